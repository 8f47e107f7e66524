"""Sides that follow from the length of a run, and the sides of a run as they were chosen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from farhorizon.boundaries import Side
from farhorizon.checks.examined import Examined
from farhorizon.checks.price import extended_price, price
from farhorizon.errors import InputError
from farhorizon.files.checkpoint_format import read_checkpoint
from farhorizon.machine import available_memory
from farhorizon.models import LatticeModel
from farhorizon.simulation.course import warn
from farhorizon.simulation.described import rebuild
from farhorizon.simulation.setup import Key, side_name
from farhorizon.simulation.surroundings import Surroundings


class Changeable(Examined, Protocol):
    """A set-up before its run that can have other sides."""

    step_count: int

    def examine(self, until: float) -> object:
        """Look at the stability of a run; InputError where it is refused."""

    def take(self, sides: Mapping[Key, Side]) -> None:
        """Be at the start of the same run with some other sides."""


@dataclass
class Settling:
    """The choice of sides by the length of the run.

    Attributes
    ----------
    autos : dict of (axis, side) to Side
        Sides that are layers or extend the domain, whichever takes less time.
    open_ended : list of (axis, side)
        Those that follow from the length of the run.
    good_for : float
        Length of the run that the sides are good for, as far as they are chosen for one.
    why : list of str
        How it was chosen.
    """

    autos: dict[Key, Side]
    open_ended: list[Key]
    good_for: float = 0.0
    why: list[str] = field(default_factory=list)

    def settle(self, run: Changeable, until: float) -> None:
        """Choose anew for a run that has not begun if it is longer than the sides are good for.

        Raises
        ------
        InputError
            An extended domain that does not fit into memory.
        """
        if run.step_count or not until > self.good_for * (1 + 1e-9):
            return
        if self.autos:
            self._decide(run, until)
        elif any(until > end * (1 + 1e-9) for end in (*_ends(run.thickness), *_ends(run.extents))):
            sides: dict[Key, Any] = dict(run.sides)
            try:
                run.take({key: replace(sides[key], nodes=None, until=until) for key in self.open_ended})
            except InputError:  # what layers keep then is noted
                if any(sides[key].extended for key in self.open_ended):
                    raise
        self.good_for = until

    def adopt(self, run: Changeable, path: str | Path) -> None:
        """Take the sides of the run that wrote a checkpoint, as far as its length or its price chose them."""
        names = {key: side_name(*key) for key in {*self.open_ended, *self.autos}}
        if run.step_count or not names:
            return
        arrays, meta = read_checkpoint(path)
        theirs = rebuild(meta["setup"]["dict"]["boundary"], arrays)
        if all(theirs[name].stretched or theirs[name].extended for name in names.values() if name in theirs):
            run.take({key: theirs[name] for key, name in names.items()})

    def _decide(self, run: Changeable, until: float) -> None:
        """Take layers or the extended domain on the sides that leave the choice, whichever takes less time."""
        far_sides: dict[Key, Side] = {key: b.as_domain(until) for key, b in self.autos.items()}
        near_sides: dict[Key, Side] = {key: b.as_layer(until, run.model.target) for key, b in self.autos.items()}
        try:
            if any(run.sides[key] != layer for key, layer in near_sides.items()):
                run.take(near_sides)
        except InputError as error:
            run.take(far_sides)
            self.why = [f"the domain is extended, for layers do not serve: {error.message}"]
            return
        layers, far = price(run), extended_price(run, until, list(self.autos))
        fits = far.memory <= available_memory()
        if fits and far.seconds < layers.seconds:
            run.take(far_sides)
            self.why = [f"the domain is extended: layers would take {layers.over(far)}"]
            return
        self.why = [f"layers: the extended domain would take {far.over(layers)}"]
        try:
            run.examine(until)  # as the run will, which knows the answer then
        except InputError as error:
            if fits:
                run.take(far_sides)
                self.why = [f"the domain is extended, for layers do not serve: {error.message}"]


def outlasted(around: Surroundings, until: float, dt: float) -> list[str]:
    """What is to be said of a run that outlasts what its sides were chosen for, by more than its last step."""
    asked = {side_name(*key): b.until or 0.0 for key, b in around.sides.items()}
    first = min(around.thickness, key=lambda name: around.thickness[name].until, default="")
    longer = (
        "errors of longer runs are not predicted"
        if first and asked[first] > around.thickness[first].until + dt
        else "LatticePML(target=..., until=...) chooses them for a longer run"
    )
    chosen = {
        f"the layers keep their target up to t = {{:.6g}}, later perhaps not: {longer}": _ends(around.thickness),
        "nothing comes back from the end of the extended domain up to t = {:.6g}, later something does: "
        "Extended(until=...)": _ends(around.extents),
    }
    return [said.format(min(ends)) for said, ends in chosen.items() if ends and until > min(ends) + dt]


def warn_outlasted(around: Surroundings, known: float, until: float, dt: float) -> None:
    """Warn once of a run that outlasts what its sides were chosen for, if it did not by the end that was known."""
    told = outlasted(around, known, dt)
    for text in outlasted(around, until, dt):
        if text not in told:
            warn(text)


def settled_sides(around: Surroundings, model: LatticeModel) -> dict[str, Side]:
    """The sides by name, with the layers that were chosen for the data: on another lattice, or without data, they stay
    what they are.
    """
    found: dict[str, Side] = {}
    for key, side in around.sides.items():
        name, extent = side_name(*key), around.extents.get(key)
        found[name] = side
        if name in around.thickness:
            layer = around.layers[key]
            found[name] = replace(side, target=side.wanted(model.target), nodes=layer.columns, profile=layer)
        elif extent is not None and np.isfinite(extent.until):
            found[name] = replace(side, nodes=extent.nodes, until=extent.until)
    return found


def _ends(chosen: Mapping[Any, Any]) -> list[float]:
    """Lengths of runs that sides were chosen for."""
    return [found.until for found in chosen.values()]

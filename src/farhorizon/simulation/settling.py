"""Sides that depend on the length of a run, and the sides of a run as chosen."""

from __future__ import annotations

import copy
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
from farhorizon.medium.integrators import Euler, RungeKuttaChebyshev
from farhorizon.models import LatticeModel
from farhorizon.simulation.course import warn
from farhorizon.simulation.described import rebuild
from farhorizon.simulation.setup import Key, side_name
from farhorizon.simulation.surroundings import Foretold, Surroundings

# times up to which errors are predicted next, relative to that up to which they are known; the second one is tried if
# a target is missed by the first
_AHEAD = 1.5, 1.05
_MANY = 100_000  # steps: assembling another set-up, in order to see what it saves, takes less time than some of these
_LONGER = "LatticePML(target=..., until=...) chooses them for a longer run"


class Changeable(Examined, Protocol):
    """A set-up before its run whose sides can be replaced."""

    step_count: int
    team: Any

    def examine(self, until: float) -> object:
        """Examine the stability of a run; raise InputError if it is refused."""

    def take(self, sides: Mapping[Key, Side]) -> None:
        """Go back to the start of the same run with some sides replaced."""


@dataclass
class Settling:
    """Choice of sides by the length of the run.

    Attributes
    ----------
    autos : dict of (axis, side) to Side
        Sides that become layers or extended domains, whichever takes less time.
    open_ended : list of (axis, side)
        Sides that depend on the length of the run.
    good_for : float
        Length of the run for which the sides were last chosen.
    why : list of str
        Reasons for the choice.
    """

    autos: dict[Key, Side]
    open_ended: list[Key]
    good_for: float = 0.0
    why: list[str] = field(default_factory=list)

    def settle(self, run: Changeable, until: float) -> None:
        """Choose the sides again if the run has not begun and is to be longer than they were chosen for.

        Raises
        ------
        InputError
            The extended domain does not fit into memory.
        """
        if run.step_count or not until > self.good_for * (1 + 1e-9):
            return
        if self.autos:
            self._decide(run, until)
        elif any(until > end * (1 + 1e-9) for end in (*_ends(run.thickness), *_ends(run.extents))):
            sides: dict[Key, Any] = dict(run.sides)
            try:
                run.take({key: replace(sides[key], nodes=None, until=until) for key in self.open_ended})
            except InputError:  # layers stay as they are, which is noted
                if any(sides[key].extended for key in self.open_ended):
                    raise
        self.good_for = until

    def adopt(self, run: Changeable, path: str | Path) -> None:
        """Take those sides that depend on the length of the run or on their cost from the run that wrote a
        checkpoint.
        """
        names = {key: side_name(*key) for key in {*self.open_ended, *self.autos}}
        if run.step_count or not names:
            return
        arrays, meta = read_checkpoint(path)
        theirs = rebuild(meta["setup"]["dict"]["boundary"], arrays)
        if all(theirs[name].stretched or theirs[name].extended for name in names.values() if name in theirs):
            run.take({key: theirs[name] for key, name in names.items()})

    def _decide(self, run: Changeable, until: float) -> None:
        """Use layers or the extended domain on the sides that leave the choice open, whichever takes less time."""
        far_sides: dict[Key, Side] = {key: b.as_domain(until) for key, b in self.autos.items()}
        near_sides: dict[Key, Side] = {key: b.as_layer(until, run.model.target) for key, b in self.autos.items()}
        try:
            if any(run.sides[key] != layer for key, layer in near_sides.items()):
                run.take(near_sides)
        except InputError as error:
            run.take(far_sides)
            self.why = [f"the domain is extended, because layers cannot be used: {error.message}"]
            return
        layers, far = price(run), extended_price(run, until, list(self.autos))
        fits = far.memory <= available_memory()
        if fits and far.seconds < layers.seconds:
            run.take(far_sides)
            self.why = [f"the domain is extended: layers would take {layers.over(far)}"]
            return
        self.why = [f"layers: the extended domain would take {far.over(layers)}"]
        try:
            run.examine(until)  # the run needs this too, and reuses the result
        except InputError as error:
            if fits:
                run.take(far_sides)
                self.why = [f"the domain is extended, because layers cannot be used: {error.message}"]


def foretell(around: Surroundings, model: LatticeModel, until: float, dt: float) -> None:
    """Predict what the layers reflect in a run that lasts longer than they were chosen for. The prediction extends
    somewhat further, unless a target is missed by then, so that a run in many pieces needs only a few of them.
    """
    known = min((max(one.until, _foretold(around, name).until) for name, one in around.thickness.items()), default=0.0)
    if around.returned is None or not known + dt < until <= around.foreseeable:
        return
    already = _missing(around, model, list(around.foretold))
    for ahead in _AHEAD:
        end = min(max(until, ahead * known), around.foreseeable)
        try:
            errors = around.returned(end)
        except Exception:  # signals are functions of the user and may not be defined at such late times
            continue
        around.foretold.update({side_name(*key): Foretold(end, error) for key, error in errors.items()})
        if already or not _missing(around, model, list(around.foretold)):
            return


def outlasted(around: Surroundings, model: LatticeModel, until: float, dt: float) -> list[str]:
    """Return warnings for a run that lasts longer, by more than its last step, than its sides were chosen for; the
    target of a side without its own is that of the model.
    """
    late = [name for name, one in around.thickness.items() if until > one.until + dt]
    unknown = [name for name in late if until > _foretold(around, name).until + dt]
    found = [_may_miss(around, unknown, dt)] if unknown else []
    missing = _missing(around, model, [name for name in late if name not in unknown])
    if missing:
        chosen = min(around.thickness[name].until for name in missing)
        end = max(_foretold(around, name).until for name in missing)
        of = "the largest value" + " at that time" * (model.order == 1)
        found.append(
            f"the layers ({', '.join(missing)}) meet their target up to t = {chosen:.6g}; up to t = {end:.6g} they are "
            f"predicted to reflect {max(missing.values()):.1g} of {of}: {_LONGER}"
        )
    ends = _ends(around.extents)
    if ends and until > min(ends) + dt:
        found.append(
            f"nothing comes back from the end of the extended domain up to t = {min(ends):.6g}, but later "
            "something does: use Extended(until=...)"
        )
    return found


def _missing(around: Surroundings, model: LatticeModel, names: list[str]) -> dict[str, float]:
    """Return which of some sides with predictions miss their targets, with the predicted error. The errors of the two
    sides of an axis add up, and their sum is compared with the larger of the two targets.
    """
    sides = {side_name(*key): b for key, b in around.sides.items()}
    targets = {name: sides[name].wanted(model.target) for name in around.foretold}  # walls have none
    found = {}
    for name in names:
        axis = {other: one.error for other, one in around.foretold.items() if other[0] == name[0]}
        own, both = axis[name], sum(axis.values())
        if both > max(targets[other] for other in axis):
            found[name] = both
        elif own > targets[name]:
            found[name] = own
    return found


def _foretold(around: Surroundings, name: str) -> Foretold:
    return around.foretold.get(name, Foretold())


def _may_miss(around: Surroundings, names: list[str], dt: float) -> str:
    """Return a warning about layers of which nothing is known at such late times."""
    asked = {side_name(*key): b.until or 0.0 for key, b in around.sides.items()}
    first = min(names, key=lambda name: around.thickness[name].until)
    end = around.thickness[first].until
    longer = "errors of longer runs are not predicted" if asked[first] > end + dt else _LONGER
    return f"the layers meet their target up to t = {end:.6g}, but perhaps not later: {longer}"


def warn_outlasted(around: Surroundings, model: LatticeModel, known: float, until: float, dt: float) -> None:
    """Warn of a run that now lasts longer than its sides were chosen for; warnings that applied at the time `known` are
    not repeated.
    """
    told = outlasted(around, model, known, dt)
    foretell(around, model, until, dt)
    for text in outlasted(around, model, until, dt):
        if text not in told:
            warn(text)


def many_steps(run: Changeable, until: float) -> list[str]:
    """Return a note on a run of many steps of Euler's method, if a method of more stages can take fewer."""
    steps, model = int(np.ceil(until / run.dt)), copy.copy(run.model)
    if not isinstance(model.integrator, Euler) or steps < _MANY or run.team:
        return []
    model.integrator = RungeKuttaChebyshev()
    try:
        other = run.remade(model=model, dt=None)
    except InputError:
        return []
    stages, longest = model.integrator.chebyshev, other.step_limit / 2  # half of the limit, as Euler's steps have
    sums = stages * until / longest
    if sums > steps / 2:
        return []
    return [
        f"Euler's method takes {steps} steps of {run.dt:.3g} to t = {until:g}, as its stability requires: "
        f'integrator = "rkc" is stable with steps of up to {longest:.3g}, each of {stages} sums over the bonds, '
        f"{steps / sums:.2g} times fewer in all; give it the dt that the data and their changes in time require"
    ]


def settled_sides(around: Surroundings, model: LatticeModel) -> dict[str, Side]:
    """Return the sides by name, with the layers that were chosen for the data, so that they remain the same on another
    lattice or without data.
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
    """Lengths of the runs that sides were chosen for."""
    return [found.until for found in chosen.values()]

"""Sides that depend on the length of a run, and the sides of a run as chosen."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from farhorizon.analysis.layers.thickness import Thickness
from farhorizon.boundaries import Side
from farhorizon.checks.examined import Examined
from farhorizon.checks.run_cost import extended_run_cost, run_cost
from farhorizon.errors import InputError
from farhorizon.files.checkpoint_format import read_checkpoint
from farhorizon.machine import available_memory
from farhorizon.medium.integrators import Euler, RungeKuttaChebyshev
from farhorizon.rounding import MARGIN
from farhorizon.simulation.setup.serialization import rebuild
from farhorizon.simulation.setup.setup import Key, Setup, side_name
from farhorizon.simulation.sides.layer_choice import Chosen, assess_layers, choose_layers
from farhorizon.simulation.sides.layered_sides import LayeredSides
from farhorizon.simulation.time.outer_loop import warn

_AHEAD = 1.5  # how much farther than a run that is continued the trial of its layers goes
_MANY = 100_000  # steps: assembling another set-up, in order to see what it saves, takes less time than some of these
_LONGER = "LatticePML(target=..., until=...) chooses them for a longer run"


T = TypeVar("T")


class Changeable(Examined, Protocol):
    """A set-up before its run whose sides can be replaced."""

    step_count: int
    team: Any
    setup: Setup
    subdomain: Any
    parts: Any

    @property
    def of(self) -> Callable[..., Any]:
        """Makes a run of a set-up."""

    def examine(self, until: float) -> object:
        """Examine the stability of a run; raise InputError if it is refused."""

    def take(self, sides: Mapping[Key, Side]) -> None:
        """Go back to the start of the same run with some sides replaced."""


@dataclass
class SideSelection:
    """Choice of sides by the length of the run: sides that become layers or extended domains, whichever takes less time
    (`autos`), or depend on the length (`open_ended`), the length that they are `good_for`, and why, with layers, their
    errors and warnings.
    """

    autos: dict[Key, Side]
    open_ended: list[Key]
    good_for: float = 0.0
    thickness: dict[str, Thickness] = field(default_factory=dict)
    doubts: list[str] = field(default_factory=list)
    why: list[str] = field(default_factory=list)

    def select(self, run: Changeable, until: float) -> None:
        """Choose the sides for a run that has not begun and is to be longer than they were chosen for; see whether
        those of a run that has begun are good for longer. An InputError where no layer keeps a target, or the extended
        domain does not fit into memory.
        """
        if not until > self.good_for * (1 + MARGIN):
            return
        if run.step_count:
            self._prolong(run, until)
            return
        self.doubts, self.why = [], []
        if self.autos:
            self._decide(run, until)
        else:
            self._choose(run, until)
        self._assess(run, until)
        self.good_for = max([until, *(one.until for one in self.thickness.values())])

    def _choose(self, run: Changeable, until: float) -> None:
        """Choose the open-ended sides."""
        every: Mapping[Key, Any] = run.sides if run.subdomain is None else run.subdomain.sides
        keys = [key for key in self.open_ended if every[key].extended]
        if keys and any(until > extent.until * (1 + MARGIN) for extent in run.extents.values()):
            run.take({key: replace(every[key], nodes=None, until=until) for key in keys})
        if keys := [key for key in self.open_ended if every[key].stretched]:
            self._take(run, by_first(run, lambda whole: choose_layers(whole, keys, until)))

    def _take(self, run: Changeable, chosen: Chosen) -> None:
        run.take(chosen.sides)
        self.thickness, self.doubts = chosen.thickness, chosen.doubts
        self.why = self.why + chosen.notes

    def _assess(self, run: Changeable, until: float) -> None:
        """Compare layers of a given number of nodes that have a target with thicker ones."""
        given: Mapping[Key, Any] = run.sides if run.subdomain is None else run.setup.sides
        asked = [key for key, b in given.items() if b.stretched and not b.whole and b.nodes is not None]
        if keys := [key for key in asked if given[key].target is not None]:
            self.doubts = self.doubts + by_first(run, lambda whole: assess_layers(whole, keys, until))[1]

    def assess_given(self, run: Changeable, until: float) -> None:
        """Compare layers of a given number of nodes without a target with thicker ones, for a report."""
        keys = [key for key, b in run.sides.items() if b.stretched and not b.whole and b.nodes and b.target is None]
        if run.step_count or not keys:
            return
        error, doubts = assess_layers(run, keys, until)
        layers = {side_name(*key): run.parts.layered.layers[key] for key in keys}
        self.thickness = self.thickness | {name: Thickness("given", one, error, until) for name, one in layers.items()}
        self.doubts = [*self.doubts, *(text for text in doubts if text not in self.doubts)]

    def _prolong(self, run: Changeable, until: float) -> None:
        """See whether the layers of a run that has begun are good for longer."""
        keys = [key for key in self.open_ended if side_name(*key) in self.thickness]
        if not keys or not self.good_for:
            return
        error, doubts = by_first(run, lambda whole: assess_layers(whole, keys, _AHEAD * until))
        if not np.isnan(error) and not doubts:
            self.good_for = _AHEAD * until
            return
        end = max(one.until for one in self.thickness.values())
        known = f"up to t = {_AHEAD * until:.6g} they reflect {error:.1g}" if doubts else "perhaps not later"
        say = f"the layers ({', '.join(self.thickness)}) meet their target up to t = {end:.6g}, but {known}: {_LONGER}"
        if say not in self.doubts:
            self.doubts = [*self.doubts, say]
            warn(say)

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
            if not all(run.sides[key].stretched for key in near_sides):
                run.take(near_sides)
            others = [key for key in self.open_ended if run.sides[key].stretched and key not in self.autos]
            self._take(run, by_first(run, lambda whole: choose_layers(whole, [*self.autos, *others], until)))
        except InputError as error:
            self._extend(run, far_sides)
            self.why = [f"the domain is extended, because layers cannot be used: {error.message}"]
            return
        layers, far = run_cost(run), extended_run_cost(run, until, list(self.autos))
        fits = far.memory <= available_memory()
        if fits and far.seconds < layers.seconds:
            self._extend(run, far_sides)
            self.why = [f"the domain is extended: layers would take {layers.over(far)}"]
            return
        self.why = [f"layers: the extended domain would take {far.over(layers)}", *self.why]
        try:
            run.examine(until)  # the run needs this too, and reuses the result
        except InputError as error:
            if fits:
                self._extend(run, far_sides)
                self.why = [f"the domain is extended, because layers cannot be used: {error.message}"]

    def _extend(self, run: Changeable, sides: Mapping[Key, Side]) -> None:
        run.take(sides)
        self.thickness, self.doubts = {}, []


def extension_warnings(layered: LayeredSides, until: float, dt: float) -> list[str]:
    """Return a warning for a run that lasts longer than extended domains are chosen for, by more than a step."""
    ends = [extent.until for extent in layered.extents.values()]
    if not ends or until <= min(ends) + dt:
        return []
    return [
        f"nothing comes back from the end of the extended domain up to t = {min(ends):.6g}, but later "
        "something does: use Extended(until=...)"
    ]


def by_first(run: Changeable, work: Callable[[Any], T]) -> T:
    """Return the result of work on the whole set-up of a run; on several processes the first one does it."""
    if run.subdomain is None:
        return work(run)
    whole = replace(run.setup, dt=run.dt, boundary=run.subdomain.boundary)
    return run.team.first(run.team.by_first(lambda: work(run.of(whole))))


def many_steps(run: Changeable, until: float) -> list[str]:
    """Return a note on a run of many steps of Euler's method, if a method of more stages can take fewer."""
    steps, model = int(np.ceil(until / run.dt)), copy.copy(run.model)
    if not isinstance(model.integrator, Euler) or steps < _MANY or run.team:
        return []
    model.integrator = RungeKuttaChebyshev()
    try:
        other = run.remade(model=model, dt=None, boundary=run.parts.layered.as_given())
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


def resolved_sides(layered: LayeredSides) -> dict[str, Side]:
    """Return the sides by name, with extended domains as they were chosen, so that they remain the same on another
    lattice or without data.
    """
    resolved: dict[str, Side] = {}
    for key, side in layered.sides.items():
        name, extent = side_name(*key), layered.extents.get(key)
        resolved[name] = side
        if extent is not None and np.isfinite(extent.until):
            resolved[name] = replace(side, nodes=extent.nodes, until=extent.until)
    return resolved

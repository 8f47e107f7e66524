"""What heat strains a near field, from a temperature that is given or computed beside it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from farhorizon.engine.settings import give_heat
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import Lattice
from farhorizon.inputs.expressions import as_given
from farhorizon.inputs.sources import field, split
from farhorizon.inputs.thermal_loads import ThermalLoad
from farhorizon.simulation.course import warn
from farhorizon.simulation.grid import Grid
from farhorizon.simulation.near_field import NearField
from farhorizon.simulation.setup import Setup, Sides, side_name
from farhorizon.simulation.team import ALONE, Team

_STRIP = 2  # reaches beside a side in which no bond sees heat, or one of its ends does not


class Heating:
    """What heat strains a near field as time goes on; the engine has it.

    Parameters
    ----------
    load : ThermalLoad
        With texts settled (`farhorizon.simulation.setup`).
    near : NearField
    grid : Grid
    sides : dict of (axis, side) to Side
    run_of : callable
        Makes a run of a set-up.
    team : Team
        The processes that compute the run, which all look at the same steps.

    Attributes
    ----------
    every : int
        Steps from one look at the temperature to the next, between which the strains change evenly; 0 where they stay.

    Raises
    ------
    InputError
        A temperature on other nodes, an expansion that is not finite, heat near sides that are not free.
    """

    def __init__(
        self,
        load: ThermalLoad,
        near: NearField,
        grid: Grid,
        sides: Sides,
        run_of: Callable[[Setup], Any],
        team: Team = ALONE,
    ) -> None:
        self.load, self.near, self.grid, self.sides, self._team = load, near, grid, sides, team
        key, lattice = "load.expansion", near.lattice
        self._expansion = field(as_given(load.expansion, lattice.dim, key, time=False), lattice, 1, key) * _held(near)
        self._largest, self._told = 0.0, False
        run = RunBeside(load, lattice, run_of) if load.of_run(load.temperature) else None
        self._temperature = _given(load, lattice) if run is None else run.at
        between = load.every or (0.0 if run is None else run.dt)
        self.every = 0 if load.steady else max(1, int(between / near.dt * (1 + 1e-9)))
        self._known: dict[int, np.ndarray] = {}

    def lay(self, step: int) -> float:
        """Tell the engine what heat strains the nodes at a step, and until the next look; the displacements that all
        strains so far explain.
        """
        start = step - step % self.every if self.every else 0
        now = self._strain(start)
        rate = (self._strain(start + self.every) - now) / self.every if self.every else np.zeros_like(now)
        give_heat(self.grid.engine, self.grid.grown(now), self.grid.grown(rate), step - start)
        return self._largest * self.near.lattice.spacing * max(self.near.lattice.whole.shape)

    def due(self, step: int) -> bool:
        """Whether there is a look at the temperature before a step."""
        return bool(self.every) and step % self.every == 0

    def allow(self, step: int, steps: int) -> int:
        """How many of some steps may be made from one on until the next look."""
        return min(steps, self.every - step % self.every) if self.every else steps

    @property
    def strains(self) -> np.ndarray:
        """What heat strains the nodes now; shape of the lattice."""
        warmth = self.grid.engine.tables.heat.warmth[self.grid.nodes]
        return warmth.astype(float).reshape(self.near.lattice.shape)

    def _strain(self, step: int) -> np.ndarray:
        """The strains at a step: those of the last look are known at the next one."""
        if step not in self._known:
            changed = self._temperature(step * self.near.dt) - self.load.reference
            values = self.near.inside(self._expansion * changed)
            self._check_sides(values, step)
            self._known = {k: v for k, v in self._known.items() if k == step - self.every} | {step: values}
        return self._known[step]

    def _check_sides(self, strains: np.ndarray, step: int) -> None:
        """Beside sides that are neither free nor periodic no bond knows of heat."""
        found = {None: float(np.abs(strains).max(initial=0))} | self._beside(strains)
        every = self._team.gather(found)
        self._largest = max(self._largest, *(one[None] for one in every))
        for key in dict.fromkeys(key for one in every for key in one if key is not None):
            wide, strain, target = max(one[key] for one in every if key in one)
            share = strain / max(self._largest, 1e-300)
            if share <= target:
                continue
            words = f"the temperature near the side {side_name(*key)} is not that of the solid free of stress"
            if step == 0:
                raise InputError(
                    words,
                    value=f"{share:.2g} of the largest change within {wide} nodes of it",
                    limit=f"{target:g}",
                    key="load.temperature",
                    remedy="a larger near field, Periodic or Free",
                )
            if not self._told:
                self._told = True
                warn(
                    f"{words}: from t = {step * self.near.dt:.3g} on {share:.2g} of the largest change is missed there"
                )

    def _beside(self, strains: np.ndarray) -> dict[Any, Any]:
        """Of each side that must see no heat how many nodes beside it are looked at, the largest strain of them, and
        what it may be over the largest of all.
        """
        found = {}
        for (axis, side), boundary in self.sides.items():
            if boundary.periodic or boundary.shared or not boundary.bonded:
                continue
            wide = _STRIP * self.near.stencil.reach[axis]
            strip = np.take(strains, range(wide) if side < 0 else range(-wide, 0), axis)
            target = boundary.wanted(self.near.model.target) if boundary.endless else self.near.model.target
            found[axis, side] = wide, float(np.abs(strip).max(initial=0)), target
        return found


class RunBeside:
    """The field of a run beside another one, on a part of its lattice.

    Parameters
    ----------
    load : ThermalLoad
    lattice : Lattice
        Of the other run.
    run_of : callable
        Makes a run of a set-up.

    Raises
    ------
    InputError
        Nodes that are not those of the lattice, or without a temperature.
    """

    def __init__(self, load: ThermalLoad, lattice: Lattice, run_of: Callable[[Setup], Any]) -> None:
        self._setup, self._run_of, self._reference = load.temperature, run_of, load.reference
        own = self._setup.lattice
        first = (own.lower - lattice.lower) / lattice.spacing if own.dim == lattice.dim else np.full(1, np.nan)
        place = np.round(np.nan_to_num(first, nan=-1)).astype(int)
        last = place + np.array(own.shape) if own.dim == lattice.dim else place
        fits = abs(own.spacing / lattice.spacing - 1) < 1e-9 and np.abs(first - place).max() < 1e-6
        if not fits or place.min() < 0 or (last > lattice.shape).any():
            raise InputError(
                "the temperature is computed on nodes that are not those of the solid",
                value=f"spacing {own.spacing:g} from {own.lower.tolist()}",
                limit=f"spacing {lattice.spacing:g} from {lattice.lower.tolist()} to {lattice.upper.tolist()}",
                key="load.temperature",
                remedy="the same lattice, or a part of it",
            )
        self._shape = lattice.shape
        self._part = tuple(slice(a, b) for a, b in zip(place, last, strict=True))
        self._begin()
        unknown = ~np.isfinite(self._run.fields["u"])
        unknown &= True if lattice.mask is None else lattice.mask[self._part]
        if unknown.any():
            raise InputError(
                "the temperature is not known on nodes of the solid",
                value=f"{int(unknown.sum())} nodes",
                key="load.temperature",
                remedy='conditions of another kind than "mirror", whose images lie there, and the body of the solid',
            )

    def _begin(self) -> None:
        self._run = self._run_of(self._setup)
        self.dt = float(self._run.dt)
        self._before = self._after = self._field()

    def _field(self) -> np.ndarray:
        found = np.full(self._shape, self._reference)
        values = self._run.fields["u"]
        found[self._part] = np.where(np.isfinite(values), values, self._reference)
        return found

    def at(self, t: float) -> np.ndarray:
        """The field at a time, linear between steps; from one long past the run begins anew."""
        if t < (self._run.step_count - 1) * self.dt:
            self._begin()
        while self._run.step_count * self.dt < t:
            self._run.step()
            self._before, self._after = self._after, self._field()
        part = max(self._run.step_count - t / self.dt, 0.0)
        return self._after + min(part, 1.0) * (self._before - self._after)


def _given(load: ThermalLoad, lattice: Lattice) -> Callable[[float], Any]:
    """A temperature as a function of time."""
    space, time = split(load.temperature, lattice)
    return time if space is None else lambda t: space * time(t)


def _held(near: NearField) -> Any:
    """What strains in the plane are over those that are free: more where none is free across it."""
    if near.lattice.dim != 2 or getattr(near.model, "plane", None) == "stress":
        return 1.0
    lame, shear = near.lame
    total = lame + shear
    return 1 + np.divide(lame, 2 * total, out=np.zeros_like(total), where=total > 0)

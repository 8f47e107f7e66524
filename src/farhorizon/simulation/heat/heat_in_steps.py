"""A temperature that is advanced step by step together with the displacements."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np

from farhorizon.boundaries import Side
from farhorizon.engine.settings import give_heat
from farhorizon.inputs.thermal_loads import ThermalLoad
from farhorizon.simulation.heat.broken_bonds import BrokenBonds
from farhorizon.simulation.heat.coupling import expansion_of
from farhorizon.simulation.heat.heating import Heating, check_known, insulated
from farhorizon.simulation.heat.thermoelastic_sides import ThermoelasticNodes, heat_beside
from farhorizon.simulation.processes.process_group import ALONE
from farhorizon.simulation.setup.grid import Grid
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Key, Setup, Sides


class HeatInSteps(Heating):
    """A temperature that makes the same steps as the displacements.

    Parameters
    ----------
    load : ThermalLoad
        Its temperature is the set-up of the heat conduction.
    near : NearField
        Near field of the solid, to which `grid` and `sides` belong as well.
    grid : Grid
    sides : dict of (axis, side) to Side
    shared : mapping of (axis, side) to Side
        Sides through which the temperature continues together with the displacements, as used for the temperature.
    time_loop_of : callable
        Makes a `TimeLoop` of a set-up, given what drives it in addition to its sources: a function of time.
    broken : BrokenBonds, optional
        Broken bonds of the solid, if there can be any; they do not conduct from the step in which they break.

    Attributes
    ----------
    kept : tuple of str
        Names of the arrays to save that do not follow from the set-up, in addition to the state of the heat conduction.
    """

    kept: ClassVar[tuple[str, ...]] = ("now", "before")

    def __init__(
        self,
        load: ThermalLoad,
        near: NearField,
        grid: Grid,
        sides: Sides,
        shared: Mapping[Key, Side],
        time_loop_of: Callable[[Setup, Callable[[float], np.ndarray]], Any],
        broken: BrokenBonds | None = None,
    ) -> None:
        cold = {key: side for key, side in sides.items() if key not in shared}
        self.load, self.near, self.grid, self.sides, self._team = load, near, grid, cold, ALONE
        assert load.reference is not None
        self._zero = load.reference
        self._whole = expansion_of(load, near.lattice, near.model, near.lame)
        self._expansion = self._whole * self._seen()
        self._largest, self._told = 0.0, False
        self.every = 1
        self._power = np.zeros(near.lattice.shape)
        self._heat = time_loop_of(heat_beside(load, near.dt, shared), lambda _: self._power)
        check_known(len(self._heat.parts.near.conditions.images))
        self._broken = broken
        if broken is not None:
            self._insulated = insulated(load, broken, self._heat.parts, np.zeros(near.lattice.dim, int))
            self._table: np.ndarray | None = broken.table()
        self._beyond = ThermoelasticNodes(grid, self._heat.parts.grid, self._expansion) if shared else None
        self._now = self._before = self._temperature_now()

    def _seen(self) -> Any:
        """Factor on the expansion at each node."""
        return 1.0

    def _temperature_now(self) -> np.ndarray:
        parts = self._heat.parts
        found = parts.grid.view(parts.grid.engine.current).reshape(self.near.lattice.shape).astype(float)
        return np.asarray(found + parts.near.background)

    def lay(self, step: int) -> float:
        """Give the engine the present thermal strains; return the size of displacements that all strains so far can
        explain.
        """
        changed = self._now - self._zero
        strains = self.near.inside(self._expansion * changed)
        self._check_heat(changed, step)
        give_heat(self.grid.engine, self.grid.grown(strains), self.grid.grown(np.zeros_like(strains)))
        if self._beyond is not None:
            self._beyond.lay()
        return self.explained

    def follow(self, step: int) -> None:
        """Advance the temperature by a step from number `step`, which the displacements have already made."""
        if self._broken is not None and (table := self._broken.table()) is not self._table:
            self._table = table
            self._heat.sever(self._insulated.of(table, self._heat.parts), step)
        for _ in self._heat.advance(step, 1):
            pass
        self._before, self._now = self._now, self._temperature_now()

    def at_points(self, nodes: np.ndarray, weights: np.ndarray, steps: int) -> np.ndarray:
        """As in `Heating`, for the temperature after the last step and, of two steps, before it."""
        strains = (self._expansion * (np.stack([self._before, self._now])[-steps:] - self._zero)).reshape(steps, -1)
        return np.asarray((strains[:, nodes] * weights).sum(-1))

    @property
    def fields(self) -> dict[str, np.ndarray]:
        return {"T": self._now.copy(), "thermal_strain": self._expansion * (self._now - self._zero)}

    def state(self, step: int) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        arrays, meta = self._heat.state(step)
        own = {name: getattr(self, f"_{name}") for name in self.kept}
        return {f"heat/{name}": values for name, values in {**arrays, **own}.items()}, {"heat": meta}

    def take(self, arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any]) -> None:
        mine = {name.removeprefix("heat/"): a for name, a in arrays.items() if name.startswith("heat/")}
        facts = meta["heat"]
        self._heat.take([(facts["boxes"][0], mine)], facts)
        self._heat.complete()
        if self._broken is not None:
            self._broken.forget()
            self._table = None
        for name in self.kept:
            setattr(self, f"_{name}", mine[name])

    def _check_heat(self, changed: np.ndarray, step: int) -> None:
        """Check that no heat flows to where bonds ignore it, so that thermal strains would be missed."""
        self._check_sides(self.near.inside(self._whole * changed), step)

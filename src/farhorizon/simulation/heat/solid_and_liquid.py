"""Solid and liquid in corrosion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from farhorizon.engine.engine import NEVER
from farhorizon.engine.features.phases import set_phases
from farhorizon.errors import InputError
from farhorizon.inputs.specimens import place
from farhorizon.models.model import Dissolution
from farhorizon.simulation.setup.grid import Grid
from farhorizon.simulation.setup.setup import Setup, Sides, side_name

_SUPERSATURATED = 0.05  # fraction of the saturation by which the liquid may exceed it without a warning


def placed(setup: Setup, sides: Sides) -> tuple[np.ndarray, np.ndarray]:
    """Return the solid nodes and their concentrations; refuse metal at an absorbing side, where everything must be
    liquid.
    """
    lattice, dissolution = setup.lattice, setup.model.dissolution
    if dissolution is None:
        return np.zeros(lattice.shape, bool), np.zeros(lattice.shape)
    solid, metal = place(setup.specimens, lattice, dissolution.saturation, setup.background)
    for (axis, side), boundary in sides.items():
        if boundary.endless and np.take(solid, 0 if side < 0 else -1, axis).any():
            raise InputError(
                f"a specimen touches the absorbing side {side_name(axis, side)}; beyond it all is liquid",
                key="specimens",
                remedy="enlarge the near field, or end the specimen at a Free side",
            )
    return solid, metal


@dataclass(frozen=True, eq=False)
class SolidAndLiquid:
    """Phases of a near field on its grid; `first` marks the nodes that are solid at the start."""

    grid: Grid
    dissolution: Dissolution
    background: float
    first: np.ndarray

    def set(self, dissolved: np.ndarray) -> None:
        """Give the engine the step at which each node of the near field dissolved (`NEVER` if it is solid)."""
        core = np.zeros(self.grid.core.nodes, np.int64)
        core[self.grid.near] = dissolved.reshape(core[self.grid.near].shape)
        law = self.dissolution
        set_phases(self.grid.engine, core, law.interface, law.saturation - self.background, law.limited)

    def start(self) -> None:
        """Give the engine the initial phases."""
        self.set(np.where(self.first, NEVER, 0))

    @property
    def steps(self) -> np.ndarray:
        """Step at which each node dissolved, of the shape of the lattice."""
        return self.grid.get("phases.dissolved")

    @property
    def solid(self) -> np.ndarray:
        """Nodes of the near field that are solid now."""
        return self.steps == NEVER

    def refuse_wet(self, busy: np.ndarray) -> None:
        """Raise InputError if a source or a condition acts on solid nodes (`busy` marks where they act): metal changes
        only by what it loses to the liquid.
        """
        wet = int((busy & self.solid).sum())
        if wet:
            raise InputError(
                "a source or a condition acts on solid nodes",
                value=f"{wet} nodes",
                key="specimens",
                remedy="keep sources and conditions in the liquid",
            )

    @property
    def most(self) -> float:
        """Largest concentration in the liquid relative to the saturation, both relative to the background."""
        liquid = np.where(self.solid, -np.inf, self.grid.get("u"))
        return float(liquid.max()) / (self.dissolution.saturation - self.background)

    def warning(self, most: float) -> str | None:
        """Return a warning if `most`, the largest ratio in the whole run, exceeds 1 by too much; otherwise None."""
        if most <= 1 + _SUPERSATURATED:
            return None
        remedy = (
            "limited = true guarantees its bound only in Euler's steps: use integrator = 'euler' or a smaller step"
            if self.dissolution.limited
            else "use limited = true, or an interface for the speed of the front (Corrosion.interface_for)"
        )
        return (
            f"the liquid holds up to {most:.3g} times the saturation: metal dissolves faster than it diffuses away; "
            f"{remedy}"
        )

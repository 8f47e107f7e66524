"""The solid and the liquid of a corrosion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from farhorizon.engine.engine import NEVER
from farhorizon.engine.settings import set_phases
from farhorizon.errors import InputError
from farhorizon.inputs.specimens import place
from farhorizon.models.model import Dissolution
from farhorizon.simulation.grid import Grid
from farhorizon.simulation.setup import Setup, Sides, side_name

_SUPERSATURATED = 0.05  # part of the saturation by which liquid may exceed it without a word


def placed(setup: Setup, sides: Sides) -> tuple[np.ndarray, np.ndarray]:
    """The solid nodes and what they hold; refuses metal at an absorbing side, where all must be liquid."""
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
    """The phases of a near field on its grid.

    Attributes
    ----------
    grid : Grid
    dissolution : Dissolution
    background : float
    first : ndarray of bool
        Nodes that are solid at the start.
    """

    grid: Grid
    dissolution: Dissolution
    background: float
    first: np.ndarray

    def set(self, dissolved: np.ndarray) -> None:
        """Give the engine the step at which each node of the near field became liquid (`NEVER`: solid)."""
        core = np.zeros(self.grid.engine.core.nodes, np.int64)
        core[self.grid.near] = dissolved.reshape(core[self.grid.near].shape)
        law = self.dissolution
        set_phases(self.grid.engine, core, law.interface, law.saturation - self.background, law.limited)

    def start(self) -> None:
        """Give the engine the phases of the start."""
        self.set(np.where(self.first, NEVER, 0))

    @property
    def steps(self) -> np.ndarray:
        """Step at which each node became liquid, of the lattice's shape."""
        return self.grid.engine.dissolved[self.grid.near].reshape(self.grid.lattice.shape)

    @property
    def solid(self) -> np.ndarray:
        """The nodes of the near field that are solid now."""
        return self.steps == NEVER

    def refuse_wet(self, busy: np.ndarray) -> None:
        """Metal changes by what it loses to the liquid alone: InputError where nodes that something acts on are
        solid.
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
        """The most that the liquid holds, over what can be dissolved in it."""
        liquid = np.where(self.solid, -np.inf, self.grid.view(self.grid.engine.current).reshape(self.first.shape))
        return float(liquid.max()) / (self.dissolution.saturation - self.background)

    def warning(self, most: float) -> str | None:
        """What is said where the liquid of the whole run holds so much more than can be dissolved in it; None where it
        does not.
        """
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

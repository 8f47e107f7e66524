"""The margin of a near field with breakable bonds: within one reach of sides that are not free, and outside the boxes
of incident waves, bonds cannot break, so that a crack that gets there stops.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from farhorizon.engine.bonds import steepest
from farhorizon.geometry.lattice import Lattice
from farhorizon.simulation.time.outer_loop import warn_once


@dataclass(frozen=True, eq=False)
class IntactMargin:
    """The bonds of the nodes in the margin."""

    nodes: np.ndarray  # of int, shape (n,); places of the nodes in a level
    corners: np.ndarray  # of int, shape (n, dim); their indices in the lattice
    bits: np.ndarray  # of uint64, shape (words, n); one bit per bond: set if it is present and ends in the near field
    distances: np.ndarray  # of int, shape (K,); offsets to the neighbours in a level
    bonds: np.ndarray  # shape (K, dim); bond vectors
    # largest ``|xi + eta|^2 / |xi|^2 - 1`` at which the weakest bonds would not break (linearised: ``2 xi . eta /
    # |xi|^2``)
    limit: float
    nonlinear: bool
    strength: np.ndarray  # limit at each place of a level relative to `limit`, or a single number
    every: int  # steps between two checks: a wave takes longer to cross the margin
    boxed: bool  # whether the margin includes what lies outside the boxes of incident waves

    def overstretched(self, level: np.ndarray) -> np.ndarray | None:
        """Return the index in the lattice of the node whose bond exceeds its limit most in a level of the engine; None
        if none does.
        """
        given = self.nodes, self.bits, self.distances, self.bonds, self.nonlinear, self.strength
        node, strain = steepest(level, *given)
        return self.corners[node] if strain > self.limit else None

    def warning(self, level: np.ndarray, lattice: Lattice) -> str | None:
        """Return a warning if a bond exceeds its limit; otherwise None."""
        node = self.overstretched(level)
        if node is None:
            return None
        place = (lattice.lower + lattice.spacing * node).round(9).tolist()
        return (
            f"bonds near {place} are stretched beyond the critical stretch where they cannot break, within one "
            f"reach of a side that is not free{' or outside the box of an incident wave' if self.boxed else ''}: a "
            "crack stops there, and what follows is not valid; enlarge the near field"
        )


def intact_margin(
    shape: tuple[int, ...],
    breakable: tuple[slice, ...],
    places: np.ndarray,
    offsets: np.ndarray,
    present: np.ndarray,
    within: Sequence[np.ndarray],
    distances: np.ndarray,
    bonds: np.ndarray,
    limit: float,
    nonlinear: bool,
    strength: np.ndarray,
    every: int,
) -> IntactMargin | None:
    """Return the margin of a near field, or None if there is none.

    Bonds can break between the nodes `breakable` of a lattice of this shape. `places` are those of the nodes in a
    level; `offsets`, shape (K, dim), those of the bonds; `present`, shape (words, *shape), has one bit per bond;
    `within` are masks of the boxes of incident waves: bonds through the faces of a box have no meaningful stretch. The
    others are as in `IntactMargin`.
    """
    outside = np.ones(shape, bool)
    outside[breakable] = False
    corners = np.argwhere(outside)
    bits = present[:, outside]
    for k, offset in enumerate(offsets):
        neighbours = corners + offset
        leaves = ((neighbours < 0) | (neighbours >= shape)).any(1)
        neighbours_inside = tuple(np.where(leaves[:, None], corners, neighbours).T)
        for inside in within:
            leaves |= inside[outside] != inside[neighbours_inside]
        bits[k >> 6, leaves] &= ~(np.uint64(1) << np.uint64(k & 63))
    held = bits.any(0)
    if not held.any() or not np.isfinite(limit):
        return None
    return IntactMargin(
        places[outside][held],
        corners[held],
        np.ascontiguousarray(bits[:, held]),
        distances,
        np.ascontiguousarray(bonds, float),
        limit,
        nonlinear,
        strength,
        every,
        bool(within),
    )


def look_at(run: Any, margin: IntactMargin | None, every: int, level: np.ndarray) -> None:
    """Warn if bonds in the margin of a run are stretched beyond their limit, every `every` steps, if that is positive;
    on several processes any of them may have such bonds.
    """
    if not every or run.step_count < run.next_look:
        return
    run.next_look = (run.step_count // every + 1) * every
    warnings_of_all = run.team.gather(None if margin is None else margin.warning(level, run.lattice))
    warning = next((text for text in warnings_of_all if text is not None), None)
    if warning is not None:
        warn_once(run, "crack where bonds cannot break", warning)

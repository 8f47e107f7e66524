"""The margin of a near field whose bonds break: within one reach of sides that are not free, and outside the boxes of
incident waves, they cannot, so that a crack that gets there stops.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from farhorizon.engine.bonds import steepest
from farhorizon.geometry.lattice import Lattice
from farhorizon.simulation.course import say_doubt


@dataclass(frozen=True, eq=False)
class IntactMargin:
    """The bonds of the nodes that lie there.

    Attributes
    ----------
    nodes : ndarray of int, shape (n,)
        Places of the nodes in a level.
    corners : ndarray of int, shape (n, dim)
        Their indices in the lattice.
    bits : ndarray of uint64, shape (words, n)
        Which of their bonds are there and end in the near field.
    distances : ndarray of int, shape (K,)
        To the neighbours in a level.
    bonds : ndarray, shape (K, dim)
        Vectors of the bonds.
    limit : float
        Largest ``|xi + eta|^2 / |xi|^2 - 1`` of a bond that would not break (linearised: ``2 xi . eta / |xi|^2``).
    nonlinear : bool
    strength : ndarray
        Of each place of a level the limit over that one, or of one number.
    every : int
        Steps between two looks: a wave takes longer through the margin.
    boxed : bool
        Whether what lies outside the boxes of incident waves is part of it.
    """

    nodes: np.ndarray
    corners: np.ndarray
    bits: np.ndarray
    distances: np.ndarray
    bonds: np.ndarray
    limit: float
    nonlinear: bool
    strength: np.ndarray
    every: int
    boxed: bool

    def overstretched(self, level: np.ndarray) -> np.ndarray | None:
        """Index in the lattice of the node with the bond that is nearest to its limit, or farthest beyond, if that is
        beyond it; `level` as the engine has it.
        """
        given = self.nodes, self.bits, self.distances, self.bonds, self.nonlinear, self.strength
        node, strain = steepest(level, *given)
        return self.corners[node] if strain > self.limit else None

    def warning(self, level: np.ndarray, lattice: Lattice) -> str | None:
        """What is said where such a bond is; None where there is none."""
        found = self.overstretched(level)
        if found is None:
            return None
        place = (lattice.lower + lattice.spacing * found).round(9).tolist()
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
    """The margin of a near field, None if there is none.

    Parameters
    ----------
    shape : tuple of int
        Of the lattice.
    breakable : tuple of slice
        The nodes between which bonds break.
    places : ndarray of int, of that shape
        Of the nodes in a level.
    offsets : ndarray of int, shape (K, dim)
    present : ndarray of uint64, shape (words, *shape)
        Bits of the bonds that are there.
    within : sequence of ndarray of bool, of that shape
        Nodes in the boxes of incident waves: bonds through their faces have no stretch that means anything.

    The rest as of `IntactMargin`.
    """
    outside = np.ones(shape, bool)
    outside[breakable] = False
    corners = np.argwhere(outside)
    bits = present[:, outside]
    for k, offset in enumerate(offsets):
        other = corners + offset
        leaves = ((other < 0) | (other >= shape)).any(1)
        there = tuple(np.where(leaves[:, None], corners, other).T)
        for inside in within:
            leaves |= inside[outside] != inside[there]
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
    """See every so many steps, if that is above 0, whether bonds of the margin of a run, which cannot break, are
    stretched so far that they would; of several processes any may have some.
    """
    if not every or run.step_count < run.next_look:
        return
    run.next_look = (run.step_count // every + 1) * every
    found = run.team.gather(None if margin is None else margin.warning(level, run.lattice))
    warning = next((one for one in found if one is not None), None)
    if warning is not None:
        say_doubt(run, "crack where bonds cannot break", warning)

"""The part of the near field whose history a gradient needs: a box around the region of the unknown medium."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from farhorizon.geometry.lattice import Lattice
from farhorizon.inputs.cracks import cut_bonds
from farhorizon.simulation.setup.setup import Setup


@dataclass(frozen=True, eq=False)
class Patch:
    """A box of places, one reach wider than a region, by the index of the first (negative beyond the lower edge) and
    the number along each axis of the lattice; beyond walls its places are those of the halo.
    """

    lattice: Lattice
    reach: tuple[int, ...]
    first: tuple[int, ...]
    shape: tuple[int, ...]
    periodic: frozenset[int]

    @classmethod
    def around(cls, region: np.ndarray, lattice: Lattice, reach: tuple[int, ...], periodic: frozenset[int]) -> Patch:
        """Return the patch of a region, a mask of the lattice's shape that is not empty."""
        places = np.argwhere(region)
        first, last = places.min(0) - reach, places.max(0) + reach
        for axis in periodic:  # all of the axis, so that each bond across it has an end that is no copy
            if first[axis] < 0 or last[axis] >= lattice.shape[axis]:
                first[axis], last[axis] = -reach[axis], lattice.shape[axis] - 1 + reach[axis]
        return cls(lattice, tuple(reach), tuple(map(int, first)), tuple(map(int, last + 1 - first)), periodic)

    @property
    def shape3(self) -> np.ndarray:
        """Places along the three axes of the engine."""
        return np.array((1,) * (3 - len(self.shape)) + self.shape)

    @property
    def places(self) -> int:
        """Number of places."""
        return int(np.prod(self.shape))

    @property
    def _along(self) -> list[np.ndarray]:
        """Index of each place along each axis of the lattice; may lie outside."""
        return [f + np.arange(n) for f, n in zip(self.first, self.shape, strict=True)]

    @cached_property
    def nodes(self) -> np.ndarray:
        """Flat index of the node of the lattice to which each place belongs, shape (places,): itself, the same node
        across a periodic axis, or the one at the edge.
        """
        along = [
            index % n if axis in self.periodic else np.clip(index, 0, n - 1)
            for axis, (index, n) in enumerate(zip(self._along, self.lattice.shape, strict=True))
        ]
        return np.ravel_multi_index(np.ix_(*along), self.lattice.shape).ravel()

    def beyond(self, axis: int, side: int) -> np.ndarray:
        """Mask of the places beyond a side, shape (places,)."""
        index = self._along[axis]
        out = index < 0 if side < 0 else index >= self.lattice.shape[axis]
        column = out.reshape([-1 if a == axis else 1 for a in range(len(self.shape))])
        return np.broadcast_to(column, self.shape).ravel()

    @cached_property
    def own(self) -> np.ndarray:
        """Mask of the places that are nodes of the lattice, shape (places,)."""
        axes = range(len(self.shape))
        return ~np.any([self.beyond(axis, side) for axis in axes for side in (-1, 1)], axis=0)

    @property
    def copies(self) -> np.ndarray:
        """Mask of the places that are copies of nodes across a periodic axis, shape (places,)."""
        halos = [self.beyond(axis, side) for axis in self.periodic for side in (-1, 1)]
        return np.any(halos, axis=0) if halos else np.zeros(self.places, bool)

    def over(self, values: np.ndarray) -> np.ndarray:
        """Return values at the nodes of the lattice (last axes) at the places, as the engine continues the medium."""
        return values.reshape(*values.shape[: values.ndim - self.lattice.dim], -1)[..., self.nodes]

    def onto(self, values: np.ndarray) -> np.ndarray:
        """Return the sums of values at the places (last axis) that belong to each node, of the lattice's shape."""
        flat = values.reshape(-1, self.places)
        rows = [np.bincount(self.nodes, one, int(np.prod(self.lattice.shape))) for one in flat]
        return np.reshape(rows, (*values.shape[:-1], *self.lattice.shape))

    def exists(self, setup: Setup, sides: dict[tuple[int, int], Any]) -> np.ndarray:
        """Return 1 at places where the operator reads a value that is known, 0 elsewhere, shape (places,): beyond sides
        that absorb there is nothing that a region could reach.
        """
        exists = np.ones(self.places)
        if self.lattice.existing is not None and setup.rim == "free":
            exists *= self.over(self.lattice.existing.astype(float))
        for key, side in sides.items():
            if side.held is None and not side.periodic:
                exists[self.beyond(*key)] = 0
        return exists

    def held(self, sides: dict[tuple[int, int], Any], background: float) -> list[tuple[np.ndarray, float]]:
        """Return the places beyond fixed sides, each mask with the value there less the background."""
        walls = [(self.beyond(*key), side.held - background) for key, side in sides.items() if side.held is not None]
        return [wall for wall in walls if wall[0].any()]

    def lost(self, setup: Setup, offsets: np.ndarray) -> np.ndarray:
        """Return the fraction of the bond along each offset that cracks have cut, shape (K, places); (0, 0) if none."""
        if not setup.cracks:
            return np.zeros((0, 0))
        lost = np.zeros((len(offsets), self.places))
        lower = self.lattice.lower + self.lattice.spacing * np.array(self.first)
        for crack in setup.cracks:
            nodes, bonds = cut_bonds(crack.cut, lower, self.lattice.spacing, self.shape, offsets)
            at = bonds, np.ravel_multi_index(tuple(nodes.T), self.shape)
            lost[at] = np.maximum(lost[at], 1 - crack.factor)
        return lost

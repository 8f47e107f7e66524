"""Solid and liquid: tiles that are all liquid, all solid or mixed, and the solid nodes that become liquid.

The coefficient of a node is its phase: 1 in the liquid, minus the factor of interface bonds in the solid (`program.bond_factor`, rule
"phases"). A *tile* is a stretch of `TILE` nodes of up to `TILE_ROWS` neighbouring rows. It knows how many solid nodes
lie in it or within one reach of it: none, and the stencil's plain rows serve; all, and nothing changes there; else bonds are looked
at one by one. A node that becomes liquid is taken off these counts, so that nothing is ever classified anew.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from farhorizon.engine.threads import add

TILE = 16
TILE_ROWS = 8
LIQUID, MIXED, SOLID = 0, 1, 2
#: Step of dissolution of a node that is still solid.
NEVER = np.iinfo(np.int64).max


def count_solid(solid: np.ndarray, reach: tuple[int, ...], sizes: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Solid nodes in each tile and within one reach of it, and all nodes there.

    Parameters
    ----------
    solid : ndarray of bool
        The core with its halo, three axes.
    reach : tuple of int
        Width of the halo along each axis.
    sizes : tuple of int
        Nodes of a tile along each axis, one along the first.

    Returns
    -------
    solids, volumes : ndarray of int64, shape (rows of tiles, tiles in a row)
    """
    solids, volumes = solid.astype(np.int64), np.ones(1, np.int64)
    for axis, (m, size) in enumerate(zip(reach, sizes, strict=True)):
        nodes = solid.shape[axis] - 2 * m
        first = np.arange(0, nodes, size)
        last = np.minimum(first + size, nodes) + 2 * m
        total = np.concatenate([np.zeros_like(np.take(solids, [0], axis)), np.cumsum(solids, axis)], axis)
        solids = np.take(total, last, axis) - np.take(total, first, axis)
        volumes = np.multiply.outer(volumes, last - first)
    parts = (np.swapaxes(counts, 0, 1).reshape(-1, solids.shape[2]) for counts in (solids, volumes.reshape(solids.shape)))
    return next(parts), next(parts)


@njit(error_model="numpy", inline="always")
def phase_of(solid, volume):  # type: ignore[no-untyped-def]
    """Kind of a tile that has so many solid nodes among those in it and around it."""
    return LIQUID if solid == 0 else SOLID if solid == volume else MIXED


@njit(error_model="numpy", cache=True)
def uncount(at, nodes, reach, period, solids):  # type: ignore[no-untyped-def]
    """Take the node at the three coordinates `at`, and its periodic images, off the counts of all tiles around it."""
    word = np.int64(solids.ctypes.data)
    for i0 in range(at[0] - period[0], at[0] + period[0] + 1, max(period[0], 1)):
        for i1 in range(at[1] - period[1], at[1] + period[1] + 1, max(period[1], 1)):
            for i2 in range(at[2] - period[2], at[2] + period[2] + 1, max(period[2], 1)):
                if (
                    -reach[0] <= i0 < nodes[0] + reach[0] and -reach[1] <= i1 < nodes[1] + reach[1] and -reach[2] <= i2 < nodes[2] + reach[2]
                ):  # fmt: skip
                    for t0 in range(max(i0 - reach[0], 0), min(i0 + reach[0], nodes[0] - 1) + 1):
                        for t1 in range(max(i1 - reach[1], 0) // TILE_ROWS, min(i1 + reach[1], nodes[1] - 1) // TILE_ROWS + 1):
                            for t2 in range(max(i2 - reach[2], 0) // TILE, min(i2 + reach[2], nodes[2] - 1) // TILE + 1):
                                add(word + 8 * ((t1 * nodes[0] + t0) * solids.shape[1] + t2), -1)


@njit(error_model="numpy", inline="always")
def any_below(coefficient, u, saturation):  # type: ignore[no-untyped-def]
    """Whether a solid node has a value below the saturation; without branches, for it is asked of every mixed row in every step."""
    found = 0
    for i in range(u.size):
        found += (coefficient[i] <= 0) & (u[i] < saturation)
    return found > 0


@njit(error_model="numpy", cache=True)
def dissolve(lane, lanes, u, coefficient, dissolved, total, step, saturation, block, solids, volumes, reach, period):  # type: ignore[no-untyped-def]
    """Solid nodes of mixed tiles whose value is below `saturation` become liquid; `dissolved` says at which step, `total` how many there were.

    Lanes share the tiles. The counts that they change beside each other concern tiles that hold no such node, or have been looked at.
    """
    nodes = (block[1], block[2], block[3])
    for number in range(lane, solids.shape[0], lanes):
        i0, first = number % nodes[0], (number // nodes[0]) * TILE_ROWS
        for column in range(solids.shape[1]):
            if phase_of(solids[number, column], volumes[number, column]) != MIXED:
                continue
            for i1 in range(first, min(first + TILE_ROWS, nodes[1])):
                row = block[0] + i0 * block[4] + i1 * block[5]
                stretch = slice(row + column * TILE, row + min((column + 1) * TILE, nodes[2]))
                if not any_below(coefficient[stretch], u[stretch], saturation):
                    continue
                for i2 in range(column * TILE, min((column + 1) * TILE, nodes[2])):
                    if coefficient[row + i2] <= 0 and u[row + i2] < saturation:
                        coefficient[row + i2] = 1
                        dissolved[row + i2] = step
                        uncount((i0, i1, i2), nodes, reach, period, solids)
                        add(np.int64(total.ctypes.data), 1)

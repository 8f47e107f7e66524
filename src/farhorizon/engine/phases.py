"""Solid and liquid: tiles that are all liquid, all solid or mixed, and the solid nodes that become liquid.

The coefficient of a node is its phase: 1 in the liquid, minus the factor of interface bonds in the solid
(`bonds.bond_factor`, rule "phases"). A *tile* is a stretch of `TILE` nodes of up to `TILE_ROWS` neighbouring rows,
small, so that few nodes share one with a front. It knows how many solid nodes lie in it or within one reach of it:
none, and the stencil's plain rows serve; all, and nothing changes there; else bonds are looked at one by one. A node
that becomes liquid is taken off these counts. What a step goes through are *runs*, neighbouring tiles of one kind in a
row of tiles; they are found anew in the rows whose counts have changed.
"""

from __future__ import annotations

import numpy as np

from farhorizon.engine.rows.compiled import njit
from farhorizon.engine.rows.vectors import TILE, TILE_ROWS, any_below
from farhorizon.engine.threads import add

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
    parts = (
        np.swapaxes(counts, 0, 1).reshape(-1, solids.shape[2]) for counts in (solids, volumes.reshape(solids.shape))
    )
    return next(parts), next(parts)


@njit(error_model="numpy", inline="always")
def phase_of(solid, volume):
    """Kind of a tile that has so many solid nodes among those in it and around it."""
    return LIQUID if solid == 0 else SOLID if solid == volume else MIXED


@njit(error_model="numpy", cache=True)
def find_runs(lane, lanes, solids, volumes, changed, runs):
    """Runs of the rows of tiles that have `changed`: ``runs[row, i]`` is the kind of a run and the tile after its last;
    one lane's share.
    """
    rows, tiles = solids.shape
    for row in range(lane * rows // lanes, (lane + 1) * rows // lanes):
        if not changed[row]:
            continue
        changed[row], found = False, 0
        for tile in range(tiles):
            runs[row, found, 0], runs[row, found, 1] = phase_of(solids[row, tile], volumes[row, tile]), tile + 1
            if tile + 1 < tiles and phase_of(solids[row, tile + 1], volumes[row, tile + 1]) != runs[row, found, 0]:
                found += 1


@njit(error_model="numpy", cache=True)
def uncount(at, nodes, reach, period, solids, changed):
    """Take the node at the three coordinates `at`, and its periodic images, off the counts of all tiles around it."""
    word = np.int64(solids.ctypes.data)
    for i0 in range(at[0] - period[0], at[0] + period[0] + 1, max(period[0], 1)):
        for i1 in range(at[1] - period[1], at[1] + period[1] + 1, max(period[1], 1)):
            for i2 in range(at[2] - period[2], at[2] + period[2] + 1, max(period[2], 1)):
                if (
                    -reach[0] <= i0 < nodes[0] + reach[0]
                    and -reach[1] <= i1 < nodes[1] + reach[1]
                    and -reach[2] <= i2 < nodes[2] + reach[2]
                ):
                    for t0 in range(max(i0 - reach[0], 0), min(i0 + reach[0], nodes[0] - 1) + 1):
                        for t1 in range(
                            max(i1 - reach[1], 0) // TILE_ROWS, min(i1 + reach[1], nodes[1] - 1) // TILE_ROWS + 1
                        ):
                            changed[t1 * nodes[0] + t0] = True
                            for t2 in range(
                                max(i2 - reach[2], 0) // TILE, min(i2 + reach[2], nodes[2] - 1) // TILE + 1
                            ):
                                add(word + 8 * ((t1 * nodes[0] + t0) * solids.shape[1] + t2), -1)


@njit(error_model="numpy", cache=True)
def dissolve(
    lane, lanes, u, coefficient, dissolved, total, step, block, solids, changed, saturation, period, runs, reach
):
    """Solid nodes of mixed tiles whose value is below `saturation` become liquid; `dissolved` says at which step,
    `total` how many there were.

    Lanes share the rows of tiles; the runs stay as they are meanwhile.
    """
    nodes = (block[1], block[2], block[3])
    limit = u.dtype.type(saturation)
    metal, values = coefficient.ctypes.data, u.ctypes.data
    for number in range(lane, solids.shape[0], lanes):
        i0, first = number % nodes[0], (number // nodes[0]) * TILE_ROWS
        corner = block[0] + i0 * block[4] + first * block[5]
        run, stop = 0, 0
        while stop < nodes[2]:
            start, stop, kind = stop, min(runs[number, run, 1] * TILE, nodes[2]), runs[number, run, 0]
            run += 1
            place, count = (corner + start) * u.itemsize, min(TILE_ROWS, nodes[1] - first)
            if kind != MIXED or not any_below(metal + place, values + place, limit, stop - start, count, block[5]):
                continue
            for i1 in range(first, first + count):
                row = block[0] + i0 * block[4] + i1 * block[5]
                for i2 in range(start, stop):
                    if coefficient[row + i2] <= 0 and u[row + i2] < limit:
                        coefficient[row + i2] = 1
                        dissolved[row + i2] = step
                        uncount((i0, i1, i2), nodes, reach, period, solids, changed)
                        add(np.int64(total.ctypes.data), 1)

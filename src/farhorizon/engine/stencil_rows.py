"""Which blocks can sweep a stencil with compiled rows, and the weights that these are given."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from farhorizon.engine.build import load_rows
from farhorizon.engine.layout import Block
from farhorizon.engine.simd_matrix import parity

_UNROLLED_LIMIT = 1200  # products in straight-line code beyond which compiling takes longer than a run
_ROUNDING = 1e-14  # of the largest weight: mirror images that differ by less are alike

Offset = tuple[int, int, int]


def compiled_rows(blocks: Sequence[Block], offsets: np.ndarray, weights: np.ndarray, real: str, increments: bool) -> tuple[np.ndarray, np.ndarray]:
    """Compiled rows of each block, and the weights they take.

    Parameters
    ----------
    blocks : sequence of Block
    offsets, weights : ndarray, shapes (K, 3) and (K,) or (K, d, d)
    real : {"float64", "float32"}
    increments : bool

    Returns
    -------
    functions : ndarray of int, shape (blocks,)
        Address of the rows, 0 where there are none.
    weights : ndarray, shape (blocks, n)
    """
    table = dict(zip(map(tuple, offsets.tolist()), weights, strict=True))
    shape, rows, fits = _scalar_rows(blocks, table) if weights.ndim == 1 else _matrix_rows(blocks, table)
    functions = np.zeros(len(blocks), np.int64)
    if not fits.any():
        return functions, rows
    if weights.ndim == 1:
        numbers, rows = _weight_classes(rows)
        if len(shape) <= _UNROLLED_LIMIT:
            functions[fits] = load_rows(shape, numbers, real, increments)
    else:
        used = (rows != 0).any(0)
        pattern = tuple(tuple(row) for row in used.reshape(len(shape), -1).tolist())
        if used.sum() <= _UNROLLED_LIMIT:
            functions[fits] = load_rows(shape, (), real, increments, pattern)
    return functions, rows


def _scalar_rows(blocks: Sequence[Block], table: dict[Offset, float]) -> tuple[tuple[Offset, ...], np.ndarray, np.ndarray]:
    """Offsets with the inner one >= 0, their weights in each block, and the blocks that look alike: stencils even along every axis alone."""
    even = all(table.get((a, b, -c)) == w for (a, b, c), w in table.items())
    shape = tuple(sorted(o for o in table if o[2] >= 0)) if even else ()
    rows, fits = np.zeros((len(blocks), len(shape))), np.zeros(len(blocks), bool)
    for number, block in enumerate(blocks if shape else ()):
        physical = [_physical(block, o) for o in shape]
        mirrored: list[Offset] = [tuple(-i if a == block.order[2] else i for a, i in enumerate(o)) for o in physical]  # type: ignore[misc]
        fits[number] = all(o in table and table.get(n) == table[o] for o, n in zip(physical, mirrored, strict=True))
        if fits[number]:
            rows[number] = [table[o] for o in physical]
    return shape, rows, fits


def _matrix_rows(blocks: Sequence[Block], table: dict[Offset, np.ndarray]) -> tuple[tuple[Offset, ...], np.ndarray, np.ndarray]:
    """The same for stencils of matrices that go over into themselves in mirrors: offsets >= 0, the centre with what the others leave it."""
    table = table | {(0, 0, 0): -np.sum(list(table.values()), axis=0)}
    components, largest = len(table[0, 0, 0]), max(float(np.abs(w).max()) for w in table.values())
    lead = 3 - components

    def even(axis: int) -> bool:
        sign = np.array([[1 - 2 * parity(row, column, components)[axis] for column in range(components)] for row in range(components)])
        mirrored = {o: tuple(-i if a == axis else i for a, i in enumerate(o)) for o in table}
        return all(m in table and np.abs(table[m] - sign * table[o]).max() <= _ROUNDING * largest for o, m in mirrored.items())

    alike = all(even(axis) for axis in range(lead, 3))
    shape = tuple(sorted(o for o in table if min(o) >= 0)) if alike else ()
    rows, fits = np.zeros((len(blocks), len(shape) * components**2)), np.zeros(len(blocks), bool)
    for number, block in enumerate(blocks if shape else ()):
        own = [a - lead for a in block.order if a >= lead]
        physical = [_physical(block, o) for o in shape]
        fits[number] = all(o in table for o in physical)
        if fits[number]:
            found = np.array([table[o][np.ix_(own, own)] for o in physical])
            rows[number] = np.where(np.abs(found) > _ROUNDING * largest, found, 0.0).ravel()
    return shape, rows, fits


def _physical(block: Block, offset: Offset) -> Offset:
    """An offset along a block's axes, by axis."""
    x, y, z = (int(offset[block.order.index(a)]) for a in range(3))
    return x, y, z


def _weight_classes(weights: np.ndarray) -> tuple[tuple[int, ...], np.ndarray]:
    """Class of each column of `weights`, numbered by first appearance, and one column a class."""
    _, first, inverse = np.unique(weights, axis=1, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    return tuple(rank[inverse.ravel()].tolist()), np.ascontiguousarray(weights[:, np.sort(first)])

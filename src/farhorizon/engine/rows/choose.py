"""Which stencils are swept with compiled rows, and the weights that these are given."""

from __future__ import annotations

import numpy as np

from farhorizon.engine.rows.build import load_rows
from farhorizon.engine.rows.matrices import parity

UNROLLED_LIMIT = 1200  # products in straight-line code beyond which compiling takes longer than a run
_ROUNDING = 1e-14  # of the largest weight: mirror images that differ by less are alike

Offset = tuple[int, int, int]


def compiled_rows(offsets: np.ndarray, weights: np.ndarray, real: str, increments: bool) -> tuple[int, np.ndarray]:
    """Compiled rows of a stencil, and the weights they take.

    Parameters
    ----------
    offsets, weights : ndarray, shapes (K, 3) and (K,) or (K, d, d)
    real : {"float64", "float32"}
    increments : bool

    Returns
    -------
    function : int
        Address of the rows, 0 where there are none.
    weights : ndarray, shape (n,)
    """
    table = dict(zip(map(tuple, offsets.tolist()), weights, strict=True))
    shape, row = _scalar_row(table) if weights.ndim == 1 else _matrix_row(table)
    if not shape:
        return 0, np.zeros(1)
    if weights.ndim == 1:
        numbers, row = _weight_classes(row)
        return load_rows(shape, numbers, real, increments) if len(shape) <= UNROLLED_LIMIT else 0, row
    used = row.reshape(len(shape), -1) != 0
    pattern = tuple(tuple(r) for r in used.tolist())
    return load_rows(shape, (), real, increments, pattern) if used.sum() <= UNROLLED_LIMIT else 0, row


def _scalar_row(table: dict[Offset, float]) -> tuple[tuple[Offset, ...], np.ndarray]:
    """Offsets with the inner one >= 0, and their weights, of a stencil that looks alike both ways along the inner axis;
    else none.
    """
    even = all(table.get((a, b, -c)) == w for (a, b, c), w in table.items())
    shape = tuple(sorted(o for o in table if o[2] >= 0)) if even else ()
    return shape, np.array([table[o] for o in shape])


def _matrix_row(table: dict[Offset, np.ndarray]) -> tuple[tuple[Offset, ...], np.ndarray]:
    """The same for stencils of matrices that go over into themselves in mirrors: offsets >= 0, the centre with what the
    others leave it.
    """
    table = table | {(0, 0, 0): -np.sum(list(table.values()), axis=0)}
    shape, found = mirrored(table)
    return shape, found.ravel()


def mirrored(table: dict[Offset, np.ndarray]) -> tuple[tuple[Offset, ...], np.ndarray]:
    """Offsets >= 0 and their matrices, shape (n, d, d), of a stencil of matrices that goes over into itself in mirrors;
    else none.
    """
    components, largest = len(next(iter(table.values()))), max(float(np.abs(w).max()) for w in table.values())

    def even(axis: int) -> bool:
        sign = np.array(
            [
                [1 - 2 * parity(row, column, components)[axis] for column in range(components)]
                for row in range(components)
            ]
        )
        mirrored = {o: tuple(-i if a == axis else i for a, i in enumerate(o)) for o in table}
        return all(
            m in table and np.abs(table[m] - sign * table[o]).max() <= _ROUNDING * largest for o, m in mirrored.items()
        )

    shape = tuple(sorted(o for o in table if min(o) >= 0)) if all(even(axis) for axis in range(3)) else ()
    found = np.array([table[o] for o in shape]).reshape(-1, components, components)
    return shape, np.where(np.abs(found) > _ROUNDING * largest, found, 0.0)


def _weight_classes(weights: np.ndarray) -> tuple[tuple[int, ...], np.ndarray]:
    """Class of each weight, numbered by first appearance, and one weight a class."""
    _, first, inverse = np.unique(weights, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    return tuple(rank[inverse.ravel()].tolist()), weights[np.sort(first)]

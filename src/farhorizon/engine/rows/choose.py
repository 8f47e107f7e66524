"""Chooses which stencils are swept by compiled rows, and the weights that these are given."""

from __future__ import annotations

import numpy as np

from farhorizon.engine.rows.build import load_rows
from farhorizon.engine.rows.matrices import MirrorStencil, Signs, parity
from farhorizon.engine.rows.stencil_sweeps import fits_lines

UNROLLED_LIMIT = 1200  # products in straight-line code beyond which compiling takes longer than a run
_ROUNDING = 1e-14  # relative to the largest weight: mirror images that differ by less are equal

Offset = tuple[int, int, int]


def compiled_rows(
    offsets: np.ndarray, weights: np.ndarray, real: str, increments: bool, signs: Signs, reaction: np.ndarray
) -> tuple[int, np.ndarray]:
    """Address of the compiled rows of a stencil, 0 where there are none, and the weights that they take, shape (n,).

    The stencil has offsets of shape (K, 3) and weights of shape (K,) or, for components with these `signs`, (K, d, d);
    `reaction` is a matrix, or empty, which is subtracted from the weight of a node's own value.
    """
    if not weights.any():
        return 0, np.zeros(1)
    table = dict(zip(map(tuple, offsets.tolist()), weights, strict=True))
    if weights.ndim > 1:  # the centre balances the others
        centre = -np.sum(weights, axis=0) - (reaction if reaction.size else 0)
        return _matrix_rows(table | {(0, 0, 0): centre}, signs, signs, "step", real, increments)
    shape, row = _scalar_row(table)
    if not shape:
        return 0, np.zeros(1)
    classes, row = _weight_classes(row)
    if len(shape) > UNROLLED_LIMIT:
        return 0, row
    return load_rows("stencil_rows", shape=shape, classes=classes, real=real, increments=increments)[0], row


def compiled_sums(
    offsets: np.ndarray, weights: np.ndarray, inside: Signs, outside: Signs, form: str, real: str
) -> tuple[int, np.ndarray]:
    """The same for sums from one field to another, with weights of shape (K, rows, columns) and these signs of the
    components; see `matrices.matrix_sweep`.
    """
    table = dict(zip(map(tuple, offsets.tolist()), weights, strict=True))
    return _matrix_rows(table, inside, outside, form, real, False)


def equal_blocks(weights: np.ndarray, count: int) -> bool:
    """Whether matrices, shape (K, rows, columns), consist of `count` equal blocks on their diagonal."""
    rows, columns = (n // count for n in weights.shape[1:])
    if rows * count != weights.shape[1] or columns * count != weights.shape[2]:
        return False
    return np.array_equal(weights, np.kron(np.eye(count), weights[:, :rows, :columns]))


def _matrix_rows(
    table: dict[Offset, np.ndarray], inside: Signs, outside: Signs, form: str, real: str, increments: bool
) -> tuple[int, np.ndarray]:
    shape, matrices = mirrored(table, inside, outside)
    if not shape:
        return 0, np.zeros(1)
    if np.count_nonzero(matrices) > UNROLLED_LIMIT:
        return 0, matrices.ravel()
    stencil, lines = mirror_stencil(shape, matrices, inside, outside), fits_lines(shape, real) and not increments
    return load_rows("matrix_rows", stencil=stencil, real=real, form=form, lines=lines)[0], matrices.ravel()


def mirror_stencil(offsets: tuple[Offset, ...], matrices: np.ndarray, inside: Signs, outside: Signs) -> MirrorStencil:
    """The stencil of some of the offsets and matrices of `mirrored`."""
    pattern = tuple(tuple(row) for row in (matrices.reshape(len(offsets), -1) != 0).tolist())
    return MirrorStencil(offsets, pattern, inside, outside)


def _scalar_row(table: dict[Offset, float]) -> tuple[tuple[Offset, ...], np.ndarray]:
    """Offsets with the inner one >= 0, and their weights, of a stencil that is symmetric along the inner axis; none for
    others.
    """
    even = all(table.get((a, b, -c)) == w for (a, b, c), w in table.items())
    shape = tuple(sorted(o for o in table if o[2] >= 0)) if even else ()
    return shape, np.array([table[o] for o in shape])


def mirrored(table: dict[Offset, np.ndarray], inside: Signs, outside: Signs) -> tuple[tuple[Offset, ...], np.ndarray]:
    """Offsets >= 0 and their matrices, shape (n, rows, columns), of a stencil that is mirror-symmetric for fields whose
    components have these signs; none for others.
    """
    largest = max(float(np.abs(w).max()) for w in table.values())

    def even(axis: int) -> bool:
        sign = np.array([[1 - 2 * parity(row, column)[axis] for column in inside] for row in outside])
        images = {o: tuple(-i if a == axis else i for a, i in enumerate(o)) for o in table}
        return all(
            m in table and np.abs(table[m] - sign * table[o]).max() <= _ROUNDING * largest for o, m in images.items()
        )

    shape = tuple(sorted(o for o in table if min(o) >= 0)) if all(even(axis) for axis in range(3)) else ()
    matrices = np.array([table[o] for o in shape]).reshape(-1, len(outside), len(inside))
    return shape, np.where(np.abs(matrices) > _ROUNDING * largest, matrices, 0.0)


def _weight_classes(weights: np.ndarray) -> tuple[tuple[int, ...], np.ndarray]:
    """Class of each weight, numbered by first appearance, and the weight of each class."""
    _, first, inverse = np.unique(weights, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    return tuple(rank[inverse.ravel()].tolist()), weights[np.sort(first)]

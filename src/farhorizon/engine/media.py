"""Regions where a varying medium is uniform within reach: their rows are swept like those of a uniform medium, with
weights of their own.

With strata, inclusions or a bimetal plate most nodes see a single medium, and their bonds need not be summed one by
one. Which nodes these are does not depend on how the box is divided, so that all processes and threads compute the same
sums.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from farhorizon.engine.bonds import PHASES
from farhorizon.engine.field import Field, block_of
from farhorizon.engine.layout import with_defaults
from farhorizon.engine.rows.choose import compiled_rows
from farhorizon.engine.tables import Media

Piece = tuple[int, int, int, int, int]

#: Smallest gap, in nodes, between runs whose bonds differ at which these are summed separately; shorter gaps are summed
#: with them, and the results discarded.
_APART = 24


def media_of(engine: Field) -> Media:
    """Return the media of an engine whose nodes have coefficients, also in their halo."""
    material, layout = engine.tables.material, engine.layout
    if material.coefficient.size == 1 or material.rule == PHASES or np.ndim(engine.reaction):
        return with_defaults(Media, engine.dtype)
    values, numbers = _uniform(layout.box.all(material.coefficient), layout.reach)
    given = engine.dtype.name, engine.stages.increments, engine.signs, np.zeros((0, 0))
    block = block_of(engine)[1]
    function, row = compiled_rows(engine.offsets, block, *given) if values.size else (0, np.zeros(1))
    if function == 0:
        return with_defaults(Media, engine.dtype)
    mixed = np.zeros(layout.size, np.int8)
    mixed[layout.box.node_indices()[numbers == -1]] = 1
    pieces, ranges, depth = [], [0], engine.tables.sweep.depth
    for first in range(0, layout.box.nodes[1], depth):  # parts of the box in order
        for plane in numbers[:, first : first + depth]:
            pieces += [(first + a, first + b, *rest) for a, b, *rest in _pieces(plane)]
            ranges.append(len(pieces))
    scale = np.array([stage[2] for stage in engine.stages.numbers])
    middle = -float(block.sum()) if block.ndim == 1 and not engine.stages.increments else 0.0
    return Media(
        function=function,
        pieces=np.array(pieces, np.int64),
        ranges=np.array(ranges, np.int64),
        mixed=mixed,
        weights=np.multiply.outer(values[:, None] * scale, row).astype(engine.dtype),
        own=(scale * (values[:, None] - 1) * middle).astype(engine.dtype),
    )


def _uniform(coefficient: np.ndarray, reach: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Find the coefficients that all nodes within reach of a node share, and their number for each node, -1 where they
    differ; for a box with its halo.
    """
    least = most = coefficient
    for axis, m in enumerate(reach):
        inside = tuple(slice(m, n - m) if a == axis else slice(None) for a, n in enumerate(least.shape))
        least = minimum_filter1d(least, 2 * m + 1, axis=axis)[inside]
        most = maximum_filter1d(most, 2 * m + 1, axis=axis)[inside]
    numbers = np.full(least.shape, -1)
    values, numbers[least == most] = np.unique(least[least == most], return_inverse=True)
    return values, numbers


def _pieces(media: np.ndarray) -> Iterator[Piece]:
    """Yield the pieces of some rows of nodes: of all rows together where they are equal, else row by row."""
    alike = np.where((media == media[0]).all(0), media[0], -2)
    for start, stop, medium in _runs(alike):
        if medium >= 0:
            yield 0, len(media), start, stop, medium
        for i, row in enumerate(media[:, start:stop] if medium == -2 else ()):
            yield from ((i, i + 1, start + a, start + b, number) for a, b, number in _runs(row) if number >= 0)
    rows = [(0, len(media), media[0])] if (alike > -2).all() else [(i, i + 1, row) for i, row in enumerate(media)]
    for first, last, row in rows:
        yield from ((first, last, start, stop, -1) for start, stop in _joined(row))


def _runs(row: np.ndarray) -> Iterator[tuple[int, int, int]]:
    """Yield first, last + 1 and value of each run of equal numbers."""
    edges = np.flatnonzero(np.diff(row)) + 1
    for start, stop in zip([0, *edges.tolist()], [*edges.tolist(), len(row)], strict=True):
        yield start, stop, int(row[start])


def _joined(row: np.ndarray) -> list[tuple[int, int]]:
    """Runs of nodes in a row whose bonds differ, as first and last + 1; runs with a short gap between them are
    joined.
    """
    joined: list[tuple[int, int]] = []
    for start, stop, medium in _runs(row):
        if medium == -1:
            near = bool(joined) and start - joined[-1][1] < _APART
            joined[-1 if near else len(joined) :] = [(joined[-1][0] if near else start, stop)]
    return joined

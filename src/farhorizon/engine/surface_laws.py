"""Tables of the law for nodes that lack bonds, row by row, for `farhorizon.engine.point_law`."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from farhorizon.engine.layout import SLACK, Block
from farhorizon.engine.point_law import ALIKE, EACH, LawRows
from farhorizon.engine.surface import in_rows

_LONG = 8  # number of neighbours with one matrix; fewer take one vector, in which each may have its own


def law_rows(block: Block, nodes: np.ndarray, numbers: np.ndarray, matrices: np.ndarray) -> LawRows:
    """Return the tables for places of a block, given the indices of their matrices."""
    ranges, stretches, kinds = in_rows(block, nodes, numbers)
    used, weights = matrices.size, [matrices.ravel()]
    found, firsts = [], [0]
    for place, stop, start in stretches.tolist():
        for first, end in _runs(kinds[start : start + stop - place]):
            entry, count = start + first, end - first
            own = kinds[entry : entry + count]
            if count >= _LONG and (own == own[0]).all():
                place_of = (ALIKE, own[0] * matrices[0].size, 1)
            else:
                place_of = (EACH, used, count)
                weights.append(matrices[own].reshape(count, -1).T.ravel())
                used += weights[-1].size
            found.append((place + first, place + end, *place_of, entry))
        firsts.append(len(found))
    table = np.array(found, np.int64).reshape(-1, 6)
    return LawRows(np.array(firsts)[ranges], table, kinds, np.pad(np.concatenate(weights), (0, SLACK)))


def _runs(kinds: np.ndarray) -> Iterator[tuple[int, int]]:
    """Yield first and last + 1 of long runs of equal numbers, and of what lies between them."""
    begun = first = 0
    for end in np.append(np.flatnonzero(np.diff(kinds)) + 1, len(kinds)).tolist():
        if end - first >= _LONG:
            if begun < first:
                yield begun, first
            yield first, end
            begun = end
        first = end
    if begun < first:
        yield begun, first

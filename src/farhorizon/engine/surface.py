"""Nodes at the surface of a body: which of their bonds lead to places without a node, and the tables of what they
lack, row by row.

A place without a node holds zero. The contribution of such a bond to a sweep is its weight times the node's own value
(subtracted), so that one number per node (for vectors one matrix), the sum of those weights, corrects all of them.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from farhorizon.engine.layout import SLACK, Block, with_defaults
from farhorizon.engine.point_law import ALIKE, EACH, LawRows
from farhorizon.engine.rows.build import load_rows
from farhorizon.engine.tables import Surface

_LONG = 8  # number of neighbours with one matrix; fewer take one vector, in which each may have its own


def bare_bonds(block: Block, offsets: np.ndarray, exists: np.ndarray) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """Find the bonds of a block's nodes of which only one end exists, for offsets (K, 3) and `exists` by place.

    Return the S nodes with such bonds, three indices by axis, and which bonds these are, shape (K, S).
    """
    at = np.nonzero(_reached(block, exists) & _reached(block, ~exists))
    places = block.origin + sum(i * s for i, s in zip(at, block.stride, strict=True))
    bare = np.stack([exists[places] != exists[places + int(offset @ np.array(block.stride))] for offset in offsets])
    lacking = bare.any(0)
    return tuple(i[lacking] for i in at), bare[:, lacking]


def surface_of(block: Block, nodes: np.ndarray, weights: np.ndarray) -> Surface:
    """Return the tables of weights on the nodes' own values, for places of the block and weights of shape (S,), or (S,
    rows, columns).
    """
    if not len(nodes):
        return with_defaults(Surface, weights.dtype)
    rows, columns = weights.shape[1:] or (1, 1)
    entries, real = (tuple(range(columns)),) * rows, weights.dtype.name
    functions = load_rows("map_rows", entries=entries, columns=columns, each=True, added=True, real=real)
    return Surface(*in_rows(block, nodes, weights), *functions)


def in_rows(block: Block, nodes: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return `shared_rows` for some numbers of each of these places."""
    first, second, third = block.coordinates(nodes).T
    order = np.lexsort((third, second, first))
    counts = np.bincount(first * block.nodes[1] + second, minlength=block.nodes[0] * block.nodes[1])
    numbers = weights[order].reshape(len(nodes), int(np.prod(weights.shape[1:])))
    return shared_rows(np.cumsum(np.append(0, counts)), third[order], numbers)


def _reached(block: Block, marked: np.ndarray) -> np.ndarray:
    """Which nodes of a block have a marked place of the box within reach of them."""
    near = block.all(marked)
    for axis, m in enumerate(block.reach):
        near = np.asarray(np.lib.stride_tricks.sliding_window_view(near, 2 * m + 1, axis).any(-1))
    return near


def shared_rows(
    starts: np.ndarray, places: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Arrange weights, shape (N, n), on nodes of rows in stretches of neighbours; equal rows share theirs, so that
    these stay in the cache. `starts` are the first entries of the R rows and the end, `places` positions along them.

    Return for each row its first stretch and last + 1; for each stretch its first node, last + 1, and the index of its
    first entry of the weights; and these: for each stretch the first number of all its nodes, then the second, and so
    on, padded by as many entries as a vector may read beyond the last.
    """
    known: dict[bytes, int] = {}
    kept: list[np.ndarray] = []
    rows = np.zeros(len(starts) - 1, np.int64)
    for row, (first, last) in enumerate(itertools.pairwise(starts.tolist())):
        key = places[first:last].tobytes() + weights[first:last].tobytes()
        rows[row] = known.setdefault(key, len(known))
        if rows[row] == len(kept):
            kept.append(np.arange(first, last))
    entries = np.concatenate([np.zeros(0, np.int64), *kept])
    owner = np.repeat(np.arange(len(kept)), [len(k) for k in kept])
    places, end = places[entries], len(entries)
    begins = np.flatnonzero((np.diff(places, prepend=-1) != 1) | (np.diff(owner, prepend=-1) != 0))
    lengths, numbers = np.diff(begins, append=end), weights.shape[1]
    stretches = np.stack([places[begins], places[begins] + lengths, numbers * begins], axis=1)
    ranges = np.searchsorted(owner[begins], np.stack([rows, rows + 1], axis=1))
    # positions of the numbers of each entry: after those of earlier stretches, one number of a stretch after another
    stretch_of = np.repeat(np.arange(len(begins)), lengths)
    at = (numbers - 1) * begins[stretch_of] + np.arange(end)
    arranged = np.zeros(numbers * end + SLACK, weights.dtype)
    for number in range(numbers):
        arranged[at + number * lengths[stretch_of]] = weights[entries, number]
    return ranges, stretches, arranged


def law_rows(block: Block, nodes: np.ndarray, numbers: np.ndarray, matrices: np.ndarray) -> LawRows:
    """Return the law's tables for places of a block that lack bonds, given the indices of their matrices."""
    ranges, stretches, kinds = in_rows(block, nodes, numbers)
    used, weights = matrices.size, [matrices.ravel()]
    parts, firsts = [], [0]
    for place, stop, start in stretches.tolist():
        for first, end in _runs(kinds[start : start + stop - place]):
            entry, count = start + first, end - first
            of_part = kinds[entry : entry + count]
            if count >= _LONG and (of_part == of_part[0]).all():
                place_of = (ALIKE, of_part[0] * matrices[0].size, 1)
            else:
                place_of = (EACH, used, count)
                weights.append(matrices[of_part].reshape(count, -1).T.ravel())
                used += weights[-1].size
            parts.append((place + first, place + end, *place_of, entry))
        firsts.append(len(parts))
    table = np.array(parts, np.int64).reshape(-1, 6)
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

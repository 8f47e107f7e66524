"""Nodes at the surface of a body: which of their bonds lead to places without a node.

A place without a node holds zero. The contribution of such a bond to a sweep is its weight times the node's own value
(subtracted), so that one number per node (for vectors one matrix), the sum of those weights, corrects all of them.
"""

from __future__ import annotations

import itertools

import numpy as np

from farhorizon.engine.layout import SLACK, Block
from farhorizon.engine.rows.build import load_rows
from farhorizon.engine.tables import Surface


def bare_bonds(block: Block, offsets: np.ndarray, exists: np.ndarray) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """Find the bonds of the nodes of a block of which only one end exists.

    Parameters
    ----------
    block : Block
    offsets : ndarray of int, shape (K, 3)
    exists : ndarray of bool, shape (places,)
        Where nodes exist.

    Returns
    -------
    at : tuple of three ndarrays of int, shape (S,)
        Nodes with such bonds, by axis.
    bare : ndarray of bool, shape (K, S)
        Which bonds these are.
    """
    at = np.nonzero(_reached(block, exists) & _reached(block, ~exists))
    flat = block.origin + sum(i * s for i, s in zip(at, block.stride, strict=True))
    bare = np.stack([exists[flat] != exists[flat + int(offset @ np.array(block.stride))] for offset in offsets])
    found = bare.any(0)
    return tuple(i[found] for i in at), bare[:, found]


def no_surface(dtype: np.dtype) -> Surface:
    """Return the tables of a block that has all its bonds."""
    return Surface(np.zeros((0, 2), np.int64), np.zeros((0, 3), np.int64), np.zeros(0, dtype), 0)


def surface_of(block: Block, nodes: np.ndarray, weights: np.ndarray) -> Surface:
    """Return the tables of weights on the nodes' own values, for places of the block and weights of shape (S,), or (S,
    rows, columns).
    """
    if not len(nodes):
        return no_surface(weights.dtype)
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


def _reached(block: Block, there: np.ndarray) -> np.ndarray:
    """Which nodes of a block have a place that is `there` in the box within reach of them."""
    found = block.all(there)
    for axis, m in enumerate(block.reach):
        found = np.asarray(np.lib.stride_tricks.sliding_window_view(found, 2 * m + 1, axis).any(-1))
    return found


def shared_rows(
    starts: np.ndarray, places: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Arrange weights on nodes of rows in stretches of neighbours; equal rows share theirs, so that these stay in the
    cache.

    Parameters
    ----------
    starts : ndarray of int, shape (R + 1,)
        First entry of each row.
    places : ndarray of int, shape (N,)
        Positions of the nodes along their row.
    weights : ndarray, shape (N, n)

    Returns
    -------
    ranges : ndarray of int, shape (R, 2)
        First stretch of each row, and last + 1.
    stretches : ndarray of int, shape (T, 3)
        First node, last + 1, and the index of its first entry of `weights`.
    weights : ndarray
        For each stretch the first number of all its nodes, then the second, and so on; padded by as many entries as a
        vector may read beyond the last.
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
    own = np.repeat(np.arange(len(begins)), lengths)
    at = (numbers - 1) * begins[own] + np.arange(end)
    found = np.zeros(numbers * end + SLACK, weights.dtype)
    for number in range(numbers):
        found[at + number * lengths[own]] = weights[entries, number]
    return ranges, stretches, found

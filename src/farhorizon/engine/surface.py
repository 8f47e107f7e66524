"""Nodes at the edge of a body: which of their bonds lead to places where there is no node.

A place without a node holds zero. What a sweep takes along such a bond is its weight times the node's own value, so
that one number a node (of vectors a matrix), the sum of those weights, takes all of them back.
"""

from __future__ import annotations

import itertools

import numpy as np

from farhorizon.engine.layout import SLACK, Block
from farhorizon.engine.tables import Surface


def bare_bonds(block: Block, offsets: np.ndarray, exists: np.ndarray) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """Bonds of the nodes of a block of which one end alone is there.

    Parameters
    ----------
    block : Block
    offsets : ndarray of int, shape (K, 3)
    exists : ndarray of bool, shape (places,)
        Where nodes are.

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


def surface_of(block: Block, nodes: np.ndarray, weights: np.ndarray) -> Surface:
    """Tables of the weights on the nodes' own values, for places of the block and weights of shape (S,), or (S, rows,
    columns).
    """
    first, second, third = block.coordinates(nodes).T
    order = np.lexsort((third, second, first))
    counts = np.bincount(first * block.nodes[1] + second, minlength=block.nodes[0] * block.nodes[1])
    matrices = weights[order].reshape(len(nodes), int(np.prod(weights.shape[1:])))
    return Surface(*shared_rows(np.cumsum(np.append(0, counts)), third[order], matrices))


def _reached(block: Block, there: np.ndarray) -> np.ndarray:
    """Nodes of a block in whose box of one reach a place is `there`."""
    found = block.all(there)
    for axis, m in enumerate(block.reach):
        found = np.asarray(np.lib.stride_tricks.sliding_window_view(found, 2 * m + 1, axis).any(-1))
    return found


def shared_rows(
    starts: np.ndarray, places: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights on nodes of rows as stretches of neighbours; rows that are alike share theirs, which stay in the cache.

    Parameters
    ----------
    starts : ndarray of int, shape (R + 1,)
        First entry of each row.
    places : ndarray of int, shape (N,)
        Of the nodes along their row.
    weights : ndarray, shape (N, n)

    Returns
    -------
    ranges : ndarray of int, shape (R, 2)
        First stretch of each row, and the one after its last.
    stretches : ndarray of int, shape (T, 3)
        Place of the first node, that after the last, and what is to be added to a place for its entry of `weights`.
    weights : ndarray, shape (n, M)
        With as many entries more as a vector may read beyond the last.
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
    ends = np.append(begins[1:], end)[: len(begins)]
    stretches = np.stack([places[begins], places[begins] + ends - begins, begins - places[begins]], axis=1)
    ranges = np.searchsorted(owner[begins], np.stack([rows, rows + 1], axis=1))
    return ranges, stretches, np.ascontiguousarray(np.pad(weights[entries], ((0, SLACK), (0, 0))).T)

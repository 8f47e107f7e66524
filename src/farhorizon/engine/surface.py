"""Nodes at the edge of a body: which of their bonds lead to places where there is no node.

A place without a node holds zero. What a sweep takes along such a bond is its weight times the node's own value, so
that one number a node (of vectors a matrix), the sum of those weights, takes all of them back.
"""

from __future__ import annotations

import itertools

import numpy as np

from farhorizon.engine.layout import SLACK, Block
from farhorizon.engine.rows.build import load_map
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


def no_surface(dtype: np.dtype) -> Surface:
    """Tables of a block all of whose bonds are there."""
    return Surface(np.zeros((0, 2), np.int64), np.zeros((0, 3), np.int64), np.zeros(0, dtype), 0)


def surface_of(block: Block, nodes: np.ndarray, weights: np.ndarray) -> Surface:
    """Tables of the weights on the nodes' own values, for places of the block and weights of shape (S,), or (S, rows,
    columns).
    """
    if not len(nodes):
        return no_surface(weights.dtype)
    rows, columns = weights.shape[1:] or (1, 1)
    function = load_map((tuple(range(columns)),) * rows, columns, True, True, weights.dtype.name)
    return Surface(*in_rows(block, nodes, weights), function)


def in_rows(block: Block, nodes: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`shared_rows` of some numbers of each of these places."""
    first, second, third = block.coordinates(nodes).T
    order = np.lexsort((third, second, first))
    counts = np.bincount(first * block.nodes[1] + second, minlength=block.nodes[0] * block.nodes[1])
    numbers = weights[order].reshape(len(nodes), int(np.prod(weights.shape[1:])))
    return shared_rows(np.cumsum(np.append(0, counts)), third[order], numbers)


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
        Place of the first node, that after the last, and the first of its entries of `weights`.
    weights : ndarray
        Of each stretch the first number of all its nodes, then the second; with as many entries more as a vector may
        read beyond the last.
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
    # where the numbers of each entry are to be: behind those of earlier stretches, one after another of its own
    own = np.repeat(np.arange(len(begins)), lengths)
    at = (numbers - 1) * begins[own] + np.arange(end)
    found = np.zeros(numbers * end + SLACK, weights.dtype)
    for number in range(numbers):
        found[at + number * lengths[own]] = weights[entries, number]
    return ranges, stretches, found

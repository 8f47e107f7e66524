"""The fringe along an outline in the compiled loop: halo nodes whose values are sums over near nodes at this and at
earlier steps.

The fringe's earlier values lie node by node, the present one first. Nodes that are neighbours along the fastest axis
are neighbours there, too, so a sum over a cloud of nodes at two or three steps is one over a few *windows*, stretches
of `WINDOW` values from any place on. Sums over equally many windows are taken in bundles.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from farhorizon.engine.layout import aligned_zeros
from farhorizon.engine.rows.compiled import njit
from farhorizon.engine.rows.vectors import BUNDLE, WINDOW, clear, move_up, window_sums
from farhorizon.engine.threads import barrier, share


class Fringe(NamedTuple):
    """Halo nodes along an outline, and what they are sums of.

    Attributes
    ----------
    nodes : ndarray of unsigned int, shape (S,)
        Nodes of the fringe in a level: all that any sum reads, and those with sums.
    history : ndarray, shape (S, L)
        Their values one step ago (first), two and so on; moved on by one step, after which the present ones come first.
    outside : ndarray of int, shape (N, 2)
        First and last + 1 of neighbouring nodes beyond the halo, which stay at zero.
    fronts, owners, starts, places, kinds, table, new_starts, new_nodes, new_weights : ndarray
        The sums, see `split_sums`. Those of one front read new values of earlier fronts only.
    """

    nodes: np.ndarray
    history: np.ndarray
    outside: np.ndarray
    fronts: np.ndarray
    owners: np.ndarray
    starts: np.ndarray
    places: np.ndarray
    kinds: np.ndarray
    table: np.ndarray
    new_starts: np.ndarray
    new_nodes: np.ndarray
    new_weights: np.ndarray


def fringe_table(
    nodes: np.ndarray,
    levels: int,
    fronts: np.ndarray,
    rows: np.ndarray,
    starts: np.ndarray,
    columns: np.ndarray,
    weights: np.ndarray,
    outside: np.ndarray,
) -> Fringe:
    """Halo nodes along an outline that are sums over a fringe of `nodes`, as `split_sums` has it, and places `outside`
    that stay at zero.

    `rows` are the places of the halo nodes in a level. The history is zero; a step forgets its last row.
    """
    count = nodes.size * (levels - 1)
    # the last windows reach beyond it
    history = aligned_zeros(count + WINDOW, np.dtype(float))[:count].reshape(nodes.size, levels - 1)
    edges = np.flatnonzero(np.diff(np.sort(outside), prepend=-2, append=-2) != 1)
    runs = (
        np.stack([np.sort(outside)[edges[:-1]], np.sort(outside)[edges[1:] - 1] + 1], axis=1)
        if outside.size
        else np.zeros((0, 2))
    )
    sums = split_sums(fronts, rows, starts, columns, np.asarray(weights, float), nodes, levels)
    return Fringe(nodes.astype(np.uint32), history, runs.astype(np.int64), *sums)


def no_fringe() -> Fringe:
    """None: nothing closes along an outline."""
    none, one = np.zeros(0, np.int64), np.zeros(1, np.int64)
    return fringe_table(none, 1, one, none, one, none, np.zeros(0), none)


def split_sums(
    fronts: np.ndarray,
    rows: np.ndarray,
    starts: np.ndarray,
    columns: np.ndarray,
    weights: np.ndarray,
    nodes: np.ndarray,
    levels: int,
) -> tuple[np.ndarray, ...]:
    """Sums over values at several steps in the form that the compiled loop wants: bundles of sums over windows, and new
    values apart.

    Parameters
    ----------
    fronts : ndarray of int, shape (F + 1,)
        Rows of each front.
    rows : ndarray of int, shape (R,)
        Place in the fringe of the node that a sum is for.
    starts, columns, weights : ndarray
        Compressed rows; column ``level * S + place`` is the value of a place of the fringe `level` steps before the new
        one.
    nodes : ndarray of int, shape (S,)
        Nodes of the fringe in a level.
    levels : int

    Returns
    -------
    fronts : ndarray of int, shape (F + 1,)
        Bundles of each front.
    owners : ndarray of unsigned int, shape (B, BUNDLE)
        Node in a level that each sum of a bundle is for; the last one is repeated where sums are missing.
    starts, places : ndarray of unsigned int
        Compressed bundles: where the windows lie in the memory, in bytes, those of the sums side by side.
    kinds : ndarray of unsigned int, shape (B, BUNDLE)
        First of a sum's windows in `table`: sums that are alike share them, which keeps them in the cache.
    table : ndarray, shape (T, WINDOW)
        Weights.
    new_starts, new_nodes : ndarray of unsigned int
        Compressed sums, one after the other: nodes whose value at the new step counts.
    new_weights : ndarray
    """
    owner = np.repeat(np.arange(len(rows)), np.diff(starts))
    level, place = np.divmod(columns.astype(np.int64), max(nodes.size, 1))
    known = level > 0
    first, windows, table = _windows(
        owner[known], place[known] * (levels - 1) + level[known] - 1, weights[known], len(rows)
    )
    new_first = np.searchsorted(owner[~known], np.arange(len(rows) + 1))
    kinds, table = _shared_rows(first, table)
    bundles, ends = _bundled(fronts, np.diff(first))
    sums, places = bundles.ravel(), _gathered(first, bundles)
    fresh = _gathered(new_first, sums[:, None])[:, 0]
    unsigned = (
        nodes[rows[bundles]],
        _starts(np.diff(first)[bundles[:, 0]]),
        8 * windows[places],
        kinds[bundles],
        _starts(np.diff(new_first)[sums]),
        nodes[place[~known]][fresh],
    )
    owners, starts, places, kinds, new_starts, new_nodes = (a.astype(np.uint32) for a in unsigned)
    return ends, owners, starts, places, kinds, table, new_starts, new_nodes, weights[~known][fresh]


def _windows(
    owner: np.ndarray, columns: np.ndarray, weights: np.ndarray, rows: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compressed rows of windows that hold all columns: where the rows start, the first column of each window, and the
    weights, shape (W, WINDOW).
    """
    order = np.lexsort((columns, owner))
    owner, columns, weights = owner[order], columns[order], weights[order]
    opens, row, begin = np.zeros(len(owner), bool), -1, 0
    for i, (r, column) in enumerate(zip(owner.tolist(), columns.tolist(), strict=True)):
        if r != row or column >= begin + WINDOW:
            opens[i], row, begin = True, r, column
    number = np.cumsum(opens) - 1
    table = np.zeros((int(opens.sum()), WINDOW))
    np.add.at(table, (number, columns - columns[opens][number]), weights)
    return np.searchsorted(owner[opens], np.arange(rows + 1)), columns[opens], table


def _shared_rows(starts: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First value of each compressed row in a list where equal rows stand once, and that list."""
    places: dict[bytes, int] = {}
    pieces: list[np.ndarray] = [values[:0]]
    kinds, end = np.zeros(len(starts) - 1, np.int64), 0
    for row, (start, stop) in enumerate(itertools.pairwise(starts)):
        piece = values[start:stop]
        key = piece.tobytes()
        if key not in places:
            places[key] = end
            pieces.append(piece)
            end += len(piece)
        kinds[row] = places[key]
    return kinds, np.concatenate(pieces)


def _bundled(fronts: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows of one front and of as many windows in bundles, shape (B, BUNDLE), and the bundles of each front."""
    bundles, ends = [np.zeros((0, BUNDLE), int)], [0]
    for first, last in itertools.pairwise(fronts):
        for count in np.unique(counts[first:last]):
            rows = first + np.flatnonzero(counts[first:last] == count)
            bundles.append(np.pad(rows, (0, -len(rows) % BUNDLE), mode="edge").reshape(-1, BUNDLE))
        ends.append(sum(map(len, bundles)))
    return np.concatenate(bundles), np.array(ends)


def _starts(counts: np.ndarray) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(counts)])


def _gathered(starts: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Entries of compressed rows, those of rows that stand side by side (B, n) side by side, shape (entries, n)."""
    counts = np.diff(starts)[rows[:, 0]]
    within = np.arange(counts.sum()) - np.repeat(_starts(counts)[:-1], counts)
    return np.asarray(np.repeat(starts[rows], counts, axis=0) + within[:, None])


@njit(error_model="numpy", cache=True, entry=False)
def close_fringe(thread, stage, fringe):
    """Give the halo nodes of a step's new level their values; one thread's share."""
    nodes, history, src, base, out = fringe.nodes, fringe.history, stage.src, stage.base, stage.out
    first, last = share(thread, nodes.size)
    present, read = history[first:last, 0], nodes[first:last]
    # all at once: the last value of a place makes room for the present one of the next
    if last > first and history.shape[1] > 1:
        move_up(present.ctypes.data, (last - first) * history.shape[1] - 1)
    for i in range(last - first):
        present[i] = src[read[i]]
    first, last = share(thread, len(fringe.outside))
    for run in range(first, last):
        start, count = fringe.outside[run, 0], fringe.outside[run, 1] - fringe.outside[run, 0]
        clear(out.ctypes.data + start * out.itemsize, count, out[0])
        if stage.increments:
            clear(base.ctypes.data + start * out.itemsize, count, out[0])
    barrier(thread)
    owners, starts, kinds = fringe.owners, fringe.starts, fringe.kinds
    new_starts, new_nodes, new_weights = fringe.new_starts, fringe.new_nodes, fringe.new_weights
    memory, totals, width = history.ctypes.data, np.empty(BUNDLE), 8 * WINDOW
    first_place, first_weight, sums = fringe.places.ctypes.data, fringe.table.ctypes.data, totals.ctypes.data
    for front in range(fringe.fronts.size - 1):
        begin = fringe.fronts[front]
        first, last = share(thread, fringe.fronts[front + 1] - begin)
        for bundle in range(begin + first, begin + last):
            start, stop = np.int64(starts[bundle]), np.int64(starts[bundle + 1])
            window_sums(
                sums,
                stop - start,
                first_place + 4 * BUNDLE * start,
                memory,
                first_weight + width * np.int64(kinds[bundle, 0]),
                first_weight + width * np.int64(kinds[bundle, 1]),
                first_weight + width * np.int64(kinds[bundle, 2]),
                first_weight + width * np.int64(kinds[bundle, 3]),
            )
            if new_weights.size:
                for i in range(BUNDLE):
                    for k in range(new_starts[BUNDLE * bundle + i], new_starts[BUNDLE * bundle + i + 1]):
                        totals[i] += new_weights[k] * out[new_nodes[k]]
            for i in range(BUNDLE):
                out[owners[bundle, i]] = totals[i]
            if stage.increments:
                for i in range(BUNDLE):
                    node = owners[bundle, i]
                    base[node] = out[node] - src[node]
        barrier(thread)

"""Fringe along an outline in the compiled loop: halo nodes whose values are sums over values of nearby nodes in this
step and in earlier ones.

The fringe stores its earlier values node by node, the present one first. Neighbours along the fastest axis are also
neighbours there, so a sum over a cloud of nodes at two or three steps becomes a sum over a few *windows*, runs of
`WINDOW` values that may begin anywhere. Sums over the same number of windows are computed in bundles.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.codegen.vector_operations import BUNDLE, WINDOW, clear, move_up, window_sums
from farhorizon.engine.feature import AFTER, Feature, Step
from farhorizon.engine.layout import aligned_zeros, doubles, ints
from farhorizon.engine.passes import reads
from farhorizon.engine.threads import barrier, chunk_of


class OutlineStencil(NamedTuple):
    """Halo nodes along an outline, and the sums that yield their values: fronts of bundles, each with `BUNDLE` sums
    over the same number of windows. Those of a front read only those new values that belong to earlier fronts.
    """

    # Places in a level of the S nodes of the fringe: all that any sum reads, and those whose values are sums.
    nodes: np.ndarray = ints(0, bits="uint32")
    # Values one step ago (first), two steps ago and so on, shape (S, L); a step shifts them by one and puts the present
    # values first.
    history: np.ndarray = doubles(0, 0)
    outside: np.ndarray = ints(0, 2)  # first and last + 1 of runs of nodes beyond the halo, which stay at zero
    fronts: np.ndarray = ints(1)  # bundles of each front, shape (F + 1,)
    # Place in a level of the node to which each sum of a bundle belongs; the last one is repeated to fill the bundle.
    owners: np.ndarray = ints(0, BUNDLE, bits="uint32")
    # Compressed bundles: positions of the windows in the history, in bytes, side by side for the sums of a bundle.
    starts: np.ndarray = ints(1, bits="uint32")
    places: np.ndarray = ints(0, BUNDLE, bits="uint32")
    # First window of a sum in `table`, the weights: equal sums share them, which keeps them in the cache.
    kinds: np.ndarray = ints(0, BUNDLE, bits="uint32")
    table: np.ndarray = doubles(0, WINDOW)
    # Compressed sums, one after the other: nodes whose value at the new step enters, and their weights.
    new_starts: np.ndarray = ints(1, bits="uint32")
    new_nodes: np.ndarray = ints(0, bits="uint32")
    new_weights: np.ndarray = doubles(0)


class FringeSums(NamedTuple):
    """Sums over values of a fringe of S nodes at several steps, which yield those of some of its nodes."""

    fronts: np.ndarray  # rows of each front, shape (F + 1,)
    rows: np.ndarray  # position in the fringe of the node to which a sum belongs, shape (R,)
    # Compressed rows; column ``level * S + place`` is the value at a position in the fringe `level` steps before the
    # new one.
    starts: np.ndarray
    columns: np.ndarray
    weights: np.ndarray


def outline_table(nodes: np.ndarray, levels: int, sums: FringeSums, outside: np.ndarray) -> OutlineStencil:
    """Return the tables of halo nodes along an outline that are sums over a fringe of `nodes`, and of places `outside`
    that stay at zero. The history of so many levels, less the present one, is zero.
    """
    count = nodes.size * (levels - 1)
    # the last windows extend beyond it
    history = aligned_zeros(count + WINDOW, np.dtype(float))[:count].reshape(nodes.size, levels - 1)
    edges = np.flatnonzero(np.diff(np.sort(outside), prepend=-2, append=-2) != 1)
    runs = (
        np.stack([np.sort(outside)[edges[:-1]], np.sort(outside)[edges[1:] - 1] + 1], axis=1)
        if outside.size
        else np.zeros((0, 2))
    )
    stencil = OutlineStencil(nodes=nodes.astype(np.uint32), history=history, outside=runs.astype(np.int64))
    return stencil._replace(**_bundles(sums, nodes, levels))


def _bundles(sums: FringeSums, nodes: np.ndarray, levels: int) -> dict[str, np.ndarray]:
    """Convert sums to what the compiled loop needs: bundles of sums over windows, and new values separately."""
    fronts, rows, starts, columns, weights = sums
    weights = np.asarray(weights, float)
    owner = np.repeat(np.arange(len(rows)), np.diff(starts))
    level, place = np.divmod(columns.astype(np.int64), max(nodes.size, 1))
    known = level > 0
    first, windows, table = _windows(
        owner[known], place[known] * (levels - 1) + level[known] - 1, weights[known], len(rows)
    )
    new_first = np.searchsorted(owner[~known], np.arange(len(rows) + 1))
    kinds, table = _shared_rows(first, table)
    bundles, ends = _bundled(fronts, np.diff(first))
    in_order, places = bundles.ravel(), _gathered(first, bundles)
    new_entries = _gathered(new_first, in_order[:, None])[:, 0]
    unsigned = {
        "owners": nodes[rows[bundles]],
        "starts": _starts(np.diff(first)[bundles[:, 0]]),
        "places": 8 * windows[places],
        "kinds": kinds[bundles],
        "new_starts": _starts(np.diff(new_first)[in_order]),
        "new_nodes": nodes[place[~known]][new_entries],
    }
    return {name: values.astype(np.uint32) for name, values in unsigned.items()} | {
        "fronts": ends,
        "table": table,
        "new_weights": weights[~known][new_entries],
    }


def _windows(
    owner: np.ndarray, columns: np.ndarray, weights: np.ndarray, rows: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cover the columns of compressed rows by windows: where the rows start, the first column of each window, and its
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
    """Index of the first value of each compressed row in a list that contains equal rows once, and that list."""
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
    """Bundles of rows that belong to one front and have the same number of windows, shape (B, BUNDLE), and the bundles
    of each front.
    """
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
    """Indices of the entries of compressed rows, for n rows side by side given as (B, n); shape (entries, n)."""
    counts = np.diff(starts)[rows[:, 0]]
    within = np.arange(counts.sum()) - np.repeat(_starts(counts)[:-1], counts)
    return np.asarray(np.repeat(starts[rows], counts, axis=0) + within[:, None])


@njit(error_model="numpy", cache=True, entry=False)
def fill_outline(thread, stage, stencil):
    """Set the values of the halo nodes in the new level of a step; one thread's share."""
    nodes, history, src, base, out = stencil.nodes, stencil.history, stage.src, stage.base, stage.out
    first, last = chunk_of(thread, nodes.size)
    present, read = history[first:last, 0], nodes[first:last]
    # all at once: the last value of a node makes room for the present one of the next node
    if last > first and history.shape[1] > 1:
        move_up(present.ctypes.data, (last - first) * history.shape[1] - 1)
    for i in range(last - first):
        present[i] = src[read[i]]
    first, last = chunk_of(thread, len(stencil.outside))
    for run in range(first, last):
        start, count = stencil.outside[run, 0], stencil.outside[run, 1] - stencil.outside[run, 0]
        clear(out.ctypes.data + start * out.itemsize, count, out[0])
        if stage.increments:
            clear(base.ctypes.data + start * out.itemsize, count, out[0])
    barrier(thread)
    owners, starts, kinds = stencil.owners, stencil.starts, stencil.kinds
    new_starts, new_nodes, new_weights = stencil.new_starts, stencil.new_nodes, stencil.new_weights
    memory, totals, width = history.ctypes.data, np.empty(BUNDLE), 8 * WINDOW
    first_place, first_weight, sums = stencil.places.ctypes.data, stencil.table.ctypes.data, totals.ctypes.data
    for front in range(stencil.fronts.size - 1):
        begin = stencil.fronts[front]
        first, last = chunk_of(thread, stencil.fronts[front + 1] - begin)
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


@reads("outline_stencil")
def fill_halo_of_outline(thread, stage, sums, tables, inputs, step, number):
    """Fill the halo along an outline."""
    fill_outline(thread, stage, tables.outline_stencil)


OUTLINE = Feature(
    "outline_stencil",
    [Step(AFTER, fill_halo_of_outline, lambda tables, *_: tables.outline_stencil.nodes.size)],
    table=OutlineStencil,
    map=lambda stencil: stencil._replace(history=stencil.history[:0]),
    other=lambda stencil: {"fringe": stencil.history.T},
)

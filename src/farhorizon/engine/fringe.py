"""The fringe along an outline in the compiled loop: halo nodes whose values are sums over near nodes at this and at earlier steps."""

from numba import njit

from farhorizon.engine.threads import barrier

_ANY_ORDER = {"reassoc", "contract", "nsz"}  # sums may be taken in vectors


@njit(error_model="numpy", fastmath=_ANY_ORDER, cache=True)
def combination(columns, weights, values):
    """Sum of some values with weights."""
    total = 0.0
    for k in range(columns.size):
        total += weights[k] * values[columns[k]]
    return total


@njit(error_model="numpy", cache=True)
def close_fringe(lane, lanes, sync, src, base, out, increments, nodes, history, fronts, rows, starts, columns, kinds, weights, outside):
    """Give the halo nodes of a step's new level `out` their values; one lane's share.

    Parameters
    ----------
    lane, lanes, sync
        Threads that share the work, and where they meet.
    src, base, out : ndarray
        Levels of the stage.
    increments : bool
    nodes : ndarray of int, shape (S,)
        Nodes of the fringe in a level: all that any sum reads, and those with sums.
    history : ndarray, shape (L, S)
        Their values at the new step (first row), at the present one and before; moved on by one step.
    fronts : ndarray of int, shape (F + 1,)
        Rows of one front, fronts[f] to fronts[f + 1], read new values of earlier fronts only.
    rows : ndarray of int, shape (R,)
        Place in the fringe of the node that a sum is for.
    starts, columns : ndarray of int
        Sums over places in `history`, as compressed rows; columns without sign, which saves looking for negative ones.
    kinds : ndarray of int, shape (R,)
        First of a row's weights in `weights`: rows that are alike share them, which keeps them in the cache.
    weights : ndarray
    outside : ndarray of int, shape (N, 2)
        First and last + 1 of neighbouring nodes beyond the halo, which stay at zero.
    """
    levels, size = history.shape
    first, last = lane * size // lanes, (lane + 1) * size // lanes
    for level in range(levels - 1, 0, -1):
        for i in range(first, last):
            history[level, i] = history[level - 1, i]
    for i in range(first, last):
        history[0, i] = out[nodes[i]]
    for i in range(lane, outside.shape[0], lanes):
        out[outside[i, 0] : outside[i, 1]] = 0
        if increments:
            base[outside[i, 0] : outside[i, 1]] = 0
    barrier(sync, lanes)
    values = history.ravel()
    for front in range(fronts.size - 1):
        for row in range(fronts[front] + lane, fronts[front + 1], lanes):
            place = rows[row]
            node = nodes[place]
            total = combination(columns[starts[row] : starts[row + 1]], weights[kinds[row] :], values)
            history[0, place] = total
            out[node] = total
            if increments:
                base[node] = out[node] - src[node]
        barrier(sync, lanes)

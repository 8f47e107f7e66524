"""Drag that moves velocities towards the mean of their neighbours, in the compiled loop (Wildman and Gazonas 2012, eq.
3-4)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from farhorizon.engine.rows.compiled import njit
from farhorizon.engine.threads import barrier, share


class Drag(NamedTuple):
    """The drag of nodes, and what it takes.

    Attributes
    ----------
    rate : ndarray, shape (1,), or empty
        By which part of what is between them an increment moves towards the mean of those of its neighbours in a step.
    distances : ndarray of int, shape (K,)
    alive, full : ndarray of uint64, shapes (words, places) and (words,)
        Bits of the bonds that are there, and of all bonds.
    first, end : ndarray of int, shape (3,)
        Box of the nodes whose loss is added up.
    lost : ndarray, shape (planes, rows)
        What these have lost, over the mass of a node of the medium.
    room : ndarray, shape (threads, d, nodes of a row)
    """

    rate: np.ndarray
    distances: np.ndarray
    alive: np.ndarray
    full: np.ndarray
    first: np.ndarray
    end: np.ndarray
    lost: np.ndarray
    room: np.ndarray


def no_drag(real: np.dtype) -> Drag:
    """None."""
    none, bits = np.zeros(0, np.int64), np.zeros(0, np.uint64)
    return Drag(
        np.zeros(0, real), none, bits.reshape(0, 0), bits, none, none, np.zeros((0, 0)), np.zeros((0, 0, 0), real)
    )


@njit(error_model="numpy", cache=True, counted=False)
def _there(bits, node, bond):
    """Whether a bond is, by its bits."""
    return (bits[bond >> 6, node] >> np.uint64(bond & 63)) & np.uint64(1) != 0


@njit(error_model="numpy", cache=True, counted=False)
def _means(stage, drag, place, pull):
    """Of each node of a row the mean increment of its neighbours, less its own; shape (d, nodes)."""
    src, base, apart = stage.src, stage.base, stage.src.size // stage.components
    for c in range(stage.components):
        first = c * apart + place
        here, before, total = src[first : first + pull.shape[1]], base[first : first + pull.shape[1]], pull[c]
        total[:] = 0
        for k in range(drag.distances.size):
            at = first + drag.distances[k]
            there, ago = src[at : at + total.size], base[at : at + total.size]
            for i in range(total.size):
                total[i] += there[i] - ago[i]
        for i in range(total.size):
            total[i] = total[i] / drag.distances.size - (here[i] - before[i])
    for i in range(pull.shape[1]):
        node, whole = place + i, True
        for word in range(drag.full.size):
            whole &= drag.alive[word, node] == drag.full[word]
        if whole:
            continue
        for c in range(stage.components):
            total, number, at = src[0] * 0, 0, c * apart + node
            for k in range(drag.distances.size):
                if _there(drag.alive, node, k):
                    total += src[at + drag.distances[k]] - base[at + drag.distances[k]]
                    number += 1
            pull[c, i] = total / number - (src[at] - base[at]) if number else src[0] * 0


@njit(error_model="numpy", cache=True, counted=False)
def drag_along(thread, stage, block, mobility, drag):
    """Add what drag does in a step, once all else is done, and add up what it takes."""
    apart, rate, pull = stage.src.size // stage.components, drag.rate[0], drag.room[thread.number]
    own = share(thread, block[1] * block[2])
    for row in range(own[0], own[1]):
        i0, i1 = row // block[2], row % block[2]
        place, taken = block[0] + i0 * block[4] + i1 * block[5], 0.0
        _means(stage, drag, place, pull)
        near = drag.first[0] <= i0 < drag.end[0] and drag.first[1] <= i1 < drag.end[1]
        for c in range(stage.components):
            first = c * apart + place
            base, out, gained = stage.base[first : first + block[3]], stage.out[first : first + block[3]], pull[c]
            for i in range(block[3]):
                out[i] += rate * gained[i]
            for i in range(drag.first[2], drag.end[2] if near else drag.first[2]):
                mass = 1 / np.float64(mobility[place + i]) if mobility.size else 1.0
                taken -= mass * np.float64(rate * gained[i]) * (np.float64(out[i]) - np.float64(base[i]))
        drag.lost[i0, i1] += 0.5 * taken
    barrier(thread)

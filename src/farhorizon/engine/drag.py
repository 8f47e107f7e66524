"""Drag that moves velocities towards the mean of their neighbours, in the compiled loop (Wildman and Gazonas 2012, eq.
3-4)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from farhorizon.engine.bonds import is_set
from farhorizon.engine.rows.compiled import njit
from farhorizon.engine.threads import barrier, chunk_of


class Drag(NamedTuple):
    """Drag on nodes, and the energy that it takes; see `engine.dragged_layers`.

    Attributes
    ----------
    rate : ndarray, shape (1,), or empty
        Fraction of the difference to the mean increment of its neighbours by which the increment of a node changes in a
        step.
    distances : ndarray of int, shape (K,)
    alive, full : ndarray of uint64, shapes (words, places) and (words,)
        Bits of the bonds that are present, and of all bonds.
    first, end : ndarray of int, shape (3,)
        Box of the nodes whose loss is accumulated.
    lost : ndarray, shape (planes, rows)
        Energy that these have lost, over the mass of a node of the medium.
    room : ndarray, shape (threads, d, nodes of a row)
    moved : ndarray, shape (d * places,)
        Increments of a step.
    beyond : ndarray, of the same shape
        Contributions of the layers to the sums over neighbours, which are used once per step.
    """

    rate: np.ndarray
    distances: np.ndarray
    alive: np.ndarray
    full: np.ndarray
    first: np.ndarray
    end: np.ndarray
    lost: np.ndarray
    room: np.ndarray
    moved: np.ndarray
    beyond: np.ndarray


def no_drag(real: np.dtype) -> Drag:
    """Return empty tables."""
    none, bits, nothing = np.zeros(0, np.int64), np.zeros(0, np.uint64), np.zeros(0, real)
    room = np.zeros((0, 0)), np.zeros((0, 0, 0), real)
    return Drag(nothing, none, bits.reshape(0, 0), bits, none, none, *room, nothing, nothing)


@njit(error_model="numpy", cache=True, counted=False)
def take_increments(thread, stage, drag):
    """Store the increment of each place in the last step."""
    first, end = chunk_of(thread, drag.moved.size)
    for i in range(first, end):
        drag.moved[i] = stage.src[i] - stage.base[i]
    barrier(thread)


@njit(error_model="numpy", cache=True, counted=False)
def _means(components, drag, place, pull):
    """Compute for each node of a row the mean increment of its neighbours minus its own; shape (d, nodes)."""
    moved, beyond, apart = drag.moved, drag.beyond, drag.moved.size // components
    for c in range(components):
        first = c * apart + place
        total, added = pull[c], beyond[first : first + pull.shape[1]]
        for i in range(total.size):
            total[i] = added[i]
        for k in range(drag.distances.size):
            there = moved[first + drag.distances[k] :]
            for i in range(total.size):
                total[i] += there[i]
        own = moved[first : first + total.size]
        for i in range(total.size):
            total[i] = total[i] / drag.distances.size - own[i]
    for i in range(pull.shape[1]):
        node, whole = place + i, True
        for word in range(drag.full.size):
            whole &= drag.alive[word, node] == drag.full[word]
        if whole:
            continue
        for c in range(components):
            at = c * apart + node
            total, number = beyond[at], 0
            for k in range(drag.distances.size):
                if is_set(drag.alive, node, k):
                    total += moved[at + drag.distances[k]]
                    number += 1
            pull[c, i] = total / number - moved[at] if number else moved[at] * 0
    for c in range(components):
        beyond[c * apart + place : c * apart + place + pull.shape[1]] = 0


@njit(error_model="numpy", cache=True, counted=False)
def drag_along(thread, stage, block, mobility, drag):
    """Add the effect of drag to a step, after everything else, and accumulate the loss."""
    apart, rate, pull = stage.src.size // stage.components, drag.rate[0], drag.room[thread.number]
    own = chunk_of(thread, block[1] * block[2])
    for row in range(own[0], own[1]):
        i0, i1 = row // block[2], row % block[2]
        place, taken = block[0] + i0 * block[4] + i1 * block[5], 0.0
        _means(stage.components, drag, place, pull)
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

"""Drag that moves velocities towards the mean of their neighbours, in the compiled loop (Wildman and Gazonas 2012, eq.
3-4)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from farhorizon.engine.bonds import is_set
from farhorizon.engine.layout import doubles, ints, reals
from farhorizon.engine.rows.compiled import njit
from farhorizon.engine.threads import barrier, chunk_of


class Drag(NamedTuple):
    """Drag on nodes, and the energy that it takes; what layers add is a pass of its own, `layer_passes.drag_pass`."""

    # Fraction of the difference to the mean increment of its neighbours by which the increment of a node changes in a
    # step; shape (1,), empty without drag.
    rate: np.ndarray = reals(0)
    distances: np.ndarray = ints(0)  # shape (K,)
    alive: np.ndarray = ints(0, 0, bits="uint64")  # bits of the bonds that are present, shape (words, places)
    full: np.ndarray = ints(0, bits="uint64")  # bits of all bonds, shape (words,)
    first: np.ndarray = ints(0)  # box of the nodes whose loss is accumulated, shape (3,), as is `end`
    end: np.ndarray = ints(0)
    lost: np.ndarray = doubles(0, 0)  # energy that they have lost over the mass of a node of the medium; (planes, rows)
    room: np.ndarray = reals(0, 0, 0)  # shape (threads, d, nodes of a row)
    moved: np.ndarray = reals(0)  # increments of a step, shape (d * places,)
    beyond: np.ndarray = reals(0)  # what layers add to the sums over neighbours, used once per step; same shape


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
        here = moved[first : first + total.size]
        for i in range(total.size):
            total[i] = total[i] / drag.distances.size - here[i]
    for i in range(pull.shape[1]):
        node, intact = place + i, True
        for word in range(drag.full.size):
            intact &= drag.alive[word, node] == drag.full[word]
        if intact:
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
    chunk = chunk_of(thread, block[1] * block[2])
    for row in range(chunk[0], chunk[1]):
        i0, i1 = row // block[2], row % block[2]
        place, taken = block[0] + i0 * block[4] + i1 * block[5], 0.0
        _means(stage.components, drag, place, pull)
        near = drag.first[0] <= i0 < drag.end[0] and drag.first[1] <= i1 < drag.end[1]
        for c in range(stage.components):
            first = c * apart + place
            base, out, gain = stage.base[first : first + block[3]], stage.out[first : first + block[3]], pull[c]
            for i in range(block[3]):
                out[i] += rate * gain[i]
            for i in range(drag.first[2], drag.end[2] if near else drag.first[2]):
                mass = 1 / np.float64(mobility[place + i]) if mobility.size else 1.0
                taken -= mass * np.float64(rate * gain[i]) * (np.float64(out[i]) - np.float64(base[i]))
        drag.lost[i0, i1] += 0.5 * taken
    barrier(thread)

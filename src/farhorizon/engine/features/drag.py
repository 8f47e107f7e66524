"""Drag that moves velocities towards the mean of their neighbours, in the compiled loop (Wildman and Gazonas 2012, eq.
3-4)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from farhorizon.engine.bonds import all_bits, is_set
from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.exchange import SLOTS
from farhorizon.engine.feature import CHANGE, Feature, Step
from farhorizon.engine.field import Field
from farhorizon.engine.layers import has_layers
from farhorizon.engine.layout import aligned_zeros, doubles, ints, reals
from farhorizon.engine.passes import LINES, NEIGHBOURS, STRETCH, Operation, exchanged, present, reads
from farhorizon.engine.tables import Tables
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


@reads("drag")
def keep_increments(thread, stage, sums, tables, inputs, step, number):
    """Store the increment of each place in the last step."""
    drag = tables.drag
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


@reads("drag", "mobility")
def drag_nodes(thread, stage, sums, tables, inputs, step, number):
    """Add the effect of drag to a step, after everything else, and accumulate the loss."""
    block, mobility, drag = sums.sweep.block, tables.mobility, tables.drag
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


def _used(tables: Tables, *_: Any) -> int:
    return int(tables.drag.rate.size)


def _over_neighbours(tables: Tables, operation: Operation) -> list[Operation]:
    """Let the layers add to the sums over neighbours first."""
    layers = tables.neighbours.layers
    lines = present((LINES, has_layers(layers, 2)), number=NEIGHBOURS)
    filled = exchanged(tables, NEIGHBOURS, [SLOTS + NEIGHBOURS], lines, ahead=False)
    return [*filled, *((STRETCH, axis, NEIGHBOURS) for axis in (2, 1, 0) if has_layers(layers, axis)), operation]


DRAG = Feature(
    "drag",
    [Step(CHANGE, keep_increments, _used), Step(CHANGE, drag_nodes, _used, around=_over_neighbours)],
    table=Drag,
    map=lambda drag: (drag.rate, drag.distances, drag.alive, drag.full, drag.first, drag.end),
    sums=lambda drag: {"drag": drag.lost[None]},
)


def set_drag(engine: Field, rate: float, first: np.ndarray, end: np.ndarray) -> None:
    """Set drag towards the mean velocity of the neighbours, with a given rate, for equations of second order. The
    energy that it takes from the nodes of the core from `first` to `end` is accumulated.

    The older level must outlive a step, and the engine must have been created for drag. Absent bonds are set later.
    """
    assert engine.drag_pass is not None
    box, low = engine.layout.box, np.array(engine.layout.low)
    full, alive = all_bits(len(engine.offsets)), engine.tables.bonds.alive
    moved, beyond = aligned_zeros(engine.components * engine.layout.size, engine.dtype, 2)
    if not engine.bonds:
        alive = np.zeros((len(full), engine.layout.size), np.uint64)
        alive[:, box.node_indices()] = full[:, None, None, None]
    drag = Drag(
        rate=np.array([rate * engine.dt], engine.dtype),
        distances=engine.layout.distances,
        alive=alive,
        full=full,
        first=first.astype(np.int64) + low,
        end=end.astype(np.int64) + low,
        lost=np.zeros(box.nodes[:2]),
        room=np.zeros((engine.threads, engine.components, box.nodes[2]), engine.dtype),
        moved=moved,
        beyond=beyond,
    )
    engine.replace(drag=drag)


def lost_by_drag(engine: Field) -> float:
    """Energy that drag has dissipated, per unit mass of a node."""
    return float(engine.tables.drag.lost.sum()) / engine.dt**2

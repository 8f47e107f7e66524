"""The operations of the compiled time loop.

A step consists of one or more *stages*. A stage sweeps the box of all nodes (``out = a*in + b*base + weights *
neighbours``), adds what the layers contribute (see `engine.nested`), and does whatever else `engine.operations` lists.
Levels are flat arrays laid out by `engine.layout`. For a field of several components each level holds as many copies of
the layout, one after the other.

The loop (`engine.loop`) calls each operation by its address, so that an operation is compiled when a run first needs
it, and the loop only once. All operations take the same arguments: the thread, the `Stage` and the `Sums` that they
work with, all tables, the inputs from outside, the number of the step within this call, and one more number, whose
meaning depends on the operation. `engine.rows.build` writes this module out with the machine code of what is used.

Several threads go through the same operations, each with its share of every part, and meet at barriers.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from farhorizon.engine.bonds import (
    END,
    FIRST,
    PHASES,
    PIECE_ROWS,
    StateBonds,
    add_work,
    bond_factor,
    bond_gap,
    hold_nodes,
    next_piece,
    sweep_tiles,
)
from farhorizon.engine.damage import break_bonds, redo_damaged
from farhorizon.engine.dampers import move_dampers
from farhorizon.engine.drag import drag_along, take_increments
from farhorizon.engine.ends import exact_ends
from farhorizon.engine.exchange import LEVEL
from farhorizon.engine.filter import damp_short_waves
from farhorizon.engine.operations import (
    ADD_SOURCES,
    AHEAD,
    BREAK,
    COPY,
    CUT,
    DAMAGED,
    DAMP_NEW,
    DAMP_OLD,
    DAMPERS,
    DEPEND,
    DISSOLVE,
    DRAG,
    ENDS,
    FILTER,
    FLOW,
    FRINGE,
    HEAT,
    HEAT_BEYOND,
    HOLD,
    INERTIA,
    KEEP,
    LAW,
    MELT,
    MOVED,
    RECEIVE,
    RELEASE,
    SEND,
    STRETCH_FORCES,
    STRETCH_STATES,
    SWEEP,
    WARM,
    WORK,
)
from farhorizon.engine.outline_stencil import fill_outline
from farhorizon.engine.phases import LIQUID, SOLID, dissolve, find_runs, melt
from farhorizon.engine.point_law import apply_to_rows
from farhorizon.engine.release import break_by_energy
from farhorizon.engine.rows.calls import call_operation, call_with
from farhorizon.engine.rows.compiled import njit
from farhorizon.engine.rows.exchanges import MOVES, RECEIVES, SENDS, TABLE, USED, call_exchange
from farhorizon.engine.rows.matrices import call_map
from farhorizon.engine.rows.runs import block_sum, copy_run, copy_values
from farhorizon.engine.rows.stencil_sweeps import TILE, TILE_ROWS, call_sweep, sweep_phases
from farhorizon.engine.stretches import stretch_forces, stretch_states
from farhorizon.engine.tables import GENERAL
from farhorizon.engine.thermal_strain import advance_thermal_strains, push_beyond, push_springs
from farhorizon.engine.threads import barrier, chunk_of, claim

CHUNK, VECTOR = 64, 8  # nodes of a row that are summed at a time, and nodes per vector
SHIFTS = 12  # column of `Sweep.block` at which the distances between components begin

# A literal argument would have a type of its own, for each of which Numba compiles a function again.
ZERO, ONE = np.int64(0), np.int64(1)

#: The function that does each operation, by its number; `engine.loop` compiles it.
OPERATIONS: dict[int, Callable[..., Any]] = {}


def operation(number: int) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Register the function that does an operation."""

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        OPERATIONS[number] = function
        return function

    return decorate


@njit(error_model="numpy", cache=True, counted=False)
def whole_vectors(count):
    """Number of values of a row to sum for `count` nodes: whole vectors, because the remainder of a loop over vectors
    takes as long as many of them, and there is room beyond the end of a row.
    """
    return min(CHUNK, (count + VECTOR - 1) // VECTOR * VECTOR)


def general_rows(stage, sums, start, to, count):
    """Sweep one row with any stencil, by offsets known only at run time and over differences; called by its address."""
    sweep, material = sums.sweep, sums.material
    src, base, out, offsets, weights = stage.src, stage.base, stage.out, sweep.offsets, sweep.general[stage.part]
    a, b, coefficient, mixed = stage.a_difference, stage.b, material.coefficient, sums.media.mixed
    acc, every = np.empty(CHUNK, src.dtype), mixed.size == 1
    for first in range(0, count, CHUNK):
        n = min(CHUNK, count - first)
        m = whole_vectors(n)
        origin = start + first
        here = src[origin : origin + m]
        acc[:m] = 0
        for k in range(offsets.size):
            w = weights[k]
            at = origin + offsets[k]
            there = src[at : at + m]
            if coefficient.size > 1:
                c_here, c_there = coefficient[origin : origin + m], coefficient[at : at + m]
                for i in range(m):
                    acc[i] += w * bond_factor(material.rule, c_here[i], c_there[i]) * (there[i] - here[i])
            else:
                for i in range(m):
                    acc[i] += w * (there[i] - here[i])
        node = to + first
        for i in range(n):
            if every or mixed[node + i] != 0:
                if stage.increments:
                    base[node + i] = a * here[i] + b * base[node + i] + acc[i]
                    out[node + i] = here[i] + base[node + i]
                else:
                    out[node + i] = a * here[i] + b * base[node + i] + acc[i]


def general_matrix_rows(stage, sums, start, to, count):
    """Sweep one row of a field of several components with matrices, stored row by row; called by its address."""
    sweep, material = sums.sweep, sums.material
    src, base, out, offsets, weights = stage.src, stage.base, stage.out, sweep.offsets, sweep.general[stage.part]
    a, b, coefficient, components, rows = (
        stage.a_difference,
        stage.b,
        material.coefficient,
        stage.components,
        stage.rows,
    )
    acc = np.empty((rows, CHUNK), src.dtype)
    factor, mixed = np.empty(CHUNK, src.dtype), sums.media.mixed
    every = mixed.size == 1
    read, written = src.size // components, out.size // rows
    for first in range(0, count, CHUNK):
        n = min(CHUNK, count - first)
        m = whole_vectors(n)
        origin, node = start + first, to + first
        acc[:] = 0
        factor[:m] = 1
        for k in range(offsets.size):
            at = origin + offsets[k]
            if coefficient.size > 1:
                for i in range(m):
                    factor[i] = bond_factor(material.rule, coefficient[origin + i], coefficient[at + i])
            for column in range(components):
                here, there = src[origin + column * read :], src[at + column * read :]
                for row in range(rows):
                    w = weights[(k * rows + row) * components + column]
                    if w != 0:
                        for i in range(m):
                            acc[row, i] += w * factor[i] * (there[i] - here[i])
        own = offsets.size * rows * components
        for place in range(own, weights.size):
            row, here = (place - own) // components, src[origin + (place - own) % components * read :]
            for i in range(n):
                acc[row, i] += weights[place] * here[i]
        for row in range(rows):
            old, new = base[node + row * written :], out[node + row * written :]
            if a != 0:
                here = src[origin + row * read :]
                for i in range(n):
                    acc[row, i] += a * here[i]
            for i in range(n):
                if every or mixed[node + i] != 0:
                    new[i] = b * old[i] + acc[row, i]


@njit(error_model="numpy", cache=True, counted=False)
def count_parts(sweep):
    """Number of parts of the box, which are bundles of neighbouring rows."""
    return sweep.block[1] * ((sweep.block[2] + sweep.depth - 1) // sweep.depth)


@njit(error_model="numpy", cache=True, counted=False)
def rows_of(sweep, number):
    """Plane of a part of the box, its first row, and the row after its last."""
    first = number // sweep.block[1] * sweep.depth
    return number % sweep.block[1], first, min(first + sweep.depth, sweep.block[2])


@njit(error_model="numpy", cache=True, counted=False)
def sweep_rows(stage, sums, i0, i1, end, first, last):
    """Sweep the nodes `first` to `last` of the rows i1 to `end` of a plane, which belong to one part of the box."""
    sweep, media = sums.sweep, sums.media
    if sweep.function != 0:
        weights = sweep.weights.ctypes.data + stage.part * sweep.weights.shape[1] * stage.src.itemsize
        sweep_compiled(stage, sweep, sweep.function, weights, stage.a, i0, i1, end, first, last)
    elif media.function == 0:
        sweep_general(stage, sums, i0, i1, end, first, last)
    else:
        part, stages = i1 // sweep.depth * sweep.block[1] + i0, media.own.shape[1]
        for piece in range(media.ranges[part], media.ranges[part + 1]):
            row, stop = max(i1, media.pieces[piece, 0]), min(end, media.pieces[piece, 1])
            node, after = max(first, media.pieces[piece, 2]), min(last, media.pieces[piece, 3])
            medium = media.pieces[piece, 4]
            if row < stop and node < after:
                if medium < 0:
                    sweep_general(stage, sums, i0, row, stop, node, after)
                else:
                    at = (medium * stages + stage.part) * media.weights.shape[2] * stage.src.itemsize
                    weights, own = media.weights.ctypes.data + at, stage.a + media.own[medium, stage.part]
                    sweep_compiled(stage, sweep, media.function, weights, own, i0, row, stop, node, after)


@njit(error_model="numpy", cache=True, counted=False)
def sweep_compiled(stage, sweep, function, weights, a, i0, i1, end, first, last):
    """Do the same by compiled rows, given the address of their weights and the factor of a node's own value."""
    src, block = stage.src, sweep.block
    start, to = block[0] + i0 * block[4] + i1 * block[5] + first, block[9] + i0 * block[10] + i1 * block[11] + first
    size = src.itemsize
    read, written = src.nbytes // sweep.blocks, stage.out.nbytes // sweep.blocks
    for number in range(sweep.blocks):
        here, there = start * size + number * read, to * size + number * written
        call_sweep(
            function,
            (src.ctypes.data + here, stage.base.ctypes.data + there, stage.out.ctypes.data + there),
            weights,
            a,
            stage.b,
            (last - first, end - i1),
            (block[6], block[7], block[8]),
            (block[5], block[11]),
            block.ctypes.data + 8 * SHIFTS,
        )


@njit(error_model="numpy", cache=True, counted=False)
def sweep_general(stage, sums, i0, i1, end, first, last):
    """Do the same bond by bond."""
    block = sums.sweep.block
    start, to = block[0] + i0 * block[4] + i1 * block[5] + first, block[9] + i0 * block[10] + i1 * block[11] + first
    for row in range(end - i1):
        call_with(sums.called[GENERAL], stage, sums, (start + row * block[5], to + row * block[11], last - first))


@njit(error_model="numpy", cache=True, counted=False)
def rows_within(i0, first, last, low, high):
    """Those of the rows `first` to `last` of plane i0 that lie in the box from `low` to `high`: first and end, both
    `last` if there are none.
    """
    i1, end = max(first, low[1]), min(last, high[1])
    return (i1, end) if i1 < end and low[0] <= i0 < high[0] else (last, last)


def stencil_part(thread, stage, sums, tables, inputs, step, number):
    """Sweep the rows of one part of the box; bundles that follow one another along the slowest axis share most of what
    they read.
    """
    i0, first, last = rows_of(sums.sweep, number)
    sweep_rows(stage, sums, i0, first, last, ZERO, sums.sweep.block[3])


def stencil_ahead(thread, stage, sums, tables, inputs, step, number):
    """Sweep the rows of one part of the box that need no halo."""
    i0, first, last = rows_of(sums.sweep, number)
    i1, end = rows_within(i0, first, last, sums.free[0], sums.free[1])
    if i1 < end:
        sweep_rows(stage, sums, i0, i1, end, ZERO, sums.sweep.block[3])


def stencil_rest(thread, stage, sums, tables, inputs, step, number):
    """Sweep the rows of one part of the box that need the halo."""
    i0, first, last = rows_of(sums.sweep, number)
    i1, end = rows_within(i0, first, last, sums.free[0], sums.free[1])
    if first < i1:
        sweep_rows(stage, sums, i0, first, i1, ZERO, sums.sweep.block[3])
    if end < last:
        sweep_rows(stage, sums, i0, end, last, ZERO, sums.sweep.block[3])


@njit(error_model="numpy", cache=True, counted=False)
def is_free(sums, number):
    """Whether no row of a part of the box needs the halo, so that all of it is swept ahead."""
    i0, first, last = rows_of(sums.sweep, number)
    i1, end = rows_within(i0, first, last, sums.free[0], sums.free[1])
    return i1 == first and end == last


def bonds_part(thread, stage, sums, tables, inputs, step, number):
    """Sweep a part of the box that contains a zone of bonds with a law of their own."""
    sweep_bonds(stage, sums, tables.bonds, number)


def bonds_ahead(thread, stage, sums, tables, inputs, step, number):
    """Do the same if it needs no halo."""
    if is_free(sums, number):
        sweep_bonds(stage, sums, tables.bonds, number)


def bonds_rest(thread, stage, sums, tables, inputs, step, number):
    """Do the same if it needs the halo."""
    if not is_free(sums, number):
        sweep_bonds(stage, sums, tables.bonds, number)


@njit(error_model="numpy", cache=True, counted=False)
def sweep_bonds(stage, sums, bonds, number):
    """Sweep a part of the box: in the zone tile by tile; around it, and where nothing can break, by the stencil."""
    sweep, material, zone = sums.sweep, sums.material, bonds.zone
    i0, first, last = rows_of(sweep, number)
    nodes = sweep.block[3]
    low, high = rows_within(i0, first, last, zone[FIRST : FIRST + 2], zone[END : END + 2])
    for i1, end, start, stop in (
        (first, low, 0, nodes),
        (high, last, 0, nodes),
        (low, high, 0, zone[FIRST + 2]),
        (low, high, zone[END + 2], nodes),
    ):
        if i1 < end and start < stop:
            sweep_rows(stage, sums, i0, i1, end, start, stop)
    for row in range(low // PIECE_ROWS, (high + PIECE_ROWS - 1) // PIECE_ROWS if low < high else 0):
        i1, end = max(row * PIECE_ROWS, low), min((row + 1) * PIECE_ROWS, high)
        stop = zone[FIRST + 2]
        while stop < zone[END + 2]:
            start = stop
            stop, whole = next_piece(stage, sweep, material, bonds, i0, i1, end, start)
            if whole:
                sweep_rows(stage, sums, i0, i1, end, start, stop)
            else:
                sweep_tiles(stage, sweep, material, bonds, i0, i1, end, start, stop)


def phases_part(thread, stage, sums, tables, inputs, step, number):
    """Sweep a part of the box in which there are two phases."""
    sweep_runs(stage, sums, tables.phases.runs, number)


def phases_ahead(thread, stage, sums, tables, inputs, step, number):
    """Do the same if it needs no halo."""
    if is_free(sums, number):
        sweep_runs(stage, sums, tables.phases.runs, number)


def phases_rest(thread, stage, sums, tables, inputs, step, number):
    """Do the same if it needs the halo."""
    if not is_free(sums, number):
        sweep_runs(stage, sums, tables.phases.runs, number)


@njit(error_model="numpy", cache=True, counted=False)
def sweep_runs(stage, sums, runs, number):
    """Sweep a part of the box: runs of liquid tiles by the compiled rows, mixed ones bond by bond, solid ones not at
    all.

    Runs are handled by addresses alone: Numba counts the references to an array that it passes on, which takes longer
    than a tile.
    """
    sweep, material, src = sums.sweep, sums.material, stage.src
    block = sweep.block
    i0, first, last = rows_of(sweep, number)
    upper, lower = first, last
    first, last = first // TILE_ROWS, (last + TILE_ROWS - 1) // TILE_ROWS
    metal = False
    for row in range(first, last):
        metal |= runs[row * block[1] + i0, 0, 0] != LIQUID or runs[row * block[1] + i0, 0, 1] * TILE < block[3]
    if not metal:
        sweep_rows(stage, sums, i0, upper, lower, ZERO, block[3])
        return
    size = src.itemsize
    places = src.ctypes.data, material.coefficient.ctypes.data, stage.base.ctypes.data, stage.out.ctypes.data
    bonds, apart = sweep.offsets.size, sweep.offsets.ctypes.data
    between = sweep.general.ctypes.data + stage.part * sweep.general.shape[1] * size
    plain = sweep.weights.ctypes.data + stage.part * sweep.weights.shape[1] * size
    for row in range(first, last):
        at = (block[0] + i0 * block[4] + row * TILE_ROWS * block[5]) * size
        to = (block[9] + i0 * block[10] + row * TILE_ROWS * block[11]) * size
        count = min(TILE_ROWS, block[2] - row * TILE_ROWS)
        run, stop = 0, 0
        while stop < block[3]:
            start, kind = stop, runs[row * block[1] + i0, run, 0]
            stop = min(runs[row * block[1] + i0, run, 1] * TILE, block[3])
            run += 1
            here, there = at + start * size, to + start * size
            if kind == LIQUID and sweep.function != 0:
                call_sweep(
                    sweep.function,
                    (places[0] + here, places[2] + there, places[3] + there),
                    plain,
                    stage.a,
                    stage.b,
                    (stop - start, count),
                    (block[6], block[7], block[8]),
                    (block[5], block[11]),
                    block.ctypes.data + 8 * SHIFTS,
                )
            elif kind != SOLID:
                sweep_phases(
                    (places[0] + here, places[1] + here, places[2] + there, places[3] + there),
                    (apart, between, bonds),
                    (stage.a_difference, stage.b, material.interface, material.ceiling),
                    (stop - start, count),
                    (block[5], block[11]),
                )


def release_part(thread, stage, sums, tables, inputs, step, number):
    """Restore what the sweep has subtracted for bonds to places without a node, in one part of the box.

    All values are zero there, so it has subtracted the weights times the node's own value (see `engine.surface`).
    """
    sweep, material, surface, scale = sums.sweep, sums.material, sums.surface, stage.scale
    src, base, out, block = stage.src, stage.base, stage.out, sweep.block
    ranges, stretches, weights, coefficient = surface.ranges, surface.stretches, surface.weights, material.coefficient
    rule, components, function = material.rule, stage.components, surface.function
    size = src.itemsize
    apart, away = src.nbytes // components, out.nbytes // stage.rows
    i0, first, last = rows_of(sweep, number)
    for i1 in range(first, last):
        start, to = block[0] + i0 * block[4] + i1 * block[5], block[9] + i0 * block[10] + i1 * block[11]
        row = i0 * block[2] + i1
        for stretch in range(ranges[row, 0], ranges[row, 1]):
            place, stop, own = stretches[stretch]
            if rule == PHASES:
                for i in range(stop - place):
                    node = start + place + i
                    factor = scale * abs(coefficient[node])  # beyond a body all is liquid
                    liquid = abs(coefficient[node])
                    gap = bond_gap(rule, coefficient[node], liquid, src[node] * 0, src[node], material.ceiling)
                    out[to + place + i] += factor * weights[own + i] * gap
                continue
            here, taken, n = src.ctypes.data + (start + place) * size, weights.ctypes.data + own * size, stop - place
            call_map(function, here, apart, out.ctypes.data + (to + place) * size, away, taken, n * size, n, scale)
            if stage.increments:
                call_map(function, here, apart, base.ctypes.data + (to + place) * size, away, taken, n * size, n, scale)


@njit(error_model="numpy", cache=True, counted=False)
def first_from(rows, r, last, key):
    """First row from r on, before `last`, whose first number is not below `key`; rows are sorted by it."""
    while r < last:
        middle = (r + last) // 2
        if rows[middle, 0] < key:
            r = middle + 1
        else:
            last = middle
    return r


@njit(error_model="numpy", cache=True, counted=False)
def record_nodes(level, runs, low, high, node_values):
    """Copy the values of nodes whose keys are from `low` to `high`, run by run: reading an index for each node would
    take longer than copying the values.
    """
    source, to, size = level.ctypes.data, node_values.ctypes.data, level.itemsize
    r = first_from(runs, ZERO, runs.shape[0], low)
    while r < runs.shape[0] and runs[r, 0] < high:
        copy_values(source + runs[r, 1] * size, to + runs[r, 2] * 8, runs[r, 3], level[0])
        r += 1


@njit(error_model="numpy", cache=True, counted=False)
def sum_blocks(level, block_sums, low, high, way, block_values):
    """Sum over blocks of nodes whose middles are from `low` to `high`; if `way` is 1 or -1, over those whose last or
    first rows are: where rows are swept upwards or downwards, all their others have just been in the cache.
    """
    sets, rows, weights, stride = block_sums.sets, block_sums.rows, block_sums.weights, block_sums.stride
    source, factors, size = level.ctypes.data, weights.ctypes.data, level.itemsize
    none = level.dtype.type(0)  # 0 times a float32 is a float64 here
    end = ZERO
    for s in range(sets.shape[0]):
        start, end = end, end + sets[s, 0]
        planes, lines, nodes = sets[s, 1], sets[s, 2], sets[s, 3]
        rest = (lines - (way > 0)) // 2 * way * stride[1]
        r = first_from(rows, start, end, low - rest)
        while r < end and rows[r, 0] < high - rest:
            place, first = rows[r, 1], rows[r, 2]
            across, along = factors + rows[r, 3] * size, factors + rows[r, 4] * size
            total = none
            for i in range(planes):
                plane = source + (place + i * stride[0]) * size
                total += weights[first + i] * block_sum(plane, across, lines, stride[1], along, nodes, none)
            block_values[rows[r, 5]] = total
            r += 1


@njit(error_model="numpy", cache=True, counted=False)
def keys_of(sweep, number):
    """Keys of the first node of a part of the box and of the one after its last."""
    block = sweep.block
    i0, first, last = rows_of(sweep, number)
    plane = block[0] + i0 * block[4]
    return plane + first * block[5], plane + last * block[5]


@njit(error_model="numpy", cache=True, counted=False)
def is_kept(inputs, step):
    """Whether recorders want the field after a step."""
    return (inputs.before + step + 1) % inputs.stride == 0


def record_nodes_part(thread, stage, sums, tables, inputs, step, number):
    """Record the watched values after the previous step: the sweep has just read them, so they are in the cache."""
    if step > 0 and stage.part == 0 and is_kept(inputs, step - 1):
        low, high = keys_of(sums.sweep, number)
        record_nodes(stage.src, inputs.recorded_nodes, low, high, inputs.node_values[step - 1])


def record_blocks_part(thread, stage, sums, tables, inputs, step, number):
    """Record the sums over blocks of nodes after the previous step."""
    if step > 0 and stage.part == 0 and is_kept(inputs, step - 1):
        low, high = keys_of(sums.sweep, number)
        way = ZERO if sums.sweep.block[1] > 1 else ONE - 2 * stage.backward  # in 3D the sweep visits planes before rows
        sum_blocks(stage.src, tables.block_sums, low, high, way, inputs.block_values[step - 1])


@njit(error_model="numpy", cache=True, counted=False)
def state_law(thread, sweep, number, whole):
    """Apply the law to a part's nodes whose states are complete after the sweep (`whole`), or to its others."""
    i0, first, last = rows_of(sweep, number)
    apply_to_rows(thread, sweep.law, sweep.block, i0, first, last, whole)


def law_part(thread, stage, sums, tables, inputs, step, number):
    """Apply the law of the nodes whose states are complete once they are swept."""
    state_law(thread, sums.sweep, number, True)


def move_part(thread, stage, sums, tables, inputs, step, number):
    """Let the messages progress with each part of the box that is swept ahead, by the thread that has begun them."""
    if thread.number == 0:
        for kind in range(tables.exchange.shape[0]):
            for axis in range(3):
                messages = tables.exchange[kind, axis]
                if messages[USED] != 0:
                    call_exchange(messages[MOVES], messages[TABLE], ZERO, ZERO, ZERO)


@operation(SWEEP)
def sweep_box(thread, stage, sums, tables, inputs, step, number):
    """Go through all parts of the box and do with each all that there is to do (`Sums.each`)."""
    go_through(thread, stage, sums, tables, inputs, step, sums.each, ZERO, ONE)


@operation(AHEAD)
def sweep_ahead(thread, stage, sums, tables, inputs, step, number):
    """Go through a share of the parts, as far as they need no halo (`Sums.ahead`)."""
    go_through(thread, stage, sums, tables, inputs, step, sums.ahead, number // 2, number % 2 + 1)


@njit(error_model="numpy", cache=True, counted=False)
def go_through(thread, stage, sums, tables, inputs, step, each, turn, shares):
    """Call the functions `each` for every part of the box, or for a share of the parts. Every other stage begins with
    the last part, which the previous stage left in the cache.

    Each thread has its own parts, the same in all steps, because the threads' caches may lie far apart. It claims them
    bit by bit, and then some of the others', so that a thread whose processor is otherwise busy does less.
    """
    count = count_parts(sums.sweep)
    for shift in range(thread.threads):
        owner = (thread.number + shift) % thread.threads
        first = owner * count // thread.threads
        own = (owner + 1) * count // thread.threads - first
        if shares > 1:  # divisions take as long as a short row
            begin, end = turn * own // shares, (turn + 1) * own // shares
            first, own = first + begin, end - begin
        size = max(1, own // 8) if thread.threads > 1 else own
        claimed = claim(thread, owner) if thread.threads > 1 else 0
        while claimed * size < own:
            for i in range(claimed * size, min(own, (claimed + 1) * size)):
                part = first + (own - 1 - i if stage.backward else i)
                for k in range(each.size):
                    call_operation(each[k], thread, stage, sums, tables, inputs, step, part)
            claimed = claim(thread, owner) if thread.threads > 1 else 1
    barrier(thread)


@njit(error_model="numpy", cache=True, counted=False, entry=True)
def copy(array, copies, components):
    """Make the periodic copies."""
    copy_runs(array, copies, components, 0, copies.shape[1])


@njit(error_model="numpy", cache=True, counted=False)
def copy_runs(array, copies, components, first, last):
    """Make the periodic copies `first` to `last`, see `Layout.copies`."""
    apart, size = array.nbytes // components, array.itemsize
    for c in range(components):
        start = np.int64(array.ctypes.data) + c * apart
        for i in range(first, last):
            copy_run(start + copies[0, i] * size, start + copies[1, i] * size, copies[2, i], array[0])


@operation(COPY)
def copy_across(thread, stage, sums, tables, inputs, step, number):
    """Fill the halo that repeats what lies across periodic axes."""
    own = chunk_of(thread, tables.copies.shape[1])
    copy_runs(stage.src, tables.copies, stage.components, own[0], own[1])
    barrier(thread)


@operation(SEND)
def send_messages(thread, stage, sums, tables, inputs, step, number):
    """Begin the messages of one kind along one axis; until they end nothing changes what they are packed from."""
    if number // 3 != LEVEL:
        barrier(thread)  # all have filled their slots
    if thread.number == 0:
        exchange_by(SENDS, stage, sums, tables, number)


@operation(RECEIVE)
def receive_messages(thread, stage, sums, tables, inputs, step, number):
    """End messages: other processes have filled the halo of a level, or that of the layers' slots."""
    if thread.number == 0:
        exchange_by(RECEIVES, stage, sums, tables, number)
    barrier(thread)


@njit(error_model="numpy", cache=True, counted=False)
def exchange_by(column, stage, sums, tables, number):
    """Call a function of an exchange, given by its column in the table of messages."""
    messages = tables.exchange[number // 3, number % 3]
    array, components = (stage.src, stage.components) if number // 3 == LEVEL else (sums.layers.slots, ONE)
    start, apart = np.int64(array.ctypes.data), array.nbytes // components
    call_exchange(messages[column], messages[TABLE], start, components, apart)


@njit(error_model="numpy", cache=True, counted=False)
def run_start(nodes, i):
    """First place from i on at which the entries of another node begin."""
    while 0 < i < nodes.size and nodes[i] == nodes[i - 1]:
        i += 1
    return i


@operation(CUT)
def cut(thread, stage, sums, tables, inputs, step, number):
    """Subtract the absent bonds; all those of one node belong to one thread."""
    material, cuts = sums.material, sums.cuts
    src, base, out, components, rule = stage.src, stage.base, stage.out, stage.components, material.rule
    nodes, neighbours, weights, coefficient = cuts.nodes, cuts.neighbours, cuts.weights, material.coefficient
    own = chunk_of(thread, nodes.size)
    apart, rows = src.size // components, stage.rows
    for i in range(run_start(nodes, own[0]), run_start(nodes, own[1])):
        factor, mine, other = stage.scale, coefficient[0], coefficient[0]
        if coefficient.size > 1:
            mine, other = coefficient[nodes[i]], coefficient[neighbours[i]]
            factor *= bond_factor(rule, mine, other)
        for column in range(components):
            here, there = src[nodes[i] + column * apart], src[neighbours[i] + column * apart]
            difference = factor * bond_gap(rule, mine, other, here, there, material.ceiling)
            for row in range(rows):
                lost = weights[(i * rows + row) * components + column] * difference
                out[nodes[i] + row * apart] -= lost
                if stage.increments:
                    base[nodes[i] + row * apart] -= lost
    barrier(thread)


@operation(DAMP_OLD)
def damp_old(thread, stage, sums, tables, inputs, step, number):
    """Damp the increment of the last step in absorbing zones."""
    src, base, damping = stage.src, stage.base, tables.damping
    for i in range(thread.number, damping.nodes.size, thread.threads):
        node = damping.nodes[i]
        if stage.increments:
            base[node] *= damping.before[i]
        else:
            base[node] = src[node] - (src[node] - base[node]) * damping.before[i]
    barrier(thread)


@operation(DAMP_NEW)
def damp_new(thread, stage, sums, tables, inputs, step, number):
    """Damp the increment of this step in absorbing zones, and let values leak there."""
    src, out, damping = stage.src, stage.out, tables.damping
    for i in range(thread.number, damping.nodes.size, thread.threads):
        node = damping.nodes[i]
        change, loss = (out[node] - src[node]) * damping.after[i], stage.scale * damping.leak[i] * src[node]
        out[node] = src[node] + change - loss
        if stage.increments:
            stage.base[node] = out[node] - src[node]
    barrier(thread)


@operation(INERTIA)
def weigh_down(thread, stage, sums, tables, inputs, step, number):
    """Scale what forces have done to each node in this step by its mobility, to account for its mass; `base` still
    holds the level before `src`.
    """
    block, mobility = sums.sweep.block, tables.mobility
    apart, keep = stage.out.size // stage.components, -stage.b
    own = chunk_of(thread, block[1] * block[2])
    for row in range(own[0], own[1]):
        first = block[0] + row // block[2] * block[4] + row % block[2] * block[5]
        mobile = mobility[first : first + block[3]]
        for c in range(stage.components):
            start, end = first + c * apart, first + c * apart + block[3]
            src, base, out = stage.src[start:end], stage.base[start:end], stage.out[start:end]
            for i in range(block[3]):
                free = src[i] + keep * (src[i] - base[i])
                out[i] = free + mobile[i] * (out[i] - free)
    barrier(thread)


@operation(ADD_SOURCES)
def add_sources(thread, stage, sums, tables, inputs, step, number):
    """Add the sources."""
    nodes, fields, scale = inputs.source_nodes, inputs.source_fields, tables.numbers[stage.part, 4]
    for j in range(fields.shape[0]):
        amplitude = scale * inputs.source_times[step, stage.part, j]
        if amplitude != 0:
            for i in range(thread.number, nodes.size, thread.threads):
                gain = amplitude * fields[j, i]
                stage.out[nodes[i]] += gain
                if stage.increments:
                    stage.base[nodes[i]] += gain
    barrier(thread)


@operation(HOLD)
def hold(thread, stage, sums, tables, inputs, step, number):
    """Set nodes to the values that they are given after each step, and add up the work of what holds them."""
    hold_nodes(thread, stage, tables.work, tables.mobility, inputs, step)
    barrier(thread)


@njit(error_model="numpy", cache=True, counted=False, entry=True)
def depend(stage, dependents, fields, times):
    """Set nodes, in order, to linear combinations of the values of others, plus fields times amplitudes."""
    nodes, starts, out = dependents.nodes, dependents.starts, stage.out
    for i in range(nodes.size):
        total = out[nodes[i]] * 0
        for k in range(starts[i], starts[i + 1]):
            total += dependents.weights[k] * out[dependents.sources[k]]
        for j in range(fields.shape[0]):
            total += times[j] * fields[j, i]
        out[nodes[i]] = total
        if stage.increments:
            stage.base[nodes[i]] = total - stage.src[nodes[i]]


@operation(DEPEND)
def depend_on_others(thread, stage, sums, tables, inputs, step, number):
    """Set the dependent nodes. One thread does this, because each node may depend on the one before."""
    if thread.number == 0:
        depend(stage, tables.dependents, inputs.dependent_fields, inputs.dependent_times[step, stage.part])
    barrier(thread)


@njit(error_model="numpy", cache=True, counted=False)
def add_to(totals, account, gain):
    """Add to totals[0, account]; totals[1] holds the rounding errors of the sums (Neumaier)."""
    total = totals[0, account] + gain
    totals[1, account] += (
        (totals[0, account] - total) + gain
        if abs(totals[0, account]) >= abs(gain)
        else (gain - total) + totals[0, account]
    )
    totals[0, account] = total


@operation(FLOW)
def add_flow(thread, stage, sums, tables, inputs, step, number):
    """Add what flows along bonds into their nodes, account by account."""
    if thread.number == 0:
        add_flow_along_bonds(stage, sums.material, tables.flows)
    barrier(thread)


@njit(error_model="numpy", cache=True, counted=False)
def add_flow_along_bonds(stage, material, flows):
    """Do this in one thread; a neighbour whose index is below 0 has the value zero."""
    nodes, neighbours, weights = flows.nodes, flows.neighbours, flows.weights
    src, rule, coefficient, effect = stage.src, material.rule, material.coefficient, flows.effects[stage.part]
    for i in range(flows.accounts.size):
        here = np.float64(src[nodes[i]])
        gain = -effect * weights[i] * here
        if neighbours[i] >= 0:
            mine, other, factor = coefficient[0], coefficient[0], 1.0
            if coefficient.size > 1:
                mine, other = coefficient[nodes[i]], coefficient[neighbours[i]]
                factor = bond_factor(rule, mine, other)
            there, ceiling = np.float64(src[neighbours[i]]), np.float64(material.ceiling)
            gain = effect * weights[i] * bond_gap(rule, mine, other, here, there, ceiling) * factor
        add_to(flows.totals, flows.accounts[i], gain)


def clear_inflow(thread, stage, sums, tables, inputs, step, number):
    """Set the level that takes what the layers contribute to zero."""
    if thread.number == 0:
        tables.flows.inflow[:] = 0
    barrier(thread)


def add_inflow(thread, stage, sums, tables, inputs, step, number):
    """Add to the flows what the layers along an axis, the number, have brought to the nodes beside them."""
    if thread.number == 0:
        flows = tables.flows
        sides, effect = flows.sides, flows.effects[stage.part]
        for i in range(sides.shape[0]):
            if sides[i, 0] == number:
                for k in range(sides[i, 2], sides[i, 3]):
                    add_to(flows.totals, sides[i, 1], effect * np.float64(flows.inflow[flows.beside[k]]))
    barrier(thread)


@operation(ENDS)
def close_ends(thread, stage, sums, tables, inputs, step, number):
    """Add the forces of the chains beyond all exact ends, and to the flows what these bring to their drivers; an
    account below 0 means that there is none.
    """
    if thread.number == 0:
        ends, flows = tables.ends, tables.flows
        exact_ends(stage, ends)
        effect = flows.effects[stage.part]
        for end in range(flows.ends.shape[0]):
            for m in range(flows.ends.shape[1]):
                if flows.ends[end, m] >= 0:
                    add_to(flows.totals, flows.ends[end, m], effect * ends.forces[end, m])
    barrier(thread)


@operation(FILTER)
def filter_layers(thread, stage, sums, tables, inputs, step, number):
    """Damp short waves in the layers."""
    if (inputs.before + step + 1) % tables.filter.every == 0:
        damp_short_waves(thread, stage, tables.filter)


@operation(DAMPERS)
def move_hanging_masses(thread, stage, sums, tables, inputs, step, number):
    """Move the masses of the tuned dampers, which hang on nodes of the layers."""
    move_dampers(thread, stage, tables.dampers)


@operation(MOVED)
def keep_increments(thread, stage, sums, tables, inputs, step, number):
    """Keep the increments of the last step, from which drag follows."""
    take_increments(thread, stage, tables.drag)


@operation(DRAG)
def drag_nodes(thread, stage, sums, tables, inputs, step, number):
    """Move velocities towards the mean of their neighbours."""
    drag_along(thread, stage, sums.sweep.block, tables.mobility, tables.drag)


@operation(WORK)
def sum_work(thread, stage, sums, tables, inputs, step, number):
    """Add up the work of the sources."""
    add_work(thread, stage, tables.work, inputs, inputs.source_times[step, stage.part])


@operation(FRINGE)
def close_outline(thread, stage, sums, tables, inputs, step, number):
    """Fill the halo along an outline."""
    fill_outline(thread, stage, tables.outline_stencil)


@operation(DISSOLVE)
def dissolve_nodes(thread, stage, sums, tables, inputs, step, number):
    """Turn solid nodes liquid; where some have changed, find the runs of tiles anew."""
    phases, coefficient = tables.phases, sums.material.coefficient
    dissolve(thread, stage.out, coefficient, sums.sweep, phases, inputs.before + step + 1)
    barrier(thread)
    if phases.total[0] != phases.total[1]:
        find_runs(thread, phases)
        barrier(thread)
        if thread.number == 0:
            phases.total[1] = phases.total[0]
            copy(coefficient, tables.copies, ONE)
        barrier(thread)


@operation(MELT)
def melt_halo(thread, stage, sums, tables, inputs, step, number):
    """Do the same in the halo, as other processes have just filled it."""
    phases = tables.phases
    if thread.number == 0:
        melt(stage.src, sums.material.coefficient, sums.sweep, phases)
    barrier(thread)
    if phases.total[0] != phases.total[1]:
        find_runs(thread, phases)
        barrier(thread)
        if thread.number == 0:
            phases.total[1] = phases.total[0]
        barrier(thread)


@operation(KEEP)  # with `record_blocks_last`
def record_nodes_last(thread, stage, sums, tables, inputs, step, number):
    """Record the watched values after the last step of a call; after others the next step does so."""
    if step == inputs.node_values.shape[0] - 1 and is_kept(inputs, step):
        own = chunk_of(thread, count_parts(sums.sweep))
        for part in range(own[0], own[1]):
            low, high = keys_of(sums.sweep, part)
            record_nodes(stage.out, inputs.recorded_nodes, low, high, inputs.node_values[step])


def record_blocks_last(thread, stage, sums, tables, inputs, step, number):
    """Record the sums over blocks of nodes after the last step of a call."""
    if step == inputs.node_values.shape[0] - 1 and is_kept(inputs, step):
        own = chunk_of(thread, count_parts(sums.sweep))
        for part in range(own[0], own[1]):
            low, high = keys_of(sums.sweep, part)
            sum_blocks(stage.out, tables.block_sums, low, high, ZERO, inputs.block_values[step])


@operation(LAW)
def apply_law_after(thread, stage, sums, tables, inputs, step, number):
    """Apply the law of the nodes whose states are complete only once all sums have been made."""
    own = chunk_of(thread, count_parts(sums.sweep))
    for part in range(own[0], own[1]):
        state_law(thread, sums.sweep, part, False)
    barrier(thread)


@operation(BREAK)
def break_beyond(thread, stage, sums, tables, inputs, step, number):
    """Break bonds that are stretched beyond their limit."""
    break_bonds(thread, stage, sums.sweep, sums.liquid, tables.bonds)


@operation(RELEASE)
def break_with_energy(thread, stage, sums, tables, inputs, step, number):
    """Break bonds with which enough energy is lost."""
    passes = tables.gradient_pass, tables.divergence_pass
    break_by_energy(thread, stage, StateBonds(sums.sweep, sums.liquid, passes[0], passes[1], tables.bonds))


@operation(DAMAGED)
def redo_nodes(thread, stage, sums, tables, inputs, step, number):
    """Recompute states or forces of nodes that have lost bonds; the number says which, see `engine.damage`."""
    passes = tables.gradient_pass, tables.divergence_pass
    redo_damaged(thread, stage, StateBonds(sums.sweep, sums.liquid, passes[0], passes[1], tables.bonds), number)


@operation(STRETCH_STATES)
def stretch_all_states(thread, stage, sums, tables, inputs, step, number):
    """Stretch the derivatives that nodes have for states, in the layers; if the number is 1 their memory begins."""
    stretch_states(thread, tables.gradient_pass.sweep.law, tables.stretches, number != 0)


@operation(STRETCH_FORCES)
def stretch_all_forces(thread, stage, sums, tables, inputs, step, number):
    """Stretch the derivatives of what the law has made of the states, in the layers; with 1 their memory begins."""
    stretch_forces(thread, stage, tables.gradient_pass.sweep.law, tables.stretches, number != 0)


@operation(HEAT)
def heat_springs(thread, stage, sums, tables, inputs, step, number):
    """Subtract the effect of thermal strains from the forces of springs beside states."""
    push_springs(thread, stage, sums.sweep.block, sums.liquid, tables.bonds, tables.heat)


@operation(HEAT_BEYOND)
def heat_beyond(thread, stage, sums, tables, inputs, step, number):
    """Do the same for bonds without a law of their own, and for springs beside states."""
    push_beyond(thread, stage, sums.sweep.block, sums.liquid, tables.bonds, tables.heat)


@operation(WARM)
def step_thermal_strains(thread, stage, sums, tables, inputs, step, number):
    """Advance the thermal strains to those of the next step."""
    advance_thermal_strains(thread, tables.heat)

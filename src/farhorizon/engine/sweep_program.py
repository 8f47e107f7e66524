"""The operations of the compiled time loop that go over the box part by part, where a part is a bundle of neighbouring
rows: the sweep, and what is done with each part while it is in the cache. See `engine.program`.
"""

import numpy as np

from farhorizon.engine.bonds import END, FIRST, PHASES, PIECE_ROWS, bond_factor, bond_gap, next_piece, sweep_tiles
from farhorizon.engine.codegen.calls import call_operation, call_with
from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.codegen.exchanges import MOVES, TABLE, USED, call_exchange
from farhorizon.engine.codegen.matrices import call_map
from farhorizon.engine.codegen.stencil_sweeps import call_sweep
from farhorizon.engine.passes import AHEAD, LAW, SWEEP, operation, reads
from farhorizon.engine.point_law import apply_to_rows
from farhorizon.engine.tables import GENERAL
from farhorizon.engine.threads import barrier, chunk_of, claim

CHUNK, VECTOR = 64, 8  # nodes of a row that are summed at a time, and nodes per vector
SHIFTS = 12  # column of `Sweep.block` at which the distances between components begin

# A literal argument would have a type of its own, for each of which Numba compiles a function again.
ZERO, ONE = np.int64(0), np.int64(1)


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
    total, everywhere = np.empty(CHUNK, src.dtype), mixed.size == 1
    for first in range(0, count, CHUNK):
        n = min(CHUNK, count - first)
        m = whole_vectors(n)
        origin = start + first
        u = src[origin : origin + m]
        total[:m] = 0
        for k in range(offsets.size):
            w = weights[k]
            at = origin + offsets[k]
            u_neighbour = src[at : at + m]
            if coefficient.size > 1:
                c, c_neighbour = coefficient[origin : origin + m], coefficient[at : at + m]
                for i in range(m):
                    total[i] += w * bond_factor(material.rule, c[i], c_neighbour[i]) * (u_neighbour[i] - u[i])
            else:
                for i in range(m):
                    total[i] += w * (u_neighbour[i] - u[i])
        node = to + first
        for i in range(n):
            if everywhere or mixed[node + i] != 0:
                if stage.increments:
                    base[node + i] = a * u[i] + b * base[node + i] + total[i]
                    out[node + i] = u[i] + base[node + i]
                else:
                    out[node + i] = a * u[i] + b * base[node + i] + total[i]


def general_matrix_rows(stage, sums, start, to, count):
    """Sweep one row of a field of several components with matrices, stored row by row; called by its address."""
    sweep, material = sums.sweep, sums.material
    src, base, out, offsets, weights = stage.src, stage.base, stage.out, sweep.offsets, sweep.general[stage.part]
    a, b, coefficient = stage.a_difference, stage.b, material.coefficient
    components, rows = stage.components, stage.rows
    total = np.empty((rows, CHUNK), src.dtype)
    factor, mixed = np.empty(CHUNK, src.dtype), sums.media.mixed
    everywhere = mixed.size == 1
    read, written = src.size // components, out.size // rows
    for first in range(0, count, CHUNK):
        n = min(CHUNK, count - first)
        m = whole_vectors(n)
        origin, node = start + first, to + first
        total[:] = 0
        factor[:m] = 1
        for k in range(offsets.size):
            at = origin + offsets[k]
            if coefficient.size > 1:
                for i in range(m):
                    factor[i] = bond_factor(material.rule, coefficient[origin + i], coefficient[at + i])
            for column in range(components):
                u, u_neighbour = src[origin + column * read :], src[at + column * read :]
                for row in range(rows):
                    w = weights[(k * rows + row) * components + column]
                    if w != 0:
                        for i in range(m):
                            total[row, i] += w * factor[i] * (u_neighbour[i] - u[i])
        reaction = offsets.size * rows * components  # where the weights of a reaction matrix begin
        for place in range(reaction, weights.size):
            row, u = (place - reaction) // components, src[origin + (place - reaction) % components * read :]
            for i in range(n):
                total[row, i] += weights[place] * u[i]
        for row in range(rows):
            old, new = base[node + row * written :], out[node + row * written :]
            if a != 0:
                u = src[origin + row * read :]
                for i in range(n):
                    total[row, i] += a * u[i]
            for i in range(n):
                if everywhere or mixed[node + i] != 0:
                    new[i] = b * old[i] + total[row, i]


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
                    weights, a = media.weights.ctypes.data + at, stage.a + media.own[medium, stage.part]
                    sweep_compiled(stage, sweep, media.function, weights, a, i0, row, stop, node, after)


@njit(error_model="numpy", cache=True, counted=False)
def sweep_compiled(stage, sweep, function, weights, a, i0, i1, end, first, last):
    """Do the same by compiled rows, given the address of their weights and the factor of a node's own value."""
    src, block = stage.src, sweep.block
    start, to = block[0] + i0 * block[4] + i1 * block[5] + first, block[9] + i0 * block[10] + i1 * block[11] + first
    size = src.itemsize
    read, written = src.nbytes // sweep.blocks, stage.out.nbytes // sweep.blocks
    for number in range(sweep.blocks):
        source, result = start * size + number * read, to * size + number * written
        call_sweep(
            function,
            (src.ctypes.data + source, stage.base.ctypes.data + result, stage.out.ctypes.data + result),
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


@reads("bonds")
def bonds_part(thread, stage, sums, tables, inputs, step, number):
    """Sweep a part of the box that contains a zone of bonds with a law of their own."""
    sweep_bonds(stage, sums, tables.bonds, number)


@reads("bonds")
def bonds_ahead(thread, stage, sums, tables, inputs, step, number):
    """Do the same if it needs no halo."""
    if is_free(sums, number):
        sweep_bonds(stage, sums, tables.bonds, number)


@reads("bonds")
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
            stop, intact = next_piece(stage, sweep, material, bonds, i0, i1, end, start)
            if intact:
                sweep_rows(stage, sums, i0, i1, end, start, stop)
            else:
                sweep_tiles(stage, sweep, material, bonds, i0, i1, end, start, stop)


def release_part(thread, stage, sums, tables, inputs, step, number):
    """Restore what the sweep has subtracted for bonds to places without a node, in one part of the box.

    All values are zero there, so it has subtracted the weights times the node's own value (see `engine.surface`).
    """
    sweep, material, surface, scale = sums.sweep, sums.material, sums.surface, stage.scale
    src, base, out, block = stage.src, stage.base, stage.out, sweep.block
    ranges, segments, weights, coefficient = surface.ranges, surface.segments, surface.weights, material.coefficient
    rule, components, function = material.rule, stage.components, surface.function
    size = src.itemsize
    apart, away = src.nbytes // components, out.nbytes // stage.rows
    i0, first, last = rows_of(sweep, number)
    for i1 in range(first, last):
        start, to = block[0] + i0 * block[4] + i1 * block[5], block[9] + i0 * block[10] + i1 * block[11]
        row = i0 * block[2] + i1
        for segment in range(ranges[row, 0], ranges[row, 1]):
            place, stop, entry = segments[segment]
            if rule == PHASES:
                for i in range(stop - place):
                    node = start + place + i
                    factor = scale * abs(coefficient[node])  # beyond a body all is liquid
                    liquid = abs(coefficient[node])
                    gap = bond_gap(rule, coefficient[node], liquid, src[node] * 0, src[node], material.ceiling)
                    out[to + place + i] += factor * weights[entry + i] * gap
                continue
            source, n = src.ctypes.data + (start + place) * size, stop - place
            result, matrix = (to + place) * size, weights.ctypes.data + entry * size
            call_map(function, source, apart, out.ctypes.data + result, away, matrix, n * size, n, scale)
            if stage.increments:
                call_map(function, source, apart, base.ctypes.data + result, away, matrix, n * size, n, scale)


@njit(error_model="numpy", cache=True, counted=False)
def state_law(thread, sweep, number, swept):
    """Apply the law to a part's nodes whose states are complete after the sweep (`swept`), or to its others."""
    i0, first, last = rows_of(sweep, number)
    apply_to_rows(thread, sweep.law, sweep.block, i0, first, last, swept)


def law_part(thread, stage, sums, tables, inputs, step, number):
    """Apply the law of the nodes whose states are complete once they are swept."""
    state_law(thread, sums.sweep, number, True)


@reads("exchange")
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
    go_through(thread, stage, sums, inputs, step, sums.each, ZERO, ONE)


@operation(AHEAD)
def sweep_ahead(thread, stage, sums, tables, inputs, step, number):
    """Go through some of the parts, as far as they need no halo (`Sums.ahead`)."""
    go_through(thread, stage, sums, inputs, step, sums.ahead, number // 2, number % 2 + 1)


@njit(error_model="numpy", cache=True, counted=False)
def go_through(thread, stage, sums, inputs, step, functions, turn, turns):
    """Call functions for all parts of the box, or for those of one of several turns. Every other stage begins with the
    last part, which the previous stage left in the cache.

    Each thread has its own parts, the same in all steps, because the threads' caches may lie far apart. It claims them
    bit by bit, and then some of the others', so that a thread whose processor is otherwise busy does less.
    """
    count = count_parts(sums.sweep)
    for shift in range(thread.threads):
        owner = (thread.number + shift) % thread.threads
        first = owner * count // thread.threads
        parts = (owner + 1) * count // thread.threads - first
        if turns > 1:  # divisions take as long as a short row
            begin, end = turn * parts // turns, (turn + 1) * parts // turns
            first, parts = first + begin, end - begin
        size = max(1, parts // 8) if thread.threads > 1 else parts  # what a thread claims at once
        claimed = claim(thread, owner) if thread.threads > 1 else 0
        while claimed * size < parts:
            for i in range(claimed * size, min(parts, (claimed + 1) * size)):
                part = first + (parts - 1 - i if stage.backward else i)
                for k in range(functions.shape[0]):
                    call_operation(functions[k, 0], thread, stage, sums, functions[k, 1], inputs, step, part)
            claimed = claim(thread, owner) if thread.threads > 1 else 1
    barrier(thread)


@operation(LAW)
def apply_law_after(thread, stage, sums, tables, inputs, step, number):
    """Apply the law of the nodes whose states are complete only once all sums have been made."""
    chunk = chunk_of(thread, count_parts(sums.sweep))
    for part in range(chunk[0], chunk[1]):
        state_law(thread, sums.sweep, part, False)
    barrier(thread)

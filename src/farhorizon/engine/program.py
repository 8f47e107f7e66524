"""The compiled time loop.

`run` goes through many steps without returning to Python. A step is one or more *stages*; a stage sweeps the box of all
nodes (``out = a*in + b*base + weights * neighbours``) and then adds what the layers contribute (see `engine.nested`).
Arrays named ``levels[l]`` are flat time levels laid out by `engine.layout`. Of a field of several components each level
holds as many copies of the layout, one after the other.

This text is a template: `engine.rows.build` writes it out with and without the kernels of what few runs have (`RARE`:
phases, bonds that break, exact ends, outlines), which take as long to compile as all others.

Several threads go through the same loop, each with its share (`lane` of `lanes`) of every part, and meet at barriers.
"""

import numpy as np

from farhorizon.engine.bonds import (
    CALM_ROWS,
    END,
    FIRST,
    PHASES,
    bond_factor,
    bond_gap,
    book_work,
    next_piece,
    sweep_tiles,
)
from farhorizon.engine.ends import exact_ends
from farhorizon.engine.filter import damp_short_waves
from farhorizon.engine.fringe import close_fringe
from farhorizon.engine.nested import add_layers, continue_lines
from farhorizon.engine.phases import LIQUID, SOLID, dissolve, find_runs
from farhorizon.engine.rows.compiled import njit
from farhorizon.engine.rows.vectors import TILE, TILE_ROWS, add_weighted, call_sweep, sweep_phases
from farhorizon.engine.threads import barrier, claim

CHUNK = 64
SHIFTS = 12  # column of a block's row where the distances of the components begin

RARE = True

# Plain numbers among the arguments would be types of their own, for each of which Numba compiles a function anew.
NONE, ONE = np.int64(0), np.int64(1)


@njit(error_model="numpy", cache=True)
def sweep_general(src, base, out, start, to, count, offsets, weights, a, b, increments, coefficient, rule):
    """One row of any stencil with run-time offsets; the sum runs over differences."""
    acc = np.empty(CHUNK, src.dtype)
    for first in range(0, count, CHUNK):
        n = min(CHUNK, count - first)
        origin = start + first
        here = src[origin : origin + n]
        acc[:n] = 0
        for k in range(offsets.size):
            w = weights[k]
            at = origin + offsets[k]
            there = src[at : at + n]
            if coefficient.size > 1:
                c_here, c_there = coefficient[origin : origin + n], coefficient[at : at + n]
                for i in range(n):
                    acc[i] += w * bond_factor(rule, c_here[i], c_there[i]) * (there[i] - here[i])
            else:
                for i in range(n):
                    acc[i] += w * (there[i] - here[i])
        node = to + first
        if increments:
            for i in range(n):
                base[node + i] = b * base[node + i] + acc[i]
                out[node + i] = here[i] + base[node + i]
        else:
            for i in range(n):
                out[node + i] = a * here[i] + b * base[node + i] + acc[i]


@njit(error_model="numpy", cache=True)
def sweep_general_matrix(src, base, out, start, to, count, offsets, weights, a, b, coefficient, rule, components):
    """One row of any stencil of matrices, given row by row, for a field of several components."""
    acc = np.empty((components, CHUNK), src.dtype)
    factor = np.empty(CHUNK, src.dtype)
    read, written = src.size // components, out.size // components
    for first in range(0, count, CHUNK):
        n = min(CHUNK, count - first)
        origin, node = start + first, to + first
        acc[:] = 0
        factor[:n] = 1
        for k in range(offsets.size):
            at = origin + offsets[k]
            if coefficient.size > 1:
                for i in range(n):
                    factor[i] = bond_factor(rule, coefficient[origin + i], coefficient[at + i])
            for column in range(components):
                here, there = src[origin + column * read :], src[at + column * read :]
                for row in range(components):
                    w = weights[(k * components + row) * components + column]
                    if w != 0:
                        for i in range(n):
                            acc[row, i] += w * factor[i] * (there[i] - here[i])
        for row in range(components):
            here, old, new = src[origin + row * read :], base[node + row * written :], out[node + row * written :]
            for i in range(n):
                new[i] = a * here[i] + b * old[i] + acc[row, i]


# What all rows of a stage share: law = (weights of the general sweep, a, a for differences, b, increments, rule,
# components, ceiling).


@njit(error_model="numpy", cache=True, counted=False)
def count_parts(block, depth):
    """Parts of a block: bundles of up to `depth` neighbouring rows."""
    return block[1] * ((block[2] + depth - 1) // depth)


@njit(error_model="numpy", cache=True, counted=False)
def sweep_rows(src, base, out, block, i0, i1, count, first, last, function, weights, offsets, coefficient, law):
    """Nodes `first` to `last` of `count` rows of a block; a stencil without compiled rows has function 0."""
    general, a, a_difference, b, increments, rule, components, _ = law
    start, to = block[0] + i0 * block[4] + i1 * block[5] + first, block[9] + i0 * block[10] + i1 * block[11] + first
    if function != 0:
        size = src.itemsize
        call_sweep(
            function,
            src.ctypes.data + start * size,
            base.ctypes.data + to * size,
            out.ctypes.data + to * size,
            weights.ctypes.data,
            a,
            b,
            last - first,
            count,
            block[6],
            block[7],
            block[8],
            block[5],
            block[11],
            block.ctypes.data + 8 * SHIFTS,
        )
    elif components == 1:
        for row in range(count):
            sweep_general(
                src,
                base,
                out,
                start + row * block[5],
                to + row * block[11],
                last - first,
                offsets,
                general,
                a_difference,
                b,
                increments,
                coefficient,
                rule,
            )
    else:
        for row in range(count):
            sweep_general_matrix(
                src,
                base,
                out,
                start + row * block[5],
                to + row * block[11],
                last - first,
                offsets,
                general,
                a_difference,
                b,
                coefficient,
                rule,
                components,
            )


@njit(error_model="numpy", cache=True, counted=False)
def sweep_part(src, base, out, block, number, depth, first, last, function, weights, offsets, coefficient, law):
    """Nodes `first` to `last` of the rows of one part of a block: bundles one after the other along the slowest axis
    share most of what they read.
    """
    i0, i1 = number % block[1], (number // block[1]) * depth
    sweep_rows(
        src,
        base,
        out,
        block,
        i0,
        i1,
        min(depth, block[2] - i1),
        first,
        last,
        function,
        weights,
        offsets,
        coefficient,
        law,
    )


@njit(error_model="numpy", cache=True, counted=False)
def sweep_bonds(src, base, out, block, number, depth, function, weights, offsets, coefficient, law, bonds, reach):
    """A part of the core with a zone of bonds that follow a law of their own: there tile by tile, around it, and where
    it is calm, by the stencil.
    """
    zone = bonds.zone
    i0, first = number % block[1], (number // block[1]) * depth
    last = min(first + depth, block[2])
    low, high = max(first, zone[FIRST + 1]), min(last, zone[END + 1])
    if low >= high or not zone[FIRST] <= i0 < zone[END]:
        low, high = last, last
    for i1, end, start, stop in (
        (first, low, 0, block[3]),
        (high, last, 0, block[3]),
        (low, high, 0, zone[FIRST + 2]),
        (low, high, zone[END + 2], block[3]),
    ):
        if i1 < end and start < stop:
            sweep_rows(
                src, base, out, block, i0, i1, end - i1, start, stop, function, weights, offsets, coefficient, law
            )
    for row in range(low // CALM_ROWS, (high + CALM_ROWS - 1) // CALM_ROWS if low < high else 0):
        i1, end = max(row * CALM_ROWS, low), min((row + 1) * CALM_ROWS, high)
        stop = zone[FIRST + 2]
        while stop < zone[END + 2]:
            start = stop
            stop, calm = next_piece(src, block, reach, i0, i1, end, start, law[6], coefficient.size > 1, bonds)
            if calm:
                sweep_rows(
                    src, base, out, block, i0, i1, end - i1, start, stop, function, weights, offsets, coefficient, law
                )
            else:
                sweep_tiles(
                    src, base, out, block, i0, i1, end, start, stop, law[2], law[3], law[6], coefficient, law[5], bonds
                )


@njit(error_model="numpy", cache=True, counted=False)
def sweep_two_phases(
    src, base, out, block, number, depth, function, weights, offsets, coefficient, law, runs, interface
):
    """A part of the core in two phases: runs of liquid tiles by the compiled rows, of mixed ones bond by bond, of solid
    ones not at all.

    Between runs there are addresses only: Numba counts the references to an array that it passes on, which takes longer
    than a tile.
    """
    i0, first = number % block[1], (number // block[1]) * depth // TILE_ROWS
    last = min(first + depth // TILE_ROWS, (block[2] + TILE_ROWS - 1) // TILE_ROWS)
    metal = False
    for row in range(first, last):
        metal |= runs[row * block[1] + i0, 0, 0] != LIQUID or runs[row * block[1] + i0, 0, 1] * TILE < block[3]
    if not metal:
        sweep_part(src, base, out, block, number, depth, NONE, block[3], function, weights, offsets, coefficient, law)
        return
    general, a, a_difference, b, _, _, _, _ = law
    size = src.itemsize
    places = src.ctypes.data, coefficient.ctypes.data, base.ctypes.data, out.ctypes.data
    bonds, apart, between, plain = offsets.size, offsets.ctypes.data, general.ctypes.data, weights.ctypes.data
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
            if kind == LIQUID and function != 0:
                call_sweep(
                    function,
                    places[0] + here,
                    places[2] + there,
                    places[3] + there,
                    plain,
                    a,
                    b,
                    stop - start,
                    count,
                    block[6],
                    block[7],
                    block[8],
                    block[5],
                    block[11],
                    block.ctypes.data + 8 * SHIFTS,
                )
            elif kind != SOLID:
                sweep_phases(
                    places[0] + here,
                    places[1] + here,
                    places[2] + there,
                    places[3] + there,
                    apart,
                    between,
                    bonds,
                    a_difference,
                    b,
                    interface[0],
                    interface[1],
                    stop - start,
                    count,
                    block[5],
                    block[11],
                )


@njit(error_model="numpy", cache=True, counted=False)
def release(src, base, out, block, number, depth, begin, end, law, scale, coefficient, rim):
    """Take back the bonds to places without a node, of the nodes `begin` to `end` of the rows of one part of a block.

    There all is zero, so the sweep has taken the bonds' weights times the node's own value (see `engine.surface`).
    """
    ranges, stretches, weights = rim
    increments, rule, components, ceiling = law[4], law[5], law[6], law[7]
    size, count = src.itemsize, weights.shape[1]
    apart, away = src.size // components, out.size // components
    i0, first = number % block[1], (number // block[1]) * depth
    for i1 in range(first, min(first + depth, block[2])):
        start, to = block[0] + i0 * block[4] + i1 * block[5], block[9] + i0 * block[10] + i1 * block[11]
        row = i0 * block[2] + i1
        for stretch in range(ranges[row, 0], ranges[row, 1]):
            place, stop = max(stretches[stretch, 0], begin), min(stretches[stretch, 1], end)
            entry = place + stretches[stretch, 2]
            if rule == PHASES:
                for i in range(stop - place):
                    own = start + place + i
                    factor = scale * abs(coefficient[own])  # beyond a body all is liquid
                    gap = bond_gap(rule, coefficient[own], abs(coefficient[own]), src[own] * 0, src[own], ceiling)
                    out[to + place + i] += factor * weights[0, entry + i] * gap
                continue
            for a in range(components):
                here, node = src.ctypes.data + (start + place) * size, (to + place + a * away) * size
                taken = weights.ctypes.data + (a * components * count + entry) * size
                add_weighted(out.ctypes.data + node, here, taken, scale, stop - place, components, apart, count)
                if increments:
                    add_weighted(base.ctypes.data + node, here, taken, scale, stop - place, components, apart, count)


@njit(error_model="numpy", cache=True, counted=False)
def sweep_core(
    lane,
    lanes,
    sync,
    src,
    base,
    out,
    block,
    function,
    depth,
    backward,
    weights,
    offsets,
    coefficient,
    law,
    scale,
    rim,
    runs,
    interface,
    bonds,
    reach,
):
    """All parts of the core; in every other stage the last first: it meets what the last stage left in the cache.

    Each lane has a share of its own, the same in all steps, for the threads' caches may lie far apart. It claims some
    parts as it goes, and when it is through some of the others', so that one whose processor is busy otherwise does
    less.
    """
    count = count_parts(block, depth)
    for shift in range(lanes):
        owner = (lane + shift) % lanes
        first = owner * count // lanes
        share = (owner + 1) * count // lanes - first
        size = max(1, share // 8) if lanes > 1 else share
        claimed = claim(sync, owner) if lanes > 1 else 0
        while claimed * size < share:
            for i in range(claimed * size, min(share, (claimed + 1) * size)):
                number = first + (share - 1 - i if backward else i)
                if RARE and runs.size:
                    sweep_two_phases(
                        src,
                        base,
                        out,
                        block,
                        number,
                        depth,
                        function,
                        weights,
                        offsets,
                        coefficient,
                        law,
                        runs,
                        interface,
                    )
                elif RARE and bonds.places.shape[0]:
                    sweep_bonds(
                        src, base, out, block, number, depth, function, weights, offsets, coefficient, law, bonds, reach
                    )
                else:
                    sweep_part(
                        src,
                        base,
                        out,
                        block,
                        number,
                        depth,
                        NONE,
                        block[3],
                        function,
                        weights,
                        offsets,
                        coefficient,
                        law,
                    )
                if rim[1].size:
                    release(src, base, out, block, number, depth, NONE, block[3], law, scale, coefficient, rim)
            claimed = claim(sync, owner) if lanes > 1 else 1


@njit(error_model="numpy", cache=True, counted=False)
def share(lane, lanes, count):
    """Range of a lane among `count` pieces."""
    return lane * count // lanes, (lane + 1) * count // lanes


@njit(error_model="numpy", cache=True, counted=False)
def copy(array, copies, components):
    """Periodic copies."""
    size = array.size // components
    for c in range(components):
        for i in range(copies.shape[1]):
            array[c * size + copies[0, i]] = array[c * size + copies[1, i]]


@njit(error_model="numpy", cache=True, counted=False)
def run_start(nodes, i):
    """The first place from i on where another node begins."""
    while 0 < i < nodes.size and nodes[i] == nodes[i - 1]:
        i += 1
    return i


@njit(error_model="numpy", cache=True, counted=False)
def cut(
    lane,
    lanes,
    sync,
    src,
    base,
    out,
    scale,
    components,
    nodes,
    neighbours,
    weights,
    increments,
    coefficient,
    rule,
    ceiling,
):
    """Take back the absent bonds from `nodes` to `neighbours`; all those of a node belong to one lane."""
    if nodes.size == 0:
        return
    own = share(lane, lanes, nodes.size)
    apart = src.size // components
    for i in range(run_start(nodes, own[0]), run_start(nodes, own[1])):
        factor, mine, other = scale, coefficient[0], coefficient[0]
        if coefficient.size > 1:
            mine, other = coefficient[nodes[i]], coefficient[neighbours[i]]
            factor *= bond_factor(rule, mine, other)
        for column in range(components):
            difference = factor * bond_gap(
                rule, mine, other, src[nodes[i] + column * apart], src[neighbours[i] + column * apart], ceiling
            )
            for row in range(components):
                lost = weights[(i * components + row) * components + column] * difference
                out[nodes[i] + row * apart] -= lost
                if increments:
                    base[nodes[i] + row * apart] -= lost
    barrier(sync, lanes)


@njit(error_model="numpy", cache=True, counted=False)
def sweep_box(
    lane,
    lanes,
    sync,
    src,
    base,
    out,
    numbers,
    increments,
    backward,
    components,
    box,
    coefficient,
    rule,
    cuts,
    rim,
    runs,
    interface,
    bonds,
    reach,
):
    """``out = a*src + b*base + scale*L(src)`` on all nodes, with plain shifts; `box`: see `Engine`."""
    block, function, depth, weights, offsets, general = box
    law = (general, numbers[0], numbers[1], numbers[2], increments, rule, components, interface[1])
    sweep_core(
        lane,
        lanes,
        sync,
        src,
        base,
        out,
        block,
        function,
        depth,
        backward,
        weights,
        offsets,
        coefficient,
        law,
        numbers[3],
        rim,
        runs,
        interface,
        bonds,
        reach,
    )
    barrier(sync, lanes)
    cut(
        lane,
        lanes,
        sync,
        src,
        base,
        out,
        numbers[3],
        components,
        cuts[0],
        cuts[1],
        cuts[2],
        increments,
        coefficient,
        rule,
        interface[1],
    )


@njit(error_model="numpy", cache=True, counted=False)
def stage(
    lane,
    lanes,
    sync,
    src,
    base,
    out,
    numbers,
    increments,
    backward,
    slots,
    memory,
    scratch,
    components,
    box,
    layers,
    copies,
    coefficient,
    rule,
    cuts,
    rim,
    runs,
    interface,
    bonds,
    reach,
):
    """``out = a*src + b*base + scale*L(src)`` everywhere; fills the halo of `src` and advances the layers' memory to
    its time.

    numbers = (a, a for differences, b, scale, source scale).
    """
    if copies.shape[1]:
        if lane == 0:
            copy(src, copies, components)
        barrier(sync, lanes)
    continue_lines(lane, lanes, sync, src, layers, slots, memory, scratch[lane], components)
    sweep_box(
        lane,
        lanes,
        sync,
        src,
        base,
        out,
        numbers,
        increments,
        backward,
        components,
        box,
        coefficient,
        rule,
        cuts,
        rim,
        runs,
        interface,
        bonds,
        reach,
    )
    material = coefficient if rule != PHASES else coefficient[:1]  # all is liquid in and beside layers
    for axis in range(2, -1, -1):
        add_layers(
            lane,
            lanes,
            sync,
            axis,
            src,
            base,
            out,
            numbers[3],
            increments,
            layers,
            slots,
            memory,
            scratch[lane],
            components,
            material,
            rule,
        )


@njit(error_model="numpy", cache=True, counted=False)
def tie(src, base, out, increments, tied, starts, sources, weights, fields, times):
    """Prescribed nodes: a combination of other nodes, those from `starts` on, plus fields times amplitudes; in
    order."""
    for i in range(tied.size):
        total = out[tied[i]] * 0
        for k in range(starts[i], starts[i + 1]):
            total += weights[k] * out[sources[k]]
        for j in range(fields.shape[0]):
            total += times[j] * fields[j, i]
        out[tied[i]] = total
        if increments:
            base[tied[i]] = total - src[tied[i]]


@njit(error_model="numpy", cache=True, counted=False)
def add_to(flows, row, gain):
    """Add to flows[0, row]; flows[1] holds the rounding of the sums (Neumaier)."""
    total = flows[0, row] + gain
    flows[1, row] += (
        (flows[0, row] - total) + gain if abs(flows[0, row]) >= abs(gain) else (gain - total) + flows[0, row]
    )
    flows[0, row] = total


@njit(error_model="numpy", cache=True, counted=False)
def book(src, books, nodes, neighbours, weights, effect, flows, coefficient, rule, ceiling):
    """Add what flows along bonds into `nodes` to the flows, book by book; a neighbour below 0 is at zero."""
    for i in range(books.size):
        here = np.float64(src[nodes[i]])
        gain = -effect * weights[i] * here
        if neighbours[i] >= 0:
            mine, other, factor = coefficient[0], coefficient[0], 1.0
            if coefficient.size > 1:
                mine, other = coefficient[nodes[i]], coefficient[neighbours[i]]
                factor = bond_factor(rule, mine, other)
            gain = (
                effect
                * weights[i]
                * bond_gap(rule, mine, other, here, np.float64(src[neighbours[i]]), np.float64(ceiling))
                * factor
            )
        add_to(flows, books[i], gain)


@njit(error_model="numpy", cache=True, counted=False)
def book_layers(
    lane, lanes, sync, src, sides, nodes, inflow, effect, flows, layers, slots, memory, scratch, coefficient, rule
):
    """Add what layers without memory bring to the nodes of the core next to them; sides[i] = (axis, book, first node,
    last node + 1).

    `inflow` is a level to work in. The slots are those of `src`.
    """
    for axis in range(3):
        if lane == 0:
            inflow[:] = 0
        barrier(sync, lanes)
        add_layers(
            lane,
            lanes,
            sync,
            axis,
            src,
            inflow,
            inflow,
            inflow.dtype.type(1),
            False,
            layers,
            slots,
            memory,
            scratch,
            1,
            coefficient,
            rule,
        )
        if lane == 0:
            for i in range(sides.shape[0]):
                if sides[i, 0] == axis:
                    for k in range(sides[i, 2], sides[i, 3]):
                        add_to(flows, sides[i, 1], effect * np.float64(inflow[nodes[k]]))
        barrier(sync, lanes)


@njit(error_model="numpy", cache=True, counted=False)
def book_ends(books, forces, effect, flows):
    """Add what exact ends bring to their drivers, whose books are books[end, m], none below 0."""
    for end in range(books.shape[0]):
        for m in range(books.shape[1]):
            if books[end, m] >= 0:
                add_to(flows, books[end, m], effect * forces[end, m])


@njit(error_model="numpy", nogil=True, cache=True, counted=False)
def run(
    lane,
    lanes,
    sync,
    steps,
    phase,
    levels,
    stages,
    numbers,
    increments,
    slots,
    memory,
    scratch,
    components,
    block,
    function,
    depth,
    weights,
    offsets,
    general,
    layers,
    copies,
    coefficient,
    rule,
    cuts,
    rim,
    runs,
    interface,
    bonds,
    reach,
    work,
    solids,
    volumes,
    changed,
    dissolved,
    total,
    saturation,
    period,
    steps_before,
    damped,
    damp_before,
    damp_after,
    damp_leak,
    ends,
    tied,
    tied_starts,
    tied_sources,
    tied_weights,
    books,
    book_nodes,
    book_neighbours,
    book_weights,
    book_effects,
    end_books,
    layer_books,
    layer_nodes,
    inflow,
    flows,
    fringe,
    short_waves,
    source_nodes,
    source_fields,
    source_times,
    held,
    held_times,
    tied_fields,
    tied_times,
    watched,
    seen,
):
    """One lane's share of `steps` steps from the rotation `phase`.

    After them the level ``stages[(phase + steps) % rotations, 0, 0]`` holds the state, where stages[phase, stage] =
    (in, base, out) are level numbers; numbers[stage] as in `stage`. source_times[step, stage, j] multiplies
    source_fields[j] on source_nodes. `ends`: the last arguments of `ends.exact_ends`; `fringe`: those of
    `fringe.close_fringe`; `short_waves`: those of `filter.damp_short_waves`. After each step the nodes `held` have the
    values ``held_times[step]``, and those of the nodes `watched` are copied to ``seen[step]``. From solids to
    steps_before, and `runs` and `interface`: see `engine.phases`; `bonds`: see `engine.bonds`; `work` is where that of
    sources is added up, where it is wanted.
    """
    per_step = stages.shape[1]
    bounded = ends[2].shape[0] > 0
    known = total[0]
    for step in range(steps):
        for part in range(per_step):
            src = levels[stages[phase, part, 0]]
            base = levels[stages[phase, part, 1]]
            out = levels[stages[phase, part, 2]]
            scale, source_scale = numbers[part, 3], numbers[part, 4]
            if damped.size:
                for i in range(lane, damped.size, lanes):
                    node = damped[i]
                    if increments:
                        base[node] *= damp_before[i]
                    else:
                        base[node] = src[node] - (src[node] - base[node]) * damp_before[i]
                barrier(sync, lanes)
            box = (block, function, depth, weights[part], offsets, general[part])
            stage(
                lane,
                lanes,
                sync,
                src,
                base,
                out,
                numbers[part],
                increments,
                (phase + part) % 2 == 1,
                slots,
                memory,
                scratch,
                components,
                box,
                layers,
                copies,
                coefficient,
                rule,
                cuts,
                rim,
                runs,
                interface,
                bonds,
                reach,
            )
            if RARE and bounded:
                if lane == 0:
                    exact_ends(src, base, out, scale, increments, *ends)
                    book_ends(end_books, ends[8], book_effects[part], flows)
                barrier(sync, lanes)
            if source_fields.shape[0]:
                for j in range(source_fields.shape[0]):
                    amplitude = source_scale * source_times[step, part, j]
                    if amplitude != 0:
                        for i in range(lane, source_nodes.size, lanes):
                            gain = amplitude * source_fields[j, i]
                            out[source_nodes[i]] += gain
                            if increments:
                                base[source_nodes[i]] += gain
                barrier(sync, lanes)
            if damped.size:
                for i in range(lane, damped.size, lanes):
                    node = damped[i]
                    out[node] = src[node] + (out[node] - src[node]) * damp_after[i] - scale * damp_leak[i] * src[node]
                    if increments:
                        base[node] = out[node] - src[node]
                barrier(sync, lanes)
            if short_waves[4].size:
                size = src.size // components
                for c in range(components):
                    damp_short_waves(
                        lane,
                        lanes,
                        sync,
                        src[c * size : (c + 1) * size],
                        base[c * size : (c + 1) * size],
                        out[c * size : (c + 1) * size],
                        increments,
                        *short_waves,
                    )
            if held.size:
                for i in range(lane, held.size, lanes):
                    node = held[i]
                    out[node] = held_times[step, i]
                    if increments:
                        base[node] = out[node] - src[node]
                barrier(sync, lanes)
            if RARE and work.size and source_fields.shape[0]:
                book_work(lane, lanes, work, base, out, source_nodes, source_fields, source_times[step, part])
            if inflow.size and book_effects[part] != 0:
                book_layers(
                    lane,
                    lanes,
                    sync,
                    src,
                    layer_books,
                    layer_nodes,
                    inflow,
                    book_effects[part],
                    flows,
                    layers,
                    slots,
                    memory,
                    scratch[lane],
                    coefficient if rule != PHASES else coefficient[:1],
                    rule,
                )
            if books.size or tied.size:
                if lane == 0:
                    if books.size and book_effects[part] != 0:
                        book(
                            src,
                            books,
                            book_nodes,
                            book_neighbours,
                            book_weights,
                            book_effects[part],
                            flows,
                            coefficient,
                            rule,
                            interface[1],
                        )
                    if tied.size:
                        tie(
                            src,
                            base,
                            out,
                            increments,
                            tied,
                            tied_starts,
                            tied_sources,
                            tied_weights,
                            tied_fields,
                            tied_times[step, part],
                        )
                barrier(sync, lanes)
            if RARE and fringe[0].size:
                close_fringe(lane, lanes, sync, src, base, out, increments, *fringe)
        if RARE and runs.size:
            dissolve(
                lane,
                lanes,
                levels[stages[phase, per_step - 1, 2]],
                coefficient,
                dissolved,
                total,
                steps_before + step + 1,
                block,
                solids,
                changed,
                saturation,
                period,
                runs,
                reach,
            )
            barrier(sync, lanes)
            if total[0] != known:
                known = total[0]
                find_runs(lane, lanes, solids, volumes, changed, runs)
                barrier(sync, lanes)
                if copies.shape[1]:
                    if lane == 0:
                        copy(coefficient, copies, ONE)
                    barrier(sync, lanes)
        state = levels[stages[phase, per_step - 1, 2]]  # the next step does not write it before its first barrier
        for i in range(lane, watched.size, lanes):
            seen[step, i] = state[watched[i]]
        phase = (phase + 1) % stages.shape[0]

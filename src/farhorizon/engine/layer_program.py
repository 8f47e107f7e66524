"""The operations of the time loop on layers, see `engine.layers`.

Like those of `engine.program` they are compiled when a run first needs them; so are the functions that they call by
address (`tables.Sums`), which not all runs need: for edges, bonds with coefficients, and absent bonds.

Functions that are called for every column work with addresses only: Numba counts the references to arrays that it
passes on, which takes longer than the work. A thread's work space has rows of `LINES` values: parts of a face, results
of shifts, what edges add, parts of an edge, and factors of bonds.
"""

import numpy as np

from farhorizon.engine.bonds import bond_factor
from farhorizon.engine.codegen.calls import call_with
from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.codegen.layer_sums import call_bands, call_crossing, call_mirrored
from farhorizon.engine.codegen.shifts import call_parts, call_shifts
from farhorizon.engine.codegen.vector_operations import TURNED, add_lines, clear, fetch, turn
from farhorizon.engine.layers import (
    AXIS,
    BAND_MEMORY,
    BASE,
    COLUMNS,
    CUTS,
    EDGE_CELLS,
    EDGE_FACE,
    EDGE_KINDS,
    EDGE_MEMORY,
    EDGE_OTHER,
    EDGE_SUMS,
    INWARDS,
    KIND_CELLS,
    KIND_FIRST,
    KIND_INWARDS,
    KIND_OUTWARDS,
    KIND_PARTS,
    KIND_REACH,
    LINE,
    LINES,
    MEMORY,
    NO_SLOT,
    OF_BANDS,
    OF_EDGES,
    ORIGIN,
    OUTWARDS,
    PARTS,
    PLANE,
    PROFILE,
    REACH,
    ROW,
    ROW_STEP,
    ROWS,
    SETS,
    SLOT,
    SLOT_ROW,
    SLOT_STEP,
    STEP,
    SUMS,
    TILE_BAND,
    TILE_COLUMN,
    TILE_COUNT,
    TILE_FIRST,
    TILE_PLACE,
    TILE_VECTORS,
    WIDTH,
)
from farhorizon.engine.tables import ABSENT, EDGE, FACE
from farhorizon.engine.threads import barrier, chunk_of

_TOGETHER = 128  # lines of a plane that are processed together
_GOLDEN = -7046029254386353131  # 2^64 over the golden ratio, as a signed number


@njit(error_model="numpy", cache=True, counted=False)
def address(array):
    """Byte address of an array."""
    return np.int64(array.ctypes.data)


@njit(error_model="numpy", cache=True, counted=False)
def fetch_lines(start, size):
    """Prefetch so many bytes, which are needed soon and which the hardware prefetcher would notice too late."""
    for place in range(start, start + size, 64):
        fetch(place)


@njit(error_model="numpy", cache=True, counted=False)
def dither(step):
    """Number that is added in a step to the second halves of numbers before these are dropped: multiples of the golden
    ratio, which are spread most evenly over any number of steps.
    """
    return (step * _GOLDEN >> 32) & ((1 << 32) - 1)


@njit(error_model="numpy", cache=True, counted=False)
def stretch_of(layers, profile):
    """Addresses of the tables r, e and f of a layer."""
    return address(layers.r[profile]), address(layers.e[profile]), address(layers.f[profile])


@njit(error_model="numpy", cache=True, counted=False)
def weigh(layers, function, number, source, slot, band, to, step, vectors, least):
    """Compute the sums `number` from k = `least` on, for a tile. `source` holds the addresses of its first node in the
    level and of the factors of bonds, `slot` that of its place in a band.
    """
    many = layers.ends.shape[1] * 8
    ends, weights = address(layers.ends) + 3 * number * many, address(layers.weights)
    places, factors, apart = address(layers.places), address(layers.factors), layers.weights.strides[0]
    call_parts(function, (to, step), source, (ends, places, factors, weights, apart), vectors, least, 0)
    if band >= 0:
        ends += (1 + band) * many
        call_parts(function, (to, step), (slot, source[1]), (ends, places, factors, weights, apart), vectors, least, 1)


@njit(error_model="numpy", cache=True, counted=False)
def weigh_bonds(sums, worker, span, node, count):
    """Compute the factors of the bonds of some nodes across an axis; return the address of the first. All columns of a
    layer have the same factors, as coefficients do not vary along its normal.
    """
    layers, material, work = sums.layers, sums.liquid, sums.work_space[worker]
    coefficient, rule, first = material.coefficient, material.rule, layers.sizes[10] * LINES
    for number in range(layers.spans[span], layers.spans[span + 1]):
        place, neighbour = first + (number - layers.spans[span]) * LINES, node + layers.neighbours[number]
        for i in range(count):
            work[place + i] = bond_factor(rule, coefficient[node + i], coefficient[neighbour + i])
        work[place + count : place + LINES] = 0
    return address(work) + first * work.itemsize


def continue_band(thread, stage, sums, tables, inputs, step, number):
    """Fill the slots of a band, the number, from a level whose halo is complete: continue the field on all its lines,
    side by side, and advance the memory. What other threads fill is read only after the next barrier, see `meet`.
    """
    layers, work = sums.layers, sums.work_space[thread.number]
    src, components, slots, memory = stage.src, stage.components, layers.slots, layers.memory
    band, sizes = layers.bands[number], layers.sizes
    columns, m, sets, ahead, width = band[COLUMNS], band[REACH], band[SETS], band[STEP], band[WIDTH]
    group, size, like = sizes[7], src.itemsize, work[0]
    each = (sizes[1] + group - 1) // group
    groups, vectors, row, sign = sizes[0] * each, group * size // 64, LINES * size, 1 if ahead > 0 else -1
    start = address(work)
    # Columns are in their order in memory: those of the field from `first` on, those of the slots from the same one or
    # the next on.
    first, zero = (band[ORIGIN] - m, start + m * row) if ahead > 0 else (band[ORIGIN] - columns, start + columns * row)
    middle = (m - 1 if ahead > 0 else columns) * m * row
    shifted, far = start + sizes[5] * row, (sets - 1) * (sizes[5] // 2) * row
    stretch = stretch_of(layers, band[PROFILE])
    apart, cells, cell = src.size // components, (2 * columns + 1) * m, layers.cell * group
    clear(shifted + (columns + m) * m * row, (width - columns - m) * m * LINES, like)
    if sets == 2:
        clear(shifted + far, width * m * LINES, like)
    chunk, dithered = chunk_of(thread, components * groups), dither(inputs.before[0] + step)
    for item in range(chunk[0], chunk[1]):
        c, x, y = item // groups, item % groups // each, item % each * group
        count = min(group, sizes[1] - y)
        at = address(src) + (c * apart + first + x * band[PLANE] + y * band[ROW]) * size
        memo = address(memory) + layers.cell * (band[BAND_MEMORY] + item * group * cells)
        for i in range(group, 2 * group):  # the next lines lie too far apart for the hardware prefetcher
            for column in range(0, columns + m + 1, 64 // size):
                fetch(at + (i * band[ROW] + column) * size)
        for i in range(0, count, TURNED):
            for column in range(0, columns + m + 1, TURNED):
                turn(
                    at + (i * band[ROW] + column) * size,
                    band[ROW] * size,
                    min(count - i, TURNED) - 1,
                    start + column * row + i * size,
                    row,
                    TURNED - 1,
                    like,
                )
        if sets == 2:
            clear(shifted + far, (columns + m) * m * LINES, like)
        fetch_lines(memo + group * cells * layers.cell, group * cells * layers.cell)
        line, inwards = (zero, sign * row, 0), memo + (columns + 1) * m * cell
        on, back = (shifted + middle, sign * m * row, row), (shifted + far + middle, sign * m * row, row)
        call_shifts(band[OUTWARDS], line, on, (memo, cell, dithered), stretch, columns, vectors)
        call_shifts(band[INWARDS], line, back, (inwards, cell, dithered), stretch, columns, vectors)
        for k in range(m * sets):
            slot = band[BASE] + ((c * sets * m + k) * sizes[2] + sizes[3] + x * band[LINE] + y) * width
            source = shifted + (k // m) * far + k % m * row
            for i in range(0, count, TURNED):
                for column in range(0, width, TURNED):
                    turn(
                        source + column * m * row + i * size,
                        m * row,
                        TURNED - 1,
                        address(slots) + (slot + i * width + column) * size,
                        width * size,
                        min(count - i, TURNED) - 1,
                        like,
                    )


@njit(error_model="numpy", cache=True, counted=False)
def slot_steps(layers, number, size):
    """Distances in a band's slots, in bytes: between fields, between components, and to the fields that serve
    neighbours ahead and behind.
    """
    if number < 0:
        return 0, 0, 0, 0
    band = layers.bands[number]
    step = layers.sizes[2] * band[WIDTH] * size
    far = (band[SETS] - 1) * band[REACH] * step
    return step, step * band[REACH] * band[SETS], 0 if band[STEP] > 0 else far, far if band[STEP] > 0 else 0


def add_bands(thread, stage, sums, tables, inputs, step, number):
    """Add what the layers along the last axis, whose slots are filled, contribute to all nodes in their bands: to
    ``out``, and to ``base`` where that holds increments.

    Threads write to the same nodes along different axes, so they meet after each axis.
    """
    layers, work = sums.layers, sums.work_space[thread.number]
    src, base, out, slots = stage.src, stage.base, stage.out, layers.slots
    scale, varied = stage.scale * layers.unit, sums.liquid.coefficient.size > 1
    sizes, size = layers.sizes, src.itemsize
    apart, to = src.size // stage.components, address(work)
    olds, news, extra = address(base), address(out), address(slots)
    for t in range(layers.tiles.shape[0]):
        tile = layers.tiles[t]
        side, count = tile[TILE_BAND], tile[TILE_COUNT]
        if side < 0:
            continue
        band = layers.bands[side]
        width = band[WIDTH]
        # Narrow bands, whose lines are neighbours, are summed several lines at a time: the same ones with any number of
        # threads, as rounding depends on it.
        several = LINES // width if width <= LINES and not varied else 1
        each = (sizes[1] + several - 1) // several
        chunk = chunk_of(thread, sizes[0] * each)
        for group in range(chunk[0], chunk[1]):
            x, y = group // each, group % each * several
            together = min(several, sizes[1] - y)
            node, slot = place_in_band(layers, t, x, y)
            vectors = together * width * size // 64 if several > 1 else tile[TILE_VECTORS]
            factors = weigh_bonds(sums, thread.number, OF_BANDS, node, count) if varied else to
            for i in range(several, 2 * several):
                fetch(news + (node + i * band[ROW]) * size)
                fetch(news + (node + i * band[ROW] + count - 1) * size)
            for c in range(stage.rows):
                source = to, factors  # there are no terms in the level
                weigh(layers, band[PARTS], sizes[4] + c, source, extra + slot * size, side, to, 0, vectors, 1)
                for i in range(together):
                    place = (node + c * apart + i * band[ROW]) * size
                    add_lines(to + i * width * size, news + place, scale, count)
                    if stage.increments:
                        add_lines(to + i * width * size, olds + place, scale, count)
    barrier(thread)


@njit(error_model="numpy", cache=True, counted=False)
def place_in_band(layers, t, x, y):
    """Place of the first node of a line in tile t of a band, in the level and among the slots."""
    tile, sizes = layers.tiles[t], layers.sizes
    band = layers.bands[tile[TILE_BAND]]
    node = sizes[8] + x * band[PLANE] + y * band[ROW] + tile[TILE_FIRST]
    return node, band[BASE] + (sizes[3] + x * band[LINE] + y) * band[WIDTH] + tile[TILE_COLUMN]


def add_mirrored_bands(thread, stage, sums, tables, inputs, step, number):
    """Do the same for a mirror-symmetric stencil, piece by piece of a plane. What a node gets does not depend on where
    the pieces end.
    """
    layers, work, size = sums.layers, sums.work_space[thread.number], stage.src.itemsize
    apart, planes, lines = stage.src.size // stage.components * size, layers.sizes[0], layers.sizes[1]
    olds, news, extra = address(stage.base), address(stage.out), address(layers.slots)
    function, weights = layers.mirrored[2, 1, 0], address(layers.mirrored_weights) + layers.mirrored[2, 1, 1] * size
    work[0] = stage.scale * layers.unit
    pieces = (lines + _TOGETHER - 1) // _TOGETHER
    chunk = chunk_of(thread, planes * pieces)
    for t in range(layers.tiles.shape[0]):
        side = layers.tiles[t, TILE_BAND]
        if side < 0:
            continue
        apiece, shift, ahead, behind = slot_steps(layers, side, size)
        row, line = layers.bands[side, ROW] * size, layers.bands[side, WIDTH] * size
        for piece in range(chunk[0], chunk[1]):
            x, y = piece // pieces, piece % pieces * _TOGETHER
            node, slot = place_in_band(layers, t, x, y)
            here = extra + slot * size
            call_bands(
                function,
                (news + node * size, olds + node * size if stage.increments else 0, row, apart),
                (here + ahead, here + behind),
                (layers.bands[side, LINE] * line, line, shift, apiece),
                (weights, address(work)),
                (min(_TOGETHER, lines - y), layers.tiles[t, TILE_COUNT]),
            )
    barrier(thread)


@njit(error_model="numpy", cache=True, counted=False)
def take_bond(sums, src, work, to, weight, at, distances):
    """Subtract an absent bond from a number of the work space. `at` holds its node and its place in the slots, or -1;
    `distances` are those to the neighbour, to its slot, if any, and to its coefficient.
    """
    near, far, to_coefficient = distances
    node, slot = at
    material = sums.liquid
    value = src[node + near]
    if slot >= 0 and far != NO_SLOT:
        value += sums.layers.slots[slot + far]
    if material.coefficient.size > 1:
        weight *= bond_factor(material.rule, material.coefficient[node], material.coefficient[node + to_coefficient])
    work[to] -= weight * value


@njit(error_model="numpy", cache=True, counted=False)
def take_edge_cuts(sums, src, work, cuts, which, node, slot, band, parts):
    """Subtract the absent bonds of an edge from the parts on one column of the second axis' layer. `which` holds the
    set and k - 1 of the first axis, whether inwards, and the column.
    """
    layers = sums.layers
    for i in range(layers.edge_cut_ranges[cuts], layers.edge_cut_ranges[cuts + 1]):
        place, number, a, inward, k, near, far, to_coefficient = layers.edge_cuts[i]
        if number != which[0] or a != which[1] or inward != which[2] or k < -which[3] - 1:
            continue
        to, at = (parts + k) * LINES + place, (node + place, slot + place if band >= 0 else -1)
        take_bond(sums, src, work, to, layers.edge_cut_weights[i], at, (near, far, to_coefficient))


@njit(error_model="numpy", cache=True, counted=False)
def edge_parts(face, other):
    """Numbers of rows of work space for the parts of an edge: of a component, of a set, and of one direction along the
    second axis. The latter are ordered by its column, from -reach on, then by k - 1.
    """
    of_inward = (other[COLUMNS] + other[REACH] + 1) * other[REACH]
    return face[SETS] * other[SETS] * of_inward, other[SETS] * of_inward, of_inward


@njit(error_model="numpy", cache=True, counted=False)
def sum_crossings(stage, sums, place, a, steps, node, slot, band, vectors):
    """Compute all parts of distance `a` + 1 along the first axis on a column of an edge at once, for a mirror-symmetric
    stencil. All places are addresses. `place` is that of the first component's part that lies upwards along both axes;
    `steps` are the distances from it to those downwards along each axis, of the next component and of the next k.
    """
    layers, size = sums.layers, stage.src.itemsize
    weights, apart = address(layers.mirrored_weights), stage.src.size // stage.components * size
    to = place, steps[0], steps[1], steps[2], steps[3]
    function, first = layers.mirrored[3 + a, 0]
    call_crossing(function, to, (node, 0), (apart, 0), weights + first * size, vectors)
    function, first = layers.mirrored[3 + a, 1]
    if band >= 0 and function != 0:
        step, shift, ahead, behind = slot_steps(layers, band, size)
        call_crossing(function, to, (slot + ahead, slot + behind), (shift, step), weights + first * size, vectors)


@njit(error_model="numpy", cache=True, counted=False)
def sum_edge(stage, sums, worker, number, t, a, p, factors):
    """Compute the parts of distance `a` + 1 along the first axis on its column `p`, on all columns of the second."""
    layers, work, varied = sums.layers, sums.work_space[worker], sums.liquid.coefficient.size > 1
    edge, tile, sizes, rows = layers.edges[number], layers.tiles[t], layers.sizes, stage.rows
    face, other = layers.faces[edge[EDGE_FACE]], layers.faces[edge[EDGE_OTHER]]
    kind, band, vectors = layers.kinds[edge[EDGE_KINDS] + a], tile[TILE_BAND], tile[TILE_VECTORS]
    m, n, sets, inwards, most = face[REACH], other[REACH], face[SETS], other[SETS], kind[KIND_REACH]
    size, start = stage.src.itemsize, address(work)
    row, width = LINES * size, layers.bands[max(band, 0), WIDTH]
    of_row, of_set, of_inward = edge_parts(face, other)
    corner = face[ORIGIN] + (other[ORIGIN] - sizes[8]) + tile[TILE_FIRST]  # column 0 of both
    line = layers.bands[max(band, 0), BASE] + (face[SLOT] + other[SLOT] - sizes[3]) * width + tile[TILE_COLUMN]
    up = 1 if face[STEP] > 0 else -1, 1 if other[STEP] > 0 else -1
    steps = of_set * row * up[0], of_inward * row * up[1], of_row * row, row
    first = (0 if up[0] > 0 else (sets - 1) * of_set) + (0 if up[1] > 0 else (inwards - 1) * of_inward)
    for q in range(-most, other[COLUMNS] + 1):
        node = corner + p * face[STEP] + q * other[STEP]
        slot = line + (p * face[SLOT_STEP] + q * other[SLOT_STEP]) * width
        place = sizes[11] + (q + n) * n
        source, slots = address(stage.src) + node * size, address(layers.slots) + slot * size
        mirrored = not varied and layers.mirrored[3 + a, 0, 0] != 0
        if mirrored:
            sum_crossings(stage, sums, start + (place + first) * row, a, steps, source, slots, band, vectors)
        for c in range(0 if mirrored and layers.edge_cuts.shape[0] == 0 else rows):
            cuts = (number * rows + c) * layers.tiles.shape[0] + t
            for which in range(0 if p >= 0 else sets - 1, sets):
                sum_number = edge[EDGE_SUMS] + ((c * sets + which) * m + a) * inwards
                for inward in range(0 if q >= 0 else inwards - 1, inwards):
                    to = place + c * of_row + which * of_set + inward * of_inward
                    if not mirrored:
                        weigh(
                            layers,
                            kind[KIND_PARTS],
                            sum_number + inward,
                            (source, factors),
                            slots,
                            band,
                            start + to * row,
                            row,
                            vectors,
                            max(1, -q),
                        )
                    if layers.edge_cuts.shape[0]:
                        take_edge_cuts(sums, stage.src, work, cuts, (which, a, inward, q), node, slot, band, to)


def stretch_edge(stage, sums, worker, number, t, dithered):
    """Compute what the second axis' layer adds to the parts of the first one's, for the rows of an edge and one tile,
    into the row ((set * reach + k - 1) * columns + column of the first axis) * columns + column of the second
    of the work space for it, both counted from -reach.
    """
    layers, work, varied = sums.layers, sums.work_space[worker], sums.liquid.coefficient.size > 1
    edge, tile, sizes = layers.edges[number], layers.tiles[t], layers.sizes
    face, other = layers.faces[edge[EDGE_FACE]], layers.faces[edge[EDGE_OTHER]]
    m, n, sets, vectors, columns = face[REACH], other[REACH], face[SETS], tile[TILE_VECTORS], other[COLUMNS]
    size, start = stage.src.itemsize, address(work)
    row, wide, high = LINES * size, face[COLUMNS] + m + 1, columns + n + 1
    of_row, of_set, of_inward = edge_parts(face, other)
    stretch, cell = stretch_of(layers, other[PROFILE]), layers.cell * (vectors * 64 // size)
    corner = face[ORIGIN] + (other[ORIGIN] - sizes[8]) + tile[TILE_FIRST]
    factors = weigh_bonds(sums, worker, OF_EDGES, corner, tile[TILE_COUNT]) if varied else start
    for a in range(m):
        kinds = edge[EDGE_KINDS] + a
        most = layers.kinds[kinds, KIND_REACH]
        for p in range(-a - 1, face[COLUMNS] + 1 if most > 0 else -a - 1):
            sum_edge(stage, sums, worker, number, t, a, p, factors)
            for part in range(stage.rows * sets):
                c, which = part // sets, part % sets
                kind = layers.kinds[kinds + which * m]
                if p < kind[KIND_FIRST]:
                    continue
                past = (kind[KIND_CELLS] + (p - kind[KIND_FIRST]) * (2 * columns + 1) * most) * cell
                of_part = layers.cell * (edge[EDGE_MEMORY] + (c * sizes[6] + tile[TILE_PLACE]) * edge[EDGE_CELLS])
                memo = address(layers.memory) + of_part + past
                to = (stage.rows + 2) * sizes[5] + c * sizes[9] + ((which * m + a) * wide + p + m) * high
                zero, result = start + (sizes[11] + c * of_row + which * of_set + n * n) * row, start + to * row
                outer, inner = (zero, n * row, row), (zero + (of_set - of_inward) * row, n * row, row)
                total, back = (result + n * row, row, row), memo + (columns + 1) * most * cell
                call_shifts(kind[KIND_OUTWARDS], outer, total, (memo, cell, dithered), stretch, columns, vectors)
                call_shifts(kind[KIND_INWARDS], inner, total, (back, cell, dithered), stretch, columns, vectors)
                clear(result + row, (n - most) * LINES, work[0])


@njit(error_model="numpy", cache=True, counted=False)
def add_edge(stage, sums, worker, number, row, part, p, here):
    """Add what the other axis' layer contributes, as `stretch_edge` has left it, to the parts of a row of a face, of
    one component and set (`part`) and on one column; `here` is the first of their rows of work space.
    """
    layers, work, sizes, item = sums.layers, sums.work_space[worker], sums.layers.sizes, sums.layers.items[number]
    face, edge, vectors = layers.faces[item[0]], layers.edges[item[4]], layers.tiles[item[3], TILE_VECTORS]
    other, m, c, which = layers.faces[edge[EDGE_OTHER]], face[REACH], part // face[SETS], part % face[SETS]
    start, wide, lanes = address(work), LINES * work.itemsize, vectors * 64 // work.itemsize
    corner, side = (other[ORIGIN] - sizes[8]) // abs(other[STEP]), 1 if other[STEP] > 0 else -1
    first = (stage.rows + 2) * sizes[5] + c * sizes[9] + (row - corner) * side + other[REACH]
    for k in range(max(0, -p - 1), m):
        if layers.kinds[edge[EDGE_KINDS] + k, KIND_REACH] > 0:
            column = (which * m + k) * (face[COLUMNS] + m + 1) + p + m
            far = first + column * (other[COLUMNS] + other[REACH] + 1)
            add_lines(start + far * wide, start + (here + k) * wide, work.dtype.type(1), lanes)


@njit(error_model="numpy", cache=True, counted=False)
def sum_row(stage, sums, worker, number, row, coming):
    """Compute the parts of a row of a face on all columns; prefetch the next row's memory, which begins at `coming`."""
    layers, work, varied, rows = sums.layers, sums.work_space[worker], sums.liquid.coefficient.size > 1, stage.rows
    item, sizes, size = layers.items[number], layers.sizes, stage.src.itemsize
    face, tile = layers.faces[item[0]], layers.tiles[item[3]]
    columns, m, sets = face[COLUMNS], face[REACH], face[SETS]
    band, count, vectors = tile[TILE_BAND], tile[TILE_COUNT], tile[TILE_VECTORS]
    wide, start, half = LINES * size, address(work), sizes[5] // 2
    field, extra, olds, news = address(stage.src), address(layers.slots), address(stage.base), address(stage.out)
    apart, cells = stage.src.size // stage.components, (2 * columns + 1) * m
    of_row = layers.cell * sizes[6] * cells * face[ROWS]
    each = -(-cells * layers.cell * (vectors * 64 // size) // (columns + m + 1) // 64) * 64  # bytes per column
    width = layers.bands[max(band, 0), WIDTH]
    line = layers.bands[max(band, 0), BASE] + face[SLOT] * width + tile[TILE_COLUMN]
    function, band_function = layers.mirrored[face[AXIS], 0, 0], layers.mirrored[face[AXIS], 1, 0] if band >= 0 else 0
    weights = address(layers.mirrored_weights) + layers.mirrored[face[AXIS], 0, 1] * size
    band_weights = address(layers.mirrored_weights) + layers.mirrored[face[AXIS], 1, 1] * size
    mirrored = not varied and function != 0
    step, shift, ahead, behind = slot_steps(layers, band, size)
    on, back = (0, (sets - 1) * half * wide) if face[STEP] > 0 else ((sets - 1) * half * wide, 0)
    across, slots_across = face[ROW_STEP] * size, face[SLOT_ROW] * width * size
    first = face[ORIGIN] + row * face[ROW_STEP] + tile[TILE_FIRST]
    factors = weigh_bonds(sums, worker, face[AXIS], first, count) if varied else start
    complete = mirrored and item[4] < 0 and layers.cuts.shape[0] == 0
    for p in range(-m, columns + 1):
        node, to = first + p * face[STEP], (p + m) * m
        slot = line + (p * face[SLOT_STEP] + row * face[SLOT_ROW]) * width
        for c in range(rows):
            fetch_lines(news + (node + c * apart) * size, count * size)
            fetch_lines(field + (node + c * apart + (m + 1) * face[ROW_STEP]) * size, count * size)
            if stage.increments:
                fetch_lines(olds + (node + c * apart) * size, count * size)
            fetch_lines(coming + c * of_row, each)
        coming += each
        if mirrored:
            plus, minus, here = start + to * wide + on, start + to * wide + back, extra + slot * size
            sides = (plus, minus, wide, sizes[5] * wide)
            strides = (across, across, apart * size, 0)
            call_mirrored(function, sides, (field + node * size, 0), strides, weights, vectors)
            if band_function != 0:
                for k in range(stage.components * m * sets):  # the next row's: many, far apart
                    fetch_lines(here + k * step + (m + 1) * slots_across, width * size)
                strides = (slots_across, slots_across, shift, step)
                call_mirrored(band_function, sides, (here + ahead, here + behind), strides, band_weights, vectors)
        for part in range(0 if complete else rows * sets):
            c, which = part // sets, part % sets
            if p < 0 and which < sets - 1:
                continue
            here = c * sizes[5] + which * half + to
            if not mirrored:
                weigh(
                    layers,
                    face[PARTS],
                    face[SUMS] + part,
                    (field + node * size, factors),
                    extra + slot * size,
                    band,
                    start + here * wide,
                    wide,
                    vectors,
                    max(1, -p),
                )
            if item[4] >= 0:
                add_edge(stage, sums, worker, number, row, part, p, here)
            if layers.cuts.shape[0]:
                cuts = face[CUTS] + (c * face[ROWS] + row) * layers.tiles.shape[0] + item[3]
                call_with(sums.called[ABSENT], stage, sums, (worker, cuts, which, p, node, slot, band, here))


def stretch_face(stage, sums, worker, number, dithered):
    """Add what a face's layer contributes to some rows of one tile, on its columns and on those of the core next to it,
    and advance its memory.
    """
    layers, work, scale = sums.layers, sums.work_space[worker], stage.scale * sums.layers.unit
    item, sizes, size, rows = layers.items[number], layers.sizes, stage.src.itemsize, stage.rows
    face, tile = layers.faces[item[0]], layers.tiles[item[3]]
    columns, m, count, vectors = face[COLUMNS], face[REACH], tile[TILE_COUNT], tile[TILE_VECTORS]
    wide, start, memory = LINES * size, address(work), address(layers.memory)
    back, result = (face[SETS] - 1) * (sizes[5] // 2) * wide, start + ((rows + 1) * sizes[5] + m) * wide
    stretch, apart, cells = stretch_of(layers, face[PROFILE]), stage.src.size // stage.components, (2 * columns + 1) * m
    cell = layers.cell * (vectors * 64 // size)
    if item[4] >= 0:
        call_with(sums.called[EDGE], stage, sums, (worker, item[4], item[3], dithered))
    of_row = layers.cell * sizes[6] * cells
    for row in range(item[1], item[2]):
        first = face[ORIGIN] + row * face[ROW_STEP] + tile[TILE_FIRST]
        of_first = memory + layers.cell * (face[MEMORY] + (row * sizes[6] + tile[TILE_PLACE]) * cells)
        sum_row(stage, sums, worker, number, row, of_first + (of_row if face[ROWS] > 1 else cells * cell))
        for c in range(rows):
            memo, zero = of_first + c * face[ROWS] * of_row, start + (c * sizes[5] + m * m) * wide
            outer, inner, total = (zero, m * wide, wide), (zero + back, m * wide, wide), (result, wide, wide)
            inwards = memo + (columns + 1) * m * cell
            call_shifts(face[OUTWARDS], outer, total, (memo, cell, dithered), stretch, columns, vectors)
            call_shifts(face[INWARDS], inner, total, (inwards, cell, dithered), stretch, columns, vectors)
            for p in range(1 - m, columns + 1):
                place = (first + p * face[STEP] + c * apart) * size
                add_lines(result + p * wide, address(stage.out) + place, scale, count)
                if stage.increments:
                    add_lines(result + p * wide, address(stage.base) + place, scale, count)


def take_cuts(stage, sums, worker, cuts, which, p, node, slot, band, parts):
    """Subtract the absent bonds of a row of a face from the parts on one column."""
    layers, src, work = sums.layers, stage.src, sums.work_space[worker]
    for i in range(layers.cut_ranges[cuts], layers.cut_ranges[cuts + 1]):
        place, number, k, near, far, to_coefficient = layers.cuts[i]
        if number != which or k < -p - 1:
            continue
        to, at = (parts + k) * LINES + place, (node + place, slot + place if band >= 0 else -1)
        take_bond(sums, src, work, to, layers.cut_weights[i], at, (near, far, to_coefficient))


def take_band_cuts(thread, stage, sums, tables, inputs, step, number):
    """Subtract what the lines of bands have added for absent bonds; one thread does this."""
    if thread.number == 0:
        layers, material = sums.layers, sums.liquid
        coefficient, slots, scale = material.coefficient, layers.slots, stage.scale * layers.unit
        for i in range(layers.band_cuts.shape[0]):
            side, node, slot, c_node, c_neighbour = layers.band_cuts[i]
            w = scale * layers.band_cut_weights[i]
            if coefficient.size > 1:
                w *= bond_factor(material.rule, coefficient[c_node], coefficient[c_neighbour])
            for p in range(layers.bands[side, COLUMNS] + layers.bands[side, REACH]):
                stage.out[node + p] -= w * slots[slot + p]
                if stage.increments:
                    stage.base[node + p] -= w * slots[slot + p]
    barrier(thread)


def meet(thread, stage, sums, tables, inputs, step, number):
    """Wait until all slots are filled, in passes in which no sweep follows before they are read."""
    barrier(thread)


def copy_slots(thread, stage, sums, tables, inputs, step, number):
    """Copy the slots of bands that repeat others, once all are filled; the sweep that follows ends with a barrier, see
    also `meet`.
    """
    barrier(thread)
    if thread.number == 0:
        layers = sums.layers
        for i in range(layers.copies.shape[1]):
            layers.slots[layers.copies[0, i]] = layers.slots[layers.copies[1, i]]


def stretch_faces(thread, stage, sums, tables, inputs, step, number):
    """Add what the layers along an axis, the number, contribute; see `add_bands`."""
    ranges, dithered = sums.layers.item_ranges, dither(inputs.before[0] + step)
    for i in range(ranges[1 - number] + thread.number, ranges[2 - number], thread.threads):
        call_with(sums.called[FACE], stage, sums, (thread.number, i, dithered))
    barrier(thread)

"""The layers: what stretched shifts add to the sums that a sweep has made with plain ones.

A stencil is a sum of products of shifts. Where an axis has layers its shift by one node outwards is ``v = V q``,

    v(p) = q(p+1) + c(p),   c(p) = r (q(p) - v(p+1)) - N(p),   N <- e N + f (q(p) - v(p+1)),

on the edge between the columns p and p+1 of a layer, where column 0 is the last one of the core; inwards likewise. On
all other edges c is zero. So the stencil is swept over all nodes, those of the layers included, with plain shifts, and
the layers add sums over c, as follows.

- Along the first two axes in nested (Horner) form: ``sum_k V^k B_k = V (B_1 + V (B_2 + ...))`` takes one c, with one N,
  for each k, direction and edge, whatever the B_k, the parts of the stencil that reach k columns outwards, or inwards.
  Those are wanted on the columns of the layer and on the last reach + 1 of the core. Where faces of both axes meet, in
  an edge, the B_k of the first axis contain what the layers of the second add to them.
- Along the last axis, whose nodes are neighbours in memory, the fields ``V^k u`` are continued instead, line by line:
  ``slots`` holds what they have more than plain shifts, on a *band*: the columns of the layer and as many of the core
  as the stencil reaches. All sums across that axis read them as further lines.

Lines along the last axis are cut into *tiles* of up to `LINES` nodes, whose values go through side by side. Bands are
tiles of their own.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from farhorizon.engine.bonds import bond_factor
from farhorizon.engine.rows.compiled import njit
from farhorizon.engine.rows.layer_sums import call_mirrored
from farhorizon.engine.rows.vectors import TURNED, add_lines, call_parts, call_shifts, clear, fetch, turn
from farhorizon.engine.threads import barrier, share

#: Values that go through side by side.
LINES = 32

# Columns of tables.
AXIS, PROFILE, COLUMNS, REACH, SETS, ORIGIN, STEP, OUTWARDS, INWARDS, PARTS = range(10)  # of a face and of a band
ROWS, ROW_STEP, SLOT, SLOT_STEP, SLOT_ROW, SUMS, MEMORY, CUTS = range(10, 18)  # of a face
WIDTH, BASE, BAND_MEMORY, PLANE, ROW, LINE = range(10, 16)  # of a band
TILE_FIRST, TILE_COUNT, TILE_VECTORS, TILE_BAND, TILE_COLUMN, TILE_PLACE = range(6)
EDGE_FACE, EDGE_OTHER, EDGE_SUMS, EDGE_MEMORY, EDGE_CELLS, EDGE_FIRST, EDGE_ROWS, EDGE_KINDS = range(8)
KIND_REACH, KIND_FIRST, KIND_CELLS, KIND_OUTWARDS, KIND_INWARDS, KIND_PARTS = range(6)  # of the parts of an edge


class Layers(NamedTuple):
    """What the compiled loop knows of the layers.

    Attributes
    ----------
    faces : ndarray of int, shape (F, 18)
        Layers along the first two axes: see `engine.layer_tables`.
    bands : ndarray of int, shape (2, 16)
        Those along the last axis, the low and the high one; no columns where there is none.
    edges : ndarray of int, shape (E, 8)
        Where two faces meet.
    kinds : ndarray of int, shape (n, 6)
        Of an edge, for each set and k of the first face: how far those parts reach along the second, the first column
        where they are wanted, the cells of memory before them, and the functions that they take.
    tiles : ndarray of int, shape (T, 6)
    items : ndarray of int, shape (n, 5)
        Pieces of work: face, first row, last row + 1, tile, edge or -1.
    item_ranges : ndarray of int, shape (3,)
        Items of the second axis, then of the first.
    ends : ndarray of int, shape (3 S, reach + 1)
        Sums: three rows each, for terms in the level, in the low and in the high band, of the ends of their groups of
        terms, see `vectors.weighted_parts`.
    places, materials : ndarray of int
        Of each term, the distance from a node to what it is taken of, in bytes, and to the coefficient there, in
        elements.
    weights : ndarray, shape (terms, reach)
    cuts : ndarray of int, shape (n, 6)
        Absent bonds: node of the tile, set, k - 1, distances to the neighbour, to its place in the band, to its
        coefficient.
    cut_weights : ndarray
    cut_ranges : ndarray of int
        Cuts of each component, row and tile of a face, from its `CUTS` on.
    band_cuts : ndarray of int, shape (n, 5)
        Of bands: band, first node, its place in the slots, and the two coefficients.
    band_cut_weights : ndarray
    copies : ndarray of int, shape (2, n)
        Of the slots, where an axis is periodic.
    r, e, f : ndarray, shape (layers, columns + 1)
    mirrored : ndarray of int, shape (3, 2, 2)
        Of stencils that go over into themselves in mirrors, for each axis, for terms in the level and in the bands: the
        function that sums all parts at once, or 0, and the first of its weights.
    mirrored_weights : ndarray
    sizes : ndarray of int, shape (10,)
        Lines along the first two axes, of a band with their halo, and to the first one; the first sum of the bands;
        rows of work space of the parts of a face; lanes of all tiles and of a group of lines; the place of the first
        node; rows of work space of an edge.
    cell : int
        Bytes of each number that layers remember; 0 where they have no memory.
    unit : float
        Sum of the weights' sizes, over which all weights here are taken.
    slots, memory : ndarray
        Values of the bands, and what the layers remember: see `engine.layer_tables`.
    """

    faces: np.ndarray
    bands: np.ndarray
    edges: np.ndarray
    kinds: np.ndarray
    tiles: np.ndarray
    items: np.ndarray
    item_ranges: np.ndarray
    ends: np.ndarray
    places: np.ndarray
    materials: np.ndarray
    weights: np.ndarray
    cuts: np.ndarray
    cut_weights: np.ndarray
    cut_ranges: np.ndarray
    band_cuts: np.ndarray
    band_cut_weights: np.ndarray
    copies: np.ndarray
    r: np.ndarray
    e: np.ndarray
    f: np.ndarray
    mirrored: np.ndarray
    mirrored_weights: np.ndarray
    sizes: np.ndarray
    cell: int
    unit: Any
    slots: np.ndarray
    memory: np.ndarray


# --- the compiled part ---------------------------------------------------------------------------------------------
# Where a function is called for every column there are addresses only: Numba counts the references to arrays that it
# passes on, which takes longer than the work. A thread's work space has rows of `LINES` values: parts of a face, parts
# of an edge, what is found, what an edge adds.


@njit(error_model="numpy", cache=True, counted=False)
def address(array):
    """Byte address of an array."""
    return np.int64(array.ctypes.data)


@njit(error_model="numpy", cache=True, counted=False)
def stretch_of(layers, profile):
    """Addresses of the tables of the edges of a layer."""
    return address(layers.r[profile]), address(layers.e[profile]), address(layers.f[profile])


@njit(error_model="numpy", cache=True, counted=False)
def weigh(tables, function, number, node, slot, band, to, step, vectors, least):
    """The sums `number` from k = `least` on, for a tile whose first node is at `node` in the level, and at `slot` where
    it lies in a band.

    All are addresses; tables: of `Layers.ends`, of its rows their length, of the places, the weights and theirs.
    """
    ends, row, places, weights, weight_step = tables
    call_parts(function, to, step, node, ends + 3 * number * row, places, weights, weight_step, vectors, least, 0)
    if band >= 0:
        call_parts(
            function,
            to,
            step,
            slot,
            ends + (3 * number + 1 + band) * row,
            places,
            weights,
            weight_step,
            vectors,
            least,
            1,
        )


@njit(error_model="numpy", cache=True, counted=False)
def tables_of(layers):
    """What `weigh` takes."""
    rows, size = layers.ends.shape[1] * 8, layers.weights.itemsize
    return address(layers.ends), rows, address(layers.places), address(layers.weights), layers.weights.shape[1] * size


@njit(error_model="numpy", cache=True, counted=False)
def weigh_bonds(layers, number, sums, src, node, slot, band, work, to, count, material):
    """The same, of so many sums, where bonds have coefficients; places in arrays, `to` a row of the work space."""
    coefficient, rule, slots = material.coefficient, material.rule, layers.slots
    work[to * LINES : (to + sums) * LINES] = 0
    for part in range(1 if band < 0 else 2):
        ends = layers.ends[3 * number + (0 if part == 0 else 1 + band)]
        source, at = (src, node) if part == 0 else (slots, slot)
        for term in range(ends[0], ends[sums]):
            other, there = node + layers.materials[term], at + layers.places[term] // src.itemsize
            for k in range(sums):
                row, w = work[(to + k) * LINES : (to + k + 1) * LINES], layers.weights[term, k]
                if w != 0:
                    for i in range(count):
                        row[i] += (
                            w * bond_factor(rule, coefficient[node + i], coefficient[other + i]) * source[there + i]
                        )


@njit(error_model="numpy", cache=True, counted=False)
def continue_band(thread, number, stage, layers, work):
    """Fill the slots of a band: continue the field of all its lines, side by side, and advance the memory."""
    src, components, slots, memory = stage.src, stage.components, layers.slots, layers.memory
    band, sizes = layers.bands[number], layers.sizes
    columns, m, sets, step, width = band[COLUMNS], band[REACH], band[SETS], band[STEP], band[WIDTH]
    group, size, like = sizes[7], src.itemsize, work[0]
    each = (sizes[1] + group - 1) // group
    groups, vectors, row, sign = sizes[0] * each, group * size // 64, LINES * size, 1 if step > 0 else -1
    start = address(work)
    # Columns in their order in memory: those of the field from `first`, of the slots from the same one or the next of
    # them on.
    first, zero = (band[ORIGIN] - m, start + m * row) if step > 0 else (band[ORIGIN] - columns, start + columns * row)
    middle = (m - 1 if step > 0 else columns) * m * row
    found, far = start + sizes[5] * row, (sets - 1) * (sizes[5] // 2) * row
    stretch = stretch_of(layers, band[PROFILE])
    apart, cells, cell = src.size // components, (2 * columns + 1) * m, layers.cell * group
    clear(found + (columns + m) * m * row, (width - columns - m) * m * LINES, like)
    if sets == 2:
        clear(found + far, width * m * LINES, like)
    own = share(thread, components * groups)
    for item in range(own[0], own[1]):
        c, x, y = item // groups, item % groups // each, item % each * group
        count = min(group, sizes[1] - y)
        at = address(src) + (c * apart + first + x * band[PLANE] + y * band[ROW]) * size
        for i in range(group, 2 * group):  # the next lines: they lie too far apart for the hardware to notice
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
            clear(found + far, (columns + m) * m * LINES, like)
        memo = address(memory) + layers.cell * (band[BAND_MEMORY] + item * group * cells)
        line, inwards = (zero, sign * row, 0), memo + (columns + 1) * m * cell
        on, back = (found + middle, sign * m * row, row), (found + far + middle, sign * m * row, row)
        call_shifts(band[OUTWARDS], line, on, (memo, cell), stretch, columns, vectors)
        call_shifts(band[INWARDS], line, back, (inwards, cell), stretch, columns, vectors)
        for k in range(m * sets):
            here = band[BASE] + ((c * sets * m + k) * sizes[2] + sizes[3] + x * band[LINE] + y) * width
            source = found + (k // m) * far + k % m * row
            for i in range(0, count, TURNED):
                for column in range(0, width, TURNED):
                    turn(
                        source + column * m * row + i * size,
                        m * row,
                        TURNED - 1,
                        address(slots) + (here + i * width + column) * size,
                        width * size,
                        min(count - i, TURNED) - 1,
                        like,
                    )


@njit(error_model="numpy", cache=True, counted=False)
def slot_steps(layers, number, size):
    """Of a band's slots, in bytes: the distances of fields and of components, and how far those lie that serve
    neighbours ahead and behind.
    """
    if number < 0:
        return 0, 0, 0, 0
    band = layers.bands[number]
    step = layers.sizes[2] * band[WIDTH] * size
    far = (band[SETS] - 1) * band[REACH] * step
    return step, step * band[REACH] * band[SETS], 0 if band[STEP] > 0 else far, far if band[STEP] > 0 else 0


@njit(error_model="numpy", cache=True, counted=False)
def add_bands(thread, stage, layers, work, material):
    """Add what the layers along the last axis contribute to all nodes in their bands."""
    src, base, out, slots = stage.src, stage.base, stage.out, layers.slots
    scale, coefficient = stage.scale * layers.unit, material.coefficient
    sizes, size = layers.sizes, src.itemsize
    apart, to = src.size // stage.components, address(work)
    tables = tables_of(layers)
    olds, news, extra = address(base), address(out), address(slots)
    function, weights = layers.mirrored[2, 1, 0], address(layers.mirrored_weights) + layers.mirrored[2, 1, 1] * size
    sums = coefficient.size == 1 and function != 0
    for t in range(layers.tiles.shape[0]):
        tile = layers.tiles[t]
        number, count = tile[TILE_BAND], tile[TILE_COUNT]
        if number < 0:
            continue
        band = layers.bands[number]
        step, shift, ahead, behind = slot_steps(layers, number, size)
        width = band[WIDTH]
        # Narrow bands, whose lines are neighbours, go through several lines at a time: the same ones with any number of
        # threads, as sums depend on it.
        several = LINES // width if width <= LINES and coefficient.size == 1 else 1
        each = (sizes[1] + several - 1) // several
        own = share(thread, sizes[0] * each)
        for group in range(own[0], own[1]):
            x, y = group // each, group % each * several
            together = min(several, sizes[1] - y)
            node = sizes[8] + x * band[PLANE] + y * band[ROW] + tile[TILE_FIRST]
            slot = band[BASE] + (sizes[3] + x * band[LINE] + y) * width + tile[TILE_COLUMN]
            vectors = together * width * size // 64 if several > 1 else tile[TILE_VECTORS]
            for i in range(several, 2 * several):
                fetch(news + (node + i * band[ROW]) * size)
                fetch(news + (node + i * band[ROW] + count - 1) * size)
            if sums:
                here = extra + slot * size
                call_mirrored(
                    function,
                    (to, to, LINES * size, LINES * size),
                    (here + ahead, here + behind),
                    (band[LINE] * width * size, width * size, shift, step),
                    weights,
                    vectors,
                )
            for c in range(stage.rows):
                here = to + (c * LINES * size if sums else 0)
                if coefficient.size > 1:
                    weigh_bonds(layers, sizes[4] + c, 1, src, node, slot, number, work, 0, count, material)
                elif not sums:
                    ends = tables[0] + (3 * (sizes[4] + c) + 1 + number) * tables[1]
                    call_parts(
                        band[PARTS], to, 0, extra + slot * size, ends, tables[2], tables[3], tables[4], vectors, 1, 0
                    )
                for i in range(together):
                    place = (node + c * apart + i * band[ROW]) * size
                    add_lines(here + i * width * size, news + place, scale, count)
                    if stage.increments:
                        add_lines(here + i * width * size, olds + place, scale, count)


@njit(error_model="numpy", cache=True, counted=False)
def stretch_edge(number, c, t, stage, layers, work, material):
    """What the second axis' layer adds to the parts of the first one's, for the rows of an edge and one tile; into the
    last rows of the work space.

    Row ((set * reach + k - 1) * columns + column of the first axis) * columns + column of the second, both counted from
    -reach.
    """
    src, slots, memory, coefficient = stage.src, layers.slots, layers.memory, material.coefficient
    edge, tile, sizes = layers.edges[number], layers.tiles[t], layers.sizes
    face, other = layers.faces[edge[EDGE_FACE]], layers.faces[edge[EDGE_OTHER]]
    band, count, vectors = tile[TILE_BAND], tile[TILE_COUNT], tile[TILE_VECTORS]
    m, n = face[REACH], other[REACH]
    size, like = src.itemsize, work[0]
    row, start = LINES * size, address(work)
    parts, half = stage.rows * sizes[5], sizes[5] // 2
    target = (stage.rows + 2) * sizes[5] + c * sizes[9]
    wide, high = face[COLUMNS] + m + 1, other[COLUMNS] + n + 1
    stretch = stretch_of(layers, other[PROFILE])
    tables = tables_of(layers)
    field, extra = address(src), address(slots)
    lanes = vectors * 64 // size
    first_cell = edge[EDGE_MEMORY] + (c * sizes[6] + tile[TILE_PLACE]) * edge[EDGE_CELLS]
    cell = layers.cell * lanes
    corner = face[ORIGIN] + (other[ORIGIN] - sizes[8]) + tile[TILE_FIRST]  # column 0 of both
    width = layers.bands[max(band, 0), WIDTH]
    line = layers.bands[max(band, 0), BASE] + (face[SLOT] + other[SLOT] - sizes[3]) * width + tile[TILE_COLUMN]
    for own in range(face[SETS]):
        for a in range(m):
            kind = layers.kinds[edge[EDGE_KINDS] + own * m + a]
            most = kind[KIND_REACH]
            past = first_cell + kind[KIND_CELLS] * lanes
            for p in range(kind[KIND_FIRST], face[COLUMNS] + 1):
                to = target + ((own * m + a) * wide + p + m) * high + n
                if most == 0:
                    clear(start + (to + 1 - n) * row, (high - 1) * LINES, like)
                    continue
                for inward in range(other[SETS]):
                    sums = edge[EDGE_SUMS] + ((c * face[SETS] + own) * m + a) * other[SETS] + inward
                    for q in range(0 if inward < other[SETS] - 1 else -most, other[COLUMNS] + 1):
                        node = corner + p * face[STEP] + q * other[STEP]
                        slot = line + (p * face[SLOT_STEP] + q * other[SLOT_STEP]) * width
                        place = parts + inward * half + (q + n) * n
                        if coefficient.size > 1:
                            weigh_bonds(layers, sums, most, src, node, slot, band, work, place, count, material)
                        else:
                            weigh(
                                tables,
                                kind[KIND_PARTS],
                                sums,
                                field + node * size,
                                extra + slot * size,
                                band,
                                start + place * row,
                                row,
                                vectors,
                                max(1, -q),
                            )
                memo = address(memory) + layers.cell * past
                zero, there = start + (parts + n * n) * row, start + to * row
                outer, inner = (zero, n * row, row), (zero + (other[SETS] - 1) * half * row, n * row, row)
                total, inwards = (there, row, row), memo + (other[COLUMNS] + 1) * most * cell
                call_shifts(kind[KIND_OUTWARDS], outer, total, (memo, cell), stretch, other[COLUMNS], vectors)
                call_shifts(kind[KIND_INWARDS], inner, total, (inwards, cell), stretch, other[COLUMNS], vectors)
                clear(start + (to + 1 - n) * row, (n - most) * LINES, like)
                past += (2 * other[COLUMNS] + 1) * most * lanes


@njit(error_model="numpy", cache=True, counted=False)
def stretch_face(item, stage, layers, work, material):
    """Add what a face's layer contributes to some rows of one tile, on its columns and on those of the core next to it;
    advances its memory.
    """
    src, base, out, rows = stage.src, stage.base, stage.out, stage.rows
    scale, slots, memory, coefficient = stage.scale * layers.unit, layers.slots, layers.memory, material.coefficient
    face, tile, sizes = layers.faces[item[0]], layers.tiles[item[3]], layers.sizes
    columns, m, sets = face[COLUMNS], face[REACH], face[SETS]
    band, count, vectors = tile[TILE_BAND], tile[TILE_COUNT], tile[TILE_VECTORS]
    size = src.itemsize
    wide, start = LINES * size, address(work)
    half, found, added = sizes[5] // 2, (rows + 1) * sizes[5], (rows + 2) * sizes[5]
    stretch = stretch_of(layers, face[PROFILE])
    tables = tables_of(layers)
    field, extra, olds, news = address(src), address(slots), address(base), address(out)
    lanes, apart, cells = vectors * 64 // size, src.size // stage.components, (2 * columns + 1) * m
    cell = layers.cell * lanes
    edge = item[4]
    other = layers.faces[layers.edges[max(edge, 0), EDGE_OTHER]] if edge >= 0 else face
    high = other[COLUMNS] + other[REACH] + 1
    corner, side = (other[ORIGIN] - sizes[8]) // abs(other[STEP]), 1 if other[STEP] > 0 else -1
    width = layers.bands[max(band, 0), WIDTH]
    line = layers.bands[max(band, 0), BASE] + face[SLOT] * width + tile[TILE_COLUMN]
    function, band_function = layers.mirrored[face[AXIS], 0, 0], layers.mirrored[face[AXIS], 1, 0] if band >= 0 else 0
    weights = address(layers.mirrored_weights) + layers.mirrored[face[AXIS], 0, 1] * size
    band_weights = address(layers.mirrored_weights) + layers.mirrored[face[AXIS], 1, 1] * size
    sums = coefficient.size == 1 and function != 0
    step, shift, ahead, behind = slot_steps(layers, band, size)
    on, back = (0, (sets - 1) * half * wide) if face[STEP] > 0 else ((sets - 1) * half * wide, 0)
    across, slots_across = face[ROW_STEP] * size, face[SLOT_ROW] * width * size
    for c in range(rows if edge >= 0 else 0):
        stretch_edge(edge, c, item[3], stage, layers, work, material)
    for row in range(item[1], item[2]):
        first = face[ORIGIN] + row * face[ROW_STEP] + tile[TILE_FIRST]
        for p in range(-m, columns + 1):
            node, slot, to = (
                first + p * face[STEP],
                line + (p * face[SLOT_STEP] + row * face[SLOT_ROW]) * width,
                (p + m) * m,
            )
            if sums:
                plus, minus, here = start + to * wide + on, start + to * wide + back, extra + slot * size
                sides = (plus, minus, wide, sizes[5] * wide)
                strides = (across, across, apart * size, 0)
                call_mirrored(function, sides, (field + node * size, 0), strides, weights, vectors)
                if band_function != 0:
                    strides = (slots_across, slots_across, shift, step)
                    call_mirrored(band_function, sides, (here + ahead, here + behind), strides, band_weights, vectors)
            for part in range(0 if sums and edge < 0 and layers.cuts.shape[0] == 0 else rows * sets):
                c, own = part // sets, part % sets
                if p < 0 and own < sets - 1:
                    continue
                here, number = c * sizes[5] + own * half + to, face[SUMS] + c * sets + own
                if coefficient.size > 1:
                    weigh_bonds(layers, number, m, src, node, slot, band, work, here, count, material)
                elif not sums:
                    weigh(
                        tables,
                        face[PARTS],
                        number,
                        field + node * size,
                        extra + slot * size,
                        band,
                        start + here * wide,
                        wide,
                        vectors,
                        max(1, -p),
                    )
                for k in range(max(0, -p - 1), m if edge >= 0 else 0):
                    far = (
                        c * sizes[9]
                        + ((own * m + k) * (columns + m + 1) + p + m) * high
                        + (row - corner) * side
                        + other[REACH]
                    )
                    add_lines(start + (added + far) * wide, start + (here + k) * wide, work.dtype.type(1), LINES)
                if layers.cuts.shape[0]:
                    cuts = face[CUTS] + (c * face[ROWS] + row) * layers.tiles.shape[0] + item[3]
                    take_cuts(cuts, own, p, node, slot, band, src, layers, work, here, material)
        for c in range(rows):
            first_cell = face[MEMORY] + ((c * face[ROWS] + row) * sizes[6] + tile[TILE_PLACE]) * cells
            memo = address(memory) + layers.cell * first_cell
            zero, there = start + (c * sizes[5] + m * m) * wide, start + (found + m) * wide
            outer, inner = (zero, m * wide, wide), (zero + (sets - 1) * half * wide, m * wide, wide)
            total, inwards = (there, wide, wide), memo + (columns + 1) * m * cell
            call_shifts(face[OUTWARDS], outer, total, (memo, cell), stretch, columns, vectors)
            call_shifts(face[INWARDS], inner, total, (inwards, cell), stretch, columns, vectors)
            for p in range(1 - m, columns + 1):
                place = (first + p * face[STEP] + c * apart) * size
                add_lines(there + p * wide, news + place, scale, count)
                if stage.increments:
                    add_lines(there + p * wide, olds + place, scale, count)


@njit(error_model="numpy", cache=True, counted=False)
def take_cuts(cuts, own, p, node, slot, band, src, layers, work, parts, material):
    """Take the absent bonds of a row of a face from the parts on one column."""
    coefficient = material.coefficient
    for i in range(layers.cut_ranges[cuts], layers.cut_ranges[cuts + 1]):
        place, which, k, near, far, there = layers.cuts[i]
        if which != own or k < -p - 1:
            continue
        value = src[node + place + near]
        if band >= 0 and far >= 0:
            value += layers.slots[slot + place + far]
        w = layers.cut_weights[i]
        if coefficient.size > 1:
            w *= bond_factor(material.rule, coefficient[node + place], coefficient[node + place + there])
        work[(parts + k) * LINES + place] -= w * value


@njit(error_model="numpy", cache=True, counted=False)
def take_band_cuts(stage, layers, material):
    """Take the absent bonds of the lines of bands from what these have added."""
    coefficient, slots, scale = material.coefficient, layers.slots, stage.scale * layers.unit
    for i in range(layers.band_cuts.shape[0]):
        number, node, slot, here, there = layers.band_cuts[i]
        w = scale * layers.band_cut_weights[i]
        if coefficient.size > 1:
            w *= bond_factor(material.rule, coefficient[here], coefficient[there])
        for p in range(layers.bands[number, COLUMNS] + layers.bands[number, REACH]):
            stage.out[node + p] -= w * slots[slot + p]
            if stage.increments:
                stage.base[node + p] -= w * slots[slot + p]


@njit(error_model="numpy", cache=True, counted=False)
def continue_lines(thread, stage, layers, work):
    """Fill the slots from a level whose halo is complete, and advance the memory of the last axis."""
    for number in range(2):
        if layers.bands[number, COLUMNS]:
            continue_band(thread, number, stage, layers, work)
    if layers.copies.shape[1]:
        barrier(thread)
        if thread.number == 0:
            for i in range(layers.copies.shape[1]):
                layers.slots[layers.copies[0, i]] = layers.slots[layers.copies[1, i]]


def has_layers(layers: Layers, axis: int) -> bool:
    """Whether there are any along an axis."""
    return bool(layers.bands[:, COLUMNS].any() if axis == 2 else np.diff(layers.item_ranges)[1 - axis])


@njit(error_model="numpy", cache=True, counted=False)
def add_layers(thread, axis, stage, layers, work, material):
    """Add what the layers along one axis contribute to ``out``, and to ``base`` where that holds increments;
    `continue_lines` comes before.

    Threads write the same nodes along different axes, so they meet after each.
    """
    if axis == 2:
        add_bands(thread, stage, layers, work, material)
        if layers.band_cuts.shape[0]:
            barrier(thread)
            if thread.number == 0:
                take_band_cuts(stage, layers, material)
    else:
        for i in range(layers.item_ranges[1 - axis] + thread.number, layers.item_ranges[2 - axis], thread.threads):
            stretch_face(layers.items[i], stage, layers, work, material)
    barrier(thread)

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

import itertools
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from farhorizon.engine.bonds import bond_factor
from farhorizon.engine.layout import ALIGN, SLACK, Layout, aligned_zeros
from farhorizon.engine.rows.build import load_parts, load_shifts
from farhorizon.engine.rows.choose import UNROLLED_LIMIT, mirrored
from farhorizon.engine.rows.compiled import njit
from farhorizon.engine.rows.layer_sums import call_mirrored
from farhorizon.engine.rows.vectors import TURNED, add_lines, call_parts, call_shifts, clear, fetch, turn
from farhorizon.engine.threads import barrier, share

#: Values that go through side by side.
LINES = 32

# Columns of tables.
AXIS, PROFILE, COLUMNS, REACH, SETS, ORIGIN, STEP, OUTWARDS, INWARDS, PARTS = range(10)  # of a face and of a band
ROWS, ROW_STEP, SLOT, SLOT_STEP, SLOT_ROW, SUMS, MEMORY, CUTS = range(10, 18)  # of a face
WIDTH, BASE, KEPT, PLANE, ROW, LINE = range(10, 16)  # of a band
TILE_FIRST, TILE_COUNT, TILE_VECTORS, TILE_BAND, TILE_COLUMN, TILE_PLACE = range(6)
EDGE_FACE, EDGE_OTHER, EDGE_SUMS, EDGE_MEMORY, EDGE_CELLS, EDGE_FIRST, EDGE_ROWS, EDGE_KINDS = range(8)
KIND_REACH, KIND_FIRST, KIND_CELLS, KIND_OUTWARDS, KIND_INWARDS, KIND_PARTS = range(6)  # of the parts of an edge


class Layers(NamedTuple):
    """What the compiled loop knows of the layers.

    Attributes
    ----------
    faces : ndarray of int, shape (F, 18)
        Layers along the first two axes: see `LayerTables`.
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
    slots : ndarray
        Values of the bands.
    memory : ndarray
        Room for what the layers remember, whose numbers may be shorter than these: see `LayerTables.kept`.
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


class LayerTables:
    """Makes the tables of the layers of a box.

    Parameters
    ----------
    layout : Layout
    offsets, weights : ndarray, shapes (K, 3) and (K, d, d)
        The stencil.
    recursion : mapping of (axis, side) to (r, e, f)
        Of each layer, each of shape (columns + 1,).
    dtype, kept : dtype
        Of the field, and of what the layers remember.
    remember, alike : bool
        Whether the layers have memory, and whether no bonds have coefficients.

    Attributes
    ----------
    layers : Layers
        Without cuts.
    scratch : int
        Numbers of the work space of each thread.
    """

    def __init__(
        self,
        layout: Layout,
        offsets: np.ndarray,
        weights: np.ndarray,
        recursion: Mapping[tuple[int, int], tuple[np.ndarray, ...]],
        dtype: np.dtype,
        kept: np.dtype,
        remember: bool,
        alike: bool = True,
    ) -> None:
        # so that parts and their memory are as large as the field, in all units
        self.unit = float(np.abs(weights).sum()) or 1.0
        self.layout, self.offsets, self.weights, self.remember = layout, offsets, weights / self.unit, remember
        self.dtype, self.kept, self._types = dtype, kept, (dtype.name, kept.name)
        self.lanes, self.components = 64 // dtype.itemsize, layout.components
        names = list(recursion)
        self._profiles = {name: i for i, name in enumerate(names)}
        n, m = layout.box.nodes, layout.reach
        self.grid = (n[1] + 2 * m[1], 1)  # distances between lines of a band
        self.lines = (n[0] + 2 * m[0]) * (n[1] + 2 * m[1])
        self._first_line = m[0] * self.grid[0] + m[1]
        self.even = [self._mirrors(axis) for axis in range(3)]
        self.sets = [1 if even else 2 for even in self.even]  # parts outwards and inwards are the same, or not
        self._ends: list[list[int]] = []
        self._places: list[int] = []
        self._materials: list[int] = []
        self._weights: list[np.ndarray] = []
        self.memory = 0
        self.bands, self.slots = self._make_bands()
        self.tiles = self._make_tiles()
        self.faces = self._make_faces()
        edges, kinds = self._make_edges()
        self.band_sums = len(self._ends) // 3
        for row in range(self.components):
            self._add_sums(row, [{}], [0, 1])
        items, ranges = self._make_items(edges)
        self.edges, self.kinds = edges, kinds
        longest = max((len(r) for r, _, _ in recursion.values()), default=1)
        tables = np.zeros((3, max(len(names), 1), longest), dtype)
        for i, name in enumerate(names):
            for row, values in zip(tables, recursion[name], strict=True):
                row[i, : len(values)] = values
        if not remember:
            tables[1:] = 0
        none = np.zeros(0, np.int64)
        self.layers = Layers(
            self.faces,
            self.bands,
            edges,
            kinds,
            self.tiles,
            items,
            ranges,
            np.array(self._ends, np.int64),
            np.array(self._places, np.int64),
            np.array(self._materials, np.int64),
            np.array(self._weights, dtype).reshape(-1, max(layout.reach)),
            none.reshape(0, 6),
            np.zeros(0, dtype),
            none,
            none.reshape(0, 5),
            np.zeros(0, dtype),
            self._copies(),
            tables[0],
            tables[1],
            tables[2],
            *self._mirrored(alike),
            self._sizes(),
            kept.itemsize * remember,
            dtype.type(self.unit),
            aligned_zeros(self.slots, dtype),
            aligned_zeros(-(-self.memory * kept.itemsize // dtype.itemsize) if remember else ALIGN * 4, dtype),
        )

    def _mirrors(self, axis: int) -> bool:
        """Whether the stencil looks alike along an axis and against it."""
        table = {tuple(o): w for o, w in zip(self.offsets.tolist(), self.weights, strict=True)}
        turned = ((tuple(-i if a == axis else i for a, i in enumerate(o)), w) for o, w in table.items())
        return all(o in table and np.array_equal(table[o], w) for o, w in turned)

    # --- where everything lies ---------------------------------------------------------------------------------

    def _make_bands(self) -> tuple[np.ndarray, int]:
        layout, m = self.layout, self.layout.reach[2]
        table, size = np.zeros((2, LINE + 1), np.int64), SLACK
        groups = layout.box.nodes[0] * -(-layout.box.nodes[1] // self._group_lanes())
        for number, side in enumerate((-1, 1)):
            if (2, side) not in self._profiles:
                continue
            columns = layout.columns[2, side]
            first = layout.low[2] if side < 0 else layout.low[2] + layout.core[2] - 1
            width = -(-(columns + m) // self.lanes) * self.lanes
            table[number] = (
                2,
                self._profiles[2, side],
                columns,
                m,
                self.sets[2],
                layout.box.origin + first,
                side,
                *load_shifts(m, False, *self._types),
                width,
                size,
                self.memory,
                *layout.box.stride[:2],
                self.grid[0],
            )
            size += self.components * self.sets[2] * m * self.lines * width
            self.memory += self.components * groups * self._group_lanes() * (2 * columns + 1) * m
        return table, size + SLACK

    def _group_lanes(self) -> int:
        """Lines along the last axis that go through side by side: those with which the fewest lanes are empty."""
        n = self.layout.box.nodes[1]
        return min((size for size in range(LINES, 0, -self.lanes)), key=lambda size: -(-n // size) * size)

    def _make_tiles(self) -> np.ndarray:
        layout, rows, place = self.layout, [], 0
        low, high = (int(self.bands[i, COLUMNS] and self.bands[i, COLUMNS] + layout.reach[2]) for i in (0, 1))
        n = layout.box.nodes[2]
        for first, last, band in ((0, low, 0), (low, n - high, -1), (n - high, n, 1)):
            count = -(-(last - first) // LINES)
            each = -(-(last - first) // max(count, 1))
            size = -(-each // self.lanes) * self.lanes  # tiles of about the same size
            for start in range(first, last, max(size, 1)):
                nodes = min(size, last - start)
                vectors = -(-nodes // self.lanes)
                rows.append((start, nodes, vectors, band, start - first, place))
                place += vectors * self.lanes
        self._tile_lanes = place
        return np.array(rows, np.int64)

    def _make_faces(self) -> np.ndarray:
        layout, rows = self.layout, []
        for axis, side in itertools.product((0, 1), (-1, 1)):
            if (axis, side) not in self._profiles:
                continue
            other = 1 - axis
            columns, m, stride = layout.columns[axis, side], layout.reach[axis], layout.box.stride
            first = layout.low[axis] if side < 0 else layout.low[axis] + layout.core[axis] - 1
            sums = len(self._ends) // 3
            for row, own in itertools.product(range(self.components), range(self.sets[axis])):
                self._add_sums(row, [{axis: side * k * (1 - 2 * own)} for k in range(1, m + 1)], [other, 2])
            count = layout.box.nodes[other]
            rows.append(
                (
                    axis,
                    self._profiles[axis, side],
                    columns,
                    m,
                    self.sets[axis],
                    layout.box.origin + first * stride[axis],
                    side * stride[axis],
                    *load_shifts(m, True, *self._types),
                    count,
                    stride[other],
                    self._first_line + first * self.grid[axis],
                    side * self.grid[axis],
                    self.grid[other],
                    sums,
                    self.memory,
                    0,
                )
            )
            self.memory += self.components * count * self._tile_lanes * (2 * columns + 1) * m
        return np.array(rows, np.int64).reshape(-1, CUTS + 1)

    def _make_edges(self) -> tuple[np.ndarray, np.ndarray]:
        rows: list[tuple[int, ...]] = []
        kinds: list[tuple[int, ...]] = []
        layout = self.layout
        for number, face in enumerate(self.faces):
            for other_number, other in enumerate(self.faces):
                if face[AXIS] != 0 or other[AXIS] != 1:
                    continue
                sides, m = (int(np.sign(face[STEP])), int(np.sign(other[STEP]))), layout.reach
                sums, first_kind, cells = len(self._ends) // 3, len(kinds), 0
                for own, a in itertools.product(range(self.sets[0]), range(1, m[0] + 1)):
                    far = int(np.abs(self.offsets[np.abs(self.offsets[:, 0]) == a, 1]).max(initial=0))
                    start = -a if own == self.sets[0] - 1 else 0  # parts outwards are wanted from column 0 on
                    kinds.append((far, start, cells, *(load_shifts(far, True, *self._types) if far else (0, 0, 0))))
                    cells += (int(face[COLUMNS]) + 1 - start) * (2 * int(other[COLUMNS]) + 1) * far
                kinds_of = itertools.product(
                    range(self.components), range(self.sets[0]), range(1, m[0] + 1), range(self.sets[1])
                )
                for row, own, a, inward in kinds_of:
                    x, y = sides[0] * a * (1 - 2 * own), sides[1] * (1 - 2 * inward)
                    self._add_sums(
                        row, [{0: x, 1: y * b} for b in range(1, kinds[first_kind + own * m[0] + a - 1][0] + 1)], [2]
                    )
                wide = int(other[COLUMNS]) + m[1]
                first = 0 if sides[1] < 0 else layout.box.nodes[1] - wide
                rows.append((number, other_number, sums, self.memory, cells, first, first + wide, first_kind))
                self.memory += self.components * self._tile_lanes * cells
        return np.array(rows, np.int64).reshape(-1, 8), np.array(kinds, np.int64).reshape(-1, 6)

    def _make_items(self, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pieces of work, each done by one thread; those of the first axis take the rows of an edge together."""
        found: list[list[tuple[int, ...]]] = [[], []]
        for number, face in enumerate(self.faces):
            ends = [(int(e[EDGE_FIRST]), int(e[EDGE_ROWS]), i) for i, e in enumerate(edges) if e[EDGE_FACE] == number]
            first = max((last for start, last, _ in ends if start == 0), default=0)
            last = min((start for start, _, _ in ends if start > 0), default=int(face[ROWS]))
            step = max(1, -(-(last - first) // 32))
            pieces = [(i, min(i + step, last), -1) for i in range(first, last, step)] + ends
            found[int(face[AXIS])] += [
                (number, *piece[:2], tile, piece[2]) for piece in pieces for tile in range(len(self.tiles))
            ]
        items = np.array(found[1] + found[0], np.int64).reshape(-1, 5)
        return items, np.array([0, len(found[1]), len(items)], np.int64)

    def _copies(self) -> np.ndarray:
        """Places of the slots that repeat what lies across a periodic axis: (to, from)."""
        layout, found = self.layout, [np.zeros((2, 0), np.int64)]
        n, m = layout.box.nodes, layout.reach
        for axis in (0, 1):
            if axis not in layout.periodic:
                continue
            halo = np.r_[-m[axis] : 0, n[axis] : n[axis] + m[axis]]
            pairs = []
            for along in (halo, halo % n[axis]):
                parts = [
                    along if a == axis else np.arange(-m[a], n[a] + m[a]) if a < axis else np.arange(n[a])
                    for a in (0, 1)
                ]
                pairs.append(self._first_line + np.add.outer(parts[0] * self.grid[0], parts[1]).ravel())
            for band in self.bands:
                if band[COLUMNS]:
                    fields = np.arange(self.components * self.sets[2] * layout.reach[2]) * self.lines
                    whole = [
                        np.add.outer(np.add.outer(fields, at) * band[WIDTH], np.arange(band[WIDTH])).ravel()
                        + band[BASE]
                        for at in pairs
                    ]
                    found.append(np.array(whole))
        return np.concatenate(found, axis=1)

    def _sizes(self) -> np.ndarray:
        """What `Layers.sizes` holds; sets the work space of a thread."""
        n0, n1, _ = self.layout.box.nodes
        rows = [int(f[COLUMNS] + f[REACH] + 1) * int(f[REACH]) for f in self.faces]
        rows += [int(b[WIDTH] + TURNED) * int(b[REACH]) for b in self.bands]
        parts = 2 * max(rows)
        edge = 0
        for e in self.edges:
            face, other = self.faces[e[EDGE_FACE]], self.faces[e[EDGE_OTHER]]
            edge = max(
                edge,
                int(face[SETS] * face[REACH] * (face[COLUMNS] + face[REACH] + 1) * (other[COLUMNS] + other[REACH] + 1)),
            )
        self.scratch = ((self.components + 2) * parts + self.components * edge) * LINES + SLACK
        return np.array(
            [
                n0,
                n1,
                self.lines,
                self._first_line,
                self.band_sums,
                parts,
                self._tile_lanes,
                self._group_lanes(),
                self.layout.box.origin,
                edge,
            ],
            np.int64,
        )

    def _mirrored(self, alike: bool) -> tuple[np.ndarray, np.ndarray]:
        """What `Layers.mirrored` and `mirrored_weights` hold."""
        functions, rows, size = np.zeros((3, 2, 2), np.int64), [np.zeros(0)], self.components**2
        shape, matrices = mirrored(dict(zip(map(tuple, self.offsets.tolist()), self.weights, strict=True)))
        in_bands = bool(self.bands[:, COLUMNS].any())
        used = [in_bands if axis == 2 else bool((self.faces[:, AXIS] == axis).any()) for axis in range(3)]
        for axis, apart in (
            itertools.product(range(3), (False, True)) if alike and self.layout.reach[2] <= self.lanes else ()
        ):
            chosen = [i for i, o in enumerate(shape) if (axis == 2 or o[axis] > 0) and (o[2] > 0 or not apart)]
            products = np.count_nonzero(matrices[chosen])
            if (
                not used[axis]
                or not 0 < products <= UNROLLED_LIMIT
                or (apart and not in_bands)
                or (axis == 2 and not apart)
            ):
                continue
            pattern = tuple(tuple(row) for row in (matrices[chosen].reshape(-1, size) != 0).tolist())
            parts = load_parts(
                tuple(shape[i] for i in chosen),
                pattern,
                axis,
                self.sets[axis] == 2,
                apart,
                self.sets[2] == 2,
                self.dtype.name,
            )
            functions[axis, int(apart)] = parts, sum(map(len, rows))
            rows.append(matrices[chosen].ravel())
        return functions, np.concatenate(rows).astype(self.dtype)

    # --- absent bonds ------------------------------------------------------------------------------------------

    def cut(self, nodes: np.ndarray, neighbours: np.ndarray, weights: np.ndarray) -> Layers:
        """The layers without some bonds, given by places in a level and weights (n,) or (n, d, d).

        A layer's columns, and those of the core next to it, lack the same bonds; those of its first column count.
        """
        box = self.layout.box
        here = np.stack(self._coordinates(nodes), -1)
        offset = np.stack(self._coordinates(neighbours), -1) - here
        matrices = weights.reshape(len(nodes), self.components, self.components) / self.unit
        faces, face_rows, band_rows, start = self.faces.copy(), [], [], 0
        for face in faces:
            axis, side = int(face[AXIS]), int(np.sign(face[STEP]))
            column = (int(face[ORIGIN]) - box.origin + int(face[STEP])) // box.stride[axis]
            face[CUTS] = start
            for i in np.flatnonzero((here[:, axis] == column) & (offset[:, axis] != 0)):
                face_rows += self._face_cuts(face, here[i], offset[i], matrices[i], axis, side)
            start += self.components * int(face[ROWS]) * len(self.tiles)
        for number, band in enumerate(self.bands):
            column = int(band[ORIGIN]) - box.origin + int(band[STEP])
            for i in np.flatnonzero((here[:, 2] == column) & (offset[:, 2] != 0)) if band[COLUMNS] else ():
                band_rows += self._band_cuts(number, int(nodes[i]), here[i], offset[i], matrices[i])
        if not face_rows and not band_rows:
            return self.layers
        face_rows.sort(key=lambda row: row[0])
        table = np.array([row[1:7] for row in face_rows], np.int64).reshape(-1, 6)
        ranges = np.searchsorted([row[0] for row in face_rows], np.arange(start + 1))
        return self.layers._replace(
            faces=faces,
            cuts=table,
            cut_weights=np.array([row[7] for row in face_rows], self.dtype),
            cut_ranges=ranges,
            band_cuts=np.array([row[:5] for row in band_rows], np.int64).reshape(-1, 5),
            band_cut_weights=np.array([row[5] for row in band_rows], self.dtype),
        )

    def _coordinates(self, places: np.ndarray) -> list[np.ndarray]:
        """Numbers of nodes along the axes, counted from the first of the box, of places in a level."""
        box, found = self.layout.box, []
        left = np.asarray(places, np.int64) - box.origin + int(np.dot(box.reach, box.stride))
        for stride, m in zip(box.stride, box.reach, strict=True):
            found.append(left // stride - m)
            left = left % stride
        return found

    def _face_cuts(self, face, here, offset, matrix, axis: int, side: int) -> list[tuple[Any, ...]]:
        """Of one bond: its key, and the entries of `Layers.cuts` and `cut_weights`."""
        own = int(offset[axis] * side < 0)
        if own >= face[SETS]:
            return []  # its mirror image serves
        other, k = 1 - axis, int(abs(offset[axis]))
        t = int(np.searchsorted(self.tiles[:, TILE_FIRST], here[2], side="right")) - 1
        lane, band = int(here[2] - self.tiles[t, TILE_FIRST]), int(self.tiles[t, TILE_BAND])
        across = int(offset[other] * face[ROW_STEP] + offset[2])
        place = self._slot_of(band, int(offset[2])) if band >= 0 else None
        rows = []
        for row, column in np.argwhere(matrix != 0):
            far = -1
            if place is not None:
                line = (column * self.sets[2] * self.layout.reach[2] + place) * self.lines + offset[other] * self.grid[
                    other
                ]
                far = line * self.bands[band, WIDTH]
            key = int(face[CUTS] + (row * face[ROWS] + here[other]) * len(self.tiles) + t)
            rows.append((key, lane, own, k - 1, across + column * self.layout.size, far, across, matrix[row, column]))
        return rows

    def _band_cuts(self, number: int, node: int, here, offset, matrix) -> list[tuple[Any, ...]]:
        """Of one bond: the entries of `Layers.band_cuts` and `band_cut_weights`."""
        place, band, box = self._slot_of(number, int(offset[2])), self.bands[number], self.layout.box
        rows = []
        for row, column in np.argwhere(matrix != 0) if place is not None else ():
            line = self._first_line + (here[0] + offset[0]) * self.grid[0] + here[1] + offset[1]
            slot = (
                band[BASE] + ((column * self.sets[2] * self.layout.reach[2] + place) * self.lines + line) * band[WIDTH]
            )
            first = node - here[2] + (0 if band[STEP] < 0 else box.nodes[2] - band[COLUMNS] - band[REACH])
            there = node + offset[0] * box.stride[0] + offset[1] * box.stride[1]
            rows.append((first + row * self.layout.size, slot, node, there, matrix[row, column]))
        return [(number, *row) for row in rows]

    # --- the memory --------------------------------------------------------------------------------------------

    def cells(self, driven: np.ndarray) -> list[tuple[tuple[int, int], np.ndarray]]:
        """Places of the memory that is ever used: of each layer, and then of each edge, its axis and side, and places
        by component, number of the application, and line; `driven`, shape (layers, columns + 1), says of which edges
        between columns.
        """
        found = []
        for number, band in enumerate(self.bands):
            if band[COLUMNS]:
                n0, n1, _ = self.layout.box.nodes
                size, cells = self._group_lanes(), int(2 * band[COLUMNS] + 1) * int(band[REACH])
                each, y = -(-n1 // size), np.arange(n1)
                group = (np.arange(n0)[:, None] * each + y // size).ravel()
                first = [
                    band[KEPT] + (c * n0 * each + group) * size * cells + np.tile(y % size, n0)
                    for c in range(self.components)
                ]
                used = self._used(band, driven)
                found.append(((2, 2 * number - 1), np.array([used[:, None] * size + at for at in first])))
        tile = np.repeat(np.arange(len(self.tiles)), self.tiles[:, TILE_COUNT])
        lane = np.arange(self.layout.box.nodes[2]) - self.tiles[tile, TILE_FIRST]
        size = self.tiles[tile, TILE_VECTORS] * self.lanes
        for face in self.faces:
            cells, rows = int(2 * face[COLUMNS] + 1) * int(face[REACH]), np.arange(face[ROWS])[:, None]
            used, places = self._used(face, driven), []
            for c in range(self.components):
                first = (
                    face[MEMORY]
                    + ((c * face[ROWS] + rows) * self._tile_lanes + self.tiles[tile, TILE_PLACE]) * cells
                    + lane
                )
                places.append((first + used[:, None, None] * size).reshape(len(used), -1))
            found.append(((int(face[AXIS]), int(np.sign(face[STEP]))), np.array(places)))
        for edge in self.edges:
            face, other = self.faces[edge[EDGE_FACE]], self.faces[edge[EDGE_OTHER]]
            ever: list[np.ndarray] = []
            end = 0
            for own, a in itertools.product(range(face[SETS]), range(face[REACH])):
                most, start = self.kinds[edge[EDGE_KINDS] + own * face[REACH] + a, :2]
                one = self._used(other, driven, int(most))
                for _ in range(start, face[COLUMNS] + 1):
                    ever.append(end + one)
                    end += int(2 * other[COLUMNS] + 1) * int(most)
            of_all = np.concatenate(ever)
            place = self.tiles[tile, TILE_PLACE]
            first = [
                edge[EDGE_MEMORY] + (c * self._tile_lanes + place) * edge[EDGE_CELLS] + lane
                for c in range(self.components)
            ]
            found.append(((1, int(np.sign(other[STEP]))), np.array([at + of_all[:, None] * size for at in first])))
        return found

    @staticmethod
    def _used(layer: np.ndarray, driven: np.ndarray, most: int | None = None) -> np.ndarray:
        """Numbers of the cells of one line whose edges are driven: those outwards from the outer end inwards, then
        those inwards.
        """
        columns, most = int(layer[COLUMNS]), int(layer[REACH]) if most is None else most
        edges = np.concatenate([np.repeat(np.arange(columns, -1, -1), most), np.repeat(np.arange(columns), most)])
        return np.flatnonzero(driven[layer[PROFILE], edges])

    # --- sums --------------------------------------------------------------------------------------------------

    def _add_sums(self, row: int, fixed: list[dict[int, int]], across: list[int]) -> None:
        """Sums for one component of the result, each with given offsets along some axes, of terms at offsets along the
        others.

        Without given offsets, those of bands alone.
        """
        stride, columns = self.layout.box.stride, range(self.components)
        for band in (None, 0, 1):
            terms: dict[tuple[int, int], np.ndarray] = {}
            for k, given in enumerate(fixed):
                at = np.ones(len(self.offsets), bool)
                for axis, value in given.items():
                    at &= self.offsets[:, axis] == value
                for o, w in zip(self.offsets[at].tolist(), self.weights[at], strict=True):
                    for column in columns if band is not None or given else ():
                        material = sum(o[a] * stride[a] for a in across)
                        place = (
                            material + column * self.layout.size
                            if band is None
                            else self._band_place(band, o, column, across)
                        )
                        if place is not None and w[row, column] != 0:
                            terms.setdefault((place, material), np.zeros(max(self.layout.reach)))[k] += w[row, column]
            self._add_terms(terms, len(fixed))

    def _band_place(self, number: int, offset: list[int], column: int, across: list[int]) -> int | None:
        """Where the slots of a band serve an offset, counted from the line of a node; None where they do not."""
        if not self.bands[number, COLUMNS] or (place := self._slot_of(number, offset[2])) is None:
            return None
        line = (column * self.sets[2] * self.layout.reach[2] + place) * self.lines + sum(
            offset[a] * self.grid[a] for a in across if a != 2
        )
        return int(line * self.bands[number, WIDTH])

    def _slot_of(self, number: int, offset: int) -> int | None:
        """Which field of a band's slots serves an offset along the last axis; those of mirror images are added up and
        come once.
        """
        if offset == 0 or (self.sets[2] == 1 and offset < 0):
            return None
        inwards = self.sets[2] == 2 and offset * int(self.bands[number, STEP]) < 0
        return abs(offset) - 1 + self.layout.reach[2] * inwards

    def _add_terms(self, terms: dict[tuple[int, int], np.ndarray], sums: int) -> None:
        """Groups of terms: those that the last sum has, of the others those that the last but one has, and so on."""
        first = len(self._places)
        used = {key: int(np.flatnonzero(w)[-1]) + 1 for key, w in terms.items()}
        for key in sorted(terms, key=lambda key: (-used[key], key)):
            self._places.append(key[0] * self.dtype.itemsize)
            self._materials.append(key[1])
            self._weights.append(terms[key])
        last = [first + sum(n >= k for n in used.values()) for k in range(sums, 0, -1)]
        self._ends.append([first, *last, *[0] * (max(self.layout.reach) - sums)])


# --- the compiled part ---------------------------------------------------------------------------------------------
# Where a function is called for every column there are addresses only: Numba counts the references to arrays that it
# passes on, which takes longer
# than the work. A thread's work space has rows of `LINES` values: parts of a face, parts of an edge, what is found,
# what an edge adds.


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
        kept = address(memory) + layers.cell * (band[KEPT] + item * group * cells)
        line, inwards = (zero, sign * row, 0), kept + (columns + 1) * m * cell
        on, back = (found + middle, sign * m * row, row), (found + far + middle, sign * m * row, row)
        call_shifts(band[OUTWARDS], line, on, (kept, cell), stretch, columns, vectors)
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
    src, base, out, components, slots = stage.src, stage.base, stage.out, stage.components, layers.slots
    scale, coefficient = stage.scale * layers.unit, material.coefficient
    sizes, size = layers.sizes, src.itemsize
    apart, to = src.size // components, address(work)
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
            for c in range(components):
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
    parts, half = stage.components * sizes[5], sizes[5] // 2
    target = (stage.components + 2) * sizes[5] + c * sizes[9]
    wide, high = face[COLUMNS] + m + 1, other[COLUMNS] + n + 1
    stretch = stretch_of(layers, other[PROFILE])
    tables = tables_of(layers)
    field, extra = address(src), address(slots)
    lanes = vectors * 64 // size
    kept = edge[EDGE_MEMORY] + (c * sizes[6] + tile[TILE_PLACE]) * edge[EDGE_CELLS]
    cell = layers.cell * lanes
    corner = face[ORIGIN] + (other[ORIGIN] - sizes[8]) + tile[TILE_FIRST]  # column 0 of both
    width = layers.bands[max(band, 0), WIDTH]
    line = layers.bands[max(band, 0), BASE] + (face[SLOT] + other[SLOT] - sizes[3]) * width + tile[TILE_COLUMN]
    for own in range(face[SETS]):
        for a in range(m):
            kind = layers.kinds[edge[EDGE_KINDS] + own * m + a]
            most = kind[KIND_REACH]
            past = kept + kind[KIND_CELLS] * lanes
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
    src, base, out, components = stage.src, stage.base, stage.out, stage.components
    scale, slots, memory, coefficient = stage.scale * layers.unit, layers.slots, layers.memory, material.coefficient
    face, tile, sizes = layers.faces[item[0]], layers.tiles[item[3]], layers.sizes
    columns, m, sets = face[COLUMNS], face[REACH], face[SETS]
    band, count, vectors = tile[TILE_BAND], tile[TILE_COUNT], tile[TILE_VECTORS]
    size = src.itemsize
    wide, start = LINES * size, address(work)
    half, found, added = sizes[5] // 2, (components + 1) * sizes[5], (components + 2) * sizes[5]
    stretch = stretch_of(layers, face[PROFILE])
    tables = tables_of(layers)
    field, extra, olds, news = address(src), address(slots), address(base), address(out)
    lanes, apart, cells = vectors * 64 // size, src.size // components, (2 * columns + 1) * m
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
    for c in range(components if edge >= 0 else 0):
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
            for part in range(0 if sums and edge < 0 and layers.cuts.shape[0] == 0 else components * sets):
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
        for c in range(components):
            kept = face[MEMORY] + ((c * face[ROWS] + row) * sizes[6] + tile[TILE_PLACE]) * cells
            memo = address(memory) + layers.cell * kept
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

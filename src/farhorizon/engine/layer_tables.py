"""Builds the tables of the layers of a box: where faces, edges and bands lie, and the pieces of work."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping

import numpy as np

from farhorizon.engine.layer_terms import Slots, Terms
from farhorizon.engine.layout import ALIGN, HALOS, SLACK, Layout, aligned, aligned_zeros
from farhorizon.engine.nested import (
    ACROSS,
    AXIS,
    BAND_MEMORY,
    BASE,
    COLUMNS,
    CUTS,
    EDGE_CELLS,
    EDGE_FACE,
    EDGE_FIRST,
    EDGE_KINDS,
    EDGE_MEMORY,
    EDGE_OTHER,
    EDGE_ROWS,
    LINE,
    LINES,
    MEMORY,
    PROFILE,
    REACH,
    ROWS,
    SETS,
    STEP,
    TILE_COUNT,
    TILE_FIRST,
    TILE_PLACE,
    TILE_VECTORS,
    WIDTH,
    Layers,
)
from farhorizon.engine.rows.build import load_bands, load_crossing, load_parts, load_shifts
from farhorizon.engine.rows.choose import UNROLLED_LIMIT, mirrored
from farhorizon.engine.rows.matrices import Signs
from farhorizon.engine.rows.vectors import TURNED


class LayerTables:
    """Builds the tables of the layers of a box.

    Parameters
    ----------
    layout : Layout
    offsets, weights : ndarray, shapes (K, 3) and (K, rows, columns)
        The stencil, from a field of `columns` components to one of `rows` components.
    inside, outside : tuple of (int, int, int)
        Signs of their components in mirrors, see `rows.matrices`.
    recursion : mapping of (axis, side) to (r, e, f)
        The recursion of each layer, three arrays of shape (columns + 1,).
    dtype, kept : dtype
        Of the field, and of what the layers remember.
    remember, alike : bool
        Whether the layers have memory, and whether no bonds have coefficients.
    stages : int
        Stages of a step, each of which has a memory of its own: what the layers continue differs from one to the next.

    Attributes
    ----------
    layers : Layers
        With all bonds; see `layer_cuts`.
    slots : Slots
    scratch : int
        Numbers in the work space of each thread.
    start : int
        Where the layers' memory begins in that of the engine.
    """

    def __init__(
        self,
        layout: Layout,
        offsets: np.ndarray,
        weights: np.ndarray,
        inside: Signs,
        outside: Signs,
        recursion: Mapping[tuple[int, int], tuple[np.ndarray, ...]],
        dtype: np.dtype,
        kept: np.dtype,
        remember: bool,
        alike: bool = True,
        stages: int = 1,
    ) -> None:
        # so that parts and their memory are of the field's magnitude, in all units
        self.unit = float(np.abs(weights).sum()) or 1.0
        self.layout, self.offsets, self.weights, self.remember = layout, offsets, weights / self.unit, remember
        self.alike, self.stages = alike, stages
        self.dtype, self.kept = dtype, kept
        self.lanes, self.signs = 64 // dtype.itemsize, (inside, outside)
        self.columns, self.rows = len(inside), len(outside)
        self._profiles = {name: i for i, name in enumerate(recursion)}
        self.even = [self._mirrors(axis) for axis in range(3)]
        self.sets = [1 if even else 2 for even in self.even]  # whether parts outwards and inwards are equal
        room = self._place()
        self.layers = self._layers(recursion, room)

    def _place(self) -> int:
        """Place bands, tiles, faces, edges and the sums over them, each of which takes its part of the memory; return
        the size of the slots.
        """
        self.memory = self.start = 0
        self.bands = np.zeros((2, LINE + 1), np.int64)
        self.slots = Slots(self.layout, self.sets[2], self.bands)
        room = self._make_bands()
        self.terms = Terms(self.layout, self.offsets, self.weights, self.dtype.itemsize, self.slots)
        self.tiles = self._make_tiles()
        self.faces = self._make_faces()
        self.edges, self.kinds = self._make_edges()
        self.band_sums = self.terms.count
        for row in range(self.rows):
            self.terms.add(row, [{}], [0, 1])
        return room

    def _layers(self, recursion: Mapping[tuple[int, int], tuple[np.ndarray, ...]], room: int) -> Layers:
        """Tables of the layers with all bonds."""
        none, real, terms = np.zeros(0, np.int64), self.dtype, self.terms
        r, e, f = self._recursions(recursion)
        neighbours = [list(terms.neighbours.get(across, ())) for across in ACROSS]
        return Layers(
            self.faces,
            self.bands,
            self.edges,
            self.kinds,
            self.tiles,
            *self._make_items(),
            np.array(terms.ends, np.int64),
            np.array(terms.places, np.int64),
            np.array(terms.factors, np.int64),
            np.array([n for found in neighbours for n in found], np.int64),
            np.cumsum([0, *map(len, neighbours)]),
            np.array(terms.values, real).reshape(-1, max(self.layout.reach)),
            none.reshape(0, 6),
            np.zeros(0, real),
            none,
            none.reshape(0, 8),
            np.zeros(0, real),
            none,
            none.reshape(0, 5),
            np.zeros(0, real),
            self._copies(),
            r,
            e,
            f,
            *self._mirrored(),
            self._sizes(),
            self.kept.itemsize * self.remember,
            real.type(self.unit),
            aligned_zeros(room, real),
            aligned_zeros(self.stages * aligned(self.memory) if self.remember else ALIGN * 4, self.kept),
        )

    def _recursions(self, recursion: Mapping[tuple[int, int], tuple[np.ndarray, ...]]) -> np.ndarray:
        """Numbers r, e and f of the layers, the last two zero without memory; shape (3, layers, columns + 1)."""
        longest = max((len(r) for r, _, _ in recursion.values()), default=1)
        tables = np.zeros((3, max(len(recursion), 1), longest), self.dtype)
        for i, of_layer in enumerate(recursion.values()):
            for row, values in zip(tables, of_layer, strict=True):
                row[i, : len(values)] = values
        if not self.remember:
            tables[1:] = 0
        return tables

    def _mirrors(self, axis: int) -> bool:
        """Whether the stencil is symmetric under reversal of an axis."""
        table = {tuple(o): w for o, w in zip(self.offsets.tolist(), self.weights, strict=True)}
        turned = ((tuple(-i if a == axis else i for a, i in enumerate(o)), w) for o, w in table.items())
        return all(o in table and np.array_equal(table[o], w) for o, w in turned)

    def _shifts(self, reach: int, nested: bool) -> tuple[int, int, int]:
        """Addresses of the stretched shifts of a reach, outwards and inwards, and of the sums that they take."""
        return load_shifts(reach, nested, not self.alike, self.dtype.name, self.kept.name)

    # --- where everything lies ---------------------------------------------------------------------------------

    def _make_bands(self) -> int:
        """Fill the table of bands; return the size of the slots."""
        layout, m, table, size = self.layout, self.layout.reach[2], self.bands, SLACK
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
                *self._shifts(m, False),
                width,
                size,
                self.memory,
                *layout.box.stride[:2],
                self.slots.grid[0],
            )
            size += self.columns * self.sets[2] * m * self.slots.lines * width
            self.memory += self.columns * groups * self._group_lanes() * (2 * columns + 1) * m
        return size + SLACK

    def _group_lanes(self) -> int:
        """Number of lines along the last axis to process side by side, such that the fewest lanes are empty."""
        n = self.layout.box.nodes[1]
        return min((size for size in range(LINES, 0, -self.lanes)), key=lambda size: -(-n // size) * size)

    def _make_tiles(self) -> np.ndarray:
        layout, rows, place = self.layout, [], 0
        low, high = (int(self.bands[i, COLUMNS] and self.bands[i, COLUMNS] + layout.reach[2]) for i in (0, 1))
        n = layout.box.nodes[2]
        # The tiles of the low band take all nodes that slots are stored for, which are zero beyond the band: the next
        # tiles then begin at whole vectors, so that what they read lies in one cache line.
        low = max(low, min(int(self.bands[0, WIDTH]), n - high))
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
            sums = self.terms.count
            for row, own in itertools.product(range(self.rows), range(self.sets[axis])):
                self.terms.add(row, [{axis: side * k * (1 - 2 * own)} for k in range(1, m + 1)], [other, 2])
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
                    *self._shifts(m, True),
                    count,
                    stride[other],
                    self.slots.first + first * self.slots.grid[axis],
                    side * self.slots.grid[axis],
                    self.slots.grid[other],
                    sums,
                    self.memory,
                    0,
                )
            )
            self.memory += self.rows * count * self._tile_lanes * (2 * columns + 1) * m
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
                sums, first_kind, cells = self.terms.count, len(kinds), 0
                for own, a in itertools.product(range(self.sets[0]), range(1, m[0] + 1)):
                    far = int(np.abs(self.offsets[np.abs(self.offsets[:, 0]) == a, 1]).max(initial=0))
                    start = -a if own == self.sets[0] - 1 else 0  # parts outwards are needed from column 0 on
                    kinds.append((far, start, cells, *(self._shifts(far, True) if far else (0, 0, 0))))
                    cells += (int(face[COLUMNS]) + 1 - start) * (2 * int(other[COLUMNS]) + 1) * far
                kinds_of = itertools.product(
                    range(self.rows), range(self.sets[0]), range(1, m[0] + 1), range(self.sets[1])
                )
                for row, own, a, inward in kinds_of:
                    x, y = sides[0] * a * (1 - 2 * own), sides[1] * (1 - 2 * inward)
                    self.terms.add(
                        row, [{0: x, 1: y * b} for b in range(1, kinds[first_kind + own * m[0] + a - 1][0] + 1)], [2]
                    )
                wide = int(other[COLUMNS]) + m[1]
                first = 0 if sides[1] < 0 else layout.box.nodes[1] - wide
                rows.append((number, other_number, sums, self.memory, cells, first, first + wide, first_kind))
                self.memory += self.rows * self._tile_lanes * cells
        return np.array(rows, np.int64).reshape(-1, 8), np.array(kinds, np.int64).reshape(-1, 6)

    def _make_items(self) -> tuple[np.ndarray, np.ndarray]:
        """Pieces of work, each done by one thread; those of the first axis take the rows of an edge together."""
        found: list[list[tuple[int, ...]]] = [[], []]
        for number, face in enumerate(self.faces):
            ends = [
                (int(e[EDGE_FIRST]), int(e[EDGE_ROWS]), i) for i, e in enumerate(self.edges) if e[EDGE_FACE] == number
            ]
            first = max((last for start, last, _ in ends if start == 0), default=0)
            last = min((start for start, _, _ in ends if start > 0), default=int(face[ROWS]))
            step = max(1, -(-(last - first) // 32))
            pieces = [(i, min(i + step, last), -1) for i in range(first, last, step)] + ends
            found[int(face[AXIS])] += [
                (number, *piece[:2], tile, piece[2]) for piece in pieces for tile in range(len(self.tiles))
            ]
        items = np.array(found[1] + found[0], np.int64).reshape(-1, 5)
        return items, np.array([0, len(found[1]), len(items)], np.int64)

    def in_a_line(self, side: int) -> int:
        """Number of slots beside a line along the last axis, of the layer on a side."""
        fields = self.columns * self.sets[2] * self.layout.reach[2]
        return sum(fields * int(band[WIDTH]) for band in self.bands if band[COLUMNS] and band[STEP] == side)

    def across(self, axis: int, side: int) -> np.ndarray:
        """Places of the slots in the halo on a side, and those that they repeat if the axis is periodic, shape (2, n);
        see `Layout.across`.
        """
        layout, found = self.layout, [np.zeros((2, 0), np.int64)]
        n, m = layout.box.nodes, layout.reach
        halo = np.arange(-m[axis], 0) if side < 0 else np.arange(n[axis], n[axis] + m[axis])
        pairs, earlier = [], HALOS[: HALOS.index(axis)]
        for along in (halo, halo % n[axis]) if axis < 2 else ():
            halos = [m[a] * (a in earlier) for a in (0, 1)]
            parts = [along if a == axis else np.arange(-halos[a], n[a] + halos[a]) for a in (0, 1)]
            pairs.append(self.slots.first + np.add.outer(parts[0] * self.slots.grid[0], parts[1]).ravel())
        for band in self.bands:
            if band[COLUMNS] and pairs:
                fields = np.arange(self.columns * self.sets[2] * layout.reach[2]) * self.slots.lines
                whole = [
                    np.add.outer(np.add.outer(fields, at) * band[WIDTH], np.arange(band[WIDTH])).ravel() + band[BASE]
                    for at in pairs
                ]
                found.append(np.array(whole))
        return np.concatenate(found, axis=1)

    def _copies(self) -> np.ndarray:
        """Places of the slots that repeat what lies across a periodic axis: (to, from)."""
        periodic = self.layout.periodic
        found = [self.across(axis, side) for axis in HALOS if axis in periodic for side in (-1, 1)]
        return np.concatenate([np.zeros((2, 0), np.int64), *found], axis=1)

    def _sizes(self) -> np.ndarray:
        """Make `Layers.sizes`, and set the size of a thread's work space."""
        n0, n1, _ = self.layout.box.nodes
        rows = [int(f[COLUMNS] + f[REACH] + 1) * int(f[REACH]) for f in self.faces]
        rows += [int(b[WIDTH] + TURNED) * int(b[REACH]) for b in self.bands]
        parts = 2 * max(rows)
        edge = crossing = 0
        for e in self.edges:
            face, other = self.faces[e[EDGE_FACE]], self.faces[e[EDGE_OTHER]]
            high = int(other[COLUMNS] + other[REACH] + 1)
            edge = max(edge, int(face[SETS] * face[REACH] * (face[COLUMNS] + face[REACH] + 1)) * high)
            crossing = max(crossing, self.rows * int(face[SETS] * other[SETS] * other[REACH]) * high)
        at_crossing = (self.rows + 2) * parts + self.rows * edge
        before = at_crossing + crossing
        factors = 0 if self.alike else max(map(len, self.terms.neighbours.values()), default=0)
        self.scratch = (before + factors) * LINES + SLACK
        return np.array(
            [
                n0,
                n1,
                self.slots.lines,
                self.slots.first,
                self.band_sums,
                parts,
                self._tile_lanes,
                self._group_lanes(),
                self.layout.box.origin,
                edge,
                before,
                at_crossing,
            ],
            np.int64,
        )

    def _mirrored(self) -> tuple[np.ndarray, np.ndarray]:
        """Make `Layers.mirrored` and `mirrored_weights`."""
        m, size = self.layout.reach, self.rows * self.columns
        functions, rows = np.zeros((3 + m[0], 2, 2), np.int64), [np.zeros(0)]
        if not self.alike or m[2] > self.lanes:
            return functions, np.concatenate(rows).astype(self.dtype)
        shape, matrices = mirrored(dict(zip(map(tuple, self.offsets.tolist()), self.weights, strict=True)), *self.signs)
        in_bands = bool(self.bands[:, COLUMNS].any())
        of_faces = [axis for axis in (0, 1) if (self.faces[:, AXIS] == axis).any()]
        wanted = [(axis, apart) for axis in of_faces for apart in (False, True)]
        wanted += [(3 + a, apart) for a in range(m[0] if len(self.edges) else 0) for apart in (False, True)]
        for number, apart in [*wanted, (2, True)]:
            chosen = [i for i, o in enumerate(shape) if self._takes(number, o) and (o[2] > 0 or not apart)]
            if (apart and not in_bands) or not 0 < np.count_nonzero(matrices[chosen]) <= UNROLLED_LIMIT:
                continue
            found = tuple(shape[i] for i in chosen)
            pattern = tuple(tuple(row) for row in (matrices[chosen].reshape(-1, size) != 0).tolist())
            differ, real = self.sets[2] == 2, self.dtype.name
            if number == 2:
                function = load_bands(found, pattern, *self.signs, differ, real)
            elif number < 3:
                both = self.sets[number] == 2
                function = load_parts(found, pattern, *self.signs, number, both, apart, differ, real)
            else:
                each, reach = (self.sets[0] == 2, self.sets[1] == 2), max(o[1] for o in found)
                function = load_crossing(found, pattern, *self.signs, each, reach, apart, differ, real)
            functions[number, int(apart)] = function, sum(map(len, rows))
            rows.append(matrices[chosen].ravel())
        return functions, np.concatenate(rows).astype(self.dtype)

    @staticmethod
    def _takes(number: int, offset: tuple[int, ...]) -> bool:
        """Whether the sums of a row of `Layers.mirrored` take the terms at an offset."""
        if number > 2:
            return offset[0] == number - 2 and offset[1] > 0
        return number == 2 or offset[number] > 0

    # --- the memory --------------------------------------------------------------------------------------------

    def cells(self, driven: np.ndarray) -> list[tuple[tuple[int, int], np.ndarray, Signs]]:
        """Places of the memory that is ever used, for each layer and then for each edge: its axis and side; the places,
        by component, number of the application, and line; and the signs of the components. `driven`, shape (layers,
        columns + 1), says which edges between columns use theirs.
        """
        found = []
        for number, band in enumerate(self.bands):
            if band[COLUMNS]:
                n0, n1, _ = self.layout.box.nodes
                size, cells = self._group_lanes(), int(2 * band[COLUMNS] + 1) * int(band[REACH])
                each, y = -(-n1 // size), np.arange(n1)
                group = (np.arange(n0)[:, None] * each + y // size).ravel()
                first = [
                    band[BAND_MEMORY] + (c * n0 * each + group) * size * cells + np.tile(y % size, n0)
                    for c in range(self.columns)
                ]
                used = self._used(band, driven)
                found.append(
                    ((2, 2 * number - 1), np.array([used[:, None] * size + at for at in first]), self.signs[0])
                )
        tile = np.repeat(np.arange(len(self.tiles)), self.tiles[:, TILE_COUNT])
        lane = np.arange(self.layout.box.nodes[2]) - self.tiles[tile, TILE_FIRST]
        size = self.tiles[tile, TILE_VECTORS] * self.lanes
        for face in self.faces:
            cells, rows = int(2 * face[COLUMNS] + 1) * int(face[REACH]), np.arange(face[ROWS])[:, None]
            used, places = self._used(face, driven), []
            for c in range(self.rows):
                first = (
                    face[MEMORY]
                    + ((c * face[ROWS] + rows) * self._tile_lanes + self.tiles[tile, TILE_PLACE]) * cells
                    + lane
                )
                places.append((first + used[:, None, None] * size).reshape(len(used), -1))
            found.append(((int(face[AXIS]), int(np.sign(face[STEP]))), np.array(places), self.signs[1]))
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
                edge[EDGE_MEMORY] + (c * self._tile_lanes + place) * edge[EDGE_CELLS] + lane for c in range(self.rows)
            ]
            found.append(
                ((1, int(np.sign(other[STEP]))), np.array([at + of_all[:, None] * size for at in first]), self.signs[1])
            )
        return found

    def lines(self) -> Iterator[tuple[str, np.ndarray, tuple[int, ...]]]:
        """Places of the memory of each layer and of each edge: its name; the places, by component, number of the
        application, and coordinates of the line along some axes of the box; and these axes.
        """

        def name(layer: np.ndarray) -> str:
            return f"{int(layer[AXIS])}{'-+'[int(layer[STEP]) > 0]}"

        kinds: list[tuple[str, tuple[int, ...]]] = [(name(one), (0, 1)) for one in self.bands if one[COLUMNS]]
        kinds += [(name(one), (1 - int(one[AXIS]), 2)) for one in self.faces]
        kinds += [(name(self.faces[one[EDGE_FACE]]) + name(self.faces[one[EDGE_OTHER]]), (2,)) for one in self.edges]
        every = self.cells(np.ones(self.layers.f.shape, bool))
        for stage, start in enumerate(self.starts):
            for (called, axes), (_, places, _) in zip(kinds, every, strict=True):
                places = start + places.reshape(*places.shape[:2], *(self.layout.box.nodes[a] for a in axes))
                yield called + f"/{stage}" * (stage > 0), places, axes

    @property
    def starts(self) -> list[int]:
        """Where the memory of each stage begins."""
        return [stage * aligned(self.memory) for stage in range(self.stages)]

    @staticmethod
    def _used(layer: np.ndarray, driven: np.ndarray, most: int | None = None) -> np.ndarray:
        """Numbers of the cells of one line whose edges are driven: those outwards, from the outer end inwards, then
        those inwards.
        """
        columns, most = int(layer[COLUMNS]), int(layer[REACH]) if most is None else most
        edges = np.concatenate([np.repeat(np.arange(columns, -1, -1), most), np.repeat(np.arange(columns), most)])
        return np.flatnonzero(driven[layer[PROFILE], edges])

"""Builds the tables of the layers of a box: where faces, edges and bands lie, the terms of a stencil that they sum, and
the pieces of work.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from farhorizon.engine.codegen.build import load_rows
from farhorizon.engine.codegen.choose import UNROLLED_LIMIT, mirror_stencil, mirrored
from farhorizon.engine.codegen.matrices import Signs
from farhorizon.engine.codegen.vector_operations import TURNED
from farhorizon.engine.layers import (
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
from farhorizon.engine.layout import ALIGN, HALOS, SLACK, Layout, aligned, aligned_zeros, with_defaults


@dataclass(frozen=True)
class Slots:
    """Where the slots of bands lie: for each component and each distance along the last axis one line beside every line
    of nodes, those of the halo included.
    """

    layout: Layout
    sets: int  # 1 if the values for neighbours ahead and behind are added up, 2 if both have slots
    bands: np.ndarray  # see `layers.Layers`

    @property
    def grid(self) -> tuple[int, int]:
        """Distances in lines between neighbours along the first two axes."""
        return self.layout.box.nodes[1] + 2 * self.layout.reach[1], 1

    @property
    def first(self) -> int:
        """Number of the line of the first node."""
        return self.layout.reach[0] * self.grid[0] + self.layout.reach[1]

    @property
    def lines(self) -> int:
        """Number of lines for one component and distance."""
        return (self.layout.box.nodes[0] + 2 * self.layout.reach[0]) * self.grid[0]

    def place(self, number: int, component: int, offset: Sequence[int]) -> int | None:
        """Place of the slots of a band that serve an offset, counted from the line of a node; None if none do, as for
        one of two mirror images, which are added up.
        """
        ahead, reach = int(offset[2]), self.layout.reach[2]
        if not self.bands[number, COLUMNS] or ahead == 0 or (self.sets == 1 and ahead < 0):
            return None
        inwards = self.sets == 2 and ahead * int(self.bands[number, STEP]) < 0
        distance = (component * self.sets + inwards) * reach + abs(ahead) - 1
        line = distance * self.lines + offset[0] * self.grid[0] + offset[1] * self.grid[1]
        return int(line * self.bands[number, WIDTH])


@dataclass(frozen=True)
class Terms:
    """Sums over the terms of a stencil, one after the other: rows of the tables of the same names in `layers.Layers`,
    where `values` are called `weights`.
    """

    layout: Layout
    offsets: np.ndarray  # shape (K, 3)
    weights: np.ndarray  # shape (K, rows, columns)
    itemsize: int  # bytes of a number of the field
    slots: Slots
    ends: list[list[int]] = field(default_factory=list)
    places: list[int] = field(default_factory=list)
    factors: list[int] = field(default_factory=list)
    values: list[np.ndarray] = field(default_factory=list)
    # for the axes along which sums run, the distances to neighbours along them and the numbers of these
    neighbours: dict[tuple[int, ...], dict[int, int]] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """Number of sums so far."""
        return len(self.ends) // 3

    def add(self, row: int, fixed: Sequence[Mapping[int, int]], across: Sequence[int]) -> None:
        """Add sums for one component of the result, each with `fixed` offsets along some axes, over terms at all
        offsets along the axes `across`; without fixed offsets, only those over the slots of bands.
        """
        stride, numbers = self.layout.box.stride, self.neighbours.setdefault(tuple(across), {})
        for band in (None, 0, 1):
            terms: dict[tuple[int, int], np.ndarray] = {}
            for k, offset_along in enumerate(fixed):
                chosen = np.ones(len(self.offsets), bool)
                for axis, value in offset_along.items():
                    chosen &= self.offsets[:, axis] == value
                for offset, matrix in zip(self.offsets[chosen].tolist(), self.weights[chosen], strict=True):
                    distance = sum(offset[a] * stride[a] for a in across)  # to the coefficient
                    line = [offset[a] if a in across or a == 2 else 0 for a in range(3)]
                    for column in np.flatnonzero(matrix[row]).tolist() if band is not None or offset_along else ():
                        place = (
                            distance + column * self.layout.size
                            if band is None
                            else self.slots.place(band, column, line)
                        )
                        if place is not None:
                            weights = terms.setdefault((place, distance), np.zeros(max(self.layout.reach)))
                            weights[k] += matrix[row, column]
            self._append(terms, len(fixed), numbers)

    def _append(self, terms: dict[tuple[int, int], np.ndarray], sums: int, numbers: dict[int, int]) -> None:
        """Append terms in groups: those that the last sum has, then those that the last but one has, and so on."""
        first = len(self.places)
        used = {key: int(np.flatnonzero(w)[-1]) + 1 for key, w in terms.items()}
        for key in sorted(terms, key=lambda key: (-used[key], key)):
            self.places.append(key[0] * self.itemsize)
            self.factors.append(numbers.setdefault(key[1], len(numbers)) * LINES * self.itemsize)
            self.values.append(terms[key])
        last = [first + sum(n >= k for n in used.values()) for k in range(sums, 0, -1)]
        self.ends.append([first, *last, *[0] * (max(self.layout.reach) - sums)])


class LayerSetup(NamedTuple):
    """What the layers of all passes of an engine have in common."""

    layout: Layout
    offsets: np.ndarray  # of the stencil, shape (K, 3)
    recursion: Mapping[tuple[int, int], tuple[np.ndarray, ...]]  # r, e and f by (axis, side), shapes (columns + 1,)
    dtype: np.dtype  # of the field
    kept: np.dtype  # of what the layers remember
    remember: bool  # whether they have memory
    stages: int = 1  # of a step, each of which has a memory of its own


class LayerTables:
    """Builds the tables of the layers of a pass from a field of `columns` components to one of `rows` components, whose
    signs in mirrors are `inside` and `outside`; `weights` has the shape (K, rows, columns). Bonds have coefficients
    unless they are `alike`.
    """

    layers: Layers  # with all bonds; see `layer_passes.cut_layers`
    slots: Slots
    scratch: int  # numbers in the work space of each thread
    start: int  # where the layers' memory begins in that of the engine

    def __init__(
        self, setup: LayerSetup, weights: np.ndarray, inside: Signs, outside: Signs, alike: bool = True
    ) -> None:
        # so that parts and their memory are of the field's magnitude, in all units
        self.unit = float(np.abs(weights).sum()) or 1.0
        self.layout, self.offsets, self.weights = setup.layout, setup.offsets, weights / self.unit
        self.dtype, self.kept, self.remember, self.alike = setup.dtype, setup.kept, setup.remember, alike
        self.stages = setup.stages
        self.lanes, self.signs = 64 // self.dtype.itemsize, (inside, outside)
        self.columns, self.rows = len(inside), len(outside)
        self._profiles = {name: i for i, name in enumerate(setup.recursion)}
        self.even = [self._mirrors(axis) for axis in range(3)]
        self.sets = [1 if even else 2 for even in self.even]  # whether parts outwards and inwards are equal
        room = self._place()
        self.layers = self._layers(setup.recursion, room)

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
        real, terms = self.dtype, self.terms
        r, e, f = self._recursions(recursion)
        items, item_ranges = self._make_items()
        neighbours = [list(terms.neighbours.get(across, ())) for across in ACROSS]
        mirrored, mirrored_weights = self._mirrored()
        return with_defaults(
            Layers,
            real,
            faces=self.faces,
            bands=self.bands,
            edges=self.edges,
            kinds=self.kinds,
            tiles=self.tiles,
            items=items,
            item_ranges=item_ranges,
            ends=np.array(terms.ends, np.int64),
            places=np.array(terms.places, np.int64),
            factors=np.array(terms.factors, np.int64),
            neighbours=np.array([n for distances in neighbours for n in distances], np.int64),
            spans=np.cumsum([0, *map(len, neighbours)]),
            weights=np.array(terms.values, real).reshape(-1, max(self.layout.reach)),
            r=r,
            e=e,
            f=f,
            mirrored=mirrored,
            mirrored_weights=mirrored_weights,
            sizes=self._sizes(),
            cell=self.kept.itemsize * self.remember,
            unit=real.type(self.unit),
            slots=aligned_zeros(room, real),
            memory=aligned_zeros(self.stages * aligned(self.memory) if self.remember else ALIGN * 4, self.kept),
            copies=self._copies(),
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
        images = ((tuple(-i if a == axis else i for a, i in enumerate(o)), w) for o, w in table.items())
        return all(o in table and np.array_equal(table[o], w) for o, w in images)

    def _shifts(self, reach: int, nested: bool) -> tuple[int, ...]:
        """Addresses of the stretched shifts of a reach, outwards and inwards, and of the sums that they take."""
        varied, real, kept = not self.alike, self.dtype.name, self.kept.name
        return load_rows("shift_rows", reach=reach, nested=nested, varied=varied, real=real, kept=kept)

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
            for row, inward in itertools.product(range(self.rows), range(self.sets[axis])):
                self.terms.add(row, [{axis: side * k * (1 - 2 * inward)} for k in range(1, m + 1)], [other, 2])
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
                for inward, a in itertools.product(range(self.sets[0]), range(1, m[0] + 1)):
                    far = int(np.abs(self.offsets[np.abs(self.offsets[:, 0]) == a, 1]).max(initial=0))
                    start = -a if inward == self.sets[0] - 1 else 0  # parts outwards are needed from column 0 on
                    kinds.append((far, start, cells, *(self._shifts(far, True) if far else (0, 0, 0))))
                    cells += (int(face[COLUMNS]) + 1 - start) * (2 * int(other[COLUMNS]) + 1) * far
                parts = itertools.product(
                    range(self.rows), range(self.sets[0]), range(1, m[0] + 1), range(self.sets[1])
                )
                for row, inward, a, inward_other in parts:
                    x, y = sides[0] * a * (1 - 2 * inward), sides[1] * (1 - 2 * inward_other)
                    far = kinds[first_kind + inward * m[0] + a - 1][0]
                    self.terms.add(row, [{0: x, 1: y * b} for b in range(1, far + 1)], [2])
                wide = int(other[COLUMNS]) + m[1]
                first = 0 if sides[1] < 0 else layout.box.nodes[1] - wide
                rows.append((number, other_number, sums, self.memory, cells, first, first + wide, first_kind))
                self.memory += self.rows * self._tile_lanes * cells
        return np.array(rows, np.int64).reshape(-1, 8), np.array(kinds, np.int64).reshape(-1, 6)

    def _make_items(self) -> tuple[np.ndarray, np.ndarray]:
        """Pieces of work, each done by one thread; those of the first axis take the rows of an edge together."""
        by_axis: list[list[tuple[int, ...]]] = [[], []]
        for number, face in enumerate(self.faces):
            ends = [
                (int(e[EDGE_FIRST]), int(e[EDGE_ROWS]), i) for i, e in enumerate(self.edges) if e[EDGE_FACE] == number
            ]
            first = max((last for start, last, _ in ends if start == 0), default=0)
            last = min((start for start, _, _ in ends if start > 0), default=int(face[ROWS]))
            step = max(1, -(-(last - first) // 32))
            pieces = [(i, min(i + step, last), -1) for i in range(first, last, step)] + ends
            by_axis[int(face[AXIS])] += [
                (number, *piece[:2], tile, piece[2]) for piece in pieces for tile in range(len(self.tiles))
            ]
        items = np.array(by_axis[1] + by_axis[0], np.int64).reshape(-1, 5)
        return items, np.array([0, len(by_axis[1]), len(items)], np.int64)

    def in_a_line(self, side: int) -> int:
        """Number of slots beside a line along the last axis, of the layer on a side."""
        fields = self.columns * self.sets[2] * self.layout.reach[2]
        return sum(fields * int(band[WIDTH]) for band in self.bands if band[COLUMNS] and band[STEP] == side)

    def across(self, axis: int, side: int) -> np.ndarray:
        """Places of the slots in the halo on a side, and those that they repeat if the axis is periodic, shape (2, n);
        see `Layout.across`.
        """
        layout, slots = self.layout, [np.zeros((2, 0), np.int64)]
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
                of_band = [
                    np.add.outer(np.add.outer(fields, lines) * band[WIDTH], np.arange(band[WIDTH])).ravel() + band[BASE]
                    for lines in pairs
                ]
                slots.append(np.array(of_band))
        return np.concatenate(slots, axis=1)

    def _copies(self) -> np.ndarray:
        """Places of the slots that repeat what lies across a periodic axis: (to, from)."""
        periodic = self.layout.periodic
        halos = [self.across(axis, side) for axis in HALOS if axis in periodic for side in (-1, 1)]
        return np.concatenate([np.zeros((2, 0), np.int64), *halos], axis=1)

    def _sizes(self) -> np.ndarray:
        """Make `Layers.sizes`, and set the size of a thread's work space."""
        n0, n1, _ = self.layout.box.nodes
        rows = [int(f[COLUMNS] + f[REACH] + 1) * int(f[REACH]) for f in self.faces]
        rows += [int(b[WIDTH] + TURNED) * int(b[REACH]) for b in self.bands]
        parts = 2 * max(rows)  # outwards and inwards
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
        m = self.layout.reach
        functions, rows = np.zeros((3 + m[0], 2, 2), np.int64), [np.zeros(0)]
        if not self.alike or m[2] > self.lanes:
            return functions, np.concatenate(rows).astype(self.dtype)
        shape, matrices = mirrored(dict(zip(map(tuple, self.offsets.tolist()), self.weights, strict=True)), *self.signs)
        in_bands = bool(self.bands[:, COLUMNS].any())
        of_faces = [axis for axis in (0, 1) if (self.faces[:, AXIS] == axis).any()]
        sums = [(axis, apart) for axis in of_faces for apart in (False, True)]  # apart: over the slots of bands
        sums += [(3 + a, apart) for a in range(m[0] if len(self.edges) else 0) for apart in (False, True)]
        for number, apart in [*sums, (2, True)]:
            chosen = [i for i, o in enumerate(shape) if self._takes(number, o) and (o[2] > 0 or not apart)]
            if (apart and not in_bands) or not 0 < np.count_nonzero(matrices[chosen]) <= UNROLLED_LIMIT:
                continue
            offsets = tuple(shape[i] for i in chosen)
            stencil = mirror_stencil(offsets, matrices[chosen], *self.signs)
            settings: dict[str, Any] = {"stencil": stencil, "differ": self.sets[2] == 2, "real": self.dtype.name}
            if number == 2:
                rows_of = "band_rows"
            elif number < 3:
                rows_of = "part_rows"
                settings |= {"axis": number, "both": self.sets[number] == 2, "apart": apart}
            else:
                rows_of = "crossing_rows"
                both, reach = (self.sets[0] == 2, self.sets[1] == 2), max(o[1] for o in offsets)
                settings |= {"both": both, "reach": reach, "apart": apart}
            functions[number, int(apart)] = *load_rows(rows_of, **settings), sum(map(len, rows))
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
        cells_of: list[tuple[tuple[int, int], np.ndarray, Signs]] = []
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
                cells_of.append(
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
            cells_of.append(((int(face[AXIS]), int(np.sign(face[STEP]))), np.array(places), self.signs[1]))
        for edge in self.edges:
            face, other = self.faces[edge[EDGE_FACE]], self.faces[edge[EDGE_OTHER]]
            used_in_column: list[np.ndarray] = []
            end = 0
            for inward, a in itertools.product(range(face[SETS]), range(face[REACH])):
                most, start = self.kinds[edge[EDGE_KINDS] + inward * face[REACH] + a, :2]
                used = self._used(other, driven, int(most))
                for _ in range(start, face[COLUMNS] + 1):
                    used_in_column.append(end + used)
                    end += int(2 * other[COLUMNS] + 1) * int(most)
            used = np.concatenate(used_in_column)
            place = self.tiles[tile, TILE_PLACE]
            first = [
                edge[EDGE_MEMORY] + (c * self._tile_lanes + place) * edge[EDGE_CELLS] + lane for c in range(self.rows)
            ]
            cells_of.append(
                ((1, int(np.sign(other[STEP]))), np.array([at + used[:, None] * size for at in first]), self.signs[1])
            )
        return cells_of

    def lines(self) -> Iterator[tuple[str, np.ndarray, tuple[int, ...]]]:
        """Places of the memory of each layer and of each edge: its name; the places, by component, number of the
        application, and coordinates of the line along some axes of the box; and these axes.
        """

        def name(layer: np.ndarray) -> str:
            return f"{int(layer[AXIS])}{'-+'[int(layer[STEP]) > 0]}"

        kinds: list[tuple[str, tuple[int, ...]]] = [(name(band), (0, 1)) for band in self.bands if band[COLUMNS]]
        kinds += [(name(face), (1 - int(face[AXIS]), 2)) for face in self.faces]
        kinds += [(name(self.faces[edge[EDGE_FACE]]) + name(self.faces[edge[EDGE_OTHER]]), (2,)) for edge in self.edges]
        cells = self.cells(np.ones(self.layers.f.shape, bool))
        for stage, start in enumerate(self.starts):
            for (called, axes), (_, places, _) in zip(kinds, cells, strict=True):
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

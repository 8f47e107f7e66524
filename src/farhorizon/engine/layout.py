"""Where every value lives: the core block, the layer blocks, their strides, and the order in which halos are filled.

A *level* is one flat array: the core with its halo, then one *plane* a layer block, its nodes. A layer column p along a
stretched axis also needs the continued values U(p, k) for k = -m..m, its *slots*. Slot (k, p) lies at ``k * columns + p``: a
node's neighbours along the axis are ``columns`` apart and its nodes are neighbours in memory, so the plain stencil applies to
layer nodes as it does to core nodes; only the distances differ.

A field of several components has one such level, and one such set of slots, for each, one after the other.

Slots are wanted for one sweep only. The blocks that share their first stretched axis and its side form a *tree*: it is filled axis by axis
from the planes, swept, and its slots are given to the next tree, so that they hardly leave the cache.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

#: Lines that one halo task sweeps together, and the values kept before and after an array for vector loads.
LINES = 32
SLACK = 64
#: Values whose bytes are a whole number of cache lines, in either precision.
ALIGN = 16

#: Columns of the halo task table; the compiled driver reads them by these positions.
TASK_FIELDS = ("inner", "inner_k", "inner_line", "node", "node_p", "node_line", "slot", "slot_p", "slot_k", "slot_line", "count", "memory", "kmax",
               "profile", "columns", "first")  # fmt: skip
#: Columns of the block table.
BLOCK_FIELDS = ("slot", "n0", "n1", "n2", "step0", "step1", "stride0", "stride1", "stride2", "out", "out_step0", "out_step1",
                "read0", "read1", "read2", "written0", "written1", "written2")  # fmt: skip


@dataclass
class Grid:
    """Places of a block's values in memory, per axis."""

    base: int
    extent: tuple[int, ...]  # places, halo included
    step: tuple[int, ...]  # between nodes
    stride: tuple[int, ...]  # between neighbours
    pad: tuple[int, ...]  # neighbours before the first node

    @property
    def origin(self) -> int:
        """Index of the first node."""
        return self.base + sum(m * s for m, s in zip(self.pad, self.stride, strict=True))

    def nodes(self, count: tuple[int, ...]) -> np.ndarray:
        """Indices of the nodes."""
        parts = [np.arange(n) * s for n, s in zip(count, self.step, strict=True)]
        return self.origin + np.add.outer(np.add.outer(parts[0], parts[1]), parts[2])

    def all(self, array: np.ndarray) -> np.ndarray:
        """All places, halo included; shares memory."""
        strides = [min(s, t) * array.itemsize for s, t in zip(self.stride, self.step, strict=True)]
        return np.lib.stride_tricks.as_strided(array[self.base :], self.extent, strides)


@dataclass
class Block:
    """One box of nodes: per axis the core (0), the low layer (-1) or the high layer (+1)."""

    segment: tuple[int, ...]
    nodes: tuple[int, ...]
    order: tuple[int, ...]  # axes from slowest to fastest in memory
    reach: tuple[int, ...]
    plane: Grid  # in a level
    slots: Grid  # beyond the end of a level; the core's plane serves as its slots
    components: int = 1
    distance: int = 0  # of the components in a level

    @property
    def first(self) -> int:
        """First stretched axis (the core: 3)."""
        return next((a for a in range(3) if self.segment[a]), 3)

    @property
    def stride(self) -> tuple[int, ...]:
        """Distances between neighbours, per axis."""
        return self.slots.stride

    def view(self, level: np.ndarray) -> np.ndarray:
        """Nodes of this block in one level, indexed by axis, or by component and axis; shares memory."""
        shape, steps = ((self.nodes, self.plane.step) if self.components == 1 else
                        ((self.components, *self.nodes), (self.distance, *self.plane.step)))  # fmt: skip
        return np.lib.stride_tricks.as_strided(level[self.plane.origin :], shape, [s * level.itemsize for s in steps])

    def node_indices(self) -> np.ndarray:
        """Indices of all nodes in a level (of the first component), indexed by axis."""
        return self.plane.nodes(self.nodes)

    def slot_indices(self) -> np.ndarray:
        """Indices of all nodes among the slots (core: in the level), indexed by axis; a neighbour is `stride` away."""
        return self.slots.nodes(self.nodes)

    def along(self, grid: Grid, axis: int, nodes_only: bool) -> np.ndarray:
        """Distances from a grid's base along one axis: of the nodes, or of every place."""
        if nodes_only:
            return grid.pad[axis] * grid.stride[axis] + grid.step[axis] * np.arange(self.nodes[axis])
        return min(grid.stride[axis], grid.step[axis]) * np.arange(grid.extent[axis])


def _aligned(count: int) -> int:
    return -(-count // ALIGN) * ALIGN


def _row(count: int) -> int:
    """Length of a row in memory: an odd multiple of `ALIGN`, so that neighbouring rows do not compete for the same part of a cache."""
    parts = -(-count // ALIGN)
    return (parts + 1 - parts % 2) * ALIGN


@dataclass
class Layout:
    """Blocks and halo operations of a core of given size.

    Parameters
    ----------
    core : tuple of int
        Nodes of the core along the three axes (leading axes have one node in 1D and 2D).
    offsets : ndarray, shape (K, 3)
        Stencil offsets.
    layers : mapping of (axis, side) to (columns, profile number)
        Sides that carry a layer; side is -1 or +1.
    periodic : set of int
        Axes that close on themselves.
    components : int
        Of the field. What follows is for one of them.

    Attributes
    ----------
    size : int
        Values of a level.
    places : int
        Indices in use: those of a level, then those of all slots.
    trees : list of tuple (first, last)
        Ranges of `places`; all begin at the same slot in memory.
    slots : int
        Slots in memory: those of the largest tree.
    copies : dict of (tree, axis) to ndarray, shape (2, n)
        Periodic copies, and blanks, (to, from) in the slots of a tree; tree -1: in a level.
    tasks : dict of (tree, axis) to ndarray
        Rows of `TASK_FIELDS`.
    """

    core: tuple[int, int, int]
    offsets: np.ndarray
    layers: Mapping[tuple[int, int], tuple[int, int]]
    periodic: frozenset[int]
    components: int = 1
    blocks: dict[tuple[int, ...], Block] = field(init=False)
    size: int = field(init=False)
    places: int = field(init=False)
    trees: list[tuple[int, int]] = field(init=False)
    slots: int = field(init=False)
    copies: dict[tuple[int, int], np.ndarray] = field(init=False)
    tasks: dict[tuple[int, int], np.ndarray] = field(init=False)
    memory: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        self.reach = tuple(int(n) for n in np.abs(self.offsets).max(0))
        self._place_blocks()
        self.copies, self.tasks = {}, {}
        for axis in range(3):
            if self.reach[axis]:
                self._collect(axis)

    # --- where the blocks lie ----------------------------------------------------------------------------------

    def tree(self, block: Block) -> int:
        """Number of the tree that a layer block belongs to (the core: -1)."""
        return self._tree_keys.index(self._tree_key(block)) if any(block.segment) else -1

    def _tree_key(self, block: Block) -> tuple[int, int]:
        return (block.first, block.segment[block.first])

    def _place_blocks(self) -> None:
        sides = [[s for s in (0, -1, 1) if s == 0 or (a, s) in self.layers] for a in range(3)]
        blocks = [self._shape_of(segment) for segment in itertools.product(*sides)]
        self._tree_keys = sorted({self._tree_key(b) for b in blocks if any(b.segment)})
        blocks.sort(key=lambda b: (self.tree(b), sum(map(abs, b.segment)), b.segment))
        self.blocks = {b.segment: b for b in blocks}
        end = SLACK
        for block in blocks:
            grid = block.plane
            grid.base = end + -grid.origin % ALIGN
            end = _aligned(grid.base + grid.extent[block.order[0]] * grid.step[block.order[0]])
        self.size = end = _aligned(end + SLACK)
        for block in blocks:
            block.components, block.distance = self.components, self.size
        self.trees = []
        for number in range(len(self._tree_keys)):
            start, end = end, end + SLACK
            for block in (b for b in blocks if self.tree(b) == number):
                grid, slowest = block.slots, block.order[0]
                grid.base = end
                end += _aligned(grid.extent[slowest] * min(grid.stride[slowest], grid.step[slowest]))
            end = _aligned(end + SLACK)
            self.trees.append((start, end))
        self.places = end
        self.slots = max((last - first for first, last in self.trees), default=0)

    def _shape_of(self, segment: tuple[int, ...]) -> Block:
        """Extents and distances of a block, not yet its place."""
        idle = [a for a in range(3) if self.reach[a] == 0]  # axes that 1D and 2D lack stay slowest
        stretched = [a for a in range(3) if segment[a]]
        free = [a for a in range(3) if not segment[a] and a not in idle]
        # Lines along the fastest axis; the slots of one line close together.
        order = tuple(idle + free[:-1] + stretched[::-1] + free[-1:])
        nodes = tuple(self.layers[a, side][0] if side else self.core[a] for a, side in enumerate(segment))
        first = stretched[0] if stretched else 3
        pad = tuple(m if a < first else 0 for a, m in enumerate(self.reach))  # what later trees read beyond the nodes
        plane = self._grid(order, tuple(n + 2 * m for n, m in zip(nodes, pad, strict=True)), nodes, pad, (), idle)
        if not stretched:
            return Block(segment, nodes, order, self.reach, plane, plane)
        extent = tuple(n * (2 * m + 1) if side else n + 2 * m for n, m, side in zip(nodes, self.reach, segment, strict=True))
        return Block(segment, nodes, order, self.reach, plane, self._grid(order, extent, nodes, self.reach, stretched, idle))

    @staticmethod
    def _grid(order, extent, nodes, pad, stretched, idle) -> Grid:  # type: ignore[no-untyped-def]
        step, run = [0, 0, 0], 1
        for place, a in enumerate(reversed(order)):
            step[a] = run
            length = extent[a]
            if place == 0 and a not in stretched and len(idle) < 2:
                length = _row(length)
            elif place == 1 and a not in stretched and not idle:
                length += 1 - length % 2
            run *= length
        stride = tuple(s * (n if a in stretched else 1) for a, (s, n) in enumerate(zip(step, nodes, strict=True)))
        return Grid(0, extent, tuple(step), stride, pad)

    @property
    def task_sides(self) -> list[tuple[int, int]]:
        """(axis, side) of the layers that the entries of `tasks` fill, where only one axis has layers."""
        return [self._tree_keys[tree] for tree, _ in self.tasks]

    def in_tree(self, index: int, tree: int) -> int:
        """Place of an index beyond `size` in the memory that the trees share."""
        return index - self.trees[tree][0]

    def table(self) -> np.ndarray:
        """One row of `BLOCK_FIELDS` a block, the core first; axes, and components with them, in the block's own order."""
        rows = []
        for block in self.blocks.values():
            first, second, third = block.order
            grid, plane, tree = block.slots, block.plane, self.tree(block)
            assert grid.step[third] == plane.step[third] == 1, "nodes along the fastest axis must be neighbours in memory"
            lead = 3 - self.components
            number = [a - lead for a in block.order if a >= lead] + [0] * lead if self.components > 1 else [0] * 3
            rows.append((
                grid.origin if tree < 0 else self.in_tree(grid.origin, tree), *(block.nodes[a] for a in block.order), grid.step[first],
                grid.step[second], *(grid.stride[a] for a in block.order), plane.origin, plane.step[first], plane.step[second],
                *(c * (self.size if tree < 0 else self.slots) for c in number), *(c * self.size for c in number),
            ))  # fmt: skip
        return np.array(rows, np.int64)

    # --- how halos are filled ----------------------------------------------------------------------------------

    def _needed(self, axis: int, fixed: dict[int, int]) -> int:
        """Largest offset along `axis` among stencil offsets at least as far out as `fixed` along other axes."""
        far = np.ones(len(self.offsets), bool)
        for other, k in fixed.items():
            far &= np.abs(self.offsets[:, other]) >= abs(k)
        return int(np.abs(self.offsets[far, axis]).max(initial=0))

    def _slot_offset(self, block: Block, axis: int, slot: int) -> int:
        """Offset k that a slot of a layer stands for; 0 in the core, whose halo serves every offset."""
        return slot // block.nodes[axis] - self.reach[axis] if block.segment[axis] else 0

    def _collect(self, axis: int) -> None:
        """Operations of one axis: periodic copies, and the tasks that continue a block into its layer.

        Where a side has neither, the halo is zero; trees that do not lie alike in the memory they share leave their values in each other's.
        """
        shapes = {(a, columns) for (a, _), (columns, _) in self.layers.items()}
        copies: dict[tuple[int, int], list[np.ndarray]] = {}
        tasks: dict[tuple[int, int], list[tuple[int, ...]]] = {}
        for segment, inner in self.blocks.items():
            if segment[axis]:
                continue
            # Before its first stretched axis a block is read and completed in the level, after it among the slots.
            tree = -1 if axis < inner.first else self.tree(inner)
            if axis in self.periodic:
                copies.setdefault((tree, axis), []).append(self._wrap(axis, inner, tree))
            for side in (-1, 1):
                if (axis, side) in self.layers:
                    layer = self.blocks[tuple(side if a == axis else s for a, s in enumerate(segment))]
                    tasks.setdefault((self.tree(layer), axis), []).extend(self._continue(axis, side, inner, layer, tree))
                elif axis not in self.periodic and tree >= 0 and len(shapes) > 1:
                    copies.setdefault((tree, axis), []).append(self._blank(axis, side, inner))
        self.copies |= {key: np.concatenate(parts, axis=1) for key, parts in copies.items()}
        self.tasks |= {key: np.array(rows, np.int64).reshape(-1, len(TASK_FIELDS)) for key, rows in tasks.items()}

    def _wrap(self, axis: int, block: Block, tree: int) -> np.ndarray:
        n, m = block.nodes[axis], self.reach[axis]
        pads = np.r_[0:m, n + m : n + 2 * m]
        wrapped = (pads - m) % n + m
        return np.array([self._lines(axis, block, tree, at) for at in (pads, wrapped)])

    def _blank(self, axis: int, side: int, block: Block) -> np.ndarray:
        """The halo of one side among the slots, from the first of them, which nothing is ever written to."""
        n, m = block.nodes[axis], self.reach[axis]
        pads = self._lines(axis, block, self.tree(block), np.arange(m) + (n + m if side > 0 else 0))
        return np.array([pads, np.zeros_like(pads)])

    def _lines(self, axis: int, block: Block, tree: int, at: np.ndarray) -> np.ndarray:
        """Places `at` along an axis on all lines: in a level, or among the slots of a tree."""
        grid = block.plane if tree < 0 else block.slots
        base = grid.base if tree < 0 else self.in_tree(grid.base, tree)
        lines = base + np.add.outer(*[block.along(grid, a, nodes_only=a > axis) for a in range(3) if a != axis]).ravel()
        return np.add.outer(at * grid.stride[axis], lines).ravel()

    def _continue(self, axis: int, side: int, inner: Block, layer: Block, tree: int) -> list[tuple[int, ...]]:
        """Halo tasks of one face: up to LINES lines each, lines along the layer's fastest unstretched axis."""
        columns, profile = self.layers[axis, side]
        others = [a for a in range(3) if a != axis]
        line = max(others, key=lambda a: (layer.nodes[a] > 1, layer.order.index(a)))
        outer = next(a for a in others if a != line)
        target = self.tree(layer)
        inner_grid, node_grid, slot_grid = (inner.plane, layer.plane, layer.slots) if tree < 0 else (inner.slots, layer.slots, layer.slots)
        edge = inner.nodes[axis] - 1 if side > 0 else 0
        bases = [
            inner_grid.base + inner_grid.stride[axis] * inner_grid.pad[axis] + inner_grid.step[axis] * edge,
            node_grid.base + node_grid.stride[axis] * node_grid.pad[axis],
            slot_grid.base + slot_grid.stride[axis] * slot_grid.pad[axis],
        ]
        bases = [b if b < self.size else self.in_tree(b, target) for b in bases]
        blocks, grids = (inner, layer, layer), (inner_grid, node_grid, slot_grid)
        outers = [b.along(g, outer, outer > axis) for b, g in zip(blocks, grids, strict=True)]
        lines = [b.along(g, line, line > axis) for b, g in zip(blocks, grids, strict=True)]
        step = [int(v[1] - v[0]) if len(v) > 1 else 1 for v in lines]
        rows: list[tuple[int, ...]] = []
        for number in range(len(outers[2])):
            kmax = self._needed(axis, {outer: self._slot_offset(layer, outer, number)} if outer < axis else {})
            if kmax == 0:
                continue
            for first in range(0, len(lines[2]), LINES):
                at = [base + int(o[number] + v[first]) for base, o, v in zip(bases, outers, lines, strict=True)]
                rows.append((
                    at[0], side * inner_grid.stride[axis], step[0], at[1], node_grid.step[axis], step[1], at[2], slot_grid.step[axis],
                    side * slot_grid.stride[axis], step[2], min(LINES, len(lines[2]) - first), self.memory, kmax, profile, columns, int(tree < 0),
                ))  # fmt: skip
                self.memory += (columns + 1) * 2 * kmax * LINES
        return rows

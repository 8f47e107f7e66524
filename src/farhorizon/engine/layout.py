"""Where every value lives: the core block, the layer blocks, their strides, and the order in which halos are filled.

A *level* is one flat array: the core with its halo, then the nodes of every layer block. A layer column p along a stretched
axis also needs the continued values U(p, k) for k = -m..m; they are wanted for one step only, so all levels share one flat
array of *slots*. Slot (k, p) lies at ``k * columns + p``: a node's neighbours along the axis are ``columns`` apart and its
nodes are neighbours in memory, so the plain stencil applies to layer nodes as it does to core nodes; only the distances differ.

An index below `Layout.size` points into a level, one above it into the slots.
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
TASK_FIELDS = ("inner", "inner_k", "inner_line", "layer", "layer_p", "layer_k", "layer_line", "count", "memory", "kmax", "profile", "columns",
               "inner_in_slots")  # fmt: skip
#: Columns of the block table.
BLOCK_FIELDS = ("in_slots", "origin", "n0", "n1", "n2", "step0", "step1", "stride0", "stride1", "stride2", "out", "out_step0", "out_step1")


@dataclass
class Block:
    """One box of nodes: per axis the core (0), the low layer (-1) or the high layer (+1)."""

    segment: tuple[int, ...]
    base: int
    extent: tuple[int, ...]  # slots along each axis, halo included
    stride: tuple[int, ...]  # between neighbours, per axis
    step: tuple[int, ...]  # between nodes, per axis
    nodes: tuple[int, ...]
    order: tuple[int, ...]  # axes from slowest to fastest in memory
    reach: tuple[int, ...]
    node_origin: int = 0  # the same nodes in a level
    node_step: tuple[int, ...] = (0, 0, 0)

    @property
    def origin(self) -> int:
        """Index of the first node among the slots (core: in the level)."""
        return self.base + sum(m * s for m, s in zip(self.reach, self.stride, strict=True))

    def view(self, level: np.ndarray) -> np.ndarray:
        """Nodes of this block in one level, indexed by axis; shares memory."""
        return np.lib.stride_tricks.as_strided(level[self.node_origin :], self.nodes, [s * level.itemsize for s in self.node_step])

    def node_indices(self) -> np.ndarray:
        """Indices of all nodes in a level, indexed by axis."""
        return self.node_origin + _outer([np.arange(n) * s for n, s in zip(self.nodes, self.node_step, strict=True)])

    def slot_indices(self) -> np.ndarray:
        """Indices of all nodes among the slots (core: in the level), indexed by axis; a neighbour is ``stride`` away."""
        return self.origin + _outer([np.arange(n) * s for n, s in zip(self.nodes, self.step, strict=True)])

    def along(self, axis: int, nodes_only: bool) -> np.ndarray:
        """Distances from the block's base along one axis: of the nodes, or of every slot."""
        if nodes_only:
            return self.reach[axis] * self.stride[axis] + self.step[axis] * np.arange(self.nodes[axis])
        return min(self.stride[axis], self.step[axis]) * np.arange(self.extent[axis])

    def slots(self, array: np.ndarray) -> np.ndarray:
        """All slots of this block, halo included, in an array over levels and slots; shares memory."""
        strides = [min(s, t) * array.itemsize for s, t in zip(self.stride, self.step, strict=True)]
        return np.lib.stride_tricks.as_strided(array[self.base :], self.extent, strides)


def _outer(parts: list[np.ndarray]) -> np.ndarray:
    return np.add.outer(np.add.outer(parts[0], parts[1]), parts[2])


def _aligned(count: int) -> int:
    return -(-count // ALIGN) * ALIGN


def _row(count: int) -> int:
    """Length of a row in memory: an odd multiple of `ALIGN`, so that neighbouring rows do not compete for the same part of a cache."""
    parts = -(-count // ALIGN)
    return (parts + 1 - parts % 2) * ALIGN


@dataclass
class AxisFill:
    """Halo operations of one axis: plain copies, then layer sweeps."""

    copy_to: np.ndarray
    copy_from: np.ndarray
    tasks: np.ndarray


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
    """

    core: tuple[int, int, int]
    offsets: np.ndarray
    layers: Mapping[tuple[int, int], tuple[int, int]]
    periodic: frozenset[int]
    blocks: dict[tuple[int, ...], Block] = field(init=False)
    fills: list[AxisFill] = field(init=False)
    size: int = field(init=False)
    slots: int = field(init=False)
    memory: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        self.reach = tuple(int(n) for n in np.abs(self.offsets).max(0))
        self._place_blocks()
        self.fills = [self._axis_fill(axis) for axis in range(3)]

    def _place_blocks(self) -> None:
        sides = [[s for s in (0, -1, 1) if s == 0 or (a, s) in self.layers] for a in range(3)]
        segments = sorted(itertools.product(*sides), key=lambda s: (sum(map(abs, s)), s))
        self.blocks = {segment: self._shape_of(segment) for segment in segments}
        end = SLACK  # the level: the core with its halo, then the nodes of the layers
        for block in self.blocks.values():
            if not any(block.segment):
                block.base = end + -block.origin % ALIGN
                block.node_origin, block.node_step = block.origin, block.step
                end = _aligned(block.base + block.extent[block.order[0]] * block.stride[block.order[0]])
            else:
                block.node_origin, step = end, [0, 0, 0]
                run = 1
                for a in reversed(block.order):
                    step[a] = run
                    run *= block.nodes[a]
                block.node_step = tuple(step)
                end += _aligned(run)
        self.size = end = _aligned(end + SLACK)
        end += SLACK
        for block in self.blocks.values():
            if any(block.segment):
                block.base = end
                slowest = block.order[0]
                end += _aligned(block.extent[slowest] * min(block.stride[slowest], block.step[slowest]))
        self.slots = _aligned(end + SLACK) - self.size

    def _shape_of(self, segment: tuple[int, ...]) -> Block:
        """Extents and distances of a block, not yet its place."""
        idle = [a for a in range(3) if self.reach[a] == 0]  # axes that 1D and 2D lack stay slowest
        stretched = [a for a in range(3) if segment[a]]
        order = tuple(idle + stretched[::-1] + [a for a in range(3) if not segment[a] and a not in idle])
        nodes = tuple(self.layers[a, side][0] if side else self.core[a] for a, side in enumerate(segment))
        extent = tuple(n * (2 * m + 1) if side else n + 2 * m for n, m, side in zip(nodes, self.reach, segment, strict=True))
        step, run = [0, 0, 0], 1
        for place, a in enumerate(reversed(order)):
            step[a] = run
            length = extent[a]
            if place == 0 and not segment[a] and len(idle) < 2:
                length = _row(length)
            elif place == 1 and not segment[a] and len(idle) < 1:
                length += 1 - length % 2
            run *= length
        stride = tuple(s * (n if side else 1) for s, n, side in zip(step, nodes, segment, strict=True))
        return Block(segment, 0, extent, stride, tuple(step), nodes, order, self.reach)

    def table(self) -> np.ndarray:
        """One row of `BLOCK_FIELDS` a block, the core first; axes in the block's own order."""
        rows = []
        for block in self.blocks.values():
            first, second, third = block.order
            in_slots = int(any(block.segment))
            rows.append((
                in_slots, block.origin - in_slots * self.size, *(block.nodes[a] for a in block.order), block.step[first], block.step[second],
                *(block.stride[a] for a in block.order), block.node_origin, block.node_step[first], block.node_step[second],
            ))  # fmt: skip
            assert block.step[third] == block.node_step[third] == 1, "nodes along the fastest axis must be neighbours in memory"
        return np.array(rows, np.int64)

    def _needed(self, axis: int, fixed: dict[int, int]) -> int:
        """Largest offset along `axis` among stencil offsets at least as far out as `fixed` along other axes."""
        far = np.ones(len(self.offsets), bool)
        for other, k in fixed.items():
            far &= np.abs(self.offsets[:, other]) >= abs(k)
        return int(np.abs(self.offsets[far, axis]).max(initial=0))

    def _slot_offset(self, block: Block, axis: int, slot: int) -> int:
        """Offset k that a slot of a layer stands for; 0 in the core, whose halo serves every offset."""
        return slot // block.nodes[axis] - self.reach[axis] if block.segment[axis] else 0

    def _axis_fill(self, axis: int) -> AxisFill:
        to: list[np.ndarray] = []
        source: list[np.ndarray] = []
        rows: list[tuple[int, ...]] = []
        m = self.reach[axis]
        for segment, inner in self.blocks.items():
            if segment[axis] or m == 0:
                continue
            others = [a for a in range(3) if a != axis]
            if axis in self.periodic:
                lines = np.add.outer(*[inner.along(a, nodes_only=a > axis) for a in others]).ravel() + inner.base
                n, s = inner.nodes[axis], inner.stride[axis]
                pads = np.r_[0:m, n + m : n + 2 * m]
                wrapped = (pads - m) % n + m
                to.append(np.add.outer(pads * s, lines).ravel())
                source.append(np.add.outer(wrapped * s, lines).ravel())
            for side in (-1, 1):
                if (axis, side) not in self.layers:
                    continue
                layer = self.blocks[tuple(side if a == axis else s for a, s in enumerate(segment))]
                rows += self._sweeps(axis, side, inner, layer, others)
        empty = np.zeros(0, np.int64)
        return AxisFill(
            np.concatenate(to) if to else empty,
            np.concatenate(source) if source else empty,
            np.array(rows, np.int64).reshape(-1, len(TASK_FIELDS)),
        )

    def _sweeps(self, axis: int, side: int, inner: Block, layer: Block, others: list[int]) -> list[tuple[int, ...]]:
        """Halo tasks of one face: up to LINES lines each, lines along the layer's fastest unstretched axis."""
        columns, profile = self.layers[axis, side]
        line_axis = max(others, key=lambda a: (layer.nodes[a] > 1, layer.order.index(a)))
        outer_axis = next(a for a in others if a != line_axis)
        inner_base = inner.base + inner.stride[axis] * (self.reach[axis] + (inner.nodes[axis] - 1 if side > 0 else 0))
        layer_base = layer.base + layer.stride[axis] * self.reach[axis]
        inner_outer, layer_outer = (b.along(outer_axis, outer_axis > axis) for b in (inner, layer))
        inner_line, layer_line = (b.along(line_axis, line_axis > axis) for b in (inner, layer))
        step = [int(v[1] - v[0]) if len(v) > 1 else 1 for v in (inner_line, layer_line)]
        in_slots = int(any(inner.segment))
        inner_base -= in_slots * self.size
        layer_base -= self.size
        rows: list[tuple[int, ...]] = []
        for number in range(len(layer_outer)):
            at = {outer_axis: self._slot_offset(layer, outer_axis, number)} if outer_axis < axis else {}
            kmax = self._needed(axis, at)
            if kmax == 0:
                continue
            for first in range(0, len(layer_line), LINES):
                count = min(LINES, len(layer_line) - first)
                rows.append(
                    (
                        inner_base + int(inner_outer[number] + inner_line[first]),
                        side * inner.stride[axis],
                        step[0],
                        layer_base + int(layer_outer[number] + layer_line[first]),
                        layer.step[axis],
                        side * layer.stride[axis],
                        step[1],
                        count,
                        self.memory,
                        kmax,
                        profile,
                        columns,
                        in_slots,
                    )
                )
                self.memory += (columns + 1) * 2 * kmax * LINES
        return rows

"""Where every value lives: the core block, the layer blocks, their strides, and the order in which halos are filled.

A layer column p along a stretched axis holds the continued values U(p, k) for k = -m..m in neighbouring *slots*, so
a layer node's neighbours along that axis lie in its own column, one slot apart, and the plain stencil applies to
layer nodes as it does to core nodes: only the distance between neighbours (one slot) and between nodes (2m + 1
slots) differs. All blocks of one time level lie in one flat array, so a time level is one pointer.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

#: Lines that one halo task sweeps together, and the values kept before and after a level for vector loads.
LINES = 32
SLACK = 64

#: Columns of the halo task table; the compiled driver reads them by these positions.
TASK_FIELDS = ("inner", "inner_k", "inner_line", "layer", "layer_p", "layer_k", "layer_line", "count", "memory", "kmax", "profile", "columns")


@dataclass
class Block:
    """One box of nodes: per axis the core (0), the low layer (-1) or the high layer (+1)."""

    segment: tuple[int, ...]
    base: int
    extent: tuple[int, ...]  # slots along each axis, pads included
    stride: tuple[int, ...]  # between neighbours, per axis
    step: tuple[int, ...]  # between nodes, per axis
    nodes: tuple[int, ...]
    order: tuple[int, ...]  # axes from slowest to fastest in memory
    reach: tuple[int, ...]

    @property
    def origin(self) -> int:
        """Flat index of the first node."""
        return self.base + sum(m * s for m, s in zip(self.reach, self.stride, strict=True))

    def view(self, level: np.ndarray) -> np.ndarray:
        """Nodes of this block in one time level, indexed by axis; shares memory."""
        size = level.itemsize
        strides = [s * size for s in self.step]
        return np.lib.stride_tricks.as_strided(level[self.origin :], self.nodes, strides)

    def slots(self, level: np.ndarray) -> np.ndarray:
        """All slots of this block, pads included; shares memory."""
        return np.lib.stride_tricks.as_strided(level[self.base :], self.extent, [s * level.itemsize for s in self.stride])

    def node_indices(self) -> np.ndarray:
        """Flat indices of all nodes, indexed by axis."""
        parts = [np.arange(n) * s for n, s in zip(self.nodes, self.step, strict=True)]
        return self.origin + np.add.outer(np.add.outer(parts[0], parts[1]), parts[2])

    def indices(self, axis: int, nodes_only: bool) -> np.ndarray:
        """Flat distances from the block's base along one axis: of the nodes, or of every slot."""
        if nodes_only:
            return self.reach[axis] * self.stride[axis] + self.step[axis] * np.arange(self.nodes[axis])
        return self.stride[axis] * np.arange(self.extent[axis])


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
    memory: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        self.reach = tuple(int(n) for n in np.abs(self.offsets).max(0))
        self._place_blocks()
        self.fills = [self._axis_fill(axis) for axis in range(3)]

    def _place_blocks(self) -> None:
        self.blocks, base = {}, SLACK
        sides = [[s for s in (0, -1, 1) if s == 0 or (a, s) in self.layers] for a in range(3)]
        for segment in sorted(itertools.product(*sides), key=lambda s: (sum(map(abs, s)), s)):
            stretched = [a for a in range(3) if segment[a]]
            idle = [a for a in range(3) if self.reach[a] == 0]  # axes that 1D and 2D lack stay slowest, as in the core
            order = tuple(idle + stretched + [a for a in range(3) if not segment[a] and a not in idle])
            nodes, extent = [], []
            for a, side in enumerate(segment):
                columns = self.layers[a, side][0] if side else self.core[a]
                nodes.append(columns)
                extent.append(columns * (2 * self.reach[a] + 1) if side else columns + 2 * self.reach[a])
            stride, run = [0, 0, 0], 1
            for a in reversed(order):
                stride[a] = run
                run *= extent[a]
            step = [s * (2 * m + 1 if side else 1) for s, m, side in zip(stride, self.reach, segment, strict=True)]
            self.blocks[segment] = Block(segment, base, tuple(extent), tuple(stride), tuple(step), tuple(nodes), order, self.reach)
            base += run
        self.size = base + SLACK

    def _needed(self, axis: int, fixed: dict[int, int]) -> int:
        """Largest offset along `axis` among stencil offsets at least as far out as `fixed` along other axes."""
        far = np.ones(len(self.offsets), bool)
        for other, k in fixed.items():
            far &= np.abs(self.offsets[:, other]) >= abs(k)
        return int(np.abs(self.offsets[far, axis]).max(initial=0))

    def _slot_offset(self, block: Block, axis: int, slot: int) -> int:
        """Offset k that a slot of a layer stands for; 0 in the core, whose halo serves every offset."""
        return slot % (2 * self.reach[axis] + 1) - self.reach[axis] if block.segment[axis] else 0

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
                lines = np.add.outer(*[inner.indices(a, nodes_only=a > axis) for a in others]).ravel() + inner.base
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
        inner_outer, layer_outer = (b.indices(outer_axis, outer_axis > axis) for b in (inner, layer))
        inner_line, layer_line = (b.indices(line_axis, line_axis > axis) for b in (inner, layer))
        step = [int(v[1] - v[0]) if len(v) > 1 else 1 for v in (inner_line, layer_line)]
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
                    )
                )
                self.memory += (columns + 1) * 2 * kmax * LINES
        return rows

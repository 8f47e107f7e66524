"""Where every value lives: one box of nodes, the core with its layers around it, in their natural order.

A *level* is one flat array: all nodes and a halo around them that is zero, or repeats what lies across a periodic axis.
A field of several components has one such level for each, one after the other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

#: Values kept before and after an array for vector loads.
SLACK = 64
#: Values whose bytes are a whole number of cache lines, in either precision.
ALIGN = 16
_CACHE_LINE = 64  # bytes
# Long rows so many bytes apart, or a multiple of it, compete for the same parts of the first cache; short ones stay
# there whole, and what lies between them unread slows a sweep more.
_COMPETING, _LONG_ROW = 512, 2048

#: Axes in the order in which halos along them repeat what lies elsewhere, those of earlier ones with it. All rows read
#: the halo of the last axis: once that is there whole rows need none of the others.
HALOS = (2, 0, 1)

#: Columns of the row that describes a box to the compiled driver; behind them the distances of the components that are
#: read, and of those that are written.
BOX_FIELDS = (
    "origin",
    "n0",
    "n1",
    "n2",
    "step0",
    "step1",
    "stride0",
    "stride1",
    "stride2",
    "out",
    "out_step0",
    "out_step1",
)


@dataclass(frozen=True)
class Block:
    """A box of nodes in a level.

    Attributes
    ----------
    nodes : tuple of int
        Along the three axes.
    reach : tuple of int
        Neighbours beyond the box along each axis.
    stride : tuple of int
        Distances between neighbours.
    origin : int
        Index of the first node.
    components, distance : int
        Of the field, and the distance between them.
    """

    nodes: tuple[int, int, int]
    reach: tuple[int, int, int]
    stride: tuple[int, int, int]
    origin: int
    components: int = 1
    distance: int = 0

    def view(self, level: np.ndarray) -> np.ndarray:
        """Nodes of this block in one level, indexed by axis, or by component and axis; shares memory."""
        shape, steps = (
            (self.nodes, self.stride)
            if self.components == 1
            else ((self.components, *self.nodes), (self.distance, *self.stride))
        )
        return np.lib.stride_tricks.as_strided(level[self.origin :], shape, [s * level.itemsize for s in steps])

    def all(self, level: np.ndarray) -> np.ndarray:
        """Nodes of this block and those within reach, of the first component; shares memory."""
        shape = [n + 2 * m for n, m in zip(self.nodes, self.reach, strict=True)]
        first = self.origin - int(np.dot(self.reach, self.stride))
        return np.lib.stride_tricks.as_strided(level[first:], shape, [s * level.itemsize for s in self.stride])

    def coordinates(self, places: np.ndarray) -> np.ndarray:
        """Numbers of nodes along the axes, counted from the first of this block, of places in a level; shape (n, 3)."""
        found = []
        left = np.asarray(places, np.int64) - self.origin + int(np.dot(self.reach, self.stride))
        for stride, m in zip(self.stride, self.reach, strict=True):
            found.append(left // stride - m)
            left = left % stride
        return np.stack(found, -1)

    def node_indices(self) -> np.ndarray:
        """Indices of all nodes in a level (of the first component), indexed by axis."""
        parts = [np.arange(n) * s for n, s in zip(self.nodes, self.stride, strict=True)]
        return self.origin + np.add.outer(np.add.outer(parts[0], parts[1]), parts[2])


def aligned(count: int) -> int:
    """The next multiple of `ALIGN`."""
    return -(-count // ALIGN) * ALIGN


def aligned_zeros(count: int, dtype: np.dtype, rows: int = 0) -> np.ndarray:
    """Zeros that begin on a cache line, shape (rows, count) or (count,)."""
    total = max(rows, 1) * count
    raw = np.zeros(total + ALIGN, dtype)
    first = -raw.ctypes.data // dtype.itemsize % ALIGN
    values = raw[first : first + total]
    return values.reshape(rows, count) if rows else values


def row_values(count: int, itemsize: int) -> int:
    """Distance between rows of so many values: whole cache lines that do not compete with those of the next rows."""
    lines = -(-count * itemsize // _CACHE_LINE)
    bytes_apart = lines * _CACHE_LINE
    competes = bytes_apart >= _LONG_ROW and bytes_apart % _COMPETING == 0
    return (lines + competes) * _CACHE_LINE // itemsize


@dataclass
class Layout:
    """The box of a core of given size and its layers.

    Parameters
    ----------
    core : tuple of int
        Nodes of the core along the three axes (leading axes have one node in 1D and 2D).
    offsets : ndarray, shape (K, 3)
        Stencil offsets.
    columns : mapping of (axis, side) to int
        Nodes along the normal of the layers; side is -1 or +1.
    periodic : set of int
        Axes that close on themselves.
    components : int
        Of the field. What follows is for one of them.
    itemsize : int
        Bytes of a value.

    Attributes
    ----------
    reach : tuple of int
    low, high : tuple of int
        Columns of the layers on the low and high side of each axis.
    size : int
        Values of a level.
    box, near : Block
        All nodes, and those of the core.
    """

    core: tuple[int, int, int]
    offsets: np.ndarray
    columns: Mapping[tuple[int, int], int]
    periodic: frozenset[int]
    components: int = 1
    itemsize: int = 8
    reach: tuple[int, int, int] = field(init=False)
    low: tuple[int, ...] = field(init=False)
    high: tuple[int, ...] = field(init=False)
    size: int = field(init=False)
    box: Block = field(init=False)
    near: Block = field(init=False)

    def __post_init__(self) -> None:
        x, y, z = (int(n) for n in np.abs(self.offsets).max(0))
        self.reach = x, y, z
        self.low, self.high = (tuple(self.columns.get((a, side), 0) for a in range(3)) for side in (-1, 1))
        n0, n1, n2 = (low + n + high for low, n, high in zip(self.low, self.core, self.high, strict=True))
        # Planes are odd multiples of rows, so that those of neighbouring ones do not compete, either.
        row = row_values(n2 + 2 * z, self.itemsize) if y else n2 + 2 * z
        plane = row * ((n1 + 2 * y) | 1 if x else n1 + 2 * y)
        stride = plane, row, 1
        origin = aligned(SLACK + int(np.dot(self.reach, stride)))
        self.size = aligned(origin + (n0 + x) * plane + 2 * SLACK)
        self.box = Block((n0, n1, n2), self.reach, stride, origin, self.components, self.size)
        first = origin + int(np.dot(self.low, stride))
        self.near = Block(self.core, self.reach, stride, first, self.components, self.size)

    def table(self, columns: int, rows: int) -> np.ndarray:
        """The row of `BOX_FIELDS` for a sweep from a field of so many components to one."""
        box = self.box
        apart = [c * self.size for count in (columns, rows) for c in range(count)]
        return np.array(
            [box.origin, *box.nodes, *box.stride[:2], *box.stride, box.origin, *box.stride[:2], *apart], np.int64
        )

    def across(self, axis: int, side: int) -> np.ndarray:
        """Places of the halo on a side, and those that it repeats if the axis is periodic; shape (2, n)."""
        n, m = self.box.nodes[axis], self.reach[axis]
        halo = np.arange(-m, 0) if side < 0 else np.arange(n, n + m)
        # Later axes are filled after this one, earlier ones with their halo.
        earlier = HALOS[: HALOS.index(axis)]
        lines = [
            np.arange(-r, k + r) if a in earlier else np.arange(k)
            for a, (k, r) in enumerate(zip(self.box.nodes, self.reach, strict=True))
        ]
        places = []
        for along in (halo, halo % n):
            lines[axis] = along
            parts = [at * s for at, s in zip(lines, self.box.stride, strict=True)]
            places.append((self.box.origin + np.add.outer(np.add.outer(parts[0], parts[1]), parts[2])).ravel())
        return np.array(places)

    def copies(self) -> np.ndarray:
        """Runs of places of the halo that repeat what lies across periodic axes, and where that is inside the box:
        (to, from, places), shape (3, n), in no order.
        """
        axes = [axis for axis in HALOS if axis in self.periodic]
        found = [self.across(axis, side) for axis in axes for side in (-1, 1)]
        inside = np.arange(self.size if found else 0)
        for to, source in found:
            inside[to] = inside[source]  # what lies across later axes is itself a halo of earlier ones
        to = np.sort(np.concatenate([np.zeros(0, np.int64), *(places[0] for places in found)]))
        source = inside[to]
        starts = np.flatnonzero((np.diff(to, prepend=-2) != 1) | (np.diff(source, prepend=-2) != 1))
        return np.array([to[starts], source[starts], np.diff(starts, append=to.size)])

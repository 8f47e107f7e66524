"""Layout of the values in memory: one box of nodes, the core with the layers around it, in their natural order.

A *level* is one flat array of all nodes and a halo around them that is zero, or repeats what lies across a periodic
axis. A *place* is an index in a level. A field of several components has one such level for each of them, one after the
other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np

Table = TypeVar("Table")

#: Number of values reserved before and after an array for vector loads.
SLACK = 64
#: Number of values that occupy a whole number of cache lines, in either precision.
ALIGN = 16
_CACHE_LINE = 64  # bytes
# Long rows whose distance is a multiple of this number of bytes compete for the same sets of the first-level cache;
# short rows fit into it as a whole, and padding between them slows a sweep more.
_COMPETING, _LONG_ROW = 512, 2048

#: Axes in the order in which their halos are filled; later ones include the halos of earlier ones. All rows read the
#: halo of the last axis: once it is filled, rows away from the other sides need no more.
HALOS = (2, 0, 1)

#: Columns of the row that describes a box to the compiled driver; the distances of the components that are read, and of
#: those that are written, follow.
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
    """Box of nodes in a level."""

    nodes: tuple[int, int, int]  # number of nodes along the three axes
    reach: tuple[int, int, int]  # number of neighbours beyond the box along each axis
    stride: tuple[int, int, int]  # distances between neighbours in a level
    origin: int  # place of the first node
    components: int = 1  # of the field
    distance: int = 0  # between its components

    def view(self, level: np.ndarray) -> np.ndarray:
        """Nodes of this block in one level, indexed by axis, or by component and axis; a view."""
        shape, steps = (
            (self.nodes, self.stride)
            if self.components == 1
            else ((self.components, *self.nodes), (self.distance, *self.stride))
        )
        return np.lib.stride_tricks.as_strided(level[self.origin :], shape, [s * level.itemsize for s in steps])

    def all(self, level: np.ndarray) -> np.ndarray:
        """Nodes of this block and those within reach, for the first component; a view."""
        shape = [n + 2 * m for n, m in zip(self.nodes, self.reach, strict=True)]
        first = self.origin - int(np.dot(self.reach, self.stride))
        return np.lib.stride_tricks.as_strided(level[first:], shape, [s * level.itemsize for s in self.stride])

    def coordinates(self, places: np.ndarray) -> np.ndarray:
        """Coordinates of places in a level, counted in nodes from the first of this block; shape (n, 3)."""
        coordinates = []
        rest = np.asarray(places, np.int64) - self.origin + int(np.dot(self.reach, self.stride))
        for stride, m in zip(self.stride, self.reach, strict=True):
            coordinates.append(rest // stride - m)
            rest = rest % stride
        return np.stack(coordinates, -1)

    def node_indices(self) -> np.ndarray:
        """Places of all nodes in a level (of the first component), indexed by axis."""
        parts = [np.arange(n) * s for n, s in zip(self.nodes, self.stride, strict=True)]
        return self.origin + np.add.outer(np.add.outer(parts[0], parts[1]), parts[2])


class Default(NamedTuple):
    """Default of a field of a table: equal numbers, in the precision of the levels unless a type is given."""

    shape: tuple[int, ...]
    value: float = 0.0
    dtype: np.dtype | None = None

    def made(self, real: np.dtype) -> Any:
        """Return a new array, or a number if the shape has no axes."""
        return np.full(self.shape, self.value, real if self.dtype is None else self.dtype)[()]


def reals(*shape: int, value: float = 0.0) -> Any:
    """Return the default of a field with numbers in the precision of the levels."""
    return Default(shape, value)


def doubles(*shape: int) -> Any:
    """Return the default of a field with numbers in double precision."""
    return Default(shape, dtype=np.dtype(np.float64))


def ints(*shape: int, bits: str = "int64") -> Any:
    """Return the default of a field with integers."""
    return Default(shape, dtype=np.dtype(bits))


def empty(table: type[Table]) -> Table:
    """Return the default of a field that is a table in turn, with all of its own defaults."""
    return cast(Table, table)


def with_defaults(table: type[Table], real: np.dtype, /, **given: Any) -> Table:
    """Return a table (a named tuple of arrays) whose fields are as given, or else their defaults, which all tables
    share. Machine code depends on the types of all fields, so that the precision `real` matters even where an array is
    empty.
    """
    return table(**(_defaults(table, np.dtype(real)) | given))  # type: ignore[arg-type]  # types are hashable


@lru_cache
def _defaults(table: type[Table], real: np.dtype) -> dict[str, Any]:
    """The defaults of the fields of a table that have one."""
    defaults = getattr(table, "_field_defaults").items()  # noqa: B009
    return {name: made(default, real) for name, default in defaults}


def made(default: Any, real: np.dtype) -> Any:
    """Return what a default of a field stands for: an array, a table, or a number."""
    if isinstance(default, Default):
        return default.made(real)
    return with_defaults(default, real) if isinstance(default, type) else default


def aligned(count: int) -> int:
    """Round up to a multiple of `ALIGN`."""
    return -(-count // ALIGN) * ALIGN


def aligned_zeros(count: int, dtype: np.dtype, rows: int = 0) -> np.ndarray:
    """Return zeros that begin on a cache line, shape (rows, count) or (count,)."""
    total = max(rows, 1) * count
    raw = np.zeros(total + ALIGN, dtype)
    first = -raw.ctypes.data // dtype.itemsize % ALIGN
    values = raw[first : first + total]
    return values.reshape(rows, count) if rows else values


def row_values(count: int, itemsize: int) -> int:
    """Distance between rows of `count` values: whole cache lines that do not compete with those of the next rows."""
    lines = -(-count * itemsize // _CACHE_LINE)
    bytes_apart = lines * _CACHE_LINE
    competes = bytes_apart >= _LONG_ROW and bytes_apart % _COMPETING == 0
    return (lines + competes) * _CACHE_LINE // itemsize


@dataclass
class Layout:
    """Layout of the box of a core and its layers."""

    core: tuple[int, int, int]  # nodes of the core along the three axes (leading axes have one in 1D and 2D)
    offsets: np.ndarray  # of the stencil, shape (K, 3)
    columns: Mapping[tuple[int, int], int]  # nodes of each layer along its normal, by axis and side, -1 or +1
    periodic: frozenset[int]  # axes
    components: int = 1  # of the field; what follows is for one of them
    itemsize: int = 8  # bytes of a value
    reach: tuple[int, int, int] = field(init=False)
    low: tuple[int, ...] = field(init=False)  # columns of the layers on the low side of each axis
    high: tuple[int, ...] = field(init=False)
    size: int = field(init=False)  # number of values of a level
    box: Block = field(init=False)  # all nodes
    near: Block = field(init=False)  # those of the core

    def __post_init__(self) -> None:
        x, y, z = (int(n) for n in np.abs(self.offsets).max(0))
        self.reach = x, y, z
        self.low, self.high = (tuple(self.columns.get((a, side), 0) for a in range(3)) for side in (-1, 1))
        n0, n1, n2 = (low + n + high for low, n, high in zip(self.low, self.core, self.high, strict=True))
        # Planes are odd multiples of rows, so that neighbouring planes do not compete, either.
        row = row_values(n2 + 2 * z, self.itemsize) if y else n2 + 2 * z
        plane = row * ((n1 + 2 * y) | 1 if x else n1 + 2 * y)
        stride = plane, row, 1
        origin = aligned(SLACK + int(np.dot(self.reach, stride)))
        self.size = aligned(origin + (n0 + x) * plane + 2 * SLACK)
        self.box = Block((n0, n1, n2), self.reach, stride, origin, self.components, self.size)
        first = origin + int(np.dot(self.low, stride))
        self.near = Block(self.core, self.reach, stride, first, self.components, self.size)

    @property
    def distances(self) -> np.ndarray:
        """Distances in a level to the neighbours of a node, in the order of the offsets; shape (K,)."""
        return np.asarray(self.offsets @ np.array(self.box.stride))

    @property
    def away(self) -> tuple[np.ndarray, np.ndarray]:
        """First node, and last + 1, of the box of nodes to which no layer adds anything."""
        layered, m = [[(a, side) in self.columns for a in range(3)] for side in (-1, 1)], np.array(self.reach)
        first = np.where(layered[0], np.array(self.low) + m, 0)
        return first, np.maximum(first, self.box.nodes - np.where(layered[1], np.array(self.high) + m, 0))

    def bonds_between(self, nodes: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
        """Numbers in the stencil of the bonds from some places in a level to others."""
        order = np.argsort(self.distances)
        return np.asarray(order[np.searchsorted(self.distances[order], neighbours - nodes)])

    def table(self, columns: int, rows: int) -> np.ndarray:
        """Row of `BOX_FIELDS` for a sweep from a field of `columns` components to one of `rows`."""
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
        """Runs of places of the halo that repeat what lies across periodic axes, and the places inside the box that
        they repeat: (to, from, length), shape (3, n), in no particular order.
        """
        axes = [axis for axis in HALOS if axis in self.periodic]
        halos = [self.across(axis, side) for axis in axes for side in (-1, 1)]
        inside = np.arange(self.size if halos else 0)
        for to, source in halos:
            inside[to] = inside[source]  # what later axes repeat may itself be a halo of earlier ones
        to = np.sort(np.concatenate([np.zeros(0, np.int64), *(places[0] for places in halos)]))
        source = inside[to]
        starts = np.flatnonzero((np.diff(to, prepend=-2) != 1) | (np.diff(source, prepend=-2) != 1))
        return np.array([to[starts], source[starts], np.diff(starts, append=to.size)])

"""Halos that other processes fill, and the tables of the messages that do so.

A neighbouring process acts like a periodic side: the halo repeats what lies on the other side of an axis, which is in
the memory of another process. Values are packed, sent and unpacked axis by axis; later axes (`layout.HALOS`) include
the halos of earlier ones, so that edges and corners need no messages of their own. While the messages along an axis are
under way, rows that need none of them are swept (`free_of_halos`).
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from farhorizon.engine.codegen.build import load_rows
from farhorizon.engine.codegen.exchanges import HEAD, RECEIVES, REQUEST, ROW, STATUS, TABLE, USED
from farhorizon.engine.layout import HALOS, Layout

Places = np.ndarray  # of a halo, and of what it repeats; shape (2, n)
Side = tuple[int, int]

#: Kinds of messages: levels and states; slots of each pass, from here on; the box of the filter, which is the last
#: kind.
LEVEL, SLOTS, FILTER = 0, 1, -1


@dataclass(frozen=True)
class Link:
    """Handles by which compiled code reaches other processes, whose messages it awaits without an end."""

    functions: tuple[int, int, int, int]  # addresses of MPI_Isend, _Irecv, _Waitall and _Testall; 0 for one process
    communicator: int
    byte: int  # handle of the byte type
    wide: bool  # whether handles are pointers instead of integers of four bytes
    rank: int  # of this process
    # called with what this process is about to compute with the others, in numbers; raises on all unless all are
    agree: Callable[[tuple[int, ...]], object] = lambda numbers: None


@dataclass(frozen=True, eq=False)
class Messages:
    """Values that are sent and received, axis by axis. Each row is a message: destination and source (negative for
    none), the places that are sent and filled, and a tag, twice the axis plus one on the high side.
    """

    link: Link
    rows: list[tuple[int, int, np.ndarray, np.ndarray, int]]

    @classmethod
    def between(cls, link: Link, neighbours: Mapping[Side, int], across: Mapping[Side, Places]) -> Messages:
        """Return the messages that fill the halos on all sides: `neighbours` are ranks, negative for none, and `across`
        the places of the halo on a side and those that it would repeat if the axis were periodic.
        """
        rows = []
        for axis, side in sorted(neighbours):
            # what the halo here would repeat is what the neighbour on the other side needs
            filled, sent = across[axis, side]
            rows.append((neighbours[axis, -side], neighbours[axis, side], sent, filled, 2 * axis + (side > 0)))
        return cls(link, [row for row in rows if len(row[2])])

    def along(self, axis: int) -> Messages:
        """Return the messages along one axis, which do not depend on each other."""
        return Messages(self.link, [row for row in self.rows if row[-1] // 2 == axis])

    @property
    def volume(self) -> int:
        """Number of values per component that are sent to other processes."""
        return sum(len(sent) for to, _, sent, *_ in self.rows if to >= 0 and to != self.link.rank)


class Table:
    """Table of messages for compiled code, see `engine.codegen.exchanges`, and the memory that it refers to.

    A value has `size` bytes and at most so many components; messages of several kinds may be under way at once.
    """

    def __init__(self, messages: Messages, size: int, components: int, kind: int) -> None:
        link, runs, rows = messages.link, list[np.ndarray](), []
        lengths = [components * len(sent) * size for _, _, sent, *_ in messages.rows]
        self._buffers = [np.zeros((2, length), np.uint8) for length in lengths]
        most = 2 * len(messages.rows)  # one to send and one to receive per message
        self._requests, self._statuses = np.zeros(most * REQUEST, np.uint8), np.zeros(most * STATUS, np.uint8)
        start = HEAD + ROW * len(messages.rows)
        for (to, source, sent, filled, tag), buffers in zip(messages.rows, self._buffers, strict=True):
            ends = []
            for places in (sent, filled):
                of_bytes = _runs(places) * size
                runs.append(of_bytes.ravel())
                ends += [start, start + of_bytes.size]
                start += of_bytes.size
            addresses = [buffer.ctypes.data for buffer in buffers]
            rows.append([to, source, *ends, len(sent) * size, 6 * kind + tag, *addresses])  # six tags in each kind
        head = [*link.functions, link.communicator, link.byte, link.wide, link.rank, len(rows)]
        head += [self._requests.ctypes.data, self._statuses.ctypes.data, 0]
        self.words = np.concatenate([np.array(words, np.int64) for words in (head, *rows, *runs)])

    @property
    def address(self) -> int:
        """Address of the table for compiled code."""
        return int(self.words.ctypes.data)


def _runs(places: np.ndarray) -> np.ndarray:
    """Runs of neighbouring places: the first of each, and their number."""
    first = np.flatnonzero(np.diff(places, prepend=-2) != 1)
    return np.stack([places[first], np.diff(first, append=len(places))], axis=-1)


def free_of_halos(layout: Layout, neighbours: Mapping[Side, int]) -> np.ndarray:
    """Rows that do not depend on what other processes fill along the first two axes: first and end, shape (2, 2); zero
    if there are none. Rows are not cut: this would cost more vectors than the messages along the last axis take time.
    """
    ends = np.array([(0, 0), layout.box.nodes[:2]], np.int64)
    for (axis, side), rank in neighbours.items():
        if rank >= 0 and axis < 2:
            ends[int(side > 0), axis] -= side * layout.reach[axis]
    return ends if (ends[0] < ends[1]).all() else np.zeros((2, 2), np.int64)


class Exchange:
    """Exchange of halos of an engine with other processes: messages of levels, of the slots of each pass, and of the
    box of the filter.

    `numbers`, shape (kinds, 3, 5), has for each kind and axis the addresses of the functions that start messages,
    complete them and let them make progress, the address of their table, and whether it has any messages.
    """

    def __init__(self, kinds: Sequence[Messages], components: int, dtype: np.dtype) -> None:
        self.messages, self.agree = list(kinds), kinds[0].link.agree
        along = [[messages.along(axis) for axis in range(3)] for messages in kinds]
        self._tables = [
            [Table(messages, dtype.itemsize, components if kind == LEVEL else 1, kind) for messages in axes]
            for kind, axes in enumerate(along)
        ]
        functions = load_rows("exchange_rows")
        self.numbers = np.array(
            [
                [(*functions, table.address, bool(messages.rows)) for table, messages in zip(tables, axes, strict=True)]
                for tables, axes in zip(self._tables, along, strict=True)
            ],
            np.int64,
        )

    def fill(self, level: np.ndarray, components: int, times: int = 1, kind: int = LEVEL) -> None:
        """Fill the halo of a level, or another kind of array, from other processes as the compiled loop does; all of
        them call this together.
        """
        self.agree((kind, times))
        compiled = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 4)
        calls = [
            (compiled(function), numbers[TABLE])
            for numbers in self.numbers[kind, list(HALOS)].tolist()
            for function in numbers[: RECEIVES + 1]
            if numbers[USED]
        ]
        for _ in range(times):
            for call, table in calls:
                call(table, level.ctypes.data, components, level.nbytes // components)

    @property
    def filled(self) -> np.ndarray:
        """Places of a level's first component that other processes fill, shape (n,)."""
        places = [filled for _, source, _, filled, _ in self.messages[LEVEL].rows if source >= 0]
        return np.unique(np.concatenate([np.zeros(0, np.int64), *places]))

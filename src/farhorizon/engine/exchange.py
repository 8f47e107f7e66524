"""Halos that other processes fill, and the tables of messages by which they do.

A neighbouring process is one more periodic side: the halo repeats what lies on the other side of an axis, only that
this lies in the memory of another process. Axis by axis values are packed, sent and unpacked; later axes
(`layout.HALOS`) send the halos of earlier ones along, so that those at edges and corners come of themselves. While the
messages along an axis are on their way, rows are swept that need none of them (`free_of_halos`).
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from farhorizon.engine.layout import HALOS, Layout
from farhorizon.engine.rows.build import load_exchange
from farhorizon.engine.rows.exchanges import HEAD, RECEIVES, REQUEST, ROW, STATUS, TABLE, USED

Places = np.ndarray  # of a halo, and of what it repeats; shape (2, n)
Side = tuple[int, int]

#: Kinds of messages: of levels and states, and of the slots of each pass; of the filter's box the last one.
LEVEL, SLOTS, FILTER = 0, 1, -1


@dataclass(frozen=True)
class Link:
    """How a process reaches others: numbers that compiled code is given.

    Attributes
    ----------
    functions : tuple of int
        Addresses of MPI_Isend, MPI_Irecv, MPI_Waitall and MPI_Testall; 0 where there is nobody but the process itself.
    communicator, kind : int
        Handles: of the communicator, and of the type of a byte.
    wide : bool
        Whether handles are pointers, not numbers of four bytes.
    own : int
        Number of this process.
    """

    functions: tuple[int, int, int, int]
    communicator: int
    kind: int
    wide: bool
    own: int


@dataclass(frozen=True, eq=False)
class Messages:
    """What is sent and received, axis by axis.

    Attributes
    ----------
    link : Link
    rows : list of (int, int, ndarray, ndarray, int)
        Of each message, to whom and from whom (below 0 for nobody), places that are sent and places that are filled,
        and what tells it from others: twice the axis, and one more on the high side.
    """

    link: Link
    rows: list[tuple[int, int, np.ndarray, np.ndarray, int]]

    @classmethod
    def between(cls, link: Link, neighbours: Mapping[Side, int], across: Mapping[Side, Places]) -> Messages:
        """Those that fill the halos on all sides.

        Parameters
        ----------
        link : Link
        neighbours : mapping of (axis, side) to int
            Numbers of processes, below 0 for nobody; of axes without any, none.
        across : mapping of (axis, side) to ndarray of int, shape (2, n)
            Places of the halo on a side, and those that it would repeat if the axis were periodic.
        """
        rows = []
        for axis, side in sorted(neighbours):
            # what the halo here would repeat is what the neighbour on the other side wants
            filled, sent = across[axis, side]
            rows.append((neighbours[axis, -side], neighbours[axis, side], sent, filled, 2 * axis + (side > 0)))
        return cls(link, [row for row in rows if len(row[2])])

    def along(self, axis: int) -> Messages:
        """Those along one axis, which do not wait for each other."""
        return Messages(self.link, [row for row in self.rows if row[-1] // 2 == axis])

    @property
    def volume(self) -> int:
        """Values of one component that go to other processes."""
        return sum(len(sent) for to, _, sent, *_ in self.rows if to >= 0 and to != self.link.own)


class Table:
    """The table of messages as compiled code reads it, see `engine.rows.exchanges`, and the memory that it refers to.

    Parameters
    ----------
    messages : Messages
    size : int
        Bytes of a value.
    components : int
        The most that are sent of a value.
    kind : int
        Messages of several kinds may be on their way at once.
    """

    def __init__(self, messages: Messages, size: int, components: int, kind: int) -> None:
        link, runs, rows = messages.link, list[np.ndarray](), []
        lengths = [components * len(sent) * size for _, _, sent, *_ in messages.rows]
        self._buffers = [np.zeros((2, length), np.uint8) for length in lengths]
        most = 2 * len(messages.rows)  # of each message one to send and one to receive
        self._requests, self._statuses = np.zeros(most * REQUEST, np.uint8), np.zeros(most * STATUS, np.uint8)
        start = HEAD + ROW * len(messages.rows)
        for (to, source, sent, filled, tag), buffers in zip(messages.rows, self._buffers, strict=True):
            ends = []
            for places in (sent, filled):
                found = _runs(places) * size
                runs.append(found.ravel())
                ends += [start, start + found.size]
                start += found.size
            rows.append([to, source, *ends, len(sent) * size, 6 * kind + tag, *(one.ctypes.data for one in buffers)])
        head = [*link.functions, link.communicator, link.kind, link.wide, link.own, len(rows)]
        head += [self._requests.ctypes.data, self._statuses.ctypes.data, 0]
        self.words = np.concatenate([np.array(one, np.int64) for one in (head, *rows, *runs)])

    @property
    def address(self) -> int:
        """Where compiled code finds it."""
        return int(self.words.ctypes.data)


def _runs(places: np.ndarray) -> np.ndarray:
    """Runs of neighbouring places: the first of each, and their number."""
    first = np.flatnonzero(np.diff(places, prepend=-2) != 1)
    return np.stack([places[first], np.diff(first, append=len(places))], axis=-1)


def free_of_halos(layout: Layout, neighbours: Mapping[Side, int]) -> np.ndarray:
    """Which rows take nothing that other processes fill along the first two axes: first and end, shape (2, 2), of none
    where there are none. To cut rows would take more vectors than the messages along the last axis take time.
    """
    found = np.array([(0, 0), layout.box.nodes[:2]], np.int64)
    for (axis, side), other in neighbours.items():
        if other >= 0 and axis < 2:
            found[int(side > 0), axis] -= side * layout.reach[axis]
    return found if (found[0] < found[1]).all() else np.zeros((2, 2), np.int64)


class Exchange:
    """The exchange of an engine.

    Parameters
    ----------
    kinds : sequence of Messages
        Of levels, of the slots of each pass, and of the box of the filter.
    components : int
        The most of any field that is exchanged.
    dtype : dtype

    Attributes
    ----------
    messages : list of Messages
    numbers : ndarray of int, shape (kinds, 3, 5)
        Of each kind and axis the addresses of what begins messages, ends them and lets them move on, and of their
        table, and whether there is anything in it.
    """

    def __init__(self, kinds: Sequence[Messages], components: int, dtype: np.dtype) -> None:
        self.messages, self._size = list(kinds), dtype.itemsize
        along = [[one.along(axis) for axis in range(3)] for one in kinds]
        self._tables = [
            [Table(one, dtype.itemsize, components if kind == LEVEL else 1, kind) for one in axes]
            for kind, axes in enumerate(along)
        ]
        functions = load_exchange()
        self.numbers = np.array(
            [
                [(*functions, table.address, bool(one.rows)) for table, one in zip(tables, axes, strict=True)]
                for tables, axes in zip(self._tables, along, strict=True)
            ],
            np.int64,
        )

    def fill(self, level: np.ndarray, components: int, times: int = 1, kind: int = LEVEL) -> None:
        """Let other processes fill the halo of a level, or what else is exchanged, as the compiled loop does; all of
        them call it.
        """
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

    def volume(self, components: int) -> int:
        """Bytes of a level that this process sends to others."""
        return self.messages[LEVEL].volume * components * self._size

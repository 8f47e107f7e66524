"""Halos that other processes fill, and the tables of messages by which they do.

A neighbouring process is one more periodic side: the halo repeats what lies on the other side of an axis, only that
this lies in the memory of another process. Axis by axis values are packed, sent and unpacked; later axes send the halos
of earlier ones along, so that those at edges and corners come of themselves.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from farhorizon.engine.rows.build import load_exchange
from farhorizon.engine.rows.exchanges import HEAD, ROW

Places = np.ndarray  # of a halo, and of what it repeats; shape (2, n)
Side = tuple[int, int]

#: Numbers of the tables: of levels and states, and of the slots of each pass; of the filter's box the last one.
LEVEL, SLOTS = 0, 1


@dataclass(frozen=True)
class Link:
    """How a process reaches others: numbers that compiled code is given.

    Attributes
    ----------
    function : int
        Address of MPI_Sendrecv; 0 where there is nobody but the process itself.
    communicator, kind : int
        Handles: of the communicator, and of the type of a byte.
    wide : bool
        Whether handles are pointers, not numbers of four bytes.
    own : int
        Number of this process.
    """

    function: int
    communicator: int
    kind: int
    wide: bool
    own: int


@dataclass(frozen=True, eq=False)
class Messages:
    """What is sent and received, in this order.

    Attributes
    ----------
    link : Link
    rows : list of (int, int, ndarray, ndarray, int)
        Of each message, to whom and from whom (below 0 for nobody), places that are sent and places that are filled,
        and what tells it from others.
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

    def table(self, size: int, buffers: np.ndarray) -> np.ndarray:
        """The table for values of so many bytes, see `engine.rows.exchanges`; `buffers` must outlive it."""
        link, runs, rows = self.link, list[np.ndarray](), []
        start = HEAD + ROW * len(self.rows)
        for to, source, sent, filled, tag in self.rows:
            ends = []
            for places in (sent, filled):
                found = _runs(places) * size
                runs.append(found.ravel())
                ends += [start, start + found.size]
                start += found.size
            rows.append([to, source, *ends, len(sent) * size, tag])
        head = [link.function, link.communicator, link.kind, link.wide, link.own, len(self.rows)]
        return np.concatenate(
            [np.array([*head, *(one.ctypes.data for one in buffers)], np.int64), *np.array(rows, np.int64), *runs]
        )

    @property
    def longest(self) -> int:
        """Values of one component in the longest message."""
        return max((len(sent) for _, _, sent, *_ in self.rows), default=0)

    @property
    def volume(self) -> int:
        """Values of one component that go to other processes."""
        return sum(len(sent) for to, _, sent, *_ in self.rows if to >= 0 and to != self.link.own)


def _runs(places: np.ndarray) -> np.ndarray:
    """Runs of neighbouring places: the first of each, and their number."""
    first = np.flatnonzero(np.diff(places, prepend=-2) != 1)
    return np.stack([places[first], np.diff(first, append=len(places))], axis=-1)


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
    numbers : ndarray of int, shape (kinds, 3)
        Of each kind the address of the compiled function and of its table, and whether there is anything in it.
    """

    def __init__(self, kinds: Sequence[Messages], components: int, dtype: np.dtype) -> None:
        self.messages, self._size = list(kinds), dtype.itemsize
        longest = max(one.longest for one in kinds)
        self._buffers = np.zeros((2, components * longest * dtype.itemsize), np.uint8)
        self._tables = [one.table(dtype.itemsize, self._buffers) for one in kinds]
        function = load_exchange()
        used = [bool(one.rows) for one in kinds]
        addresses = [table.ctypes.data for table in self._tables]
        self.numbers = np.array([(function, *one) for one in zip(addresses, used, strict=True)], np.int64)

    def fill(self, level: np.ndarray, components: int, times: int = 1) -> None:
        """Let other processes fill the halo of a level, as the compiled loop does; all of them call it."""
        function, table, _ = (int(number) for number in self.numbers[LEVEL])
        call = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 4)(function)
        for _ in range(times):
            call(table, level.ctypes.data, components, level.nbytes // components)

    @property
    def filled(self) -> np.ndarray:
        """Places of a level's first component that other processes fill, shape (n,)."""
        places = [filled for _, source, _, filled, _ in self.messages[LEVEL].rows if source >= 0]
        return np.unique(np.concatenate([np.zeros(0, np.int64), *places]))

    def volume(self, components: int) -> int:
        """Bytes of a level that this process sends to others."""
        return self.messages[LEVEL].volume * components * self._size

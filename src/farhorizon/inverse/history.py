"""The history of a run on a patch: kept as a whole, or remade piece by piece from states that were kept on the way."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from farhorizon.errors import InputError
from farhorizon.files.records import Recorded
from farhorizon.inverse.patch import Patch
from farhorizon.inverse.schedule import pieces_backward, repeats, states_ahead
from farhorizon.simulation.assembly import RunParts
from farhorizon.simulation.recorders.recorder import Arrays, Recorder, RecordRequest, StepValues
from farhorizon.simulation.setup.setup import Setup
from farhorizon.simulation.simulation import Simulation

_PARTS = "levels", "memory"  # of an engine that a run goes back to


class PatchRecorder(Recorder, offered=False):
    """A recorder that sees, after every step, the places of a patch and perhaps further `nodes`, flat indices; `of_all`
    are the sorted ones of the patches of all processes.
    """

    name = "patch"
    shared = unlike = True

    def __init__(self, patch: Patch, nodes: np.ndarray | None = None, of_all: np.ndarray | None = None) -> None:
        self.notes = []
        self.patch = patch
        self.nodes = np.zeros(0, np.int64) if nodes is None else nodes
        # all processes request and receive the same, of which each takes its columns
        self._requested, self._columns = np.concatenate([patch.nodes, self.nodes]), None
        if of_all is not None:
            columns = np.searchsorted(of_all, patch.nodes), of_all.size + np.arange(self.nodes.size)
            self._requested, self._columns = np.concatenate([of_all, self.nodes]), np.concatenate(columns)

    def begin(self, setup: Setup, parts: RunParts) -> RecordRequest:
        self._background = parts.near.background
        return RecordRequest(self._requested, ())

    def start(self, step: int, heard: StepValues) -> None:
        pass

    def rows(self, heard: StepValues) -> np.ndarray:
        """Return what was recorded, shape (steps, components, places and nodes)."""
        nodes = heard.nodes.swapaxes(1, 2)
        return nodes if self._columns is None else nodes[:, :, self._columns]

    @property
    def recorded(self) -> Recorded:
        """Not asked for: what is on a patch is read by rows, and goes into no file."""
        raise NotImplementedError

    def forget(self) -> None:
        pass

    def state(self) -> Arrays:
        return {}

    def take(self, state: Arrays) -> None:
        pass


class Rows(PatchRecorder, offered=False):
    """The `values` (rows, components, places) of a run on a patch in consecutive steps, from step `first` on; `walls`
    are places beyond walls and the value there, see `Patch.held`.
    """

    def __init__(
        self,
        patch: Patch,
        walls: list[tuple[np.ndarray, float]],
        real: str = "float64",
        of_all: np.ndarray | None = None,
    ) -> None:
        super().__init__(patch, of_all=of_all)
        self.walls, self.real = walls, real
        self.first, self.values = 0, np.zeros((0, 1, patch.places), real)

    def open(self, sim: Simulation, steps: int) -> None:
        """Make room for the next steps of a run, and fill in its present level and the one before."""
        levels = ["u_old", "u"][2 - sim.model.order :]
        components = sim.stencil.components
        shape = steps + len(levels), components, self.patch.places
        if self.values.shape != shape:
            self.values = np.zeros(shape, self.real)
        self.first = sim.step_count + 1 - len(levels)
        for row, level in enumerate(levels):
            values = on_all_nodes(sim, sim.parts.grid.get(level)).reshape(components, -1)
            self.values[row] = values[:, self.patch.nodes]
        self._lay_walls(0, len(levels))

    def add(self, step: int, heard: StepValues) -> None:
        row, rows = step - self.first, self.rows(heard)
        self.values[row : row + len(rows)] = rows
        self._lay_walls(row, row + len(rows))

    def _lay_walls(self, low: int, high: int) -> None:
        for beyond, value in self.walls:
            self.values[low:high, :, beyond] = value


def on_all_nodes(sim: Simulation, field: np.ndarray) -> np.ndarray:
    """Return a field, whose last axes are those of the lattice, on all nodes, if this process has a part of them."""
    whole = sim.lattice.whole
    if not sim.team:
        return field
    lead, count = field.shape[: field.ndim - whole.dim], int(np.prod(whole.shape))
    here = np.arange(count).reshape(whole.shape)[sim.lattice.within].ravel()
    flat = np.ascontiguousarray(field, float).reshape(-1, here.size)
    return sim.team.completed(flat, here, count, 1).reshape(*lead, *whole.shape)


_AT_ONCE = (
    1 << 21
)  # numbers that a patch keeps before they are used: blocks of this size are used again, not mapped anew


def advance(sim: Simulation, patch: Patch, steps: int) -> None:
    """Advance a run that records a patch, few steps at a time."""
    places = max(1, int(sim.team.largest(patch.places)))  # all processes make the same steps at once
    most = max(1, _AT_ONCE // (sim.stencil.components * places))
    end = sim.step_count + steps
    while sim.step_count < end:
        sim.step(min(most, end - sim.step_count))


class Piece(NamedTuple):
    """The rows of the steps from `first` to `end` of a run; for waves also the step before."""

    first: int
    end: int
    rows: Rows

    def energy(self) -> np.ndarray:
        """Return the sum of ``u . u`` over the steps, shape (places,)."""
        found = np.zeros(self.rows.patch.places)
        for row in self.rows.values[self.first - self.rows.first : self.end - self.rows.first]:
            found += (row.astype(float) ** 2).sum(0)
        return found


class Past(NamedTuple):
    """The state of a run between two steps."""

    arrays: tuple[np.ndarray, ...]  # those of `_PARTS`
    clock: tuple[int, int]
    scale: float

    @property
    def step(self) -> int:
        """Steps done."""
        return self.clock[0]

    @classmethod
    def of(cls, sim: Simulation) -> Past:
        """Return a copy of the present state."""
        arrays = tuple(sim.engine.get(name).copy() for name in _PARTS)
        return cls(arrays, sim.engine.clock, sim.time_loop.source_table.scale)

    def restore(self, sim: Simulation) -> None:
        """Bring a run of the same set-up into this state."""
        for name, values in zip(_PARTS, self.arrays, strict=True):
            sim.engine.put(name, values)
        sim.engine.clock, sim.time_loop.source_table.scale = self.clock, self.scale
        sim.step_count, sim.time = self.step, self.step * sim.dt

    @property
    def nbytes(self) -> int:
        """Bytes of the state."""
        return sum(one.nbytes for one in self.arrays)


class WholeHistory:
    """A history that is kept as a whole, of a run at its start with `rows` among its recorders."""

    def __init__(self, sim: Simulation, rows: Rows, steps: int) -> None:
        self.sim, self.rows, self.steps = sim, rows, steps

    def run(self) -> None:
        """Run to the end."""
        self.rows.open(self.sim, self.steps)
        advance(self.sim, self.rows.patch, self.steps)

    def backward(self) -> Iterator[Piece]:
        """Yield the pieces, the last one first."""
        yield Piece(0, self.steps, self.rows)


class Remade:
    """A history whose pieces, `length` steps each, are computed again from up to `room` states that were kept."""

    def __init__(self, sim: Simulation, setup: Setup, rows: Rows, steps: int, length: int, room: int) -> None:
        self.sim, self.rows, self.steps, self.length, self.room = sim, rows, steps, length, room
        self.count = -(-steps // length)
        self._states: dict[int, Past] = {}
        self._setup = setup

    @classmethod
    def within(cls, budget: float, row: int, sim: Simulation, setup: Setup, rows: Rows, steps: int) -> Remade:
        """Return the history that fits into `budget` bytes with the least work, for rows of `row` bytes; an InputError
        where not even a few states fit, or for exact ends, which keep their own past.
        """
        key, size = "memory", int(sim.team.largest(sum(sim.engine.get(name).nbytes for name in _PARTS)))
        if sim.exact_ends is not None:
            raise InputError(
                "exact ends keep their whole past, and the history must fit, too",
                value=budget,
                limit=(steps + 2) * row,
                key=key,
                remedy='precision="float32", a smaller region, or LatticePML',
            )
        rooms = range(1, int((budget - 3 * row) // size) + 1)
        found = [(room, int((budget - room * size) // row) - 2) for room in rooms]
        if not found:
            raise InputError(
                "the history does not fit",
                value=budget,
                limit=f">= {size + 3 * row}",
                key=key,
                remedy='more memory, precision="float32", or a smaller region',
            )
        works = [repeats(-(-steps // length), room) * length for room, length in found]
        room, length = found[int(np.argmin(works))]
        return cls(sim, setup, rows, steps, length, room)

    def run(self) -> None:
        """Run to the end, and keep the states from which the last pieces are made."""
        for piece in states_ahead(self.count, self.room):
            self.sim.step(piece * self.length - self.sim.step_count)
            self._states[piece] = Past.of(self.sim)
        self.sim.step(self.steps - self.sim.step_count)

    def backward(self) -> Iterator[Piece]:
        """Yield the pieces, the last one first."""
        processes = self.sim.team, self.sim.topology
        self.sim = sim = Simulation.of(self._setup, [], *processes)  # whose receivers do not record anything twice
        again = Simulation.of(self._setup, [self.rows], *processes)
        for piece, start, keep in pieces_backward(self.count, self.room):
            for number in [number for number in self._states if number > piece]:
                del self._states[number]
            self._states[start].restore(sim)
            for number in keep:
                sim.step(number * self.length - sim.step_count)
                self._states[number] = Past.of(sim)
            first, end = piece * self.length, min((piece + 1) * self.length, self.steps)
            sim.step(first - sim.step_count)
            Past.of(sim).restore(again)
            self.rows.open(again, end - first)
            advance(again, self.rows.patch, end - first)
            yield Piece(first, end, self.rows)

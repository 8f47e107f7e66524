"""Values that the compiled loop keeps after every step for the recorders and probes of a run.

Each of several processes keeps those of its own nodes; the recorders of all receive the complete values.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from farhorizon import kinds
from farhorizon.engine.features.block_sums import record_blocks
from farhorizon.errors import FileFormatError, InputError
from farhorizon.geometry.interpolation import Blocks
from farhorizon.geometry.lattice import Lattice
from farhorizon.simulation.assembly import RunParts
from farhorizon.simulation.heat.thermal_strains import ThermalStrains
from farhorizon.simulation.processes.process_group import ALONE, ProcessGroup
from farhorizon.simulation.recorders.fourier_sums import BLOCK
from farhorizon.simulation.recorders.recorder import Arrays, Recorder, RecordRequest, RowRecorder, StepValues
from farhorizon.simulation.setup.setup import Setup
from farhorizon.simulation.time.outer_loop import warn

_NUMBERS = itertools.count(1)  # numbers of the runs of this process
_ROOM = 2**24  # how many numbers may be kept before the loop returns, which fits easily into memory


class Probes:
    """Values recorded by a run at some nodes, after every step or every few steps; created by `Run.record`.

    Parameters
    ----------
    lattice : Lattice
    points : array_like, shape (n, dim), or (n,) in 1D
        Each point is replaced by the nearest node.
    stride : int
        Steps from one row to the next.

    Attributes
    ----------
    places : ndarray, shape (n, dim)
        Coordinates of the nodes that are used.
    nodes : ndarray of int, shape (n,)
        Their flat indices in the lattice.

    Raises
    ------
    InputError
        A point outside the near field.

    Examples
    --------
    >>> import farhorizon as fh
    >>> sim = fh.Simulation(fh.Lattice(1.0, -9, 9), fh.Wave(fh.Kernel(1.0)), initial={"u": "exp(-x**2)"})
    >>> probes = sim.record([0.0, 4.0])
    >>> sim.step(6)
    >>> probes.values.shape
    (7, 2)
    """

    def __init__(self, lattice: Lattice, points: Any, stride: int = 1) -> None:
        kinds.instance(lattice, "lattice", Lattice, "a Lattice")
        stride, points = kinds.integer(stride, "stride", least=1), kinds.array(points, "probes")
        if points.ndim < 2 and (lattice.dim == 1 or not points.size):  # numbers along a line, or none at all
            points = points.reshape(-1, lattice.dim)
        asked = kinds.array(np.atleast_2d(points), "probes", shape=(None, lattice.dim))
        indices = np.array([lattice.index(point, "probes") for point in asked], int).reshape(-1, lattice.dim)
        self.places, self.stride = lattice.lower + lattice.spacing * indices, stride
        self.nodes = np.ravel_multi_index(tuple(indices.T), lattice.shape) if len(indices) else np.zeros(0, int)
        apart = np.abs(self.places - asked).max(1, initial=0) > 1e-6 * lattice.spacing
        pairs = zip(asked[apart].tolist(), self.places[apart].round(12).tolist(), strict=True)
        self.notes = [f"the probe at {point} is recorded at the nearest node, {place}" for point, place in pairs]
        self._steps: list[np.ndarray] = []
        self._rows: list[np.ndarray] = []
        self._dt = 0.0

    def add(self, step: int, dt: float, rows: np.ndarray) -> None:
        """Record the values after the steps from number `step` on, shape (steps, n[, components])."""
        steps = step + np.arange(len(rows))
        kept = steps % self.stride == 0
        self._steps.append(steps[kept])
        self._rows.append(rows[kept])
        self._dt = dt

    @property
    def times(self) -> np.ndarray:
        """Times of the rows, shape (rows,)."""
        return np.concatenate([np.zeros(0), *self._steps]) * self._dt

    @property
    def values(self) -> np.ndarray:
        """Values, shape (rows, n[, components])."""
        return np.concatenate(self._rows) if self._rows else np.zeros((0, len(self.nodes)))

    def take(self) -> tuple[np.ndarray, np.ndarray]:
        """Return times and values since the last call, and discard them here."""
        times, values = self.times, self.values
        self._steps, self._rows = [], [values[:0]]
        return times, values


class _Served(NamedTuple):
    """A recorder, what it requests, and the part of it that lies in the box of this process."""

    recorder: Recorder
    request: RecordRequest
    nodes: np.ndarray
    which: np.ndarray  # which of the requested nodes these are
    blocks: list[tuple[Blocks, np.ndarray]]  # sums over blocks, and which of the requested ones these are
    strain: tuple[np.ndarray, np.ndarray] | None = None  # nodes and weights of the sums of thermal strains


class Recording:
    """The recorders and probes of a run, and the values that the loop keeps for them.

    Raises InputError if a recorder requests what the run cannot provide, or two recorders have the same name.
    """

    def __init__(
        self,
        setup: Setup,
        parts: RunParts,
        recorders: Sequence[Recorder] = (),
        team: ProcessGroup = ALONE,
        heating: ThermalStrains | None = None,
    ) -> None:
        self._heating = heating
        self._near, self._grid, self.recorders, self._team = parts.near, parts.grid, list(recorders), team
        names = [name for recorder in self.recorders for name in recorder.names]
        for name in names:
            if names.count(name) > 1:
                raise InputError(
                    "two recorders have one name",
                    value=name,
                    limit="a name each",
                    key="observe",
                    remedy='name="..." tells them apart',
                )
        doubts_before, self._number = self.doubts, next(_NUMBERS)
        requests: list[RecordRequest] = []
        for recorder in self.recorders:
            with self._naming(recorder), team.agreed():
                requests.append(recorder.begin(setup, parts))
            if isinstance(recorder, RowRecorder):
                recorder.resting = setup.load_steps is not None
            recorder.run = self._number
        for text in self.doubts:
            if text not in doubts_before:  # recorders of a run that is made anew have already issued theirs
                warn(text)
        self._served = [self._part_of(*pair) for pair in zip(self.recorders, requests, strict=True)]
        self._probed, self._own_probed = np.zeros(0, np.int64), (np.zeros(0, np.int64), np.zeros(0, np.int64))
        self._lay()
        for served in self._served:
            served.recorder.start(0, self._now(served))

    @contextmanager
    def _naming(self, recorder: Recorder) -> Iterator[None]:
        """Context in which an InputError names the recorder that it refers to, if there are several of its type."""
        try:
            yield
        except InputError as error:
            of_type = [other for other in self.recorders if type(other) is type(recorder)]
            if len(of_type) == 1:
                raise
            table, dot, parameter = error.key.partition(".")
            named = error.at(f"{table}[{of_type.index(recorder)}]{dot}{parameter}")
            named.agreed, named.told = error.agreed, error.told
            raise named from None

    def _lay(self) -> None:
        """Tell the engine what to keep: all components of nodes, one after the other, and the sums over blocks."""
        engine, lead = self._grid.engine, self._grid.lead
        places = self._grid.nodes.ravel()
        of_nodes = [self._own_probed[0], *(served.nodes for served in self._served)]
        sums: list[tuple[np.ndarray, list[np.ndarray]]] = []
        for blocks in (blocks for served in self._served for blocks, which in served.blocks if len(which)):
            first = places[np.ravel_multi_index(tuple(blocks.first.T), blocks.shape)]
            along = [np.ones((len(first), 1))] * lead + list(blocks.weights)
            sums += [(first + component * self._grid.layout.size, along) for component in range(engine.components)]
        record_blocks(engine, sums)
        requests = [served.request for served in self._served]
        count = len(self._probed) + sum(
            len(asked.nodes) + sum(len(b.first) for b in asked.blocks) for asked in requests
        )
        self._kept = engine.components * count  # how many numbers per step, over all processes
        engine.record_nodes(
            np.concatenate([engine.all_components(places[nodes]) for nodes in of_nodes]),
            math.gcd(*(asked.every for asked in requests), int(self._probed.size > 0)) or 1,
            any(asked.held for asked in requests),
            any(asked.impactors for asked in requests),
        )

    def _part_of(self, recorder: Recorder, request: RecordRequest) -> _Served:
        lattice = self._near.lattice
        blocks = [(blocks, np.arange(len(blocks.first))) for blocks in request.blocks]
        if self._team:
            blocks = [blocks.within(lattice.first, lattice.shape) for blocks in request.blocks]
        strain = blocks[0][0].entries() if request.heat else None
        return _Served(recorder, request, *self._nodes_of(request.nodes), blocks, strain)

    def _nodes_of(self, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return those of some nodes of the lattice that lie in this part of it, and which of them these are."""
        inside, own = self._near.lattice.own(nodes)
        return own, np.flatnonzero(inside)

    def _width(self, nodes: np.ndarray) -> int:
        """Return how many numbers the loop keeps per step for some nodes."""
        return self._grid.engine.components * len(nodes)

    def set_probes(self, nodes: np.ndarray) -> None:
        """Keep values of some nodes of the near field for probes, in place of those before."""
        self._probed, self._own_probed = nodes, self._nodes_of(nodes)
        self._lay()

    def _now(self, served: _Served) -> StepValues:
        """Return what a recorder receives for the previous step and the present one, from the present state."""
        engine, grid = self._grid.engine, self._grid
        names = ("u_old" if self._near.model.order == 2 else "u", "u")
        # (2, nodes, components)
        values = np.stack([np.array(grid.get(name), float).reshape(engine.components, -1).T for name in names])
        block_values = []
        for blocks, _ in served.blocks:
            nodes, weights = blocks.entries()
            block_values.append(np.einsum("rnkc,nk->rnc", values[:, nodes], weights))
        none = np.zeros((0, len(served.request.held), engine.components))
        if served.request.impactors:
            none = np.zeros((0, served.request.impactors, 3 * engine.components + 1))
        return self._of_all(served, values[:, served.nodes], block_values)._replace(forces=none)

    def _of_all(self, served: _Served, nodes: np.ndarray, blocks: Sequence[np.ndarray]) -> StepValues:
        """Combine the values of all processes."""
        completed, request = self._team.completed, served.request
        sums = [
            completed(values, which, len(requested.first), 1)
            for values, (_, which), requested in zip(blocks, served.blocks, request.blocks, strict=True)
        ]
        if served.strain is not None and self._heating is not None:
            own_strains = self._heating.at_points(*served.strain, len(blocks[0]))[..., None]
            strains = completed(own_strains, served.blocks[0][1], len(request.blocks[0].first), 1)
            sums.append(np.broadcast_to(strains, sums[0].shape))
        return StepValues(completed(nodes, served.which, len(request.nodes), 1), tuple(sums))

    def foresee(self, until: float, steps: int) -> None:
        """Announce a run to a time, of `steps` steps in all, to the recorders."""
        with self._team.agreed():
            for recorder in self.recorders:
                recorder.foresee(until, steps)

    def allow(self, step: int, steps: int) -> int:
        """Return how many of some steps to make from number `step` on: up to where a recorder examines the run,
        few enough for the kept values to fit into memory, and ending with a block of Fourier sums unless that would
        make them less than half, because whole blocks are summed without a copy.

        Raises InputError if a recorder has been passed to another run in the meantime.
        """
        for recorder in self.recorders:
            if recorder.run != self._number:
                raise InputError(
                    "another run has this recorder now",
                    value=recorder.name,
                    limit="one run at a time",
                    key="observe",
                    remedy="a recorder of its own for each run",
                )
        most = max(BLOCK, _ROOM // max(1, self._kept))
        to_stops = [s.request.every - step % s.request.every for s in self._served if s.request.stop]
        steps = min([steps, most, *to_stops])
        to_block = steps - (step + steps + 1) % BLOCK
        return to_block if 2 * to_block > steps else steps

    def add(self, step: int) -> None:
        """Pass the values that the loop has kept in its last steps, from number `step` on, to the recorders."""
        engine, row = self._grid.engine, 0
        node_values, block_values = engine.get("node_values"), engine.get("block_values")
        start = self._width(self._own_probed[0])
        for served in self._served:
            end = start + self._width(served.nodes)
            nodes, start = _by_component(node_values[:, start:end], engine.components), end
            sums = []
            for blocks, _ in served.blocks:
                last = row + engine.components * len(blocks.first)
                sums.append(_by_component(block_values[:, row:last], engine.components))
                row = last
            values, held = self._of_all(served, nodes, sums), served.request.held
            if held:
                values = values._replace(forces=self._forces(step, held))
            elif served.request.impactors:
                values = values._replace(forces=engine.get("impactor_values"))
            served.recorder.add(step, values)

    def _forces(self, step: int, groups: Sequence[np.ndarray]) -> np.ndarray:
        """Return the sums over groups of nodes of the forces that held them in the last steps, from number `step` on;
        shape (steps, groups, components).
        """
        held_forces, components = self._grid.engine.get("held_forces"), self._grid.engine.components
        lattice = self._near.lattice
        component, node = np.divmod(self._near.prescribed.held(step - 1), int(np.prod(lattice.shape)))
        sums = np.zeros((len(held_forces), len(groups), components))
        for number, group in enumerate(groups):
            inside = np.isin(node, self._nodes_of(group)[0])
            for axis in range(components):
                which = np.flatnonzero(inside & (component == axis))
                # row by row in the same order, however many steps are added at once
                sums[:, number, axis] = np.ascontiguousarray(held_forces[:, which]).sum(1)
        return self._team.summed(sums)

    def probed(self) -> np.ndarray:
        """Return the values at the nodes of the probes after each of the last steps; shape (steps, nodes), for vectors
        (steps, nodes, components).
        """
        near, engine = self._near, self._grid.engine
        own_nodes, which = self._own_probed
        values = engine.get("node_values")[:, : self._width(own_nodes)] + near.background
        values = _by_component(values, engine.components)
        if near.hidden is not None:
            values[:, near.hidden.ravel()[own_nodes]] = np.nan
        completed = self._team.completed(values, which, len(self._probed), 1)
        return np.asarray(completed[..., 0] if engine.components == 1 else completed)

    @property
    def notes(self) -> list[str]:
        """Notes of all recorders."""
        return [note for recorder in self.recorders for note in recorder.notes]

    @property
    def doubts(self) -> list[str]:
        """Why recorded data may be wrong, from all recorders."""
        return [text for recorder in self.recorders for text in recorder.doubts]

    def state(self) -> Arrays:
        """Return the state of all recorders, by their names."""
        return {
            f"recorder/{served.recorder.name}/{name}": array
            for served in self._served
            for name, array in {**served.recorder.state(), **_asked(served)}.items()
        }

    def take(self, arrays: Arrays, step: int) -> None:
        """Restore a state returned by `state`; recorders that are not in it begin now.

        Raises FileFormatError if something else was recorded under the name of a recorder.
        """
        for served in self._served:
            recorder = served.recorder
            head = f"recorder/{recorder.name}/"
            stored = {name.removeprefix(head): array for name, array in arrays.items() if name.startswith(head)}
            if not stored:
                recorder.start(step, self._now(served))
                continue
            present, asked = recorder.state(), _asked(served)
            asked_before = {name: stored.pop(name, asked[name]) for name in asked}
            alike = present.keys() == stored.keys() and all(
                present[name].shape[1:] == array.shape[1:] for name, array in stored.items()
            )
            changed = [name for name, array in asked.items() if not _equal(array, asked_before[name])]
            if not alike or changed:
                raise FileFormatError(
                    "the checkpoint belongs to a run that recorded something else under this name",
                    value=recorder.name,
                    limit=", ".join(
                        [f"same {name.partition('.')[2]}" for name in changed]
                        or [f"{name} {array.shape[1:]}" for name, array in present.items()]
                    ),
                    key="observe",
                    remedy="give the recorders of the run that wrote it, or another name",
                )
            recorder.take(stored)


def _asked(served: _Served) -> Arrays:
    """Return where, how often and at which frequencies a recorder records."""
    asked = {"every": np.array([served.request.every]), **served.recorder.asked}
    return {f"asked.{name}": np.asarray(values, float) for name, values in asked.items()}


def _equal(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether two arrays are equal up to rounding errors."""
    size = np.abs(first).max(initial=0.0)
    return first.shape == second.shape and np.allclose(first, second, rtol=0, atol=1e-9 * size, equal_nan=True)


def _by_component(values: np.ndarray, components: int) -> np.ndarray:
    """Reshape rows that hold all nodes, component by component, to (steps, nodes, components)."""
    return values.reshape(len(values), components, -1).swapaxes(1, 2)

"""Values that the compiled loop keeps after every step for the recorders and probes of a run.

Each of several processes keeps the part of its own nodes; the recorders of all receive the complete values.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from farhorizon.engine.settings import record_blocks
from farhorizon.errors import FileFormatError, InputError
from farhorizon.geometry.interpolation import Blocks
from farhorizon.simulation.assembly import Parts
from farhorizon.simulation.heat.heating import Heating
from farhorizon.simulation.processes.process_group import ALONE, ProcessGroup
from farhorizon.simulation.recorders.fourier_sums import BLOCK
from farhorizon.simulation.recorders.recorder import Arrays, Recorder, RecordRequest, StepValues
from farhorizon.simulation.setup.setup import Setup
from farhorizon.simulation.time.outer_loop import warn

_NUMBERS = itertools.count(1)  # numbers of the runs of this process
_ROOM = 2**24  # how many numbers may be kept before the loop returns, which fits easily into memory


class _Own(NamedTuple):
    """The part of what a recorder wants that lies in the box of this process: nodes, and which of the wanted ones they
    are; sums over blocks, likewise; nodes and weights of the sums of thermal strains.
    """

    nodes: np.ndarray
    which: np.ndarray
    blocks: list[tuple[Blocks, np.ndarray]]
    warm: tuple[np.ndarray, np.ndarray] | None = None


class Recording:
    """The recorders and probes of a run, and the values that the loop keeps for them.

    Parameters
    ----------
    setup : Setup
    parts : Parts
    recorders : sequence of Recorder
    team : ProcessGroup
        The processes that compute the run.
    heating : Heating, optional
        Temperature that strains the medium.

    Raises
    ------
    InputError
        A recorder wants what the run cannot provide; two recorders have the same name.
    """

    def __init__(
        self,
        setup: Setup,
        parts: Parts,
        recorders: Sequence[Recorder] = (),
        team: ProcessGroup = ALONE,
        heating: Heating | None = None,
    ) -> None:
        self._heating = heating
        self._near, self._grid, self.recorders, self._team = parts.near, parts.grid, list(recorders), team
        names = [name for one in self.recorders for name in one.names]
        for name in names:
            if names.count(name) > 1:
                raise InputError(
                    "two recorders have one name",
                    value=name,
                    limit="a name each",
                    key="observe",
                    remedy='name="..." tells them apart',
                )
        known, self._number = self.doubts, next(_NUMBERS)
        self._wanted: list[RecordRequest] = []
        for one in self.recorders:
            with self._naming(one), team.agreed():
                self._wanted.append(one.begin(setup, parts))
            one.run = self._number
        for text in self.doubts:
            if text not in known:  # recorders of a run that is made anew have already issued theirs
                warn(text)
        self._own = [self._part_of(wanted) for wanted in self._wanted]
        self._probed, self._own_probed = np.zeros(0, np.int64), (np.zeros(0, np.int64), np.zeros(0, np.int64))
        self._lay()
        for one, wanted, own in zip(self.recorders, self._wanted, self._own, strict=True):
            one.start(0, self._now(wanted, own))

    @contextmanager
    def _naming(self, one: Recorder) -> Iterator[None]:
        """Context in which an InputError names the recorder that it refers to, if there are several of its type."""
        try:
            yield
        except InputError as error:
            alike = [other for other in self.recorders if type(other) is type(one)]
            if len(alike) == 1:
                raise
            table, dot, rest = error.key.partition(".")
            named = error.at(f"{table}[{alike.index(one)}]{dot}{rest}")
            named.agreed, named.told = error.agreed, error.told
            raise named from None

    def _lay(self) -> None:
        """Tell the engine what to keep: all components of nodes, one after the other, and the sums over blocks."""
        engine, lead = self._grid.engine, self._grid.lead
        places = self._grid.nodes.ravel()
        watched = [engine.all_components(places[nodes]) for nodes in self._all_nodes()]
        engine.record_nodes(np.concatenate(watched))
        found: list[tuple[np.ndarray, list[np.ndarray]]] = []
        for blocks in (one for own in self._own for one, which in own.blocks if len(which)):
            first = places[np.ravel_multi_index(tuple(blocks.first.T), blocks.shape)]
            along = [np.ones((len(first), 1))] * lead + list(blocks.weights)
            found += [(first + component * engine.layout.size, along) for component in range(engine.components)]
        record_blocks(engine, found)
        asked = [
            self._probed,
            *(one for wanted in self._wanted for one in (wanted.nodes, *(b.first for b in wanted.blocks))),
        ]
        self._kept = engine.components * sum(map(len, asked))  # how many numbers per step, over all processes
        engine.watch_stride = math.gcd(*(wanted.every for wanted in self._wanted), int(self._probed.size > 0)) or 1
        engine.forces_wanted = any(wanted.held for wanted in self._wanted)

    def _part_of(self, wanted: RecordRequest) -> _Own:
        lattice = self._near.lattice
        nodes, which = self._nodes_of(wanted.nodes)
        blocks = [(one, np.arange(len(one.first))) for one in wanted.blocks]
        if self._team:
            blocks = [one.within(lattice.first, lattice.shape) for one in wanted.blocks]
        return _Own(nodes, which, blocks, blocks[0][0].entries() if wanted.heat else None)

    def _nodes_of(self, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return those of some nodes of the lattice that lie in this part of it, and which of them these are."""
        inside, own = self._near.lattice.own(nodes)
        return own, np.flatnonzero(inside)

    def _all_nodes(self) -> list[np.ndarray]:
        return [self._own_probed[0], *(own.nodes for own in self._own)]

    def _width(self, nodes: np.ndarray) -> int:
        """Return how many numbers the loop keeps per step for some nodes."""
        return self._grid.engine.components * len(nodes)

    def set_probes(self, nodes: np.ndarray) -> None:
        """Keep values of some nodes of the near field for probes, in place of those before."""
        self._probed, self._own_probed = nodes, self._nodes_of(nodes)
        self._lay()

    def _now(self, wanted: RecordRequest, own: _Own) -> StepValues:
        """Return what a recorder receives for the previous step and the present one, from the present state."""
        engine, grid = self._grid.engine, self._grid
        order = self._near.model.order
        levels = [engine.older, engine.current] if order == 2 else [engine.current] * 2
        flat = [np.array(grid.view(level), float).reshape(engine.components, -1).T for level in levels]
        values = np.stack(flat)  # (2, nodes, components)
        blocks = []
        for one, _ in own.blocks:
            nodes, weights = one.entries()
            blocks.append(np.einsum("rnkc,nk->rnc", values[:, nodes], weights))
        return self._of_all(wanted, own, values[:, own.nodes], blocks)

    def _of_all(self, wanted: RecordRequest, own: _Own, nodes: np.ndarray, blocks: Sequence[np.ndarray]) -> StepValues:
        """Combine the values of all processes."""
        completed = self._team.completed
        sums = [
            completed(values, which, len(asked.first), 1)
            for values, (_, which), asked in zip(blocks, own.blocks, wanted.blocks, strict=True)
        ]
        if own.warm is not None and self._heating is not None:
            strains = self._heating.at_points(*own.warm, len(blocks[0]))[..., None]
            known = completed(strains, own.blocks[0][1], len(wanted.blocks[0].first), 1)
            sums.append(np.broadcast_to(known, sums[0].shape))
        return StepValues(completed(nodes, own.which, len(wanted.nodes), 1), tuple(sums))

    def foresee(self, until: float, steps: int) -> None:
        """Announce a run to a time, of `steps` steps in all, to the recorders."""
        with self._team.agreed():
            for one in self.recorders:
                one.foresee(until, steps)

    def allow(self, step: int, wanted: int) -> int:
        """Return how many of the wanted steps to make from number `step` on: up to where a recorder examines the run,
        few enough for the kept values to fit into memory, and ending with a block of Fourier sums unless that would
        make them less than half, because whole blocks are summed without a copy.

        Raises
        ------
        InputError
            A recorder has been passed to another run in the meantime.
        """
        for one in self.recorders:
            if one.run != self._number:
                raise InputError(
                    "another run has this recorder now",
                    value=one.name,
                    limit="one run at a time",
                    key="observe",
                    remedy="a recorder of its own for each run",
                )
        most = max(BLOCK, _ROOM // max(1, self._kept))
        wanted = min([wanted, most, *(one.every - step % one.every for one in self._wanted if one.stop)])
        whole = wanted - (step + wanted + 1) % BLOCK
        return whole if 2 * whole > wanted else wanted

    def add(self, step: int) -> None:
        """Pass the values that the loop has kept in its last steps, from number `step` on, to the recorders."""
        engine, row = self._grid.engine, 0
        start = self._width(self._own_probed[0])
        for one, wanted, own in zip(self.recorders, self._wanted, self._own, strict=True):
            end = start + self._width(own.nodes)
            nodes, start = _by_component(engine.node_values[:, start:end], engine.components), end
            blocks = []
            for block, _ in own.blocks:
                last = row + engine.components * len(block.first)
                blocks.append(_by_component(engine.block_values[:, row:last], engine.components))
                row = last
            block_values = self._of_all(wanted, own, nodes, blocks)
            one.add(
                step, block_values._replace(forces=self._forces(step, wanted.held)) if wanted.held else block_values
            )

    def _forces(self, step: int, groups: Sequence[np.ndarray]) -> np.ndarray:
        """Return the sums over groups of nodes of the forces that held them in the last steps, from number `step` on;
        shape (steps, groups, components).
        """
        engine, lattice = self._grid.engine, self._near.lattice
        component, node = np.divmod(self._near.prescribed.held(step - 1), int(np.prod(lattice.shape)))
        found = np.zeros((len(engine.held_forces), len(groups), engine.components))
        for number, group in enumerate(groups):
            inside = np.isin(node, self._nodes_of(group)[0])
            for c in range(engine.components):
                which = np.flatnonzero(inside & (component == c))
                # row by row in the same order, however many steps are added at once
                found[:, number, c] = np.ascontiguousarray(engine.held_forces[:, which]).sum(1)
        return self._team.summed(found)

    def probed(self) -> np.ndarray:
        """Return the values at the nodes of the probes after each of the last steps; shape (steps, nodes), for vectors
        (steps, nodes, components).
        """
        near, engine = self._near, self._grid.engine
        own, which = self._own_probed
        values = engine.node_values[:, : self._width(own)] + near.background
        values = _by_component(values, engine.components)
        if near.hidden is not None:
            values[:, near.hidden.ravel()[own]] = np.nan
        found = self._team.completed(values, which, len(self._probed), 1)
        return np.asarray(found[..., 0] if engine.components == 1 else found)

    @property
    def notes(self) -> list[str]:
        """Notes of all recorders."""
        return [note for one in self.recorders for note in one.notes]

    @property
    def doubts(self) -> list[str]:
        """Why recorded data may be wrong, from all recorders."""
        return [text for one in self.recorders for text in one.doubts]

    def state(self) -> Arrays:
        """Return the state of all recorders, by their names."""
        return {
            f"recorder/{one.name}/{name}": array
            for one, wanted in zip(self.recorders, self._wanted, strict=True)
            for name, array in {**one.state(), **_asked(one, wanted)}.items()
        }

    def take(self, arrays: Arrays, step: int) -> None:
        """Restore a state returned by `state`; recorders that are not in it begin now.

        Raises
        ------
        FileFormatError
            Something else was recorded under the name of a recorder.
        """
        for one, wanted, own in zip(self.recorders, self._wanted, self._own, strict=True):
            head = f"recorder/{one.name}/"
            theirs = {name.removeprefix(head): array for name, array in arrays.items() if name.startswith(head)}
            if not theirs:
                one.start(step, self._now(wanted, own))
                continue
            mine, asked = one.state(), _asked(one, wanted)
            before = {name: theirs.pop(name, asked[name]) for name in asked}
            alike = mine.keys() == theirs.keys() and all(mine[n].shape[1:] == a.shape[1:] for n, a in theirs.items())
            other = [name for name, array in asked.items() if not _same(array, before[name])]
            if not alike or other:
                raise FileFormatError(
                    "the checkpoint belongs to a run that recorded something else under this name",
                    value=one.name,
                    limit=", ".join(
                        [f"same {name.partition('.')[2]}" for name in other]
                        or [f"{n} {a.shape[1:]}" for n, a in mine.items()]
                    ),
                    key="observe",
                    remedy="give the recorders of the run that wrote it, or another name",
                )
            one.take(theirs)


def _asked(one: Recorder, wanted: RecordRequest) -> Arrays:
    """Return where, how often and at which frequencies a recorder records."""
    found = {"every": np.array([wanted.every]), **one.asked}
    return {f"asked.{name}": np.asarray(values, float) for name, values in found.items()}


def _same(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two arrays are equal up to rounding errors."""
    size = np.abs(one).max(initial=0.0)
    return one.shape == other.shape and np.allclose(one, other, rtol=0, atol=1e-9 * size, equal_nan=True)


def _by_component(values: np.ndarray, components: int) -> np.ndarray:
    """Reshape rows that hold all nodes, component by component, to (steps, nodes, components)."""
    return values.reshape(len(values), components, -1).swapaxes(1, 2)

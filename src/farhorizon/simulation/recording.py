"""What the compiled loop keeps after every step for the recorders of a run and its probes."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from farhorizon.errors import FileFormatError, InputError
from farhorizon.simulation.assembly import Parts
from farhorizon.simulation.course import warn
from farhorizon.simulation.fourier_sums import BLOCK
from farhorizon.simulation.recorder import Arrays, Heard, Recorder, Wanted
from farhorizon.simulation.setup import Setup

_ROOM = 2**24  # numbers that are kept of the steps between two looks: fewer than memory has


class Recording:
    """The recorders of a run at its start and its probes, and what the loop keeps for them.

    Parameters
    ----------
    setup : Setup
    parts : Parts
    recorders : sequence of Recorder

    Raises
    ------
    InputError
        What a recorder wants and the run cannot give, two recorders of one name.
    """

    def __init__(self, setup: Setup, parts: Parts, recorders: Sequence[Recorder] = ()) -> None:
        self._near, self._grid, self.recorders = parts.near, parts.grid, list(recorders)
        names = [name for one in self.recorders for name in one.names]
        for name in names:
            if names.count(name) > 1:
                raise InputError(
                    "two recorders have one name", value=name, key="observe", remedy='name="..." tells them apart'
                )
        known = self.doubts
        self._wanted = [one.begin(setup, parts) for one in self.recorders]
        for text in self.doubts:
            if text not in known:  # the recorders of a run that is made anew have told it
                warn(text)
        self._probed = np.zeros(0, np.int64)
        self._lay()
        for one, wanted in zip(self.recorders, self._wanted, strict=True):
            one.start(0, self._now(wanted))

    def _lay(self) -> None:
        """Tell the engine what to keep: all components of nodes, one after the other, and the rows of blocks."""
        engine, lead = self._grid.engine, self._grid.lead
        places = self._grid.nodes.ravel()
        watched = [engine.all_components(places[nodes]) for nodes in self._all_nodes()]
        engine.watch(np.concatenate(watched))
        found: list[tuple[np.ndarray, list[np.ndarray]]] = []
        for blocks in (one for wanted in self._wanted for one in wanted.blocks):
            first = places[np.ravel_multi_index(tuple(blocks.first.T), blocks.shape)]
            along = [np.ones((len(first), 1))] * lead + list(blocks.weights)
            found += [(first + component * engine.layout.size, along) for component in range(engine.components)]
        engine.listen(found)
        self._kept = sum(map(len, watched)) + sum(len(first) for first, _ in found)  # numbers a step
        engine.watch_stride = math.gcd(*(wanted.every for wanted in self._wanted), int(self._probed.size > 0)) or 1

    def _all_nodes(self) -> list[np.ndarray]:
        return [self._probed, *(wanted.nodes for wanted in self._wanted)]

    def _width(self, nodes: np.ndarray) -> int:
        """Numbers that the loop keeps of some nodes in a step."""
        return self._grid.engine.components * len(nodes)

    def watch(self, nodes: np.ndarray) -> None:
        """Look at some nodes of the near field for probes, in place of those before."""
        self._probed = nodes
        self._lay()

    def _now(self, wanted: Wanted) -> Heard:
        """What a recorder would be given of the state as it is, after what it was a step before."""
        engine, grid = self._grid.engine, self._grid
        order = self._near.model.order
        levels = [engine.older, engine.current] if order == 2 else [engine.current] * 2
        flat = [np.array(grid.view(level), float).reshape(engine.components, -1).T for level in levels]
        values = np.stack(flat)  # (2, nodes, components)
        blocks = []
        for one in wanted.blocks:
            nodes, weights = one.entries()
            blocks.append(np.einsum("rnkc,nk->rnc", values[:, nodes], weights))
        return Heard(values[:, wanted.nodes], tuple(blocks))

    def foresee(self, until: float, steps: int) -> None:
        """Let the recorders look at a run to a time, of so many steps in all."""
        for one in self.recorders:
            one.foresee(until, steps)

    def allow(self, step: int, wanted: int) -> int:
        """How many of the wanted steps to make from one on: to where a recorder has to see the run; so few that what is
        kept of them stays small; and to where blocks of Fourier sums end, if that is not much less, for whole blocks
        are summed where they lie.
        """
        most = max(BLOCK, _ROOM // max(1, self._kept))
        wanted = min([wanted, most, *(one.every - step % one.every for one in self._wanted if one.stop)])
        whole = wanted - (step + wanted + 1) % BLOCK
        return whole if 2 * whole > wanted else wanted

    def add(self, step: int) -> None:
        """Give the recorders what the loop has kept of its last steps, which begin with number `step`."""
        engine, row = self._grid.engine, 0
        start = self._width(self._probed)
        for one, wanted in zip(self.recorders, self._wanted, strict=True):
            end = start + self._width(wanted.nodes)
            nodes, start = _by_component(engine.seen[:, start:end], engine.components), end
            blocks = []
            for block in wanted.blocks:
                last = row + engine.components * len(block.first)
                blocks.append(_by_component(engine.heard[:, row:last], engine.components))
                row = last
            one.add(step, Heard(nodes, tuple(blocks)))

    def probed(self) -> np.ndarray:
        """What the nodes of the probes had after each of the last steps; shape (steps, nodes), of vectors (steps,
        nodes, components).
        """
        near, engine = self._near, self._grid.engine
        values = engine.seen[:, : self._width(self._probed)] + near.background
        found = _by_component(values, engine.components)
        if near.hidden is not None:
            found[:, near.hidden.ravel()[self._probed]] = np.nan
        return np.asarray(found[..., 0] if engine.components == 1 else found)

    @property
    def notes(self) -> list[str]:
        """What the recorders have to say."""
        return [note for one in self.recorders for note in one.notes]

    @property
    def doubts(self) -> list[str]:
        """Why what they record may be false."""
        return [text for one in self.recorders for text in one.doubts]

    def state(self) -> Arrays:
        """That of all recorders, by their names."""
        return {f"recorder/{one.name}/{name}": array for one in self.recorders for name, array in one.state().items()}

    def take(self, arrays: Arrays, step: int) -> None:
        """Be in a state that `state` gave; recorders that are not in it begin now.

        Raises
        ------
        FileFormatError
            What was recorded under a name does not fit.
        """
        for one, wanted in zip(self.recorders, self._wanted, strict=True):
            head = f"recorder/{one.name}/"
            theirs = {name.removeprefix(head): array for name, array in arrays.items() if name.startswith(head)}
            if not theirs:
                one.start(step, self._now(wanted))
                continue
            mine = one.state()
            alike = mine.keys() == theirs.keys() and all(mine[n].shape[1:] == a.shape[1:] for n, a in theirs.items())
            if not alike:
                raise FileFormatError(
                    "the checkpoint belongs to a run that recorded something else under this name",
                    value=one.name,
                    remedy="give the recorders of the run that wrote it, or another name",
                )
            one.take(theirs)


def _by_component(values: np.ndarray, components: int) -> np.ndarray:
    """Rows of all nodes, component by component, as (steps, nodes, components)."""
    return values.reshape(len(values), components, -1).swapaxes(1, 2)

"""Tuned dampers: part of the mass of a layer's nodes hangs on damped springs.

A wave whose group velocity points against its phase velocity grows in a layer. All such waves of a medium lie in a band
of frequencies near the largest one, far above those of waves that the lattice resolves. So each node of the layer
carries a mass on a spring that is tuned to this band: it removes energy there, at every node separately, and leaves
slower waves alone, however steeply they decay in the layer. (Den Hartog's dynamic vibration absorber, Mechanical
Vibrations, 1956, chapter 3.)

With a the change that the forces make in a node's increment, the hanging mass and the node follow

    q <- keep q - pull p + a,   p <- p + q,   increment += a + strength (q - q of the step before),

so that the forces act through the factor ``1 + strength g`` at a frequency whose factor over a step is z, with

    g = (1 - 1/z)^2 / (1 - (1 + keep - pull)/z + keep/z^2).

Its imaginary part is positive at every frequency and every time step: dampers remove energy and never add any. Waves
much slower than the springs see the unchanged mass, to second order in their frequency. The fastest see a smaller one,
which shortens the largest stable step.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from farhorizon.engine.codegen.vector_operations import advance_masses, fetch
from farhorizon.engine.feature import CHANGE, Feature, Step
from farhorizon.engine.layout import SLACK, Layout
from farhorizon.engine.passes import reads
from farhorizon.engine.threads import barrier, chunk_of

# limits where a step is too long: of the frequency, relative to the largest one of the scheme, and of the width
_NEAR, _MOST = 0.98, 0.9
_AHEAD = 8  # runs between use and prefetch


class Dampers(NamedTuple):
    """Hanging masses of a run."""

    # Runs of neighbouring nodes along the last axis: place in a level, place of the first strength, place of the first
    # state, number of nodes, and number of their springs; shape (R, 5).
    runs: np.ndarray
    springs: np.ndarray  # `keep` and `pull`, shape (S, 2)
    # Different lines of strengths along the last axis; they go on for `SLACK` values, as the states do.
    strengths: np.ndarray
    # Last increments of the nodes, then p, then q, each component by component. They are of the memory's type, and so
    # halves where layers remember halves: dampers contribute a small part of a force, and the error is that much
    # smaller.
    states: np.ndarray
    apart: int  # distance from one component to the next in `states`


def springs_of(tuned: np.ndarray, dt: float) -> tuple[float, float]:
    """`keep` and `pull` of springs of an angular frequency that remove energy in a band of some width around it."""
    frequency, width = tuned.tolist()
    place = min(frequency * dt / 2, _NEAR)
    # frequencies crowd at the largest one that a step carries: the band is made as wide as it is on the lattice
    damping = min(width * dt / (2 * np.sqrt(1 - place**2)), _MOST)
    keep = (1 - damping) / (1 + damping)
    return keep, 2 * (1 + keep) * place**2


def strengths_of(rates: np.ndarray, keep: float, pull: float, dt: float) -> np.ndarray:
    """Strengths with which waves of the springs' frequency lose their velocity at given rates."""
    square = pull / (2 * (1 + keep))  # of the sine of half their phase advance in a step
    return np.asarray(rates * dt * (1 - keep) * (1 - square) / (4 * square))


def response(factor: np.ndarray, keep: float, pull: float) -> np.ndarray:
    """The response g of waves with given factors over a step."""
    back = 1 / np.asarray(factor)
    return np.asarray((1 - back) ** 2 / (1 - (1 + keep - pull) * back + keep * back**2))


class DamperTables:
    """The dampers of the layers of a box, by (axis, side)."""

    # Places of the states of each layer that has dampers, by its nodes in the box, corners included. Where layers meet,
    # the states of the first axis are in use, and all others share one place, the last.
    slabs: dict[tuple[int, int], np.ndarray]
    used: dict[tuple[int, int], np.ndarray]  # which of these states are in use
    size: int  # number of places of states per component
    start: int  # where they begin in the engine's memory

    def __init__(self, layout: Layout, layers: Mapping[tuple[int, int], Any], dt: float) -> None:
        self.layout, self.start, self.slabs, self.used, self.size = layout, 0, {}, {}, 0
        tuned = {key: layer for key, layer in sorted(layers.items()) if layer.tuned.size}
        springs = [springs_of(layer.tuned, dt) for layer in tuned.values()]
        box, nodes = layout.box, layout.box.nodes
        along, outside = [np.zeros(n) for n in nodes], [np.ones(n, bool) for n in nodes]
        for (axis, side), layer, (keep, pull) in zip(tuned, tuned.values(), springs, strict=True):
            columns = _columns(nodes[axis], side, layer.columns)
            along[axis][columns] += strengths_of(layer.damping, keep, pull, dt)[::side]
            outside[axis][columns] = False
        across, line = np.unique(np.add.outer(along[0], along[1]), return_inverse=True)
        line = line.reshape(nodes[:2]) * nodes[2]
        self._springs, self._strengths = np.array(springs).reshape(-1, 2), np.add.outer(across, along[2]).ravel()
        runs = [np.zeros((0, 5), np.int64)]
        for number, ((axis, side), layer) in enumerate(tuned.items()):
            slab = [_columns(n, side, layer.columns) if a == axis else slice(None) for a, n in enumerate(nodes)]
            free = [outside[a][slab[a]] | (a >= axis) for a in range(3)]
            self.used[axis, side] = used = free[0][:, None, None] & free[1][:, None] & free[2]
            self.slabs[axis, side] = places = np.where(used, self.size - 1 + np.cumsum(used).reshape(used.shape), -1)
            self.size += int(used.sum())
            indices = [np.arange(n)[part] for n, part in zip(nodes, slab, strict=True)]
            parts = [along_axis * step for along_axis, step in zip(indices, box.stride, strict=True)]
            levels = box.origin + np.add.outer(np.add.outer(parts[0], parts[1]), parts[2])
            entries = np.add.outer(line[slab[0], slab[1]], indices[2])
            runs.append(_runs(levels[used], entries[used], places[used], number))
        for places in self.slabs.values():
            places[places < 0] = self.size
        self.size += bool(self.slabs)
        self._runs = np.concatenate(runs)

    def tables(self, memory: np.ndarray, real: np.dtype) -> Dampers:
        """Dampers for the compiled loop, whose states are the memory of an engine from `start` on."""
        states = memory[self.start :][: 3 * self.layout.components * self.size]
        strengths = np.append(self._strengths, np.zeros(SLACK)).astype(real)
        return Dampers(self._runs, self._springs.astype(real), strengths, states, self.size)

    def lines(self) -> Iterator[tuple[str, np.ndarray, tuple[int, ...]]]:
        """Places in the memory by name, see `LayerTables.lines`."""
        for (axis, side), places in self.slabs.items():
            along = np.moveaxis(places, axis, 0)
            states = self.size * np.arange(3 * self.layout.components)[:, None, None, None] + along
            yield f"{axis}{'-+'[side > 0]}", self.start + states, tuple(a for a in range(3) if a != axis)

    def cells(self) -> list[tuple[tuple[int, int], np.ndarray]]:
        """Places of the states in use, for each layer by component, number (those of its nodes outwards, three times),
        and line.
        """
        cells = []
        for (axis, side), places in self.slabs.items():
            along, used = (np.moveaxis(array, axis, 0)[::side] for array in (places, self.used[axis, side]))
            lines = along.reshape(len(along), -1)[:, used.reshape(len(used), -1).all(0)]
            each = self.size * np.arange(3 * self.layout.components).reshape(3, -1)
            by_component = each.T[:, :, None, None] + lines
            cells.append(((axis, side), self.start + by_component.reshape(self.layout.components, -1, lines.shape[1])))
        return cells


def _columns(nodes: int, side: int, columns: int) -> slice:
    """Nodes of a layer along its normal."""
    return slice(columns) if side < 0 else slice(nodes - columns, None)


def _runs(nodes: np.ndarray, entries: np.ndarray, places: np.ndarray, number: int) -> np.ndarray:
    """Runs in which nodes, entries and places all increase by one, as `Dampers.runs`."""
    rows = np.array([nodes, entries, places])
    first = np.flatnonzero((np.diff(rows, prepend=rows[:, :1] - 2) != 1).any(0))
    counts = np.diff(first, append=rows.shape[1])
    return np.vstack([rows[:, first], counts, np.full_like(counts, number)]).T.copy()


@reads("dampers")
def advance_hanging_masses(thread, stage, sums, tables, inputs, step, number):
    """Move the hanging masses and let them pull their nodes; one thread's chunk."""
    dampers = tables.dampers
    runs, springs, size = dampers.runs, dampers.springs, stage.out.itemsize
    apart, each = stage.src.size // stage.components, dampers.apart
    later = stage.components * each * dampers.states.itemsize
    out, src, base = stage.out.ctypes.data, stage.src.ctypes.data, stage.base.ctypes.data
    states, strengths, cell = dampers.states.ctypes.data, dampers.strengths.ctypes.data, dampers.states.itemsize
    source_part = stage.out.dtype.type(0 if stage.increments else 1)
    chunk = chunk_of(thread, runs.shape[0])
    for i in range(chunk[0], chunk[1]):
        node, strength, state, count, number = runs[i, 0], runs[i, 1], runs[i, 2], runs[i, 3], runs[i, 4]
        # in layers along the last axis runs are short, and too far apart for the hardware prefetcher
        ahead = runs[min(i + _AHEAD, runs.shape[0] - 1), 0] * size
        fetch(out + ahead)
        fetch(src + ahead)
        for c in range(stage.components):
            level, last = (c * apart + node) * size, states + (c * each + state) * cell
            before = base if stage.increments else out
            advance_masses(
                (last, last + later, last + 2 * later),
                (before + level, src + level, base + level if stage.increments else 0, out + level),
                strengths + strength * size,
                springs[number, 0],
                springs[number, 1],
                source_part,
                count,
                dampers.states[0],
            )
    barrier(thread)


DAMPERS = Feature(
    "dampers",
    [Step(CHANGE, advance_hanging_masses, lambda tables, *_: tables.dampers.runs.size, whole=True)],
    table=Dampers,
    made=lambda engine: engine.dampers.tables(engine.memory, engine.dtype),
)

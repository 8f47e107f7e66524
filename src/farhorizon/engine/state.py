"""Complete state of an engine as one vector: the contents of a checkpoint without work space, halos and padding."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from farhorizon.engine.engine import Engine


class State:
    """Reads and writes the state of an engine, with all inputs (sources, prescribed values, a fixed halo) equal to
    zero.

    Parameters
    ----------
    engine : Engine
        Its exact ends must be sums of exponentials: the past of a convolution is not a finite state.

    Attributes
    ----------
    size : int
        Number of entries of a state: all existing nodes of the time levels that a step reads, the memory of the layers,
        the modes of exact ends, and the earlier values that conditions along an outline read.
    every : int
        Number of steps between filters of short waves in the layers; only the map of that many steps is always the
        same.
    """

    def __init__(self, engine: Engine) -> None:
        self.engine, self.every = engine, engine.tables.filter.every
        nodes = engine.layout.box.node_indices().ravel()
        self._nodes = engine.all_components(nodes[engine.absent.exists[nodes]])
        self._memory = np.concatenate(
            [np.zeros(0, np.int64), *(cells.ravel() for _, _, cells, _ in engine.layer_memory)]
        )
        gain = engine.tables.stretches.gain
        if engine.passes is not None:  # memory of the components and axes that are stretched
            kept = np.flatnonzero(np.tile(gain != 0, (2 * len(gain), 1)))
            self._memory = np.concatenate([self._memory, engine.passes.start + kept])
        poles = engine.ends.poles
        self._modes = np.nonzero(np.concatenate([poles.any(1)] * 2, axis=1))
        self.size = len(self.read())

    def _levels(self, phase: int) -> list[int]:
        """Levels that a step reads before it writes them: that of the field, and for second order also the previous
        level or the increment.
        """
        stages, read, written = self.engine.stages, [], set()
        for (source, base, out), (_, b, _, _) in zip(stages.rotation[phase], stages.numbers, strict=True):
            read += [level for level in (source, base) if level not in written and (level == source or b != 0)]
            written.add(out)
        return list(dict.fromkeys(read))

    def write(self, values: np.ndarray) -> None:
        """Set the engine to a state."""
        engine, count, levels = self.engine, len(self._nodes), self._levels(0)
        engine.levels[...], engine.memory[...], engine.ends.states[...], engine.outline_history[...] = 0, 0, 0, 0
        engine.phase, engine.steps_done = 0, 0
        engine.ends.clock[0] = 1  # not the first step, whose sample counts half at exact ends
        for i, level in enumerate(levels):
            engine.levels[level, self._nodes] = values[i * count : (i + 1) * count]
            engine.complete(engine.levels[level])  # a step fills only the halo of the present level
        end = len(levels) * count
        engine.memory[self._memory] = values[end : end + len(self._memory)]
        start, end = end + len(self._memory), end + len(self._memory) + len(self._modes[0])
        engine.ends.states[self._modes] = values[start:end]
        # a step drops the last row
        engine.outline_history[:-1] = values[end:].reshape(engine.outline_history[:-1].shape)

    def read(self) -> np.ndarray:
        """Return the present state of the engine."""
        engine = self.engine
        levels = [engine.levels[level, self._nodes] for level in self._levels(engine.phase)]
        return np.concatenate(
            [*levels, engine.memory[self._memory], engine.ends.states[self._modes], engine.outline_history[:-1].ravel()]
        )

    def after(self, values: np.ndarray, steps: int = 1) -> np.ndarray:
        """State after a number of steps, shape (size,), from a state at the beginning of a round of `every` steps; real
        and imaginary parts of a complex state are advanced separately.
        """
        if np.iscomplexobj(values):
            return self.after(values.real, steps) + 1j * self.after(values.imag, steps)
        self.write(values)
        self.engine.advance_alone(steps)
        return self.read()

    def after_rounds(self, values: np.ndarray, rounds: int = 1) -> np.ndarray:
        """State after a number of whole rounds of `every` steps."""
        return self.after(values, rounds * self.every)

    def field(self, values: np.ndarray) -> np.ndarray:
        """Field of a state on the core, with the shape of the core, after the components if there are several; complex
        if the state is.
        """
        level = np.zeros(self.engine.levels.shape[1], values.dtype)
        level[self._nodes] = values[: len(self._nodes)]
        return self.engine.core.view(level).copy()

    def portrait(self, values: np.ndarray) -> np.ndarray:
        """Field of a state for a picture, with the shape of the core: for vectors the component with the largest
        value.
        """
        found = self.field(values)
        return (
            found if self.engine.components == 1 else found[np.unravel_index(np.argmax(np.abs(found)), found.shape)[0]]
        )

    def rows(self) -> Rows:
        """Entries of the state by (entry of a row along the normal, row), for an engine whose layers all lie on its
        first axis.

        The rows are translations along the other axes, the last axis fastest.
        """
        axis = next(a for a in range(3) if self.engine.layout.reach[a])
        layout, components = self.engine.layout, self.engine.components
        low, inside, high = layout.low[axis], layout.core[axis], layout.high[axis]
        columns = (
            [(-1, low - 1 - i, low) for i in range(low)]
            + [(0, i, inside) for i in range(inside)]
            + [(1, i, high) for i in range(high)]
        )
        place, names, start = [], [], 0
        for level, c in itertools.product(range(len(self._levels(0))), range(components)):
            count = int(np.prod(layout.box.nodes))
            place.append(
                np.moveaxis(np.arange(start, start + count).reshape(layout.box.nodes), axis, 0).reshape(
                    len(columns), -1
                )
            )
            names += [(level, c, *column) for column in columns]  # nodes of a layer are counted outwards
            start += count
        # the first component is the one along the normal
        turned = {(level, 0): -1 for level in range(len(self._levels(0))) if components > 1}
        for which, (normal, side), cells, alike in self.engine.layer_memory:
            for c, found in enumerate(cells):
                place.append(np.arange(start, start + found.size).reshape(found.shape))
                names += [(-1 - which, c, side, p, len(found)) for p in range(len(found))]
                turned[-1 - which, c] = 1 - 2 * alike[c][normal]
                start += found.size
        number = {name: i for i, name in enumerate(names)}
        images = [number.get((level, c, -side, p if side else n - 1 - p, n)) for level, c, side, p, n in names]
        signs = np.array([turned.get((level, c), 1) for level, c, *_ in names])
        kinds = sorted({(level, c, n) for level, c, side, _, n in names if side == 0})
        near = np.array([[number[level, c, 0, p, n] for p in range(n)] for level, c, n in kinds])
        layers = {}
        for side, n in {side: n for level, _, side, _, n in names if level == 0 and side}.items():
            levels = range(len(self._levels(0)))
            layers[side] = np.array(
                [[[number[level, c, side, p, n] for p in range(n)] for c in range(components)] for level in levels]
            )
        return Rows(np.concatenate(place), None if None in images else np.array(images), signs, near, layers)


@dataclass(frozen=True)
class Rows:
    """State arranged by rows along the normal of the layers.

    Attributes
    ----------
    place : ndarray of int, shape (entries, rows)
        Position in the state of the entries of each row.
    images : ndarray of int, shape (entries,), or None
        Mirror image of each entry with respect to the middle between the sides; None if the sides differ.
    signs : ndarray of int, shape (entries,)
        Factor of an entry under this mirroring: -1 for the component along the normal, else 1.
    near : ndarray of int, shape (levels * components, nodes)
        Entries of the nodes of the core.
    layers : mapping of int to ndarray of int, shape (levels, components, columns)
        Entries of the nodes of the low (-1) and the high layer (1), outwards.
    """

    place: np.ndarray
    images: np.ndarray | None
    signs: np.ndarray
    near: np.ndarray
    layers: Mapping[int, np.ndarray]


def digest(engine: Engine) -> str:
    """Hash of everything that determines the map of a step: engines with equal digests have the same map."""
    rule = engine.tables.material.rule
    mark = hashlib.sha256(
        repr(
            (
                engine.dt,
                engine.stages,
                engine.reaction,
                engine.core.nodes,
                sorted(engine.layout.periodic),
                rule,
                engine.dtype.name,
                engine.kept.name,
            )
        ).encode()
    )
    layers = [
        a
        for _, layer in sorted(engine.layers.items())
        for a in (layer.kappa, layer.sigma, layer.alpha, layer.damping, layer.taps, layer.tuned)
    ]
    mark.update(
        repr(
            [(name, layer.columns, layer.whole, layer.every) for name, layer in sorted(engine.layers.items())]
        ).encode()
    )
    tables = engine.tables
    law = tables.gradient_pass.sweep.law
    none = np.zeros(0)
    ends, outline_stencil = tables.ends, tables.outline_stencil._replace(history=none)
    for array in (
        engine.offsets,
        engine.weights,
        *layers,
        tables.material.coefficient,
        *tables.cuts,
        *tables.surface[:-1],
        *(law.intact, law.nodes, law.numbers, law.matrices, law.local),
        *tables.stretches._replace(memory=none, room=none),
        *tables.drag._replace(lost=none, room=none, moved=none, beyond=none),
        tables.mobility,
        *tables.gradient_pass.surface[:-1],
        *tables.divergence_pass.surface[:-1],
        *tables.divergence_pass.cuts,
        *tables.damping,
        *tables.dependents,
        engine.held,
        *(ends.nodes, ends.poles, ends.inputs, ends.outputs),
        *outline_stencil,
    ):
        mark.update(np.ascontiguousarray(array).tobytes())
    return mark.hexdigest()


@contextmanager
def as_before(engine: Engine) -> Iterator[None]:
    """Restore the state of an engine when the context ends."""
    tables = engine.tables
    ends, phases = tables.ends, tables.phases
    arrays = [
        engine.levels,
        engine.memory,
        *(ends.states, ends.forces, ends.clock),
        tables.flows.totals,
        tables.drag.lost,
        tables.outline_stencil.history,
        tables.material.coefficient,
        *(phases.runs, phases.solids, phases.volumes, phases.changed, phases.dissolved, phases.total),
        *engine.bonds.state.values(),
    ]
    kept, phase, steps = [a.copy() for a in arrays], engine.phase, engine.steps_done
    try:
        yield
    finally:
        for array, values in zip(arrays, kept, strict=True):
            array[...] = values
        # lanes without nodes take what is left there, which may be infinite
        tables.work_space[...] = 0
        engine.phase, engine.steps_done = phase, steps

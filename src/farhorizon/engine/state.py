"""State of an engine: as one vector, without work space, halos and padding (`State`), and by the nodes of its box
(`pieces_of`), which does not depend on the layout in memory, so that the state of one box can be assembled from those
of others.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from farhorizon.engine.engine import Engine
from farhorizon.engine.feature_list import with_tables

Box = Sequence[tuple[int, int]]  # first node and last + 1 along the three axes


class State:
    """Reads and writes the state of an engine as one vector, with all inputs (sources, prescribed values, a fixed halo)
    equal to zero: all existing nodes of the time levels that a step reads, the memory of the layers, the modes of exact
    ends, and the earlier values that conditions along an outline read. Exact ends must be sums of exponentials: the
    past of a convolution is not a finite state.
    """

    size: int  # number of entries
    size_of_field: int  # number of the first of them, which are the field
    every: int  # steps between filters of short waves in the layers; only the map of that many is always the same

    def __init__(self, engine: Engine) -> None:
        self.engine, self.every = engine, engine.every
        nodes = engine.layout.box.node_indices().ravel()
        self._nodes = engine.all_components(nodes[engine.absent.exists[nodes]])
        self._memory = np.concatenate(
            [np.zeros(0, np.int64), *(cells.ravel() for _, _, cells, _ in engine.layer_memory)]
        )
        gain = engine.tables.stretches.gain
        if engine.passes is not None:  # memory of the components and axes that are stretched
            kept = np.flatnonzero(np.tile(gain != 0, (2 * len(gain), 1)))
            self._memory = np.concatenate([self._memory, engine.passes.start + kept])
        poles = engine.tables.ends.poles
        self._modes = np.nonzero(np.concatenate([poles.any(1)] * 2, axis=1))
        self.size, self.size_of_field = len(self.read()), len(self._nodes)

    def _levels(self, phase: int) -> list[int]:
        """Levels that a step reads before it writes them, and those of the memory of relaxation."""
        return [*self._of_times(phase), *range(self.engine.stages.levels, len(self.engine.levels))]

    def _of_times(self, phase: int) -> list[int]:
        """The first of these: that of the field, and for second order also the previous level or the increment."""
        stages, read, written = self.engine.stages, [], set()
        for (source, base, out), (_, b, _, _) in zip(stages.rotation[phase], stages.numbers, strict=True):
            read += [level for level in (source, base) if level not in written and (level == source or b != 0)]
            written.add(out)
        return list(dict.fromkeys(read))

    def write(self, values: np.ndarray) -> None:
        """Set the engine to a state."""
        engine, count, levels = self.engine, len(self._nodes), self._levels(0)
        history = engine.tables.outline_stencil.history.T
        engine.levels[...], engine.memory[...], engine.tables.ends.states[...], history[...] = 0, 0, 0, 0
        engine.phase, engine.steps_done = 0, 0
        engine.tables.ends.clock[0] = 1  # not the first step, whose sample counts half at exact ends
        for i, level in enumerate(levels):
            engine.levels[level, self._nodes] = values[i * count : (i + 1) * count]
            engine.complete(engine.levels[level])  # a step fills only the halo of the present level
        end = len(levels) * count
        engine.memory[self._memory] = values[end : end + len(self._memory)]
        start, end = end + len(self._memory), end + len(self._memory) + len(self._modes[0])
        engine.tables.ends.states[self._modes] = values[start:end]
        # a step drops the last row
        history[:-1] = values[end:].reshape(history[:-1].shape)

    def read(self) -> np.ndarray:
        """Return the present state of the engine."""
        engine, history = self.engine, self.engine.tables.outline_stencil.history.T
        levels = [engine.levels[level, self._nodes] for level in self._levels(engine.phase)]
        return np.concatenate(
            [*levels, engine.memory[self._memory], engine.tables.ends.states[self._modes], history[:-1].ravel()]
        )

    def after(self, values: np.ndarray, steps: int = 1) -> np.ndarray:
        """State after a number of steps, shape (size,), from a state at the beginning of a round of `every` steps; real
        and imaginary parts of a complex state are advanced separately.
        """
        if np.iscomplexobj(values):
            return self.after(values.real, steps) + 1j * self.after(values.imag, steps)
        self.write(values)
        self.engine.advance(steps)
        return self.read()

    def after_rounds(self, values: np.ndarray, rounds: int = 1) -> np.ndarray:
        """State after a number of whole rounds of `every` steps."""
        return self.after(values, rounds * self.every)

    def at_rest(self, field: np.ndarray) -> np.ndarray:
        """State with the values `field` at all existing nodes, shape (`size_of_field`,), at rest, and with nothing in
        the memory of the layers.
        """
        values = np.zeros(self.size)
        levels = len(self._of_times(0)) if not self.engine.stages.increments else 1
        values[: levels * len(field)] = np.tile(field, levels)
        return values

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
        field = self.field(values)
        return (
            field if self.engine.components == 1 else field[np.unravel_index(np.argmax(np.abs(field)), field.shape)[0]]
        )

    def rows(self) -> Rows:
        """Entries of the state by (entry of a row along the normal, row), for an engine whose layers all lie on its
        first axis. The rows are translations along the other axes, the last axis fastest.
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
        mirrored = {(level, 0): -1 for level in range(len(self._levels(0))) if components > 1}
        for which, (normal, side), cells, signs_of_cells in self.engine.layer_memory:
            for c, of_component in enumerate(cells):
                place.append(np.arange(start, start + of_component.size).reshape(of_component.shape))
                names += [(-1 - which, c, side, p, len(of_component)) for p in range(len(of_component))]
                mirrored[-1 - which, c] = 1 - 2 * signs_of_cells[c][normal]
                start += of_component.size
        number = {name: i for i, name in enumerate(names)}
        images = [number.get((level, c, -side, p if side else n - 1 - p, n)) for level, c, side, p, n in names]
        signs = np.array([mirrored.get((level, c), 1) for level, c, *_ in names])
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
    """State arranged by rows along the normal of the layers."""

    place: np.ndarray  # position in the state of the entries of each row, shape (entries, rows)
    images: np.ndarray | None  # mirror image of each entry in the middle between the sides; None if the sides differ
    signs: np.ndarray  # factor of an entry under this mirroring: -1 for the component along the normal, else 1
    near: np.ndarray  # entries of the nodes of the core, shape (levels * components, nodes)
    # entries of the nodes of the low (-1) and the high layer (1), outwards, shape (levels, components, columns)
    layers: Mapping[int, np.ndarray]


def digest(engine: Engine) -> str:
    """Hash of everything that determines the map of a step: engines with equal digests have the same map."""
    layers = sorted(engine.layers.items())
    settings = (
        *(engine.dt, engine.stages, engine.reaction, engine.core.nodes, sorted(engine.layout.periodic)),
        *(engine.tables.material.rule, engine.dtype.name, engine.kept.name),
    )
    mark = hashlib.sha256(repr(settings).encode())
    mark.update(repr([(name, layer.columns, layer.whole, layer.every) for name, layer in layers]).encode())
    tables = engine.tables
    law = tables.gradient_pass.sweep.law
    none = np.zeros(0)
    for array in (
        engine.offsets,
        engine.weights,
        *(
            array
            for _, layer in layers
            for array in (layer.kappa, layer.sigma, layer.alpha, layer.damping, layer.taps, layer.tuned)
        ),
        tables.material.coefficient,
        tables.bonds.excess,
        *tables.cuts,
        *(array for feature, table in with_tables(tables) for array in feature.map(table)),
        *tables.surface[:-1],
        *(law.intact, law.nodes, law.numbers, law.matrices, law.local),
        *tables.stretches._replace(memory=none, room=none),
        *tables.gradient_pass.surface[:-1],
        *tables.divergence_pass.surface[:-1],
        *tables.divergence_pass.cuts,
        engine.held,
    ):
        mark.update(np.ascontiguousarray(array).tobytes())
    return mark.hexdigest()


@contextmanager
def as_before(engine: Engine) -> Iterator[None]:
    """Restore the state of an engine when the context ends."""
    tables = engine.tables
    arrays = [
        engine.levels,
        engine.memory,
        tables.material.coefficient,
        *engine.bonds.state.values(),
        *(array for feature, table in with_tables(tables) for array in feature.state(table).values()),
    ]
    copies, phase, steps = [a.copy() for a in arrays], engine.phase, engine.steps_done
    try:
        yield
    finally:
        for array, values in zip(arrays, copies, strict=True):
            array[...] = values
        # lanes without nodes take what is left there, which may be infinite
        tables.work_space[...] = 0
        engine.phase, engine.steps_done = phase, steps


class Piece(NamedTuple):
    """Some values of a state by nodes."""

    array: np.ndarray  # level or memory that contains them
    places: np.ndarray  # index of each value in it; the last axes are some of those of the box
    axes: tuple[int, ...]  # axes of the box that these are


def pieces_of(engine: Engine, more: Mapping[str, np.ndarray] | None = None) -> dict[str, Piece]:
    """Return all pieces of a state by name: of each level, of further ones that have their form, and of each pass and
    layer.
    """
    nodes, axes = engine.layout.box.node_indices(), (0, 1, 2)
    components = np.stack([nodes + c * engine.layout.size for c in range(engine.components)])
    levels = {f"level/{k}": level for k, level in enumerate(engine.levels)} | dict(more or {})
    pieces = {name: Piece(level, components, axes) for name, level in levels.items()}
    pieces |= {name: Piece(engine.memory, places, across) for name, places, across in engine.remembered()}
    bonds = engine.bonds.table
    pieces |= {f"bonds/{word}": Piece(bits, nodes, axes) for word, bits in enumerate(bonds.alive)}
    pieces |= {f"shares/{bond}": Piece(left, nodes, axes) for bond, left in enumerate(bonds.residual_stiffness)}
    pieces |= {f"history/{line}": Piece(values, nodes, axes) for line, values in enumerate(bonds.history)}
    for feature, table in with_tables(engine.tables):
        pieces |= {name: Piece(values, nodes, axes) for name, values in feature.nodal(table).items() if values.size}
    return pieces


def values_of(engine: Engine, more: Mapping[str, np.ndarray] | None = None) -> dict[str, np.ndarray]:
    """Return copies of the values of all pieces by name; `more` as in `pieces_of`."""
    return {name: piece.array[piece.places] for name, piece in pieces_of(engine, more).items()}


def sums_of(engine: Engine) -> dict[str, float]:
    """Return accumulated quantities by name: energy and number of broken bonds, work of the sources, losses by drag,
    and the flow into each account; in units of the update.
    """
    return {
        f"{name}/{i}": float(parts.sum())
        for name, sums in parts_of_sums(engine).items()
        for i, parts in enumerate(sums)
    }


def take_sums(engine: Engine, given: Mapping[str, float]) -> None:
    """Continue to accumulate from the result of `sums_of`."""
    for name, sums in parts_of_sums(engine).items():
        for i, parts in enumerate(sums):
            parts[...] = 0
            parts.flat[0] = given[f"{name}/{i}"]


def parts_of_sums(engine: Engine) -> dict[str, np.ndarray]:
    """Return the arrays, by places or threads, whose sums `sums_of` returns, by name; the first axis is that of the
    sums. They share memory.
    """
    tables = engine.tables
    accumulated = {"broken": np.moveaxis(tables.bonds.broken, -1, 0)}
    for feature, table in with_tables(tables):
        accumulated |= feature.sums(table)
    return {name: sums for name, sums in accumulated.items() if sums.size}


def of_the_run(engine: Engine) -> dict[str, np.ndarray]:
    """Return the state that belongs to the run, and not to its nodes, by name; the arrays share memory."""
    state = {"stretches": engine.tables.stretches.memory}
    for feature, table in with_tables(engine.tables):
        state |= feature.other(table)
    return {name: values for name, values in state.items() if values.size}


def common(box: Box, other: Box, axes: Sequence[int]) -> tuple[tuple[slice, ...], tuple[slice, ...]] | None:
    """Return the intersection of two boxes along some axes, counted in each of them; None if it is empty."""
    pairs = [(max(box[a][0], other[a][0]), min(box[a][1], other[a][1]), a) for a in axes]
    if any(first >= end for first, end, _ in pairs):
        return None
    in_box, in_other = (
        tuple(slice(first - within[a][0], end - within[a][0]) for first, end, a in pairs) for within in (box, other)
    )
    return in_box, in_other


class Assembly:
    """Assembles the state of an engine from those of boxes that cover its own; `more` as in `pieces_of`."""

    def __init__(self, engine: Engine, box: Box, more: Mapping[str, np.ndarray] | None = None) -> None:
        self._engine, self._pieces, self._box = engine, pieces_of(engine, more), box
        self._values = {name: piece.array[piece.places] for name, piece in self._pieces.items()}
        self._lacks = {
            name: np.ones(piece.places.shape[-len(piece.axes) :], bool) for name, piece in self._pieces.items()
        }

    def add(self, box: Box, arrays: Mapping[str, np.ndarray]) -> bool:
        """Take over what a box has in common with this one; return whether its layers have the same form."""
        for name, piece in self._pieces.items():
            shared = common(self._box, box, piece.axes)
            if name not in arrays or shared is None:
                continue
            (inside, source), values = shared, arrays[name]
            front = values.ndim - len(piece.axes)
            if values.shape[:front] != piece.places.shape[: -len(piece.axes)]:
                return False
            to: tuple[Any, ...] = (..., *inside)
            of: tuple[Any, ...] = (..., *source)
            self._values[name][to] = values[of]
            self._lacks[name][inside] = False
        return True

    def put(self) -> bool:
        """Write the state to the engine if it is complete; return whether it is."""
        if any(lacking.any() for lacking in self._lacks.values()):
            return False
        bonds = self._engine.bonds
        alive = bonds.table.alive.copy()
        # what belongs to no node may be left from a field that was not finite; it is multiplied by zero at most
        self._engine.memory[...] = self._engine.tables.work_space[...] = 0
        for name, piece in self._pieces.items():
            piece.array[piece.places] = self._values[name]
        if bonds:
            bonds.break_since(alive)
        return True

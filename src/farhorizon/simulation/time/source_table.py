"""Supply of the engine with sources, conditions and prescribed values as time advances."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from farhorizon.engine.features.dependents import set_dependent_values, set_dependents
from farhorizon.errors import InputError
from farhorizon.inputs.sources import at_times, steady
from farhorizon.simulation.heat.solid_and_liquid import SolidAndLiquid
from farhorizon.simulation.setup.grid import Grid
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.time.impacts import RigidShapes
from farhorizon.simulation.time.source_terms import SourceTerm

_TABLE = 1 << 20  # numbers in one table of source amplitudes
_LARGEST_POWER = 700.0  # of e that is a finite number


@dataclass(frozen=True)
class Batch:
    """Steps that the engine has made, and the action of the sources in them."""

    steps: int
    places: np.ndarray  # of int, shape (n,); flat indices in the field at which sources act
    fields: np.ndarray  # shape (j, n)
    amplitudes: np.ndarray  # shape (steps, stages, j)


class Path(NamedTuple):
    """What drives a run at a step and at the next one, between which it moves in a straight line."""

    held: np.ndarray  # prescribed values, shape (2, H)
    places: np.ndarray  # of int; as in `Batch`, and so are the fields
    fields: np.ndarray
    amplitudes: np.ndarray  # shape (2, stages, j)


class SourceTable:
    """The source terms of a run: sources, loads, conditions and incident waves. No source may act on the metal of
    `phases`.
    """

    def __init__(
        self,
        near: NearField,
        grid: Grid,
        source_terms: Sequence[SourceTerm],
        phases: SolidAndLiquid | None,
        scale: float,
        shapes: RigidShapes | None = None,
    ) -> None:
        self.near, self.grid, self.source_terms, self.phases = near, grid, list(source_terms), phases
        self.shapes = shapes
        self.scale = scale  # largest value that the initial data and all that has driven the run so far explain
        self._nodes = grid.indices if self.source_terms else np.zeros(0, np.int64)
        self._lasting: tuple[np.ndarray, np.ndarray] | None = None  # result of `_strengths` if it never changes

    def prescribe(self) -> None:
        """Give the engine the nodes that conditions prescribe, with their values at the start."""
        engine, table, near = self.grid.engine, self.near.conditions, self.grid.indices
        set_dependents(engine, near[table.nodes], table.starts, near[table.references], table.weights)
        if table.nodes.size:
            fields = _rows(self._fields(table.source_terms, table.nodes.shape, 0, (0.0,)), np.arange(table.nodes.size))
            amplitudes = self._amplitudes(table.source_terms, 0, (0.0,), np.ones((1, 1)), 1)
            self.scale = max(self.scale, _largest(fields, amplitudes))
            set_dependent_values(engine, amplitudes[0, 0] @ fields)

    def hold(self, step: int) -> None:
        """Tell the engine which nodes follow a prescribed value from a step on."""
        self.grid.engine.hold(self.grid.indices[self.near.prescribed.held(step)])

    def force(self, t: float) -> np.ndarray:
        """Return the action of the sources at a time, in the shape of the field."""
        total = np.zeros(self.near.field_shape)
        for space, time in self.source_terms:
            total += time(t) if space is None else space * time(t)
        return total * self.near.model.source_factor

    def advance(self, step: int, steps: int) -> Iterator[Batch]:
        """Advance the engine by `steps` steps from number `step` on; yields each batch of them once it is computed."""
        near, engine = self.near, self.grid.engine
        dtype, stages, held = engine.dtype, len(engine.stages.numbers), near.conditions
        if not self.source_terms and not held.nodes.size:
            engine.advance(steps, held_values=self._prescribed(step, steps), impactor_paths=self._paths(step, steps))
            self._grow(steps)
            nothing, still = np.zeros((0, 0), dtype), np.zeros((steps, stages, 0), dtype)
            yield Batch(steps, np.zeros(0, np.int64), nothing, still)
            return
        integrator = near.model.integrator
        samples, weights = integrator.source_samples(near.dt)
        prescribed_samples, held_weights = integrator.prescribed_samples(near.dt)
        weights = weights * near.model.source_factor
        general = any(space is None for space, _ in self.source_terms + held.source_terms)
        count = len(self.source_terms + held.source_terms)
        all_held = np.arange(held.nodes.size)
        batch = 1 if general else max(1, min(steps, _TABLE // max(stages * count, 1)))
        end = step + steps
        while step < end:
            n = min(batch, end - step)
            places, strength = self._strengths(step, samples)
            amplitudes = self._amplitudes(self.source_terms, step, samples, weights, n)
            if general and self.phases is not None:
                busy = np.zeros(near.lattice.shape, bool)
                busy.ravel()[places] = True
                self.phases.refuse_wet(busy)
            values = _rows(self._fields(held.source_terms, held.nodes.shape, step, prescribed_samples), all_held)
            times = self._amplitudes(held.source_terms, step, prescribed_samples, held_weights, n)
            engine.advance(
                n,
                self._nodes[places],
                strength.astype(dtype),
                amplitudes.astype(dtype),
                self._prescribed(step, n),
                values.astype(dtype),
                times.astype(dtype),
                self._paths(step, n),
            )
            explained = _largest(strength, amplitudes) * n * near.dt
            self.scale += explained * ((step + n) * near.dt if near.model.order == 2 else 1.0)
            self.scale = max(self.scale, _largest(values, times))
            self._grow(n)
            yield Batch(n, places, strength, amplitudes)
            step += n

    def path(self, step: int) -> Path:
        """Return what drives a run from a step to the next one; before the first one nothing acts."""
        near, engine = self.near, self.grid.engine
        held = near.prescribed.table(step, 1)[0]
        places, fields = self._strengths(step, (0.0,))
        weights = np.full((1, 1), near.model.source_factor)
        amplitudes = self._amplitudes(self.source_terms, step, (0.0,), weights, 2)
        if not step:
            amplitudes[0] = 0
        reached = _largest(fields, amplitudes) * near.slow_crossing**2  # by a bar as long as the body
        self.scale = max(self.scale, reached, float(np.abs(held).max(initial=0)))
        return Path(np.stack([engine.get("u", engine.held).astype(float), held]), places, fields, amplitudes)

    def follow(self, path: Path, way: np.ndarray) -> None:
        """Advance the engine by a step at each of some positions on a path, 0 at its start and 1 at its end."""
        held, amplitudes = (
            values[0] + np.multiply.outer(way, values[1] - values[0]) for values in (path.held, path.amplitudes)
        )
        dtype = self.grid.engine.dtype
        engine_inputs = self._nodes[path.places], path.fields.astype(dtype), amplitudes.astype(dtype)
        self.grid.engine.advance(len(way), *engine_inputs, held if held.size else None)

    def _grow(self, steps: int) -> None:
        """Let the scale grow as the medium itself does in some steps."""
        self.scale *= float(np.exp(min(self.near.growth * steps * self.near.dt, _LARGEST_POWER)))

    def _prescribed(self, step: int, steps: int) -> np.ndarray | None:
        """Return the values of prescribed nodes after each of the next steps; None if there are no such nodes."""
        if not self.near.prescribed.constraints:
            return None
        values = self.near.prescribed.table(step, steps)
        self.scale = max(self.scale, float(np.abs(values).max(initial=0)))
        return values

    def _paths(self, step: int, steps: int) -> np.ndarray | None:
        """Return the prescribed displacements of impactors after each of the next steps; None without impactors."""
        if self.shapes is None:
            return None
        paths = self.shapes.paths(step, steps)
        self.scale = max(self.scale, self.shapes.reaches(step, paths))
        return paths

    def _strengths(self, step: int, samples: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
        """Return where in the field sources act in the next steps, shape (n,), and the strength of each there, shape
        (j, n). Sources that split into space and time stay where they are and are evaluated once.
        """
        if self._lasting is not None:
            return self._lasting
        fields = self._fields(self.source_terms, self.near.field_shape, step, samples)
        busy = np.zeros(int(np.prod(self.near.field_shape)), bool)
        for values in fields:
            busy |= values != 0
        places = np.flatnonzero(busy)
        strengths = places, _rows(fields, places)
        if all(space is not None for space, _ in self.source_terms):
            self._lasting = strengths
        return strengths

    def _fields(
        self, source_terms: Sequence[SourceTerm], shape: tuple[int, ...], step: int, samples: Sequence[float]
    ) -> list[np.ndarray]:
        """Return the fields of source terms over nodes: one for each that splits into space and time, otherwise one for
        each sample time of the next step.
        """
        start, fields = self.near.dt * step, []
        for space, time in source_terms:
            if space is None:
                fields += [np.broadcast_to(np.asarray(time(start + s), float), shape).ravel() for s in samples]
            else:
                fields.append(np.asarray(space, float).ravel())
        return fields

    def _amplitudes(
        self, source_terms: Sequence[SourceTerm], step: int, samples: Sequence[float], weights: np.ndarray, count: int
    ) -> np.ndarray:
        """Return the amplitudes of the fields in each stage of `count` steps from one on, shape (count, stages, j)."""
        times = self.near.dt * (step + np.arange(count))
        table: list[np.ndarray] = []
        for space, time in source_terms:
            if space is None:
                table += [np.broadcast_to(weights[:, i], (1, len(weights))) for i in range(len(samples))]
            elif time is steady:
                table.append(np.broadcast_to(weights.sum(1), (count, len(weights))))
            else:
                values = at_times(time, times[:, None] + np.array(samples))
                # a product of matrices may be rounded in another way if a run makes the same steps in other batches
                table.append(sum(values[:, i, None] * weights[:, i] for i in range(len(samples))))
        if not table:
            return np.zeros((count, len(weights), 0))
        amplitudes = np.stack(table, axis=-1)
        wrong = ~np.isfinite(amplitudes).all(axis=(1, 2))
        if wrong.any():
            raise InputError(
                "a source or condition is not finite",
                value=f"t = {times[np.argmax(wrong)]:g}",
                limit="no nan, no inf",
                key="source",
                remedy="where(t < ..., a, b) in an expression restricts it to where it is defined, or an earlier end",
            )
        return amplitudes


def _rows(fields: Sequence[np.ndarray], places: np.ndarray) -> np.ndarray:
    """Return the values of each field at some places, as one table."""
    return np.stack([values[places] for values in fields]) if fields else np.zeros((0, places.size))


def _largest(fields: np.ndarray, amplitudes: np.ndarray) -> float:
    """Return the product of the largest field value and the largest amplitude, an estimate of the largest sum."""
    return float(np.abs(fields).max(initial=0) * np.abs(amplitudes).max(initial=0))

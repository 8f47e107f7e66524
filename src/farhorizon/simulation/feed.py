"""What drives the engine in time: sources, conditions, and nodes that follow a value."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from farhorizon.engine.settings import set_dependents
from farhorizon.errors import InputError
from farhorizon.inputs.sources import steady
from farhorizon.simulation.drives import Drive
from farhorizon.simulation.grid import Grid
from farhorizon.simulation.near_field import NearField
from farhorizon.simulation.solid_and_liquid import SolidAndLiquid
from farhorizon.simulation.team import ALONE, Team

_TABLE = 1 << 20  # numbers in one table of source amplitudes


@dataclass(frozen=True)
class Batch:
    """Steps that the engine has made, and what the sources have done in them.

    Attributes
    ----------
    steps : int
    places : ndarray of int, shape (n,)
        Where in the field sources act.
    fields : ndarray, shape (j, n)
    amplitudes : ndarray, shape (steps, stages, j)
    """

    steps: int
    places: np.ndarray
    fields: np.ndarray
    amplitudes: np.ndarray


class Feed:
    """The drives of a run.

    Parameters
    ----------
    near : NearField
    grid : Grid
    drives : sequence of Drive
        Sources, loads, conditions and incident waves.
    phases : SolidAndLiquid or None
        Metal, which no source acts on.
    scale : float
        What the initial data explain.
    team : Team
        The processes that compute the run.

    Attributes
    ----------
    scale : float
        The largest value that the data and all that has driven the run explain.
    """

    def __init__(
        self,
        near: NearField,
        grid: Grid,
        drives: Sequence[Drive],
        phases: SolidAndLiquid | None,
        scale: float,
        team: Team = ALONE,
    ) -> None:
        self.near, self.grid, self.drives, self.phases, self.scale = near, grid, list(drives), phases, scale
        self._team = team
        self._nodes = grid.indices if self.drives else np.zeros(0, np.int64)
        self._lasting: tuple[np.ndarray, np.ndarray] | None = None  # what `_strengths` finds, where it stays as it is

    def prescribe(self) -> None:
        """Give the engine the nodes that conditions prescribe, with their values at the start."""
        engine, table, near = self.grid.engine, self.near.conditions, self.grid.indices
        set_dependents(engine, near[table.nodes], table.starts, near[table.references], table.weights)
        if table.nodes.size:
            fields = _rows(self._fields(table.drives, table.nodes.shape, 0, (0.0,)), np.arange(table.nodes.size))
            amplitudes = self._amplitudes(table.drives, 0, (0.0,), np.ones((1, 1)), 1)
            self.scale = max(self.scale, _largest(fields, amplitudes))
            engine.set_dependent_values(amplitudes[0, 0] @ fields)

    def hold(self, step: int) -> None:
        """Tell the engine which nodes follow a value from a step on."""
        self.grid.engine.hold(self.grid.indices[self.near.prescribed.held(step)])

    def force(self, t: float) -> np.ndarray:
        """What the sources do at a time, of the field's shape."""
        total = np.zeros(self.near.field_shape)
        for space, time in self.drives:
            total += time(t) if space is None else space * time(t)
        return total * self.near.model.source_factor

    def advance(self, step: int, steps: int) -> Iterator[Batch]:
        """Advance the engine by some steps from one on; after each batch of them the caller has its turn."""
        near, engine = self.near, self.grid.engine
        dtype, stages, held = engine.dtype, len(engine.stages.numbers), near.conditions
        if not self.drives and not held.nodes.size:
            nothing, still = np.zeros((0, 0), dtype), np.zeros((steps, stages, 0), dtype)
            engine.advance(steps, np.zeros(0, np.int64), nothing, still, self._prescribed(step, steps))
            yield Batch(steps, np.zeros(0, np.int64), nothing, still)
            return
        integrator = near.model.integrator
        samples, weights = integrator.source_samples(near.dt)
        prescribed_samples, held_weights = integrator.prescribed_samples(near.dt)
        weights = weights * near.model.source_factor
        general = any(space is None for space, _ in self.drives + held.drives)
        count = len(self.drives + held.drives)
        every = np.arange(held.nodes.size)
        batch = 1 if general else max(1, min(steps, _TABLE // max(stages * count, 1)))
        end = step + steps
        while step < end:
            n = min(batch, end - step)
            places, strength = self._strengths(step, samples)
            amplitudes = self._amplitudes(self.drives, step, samples, weights, n)
            if general and self.phases is not None:
                busy = np.zeros(near.lattice.shape, bool)
                busy.ravel()[places] = True
                with self._team.agreed():
                    self.phases.refuse_wet(busy)
            values = _rows(self._fields(held.drives, held.nodes.shape, step, prescribed_samples), every)
            times = self._amplitudes(held.drives, step, prescribed_samples, held_weights, n)
            engine.advance(
                n,
                self._nodes[places],
                strength.astype(dtype),
                amplitudes.astype(dtype),
                self._prescribed(step, n),
                values.astype(dtype),
                times.astype(dtype),
            )
            explained = _largest(strength, amplitudes) * n * near.dt
            self.scale += explained * ((step + n) * near.dt if near.model.order == 2 else 1.0)
            self.scale = max(self.scale, _largest(values, times))
            yield Batch(n, places, strength, amplitudes)
            step += n

    def _prescribed(self, step: int, steps: int) -> np.ndarray | None:
        """Values of the held nodes after each of the next steps."""
        if not self.near.prescribed.constraints:
            return None
        values = self.near.prescribed.table(step, steps)
        self.scale = max(self.scale, float(np.abs(values).max(initial=0)))
        return values

    def _strengths(self, step: int, samples: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
        """Where in the field sources act in the next steps, shape (n,), and how strongly each does there, shape (j, n).

        Those that split into space and time stay where they are: they are looked through once.
        """
        if self._lasting is not None:
            return self._lasting
        fields = self._fields(self.drives, self.near.field_shape, step, samples)
        busy = np.zeros(int(np.prod(self.near.field_shape)), bool)
        for values in fields:
            busy |= values != 0
        places = np.flatnonzero(busy)
        found = places, _rows(fields, places)
        if all(space is not None for space, _ in self.drives):
            self._lasting = found
        return found

    def _fields(
        self, drives: Sequence[Drive], shape: tuple[int, ...], step: int, samples: Sequence[float]
    ) -> list[np.ndarray]:
        """Fields over nodes. What does not split into space and time has one for each sample time of the next step."""
        start, found = self.near.dt * step, []
        for space, time in drives:
            if space is None:
                found += [np.broadcast_to(np.asarray(time(start + s), float), shape).ravel() for s in samples]
            else:
                found.append(np.asarray(space, float).ravel())
        return found

    def _amplitudes(
        self, drives: Sequence[Drive], step: int, samples: Sequence[float], weights: np.ndarray, count: int
    ) -> np.ndarray:
        """Amplitudes of the fields in each stage of `count` steps from one on, shape (count, stages, j)."""
        times = self.near.dt * (step + np.arange(count))
        table: list[np.ndarray] = []
        for space, time in drives:
            if space is None:
                table += [np.broadcast_to(weights[:, i], (1, len(weights))) for i in range(len(samples))]
            elif time is steady:
                table.append(np.broadcast_to(weights.sum(1), (count, len(weights))))
            else:
                table.append(np.array([[time(t + s) for s in samples] for t in times], float) @ weights.T)
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
    """Some places of each field, as one table."""
    return np.stack([values[places] for values in fields]) if fields else np.zeros((0, places.size))


def _largest(fields: np.ndarray, amplitudes: np.ndarray) -> float:
    """A bound of the sum of fields with amplitudes."""
    return float(np.abs(fields).max(initial=0) * np.abs(amplitudes).max(initial=0))

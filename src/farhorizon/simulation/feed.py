"""What drives the engine in time: sources, conditions, and nodes that follow a value."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from farhorizon.errors import InputError
from farhorizon.inputs.sources import steady
from farhorizon.simulation.drives import Drive
from farhorizon.simulation.grid import Grid
from farhorizon.simulation.near_field import NearField
from farhorizon.simulation.solid_and_liquid import SolidAndLiquid

_TABLE = 1 << 20  # numbers in one table of source amplitudes


@dataclass(frozen=True)
class Batch:
    """Steps that the engine has made, and what the sources have done in them.

    Attributes
    ----------
    steps : int
    fields : ndarray, shape (j, nodes)
    amplitudes : ndarray, shape (steps, stages, j)
    """

    steps: int
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

    Attributes
    ----------
    scale : float
        The largest value that the data and all that has driven the run explain.
    """

    def __init__(
        self, near: NearField, grid: Grid, drives: Sequence[Drive], phases: SolidAndLiquid | None, scale: float
    ) -> None:
        self.near, self.grid, self.drives, self.phases, self.scale = near, grid, list(drives), phases, scale
        self._nodes = grid.indices if self.drives else np.zeros(0, np.int64)

    def prescribe(self) -> None:
        """Give the engine the nodes that conditions prescribe, with their values at the start."""
        engine, table, near = self.grid.engine, self.near.conditions, self.grid.indices
        engine.set_dependents(near[table.nodes], table.starts, near[table.references], table.weights)
        if table.nodes.size:
            fields, amplitudes = self._tables(table.drives, table.nodes.shape, 0, (0.0,), np.ones((1, 1)), 1)
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
            yield Batch(steps, np.zeros((0, int(np.prod(near.field_shape)))), still)
            return
        integrator = near.model.integrator
        samples, weights = integrator.source_samples(near.dt)
        prescribed_samples, held_weights = integrator.prescribed_samples(near.dt)
        weights = weights * near.model.source_factor
        general = any(space is None for space, _ in self.drives + held.drives)
        count = len(self.drives + held.drives)
        batch = 1 if general else max(1, min(steps, _TABLE // max(stages * count, 1)))
        end = step + steps
        while step < end:
            n = min(batch, end - step)
            strength, amplitudes = self._tables(self.drives, near.field_shape, step, samples, weights, n)
            if general and self.phases is not None:
                self.phases.refuse_wet(np.any(strength != 0, axis=0).reshape(near.lattice.shape))
            values, times = self._tables(held.drives, held.nodes.shape, step, prescribed_samples, held_weights, n)
            used = np.any(strength, axis=0)
            engine.advance(
                n,
                self._nodes[used] if self.drives else self._nodes,
                np.ascontiguousarray(strength[:, used], dtype),
                amplitudes.astype(dtype),
                self._prescribed(step, n),
                values.astype(dtype),
                times.astype(dtype),
            )
            explained = _largest(strength, amplitudes) * n * near.dt
            self.scale += explained * (max(1.0, step * near.dt) if near.model.order == 2 else 1.0)
            self.scale = max(self.scale, _largest(values, times))
            yield Batch(n, strength, amplitudes)
            step += n

    def _prescribed(self, step: int, steps: int) -> np.ndarray | None:
        """Values of the held nodes after each of the next steps."""
        if not self.near.prescribed.constraints:
            return None
        values = self.near.prescribed.table(step, steps)
        self.scale = max(self.scale, float(np.abs(values).max(initial=0)))
        return values

    def _tables(
        self,
        drives: Sequence[Drive],
        shape: tuple[int, ...],
        step: int,
        samples: Sequence[float],
        weights: np.ndarray,
        count: int,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Fields over nodes, shape (j, nodes), and their amplitudes in each stage of `count` steps from one on, shape
        (count, stages, j).

        What does not split into space and time takes one field for each sample time of the next step.
        """
        times = self.near.dt * (step + np.arange(count))
        fields, table = [], []
        for space, time in drives:
            if space is None:
                fields += [np.broadcast_to(np.asarray(time(times[0] + s), float), shape).ravel() for s in samples]
                table += [np.broadcast_to(weights[:, i], (1, len(weights))) for i in range(len(samples))]
            else:
                fields.append(np.asarray(space, float).ravel())
                if time is steady:
                    table.append(np.broadcast_to(weights.sum(1), (count, len(weights))))
                else:
                    table.append(np.array([[time(t + s) for s in samples] for t in times], float) @ weights.T)
        if not fields:
            return np.zeros((0, int(np.prod(shape)))), np.zeros((count, len(weights), 0))
        amplitudes = np.stack(table, axis=-1)
        if not np.isfinite(amplitudes).all():
            raise InputError("a source or condition is not finite", value=f"t = {times[0]:g}", key="source")
        return np.stack(fields), amplitudes


def _largest(fields: np.ndarray, amplitudes: np.ndarray) -> float:
    """A bound of the sum of fields with amplitudes."""
    return float(np.abs(fields).max(initial=0) * np.abs(amplitudes).max(initial=0))

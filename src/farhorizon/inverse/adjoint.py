r"""The adjoint of a run: the same medium between the same sides, at rest, driven by the residuals in reverse order.

The scheme of a run is ``A u[n+1] - B u[n] + C u[n-1] = K u[n] + s[n]`` for waves, with ``A = (1 + d dt) rho / dt^2``,
``B = 2 rho / dt^2`` and ``C = (1 - d dt) rho / dt^2``, and ``A (u[n+1] - u[n]) = K u[n] + s[n]`` with ``A = rho / dt``
for diffusion. K is symmetric, also where layers continue the near field, because they continue the same operator. The
multiplier of step n therefore obeys the same scheme backwards, with the derivative of the misfit by u[n] as its source:
it is ``w[shift - n]`` of an ordinary run, with shift = N + 1 for waves and N for diffusion.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from farhorizon.boundaries import Fixed
from farhorizon.inputs.prescribed import Prescribed
from farhorizon.simulation.processes.process_group import ALONE, ProcessGroup
from farhorizon.simulation.recorders.recorder import Recorder
from farhorizon.simulation.setup.setup import Setup
from farhorizon.simulation.simulation import Simulation
from farhorizon.simulation.time.source_table import Batch, SourceTable


class Residuals:
    """Derivatives of a misfit by the field at the nodes, as sums over receivers."""

    def __init__(self, steps: int, shape: tuple[int, ...]) -> None:
        self.steps, self.size = steps, int(np.prod(shape))
        self._parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def add(self, nodes: np.ndarray, weights: np.ndarray, rates: np.ndarray) -> None:
        """Add receivers with nodes and weights (n, K), and derivatives by the record of each after each step, (steps +
        1, n, components).
        """
        self._parts.append((nodes, weights, rates))

    def table(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return flat indices in the field, shape (S,), fields on them, shape (J, S), and the amplitude of each after
        every step, shape (steps + 1, J); receivers whose derivatives are all zero are left out.
        """
        fields: list[tuple[np.ndarray, np.ndarray]] = []
        rates: list[np.ndarray] = []
        for nodes, weights, values in self._parts:
            count = self.size // values.shape[2]
            for component in range(values.shape[2]):
                for number in np.flatnonzero(values[:, :, component].any(0)):
                    fields.append((nodes[number] + component * count, weights[number]))
                    rates.append(values[:, number, component])
        places = np.unique(np.concatenate([np.zeros(0, np.int64), *(at for at, _ in fields)]))
        table = np.zeros((len(fields), places.size))
        for row, (at, weights) in zip(table, fields, strict=True):
            np.add.at(row, np.searchsorted(places, at), weights)
        return places, table, np.reshape(rates, (-1, self.steps + 1)).T


class AdjointFeed(SourceTable):
    """Supply of an adjoint run, at rest, with residuals, the last ones first; `shift` is the step of the run plus that
    of its adjoint.
    """

    def __init__(self, sim: Simulation, residuals: Residuals, shift: int) -> None:
        near, grid = sim.parts.near, sim.parts.grid
        places, fields, rates = residuals.table()
        component, node = np.divmod(places, int(np.prod(near.lattice.whole.shape)))
        here, node = near.lattice.own(node)  # on this process
        fields, places = fields[:, here], component[here] * int(np.prod(near.lattice.shape)) + node
        factor = near.model.source_factor
        density = 1.0 if near.density is None else float(near.density.min())
        largest = np.abs(rates).max(0, initial=0) @ np.abs(fields).max(1, initial=0) * factor / density
        super().__init__(near, grid, [], None, float(largest) * near.dt ** (near.model.order - 1) + 1e-300)
        self._places, self._on_places, self._shift = grid.indices[places], fields.astype(grid.engine.dtype), shift
        self._rates = factor * np.concatenate([rates, np.zeros((1, rates.shape[1]))])  # the last row serves no step
        self._largest = float(largest)

    def advance(self, step: int, steps: int) -> Iterator[Batch]:
        """Advance the engine by `steps` steps from number `step` on."""
        engine, n = self.grid.engine, self._shift - step - np.arange(steps)
        inside = (n >= 0) & (n < len(self._rates) - 1)
        amplitudes = self._rates[np.where(inside, n, -1)][:, None].astype(engine.dtype)
        engine.advance(steps, self._places, self._on_places, amplitudes, self._prescribed(step, steps))
        self.scale += self._largest * steps * self.near.dt * (step + steps) * self.near.dt
        self._grow(steps)
        yield Batch(steps, self._places, self._on_places, amplitudes)


def adjoint_run(
    setup: Setup,
    residuals: Residuals,
    shift: int,
    observe: Sequence[Recorder],
    team: ProcessGroup = ALONE,
    topology: Sequence[int] | None = None,
) -> Simulation:
    """Return the adjoint of a run, at its start, for the run's set-up with all choices made."""
    given: dict[str, Any] = dict(setup.boundary)  # type: ignore[arg-type]
    sides = {name: replace(side, value=0.0) if isinstance(side, Fixed) else side for name, side in given.items()}
    held = tuple(_at_zero(one) for one in setup.constraints if isinstance(one, Prescribed))
    still = replace(
        setup, boundary=sides, constraints=held, background=0.0, initial={}, sources=(), loads=(), balance=False
    )
    sim = Simulation.of(still, observe, team, topology)
    sim.time_loop.source_table = AdjointFeed(sim, residuals, shift)
    return sim


def _at_zero(one: Prescribed) -> Prescribed:
    """Return the same constraint with the value 0 of all components that it prescribes."""
    given = one.velocity if one.value is None else one.value
    zero = [None if value is None else 0.0 for value in given] if isinstance(given, list) else 0.0
    return replace(one, value=zero, velocity=None)

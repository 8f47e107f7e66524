"""Load steps: iterations of the engine by adaptive dynamic relaxation until a body is in equilibrium.

An iteration is a step of velocity Verlet in which the previous increment is multiplied by a factor,

    u(n+1) - u(n) = (1 - w)^2 (u(n) - u(n-1)) + dt^2 M^-1 F(u(n)),

which damps the mode of the frequency w per iteration critically. Frequencies come from Rayleigh's quotient of the
latest increment, ``w^2 = -d . (F(u(n)) - F(u(n-1))) / d . M d`` with ``d = u(n) - u(n-1)`` (Underwood 1983; Kilic and
Madenci 2010, Theor. Appl. Fract. Mech. 53, 194-204, there with a diagonal matrix in place of the change of the forces).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from farhorizon.engine.settings import damp_increments
from farhorizon.inputs.load_steps import LoadSteps
from farhorizon.simulation.setup.grid import Grid
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.time.source_table import Path, SourceTable

_CHECK = 32  # iterations from one check to the next, which costs about as much as one of them
# Loads move for this many times 1/w: a critically damped mode that is driven at a constant rate lags by 2/w, here a
# tenth of what is added in a load step, and bonds are strained by that much in excess.
_RISE = 20.0
_SETTLED = 2  # checks in a row that must find equilibrium: velocity and acceleration may vanish at one moment


class Relaxation:
    """Iterations that bring a body into equilibrium under the loads of a step."""

    def __init__(self, load_steps: LoadSteps, near: NearField, grid: Grid, source_table: SourceTable) -> None:
        self._load_steps, self._near, self._grid, self._source_table = load_steps, near, grid, source_table
        # of the slowest mode, per iteration: at first that of a bar as long as the body which is held at one end
        self.frequency = np.pi / 2 * near.dt / near.slow_crossing
        self.iterations = 0  # of all load steps
        self.missed = 0.0  # what the displacements of a step may still change, if its limit has ended one
        self._masses = np.ones(1) if near.density is None else near.inside(near.density)

    def state(self) -> dict[str, float]:
        """Return what the next load step depends on, as JSON."""
        return {"frequency": self.frequency, "iterations": self.iterations}

    def take(self, state: Mapping[str, float]) -> None:
        """Restore what `state` returned."""
        self.frequency, self.iterations = state["frequency"], int(state["iterations"])

    def warning(self) -> str | None:
        """Return why the present state may not be one of equilibrium; None if it is."""
        if not self.missed:
            return None
        return (
            f"load steps are not in equilibrium: after {self._load_steps.limit} iterations displacements may still "
            f"change by {self.missed:.2g} of their size; a smaller interval, or a higher limit"
        )

    def settle(self, step: int) -> None:
        """Go from the equilibrium at a step to that at the next one; the last iteration is recorded as that step."""
        engine, settings = self._grid.engine, self._load_steps
        engine.older[...] = engine.current  # at rest
        path = self._source_table.path(step)
        moved, settled, rate = 0.0, 0, 1 / _RISE
        for count in range(_CHECK, settings.limit + _CHECK, _CHECK):
            damp_increments(engine, (1 - self.frequency) ** 2)
            way = np.minimum(1.0, moved + rate * self.frequency * np.arange(1, _CHECK + 1))
            self._iterate(step, path, way[:-1])
            before = self._accelerations()
            self._iterate(step, path, way[-1:])
            still, moved = moved == 1, way[-1]
            remaining = self._remaining(before) if still else np.inf
            settled = settled + 1 if remaining <= settings.tolerance else 0
            if settled == _SETTLED or np.isnan(remaining):
                break
        self.iterations += count
        if settled < _SETTLED:
            self.missed = remaining

    def _iterate(self, step: int, path: Path, way: np.ndarray) -> None:
        """Iterate once for each of some positions on the way from the loads of a step to those of the next one."""
        self._grid.engine.steps_done = step + 1 - len(way)  # what is recorded of the last one is that of the next step
        self._source_table.follow(path, way)

    def _level(self, level: np.ndarray) -> np.ndarray:
        """Return a level in the near field, zero where there are no nodes."""
        return self._near.inside(self._grid.view(level).reshape(self._near.field_shape).astype(float))

    def _accelerations(self) -> np.ndarray:
        """Return the forces on free nodes over their masses at the last but one iterate, in units of iterations."""
        engine = self._grid.engine
        now, before, earlier = (self._level(level) for level in engine.last_levels)
        accelerations = now - before - (1 - self.frequency) ** 2 * (before - earlier)
        accelerations.ravel()[self._near.prescribed.held(engine.steps_done - 1)] = 0
        return accelerations

    def _remaining(self, accelerations: np.ndarray) -> float:
        """Return an estimate of what the displacements are still going to change, relative to their size, and update
        the frequency; `accelerations` are those of the previous iteration.
        """
        _, now, before = (self._level(level) for level in self._grid.engine.last_levels)
        increment, latest = now - before, self._accelerations()
        moving, size = self._product(increment, increment), self._product(now, now)
        stiffness = -self._product(increment, latest - accelerations)
        if moving > 0 and stiffness > 0:  # not while bonds break
            self.frequency = min(1.0, float(np.sqrt(stiffness / moving)))
        change = self._product(latest, latest) / self.frequency**4 + moving / self.frequency**2
        return float(np.sqrt(change / size)) if size > 0 else float(change)

    def _product(self, first: np.ndarray, second: np.ndarray) -> float:
        """Return the product of two fields, weighted by the masses of the nodes."""
        return float((self._masses * first * second).sum())

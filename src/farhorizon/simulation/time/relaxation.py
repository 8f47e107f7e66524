"""Load steps: iterations of the engine by adaptive dynamic relaxation until a body is in equilibrium.

An iteration is a step of velocity Verlet in which the previous increment is multiplied by a factor,

    u(n+1) - u(n) = (1 - w)^2 (u(n) - u(n-1)) + dt^2 M^-1 F(u(n)),

which damps the mode of the frequency w per iteration critically. Frequencies come from Rayleigh's quotient of the
change d of the displacements over some iterations and that of the forces, ``w^2 = -d . (F(u + d) - F(u)) / d . M d``
(Underwood 1983; Kilic and Madenci 2010, Theor. Appl. Fract. Mech. 53, 194-204, there with a diagonal stiffness).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from farhorizon.engine.settings import damp_increments
from farhorizon.inputs.load_steps import LoadSteps
from farhorizon.simulation.setup.grid import Grid
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.time.source_table import SourceTable

_CHECK = 32  # iterations from one check to the next, which costs about as much as some of them
# Loads move for this many times 1/w: a critically damped mode that is driven at a constant rate lags by 2/w, here a
# fifth of what is added in a load step.
_RISE = 10.0
# of the frequencies, with which an iteration is stable: (2 STABLE)^2 < 2 (1 + (1 - w)^2), see `quasi_static.STABLE`
_HIGHEST = 0.2
_ROUNDING = 1e-15  # of accelerations, which are sums of a few displacements, relative to these


class _State(NamedTuple):
    """Fields at the nodes, components first."""

    displacements: np.ndarray
    increments: np.ndarray  # of the last iteration
    accelerations: np.ndarray


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
        engine.put("u_old", engine.get("u"))  # at rest
        path = self._source_table.path(step)
        moved, quiet, remaining, before = 0.0, 0.0, np.inf, None
        for _ in range(0, settings.limit, _CHECK):
            self.iterations += _CHECK
            damp_increments(engine, (1 - self.frequency) ** 2)
            way = moved + self.frequency / _RISE * np.arange(1, _CHECK + 1)
            self._source_table.follow(path, np.minimum(1.0, way))
            if moved == 1:
                now = self._state(step)
                remaining, before = self._remaining(now, before), now
                least = max(settings.tolerance, _ROUNDING / self.frequency**2)
                quiet = quiet + _CHECK * self.frequency if remaining <= least else 0.0
            moved = min(1.0, way[-1])
            if quiet >= 1 or np.isnan(remaining):  # for as long as a mode takes to show
                break
        else:
            self.missed = remaining
        engine.clock = step, engine.clock[1]
        self._source_table.follow(path, np.ones(1))

    def _state(self, step: int) -> _State:
        """Return displacements, increments and accelerations of the last but one iterate, in units of iterations; those
        of nodes without a body and the accelerations of held nodes are zero.
        """
        later, now, before = (
            self._near.inside(self._grid.get(name).astype(float)) for name in ("u", "u_old", "u_older")
        )
        increments = now - before
        accelerations = later - now - (1 - self.frequency) ** 2 * increments
        accelerations.ravel()[self._near.prescribed.held(step)] = 0
        return _State(now, increments, accelerations)

    def _remaining(self, state: _State, before: _State | None) -> float:
        """Return an estimate of what the displacements are still going to change, relative to their size; infinite
        without the state at the last check, from which the frequency for the next iterations follows.
        """
        if before is None:
            return np.inf
        change, turned = state.displacements - before.displacements, state.accelerations - before.accelerations
        accelerated, moving, size = (self._product(field, field) for field in reversed(state))
        changed, stiffness = self._product(change, change), -self._product(change, turned)
        # not while bonds break, nor by rounding errors
        if changed > 0 and stiffness > 0 and self._product(turned, turned) > _ROUNDING**2 * size:
            # it rises no faster than its mode decays: where a slow mode turns round, others count for a moment
            slow = self.frequency * np.exp(_CHECK * self.frequency)
            self.frequency = min(_HIGHEST, slow, float(np.sqrt(stiffness / changed)))
        ahead = accelerated / self.frequency**4 + moving / self.frequency**2
        return float(np.sqrt(ahead / size)) if size > 0 else float(ahead)

    def _product(self, first: np.ndarray, second: np.ndarray) -> float:
        """Return the product of two fields, weighted by the masses of the nodes."""
        return float((self._masses * first * second).sum())

"""Waves of diffusion that alternate from step to step, and their reflection by the layers of a run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from farhorizon.analysis.layers.first_steps import FirstSteps, waves_of
from farhorizon.analysis.layers.short_waves import short_share
from farhorizon.analysis.layers.side_data import Datum
from farhorizon.boundaries import Side
from farhorizon.engine.engine import Layer
from farhorizon.medium.integrators import Verlet
from farhorizon.simulation.near_field import NearField
from farhorizon.simulation.wave_data import largest_along

_GENTLY = 0.1  # magnitude of the factor per step below which a wave vanishes before it reaches a side
_GONE = 1e-9  # remaining share of the waves below which they are no longer followed
_STEPS = 128  # largest number of steps that are followed
FOLLOWED = 0.91  # factor per step with which 6e-6 of a wave remains after `_STEPS` steps
_FEW = 1e-2  # share of such waves in the data, over the wanted error, that is neglected


@dataclass(frozen=True)
class AlternatingWaves:
    """Waves whose sign alternates with each step of forward Euler: beyond half its limit the shortest ones do.

    Attributes
    ----------
    near : NearField
    sides : mapping of (axis, side) to Side
    data : sequence of Datum
        Initial data and lasting sources.
    first : float
        Smallest wavenumber times spacing of such waves in any direction.
    steps : int
        Number of steps after which they have vanished, or nearly so for factors up to `FOLLOWED`.
    """

    near: NearField
    sides: Mapping[tuple[int, int], Side]
    data: Sequence[Datum]
    first: float
    steps: int
    _steps_at: dict[tuple[object, ...], list[FirstSteps]] = field(default_factory=dict)

    @classmethod
    def of(cls, near: NearField, sides: Mapping[tuple[int, int], Side], data: Sequence[Datum]) -> AlternatingWaves:
        """Return the alternating waves of a set-up; without data if there are no such waves."""
        integrator, none = near.model.integrator, cls(near, sides, (), np.pi, 0)
        if not integrator.alternates:
            return none
        radius, growth = growth_of_waves(near)
        alternating = growth < -_GENTLY
        if not alternating.any():
            return none
        left = min(float(np.abs(growth[alternating]).max()), 0.999)
        steps = min(_STEPS, int(np.ceil(np.log(_GONE) / np.log(left))))
        return cls(near, sides, data, float(radius[alternating].min()), steps)

    def returned(self, axis: int, side: int, layer: Layer, wanted: float, until: float) -> float:
        """Return the largest error that a layer makes of them up to a time, relative to the largest value at the same
        time; 0 if the data hold too few of them.
        """
        key = axis, side, wanted, until
        if key not in self._steps_at:
            self._steps_at[key] = list(self._first_steps(*key))
        return max((steps.returned(layer) for steps in self._steps_at[key]), default=0.0)

    def _first_steps(self, axis: int, side: int, wanted: float, until: float) -> Iterator[FirstSteps]:
        """Yield the data as seen from a side, on the plane of the normal and the first tangential axis; in 3D with
        waves along the other tangential axis, as if the data were a product.
        """
        others = [other for other in range(self.near.lattice.dim) if other != axis]
        scale, steps = self.near.fastest_rate * self.near.dt, min(self.steps, int(np.ceil(until / self.near.dt)))
        periodic = bool(others) and self.sides[others[0], -1].periodic
        for datum in self.data:
            if not datum.values.any() or short_share(datum.values, self.first) <= _FEW * wanted:
                continue
            values = datum.turned(axis, side).values
            rows = largest_along(values, range(2, values.ndim)).reshape(len(values), -1)
            beyond = waves_of(largest_along(values, (0, 1)).ravel()) if values.ndim == 3 else [(0.0, 1.0)]
            stencil, lasting = self.near.stencil.along(axis), datum.kind == "source"
            yield FirstSteps(stencil, scale, rows, periodic, steps, wanted, beyond=beyond, lasting=lasting)


def growth_of_waves(near: NearField) -> tuple[np.ndarray, np.ndarray]:
    """Return the wavenumbers times spacing of a sample of waves of all directions, and their factors in a step of
    diffusion.
    """
    zone, values, _ = near.stencil.zone_branches
    integrator = near.model.integrator
    assert not isinstance(integrator, Verlet)  # Verlet is for waves
    return np.sqrt(sum(axis**2 for axis in zone)), integrator.growth(near.fastest_rate * values[..., 0], near.dt)

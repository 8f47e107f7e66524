"""Waves of diffusion that alternate from step to step, and what the layers of a run send back of them."""

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

_GENTLY = 0.1  # a factor a step of which nothing is left before a wave reaches a side
_GONE = 1e-9  # share of them after which nobody looks
_STEPS = 128  # that are looked at, at most
FOLLOWED = 0.91  # factor a step of which hardly anything is left after so many: 6e-6
_FEW = 1e-2  # share of the wanted error that such waves in the data may be


@dataclass(frozen=True)
class AlternatingWaves:
    """Waves that change their sign with each step of forward Euler: beyond half its limit the shortest ones do.

    Attributes
    ----------
    near : NearField
    sides : mapping of (axis, side) to Side
    data : sequence of Datum
        At the start, and sources that go on.
    first : float
        Least wavenumber times spacing of such waves, of any direction.
    steps : int
        After which none is left, or hardly any of those up to `FOLLOWED`.
    """

    near: NearField
    sides: Mapping[tuple[int, int], Side]
    data: Sequence[Datum]
    first: float
    steps: int
    _steps_at: dict[tuple[object, ...], list[FirstSteps]] = field(default_factory=dict)

    @classmethod
    def of(cls, near: NearField, sides: Mapping[tuple[int, int], Side], data: Sequence[Datum]) -> AlternatingWaves:
        """Those of a set-up; without data where there are none to speak of."""
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
        """Largest error that a layer makes of them up to a time, relative to the largest value at the same time; 0
        where the data have too few.
        """
        key = axis, side, wanted, until
        if key not in self._steps_at:
            self._steps_at[key] = list(self._first_steps(*key))
        return max((steps.returned(layer) for steps in self._steps_at[key]), default=0.0)

    def _first_steps(self, axis: int, side: int, wanted: float, until: float) -> Iterator[FirstSteps]:
        """The data as a side sees them, on the plane along the first tangential axis; in space with waves along the
        other one, as if they were a product.
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
    """Wavenumbers times spacing of a sample of all waves, whatever way they go, and their factors in a step of
    diffusion.
    """
    zone, values, _ = near.stencil.zone_branches
    integrator = near.model.integrator
    assert not isinstance(integrator, Verlet)  # which is of waves
    return np.sqrt(sum(axis**2 for axis in zone)), integrator.growth(near.fastest_rate * values[..., 0], near.dt)

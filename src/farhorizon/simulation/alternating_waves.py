"""Waves of diffusion that alternate from step to step, and what the layers of a run send back of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from farhorizon.analysis.layers.first_steps import FirstSteps
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
        At the start.
    first : float
        Least wavenumber times spacing of such waves.
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
        assert not isinstance(integrator, Verlet)  # which is of waves
        angles = np.linspace(0, np.pi, 513)[1:]
        symbol = near.stencil.symbol(angles, *[0.0] * (near.lattice.dim - 1))
        growth = integrator.growth(near.fastest_rate * symbol, near.dt)
        alternating = np.flatnonzero(growth < -_GENTLY)
        if not alternating.size:
            return none
        left = min(float(np.abs(growth[alternating]).max()), 0.999)
        steps = min(_STEPS, int(np.ceil(np.log(_GONE) / np.log(left))))
        return cls(near, sides, data, float(angles[alternating[0]]), steps)

    def returned(self, axis: int, side: int, layer: Layer, wanted: float, until: float) -> float:
        """Largest error that a layer makes of them up to a time, relative to the largest value at the same time; 0
        where the data have too few.
        """
        key = axis, side, wanted, until
        if key not in self._steps_at:
            self._steps_at[key] = list(self._first_steps(*key))
        return max((steps.returned(layer) for steps in self._steps_at[key]), default=0.0)

    def _first_steps(self, axis: int, side: int, wanted: float, until: float) -> Iterator[FirstSteps]:
        """The data as a side sees them, on planes along each tangential axis."""
        others = [other for other in range(self.near.lattice.dim) if other != axis]
        scale, steps = self.near.fastest_rate * self.near.dt, min(self.steps, int(np.ceil(until / self.near.dt)))
        for datum in self.data:
            if short_share(datum.values, self.first) <= _FEW * wanted:
                continue
            values = datum.turned(axis, side).values
            for kept in range(max(1, len(others))):
                flat = largest_along(values, [place for place in range(1, values.ndim) if place != kept + 1])
                rows = flat.reshape(len(flat), -1)
                periodic = bool(others) and self.sides[others[kept], -1].periodic
                stencil = self.near.stencil.along(axis)
                yield FirstSteps(stencil, scale, rows, periodic, steps, wanted, across=kept + 1)

"""Pulses in a lattice with a free surface, or strata, or both: plane pulses with what they become there, and pulses
that run along a surface.

Both are sums of waves that solve the equations of the lattice and of velocity Verlet exactly (`half_space`). They are
periodic, with a period long enough for everything that travels to have left. Where the reflected waves have phases of
their own, beyond the critical angle, or for the displacement along the surface of a Rayleigh wave, the pulse is partly
a Hilbert transform: it has a tail before and after it, which decays as a power of time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from farhorizon.analysis.half_space import Column, HalfSpace
from farhorizon.analysis.references.infinite_lattice import Scheme
from farhorizon.analysis.references.pulse import (
    PlanePulse,
    TravellingWaves,
    check_lost,
    harmonics,
    significant,
    steps_of,
)
from farhorizon.errors import InputError
from farhorizon.medium.stratified_medium import StratifiedMedium

_TAIL = 1e-9  # part of the signal that may be left between two periods of a pulse without a tail
_SPARE, _LONGER = 1.5, (2.0, 4.0)  # periods over the shortest possible one, and longer ones over the first of these
_HELPS = 0.25  # a longer period that leaves more than this part of the tail does not help
_PROBES = 9  # times at which the tail is evaluated
_LONG = 1e-2  # wavenumber times spacing of a long wave
_RAYLEIGH = 0.9  # approximate speed of Rayleigh waves over that of S waves


@dataclass(frozen=True, eq=False)
class FreeSurface:
    """The first row of a medium across an axis of a lattice, and the rows in which a pulse is needed."""

    scheme: Scheme
    end: StratifiedMedium
    spacing: float
    level: float  # coordinate of the nodes of the first row
    rows: int  # from the first row down, in which the pulse is needed
    depth: int  # of the box, in rows

    @property
    def half_space(self) -> HalfSpace:
        """The medium as a chain of rows."""
        return HalfSpace(self.end)

    def normal_first(self, vector: np.ndarray) -> np.ndarray:
        """Components of a vector with the normal first; those of a scalar field unchanged."""
        return vector[self.end.order] if self.scheme.stencil.components > 1 else vector

    def shape(self, column: Column, amplitude: complex = 1.0) -> np.ndarray:
        """A wave in all rows in the convention of `TravellingWaves`, whose waves have the time dependence ``exp(i w
        t)``.
        """
        shape = amplitude * column.at(self.rows).conj()
        order = np.argsort(self.end.order)
        return shape[:, order] if self.scheme.stencil.components > 1 else shape

    def squared(self, frequency: float) -> float:
        """Squared frequency in units of the stencil, for the discrete frequency of the scheme."""
        dt = self.scheme.dt
        return float((2 / dt * np.sin(frequency * dt / 2)) ** 2 / self.scheme.rate)

    @property
    def slowest(self) -> float:
        """Speed of the slowest long wave that travels straight down, in rows per unit of time."""
        along = [_LONG, *[0.0] * (self.scheme.stencil.dim - 1)]
        branches = self.scheme.stencil.along(self.end.axis).branches(*along)
        return float(np.sqrt(self.scheme.rate * branches.min()) / _LONG)

    @property
    def delay(self) -> float:
        """Time in which the slowest long waves pass all strata straight, and what is reflected back and forth between
        their ends decays to the tail that may be left.
        """
        if self.end.strata is None:
            return 0.0
        passage, kept = float(self.end.strata.slowness.sum()) / self.slowest, self.end.strata.reflection
        return passage * (1 + 2 * np.log(_TAIL) / np.log(kept)) if kept else passage

    @property
    def rest(self) -> tuple[float, float]:
        """Middle and half-width of the time, as parts of that between two passages of the signal, in which the surface
        should be at rest: the last part of it if the medium rings.
        """
        return (1 / 2, 1 / 4) if self.end.strata is None else (7 / 8, 1 / 16)

    def along(self, direction: np.ndarray) -> tuple[np.ndarray, float]:
        """Projection of a unit vector on the surface, as a unit vector in space, and its length."""
        flat = np.where(np.arange(direction.size) == self.end.axis, 0.0, direction)
        length = float(np.linalg.norm(flat))
        return (flat / length if length else flat), length


@dataclass(frozen=True, eq=False)
class SurfacePulse:
    """A pulse in a half-space."""

    waves: TravellingWaves  # along `direction`, in rows down from the surface
    direction: np.ndarray  # along the surface, of length 1; zero if the pulse is uniform along the surface
    period: float
    tail: float  # largest value of the pulse between two periods, over the largest value of the signal
    #: Part of the signal, relative to its largest value, in frequencies that the lattice does not carry, which is left
    #: out.
    lost: float


def reflected_pulse(
    surface: FreeSurface,
    make: Callable[[float], PlanePulse],
    direction: np.ndarray,
    way: tuple[float, float],
    samples: np.ndarray,
) -> SurfacePulse:
    """A plane pulse that comes to a surface or strata in a direction (dim,) of length 1, together with what it becomes
    there; an InputError if it does not come to them.

    `make` maps a period to the pulse in the unbounded medium inside. `way` is the distance from the origin, along its
    path, at which it has its signal, and the distance to which it travels; `samples` is the signal at the time steps.
    """
    half_space = surface.half_space
    tangent, length = surface.along(direction)
    tangential = direction[surface.end.order[1:]]
    up = surface.end.side * direction[surface.end.axis]
    met = direction[surface.end.axis] * surface.level - way[0]  # length of its path to the surface, above the origin

    def pulse_of_period(period: float) -> SurfacePulse:
        pulse, numbers, shapes = make(period), [], []
        size = np.abs(pulse.amplitudes)
        used = pulse.frequencies > 0
        if surface.end.strata is not None:  # what rings has a long period, and many waves that are too small to matter
            used &= size > _TAIL * size.max()
        for number in np.flatnonzero(used):
            wavenumber, amplitude = pulse.wavenumbers[number], pulse.amplitudes[number]
            # a column has the time dependence exp(-i w t)
            vector = (amplitude * pulse.polarisations[number] * np.exp(-1j * wavenumber * met)).conj()
            if vector.any():
                angle, squared = wavenumber * surface.spacing, surface.squared(pulse.frequencies[number])
                wave = complex(np.exp(1j * angle * up)), surface.normal_first(vector)
                shapes.append(surface.shape(half_space.total(squared, angle * tangential, *wave)))
                numbers.append(number)
        moving = TravellingWaves(
            pulse.frequencies[numbers], length * pulse.wavenumbers[numbers], np.array(shapes), surface.spacing
        )
        return _at_rest(moving, tangent, pulse.period, pulse.lost, met / pulse.speed, samples, surface)

    return _with_a_small_tail(pulse_of_period, surface, way, samples)


def rayleigh_pulse(
    surface: FreeSurface, direction: np.ndarray, way: tuple[float, float], samples: np.ndarray
) -> SurfacePulse:
    """A pulse that runs along a surface in a direction (dim,) of length 1; an InputError for a signal with frequencies
    at which no wave runs along the surface.

    `way` is the distance from the origin, along its path, at which the displacement of the surface along its outward
    normal is the signal, and the distance to which it travels; `samples` is the signal at the time steps.
    """
    scheme, dt, half_space = surface.scheme, surface.scheme.dt, surface.half_space
    tangential = direction[surface.end.order[1:]]
    # wavenumber over the root of the squared frequency
    guess = np.sqrt(scheme.rate) / (_RAYLEIGH * surface.slowest)

    def pulse_of_period(period: float) -> SurfacePulse:
        count = steps_of(period, dt)
        frequencies, amplitudes = harmonics(samples, dt, count)
        used = np.flatnonzero(significant(amplitudes) & (frequencies > 0))
        ratio, lost = guess, 0.0
        numbers: list[int] = []
        wavenumbers, shapes = [], []
        for number in used.tolist():
            squared = surface.squared(frequencies[number])
            try:
                angle, column = half_space.surface_wave(squared, tangential, ratio * np.sqrt(squared))
            except InputError:
                if not numbers:
                    raise
                lost = float(np.abs(amplitudes[number:]).sum() / np.abs(samples).max())
                check_lost(lost, float(frequencies[number]))
                break
            ratio, wavenumber = angle / np.sqrt(squared), angle / surface.spacing
            normal = surface.end.side * column.rows[0, 0].conj()
            shapes.append(surface.shape(column, amplitudes[number] * np.exp(1j * wavenumber * way[0]) / normal))
            wavenumbers.append(wavenumber)
            numbers.append(number)
        moving = TravellingWaves(frequencies[numbers], np.array(wavenumbers), np.array(shapes), surface.spacing)
        arrival = -way[0] * wavenumbers[0] / frequencies[numbers[0]]
        return _at_rest(moving, direction, count * dt, lost, arrival, samples, surface)

    return _with_a_small_tail(pulse_of_period, surface, way, samples)


def _with_a_small_tail(
    pulse_of_period: Callable[[float], SurfacePulse],
    surface: FreeSurface,
    way: tuple[float, float],
    samples: np.ndarray,
) -> SurfacePulse:
    """The pulse with the shortest of several periods that leaves no tail, or beyond which a longer one does not help.

    The shortest is one and a half times the time in which the slowest long wave passes the box along the path and down.
    """
    passed = (way[1] - way[0]) / surface.spacing + surface.depth
    least = _SPARE * (samples.size * surface.scheme.dt + passed / surface.slowest + surface.delay)
    pulse = pulse_of_period(least)
    for factor in _LONGER:
        if pulse.tail <= _TAIL:
            break
        longer = pulse_of_period(factor * least)
        if longer.tail > _HELPS * pulse.tail:
            break
        pulse = longer
    return pulse


def _at_rest(
    moving: TravellingWaves,
    direction: np.ndarray,
    period: float,
    lost: float,
    arrival: float,
    samples: np.ndarray,
    surface: FreeSurface,
) -> SurfacePulse:
    """The moving waves, and with them the translation that brings the surface to rest between two periods; `arrival` is
    the time at which the pulse comes to the surface above the origin.
    """
    duration, (middle, width) = samples.size * surface.scheme.dt, surface.rest
    pause = period - duration
    middle = arrival + duration + pause * middle
    surface_at = moving.at(np.zeros(1))
    translation = -surface_at(middle)[:, 0]
    times = middle + pause * width * np.linspace(-1, 1, _PROBES)
    tail = max(float(np.abs(surface_at(t)[:, 0] + translation).max()) for t in times) / float(np.abs(samples).max())
    waves = TravellingWaves(
        np.append(moving.frequencies, 0.0),
        np.append(moving.wavenumbers, 0.0),
        np.concatenate([moving.shapes, np.broadcast_to(translation, (1, *moving.shapes.shape[1:]))]),
        moving.spacing,
    )
    return SurfacePulse(waves, direction, period, tail, lost)

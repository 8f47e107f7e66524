"""Pulses in a half-infinite lattice with a free surface: plane ones with all that the surface sends back, and those
that run along it.

Both are sums of waves that solve the equations of the lattice and of velocity Verlet exactly (`half_space`). They
repeat themselves after a period, which is long enough for all that travels to have left. Where the surface sends
back waves with a phase of their own, beyond the critical angle, or for the displacement along the surface of a Rayleigh
wave, the pulse is a Hilbert transform in part: it has a tail before and after it, which falls off as a power of time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from farhorizon.analysis.half_space import Column, HalfSpace
from farhorizon.analysis.references.driven import Scheme
from farhorizon.analysis.references.pulse import (
    PlanePulse,
    TravellingWaves,
    check_lost,
    felt,
    harmonics,
    late,
    sampled,
    steps_of,
)
from farhorizon.errors import InputError

_FAINT = 1e-10  # of the amplitude of a wave: what the surface sends back below this need not leave
_TAIL = 1e-9  # of the signal: a pulse that has more of it left between two periods has a tail
_LONGER = 2.0  # by which factor the period of a pulse with a tail is longer
_PROBES = 9  # times at which a tail is looked for
_RAYLEIGH = 0.9  # about the speed of Rayleigh waves over that of S waves


@dataclass(frozen=True, eq=False)
class FreeSurface:
    """A free surface across an axis of a lattice, and where a pulse meets the box that stands on it.

    Attributes
    ----------
    scheme : Scheme
        Of the medium.
    spacing : float
    axis : int
    side : {-1, 1}
    level : float
        Coordinate of its nodes.
    rows : int
        How far down the pulse is wanted.
    """

    scheme: Scheme
    spacing: float
    axis: int
    side: int
    level: float
    rows: int

    @property
    def half_space(self) -> HalfSpace:
        """The medium below it."""
        return HalfSpace(self.scheme.stencil.along(self.axis), self.side)

    @property
    def order(self) -> list[int]:
        """The axes, the normal first."""
        return [self.axis, *(a for a in range(self.scheme.stencil.dim) if a != self.axis)]

    def turned(self, vector: np.ndarray) -> np.ndarray:
        """Components of a vector with the normal first; of a scalar field as they are."""
        return vector[self.order] if self.scheme.stencil.components > 1 else vector

    def shape(self, column: Column, amplitude: complex = 1.0) -> np.ndarray:
        """A wave in all rows, as `TravellingWaves` takes it: time goes as ``exp(i w t)`` there."""
        found = amplitude * column.at(self.rows).conj()
        back = np.argsort(self.order)
        return found[:, back] if self.scheme.stencil.components > 1 else found

    def squared(self, frequency: float) -> float:
        """Square of a frequency in units of the stencil, as the scheme has it."""
        dt = self.scheme.dt
        return float((2 / dt * np.sin(frequency * dt / 2)) ** 2 / self.scheme.rate)

    def along(self, direction: np.ndarray) -> tuple[np.ndarray, float]:
        """What of a unit vector is along the surface, as a unit vector in space, and its length."""
        flat = np.where(np.arange(direction.size) == self.axis, 0.0, direction)
        length = float(np.linalg.norm(flat))
        return (flat / length if length else flat), length


@dataclass(frozen=True, eq=False)
class SurfacePulse:
    """A pulse in a half-space.

    Attributes
    ----------
    waves : TravellingWaves
        Along `direction`, in rows down from the surface.
    direction : ndarray, shape (dim,)
        Along the surface, of length 1; zero where nothing depends on the place along it.
    period : float
    tail : float
        What is left of it between two periods, over the largest value of the signal.
    lost : float
        Part of the signal, relative to its largest value, in frequencies that the lattice does not carry: it is left
        out.
    """

    waves: TravellingWaves
    direction: np.ndarray
    period: float
    tail: float
    lost: float


def reflected_pulse(
    surface: FreeSurface, make: Callable[[float], PlanePulse], direction: np.ndarray, start: float, samples: np.ndarray
) -> SurfacePulse:
    """A plane pulse that comes to a surface, with all that this sends back.

    Parameters
    ----------
    surface : FreeSurface
    make : callable
        The pulse in the open medium, for a time by which its period is longer.
    direction : ndarray, shape (dim,)
        Along which it travels, of length 1.
    start : float
        Where on its way it has its signal, from the origin.
    samples : ndarray
        The signal at the time steps.

    Raises
    ------
    InputError
        It does not come to the surface.
    """
    scheme, half_space = surface.scheme, surface.half_space
    flat, length = surface.along(direction)
    tangential = direction[surface.order[1:]]
    up = surface.side * direction[surface.axis]
    met = direction[surface.axis] * surface.level - start  # its way to the surface, at the origin of the others axes

    def columns(pulse: PlanePulse) -> dict[int, Column]:
        """What moves of the pulse, by the number of the wave."""
        found = {}
        for number in np.flatnonzero(pulse.frequencies > 0):
            wavenumber, amplitude = pulse.wavenumbers[number], pulse.amplitudes[number]
            # time goes as exp(-i w t) in a column
            vector = (amplitude * pulse.polarisations[number] * np.exp(-1j * wavenumber * met)).conj()
            if vector.any():
                angle = wavenumber * surface.spacing
                wave = complex(np.exp(1j * angle * up)), surface.turned(vector)
                found[int(number)] = half_space.total(
                    surface.squared(pulse.frequencies[number]), angle * tangential, *wave
                )
        return found

    def delay(pulse: PlanePulse) -> float:
        """Time that what is sent back takes to the last row."""
        slowest = np.inf
        for number, column in columns(pulse).items():
            if pulse.late[number]:
                sizes = np.linalg.norm(column.vectors, axis=1)
                speed = float(column.speeds[sizes > _FAINT * sizes.max()].min())
                rise = 2 / scheme.dt * np.sin(pulse.frequencies[number] * scheme.dt)
                slowest = min(slowest, scheme.rate * speed / rise)
        return surface.rows / slowest

    def whole(later: float) -> SurfacePulse:
        pulse = make(later)
        found = columns(pulse)
        numbers, shapes = list(found), np.array([surface.shape(column) for column in found.values()])
        moving = TravellingWaves(
            pulse.frequencies[numbers], length * pulse.wavenumbers[numbers], shapes, surface.spacing
        )
        return _at_rest(moving, flat, pulse.period, pulse.lost, met / pulse.speed, samples, scheme.dt)

    later = delay(make(0.0))
    found = whole(later)
    return found if found.tail <= _TAIL else whole(later + (_LONGER - 1) * found.period)


def rayleigh_pulse(
    surface: FreeSurface,
    direction: np.ndarray,
    start: float,
    end: float,
    signal: Callable[[float], float],
    duration: float,
) -> SurfacePulse:
    """A pulse that runs along a surface.

    Parameters
    ----------
    surface : FreeSurface
    direction : ndarray, shape (dim,)
        Along the surface, of length 1.
    start : float
        Where on its way the displacement of the surface along its outward normal is the signal, from the origin.
    end : float
        How far it is to go, from the origin.
    signal : callable
        Of t, zero outside 0 to `duration`.
    duration : float

    Raises
    ------
    InputError
        A signal that is not finite, or with frequencies of which no wave runs along the surface.
    """
    scheme, dt = surface.scheme, surface.scheme.dt
    samples = sampled(signal, duration, dt)
    tangential = direction[surface.order[1:]]
    stencil = scheme.stencil.along(surface.axis)
    angle = 1e-2
    slow = stencil.branches(0.0, *(angle * tangential)).min() / angle**2
    guess = 1 / (_RAYLEIGH * np.sqrt(slow))  # wavenumber over the root of the squared frequency

    def waves(count: int) -> tuple[TravellingWaves, np.ndarray, float]:
        frequencies, amplitudes = harmonics(samples, dt, count)
        used = np.flatnonzero(felt(amplitudes) & (frequencies > 0))
        ratio, numbers, shapes, lost, kept = guess, [], [], 0.0, []
        for number in used:
            squared = surface.squared(frequencies[number])
            try:
                wavenumber, column = surface.half_space.surface_wave(squared, tangential, ratio * np.sqrt(squared))
            except InputError:
                lost = float(np.abs(amplitudes[number:]).sum() / np.abs(samples).max())
                check_lost(lost, float(frequencies[number]))
                break
            ratio = wavenumber / np.sqrt(squared)
            normal = surface.side * column.rows[0, 0].conj()
            phase = np.exp(1j * wavenumber / surface.spacing * start)
            shapes.append(surface.shape(column, amplitudes[number] * phase / normal))
            numbers.append(wavenumber / surface.spacing)
            kept.append(number)
        found = TravellingWaves(frequencies[kept], np.array(numbers), np.array(shapes), surface.spacing)
        return found, late(amplitudes[kept]), lost

    moving, counts, _ = waves(4 * samples.size)
    speeds = np.gradient(moving.frequencies, moving.wavenumbers)[counts]
    passed = duration + (end - start) / float(speeds.min())
    speed = float(moving.frequencies[0] / moving.wavenumbers[0])
    for factor in (1.0, _LONGER):
        count = steps_of(factor * passed, dt)
        moving, _, lost = waves(count)
        found = _at_rest(moving, direction, count * dt, lost, -start / speed, samples, dt)
        if found.tail <= _TAIL:
            break
    return found


def _at_rest(
    moving: TravellingWaves,
    direction: np.ndarray,
    period: float,
    lost: float,
    arrival: float,
    samples: np.ndarray,
    dt: float,
) -> SurfacePulse:
    """The waves that move, and with them the translation that makes the surface rest between two periods.

    Parameters
    ----------
    moving : TravellingWaves
    direction : ndarray, shape (dim,)
    period, lost : float
    arrival : float
        When the pulse comes to the surface above the origin.
    samples : ndarray
    dt : float
    """
    quiet = period - samples.size * dt
    middle = arrival + samples.size * dt + quiet / 2
    there = moving.at(np.zeros(1))
    still = -there(middle)[:, 0]
    times = middle + quiet / 4 * np.linspace(-1, 1, _PROBES)
    tail = max(float(np.abs(there(t)[:, 0] + still).max()) for t in times) / float(np.abs(samples).max())
    waves = TravellingWaves(
        np.append(moving.frequencies, 0.0),
        np.append(moving.wavenumbers, 0.0),
        np.concatenate([moving.shapes, np.broadcast_to(still, (1, *moving.shapes.shape[1:]))]),
        moving.spacing,
    )
    return SurfacePulse(waves, direction, period, tail, lost)

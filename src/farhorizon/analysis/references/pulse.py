"""Plane pulses that solve the equations of an undamped lattice exactly: a signal in time, carried in a direction by the
lattice's own waves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from farhorizon.errors import InputError
from farhorizon.machine import available_memory
from farhorizon.medium.stencil import Stencil
from farhorizon.rounding import MARGIN, TINY

_SAMPLES = 1024  # wavenumbers at which a branch is sampled before its equation is solved
_NEWTON = 8  # steps from an interpolated start, whose error each of them squares
_LONG = 1e-5  # below this wavenumber times spacing, polarisations are those of this wave
_LOST = 1e-12  # frequencies below this part of the largest amplitude are left out
_SLOW = 0.1  # group speed, relative to that of long waves, below which a lattice does not carry a wave
# largest part of the signal, relative to its largest value, at frequencies that the lattice does not carry, which is
# left out
_CARRIED = 1e-2
_MOST_STEPS = 10**6  # of a signal: more than a pulse has, and its waves are found in a second
_LATE = 1e-10  # frequencies above this part of the largest must have passed before the pulse is over
# interpolation in space: nodes per radian of the shortest wave, and nodes used for a value
_GRID, _POINTS = 6.0, 14


def sampled(signal: Callable[[np.ndarray], np.ndarray], duration: float, dt: float) -> np.ndarray:
    """Samples of a signal at the time steps within its duration; an InputError if it is not finite, or zero, or lasts
    too many steps.
    """
    if not duration <= _MOST_STEPS * dt:
        raise InputError(
            "the signal lasts too many time steps",
            value=duration,
            limit=f"{_MOST_STEPS * dt:.4g}, {_MOST_STEPS} steps",
            key="incident.duration",
            remedy="how long the signal itself lasts, in the unit of time of the run",
        )
    steps = int(np.ceil(duration / dt - MARGIN)) + 1  # rounding must not add a step in some units
    samples = signal(dt * np.arange(steps))
    if not np.isfinite(samples).all():
        raise InputError("the signal must be finite", value=samples[~np.isfinite(samples)][0], key="incident.signal")
    if not samples.any():
        raise InputError(
            "the signal is zero", value=duration, key="incident.signal", remedy="a signal within 0 <= t <= duration"
        )
    return samples


def harmonics(samples: np.ndarray, dt: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies w (rad per time) and complex amplitudes a for which ``Re sum a exp(i w t)`` is the signal, followed
    by zeros, over `count` steps.
    """
    spectrum = np.fft.rfft(samples, count) * 2 / count
    spectrum[0] /= 2
    if count % 2 == 0:
        spectrum[-1] /= 2
    return 2 * np.pi * np.arange(spectrum.size) / (count * dt), spectrum


def significant(amplitudes: np.ndarray) -> np.ndarray:
    """Which of the waves of a pulse are large enough not to be left out."""
    return np.asarray(np.abs(amplitudes) > _LOST * np.abs(amplitudes).max())


def steps_of(time: float, dt: float) -> int:
    """Number of steps in the period of a pulse that has passed at a given time."""
    return int(np.ceil(time / dt - MARGIN)) + 2


def check_lost(lost: float, limit: float) -> None:
    """Raise an InputError if too large a part of a signal is at frequencies, above a limit, that the lattice does not
    carry.
    """
    if lost > _CARRIED:
        raise InputError(
            "the signal has frequencies which the lattice does not carry",
            key="incident.signal",
            value=f"a share of {lost:.2g} above {limit:.4g} rad per time",
            limit=f"{_CARRIED:g}",
            remedy="a smoother or longer signal that is zero at both ends, or a finer lattice",
        )


class PlanePulse:
    """``u(x, t) = sum_j Re a_j p_j exp(i (w_j t - k_j s))``, s = n . (x - x0), with the dispersion of the lattice and
    of velocity Verlet, for the M frequencies of a signal that is zero outside 0 to `duration`; an InputError for a
    signal that is not finite, or has frequencies that the lattice does not carry (`lost` is their part).

    At x0 it is the signal; for vectors times the polarisation, along the direction for P waves, except for the part of
    the latter that belongs to waves of the other type, since on a lattice waves are polarised only approximately along
    and across. It is periodic with `period`, by default the time in which all significant waves pass `distance`.
    """

    def __init__(
        self,
        stencil: Stencil,
        coefficient: float,
        spacing: float,
        dt: float,
        direction: np.ndarray,
        polarisation: np.ndarray | None,
        signal: Callable[[np.ndarray], np.ndarray],
        duration: float,
        distance: float,
        period: float | None = None,
    ) -> None:
        self._rate = np.sqrt(coefficient) / spacing
        self.spacing, self.dt, self.distance = spacing, dt, distance
        samples = sampled(signal, duration, dt)
        self._branches = [
            _Branch(stencil, direction, polarisation, number) for number in range(_count(polarisation, direction))
        ]
        self._set_waves(samples, 4 * samples.size if period is None else steps_of(period, dt))
        speeds = self._group_speeds()
        self.speed = float(speeds[0])
        if period is None:
            late = np.abs(self.amplitudes) > _LATE * np.abs(self.amplitudes).max()
            passed = duration + distance / max(float(speeds[late].min()), TINY)
            self._set_waves(samples, steps_of(passed, dt))

    def _set_waves(self, samples: np.ndarray, count: int) -> None:
        """Determine the waves whose sum is the signal, followed by zeros, over `count` steps."""
        frequencies, spectrum = harmonics(samples, self.dt, count)
        roots = 2 / (self.dt * self._rate) * np.sin(frequencies * self.dt / 2)
        most = min(branch.most for branch in self._branches)
        above = roots >= most
        self.lost = float(np.abs(spectrum[above]).sum() / np.abs(samples).max())
        check_lost(self.lost, 2 / self.dt * np.arcsin(min(most * self.dt * self._rate / 2, 1.0)))
        used = ~above & significant(spectrum)
        self.period = count * self.dt
        self.frequencies = np.tile(frequencies[used], len(self._branches))
        self.amplitudes = np.tile(spectrum[used], len(self._branches))
        angles, slopes, polarisations = zip(*(branch.solve(roots[used]) for branch in self._branches), strict=True)
        self.wavenumbers = np.concatenate(angles) / self.spacing
        self._slopes, self.polarisations = np.concatenate(slopes), np.concatenate(polarisations)

    def _group_speeds(self) -> np.ndarray:
        """dw/dk of each wave; at k = 0, that of the fastest."""
        rise = 2 / self.dt * np.sin(self.frequencies * self.dt)
        moves = rise > 0
        speeds = self._rate**2 * self._slopes * self.spacing / np.where(moves, rise, 1.0)
        return np.where(moves, speeds, speeds[moves].max())

    @property
    def waves(self) -> TravellingWaves:
        """The waves whose sum is the pulse."""
        shapes = (self.amplitudes[:, None] * self.polarisations)[:, None]
        return TravellingWaves(self.frequencies, self.wavenumbers, shapes, self.spacing)

    def at(self, places: np.ndarray) -> Callable[[float], np.ndarray]:
        """The pulse at distances s along its path, shape (n,): a function of t that gives the displacement, shape
        (components, n).
        """
        return self.waves.at(places)


@dataclass(frozen=True, eq=False)
class TravellingWaves:
    """``u = sum_j Re S_j(row) exp(i (w_j t - k_j s))``: waves along a line s, each with a shape across it."""

    frequencies: np.ndarray  # (M,)
    wavenumbers: np.ndarray  # (M,)
    shapes: np.ndarray  # (M, rows, components)
    spacing: float

    def at(self, places: np.ndarray, rows: np.ndarray | None = None) -> Callable[[float], np.ndarray]:
        """The displacement at places s (n,) and rows, by default the first: a function of t with values (components,
        n). Many places are interpolated from a line of points; an InputError if the waves do not fit into memory.
        """
        from scipy import sparse

        rows = np.zeros(places.size, int) if rows is None else rows
        used, row = np.unique(rows, return_inverse=True)
        label = np.round(places / (MARGIN * self.spacing)).astype(np.int64)
        pairs, first_of, index_of = np.unique(
            np.stack([label, row], -1), axis=0, return_index=True, return_inverse=True
        )
        line, at_rows = places[first_of], row[first_of]
        step = 1 / (_GRID * max(np.abs(self.wavenumbers).max(initial=0), MARGIN / self.spacing))
        low, high = line.min(initial=0), line.max(initial=0)
        count = int(np.ceil((high - low) / step)) + 1
        if (count + 2 * _POINTS) * used.size < len(pairs):
            first = low - _POINTS // 2 * step
            points = first + step * np.arange(count + _POINTS + 1)
            index, weights = _lagrange((places - first) / step)
            index = index + row[:, None] * points.size
            line, at_rows = np.tile(points, used.size), np.repeat(np.arange(used.size), points.size)
        else:
            index, weights = index_of.reshape(-1, 1), np.ones((places.size, 1))
        start = np.arange(0, index.size + 1, index.shape[1])
        interpolation = sparse.csr_array((weights.ravel(), index.ravel(), start), shape=(places.size, line.size)).T
        components, count = self.shapes.shape[2], len(self.frequencies)
        need = 16.0 * count * components * line.size
        if need > available_memory() / 2:
            raise InputError(
                "the waves that an incident wave is made of do not fit into memory",
                value=f"about {need / 2**30:.3g} GiB for {count} waves on {line.size} nodes",
                limit=f"{available_memory() / 2**30 / 2:.3g} GiB",
                key="incident",
                remedy="a smaller box, a shorter signal, or a direction along an axis",
            )
        real, imaginary = np.empty((2, count, components, line.size))
        for j, (number, shape) in enumerate(zip(self.wavenumbers, self.shapes, strict=True)):
            wave = shape[used][at_rows].T * np.exp(-1j * number * line)
            real[j], imaginary[j] = wave.real, wave.imag
        real, imaginary = real.reshape(count, -1), imaginary.reshape(count, -1)

        def values(t: float) -> np.ndarray:
            phase = self.frequencies * t
            displacement = (np.cos(phase) @ real - np.sin(phase) @ imaginary).reshape(components, line.size)
            return np.asarray(displacement @ interpolation)

        return values


def _count(polarisation: np.ndarray | None, direction: np.ndarray) -> int:
    """Number of branches of which a pulse consists: as many as there are S waves, else one."""
    return 1 if polarisation is None or abs(polarisation @ direction) > 0.5 else direction.size - 1


class _Branch:
    """One branch of the symbol along a direction, from k = 0 to where its waves become slow, `most` the root of its
    largest value: for vectors the P wave, most nearly along the direction, or a `number` of the others in the order of
    their frequencies.
    """

    def __init__(self, stencil: Stencil, direction: np.ndarray, polarisation: np.ndarray | None, number: int) -> None:
        self._stencil, self._direction, self._polarisation, self._number = stencil, direction, polarisation, number
        angles = np.linspace(0.0, np.pi / np.abs(direction).max(), _SAMPLES + 1)
        roots = np.sqrt(np.maximum(self.at(angles)[0], 0))
        steps = np.diff(roots)
        rise = int(np.argmax(np.append(steps <= _SLOW * steps[0], True))) + 1
        self._angles, self._roots, self.most = angles[:rise], roots[:rise], float(roots[rise - 1])

    def at(self, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Value, slope, and projection of the polarisation on the branch, at wavenumbers times spacing."""
        along = [np.maximum(angle, _LONG) * n for n in self._direction]
        slope = np.sum([n * self._stencil.symbol_gradient(a, *along) for a, n in enumerate(self._direction)], axis=0)
        symbol = self._stencil.symbol(*along)
        moves = angle >= _LONG
        if self._polarisation is None:
            return np.where(moves, symbol, 0), slope, np.ones((angle.size, 1))
        values, modes = np.linalg.eigh(symbol)
        chosen = np.abs(np.einsum("mij,i->mj", modes.conj(), self._direction)).argmax(1)
        if abs(self._polarisation @ self._direction) < 0.5:
            slower = np.array(
                [[i for i in range(self._direction.size) if i != fastest] for fastest in range(self._direction.size)]
            )
            chosen = slower[chosen, self._number]
        mode = np.take_along_axis(modes, chosen[:, None, None], 2)[..., 0]
        value = np.take_along_axis(values, chosen[:, None], 1)[:, 0]
        slope = np.einsum("mi,mij,mj->m", mode.conj(), slope, mode).real
        return np.where(moves, value, 0), slope, mode * (mode.conj() @ self._polarisation)[:, None]

    def solve(self, roots: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Wavenumbers times spacing at which the values of the branch are the squares of `roots`, with slopes and
        polarisations there.
        """
        angle = np.interp(roots, self._roots, self._angles)
        for _ in range(_NEWTON):
            value, slope, _ = self.at(angle)
            angle = np.where(roots > 0, angle - (value - roots**2) / slope, 0.0)
        return angle, *self.at(angle)[1:]


def _lagrange(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes 0, 1, 2, .. around each place, and their weights in polynomial interpolation; both of shape (n,
    _POINTS).
    """
    first = np.floor(place).astype(int) - (_POINTS // 2 - 1)
    index = first[:, None] + np.arange(_POINTS)
    difference = place[:, None] - index
    nodes = np.arange(_POINTS)
    weights = np.ones_like(difference)
    for j in nodes:
        other_nodes = nodes[nodes != j]
        weights[:, j] = np.prod(difference[:, other_nodes] / (j - other_nodes), axis=1)
    return index, weights

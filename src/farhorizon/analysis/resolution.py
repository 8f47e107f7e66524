"""Waves on a lattice: those that a field contains, the nodes per wavelength, and what dispersion does to a signal."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy import fft

from farhorizon.medium.integrators import ModifiedEquation, Verlet
from farhorizon.medium.stencil import Stencil

ENOUGH = 6.0  # nodes per wavelength of a well-resolved wave
_SAMPLES = 512  # samples of a branch between the middle and the edge of the Brillouin zone
_PARTS = (0.001, 0.5, 0.999)  # parts of the energy, counted from the longest wave
_MOMENTS = 2048  # number of times at which a source is sampled
_PADS = 2  # size of the box over that of the field: as much empty space again


class Resolution(NamedTuple):
    """How a lattice resolves the waves of a frequency."""

    #: Nodes per wavelength of the shortest wave along an axis or a diagonal; 0 where the lattice does not carry one of
    #: the waves, and infinite below the lowest frequency of a medium with a reaction.
    nodes: float
    #: Factor on spacing and time step with which the shortest wave would have `ENOUGH` nodes.
    scale: float


Scheme = Verlet | ModifiedEquation


def resolution(stencil: Stencil, rate: float, dt: float, frequency: float, scheme: Scheme | None = None) -> Resolution:
    """How a lattice resolves the waves of a frequency (cycles per time), by the dispersion of the stencil and of the
    time stepping, velocity Verlet unless given; `rate`, the squared speed over the squared spacing, is the factor on
    the stencil.
    """
    lines = [_branches(stencil, np.array(direction)) for direction in _directions(stencil.dim)]
    lowest = [float(np.interp(2 * np.pi / ENOUGH, numbers, branch)) for numbers, values in lines for branch in values.T]
    scheme = Verlet() if scheme is None else scheme
    enough = scheme.frequency_of_steps(min(lowest) * float(np.sqrt(rate)), dt)
    if frequency * dt >= 0.5:  # beyond the Nyquist frequency of the steps
        return Resolution(0.0, float(enough / frequency))
    root = float(scheme.frequency_of_nodes(np.array(frequency), dt)) / np.sqrt(rate)
    largest = max(_wavenumber(numbers, branch, root) for numbers, values in lines for branch in values.T)
    nodes = np.inf if largest == 0 else 2 * np.pi / largest
    return Resolution(float(nodes), float(enough / frequency))


Lines = list[tuple[np.ndarray, np.ndarray]]
"""Wavenumbers times spacing, and the frequency of one branch at them, along a direction."""


def lines_along(stencil: Stencil, way: np.ndarray) -> Lines:
    """The branches of a stencil without a reaction along a way, shape (dim,)."""
    numbers, values = _branches(stencil, way / np.abs(way).max())
    return [(numbers, branch) for branch in values.T if branch[1] > 0]


def delay(
    lines: Lines, rate: float, dt: float, frequency: float, distance: float, scheme: Scheme | None = None
) -> float:
    """Periods by which stencil and time stepping delay a wave of a frequency (cycles per time) on a way of some nodes,
    relative to long waves of the same type; negative if it is early. Of several types, that with the largest error;
    `rate` and `scheme` as in `resolution`.
    """
    phases = _phases(lines, rate, dt, np.array([frequency]), distance, scheme)
    return float(max((phase[0] for phase in phases), key=abs) / (2 * np.pi))


def trace_error(
    lines: Lines,
    rate: float,
    dt: float,
    frequencies: np.ndarray,
    amplitudes: np.ndarray,
    distance: float,
    scheme: Scheme | None = None,
) -> float:
    """Largest error, relative to the largest value, that stencil and time stepping make over a distance in nodes in a
    signal whose frequencies (n,), multiples of one from 0 on, have their peaks at the same time, for the type of waves
    that is delayed most; `rate` and `scheme` as in `resolution`.
    """
    phase = max(
        _phases(lines, rate, dt, frequencies, distance, scheme), key=lambda phase: float(amplitudes @ np.abs(phase))
    )
    error = np.fft.fft(amplitudes * (1 - np.exp(-1j * phase)), 8 * len(phase)).real  # eight times per shortest period
    return float(np.abs(error).max() / amplitudes.sum())


def _phases(
    lines: Lines, rate: float, dt: float, frequencies: np.ndarray, distance: float, scheme: Scheme | None
) -> list[np.ndarray]:
    """Phases by which waves of each type are behind long ones after a distance in nodes."""
    roots = (Verlet() if scheme is None else scheme).frequency_of_nodes(frequencies, dt) / np.sqrt(rate)
    omega = 2 * np.pi * frequencies / np.sqrt(rate)
    return [
        distance * (_wavenumbers(numbers, branch, roots) - omega * numbers[1] / branch[1]) for numbers, branch in lines
    ]


def _wavenumbers(numbers: np.ndarray, branch: np.ndarray, roots: np.ndarray) -> np.ndarray:
    """The wavenumbers up to the maximum of a branch at which it has some values; the last one where it stays below."""
    end = int(branch.argmax()) + 1
    return np.interp(roots, np.maximum.accumulate(branch[:end]), numbers[:end])


def _directions(dim: int) -> list[tuple[int, ...]]:
    """Axes and diagonals, one of each pair of opposite directions."""
    return [way for way in itertools.product((-1, 0, 1), repeat=dim) if way > (0,) * dim]


def _branches(stencil: Stencil, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Wavenumbers times spacing along a direction, from zero to the edge of the zone, and the frequencies of the
    branches there, roots of the eigenvalues of the symbol, shape (n, components).
    """
    part = np.linspace(0.0, np.pi, _SAMPLES)
    symbol = stencil.branches(*(part * n for n in direction))
    return part * float(np.linalg.norm(direction)), np.sqrt(np.maximum(symbol, 0.0))


def _wavenumber(numbers: np.ndarray, branch: np.ndarray, root: float) -> float:
    """The first wavenumber at which a branch has a value; 0 where it begins above, infinite where it stays below."""
    above = branch >= root
    if not above.any():
        return np.inf
    end = int(np.argmax(above))
    if end == 0:
        return 0.0
    return float(np.interp(root, branch[end - 1 : end + 1], numbers[end - 1 : end + 1]))


class Band(NamedTuple):
    """Wavelengths, from the spectrum of a field: a thousandth, half and all but a thousandth of the energy lies in
    longer waves.
    """

    longest: float
    typical: float
    shortest: float


def band(
    fields: Sequence[np.ndarray],
    spacing: float,
    orders: Sequence[int],
    gains: Sequence[Callable[[np.ndarray], np.ndarray] | None] | None = None,
) -> Band | None:
    """Wavelengths of the waves that fields of one shape radiate (nan counts as 0); None if the fields are zero. No wave
    is taken to be longer than four times the box or shorter than two spacings.

    `orders` are the powers of the wavenumber in the amplitude that counts: 1 for displacements, whose energy is in
    their gradient, 0 for velocities, sources and diffusing fields. `gains` are factors on each field's amplitude as
    functions of the wavenumber times spacing: the spectrum of a source in time.
    """
    shape = fields[0].shape
    box = [fft.next_fast_len(_PADS * n, real=True) for n in shape]
    angles = [2 * np.pi * np.fft.fftfreq(n) for n in box[:-1]] + [2 * np.pi * np.fft.rfftfreq(box[-1])]
    number = np.sqrt(np.asarray(sum(a**2 for a in np.ix_(*angles))))
    energy = np.zeros(number.shape)
    for values, order, gain in zip(fields, orders, gains or [None] * len(fields), strict=True):
        power = np.abs(fft.rfftn(np.nan_to_num(np.asarray(values, float)), box)) ** 2 * number ** (2 * order)
        if gain is not None:
            power = power * gain(number) ** 2
        if power.any():
            energy += power / power.sum()
    if not energy.any():
        return None
    order_of = np.argsort(number, axis=None)
    summed = np.cumsum(energy.ravel()[order_of])
    limits = number.ravel()[order_of][np.searchsorted(summed, np.array(_PARTS) * summed[-1])]
    longest, typical, shortest = (
        float(np.clip(2 * np.pi / max(k, 1e-9), 2.0, 4 * max(shape))) * spacing for k in limits
    )
    return Band(longest, typical, shortest)


def faded(values: np.ndarray, free: Sequence[tuple[bool, bool]]) -> np.ndarray:
    """Taper a scalar field (nan counts as 0) that continues beyond the lattice towards its sides, where a jump would
    count as short waves; where it ends at a `free` side, replace it by the half at that side and its mirror image.
    """
    for axis, (low, high) in enumerate(free):
        along = np.nan_to_num(np.moveaxis(values, axis, -1))
        n, half = along.shape[-1], along.shape[-1] // 2
        if half and (low or high):
            near = along[..., n - half :] if high else along[..., half - 1 :: -1]
            along = np.concatenate([near, near[..., ::-1], np.zeros_like(along[..., : n % 2])], -1)
        values = np.moveaxis(along * np.hanning(n + 2)[1:-1], -1, axis)
    return values


def gain_of_time(
    time: Callable[[float], float], until: float, rate: float, lowest: float = 0.0
) -> Callable[[np.ndarray], np.ndarray]:
    """Factor on the waves of a source due to its time function: its spectrum up to the end of the run at the frequency
    of each wavenumber. `rate` is speed over spacing, `lowest` the squared frequency of the longest waves; if it is
    negative they grow, and do not oscillate.
    """
    moments = np.linspace(0, until, _MOMENTS)
    values = np.array([time(float(t)) for t in moments])
    amplitudes = np.abs(np.fft.rfft(values, 2 * _MOMENTS))
    frequencies = 2 * np.pi * np.fft.rfftfreq(2 * _MOMENTS, moments[1])

    def gain(number: np.ndarray) -> np.ndarray:
        frequency = np.sqrt(np.maximum((rate * number) ** 2 + lowest, 0.0))
        return np.asarray(np.interp(frequency, frequencies, amplitudes, right=0.0))

    return gain


def gain_of_spectrum(
    spectrum: Callable[[np.ndarray], np.ndarray], longest: float, rate: float, lowest: float = 0.0
) -> Callable[[np.ndarray], np.ndarray]:
    """`gain_of_time` for a signal whose spectrum is a known function of the frequency in cycles per time; no period is
    taken to be longer than `longest`, as the spectrum of a permanent load is infinite at 0.
    """

    def gain(number: np.ndarray) -> np.ndarray:
        frequency = np.sqrt(np.maximum((rate * number) ** 2 + lowest, 0.0)) / (2 * np.pi)
        return np.abs(spectrum(np.maximum(frequency, 1 / longest)))

    return gain

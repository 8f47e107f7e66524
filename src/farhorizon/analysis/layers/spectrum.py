"""The wavelengths that a field contains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft

_SHARES = (0.001, 0.5, 0.999)  # shares of the energy, counted from the longest wave
_MOMENTS = 2048  # number of times at which a source is sampled
_PADS = 2  # size of the box over that of the field: as much empty space again


@dataclass(frozen=True)
class Band:
    """Wavelengths, from the spectrum of a field.

    Attributes
    ----------
    longest, typical, shortest : float
        A thousandth, half and all but a thousandth of the energy lies in longer waves.
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
    """Wavelengths of the waves that fields radiate.

    Parameters
    ----------
    fields : sequence of ndarray
        All of the same shape; nan counts as 0.
    spacing : float
    orders : sequence of int
        Power of the wavenumber in the amplitude that counts: 1 for displacements, whose energy is in their gradient, 0
        for velocities, sources and diffusing fields.
    gains : sequence of callable or None, optional
        Factor on each field's amplitude as a function of the wavenumber times spacing: the spectrum of a source in
        time.

    Returns
    -------
    Band or None
        None if the fields are zero. No wave is taken to be longer than four times the box or shorter than two spacings.
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
    passed = np.cumsum(energy.ravel()[order_of])
    found = number.ravel()[order_of][np.searchsorted(passed, np.array(_SHARES) * passed[-1])]
    longest, typical, shortest = (
        float(np.clip(2 * np.pi / max(k, 1e-9), 2.0, 4 * max(shape))) * spacing for k in found
    )
    return Band(longest, typical, shortest)


def faded(values: np.ndarray, free: Sequence[tuple[bool, bool]]) -> np.ndarray:
    """Taper a field that continues beyond the lattice towards its sides, where a jump would count as short waves.

    Parameters
    ----------
    values : ndarray
        A scalar field; nan counts as 0.
    free : sequence of (bool, bool)
        Whether it ends at the low and the high side of each axis: it is then replaced by the half of the lattice at
        that side and its mirror image, whose waves are as long.

    Returns
    -------
    ndarray
        Of the same shape.
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
    """Factor on the waves of a source due to its time function: its spectrum at the frequency of each wavenumber.

    Parameters
    ----------
    time : callable
    until : float
        End of the run.
    rate : float
        Speed over spacing.
    lowest : float
        Squared frequency of the longest waves; if it is negative they grow, and do not oscillate.
    """
    moments = np.linspace(0, until, _MOMENTS)
    values = np.array([time(float(t)) for t in moments])
    amplitudes = np.abs(np.fft.rfft(values, 2 * _MOMENTS))
    frequencies = 2 * np.pi * np.fft.rfftfreq(2 * _MOMENTS, moments[1])

    def gain(number: np.ndarray) -> np.ndarray:
        own = np.sqrt(np.maximum((rate * number) ** 2 + lowest, 0.0))
        return np.asarray(np.interp(own, frequencies, amplitudes, right=0.0))

    return gain


def gain_of_spectrum(
    spectrum: Callable[[np.ndarray], np.ndarray], longest: float, rate: float, lowest: float = 0.0
) -> Callable[[np.ndarray], np.ndarray]:
    """`gain_of_time` for a signal whose spectrum is known.

    Parameters
    ----------
    spectrum : callable
        Spectrum as a function of frequencies in cycles per time.
    longest : float
        Longest period that counts: the spectrum of a permanent load is infinite at 0.
    rate : float
        Speed over spacing.
    lowest : float
        Squared frequency of the longest waves.
    """

    def gain(number: np.ndarray) -> np.ndarray:
        frequency = np.sqrt(np.maximum((rate * number) ** 2 + lowest, 0.0)) / (2 * np.pi)
        return np.abs(spectrum(np.maximum(frequency, 1 / longest)))

    return gain

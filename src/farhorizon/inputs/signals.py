"""Signals: factors of time that begin at rest and whose spectra are known.

The spectrum of s is ``S(f) = integral of s(t) exp(-2 pi i f t) dt`` with the frequency f in cycles per time. It
determines, before a run, how short the waves of a source are.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from farhorizon import kinds
from farhorizon.arguments import Duration, Frequency, Registered
from farhorizon.errors import InputError
from farhorizon.files.foreign import naming, npy, reading
from farhorizon.files.storable import Storable

SMALL = 1e-3  # part of a signal that may lie above its highest frequency, and with which it may begin
_PER_LOBE = 8  # points of a sampled spectrum between two zeros of the spectrum of a box as long as the signal
_BEYOND = 1e-2  # of `SMALL`: what the upper half of the sampled frequencies may add
_MOST = 1 << 20  # points of a sampled spectrum, beyond which it counts as unlimited
_FEWEST = 4  # samples that a cubic spline needs
_PAD = 24  # samples added at each end, over which its effect on the spline's coefficients decays: 0.27**24 = 2e-14


class Signal(Registered, Storable, ABC):
    """A factor of time that begins at rest and has a known spectrum.

    A user-defined signal is a frozen dataclass that derives from this class and defines `end`, ``__call__`` and
    `spectrum`. Its fields are the keys of its table in case files.

    Attributes
    ----------
    tag : str
        Its `type` in a case file: ``ToneBurst`` is "tone-burst".
    known : dict of str to type
        All signals by name, including user-defined ones.

    Examples
    --------
    >>> import farhorizon as fh
    >>> isinstance(fh.Ricker(2.0), fh.Signal), fh.ToneBurst.tag
    (True, 'tone-burst')
    """

    tag: ClassVar[str]
    known: ClassVar[dict[str, type[Signal]]] = {}

    @property
    @abstractmethod
    def end(self) -> float:
        """Time after which the signal is constant: zero, unless it is a permanent load."""

    @abstractmethod
    def __call__(self, t: Any) -> Any:
        """The signal at a time, or at times of any shape."""

    @abstractmethod
    def spectrum(self, frequency: ArrayLike) -> np.ndarray:
        """Complex spectrum at frequencies in cycles per time, of their shape; infinite at 0 for a permanent load."""

    @property
    def highest_frequency(self) -> float:
        """Frequency, in cycles per time, above which less than a thousandth of the amplitude lies: the part of the
        signal above it never exceeds that fraction of the signal's largest value. Infinite if the spectrum decays too
        slowly for such a frequency to exist.

        The bound follows from the integral,
        ``|integral over |f| > F of S(f) exp(2 pi i f t) df| <= 2 integral from F of |S(f)| df``.
        """
        return self._frequencies[1]

    @property
    def median_frequency(self) -> float:
        """Frequency, in cycles per time, below which half of the amplitude lies, by the same integral."""
        return self._frequencies[0]

    @cached_property
    def _frequencies(self) -> tuple[float, float]:
        """Median and highest frequency. The range in which the spectrum is sampled is doubled until its upper half adds
        next to nothing and all of it accounts for the largest value.
        """
        peak = self._peak
        width, count = 1 / (_PER_LOBE * self.end), 8 * _PER_LOBE
        while count <= _MOST:
            share = 2 * width * self._amplitudes(width, count) / peak
            if share[count // 2 :].sum() < _BEYOND * SMALL and share.sum() > 0.9:
                above = share[::-1].cumsum()[::-1]
                return width * float(np.argmax(above < 0.5 * above[0])), width * float(np.argmax(above < SMALL))
            count *= 2
        return np.inf, np.inf

    @property
    def _peak(self) -> float:
        """Largest magnitude of the signal."""
        return float(np.abs(self(np.linspace(0.0, self.end, 4096))).max())  # a lobe of the fastest signal has tens

    def _amplitudes(self, width: float, count: int) -> np.ndarray:
        """Magnitude of the spectrum in the middle of each of `count` bands of equal width, from 0 on."""
        return np.abs(self.spectrum(width * (np.arange(count) + 0.5)))


def _number(value: Any, signal: Signal, name: str, **limits: Any) -> float:
    return kinds.number(value, f"{signal.tag}.{name}", **limits)


class _Pulse(Signal):
    """A signal that is nonzero everywhere, with its peak at a given delay or a suitable default."""

    delay: float | None

    @property
    def _centre(self) -> float:
        assert self.delay is not None
        return self.delay

    def _set_delay(self, default: float) -> None:
        """Store the delay; raises InputError if the value at t = 0 is not small."""
        kinds.set_fields(self, delay=default if self.delay is None else _number(self.delay, self, "delay", least=0))
        start = abs(float(self(0.0)))
        if start > SMALL:
            raise InputError(
                "the signal does not begin at rest: the run would start with a jump",
                value=f"{start:.3g} of the largest value at t = 0",
                limit=f"{SMALL:g}",
                key=f"{self.tag}.delay",
                remedy=f"delay = {default:.4g}, or leave it out",
            )


@dataclass(frozen=True)
class Ricker(_Pulse):
    r"""The Ricker wavelet, the second derivative of a Gaussian: the usual signal in seismology.

    ``(1 - 2 a) exp(-a)`` with :math:`a = (\pi f (t - t_0))^2`.

    Parameters
    ----------
    frequency : float
        Frequency at which the amplitude of its spectrum is largest, in cycles per time.
    delay : float, optional
        Time t0 of its peak, where it is 1; unless given 1.5 / frequency, with which it begins with a value of 1e-8.

    Raises
    ------
    InputError
        A frequency that is not positive, a delay so short that the signal does not begin at rest.

    Notes
    -----
    Ricker (1953), Geophysics 18(1), 10-40. Its spectrum has the magnitude ``2 / sqrt(pi) f^2 / f0^3 exp(-(f / f0)^2)``,
    and its highest frequency is 2.85 f0, which is sampled as 2.875 f0.

    Examples
    --------
    >>> import farhorizon as fh
    >>> pulse = fh.Ricker(2.0)
    >>> pulse.delay, float(pulse(0.75)), pulse.highest_frequency
    (0.75, 1.0, 5.75)
    """

    frequency: Frequency
    delay: Duration | None = None

    def __post_init__(self) -> None:
        kinds.set_fields(self, frequency=_number(self.frequency, self, "frequency", above=0))
        self._set_delay(1.5 / self.frequency)  # (1 - 2 a) exp(-a) is -1e-8 there, with a = (1.5 pi)^2

    @property
    def end(self) -> float:
        """End of the signal: as long after the peak as the default delay."""
        return self._centre + 1.5 / self.frequency

    def __call__(self, t: Any) -> Any:
        """The signal at a time, or at times of any shape."""
        phase = (np.pi * self.frequency * (np.asarray(t) - self._centre)) ** 2
        return (1 - 2 * phase) * np.exp(-phase)

    def spectrum(self, frequency: ArrayLike) -> np.ndarray:
        """Complex spectrum at frequencies in cycles per time, of the same shape as these."""
        f = np.asarray(frequency, float)
        size = 2 / np.sqrt(np.pi) * f**2 / self.frequency**3 * np.exp(-((f / self.frequency) ** 2))
        return np.asarray(size * np.exp(-2j * np.pi * f * self._centre))


@dataclass(frozen=True)
class Gaussian(_Pulse):
    r"""A Gaussian pulse.

    :math:`\exp(-((t - t_0) / w)^2)`.

    Parameters
    ----------
    width : float
        w, the time in which it decreases from 1 to 1/e.
    delay : float, optional
        Time t0 of its peak, where it is 1; unless given 4.5 widths, with which it begins with a value of 2e-9.

    Raises
    ------
    InputError
        A width that is not positive, a delay so short that the signal does not begin at rest.

    Examples
    --------
    >>> import farhorizon as fh
    >>> pulse = fh.Gaussian(width=2.0)
    >>> pulse.delay, float(pulse(9.0))
    (9.0, 1.0)
    """

    width: Duration
    delay: Duration | None = None

    def __post_init__(self) -> None:
        kinds.set_fields(self, width=_number(self.width, self, "width", above=0))
        self._set_delay(4.5 * self.width)  # exp(-4.5^2) is 2e-9

    @property
    def end(self) -> float:
        """End of the signal: 4.5 widths after the peak."""
        return self._centre + 4.5 * self.width

    def __call__(self, t: Any) -> Any:
        """The signal at a time, or at times of any shape."""
        return np.exp(-(((np.asarray(t) - self._centre) / self.width) ** 2))

    def spectrum(self, frequency: ArrayLike) -> np.ndarray:
        """Complex spectrum at frequencies in cycles per time, of the same shape as these."""
        f = np.asarray(frequency, float)
        size = np.sqrt(np.pi) * self.width * np.exp(-((np.pi * f * self.width) ** 2))
        return np.asarray(size * np.exp(-2j * np.pi * f * self._centre))


def _hann(t: np.ndarray, length: float) -> np.ndarray:
    """The Hann window ``sin(pi t / T)^2`` on 0 to T, zero outside."""
    return np.where((t > 0) & (t < length), np.sin(np.pi * t / length) ** 2, 0.0)


# Terms exp(2 pi i m t / T) of the Hann window: m and the coefficient
_HANN = ((0, 0.5), (1, -0.25), (-1, -0.25))


def _hann_spectrum(frequency: np.ndarray, length: float) -> np.ndarray:
    """Spectrum of the Hann window."""

    def box(f: np.ndarray) -> np.ndarray:
        return np.asarray(length * np.sinc(f * length) * np.exp(-1j * np.pi * f * length))

    return np.asarray(sum(weight * box(frequency - m / length) for m, weight in _HANN))


@dataclass(frozen=True)
class ToneBurst(Signal):
    r"""A few cycles of a sine in a Hann window: the usual signal in ultrasonic testing.

    :math:`\sin(2 \pi f t) \sin^2(\pi f t / n)` for ``0 < t < n / f``.

    Parameters
    ----------
    frequency : float
        Frequency f of the sine, in cycles per time.
    cycles : float
        Number n of cycles, at least 1.

    Raises
    ------
    InputError
        A frequency that is not positive, less than one cycle.

    Examples
    --------
    >>> import farhorizon as fh
    >>> burst = fh.ToneBurst(frequency=5e6, cycles=5)
    >>> round(burst.end * 1e6, 9), float(burst(0.0)), float(burst(1.0))
    (1.0, 0.0, 0.0)
    """

    frequency: Frequency
    cycles: float

    def __post_init__(self) -> None:
        kinds.set_fields(
            self,
            frequency=_number(self.frequency, self, "frequency", above=0),
            cycles=_number(self.cycles, self, "cycles", least=1),
        )

    @property
    def end(self) -> float:
        """End of the last cycle."""
        return self.cycles / self.frequency

    def __call__(self, t: Any) -> Any:
        """The signal at a time, or at times of any shape."""
        t = np.asarray(t, float)
        return np.sin(2 * np.pi * self.frequency * t) * _hann(t, self.end)

    def spectrum(self, frequency: ArrayLike) -> np.ndarray:
        """Complex spectrum at frequencies in cycles per time, of the same shape as these."""
        f = np.asarray(frequency, float)
        above, below = (_hann_spectrum(f - sign * self.frequency, self.end) for sign in (1, -1))
        return (above - below) / 2j


@dataclass(frozen=True)
class Step(Signal):
    r"""A load that rises smoothly from 0 to 1 and remains.

    :math:`t / T - \sin(2 \pi t / T) / (2 \pi)` for ``0 < t < T``.

    Parameters
    ----------
    rise : float
        Time T over which the load rises.

    Raises
    ------
    InputError
        A time that is not positive.

    Examples
    --------
    >>> import farhorizon as fh
    >>> load = fh.Step(rise=4.0)
    >>> [float(load(t)) for t in (0.0, 2.0, 4.0, 100.0)]
    [0.0, 0.5, 1.0, 1.0]
    """

    rise: Duration

    def __post_init__(self) -> None:
        kinds.set_fields(self, rise=_number(self.rise, self, "rise", above=0))

    @property
    def end(self) -> float:
        """The rise time."""
        return self.rise

    def __call__(self, t: Any) -> Any:
        """The signal at a time, or at times of any shape."""
        part = np.clip(np.asarray(t, float) / self.rise, 0.0, 1.0)
        return part - np.sin(2 * np.pi * part) / (2 * np.pi)

    def spectrum(self, frequency: ArrayLike) -> np.ndarray:
        """Complex spectrum at frequencies in cycles per time, of the same shape as these; infinite at 0."""
        f = np.asarray(frequency, float)
        rate = 2 / self.rise * _hann_spectrum(f, self.rise)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(f == 0, np.inf, rate / (2j * np.pi * f))


@dataclass(frozen=True)
class Chirp(Signal):
    r"""A sine whose frequency changes linearly from one value to another, in a Hann window.

    :math:`\sin(2 \pi (f_0 t + (f_1 - f_0) t^2 / 2T)) \sin^2(\pi t / T)` for ``0 < t < T``.

    Parameters
    ----------
    first, last : float
        Frequencies f0 and f1 at the start and at the end, in cycles per time.
    duration : float
        Duration T of the signal.

    Raises
    ------
    InputError
        Frequencies that are not positive or equal, a duration that is not positive.

    Examples
    --------
    >>> import farhorizon as fh
    >>> sweep = fh.Chirp(first=1.0, last=4.0, duration=10.0)
    >>> 4.0 < sweep.highest_frequency < 5.0
    True
    """

    first: Frequency
    last: Frequency
    duration: Duration

    def __post_init__(self) -> None:
        for name in ("first", "last", "duration"):
            kinds.set_fields(self, **{name: _number(getattr(self, name), self, name, above=0)})
        if self.first == self.last:
            raise InputError(
                "the frequency of a chirp changes",
                value=self.last,
                limit=f"another than first = {self.first:g}",
                key="chirp.last",
                remedy=f"ToneBurst({self.first:g}, {self.first * self.duration:g})",
            )

    @property
    def end(self) -> float:
        """The duration."""
        return self.duration

    def __call__(self, t: Any) -> Any:
        """The signal at a time, or at times of any shape."""
        t = np.asarray(t, float)
        cycles = self.first * t + (self.last - self.first) * t**2 / (2 * self.duration)
        return np.sin(2 * np.pi * cycles) * _hann(t, self.duration)

    def spectrum(self, frequency: ArrayLike) -> np.ndarray:
        """Complex spectrum at frequencies in cycles per time, of the same shape as these, by Fresnel integrals."""
        f, length = np.asarray(frequency, float), self.duration
        rate = (self.last - self.first) / length
        amplitudes = np.zeros(f.shape, complex)
        for m, weight in _HANN:
            up = _sweep(self.first + m / length - f, rate, length)
            down = _sweep(-self.first + m / length - f, -rate, length)
            amplitudes += weight * (up - down) / 2j
        return amplitudes


def _sweep(frequency: np.ndarray, rate: float, length: float) -> np.ndarray:
    """Integral of ``exp(2 pi i (frequency t + rate t^2 / 2))`` over t from 0 to `length`, for each frequency."""
    from scipy.special import fresnel

    if rate < 0:
        return _sweep(-frequency, -rate, length).conj()
    ends = [np.sqrt(2 * rate) * (t + frequency / rate) for t in (0.0, length)]
    (sine0, cosine0), (sine1, cosine1) = (fresnel(end) for end in ends)
    turned = np.exp(-1j * np.pi * frequency**2 / rate) / np.sqrt(2 * rate)
    return np.asarray(turned * (cosine1 - cosine0 + 1j * (sine1 - sine0)))


@dataclass(frozen=True, eq=False)
class Samples(Signal):
    """Samples of a signal, interpolated by a cubic spline.

    Where they begin or end with a jump or a kink, the spline overshoots.

    Parameters
    ----------
    values : array_like, shape (n,), or path
        Values at t = 0, dt, 2 dt, ...; after the last of them the signal stays constant. A file is a NumPy array (.npy)
        or a text file of numbers, with one sample per line, optionally preceded by its time.
    dt : float
        Time between two samples.

    Raises
    ------
    InputError
        Fewer than four samples, numbers that are not finite, samples that begin with more than a thousandth of the
        largest one or are all zero; a file whose times are not 0, dt, 2 dt, ...
    FileFormatError
        A file that cannot be read.

    Notes
    -----
    With the coefficients c of the cubic B-splines (Unser 1999, IEEE Signal Processing Magazine 16(6), eq 6), the
    spectrum is ``dt sinc(f dt)^4 sum_k c_k exp(-2 pi i f k dt)``.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> measured = fh.Samples(np.sin(np.pi * np.arange(41) / 40) ** 4, dt=0.25)
    >>> measured.end, round(float(measured(5.1)), 4), round(float(np.sin(np.pi * 5.1 / 10) ** 4), 4)
    (10.0, 0.998, 0.998)
    """

    values: Sequence[float] | np.ndarray | Path
    dt: Duration

    def __post_init__(self) -> None:
        dt = _number(self.dt, self, "dt", above=0)
        given = self.values
        with naming(given):
            values = _read(Path(given), dt) if isinstance(given, str | Path) else given
            values = _checked(kinds.array(values, "samples.values"))
        kinds.set_fields(self, values=values, dt=dt)

    @property
    def end(self) -> float:
        """Time of the last sample."""
        return (len(self.values) - 1) * self.dt  # type: ignore[arg-type]

    def __call__(self, t: Any) -> Any:
        """The signal at a time, or at times of any shape."""
        return self._spline(np.clip(np.asarray(t, float), *self._ends))[()]

    def spectrum(self, frequency: ArrayLike) -> np.ndarray:
        """Complex spectrum at frequencies in cycles per time, of the same shape as these; infinite at 0 if the last
        sample is not zero.
        """
        f = np.asarray(frequency, float)
        indices = np.arange(len(self._coefficients))
        # one by one: a table of all would be as large as the number of frequencies times that of samples
        sums = [
            (self._coefficients * np.exp(-2j * np.pi * frequency * self.dt * indices)).sum() for frequency in f.ravel()
        ]
        early = np.exp(2j * np.pi * f * _PAD * self.dt)  # the first coefficient is that of an added sample
        return self._whole(np.reshape(sums, f.shape), f) * early

    def _amplitudes(self, width: float, count: int) -> np.ndarray:
        from scipy.signal import czt

        turn = -2j * np.pi * width * self.dt
        sums = czt(self._coefficients, count, np.exp(turn), np.exp(-turn / 2))
        return np.abs(self._whole(sums, width * (np.arange(count) + 0.5)))

    def _whole(self, sums: np.ndarray, frequency: np.ndarray) -> np.ndarray:
        """The spectrum from the sums over the coefficients, including those of the value that remains."""
        last = float(self._spline.c[-1])
        with np.errstate(divide="ignore", invalid="ignore"):
            turn = np.exp(-2j * np.pi * frequency * self.dt)
            rest = last * turn ** len(self._coefficients) / (1 - turn) if last else 0.0
            return np.asarray(self.dt * np.sinc(frequency * self.dt) ** 4 * (sums + rest))

    @cached_property
    def _spline(self) -> Any:
        """Cubic spline through all samples, padded at both ends until the effect of the ends has decayed."""
        from scipy.interpolate import make_interp_spline

        values = np.concatenate([np.zeros(_PAD), np.asarray(self.values), np.full(_PAD, self.values[-1])])  # type: ignore
        times = self.dt * (np.arange(len(values)) - _PAD)
        return make_interp_spline(times, values, 3, bc_type="clamped")

    @property
    def _ends(self) -> tuple[float, float]:
        return float(self._spline.t[0]), float(self._spline.t[-1])

    @property
    def _coefficients(self) -> np.ndarray:
        """Coefficients of the B-splines about each sample; earlier ones are zero, later ones are the last value."""
        return np.asarray(self._spline.c[1:-1])


class Delayed(Signal, offered=False):
    """A signal with a delay, as emitted by one element of an array."""

    def __init__(self, signal: Signal, delay: float) -> None:
        self.signal, self.delay = signal, delay

    @property
    def end(self) -> float:
        """End of the signal, including the delay."""
        return self.signal.end + self.delay

    def __call__(self, t: Any) -> Any:
        """The signal at a time, or at times of any shape."""
        t = np.asarray(t, float)
        return np.where(t >= self.delay, self.signal(t - self.delay), 0.0)[()]

    def spectrum(self, frequency: ArrayLike) -> np.ndarray:
        """Complex spectrum at frequencies in cycles per time, of their shape."""
        return np.asarray(self.signal.spectrum(frequency) * np.exp(-2j * np.pi * np.asarray(frequency) * self.delay))


def _checked(values: np.ndarray) -> np.ndarray:
    """Samples of a signal that begins at rest."""
    if values.ndim != 1 or len(values) < _FEWEST:
        raise InputError(
            "a signal is one list of samples",
            value=f"shape {values.shape}",
            limit=f"at least {_FEWEST}",
            key="samples.values",
            remedy="one column, of more samples",
        )
    largest = float(np.abs(values).max())
    if not largest > 0:
        raise InputError(
            "all samples are zero", value=0, limit="one that is not", key="samples.values", remedy="leave it out"
        )
    kinds.check_magnitude(largest, "samples.values")
    if abs(values[0]) > SMALL * largest:
        raise InputError(
            "the signal does not begin at rest: the run would start with a jump",
            value=f"{abs(values[0]) / largest:.3g} of the largest sample at t = 0",
            limit=f"{SMALL:g}",
            key="samples.values",
            remedy="subtract what it begins with, or let it rise over some samples",
        )
    return values


def _read(path: Path, dt: float) -> np.ndarray:
    """The samples in a file, which contains no times or those of samples `dt` apart."""
    with reading(path, "the samples", "samples.values", "one number a line, or a .npy file"):
        if path.suffix.lower() == ".npy":
            values = npy(path)
        else:
            values = np.loadtxt(path.read_text(encoding="utf-8").replace(",", " ").splitlines(), ndmin=1)
    if values.ndim != 2 or values.shape[1] != 2:
        return np.asarray(values)
    times, values = kinds.array(values, "samples.values").T
    if np.abs(times - dt * np.arange(len(times))).max() > 1e-3 * dt:
        step = (times[-1] - times[0]) / max(len(times) - 1, 1)
        raise InputError(
            "the times in the file are not those of the samples",
            value=f"{len(times)} from {times[0]:.6g} on, {step:.6g} apart",
            limit=f"0, dt, 2 dt, ... with dt = {dt:g}",
            key="samples.dt",
            remedy=f"dt = {step:.6g}, times from 0 on in the unit of the run's, or a file of values alone",
        )
    return values

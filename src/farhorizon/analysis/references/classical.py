"""Solutions of the classical heat equation: the slab, and the line source in the infinite medium.

Series are truncated where a bound of the remainder falls below the target error. Lengths, times and temperatures are in
any consistent units. Carslaw and Jaeger (1959), chapters 3 and 10; Bobaru and Duangpanya (2010), eqs 31 to 44, with
the misprints of eqs 33, 38, 39 and 43 corrected.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from farhorizon.errors import InputError
from farhorizon.rounding import EQUAL

_MOST_TERMS = 2_000_000  # of a series: some seconds
_BLOCK = 1 << 20  # numbers in one table of eigenfunctions


@dataclass(frozen=True)
class End:
    """Condition at one end of a slab: a temperature, or the slope dT/dx if `slope` is set, 0 for an insulated end."""

    value: float = 0.0
    slope: bool = False


@dataclass(frozen=True)
class Slab:
    """Slab ``0 < x < length`` whose ends are kept at a temperature or at a slope; at the start the pieces (lower,
    upper, temperature) are at a temperature, and all else is at 0.
    """

    length: float
    diffusivity: float
    pieces: Sequence[tuple[float, float, float]]
    left: End = End()
    right: End = End()

    def __post_init__(self) -> None:
        for name in ("length", "diffusivity"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise InputError("must be finite and positive", value=value, limit="> 0", key=name)
        for low, high, _ in self.pieces:
            if not 0 <= low < high <= self.length * (1 + EQUAL):
                raise InputError(
                    "a piece of the start must lie in the slab",
                    value=(low, high),
                    limit=f"0 to {self.length}",
                    key="pieces",
                )

    def temperature(self, x: ArrayLike, t: float, error: float = 1e-13) -> np.ndarray:
        """Temperature at positions x, shape of x; at t = 0 the start itself, between two pieces their mean. The
        truncation error of the series is at most `error` relative to the mean of |start less steady state|.
        """
        return self._sum(np.asarray(x, float), t, error, 0)

    def gradient(self, x: ArrayLike, t: float, error: float = 1e-13) -> np.ndarray:
        """Slope dT/dx at positions x for t > 0; the heat flux is ``-conductivity`` times it.

        `error` is relative to that mean divided by the length.
        """
        if t <= 0:
            raise InputError("the gradient of a start with jumps is not a function", value=t, limit="> 0", key="t")
        return self._sum(np.asarray(x, float), t, error, 1)

    # The state is polynomial + drift t + sum of amplitude_n phi_n(x) exp(-diffusivity k_n^2 t); phi is a sine where the
    # left end is at a temperature, else a cosine.

    @property
    def _steady(self) -> tuple[np.ndarray, float]:
        """Polynomial (c0, c1, c2) that satisfies both end conditions, and its rate of change (two different slopes heat
        the slab).
        """
        left, right, length = self.left, self.right, self.length
        if left.slope and right.slope:
            bend = (right.value - left.value) / (2 * length)
            return np.array([0.0, left.value, bend]), 2 * bend * self.diffusivity
        if left.slope:
            return np.array([right.value - left.value * length, left.value, 0.0]), 0.0
        slope = right.value if right.slope else (right.value - left.value) / length
        return np.array([left.value, slope, 0.0]), 0.0

    def _wavenumbers(self, first: int, last: int) -> np.ndarray:
        start = {(False, False): 1.0, (True, True): 0.0}.get((self.left.slope, self.right.slope), 0.5)
        return (start + np.arange(first, last)) * np.pi / self.length

    def _amplitudes(self, k: np.ndarray) -> np.ndarray:
        """Coefficients of the start less the polynomial, by closed integrals of x^j exp(i k x)."""
        polynomial, _ = self._steady
        flat = k == 0
        wave = np.where(flat, 1.0, k)

        def integral(power: int, low: float, high: float) -> np.ndarray:
            total = np.zeros(k.shape, complex)
            for x, sign in ((high, 1), (low, -1)):
                for j in range(power + 1):
                    total += (
                        sign
                        * (-1) ** j
                        * math.perm(power, j)
                        * x ** (power - j)
                        / (1j * wave) ** (j + 1)
                        * np.exp(1j * wave * x)
                    )
            return np.where(flat, (high ** (power + 1) - low ** (power + 1)) / (power + 1), total)

        moments = sum((value * integral(0, low, high) for low, high, value in self.pieces), np.zeros(k.shape, complex))
        moments = moments - sum(c * integral(j, 0.0, self.length) for j, c in enumerate(polynomial))
        norm = np.where(flat, 1.0, 2.0) / self.length
        return norm * (moments.real if self.left.slope else moments.imag)

    def _terms(self, t: float, error: float, derivative: int) -> int:
        """Number of terms after which the bound ``sum of 2 (k length)^derivative exp(-diffusivity k^2 t)`` is below the
        error.
        """
        count = 1
        step = np.pi / self.length
        while count < _MOST_TERMS:
            k = float(self._wavenumbers(count, count + 1)[0])
            ratio = ((k + step) / k) ** derivative * np.exp(-self.diffusivity * t * step * (2 * k + step))
            if (
                ratio < 1
                and 2 * (k * self.length) ** derivative * np.exp(-self.diffusivity * k**2 * t) / (1 - ratio) < error
            ):
                return count
            count = int(count * 1.2) + 1  # a fifth too many terms cost no more than more searching
        raise InputError(
            "so early that the series is useless", value=t, key="t", remedy="half_space: no end has noticed the other"
        )

    def _beyond(self, x: np.ndarray, place: float) -> np.ndarray:
        """1 beyond a place, 0 before it, 1/2 at it (to rounding)."""
        gap = x - place
        return np.heaviside(np.where(np.abs(gap) < EQUAL * self.length, 0.0, gap), 0.5)

    def _sum(self, x: np.ndarray, t: float, error: float, derivative: int) -> np.ndarray:
        if t <= 0:
            return sum(
                (value * (self._beyond(x, low) - self._beyond(x, high)) for low, high, value in self.pieces),
                np.zeros_like(x),
            )
        polynomial, drift = self._steady
        c0, c1, c2 = polynomial
        total = c0 + drift * t + x * (c1 + c2 * x) if derivative == 0 else c1 + 2 * c2 * x
        points = x.ravel()
        series = np.zeros(points.shape)
        last = self._terms(t, error, derivative)
        block = max(1, _BLOCK // max(points.size, 1))
        for first in range(0, last, block):
            k = self._wavenumbers(first, min(first + block, last))
            strength = self._amplitudes(k) * np.exp(-self.diffusivity * k**2 * t)
            angle = np.multiply.outer(points, k)
            if derivative == 0:
                series += (np.cos(angle) if self.left.slope else np.sin(angle)) @ strength
            else:
                series += (-np.sin(angle) if self.left.slope else np.cos(angle)) @ (strength * k)
        return total + series.reshape(x.shape)


def line_source(
    r: ArrayLike, t: float, diffusivity: float, conductivity: float, power: float, width: float = 0.0
) -> np.ndarray:
    """Infinite medium, initially at 0, around a line that heats it with constant power per length from t = 0 on, spread
    as ``exp(-(r / width)^2) / (pi width^2)`` (Carslaw and Jaeger, 10.4).
    """
    squared = np.asarray(r, float) ** 2
    late = squared / (width**2 + 4 * diffusivity * t)
    if not width:
        return power / (4 * np.pi * conductivity) * special.exp1(late)
    # E1(a) - E1(b) = Ein(a) - Ein(b) + log(b / a): the logarithms of r cancel, so that there is a value on the axis
    early = squared / width**2
    safe = np.where(squared > 0, 1.0, 0.0)
    smooth = np.where(
        squared > 0,
        special.exp1(np.where(safe, late, 1.0)) - special.exp1(np.where(safe, early, 1.0)),
        np.log1p(4 * diffusivity * t / width**2),
    )
    return power / (4 * np.pi * conductivity) * smooth

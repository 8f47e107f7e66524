"""Stability of a linear one-step map: the spectral radius of the complete update, by dense eigenvalues or by Krylov spaces of its powers.

A map is stable if no eigenvalue lies outside the unit circle by more than `TOLERANCE` per unit time. Every number comes with a bound of what
rounding and unfinished iterations may hide: where that bound reaches across the tolerance, nothing is claimed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

#: Growth per unit time, (spectral radius - 1)/dt, up to which a map counts as stable.
TOLERANCE = 1e-10
_NOISE = 8  # crossing times of white noise before
_LEAST = 12  # crossing times in Krylov vectors, at least: a mode that grows slowly may hide behind one that decays slowly
_RAISE = 8  # factor from one power of the map to the next
_EXPLODED = 1e6  # growth of white noise over a run that is no transient any more


@dataclass(frozen=True)
class Growth:
    """What is known of the fastest growing mode of a map.

    Attributes
    ----------
    rate : float
        Growth per unit time, (|factor| - 1)/dt; negative: it decays.
    error : float
        By how much the rate may be wrong.
    factor : complex
        Factor that the mode gains in a step.
    mode : ndarray of complex
        The state that grows; empty where none was asked for.
    """

    rate: float
    error: float
    factor: complex
    mode: np.ndarray

    @property
    def stable(self) -> bool | None:
        """Whether nothing grows; None if it cannot be told."""
        if self.rate + self.error <= TOLERANCE:
            return True
        return False if self.rate - self.error > TOLERANCE else None

    @property
    def angle(self) -> float:
        """Phase that the mode gains in a step, frequency times dt."""
        return float(abs(np.angle(self.factor)))


def fastest(found: Sequence[Growth]) -> Growth:
    """The one that decides: the fastest certain growth, else that with the largest rate and error."""
    growing = [g for g in found if g.stable is False]
    return max(growing, key=lambda g: g.rate) if growing else max(found, key=lambda g: g.rate + g.error)


def dense_growth(matrix: np.ndarray, dt: float) -> Growth:
    """Fastest mode of a map that is given as a matrix, by its eigenvalues.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
        The map of one step.
    dt : float
        Time step.

    Returns
    -------
    Growth
        The error is that of rounding, ``4 eps |G| / |y . x|`` with the eigenvectors x and y of the map and its transpose.
    """
    if np.iscomplexobj(matrix) and np.abs(matrix.imag).max(initial=0) <= 1e-15 * np.abs(matrix).max(initial=0):
        matrix = matrix.real
    factors = linalg.eigvals(matrix, check_finite=False)
    order = np.argsort(-np.abs(factors))
    size = np.linalg.norm(matrix)
    found = []
    for factor in factors[order[: min(4, len(order))]]:  # of some that are as large, an ill-conditioned one decides
        right, left = _eigenvectors(matrix, factor)
        error = 4 * np.finfo(float).eps * size / max(abs(np.vdot(left, right)), 1e-300)
        found.append(Growth((abs(factor) - 1) / dt, error / dt, complex(factor), right))
    return fastest(found)


def _eigenvectors(matrix: np.ndarray, factor: complex) -> tuple[np.ndarray, np.ndarray]:
    """Right and left eigenvectors of length 1 by inverse iteration, the left one for ``y^H G = factor y^H``."""
    shifted = matrix - (factor * (1 + 1e-14) + 1e-300) * np.eye(len(matrix))
    solve = linalg.lu_factor(shifted, check_finite=False)
    vectors = []
    for transposed in (0, 2):
        x = np.random.default_rng(0).standard_normal(len(matrix)).astype(complex)
        for _ in range(3):
            x = linalg.lu_solve(solve, x, trans=transposed, check_finite=False)
            x = x / np.linalg.norm(x)
        vectors.append(x)
    return vectors[0], vectors[1]


def krylov_growth(
    advance: Callable[[np.ndarray, int], np.ndarray], size: int, dt: float, crossing: int, budget: float, seed: int = 0, subspace: int = 16
) -> Growth:
    """Fastest mode of a map that can only be applied, from white noise.

    Noise runs for some crossing times; then Krylov spaces of powers of the map are built, of ever higher powers, until the largest eigenvalue has
    settled inside or outside the unit circle: in a high power what decays has died out, and few vectors tell the rest apart.

    Parameters
    ----------
    advance : callable
        State and number of steps to the state after them.
    size : int
        Numbers in a state.
    dt : float
        Time step.
    crossing : int
        Steps in which the fastest wave, or half of what diffuses, crosses the near field and the layers.
    budget : float
        Seconds after which it gives up.
    seed : int
        Of the noise.
    subspace : int
        Most vectors in a Krylov space.

    Returns
    -------
    Growth
        The error is that of the eigenvalue problem's residual, and infinite if time ran out before anything was found.
    """
    end = time.monotonic() + budget
    start = np.random.default_rng(seed).standard_normal(size)
    x, before = advance(start, crossing), 0.0
    for _ in range(_NOISE):
        before, x = float(np.linalg.norm(x)), advance(x, crossing)
        now = float(np.linalg.norm(x))
        if not now < _EXPLODED * np.linalg.norm(start):
            rate = np.log(now / before) / (crossing * dt) if np.isfinite(now) else np.inf
            return Growth(float(rate), 0.1 * abs(float(rate)) if np.isfinite(rate) else 0.0, complex(np.exp(min(rate, 1e3) * dt)), x / now)
        if time.monotonic() > end:
            return Growth(0.0, np.inf, 1.0, np.zeros(0))
    power, best = crossing, Growth(0.0, np.inf, 1.0, np.zeros(0))
    while time.monotonic() < end:
        least = max(4, -(-_LEAST * crossing // power))
        found, x = _arnoldi(lambda v: advance(v, power), x, power, dt, least, min(subspace, size), end)  # noqa: B023
        if found is not None and (found.error < best.error or found.stable is not None):
            best = found
        if best.stable is not None:
            break
        power *= _RAISE
    return best


def _arnoldi(
    apply: Callable[[np.ndarray], np.ndarray], start: np.ndarray, power: int, dt: float, least: int, subspace: int, end: float
) -> tuple[Growth | None, np.ndarray]:
    """Leading eigenvalue of a power of a map in a Krylov space, which ends as soon as it is settled; and the vector to go on with."""
    length = float(np.linalg.norm(start))
    if length < 1e-200:  # noise has died out altogether
        return Growth(-1 / (power * dt), 0.0, 0.0, np.zeros(0)), start
    basis, projected = [start / length], np.zeros((subspace + 1, subspace))
    found, ahead = None, start
    for k in range(subspace):
        image = apply(basis[k])
        for _ in range(2):  # twice, to be orthogonal to rounding
            for j, b in enumerate(basis):
                share = float(b @ image)
                projected[j, k] += share
                image = image - share * b
        rest = float(np.linalg.norm(image))
        projected[k + 1, k] = rest
        if k % 4 == 3 or k == subspace - 1 or rest < 1e-14 or time.monotonic() > end:
            values, left, right = linalg.eig(projected[: k + 1, : k + 1], left=True, right=True)
            i = int(np.argmax(np.abs(values)))
            condition = np.linalg.norm(left[:, i]) * np.linalg.norm(right[:, i]) / max(abs(np.vdot(left[:, i], right[:, i])), 1e-300)
            residual = rest * abs(right[k, i]) / np.linalg.norm(right[:, i])
            growth = abs(values[i]) ** (1 / power)
            error = 10 * condition * max(residual, 1e-15) / max(abs(values[i]), 1e-300)
            mode = np.array(basis).T @ right[:, i]
            ahead = mode.real if np.linalg.norm(mode.real) > np.linalg.norm(mode.imag) else mode.imag
            rate = np.log(abs(values[i])) / (power * dt) if values[i] else -np.inf
            found = Growth(float(rate), float(np.log1p(min(error, 1e300)) / (power * dt)), complex(growth), mode)
            if (found.stable is not None and k + 1 >= least) or rest < 1e-14 or time.monotonic() > end:
                break
        basis.append(image / rest)
    return found, ahead

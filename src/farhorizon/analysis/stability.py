"""Stability of a linear one-step map: the spectral radius of the complete update, from dense eigenvalues or from Krylov
spaces of its powers.

A map is stable if no eigenvalue lies outside the unit circle by more than `TOLERANCE` per unit of time. That unit is
the crossing time of the set-up (`Run.crossing`), so that a verdict does not depend on units of measurement; ``dt`` is
the step in it. Every number comes with a bound on what rounding and unfinished iterations may hide: where that bound
reaches across the tolerance, nothing is claimed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

#: Largest growth per crossing, (spectral radius - 1)/dt, of a map that counts as stable.
TOLERANCE = 1e-10
SHORT = 10  # crossing times of white noise that run before anything else
_NOISE = 20  # the same before Krylov spaces
_LONG = 120  # crossing times of noise where Krylov spaces are inconclusive
# smallest number of Krylov vectors of the first power: a mode that grows slowly may hide behind one that decays slowly
_LEAST = 12
_RAISE = 8  # factor from one power of the map to the next
_POWERS = 2  # number of powers that are tried
_CLEAR = 1e-6  # a factor this far inside the unit circle is doubtful only with a condition number of a thousand million
_RISES = 2.0  # rise over the last third of a short run, above that of what grows in proportion to time
_VECTORS = 16  # largest number of vectors of a Krylov space
# largest error over rate of growth that a short run reports: the error is of first order, and larger for modes that
# nearly coincide
_SURE = 0.5
DENSE = 700  # largest size of a state for which all eigenvalues are computed, which takes a second
_EXPLODED = 1e6  # growth of white noise over a run that cannot be a transient
_SLOWS = 0.9  # part of the rise in the previous third: exponential growth rises by as much, or by more and more
_UNWATCHED = 1000  # steps of noise between two checks of the time


@dataclass(frozen=True)
class Growth:
    """What is known of the fastest growing mode of a map.

    Attributes
    ----------
    rate : float
        Growth per crossing, (|factor| - 1)/dt; negative if the mode decays.
    error : float
        Bound on the error of the rate.
    factor : complex
        Factor of the mode per step.
    mode : ndarray of complex
        The growing state; empty if it was not requested.
    hidden : float
        Growth per crossing that could have gone unnoticed in a run from noise; 0 for a rate from eigenvalues.
    """

    rate: float
    error: float
    factor: complex
    mode: np.ndarray
    hidden: float = 0.0

    @property
    def stable(self) -> bool | None:
        """Whether nothing grows; None if this is not known."""
        if self.rate + self.error <= TOLERANCE:
            return True
        return False if self.rate - self.error > TOLERANCE else None

    @property
    def angle(self) -> float:
        """Phase of the mode per step, frequency times dt."""
        return float(abs(np.angle(self.factor)))


def fastest(found: Sequence[Growth]) -> Growth:
    """The result that decides: the fastest certain growth, or else that with the largest sum of rate and error."""
    growing = [g for g in found if g.stable is False]
    return max(growing, key=lambda g: g.rate) if growing else max(found, key=lambda g: g.rate + g.error)


def dense_growth(matrix: np.ndarray, dt: float) -> Growth:
    """Fastest mode of a map that is given as a matrix, from its eigenvalues.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
        The map of one step.
    dt : float
        Time step in crossings.

    Returns
    -------
    Growth
        Its error is that of rounding, ``4 eps |G| / |y . x|`` with the eigenvectors x and y of the map and its
        transpose.
    """
    if np.iscomplexobj(matrix) and np.abs(matrix.imag).max(initial=0) <= 1e-15 * np.abs(matrix).max(initial=0):
        matrix = matrix.real
    factors = linalg.eigvals(matrix, check_finite=False)
    order = np.argsort(-np.abs(factors))
    size = np.linalg.norm(matrix)
    found: list[Growth] = []
    # among factors equally close to 1, an ill-conditioned one decides
    for factor in factors[order[: min(4, len(order))]]:
        if found and abs(factor) < 1 - _CLEAR:
            break
        right, left = _eigenvectors(matrix, factor)
        error = 4 * np.finfo(float).eps * size / max(abs(np.vdot(left, right)), 1e-300)
        found.append(Growth((abs(factor) - 1) / dt, error / dt, complex(factor), right))
    return fastest(found)


def _eigenvectors(matrix: np.ndarray, factor: complex) -> tuple[np.ndarray, np.ndarray]:
    """Right and left eigenvectors of length 1 by inverse iteration; the left one solves ``y^H G = factor y^H``."""
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
    advance: Callable[[np.ndarray, int], np.ndarray],
    size: int,
    dt: float,
    crossing: int,
    budget: float,
    seed: int = 0,
    subspace: int = _VECTORS,
) -> Growth:
    """Fastest mode of a map that can only be applied, from white noise.

    Noise runs for 20 crossing times; then Krylov spaces of ever higher powers of the map are built: in a high power the
    decaying part has disappeared, and few vectors separate the rest. Near the factor 1, slowly decaying modes may be
    too close to each other for that. Noise then runs on to 120 crossing times, and if its size decreases over the last
    third of them, that is the result.

    Parameters
    ----------
    advance : callable
        Maps a state and a number of steps to the state after these steps.
    size : int
        Size of a state.
    dt : float
        Time step in crossings.
    crossing : int
        Number of steps in which the fastest wave, or a substantial part of a diffusing field, crosses the whole domain
        of the map, layers included.
    budget : float
        Seconds after which it gives up.
    seed : int
        Of the noise.
    subspace : int
        Largest number of vectors in a Krylov space.

    Returns
    -------
    Growth
        Its error is that of the eigenvalue problem's residual, 0 with `hidden` set where a long run decides, and
        infinite if time ran out.
    """
    begin = time.monotonic()
    end, unknown = begin + budget, Growth(0.0, np.inf, 1.0, np.zeros(0))
    noise = _Noise(advance, size, dt, crossing, seed)
    if not noise.run(_NOISE, end):
        return noise.explosion() or unknown
    pace = (time.monotonic() - begin) / _NOISE
    power, x = crossing, noise.state
    for _ in range(_POWERS):
        left, spaces, long = end - time.monotonic(), subspace * power / crossing * pace, (_LONG - _NOISE) * pace
        if spaces > left or spaces + long > left >= long:  # the long run must follow, where there is time for it
            break
        least = max(4, _LEAST * crossing // power)
        found, x = _arnoldi(lambda v: advance(v, power), x, power, dt, least, min(subspace, size))  # noqa: B023
        if found.stable is not None:
            return found
        power *= _RAISE
    until = _LONG
    while noise.run(until, end):
        found = noise.decay()
        if found.stable is not None:
            return found
        until *= 2  # modes that nearly coincide add up before they decay
    return noise.explosion() or unknown


def noise_growth(
    advance: Callable[[np.ndarray, int], np.ndarray],
    size: int,
    dt: float,
    crossing: int,
    budget: float,
    crossings: float = np.inf,
    seed: int = 0,
    longest: float = np.inf,
) -> tuple[Growth | None, float]:
    """Growth seen in a short run from white noise, of a map that can only be applied: a cheap test, before anything
    else is examined.

    Parameters
    ----------
    advance, size, dt, crossing, budget, seed
        As for `krylov_growth`.
    crossings : float
        Length of the run in question, in crossing times of the domain of the map; noise runs for as long, but at most
        ten crossing times. If it is finite, this is not limited by the budget, since it takes less time than the run
        itself, and the budget is for what follows where noise rises.
    longest : float
        Limit in seconds in that case.

    Returns
    -------
    Growth or None
        Noise that rises over the last third of the run is continued, and a Krylov space of the map distinguishes growth
        from a transient. A state that is still twice as large at the end as at two thirds when time is up counts as
        growth, unless its rise slows down, as that of a power of time does. None if no growth is seen.
    float
        Crossing times for which noise ran: fewer than requested if there was no time.
    """
    begin, asked = time.monotonic(), bool(np.isfinite(crossings))
    share = min(crossings / SHORT, 1.0)
    piece = max(1, int(np.ceil(crossing * share)))  # a shorter run is sampled as often
    noise = _Noise(advance, size, dt, piece, seed)
    whole = noise.run(SHORT, begin + (longest if asked else budget))
    end = budget + (time.monotonic() if asked else begin)
    if noise.explosion() is not None:
        return noise.explosion(), 0.0
    length = len(noise.sizes) - 1
    # soon after the start noise may grow in proportion to time, because its velocities are those of short waves
    least = 1.0 if whole and share == 1 else _RISES
    # few vectors cannot separate modes that nearly coincide, such as those of a drift
    if size <= DENSE and noise.rise() > least:
        found = dense_growth(np.stack([advance(unit, 1) for unit in np.eye(size)], axis=1), dt)
        if found.stable is not None:
            return (None if found.stable else found), length * share
    while noise.rise() > least and time.monotonic() < end:
        found, _ = _arnoldi(lambda v: advance(v, crossing), noise.state, crossing, dt, 4, min(_VECTORS, size))
        if found.stable is False and found.error < _SURE * found.rate:
            return found, length * share
        length *= 2
        if not noise.run(length, end):
            break
    grows = noise.rise() > _RISES and not noise.slows()
    growth = noise.explosion() or (replace(noise.decay(), error=0.0) if grows else None)
    return growth, length * share


class _Noise:
    """A run from white noise, with the size of its state after each crossing time."""

    def __init__(
        self, advance: Callable[[np.ndarray, int], np.ndarray], size: int, dt: float, crossing: int, seed: int
    ) -> None:
        self.advance, self.dt, self.crossing = advance, dt, crossing
        self.state = np.random.default_rng(seed).standard_normal(size)
        self.sizes = [float(np.linalg.norm(self.state))]

    def run(self, until: int, end: float) -> bool:
        """Continue to a number of crossing times; return False if the state exploded or time ran out before."""
        while len(self.sizes) <= until:
            for done in range(0, self.crossing, _UNWATCHED):  # steps may be so short that one crossing takes days
                self.state = self.advance(self.state, min(_UNWATCHED, self.crossing - done))
                if time.monotonic() > end:
                    return False
            self.sizes.append(float(np.linalg.norm(self.state)))
            if not self.sizes[-1] < _EXPLODED * self.sizes[0]:
                return False
        return True

    def explosion(self) -> Growth | None:
        """The growth of a state that exploded; None if it did not."""
        if self.sizes[-1] < _EXPLODED * self.sizes[0]:
            return None
        finite = [s for s in self.sizes if np.isfinite(s)]
        late = finite[len(finite) // 2 :] if len(finite) > 3 else finite
        rate = np.log(late[-1] / late[0]) / ((len(late) - 1) * self.crossing * self.dt) if len(late) > 1 else np.inf
        mode = self.state / self.sizes[-1] if np.isfinite(self.sizes[-1]) else np.zeros(0)
        return Growth(
            float(rate),
            0.0 if np.isinf(rate) else 0.1 * abs(float(rate)),
            complex(np.exp(min(rate, 1e3) * self.dt)),
            mode.astype(complex),
        )

    def rise(self) -> float:
        """Size of the state over its size at two thirds of the run."""
        return self.sizes[-1] / max(self.sizes[-1 - (len(self.sizes) - 1) // 3], 1e-300)

    def slows(self) -> bool:
        """Whether the state rose less in the last third of the run than in the previous one."""
        third = (len(self.sizes) - 1) // 3
        before = self.sizes[-1 - third] / max(self.sizes[-1 - 2 * third], 1e-300)
        return self.rise() < _SLOWS * before

    def decay(self) -> Growth:
        """Growth or decay over the last third of the run."""
        count = len(self.sizes) - 1
        last = self.sizes[-1 - count // 3 :]
        span = (len(last) - 1) * self.crossing * self.dt
        rate = float(np.log(max(last[-1], 1e-300) / max(last[0], 1e-300)) / span)
        hidden = 0.5 * np.log(len(self.state)) / (count * self.crossing * self.dt)
        return Growth(rate, 0.0 if rate < 0 else np.inf, complex(np.exp(rate * self.dt)), np.zeros(0), hidden)


def _arnoldi(
    apply: Callable[[np.ndarray], np.ndarray], start: np.ndarray, power: int, dt: float, least: int, subspace: int
) -> tuple[Growth, np.ndarray]:
    """Leading eigenvalue of a power of a map in a Krylov space, which ends as soon as the verdict is certain; and the
    vector with which to continue.
    """
    length = float(np.linalg.norm(start))
    if length < 1e-200:  # the noise has decayed completely
        return Growth(-1 / (power * dt), 0.0, 0.0, np.zeros(0)), start
    basis, projected = [start / length], np.zeros((subspace + 1, subspace))
    for k in range(subspace):
        image = apply(basis[k])
        for _ in range(2):  # twice, for orthogonality to rounding
            for j, b in enumerate(basis):
                share = float(b @ image)
                projected[j, k] += share
                image = image - share * b
        rest = float(np.linalg.norm(image))
        projected[k + 1, k] = rest
        last = k + 1 == subspace or rest < 1e-14
        if last or (k % 4 == 3 and k + 1 >= least):
            found = _leading(projected[: k + 1, : k + 1], rest, basis, power, dt)
            if last or found.stable is not None:
                break
        basis.append(image / rest)
    parts = found.mode.real, found.mode.imag
    return found, max(parts, key=lambda p: float(np.linalg.norm(p)))


def _leading(projected: np.ndarray, rest: float, basis: Sequence[np.ndarray], power: int, dt: float) -> Growth:
    """Largest eigenvalue of a power of a map in a Krylov space; the error is ten times the residual times the condition
    number.
    """
    values, left, right = linalg.eig(projected, left=True, right=True)
    i = int(np.argmax(np.abs(values)))
    size, x, y = max(float(np.abs(values[i])), 1e-300), right[:, i], left[:, i]
    condition = np.linalg.norm(x) * np.linalg.norm(y) / max(abs(np.vdot(y, x)), 1e-300)
    residual = max(rest * abs(x[-1]) / np.linalg.norm(x), 1e-15)
    error = np.log1p(min(10 * condition * residual / size, 1e300)) / (power * dt)
    return Growth(float(np.log(size) / (power * dt)), float(error), complex(size ** (1 / power)), np.array(basis).T @ x)

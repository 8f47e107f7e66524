"""Stability of a linear one-step map: the spectral radius of the complete update, from dense eigenvalues or from Krylov
spaces of its powers.

A map is stable if no eigenvalue lies outside the unit circle by more than `TOLERANCE` per unit of time. That unit is
the crossing time of the set-up (`Run.crossing`), so that a verdict does not depend on units of measurement; ``dt`` is
the step in it. Every number comes with a bound on what rounding and unfinished iterations may hide: where that bound
reaches across the tolerance, nothing is claimed.

How much is examined is limited by an `Allowance` of operations, never by the clock: the same set-up gets the same
verdict on a busy machine and on an idle one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import linalg

from farhorizon.rounding import TINY

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
_RISES = 2.0  # rise over the last third of a run shorter than `SHORT`, above that of what grows in proportion to time
_VECTORS = 16  # largest number of vectors of a Krylov space
# largest error over rate of growth that a short run reports: the error is of first order, and larger for modes that
# nearly coincide (three that do, which noise follows as the square of time, had 0.37 on one machine)
_SURE = 0.25
DENSE = 700  # largest size of a state for which all eigenvalues are computed, which takes a second
_EXPLODED = 1e6  # growth of white noise over a run that cannot be a transient
_PIECE = 1000  # steps of noise between which an interrupt takes effect


class Allowance:
    """Operations that an examination may still perform, in seconds of a typical core."""

    def __init__(self, seconds: float) -> None:
        self.left, self.used = seconds, 0.0

    def take(self, seconds: float) -> bool:
        """Use some of it, if that much is left; return whether it was."""
        if seconds > self.left:
            return False
        self.left -= seconds
        self.used += seconds
        return True


def step_seconds(products: float) -> float:
    """Seconds that a step takes on a typical core, by the products of weights and values that it sums: some 3e9 a
    second, and a microsecond to begin with (measured, fields in the cache).
    """
    return products / 3e9 + 1e-6


def eigenvalue_seconds(size: int) -> float:
    """Seconds that all eigenvalues of a matrix take on a typical core."""
    return float((size / DENSE) ** 3)


@dataclass(frozen=True)
class Growth:
    """What is known of the fastest growing mode of a map."""

    #: Growth per crossing, (|factor| - 1)/dt; negative if the mode decays.
    rate: float
    #: Bound on the error of the rate.
    error: float
    #: Factor of the mode per step.
    factor: complex
    #: The growing state; empty if it was not requested.
    mode: np.ndarray
    #: Growth per crossing that could have gone unnoticed in a run from noise; 0 for a rate from eigenvalues.
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


def fastest(results: Sequence[Growth]) -> Growth:
    """The result that decides: the fastest certain growth, or else that with the largest sum of rate and error."""
    growing = [g for g in results if g.stable is False]
    return max(growing, key=lambda g: g.rate) if growing else max(results, key=lambda g: g.rate + g.error)


class LinearMap(NamedTuple):
    """A linear one-step map that can only be applied."""

    #: Maps a state and a number of steps to the state after these steps.
    advance: Callable[[np.ndarray, int], np.ndarray]
    #: Numbers in a state.
    size: int
    #: Time step in crossings of the set-up.
    dt: float
    #: Number of steps in which the fastest wave, or a substantial part of a diffusing field, crosses the whole domain
    #: of the map, layers included.
    crossing: int
    #: Seconds that a step takes on a typical core.
    cost: float


def dense_growth(matrix: np.ndarray, dt: float) -> Growth:
    """Fastest mode of a map that is given as a matrix, from its eigenvalues; dt is in crossings.

    The error is that of rounding, ``4 eps |G| / |y . x|`` with the eigenvectors x and y of the map and its transpose.
    """
    if np.iscomplexobj(matrix) and np.abs(matrix.imag).max(initial=0) <= 1e-15 * np.abs(matrix).max(initial=0):
        matrix = matrix.real
    factors = linalg.eigvals(matrix, check_finite=False)
    order = np.argsort(-np.abs(factors))
    size = np.linalg.norm(matrix)
    growths: list[Growth] = []
    # among factors equally close to 1, an ill-conditioned one decides
    for factor in factors[order[: min(4, len(order))]]:
        if growths and abs(factor) < 1 - _CLEAR:
            break
        right, left = _eigenvectors(matrix, factor)
        error = 4 * np.finfo(float).eps * size / max(abs(np.vdot(left, right)), TINY)
        growths.append(Growth((abs(factor) - 1) / dt, error / dt, complex(factor), right))
    return fastest(growths)


def _eigenvectors(matrix: np.ndarray, factor: complex) -> tuple[np.ndarray, np.ndarray]:
    """Right and left eigenvectors of length 1 by inverse iteration; the left one solves ``y^H G = factor y^H``."""
    shifted = matrix - (factor * (1 + 1e-14) + TINY) * np.eye(len(matrix))
    (factorised,) = linalg.get_lapack_funcs(("getrf",), (shifted,))
    lu, pivots, _ = factorised(shifted)
    # the factor is exact where the map drifts, as for a body without bonds; LAPACK's inverse iteration does the same
    lu[np.diag_indices_from(lu)] += (np.diag(lu) == 0) * (np.finfo(float).eps * np.linalg.norm(matrix) or 1.0)
    solve = lu, pivots
    vectors = []
    for transposed in (0, 2):
        x = np.random.default_rng(0).standard_normal(len(matrix)).astype(complex)
        for _ in range(3):
            x = linalg.lu_solve(solve, x, trans=transposed, check_finite=False)
            x = x / np.linalg.norm(x)
        vectors.append(x)
    return vectors[0], vectors[1]


def krylov_growth(update: LinearMap, allowance: Allowance) -> Growth:
    """Fastest mode of a map that can only be applied, from white noise.

    Noise runs for 20 crossing times; then Krylov spaces of ever higher powers of the map are built: in a high power the
    decaying part has disappeared, and few vectors separate the rest. Near the factor 1, slowly decaying modes may be
    too close to each other for that. Noise then runs on to 120 crossing times, and if its size decreases over the last
    third of them, that is the result.

    The error is that of the eigenvalue problem's residual, 0 with `hidden` set where a long run decides, and infinite
    if the allowance was used up.
    """
    unknown = Growth(0.0, np.inf, 1.0, np.zeros(0))
    noise = _Noise(update)
    if not noise.follow(_NOISE, allowance):
        return noise.explosion() or unknown
    power, x, long = update.crossing, noise.state, (_LONG - _NOISE) * update.crossing * update.cost
    for _ in range(_POWERS):
        spaces = _VECTORS * power * update.cost
        if spaces + long > allowance.left >= long:  # the long run must follow, where it is allowed
            break
        if not allowance.take(spaces):
            break
        least = max(4, _LEAST * update.crossing // power)
        growth, x = _arnoldi(update, x, power, least)
        if growth.stable is not None:
            return growth
        power *= _RAISE
    until = _LONG
    while noise.follow(until, allowance):
        growth = noise.decay()
        if growth.stable is not None:
            return growth
        until *= 2  # modes that nearly coincide add up before they decay
    return noise.explosion() or unknown


def noise_growth(
    update: LinearMap, noise: np.ndarray, allowance: Allowance, short: Allowance, crossings: float = np.inf
) -> tuple[Growth | None, float]:
    """Growth seen in a short run from the state `noise`, of a map that can only be applied: a cheap test, before
    anything else is examined. Returns the growth, and the crossing times for which noise ran without growth, 0 if it
    still rose when the allowance was used up.

    Noise runs as long as the run in question, `crossings`, but at most ten crossing times, within the allowance
    `short`. Where it rises over the last third it is continued, within `allowance`, and a Krylov space of the map
    distinguishes growth from a transient. The growth is None if none is seen, or if the allowance was used up before it
    was certain.
    """
    fraction = min(crossings / SHORT, 1.0)
    # a shorter run is sampled as often
    run = _Noise(update._replace(crossing=max(1, int(np.ceil(update.crossing * fraction)))), noise)
    complete = run.follow(SHORT, short)
    if run.explosion() is not None:
        return run.explosion(), 0.0
    length = len(run.sizes) - 1
    # soon after the start a state with momentum may grow in proportion to time, by half over a third of the run
    least = 1.0 if complete and fraction == 1 else _RISES
    # few vectors cannot separate modes that nearly coincide, such as those of a drift
    if update.size <= DENSE and run.rise() > least:
        matrix = np.stack([update.advance(unit, 1) for unit in np.eye(update.size)], axis=1)
        growth = dense_growth(matrix, update.dt)
        if growth.stable is not None:
            return (None if growth.stable else growth), length * fraction
    while run.rise() > least and allowance.take(_VECTORS * update.crossing * update.cost):
        growth, _ = _arnoldi(update, run.state, update.crossing, 4)
        if growth.stable is False and growth.error < _SURE * growth.rate:
            return growth, length * fraction
        length *= 2
        if not run.follow(length, allowance):
            return run.explosion(), 0.0
    return None, length * fraction if run.rise() <= least else 0.0


def white_noise(size: int) -> np.ndarray:
    """The same noise in every certificate, so that its verdict is the same."""
    return np.random.default_rng(0).standard_normal(size)


class _Noise:
    """A run from white noise, with the size of its state after each crossing time."""

    def __init__(self, update: LinearMap, state: np.ndarray | None = None) -> None:
        self.update = update
        self.state = white_noise(update.size) if state is None else state
        self.sizes = [float(np.linalg.norm(self.state))]

    def follow(self, until: int, allowance: Allowance) -> bool:
        """Continue to a number of crossing times; return False if the state exploded or the allowance ended before."""
        while len(self.sizes) <= until:
            if not allowance.take(self.update.crossing * self.update.cost):
                return False
            for done in range(0, self.update.crossing, _PIECE):
                self.state = self.update.advance(self.state, min(_PIECE, self.update.crossing - done))
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
        crossing, dt = self.update.crossing, self.update.dt
        rate = np.log(late[-1] / late[0]) / ((len(late) - 1) * crossing * dt) if len(late) > 1 else np.inf
        mode = self.state / self.sizes[-1] if np.isfinite(self.sizes[-1]) else np.zeros(0)
        return Growth(
            float(rate),
            0.0 if np.isinf(rate) else 0.1 * abs(float(rate)),  # several modes may take part
            complex(np.exp(min(rate, 1e3) * dt)),  # finite
            mode.astype(complex),
        )

    def rise(self) -> float:
        """Size of the state over its size at two thirds of the run."""
        return self.sizes[-1] / max(self.sizes[-1 - (len(self.sizes) - 1) // 3], TINY)

    def decay(self) -> Growth:
        """Growth or decay over the last third of the run."""
        count = len(self.sizes) - 1
        last = self.sizes[-1 - count // 3 :]
        span = (len(last) - 1) * self.update.crossing * self.update.dt
        rate = float(np.log(max(last[-1], TINY) / max(last[0], TINY)) / span)
        hidden = 0.5 * np.log(len(self.state)) / (count * self.update.crossing * self.update.dt)
        return Growth(rate, 0.0 if rate < 0 else np.inf, complex(np.exp(rate * self.update.dt)), np.zeros(0), hidden)


def _arnoldi(update: LinearMap, start: np.ndarray, power: int, least: int) -> tuple[Growth, np.ndarray]:
    """Leading eigenvalue of a power of a map in a Krylov space, which ends as soon as the verdict is certain, but not
    before the `least` number of vectors; and the vector with which to continue.
    """
    subspace, dt = min(_VECTORS, update.size), update.dt
    length = float(np.linalg.norm(start))
    if length < 1e-200:  # its square is zero: the noise has decayed completely
        return Growth(-1 / (power * dt), 0.0, 0.0, np.zeros(0)), start
    basis, projected = [start / length], np.zeros((subspace + 1, subspace))
    for k in range(subspace):
        image = update.advance(basis[k], power)
        for _ in range(2):  # twice, for orthogonality to rounding
            for j, b in enumerate(basis):
                part = float(b @ image)
                projected[j, k] += part
                image = image - part * b
        remainder = float(np.linalg.norm(image))
        projected[k + 1, k] = remainder
        last = k + 1 == subspace or remainder < 1e-14
        if last or (k % 4 == 3 and k + 1 >= least):
            growth = _leading(projected[: k + 1, : k + 1], remainder, basis, power, dt)
            if last or growth.stable is not None:
                break
        basis.append(image / remainder)
    parts = growth.mode.real, growth.mode.imag
    return growth, max(parts, key=lambda p: float(np.linalg.norm(p)))


def _leading(projected: np.ndarray, remainder: float, basis: Sequence[np.ndarray], power: int, dt: float) -> Growth:
    """Largest eigenvalue of a power of a map in a Krylov space; the error is ten times the residual times the condition
    number.
    """
    values, left, right = linalg.eig(projected, left=True, right=True)
    i = int(np.argmax(np.abs(values)))
    size, x, y = max(float(np.abs(values[i])), TINY), right[:, i], left[:, i]
    condition = np.linalg.norm(x) * np.linalg.norm(y) / max(abs(np.vdot(y, x)), TINY)
    residual = max(remainder * abs(x[-1]) / np.linalg.norm(x), 1e-15)
    error = np.log1p(min(10 * condition * residual / size, 1e300)) / (power * dt)
    return Growth(float(np.log(size) / (power * dt)), float(error), complex(size ** (1 / power)), np.array(basis).T @ x)

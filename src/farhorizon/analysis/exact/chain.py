"""Kernels of the exact boundary in one dimension: the response of a half-infinite chain to its drivers, fully discrete
in time.

The chain's nodes are 0, -1, -2, ... and the near field's 1, 2, ...; the *drivers* 1 .. K (K the reach of the stencil)
act on the chain, and its first K nodes, the *ghosts* 0, -1, .. -(K - 1), act back. The response of a chain initially at
rest is

    ghost(-q) at step j = sum over lags a = 1 .. j and drivers m of  F[a, q, m - 1] u_m at step j - a,

explicit because F[0] = 0. The sample at step 0 has the weight `Recursion.first`. The force of all ghosts on driver i is
the same sum with M = D^T F, D[q, m - 1] = a_(m + q), which is symmetric. Where the bonds of a node towards the near
field and away from it differ (a stencil that drifts), weights have shape (2, K), in this order: F follows from both,
and D contains those of the drivers, which point away. Ji, Pang, Zhang, Yang and Perdikaris (2021),
eqs 5 to 15, derive the kernels of the chain that is continuous in time and then discretise the convolution; here the
chain takes the same time steps as the near field, so that there is no discretisation error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft, special

from farhorizon.errors import InputError
from farhorizon.medium.integrators import Integrator, ModifiedEquation, Verlet
from farhorizon.medium.stencil import Stencil

_ROUNDING = 42.0  # anything below exp(-42) = 6e-19 of the impulse is neglected
_CHAIN_FLOPS = 3e10  # up to this cost (a few seconds) the chain is run, since it is the more accurate method
# cost of a point of the transform, in steps of one node; measured at K = 2, 7, 25: 1600, 2900, 3100
_POINT_COST = 3000
_OVERSAMPLING = 16  # points of the circle per step: rounding of the last step grows by 10^(15/16), ninefold


@dataclass(frozen=True)
class Recursion:
    """A scheme in increments: ``d <- keep d + scale (A u - reaction u), u <- u + d``."""

    #: Part of the last increment that a step keeps: (1 - d dt)/(1 + d dt) for Verlet with damping 2 d u_t, 0 for
    #: forward Euler.
    keep: float
    #: Factor of the operator: dt^2/(1 + d dt), or dt.
    scale: float
    #: Weight of the sample at step 0: the first Verlet step is ``u(1) = u(0) + (1 - d dt) dt v(0) + dt^2/2 A u(0)``,
    #: that is, (1 + d dt)/2 of a later one for a start at rest; 1 for forward Euler.
    first: float
    #: Reaction of a chain if A contains only its bonds; 0 if A is the whole operator.
    reaction: float = 0.0

    @classmethod
    def of(cls, integrator: Integrator, dt: float, damping: float = 0.0, reaction: float = 0.0) -> Recursion:
        """The recursion of an integrator; an InputError for schemes of several stages, the inner ones of which would
        need ghosts of their own.
        """
        if isinstance(integrator, ModifiedEquation):
            return _TwoStages(1.0, dt**2, 0.5, reaction)
        numbers = integrator.stages(dt, damping, True).numbers
        if len(numbers) > 1:
            raise InputError(
                "the exact boundary serves schemes of one stage only",
                value=integrator.name,
                limit="velocity Verlet, forward Euler",
                remedy="integrator = euler",
            )
        _, keep, scale, _ = numbers[0]
        return cls(keep, scale, dt**2 / 2 / scale if isinstance(integrator, Verlet) else 1.0, reaction)

    def eigenvalue(self, z: np.ndarray) -> np.ndarray:
        """Eigenvalue of A for which a mode has the factor z per step: ``(z - 1)(1 - keep/z)/scale + reaction``."""
        return (z - 1) * (1 - self.keep / z) / self.scale + self.reaction

    def gain(self, eigenvalue: complex) -> complex:
        """What a step adds to the increment of a mode with an eigenvalue of A, relative to its value."""
        return self.scale * eigenvalue

    def growth(self, eigenvalue: np.ndarray) -> np.ndarray:
        """Largest modulus of the factor per step for eigenvalues of A."""
        half = (1 + self.keep + self.scale * (eigenvalue.astype(complex) - self.reaction)) / 2
        root = np.sqrt(half**2 - self.keep)
        return np.maximum(np.abs(half + root), np.abs(half - root))


class _TwoStages(Recursion):
    """The modified equation, for layers that repeat what they do in each stage: ``y + y^2/12`` with ``y = dt^2 A`` in
    place of y.
    """

    def eigenvalue(self, z: np.ndarray) -> np.ndarray:
        change = super().eigenvalue(z) - self.reaction
        return (np.sqrt(36 + 12 * self.scale * np.asarray(change, complex)) - 6) / self.scale + self.reaction

    def gain(self, eigenvalue: complex) -> complex:
        scaled = self.scale * eigenvalue
        return scaled + scaled**2 / 12


def half_weights(stencil: Stencil, rate: float = 1.0, side: int = -1) -> np.ndarray:
    """Weights a_1 .. a_K of a one-dimensional stencil times `rate` (``coefficient / spacing^2``), zeros where it has
    gaps; for a stencil that drifts those towards the near field and away from it, shape (2, K), beyond its end at
    `side` (-1 or 1).
    """
    if stencil.dim != 1:
        raise InputError(
            "the exact boundary is for one dimension", value=f"{stencil.dim} dimensions", remedy="LatticePML"
        )
    weights = np.zeros((2, stencil.reach[0]))
    for half, direction in zip(weights, (-side, side), strict=True):
        ahead = direction * stencil.offsets[:, 0] > 0
        half[direction * stencil.offsets[ahead, 0] - 1] = rate * stencil.weights[ahead]
    return weights if stencil.drifting else weights[0]


def both_ways(weights: np.ndarray) -> np.ndarray:
    """Weights towards the near field and away from it, shape (2, K)."""
    return np.broadcast_to(weights, (2, weights.shape[-1]))


def symbol(weights: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """``4 sum_k a_k sin^2(k angle / 2)``, the eigenvalue of -A for waves ``exp(i angle n)``, n away from the near
    field; complex angles too.
    """
    toward, away = both_ways(weights)
    phase = np.multiply.outer(angle, np.arange(1, toward.size + 1))
    even = 2 * ((toward + away) * np.sin(phase / 2) ** 2).sum(-1)
    return even if weights.ndim == 1 else even + 1j * ((toward - away) * np.sin(phase)).sum(-1)


def driver_matrix(weights: np.ndarray) -> np.ndarray:
    """D[q, m - 1] = a_(m + q), the bonds of the drivers m to the ghosts -q; shape (K, K)."""
    away = both_ways(weights)[1]
    reach = away.size
    padded = np.concatenate([away, np.zeros(reach)])
    return padded[np.add.outer(np.arange(reach), np.arange(reach))]


def force_form(kernel: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """M = D^T F: the acceleration of driver i from the past of driver m; shape (steps + 1, K, K) like F."""
    return np.matmul(driver_matrix(weights).T, kernel)


def ground(weights: np.ndarray) -> np.ndarray:
    """Sum of the bonds of each driver that reach beyond the end; shape (K,). The force of the ghosts is M u - ground
    u."""
    return driver_matrix(weights).sum(0)


def fronts(weights: np.ndarray, recursion: Recursion, steps: int) -> np.ndarray:
    """Number of nodes that an impulse can have reached after 0 .. `steps` steps, with more than 1e-18 of its size;
    shape (steps + 1,).

    A mode of complex angle kappa + i theta decays by theta per node and grows by at most the factor g(theta) per step,
    so that ``(steps log g + 42) / theta`` is a bound for every theta; the smallest of them is taken.
    """
    reach = weights.shape[-1]
    # any theta gives a bound: 80 of them, 14 % apart, miss the least one by less, since it is flat there
    theta = np.geomspace(1e-4, 4.0, 80) / max(1, reach // 4)
    angle = np.linspace(0, np.pi, 513)[:, None] + 1j * theta
    rate = np.log(np.maximum(recursion.growth(-symbol(weights, angle)).max(0), 1.0))
    count = np.arange(steps + 1)
    bound = reach * count.astype(float)  # a step carries no farther than the stencil reaches
    for growth, decay in zip(rate, theta, strict=True):
        np.minimum(bound, (count * growth + _ROUNDING) / decay, out=bound)
    return np.ceil(bound).astype(np.int64) + reach


def run_kernel(weights: np.ndarray, recursion: Recursion, steps: int) -> np.ndarray:
    """Ghost kernel F, shape (steps + 1, K, K), by running the scheme on a chain so long that nothing returns from its
    end; for weights a_1 .. a_K, shape (K,) or (2, K), in 1/time^2 for waves, 1/time for diffusion.
    """
    from farhorizon.engine.chain_loops import chain_responses  # late: Numba is slow to import

    window = _window(weights, recursion, steps)
    return chain_responses(both_ways(weights).copy(), recursion.keep, recursion.scale, recursion.reaction, window)


def _window(weights: np.ndarray, recursion: Recursion, steps: int) -> np.ndarray:
    """Number of nodes from which an impulse at step 0 can return to the drivers by the last step, at each step."""
    returns = fronts(both_ways(weights)[::-1] if weights.ndim > 1 else weights, recursion, steps)
    return np.minimum(fronts(weights, recursion, steps) if weights.ndim > 1 else returns, returns[::-1])


def surface_response(weights: np.ndarray, eigenvalue: np.ndarray) -> np.ndarray:
    """Ratio of ghosts to drivers, (n, K, K), for eigenvalues sigma (n,), which is the transform of F at sigma, by
    cyclic reduction; an InputError for a point so close to the cut, the negative eigenvalues of A, that it does not
    converge.

    K nodes form a block; each iteration removes every other block (Lopez Sancho, Lopez Sancho and Rubio, J. Phys. F 15
    (1985) 851).
    """
    reach = weights.size
    row = np.concatenate([weights[::-1], [-2 * weights.sum()], weights, np.zeros(reach)])
    distance = np.subtract.outer(np.arange(reach), np.arange(reach))
    inner, toward = row[reach + distance], np.triu(row[np.minimum(2 * reach + distance, row.size - 1)])
    response = np.empty((eigenvalue.size, reach, reach), complex)
    block = max(1, 200_000 // reach**2)  # matrices at a time, 3 MB in all, which stay in the cache
    for start in range(0, eigenvalue.size, block):
        part = slice(start, min(start + block, eigenvalue.size))
        response[part] = _reduce(eigenvalue[part], inner, toward)
    return response


def _reduce(eigenvalue: np.ndarray, inner: np.ndarray, toward: np.ndarray) -> np.ndarray:
    """Cyclic reduction of blocks (sigma - inner), coupled by `toward` in the direction of the drivers and by its
    transpose away from them.
    """
    reach = len(inner)
    middle = eigenvalue[:, None, None] * np.eye(reach) - inner
    surface = middle.copy()
    away = np.broadcast_to(toward.T.astype(complex), middle.shape).copy()
    active = np.arange(eigenvalue.size)
    for _ in range(60):  # of 2^60 blocks the last is beyond the reach of any point off the cut
        e, a = middle[active], away[active]
        solved = np.linalg.solve(e, np.concatenate([np.swapaxes(a, 1, 2), a], 2))
        outward, onward = a @ solved[:, :, :reach], a @ solved[:, :, reach:]
        surface[active] -= outward
        # by mirror symmetry, the other correction is this one in reversed order
        middle[active] = e - outward - outward[:, ::-1, ::-1]
        away[active] = onward
        size = np.abs(onward).max((1, 2)) / np.abs(eigenvalue[active])
        active = active[size > 1e-10]  # the next correction is its square
        if not active.size:
            return np.linalg.solve(surface, np.broadcast_to(toward[:, ::-1].astype(complex), middle.shape))
    raise InputError("the surface response does not converge on the spectrum of the chain", value=eigenvalue[active[0]])


def largest_angle(weights: np.ndarray, recursion: Recursion) -> float:
    """Largest angle of the scheme's oscillating factors z in the complex plane; pi for forward Euler and where all
    modes are overdamped.
    """
    if recursion.keep <= 0:  # forward Euler, or damping so strong that d dt >= 1
        return np.pi
    largest = float(symbol(weights, np.linspace(0, np.pi, 4097)).max()) + recursion.reaction
    half = (1 + recursion.keep - recursion.scale * largest) / (2 * np.sqrt(recursion.keep))
    return float(np.arccos(max(half, -1.0))) if half < 1 else np.pi


def transform_kernel(
    weights: np.ndarray, recursion: Recursion, steps: int, oversampling: int = _OVERSAMPLING
) -> np.ndarray:
    """Ghost kernel F, as `run_kernel`, by inversion of its z-transform on a circle; the cost grows like steps log
    steps.

    Only the part of the circle near the spectrum needs fine sampling. The rest is a smooth function, separated by a
    window that is smooth to rounding, and coarse sampling gives its transform, which has decayed after a few steps.
    With more points on the circle per step (`oversampling`) its radius is closer to 1, which amplifies rounding less.
    """
    count = fft.next_fast_len(oversampling * (steps + 1), real=True)
    radius = 10.0 ** (15 / count)  # wrap-around is damped to 1e-15
    width = largest_angle(weights, recursion)
    # the transform of the window, exp(-(n width / 12)^2), is below rounding from n = 75 / width on; twenty times
    # as many points, for the response that it multiplies
    coarse = fft.next_fast_len(int(1500 / width), real=True)
    split = 4 * width < np.pi and 2 * coarse < count

    def inside(points: int) -> tuple[np.ndarray, np.ndarray]:
        """Angles on half a circle of `points` points, and the window: 1 within 1.5 bands, 0 beyond 3.5."""
        angle = 2 * np.pi * np.arange(points // 2 + 1) / points
        # erfc(6) is 2e-17
        return angle, special.erfc(6 * (angle / width - 2.5)) / 2 if split else np.ones(angle.size)

    kernel = np.zeros((steps + 1, weights.size, weights.size))
    for points, coarse_part in ((count, False), (coarse, True)) if split else ((count, False),):
        angle, window = inside(points)
        window = 1 - window if coarse_part else window
        used = np.flatnonzero(window > 1e-17)
        part = window[used, None, None] * surface_response(
            weights, recursion.eigenvalue(radius * np.exp(1j * angle[used]))
        )
        known = min(steps + 1, points // 2)  # the other half is negative times, where the two parts cancel
        scale = radius ** np.arange(float(known))
        for i in range(weights.size):
            for j in range(weights.size):
                spectrum = np.zeros(points // 2 + 1, complex)
                spectrum[used] = part[:, i, j]
                kernel[:known, i, j] += fft.irfft(spectrum, points)[:known] * scale
    kernel[0] = 0
    return kernel


def ghost_kernel(weights: np.ndarray, recursion: Recursion, steps: int) -> np.ndarray:
    """Ghost kernel F, as `run_kernel`, from a run of the chain, or from the transform where the chain takes more than a
    few seconds and twice as long.

    The chain is preferred because it preserves rigid motions to rounding; the transform serves symmetric bonds only.
    """
    if weights.ndim > 1:
        return run_kernel(weights, recursion, steps)
    node_steps = float(_window(weights, recursion, steps).sum())
    points = _OVERSAMPLING / 2 * steps * min(1.0, 4 * largest_angle(weights, recursion) / np.pi)
    cheap = 4 * weights.size**2 * node_steps < _CHAIN_FLOPS or node_steps < 2 * _POINT_COST * points
    return run_kernel(weights, recursion, steps) if cheap else transform_kernel(weights, recursion, steps)

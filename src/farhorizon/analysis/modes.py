"""Outgoing plane waves: their wavevectors, frequencies and factors in time, and conditions fitted to them.

A mode is ``exp(i k.x)`` times a factor per step, lambda. Waves have real wavevectors k along directions that point
outwards; diffusion has ``k = i kappa n``, modes ``exp(-kappa n.x)`` that decay outwards and grow in time (Shojaei et
al. 2020, eqs 13 to 28; Hermann et al. 2023, eqs 10 to 35). With the symbol S(k) of the medium the factor solves ``(1 +
d dt) lambda^2 - (2 - dt^2 S) lambda + 1 - d dt = 0`` for velocity Verlet, and is ``1 - dt S`` for forward Euler; in
continuous time it is the exponential.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from farhorizon.errors import InputError

# largest exponent of a mode within a cloud or a step: beyond 709 the mode overflows, beyond about half of that its
# square
_OVERFLOW = 300.0
_ODD = 1e-12  # rounding of the imaginary part, which is that of weights that are not symmetric
_LOWEST = 1e-4  # S/rate below which longer waves have no higher weight
_NODES = 1_000_000  # products of modes and offsets in memory at once


def outward(dim: int, largest: float, count: int, balanced: bool = True) -> np.ndarray:
    """Unit vectors (n, dim) around the outward normal, the first axis: `count` angles from -largest to largest
    (radians), both included; in 3D the normal, and rings of 6, 12, 18, .. directions at the positive angles.

    Not `balanced`, in 3D: the grid of Shojaei et al. (2020), appendix A, `count` by `count` angles over the octant
    around (1, 1, 1), rotated so that this vector becomes the normal; it repeats one direction and favours one side, and
    `largest` has no effect.
    """
    if dim == 1:
        return np.ones((1, 1))
    if dim == 2:
        angles = np.linspace(-largest, largest, count) if count > 1 else np.zeros(1)
        return np.stack([np.cos(angles), np.sin(angles)], axis=1)
    if not balanced:
        around, polar = (a.ravel() for a in np.meshgrid(*[np.linspace(0, np.pi / 2, count)] * 2, indexing="ij"))
        octant = np.stack([np.cos(around) * np.sin(polar), np.sin(around) * np.sin(polar), np.cos(polar)], axis=1)
        return octant @ frame(np.ones(3) / np.sqrt(3)).T
    rings = [(0.0, np.zeros(1))]
    rings += [(largest * r / (count // 2), 2 * np.pi * np.arange(6 * r) / (6 * r)) for r in range(1, count // 2 + 1)]
    return np.concatenate(
        [
            np.stack(
                [np.full(turn.size, np.cos(polar)), np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn)], axis=1
            )
            for polar, turn in rings
        ]
    )


def frame(normal: np.ndarray) -> np.ndarray:
    """Orthonormal rows, the first of which is the unit vector `normal`; shape (dim, dim)."""
    if normal.size == 1:
        return normal.reshape(1, 1)
    if normal.size == 2:
        return np.array([normal, [-normal[1], normal[0]]])
    first = int(np.argmin(np.abs(normal)))
    second, third = (first + 1) % 3, (first + 2) % 3
    across = np.zeros(3)
    across[second], across[third] = -normal[third], normal[second]
    across /= np.hypot(normal[second], normal[third])
    last = [normal[(a + 1) % 3] * across[(a + 2) % 3] - normal[(a + 2) % 3] * across[(a + 1) % 3] for a in range(3)]
    return np.array([normal, across, last])


def discrete_symbol(k: np.ndarray, offsets: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """``sum_j w_j (1 - cos(k.x_j))``, (M,), of a stencil with bond vectors in space (J, dim) and weights (J,) in units
    of the operator, at real or complex wavevectors (M, dim) (Hermann et al. 2023, eq 52).
    """
    rows = max(1, _NODES // len(weights))
    with np.errstate(over="ignore", invalid="ignore"):
        return np.concatenate(
            [2 * np.sin(k[i : i + rows] @ offsets.T / 2) ** 2 @ weights for i in range(0, len(k), rows)]
        )


def polarised(k: np.ndarray, offsets: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Symbols (M d,) and polarisations (M d, d) of a field of several components, those of one wavevector one after the
    other: eigenvalues and eigenvectors of the matrix ``sum_j w_j (1 - exp(i k.x_j))``, for weights (J, d, d).
    """
    phase = k @ offsets.T
    matrix = np.tensordot(2 * np.sin(phase / 2) ** 2 - 1j * np.sin(phase), weights, 1)
    values, vectors = np.linalg.eigh(matrix if np.abs(matrix.imag).max() > _ODD * np.abs(matrix).max() else matrix.real)
    return np.maximum(values, 0.0).ravel(), np.swapaxes(vectors, 1, 2).reshape(-1, weights.shape[1])


def series_symbol(k: np.ndarray, coefficient: float, horizon: float, terms: np.ndarray) -> np.ndarray:
    """``coefficient k^2 (1 + terms[0] z^2 + terms[1] z^4 + ..)``, z = |k| horizon. `Kernel.series` gives the terms;
    without terms it is the symbol of the local equation.

    Takes real or imaginary wavevectors k, shape (M, dim); returns shape (M,).
    """
    square = (k**2).sum(1)
    with np.errstate(over="ignore", invalid="ignore"):
        return coefficient * square * np.polynomial.polynomial.polyval(horizon**2 * square, np.r_[1.0, terms])


def factors(symbol: np.ndarray, dt: float, order: int, damping: float = 0.0, discrete: bool = True) -> np.ndarray:
    """Factor per step, (M,), of modes with symbols S at outgoing wavevectors; with `discrete` False in continuous time.
    An InputError if modes overflow, or waves are too short for the step.

    For waves, the root that moves outwards, ``exp(-i w dt)`` with w > 0; of two real roots, the one nearer to 1.
    """
    largest = float(np.abs(dt**order * symbol).max())
    if not largest < (_OVERFLOW if order == 1 else 4.0):
        raise InputError(
            "modes overflow within a time step" if order == 1 else "modes are too short for the time step",
            value=f"{largest:.3g}",
            limit=f"{_OVERFLOW:g} (rate times step)" if order == 1 else "4 (squared frequency times squared step)",
            key="boundary.wavenumber",
            remedy="a smaller largest wavenumber, or a smaller step",
        )
    if order == 1:
        return 1 - dt * symbol if discrete else np.exp(-dt * symbol)
    damped = damping * dt
    if discrete:
        half, last = (1 - dt**2 * symbol / 2) / (1 + damped), (1 - damped) / (1 + damped)
        squared = np.asarray(last - half**2, complex)
        return np.where(squared.real >= 0, half - 1j * np.sqrt(squared), half + np.sqrt(-squared))
    squared = np.asarray(symbol - damping**2, complex)
    return np.exp(-damped) * np.where(
        squared.real >= 0, np.exp(-1j * dt * np.sqrt(squared)), np.exp(dt * np.sqrt(-squared))
    )


def phases(k: np.ndarray, places: np.ndarray) -> np.ndarray:
    """``exp(i k.x)`` of modes (M, dim) at places (J, dim); shape (M, J). An InputError if they overflow."""
    exponent = 1j * (k @ places.T)
    largest = float(np.abs(exponent.real).max(initial=0))
    if not largest < _OVERFLOW:
        raise InputError(
            "modes overflow within a cloud",
            value=f"exponent {largest:.3g}",
            limit=_OVERFLOW,
            key="boundary.wavenumber",
            remedy="a smaller largest wavenumber, or smaller clouds",
        )
    return np.exp(exponent)


class Fit(NamedTuple):
    """Weights that give the next value at a cloud's centre."""

    #: For the present step and earlier ones, (levels, J), or (levels, J d, d) for a field of d components: for each
    #: component at the centre, the components of the nodes, node by node.
    weights: np.ndarray
    #: Condition number of what was inverted: without the singular values that are cut off, and with regularisation.
    condition: float


class CloudModes(NamedTuple):
    """Modes at the nodes of a cloud."""

    values: np.ndarray  # relative to the centre, (M, J)
    factor: np.ndarray  # per step, (M,)
    symbol: np.ndarray  # S, (M,)
    polar: np.ndarray | None = None  # polarisations of a field of d components, (M, d)

    def of_components(self) -> tuple[np.ndarray, np.ndarray]:
        """The modes at the components of all nodes, shape (M, J d), and at the centre: 1, or the polarisations."""
        if self.polar is None:
            return self.values, np.ones(len(self.values))
        return (self.values[:, :, None] * self.polar[:, None]).reshape(len(self.values), -1), self.polar


def fit(cloud: CloudModes, levels: int, *, regularization: float | None = None, rcond: float = 1e-12) -> Fit:
    """Weights that give the next value at a cloud's centre from the values of the cloud at the present and earlier
    steps: the least-squares fit of the factor per step over all modes, of minimal norm (Shojaei et al. 2020, eq 44;
    Hermann et al. 2023, eq 50).

    `regularization` is the parameter of Tikhonov's method, relative to the largest singular value; without it, singular
    values below `rcond` times the largest are cut off.
    """
    (modes, unit), factor = cloud.of_components(), cloud.factor
    matrix = np.concatenate([modes * factor[:, None] ** -float(level) for level in range(levels)], axis=1)
    weights, condition = _solve(matrix, (factor * unit.T).T, regularization, rcond)
    return Fit(weights.reshape(levels, -1, *unit.shape[1:]), condition)


def fit_operator(cloud: CloudModes, centre: int, dt: float, order: int, rate: float, regularization: float) -> Fit:
    """As `fit`, but fitted to the acceleration (waves, two levels) or rate (diffusion, one level) at the centre, the
    node of this number, which has a limit as dt goes to 0.

    ``(u+ - 2u + u-)/dt^2 = sum_j a_j u_j + b_j (u_j - u_j^-)/dt``: the reflection of a mode is approximately its
    residual over S, so that each has the weight ``(S/rate + 1e-4)^-1.5``, which favours long waves. `rate`, the
    coefficient over squared spacing, scales the unknowns to the order of 1; the parameter of Tikhonov's method is
    absolute in those units.
    """
    (modes, unit), factor = cloud.of_components(), cloud.factor
    weight = (np.abs(cloud.symbol) / rate + _LOWEST) ** -1.5
    if order == 1:
        right = ((factor - 1) / (dt * rate) * weight * unit.T).T
        a, condition = _solve(weight[:, None] * modes, right, regularization, 0.0, absolute=True)
        update = dt * rate * a[None]
    else:
        speed = np.sqrt(rate)
        change = (1 - 1 / factor) / (dt * speed)
        right = ((factor - 2 + 1 / factor) / (dt**2 * rate) * weight * unit.T).T
        matrix = np.concatenate([modes, modes * change[:, None]], axis=1) * weight[:, None]
        unknowns, condition = _solve(matrix, right, regularization, 0.0, absolute=True)
        a, b = unknowns.reshape(2, -1, *unit.shape[1:])
        update = np.array([dt**2 * rate * a + dt * speed * b, -dt * speed * b])
    count = 1 if cloud.polar is None else cloud.polar.shape[1]
    centre_entries = slice(centre * count, (centre + 1) * count)
    identity = np.ones(1) if cloud.polar is None else np.eye(count)
    update[0, centre_entries] += order * identity
    update[1:, centre_entries] -= identity
    return Fit(update, condition)


def _solve(
    matrix: np.ndarray, target: np.ndarray, regularization: float | None, rcond: float, absolute: bool = False
) -> tuple[np.ndarray, float]:
    """Real least-squares solution of complex equations by singular values, cut off at `rcond` or regularized, and the
    condition number of what was inverted.
    """
    real = np.concatenate([matrix.real, matrix.imag])
    left, values, right = np.linalg.svd(real, full_matrices=False)
    projected = left.T @ np.concatenate([target.real, target.imag])
    if regularization is None:
        used = values > rcond * values[0]
        inverse = np.where(used, 1 / np.where(used, values, 1.0), 0.0)
        condition = values[0] / values[used][-1]
    else:
        added = (regularization * (1.0 if absolute else values[0])) ** 2
        inverse = values / (values**2 + added)
        with np.errstate(divide="ignore"):
            condition = np.sqrt((values[0] ** 2 + added) / (values[-1] ** 2 + added))
    return right.T @ (inverse * projected.T).T, float(condition)

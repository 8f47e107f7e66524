"""A cylindrically symmetric wave in the infinite elastic plane: in closed form for the local medium, and by a Hankel
integral for the nonlocal one.

The radial displacement obeys ``u_tt = c^2 (u_rr + u_r / r - u / r^2)`` and starts, at rest, as ``b (r/a) (1 +
(r/a)^2)^(-3/2)``.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

_DECAYED = 40.0  # exp(-40) is below rounding


def radial_wave(r: ArrayLike, t: ArrayLike, speed: float, amplitude: float = 1.0, width: float = 1.0) -> np.ndarray:
    """Radial displacement of the local medium at distances r from the axis and times t (broadcast), for the
    longitudinal speed c, with b = `amplitude` and a = `width`.

    It is Wildman and Gazonas (2012), eq. 3-3, read as ``b r / (sqrt(2) a R^6) sqrt(R^2 + alpha) (2 alpha - R^2)``. As
    printed, with the last factor under the root, it neither has the initial value nor is a solution.
    """
    scaled = (np.asarray(r, float) / width) ** 2
    turn = np.asarray(t, float) * speed / width
    alpha = 1 + scaled - turn**2
    squared = np.hypot(alpha, 2 * turn)
    # sqrt(R^2 + alpha) cancels behind the front, where alpha < 0: there it is 2 turn / sqrt(R^2 - alpha)
    behind = alpha < 0
    gap = np.sqrt(np.where(behind, squared - alpha, 1.0))
    root = np.where(behind, 2 * np.abs(turn) / gap, np.sqrt(np.where(behind, 1.0, squared + alpha)))
    return amplitude * np.asarray(r, float) / width / np.sqrt(2) * root * (2 * alpha - squared) / squared**3


def nonlocal_radial_wave(
    r: ArrayLike,
    t: ArrayLike,
    speed: float,
    symbol: Callable[[np.ndarray], np.ndarray],
    amplitude: float = 1.0,
    width: float = 1.0,
) -> np.ndarray:
    """Radial displacement of a nonlocal medium whose gradient has the symbol g, ``integral of k b a^2 exp(-k a) J1(k r)
    cos(c g(k) t) dk``; arguments as for `radial_wave`, which the identity gives.
    """
    r, t = np.broadcast_arrays(np.asarray(r, float), np.asarray(t, float))
    last = _DECAYED / width
    # at least three points per oscillation of the fastest of J1 and cos, and at least 400
    panels = int(20 + last * (r.max(initial=0.0) + speed * t.max(initial=0.0)) / (2 * np.pi))
    points, weights = np.polynomial.legendre.leggauss(20)
    edges = np.linspace(0, last, panels + 1)
    k = (edges[:-1, None] + (points + 1) / 2 * np.diff(edges)[:, None]).ravel()
    measure = (weights / 2 * np.diff(edges)[:, None]).ravel() * k * amplitude * width**2 * np.exp(-k * width)
    frequency = speed * symbol(k)
    values = [
        measure @ (special.j1(k * x) * np.cos(frequency * time)) for x, time in zip(r.ravel(), t.ravel(), strict=True)
    ]
    return np.array(values).reshape(r.shape)


def gaussian_symbol(width: float) -> Callable[[np.ndarray], np.ndarray]:
    """Symbol ``k exp(-(k width)^2 / 4)`` of the gradient with influence function ``exp(-(r/width)^2)``, in the
    plane."""
    return lambda k: k * np.exp(-((k * width) ** 2) / 4)

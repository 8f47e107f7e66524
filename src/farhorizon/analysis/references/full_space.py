"""Fields of point sources in a homogeneous, isotropic, unbounded medium, by the classical equations.

Aki and Richards (2002), Quantitative Seismology, eqs 4.23 and 4.29, and the scalar wave in the plane (Morse and
Feshbach 1953, section 7.3). The field of a line source in space is that of a point source in the plane. The
last two functions give an initial displacement around an axis, for the local and a nonlocal medium.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

_POINTS = 64  # points of a quadrature, for signals with a few oscillations over its length
_RATE = 1e-4  # step of the difference that approximates the derivative of a signal, over the given time scale

Signal = Callable[[np.ndarray], np.ndarray]


def scalar_wave_in_the_plane(distance: float, times: np.ndarray, signal: Signal, speed: float = 1.0) -> np.ndarray:
    """Solution of ``u_tt = c^2 laplace(u) + delta(x) s(t)`` in the plane, from rest, at a distance; shape of times.

    ``u = 1/(2 pi c^2) integral of s(t - r/c cosh(theta))`` over theta from 0 to ``acosh(c t / r)``.
    """
    points, weights = np.polynomial.legendre.leggauss(_POINTS)
    late = np.arccosh(np.maximum(speed * np.asarray(times) / distance, 1.0))[..., None]
    theta = late * (points + 1) / 2
    values = signal(np.asarray(times)[..., None] - distance / speed * np.cosh(theta))
    return np.asarray((late * values) @ weights / (4 * np.pi * speed**2))


@dataclass(frozen=True)
class FullSpace:
    """An unbounded elastic medium."""

    p_speed: float
    s_speed: float
    density: float

    def of_force(self, at: np.ndarray, times: np.ndarray, force: np.ndarray, signal: Signal) -> np.ndarray:
        """Displacement (3, n) at a place (3,) due to a force (3,) at the origin, with a signal that is zero before zero
        (Aki and Richards, eq 4.23).
        """
        r, g, eye = float(np.linalg.norm(at)), at / np.linalg.norm(at), np.eye(3)
        along = np.outer(g, g)
        near, p, s = (3 * along - eye) @ force / r**3, along @ force / r, (along - eye) @ force / r
        fast, slow = signal(times - r / self.p_speed), signal(times - r / self.s_speed)
        displacement = np.multiply.outer(near, self._between(r, times, signal))
        displacement += np.multiply.outer(p / self.p_speed**2, fast) - np.multiply.outer(s / self.s_speed**2, slow)
        return np.asarray(displacement / (4 * np.pi * self.density))

    def of_moment(
        self, at: np.ndarray, times: np.ndarray, moment: np.ndarray, signal: Signal, scale: float
    ) -> np.ndarray:
        """Displacement (3, n) at a place (3,) due to a symmetric moment tensor (3, 3) at the origin (Aki and Richards,
        eq 4.29); the derivative of the signal is a difference over a small part of its time scale.
        """
        r, g = float(np.linalg.norm(at)), at / np.linalg.norm(at)
        pushed, trace = moment @ g, float(np.trace(moment))
        radial = float(g @ pushed) * g  # g_n g_p g_q M_pq
        remainder = trace * g + 2 * pushed  # (g_n d_pq + g_p d_nq + g_q d_np) M_pq
        p, s, rho, step = self.p_speed, self.s_speed, self.density, _RATE * scale

        def rate(t: np.ndarray) -> np.ndarray:
            return np.asarray((signal(t + step) - signal(t - step)) / (2 * step))

        terms = [
            ((15 * radial - 3 * remainder) / r**4, self._between(r, times, signal)),
            ((6 * radial - remainder) / (p**2 * r**2), signal(times - r / p)),
            (-(6 * radial - remainder - pushed) / (s**2 * r**2), signal(times - r / s)),
            (radial / (p**3 * r), rate(times - r / p)),
            (-(radial - pushed) / (s**3 * r), rate(times - r / s)),
        ]
        return np.asarray(sum(np.multiply.outer(size, course) for size, course in terms) / (4 * np.pi * rho))

    def _between(self, r: float, times: np.ndarray, signal: Signal) -> np.ndarray:
        """Integral of ``tau s(t - tau)`` from the arrival of P waves to that of S waves."""
        points, weights = np.polynomial.legendre.leggauss(_POINTS)
        half = (r / self.s_speed - r / self.p_speed) / 2
        tau = r / self.p_speed + half * (points + 1)
        return np.asarray((tau * signal(np.asarray(times)[:, None] - tau)) @ weights * half)


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

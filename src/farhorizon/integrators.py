"""Time integrators as lists of stages, and their symbols.

A stage writes ``out = b*base + in*a + scale * L(in) + source_scale * source``. For a linear operator the classical
Runge-Kutta method of fourth order is a nested polynomial, so it needs four such stages and three levels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Largest |dt * eigenvalue| on the negative real axis for which Runge-Kutta 4 does not grow.
RK4_REAL_LIMIT = 2.785293563405282


@dataclass(frozen=True)
class Stages:
    """What the engine needs of an integrator.

    Attributes
    ----------
    levels : int
        Time levels in memory.
    rotation : tuple
        ``rotation[phase][stage] = (in, base, out)``, level numbers.
    numbers : tuple
        ``numbers[stage] = (a, b, scale, source_scale)`` with L written in differences.
    increments : bool
        The base level holds the increment u(n) - u(n-1) and is advanced in place.
    """

    levels: int
    rotation: tuple[tuple[tuple[int, int, int], ...], ...]
    numbers: tuple[tuple[float, float, float, float], ...]
    increments: bool = False


@dataclass(frozen=True)
class Verlet:
    """Velocity Verlet with viscous damping 2 d u_t taken implicitly.

    ``(1 + d dt) u(n+1) - 2 u(n) + (1 - d dt) u(n-1) = dt^2 (L u(n) + s(n))``
    (Hermann et al. 2023, eq 42, in terms of u alone).
    """

    order = 2
    name = "velocity Verlet"

    @staticmethod
    def step_limit(largest: float) -> float:
        """Largest stable step for the largest eigenvalue of -L."""
        return 2.0 / np.sqrt(largest)

    @staticmethod
    def stages(dt: float, damping: float = 0.0, increments: bool = False) -> Stages:
        """Stages of one step."""
        share = damping * dt
        scale = dt**2 / (1 + share)
        if increments:
            return Stages(3, (((0, 2, 1),), ((1, 2, 0),)), ((1.0, (1 - share) / (1 + share), scale, scale),), True)
        return Stages(2, (((0, 1, 1),), ((1, 0, 0),)), ((2 / (1 + share), -(1 - share) / (1 + share), scale, scale),))

    @staticmethod
    def source_samples(dt: float) -> tuple[tuple[float, ...], np.ndarray]:
        """Times within a step at which a source is read, and its weight in each stage, shape (stages, times)."""
        return (0.0,), np.ones((1, 1))

    @staticmethod
    def propagate(symbol: np.ndarray, dt: float, steps: int, u: np.ndarray, v: np.ndarray, damping: float = 0.0) -> np.ndarray:
        """Exact result of `steps` steps for each eigenvalue -symbol, from Fourier coefficients of u and u_t at t = 0."""
        # u(n) = ratio^n (u cos(n angle) + rest sin(n angle)): no difference of nearly equal powers, so that
        # rounding grows like n only. Overdamped modes have an imaginary angle.
        share = damping * dt
        ratio = np.sqrt((1 - share) / (1 + share))
        quarter = dt**2 * np.asarray(symbol, float)
        cosine = ((1 - quarter / 2) / np.sqrt(1 - share**2)).astype(complex)
        sine = np.sqrt(((quarter - quarter**2 / 4 - share**2) / (1 - share**2)).astype(complex))
        angle = -1j * np.log(cosine + 1j * sine)
        flat = np.abs(sine) < 1e-9
        slope = np.where(flat, steps * cosine ** (steps - 1), np.sin(steps * angle) / np.where(flat, 1.0, sine))
        return ratio**steps * (u * np.cos(steps * angle) + (share * cosine * u + ratio * (1 + share) * dt * v) * slope)


@dataclass(frozen=True)
class Euler:
    """Forward Euler, ``u(n+1) = u(n) + dt (L u(n) + s(n))``."""

    order = 1
    name = "forward Euler"

    @staticmethod
    def step_limit(largest: float) -> float:
        """Largest stable step for the largest eigenvalue of -L."""
        return 2.0 / largest

    @staticmethod
    def stages(dt: float, damping: float = 0.0, increments: bool = False) -> Stages:
        """Stages of one step."""
        return Stages(2, (((0, 1, 1),), ((1, 0, 0),)), ((1.0, 0.0, dt, dt),))

    @staticmethod
    def source_samples(dt: float) -> tuple[tuple[float, ...], np.ndarray]:
        """Times within a step at which a source is read, and its weight in each stage, shape (stages, times)."""
        return (0.0,), np.ones((1, 1))

    @staticmethod
    def growth(symbol: np.ndarray, dt: float) -> np.ndarray:
        """Factor of one step for eigenvalues -symbol."""
        return 1 - dt * symbol


@dataclass(frozen=True)
class RungeKutta4:
    """The classical Runge-Kutta method of fourth order."""

    order = 4
    name = "Runge-Kutta 4"

    @staticmethod
    def step_limit(largest: float) -> float:
        """Largest stable step for the largest eigenvalue of -L."""
        return RK4_REAL_LIMIT / largest

    @staticmethod
    def stages(dt: float, damping: float = 0.0, increments: bool = False) -> Stages:
        """Stages of one step: u + dt L (u + dt/2 L (u + dt/3 L (u + dt/4 L u)))."""
        rotation = (((0, 0, 1), (1, 0, 2), (2, 0, 1), (1, 0, 0)),)
        return Stages(3, rotation, tuple((0.0, 1.0, dt / j, dt) for j in (4, 3, 2, 1)))

    @staticmethod
    def source_samples(dt: float) -> tuple[tuple[float, ...], np.ndarray]:
        """Times within a step at which a source is read, and its weight in each stage, shape (stages, times).

        The weights make the nested form equal to the classical method for any source.
        """
        return (0.0, dt / 2, dt), np.array([[1 / 4, 0, 0], [1 / 6, 1 / 6, 0], [1 / 6, 2 / 6, 0], [1 / 6, 4 / 6, 1 / 6]])

    @staticmethod
    def growth(symbol: np.ndarray, dt: float) -> np.ndarray:
        """Factor of one step for eigenvalues -symbol."""
        z = -dt * symbol
        return 1 + z * (1 + z / 2 * (1 + z / 3 * (1 + z / 4)))


Integrator = Verlet | Euler | RungeKutta4

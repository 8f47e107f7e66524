"""Time integrators as lists of stages, and their symbols.

A stage writes ``out = b*base + in*a + scale * L(in) + source_scale * source``. For a linear operator the classical
Runge-Kutta method of fourth order is a nested polynomial, so it needs four such stages and three levels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from farhorizon import kinds
from farhorizon.files.storable import Storable
from farhorizon.rounding import MARGIN

#: Largest |dt * eigenvalue| on the negative real axis for which Runge-Kutta 4 does not grow.
RK4_REAL_LIMIT = 2.785293563405282


#: Numbers of the levels (in, base, out) of each stage of a step.
Rotation = tuple[tuple[int, int, int], ...]


@dataclass(frozen=True)
class Stages:
    """Description of an integrator for the engine."""

    #: Number of time levels in memory.
    levels: int
    #: ``rotation[phase][stage] = (in, base, out)``, level numbers.
    rotation: tuple[Rotation, ...]
    #: ``numbers[stage] = (a, b, scale, source_scale)`` with L written in differences.
    numbers: tuple[tuple[float, float, float, float], ...]
    #: Whether the base level holds the increment u(n) - u(n-1) and is advanced in place.
    increments: bool = False


def _closed_cycle(rotation: Rotation) -> tuple[Rotation, ...]:
    """Steps whose result lies in another level than their start: each begins where the previous one ends, and the last
    ends where the first begins.
    """
    order = list(range(1 + max(level for stage in rotation for level in stage)))
    rotations: list[Rotation] = []
    while not rotations or order != sorted(order):
        rotations.append(tuple((order[src], order[base], order[out]) for src, base, out in rotation))
        result = order[rotation[-1][2]]
        order = [result, *(level for level in order if level != result)]
    return tuple(rotations)


class _OneStage:
    """A method that applies the operator once per step."""

    @staticmethod
    def source_samples(dt: float) -> tuple[tuple[float, ...], np.ndarray]:
        """Times within a step at which a source is read, and its weight in each stage, shape (stages, times)."""
        return (0.0,), np.ones((1, 1))

    @staticmethod
    def prescribed_samples(dt: float) -> tuple[tuple[float, ...], np.ndarray]:
        """Times within a step, and their weights in the value that a prescribed node takes after each stage, shape
        (stages, times).
        """
        return (dt,), np.ones((1, 1))


@dataclass(frozen=True)
class Verlet(_OneStage):
    """Velocity Verlet with viscous damping 2 d u_t taken implicitly.

    ``(1 + d dt) u(n+1) - 2 u(n) + (1 - d dt) u(n-1) = dt^2 (L u(n) + s(n))``
    (Hermann et al. 2023, eq 42, in terms of u alone).
    """

    order = 2
    equation_order: ClassVar[Literal[2]] = 2
    name = "velocity Verlet"
    alternates = False
    outruns = False

    @staticmethod
    def step_limit(largest: float) -> float:
        """Largest stable step for the largest eigenvalue of -L."""
        return 2.0 / np.sqrt(largest)

    @staticmethod
    def stages(dt: float, damping: float = 0.0, increments: bool = False, lasting: bool = False) -> Stages:
        """Stages of one step; with `lasting`, a further level takes the result, so that the base outlives its stage."""
        damped = damping * dt
        scale = dt**2 / (1 + damped)
        if increments:
            return Stages(3, (((0, 2, 1),), ((1, 2, 0),)), ((1.0, (1 - damped) / (1 + damped), scale, scale),), True)
        numbers = ((2 / (1 + damped), -(1 - damped) / (1 + damped), scale, scale),)
        if lasting:
            return Stages(3, (((0, 1, 2),), ((2, 0, 1),), ((1, 2, 0),)), numbers)
        return Stages(2, (((0, 1, 1),), ((1, 0, 0),)), numbers)

    @staticmethod
    def modes(symbol: np.ndarray, dt: float, damping: float = 0.0) -> VerletModes:
        """Exact results of any number of steps, for each eigenvalue -symbol."""
        return VerletModes(symbol, dt, damping)

    @staticmethod
    def frequency_of_nodes(frequency: np.ndarray, dt: float) -> np.ndarray:
        """Angular frequency of the waves of the differential equations of the nodes that the steps turn into waves of a
        frequency, in cycles per time.
        """
        return 2 / dt * np.sin(np.pi * np.minimum(frequency * dt, 0.5))

    @staticmethod
    def frequency_of_steps(omega: float, dt: float) -> float:
        """The inverse of `frequency_of_nodes`."""
        return float(np.arcsin(min(1.0, omega * dt / 2)) / (np.pi * dt))

    @staticmethod
    def propagate(
        symbol: np.ndarray, dt: float, steps: int, u: np.ndarray, v: np.ndarray, damping: float = 0.0
    ) -> np.ndarray:
        """Exact result of `steps` steps for each eigenvalue -symbol, from Fourier coefficients of u and u_t at t =
        0.
        """
        return VerletModes(symbol, dt, damping).after(steps, u, v)


class VerletModes:
    """Exact result of any number of steps of velocity Verlet, with its damping d, for each eigenmode, from its
    eigenvalue of -L in 1/time^2.
    """

    def __init__(self, symbol: np.ndarray, dt: float, damping: float = 0.0) -> None:
        # u(n) = ratio^n (u cos(n angle) + rest sin(n angle)) has no difference of nearly equal powers, so that rounding
        # errors grow only like n. Overdamped modes have an imaginary angle; without them everything stays real, because
        # complex functions take ten times as long.
        self._dt, self._damped = dt, damping * dt
        damped, quarter = self._damped, dt**2 * np.asarray(symbol, float)
        self._ratio = np.sqrt((1 - damped) / (1 + damped))
        self._cosine = (1 - quarter / 2) / np.sqrt(1 - damped**2)
        sine = np.emath.sqrt((quarter - quarter**2 / 4 - damped**2) / (1 - damped**2))
        self._angle = np.arctan2(sine, self._cosine) if np.isrealobj(sine) else -1j * np.log(self._cosine + 1j * sine)
        self._flat = np.abs(sine) < 1e-9
        self._sine = np.where(self._flat, 1.0, sine)

    def after(self, steps: int, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Amplitudes of the modes after `steps` steps, from the amplitudes and their time derivatives at t = 0."""
        angle = steps * self._angle
        amplitudes = u * np.cos(angle)
        if self._damped or np.any(v):
            limit = np.power(self._cosine, steps - 1, where=self._flat, out=np.ones_like(self._cosine))
            slope = np.where(self._flat, steps * limit, np.sin(angle) / self._sine)
            amplitudes = (
                amplitudes + (self._damped * self._cosine * u + self._ratio * (1 + self._damped) * self._dt * v) * slope
            )
        return self._ratio**steps * amplitudes


@dataclass(frozen=True)
class ModifiedEquation:
    """The modified-equation (Lax-Wendroff) method of fourth order for linear waves without damping.

    ``u(n+1) - 2 u(n) + u(n-1) = dt^2 (L u + s) + dt^4/12 (L (L u + s) + s_tt)`` (Dablain 1986, Geophysics 51(1), eq 15;
    Shubin and Bell 1987, SIAM J. Sci. Stat. Comput. 8, 135). The polynomial of z = dt^2 L on the right-hand side has
    real roots, ``2 + z + z^2/12 = 2 (1 + z/p) (1 + z/q)`` with p, q = 6 +- 2 sqrt(3), so that a step consists of two
    stages: ``w = u + (z u + dt^2 s)/p`` and ``u(n+1) = 2 (w + z w/q) - u(n-1)`` with what else the source adds.
    """

    order = 4
    equation_order: ClassVar[Literal[2]] = 2
    name = "modified equation"
    alternates = False
    outruns = False

    @staticmethod
    def step_limit(largest: float) -> float:
        """Largest stable step for the largest eigenvalue of -L: ``|2 + z + z^2/12| <= 2`` from z = -12 to 0."""
        return np.sqrt(12.0 / largest)

    @staticmethod
    def stages(dt: float, damping: float = 0.0, increments: bool = False, lasting: bool = False) -> Stages:
        """Stages of one step: w in a level of its own, then the result, in place of the base or, with `lasting`, in a
        fourth level.
        """
        numbers = (1.0, 0.0, dt**2 / _ROOTS[0], dt**2 / _ROOTS[0]), (2.0, -1.0, 2 * dt**2 / _ROOTS[1], dt**2)
        if lasting:
            turns = ((0, 1, 3), (3, 1, 2)), ((2, 0, 3), (3, 0, 1)), ((1, 2, 3), (3, 2, 0))
            return Stages(4, turns, numbers)
        return Stages(3, (((0, 1, 2), (2, 1, 1)), ((1, 0, 2), (2, 0, 0))), numbers)

    @staticmethod
    def source_samples(dt: float) -> tuple[tuple[float, ...], np.ndarray]:
        """Times about a step at which a source is read, and its weight in each stage, shape (stages, times): its second
        derivative in time is that of the parabola through three steps.
        """
        return (-dt, 0.0, dt), np.array([[0, 1, 0], [1 / 12, 1 - 2 / _ROOTS[0] - 1 / 6, 1 / 12]])

    @staticmethod
    def prescribed_samples(dt: float) -> tuple[tuple[float, ...], np.ndarray]:
        """As for the other methods; only constant values are prescribed, which are those of each stage."""
        return (dt,), np.ones((2, 1))

    @staticmethod
    def modes(symbol: np.ndarray, dt: float, damping: float = 0.0) -> VerletModes:
        """Exact results of any number of steps, for each eigenvalue -symbol."""
        return _ModifiedModes(symbol, dt)

    @staticmethod
    def frequency_of_nodes(frequency: np.ndarray, dt: float) -> np.ndarray:
        """As for `Verlet`; the steps carry waves of up to a third of a cycle per step."""
        squared = 4 * np.sin(np.pi * np.minimum(frequency * dt, 1 / 3)) ** 2  # of Verlet, in steps
        return np.sqrt(6 - np.sqrt(np.maximum(36 - 12 * squared, 0.0))) / dt

    @staticmethod
    def frequency_of_steps(omega: float, dt: float) -> float:
        """The inverse of `frequency_of_nodes`."""
        squared = min(6.0, (omega * dt) ** 2)
        return float(np.arcsin(np.sqrt(squared - squared**2 / 12) / 2) / (np.pi * dt))


_ROOTS = 6 + 2 * np.sqrt(3), 6 - 2 * np.sqrt(3)  # p and q; in this order w is the smaller for short waves


class _ModifiedModes(VerletModes):
    """The same for the modified equation: Verlet's method for ``S - dt^2 S^2 / 12`` in place of the eigenvalue S, with
    a start of fourth order.
    """

    def __init__(self, symbol: np.ndarray, dt: float) -> None:
        rate = np.asarray(symbol, float)
        super().__init__(rate - dt**2 * rate**2 / 12, dt)
        self._of_velocity = 1 - dt**2 * rate / 6

    def after(self, steps: int, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """As `VerletModes.after`."""
        return super().after(steps, u, self._of_velocity * v)


@dataclass(frozen=True)
class Euler(_OneStage):
    """Forward Euler, ``u(n+1) = u(n) + dt (L u(n) + s(n))``."""

    order = 1
    equation_order: ClassVar[Literal[1]] = 1
    name = "forward Euler"
    alternates = True  # near its limit the shortest waves of diffusion change their sign with each step
    outruns = False

    @staticmethod
    def step_limit(largest: float) -> float:
        """Largest stable step for the largest eigenvalue of -L."""
        return 2.0 / largest

    @staticmethod
    def stages(dt: float, damping: float = 0.0, increments: bool = False, lasting: bool = False) -> Stages:
        """Stages of one step; the base has no part in it."""
        return Stages(2, (((0, 1, 1),), ((1, 0, 0),)), ((1.0, 0.0, dt, dt),))

    @staticmethod
    def growth(symbol: np.ndarray, dt: float) -> np.ndarray:
        """Factor of one step for eigenvalues -symbol."""
        return 1 - dt * symbol


@dataclass(frozen=True)
class RungeKutta4:
    """The classical Runge-Kutta method of fourth order."""

    order = 4
    equation_order: ClassVar[Literal[1]] = 1
    name = "Runge-Kutta 4"
    alternates = False
    outruns = False

    @staticmethod
    def step_limit(largest: float) -> float:
        """Largest stable step for the largest eigenvalue of -L."""
        return RK4_REAL_LIMIT / largest

    @staticmethod
    def stages(dt: float, damping: float = 0.0, increments: bool = False, lasting: bool = False) -> Stages:
        """Stages of one step: u + dt L (u + dt/2 L (u + dt/3 L (u + dt/4 L u))); with `lasting` the base outlives its
        stage.
        """
        rotation = _closed_cycle(((0, 0, 1), (1, 0, 2), (2, 0, 1), (1, 0, 2 if lasting else 0)))
        return Stages(3, rotation, tuple((0.0, 1.0, dt / j, dt) for j in (4, 3, 2, 1)))

    @staticmethod
    def source_samples(dt: float) -> tuple[tuple[float, ...], np.ndarray]:
        """Times within a step at which a source is read, and its weight in each stage, shape (stages, times).

        The weights make the nested form equal to the classical method for any source.
        """
        return (0.0, dt / 2, dt), np.array([[1 / 4, 0, 0], [1 / 6, 1 / 6, 0], [1 / 6, 2 / 6, 0], [1 / 6, 4 / 6, 1 / 6]])

    @staticmethod
    def prescribed_samples(dt: float) -> tuple[tuple[float, ...], np.ndarray]:
        """Times within a step, and their weights in the value that a prescribed node takes after each stage, shape
        (stages, times).

        Stage j multiplies its operator by dt/j, so that these are j times the weights of a source: a prescribed node
        acts on its neighbours as the source that it is to them.
        """
        return (0.0, dt / 2, dt), np.array([[1 / 2, 1 / 2, 0], [1 / 3, 2 / 3, 0], [1 / 6, 4 / 6, 1 / 6], [0, 0, 1]])

    @staticmethod
    def growth(symbol: np.ndarray, dt: float) -> np.ndarray:
        """Factor of one step for eigenvalues -symbol."""
        z = -dt * symbol
        return 1 + z * (1 + z / 2 * (1 + z / 3 * (1 + z / 4)))


@dataclass(frozen=True)
class RungeKuttaChebyshev(Storable):
    """Stabilised explicit method of second order: its stable step grows with the square of the number of stages.

    If no time step is given, it follows the initial data, or is that of Euler's method if anything else drives the
    field: specify `dt` to use longer steps.

    One step is the polynomial ``a + b T_s(w0 + w1 z)`` of z = dt L with Verwer's damping 2/13 (Sommeijer, Shampine and
    Verwer 1998, J. Comput. Appl. Math. 88, section 2). For a linear operator the Chebyshev polynomials need only three
    terms, ``Y_j = mu Y_(j-1) + nu Y_(j-2) + mu' (L Y_(j-1) + s)`` with mu + nu = 1, and the last of them is combined
    with the initial level by a stage without operator: stages of the kind that the engine provides, and three levels.

    Parameters
    ----------
    chebyshev : int
        Number of stages s of a step, >= 2: the limit is about ``0.65 s^2 / largest eigenvalue``, compared with 2.8 for
        the four stages of Runge-Kutta 4.

    Raises
    ------
    InputError
        Fewer than 2 or more than 1000 stages.

    Examples
    --------
    >>> import farhorizon as fh
    >>> slow, fast = (fh.Diffusion(fh.Kernel(3.0), integrator=one) for one in ("euler", fh.RungeKuttaChebyshev(20)))
    >>> lattice = fh.Lattice(1.0, -9, 9)
    >>> limits = [fh.Simulation(lattice, one, fh.Fixed()).step_limit for one in (slow, fast)]
    >>> bool(limits[1] > 100 * limits[0])
    True
    """

    chebyshev: int = 20
    order = 2
    equation_order: ClassVar[Literal[1]] = 1
    name = "Runge-Kutta-Chebyshev"
    alternates = False
    outruns = True  # stable steps may be much longer than those that follow the field

    def __post_init__(self) -> None:
        kinds.set_fields(
            self, chebyshev=kinds.integer(self.chebyshev, "model.integrator.chebyshev", least=2, most=1000)
        )

    @classmethod
    def for_step(cls, dt: float, largest: float) -> RungeKuttaChebyshev:
        """The method with the fewest stages for which a step is stable, for the largest eigenvalue of -L."""
        stages = max(2, int(np.sqrt(1.5 * dt * largest)))  # undamped, dt largest = 2 (s^2 - 1) / 3 is stable
        while stages < 1000 and cls(stages).step_limit(largest) < dt * (1 + MARGIN):
            stages += 1
        return cls(stages)

    def _shift(self) -> tuple[float, float, np.ndarray, np.ndarray]:
        """w0, w1 and T_j, T_j' at w0 for j = 0..s."""
        s = self.chebyshev
        w0 = 1 + 2 / 13 / s**2  # the damping of Sommeijer, Shampine and Verwer
        values, slopes, bends = np.zeros((3, s + 1))
        values[:2], slopes[1] = (1, w0), 1
        for j in range(2, s + 1):
            values[j] = 2 * w0 * values[j - 1] - values[j - 2]
            slopes[j] = 2 * values[j - 1] + 2 * w0 * slopes[j - 1] - slopes[j - 2]
            bends[j] = 4 * slopes[j - 1] + 2 * w0 * bends[j - 1] - bends[j - 2]
        return w0, slopes[s] / bends[s], values, slopes

    def _mix(self) -> tuple[float, float]:
        """Weights of the start and of the last Chebyshev stage (which is 1 at z = 0) in the result."""
        _, w1, values, slopes = self._shift()
        last = values[-1] / (w1 * slopes[-1])  # b T_s with b = 1 / (w1 T_s'): the first derivative is 1
        return 1 - last, last

    def step_limit(self, largest: float) -> float:
        """Largest stable step for the largest eigenvalue of -L."""
        w0, w1, _, _ = self._shift()
        return float((1 + w0) / w1 / largest)

    def stages(self, dt: float, damping: float = 0.0, increments: bool = False, lasting: bool = False) -> Stages:
        """Stages of one step: the Chebyshev polynomials in levels 1 and 2, the initial values in level 0, which
        receives the combination. With `lasting` there is one more level, and the base outlives its stage.
        """
        w0, w1, values, _ = self._shift()
        turns, last = 2 + lasting, self.chebyshev
        place = [0, *(1 + (j - 1) % turns for j in range(1, last + 2))]
        rotation, numbers = [(0, 0, 1)], [(0.0, 1.0, w1 / w0 * dt, w1 / w0 * dt)]
        for j in range(2, last + 1):
            scale = 2 * w1 * values[j - 1] / values[j] * dt
            rotation.append((place[j - 1], place[j - 2], place[j]))
            numbers.append((2 * w0 * values[j - 1] / values[j], -values[j - 2] / values[j], scale, scale))
        weights = self._mix()
        rotation.append((place[last], 0, place[last + 1] if lasting else 0))
        numbers.append((weights[1], weights[0], 0.0, 0.0))
        return Stages(turns + 1, _closed_cycle(tuple(rotation)), tuple(numbers))

    def _times(self) -> np.ndarray:
        """Time of each Chebyshev stage in steps, from the start (0) to the last (about 3, before it is mixed with the
        start); shape (s + 1,).
        """
        _, w1, values, slopes = self._shift()
        return w1 * slopes / values

    def source_samples(self, dt: float) -> tuple[tuple[float, ...], np.ndarray]:
        """Times within a step at which a source is read, and its weight in each stage, shape (stages, times).

        The stages lie outside the step; what varies in time is extrapolated to them linearly from the two ends of the
        step, which is as accurate as the method.
        """
        times = np.append(self._times()[:-1], 0.0)
        return (0.0, dt), np.stack([1 - times, times], axis=1)

    def prescribed_samples(self, dt: float) -> tuple[tuple[float, ...], np.ndarray]:
        """Times within a step, and their weights in the value that a prescribed node has after each stage, shape
        (stages, times).
        """
        times = np.append(self._times()[1:], 1.0)
        return (0.0, dt), np.stack([1 - times, times], axis=1)

    def growth(self, symbol: np.ndarray, dt: float) -> np.ndarray:
        """Amplification factor of one step for eigenvalues -symbol."""
        w0, w1, values, _ = self._shift()
        start, last = self._mix()
        x = w0 - w1 * dt * np.asarray(symbol, float)
        inner = np.cos(self.chebyshev * np.arccos(np.clip(x, -1, 1)))
        outer = np.cosh(self.chebyshev * np.arccosh(np.maximum(np.abs(x), 1))) * np.sign(x) ** self.chebyshev
        return start + last / values[-1] * np.where(np.abs(x) <= 1, inner, outer)


Integrator = Verlet | ModifiedEquation | Euler | RungeKutta4 | RungeKuttaChebyshev


def stage_effects(stages: Stages) -> np.ndarray:
    """Effect of a unit added to the output of each stage on the state after the step, if the operator does not act on
    it, shape (stages,): a conserved quantity changes in a step by the sum over the stages of effect times scale times
    the flow into the input of the stage.
    """
    rotation = stages.rotation[0]
    effects = np.zeros(len(rotation))
    for unit in range(len(rotation)):
        levels = np.zeros(stages.levels)
        levels[rotation[unit][2]] = 1
        for (source, base, out), (a, b, _, _) in list(zip(rotation, stages.numbers, strict=True))[unit + 1 :]:
            levels[out] = a * levels[source] + b * levels[base]
        effects[unit] = levels[stages.rotation[1 % len(stages.rotation)][0][0]]
    return effects

"""Ji, Pang, Zhang, Yang and Perdikaris (2021): exact artificial boundary conditions of 1D semi-discretized
peridynamics.

The construction of the paper is continuous in time: the responses g_m of the infinite chain to an impulse give the
kernels f of the half-infinite chain by an integral equation, and these are convolved with the drivers by the
trapezoidal rule. `analysis.exact.chain` computes the kernels of the fully discrete scheme instead; both are run here.
Two printed statements do not lead to the printed numbers and are corrected (`INTERFACE`, `PULSE`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy import fft, special
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

from farhorizon.analysis.exact.chain import Recursion, force_form, fronts, ghost_kernel, symbol
from farhorizon.papers import LINE, reproduction
from farhorizon.papers.bar import Bar, bonds_of
from farhorizon.papers.bar_loops import bar_acceleration, recursive_impulse
from farhorizon.studies.collection import Comparison, Outcome, Row, Setting

PAPER = (
    "Ji, Pang, Zhang, Yang, Perdikaris (2021), Exact artificial boundary conditions of 1D semi-discretized peridynamics"
)
# published, as all numbers below unless they say more
SPACING, WIDTH, HORIZON = 0.1, 0.25, 0.75
STEPS = (0.001, 0.002, 0.0025, 0.004, 0.005)
BEAM = np.array([4.0, -1.0])  # Euler-Bernoulli, eq 29
THEIRS, OURS = "Ji et al., trapezoidal rule", "fully discrete kernel"  # names of the boundaries
INTERFACE = "the soft part is |x| < 4 strictly, without the nodes at 4: only this leads to the printed numbers"
PULSE = "the pulse acts until t = 10, not 5 as printed: only this leads to the printed numbers"
ALL_NODES = "the errors are the largest over all nodes, not those of the left end as the text says"
KERNEL_ERRORS = "the printed errors are differences from the same method at half the smallest step"
REST = "the reference is exact in time, by the modes of a chain from whose ends nothing returns"
LEFT, ORIGIN, RIGHT = 0, 100, 200  # nodes whose histories are shown in the paper
State = tuple[np.ndarray, np.ndarray]

# Kernels of the chain in continuous time


def micromodulus(distance: np.ndarray) -> np.ndarray:
    """C of eq 35, zero beyond the horizon of 0.75."""
    inside = np.abs(distance) < HORIZON + 1e-9
    return np.where(inside, 4 / (WIDTH**3 * np.sqrt(np.pi)) * np.exp(-((distance / WIDTH) ** 2)), 0.0)


def bar_weights() -> np.ndarray:
    """a_1 .. a_7 of eq 4 for the bar; shape (7,)."""
    reach = int(np.floor(HORIZON / SPACING + 1e-9))
    return micromodulus(SPACING * np.arange(1, reach + 1)) * SPACING


def impulse_response(weights: np.ndarray, dt: float, steps: int) -> np.ndarray:
    """g_0 .. g_(2K-1) of the infinite chain at t = 0, dt, .. (eqs 22 to 24), exact in time; shape (steps + 1, 2K).

    The trapezoidal rule for the integral over wavenumbers gives the response of a periodic chain, which is made so long
    that waves that travel round it are below rounding.
    """
    zone = np.linspace(0, np.pi, 4097)
    travel = np.abs(np.gradient(np.sqrt(symbol(weights, zone)), zone)).max() * dt * steps
    nodes = 2 * int(travel / 2 + 4 * weights.size + 8 * np.cbrt(travel) + 8)
    angle = 2 * np.pi * np.arange(1, nodes // 2 + 1) / nodes
    omega = np.sqrt(symbol(weights, angle))
    amplitudes = np.where(angle < np.pi, 2.0, 1.0) / nodes / omega  # both signs of the wavenumber
    waves = amplitudes[:, None] * np.cos(np.multiply.outer(angle, np.arange(2 * weights.size)))
    g = np.empty((steps + 1, 2 * weights.size))
    for start in range(0, steps + 1, 4096):
        t = dt * np.arange(start, min(start + 4096, steps + 1))
        # the rigid motion contributes t / nodes
        g[start : start + t.size] = np.sin(np.multiply.outer(t, omega)) @ waves + t[:, None] / nodes
    return g


def recursive_response(weights: np.ndarray, dt: float, steps: int) -> np.ndarray:
    """g_0 .. g_(2K-1) by the paper's method, Runge-Kutta 4 closed by the recursion of eq 27; shape (steps + 1, 2K).

    It works for K = 2 (the paper's test). For other stencils the closed system has solutions that grow at the rate
    ``max |Im w(c)|`` over the complex critical points of the symbol (0.41 for the bar), so that it is useless beyond
    short times.
    """
    return recursive_impulse(weights, dt, steps)


def semi_discrete_kernel(weights: np.ndarray, g: np.ndarray, dt: float) -> np.ndarray:
    """Ghost kernels f of the half-infinite chain by the trapezoidal rule (eq 34), as a quotient of power series in the
    shift by dt; shape (steps + 1, K, K), for the ghosts -n (n = 0 .. K - 1) and the drivers m = 1 .. K.

    With P[a, n, l] = sum over k > l of a_k g_|k + n - l| and R[a, n, m - 1] = sum over k of a_(k + m) g_|k - n|, eq 34
    reads ``f + dt P * f = R``. (I + dt P) is inverted by Newton's method for power series, with products by FFT.
    """
    reach = weights.size
    left, right = np.zeros((2, len(g), reach, reach))
    for n in range(reach):
        for j in range(reach):
            for k in range(j + 1, reach + 1):
                left[:, n, j] += dt * weights[k - 1] * g[:, abs(k + n - j)]
            for k in range(reach - j):
                right[:, n, j] += weights[k + j] * g[:, abs(k - n)]
    left[0] += np.eye(reach)
    return _product(_inverse(left), right, len(g))


def _product(left: np.ndarray, right: np.ndarray, size: int) -> np.ndarray:
    """First `size` terms of the product of two matrix power series."""
    length = fft.next_fast_len(min(size, len(left)) + min(size, len(right)) - 1, real=True)
    spectrum = np.matmul(fft.rfft(left[:size], length, axis=0), fft.rfft(right[:size], length, axis=0))
    return fft.irfft(spectrum, length, axis=0)[:size]


def _inverse(series: np.ndarray) -> np.ndarray:
    """Reciprocal of a matrix power series whose constant term is the identity."""
    out, size = series[:1].copy(), 1
    while size < len(series):
        size = min(2 * size, len(series))
        rest = -_product(series, out, size)
        rest[0] += 2 * np.eye(series.shape[1])
        out = _product(out, rest, size)
    return out


def verlet(dt: float) -> Recursion:
    """Velocity Verlet as a recursion in increments."""
    return Recursion(keep=1.0, scale=dt**2, first=0.5)


@cache
def _paper_kernel(dt: float, steps: int) -> np.ndarray:
    """Force kernel of the paper's boundary for the bar; its first sample has the weight 1/2 of the trapezoidal rule (eq
    42).
    """
    weights = bar_weights()
    return dt * force_form(semi_discrete_kernel(weights, impulse_response(weights, dt, steps), dt), weights)


@cache
def _discrete_kernel(dt: float, steps: int) -> np.ndarray:
    """Force kernel of the fully discrete chain for the bar."""
    weights = bar_weights()
    return force_form(ghost_kernel(weights, verlet(dt), steps), weights)


def beam_kernel(t: float) -> np.ndarray:
    """Exact f of the Euler-Bernoulli beam (K = 2) at one time, shape (2, 2): ghosts 0, -1 and drivers 1, 2.

    On the cut s = i w + 0 with w = 4 sin^2(x/2), the two decaying roots are exp(-i x) and ``1 + w/2 - sqrt(w +
    w^2/4)``. The first ghost has (sum of roots, -product of roots), the next one the square of their companion matrix,
    and f(t) = -2/pi int Im(f~) sin(w t) dw. The first entry is ``2 J_1(2t) sin(2t)/t``.
    """
    panels = int(10 + t)
    points, gauss = np.polynomial.legendre.leggauss(20)
    x = ((np.arange(panels)[:, None] + (points + 1) / 2) * np.pi / panels).ravel()
    w = 4 * np.sin(x / 2) ** 2
    first, second = np.exp(-1j * x), 1 + w / 2 - np.sqrt(w + w**2 / 4)
    total, product = first + second, first * second
    values = np.array([[total, -product], [total**2 - product, -total * product]])
    weight = np.tile(gauss, panels) * np.pi / panels / 2 * 2 * np.sin(x) * np.sin(w * t)
    return -2 / np.pi * (values.imag * weight).sum(-1)


# The published examples


@dataclass(frozen=True)
class BarExample:
    """A bar on -10 .. 10 (201 nodes) with the paper's boundary; `soft` is the factor of the bonds in |x| < 4 (eq 44).
    If `seismic`, it starts at rest with a Ricker pulse at the origin until t = 10 and a free right end, instead of the
    Gaussian of eq 36.
    """

    soft: float = 1.0
    seismic: bool = False

    def coordinates(self, pad: int = 0) -> np.ndarray:
        """Coordinates of the nodes, with `pad` more of them beyond each exact end."""
        return SPACING * np.arange(-100 - pad, 101 + (0 if self.seismic else pad))

    def setup(self, pad: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Initial values, shape (N,), and bonds, shape (7, N)."""
        x = self.coordinates(pad)
        coefficient = np.where(np.abs(x) < 4 - 1e-9, self.soft, 1.0)
        u = np.where(np.abs(x) < SPACING / 2, ricker(0.0), 0.0) if self.seismic else np.exp(-(x**2))
        u[np.abs(x) > 10 + 1e-9] = 0
        return u, bonds_of(bar_weights(), x.size, coefficient)

    def run(
        self, dt: float, times: Sequence[float], kernel: np.ndarray | None, first: float | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """u and u_t in the near field at given times by velocity Verlet; shapes (times, 201).

        `kernel` and `first` specify the boundary; without a kernel the chain is so long that nothing returns.
        """
        weights, recursion = bar_weights(), verlet(dt)
        steps = [round(t / dt) for t in times]
        pad = 0 if kernel is not None else int(fronts(weights, recursion, steps[-1])[-1]) // 2 + 20
        u, bonds = self.setup(pad)
        node = pad + 100
        held: dict[int, Callable[[int], float]] = {node: lambda n: ricker(n * dt)} if self.seismic else {}
        ends = (None, None) if kernel is None else (kernel, None if self.seismic else kernel)
        bar = Bar(weights, recursion, u, bonds=bonds, ends=ends, held=held, first=first)
        near = slice(pad, pad + 201)
        states, at = [], u
        for number in steps:
            if self.seismic and bar.step < round(PULSE_END / dt) <= number:
                bar.run(round(PULSE_END / dt) - bar.step)
                at = bar.u.copy()
                bar.release(node, dt * ricker_rate(PULSE_END))
            if number > bar.step:
                bar.run(number - bar.step)
                at = bar.u.copy()
            before = bar.d.copy()
            bar.run(1)
            states.append((at[near], (before + bar.d)[near] / (2 * dt)))
        return np.array([u for u, _ in states]), np.array([v for _, v in states])

    def reference(self, times: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
        """u and u_t in the near field for the chain discrete in space and exact in time; shapes (times, 201)."""
        weights = bar_weights()
        # the fastest wave travels 10 nodes per unit of time, and must not return
        pad = int(5.2 * times[-1] + 12 * np.cbrt(times[-1]) + 60)
        u, bonds = self.setup(pad)
        operator = np.zeros((u.size, u.size))
        for k in range(1, weights.size + 1):
            i = np.arange(u.size - k)
            operator[i, i + k] = operator[i + k, i] = bonds[k - 1, :-k]
        operator -= np.diag(operator.sum(1))
        v, start = np.zeros(u.size), 0.0
        states: list[State] = []
        if self.seismic:
            start = PULSE_END
            states, (u, v) = _forced(u, bonds, pad + 100, [t for t in times if t < start])
        squares, modes = eigh(-operator)
        omega = np.sqrt(np.maximum(squares, 0.0))
        shares, rates = modes.T @ u, modes.T @ v
        for t in times[len(states) :]:
            angle = omega * (t - start)
            states.append(
                (
                    modes @ (shares * np.cos(angle) + rates * (t - start) * np.sinc(angle / np.pi)),
                    modes @ (rates * np.cos(angle) - shares * omega * np.sin(angle)),
                )
            )
        near = slice(pad, pad + 201)
        return np.array([u[near] for u, _ in states]), np.array([v[near] for _, v in states])


PULSE_END = 10.0
_PULSE = (np.pi * 0.2) ** 2  # pi^2 f_p^2, peak frequency 0.2
_DELAY = 5.0


def ricker(t: float) -> float:
    """Displacement of the origin (eq 45)."""
    q = _PULSE * (t - _DELAY) ** 2
    return float((1 - 2 * q) * np.exp(-q))


def ricker_rate(t: float) -> float:
    """Time derivative of `ricker`."""
    q = _PULSE * (t - _DELAY) ** 2
    return float(_PULSE * (t - _DELAY) * (4 * q - 6) * np.exp(-q))


def _forced(u: np.ndarray, bonds: np.ndarray, node: int, times: Sequence[float]) -> tuple[list[State], State]:
    """u and u_t of the chain whose `node` follows the pulse, at given times before its end, and at its end.

    By the Dormand-Prince method of order 8.
    """
    size = u.size
    force = np.empty(size)

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        value = y[:size].copy()
        value[node] = ricker(t)
        bar_acceleration(value, bonds, force)
        force[node] = 0
        return np.concatenate([y[size:], force])

    moments = [*times, PULSE_END]
    start = np.concatenate([u, np.zeros(size)])
    solved = solve_ivp(slope, (0.0, PULSE_END), start, method="DOP853", rtol=1e-13, atol=1e-16, t_eval=moments).y.T
    states = [(y[:size], y[size:]) for y in solved]
    for t, (values, rates) in zip(moments, states, strict=True):
        values[node], rates[node] = ricker(t), ricker_rate(t)
    return states[:-1], states[-1]


def solution(x: np.ndarray, t: float) -> State:
    """u and u_t of the bar of eq 36 in the continuum (eq 37), by Gauss-Legendre quadrature up to k = 14, where the
    integrand is below 1e-20.
    """
    points, gauss = np.polynomial.legendre.leggauss(400)
    k, weight = 7 * (points + 1), 7 * gauss
    omega = 2 / WIDTH * np.sqrt(-np.expm1(-((k * WIDTH) ** 2) / 4))
    waves = np.cos(np.multiply.outer(x, k)) * (weight * np.exp(-(k**2) / 4)) / np.sqrt(np.pi)
    return waves @ np.cos(omega * t), -waves @ (omega * np.sin(omega * t))


# The tables


def _printed(lines: str) -> np.ndarray:
    """Printed lines of a table, shape (times, steps + 1): the errors, and the rate in the last column."""
    return np.array([[float(word) for word in line.split()] for line in lines.strip().splitlines()])


def _rows(
    times: Sequence[float], errors: np.ndarray, printed: np.ndarray, misprints: dict[tuple[int, int], tuple[float, str]]
) -> list[Row]:
    """Rows for a table of errors, shape (times, steps), and for its convergence rates."""
    rows = []
    for i, t in enumerate(times):
        for j, dt in enumerate(STEPS):
            corrected, note = misprints.get((i, j), (None, ""))
            rows.append(Row(f"t = {t:g}, dt = {dt:g}", float(errors[i, j]), float(printed[i, j]), corrected, note))
        rows.append(
            Row(f"t = {t:g}, rate", float(np.polyfit(np.log(STEPS), np.log(errors[i]), 1)[0]), float(printed[i, -1]))
        )
    return rows


def _errors(example: BarExample, times: Sequence[float], velocity: bool = False) -> np.ndarray:
    """Errors of the paper's boundary against the solution that is exact in time, shape (times, steps)."""
    exact = example.reference(times)[int(velocity)]
    errors = np.empty((len(times), len(STEPS)))
    for j, dt in enumerate(STEPS):
        computed = example.run(dt, times, _paper_kernel(dt, round(times[-1] / dt) + 1), 0.5)[int(velocity)]
        errors[:, j] = np.abs(computed - exact).max(1)
    return errors


def _settings(*, tabled: bool) -> list[Setting]:
    """Grid and steps of the bar: those of the tables, or that of the figures."""
    grid = [Setting("nodes", 201, 201), Setting("spacing", SPACING, 0.1)]
    if not tabled:
        return [*grid, Setting("time step", STEPS[-1], note="the largest of the tables")]
    return [*grid, Setting("time steps from", STEPS[0], 0.001), Setting("to", STEPS[-1], 0.005)]


def _table(
    folder: Path,
    number: int,
    figure: int,
    example: BarExample,
    times: Sequence[float],
    lines: str,
    misprints: dict[tuple[int, int], tuple[float, str]],
    velocity: bool = False,
) -> Outcome:
    """Table of errors, and the figure of its convergence with the computed and the printed values."""
    from farhorizon.pictures.curves import log_panels

    errors, printed = _errors(example, times, velocity), _printed(lines)
    path = folder / f"ji2021-fig{figure}.png"
    curves = [(f"$t = {t:g}$", np.array(STEPS), values) for t, values in zip(times, errors, strict=True)]
    log_panels(
        [("", curves)],
        path,
        xlabel=r"$\Delta t$",
        ylabel=r"$\ell_\infty$ error of the " + ("velocity" if velocity else "displacement"),
        order=2,
        printed=[list(printed[:, :-1])],
    )
    rows = _rows(times, errors, printed, misprints)
    rates = [row.ours for row in rows if row.what.endswith("rate")]
    comparisons = [
        Comparison.of_rows(f"table {number}", rows),
        Comparison(
            f"figure {figure}",
            "errors that fall with the square of the time step",
            f"rates of {min(rates):.2f} to {max(rates):.2f}",
            all(abs(rate / 2 - 1) < 0.05 for rate in rates),
        ),
    ]
    return Outcome(rows, _boundary_errors(example, times), [path], comparisons, _settings(tabled=True))


def _boundary_errors(example: BarExample, times: Sequence[float]) -> dict[str, float]:
    """Largest error of each boundary at the largest step, against a chain from whose ends nothing returns, with the
    same step.
    """
    dt, steps = STEPS[-1], round(times[-1] / STEPS[-1]) + 1
    infinite = example.run(dt, times, None)[0]
    return {
        THEIRS: float(np.abs(example.run(dt, times, _paper_kernel(dt, steps), 0.5)[0] - infinite).max()),
        OURS: float(np.abs(example.run(dt, times, _discrete_kernel(dt, steps))[0] - infinite).max()),
    }


_BEAM_DIVISIONS = (500, 400, 250, 200)
_BEAM_TIMES = (3, 18, 300, 3000)  # in units of pi


def _beam_kernels(division: int, last: int) -> np.ndarray:
    """f of the beam by the paper's method with dt = 3 pi / division, up to last * pi."""
    dt = 3 * np.pi / division
    return semi_discrete_kernel(BEAM, recursive_response(BEAM, dt, last * division // 3), dt)


_TRUE_ERROR = "true error; the printed one is against a kernel that has an error itself"


@reproduction(
    "ji2021-table1", PAPER, "kernels of the Euler-Bernoulli beam: error and convergence", readings=(KERNEL_ERRORS,)
)
def table1(folder: Path) -> Outcome:
    """Largest error over the four kernels f by fourth-order Runge-Kutta, recursion and trapezoidal rule.

    As the numbers show, the printed errors are differences from the same method at half the smallest step; these and
    the true errors are listed.
    """
    from farhorizon.pictures.curves import log_panels

    printed = {
        3: (9.26e-06, 1.63e-05, 4.79e-05, 7.88e-04, 2.32),
        18: (9.31e-07, 1.71e-06, 5.92e-06, 1.11e-05, 2.69),
        300: (3.80e-08, 8.71e-08, 5.15e-07, 1.24e-06, 3.80),
        3000: (8.51e-09, 2.16e-08, 1.52e-07, 3.93e-07, 4.17),
    }
    finest = 2 * _BEAM_DIVISIONS[0]
    fine = _beam_kernels(finest, _BEAM_TIMES[-1])
    references = {
        f"dt = 3 pi / {finest}": {t: fine[t * finest // 3] for t in _BEAM_TIMES},
        "the exact kernel": {t: beam_kernel(t * np.pi) for t in _BEAM_TIMES},
    }
    kernels = {division: _beam_kernels(division, _BEAM_TIMES[-1]) for division in _BEAM_DIVISIONS}
    steps = 3 * np.pi / np.array(_BEAM_DIVISIONS[::-1], float)
    rows, panels = [], []
    for against, reference in references.items():
        reason = _TRUE_ERROR if against == "the exact kernel" else ""
        curves = []
        for t in _BEAM_TIMES:
            errors = [
                float(np.abs(kernels[division][t * division // 3] - reference[t]).max()) for division in _BEAM_DIVISIONS
            ]
            for division, error, value in zip(_BEAM_DIVISIONS, errors, printed[t], strict=False):
                corrected = 7.88e-5 if (t, division) == (3, 200) else None
                note = "" if corrected is None else "the exponent: the columns fall like dt^2.3"
                what = f"t = {t} pi, dt = 3 pi / {division}, against {against}"
                rows.append(Row(what, error, value, corrected, note, reason))
            rate = float(-np.polyfit(np.log(_BEAM_DIVISIONS), np.log(errors), 1)[0])
            rows.append(Row(f"t = {t} pi, rate, against {against}", rate, printed[t][-1], reason=reason))
            curves.append((f"$t = {t}\\pi$", steps, np.array(errors[::-1])))
        panels.append((f"against {against}".replace("pi", "$\\pi$"), curves))
    path = folder / "ji2021-table1.png"
    circles = [np.array(printed[t][-2::-1]) for t in _BEAM_TIMES]
    log_panels(
        panels, path, xlabel=r"$\Delta t$", ylabel=r"$\ell_\infty$ error of $f$", order=2, printed=[circles, circles]
    )
    unexplained = [row for row in rows if not row.reason]
    rates = [row.ours for row in unexplained if "rate" in row.what]
    comparisons = [
        Comparison.of_rows("table 1", unexplained),
        Comparison("table 1", "rates above 2", f"rates of {min(rates):.2f} to {max(rates):.2f}", min(rates) > 2),
    ]
    settings = [Setting(f"time step 3 pi / {d}", 3 * np.pi / d, 3 * np.pi / d) for d in _BEAM_DIVISIONS]
    return Outcome(rows, pictures=[path], comparisons=comparisons, settings=settings)


@reproduction(
    "ji2021-table2",
    PAPER,
    "bar: error of the displacement (and figure 5: convergence)",
    figures=("fig5",),
    readings=(REST,),
)
def table2(folder: Path) -> Outcome:
    """Displacement of the bar at t = 5, 10, 15, 40."""
    printed = """
        4.03e-07 1.61e-06 2.51e-06 2.51e-06 1.01e-05 2.00
        1.06e-06 4.26e-06 6.65e-06 1.70e-05 2.66e-05 2.00
        7.57e-07 3.02e-06 4.72e-06 1.21e-05 1.88e-05 1.99
        1.67e-09 6.69e-09 1.04e-08 2.67e-08 4.17e-08 2.00"""
    misprints = {(0, 3): (6.45e-6, "a copy of its left neighbour; dt^2 between its neighbours")}
    return _table(folder, 2, 5, BarExample(), (5.0, 10.0, 15.0, 40.0), printed, misprints)


@reproduction(
    "ji2021-table3",
    PAPER,
    "bar: error of the velocity (and figure 6: convergence)",
    takes="10 s",
    figures=("fig6",),
    readings=(REST,),
)
def table3(folder: Path) -> Outcome:
    """Velocity of the bar at t = 5, 10, 15, 40."""
    printed = """
        9.87e-07 3.94e-06 6.16e-06 1.57e-05 2.46e-05 2.00
        2.25e-06 9.03e-06 1.41e-05 3.61e-05 5.64e-05 2.00
        7.94e-07 3.17e-06 4.96e-06 1.26e-05 1.98e-05 2.00
        8.87e-09 3.54e-08 5.54e-08 1.41e-07 2.21e-07 2.00"""
    return _table(folder, 3, 6, BarExample(), (5.0, 10.0, 15.0, 40.0), printed, {}, velocity=True)


@reproduction(
    "ji2021-table4",
    PAPER,
    "interface, beta = 0.5: error of the displacement (and figure 10: convergence)",
    figures=("fig10",),
    readings=(INTERFACE, REST),
)
def table4(folder: Path) -> Outcome:
    """Displacement of the composite bar, which is half as stiff within |x| < 4."""
    printed = """
        2.33e-07 9.34e-07 1.46e-06 3.73e-06 5.84e-06 2.00
        6.39e-07 2.55e-06 3.99e-06 1.02e-05 1.59e-05 2.00
        2.33e-07 9.33e-06 1.45e-06 3.72e-06 5.82e-06 2.00
        9.78e-11 3.90e-10 6.11e-10 1.56e-09 2.43e-09 2.00"""
    misprints = {(2, 1): (9.33e-7, "the exponent: dt^2 between its neighbours")}
    return _table(folder, 4, 10, BarExample(soft=0.5), (10.0, 15.0, 40.0, 100.0), printed, misprints)


@reproduction(
    "ji2021-table5",
    PAPER,
    "interface, beta = 0.1: error of the displacement (and figure 11: convergence)",
    figures=("fig11",),
    readings=(INTERFACE, REST),
)
def table5(folder: Path) -> Outcome:
    """Displacement of the composite bar, which is a tenth as stiff within |x| < 4."""
    printed = """
        2.44e-08 9.76e-08 1.52e-07 3.90e-07 6.10e-07 2.00
        7.90e-08 3.16e-07 4.93e-07 1.26e-06 1.97e-06 2.00
        8.13e-07 3.25e-06 5.08e-06 1.30e-05 2.03e-05 2.00
        3.90e-07 1.56e-06 2.44e-06 6.24e-06 9.75e-06 2.00"""
    return _table(folder, 5, 11, BarExample(soft=0.1), (10.0, 15.0, 40.0, 100.0), printed, {})


@reproduction(
    "ji2021-table6",
    PAPER,
    "seismic source: error of the displacement (and figure 14: convergence)",
    takes="10 s",
    figures=("fig14",),
    readings=(PULSE, ALL_NODES, REST),
)
def table6(folder: Path) -> Outcome:
    """Displacement of the half-infinite bar with a Ricker pulse at the origin; the largest error over all nodes, not
    that at the left end as the text says.
    """
    printed = """
        8.46e-07 3.38e-06 5.29e-06 1.35e-05 2.11e-05 2.00
        2.78e-06 1.11e-05 1.74e-05 4.45e-05 6.96e-05 2.00
        1.38e-06 5.55e-06 8.67e-06 2.21e-05 3.47e-05 2.00
        1.11e-06 4.49e-06 7.03e-06 1.82e-05 2.87e-05 2.02"""
    return _table(folder, 6, 14, BarExample(seismic=True), (10.0, 15.0, 40.0, 100.0), printed, {})


# The figures


@reproduction("ji2021-fig2", PAPER, "kernel f_0^1 of the Euler-Bernoulli beam at large times, numerical and analytical")
def figure2(folder: Path) -> Outcome:
    """f_0^1 on [2990 pi, 3000 pi] by the paper's method, compared with ``2 J_1(2t) sin(2t)/t``."""
    from farhorizon.pictures.curves import curve_panels

    division = _BEAM_DIVISIONS[0]
    dt = 3 * np.pi / division
    first, last = round(2990 * division / 3), 3000 * division // 3
    t = dt * np.arange(first, last + 1)
    numerical = _beam_kernels(division, 3000)[first:, 0, 0]
    analytical = 2 * special.j1(2 * t) * np.sin(2 * t) / t
    path = folder / "ji2021-fig2.png"
    place = t / np.pi
    compared = [("analytical", place, analytical), ("numerical", place, numerical)]
    difference = [("numerical less analytical", place, numerical - analytical)]
    curve_panels([("", compared), ("", difference)], path, xlabel="$t/\\pi$", ylabel="$f_0^1(t)$")
    rows = [
        Row("largest |f_0^1|, analytical", float(np.abs(analytical).max()), note="the figure prints no number"),
        Row("largest |f_0^1|, numerical", float(np.abs(numerical).max())),
        Row(
            "largest difference, dt = 3 pi / 500",
            float(np.abs(numerical - analytical).max()),
            note="table 1 has the four kernels at 3000 pi",
        ),
    ]
    apart = float(np.abs(numerical - analytical).max() / np.abs(analytical).max())
    compared_here = Comparison(
        "figure 2",
        "the numerical kernel on the analytical one, 2 J_1(2t) sin(2t)/t",
        f"a largest difference of {100 * apart:.1g} % of the largest value",
        apart < LINE,
    )
    settings = [Setting("time step 3 pi / 500", dt, note="the smallest of table 1")]
    return Outcome(rows, pictures=[path], comparisons=[compared_here], settings=settings)


_TIMES = (5.0, 10.0, 15.0, 40.0)  # of figures 3 and 4


def _snapshots(folder: Path, figure: int, velocity: bool) -> Outcome:
    """The bar at four times with both boundaries, compared with the continuum (eq 37)."""
    from farhorizon.pictures.curves import curve_panels

    example, dt, field = BarExample(), STEPS[-1], int(velocity)
    steps, x = round(_TIMES[-1] / dt) + 1, example.coordinates()
    analytical = [solution(x, t)[field] for t in _TIMES]
    computed = {
        THEIRS: example.run(dt, _TIMES, _paper_kernel(dt, steps), 0.5)[field],
        OURS: example.run(dt, _TIMES, _discrete_kernel(dt, steps))[field],
    }
    panels, rows = [], []
    for n, (t, exact) in enumerate(zip(_TIMES, analytical, strict=True)):
        panels.append(
            (
                f"$t = {t:g}$",
                [("analytical (eq 37)", x, exact), *((name, x, values[n]) for name, values in computed.items())],
            )
        )
        rows += [
            Row(
                f"t = {t:g}, largest difference from eq 37, {name}",
                float(np.abs(values[n] - exact).max()),
                note=f"largest value: {np.abs(exact).max():.1e}",
            )
            for name, values in computed.items()
        ]
    path = folder / f"ji2021-fig{figure}.png"
    curve_panels(panels, path, xlabel="$x$", ylabel="$u_t$" if velocity else "$u$")
    largest = np.abs(analytical[0]).max()
    apart = float(np.abs(computed[THEIRS] - analytical).max() / largest)
    gone = float(np.abs(analytical[-1]).max() / largest)
    compared = Comparison(
        f"figure {figure}",
        "two humps that leave, numerical on analytical (eq 37), and almost nothing left at t = 40",
        f"a largest difference of {100 * apart:.1g} % and at t = 40 a largest value of {100 * gone:.1g} % of the "
        "largest value at t = 5",
        apart < LINE and gone < LINE,
    )
    return Outcome(rows, _boundary_errors(example, _TIMES), [path], [compared], _settings(tabled=False))


@reproduction("ji2021-fig3", PAPER, "bar: displacement at t = 5, 10, 15, 40, numerical and analytical")
def figure3(folder: Path) -> Outcome:
    """Displacement of the bar."""
    return _snapshots(folder, 3, False)


@reproduction("ji2021-fig4", PAPER, "bar: velocity at t = 5, 10, 15, 40, numerical and analytical")
def figure4(folder: Path) -> Outcome:
    """Velocity of the bar."""
    return _snapshots(folder, 4, True)


@cache
def histories(example: BarExample, until: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times from 0 on, shape (n,), and u in the near field at these times, shape (n, 201).

    u is given for the chain that is exact in time ("reference"), and for both boundaries at the paper's largest step.
    """
    times = tuple(0.2 * np.arange(round(until / 0.2) + 1))
    dt, steps = STEPS[-1], round(until / STEPS[-1]) + 1
    kernels = {THEIRS: (_paper_kernel(dt, steps), 0.5), OURS: (_discrete_kernel(dt, steps), None)}
    runs = {name: example.run(dt, times, kernel, first)[0] for name, (kernel, first) in kernels.items()}
    return np.array(times), {"reference": example.reference(times)[0], **runs}


_BETAS, _LONG = (1.0, 0.5, 0.1), 100.0


@reproduction(
    "ji2021-fig8",
    PAPER,
    "interface: displacement of the origin and of the right end over time, beta = 1, 0.5, 0.1",
    takes="30 s",
    readings=(INTERFACE,),
)
def figure8(folder: Path) -> Outcome:
    """Histories up to t = 100. The largest maximum and minimum are compared with those of a local bar, in which the
    soft part has the reflection coefficient (sqrt(beta) - 1)/(sqrt(beta) + 1).
    """
    from farhorizon.pictures.curves import curve_panels

    rows, humps, hollows = [], [], []
    curves: dict[int, list[tuple[str, np.ndarray, np.ndarray]]] = {ORIGIN: [], RIGHT: []}
    for beta in _BETAS:
        times, runs = histories(BarExample(soft=beta), _LONG)
        for node, part in curves.items():
            part.append((rf"$\beta = {beta:g}$", times, runs[OURS][:, node]))
        local = (np.sqrt(beta) - 1) / (np.sqrt(beta) + 1)
        hump, hollow = runs[OURS][:, RIGHT], runs[OURS][:, ORIGIN]
        humps.append(float(hump.max()))
        hollows.append(float(-hollow.min()))
        note = "the figure prints no number; half of the pulse, transmitted"
        rows += [
            Row(
                f"beta = {beta:g}, first hump of the right end",
                float(hump.max()),
                note=f"{note}: local bar {(1 + local) / 2:.3f}",
            ),
            Row(
                f"beta = {beta:g}, its time", float(times[hump.argmax()]), note=f"local bar {4 / np.sqrt(beta) + 6:.3g}"
            ),
            Row(
                f"beta = {beta:g}, first hollow of the origin",
                float(hollow.min()),
                note=f"both halves, reflected: local bar {local:.3f}",
            ),
        ]
        if beta < 1:
            rows.append(
                Row(
                    f"beta = {beta:g}, its time",
                    float(times[hollow.argmin()]),
                    note=f"local bar {8 / np.sqrt(beta):.3g}",
                )
            )
    path = folder / "ji2021-fig8.png"
    curve_panels(
        [("origin", curves[ORIGIN]), ("right end", curves[RIGHT])], path, xlabel="$t$", ylabel="$u$", reference=""
    )
    compared = [
        Comparison(
            "figure 8 a",
            "no hollow of the origin for beta = 1, and a deeper first one for a smaller beta",
            f"hollows of {', '.join(f'{h:.3f}' for h in hollows)} for beta = 1, 0.5, 0.1",
            hollows[0] < LINE and hollows[0] < hollows[1] < hollows[2],
        ),
        Comparison(
            "figure 8 b",
            "a lower first hump of the right end for a smaller beta",
            f"humps of {', '.join(f'{h:.3f}' for h in humps)} for beta = 1, 0.5, 0.1",
            humps[0] > humps[1] > humps[2],
        ),
    ]
    return Outcome(rows, pictures=[path], comparisons=compared, settings=_settings(tabled=False))


@reproduction(
    "ji2021-fig9",
    PAPER,
    "interface: error of the displacement of the origin and of the right end over time, beta = 1, 0.5, 0.1",
    takes="40 s",
    readings=(INTERFACE, REST),
)
def figure9(folder: Path) -> Outcome:
    """Differences from the chain that is exact in time up to t = 100, at the paper's largest step: they contain the
    errors of the time step and of the boundary.
    """
    from farhorizon.pictures.curves import log_panels

    rows, panels = [], []
    for beta in _BETAS:
        times, runs = histories(BarExample(soft=beta), _LONG)
        curves = []
        for place, node in (("origin", ORIGIN), ("right end", RIGHT)):
            for name in (THEIRS, OURS):
                error = np.abs(runs[name][:, node] - runs["reference"][:, node])
                curves.append((f"{place}, {name}", times, error))
                rows.append(
                    Row(
                        f"beta = {beta:g}, {place}, {name}, largest error",
                        float(error.max()),
                        note="the figure prints no number",
                    )
                )
                rows.append(Row(f"beta = {beta:g}, {place}, {name}, error at t = 100", float(error[-1])))
        panels.append((rf"$\beta = {beta:g}$, $\Delta t = {STEPS[-1]:g}$", curves))
    path = folder / "ji2021-fig9.png"
    log_panels(panels, path, xlabel="$t$", ylabel=r"$|u - u_\mathrm{ref}|$")
    largest = max(row.ours for row in rows if THEIRS in row.what)
    # the largest error of tables 4 and 5, at four times only
    tabled = 2.03e-5
    compared = Comparison(
        "figure 9",
        f"errors of the size of tables 4 and 5, to {tabled:g}, without a number of its own",
        f"errors to {largest:.2e} over the whole time at the step of {STEPS[-1]:g}",
        largest < 2 * tabled,
    )
    return Outcome(rows, pictures=[path], comparisons=[compared], settings=_settings(tabled=False))


@reproduction(
    "ji2021-fig13",
    PAPER,
    "seismic source: displacement of the origin, the right and the left end over time",
    readings=(PULSE, REST),
)
def figure13(folder: Path) -> Outcome:
    """Histories up to t = 60, compared with the chain that is exact in time; maxima are compared with those of a local
    bar, whose free end doubles the pulse and reflects it.
    """
    from farhorizon.pictures.curves import curve_panels

    example = BarExample(seismic=True)
    times, runs = histories(example, 60.0)
    rows, panels = [], []
    for place, node, humps in (
        ("origin", ORIGIN, {5: 1, 25: 1}),
        ("right end", RIGHT, {15: 2}),
        ("left end", LEFT, {15: 1, 35: 1}),
    ):
        panels.append((place, [(name, times, values[:, node]) for name, values in runs.items()]))
        for t, height in humps.items():
            near = np.abs(times - t) < 5
            ours, at = runs[OURS][near, node], times[near]
            rows += [
                Row(
                    f"{place}, hump about t = {t}",
                    float(ours.max()),
                    note=f"local bar {height}; the figure prints no number",
                ),
                Row(f"{place}, its time", float(at[ours.argmax()]), note=f"local bar {t}"),
            ]
        rows += [
            Row(
                f"{place}, largest difference from the reference, {name}",
                float(np.abs(runs[name] - runs["reference"])[:, node].max()),
            )
            for name in (THEIRS, OURS)
        ]
    path = folder / "ji2021-fig13.png"
    curve_panels(panels, path, xlabel="$t$", ylabel="$u$")
    compared = _seismic_humps(times, runs[THEIRS])
    return Outcome(rows, _boundary_errors(example, (60.0,)), [path], compared, _settings(tabled=False))


def _seismic_humps(times: np.ndarray, u: np.ndarray) -> list[Comparison]:
    """Comparisons with the three parts of figure 13 for u at these times, shape (times, 201)."""

    def hump(node: int, about: float) -> tuple[float, float]:
        near = np.abs(times - about) < 5
        return float(times[near][u[near, node].argmax()]), float(u[near, node].max())

    first, second = hump(ORIGIN, 5.0), hump(ORIGIN, 25.0)
    right, later = hump(RIGHT, 15.0), float(np.abs(u[times > 25, RIGHT]).max())
    left, echo = hump(LEFT, 15.0), hump(LEFT, 35.0)

    def at(extremum: tuple[float, float]) -> str:
        return f"{extremum[1]:.2f} at t = {extremum[0]:.3g}"

    near = 1.0  # the paper says "about", and reads its times off a picture
    return [
        Comparison(
            "figure 13 a",
            "the pulse at its peak at t = 5, and the reflection of the free end as a second hump",
            f"{at(first)}, and {at(second)}",
            abs(first[0] - 5) < near and second[1] > 0.5,
        ),
        Comparison(
            "figure 13 b",
            "one hump about t = 15, almost doubled, and no visible reflection of the left end",
            f"{at(right)}, and after t = 25 at most {later:.1g}",
            abs(right[0] - 15) < near and abs(right[1] / 2 - 1) < 0.1 and later < 2 * LINE,
        ),
        Comparison(
            "figure 13 c",
            "a hump at t = 15, and the reflection of the free end as a second one",
            f"{at(left)}, and {at(echo)}",
            abs(left[0] - 15) < near and echo[1] > 0.5,
        ),
    ]

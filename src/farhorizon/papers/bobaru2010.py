"""Bobaru and Duangpanya (2010): the peridynamic formulation for transient heat conduction, figures 8 to 15.

A bar with a temperature prescribed on the single node at an end, or a flux on nodes beyond it (eq. 22). What the paper
leaves open is chosen such that its statements are reproduced (`GRID`, `BEYOND`, `NORM`, `CLASSICAL`).

At the ends of example 1 the relative difference is 1 on every grid, which explains the rate 1.01; in the bulk the
differences are of first order in both examples, and the rate 1.5 is this order plus 1/2 from the norm.

The paper interprets figure 10 as m-convergence. There is none if the temperature is prescribed on one node: in 1D the
energy of the operator is that of half a derivative, for which a point has zero capacity, so that the condition at the
end loses its effect like log m as m grows. If the temperature is prescribed on a layer as wide as the horizon, there is
a limit; `figure10` shows both.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon import (
    Flux,
    Free,
    Heat,
    InputError,
    Insulated,
    Kernel,
    Lattice,
    RungeKuttaChebyshev,
    Simulation,
    Temperature,
)
from farhorizon.analysis.references.classical import End, Slab
from farhorizon.papers import LINE, reproduction
from farhorizon.studies.collection import Comparison, Outcome, Row, Setting

PAPER = "Bobaru, Duangpanya (2010), The peridynamic formulation for transient heat conduction"
GRID = (
    "the self term of the micro-conductivity is k(0), not k of the nearest neighbour as printed under eq. 18, and dx = "
    "L/N with N rounded"
)
BEYOND = "the nodes of eq. 22 lie beyond the bar"
NORM = "eq. 45 is plotted and printed as 1/N sqrt(sum of squared relative differences): the 1/N is outside the root"
CLASSICAL = "eqs 33, 38, 39 and 43 are misprinted; the classical solutions are series of the stated problems"
DIFFUSIVITY = 1.14  # as all numbers below, published
TIMES = (0.1, 4.0, 8.0)
DIVISIONS = (100, 200, 400, 800)  # horizons 3L/100 ..
RATIOS = (2, 4, 8, 16)
RATIO = 4  # m of the profiles, figures 8, 9 and 15
KERNELS = {"constant": "constant", "triangular": "linear"}
_PROFILE_STEP = 0.00025  # s
# the first of m nodes beyond the bar is m - 1/2 spacings from its end
_ASIDE = RATIO - 0.5
_SHOWN = {"constant": 15, "triangular": 14}  # equidistant nodes that are drawn, as in the paper
STEPS = 400  # time steps up to 8 s: their error in the mid temperature is below 1e-5
#: Printed slopes of figures 11 and 12 for m = 2, 4, 8, 16.
SLOPES = {
    (1, "constant"): (1.0104, 1.0132, 1.0109, 1.0104),
    (1, "triangular"): (1.0095, 1.0102, 1.0082, 1.0055),
    (2, "constant"): (1.4824, 1.4982, 1.4914, 1.4811),
    (2, "triangular"): (1.4843, 1.4990, 1.4877, 1.4433),
}


@dataclass(frozen=True)
class Study:
    """Values (H, M) as a function of the horizon (H,) and of the number of nodes in it (M,)."""

    horizons: np.ndarray
    ratios: np.ndarray
    values: np.ndarray

    def increments(self) -> np.ndarray:
        """Change by each refinement at the same horizon, shape (H, M - 1): in m-convergence it tends to zero
        geometrically.
        """
        return np.diff(self.values, axis=1)

    def rates(self, last: int | None = None) -> np.ndarray:
        """Slope of the logarithm of the values over that of the horizon for each m, by least squares, shape (M,), over
        the `last` horizons (all unless given). InputError for values that are not positive.
        """
        first = 0 if last is None else max(0, len(self.horizons) - last)
        horizons, values = self.horizons[first:], self.values[first:]
        _need_two(horizons, "a rate")
        if (values <= 0).any():
            raise InputError(
                "a rate needs positive values",
                value=values.min(),
                limit="> 0",
                key="study",
                remedy="study an error, not a value",
            )
        return np.polyfit(np.log(horizons), np.log(values), 1)[0]

    def crossing(self) -> tuple[float, float]:
        """The number of nodes m* at which the curves over log m of the last two horizons cross, and the value there;
        nan if they do not cross.
        """
        _need_two(self.horizons, "a crossing")
        coarse, fine = self.values[-2:]
        place = np.log(self.ratios)
        gap = coarse - fine
        for i in range(len(gap)):
            if gap[i] == 0:
                return float(self.ratios[i]), float(fine[i])
            if i and gap[i - 1] * gap[i] < 0:
                fraction = gap[i - 1] / (gap[i - 1] - gap[i])
                at = place[i - 1] + fraction * (place[i] - place[i - 1])
                return float(np.exp(at)), float(np.interp(at, place, fine))
        return np.nan, np.nan


def _need_two(horizons: np.ndarray, what: str) -> None:
    """Refuse a study of fewer than two horizons."""
    if len(horizons) < 2:
        raise InputError(
            f"{what} needs two horizons",
            value=len(horizons),
            limit="2 or more",
            key="study",
            remedy="study more horizons",
        )


def over_horizons(
    measure: Callable[[float, int], dict[str, float]],
    horizons: Sequence[float],
    ratios: Sequence[int],
    workers: int | None = None,
) -> dict[str, Study]:
    """Measure numbers by name for all combinations of horizons and numbers m of nodes in the horizon, several at a
    time: in threads, of which there is one for each core unless given, because the compiled loop releases the
    interpreter lock. Simulations in `measure` should use one thread.
    """
    if not len(horizons) or not len(ratios) or min(horizons) <= 0 or min(ratios) < 1:
        raise InputError(
            "a study needs positive horizons and at least one node in each",
            value=(list(horizons), list(ratios)),
            key="study",
        )
    cells = [(h, m) for h in horizons for m in ratios]
    # start with the finest grid, so that no worker is left alone with it at the end
    cost = sorted(range(len(cells)), key=lambda i: cells[i][0] / cells[i][1])
    measured: list[dict[str, Any]] = [{}] * len(cells)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    with ThreadPoolExecutor(workers or cores) as pool:
        for i, result in zip(cost, pool.map(lambda i: measure(*cells[i]), cost), strict=True):
            measured[i] = result
    shape = len(horizons), len(ratios)
    return {
        name: Study(
            np.asarray(horizons, float),
            np.asarray(ratios, int),
            np.array([f[name] for f in measured], float).reshape(shape),
        )
        for name in measured[0]
    }


@dataclass(frozen=True)
class DiffusionExample:
    """One of the paper's bars, 1 to 3."""

    number: int

    @property
    def length(self) -> float:
        """Length of the bar in cm."""
        return np.pi if self.number == 3 else 10.0

    @property
    def classical(self) -> Slab:
        """Corresponding classical problem, eqs 28 to 30, 35 to 37 or 40 to 42."""
        if self.number == 1:
            return Slab(10.0, DIFFUSIVITY, [(0, 10, 100.0)])
        if self.number == 2:
            return Slab(10.0, DIFFUSIVITY, [(0, 5, 60.0)], End(0.0, slope=True), End(100.0))
        return Slab(np.pi, DIFFUSIVITY, [], End(20.0), End(3.0, slope=True))

    def conditions(self, kind: str = "node") -> list[Temperature | Flux | Insulated]:
        """Conditions of the paper; with kind "volume" the temperature is prescribed on a layer beyond the bar."""
        if self.number == 1:
            return [Temperature("x-", 0.0, kind), Temperature("x+", 0.0, kind)]
        if self.number == 2:
            return [Insulated("x-", "layer"), Temperature("x+", 100.0, kind)]
        return [Temperature("x-", 20.0, kind), Flux("x+", 3 * DIFFUSIVITY, "layer")]

    def simulation(
        self, kernel: str, horizon: float, ratio: int, dt: float, *, kind: str = "node"
    ) -> tuple[Simulation, slice]:
        """The bar on a grid of ``L m / horizon`` nodes, rounded, where m is the number of spacings in the horizon, and
        the slice of the nodes that belong to it; Runge-Kutta-Chebyshev with as many stages as dt requires.
        """
        nodes = round(self.length * ratio / horizon)
        spacing = self.length / nodes
        operator = Kernel(ratio * spacing, influence=KERNELS[kernel], calibrate=False)
        stencil = Heat(operator).stencil(spacing, 1)
        model = Heat(
            operator,
            conductivity=DIFFUSIVITY,
            integrator=RungeKuttaChebyshev.for_step(dt, stencil.symbol_maximum * DIFFUSIVITY / spacing**2),
        )
        held = self.conditions(kind)
        beyond = [0 if isinstance(c, Temperature) and kind == "node" else stencil.reach[0] for c in held]
        low = spacing * (0.5 - beyond[0])
        lattice = Lattice(spacing, low, low + spacing * (nodes + sum(beyond) - 1))
        start = self.classical.temperature(lattice.axes[0], 0.0)
        sim = Simulation(lattice, model, Free(), {"u": start}, constraints=held, dt=dt, threads=1)
        return sim, slice(beyond[0], beyond[0] + nodes)


def _settings(nodes: int | None, dt: float) -> list[Setting]:
    """Grid and time step, which in the paper is that of the fourth-order Runge-Kutta method in all tests."""
    grid = [] if nodes is None else [Setting("nodes", nodes, 1067)]
    note = "Runge-Kutta-Chebyshev method, whose error at this step is below the differences shown"
    return [*grid, Setting("time step (s)", dt, 1e-6, note)]


def difference(computed: np.ndarray, classical: np.ndarray) -> float:
    """Difference that the paper plots for eq. 45: 1/N times the norm of the relative differences."""
    return float(np.sqrt((((classical - computed) / classical) ** 2).sum()) / computed.size)


@cache
def studies(number: int, kernel: str) -> dict[str, Study]:
    """Mid temperature ("middle") and difference ("difference") at 8 s for all horizons and m of the paper."""
    example = DiffusionExample(number)

    def measure(horizon: float, ratio: int) -> dict[str, float]:
        sim, bar = example.simulation(kernel, horizon, ratio, 8.0 / STEPS)
        sim.step(STEPS)
        u, x = sim.fields["u"][bar], sim.lattice.axes[0][bar]
        return {"middle": float(u[u.size // 2]), "difference": difference(u, example.classical.temperature(x, 8.0))}

    return over_horizons(measure, [3 * example.length / d for d in DIVISIONS], RATIOS)


def limits(kernel: str, ratios: tuple[int, ...] = (2, 4, 8, 16, 32, 64, 128), kind: str = "node") -> Study:
    """Mid temperature of example 1 at 8 s for the horizon 3L/100, as a function of m."""

    def measure(horizon: float, ratio: int) -> dict[str, float]:
        sim, bar = DiffusionExample(1).simulation(kernel, horizon, ratio, 8.0 / STEPS, kind=kind)
        sim.step(STEPS)
        u = sim.fields["u"][bar]
        return {"middle": float(u[u.size // 2]) if u.size % 2 else float(u[u.size // 2 - 1 : u.size // 2 + 1].mean())}

    return over_horizons(measure, [0.3], ratios)["middle"]


def _profiles(folder: Path, name: str, number: int) -> Outcome:
    """Profiles at 0.1, 4 and 8 s for the horizon 3L/800 and m = 4."""
    from farhorizon.pictures.curves import curve_panels

    example = DiffusionExample(number)
    rows, panels, apart_of = [], [], []
    curves: dict[float, list[tuple[str, np.ndarray, np.ndarray]]] = {t: [] for t in TIMES}
    for kernel in KERNELS:
        sim, bar = example.simulation(kernel, 3 * example.length / 800, RATIO, _PROFILE_STEP)
        x = sim.lattice.axes[0][bar]
        for t in TIMES:
            sim.run(t, progress=False)
            u, exact = sim.fields["u"][bar], example.classical.temperature(x, t)
            if not curves[t]:
                curves[t].append(("classical", x, exact))
            shown = np.linspace(0, x.size - 1, _SHOWN[kernel]).astype(int)
            curves[t].append((f"{kernel} micro-conductivity", x[shown], u[shown]))
            apart = np.abs(u - exact)
            apart_of.append(float(apart.max() / (exact.max() - exact.min())))
            rows.append(
                Row(
                    f"t = {t:g} s, {kernel}, largest difference from the classical solution two horizons inside (C)",
                    float(apart[2 * RATIO : -2 * RATIO].max()),
                    note="the bulk; the figure prints no number",
                )
            )
            rows.append(
                Row(
                    f"t = {t:g} s, {kernel}, the same over the whole bar (C)",
                    float(apart.max()),
                    note=f"at {x[apart.argmax()]:.3g} cm",
                )
            )
            if number == 3 and t == 8.0:
                printed = {"constant": 3.43e-5, "triangular": 2.84e-5}[kernel]
                aside = example.classical.temperature(x + _ASIDE * sim.lattice.spacing, t)
                reason = (
                    "closer to the classical solution than the paper's; compared with that solution "
                    f"{_ASIDE:g} spacings aside, as if the places began with the first of the nodes beyond the bar, it "
                    f"is {difference(u, aside):.3g}"
                )
                rows.append(
                    Row(f"t = 8 s, {kernel}, difference of eq. 45", difference(u, exact), printed, reason=reason)
                )
    panels = [(f"$t = {t:g}$ s", curves[t]) for t in TIMES]
    path = folder / f"{name}.png"
    points = [f"{kernel} micro-conductivity" for kernel in KERNELS]
    curve_panels(panels, path, xlabel="$x$ (cm)", ylabel="temperature (\N{DEGREE SIGN}C)", points=points)
    compared = Comparison(
        f"figure {name.rpartition('fig')[2]}",
        "both micro-conductivities on the classical solution at 0.1, 4 and 8 s",
        f"a largest difference of {100 * max(apart_of):.2g} % of the range of temperatures",
        max(apart_of) < LINE,
    )
    settings = _settings(x.size, _PROFILE_STEP)
    return Outcome(rows, pictures=[path], comparisons=[compared], settings=settings)


@reproduction(
    "bobaru2010-fig8",
    PAPER,
    "example 1: temperature at 0.1, 4 and 8 s, classical and peridynamic",
    readings=(GRID, CLASSICAL),
)
def figure8(folder: Path) -> Outcome:
    """Both ends are held at 0."""
    return _profiles(folder, "bobaru2010-fig8", 1)


@reproduction(
    "bobaru2010-fig9",
    PAPER,
    "example 2: temperature at 0.1, 4 and 8 s, classical and peridynamic",
    readings=(GRID, CLASSICAL, BEYOND),
)
def figure9(folder: Path) -> Outcome:
    """The left end is insulated, the right one is held at 100."""
    return _profiles(folder, "bobaru2010-fig9", 2)


@reproduction(
    "bobaru2010-fig10",
    PAPER,
    "m-convergence of the temperature in the middle at 8 s, and that it has no limit",
    takes="10 s",
    readings=(GRID, CLASSICAL),
)
def figure10(folder: Path) -> Outcome:
    """Mid temperatures, the crossings of their curves, and their course as m grows, with one node and with a layer
    held."""
    from farhorizon.pictures.curves import curve_panels

    rows, panels, places, late = [], [], [], []
    printed = {1: 51.75, 2: 53.06}
    for number in (1, 2):
        example = DiffusionExample(number)
        exact = float(example.classical.temperature(5.0, 8.0))
        rows.append(Row(f"example {number}, classical", exact, printed[number]))
        for kernel in KERNELS:
            study = studies(number, kernel)["middle"]
            for division, values in zip(DIVISIONS, study.values, strict=True):
                rows += [
                    Row(f"example {number}, {kernel}, horizon 3L/{division}, m = {m}", float(v))
                    for m, v in zip(RATIOS, values, strict=True)
                ]
            at, value = study.crossing()
            places.append(at)
            rows.append(
                Row(
                    f"example {number}, {kernel}, m where the curves cross",
                    at,
                    note="paper: between 3 and 5, larger for the triangle",
                )
            )
            rows.append(Row(f"example {number}, {kernel}, value there", value, printed[number]))
            curves = [("classical", np.log2(study.ratios), np.full(len(RATIOS), exact))]
            curves += [(f"$3L/{d}$", np.log2(study.ratios), v) for d, v in zip(DIVISIONS, study.values, strict=True)]
            panels.append((f"example {number}, {kernel}", curves))
    for kernel in KERNELS:
        curves = []
        for kind, words in (("node", "one node held"), ("volume", "a layer held")):
            study = limits(kernel, kind=kind)
            late.append(float(study.increments()[0][-1]))
            curves.append((words, np.log2(study.ratios), study.values[0]))
            note = "does not go to zero: no limit" if kind == "node" else "halves each time: a limit"
            rows += [
                Row(f"example 1, {kernel}, 3L/100, {words}, change from m = {m // 2} to {m}", float(v), note=note)
                for m, v in zip(study.ratios[1:], study.increments()[0], strict=True)
            ]
        panels.append((f"example 1, {kernel}, $3L/100$", curves))
    curve_panels(
        panels,
        folder / "bobaru2010-fig10.png",
        xlabel="$\\log_2 m$",
        ylabel="temperature in the middle (\N{DEGREE SIGN}C)",
    )
    compared = [
        Comparison.of_rows(
            "figure 10", rows, "the classical temperatures 51.75 and 53.06, and curves that cross there"
        ),
        Comparison(
            "figure 10",
            "curves of all horizons that cross between m = 3 and 5, later for the triangle",
            f"crossings at m = {', '.join(f'{m:.2f}' for m in places)}",
            all(3 < m < 5 for m in places) and places[0] < places[1] and places[2] < places[3],
        ),
        Comparison(
            "figure 10",
            "changes that slow down as m grows, read as convergence",
            f"with one node held, changes of {late[0]:.2g} and {late[2]:.2g} C still from m = 64 to 128",
            max(abs(late[0]), abs(late[2])) < LINE,
            "a point has no capacity in 1D, so that one held node loses its effect like log m; with a layer held the "
            f"changes are {late[1]:.1g} and {late[3]:.1g} C and halve each time",
        ),
    ]
    path = folder / "bobaru2010-fig10.png"
    return Outcome(rows, pictures=[path], comparisons=compared, settings=_settings(None, 8.0 / STEPS))


def _rates(folder: Path, name: str, number: int) -> Outcome:
    from farhorizon.pictures.curves import curve_panels

    rows, panels = [], []
    for kernel in KERNELS:
        study = studies(number, kernel)["difference"]
        for m, slope, printed in zip(RATIOS, study.rates(3), SLOPES[number, kernel], strict=True):
            rows.append(
                Row(
                    f"{kernel}, m = {m}, slope",
                    float(slope),
                    printed,
                    note="four digits cannot be recovered: grid and sum are not stated",
                )
            )
        curves = [
            (f"$m = {m}$", np.log10(study.horizons[1:]), np.log10(study.values[1:, i])) for i, m in enumerate(RATIOS)
        ]
        panels.append((kernel, curves))
    curve_panels(
        panels, folder / f"{name}.png", xlabel="$\\log_{10}$ horizon", ylabel="$\\log_{10}$ difference", reference=""
    )
    compared = Comparison.of_rows(f"figure {name.rpartition('fig')[2]}", rows, f"{len(rows)} rates")
    settings = _settings(None, 8.0 / STEPS)
    return Outcome(rows, pictures=[folder / f"{name}.png"], comparisons=[compared], settings=settings)


@reproduction("bobaru2010-fig11", PAPER, "example 1: rates of the delta-convergence", readings=(GRID, CLASSICAL, NORM))
def figure11(folder: Path) -> Outcome:
    """Slopes over the three smallest horizons."""
    return _rates(folder, "bobaru2010-fig11", 1)


@reproduction("bobaru2010-fig12", PAPER, "example 2: rates of the delta-convergence", readings=(GRID, CLASSICAL, NORM))
def figure12(folder: Path) -> Outcome:
    """Slopes over the three smallest horizons."""
    return _rates(folder, "bobaru2010-fig12", 2)


def _fluxes(folder: Path, name: str, number: int, ratio: int) -> Outcome:
    """Flux divided by conductivity, positive from right to left as in the paper, for the horizon 3L/800."""
    from farhorizon.pictures.curves import curve_panels

    example = DiffusionExample(number)
    rows, panels, apart = [], [], []
    for kernel in KERNELS:
        sim, bar = example.simulation(kernel, 3 * example.length / 800, ratio, 8.0 / STEPS)
        sim.step(STEPS)
        x, flux = sim.lattice.axes[0][bar], -sim.flux()[0][bar] / DIFFUSIVITY
        exact = example.classical.gradient(x, 8.0)
        error, inside = np.abs(flux - exact), slice(2 * ratio, -2 * ratio)
        apart.append(float(error[inside].max() / np.abs(exact).max()))
        rows.append(
            Row(
                f"{kernel}, largest flux over conductivity (C/cm)",
                float(np.abs(flux).max()),
                note="the figure prints no number",
            )
        )
        rows.append(
            Row(
                f"{kernel}, largest difference from the classical flux two horizons inside",
                float(error[inside].max()),
                note="first order",
            )
        )
        rows.append(
            Row(
                f"{kernel}, the same over the whole bar",
                float(error.max()),
                note="a held node has a boundary layer one horizon wide",
            )
        )
        panels.append((kernel, [("classical", x, exact), ("peridynamic", x, flux)]))
    curve_panels(panels, folder / f"{name}.png", xlabel="$x$ (cm)", ylabel="flux / conductivity (\N{DEGREE SIGN}C/cm)")
    compared = Comparison(
        f"figure {name.rpartition('fig')[2]}",
        "the peridynamic flux on the classical one, for both micro-conductivities",
        f"a largest difference of {100 * max(apart):.1g} % of the largest flux from two horizons inside on; next to a "
        "held node there is a layer of one horizon in which it differs, between the few places that the paper draws",
        max(apart) < LINE,
    )
    settings = [Setting("nodes", x.size, 1067 if ratio == RATIO else None), *_settings(None, 8.0 / STEPS)]
    return Outcome(rows, pictures=[folder / f"{name}.png"], comparisons=[compared], settings=settings)


@reproduction("bobaru2010-fig13", PAPER, "example 1: heat flux at 8 s", readings=(GRID, CLASSICAL))
def figure13(folder: Path) -> Outcome:
    """m = 2."""
    return _fluxes(folder, "bobaru2010-fig13", 1, 2)


@reproduction("bobaru2010-fig14", PAPER, "example 2: heat flux at 8 s", readings=(GRID, CLASSICAL))
def figure14(folder: Path) -> Outcome:
    """m = 4."""
    return _fluxes(folder, "bobaru2010-fig14", 2, 4)


@reproduction(
    "bobaru2010-fig15",
    PAPER,
    "example 3: temperature at 0.1, 4 and 8 s with a flux at the right end",
    readings=(GRID, CLASSICAL, BEYOND, NORM),
)
def figure15(folder: Path) -> Outcome:
    """The left end is held at 20, the right one at a slope of 3 C/cm."""
    return _profiles(folder, "bobaru2010-fig15", 3)

"""Shojaei, Hermann, Seleson and Cyron (2020): Dirichlet absorbing conditions for classical and peridynamic diffusion,
example 1 (section 5.1) and table 1.

What the paper leaves open is in `WAVENUMBERS` and `ENERGY`.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon import Diffusion, Fixed, Free, Kernel, Lattice, LatticePML, PlaneWave, Side, Stencil
from farhorizon.papers import LINE, reproduction
from farhorizon.papers.measure import Measured, Reference, infinite, measured_run, stability_note
from farhorizon.studies.collection import Comparison, Outcome, Row, Setting

PAPER = (
    "Shojaei, Hermann, Seleson, Cyron (2020), Dirichlet absorbing boundary conditions for classical and "
    "peridynamic diffusion-type models"
)
WAVENUMBERS = (
    "the largest wavenumber of the modes is not stated: eq. 47 allows up to 11.3, which is no better than a value held "
    "at zero; the smallest errors, a few per cent, are those of a few times the reciprocal of half the near field, 0.25"
)
ENERGY = (
    "eq. 50 relates the error of the energy to the initial energy, of which 1.5 % is left at t = 250, and so "
    "understates it by that factor"
)
SPACING, STEP, END, LONG = 0.125, 0.001, 250.0, 4000.0
_ALLOWED = 11.3  # 1 / (sqrt(1/2) spacing), eq 47


def line(operator: Kernel | Stencil, layer: int) -> dict[str, Any]:
    """Set-up of example 1: 481 nodes on -30 .. 30, of which the outermost `layer` at each end belong to the
    condition."""
    half = 30 - layer * SPACING
    return {
        "lattice": Lattice(SPACING, (-half,), (half,)),
        "model": Diffusion(operator),
        "dt": STEP,
        "initial": {"u": lambda x: np.exp(-4 * x**2)},
    }


def published(wavenumber: float, radius: int = 2, layer: int | None = None) -> PlaneWave:
    """The condition of the paper: 20 wavenumbers, clouds with a radius of `radius` spacings, local modes."""
    return PlaneWave(
        radius=radius * SPACING, wavenumber=wavenumber, wavenumbers=20, layer=None if layer is None else layer * SPACING
    )


def _conditions(radius: int) -> dict[str, Side]:
    return {
        "published, wavenumbers to 11.3 (eq 47)": published(_ALLOWED, radius),
        "published, to 1": published(1.0, radius),
        "published, to 0.25": published(0.25, radius),
        "repaired, to 6 / 30, nearest neighbours": PlaneWave(),
        "held at zero": Fixed(),
        "no flux": Free(),
        "lattice PML": LatticePML(),
    }


def _errors(run: Measured, exact: list[np.ndarray], first: float) -> tuple[float, float, float]:
    """Largest error of the energy over the run relative to the initial energy (eq 50), its error at the end relative to
    the exact energy then, and the error of the field at the end relative to the largest exact value then.
    """
    if len(run.fields) < len(exact):
        return np.inf, np.inf, np.inf
    energies = np.array([[float((u**2).sum()) for u in part] for part in (run.fields, exact)])
    last = np.abs(exact[-1]).max()
    return (
        float(np.abs(energies[0] - energies[1]).max() / first),
        float(abs(energies[0, -1] / energies[1, -1] - 1)),
        float(run.errors[-1] / last),
    )


_EARLY = (0.5, 1.0, 2.0, 5.0)  # while the energy falls most
_BEST = "published, to 0.25"  # the reading that comes closest to what the paper says


def _settings(until: float) -> list[Setting]:
    """Grid, step and end of example 1; nodes include the absorbing ones."""
    return [
        Setting("nodes", 481, 481),
        Setting("time step", STEP, 0.001),
        Setting("end", until, LONG, "the fields and errors of the paper end at 250"),
    ]


def _example(
    name: str,
    figures: tuple[int, int, int | None],
    folder: Path,
    setup: Mapping[str, Any],
    conditions: Mapping[str, Side],
    full: bool,
    shown: tuple[str, ...],
) -> Outcome:
    """Rows and pictures: energies and fields up to t = 250, and with `full` also the energy left at up to t = 4000.

    `figures` are the numbers of those of the fields, of the energy, and of its error if the paper has it.
    """
    from farhorizon.pictures.curves import curve_panels, error_history

    times = [*_EARLY, *np.linspace(10, END, 25)]
    later = [1000.0, 2000.0, LONG] if full else []
    reference: Reference = infinite(setup, (times + later)[-1])
    exact = [reference(round(t / STEP)) for t in times]
    u0 = setup["initial"]["u"](setup["lattice"].axes[0])
    first = float((u0**2).sum())
    rows, errors = [Row("nodes, absorbing ones included", 481, 481)], {}
    exact_energy = np.array([float((u**2).sum()) for u in exact]) / first
    energies, changes = {"infinite medium": (np.array([0.0, *times]), np.array([1.0, *exact_energy]))}, {}
    fields = {"infinite medium": exact}
    for label, boundary in conditions.items():
        run = measured_run(setup, boundary, times, reference)
        note = stability_note(setup, boundary, END)
        energy, current, largest = _errors(run, exact, first)
        rows += [
            Row(f"{label}: error of the energy / initial energy", energy, note=note),
            Row(f"{label}: error of the energy / energy at t = 250", current),
            Row(f"{label}: largest error / largest value at t = 250", largest),
        ]
        errors[label] = float(run.errors.max()) / float(np.abs(u0).max())
        fields[label] = run.fields
        left = np.array([float((u**2).sum()) for u in run.fields]) / first
        changes[label] = (np.array(times[: left.size]), np.abs(left - exact_energy[: left.size]))
        energies[label] = (np.array([0.0, *times[: left.size]]), np.array([1.0, *left]))
        if later:
            late = measured_run(setup, boundary, later, reference)
            more = [float((u**2).sum()) / first for u in late.fields]
            known = energies[label]
            energies[label] = (np.append(known[0], later[: len(more)]), np.append(known[1], more))
            rows += [
                Row(
                    f"{label}: energy left at t = {t:g} / initial energy",
                    float((u**2).sum()) / first,
                    note=f"infinite medium {float((reference(round(t / STEP)) ** 2).sum()) / first:.3g}",
                )
                for t, u in zip(later, late.fields, strict=False)
            ]
    numbers = {"fields": figures[0], "energy": figures[1], "errors": figures[2]}
    files = [
        folder / (f"shojaei2020-fig{number}.png" if number else f"{name}-{part}.png")
        for part, number in numbers.items()
    ]
    error_history(energies, files[1], "energy / initial energy", "", xlabel="$t$")
    error_history(changes, files[2], "error of the energy / initial energy", "", xlabel="$t$")
    panels = []
    for t in (50.0, END):
        at = times.index(t)
        panels.append(
            (
                f"t = {t:g}",
                [
                    (label, setup["lattice"].axes[0], fields[label][at])
                    for label in ("infinite medium", *shown)
                    if fields[label]
                ],
            )
        )
    curve_panels(panels, files[0], xlabel="x", ylabel="u")
    apart = float(np.abs(fields[_BEST][-1] - exact[-1]).max() / exact[-1].max())
    compared = _compared(figures, apart, energies, changes)
    return Outcome(rows, errors, files, compared, _settings(LONG if full else END))


History = tuple[np.ndarray, np.ndarray]  # times and values


def _compared(
    figures: tuple[int, int, int | None], apart: float, energies: Mapping[str, History], changes: Mapping[str, History]
) -> list[Comparison]:
    """Comparisons with the figures of the fields, of the energy, and of its error, for the closest reading."""
    energy, change = energies[_BEST][1], float(changes[_BEST][1].max())
    walls = changes["no flux"][1]
    comparisons = [
        Comparison(
            f"figure {figures[0]}",
            "the field on that of the larger domain",
            f"with wavenumbers to 0.25 a largest difference of {100 * apart:.1g} % of the largest value at t = 250",
            apart < LINE,
            "the paper does not state its wavenumbers; of those computed here these come closest",
        ),
        Comparison(
            f"figure {figures[1]}",
            "an energy that falls all the time, on that of the larger domain",
            f"with wavenumbers to 0.25 {'one' if (np.diff(energy) < 0).all() else 'none'} that does, and differs by "
            f"{change:.1g} of the initial energy at most",
            bool((np.diff(energy) < 0).all()) and change < LINE,
        ),
    ]
    if figures[2] is not None:
        comparisons.append(
            Comparison(
                f"figure {figures[2]}",
                "a very small error of the energy, and one that grows rapidly without a condition",
                f"{change:.1g} with wavenumbers to 0.25 and up to {walls.max():.1g} without a flux at the ends",
                bool(change < walls.max() / 10 and walls.argmax() > 0),
            )
        )
    return comparisons


@reproduction(
    "shojaei2020-ex1-fem",
    PAPER,
    "diffusion on a line, linear finite elements: figures 7 to 9",
    takes="10 s",
    full="minutes",
    figures=("fig7", "fig8", "fig9"),
    readings=(WAVENUMBERS, ENERGY),
)
def example_1_elements(folder: Path, full: bool = False) -> Outcome:
    """The published grid and step up to t = 250, or t = 4000 with `full`."""
    shown = ("published, wavenumbers to 11.3 (eq 47)", "published, to 1", "lattice PML")
    return _example(
        "shojaei2020-ex1-fem", (7, 8, 9), folder, line(Stencil.finite_element(1), 1), _conditions(3), full, shown
    )


@reproduction(
    "shojaei2020-ex1-pd",
    PAPER,
    "diffusion on a line, peridynamic, horizon and layer of 4 spacings: figures 10, 11",
    takes="10 s",
    full="minutes",
    figures=("fig10", "fig11"),
    readings=(WAVENUMBERS, ENERGY),
)
def example_1_peridynamic(folder: Path, full: bool = False) -> Outcome:
    """The published grid and step up to t = 250, or t = 4000 with `full`."""
    shown = ("published, wavenumbers to 11.3 (eq 47)", "published, to 1", "lattice PML")
    return _example(
        "shojaei2020-ex1-pd", (10, 11, None), folder, line(Kernel(4 * SPACING, 1), 4), _conditions(2), full, shown
    )


@reproduction(
    "shojaei2020-ex1-layers",
    PAPER,
    "the same with layers thinner than the horizon: figures 12, 13",
    takes="20 s",
    figures=("fig12", "fig13"),
    readings=(WAVENUMBERS, ENERGY),
)
def example_1_layers(folder: Path) -> Outcome:
    """Layers of 4, 3, 2 and 1 spacings without the bonds that reach beyond them, for four values of the largest
    wavenumber."""
    from farhorizon.pictures.curves import curve_panels, log_panels

    rows, errors, panels, changes = [], {}, [], []
    largest_of: dict[tuple[float, int], tuple[float, float]] = {}
    for wavenumber in (0.25, 0.5, 1.0, 2.0):
        curves: list[tuple[str, np.ndarray, np.ndarray]] = []
        courses: list[tuple[str, np.ndarray, np.ndarray]] = []
        for layer in (4, 3, 2, 1):
            setup = line(Kernel(4 * SPACING, 1), layer)
            reference = infinite(setup, END)
            times = list(np.linspace(10, END, 25))
            exact = [reference(round(t / STEP)) for t in times]
            boundary = published(wavenumber, layer=layer)
            run = measured_run(setup, boundary, times, reference)
            first = float((setup["initial"]["u"](setup["lattice"].axes[0]) ** 2).sum())
            energy, _, largest = _errors(run, exact, first)
            largest_of[wavenumber, layer] = largest, energy
            apart = [
                abs(float((u**2).sum()) - float((e**2).sum())) / first for u, e in zip(run.fields, exact, strict=False)
            ]
            courses.append(
                (f"layer of {layer} spacing" + "s" * (layer > 1), np.array(times[: len(apart)]), np.array(apart))
            )
            label = f"wavenumbers to {wavenumber:g}, layer of {layer} spacing" + "s" * (layer > 1)
            note = stability_note(setup, boundary, END)
            rows += [
                Row(f"{label}: largest error / largest value at t = 250", largest, note=note),
                Row(
                    f"{label}: error of the energy / initial energy",
                    energy,
                    note="" if np.isfinite(energy) else "it overflows",
                ),
            ]
            errors[label] = float(run.errors.max())
            if not curves:
                curves.append(("infinite medium", setup["lattice"].axes[0], exact[-1]))
            if largest < 2:
                curves.append(
                    (f"layer of {layer} spacing" + "s" * (layer > 1), setup["lattice"].axes[0], run.fields[-1])
                )
        panels.append((f"t = 250, wavenumbers to {wavenumber:g}", curves))
        changes.append((f"wavenumbers to {wavenumber:g}", [course for course in courses if course[1].size]))
    paths = [folder / "shojaei2020-fig12.png", folder / "shojaei2020-fig13.png"]
    curve_panels(panels, paths[0], xlabel="x", ylabel="u")
    log_panels(changes, paths[1], xlabel="$t$", ylabel=r"$\Delta\Pi / \Pi_0$")
    best = [largest_of[0.25, layer] for layer in (4, 3, 2, 1)]
    thinnest = np.isfinite([largest_of[wavenumber, 1][0] for wavenumber in (0.25, 0.5, 1.0, 2.0)])
    ends = f"; with one spacing {4 - thinnest.sum()} of 4 runs overflow"
    reason = (
        "the paper does not state its wavenumbers, nor what it does with the bonds that reach beyond a thin layer; a "
        "layer of one spacing grows with each of those computed here"
    )
    start = "with wavenumbers to 0.25 errors of "
    fields, energies = ([f"{values[part]:.1g}" for values in best[:3]] for part in (0, 1))
    compared = [
        Comparison(
            "figure 12",
            "fields at t = 250 that differ more the thinner the layer is, from 4 to 1 spacings",
            f"{start}{', '.join(fields)} of the largest value for 4, 3 and 2 spacings{ends}",
            all(thick[0] < thin[0] for thick, thin in pairwise(best)) and np.isfinite(best[3][0]),
            reason,
        ),
        Comparison(
            "figure 13",
            "an appropriate accuracy of the energy with layers of 3 spacings and more, and less with thinner ones",
            f"{start}{', '.join(energies)} of the initial energy for 4, 3 and 2 spacings{ends}",
            max(best[0][1], best[1][1]) < LINE and best[1][1] < best[2][1] and np.isfinite(best[3][1]),
            reason,
        ),
    ]
    return Outcome(rows, errors, paths, compared, _settings(END))


TABLE_1 = [  # dim, exponent p of J_p, influence, printed c delta^(dim + 2 - p) / chi^2
    (1, 0, "constant", 3.0),
    (1, 1, "constant", 2.0),
    (1, 0, "linear", 12.0),
    (1, 1, "linear", 6.0),
    (2, 0, "constant", 8 / np.pi),
    (2, 1, "constant", 6 / np.pi),
    (2, 2, "constant", 4 / np.pi),
    (2, 0, "linear", 40 / np.pi),
    (2, 1, "linear", 24 / np.pi),
    (2, 2, "linear", 12 / np.pi),
    (3, 1, "constant", 6 / np.pi),
    (3, 2, "constant", 9 / 2 / np.pi),
    (3, 1, "linear", 30 / np.pi),
    (3, 2, "linear", 18 / np.pi),
]
# dim, p, equation, and terms of omega / (chi kappa)^2
SERIES = [(2, 1, "eq 26", (3 / 80, 1 / 1344)), (3, 1, "eq 56", (6 / 180, 6 / 10080))]


@reproduction(
    "shojaei2020-table1", PAPER, "constants of the micro-diffusivity in 1D, 2D and 3D, and the series of eqs 26 and 56"
)
def table_1(folder: Path) -> Outcome:
    """All 14 entries, and the terms printed in the equations."""
    rows = [
        Row(
            f"{dim}D, J_{p}, {influence}: c horizon^{dim + 2 - p} / diffusivity",
            Kernel(1.0, p, influence).scaling_constant(dim),
            printed,
        )
        for dim, p, influence, printed in TABLE_1
    ]
    for dim, p, name, terms in SERIES:
        ours = Kernel(1.0, p).series(dim, 2) * [-1, 1]  # the modes grow in space: their wavenumber is imaginary
        rows += [
            Row(f"{dim}D, J_{p}, {name}: term (kappa horizon)^{2 * j + 2}", float(ours[j]), terms[j]) for j in range(2)
        ]
    compared = [
        Comparison.of_rows("table 1", rows[: len(TABLE_1)]),
        Comparison.of_rows("eqs 26 and 56", rows[len(TABLE_1) :]),
    ]
    return Outcome(rows, comparisons=compared)

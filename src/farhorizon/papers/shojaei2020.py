"""Shojaei, Hermann, Seleson and Cyron (2020): Dirichlet absorbing conditions for classical and peridynamic diffusion,
example 1 (section 5.1) and table 1.

The paper does not state the largest wavenumber of its modes, Delta kappa. Eq 47 allows up to 11.3 in example 1, which
is no better than a value held at zero. The smallest errors, a few per cent, are reached with a few times the reciprocal
of half the extent of the near field. Eq 50 relates the error of the energy to the initial energy, of which 1.5 % is
left at t = 250, and so understates it by that factor; the error relative to the energy that is left is also given here.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon.boundaries import Fixed, Free, LatticePML, PlaneWave, Side
from farhorizon.geometry.lattice import Lattice
from farhorizon.medium.kernel import Kernel
from farhorizon.medium.stencil import Stencil
from farhorizon.models import Diffusion
from farhorizon.papers.measure import Measured, Reference, infinite, measured_run, stability_note
from farhorizon.papers.reproductions import reproduction
from farhorizon.studies.collection import Outcome, Row

PAPER = (
    "Shojaei, Hermann, Seleson, Cyron (2020), Dirichlet absorbing boundary conditions for classical and "
    "peridynamic diffusion-type models"
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


def _errors(found: Measured, exact: list[np.ndarray], first: float) -> tuple[float, float, float]:
    """Largest error of the energy over the run relative to the initial energy (eq 50), its error at the end relative to
    the exact energy then, and the error of the field at the end relative to the largest exact value then.
    """
    if len(found.fields) < len(exact):
        return np.inf, np.inf, np.inf
    energies = np.array([[float((u**2).sum()) for u in part] for part in (found.fields, exact)])
    last = np.abs(exact[-1]).max()
    return (
        float(np.abs(energies[0] - energies[1]).max() / first),
        float(abs(energies[0, -1] / energies[1, -1] - 1)),
        float(found.errors[-1] / last),
    )


def _example(
    name: str,
    folder: Path,
    setup: Mapping[str, Any],
    conditions: Mapping[str, Side],
    full: bool,
    shown: tuple[str, ...],
) -> Outcome:
    """Rows and pictures: energies and fields up to t = 250, and with `full` also the energy left at up to t = 4000."""
    from farhorizon.pictures.curves import curve_panels, error_history

    times = list(np.linspace(10, END, 25))
    later = [1000.0, 2000.0, LONG] if full else []
    reference: Reference = infinite(setup, (times + later)[-1])
    exact = [reference(round(t / STEP)) for t in times]
    u0 = setup["initial"]["u"](setup["lattice"].axes[0])
    first = float((u0**2).sum())
    rows, errors, energies = [Row("nodes, absorbing ones included", 481, 481)], {}, {}
    fields = {"infinite medium": exact}
    for label, boundary in conditions.items():
        found = measured_run(setup, boundary, times, reference)
        note = stability_note(setup, boundary, END)
        energy, current, largest = _errors(found, exact, first)
        rows += [
            Row(f"{label}: error of the energy / initial energy", energy, note=note),
            Row(f"{label}: error of the energy / energy at t = 250", current),
            Row(f"{label}: largest error / largest value at t = 250", largest),
        ]
        errors[label] = float(found.errors.max()) / float(np.abs(u0).max())
        fields[label] = found.fields
        energies[label] = np.array(
            [abs(float((u**2).sum()) - float((e**2).sum())) / first for u, e in zip(found.fields, exact, strict=False)]
        )
        if later:
            late = measured_run(setup, boundary, later, reference)
            rows += [
                Row(
                    f"{label}: energy left at t = {t:g} / initial energy",
                    float((u**2).sum()) / first,
                    note=f"infinite medium {float((reference(round(t / STEP)) ** 2).sum()) / first:.3g}",
                )
                for t, u in zip(later, late.fields, strict=False)
            ]
    files = [folder / f"{name}-energy.png", folder / f"{name}-fields.png"]
    error_history(
        {label: (np.array(times[: len(e)]), e) for label, e in energies.items()},
        files[0],
        "error of the energy / initial energy",
        "",
    )
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
    curve_panels(panels, files[1], xlabel="x", ylabel="u")
    return Outcome(rows, errors, files)


@reproduction(
    "shojaei2020-ex1-fem", PAPER, "diffusion on a line, linear finite elements: figures 7 to 9", full="minutes"
)
def example_1_elements(folder: Path, full: bool = False) -> Outcome:
    """The published grid and step up to t = 250, or t = 4000 with `full`."""
    shown = ("published, wavenumbers to 11.3 (eq 47)", "published, to 1", "lattice PML")
    return _example("shojaei2020-ex1-fem", folder, line(Stencil.finite_element(1), 1), _conditions(3), full, shown)


@reproduction(
    "shojaei2020-ex1-pd",
    PAPER,
    "diffusion on a line, peridynamic, horizon and layer of 4 spacings: figures 10, 11",
    full="minutes",
)
def example_1_peridynamic(folder: Path, full: bool = False) -> Outcome:
    """The published grid and step up to t = 250, or t = 4000 with `full`."""
    shown = ("published, wavenumbers to 11.3 (eq 47)", "published, to 1", "lattice PML")
    return _example("shojaei2020-ex1-pd", folder, line(Kernel(4 * SPACING, 1), 4), _conditions(2), full, shown)


@reproduction("shojaei2020-ex1-layers", PAPER, "the same with layers thinner than the horizon: figures 12, 13")
def example_1_layers(folder: Path) -> Outcome:
    """Layers of 4, 3, 2 and 1 spacings without the bonds that reach beyond them, for four values of the largest
    wavenumber."""
    from farhorizon.pictures.curves import curve_panels

    rows, errors, panels = [], {}, []
    for wavenumber in (0.25, 0.5, 1.0, 2.0):
        curves: list[tuple[str, np.ndarray, np.ndarray]] = []
        for layer in (4, 3, 2, 1):
            setup = line(Kernel(4 * SPACING, 1), layer)
            reference = infinite(setup, END)
            times = list(np.linspace(10, END, 25))
            exact = [reference(round(t / STEP)) for t in times]
            boundary = published(wavenumber, layer=layer)
            found = measured_run(setup, boundary, times, reference)
            first = float((setup["initial"]["u"](setup["lattice"].axes[0]) ** 2).sum())
            energy, _, largest = _errors(found, exact, first)
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
            errors[label] = float(found.errors.max())
            if not curves:
                curves.append(("infinite medium", setup["lattice"].axes[0], exact[-1]))
            if largest < 2:
                curves.append(
                    (f"layer of {layer} spacing" + "s" * (layer > 1), setup["lattice"].axes[0], found.fields[-1])
                )
        panels.append((f"t = 250, wavenumbers to {wavenumber:g}", curves))
    path = folder / "shojaei2020-ex1-layers.png"
    curve_panels(panels, path, xlabel="x", ylabel="u")
    return Outcome(rows, errors, [path])


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
    return Outcome(rows)

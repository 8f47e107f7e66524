"""Hermann, Shojaei, Seleson, Cyron and Silling (2023): Dirichlet-type absorbing conditions for peridynamic scalar waves.

Each example is run with the published condition in several readings, for the paper leaves some of its options open (the radius of clouds in
example 1, the thinning elsewhere), with what repairs it, with Higdon's and the first-order condition, and with a lattice PML. The paper prints
pictures and no errors; ours are the largest differences from the infinite lattice, same step, over the near field.

Read with these corrections: "2 d w" in eqs 13 to 27 is "2 i d w"; the frequency of eq 35 has the sign of the wavenumber, or half of the modes come
in; the initial data have |x|^2 in the exponent; the cone of eq 54 is closed. The damped relation of one step is that of eq 42 in terms of u alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon.analysis.modes import discrete_symbol, series_symbol
from farhorizon.boundaries import Boundary, Exact, FirstOrder, Fixed, Higdon, LatticePML, PlaneWave, Sponge
from farhorizon.kernel import Kernel
from farhorizon.lattice import Lattice
from farhorizon.models import Wave
from farhorizon.papers import Outcome, Row, reproduction
from farhorizon.papers.measure import Reference, infinite, pictures, run, stability, stability_note
from farhorizon.shapes import Disc
from farhorizon.simulation import Simulation
from farhorizon.stencil import Stencil

PAPER = (
    "Hermann, Shojaei, Seleson, Cyron, Silling (2023), Dirichlet-type absorbing boundary conditions for peridynamic scalar waves in "
    "two-dimensional viscous media"
)
RADIUS, DAMPING = 26.0, 0.0125
TIMES = (20.0, 30.0, 40.0, 50.0)
PROBE = (20.0, 10.0)
_SMALL = 8.0  # radius of the near fields whose stability is examined
_CROSSINGS = 20
_OPEN = 44.0  # degrees: the open cone of eq 54, without its diagonals


def published(radius: float, **options: Any) -> PlaneWave:
    """The paper's condition: collocation on continuous-time modes, wavenumbers to 1 in five steps, eleven angles to 45 degrees."""
    return PlaneWave(**{"fit": "collocation", "time": "continuous", "radius": radius, "thin": 1, "wavenumber": 1.0, "wavenumbers": 5,
                        "angle": 45.0, "normals": "free", **options})  # fmt: skip


def wide_pulse(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Initial data of examples 1 and 3."""
    return np.exp(-np.log(2) / 9 * (x**2 + y**2))


def narrow_pulse(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Initial data of example 2."""
    return np.exp(-np.log(2) * (x**2 + y**2))


def square(half: float, dt: float) -> dict[str, Any]:
    """Example 1: lumped bilinear elements of edge 0.5 on a square whose outermost nodes are the condition's."""
    spacing = 0.5
    lattice = Lattice(spacing, (spacing - half,) * 2, (half - spacing,) * 2)
    return {"lattice": lattice, "model": Wave(Stencil.finite_element(2), damping=DAMPING), "initial": {"u": wide_pulse}, "dt": dt}


def disc(radius: float, reach: int, dt: float) -> dict[str, Any]:
    """Examples 2 and 3: a disc of peridynamic nodes, the outermost horizon of which is the condition's."""
    spacing = 0.25
    lattice = Lattice(spacing, window=Disc(radius - reach * spacing))
    kernel = Kernel(reach * spacing, 2, calibrate=False)
    return {"lattice": lattice, "model": Wave(kernel, damping=DAMPING), "initial": {"u": narrow_pulse if reach == 6 else wide_pulse}, "dt": dt}


def _outcome(
    name: str, folder: Path, setup: Mapping[str, Any], small: Mapping[str, Any], conditions: Mapping[str, Boundary], times: Sequence[float],
    shown: Sequence[str],
) -> Outcome:  # fmt: skip
    """Rows and pictures of an example in a homogeneous medium: errors at the times, and the stability of a small near field."""
    exact = infinite(setup, times[-1])
    fields = [exact(round(t / setup["dt"])) for t in times]
    rows = [Row(f"infinite medium, largest |u| at t = {t:g}", float(np.nanmax(np.abs(f)))) for t, f in zip(times, fields, strict=True)]
    crossing = 2 * float(small["lattice"].upper[0]) / small["model"].speed
    runs = {}
    for label, boundary in conditions.items():
        runs[label] = run(setup, boundary, times, exact)
        notes = [stability_note(small, boundary, _CROSSINGS * crossing)] + [""] * len(times)
        rows += [Row(f"{label}, t = {t:g}", float(e), note=note) for t, e, note in zip(times, runs[label].errors, notes, strict=False)]
    peak = float(np.abs(setup["initial"]["u"](*setup["lattice"].coordinates())).max())
    errors = {label: float(found.errors.max()) / peak for label, found in runs.items()}
    return Outcome(rows, errors, pictures(name, folder, setup["lattice"].axes, times, fields, runs, shown))


@reproduction("hermann2023-ex1", PAPER, "finite elements on a square: the condition for classical waves, and the first-order one", full="minutes")
def example_1(folder: Path, full: bool = False) -> Outcome:
    """Square of 105^2 nodes; the step is 20 times the paper's unless `full`."""
    dt = 5e-4 if full else 0.01
    setup = square(RADIUS, dt)
    conditions: dict[str, Boundary] = {
        "published, 1 spacing": published(0.5), "published, 2 spacings": published(1.0), "published, 3 spacings": published(1.5),
        "repaired, operator fit, 3 spacings": PlaneWave(), "repaired, operator fit, 1 spacing": PlaneWave(radius=0.5),
        "Higdon (0, 45)": Higdon((0, 45), 0.03), "Higdon (0, 30, 60)": Higdon((0, 30, 60), 0.03), "first order, A13": FirstOrder(),
        "lattice PML": LatticePML(),
    }  # fmt: skip
    nodes = int((2 * RADIUS / 0.5 + 1) ** 2)
    counts = [Row("nodes of the square", nodes, 11025), Row("elements", (2 * RADIUS / 0.5) ** 2, 10816)]
    shown = ("published, 1 spacing", "published, 3 spacings", "repaired, operator fit, 3 spacings", "first order, A13", "lattice PML")
    found = _outcome("hermann2023-ex1", folder, setup, square(_SMALL, 0.05), conditions, TIMES, shown)
    return Outcome(counts + found.rows, found.infinite_error, found.pictures)


def disc_conditions(reach: int) -> dict[str, Boundary]:
    """What is run on discs: readings of the published condition, its repairs, and the others."""
    horizon = 0.25 * reach
    thin: dict[str, Any] = {"thin": 2, "cone": 45.0 if reach == 6 else _OPEN}
    readings: dict[str, Boundary] = {
        "published A, whole cone": published(horizon), "published A, thinned by 2": published(horizon, **thin),
        "published B, thinned by 2": published(horizon, dispersion="local", **thin),
        "published A, lattice normals": published(horizon, thin=-(-reach // 3), normals="lattice"),
    }  # fmt: skip
    if reach == 6:
        readings["published A, thinned by 3"] = published(horizon, thin=3)
    return readings | {
        "repaired, operator fit": PlaneWave(), "Higdon (0, 0)": Higdon((0, 0), 0.02), "Higdon (0, 45)": Higdon((0, 45), 0.02),
        "lattice PML": LatticePML(),
    }  # fmt: skip


def _disc_counts(reach: int) -> list[Row]:
    """Node numbers of the paper's discs: every lattice point within the radius, the fringe in it."""
    grid = np.arange(-504, 505)
    square_of_radius = np.add.outer(grid**2, grid**2)
    inside, large = (int((square_of_radius <= (r * 4) ** 2).sum()) for r in (RADIUS, 126))
    fringe = inside - int((square_of_radius <= (RADIUS * 4 - reach) ** 2).sum())
    return [Row("nodes of the disc", inside, 33949), Row("nodes of the reference", large, 797889), Row("absorbing nodes", fringe)]


@reproduction(
    "hermann2023-ex2", PAPER, "disc, horizon 6 (and 3) spacings: modes with the lattice's dispersion (A) and local (B), and repairs", full="minutes"
)
def example_2(folder: Path, full: bool = False) -> Outcome:
    """Disc of radius 26; the step is 500 times the paper's, with `full` 20 times."""
    dt = 2e-3 if full else 0.05
    whole = Outcome(_disc_counts(6))
    for reach in (6, 3):
        setup = {**disc(RADIUS, reach, dt), "initial": {"u": narrow_pulse}}
        small = disc(_SMALL, reach, 0.05)
        shown = ("published A, thinned by 2", "published A, lattice normals", "repaired, operator fit", "Higdon (0, 45)", "lattice PML")
        found = _outcome(f"hermann2023-ex2-{reach}", folder, setup, small, disc_conditions(reach), TIMES, shown)
        mark = f"horizon {reach} spacings: "
        whole.rows.extend(Row(mark + row.what, row.ours, row.printed, note=row.note) for row in found.rows)
        whole.infinite_error.update({mark + label: value for label, value in found.infinite_error.items()})
        whole.pictures.extend(found.pictures)
    return whole


NOTCHES = [[(-7.0, -7.0), (7.0, -7.0)], [(0.0, 10.0), (7.0, 10.0)]]
_ASIDE = 1e-3 * 0.25  # the notches run through nodes; they are moved this far off them


def notched(radius: float, dt: float) -> dict[str, Any]:
    """Example 3."""
    cracks = [[(x, y + _ASIDE) for x, y in notch] for notch in NOTCHES]
    return {**disc(radius, 3, dt), "cracks": cracks}


def large_domain(setup: Mapping[str, Any], until: float) -> Reference:
    """The near field of a set-up with cracks, on a square from whose ends nothing returns."""
    lattice = setup["lattice"]
    half = lattice.spacing * (lattice.shape[0] // 2 + int(0.5 * until / lattice.spacing) + 40)
    sim = Simulation(**{**setup, "lattice": Lattice(lattice.spacing, (-half,) * 2, (half,) * 2), "boundary": Fixed()})
    first = (sim.lattice.shape[0] - lattice.shape[0]) // 2
    near = (slice(first, first + lattice.shape[0]),) * 2
    known: dict[int, np.ndarray] = {}

    def after(steps: int) -> np.ndarray:
        if steps not in known:
            sim.step(steps - sim.step_count)
            known[steps] = np.where(lattice.mask, sim.fields["u"][near], np.nan)
        return known[steps]

    return after


@reproduction("hermann2023-ex3", PAPER, "disc with two notches: errors, and the field at (20, 10) for radius 26 and 42", full="minutes")
def example_3(folder: Path, full: bool = False) -> Outcome:
    """Radius 26 and 42 to t = 70; the step is 500 times the paper's, with `full` 50 times."""
    from farhorizon.plot import curve_panels

    dt = 5e-3 if full else 0.05
    times = tuple(np.arange(1.0, 71.0))
    conditions: dict[str, Boundary] = {
        "published A, thinned by 2": published(0.75, thin=2, cone=_OPEN), "published A, lattice normals": published(0.75, normals="lattice"),
        "repaired, operator fit": PlaneWave(), "Higdon (0, 45)": Higdon((0, 45), 0.02), "lattice PML": LatticePML(),
    }  # fmt: skip
    whole, panels = Outcome([]), []
    for radius in (RADIUS, 42.0):
        setup = notched(radius, dt)
        exact = large_domain(setup, times[-1])
        fields = [exact(round(t / dt)) for t in times]
        probe = setup["lattice"].index(PROBE)
        curves = [("large domain", np.array(times), np.array([f[probe] for f in fields]))]
        runs = {label: run(setup, boundary, times, exact) for label, boundary in conditions.items()}
        for label, found in runs.items():
            at_probe = np.array([f[probe] for f in found.fields])
            curves.append((label, np.array(times[: len(at_probe)]), at_probe))
            apart = float(np.abs(at_probe - curves[0][2][: len(at_probe)]).max())
            whole.rows.extend(
                Row(f"radius {radius:g}, {label}, t = {t:g}", float(found.errors[times.index(t)]),
                    note=f"at (20, 10) at most {apart:.2g}" if t == 30 else "")
                for t in (30.0, 40.0, 50.0, 70.0)
            )  # fmt: skip
            whole.infinite_error[f"radius {radius:g}, {label}"] = float(found.errors.max())
        panels.append(
            (f"radius {radius:g}", [c for c in curves if c[0] in ("large domain", "published A, lattice normals", "repaired, operator fit")])
        )
        cracks = [np.array(notch) for notch in NOTCHES]
        name = f"hermann2023-ex3-{radius:g}"
        whole.pictures.extend(pictures(name, folder, setup["lattice"].axes, times, fields, runs, tuple(conditions), cracks))
    for label, boundary in conditions.items():
        less_one, how = stability(disc(_SMALL, 3, 0.05), boundary, _CROSSINGS * 2 * _SMALL)
        whole.rows.append(Row(f"{label}, spectral radius less 1, disc of {_SMALL:g}", less_one, note=how))
    whole.pictures.append(folder / "hermann2023-ex3-probe.png")
    curve_panels(panels, whole.pictures[-1], xlabel="t", ylabel="u at (20, 10)")
    return whole


@reproduction("hermann2023-appB", PAPER, "highly dispersive pulse on a line, 25 nodes in the horizon", full="minutes")
def appendix_b(folder: Path, full: bool = False) -> Outcome:
    """2001 nodes, 150 000 steps with `full`, else a third of them. The kernel of the exact ends takes some minutes, once."""
    spacing, dt = 0.01, 1e-4
    times = (5.0, 10.0, 15.0) if full else (2.5, 5.0)
    kernel = Kernel(0.25, 0, volume="full", calibrate=False)
    lattice = Lattice(spacing, (-10.0,), (10.0,))
    model = Wave(kernel, float(np.sqrt(10)), 5e-4)
    setup = {"lattice": lattice, "model": model, "initial": {"u": lambda x: np.exp(-20 * np.log(2) * x**2)}, "dt": dt}
    small = {**setup, "lattice": Lattice(spacing, (-1.0,), (1.0,))}
    line: dict[str, Any] = {"wavenumber": 1.0, "wavenumbers": 10}
    conditions: dict[str, Boundary] = {
        "published, centre and 25 nodes": published(0.25, **line), "published, centre and 1 node": published(0.01, **line),
        "published, centre and 3 nodes": published(0.03, **line), "published, wavenumbers to 10": published(0.25, wavenumber=10.0, wavenumbers=10),
        "repaired, operator fit, centre and 1 node": PlaneWave(wavenumber=10.0), "Higdon (0, 0)": Higdon((0, 0)),
        "sponge of 400 nodes": Sponge(400), "lattice PML": LatticePML(), "exact ends": Exact(compress=None),
    }  # fmt: skip
    counts = [Row("nodes between the absorbing ones", lattice.nodes, 2001), Row("absorbing nodes at each end", 25, 25)]
    shown = ("published, centre and 25 nodes", "published, centre and 3 nodes", "Higdon (0, 0)")
    found = _outcome("hermann2023-appB", folder, setup, small, conditions, times, shown)
    return Outcome(counts + found.rows, found.infinite_error, found.pictures)


@reproduction("hermann2023-fig6", PAPER, "dispersion: numerical, Taylor and local")
def figure_6(folder: Path) -> Outcome:
    """Frequencies at a horizon of 2 without damping, on the lattice with 2 and 8 spacings in it, by series of order 4 and 26, and local."""
    from farhorizon.plot import curve_panels

    horizon = 2.0
    kernel = Kernel(horizon, 2)
    k = np.linspace(0.0, np.pi, 315)
    along = np.stack([k, 0 * k], axis=1)
    curves = [("closed form", k, np.sqrt(kernel.dispersion(k, 2)))]
    for m in (2, 8):
        spacing = horizon / m
        stencil = Stencil.from_kernel(Kernel(horizon, 2, calibrate=False), spacing, 2)
        symbol = discrete_symbol(along, spacing * stencil.offsets, stencil.weights / spacing**2)
        curves.append((f"numerical, horizon / spacing = {m}", k, np.sqrt(symbol)))
    for order in (4, 26):
        series = series_symbol(along, 1.0, horizon, kernel.series(2, order // 2 - 1))
        curves.append((f"Taylor, order {order}", k, np.sqrt(np.abs(series))))
    curves.append(("local", k, k))
    path = folder / "hermann2023-fig6.png"
    panels = [("on the lattice", curves[:3]), ("series and local", [curves[0], *curves[3:]])]
    curve_panels(panels, path, xlabel="wavenumber", ylabel="frequency")
    rows = []
    for at in (1.0, 2.0, 3.0):
        place = int(np.argmin(np.abs(k - at)))
        rows += [Row(f"frequency at wavenumber {at:g}, {name}", float(y[place]), note="the figure prints no number" * (name == "closed form"))
                 for name, _, y in curves]  # fmt: skip
    return Outcome(rows, pictures=[path])

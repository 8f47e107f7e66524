"""A branching crack with and without edges: does branching require echoes?

Two bands beside a short crack are pulled apart permanently. Its tips run faster and faster until they branch. In the
infinite medium no wave returns to them; in a plate with free edges the first echo arrives at a known time. Bobaru and
Hu (2012) found with smaller and larger plates that branching needs no waves from the edges. Here the same crack is
computed without any edges.

It is also computed at several horizons and spacings. There is no exact solution for its speed and its branches, only a
bound: no energy flows into the tip of a mode I crack at the Rayleigh wave speed (Freund, 1990, Dynamic fracture
mechanics), so that no tip is faster. The runs also show whether the pattern stays the same as the spacing decreases at
a fixed horizon, and as the horizon decreases.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from farhorizon import CrackTips, Elastic, Free, Kernel, Lattice, LatticePML, Side, Simulation
from farhorizon.studies.collection import Outcome, Row
from farhorizon.validation import validation

BRANCHING = "Bobaru and Hu (2012), The meaning, selection, and use of the peridynamic horizon"
SPACING = 0.125
HALF, WIDER = 16.0, 18.0  # half widths of two near fields
BAND = 9.0  # distance of the pulled bands from the crack
END = 36.0
TOUGHNESS = 3e-5
RAYLEIGH = 0.9194  # Rayleigh wave speed over S wave speed for a Poisson's ratio of 1/4


def running(boundary: Side, half: float, spacing: float = SPACING, reach: int = 3) -> tuple[Simulation, CrackTips]:
    """Run of a crack until it has branched, and its tips; the horizon is `reach` spacings."""
    edge = half - spacing / 2
    lattice = Lattice(spacing, (-half, -edge), (half, edge))
    model = Elastic(Kernel(reach * spacing, exponent=1), young=1.0, fracture_energy=TOUGHNESS)
    bands = f"0.004*(exp(-(y-{BAND})**2)-exp(-(y+{BAND})**2))*exp(-(x/7)**4)*(1-exp(-t/3))"
    tips = CrackTips(every=4)
    sim = Simulation(lattice, model, boundary, sources=[["0", bands]], cracks=[[(-2, 0), (2, 0)]], observe=[tips])
    return sim.run(END, progress=False), tips


def time_of_branching(tips: CrackTips) -> float:
    """First time at which there are more than the two initial tips; infinite if there never are."""
    seen = np.isfinite(tips.data["position"][..., 0])
    return float(tips.times[np.argmax(seen[:, 2:].any(1))]) if seen[:, 2:].any() else np.inf


def angle_of_branches(tips: CrackTips, place: np.ndarray) -> float:
    """Angle in degrees at `place` between the two tips that are farthest to the right."""
    last = tips.now.tips[np.argsort(tips.now.tips[:, 0])[-2:]]
    return float(np.ptp(np.degrees(np.arctan2(*(last - place).T[::-1]))))


def time_of_parting(tips: CrackTips, later: CrackTips) -> float:
    """First time at which the first tips of two runs are a quarter of a horizon apart; infinite if they never are."""
    first, second = (tracked.data["position"][:, 0] for tracked in (tips, later))
    apart = np.linalg.norm(first - second, axis=1) > 0.75 * SPACING
    return float(tips.times[np.argmax(apart)]) if apart.any() else np.inf


def _drawn(tips: CrackTips) -> np.ndarray:
    """Paths of the cracks as one line with gaps, shape (n, 2)."""
    gap = np.full((1, 2), np.nan)
    return np.concatenate([part for path in tips.now.paths for part in (path, gap)])


@validation("branching", BRANCHING, "a crack that branches in the infinite medium, and in a plate with free edges")
def branching(folder: Path) -> Outcome:
    """Times of branching and of the first echo, speeds and angles."""
    from farhorizon.pictures.curves import curve_panels

    sim, tips = running(LatticePML(nodes=24), HALF)
    _, more = running(LatticePML(nodes=24), WIDER)
    _, boxed = running(Free(), HALF)
    model = sim.model
    assert isinstance(model, Elastic)
    echo = 2 * (HALF - BAND) / model.p_speed + BAND / model.p_speed
    first = time_of_branching(tips)
    fastest = float(np.nanmax(tips.data["speed"][tips.times < first])) / (RAYLEIGH * model.s_speed)
    place = tips.now.branches[np.argmax(tips.now.branches[:, 0])]
    rows = [
        Row("branches in the infinite medium at t", first),
        Row("the same in a near field wider by an eighth, over it", time_of_branching(more) / first, 1.0),
        Row("the first echo of free edges comes to the crack at t", float(echo)),
        Row("tips with free edges and without are a quarter of a horizon apart at t", time_of_parting(tips, boxed)),
        Row("branches between free edges at t", time_of_branching(boxed)),
        Row("largest speed before branching over that of Rayleigh waves", fastest),
        Row("angle between the last branches, degrees", angle_of_branches(tips, place)),
    ]
    picture = folder / "branching.png"
    rayleigh, both = RAYLEIGH * model.s_speed, (("infinite medium", tips), ("free edges", boxed))
    speeds = [(name, tracked.times, tracked.data["speed"][:, 0] / rayleigh) for name, tracked in both]
    cracks = [(name, *_drawn(tracked).T) for name, tracked in both]
    curve_panels(
        [("one tip", speeds), (f"cracks at t = {END:g}", cracks)],
        picture,
        xlabel=("t", "x"),
        ylabel=("speed / Rayleigh speed", "y"),
        equal=[1],
    )
    return Outcome(rows, pictures=[picture])


SPEEDS = "Freund (1990), Dynamic fracture mechanics; Ha and Bobaru (2010), Int. J. Fract. 162, 229"
HORIZONS = (0.5, 0.25)
SMALLEST = 0.125  # smallest horizon, with `full`
REACHES = (2, 3, 4)  # numbers of spacings in the horizon
PATTERNS_HALF = 16.5  # half width of the near field of patterns, a multiple of all spacings
SHOWN = 13.0, 3.5  # half widths of the part that is drawn


def pattern(horizon: float, reach: int) -> tuple[Simulation, CrackTips]:
    """Run of the crack up to the end, and its tips."""
    return running(LatticePML(nodes=24), PATTERNS_HALF, horizon / reach, reach)


def speeds(sim: Simulation, tips: CrackTips) -> np.ndarray:
    """Speed of the fastest tip at each record relative to the Rayleigh wave speed; nan where no speed is known."""
    assert isinstance(sim.model, Elastic)
    fastest: np.ndarray = np.fmax.reduce(tips.data["speed"], axis=1)
    return fastest / (RAYLEIGH * sim.model.s_speed)


def measured(sim: Simulation, tips: CrackTips, name: str) -> list[Row]:
    """Rows for one crack."""
    first, speed = time_of_branching(tips), speeds(sim, tips)
    branches = tips.now.branches[tips.now.branches[:, 0] > 0]
    spent = (tips.dissipated[-1] - tips.dissipated[0]) / (tips.length[-1] - tips.length[0])
    bound = "1 is the bound"
    return [
        Row(f"{name}: branches at t", first),
        Row(
            f"{name}: largest speed before over that of Rayleigh waves",
            np.nanmax(speed[tips.times < first]),
            note=bound,
        ),
        Row(f"{name}: the same of any tip at any time", np.nanmax(speed), note=bound),
        Row(f"{name}: angle of the branches, degrees", angle_of_branches(tips, branches[branches[:, 0].argmin()])),
        Row(f"{name}: broken bonds over fracture energy times length", float(spent / TOUGHNESS)),
    ]


def draw_patterns(runs: dict[tuple[float, int], Simulation], picture: Path) -> None:
    """Draw the final damage of all cracks, with one row per horizon and one column per number of spacings in it."""
    from farhorizon.pictures.panels import cell_edges
    from farhorizon.pictures.style import figure_at

    horizons = list(dict.fromkeys(horizon for horizon, _ in runs))
    with figure_at(picture, (7.2, 0.6 + 0.62 * len(horizons))) as figure:
        panels = figure.subplots(len(horizons), len(REACHES), sharex=True, sharey=True, squeeze=False)
        for (horizon, reach), sim in runs.items():
            row, column = horizons.index(horizon), REACHES.index(reach)
            panel, axes = panels[row, column], sim.lattice.axes
            image = panel.imshow(
                sim.fields["damage"].T, origin="lower", extent=cell_edges(axes), cmap="Greys", vmin=0.0, vmax=0.5
            )
            panel.set(xlim=(-SHOWN[0], SHOWN[0]), ylim=(-SHOWN[1], SHOWN[1]))
            if row == 0:
                panel.set_title(f"{reach} spacings in the horizon")
            if column == 0:
                panel.set_ylabel(f"horizon\n{horizon:g}")
        figure.colorbar(image, ax=panels, label="damage", aspect=8 * len(horizons))


@validation(
    "branching-patterns",
    SPEEDS,
    "speeds and branches of a crack at several horizons and spacings",
    "a minute",
    full="minutes",
)
def branching_patterns(folder: Path, full: bool = False) -> Outcome:
    """Two horizons, or three with `full`, with two, three and four spacings in each."""
    from farhorizon.pictures.curves import curve_panels

    rows, runs, panels = [], {}, []
    for horizon in (*HORIZONS, SMALLEST) if full else HORIZONS:
        curves = [("Rayleigh waves", np.array([0.0, END]), np.ones(2))]
        for reach in REACHES:
            sim, tips = pattern(horizon, reach)
            runs[horizon, reach] = sim
            rows += measured(sim, tips, f"horizon {horizon:g}, {reach} spacings")
            curves.append((f"{reach} spacings in the horizon", tips.times, speeds(sim, tips)))
        panels.append((f"horizon {horizon:g}", curves))
    pictures = [folder / "branching-patterns.png", folder / "branching-speeds.png"]
    draw_patterns(runs, pictures[0])
    curve_panels(panels, pictures[1], xlabel="t", ylabel="speed of the fastest tip / Rayleigh speed")
    return Outcome(rows, pictures=pictures)

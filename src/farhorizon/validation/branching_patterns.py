"""The crack of `validate branching` in the infinite medium at several horizons and spacings.

There is no exact solution for its speed and its branches, only a bound: no energy flows into the tip of a mode I crack
at the Rayleigh wave speed (Freund, 1990, Dynamic fracture mechanics), so that no tip is faster. The runs also show
whether the pattern stays the same as the spacing decreases at a fixed horizon, and as the horizon decreases.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from farhorizon import CrackTips, Elastic, LatticePML, Simulation
from farhorizon.studies.collection import Outcome, Row
from farhorizon.validation.branching import END, RAYLEIGH, TOUGHNESS, angle_of_branches, running, time_of_branching
from farhorizon.validation.validations import validation

SPEEDS = "Freund (1990), Dynamic fracture mechanics; Ha and Bobaru (2010), Int. J. Fract. 162, 229"
HORIZONS = (0.5, 0.25)
SMALLEST = 0.125  # smallest horizon, with `full`
REACHES = (2, 3, 4)  # numbers of spacings in the horizon
HALF = 16.5  # half width of the near field, a multiple of all spacings
SHOWN = 13.0, 3.5  # half widths of the part that is drawn


def pattern(horizon: float, reach: int) -> tuple[Simulation, CrackTips]:
    """Run of the crack up to the end, and its tips."""
    return running(LatticePML(nodes=24), HALF, horizon / reach, reach)


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

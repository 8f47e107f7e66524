"""A branching crack with and without edges: does branching require echoes?

Two bands beside a short crack are pulled apart permanently. Its tips run faster and faster until they branch. In the
infinite medium no wave returns to them; in a plate with free edges the first echo arrives at a known time. Bobaru and
Hu (2012) found with smaller and larger plates that branching needs no waves from the edges. Here the same crack is
computed without any edges.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from farhorizon import CrackTips, Elastic, Free, Kernel, Lattice, LatticePML, Side, Simulation
from farhorizon.studies.collection import Outcome, Row
from farhorizon.validation.validations import validation

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

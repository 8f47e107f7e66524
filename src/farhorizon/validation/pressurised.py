r"""Cracks held open by a pressure on their faces, until all waves have left.

A straight crack of length 2a in 2D and a penny-shaped one of radius a in 3D open elliptically:

.. math:: \frac{4 (1 - \nu^2)\,p}{E}\sqrt{a^2 - x^2}, \quad K_I = p\sqrt{\pi a}; \qquad
   \frac{8 (1 - \nu^2)\,p}{\pi E}\sqrt{a^2 - r^2}, \quad K_I = 2p\sqrt{a / \pi}

(Griffith, 1921, in plane strain; Sneddon, 1946, Proc. R. Soc. A 187, 229). The runs are not damped: they end when the
kinetic energy has left through the layers.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from farhorizon import (
    DiscCut,
    Elastic,
    Kernel,
    Lattice,
    LatticePML,
    Polyline,
    Pressure,
    Simulation,
    Step,
    StressIntensity,
)
from farhorizon.analysis.fracture.opening import face_jumps, opening_intensity
from farhorizon.studies.collection import Outcome, Row
from farhorizon.validation import validation
from farhorizon.validation.penny import draw_profile

SNEDDON = "Griffith (1921); Sneddon (1946), The distribution of stress in the neighbourhood of a crack"
SIZE = 4.0  # half length, and radius
TURN = 0.4  # angle of the straight crack to the lattice, in radians
YOUNG, POISSON = 1.0, 0.25  # bond-based, plane strain
SPACINGS = (0.25, 0.125)
COARSE = (1.0, 0.5)  # spacings for the penny-shaped crack


def griffith_opening(x: np.ndarray) -> np.ndarray:
    """Exact opening of the straight crack at the distances x from the middle, under a unit pressure."""
    return np.asarray(4 * (1 - POISSON**2) / YOUNG * np.sqrt(np.maximum(SIZE**2 - x**2, 0.0)))


def penny_opening(r: np.ndarray, radius: float) -> np.ndarray:
    """Exact opening of the penny-shaped crack at the distances r from the middle, under a unit pressure."""
    return np.asarray(8 * (1 - POISSON**2) / (np.pi * YOUNG) * np.sqrt(np.maximum(radius**2 - r**2, 0.0)))


def straight(spacing: float) -> tuple[Simulation, Polyline, StressIntensity, StressIntensity]:
    """A straight crack at rest under a unit pressure, and K recorded between two pairs of circles."""
    half = 2 * SIZE - spacing / 2
    lattice = Lattice(spacing, (-half, -half), (half, half))
    model = Elastic(Kernel(2 * spacing, exponent=1), young=YOUNG)
    ahead = np.array([np.cos(TURN), np.sin(TURN)])
    crack = Polyline([-SIZE * ahead, SIZE * ahead])
    large, small = StressIntensity(every=4), StressIntensity(radii=(0.3 * SIZE, 0.55 * SIZE), every=4, name="small")
    press = Pressure(crack, 1.0, time=Step(SIZE))
    sim = Simulation(lattice, model, LatticePML(nodes=16), loads=[press], cracks=[crack], observe=[large, small])
    return sim.run("static", tolerance=1e-3, limit=500.0, progress=False), crack, large, small


@validation("griffith-crack", SNEDDON, "a pressurised crack across the lattice, to the static limit")
def griffith(folder: Path) -> Outcome:
    """K by the interaction integral between two pairs of circles, and the opening."""
    from farhorizon.pictures.curves import curve_panels

    x = np.linspace(-0.9 * SIZE, 0.9 * SIZE, 61)
    unit, rows, errors = np.sqrt(np.pi * SIZE), [], []
    for spacing in SPACINGS:
        sim, crack, large, small = straight(spacing)
        computed = face_jumps(sim.fields["u"], sim.lattice, crack, SIZE + x)[:, 0]
        errors.append(float(np.abs(computed - griffith_opening(x)).max() / griffith_opening(np.zeros(1))[0]))
        intensity, sliding = large.data["K_I"][-1].mean(), np.abs(large.data["K_II"][-1]).max()
        rows += [
            Row(f"K_I over p sqrt(pi a), spacing a/{SIZE / spacing:g}", float(intensity / unit), 1.0),
            Row(f"K_II over p sqrt(pi a), spacing a/{SIZE / spacing:g}", float(sliding / unit)),
        ]
    inner = small.data["K_I"][-1].mean()
    rows += [
        Row("K_I between smaller circles over that between larger ones", float(inner / intensity), 1.0),
        Row("opening, largest difference of the largest", errors[-1]),
        Row("order of the opening in the spacing", float(np.log2(errors[0] / errors[1])), 1.0),
        Row("crossings of the near field by P waves until rest", float(sim.time / sim.crossing)),
    ]
    picture = folder / "griffith-crack.png"
    assert isinstance(sim.model, Elastic)
    smooth, most = SIZE * np.sin(np.linspace(-np.pi / 2, np.pi / 2, 100)), griffith_opening(np.zeros(1))
    opening = [("exact", smooth / SIZE, griffith_opening(smooth) / most), ("computed", x / SIZE, computed / most)]
    times = large.times * sim.model.p_speed / SIZE
    history = [("exact", times[[0, -1]], np.ones(2)), ("computed", times, large.data["K_I"][:, 1] / unit)]
    curve_panels(
        [("static limit", opening), ("on the way there", history)],
        picture,
        xlabel=("x / a", "time in units of a over the speed of P waves"),
        ylabel=("opening / exact largest", r"$K_I\,/\,p\sqrt{\pi a}$"),
    )
    return Outcome(rows, pictures=[picture])


def penny_at_rest(spacing: float, **material: Any) -> tuple[np.ndarray, np.ndarray, float]:
    """Distances from the middle of the nodes beside a penny-shaped crack, its opening there, and the radius of a disc
    with the area of the cut in the lattice; the solid is bond-based unless a material is given.
    """
    model = Elastic(Kernel(2 * spacing, exponent=1), young=YOUNG, **material)
    reach = spacing * model.stencil(spacing, 3).reach[2]
    wide, high = SIZE + 2 * spacing, max(SIZE / 2, reach) + spacing / 2
    lattice = Lattice(spacing, (-wide, -wide, -high), (wide, wide, high))
    crack = DiscCut((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), SIZE)
    press = Pressure(crack, 1.0, time=Step(2 * SIZE))
    sim = Simulation(lattice, model, LatticePML(nodes=8), loads=[press], cracks=[crack])
    sim.run("static", tolerance=0.01, limit=400.0, progress=False)
    x, y, _ = lattice.coordinates()
    r, middle = np.hypot(x, y)[..., 0], lattice.shape[2] // 2
    u = sim.fields["u"][2]
    cut = spacing * np.sqrt((r < SIZE).sum() / np.pi)
    return r, u[..., middle] - u[..., middle - 1], float(cut)


@validation("penny-pressure", SNEDDON, "a pressurised penny-shaped crack, to the static limit")
def penny_pressure(folder: Path) -> Outcome:
    """The opening in the middle, and K derived from the opening."""
    rows = []
    for spacing in COARSE:
        r, computed, radius = penny_at_rest(spacing)
        middle = np.unravel_index(r.argmin(), r.shape)
        ratio = float(computed[middle] / penny_opening(np.zeros(1), radius)[0])
        rows.append(
            Row(f"opening in the middle over 8 (1 - nu^2) p a / pi E, spacing a/{SIZE / spacing:g}", ratio, 1.0)
        )
    inside, picture = r < SIZE, folder / "penny-pressure.png"
    near = (1.5 * COARSE[-1], 0.75 * SIZE)
    stiffness = YOUNG / (1 - POISSON**2)
    intensity = opening_intensity(radius - r[inside], computed[inside], stiffness, near)
    rows += [Row("K_I over 2 p sqrt(a / pi), from the opening", intensity / (2 * np.sqrt(radius / np.pi)), 1.0)]
    draw_profile(r[inside], computed[inside], radius, penny_opening, "opening", picture)
    return Outcome(rows, pictures=[picture])

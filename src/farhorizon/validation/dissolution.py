r"""Diffusion-controlled dissolution of steel under an open electrolyte and in a pencil electrode.

Metal of concentration :math:`C_m` dissolves where the liquid is below its saturation :math:`C_s`, and the dissolved
metal diffuses away. From a plane face the front moves by :math:`2p\sqrt{Dt}` (the Stefan problem; Scheiner and
Hellmich, 2007, Stable pitting corrosion of stainless steel as diffusion-controlled dissolution process), with

.. math:: \sqrt\pi\,p\,e^{p^2}\,\mathrm{erfc}(-p) = \frac{C_s}{C_m - C_s}

for an unbounded electrolyte, and with :math:`\mathrm{erf}(p)` in place of :math:`\mathrm{erfc}(-p)` if the mouth of the
pit, at the initial surface of the metal, is kept free of dissolved metal.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.optimize import brentq
from scipy.special import erf, erfc

from farhorizon import Box, Corrosion, Fixed, Free, Kernel, Lattice, LatticePML, Simulation, Specimen
from farhorizon.studies.collection import Outcome, Row
from farhorizon.validation import validation

PITS = (
    "Scheiner, Hellmich (2007), Stable pitting corrosion of stainless steel as diffusion-controlled dissolution process"
)
METAL, SATURATION = 143e3, 5.1e3  # mol / m3, of 304 stainless steel in its own chlorides
DIFFUSIVITY = 8.5e-10  # m2 / s
UNTIL = 225.0  # s
HORIZONS = (4e-6, 2e-6)  # m


def parameter(right: Callable[[float], float]) -> float:
    """Parameter p of the Stefan problem with the error function `right`."""
    supply = SATURATION / (METAL - SATURATION)
    return float(brentq(lambda p: np.sqrt(np.pi) * p * np.exp(p**2) * right(p) - supply, 1e-4, 2.0))


def run(horizon: float, open_: bool) -> Simulation:
    """A bar of metal at x < 0 next to liquid that is unbounded or ends at the mouth, before its first step."""
    spacing, depth = horizon / 2, 400e-6 if not open_ else 100e-6
    lattice = Lattice(spacing, -depth + spacing / 2, (20.5 if open_ else -0.5) * spacing)
    model = Corrosion(Kernel(horizon), diffusivity=DIFFUSIVITY, saturation=SATURATION, interface=1.0, limited=True)
    mouth = LatticePML(until=UNTIL) if open_ else Fixed(0.0)
    return Simulation(lattice, model, {"x-": Free(), "x+": mouth}, specimens=[Specimen(Box(-depth, 0.0), METAL)])


def front(sim: Simulation) -> float:
    """Distance in m that the front has moved, such that a sharp front would leave the same amount of metal."""
    solid = sim.fields["solid"] > 0
    depth = -(sim.lattice.lower[0] - sim.lattice.spacing / 2)
    return float(depth - sim.fields["u"][solid].sum() * sim.lattice.spacing / METAL)


def _outcome(folder: Path, name: str, open_: bool, right: Callable[[float], float]) -> Outcome:
    from farhorizon.pictures.curves import curve_panels

    p, ratios = parameter(right), []
    curves: list[tuple[str, np.ndarray, np.ndarray]] = []
    for horizon in HORIZONS:
        sim = run(horizon, open_)
        times = np.linspace(UNTIL / 60, UNTIL, 60)
        depths = []
        for t in times:
            sim.run(t, progress=False)
            depths.append(front(sim))
        exact = 2 * p * np.sqrt(DIFFUSIVITY * times)
        ratios.append(float(np.mean(np.array(depths)[30:] / exact[30:])))
        if not curves:
            curves.append(("exact", times, exact * 1e6))
        curves.append((f"horizon {horizon * 1e6:g} micrometres", times, np.array(depths) * 1e6))
    rows = [
        Row(f"depth over the exact one, second half, horizon {horizon * 1e6:g} micrometres", ratio, 1.0)
        for horizon, ratio in zip(HORIZONS, ratios, strict=True)
    ]
    rows.append(
        Row(
            "depth over the root of time, micrometres per root second",
            float(depths[-1] / np.sqrt(UNTIL) * 1e6),
            float(2 * p * np.sqrt(DIFFUSIVITY) * 1e6),
        )
    )
    picture = folder / f"{name}.png"
    curve_panels([("", curves)], picture, xlabel="time (s)", ylabel="depth of the front (micrometres)")
    return Outcome(rows, pictures=[picture])


@validation("pencil-electrode", PITS, "steel dissolves in a pit whose mouth is kept clean")
def pencil(folder: Path) -> Outcome:
    """Pencil electrode of 304 stainless steel."""
    return _outcome(folder, "pencil-electrode", False, erf)


@validation("open-electrolyte", PITS, "steel dissolves under an electrolyte that goes on for ever")
def electrolyte(folder: Path) -> Outcome:
    """The near field contains a little liquid; a layer replaces the rest of the electrolyte."""
    return _outcome(folder, "open-electrolyte", True, lambda p: float(erfc(-p)))

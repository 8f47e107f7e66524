r"""A crack that a shear wave hits: the mode III stress intensity factor from the first moment to the static one.

A wave whose stress :math:`\tau(t)` rises within a short time falls at right angles on a crack of length 2a. What the
crack adds to it is the field of a crack whose faces are loaded with that stress. Until a signal of the other tip
arrives, each tip is that of a half-plane crack. By Chaplygin's transformation a face on which a stress of size 1 acts
from t = 0 on moves with

.. math:: \dot w(r, t) = \frac{2c}{\pi\mu}\arcsin\sqrt{\min(1, r/ct)}

and the faces apart twice as fast, whence :math:`K = 2\tau\sqrt{2ct/\pi}` (Achenbach, 1973, Wave propagation in elastic
solids; Freund, 1990, Dynamic fracture mechanics). When all waves have left,
:math:`K = \tau\sqrt{\pi a}`: what no run with edges comes to, and here needs no artificial damping.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from farhorizon.boundaries import LatticePML
from farhorizon.geometry.lattice import Lattice
from farhorizon.inputs.sources import Source
from farhorizon.medium.stencil import Stencil
from farhorizon.models import Wave
from farhorizon.simulation.simulation import Simulation
from farhorizon.studies.collection import Outcome, Row
from farhorizon.validation.validations import validation

CRACK = "Freund (1990), Dynamic fracture mechanics; Achenbach (1973), Wave propagation in elastic solids"
HALF_LENGTH = 8.0  # a
RISE = 2.0  # time in which the stress rises to 1
SPACINGS = (0.25, 0.125)
STATIC = 200.0


def stress(t: np.ndarray | float) -> np.ndarray:
    """Of the incident wave: smooth from 0 to 1."""
    share = np.clip(np.asarray(t) / RISE, 0.0, 1.0)
    return share - np.sin(2 * np.pi * share) / (2 * np.pi)


def opening(r: np.ndarray, t: float) -> np.ndarray:
    """Exact distance between the faces at the distances r from a tip that knows nothing of the other one."""
    nodes, weights = np.polynomial.legendre.leggauss(400)
    s, ds = (nodes + 1) * t / 2, weights * t / 2
    late = np.maximum(t - s, 1e-300)
    rates = 4 / np.pi * np.arcsin(np.sqrt(np.minimum(1.0, r[:, None] / late)))
    return rates @ (ds * stress(s))


def intensity(t: float) -> float:
    """Exact K of such a tip: the stress history over that of a step."""
    nodes, weights = np.polynomial.legendre.leggauss(400)
    s, ds = (nodes + 1) * min(t, RISE) / 2, weights * min(t, RISE) / 2
    rate = (1 - np.cos(2 * np.pi * s / RISE)) / RISE
    return float((ds * rate) @ (2 * np.sqrt(2 * (t - s) / np.pi)))


def measured_intensity(r: np.ndarray, found: np.ndarray) -> float:
    """K from the opening, 4 K sqrt(r / 2 pi) at the tip: its square over r by a parabola, for the place of the tip
    between two nodes is known to a part of the spacing only.
    """
    step = abs(r[1] - r[0])
    near = (r > 3 * step) & (r < HALF_LENGTH / 4)
    square = np.polynomial.Polynomial.fit(r[near], found[near] ** 2, 2)
    roots = square.roots()
    tip = roots[np.argmin(np.abs(roots))]
    return float(np.sqrt(2 * np.pi * square.deriv()(tip).real) / 4)


def run(spacing: float, until: float) -> Simulation:
    """The crack before its faces are loaded; it runs between two rows of nodes."""
    lattice = Lattice(spacing, (-HALF_LENGTH - 2.0, spacing / 2 - 4.0), (HALF_LENGTH + 2.0, 4.0 - spacing / 2))
    x, y = lattice.coordinates()
    loaded = (np.abs(x) <= HALF_LENGTH + 1e-9) & (np.abs(y) < spacing)
    tip = HALF_LENGTH + spacing / 2
    return Simulation(
        lattice,
        Wave(Stencil.finite_difference(2)),
        LatticePML(target=1e-5, until=until),
        sources=[Source(-np.sign(y) * loaded / spacing, time=stress)],
        cracks=[[(-tip, 0.0), (tip, 0.0)]],
    )


def faces(sim: Simulation) -> tuple[np.ndarray, np.ndarray]:
    """Distances of the nodes along the crack from its right tip, and the opening there: the faces lie half a spacing
    beyond the rows of nodes, between which and the face the stress is that of the load.
    """
    x, y = sim.lattice.axes
    middle = len(y) // 2
    there = np.flatnonzero(np.abs(x) <= HALF_LENGTH + 1e-9)[::-1]
    u = sim.fields["u"]
    spacing = sim.lattice.spacing
    rows = u[there, middle - 1] - u[there, middle]
    return HALF_LENGTH + spacing / 2 - x[there], rows + spacing * stress(sim.time)


@validation("mode-three", CRACK, "a shear wave hits a crack: K to the static limit", "a minute")
def mode_three(folder: Path) -> Outcome:
    """Opening before the tips know of each other, and K at several times."""
    from farhorizon.pictures.curves import curve_panels

    rows, errors, limits, panels = [], [], [], []
    times = (4.0, 8.0, 12.0)  # a signal of the other tip takes 16
    for spacing in SPACINGS:
        sim, apart = run(spacing, STATIC), []
        for t in times:
            sim.run(t, progress=False)
            r, found = faces(sim)
            since = sim.time
            wanted = opening(r, since)
            alone = r < 2 * HALF_LENGTH - since
            apart.append(np.abs(found - wanted)[alone & (r > HALF_LENGTH / 8)].max() / wanted.max())
            ratio = measured_intensity(r, found) / intensity(since)
            if spacing == SPACINGS[-1]:
                rows.append(Row(f"K over that of the half-plane crack, t = {t:g}", ratio, 1.0))
                panels.append((f"t = {t:g}", [("exact", r[alone], wanted[alone]), ("computed", r, found)]))
        errors.append(float(max(apart)))
        sim.run(STATIC, progress=False)
        r, found = faces(sim)
        limits.append(measured_intensity(r, found) / np.sqrt(np.pi * HALF_LENGTH))
    static = 2 * np.sqrt(r * (2 * HALF_LENGTH - r).clip(0.0))
    panels.append((f"t = {STATIC:g}, and the static opening", [("exact", r, static), ("computed", r, found)]))
    rows += [
        Row(f"opening beyond a/8 from the tip, largest difference of the largest, spacing {spacing:g}", error)
        for spacing, error in zip(SPACINGS, errors, strict=True)
    ]
    rows.append(
        Row("order in the spacing", float(np.log2(errors[0] / errors[1])), 1.0, note="the tip lies between nodes")
    )
    rows.append(Row(f"K over tau sqrt(pi a), t = {STATIC:g}", float(limits[-1]), 1.0))
    picture = folder / "mode-three.png"
    curve_panels(panels, picture, xlabel="distance from the tip", ylabel="opening")
    return Outcome(rows, pictures=[picture])

r"""Cracks hit by a wave: the stress intensity factor from the first moment to the static limit.

A wave whose stress :math:`\tau(t)` rises within a short time is normally incident on a crack of length 2a. The
scattered field is that of a crack whose faces are loaded with this stress. Until a signal of the other tip arrives,
each tip behaves as that of a half-plane crack, and its K under a step :math:`\tau` is

.. math:: K_{III} = 2\tau\sqrt{\frac{2ct}{\pi}}, \qquad
   K_I = \frac{2\sqrt{1 - 2\nu}}{1 - \nu}\,\tau\sqrt{\frac{c_Pt}{\pi}}

(Freund, 1990, Dynamic fracture mechanics; Achenbach, 1973, Wave propagation in elastic solids). In mode III the motion
of the faces is also known: by Chaplygin's transformation each moves with the velocity

.. math:: \dot w(r, t) = \frac{2c\,\tau}{\pi\mu}\arcsin\sqrt{\min(1, r/ct)} .

When all waves have left, :math:`K = \tau\sqrt{\pi a}`. A run with edges does not reach this limit; here it is reached
without artificial damping.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from farhorizon import Elastic, Kernel, Lattice, LatticePML, Polyline, Pressure, Simulation, Source, Stencil, Step, Wave
from farhorizon.analysis.fracture.opening import opening_intensity
from farhorizon.studies.collection import Outcome, Row
from farhorizon.validation import validation

CRACK = "Freund (1990), Dynamic fracture mechanics; Achenbach (1973), Wave propagation in elastic solids"
HALF_LENGTH = 8.0  # a
RISE = 2.0  # time in which the stress of the wave rises to 1
STRESS = Step(RISE)
SPACINGS = (0.25, 0.125)
STATIC = 200.0
YOUNG, POISSON = 1.0, 0.25  # bond-based, plane strain


def opening(r: np.ndarray, t: float) -> np.ndarray:
    """Exact opening at the distances r from a tip before a signal of the other one arrives."""
    nodes, weights = np.polynomial.legendre.leggauss(400)
    s, ds = (nodes + 1) * t / 2, weights * t / 2
    late = np.maximum(t - s, 1e-300)
    rates = 4 / np.pi * np.arcsin(np.sqrt(np.minimum(1.0, r[:, None] / late)))
    return rates @ (ds * STRESS(s))


def intensity(t: float, step: Callable[[np.ndarray], np.ndarray]) -> float:
    """Exact K of such a tip under the stress, by superposition of the K under steps of stress."""
    nodes, weights = np.polynomial.legendre.leggauss(400)
    s, ds = (nodes + 1) * min(t, RISE) / 2, weights * min(t, RISE) / 2
    rate = (1 - np.cos(2 * np.pi * s / RISE)) / RISE
    return float((ds * rate) @ step(t - s))


def shear_step(t: np.ndarray) -> np.ndarray:
    """K of mode III under a step of unit stress, for unit shear modulus and wave speed."""
    return 2 * np.sqrt(2 * t / np.pi)


def pressure_step(way: np.ndarray) -> np.ndarray:
    """K of mode I under a step of unit stress after P waves have travelled the distance `way`."""
    return 2 * np.sqrt(1 - 2 * POISSON) / (1 - POISSON) * np.sqrt(way / np.pi)


def measured_intensity(r: np.ndarray, jump: np.ndarray, stiffness: float = 2.0) -> float:
    """K from the opening within a quarter of the half length of the tip; of mode III unless a stiffness is given."""
    return opening_intensity(r, jump, stiffness, (3 * abs(r[1] - r[0]), HALF_LENGTH / 4))


def sheared(spacing: float, until: float) -> Simulation:
    """Crack between two rows of nodes of a membrane, before its faces are loaded."""
    lattice = Lattice(spacing, (-HALF_LENGTH - 2.0, spacing / 2 - 4.0), (HALF_LENGTH + 2.0, 4.0 - spacing / 2))
    x, y = lattice.coordinates()
    loaded = (np.abs(x) <= HALF_LENGTH + 1e-9) & (np.abs(y) < spacing)
    tip = HALF_LENGTH + spacing / 2
    return Simulation(
        lattice,
        Wave(Stencil.finite_difference(2)),
        LatticePML(target=1e-5, until=until),
        sources=[Source(-np.sign(y) * loaded / spacing, time=STRESS)],
        cracks=[[(-tip, 0.0), (tip, 0.0)]],
    )


def faces(sim: Simulation) -> tuple[np.ndarray, np.ndarray]:
    """Distances from the right tip of the nodes along the crack, and the displacement jump between the rows of nodes on
    both sides of it, in the direction of the load.
    """
    x, y = sim.lattice.axes
    middle = len(y) // 2
    opened = np.flatnonzero(np.abs(x) <= HALF_LENGTH + 1e-9)[::-1]
    u = sim.fields["u"][-1] if sim.fields["u"].ndim > 2 else sim.fields["u"]
    return HALF_LENGTH + sim.lattice.spacing / 2 - x[opened], np.abs(u[opened, middle - 1] - u[opened, middle])


@validation("mode-three", CRACK, "a shear wave hits a crack: K to the static limit", "a minute")
def mode_three(folder: Path) -> Outcome:
    """Opening before the tips interact, and K at several times."""
    from farhorizon.pictures.curves import curve_panels

    rows, errors, limits, panels = [], [], [], []
    times = (4.0, 8.0, 12.0)  # a signal of the other tip arrives at 16
    for spacing in SPACINGS:
        sim, apart = sheared(spacing, STATIC), []
        for t in times:
            sim.run(t, progress=False)
            r, computed = faces(sim)
            since = sim.time
            computed += spacing * STRESS(
                since
            )  # the faces lie half a spacing beyond the rows, and the load acts between
            solution = opening(r, since)
            alone = r < 2 * HALF_LENGTH - since
            apart.append(np.abs(computed - solution)[alone & (r > HALF_LENGTH / 8)].max() / solution.max())
            ratio = measured_intensity(r, computed) / intensity(since, shear_step)
            if spacing == SPACINGS[-1]:
                rows.append(Row(f"K over that of the half-plane crack, t = {t:g}", ratio, 1.0))
                panels.append((f"t = {t:g}", [("exact", r[alone], solution[alone]), ("computed", r, computed)]))
        errors.append(float(max(apart)))
        sim.run(STATIC, progress=False)
        r, computed = faces(sim)
        computed += spacing
        limits.append(measured_intensity(r, computed) / np.sqrt(np.pi * HALF_LENGTH))
    static = 2 * np.sqrt(r * (2 * HALF_LENGTH - r).clip(0.0))
    panels.append((f"t = {STATIC:g}, and the static opening", [("exact", r, static), ("computed", r, computed)]))
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


def opened(spacing: float, half: tuple[float, float]) -> tuple[Simulation, float]:
    """Crack in a bond-based solid before its faces are pressed apart, in a near field with the half widths `half`, and
    the speed of P waves.

    The load is the stress of the incident wave, whose only strain is that along its direction.
    """
    model = Elastic(Kernel(2 * spacing, exponent=1), young=YOUNG)
    lattice = Lattice(spacing, (-half[0], spacing / 2 - half[1]), (half[0], half[1] - spacing / 2))
    tip = HALF_LENGTH + spacing / 2
    crack = Polyline([(-tip, 0.0), (tip, 0.0)])
    press = Pressure(crack, np.diag([model.lame / model.p_modulus, 1.0]), time=STRESS)
    return Simulation(lattice, model, LatticePML(nodes=20), loads=[press], cracks=[crack]), model.p_speed


def pulled_intensity(sim: Simulation) -> float:
    """K of mode I in plane strain."""
    return measured_intensity(*faces(sim), YOUNG / (1 - POISSON**2))


@validation("mode-one", CRACK, "a pressure wave hits a crack: K to the static limit", "a minute")
def mode_one(folder: Path) -> Outcome:
    """K at several times and at the end, and its dependence on the size of the near field.

    K is determined from the quarter of the half length next to the tip, which Rayleigh waves have passed by ct = 6.
    """
    from farhorizon.pictures.curves import curve_panels

    rows, ends = [], []
    static = np.sqrt(np.pi * HALF_LENGTH)
    ways = np.concatenate([np.arange(6.0, 16.1, 0.5), np.arange(17.0, 120.0)])  # of P waves; the other tip is at 16
    alone = ways <= 2 * HALF_LENGTH
    for spacing, half in ((0.25, (10.0, 4.0)), (0.25, (14.0, 12.0)), (0.125, (10.0, 4.0))):
        sim, speed = opened(spacing, half)
        measured, exact = [], []
        for way in ways:
            sim.run(way / speed, progress=False)
            measured.append(pulled_intensity(sim))
            exact.append(intensity(sim.time, lambda t, speed=speed: pressure_step(speed * t)))  # type: ignore[misc]
        sim.run(STATIC, progress=False)
        ends.append(pulled_intensity(sim))
    for way in (6.0, 8.0, 12.0, 16.0):
        i = int(np.argmin(np.abs(ways - way)))
        rows.append(Row(f"K over that of the half-plane crack, ct = {way:g}", measured[i] / exact[i], 1.0))
    rows.append(Row("largest K over p sqrt(pi a)", float(max(measured) / static)))
    rows += [
        Row(f"K over p sqrt(pi a), t = {STATIC:g}, spacing {spacing:g}", float(end / static), 1.0)
        for spacing, end in ((0.25, ends[0]), (0.125, ends[2]))
    ]
    rows.append(Row("K of a near field of 20 x 8 over that of 28 x 24", float(ends[0] / ends[1]), 1.0))
    picture = folder / "mode-one.png"
    curves = [
        ("half-plane crack", ways[alone], np.array(exact)[alone]),
        ("computed", ways, np.array(measured)),
        ("static", ways[~alone], np.full((~alone).sum(), static)),
    ]
    curve_panels(
        [("", curves)],
        picture,
        xlabel=f"distance travelled by P waves (half length of the crack: {HALF_LENGTH:g})",
        ylabel=r"$K_{\mathrm{I}}$",
    )
    return Outcome(rows, pictures=[picture])

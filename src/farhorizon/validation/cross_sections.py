r"""Scattering cross sections over frequency, compared with series obtained by separation of variables.

Each scattered field is a sum over orders n of outgoing waves with factors :math:`A_n` that follow from the condition on
the face of the scatterer. With :math:`\varepsilon_0 = 1` and :math:`\varepsilon_n = 2` the cross section of a cylinder
is :math:`\frac{4}{k} \sum \varepsilon_n |A_n|^2`, and by the optical theorem
:math:`-\frac{4}{k} \sum \varepsilon_n \mathrm{Re} A_n`.

- A soft and a rigid cylinder of radius a: :math:`A_n = -J_n(ka)/H_n(ka)`, with derivatives for the rigid one.
- A cavity in a solid with incident P waves (Pao and Mow, 1973, chapter 3): potentials of P and S waves with factors
  :math:`A_n` and :math:`B_n` that make the normal and the shear stress on its face vanish; :math:`|B_n|^2` is added to
  :math:`|A_n|^2`.
- A crack with normally incident scalar waves: Mathieu functions of an elliptic cylinder of zero thickness,
  :math:`\frac{8}{k} \sum |A_n|^2 \mathrm{se}_n(\pi/2)^2` with the derivatives of the radial functions on the crack,
  :math:`A_n = -Ms_n^{(1)\prime}(0) / Ms_n^{(3)\prime}(0)` (Bowman, Senior and Uslenghi, 1969, chapter 4).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy import special

from farhorizon import (
    Box,
    Disc,
    Elastic,
    FarField,
    IncidentWave,
    Kernel,
    Lattice,
    LatticePML,
    Prescribed,
    Simulation,
    Wave,
)
from farhorizon.studies.collection import Outcome, Row
from farhorizon.validation import validation

SERIES = "Bowman, Senior, Uslenghi (1969), Electromagnetic and Acoustic Scattering"
CAVITY = "Pao, Mow (1973), Diffraction of Elastic Waves"
RADIUS = 2.0
FREQUENCIES = np.linspace(0.06, 0.16, 21)
SPACINGS = (0.25, 0.125)
UNTIL = 200.0
TITLES = {"soft": "soft cylinder", "rigid": "rigid cylinder", "crack": "crack", "cavity": "cavity, P waves"}
ORDERS = np.arange(31)
EVEN = np.where(ORDERS == 0, 1.0, 2.0)  # epsilon_n


def solid(spacing: float) -> Elastic:
    """Bond-based solid."""
    return Elastic(Kernel(2 * spacing, exponent=1), young=1.0, density=1.0)


P_SPEED, S_SPEED = solid(1.0).p_speed, solid(1.0).s_speed


def cylinder(frequency: float, rigid: bool) -> np.ndarray:
    """Factors of a cylinder for scalar waves of speed 1."""
    x = 2 * np.pi * frequency * RADIUS
    inner, outer = (special.jvp, special.h1vp) if rigid else (special.jv, special.hankel1)
    return np.asarray(-inner(ORDERS, x) / outer(ORDERS, x))


def cavity(frequency: float) -> tuple[np.ndarray, np.ndarray]:
    """Factors of the P and S waves that a cavity scatters from incident P waves."""
    p, s = (2 * np.pi * frequency * RADIUS / c for c in (P_SPEED, S_SPEED))
    n, bend = ORDERS, ORDERS**2 + ORDERS - s**2 / 2

    def pressed(z: Callable[..., Any]) -> list[np.ndarray]:
        """Normal and shear stress of a P wave, multiplied by a^2 / (2 mu)."""
        return [bend * z(n, p) - p * z(n - 1, p), n * ((n + 1) * z(n, p) - p * z(n - 1, p))]

    outer = special.hankel1
    sheared = [n * (s * outer(n - 1, s) - (n + 1) * outer(n, s)), s * outer(n - 1, s) - bend * outer(n, s)]
    matrix = np.moveaxis(np.array([pressed(outer), sheared]), (0, 1), (2, 1))  # order, stress, wave
    amplitudes = np.linalg.solve(matrix, -np.array(pressed(special.jv)).T[..., None])[..., 0]
    return amplitudes[:, 0], amplitudes[:, 1]


def crack(frequency: float) -> np.ndarray:
    """``|A_n|^2 se_n(pi/2)^2`` of a free crack of half length a for scalar waves of speed 1, for odd orders."""
    q = (np.pi * frequency * RADIUS) ** 2
    terms = []
    for n in range(1, 20, 2):
        first, second = (radial(n, q, 0.0)[1] for radial in (special.mathieu_modsem1, special.mathieu_modsem2))
        terms.append(abs(first / (first + 1j * second)) ** 2 * special.mathieu_sem(n, q, 90.0)[0] ** 2)
    return np.array(terms)


def exact(kind: str) -> np.ndarray:
    """Exact cross sections at the frequencies."""
    k = 2 * np.pi * FREQUENCIES
    if kind == "crack":
        return 8 / k * np.array([crack(f).sum() for f in FREQUENCIES])
    if kind == "cavity":
        squares = [(np.abs(cavity(f)) ** 2).sum(0) for f in FREQUENCIES]
        return np.asarray(4 / k * P_SPEED * (np.array(squares) @ EVEN))
    return np.asarray(4 / k * (np.array([np.abs(cylinder(f, kind == "rigid")) ** 2 for f in FREQUENCIES]) @ EVEN))


def run(kind: str, spacing: float) -> FarField:
    """Far field of the scattered wave of a burst that contains all frequencies."""
    far = FarField(frequencies=FREQUENCIES, history=False)
    disc, everywhere = Disc(RADIUS), Box((-99.0, -99.0), (99.0, 99.0))
    shape = everywhere - disc if kind in ("rigid", "cavity") else None
    # the crack and its tips lie half-way between nodes
    corner = 7.0 + (spacing / 2 if kind == "crack" else 0.0)
    sim = Simulation(
        Lattice(spacing, (-corner, -corner), (corner, corner), body=shape),
        solid(spacing) if kind == "cavity" else Wave(Kernel(2 * spacing)),
        LatticePML(nodes=20),
        sources=[IncidentWave((1.0, 0.0), "sin(2*pi*(t-24)/9)*exp(-((t-24)/5)**2)", duration=48.0)],
        constraints=[Prescribed(disc, 0.0)] if kind == "soft" else [],
        cracks=[[(0.0, -RADIUS), (0.0, RADIUS)]] if kind == "crack" else [],
        observe=[far],
    )
    sim.run(UNTIL, progress=False)
    return far


def compared(folder: Path, name: str, kinds: tuple[str, ...]) -> Outcome:
    """Compare each kind of scatterer at both spacings with the exact cross section."""
    from farhorizon.pictures.curves import curve_panels

    rows, panels = [], []
    for kind in kinds:
        sections, errors, balances = exact(kind), [], []
        lengths = 2 * np.pi * FREQUENCIES * RADIUS / (P_SPEED if kind == "cavity" else 1.0)
        curves = [("exact", lengths, sections / (2 * RADIUS))]
        for spacing in SPACINGS:
            scattering, total = run(kind, spacing).cross_sections()
            errors.append(float(np.abs(total / sections - 1).max()))
            balances.append(float(np.abs(scattering / total - 1).max()))
            curves.append((f"spacing a/{RADIUS / spacing:g}", lengths, total / (2 * RADIUS)))
            rows.append(Row(f"{kind}: largest error over frequency, spacing {spacing:g}", errors[-1]))
        rows.append(Row(f"{kind}: order in the spacing", float(np.log2(errors[0] / errors[1])), 1.0))
        rows.append(Row(f"{kind}: scattered over lost energy less 1, at most", max(balances)))
        panels.append((TITLES[kind], curves))
    picture = folder / f"{name}.png"
    curve_panels(panels, picture, xlabel="ka", ylabel="cross section / 2a")
    return Outcome(rows, pictures=[picture])


@validation("cylinders", SERIES, "cross sections of a soft and of a rigid cylinder over frequency", "ten seconds")
def cylinders(folder: Path) -> Outcome:
    """The soft cylinder consists of nodes held at zero, the rigid one is a hole."""
    return compared(folder, "cylinders", ("soft", "rigid"))


@validation("crack-scattering", SERIES, "cross section of a crack over frequency", "ten seconds")
def crack_scattering(folder: Path) -> Outcome:
    """Scalar waves, such as out-of-plane shear waves."""
    return compared(folder, "crack-scattering", ("crack",))


@validation("cavity", CAVITY, "cross section of a cylindrical cavity in a solid over frequency", "half a minute")
def cavity_scattering(folder: Path) -> Outcome:
    """P waves, which are scattered as P and S waves."""
    return compared(folder, "cavity", ("cavity",))

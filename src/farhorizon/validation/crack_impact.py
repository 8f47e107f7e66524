r"""Edge crack beside which a projectile hits the edge: stress intensity factors until the first echo.

The half-plane x > 0 has a crack of length l that extends from its edge along y = 0. At t = 0 a projectile hits the edge
below the crack, at y < 0, and gives it the inward velocity :math:`v_0`; it is frictionless and covers the whole edge
below the crack. Until P waves have travelled to the tip, back to the edge and to the tip again, at :math:`t = 3l/c_P`,
the tip cannot distinguish the edge above the crack from the middle of a plane in which the crack continues, nor the
projectile from the mirror image of the body that it hits. K is therefore that of a crack in the infinite plane beside a
gap on the half-line x = 0, y < 0 that opens by :math:`2v_0t`. It is the problem of Lee and Freund (1990, J. Appl. Mech.
57, 104), a model of the experiment of Kalthoff and Winkler.

By reciprocity, K is the integral over the gap of its opening times the stress :math:`\sigma_{xx}` of Bueckner's weight
field, which is that of an unloaded half-plane crack whose faces move as :math:`r^{-1/2}` at the tip. In terms of the
Laplace variable s the displacements of its faces are (Freund, 1990, Dynamic fracture mechanics, chapters 2 and 3)

.. math:: u^\pm = \pm\frac{\sqrt{2s}}{2}\frac{1}{2\pi i} \int_{-i\infty}^{i\infty} F(\zeta)\,e^{s\zeta x}\,d\zeta,
   \qquad F = \frac{\sqrt{\gamma - \zeta}}{(c - \zeta)\,S(-\zeta)} ,

normal to the crack with :math:`\gamma = a` in mode I and along it with :math:`\gamma = b` in mode II, where a, b and c
are the slownesses of P, S and Rayleigh waves, and with :math:`R(\zeta) = (b^2 - 2\zeta^2)^2 + 4\zeta^2AB`,
:math:`A = \sqrt{a^2 - \zeta^2}`, :math:`B = \sqrt{b^2 - \zeta^2}`,

.. math:: \frac{R}{2(b^2 - a^2)(c^2 - \zeta^2)} = S(\zeta)\,S(-\zeta), \qquad \ln S(\zeta) = -\frac1\pi \int_a^b
   \arctan\frac{4w^2\sqrt{(w^2 - a^2)(b^2 - w^2)}}{(b^2 - 2w^2)^2}\,\frac{dw}{w + \zeta} .

Each of its waves decays exponentially away from the crack, so that the integral over the gap is elementary. Since the
gap begins on the line of the crack, so is the inverse Laplace transform:

.. math:: K(t) = -\frac{2\sqrt2\mu v_0}{\pi\sqrt\pi}\,\mathrm{Im}\int_0^{t/l} \sqrt{t - \zeta l}\;F\,H\,d\zeta, \qquad
   H_I = \frac{b^2 - 2a^2}{A^2}, \quad
   H_{II} = \frac{2\zeta}{b^2}\left(\frac{b^2 - 2a^2 + 2\zeta^2}{A} + \frac{b^2 - 2\zeta^2}{B}\right) ,

on a path through the upper half-plane. Both factors are negative: the wave presses the faces together, and the lower
face moves forward.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from farhorizon import Elastic, Kernel, Lattice, LatticePML, Polyline, Simulation, Source, StressIntensity
from farhorizon.studies.collection import Outcome, Row
from farhorizon.validation import validation

IMPACT = "Lee, Freund (1990), Fracture initiation due to asymmetric impact loading of an edge cracked plate"
LENGTH = 1.0  # length l of the crack
SHEAR = 1.0  # shear modulus; the density is also 1, and so is the speed of S waves
P_SPEED = np.sqrt(3.0)
RISE = 0.5 * LENGTH / P_SPEED  # time in which the velocity of the projectile rises to v0 = 1
ECHO = 3 * LENGTH / P_SPEED
DEEP = 3.0  # length of the gap: waves from its lower end arrive after the echo
SPACINGS = (0.0125, 0.00625)
RECORDS = 121  # number of times at which K is computed
NEAR = 1.2 * LENGTH / P_SPEED  # time after which K is compared


@cache
def slownesses() -> tuple[float, float, float]:
    """Slownesses of P, S and Rayleigh waves."""
    return 1 / P_SPEED, 1.0, float(np.sqrt(0.75 + np.sqrt(3) / 4))  # the root of R for a Poisson's ratio of 1/4


def smooth_factor(zeta: np.ndarray) -> np.ndarray:
    """S(zeta) for zeta in the right half-plane."""
    a, b, _ = slownesses()
    count = 100
    cosine = np.cos((2 * np.arange(count) + 1) * np.pi / (2 * count))
    w = (a + b + (b - a) * cosine) / 2
    angle = np.arctan2(4 * w**2 * np.sqrt((w**2 - a**2) * (b**2 - w**2)), (b**2 - 2 * w**2) ** 2)
    weights = angle * np.sqrt(1 - cosine**2) * (b - a) / (2 * count)
    return np.asarray(np.exp(-sum(part / (zeta + place) for part, place in zip(weights, w, strict=True))))


def step_intensities(t: np.ndarray) -> np.ndarray:
    """K_I and K_II at times t if the velocity of the edge jumps to 1; shape (2, n)."""
    a, b, c = slownesses()
    nodes, weights = np.polynomial.legendre.leggauss(120)
    part, weights = (1 - nodes) / 2, weights / 2
    start, end = a / 2, np.maximum(np.asarray(t, float), a * LENGTH)[:, None] / LENGTH
    # on half a circle; the square substitution removes the root singularity at its end
    way = np.exp(1j * np.pi * part**2)
    zeta = (start + end) / 2 + (end - start) / 2 * way
    step = weights * (end - start) / 2 * -2j * np.pi * part * way
    roots = {s: (np.sqrt(s - zeta), np.sqrt(s + zeta)) for s in (a, b)}
    p, q = roots[a][0] * roots[a][1], roots[b][0] * roots[b][1]
    rayleigh = (b**2 - 2 * zeta**2) ** 2 + 4 * zeta**2 * p * q
    # 1 / ((c - zeta) S(-zeta)) from R, because S itself is smooth only in the right half-plane
    common = 2 * (b**2 - a**2) * (c + zeta) * smooth_factor(zeta) / rayleigh
    opened = roots[a][0] * (b**2 - 2 * a**2) / p**2
    slid = roots[b][0] * 2 * zeta / b**2 * ((b**2 - 2 * a**2 + 2 * zeta**2) / p + (b**2 - 2 * zeta**2) / q)
    late = np.sqrt((end - zeta) * LENGTH)
    factor = -2 * np.sqrt(2 / np.pi) * SHEAR / np.pi * late * common * step
    return np.array([(factor * mode).sum(1).imag for mode in (opened, slid)])


def intensities(t: np.ndarray) -> np.ndarray:
    """K_I and K_II at times t if the velocity of the edge rises smoothly to 1; shape (2, n)."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    s = (nodes + 1) * RISE / 2
    rate = weights * (1 - np.cos(2 * np.pi * s / RISE)) / 2
    late = np.subtract.outer(np.asarray(t, float), s)
    return step_intensities(late.ravel()).reshape(2, *late.shape) @ rate


def gap(t: float) -> float:
    """Opening of the gap: twice the displacement of the edge."""
    part = min(t / RISE, 1.0)
    rising = part**2 / 2 - (1 - np.cos(2 * np.pi * part)) / (4 * np.pi**2)
    return float(2 * (RISE * rising + max(t - RISE, 0.0)))


def hit(spacing: float) -> StressIntensity:
    """K of the crack in a bond-based solid; forces at the ends of the bonds across the gap impose its opening."""
    # the gap and the crack run between nodes
    lower = (-LENGTH - 0.3 + spacing / 2, -DEEP - 0.1 + spacing / 2)
    lattice = Lattice(spacing, lower, (2 * LENGTH - spacing / 2, LENGTH - spacing / 2))
    model = Elastic(Kernel(2 * spacing, exponent=1), shear=SHEAR)
    crack, opened = Polyline([(-LENGTH, 0.0), (LENGTH, 0.0)]), Polyline([(0.0, -DEEP), (0.0, 0.0)])
    stencil = model.stencil(spacing, 2)
    force, start = np.zeros((2, *lattice.shape)), np.stack(lattice.coordinates(), axis=-1)
    for offset, weight in zip(stencil.offsets, stencil.weights, strict=True):
        nodes = opened.cuts(start, start + spacing * offset) & ~crack.cuts(start, start + spacing * offset)
        force[:, nodes] -= (np.sign(offset[0]) * weight[:, 0] * model.p_modulus / spacing**2)[:, None]
    intensity = StressIntensity([(LENGTH, 0.0)], radii=(0.4 * LENGTH, 0.8 * LENGTH))
    sources = [Source(force, time=gap)]
    Simulation(lattice, model, LatticePML(nodes=20), sources=sources, cracks=[crack], observe=[intensity]).run(
        ECHO, progress=False
    )
    return intensity


@validation("kalthoff", IMPACT, "a projectile hits the edge beside an edge crack: K_I and K_II to the echo", "a minute")
def kalthoff(folder: Path) -> Outcome:
    """Both stress intensity factors, starting before the first wave reaches the tip."""
    from farhorizon.pictures.curves import curve_panels
    from farhorizon.pictures.words import in_words

    rows, errors = [], []
    for spacing in SPACINGS:
        intensity = hit(spacing)
        some = np.linspace(0, len(intensity.times) - 1, RECORDS).round().astype(int)
        times, computed = intensity.times[some], np.array([intensity.data[mode][some, 0] for mode in ("K_I", "K_II")])
        exact = intensities(times)
        apart = np.abs(computed - exact)[:, times > NEAR].max(1) / np.abs(exact).max(1)
        errors.append(apart)
        rows += [
            Row(f"{mode}: largest difference, of the largest, spacing {spacing:g} l", float(error))
            for mode, error in zip(("K_I", "K_II"), apart, strict=True)
        ]
    rows += [
        Row(f"{mode}: order in the spacing", float(np.log2(coarse / fine)), 1.0, note="the tip lies between nodes")
        for mode, coarse, fine in zip(("K_I", "K_II"), *errors, strict=True)
    ]
    for way in (2.0, 3.0):
        at = int(np.argmin(np.abs(times - way * LENGTH / P_SPEED)))
        rows += [
            Row(f"{mode} over the exact one at t = {way:g} l/c_P", float(computed[i, at] / exact[i, at]), 1.0)
            for i, mode in enumerate(("K_I", "K_II"))
        ]
    unit = SHEAR / P_SPEED * np.sqrt(LENGTH / np.pi)
    way = times * P_SPEED / LENGTH
    panels = [
        (in_words(mode), [("exact", way, exact[i] / unit), ("computed", way, computed[i] / unit)])
        for i, mode in enumerate(("K_I", "K_II"))
    ]
    picture = folder / "kalthoff.png"
    curve_panels(panels, picture, xlabel="$c_P t / l$", ylabel=r"$K c_P / (\mu v_0) \; \sqrt{\pi / l}$")
    return Outcome(rows, pictures=[picture])

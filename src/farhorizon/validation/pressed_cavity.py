r"""Spherical cavity in an infinite solid under a permanent pressure: the wave and the static field.

Under a pressure p that is applied suddenly the displacement is radial,

.. math:: u_r = -\frac{\dot F(T)}{c r} - \frac{F(T)}{r^2}, \quad T = t - \frac{r - a}{c}, \quad
   F = -\frac{p\,a}{\rho(\alpha^2 + \omega^2)}\left[1 - e^{-\alpha T}\left(\cos\omega T +
   \frac{\alpha}{\omega}\sin\omega T\right)\right],

with :math:`\alpha = \frac{c}{a}\frac{1 - 2\nu}{1 - \nu}` and
:math:`\omega = \frac{c}{a}\frac{\sqrt{1 - 2\nu}}{1 - \nu}` (Sharpe, 1942, Geophysics 7, 144; Blake, 1952, J. Acoust.
Soc. Am. 24, 211), and eventually :math:`p\,a^3/(4\mu r^2)`. Here the pressure rises smoothly, which is a superposition
of such steps.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from farhorizon import Ball, Box, Elastic, Kernel, Lattice, LatticePML, Pressure, Simulation, Step
from farhorizon.studies.collection import Outcome, Row
from farhorizon.validation import validation
from farhorizon.validation.explosion import against_exact

SHARPE = "Sharpe (1942), The production of elastic waves by explosion pressures"
RADIUS = 1.0
RISE = 1.0  # time in which the pressure rises to 1
PRESSURE = Step(RISE)
HALF = 2.25  # half width of the near field
NEAREST = 1.5  # smallest distance at which the field is compared: a horizon of the coarse lattice beyond the rim
SPACINGS = (1 / 6, 1 / 12)
PASSING, STATIC = 2.5, 16.0


def exact(r: np.ndarray, t: float, model: Elastic, radius: float) -> np.ndarray:
    """Radial displacement at the distances r, shape (n,), around a cavity of this radius."""
    speed, ratio = model.p_speed, 1 - 2 * model.poisson
    decay, frequency = speed / radius * np.array([ratio, np.sqrt(ratio)]) / (1 - model.poisson)
    nodes, weights = np.polynomial.legendre.leggauss(80)
    began = np.clip(t - (r - radius) / speed, 0.0, RISE)[:, None] / 2  # steps that have arrived at r
    steps = (nodes + 1) * began
    share_of = weights * began * (1 - np.cos(2 * np.pi * steps / RISE)) / RISE  # rate of the pressure
    late = t - (r[:, None] - radius) / speed - steps
    fading = np.exp(-decay * late)
    size = -radius / (model.density * (decay**2 + frequency**2))
    moment = size * (1 - fading * (np.cos(frequency * late) + decay / frequency * np.sin(frequency * late)))
    rate = size * fading * np.sin(frequency * late) * (frequency + decay**2 / frequency)
    return np.asarray((share_of * (-rate / (speed * r[:, None]) - moment / r[:, None] ** 2)).sum(1))


def solid(spacing: float) -> Elastic:
    """Correspondence solid: of all materials it has the stiffest faces."""
    kernel = Kernel(1.5 * spacing, exponent=1)
    return Elastic(kernel, young=1.0, poisson=0.3, material="correspondence", stabilisation=0.5)


def run(spacing: float) -> tuple[Simulation, float]:
    """Simulation before its first step, and radius of a ball with the volume of the hole in the lattice."""
    half = (round(HALF / spacing) - 0.5) * spacing
    hole = Ball(RADIUS)
    lattice = Lattice(spacing, (-half,) * 3, (half,) * 3, body=Box((-2 * HALF,) * 3, (2 * HALF,) * 3) - hole)
    missing = hole.contains(np.stack(lattice.coordinates(), -1)).sum()
    sim = Simulation(
        lattice, solid(spacing), LatticePML(target=1e-3, until=STATIC), loads=[Pressure(hole, 1.0, time=PRESSURE)]
    )
    return sim, float(spacing * (0.75 / np.pi * missing) ** (1 / 3))


@validation("pressed-cavity", SHARPE, "a spherical cavity that is pressed open, to the static limit", "a minute")
def pressed_cavity(folder: Path) -> Outcome:
    """The solid is a correspondence material, and the rim of the cavity is a staircase."""
    from farhorizon.pictures.curves import curve_panels

    runs = []
    for spacing in SPACINGS:
        sim, radius = run(spacing)
        runs.append((f"a/{RADIUS / spacing:.3g}", sim, partial(exact, model=solid(spacing), radius=radius)))
    rows, panels = against_exact(runs, (PASSING, STATIC), 1.0, "the rim is a staircase", NEAREST)
    _, r, computed = panels[-1][1][-1]
    static = radius**3 / (4 * solid(1.0).shear * r**2)
    rows.append(Row("static displacement over p a^3/(4 mu r^2), mean", float((computed / static).mean()), 1.0))
    picture = folder / "pressed-cavity.png"
    curve_panels(panels, picture, xlabel="distance", ylabel="radial displacement")
    return Outcome(rows, pictures=[picture])

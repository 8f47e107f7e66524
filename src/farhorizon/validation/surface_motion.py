r"""Waves at the free surface of a half-space, from a source below it: Garvin's problem.

At the depth h below the surface z = 0 of a half-plane a line of charges goes off, the body force
:math:`b = -M(t)\,\nabla\delta`. Its P wave and what the surface sends back are sums of plane waves
:math:`e^{s(ipx - ah)}` of slowness p, with :math:`a = \sqrt{p^2 + \alpha^{-2}}`,
:math:`b = \sqrt{p^2 + \beta^{-2}}` and the Rayleigh function :math:`R = (p^2 + b^2)^2 - 4p^2ab`.
In Laplace's s the surface is displaced by

.. math:: \begin{pmatrix} \bar u_x \\ \bar u_z \end{pmatrix} = \frac{s\bar M}{4\pi\rho\alpha^2\beta^2}
   \int_{-\infty}^\infty \frac{2}{R} \begin{pmatrix} -2ipb \\ p^2 + b^2 \end{pmatrix} e^{s(ipx - ah)}\,dp ,

z and :math:`u_z` upwards. On the path on which :math:`ah - ipx = t` is real,

.. math:: p = \frac{ixt + h\sqrt{t^2 - r^2/\alpha^2}}{r^2}, \qquad r^2 = x^2 + h^2 ,

the integral is a Laplace transform by inspection, and the displacement is :math:`\dot M` convolved with twice the real
part of the integrand times :math:`dp/dt` (Garvin, 1956, by the method of Cagniard and de Hoop). With
:math:`t = (r/\alpha)\cosh\theta` it is smooth. For good it is :math:`4(1 - \nu)` times that of the infinite solid.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from farhorizon.boundaries import Free, LatticePML
from farhorizon.geometry.lattice import Lattice
from farhorizon.inputs.local_sources import MomentTensor
from farhorizon.inputs.signals import Step
from farhorizon.medium.kernel import Kernel
from farhorizon.models import Elastic
from farhorizon.simulation.receivers import Receivers
from farhorizon.simulation.simulation import Simulation
from farhorizon.studies.collection import Outcome, Row
from farhorizon.validation.validations import validation

BLAST = "Garvin (1956), Exact transient solution of the buried line source problem"
DEPTH = 1.0  # of the charge
RISE = 1.0  # time in which its moment rises to 1; S waves run a depth in it
PLACES = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0)  # along the surface, from the point above it
MARGIN = 0.6  # of the near field around them
UNTIL = 8.0
SPACINGS = (0.05, 0.025)  # 20 and 40 nodes on the way of S waves in the rise
#: Rows of nodes below a free surface, which is half a spacing above the first, and what extrapolates them to it.
SURFACE = np.array([15.0, -10.0, 3.0]) / 8


def solid(spacing: float) -> Elastic:
    """Of Poisson's ratio 1/4, with S waves of speed 1 and density 1; its surfaces are of second order."""
    kernel = Kernel(1.5 * spacing, exponent=2)
    return Elastic(kernel, shear=1.0, poisson=0.25, material="correspondence", stabilisation=0.8)


def buried_blast(x: float, times: np.ndarray, speeds: tuple[float, float], density: float) -> np.ndarray:
    """Horizontal and upward displacement of the surface at the distance x, shape (2, n), from the speeds of P and S
    waves.
    """
    alpha, beta = speeds
    distance = np.hypot(x, DEPTH)
    nodes, weights = np.polynomial.legendre.leggauss(800)

    def angle(t: np.ndarray) -> np.ndarray:
        return np.arccosh(np.maximum(1.0, t * alpha / distance))[:, None]

    first, last = angle(times - RISE), angle(times)
    theta = first + (last - first) * (nodes + 1) / 2
    t, root = distance / alpha * np.cosh(theta), distance / alpha * np.sinh(theta)
    p, dp = (1j * x * t + DEPTH * root) / distance**2, (1j * x * root + DEPTH * t) / distance**2
    a, b = (np.sqrt(p**2 + 1 / speed**2) for speed in (alpha, beta))
    bend = p**2 + b**2
    factor = 2 * dp / (bend**2 - 4 * p**2 * a * b)
    rate = (1 - np.cos(2 * np.pi * (times[:, None] - t) / RISE)) / RISE
    amount = rate * weights * (last - first) / 2 / (4 * np.pi * density * (alpha * beta) ** 2)
    return np.array([(amount * 2 * (factor * part).real).sum(1) for part in (-2j * p * b, bend)])


def run_blast(spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Times, and displacements of the surface at the places, shape (places, 2, times)."""
    top = -spacing / 2
    rows = top - spacing * np.arange(len(SURFACE))
    points = [(x, z) for x in PLACES for z in rows]
    surface = Receivers(points, interpolation="linear")
    lattice = Lattice(spacing, (-MARGIN, top - DEPTH - MARGIN), (PLACES[-1] + MARGIN, top))
    sides = {"all": LatticePML(nodes=24), "y+": Free()}
    charge = MomentTensor((0.0, -DEPTH), 1.0, Step(RISE))
    Simulation(lattice, solid(spacing), sides, sources=[charge], observe=[surface]).run(UNTIL, progress=False)
    found = surface.data["u"].reshape(-1, len(PLACES), len(SURFACE), 2)
    return surface.times, np.einsum("tprc,r->pct", found, SURFACE)


@validation("garvin", BLAST, "the surface of a half-space above a buried line of charges", "ten seconds")
def garvin(folder: Path) -> Outcome:
    """All waves at the surface: P, the S waves that it becomes, and Rayleigh waves."""
    from farhorizon.pictures.curves import curve_panels

    rows, errors, model = [], [], solid(1.0)
    for spacing in SPACINGS:
        times, found = run_blast(spacing)
        wanted = np.array([buried_blast(x, times, (model.p_speed, model.s_speed), model.density) for x in PLACES])
        apart = np.abs(found - wanted).max((1, 2)) / np.abs(wanted).max((1, 2))
        errors.append(float(apart.max()))
        rows.append(Row(f"largest difference, of the largest value at its place, spacing {spacing:g} h", errors[-1]))
    rows.append(Row("order in the spacing", float(np.log2(errors[0] / errors[1])), 2.0))
    panels = [
        (f"x = {x:g} h", [("exact", times, wanted[i, 1]), ("computed", times, found[i, 1])])
        for i, x in enumerate(PLACES)
        if x in (0.0, 1.0, 2.0, 4.0)
    ]
    picture = folder / "garvin.png"
    curve_panels(panels, picture, xlabel="t beta / h", ylabel="upward displacement")
    return Outcome(rows, pictures=[picture])

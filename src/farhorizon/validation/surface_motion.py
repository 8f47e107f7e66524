r"""Waves at the free surface of a half-space, from a source below it and from a source on it.

Garvin's problem. A line of charges explodes at the depth h below the surface z = 0 of a half-plane, which is the body
force :math:`b = -M(t)\,\nabla\delta`. Its P wave and the waves that the surface reflects are sums of plane waves
:math:`e^{s(ipx - ah)}` of slowness p, with :math:`a = \sqrt{p^2 + \alpha^{-2}}`, :math:`b = \sqrt{p^2 + \beta^{-2}}`
and the Rayleigh function :math:`R = (p^2 + b^2)^2 - 4p^2ab`. In terms of the Laplace variable s the displacement of the
surface is

.. math:: \begin{pmatrix} \bar u_x \\ \bar u_z \end{pmatrix} = \frac{s\bar M}{4\pi\rho\alpha^2\beta^2}
   \int_{-\infty}^\infty \frac{2}{R} \begin{pmatrix} -2ipb \\ p^2 + b^2 \end{pmatrix} e^{s(ipx - ah)}\,dp ,

with z and :math:`u_z` upwards. On the path on which :math:`ah - ipx = t` is real,

.. math:: p = \frac{ixt + h\sqrt{t^2 - r^2/\alpha^2}}{r^2}, \qquad r^2 = x^2 + h^2 ,

the integral is a Laplace transform by inspection, and the displacement is :math:`\dot M` convolved with twice the real
part of the integrand times :math:`dp/dt` (Garvin, 1956, by the method of Cagniard and de Hoop). The substitution
:math:`t = (r/\alpha)\cosh\theta` makes the integrand smooth. The static displacement is :math:`4(1 - \nu)` times that
in the infinite solid.

Lamb's problem. The force :math:`P(t)` presses on a point of the surface of a half-space in three dimensions. For
Poisson's ratio 1/4, a step of it displaces the surface at the distance r by :math:`\frac{P}{\mu r}\,G(\beta t/r)`,
where G is algebraic between the arrivals of P, S and Rayleigh waves, the last at :math:`q_R = \sqrt{3/4 + \sqrt3/4}`
(Pekeris, 1955): see `pressed_step`. The substitution :math:`q = q_R - v^2` removes its root singularity before
:math:`q_R`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from farhorizon import Elastic, Free, Kernel, Lattice, LatticePML, MomentTensor, Receivers, Simulation, Source, Step
from farhorizon.studies.collection import Outcome, Row
from farhorizon.validation import validation

BLAST = "Garvin (1956), Exact transient solution of the buried line source problem"
DEPTH = 1.0  # of the charges, h
RISE = 1.0  # time in which their moment rises to 1, and S waves travel the distance h
PLACES = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0)  # x of the receivers on the surface; x = 0 is above the charges
MARGIN = 0.6  # of the near field around charges and receivers
UNTIL = 8.0
SPACINGS = (0.05, 0.025)  # S waves travel 20 and 40 nodes during the rise
#: Weights that extrapolate the first rows of nodes to the free surface, which is half a spacing above the first row.
SURFACE = np.array([15.0, -10.0, 3.0]) / 8


def solid(kernel: Kernel, stabilisation: float) -> Elastic:
    """Solid with Poisson's ratio 1/4, S wave speed 1 and density 1, whose free surfaces are of second order."""
    return Elastic(kernel, shear=1.0, poisson=0.25, material="correspondence", stabilisation=stabilisation)


def rising(t: np.ndarray) -> np.ndarray:
    """Rate of the load at times during its rise."""
    return (1 - np.cos(2 * np.pi * t / RISE)) / RISE


def buried_blast(x: float, times: np.ndarray, speeds: tuple[float, float], density: float) -> np.ndarray:
    """Exact horizontal and upward displacement of the surface at the distance x, shape (2, n); `speeds` are those of P
    and S waves.
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
    amount = rising(times[:, None] - t) * weights * (last - first) / 2 / (4 * np.pi * density * (alpha * beta) ** 2)
    return np.array([(amount * 2 * (factor * part).real).sum(1) for part in (-2j * p * b, bend)])


def run_blast(spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Times, and displacements of the surface at PLACES, shape (places, 2, times)."""
    top = -spacing / 2
    rows = top - spacing * np.arange(len(SURFACE))
    points = [(x, z) for x in PLACES for z in rows]
    surface = Receivers(points, interpolation="linear")
    lattice = Lattice(spacing, (-MARGIN, top - DEPTH - MARGIN), (PLACES[-1] + MARGIN, top))
    sides = {"all": LatticePML(nodes=24), "y+": Free()}
    charge = MomentTensor((0.0, -DEPTH), 1.0, Step(RISE))
    model = solid(Kernel(1.5 * spacing, exponent=2), 0.8)
    Simulation(lattice, model, sides, sources=[charge], observe=[surface]).run(UNTIL, progress=False)
    recorded = surface.data["u"].reshape(-1, len(PLACES), len(SURFACE), 2)
    return surface.times, np.einsum("tprc,r->pct", recorded, SURFACE)


@validation("garvin", BLAST, "the surface of a half-space above a buried line of charges", "ten seconds")
def garvin(folder: Path) -> Outcome:
    """All waves at the surface: P waves, the S waves converted from them, and Rayleigh waves."""
    from farhorizon.pictures.curves import curve_panels

    rows, errors = [], []
    for spacing in SPACINGS:
        times, computed = run_blast(spacing)
        exact = np.array([buried_blast(x, times, (np.sqrt(3.0), 1.0), 1.0) for x in PLACES])
        apart = np.abs(computed - exact).max((1, 2)) / np.abs(exact).max((1, 2))
        errors.append(float(apart.max()))
        rows.append(Row(f"largest difference, of the largest value at its place, spacing {spacing:g} h", errors[-1]))
    rows.append(Row("order in the spacing", float(np.log2(errors[0] / errors[1])), 2.0))
    panels = [
        (f"$x = {x:g}\\,h$", [("exact", times, exact[i, 1]), ("computed", times, computed[i, 1])])
        for i, x in enumerate(PLACES)
        if x in (0.0, 1.0, 2.0, 4.0)
    ]
    picture = folder / "garvin.png"
    curve_panels(panels, picture, xlabel=r"$\beta t / h$", ylabel="upward displacement")
    return Outcome(rows, pictures=[picture])


LAMB = "Pekeris (1955), The seismic surface pulse"
AWAY = 1.0  # distance along the surface from the load, which S waves travel during the rise
PRESSED = 2.4  # end of the run
ROOT = np.sqrt(3.0)
RAYLEIGH = float(np.sqrt(0.75 + ROOT / 4))  # slowness of Rayleigh waves over that of S waves


def pressed_step(q: np.ndarray) -> np.ndarray:
    """G at times q, in units of the travel time of S waves."""
    square = np.asarray(q, float) ** 2

    def root(constant: float, distance: np.ndarray) -> np.ndarray:
        return np.sqrt(constant / np.where(distance > 0, distance, 1.0))

    late = root(3 * ROOT + 5, RAYLEIGH**2 - square)
    early = 6 - root(3.0, square - 0.25) - late + root(3 * ROOT - 5, square + ROOT / 4 - 0.75)
    parts = [square <= 1 / 3, square <= 1, square < RAYLEIGH**2]
    return np.select(parts, [0 * square, early / (32 * np.pi), (6 - late) / (16 * np.pi)], 3 / (8 * np.pi))


def pressed(r: float, times: np.ndarray) -> np.ndarray:
    """Exact displacement of the surface along the force at the distance r, for unit force, shear modulus and S wave
    speed."""
    nodes, weights = np.polynomial.legendre.leggauss(200)
    part, weights = (1 - nodes) / 2, weights / 2
    displacement = np.zeros(len(times))
    for start, end in ((1 / ROOT, 1.0), (1.0, RAYLEIGH), (RAYLEIGH, np.inf)):
        first = np.maximum(start, (times - RISE) / r)[:, None]
        last = np.maximum(np.minimum(end, times / r)[:, None], first)
        # the points are denser towards the end, where the integrand has a root singularity
        q = last - (last - first) * part**2
        step = (last - first) * 2 * part * weights
        displacement += (rising(times[:, None] - r * q) * pressed_step(q) * step).sum(1)
    return displacement


def run_pressed(spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Times, and computed displacement of the surface along the force."""
    wide, top = round(0.25 / spacing) * spacing, -spacing / 2
    rows = top - spacing * np.arange(len(SURFACE))
    surface = Receivers([(AWAY, 0.0, z) for z in rows], interpolation="linear")
    lattice = Lattice(spacing, (-wide, -wide, top - 1.6 * wide), (AWAY + wide, wide, top))
    force = np.zeros((3, *lattice.shape))
    # by reciprocity, the weights that extrapolate the field to the surface also represent a force on it
    force[(2, *lattice.index((0.0, 0.0, top))[:2])][-1 : -1 - len(SURFACE) : -1] = -SURFACE / spacing**3
    sides = {"all": LatticePML(nodes=10), "z+": Free()}
    model = solid(Kernel(spacing, exponent=0), 4 / 9)  # cancels the second-order dispersion of S waves
    source = Source(force, time=Step(RISE))
    Simulation(lattice, model, sides, sources=[source], observe=[surface]).run(PRESSED, progress=False)
    return surface.times, -surface.data["u"][..., 2] @ SURFACE


@validation("pekeris", LAMB, "the surface of a half-space beside a point that is pressed, in 3D", "a minute")
def pekeris(folder: Path) -> Outcome:
    """Displacement along the force, while the Rayleigh wave passes, and before and after."""
    from farhorizon.pictures.curves import curve_panels

    rows, errors = [], []
    for spacing in SPACINGS:
        times, computed = run_pressed(spacing)
        exact = pressed(AWAY, times)
        apart = np.abs(computed - exact) / np.abs(exact).max()
        passing = (times > RAYLEIGH * AWAY) & (times < RAYLEIGH * AWAY + RISE)
        errors.append(float(apart.max()))
        rows += [
            Row(f"largest difference, of the largest value, spacing {spacing:g}", errors[-1]),
            Row(f"the same before and after the Rayleigh wave, spacing {spacing:g}", float(apart[~passing].max())),
        ]
    rows.append(Row("order in the spacing", float(np.log2(errors[0] / errors[1])), 2.0))
    rows.append(Row("last displacement over the static one", float(computed[-1] * 8 * np.pi * AWAY / 3), 1.0))
    curves = [("exact", times, exact), ("computed", times, computed)]
    picture = folder / "pekeris.png"
    curve_panels([("", curves)], picture, xlabel="t", ylabel="displacement along the force")
    return Outcome(rows, pictures=[picture])

r"""Crack that runs through the square lattice at a constant speed: exact relation between load and speed.

The nodes of a square lattice of spacing 1 obey :math:`\ddot u = \Delta u + f` with the five-point difference operator;
waves have the speed 1. The bonds between the rows y = 0 and y = -1 open one after the other, the one at x = n at the
time n/v, and opposite forces on the two rows follow the tip. All nodes of a row have the same history, each 1/v after
its neighbour. With M steps of velocity Verlet in this time, the motion of row 0 is a single sequence :math:`U_j`, where
j/M is the distance that the tip still has to travel to a node. With the transforms :math:`\sum U_j z^j` the rows away
from the crack are eliminated by

.. math:: h = 2 - z^M - z^{-M} + \frac{z - 2 + 1/z}{\Delta t^2} , \qquad \lambda + \frac1\lambda = 2 + h ,

and intact bonds (:math:`U_+`, j > 0) and open bonds (:math:`U_-`) under the force P on row 0 obey

.. math::

    L\,U_+ + U_- = \frac{L - 1}{2}\,P, \qquad
    L = \frac{1 + \lambda}{1 - \lambda} = \sqrt{\frac{h + 4}{h}} = L_+ L_-

(Slepyan, 1981, Sov. Phys. Dokl. 26, 538; 2002, Models and Phenomena in Fracture Mechanics). Both h and h + 4 are
polynomials in z and 1/z. :math:`L_+` has their zeros outside the unit circle, :math:`L_-` those inside; a zero on the
circle belongs to the side to which a small damping moves it. Hence, with the part [...]_+ of positive powers,

.. math:: U_+ = \frac{[P L_+]_+}{2 L_+}, \qquad U_- = \frac{L_- [P L_+]_- - P}{2} .

**Load against speed.** A load far behind the tip causes the square root field of a crack in a continuum with the energy
release rate G. The bond that opens has the elongation 2U and the energy :math:`G_0 = 2 U^2`. Zeros off the circle
cancel:

.. math:: \frac{G_0}{G} = \prod \frac{\sin(\theta_-/2)}{\sin(\theta_+/2)}

over the real wavenumbers :math:`\theta` at which h or h + 4 changes sign: :math:`\theta_-` where the product of both
becomes negative, :math:`\theta_+` where it becomes positive again. With short steps these are Slepyan's ratios of
wavenumbers k with :math:`4\sin^2(k/2) - k^2 v^2` between -4 and 0. U is the geometric mean of the values in the last
step with the bond and in the first without it.

A crack at rest stays where it is from :math:`G_0/G = \sqrt2 - 1`, below which the next bond breaks, to
:math:`\sqrt2 + 1`, above which the last one would heal: it is trapped by the lattice. The solution for a running crack
is valid only if no bond is longer at any time before it opens than when it opens, which forbids low speeds. Where bonds
along the faces become longer than that, bonds beside the crack break as well (Marder and Gross, 1995, J. Mech. Phys.
Solids 43, 1).
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.special import erf, gamma

from farhorizon import Crack, Lattice, LatticePML, Simulation, Source, Stencil, Wave
from farhorizon.studies.collection import Outcome, Row
from farhorizon.validation import validation

STEADY = "Slepyan (1981), Dynamics of a crack in a lattice"
SPEEDS = (0.25, 0.4, 0.5, 0.6, 0.7, 0.75)
DRAWN = (0.25, 0.5, 0.75)
LONGEST = 0.3  # largest time step
DISTANCE = 10.0  # approximate distance of the load from the tip
FARTHER = 30.0  # the same for a crack at rest
FARTHEST = 7.0  # extent of the load over these distances: there it is 1e-6 of its largest value
ROWS = 8  # of the near field on either side of the crack
AHEAD, BEHIND = 6, 4  # numbers of bonds in the compared history
RISE = (60.0, 15.0)  # time and duration of the rise of the load: short waves from it stay near a fast tip for long
CIRCLE = 1e-7  # zeros this close to the unit circle are taken to lie on it


class Zeros(NamedTuple):
    """Zeros of h or h + 4 that belong to ``L_+`` (outer) and to ``L_-`` (inner)."""

    outer: np.ndarray
    inner: np.ndarray


def zeros(speed: float, steps: int, level: float) -> Zeros:
    """Zeros of ``h + level``; for h, one of the two zeros at z = 1 belongs to each side."""
    rate = (speed * steps) ** 2
    h = np.zeros(2 * steps + 1)
    h[[0, -1]] = -1
    h[[steps - 1, steps + 1]] += rate
    h[steps] += 2 - 2 * rate + level
    still = np.ones(0) if level else np.ones(1)
    if not level:
        h = np.polynomial.polynomial.polydiv(h, [1, -2, 1])[0]
    z = np.polynomial.polynomial.polyroots(h)
    on = np.abs(np.abs(z) - 1) < CIRCLE
    z[on] /= np.abs(z[on])
    slope = steps * (z ** (-steps - 1) - z ** (steps - 1)) + rate * (1 - z**-2)
    moved = -(z - 1 / z) / slope  # by a small damping
    outer = np.where(on, (np.conj(z) * moved).real > 0, np.abs(z) > 1)
    return Zeros(np.append(z[outer], still), np.append(z[~outer], still))


def powers(above: np.ndarray, below: np.ndarray, count: int) -> np.ndarray:
    """Power series coefficients of ``prod (1 - z/a)^(1/2) / prod (1 - z/b)^(1/2)``."""
    n = np.arange(1, count)
    rates = ((below[:, None] ** -n).sum(0) - (above[:, None] ** -n).sum(0)).real / 2
    coefficients = np.ones(count)
    for i in range(1, count):
        coefficients[i] = rates[:i] @ coefficients[i - 1 :: -1] / i
    return coefficients


def history(speed: float, steps: int, load: np.ndarray, ahead: int) -> tuple[np.ndarray, np.ndarray]:
    """Motion U of row 0 behind the tip, at j = 0, -1, ..., and at j = 1 .. `ahead`, under a force on row 0 at j = 0,
    -1, ...; `steps` are the time steps between the openings of two neighbouring bonds.
    """
    high, low = zeros(speed, steps, 4.0), zeros(speed, steps, 0.0)
    first = np.sqrt(np.sqrt(np.abs(np.prod(high.outer) / np.prod(low.outer))))
    count, n = len(load) + ahead, len(load)
    plus = first * powers(high.outer, low.outer, count)
    driven = np.convolve(plus, load[::-1])[:count]  # from j = 1 - n on
    held = np.convolve(driven[n:], powers(low.outer, high.outer, ahead) / first)[:ahead]
    minus = first * powers(1 / high.inner, 1 / low.inner, n)
    return (np.convolve(driven[n - 1 :: -1], minus)[:n] - load) / 2, held / 2


def ratio_of_steps(speed: float, steps: int) -> float:
    """G0/G for a load far away, with finite time steps."""
    high, low = zeros(speed, steps, 4.0), zeros(speed, steps, 0.0)

    def product(z: np.ndarray) -> float:
        return float(np.prod(np.abs(1 - z[(np.abs(np.abs(z) - 1) < CIRCLE) & (z != 1)])))

    return float(np.sqrt(product(high.outer) / product(high.inner) * product(low.inner) / product(low.outer)))


def ratio(speed: float) -> float:
    """G0/G for a load far away in continuous time (Slepyan, 1981)."""
    k = np.linspace(0.0, 3 / speed, 4000 + int(400 / speed))[1:]  # h + 4 is below zero beyond 2 sqrt(2) / v

    def product(k: np.ndarray) -> np.ndarray:
        h = 4 * np.sin(k / 2) ** 2 - (speed * k) ** 2
        return np.asarray(h * (h + 4))

    signs = np.sign(product(k))
    roots = [brentq(product, k[i], k[i + 1], xtol=1e-13) for i in np.flatnonzero(signs[1:] != signs[:-1])]
    return float(np.prod(roots[::2]) / np.prod(roots[1::2]))


def load(behind: np.ndarray, distance: float = DISTANCE) -> np.ndarray:
    """Force at the distances `behind` the tip, concentrated around `distance`.

    The integral of force / behind^(3/2) vanishes, so that the difference from a load far away falls with the square of
    the distance.
    """
    s = np.maximum(behind, 0.0) / distance
    return np.where(s < FARTHEST, s**4 * (s - 7 / 8) * np.exp(4 - 4 * s), 0.0)


def release_rate(speed: float, distance: float = DISTANCE) -> float:
    """G of the load in a continuum: ``(integral of load / sqrt(distance))^2 / (pi sqrt(1 - v^2))``."""
    integral = np.exp(4) * gamma(4.5) * np.sqrt(distance) / 4**5.5
    return float(integral**2 / (np.pi * np.sqrt(1 - speed**2)))


def exact_rows(speed: float, steps: int) -> np.ndarray:
    """Displacements of two neighbouring nodes of row 0 as the tip approaches and passes: over AHEAD bonds, up to the
    last step before the bond of the first node opens, and over BEHIND bonds; shape (2, number of these steps).
    """
    given = load(np.arange(int(FARTHEST * DISTANCE) * steps) / steps)
    behind, ahead = history(speed, steps, given, (AHEAD + 1) * steps)
    sequence = np.concatenate([ahead[::-1], behind[: BEHIND * steps]])
    return np.array([sequence[steps:], sequence[:-steps]])


def computed_rows(speed: float, steps: int) -> np.ndarray:
    """The same from a run, for nodes that the tip passes near its end."""
    # a load at the distance s acts on the tip after s / (1 - v)
    place = int(np.ceil(speed * (RISE[0] + 4 * RISE[1] + FARTHEST * DISTANCE / (1 - speed)) + AHEAD))
    until = (place + BEHIND + 1) / speed
    lattice = Lattice(1.0, (-FARTHEST * DISTANCE, -ROWS), (place + 2 * AHEAD, ROWS - 1))
    opening = [Crack([(n - 0.5, -0.5), (n + 0.5, -0.5)], opens=n / speed) for n in range(1, place + BEHIND + 2)]
    sim = pulled(lattice, speed, opening, 1 / (speed * steps), until)
    probes = sim.record([(place, 0.0), (place + 1, 0.0)])
    sim.run(until, progress=False)
    return np.array(probes.values).T[:, (place - AHEAD) * steps : (place + BEHIND) * steps]


def pulled(
    lattice: Lattice, speed: float, opening: list[Crack], dt: float, until: float, distance: float = DISTANCE
) -> Simulation:
    """A crack whose tip is initially at x = 0, under a load that follows it at a given speed."""

    def force(x: np.ndarray, y: np.ndarray, t: float) -> np.ndarray:
        sign = np.where(y == 0, 1.0, np.where(y == -1, -1.0, 0.0))
        return sign * load(speed * t - x, distance) * (1 + erf((t - RISE[0]) / RISE[1])) / 2

    return Simulation(
        lattice,
        Wave(Stencil.finite_difference(2)),
        LatticePML(target=1e-6, until=until),
        sources=[Source(force)],
        cracks=[[(2 * lattice.lower[0], -0.5), (0.5, -0.5)], *opening],
        dt=dt,
    )


class Reading(NamedTuple):
    """Results from a history: mean displacement as the bond opens, largest earlier displacement relative to it, and
    largest elongation of the bond along the face relative to that of the bond that opens.
    """

    opening: float
    before: float
    beside: float


def read(rows: np.ndarray, steps: int) -> Reading:
    """Evaluate a history."""
    first = AHEAD * steps
    opening = float(np.sqrt(rows[0, first - 1] * rows[0, first]))
    before, beside = rows[0, :first].max(), np.abs(rows[0] - rows[1]).max() / 2
    return Reading(opening, float(before / opening), float(beside / opening))


def at_rest() -> tuple[float, float]:
    """G0/G at which a crack at rest advances, and at which it heals."""
    far = FARTHEST * FARTHER
    until = RISE[0] + 4 * RISE[1] + 2 * far
    sim = pulled(Lattice(1.0, (-far, -ROWS), (2 * AHEAD, ROWS - 1)), 0.0, [], LONGEST, until, FARTHER)
    sim.run(until, progress=False)
    last, following = (float(sim.fields["u"][sim.lattice.index((x, 0.0))]) for x in (0.0, 1.0))
    return 2 * following**2 / release_rate(0.0, FARTHER), 2 * last**2 / release_rate(0.0, FARTHER)


@validation(
    "lattice-fracture", STEADY, "load against speed of a crack that runs through the square lattice", "a minute"
)
def lattice_fracture(folder: Path) -> Outcome:
    """Load against speed, bonds ahead of the tip and along the faces, and the crack at rest."""
    from farhorizon.pictures.curves import curve_panels

    rows, ratios, panels, in_time = [], [], [], "{:.5g} in continuous time"
    for speed in SPEEDS:
        steps = int(np.ceil(1 / (speed * LONGEST)))
        computed, solution = computed_rows(speed, steps), exact_rows(speed, steps)
        ours, exact = read(computed, steps), read(solution, steps)
        ratios.append(2 * ours.opening**2 / release_rate(speed))
        apart = float(np.abs(computed - solution).max() / exact.opening)
        rows += [
            Row(f"v = {speed:g}: G0/G", ratios[-1], ratio_of_steps(speed, steps), note=in_time.format(ratio(speed))),
            Row(f"v = {speed:g}: largest elongation before, of that as the bond opens", ours.before, exact.before),
            Row(f"v = {speed:g}: largest elongation along the faces, of that", ours.beside, exact.beside),
            Row(f"v = {speed:g}: largest difference from the exact history, of that", apart, 0.0),
        ]
        if speed in DRAWN:
            x = np.arange(-AHEAD * steps, BEHIND * steps) / steps
            here = np.abs(x) <= BEHIND
            curves = [
                (name, x[here], motion[0, here] / exact.opening)
                for name, motion in (("exact", solution), ("computed", computed))
            ]
            panels.append((f"a bond as the tip passes, v = {speed:g}", curves))
    trapped = zip(("goes on", "heals"), at_rest(), (np.sqrt(2) - 1, np.sqrt(2) + 1), strict=True)
    rows += [Row(f"G0/G at which a crack at rest {what}", ours, float(exact)) for what, ours, exact in trapped]
    speeds = np.linspace(0.03, 0.99, 800)
    points = np.full((2, 2 * len(SPEEDS)), np.nan)
    points[:, ::2] = SPEEDS, ratios
    loads = [("exact", speeds, np.array([ratio(v) for v in speeds])), ("computed", *points)]
    picture = folder / "lattice-fracture.png"
    curve_panels(
        [("load against speed", loads), *panels],
        picture,
        xlabel=("speed of the crack / speed of waves", *["nodes that the tip is beyond it"] * len(panels)),
        ylabel=("G0/G", *["elongation / as it opens"] * len(panels)),
    )
    return Outcome(rows, pictures=[picture])

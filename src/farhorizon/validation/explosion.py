r"""Centre of dilatation in an infinite solid, from its first wave to the static field that remains.

The body force is the gradient of a Gaussian, :math:`b = -M(t)\,\nabla g`, whose integral is M. Then
:math:`u = \nabla\Phi` with :math:`\rho\Phi_{tt} = \rho\alpha^2\Delta\Phi - M g`, a spherical field. By the Fourier
integral over k

.. math:: u_r = \frac{1}{2\pi^2\rho}\int_0^\infty k^3 j_1(kr)\,\hat g(k) \int_0^t M(s)\,
   \frac{\sin\alpha k(t-s)}{\alpha k}\,ds\,dk .

Outside the Gaussian this is :math:`u_r = \frac{1}{4\pi\rho\alpha^2}\left(\frac{M(t-r/\alpha)}{r^2} + \frac{\dot
M(t-r/\alpha)}{\alpha r}\right)` (Aki and Richards, 2002, Quantitative Seismology, chapter 4), and eventually
:math:`M/(4\pi\rho\alpha^2r^2)`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import spherical_jn

from farhorizon import Elastic, Lattice, LatticePML, Simulation, Source, Step
from farhorizon.studies.collection import Outcome, Row
from farhorizon.validation import validation

CENTRE = "Aki, Richards (2002), Quantitative Seismology"
BREADTH = 1.0  # standard deviation of the Gaussian
RISE = 2.0  # time in which M rises to 1
MOMENT = Step(RISE)
HALF = 6.0  # half width of the near field
SPACINGS = (0.6, 0.3)
PASSING = 6.0  # time at which the front is inside the near field
STATIC = 40.0


def exact(r: np.ndarray, t: float, speed: float, density: float) -> np.ndarray:
    """Exact radial displacement at the distances r."""
    nodes, weights = np.polynomial.legendre.leggauss(600)
    highest = 9.0 / BREADTH
    k, dk = (nodes + 1) * highest / 2, weights * highest / 2
    s, ds = (nodes + 1) * min(t, RISE) / 2, weights * min(t, RISE) / 2
    # after the rise M is 1, and the rest of the integral over s is elementary
    response = np.sin(speed * np.multiply.outer(k, t - s)) @ (ds * MOMENT(s)) / (speed * k)
    if t > RISE:
        response += (1 - np.cos(speed * k * (t - RISE))) / (speed * k) ** 2
    spectrum = dk * k**3 * np.exp(-((k * BREADTH) ** 2) / 2) * response / (2 * np.pi**2 * density)
    return spherical_jn(1, np.multiply.outer(r, k)) @ spectrum


def far(r: np.ndarray, speed: float, density: float) -> np.ndarray:
    """Static radial displacement outside the Gaussian."""
    return 1 / (4 * np.pi * density * speed**2 * r**2)


def run(model: Elastic, spacing: float) -> Simulation:
    """Simulation of the solid before its first step."""
    lattice = Lattice(spacing, (-HALF,) * 3, (HALF,) * 3)
    points = lattice.coordinates()
    gauss = np.exp(-sum(x**2 for x in points) / (2 * BREADTH**2)) / (2 * np.pi * BREADTH**2) ** 1.5
    force = np.array([x / BREADTH**2 * gauss for x in points])
    return Simulation(lattice, model, LatticePML(target=1e-3, until=STATIC), sources=[Source(force, time=MOMENT)])


def radial(sim: Simulation) -> tuple[np.ndarray, np.ndarray]:
    """Distances from the centre, and radial displacements, of all nodes except the centre."""
    points = np.array(sim.lattice.coordinates())
    r = np.sqrt((points**2).sum(0))
    outside = r > 0
    return r[outside], (sim.fields["u"] * points).sum(0)[outside] / r[outside]


def against_exact(
    runs: Iterable[tuple[str, Simulation, Callable[..., np.ndarray]]],
    times: Sequence[float],
    order: float,
    note: str = "",
    nearest: float = 0.0,
) -> tuple[list[Row], list[Any]]:
    """Compare radial displacements of runs on two lattices with the exact ones at given times.

    Returns rows with the largest differences and their order in the spacing, and panels of curves of the last run.
    Nodes at distances below `nearest` are left out.
    """
    rows, errors = [], []
    for spacing, sim, exact in runs:
        apart, panels = [], []
        for t in times:
            sim.run(t, progress=False)
            r, computed = radial(sim)
            outer = np.isfinite(computed) & (r >= nearest)
            r, computed = r[outer], computed[outer]
            solution, along = exact(r, sim.time), np.argsort(r)
            apart.append(float(np.abs(computed - solution).max() / np.abs(solution).max()))
            rows.append(Row(f"largest difference at t = {t:g}, of the largest value, spacing {spacing}", apart[-1]))
            panels.append((f"t = {t:g}", [("exact", r[along], solution[along]), ("computed", r, computed)]))
        errors.append(apart)
    rows += [
        Row(f"order in the spacing, t = {t:g}", float(np.log2(coarse / fine)), order, note=note)
        for t, coarse, fine in zip(times, *errors, strict=True)
    ]
    return rows, panels


@validation("explosion", CENTRE, "a centre of dilatation in an infinite solid, to its static limit", "a minute")
def explosion(folder: Path) -> Outcome:
    """A solid with Poisson's ratio 0.3."""
    from farhorizon.pictures.curves import curve_panels

    model = Elastic(None, young=1.0, poisson=0.3, density=1.0, material="finite-element")
    speed, density = model.p_speed, model.density
    solution = partial(exact, speed=speed, density=density)
    runs = ((f"{spacing:g}", run(model, spacing), solution) for spacing in SPACINGS)
    rows, panels = against_exact(runs, (PASSING, STATIC), 2.0)
    _, r, computed = panels[-1][1][-1]
    outer = r > 5 * BREADTH
    words = "static displacement over M/(4 pi rho alpha^2 r^2), five breadths out and farther"
    rows.append(Row(words, float((computed / far(r, speed, density))[outer].mean()), 1.0))
    picture = folder / "explosion.png"
    curve_panels(panels, picture, xlabel="distance", ylabel="radial displacement")
    return Outcome(rows, pictures=[picture])

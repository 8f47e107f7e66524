r"""Waves in the peridynamic bar and plane with a Gaussian micromodulus, whose dispersion is known in closed form.

With :math:`C(\xi) = a\,e^{-\xi^2/w^2}` a wave of wavenumber k has the frequency

.. math:: \omega^2 = \frac{4c^2}{w^2}\left(1 - e^{-k^2w^2/4}\right)

in any dimension: short waves stand still with the frequency 2c/w. A field that is released at rest is an integral over
its Fourier transform (Weckner and Abeyaratne, 2005, The effect of long-range forces on the dynamics of a bar). The
sums over the nodes of a lattice with two nodes in w are these integrals to 1e-15, so that what is left of the
difference is what ends and layers send back, and the time step: velocity Verlet turns :math:`\omega` into
:math:`\frac{2}{\Delta t}\arcsin\frac{\omega\Delta t}{2}`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.special import j0

from farhorizon.boundaries import Exact, LatticePML, Side
from farhorizon.geometry.lattice import Lattice
from farhorizon.medium.kernel import Kernel
from farhorizon.models import Wave
from farhorizon.simulation.simulation import Simulation
from farhorizon.studies.collection import Outcome, Row
from farhorizon.validation.validations import validation

BAR = "Weckner, Abeyaratne (2005), The effect of long-range forces on the dynamics of a bar"
WIDTH = 2.0  # w in spacings
HORIZON = 5.7 * WIDTH  # the micromodulus is 1e-14 of its maximum there
BREADTH = 3.0  # standard deviation of the released Gaussian


def frequency(k: np.ndarray) -> np.ndarray:
    """Of waves in the medium, for the speed 1."""
    return 2 / WIDTH * np.sqrt(-np.expm1(-((k * WIDTH) ** 2) / 4))


def stepped(omega: np.ndarray, dt: float) -> np.ndarray:
    """Frequency that velocity Verlet makes of one."""
    return 2 / dt * np.arcsin(omega * dt / 2)


def released(r: np.ndarray, t: float, dim: int, dt: float = 0.0) -> np.ndarray:
    """A Gaussian of height 1 that was released at rest, at the distances r; with the frequencies of a time step if one
    is given.
    """
    nodes, weights = np.polynomial.legendre.leggauss(400 + 4 * round(t + np.abs(r).max()))
    highest = 9.0 / BREADTH  # where its transform is 1e-17
    k, weights = (nodes + 1) * highest / 2, weights * highest / 2
    omega = frequency(k) if dt == 0 else stepped(frequency(k), dt)
    spectrum = weights * np.exp(-((k * BREADTH) ** 2) / 2) * np.cos(omega * t)
    if dim == 1:
        return BREADTH * np.sqrt(2 / np.pi) * np.cos(np.multiply.outer(r, k)) @ spectrum
    return BREADTH**2 * j0(np.multiply.outer(r, k)) @ (spectrum * k)


def run(dim: int, size: float, boundary: Side, until: float, dt: float) -> tuple[Simulation, np.ndarray, list[float]]:
    """A run of the released Gaussian, the distances of its nodes from the middle, and its largest differences from the
    exact solution with the frequencies of its time step and of continuous time, at ten times.
    """
    lattice = Lattice(1.0, (-size,) * dim, (size,) * dim)
    r = np.sqrt(sum(x**2 for x in lattice.coordinates()))
    kernel = Kernel(HORIZON, exponent=0, influence="gaussian", width=WIDTH, volume="full")
    sim = Simulation(lattice, Wave(kernel), boundary, {"u": np.exp(-((r / BREADTH) ** 2) / 2)}, dt=dt)
    distances, place = np.unique(r, return_inverse=True)
    worst = [0.0, 0.0]
    for t in np.linspace(until / 10, until, 10):
        sim.run(t, progress=False)
        for i, step in enumerate((sim.dt, 0.0)):
            exact = released(distances, sim.time, dim, step)[place].reshape(r.shape)
            worst[i] = max(worst[i], float(np.abs(sim.fields["u"] - exact).max()))
    return sim, r, worst


def _outcome(folder: Path, name: str, dim: int, size: float, boundary: Side, until: float) -> Outcome:
    """Rows: the difference with the time step's own frequencies, that from continuous time, and its order."""
    from farhorizon.pictures.curves import curve_panels

    panels, steps = [], (0.4, 0.2)
    coarse, fine = (run(dim, size, boundary, until, dt)[2] for dt in steps)
    rows = [
        Row(f"largest difference until t = {until:g}, of the initial maximum", fine[0], 0.0),
        Row(f"the same from continuous time, time step {steps[1]:g}", fine[1]),
        Row("order in the time step", float(np.log2(coarse[1] / fine[1])), 2.0),
    ]
    for t in (size, until):
        sim, r, _ = run(dim, size, boundary, t, steps[1])
        distances, first = np.unique(r, return_index=True)
        found = sim.fields["u"].ravel()[first]
        curves = [("exact", distances, released(distances, sim.time, dim)), ("computed", distances, found)]
        panels.append((f"t = {t:g}", curves))
    picture = folder / f"{name}.png"
    curve_panels(panels, picture, xlabel="distance from the middle", ylabel="u")
    return Outcome(rows, pictures=[picture])


@validation("gaussian-bar", BAR, "a Gaussian released in an infinite peridynamic bar, between exact ends")
def bar(folder: Path) -> Outcome:
    """Two crossings."""
    return _outcome(folder, "gaussian-bar", 1, 20.0, Exact(), 80.0)


@validation("gaussian-plane", BAR, "the same in an infinite peridynamic plane, in layers")
def plane(folder: Path) -> Outcome:
    """Two crossings."""
    return _outcome(folder, "gaussian-plane", 2, 20.0, LatticePML(target=1e-4, until=80.0), 80.0)

r"""Waves in a peridynamic bar, plane and solid with a Gaussian micromodulus, whose dispersion relation is known in
closed form.

With :math:`C(\xi) = a\,e^{-\xi^2/w^2}` a wave of wavenumber k has the frequency

.. math:: \omega^2 = \frac{4c^2}{w^2}\left(1 - e^{-k^2w^2/4}\right)

in any dimension: short waves have zero group velocity and the frequency 2c/w. A field that is released at rest is an
integral over its Fourier transform (Weckner and Abeyaratne, 2005, The effect of long-range forces on the dynamics of a
bar; in 3D Weckner, Brunk, Epton, Silling and Askari, 2009, Proc. R. Soc. A 465, 3463). The sums over the nodes of a
lattice with two spacings in w equal these integrals to 1e-15, so that the remaining difference is due to reflections
from ends, edges of an extended domain and layers, and to the time step: velocity Verlet turns :math:`\omega` into
:math:`\frac{2}{\Delta t}\arcsin\frac{\omega\Delta t}{2}`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.special import j0

from farhorizon import Exact, Extended, Kernel, Lattice, LatticePML, Side, Simulation, Wave
from farhorizon.studies.collection import Outcome, Row
from farhorizon.validation import validation

BAR = "Weckner, Abeyaratne (2005), The effect of long-range forces on the dynamics of a bar"
WIDTH = 2.0  # w in spacings
HORIZON = 5.7 * WIDTH  # the micromodulus is 1e-14 of its maximum there
BREADTH = 3.0  # standard deviation of the released Gaussian
NARROW = 2.2  # that of the one in the solid
STEPS = (0.4, 0.2)


def frequency(k: np.ndarray) -> np.ndarray:
    """Frequency of waves in the medium, for the speed 1."""
    return 2 / WIDTH * np.sqrt(-np.expm1(-((k * WIDTH) ** 2) / 4))


def stepped(omega: np.ndarray, dt: float) -> np.ndarray:
    """Frequency into which velocity Verlet turns omega."""
    return 2 / dt * np.arcsin(omega * dt / 2)


def released(r: np.ndarray, t: float, dim: int, dt: float = 0.0, breadth: float = BREADTH) -> np.ndarray:
    """Gaussian of height 1 released at rest, at the distances r and the time t; with the frequencies of a time step if
    dt is given.
    """
    nodes, weights = np.polynomial.legendre.leggauss(400 + 4 * round(t + np.abs(r).max()))
    highest = 9.0 / breadth  # there the transform is 1e-17
    k, weights = (nodes + 1) * highest / 2, weights * highest / 2
    omega = frequency(k) if dt == 0 else stepped(frequency(k), dt)
    spectrum = breadth**dim * weights * np.exp(-((k * breadth) ** 2) / 2) * np.cos(omega * t)
    phase = np.multiply.outer(r, k)
    if dim == 1:
        return np.sqrt(2 / np.pi) * np.cos(phase) @ spectrum
    return j0(phase) @ (spectrum * k) if dim == 2 else np.sqrt(2 / np.pi) * np.sinc(phase / np.pi) @ (spectrum * k**2)


def run(
    dim: int, size: float, boundary: Side, until: float, dt: float, breadth: float = BREADTH
) -> tuple[Simulation, np.ndarray, list[float]]:
    """Run of the released Gaussian, distances of the nodes from the middle, and the largest differences over ten times
    from the exact solutions with the frequencies of the time step and with those of continuous time.
    """
    lattice = Lattice(1.0, (-size,) * dim, (size,) * dim)
    r = np.sqrt(sum(x**2 for x in lattice.coordinates()))
    kernel = Kernel(HORIZON, exponent=0, influence="gaussian", width=WIDTH, volume="full")
    sim = Simulation(lattice, Wave(kernel), boundary, {"u": np.exp(-((r / breadth) ** 2) / 2)}, dt=dt)
    distances, place = np.unique(r, return_inverse=True)
    worst = [0.0, 0.0]
    for t in np.linspace(until / 10, until, 10):
        sim.run(t, progress=False)
        for i, step in enumerate((sim.dt, 0.0)):
            exact = released(distances, sim.time, dim, step, breadth)[place].reshape(r.shape)
            worst[i] = max(worst[i], float(np.abs(sim.fields["u"] - exact).max()))
    return sim, r, worst


def _outcome(
    folder: Path, name: str, dim: int, size: float, boundary: Side, until: float, breadth: float = BREADTH
) -> Outcome:
    """Rows with the difference for the frequencies of the time step, that for continuous time, and its order."""
    from farhorizon.pictures.curves import curve_panels

    coarse, fine = (run(dim, size, boundary, until, dt, breadth) for dt in STEPS)
    rows = [
        Row(f"largest difference until t = {until:g}, of the initial maximum", fine[2][0], 0.0),
        Row(f"the same from continuous time, time step {STEPS[1]:g}", fine[2][1]),
        Row("order in the time step", float(np.log2(coarse[2][1] / fine[2][1])), 2.0),
    ]
    panels = []
    for sim, r, _ in [run(dim, size, boundary, size, STEPS[1], breadth), fine] if size < until else [fine]:
        distances, first = np.unique(r, return_index=True)
        computed = sim.fields["u"].ravel()[first]
        exact = released(distances, sim.time, dim, breadth=breadth)
        panels.append((f"t = {sim.time:g}", [("exact", distances, exact), ("computed", distances, computed)]))
    picture = folder / f"{name}.png"
    curve_panels(panels, picture, xlabel="distance from the middle", ylabel="u")
    return Outcome(rows, pictures=[picture])


@validation("gaussian-bar", BAR, "a Gaussian released in an infinite peridynamic bar, between exact ends")
def bar(folder: Path) -> Outcome:
    """The run lasts two crossings."""
    return _outcome(folder, "gaussian-bar", 1, 20.0, Exact(), 80.0)


@validation("gaussian-plane", BAR, "the same in an infinite peridynamic plane, in an extended domain and in layers")
def plane(folder: Path) -> Outcome:
    """The run lasts two crossings. Layers for a target of 1e-6 are refused: with such long bonds they grow."""
    size, until = 20.0, 80.0
    outcome = _outcome(folder, "gaussian-plane", 2, size, Extended(target=1e-10, until=until), until)
    layered = run(2, size, LatticePML(target=1e-4, until=until), until, STEPS[1])[2][0]
    outcome.rows.append(Row("largest difference in layers made for 1e-4", layered, 0.0))
    return outcome


@validation("gaussian-solid", BAR, "the same in an infinite peridynamic solid, in an extended domain", "a minute")
def solid(folder: Path) -> Outcome:
    """A narrower Gaussian, while it splits into a wave and a part that stays."""
    return _outcome(folder, "gaussian-solid", 3, 15.0, Extended(target=1e-10), 4.0, NARROW)

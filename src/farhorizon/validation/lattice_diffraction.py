r"""Waves from a point near a semi-infinite crack and near a semi-infinite rigid line in the square lattice, exact at
every node.

The nodes of a square lattice of spacing 1 obey :math:`\ddot u = \Delta u + f` with the five-point difference operator.
For the time factor :math:`e^{-i\omega t}`, the Fourier transform of a row is multiplied from one row to the next by
:math:`\lambda`, the root inside the unit circle of

.. math:: \lambda + \frac1\lambda = 4 - \omega^2 - 2\cos\xi ,

and the field of a unit force at the node :math:`(x_s, y_s)`, :math:`y_s \ge 0`, is :math:`\frac{1}{2\pi}\int
\frac{\lambda^{|y - y_s|}}{1/\lambda - \lambda}\,e^{i\xi(x - x_s)}\,d\xi`.

**Crack.** The bonds between the rows y = 0 and y = -1 are cut at :math:`x \le 0`. The scattered field is odd across the
crack. For the transforms :math:`U_+` of row 0 at x > 0 and :math:`U_-` at :math:`x \le 0`, the equations of its nodes
are

.. math:: L\,U_+ + U_- = \frac{1 - L}{2}\,Q_-, \qquad L = \frac{1 + \lambda}{1 - \lambda} = L_+ L_- ,

with the force :math:`Q_-` that the cut bonds would have transmitted. Each wave :math:`e^{i\kappa x}` of this force
contributes

.. math:: U = \frac{1 - L(\xi)}{2L_+(\xi)}\,\frac{L_+(\kappa)}{1 - e^{-i(\kappa - \xi)}} .

**Rigid line.** The nodes of row 0 at :math:`x \le 0` are held. The scattered field is even across the line, and row 0
obeys

.. math:: K\,(U_+ + U_-) = F_-, \qquad K = \frac1\lambda - \lambda = K_+ K_- ,

with the forces :math:`F_-` that hold the nodes; :math:`U_-` is minus the incident wave. Each wave :math:`e^{i\kappa x}`
of the incident wave contributes

.. math:: U = -\frac{K_+(\kappa)}{K_+(\xi)}\,\frac{1}{1 - e^{-i(\kappa - \xi)}}

(by the Wiener-Hopf method; Slepyan, 2002, Models and Phenomena in Fracture Mechanics; for plane waves Sharma, 2015,
SIAM J. Appl. Math. 75, 1171 and 1915). For real :math:`\omega` the paths of integration pass the branch points on the
sides that a small damping would select, and the trapezoidal rule is exact to rounding. A run with velocity Verlet has
the same solution with :math:`\frac{2}{\Delta t}\sin\frac{\omega\Delta t}{2}` in place of :math:`\omega`, so that the
difference is entirely due to reflections from the layers.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon import Box, Lattice, LatticePML, PointSource, Prescribed, Simulation, Spectra, Stencil, Wave
from farhorizon.studies.collection import Outcome, Row
from farhorizon.validation.validations import validation

CRACK = "Sharma (2015), Diffraction of waves on square lattice by semi-infinite crack"
LINE = "Sharma (2015), Diffraction of waves on square lattice by semi-infinite rigid constraint"
SOURCE = (6, 9)
HALF = 20  # half width of the near field
FREQUENCIES = np.array([0.75, 1.0, 1.25])  # angular; the waves are 8.3 to 4.9 nodes long
UNTIL = 240.0
TARGETS = (1e-6, 1e-8)
POINTS = 1024  # quadrature points on a path
BEND, APART = 0.4, 0.1  # distances of the paths of integration from the real axis and from each other


def path(level: int) -> tuple[np.ndarray, np.ndarray]:
    """Points and weights of a path above the branch points on the left and below those on the right; paths of higher
    levels lie above it.
    """
    t = (np.arange(POINTS) + 0.5) * 2 * np.pi / POINTS - np.pi
    return t - 1j * BEND * np.sin(t) + 1j * APART * level, (1 - 1j * BEND * np.cos(t)) * 2 * np.pi / POINTS


def row_factor(xi: np.ndarray, omega: complex) -> np.ndarray:
    """Lambda on a path for frequencies below 2, with branch cuts that do not meet the paths."""
    edge = 2 * np.arcsin(omega / 2)
    half = 2 - omega**2 / 2 - np.cos(xi)
    root = np.sqrt(2j * np.sin((xi - edge) / 2)) * np.sqrt(-1j * np.sin((xi + edge) / 2))
    return np.asarray(half - root * np.sqrt(half + 1))


def transmission(factor: np.ndarray) -> np.ndarray:
    """Kernel L of the crack, given lambda."""
    return (1 + factor) / (1 - factor)


def stiffness(factor: np.ndarray) -> np.ndarray:
    """Kernel K of the rigid line, given lambda: the force on a row over its displacement."""
    return 1 / factor - factor


def split(symbol: Callable[[np.ndarray], np.ndarray], xi: np.ndarray, omega: complex) -> np.ndarray:
    """Factor ``L_+`` or ``K_+`` of a kernel on a path below that of level 2."""
    eta, step = path(2)
    integrand = np.log(symbol(row_factor(eta, omega))) * step / (2 * np.pi)
    return np.asarray(np.exp((1 / np.expm1(-1j * np.subtract.outer(eta, xi)) + 0.5).T @ integrand))


def from_source(x: np.ndarray, y: np.ndarray, omega: complex) -> np.ndarray:
    """Field of a unit force in the lattice without obstacles, shape (len(x), len(y))."""
    xi, step = path(0)
    factor = row_factor(xi, omega)
    rows = factor[:, None] ** np.abs(y - SOURCE[1]) * (step / stiffness(factor) / (2 * np.pi))[:, None]
    return np.exp(1j * np.multiply.outer(x - SOURCE[0], xi)) @ rows


def arriving(omega: complex) -> tuple[np.ndarray, np.ndarray]:
    """Amplitudes of the incident waves in row 0 on the path of level 0, and lambda on this path."""
    kappa, density = path(0)
    factor = row_factor(kappa, omega)
    return density * np.exp(-1j * kappa * SOURCE[0]) * factor ** SOURCE[1] / stiffness(factor) / (2 * np.pi), factor


def sent(symbol: Callable[[np.ndarray], np.ndarray], waves: np.ndarray, omega: complex) -> np.ndarray:
    """Scattered field on the path of level 1, up to a factor that depends on the obstacle, for incident waves on the
    path of level 0 that are cut off at x = 0: the sum of ``S_+(kappa) / S_+(xi) / (1 - exp(-i (kappa - xi)))`` with the
    kernel S.
    """
    kappa, xi = path(0)[0], path(1)[0]
    ended = (1 / -np.expm1(-1j * np.subtract.outer(kappa, xi))).T @ (waves * split(symbol, kappa, omega))
    return np.asarray(ended / split(symbol, xi, omega))


def from_crack(x: np.ndarray, y: np.ndarray, omega: complex) -> np.ndarray:
    """Field scattered by the crack, shape (len(x), len(y))."""
    waves, factor = arriving(omega)
    force = waves * (factor - 1)  # transmitted by the bonds to row -1
    xi, step = path(1)
    factor = row_factor(xi, omega)
    row = -factor / (1 - factor) * sent(transmission, force, omega)
    rows = factor[:, None] ** np.where(y < 0, -1 - y, y) * (row * step / (2 * np.pi))[:, None]
    return np.exp(1j * np.multiply.outer(x, xi)) @ rows * np.where(y < 0, -1.0, 1.0)


def from_line(x: np.ndarray, y: np.ndarray, omega: complex) -> np.ndarray:
    """Field scattered by the rigid line, shape (len(x), len(y))."""
    xi, step = path(1)
    row = -sent(stiffness, arriving(omega)[0], omega)
    rows = row_factor(xi, omega)[:, None] ** np.abs(y) * (row * step / (2 * np.pi))[:, None]
    return np.exp(1j * np.multiply.outer(x, xi)) @ rows


def signal(t: float) -> float:
    """Time signal of the force; its spectrum is negligible below the frequency 0.25 and above 1.75."""
    return float(np.exp(-(((t - 48.0) / 8.0) ** 2)) * np.cos(t - 48.0))


def run(target: float, obstacle: dict[str, Any]) -> tuple[Lattice, np.ndarray]:
    """The lattice, and its field near an obstacle at the frequencies, divided by the spectrum of the force."""
    dt = 0.5
    lattice = Lattice(1.0, (-HALF, -HALF), (HALF, HALF))
    frequencies = np.arcsin(FREQUENCIES * dt / 2) / (np.pi * dt)  # of the time steps
    spectra = Spectra(Box((-HALF, -HALF), (HALF, HALF)), frequencies)
    sim = Simulation(
        lattice,
        Wave(Stencil.finite_difference(2)),
        LatticePML(target=target, until=UNTIL),
        sources=[PointSource(SOURCE, time=signal)],
        observe=[spectra],
        dt=dt,
        **obstacle,
    )
    sim.run(UNTIL, progress=False)
    times = dt * np.arange(sim.step_count + 1)
    force = dt * np.exp(-2j * np.pi * np.multiply.outer(frequencies, times)) @ [signal(t) for t in times]
    field = spectra.data["u"].reshape(len(frequencies), *lattice.shape)
    return lattice, np.conj(field / force[:, None, None])  # Fourier sums use the opposite sign of time


def beside(
    folder: Path, name: str, obstacle: dict[str, Any], added: Callable[..., np.ndarray], end: tuple[float, float]
) -> tuple[list[Row], np.ndarray, np.ndarray, Path]:
    """Differences from the exact solution for both targets, the last computed and exact fields, and a picture that
    shows the obstacle from the left to its end.
    """
    from farhorizon.pictures.fields import field_panels
    from farhorizon.pictures.panels import Look, Panel

    rows = []
    for target in TARGETS:
        lattice, fields = run(target, obstacle)
        x, y = lattice.axes
        for omega, computed in zip(FREQUENCIES, fields, strict=True):
            incident = from_source(x, y, omega)
            exact = incident + added(x, y, omega)
            apart = float(np.abs(computed - exact).max() / np.abs(incident[HALF, HALF]))
            what = f"largest difference, of the incident wave at the tip, omega = {omega:g}, target {target:g}"
            rows.append(Row(what, apart, 0.0))
    picture = folder / f"{name}.png"
    parts = [("real part, computed", computed.real), ("exact", exact.real), ("incident wave alone", incident.real)]
    line = np.array([(-HALF, end[1]), end])
    look = Look(limits=(-0.15, 0.15), cracks=[line])
    field_panels([Panel(*part) for part in parts], lattice.axes, picture, look)
    return rows, computed, exact, picture


@validation("lattice-crack", CRACK, "a semi-infinite crack in the square lattice, exact at every node", "ten seconds")
def lattice_crack(folder: Path) -> Outcome:
    """Waves from a point around a crack that continues into the layer, with layers for two targets."""
    crack = [(-2.0 * HALF, -0.5), (0.5, -0.5)]
    rows, computed, exact, picture = beside(folder, "lattice-crack", {"cracks": [crack]}, from_crack, (0.5, -0.5))
    openings = [abs(field[HALF, HALF] - field[HALF, HALF - 1]) for field in (computed, exact)]
    what = f"opening at the tip over the exact one, omega = {FREQUENCIES[-1]:g}"
    rows.append(Row(what, float(openings[0] / openings[1]), 1.0))
    return Outcome(rows, pictures=[picture])


@validation(
    "lattice-line", LINE, "a semi-infinite rigid line in the square lattice, exact at every node", "ten seconds"
)
def lattice_line(folder: Path) -> Outcome:
    """Waves from a point around a line of held nodes that continues into the layer, with layers for two targets."""
    held = Prescribed(Box((-2.0 * HALF, -0.1), (0.1, 0.1)), 0.0)
    rows, computed, exact, picture = beside(folder, "lattice-line", {"constraints": [held]}, from_line, (0.0, 0.0))
    ahead = abs(computed[HALF + 1, HALF]) / abs(exact[HALF + 1, HALF])
    what = f"displacement of the node ahead of the tip over the exact one, omega = {FREQUENCIES[-1]:g}"
    rows.append(Row(what, float(ahead), 1.0))
    return Outcome(rows, pictures=[picture])

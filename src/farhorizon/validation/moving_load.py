r"""Mach cones of a load that moves faster than the waves that it excites.

A Gaussian load that moves along x with the velocity v begins to act at t = 0. For the wave equation with the source
:math:`g(x - vt)` each Fourier component is an oscillator,

.. math:: \hat u_{tt} + c^2k^2\,\hat u = \hat g\,e^{-i\kappa t}, \qquad \kappa = k_x v,

.. math:: \hat u = \hat g\,\frac{e^{-i\kappa t} - \cos ckt + \frac{i\kappa}{ck}\sin ckt}{c^2k^2 - \kappa^2},

and the field is the inverse transform on a period so large that nothing travels round it. In an elastic medium the
components of the load along and normal to k excite P and S waves (Cole and Huth, 1958, Stresses produced in a half
plane by moving loads, for the cones). The angle of a cone to the path is :math:`\arcsin(c/v)`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from farhorizon import Elastic, Lattice, LatticeModel, LatticePML, Simulation, Source, Stencil, Wave
from farhorizon.studies.collection import Outcome, Row
from farhorizon.validation.validations import validation

CONES = "Cole, Huth (1958), Stresses produced in a half plane by moving loads"
BREADTH = 1.0  # standard deviation of the load
HALF = 18.0  # half width of the near field
START = -12.0  # initial position of the load
UNTIL = 16.0
SPACINGS = (0.5, 0.25)


def oscillators(k: np.ndarray, kappa: np.ndarray, speed: float, t: float) -> np.ndarray:
    """Response of each Fourier component to a moving unit load, from rest at t = 0."""
    omega = speed * k
    gap = omega**2 - kappa**2
    close = np.abs(gap) < 1e-9 * (omega**2 + kappa**2 + 1)
    sine = t * np.sinc(omega * t / np.pi)  # sin(omega t) / omega
    forced = np.exp(-1j * kappa * t) - np.cos(omega * t) + 1j * kappa * sine
    # at resonance, the limit kappa -> omega; at zero frequency the load accelerates forever
    resonant = 1j * (t * np.exp(-1j * kappa * t) - sine) / np.where(kappa == 0, 1.0, 2 * kappa)
    limit = np.where(omega == 0, t**2 / 2, resonant)
    return np.where(close, limit, forced / np.where(close, 1.0, gap))


def exact(lattice: Lattice, velocity: float, t: float, speeds: tuple[float, ...]) -> np.ndarray:
    """Exact field of the load on the nodes; for two speeds, the displacements due to a force along y."""
    h = lattice.spacing
    n = 2 ** int(np.ceil(np.log2(2 * (HALF + max(max(speeds), velocity) * t + 8 * BREADTH) / h)))
    kx, ky = np.meshgrid(*[2 * np.pi * np.fft.fftfreq(n, h)] * 2, indexing="ij")
    k = np.hypot(kx, ky)
    load = 2 * np.pi * BREADTH**2 * np.exp(-((k * BREADTH) ** 2) / 2) * np.exp(-1j * kx * START)
    responses = [load * oscillators(k, kx * velocity, speed, t) for speed in speeds]
    if len(speeds) == 1:
        parts = responses
    else:
        along, across = responses
        square = np.where(k == 0, 1.0, k**2)
        parts = [
            (along - across) * kx * ky / square,
            np.where(k == 0, along, (along * ky**2 + across * kx**2) / square),
        ]
    places = [np.round(x / h).astype(int) % n for x in lattice.axes]
    fields = [np.fft.ifft2(part).real[np.ix_(*places)] / h**2 for part in parts]
    return fields[0] if len(speeds) == 1 else np.array(fields)


def run(model: LatticeModel, velocity: float, spacing: float, speeds: tuple[float, ...]) -> Simulation:
    """Simulation run up to its end."""
    lattice = Lattice(spacing, (-HALF, -HALF / 2), (HALF, HALF / 2))

    def load(x: np.ndarray, y: np.ndarray, t: float) -> np.ndarray:
        return np.exp(-((x - START - velocity * t) ** 2 + y**2) / (2 * BREADTH**2))

    value = load if len(speeds) == 1 else [0.0, load]
    sim = Simulation(lattice, model, LatticePML(target=1e-4, until=UNTIL), sources=[Source(value)])
    return sim.run(UNTIL, progress=False)


def ridge(lattice: Lattice, field: np.ndarray, head: float, limits: tuple[float, float]) -> float:
    """Angle in degrees between the path and the ridge of a field.

    The ridge is the straight line fitted to the steepest place of each row between two distances from the path.
    """
    x, y = lattice.axes
    rows = np.flatnonzero((y >= limits[0]) & (y <= limits[1]))
    slope = np.gradient(field, lattice.spacing, axis=0)
    places = []
    for row in rows:
        values = np.abs(slope[:, row])
        i = int(values.argmax())
        left, middle, right = values[i - 1 : i + 2]
        places.append(x[i] + lattice.spacing * (left - right) / (left - 2 * middle + right) / 2)
    rise = np.polyfit(head - np.array(places), y[rows], 1)[0]
    return float(np.degrees(np.arctan(rise)))


def _outcome(
    folder: Path,
    name: str,
    model: LatticeModel,
    velocity: float,
    speeds: tuple[float, ...],
    shown: Callable[..., np.ndarray],
) -> tuple[Outcome, Simulation]:
    from farhorizon.pictures.fields import field_panels
    from farhorizon.pictures.panels import Panel

    errors = []
    for spacing in SPACINGS:
        sim = run(model, velocity, spacing, speeds)
        computed, solution = sim.fields["u"], exact(sim.lattice, velocity, sim.time, speeds)
        errors.append(float(np.abs(computed - solution).max() / np.abs(solution).max()))
    rows = [
        Row(f"largest difference at t = {UNTIL:g}, of the largest value, spacing {spacing:g}", error)
        for spacing, error in zip(SPACINGS, errors, strict=True)
    ]
    rows.append(Row("order in the spacing", float(np.log2(errors[0] / errors[1])), 2.0))
    picture = folder / f"{name}.png"
    panels = [Panel("computed", shown(computed)), Panel("exact", shown(solution))]
    field_panels(panels, sim.lattice.axes, picture)
    return Outcome(rows, pictures=[picture]), sim


@validation("mach-cone", CONES, "the cone behind a load that moves at 1.5 times the speed of waves")
def scalar(folder: Path) -> Outcome:
    """Scalar waves in a membrane."""
    velocity = 1.5
    outcome, sim = _outcome(folder, "mach-cone", Wave(Stencil.finite_element(2)), velocity, (1.0,), lambda u: u)
    angle = ridge(sim.lattice, sim.fields["u"], START + velocity * sim.time, (3.0, 5.5))
    outcome.rows.append(Row("angle of the cone in degrees", angle, float(np.degrees(np.arcsin(1 / velocity)))))
    return outcome


@validation("mach-cones", CONES, "P and S cones of a force that moves faster than both waves")
def elastic(folder: Path) -> Outcome:
    """A solid with Poisson's ratio 0.3 in plane strain."""
    model = Elastic(None, young=1.0, poisson=0.3, material="finite-element")
    velocity = 1.25 * model.p_speed
    outcome, _ = _outcome(folder, "mach-cones", model, velocity, (model.p_speed, model.s_speed), lambda u: u[1])
    return outcome

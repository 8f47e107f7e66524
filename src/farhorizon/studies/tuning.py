"""Search for the best certified condition along an outline: candidates are ordered by their reflection at a flat side
and accepted by the certificate of the complete update.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np

from farhorizon import kinds
from farhorizon.analysis.exact.chain import Recursion
from farhorizon.analysis.layers.chain_modes import ArrivingWave, LatticeMedium
from farhorizon.boundaries import Higdon, Periodic, PlaneWave
from farhorizon.checks.certificate import CERTIFIED, Certificate
from farhorizon.checks.facts import options_shown
from farhorizon.checks.report import TunedFacts, content
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import AXES, Lattice
from farhorizon.rounding import MARGIN

if TYPE_CHECKING:
    from farhorizon.simulation.simulation import Simulation

BUDGET = 60.0  # seconds
_FRACTION = 0.2  # largest fraction of the budget for one certificate
_RADII = (1.0, 2.0, 3.0, 4.0)  # radii of clouds, in spacings; the reach is added
_ANGLES = (30.0, 45.0, 60.0)  # largest angles of modes
_WAVENUMBERS = (0.5, 1.0)  # largest wavenumbers of modes, divided by the spacing
_REGULARIZATIONS = (4e-5, 1e-2, 1.0)  # below 1e-4 it has no effect; 1 is the order of the unknowns
_PASSING = (0.0, 15.0, 30.0, 45.0, 60.0)  # angles of Higdon's factors
_SHIFTS = (1.0, 2.0)  # shift relative to the default
_BAND = (8.0, 80.0)  # wavelengths in spacings, if there are no data to define them
_WAVES = 5  # number of wavelengths in the band, and of angles


@dataclass(frozen=True)
class Tuning:
    """A certified condition, and what it reflects.

    Attributes
    ----------
    boundary : PlaneWave or Higdon
    amplitude : float
        Largest reflected amplitude at a flat side, of plane waves of amplitude 1 in the band and up to the angle.
    angle : float
        Largest angle of incidence, in degrees.
    certificate : Certificate
        Certificate of the complete update on the outline itself.
    refused : int
        Number of candidates that reflect less but are not certified.
    """

    boundary: PlaneWave | Higdon
    amplitude: float
    angle: float
    certificate: Certificate
    refused: int

    @property
    def toml(self) -> str:
        """The condition as written in a case file."""
        given = {
            f.name: getattr(self.boundary, f.name)
            for f in fields(self.boundary)
            if getattr(self.boundary, f.name) != f.default
        }
        words = {name: list(value) if isinstance(value, tuple) else value for name, value in given.items()}
        return (
            f'{{ type = "{self.boundary.tag}"'
            + "".join(f", {name} = {json.dumps(value)}" for name, value in words.items())
            + " }"
        )

    def as_json(self) -> TunedFacts:
        """Return the condition and its certificate as plain data."""
        return {
            "boundary": self.toml,
            "amplitude": self.amplitude,
            "angle": self.angle,
            "certificate": self.certificate.as_json(),
        }

    def __str__(self) -> str:
        decibels = 20 * np.log10(max(self.amplitude, 1e-16))
        return (
            f"{options_shown(self.boundary)}: at most {decibels:.0f} dB up to {self.angle:g} degrees at a flat side; "
            f"{self.certificate}; "
            f"{self.refused} that send back less are not certified"
        )


def tuned(
    sim: Simulation, angle: float = 60.0, band: tuple[float, float] | None = None, budget: float = BUDGET
) -> Tuning:
    """Search for the options of the closing condition of a simulation with the smallest reflection among those that are
    certified.

    For a `PlaneWave`, the radius of the cloud, the angles and wavenumbers of its modes and the regularisation are
    varied, for a `Higdon` the angles and the shift; all other options remain as given.
    ``sim.remade(boundary=tuned(sim).boundary)`` applies the result.

    Parameters
    ----------
    sim : Simulation
        A simulation of waves with the same closing condition on all sides.
    angle : float
        Largest angle of incidence considered, in degrees.
    band : tuple of float, optional
        Shortest and longest wavelength; those of the initial data and sources unless given.
    budget : float
        Time for all certificates, in seconds.

    Raises
    ------
    InputError
        Another boundary, diffusion, a field of several components, numbers out of range, or no candidate that can be
        certified in this time.

    Examples
    --------
    >>> import farhorizon as fh
    >>> lattice = fh.Lattice(1.0, (-9.0, -9.0), (9.0, 9.0))
    >>> sim = fh.Simulation(lattice, fh.Wave(fh.Stencil.finite_difference(2)), fh.Higdon(), {"u": "exp(-x**2 - y**2)"})
    >>> fh.tuned(sim, budget=20.0).certificate.verdict
    'certified'
    """
    if not hasattr(sim, "remade"):
        raise InputError("must be a Simulation", value=kinds.said(sim), key="sim")
    angle, budget = kinds.number(angle, "angle", least=0, below=90), kinds.number(budget, "budget", above=0)
    given = next(iter(sim.sides.values()))
    if sim.model.order != 2 or not isinstance(given, PlaneWave | Higdon) or any(b != given for b in sim.sides.values()):
        raise InputError(
            "waves that one PlaneWave or Higdon closes are tuned",
            value=", ".join(type(b).__name__ for b in sim.sides.values()),
            key="boundary",
        )
    if sim.stencil.components > 1:
        raise InputError(
            "conditions for scalar waves are tuned",
            value=sim.model.title,
            key="model",
            limit="one component",
            remedy="a LatticePML, or damping for the default PlaneWave()",
        )
    if band is not None and not 0 < kinds.array(band, "band", shape=(2,))[0] <= band[1]:
        raise InputError(
            "a band has its shortest wavelength first", value=band, limit="0 < shortest <= longest", key="band"
        )
    if band is None:
        waves = content(sim)
        band = (
            (waves.shortest, waves.longest)
            if waves is not None
            else (_BAND[0] * sim.lattice.spacing, _BAND[1] * sim.lattice.spacing)
        )
    ranked = []
    for candidate in _candidates(sim, given):
        try:
            ranked.append((flat_reflection(sim, candidate, angle, band), candidate))
        except InputError:  # a cloud without neighbours, or no wave of the band
            continue
    ranked.sort(key=lambda pair: pair[0])
    left = budget
    for refused, (amplitude, candidate) in enumerate(ranked):
        if left <= 0:
            break
        try:
            certificate = sim.remade(boundary=candidate, initial={}).certificate(min(left, _FRACTION * budget))
        except InputError:  # applicable to a flat side, but not to this outline
            continue
        left -= certificate.work
        if certificate.verdict == CERTIFIED:
            return Tuning(candidate, amplitude, angle, certificate, refused)
    raise InputError(
        "no setting is certified",
        value=f"{type(given).__name__}, {len(ranked)} settings",
        limit=f"{budget:g} s",
        key="boundary",
        remedy="Higdon instead of PlaneWave, more damping, or LatticePML",
    )


def _candidates(sim: Simulation, given: PlaneWave | Higdon) -> Iterator[PlaneWave | Higdon]:
    if isinstance(given, PlaneWave):
        radii = {r * sim.lattice.spacing for r in (*_RADII, float(max(sim.stencil.reach)))}
        waves = [k / sim.lattice.spacing for k in _WAVENUMBERS] if given.wavenumber is None else [given.wavenumber]
        for radius, angle, wavenumber, regularization in itertools.product(
            sorted(radii), _ANGLES, waves, _REGULARIZATIONS
        ):
            yield replace(given, radius=radius, angle=angle, wavenumber=wavenumber, regularization=regularization)
        return
    assert sim.closure is not None
    speed = float(np.sqrt(sim.model.coefficient))
    least = given.shift or max(sim.model.damping, 0.5 * speed / sim.closure.fringe.extent)
    for count in (2, 3):
        for angles, shift in itertools.product(itertools.combinations_with_replacement(_PASSING, count), _SHIFTS):
            yield replace(given, angles=angles, shift=shift * least)


def flat_reflection(sim: Simulation, boundary: PlaneWave | Higdon, angle: float, band: tuple[float, float]) -> float:
    """Largest amplitude that a flat side along the lattice reflects of plane waves of amplitude 1, up to an angle in
    degrees, between the wavelengths of a band. InputError if no wave reaches the side, or the condition does not apply.
    """
    rows = _flat_rows(sim, boundary)
    spacing = sim.lattice.spacing
    medium = LatticeMedium(
        sim.stencil,
        sim.model.coefficient,
        spacing,
        Recursion.of(sim.model.integrator, sim.dt, sim.model.damping),
        sim.dt,
    )
    largest = []
    for wavelength in np.geomspace(*band, _WAVES) / spacing:
        for theta in np.linspace(0, angle, _WAVES if sim.lattice.dim > 1 else 1):
            try:
                largest.append(_sent_back(rows, medium.plane_wave(float(wavelength), float(theta))))
            except InputError:
                continue
    if not largest:
        raise InputError("no wave of the band comes to the side", value=band, key="band")
    return max(largest)


# for each halo column: its place, and the levels, offsets (N, dim) and weights of the nodes that it reads
_Rows = list[tuple[int, np.ndarray, np.ndarray, np.ndarray]]


def _flat_rows(sim: Simulation, boundary: PlaneWave | Higdon) -> _Rows:
    """The condition at the halo nodes along the normal of a flat side; places are counted from the last node of
    the near field.
    """
    lattice, dim = sim.lattice, sim.lattice.dim
    assert sim.closure is not None
    thickness = boundary.depth(sim.closure.medium, lattice.spacing, sim.closure.fringe.extent)
    depth = int(np.ceil(thickness / lattice.spacing - MARGIN))
    wide = np.array([2 * (depth + max(sim.stencil.reach)) + 2] + [2 * max(depth, *sim.stencil.reach) + 1] * (dim - 1))
    box = Lattice(lattice.spacing, [0.0] * dim, (lattice.spacing * (wide - 1)).tolist())
    flat = sim.remade(lattice=box, boundary={"x": boundary} | {AXES[a]: Periodic() for a in range(1, dim)})
    closure = flat.closure
    assert closure is not None
    last, update, index = closure.outline.bounds()[1], closure.update, closure.fringe.index
    rows: _Rows = []
    for number, place in enumerate(closure.rows):
        if index[place, 0] <= last[0] or index[place, 1:].any():
            continue
        entries = slice(update.indptr[number], update.indptr[number + 1])
        level, read = np.divmod(update.indices[entries], len(index))
        steps = index[read] - index[place]
        steps[:, 1:] -= wide[1:] * np.rint(steps[:, 1:] / wide[1:]).astype(int)
        rows.append((int(index[place, 0] - last[0]), level, steps, update.data[entries]))
    return rows


def _sent_back(rows: _Rows, wave: ArrivingWave) -> float:
    """Amplitude of the reflected waves, from one condition per halo column (rows) and one unknown per mode
    (columns).
    """
    modes = np.append(wave.modes.leaving, wave.modes.incoming)
    conditions = np.empty((len(rows), len(modes)), complex)
    for row, (place, level, steps, weights) in enumerate(rows):
        factors = weights * wave.factor ** -level.astype(float)
        if steps.shape[1] > 1:
            factors = factors * np.exp(1j * wave.along[0] * steps[:, 1])
        conditions[row] = modes**place - factors @ modes ** (place + steps[:, :1])
    back = np.linalg.lstsq(conditions[:, :-1], -conditions[:, -1], rcond=None)[0]
    return float(np.sqrt((np.abs(back[wave.modes.travels]) ** 2).sum()))

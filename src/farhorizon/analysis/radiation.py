"""What forces on a lattice radiate at a frequency: patterns, energies, and cross sections for plane waves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from farhorizon import kinds
from farhorizon.analysis.references.infinite_lattice import Scheme
from farhorizon.analysis.wave_surface import along, carried_band, outgoing
from farhorizon.errors import InputError

#: Types of waves by the number of components of the field, the fastest first.
WAVES = {1: ("wave",), 2: ("P", "S"), 3: ("P", "S1", "S2")}
#: The same, with both S waves as one type.
KINDS = {1: ("wave",), 2: ("P", "S"), 3: ("P", "S")}
_BLOCK = 1 << 22  # complex numbers that are processed at a time
_NEAREST = 1e-6  # part of the band excluded at its ends, where nothing travels
_SUMMED = 1e-9  # relative difference between sums over more and over fewer directions at which they have converged
_MOST = 512  # largest number of rings of directions


class CrossSections(NamedTuple):
    """Cross sections of a scatterer, (F,): power over incident power per area (in two dimensions per length)."""

    #: Of the scattered power, which leaves the box.
    scattering: np.ndarray
    #: Of the power removed from the wave, scattered or absorbed: by the optical theorem, from forward scattering.
    total: np.ndarray


@dataclass(frozen=True, eq=False)
class Pattern:
    r"""Radiated waves by frequency, type and direction.

    At a distance r from the origin of the coordinates, along a direction, the spectrum of the field (with the sign and
    the scale of `FarField.frequencies`) approaches

    .. math:: \sum_\text{waves} A\,e\;\frac{\exp(-i\,k \cdot x)}{r^{(\text{dim} - 1)/2}},

    without the terms that decay faster. Relative to this, these are of the order of a wavelength over r, or of the
    squared size of the radiating region over a wavelength and r.

    Attributes
    ----------
    frequencies : ndarray, shape (F,)
        Cycles per time.
    directions : ndarray, shape (D, dim)
        Unit vectors, along which energy travels.
    waves : tuple of str
        "wave" for a scalar; "P" and "S", in space "P", "S1" and "S2", the faster S wave first. Where both S waves
        coincide, they are any two at right angles.
    amplitudes : ndarray of complex, shape (F, B, D)
        A, in units of the field times time times length^((dim - 1) / 2).
    polarisations : ndarray of complex, shape (F, B, D, components)
        e, of unit length.
    wave_vectors : ndarray of complex, shape (F, B, D, dim)
        k, in 1/length, which points along the direction only approximately, and less so in anisotropic media. Its
        imaginary part, below zero, is due to damping.
    intensities : ndarray, shape (F, B, D)
        Energy per frequency and angle (in space, solid angle; in one dimension, per side): integrated over positive
        frequencies, the energy that passes through a sphere without damping.
    cross_sections : ndarray, shape (F, B, D), or None
        For a run with one incident wave, the differential scattering cross section: power per angle over the incident
        power per area (in two dimensions, per length).
    """

    frequencies: np.ndarray
    directions: np.ndarray
    waves: tuple[str, ...]
    amplitudes: np.ndarray
    polarisations: np.ndarray
    wave_vectors: np.ndarray
    intensities: np.ndarray
    cross_sections: np.ndarray | None = None

    def spectrum(self, distance: float) -> np.ndarray:
        """The spectrum of the field at a distance from the origin in each direction, according to the pattern.

        Parameters
        ----------
        distance : float

        Returns
        -------
        ndarray of complex, shape (F, D[, components])
        """
        r, across = kinds.number(distance, "distance", above=0), self.directions.shape[1] - 1
        phases = np.exp(-1j * r * np.einsum("fbdi,di->fbd", self.wave_vectors, self.directions))
        waves = (self.amplitudes * phases)[..., None] * self.polarisations
        field = waves.sum(1) / r ** (across / 2)
        return np.asarray(field[..., 0] if len(self.waves) == 1 else field)


def squared_frequency(scheme: Scheme, frequency: float) -> complex:
    """The eigenvalue of the symbol for which a wave has a frequency, in cycles per time, with the time steps and the
    damping of the scheme.
    """
    factor = np.exp(-2j * np.pi * frequency * scheme.dt)
    eigenvalue = complex(-scheme.recursion.eigenvalue(factor) / scheme.rate)
    return eigenvalue if scheme.recursion.keep < 1 else complex(eigenvalue.real)


def checked_frequencies(scheme: Scheme, frequencies: Any, key: str) -> np.ndarray:
    """Frequencies, checked to be such that the lattice of a scheme for waves carries their waves in all directions;
    InputError otherwise.
    """
    checked = np.atleast_1d(kinds.array(frequencies, key))
    checked = kinds.array(checked, key, shape=(None,))
    if not checked.size:
        return checked
    if scheme.order != 2:
        raise InputError(
            "only waves have a pattern by frequency",
            value=checked,
            limit="Wave or Elastic",
            key=key,
            remedy="FarField.at, in time, serves",
        )
    nyquist = 0.5 / scheme.dt
    roots = np.sqrt(np.array(carried_band(scheme.stencil)) * scheme.rate) * scheme.dt / 2
    lowest, highest = np.arcsin(np.minimum(roots, 1.0)) * 2 * nyquist / np.pi
    width = highest - lowest
    wrong = checked[(checked <= lowest + _NEAREST * width) | (checked >= highest - _NEAREST * width)]
    if wrong.size:
        raise InputError(
            "the lattice does not carry waves of this frequency in all directions",
            value=float(wrong[0]),
            limit=f"{lowest:.4g} to {highest:.4g} cycles per time; the time steps end at {nyquist:.4g}",
            key=key,
            remedy="a lower frequency, or a finer lattice" if wrong[0] > lowest else "a higher frequency",
        )
    return checked


def as_directions(given: Any, dim: int, key: str) -> np.ndarray:
    """Unit vectors (D, dim) from vectors, or from a number of evenly spaced ones: both directions on a line, angles
    from the x axis in the plane, in space that number in each of the planes xy, yz and zx.
    """
    if isinstance(given, int) and not isinstance(given, bool):
        turn = 2 * np.pi * np.arange(kinds.integer(given, key, least=1)) / given
        circle = np.stack([np.cos(turn), np.sin(turn), np.zeros(given)], -1)
        if dim == 1:
            return np.array([[1.0], [-1.0]])
        return circle[:, :2] if dim == 2 else np.concatenate([np.roll(circle, axis, 1) for axis in range(3)])
    vectors = kinds.array(np.atleast_2d(kinds.array(given, key)), key, shape=(None, dim))
    lengths = np.linalg.norm(vectors, axis=1)
    if not len(vectors) or not lengths.all():
        raise InputError(
            "directions are one or more vectors that are not zero",
            value=given,
            limit="length > 0",
            key=key,
            remedy="a number of even directions, or vectors of any length",
        )
    return vectors / lengths[:, None]


def waves_sent(
    scheme: Scheme, squared: complex, nodes: np.ndarray, forces: np.ndarray, directions: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Amplitudes (B, D), polarisations, wave vectors and slopes of the waves that forces radiate, for unit spacing; as
    `WavesByEnergyDirection`, with the slopes of the operator's eigenvalue.

    The forces (components, W) at positions (W, dim), in spacings, are accelerations with time dependence ``exp(-i omega
    t)``; `squared` is from `squared_frequency`.
    """
    waves = outgoing(scheme.stencil, squared, directions)
    sums = transform(nodes, forces, waves.wave_vectors)
    amplitudes = (waves.projections * sums).sum(-1) * waves.amplitudes / scheme.rate
    return amplitudes, waves.polarisations, waves.wave_vectors, scheme.rate * waves.slopes


def transform(nodes: np.ndarray, forces: np.ndarray, wave_vectors: np.ndarray) -> np.ndarray:
    """``sum_j f_j exp(-i k . x_j)``, shape (.., components), for wave vectors of shape (.., dim)."""
    vectors = wave_vectors.reshape(-1, wave_vectors.shape[-1])
    rows = max(1, _BLOCK // len(nodes))
    parts = [np.exp(-1j * vectors[start : start + rows] @ nodes.T) @ forces.T for start in range(0, len(vectors), rows)]
    return np.concatenate(parts).reshape(*wave_vectors.shape[:-1], len(forces))


def powers_sent(scheme: Scheme, squared: float, nodes: np.ndarray, forces: np.ndarray) -> np.ndarray:
    r"""Twice the mean power that forces radiate in each of `KINDS`, over mass and frequency, for unit spacing; in space
    both S waves together, as each alone has edges where they touch. Arguments as for `waves_sent`, without damping.

    With the Green function as an integral over wave vectors, :math:`\mathrm{Im} \sum f^* G f` is

    .. math:: \frac{\pi}{(2\pi)^\text{dim}} \oint \frac{|e^H F(k)|^2}{|\nabla \lambda|}\,dS

    over the wave surfaces :math:`\lambda(k) = \Omega^2`, where F is the transform of the forces. This is an integral
    over directions of k, exact on the lattice, whether or not several waves of a type travel in one direction.
    """
    rings = (
        int(np.linalg.norm(np.ptp(nodes, axis=0)) * np.sqrt(squared)) + 12
    )  # a node an angle of phase; then more until nothing changes
    before = _over_surfaces(scheme, squared, nodes, forces, rings)
    while scheme.stencil.dim > 1:
        rings += rings // 2
        powers = _over_surfaces(scheme, squared, nodes, forces, rings)
        if np.abs(powers - before).max() <= _SUMMED * powers.sum() or rings > _MOST:
            return powers
        before = powers
    return before


def _over_surfaces(scheme: Scheme, squared: float, nodes: np.ndarray, forces: np.ndarray, rings: int) -> np.ndarray:
    dim = scheme.stencil.dim
    rays, weights = all_around(dim, rings)
    waves = along(scheme.stencil, squared, rays)
    sums = np.abs((waves.projections * transform(nodes, forces, waves.wave_vectors)).sum(-1)) ** 2
    sizes = np.linalg.norm(waves.wave_vectors, axis=-1) ** (dim - 1) / (waves.gradients * rays).sum(-1)
    powers = np.pi / (2 * np.pi) ** dim / scheme.rate * (weights * sizes * sums).sum(-1)
    return np.append(powers[:1], powers[1:].sum()) if len(powers) > 1 else np.asarray(powers)


def all_around(dim: int, rings: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions (D, dim) and weights (D,) of a quadrature over all directions: both directions on a line, evenly
    spaced angles in the plane, in space Gauss-Legendre nodes along z and evenly spaced azimuths.
    """
    turns = np.pi * np.arange(2 * rings) / rings
    circle, even = np.stack([np.cos(turns), np.sin(turns)], -1), np.full(2 * rings, np.pi / rings)
    if dim == 1:
        return np.array([[1.0], [-1.0]]), np.ones(2)
    if dim == 2:
        return circle, even
    heights, weights = np.polynomial.legendre.leggauss(rings)
    around = np.sqrt(1 - heights**2)[:, None, None] * circle
    rays = np.concatenate([around, np.broadcast_to(heights[:, None, None], (*around.shape[:2], 1))], -1)
    return rays.reshape(-1, 3), np.outer(weights, even).ravel()


@dataclass(frozen=True, eq=False)
class ArrivingPlane:
    """The spectrum of a plane wave at one frequency, for unit spacing: the sum of its B branches."""

    amplitudes: np.ndarray  # at the origin, with time dependence ``exp(-i omega t)``
    wave_vectors: np.ndarray
    polarisations: np.ndarray
    slopes: np.ndarray  # lengths of the gradients of the operator's eigenvalue

    @classmethod
    def of(
        cls,
        scheme: Scheme,
        squared: complex,
        direction: np.ndarray,
        vector: np.ndarray | None,
        amplitude: complex,
        place: float,
    ) -> ArrivingPlane:
        """The wave whose displacement along `vector` (None for a scalar) is `amplitude` on the plane at the distance
        `place` along its path.
        """
        waves = along(scheme.stencil, squared.real, direction[None])
        # the choice of `PlanePulse`: the fastest branch, or those at right angles to it
        used = slice(0, 1) if vector is None or abs(vector @ direction) > 0.5 else slice(1, None)
        vectors, shapes = waves.wave_vectors[used, 0], waves.polarisations[used, 0]
        parts = np.ones(1) if vector is None else shapes.conj() @ vector
        phases = np.exp(-1j * (vectors @ direction) * place)
        slopes = scheme.rate * np.linalg.norm(waves.gradients[used, 0], axis=-1)
        return cls(amplitude * parts * phases, vectors, shapes, slopes)

    def field(self, nodes: np.ndarray) -> np.ndarray:
        """The wave at positions (W, dim), shape (components, W)."""
        phases = np.exp(1j * nodes @ self.wave_vectors.T)
        return np.asarray((phases * self.amplitudes @ self.polarisations).T)

    @property
    def strength(self) -> float:
        """Twice the mean power per area, over mass and frequency (see `FarField.energy`)."""
        return float((np.abs(self.amplitudes) ** 2 * self.slopes).sum() / 2)

    def work(self, nodes: np.ndarray, forces: np.ndarray) -> float:
        """Twice the mean power that forces which replace a scatterer extract from the wave, in the same units."""
        sums = transform(nodes, forces, self.wave_vectors)
        return float(((self.polarisations.conj() * sums).sum(-1) * self.amplitudes.conj()).sum().imag)

"""Modes of the half-infinite lattice in front of a flat side, at one frequency and one wavenumber along the side.

For such a wave the medium is a chain along the normal, for vectors one of d x d blocks. At a factor z per step it
carries 2 K d modes ``v zeta^j`` (K the reach of the stencil along the normal): the incoming wave, K d modes that leave
the side or decay away from it, and others that come to the side or decay towards it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg
from scipy.linalg import lapack
from scipy.optimize import linear_sum_assignment

from farhorizon.analysis.exact.chain import Recursion
from farhorizon.errors import InputError
from farhorizon.medium.stencil import Stencil
from farhorizon.rounding import TINY

ALIKE = 1e-6  # modes whose factors differ by less are polarisations of one wave
_TYPES = {1: ("",), 2: ("P", "S"), 3: ("P", "SV", "SH")}  # types of waves, by components of the field
_UNIT = 1e-8  # a mode whose factor has a modulus nearer to 1 propagates
_MEANT = 0.1  # part of the largest overlap with a polarisation above which a wave has that polarisation
# a mode that decays by more over a node is negligible two nodes away; infinite where the outermost weights are singular
_FAR = 1e5


@dataclass(frozen=True)
class Modes:
    """Modes of a chain at one factor per step: factor per node and polarisation (d,) of the wave that comes to the
    side, factors (n,) and polarisations (n, d) of those that leave it or decay, and which of these propagate (if none
    does, the one that reaches farthest).
    """

    incoming: complex
    vector: np.ndarray
    leaving: np.ndarray
    vectors: np.ndarray
    travels: np.ndarray


def chain_weights(stencil: Stencil, angles: Sequence[float]) -> np.ndarray:
    """Weights of the offsets -K .. K along the first axis for waves of given wavenumbers times spacing along the other
    axes, with the sum over all bonds and the reaction subtracted from the middle one; shape (2 K + 1,[ d, d]), complex.
    """
    reach = stencil.reach[0]
    weights = np.zeros((2 * reach + 1, *stencil.weights.shape[1:]), complex)
    phase = np.exp(1j * stencil.offsets[:, 1:] @ np.asarray(angles, float))
    np.add.at(weights, stencil.offsets[:, 0] + reach, (stencil.weights.T * phase).T)
    weights[reach] -= stencil.weights.sum(0) + stencil.own
    return weights


def chain_roots(blocks: np.ndarray, eigenvalue: complex) -> tuple[np.ndarray, np.ndarray]:
    """Factors and polarisations, shapes (n,) and (n, d), of ``sum_k B_k zeta^k v = eigenvalue v``, by the companion
    pencil of the polynomial.
    """
    size, d = len(blocks) - 1, blocks.shape[1]
    polynomial = blocks.astype(complex)
    polynomial[size // 2] -= eigenvalue * np.eye(d)
    polynomial /= np.abs(polynomial).max()
    left, right = np.eye(size * d, k=d, dtype=complex), np.eye(size * d, dtype=complex)
    left[-d:] = -np.concatenate(polynomial[:-1], axis=1)
    right[-d:, -d:] = polynomial[-1]
    # beta = 0 where the outermost weights are singular. Chains are small, and half-spaces solve hundreds of them: the
    # overhead of `linalg.eig` around the same call would double the time
    alpha, beta, _, eigenvectors, _, failed = lapack.zggev(left, right, compute_vl=0)
    if failed:
        raise np.linalg.LinAlgError("the modes of a chain were not found")
    finite = (np.abs(alpha) < _FAR * np.abs(beta)) & (np.abs(alpha) > np.abs(beta) / _FAR)
    roots, eigenvectors = alpha[finite] / beta[finite], eigenvectors[:, finite]
    vectors = np.where(np.abs(roots) < 1, eigenvectors[:d], eigenvectors[-d:]).T  # v, or v zeta^(2 K - 1)
    return roots, vectors / np.linalg.norm(vectors, axis=1)[:, None]


def chain_modes(
    weights: np.ndarray, factor: complex, recursion: Recursion, near: complex, polarisation: np.ndarray | None = None
) -> Modes:
    """All modes for weights as from `chain_weights`, times coefficient / spacing^2; the incoming one, or the mirror
    image of one that leaves, has the factor per node nearest to `near`, for vectors among those of nearly the given
    polarisation (d,). An InputError if no wave comes to the side.
    """
    blocks = weights.reshape(len(weights), *weights.shape[1:] or (1, 1))
    roots, vectors = chain_roots(blocks, complex(recursion.eigenvalue(np.array(factor))))
    comes = _comes_to_the_side(blocks, roots, vectors, factor, recursion)
    # number of modes each way, fewer where the outermost weights are singular
    count = (len(weights) // 2) * vectors.shape[1]
    if not comes.any() or not 0 < (~comes).sum() <= count:  # or overdamped: nothing travels
        raise InputError("no wave of this frequency and wavenumber comes to the side", value=near)
    distance = np.minimum(np.abs(roots - near), np.abs(roots - 1 / near))
    if polarisation is not None:  # a wave of another polarisation may be as near
        overlap = np.abs(vectors.conj() @ polarisation)
        distance = np.where(overlap > _MEANT * overlap[comes].max(), distance, np.inf)
    incoming = roots[comes][np.argmin(distance[comes])]
    leaving = roots[~comes]
    travels = np.abs(np.abs(leaving) - 1) <= _UNIT + 2 * abs(abs(incoming) - 1)
    if not travels.any():  # evanescent towards the side, and reflected as evanescent away from it
        travels[np.argmin(np.abs(leaving))] = True
    degenerate = vectors[comes & (np.abs(roots - incoming) < ALIKE)]
    basis = degenerate.T if len(degenerate) == 1 else linalg.qr(degenerate.T, mode="economic")[0]
    vector = basis @ basis.conj().T @ (np.ones(1) if polarisation is None else polarisation)
    return Modes(complex(incoming), vector / np.linalg.norm(vector), leaving, vectors[~comes], travels)


def _comes_to_the_side(
    blocks: np.ndarray, roots: np.ndarray, vectors: np.ndarray, factor: complex, recursion: Recursion
) -> np.ndarray:
    """Which modes come to the side or decay towards it, by their group velocity where they propagate; shape (n,)."""
    powers = np.arange(len(blocks)) - len(blocks) // 2
    # zeta dL/dzeta for each mode
    slope = np.einsum("ni,kij,nj,nk->n", vectors.conj(), blocks, vectors, powers * roots[:, None] ** powers)
    step = 1e-6  # of a central difference: its error is of the order of 1e-12
    rise = (
        recursion.eigenvalue(np.array(factor * (1 + step))) - recursion.eigenvalue(np.array(factor * (1 - step)))
    ) / (2 * step)
    excess = np.abs(roots) - 1
    # a wave that grows in time is smaller the farther it has travelled: one that comes to the side decays towards it
    return np.where(np.abs(excess) > _UNIT, excess, (rise / np.where(slope == 0, TINY, slope)).real) < 0


def types_of(components: int, dim: int) -> tuple[str, ...]:
    """Types of the waves of a field, by its number of components and dimensions: one without a name for a scalar; P and
    S, in space SV and SH, for a vector. If there are more components, the first ones form a vector, and the waves of
    the others are numbered.
    """
    if components in (1, dim):
        return _TYPES[components]
    vector = _TYPES[dim] if components > dim else ()
    return vector + tuple(f"u{number}" for number in range(len(vector) + 1, components + 1))


def polarisations(components: int, dim: int, angle: float, azimuth: float = 0.0) -> np.ndarray:
    """Polarisations of long waves in an isotropic medium, in the order of `types_of`, as rows of shape (components,
    components).

    `angle` (radians) is between the wave vector and the normal, the first axis; in 3D `azimuth` is between its
    tangential part and the second axis. SV lies in the plane of incidence, SH along the side.
    """
    if components != dim:
        rows = np.eye(components)
        if components > dim:
            rows[:dim, :dim] = polarisations(dim, dim, angle, azimuth)
        return rows
    if components == 1:
        return np.ones((1, 1))
    along = [1.0] if components == 2 else [np.cos(azimuth), np.sin(azimuth)]
    plane = np.array(
        [[np.cos(angle), *(np.sin(angle) * t for t in along)], [-np.sin(angle), *(np.cos(angle) * t for t in along)]]
    )
    return plane if components == 2 else np.vstack([plane, [0.0, -along[1], along[0]]])


def eigenvalue_of_type(symbol: np.ndarray, polarisation: np.ndarray, number: int) -> float:
    """Eigenvalue of a symbol (d, d) or () that belongs to the type of wave with this row of `polarisations`."""
    values, vectors = np.linalg.eigh(np.reshape(symbol, polarisation.shape))
    _, branch = linear_sum_assignment(-(np.abs(polarisation @ vectors) ** 2))
    return float(values[branch[number]])


def factor_of_wave(eigenvalue: float, recursion: Recursion) -> complex:
    """Factor per step, with a phase that decreases in time, of a wave for which an operator has a real `eigenvalue`;
    for first order in time, the factor of the decaying mode.
    """
    half = (1 + recursion.keep + recursion.gain(eigenvalue)) / 2
    if recursion.keep == 0:
        return complex(2 * half)
    return complex(half - np.sqrt(complex(half**2 - recursion.keep)))


@dataclass(frozen=True)
class ArrivingWave:
    """A wave that meets a side, with the weights of its chain, its tangential wavenumbers (dim - 1,) and its factor per
    step.
    """

    weights: np.ndarray
    along: np.ndarray
    modes: Modes
    factor: complex
    recursion: Recursion
    dt: float

    @property
    def s(self) -> complex:
        """Discrete frequency of the trapezoidal rule, ``2/dt (z - 1)/(z + 1)``."""
        return 2 / self.dt * (self.factor - 1) / (self.factor + 1)

    @property
    def eigenvalue(self) -> complex:
        """Eigenvalue of the operator, in 1/time^2 (waves) or 1/time (diffusion)."""
        return complex(self.recursion.eigenvalue(np.array(self.factor)))


@dataclass(frozen=True)
class LatticeMedium:
    """An unbounded medium and its time integration; the stencil's first axis is the normal of the side at which waves
    arrive, the coefficient a squared speed or diffusivity.
    """

    stencil: Stencil
    coefficient: float
    spacing: float
    recursion: Recursion
    dt: float

    @property
    def rate(self) -> float:
        """``coefficient / spacing^2``."""
        return self.coefficient / self.spacing**2

    def wave(
        self,
        along: Sequence[float] | np.ndarray,
        factor: complex,
        near: complex,
        polarisation: np.ndarray | None = None,
    ) -> ArrivingWave:
        """The wave of a factor per step and tangential wavenumbers times spacing; see `chain_modes`."""
        along = np.asarray(along, float)
        weights = self.rate * chain_weights(self.stencil, along.tolist())
        modes = chain_modes(weights, factor, self.recursion, near, polarisation)
        return ArrivingWave(weights, along, modes, factor, self.recursion, self.dt)

    def plane_wave(self, wavelength: float, angle: float, azimuth: float = 0.0, number: int = 0) -> ArrivingWave:
        """A plane wave, for schemes of second order in time; an InputError if it is too short for the lattice, or the
        integrator has several stages.

        The wavelength is in spacings, `angle` (degrees) is between the wave vector and the normal, in 3D `azimuth`
        between its tangential part and the first axis along the side; `number` is that of its type among `types_of`.
        """
        wavenumber, tilt, turn = 2 * np.pi / wavelength, np.radians(angle), np.radians(azimuth)
        along = wavenumber * np.sin(tilt) * np.array([np.cos(turn), np.sin(turn)])[: self.stencil.dim - 1]
        normal = wavenumber * np.cos(tilt)
        rows = polarisations(self.stencil.components, self.stencil.dim, float(tilt), float(turn))
        factor = factor_of_wave(
            -self.rate * eigenvalue_of_type(self.stencil.symbol(normal, *along), rows, number), self.recursion
        )
        return self.wave(along, factor, np.exp(1j * normal), rows[number])

    def diffusion_wave(self, wavelength: float, angle: float) -> ArrivingWave:
        """The field that diffuses from a source of one frequency, ``exp(i w t - (a + i b) x + i q y)``, whose phase
        travels towards the side while it decays.

        In the continuum ``(a + i b)^2 = q^2 + (r + i w) / D``, with the reaction r; without it ``b = sqrt(w cos(angle)
        / 2 D)``, ``q = b tan(angle)``, and with it the angle stands for the same q. The layer's stretch does not depend
        on the frequency, so time is taken to be continuous. The wavelength along the normal, ``2 pi sqrt(2 D / w)``, is
        in spacings; the angle (degrees) is between the direction of the phase and the normal.
        """
        tilt = np.radians(angle)
        frequency = 2 * self.rate * (2 * np.pi / wavelength) ** 2
        normal = 2 * np.pi / wavelength * np.sqrt(np.cos(tilt))
        along = np.array([normal * np.tan(tilt), 0.0])[: self.stencil.dim - 1]
        decay = np.sqrt((along**2).sum() + self.stencil.reaction + 1j * frequency / self.rate)
        return self.wave(along, 1 + 1j * frequency * self.recursion.scale, np.exp(-decay))

"""The wave surface of a lattice: the waves of one frequency, and what a point force radiates in each direction."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from farhorizon.errors import InputError
from farhorizon.medium.stencil import Stencil
from farhorizon.rounding import EQUAL, MARGIN, TINY

#: Branches closer to each other than this part of their eigenvalue count as one, as S waves along an axis of symmetry
#: do.
_APART = 1e-5
_RADII = 96  # wavenumbers at which branches are sampled along a ray
_RAYS = {1: 2, 2: 180, 3: 600}  # by dimension: 2 and 8 degrees apart, near enough for Newton's method
_NEWTON, _SETTLED, _STRIDE = 30, 1e-12, 0.3  # steps, relative change at which they end, and longest relative step
_ONTO = 3  # steps from the mean of near branches to one of them: the error, at most `_NEARLY`, is squared thrice
#: Near directions in which both S waves coincide, branches closer than this are replaced by their mean.
_NEARLY = 0.1


@dataclass(frozen=True)
class WavesByEnergyDirection:
    """Waves of one frequency that carry their energy in given directions; the branch with the largest eigenvalue, the
    fastest wave, comes first.
    """

    wave_vectors: np.ndarray  # times spacing, (B, D, dim); real without damping
    slopes: np.ndarray  # derivatives of the symbol's eigenvalue along the direction, that of its gradient, (B, D)
    #: Products of the second derivatives along the principal directions at right angles to it, (B, D); 1 on a line.
    curvatures: np.ndarray
    polarisations: np.ndarray  # displacement of the wave, of unit length, (B, D, components)
    #: Row vectors that project a force on it, (B, D, components): without damping, the conjugates of the polarisations.
    projections: np.ndarray

    @property
    def amplitudes(self) -> np.ndarray:
        r"""Amplitudes radiated in each direction by a unit force at a node, shape (B, D): at a distance of r nodes the
        field is the polarisation times ``amplitude * exp(i k . x) / r**((dim - 1) / 2)``, up to terms that decay
        faster.

        The integral of a plane wave over its Brillouin zone, divided by :math:`\lambda(k) - \Omega^2`, has the residue
        :math:`i/g` on the wave surface, where g is the slope. Along the surface its phase is stationary where the
        gradient of the eigenvalue points to the receiver, and each principal direction contributes :math:`\sqrt{g / (2
        \pi i\, r h)}`, where h is the second derivative (Lighthill, Phil. Trans. R. Soc. A 252 (1960) 397, section 4).
        """
        across = self.wave_vectors.shape[-1] - 1
        return 1j / self.slopes * np.sqrt(self.slopes / (2j * np.pi)) ** across / np.sqrt(self.curvatures)


def outgoing(stencil: Stencil, squared: complex, directions: np.ndarray) -> WavesByEnergyDirection:
    """The waves of one frequency whose group velocity points in given directions, unit vectors (D, dim); an InputError
    if several waves of one branch travel in one direction.

    `squared` is the squared frequency in units of ``coefficient / spacing^2``: the eigenvalue of the symbol, between
    the limits of `carried_band`. Its imaginary part, above zero, is that of a damped wave.
    """
    start = _start(stencil, squared.real, directions)
    branches = [_branch(stencil, squared, directions, angles, number) for number, angles in enumerate(start)]
    settled = np.stack([branch[0] for branch in branches])
    vectors, slopes, curvatures, shapes, rows = (np.stack(values) for values in list(zip(*branches, strict=True))[1:])
    if stencil.components == 3:
        # near a corner of the surfaces of both S waves a single branch has no wave, but their mean is smooth
        (corners,) = np.nonzero(~settled[1:].all(0))
        for number in (1, 2) if corners.size else ():
            mean = _branch(stencil, squared, directions[corners], start[number, corners], number, _NEARLY)
            for branch_values, replacement in zip(
                (settled, vectors, slopes, curvatures, shapes, rows), mean, strict=True
            ):
                branch_values[number, corners] = replacement
        _set_apart(stencil, vectors, shapes, rows)
    if not settled.all():
        raise InputError(
            "no wave of this frequency is found for some direction",
            value=f"{squared:.4g} coefficient / spacing^2, squared",
            key="far_field.frequencies",
            remedy="a lower frequency, or a finer lattice",
        )
    _fix_phases(shapes, rows, directions)
    return WavesByEnergyDirection(vectors, slopes, curvatures, shapes, rows)


def _fix_phases(shapes: np.ndarray, rows: np.ndarray, directions: np.ndarray) -> None:
    """Fix the phases of the displacements, which are arbitrary as computed: P waves point along the direction, S waves
    in the plane to its left, in space along their largest component.
    """
    along = np.zeros(shapes.shape)
    largest = np.abs(shapes).round(6).argmax(-1)
    np.put_along_axis(along, largest[..., None], 1.0, -1)
    if shapes.shape[-1] > 1:
        along[0] = directions
    if shapes.shape[-1] == 2:
        along[1] = np.stack([-directions[:, 1], directions[:, 0]], -1)
    phase = np.exp(1j * np.angle((shapes * along).sum(-1)))[..., None]
    shapes /= phase
    rows *= phase


def _set_apart(stencil: Stencil, vectors: np.ndarray, shapes: np.ndarray, rows: np.ndarray) -> None:
    """Take both S waves from one decomposition where they coincide; from two decompositions, their polarisations need
    not be orthogonal.
    """
    (equal,) = np.nonzero(np.abs(vectors[1] - vectors[2]).max(1) < MARGIN * np.abs(vectors[1]).max(1))
    for number in (1, 2) if equal.size else ():
        *_, shapes[number, equal], rows[number, equal] = _expansion(stencil, vectors[1, equal].astype(complex), number)


@dataclass(frozen=True)
class WavesByPhaseDirection:
    """Waves of one frequency whose phases travel in given directions.

    The last two fields are as in `WavesByEnergyDirection`.
    """

    wave_vectors: np.ndarray  # times spacing, (B, D, dim); the fastest wave comes first
    gradients: np.ndarray  # of the symbol's eigenvalue, in whose direction energy travels, (B, D, dim)
    polarisations: np.ndarray
    projections: np.ndarray


def along(stencil: Stencil, squared: float, directions: np.ndarray) -> WavesByPhaseDirection:
    """The waves of one frequency whose phases travel in given directions, unit vectors (D, dim); `squared` as for
    `outgoing`, without damping.
    """
    lengths, roots = _radial(stencil, directions)
    branches = []
    for number, branch in enumerate(roots):
        length = _crossing(lengths, branch, squared)
        for _ in range(_NEWTON):
            value, gradient, *_ = _expansion(stencil, length[:, None] * directions + 0j, number, 0.0)
            change = (value.real - squared) / (gradient * directions).sum(1).real
            length = length - change
            if (np.abs(change) < _SETTLED * length).all():
                break
        vectors = length[:, None] * directions
        gradient, _, *shapes = _expansion(stencil, vectors + 0j, number, 0.0)[1:]
        branches.append((vectors, gradient.real, *shapes))
    vectors, gradients, polarisations, rows = (np.stack(values) for values in zip(*branches, strict=True))
    if stencil.components == 3:
        _set_apart(stencil, vectors, polarisations, rows)
    return WavesByPhaseDirection(vectors, gradients, polarisations, rows)


def carried_band(stencil: Stencil) -> tuple[float, float]:
    """Limits of the squared frequency, in units of ``coefficient / spacing^2``, between which each branch has one
    closed wave surface around k = 0.

    Up to the upper limit the eigenvalue grows along each ray from k = 0; above it, waves of a wavelength of a few nodes
    run backward, or do not travel in some directions. Below the lower limit, the reaction, nothing travels.
    """
    zone, values, slopes = stencil.zone_branches
    outward = sum((k[..., None] * slope for k, slope in zip(zone, slopes, strict=True)), np.zeros(()))
    moving = sum((k**2 for k in zone), np.zeros(()))[..., None] > 0
    backward = np.broadcast_to(moving, values.shape) & (outward <= EQUAL * values.max())
    return stencil.reaction, float(values[backward].min())


@lru_cache(maxsize=8)
def _rays(stencil: Stencil) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit vectors (R, dim), wavenumbers on each up to the edge of the zone (R, n), and the square roots of the
    branches there, the largest first (B, R, n).
    """
    count = _RAYS[stencil.dim]
    if stencil.dim < 3:
        turn = 2 * np.pi * (np.arange(count) + 0.5 * (stencil.dim > 1)) / count
        rays = np.stack([np.cos(turn), np.sin(turn)], -1)[:, : stencil.dim]
    else:
        height, turn = 1 - (2 * np.arange(count) + 1) / count, np.pi * (1 + np.sqrt(5)) * np.arange(count)
        across = np.sqrt(1 - height**2)
        rays = np.stack([across * np.cos(turn), across * np.sin(turn), height], -1)
    return rays, *_radial(stencil, rays)


def _radial(stencil: Stencil, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Wavenumbers along rays up to the edge of the zone (R, n), and square roots of the branches there (B, R, n)."""
    lengths = np.pi / np.abs(rays).max(1)[:, None] * np.linspace(0, 1, _RADII)
    values = stencil.branches(*np.moveaxis(rays[:, None] * lengths[..., None], -1, 0))
    return lengths, np.moveaxis(np.sqrt(np.maximum(values, 0.0)), -1, 0)[::-1]


def _crossing(lengths: np.ndarray, branch: np.ndarray, squared: float) -> np.ndarray:
    """Wavenumbers at which a branch reaches a squared frequency, interpolated between the samples; shape (R,)."""
    rows, first = np.arange(len(lengths)), np.argmax(branch > np.sqrt(squared), axis=1)
    below, above = branch[rows, first - 1], branch[rows, first]
    fraction = (np.sqrt(squared) - below) / (above - below)
    return np.asarray(lengths[rows, first - 1] + fraction * (lengths[rows, first] - lengths[rows, first - 1]))


def _start(stencil: Stencil, squared: float, directions: np.ndarray) -> np.ndarray:
    """Wave vectors (B, D, dim) of undamped waves whose group velocity approximately points in the directions; an
    InputError if the wave surface is not convex.
    """
    rays, lengths, roots = _rays(stencil)
    starts: list[np.ndarray] = []
    for branch in roots:
        angles = rays * _crossing(lengths, branch, squared)[:, None]
        number = len(starts)
        # the mean of S waves in space: where they touch, each has corners, which do not matter where they nearly
        # coincide
        _, slopes, second, *_ = _expansion(stencil, angles.astype(complex), number, _NEARLY)
        normals = (slopes / np.linalg.norm(slopes, axis=1)[:, None]).real
        if (_across(second, normals).real <= 0).any():
            raise InputError(
                "waves of this frequency go in some directions by several ways: the wave surface is not convex",
                value=f"{squared:.4g} coefficient / spacing^2, squared",
                key="far_field.frequencies",
                remedy="a lower frequency, or a finer lattice",
            )
        starts.append(angles[np.argmax(directions @ normals.T, axis=1)])
    return np.stack(starts)


def _branch(
    stencil: Stencil, squared: complex, directions: np.ndarray, angles: np.ndarray, number: int, apart: float = _APART
) -> tuple[np.ndarray, ...]:
    """Wave vectors of one branch by Newton's method: whether each was found, and the attributes of
    `WavesByEnergyDirection` for the branch.

    The unknowns are the wave vector and the slope g: the eigenvalue is given, and its gradient is g times the
    direction.
    """
    dim = stencil.dim
    angles = angles.astype(complex)
    value, gradient, second, *shapes = _expansion(stencil, angles, number, apart)
    slope = (gradient * directions).sum(1)
    matrix = np.zeros((len(directions), dim + 1, dim + 1), complex)
    for _ in range(_NEWTON):
        residual = np.concatenate([(value - squared)[:, None], gradient - slope[:, None] * directions], axis=1)
        matrix[:, 0, :dim], matrix[:, 1:, :dim], matrix[:, 1:, dim] = gradient, second, -directions
        change = np.linalg.solve(matrix, residual[..., None])[..., 0]
        size, length = np.abs(change[:, :dim]).max(1), np.abs(angles).max(1)
        change *= np.minimum(1.0, _STRIDE * length / np.maximum(size, TINY))[:, None]
        angles, slope = angles - change[:, :dim], slope - change[:, dim]
        value, gradient, second, *shapes = _expansion(stencil, angles, number, apart)
        settled = size < _SETTLED * length
        if settled.all():
            break
    for _ in range(_ONTO):  # from the mean to the branch's own surface
        value, gradient, _, *shapes = _expansion(stencil, angles, number, 0.0)
        angles = angles - ((value - squared) / (gradient * directions).sum(1))[:, None] * directions
    curvatures = _across(second, directions)
    return settled & (curvatures.real > 0), angles, slope, curvatures, *shapes


def _across(second: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Determinants of matrices (D, dim, dim) restricted to the planes at right angles to the directions."""
    # minus the determinant of the bordered matrix
    dim = directions.shape[1]
    matrix = np.zeros((len(directions), dim + 1, dim + 1), complex)
    matrix[:, :dim, :dim], matrix[:, dim, :dim], matrix[:, :dim, dim] = second, directions, directions
    return -np.linalg.det(matrix)


def _expansion(stencil: Stencil, angles: np.ndarray, number: int, apart: float = _APART) -> tuple[np.ndarray, ...]:
    """A branch at complex wave vectors (D, dim): its eigenvalue, first (D, dim) and second derivatives (D, dim, dim),
    as means over branches that coincide; polarisation and projection (D, components).
    """
    size, offsets = stencil.components, stencil.offsets.astype(float)
    weights = stencil.weights.reshape(-1, size * size)
    phases = np.exp(1j * angles @ offsets.T)
    pairs = offsets[:, :, None] * offsets[:, None, :]
    dim = stencil.dim
    shape = (len(angles), size, size)
    symbol = (weights.sum(0) - phases @ weights).reshape(shape) + stencil.reaction * np.eye(size)
    first = np.stack([(-1j * phases * offsets[:, a]) @ weights for a in range(dim)], 1).reshape(-1, dim, size, size)
    second = np.stack([(phases * pairs[:, a, b]) @ weights for a in range(dim) for b in range(dim)], 1)
    second = second.reshape(-1, dim, dim, size, size)
    values, right, left = _eigen(symbol)
    first = np.einsum("nij,najk,nkl->nail", left, first, right)
    second = np.einsum("nij,nabjk,nki->nabi", left, second, right)
    gaps = values[:, :, None] - values[:, None, :]
    coincide = np.abs(gaps) <= apart * np.abs(values[:, :, None])
    products = np.einsum("naij,nbji->nabij", first, first)
    products = products + products.swapaxes(1, 2)
    second = second + (products / np.where(coincide, np.inf, gaps)[:, None, None]).sum(-1)
    # mean over the branches that coincide with this one
    weight = coincide[:, number] / coincide[:, number].sum(1, keepdims=True)
    return (
        (weight * values).sum(1),
        np.einsum("ni,naii->na", weight, first),
        np.einsum("ni,nabi->nab", weight, second),
        right[:, :, number],
        left[:, number],
    )


def _eigen(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Eigenvalues with the largest real part first, eigenvectors of unit length in columns, and their inverse."""
    if np.abs(matrices - matrices.conj().swapaxes(1, 2)).max() <= 1e-14 * np.abs(matrices).max():
        values, right = np.linalg.eigh(matrices)
        values, right = values[:, ::-1].astype(complex), right[:, :, ::-1]
        return values, right, right.conj().swapaxes(1, 2)
    values, right = np.linalg.eig(matrices)
    order = np.argsort(-values.real, axis=1)
    values, right = np.take_along_axis(values, order, 1), np.take_along_axis(right, order[:, None], 2)
    return values, right, np.linalg.inv(right)

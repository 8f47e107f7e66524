"""Reflection of plane waves by a flat side, from the exact problem on the half-infinite lattice, without a run in time.

Along a side a wave has a tangential wavenumber, and the medium in front of the side is a chain, for vectors one of d x
d blocks. At a factor z per step the chain carries 2 K d modes ``v zeta^j`` (K the reach of the stencil along the
normal): the incoming wave, K d modes that leave the side or decay away from it, and others that come to the side or
decay towards it, which are absent. Near field, layer and memory of the side obey ``z x = G x`` with the map G of one
step; their solution must continue in the incoming wave and the leaving modes. Waves of vectors are classified as P and
S by their polarisation; a side converts one into the other.
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

_TYPES = {1: ("",), 2: ("P", "S"), 3: ("P", "SV", "SH")}  # types of waves, by components of the field
_UNIT = 1e-8  # a mode whose factor has a modulus nearer to 1 propagates
_ALIKE = 1e-6  # modes whose factors differ by less are polarisations of one wave
_MEANT = 0.1  # part of the largest overlap with a polarisation above which a wave has that polarisation
# a mode that decays by more over a node is negligible two nodes away; infinite where the outermost weights are singular
_FAR = 1e5


@dataclass(frozen=True)
class Modes:
    """Modes of a chain at one factor per step; d is the number of components of the field, 1 for a scalar.

    Attributes
    ----------
    incoming : complex
        Factor per node of the wave that comes to the side (towards larger j).
    vector : ndarray of complex, shape (d,)
        Its polarisation, of length 1.
    leaving : ndarray of complex, shape (n,)
        Factors of the modes that leave the side or decay away from it.
    vectors : ndarray of complex, shape (n, d)
        Their polarisations.
    travels : ndarray of bool, shape (n,)
        Which of them propagate; where none does, the one that reaches farthest.
    """

    incoming: complex
    vector: np.ndarray
    leaving: np.ndarray
    vectors: np.ndarray
    travels: np.ndarray


def chain_weights(stencil: Stencil, angles: Sequence[float]) -> np.ndarray:
    """The stencil along its first axis for waves of given tangential wavenumbers times spacing.

    Parameters
    ----------
    stencil : Stencil
    angles : sequence of float
        One for each axis but the first.

    Returns
    -------
    ndarray of complex, shape (2 K + 1,), of matrices (2 K + 1, d, d)
        Weights of the offsets -K .. K, with the sum over all bonds and the reaction subtracted from the middle one.
    """
    reach = stencil.reach[0]
    found = np.zeros((2 * reach + 1, *stencil.weights.shape[1:]), complex)
    phase = np.exp(1j * stencil.offsets[:, 1:] @ np.asarray(angles, float))
    np.add.at(found, stencil.offsets[:, 0] + reach, (stencil.weights.T * phase).T)
    found[reach] -= stencil.weights.sum(0) + stencil.own
    return found


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

    Parameters
    ----------
    components, dim : int
    angle : float
        Between the wave vector and the normal, the first axis, in radians.
    azimuth : float
        In 3D, between its tangential part and the second axis, in radians. SV lies in the plane of incidence, SH along
        the side.
    """
    if components != dim:
        found = np.eye(components)
        if components > dim:
            found[:dim, :dim] = polarisations(dim, dim, angle, azimuth)
        return found
    if components == 1:
        return np.ones((1, 1))
    along = [1.0] if components == 2 else [np.cos(azimuth), np.sin(azimuth)]
    plane = np.array(
        [[np.cos(angle), *(np.sin(angle) * t for t in along)], [-np.sin(angle), *(np.cos(angle) * t for t in along)]]
    )
    return plane if components == 2 else np.vstack([plane, [0.0, -along[1], along[0]]])


def eigenvalue_of_type(symbol: np.ndarray, polarisation: np.ndarray, number: int) -> float:
    """Eigenvalue of a stencil's symbol that belongs to one type of wave.

    Parameters
    ----------
    symbol : ndarray, shape (d, d) or ()
    polarisation : ndarray, shape (d, d)
        As from `polarisations`.
    number : int
        Number of the type, a row of `polarisation`.
    """
    values, vectors = np.linalg.eigh(np.reshape(symbol, polarisation.shape))
    _, branch = linear_sum_assignment(-(np.abs(polarisation @ vectors) ** 2))
    return float(values[branch[number]])


def factor_of_wave(eigenvalue: float, recursion: Recursion) -> complex:
    """Factor per step, with a phase that decreases in time, of a wave for which an operator has a real `eigenvalue`;
    for first order in time, the factor of the decaying mode.
    """
    half = (1 + recursion.keep + recursion.scale * eigenvalue) / 2
    if recursion.keep == 0:
        return complex(2 * half)
    return complex(half - np.sqrt(complex(half**2 - recursion.keep)))


@dataclass(frozen=True)
class Chain:
    """All modes of a chain at one factor per step.

    Attributes
    ----------
    weights : ndarray of complex, shape (2 K + 1,) or (2 K + 1, d, d)
    roots : ndarray of complex, shape (n,)
        Factors per node.
    vectors : ndarray of complex, shape (n, d)
        Polarisations.
    ahead : ndarray of bool, shape (n,)
        Which of them come to the side.
    """

    weights: np.ndarray
    roots: np.ndarray
    vectors: np.ndarray
    ahead: np.ndarray

    @classmethod
    def of(cls, weights: np.ndarray, factor: complex, recursion: Recursion) -> Chain:
        """The modes for weights as from `chain_weights`, times coefficient / spacing^2."""
        blocks = weights.reshape(len(weights), *weights.shape[1:] or (1, 1))
        roots, vectors = chain_roots(blocks, complex(recursion.eigenvalue(np.array(factor))))
        powers = np.arange(len(blocks)) - len(blocks) // 2
        # zeta dL/dzeta for each mode
        slope = np.einsum("ni,kij,nj,nk->n", vectors.conj(), blocks, vectors, powers * roots[:, None] ** powers)
        step = 1e-6
        rise = (
            recursion.eigenvalue(np.array(factor * (1 + step))) - recursion.eigenvalue(np.array(factor * (1 - step)))
        ) / (2 * step)
        apart = np.abs(roots) - 1
        # a wave that grows in time is smaller the farther it has travelled: one that comes to the side decays towards
        # it
        ahead = np.where(np.abs(apart) > _UNIT, apart, (rise / np.where(slope == 0, 1e-300, slope)).real) < 0
        return cls(weights, roots, vectors, ahead)

    def modes(self, near: complex, polarisation: np.ndarray | None = None) -> Modes:
        """Return all modes, for one of them as the incoming wave.

        Parameters
        ----------
        near : complex
            Approximate factor per node of the wave that is meant; if that wave leaves the side (a backward wave), its
            mirror image comes.
        polarisation : ndarray, shape (d,), optional
            Approximate polarisation of the wave, for a field of vectors.

        Raises
        ------
        InputError
            No wave comes to the side.
        """
        roots, vectors, ahead = self.roots, self.vectors, self.ahead
        # number of modes each way, fewer where the outermost weights are singular
        there = (len(self.weights) // 2) * vectors.shape[1]
        if not ahead.any() or not 0 < (~ahead).sum() <= there:  # or overdamped: nothing travels
            raise InputError("no wave of this frequency and wavenumber comes to the side", value=near)
        away = np.minimum(np.abs(roots - near), np.abs(roots - 1 / near))
        if polarisation is not None:  # a wave of another polarisation may be as near
            alike = np.abs(vectors.conj() @ polarisation)
            away = np.where(alike > _MEANT * alike[ahead].max(), away, np.inf)
        incoming = roots[ahead][np.argmin(away[ahead])]
        leaving = roots[~ahead]
        travels = np.abs(np.abs(leaving) - 1) <= _UNIT + 2 * abs(abs(incoming) - 1)
        if not travels.any():  # evanescent towards the side, and reflected as evanescent away from it
            travels[np.argmin(np.abs(leaving))] = True
        alike = vectors[ahead & (np.abs(roots - incoming) < _ALIKE)]
        basis = alike.T if len(alike) == 1 else linalg.qr(alike.T, mode="economic")[0]
        vector = basis @ basis.conj().T @ (np.ones(1) if polarisation is None else polarisation)
        return Modes(complex(incoming), vector / np.linalg.norm(vector), leaving, vectors[~ahead], travels)


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
    # beta = 0 where the outermost weights are singular. Chains are small and solved by the thousand: the overhead of
    # `linalg.eig` around the same call would double the time
    alpha, beta, _, found, _, failed = lapack.zggev(left, right, compute_vl=0)
    if failed:
        raise np.linalg.LinAlgError("the modes of a chain were not found")
    finite = (np.abs(alpha) < _FAR * np.abs(beta)) & (np.abs(alpha) > np.abs(beta) / _FAR)
    roots, found = alpha[finite] / beta[finite], found[:, finite]
    vectors = np.where(np.abs(roots) < 1, found[:d], found[-d:]).T  # v, or v zeta^(2 K - 1)
    return roots, vectors / np.linalg.norm(vectors, axis=1)[:, None]


def reflection(
    matrix: np.ndarray, columns: np.ndarray, levels: Sequence[complex], factor: complex, modes: Modes, reach: int
) -> np.ndarray:
    """Amplitudes of all leaving modes for an incoming wave of amplitude 1, both at the side's end of the near field.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
        Map of one step of a near field whose high end is the side, and of all memory of the side. Its low end is
        arbitrary.
    columns : ndarray of int, shape (levels, d, columns)
        Entries of the state that are the near field's nodes along the normal, at least 2 K + 2 columns.
    levels : sequence of complex
        Amplitude of a wave in each time level: 1 for the field itself.
    factor : complex
        Factor per step.
    modes : Modes
    reach : int
        K.

    Returns
    -------
    ndarray of complex, shape (leaving modes,)
    """
    count, width, size = len(modes.leaving), columns.shape[-1], len(matrix)
    place = np.arange(width) - (width - 1)
    wave = np.multiply.outer(modes.vector, modes.incoming**place)
    away = modes.vectors.T[:, None, :] * modes.leaving ** place[:, None]  # (d, columns, modes)
    system, right = np.zeros((size + count, size + count), complex), np.zeros(size + count, complex)
    system[:size, :size] = factor * np.eye(size) - matrix
    for level, share in zip(columns, levels, strict=True):  # the modes replace the nodes that the low end affects
        rows = level[:, :reach].ravel()
        system[rows] = 0
        system[rows, rows] = 1
        system[rows, size:] = -share * away[:, :reach].reshape(len(rows), count)
        right[rows] = share * wave[:, :reach].ravel()
    # match them at the next nodes, which have at least as many values as there are modes
    known = away[:, reach : 2 * reach].reshape(-1, count)
    turned = linalg.qr(known / np.abs(known).max(0), mode="economic")[0].conj().T
    system[size:, columns[0, :, reach : 2 * reach].ravel()], system[size:, size:] = turned, -turned @ known
    right[size:] = turned @ wave[:, reach : 2 * reach].ravel()
    return np.asarray(np.linalg.solve(system, right)[size:])


def by_type(modes: Modes, amplitudes: np.ndarray, along: np.ndarray, azimuth: float = 0.0) -> dict[str, complex]:
    """Amplitudes of the leaving waves by type; for several of one type, the root of the sum of squares.

    Parameters
    ----------
    modes : Modes
    amplitudes : ndarray of complex
        As from `reflection`.
    along : ndarray
        Tangential wavenumbers times spacing.
    azimuth : float
        Direction of these, in radians.

    Returns
    -------
    dict
        Without the types that do not travel.
    """
    found: dict[str, complex] = {}
    components, dim, left = len(modes.vector), len(along) + 1, modes.travels.copy()
    while left.any():
        alike = left & (np.abs(modes.leaving - modes.leaving[np.argmax(left)]) < _ALIKE)
        left &= ~alike
        field = amplitudes[alike] @ modes.vectors[alike]
        angle = np.arctan2(np.linalg.norm(along), np.angle(modes.leaving[alike][0]))
        basis = linalg.qr(modes.vectors[alike].T, mode="economic")[0]
        shadows = polarisations(components, dim, float(angle), azimuth) @ basis.conj() @ basis.T
        lengths = np.linalg.norm(shadows, axis=1)
        for number in np.argsort(-lengths)[: basis.shape[1]]:
            name, share = types_of(components, dim)[number], complex(np.vdot(shadows[number], field) / lengths[number])
            found[name] = complex(np.sqrt(found[name] ** 2 + share**2)) if name in found else share
    return found

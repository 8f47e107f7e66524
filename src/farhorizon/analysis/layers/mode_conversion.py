"""Mode conversion at a wall: which waves turn into backward waves where a wall reflects them.

A wall reflects a wave into all modes of the same frequency and of the same wavenumber along the wall. On a lattice some
of these are short, and run backward along the wall: their energy travels against their phase. The amplitude of each
mode follows from the equations of the rows next to the wall, for a half-infinite lattice and without a run in time.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import polynomial
from scipy import fft

from farhorizon.analysis.layers.reflection import chain_weights
from farhorizon.medium.stencil import Stencil

_ANGLES = 32  # wavenumbers along each axis
_NEARBY = 1e-3  # distance of the wavenumbers from which slopes are taken
_DAMPED = 1e-6  # relative damping of the squared frequency, which tells modes that leave from those that come
_TRAVELS = 1e-3  # a mode that propagates decays by no more over a node
_BACKWARD = 1e-6  # growth over sigma in a layer from which on a wave counts as a backward one
_TURN = np.exp(0.3j)  # modes that change by -_TURN from node to node would not be found: no wave does exactly that
_GONE = 1e-7  # smallest factor of a mode per node: singular outermost blocks carry fewer modes
_POLARISED = 0.1  # weight of the polarisation in the search for the incident mode, against that of its factor
_SINGULAR = 1e-14  # added to the normal equations at a wall, some of which are empty where modes are lacking
_LARGEST = 10.0  # limit of the amplitudes: waves that hardly leave the wall would have arbitrarily large ones


@dataclass(frozen=True, eq=False)
class Conversion:
    """Amplitudes of the backward waves into which walls convert plane waves.

    Attributes
    ----------
    stencil : Stencil
        In the plane, with the normal of the wall first.
    amplitudes : ndarray, shape (n, n, components)
        Sums over all backward modes, relative to the incident wave, by the magnitudes of the wavenumbers normal to the
        wall and along it, in n intervals up to pi, and by branch.
    """

    stencil: Stencil
    amplitudes: np.ndarray

    def turned(self, values: np.ndarray, component: int = 0) -> tuple[float, float]:
        """Largest amplitude of the backward waves that a wall makes of a field, if all of them meet in phase, and the
        root of the sum of their squares over all nodes; both relative to the largest value of the field.

        Parameters
        ----------
        values : ndarray, shape (n0, n1, ...)
            Not zero everywhere, and taken to be periodic; with the normal of the wall first, and the direction along it
            second. In 3D waves are taken to be converted as in the plane of these two.
        component : int
            To which the values belong.
        """
        angles = [2 * np.pi * np.fft.fftfreq(n) for n in values.shape[:2]]
        intervals = [np.minimum(np.abs(a) * _ANGLES / np.pi, _ANGLES - 1).astype(int) for a in angles]
        amplitudes = self.amplitudes[np.ix_(*intervals)]
        if self.stencil.components > 1:
            shapes = np.linalg.eigh(self.stencil.symbol(*np.ix_(*angles)))[1]
            amplitudes = np.abs(shapes[..., component, :]) * amplitudes
        sent = np.abs(fft.fftn(values)).reshape(*values.shape[:2], -1)
        in_phase = (sent.sum(-1) * amplitudes.sum(-1)).sum() / values.size
        squares = ((sent**2).sum(-1) * (amplitudes**2).sum(-1)).sum() / values.size
        largest = np.abs(values).max()
        return float(in_phase / largest), float(np.sqrt(squares) / largest)


@lru_cache(maxsize=16)
def conversion(stencil: Stencil) -> Conversion:
    """Conversion at walls across the first axis of a stencil, for waves in the plane of its first two axes: at free or
    fixed walls, whichever convert more.
    """
    angles, plane = (np.arange(_ANGLES) + 0.5) * np.pi / _ANGLES, _in_the_plane(stencil)
    return Conversion(plane, np.stack([_converted(plane, angles, along) for along in angles], 1))


def _in_the_plane(stencil: Stencil) -> Stencil:
    """The stencil for waves that are uniform along the third axis, if any; of a scalar field."""
    if stencil.dim == 2:
        return stencil
    offsets, where = np.unique(stencil.offsets[:, :2], axis=0, return_inverse=True)
    weights, others = np.bincount(where.ravel(), stencil.weights), offsets.any(1)
    return Stencil(offsets[others], weights[others], stencil.reaction)


def _converted(stencil: Stencil, normal: np.ndarray, along: float) -> np.ndarray:
    """Amplitudes of the backward waves for one wavenumber along the wall and n normal to it; shape (n, components)."""
    size, reach = stencil.components, stencil.reach[0]
    half, powers = reach * size, np.arange(-reach, reach + 1)
    here, before, after = (
        chain_weights(stencil, [angle]).reshape(-1, size, size) for angle in (along, along - _NEARBY, along + _NEARBY)
    )
    symbol = np.reshape(stencil.symbol(normal, np.full_like(normal, along)), (-1, size, size))
    squared, shapes = np.linalg.eigh(symbol)
    waves = np.repeat(normal, size), squared.ravel(), np.swapaxes(shapes, 1, 2).reshape(-1, size)

    factors, vectors = _modes(here, waves[1] * (1 + 1j * _DAMPED))
    came, polarised = _incident(factors[:, half:], vectors[..., half:], waves[0], waves[2])
    left, leaving = factors[:, :half], vectors[..., :half]
    travels = np.abs(left) > 1 - _TRAVELS
    phases = np.where(travels, left, 1)[..., None] ** powers
    rise = (after - before) / (2 * _NEARBY)
    slope = -np.einsum("niq,mij,njq,nqm->nq", leaving.conj(), rise, leaving, phases, optimize=True).real
    backward = travels & (np.sin(along) * slope < -2 * _BACKWARD * waves[1][:, None])

    bonds = stencil.weights.reshape(-1, size, size)
    absent = np.stack([bonds[stencil.offsets[:, 0] == m].sum(0) for m in powers])
    found = np.zeros(len(left))
    for lacking in (absent, np.zeros_like(absent)):  # a free wall and a fixed one, beyond which nothing moves
        system, given = (_lacking(here, lacking, *modes) for modes in ((left, leaving), (came, polarised)))
        scale = np.abs(system).max(1, keepdims=True)
        system = np.where(np.abs(left)[:, None] > _GONE, system / np.maximum(scale, 1e-300), 0)
        turned = system.conj().swapaxes(1, 2)
        solved = np.linalg.solve(turned @ system + _SINGULAR * np.eye(half), turned @ given)[..., 0]
        amplitudes = np.abs(solved) / np.maximum(scale[:, 0], 1e-300) * np.abs(leaving).max(1)
        found = np.maximum(found, np.where(backward, amplitudes, 0.0).sum(1))
    return np.minimum(found, _LARGEST).reshape(-1, size)


def _modes(blocks: np.ndarray, squared: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Factors per node of the modes of a chain at n squared frequencies, in increasing order of their magnitudes, and
    their polarisations; shapes (n, m) and (n, components, m).

    The factor is a Moebius transform of the eigenvalue of a companion matrix, since the outermost blocks, which would
    be the leading coefficients, may be singular.
    """
    size, degree = blocks.shape[1], len(blocks) - 1
    series = np.broadcast_to(blocks, (len(squared), *blocks.shape)).copy()
    series[:, degree // 2] += squared[:, None, None] * np.eye(size)
    turned = np.zeros((degree + 1, degree + 1), complex)
    for m in range(degree + 1):
        raised = [polynomial.polypow(one, power) for one, power in (([1, 1], m), ([1, -1], degree - m))]
        turned[:, m] = _TURN**m * polynomial.polymul(*raised)
    terms = np.einsum("sm,nmij->nsij", turned, series)
    companion = np.zeros((len(squared), degree * size, degree * size), complex)
    companion[:, :-size, size:] = np.eye((degree - 1) * size)
    last = -np.linalg.solve(terms[:, -1:], terms[:, :-1])
    companion[:, -size:] = np.moveaxis(last, 1, 2).reshape(len(squared), size, -1)
    values, states = np.linalg.eig(companion)
    with np.errstate(divide="ignore", invalid="ignore"):
        factors, vectors = _TURN * (1 + values) / (1 - values), states[:, :size]
    vectors = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)
    factors = np.where(np.abs(factors) < _GONE, _GONE, factors)
    order = np.argsort(np.abs(factors), 1)
    return np.take_along_axis(factors, order, 1), np.take_along_axis(vectors, order[:, None], 2)


def _incident(
    factors: np.ndarray, vectors: np.ndarray, normal: np.ndarray, shape: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Among modes that come to the wall, those that are the given waves, or their mirror images; shapes (n, 1) and (n,
    components, 1).
    """
    wave = np.exp(1j * normal)[:, None]
    away = np.minimum(np.abs(factors - wave), np.abs(factors - wave.conj()))
    alike = np.einsum("ni,nij->nj", np.abs(shape), np.abs(vectors))
    which = (away - _POLARISED * alike).argmin(1)[:, None]
    found = np.take_along_axis(factors, which, 1)
    return found / np.abs(found), np.take_along_axis(vectors, which[:, None], 2)


def _lacking(blocks: np.ndarray, absent: np.ndarray, factors: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """What the rows next to a wall lack of the equations of the infinite chain in each of m modes: forces from beyond
    the wall, and those on their own displacement by `absent` bonds; shape (n, rows times components, m).
    """
    reach = len(blocks) // 2
    rows = []
    for row in range(reach):
        lost = 0
        for m in range(-reach, -row):
            forces = (np.einsum("ij,njq->niq", one, vectors) for one in (blocks[m + reach], absent[m + reach]))
            there, own = forces
            lost = lost + there * factors[:, None] ** (row + m) - own * factors[:, None] ** row
        rows.append(lost)
    return np.concatenate(rows, 1)

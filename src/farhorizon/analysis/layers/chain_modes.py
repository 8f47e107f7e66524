"""Modes of the chain that represents the medium in front of a side for each tangential wavenumber, and their amplitudes
for given data.

A mode changes along the normal by a factor zeta per node. The slowest one carries data farthest. All modes are needed
where some run backward, for vectors in the plane those of both components together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from farhorizon.analysis.layers.layer import LatticeMedium
from farhorizon.engine.parallel import in_parallel
from farhorizon.medium.stencil import Stencil

_NEWTON, _LONGEST = 12, 0.3  # iterations from the root of long waves, and the largest change of log zeta in each
_SETTLED = 1e-8  # relative residual of a root
# for all modes of a chain: relative residual, where two nearly coincide, and the smallest factor per node
_ROUGH, _GONE = 1e-6, 1e-6
_NEARLY = 0.01  # and the largest change of log zeta in an iteration from such a root
_NOTHING = 1e-20  # rows with no more than this part of the largest value are left out
_STEEP = 8.0  # steepness with which waves fade out around 0.7 of the limit of speeds: 1e-8 remains at the limit
_IN_CACHE = 1 << 13  # waves that are processed together
_FLAT = 1e-14  # smallest leading coefficient over the largest one; below it, modes decay at once
_LEVEL = 1e-100  # the same for a slope, which counts as zero below it


def slowest_modes(medium: LatticeMedium, eigenvalue: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Factor per node and ``zeta dA/dzeta`` of the mode that reaches farthest; shape (frequencies, tangential modes).

    The slope is zero where the lattice carries no such wave.
    """
    stencil, rate = medium.stencil, medium.rate
    lines = _lines(stencil, along)
    target = eigenvalue[:, None] / rate
    squared = (4 * np.sin(along / 2) ** 2).sum(0) + stencil.reaction
    exponent = -np.sqrt(target + squared)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for _ in range(_NEWTON):
            value, slope = _chain(lines, np.exp(exponent))
            change = (value - target) / slope
            length = np.abs(change)
            exponent = exponent - change * np.minimum(1, _LONGEST / np.maximum(length, 1e-300))
            if not (length > 1e-10).any():
                break
        root = np.exp(exponent)
        value, slope = _chain(lines, root)
        carried = (np.abs(value - target) < _SETTLED * np.abs(target)) & (np.abs(root) < 1)
    return np.where(carried, root, 0.5), np.where(carried, rate * slope, 0.0)


def all_modes(medium: LatticeMedium, eigenvalue: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same as `slowest_modes` for all modes that come from a distance; shape (modes, frequencies, tangential
    modes).

    The eigenvalue is a polynomial of ``(zeta + 1/zeta)/2``, whose roots are eigenvalues of a matrix for its Chebyshev
    series.
    """
    lines = _lines(medium.stencil, along)
    series = np.stack(
        [np.broadcast_to((2 if d else 1) * line, eigenvalue.shape + line.shape) for d, line in enumerate(lines)], -1
    )
    series = series.astype(complex)
    target = (eigenvalue / medium.rate)[:, None]
    series[..., 0] -= target
    root, gone = _factors(series)
    value, slope = _chain(lines, root)
    carried = ~gone & (np.abs(value - target) < _ROUGH * np.abs(series).max())
    return np.where(carried, root, 0.5), np.where(carried, medium.rate * slope, 0.0)


def _factors(series: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Factors per node, below 1, at which Chebyshev series in ``(zeta + 1/zeta)/2`` are zero, and which of them decay
    at once; shape (degree, ...) for series (..., degree + 1).
    """
    degree = series.shape[-1] - 1
    floor = _FLAT * np.abs(series).max(-1, keepdims=True)
    last = np.where(np.abs(series[..., -1:]) < floor, floor, series[..., -1:])
    matrix = np.zeros((*series.shape[:-1], degree, degree), complex)
    row = np.arange(degree - 1)
    matrix[..., row, row + 1] = 0.5
    matrix[..., row + 1, row] = 0.5
    matrix[..., 0, 1:2] = 1.0
    matrix[..., -1, :] -= series[..., :-1] / (last if degree == 1 else 2 * last)
    half = np.moveaxis(np.linalg.eigvals(matrix), -1, 0)
    grown = half + np.sqrt(half - 1) * np.sqrt(half + 1)  # the inverse factor, at least 1 in modulus
    gone = ~(np.abs(grown) < 1 / _GONE)
    return 1 / np.where(gone, 2.0, grown), gone


@dataclass(frozen=True)
class _PlaneChain:
    """The symmetric 2 x 2 matrix that represents a stencil of vectors in the plane for modes of given tangential
    wavenumbers: the entries along the normal, across it, and between both; the last one is odd along the normal.

    Attributes
    ----------
    normal, across, between : ndarray, shape (K + 1, m)
        Weights by distance along the normal.
    """

    normal: np.ndarray
    across: np.ndarray
    between: np.ndarray

    @classmethod
    def of(cls, stencil: Stencil, along: np.ndarray, order: int = 0) -> _PlaneChain:
        """The matrix for tangential wavenumbers times spacing, shape (1, m), or, for order 1, its derivative with
        respect to these.
        """
        found = np.zeros((3, stencil.reach[0] + 1, along.shape[1]), complex)
        entries = stencil.weights[:, [0, 1, 0], [0, 1, 1]]
        for offset, entry in zip(stencil.offsets, entries, strict=True):
            if offset[0] >= 0:
                found[:, offset[0]] += np.outer(entry, (1j * offset[1]) ** order * np.exp(1j * offset[1:] @ along))
        if order == 0:
            own = stencil.weights.sum(0) + stencil.own
            found[:, 0] -= np.array([own[0, 0], own[1, 1], own[0, 1]])[:, None]
        return cls(*found)

    def at(self, root: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The three entries, with the eigenvalue subtracted from the diagonal, and their derivatives with respect to
        the logarithm of the factor; shape (3, ...).
        """
        parts = [_chain(self.normal, root), _chain(self.across, root), _chain(self.between, root, -1)]
        value, slope = (np.stack(part) for part in zip(*parts, strict=True))
        value[:2] -= target
        return value, slope

    def series(self, target: np.ndarray) -> np.ndarray:
        """The determinant as Chebyshev series, of shape (frequencies, m, degree + 1), for eigenvalues of shape
        (frequencies, 1).
        """
        degree = 2 * (len(self.normal) - 1)
        angles = np.exp(2j * np.pi * np.arange(2 * degree + 1) / (2 * degree + 1))[:, None]
        normal, across, between = self.at(np.broadcast_to(angles, (len(angles), self.normal.shape[1])), np.zeros(()))[0]
        sampled = normal * across - between**2, normal + across
        found, trace = (np.fft.fft(part, axis=0)[: degree + 1].T / len(angles) for part in sampled)
        series = found - target[..., None] * trace
        series[..., 0] += target**2
        series[..., 1:] *= 2
        # bonds along the normal alone have no stiffness across it
        held = np.flatnonzero(np.abs(series).max((0, 1)) > _FLAT * np.abs(series).max())
        return np.asarray(series[..., : max(int(held[-1]), 1) + 1])


def vectors_arrived(
    medium: LatticeMedium,
    z: np.ndarray,
    along: np.ndarray,
    sent: Sequence[tuple[int, np.ndarray, np.ndarray]],
    limit: float = np.inf,
) -> tuple[np.ndarray, ...]:
    """All modes of vectors in the plane that come to a side, with their amplitudes for given data: the residues of the
    inverse of their matrix, which are those of its adjugate over the derivative of its determinant.

    Parameters
    ----------
    medium : LatticeMedium
    z : ndarray of complex, shape (frequencies,)
        Factors per step.
    along : ndarray, shape (1, m)
        Tangential wavenumbers times spacing.
    sent : sequence of (int, ndarray, ndarray)
        Component, rows (rows, m) towards the side, and transform of the scheme for them at each frequency.
    limit : float, optional
        Speed along the side that waves do not exceed: faster ones are left out, by a smooth function of their speed.

    Returns
    -------
    tuple of ndarray
        Factors per node, amplitudes and steps per node, shape (frequencies, modes m), and polarisations, shape (2,
        frequencies, modes m); amplitudes are zero where the lattice carries no such wave.
    """
    alike, number = alike_along(medium.stencil, along)
    target = (medium.recursion.eigenvalue(z) / medium.rate)[:, None]
    series = _PlaneChain.of(medium.stencil, alike).series(target)
    largest = float(np.abs(series).max())
    chain, tilted = (_PlaneChain.of(medium.stencil, along, order) for order in (0, 1))

    def arrived(part: slice) -> tuple[np.ndarray, ...]:
        """The modes at some frequencies."""
        root, gone = (found[..., number] for found in _factors(series[part]))
        for polish in (True, True, False):
            value, slope = chain.at(root, target[part])
            determinant = value[0] * value[1] - value[2] ** 2
            rise = slope[0] * value[1] + value[0] * slope[1] - 2 * value[2] * slope[2]
            level = np.abs(rise) <= _LEVEL * largest  # rounding may leave no slope for modes that decay at once
            rise = np.where(level, 1.0, rise)
            if polish:
                change = np.where(level, 0.0, determinant / rise)
                root = root * np.exp(-change * np.minimum(1.0, _NEARLY / np.maximum(np.abs(change), 1e-300)))
        carried = ~gone & ~level & (np.abs(root) < 1) & (np.abs(determinant) < _ROUGH * largest)
        # columns of the adjugate, the longer of which gives the polarisation
        columns = np.stack([np.stack([value[1], -value[2]]), np.stack([-value[2], value[0]])])
        lengths = np.linalg.norm(columns, axis=1)
        shape = np.where(lengths[0] > lengths[1], columns[0], columns[1]) / np.maximum(lengths.max(0), 1e-300)
        total = np.zeros(root.shape, complex)
        for component, rows, start in sent:
            total += (shape.conj() * columns[component]).sum(0) * _carried(rows, root) * start[part, None]
        total = np.where(carried, total / (medium.rate * rise), 0)
        # derivative of the determinant with respect to the logarithm of the factor per step
        turn = (medium.recursion.keep / z[part] - z[part])[:, None] * np.where(carried, value[0] + value[1], 1)
        turn = turn / (medium.recursion.scale * medium.rate)
        slowness = np.where(carried, turn / rise, 0)
        if limit < np.inf:
            tilt = tilted.at(root, np.zeros(()))[0]
            drift = np.abs(tilt[0] * value[1] + value[0] * tilt[1] - 2 * value[2] * tilt[2])
            share = drift / np.abs(turn) * medium.spacing / (limit * medium.dt)
            total = total * special.erfc(_STEEP * (np.minimum(share, 2.0) ** 2 - 0.5)) / 2
        root = np.where(carried, root, 0.5)
        found = [np.concatenate(one, axis=1) for one in (root, total, slowness)]
        return *found, np.concatenate(np.moveaxis(shape, 1, 0), axis=2)

    parts = parts_in_cache(len(z), along.shape[1] * (series.shape[-1] - 1))
    return tuple(np.concatenate(found, axis=-2) for found in zip(*in_parallel(arrived, parts), strict=True))


def parts_in_cache(frequencies: int, modes: int) -> list[slice]:
    """Slices of the frequencies, each with so few waves that they fit in the cache."""
    together = max(1, _IN_CACHE // max(1, modes))
    return [slice(first, first + together) for first in range(0, max(1, frequencies), together)]


def _lines(stencil: Stencil, along: np.ndarray) -> np.ndarray:
    """Weights, by distance along the normal, of the chain that represents the stencil for tangential wavenumbers."""
    lines = np.zeros((stencil.reach[0] + 1, along.shape[1]))
    for offset, weight in zip(stencil.offsets, stencil.weights, strict=True):
        if offset[0] >= 0:
            lines[offset[0]] += weight * np.cos(offset[1:] @ along)
    lines[0] -= stencil.weights.sum() + stencil.reaction
    return lines


def alike_along(stencil: Stencil, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tangential wavenumbers whose modes differ, and for each given wavenumber the index of the one with the same
    modes.
    """
    tangential = range(1, stencil.dim)
    if not len(along) or not all(stencil.even_along(axis) for axis in tangential):
        return along, np.arange(along.shape[1])
    folded = np.abs(along)
    if stencil.dim == 3 and stencil.same_along(1, 2):
        folded = np.sort(folded, axis=0)
    found, number = np.unique(np.round(folded, 12), axis=1, return_inverse=True)
    return found, number.ravel()


def sent_in_mode(rows: np.ndarray, root: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Amplitude of data on rows in a mode, at the last row; zero where the lattice carries no such mode."""
    return np.where(slope == 0, 0, _carried(rows, root) / np.where(slope == 0, 1, slope))


def _carried(rows: np.ndarray, root: np.ndarray) -> np.ndarray:
    """``sum_x rows[x] root^(last - x)``, by Horner's rule over the rows that are not negligible."""
    sizes = np.abs(rows).max(1)
    held = np.flatnonzero(sizes > _NOTHING * sizes.max(initial=0.0))
    found = np.zeros(root.shape, complex)
    if held.size:
        for row in rows[held[0] : held[-1] + 1]:
            found = found * root + row
        found = found * root ** (len(rows) - 1 - held[-1])
    return found


def _chain(lines: np.ndarray, root: np.ndarray, back: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalue of the chain for modes of a given factor per node, and its derivative with respect to the logarithm of
    the factor; the weights in the opposite direction are multiplied by `back`, 1 or -1.
    """
    value, slope, power = lines[0] + 0j * root, np.zeros_like(root), np.ones_like(root)
    for distance, line in enumerate(lines[1:], 1):
        power = power * root
        value = value + line * (power + back / power)
        slope = slope + line * distance * (power - back / power)
    return value, slope

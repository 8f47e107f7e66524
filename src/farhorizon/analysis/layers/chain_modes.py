"""Modes of the chain that the medium in front of a side is for each tangential wavenumber, and what data send in them.

A mode goes on along the normal by a factor zeta over a node. The slowest one carries data farthest; all of them are
asked for where some run backward, of vectors in the plane those of both components together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from farhorizon.analysis.layers.layer import LatticeMedium
from farhorizon.engine.parallel import in_parallel
from farhorizon.medium.stencil import Stencil

_NEWTON, _LONGEST = 12, 0.3  # iterations from the root of long waves, and the largest change of log zeta in one of them
_SETTLED = 1e-8  # relative residual of a root
# of the modes of a chain: relative residual, where two nearly coincide, and the least factor over a node
_ROUGH, _GONE = 1e-6, 1e-6
_NEARLY = 0.01  # and the largest change of log zeta in an iteration from such a root
_NOTHING = 1e-20  # of the largest of the rows: those that hold no more are left out
_STEEP = 8.0  # how fast waves fade out about 0.7 of the limit of speeds: 1e-8 remains at it
_IN_CACHE = 1 << 13  # waves that are looked at together
_FLAT = 1e-14  # of a polynomial's largest coefficient, the least of the first one: what dies out at once
_LEVEL = 1e-100  # of the same, a slope that is none


def slowest_modes(medium: LatticeMedium, eigenvalue: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Factor over a node and ``zeta dA/dzeta`` of the mode that reaches farthest; shape (frequencies, tangential
    modes).

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
    """Of all modes that come from a distance, as `slowest_modes`; shape (modes, frequencies, tangential modes).

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
    """Factors over a node, below 1, at which Chebyshev series in ``(zeta + 1/zeta)/2`` are zero, and which of them die
    out at once; shape (degree, ...) for series (..., degree + 1).
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
    grown = half + np.sqrt(half - 1) * np.sqrt(half + 1)  # the other way, by 1 at least
    gone = ~(np.abs(grown) < 1 / _GONE)
    return 1 / np.where(gone, 2.0, grown), gone


@dataclass(frozen=True)
class _PlaneChain:
    """The symmetric matrix of 2 x 2 that a stencil of vectors in the plane is for modes of given tangential
    wavenumbers: along the normal, across, and between both, which changes its sign with the direction.

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
        """For tangential wavenumbers times spacing, shape (1, m); or its derivative by these, of order 1."""
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
        """The three entries less an eigenvalue, and their derivatives by the factor's logarithm; shape (3, ...)."""
        parts = [_chain(self.normal, root), _chain(self.across, root), _chain(self.between, root, -1)]
        value, slope = (np.stack(part) for part in zip(*parts, strict=True))
        value[:2] -= target
        return value, slope

    def series(self, target: np.ndarray) -> np.ndarray:
        """The determinant as a Chebyshev series, shape (frequencies, m, degree + 1); eigenvalues (frequencies, 1)."""
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
    """All modes of vectors in the plane that come to a side, by what data send in them: the residues of the inverse of
    their matrix, which are those of its adjugate over the derivative of its determinant.

    Parameters
    ----------
    medium : LatticeMedium
    z : ndarray of complex, shape (frequencies,)
        Factors over a step.
    along : ndarray, shape (1, m)
        Tangential wavenumbers times spacing.
    sent : sequence of (int, ndarray, ndarray)
        Component, rows (rows, m) towards the side, and what the scheme makes of them at each frequency.
    limit : float, optional
        Speed along the side that waves do not exceed: faster ones are left out, by a smooth function of their speed.

    Returns
    -------
    tuple of ndarray
        Factors over a node, amplitudes and steps over a node, shape (frequencies, modes m), and polarisations, shape
        (2, frequencies, modes m); amplitudes are zero where the lattice carries no such wave.
    """
    alike, number = alike_along(medium.stencil, along)
    target = (medium.recursion.eigenvalue(z) / medium.rate)[:, None]
    series = _PlaneChain.of(medium.stencil, alike).series(target)
    largest = float(np.abs(series).max())
    chain, tilted = (_PlaneChain.of(medium.stencil, along, order) for order in (0, 1))

    def arrived(part: slice) -> tuple[np.ndarray, ...]:
        """Those of some frequencies."""
        root, gone = (found[..., number] for found in _factors(series[part]))
        for polish in (True, True, False):
            value, slope = chain.at(root, target[part])
            determinant = value[0] * value[1] - value[2] ** 2
            rise = slope[0] * value[1] + value[0] * slope[1] - 2 * value[2] * slope[2]
            level = np.abs(rise) <= _LEVEL * largest  # of what dies out at once rounding may leave nothing
            rise = np.where(level, 1.0, rise)
            if polish:
                change = np.where(level, 0.0, determinant / rise)
                root = root * np.exp(-change * np.minimum(1.0, _NEARLY / np.maximum(np.abs(change), 1e-300)))
        carried = ~gone & ~level & (np.abs(root) < 1) & (np.abs(determinant) < _ROUGH * largest)
        # columns of the adjugate, of which the longer one tells the polarisation
        columns = np.stack([np.stack([value[1], -value[2]]), np.stack([-value[2], value[0]])])
        lengths = np.linalg.norm(columns, axis=1)
        shape = np.where(lengths[0] > lengths[1], columns[0], columns[1]) / np.maximum(lengths.max(0), 1e-300)
        total = np.zeros(root.shape, complex)
        for component, rows, start in sent:
            total += (shape.conj() * columns[component]).sum(0) * _carried(rows, root) * start[part, None]
        total = np.where(carried, total / (medium.rate * rise), 0)
        # of the eigenvalue, by which it changes with the factor's logarithm, a step
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
    """Parts of so many frequencies, of so few waves that they are looked at in the cache."""
    together = max(1, _IN_CACHE // max(1, modes))
    return [slice(first, first + together) for first in range(0, max(1, frequencies), together)]


def _lines(stencil: Stencil, along: np.ndarray) -> np.ndarray:
    """Weights of the chain that the stencil is for tangential wavenumbers, by distance along the normal."""
    lines = np.zeros((stencil.reach[0] + 1, along.shape[1]))
    for offset, weight in zip(stencil.offsets, stencil.weights, strict=True):
        if offset[0] >= 0:
            lines[offset[0]] += weight * np.cos(offset[1:] @ along)
    lines[0] -= stencil.weights.sum() + stencil.reaction
    return lines


def alike_along(stencil: Stencil, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tangential wavenumbers whose modes differ, and for each given one the number of the one it is like."""
    tangential = range(1, stencil.dim)
    if not len(along) or not all(stencil.even_along(axis) for axis in tangential):
        return along, np.arange(along.shape[1])
    folded = np.abs(along)
    if stencil.dim == 3 and stencil.same_along(1, 2):
        folded = np.sort(folded, axis=0)
    found, number = np.unique(np.round(folded, 12), axis=1, return_inverse=True)
    return found, number.ravel()


def sent_in_mode(rows: np.ndarray, root: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """What data on rows send to the last of them in a mode, nothing where the lattice carries none."""
    return np.where(slope == 0, 0, _carried(rows, root) / np.where(slope == 0, 1, slope))


def _carried(rows: np.ndarray, root: np.ndarray) -> np.ndarray:
    """``sum_x rows[x] root^(last - x)``, by Horner's rule over the rows that hold something."""
    sizes = np.abs(rows).max(1)
    held = np.flatnonzero(sizes > _NOTHING * sizes.max(initial=0.0))
    found = np.zeros(root.shape, complex)
    if held.size:
        for row in rows[held[0] : held[-1] + 1]:
            found = found * root + row
        found = found * root ** (len(rows) - 1 - held[-1])
    return found


def _chain(lines: np.ndarray, root: np.ndarray, back: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalue of the chain for modes of a factor over a node, and its derivative by the factor's logarithm; the
    weights the other way times `back`, 1 or -1.
    """
    value, slope, power = lines[0] + 0j * root, np.zeros_like(root), np.ones_like(root)
    for distance, line in enumerate(lines[1:], 1):
        power = power * root
        value = value + line * (power + back / power)
        slope = slope + line * distance * (power - back / power)
    return value, slope

"""Waves of a half-infinite lattice that ends at a free surface: the reflection of a plane wave, and waves that run
along the surface.

Along the surface a wave has a wavenumber, so that the medium below is a column of rows: a chain of blocks. The first
row is the surface; bonds beyond it are absent. Far down a wave is a sum of the modes of the infinite chain, ``v
zeta^-q`` in row q, and the rows near the surface obey their own equations: one linear system for these rows and for the
amplitudes of the modes that leave. A wave along the surface is a solution without an incoming mode.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg

from farhorizon.analysis.layers.chain_modes import chain_roots, chain_weights
from farhorizon.errors import InputError
from farhorizon.medium.free_side import FreeSide
from farhorizon.medium.stencil import Stencil

_UNIT = 1e-7  # a mode whose factor has a modulus nearer to 1 propagates
_ROWS = 4  # smallest number of rows that are unknowns themselves: a mode that is not found is negligible below them
_SECANT, _SETTLED = 40, 1e-13  # secant steps for a surface wave, and relative change of wavenumber at which they end
_TRAVELS = 1e-6  # largest amplitude of a mode that travels down from a surface wave


@dataclass(frozen=True, eq=False)
class Column:
    """A wave in the rows below a surface, for one frequency and one wavenumber along it."""

    rows: np.ndarray  # the first T rows, (T, components)
    factors: np.ndarray  # of the modes below, from one row to the next one down, (m,)
    vectors: np.ndarray  # the modes in row T, with their amplitudes, (m, components)
    #: Downward, ``d(Omega^2)/dk`` of the modes that propagate, with k in radians per row; infinite for others.
    speeds: np.ndarray
    #: Residual of the equations of the first rows, projected on the wave; zero except for a wave along the surface that
    #: has not converged.
    defect: complex = 0.0

    def at(self, count: int) -> np.ndarray:
        """The wave in the first `count` rows, shape (count, components)."""
        known = len(self.rows)
        deeper = self.factors ** np.arange(max(count - known, 0))[:, None] @ self.vectors
        return np.concatenate([self.rows[:count], deeper])


@dataclass(frozen=True, eq=False)
class HalfSpace:
    """The half-infinite lattice below a free surface, in units of the stencil; the normal is the first of all axes and
    components.
    """

    end: FreeSide

    @cached_property
    def stencil(self) -> Stencil:
        """Stencil of the medium inside."""
        return self.end.stencil.along(self.end.axis)

    @property
    def side(self) -> int:
        """1 if the medium ends with growing indices along the normal, else -1."""
        return self.end.side

    @cached_property
    def reach(self) -> int:
        """Number of rows with which a row is linked on either side."""
        return self.stencil.reach[0]

    def _blocks(self, along: np.ndarray) -> np.ndarray:
        """The stencil along the normal, from K rows below to K rows above, shape (2 K + 1, d, d)."""
        d = self.stencil.components
        return chain_weights(self.stencil, along.tolist())[:: self.side].reshape(-1, d, d)

    def _rows(self, along: np.ndarray) -> np.ndarray:
        """The same as `_blocks` for each row, from the surface down to the first row that has all bonds; shape (rows, 2
        K + 1, d, d).
        """
        end, d, order = self.end, self.stencil.components, self.end.order
        weights = end.weights[..., order, :][..., order] if d > 1 else end.weights
        phase = np.exp(1j * end.offsets[:, order[1:]] @ along)
        blocks = np.zeros((2 * self.reach + 1, len(weights), d, d), complex)
        up = end.side * end.offsets[:, end.axis]
        np.add.at(blocks, up + self.reach, (weights * phase[:, None, None]).swapaxes(0, 1))
        blocks[self.reach] -= weights.sum(1) + self.stencil.own
        return blocks.swapaxes(0, 1)

    def _modes(self, blocks: np.ndarray, squared: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Factors downward, polarisations and speeds of the modes that leave the surface."""
        roots, vectors = chain_roots(blocks, complex(-squared))
        powers = np.arange(len(blocks)) - self.reach
        slope = np.einsum("ni,kij,nj,nk->n", vectors.conj(), blocks, vectors, powers * roots[:, None] ** powers)
        travels = np.abs(np.abs(roots) - 1) < _UNIT
        # u goes as exp(i (k q' - w t)), q' upward: d(Omega^2)/dk = -i slope
        speed = (-1j * slope).real
        leaves = np.where(travels, speed < 0, np.abs(roots) > 1)
        return 1 / roots[leaves], vectors[leaves], np.where(travels, -speed, np.inf)[leaves]

    def _system(self, along: np.ndarray, squared: float, count: int) -> np.ndarray:
        """The equations of the first ``count + K`` rows as a matrix that acts on the first ``count + 2 K`` rows."""
        d, reach, rows = self.stencil.components, self.reach, self._rows(along)
        matrix = np.zeros(((count + reach), d, (count + 2 * reach), d), complex)
        for row in range(count + reach):
            for up in range(-reach, min(reach, row) + 1):
                matrix[row, :, row - up] += rows[min(row, reach), up + reach]
            matrix[row, :, row] += squared * np.eye(d)
        return matrix.reshape((count + reach) * d, -1)

    def _unknowns(self, along: np.ndarray, squared: float) -> tuple[np.ndarray, ...]:
        """The system for the first rows and the amplitudes of the modes below, the system for all rows, and the modes:
        factors, vectors, speeds.
        """
        factors, vectors, speeds = self._modes(self._blocks(along), squared)
        d, count = self.stencil.components, self.unknown_rows
        equations = self._system(along, squared, count)
        below = (factors[:, None] ** np.arange(2 * self.reach))[:, :, None] * vectors[:, None]
        system = np.concatenate(
            [equations[:, : count * d], equations[:, count * d :] @ below.reshape(len(factors), -1).T], 1
        )
        return system, equations, factors, vectors, speeds

    @property
    def unknown_rows(self) -> int:
        """Number of rows that are unknowns themselves."""
        return max(2 * self.reach, _ROWS)

    def total(self, squared: float, along: np.ndarray, root: complex, vector: np.ndarray) -> Column:
        """A plane wave together with its reflection by the surface; an InputError if the wave does not come to the
        surface.

        `squared` is the squared frequency, in units of ``coefficient / spacing^2``, `along` (dim - 1,) the wavenumbers
        along the surface times spacing, `root` the factor of the incoming wave from one row to the next one up, and
        `vector` (d,) its displacement in the first row.
        """
        d, blocks = self.stencil.components, self._blocks(along)
        powers = np.arange(2 * self.reach + 1) - self.reach
        slope = vector.conj() @ np.einsum("kij,k->ij", blocks, powers * root**powers) @ vector
        if (-1j * slope).real <= 0:
            raise InputError(
                "the wave does not come to the surface", key="incident.direction", remedy="a direction towards it"
            )
        system, equations, factors, vectors, speeds = self._unknowns(along, squared)
        count = self.unknown_rows
        rows = np.arange(count + 2 * self.reach)
        wave = root ** -rows.astype(float)[:, None] * vector
        # the unknowns of the first rows are the total field, those below are the leaving waves
        right = -equations[:, count * d :] @ wave[count:].ravel()
        scale = np.abs(system).max(0)
        unknowns = linalg.lstsq(system / scale, right)[0] / scale
        top, amplitudes = unknowns[: count * d].reshape(count, d), unknowns[count * d :]
        return Column(
            top,
            np.append(factors, 1 / root),
            np.concatenate([amplitudes[:, None] * vectors, wave[count : count + 1]]),
            np.append(speeds, np.inf),
        )

    def free(self, squared: float, along: np.ndarray) -> Column:
        """The wave along the surface with the smallest residual in its equations; its vector of unknowns has unit
        length.
        """
        d, count = self.stencil.components, self.unknown_rows
        system, _, factors, vectors, speeds = self._unknowns(along, squared)
        unknowns = np.linalg.svd(system)[2][-1].conj()
        top, amplitudes = unknowns[: count * d].reshape(count, d), unknowns[count * d :]
        column = Column(top, factors, amplitudes[:, None] * vectors, speeds)
        residual = system @ unknowns
        field = column.at(count + self.reach).ravel()
        return Column(top, factors, column.vectors, speeds, complex(field.conj() @ residual))

    def surface_wave(self, squared: float, direction: np.ndarray, start: float) -> tuple[float, Column]:
        """The wavenumber times spacing near `start`, and the wave of one squared frequency along the surface in a
        direction, a unit vector (dim - 1,); an InputError if there is none because it would radiate energy downwards.

        The column is Hermitian, so that ``u* (H + Omega^2) u``, for the wave u with the smallest residual, is accurate
        to second order in the error of u; its zero as a function of the wavenumber is found by the secant method.
        """
        numbers = [start, start * (1 + 1e-4)]
        columns = [self.free(squared, number * direction) for number in numbers]
        for _ in range(_SECANT):
            (a, b), (f, g) = numbers, (column.defect.real for column in columns)
            if g == f or abs(b - a) < _SETTLED * abs(b):
                break
            step = float(np.clip(-g * (b - a) / (g - f), -0.2 * b, 0.2 * b))
            numbers = [b, b + step]
            columns = [columns[1], self.free(squared, numbers[1] * direction)]
        column = columns[1]
        sent = np.linalg.norm(column.vectors[np.isfinite(column.speeds)], axis=1)
        if abs(numbers[1] - numbers[0]) > 1e-9 * start or sent.max(initial=0) > _TRAVELS:
            raise InputError(
                "no wave of this frequency runs along the surface",
                value=f"{np.sqrt(squared):.4g} sqrt(coefficient) / spacing",
                key="incident.signal",
                remedy="a smoother or longer signal, a finer lattice, or stabilisation of a correspondence material",
            )
        return numbers[1], column

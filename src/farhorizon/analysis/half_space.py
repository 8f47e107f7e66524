"""Waves of a half-infinite lattice that ends at a free surface, or has strata on top, or both: what a plane wave from
below becomes there, and waves that run along a surface.

Along the surface a wave has a wavenumber, so that the medium below is a column of rows: a chain of blocks. The first
row is the surface; bonds beyond it are absent. Far down a wave is a sum of the modes of the infinite chain, ``v
zeta^-q`` in row q, and the rows above obey their own equations: one linear system for these rows and for the amplitudes
of the modes that leave. Where the medium goes on above the first row, it carries modes that leave upwards. A wave along
the surface is a solution without an incoming mode.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import splu

from farhorizon.analysis.layers.chain_modes import chain_roots, chain_weights
from farhorizon.errors import InputError
from farhorizon.medium.stencil import Stencil
from farhorizon.medium.stratified_medium import StratifiedMedium

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
    """The lattice below a free surface or below the first row of strata, in units of the stencil; the normal is the
    first of all axes and components.
    """

    end: StratifiedMedium

    @cached_property
    def stencil(self) -> Stencil:
        """Stencil of the medium inside."""
        return self.end.inside.along(self.end.axis)

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
        """Factors downward, polarisations and speeds of the modes that go down from the surface."""
        roots, vectors = chain_roots(blocks, complex(-squared))
        powers = np.arange(len(blocks)) - self.reach
        slope = np.einsum("ni,kij,nj,nk->n", vectors.conj(), blocks, vectors, powers * roots[:, None] ** powers)
        travels = np.abs(np.abs(roots) - 1) < _UNIT
        # u goes as exp(i (k q' - w t)), q' upward: d(Omega^2)/dk = -i slope
        speed = (-1j * slope).real
        leaves = np.where(travels, speed < 0, np.abs(roots) > 1)
        return 1 / roots[leaves], vectors[leaves], np.where(travels, -speed, np.inf)[leaves]

    def _system(self, along: np.ndarray, squared: float, count: int) -> np.ndarray:
        """The equations of the first ``count + K`` rows as a matrix that acts on the first ``count + 2 K`` rows; if the
        medium goes on above, preceded by those of K rows there, which act on 2 K rows there.
        """
        d, reach, blocks = self.stencil.components, self.reach, self._rows(along)
        rows = np.arange(-reach if self.end.open else 0, count + reach)
        first = rows[0] - reach if self.end.open else 0
        matrix = np.zeros((len(rows), d, count + 2 * reach - first, d), complex)
        number, of_row = np.arange(len(rows)), np.clip(rows, 0, len(blocks) - 1)
        for up in range(-reach, reach + 1):
            there = rows - up >= first
            matrix[number[there], :, (rows - up - first)[there]] += blocks[of_row[there], up + reach]
        matrix[number, :, rows - first] += squared * np.eye(d)
        return matrix.reshape(len(rows) * d, -1)

    def _unknowns(self, along: np.ndarray, squared: float) -> tuple[np.ndarray, ...]:
        """The system for the first rows and the amplitudes of the modes below, and above if the medium goes on there,
        the system for all rows, and the modes below: factors, vectors, speeds.
        """
        factors, vectors, speeds = self._modes(self._blocks(along), squared)
        d, count = self.stencil.components, self.unknown_rows
        equations = self._system(along, squared, count)
        below = (factors[:, None] ** np.arange(2 * self.reach))[:, :, None] * vectors[:, None]
        above = self._above * d
        parts = [
            equations[:, above : above + count * d],
            equations[:, above + count * d :] @ below.reshape(len(factors), -1).T,
        ]
        if above:
            upwards, polarisations, _ = self._modes(self._rows(along)[0, ::-1], squared)
            powers = upwards[:, None] ** np.arange(self._above)[::-1]
            parts.append(equations[:, :above] @ (powers[:, :, None] * polarisations[:, None]).reshape(-1, above).T)
        return np.concatenate(parts, 1), equations, factors, vectors, speeds

    @property
    def unknown_rows(self) -> int:
        """Number of rows that are unknowns themselves: below them only the medium inside is found."""
        return max(2 * self.reach, _ROWS, len(self.end.weights) - 1 - self.reach)

    @property
    def _above(self) -> int:
        """Number of rows above the first one that occur in the system."""
        return 2 * self.reach if self.end.open else 0

    def _solved(self, system: np.ndarray, right: np.ndarray, modes: int) -> np.ndarray:
        """Solution of a system of `_unknowns`, which may have more equations than unknowns; `modes` are below."""
        scale = np.abs(system).max(0)
        matrix, ends = system / scale, self.reach * self.stencil.components
        if self.end.strata is None:
            return np.asarray(linalg.lstsq(matrix, right)[0] / scale)
        # The equations of the K rows beyond the unknown ones on a side have the rank of the modes there, which is less
        # than their number where the outermost weights are singular: what is left is a sparse square system
        above = matrix.shape[1] - self.unknown_rows * self.stencil.components - modes
        last = len(matrix) - ends
        parts = [(slice(last, None), modes)] + [(slice(ends), above)] * self.end.open
        kept, sides = [matrix[ends if self.end.open else 0 : last]], [right[ends if self.end.open else 0 : last]]
        for rows, rank in parts:
            independent = np.linalg.svd(matrix[rows])[0][:, :rank].conj().T
            kept.append(independent @ matrix[rows])
            sides.append(independent @ right[rows])
        return np.asarray(splu(sparse.csc_array(np.concatenate(kept))).solve(np.concatenate(sides)) / scale)

    def total(self, squared: float, along: np.ndarray, root: complex, vector: np.ndarray) -> Column:
        """A plane wave together with what it becomes at the surface and in strata; an InputError if the wave does not
        come to the surface.

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
        right = -equations[:, (self._above + count) * d :] @ wave[count:].ravel()
        unknowns = self._solved(system, right, len(factors))
        top, amplitudes = unknowns[: count * d].reshape(count, d), unknowns[count * d : count * d + len(factors)]
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

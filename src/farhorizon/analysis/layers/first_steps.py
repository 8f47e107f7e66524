"""What a layer for diffusion reflects in the first steps of an explicit scheme, step by step.

The formulas for these layers (`farhorizon.analysis.layers.diffusing`) cover waves that decay. Beyond half the largest
step of forward Euler the shortest waves alternate instead, for some tens of steps; layers hardly absorb such waves, and
narrow data contain many of them. Layers for diffusion have no memory, so that the columns of a layer and the near field
in front of it form one constant matrix for each tangential wavenumber. The first steps can therefore be computed, and
compared with a medium that continues.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import fft

from farhorizon.analysis.layers.columns import continuations
from farhorizon.analysis.layers.reflection import chain_weights
from farhorizon.engine.engine import Layer
from farhorizon.medium.stencil import Stencil

_FELT = 1e-4  # tangential modes with a smaller share of the data than this part of the target error are left out
# number of waves that represent all along the third axis, the power by which they crowd towards long waves, and the
# length of the transform over that of the data
_WAVES, _LONGER, _FINE = 6, 1.5, 6
_WIDE = 7.0  # standard deviations beyond which the spreading field is neglected: exp(-24) remains


@dataclass(frozen=True)
class FirstSteps:
    """Data in front of a side in the first steps of forward Euler, on a plane across the side.

    Attributes
    ----------
    stencil : Stencil
        Its first axis is the normal.
    scale : float
        ``coefficient / spacing^2`` times the step.
    rows : ndarray, shape (rows, nodes)
        Data, the first axis towards the side; on a line, one node per row.
    periodic : bool
        Whether the data are periodic along the side.
    steps : int
    wanted : float
        The target error, which determines the tangential modes that are left out.
    margin : int
        Nodes between the last row and the layer, where errors do not count.
    beyond : sequence of (float, float)
        In space, waves along the third axis: wavenumber times spacing, and share of the data.
    lasting : bool
        Whether the data are a source, which is added in each step.
    """

    stencil: Stencil
    scale: float
    rows: np.ndarray
    periodic: bool
    steps: int
    wanted: float
    margin: int = 1
    beyond: Sequence[tuple[float, float]] = ((0.0, 1.0),)
    lasting: bool = False

    @property
    def _room(self) -> int:
        """Nodes beyond the data that the field reaches."""
        reach = max(self.stencil.reach)
        return min(reach * self.steps, reach + int(np.ceil(_WIDE * np.sqrt(2 * self.scale * self.steps))))

    @cached_property
    def _length(self) -> int:
        """Period of the data along the side, in nodes."""
        nodes = self.rows.shape[1]
        return nodes if self.periodic or nodes == 1 else fft.next_fast_len(nodes + 2 * self._room, real=True)

    @cached_property
    def _spectrum(self) -> np.ndarray:
        """Fourier coefficients of the data along the side, shape (modes, rows)."""
        return np.asarray(fft.rfft(self.rows, self._length, axis=1).T)

    @cached_property
    def _kept(self) -> np.ndarray:
        """Indices of the tangential modes that are not negligible."""
        content = np.abs(self._spectrum).sum(1)
        return np.flatnonzero(content > _FELT * self.wanted * content.sum())

    @cached_property
    def _weights(self) -> np.ndarray:
        """Weights of the chain along the normal, times the scale, shape (waves beyond * modes, 2 K + 1)."""
        numbers = 2 * np.pi * self._kept / self._length
        chains = [
            chain_weights(self.stencil, (one, other)[: self.stencil.dim - 1]).real
            for other, _ in self.beyond
            for one in numbers
        ]
        return self.scale * np.array(chains)

    @cached_property
    def _undisturbed(self) -> tuple[np.ndarray, np.ndarray]:
        """In a medium that continues beyond the side: for each step, the values at the 2 K + 1 nodes around the last
        one before the layer, and the largest value of the whole field.
        """
        reach, count = self.stencil.reach[0], len(self.rows) + self.margin
        start = np.tile(self._spectrum[self._kept], (len(self.beyond), 1))
        field = start = np.pad(start, ((0, 0), (self._room, self.margin + self._room)))
        last, tails, largest = self._room + count, [], []
        for _ in range(self.steps):
            tails.append(field[:, last - reach - 1 : last + reach])
            field = field + _summed(self._weights, field) + (start if self.lasting else 0.0)
            largest.append(np.abs(self._along_side(field).sum(0)).max())
        return np.array(tails), np.array(largest)

    def _along_side(self, modes: np.ndarray) -> np.ndarray:
        """Values at the nodes of the side, of shape (waves beyond, nodes, columns), for given values of the modes that
        are kept.
        """
        every = np.zeros((len(self.beyond), self._length // 2 + 1, modes.shape[1]), complex)
        shares = np.array([share for _, share in self.beyond])
        every[:, self._kept] = modes.reshape(len(shares), -1, modes.shape[1]) * shares[:, None, None]
        return np.asarray(fft.irfft(every, self._length, axis=1)[:, : self.rows.shape[1]])

    def returned(self, layer: Layer) -> float:
        """Largest value that a layer without memory returns to the near field, over the largest value of the field
        after the same step. The amplitudes of the waves beyond are added up.
        """
        reach, (tails, largest) = self.stencil.reach[0], self._undisturbed
        beside = np.einsum("mk,kij->mij", self._weights, _matrices(layer.kappa, reach))
        count = len(self._weights)
        back = np.zeros((count, min(len(self.rows), self._room) + self.margin + reach), complex)
        columns, worst = np.zeros((count, layer.columns), complex), 0.0
        for tail, size in zip(tails, largest, strict=True):
            here = back[:, -reach - 1 :] + tail[:, : reach + 1]
            changed = np.einsum("mij,mj->mi", beside, np.concatenate([here, columns], axis=1))
            # the contribution of the continued medium, which the layer replaces
            instead = _summed(self._weights, np.concatenate([np.zeros_like(here), tail[:, reach + 1 :]], axis=1))
            back, columns = back + _summed(self._weights, back), columns + changed[:, reach + 1 :]
            back[:, -reach - 1 :] += changed[:, : reach + 1] - instead[:, : reach + 1]
            inside = back[:, : back.shape[1] - self.margin]
            worst = max(worst, float(np.abs(self._along_side(inside)).sum(0).max()) / size)
        return worst


def waves_of(line: np.ndarray) -> list[tuple[float, float]]:
    """Some wavenumbers times spacing that represent those of values along an axis, and the share of each in the largest
    value, as if all were in phase there.
    """
    length = fft.next_fast_len(_FINE * len(line), real=True)
    angles = 2 * np.pi * np.arange(length // 2 + 1) / length
    sizes = np.abs(fft.rfft(line, length)) * np.where((angles > 0) & (angles < np.pi), 2, 1)
    shares = sizes / (length * np.abs(line).max())
    bounds = np.searchsorted(angles, np.pi * (np.arange(_WAVES) / _WAVES) ** _LONGER)
    every = np.add.reduceat(shares, bounds)
    middles = np.add.reduceat(shares * angles, bounds) / np.where(every > 0, every, 1)
    return [(float(angle), float(share)) for angle, share in zip(middles, every, strict=True) if share > 0]


def _summed(weights: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """Sums of the chains, with zeros beyond the ends of the lines; weights (m, 2 K + 1), lines (m, n)."""
    reach, count, total = weights.shape[1] // 2, lines.shape[1], np.zeros_like(lines)
    for k, weight in zip(range(-reach, reach + 1), weights.T, strict=True):
        first, last = max(0, -k), count - max(0, k)
        total[:, first:last] += weight[:, None] * lines[:, first + k : last + k]
    return total


def _matrices(kappa: np.ndarray, reach: int) -> np.ndarray:
    """Matrices of a layer without memory: for a chain of weights w, the sum over k of w(k) times these matrices is the
    operator on the near field's nodes -K .. 0 and the columns 1 .. L. What the near field's nodes contribute to one
    another is left out.

    Returns
    -------
    ndarray, shape (2 K + 1, K + 1 + L, K + 1 + L)
    """
    count, last = len(kappa) - 1, reach
    found = np.zeros((2 * reach + 1, reach + 1 + count, reach + 1 + count))
    columns = slice(reach + 1, None)
    found[reach, columns, columns] = np.eye(count)
    for k, parts in enumerate(continuations(kappa[None].astype(complex), reach), 1):
        ahead, outwards = (part[0].real for part in parts)
        back, near = outwards[:, :count], outwards[:, count:]
        for i in range(reach - k + 1):  # for the node -i, which is i nodes from column 0
            found[reach + i + k, last - i, last:] += ahead[0]
        found[reach + k, columns, last:] += ahead[1:]
        found[reach - k, columns, columns] += back
        found[reach - k, columns, : last + 1] += near[:, ::-1]
    return found

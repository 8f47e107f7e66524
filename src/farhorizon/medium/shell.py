"""The shell of a box of nodes: the field there determines what the box radiates into the medium around it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from farhorizon.medium.stencil import Stencil
from farhorizon.medium.stratified_medium import StratifiedMedium

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True, eq=False)
class Shell:
    r"""The nodes within one reach of the faces of a box, on both sides of them, and the commutator of an operator with
    the box; `first` and `last` are the smallest and the largest index of the box along each axis.

    Let :math:`\chi` be 1 on the nodes of the box and 0 outside. Where u solves the equation of the uniform medium
    outside the box, :math:`(1 - \chi) u` is what that medium radiates, on the whole infinite lattice, when it is driven
    by the forces :math:`f = L (\chi u) - \chi L u`. Only bonds between a node inside and one outside contribute to
    them: :math:`f_i = \sum_j w_{ij} (\chi_j - \chi_i) u_j`. There is no quadrature error, whatever the integrator. The
    counterpart in electromagnetics uses a surface between the nodes, and has the error of its quadrature: Taflove and
    Hagness, Computational Electrodynamics (2005), chapter 8.

    Examples
    --------
    >>> shell = Shell(Stencil.finite_difference(1), [3], [6])
    >>> shell.nodes.ravel().tolist()
    [2, 3, 6, 7]
    >>> shell.commutator.toarray()[0].tolist()  # the node outside is pulled by its neighbour inside
    [0.0, 1.0, 0.0, 0.0]
    """

    stencil: Stencil
    first: ArrayLike
    last: ArrayLike
    #: The medium where its weights depend on the row; a box that extends beyond its free side is open there.
    end: StratifiedMedium | None = None

    @cached_property
    def nodes(self) -> np.ndarray:
        """Indices of the nodes with a bond through a face, in order, shape (W, dim)."""
        first, last, reach = np.array(self.first), np.array(self.last), np.array(self.stencil.reach)
        grid = np.indices(last - first + 2 * reach + 1).reshape(len(reach), -1).T + first - reach
        near = grid[~((grid >= first + reach) & (grid <= last - reach)).all(1) & self._exist(grid)]
        inside = self.contains(near)
        crossed = np.zeros(len(near), bool)
        for offset in self._offsets:
            crossed |= (self.contains(near + offset) != inside) & self._exist(near + offset)
        return near[crossed]

    @property
    def _offsets(self) -> np.ndarray:
        return self.stencil.offsets if self.end is None else self.end.offsets

    @property
    def _weights(self) -> np.ndarray:
        """Weights of bonds by the row of a node and the offset, shape (rows, K, components, components)."""
        if self.end is not None:
            return self.end.weights
        return self.stencil.weights.reshape(1, -1, self.stencil.components, self.stencil.components)

    @property
    def _rows(self) -> np.ndarray:
        """Row of each node of the shell in `_weights`."""
        return 0 * self.nodes[:, 0] if self.end is None else self.end.row_of_weights(self.nodes)

    def _exist(self, nodes: np.ndarray) -> np.ndarray:
        """Which nodes exist."""
        return np.ones(len(nodes), bool) if self.end is None else self.end.exists(nodes)

    def contains(self, nodes: np.ndarray) -> np.ndarray:
        """Which nodes, indices of shape (.., dim), are in the box."""
        return np.asarray(((nodes >= np.array(self.first)) & (nodes <= np.array(self.last))).all(-1))

    @cached_property
    def inside(self) -> np.ndarray:
        """Which nodes of the shell are in the box, shape (W,)."""
        return self.contains(self.nodes)

    @cached_property
    def commutator(self) -> csr_array:
        """Forces on the nodes of the shell from the field there, for unit spacing and coefficient; a sparse matrix of
        shape (components * W, components * W), components first.
        """
        from scipy import sparse

        nodes, weights, rows_of = self.nodes, self._weights, self._rows
        count = len(nodes)
        low = nodes.min(0)
        extent = nodes.max(0) - low + 1
        numbers = np.full(int(np.prod(extent)), -1)
        numbers[np.ravel_multi_index(tuple((nodes - low).T), tuple(extent))] = np.arange(count)
        rows, columns, values = [], [], []
        for number, offset in enumerate(self._offsets):
            ends = nodes + offset
            jump = (self.contains(ends).astype(float) - self.inside) * self._exist(ends)
            (i,) = np.nonzero(jump)
            j = numbers[np.ravel_multi_index(tuple((ends[i] - low).T), tuple(extent))]
            for a, b in np.argwhere(weights[:, number].any(0)):
                rows.append(a * count + i)
                columns.append(b * count + j)
                values.append(weights[rows_of[i], number, a, b] * jump[i])
        size = self.stencil.components * count
        entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
        return sparse.csr_array(entries, shape=(size, size))

"""The operator of a medium that ends at a free side, where weights near the side differ from those inside."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from farhorizon.medium.force_states import ForceStates
from farhorizon.medium.stencil import Stencil

_FAINT = 1e-14  # weights smaller than this, relative to the largest, are rounding errors


@dataclass(frozen=True, eq=False)
class FreeSide:
    """A uniform medium without nodes beyond a side, ``(L u)_i = sum_k w_k (u_(i+k) - u_i)`` with weights that depend on
    the row of node i.

    For plain bonds, the weights are those of the stencil, without the absent bonds. Where forces follow from states,
    the nodes at both ends of a bond also lack some of their bonds, and have different shape tensors: rows differ down
    to twice the reach of the bonds, which is the reach of the stencil.

    Examples
    --------
    >>> end = FreeSide(Stencil.finite_difference(1), 0, 1)
    >>> end.offsets.ravel().tolist(), end.weights.reshape(2, 2).tolist()  # the outermost node has one neighbour
    ([-1, 1], [[1.0, 0.0], [1.0, 1.0]])
    """

    stencil: Stencil  # of the medium inside
    axis: int  # normal to the side
    side: int  # 1 if the medium ends towards larger indices, -1 towards smaller ones
    edge: int = 0  # index of the outermost nodes along the axis
    states: ForceStates | None = None  # whose convolution is the stencil; None for plain bonds

    @property
    def order(self) -> list[int]:
        """The axes, with the normal first."""
        return [self.axis, *(a for a in range(self.stencil.dim) if a != self.axis)]

    def row(self, nodes: np.ndarray) -> np.ndarray:
        """Rows of nodes, indices of shape (.., dim): 0 for the outermost, negative beyond the side."""
        return np.asarray(self.side * (self.edge - nodes[..., self.axis]))

    def weights_at(self, nodes: np.ndarray) -> np.ndarray:
        """Weights of the bonds of existing nodes (n, dim), shape (n, K, components, components)."""
        return np.asarray(self.weights[np.minimum(self.row(nodes), self.stencil.reach[self.axis])])

    @property
    def offsets(self) -> np.ndarray:
        """Offsets of all weights, shape (K, dim)."""
        return self._table[0]

    @property
    def weights(self) -> np.ndarray:
        """Weights of the rows from the outermost on, shape (rows, K, components, components); the last ones apply to
        all further rows.
        """
        return self._table[1]

    @cached_property
    def _table(self) -> tuple[np.ndarray, np.ndarray]:
        rows, components = self.stencil.reach[self.axis] + 1, self.stencil.components
        if self.states is None:
            weights = self.stencil.weights.reshape(-1, components, components)
            present = self.side * self.stencil.offsets[:, self.axis] <= np.arange(rows)[:, None]
            return self.stencil.offsets, present[..., None, None] * weights
        tables = np.stack([self._row_of_states(self.states, row) for row in range(rows)])
        size = np.abs(tables).max((0, -2, -1))
        size = np.maximum(size, np.flip(size))
        reach = np.array(size.shape) // 2
        size[tuple(reach)] = 0  # the weight of a node's own value is minus the sum of all others
        offsets = np.argwhere(size > _FAINT * size.max())
        return offsets - reach, tables[:, *offsets.T]

    def _row_of_states(self, states: ForceStates, row: int) -> np.ndarray:
        """Sum over the bonds of a node in a row of the forces due to the states at both ends, as a dense table of the
        weights of the displacements around the node, which is in its middle.
        """
        offsets, dim = states.offsets, self.stencil.dim
        reach = int(np.abs(offsets).max())
        up = self.side * offsets[:, self.axis]
        table = np.zeros((*[4 * reach + 1] * dim, dim, dim))
        for k in np.flatnonzero(up <= row):
            for end, at in ((offsets[k], row - up[k]), (0 * offsets[k], row)):
                present = up <= at
                (law,) = states.law(states.shapes[present].sum(0)[None], np.array([states.moduli]))
                pulled = states.divergence[k] @ law @ states.gradient[present]
                table[tuple((offsets[present] + end + 2 * reach).T)] += pulled
                table[tuple(end + 2 * reach)] -= pulled.sum(0)
            table[tuple(offsets[k] + 2 * reach)] += states.bonds[k]
        return table

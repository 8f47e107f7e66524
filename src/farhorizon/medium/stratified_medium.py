"""The operator of a medium whose weights depend on the row of a node down from a side."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from farhorizon.engine.bonds import combined
from farhorizon.medium.force_states import ForceStates
from farhorizon.medium.stencil import Stencil

_FAINT = 1e-14  # weights smaller than this, relative to the largest, are rounding errors


@dataclass(frozen=True, eq=False)
class Strata:
    """Constants of horizontal strata by row, from the outermost row on; those of the last row apply to all further
    rows.
    """

    bonds: np.ndarray  # factor on bonds, or on the springs beside states, (R,)
    density: np.ndarray  # mass of a node over that of the model, (R,)
    moduli: np.ndarray | None  # of the law of states, (R, 3); None if they are those of the states
    rule: str  # by which the factors of the ends of a bond are combined

    @property
    def slowness(self) -> np.ndarray:
        """Slowness of the slowest waves in each row over that in the last one, (R,)."""
        slowness = np.sqrt(self.density / self._shear)
        return np.asarray(slowness / slowness[-1])

    @property
    def reflection(self) -> float:
        """Reflection coefficient of the slowest waves between the rows that differ most, straight onto them."""
        impedance = np.sqrt(self.density * self._shear)
        return float(np.ptp(impedance) / (impedance.max() + impedance.min()))

    @property
    def _shear(self) -> np.ndarray:
        """Shear modulus of each row, or the modulus of a scalar field, up to a factor, (R,)."""
        return self.bonds if self.moduli is None or not self.moduli[:, 1].any() else self.moduli[:, 1]

    def _row(self, row: int | np.ndarray) -> np.ndarray:
        return np.clip(row, 0, len(self.bonds) - 1)

    def factor(self, row: int | np.ndarray, other: int | np.ndarray) -> np.ndarray:
        """Factor on the bonds between nodes of two rows."""
        return combined(self.rule, self.bonds[self._row(row)], self.bonds[self._row(other)])

    def density_at(self, row: int | np.ndarray) -> np.ndarray:
        """Mass of the nodes of a row over that of the model."""
        return np.asarray(self.density[self._row(row)])

    def moduli_at(self, row: int, states: ForceStates) -> np.ndarray:
        """Moduli of the law of the nodes of a row."""
        return np.array(states.moduli) if self.moduli is None else self.moduli[self._row(row)]


@dataclass(frozen=True, eq=False)
class StratifiedMedium:
    """A medium without nodes beyond a side, ``(L u)_i = sum_k w_k (u_(i+k) - u_i)`` with weights that depend on the row
    of node i; or, if `open`, one that continues beyond the side as it is in the outermost row.

    For plain bonds, the weights are those of the stencil, without the absent bonds. Where forces follow from states,
    the nodes at both ends of a bond also lack some of their bonds, and have different shape tensors: rows differ down
    to twice the reach of the bonds, which is the reach of the stencil. Further rows differ if there are strata.

    Examples
    --------
    >>> end = StratifiedMedium(Stencil.finite_difference(1), 0, 1)
    >>> end.offsets.ravel().tolist(), end.weights.reshape(2, 2).tolist()  # the outermost node has one neighbour
    ([-1, 1], [[1.0, 0.0], [1.0, 1.0]])
    """

    stencil: Stencil  # of the model, which is that of the medium inside unless there are strata
    axis: int  # normal to the side
    side: int  # 1 if the side is that of larger indices, -1 if it is that of smaller ones
    edge: int = 0  # index of the outermost nodes along the axis
    states: ForceStates | None = None  # whose convolution is the stencil; None for plain bonds
    strata: Strata | None = None  # relative to the model; None if the medium is uniform
    open: bool = False  # whether the medium continues beyond the side

    @property
    def order(self) -> list[int]:
        """The axes, with the normal first."""
        return [self.axis, *(a for a in range(self.stencil.dim) if a != self.axis)]

    def row(self, nodes: np.ndarray) -> np.ndarray:
        """Rows of nodes, indices of shape (.., dim): 0 for the outermost, negative beyond the side."""
        return np.asarray(self.side * (self.edge - nodes[..., self.axis]))

    def exists(self, nodes: np.ndarray) -> np.ndarray:
        """Which nodes, indices of shape (.., dim), there are."""
        rows = self.row(nodes)
        return np.full(rows.shape, True) if self.open else rows >= 0

    def row_of_weights(self, nodes: np.ndarray) -> np.ndarray:
        """Row in `weights` of existing nodes, indices of shape (.., dim)."""
        return np.clip(self.row(nodes), 0, len(self.weights) - 1)

    def weights_at(self, nodes: np.ndarray) -> np.ndarray:
        """Weights of the bonds of existing nodes (n, dim), shape (n, K, components, components)."""
        return np.asarray(self.weights[self.row_of_weights(nodes)])

    @property
    def offsets(self) -> np.ndarray:
        """Offsets of all weights, shape (K, dim)."""
        return self._table[0]

    @property
    def weights(self) -> np.ndarray:
        """Weights of the rows from the outermost on, shape (rows, K, components, components); the last ones apply to
        all further rows, and the first ones to those beyond an open side.
        """
        return self._table[1]

    @cached_property
    def inside(self) -> Stencil:
        """Stencil of the medium inside, below all strata."""
        if self.strata is None:
            return self.stencil
        weights = self.weights[-1, :, 0, 0] if self.stencil.components == 1 else self.weights[-1]
        return Stencil(self.offsets, weights, self.stencil.reaction)

    @cached_property
    def _table(self) -> tuple[np.ndarray, np.ndarray]:
        rows, components = self.stencil.reach[self.axis] + 1, self.stencil.components
        if self.strata is not None:
            rows += len(self.strata.bonds) - 1
        if self.states is None:
            weights = self.stencil.weights.reshape(-1, components, components)
            number, up = np.arange(rows)[:, None], self.side * self.stencil.offsets[:, self.axis]
            factors = np.asarray(self._present(up, number), float)
            if self.strata is not None:
                factors = factors * self.strata.factor(number, number - up) / self.strata.density_at(number)
            return self.stencil.offsets, factors[..., None, None] * weights
        tables = np.stack([self._row_of_states(self.states, row) for row in range(rows)])
        size = np.abs(tables).max((0, -2, -1))
        size = np.maximum(size, np.flip(size))
        reach = np.array(size.shape) // 2
        size[tuple(reach)] = 0  # the weight of a node's own value is minus the sum of all others
        offsets = np.argwhere(size > _FAINT * size.max())
        return offsets - reach, tables[:, *offsets.T]

    def _present(self, up: np.ndarray, row: int | np.ndarray) -> np.ndarray:
        """Which bonds, by the rows that they lead up, the nodes of a row have."""
        return np.asarray((up <= row) | self.open)

    def _row_of_states(self, states: ForceStates, row: int) -> np.ndarray:
        """Sum over the bonds of a node in a row of the forces due to the states at both ends, as a dense table of the
        weights of the displacements around the node, which is in its middle.
        """
        offsets, dim = states.offsets, self.stencil.dim
        reach = int(np.abs(offsets).max())
        up = self.side * offsets[:, self.axis]
        table = np.zeros((*[4 * reach + 1] * dim, dim, dim))
        for k in np.flatnonzero(self._present(up, row)):
            for end, at in ((offsets[k], row - up[k]), (0 * offsets[k], row)):
                present = self._present(up, at)
                moduli = np.array(states.moduli) if self.strata is None else self.strata.moduli_at(at, states)
                (law,) = states.law(states.shapes[present].sum(0)[None], moduli[None])
                pulled = states.divergence[k] @ law @ states.gradient[present]
                table[tuple((offsets[present] + end + 2 * reach).T)] += pulled
                table[tuple(end + 2 * reach)] -= pulled.sum(0)
            factor = 1.0 if self.strata is None else self.strata.factor(row, row - up[k])
            table[tuple(offsets[k] + 2 * reach)] += factor * states.bonds[k]
        return table if self.strata is None else table / self.strata.density_at(row)

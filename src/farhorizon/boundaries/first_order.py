"""Conventional first-order condition, u_t + c u_n + d u = 0, on the outermost nodes.

Appendix A of Hermann, Shojaei, Seleson, Cyron and Silling (2023), eq A13, as the boundary term of linear finite
elements with lumped masses: an outermost node has elements on the inside only, which doubles its bonds inwards, and its
damping and stiffness increase by d + c/spacing and 2 c d/spacing for each side that it lies on. Both are positive, so
the condition never causes growth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import sparse

from farhorizon.boundaries.outline import Closing, Medium, OutlineNodes
from farhorizon.errors import InputError


@dataclass(frozen=True)
class FirstOrder(Closing):
    """Flat side that transmits waves along its normal; only for classical waves, that is, stencils that reach one node.

    Examples
    --------
    >>> import farhorizon as fh
    >>> grid = fh.Stencil.finite_difference(2)
    >>> lattice = fh.Lattice(1.0, (-9.0, -9.0), (9.0, 9.0))
    >>> sim = fh.Simulation(lattice, fh.Wave(grid), fh.FirstOrder(), {"u": "exp(-x**2 - y**2)"})
    >>> sim.certificate().verdict
    'certified'
    """

    passive: ClassVar[bool] = True

    def wanted(self, default: float) -> float:
        """Return the fraction of the largest value that may be neglected beyond the side: much less than the error of
        the condition itself.
        """
        return 1e-6

    def depth(self, medium: Medium, spacing: float, extent: float) -> float:
        """Return the distance to which nodes are read inwards."""
        return spacing * float(np.sqrt(medium.offsets.shape[1]))

    def update(self, fringe: OutlineNodes, halo: np.ndarray, medium: Medium) -> sparse.csr_array:
        """Return the rows for the halo nodes (positions in the fringe) over the new level and earlier ones, shape (H, 3
        S).

        Raises
        ------
        InputError
            For diffusion, a stencil that reaches further than one node, or a curved outline.
        """
        if medium.order != 2:
            raise InputError(
                "the first-order condition is for waves",
                value="diffusion",
                key="boundary",
                remedy="PlaneWave or LatticePML",
            )
        offsets = np.round(medium.offsets / fringe.spacing).astype(int)
        if np.abs(offsets).max() > 1:
            raise InputError(
                "the first-order condition is for classical equations",
                value=f"reach {np.abs(offsets).max()}",
                limit="1 node",
                key="boundary",
                remedy="Higdon, PlaneWave or LatticePML",
            )
        if fringe.faces is None:
            raise InputError(
                "the first-order condition needs flat sides",
                key="boundary",
                remedy="lower and upper in place of a window, or Higdon",
            )
        size, faces = len(fringe.points), fringe.faces[halo]
        speed, dt = float(np.sqrt(medium.coefficient)), medium.dt
        rate = medium.damping + np.abs(faces).sum(1) * speed / fringe.spacing
        stiffness = 2 * speed * medium.damping / fringe.spacing * np.abs(faces).sum(1)
        after, scale = 1 + rate * dt, dt**2 / (1 + rate * dt)
        rows_of_halo = np.arange(len(halo))
        rows, columns, data = (
            [rows_of_halo, rows_of_halo],
            [size + halo, 2 * size + halo],
            [2 / after - scale * stiffness, -(1 - rate * dt) / after],
        )
        for offset, weight in zip(offsets, medium.weights, strict=True):
            folded = np.where(faces * offset > 0, -offset, offset)
            neighbour, bond = fringe.at(fringe.index[halo] + folded), fringe.bonded(fringe.index[halo] + folded)
            inside = neighbour >= 0  # other nodes are held at zero
            rows += [rows_of_halo[inside], rows_of_halo[bond]]
            columns += [size + neighbour[inside], size + halo[bond]]
            data += [weight * scale[inside], -weight * scale[bond]]
        return sparse.csr_array(
            (np.concatenate(data), (np.concatenate(rows), np.concatenate(columns))), shape=(len(halo), 3 * size)
        )

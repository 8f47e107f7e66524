"""Higdon's conditions: a product of one-way wave operators along a grid axis.

R. L. Higdon (1986), Math. Comp. 47: ``prod_j (cos a_j d_t + c d_n + eps) u = 0`` transmits plane waves at the angles
a_j. The box scheme over one spacing and one step yields each halo node from nodes further in, at the new step and at
earlier ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from typing import ClassVar

import numpy as np
from scipy import sparse

from farhorizon import kinds
from farhorizon.arguments import Frequency
from farhorizon.boundaries.outline import Closing, Medium, OutlineNodes
from farhorizon.errors import InputError


@dataclass(frozen=True)
class Higdon(Closing):
    """Side or outline that transmits waves arriving at given angles; for waves only.

    Along a curved outline each node uses the grid axis nearest to its normal. Two angles were stable in all tests
    but for finite elements; three reflect less at a flat side, but grow at some curved ones.

    Parameters
    ----------
    angles : sequence of float
        In degrees, one per factor.
    shift : float, optional
        eps in ``cos a d_t + c d_n + eps`` (1/time), which prevents slow fields from drifting; unless given, the damping
        d of ``2 d u_t`` or half the speed divided by half the extent of the near field, whichever is larger.

    Raises
    ------
    InputError
        No angle or more than 4, angles of 90 or more, a negative shift.

    Examples
    --------
    >>> import farhorizon as fh
    >>> fh.Higdon(angles=(0.0, 60.0))
    Higdon(angles=(0.0, 60.0), shift=None)
    """

    label: ClassVar[str] = "Higdon"
    angles: tuple[float, ...] = (0.0, 45.0)
    shift: Frequency | None = None

    def __post_init__(self) -> None:
        angles = np.atleast_1d(kinds.array(self.angles, "boundary.angles"))
        kinds.set_fields(
            self,
            angles=tuple(kinds.array(angles, "boundary.angles", shape=(None,)).tolist()),
            shift=None if self.shift is None else kinds.number(self.shift, "boundary.shift", least=0),
        )
        if not 1 <= len(self.angles) <= 4:
            raise InputError(
                "a Higdon condition has one to four angles", value=list(self.angles), key="boundary.angles"
            )
        if not all(0 <= abs(a) < 90 for a in self.angles):
            raise InputError(
                "waves arrive at less than 90 degrees", value=list(self.angles), limit="below 90", key="boundary.angles"
            )

    def wanted(self, default: float) -> float:
        """Return the fraction of the largest value that may be neglected beyond the outline: much less than the error
        of the condition itself.
        """
        return 1e-6

    def depth(self, medium: Medium, spacing: float, extent: float) -> float:
        """Return the distance to which nodes are read inwards."""
        return len(self.angles) * spacing

    def stencil(self, speed: float, spacing: float, dt: float, shift: float) -> np.ndarray:
        """Return the weights of earlier steps (rows) and of nodes further inwards (columns), shape (J + 1, J + 1); that
        of the node itself at the new step is 0.
        """
        factors = []
        for angle in self.angles:
            time, space = np.cos(np.radians(angle)) / (2 * dt), speed / (2 * spacing)
            factors.append(np.array([[time + space, time - space], [space - time, -time - space]]) + shift / 4)

        def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
            summed = np.zeros((a.shape[0] + 1, a.shape[1] + 1))
            for i in range(2):
                for j in range(2):
                    summed[i : i + a.shape[0], j : j + a.shape[1]] += a * b[i, j]
            return summed

        operator = reduce(product, factors)
        weights = -operator / operator[0, 0]
        weights[0, 0] = 0
        return weights

    def update(self, fringe: OutlineNodes, halo: np.ndarray, medium: Medium) -> sparse.csr_array:
        """Return the rows for the halo nodes (positions in the fringe) over the new level and earlier ones, shape (H,
        (J + 2) S).

        Raises
        ------
        InputError
            For diffusion, or an outline whose normal changes within the range of the nodes that are read.
        """
        if medium.order != 2:
            raise InputError(
                "Higdon's condition is for waves", value="diffusion", key="boundary", remedy="PlaneWave or LatticePML"
            )
        speed = float(np.sqrt(medium.coefficient))
        shift = max(medium.damping, 0.5 * speed / fringe.extent) if self.shift is None else self.shift
        weights = self.stencil(speed, fringe.spacing, medium.dt, shift)
        size = len(weights)
        columns = np.empty((len(halo), size, size), int)
        for steps in range(size):
            places = fringe.at(fringe.index[halo] - steps * fringe.axes[halo])
            if (places < 0).any():
                where = fringe.points[halo[np.argmax(places < 0)]].tolist()
                raise InputError(
                    "Higdon's condition needs nodes straight inwards of each halo node",
                    value=where,
                    limit=f"{size - 1} nodes",
                    key="boundary",
                    remedy="a larger or smoother window, fewer angles, or LatticePML",
                )
            columns[:, :, steps] = np.arange(size) * len(fringe.points) + places[:, None]
        rows = np.repeat(np.arange(len(halo)), size**2)
        data = np.broadcast_to(weights, columns.shape).ravel()
        rows_of_halo = sparse.csr_array((data, (rows, columns.ravel())), shape=(len(halo), size * len(fringe.points)))
        rows_of_halo.eliminate_zeros()
        return rows_of_halo

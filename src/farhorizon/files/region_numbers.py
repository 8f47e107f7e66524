"""Regions beside the fields of a results file: a number a node, which does not change in time, and a name for each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

FIELD = "region"
"""Their name among the point data, where ParaView finds them."""
OUTSIDE = -1
"""Number of nodes that do not exist, outside a body or a window."""
_TOLD = 6  # regions in a row of a report


class Regions(NamedTuple):
    """Nodes that are made of the same.

    Attributes
    ----------
    numbers : ndarray of int32, of the lattice's shape
        That of each node's region from 0 on; -1 where there is no node.
    names : tuple of str
        Of what each is made, by number.
    """

    numbers: np.ndarray
    names: tuple[str, ...]

    def __str__(self) -> str:
        """The largest ones, and how many nodes each has."""
        counts = np.bincount(self.numbers[self.numbers >= 0], minlength=len(self.names))
        told = [f"{name} ({count} nodes)" for name, count in zip(self.names[:_TOLD], counts.tolist(), strict=False)]
        more = len(self.names) - _TOLD
        return "; ".join(told + [f"{more} more"] * (more > 0))

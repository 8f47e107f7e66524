"""Regions beside the fields of a results file: a number for each node, constant in time, and a name for each number."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

FIELD = "region"
"""Name of the regions among the point data, under which ParaView lists them."""
OUTSIDE = -1
"""Region number of nodes that do not exist, outside a body or a window."""
_NAMED = 6  # most regions named in a row of a report


class Regions(NamedTuple):
    """Regions of nodes of the same material."""

    numbers: np.ndarray  # of the lattice's shape, int32: each node's region, from 0 on; -1 where there is no node
    names: tuple[str, ...]  # of the materials, by number

    def __str__(self) -> str:
        """The largest regions with their numbers of nodes, and how many more there are."""
        counts = np.bincount(self.numbers[self.numbers >= 0], minlength=len(self.names))
        named = [f"{name} ({count} nodes)" for name, count in zip(self.names[:_NAMED], counts.tolist(), strict=False)]
        more = len(self.names) - _NAMED
        return "; ".join(named + [f"{more} more"] * (more > 0))

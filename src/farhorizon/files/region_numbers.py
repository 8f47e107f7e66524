"""Regions beside the fields of a results file: a number a node, which does not change in time, and a name for each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

FIELD = "region"
"""Their name among the point data, where ParaView finds them."""
OUTSIDE = -1
"""Number of nodes that do not exist, outside a body or a window."""


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

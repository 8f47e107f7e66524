"""Forces on a body from outside: per volume, and per area on its free sides."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class BodyForce:
    """A force per volume on the near field.

    Parameters
    ----------
    value : sequence of (ndarray, callable or float)
        One component an axis: an array of the lattice's shape, a function of the coordinates, or a number.
    time : callable, optional
        Factor of t; 1 unless given.
    """

    value: Sequence[Any]
    time: Callable[[float], float] | None = None


@dataclass(frozen=True)
class Traction:
    """A force per area on a free side, a body force on its outermost nodes.

    Parameters
    ----------
    side : str
        "x-", "y+", ...
    value : sequence of float
        One component an axis.
    between : sequence of (float, float), optional
        Where it acts, along each of the other axes in their order; the whole side unless given. Nodes on either end count.
    time : callable, optional
        Factor of t; 1 unless given.
    """

    side: str
    value: Sequence[float]
    between: Sequence[tuple[float, float]] | None = None
    time: Callable[[float], float] | None = None

"""Boundaries without a layer: a fixed value, absent bonds, a copy of the other side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from farhorizon import kinds


@dataclass(frozen=True)
class Fixed:
    """The field has a given value on every node beyond the side.

    Parameters
    ----------
    value : float
    """

    value: float = 0.0
    image: ClassVar[int] = -1  # sign of what it sends back

    def __post_init__(self) -> None:
        kinds.settle(self, value=kinds.number(self.value, "boundary.value"))


@dataclass(frozen=True)
class Free:
    """The body ends: bonds across the side do not exist."""

    image: ClassVar[int] = 1  # sign of what it sends back


@dataclass(frozen=True)
class Periodic:
    """The field repeats itself beyond the opposite side."""

"""Boundaries without a layer: a fixed value, absent bonds, a copy of the other side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

from farhorizon import kinds
from farhorizon.boundaries.side import Side


@dataclass(frozen=True)
class Fixed(Side):
    """The field has a given value on every node beyond the side.

    Parameters
    ----------
    value : float
    """

    value: float = 0.0
    passive: ClassVar[bool] = True
    image: ClassVar[int] = -1
    cracks: ClassVar[Literal["end"]] = "end"

    def __post_init__(self) -> None:
        kinds.settle(self, value=kinds.number(self.value, "boundary.value"))

    @property
    def held(self) -> float:
        """The value."""
        return self.value


@dataclass(frozen=True)
class Free(Side):
    """The body ends: bonds across the side do not exist."""

    bonded: ClassVar[bool] = False
    passive: ClassVar[bool] = True
    image: ClassVar[int] = 1
    cracks: ClassVar[Literal["end"]] = "end"


@dataclass(frozen=True)
class Periodic(Side):
    """The field repeats itself beyond the opposite side."""

    periodic: ClassVar[bool] = True
    passive: ClassVar[bool] = True

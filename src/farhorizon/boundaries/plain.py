"""Boundaries without a layer: a fixed value, absent bonds, a copy of the other side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from farhorizon.errors import InputError


@dataclass(frozen=True)
class Fixed:
    """The field has a given value on every node beyond the side.

    Parameters
    ----------
    value : float
    """

    value: float = 0.0

    def __post_init__(self) -> None:
        if not np.isfinite(self.value):
            raise InputError("the fixed value must be finite", value=self.value, key="boundary.value")


@dataclass(frozen=True)
class Free:
    """The body ends: bonds across the side do not exist."""


@dataclass(frozen=True)
class Periodic:
    """The field repeats itself beyond the opposite side."""

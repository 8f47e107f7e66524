"""Sources: functions of space and time on the near field."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from farhorizon.errors import InputError
from farhorizon.expressions import Expression
from farhorizon.lattice import Lattice


@dataclass(frozen=True)
class Source:
    """A term s(x, t) on the right-hand side.

    Parameters
    ----------
    value : ndarray, callable, Expression or float
        An array of the lattice's shape, a callable of the coordinates (with `time`) or of the coordinates and t
        (without), an expression of x, y, z, t, or a number.
    time : callable, optional
        Factor of t. A source that is a product of space and time runs without returning to Python.
    """

    value: Any
    time: Callable[[float], float] | None = None


def split(source: Any, lattice: Lattice) -> tuple[np.ndarray | None, Callable[..., Any]]:
    """(space, time) with ``s = space * time(t)``, or (None, s) with ``s(t)`` an array of the lattice's shape.

    Raises
    ------
    InputError
        An array of another shape, or values that are not finite.
    """
    if not isinstance(source, Source):
        source = Source(source)
    value, time = source.value, source.time
    coordinates = lattice.coordinates()
    if isinstance(value, Expression):
        parts = value.separate()
        if parts is not None:
            space, factor = parts
            own = lambda t: float(factor(t=t))  # noqa: E731
            both = own if time is None else lambda t: own(t) * time(t)
            return checked(space(*coordinates), lattice), both
        return None, lambda t: checked(value(*coordinates, t=t), lattice) * (1.0 if time is None else time(t))
    if callable(value):
        if time is None:
            return None, lambda t: checked(value(*coordinates, t), lattice)
        return checked(value(*coordinates), lattice), time
    return checked(value, lattice), time or (lambda t: 1.0)


def checked(value: Any, lattice: Lattice, key: str = "source") -> np.ndarray:
    """The values as a float array of the lattice's shape; zero outside a body, and outside a window where not finite."""
    values = np.asarray(value, float)
    if values.ndim and values.shape != lattice.shape:
        raise InputError("an array must have the lattice's shape", value=values.shape, limit=lattice.shape, key=key)
    values = np.broadcast_to(values, lattice.shape)
    shown = values if lattice.mask is None else values[lattice.mask]
    if not np.isfinite(shown).all():
        raise InputError("values must be finite", value=f"{int((~np.isfinite(shown)).sum())} nan or inf", key=key)
    if lattice.mask is None:
        return values
    return np.where(lattice.mask if lattice.body is not None else np.isfinite(values), values, 0.0)

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


def steady(t: float) -> float:
    """The factor 1 of what does not depend on time."""
    return 1.0


def parts(source: Any) -> tuple[Any, Callable[..., Any]]:
    """(space, time) with ``s = space * time(t)``, space a callable of the coordinates, an array or a number; or (None, s(*coordinates, t))."""
    if not isinstance(source, Source):
        source = Source(source)
    value, time = source.value, source.time
    if isinstance(value, Expression):
        both = value.separate()
        factor = time or steady
        if both is None:
            return None, lambda *at: value(*at[:-1], t=at[-1]) * factor(at[-1])
        space, own = both
        return space, lambda t: float(own(t=t)) * factor(t)
    if callable(value) and time is None:
        return None, value
    return value, time or steady


def split(source: Any, lattice: Lattice) -> tuple[np.ndarray | None, Callable[..., Any]]:
    """(space, time) with ``s = space * time(t)``, or (None, s) with ``s(t)`` an array of the lattice's shape.

    Raises
    ------
    InputError
        An array of another shape, or values that are not finite.
    """
    space, time = parts(source)
    coordinates = lattice.coordinates()
    if space is None:
        return None, lambda t: checked(time(*coordinates, t), lattice)
    return checked(space(*coordinates) if callable(space) else space, lattice), time


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

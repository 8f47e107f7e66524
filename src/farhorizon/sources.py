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
    value : ndarray, callable, Expression or float, or a sequence of one a component
        An array of the lattice's shape, a callable of the coordinates (with `time`) or of the coordinates and t
        (without), an expression of x, y, z, t, or a number. Of a vector field, a body force: arrays and what callables return have the
        components first.
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


def split(source: Any, lattice: Lattice, components: int = 1) -> tuple[np.ndarray | None, Callable[..., Any]]:
    """(space, time) with ``s = space * time(t)``, or (None, s) with ``s(t)`` an array of the field's shape.

    Raises
    ------
    InputError
        An array of another shape, or values that are not finite.
    """
    space, time = parts(source)
    if space is None:
        return None, lambda t: field(time(*lattice.coordinates(), t), lattice, components)
    return field(space, lattice, components), time


def by_component(source: Any, lattice: Lattice, components: int) -> list[tuple[Any, Any]]:
    """A source as (scalar source, unit), whose products make up that of a vector field, or as (source, 1) where it is given whole."""
    value, time = (source.value, source.time) if isinstance(source, Source) else (source, None)
    if components == 1 or not isinstance(value, list | tuple):
        return [(source, 1.0)]
    if len(value) != components:
        raise InputError("a source of a vector field needs all components", value=len(value), limit=components, key="source")
    units = np.eye(components).reshape(components, components, *[1] * lattice.dim)
    found = [(Source(part, time), unit) for part, unit in zip(value, units, strict=True)]
    return [pair for pair in found if not _is_zero(pair[0].value)] or found


def _is_zero(value: Any) -> bool:
    """Whether a component is left at zero: the number, or an expression that is nothing else."""
    if isinstance(value, Expression):
        return not (value.uses_space or value.uses_time) and not value(*[0.0] * value.dim).any()
    return bool(np.isscalar(value)) and value == 0


def field(value: Any, lattice: Lattice, components: int, key: str = "source") -> np.ndarray:
    """Values on the nodes, shape of the lattice, of vectors with the components first, from an array, a callable or a number, or one a component.

    Raises
    ------
    InputError
        As `checked`, or not as many components as the field has.
    """
    found = value(*lattice.coordinates()) if callable(value) else value
    if components == 1:
        return checked(found, lattice, key)
    if np.isscalar(found) or len(found) != components:
        raise InputError("a vector field needs one entry a component", value="a number" if np.isscalar(found) else f"{len(found)} entries",
                         limit=components, key=key)  # fmt: skip
    return np.stack([field(part, lattice, 1, f"{key}[{i}]") for i, part in enumerate(found)])


def magnitude(value: Any) -> Callable[..., np.ndarray]:
    """The largest magnitude of any component, as a function of the coordinates (and t), of what `field` takes."""

    def largest(*at: Any) -> np.ndarray:
        found = value(*at) if callable(value) else value
        entries = [entry(*at) if callable(entry) else entry for entry in (found if isinstance(found, list | tuple) else [found])]
        sizes = [np.abs(np.asarray(entry, float)) for entry in entries]
        sizes = [size.max(0) if size.ndim > np.ndim(at[0]) else np.broadcast_to(size, np.shape(at[0])) for size in sizes]
        return np.asarray(np.max(sizes, axis=0))

    return largest


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

"""Sources: functions of space and time on the near field."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import ANY, Function, OfTime, Unit
from farhorizon.errors import InputError, shown
from farhorizon.files.storable import Storable
from farhorizon.geometry.lattice import AXES, Lattice
from farhorizon.inputs.expressions import Expression, as_given, as_signal
from farhorizon.inputs.signals import Signal

#: Range of the largest value of data for each type of numbers: the squares of larger values, as in an energy and its
#: parts, overflow, and those of smaller ones vanish. In single precision the range leaves room for the coefficients by
#: which squares are multiplied.
_RANGES = {"float64": (0.0, 1e150), "float32": (1e-15, 1e15)}

_IN_FILE = "The term, a function of the coordinates and t; for vectors a list with one entry per component."


@dataclass(frozen=True)
class Source(Storable):
    """A term s(x, t) on the right-hand side.

    Parameters
    ----------
    value : ndarray, callable, str, Expression or float, or a list of one per component
        An array of the lattice's shape, a callable of the coordinates (with `time`) or of the coordinates and t
        (without), an expression of x, y, z, t, or a number. For a vector field this is a body force: arrays and return
        values of callables have the components first.
    time : callable, str, Expression or float, optional
        Factor of t; 1 unless given. A source that is a product of space and time runs without returning to Python.

    Raises
    ------
    InputError
        A time factor that is not a function of t.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> pulse = fh.Source("exp(-x**2)", time=lambda t: np.exp(-((t - 2.0) ** 2)))
    >>> sim = fh.Simulation(fh.Lattice(0.5, -9, 9), fh.Wave(fh.Kernel(1.0)), sources=[pulse])
    >>> _ = sim.run(until=4.0)
    >>> bool(sim.fields["u"].max() > 0.5)
    True
    """

    value: Annotated[Any, Function(components=True, field=True), Unit(ANY), _IN_FILE]
    time: OfTime = None

    def __post_init__(self) -> None:
        if self.time is not None:
            kinds.set_fields(self, time=as_signal(self.time, "source.time"))


def steady(t: float) -> float:
    """The time factor 1 of whatever does not depend on time."""
    return 1.0


@dataclass(frozen=True)
class TimeFactors:
    """The product of two functions of time."""

    first: Callable[[float], Any]
    second: Callable[[float], Any]

    def __call__(self, t: float) -> float:
        return float(self.first(t)) * float(self.second(t))


def at_times(time: Callable[[float], Any], times: np.ndarray, key: str = "source.time") -> np.ndarray:
    """Values of a function of time, which are numbers, at times of any shape: signals and expressions are evaluated at
    all times at once, functions in Python at one after the other.
    """
    if isinstance(time, TimeFactors):
        return at_times(time.first, times, key) * at_times(time.second, times, key)
    if isinstance(time, Expression | Signal):
        return kinds.array(time(times), key, shape=times.shape, finite=False)
    each = kinds.array([time(t) for t in times.ravel()], key, shape=(times.size,), finite=False)
    return each.reshape(times.shape)


def as_source(source: Any, dim: int, key: str) -> Any:
    """Return a source, or a value that is given like one, with texts as `Expression` of the lattice's coordinates;
    raises InputError for a text that is not one, and a function of other arguments than these and, without a factor of
    time, t.
    """
    value, timed = (source.value, source.time is not None) if isinstance(source, Source) else (source, False)
    parsed = as_given(value, dim, key)
    for entry in parsed if isinstance(parsed, list | tuple) else [parsed]:
        if callable(entry) and not isinstance(entry, Expression):
            kinds.function(entry, key, ", ".join(AXES[:dim]) + ("" if timed else ", t"))
    return replace(source, value=parsed) if isinstance(source, Source) else parsed


def space_and_time(source: Any) -> tuple[Any, Callable[..., Any]]:
    """Return (space, time) with ``s = space * time(t)``, space a callable of the coordinates, an array or a number; or
    (None, s(*coordinates, t)).
    """
    if not isinstance(source, Source):
        source = Source(source)
    value, time = source.value, source.time
    if isinstance(value, Expression):
        both = value.separate()
        factor = time or steady
        if both is None:
            return None, lambda *at: value(*at[:-1], t=at[-1]) * factor(at[-1])
        space, history = both
        return space, history if time is None else TimeFactors(history, time)
    if callable(value) and time is None:
        return None, value
    return value, time or steady


def split(source: Any, lattice: Lattice, components: int = 1) -> tuple[np.ndarray | None, Callable[..., Any]]:
    """Return (space, time) with ``s = space * time(t)``, or (None, s) with ``s(t)`` an array of the field's shape;
    raises InputError for an array of another shape, and values that are not finite.
    """
    space, time = space_and_time(source)
    if space is None:
        return None, lambda t: field(time(*lattice.coordinates(), t), lattice, components)
    return field(space, lattice, components), time


def by_component(source: Any, lattice: Lattice, components: int) -> list[tuple[Any, Any]]:
    """Split a source into pairs (scalar source, unit) whose products add up to that of a vector field, or return
    [(source, 1)] if it is given as a whole.
    """
    value, time = (source.value, source.time) if isinstance(source, Source) else (source, None)
    if components == 1 or not isinstance(value, list | tuple):
        return [(source, 1.0)]
    if len(value) != components:
        raise InputError(
            "a source of a vector field needs one entry per component",
            value=f"{len(value)} entries",
            limit=f"a list of {components}",
            key="source",
            remedy="0 for a component that is not driven",
        )
    units = np.eye(components).reshape(components, components, *[1] * lattice.dim)
    pairs = [(Source(part, time), unit) for part, unit in zip(value, units, strict=True)]
    return [pair for pair in pairs if not _is_zero(pair[0].value)] or pairs


def _is_zero(value: Any) -> bool:
    """Whether a component is zero: the number 0, or a constant expression of this value."""
    if isinstance(value, Expression):
        return not (value.uses_space or value.uses_time) and not value.on(0)().any()
    return bool(np.isscalar(value)) and value == 0


def field(value: Any, lattice: Lattice, components: int, key: str = "source") -> np.ndarray:
    """Return values on the nodes from an array, a callable or a number, or one of these per component: of the lattice's
    shape, for vectors with the components first. Raises InputError as `checked`, and for a number of components other
    than that of the field.
    """
    values = value(*lattice.coordinates()) if callable(value) else value
    if components == 1:
        return checked(values, lattice, key)
    entries = (
        len(values)
        if isinstance(values, list | tuple) or (isinstance(values, np.ndarray) and values.ndim > lattice.dim)
        else None
    )
    if entries != components:
        raise InputError(
            "a vector field needs one entry per component",
            value="one for all" if entries is None else f"{entries} entries",
            limit=f"a list of {components}",
            key=key,
            remedy=_listed(components, lattice.dim),
        )
    return np.stack([field(part, lattice, 1, f"{key}[{i}]") for i, part in enumerate(values)])


def _listed(components: int, dim: int) -> str:
    """Example of how a field of several components is given, for messages."""
    bell = "exp(-" + " - ".join(f"{axis}**2" for axis in "xyz"[:dim]) + ")"
    return f'["{bell}", {", ".join(["0.0"] * (components - 1))}] for a field along x'


def largest_component(value: Any) -> Callable[..., np.ndarray]:
    """Largest magnitude of any component of what `field` accepts, as a function of the coordinates (and t)."""

    def largest(*at: Any) -> np.ndarray:
        values = value(*at) if callable(value) else value
        entries = [
            entry(*at) if callable(entry) else entry
            for entry in (values if isinstance(values, list | tuple) else [values])
        ]
        sizes = [np.abs(np.asarray(entry, float)) for entry in entries]
        sizes = [
            size.max(0) if size.ndim > np.ndim(at[0]) else np.broadcast_to(size, np.shape(at[0])) for size in sizes
        ]
        return np.asarray(np.max(sizes, axis=0))

    return largest


def check_size(
    values: np.ndarray, key: str, dtype: str = "float64", largest_of_all: Callable[[float], float] = float
) -> None:
    """Refuse data whose squares overflow or vanish in a type of numbers with an InputError; where there are several
    processes, all use the largest value of all.
    """
    least, most = _RANGES[dtype]
    largest = largest_of_all(float(np.abs(values).max(initial=0, where=np.isfinite(values))))
    if largest > most or 0 < largest < least:
        single = dtype == "float32"
        raise InputError(
            "values are beyond what can be computed with" + " in single precision" * single + ": their squares, as in "
            f"an energy, {'overflow' if largest > most else 'vanish'}",
            value=largest,
            limit=f"{least:g} to {most:g}" if single else f"{most:g}",
            key=key,
            remedy="other units" + ', or dtype="float64"' * single,
        )


def checked(value: Any, lattice: Lattice, key: str = "source") -> np.ndarray:
    """Values as a float array of the lattice's shape; zero outside a body, and outside a window where not finite."""
    values = np.broadcast_to(checked_shape(kinds.array(value, key, finite=False), lattice, key), lattice.shape)
    bad = ~np.isfinite(values) if lattice.mask is None else ~np.isfinite(values) & lattice.mask
    if bad.any():
        first = np.unravel_index(int(np.argmax(bad)), bad.shape)
        place = lattice.lower + lattice.spacing * np.array(first)
        raise InputError(
            "values must be finite",
            value=f"{values[first]:g} at {shown(place)}, and on {int(bad.sum())} of {bad.size} nodes in all",
            limit="no nan, no inf",
            key=key,
            remedy="where(condition, a, b) in an expression restricts it to where it is defined",
        )
    check_size(values, key)
    if lattice.mask is None:
        return values
    return np.where(np.isfinite(values) if lattice.existing is None else lattice.existing, values, 0.0)


def checked_shape(values: np.ndarray, lattice: Lattice, key: str) -> np.ndarray:
    """Return values that are one number, or one for each node; raises InputError for others."""
    if values.ndim and values.shape != lattice.shape:
        raise InputError(
            "an array must have the lattice's shape",
            value=values.shape,
            limit=lattice.shape,
            key=key,
            remedy="one value a node; Lattice.axes has their coordinates",
        )
    return values


def widened(
    value: Any, lattice: Lattice, nodes: dict[tuple[int, int], int], mode: Literal["constant", "edge"] = "constant"
) -> Any:
    """Extend values on the nodes to a lattice with more nodes beyond its sides, by zeros or by the values at the edge;
    functions and numbers are returned as they are.
    """
    if isinstance(value, list | tuple):
        return [widened(part, lattice, nodes, mode) for part in value]
    if callable(value) or np.ndim(value) == 0:
        return value
    pads = [(nodes.get((a, -1), 0), nodes.get((a, 1), 0)) for a in range(lattice.dim)]
    return np.pad(np.asarray(value), [(0, 0)] * (np.ndim(value) - lattice.dim) + pads, mode=mode)

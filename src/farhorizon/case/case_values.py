"""Numbers, expressions and signals of a case file, as a set-up takes them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypeVar

from farhorizon import public as fh
from farhorizon.case.schema import BoxPart, Part, WeibullPart, signal_kinds, under
from farhorizon.errors import InputError
from farhorizon.inputs.expressions import as_given, as_signal

Made = TypeVar("Made")


class Values(NamedTuple):
    """Reads values of fields of a lattice: with a component for each dimension, or one."""

    dim: int
    vector: bool = False

    def expression(self, value: str | float | list[str | float], key: str, time: bool = True) -> Any:
        """A number or an expression of the coordinates, and of t where it may be one, of a vector a list of them."""
        if isinstance(value, list):
            if not self.vector or len(value) != self.dim:
                limit = f"a list of {self.dim}" if self.vector else "one"
                raise InputError("not as many entries as the field has components", value=value, limit=limit, key=key)
            return [self.entry(part, f"{key}[{i}]", time) for i, part in enumerate(value)]
        return self.entry(value, key, time)

    def entry(self, value: str | float, key: str, time: bool = True) -> Any:
        """A number, or an expression of the coordinates, and of t where it may be one."""
        return as_given(value, self.dim, key, time=time)

    def steady(self, value: str | float | WeibullPart, key: str) -> Any:
        """An expression of the coordinates alone, a number, or what scatters."""
        if isinstance(value, WeibullPart):
            return made(fh.Weibull, key, **value.model_dump(exclude={"type"}))
        return self.entry(value, key, time=False)

    def of_times(self, value: Any, key: str) -> Any:
        """Functions of t, one a component, and None where there is none."""
        if value is None or value is False:
            return None
        if isinstance(value, list):
            return [self.of_times(one, f"{key}[{i}]") for i, one in enumerate(value)]
        return of_time(value, key) if isinstance(value, Part) else self.entry(value, key)


def of_time(value: str | float | Part, key: str) -> Any:
    """A function of t alone."""
    return built(value, signal_kinds(), key) if isinstance(value, Part) else as_signal(value, key)


def built(part: Part, known: Mapping[str, Any], key: str, **changes: Any) -> Any:
    """What a table stands for that has a type and the fields of a dataclass, some of them changed."""
    given = dict(part)
    values = {name: given[name] for name in part.model_fields_set - {"type"}} | changes
    return made(known[given["type"]], key, **values)


def made(kind: Callable[..., Made], key: str, /, *given: Any, **named: Any) -> Made:
    """An object of a kind, whose complaints name the key of its table."""
    try:
        return kind(*given, **named)
    except InputError as error:
        raise error.at(under(key, error.key)) from None


def a_box(part: BoxPart | None) -> fh.Box | None:
    """A box that may be left out."""
    return None if part is None else fh.Box(part.lower, part.upper)

"""Numbers, expressions and signals of a case file, converted to arguments of a set-up."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypeVar

from farhorizon import public as fh
from farhorizon.case.schema import BoxPart, Part, WeibullPart, signal_kinds, under
from farhorizon.errors import InputError
from farhorizon.inputs.expressions import as_given, as_signal

Made = TypeVar("Made")


class Values(NamedTuple):
    """Reads values of fields on a lattice of `dim` dimensions, with one component per dimension if `vector`, otherwise
    one.
    """

    dim: int
    vector: bool = False

    def expression(self, value: str | float | list[str | float], key: str, time: bool = True) -> Any:
        """A number or an expression of the coordinates (and of t if `time`); for vectors, a list of them."""
        if isinstance(value, list):
            if not self.vector or len(value) != self.dim:
                limit = f"a list of {self.dim}" if self.vector else "one"
                raise InputError("not as many entries as the field has components", value=value, limit=limit, key=key)
            return [self.entry(part, f"{key}[{i}]", time) for i, part in enumerate(value)]
        return self.entry(value, key, time)

    def entry(self, value: str | float, key: str, time: bool = True) -> Any:
        """A number, or an expression of the coordinates (and of t if `time`)."""
        return as_given(value, self.dim, key, time=time)

    def steady(self, value: str | float | WeibullPart, key: str) -> Any:
        """A number, an expression of the coordinates alone, or a distribution that scatters."""
        if isinstance(value, WeibullPart):
            return made(fh.Weibull, key, **value.model_dump(exclude={"type"}))
        return self.entry(value, key, time=False)

    def of_times(self, value: Any, key: str) -> Any:
        """Functions of t, one per component; None for a component without one."""
        if value is None or value is False:
            return None
        if isinstance(value, list):
            return [self.of_times(one, f"{key}[{i}]") for i, one in enumerate(value)]
        return of_time(value, key) if isinstance(value, Part) else self.entry(value, key)


def of_time(value: str | float | Part, key: str) -> Any:
    """A function of t alone."""
    return built(value, signal_kinds(), key) if isinstance(value, Part) else as_signal(value, key)


def built(part: Part, known: Mapping[str, Any], key: str, **changes: Any) -> Any:
    """The object described by a table that has a type and the fields of a dataclass, with some fields changed."""
    given = dict(part)
    values = {name: given[name] for name in part.model_fields_set - {"type"}} | changes
    return made(known[given["type"]], key, **values)


def made(kind: Callable[..., Made], key: str, /, *given: Any, **named: Any) -> Made:
    """An object of a kind; its errors name the key of its table."""
    try:
        return kind(*given, **named)
    except InputError as error:
        raise error.at(under(key, error.key)) from None


def a_box(part: BoxPart | None) -> fh.Box | None:
    """A box, or None if omitted."""
    return None if part is None else fh.Box(part.lower, part.upper)

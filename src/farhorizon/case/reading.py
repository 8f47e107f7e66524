"""Tables of a case file as objects: the arguments that its keys give, and what is made of them."""

from __future__ import annotations

from typing import Any, NamedTuple

from farhorizon.arguments import Function
from farhorizon.case.schema import Argument, Option, Part, under
from farhorizon.errors import InputError
from farhorizon.geometry.shapes import Shape
from farhorizon.inputs.expressions import as_given, as_signal
from farhorizon.medium.of_field import names_field


class Reader(NamedTuple):
    """Reads tables for a lattice of `dim` dimensions and a field with one component per dimension if `vector`,
    otherwise one.
    """

    dim: int
    vector: bool = False

    def made(self, table: Part, key: str, **others: Any) -> Any:
        """The object that a table describes, given also by `others`; an InputError names the key."""
        if type(table).MAKER is Shape:
            return self.region(table, key)
        given: dict[str, Any] = {}
        names: dict[str, str] = {}  # keys by argument
        for argument_name, argument in table.ARGUMENTS.items():
            given |= argument.default
            used = None if argument_name in others else _used(table, argument, key)
            if used is not None:
                values = [self._value(getattr(table, name), used.function, f"{key}.{name}") for name in used.keys]
                given[argument_name] = values[0] if used.makes is None else used.makes(*values)
                names[argument_name] = used.keys[0]
        try:
            return type(table).MAKER(**given | others)
        except InputError as error:
            last = error.key.rpartition(".")[2]
            if last in names:
                raise error.at(f"{key}.{names[last]}") from None
            raise error.at(key if key.endswith(f".{last}") else under(key, error.key)) from None

    def region(self, table: Part, key: str) -> Shape:
        """The shape that the table of a region describes."""
        shapes = {name: nested for name, nested in table if name != "without" and nested is not None}
        if len(shapes) != 1:
            names = ", ".join(name for name in type(table).model_fields if name != "without")
            raise InputError(f"give exactly one of {names}", key=key)
        [(name, shape)] = shapes.items()
        region = self.made(shape, f"{key}.{name}")
        for hole in getattr(table, "without"):  # noqa: B009 (the class is made from the shapes that there are)
            region = region - self.region(hole, f"{key}.without")
        return region

    def _value(self, value: Any, function: Function | None, key: str) -> Any:
        """The value of a key."""
        if isinstance(value, Part):
            return self.made(value, key)
        if function is None and isinstance(value, list):
            return [self._value(entry, None, f"{key}[{i}]") for i, entry in enumerate(value)]
        if function is None or value is None:
            return value
        if not function.place:
            return self.of_times(value, key)
        if not function.time or (function.field and names_field(value)):
            return value  # which the class reads
        return self.expression(value, key) if function.components else self.entry(value, key)

    def expression(self, value: str | float | list[str | float], key: str, time: bool = True) -> Any:
        """A number or an expression of the coordinates (and of t if `time`); for vectors, a list of them."""
        if isinstance(value, list):
            if not self.vector or len(value) != self.dim:
                limit = f"a list of {self.dim}" if self.vector else "one"
                raise InputError("not as many entries as the field has components", value=value, limit=limit, key=key)
            return [self.entry(entry, f"{key}[{i}]", time) for i, entry in enumerate(value)]
        return self.entry(value, key, time)

    def entry(self, value: str | float, key: str, time: bool = True) -> Any:
        """A number, or an expression of the coordinates (and of t if `time`)."""
        return as_given(value, self.dim, key, time=time)

    def constant(self, value: Any, key: str) -> Any:
        """A constant of a material: a number, an expression of the coordinates, or a distribution that scatters."""
        return self.made(value, key) if isinstance(value, Part) else self.entry(value, key, time=False)

    def of_times(self, value: Any, key: str) -> Any:
        """A function of t, or one per component, None for one that is false."""
        if value is False:
            return None
        if isinstance(value, list):
            return [self.of_times(component, f"{key}[{i}]") for i, component in enumerate(value)]
        return self.made(value, key) if isinstance(value, Part) else as_signal(value, key)


def _used(table: Part, argument: Argument, key: str) -> Option | None:
    """The option by which a table gives an argument, None if it leaves the argument to its default; InputError for
    several options, or for none where one is needed.
    """
    given = [option for option in argument.options if table.model_fields_set & {*option.keys}]
    complete = [option for option in given if table.model_fields_set >= {*option.keys}]
    if (given == complete and len(given) == 1) or not (given or argument.needed):
        return given[0] if given else None
    names = [option.name for option in argument.options]
    several = ", ".join(key for option in given for key in option.keys if key in table.model_fields_set)
    raise InputError(
        f"give either {' or '.join(names)}" if len(names) == 2 else f"give exactly one of {', '.join(names)}",
        value=several or "none",
        limit="1",
        key=key,
        remedy="leave the others out" if len(given) > 1 else f"{(given or argument.options)[0].name} = ...",
    )

"""What arguments of public classes are beyond their Python type, stated in the annotations of the parameters.

The tables of case files, their units and their explanations are made from these annotations and from the docstrings, so
that a parameter is described once, where it is defined: ``horizon: Length`` is a key that takes "3 mm".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from numpy.typing import ArrayLike

from farhorizon import kinds

ANY, FIELD, RATE = "any", "that of u", "that of v"


@dataclass(frozen=True)
class Unit:
    """The SI unit of a number, or `ANY`, or `FIELD` or `RATE` for the unit of the field or of its velocity."""

    si: str


@dataclass(frozen=True)
class Toml:
    """The type that a case file takes in place of that of the parameter."""

    hint: Any


@dataclass(frozen=True)
class Function:
    """A number, or an expression of the coordinates (`place`), of t (`time`), or of both.

    With `components`, a list of these for a vector field; with `field`, also an expression of the field.
    """

    place: bool = True
    time: bool = True
    components: bool = False
    field: bool = False


@dataclass(frozen=True)
class OfRegions:
    """A constant of the medium, of which regions may have values of their own."""


@dataclass(frozen=True)
class InFile:
    """The default of a key in a case file where it differs from that of the parameter; `REQUIRED` for none."""

    default: Any


@dataclass(frozen=True)
class Makes:
    """A function that makes the value from its own arguments, which are the keys of a table."""

    function: Callable[..., Any]


class OneOf:
    """The keys of a case file that give the parameter, one of which is used, with their types; the fields of a named
    tuple are keys beside the others.
    """

    def __init__(self, **keys: Any) -> None:
        self.keys = keys


REQUIRED: Any = object()
PYTHON_ONLY = InFile(object())
"""The parameter is no key of a case file."""

Length = Annotated[float, Unit("m")]
Duration = Annotated[float, Unit("s")]
Frequency = Annotated[float, Unit("1/s")]
Speed = Annotated[float, Unit("m/s")]
Point = Annotated[ArrayLike, Toml(list[float]), Unit("m")]
Points = Annotated[ArrayLike, Toml(list[list[float]]), Unit("m")]
Frequencies = Annotated[Any, Toml(list[float]), Unit("1/s")]
OfTime = Annotated[Any, Function(place=False)]


class Registered:
    """Base of classes that a case file names: a subclass is listed in `known` of the nearest class that defines it.

    Attributes
    ----------
    tag : str
        Its name in a case file: ``ToneBurst`` is "tone-burst", unless the class has a tag of its own.
    known : dict of str to type
        All classes of a family by name, including user-defined ones.

    Raises
    ------
    TypeError
        When a class is defined with the name or the tag of a class of another module.
    """

    tag: ClassVar[str]
    known: ClassVar[dict[str, Any]]

    def __init_subclass__(cls, offered: bool = True, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "known" in vars(cls):  # the base of a family
            return
        if "tag" not in vars(cls):
            cls.tag = kinds.hyphened(cls.__name__)
        if offered:
            mine = (cls.__module__, cls.__name__)
            for other in cls.known.values():
                if {other.tag, other.__name__} & {cls.tag, cls.__name__} and (other.__module__, other.__name__) != mine:
                    raise TypeError(
                        f"there is a {other.tag!r} already, {other.__module__}.{other.__name__}: rename yours"
                    )
            cls.known[cls.__name__] = cls

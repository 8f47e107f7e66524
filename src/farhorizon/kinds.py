"""Converters for arguments: each returns a value the program can compute with, or raises InputError.

Every public argument passes through one of these before any work is done, so that errors name its key in the user's
terms rather than surface later in NumPy.
"""

from __future__ import annotations

import inspect
import numbers
import operator
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon.errors import InputError, nearest, shown

LARGEST = 1e60
"""Largest magnitude of a constant; nonzero ones are at least its inverse. Products of five such numbers, such as powers
of the horizon, stay finite.
"""
_FINITE, _GAPS = "no nan, no inf", "see where it comes from: a division by zero, or a gap in a file"
MOST_WHOLE = 1_000_000
"""Largest whole number, unless another limit applies."""


def number(
    value: Any,
    key: str,
    *,
    above: float | None = None,
    least: float | None = None,
    below: float | None = None,
    most: float | None = None,
    remedy: str = "",
    beyond: str = "",
) -> float:
    """A finite real number: an int, a float, a NumPy scalar or a zero-dimensional array, neither bool nor string. For
    anything else, and for a number out of range (`above` and `below` are exclusive), an InputError for the key.

    `remedy` says what to do instead of giving something that is not a number, such as an array, `beyond` what to do
    instead of giving a number that is out of range.
    """
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if not isinstance(value, numbers.Real) or isinstance(value, bool):
        raise InputError(
            "must be a number", value=said(value), limit=_range(above, least, below, most), key=key, remedy=remedy
        )
    try:
        converted = float(value)
    except OverflowError:
        converted = np.inf
    fits = (
        np.isfinite(converted)
        and (above is None or converted > above)
        and (least is None or converted >= least)
        and (below is None or converted < below)
        and (most is None or converted <= most)
    )
    if not fits:
        raise InputError(
            _demand(above, least, below, most),
            value=value,
            limit=_range(above, least, below, most) or _FINITE,
            key=key,
            remedy=_GAPS if np.isnan(converted) or not (np.isfinite(converted) or beyond) else beyond,
        )
    check_magnitude(converted, key)
    return converted


def check_magnitude(values: np.ndarray | float, key: str) -> None:
    """Raise InputError for numbers other than zero whose products would overflow or underflow."""
    given = np.asarray(values, float).ravel()
    size = np.abs(given)
    wrong = given[(size != 0) & ~((size >= 1 / LARGEST) & (size <= LARGEST))]
    if wrong.size:
        raise InputError(
            "is beyond what can be computed with",
            value=float(wrong[0]),
            limit=f"{1 / LARGEST:g} to {LARGEST:g} in magnitude",
            key=key,
            remedy="other units",
        )


def integer(value: Any, key: str, *, least: int, most: int = MOST_WHOLE) -> int:
    """A whole number between two limits, both included: what `operator.index` accepts (so not 3.0), except bool;
    InputError for anything else.
    """
    limit, remedy = f"{least} to {most}", "a whole number within these limits"
    try:
        if isinstance(value, bool):
            raise TypeError
        converted = operator.index(value)
    except TypeError:
        words = said(value)
        if isinstance(value, float | np.floating):
            words = str(float(value))  # shows 3.0, not 3
            if least <= value <= most and float(value).is_integer():
                remedy = f"write {value:.0f}"
        raise InputError("must be a whole number", value=words, limit=limit, key=key, remedy=remedy) from None
    if not least <= converted <= most:
        raise InputError("is out of range", value=converted, limit=limit, key=key, remedy=remedy)
    return converted


def flag(value: Any, key: str) -> bool:
    """True or false; InputError for anything else."""
    if not isinstance(value, bool | np.bool_):
        raise InputError("must be true or false", value=said(value), limit="a bool", key=key, remedy="one of both")
    return bool(value)


def text(value: Any, key: str) -> str:
    """A string; InputError for anything else."""
    if not isinstance(value, str):
        raise InputError("must be a text", value=said(value), limit="a text", key=key, remedy="put it into quotes")
    return value


def one_of(value: Any, key: str, known: Iterable[str], message: str = "unknown word") -> str:
    """One of some words; for anything else, InputError with `message`, all of the words and the most similar one."""
    words = list(known)
    if not isinstance(value, str) or value not in words:
        near = nearest(value, words) if isinstance(value, str) else []
        raise InputError(
            message,
            value=said(value),
            limit=", ".join(words),
            key=key,
            remedy=f"did you mean {near[0]!r}?" if near else "one of these",
        )
    return value


def number_type(value: Any) -> Any:
    """The name of a floating-point type, such as ``np.float32``; other values unchanged."""
    dtype = value.type if isinstance(value, np.dtype) else value
    return np.dtype(dtype).name if isinstance(dtype, type) and issubclass(dtype, float | np.float32) else value


def array(value: Any, key: str, *, shape: tuple[int | None, ...] | None = None, finite: bool = True) -> np.ndarray:
    """Real numbers, or bool, as an array of float64; `shape` is the required one, with None for any length.

    An InputError for entries that are not real numbers, masked entries, another shape, and, if `finite`, nan and inf.
    """
    if np.ma.is_masked(value):
        raise InputError(
            "entries are masked: they have no values",
            value=f"{np.ma.count_masked(value)} of {value.size}",
            limit="none",
            key=key,
            remedy="value.filled(0.0), or whatever they are to be",
        )
    try:
        converted = np.asarray(value)
    except (TypeError, ValueError):  # rows of different lengths
        converted = np.asarray(None)
    if converted.dtype.kind not in "biuf":
        raise InputError(
            "must be real numbers",
            value=said(value),
            limit="int, float or bool" if shape is None else f"shape {_shape(shape)}",
            key=key,
            remedy="a number, or rows of as many numbers each",
        )
    converted = converted.astype(float, copy=False)
    if shape is not None and not (
        converted.ndim == len(shape) and all(want in (None, n) for n, want in zip(converted.shape, shape, strict=True))
    ):
        raise InputError(
            "has another shape",
            value=f"shape {_shape(converted.shape)}",
            limit=f"shape {_shape(shape)}",
            key=key,
            remedy="as many entries along each axis as the limit says",
        )
    if finite and not np.isfinite(converted).all():
        raise InputError("values must be finite", value=said(value), limit=_FINITE, key=key, remedy=_GAPS)
    return converted


def mask(value: Any, key: str, message: str = "must be an array of true and false") -> np.ndarray:
    """An array of bool; InputError with `message` for anything else."""
    try:
        converted = np.asarray(value)
    except (TypeError, ValueError):
        converted = np.asarray(None)
    if converted.dtype != bool:
        raise InputError(message, value=said(value), limit="an array of bool", key=key, remedy="a comparison gives one")
    return converted


def sequence(value: Any, key: str, what: str = "entries") -> list[Any]:
    """A list or a tuple as a list; InputError for anything else, including strings and arrays."""
    if not isinstance(value, list | tuple):
        raise InputError(
            f"must be a list of {what}",
            value=said(value),
            limit="a list or a tuple",
            key=key,
            remedy="put it into a list: [...]",
        )
    return list(value)


def instance(value: Any, key: str, kinds: type | tuple[type, ...], what: str, remedy: str = "") -> Any:
    """An object of one of some classes; for anything else, InputError that it must be `what`."""
    if not isinstance(value, kinds):
        raise InputError(f"must be {what}", value=said(value), key=key, remedy=remedy)
    return value


def function(value: Any, key: str, arguments: str) -> Callable[..., Any]:
    """A callable that takes as many positional arguments as `arguments` names, e.g. "x, y, t"; InputError for anything
    else.
    """
    if not callable(value):
        raise InputError(
            f"must be a function of {arguments}",
            value=said(value),
            limit="what can be called",
            key=key,
            remedy=f"lambda {arguments}: ...",
        )
    names = arguments.split(", ")
    try:
        # signatures of ufuncs include an argument for the output
        if isinstance(value, np.ufunc) and value.nin != len(names):
            raise TypeError(f"it takes {value.nin}")
        inspect.signature(value).bind(*names)
    except TypeError as error:
        raise InputError(
            f"the function is called with {arguments}",
            value=f"{shown(value)}: {error}",
            key=key,
            remedy=f"a function of {len(names)} argument{'s' if len(names) > 1 else ''}",
        ) from None
    except ValueError:  # compiled functions may have no signature
        pass
    return value


def path(value: Any, key: str) -> Path:
    """The path of a file, given as a string or a Path; InputError for anything else."""
    if not isinstance(value, str | Path):
        raise InputError("must be a path", value=said(value), limit="a text or a Path", key=key, remedy='"name.h5"')
    converted = Path(value)
    if not converted.name:  # "", "." and "/"
        raise InputError("must name a file", value=said(value), key=key, remedy='"name.h5"')
    return converted


def set_fields(target: Any, /, **values: Any) -> None:
    """Set attributes of a frozen dataclass to the values returned by converters."""
    for name, value in values.items():
        object.__setattr__(target, name, value)


def hyphened(name: str) -> str:
    """The name of a class as used in case files: ``LatticePML`` becomes "lattice-pml"."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "-", name).lower()


def said(value: Any) -> str:
    """A value of the wrong kind as text, with its type where the value does not show it."""
    if value is None:
        return "None"
    if isinstance(value, str):
        return f"the text {value!r}"
    if isinstance(value, np.ndarray):
        return f"an array of shape {_shape(value.shape)}" + (
            "" if value.dtype.kind in "biuf" else f" and type {value.dtype}"
        )
    return shown(value)


def _shape(shape: Sequence[int | None]) -> str:
    inner = ", ".join("n" if n is None else str(n) for n in shape)
    return f"({inner},)" if len(shape) == 1 else f"({inner})"


def _range(above: float | None, least: float | None, below: float | None, most: float | None) -> str | None:
    if least is not None and most is not None:
        return f"{shown(least)} to {shown(most)}"
    limits = ((above, ">"), (least, ">="), (below, "<"), (most, "<="))
    return " and ".join(f"{sign} {shown(limit)}" for limit, sign in limits if limit is not None) or None


def _demand(above: float | None, least: float | None, below: float | None, most: float | None) -> str:
    if below is not None or most is not None:
        return "is out of range"
    words: dict[tuple[float | None, float | None], str] = {
        (None, None): "must be finite",
        (0, None): "must be finite and positive",
        (None, 0): "must be finite and not negative",
    }
    return words.get((above, least), "is out of range")

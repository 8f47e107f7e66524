"""Errors that name the value, the limit and a remedy."""

from __future__ import annotations

import difflib
import numbers
import re
from collections.abc import Iterable
from typing import Any, Self

import numpy as np

_LONGEST = 100  # characters of a value in a message
_ALIKE = 0.6  # ratio of words from which one may be the other misspelt: that of difflib itself
_FEW = 8  # entries of an array that are shown


class FarhorizonError(Exception):
    """Base class of all errors that farhorizon raises deliberately.

    Examples
    --------
    >>> import farhorizon as fh
    >>> try:
    ...     fh.Lattice(1.0, 5.0, -5.0)
    ... except fh.FarhorizonError as error:
    ...     print(type(error).__name__)
    InputError
    """

    agreed = told = False
    """Whether all processes of a run have raised it, and whether another one tells of it."""


class InputError(FarhorizonError, ValueError):
    """Input that cannot be computed, refused before any work is done.

    Parameters
    ----------
    message : str
        What is wrong, in one sentence.
    value, limit : object, optional
        The offending value and the limit that it violates.
    remedy : str, optional
        What to do instead.
    key : str, optional
        Where the value is given, e.g. ``"model.kernel.horizon"``.

    Examples
    --------
    >>> import farhorizon as fh
    >>> try:
    ...     fh.Kernel(horizon=-1.0)
    ... except fh.InputError as error:
    ...     print(error)
    kernel.horizon: must be finite and positive; value: -1; limit: > 0
    """

    def __init__(self, message: str, *, value: Any = None, limit: Any = None, remedy: str = "", key: str = "") -> None:
        self.message, self.value, self.limit, self.remedy, self.key = message, value, limit, remedy, key
        parts = [f"{key}: {message}" if key else message]
        if value is not None:
            parts.append(f"value: {_cut(shown(value))}")
        if limit is not None:
            parts.append(f"limit: {shown(limit)}")
        if remedy:
            parts.append(f"remedy: {remedy}")
        super().__init__("; ".join(parts))

    def at(self, key: str) -> Self:
        """The same error with another key, set by a caller that knows where the value is given."""
        return type(self)(self.message, value=self.value, limit=self.limit, remedy=self.remedy, key=key)


class FileFormatError(InputError):
    """A results file, checkpoint or case file that is truncated, foreign or damaged.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "results.h5")
    ...     _ = path.write_bytes(b"no HDF5")
    ...     try:
    ...         fh.open_results(path)
    ...     except fh.FileFormatError:
    ...         print("not a results file")
    not a results file
    """


class UnstableError(FarhorizonError, RuntimeError):
    """The run produced a non-finite or exploding value; the message gives the step, the location and the likely cause.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> sim = fh.Simulation(fh.Lattice(1.0, -9, 9), fh.Wave(fh.Kernel(1.0)), initial={"u": "exp(-x**2)"})
    >>> sim.engine.current[:] = np.nan  # as if it had grown beyond all bounds
    >>> try:
    ...     sim.step(100)
    ... except fh.UnstableError:
    ...     print("stopped")
    stopped
    """


class ValidityWarning(UserWarning):
    """The result of a run is doubtful from a certain time on; see `Run.cautions`.

    Examples
    --------
    >>> import farhorizon as fh
    >>> issubclass(fh.ValidityWarning, UserWarning)
    True
    """


def suggestion(word: str, words: Iterable[str]) -> str:
    """The most similar of some words, if one is similar enough, followed by all of them."""
    names = list(words)
    near = nearest(word, names)
    return (f"did you mean {near[0]!r}? " if near else "") + f"known: {', '.join(names)}"


def nearest(word: str, words: Iterable[str]) -> list[str]:
    """The most similar of some words in a list, which is empty if none is similar enough.

    Parts of a name that both have in common do not count, since it is by the others that they differ: "plane-wave" is
    no misspelt "rayleigh-wave", but "reyleigh-wave" is.

    Examples
    --------
    >>> nearest("plane-wave", ["rayleigh-wave"]), nearest("reyleigh-wave", ["rayleigh-wave"])
    ([], ['rayleigh-wave'])
    """
    return [match for match in difflib.get_close_matches(word, list(words), 3, _ALIKE) if _is_like(word, match)][:1]


def _is_like(word: str, known: str) -> bool:
    """Whether two names are similar, or one only lacks parts of the other, apart from the parts that both have."""
    first, second = (re.split("[-_. ]", name.lower()) for name in (word, known))
    left, right = (
        "-".join(part for part in parts if part not in others) for parts, others in ((first, second), (second, first))
    )
    return not left or not right or difflib.SequenceMatcher(None, left, right).ratio() >= _ALIKE


def shown(value: Any) -> str:
    """A value as a person would write it: numbers without rounding noise, large arrays by their shape, objects by their
    type.
    """
    if isinstance(value, np.ndarray | np.generic):
        if value.size > _FEW:
            return f"an array of shape {shown(value.shape)}"
        return shown(value.tolist())
    if isinstance(value, numbers.Real) and not isinstance(value, numbers.Integral):
        return f"{float(value):.10g}"
    if isinstance(value, list | tuple):
        inner = ", ".join(shown(part) for part in value[: 4 * _FEW])
        inner += ", ..." if len(value) > 4 * _FEW else "," if isinstance(value, tuple) and len(value) == 1 else ""
        return f"({inner})" if isinstance(value, tuple) else f"[{inner}]"
    if isinstance(value, type) or callable(value):
        name = getattr(value, "__qualname__", type(value).__name__)
        if isinstance(value, type):
            return name
        return f"the function {name}" if name != type(value).__name__ else _plain(value)
    return _plain(value)


def _plain(value: Any) -> str:
    """A value as text; objects without a representation of their own by their type, because an address helps nobody."""
    cls = type(value)
    return (
        f"an object of type {cls.__qualname__}"
        if cls.__repr__ is object.__repr__ and cls.__str__ is object.__str__
        else _long(value)
    )


def _long(value: Any) -> str:
    try:
        return str(value)
    except ValueError:  # Python does not print integers of more than 4300 digits
        return f"a whole number of {value.bit_length()} bits"


def _cut(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 4]} ..."

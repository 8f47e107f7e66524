"""Digests of what a run is given, equal on two processes if it is the same there: with the values in arrays, and those
that functions compute with.
"""

from __future__ import annotations

import functools
import hashlib
import sys
from collections.abc import Iterable, Mapping, Set
from pathlib import PurePath
from types import CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

from farhorizon.simulation.setup.serialization import arguments_of

_ATOMS = (type(None), bool, int, float, complex, str, bytes, PurePath)


def digest_of(value: Any) -> bytes:
    """Digest of a value: of objects by the arguments of their constructor or their attributes, of functions by their
    code and the values that it refers to, of the standard library and runs by their type alone.
    """
    return _Digests().of(value)


class _Digests:
    """Digests of values that may contain one another."""

    def __init__(self) -> None:
        self._known: dict[int, tuple[Any, bytes]] = {}  # by address; the value is kept, so that it stays at its address

    def of(self, value: Any) -> bytes:
        if isinstance(value, np.generic):
            value = value.item()
        if isinstance(value, _ATOMS):
            return _joined([repr(value).encode()])
        if id(value) not in self._known:
            self._known[id(value)] = value, b"contains itself"
            name = f"{type(value).__module__}.{type(value).__qualname__}".encode()
            self._known[id(value)] = value, _joined([name, *self._parts(value)])
        return self._known[id(value)][1]

    def _parts(self, value: Any) -> Iterable[bytes]:
        """Digests of the parts of a value."""
        try:
            if (given := arguments_of(value)) is not None:
                return self._items(given)
        except AttributeError:  # a class of a user that does not keep its arguments
            return self._items(_attributes(value))
        if isinstance(value, np.ndarray):
            if value.dtype.hasobject:
                return [self.of(value.shape), self.of(value.ravel().tolist())]
            return [self.of((value.shape, value.dtype.str)), hashlib.blake2b(np.ascontiguousarray(value).data).digest()]
        if isinstance(value, Mapping):
            return self._items(value)
        if isinstance(value, Set):
            return sorted(map(self.of, value))
        if isinstance(value, list | tuple):
            return map(self.of, value)
        if isinstance(value, CodeType):
            return map(self.of, (value.co_code, value.co_names, value.co_consts))
        if isinstance(value, FunctionType):
            return self._function(value)
        if isinstance(value, MethodType):
            return map(self.of, (value.__func__, value.__self__))
        if isinstance(value, functools.partial):
            return map(self.of, (value.func, value.args, value.keywords))
        for wrapped in ("py_func", "__wrapped__"):  # compiled, and cached functions
            if isinstance(inner := getattr(value, wrapped, None), FunctionType):
                return [self.of(inner)]
        if hasattr(type(value), "__array__"):
            return [self.of(np.asarray(value))]
        if hasattr(value, "__qualname__") or isinstance(value, ModuleType):
            return [self.of(getattr(value, "__qualname__", None) or value.__name__)]
        if type(value).__module__.partition(".")[0] in sys.stdlib_module_names or hasattr(value, "team"):
            return []
        return self._items(_attributes(value))

    def _items(self, values: Mapping[Any, Any]) -> list[bytes]:
        return sorted(_joined([self.of(key), self.of(value)]) for key, value in values.items())

    def _function(self, value: FunctionType) -> Iterable[bytes]:
        cells = []
        for cell in value.__closure__ or ():
            try:
                cells.append(cell.cell_contents)
            except ValueError:  # not assigned yet
                cells.append(None)
        read = {name: value.__globals__[name] for name in _names_in(value.__code__) if name in value.__globals__}
        used = {name: item for name, item in read.items() if _is_data(item) or _is_beside(item, value)}
        return map(self.of, (value.__code__, value.__defaults__, value.__kwdefaults__, cells, used))


def _joined(parts: Iterable[bytes]) -> bytes:
    joined = hashlib.blake2b(digest_size=16)
    for part in parts:
        joined.update(len(part).to_bytes(8, "little") + part)
    return joined.digest()


def _attributes(value: Any) -> dict[str, Any]:
    """Attributes of an object, without what it has computed on demand."""
    cls = type(value)
    slots = [name for base in cls.__mro__ for name in np.atleast_1d(base.__dict__.get("__slots__", ()))]
    held = {str(name): getattr(value, name) for name in slots if hasattr(value, name)} | getattr(value, "__dict__", {})
    return {
        name: item for name, item in held.items() if not isinstance(getattr(cls, name, None), functools.cached_property)
    }


def _names_in(code: CodeType) -> set[str]:
    """Names that a function and those defined in it may look up in their module."""
    inner = [constant for constant in code.co_consts if isinstance(constant, CodeType)]
    return set(code.co_names).union(*map(_names_in, inner))


def _is_data(value: Any) -> bool:
    """Whether a value consists of numbers, texts and arrays."""
    if isinstance(value, Mapping):
        return all(_is_data(item) for item in value.values())
    if isinstance(value, list | tuple | Set):
        return all(map(_is_data, value))
    return isinstance(value, (*_ATOMS, np.generic, np.ndarray))


def _is_beside(value: Any, function: FunctionType) -> bool:
    """Whether a value is another function of the same module."""
    return isinstance(value, FunctionType) and value.__globals__ is function.__globals__

"""Named tuples that stay in memory: a compiled function is given their address, and reads a field where it needs it.

Numba passes a named tuple field by field, and an array as seven numbers or more. For the loop's tables that is about a
thousand numbers in the call of each function that uses one, and LLVM spends most of its time on them.
"""

from __future__ import annotations

import hashlib
from functools import cache, lru_cache
from operator import is_
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import models, register_model, unbox

from farhorizon.engine.codegen.code_digest import digest
from farhorizon.engine.codegen.numba_internals import AttributeTemplate, arrayobj, infer_getattr, lower_getattr_generic

_WORD = 8  # bytes
_I64 = ir.IntType(64)


class Struct:
    """A named tuple of arrays, numbers and named tuples, as compiled functions read it; it does not change.

    What it has in common with `last`, a struct of the same class, need not be examined again, nor do the named tuples
    that are `known`: structs by the identities of their named tuples, to which this one and those in it are added.
    """

    def __init__(self, table: Any, last: Struct | None = None, known: dict[int, Struct] | None = None) -> None:
        self.table = table  # keeps its arrays alive
        known = {} if known is None else known
        self.parts: list[Struct | _Value]  # of each field; the words of an array are its address, shape and strides
        if last is None:
            self.parts = [known.get(id(value)) or _part(value, None, known) for value in table]
        else:
            before = zip(table, last.table, last.parts, strict=True)
            self.parts = [
                part if value is old else known.get(id(value)) or _part(value, part, known)
                for value, old, part in before
            ]
        kinds = tuple(part.type for part in self.parts)
        self.type: StructType
        if last is not None and all(map(is_, kinds, (part.type for part in last.parts))):
            self.type = last.type
        else:
            self.type = _struct_type(type(table).__name__, table._fields, kinds)
        self.words: list[int] = [word for part in self.parts for word in part.words]
        self._memory = np.array(self.words, np.int64)
        self.address = _address(self._memory)  # of the words
        known[id(table)] = self

    def known(self) -> dict[int, Struct]:
        """The structs in this one, by the identities of their named tuples."""
        structs: dict[int, Struct] = {}
        for part in self.parts:
            if isinstance(part, Struct):
                structs[id(part.table)] = part
                structs |= part.known()
        return structs

    def __reduce__(self) -> tuple[type[Struct], tuple[Any]]:
        return Struct, (self.table,)  # a copy has arrays of its own

    @property
    def _numba_type_(self) -> StructType:
        return self.type


@cache
def _layout() -> str:
    """What makes types differ where machine code reads them differently."""
    return digest(Path(__file__))


@lru_cache
def _array_type(dtype: np.dtype, axes: int, dense: bool, writeable: bool) -> types.Array:
    return types.Array(numba.from_dtype(dtype), axes, "C" if dense else "A", readonly=not writeable)


@cache
def _number_type(number: type) -> types.Type:
    return numba.typeof(number(0))


def _address(array: np.ndarray) -> int:
    return int(array.__array_interface__["data"][0])  # faster than `array.ctypes`


class _Value(NamedTuple):
    """An array or a number as a part of a struct."""

    type: types.Type
    words: tuple[int, ...]


def _part(value: Any, last: Any, known: dict[int, Struct]) -> Struct | _Value:
    if isinstance(value, tuple):
        return Struct(value, last, known)
    if isinstance(value, np.ndarray):
        flags = value.flags
        kind = _array_type(value.dtype, value.ndim, flags.c_contiguous, flags.writeable)
        return _Value(kind, (_address(value), *value.shape, *value.strides))
    if isinstance(value, (float, np.floating)):
        bits = np.zeros(1, np.int64)
        bits.view(type(value))[0] = value
        return _Value(_number_type(type(value)), (int(bits[0]),))  # type: ignore[arg-type]  # types are hashable
    return _Value(_number_type(type(value)), (int(value),))  # type: ignore[arg-type]


class StructType(types.Type):
    """Type of a `Struct`."""

    def __init__(self, name: str, fields: tuple[tuple[str, types.Type], ...]) -> None:
        self.fields: dict[str, tuple[int, types.Type]] = {}  # first word of each field, and its type
        self.size = 0
        for field, kind in fields:
            self.fields[field] = self.size, kind
            self.size += _length(kind)
        mark = ", ".join([_layout(), *(f"{field}: {kind}" for field, kind in fields)])
        super().__init__(f"Struct({name}, {hashlib.sha256(mark.encode()).hexdigest()[:20]})")


@cache
def _struct_type(name: str, fields: tuple[str, ...], kinds: tuple[types.Type, ...]) -> StructType:
    return StructType(name, tuple(zip(fields, kinds, strict=True)))


def _length(kind: types.Type) -> int:
    """Number of words of a field."""
    if isinstance(kind, StructType):
        return kind.size
    return 1 + 2 * kind.ndim if isinstance(kind, types.Array) else 1


@register_model(StructType)
class _Address(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: StructType) -> None:
        super().__init__(manager, kind, _I64)


@unbox(StructType)
def _unbox(kind: StructType, struct: Any, c: Any) -> Any:
    address = c.pyapi.object_getattr_string(struct, "address")
    native = c.unbox(types.int64, address)
    c.pyapi.decref(address)
    return native


@infer_getattr
class _Fields(AttributeTemplate):
    key = StructType

    def generic_resolve(self, kind: StructType, name: str) -> types.Type | None:  # type: ignore[override]
        return kind.fields[name][1] if name in kind.fields else None


@lower_getattr_generic(StructType)
def _field(context: Any, builder: ir.IRBuilder, kind: StructType, address: Any, name: str) -> Any:
    start, type_of_field = kind.fields[name]
    if isinstance(type_of_field, StructType):
        return builder.add(address, _I64(start * _WORD))

    def word(number: int) -> Any:
        place = builder.inttoptr(builder.add(address, _I64((start + number) * _WORD)), _I64.as_pointer())
        value = builder.load(place)
        value.set_metadata("invariant.load", builder.module.add_metadata([]))
        return value

    if isinstance(type_of_field, types.Array):
        array, axes = arrayobj.make_array(type_of_field)(context, builder), range(type_of_field.ndim)
        shape, strides = ([word(1 + axis + first) for axis in axes] for first in (0, type_of_field.ndim))
        data = builder.inttoptr(word(0), array.data.type)
        itemsize = context.get_abi_sizeof(context.get_data_type(type_of_field.dtype))
        arrayobj.populate_array(array, data, shape, strides, itemsize, None)
        return array._getvalue()
    if isinstance(type_of_field, types.Boolean):
        return builder.icmp_signed("!=", word(0), _I64(0))
    if isinstance(type_of_field, types.Float):
        width = type_of_field.bitwidth
        bits = builder.trunc(word(0), ir.IntType(width)) if width < 64 else word(0)
        return builder.bitcast(bits, context.get_value_type(type_of_field))
    return word(0)

"""Explicit SIMD: what the modules of this folder emit vector instructions with.

Numba's vectoriser loses most of the speed on loops of this kind, so the vector instructions are emitted here. Products
carry only the ``contract`` flag: a fixed order of summation makes results deterministic and needs few registers.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba import types

from farhorizon.engine.codegen.numba_internals import cgutils

CONTRACT = ("contract",)
I64 = ir.IntType(64)
I32 = ir.IntType(32)
LANES = {"float64": 8, "float32": 16}  # of vectors of 64 bytes


class Vectors:
    """Loads, stores and constants of one vector type, on byte addresses."""

    def __init__(self, builder: ir.IRBuilder, scalar: ir.Type, lanes: int) -> None:
        self.builder, self.scalar, self.lanes = builder, scalar, lanes
        self.size = 8 if isinstance(scalar, ir.DoubleType) else 4
        self.type = ir.VectorType(scalar, lanes)

    @classmethod
    def of(cls, builder: ir.IRBuilder, real: str) -> Vectors:
        """Vectors of 64 bytes."""
        return cls(builder, ir.DoubleType() if real == "float64" else ir.FloatType(), LANES[real])

    def splat(self, value: Any) -> Any:
        """Vector with the same value in every lane."""
        kind = ir.VectorType(value.type, self.lanes)
        first = self.builder.insert_element(ir.Constant(kind, ir.Undefined), value, I32(0))
        return self.builder.shuffle_vector(
            first, ir.Constant(kind, ir.Undefined), ir.Constant(ir.VectorType(I32, self.lanes), [0] * self.lanes)
        )

    def splat_all(self, address: Any, count: int) -> list[Any]:
        """Vectors of `count` values at an address, each with one of the values in every lane."""
        return [
            self.splat(self.builder.load(self.pointer(self.builder.add(address, I64(i * self.size)), self.scalar)))
            for i in range(count)
        ]

    def shifted(self, address: Any, *moves: tuple[int, Any]) -> Any:
        """An address moved by count * distance elements for each (count, distance)."""
        for count, distance in moves:
            address = self.builder.add(address, self.builder.mul(I64(count * self.size), distance))
        return address

    def concatenate(self, low: Any, high: Any, first: int) -> Any:
        """The lanes from `first` on of two vectors placed one after the other."""
        return self.builder.shuffle_vector(
            low, high, ir.Constant(ir.VectorType(I32, self.lanes), list(range(first, first + self.lanes)))
        )

    def prefetch(self, address: Any) -> None:
        """Prefetch the cache line of an address, which need not exist."""
        kind = ir.IntType(8).as_pointer()
        fetch = cgutils.get_or_insert_function(
            self.builder.module, ir.FunctionType(ir.VoidType(), [kind, I32, I32, I32]), "llvm.prefetch.p0i8"
        )
        self.builder.call(fetch, [self.pointer(address, ir.IntType(8)), I32(0), I32(3), I32(1)])

    def sum(self, terms: Sequence[Any]) -> Any:
        """Sum of the terms, added from left to right."""
        return functools.reduce(self.builder.fadd, terms)

    def pointer(self, address: Any, kind: ir.Type | None = None) -> Any:
        """Typed pointer from an address."""
        return self.builder.inttoptr(address, (kind or self.type).as_pointer())

    def load(self, address: Any) -> Any:
        """Load a vector from an address aligned to one element."""
        value = self.builder.load(self.pointer(address))
        value.align = self.size
        return value

    def store(self, value: Any, address: Any) -> None:
        """Store a vector at an address aligned to one element."""
        self.builder.store(value, self.pointer(address)).align = self.size

    def store_first(self, count: Any) -> Callable[[Any, Any], None]:
        """Function that stores only the first `count` lanes."""
        numbers = ir.VectorType(I64, self.lanes)
        mask = self.builder.icmp_signed("<", ir.Constant(numbers, list(range(self.lanes))), self.splat(count))
        parts = [self.type, self.type.as_pointer(), I32, ir.VectorType(ir.IntType(1), self.lanes)]
        suffix = f"v{self.lanes}f{self.size * 8}"
        masked = cgutils.get_or_insert_function(
            self.builder.module, ir.FunctionType(ir.VoidType(), parts), f"llvm.masked.store.{suffix}.p0{suffix}"
        )
        return lambda value, address: self.builder.call(masked, [value, self.pointer(address), I32(self.size), mask])

    def in_chunks(self, count: Any, chunk: Callable[..., None], *more: Vectors) -> None:
        """Call ``chunk(x, store)`` for every whole vector of `count` values and for the remainder; the stores of `more`
        types with as many lanes are passed as well.
        """
        rest, types_of_values = self.builder.srem(count, I64(self.lanes)), (self, *more)
        full = self.builder.sub(count, rest)
        with cgutils.for_range_slice(self.builder, I64(0), full, I64(self.lanes), I64) as (x, _):
            chunk(x, *(vectors.store for vectors in types_of_values))
        with self.builder.if_then(self.builder.icmp_signed(">", rest, I64(0))):
            chunk(full, *(vectors.store_first(rest) for vectors in types_of_values))

    def loop(
        self, first: Any, last: Any, step: int, start: Sequence[Any], body: Callable[[Any, list[Any]], list[Any]]
    ) -> tuple[Any, list[Any]]:
        """Repeat ``values = body(i, values)`` from `start` for i = first, first + step, ... while `step` numbers are
        left before `last`; return the next i and the values.
        """
        builder = self.builder
        before, test, inside, after = (
            builder.block,
            *(builder.append_basic_block(name) for name in ("test", "turn", "done")),
        )
        builder.branch(test)
        builder.position_at_end(test)
        i, *values = (builder.phi(value.type) for value in (first, *start))
        for phi, value in zip([i, *values], [first, *start], strict=True):
            phi.add_incoming(value, before)
        following = builder.add(i, I64(step))
        builder.cbranch(builder.icmp_signed("<=", following, last), inside, after)
        builder.position_at_end(inside)
        for phi, value in zip([i, *values], [following, *body(i, values)], strict=True):
            phi.add_incoming(value, builder.block)
        builder.branch(test)
        builder.position_at_end(after)
        return i, values

    def multiply_add(self, total: Any, factor: Any, term: Any) -> Any:
        """``total + factor * term``; only the product if there is no total."""
        product = self.builder.fmul(factor, term, flags=CONTRACT)
        return product if total is None else self.builder.fadd(total, product, flags=CONTRACT)


def int64s(count: int) -> Any:
    """Numba type of a tuple of `count` addresses or distances."""
    return types.UniTuple(types.int64, count)


def flat(builder: ir.IRBuilder, args: Sequence[Any]) -> tuple[Any, ...]:
    """Values one by one, where some come in tuples."""
    grouped = [cgutils.unpack_tuple(builder, arg) if isinstance(arg.type, ir.ArrayType) else [arg] for arg in args]
    return tuple(value for group in grouped for value in group)

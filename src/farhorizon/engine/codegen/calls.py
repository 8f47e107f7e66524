"""Calls of compiled functions by their addresses, which are passed as numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from farhorizon.engine.codegen.numba_internals import cgutils


def call_of(kinds: Sequence[Any]) -> tuple[Any, Callable[..., Any]]:
    """Signature and code of an intrinsic that calls a compiled function without a result, by its address, with the
    other arguments.
    """

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        kind = ir.FunctionType(ir.VoidType(), [arg.type for arg in args[1:]])
        builder.call(builder.inttoptr(args[0], kind.as_pointer()), args[1:])
        return context.get_dummy_value()

    return types.void(types.int64, *kinds), codegen


def _call_operation(typingctx, function, thread, stage, sums, tables, inputs, step, number):
    """Call an operation of `engine.program` with structs or their addresses."""
    return call_of((thread, stage, sums, tables, inputs, types.int64, types.int64))


call_operation: Any = intrinsic(_call_operation)  # compiled code leaves the first argument out


@intrinsic
def call_with(typingctx, function, stage, sums, numbers):
    """Call a function that takes a stage, sums (both structs) and some integers, given as a tuple."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        given = [*args[1:3], *cgutils.unpack_tuple(builder, args[3])]
        kind = ir.FunctionType(ir.VoidType(), [value.type for value in given])
        builder.call(builder.inttoptr(args[0], kind.as_pointer()), given)
        return context.get_dummy_value()

    return types.void(types.int64, stage, sums, types.UniTuple(types.int64, len(numbers))), codegen

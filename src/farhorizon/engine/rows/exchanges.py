"""What processes send each other: values of a field into messages, from one process to another, and out of them.

MPI is called from compiled code by its address, which is a number among others, so that Numba keeps the compiled code
on disk. What differs between MPI's implementations are the handles of communicators and types: numbers of four bytes
(MPICH) or pointers (Open MPI, the standard ABI of MPI 5).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from farhorizon.engine.rows.calls import call_of
from farhorizon.engine.rows.compiled import njit

_I32, _I64, _POINTER = ir.IntType(32), ir.IntType(64), ir.IntType(8).as_pointer()
_EXCHANGE = (types.int64,) * 4
EXCHANGE_SIGNATURE = types.void(*_EXCHANGE)

# Numbers of eight bytes, one after the other: a head, then a row for each message, then runs of neighbouring values,
# each its place from the first value of a component on and its length, in bytes.
HEAD = 8
FUNCTION, COMMUNICATOR, TYPE, WIDE, OWN, MESSAGES, OUTGOING, INCOMING = range(HEAD)
ROW = 8
TO, FROM, SENT, SENT_END, FILLED, FILLED_END, BYTES, TAG = range(ROW)
_STATUS = 64  # bytes, more than any implementation takes


@intrinsic
def call_exchange(typingctx, function, table, array, components, apart):
    """Call a compiled `exchange` by its address."""
    return call_of(_EXCHANGE)


@intrinsic
def _number(typingctx, table, place):
    """A number of a table."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        at = builder.add(args[0], builder.mul(args[1], _I64(8)))
        return builder.load(builder.inttoptr(at, _I64.as_pointer()))

    return types.int64(types.int64, types.int64), codegen


@intrinsic
def _move(typingctx, to, source, count):
    """Copy bytes."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        to, source = (builder.inttoptr(one, _POINTER) for one in args[:2])
        cgutils.raw_memcpy(builder, to, source, args[2], 1)
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), codegen


def _send_and_receive(wide: bool) -> Callable[..., Any]:
    """MPI_Sendrecv by its address, with handles that are pointers or numbers of four bytes."""

    @intrinsic
    def call(typingctx, function, outgoing, incoming, count, to, source, tag, kind, communicator):
        def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
            function, outgoing, incoming, count, to, source, tag, kind, communicator = args
            handle = _POINTER if wide else _I32
            sends = [_POINTER, _I32, handle, _I32, _I32]
            form = ir.FunctionType(_I32, [*sends, *sends, handle, _POINTER])
            status = cgutils.alloca_once(builder, ir.ArrayType(ir.IntType(8), _STATUS))
            outgoing, incoming = (builder.inttoptr(one, _POINTER) for one in (outgoing, incoming))
            count, to, source, tag = (builder.trunc(one, _I32) for one in (count, to, source, tag))
            kind, communicator = (
                builder.inttoptr(one, _POINTER) if wide else builder.trunc(one, _I32) for one in (kind, communicator)
            )
            given = [outgoing, count, kind, to, tag, incoming, count, kind, source, tag, communicator]
            builder.call(builder.inttoptr(function, form.as_pointer()), [*given, builder.bitcast(status, _POINTER)])
            return context.get_dummy_value()

        return types.void(*[types.int64] * 9), codegen

    return call


_send_by_pointer, _send_by_number = _send_and_receive(True), _send_and_receive(False)


@njit(error_model="numpy", counted=False, entry=False)
def exchange_halos(table, array, components, apart):
    """Work off the messages of a table, one after the other: later ones send what earlier ones have filled.

    Parameters
    ----------
    table, array : int
        Addresses of a table and of the first value of the field's first component.
    components, apart : int
        Of the field, and the bytes from one to the next.
    """
    outgoing, incoming, own = _number(table, OUTGOING), _number(table, INCOMING), _number(table, OWN)
    for number in range(_number(table, MESSAGES)):
        row = HEAD + number * ROW
        to, source = _number(table, row + TO), _number(table, row + FROM)
        at = outgoing
        if to >= 0:
            for c in range(components):
                for run in range(_number(table, row + SENT), _number(table, row + SENT_END), 2):
                    length = _number(table, run + 1)
                    _move(at, array + c * apart + _number(table, run), length)
                    at += length
        at = outgoing
        if to != own or source != own:
            at = incoming
            given = (
                outgoing,
                incoming,
                components * _number(table, row + BYTES),
                to,
                source,
                _number(table, row + TAG),
            )
            handles = _number(table, TYPE), _number(table, COMMUNICATOR)
            if _number(table, WIDE) != 0:
                _send_by_pointer(_number(table, FUNCTION), *given, *handles)
            else:
                _send_by_number(_number(table, FUNCTION), *given, *handles)
        if source >= 0:
            for c in range(components):
                for run in range(_number(table, row + FILLED), _number(table, row + FILLED_END), 2):
                    length = _number(table, run + 1)
                    _move(array + c * apart + _number(table, run), at, length)
                    at += length

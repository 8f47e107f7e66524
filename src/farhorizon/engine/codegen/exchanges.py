"""What processes send each other: values of a field are packed into messages, sent, and unpacked.

MPI is called from compiled code by its address, passed as a number, so that Numba keeps the compiled code on disk. What
differs between implementations of MPI is the handles of communicators and types: numbers of four bytes (MPICH) or
pointers (Open MPI, the standard ABI of MPI 5).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from farhorizon.engine.codegen.calls import call_of
from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.codegen.numba_internals import cgutils

_I32, _I64, _POINTER = ir.IntType(32), ir.IntType(64), ir.IntType(8).as_pointer()
_EXCHANGE = (types.int64,) * 4
EXCHANGE_SIGNATURE = types.void(*_EXCHANGE)

# Numbers of eight bytes: a head, then a row for each message, then runs of neighbouring values, each given by its
# distance from the first value of a component and its length, in bytes.
HEAD = 12
ISEND, IRECV, WAITALL, TESTALL, COMMUNICATOR, TYPE, WIDE, OWN, MESSAGES, REQUESTS, STATUSES, UNDER_WAY = range(HEAD)
ROW = 10
TO, FROM, SENT, SENT_END, FILLED, FILLED_END, BYTES, TAG, OUTGOING, INCOMING = range(ROW)
REQUEST, STATUS = 8, 64  # bytes, as many as any implementation needs

#: Of the messages of one kind along an axis: addresses of the functions that begin them, end them and let them
#: progress, address of their table, and whether there are any.
SENDS, RECEIVES, MOVES, TABLE, USED = range(5)
NO_MESSAGES = np.zeros((3, 5), np.int64)  # along none of the axes


@intrinsic
def call_exchange(typingctx, function, table, array, components, apart):
    """Call a compiled function of an exchange by its address."""
    return call_of(_EXCHANGE)


@intrinsic
def _number(typingctx, table, place):
    """Read a number from a table."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        return builder.load(_place(builder, *args))

    return types.int64(types.int64, types.int64), codegen


@intrinsic
def _note(typingctx, table, place, value):
    """Write a number into a table."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        builder.store(args[2], _place(builder, *args[:2]))
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), codegen


def _place(builder: ir.IRBuilder, table: Any, place: Any) -> Any:
    return builder.inttoptr(builder.add(table, builder.mul(place, _I64(8))), _I64.as_pointer())


@intrinsic
def _move(typingctx, to, source, count):
    """Copy bytes."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        to, source = (builder.inttoptr(address, _POINTER) for address in args[:2])
        cgutils.raw_memcpy(builder, to, source, args[2], 1)
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), codegen


def _begin(wide: bool) -> Callable[..., Any]:
    """Intrinsic for MPI_Isend or MPI_Irecv by its address, with handles that are pointers or numbers of four bytes."""

    @intrinsic
    def call(typingctx, function, buffer, count, kind, partner, tag, communicator, request):
        def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
            function, buffer, count, kind, partner, tag, communicator, request = args
            handle = _POINTER if wide else _I32
            form = ir.FunctionType(_I32, [_POINTER, _I32, handle, _I32, _I32, handle, _POINTER])
            count, partner, tag = (builder.trunc(number, _I32) for number in (count, partner, tag))
            buffer, request = (builder.inttoptr(address, _POINTER) for address in (buffer, request))
            kind, communicator = (
                builder.inttoptr(handle, _POINTER) if wide else builder.trunc(handle, _I32)
                for handle in (kind, communicator)
            )
            message = buffer, count, kind, partner, tag, communicator, request
            builder.call(builder.inttoptr(function, form.as_pointer()), message)
            return context.get_dummy_value()

        return types.void(*[types.int64] * 8), codegen

    return call


_begin_by_pointer, _begin_by_number = _begin(True), _begin(False)


@intrinsic
def _wait(typingctx, function, count, requests, statuses):
    """Call MPI_Waitall by its address."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        function, count, *places = args
        form = ir.FunctionType(_I32, [_I32, _POINTER, _POINTER])
        given = [builder.trunc(count, _I32), *(builder.inttoptr(place, _POINTER) for place in places)]
        builder.call(builder.inttoptr(function, form.as_pointer()), given)
        return context.get_dummy_value()

    return types.void(*[types.int64] * 4), codegen


@intrinsic
def _test(typingctx, function, count, requests, statuses):
    """Call MPI_Testall by its address; its result is not used."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        function, count, requests, statuses = args
        form = ir.FunctionType(_I32, [_I32, _POINTER, _I32.as_pointer(), _POINTER])
        flag = cgutils.alloca_once(builder, _I32)
        requests, statuses = (builder.inttoptr(place, _POINTER) for place in (requests, statuses))
        builder.call(
            builder.inttoptr(function, form.as_pointer()), [builder.trunc(count, _I32), requests, flag, statuses]
        )
        return context.get_dummy_value()

    return types.void(*[types.int64] * 4), codegen


@njit(error_model="numpy", counted=False, entry=False)
def begin_message(table, function, row, buffer, components, partner, count):
    """Begin to send or receive the message of a row, as request `count`; return the number of the next one."""
    wide = _number(table, WIDE)
    request = _number(table, REQUESTS) + count * (8 if wide != 0 else 4)
    length, tag = components * _number(table, row + BYTES), _number(table, row + TAG)
    kind, communicator = _number(table, TYPE), _number(table, COMMUNICATOR)
    if wide != 0:
        _begin_by_pointer(function, buffer, length, kind, partner, tag, communicator, request)
    else:
        _begin_by_number(function, buffer, length, kind, partner, tag, communicator, request)
    return count + 1


@njit(error_model="numpy", counted=False, entry=False)
def send_values(table, array, components, apart):
    """Begin the messages of a table: values are packed and sent, and receptions are posted. The messages of a table do
    not wait for each other. `table` and `array` are addresses, the latter of the first value of the field's first
    component; its `components` lie `apart` bytes apart.
    """
    own, messages, count = _number(table, OWN), _number(table, MESSAGES), 0
    for number in range(messages):
        row = HEAD + number * ROW
        source = _number(table, row + FROM)
        if source >= 0 and source != own:
            function, buffer = _number(table, IRECV), _number(table, row + INCOMING)
            count = begin_message(table, function, row, buffer, components, source, count)
    for number in range(messages):
        row = HEAD + number * ROW
        to, at = _number(table, row + TO), _number(table, row + OUTGOING)
        if to < 0:
            continue
        for c in range(components):
            for run in range(_number(table, row + SENT), _number(table, row + SENT_END), 2):
                length = _number(table, run + 1)
                _move(at, array + c * apart + _number(table, run), length)
                at += length
        if to != own:
            function, buffer = _number(table, ISEND), _number(table, row + OUTGOING)
            count = begin_message(table, function, row, buffer, components, to, count)
    _note(table, UNDER_WAY, count)


@njit(error_model="numpy", counted=False, entry=False)
def receive_values(table, array, components, apart):
    """End the messages that `send_values` has begun, and put what has arrived in its places in the field."""
    own, count = _number(table, OWN), _number(table, UNDER_WAY)
    if count > 0:
        _wait(_number(table, WAITALL), count, _number(table, REQUESTS), _number(table, STATUSES))
        _note(table, UNDER_WAY, 0)
    for number in range(_number(table, MESSAGES)):
        row = HEAD + number * ROW
        source = _number(table, row + FROM)
        if source < 0:
            continue
        at = _number(table, row + (OUTGOING if source == own else INCOMING))
        for c in range(components):
            for run in range(_number(table, row + FILLED), _number(table, row + FILLED_END), 2):
                length = _number(table, run + 1)
                _move(array + c * apart + _number(table, run), at, length)
                at += length


@njit(error_model="numpy", counted=False, entry=False)
def move_messages(table, array, components, apart):
    """Let MPI progress messages that are under way: most implementations do so only while they are called."""
    count = _number(table, UNDER_WAY)
    if count > 0:
        _test(_number(table, TESTALL), count, _number(table, REQUESTS), _number(table, STATUSES))

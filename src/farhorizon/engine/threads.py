"""Threads that run through the time loop side by side, and barriers at which they meet.

A step has several parts, and starting threads for each of them would take longer than the part itself. Threads are
therefore started once for many steps and wait for each other at barriers, spinning for a short while before they sleep.
"""

from __future__ import annotations

import os
import platform
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.codegen.numba_internals import cgutils
from farhorizon.engine.codegen.structs import Struct
from farhorizon.machine import uninterrupted

_LINE = 16  # elements between shared words, so that each has its own cache lines
_ARRIVED, _ROUND, _CLAIMED = range(0, 3 * _LINE, _LINE)  # the last is for thread 0; those of others follow

# some ten microseconds; then the thread sleeps, which on a busy machine lets the others proceed sooner than yielding
_SPINS = 2000
_I64 = ir.IntType(64)

_sleep = (
    types.ExternalFunction("Sleep", types.void(types.int32))
    if os.name == "nt"
    else types.ExternalFunction("usleep", types.int32(types.int32))
)


class Thread(NamedTuple):
    """Thread that runs through the loop: its number, the number of threads, and the words that they share."""

    number: int
    threads: int
    shared: np.ndarray


#: The only thread of a serial run.
ALONE = Struct(Thread(0, 1, np.zeros(1, np.int64)))


@intrinsic
def add(typingctx, address, value):
    """Add to a word atomically, and return its previous value."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        return builder.atomic_rmw("add", builder.inttoptr(args[0], _I64.as_pointer()), args[1], "seq_cst")

    return types.int64(types.int64, types.int64), codegen


@intrinsic
def _read(typingctx, address):
    """Read a word as other threads left it."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        if platform.machine() in ("x86_64", "AMD64"):
            pause = cgutils.get_or_insert_function(
                builder.module, ir.FunctionType(ir.VoidType(), []), "llvm.x86.sse2.pause"
            )
            builder.call(pause, [])
        return builder.load_atomic(builder.inttoptr(args[0], _I64.as_pointer()), "acquire", 8)

    return types.int64(types.int64), codegen


@njit(cache=True, entry=False)
def barrier(thread):
    """Wait until all threads have arrived, and reset all claims."""
    if thread.threads == 1:
        return
    word = np.int64(thread.shared.ctypes.data)
    now = _read(word + 8 * _ROUND)
    if add(word + 8 * _ARRIVED, 1) == thread.threads - 1:
        add(word + 8 * _ARRIVED, -thread.threads)
        thread.shared[_CLAIMED:] = 0
        add(word + 8 * _ROUND, 1)
        return
    spins = 0
    while _read(word + 8 * _ROUND) == now:
        spins += 1
        if spins > _SPINS:
            _sleep(1)


@njit(cache=True, entry=False)
def claim(thread, owner):
    """Return the number of the next piece of a thread's chunk that no thread has claimed since the last barrier."""
    return add(np.int64(thread.shared.ctypes.data) + 8 * (_CLAIMED + owner * _LINE), 1)


@njit(cache=True, entry=False)
def chunk_of(thread, count):
    """Return first and last + 1 of a thread's pieces, out of `count`."""
    return thread.number * count // thread.threads, (thread.number + 1) * count // thread.threads


@njit(error_model="numpy", cache=True, counted=False)
def run_start(nodes, i):
    """First place from i on at which the entries of another node begin."""
    while 0 < i < nodes.size and nodes[i] == nodes[i - 1]:
        i += 1
    return i


def side_by_side(work: Callable[[Struct], None], count: int) -> None:
    """Call `work`, which must release the interpreter's lock, with each `Thread` at the same time. An interrupt waits
    until all have ended: threads would wait forever for one that is missing.
    """
    if count == 1:
        work(ALONE)
        return
    shared = np.zeros(_CLAIMED + count * _LINE, np.int64)
    threads = [Struct(Thread(number, count, shared)) for number in range(count)]
    started = [threading.Thread(target=work, args=(thread,), daemon=True) for thread in threads[1:]]
    with uninterrupted():
        for thread in started:
            thread.start()
        work(threads[0])
        for thread in started:
            thread.join()

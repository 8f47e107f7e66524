"""Explicit SIMD for what nodes make of their states: a matrix, the same for a run of nodes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from farhorizon.engine.rows.calls import call_of
from farhorizon.engine.rows.vectors import Vectors

_LAW = (types.int64,) * 4
LAW_SIGNATURE = types.void(*_LAW)


def linear_law(entries: tuple[tuple[int, ...], ...], real: str) -> Any:
    """Make the intrinsic ``law(place, apart, matrix, nodes)``: the states of so many nodes are multiplied by a matrix,
    of whose rows these are the columns that may differ from zero, at least one of each.

    It takes the byte addresses of the first number of the first node and of the matrix, the distance in bytes from one
    number of a state to the next, and the nodes.
    """

    @intrinsic
    def law(typingctx, place, apart, matrix, nodes):
        def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
            place, apart, matrix, nodes = args
            vectors, count = Vectors.of(builder, real), len(entries)
            numbers = [builder.add(place, builder.mul(ir.Constant(apart.type, c), apart)) for c in range(count)]

            def chunk(x: Any, store: Callable[[Any, Any], None]) -> None:
                at = builder.mul(x, ir.Constant(x.type, vectors.size))
                state = [vectors.load(builder.add(number, at)) for number in numbers]
                for row, columns in enumerate(entries):
                    total = None
                    for column in columns:
                        weight = builder.add(matrix, ir.Constant(matrix.type, (row * count + column) * vectors.size))
                        total = vectors.multiply_add(total, vectors.splat_all(weight, 1)[0], state[column])
                    store(total, builder.add(numbers[row], at))

            vectors.in_chunks(nodes, chunk)
            return context.get_dummy_value()

        return LAW_SIGNATURE, codegen

    return law


@intrinsic
def call_law(typingctx, function, place, apart, matrix, nodes):
    """Call a compiled `linear_law` by its address."""
    return call_of(_LAW)

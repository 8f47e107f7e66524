"""Explicit SIMD for products of matrices, one for all or one for each, with the values of neighbouring nodes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from farhorizon.engine.rows.calls import call_of
from farhorizon.engine.rows.vectors import I64, Vectors

_MAP = (*(types.int64,) * 7, types.float64)
MAP_SIGNATURE = types.void(*_MAP)


def linear_map(entries: tuple[tuple[int, ...], ...], columns: int, each: bool, added: bool, real: str) -> Any:
    """Make the intrinsic ``map(src, read, out, written, matrix, step, nodes, factor)``: ``out = matrix src`` at a
    number of nodes, or if `added` ``out += factor matrix src``; it works in place, too.

    The matrix has `columns` columns; `entries` are, for each of its rows, those that may differ from zero, at least
    one. If `each` node has its own matrix, one entry of all matrices lies side by side, and up to one vector is read
    beyond the last.

    The intrinsic takes the byte addresses of the first numbers, the distances in bytes from one number of a node to the
    next, the byte address of the matrix, the distance in bytes between its entries, and the number of nodes.
    """

    @intrinsic
    def product(typingctx, src, read, out, written, matrix, step, nodes, factor):
        def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
            src, read, out, written, matrix, step, nodes, factor = args
            vectors = Vectors.of(builder, real)
            numbers, results = (
                [builder.add(first, builder.mul(I64(i), apart)) for i in range(count)]
                for first, apart, count in ((src, read, columns), (out, written, len(entries)))
            )
            scale = vectors.splat(factor if real == "float64" else builder.fptrunc(factor, ir.FloatType()))

            def entry(number: int, at: Any) -> Any:
                place = builder.add(matrix, builder.mul(I64(number), step))
                return vectors.load(builder.add(place, at)) if each else vectors.splat_all(place, 1)[0]

            def chunk(x: Any, store: Callable[[Any, Any], None]) -> None:
                at = builder.mul(x, I64(vectors.size))
                values = [vectors.load(builder.add(number, at)) for number in numbers]
                for row, chosen in enumerate(entries):
                    total, place = None, builder.add(results[row], at)
                    for column in chosen:
                        total = vectors.multiply_add(total, entry(row * columns + column, at), values[column])
                    store(vectors.multiply_add(vectors.load(place), scale, total) if added else total, place)

            vectors.in_chunks(nodes, chunk)
            return context.get_dummy_value()

        return MAP_SIGNATURE, codegen

    return product


@intrinsic
def call_map(typingctx, function, src, read, out, written, matrix, step, nodes, factor):
    """Call a compiled `linear_map` by its address."""
    return call_of(_MAP)

"""Explicit SIMD for stencils: one Numba intrinsic that sweeps a group of grid rows.

Numba's vectoriser loses most of the speed on stencils of this size, so the vector instructions are
emitted here. One *row group* (``R0 x R1`` neighbouring rows of the contiguous axis) is swept in vectors:
each input row is loaded once and serves every output row of the group, and the pair sums
``u[x-i] + u[x+i]`` are shared by them. Products carry the ``contract`` flag only: a fixed order of
summation keeps results deterministic and the registers few.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

#: (outer offset 0, outer offset 1, inner offset >= 0); every inner offset stands for both signs.
Shape = tuple[tuple[int, int, int], ...]

_CONTRACT = ("contract",)


def row_group_sweep(shape: Shape, rows: tuple[int, int], real: str, increments: bool) -> Any:
    """Make the intrinsic ``sweep(src, base, out, weights, a, b, n, s0, s1)`` for one row group.

    Writes ``out = a*src + b*base + sum_k w_k (src_{+k} + src_{-k})`` on ``n`` nodes of each row of the group.
    With ``increments`` the sum runs over differences and advances ``base`` in place:
    ``base = b*base + sum_k w_k (src_{+k} + src_{-k} - 2 src)`` and ``out = src + base``.

    Parameters
    ----------
    shape : tuple of (int, int, int)
        Stencil offsets without the centre, inner offset >= 0 (an inner offset i > 0 stands for +i and -i).
    rows : (int, int)
        Rows in the group along the two outer axes.
    real : {"float64", "float32"}
    increments : bool

    Returns
    -------
    numba intrinsic
        Takes byte addresses (int64) of the group's first node in each array and of the weights (in the
        order of ``shape``), the numbers a and b, the row length and the two outer strides in elements.
        Reads up to one vector beyond the end of a row, writes none.
    """
    scalar: ir.Type = ir.DoubleType() if real == "float64" else ir.FloatType()
    lanes, size = (8, 8) if real == "float64" else (16, 4)
    vector = ir.VectorType(scalar, lanes)
    i64 = ir.IntType(64)
    group = [(g0, g1) for g0 in range(rows[0]) for g1 in range(rows[1])]

    # Which (weight number, inner offset) each input row contributes to each output row.
    uses: dict[tuple[int, int], list[tuple[int, int, int]]] = {}
    for out_row, (g0, g1) in enumerate(group):
        for number, (o0, o1, i) in enumerate(shape):
            uses.setdefault((g0 + o0, g1 + o1), []).append((i, out_row, number))

    def emit(builder: ir.IRBuilder, args: tuple[Any, ...]) -> None:
        src, base, out, weights, a, b, n, s0, s1 = args
        const = lambda value: ir.Constant(i64, value)  # noqa: E731

        def splat(value: Any) -> Any:
            first = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
            return builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes))

        def row_address(start: Any, o0: int, o1: int) -> Any:
            shift = builder.add(builder.mul(const(o0 * size), s0), builder.mul(const(o1 * size), s1))
            return builder.add(start, shift)

        def pointer(address: Any, x: Any, shift: int, kind: ir.Type) -> Any:
            at = builder.add(address, builder.mul(builder.add(x, const(shift)), const(size)))
            return builder.inttoptr(at, kind.as_pointer())

        def load(address: Any, x: Any, shift: int = 0) -> Any:
            value = builder.load(pointer(address, x, shift, vector))
            value.align = size
            return value

        w = []
        for number in range(len(shape)):
            at = builder.inttoptr(builder.add(weights, const(number * size)), scalar.as_pointer())
            w.append(splat(builder.load(at)))
        a_vec, b_vec = splat(a), splat(b)
        in_rows = {row: row_address(src, *row) for row in set(uses) | set(group)}
        base_rows = [row_address(base, *row) for row in group]
        out_rows = [row_address(out, *row) for row in group]

        def chunk(x: Any, store: Any) -> None:
            centre = {row: load(in_rows[row], x) for row in group}
            acc: list[Any] = [None] * len(group)
            for row in sorted(in_rows):
                pairs: dict[int, Any] = {}
                for i, out_row, number in uses.get(row, ()):
                    if increments:  # differences against the output row's own node: no sharing, no cancellation
                        own = centre[group[out_row]]
                        term = builder.fsub(load(in_rows[row], x, i), own)
                        if i:
                            term = builder.fadd(term, builder.fsub(load(in_rows[row], x, -i), own))
                    else:
                        if i not in pairs:
                            here = centre[row] if i == 0 and row in centre else load(in_rows[row], x, i)
                            pairs[i] = builder.fadd(here, load(in_rows[row], x, -i)) if i else here
                        term = pairs[i]
                    product = builder.fmul(w[number], term, flags=_CONTRACT)
                    acc[out_row] = product if acc[out_row] is None else builder.fadd(acc[out_row], product, flags=_CONTRACT)
            for out_row, row in enumerate(group):
                old = builder.fmul(b_vec, load(base_rows[out_row], x), flags=_CONTRACT)
                total = builder.fadd(acc[out_row], old, flags=_CONTRACT)
                if increments:
                    store(total, pointer(base_rows[out_row], x, 0, vector))
                    total = builder.fadd(centre[row], total)
                else:
                    total = builder.fadd(total, builder.fmul(a_vec, centre[row], flags=_CONTRACT), flags=_CONTRACT)
                store(total, pointer(out_rows[out_row], x, 0, vector))

        def store_all(value: Any, at: Any) -> None:
            builder.store(value, at).align = size

        whole = builder.sub(n, builder.srem(n, const(lanes)))
        with cgutils.for_range_slice(builder, const(0), whole, const(lanes), i64) as (x, _):
            chunk(x, store_all)

        rest = builder.srem(n, const(lanes))
        with builder.if_then(builder.icmp_signed(">", rest, const(0))):
            lane_type = ir.VectorType(ir.IntType(64), lanes)
            undefined = ir.Constant(lane_type, ir.Undefined)
            first = builder.insert_element(undefined, rest, ir.Constant(ir.IntType(32), 0))
            count = builder.shuffle_vector(first, undefined, ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes))
            mask = builder.icmp_signed("<", ir.Constant(lane_type, list(range(lanes))), count)
            signature = ir.FunctionType(ir.VoidType(), [vector, vector.as_pointer(), ir.IntType(32), ir.VectorType(ir.IntType(1), lanes)])
            suffix = f"v{lanes}f{size * 8}"
            masked = cgutils.get_or_insert_function(builder.module, signature, f"llvm.masked.store.{suffix}.p0{suffix}")

            def store_masked(value: Any, at: Any) -> None:
                builder.call(masked, [value, at, ir.Constant(ir.IntType(32), size), mask])

            chunk(whole, store_masked)

    number_type = getattr(types, real)

    @intrinsic
    def sweep(typingctx, src, base, out, weights, a, b, n, s0, s1):  # type: ignore[no-untyped-def]
        integers = (types.int64,) * 4
        signature = types.void(*integers, number_type, number_type, types.int64, types.int64, types.int64)

        def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
            emit(builder, args)
            return context.get_dummy_value()

        return signature, codegen

    return sweep

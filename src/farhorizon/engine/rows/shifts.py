"""Explicit SIMD: stretched shifts, and their memory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from farhorizon.engine.rows.calls import call_of
from farhorizon.engine.rows.vectors import CONTRACT, I32, I64, Vectors, flat, int64s


class Remembered:
    """Numbers that layers remember.

    The half of a double is its first 32 bits, which have its whole range and six digits. The remainder is not truncated
    but rounded up or down as if by chance: a number between two halves becomes the upper one in a share of the steps
    that equals its relative position between them. If it were rounded to nearest, it would not register changes below
    its last digit, and under a permanent load the layers would stop following the field.

    Parameters
    ----------
    vectors : Vectors
    kept : str
        "int32" for halves, else the type of the field.
    dithered : ir.Value
        What is added to the second half before it is dropped.
    """

    def __init__(self, vectors: Vectors, kept: str, dithered: ir.Value) -> None:
        self.vectors, self.half = vectors, kept == "int32"
        self.long, self.short = (ir.VectorType(one, vectors.lanes) for one in (I64, I32))
        if self.half:
            self.places = ir.Constant(self.long, [32] * vectors.lanes)
            self.raised = vectors.splat(dithered)

    def bytes(self, at: ir.Value) -> ir.Value:
        """Distance in the memory, in bytes, that corresponds to a distance in numbers of the field."""
        return self.vectors.builder.lshr(at, I64(1)) if self.half else at

    def load(self, address: ir.Value) -> ir.Value:
        """Load a vector in the field's precision."""
        builder, vectors = self.vectors.builder, self.vectors
        if not self.half:
            return vectors.load(address)
        found = builder.load(vectors.pointer(address, self.short))
        found.align = 4
        return builder.bitcast(builder.shl(builder.zext(found, self.long), self.places), vectors.type)

    def store(self, value: ir.Value, address: ir.Value) -> None:
        """Store a vector."""
        builder, vectors = self.vectors.builder, self.vectors
        if not self.half:
            vectors.store(value, address)
            return
        bits = builder.lshr(builder.add(builder.bitcast(value, self.long), self.raised), self.places)
        builder.store(builder.trunc(bits, self.short), vectors.pointer(address, self.short)).align = 4


def stretched_shifts(reach: int, nested: bool, outwards: bool, real: str, kept: str) -> Any:
    """Make the intrinsic that applies stretched shifts in one direction along lines that are processed side by side;
    see `engine.nested`.

    ``shifts(parts, found, memory, edges, columns, vectors)`` takes, for `parts` and for `found`, the byte address of
    column 0 and the distances between columns and between k; the address of the memory (one cell per application; for
    shifts outwards from the outer end on), the bytes of a cell (0 if there is none; e and f are zero then), and the
    number by which halves are rounded in this step, see `Remembered`; and the addresses of the tables r, e and f of the
    edges.

    Outwards, results are stored, from column 1 - reach on; inwards they are added, from column 1 on. Nested shifts take
    a part for each column and k, and yield one sum per column; others take one value per column, and yield one for each
    k.
    """
    steps = list(range(reach))
    order = steps[::-1] if nested else steps  # of the applications
    ahead = 1 if nested else -1  # the one before k is k + ahead

    def emit(builder: ir.IRBuilder, args: tuple[Any, ...]) -> None:
        parts, part_step, part_k, found, found_step, found_k, memory, cell, dithered, r, e, f, columns, number = args
        vectors = Vectors.of(builder, real)
        width = vectors.lanes * vectors.size
        remembered = Remembered(vectors, kept, dithered)
        zero = ir.Constant(vectors.type, [0.0] * vectors.lanes)

        def shifted(address: Any, *moves: tuple[Any, Any]) -> Any:
            for count, distance in moves:
                address = builder.add(
                    address, builder.mul(count if isinstance(count, ir.Value) else I64(count), distance)
                )
            return address

        def apply(at: Any, column: Any, carried: list[Any], edge: Any, cells: Any) -> tuple[list[Any], list[Any]]:
            """Apply the shifts on one column; return what is carried on to the next (v, q and the sums of c for each
            k), and the sums. Without an edge the shifts are plain.
            """
            v, q, t = carried[:reach], carried[reach : 2 * reach], carried[2 * reach :]
            v_new, q_new, t_new = list(v), list(q), list(t)
            if edge is not None:
                r_all, e_all, f_all = (
                    vectors.splat(builder.load(vectors.pointer(builder.add(table, edge), vectors.scalar)))
                    for table in (r, e, f)
                )
            here = builder.add(shifted(parts, (column, part_step)), at)
            for turn, k in enumerate(order):
                before = v_new[k + ahead] if turn else None
                new = vectors.load(shifted(here, (k if nested else 0, part_k))) if nested or not turn else None
                new = before if new is None else new if before is None else builder.fadd(new, before)
                q_new[k], v_new[k] = new, q[k]
                if edge is not None:
                    place = shifted(cells, (turn, cell))
                    d, past = builder.fsub(new, v[k]), remembered.load(place)
                    c = builder.fsub(builder.fmul(r_all, d, flags=CONTRACT), past, flags=CONTRACT)
                    grown = vectors.multiply_add(builder.fmul(e_all, past, flags=CONTRACT), f_all, d)
                    remembered.store(grown, place)
                    v_new[k] = builder.fadd(q[k], c)
                    t_new[k] = builder.fadd(t[k + ahead], c) if turn else c
            return [*v_new, *q_new, *t_new], [t_new[0]] if nested else t_new

        def stretched(at: Any, turn: Any, carried: list[Any]) -> list[Any]:
            column = builder.sub(columns, turn) if outwards else builder.add(turn, I64(1))
            edge = builder.mul(column if outwards else turn, I64(vectors.size))
            cells = builder.add(shifted(memory, (builder.mul(turn, I64(reach)), cell)), remembered.bytes(at))
            carried, sums = apply(at, column, carried, edge, cells)
            to = builder.add(shifted(found, (column, found_step)), at)
            for k, value in enumerate(sums):
                place = shifted(to, (k, found_k))
                vectors.store(value if outwards else builder.fadd(vectors.load(place), value), place)
            return carried

        def side_by_side(at: Any, many: int) -> None:
            """Process all columns of some vectors; two at a time wait less for each other's additions."""
            places, size = [builder.add(at, I64(i * width)) for i in range(many)], 3 * reach

            def each(body: Callable[[Any, list[Any]], list[Any]]) -> Callable[[list[Any]], list[Any]]:
                return lambda c: [
                    v for i, place in enumerate(places) for v in body(place, c[i * size : (i + 1) * size])
                ]

            carried = [zero] * (size * many)
            if not outwards:
                carried = vectors.loop(
                    I64(0),
                    I64(reach + 1),
                    1,
                    carried,
                    lambda turn, c: each(
                        lambda place, c: apply(place, builder.sub(turn, I64(reach)), c, None, None)[0]
                    )(c),
                )[1]
            count = builder.add(columns, I64(1)) if outwards else columns
            carried = vectors.loop(
                I64(0), count, 1, carried, lambda turn, c: each(lambda place, c: stretched(place, turn, c))(c)
            )[1]
            for i, place in enumerate(places if outwards else ()):
                sums = carried[i * size + 2 * reach : (i + 1) * size]
                for near in range(1, reach):
                    to = builder.add(shifted(found, (-near, found_step)), place)
                    for k in range(1 if nested else reach):
                        source = k + near * ahead
                        vectors.store(sums[source] if 0 <= source < reach else zero, shifted(to, (k, found_k)))

        many, done = 2 if reach < 5 else 1, I64(0)
        while many:
            end = builder.mul(builder.sdiv(number, I64(many)), I64(many * width))
            with cgutils.for_range_slice(builder, done, end, I64(many * width), I64) as (at, _):
                side_by_side(at, many)
            done, many = end, many // 2

    @intrinsic
    def shifts(typingctx, parts, found, memory, edges, columns, vectors):
        def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
            emit(builder, flat(builder, args))
            return context.get_dummy_value()

        return SHIFTS_SIGNATURE, codegen

    return shifts


_SHIFTS = int64s(3), int64s(3), int64s(3), int64s(3), types.int64, types.int64
SHIFTS_SIGNATURE = types.void(*_SHIFTS)


@intrinsic
def call_shifts(typingctx, function, parts, found, memory, edges, columns, vectors):
    """Call compiled `stretched_shifts` by their address."""
    return call_of(_SHIFTS)

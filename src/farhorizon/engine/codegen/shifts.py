"""Explicit SIMD: stretched shifts, their memory, and the sums of lines that they are applied to."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from farhorizon.engine.codegen.calls import call_of
from farhorizon.engine.codegen.numba_internals import cgutils
from farhorizon.engine.codegen.vectors import CONTRACT, I32, I64, Vectors, flat, int64s


class Remembered:
    """Numbers that layers remember: in the type of the field or, if `kept` is "int32", the first halves of doubles.

    Such a half has the whole range of a double and six digits. The remainder is not truncated but rounded up or down as
    if by chance, by adding `dithered` to it: a number between two halves becomes the upper one in a fraction of the
    steps that equals its relative position between them. If it were rounded to nearest, it would not register changes
    below its last digit, and under a permanent load the layers would stop following the field.
    """

    def __init__(self, vectors: Vectors, kept: str, dithered: ir.Value) -> None:
        self.vectors, self.half = vectors, kept == "int32"
        self.long, self.short = (ir.VectorType(integer, vectors.lanes) for integer in (I64, I32))
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
        bits = builder.load(vectors.pointer(address, self.short))
        bits.align = 4
        return builder.bitcast(builder.shl(builder.zext(bits, self.long), self.places), vectors.type)

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
    see `engine.layers`.

    ``shifts(parts, results, memory, edges, columns, vectors)`` takes, for `parts` and for `results`, the byte address
    of column 0 and the distances between columns and between k; the address of the memory (one cell per application;
    for shifts outwards from the outer end on), the bytes of a cell (0 if there is none; e and f are zero then), and the
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
        parts, part_step, part_k, results, result_step, result_k, memory, cell, dithered, r, e, f, columns, number = (
            args
        )
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
            to = builder.add(shifted(results, (column, result_step)), at)
            for k, value in enumerate(sums):
                place = shifted(to, (k, result_k))
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
                    to = builder.add(shifted(results, (-near, result_step)), place)
                    for k in range(1 if nested else reach):
                        source = k + near * ahead
                        vectors.store(sums[source] if 0 <= source < reach else zero, shifted(to, (k, result_k)))

        many, done = (
            2 if reach < 5 else 1,
            I64(0),
        )  # so many that the 3 * reach vectors carried by each stay in registers
        while many:
            end = builder.mul(builder.sdiv(number, I64(many)), I64(many * width))
            with cgutils.for_range_slice(builder, done, end, I64(many * width), I64) as (at, _):
                side_by_side(at, many)
            done, many = end, many // 2

    return _intrinsic(emit, SHIFTS_SIGNATURE)


def _intrinsic(emit: Callable[[ir.IRBuilder, tuple[Any, ...]], None], numba_signature: Any) -> Any:
    """The intrinsic of a signature with six arguments whose code is given by `emit`."""

    @intrinsic
    def emitted(typingctx, first, second, third, fourth, fifth, sixth):
        def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
            emit(builder, flat(builder, args))
            return context.get_dummy_value()

        return numba_signature, codegen

    return emitted


_SHIFTS = int64s(3), int64s(3), int64s(3), int64s(3), types.int64, types.int64
SHIFTS_SIGNATURE = types.void(*_SHIFTS)


@intrinsic
def call_shifts(typingctx, function, parts, results, memory, edges, columns, vectors):
    """Call compiled `stretched_shifts` by their address."""
    return call_of(_SHIFTS)


_IN_FLIGHT = 6  # partial sums of a vector, so that none waits for its own last addition


def weighted_parts(parts: int, varied: bool, real: str) -> Any:
    """Make the intrinsic that sums lines with weights, into several sums at a time, for nodes processed side by side.

    ``sums(to, source, tables, vectors, least, more)`` takes byte addresses: of the first sum, with the distance between
    sums; of the first node and of the first factors; and of tables. The terms come in groups: those of all sums, of all
    but the last, and so on. ``ends`` (int64) holds the groups' first and last numbers, ``places`` (int64) the distances
    in bytes from the node to the terms' values, ``factors`` (int64) those from the first factors to the terms' own,
    which are read if the bonds have coefficients (`varied`), ``weights`` a row of weights per term, ``weight_step``
    bytes apart. Groups of fewer than `least` sums are left out; if `more` is not 0 the sums are added to.
    """

    def emit(builder: ir.IRBuilder, args: tuple[Any, ...]) -> None:
        to, to_step, source, first_factor, ends, places, factors, weights, weight_step, number, least, more = args
        vectors = Vectors.of(builder, real)
        width = vectors.lanes * vectors.size
        zero = ir.Constant(vectors.type, [0.0] * vectors.lanes)
        fresh = builder.icmp_signed("==", more, I64(0))
        limits = [builder.load(vectors.pointer(builder.add(ends, I64(8 * i)), I64)) for i in range(parts + 1)]

        def place(k: int, at: Any, part: int) -> Any:
            return builder.add(builder.add(to, builder.mul(I64(k), to_step)), builder.add(at, I64(part * width)))

        def values_at(start: Any, table: Any, term: Any, at: Any, many: int) -> list[Any]:
            apart = builder.load(vectors.pointer(builder.add(table, builder.mul(term, I64(8))), I64))
            here = builder.add(builder.add(start, apart), at)
            return [vectors.load(builder.add(here, I64(part * width))) for part in range(many)]

        def grown(term: Any, at: Any, used: int, many: int, totals: list[Any]) -> list[Any]:
            w = vectors.splat_all(builder.add(weights, builder.mul(term, weight_step)), used)
            values = values_at(source, places, term, at, many)
            if varied:
                factor = values_at(first_factor, factors, term, at, many)
                values = [builder.fmul(f, value) for f, value in zip(factor, values, strict=True)]
            return [vectors.multiply_add(total, w[i // many], values[i % many]) for i, total in enumerate(totals)]

        def block(at: Any, many: int) -> None:
            totals = [
                builder.select(fresh, zero, vectors.load(place(k, at, part)))
                for k in range(parts)
                for part in range(many)
            ]
            for group in range(parts):
                used = parts - group
                last = builder.select(builder.icmp_signed("<=", least, I64(used)), limits[group + 1], limits[group])
                # as many for one vector as for several, so that rounding does not depend on where a tile ends
                of_group, turns = totals[: used * many], max(1, _IN_FLIGHT // used)
                term = limits[group]
                if turns > 1:

                    def several(term: Any, sums: list[Any], used: int = used, turns: int = turns) -> list[Any]:
                        size = used * many
                        return [
                            v
                            for t in range(turns)
                            for v in grown(builder.add(term, I64(t)), at, used, many, sums[t * size : (t + 1) * size])
                        ]

                    start = [*of_group, *[zero] * ((turns - 1) * len(of_group))]
                    term, sums = vectors.loop(term, last, turns, start, several)
                    of_group = [vectors.sum(sums[i :: used * many]) for i in range(used * many)]

                def single(term: Any, sums: list[Any], used: int = used) -> list[Any]:
                    return grown(term, at, used, many, sums)

                _, of_group = vectors.loop(term, last, 1, of_group, single)
                totals[: used * many] = of_group
            for i, total in enumerate(totals):
                vectors.store(total, place(i // many, at, i % many))

        many, done = 4 if parts <= 5 else 2, I64(0)  # so many that all sums stay in registers
        while many:
            end = builder.mul(builder.sdiv(number, I64(many)), I64(many * width))
            with cgutils.for_range_slice(builder, done, end, I64(many * width), I64) as (at, _):
                block(at, many)
            done, many = end, many // 2

    return _intrinsic(emit, PARTS_SIGNATURE)


_PARTS = int64s(2), int64s(2), int64s(5), types.int64, types.int64, types.int64
PARTS_SIGNATURE = types.void(*_PARTS)


@intrinsic
def call_parts(typingctx, function, to, source, tables, vectors, least, more):
    """Call compiled `weighted_parts` by their address."""
    return call_of(_PARTS)

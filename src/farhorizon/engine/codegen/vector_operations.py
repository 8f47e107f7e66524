"""Explicit SIMD: operations on neighbouring values in memory, and on blocks of rows of them."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from farhorizon.engine.codegen.numba_internals import cgutils
from farhorizon.engine.codegen.vectors import I32, I64, Vectors, flat, int64s

#: Values in a window, and sums that are computed side by side.
WINDOW, BUNDLE = 8, 4


@intrinsic
def window_sums(typingctx, sums, count, places, values, first, second, third, fourth):
    """Compute four sums over as many windows of `values` with weights, side by side: one alone would wait for its own
    additions.

    Takes the number of windows and byte addresses: of the results, of ``places[k, sum]``, the distance in bytes
    (uint32) of a window from `values`, and of the weights (float64) of each sum, `WINDOW` per window.
    """

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        sums, count, places, values, *weights = args
        vectors = Vectors(builder, ir.DoubleType(), WINDOW)
        totals = [cgutils.alloca_once(builder, vectors.type) for _ in weights]
        for total in totals:
            builder.store(ir.Constant(vectors.type, [0.0] * WINDOW), total)
        with cgutils.for_range(builder, count) as loop:
            here = builder.add(places, builder.mul(loop.index, I64(4 * BUNDLE)))
            for number, (total, weight) in enumerate(zip(totals, weights, strict=True)):
                place = builder.load(vectors.pointer(builder.add(here, I64(4 * number)), I32))
                value = vectors.load(builder.add(values, builder.zext(place, I64)))
                factor = vectors.load(vectors.shifted(weight, (WINDOW, loop.index)))
                builder.store(vectors.multiply_add(builder.load(total), factor, value), total)

        def added(low: Any, high: Any, *places: Sequence[int]) -> Any:
            """Sum of two selections from the lanes of two vectors placed one after the other."""
            return builder.fadd(
                *(builder.shuffle_vector(low, high, ir.Constant(ir.VectorType(I32, len(p)), list(p))) for p in places)
            )

        pairs = [
            added(
                builder.load(totals[i]),
                builder.load(totals[i + 1]),
                (0, 8, 2, 10, 4, 12, 6, 14),
                (1, 9, 3, 11, 5, 13, 7, 15),
            )
            for i in (0, 2)
        ]
        halves = added(*pairs, (0, 1, 8, 9, 4, 5, 12, 13), (2, 3, 10, 11, 6, 7, 14, 15))
        Vectors(builder, ir.DoubleType(), BUNDLE).store(added(halves, halves, (0, 1, 2, 3), (4, 5, 6, 7)), sums)
        return context.get_dummy_value()

    return types.void(*[types.int64] * 8), codegen


@intrinsic
def block_sum(typingctx, source, across, rows, apart, along, count, like):
    """``sum_i across_i sum_j along_j source[i * apart + j]`` over the rows of a block of values, of the type of `like`.

    Takes byte addresses of the first values, and the numbers of rows and of values in a row, the latter a whole number
    of vectors of 64 bytes: weights beyond the block are zero.
    """

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        source, across, rows, apart, along, count, _ = args
        vectors = Vectors.of(builder, str(signature.args[6]))
        nothing = ir.Constant(vectors.type, [0.0] * vectors.lanes)
        total, *columns = (cgutils.alloca_once(builder, vectors.type) for _ in range(3))
        builder.store(nothing, total)
        step, pair = builder.mul(apart, I64(vectors.size)), I64(2 * vectors.lanes)

        def add_columns(x: Any, number: int) -> None:
            """Add columns of vectors side by side: one alone would wait for its own additions."""
            places = [builder.mul(builder.add(x, I64(i * vectors.lanes)), I64(vectors.size)) for i in range(number)]
            for column in columns[:number]:
                builder.store(nothing, column)
            with cgutils.for_range(builder, rows) as loop:
                weight = builder.load(vectors.pointer(vectors.shifted(across, (1, loop.index)), vectors.scalar))
                factor, line = vectors.splat(weight), builder.add(source, builder.mul(loop.index, step))
                for column, at in zip(columns, places, strict=False):
                    value = vectors.load(builder.add(line, at))
                    builder.store(vectors.multiply_add(builder.load(column), factor, value), column)
            for column, at in zip(columns, places, strict=False):
                factor = vectors.load(builder.add(along, at))
                builder.store(vectors.multiply_add(builder.load(total), factor, builder.load(column)), total)

        rest = builder.srem(count, pair)
        paired = builder.sub(count, rest)
        with cgutils.for_range_slice(builder, I64(0), paired, pair, I64) as (x, _):
            add_columns(x, 2)
        with builder.if_then(builder.icmp_signed(">", rest, I64(0))):
            add_columns(paired, 1)
        folded, half = builder.load(total), vectors.lanes // 2
        while half:
            places = [[(lane + shift) % vectors.lanes for lane in range(vectors.lanes)] for shift in (0, half)]
            numbers = ir.VectorType(I32, vectors.lanes)
            parts = [builder.shuffle_vector(folded, folded, ir.Constant(numbers, place)) for place in places]
            folded, half = builder.fadd(*parts), half // 2
        return builder.extract_element(folded, I32(0))

    return like(*[types.int64] * 6, like), codegen


@intrinsic
def copy_values(typingctx, source, to, count, like):
    """Copy `count` neighbouring values of the type of `like` to numbers of 8 bytes, by byte addresses. Up to a vector
    beyond the values is read, too.
    """

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        source, to, count, like = args
        numbers = Vectors(builder, ir.DoubleType(), 8)
        values = Vectors(builder, like.type, numbers.lanes)

        def chunk(x: Any, store: Callable[[Any, Any], None]) -> None:
            value = values.load(values.shifted(source, (1, x)))
            wide = value if values.size == numbers.size else builder.fpext(value, numbers.type)
            store(wide, numbers.shifted(to, (1, x)))

        numbers.in_chunks(count, chunk)
        return context.get_dummy_value()

    return types.void(*[types.int64] * 3, like), codegen


@intrinsic
def move_up(typingctx, address, count):
    """Move `count` neighbouring numbers of 8 bytes, from a byte address on, up by one place."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        address, count = args
        low, high = (builder.inttoptr(builder.add(address, I64(shift)), I64.as_pointer()) for shift in (0, 8))
        cgutils.raw_memmove(builder, high, low, count, 8)
        return context.get_dummy_value()

    return types.void(types.int64, types.int64), codegen


@intrinsic
def clear(typingctx, address, count, like):
    """Set `count` neighbouring values of the type of `like` to zero, from a byte address on; meant for a few dozen."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        address, count, _ = args
        vectors = Vectors.of(builder, str(signature.args[2]))
        zero = ir.Constant(vectors.type, [0.0] * vectors.lanes)
        with cgutils.for_range_slice(builder, I64(0), count, I64(vectors.lanes), I64) as (x, _):
            vectors.store_first(builder.sub(count, x))(zero, vectors.shifted(address, (1, x)))
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, like), codegen


@intrinsic
def any_below(typingctx, coefficient, values, limit, n, count, step):
    """Whether any node with a coefficient of at most 0 may have a value below `limit`, on `count` rows of `n` nodes
    that lie `step` elements apart.

    Takes byte addresses of the first node, and examines whole vectors: up to 7 nodes beyond the end of a row count,
    too.
    """

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        coefficient, values, limit, n, count, step = args
        vectors = Vectors(builder, limit.type, 8)
        limits, zero = vectors.splat(limit), ir.Constant(vectors.type, [0.0] * vectors.lanes)
        none = ir.Constant(ir.VectorType(ir.IntType(1), vectors.lanes), [0] * vectors.lanes)
        lower = cgutils.alloca_once_value(builder, none)
        with (
            cgutils.for_range(builder, count) as rows,
            cgutils.for_range_slice(builder, I64(0), n, I64(vectors.lanes), I64) as (x, _),
        ):
            phase, value = (
                vectors.load(vectors.shifted(start, (1, x), (1, builder.mul(rows.index, step))))
                for start in (coefficient, values)
            )
            low = builder.and_(builder.fcmp_ordered("<=", phase, zero), builder.fcmp_ordered("<", value, limits))
            builder.store(builder.or_(builder.load(lower), low), lower)
        mask = builder.bitcast(builder.load(lower), ir.IntType(vectors.lanes))
        return builder.icmp_unsigned("!=", mask, ir.Constant(mask.type, 0))

    return types.boolean(types.int64, types.int64, limit, *[types.int64] * 3), codegen


#: Lines and columns that `turn` transposes at a time.
TURNED = 8


@intrinsic
def turn(typingctx, source, step, last, to, to_step, to_last, like):
    """Transpose a square of values: value j of line i of `source` becomes value i of line j of `to`.

    Takes byte addresses and distances of lines of `TURNED` values each, of the type of `like`; lines after `last`, or
    `to_last`, do not exist.
    """

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        source, step, last, to, to_step, to_last, like = args
        vectors = Vectors(builder, like.type, TURNED)

        def place(start: Any, line: int, distance: Any, end: Any) -> Any:
            number = builder.select(builder.icmp_signed("<", end, I64(line)), end, I64(line))
            return builder.add(start, builder.mul(number, distance))

        lines, half = [vectors.load(place(source, i, step, last)) for i in range(TURNED)], TURNED // 2
        low, high = ([i + TURNED * j for i in range(first, first + half) for j in (0, 1)] for first in (0, half))
        for _ in range(3):  # each round sorts by one more bit of the line's number
            pairs = [(lines[i], lines[i + half]) for i in range(half)]
            lines = [
                builder.shuffle_vector(*pair, ir.Constant(ir.VectorType(I32, TURNED), picked))
                for pair in pairs
                for picked in (low, high)
            ]
        for i in reversed(range(TURNED)):  # a line that does not exist is overwritten by the last one
            vectors.store(lines[i], place(to, i, to_step, to_last))
        return context.get_dummy_value()

    return types.void(*[types.int64] * 6, like), codegen


@intrinsic
def add_lines(typingctx, source, to, scale, count):
    """``to += scale * source`` on `count` neighbouring values, by byte addresses."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        source, to, scale, count = args
        vectors = Vectors.of(builder, str(signature.args[2]))
        factor = vectors.splat(scale)

        def chunk(x: Any, store: Callable[[Any, Callable[[Any, Any], None]], None]) -> None:
            at = builder.mul(x, I64(vectors.size))
            target = builder.add(to, at)
            store(vectors.multiply_add(vectors.load(target), factor, vectors.load(builder.add(source, at))), target)

        vectors.in_chunks(count, chunk)
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, scale, types.int64), codegen


@intrinsic
def fetch(typingctx, address):
    """Prefetch the cache line of an address, which need not exist."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        Vectors.of(builder, "float64").prefetch(args[0])
        return context.get_dummy_value()

    return types.void(types.int64), codegen


@intrinsic
def weigh_change(typingctx, to, level, before, fraction, strengths, count):
    """``to = strengths * (level - fraction * before)`` on `count` neighbouring values, by byte addresses."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        to, level, before, fraction, strengths, count = args
        vectors = Vectors.of(builder, str(signature.args[3]))
        factor = vectors.splat(builder.fneg(fraction))

        def chunk(x: Any, store: Callable[[Any, Any], None]) -> None:
            at = builder.mul(x, I64(vectors.size))
            change = vectors.multiply_add(
                vectors.load(builder.add(level, at)), factor, vectors.load(builder.add(before, at))
            )
            store(builder.fmul(vectors.load(builder.add(strengths, at)), change), builder.add(to, at))

        vectors.in_chunks(count, chunk)
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64, fraction, types.int64, types.int64), codegen


@intrinsic
def advance_masses(typingctx, states, levels, strengths, keep, pull, fraction, count, kept):
    """Move the masses that hang on `count` neighbouring nodes, and let them pull these; see `engine.features.dampers`.

    Takes byte addresses: `states`, of the nodes' last increments, of p and of q; `levels`, of the level that the
    increment is in, of the one that is subtracted from it, times `fraction`, 0 or 1, and of the levels to add to: a
    second one, 0 for none, and ``out``; and `strengths`. `kept` has the type of the states: that of the levels, or
    int32 for the first halves of their numbers, see `rows.shifts.Remembered`. Those are rounded to nearest, unlike the
    layers' memory: under a permanent load the layers would stop following the field, but dampers come to rest.
    """

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        last, p, q, level, before, second, out, strengths, keep, pull, fraction, count, _ = flat(builder, args)
        vectors = Vectors.of(builder, str(signature.args[3]))
        narrow = Vectors(builder, ir.FloatType(), vectors.lanes)
        halves = str(signature.args[7]) == "int32"
        long, short = (ir.VectorType(integer, vectors.lanes) for integer in (I64, I32))
        places, rounding = (ir.Constant(long, [number] * vectors.lanes) for number in (32, 1 << 31))
        kept, pulled, less = (vectors.splat(factor) for factor in (keep, builder.fneg(pull), builder.fneg(fraction)))

        def chunk(x: Any, store: Callable[[Any, Any], None], store_half: Callable[[Any, Any], None]) -> None:
            at = builder.mul(x, I64(vectors.size))

            def on(address: Any) -> Any:
                return builder.add(address, at)

            def half(address: Any) -> Any:
                return builder.add(address, builder.mul(x, I64(narrow.size)))

            def recalled(address: Any) -> Any:
                if not halves:
                    return vectors.load(on(address))
                bits = builder.zext(builder.bitcast(narrow.load(half(address)), short), long)
                return builder.bitcast(builder.shl(bits, places), vectors.type)

            def keep_state(value: Any, address: Any) -> None:
                if not halves:
                    store(value, on(address))
                    return
                bits = builder.lshr(builder.add(builder.bitcast(value, long), rounding), places)
                store_half(builder.bitcast(builder.trunc(bits, short), narrow.type), half(address))

            increment = vectors.multiply_add(vectors.load(on(level)), less, vectors.load(on(before)))
            displacement, velocity = recalled(p), recalled(q)
            moved = builder.fsub(increment, recalled(last))
            moved = vectors.multiply_add(vectors.multiply_add(moved, kept, velocity), pulled, displacement)
            gained = builder.fmul(vectors.load(on(strengths)), builder.fsub(moved, velocity))
            keep_state(builder.fadd(increment, gained), last)
            keep_state(builder.fadd(displacement, moved), p)
            keep_state(moved, q)
            store(builder.fadd(vectors.load(on(out)), gained), on(out))
            with builder.if_then(builder.icmp_signed("!=", second, I64(0))):
                store(builder.fadd(vectors.load(on(second)), gained), on(second))

        vectors.in_chunks(count, chunk, narrow)
        return context.get_dummy_value()

    addresses = types.UniTuple(types.int64, 3), types.UniTuple(types.int64, 4)
    return types.void(*addresses, types.int64, keep, keep, keep, types.int64, kept), codegen


@intrinsic
def relax_values(typingctx, levels, memory, apart, factors, count, back, total):
    """Relax the forces on `count` neighbouring nodes by mechanisms, and let these remember them; see
    `engine.features.relaxations`.

    Takes byte addresses: of the levels ``out``, ``src`` and ``base``; of the memory of the first mechanism, with the
    distance in bytes to that of the next one; and of the factors `keep` and `later`, with the number of mechanisms.
    """

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        out, src, base, memory, apart, keep, later, mechanisms, count, back, total = flat(builder, args)
        vectors = Vectors.of(builder, str(signature.args[5]))
        inertia, relaxed_now = vectors.splat(builder.fneg(back)), vectors.splat(builder.fneg(total))

        def chunk(x: Any, store: Callable[[Any, Any], None]) -> None:
            at = builder.mul(x, I64(vectors.size))
            new, now, old = (vectors.load(builder.add(level, at)) for level in (out, src, base))
            moved = vectors.multiply_add(builder.fsub(new, now), inertia, builder.fsub(now, old))

            def relax(number: Any, left: list[Any]) -> list[Any]:
                place = builder.add(builder.add(memory, at), builder.mul(number, apart))
                kept, added = (
                    vectors.splat(builder.load(vectors.pointer(vectors.shifted(start, (1, number)), vectors.scalar)))
                    for start in (keep, later)
                )
                held = vectors.load(place)
                store(vectors.multiply_add(builder.fmul(added, moved), kept, held), place)
                return [builder.fsub(left[0], held)]

            left = vectors.multiply_add(new, relaxed_now, moved)
            store(vectors.loop(I64(0), mechanisms, 1, [left], relax)[1][0], builder.add(out, at))

        vectors.in_chunks(count, chunk)
        return context.get_dummy_value()

    return types.void(int64s(3), types.int64, types.int64, int64s(3), types.int64, back, total), codegen


@intrinsic
def copy_run(typingctx, to, source, count, like):
    """``to = source`` for `count` neighbouring values of the type of `like`, by byte addresses."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        to, source, count, _ = args
        vectors = Vectors.of(builder, str(signature.args[3]))

        def chunk(x: Any, store: Callable[[Any, Any], None]) -> None:
            at = builder.mul(x, I64(vectors.size))
            store(vectors.load(builder.add(source, at)), builder.add(to, at))

        vectors.in_chunks(count, chunk)
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64, like), codegen


#: Runs of nodes that `take_passed` processes side by side: sums of one alone would wait for each other.
TOGETHER = 4


@intrinsic
def take_passed(typingctx, runs, number, arrays, steps, axes, taps, older, like):
    """``level -= strengths * F box`` on up to `TOGETHER` runs of neighbouring nodes, where F is the sum of one
    symmetric filter along each axis.

    Takes the address of the first run, see `filter.Filter.runs`, and the `number` of runs, at least 1; the byte
    addresses of the box, the strengths and the level; that of the distances in the box between neighbours along the
    axes (int64, in elements), and their number; that of the filter's weights, of a value itself and of the neighbours
    on both sides; the distance in bytes from the level to an older one from which the same is subtracted, 0 if there is
    none; and a value of the arrays' type.
    """

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        runs, number, box, strengths, level, steps, axes, taps, older, _ = flat(builder, args)
        vectors = Vectors.of(builder, str(signature.args[7]))
        lanes, zero, unity = I64(vectors.lanes), I64(0), I64(1)

        def entry(start: Any, i: int) -> Any:
            return builder.load(vectors.pointer(builder.add(start, I64(8 * i)), I64))

        def bytes_of(count: Any) -> Any:
            return builder.mul(count, I64(vectors.size))

        def least(a: Any, b: Any) -> Any:
            return builder.select(builder.icmp_signed("<", a, b), a, b)

        def most(a: Any, b: Any) -> Any:
            return builder.select(builder.icmp_signed(">", a, b), a, b)

        def tap(k: Any) -> Any:
            return vectors.splat(builder.load(vectors.pointer(builder.add(taps, bytes_of(k)), vectors.scalar)))

        def along(axes: int) -> None:
            places: tuple[list[Any], ...] = [], [], []
            rows = []
            for i in range(TOGETHER):
                exists = builder.icmp_signed("<", I64(i), number)
                row = builder.add(runs, builder.mul(builder.select(exists, I64(i), zero), I64(8 * (4 + axes))))
                for addresses, start, column in zip(places, (box, level, strengths), range(3), strict=True):
                    addresses.append(builder.add(start, bytes_of(entry(row, column))))
                rows.append(
                    [builder.select(exists, entry(row, 3), zero), *(entry(row, 4 + axis) for axis in range(axes))]
                )
            starts, targets, weights = places
            columns = list(zip(*rows, strict=True))
            counts, longest, *limits = columns[0], *(functools.reduce(most, column) for column in columns)
            shortest = functools.reduce(least, counts)
            full = builder.sub(shortest, builder.srem(shortest, lanes))  # whole vectors of all runs

            def passed(at: Any) -> list[Any]:
                """What the filter passes of one vector of each run."""
                centres, sums = [vectors.load(builder.add(start, at)) for start in starts], []
                for axis, limit in enumerate(limits):
                    step = bytes_of(entry(steps, axis))
                    first = [builder.fmul(tap(zero), centre) for centre in centres]
                    sums.append(summed(first, [builder.add(start, at) for start in starts], step, limit))
                return [vectors.sum(parts) for parts in zip(*sums, strict=True)]

            def take(x: Any, stores: list[Callable[[Any, Any], None]]) -> None:
                at = bytes_of(x)
                for total, weight, target, store in zip(passed(at), weights, targets, stores, strict=True):
                    taken, new = builder.fmul(vectors.load(builder.add(weight, at)), total), builder.add(target, at)
                    store(builder.fsub(vectors.load(new), taken), new)
                    with builder.if_then(builder.icmp_signed("!=", older, zero)):
                        old = builder.add(new, older)
                        store(builder.fsub(vectors.load(old), taken), old)

            with cgutils.for_range_slice(builder, zero, full, lanes, I64) as (x, _):
                take(x, [vectors.store] * TOGETHER)
            with cgutils.for_range_slice(builder, full, longest, lanes, I64) as (x, _):
                take(x, [vectors.store_first(builder.sub(count, x)) for count in counts])

        def summed(first: list[Any], centres: list[Any], step: Any, limit: Any) -> list[Any]:
            """Sums along one axis, over up to `limit` neighbours on both sides of addresses."""

            def grown(k: Any, totals: list[Any]) -> list[Any]:
                weight, distance, sums = tap(k), builder.mul(k, step), []
                for total, centre in zip(totals, centres, strict=True):
                    both = (vectors.load(move(centre, distance)) for move in (builder.add, builder.sub))
                    sums.append(vectors.multiply_add(total, weight, builder.fadd(*both)))
                return sums

            return vectors.loop(unity, builder.add(limit, unity), 1, first, grown)[1]

        for dim in (1, 2, 3):
            with builder.if_then(builder.icmp_signed("==", axes, I64(dim))):
                along(dim)
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, int64s(3), *[types.int64] * 4, like), codegen

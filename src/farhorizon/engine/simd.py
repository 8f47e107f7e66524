"""Explicit SIMD: Numba intrinsics that emit vector instructions, and one that calls a function by its address.

Numba's vectoriser loses most of the speed on loops of this kind, so the vector instructions are emitted here. Products
carry the ``contract`` flag only: a fixed order of summation keeps results deterministic and the registers few.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

#: (outer offset 0, outer offset 1, inner offset >= 0); every inner offset stands for both signs.
Shape = tuple[tuple[int, int, int], ...]

_CONTRACT = ("contract",)
_I64 = ir.IntType(64)
_I32 = ir.IntType(32)


class _Vectors:
    """Loads, stores and constants of one vector type, on byte addresses."""

    def __init__(self, builder: ir.IRBuilder, scalar: ir.Type, lanes: int) -> None:
        self.builder, self.scalar, self.lanes = builder, scalar, lanes
        self.size = 8 if isinstance(scalar, ir.DoubleType) else 4
        self.type = ir.VectorType(scalar, lanes)

    def splat(self, value: Any) -> Any:
        """The same value in every lane."""
        kind = ir.VectorType(value.type, self.lanes)
        first = self.builder.insert_element(ir.Constant(kind, ir.Undefined), value, _I32(0))
        return self.builder.shuffle_vector(first, ir.Constant(kind, ir.Undefined), ir.Constant(ir.VectorType(_I32, self.lanes), [0] * self.lanes))

    def pointer(self, address: Any, kind: ir.Type | None = None) -> Any:
        """A typed pointer from an address."""
        return self.builder.inttoptr(address, (kind or self.type).as_pointer())

    def load(self, address: Any) -> Any:
        """A vector from an address aligned to one element."""
        value = self.builder.load(self.pointer(address))
        value.align = self.size
        return value

    def store(self, value: Any, address: Any) -> None:
        """A vector to an address aligned to one element."""
        self.builder.store(value, self.pointer(address)).align = self.size

    def store_first(self, count: Any) -> Callable[[Any, Any], None]:
        """A store of the first `count` lanes only."""
        numbers = ir.VectorType(_I64, self.lanes)
        mask = self.builder.icmp_signed("<", ir.Constant(numbers, list(range(self.lanes))), self.splat(count))
        parts = [self.type, self.type.as_pointer(), _I32, ir.VectorType(ir.IntType(1), self.lanes)]
        suffix = f"v{self.lanes}f{self.size * 8}"
        masked = cgutils.get_or_insert_function(self.builder.module, ir.FunctionType(ir.VoidType(), parts), f"llvm.masked.store.{suffix}.p0{suffix}")
        return lambda value, address: self.builder.call(masked, [value, self.pointer(address), _I32(self.size), mask])

    def multiply_add(self, total: Any, factor: Any, term: Any) -> Any:
        """``total + factor * term``; the product alone without a total."""
        product = self.builder.fmul(factor, term, flags=_CONTRACT)
        return product if total is None else self.builder.fadd(total, product, flags=_CONTRACT)


def row_group_sweep(shape: Shape, classes: tuple[int, ...], rows: tuple[int, int], real: str, increments: bool) -> Any:
    """Make the intrinsic ``sweep(src, base, out, weights, a, b, n, s0, s1, s2, t0, t1)`` for one group of grid rows.

    Writes ``out = a*src + b*base + sum_k w_k (src_{+k} + src_{-k})`` on ``n`` nodes of each of ``R0 x R1`` neighbouring rows.
    Each input row is read once for the whole group; pair sums ``u[x-i] + u[x+i]`` and whole sums along a row that several
    output rows need are computed once.

    With ``increments`` the sum runs over differences and advances ``base`` in place:
    ``base = b*base + sum_k w_k (src_{+k} + src_{-k} - 2 src)`` and ``out = src + base``.

    Parameters
    ----------
    shape : tuple of (int, int, int)
        Stencil offsets without the centre, inner offset >= 0 (an inner offset i > 0 stands for +i and -i).
    classes : tuple of int
        Number of each offset's weight: offsets with one weight share a register.
    rows : (int, int)
        Rows in the group along the two outer axes.
    real : {"float64", "float32"}
    increments : bool

    Returns
    -------
    numba intrinsic
        Takes byte addresses (int64) of the group's first node in each array and of the weights (one a class), the numbers
        a and b, the row length, the distances between neighbours along the three axes of ``src`` and between rows of
        ``base`` and ``out``, in elements. Reads up to one vector beyond the end of a row, writes none.
    """
    scalar: ir.Type = ir.DoubleType() if real == "float64" else ir.FloatType()
    group = [(g0, g1) for g0 in range(rows[0]) for g1 in range(rows[1])]

    # A sum along an input row is a tuple of (inner offset, class); which of them go from which input row to which output rows?
    sums: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for number, (o0, o1, i) in zip(classes, shape, strict=True):
        sums.setdefault((o0, o1), []).append((i, number))
    uses: dict[tuple[int, int], dict[tuple[tuple[int, int], ...], list[int]]] = {}
    for out_row, (g0, g1) in enumerate(group):
        for (o0, o1), terms in sums.items():
            uses.setdefault((g0 + o0, g1 + o1), {}).setdefault(tuple(sorted(terms)), []).append(out_row)

    def emit(builder: ir.IRBuilder, args: tuple[Any, ...]) -> None:
        src, base, out, weights, a, b, n, s0, s1, s2, t0, t1 = args
        vectors = _Vectors(builder, scalar, 8 if real == "float64" else 16)
        size = vectors.size

        def shifted(address: Any, *moves: tuple[int, Any]) -> Any:
            for count, stride in moves:
                address = builder.add(address, builder.mul(_I64(count * size), stride))
            return address

        w = [vectors.splat(builder.load(vectors.pointer(shifted(weights, (i, _I64(1))), scalar))) for i in range(max(classes) + 1)]
        a_all, b_all = vectors.splat(a), vectors.splat(b)
        in_rows = {row: shifted(src, (row[0], s0), (row[1], s1)) for row in set(uses) | set(group)}
        base_rows, out_rows = ([shifted(start, (row[0], t0), (row[1], t1)) for row in group] for start in (base, out))

        def chunk(x: Any, store: Any) -> None:
            at = builder.mul(x, _I64(size))
            centre = {row: vectors.load(builder.add(in_rows[row], at)) for row in group}
            total: list[Any] = [None] * len(group)
            for row in sorted(in_rows):
                start = builder.add(in_rows[row], at)
                pairs: dict[int, Any] = {0: centre[row]} if row in centre else {}

                def neighbours(i: int, start: Any = start) -> tuple[Any, ...]:
                    return tuple(vectors.load(shifted(start, (side * i, s2))) for side in ((1, -1) if i else (1,)))

                def pair(i: int, pairs: dict[int, Any] = pairs, neighbours: Any = neighbours) -> Any:
                    if i not in pairs:
                        ends = neighbours(i)
                        pairs[i] = builder.fadd(*ends) if i else ends[0]
                    return pairs[i]

                for terms, users in uses.get(row, {}).items():
                    if increments:  # differences against each node's own value: nothing to share, no cancellation
                        for user in users:
                            own = centre[group[user]]
                            for i, number in terms:
                                change = [builder.fsub(end, own) for end in neighbours(i)]
                                total[user] = vectors.multiply_add(total[user], w[number], builder.fadd(*change) if i else change[0])
                    elif len(users) > 1 and len(terms) > 1:
                        shared = None
                        for i, number in terms:
                            shared = vectors.multiply_add(shared, w[number], pair(i))
                        for user in users:
                            total[user] = shared if total[user] is None else builder.fadd(total[user], shared)
                    else:
                        for user in users:
                            for i, number in terms:
                                total[user] = vectors.multiply_add(total[user], w[number], pair(i))
            for user, row in enumerate(group):
                base_at, out_at = builder.add(base_rows[user], at), builder.add(out_rows[user], at)
                new = vectors.multiply_add(total[user], b_all, vectors.load(base_at))
                if increments:
                    store(new, base_at)
                    new = builder.fadd(centre[row], new)
                else:
                    new = vectors.multiply_add(new, a_all, centre[row])
                store(new, out_at)

        rest = builder.srem(n, _I64(vectors.lanes))
        whole = builder.sub(n, rest)
        with cgutils.for_range_slice(builder, _I64(0), whole, _I64(vectors.lanes), _I64) as (x, _):
            chunk(x, vectors.store)
        with builder.if_then(builder.icmp_signed(">", rest, _I64(0))):
            chunk(whole, vectors.store_first(rest))

    @intrinsic
    def sweep(typingctx, src, base, out, weights, a, b, n, s0, s1, s2, t0, t1):  # type: ignore[no-untyped-def]
        def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
            emit(builder, args)
            return context.get_dummy_value()

        return sweep_signature(real), codegen

    return sweep


def sweep_signature(real: str) -> Any:
    """Numba signature of a row group sweep."""
    return types.void(*[types.int64] * 4, *[getattr(types, real)] * 2, *[types.int64] * 6)


@intrinsic
def call_sweep(typingctx, function, src, base, out, weights, a, b, n, s0, s1, s2, t0, t1):  # type: ignore[no-untyped-def]
    """Call a compiled row group sweep by its address: the driver need not be compiled again for every stencil."""
    signature = types.void(*[types.int64] * 5, a, a, *[types.int64] * 6)

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        kind = ir.FunctionType(ir.VoidType(), [arg.type for arg in args[1:]])
        builder.call(builder.inttoptr(args[0], kind.as_pointer()), args[1:])
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def sweep_phases(typingctx, src, coefficient, base, out, offsets, weights, bonds, a, b, n, n0, n1, s0, s1, t0, t1):  # type: ignore[no-untyped-def]
    """``out = a*src + b*base + sum over the bonds`` on `n` nodes of `n0` x `n1` rows, where bonds differ by the phases of their ends.

    All but a, b and the counts are byte addresses: of the first node in each array, of the distances (int64) to the neighbours and of their
    weights. Rows lie s0 and s1 elements apart in src and coefficient, t0 and t1 in base and out. A node with the coefficient c > 0
    (which is 1) sums ``w |c'| (u' - u)``, another one ``w |c| (u' - u)`` over liquid neighbours only, so that nothing at all flows
    between solid nodes. Reads up to 16 nodes beyond the end of a row, writes none.
    """

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        src, coefficient, base, out, offsets, weights, bonds, a, b, n, n0, n1, s0, s1, t0, t1 = args
        vectors = _Vectors(builder, a.type, 8 if isinstance(a.type, ir.DoubleType) else 16)
        size, width = vectors.size, 16
        parts = range(width // vectors.lanes)
        zero = ir.Constant(vectors.type, [0.0] * vectors.lanes)
        kind = ir.FunctionType(vectors.type, [vectors.type])
        absolute = cgutils.get_or_insert_function(builder.module, kind, f"llvm.fabs.v{vectors.lanes}f{size * 8}")

        def at(address: Any, part: int) -> Any:
            return builder.add(address, _I64(part * vectors.lanes * size))

        def chunk(row: tuple[Any, ...], x: Any, stores: list[Any]) -> None:
            shift = builder.mul(x, _I64(size))
            here, phase, older, new = (builder.add(address, shift) for address in row)
            own = [vectors.load(at(here, part)) for part in parts]
            before, body, after = builder.block, builder.append_basic_block("bonds"), builder.append_basic_block("done")
            builder.branch(body)
            builder.position_at_end(body)
            bond = builder.phi(_I64)
            sums = [builder.phi(vectors.type) for _ in range(2 * len(parts))]
            for phi, first in zip([bond, *sums], [_I64(0), *[zero] * len(sums)], strict=True):
                phi.add_incoming(first, before)
            distance = builder.load(vectors.pointer(builder.add(offsets, builder.mul(bond, _I64(8))), _I64))
            distance = builder.mul(distance, _I64(size))
            weight = vectors.splat(builder.load(vectors.pointer(builder.add(weights, builder.mul(bond, _I64(size))), vectors.scalar)))
            there, other = builder.add(here, distance), builder.add(phase, distance)
            grown = []
            for part in parts:
                flow = builder.fmul(weight, builder.fsub(vectors.load(at(there, part)), own[part]))
                theirs = vectors.load(at(other, part))
                grown.append(vectors.multiply_add(sums[2 * part], flow, builder.call(absolute, [theirs])))
                grown.append(builder.fadd(sums[2 * part + 1], builder.select(builder.fcmp_ordered(">", theirs, zero), flow, zero)))
            following = builder.add(bond, _I64(1))
            for phi, value in zip([bond, *sums], [following, *grown], strict=True):
                phi.add_incoming(value, builder.block)
            builder.cbranch(builder.icmp_signed("<", following, bonds), body, after)
            builder.position_at_end(after)
            for part, store in zip(parts, stores, strict=True):
                mine = vectors.load(at(phase, part))
                solid = builder.fmul(builder.call(absolute, [mine]), grown[2 * part + 1])
                total = builder.select(builder.fcmp_ordered(">", mine, zero), grown[2 * part], solid)
                total = vectors.multiply_add(total, vectors.splat(b), vectors.load(at(older, part)))
                store(vectors.multiply_add(total, vectors.splat(a), own[part]), at(new, part))

        rest = builder.srem(n, _I64(width))
        whole = builder.sub(n, rest)
        with cgutils.for_range(builder, n0) as first, cgutils.for_range(builder, n1) as second:
            read, written = (
                builder.mul(builder.add(builder.mul(first.index, p), builder.mul(second.index, q)), _I64(size)) for p, q in ((s0, s1), (t0, t1))
            )
            row = builder.add(src, read), builder.add(coefficient, read), builder.add(base, written), builder.add(out, written)
            with cgutils.for_range_slice(builder, _I64(0), whole, _I64(width), _I64) as (x, _):
                chunk(row, x, [vectors.store for _ in parts])
            with builder.if_then(builder.icmp_signed(">", rest, _I64(0))):
                chunk(row, whole, [vectors.store_first(builder.sub(rest, _I64(part * vectors.lanes))) for part in parts])
        return context.get_dummy_value()

    return types.void(*[types.int64] * 7, a, a, *[types.int64] * 7), codegen


def stretch_chain(lines: int, remember: bool) -> Any:
    """Make the intrinsic that continues a bundle of lines by one offset along a chain of columns.

    ``stretch(near, diagonal, here, far, step, memory, r, e, f, turn, n, count, like)``: at each of `n` columns, `step` bytes apart,
    ``d = here - diagonal; far = near + r*d - memory; memory = e*memory + f*d`` on the first `count` of `lines` values side by
    side (without the memory unless `remember`), where `near` and `diagonal` are `here` and `far` of the column before.

    All but `turn` (+1 or -1: direction in which the tables r, e, f are read), `n`, `count` and `like` (a number of the wanted
    precision) are byte addresses; n > 0. Reads up to `lines` values from each address, writes `count`. A whole bundle has plain
    stores: what a masked store wrote cannot be read back before it has reached the cache.
    """

    def chain(builder: ir.IRBuilder, args: tuple[Any, ...], vectors: _Vectors, stores: list[Any]) -> None:
        near, diagonal, here, far, step, memory, r, e, f, turn, n, _, like = args
        parts = range(len(stores))

        def at(address: Any, part: int) -> Any:
            return builder.add(address, _I64(part * vectors.lanes * vectors.size))

        start = [vectors.load(at(address, part)) for address in (near, diagonal) for part in parts]
        before, body, after = builder.block, builder.append_basic_block("columns"), builder.append_basic_block("done")
        builder.branch(body)
        builder.position_at_end(body)
        column = builder.phi(_I64)
        carried = [builder.phi(vectors.type) for _ in start]
        for phi, first in zip([column, *carried], [_I64(0), *start], strict=True):
            phi.add_incoming(first, before)
        move, turned = builder.mul(column, step), builder.mul(builder.mul(column, turn), _I64(vectors.size))
        kept = builder.add(memory, builder.mul(column, _I64(lines * vectors.size)))
        r_all, e_all, f_all = (vectors.splat(builder.load(vectors.pointer(builder.add(table, turned), like.type))) for table in (r, e, f))
        heres, news = [], []
        for part, store in enumerate(stores):
            value = vectors.load(at(builder.add(here, move), part))
            d = builder.fsub(value, carried[len(parts) + part])
            new = vectors.multiply_add(carried[part], r_all, d)
            if remember:
                old = vectors.load(at(kept, part))
                new = builder.fsub(new, old)
                store(vectors.multiply_add(builder.fmul(e_all, old, flags=_CONTRACT), f_all, d), at(kept, part))
            store(new, at(builder.add(far, move), part))
            heres.append(value)
            news.append(new)
        following = builder.add(column, _I64(1))
        for phi, value in zip([column, *carried], [following, *heres, *news], strict=True):
            phi.add_incoming(value, builder.block)
        builder.cbranch(builder.icmp_signed("<", following, n), body, after)
        builder.position_at_end(after)

    @intrinsic
    def stretch(typingctx, near, diagonal, here, far, step, memory, r, e, f, turn, n, count, like):  # type: ignore[no-untyped-def]
        def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
            count, like = args[-2:]
            full = 8 if isinstance(like.type, ir.DoubleType) else 16
            one, many = _Vectors(builder, like.type, 1), _Vectors(builder, like.type, full)
            with builder.if_else(builder.icmp_signed("==", count, _I64(lines))) as (whole, part):
                with whole:
                    chain(builder, args, many, [many.store] * (lines // full))
                with part, builder.if_else(builder.icmp_signed("==", count, _I64(1))) as (single, several):
                    with single:
                        chain(builder, args, one, [one.store])
                    with several:
                        chain(builder, args, many, [many.store_first(builder.sub(count, _I64(first))) for first in range(0, lines, full)])
            return context.get_dummy_value()

        return types.void(*[types.int64] * 12, like), codegen

    return stretch

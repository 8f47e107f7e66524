"""Explicit SIMD: Numba intrinsics that emit vector instructions, and one that calls a function by its address.

Numba's vectoriser loses most of the speed on loops of this kind, so the vector instructions are emitted here. Products
carry the ``contract`` flag only: a fixed order of summation keeps results deterministic and the registers few.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

#: (outer offset 0, outer offset 1, inner offset >= 0); every inner offset stands for both signs.
Shape = tuple[tuple[int, int, int], ...]

_CONTRACT = ("contract",)
I64 = ir.IntType(64)
I32 = ir.IntType(32)
_FIRST_CACHE = 41_000  # bytes of the first cache that a tile may take
AHEAD = 2  # rows between use and prefetch: one lasts less than a fetch from memory


class Vectors:
    """Loads, stores and constants of one vector type, on byte addresses."""

    def __init__(self, builder: ir.IRBuilder, scalar: ir.Type, lanes: int) -> None:
        self.builder, self.scalar, self.lanes = builder, scalar, lanes
        self.size = 8 if isinstance(scalar, ir.DoubleType) else 4
        self.type = ir.VectorType(scalar, lanes)

    @classmethod
    def of(cls, builder: ir.IRBuilder, real: str) -> Vectors:
        """Vectors of 64 bytes."""
        return cls(builder, ir.DoubleType(), 8) if real == "float64" else cls(builder, ir.FloatType(), 16)

    def splat(self, value: Any) -> Any:
        """The same value in every lane."""
        kind = ir.VectorType(value.type, self.lanes)
        first = self.builder.insert_element(ir.Constant(kind, ir.Undefined), value, I32(0))
        return self.builder.shuffle_vector(first, ir.Constant(kind, ir.Undefined), ir.Constant(ir.VectorType(I32, self.lanes), [0] * self.lanes))

    def splat_all(self, address: Any, count: int) -> list[Any]:
        """Each of `count` values in every lane of a vector of its own."""
        return [self.splat(self.builder.load(self.pointer(self.builder.add(address, I64(i * self.size)), self.scalar))) for i in range(count)]

    def shifted(self, address: Any, *moves: tuple[int, Any]) -> Any:
        """An address moved by count * distance elements for each (count, distance)."""
        for count, distance in moves:
            address = self.builder.add(address, self.builder.mul(I64(count * self.size), distance))
        return address

    def concatenate(self, low: Any, high: Any, first: int) -> Any:
        """The lanes from `first` on of two vectors one after the other."""
        return self.builder.shuffle_vector(low, high, ir.Constant(ir.VectorType(I32, self.lanes), list(range(first, first + self.lanes))))

    def prefetch(self, address: Any) -> None:
        """Fetch the cache line of an address, which need not exist."""
        kind = ir.IntType(8).as_pointer()
        fetch = cgutils.get_or_insert_function(self.builder.module, ir.FunctionType(ir.VoidType(), [kind, I32, I32, I32]), "llvm.prefetch.p0i8")
        self.builder.call(fetch, [self.pointer(address, ir.IntType(8)), I32(0), I32(3), I32(1)])

    def sum(self, terms: Sequence[Any]) -> Any:
        """The terms added up from the left."""
        return functools.reduce(self.builder.fadd, terms)

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
        numbers = ir.VectorType(I64, self.lanes)
        mask = self.builder.icmp_signed("<", ir.Constant(numbers, list(range(self.lanes))), self.splat(count))
        parts = [self.type, self.type.as_pointer(), I32, ir.VectorType(ir.IntType(1), self.lanes)]
        suffix = f"v{self.lanes}f{self.size * 8}"
        masked = cgutils.get_or_insert_function(self.builder.module, ir.FunctionType(ir.VoidType(), parts), f"llvm.masked.store.{suffix}.p0{suffix}")
        return lambda value, address: self.builder.call(masked, [value, self.pointer(address), I32(self.size), mask])

    def in_chunks(self, count: Any, chunk: Callable[[Any, Callable[[Any, Any], None]], None]) -> None:
        """Call ``chunk(x, store)`` for every whole vector of `count` values and for the rest."""
        rest = self.builder.srem(count, I64(self.lanes))
        whole = self.builder.sub(count, rest)
        with cgutils.for_range_slice(self.builder, I64(0), whole, I64(self.lanes), I64) as (x, _):
            chunk(x, self.store)
        with self.builder.if_then(self.builder.icmp_signed(">", rest, I64(0))):
            chunk(whole, self.store_first(rest))

    def multiply_add(self, total: Any, factor: Any, term: Any) -> Any:
        """``total + factor * term``; the product alone without a total."""
        product = self.builder.fmul(factor, term, flags=_CONTRACT)
        return product if total is None else self.builder.fadd(total, product, flags=_CONTRACT)


def line_sweep(shape: Shape, classes: tuple[int, ...], real: str) -> Any:
    """Make the intrinsic ``sweep(src, base, out, weights, a, b, n, count, s0, s1, s2, step, t, shifts)`` for rows of neighbours in memory.

    Writes ``out = a*src + b*base + sum_k w_k (src_{+k} + src_{-k})`` on `count` rows of `n` nodes. Sums over the outer axes come first:
    ``T_i = sum_o w_(o,i) src_o``, lines of equal weights added before they are multiplied. What is left is ``T_0`` and the
    ``T_i`` moved by +i and -i along the row: two neighbouring vectors, one shuffle each. So every line is read
    once, aligned, and a vector costs few more instructions than it has different weights.

    Long rows are swept in tiles whose lines stay in the first cache from one row to the next. What the row after next
    needs is fetched ahead: a tile is too short for the hardware to notice.

    Parameters
    ----------
    shape : tuple of (int, int, int)
        Stencil offsets without the centre, inner offset >= 0 (an inner offset i > 0 stands for +i and -i), at most one vector.
    classes : tuple of int
        Number of each offset's weight: offsets with one weight share a register.
    real : {"float64", "float32"}

    Returns
    -------
    numba intrinsic
        Takes byte addresses (int64) of the first node in each array and of the weights (one a class), the numbers a and b, the
        nodes of a row, the rows, the distances between neighbours along the three axes of ``src`` (s2 is 1) and between rows of
        ``src`` and of ``base`` and ``out``, in elements. Reads up to one vector before and beyond a row, writes none.
    """
    terms_of: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for number, (o0, o1, i) in zip(classes, shape, strict=True):
        terms_of.setdefault((o0, o1), []).append((i, number))
    alike: dict[tuple[tuple[int, int], ...], list[tuple[int, int]]] = {}
    for line, terms in terms_of.items():
        alike.setdefault(tuple(sorted(terms)), []).append(line)
    inner = sorted({i for _, _, i in shape})
    moved = [i for i in inner if i]
    last = {o0: max(o1 for other, o1 in terms_of if other == o0) for o0, _ in terms_of}  # the line of each plane that the next row reads first

    def emit(builder: ir.IRBuilder, args: tuple[Any, ...]) -> None:
        weights, s0, s1, step, t = args[3], args[8], args[9], args[11], args[12]
        vectors = Vectors.of(builder, real)
        w = vectors.splat_all(weights, max(classes) + 1)

        def prepare(here: Any, old: Any, new: Any) -> Row:
            lines = {line: vectors.shifted(here, (line[0], s0), (line[1], s1)) for line in terms_of}
            ahead = [vectors.shifted(here, (o0, s0), (o1, s1), (AHEAD, step)) for o0, o1 in last.items()] + [vectors.shifted(old, (AHEAD, t))]

            def sums(at: Any) -> dict[int, Any]:
                """T_i of one vector."""
                total: dict[int, Any] = dict.fromkeys([0, *inner])
                for terms, equal in alike.items():
                    together = vectors.sum([vectors.load(builder.add(lines[line], at)) for line in equal])
                    for i, number in terms:
                        total[i] = vectors.multiply_add(total[i], w[number], together)
                return total

            return Row(sums, [Output(0, [(i, i, i) for i in moved], here, old, new)], ahead)

        sweep_lines(vectors, args, tile_nodes(len(terms_of), vectors.size), prepare)

    return sweep_intrinsic(emit, real)


@dataclass(frozen=True)
class Output:
    """One field of a row: addresses of its first node, and which sums of a vector it gets.

    Attributes
    ----------
    centre : hashable
        Name of the sum that stays where it is.
    moved : list of (i, ahead, behind)
        The sum `ahead` comes from i nodes further on along the row, the sum `behind` from i nodes back.
    here, old, new : address
        In ``src``, ``base`` and ``out``.
    """

    centre: Hashable
    moved: Sequence[tuple[int, Hashable, Hashable]]
    here: Any
    old: Any
    new: Any


@dataclass(frozen=True)
class Row:
    """A row of nodes: the sums of the vector at a distance from its first node, by name, None for an empty one; its fields; what to fetch ahead."""

    sums: Callable[[Any], Mapping[Any, Any]]
    outputs: Sequence[Output]
    ahead: Sequence[Any]


def sweep_lines(vectors: Vectors, args: tuple[Any, ...], length_of_tile: int, prepare: Callable[[Any, Any, Any], Row]) -> None:
    """The loops of a sweep of rows whose nodes are neighbours in memory, tile by tile.

    Parameters
    ----------
    vectors : Vectors
    args : tuple
        Arguments of the sweep (see `line_sweep`).
    length_of_tile : int
    prepare : callable
        The `Row` that begins at given addresses in ``src``, ``base`` and ``out``.
    """
    builder = vectors.builder
    src, base, out, _, a, b, n, count, _, _, _, step, t, _ = args
    size, width = vectors.size, I64(vectors.lanes)
    a_all, b_all = vectors.splat(a), vectors.splat(b)
    tile = I64(length_of_tile)

    def row(x0: Any, length: Any, number: Any) -> None:
        here = vectors.shifted(src, (1, x0), (1, builder.mul(number, step)))
        old, new = (vectors.shifted(start, (1, x0), (1, builder.mul(number, t))) for start in (base, out))
        made = prepare(here, old, new)
        names = list(dict.fromkeys(name for o in made.outputs for _, *both in o.moved for name in both))

        def from_before(output: Output, before: Mapping[Any, Any], now: Mapping[Any, Any]) -> Any:
            """What the vector `now` gets from itself and the one before."""
            parts = [now[output.centre]] if now[output.centre] is not None else []
            return vectors.sum(parts + [vectors.concatenate(before[name], now[name], vectors.lanes - i) for i, _, name in output.moved])

        def finish(x: Any, totals: Sequence[Any], now: Mapping[Any, Any], store: Callable[[Any, Any], None]) -> tuple[Mapping[Any, Any], list[Any]]:
            """Write one vector; the sums and the totals so far of the next."""
            at = builder.mul(x, I64(size))
            for address in made.ahead:
                vectors.prefetch(builder.add(address, at))
            following = made.sums(builder.add(at, I64(vectors.lanes * size)))
            for output, begun in zip(made.outputs, totals, strict=True):
                total = vectors.sum([begun] + [vectors.concatenate(now[name], following[name], i) for i, name, _ in output.moved])
                total = vectors.multiply_add(total, b_all, vectors.load(builder.add(output.old, at)))
                store(vectors.multiply_add(total, a_all, vectors.load(builder.add(output.here, at))), builder.add(output.new, at))
            return following, [from_before(output, now, following) for output in made.outputs]

        first = made.sums(I64(0))
        before_first = made.sums(I64(-vectors.lanes * size))
        start = [I64(0), *(from_before(output, before_first, first) for output in made.outputs), *(first[name] for name in names)]
        rest = builder.srem(length, width)
        whole = builder.sub(length, rest)
        before, test, body, after = builder.block, *(builder.append_basic_block(name) for name in ("test", "vector", "rest"))
        builder.branch(test)
        builder.position_at_end(test)
        carried = [builder.phi(value.type) for value in start]
        x, totals, sums_now = carried[0], carried[1 : 1 + len(made.outputs)], carried[1 + len(made.outputs) :]
        now = dict(zip(names, sums_now, strict=True))
        builder.cbranch(builder.icmp_signed("<", x, whole), body, after)
        builder.position_at_end(body)
        following, begun = finish(x, totals, now, vectors.store)
        end = [builder.add(x, width), *begun, *(following[name] for name in names)]
        for phi, entering, coming in zip(carried, start, end, strict=True):
            phi.add_incoming(entering, before)
            phi.add_incoming(coming, builder.block)
        builder.branch(test)
        builder.position_at_end(after)
        with builder.if_then(builder.icmp_signed(">", rest, I64(0))):
            finish(x, totals, now, vectors.store_first(rest))

    with cgutils.for_range_slice(builder, I64(0), n, tile, I64) as (x0, _):
        left = builder.sub(n, x0)
        length = builder.select(builder.icmp_signed("<", left, tile), left, tile)
        with cgutils.for_range_slice(builder, I64(0), count, I64(1), I64) as (number, _):
            row(x0, length, number)


def strided_sweep(shape: Shape, classes: tuple[int, ...], real: str, increments: bool) -> Any:
    """Make the intrinsic of `line_sweep` for rows whose neighbours may lie any distance s2 apart; every neighbour is read by itself.

    With ``increments`` the sum runs over differences, which do not cancel, and advances ``base`` in place:
    ``base = b*base + sum_k w_k (src_{+k} + src_{-k} - 2 src)`` and ``out = src + base``.
    """
    members: dict[int, list[tuple[int, int, int]]] = {}
    for number, (o0, o1, i) in zip(classes, shape, strict=True):
        members.setdefault(number, []).extend((o0, o1, side * i) for side in ((1, -1) if i else (1,)))

    def emit(builder: ir.IRBuilder, args: tuple[Any, ...]) -> None:
        src, base, out, weights, a, b, n, count, s0, s1, s2, step, t, _ = args
        vectors = Vectors.of(builder, real)
        w = vectors.splat_all(weights, max(classes) + 1)
        a_all, b_all = vectors.splat(a), vectors.splat(b)

        def row(number: Any) -> None:
            here = vectors.shifted(src, (1, builder.mul(number, step)))
            old, new = (vectors.shifted(start, (1, builder.mul(number, t))) for start in (base, out))
            places = {o: vectors.shifted(here, *zip(o, (s0, s1, s2), strict=True)) for equal in members.values() for o in equal}

            def chunk(x: Any, store: Callable[[Any, Any], None]) -> None:
                at = builder.mul(x, I64(vectors.size))
                own = vectors.load(builder.add(here, at))
                total = None
                for number, equal in members.items():
                    values = [vectors.load(builder.add(places[o], at)) for o in equal]
                    total = vectors.multiply_add(total, w[number], vectors.sum([builder.fsub(v, own) for v in values] if increments else values))
                total = vectors.multiply_add(total, b_all, vectors.load(builder.add(old, at)))
                if increments:
                    store(total, builder.add(old, at))
                store(builder.fadd(own, total) if increments else vectors.multiply_add(total, a_all, own), builder.add(new, at))

            vectors.in_chunks(n, chunk)

        with cgutils.for_range_slice(builder, I64(0), count, I64(1), I64) as (number, _):
            row(number)

    return sweep_intrinsic(emit, real)


def tile_nodes(lines: int, size: int) -> int:
    """Nodes of a row to sweep at a time, so that all lines read and written stay in the first cache; lines too many for that go whole."""
    fitting = _FIRST_CACHE // ((lines + 3) * size) // 64 * 64
    return fitting if fitting * size >= 2048 else 1 << 30


def sweep_intrinsic(emit: Callable[[ir.IRBuilder, tuple[Any, ...]], None], real: str) -> Any:
    @intrinsic
    def sweep(typingctx, src, base, out, weights, a, b, n, count, s0, s1, s2, step, t, shifts):  # type: ignore[no-untyped-def]
        def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
            emit(builder, args)
            return context.get_dummy_value()

        return sweep_signature(real), codegen

    return sweep


def sweep_signature(real: str) -> Any:
    """Numba signature of a sweep."""
    return types.void(*[types.int64] * 4, *[getattr(types, real)] * 2, *[types.int64] * 8)


@intrinsic
def call_sweep(typingctx, function, src, base, out, weights, a, b, n, count, s0, s1, s2, step, t, shifts):  # type: ignore[no-untyped-def]
    """Call a compiled sweep by its address: the driver need not be compiled again for every stencil."""
    signature = types.void(*[types.int64] * 5, a, a, *[types.int64] * 8)

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        kind = ir.FunctionType(ir.VoidType(), [arg.type for arg in args[1:]])
        builder.call(builder.inttoptr(args[0], kind.as_pointer()), args[1:])
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def weigh(typingctx, out, src, weights, scale, n, terms, apart, step):  # type: ignore[no-untyped-def]
    """``out += scale * sum_b weights_b * src_b`` on `n` neighbouring values, b below `terms` (at least 1).

    `out`, `src` and `weights` are byte addresses of the first values; those of the terms lie `apart` and `step`
    elements apart. Reads up to one vector beyond the last value, writes none.
    """

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        out, src, weights, scale, n, terms, apart, step = args
        vectors = Vectors.of(builder, str(signature.args[3]))
        scales = vectors.splat(scale)

        def chunk(x: Any, store: Callable[[Any, Any], None]) -> None:
            before, body, after = builder.block, builder.append_basic_block("terms"), builder.append_basic_block("done")
            builder.branch(body)
            builder.position_at_end(body)
            term, total = builder.phi(I64), builder.phi(vectors.type)
            value = vectors.load(vectors.shifted(src, (1, x), (1, builder.mul(term, apart))))
            weight = vectors.load(vectors.shifted(weights, (1, x), (1, builder.mul(term, step))))
            grown, following = vectors.multiply_add(total, weight, value), builder.add(term, I64(1))
            nothing = ir.Constant(vectors.type, [0.0] * vectors.lanes)
            for phi, first, later in ((term, I64(0), following), (total, nothing, grown)):
                phi.add_incoming(first, before)
                phi.add_incoming(later, body)
            builder.cbranch(builder.icmp_signed("<", following, terms), body, after)
            builder.position_at_end(after)
            at = vectors.shifted(out, (1, x))
            store(vectors.multiply_add(vectors.load(at), scales, grown), at)

        vectors.in_chunks(n, chunk)
        return context.get_dummy_value()

    return types.void(*[types.int64] * 3, scale, *[types.int64] * 4), codegen


#: Nodes of a row, and rows, that `sweep_phases` takes at a time: a vector a row, so that all sums of a tile stay in registers.
TILE, TILE_ROWS = 8, 4


@intrinsic
def sweep_phases(typingctx, src, coefficient, base, out, offsets, weights, bonds, a, b, interface, ceiling, n, count, step, t):  # type: ignore[no-untyped-def]
    """``out = a*src + b*base + sum over the bonds`` on up to `TILE_ROWS` rows of `n` nodes, where bonds differ by the phases of their ends.

    All but a, b, the factor `interface` of bonds between the phases and the counts are byte addresses: of the first node in each array, of the
    distances (int64) to the neighbours and of their weights. Rows lie `step` elements apart in src and coefficient, t in base and out; a
    coefficient above 0 marks the liquid. A liquid node gains ``w (u' - u)`` from each liquid neighbour, and a node gains ``interface w (c' - c)``
    from each neighbour of the other phase, c the lesser of u and `ceiling`, so that nothing at all flows between solid nodes. Rows that are
    not there repeat the last one: their sums cost less than a loop of another length. Reads up to 8 nodes beyond the end of a row, writes none.
    """

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        src, coefficient, base, out, offsets, weights, bonds, a, b, interface, ceiling, n, count, step, t = args
        vectors = Vectors(builder, a.type, TILE)
        size = vectors.size
        zero = ir.Constant(vectors.type, [0.0] * vectors.lanes)
        a_all, b_all, between, most = (vectors.splat(value) for value in (a, b, interface, ceiling))
        last = builder.sub(count, I64(1))
        numbers = [builder.select(builder.icmp_signed("<", last, I64(row)), last, I64(row)) for row in range(TILE_ROWS)]
        apart = builder.sub(coefficient, src)

        def liquid(address: Any) -> Any:
            return builder.fcmp_ordered(">", vectors.load(address), zero)

        def held(value: Any) -> Any:
            return builder.select(builder.fcmp_ordered(">", value, most), most, value)  # what is no number stays so

        def chunk(x: Any, store: Callable[[Any, Any], None]) -> None:
            heres = [vectors.shifted(src, (1, x), (1, builder.mul(number, step))) for number in numbers]
            own = [vectors.load(here) for here in heres]
            wet = [liquid(builder.add(here, apart)) for here in heres]
            bound = [held(value) for value in own]
            before, body, after = builder.block, builder.append_basic_block("bonds"), builder.append_basic_block("done")
            builder.branch(body)
            builder.position_at_end(body)
            bond = builder.phi(I64)
            sums = [builder.phi(vectors.type) for _ in range(2 * len(heres))]
            for phi, first in zip([bond, *sums], [I64(0), *[zero] * len(sums)], strict=True):
                phi.add_incoming(first, before)
            distance = builder.load(vectors.pointer(builder.add(offsets, builder.mul(bond, I64(8))), I64))
            distance = builder.mul(distance, I64(size))
            weight = vectors.splat(builder.load(vectors.pointer(builder.add(weights, builder.mul(bond, I64(size))), vectors.scalar)))
            grown = []
            for row, here in enumerate(heres):
                there = builder.add(here, distance)
                value, other = vectors.load(there), liquid(builder.add(there, apart))
                across = vectors.multiply_add(sums[2 * row], weight, builder.fsub(held(value), bound[row]))
                grown.append(builder.select(builder.xor(wet[row], other), across, sums[2 * row]))
                opened = vectors.multiply_add(sums[2 * row + 1], weight, builder.fsub(value, own[row]))
                grown.append(builder.select(builder.and_(wet[row], other), opened, sums[2 * row + 1]))
            following = builder.add(bond, I64(1))
            for phi, value in zip([bond, *sums], [following, *grown], strict=True):
                phi.add_incoming(value, builder.block)
            builder.cbranch(builder.icmp_signed("<", following, bonds), body, after)
            builder.position_at_end(after)
            places = [vectors.shifted(I64(0), (1, x), (1, builder.mul(number, t))) for number in numbers]
            olds = [vectors.load(builder.add(base, place)) for place in places]  # before any store: rows may be repeated, and base be out
            for row, place in enumerate(places):
                total = vectors.multiply_add(grown[2 * row + 1], between, grown[2 * row])
                total = vectors.multiply_add(total, b_all, olds[row])
                store(vectors.multiply_add(total, a_all, own[row]), builder.add(out, place))

        rest = builder.srem(n, I64(vectors.lanes))
        whole = builder.sub(n, rest)
        with cgutils.for_range_slice(builder, I64(0), whole, I64(vectors.lanes), I64) as (x, _):
            chunk(x, vectors.store)
        with builder.if_then(builder.icmp_signed(">", rest, I64(0))):
            chunk(whole, vectors.store_first(rest))
        return context.get_dummy_value()

    return types.void(*[types.int64] * 7, a, a, a, a, *[types.int64] * 4), codegen


#: Neighbouring values that a window has, and sums that are taken side by side.
WINDOW, BUNDLE = 8, 4


@intrinsic
def window_sums(typingctx, sums, count, places, values, first, second, third, fourth):  # type: ignore[no-untyped-def]
    """Four sums over as many windows of `values` with weights, side by side: one alone would wait for its own additions.

    Takes the number of windows and byte addresses: of the results, of ``places[k, sum]``, the distance in bytes (uint32) of a window from
    `values`, and of the weights (float64) of each sum, `WINDOW` a window.
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
            """Sum of two choices from the lanes of two vectors one after the other."""
            return builder.fadd(*(builder.shuffle_vector(low, high, ir.Constant(ir.VectorType(I32, len(p)), list(p))) for p in places))

        pairs = [
            added(builder.load(totals[i]), builder.load(totals[i + 1]), (0, 8, 2, 10, 4, 12, 6, 14), (1, 9, 3, 11, 5, 13, 7, 15)) for i in (0, 2)
        ]
        halves = added(*pairs, (0, 1, 8, 9, 4, 5, 12, 13), (2, 3, 10, 11, 6, 7, 14, 15))
        Vectors(builder, ir.DoubleType(), BUNDLE).store(added(halves, halves, (0, 1, 2, 3), (4, 5, 6, 7)), sums)
        return context.get_dummy_value()

    return types.void(*[types.int64] * 8), codegen


@intrinsic
def move_up(typingctx, address, count):  # type: ignore[no-untyped-def]
    """Move `count` neighbouring numbers of 8 bytes from a byte address on by one place."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        address, count = args
        low, high = (builder.inttoptr(builder.add(address, I64(shift)), I64.as_pointer()) for shift in (0, 8))
        cgutils.raw_memmove(builder, high, low, count, 8)
        return context.get_dummy_value()

    return types.void(types.int64, types.int64), codegen


@intrinsic
def clear(typingctx, address, count, like):  # type: ignore[no-untyped-def]
    """Set `count` neighbouring values of the type of `like` to zero, from a byte address on; made for a few dozen."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        address, count, _ = args
        vectors = Vectors.of(builder, str(signature.args[2]))
        zero = ir.Constant(vectors.type, [0.0] * vectors.lanes)
        with cgutils.for_range_slice(builder, I64(0), count, I64(vectors.lanes), I64) as (x, _):
            vectors.store_first(builder.sub(count, x))(zero, vectors.shifted(address, (1, x)))
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, like), codegen


@intrinsic
def any_below(typingctx, coefficient, values, limit, n, count, step):  # type: ignore[no-untyped-def]
    """Whether a node with a coefficient of at most 0 may have a value below `limit`, on `count` rows of `n` nodes that lie `step` elements apart.

    Takes byte addresses of the first node, and looks at whole vectors: up to 7 nodes beyond the end of a row count, too.
    """

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        coefficient, values, limit, n, count, step = args
        vectors = Vectors(builder, limit.type, 8)
        limits, zero = vectors.splat(limit), ir.Constant(vectors.type, [0.0] * vectors.lanes)
        found = cgutils.alloca_once_value(builder, ir.Constant(ir.VectorType(ir.IntType(1), vectors.lanes), [0] * vectors.lanes))
        with cgutils.for_range(builder, count) as rows, cgutils.for_range_slice(builder, I64(0), n, I64(vectors.lanes), I64) as (x, _):
            hard, value = (vectors.load(vectors.shifted(start, (1, x), (1, builder.mul(rows.index, step)))) for start in (coefficient, values))
            low = builder.and_(builder.fcmp_ordered("<=", hard, zero), builder.fcmp_ordered("<", value, limits))
            builder.store(builder.or_(builder.load(found), low), found)
        mask = builder.bitcast(builder.load(found), ir.IntType(vectors.lanes))
        return builder.icmp_unsigned("!=", mask, ir.Constant(mask.type, 0))

    return types.boolean(types.int64, types.int64, limit, *[types.int64] * 3), codegen


def stretch_chain(lines: int, remember: bool) -> Any:
    """Make the intrinsic that continues a bundle of lines by one offset along a chain of columns.

    ``stretch(near, diagonal, here, far, step, memory, r, e, f, turn, n, count, like)``: at each of `n` columns, `step` bytes apart,
    ``d = here - diagonal; far = near + r*d - memory; memory = e*memory + f*d`` on the first `count` of `lines` values side by
    side (without the memory unless `remember`), where `near` and `diagonal` are `here` and `far` of the column before.

    All but `turn` (+1 or -1: direction in which the tables r, e, f are read), `n`, `count` and `like` (a number of the wanted
    precision) are byte addresses; n > 0. Reads up to `lines` values from each address, writes `count`. A whole bundle has plain
    stores: what a masked store wrote cannot be read back before it has reached the cache.
    """

    def chain(builder: ir.IRBuilder, args: tuple[Any, ...], vectors: Vectors, stores: list[Any]) -> None:
        near, diagonal, here, far, step, memory, r, e, f, turn, n, _, like = args
        parts = range(len(stores))

        def at(address: Any, part: int) -> Any:
            return builder.add(address, I64(part * vectors.lanes * vectors.size))

        start = [vectors.load(at(address, part)) for address in (near, diagonal) for part in parts]
        before, body, after = builder.block, builder.append_basic_block("columns"), builder.append_basic_block("done")
        builder.branch(body)
        builder.position_at_end(body)
        column = builder.phi(I64)
        carried = [builder.phi(vectors.type) for _ in start]
        for phi, first in zip([column, *carried], [I64(0), *start], strict=True):
            phi.add_incoming(first, before)
        move, turned = builder.mul(column, step), builder.mul(builder.mul(column, turn), I64(vectors.size))
        kept = builder.add(memory, builder.mul(column, I64(lines * vectors.size)))
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
        following = builder.add(column, I64(1))
        for phi, value in zip([column, *carried], [following, *heres, *news], strict=True):
            phi.add_incoming(value, builder.block)
        builder.cbranch(builder.icmp_signed("<", following, n), body, after)
        builder.position_at_end(after)

    @intrinsic
    def stretch(typingctx, near, diagonal, here, far, step, memory, r, e, f, turn, n, count, like):  # type: ignore[no-untyped-def]
        def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
            count, like = args[-2:]
            full = 8 if isinstance(like.type, ir.DoubleType) else 16
            one, many = Vectors(builder, like.type, 1), Vectors(builder, like.type, full)
            with builder.if_else(builder.icmp_signed("==", count, I64(lines))) as (whole, part):
                with whole:
                    chain(builder, args, many, [many.store] * (lines // full))
                with part, builder.if_else(builder.icmp_signed("==", count, I64(1))) as (single, several):
                    with single:
                        chain(builder, args, one, [one.store])
                    with several:
                        chain(builder, args, many, [many.store_first(builder.sub(count, I64(first))) for first in range(0, lines, full)])
            return context.get_dummy_value()

        return types.void(*[types.int64] * 12, like), codegen

    return stretch

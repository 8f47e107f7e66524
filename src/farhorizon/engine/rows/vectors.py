"""Explicit SIMD: Numba intrinsics that emit vector instructions.

Numba's vectoriser loses most of the speed on loops of this kind, so the vector instructions are emitted here. Products
carry only the ``contract`` flag: a fixed order of summation makes results deterministic and needs few registers.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from farhorizon.engine.rows.calls import call_of

#: (outer offset 0, outer offset 1, inner offset >= 0); every inner offset stands for both signs.
Shape = tuple[tuple[int, int, int], ...]

CONTRACT = ("contract",)
I64 = ir.IntType(64)
I32 = ir.IntType(32)
_FIRST_CACHE = 41_000  # bytes of the first-level cache that a tile may take
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
        """Vector with the same value in every lane."""
        kind = ir.VectorType(value.type, self.lanes)
        first = self.builder.insert_element(ir.Constant(kind, ir.Undefined), value, I32(0))
        return self.builder.shuffle_vector(
            first, ir.Constant(kind, ir.Undefined), ir.Constant(ir.VectorType(I32, self.lanes), [0] * self.lanes)
        )

    def splat_all(self, address: Any, count: int) -> list[Any]:
        """Vectors of `count` values at an address, each with one of the values in every lane."""
        return [
            self.splat(self.builder.load(self.pointer(self.builder.add(address, I64(i * self.size)), self.scalar)))
            for i in range(count)
        ]

    def shifted(self, address: Any, *moves: tuple[int, Any]) -> Any:
        """An address moved by count * distance elements for each (count, distance)."""
        for count, distance in moves:
            address = self.builder.add(address, self.builder.mul(I64(count * self.size), distance))
        return address

    def concatenate(self, low: Any, high: Any, first: int) -> Any:
        """The lanes from `first` on of two vectors placed one after the other."""
        return self.builder.shuffle_vector(
            low, high, ir.Constant(ir.VectorType(I32, self.lanes), list(range(first, first + self.lanes)))
        )

    def prefetch(self, address: Any) -> None:
        """Prefetch the cache line of an address, which need not exist."""
        kind = ir.IntType(8).as_pointer()
        fetch = cgutils.get_or_insert_function(
            self.builder.module, ir.FunctionType(ir.VoidType(), [kind, I32, I32, I32]), "llvm.prefetch.p0i8"
        )
        self.builder.call(fetch, [self.pointer(address, ir.IntType(8)), I32(0), I32(3), I32(1)])

    def sum(self, terms: Sequence[Any]) -> Any:
        """Sum of the terms, added from left to right."""
        return functools.reduce(self.builder.fadd, terms)

    def pointer(self, address: Any, kind: ir.Type | None = None) -> Any:
        """Typed pointer from an address."""
        return self.builder.inttoptr(address, (kind or self.type).as_pointer())

    def load(self, address: Any) -> Any:
        """Load a vector from an address aligned to one element."""
        value = self.builder.load(self.pointer(address))
        value.align = self.size
        return value

    def store(self, value: Any, address: Any) -> None:
        """Store a vector at an address aligned to one element."""
        self.builder.store(value, self.pointer(address)).align = self.size

    def store_first(self, count: Any) -> Callable[[Any, Any], None]:
        """Function that stores only the first `count` lanes."""
        numbers = ir.VectorType(I64, self.lanes)
        mask = self.builder.icmp_signed("<", ir.Constant(numbers, list(range(self.lanes))), self.splat(count))
        parts = [self.type, self.type.as_pointer(), I32, ir.VectorType(ir.IntType(1), self.lanes)]
        suffix = f"v{self.lanes}f{self.size * 8}"
        masked = cgutils.get_or_insert_function(
            self.builder.module, ir.FunctionType(ir.VoidType(), parts), f"llvm.masked.store.{suffix}.p0{suffix}"
        )
        return lambda value, address: self.builder.call(masked, [value, self.pointer(address), I32(self.size), mask])

    def in_chunks(self, count: Any, chunk: Callable[..., None], *others: Vectors) -> None:
        """Call ``chunk(x, store)`` for every whole vector of `count` values and for the remainder; for `others`, types
        with as many lanes, their stores are passed as well.
        """
        rest, every = self.builder.srem(count, I64(self.lanes)), (self, *others)
        whole = self.builder.sub(count, rest)
        with cgutils.for_range_slice(self.builder, I64(0), whole, I64(self.lanes), I64) as (x, _):
            chunk(x, *(one.store for one in every))
        with self.builder.if_then(self.builder.icmp_signed(">", rest, I64(0))):
            chunk(whole, *(one.store_first(rest) for one in every))

    def loop(
        self, first: Any, last: Any, step: int, start: Sequence[Any], body: Callable[[Any, list[Any]], list[Any]]
    ) -> tuple[Any, list[Any]]:
        """Repeat ``values = body(i, values)`` from `start` for i = first, first + step, ... while `step` numbers are
        left before `last`; return the next i and the values.
        """
        builder = self.builder
        before, test, inside, after = (
            builder.block,
            *(builder.append_basic_block(name) for name in ("test", "turn", "done")),
        )
        builder.branch(test)
        builder.position_at_end(test)
        i, *values = (builder.phi(value.type) for value in (first, *start))
        for phi, value in zip([i, *values], [first, *start], strict=True):
            phi.add_incoming(value, before)
        following = builder.add(i, I64(step))
        builder.cbranch(builder.icmp_signed("<=", following, last), inside, after)
        builder.position_at_end(inside)
        for phi, value in zip([i, *values], [following, *body(i, values)], strict=True):
            phi.add_incoming(value, builder.block)
        builder.branch(test)
        builder.position_at_end(after)
        return i, values

    def multiply_add(self, total: Any, factor: Any, term: Any) -> Any:
        """``total + factor * term``; only the product if there is no total."""
        product = self.builder.fmul(factor, term, flags=CONTRACT)
        return product if total is None else self.builder.fadd(total, product, flags=CONTRACT)


def int64s(count: int) -> Any:
    """Numba type of a tuple of `count` addresses or distances."""
    return types.UniTuple(types.int64, count)


def flat(builder: ir.IRBuilder, args: Sequence[Any]) -> tuple[Any, ...]:
    """Values one by one, where some come in tuples."""
    grouped = [cgutils.unpack_tuple(builder, arg) if isinstance(arg.type, ir.ArrayType) else [arg] for arg in args]
    return tuple(value for group in grouped for value in group)


def line_sweep(shape: Shape, classes: tuple[int, ...], real: str) -> Any:
    """Make the intrinsic ``sweep(src, base, out, weights, a, b, n, count, s0, s1, s2, step, t, shifts)`` for rows of
    neighbours in memory.

    It writes ``out = a*src + b*base + sum_k w_k (src_{+k} + src_{-k})`` on `count` rows of `n` nodes. Sums over the
    outer axes come first: ``T_i = sum_o w_(o,i) src_o``, where lines of equal weights are added before they are
    multiplied. What remains is ``T_0`` and the ``T_i`` moved by +i and -i along the row: two neighbouring vectors, one
    shuffle each. So every line is read once, aligned, and a vector costs few more instructions than it has different
    weights.

    Long rows are swept in tiles whose lines stay in the first-level cache from one row to the next. What the row after
    next needs is prefetched: a tile is too short for the hardware prefetcher.

    Parameters
    ----------
    shape : tuple of (int, int, int)
        Stencil offsets without the centre, inner offset >= 0 (an inner offset i > 0 stands for +i and -i), at most one
        vector.
    classes : tuple of int
        Number of each offset's weight: offsets with the same weight share a register.
    real : {"float64", "float32"}

    Returns
    -------
    numba intrinsic
        Takes byte addresses (int64) of the first node in each array and of the weights (one per class), the numbers a
        and b, the nodes of a row, the rows, the distances between neighbours along the three axes of ``src`` (s2 is 1)
        and between rows of ``src`` and of ``base`` and ``out``, in elements. Reads up to one vector before and beyond a
        row, writes none.
    """
    terms_of: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for number, (o0, o1, i) in zip(classes, shape, strict=True):
        terms_of.setdefault((o0, o1), []).append((i, number))
    alike: dict[tuple[tuple[int, int], ...], list[tuple[int, int]]] = {}
    for line, terms in terms_of.items():
        alike.setdefault(tuple(sorted(terms)), []).append(line)
    inner = sorted({i for _, _, i in shape})
    moved = [i for i in inner if i]
    # the line of each plane that the next row reads first
    last = {o0: max(o1 for other, o1 in terms_of if other == o0) for o0, _ in terms_of}

    def emit(builder: ir.IRBuilder, args: tuple[Any, ...]) -> None:
        weights, s0, s1, step, t = args[3], args[8], args[9], args[11], args[12]
        vectors = Vectors.of(builder, real)
        w = vectors.splat_all(weights, max(classes) + 1)

        def prepare(here: Any, old: Any, new: Any) -> VectorRow:
            lines = {line: vectors.shifted(here, (line[0], s0), (line[1], s1)) for line in terms_of}
            ahead = [vectors.shifted(here, (o0, s0), (o1, s1), (AHEAD, step)) for o0, o1 in last.items()] + [
                vectors.shifted(old, (AHEAD, t))
            ]

            def sums(at: Any) -> dict[int, Any]:
                """Sums T_i of one vector."""
                total: dict[int, Any] = dict.fromkeys([0, *inner])
                for terms, equal in alike.items():
                    together = vectors.sum([vectors.load(builder.add(lines[line], at)) for line in equal])
                    for i, number in terms:
                        total[i] = vectors.multiply_add(total[i], w[number], together)
                return total

            return VectorRow(sums, [Output(0, [(i, i, i) for i in moved], (here, old), new)], ahead)

        sweep_lines(vectors, args, tile_nodes(len(terms_of), vectors.size), prepare)

    return sweep_intrinsic(emit, real)


@dataclass(frozen=True)
class Output:
    """One field of a row: the addresses of its first node, and the sums of a vector that it gets.

    Attributes
    ----------
    centre : hashable
        Name of the sum that is not moved.
    moved : list of (i, ahead, behind)
        The sum `ahead` comes from i nodes further on along the row, the sum `behind` from i nodes back.
    before : sequence of address
        Addresses in ``src`` and ``base``, whose values are added with their factors; none where only the sums are
        written, ``out`` alone where they are added to its values.
    new : address
        In ``out``.
    """

    centre: Hashable
    moved: Sequence[tuple[int, Hashable, Hashable]]
    before: Sequence[Any]
    new: Any


@dataclass(frozen=True)
class VectorRow:
    """A row of nodes: the sums of the vector at a distance from its first node, by name (None for an empty sum); its
    fields; and what to prefetch.
    """

    sums: Callable[[Any], Mapping[Any, Any]]
    outputs: Sequence[Output]
    ahead: Sequence[Any]


def with_own(vectors: Vectors, total: Any, values: Sequence[Any], factors: tuple[Any, Any]) -> Any:
    """A sum plus ``a*src + b*base`` of a node, plus the value of ``out``, or alone, see `Output`."""
    if len(values) == 2:
        (own, old), (a, b) = values, factors
        return vectors.multiply_add(vectors.multiply_add(total, b, old), a, own)
    return vectors.sum([*values, total])


def sweep_lines(
    vectors: Vectors, args: tuple[Any, ...], length_of_tile: int, prepare: Callable[[Any, Any, Any], VectorRow]
) -> None:
    """Emit the loops of a sweep of rows whose nodes are neighbours in memory, tile by tile.

    Parameters
    ----------
    vectors : Vectors
    args : tuple
        Arguments of the sweep (see `line_sweep`).
    length_of_tile : int
    prepare : callable
        Makes the `VectorRow` that begins at given addresses in ``src``, ``base`` and ``out``.
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
            """What the vector `now` gets from itself and from the one before."""
            parts = [now[output.centre]] if now[output.centre] is not None else []
            return vectors.sum(
                parts + [vectors.concatenate(before[name], now[name], vectors.lanes - i) for i, _, name in output.moved]
            )

        def finish(
            x: Any, totals: Sequence[Any], now: Mapping[Any, Any], store: Callable[[Any, Any], None]
        ) -> tuple[Mapping[Any, Any], list[Any]]:
            """Write one vector; return the sums of the next vector and the totals begun for it."""
            at = builder.mul(x, I64(size))
            for address in made.ahead:
                vectors.prefetch(builder.add(address, at))
            following = made.sums(builder.add(at, I64(vectors.lanes * size)))
            for output, begun in zip(made.outputs, totals, strict=True):
                total = vectors.sum(
                    [begun] + [vectors.concatenate(now[name], following[name], i) for i, name, _ in output.moved]
                )
                values = [vectors.load(builder.add(place, at)) for place in output.before]
                store(with_own(vectors, total, values, (a_all, b_all)), builder.add(output.new, at))
            return following, [from_before(output, now, following) for output in made.outputs]

        first = made.sums(I64(0))
        before_first = made.sums(I64(-vectors.lanes * size))
        start = [
            I64(0),
            *(from_before(output, before_first, first) for output in made.outputs),
            *(first[name] for name in names),
        ]
        rest = builder.srem(length, width)
        whole = builder.sub(length, rest)
        before, test, body, after = (
            builder.block,
            *(builder.append_basic_block(name) for name in ("test", "vector", "rest")),
        )
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
    """Make the intrinsic of `line_sweep` for rows whose neighbours may lie any distance s2 apart; every neighbour is
    read separately.

    With ``increments`` the sum runs over differences, which avoids cancellation, and ``base`` is advanced in place:
    ``base = a*src + b*base + sum_k w_k (src_{+k} + src_{-k} - 2 src)`` and ``out = src + base``.
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
            places = {
                o: vectors.shifted(here, *zip(o, (s0, s1, s2), strict=True))
                for equal in members.values()
                for o in equal
            }

            def chunk(x: Any, store: Callable[[Any, Any], None]) -> None:
                at = builder.mul(x, I64(vectors.size))
                own = vectors.load(builder.add(here, at))
                total = None
                for number, equal in members.items():
                    values = [vectors.load(builder.add(places[o], at)) for o in equal]
                    total = vectors.multiply_add(
                        total, w[number], vectors.sum([builder.fsub(v, own) for v in values] if increments else values)
                    )
                total = vectors.multiply_add(total, b_all, vectors.load(builder.add(old, at)))
                total = vectors.multiply_add(total, a_all, own)
                if increments:
                    store(total, builder.add(old, at))
                    total = builder.fadd(own, total)
                store(total, builder.add(new, at))

            vectors.in_chunks(n, chunk)

        with cgutils.for_range_slice(builder, I64(0), count, I64(1), I64) as (number, _):
            row(number)

    return sweep_intrinsic(emit, real)


def tile_nodes(lines: int, size: int) -> int:
    """Nodes of a row to sweep at a time so that all lines read and written stay in the first-level cache. Rows with too
    many lines for that are swept whole.
    """
    fitting = _FIRST_CACHE // ((lines + 3) * size) // 64 * 64
    return fitting if fitting * size >= 2048 else 1 << 30


def sweep_intrinsic(emit: Callable[[ir.IRBuilder, tuple[Any, ...]], None], real: str) -> Any:
    @intrinsic
    def sweep(typingctx, levels, weights, a, b, extent, strides, apart, shifts):
        def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
            emit(builder, flat(builder, args))
            return context.get_dummy_value()

        return sweep_signature(real), codegen

    return sweep


def sweep_signature(real: str) -> Any:
    """Numba signature of a sweep."""
    return types.void(*_sweep_types(getattr(types, real)))


def _sweep_types(number: Any) -> list[Any]:
    """Types of (src, base, out), weights, a, b, (nodes, rows), three strides, distances of rows, and shifts."""
    return [int64s(3), types.int64, number, number, int64s(2), int64s(3), int64s(2), types.int64]


@intrinsic
def call_sweep(typingctx, function, levels, weights, a, b, extent, strides, apart, shifts):
    """Call a compiled sweep by its address, so that the driver need not be compiled again for every stencil."""
    return call_of(_sweep_types(a))


#: Nodes of a row, and rows, that `sweep_phases` takes at a time: one vector per row, so that all sums of a tile stay in
#: registers.
TILE, TILE_ROWS = 8, 4


@intrinsic
def sweep_phases(typingctx, at, stencil, factors, extent, apart):
    """``out = a*src + b*base + sum over the bonds`` on up to `TILE_ROWS` rows of `n` nodes, where bonds differ by the
    phases of their ends.

    Takes (src, coefficient, base, out), (distances, weights, bonds), (a, b, interface, ceiling), (n, count) and (step,
    t): byte addresses of the first node in each array, of the distances (int64) to the neighbours and of their weights;
    numbers, where `interface` is the factor of bonds between the phases; counts; and the distances between rows in
    elements, `step` in src and coefficient, t in base and out. A coefficient above 0 marks the liquid. A liquid node
    gains ``w (u' - u)`` from each liquid neighbour, and a node gains ``interface w (c' - c)`` from each neighbour of
    the other phase, c the lesser of u and `ceiling`, so that nothing flows between solid nodes. Rows that do not exist
    repeat the last one: their sums cost less than a loop of another length. Reads up to 8 nodes beyond the end of a
    row, and writes none there.
    """

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        src, coefficient, base, out, offsets, weights, bonds, *reals, n, count, step, t = flat(builder, args)
        a, b, interface, ceiling = reals
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
            return builder.select(builder.fcmp_ordered(">", value, most), most, value)  # NaN stays NaN

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
            weight = vectors.splat(
                builder.load(vectors.pointer(builder.add(weights, builder.mul(bond, I64(size))), vectors.scalar))
            )
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
            # before any store: rows may be repeated, and base may be out
            olds = [vectors.load(builder.add(base, place)) for place in places]
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

    return types.void(int64s(4), int64s(3), types.UniTuple(factors[0], 4), int64s(2), int64s(2)), codegen


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
        whole = builder.sub(count, rest)
        with cgutils.for_range_slice(builder, I64(0), whole, pair, I64) as (x, _):
            add_columns(x, 2)
        with builder.if_then(builder.icmp_signed(">", rest, I64(0))):
            add_columns(whole, 1)
        found, half = builder.load(total), vectors.lanes // 2
        while half:
            places = [[(lane + shift) % vectors.lanes for lane in range(vectors.lanes)] for shift in (0, half)]
            parts = [
                builder.shuffle_vector(found, found, ir.Constant(ir.VectorType(I32, vectors.lanes), p)) for p in places
            ]
            found, half = builder.fadd(*parts), half // 2
        return builder.extract_element(found, I32(0))

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
        found = cgutils.alloca_once_value(
            builder, ir.Constant(ir.VectorType(ir.IntType(1), vectors.lanes), [0] * vectors.lanes)
        )
        with (
            cgutils.for_range(builder, count) as rows,
            cgutils.for_range_slice(builder, I64(0), n, I64(vectors.lanes), I64) as (x, _),
        ):
            hard, value = (
                vectors.load(vectors.shifted(start, (1, x), (1, builder.mul(rows.index, step))))
                for start in (coefficient, values)
            )
            low = builder.and_(builder.fcmp_ordered("<=", hard, zero), builder.fcmp_ordered("<", value, limits))
            builder.store(builder.or_(builder.load(found), low), found)
        mask = builder.bitcast(builder.load(found), ir.IntType(vectors.lanes))
        return builder.icmp_unsigned("!=", mask, ir.Constant(mask.type, 0))

    return types.boolean(types.int64, types.int64, limit, *[types.int64] * 3), codegen


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
                mine, turns = totals[: used * many], max(1, _IN_FLIGHT // used)
                term = limits[group]
                if turns > 1:

                    def several(term: Any, sums: list[Any], used: int = used, turns: int = turns) -> list[Any]:
                        size = used * many
                        return [
                            v
                            for t in range(turns)
                            for v in grown(builder.add(term, I64(t)), at, used, many, sums[t * size : (t + 1) * size])
                        ]

                    term, sums = vectors.loop(term, last, turns, [*mine, *[zero] * ((turns - 1) * len(mine))], several)
                    mine = [vectors.sum(sums[i :: used * many]) for i in range(used * many)]

                def single(term: Any, sums: list[Any], used: int = used) -> list[Any]:
                    return grown(term, at, used, many, sums)

                _, mine = vectors.loop(term, last, 1, mine, single)
                totals[: used * many] = mine
            for i, total in enumerate(totals):
                vectors.store(total, place(i // many, at, i % many))

        many, done = 4 if parts <= 5 else 2, I64(0)
        while many:
            end = builder.mul(builder.sdiv(number, I64(many)), I64(many * width))
            with cgutils.for_range_slice(builder, done, end, I64(many * width), I64) as (at, _):
                block(at, many)
            done, many = end, many // 2

    @intrinsic
    def sums(typingctx, to, source, tables, vectors, least, more):
        def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
            emit(builder, flat(builder, args))
            return context.get_dummy_value()

        return PARTS_SIGNATURE, codegen

    return sums


_PARTS = int64s(2), int64s(2), int64s(5), types.int64, types.int64, types.int64
PARTS_SIGNATURE = types.void(*_PARTS)


@intrinsic
def call_parts(typingctx, function, to, source, tables, vectors, least, more):
    """Call compiled `weighted_parts` by their address."""
    return call_of(_PARTS)


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
            there = builder.add(to, at)
            store(vectors.multiply_add(vectors.load(there), factor, vectors.load(builder.add(source, at))), there)

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
def weigh_change(typingctx, to, level, before, share, strengths, count):
    """``to = strengths * (level - share * before)`` on `count` neighbouring values, by byte addresses."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        to, level, before, share, strengths, count = args
        vectors = Vectors.of(builder, str(signature.args[3]))
        factor = vectors.splat(builder.fneg(share))

        def chunk(x: Any, store: Callable[[Any, Any], None]) -> None:
            at = builder.mul(x, I64(vectors.size))
            change = vectors.multiply_add(
                vectors.load(builder.add(level, at)), factor, vectors.load(builder.add(before, at))
            )
            store(builder.fmul(vectors.load(builder.add(strengths, at)), change), builder.add(to, at))

        vectors.in_chunks(count, chunk)
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64, share, types.int64, types.int64), codegen


@intrinsic
def move_masses(typingctx, states, levels, strengths, keep, pull, share, count, kept):
    """Move the masses that hang on `count` neighbouring nodes, and let them pull these; see `engine.dampers`.

    Parameters
    ----------
    states : tuple of int
        Byte addresses of the nodes' last increments, of p and of q.
    levels : tuple of int
        Byte addresses of the level that the increment is in, of the one that is subtracted from it, and of the levels
        to add to: another one, 0 for none, and ``out``.
    strengths : int
    keep, pull : float
    share : float
        Factor with which the second level is subtracted, 0 or 1.
    count : int
    kept : float or int
        Value of the states' type: that of the levels, or int32 for the first halves of their numbers, see
        `rows.shifts.Remembered`. Those are rounded to nearest, unlike the layers' memory: under a permanent load the
        layers would stop following the field, but dampers come to rest.
    """

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        last, p, q, level, before, other, out, strengths, keep, pull, share, count, _ = flat(builder, args)
        vectors = Vectors.of(builder, str(signature.args[3]))
        narrow = Vectors(builder, ir.FloatType(), vectors.lanes)
        halves = str(signature.args[7]) == "int32"
        long, short = (ir.VectorType(one, vectors.lanes) for one in (I64, I32))
        places, rounding = (ir.Constant(long, [one] * vectors.lanes) for one in (32, 1 << 31))
        kept, pulled, less = (vectors.splat(one) for one in (keep, builder.fneg(pull), builder.fneg(share)))

        def chunk(x: Any, store: Callable[[Any, Any], None], store_half: Callable[[Any, Any], None]) -> None:
            at = builder.mul(x, I64(vectors.size))

            def there(address: Any) -> Any:
                return builder.add(address, at)

            def half(address: Any) -> Any:
                return builder.add(address, builder.mul(x, I64(narrow.size)))

            def recalled(address: Any) -> Any:
                if not halves:
                    return vectors.load(there(address))
                bits = builder.zext(builder.bitcast(narrow.load(half(address)), short), long)
                return builder.bitcast(builder.shl(bits, places), vectors.type)

            def keep_state(value: Any, address: Any) -> None:
                if not halves:
                    store(value, there(address))
                    return
                bits = builder.lshr(builder.add(builder.bitcast(value, long), rounding), places)
                store_half(builder.bitcast(builder.trunc(bits, short), narrow.type), half(address))

            increment = vectors.multiply_add(vectors.load(there(level)), less, vectors.load(there(before)))
            place, pace = recalled(p), recalled(q)
            moved = builder.fsub(increment, recalled(last))
            moved = vectors.multiply_add(vectors.multiply_add(moved, kept, pace), pulled, place)
            gained = builder.fmul(vectors.load(there(strengths)), builder.fsub(moved, pace))
            keep_state(builder.fadd(increment, gained), last)
            keep_state(builder.fadd(place, moved), p)
            keep_state(moved, q)
            store(builder.fadd(vectors.load(there(out)), gained), there(out))
            with builder.if_then(builder.icmp_signed("!=", other, I64(0))):
                store(builder.fadd(vectors.load(there(other)), gained), there(other))

        vectors.in_chunks(count, chunk, narrow)
        return context.get_dummy_value()

    addresses = types.UniTuple(types.int64, 3), types.UniTuple(types.int64, 4)
    return types.void(*addresses, types.int64, keep, keep, keep, types.int64, kept), codegen


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

    Parameters
    ----------
    runs, number : int
        Address of the first run, see `engine.filter.Filter.runs`, and the number of runs, at least 1.
    arrays : (int, int, int)
        Byte addresses of the box, the strengths and the level.
    steps, axes : int
        Address of the distances in the box between neighbours along the axes (int64, in elements), and their number.
    taps : int
        Address of the filter's weights, of a value itself and of the neighbours on both sides.
    older : int
        Distance in bytes from the level to another one from which the same is subtracted; 0 if there is none.
    like : float
        Value of the arrays' type.
    """

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        runs, number, box, strengths, level, steps, axes, taps, older, _ = flat(builder, args)
        vectors = Vectors.of(builder, str(signature.args[7]))
        lanes, zero, one = I64(vectors.lanes), I64(0), I64(1)

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
                there = builder.icmp_signed("<", I64(i), number)
                row = builder.add(runs, builder.mul(builder.select(there, I64(i), zero), I64(8 * (4 + axes))))
                for found, start, column in zip(places, (box, level, strengths), range(3), strict=True):
                    found.append(builder.add(start, bytes_of(entry(row, column))))
                rows.append(
                    [builder.select(there, entry(row, 3), zero), *(entry(row, 4 + axis) for axis in range(axes))]
                )
            heres, targets, weights = places
            columns = list(zip(*rows, strict=True))
            counts, longest, *limits = columns[0], *(functools.reduce(most, column) for column in columns)
            shortest = functools.reduce(least, counts)
            whole = builder.sub(shortest, builder.srem(shortest, lanes))

            def passed(at: Any) -> list[Any]:
                """What the filter passes of one vector of each run."""
                centres, found = [vectors.load(builder.add(here, at)) for here in heres], []
                for axis, limit in enumerate(limits):
                    step = bytes_of(entry(steps, axis))
                    start = [builder.fmul(tap(zero), centre) for centre in centres]
                    found.append(summed(start, [builder.add(here, at) for here in heres], step, limit))
                return [vectors.sum(parts) for parts in zip(*found, strict=True)]

            def take(x: Any, stores: list[Callable[[Any, Any], None]]) -> None:
                at = bytes_of(x)
                for total, weight, target, store in zip(passed(at), weights, targets, stores, strict=True):
                    taken, new = builder.fmul(vectors.load(builder.add(weight, at)), total), builder.add(target, at)
                    store(builder.fsub(vectors.load(new), taken), new)
                    with builder.if_then(builder.icmp_signed("!=", older, zero)):
                        old = builder.add(new, older)
                        store(builder.fsub(vectors.load(old), taken), old)

            with cgutils.for_range_slice(builder, zero, whole, lanes, I64) as (x, _):
                take(x, [vectors.store] * TOGETHER)
            with cgutils.for_range_slice(builder, whole, longest, lanes, I64) as (x, _):
                take(x, [vectors.store_first(builder.sub(count, x)) for count in counts])

        def summed(start: list[Any], heres: list[Any], step: Any, limit: Any) -> list[Any]:
            """Sums along one axis, over up to `limit` neighbours on both sides."""

            def grown(k: Any, totals: list[Any]) -> list[Any]:
                weight, far, found = tap(k), builder.mul(k, step), []
                for total, here in zip(totals, heres, strict=True):
                    both = builder.fadd(vectors.load(builder.add(here, far)), vectors.load(builder.sub(here, far)))
                    found.append(vectors.multiply_add(total, weight, both))
                return found

            return vectors.loop(one, builder.add(limit, one), 1, start, grown)[1]

        for dim in (1, 2, 3):
            with builder.if_then(builder.icmp_signed("==", axes, I64(dim))):
                along(dim)
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, int64s(3), *[types.int64] * 4, like), codegen

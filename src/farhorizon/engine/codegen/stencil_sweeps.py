"""Explicit SIMD: sweeps of rows of nodes by stencils whose weights are numbers, and by bonds between phases."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from farhorizon.engine.codegen.calls import call_of
from farhorizon.engine.codegen.numba_internals import cgutils
from farhorizon.engine.codegen.vectors import I64, LANES, Vectors, flat, int64s

#: (outer offset 0, outer offset 1, inner offset >= 0); every inner offset stands for both signs.
Shape = tuple[tuple[int, int, int], ...]
#: What emits the code of a function from its arguments, one by one.
Emit = Callable[[ir.IRBuilder, tuple[Any, ...]], None]

_FIRST_CACHE = 41_000  # bytes of the first-level cache that a tile may take
_LEAST_TILE = 2048  # bytes of a line of a tile below which tiles do not pay
AHEAD = 2  # rows between use and prefetch: one lasts less than a fetch from memory


def stencil_sweep(shape: Shape, classes: tuple[int, ...], real: str, increments: bool) -> Any:
    """Make the intrinsic that writes ``out = a*src + b*base + sum_k w_k (src_{+k} + src_{-k})`` on some rows of nodes.

    `shape` has no centre; `classes` number the weights: offsets with the same weight share a register. With
    `increments` the sum runs over differences, which avoids cancellation, and ``base`` is advanced in place: ``base =
    a*src + b*base + sum_k w_k (src_{+k} + src_{-k} - 2 src)`` and ``out = src + base``.

    The intrinsic takes byte addresses of the first node in (src, base, out), and of the weights, one per class; a and
    b; (nodes of a row, rows); in elements, distances (s0, s1, s2) between neighbours along the axes of ``src``, and
    (step, t) between rows of ``src`` and of ``base`` and ``out``; and an address that it does not use. It reads up to
    one vector before and beyond a row, and writes none there.
    """
    lines = _line_sweep(shape, classes, real) if fits_lines(shape, real) and not increments else None
    return sweep_intrinsic(lines, _strided_sweep(shape, classes, real, increments), real)


def fits_lines(shape: Shape, real: str) -> bool:
    """Whether the inner offsets are at most one vector, as sweeps along lines require."""
    return max(i for _, _, i in shape) <= LANES[real]


def _line_sweep(shape: Shape, classes: tuple[int, ...], real: str) -> Emit:
    """Make the code of `stencil_sweep` for rows of neighbours in memory (s2 is 1).

    Sums over the outer axes come first: ``T_i = sum_o w_(o,i) src_o``, where lines of equal weights are added before
    they are multiplied. What remains is ``T_0`` and the ``T_i`` moved by +i and -i along the row: two neighbouring
    vectors, one shuffle each. So every line is read once, aligned, and a vector costs few more instructions than it has
    different weights.

    Long rows are swept in tiles whose lines stay in the first-level cache from one row to the next. What the row after
    next needs is prefetched: a tile is too short for the hardware prefetcher.
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
    last = {o0: max(o1 for plane, o1 in terms_of if plane == o0) for o0, _ in terms_of}

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

    return emit


@dataclass(frozen=True)
class Output:
    """One field of a row: the sums of a vector that it gets, by name, and the addresses of its first node."""

    centre: Hashable  # the sum that is not moved
    #: (i, ahead, behind): the sum `ahead` comes from i nodes further on in the row, the sum `behind` from i nodes back
    moved: Sequence[tuple[int, Hashable, Hashable]]
    #: in ``src`` and ``base``, whose values are added with their factors; none where only the sums are written, ``out``
    #: alone where they are added to its values
    before: Sequence[Any]
    new: Any  # in ``out``


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
    """Emit the loops of a sweep of rows whose nodes are neighbours in memory, tile by tile; `args` are those of
    `stencil_sweep`, and ``prepare(src, base, out)`` makes the `VectorRow` that begins at these addresses.
    """
    builder = vectors.builder
    src, base, out, _, a, b, n, count, _, _, _, step, t, _ = args
    size, width = vectors.size, I64(vectors.lanes)
    a_all, b_all = vectors.splat(a), vectors.splat(b)
    tile = I64(length_of_tile)

    def row(x0: Any, length: Any, number: Any) -> None:
        here = vectors.shifted(src, (1, x0), (1, builder.mul(number, step)))
        old, new = (vectors.shifted(start, (1, x0), (1, builder.mul(number, t))) for start in (base, out))
        prepared = prepare(here, old, new)
        names = list(dict.fromkeys(name for o in prepared.outputs for _, *both in o.moved for name in both))

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
            for address in prepared.ahead:
                vectors.prefetch(builder.add(address, at))
            following = prepared.sums(builder.add(at, I64(vectors.lanes * size)))
            for output, begun in zip(prepared.outputs, totals, strict=True):
                total = vectors.sum(
                    [begun] + [vectors.concatenate(now[name], following[name], i) for i, name, _ in output.moved]
                )
                values = [vectors.load(builder.add(place, at)) for place in output.before]
                store(with_own(vectors, total, values, (a_all, b_all)), builder.add(output.new, at))
            return following, [from_before(output, now, following) for output in prepared.outputs]

        first = prepared.sums(I64(0))
        before_first = prepared.sums(I64(-vectors.lanes * size))
        start = [
            I64(0),
            *(from_before(output, before_first, first) for output in prepared.outputs),
            *(first[name] for name in names),
        ]
        rest = builder.srem(length, width)
        full = builder.sub(length, rest)
        before, test, body, after = (
            builder.block,
            *(builder.append_basic_block(name) for name in ("test", "vector", "rest")),
        )
        builder.branch(test)
        builder.position_at_end(test)
        carried = [builder.phi(value.type) for value in start]
        x, totals, sums_now = carried[0], carried[1 : 1 + len(prepared.outputs)], carried[1 + len(prepared.outputs) :]
        now = dict(zip(names, sums_now, strict=True))
        builder.cbranch(builder.icmp_signed("<", x, full), body, after)
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


def _strided_sweep(shape: Shape, classes: tuple[int, ...], real: str, increments: bool) -> Emit:
    """Make the code of `stencil_sweep` for rows whose neighbours may lie any distance s2 apart: every neighbour is read
    separately.
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
                    terms = [builder.fsub(v, own) for v in values] if increments else values
                    total = vectors.multiply_add(total, w[number], vectors.sum(terms))
                total = vectors.multiply_add(total, b_all, vectors.load(builder.add(old, at)))
                total = vectors.multiply_add(total, a_all, own)
                if increments:
                    store(total, builder.add(old, at))
                    total = builder.fadd(own, total)
                store(total, builder.add(new, at))

            vectors.in_chunks(n, chunk)

        with cgutils.for_range_slice(builder, I64(0), count, I64(1), I64) as (number, _):
            row(number)

    return emit


def tile_nodes(lines: int, size: int) -> int:
    """Nodes of a row to sweep at a time so that all lines read and written stay in the first-level cache. Rows with too
    many lines for that are swept whole.
    """
    fitting = (
        _FIRST_CACHE // ((lines + 3) * size) // 64 * 64
    )  # beside what is read, lines of base, out and the next row
    return fitting if fitting * size >= _LEAST_TILE else 1 << 30


def sweep_intrinsic(lines: Emit | None, strided: Emit, real: str) -> Any:
    """Make the intrinsic of a sweep: `lines`, if there is such code, for neighbours in memory, `strided` for others."""

    @intrinsic
    def sweep(typingctx, levels, weights, a, b, extent, strides, apart, shifts):
        def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
            given = flat(builder, args)
            if lines is None:
                strided(builder, given)
                return context.get_dummy_value()
            dense = builder.icmp_signed("==", given[10], I64(1))
            with builder.if_else(dense) as (then, otherwise):
                with then:
                    lines(builder, given)
                with otherwise:
                    strided(builder, given)
            return context.get_dummy_value()

        return sweep_signature(real), codegen

    return sweep


def sweep_signature(real: str) -> Any:
    """Numba signature of a sweep."""
    return types.void(*_sweep_types(getattr(types, real)))


def _sweep_types(number: Any) -> list[Any]:
    """Types of the arguments, see `stencil_sweep`; `number` is that of a and b."""
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
                neighbour = builder.add(here, distance)
                value, wet_neighbour = vectors.load(neighbour), liquid(builder.add(neighbour, apart))
                across = vectors.multiply_add(sums[2 * row], weight, builder.fsub(held(value), bound[row]))
                grown.append(builder.select(builder.xor(wet[row], wet_neighbour), across, sums[2 * row]))
                opened = vectors.multiply_add(sums[2 * row + 1], weight, builder.fsub(value, own[row]))
                grown.append(builder.select(builder.and_(wet[row], wet_neighbour), opened, sums[2 * row + 1]))
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

        vectors.in_chunks(n, chunk)
        return context.get_dummy_value()

    return types.void(int64s(4), int64s(3), types.UniTuple(factors[0], 4), int64s(2), int64s(2)), codegen

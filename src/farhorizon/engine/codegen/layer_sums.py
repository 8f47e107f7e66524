"""Explicit SIMD for the layers: the sums across lines that stretched shifts are applied to, for mirror-symmetric
stencils.

As in `engine.codegen.matrices`, values at mirror images are first combined into sums that are even or odd along each
axis, and each of these is multiplied once for every part that it belongs to.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from farhorizon.engine.codegen.calls import call_of
from farhorizon.engine.codegen.matrices import MirrorStencil, mirror_sums, parity, weight_of
from farhorizon.engine.codegen.numba_internals import cgutils
from farhorizon.engine.codegen.vectors import I64, Vectors, flat, int64s

Sums = dict[tuple[int, ...], Any]  # by parity along the first two axes

_AHEAD = 8  # lines between use and prefetch
_IN_FLIGHT = 6  # partial sums of a vector, at least, so that none waits for its own last addition
_MIRRORED = int64s(4), int64s(2), int64s(4), types.int64, types.int64
_CROSSING = int64s(5), int64s(2), int64s(2), types.int64, types.int64
_BAND = int64s(4), int64s(2), int64s(4), int64s(2), int64s(2)
MIRRORED_SIGNATURE, CROSSING_SIGNATURE = types.void(*_MIRRORED), types.void(*_CROSSING)
BAND_SIGNATURE = types.void(*_BAND)


def mirrored_parts(stencil: MirrorStencil, axis: int, both: bool, apart: bool, differ: bool, real: str) -> Any:
    """Make the intrinsic ``parts(to, source, strides, weights, vectors)``.

    For nodes that are neighbours along the last axis it sums, across lines, the parts of the stencil along another
    `axis`, 0 or 1: for each component and each distance k along that axis the part that reaches k nodes forward, and,
    if `both` differ, the one that reaches k nodes back. If `apart`, neighbours along the last axis are read from lines
    of their own, as the slots are, and the sums are added to what is there; if those ahead and behind do not `differ`,
    their sums are read.

    The intrinsic takes tuples. `to`: byte addresses of the first sum (k = 1, first component) forward and back, and the
    distances to the sums of the next k and of the next component. `source`: the address of the first node and 0, or
    those of the nearest lines ahead and behind. `strides`: distances in bytes of neighbours along the first two axes,
    of components, and of lines one node farther ahead. Then the weights, and the number of vectors.
    """
    offsets, inside, outside = stencil.offsets, stencil.inside, stencil.outside
    columns, rows = len(inside), len(outside)
    lines: dict[tuple[int, int], list[tuple[int, int, int]]] = {}
    for number, o in enumerate(offsets):
        line = (0 if axis == 0 else o[0], 0 if axis == 1 else o[1])
        lines.setdefault(line, []).append((o[axis], o[2], number))

    keys = len({(k, row) for terms in lines.values() for k, _, _ in terms for row in range(rows)})
    chains = max(1, _IN_FLIGHT // keys)

    def emit(builder: ir.IRBuilder, args: tuple[Any, ...]) -> None:
        plus, minus, part_k, part_c, ahead, behind, s0, s1, shift, step, weights, number_of_vectors = args
        vectors = Vectors.of(builder, real)
        width = vectors.lanes * vectors.size

        def along_lines(line: tuple[int, int]) -> Callable[[Any], Sums]:
            """Sums over the mirror images of a line, by parity along the first two axes."""
            return lambda start: mirror_sums(
                vectors, line, lambda image: vectors.load(_moved(builder, start, (image[0], s0), (image[1], s1)))
            )

        neighbours = _Neighbours(vectors, ahead, behind, shift, step, apart, differ)
        with cgutils.for_range_slice(builder, I64(0), builder.mul(number_of_vectors, I64(width)), I64(width), I64) as (
            at,
            _,
        ):
            total: dict[tuple[int, int, int], list[Any]] = {}
            for line, terms in lines.items():
                for column in range(columns):
                    kept: dict[str, Any] = {}
                    for i in sorted({i for _, i, _ in terms}):
                        on, back = neighbours.at(at, column, i, along_lines(line), kept)
                        made: dict[tuple[int, ...], Any] = {}
                        for k, inner, number in terms:
                            for row in range(rows) if inner == i else ():
                                if not stencil.has(number, row, column):
                                    continue
                                sign = parity(outside[row], inside[column])
                                outer = tuple(0 if a == axis else sign[a] for a in (0, 1))
                                name = (*outer, sign[2])
                                if name not in made:
                                    made[name] = (
                                        on[outer]
                                        if back is None
                                        else (builder.fsub if sign[2] else builder.fadd)(on[outer], back[outer])
                                    )
                                key = (row, sign[axis], k)
                                sums = total.setdefault(key, [None] * chains)
                                w = weight_of(vectors, weights, stencil.place(number, row, column))
                                sums.append(vectors.multiply_add(sums.pop(0), w, made[name]))
            zero = ir.Constant(vectors.type, [0.0] * vectors.lanes)
            for row in range(rows):
                for k in (
                    sorted({key[2] for key in total})
                    if apart
                    else range(1, 1 + max(k for terms in lines.values() for k, _, _ in terms))
                ):
                    even, odd = (
                        vectors.sum([value for value in total[row, p, k] if value is not None])
                        if (row, p, k) in total
                        else none
                        for p, none in ((0, zero), (1, None))
                    )
                    for address, join in ((plus, builder.fadd), (minus, builder.fsub))[: 1 + both]:
                        value = even if odd is None else join(even, odd)
                        place = _moved(builder, builder.add(address, at), (k - 1, part_k), (row, part_c))
                        vectors.store(builder.fadd(vectors.load(place), value) if apart else value, place)

    return _sums(emit, MIRRORED_SIGNATURE)


def crossing_parts(
    stencil: MirrorStencil, both: tuple[bool, bool], reach: int, apart: bool, differ: bool, real: str
) -> Any:
    """Make the intrinsic ``parts(to, source, strides, weights, vectors)`` for the nodes where faces meet.

    Along the line of a node on the last axis it sums the parts of the stencil that reach a certain distance along the
    first axis, the same for all offsets, and k nodes along the second, up to `reach`: for each component, both
    directions along each of the two axes (if `both` differ, along either axis), and each k.

    The intrinsic takes tuples. `to`: byte address of the first sum (k = 1, first component, forward along both axes),
    and the distances to the sums back along the first axis, back along the second, of the next component, and of the
    next k. `strides`: distances in bytes of components, and of lines one node farther ahead. For all else see
    `mirrored_parts`.
    """
    offsets, inside, outside = stencil.offsets, stencil.inside, stencil.outside
    columns, rows = len(inside), len(outside)
    signs = [[parity(row, column) for column in inside] for row in outside]

    def emit(builder: ir.IRBuilder, args: tuple[Any, ...]) -> None:
        to, other_x, other_y, part_c, part_k, ahead, behind, shift, step, weights, number_of_vectors = args
        vectors = Vectors.of(builder, real)
        width = vectors.lanes * vectors.size
        neighbours = _Neighbours(vectors, ahead, behind, shift, step, apart, differ)

        with cgutils.for_range_slice(builder, I64(0), builder.mul(number_of_vectors, I64(width)), I64(width), I64) as (
            at,
            _,
        ):
            total: dict[tuple[int, int], Sums] = {}
            for column in range(columns):
                kept: dict[str, Any] = {}
                made: dict[tuple[int, int], Any] = {}
                for number, (_, k, i) in enumerate(offsets):
                    for row in range(rows):
                        if not stencil.has(number, row, column):
                            continue
                        sign = signs[row][column]
                        if (i, sign[2]) not in made:
                            on, back = neighbours.at(at, column, i, lambda start: {(): vectors.load(start)}, kept)
                            join = builder.fsub if sign[2] else builder.fadd
                            made[i, sign[2]] = on[()] if back is None else join(on[()], back[()])
                        sums = total.setdefault((row, k), {})
                        w = weight_of(vectors, weights, stencil.place(number, row, column))
                        sums[sign[:2]] = vectors.multiply_add(sums.get(sign[:2]), w, made[i, sign[2]])
            for row, k in itertools.product(range(rows), range(1, reach + 1)):
                if apart and (row, k) not in total:
                    continue
                for on_x, on_y in itertools.product((0, 1)[: 1 + both[0]], (0, 1)[: 1 + both[1]]):
                    value = None
                    for sign, term in sorted(total.get((row, k), {}).items()):
                        minus = (on_x * sign[0] + on_y * sign[1]) % 2
                        value = _joined(builder, value, term, bool(minus))
                    moves = (on_x, other_x), (on_y, other_y), (row, part_c), (k - 1, part_k)
                    place = _moved(builder, builder.add(to, at), *moves)
                    if value is None:
                        value = ir.Constant(vectors.type, [0.0] * vectors.lanes)
                    vectors.store(builder.fadd(vectors.load(place), value) if apart else value, place)

    return _sums(emit, CROSSING_SIGNATURE)


def band_sums(stencil: MirrorStencil, differ: bool, real: str) -> Any:
    """Make the intrinsic ``add(to, source, strides, weights, extent)`` for the layers along the last axis.

    It adds to the nodes of a band what the slots of all lines around theirs contribute. The lines of a plane follow one
    another along the second axis, and each is read once: its contributions to the lines up to a reach before and behind
    it are added to their sums so far, which stay in registers until the last line that contributes to them has been
    read. The last of all offsets is > 0; slots ahead and behind that do not `differ` hold the sums.

    The intrinsic takes tuples. `to`: byte addresses of the first node in the levels to add to (0 for the second if
    there is none), and the distances of lines and of components there. `source`: addresses of its slots ahead and
    behind. `strides`: distances of their planes, lines and components, and of slots one node farther ahead. `weights`:
    addresses of the weights and of the factor of the sums. `extent`: numbers of lines, and of nodes in each.
    """
    offsets, inside, outside = stencil.offsets, stencil.inside, stencil.outside
    columns, rows = len(inside), len(outside)
    depth, reach = (max(o[axis] for o in offsets) for axis in (0, 1))
    window = 2 * reach + 1  # lines that a line contributes to
    steps = sorted({o[2] for o in offsets})
    signs = [[parity(row, column) for column in inside] for row in outside]

    def emit(builder: ir.IRBuilder, args: tuple[Any, ...]) -> None:
        to, second, line_to, part_c, ahead, behind, plane, line, shift, step, weights, scale, lines, nodes = args
        vectors = Vectors.of(builder, real)
        (factor,) = vectors.splat_all(scale, 1)
        zero = ir.Constant(vectors.type, [0.0] * vectors.lanes)
        neighbours = _Neighbours(vectors, ahead, behind, shift, step, True, differ)

        def along_first(x: int) -> Callable[[Any], Sums]:
            """Sums over the two planes at a distance, by parity."""
            return lambda start: mirror_sums(
                vectors, (x,), lambda image: vectors.load(_moved(builder, start, (image[0], plane)))
            )

        def brought(at: Any) -> dict[tuple[int, int, int], Any]:
            """Contributions of a line, by component, parity along the second axis, and distance there."""
            sums: dict[tuple[int, int, int], Any] = {}
            for column in range(columns):
                read: dict[tuple[int, int], tuple[Any, Any]] = {}
                made: dict[tuple[int, int, int, int], Any] = {}
                for number, (x, y, i) in enumerate(offsets):
                    for row in range(rows):
                        if not stencil.has(number, row, column):
                            continue
                        sign = signs[row][column]
                        if (x, i) not in read:
                            read[x, i] = neighbours.at(at, column, i, along_first(x), {})
                        key = (x, i, sign[0], sign[2])
                        if key not in made:
                            on, back = read[x, i]
                            made[key] = on[sign[:1]]
                            if back is not None:
                                join = builder.fsub if sign[2] else builder.fadd
                                made[key] = join(on[sign[:1]], back[sign[:1]])
                        w = weight_of(vectors, weights, stencil.place(number, row, column))
                        name = (row, sign[1], y)
                        sums[name] = vectors.multiply_add(sums.get(name), w, made[key])
            return sums

        def take(number: Any, at: Any, so_far: list[Any]) -> list[Any]:
            """Sums of the lines around one, first component first, with its contributions added."""
            sums, totals = brought(builder.add(builder.mul(number, line), at)), list(so_far)
            for row, place in itertools.product(range(rows), range(-reach, reach + 1)):
                even, odd = (sums.get((row, p, abs(place))) for p in (0, 1))
                where = row * window + reach + place
                for term, minus in ((even, False), (odd, place > 0)):
                    if term is not None:
                        totals[where] = _joined(builder, totals[where], term, minus)
            return totals

        def fetch_ahead(number: Any, at: Any) -> None:
            """Prefetch what a line some lines later needs first: it is too far for the hardware prefetcher."""
            target = _moved(builder, builder.add(at, builder.mul(number, line_to)), (_AHEAD, line_to))
            ends = [builder.add(target, I64(byte)) for byte in (0, vectors.lanes * vectors.size - 1)]
            needed = [_moved(builder, builder.add(to, end), (row, part_c)) for row in range(rows) for end in ends]
            last = _moved(builder, builder.add(at, builder.mul(number, line)), (reach + _AHEAD, line), (depth, plane))
            for column, i, first in itertools.product(range(columns), steps, (ahead, behind)[: 1 + differ]):
                needed.append(_moved(builder, builder.add(first, last), (column, shift), (i - 1, step)))
            for address in needed:
                vectors.prefetch(address)

        def passed(so_far: list[Any]) -> list[Any]:
            """Sums as they are passed on to the next line."""
            kept = [so_far[row * window + 1 : (row + 1) * window] for row in range(rows)]
            return [value for of_row in kept for value in (*of_row, zero)]

        with cgutils.for_range_slice(builder, I64(0), nodes, I64(vectors.lanes), I64) as (x, _):
            at, store = builder.mul(x, I64(vectors.size)), vectors.store_first(builder.sub(nodes, x))

            def add(number: Any, so_far: list[Any], at: Any = at, store: Any = store) -> list[Any]:
                fetch_ahead(number, at)
                totals = take(builder.add(number, I64(reach)), at, so_far)
                target = builder.add(builder.mul(number, line_to), at)

                def put(level: Any) -> None:
                    for row in range(rows):
                        place = _moved(builder, builder.add(level, target), (row, part_c))
                        store(vectors.multiply_add(vectors.load(place), factor, totals[row * window]), place)

                put(to)
                with builder.if_then(builder.icmp_signed("!=", second, I64(0))):
                    put(second)
                return passed(totals)

            def begin(number: Any, so_far: list[Any], at: Any = at) -> list[Any]:
                return passed(take(number, at, so_far))

            _, so_far = vectors.loop(I64(-reach), I64(reach), 1, [zero] * (rows * window), begin)
            vectors.loop(I64(0), lines, 1, so_far, add)

    return _sums(emit, BAND_SIGNATURE)


class _Neighbours:
    """Reads sums of values some nodes ahead and behind along the last axis, see `mirrored_parts`."""

    def __init__(
        self, vectors: Vectors, ahead: Any, behind: Any, shift: Any, step: Any, apart: bool, differ: bool
    ) -> None:
        self.vectors, self.apart, self.differ = vectors, apart, differ
        self.ahead, self.behind, self.shift, self.step = ahead, behind, shift, step

    def at(self, at: Any, column: int, i: int, read: Callable[[Any], Sums], kept: dict[str, Any]) -> tuple[Any, Any]:
        """Sums i nodes ahead and behind of the vector `at` bytes on; None for the second if i = 0 or if the two have
        been added up. ``read(address)`` returns sums, and `kept` holds what has been read of this column and line.
        """
        vectors, builder = self.vectors, self.vectors.builder
        if self.apart:
            moves = (column, self.shift), (i - 1, self.step)
            on = read(_moved(builder, builder.add(self.ahead, at), *moves))
            return on, read(_moved(builder, builder.add(self.behind, at), *moves)) if self.differ else None
        width = vectors.lanes * vectors.size
        for name, distance in (("here", 0), ("next", width), ("last", -width)):
            if name not in kept and (i or not distance):
                start = builder.add(self.ahead, builder.add(at, I64(distance)))
                kept[name] = read(_moved(builder, start, (column, self.shift)))
        if i == 0:
            return kept["here"], None
        on = {
            p: vectors.concatenate(kept["here"][p], kept["next"][p], i) if i < vectors.lanes else kept["next"][p]
            for p in kept["here"]
        }
        back = {p: vectors.concatenate(kept["last"][p], kept["here"][p], vectors.lanes - i) for p in kept["here"]}
        return on, back


def _moved(builder: ir.IRBuilder, address: Any, *moves: tuple[int, Any]) -> Any:
    """An address moved by given multiples of distances."""
    for count, distance in moves:
        if count:
            address = builder.add(address, builder.mul(I64(count), distance))
    return address


def _joined(builder: ir.IRBuilder, total: Any, term: Any, minus: bool) -> Any:
    """Sum with one more term, of either sign; None stands for no sum."""
    if total is None:
        return builder.fneg(term) if minus else term
    return (builder.fsub if minus else builder.fadd)(total, term)


def _sums(emit: Callable[[ir.IRBuilder, tuple[Any, ...]], None], kind: Any) -> Any:
    """The intrinsic of a signature whose code is given by `emit`."""

    @intrinsic
    def parts(typingctx, to, source, strides, weights, vectors):
        def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
            emit(builder, flat(builder, args))
            return context.get_dummy_value()

        return kind, codegen

    return parts


@intrinsic
def call_mirrored(typingctx, function, to, source, strides, weights, vectors):
    """Call compiled `mirrored_parts` by their address."""
    return call_of(_MIRRORED)


@intrinsic
def call_bands(typingctx, function, to, source, strides, weights, vectors):
    """Call compiled `band_sums` by their address."""
    return call_of(_BAND)


@intrinsic
def call_crossing(typingctx, function, to, source, strides, weights, vectors):
    """Call compiled `crossing_parts` by their address."""
    return call_of(_CROSSING)

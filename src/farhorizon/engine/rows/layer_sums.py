"""Explicit SIMD for the layers: the sums across lines that stretched shifts are applied to, of stencils that go over
into themselves in mirrors.

As in `engine.rows.matrices`, values at mirror images are combined first, to sums that are even or odd along each axis,
and each is multiplied once for every part that it belongs to.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from farhorizon.engine.rows.calls import call_of
from farhorizon.engine.rows.matrices import Octant, Pattern, Signs, mirror_sums, parity
from farhorizon.engine.rows.vectors import I64, Vectors, flat, int64s

_IN_FLIGHT = 6  # sums that a vector is added up in, at least: each waits for itself
_MIRRORED = int64s(4), int64s(2), int64s(4), types.int64, types.int64
MIRRORED_SIGNATURE = types.void(*_MIRRORED)


def mirrored_parts(
    offsets: Octant,
    pattern: Pattern,
    inside: Signs,
    outside: Signs,
    axis: int,
    both: bool,
    apart: bool,
    differ: bool,
    real: str,
) -> Any:
    """Make the intrinsic ``parts(to, source, strides, weights, vectors)``.

    It sums what lines across an axis bring to nodes that are neighbours along the last axis, for each component and
    each distance k along that axis: what lies k nodes on in its direction, and what lies k nodes back.

    Parameters
    ----------
    offsets : tuple of (int, int, int)
        Offsets >= 0 that stand for their mirror images.
    pattern : tuple of tuple of bool
        Which of their weights differ from zero, one for a scalar field.
    inside, outside : tuple of (int, int, int)
        Signs of the components that are read, and of those that are written.
    axis : int
        The first or the second axis, with k from 1 on; the last axis: one sum of all lines, no k.
    both : bool
        Whether what lies on and what lies back differ.
    apart, differ : bool
        Whether neighbours along the last axis are read from lines of their own (as the slots are), and whether those
        ahead and behind differ; where they do not, their sums are read.
    real : {"float64", "float32"}

    Returns
    -------
    numba intrinsic
        Takes groups. `to`: byte addresses of the first sum (k = 1, first component) of what lies on and of what lies
        back, and the distances of the sums of one more k and component. `source`: that of the first node and 0, or of
        the nearest lines ahead and behind. `strides`: distances in bytes of neighbours along the first two axes, of
        components, and of lines one node farther ahead. Then the weights, and how many vectors. From lines of their
        own, for the first two axes, sums are added to what is there.
    """
    columns, rows = len(inside), len(outside)
    adds = apart and axis < 2
    lines: dict[tuple[int, int], list[tuple[int, int, int]]] = {}
    for number, o in enumerate(offsets):
        line = (0 if axis == 0 else o[0], 0 if axis == 1 else o[1])
        lines.setdefault(line, []).append((o[axis] if axis < 2 else 1, o[2], number))

    keys = len({(k, row) for terms in lines.values() for k, _, _ in terms for row in range(rows)})
    chains = max(1, _IN_FLIGHT // keys)

    def emit(builder: ir.IRBuilder, args: tuple[Any, ...]) -> None:
        plus, minus, part_k, part_c, ahead, behind, s0, s1, shift, step, weights, number_of_vectors = args
        vectors = Vectors.of(builder, real)
        width = vectors.lanes * vectors.size

        def moved(address: Any, *moves: tuple[int, Any]) -> Any:
            for count, distance in moves:
                if count:
                    address = builder.add(address, builder.mul(I64(count), distance))
            return address

        def weight(number: int, row: int, column: int) -> Any:
            place = (number * rows + row) * columns + column
            return vectors.splat_all(builder.add(weights, I64(place * vectors.size)), 1)[0]

        def along_lines(start: Any, line: tuple[int, int]) -> dict[tuple[int, ...], Any]:
            """Sums over the mirror images of a line, by parity along the first two axes."""
            return mirror_sums(vectors, line, lambda image: vectors.load(moved(start, (image[0], s0), (image[1], s1))))

        def neighbours(at: Any, column: int, line: tuple[int, int], i: int, kept: dict[str, Any]) -> tuple[Any, Any]:
            """Sums i nodes on and back along the last axis; where these are added up, and for i = 0, the first
            alone."""
            if apart:
                on = along_lines(moved(builder.add(ahead, at), (column, shift), (i - 1, step)), line)
                return on, along_lines(
                    moved(builder.add(behind, at), (column, shift), (i - 1, step)), line
                ) if differ else None
            for name, distance in (("here", 0), ("next", width), ("last", -width)):
                if name not in kept and (i or not distance):
                    kept[name] = along_lines(
                        moved(builder.add(ahead, builder.add(at, I64(distance))), (column, shift)), line
                    )
            if i == 0:
                return kept["here"], None
            on = {
                p: vectors.concatenate(kept["here"][p], kept["next"][p], i) if i < vectors.lanes else kept["next"][p]
                for p in kept["here"]
            }
            back = {p: vectors.concatenate(kept["last"][p], kept["here"][p], vectors.lanes - i) for p in kept["here"]}
            return on, back

        with cgutils.for_range_slice(builder, I64(0), builder.mul(number_of_vectors, I64(width)), I64(width), I64) as (
            at,
            _,
        ):
            total: dict[tuple[int, int, int], list[Any]] = {}
            for line, terms in lines.items():
                for column in range(columns):
                    kept: dict[str, Any] = {}
                    for i in sorted({i for _, i, _ in terms}):
                        on, back = neighbours(at, column, line, i, kept)
                        made: dict[tuple[int, ...], Any] = {}
                        for k, inner, number in terms:
                            for row in range(rows) if inner == i else ():
                                if not pattern[number][row * columns + column]:
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
                                key = (row, sign[axis] if axis < 2 else 0, k)
                                sums = total.setdefault(key, [None] * chains)
                                sums.append(vectors.multiply_add(sums.pop(0), weight(number, row, column), made[name]))
            zero = ir.Constant(vectors.type, [0.0] * vectors.lanes)
            for row in range(rows):
                for k in (
                    sorted({key[2] for key in total})
                    if adds
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
                        place = moved(builder.add(address, at), (k - 1, part_k), (row, part_c))
                        vectors.store(builder.fadd(vectors.load(place), value) if adds else value, place)

    @intrinsic
    def parts(typingctx, to, source, strides, weights, vectors):
        def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
            emit(builder, flat(builder, args))
            return context.get_dummy_value()

        return MIRRORED_SIGNATURE, codegen

    return parts


@intrinsic
def call_mirrored(typingctx, function, to, source, strides, weights, vectors):
    """Call compiled `mirrored_parts` by their address."""
    return call_of(_MIRRORED)

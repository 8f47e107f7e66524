"""Explicit SIMD for fields of several components: sweeps of stencils whose weights are matrices, and products of
matrices with the values of nodes.

The stencil of an isotropic or orthotropic medium is mirror-symmetric: under reversal of an axis the components of a
vector along it change their sign, as do those of a tensor with one index along it, and the weights that couple a
component that changes with one that does not. So the values at the mirror images of an offset (two, four or eight) are
first combined into sums that are even or odd along each axis, and every combination is multiplied once for each
component that it contributes to.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import partial
from typing import Any, NamedTuple

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from farhorizon.engine.codegen.calls import call_of
from farhorizon.engine.codegen.numba_internals import cgutils
from farhorizon.engine.codegen.stencil_sweeps import (
    AHEAD,
    Emit,
    Output,
    VectorRow,
    sweep_intrinsic,
    sweep_lines,
    tile_nodes,
    with_own,
)
from farhorizon.engine.codegen.vectors import I64, Vectors

# Lines that are read together at most: of more of them the first-level cache would hold too few nodes, so that each
# component of ``src`` is swept separately.
_LINES = 32

#: For each component of a field whether it changes its sign (1) or not (0) under reversal of each axis.
Signs = tuple[tuple[int, int, int], ...]


class MirrorStencil(NamedTuple):
    """Mirror-symmetric stencil from one field to another, without its weights, which are matrices."""

    offsets: tuple[tuple[int, int, int], ...]  # all >= 0; each stands for its mirror images
    pattern: tuple[tuple[bool, ...], ...]  # for each offset which entries of its weight differ from zero, row by row
    inside: Signs  # of the components that are read
    outside: Signs  # of those that are written

    def has(self, number: int, row: int, column: int) -> bool:
        """Whether a weight differs from zero."""
        return self.pattern[number][row * len(self.inside) + column]

    def place(self, number: int, row: int, column: int) -> int:
        """Number of a weight among all entries of the matrices."""
        return (number * len(self.outside) + row) * len(self.inside) + column


def signs_of(components: int) -> Signs:
    """Signs of a scalar, or of a vector along the last axes."""
    if components == 1:
        return ((0, 0, 0),)
    return tuple(
        (int(c == components - 3), int(c == components - 2), int(c == components - 1)) for c in range(components)
    )


def parity(row: tuple[int, ...], column: tuple[int, ...]) -> tuple[int, ...]:
    """Whether the weight between components of these signs is even (0) or odd (1) along each axis."""
    return tuple(int(a != b) for a, b in zip(row, column, strict=True))


def mirror_sums(
    vectors: Vectors, offset: tuple[int, ...], load: Callable[[tuple[int, ...]], Any]
) -> dict[tuple[int, ...], Any]:
    """Sums of the values at the mirror images of an offset, by their parity along each axis."""
    if not offset:
        return {(): load(())}
    o, rest = offset[0], offset[1:]
    plus = mirror_sums(vectors, rest, lambda image: load((o, *image)))
    if o == 0:
        return {(0, *p): value for p, value in plus.items()}
    minus = mirror_sums(vectors, rest, lambda image: load((-o, *image)))
    even = {(0, *p): vectors.builder.fadd(plus[p], minus[p]) for p in plus}
    return even | {(1, *p): vectors.builder.fsub(plus[p], minus[p]) for p in plus}


def weight_of(vectors: Vectors, address: Any, place: int) -> Any:
    """A weight in every lane, read where it is used, because there are more weights than registers."""
    return vectors.splat_all(vectors.builder.add(address, I64(place * vectors.size)), 1)[0]


def _shifted_fields(vectors: Vectors, shifts: Any, columns: int, rows: int) -> tuple[list[Any], list[Any]]:
    """Distances of the components in ``src``, and of those in ``base`` and ``out``, in elements, from the table that a
    sweep is given.
    """
    distances = [
        vectors.builder.load(vectors.pointer(vectors.builder.add(shifts, I64(8 * i)), I64))
        for i in range(columns + rows)
    ]
    return distances[:columns], distances[columns:]


def matrix_sweep(stencil: MirrorStencil, real: str, form: str, lines: bool) -> Any:
    """Make the intrinsic of `stencil_sweeps.stencil_sweep` for fields of several components.

    It writes, by `form`: ``a*src + b*base`` plus the sums ("step", for a field with itself, whose stencil has a
    centre); only the sums ("sum"); or the sums added to the values of ``out`` ("add"). With `lines`, neighbours in
    memory are swept line by line; no inner offset is then longer than one vector. ``weights`` are matrices, one per
    offset; ``shifts`` is the address of distances in elements (int64): of the components in ``src``, and of those in
    ``base`` and ``out``.
    """
    return sweep_intrinsic(
        _matrix_lines(stencil, real, form) if lines else None, _matrix_strided(stencil, real, form), real
    )


def _matrix_lines(stencil: MirrorStencil, real: str, form: str) -> Emit:
    """Make the code of `matrix_sweep` for rows of neighbours in memory."""
    offsets, inside, outside = stencil.offsets, stencil.inside, stencil.outside
    columns, rows = len(inside), len(outside)
    lines: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for number, (o0, o1, i) in enumerate(offsets):
        lines.setdefault((o0, o1), []).append((i, number))
    last = {o0: max(o1 for plane, o1 in lines if plane == o0) for o0, _ in lines}
    read = sum((1 + (o0 > 0)) * (1 + (o1 > 0)) for o0, o1 in lines)
    together = columns if columns * read <= _LINES else 1

    def emit(builder: ir.IRBuilder, args: tuple[Any, ...]) -> None:
        weights, s0, s1, step, t, shifts = args[3], args[8], args[9], args[11], args[12], args[13]
        vectors = Vectors.of(builder, real)
        read_at, written_at = _shifted_fields(vectors, shifts, columns, rows)
        zero = ir.Constant(vectors.type, [0.0] * vectors.lanes)

        def prepare(swept: range, here: Any, old: Any, new: Any) -> VectorRow:
            """What some columns contribute to a row."""
            sources = [vectors.shifted(here, (1, shift)) for shift in read_at]
            olds, news = ([vectors.shifted(start, (1, shift)) for shift in written_at] for start in (old, new))
            images = sorted({(side * o0, turn * o1) for o0, o1 in lines for side in (1, -1) for turn in (1, -1)})
            places = {
                column: {image: vectors.shifted(sources[column], (image[0], s0), (image[1], s1)) for image in images}
                for column in swept
            }
            begins = swept.start == 0  # the first columns to write to the row
            reached = {
                row
                for n in range(len(offsets))
                for row in range(rows)
                for column in swept
                if stencil.has(n, row, column)
            }
            written = range(rows) if begins else sorted(reached)
            ahead = [
                vectors.shifted(source, (sign * o0, s0), (o1, s1), (AHEAD, step))
                for source in sources[swept.start : swept.stop]
                for o0, o1 in last.items()
                for sign in ((1, -1) if o0 else (1,))
            ] + [vectors.shifted(address, (AHEAD, t)) for address in (olds if form == "step" else news) if begins]

            def read_from(lines_at: dict[Any, Any], at: Any) -> Callable[[tuple[int, ...]], Any]:
                return lambda image: vectors.load(builder.add(lines_at[image], at))

            def sums(at: Any) -> dict[Hashable, Any]:
                """Even and odd sums along the row, combined into those that come from ahead (their sum) and from behind
                (their difference).
                """
                total: dict[tuple[int, int, int], Any] = {}
                for line, terms in lines.items():
                    for column in swept:
                        combined = mirror_sums(vectors, line, read_from(places[column], at))
                        for i, number in terms:
                            for row in range(rows):
                                if stencil.has(number, row, column):
                                    *outer, odd = parity(outside[row], inside[column])
                                    key = (row, odd, i)
                                    w = weight_of(vectors, weights, stencil.place(number, row, column))
                                    total[key] = vectors.multiply_add(total.get(key), w, combined[tuple(outer)])
                named: dict[Hashable, Any] = {
                    (row, 0): total.get((row, 0, 0), None if row in reached else zero) for row in written
                }
                for row, i in {(row, i) for row, _, i in total if i}:
                    even, uneven = total.get((row, 0, i), zero), total.get((row, 1, i))
                    named[row, i, "ahead"] = even if uneven is None else builder.fadd(even, uneven)
                    named[row, i, "behind"] = even if uneven is None else builder.fsub(even, uneven)
                return named

            moved = [
                {
                    i
                    for number, (_, _, i) in enumerate(offsets)
                    if i and any(stencil.has(number, row, column) for column in swept)
                }
                for row in range(rows)
            ]
            own = {"step": (sources, olds), "sum": (), "add": (news,)}[form if begins else "add"]
            outputs = [
                Output(
                    (row, 0),
                    [(i, (row, i, "ahead"), (row, i, "behind")) for i in sorted(moved[row])],
                    [at[row] for at in own],
                    news[row],
                )
                for row in written
            ]
            return VectorRow(sums, outputs, ahead)

        nodes = tile_nodes(together * read + rows * (form != "step"), vectors.size)
        for first in range(0, columns, together):
            sweep_lines(vectors, args, nodes, partial(prepare, range(first, first + together)))

    return emit


def _matrix_strided(stencil: MirrorStencil, real: str, form: str) -> Emit:
    """Make the code of `matrix_sweep` for rows whose neighbours lie any distance s2 apart: every value is read
    separately.
    """
    offsets, inside, outside = stencil.offsets, stencil.inside, stencil.outside
    columns, rows = len(inside), len(outside)

    def emit(builder: ir.IRBuilder, args: tuple[Any, ...]) -> None:
        src, base, out, weights, a, b, n, count, s0, s1, s2, step, t, shifts = args
        vectors = Vectors.of(builder, real)
        read_at, written_at = _shifted_fields(vectors, shifts, columns, rows)
        a_all, b_all = vectors.splat(a), vectors.splat(b)

        def chunk(x: Any, number: Any, store: Callable[[Any, Any], None]) -> None:
            sources = [vectors.shifted(src, (1, builder.mul(number, step)), (1, x), (1, shift)) for shift in read_at]
            olds, news = (
                [vectors.shifted(start, (1, builder.mul(number, t)), (1, x), (1, shift)) for shift in written_at]
                for start in (base, out)
            )

            def read_from(source: Any) -> Callable[[tuple[int, ...]], Any]:
                return lambda image: vectors.load(vectors.shifted(source, *zip(image, (s0, s1, s2), strict=True)))

            total: list[Any] = [None] * rows
            for number_of_offset, offset in enumerate(offsets):
                for column in range(columns):
                    combined = mirror_sums(vectors, offset, read_from(sources[column]))
                    for row in range(rows):
                        if stencil.has(number_of_offset, row, column):
                            w = weight_of(vectors, weights, stencil.place(number_of_offset, row, column))
                            combination = combined[parity(outside[row], inside[column])]
                            total[row] = vectors.multiply_add(total[row], w, combination)
            own = {"step": (sources, olds), "sum": (), "add": (news,)}[form]
            for row in range(rows):
                values = [vectors.load(at[row]) for at in own]
                store(with_own(vectors, total[row], values, (a_all, b_all)), news[row])

        with cgutils.for_range_slice(builder, I64(0), count, I64(1), I64) as (number, _):
            vectors.in_chunks(n, lambda x, store: chunk(x, number, store))

    return emit


_MAP = (*(types.int64,) * 7, types.float64)
MAP_SIGNATURE = types.void(*_MAP)


def linear_map(entries: tuple[tuple[int, ...], ...], columns: int, each: bool, added: bool, real: str) -> Any:
    """Make the intrinsic ``map(src, read, out, written, matrix, step, nodes, factor)``: ``out = matrix src`` at a
    number of nodes, or if `added` ``out += factor matrix src``; it works in place, too.

    The matrix has `columns` columns; `entries` are, for each of its rows, those that may differ from zero, at least
    one. If `each` node has its own matrix, one entry of all matrices lies side by side, and up to one vector is read
    beyond the last.

    The intrinsic takes the byte addresses of the first numbers, the distances in bytes from one number of a node to the
    next, the byte address of the matrix, the distance in bytes between its entries, and the number of nodes.
    """

    @intrinsic
    def product(typingctx, src, read, out, written, matrix, step, nodes, factor):
        def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
            src, read, out, written, matrix, step, nodes, factor = args
            vectors = Vectors.of(builder, real)
            numbers, results = (
                [builder.add(first, builder.mul(I64(i), apart)) for i in range(count)]
                for first, apart, count in ((src, read, columns), (out, written, len(entries)))
            )
            scale = vectors.splat(factor if real == "float64" else builder.fptrunc(factor, ir.FloatType()))

            def entry(number: int, at: Any) -> Any:
                place = builder.add(matrix, builder.mul(I64(number), step))
                return vectors.load(builder.add(place, at)) if each else vectors.splat_all(place, 1)[0]

            def chunk(x: Any, store: Callable[[Any, Any], None]) -> None:
                at = builder.mul(x, I64(vectors.size))
                values = [vectors.load(builder.add(number, at)) for number in numbers]
                for row, columns_of_row in enumerate(entries):
                    total, place = None, builder.add(results[row], at)
                    for column in columns_of_row:
                        total = vectors.multiply_add(total, entry(row * columns + column, at), values[column])
                    store(vectors.multiply_add(vectors.load(place), scale, total) if added else total, place)

            vectors.in_chunks(nodes, chunk)
            return context.get_dummy_value()

        return MAP_SIGNATURE, codegen

    return product


@intrinsic
def call_map(typingctx, function, src, read, out, written, matrix, step, nodes, factor):
    """Call a compiled `linear_map` by its address."""
    return call_of(_MAP)

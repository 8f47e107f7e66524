"""Explicit SIMD for fields of several components: sweeps of stencils whose weights are matrices.

The stencil of an isotropic or orthotropic medium is mirror-symmetric: under reversal of an axis the components of a
vector along it change their sign, as do those of a tensor with one index along it, and the weights that couple a
component that changes with one that does not. So the values at the mirror images of an offset (two, four or eight) are
first combined into sums that are even or odd along each axis, and every combination is multiplied once for each
component that it contributes to.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import partial
from typing import Any

from llvmlite import ir
from numba.core import cgutils

from farhorizon.engine.rows.vectors import (
    AHEAD,
    I64,
    Output,
    VectorRow,
    Vectors,
    sweep_intrinsic,
    sweep_lines,
    tile_nodes,
    with_own,
)

# Lines that are read together at most: of more of them the first-level cache would hold too few nodes, so that each
# component of ``src`` is swept separately.
_LINES = 32

#: (offset >= 0 along the outer axes and along the inner one); every one stands for its mirror images.
Octant = tuple[tuple[int, int, int], ...]
#: For each offset whether the weight of [row, column] differs from zero, row by row.
Pattern = tuple[tuple[bool, ...], ...]
#: For each component of a field whether it changes its sign (1) or not (0) under reversal of each axis.
Signs = tuple[tuple[int, int, int], ...]


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


class _Weights:
    """Weights that are read where they are used, because there are more of them than registers."""

    def __init__(self, vectors: Vectors, address: Any, pattern: Pattern, columns: int) -> None:
        self.vectors, self.address, self.pattern, self.columns = vectors, address, pattern, columns
        self.rows = len(pattern[0]) // columns

    def used(self, number: int, row: int, column: int) -> bool:
        return self.pattern[number][row * self.columns + column]

    def of(self, number: int, row: int, column: int) -> Any:
        place = (number * self.rows + row) * self.columns + column
        return self.vectors.splat_all(self.vectors.builder.add(self.address, I64(place * self.vectors.size)), 1)[0]


def _shifted_fields(vectors: Vectors, shifts: Any, columns: int, rows: int) -> tuple[list[Any], list[Any]]:
    """Distances of the components in ``src``, and of those in ``base`` and ``out``, in elements, from the table that a
    sweep is given.
    """
    found = [
        vectors.builder.load(vectors.pointer(vectors.builder.add(shifts, I64(8 * i)), I64))
        for i in range(columns + rows)
    ]
    return found[:columns], found[columns:]


def matrix_line_sweep(offsets: Octant, pattern: Pattern, real: str, inside: Signs, outside: Signs, form: str) -> Any:
    """Make the intrinsic of `vectors.line_sweep` for fields of several components.

    Parameters
    ----------
    offsets : tuple of (int, int, int)
        Offsets >= 0 that stand for their mirror images, the centre among them; the inner one at most one vector.
    pattern : tuple of tuple of bool
        Which weights differ from zero.
    real : {"float64", "float32"}
    inside, outside : tuple of (int, int, int)
        Signs of the components of ``src``, and of ``base`` and ``out``.
    form : {"step", "sum", "add"}
        What is written: ``a*src + b*base`` plus the sums, for fields of the same components; only the sums; or the sums
        added to the values of ``out``.

    Returns
    -------
    numba intrinsic
        ``weights`` are matrices, one per offset; ``shifts`` is the address of distances in elements (int64): of the
        components in ``src``, and of those in ``base`` and ``out``.
    """
    columns, rows = len(inside), len(outside)
    lines: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for number, (o0, o1, i) in enumerate(offsets):
        lines.setdefault((o0, o1), []).append((i, number))
    last = {o0: max(o1 for other, o1 in lines if other == o0) for o0, _ in lines}
    read = sum((1 + (o0 > 0)) * (1 + (o1 > 0)) for o0, o1 in lines)
    together = columns if columns * read <= _LINES else 1

    def emit(builder: ir.IRBuilder, args: tuple[Any, ...]) -> None:
        weights, s0, s1, step, t, shifts = args[3], args[8], args[9], args[11], args[12], args[13]
        vectors = Vectors.of(builder, real)
        w = _Weights(vectors, weights, pattern, columns)
        read_at, written_at = _shifted_fields(vectors, shifts, columns, rows)
        zero = ir.Constant(vectors.type, [0.0] * vectors.lanes)

        def prepare(some: range, here: Any, old: Any, new: Any) -> VectorRow:
            """What some columns contribute to a row."""
            sources = [vectors.shifted(here, (1, shift)) for shift in read_at]
            olds, news = ([vectors.shifted(start, (1, shift)) for shift in written_at] for start in (old, new))
            images = sorted({(side * o0, turn * o1) for o0, o1 in lines for side in (1, -1) for turn in (1, -1)})
            places = {
                column: {image: vectors.shifted(sources[column], (image[0], s0), (image[1], s1)) for image in images}
                for column in some
            }
            begins = some.start == 0  # the first columns to write to the row
            reached = {
                row for n in range(len(offsets)) for row in range(rows) for column in some if w.used(n, row, column)
            }
            written = range(rows) if begins else sorted(reached)
            ahead = [
                vectors.shifted(source, (sign * o0, s0), (o1, s1), (AHEAD, step))
                for source in sources[some.start : some.stop]
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
                    for column in some:
                        combined = mirror_sums(vectors, line, read_from(places[column], at))
                        for i, number in terms:
                            for row in range(rows):
                                if w.used(number, row, column):
                                    *outer, odd = parity(outside[row], inside[column])
                                    key = (row, odd, i)
                                    total[key] = vectors.multiply_add(
                                        total.get(key), w.of(number, row, column), combined[tuple(outer)]
                                    )
                found: dict[Hashable, Any] = {
                    (row, 0): total.get((row, 0, 0), None if row in reached else zero) for row in written
                }
                for row, i in {(row, i) for row, _, i in total if i}:
                    even, turned = total.get((row, 0, i), zero), total.get((row, 1, i))
                    found[row, i, "ahead"] = even if turned is None else builder.fadd(even, turned)
                    found[row, i, "behind"] = even if turned is None else builder.fsub(even, turned)
                return found

            moved = [
                {
                    i
                    for number, (_, _, i) in enumerate(offsets)
                    if i and any(w.used(number, row, column) for column in some)
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

        for first in range(0, columns, together):
            some = range(first, first + together)
            sweep_lines(
                vectors,
                args,
                tile_nodes(together * read + rows * (form != "step"), vectors.size),
                partial(prepare, some),
            )

    return sweep_intrinsic(emit, real)


def matrix_strided_sweep(offsets: Octant, pattern: Pattern, real: str, inside: Signs, outside: Signs, form: str) -> Any:
    """Do the same for rows whose neighbours lie any distance s2 apart: every value is read separately."""
    columns, rows = len(inside), len(outside)

    def emit(builder: ir.IRBuilder, args: tuple[Any, ...]) -> None:
        src, base, out, weights, a, b, n, count, s0, s1, s2, step, t, shifts = args
        vectors = Vectors.of(builder, real)
        w = _Weights(vectors, weights, pattern, columns)
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
            for place, offset in enumerate(offsets):
                for column in range(columns):
                    combined = mirror_sums(vectors, offset, read_from(sources[column]))
                    for row in range(rows):
                        if w.used(place, row, column):
                            total[row] = vectors.multiply_add(
                                total[row], w.of(place, row, column), combined[parity(outside[row], inside[column])]
                            )
            own = {"step": (sources, olds), "sum": (), "add": (news,)}[form]
            for row in range(rows):
                values = [vectors.load(at[row]) for at in own]
                store(with_own(vectors, total[row], values, (a_all, b_all)), news[row])

        with cgutils.for_range_slice(builder, I64(0), count, I64(1), I64) as (number, _):
            vectors.in_chunks(n, lambda x, store: chunk(x, number, store))

    return sweep_intrinsic(emit, real)

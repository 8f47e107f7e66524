"""Explicit SIMD for fields of several components: sweeps of stencils whose weights are matrices.

A stencil of an isotropic or orthotropic medium goes over into itself in a mirror: where an axis is turned, the weights
that couple the component along it with another one change their sign, all others stay. So the values at the mirror
images of an offset (two, four or eight) are combined first, to sums that are even or odd along each axis, and every
combination is multiplied once for each component that gets it.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
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
)

#: (offset >= 0 along the outer axes and along the inner one); every one stands for its mirror images.
Octant = tuple[tuple[int, int, int], ...]
#: For each offset whether the weight of [row, column] differs from zero, row by row.
Pattern = tuple[tuple[bool, ...], ...]


def _components(pattern: Pattern) -> int:
    return 2 if len(pattern[0]) == 4 else 3


def parity(row: int, column: int, components: int) -> tuple[int, ...]:
    """Along each axis whether the weight of [row, column] is even (0) or odd (1); the components are those along the
    last axes.
    """
    return tuple(int((row == a) != (column == a)) for a in range(components - 3, components))


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
    """Weights read where they are used: there are more of them than registers."""

    def __init__(self, vectors: Vectors, address: Any, pattern: Pattern) -> None:
        self.vectors, self.address, self.pattern = vectors, address, pattern
        self.components = _components(pattern)

    def used(self, number: int, row: int, column: int) -> bool:
        return self.pattern[number][row * self.components + column]

    def of(self, number: int, row: int, column: int) -> Any:
        place = (number * self.components + row) * self.components + column
        return self.vectors.splat_all(self.vectors.builder.add(self.address, I64(place * self.vectors.size)), 1)[0]


def _shifted_fields(vectors: Vectors, shifts: Any, components: int) -> tuple[list[Any], list[Any]]:
    """Distances, in elements, of the components in ``src`` and in ``base`` and ``out``, from the table that a sweep is
    given.
    """
    found = [
        vectors.builder.load(vectors.pointer(vectors.builder.add(shifts, I64(8 * i)), ir.IntType(64))) for i in range(6)
    ]
    return found[:components], found[3 : 3 + components]


def matrix_line_sweep(offsets: Octant, pattern: Pattern, real: str) -> Any:
    """Make the intrinsic of `vectors.line_sweep` for a field of two or three components.

    Parameters
    ----------
    offsets : tuple of (int, int, int)
        Offsets >= 0 that stand for their mirror images, the centre among them; the inner one at most one vector.
    pattern : tuple of tuple of bool
        Which weights differ from zero.
    real : {"float64", "float32"}

    Returns
    -------
    numba intrinsic
        ``weights`` are matrices, one an offset; ``shifts`` is the address of six distances in elements (int64): of the
        components in ``src``, and in ``base`` and ``out``. The components are those along the rows' axes, slowest
        first, the last one along the row.
    """
    components = _components(pattern)
    lines: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for number, (o0, o1, i) in enumerate(offsets):
        lines.setdefault((o0, o1), []).append((i, number))
    last = {o0: max(o1 for other, o1 in lines if other == o0) for o0, _ in lines}
    read = sum((1 + (o0 > 0)) * (1 + (o1 > 0)) for o0, o1 in lines)

    def emit(builder: ir.IRBuilder, args: tuple[Any, ...]) -> None:
        weights, s0, s1, step, t, shifts = args[3], args[8], args[9], args[11], args[12], args[13]
        vectors = Vectors.of(builder, real)
        w = _Weights(vectors, weights, pattern)
        inside, outside = _shifted_fields(vectors, shifts, components)
        zero = ir.Constant(vectors.type, [0.0] * vectors.lanes)

        def prepare(here: Any, old: Any, new: Any) -> VectorRow:
            sources = [vectors.shifted(here, (1, shift)) for shift in inside]
            olds, news = ([vectors.shifted(start, (1, shift)) for shift in outside] for start in (old, new))
            images = {(side * o0, turn * o1) for o0, o1 in lines for side in (1, -1) for turn in (1, -1)}
            places = [
                {image: vectors.shifted(source, (image[0], s0), (image[1], s1)) for image in sorted(images)}
                for source in sources
            ]
            ahead = [
                vectors.shifted(source, (sign * o0, s0), (o1, s1), (AHEAD, step))
                for source in sources
                for o0, o1 in last.items()
                for sign in ((1, -1) if o0 else (1,))
            ] + [vectors.shifted(address, (AHEAD, t)) for address in olds]

            def read_from(lines_at: dict[Any, Any], at: Any) -> Callable[[tuple[int, ...]], Any]:
                return lambda image: vectors.load(builder.add(lines_at[image], at))

            def sums(at: Any) -> dict[Hashable, Any]:
                """Even and odd sums along the row, then those that come from ahead (their sum) and from behind (their
                difference).
                """
                total: dict[tuple[int, int, int], Any] = {}
                for line, terms in lines.items():
                    for column in range(components):
                        combined = mirror_sums(vectors, line, read_from(places[column], at))
                        for i, number in terms:
                            for row in range(components):
                                if w.used(number, row, column):
                                    *outer, odd = parity(row, column, components)
                                    key = (row, odd, i)
                                    total[key] = vectors.multiply_add(
                                        total.get(key), w.of(number, row, column), combined[tuple(outer)]
                                    )
                found: dict[Hashable, Any] = {(row, 0): total.get((row, 0, 0)) for row in range(components)}
                for row, i in {(row, i) for row, _, i in total if i}:
                    even, turned = total.get((row, 0, i), zero), total.get((row, 1, i))
                    found[row, i, "ahead"] = even if turned is None else builder.fadd(even, turned)
                    found[row, i, "behind"] = even if turned is None else builder.fsub(even, turned)
                return found

            moved = [
                {
                    i
                    for number, (_, _, i) in enumerate(offsets)
                    if i and any(pattern[number][row * components : (row + 1) * components])
                }
                for row in range(components)
            ]
            outputs = [
                Output(
                    (row, 0),
                    [(i, (row, i, "ahead"), (row, i, "behind")) for i in sorted(moved[row])],
                    sources[row],
                    olds[row],
                    news[row],
                )
                for row in range(components)
            ]
            return VectorRow(sums, outputs, ahead)

        sweep_lines(vectors, args, tile_nodes(components * read, vectors.size), prepare)

    return sweep_intrinsic(emit, real)


def matrix_strided_sweep(offsets: Octant, pattern: Pattern, real: str) -> Any:
    """The same for rows whose neighbours lie any distance s2 apart: every value is read by itself."""
    components = _components(pattern)

    def emit(builder: ir.IRBuilder, args: tuple[Any, ...]) -> None:
        src, base, out, weights, a, b, n, count, s0, s1, s2, step, t, shifts = args
        vectors = Vectors.of(builder, real)
        w = _Weights(vectors, weights, pattern)
        inside, outside = _shifted_fields(vectors, shifts, components)
        a_all, b_all = vectors.splat(a), vectors.splat(b)

        def chunk(x: Any, number: Any, store: Callable[[Any, Any], None]) -> None:
            sources = [vectors.shifted(src, (1, builder.mul(number, step)), (1, x), (1, shift)) for shift in inside]
            olds, news = (
                [vectors.shifted(start, (1, builder.mul(number, t)), (1, x), (1, shift)) for shift in outside]
                for start in (base, out)
            )

            def read_from(source: Any) -> Callable[[tuple[int, ...]], Any]:
                return lambda image: vectors.load(vectors.shifted(source, *zip(image, (s0, s1, s2), strict=True)))

            total: list[Any] = [None] * components
            for place, offset in enumerate(offsets):
                for column in range(components):
                    combined = mirror_sums(vectors, offset, read_from(sources[column]))
                    for row in range(components):
                        if w.used(place, row, column):
                            total[row] = vectors.multiply_add(
                                total[row], w.of(place, row, column), combined[parity(row, column, components)]
                            )
            own = [vectors.load(source) for source in sources]
            before = [vectors.load(old) for old in olds]
            for row in range(components):
                moved = vectors.multiply_add(total[row], b_all, before[row])
                store(vectors.multiply_add(moved, a_all, own[row]), news[row])

        with cgutils.for_range_slice(builder, I64(0), count, I64(1), I64) as (number, _):
            vectors.in_chunks(n, lambda x, store: chunk(x, number, store))

    return sweep_intrinsic(emit, real)

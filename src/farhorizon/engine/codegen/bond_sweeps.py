"""Explicit SIMD for bonds that follow a law of their own stretch, one by one, and that break.

The force of a bond ``xi`` whose ends have moved apart by ``eta`` is ``c e h(e) (xi + eta)`` with ``e = |xi + eta|^2 /
xi|^2 - 1``, computed from ``eta`` without cancellation, and ``h(e) = 1 / (1 + e + sqrt(1 + e))``: the prototype
microelastic law ``c (|y| - |xi|) y / |y|``. Linearised it is ``c e/2 xi`` with ``e = 2 xi . eta / |xi|^2``. A bond
breaks where e exceeds a limit, which may be that of the weaker of its ends. The quantity that decides this is rounded
alike at both ends of a bond, because all factors change their sign there and the order of summation is fixed, so that
each end finds the same by itself. Absent bonds may carry compression, where e is below zero. Where the material varies,
c has a factor that follows from the coefficients of both ends, whichever comes first. Where heat strains the nodes, e
is reduced by the sum of the strains that both ends would have if they were free, which is twice their mean.

A bond that softens keeps a fraction of its stiffness, which each of its ends remembers: the smallest that its stretches
have left since the start, so that it unloads along the secant. With the stretch s, e/2 or ``|xi + eta| / |xi| - 1``,
and the limits s0 and s1 this is ``s0 (s1 - s) / (s (s1 - s0))`` where the force falls linearly, and ``s0/s exp(-2 (s -
s0) / (s1 - s0))`` where it decays; both dissipate the energy ``c |xi|^2 s0 s1 / 2``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from farhorizon.engine.codegen.numba_internals import cgutils
from farhorizon.engine.codegen.vectors import I64, Vectors

#: Nodes of a row that are swept together: one vector.
LANES = 8
#: Rows that are swept together, by components of the field: as many as have sums that stay in registers.
ROWS = {2: 4, 3: 2}
#: Columns of a bond in the table of integers: its distance in elements, its offset along the three axes.
PLACES = 4

#: How the force of a bond that is stretched beyond its limit falls to zero.
SOFTENINGS = ("linear", "exponential")

_INTEGERS = ir.VectorType(ir.IntType(64), LANES)


class TileAddresses(NamedTuple):
    """Byte addresses of what a sweep of tiles reads and writes, int64: of the first node in the levels and in arrays
    with a value per node, and of tables.
    """

    src: int
    base: int
    out: int
    coefficient: int
    alive: int  # bits of the bonds that are present
    strength: int
    stiffness: int  # by which strengths are divided that are energies
    closing: int  # bits of the bonds that carry compression in any case
    thermal_strain: int
    residual_stiffness: int  # fractions of their stiffness that bonds keep
    final: int  # stretches at which none is left
    history: int  # what bonds remember whose law is a function, number by number
    parameters: int  # of such a law, float64: 1 while histories rest, the time step, then its own
    broken: int  # energy, in units of c, and number of broken bonds, float64; bonds that soften add to them
    table: int  # bond by bond xi, 1 / |xi|^2 and c, without coefficients
    places: int  # bond by bond `PLACES` integers
    zone: int  # first node, then extent along each axis, int64
    excess: int  # numbers of each node near surfaces, one after the other as components of a level
    cosines: int  # bond by bond their weights in the factor of a spring


class TileShape(NamedTuple):
    """Where the nodes of tiles lie, int64; distances are in elements."""

    bonds: int  # of a node
    words: int  # distance between words of bits, and between the residual stiffnesses of one bond and the next
    nodes: int  # of a row
    rows: int
    step: int  # distance of rows
    apart: int  # distance of components
    i0: int  # coordinates of the first node
    i1: int
    i2: int


_ADDRESSES = types.NamedUniTuple(types.int64, len(TileAddresses._fields), TileAddresses)
_SHAPE = types.NamedUniTuple(types.int64, len(TileShape._fields), TileShape)


class BondLaw(NamedTuple):
    """What the code of a sweep depends on."""

    components: int  # of the field, 2 or 3
    nonlinear: bool
    real: str  # "float64" or "float32"
    rule: str | None = (
        None  # how the coefficients of both ends combine: "both", "arithmetic", "harmonic", or no coefficients
    )
    strengths: bool = False  # whether nodes have strengths of their own
    energies: str | None = None  # how stiffnesses of both ends combine, by which strengths are divided; None if by none
    contact: bool = False  # whether absent bonds carry compression
    thermal: bool = False  # whether heat strains the nodes
    softening: str | None = None  # one of `SOFTENINGS`; None where bonds break at once
    surface: int = 0  # how many numbers of nodes near surfaces determine the factors of bonds in damaged tiles


#: Addresses, places, and the reals a, b and limit, as values in the emitted code.
TileArguments = tuple[TileAddresses, TileShape, Any, Any, Any]


class Tile:
    """Up to `ROWS` rows of up to `LANES` nodes, the loop over their bonds, and the update in time. Rows that do not
    exist repeat the last one.

    The tile begins `first` nodes beyond the addresses in `args`.
    """

    def __init__(self, builder: ir.IRBuilder, args: TileArguments, law: BondLaw, first: Any) -> None:
        at, self.shape, self.a, self.b, limit = args
        self.builder, self.law = builder, law
        self.vectors = vectors = Vectors(builder, ir.DoubleType() if law.real == "float64" else ir.FloatType(), LANES)
        src, base, out = (vectors.shifted(start, (1, first)) for start in (at.src, at.base, at.out))
        self.at = at = at._replace(src=src, base=base, out=out)
        last = builder.sub(self.shape.rows, I64(1))
        self.rows = [
            builder.select(builder.icmp_signed("<", last, I64(row)), last, I64(row))
            for row in range(ROWS[law.components])
        ]
        self.limit = vectors.splat(limit)
        self.exists = self.below(first, self.shape.nodes)  # mask of the lanes with nodes
        self.own = [[vectors.load(self.place(at.src, row, c)) for c in range(law.components)] for row in self.rows]
        self.coefficient = vectors.shifted(at.coefficient, (1, first))
        self.coefficients = self.of_rows(self.coefficient, law.rule is not None)
        self.strength = vectors.shifted(at.strength, (1, first))
        self.strengths = self.of_rows(self.strength, law.strengths)
        self.stiffness_start = vectors.shifted(at.stiffness, (1, first))
        self.stiffnesses = self.of_rows(self.stiffness_start, law.energies is not None)
        self.thermal_strain = vectors.shifted(at.thermal_strain, (1, first))
        self.thermal_strains = self.of_rows(self.thermal_strain, law.thermal)
        self.final = vectors.shifted(at.final, (1, first))

    def parameter(self, number: int) -> Any:
        """One parameter of a law that is a function."""
        return self.builder.load(
            self.vectors.pointer(self.builder.add(self.at.parameters, I64(8 * number)), ir.DoubleType())
        )

    def of_rows(self, start: Any, used: bool) -> list[Any]:
        """Values of each row in an array of nodes that begins at `start`, if they are used."""
        return [self.vectors.load(self.place(start, row, 0)) for row in self.rows] if used else []

    def constant(self, value: float) -> Any:
        return ir.Constant(self.vectors.type, [value] * LANES)

    def below(self, first: Any, limit: Any) -> Any:
        """Mask of the lanes in which ``first + lane`` lies in 0..limit - 1."""
        values = self.builder.add(ir.Constant(_INTEGERS, list(range(LANES))), self.vectors.splat(first))
        return self.builder.icmp_unsigned("<", values, self.vectors.splat(limit))

    def place(self, start: Any, row: Any, component: int) -> Any:
        return self.vectors.shifted(start, (1, self.builder.mul(row, self.shape.step)), (component, self.shape.apart))

    def integer(self, address: Any, number: int) -> Any:
        return self.builder.load(self.vectors.pointer(self.builder.add(address, I64(8 * number)), ir.IntType(64)))

    def offset(self, bond: Any, column: int) -> Any:
        """One entry of a bond in the table of integers."""
        return self.integer(self.builder.add(self.at.places, self.builder.mul(bond, I64(8 * PLACES))), column)

    def call(self, name: str, *values: Any) -> Any:
        kind = self.vectors.type
        name = f"llvm.{name}.v{LANES}f{self.vectors.size * 8}"
        return self.builder.call(
            cgutils.get_or_insert_function(self.builder.module, ir.FunctionType(kind, [kind] * len(values)), name),
            values,
        )

    def any(self, mask: Any) -> Any:
        """Whether a lane of a mask is set."""
        bits = self.builder.bitcast(mask, ir.IntType(LANES))
        return self.builder.icmp_unsigned("!=", bits, ir.Constant(bits.type, 0))

    def differences(self, bond: Any, row: int) -> list[Any]:
        """``eta`` of one bond."""
        ends = self.ends(self.at.src, bond, row)
        return [self.builder.fsub(end, own) for end, own in zip(ends, self.own[row], strict=True)]

    def ends(self, level: Any, bond: Any, row: int) -> list[Any]:
        """Values of a level at the other end of a bond."""
        distance = self.offset(bond, 0)
        starts = [self.place(level, self.rows[row], c) for c in range(self.law.components)]
        return [self.vectors.load(self.vectors.shifted(start, (1, distance))) for start in starts]

    def differences_before(self, bond: Any, row: int) -> list[Any]:
        """``eta`` a step ago."""
        base, row_at = self.at.base, self.rows[row]
        before = [self.vectors.load(self.place(base, row_at, c)) for c in range(self.law.components)]
        return [self.builder.fsub(end, own) for end, own in zip(self.ends(base, bond, row), before, strict=True)]

    def stretch(self, xi: list[Any], inverse: Any, eta: list[Any], curved: Any = None) -> tuple[Any, list[Any]]:
        """``e`` and the direction of the force; `curved`: lanes in which the law is not linearised, by default all."""
        builder = self.builder
        direction, sums = xi, [builder.fadd(x, x) for x in xi]
        if self.law.nonlinear:
            y = [builder.fadd(x, d) for x, d in zip(xi, eta, strict=True)]
            both = [builder.fadd(v, x) for v, x in zip(y, xi, strict=True)]
            direction = y if curved is None else [builder.select(curved, v, x) for v, x in zip(y, xi, strict=True)]
            sums = both if curved is None else [builder.select(curved, s, t) for s, t in zip(both, sums, strict=True)]
        total = builder.fmul(eta[0], sums[0])
        for d, s in zip(eta[1:], sums[1:], strict=True):
            total = self.call("fma", d, s, total)
        return builder.fmul(total, inverse), direction

    def beyond(self, bond: Any, row: int, start: Any) -> Any:
        """Value at the other end of a bond in an array of nodes that begins at `start`."""
        return self.vectors.load(self.vectors.shifted(self.place(start, self.rows[row], 0), (1, self.offset(bond, 0))))

    def mechanical(self, e: Any, bond: Any, row: int, curved: Any = None) -> Any:
        """e less the thermal strains of both ends; `curved`: lanes in which the bond follows the law."""
        if not self.law.thermal:
            return e
        both = self.builder.fadd(self.thermal_strains[row], self.beyond(bond, row, self.thermal_strain))
        cold = self.builder.fsub(e, both)
        return cold if curved is None else self.builder.select(curved, cold, e)

    def bits(self, start: Any, bond: Any, row: int) -> tuple[Any, Any]:
        """Pointer to the words with the bits of a bond, among those from `start` on, and these words."""
        builder = self.builder
        word = builder.mul(builder.lshr(bond, I64(6)), self.shape.words)
        place = builder.add(start, builder.mul(builder.add(builder.mul(self.rows[row], self.shape.step), word), I64(8)))
        pointer = self.vectors.pointer(place, _INTEGERS)
        return pointer, builder.load(pointer, align=8)

    @property
    def bound(self) -> Any:
        """Value of `measured` above which a bond breaks."""
        return self.constant(0.0) if self.law.strengths else self.limit

    def measured(self, e: Any, bond: Any, row: int) -> Any:
        """The quantity that decides whether a bond breaks: e, or its excess over the limit of the weaker end."""
        return self.builder.fsub(e, self.limit_of(bond, row)) if self.law.strengths else e

    def limit_of(self, bond: Any, row: int) -> Any:
        """Largest e at which a bond stays as it is."""
        if not self.law.strengths:
            return self.limit
        builder, strength = self.builder, self.least(self.strengths[row], self.beyond(bond, row, self.strength))
        if self.law.energies is None:
            return builder.fmul(self.limit, strength)
        stiffness = self.combined(self.law.energies, self.stiffnesses[row], bond, row, self.stiffness_start)
        ratio = self.call("sqrt", builder.fdiv(strength, stiffness))
        if not self.law.nonlinear:
            return builder.fmul(self.limit, ratio)
        stretch = builder.fmul(self.bond_stretch(self.limit), ratio)
        return builder.fmul(stretch, builder.fadd(stretch, self.constant(2.0)))

    def least(self, a: Any, b: Any) -> Any:
        return self.builder.select(self.builder.fcmp_ordered("<", a, b), a, b)

    def bond_stretch(self, e: Any) -> Any:
        """Stretch of bonds that follow the law."""
        if not self.law.nonlinear:
            return self.builder.fmul(e, self.constant(0.5))
        unity = self.constant(1.0)
        root = self.call("sqrt", self.builder.fadd(e, unity))
        return self.builder.fdiv(e, self.builder.fadd(unity, root))

    def residual(self, e: Any, bond: Any, row: int) -> Any:
        """Fraction of a bond's stiffness that a stretch beyond the limit leaves; zero where both limits are equal."""
        builder = self.builder
        stretch, onset = self.bond_stretch(e), self.bond_stretch(self.limit_of(bond, row))
        here = self.vectors.load(self.place(self.final, self.rows[row], 0))
        final = self.least(here, self.beyond(bond, row, self.final))
        width = builder.fsub(final, onset)
        if self.law.softening == "linear":
            falls = builder.fdiv(builder.fsub(final, stretch), width)
        else:
            beyond = builder.fmul(self.constant(-2.0), builder.fsub(stretch, onset))
            falls = self.call("exp", builder.fdiv(beyond, width))
        left = builder.fmul(builder.fdiv(onset, stretch), falls)
        return builder.select(builder.fcmp_ordered(">", left, self.constant(0.0)), left, self.constant(0.0))

    def stiffness(self, uniform: Any, bond: Any, row: int) -> Any:
        """c of one bond from its value without coefficients, see `engine.bonds.bond_factor`."""
        if self.law.rule is None:
            return uniform
        mean = self.combined(self.law.rule, self.coefficients[row], bond, row, self.coefficient)
        return self.builder.fmul(uniform, mean)

    def combined(self, rule: str, near: Any, bond: Any, row: int, start: Any) -> Any:
        """Values of both ends of one bond, combined by a rule."""
        builder, far = self.builder, self.beyond(bond, row, start)
        if rule == "both":
            return self.least(near, far)
        total = builder.fadd(near, far)
        if rule == "arithmetic":
            return builder.fmul(total, self.constant(0.5))
        product = builder.fmul(builder.fmul(near, far), self.constant(2.0))
        return builder.select(
            builder.fcmp_ordered(">", total, self.constant(0.0)), builder.fdiv(product, total), self.constant(0.0)
        )

    def stiffened(self, stiffness: Any, bond: Any, row: int) -> Any:
        """c of one bond near a surface, see `engine.bonds.stiffening`."""
        if not self.law.surface:
            return stiffness
        builder, vectors, factor = self.builder, self.vectors, self.constant(1.0)
        weights = vectors.splat_all(vectors.shifted(self.at.cosines, (self.law.surface, bond)), self.law.surface)
        for number, weight in enumerate(weights):
            near = self.place(self.at.excess, self.rows[row], number)
            far = vectors.shifted(near, (1, self.offset(bond, 0)))
            factor = self.call("fma", weight, builder.fadd(vectors.load(near), vectors.load(far)), factor)
        return builder.fmul(stiffness, factor)

    def pull(self, e: Any, stiffness: Any, curved: Any = None) -> Any:
        """Factor of the direction in the force."""
        builder, half = self.builder, self.constant(0.5)
        if not self.law.nonlinear:
            return builder.fmul(builder.fmul(stiffness, e), half)
        q = builder.fadd(e, self.constant(1.0))
        h = builder.fdiv(self.constant(1.0), builder.fadd(q, self.call("sqrt", q)))
        return builder.fmul(builder.fmul(stiffness, e), h if curved is None else builder.select(curved, h, half))

    def over_bonds(self, carried: Any, force: Callable[..., tuple[Any, list[Any], Any]]) -> tuple[list[Any], Any]:
        """Sums of the forces over all bonds, row by row and component by component, and what is carried from bond to
        bond.

        ``force(bond, row, xi, inverse, stiffness, carried)`` returns the factor of the direction, the direction, and
        what is carried on.
        """
        builder, vectors, components = self.builder, self.vectors, self.law.components
        rows = range(len(self.rows))
        before, body, after = builder.block, builder.append_basic_block("bonds"), builder.append_basic_block("summed")
        builder.branch(body)
        builder.position_at_end(body)
        bond, kept = builder.phi(I64), builder.phi(carried.type)
        sums = [builder.phi(vectors.type) for _ in rows for _ in range(components)]
        phis = [bond, kept, *sums]
        for phi, first in zip(phis, [I64(0), carried, *[self.constant(0.0)] * len(sums)], strict=True):
            phi.add_incoming(first, before)
        entries = vectors.shifted(self.at.table, (components + 2, bond))
        *xi, inverse, stiffness = vectors.splat_all(entries, components + 2)
        grown = []
        for row in rows:
            factor, direction, kept = force(bond, row, xi, inverse, stiffness, kept)
            grown += [vectors.multiply_add(sums[row * components + c], factor, direction[c]) for c in range(components)]
        following = builder.add(bond, I64(1))
        for phi, value in zip(phis, [following, kept, *grown], strict=True):
            phi.add_incoming(value, builder.block)
        builder.cbranch(builder.icmp_signed("<", following, self.shape.bonds), body, after)
        builder.position_at_end(after)
        return grown, kept

    def update(self, sums: list[Any], n: Any) -> None:
        """Write ``out = a*src + b*base + sums``."""
        vectors = self.vectors
        a_all, b_all = vectors.splat(self.a), vectors.splat(self.b)
        store = vectors.store_first(n)
        for row, own in zip(self.rows, self.own, strict=True):
            for c in range(self.law.components):
                total = vectors.multiply_add(sums.pop(0), b_all, vectors.load(self.place(self.at.base, row, c)))
                store(vectors.multiply_add(total, a_all, own[c]), self.place(self.at.out, row, c))


def _intact(builder: ir.IRBuilder, args: TileArguments, law: BondLaw) -> Any:
    """Sweep successive tiles that have all their bonds, within the zone; return their number, up to the first tile of
    which a bond is about to break.
    """
    n = args[1].nodes
    swept = cgutils.alloca_once_value(builder, I64(0))
    tiles = builder.sdiv(builder.add(n, I64(LANES - 1)), I64(LANES))
    with cgutils.for_range(builder, tiles) as loop:
        first = builder.mul(loop.index, I64(LANES))
        left = builder.sub(n, first)
        breaks = _sweep_intact(
            Tile(builder, args, law, first),
            builder.select(builder.icmp_signed("<", left, I64(LANES)), left, I64(LANES)),
        )
        with builder.if_then(breaks):
            loop.do_break()
        builder.store(builder.add(loop.index, I64(1)), swept)
    return builder.load(swept)


def _sweep_intact(tile: Tile, n: Any) -> Any:
    """Sweep one of them; nothing is written if a bond is about to break."""
    builder = tile.builder

    def force(bond: Any, row: int, xi: list[Any], inverse: Any, stiffness: Any, top: Any) -> tuple[Any, list[Any], Any]:
        e, direction = tile.stretch(xi, inverse, tile.differences(bond, row))
        e = tile.mechanical(e, bond, row)
        measured = tile.measured(e, bond, row)
        return (
            tile.pull(e, tile.stiffness(stiffness, bond, row)),
            direction,
            builder.select(builder.fcmp_ordered(">", measured, top), measured, top),
        )

    sums, top = tile.over_bonds(tile.constant(-1.0), force)
    breaks = tile.any(builder.and_(builder.fcmp_ordered(">", top, tile.bound), tile.exists))
    with builder.if_then(builder.not_(breaks)):
        tile.update(sums, n)
    return breaks


def _soften(
    tile: Tile, bond: Any, row: int, material: tuple[list[Any], Any, Any], e: Any, curved: Any, over: Any
) -> tuple[Any, Any]:
    """Residual stiffness of bonds some of which are `over` their limits, and mask of those that end.

    `material` is xi, ``1 / |xi|^2`` and c. The energy that they lose, ``c d d' / 2`` with the elongations d now and d'
    a step ago, is added up, half of it at either end, and so is the number of bonds that end.
    """
    builder, vectors, real = tile.builder, tile.vectors, ir.DoubleType()
    xi, inverse, stiffness = material
    place = tile.place(
        vectors.shifted(tile.at.residual_stiffness, (1, builder.mul(bond, tile.shape.words))), tile.rows[row], 0
    )
    before = vectors.load(place)
    entry = builder.block
    with builder.if_then(tile.any(over)):
        now = builder.select(over, tile.least(tile.residual(e, bond, row), before), before)
        vectors.store(now, place)
        ago = tile.stretch(xi, inverse, tile.differences_before(bond, row), curved)[0]
        both = builder.fmul(tile.bond_stretch(e), tile.bond_stretch(tile.mechanical(ago, bond, row, curved)))
        energy = builder.fmul(builder.fmul(builder.fsub(before, now), builder.fdiv(stiffness, inverse)), both)
        energy = builder.select(over, energy, tile.constant(0.0))
        lanes = [builder.extract_element(energy, ir.IntType(32)(lane)) for lane in range(LANES)]
        lost = vectors.sum([lane if lane.type == real else builder.fpext(lane, real) for lane in lanes])
        ends = builder.and_(over, builder.fcmp_ordered("<=", now, tile.constant(0.0)))
        number = builder.uitofp(builder.ctpop(builder.bitcast(ends, ir.IntType(LANES))), real)
        for column, (value, fraction) in enumerate(((lost, 0.25), (number, 0.5))):
            pointer = vectors.pointer(builder.add(tile.at.broken, I64(8 * column)), real)
            gain = builder.fmul(value, ir.Constant(real, fraction))
            builder.store(builder.fadd(builder.load(pointer), gain), pointer)
        softened = builder.block
    none = ir.Constant(ir.VectorType(ir.IntType(1), LANES), [0] * LANES)
    results = []
    for new, old in ((now, before), (ends, none)):
        phi = builder.phi(new.type)
        phi.add_incoming(new, softened)
        phi.add_incoming(old, entry)
        results.append(phi)
    return results[0], results[1]


def damaged_tile(
    builder: ir.IRBuilder, args: TileArguments, law: BondLaw, response: Callable[[Tile], Any] | None = None
) -> Any:
    """Sweep a tile that lacks bonds, or with bonds that leave the zone; return 1 if some have broken now.

    The `response` of bonds whose law is a function is made for the tile, see `bond_functions.Response`.
    """
    tile = Tile(builder, args, law, I64(0))
    respond = None if response is None else response(tile)
    vectors = tile.vectors
    none = ir.Constant(ir.VectorType(ir.IntType(1), LANES), [0] * LANES)
    i0, i1, i2 = tile.shape.i0, tile.shape.i1, tile.shape.i2

    def within(position: Any, axis: int) -> Any:
        zone = tile.at.zone
        return builder.icmp_unsigned("<", builder.sub(position, tile.integer(zone, axis)), tile.integer(zone, 3 + axis))

    def force(
        bond: Any, row: int, xi: list[Any], inverse: Any, stiffness: Any, changed: Any
    ) -> tuple[Any, list[Any], Any]:
        o0, o1, o2 = (tile.offset(bond, 1 + axis) for axis in range(3))
        outer = builder.and_(
            within(builder.add(i0, o0), 0), within(builder.add(builder.add(i1, tile.rows[row]), o1), 1)
        )
        start, extent = tile.integer(tile.at.zone, 2), tile.integer(tile.at.zone, 5)
        lanes = tile.below(builder.sub(builder.add(i2, o2), start), extent)
        curved = builder.select(outer, lanes, none)
        pointer, bits = tile.bits(tile.at.alive, bond, row)
        bit = vectors.splat(builder.shl(I64(1), builder.and_(bond, I64(63))))
        unset = ir.Constant(_INTEGERS, [0] * LANES)
        alive = builder.icmp_unsigned("!=", builder.and_(bits, bit), unset)
        e, direction = tile.stretch(xi, inverse, tile.differences(bond, row), curved)
        e = tile.mechanical(e, bond, row, curved)
        over = builder.and_(
            builder.and_(builder.fcmp_ordered(">", tile.measured(e, bond, row), tile.bound), curved),
            builder.and_(alive, tile.exists),
        )
        stiffness = tile.stiffened(tile.stiffness(stiffness, bond, row), bond, row)
        full = pull = tile.pull(e, stiffness, curved)
        if law.softening:
            left, over = _soften(tile, bond, row, (xi, inverse, stiffness), e, curved, over)
            pull = builder.fmul(pull, left)
        if respond is not None:
            pull, over = respond(bond, row, (xi, inverse, stiffness), e, pull, curved, alive)
        factor = builder.select(builder.and_(alive, builder.not_(over)), pull, tile.constant(0.0))
        if law.contact:
            closes = builder.icmp_unsigned("!=", builder.and_(tile.bits(tile.at.closing, bond, row)[1], bit), unset)
            shorter = builder.and_(builder.fcmp_ordered("<", e, tile.constant(0.0)), curved)
            factor = builder.select(builder.and_(closes, shorter), full, factor)
        breaks = tile.any(over)
        with builder.if_then(breaks):
            builder.store(builder.select(over, builder.and_(bits, builder.not_(bit)), bits), pointer, align=8)
        return factor, direction, builder.or_(changed, builder.zext(breaks, I64))

    sums, changed = tile.over_bonds(I64(0), force)
    tile.update(sums, args[1].nodes)
    return changed


def bond_sweep(law: BondLaw, damaged: bool) -> Any:
    """Make the intrinsic that writes ``out = a*src + b*base + sum over the bonds`` on tiles, given `TileAddresses`, a
    `TileShape`, a, b and the limit. A bond within the zone follows the law and may break, others are linearised.

    On a `damaged` tile it checks the bits of the bonds and the ends of the zone, clears the bits of bonds that break,
    and returns whether one does. On intact ones, of which there may be many in a row, it returns the number that it has
    swept: up to the first of which a bond is about to break, where nothing is written.
    """

    @intrinsic
    def sweep(typingctx, at, shape, a, b, limit):
        def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
            return (damaged_tile if damaged else _intact)(builder, unpacked(builder, args), law)

        return bond_signature(law.real), codegen

    return sweep


def steepness(components: int, real: str) -> Any:
    """Make the intrinsic that returns the sum of the squares of the largest differences between neighbours, of each
    component along each axis.

    For a field that is linear between the nodes its root bounds the stretch of every bond between the nodes examined:
    that of ``xi`` is ``n . (D n)`` over the spacing for a matrix D whose entries are no larger than those differences.

    The intrinsic takes the byte address of the first node, the numbers of planes, rows and nodes of a row, and the
    distances of planes, rows and components, in elements. It examines whole vectors, and one neighbour beyond.
    """

    @intrinsic
    def measure(typingctx, src, planes, rows, n, step0, step1, apart):
        def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
            src, planes, rows, n, step0, step1, apart = args
            vectors = Vectors(builder, ir.DoubleType() if real == "float64" else ir.FloatType(), LANES)
            magnitude = cgutils.get_or_insert_function(
                builder.module, ir.FunctionType(vectors.type, [vectors.type]), f"llvm.fabs.v{LANES}f{vectors.size * 8}"
            )
            steps = [step0, step1, I64(1)][3 - components :]
            zero = ir.Constant(vectors.type, [0.0] * LANES)
            tops = [cgutils.alloca_once_value(builder, zero) for _ in range(components * len(steps))]
            with cgutils.for_range(builder, planes) as plane, cgutils.for_range(builder, rows) as row:
                line = vectors.shifted(src, (1, builder.mul(plane.index, step0)), (1, builder.mul(row.index, step1)))
                with cgutils.for_range_slice(builder, I64(0), n, I64(LANES), I64) as (x, _):
                    for number, top in enumerate(tops):
                        here = vectors.shifted(line, (1, x), (number // len(steps), apart))
                        ahead = vectors.load(vectors.shifted(here, (1, steps[number % len(steps)])))
                        size = builder.call(magnitude, [builder.fsub(ahead, vectors.load(here))])
                        before = builder.load(top)
                        builder.store(builder.select(builder.fcmp_ordered(">", size, before), size, before), top)
            total = ir.Constant(ir.DoubleType(), 0.0)
            for top in tops:
                values = [builder.extract_element(builder.load(top), ir.IntType(32)(lane)) for lane in range(LANES)]
                while len(values) > 1:
                    values = [
                        builder.select(builder.fcmp_ordered(">", a, b), a, b)
                        for a, b in zip(values[::2], values[1::2], strict=True)
                    ]
                largest = values[0] if real == "float64" else builder.fpext(values[0], ir.DoubleType())
                total = builder.fadd(total, builder.fmul(largest, largest))
            return total

        return STEEPNESS_SIGNATURE, codegen

    return measure


STEEPNESS_SIGNATURE = types.float64(*[types.int64] * 7)


@intrinsic
def call_steepness(typingctx, function, src, planes, rows, n, step0, step1, apart):
    """Call a compiled `steepness` by its address."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        kind = ir.FunctionType(ir.DoubleType(), [arg.type for arg in args[1:]])
        return builder.call(builder.inttoptr(args[0], kind.as_pointer()), args[1:])

    return types.float64(*[types.int64] * 8), codegen


def unpacked(builder: ir.IRBuilder, args: tuple[Any, ...]) -> TileArguments:
    """The arguments of a sweep as values in the emitted code."""
    at, shape, *reals = args
    tuples = (list(cgutils.unpack_tuple(builder, value)) for value in (at, shape))
    return TileAddresses(*next(tuples)), TileShape(*next(tuples)), *reals


def bond_signature(real: str) -> Any:
    """Numba signature of the sweep of tiles."""
    return types.int64(_ADDRESSES, _SHAPE, *[getattr(types, real)] * 3)


@intrinsic
def call_bonds(typingctx, function, at, shape, a, b, limit):
    """Call a compiled sweep of tiles by its address, so that the driver need not be compiled again for every law."""
    signature = types.int64(types.int64, _ADDRESSES, _SHAPE, a, a, a)

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        kind = ir.FunctionType(I64, [arg.type for arg in args[1:]])
        return builder.call(builder.inttoptr(args[0], kind.as_pointer()), args[1:])

    return signature, codegen

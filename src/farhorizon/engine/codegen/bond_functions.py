"""Laws of bonds that are functions: what a tile calls for each of its lanes, compiled by Numba into its sweep.

A law has the energy ``E(s, h)`` of a bond with the stretch s and the history h, in units of its stiffness times its
squared length, the force ``dE/ds``, and the step from one history to the next. With the polar form ``P(s, s'; h) =
2 E((s + s')/2, h) - (E(s, h) + E(s', h))/2``, which is ``s s'/2`` for a spring, and s' the stretch a step ago, velocity
Verlet conserves kinetic energy plus P to rounding while h rests, if E is a square of s. So exactly ``P(s, s'; h') -
P(s, s'; h)`` is lost when h' becomes h.
"""

from __future__ import annotations

import functools
from functools import cache
from typing import Any, NamedTuple

import numba
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from farhorizon.engine.codegen.bond_sweeps import LANES, BondLaw, Tile, bond_signature, damaged_tile, unpacked
from farhorizon.engine.codegen.numba_internals import Flags, cgutils
from farhorizon.engine.codegen.vectors import I64

#: What a function of a law may ask for by name, beside its history and its parameters: the stretch and the length of
#: the bond; for the step from one history to the next also the stretch of the step before, and the time step.
GIVEN, OF_STEP = ("stretch", "length"), ("before", "dt")


class BondFunctions(NamedTuple):
    """The functions of a law, compiled by Numba, and the names of their arguments. None of them reads anything else."""

    update: Any  # from one history to the next; None if there is no history
    force: Any
    energy: Any  # None: half the force times the stretch
    damage: Any  # fraction of the stiffness that is lost; None if bonds never break
    history: tuple[str, ...]
    start: tuple[float, ...]  # of the history
    parameters: tuple[str, ...]
    arguments: tuple[tuple[str, tuple[str, ...]], ...]  # of each function by its name

    def call(self, name: str, **by_name: str) -> str:
        """Text of the call of one of the functions, with texts of arguments where they differ from their names."""
        return f"{name}({', '.join(by_name.get(argument, argument) for argument in dict(self.arguments)[name])})"

    @property
    def needs_before(self) -> bool:
        """Whether the history depends on the stretch of the step before."""
        return "before" in dict(self.arguments).get("update", ())


def _made(functions: BondFunctions, lines: list[str]) -> Any:
    """The function `made` whose text is given, which calls those of a law."""
    scope: dict[str, Any] = {"__name__": __name__}
    scope |= {name: getattr(functions, name) for name in ("update", "force", "energy", "damage")}
    exec("\n".join(lines), scope)  # the text is made here, of names that are identifiers
    return scope["made"]


def _energy(functions: BondFunctions, stretch: str, history: dict[str, str]) -> str:
    """Text of the energy at a stretch."""
    if functions.energy is not None:
        return functions.call("energy", stretch=stretch, **history)
    return f"0.5 * ({stretch}) * {functions.call('force', stretch=stretch, **history)}"


def _polar(functions: BondFunctions, history: dict[str, str]) -> str:
    """Text of the polar form of the energy."""
    middle, now, ago = (_energy(functions, at, history) for at in ("0.5 * (stretch + before)", "stretch", "before"))
    return f"2 * {middle} - 0.5 * ({now} + {ago})"


class Lane(NamedTuple):
    """A function of numbers, and the names of those that it takes, without time step, length and parameters, and
    returns.
    """

    function: Any
    takes: tuple[str, ...]
    returns: tuple[str, ...]


def _lane(functions: BondFunctions, takes: list[str], lines: list[str], returns: dict[str, str]) -> Lane:
    """A function with these lines and results, by name."""
    head = f"def made({', '.join([*takes, 'dt', 'length', *functions.parameters])}):"
    last = f"return ({' '.join(f'float({text}),' for text in returns.values())})"
    return Lane(_made(functions, [head, *(f"    {line}" for line in [*lines, last])]), tuple(takes), tuple(returns))


@cache
def advance(functions: BondFunctions) -> Lane:
    """History and force of a bond; the history rests unless the bond is active."""
    history = functions.history
    lines = []
    if history:  # no branch around the update: lanes are computed together
        following = {name: f"old_{name}" for name in history}
        lines += [f"{', '.join(f'next_{name}' for name in history)} = {functions.call('update', **following)}"]
        lines += [f"{name} = next_{name} if active != 0 else old_{name}" for name in history]
    force = {"force": functions.call("force")}
    return _lane(
        functions,
        ["stretch", "before", "active", *(f"old_{name}" for name in history)],
        lines,
        {name: name for name in history} | force,
    )


@cache
def losses(functions: BondFunctions) -> Lane:
    """Energy that a bond loses as its history changes, and the fraction of its stiffness that is lost then."""
    old = {name: f"old_{name}" for name in functions.history}
    lost = f"{_polar(functions, old)} - ({_polar(functions, {})})"
    gone = functions.call("damage") if functions.damage is not None else "0.0"
    return _lane(functions, ["stretch", "before", *old.values(), *old], [], {"lost": lost, "gone": gone})


@cache
def stored(functions: BondFunctions) -> Any:
    """Compiled function that computes the polar form of the energies of bonds, given arrays of stretches, of those a
    step ago and of histories, into an array of the same shape, (n,).
    """
    arrays = ["stretch", "before", *functions.history, "energy_of"]
    scalars = ["dt", "length", *functions.parameters]
    lines = [f"def made({', '.join([*(f'all_{name}' for name in arrays), *scalars])}):"]
    lines += ["    for i in range(len(all_stretch)):", *(f"        {name} = all_{name}[i]" for name in arrays[:-1])]
    lines += [f"        all_energy_of[i] = {_polar(functions, {})}"]
    return numba.njit(error_model="numpy")(_made(functions, lines))


def _as_vectors(module: ir.Module) -> Any:
    """Metadata of a loop that LLVM turns into vectors instead of unrolling it first, whatever it thinks of the cost."""
    truth, lanes = ir.Constant(ir.IntType(1), 1), ir.Constant(ir.IntType(32), LANES)
    options = [
        module.add_metadata([ir.MetaDataString(module, "llvm.loop.vectorize.enable"), truth]),
        module.add_metadata([ir.MetaDataString(module, "llvm.loop.vectorize.width"), lanes]),
        module.add_metadata([ir.MetaDataString(module, "llvm.loop.unroll.disable")]),
    ]
    loop = module.add_metadata([ir.MetaDataString(module, f"loop {len(module.metadata)}")])
    loop.operands = (loop, *options)  # the first operand of a loop is the loop itself
    return loop


class Response:
    """What the bonds of a tile respond by such a law: their forces, and which of them end."""

    def __init__(self, tile: Tile, functions: BondFunctions, context: Any) -> None:
        self.tile, self.functions, self.context, self.builder = tile, functions, context, tile.builder
        self.double = ir.VectorType(ir.DoubleType(), LANES)
        # read once, before the loop over bonds, so that what depends on them alone is computed there
        frozen, self.dt, *self.parameters = (tile.parameter(number) for number in range(2 + len(functions.parameters)))
        moves = self.builder.fcmp_ordered("==", frozen, ir.Constant(ir.DoubleType(), 0.0))
        self.moves = tile.vectors.splat(moves)
        self.room: dict[str, Any] = {}

    def wide(self, vector: Any) -> Any:
        """A vector in double precision."""
        return vector if vector.type == self.double else self.builder.fpext(vector, self.double)

    def narrow(self, vector: Any) -> Any:
        """A vector of doubles in the precision of the run."""
        kind = self.tile.vectors.type
        return vector if vector.type == kind else self.builder.fptrunc(vector, kind)

    def call(self, lane: Lane, length: Any, given: dict[str, Any]) -> dict[str, Any]:
        """Call a function lane by lane, given vectors of doubles by name; return vectors by name."""
        builder, real = self.builder, ir.DoubleType()
        for name in (*lane.takes, *lane.returns):
            if name not in self.room:  # in the entry block, so that a loop does not take more and more of the stack
                self.room[name] = cgutils.alloca_once(builder, self.double, name=name)
        for name in lane.takes:
            builder.store(given[name], self.room[name])
        first = {name: builder.bitcast(pointer, real.as_pointer()) for name, pointer in self.room.items()}
        scalars = [self.dt, length, *self.parameters]
        result = types.UniTuple(types.float64, len(lane.returns))
        signature = result(*[types.float64] * (len(lane.takes) + len(scalars)))
        flags: Any = Flags()
        flags.error_model = "numpy"
        # without Numba's cache, which knows a function by its text alone
        compiled = self.context.compile_subroutine(builder, lane.function, signature, flags=flags, caching=False)
        before, body, after = builder.block, *(builder.append_basic_block(name) for name in ("lane", "lanes_done"))
        builder.branch(body)
        builder.position_at_end(body)
        index = builder.phi(I64)
        values = [builder.load(builder.gep(first[name], [index])) for name in lane.takes]
        results = self.context.call_internal(builder, compiled.fndesc, signature, [*values, *scalars])
        for name, value in zip(lane.returns, cgutils.unpack_tuple(builder, results), strict=True):
            builder.store(value, builder.gep(first[name], [index]))
        following = builder.add(index, I64(1))
        index.add_incoming(I64(0), before)
        index.add_incoming(following, builder.block)
        turn = builder.cbranch(builder.icmp_signed("<", following, I64(LANES)), body, after)
        turn.set_metadata("llvm.loop", _as_vectors(builder.module))
        builder.position_at_end(after)
        return {name: builder.load(self.room[name]) for name in lane.returns}

    def place(self, number: int, bond: Any, row: int) -> Any:
        """Address of one number of the history of a bond."""
        tile, builder = self.tile, self.builder
        line = builder.add(bond, builder.mul(I64(number), tile.shape.bonds))
        start = tile.vectors.shifted(tile.at.history, (1, builder.mul(line, tile.shape.words)))
        return tile.place(start, tile.rows[row], 0)

    def before(self, bond: Any, row: int, material: tuple[list[Any], Any, Any], curved: Any) -> Any:
        """Stretches a step ago."""
        tile, (xi, inverse, _) = self.tile, material
        ago = tile.stretch(xi, inverse, tile.differences_before(bond, row), curved)[0]
        return self.wide(tile.bond_stretch(tile.mechanical(ago, bond, row, curved)))

    def __call__(
        self, bond: Any, row: int, material: tuple[list[Any], Any, Any], e: Any, pull: Any, curved: Any, alive: Any
    ) -> tuple[Any, Any]:
        """Factor of the direction in the force, which is `pull` for springs, and mask of bonds that end.

        `material` is xi, ``1 / |xi|^2`` and c; bonds that are not `curved` are springs. Rows that do not exist repeat
        the last one: its history moves once.
        """
        tile, builder, functions = self.tile, self.builder, self.functions
        stretch = tile.bond_stretch(e)
        exists = tile.vectors.splat(builder.icmp_signed("<", I64(row), tile.shape.rows))
        active = functools.reduce(builder.and_, (alive, curved, tile.exists, exists, self.moves))
        length: Any = ir.Constant(ir.DoubleType(), 0.0)
        if any("length" in names for _, names in functions.arguments):
            first = builder.extract_element(self.wide(material[1]), ir.IntType(32)(0))
            root = cgutils.get_or_insert_function(
                builder.module, ir.FunctionType(ir.DoubleType(), [ir.DoubleType()]), "llvm.sqrt.f64"
            )
            length = builder.fdiv(ir.Constant(ir.DoubleType(), 1.0), builder.call(root, [first]))
        given = {"stretch": self.wide(stretch), "active": builder.uitofp(active, self.double)}
        places = [self.place(number, bond, row) for number in range(len(functions.history))]
        old = {f"old_{name}": tile.vectors.load(at) for name, at in zip(functions.history, places, strict=True)}
        # the others are springs that remember nothing
        busy = builder.fcmp_ordered(">", e, tile.limit)
        for value, start in zip(old.values(), functions.start, strict=True):
            busy = builder.or_(busy, builder.fcmp_unordered("!=", value, tile.constant(start)))
        old = {name: self.wide(value) for name, value in old.items()}
        none = ir.Constant(ir.VectorType(ir.IntType(1), LANES), [0] * LANES)
        entry = builder.block
        with builder.if_then(tile.any(builder.and_(busy, curved))):
            given["before"] = self.before(bond, row, material, curved) if functions.needs_before else given["stretch"]
            new = self.call(advance(functions), length, given | old)
            force = self.narrow(new.pop("force"))
            if tile.law.nonlinear:
                # c |xi| f along the deformed bond, whose length is sqrt(1 + e) |xi|
                force = builder.fdiv(force, tile.call("sqrt", builder.fadd(e, tile.constant(1.0))))
            # springs rest as they are in intact tiles, to the last bit
            responds = builder.and_(busy, curved)
            responded = builder.select(responds, builder.fmul(material[2], force), pull)
            ended = self._remember(bond, row, material, length, curved, (given, old, new, places))
            computed = builder.block
        factor, ends = builder.phi(pull.type), builder.phi(none.type)
        for phi, value, otherwise in ((factor, responded, pull), (ends, ended, none)):
            phi.add_incoming(value, computed)
            phi.add_incoming(otherwise, entry)
        return factor, ends

    def _remember(
        self,
        bond: Any,
        row: int,
        material: tuple[list[Any], Any, Any],
        length: Any,
        curved: Any,
        histories: tuple[dict[str, Any], dict[str, Any], dict[str, Any], list[Any]],
    ) -> Any:
        """Store histories where some have changed, and add up what these bonds lose; return the mask of those that end.

        Half of the energy and of the number of bonds that end is counted at either end.
        """
        tile, builder, real = self.tile, self.builder, ir.DoubleType()
        given, old, new, places = histories
        none = ir.Constant(ir.VectorType(ir.IntType(1), LANES), [0] * LANES)
        # a nan differs from everything: it is stored, and spreads to the field, where it is found
        changed = [builder.fcmp_unordered("!=", new[name], old[f"old_{name}"]) for name in new]
        if not changed:
            return none
        some = functools.reduce(builder.or_, changed)
        entry = builder.block
        with builder.if_then(tile.any(some)):
            for name, at in zip(new, places, strict=True):
                tile.vectors.store(self.narrow(new[name]), at)
            ago = given["before"] if self.functions.needs_before else self.before(bond, row, material, curved)
            found = self.call(losses(self.functions), length, {"stretch": given["stretch"], "before": ago} | old | new)
            scale = self.wide(builder.fdiv(material[2], material[1]))
            energy = builder.select(some, builder.fmul(found["lost"], scale), ir.Constant(self.double, [0.0] * LANES))
            lanes = [builder.extract_element(energy, ir.IntType(32)(lane)) for lane in range(LANES)]
            gone = builder.fcmp_ordered(">=", found["gone"], ir.Constant(self.double, [1.0] * LANES))
            ended = builder.and_(some, gone)
            left = builder.fsub(ir.Constant(self.double, [1.0] * LANES), found["gone"])
            number = builder.mul(bond, tile.shape.words)
            place = tile.place(tile.vectors.shifted(tile.at.residual_stiffness, (1, number)), tile.rows[row], 0)
            tile.vectors.store(builder.select(some, self.narrow(left), tile.vectors.load(place)), place)
            count = builder.uitofp(builder.ctpop(builder.bitcast(ended, ir.IntType(LANES))), real)
            for column, value in enumerate((tile.vectors.sum(lanes), count)):
                pointer = tile.vectors.pointer(builder.add(tile.at.broken, I64(8 * column)), real)
                gain = builder.fmul(value, ir.Constant(real, 0.5))
                builder.store(builder.fadd(builder.load(pointer), gain), pointer)
            remembered = builder.block
        phi = builder.phi(none.type)
        phi.add_incoming(ended, remembered)
        phi.add_incoming(none, entry)
        return phi


@cache
def function_sweep(law: BondLaw, functions: BondFunctions) -> Any:
    """Compiled sweep of a damaged tile whose bonds have such a law; it lives as long as the program."""

    @intrinsic
    def sweep(typingctx: Any, at: Any, shape: Any, a: Any, b: Any, limit: Any) -> Any:
        def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
            return damaged_tile(builder, unpacked(builder, args), law, lambda tile: Response(tile, functions, context))

        return bond_signature(law.real), codegen

    call: Any = sweep  # as Numba does, without the typing context

    def damaged(at: Any, shape: Any, a: Any, b: Any, limit: Any) -> Any:
        return call(at, shape, a, b, limit)

    return numba.cfunc(bond_signature(law.real))(damaged)

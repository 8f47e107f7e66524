"""The compiled time loop: it works through tables of operations, and calls each by its address.

Its arguments are numbers and addresses only, so that it is compiled once, whatever the run. An operation is compiled
when a run first needs it, for the types of the tables that it reads.
"""

from __future__ import annotations

import threading
from collections import namedtuple
from collections.abc import Set
from functools import cache
from typing import Any

import numpy as np
from numba import types

from farhorizon.engine import layer_program, program, sweep_program
from farhorizon.engine.bonds import PHASES
from farhorizon.engine.codegen.calls import call_operation
from farhorizon.engine.codegen.compile_notice import importing
from farhorizon.engine.codegen.compiled import cfunc, njit
from farhorizon.engine.codegen.structs import Struct
from farhorizon.engine.feature_list import FEATURES, steps
from farhorizon.engine.layers import COLUMNS, Layers
from farhorizon.engine.layout import with_defaults
from farhorizon.engine.passes import (
    AHEAD,
    BOND_STENCIL,
    BREAK,
    DAMAGED,
    DIVERGENCE,
    GRADIENT,
    INFLOW,
    LINES,
    NEIGHBOURS,
    OPERATIONS,
    PUSHES,
    READS,
    RELEASE,
    STRETCH,
    STRETCH_FORCES,
    STRETCH_STATES,
    SWEEP,
    TRACES,
    Function,
    pass_of,
)
from farhorizon.engine.tables import ABSENT, EDGE, FACE, GENERAL, Inputs, Media, Stage, Sums, Tables
from farhorizon.engine.threads import ALONE, side_by_side

_STEP = -1  # the stage from the level before a step of several stages to that after it
# operations on states that take the stage and the sums of the field
_OF_THE_FIELD = (BREAK, RELEASE, DAMAGED, STRETCH_STATES, STRETCH_FORCES)
# passes whose plain sums are made elsewhere, so that no sweep, at whose end threads meet, follows their lines
_UNSWEPT = (TRACES, NEIGHBOURS)
# passes whose bonds have coefficients
_OF_BONDS = (BOND_STENCIL, PUSHES, TRACES, INFLOW)
_COUNTED = ("general_rows", "general_matrix_rows")  # they create arrays

_FUNCTIONS: dict[tuple[Function, tuple[types.Type, ...]], Any] = {}
_COMPILING = threading.RLock()  # simulations may run in parallel


@njit(nogil=True, cache=True, counted=False, entry=True)
def run(thread: int, steps: int, phase: int, calls: np.ndarray, inputs: int) -> None:
    """Do one thread's part of `steps` steps, beginning with the rotation `phase`, after which the level
    ``tables.rotation[(phase + steps) % rotations, 0, 0]`` holds the state. `thread` and `inputs` are addresses;
    `calls`, shape (rotations, n, 5), says what to do in a step: addresses of functions, stages, sums and tables, and a
    number.
    """
    for step in range(steps):
        for i in range(calls.shape[1]):
            function, stage, sums, tables, number = calls[phase, i]
            call_operation(function, thread, stage, sums, tables, inputs, step, number)
        phase = (phase + 1) % calls.shape[0]


class CompiledLoop:
    """Works through tables of operations in machine code. It keeps what it has made of the last tables, because most
    calls have the same ones; those of a loop `beside` it may have much in common with the next ones.
    """

    def __init__(self, beside: CompiledLoop | None = None) -> None:
        self._levels: np.ndarray | None = None
        self._tables: Tables | None = None
        self._inputs: Struct | None = None if beside is None else beside._inputs
        self._calls = np.zeros((1, 0, 5), np.int64)
        self._kept: list[Struct] = []  # structs whose addresses the calls contain
        self._known: dict[int, Struct] = {} if beside is None else beside._known

    def __reduce__(self) -> tuple[type[CompiledLoop], tuple[()]]:
        return CompiledLoop, ()  # a copy has arrays of its own

    def __call__(
        self, steps: int, phase: int, levels: np.ndarray, tables: Tables, inputs: Inputs, threads: int
    ) -> None:
        """Do `steps` steps of the tables on some threads."""
        outside = self._inputs
        if outside is None or outside.table is not inputs:
            outside = Struct(inputs, outside)
        if not self._serves(levels, tables, outside):
            self._known = _still_known(tables, self._known)
            self._kept, self._calls = _calls(levels, tables, outside, self._known)
        self._levels, self._tables, self._inputs = levels, tables, outside
        calls, address = self._calls, outside.address
        side_by_side(lambda thread: run(thread.address, steps, phase, calls, address), threads)

    def _serves(self, levels: np.ndarray, tables: Tables, inputs: Struct) -> bool:
        """Whether the calls made last time are still valid."""
        if levels is not self._levels or self._tables is None or self._inputs is None:
            return False
        return inputs.type is self._inputs.type and (tables is self._tables or _alike(tables, self._tables))


def _alike(tables: Tables, before: Tables) -> bool:
    """Whether tables are the same objects, except that operations need only be equal."""
    return tables.operations == before.operations and all(
        value is getattr(before, name) for name, value in vars(tables).items() if name != "operations"
    )


def _still_known(tables: Tables, known: dict[int, Struct]) -> dict[int, Struct]:
    """The known structs of tables that are still in use."""
    used = {id(table): known[id(table)] for table in vars(tables).values() if id(table) in known}
    return used | {key: struct for each in used.values() for key, struct in each.known().items()}


@cache
def _named(names: tuple[str, ...]) -> Any:
    """Class of named tuples."""
    return namedtuple("Tables", names)


def _calls(
    levels: np.ndarray, tables: Tables, inputs: Struct, known: dict[int, Struct]
) -> tuple[list[Struct], np.ndarray]:
    """The calls of a step in each rotation of the levels, and the structs whose addresses they contain; `known` are
    structs of tables by their identity.
    """
    lists = tables.operations
    passes = sorted({which for operations in lists for _, _, which in operations} | {BOND_STENCIL})
    split = {which for operations in lists for operation, _, which in operations if operation == AHEAD}
    swept = {which for operations in lists for operation, _, which in operations if operation in (SWEEP, AHEAD)}
    done = {operation for operations in lists for operation, _, _ in operations}
    parts = {which: _on_parts(tables, which, which in split, done) if which in swept else ([], []) for which in passes}
    sums = {which: _sums(tables, which, known, *map(len, parts[which])) for which in passes}
    of_stages = [
        {which: _of_stage(one, part, len(lists), known) for which, one in sums.items()} for part in range(len(lists))
    ]
    read: dict[tuple[str, ...], Struct] = {}  # tables by their names

    def addresses(function: Function, stage: Struct, of_pass: Struct) -> tuple[int, int]:
        """Addresses of a function and of the tables that it reads."""
        names = READS.get(function, ())
        if names not in read:
            read[names] = Struct(_named(names)(*(getattr(tables, name) for name in names)), known=known)
        kinds = (ALONE.type, stage.type, of_pass.type, read[names].type, inputs.type, types.int64, types.int64)
        return _address(function, kinds), read[names].address

    does = [[call for operation in operations for call in _does(tables, *operation)] for operations in lists]
    staged = {*sums, *(kind for calls in does for _, kind, _, _ in calls)}
    stages = [
        [
            _stages([levels[i] for i in (*places, turn[0][0])], tables, part, (phase + part) % 2 == 1, staged)
            for part, places in enumerate(turn)
        ]
        for phase, turn in enumerate(tables.rotation)
    ]
    with _COMPILING, importing(program.__name__):
        for which, of_pass in sums.items():
            first = stages[0][0][which]
            for places, functions in zip((of_pass.table.each, of_pass.table.ahead), parts[which], strict=True):
                for place, function in zip(places, functions, strict=True):
                    place[:] = addresses(function, first, of_pass)
            _set_called(first, of_pass)
        rows: list[list[tuple[int, ...]]] = []
        for turn in stages:
            rows.append([])
            for stage, calls, mine in zip(turn, does, of_stages, strict=True):
                for function, kind, which, number in calls:
                    of_function, of_tables = addresses(function, stage[kind], mine[which])
                    rows[-1].append((of_function, stage[kind].address, mine[which].address, of_tables, number))
    structs = [*read.values(), *(struct for by_pass in (sums, *of_stages) for struct in by_pass.values())]
    structs += [struct for turn in stages for stage in turn for struct in stage.values()]
    return structs, np.array(rows, np.int64).reshape(len(rows), -1, 5)


def _does(tables: Tables, operation: str, number: int, which: int) -> list[tuple[Function, int, int, int]]:
    """Functions that do an operation, in order: each with the passes whose stage and sums it takes, and a number."""
    layers = pass_of(tables, which).layers
    if operation == LINES:
        bands = [band for band in range(2) if layers.bands[band, COLUMNS]]
        calls = [(layer_program.continue_band, which, which, band) for band in bands]
        calls += [(layer_program.copy_slots, which, which, 0)] * bool(layers.copies.shape[1])
        return calls + [(layer_program.meet, which, which, 0)] * (which in _UNSWEPT)
    if operation == STRETCH:
        return [(function, which, which, number) for function in _on_axis(layers, number)]
    step = next((step for step in steps() if step.name == operation), None)
    if step is not None:
        return [(step.function, _STEP if step.whole and len(tables.numbers) > 1 else which, which, number)]
    which = BOND_STENCIL if operation in _OF_THE_FIELD else which
    return [(OPERATIONS[operation], which, which, number)]


def _on_axis(layers: Layers, axis: int) -> list[Function]:
    """Functions that add the sums of the layers along an axis."""
    if axis < 2:
        return [layer_program.stretch_faces]
    mirrored = layers.mirrored[2, 1, 0] != 0  # bonds have no coefficients then
    functions = [layer_program.add_mirrored_bands if mirrored else layer_program.add_bands]
    return functions + [layer_program.take_band_cuts] * bool(layers.band_cuts.shape[0])


def _on_parts(tables: Tables, which: int, split: bool, done: Set[str]) -> tuple[list[Function], list[Function]]:
    """Functions that are called for each part of the box as a pass sweeps it, and those that are called while messages
    are under way. If the pass is `split`, what needs no halo has been swept by the latter. `done` are the operations of
    all stages.
    """
    operands, bonds = pass_of(tables, which), tables.bonds
    sweeps = [feature.sweep(tables) for feature in FEATURES]
    on_bonds = (sweep_program.bonds_part, sweep_program.bonds_ahead, sweep_program.bonds_rest)
    plain = (sweep_program.stencil_part, sweep_program.stencil_ahead, sweep_program.stencil_rest)
    by_law = bonds.places.shape[0] and bonds.forces
    whole, ahead, rest = next((sweep for sweep in sweeps if sweep is not None), on_bonds if by_law else plain)
    after = [
        (sweep_program.release_part, operands.surface.segments.size),
        (sweep_program.law_part, operands.sweep.law.values.size),
    ]
    functions = [rest if split else whole, *(function for function, is_used in after if is_used)]
    if which == BOND_STENCIL:
        functions += [step.part for step in steps() if step.part is not None and step.name in done]
    return functions, [sweep_program.move_part, ahead] if split else []


def _set_called(stage: Struct, sums: Struct) -> None:
    """Set the addresses of the functions that operations call."""
    table: Sums = sums.table
    layers = table.layers
    rows = sweep_program.general_rows if table.columns == table.rows == 1 else sweep_program.general_matrix_rows
    for number, function, is_used in (
        (GENERAL, rows, table.sweep.function == 0),
        (FACE, layer_program.stretch_face, len(layers.items)),
        (EDGE, layer_program.stretch_edge, len(layers.edges)),
        (ABSENT, layer_program.take_cuts, len(layers.cuts)),
    ):
        if is_used:
            numbers = function.__code__.co_argcount - 2
            table.called[number] = _address(function, (stage.type, sums.type, *[types.int64] * numbers))


def _sums(tables: Tables, which: int, known: dict[int, Struct], parts: int, ahead: int) -> Struct:
    """Sums that the operations of a pass take, with room for addresses."""
    everywhere = tables.material
    alike = everywhere._replace(coefficient=everywhere.coefficient[:1])
    material = everywhere if which in _OF_BONDS else alike
    sums = Sums(
        **pass_of(tables, which)._asdict(),
        material=material,
        liquid=alike if everywhere.rule == PHASES else material,
        media=tables.media if which == BOND_STENCIL else with_defaults(Media, tables.numbers.dtype),
        work_space=tables.work_space,
        called=np.zeros(4, np.int64),
        each=np.zeros((parts, 2), np.int64),
        ahead=np.zeros((ahead, 2), np.int64),
        free=tables.free if ahead else np.zeros_like(tables.free),
    )
    return Struct(sums, known=known)


def _of_stage(sums: Struct, part: int, stages: int, known: dict[int, Struct]) -> Struct:
    """The same sums for one of the stages, each of which has a part of the memory of the layers."""
    table: Sums = sums.table
    if stages == 1 or not table.layers.cell:
        return sums
    size = table.layers.memory.size // stages
    memory = table.layers.memory[part * size : (part + 1) * size]
    return Struct(table._replace(layers=table.layers._replace(memory=memory)), known=known)


def _stages(levels: list[np.ndarray], tables: Tables, part: int, backward: bool, passes: Set[int]) -> dict[int, Struct]:
    """A stage of the field, by the number of its pass, those of further passes, and the whole step; of these the ones
    with the given numbers. `levels` are those of the stage, and the first of the step.
    """
    src, base, out, before = levels
    a, a_difference, b, scale, _ = tables.numbers[part]
    zero, unit = tables.numbers.dtype.type(0), tables.numbers.dtype.type(1)
    states, inflow, n = tables.gradient_pass.sweep.law.values, tables.flows.inflow, tables.components
    heat, drag = tables.heat, tables.drag

    def adds(source: np.ndarray, result: np.ndarray, which: int, keep: Any, factor: Any) -> Stage:
        """Stage whose sums are added to `keep` times its result."""
        columns, rows = pass_of(tables, which).columns, pass_of(tables, which).rows
        way = backward != (which == DIVERGENCE)  # the reverse of the sweep before it
        return Stage(source, result, result, part, zero, zero, keep, factor, False, columns, rows, way)

    stages = {
        BOND_STENCIL: Stage(src, base, out, part, a, a_difference, b, scale, tables.increments, n, n, backward),
        GRADIENT: adds(src, states, GRADIENT, zero, unit),
        DIVERGENCE: adds(states, out, DIVERGENCE, unit, scale),
        PUSHES: adds(heat.thermal_strain, out, PUSHES, unit, scale),
        TRACES: adds(src, heat.traces, TRACES, unit, unit),
        NEIGHBOURS: adds(drag.moved, drag.beyond, NEIGHBOURS, zero, unit),
        INFLOW: Stage(src, inflow, inflow, part, unit, unit, unit, unit, False, n, n, backward),
        _STEP: Stage(before, base, out, part, a, a_difference, b, scale, tables.increments, n, n, backward),
    }
    return {which: Struct(stage) for which, stage in stages.items() if which in passes}


def _address(function: Function, kinds: tuple[types.Type, ...]) -> int:
    """Address of a function, compiled for arguments of some types."""
    key = function, kinds
    if key not in _FUNCTIONS:
        _FUNCTIONS[key] = cfunc(types.void(*kinds), counted=function.__name__ in _COUNTED)(function)
    return int(_FUNCTIONS[key].address)

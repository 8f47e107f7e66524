"""The compiled time loop: it works through tables of operations, and calls each by its address.

Its arguments are numbers and addresses only, so that it is compiled once, whatever the run. An operation is compiled
when a run first needs it, for the types of the tables that it reads.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Set
from typing import Any

import numpy as np
from numba import types

from farhorizon.engine.bonds import PHASES
from farhorizon.engine.codegen.build import load_layer_program, load_program, load_sweep_program
from farhorizon.engine.codegen.calls import call_operation
from farhorizon.engine.codegen.compile_notice import importing
from farhorizon.engine.codegen.compiled import cfunc, njit
from farhorizon.engine.codegen.structs import Struct
from farhorizon.engine.layers import COLUMNS, Layers, has_layers
from farhorizon.engine.layout import with_defaults
from farhorizon.engine.operations import (
    AHEAD,
    BOND_STENCIL,
    BREAK,
    DAMAGED,
    DAMPERS,
    DIVERGENCE,
    FILTER,
    FLOW_LAYERS,
    GRADIENT,
    LINES,
    NEIGHBOURS,
    PUSHES,
    RECORD,
    RELAX,
    RELEASE,
    STRETCH,
    STRETCH_FORCES,
    STRETCH_STATES,
    SWEEP,
    TRACES,
    Tables,
    pass_of,
)
from farhorizon.engine.tables import ABSENT, EDGE, FACE, GENERAL, Inputs, Media, Stage, Sums
from farhorizon.engine.threads import ALONE, side_by_side

_FLOWS = 6  # the stage whose sums go into a level of their own, after those of the passes
_STEP = 7  # the stage from the level before a step of several stages to that after it
# operations on states that take the stage and the sums of the field
_OF_THE_FIELD = (BREAK, RELEASE, DAMAGED, STRETCH_STATES, STRETCH_FORCES)
# passes whose plain sums are made elsewhere, so that no sweep, at whose end threads meet, follows their lines
_UNSWEPT = (TRACES, NEIGHBOURS)
# passes whose bonds have coefficients
_OF_BONDS = (BOND_STENCIL, PUSHES, TRACES)
_COUNTED = ("general_rows", "general_matrix_rows")  # they create arrays

Function = Callable[..., Any]

_FUNCTIONS: dict[tuple[str, tuple[types.Type, ...]], Any] = {}
_COMPILING = threading.RLock()  # simulations may run in parallel


@njit(nogil=True, cache=True, counted=False, entry=True)
def run(thread: int, steps: int, phase: int, calls: np.ndarray, tables: int, inputs: int) -> None:
    """Do one thread's part of `steps` steps, beginning with the rotation `phase`, after which the level
    ``tables.rotation[(phase + steps) % rotations, 0, 0]`` holds the state. `thread`, `tables` and `inputs` are
    addresses; `calls`, shape (rotations, n, 4), says what to do in a step: addresses of functions, stages and sums, and
    a number.
    """
    for step in range(steps):
        for i in range(calls.shape[1]):
            function, stage, sums, number = calls[phase, i]
            call_operation(function, thread, stage, sums, tables, inputs, step, number)
        phase = (phase + 1) % calls.shape[0]


class CompiledLoop:
    """Works through tables of operations in machine code. It keeps what it has made of the last tables, because most
    calls have the same ones; those of a loop `beside` it may have much in common with the next ones.
    """

    def __init__(self, beside: CompiledLoop | None = None) -> None:
        self._levels: np.ndarray | None = None
        self._tables: Struct | None = None if beside is None else beside._tables
        self._inputs: Struct | None = None if beside is None else beside._inputs
        self._calls = np.zeros((1, 0, 4), np.int64)
        self._kept: list[Struct] = []  # structs whose addresses the calls contain

    def __reduce__(self) -> tuple[type[CompiledLoop], tuple[()]]:
        return CompiledLoop, ()  # a copy has arrays of its own

    def __call__(
        self, steps: int, phase: int, levels: np.ndarray, tables: Tables, inputs: Inputs, threads: int
    ) -> None:
        """Do `steps` steps of the tables on some threads."""
        table, outside = _made(tables, self._tables), _made(inputs, self._inputs)
        if not self._serves(levels, table, outside):
            self._kept, self._calls = _calls(levels, table, outside)
        self._levels, self._tables, self._inputs = levels, table, outside
        arguments = self._calls, table.address, outside.address
        side_by_side(lambda thread: run(thread.address, steps, phase, *arguments), threads)

    def _serves(self, levels: np.ndarray, tables: Struct, inputs: Struct) -> bool:
        """Whether the calls made last time are still valid."""
        if levels is not self._levels or self._tables is None or self._inputs is None:
            return False
        if tables is self._tables and inputs is self._inputs:
            return True
        before, now = self._tables.table, tables.table
        return (
            inputs.type is self._inputs.type
            and (now is before or _alike(now, before))
            and _records(now, inputs.table) == _records(before, self._inputs.table)
        )


def _made(table: Tables | Inputs, last: Struct | None) -> Struct:
    """The struct of a table: that of the last one if it is the same."""
    return last if last is not None and last.table is table else Struct(table, last)


def _alike(tables: Tables, before: Tables) -> bool:
    """Whether tables are the same objects, except that operations need only be equal."""
    compared: Iterable[tuple[str, Any, Any]] = zip(Tables._fields, tables, before, strict=True)
    return all(np.array_equal(a, b) if name in ("operations", "starts") else a is b for name, a, b in compared)


def _calls(levels: np.ndarray, tables: Struct, inputs: Struct) -> tuple[list[Struct], np.ndarray]:
    """The calls of a step in each rotation of the levels, and the structs whose addresses they contain."""
    table: Tables = tables.table
    size = types.int64
    lists = [table.operations[a:b].tolist() for a, b in zip(table.starts[:-1], table.starts[1:], strict=True)]
    passes = sorted({which for operations in lists for _, _, which in operations} | {BOND_STENCIL})
    split = {which for operations in lists for operation, _, which in operations if operation == AHEAD}
    swept = {which for operations in lists for operation, _, which in operations if operation in (SWEEP, AHEAD)}
    done = {operation for operations in lists for operation, _, _ in operations}
    parts = {
        which: _on_parts(table, inputs.table, which, which in split, done) if which in swept else ([], [])
        for which in passes
    }
    known = tables.known()
    sums = {which: _sums(table, which, len(parts[which][0]), len(parts[which][1]), known) for which in passes}
    of_stages = [
        {which: _of_stage(one, part, len(lists), known) for which, one in sums.items()} for part in range(len(lists))
    ]

    def address(function: Function, stage: Struct, of_pass: Struct) -> int:
        return _address(function, (ALONE.type, stage.type, of_pass.type, tables.type, inputs.type, size, size))

    does = [
        [call for operation in operations for call in _does(table, inputs.table, *operation)] for operations in lists
    ]
    staged = {*sums, *(kind for calls in does for _, kind, _, _ in calls)}
    stages = [
        [
            _stages([levels[i] for i in (*places, turn[0][0])], table, part, (phase + part) % 2 == 1, staged)
            for part, places in enumerate(turn)
        ]
        for phase, turn in enumerate(table.rotation)
    ]
    with _COMPILING, importing(load_program().__name__):
        for which, of_pass in sums.items():
            first = stages[0][0][which]
            for places, functions in zip((of_pass.table.each, of_pass.table.ahead), parts[which], strict=True):
                places[:] = [address(function, first, of_pass) for function in functions]
            _set_called(first, of_pass)
        rows = [
            [
                (address(function, stage[kind], mine[which]), stage[kind].address, mine[which].address, number)
                for stage, calls, mine in zip(turn, does, of_stages, strict=True)
                for function, kind, which, number in calls
            ]
            for turn in stages
        ]
    structs = [struct for by_pass in (sums, *of_stages) for struct in by_pass.values()]
    structs += [struct for turn in stages for stage in turn for struct in stage.values()]
    return structs, np.array(rows, np.int64).reshape(len(rows), -1, 4)


def _does(
    tables: Tables, inputs: Inputs, operation: int, number: int, which: int
) -> list[tuple[Function, int, int, int]]:
    """Functions that do an operation, in order: each with the passes whose stage and sums it takes, and a number."""
    layers, on_layers = pass_of(tables, which).layers, load_layer_program()
    if operation == LINES:
        bands = [band for band in range(2) if layers.bands[band, COLUMNS]]
        calls = [(on_layers.continue_band, which, which, band) for band in bands]
        calls += [(on_layers.copy_slots, which, which, 0)] * bool(layers.copies.shape[1])
        return calls + [(on_layers.meet, which, which, 0)] * (which in _UNSWEPT)
    if operation == STRETCH:
        return [(function, which, which, number) for function in _on_axis(layers, number)]
    program, sweep_program = load_program(), load_sweep_program()
    if operation == FLOW_LAYERS:
        return [
            (function, stage, BOND_STENCIL, axis)
            for axis in range(3)
            if has_layers(layers, axis)
            for function, stage in (
                (program.clear_inflow, _FLOWS),
                *((function, _FLOWS) for function in _on_axis(layers, axis)),
                (program.add_inflow, BOND_STENCIL),
            )
        ]
    if operation == RECORD:
        functions = sweep_program.record_nodes_last, sweep_program.record_blocks_last
        used = zip(functions, _records(tables, inputs), strict=True)
        return [(function, which, which, number) for function, is_used in used if is_used]
    stage = which
    if operation in (FILTER, DAMPERS) and len(tables.numbers) > 1:
        stage = _STEP
    if operation in _OF_THE_FIELD:
        stage, which = BOND_STENCIL, BOND_STENCIL
    module = program if operation in program.OPERATIONS else sweep_program
    return [(module.OPERATIONS[operation], stage, which, number)]


def _on_axis(layers: Layers, axis: int) -> list[Function]:
    """Functions that add the sums of the layers along an axis."""
    program = load_layer_program()
    if axis < 2:
        return [program.stretch_faces]
    mirrored = layers.mirrored[2, 1, 0] != 0  # bonds have no coefficients then
    functions = [program.add_mirrored_bands if mirrored else program.add_bands]
    return functions + [program.take_band_cuts] * bool(layers.band_cuts.shape[0])


def _on_parts(
    tables: Tables, inputs: Inputs, which: int, split: bool, done: Set[int]
) -> tuple[list[Function], list[Function]]:
    """Functions that are called for each part of the box as a pass sweeps it, and those that are called while messages
    are under way. If the pass is `split`, what needs no halo has been swept by the latter. `done` are the operations of
    all stages.
    """
    program, operands, bonds = load_sweep_program(), pass_of(tables, which), tables.bonds
    if tables.phases.runs.size:
        whole, ahead, rest = program.phases_part, program.phases_ahead, program.phases_rest
    elif bonds.places.shape[0] and bonds.forces:
        whole, ahead, rest = program.bonds_part, program.bonds_ahead, program.bonds_rest
    else:
        whole, ahead, rest = program.stencil_part, program.stencil_ahead, program.stencil_rest
    nodes, blocks = _records(tables, inputs)
    after = [
        (program.release_part, operands.surface.segments.size),
        (program.record_nodes_part, which == BOND_STENCIL and nodes),
        (program.record_blocks_part, which == BOND_STENCIL and blocks),
        (program.law_part, operands.sweep.law.values.size),
        (program.relax_part, which == BOND_STENCIL and RELAX in done),
    ]
    functions = [rest if split else whole, *(function for function, is_used in after if is_used)]
    return functions, [program.move_part, ahead] if split else []


def _set_called(stage: Struct, sums: Struct) -> None:
    """Set the addresses of the functions that operations call."""
    table: Sums = sums.table
    layers, on_layers, sweep_program = table.layers, load_layer_program(), load_sweep_program()
    rows = sweep_program.general_rows if table.columns == table.rows == 1 else sweep_program.general_matrix_rows
    for number, function, is_used in (
        (GENERAL, rows, table.sweep.function == 0),
        (FACE, on_layers.stretch_face, len(layers.items)),
        (EDGE, on_layers.stretch_edge, len(layers.edges)),
        (ABSENT, on_layers.take_cuts, len(layers.cuts)),
    ):
        if is_used:
            numbers = function.__code__.co_argcount - 2
            table.called[number] = _address(function, (stage.type, sums.type, *[types.int64] * numbers))


def _records(tables: Tables, inputs: Inputs) -> tuple[bool, bool]:
    """Whether the values of any nodes are recorded, and whether any sums over blocks are."""
    return bool(inputs.recorded_nodes.size), bool(tables.block_sums.rows.size)


def _sums(tables: Tables, which: int, parts: int, ahead: int, known: dict[int, Struct]) -> Struct:
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
        each=np.zeros(parts, np.int64),
        ahead=np.zeros(ahead, np.int64),
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
    """A stage of the field, by the number of its pass, those of further passes, that of the flows and the whole step;
    of these the ones with the given numbers. `levels` are those of the stage, and the first of the step.
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
        _FLOWS: Stage(src, inflow, inflow, part, unit, unit, unit, unit, False, n, n, backward),
        _STEP: Stage(before, base, out, part, a, a_difference, b, scale, tables.increments, n, n, backward),
    }
    return {which: Struct(stage) for which, stage in stages.items() if which in passes}


def _address(function: Function, kinds: tuple[types.Type, ...]) -> int:
    """Address of a function, compiled for arguments of some types."""
    name = function.__name__, kinds
    if name not in _FUNCTIONS:
        _FUNCTIONS[name] = cfunc(types.void(*kinds), counted=function.__name__ in _COUNTED)(function)
    return int(_FUNCTIONS[name].address)

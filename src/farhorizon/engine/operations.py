"""Operations of which a step consists, and the tables that they read.

A step is one or more stages. Each stage is a list of operations, which the compiled loop executes in order
(`engine.program`, `sweep_program` and `layer_program` have the functions that do them); where needed an operation is
given a number. The plain numpy program of the tests executes the same lists.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from farhorizon.engine.bonds import Bonds
from farhorizon.engine.codegen.exchanges import USED
from farhorizon.engine.damage import FORCES, STATES, STATES_AGAIN
from farhorizon.engine.dampers import Dampers
from farhorizon.engine.derivative_pml import DerivativePML
from farhorizon.engine.dissipation import Dissipation
from farhorizon.engine.drag import Drag
from farhorizon.engine.ends import ExactEndTables
from farhorizon.engine.exchange import LEVEL, SLOTS
from farhorizon.engine.faces import Faces
from farhorizon.engine.filter import Filter
from farhorizon.engine.impactors import Impactors
from farhorizon.engine.layers import Layers, has_layers
from farhorizon.engine.layout import HALOS, doubles, empty, ints, reals, with_defaults
from farhorizon.engine.outline_stencil import OutlineStencil
from farhorizon.engine.phases import Phases
from farhorizon.engine.relaxations import Relaxations
from farhorizon.engine.tables import (
    BlockSums,
    Cuts,
    Damping,
    Dependents,
    Flows,
    Inputs,
    Material,
    Media,
    Pass,
    Surface,
    Sweep,
)
from farhorizon.engine.thermal_strain import ThermalStrains

COPY = 0  # the halo copies what lies across periodic axes
DAMP_OLD = 1  # an absorbing zone damps the increment of the last step
LINES = 2  # layers continue the field along lines of the last axis
SWEEP = 3  # out = a*src + b*base + scale*L(src), with plain shifts
CUT = 4  # contributions of absent bonds are subtracted
STRETCH = 5  # the layers along an axis add the difference between stretched and plain shifts
ENDS = 6  # exact ends
ADD_SOURCES = 7  # sources
DAMP_NEW = 8  # an absorbing zone damps the increment of this step
FILTER = 9  # layers damp short waves
HOLD = 10  # nodes with prescribed values are set
WORK = 11  # the work of sources is accumulated
FLOW_LAYERS = 12  # contributions of the layers are added to the flows
FLOW = 13  # flows along bonds are accumulated
DEPEND = 14  # nodes whose values depend on those of others are set
OUTLINE = 15  # the halo along an outline is set
DISSOLVE = 16  # solid nodes become liquid
RECORD = 17  # values of recorded nodes and sums over blocks of nodes are recorded
LAW = 18  # the law of the nodes is applied to their states
BREAK = 19  # bonds beyond their limit break
DAMAGED = 20  # sums of nodes that have lost bonds are recomputed; the number says which, see `engine.damage`
INERTIA = 21  # the change due to the forces is scaled by the mobility of the nodes
SEND = 22  # messages to other processes are started; the number is three times their kind plus their axis
STRETCH_STATES = 23  # layers stretch the derivatives in the states; with number 1 their memory begins
STRETCH_FORCES = 24  # and those of the results of the law
DRAG = 25  # velocities move towards the mean of their neighbours
THERMAL_FORCES = 26  # thermal strains are subtracted from those of the springs of state-based media
ADVANCE_STRAINS = 27  # thermal strains advance to the next step
DISSOLVE_HALO = 28  # nodes of the halo become liquid as in the processes that own them
AHEAD = 29  # SWEEP of rows that need no halo, while messages are under way: the number is twice that of a part of
# these rows, plus the number of other parts
RECEIVE = 30  # messages that fill the halo are completed; numbered as SEND
RELEASE = 31  # bonds break whose energy exceeds their limit
THERMAL_FORCES_BEYOND = 32  # as THERMAL_FORCES, but on all nodes, and also for bonds without a law of their own
DAMPERS = 33  # masses of tuned dampers move
KEEP_INCREMENTS = 34  # increments of the last step are stored for drag
PUSH = 35  # rigid shapes push nodes, and move
WORK_OF_PUSHES = 36  # the work of these pushes is accumulated
RELAX = 37  # forces of the medium relax
DISSIPATE = 38  # dashpots move, and what that takes is accumulated
TOUCH = 39  # faces of cracks push each other, and slide

# Passes of the operator: springs; sums over bonds that yield states; sums over states that yield forces; if heat passes
# through the layers, thermal forces and traces of the stresses; for drag, what layers add to sums over neighbours.
BOND_STENCIL, GRADIENT, DIVERGENCE, PUSHES, TRACES, NEIGHBOURS = range(6)
#: Fields of `Tables` with the passes other than the first.
FURTHER_PASSES = "gradient_pass", "divergence_pass", "pushes", "traces", "neighbours"


Operation = tuple[int, int, int]


class Tables(NamedTuple):
    """Everything that the loop reads and keeps, except for the levels and the inputs."""

    rotation: np.ndarray  # numbers of the levels (src, base, out), shape (rotations, stages, 3)
    numbers: np.ndarray  # (a, a for differences, b, scale, source scale) of each stage, shape (stages, 5)
    increments: bool
    components: int
    sweep: Sweep
    layers: Layers
    work_space: np.ndarray  # shape (threads, n)
    copies: np.ndarray  # runs of places of the halo that copy others, see `Layout.copies`; shape (3, n)
    material: Material
    flows: Flows
    dampers: Dampers
    block_sums: BlockSums
    gradient_pass: Pass
    divergence_pass: Pass
    pushes: Pass
    traces: Pass
    neighbours: Pass
    # Operations of all stages, one after the other: the operation, a number, and the pass of the operator to which it
    # belongs; shape (n, 3). The first of each stage, and the end; shape (stages + 1,).
    operations: np.ndarray = ints(0, 3)
    starts: np.ndarray = ints(1)
    # Messages by which other processes fill halos, by kind and axis; see `engine.exchange`; shape (kinds, 3, 5).
    exchange: np.ndarray = ints(0, 3, 5)
    # Rows that need no halo from other processes except along the last axis: first and end along the other axes.
    free: np.ndarray = ints(2, 2)
    media: Media = empty(Media)
    cuts: Cuts = empty(Cuts)
    surface: Surface = empty(Surface)
    work: np.ndarray = doubles(0)  # accumulated work of the sources, or empty
    damping: Damping = empty(Damping)
    # Acceleration of each place by a given force, relative to a node of the medium; shape (places,), or empty.
    mobility: np.ndarray = reals(0)
    ends: ExactEndTables = empty(ExactEndTables)
    dependents: Dependents = empty(Dependents)
    outline_stencil: OutlineStencil = empty(OutlineStencil)
    filter: Filter = empty(Filter)
    stretches: DerivativePML = empty(DerivativePML)
    drag: Drag = empty(Drag)
    bonds: Bonds = empty(Bonds)
    faces: Faces = empty(Faces)
    phases: Phases = empty(Phases)
    heat: ThermalStrains = empty(ThermalStrains)
    impactors: Impactors = empty(Impactors)
    relaxations: Relaxations = empty(Relaxations)
    dissipation: Dissipation = empty(Dissipation)


class Asked(NamedTuple):
    """The inputs that there are: on them, and on the tables, the operations of a step depend."""

    has_sources: bool
    held: bool
    recorded_nodes: bool
    pushed: bool


def asked_by(inputs: Inputs) -> Asked:
    """Return which inputs there are."""
    return Asked(
        len(inputs.source_fields) > 0,
        inputs.held.size > 0,
        inputs.recorded_nodes.size > 0,
        inputs.impactor_paths.size > 0,
    )


def operations_of(tables: Tables, asked: Asked) -> tuple[np.ndarray, np.ndarray]:
    """Return the operations of a step: `operations` and `starts` for tables that lack them."""
    lists = [_stage(tables, asked, stage) for stage in range(len(tables.numbers))]
    recorded = asked.recorded_nodes or tables.block_sums.rows.size
    lists[-1] += _present(
        (DISSOLVE, tables.phases.runs.size), (RECORD, recorded), (ADVANCE_STRAINS, tables.heat.rate.size)
    )
    starts = np.cumsum([0, *map(len, lists)])
    return table_of(itertools.chain(*lists)), starts


def table_of(operations: Iterable[Operation]) -> np.ndarray:
    """Return operations in the form of `Tables.operations`."""
    return np.array(list(operations), np.int64).reshape(-1, 3)


def _stage(tables: Tables, asked: Asked, stage: int) -> list[Operation]:
    damped, flows = tables.damping.nodes.size, tables.flows.effects[stage] != 0
    last = stage == len(tables.numbers) - 1  # after which there are increments of the whole step
    return (
        _present((DAMP_OLD, damped))
        + operator_operations(tables, dissolving=stage == 0)
        + _present((RELAX, tables.relaxations.keep.size), (DISSIPATE, tables.dissipation.share.size))
        + _present((ENDS, len(tables.ends.nodes)), (ADD_SOURCES, asked.has_sources), (INERTIA, tables.mobility.size))
        + _present((PUSH, asked.pushed))
        + _drag_operations(tables)
        + _present(
            (DAMP_NEW, damped),
            (FILTER, last and tables.filter.runs.size),
            (DAMPERS, last and tables.dampers.runs.size),
            (HOLD, asked.held),
            (WORK, asked.has_sources and tables.work.size),
            (WORK_OF_PUSHES, asked.pushed),
            (FLOW_LAYERS, flows and tables.flows.inflow.size),
            (FLOW, flows and tables.flows.accounts.size),
            (DEPEND, tables.dependents.nodes.size),
            (OUTLINE, tables.outline_stencil.nodes.size),
        )
    )


def operator_operations(tables: Tables, dissolving: bool = False, breaking: bool = True) -> list[Operation]:
    """Operations of the operator, including its halo and layers; if `dissolving`, the phases of the halo are updated
    for this step; if `breaking`, bonds of state-based media may break.
    """
    breaks, by_energy = not tables.bonds.forces, len(tables.bonds.released) > 0
    may_break = breaking and breaks and np.isfinite(tables.bonds.limit[0])
    before = _present((DISSOLVE_HALO, dissolving and len(tables.phases.halo)))
    before += _present((BREAK, may_break and not by_energy), number=GRADIENT)
    # In all stages or in none: the sweep reads the phases of the halo, and may overwrite one of the two levels by which
    # bonds break.
    ahead = not (breaks or len(tables.phases.halo))
    steps = _sums(tables, BOND_STENCIL, halo=True, ahead=ahead, before=before)
    if tables.gradient_pass.sweep.law.values.size:
        stretched = tables.stretches.runs.size
        steps += _sums(tables, GRADIENT) + _present((STRETCH_STATES, stretched), number=GRADIENT)
        steps += _present((LAW, _later(tables.gradient_pass)), number=GRADIENT) + [(DAMAGED, STATES, GRADIENT)] * breaks
        if may_break and by_energy:
            steps += _present((COPY, tables.copies.size), number=DIVERGENCE)
            steps += _exchanged(tables, DIVERGENCE, [LEVEL], lines=[], ahead=False)
            steps += [(RELEASE, 0, GRADIENT), (DAMAGED, STATES_AGAIN, GRADIENT)]
        steps += _sums(tables, DIVERGENCE, halo=True, ahead=True)
        steps += _present((STRETCH_FORCES, stretched), number=DIVERGENCE) + [(DAMAGED, FORCES, DIVERGENCE)] * breaks
    steps += _present((TOUCH, tables.faces.nodes.size), (THERMAL_FORCES, tables.heat.vectors.size))
    return steps + (_in_layers(tables, PUSHES, [(THERMAL_FORCES_BEYOND, 0, PUSHES)]) if tables.heat.beyond.size else [])


def trace_operations(tables: Tables) -> list[Operation]:
    """Operations by which layers add to the traces of the stresses, for a level whose halo is filled."""
    return _in_layers(tables, TRACES, [])


def _drag_operations(tables: Tables) -> list[Operation]:
    """Operations that move velocities towards the mean of their neighbours."""
    if not tables.drag.rate.size:
        return []
    layers = tables.neighbours.layers
    lines = _present((LINES, has_layers(layers, 2)), number=NEIGHBOURS)
    steps = [
        (KEEP_INCREMENTS, 0, BOND_STENCIL),
        *_exchanged(tables, NEIGHBOURS, [SLOTS + NEIGHBOURS], lines, ahead=False),
    ]
    steps += [(STRETCH, axis, NEIGHBOURS) for axis in (2, 1, 0) if has_layers(layers, axis)]
    return [*steps, (DRAG, 0, BOND_STENCIL)]


def _in_layers(tables: Tables, number: int, plain: list[Operation]) -> list[Operation]:
    """Operations of a pass whose halo is filled; `plain` ones compute the sums with plain shifts."""
    axes = [axis for axis in (2, 1, 0) if has_layers(pass_of(tables, number).layers, axis)]
    return _present((LINES, 2 in axes), number=number) + plain + [(STRETCH, axis, number) for axis in axes]


def pass_of(tables: Tables, number: int) -> Pass:
    """Return the sums of a pass."""
    if number == BOND_STENCIL:
        n = tables.components
        return Pass(tables.sweep, tables.layers, n, n, tables.cuts, tables.surface)
    passes: tuple[Pass, ...] = tuple(getattr(tables, name) for name in FURTHER_PASSES)
    return passes[number - GRADIENT]


def _sums(
    tables: Tables, number: int, halo: bool = False, ahead: bool = False, before: Sequence[Operation] = ()
) -> list[Operation]:
    """Operations of one pass: it may fill the halo of the field that it reads, sweep rows that need no halo in the
    meantime (`ahead`), and do something `before` the sweep.
    """
    operands = pass_of(tables, number)
    layers, cuts = operands.layers, operands.cuts
    axes = [axis for axis in (2, 1, 0) if has_layers(layers, axis)]
    lines = _present((LINES, 2 in axes), number=number)
    steps = _present((COPY, halo and tables.copies.size), number=number)
    steps += _exchanged(tables, number, [LEVEL] * halo + [SLOTS + number], lines, ahead)
    steps += [*before, *_present((SWEEP, 1), (CUT, cuts.nodes.size), number=number)]
    return steps + [(STRETCH, axis, number) for axis in axes]


def _exchanged(
    tables: Tables, number: int, kinds: Sequence[int], lines: list[Operation], ahead: bool
) -> list[Operation]:
    """Operations by which other processes fill halos, axis by axis, since later axes pass on the halos of earlier ones.
    The layers continue the field along lines of the last axis, which needs no halo, before their results are sent. If
    `ahead`, rows that need no halo are swept in the meantime.
    """
    along = {axis: [3 * kind + axis for kind in kinds if is_used(tables, kind, axis)] for axis in HALOS}
    axes = [axis for axis, messages in along.items() if messages]
    hidden = [axis for axis in axes if axis < 2 and ahead and tables.free.any()]
    steps = [] if axes else lines
    for axis in axes:
        levels, slots = (
            [(SEND, message, number) for message in along[axis] if (message // 3 == LEVEL) == level]
            for level in (True, False)
        )
        steps += levels + lines * (axis == axes[0]) + slots
        if axis in hidden:
            steps.append((AHEAD, 2 * hidden.index(axis) + len(hidden) - 1, number))
        steps += [(RECEIVE, message, number) for message in along[axis]]
    return steps


def is_used(tables: Tables, kind: int, axis: int) -> bool:
    """Whether there are messages of a kind along an axis."""
    return bool(tables.exchange[kind : kind + 1, axis, USED].any())


def beginning_operations(tables: Tables) -> list[Operation]:
    """Operations of the operator that initialise the memory of stretched derivatives, which then adds nothing to
    them.
    """
    return [
        (operation, 1 if operation in (STRETCH_STATES, STRETCH_FORCES) else number, which)
        for operation, number, which in operator_operations(tables, breaking=False)
    ]


def sweep_operations(tables: Tables) -> list[Operation]:
    """Operations of the operator with plain shifts, using the halo of the level as it is."""
    plain = (SWEEP, CUT, LAW, DAMAGED, TOUCH, THERMAL_FORCES, THERMAL_FORCES_BEYOND)
    return [
        step
        for step in operator_operations(tables, breaking=False)
        if step[0] in plain or (step[2] == DIVERGENCE and _fills_level(*step[:2]))
    ]


def state_operations(tables: Tables, halo: bool = False) -> list[Operation]:
    """Operations that compute the states of nodes with plain shifts, and, if asked for, fill the halo of the law's
    results.
    """
    return [
        step
        for step in sweep_operations(tables)
        if step[2] == GRADIENT or (halo and step[2] == DIVERGENCE and _fills_level(*step[:2]))
    ]


def layered_states(tables: Tables) -> list[Operation]:
    """Operations that compute the states of nodes, layers included, for a level whose halo is filled."""
    return [step for step in operator_operations(tables, breaking=False) if step[2] == GRADIENT]


def _fills_level(operation: int, number: int) -> bool:
    return operation == COPY or (operation in (SEND, RECEIVE) and number // 3 == LEVEL)


def once(tables: Tables, operations: list[Operation], numbers: np.ndarray) -> Tables:
    """Return the same tables for one stage of some operations, with its numbers, in which no bond breaks."""
    return tables._replace(
        operations=table_of(operations),
        starts=np.array([0, len(operations)]),
        rotation=np.arange(3).reshape(1, 1, 3),
        numbers=numbers,
        bonds=tables.bonds._replace(limit=np.full(2, np.inf, numbers.dtype)),
    )


def without_heat(tables: Tables) -> Tables:
    """Return the same tables without thermal strains, so that the operator is linear."""
    if not tables.heat.thermal_strain.size:
        return tables
    law = tables.gradient_pass.sweep.law
    gradient_pass = tables.gradient_pass._replace(
        sweep=tables.gradient_pass.sweep._replace(law=law._replace(thermal_strain=law.thermal_strain[:0]))
    )
    bonds = tables.bonds._replace(thermal_strain=np.zeros_like(tables.bonds.thermal_strain))
    return tables._replace(
        heat=with_defaults(ThermalStrains, law.values.dtype), bonds=bonds, gradient_pass=gradient_pass
    )


def without_contact(tables: Tables) -> Tables:
    """Return the same tables of a state-based medium whose absent bonds carry no compression."""
    if tables.bonds.forces:
        return tables
    faces = with_defaults(Faces, tables.numbers.dtype)
    return tables._replace(bonds=tables.bonds._replace(closing=tables.bonds.closing[:0]), faces=faces)


def with_histories_at_rest(tables: Tables) -> Tables:
    """Return the same tables for what is not a step of the run: bonds whose law is a function keep their histories, and
    faces that slide their slips.
    """
    if tables.faces.slips.size:
        tables = tables._replace(faces=tables.faces._replace(moving=0))
    if not tables.bonds.parameters.size:
        return tables
    parameters = tables.bonds.parameters.copy()
    parameters[0] = 1
    return tables._replace(bonds=tables.bonds._replace(parameters=parameters))


def _later(gradient_pass: Pass) -> bool:
    """Whether some states are complete only after all sums have been computed."""
    law, nodes = gradient_pass.sweep.law, gradient_pass.sweep.block[1:4]
    return bool((law.first > 0).any() or (law.end < nodes).any())


def _present(*pairs: tuple[int, int], number: int = BOND_STENCIL) -> list[Operation]:
    """Operations of those pairs (operation, whether there is anything to do) that have something to do."""
    return [(operation, 0, number) for operation, something in pairs if something]


def check_room(tables: Tables, inputs: Inputs, steps: int) -> None:
    """Raise an IndexError if a table that the loop indexes by step and stage without checking bounds is too small; the
    clock of exact ends counts once per stage.
    """
    stages, ends = len(tables.numbers), tables.ends
    clock = int(ends.clock[0]) + steps * stages if len(ends.history) else 0
    fields, dependent, held = inputs.source_fields, inputs.dependent_fields, len(inputs.held)
    pushed = len(tables.impactors.state) if inputs.impactor_paths.size else 0
    for name, shape, least in (
        ("history", ends.history.shape[1:2], (clock,)),
        ("source_times", inputs.source_times.shape, (steps, stages, len(fields))),
        ("source_fields", fields.shape[1:], (len(inputs.source_nodes) if len(fields) else 0,)),
        ("held_values", inputs.held_values.shape, (steps if held else 0, held)),
        ("held_forces", inputs.held_forces.shape, (0, held if len(inputs.held_forces) else 0)),
        (
            "impactor_paths",
            inputs.impactor_paths.shape,
            (steps if pushed else 0, pushed, tables.components if pushed else 0),
        ),
        ("dependent_times", inputs.dependent_times.shape, (steps, stages, len(dependent))),
        ("dependent_fields", dependent.shape[1:], (len(tables.dependents.nodes),)),
    ):
        if len(shape) != len(least) or any(have < want for have, want in zip(shape, least, strict=True)):
            raise IndexError(
                f"the table {name} of the compiled loop has the shape {shape}, less than {least} for {steps} steps"
            )

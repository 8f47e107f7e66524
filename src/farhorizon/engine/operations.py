"""Operations of which a step consists, and the tables that they read.

A step is one or more stages. Each stage is a list of operations, which the compiled loop executes in order; where
needed an operation is given a number. The plain numpy program of the tests executes the same lists.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from farhorizon.engine.bonds import Bonds
from farhorizon.engine.damage import FORCES, STATES, STATES_AGAIN
from farhorizon.engine.dampers import Dampers
from farhorizon.engine.drag import Drag
from farhorizon.engine.ends import Ends
from farhorizon.engine.exchange import LEVEL, SLOTS
from farhorizon.engine.filter import Filter
from farhorizon.engine.layout import HALOS
from farhorizon.engine.nested import Layers, has_layers
from farhorizon.engine.outline_stencil import OutlineStencil
from farhorizon.engine.phases import Phases
from farhorizon.engine.rows.exchanges import USED
from farhorizon.engine.stretches import Stretches
from farhorizon.engine.tables import (
    BlockSums,
    Cuts,
    Damping,
    Dependents,
    Flows,
    Inputs,
    Material,
    Media,
    Surface,
    Sweep,
)
from farhorizon.engine.thermal_strain import ThermalStrains, no_heat

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
FRINGE = 15  # the halo along an outline is set
DISSOLVE = 16  # solid nodes become liquid
KEEP = 17  # values of watched nodes and sums over blocks of nodes are recorded
LAW = 18  # the law of the nodes is applied to their states
BREAK = 19  # bonds beyond their limit break
DAMAGED = 20  # sums of nodes that have lost bonds are recomputed; the number says which, see `engine.damage`
INERTIA = 21  # the change due to the forces is scaled by the mobility of the nodes
SEND = 22  # messages to other processes are started; the number is three times their kind plus their axis
STRETCH_STATES = 23  # layers stretch the derivatives in the states; with number 1 their memory begins
STRETCH_FORCES = 24  # and those of the results of the law
DRAG = 25  # velocities move towards the mean of their neighbours
HEAT = 26  # thermal strains are subtracted from those of the springs of state-based media
WARM = 27  # thermal strains advance to the next step
MELT = 28  # nodes of the halo become liquid as in the processes that own them
AHEAD = 29  # SWEEP of rows that need no halo, while messages are under way: the number is twice that of a part of
# these rows, plus the number of other parts
RECEIVE = 30  # messages that fill the halo are completed; numbered as SEND
RELEASE = 31  # bonds break whose energy exceeds their limit
HEAT_BEYOND = 32  # as HEAT, but on all nodes, and also for bonds without a law of their own
DAMPERS = 33  # masses of tuned dampers move
MOVED = 34  # increments of the last step are stored for drag

# Passes of the operator: springs; sums over bonds that yield states; sums over states that yield forces; if heat passes
# through the layers, thermal forces and traces of the stresses; for drag, what layers add to sums over neighbours.
BOND_STENCIL, GRADIENT, DIVERGENCE, PUSHES, TRACES, NEIGHBOURS = range(6)


class Pass(NamedTuple):
    """Sums over bonds, from one field to another.

    Attributes
    ----------
    sweep : Sweep
    layers : Layers
    cuts : Cuts
    surface : Surface
    columns, rows : int
        Numbers of components that are read and written.
    """

    sweep: Sweep
    layers: Layers
    cuts: Cuts
    surface: Surface
    columns: int
    rows: int


Operation = tuple[int, int, int]


class Tables(NamedTuple):
    """Everything that the loop reads and keeps, except for the levels and the inputs.

    Attributes
    ----------
    operations : ndarray of int, shape (n, 3)
        Operations of all stages, one after the other: the operation, a number, and the pass of the operator to which it
        belongs.
    starts : ndarray of int, shape (stages + 1,)
        First operation of each stage.
    rotation : ndarray of int, shape (rotations, stages, 3)
        Numbers of the levels (src, base, out).
    numbers : ndarray, shape (stages, 5)
        (a, a for differences, b, scale, source scale).
    increments : bool
    components : int
    copies : ndarray of int, shape (3, n)
        Runs of places of the halo that copy others, see `Layout.copies`.
    exchange : ndarray of int, shape (kinds, 3, 5)
        Messages by which other processes fill halos, by kind and axis; see `engine.exchange`.
    free : ndarray of int, shape (2, 2)
        Rows that need no halo from other processes except along the last axis: first and end along the other axes.
    work_space : ndarray, shape (threads, n)
    work : ndarray, shape (n,)
        Accumulated work of the sources, or empty.
    mobility : ndarray, shape (places,)
        Acceleration of each place by a given force, relative to a node of the medium, or empty.
    """

    operations: np.ndarray
    starts: np.ndarray
    rotation: np.ndarray
    numbers: np.ndarray
    increments: bool
    components: int
    sweep: Sweep
    layers: Layers
    work_space: np.ndarray
    copies: np.ndarray
    exchange: np.ndarray
    free: np.ndarray
    material: Material
    media: Media
    cuts: Cuts
    surface: Surface
    phases: Phases
    bonds: Bonds
    work: np.ndarray
    damping: Damping
    mobility: np.ndarray
    ends: Ends
    dependents: Dependents
    flows: Flows
    outline_stencil: OutlineStencil
    filter: Filter
    dampers: Dampers
    block_sums: BlockSums
    gradient_pass: Pass
    divergence_pass: Pass
    pushes: Pass
    traces: Pass
    neighbours: Pass
    stretches: Stretches
    drag: Drag
    heat: ThermalStrains


class Asked(NamedTuple):
    """The inputs that there are: on them, and on the tables, the operations of a step depend."""

    has_sources: bool
    held: bool
    recorded_nodes: bool


def asked_by(inputs: Inputs) -> Asked:
    """Return which inputs there are."""
    return Asked(len(inputs.source_fields) > 0, inputs.held.size > 0, inputs.recorded_nodes.size > 0)


def operations_of(tables: Tables, asked: Asked) -> tuple[np.ndarray, np.ndarray]:
    """Return the operations of a step: `operations` and `starts` for tables that lack them."""
    lists = [_stage(tables, asked, stage) for stage in range(len(tables.numbers))]
    kept = asked.recorded_nodes or tables.block_sums.rows.size
    lists[-1] += _chosen((DISSOLVE, tables.phases.runs.size), (KEEP, kept), (WARM, tables.heat.rate.size))
    starts = np.cumsum([0, *map(len, lists)])
    return table_of(itertools.chain(*lists)), starts


def table_of(operations: Iterable[Operation]) -> np.ndarray:
    """Return operations in the form of `Tables.operations`."""
    return np.array(list(operations), np.int64).reshape(-1, 3)


def _stage(tables: Tables, asked: Asked, stage: int) -> list[Operation]:
    damped, flows = tables.damping.nodes.size, tables.flows.effects[stage] != 0
    last = stage == len(tables.numbers) - 1  # after which there are increments of the whole step
    return (
        _chosen((DAMP_OLD, damped))
        + operator_operations(tables, melting=stage == 0)
        + _chosen((ENDS, len(tables.ends.nodes)), (ADD_SOURCES, asked.has_sources), (INERTIA, tables.mobility.size))
        + _drag_operations(tables)
        + _chosen(
            (DAMP_NEW, damped),
            (FILTER, last and tables.filter.runs.size),
            (DAMPERS, last and tables.dampers.runs.size),
            (HOLD, asked.held),
            (WORK, asked.has_sources and tables.work.size),
            (FLOW_LAYERS, flows and tables.flows.inflow.size),
            (FLOW, flows and tables.flows.accounts.size),
            (DEPEND, tables.dependents.nodes.size),
            (FRINGE, tables.outline_stencil.nodes.size),
        )
    )


def operator_operations(tables: Tables, melting: bool = False, breaking: bool = True) -> list[Operation]:
    """Operations of the operator, including its halo and layers; if `melting`, the phases of the halo are updated for
    this step; if `breaking`, bonds of state-based media may break.
    """
    breaks, by_energy = not tables.bonds.forces, len(tables.bonds.released) > 0
    may_break = breaking and breaks and np.isfinite(tables.bonds.limit[0])
    before = _chosen((MELT, melting and len(tables.phases.halo)))
    before += _chosen((BREAK, may_break and not by_energy), number=GRADIENT)
    # In all stages or in none: the sweep reads the phases of the halo, and may overwrite one of the two levels by which
    # bonds break.
    ahead = not (breaks or len(tables.phases.halo))
    found = _sums(tables, BOND_STENCIL, halo=True, ahead=ahead, before=before)
    if tables.gradient_pass.sweep.law.values.size:
        stretched = tables.stretches.runs.size
        found += _sums(tables, GRADIENT) + _chosen((STRETCH_STATES, stretched), number=GRADIENT)
        found += _chosen((LAW, _later(tables.gradient_pass)), number=GRADIENT) + [(DAMAGED, STATES, GRADIENT)] * breaks
        if may_break and by_energy:
            found += _chosen((COPY, tables.copies.size), number=DIVERGENCE)
            found += _exchanged(tables, DIVERGENCE, [LEVEL], lines=[], ahead=False)
            found += [(RELEASE, 0, GRADIENT), (DAMAGED, STATES_AGAIN, GRADIENT)]
        found += _sums(tables, DIVERGENCE, halo=True, ahead=True)
        found += _chosen((STRETCH_FORCES, stretched), number=DIVERGENCE) + [(DAMAGED, FORCES, DIVERGENCE)] * breaks
    found += _chosen((HEAT, tables.heat.vectors.size))
    return found + (_in_layers(tables, PUSHES, [(HEAT_BEYOND, 0, PUSHES)]) if tables.heat.beyond.size else [])


def trace_operations(tables: Tables) -> list[Operation]:
    """Operations by which layers add to the traces of the stresses, for a level whose halo is filled."""
    return _in_layers(tables, TRACES, [])


def _drag_operations(tables: Tables) -> list[Operation]:
    """Operations that move velocities towards the mean of their neighbours."""
    if not tables.drag.rate.size:
        return []
    layers = tables.neighbours.layers
    lines = _chosen((LINES, has_layers(layers, 2)), number=NEIGHBOURS)
    found = [(MOVED, 0, BOND_STENCIL), *_exchanged(tables, NEIGHBOURS, [SLOTS + NEIGHBOURS], lines, ahead=False)]
    found += [(STRETCH, axis, NEIGHBOURS) for axis in (2, 1, 0) if has_layers(layers, axis)]
    return [*found, (DRAG, 0, BOND_STENCIL)]


def _in_layers(tables: Tables, number: int, plain: list[Operation]) -> list[Operation]:
    """Operations of a pass whose halo is filled; `plain` ones compute the sums with plain shifts."""
    axes = [axis for axis in (2, 1, 0) if has_layers(pass_of(tables, number).layers, axis)]
    return _chosen((LINES, 2 in axes), number=number) + plain + [(STRETCH, axis, number) for axis in axes]


def pass_of(tables: Tables, number: int) -> Pass:
    """Return the sums of a pass."""
    if number == BOND_STENCIL:
        n = tables.components
        return Pass(tables.sweep, tables.layers, tables.cuts, tables.surface, n, n)
    beside = tables.gradient_pass, tables.divergence_pass, tables.pushes, tables.traces, tables.neighbours
    return beside[number - GRADIENT]


def _sums(
    tables: Tables, number: int, halo: bool = False, ahead: bool = False, before: Sequence[Operation] = ()
) -> list[Operation]:
    """Operations of one pass.

    Parameters
    ----------
    tables : Tables
    number : int
        Number of the pass.
    halo : bool
        Whether to fill the halo of the field that it reads.
    ahead : bool
        Whether rows that need no halo may be swept in the meantime.
    before : sequence of operations
        Operations between filling the halo and the sweep.
    """
    _, layers, cuts, *_ = pass_of(tables, number)
    axes = [axis for axis in (2, 1, 0) if has_layers(layers, axis)]
    lines = _chosen((LINES, 2 in axes), number=number)
    found = _chosen((COPY, halo and tables.copies.size), number=number)
    found += _exchanged(tables, number, [LEVEL] * halo + [SLOTS + number], lines, ahead)
    found += [*before, *_chosen((SWEEP, 1), (CUT, cuts.nodes.size), number=number)]
    return found + [(STRETCH, axis, number) for axis in axes]


def _exchanged(
    tables: Tables, number: int, kinds: Sequence[int], lines: list[Operation], ahead: bool
) -> list[Operation]:
    """Operations by which other processes fill halos, axis by axis, since later axes pass on the halos of earlier ones.
    The layers continue the field along lines of the last axis, which needs no halo, before their results are sent. If
    `ahead`, rows that need no halo are swept in the meantime.
    """
    every = {axis: [3 * kind + axis for kind in kinds if is_used(tables, kind, axis)] for axis in HALOS}
    axes = [axis for axis, messages in every.items() if messages]
    hidden = [axis for axis in axes if axis < 2 and ahead and tables.free.any()]
    done = [] if axes else lines
    for axis in axes:
        levels, slots = (
            [(SEND, one, number) for one in every[axis] if (one // 3 == LEVEL) == level] for level in (True, False)
        )
        done += levels + lines * (axis == axes[0]) + slots
        if axis in hidden:
            done.append((AHEAD, 2 * hidden.index(axis) + len(hidden) - 1, number))
        done += [(RECEIVE, one, number) for one in every[axis]]
    return done


def is_used(tables: Tables, kind: int, axis: int) -> bool:
    """Whether there are messages of a kind along an axis."""
    return bool(tables.exchange[kind : kind + 1, axis, USED].any())


def beginning_operations(tables: Tables) -> list[Operation]:
    """Operations of the operator that initialise the memory of stretched derivatives, which then adds nothing to
    them.
    """
    begins = (STRETCH_STATES, STRETCH_FORCES)
    return [(one[0], 1 if one[0] in begins else one[1], one[2]) for one in operator_operations(tables, breaking=False)]


def sweep_operations(tables: Tables) -> list[Operation]:
    """Operations of the operator with plain shifts, using the halo of the level as it is."""
    return [
        one
        for one in operator_operations(tables, breaking=False)
        if one[0] in (SWEEP, CUT, LAW, DAMAGED, HEAT, HEAT_BEYOND) or (one[2] == DIVERGENCE and _fills_level(*one[:2]))
    ]


def state_operations(tables: Tables, halo: bool = False) -> list[Operation]:
    """Operations that compute the states of nodes with plain shifts, and, if asked for, fill the halo of the law's
    results.
    """
    return [
        one
        for one in sweep_operations(tables)
        if one[2] == GRADIENT or (halo and one[2] == DIVERGENCE and _fills_level(*one[:2]))
    ]


def layered_states(tables: Tables) -> list[Operation]:
    """Operations that compute the states of nodes, layers included, for a level whose halo is filled."""
    return [one for one in operator_operations(tables, breaking=False) if one[2] == GRADIENT]


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
    return tables._replace(heat=no_heat(law.values.dtype), bonds=bonds, gradient_pass=gradient_pass)


def without_contact(tables: Tables) -> Tables:
    """Return the same tables of a state-based medium whose absent bonds carry no compression."""
    if tables.bonds.forces:
        return tables
    return tables._replace(bonds=tables.bonds._replace(closing=tables.bonds.closing[:0]))


def _later(gradient_pass: Pass) -> bool:
    """Whether some states are complete only after all sums have been computed."""
    law, nodes = gradient_pass.sweep.law, gradient_pass.sweep.block[1:4]
    return bool((law.first > 0).any() or (law.end < nodes).any())


def _chosen(*wanted: tuple[int, int], number: int = BOND_STENCIL) -> list[Operation]:
    """Operations of those pairs (operation, whether there is anything to do) that have something to do."""
    return [(operation, 0, number) for operation, there in wanted if there]


def check_room(tables: Tables, inputs: Inputs, steps: int) -> None:
    """Check that the tables that the loop indexes by step and stage without checking bounds are large enough; the clock
    of exact ends counts once per stage.

    Raises
    ------
    IndexError
        If one of them is too small.
    """
    stages, ends = len(tables.numbers), tables.ends
    clock = int(ends.clock[0]) + steps * stages if len(ends.history) else 0
    fields, sums, held = inputs.source_fields, inputs.dependent_fields, len(inputs.held)
    for name, shape, least in (
        ("history", ends.history.shape[1:2], (clock,)),
        ("source_times", inputs.source_times.shape, (steps, stages, len(fields))),
        ("source_fields", fields.shape[1:], (len(inputs.source_nodes) if len(fields) else 0,)),
        ("held_values", inputs.held_values.shape, (steps if held else 0, held)),
        ("held_forces", inputs.held_forces.shape, (0, held if len(inputs.held_forces) else 0)),
        ("dependent_times", inputs.dependent_times.shape, (steps, stages, len(sums))),
        ("dependent_fields", sums.shape[1:], (len(tables.dependents.nodes),)),
    ):
        if len(shape) != len(least) or any(have < want for have, want in zip(shape, least, strict=True)):
            raise IndexError(
                f"the table {name} of the compiled loop has the shape {shape}, less than {least} for {steps} steps"
            )

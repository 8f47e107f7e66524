"""The operations of the compiled time loop.

A step consists of one or more *stages*. A stage sweeps the box of all nodes (``out = a*in + b*base + weights *
neighbours``, see `engine.sweep_program`), adds what the layers contribute (see `engine.layer_program`), and does
whatever else `engine.operations` lists. Levels are flat arrays laid out by `engine.layout`. For a field of several
components each level holds as many copies of the layout, one after the other.

The loop (`engine.loop`) calls each operation by its address, so that an operation is compiled when a run first needs
it, and the loop only once. All operations take the same arguments: the thread, the `Stage` and the `Sums` that they
work with, all tables, the inputs from outside, the number of the step within this call, and one more number, whose
meaning depends on the operation. `engine.codegen.build` writes this module out with the machine code of what is used.

Several threads go through the same operations, each with its chunk of every part, and meet at barriers.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from farhorizon.engine.bonds import CHUNK, StateBonds, bond_factor, bond_gap
from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.codegen.exchanges import RECEIVES, SENDS, TABLE, call_exchange
from farhorizon.engine.codegen.vector_operations import copy_run
from farhorizon.engine.damage import break_bonds, redo_damaged
from farhorizon.engine.dampers import advance_dampers
from farhorizon.engine.derivative_pml import stretch_forces, stretch_states
from farhorizon.engine.dissipation import move_dashpots
from farhorizon.engine.drag import drag_along, take_increments
from farhorizon.engine.ends import exact_ends
from farhorizon.engine.exchange import LEVEL
from farhorizon.engine.faces import press_faces
from farhorizon.engine.filter import damp_short_waves
from farhorizon.engine.impactors import add_work_of_pushes, push_nodes
from farhorizon.engine.operations import (
    ADD_SOURCES,
    ADVANCE_STRAINS,
    BREAK,
    COPY,
    CUT,
    DAMAGED,
    DAMP_NEW,
    DAMP_OLD,
    DAMPERS,
    DEPEND,
    DISSIPATE,
    DISSOLVE,
    DISSOLVE_HALO,
    DRAG,
    ENDS,
    FILTER,
    FLOW,
    HOLD,
    INERTIA,
    KEEP_INCREMENTS,
    OUTLINE,
    PUSH,
    RECEIVE,
    RELAX,
    RELEASE,
    SEND,
    STRETCH_FORCES,
    STRETCH_STATES,
    THERMAL_FORCES,
    THERMAL_FORCES_BEYOND,
    TOUCH,
    WORK,
    WORK_OF_PUSHES,
)
from farhorizon.engine.outline_stencil import fill_outline
from farhorizon.engine.phases import dissolve, dissolve_copies, find_runs
from farhorizon.engine.relaxations import relax_rows
from farhorizon.engine.release import break_by_energy
from farhorizon.engine.thermal_strain import (
    advance_thermal_strains,
    subtract_thermal_forces,
    subtract_thermal_forces_beyond,
)
from farhorizon.engine.threads import barrier, chunk_of

# A literal argument would have a type of its own, for each of which Numba compiles a function again.
ONE = np.int64(1)

#: The function that does each operation, by its number; `engine.loop` compiles it.
OPERATIONS: dict[int, Callable[..., Any]] = {}


def operation(number: int) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Register the function that does an operation."""

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        OPERATIONS[number] = function
        return function

    return decorate


@njit(error_model="numpy", cache=True, counted=False, entry=True)
def copy(array, copies, components):
    """Make the periodic copies."""
    copy_runs(array, copies, components, 0, copies.shape[1])


@njit(error_model="numpy", cache=True, counted=False)
def copy_runs(array, copies, components, first, last):
    """Make the periodic copies `first` to `last`, see `Layout.copies`."""
    apart, size = array.nbytes // components, array.itemsize
    for c in range(components):
        start = np.int64(array.ctypes.data) + c * apart
        for i in range(first, last):
            copy_run(start + copies[0, i] * size, start + copies[1, i] * size, copies[2, i], array[0])


@operation(COPY)
def copy_across(thread, stage, sums, tables, inputs, step, number):
    """Fill the halo that repeats what lies across periodic axes."""
    chunk = chunk_of(thread, tables.copies.shape[1])
    copy_runs(stage.src, tables.copies, stage.components, chunk[0], chunk[1])
    barrier(thread)


@operation(SEND)
def send_messages(thread, stage, sums, tables, inputs, step, number):
    """Begin the messages of one kind along one axis; until they end nothing changes what they are packed from."""
    if number // 3 != LEVEL:
        barrier(thread)  # all have filled their slots
    if thread.number == 0:
        exchange_by(SENDS, stage, sums, tables, number)


@operation(RECEIVE)
def receive_messages(thread, stage, sums, tables, inputs, step, number):
    """End messages: other processes have filled the halo of a level, or that of the layers' slots."""
    if thread.number == 0:
        exchange_by(RECEIVES, stage, sums, tables, number)
    barrier(thread)


@njit(error_model="numpy", cache=True, counted=False)
def exchange_by(column, stage, sums, tables, number):
    """Call a function of an exchange, given by its column in the table of messages."""
    messages = tables.exchange[number // 3, number % 3]
    array, components = (stage.src, stage.components) if number // 3 == LEVEL else (sums.layers.slots, ONE)
    start, apart = np.int64(array.ctypes.data), array.nbytes // components
    call_exchange(messages[column], messages[TABLE], start, components, apart)


@njit(error_model="numpy", cache=True, counted=False)
def run_start(nodes, i):
    """First place from i on at which the entries of another node begin."""
    while 0 < i < nodes.size and nodes[i] == nodes[i - 1]:
        i += 1
    return i


@operation(CUT)
def cut(thread, stage, sums, tables, inputs, step, number):
    """Subtract the absent bonds; all those of one node belong to one thread."""
    material, cuts = sums.material, sums.cuts
    src, base, out, components, rule = stage.src, stage.base, stage.out, stage.components, material.rule
    nodes, neighbours, weights, coefficient = cuts.nodes, cuts.neighbours, cuts.weights, material.coefficient
    chunk = chunk_of(thread, nodes.size)
    apart, rows = src.size // components, stage.rows
    for i in range(run_start(nodes, chunk[0]), run_start(nodes, chunk[1])):
        factor, c_node, c_neighbour = stage.scale, coefficient[0], coefficient[0]
        if coefficient.size > 1:
            c_node, c_neighbour = coefficient[nodes[i]], coefficient[neighbours[i]]
            factor *= bond_factor(rule, c_node, c_neighbour)
        for column in range(components):
            u_node, u_neighbour = src[nodes[i] + column * apart], src[neighbours[i] + column * apart]
            difference = factor * bond_gap(rule, c_node, c_neighbour, u_node, u_neighbour, material.ceiling)
            for row in range(rows):
                lost = weights[(i * rows + row) * components + column] * difference
                out[nodes[i] + row * apart] -= lost
                if stage.increments:
                    base[nodes[i] + row * apart] -= lost
    barrier(thread)


@operation(TOUCH)
def touch(thread, stage, sums, tables, inputs, step, number):
    """Let faces of cracks push each other, and slide."""
    faces = tables.faces
    chunk = chunk_of(thread, faces.nodes.size)
    first, last = run_start(faces.nodes, chunk[0]), run_start(faces.nodes, chunk[1])
    press_faces(stage, faces, tables.bonds.thermal_strain, first, last)
    barrier(thread)


@operation(DAMP_OLD)
def damp_old(thread, stage, sums, tables, inputs, step, number):
    """Damp the increment of the last step in absorbing zones."""
    src, base, damping = stage.src, stage.base, tables.damping
    for i in range(thread.number, damping.nodes.size, thread.threads):
        node = damping.nodes[i]
        if stage.increments:
            base[node] *= damping.before[i]
        else:
            base[node] = src[node] - (src[node] - base[node]) * damping.before[i]
    barrier(thread)


@operation(DAMP_NEW)
def damp_new(thread, stage, sums, tables, inputs, step, number):
    """Damp the increment of this step in absorbing zones, and let values leak there."""
    src, out, damping = stage.src, stage.out, tables.damping
    for i in range(thread.number, damping.nodes.size, thread.threads):
        node = damping.nodes[i]
        change, loss = (out[node] - src[node]) * damping.after[i], stage.scale * damping.leak[i] * src[node]
        out[node] = src[node] + change - loss
        if stage.increments:
            stage.base[node] = out[node] - src[node]
    barrier(thread)


@operation(INERTIA)
def scale_by_mobility(thread, stage, sums, tables, inputs, step, number):
    """Scale what forces have done to each node in this step by its mobility, to account for its mass; `base` still
    holds the level before `src`.
    """
    block, mobility = sums.sweep.block, tables.mobility
    apart, keep = stage.out.size // stage.components, -stage.b
    chunk = chunk_of(thread, block[1] * block[2])
    for row in range(chunk[0], chunk[1]):
        first = block[0] + row // block[2] * block[4] + row % block[2] * block[5]
        mobile = mobility[first : first + block[3]]
        for c in range(stage.components):
            start, end = first + c * apart, first + c * apart + block[3]
            src, base, out = stage.src[start:end], stage.base[start:end], stage.out[start:end]
            for i in range(block[3]):
                free = src[i] + keep * (src[i] - base[i])
                out[i] = free + mobile[i] * (out[i] - free)
    barrier(thread)


@operation(RELAX)
def relax_all_forces(thread, stage, sums, tables, inputs, step, number):
    """Relax the forces on nodes to which more has been added since the sweep."""
    rows = sums.sweep.block[2]
    chunk = chunk_of(thread, sums.sweep.block[1] * rows)
    for row in range(chunk[0], chunk[1]):
        relax_rows(stage, sums, tables, row // rows, row % rows, row % rows + 1, False)
    barrier(thread)


@operation(DISSIPATE)
def dissipate(thread, stage, sums, tables, inputs, step, number):
    """Move the dashpots of the mechanisms."""
    move_dashpots(thread, stage, sums.sweep.block, tables.relaxations, tables.dissipation)


@operation(ADD_SOURCES)
def add_sources(thread, stage, sums, tables, inputs, step, number):
    """Add the sources."""
    nodes, fields, scale = inputs.source_nodes, inputs.source_fields, tables.numbers[stage.part, 4]
    for j in range(fields.shape[0]):
        amplitude = scale * inputs.source_times[step, stage.part, j]
        if amplitude != 0:
            for i in range(thread.number, nodes.size, thread.threads):
                gain = amplitude * fields[j, i]
                stage.out[nodes[i]] += gain
                if stage.increments:
                    stage.base[nodes[i]] += gain
    barrier(thread)


@operation(HOLD)
def hold(thread, stage, sums, tables, inputs, step, number):
    """Set nodes to the values that they are given after each step, and add up the work of what holds them."""
    hold_nodes(thread, stage, tables.work, tables.mobility, inputs, step)
    barrier(thread)


@njit(error_model="numpy", cache=True, counted=False, entry=True)
def depend(stage, dependents, fields, times):
    """Set nodes, in order, to linear combinations of the values of others, plus fields times amplitudes."""
    nodes, starts, out = dependents.nodes, dependents.starts, stage.out
    for i in range(nodes.size):
        total = out[nodes[i]] * 0
        for k in range(starts[i], starts[i + 1]):
            total += dependents.weights[k] * out[dependents.sources[k]]
        for j in range(fields.shape[0]):
            total += times[j] * fields[j, i]
        out[nodes[i]] = total
        if stage.increments:
            stage.base[nodes[i]] = total - stage.src[nodes[i]]


@operation(DEPEND)
def set_dependent_nodes(thread, stage, sums, tables, inputs, step, number):
    """Set the dependent nodes. One thread does this, because each node may depend on the one before."""
    if thread.number == 0:
        depend(stage, tables.dependents, inputs.dependent_fields, inputs.dependent_times[step, stage.part])
    barrier(thread)


@njit(error_model="numpy", cache=True, counted=False)
def add_to(totals, account, gain):
    """Add to totals[0, account]; totals[1] holds the rounding errors of the sums (Neumaier)."""
    total = totals[0, account] + gain
    totals[1, account] += (
        (totals[0, account] - total) + gain
        if abs(totals[0, account]) >= abs(gain)
        else (gain - total) + totals[0, account]
    )
    totals[0, account] = total


@operation(FLOW)
def add_flow(thread, stage, sums, tables, inputs, step, number):
    """Add what flows along bonds into their nodes, account by account."""
    if thread.number == 0:
        add_flow_along_bonds(stage, sums.material, tables.flows)
    barrier(thread)


@njit(error_model="numpy", cache=True, counted=False)
def add_flow_along_bonds(stage, material, flows):
    """Do the same in one thread; a neighbour whose index is below 0 has the value zero."""
    nodes, neighbours, weights = flows.nodes, flows.neighbours, flows.weights
    src, rule, coefficient, effect = stage.src, material.rule, material.coefficient, flows.effects[stage.part]
    for i in range(flows.accounts.size):
        u_node = np.float64(src[nodes[i]])
        gain = -effect * weights[i] * u_node
        if neighbours[i] >= 0:
            c_node, c_neighbour, factor = coefficient[0], coefficient[0], 1.0
            if coefficient.size > 1:
                c_node, c_neighbour = coefficient[nodes[i]], coefficient[neighbours[i]]
                factor = bond_factor(rule, c_node, c_neighbour)
            u_neighbour, ceiling = np.float64(src[neighbours[i]]), np.float64(material.ceiling)
            gain = effect * weights[i] * bond_gap(rule, c_node, c_neighbour, u_node, u_neighbour, ceiling) * factor
        add_to(flows.totals, flows.accounts[i], gain)


def clear_inflow(thread, stage, sums, tables, inputs, step, number):
    """Set the level that takes what the layers contribute to zero."""
    if thread.number == 0:
        tables.flows.inflow[:] = 0
    barrier(thread)


def add_inflow(thread, stage, sums, tables, inputs, step, number):
    """Add to the flows what the layers along an axis, the number, have brought to the nodes beside them."""
    if thread.number == 0:
        flows = tables.flows
        sides, effect = flows.sides, flows.effects[stage.part]
        for i in range(sides.shape[0]):
            if sides[i, 0] == number:
                for k in range(sides[i, 2], sides[i, 3]):
                    add_to(flows.totals, sides[i, 1], effect * np.float64(flows.inflow[flows.beside[k]]))
    barrier(thread)


@operation(ENDS)
def add_exact_ends(thread, stage, sums, tables, inputs, step, number):
    """Add the forces of the chains beyond all exact ends, and to the flows what these bring to their drivers; an
    account below 0 means that there is none.
    """
    if thread.number == 0:
        ends, flows = tables.ends, tables.flows
        exact_ends(stage, ends)
        effect = flows.effects[stage.part]
        for end in range(flows.ends.shape[0]):
            for m in range(flows.ends.shape[1]):
                if flows.ends[end, m] >= 0:
                    add_to(flows.totals, flows.ends[end, m], effect * ends.forces[end, m])
    barrier(thread)


@operation(FILTER)
def filter_layers(thread, stage, sums, tables, inputs, step, number):
    """Damp short waves in the layers."""
    if (inputs.before[0] + step + 1) % tables.filter.every == 0:
        damp_short_waves(thread, stage, tables.filter)


@operation(DAMPERS)
def advance_hanging_masses(thread, stage, sums, tables, inputs, step, number):
    """Move the masses of the tuned dampers, which hang on nodes of the layers."""
    advance_dampers(thread, stage, tables.dampers)


@operation(KEEP_INCREMENTS)
def keep_increments(thread, stage, sums, tables, inputs, step, number):
    """Keep the increments of the last step, from which drag follows."""
    take_increments(thread, stage, tables.drag)


@operation(DRAG)
def drag_nodes(thread, stage, sums, tables, inputs, step, number):
    """Move velocities towards the mean of their neighbours."""
    drag_along(thread, stage, sums.sweep.block, tables.mobility, tables.drag)


@operation(WORK)
def sum_work(thread, stage, sums, tables, inputs, step, number):
    """Add up the work of the sources."""
    add_work(thread, stage, tables.work, inputs, inputs.source_times[step, stage.part])


@operation(PUSH)
def push_with_shapes(thread, stage, sums, tables, inputs, step, number):
    """Push the nodes in rigid shapes, and move these."""
    push_nodes(thread, stage, sums.sweep.block, tables.mobility, tables.impactors, inputs, step)


@operation(WORK_OF_PUSHES)
def sum_work_of_pushes(thread, stage, sums, tables, inputs, step, number):
    """Add up the work of rigid shapes on the nodes."""
    add_work_of_pushes(thread, stage, sums.sweep.block, tables.impactors, tables.work)


@operation(OUTLINE)
def fill_halo_of_outline(thread, stage, sums, tables, inputs, step, number):
    """Fill the halo along an outline."""
    fill_outline(thread, stage, tables.outline_stencil)


@operation(DISSOLVE)
def dissolve_nodes(thread, stage, sums, tables, inputs, step, number):
    """Turn solid nodes liquid; where some have changed, find the runs of tiles anew."""
    phases, coefficient = tables.phases, sums.material.coefficient
    dissolve(thread, stage.out, coefficient, sums.sweep, phases, inputs.before[0] + step + 1)
    barrier(thread)
    if phases.total[0] != phases.total[1]:
        find_runs(thread, phases)
        barrier(thread)
        if thread.number == 0:
            phases.total[1] = phases.total[0]
            copy(coefficient, tables.copies, ONE)
        barrier(thread)


@operation(DISSOLVE_HALO)
def dissolve_halo(thread, stage, sums, tables, inputs, step, number):
    """Do the same in the halo, as other processes have just filled it."""
    phases = tables.phases
    if thread.number == 0:
        dissolve_copies(stage.src, sums.material.coefficient, sums.sweep, phases)
    barrier(thread)
    if phases.total[0] != phases.total[1]:
        find_runs(thread, phases)
        barrier(thread)
        if thread.number == 0:
            phases.total[1] = phases.total[0]
        barrier(thread)


@operation(BREAK)
def break_stretched(thread, stage, sums, tables, inputs, step, number):
    """Break bonds that are stretched beyond their limit."""
    break_bonds(thread, stage, sums.sweep, sums.liquid, tables.bonds)


@operation(RELEASE)
def break_with_energy(thread, stage, sums, tables, inputs, step, number):
    """Break bonds with which enough energy is lost."""
    passes = tables.gradient_pass, tables.divergence_pass
    break_by_energy(thread, stage, StateBonds(sums.sweep, sums.liquid, passes[0], passes[1], tables.bonds))


@operation(DAMAGED)
def redo_nodes(thread, stage, sums, tables, inputs, step, number):
    """Recompute states or forces of nodes that have lost bonds; the number says which, see `engine.damage`."""
    passes = tables.gradient_pass, tables.divergence_pass
    redo_damaged(thread, stage, StateBonds(sums.sweep, sums.liquid, passes[0], passes[1], tables.bonds), number)


@operation(STRETCH_STATES)
def stretch_all_states(thread, stage, sums, tables, inputs, step, number):
    """Stretch the derivatives that nodes have for states, in the layers; if the number is 1 their memory begins."""
    stretch_states(thread, tables.gradient_pass.sweep.law, tables.stretches, number != 0)


@operation(STRETCH_FORCES)
def stretch_all_forces(thread, stage, sums, tables, inputs, step, number):
    """Stretch the derivatives of what the law has made of the states, in the layers; with 1 their memory begins."""
    stretch_forces(thread, stage, tables.gradient_pass.sweep.law, tables.stretches, number != 0)


@operation(THERMAL_FORCES)
def add_thermal_forces(thread, stage, sums, tables, inputs, step, number):
    """Subtract the effect of thermal strains from the forces of springs beside states."""
    subtract_thermal_forces(thread, stage, sums.sweep.block, sums.liquid, tables.bonds, tables.heat)


@operation(THERMAL_FORCES_BEYOND)
def add_thermal_forces_beyond(thread, stage, sums, tables, inputs, step, number):
    """Do the same for bonds without a law of their own, and for springs beside states, on all nodes."""
    subtract_thermal_forces_beyond(thread, stage, sums.sweep.block, sums.liquid, tables.bonds, tables.heat)


@operation(ADVANCE_STRAINS)
def step_thermal_strains(thread, stage, sums, tables, inputs, step, number):
    """Advance the thermal strains to those of the next step."""
    advance_thermal_strains(thread, tables.heat)


@njit(error_model="numpy", cache=True, entry=False)
def add_work(thread, stage, work, inputs, times):
    """Add the work of the sources over one step, ``f . (u(n+1) - u(n-1)) / 2``."""
    nodes, fields = inputs.source_nodes, inputs.source_fields
    for chunk in range(thread.number, (nodes.size + CHUNK - 1) // CHUNK, thread.threads):
        for j in range(fields.shape[0]):
            for i in range(chunk * CHUNK, min(nodes.size, (chunk + 1) * CHUNK)):
                change = np.float64(stage.out[nodes[i]]) - np.float64(stage.base[nodes[i]])
                work[chunk] += 0.5 * times[j] * fields[j, i] * change
    barrier(thread)  # the next sweep overwrites the older level


@njit(error_model="numpy", cache=True, counted=False)
def hold_nodes(thread, stage, work, mobility, inputs, step):
    """Set prescribed nodes to their values after a step. The constraint force follows from the difference to where the
    nodes would have moved freely; it and its work are recorded if wanted.
    """
    held, places, values = inputs.held, stage.out.size // stage.components, inputs.held_values[step]
    kept = step < inputs.held_forces.shape[0]
    for chunk in range(thread.number, (held.size + CHUNK - 1) // CHUNK, thread.threads):
        for i in range(chunk * CHUNK, min(held.size, (chunk + 1) * CHUNK)):
            node = held[i]
            free = np.float64(stage.out[node])
            stage.out[node] = values[i]
            if work.size or kept:
                now = np.float64(stage.out[node])
                mobile = np.float64(mobility[node % places]) if mobility.size else 1.0
                force = (now - free) / (stage.scale * mobile)
                if work.size:
                    work[chunk] += 0.5 * force * (now - np.float64(stage.base[node]))
                if kept:
                    inputs.held_forces[step, i] = force
            if stage.increments:
                stage.base[node] = stage.out[node] - stage.src[node]

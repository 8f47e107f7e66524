"""The operations of the compiled time loop.

A step consists of one or more *stages*. A stage sweeps the box of all nodes (``out = a*in + b*base + weights *
neighbours``, see `engine.sweep_program`), adds what the layers contribute (see `engine.layer_program`), and does
whatever features do (`engine.feature`). Levels are flat arrays laid out by `engine.layout`. For a field of several
components each level holds as many copies of the layout, one after the other.

The loop (`engine.loop`) calls each operation by its address, so that an operation is compiled when a run first needs
it, and the loop only once. All operations take the same arguments: the thread, the `Stage` and the `Sums` that they
work with, the tables that they read, the inputs from outside, the number of the step within this call, and one more
number, whose meaning depends on the operation.

Several threads go through the same operations, each with its chunk of every part, and meet at barriers.
"""

import numpy as np

from farhorizon.engine.bonds import StateBonds, bond_factor, bond_gap
from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.codegen.exchanges import RECEIVES, SENDS, TABLE, call_exchange
from farhorizon.engine.codegen.vector_operations import copy_run
from farhorizon.engine.damage import break_bonds, redo_damaged
from farhorizon.engine.derivative_pml import stretch_forces, stretch_states
from farhorizon.engine.exchange import LEVEL
from farhorizon.engine.passes import (
    BREAK,
    COPY,
    CUT,
    DAMAGED,
    RECEIVE,
    RELEASE,
    SEND,
    STRETCH_FORCES,
    STRETCH_STATES,
    operation,
    reads,
)
from farhorizon.engine.release import break_by_energy
from farhorizon.engine.threads import barrier, chunk_of, run_start

# A literal argument would have a type of its own, for each of which Numba compiles a function again.
ONE = np.int64(1)


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
@reads("copies")
def copy_across(thread, stage, sums, tables, inputs, step, number):
    """Fill the halo that repeats what lies across periodic axes."""
    chunk = chunk_of(thread, tables.copies.shape[1])
    copy_runs(stage.src, tables.copies, stage.components, chunk[0], chunk[1])
    barrier(thread)


@operation(SEND)
@reads("exchange")
def send_messages(thread, stage, sums, tables, inputs, step, number):
    """Begin the messages of one kind along one axis; until they end nothing changes what they are packed from."""
    if number // 3 != LEVEL:
        barrier(thread)  # all have filled their slots
    if thread.number == 0:
        exchange_by(SENDS, stage, sums, tables, number)


@operation(RECEIVE)
@reads("exchange")
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


@operation(BREAK)
@reads("bonds")
def break_stretched(thread, stage, sums, tables, inputs, step, number):
    """Break bonds that are stretched beyond their limit."""
    break_bonds(thread, stage, sums.sweep, sums.liquid, tables.bonds)


@operation(RELEASE)
@reads("bonds", "gradient_pass", "divergence_pass")
def break_with_energy(thread, stage, sums, tables, inputs, step, number):
    """Break bonds with which enough energy is lost."""
    passes = tables.gradient_pass, tables.divergence_pass
    break_by_energy(thread, stage, StateBonds(sums.sweep, sums.liquid, passes[0], passes[1], tables.bonds))


@operation(DAMAGED)
@reads("bonds", "gradient_pass", "divergence_pass")
def redo_nodes(thread, stage, sums, tables, inputs, step, number):
    """Recompute states or forces of nodes that have lost bonds; the number says which, see `engine.damage`."""
    passes = tables.gradient_pass, tables.divergence_pass
    redo_damaged(thread, stage, StateBonds(sums.sweep, sums.liquid, passes[0], passes[1], tables.bonds), number)


@operation(STRETCH_STATES)
@reads("gradient_pass", "stretches")
def stretch_all_states(thread, stage, sums, tables, inputs, step, number):
    """Stretch the derivatives that nodes have for states, in the layers; if the number is 1 their memory begins."""
    stretch_states(thread, tables.gradient_pass.sweep.law, tables.stretches, number != 0)


@operation(STRETCH_FORCES)
@reads("gradient_pass", "stretches")
def stretch_all_forces(thread, stage, sums, tables, inputs, step, number):
    """Stretch the derivatives of what the law has made of the states, in the layers; with 1 their memory begins."""
    stretch_forces(thread, stage, tables.gradient_pass.sweep.law, tables.stretches, number != 0)

"""Passes of the operator over the box of nodes, and the operations of which they consist.

A stage is a list of operations, which the compiled loop executes in order. `engine.program`, `sweep_program` and
`layer_program` have the functions that do those listed here, and each feature (`engine.feature_list`) has its own. The
plain numpy program of the tests executes the same lists.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from farhorizon.engine.codegen.exchanges import USED
from farhorizon.engine.exchange import LEVEL, SLOTS
from farhorizon.engine.layers import has_layers
from farhorizon.engine.layout import HALOS
from farhorizon.engine.tables import Pass, Tables

COPY = "copy"  # the halo copies what lies across periodic axes
LINES = "lines"  # layers continue the field along lines of the last axis
SWEEP = "sweep"  # out = a*src + b*base + scale*L(src), with plain shifts
CUT = "cut"  # contributions of absent bonds are subtracted
STRETCH = "stretch"  # the layers along an axis, the number, add the difference between stretched and plain shifts
LAW = "law"  # the law of the nodes is applied to their states
BREAK = "break"  # bonds beyond their limit break
RELEASE = "release"  # bonds break whose energy exceeds their limit
DAMAGED = "damaged"  # sums of nodes that have lost bonds are recomputed; the number says which, see `engine.damage`
SEND = "send"  # messages to other processes are started; the number is three times their kind plus their axis
RECEIVE = "receive"  # messages that fill the halo are completed; numbered as SEND
# SWEEP of rows that need no halo, while messages are under way: the number is twice that of a part of these rows, plus
# the number of other parts
AHEAD = "ahead"
STRETCH_STATES = "stretch states"  # layers stretch the derivatives in the states; with number 1 their memory begins
STRETCH_FORCES = "stretch forces"  # and those of the results of the law

# Passes of the operator: springs; sums over bonds that yield states; sums over states that yield forces; if heat passes
# through the layers, thermal forces and traces of the stresses; for drag, what layers add to sums over neighbours; and
# for flows, what they add to those of springs.
BOND_STENCIL, GRADIENT, DIVERGENCE, PUSHES, TRACES, NEIGHBOURS, INFLOW = range(7)
#: Fields of `Tables` with the passes other than the first.
FURTHER_PASSES = "gradient_pass", "divergence_pass", "pushes", "traces", "neighbours"

#: What is done, a number, and the pass of the operator to which it belongs.
Operation = tuple[str, int, int]
Function = Callable[..., Any]

#: The function that does each operation of the passes.
OPERATIONS: dict[str, Function] = {}
#: The tables that functions of the loop read, by their names.
READS: dict[Function, tuple[str, ...]] = {}


def reads(*names: str) -> Callable[[Function], Function]:
    """Register the tables that a function of the loop reads: what it is given as `tables` has these alone, so that it
    is compiled anew only if one of them changes.
    """

    def decorate(function: Function) -> Function:
        READS[function] = names
        return function

    return decorate


def operation(name: str) -> Callable[[Function], Function]:
    """Register the function that does an operation."""

    def decorate(function: Function) -> Function:
        OPERATIONS[name] = function
        return function

    return decorate


def present(*pairs: tuple[str, Any], number: int = BOND_STENCIL) -> list[Operation]:
    """Operations of those pairs (operation, whether there is anything to do) that have something to do."""
    return [(operation, 0, number) for operation, something in pairs if something]


def pass_of(tables: Tables, number: int) -> Pass:
    """Return the sums of a pass."""
    if number in (BOND_STENCIL, INFLOW):
        n = tables.components
        return Pass(tables.sweep, tables.layers, n, n, tables.cuts, tables.surface)
    passes: tuple[Pass, ...] = tuple(getattr(tables, name) for name in FURTHER_PASSES)
    return passes[number - GRADIENT]


def sums_of(
    tables: Tables, number: int, halo: bool = False, ahead: bool = False, before: Sequence[Operation] = ()
) -> list[Operation]:
    """Operations of one pass: it may fill the halo of the field that it reads, sweep rows that need no halo in the
    meantime (`ahead`), and do something `before` the sweep.
    """
    operands = pass_of(tables, number)
    layers, cuts = operands.layers, operands.cuts
    axes = [axis for axis in (2, 1, 0) if has_layers(layers, axis)]
    lines = present((LINES, 2 in axes), number=number)
    steps = present((COPY, halo and tables.copies.size), number=number)
    steps += exchanged(tables, number, [LEVEL] * halo + [SLOTS + number], lines, ahead)
    steps += [*before, *present((SWEEP, 1), (CUT, cuts.nodes.size), number=number)]
    return steps + [(STRETCH, axis, number) for axis in axes]


def exchanged(
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


def in_layers(tables: Tables, number: int, plain: list[Operation]) -> list[Operation]:
    """Operations of a pass whose halo is filled; `plain` ones compute the sums with plain shifts."""
    axes = [axis for axis in (2, 1, 0) if has_layers(pass_of(tables, number).layers, axis)]
    return present((LINES, 2 in axes), number=number) + plain + [(STRETCH, axis, number) for axis in axes]

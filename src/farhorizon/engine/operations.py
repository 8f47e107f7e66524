"""Operations of which a step consists: those of the operator (`engine.passes`), and those of the features."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from farhorizon.engine.damage import FORCES, STATES, STATES_AGAIN
from farhorizon.engine.exchange import LEVEL
from farhorizon.engine.feature import AFTER, BEFORE, CHANGE, DONE, HALO, OPERATOR
from farhorizon.engine.feature_list import FEATURES, operations_at, steps
from farhorizon.engine.features.faces import Faces
from farhorizon.engine.features.thermal_strain import ThermalStrains
from farhorizon.engine.layout import with_defaults
from farhorizon.engine.passes import (
    BOND_STENCIL,
    BREAK,
    COPY,
    CUT,
    DAMAGED,
    DIVERGENCE,
    GRADIENT,
    LAW,
    RECEIVE,
    RELEASE,
    SEND,
    STRETCH_FORCES,
    STRETCH_STATES,
    SWEEP,
    TRACES,
    Operation,
    exchanged,
    in_layers,
    present,
    sums_of,
)
from farhorizon.engine.tables import Asked, Inputs, Pass, Tables


def asked_by(inputs: Inputs) -> Asked:
    """Return which inputs there are."""
    return Asked(
        len(inputs.source_fields) > 0,
        inputs.held.size > 0,
        inputs.recorded_nodes.size > 0,
        inputs.impactor_paths.size > 0,
    )


def operations_of(tables: Tables, asked: Asked) -> tuple[tuple[Operation, ...], ...]:
    """Return the operations of each stage of a step."""

    def in_stage(stage: int) -> tuple[Operation, ...]:
        before, filled, change, after, done = (
            operations_at(place, tables, asked, stage) for place in (BEFORE, HALO, CHANGE, AFTER, DONE)
        )
        return (*before, *operator_operations(tables, filled), *change, *after, *done)

    return tuple(in_stage(stage) for stage in range(len(tables.numbers)))


def operator_operations(tables: Tables, before: Sequence[Operation] = (), breaking: bool = True) -> list[Operation]:
    """Operations of the operator, including its halo and layers. Some may come `before` its sweep; if `breaking`, bonds
    of state-based media may break.
    """
    breaks, by_energy = not tables.bonds.forces, len(tables.bonds.released) > 0
    may_break = breaking and breaks and np.isfinite(tables.bonds.limit[0])
    before = [*before, *present((BREAK, may_break and not by_energy), number=GRADIENT)]
    # In all stages or in none: the sweep reads what features set in the halo, and may overwrite one of the two levels
    # by which bonds break.
    ahead = not (breaks or operations_at(HALO, tables, Asked()))
    steps = sums_of(tables, BOND_STENCIL, halo=True, ahead=ahead, before=before)
    if tables.gradient_pass.sweep.law.values.size:
        stretched = tables.stretches.runs.size
        steps += sums_of(tables, GRADIENT) + present((STRETCH_STATES, stretched), number=GRADIENT)
        steps += present((LAW, _later(tables.gradient_pass)), number=GRADIENT) + [(DAMAGED, STATES, GRADIENT)] * breaks
        if may_break and by_energy:
            steps += present((COPY, tables.copies.size), number=DIVERGENCE)
            steps += exchanged(tables, DIVERGENCE, [LEVEL], lines=[], ahead=False)
            steps += [(RELEASE, 0, GRADIENT), (DAMAGED, STATES_AGAIN, GRADIENT)]
        steps += sums_of(tables, DIVERGENCE, halo=True, ahead=True)
        steps += present((STRETCH_FORCES, stretched), number=DIVERGENCE) + [(DAMAGED, FORCES, DIVERGENCE)] * breaks
    return steps + operations_at(OPERATOR, tables, Asked())


def trace_operations(tables: Tables) -> list[Operation]:
    """Operations by which layers add to the traces of the stresses, for a level whose halo is filled."""
    return in_layers(tables, TRACES, [])


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
    plain = [SWEEP, CUT, LAW, DAMAGED, *(step.name for step in steps() if step.place == OPERATOR)]
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


def _fills_level(operation: str, number: int) -> bool:
    return operation == COPY or (operation in (SEND, RECEIVE) and number // 3 == LEVEL)


def once(tables: Tables, operations: list[Operation], numbers: np.ndarray) -> Tables:
    """Return the same tables for one stage of some operations, with its numbers, in which no bond breaks."""
    return tables.replaced(
        operations=(tuple(operations),),
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
    return tables.replaced(
        heat=with_defaults(ThermalStrains, law.values.dtype), bonds=bonds, gradient_pass=gradient_pass
    )


def without_contact(tables: Tables) -> Tables:
    """Return the same tables of a state-based medium whose absent bonds carry no compression."""
    if tables.bonds.forces:
        return tables
    faces = with_defaults(Faces, tables.numbers.dtype)
    return tables.replaced(bonds=tables.bonds._replace(closing=tables.bonds.closing[:0]), faces=faces)


def with_histories_at_rest(tables: Tables) -> Tables:
    """Return the same tables for what is not a step of the run: bonds whose law is a function keep their histories, and
    faces that slide their slips.
    """
    if tables.faces.slips.size:
        tables = tables.replaced(faces=tables.faces._replace(moving=0))
    if not tables.bonds.parameters.size:
        return tables
    parameters = tables.bonds.parameters.copy()
    parameters[0] = 1
    return tables.replaced(bonds=tables.bonds._replace(parameters=parameters))


def _later(gradient_pass: Pass) -> bool:
    """Whether some states are complete only after all sums have been computed."""
    law, nodes = gradient_pass.sweep.law, gradient_pass.sweep.block[1:4]
    return bool((law.first > 0).any() or (law.end < nodes).any())


def check_room(tables: Tables, inputs: Inputs, steps: int) -> None:
    """Raise an IndexError if a table that the loop indexes by step and stage without checking bounds is too small."""
    for name, shape, least in (room for feature in FEATURES for room in feature.room(tables, inputs, steps)):
        if len(shape) != len(least) or any(have < want for have, want in zip(shape, least, strict=True)):
            raise IndexError(
                f"the table {name} of the compiled loop has the shape {shape}, less than {least} for {steps} steps"
            )

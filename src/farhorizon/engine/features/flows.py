"""Flows into the near field along bonds and from layers, integrated over time, in the compiled loop."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from farhorizon.engine.bonds import bond_factor, bond_gap
from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.feature import AFTER, Feature, Step
from farhorizon.engine.field import Field
from farhorizon.engine.layers import has_layers
from farhorizon.engine.layout import doubles, ints, reals, with_defaults
from farhorizon.engine.passes import INFLOW, STRETCH, Operation, reads
from farhorizon.engine.tables import Tables
from farhorizon.engine.threads import barrier

_NO_ENDS = np.zeros((0, 0), np.int64)


class Flows(NamedTuple):
    """Flows into the near field, integrated over time in a number of accounts."""

    effects: np.ndarray  # factor of the flow of each stage in that of a step
    accounts: np.ndarray = ints(0)  # of each bond, as are the next three
    nodes: np.ndarray = ints(0)
    neighbours: np.ndarray = ints(0)  # negative if the value there is zero
    weights: np.ndarray = doubles(0)
    ends: np.ndarray = ints(0, 0)  # accounts of the drivers of exact ends, negative for none; shape (ends, K)
    sides: np.ndarray = ints(0, 4)  # of each layer: axis, account, and first and last + 1 of `beside`
    beside: np.ndarray = ints(0)  # nodes next to layers
    inflow: np.ndarray = reals(0)  # level for intermediate results, empty without layers
    totals: np.ndarray = doubles(2, 0)  # sums, and their rounding errors (Neumaier)


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


@reads("flows")
def add_flow(thread, stage, sums, tables, inputs, step, number):
    """Add what flows along bonds into their nodes, account by account."""
    if thread.number == 0:
        add_flow_along_bonds(stage, sums.material, tables.flows)
    barrier(thread)


@reads("flows")
def add_inflow(thread, stage, sums, tables, inputs, step, number):
    """Add to the flows what the layers along an axis, the number, have brought to the nodes beside them; clear it."""
    if thread.number == 0:
        flows = tables.flows
        sides, effect = flows.sides, flows.effects[stage.part]
        for i in range(sides.shape[0]):
            if sides[i, 0] == number:
                for k in range(sides[i, 2], sides[i, 3]):
                    add_to(flows.totals, sides[i, 1], effect * np.float64(flows.inflow[flows.beside[k]]))
        flows.inflow[:] = 0
    barrier(thread)


def _none(engine: Field) -> Flows:
    return with_defaults(Flows, engine.dtype, effects=np.zeros(len(engine.stages.numbers)))


def _from_layers(tables: Tables, operation: Operation) -> list[Operation]:
    """Operations that add what the layers contribute, axis by axis."""
    name, _, which = operation
    axes = [axis for axis in range(3) if has_layers(tables.layers, axis)]
    return [each for axis in axes for each in ((STRETCH, axis, which), (name, axis, which))]


FLOWS = Feature(
    "flows",
    [
        Step(
            AFTER,
            add_inflow,
            lambda tables, _, stage: tables.flows.effects[stage] and tables.flows.inflow.size,
            around=_from_layers,
            which=INFLOW,
        ),
        Step(AFTER, add_flow, lambda tables, _, stage: tables.flows.effects[stage] != 0 and tables.flows.accounts.size),
    ],
    table=Flows,
    made=_none,
    sums=lambda flows: {"flows": flows.totals.T},
)


class FlowBonds(NamedTuple):
    """Bonds whose flow into their nodes is counted in accounts: places in a level, and weights without coefficients. A
    negative neighbour has the value zero.
    """

    accounts: np.ndarray
    nodes: np.ndarray
    neighbours: np.ndarray
    weights: np.ndarray


def record_flows(
    engine: Field,
    bonds: FlowBonds,
    effects: np.ndarray,
    count: int,
    ends: np.ndarray = _NO_ENDS,
    sides: Mapping[tuple[int, int], tuple[int, np.ndarray]] | None = None,
) -> None:
    """Integrate over time the flow along bonds into their nodes, in `count` accounts; `effects` are the factors of the
    flow of each stage in that of a step. First-order equations only.

    `ends`, shape (ends, K): accounts of the drivers of exact ends, -1 for none. `sides`: account of a layer (axis,
    side), and the nodes next to it whose inflow from the layer is counted.
    """
    beside, rows = [np.zeros(0, np.int64)], []
    for (axis, _), (account, nodes) in (sides or {}).items():
        first = sum(map(len, beside))
        rows.append((axis, account, first, first + len(nodes)))
        beside.append(nodes)
    flows = Flows(
        effects=effects.astype(float),
        accounts=bonds.accounts.astype(np.int64),
        nodes=bonds.nodes.astype(np.int64),
        neighbours=bonds.neighbours.astype(np.int64),
        weights=bonds.weights.astype(float),
        ends=ends,
        sides=np.array(rows, np.int64).reshape(-1, 4),
        beside=np.concatenate(beside),
        inflow=np.zeros(engine.layout.size if rows else 0, engine.dtype),
        totals=np.zeros((2, count)),
    )
    engine.replace(flows=flows)

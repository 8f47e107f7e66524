"""Nodes whose values depend on those of others, in the compiled loop."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.codegen.structs import Struct
from farhorizon.engine.feature import AFTER, Feature, Room, Step
from farhorizon.engine.field import Field
from farhorizon.engine.layout import ints, reals
from farhorizon.engine.passes import reads
from farhorizon.engine.tables import Inputs, Stage, Tables
from farhorizon.engine.threads import barrier


class Dependents(NamedTuple):
    """Nodes whose values depend on those of others: node i is the sum of weights[k] times node sources[k], k from
    starts[i] to starts[i + 1], plus a value from outside. They are set in this order.
    """

    nodes: np.ndarray = ints(0)
    starts: np.ndarray = ints(1)
    sources: np.ndarray = ints(0)
    weights: np.ndarray = reals(0)


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


@reads("dependents")
def set_dependent_nodes(thread, stage, sums, tables, inputs, step, number):
    """Set the dependent nodes. One thread does this, because each node may depend on the one before."""
    if thread.number == 0:
        depend(stage, tables.dependents, inputs.dependent_fields, inputs.dependent_times[step, stage.part])
    barrier(thread)


def _room(tables: Tables, inputs: Inputs, steps: int) -> list[Room]:
    fields, stages = inputs.dependent_fields, len(tables.numbers)
    return [
        ("dependent_times", inputs.dependent_times.shape, (steps, stages, len(fields))),
        ("dependent_fields", fields.shape[1:], (len(tables.dependents.nodes),)),
    ]


DEPENDENTS = Feature(
    "dependents",
    [Step(AFTER, set_dependent_nodes, lambda tables, *_: tables.dependents.nodes.size)],
    table=Dependents,
    map=lambda dependents: dependents,
    room=_room,
)


def set_dependents(
    engine: Field, nodes: np.ndarray, starts: np.ndarray, sources: np.ndarray, weights: np.ndarray
) -> None:
    """Set nodes with prescribed values: node i is the sum of weights[k] times node sources[k], k from starts[i] to
    starts[i + 1], plus a value passed to `advance`. They are set in this order after each stage.
    """
    nodes, starts, sources = (a.astype(np.int64) for a in (nodes, starts, sources))
    engine.replace(dependents=Dependents(nodes, starts, sources, weights.astype(engine.dtype)))


def set_dependent_values(engine: Field, values: np.ndarray) -> None:
    """Set the dependent nodes of the current level; `values` holds, for each of them, what is added to its
    combination.
    """
    level, unit = engine.current, engine.dtype.type(1)
    factors = dict.fromkeys(("a", "a_difference", "b", "scale"), unit)
    stage = Stage(level, level, level, components=engine.components, rows=engine.components, **factors)
    fields = np.asarray(values, engine.dtype)[None]
    depend(Struct(stage), Struct(engine.tables.dependents), fields, np.ones(1, engine.dtype))

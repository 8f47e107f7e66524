"""Absorbing zones that damp increments, and let values leak, in the compiled loop."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from farhorizon.engine.feature import BEFORE, CHANGE, Feature, Step
from farhorizon.engine.features.filter import without
from farhorizon.engine.field import Field
from farhorizon.engine.layout import ints, reals
from farhorizon.engine.passes import reads
from farhorizon.engine.tables import Tables
from farhorizon.engine.threads import barrier


class Damping(NamedTuple):
    """Nodes of an absorbing zone: factors of the old and of the new increment, and a loss rate."""

    nodes: np.ndarray = ints(0)
    before: np.ndarray = reals(0)
    after: np.ndarray = reals(0)
    leak: np.ndarray = reals(0)


@reads("damping")
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


@reads("damping")
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


def _used(tables: Tables, *_: Any) -> int:
    return int(tables.damping.nodes.size)


DAMPING = Feature(
    "damping",
    [Step(BEFORE, damp_old, _used), Step(CHANGE, damp_new, _used)],
    table=Damping,
    map=lambda damping: damping,
)


def set_damping(engine: Field, nodes: np.ndarray, before: np.ndarray, after: np.ndarray, leak: np.ndarray) -> None:
    """Set the nodal factors of an absorbing zone: for the old increment, for the new increment, and a loss rate. Nodes
    that lose all of their new increment stay where they are.
    """
    if nodes.size:
        engine.replace(filter=without(engine.tables.filter, lambda damped: np.isin(damped, nodes[after == 0])))
    factors = (factor.astype(engine.dtype) for factor in (before, after, leak))
    engine.replace(damping=Damping(nodes.astype(np.int64), *factors))

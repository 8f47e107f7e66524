"""Sources: fields times amplitudes that are added in each stage, and their work, in the compiled loop."""

from __future__ import annotations

import numpy as np

from farhorizon.engine.bonds import CHUNK
from farhorizon.engine.feature import AFTER, CHANGE, Feature, Room, Step
from farhorizon.engine.field import Field
from farhorizon.engine.layout import doubles
from farhorizon.engine.passes import reads
from farhorizon.engine.tables import Inputs, Tables
from farhorizon.engine.threads import barrier


@reads("numbers")
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


@reads("work")
def sum_work(thread, stage, sums, tables, inputs, step, number):
    """Add the work of the sources over one step, ``f . (u(n+1) - u(n-1)) / 2``."""
    work, times = tables.work, inputs.source_times[step, stage.part]
    nodes, fields = inputs.source_nodes, inputs.source_fields
    for chunk in range(thread.number, (nodes.size + CHUNK - 1) // CHUNK, thread.threads):
        for j in range(fields.shape[0]):
            for i in range(chunk * CHUNK, min(nodes.size, (chunk + 1) * CHUNK)):
                change = np.float64(stage.out[nodes[i]]) - np.float64(stage.base[nodes[i]])
                work[chunk] += 0.5 * times[j] * fields[j, i] * change
    barrier(thread)  # the next sweep overwrites the older level


def _room(tables: Tables, inputs: Inputs, steps: int) -> list[Room]:
    fields, stages = inputs.source_fields, len(tables.numbers)
    return [
        ("source_times", inputs.source_times.shape, (steps, stages, len(fields))),
        ("source_fields", fields.shape[1:], (len(inputs.source_nodes) if len(fields) else 0,)),
    ]


SOURCES = Feature(
    "work",  # accumulated work of the sources, or empty
    [
        Step(CHANGE, add_sources, lambda tables, asked, _: asked.has_sources),
        Step(AFTER, sum_work, lambda tables, asked, _: asked.has_sources and tables.work.size),
    ],
    table=doubles(0),
    sums=lambda work: {"work": work[None]},
    room=_room,
)


def record_work(engine: Field) -> None:
    """Accumulate the work of the sources from now on; the older level must outlive a step."""
    engine.replace(work=np.zeros(-(-engine.components * int(np.prod(engine.core.nodes)) // CHUNK)))


def work_of_sources(engine: Field) -> float:
    """Work of the sources, per unit mass of a node."""
    return float(engine.tables.work.sum())

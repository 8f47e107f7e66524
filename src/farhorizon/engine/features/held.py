"""Nodes with prescribed values, and the forces that hold them, in the compiled loop."""

from __future__ import annotations

import numpy as np

from farhorizon.engine.bonds import CHUNK
from farhorizon.engine.feature import CHANGE, Feature, Room, Step
from farhorizon.engine.passes import reads
from farhorizon.engine.tables import Inputs, Tables
from farhorizon.engine.threads import barrier


@reads("work", "mobility")
def hold(thread, stage, sums, tables, inputs, step, number):
    """Set prescribed nodes to their values after a step. The constraint force follows from the difference to where the
    nodes would have moved freely; it and its work are recorded if wanted.
    """
    work, mobility = tables.work, tables.mobility
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
    barrier(thread)


def _room(tables: Tables, inputs: Inputs, steps: int) -> list[Room]:
    held = len(inputs.held)
    return [
        ("held_values", inputs.held_values.shape, (steps if held else 0, held)),
        ("held_forces", inputs.held_forces.shape, (0, held if len(inputs.held_forces) else 0)),
    ]


HELD = Feature("held", [Step(CHANGE, hold, lambda tables, asked, _: asked.held)], room=_room)

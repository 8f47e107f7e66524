"""What processes would send each other in a run that is set up on one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from farhorizon.engine.engine import Engine
from farhorizon.errors import InputError
from farhorizon.geometry.decomposition import Decomposition, Key
from farhorizon.simulation.share import boxes_of, check_shareable

_COUNTS = 1, 2, 8, 64, 512


def rows_on_processes(run: Any, topology: Sequence[int] | None = None) -> list[tuple[str, str]]:
    """For numbers of processes the boxes that a run makes, what a process sends in a step, and how much that is beside
    what it computes, as rows of a report; or why it does not run on several.

    Parameters
    ----------
    run : Simulation
    topology : sequence of int, optional
        Boxes along the axes that are wanted, beside those that are chosen.
    """
    try:
        check_shareable(run.setup, run.recorders)
    except InputError as error:
        return [("several processes", str(error))]
    wanted = [] if topology is None else [(int(np.prod(topology)), topology)]
    found = []
    for count, given in [*((count, None) for count in _COUNTS), *wanted]:
        try:
            boxes = boxes_of(replace(run.setup, model=run.model), run.parts.around, count, given)
        except InputError as error:
            found.append((f"{count} processes", f"{error.message}: {error.limit}"))
            continue
        most = max(boxes.corners(), key=lambda number: sent_by(boxes, number, run))
        sent, size = sent_by(boxes, most, run), int(np.prod(boxes.size(most, nodes_beyond(run))))
        own = size * sum(numbers_sent(run.engine)) * run.engine.dtype.itemsize
        words = f"sends at most {sent / 1024:.3g} KiB a step, {100 * sent / own:.3g} % of the values that it computes"
        name = f"{count} process{'es' * (count > 1)}"
        found.append(
            (name, f"{' x '.join(map(str, boxes.topology))} boxes; each {words}" if sent else "nothing is sent")
        )
    return found


def nodes_beyond(run: Any) -> dict[Key, int]:
    """Nodes of the engine beyond each side of the near field: margins and layers."""
    grid, layout = run.parts.grid, run.engine.layout
    sides = {-1: layout.low, 1: layout.high}
    return {
        (axis, side): grid.margins[axis, side] + sides[side][grid.lead + axis]
        for axis in range(run.lattice.dim)
        for side in (-1, 1)
    }


def numbers_sent(engine: Engine) -> list[int]:
    """Numbers of a node beside a cut that are sent in a step, message by message."""
    states = [] if engine.passes is None else [engine.tables.scatter.columns]
    return [engine.components, *states] * len(engine.stages.numbers)


def sent_by(boxes: Decomposition, number: int, run: Any) -> int:
    """Bytes that a process sends to others in a step: of fields the values of nodes, and of layers along the last axis
    those of the lines that are cut across.

    Parameters
    ----------
    boxes : Decomposition
    number : int
        Of the process.
    run : Simulation
        On one process.
    """
    engine, beyond = run.engine, nodes_beyond(run)
    # of one pass: of a stencil composed of two each pass exchanges its own halo
    reach = np.abs(engine.offsets[:, -run.lattice.dim :]).max(axis=0).tolist()
    nodes = boxes.exchanged(number, reach, beyond)
    values = sum(nodes) * sum(numbers_sent(engine))
    lines = sum(nodes[:-1]) // boxes.size(number, beyond)[-1]
    place, last = boxes.place(number)[-1], boxes.topology[-1] - 1
    for side, outer in ((-1, place == 0), (1, place == last)):
        values += outer * lines * engine.in_a_line(side) * len(engine.stages.numbers)
    return values * engine.dtype.itemsize

"""What processes would send each other in a run that is set up on one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from farhorizon.engine.engine import Engine
from farhorizon.errors import InputError
from farhorizon.geometry.decomposition import Decomposition, Key
from farhorizon.simulation.share import boxes_of, check_shareable, work_beyond
from farhorizon.simulation.steps import seconds_of

_COUNTS = 1, 2, 8, 64, 512
#: Of a message between two processes of one machine, both ways at once: seconds whatever its size, and bytes a second
#: (`python benchmarks/scaling.py messages`, on two busy cores; `docs/howto/processes.md`).
_LATENCY, _BANDWIDTH = 15e-6, 1.3e9
#: What of that does not count where nodes are swept meanwhile (`python benchmarks/scaling.py overlap`).
_HIDDEN = 0.5


def rows_on_processes(run: Any, topology: Sequence[int] | None = None) -> list[tuple[str, str]]:
    """For numbers of processes the boxes that a run makes, what a process sends in a step, how much that is beside what
    it computes, what it holds in memory and how efficient it would be, as rows of a report; or why it does not run on
    several.

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
    found, seconds = [], seconds_of(run.engine)
    whole = float(np.prod(run.engine.layout.box.nodes))
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
        each = max(np.prod(boxes.size(number, nodes_beyond(run))) for number in boxes.corners())
        words = f"{' x '.join(map(str, boxes.topology))} boxes; each {words}" if sent else "nothing is sent"
        words += f"; {run.engine.nbytes * each / whole / 2**20:.3g} MiB each"
        if count > 1:
            words += f"; {100 * efficiency(boxes, run, seconds):.3g} % efficient, as predicted"
        found.append((name, words))
    return found


def efficiency(boxes: Decomposition, run: Any, seconds: float) -> float:
    """The time of a step on one process over that on so many, times their number, as far as it can be foreseen.

    A process takes the time of its part of the work, layers counted, and that of its messages one after the other, each
    a latency and its bytes over a bandwidth, which are those of two processes on one machine. A part of that passes
    while nodes are swept that need no halo, at most as long as these take. What processes on one processor take from
    each other's memory is not in it.

    Parameters
    ----------
    boxes : Decomposition
    run : Simulation
        On one process.
    seconds : float
        Of a step of the run.
    """
    work = {key: round(nodes) for key, nodes in work_beyond(run.parts.around, run.stencil, run.lattice).items()}
    all_of_it = np.prod([n + work[a, -1] + work[a, 1] for a, n in enumerate(run.lattice.shape)])

    def taken(number: int) -> float:
        own, free = np.prod(np.array(boxes.size(number, work))), swept_ahead(boxes, number, run)
        messages = _seconds_of_messages(boxes, number, run)
        return float(seconds * own / all_of_it + messages - min(_HIDDEN * messages, seconds * free / all_of_it))

    return float(seconds / (max(map(taken, boxes.corners())) * int(np.prod(boxes.topology))))


def _seconds_of_messages(boxes: Decomposition, number: int, run: Any) -> float:
    others = [other for other in boxes.neighbours(number).values() if other not in (-1, number)]
    count = len(others) * len(numbers_sent(run.engine))
    return count * _LATENCY + sent_by(boxes, number, run) / _BANDWIDTH


def swept_ahead(boxes: Decomposition, number: int, run: Any) -> int:
    """Nodes of a process that are swept while messages travel, see `farhorizon.engine.exchange.free_of_halos`: none
    where states break, and of bonds with a law of their own and of metal that dissolves whole rows alone.
    """
    tables, reach = run.engine.tables, run.engine.layout.reach[-run.lattice.dim :]
    whole_rows = tables.bonds.places.size or tables.phases.runs.size
    if not tables.bonds.forces or (whole_rows and (run.lattice.dim - 1, 1) in boxes.neighbours(number)):
        return 0
    nodes = boxes.size(number, nodes_beyond(run))
    for (axis, _), other in boxes.neighbours(number).items():
        nodes[axis] -= reach[axis] * (other >= 0)
    return int(np.prod(np.maximum(nodes, 0)))


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

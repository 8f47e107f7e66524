"""Prediction of the communication between several processes, for a run set up on one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from farhorizon.engine.engine import Engine
from farhorizon.errors import InputError
from farhorizon.geometry.decomposition import Decomposition, Key
from farhorizon.simulation.processes.load_balance import cost_along, cost_per_node
from farhorizon.simulation.processes.subdomain import boxes_of, check_divisible, cost_beyond
from farhorizon.simulation.time.steps import seconds_of

_COUNTS = 1, 2, 8, 64, 512  # of processes; a report has one row for each
#: Latency in seconds and bandwidth in bytes per second of messages between two processes on one machine, in both
#: directions at once; and what remains of both while rows are swept meanwhile
#: (`python benchmarks/scaling.py messages`, on two busy cores; `docs/explanation/processes.md`).
_MESSAGE, _OVERLAPPED = (20e-6, 1.9e9), (3.5e-6, 3.6e9)


def rows_on_processes(run: Any, topology: Sequence[int] | None = None) -> list[tuple[str, str]]:
    """Return rows of a report on a run with several numbers of processes, and with a topology of boxes if it is given:
    the boxes, what a process sends in a step, how much that is relative to what it computes, its memory and the
    efficiency; or why the run needs a single process.
    """
    try:
        check_divisible(run.setup, run.recorders)
    except InputError as error:
        return [("several processes", str(error))]
    asked = [] if topology is None else [(int(np.prod(topology)), topology)]
    rows, seconds = [], seconds_of(run.engine)
    beyond = cost_beyond(run.parts.layered, run.stencil, run.lattice)
    cost = cost_per_node(run.setup, run.model, run.lattice)
    along = cost_along(run.setup, run.model, beyond)
    all_nodes = float(run.engine.size)
    for count, given in [*((count, None) for count in _COUNTS), *asked]:
        try:
            boxes = boxes_of(run.setup, run.model, run.parts.layered, count, given, work=along)
        except InputError as error:
            rows.append((f"{count} processes", f"{error.message}: {error.limit}"))
            continue
        most = max(boxes.corners(), key=lambda number: halo_bytes(boxes, number, run))
        sent, size = halo_bytes(boxes, most, run), int(np.prod(boxes.size(most, nodes_beyond(run))))
        computed = size * sum(halo_numbers(run.engine)) * run.engine.dtype.itemsize
        words = (
            f"sends at most {sent / 1024:.3g} KiB a step, {100 * sent / computed:.3g} % of the values that it computes"
        )
        words = f"{' x '.join(map(str, boxes.topology))} boxes; each {words}" if sent else "nothing is sent"
        largest = max(np.prod(boxes.size(number, nodes_beyond(run))) for number in boxes.corners())
        words += f"; {run.engine.nbytes * largest / all_nodes / 2**20:.3g} MiB each"
        if count > 1:
            work = cost_of_boxes(boxes, cost, beyond)
            words += f"; the busiest has {work.max() / work.mean():.3g} of the mean work"
            words += f"; {100 * efficiency(boxes, work, run, seconds):.3g} % efficient, as predicted"
        rows.append((f"{count} process{'es' * (count > 1)}", words))
    return rows


def cost_of_boxes(boxes: Decomposition, cost: np.ndarray, beyond: Mapping[Key, float]) -> np.ndarray:
    """Return the work of each box, given that of each node; outer boxes have the nodes `beyond` the sides, too."""
    widths = [(round(beyond.get((a, -1), 0.0)), round(beyond.get((a, 1), 0.0))) for a in range(cost.ndim)]
    work = np.pad(cost, widths, constant_values=1.0)
    for axis, (ends, (low, _)) in enumerate(zip(boxes.cuts, widths, strict=True)):
        work = np.add.reduceat(work, [0, *(low + end for end in ends[1:-1])], axis)
    return work.ravel()


def efficiency(boxes: Decomposition, work: np.ndarray, run: Any, seconds: float) -> float:
    """Predict the parallel efficiency, given the work of each box and the time of a step of the run on one process:
    this time divided by that on several and by their number.

    A process takes the time of its fraction of the work plus that of its messages, one after the other. Each message
    takes a latency plus its bytes over a bandwidth, as measured between two processes on one machine. A part of those
    along all axes but the last overlaps with the sweep of rows that need no halo, for at most as long as that takes.
    Competition of processes for the memory bandwidth of one processor is not included.
    """
    fractions = work / work.sum()

    def taken(number: int) -> float:
        ahead = swept_ahead(boxes, number, run) / work.sum()
        messages, rest = (_seconds_of_messages(boxes, number, run, *link) for link in (_MESSAGE, _OVERLAPPED))
        overlap = min(sum(messages[:-1]) - sum(rest[:-1]), seconds * ahead)
        return float(seconds * fractions[number] + sum(messages) - overlap)

    slowest = max(map(taken, {*boxes.corners(), int(fractions.argmax())}))
    return float(seconds / (slowest * int(np.prod(boxes.topology))))


def _seconds_of_messages(boxes: Decomposition, number: int, run: Any, latency: float, bandwidth: float) -> list[float]:
    """Return the time that the messages of a process take along each axis."""
    cut = [axis for (axis, _), neighbour in boxes.neighbours(number).items() if neighbour not in (-1, number)]
    counts = [cut.count(axis) * len(halo_numbers(run.engine)) for axis in range(run.lattice.dim)]
    volumes = zip(counts, halo_bytes_along(boxes, number, run), strict=True)
    return [count * latency + sent / bandwidth for count, sent in volumes]


def swept_ahead(boxes: Decomposition, number: int, run: Any) -> int:
    """Return the number of nodes of a process that are swept while messages travel, see
    `farhorizon.engine.exchange.free_of_halos`: 0 for states that break, and for metal that dissolves, because some of
    it may lie beside cuts.
    """
    bonds = run.engine.bonds
    if (bonds and not bonds.forces) or run.engine.get("phases.runs").size:
        return 0
    nodes, reach = boxes.size(number, nodes_beyond(run)), run.parts.grid.layout.reach[-run.lattice.dim :]
    for (axis, _), neighbour in boxes.neighbours(number).items():
        nodes[axis] -= reach[axis] * (neighbour >= 0 and axis < run.lattice.dim - 1)
    return int(np.prod(np.maximum(nodes, 0)))


def nodes_beyond(run: Any) -> dict[Key, int]:
    """Return the number of nodes of the engine beyond each side of the near field: margins and layers."""
    grid, layout = run.parts.grid, run.parts.grid.layout
    sides = {-1: layout.low, 1: layout.high}
    return {
        (axis, side): grid.margins[axis, side] + sides[side][grid.lead + axis]
        for axis in range(run.lattice.dim)
        for side in (-1, 1)
    }


def halo_numbers(engine: Engine) -> list[int]:
    """Return how many numbers per node beside a cut are sent in a step, message by message."""
    states = [] if engine.passes is None else [engine.tables.divergence_pass.columns]
    return [engine.components, *states] * len(engine.stages.numbers)


def halo_bytes(boxes: Decomposition, number: int, run: Any) -> int:
    """Return the bytes that a process sends to others in a step; see `halo_bytes_along`."""
    return sum(halo_bytes_along(boxes, number, run))


def halo_bytes_along(boxes: Decomposition, number: int, run: Any) -> list[int]:
    """Return the bytes that a process sends to others in a step along each axis, given the run on one process: field
    values at nodes, and values of the lines of layers along the last axis that cross a cut.
    """
    engine, beyond = run.engine, nodes_beyond(run)
    # the reach of one pass: with two passes, each exchanges a halo of its own
    reach = np.abs(engine.offsets[:, -run.lattice.dim :]).max(axis=0).tolist()
    nodes = boxes.exchanged(number, reach, beyond)
    place, last = boxes.place(number)[-1], boxes.topology[-1] - 1
    length = boxes.size(number, beyond)[-1] + 2 * reach[-1]  # nodes of each line that is sent
    in_a_line = sum(outer * engine.in_a_line(side) for side, outer in ((-1, place == 0), (1, place == last)))
    lines = [count // length * in_a_line * len(engine.stages.numbers) for count in nodes[:-1]] + [0]
    values = [count * sum(halo_numbers(engine)) for count in nodes]
    return [sum(numbers) * engine.dtype.itemsize for numbers in zip(values, lines, strict=True)]

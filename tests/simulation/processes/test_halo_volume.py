"""Predicted communication of a run on several processes; `test_process_group` compares it with what they send."""

import pytest

import farhorizon as fh
from farhorizon.simulation.processes.halo_volume import (
    _MESSAGE,
    _OVERLAPPED,
    cost_of_boxes,
    efficiency,
    halo_bytes_along,
    rows_on_processes,
    swept_ahead,
)
from farhorizon.simulation.processes.load_balance import cost_per_node
from farhorizon.simulation.processes.subdomain import boxes_of, cost_beyond


def square(**more):
    given = {"initial": {"u": "exp(-x**2 - y**2)"}, "boundary": fh.Fixed(), "model": fh.Wave(fh.Kernel(0.5))} | more
    return fh.Simulation(fh.Lattice(0.5, (-10, -10), (10, 10)), **given)


def predicted(boxes, run, seconds):
    """Return the efficiency predicted from the work of the boxes."""
    beyond = cost_beyond(run.parts.layered, run.stencil, run.lattice)
    return efficiency(
        boxes, cost_of_boxes(boxes, cost_per_node(run.setup, run.model, run.lattice), beyond), run, seconds
    )


def test_what_is_sent_by_hand():
    """A square of 41 nodes with reach 1, cut in the middle: 41 values and the halo at both ends are sent, while 41
    times 20 or 21 are computed.
    """
    rows = dict(rows_on_processes(square()))
    assert rows["1 process"].startswith("nothing is sent; ")
    words = f"2 x 1 boxes; each sends at most {43 * 8 / 1024:.3g} KiB a step"
    assert rows["2 processes"].startswith(words) and "% of the values that it computes; " in rows["2 processes"]
    assert rows["2 processes"].endswith("% efficient, as predicted") and " MiB each; " in rows["2 processes"]
    assert rows["8 processes"].startswith("4 x 2 boxes") and rows["64 processes"].startswith("8 x 8 boxes")
    # boxes of three nodes at least
    assert rows["512 processes"] == "cannot be cut into so many boxes" or "at most 13 x 13" in rows["512 processes"]


def test_efficiencies_by_hand():
    """41 rows cut into 21 and 20: the slower process takes 21/41 of the time, plus that of one message of 43 values,
    part of which overlaps with the sweep of 20 of the rows.
    """
    run = square()
    boxes = boxes_of(run.setup, run.model, run.parts.layered, 2)
    for seconds in (1e-6, 1e-3, 10.0):
        message, overlapped = (latency + 43 * 8 / bandwidth for latency, bandwidth in (_MESSAGE, _OVERLAPPED))
        left = max(overlapped, message - seconds * 20 / 41)
        assert predicted(boxes, run, seconds) == pytest.approx(seconds / 2 / (seconds * 21 / 41 + left), rel=1e-12)
    assert [swept_ahead(boxes, number, run) for number in range(2)] == [41 * 19, 41 * 20]
    # layers count as work: the box with one is smaller
    layer = square(boundary={"x-": fh.LatticePML(nodes=10), "all": fh.Fixed()}, initial={})
    two = boxes_of(layer.setup, layer.model, layer.parts.layered, 2, [2, 1])
    assert 0.95 < predicted(two, layer, 10.0) <= 1 and two.size(0, {})[0] < two.size(1, {})[0]


def test_what_is_swept_ahead():
    """Nothing while messages travel along the last axis, and nothing of states that break."""
    run, seconds = square(), 1e-3
    boxes = boxes_of(run.setup, run.model, run.parts.layered, 2, [1, 2])
    message = _MESSAGE[0] + 41 * 8 / _MESSAGE[1]
    assert predicted(boxes, run, seconds) == pytest.approx(seconds / 2 / (seconds * 21 / 41 + message), rel=1e-12)
    # four boxes: along the first axis the halo of the last one is sent, too
    four = boxes_of(run.setup, run.model, run.parts.layered, 4)
    assert four.topology == (2, 2) and halo_bytes_along(four, 3, run) == [8 * (21 + 2), 8 * 21]
    assert swept_ahead(four, 3, run) == 20 * 21
    bonds = square(model=fh.Elastic(fh.Kernel(0.5), 1.0, critical_stretch=1.0), initial={})
    assert swept_ahead(four, 3, bonds) == 20 * 21
    states = fh.Elastic(fh.Kernel(0.5), 1.0, 0.3, material="state-based", critical_stretch=1.0)
    assert swept_ahead(four, 3, square(model=states, initial={}, boundary=fh.Free())) == 0


def test_boxes_that_are_asked_for():
    rows = rows_on_processes(square(), [1, 3])
    assert rows[-1][0] == "3 processes" and rows[-1][1].startswith("1 x 3 boxes")


def test_what_runs_on_one_process_alone_is_said():
    disc = fh.Lattice(0.5, window=fh.Disc(5.0, (0.0, 0.0)))
    ((name, why),) = rows_on_processes(fh.Simulation(disc, fh.Wave(fh.Kernel(0.5)), fh.Higdon(2)))
    assert name == "several processes" and "Higdon are not computed on several processes" in why


def test_it_stands_in_the_details():
    report = square().check(until=1.0, budget=0.05)
    assert "2 processes" in report.details and "2 processes" not in str(report)

"""Predicted cost of a run on the extended domain, against that domain itself."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.checks.run_cost import RunCost, extended_run_cost, run_cost, seconds_near_breaking

PULSE = {1: "exp(-(x-20)**2/8)", 2: "exp(-((x-20)**2 + (y-12)**2)/8)", 3: "exp(-((x-6)**2 + (y-6)**2 + (z-6)**2)/4)"}
SHAPE = {1: (40,), 2: (40, 24), 3: (13, 13, 13)}


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_nodes_and_memory_are_those_of_the_extended_domain(dim):
    lattice = fh.Lattice(1.0, (0.0,) * dim, np.array(SHAPE[dim]) - 1.0)
    model, start = fh.Wave(fh.Kernel(2.0)), {"u": PULSE[dim]}
    layered = fh.Simulation(lattice, model, fh.LatticePML(target=1e-4, until=30.0), start)
    extended = fh.Simulation(lattice, model, fh.Extended(target=1e-4, until=30.0), start)
    extended.prepare(30.0)
    told, known = extended_run_cost(layered, 30.0, list(layered.sides)), run_cost(extended)
    assert told.nodes == known.nodes > np.prod(SHAPE[dim])
    assert told.memory == pytest.approx(known.memory, rel=0.02)
    assert told.seconds > 0


def test_a_large_domain_is_priced_by_a_smaller_one():
    """The price is proportional to the number of nodes, without the margins."""
    lattice = fh.Lattice(1.0, (0.0, 0.0), (299.0, 99.0))
    start = {"u": "exp(-((x-150)**2 + (y-50)**2)/8)"}
    layered = fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), fh.LatticePML(target=1e-4, until=600.0), start)
    extended = fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), fh.Extended(target=1e-4, until=600.0), start)
    extended.prepare(600.0)
    told, known = extended_run_cost(layered, 600.0, list(layered.sides)), run_cost(extended)
    assert told.nodes == known.nodes > 400_000
    assert told.memory == pytest.approx(known.memory, rel=0.05)


def test_prices_in_words():
    assert RunCost(1.0, 2.0, 3.0).over(RunCost(1.0, 1.0, 2.0)) == "2 times the time, 1.5 times the memory"
    assert RunCost(1.0, 0.5, 1.0).over(RunCost(1.0, 1.0, 2.0)) == "only 0.5 of the time, 0.5 times the memory"


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", ["bond-based", "correspondence"])
def test_the_time_near_breaking_is_measured_without_a_trace(name, dim):
    """The run afterwards is bitwise that of a set-up that was not examined, and `check` names both times."""
    options = {"poisson": 0.3, "stabilisation": 0.3} if name == "correspondence" else {}
    model = fh.Elastic(fh.Kernel(2.0, 1), 1.0, material=name, critical_stretch=1e-3, **options)
    pull = fh.Source([3e-4, *[0.0] * (dim - 1)], lambda t: min(t / 10, 1.0))

    def made():
        lattice = fh.Lattice(1.0, (0.0,) * dim, (17.0, 13.0, 11.0)[:dim])
        sides = {"x-": fh.Fixed(), "all": fh.Free()}
        return fh.Simulation(lattice, model, sides, sources=[pull], threads=1).run(5.0, progress=False)

    sim, other = made(), made()
    assert seconds_near_breaking(sim) > 0
    for one in (sim, other):
        one.run(30.0, progress=False)
    assert sim.broken_bonds == other.broken_bonds > 0
    for name_of, values in other.fields.items():
        np.testing.assert_array_equal(sim.fields[name_of], values)
    report = made().check(30.0, budget=0.1)
    assert report.numbers["seconds_near_breaking"] >= report.numbers["seconds"] > 0
    assert "strained to half of what breaks them" in dict(report.rows)["time near breaking"]


def test_bonds_that_never_break_have_one_time():
    sim = fh.Simulation(fh.Lattice(1.0, (0.0, 0.0), (9.0, 9.0)), fh.Elastic(fh.Kernel(2.0, 1), 1.0), fh.Free())
    assert "time near breaking" not in dict(sim.check(10.0, budget=0.1).rows)

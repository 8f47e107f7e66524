"""Sides for which the run chooses between layers and an extended domain."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.boundaries import Extended, LatticePML
from farhorizon.case.case import Case
from farhorizon.checks.run_cost import RunCost
from farhorizon.simulation.sides import side_selection
from farhorizon.studies.compare import compare

LATTICE = fh.Lattice(0.25, (-3.0, -2.0), (3.0, 2.0))
SETUP = {"lattice": LATTICE, "model": fh.Wave(fh.Kernel(0.5)), "initial": {"u": "exp(-4*(x**2+y**2))"}}
CASE = """
[lattice]
spacing = 0.25
lower = [-3.0, -2.0]
upper = [3.0, 2.0]
[model]
type = "wave"
kernel = { horizon = 0.5 }
[initial]
u = "exp(-4*(x**2+y**2))"
[boundary]
all = { type = "auto", target = 1e-4 }
[run]
until = 8.0
"""


def kinds(sim):
    return {type(b) for b in sim.sides.values()}


@pytest.fixture
def dear(monkeypatch):
    """Make the extended domain a given number of times as expensive as layers."""

    def set_price(times):
        monkeypatch.setattr(side_selection, "run_cost", lambda sim: RunCost(1.0, 1.0, 1.0))
        monkeypatch.setattr(side_selection, "extended_run_cost", lambda sim, until, sides: RunCost(1.0, times, 1.0))

    return set_price


@pytest.mark.parametrize(
    "times, kind, words",
    [
        (0.5, Extended, "extended: layers would take 2 times the time"),
        (2.0, LatticePML, "layers: the extended domain would take 2 times the time"),
    ],
)
def test_the_cheaper_one_is_taken_and_said(dear, times, kind, words):
    dear(times)
    sim = fh.Simulation(**SETUP, boundary=fh.Auto(1e-4, until=8.0)).run(until=8.0)
    assert kinds(sim) == {kind} and sum(words in note for note in sim.notes) == 1
    same = {Extended: fh.Extended(1e-4, until=8.0), LatticePML: LatticePML(target=1e-4, until=8.0)}[kind]
    assert np.array_equal(sim.fields["u"], fh.Simulation(**SETUP, boundary=same).run(until=8.0).fields["u"])


@pytest.mark.slow
def test_errors_of_a_choice(dear):
    dear(0.5)
    (curve,) = compare({**SETUP, "boundary": fh.Auto(1e-4)}, 8.0, beside=False).curves.values()
    assert 0 < max(curve["error_rel_initial"]) <= 1e-4


def test_measured_prices_decide():
    """For a long run the layer is cheaper: the arrays of the extended domain are twenty times as long."""
    bar = {
        "lattice": fh.Lattice(1.0, 0.0, 3000.0),
        "model": fh.Wave(fh.Kernel(1.0)),
        "initial": {"u": "exp(-(x - 1500)**2/20)"},
        "threads": 1,
    }
    long = fh.Simulation(**bar, boundary=fh.Auto())
    long.prepare(60_000.0)
    assert kinds(long) == {LatticePML} and any("the extended domain would take" in note for note in long.notes)


def test_a_choice_lasts_in_checkpoints(dear, tmp_path):
    """The continued run has the sides of the one that wrote the checkpoint, whatever it would choose itself."""
    for first, then in ((0.5, 2.0), (2.0, 0.5)):
        dear(first)
        sim = fh.Simulation(**SETUP, boundary=fh.Auto(1e-4, until=8.0))
        sim.prepare(8.0)
        sim.step(20)
        sim.save(tmp_path / "a.ckpt")
        dear(then)
        again = fh.Simulation(**SETUP, boundary=fh.Auto(1e-4, until=8.0))
        again.prepare(8.0)
        again.load(tmp_path / "a.ckpt")
        assert kinds(again) == kinds(sim) == kinds(fh.Simulation.restore(tmp_path / "a.ckpt"))
        assert np.array_equal(again.run(until=8.0).fields["u"], sim.run(until=8.0).fields["u"])


def test_longer_runs_choose_anew_until_something_has_run(dear):
    dear(0.5)
    sim = fh.Simulation(**SETUP, boundary={"x": fh.Auto(1e-4), "y": fh.Periodic()})
    assert isinstance(sim.sides[0, 1], LatticePML)
    sim.prepare(8.0)
    assert sim.extents[0, 1].until == 8.0
    dear(2.0)
    sim.prepare(16.0)
    assert isinstance(sim.sides[0, 1], LatticePML) and sim.thickness["x+"].until == 16.0


def test_where_no_layer_serves_the_domain_is_extended(dear):
    dear(2.0)
    wide = fh.Wave(fh.Kernel(0.75, 0))  # with short waves that run backward
    bar, noise = fh.Lattice(0.25, -3.0, 3.0), np.random.default_rng(3).standard_normal(25)
    with pytest.raises(fh.InputError, match="no layer meets the target"):
        fh.Simulation(bar, wide, LatticePML(target=1e-12, until=100.0), {"u": noise})
    sim = fh.Simulation(bar, wide, fh.Auto(1e-12, until=100.0), {"u": noise}).run(until=2.0)
    assert kinds(sim) == {Extended} and any("layers cannot be used: no layer meets" in note for note in sim.notes)


def test_where_layers_grow_the_domain_is_extended(dear, monkeypatch):
    """Because the run would be refused when it is examined."""

    def examine(sim, until, allow_unstable=False):
        if kinds(sim) == {LatticePML}:
            raise fh.InputError("the run is not stable", value="a mode grows")

    monkeypatch.setattr(fh.Simulation, "examine", examine)
    dear(3.0)
    sim = fh.Simulation(**SETUP, boundary=fh.Auto(target=1e-4))
    sim.run(until=2.0)
    assert kinds(sim) == {Extended}
    assert any("layers cannot be used: the run is not stable" in note for note in sim.notes)


def test_a_case_and_its_check(dear):
    dear(0.5)
    case = Case(CASE)
    sim = case.simulation()
    sim.prepare(8.0)
    assert kinds(sim) == {Extended} and "layers instead" in fh.Simulation.of(case.setup).check(8.0).details


def test_bad_input():
    for wrong in ({"target": 0.5}, {"until": -1.0}):
        with pytest.raises(fh.InputError, match=f"boundary.{next(iter(wrong))}"):
            fh.Auto(**wrong)


@pytest.mark.parametrize("side", [fh.LatticePML, fh.Extended, fh.Auto])
@pytest.mark.parametrize("target", [1e-20, 0.5, "1e-5"])
def test_targets_that_no_side_keeps_are_refused_with_one_that_may_be(side, target):
    with pytest.raises(fh.InputError, match="such as 1e-5") as refused:
        side(target=target)
    assert refused.value.key == "boundary.target" and "to 0.1" in refused.value.limit

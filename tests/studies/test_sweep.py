"""Sweeps against the runs that they stand for, continued, on other executors, and with failing cases."""

import csv
import math
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import farhorizon as fh
from farhorizon.cli import main
from outputs import written

CASE = """
lattice = { spacing = 0.5, lower = [-3.0], upper = [3.0] }
model = { type = "wave", kernel = { horizon = 1.0 } }
initial = { u = "exp(-4*x**2)" }
boundary = { all = { type = "fixed" } }
run = { until = 2.0 }
output = { probes = [[0.0], [1.0]] }
"""
CHANGES = {"model.speed": [1.0, 2.0], "model.kernel.horizon": [0.5, 1.0, 1000.0]}  # the last one is too far


@pytest.fixture
def case(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("case.toml").write_text(CASE)
    return fh.read_case("case.toml")


def test_numbers_are_those_of_single_runs(case):
    """For all combinations, the last key varying fastest; failures are listed and do not affect the other runs."""
    found = fh.sweep(case, CHANGES)
    assert [tuple(one.values()) for one in found.changes] == [
        (speed, horizon) for speed in (1.0, 2.0) for horizon in (0.5, 1.0, 1000.0)
    ]
    assert list(found.failed) == [2, 5] and "at most 1000" in found.failed[2]
    run = fh.read_case("case.toml", {"model.speed": 2.0}).simulation()
    run.run(2.0)
    u = run.fields["u"]
    expected = {"dt": run.dt, "steps": run.step_count, "time": run.time, "energy": run.energy()}
    assert found.figures[4] == expected | {"max_u": abs(u).max(), "probe_0": u[6], "probe_1": u[8]}
    assert found.figures[2] == {} and found.figures[1] != found.figures[4]
    table = found.to_xarray()
    assert table.sizes == {"model.speed": 2, "model.kernel.horizon": 3}
    assert table["energy"].sel({"model.speed": 2.0, "model.kernel.horizon": 1.0}) == run.energy()
    assert math.isnan(table["energy"].values[0, 2])
    assert str(found).count("failed: ") == 2


def test_it_goes_on_where_it_was(case):
    """Results in the table are not computed again, except for failures; the table depends on the case and the
    quantities.
    """
    asked = []

    def steps(run):
        asked.append(run.dt)
        return run.step_count

    pairs = [{"model.speed": 1.0}, {"model.speed": 2.0}]
    first = fh.sweep(case, pairs[:1], {"steps": steps}, table="t.csv")
    both = fh.sweep(case, pairs, {"steps": steps}, table="t.csv")
    assert len(asked) == 2 and both.figures[0] == first.figures[0] and both.changes == pairs
    other = case.changed({"initial.u": "exp(-3*x**2)"})
    fh.sweep(other, pairs, {"steps": steps}, table="t.csv")
    assert len(asked) == 4

    def fails(run):
        asked.append(run.dt)
        raise ZeroDivisionError("nothing\nhere")

    for _ in range(2):
        assert fh.sweep(case, pairs, {"other": fails}, table="t.csv").failed[1] == "ZeroDivisionError: nothing here"
    assert len(asked) == 8
    with open("t.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["model.speed"], row["failed"]) for row in rows[-2:]] == [
        (speed, "ZeroDivisionError: nothing here") for speed in ("1", "2")
    ]
    assert list(fh.sweep(case, pairs, {"steps": steps}, table="t.csv").to_xarray().sizes) == ["model.speed"]


def test_any_executor_computes_the_same(case):
    here = fh.sweep(case, {"model.speed": [1.0, 2.0]})
    with ThreadPoolExecutor(2) as pool:
        assert fh.sweep(case, {"model.speed": [1.0, 2.0]}, executor=pool).figures == here.figures


@pytest.mark.slow
def test_processes_compute_the_same(case):
    here, there = (fh.sweep(case, {"model.speed": [1.0, 2.0]}, jobs=jobs) for jobs in (1, 2))
    assert here.figures == there.figures and not there.failed


def test_the_command(case):
    """It writes the table, prints it, and fails if a case fails."""
    assert main(["sweep", "case.toml", "model.speed=1.0,2.0", "model.kernel.horizon=0.5", "--json", "a.json"]) == 0
    facts = written("a.json", "sweep")
    assert facts["figures"] == fh.sweep(case, {"model.speed": [1.0, 2.0], "model.kernel.horizon": [0.5]}).figures
    assert main(["sweep", "case.toml", "model.kernel.horizon=0.5,1000.0", "--out", "other"]) == 1
    assert main(["sweep", "case.toml", "initial.u=exp(-x**2), sin(x)", "--set", "run.until=1.0", "--out", "o"]) == 0
    assert len(Path("o/case-sweep.csv").read_text().splitlines()) == 3


def test_refused_before_any_work(case):
    Path("foreign.csv").write_text("a,b\n1,2\n")
    Path("more.csv").write_text("model.speed,crack[0].points,energy,failed,case\n1,0.5,2,,c\n")
    Path("damaged.csv").write_text("model.speed,energy,failed,case\n1,x,,c\n")
    Path("binary.csv").write_bytes(bytes(range(256)))
    for changes, more, message in (
        ({}, {}, "nothing to change"),
        ({"model.speed": []}, {}, "nothing to change"),
        ({"model.speed": 1.0}, {}, "must be a list"),
        ([{"model.speed": 1.0}, {"run.until": 1.0}], {}, "the same keys"),
        ({"model.speed": [1.0, -1.0]}, {}, "speed"),
        ({"model.sped": [1.0]}, {}, "did you mean 'speed'"),
        ({"model.speed": [1.0]}, {"quantities": {"failed": len}}, "another column"),
        ({"model.speed": [1.0]}, {"quantities": {"a": 3}}, "must be a function"),
        ({"model.speed": [1.0]}, {"jobs": 0}, "jobs"),
        ({"model.speed": [1.0]}, {"jobs": 2, "executor": ThreadPoolExecutor(1)}, "jobs of its own"),
        ({"model.speed": [1.0]}, {"table": "foreign.csv"}, "not the table of such a sweep"),
        ({"model.speed": [1.0]}, {"table": "more.csv"}, "not the table of such a sweep"),
        ({"model.speed": [1.0]}, {"table": "damaged.csv"}, "is damaged, or no table"),
        ({"model.speed": [1.0]}, {"table": "binary.csv"}, "is damaged, or no table"),
    ):
        with pytest.raises(fh.InputError, match=message):
            fh.sweep(case, changes, **more)
    assert main(["sweep", "case.toml", "model.speed"]) == 2


def test_a_table_of_more_keys_is_another_one(case):
    """Their values were once listed as quantities."""
    keys = {"model.speed": [1.0], "model.kernel.horizon": [0.5, 1.0]}
    fh.sweep(case, keys, table="a.csv")
    with pytest.raises(fh.InputError, match="not the table of such a sweep"):
        fh.sweep(case, {"model.speed": [1.0]}, table="a.csv")
    energy = {"at.end": lambda run: run.energy()}  # a quantity may have such a name
    one = fh.sweep(case, {"model.speed": [1.0]}, energy, table="b.csv")
    assert fh.sweep(case, {"model.speed": [1.0]}, energy, table="b.csv").figures == one.figures


def test_a_key_is_given_once(case, capsys):
    """The values given first would not be computed."""
    assert main(["sweep", "case.toml", "model.speed=1.0,2.0", "model.speed=3.0"]) == 2
    assert "a key is given twice; value: model.speed" in capsys.readouterr().err
    assert not Path("case-sweep.csv").exists()

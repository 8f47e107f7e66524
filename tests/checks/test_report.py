"""Text of `check`: the verdict, what to do, and no table unless it is requested."""

import re
from pathlib import Path

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.resolution import faded
from farhorizon.checks.report import Report, content
from farhorizon.checks.run_cost import two_digits
from farhorizon.cli import main
from farhorizon.engine.codegen import compile_notice

CASE = """
lattice = { spacing = 0.25, lower = [-4.0], upper = [4.0] }
model = { type = "wave", speed = 2.0, kernel = { horizon = 0.25 } }
initial = { u = "exp(-2*x**2)" }
boundary = { all = { type = "lattice-pml", nodes = 12 } }
run = { until = 2.0 }
"""


def told(capsys, *options):
    assert main(["check", "a.toml", "--budget", "0.2", *options]) == 0
    return capsys.readouterr().out.splitlines()


def test_the_verdict_first_then_what_to_do_and_tables_when_asked_for(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("a.toml").write_text(CASE)
    short, long = told(capsys), told(capsys, "--details")
    for page in (short, long):
        assert re.match(r"fine: about .* in all, .* MiB, reflections of plane waves at most -\d+ dB", page[0])
        assert page[1] == "to do: nothing, run it"
        assert re.match(r"wave speeds +long waves 2$", next(line for line in page if line.startswith("wave speeds")))
        assert any(re.match(r"wavelengths .* = [\d.]+ nodes", line) for line in page)
        assert any(re.match(r"cheapest sides ", line) for line in page)
    assert not any("predicted reflection" in line or line.startswith("memory") for line in short)
    assert any("predicted reflection" in line for line in long) and any(line.startswith("memory") for line in long)
    assert any("--details" in line for line in short) and len(short) < 14 < len(long)


def test_the_time_in_all_is_the_sum_of_its_parts_and_no_trial_file_stays(tmp_path, monkeypatch, capsys):
    from farhorizon.case.case import Case
    from farhorizon.case.preview import whole_time

    monkeypatch.chdir(tmp_path)
    case = Case(CASE + "output = { every = 0.5, probes = [[1.0]] }\n")
    run = case.run()
    run.prepare(case.end)
    run.record(case.parts.output.probes)
    report = run.check(case.end, 0.1)
    before = run.fields["u"].copy()
    parts = whole_time(case, run, report, 3.0)
    assert parts["start"] == 3.0 and parts["steps"] == report.numbers["seconds"]
    assert report.numbers["seconds_in_all"] == pytest.approx(sum(parts.values())) and min(parts.values()) >= 0
    (row,) = (value for name, value in report.rows if name == "time in all")
    assert "(5 outputs)" in row and list(tmp_path.iterdir()) == []
    assert (run.fields["u"] == before).all() and run.step_count == 0 and len(run.probes.times) == 1


def test_what_was_compiled_before_is_no_part_of_the_time(tmp_path, monkeypatch, capsys):
    """When another case was checked in the same process, the total time was once below zero."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(compile_notice._NOTICE, "spent", 1000.0)
    Path("a.toml").write_text(CASE)
    assert "about -" not in told(capsys)[0]


def test_fields_without_displacements_may_be_written(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("a.toml").write_text(CASE)
    assert any(line.startswith("time in all") for line in told(capsys, "--set", "output.fields=['v']"))
    assert main(["new", "fracture", "-o", "a.toml", "--force"]) == 0
    assert any(line.startswith("time in all") for line in told(capsys, "--set", "output.fields=['damage']"))


@pytest.mark.parametrize("free", [{}, {"y+": fh.Free()}])
def test_incident_waves_have_the_length_of_their_signal(free):
    """The spectrum of a Ricker signal is largest at 16 nodes per wave: of the energy, k^6 exp(-2 (16 k / 2 pi)^2),
    half is in waves longer than 12.7 nodes and a thousandth in those shorter than 6.5. There are no shorter ones,
    which layers would reflect completely, although the field ends at the sides of the lattice and at a free side. The
    window that fades it out over 61 nodes blurs wavenumbers by up to 4 pi / 61, a fifth of the wavenumber of the
    shortest wave.
    """
    signal = "(1-2*(pi*(t-24)/16)**2)*exp(-(pi*(t-24)/16)**2)"
    wave = fh.IncidentWave((0.3, 0.9), signal, duration=48.0, within=fh.Box((-20, -20), (20, 30 if free else 20)))
    lattice, sides = fh.Lattice(1.0, (-30, -30), (30, 30)), {"all": fh.LatticePML(nodes=16), **free}
    sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(1.0)), sides, sources=[wave])
    report = sim.check(200.0, budget=0.0)
    found = re.search(r"([\d.]+) to ([\d.]+), half of the energy below ([\d.]+)", dict(report.rows)["wavelengths"])
    shortest, longest, typical = map(float, found.groups())
    assert shortest == pytest.approx(6.5, rel=0.2) and typical == pytest.approx(12.7, rel=0.1) and longest > 25
    assert float(re.search(r"at most (-\d+) dB", report.headline)[1]) < -60


@pytest.mark.parametrize("shape", [(1, 5), (4, 5), (5, 1)])
def test_fields_fade_out_towards_sides_that_are_not_free(shape):
    found = faded(np.ones(shape), [(False, True), (False, False)])
    assert found.shape == shape and (found <= 1).all() and found.max() > 0.4


def test_speeds_have_the_units_of_the_case(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("a.toml").write_text(CASE + 'units = { length = "mm", time = "us" }\n')
    assert "long waves 2 mm/us" in "\n".join(told(capsys))


def test_lengths_have_the_units_of_the_case(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("a.toml").write_text(CASE + 'units = { length = "mm", time = "us" }\n')
    page = "\n".join(told(capsys))
    assert re.search(r"spacing [\d.]+ mm$", page, re.MULTILINE)
    assert re.search(r"to [\d.]+ mm, half of the energy below [\d.]+ mm = ", page)


def test_the_number_of_steps_is_that_of_the_run():
    """The quotient of end and time step may be a whole number only to rounding, as in 1.05 / 0.15."""
    sim = fh.Simulation(fh.Lattice(0.25, (-3,), (3,)), fh.Wave(fh.Kernel(0.75)), initial={"v": "exp(-9*x**2)"}, dt=0.15)
    assert 1.05 / sim.dt > 7 and sim.check(1.05, budget=0.0).numbers["steps"] == sim.prepare(1.05) == 7


def test_large_factors_have_no_exponent():
    assert [two_digits(value) for value in (0.123, 1.26, 118.0, 3.2e7)] == ["0.12", "1.3", "120", "3.2e+07"]


def test_prescribed_nodes_send_waves_as_long_as_their_course():
    """The waves are not as short as the node is wide, as the initial value would imply, however small it is."""
    ricker = fh.Prescribed([0.0], "(1-2*(0.2*pi*(t-5))**2)*exp(-(0.2*pi*(t-5))**2)", until=10.0)
    bar = fh.Lattice(0.1, -10, 10), fh.Wave(fh.Kernel(0.3)), fh.Exact()
    waves = content(fh.Simulation(*bar, constraints=[ricker]), 20.0)
    assert waves is not None and 3 < waves.typical < 7 and waves.shortest > 1.5
    assert content(fh.Simulation(*bar, constraints=[fh.Prescribed([0.0], 0.0)]), 20.0) is None


def test_warnings_are_what_to_do():
    report = Report(warnings=["take more nodes"], notes=["said too"], numbers={"memory": 2.0**20})
    assert str(report).splitlines()[:2] == ["1 warning: 1 MiB", "warning: take more nodes"]
    assert "note: said too" in str(report) and "nothing" not in str(report)


def test_waves_that_hardly_move_are_told_apart():
    """Waves of two spacings, which no layer absorbs, are reported separately from the others."""
    lattice, pulse = fh.Lattice(0.5, (-4, -4), (4, 4)), fh.Expression("exp(-2*(x**2+y**2))", 2)
    report = fh.Simulation(lattice, fh.Wave(fh.Kernel(1.0)), fh.LatticePML(nodes=16), {"u": pulse}).check(1.0, 0.2)
    assert re.search(r"at most -\d\d+ dB up to 60 degrees, of the shortest 0 dB", report.headline)


def test_a_sponge_that_sends_back_much_is_not_fine():
    lattice, model = fh.Lattice(0.25, -5, 5), fh.Wave(fh.Kernel(0.5))
    thin, wide = (
        fh.Simulation(lattice, model, fh.Sponge(nodes), {"u": fh.Expression("exp(-2*x**2)", 1)}).check(5.0, 0.2)
        for nodes in (8, 120)
    )
    (warning,) = thin.warnings
    assert re.fullmatch(r"x-, x\+ reflect 0\.\d+ of waves of .*; use more nodes, .*, or a LatticePML", warning)
    assert not wide.warnings


def test_the_cheapest_sides_are_recommended():
    """In 1D the extended domain is recommended for a short run, and the layer for a long one."""
    line = fh.Lattice(0.25, -4, 4)
    for until, said in ((1.0, 'type = "extended"'), (4000.0, "as given; extended would take")):
        sim = fh.Simulation(line, fh.Wave(fh.Kernel(0.25)), fh.LatticePML(nodes=12), {"u": "exp(-2*x**2)"})
        (row,) = (value for name, value in sim.check(until, budget=0.0).rows if name == "cheapest sides")
        assert row.startswith(said)


def test_layers_that_chose_themselves_are_told_by_what_is_predicted_of_the_data():
    """Plane waves of a few nodes would suggest echoes that do not occur with these data: the run meets its target."""
    lattice, model = fh.Lattice(0.5, (-4.0, -4.0), (4.0, 4.0)), fh.Wave(fh.Kernel(1.0))
    start, target = {"u": "exp(-2*x**2 - 2*y**2)"}, 1e-5
    sim, exact = (
        fh.Simulation(lattice, model, side, start, threads=1)
        for side in (fh.LatticePML(target=target, until=10.0), fh.Extended(target=1e-9, until=10.0))
    )
    report = sim.check(until=10.0)
    assert not report.warnings
    assert re.search(r"layers reflect \S+ of the largest value,", report.headline)
    assert 0 < report.numbers["returned"] <= target
    worst = 0.0
    while sim.time < 10.0:
        sim.step(1)
        exact.step(1)
        worst = max(worst, float(np.abs(sim.fields["u"] - exact.fields["u"]).max()))
    assert worst <= target
    moving = fh.Source("exp(-3*(x - sin(t))**2 - 3*y**2)")  # not separable: represented by other data
    assert (
        "returned" not in fh.Simulation(lattice, model, fh.LatticePML(target=target), sources=[moving]).check().numbers
    )
    given = fh.Simulation(lattice, model, fh.LatticePML(nodes=2), start).check(until=10.0)
    assert "returned" not in given.numbers and any("use more nodes" in text for text in given.warnings)

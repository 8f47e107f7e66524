"""Probes: values at nodes, by default in every step, with a time axis of their own."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.cli import main
from farhorizon.files.results import open_results


def pulse(*at):
    return np.exp(-8 * sum(x**2 for x in at))


def waves(**more):
    lattice = fh.Lattice(0.25, [-3.0, -2.0], [3.0, 2.0])
    return fh.Simulation(lattice, fh.Wave(fh.Kernel(0.5)), fh.LatticePML(nodes=6), {"u": pulse}, **more)


def large():
    """Large enough for two threads."""
    lattice = fh.Lattice(0.1, [-15.0, -10.0], [15.0, 10.0])
    return fh.Simulation(lattice, fh.Wave(fh.Kernel(0.2)), fh.LatticePML(nodes=4), {"u": pulse}, threads=2)


def bar():
    return fh.Simulation(fh.Lattice(0.25, [-5.0], [5.0]), fh.Wave(fh.Kernel(0.5)), fh.Exact(), {"u": pulse})


def heat():
    """Four stages, a background, sources, and nodes beyond a wall, whose values are not temperatures."""
    lattice = fh.Lattice(0.25, [-2.0, -2.0], [2.0, 2.0])
    wall = fh.Temperature("x-", 20.0, kind="mirror")
    return fh.Simulation(
        lattice,
        fh.Heat(fh.Kernel(0.5), integrator="rk4"),
        fh.Free(),
        {"u": 20.0},
        sources=[pulse],
        background=20.0,
        constraints=[wall],
    )


def elastic():
    lattice = fh.Lattice(0.25, [-2.0, -2.0], [2.0, 2.0])
    material = fh.Elastic(fh.Kernel(0.5, exponent=1), 1.0, critical_stretch=0.2)
    return fh.Simulation(lattice, material, fh.Sponge(4), {"u": [lambda x, y: 0.01 * pulse(x, y), 0.0]})


def body():
    lattice = fh.Lattice(1.0, [-8.0, -6.0], [8.0, 6.0])
    initial = {"u": [lambda x, y: 0.01 * pulse(x / 3, y / 3), 0.0]}
    solid = fh.Correspondence(fh.Kernel(2.0, exponent=0, volume="full"), 1.0, 0.2)
    return fh.Simulation(lattice, solid, fh.NonlocalPML(nodes=4), initial)


@pytest.mark.parametrize("make", [waves, large, bar, heat, elastic, body])
def test_probes_are_the_field_after_every_step(make):
    """Bit for bit what stepping one by one shows, also at the start; recording does not change the run."""
    run, other, plain = make(), make(), make()
    corner = run.lattice.lower + 0.0
    points = [np.zeros(run.lattice.dim), corner, corner + 2.3 * run.lattice.spacing]
    probes = run.record(points)
    expected = []
    for step in range(24):
        other.step(int(step > 0))
        expected.append([other.fields["u"][(..., *run.lattice.index(p))] for p in points])
    run.step(5)
    run.run(23 * run.dt)
    assert np.array_equal(probes.values, expected, equal_nan=True) and np.ptp(probes.values[:, 0]) > 0
    np.testing.assert_array_equal(probes.times, run.dt * np.arange(24))
    plain.step(23)
    assert np.array_equal(run.fields["u"], plain.fields["u"], equal_nan=True)
    assert len(probes.notes) == 1 and "nearest node" in probes.notes[0]
    np.testing.assert_allclose(probes.places[2], corner + 2 * run.lattice.spacing)


def test_every_so_many_steps_and_forgetting():
    run = waves(dt=fh.WholeSteps(between=0.3))
    probes = run.record([[0.5, 0.5]], every=0.3)
    run.run(1.0)
    np.testing.assert_allclose(probes.times, [0.0, 0.3, 0.6, 0.9])
    times, values = probes.take()
    assert len(times) == len(values) == 4 and not len(probes.times) and not len(probes.values)
    run.run(1.3)
    np.testing.assert_allclose(probes.times, [1.2])
    assert run.record([]).values.shape[1] == 0 and waves().record([0.5, 0.5]).places.tolist() == [[0.5, 0.5]]
    assert bar().record([0.5, 1.0]).places.tolist() == [[0.5], [1.0]] and bar().record([[0.5], [1.0]]).places.shape == (
        2,
        1,
    )
    for bad in (
        {"points": [[9.0, 0.0]]},
        {"points": [[0.0, 0.0]], "every": 0.31},
        {"points": [[0.0, 0.0]], "every": -1.0},
    ):
        with pytest.raises(fh.InputError):
            run.record(**bad)


CASE = """
[lattice]
spacing = 0.25
lower = [-3.0, -3.0]
upper = [3.0, 3.0]
[model]
type = "wave"
[model.kernel]
horizon = 0.75
[initial]
u = "exp(-4*(x**2+y**2))"
[run]
until = 4.0
[output]
every = 1.0
probes = [[1.13, 0.0], [0.0, 1.0]]
"""


def test_a_results_file_has_every_step_of_the_probes(tmp_path, monkeypatch, capsys):
    """With their own times and the nodes that were chosen, also in xarray; a resumed run has the same bits;
    `probe_every` thins them.
    """
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.toml").write_text(CASE)
    (tmp_path / "b.toml").write_text(CASE + "probe_every = 0.5\n")
    assert main(["run", "a.toml", "--out", "whole"]) == 0
    assert "the probe at [1.13, 0.0] is recorded at the nearest node, [1.25, 0.0]" in capsys.readouterr().err
    assert main(["run", "a.toml", "--out", "part", "--until", "1.7"]) == 0
    assert main(["run", "a.toml", "--out", "part", "--resume"]) == 0
    assert main(["run", "b.toml"]) == 0
    whole, part, thin = (open_results(f"{name}.h5") for name in ("whole/a", "part/a", "b"))
    assert whole.probes.tolist() == [[1.25, 0.0], [0.0, 1.0]]
    steps = whole.steps[-1]
    np.testing.assert_allclose(whole.probe_times, np.linspace(0, 4, steps + 1), rtol=1e-12)
    for index, step in enumerate(whole.steps):
        np.testing.assert_array_equal(whole.probe_values[step], whole.field("u", index)[[17, 12], [12, 16]])
    np.testing.assert_array_equal(part.probe_values, whole.probe_values)
    np.testing.assert_array_equal(part.probe_times, whole.probe_times)
    np.testing.assert_allclose(thin.probe_times, np.linspace(0, 4, 9), rtol=1e-12)
    dataset = whole.to_xarray()
    np.testing.assert_array_equal(
        dataset["probe_values"].sel(probe_time=2.0, method="nearest"), whole.probe_values[steps // 2]
    )
    assert dataset["energy"].shape == (5,)
    assert main(["check", "a.toml"]) == 0
    said = capsys.readouterr().out
    assert "outputs" in said and "probes every step" in said and "nearest node" in said


def test_probes_show_displacements_that_are_not_written(tmp_path):
    """A results file of the damage alone has vectors at its probes."""
    run = elastic()
    run.record([[0.5, 0.5]])
    run.run(1.0)
    run.write(tmp_path / "a.h5", ["damage"])
    results = open_results(tmp_path / "a.h5")
    np.testing.assert_array_equal(results.probe_values, run.probes.values)
    assert results.probe_values.shape == (run.step_count + 1, 1, 2)

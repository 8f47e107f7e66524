"""Runs to the static state: against static solutions, and set-ups that have none."""

import contextlib
import os

import numpy as np
import pytest
from scipy import integrate, special

import farhorizon as fh

SEED = int(os.environ.get("FARHORIZON_SEED", np.random.SeedSequence().entropy % 2**32))
CUBE = fh.Lattice(1.0, (-4.0,) * 3, (4.0,) * 3)
SQUARE = fh.Lattice(1.0, (-6.0, -6.0), (6.0, 6.0))


def wave(boundary=None, **given):
    """Scalar waves in a small part of the plane."""
    return fh.Simulation(SQUARE, fh.Wave(fh.Kernel(2.0)), boundary or fh.LatticePML(nodes=12), **given)


def static_field(stencil, force):
    """Solution of ``L u + force = 0`` on the infinite lattice up to a constant, for forces that balance; the images
    of their dipoles, 1024 nodes apart, change it by (9/1024)^2 of the field.
    """
    box = (1024, 1024)
    angles = np.ix_(2 * np.pi * np.fft.fftfreq(box[0]), 2 * np.pi * np.fft.rfftfreq(box[1]))
    symbol = stencil.symbol(*angles)
    symbol[0, 0] = np.inf
    return np.fft.irfftn(np.fft.rfftn(force, box, (0, 1)) / symbol, box, (0, 1))[: force.shape[0], : force.shape[1]]


def test_forces_that_balance_beside_the_static_lattice():
    """The error is what still moves: velocities below the tolerance, over not much more than the time of the run."""
    print(f"seed {SEED}")
    rng = np.random.default_rng(SEED)
    x, y = SQUARE.coordinates()
    force = sum(
        sign * np.exp(-((x - a) ** 2 + (y - b) ** 2) / 2)
        for sign, (a, b) in zip((1, -2, 1), rng.uniform(-1.5, 1.5, (3, 2)), strict=True)
    )
    force -= force.sum() * np.exp(-(x**2 + y**2) / 2) / np.exp(-(x**2 + y**2) / 2).sum()
    for tolerance in (1e-2, 1e-3):
        sim = wave(sources=[fh.Source(force, fh.Step(12.0))])
        sim.run("static", tolerance=tolerance, limit=300.0)
        exact = static_field(sim.stencil, force)
        error = sim.fields["u"] - exact
        error -= error.mean()
        assert np.abs(error).max() < tolerance * sim.time / sim.crossing * np.ptp(exact)
        assert any("static at" in note for note in sim.notes)


def test_a_pulse_leaves_and_the_run_ends_when_it_has():
    sim = wave(initial={"u": "exp(-(x**2 + y**2)/4)"})
    energy = sim.energy()
    sim.run("static", tolerance=0.03, limit=500.0)
    assert sim.crossing < sim.time < 500.0
    assert sim.resting.kinetic() <= 0.03**2 * sim.peak
    assert sim.energy() < 0.03**2 * energy * sim.time / sim.crossing


def test_a_load_that_comes_late_is_waited_for():
    late = fh.Source("exp(-(x**2 + y**2)/2)", fh.Ricker(0.05, delay=60.0))
    sim = wave(sources=[late]).run("static", tolerance=0.05)
    assert sim.time > 60.0 + sim.crossing and sim.peak > 0


@pytest.mark.parametrize("factor", ["sin(t)", "t", "sin(0.01*t)"])
def test_loads_that_go_on_changing_are_refused(factor):
    with pytest.raises(fh.InputError, match="changes up to its latest end"):
        wave(sources=[fh.Source("exp(-x**2 - y**2)", factor)]).run("static")


def test_crack_that_opens_and_prescribed_nodes_are_what_drives_a_run():
    crack = fh.Crack([(-3.0, 0.5), (3.0, 0.5)], opens=30.0)
    sim = wave(cracks=[crack], constraints=[fh.Prescribed([(0.0, 0.0)], "t", until=4.0)])
    start, end = sim.resting.loading_at(0.0), sim.resting.loading_at(50.0)
    assert [np.abs(a - b).max() > 0 for a, b in zip(start, end, strict=True)] == [True, True]
    assert sim.run("static", tolerance=0.1).time > 30.0


def test_the_limit_ends_a_run_and_says_so():
    """On a line, a constant force displaces the medium at constant speed for ever."""
    sim = fh.Simulation(
        fh.Lattice(1.0, -9, 9), fh.Wave(fh.Kernel(1.0)), sources=[fh.Source("exp(-x**2)", fh.Step(2.0))]
    )
    with pytest.warns(fh.ValidityWarning, match="not static to"):
        sim.run("static", limit=100.0)
    assert 100.0 <= sim.time < 100.0 + 2 * sim.dt
    assert [caution.brief for caution in sim.cautions] == ["not static"]


def test_diffusion_between_walls():
    """The slowest mode of a wall at 0 and one at 1 decays like exp(-pi^2 D t / length^2)."""
    line = fh.Lattice(1.0, 0.0, 20.0)
    held = [fh.Temperature("x-", 0.0), fh.Temperature("x+", 1.0)]
    sim = fh.Simulation(line, fh.Diffusion(fh.Stencil.finite_difference(1)), fh.Free(), constraints=held)
    sim.run("static", tolerance=1e-3)
    assert np.abs(sim.fields["u"] - line.axes[0] / 20).max() < 1e-3


def test_diffusion_comes_to_rest_at_the_same_time_over_any_background():
    """A field is measured from its background: degrees Celsius and kelvins are the same."""
    line, ends = fh.Lattice(1.0, 0.0, 20.0), []
    for background in (0.0, 300.0):
        pulse = {"u": background + np.exp(-((line.axes[0] - 10.0) ** 2) / 4)}
        held = fh.Prescribed([4.0], value=lambda t, low=background: low + min(t, 100.0) / 500)
        sides, model = fh.Fixed(background), fh.Diffusion(fh.Kernel(2.0))
        sim = fh.Simulation(line, model, sides, pulse, background=background, constraints=[held])
        sim.run("static", limit=2000.0)
        ends.append((sim.time, sim.peak, np.abs(sim.fields["u"] - background).max()))
    assert ends[0] == pytest.approx(ends[1], rel=1e-8)
    assert ends[0][0] > 100.0


def test_a_run_in_two_parts_knows_what_it_has_seen(tmp_path):
    whole, first = (wave(initial={"u": "exp(-(x**2 + y**2)/4)"}) for _ in range(2))
    whole.run("static", tolerance=0.1, limit=200.0)
    with pytest.warns(fh.ValidityWarning, match="not static"):
        first.run("static", tolerance=0.1, limit=15.0)
    first.save(tmp_path / "state")
    second = wave(initial={"u": "exp(-(x**2 + y**2)/4)"})
    second.load(tmp_path / "state")
    assert second.peak == first.peak > 0


def stopped(sim, last, **ends):
    """Interrupt a run to its static state at a step; it may have ended before."""

    def stop(run):
        run.stop_requested = run.step_count >= last

    sim.observers.append(stop)
    with contextlib.suppress(KeyboardInterrupt):
        sim.run("static", every=sim.dt, progress=False, **ends)
    return sim


LATE = fh.Source("exp(-(x**2 + y**2)/2)", fh.Ricker(0.05, delay=30.0))
LINE = fh.Lattice(1.0, 0.0, 20.0), fh.Diffusion(fh.Stencil.finite_difference(1)), fh.Free()
HOT = [fh.Temperature("x-", 0.0), fh.Temperature("x+", 1.0)]
#: Run, tolerance and latest end; the last ones end there, moving.
RESUMED = {
    "waves of a load that ends": (lambda: wave(sources=[LATE]), 0.01, 400.0),
    "diffusion": (lambda: fh.Simulation(*LINE, constraints=HOT), 0.01, 2000.0),
    "waves to the latest end": (lambda: wave(sources=[LATE]), 0.01, 80.0),
    "diffusion to the latest end": (lambda: fh.Simulation(*LINE, constraints=HOT), 1e-6, 300.0),
}


@pytest.mark.filterwarnings("ignore::farhorizon.ValidityWarning")
@pytest.mark.parametrize("name", RESUMED)
def test_a_run_that_was_stopped_several_times_ends_where_an_undisturbed_one_does(tmp_path, name):
    """At the same step, with the same field to the last bit: also if it is stopped in its last moments."""
    print(f"seed {SEED}")
    rng = np.random.default_rng(SEED)
    make, tolerance, limit = RESUMED[name]
    ends = {"tolerance": tolerance, "limit": limit}
    whole = make().run("static", progress=False, **ends)
    last = whole.step_count
    assert (whole.time < limit) == ("latest" not in name)
    for latest in (1, last // 2, last - 2, last):  # within one window of the end, too
        stops = [*sorted(int(stop) for stop in rng.integers(1, latest + 1, 2)), latest]
        for number, stop in enumerate(stops):
            sim = make()
            if number:
                sim.load(tmp_path / "state")
            stopped(sim, stop, **ends).save(tmp_path / "state")
        sim = make()
        sim.load(tmp_path / "state")
        sim.run("static", progress=False, **ends)
        assert sim.step_count == last and sim.peak == whole.peak, stops
        np.testing.assert_array_equal(sim.fields["u"], whole.fields["u"])


def test_bad_input_is_refused():
    sim = wave()
    for arguments, message in (
        (("stationary",), "neither a time nor a state"),
        (("static", None, None, False, 2.0), r"run\.tolerance"),
        (("static", None, None, False, None, -1.0), r"run\.limit"),
        ((3.0, None, None, False, 1e-3), "only a run to the static state"),
    ):
        with pytest.raises(fh.InputError, match=message):
            sim.run(*arguments)


def test_observers_see_the_end():
    seen = []
    sim = wave(initial={"u": "exp(-(x**2 + y**2)/4)"}, observe=[lambda run: seen.append(run.step_count)])
    sim.run("static", every=10 * sim.dt, tolerance=0.1)
    assert seen[0] == 10 and seen[-1] == sim.step_count and sorted(set(seen)) == seen


def lattice_potential(n):
    """Static field of a unit force on the infinite cubic lattice, ``integral of exp(-6 t) I I I (2 t) dt``."""

    def integrand(s):
        t = s / (1 - s)
        return np.prod([special.ive(m, 2 * t) for m in n]) / (1 - s) ** 2

    return integrate.quad(integrand, 0.0, 1.0, epsabs=1e-12, epsrel=1e-10, limit=400)[0]


@pytest.mark.slow
def test_a_force_in_space_beside_the_lattice_potential():
    """The field far away is 1 / 4 pi r: nine nodes along each axis hold a small part of it, the layers the rest."""
    force = np.zeros(CUBE.shape)
    force[4, 4, 4] = 1.0
    model = fh.Wave(fh.Stencil.finite_difference(3))
    sim = fh.Simulation(CUBE, model, fh.LatticePML(target=1e-5), sources=[fh.Source(force, fh.Step(20.0))])
    sim.run("static", tolerance=1e-3)
    largest = lattice_potential((0, 0, 0))
    assert abs(largest - 0.2527310098586630) < 1e-9  # Watson (1939)
    for n in ((0, 0, 0), (1, 0, 0), (4, 0, 0), (3, 2, 1), (4, 4, 4)):
        error = sim.fields["u"][tuple(4 + i for i in n)] - lattice_potential(n)
        assert abs(error) < 1e-3 * sim.time / sim.crossing * largest


def periodic_kelvin(stencil, rate, force, nodes):
    """Displacements, of zero mean, due to forces along x on a periodic lattice."""
    angles = [2 * np.pi * np.fft.fftfreq(nodes)] * 2 + [2 * np.pi * np.fft.rfftfreq(nodes)]
    symbol = rate * stencil.symbol(*np.ix_(*angles))
    symbol[0, 0, 0] = np.eye(3)
    pull = np.multiply.outer(np.fft.rfftn(force, [nodes] * 3, (0, 1, 2)), [1.0, 0.0, 0.0])
    solved = np.linalg.solve(symbol, pull[..., None])[..., 0]
    solved[0, 0, 0] = 0.0
    found = np.stack([np.fft.irfftn(solved[..., i], [nodes] * 3, (0, 1, 2)) for i in range(3)])
    return found[:, :9, :9, :9]


@pytest.mark.slow
def test_kelvin_beside_the_infinite_lattice():
    """The periodic lattice lacks a constant of order 1 / L; its images bend the field by (4 / L)^3."""
    model = fh.Elastic(fh.Kernel(2.0, 1), 1.0)
    force = np.zeros((3, *CUBE.shape))
    force[0] = np.exp(-sum(x**2 for x in CUBE.coordinates()))
    sim = fh.Simulation(CUBE, model, fh.LatticePML(nodes=12), sources=[fh.Source(force, fh.Step(30.0))])
    sim.run("static", tolerance=3e-3, limit=400.0)
    coarse, fine = (periodic_kelvin(sim.stencil, model.coefficient, force[0], n) for n in (48, 96))
    exact = 2 * fine - coarse
    error = np.abs(sim.fields["u"] - exact).max() / exact.max()
    print(sim.time, sim.resting.slow_crossing, error)
    assert error < 3e-3 * sim.time / sim.resting.slow_crossing

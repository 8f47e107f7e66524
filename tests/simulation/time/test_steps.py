"""Time steps that divide intervals of outputs and lengths of runs."""

import copy
import re
from fractions import Fraction

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.simulation.time.steps import last_step, steps_between, whole_steps


def test_the_step_divides_what_it_is_made_for():
    """Random intervals with a common part, in any unit: whole numbers of steps, verified by exact fractions; no
    larger step would do.
    """
    seed = 20261
    rng = np.random.default_rng(seed)
    for _ in range(200):
        unit = Fraction(int(rng.integers(1, 1000)), 1000) * Fraction(10) ** int(rng.integers(-9, 7))
        counts = rng.integers(1, 400, int(rng.integers(1, 4))).tolist()
        most = float(unit) * rng.uniform(0.02, 1.0)
        dt = fh.WholeSteps(**{f"t{i}": float(unit * n) for i, n in enumerate(counts)})(most)
        exact = unit * min(counts) / round(float(unit * min(counts)) / dt)
        assert dt == pytest.approx(float(exact), rel=1e-15), seed
        assert dt <= most * (1 + 1e-5) and all((unit * n / exact).denominator == 1 for n in counts), seed
        fewer = [unit * min(counts) / k for k in range(1, round(unit * min(counts) / exact))]
        assert not any(float(s) <= most and all((unit * n / s).denominator == 1 for n in counts) for s in fewer), seed
        assert dt > most / 2 or float(unit * min(counts)) < 2 * most, seed


def test_counting_steps():
    assert whole_steps(0.3, 0.1) == 3 and whole_steps(0.3, 0.09) is None and whole_steps(0.001, 0.1) is None
    assert whole_steps(1e6, 1e6 / 333_333) == 333_333
    assert last_step(0.3, 0.1) == 3 and last_step(0.31, 0.1) == 4 and last_step(0.0, 0.1) == 0
    assert steps_between(0.75, 0.25) == 3


@pytest.mark.parametrize("every", [-1.0, 0.0, np.nan, np.inf, 0.25])
def test_outputs_between_steps_are_refused(every):
    """An interval that is no whole number of steps is refused with two that are; a step made for it is accepted."""
    lattice = fh.Lattice(0.25, [-2.0], [2.0])
    sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(0.75)), dt=0.1)
    with pytest.raises(fh.InputError, match=r"run\.every") as error:
        sim.run(1.0, every=every)
    assert sim.step_count == 0
    if every == 0.25:
        assert "every = 0.2 or 0.3" in str(error.value)
        times = []
        even = fh.Simulation(
            lattice,
            fh.Wave(fh.Kernel(0.75)),
            dt=fh.WholeSteps(every=0.25),
            observe=[lambda sim: times.append(sim.time)],
        )
        even.run(1.0, every=every)
        np.testing.assert_allclose(times, [0.25, 0.5, 0.75, 1.0], rtol=1e-14)


CASE = """
[lattice]
spacing = 0.25
lower = [-3.0]
upper = [3.0]
[model]
type = "wave"
[model.kernel]
horizon = 0.75
[run]
until = 1.0
[output]
every = 0.01
probes = [[1.13]]
"""


@pytest.mark.parametrize(
    "until, every, probe_every",
    [(1.0, 0.01, None), (70.0, 1.75, 0.5), (0.3, None, None), (1e-3, 0.3e-3, 0.1e-3), (3.0, None, 0.7)],
)
def test_outputs_of_a_case_are_even(until, every, probe_every):
    """Outputs lie at multiples of `every` to rounding, and the run ends when it should; the step is half the limit or
    a little less.
    """
    text = CASE.replace("until = 1.0", f"until = {until}").replace(
        "every = 0.01", "" if every is None else f"every = {every}"
    )
    case = Case(text + ("" if probe_every is None else f"probe_every = {probe_every}\n"))
    times = [0.0]
    sim = case.simulation(observe=[lambda sim: times.append(sim.time)])
    assert sim.dt <= 0.5 * sim.step_limit * (1 + 1e-5)
    sim.run(until, case.every(sim.dt))
    between = case.every(sim.dt)
    assert times[-1] == pytest.approx(until, rel=1e-12) and between == pytest.approx(every or max(sim.dt, until / 40))
    np.testing.assert_allclose(np.diff(times)[:-1], between, rtol=1e-9)
    assert probe_every is None or whole_steps(probe_every, sim.dt)


@pytest.mark.parametrize(
    "old, new, said",
    [
        (
            "until = 1.0",
            "until = 1.0\ndt = 0.015",
            "run.dt.*output.every is not a whole number.*remedy: dt = 0.01, or output.every = 0.015 or 0.03",
        ),
        ("until = 1.0", "until = 1.003\ndt = 0.01", "run.dt.*run.until.*run.until = 1 or 1.01"),
        (
            "every = 0.01",
            "every = 0.33",
            "no time step divides both output.every and run.until.*remedy: run.until = 0.99 or 1.32",
        ),
        ("every = 0.01", "probe_every = -1", "output.probe_every: must be positive"),
    ],
)
def test_what_does_not_fit_is_refused_with_what_does(old, new, said):
    with pytest.raises(fh.InputError, match=said):
        Case(CASE.replace(old, new)).run()


def test_rules_want_intervals():
    for intervals in ({}, {"every": 0.0}, {"every": np.nan}):
        with pytest.raises(fh.InputError):
            fh.WholeSteps(**intervals)


@pytest.mark.parametrize("most", [1e-30, 1e-300])
def test_steps_that_cannot_be_counted_are_refused(most):
    with pytest.raises(fh.InputError, match="cannot be counted") as refused:
        fh.WholeSteps(every=4.5, until=18.0)(most)
    assert refused.value.key == "dt" and refused.value.remedy


def _scattering(**options):
    speed = options.pop("speed", "where((x - 3)**2 + (y - 2)**2 < 2, 1.6, 1.5)")
    sources = [fh.PointSource((-4.0, 0.03), time=fh.Ricker(0.1))]
    lattice, model = fh.Lattice(0.5, (-6.0, -6.0), (6.0, 6.0)), fh.Wave(fh.Kernel(1.0), speed=speed)
    return fh.Simulation(lattice, model, fh.LatticePML(nodes=8), **{"sources": sources, **options})


def _said(sim):
    return [note for note in sim.notes if "was chosen for this medium" in note]


def test_a_run_to_be_compared_says_which_step_it_chose():
    """With the step that the note names, the fields of two runs are equal until the wave meets the inclusion."""
    sim = _scattering()
    [note] = _said(sim)
    dt = float(re.search(r"dt = (\S+) was", note)[1])
    assert dt == sim.dt
    wave = fh.IncidentWave((1.0, 0.0), "exp(-(t - 8)**2)", 16.0)
    assert len(_said(_scattering(speed=1.5, sources=[wave]))) == 1
    for silent in (
        _scattering(dt=dt),
        _scattering(speed=1.5),
        _scattering(sources=[], initial={"u": "exp(-x**2-y**2)"}),
    ):
        assert not _said(silent)
    apart = {}
    for name, options in {"same": {"dt": dt}, "own": {}}.items():
        total, alone = (_scattering(**options, **more).run(6.0, progress=False) for more in ({}, {"speed": 1.5}))
        seen = [run.fields["u"][:8] for run in (total, alone)]  # x up to -2.5, where nothing scattered arrives so early
        apart[name] = np.abs(seen[0] - seen[1]).max() / np.abs(seen[1]).max()
    assert apart["own"] > 100 * apart["same"]


@pytest.mark.parametrize("model", [fh.Heat(fh.Kernel(1.5)), fh.Diffusion(fh.Kernel(1.5))], ids=["heat", "diffusion"])
def test_many_steps_of_euler_name_the_faster_method(model):
    """The named step is stable, and the named saving is that of the sums over bonds."""
    lattice, start = fh.Lattice(0.5, (-5.0, -5.0), (5.0, 5.0)), {"u": "exp(-x**2 - y**2)"}
    sim = fh.Simulation(lattice, model, fh.LatticePML(nodes=6), start)
    until = 150_000 * sim.dt
    sim.prepare(until / 2)
    assert not any("rkc" in note for note in sim.notes)
    sim.prepare(until)
    [note] = [note for note in sim.notes if 'integrator = "rkc"' in note]
    longest, fewer = (float(re.search(text, note)[1]) for text in (r"steps of up to (\S+),", r"(\S+) times fewer"))
    faster = copy.copy(model)
    faster.integrator = fh.RungeKuttaChebyshev()
    other = fh.Simulation(lattice, faster, fh.LatticePML(nodes=6), start, dt=longest)
    assert fewer == pytest.approx(longest / sim.dt / 20, rel=0.05)
    other.run(40 * longest, progress=False)
    assert np.abs(other.fields["u"]).max() < 0.1  # of 1: it decays, as it does not beyond the limit


def test_euler_where_no_other_method_serves_says_nothing():
    """Conditions along an outline need one stage a step."""
    lattice = fh.Lattice(0.5, (-5.0, -5.0), (5.0, 5.0))
    sim = fh.Simulation(lattice, fh.Diffusion(fh.Kernel(1.5)), fh.PlaneWave(), {"u": "exp(-x**2 - y**2)"})
    sim.prepare(200_000 * sim.dt)
    assert not any("rkc" in note for note in sim.notes)

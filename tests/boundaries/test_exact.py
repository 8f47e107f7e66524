"""Exact ends on the engine, against chains from which nothing returns, with the same time step."""

import dataclasses
import os

import numpy as np
import pytest

import farhorizon as fh
from chains import BAR, BEAM, gaussian_weights, long_chain
from farhorizon.analysis.exact.chain import Recursion
from farhorizon.boundaries import exact
from farhorizon.case.case import Case
from farhorizon.engine.engine import available_threads
from farhorizon.papers.ji2021 import PULSE_END, BarExample, ricker, ricker_rate
from farhorizon.studies.compare import compare

COMPRESSED, CONVOLVED = fh.Exact(), fh.Exact(compress=None)
BOTH = pytest.mark.parametrize("end", [COMPRESSED, CONVOLVED], ids=["compressed", "convolved"])


def stencil_of(weights):
    """Return the stencil of the bonds a_1 .. a_K."""
    offsets = np.arange(1, weights.size + 1)
    return fh.Stencil(np.concatenate([offsets, -offsets])[:, None], np.tile(weights, 2))


def wave(weights=BAR, damping=0.0):
    """Model whose bonds on a lattice of spacing 1 have the given weights."""
    return fh.Wave(stencil_of(weights), 1.0, damping)


def line(nodes):
    return fh.Lattice(1.0, 0, nodes - 1)


def published(name, end, dt):
    """Return an example of Ji et al. (2021), made through the public interface."""
    lattice = fh.Lattice(0.1, -10, 10)
    x = lattice.axes[0]
    setup = {"lattice": lattice, "model": fh.Wave(stencil_of(BAR), speed=0.1), "boundary": end, "dt": dt}
    if name == "seismic":
        pulse = fh.Prescribed([0.0], ricker, until=PULSE_END, rate=ricker_rate)
        return fh.Simulation(**{**setup, "boundary": {"x-": end, "x+": fh.Free()}, "constraints": [pulse]})
    coefficient = np.where(np.abs(x) < 4 - 1e-9, 0.1, 1.0) if name == "interface" else None
    return fh.Simulation(**setup, initial={"u": lambda x: np.exp(-(x**2))}, coefficient=coefficient)


EXAMPLES = {"bar": BarExample(), "interface": BarExample(soft=0.1), "seismic": BarExample(seismic=True)}


@pytest.mark.parametrize(
    ("last", "dt", "bound"), [(40.0, 0.005, 1e-13), pytest.param(400.0, 0.02, 1e-12, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("name", EXAMPLES)
def test_published_examples(name, last, dt, bound):
    """The aims for the fully discrete boundary: 1e-13 at t = 40, 1e-12 at t = 400; compressed, it keeps its tolerance
    of 1e-12.
    """
    times = (0.3 * last, last)
    infinite = EXAMPLES[name].run(dt, times, None)[0]
    for end, limit in ((CONVOLVED, bound), (COMPRESSED, 1e-12)):
        sim = published(name, end, dt)
        for t, expected in zip(times, infinite, strict=True):
            sim.run(t)
            assert np.abs(sim.fields["u"] - expected).max() <= limit


RANDOM = [
    ("wave", 0.2, 1500),
    ("wave", 0.95, 1500),
    ("damped", 0.2, 1500),
    ("diffusion", 0.45, 3000),
    ("diffusion", 0.95, 3000),
]


ENDS = [
    pytest.param(
        end, reach, bound, id=f"{name}-{reach}", marks=[pytest.mark.slow] if name == "compressed" and reach > 2 else []
    )
    for name, end, bound in (("convolved", CONVOLVED, 1e-12), ("compressed", COMPRESSED, 1e-11))
    for reach in (1, 2, 7, 25)
]


@pytest.mark.sampled(7)
@pytest.mark.parametrize(("end", "reach", "bound"), ENDS)
@pytest.mark.parametrize(("kind", "share", "steps"), RANDOM)
def test_random_data_on_the_whole_near_field(end, reach, bound, kind, share, steps):
    """Including the drivers, with random velocities; the aim for the fully discrete boundary is 1e-12.

    Compressed, 1e-12 bounds the error of the force. Noise excites waves that hardly move and accumulate it: ten times
    as much is allowed.
    """
    weights, rng = gaussian_weights(reach), np.random.default_rng(reach)
    model = (
        fh.Diffusion(stencil_of(weights)) if kind == "diffusion" else wave(weights, 0.5 if kind == "damped" else 0.0)
    )
    lattice, u, increment = line(101), rng.uniform(-1, 1, 101), 0.1 * rng.uniform(-1, 1, 101)
    dt = share * fh.Simulation(lattice, model, fh.Fixed()).step_limit
    initial = {"u": u} if kind == "diffusion" else {"u": u, "v": increment / dt}
    sim = fh.Simulation(lattice, model, end, initial, dt=dt)
    recursion = Recursion.of(model.integrator, dt, model.damping)
    infinite, near = long_chain(weights, recursion, u, steps, None if kind == "diffusion" else increment)
    for _ in range(3):
        sim.step(steps // 3)
        assert np.abs(sim.fields["u"] - infinite.run(steps // 3)[near]).max() <= bound


@BOTH
@pytest.mark.parametrize("other", [fh.Free(), fh.Fixed(), fh.LatticePML(nodes=40)], ids=["free", "fixed", "pml"])
def test_one_exact_end(end, other):
    """The other end is free, fixed, or absorbed by a layer; on either side."""
    weights, steps = gaussian_weights(3), 900
    u = np.exp(-((np.arange(60) - 25.0) ** 2) / 18)
    u[np.abs(u) < 1e-12] = 0
    dt = 0.4 * fh.Simulation(line(60), wave(weights), fh.Fixed()).step_limit
    recursion = Recursion.of(wave().integrator, dt)
    sims = [
        fh.Simulation(line(60), wave(weights), {a: end, b: other}, {"u": s}, dt=dt)
        for a, b, s in (("x-", "x+", u), ("x+", "x-", u[::-1]))
    ]
    for sim in sims:
        sim.step(steps)
    # the mirror image; a layer's core has another place in memory, so that sums are taken in another order
    np.testing.assert_allclose(sims[0].fields["u"], sims[1].fields["u"][::-1], rtol=0, atol=1e-12)
    if isinstance(other, fh.Fixed):
        wide = np.pad(u, (1500, 0))
        expected = fh.Simulation(line(1560), wave(weights), other, {"u": wide}, dt=dt)
        expected.step(steps)
        assert np.abs(sims[0].fields["u"] - expected.fields["u"][1500:]).max() < 1e-12
    else:
        infinite, near = long_chain(weights, recursion, u, steps, right=not isinstance(other, fh.Free))
        # the layer: tests/boundaries/test_lattice_pml.py, with 40 nodes 1e-12 for its kernels
        bound = 1e-12 if isinstance(other, fh.Free) else 1e-10
        assert np.abs(sims[0].fields["u"] - infinite.run(steps)[near]).max() < bound


@BOTH
def test_a_run_outlives_its_kernel(end):
    """Step by step: the kernel is computed again for twice the steps, and the drivers' history is kept."""
    u = np.random.default_rng(2).uniform(-1, 1, 40)
    sim = fh.Simulation(line(40), wave(), end, {"u": u}, dt=0.1)
    infinite, near = long_chain(BAR, Recursion.of(wave().integrator, 0.1), u, 2600)
    lengths = set()
    for count in (1, 62, 3, 958, 1, 1, 500, 1074):
        sim.step(count)
        lengths.add(sim.exact_ends.steps)
        assert np.abs(sim.fields["u"] - infinite.run(count)[near]).max() <= (1e-12 if end == CONVOLVED else 1e-11)
    assert lengths == {1024, 2048, 4096}
    assert "to step 4096" in sim.ends["x-"]


@BOTH
@pytest.mark.parametrize(
    "saved", [pytest.param(1, marks=pytest.mark.slow), 64, pytest.param(100, marks=pytest.mark.slow), 1024]
)
def test_restored_runs_are_bitwise_the_same(end, saved, tmp_path):
    """Also across the end of the kernel, and at the end of a block."""
    u = np.random.default_rng(3).uniform(-1, 1, 40)
    whole = fh.Simulation(line(40), wave(damping=0.01), end, {"u": u}, dt=0.1)
    whole.step(saved)
    whole.save(tmp_path / "c")
    parts = fh.Simulation.restore(tmp_path / "c")
    assert parts.sides[0, 1] == end and parts.energy() == whole.energy()
    for sim in (whole, parts):
        sim.step(1100)
    np.testing.assert_array_equal(parts.fields["u"], whole.fields["u"])
    assert parts.energy() == whole.energy()


@BOTH
def test_energy_of_the_near_field(end):
    """Bonds across an end count half, with the values that the chain has there: against a longer bar."""
    weights = gaussian_weights(3)
    u, dt = np.random.default_rng(4).uniform(-1, 1, 30), 0.1
    sim = fh.Simulation(line(30), wave(weights), end, {"u": u}, dt=dt)
    long = fh.Simulation(line(430), wave(weights), fh.Fixed(), {"u": np.pad(u, 200)}, dt=dt)
    for _ in range(4):
        sim.step(7)
        long.step(7)
        new, old = long.engine.core.view(long.engine.current)[0, 0], long.engine.core.view(long.engine.older)[0, 0]
        near = slice(200, 230)
        expected = 0.5 * (((new - old) / dt)[near] ** 2).sum()
        for k, w in enumerate(weights, 1):
            for shift in (k, -k):
                expected += 0.25 * w * ((np.roll(new, shift) - new) * (np.roll(old, shift) - old))[near].sum()
        assert sim.energy() == pytest.approx(expected, rel=1e-10)


@BOTH
def test_data_cracks_and_interfaces_at_the_ends(end):
    """A crack, and a coefficient that varies, one node from the end: nodes are put in between."""
    weights, u = gaussian_weights(3), np.random.default_rng(5).uniform(-1, 1, 30)
    coefficient = np.full(30, 0.6)
    coefficient[[0, 1, 28]] = 0.9, 0.3, 0.7
    dt = 0.3 * fh.Simulation(line(30), wave(weights), fh.Fixed()).step_limit
    setup = {"model": wave(weights), "dt": dt, "rule": "harmonic"}
    sim = fh.Simulation(line(30), boundary=end, initial={"u": u}, cracks=[27.5], coefficient=coefficient, **setup)
    wide = {"initial": {"u": np.pad(u, 500)}, "cracks": [527.5], "coefficient": np.pad(coefficient, 500, mode="edge")}
    long = fh.Simulation(line(1030), boundary=fh.Fixed(), **wide, **setup)
    for sim_ in (sim, long):
        sim_.step(600)
    assert np.abs(sim.fields["u"] - long.fields["u"][500:530]).max() < 1e-12


def test_sources_and_background():
    """A source on a driver; the ends act on the field above the background."""
    weights, place = gaussian_weights(3), np.zeros(30)
    place[1] = 1.0
    gate = fh.Source(place, lambda t: float(t < 2))
    sim = fh.Simulation(line(30), wave(weights), CONVOLVED, sources=[gate], background=2.5, dt=0.1)
    long = fh.Simulation(
        line(830),
        wave(weights),
        fh.Fixed(2.5),
        sources=[fh.Source(np.pad(place, 400), gate.time)],
        background=2.5,
        dt=0.1,
    )
    for each in (sim, long):
        each.run(60.0)
    assert np.abs(sim.fields["u"] - long.fields["u"][400:430]).max() < 1e-12


@BOTH
def test_a_driver_that_is_held_and_let_go(end):
    """At the release, the force of the chain counts, too."""
    weights = gaussian_weights(3)
    sim, long = (
        fh.Simulation(line(n), wave(weights), side, constraints=[fh.Prescribed([at], np.sin, 2.0)], dt=0.1)
        for n, side, at in ((30, end, 1.0), (830, fh.Fixed(), 401.0))
    )
    for each in (sim, long):
        each.run(60.0)
    assert np.abs(sim.fields["u"] - long.fields["u"][400:430]).max() < 1e-12


def test_one_end_compressed_the_other_convolved():
    u = np.random.default_rng(10).uniform(-1, 1, 30)
    sim = fh.Simulation(line(30), wave(), {"x-": COMPRESSED, "x+": CONVOLVED}, {"u": u}, dt=0.1)
    infinite, near = long_chain(BAR, Recursion.of(wave().integrator, 0.1), u, 700)
    sim.step(700)
    assert np.abs(sim.fields["u"] - infinite.run(700)[near]).max() < 1e-11


def test_a_kernel_that_takes_long_is_announced(monkeypatch, capsys):
    monkeypatch.setattr(exact, "_SLOW", 0)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    fh.Simulation(line(40), wave(), CONVOLVED, dt=0.1).step(1)
    assert "kernel of 1024 steps" in capsys.readouterr().err


@pytest.mark.slow
def test_single_precision():
    """The near field is in single precision, the ends are in double."""
    u = np.exp(-((np.arange(40) - 20.0) ** 2) / 9)
    u[u < 1e-8] = 0
    runs = [
        fh.Simulation(line(40), wave(), COMPRESSED, {"u": u}, dt=0.1, dtype=real) for real in ("float32", "float64")
    ]
    for sim in runs:
        sim.step(500)
    assert np.abs(runs[0].fields["u"] - runs[1].fields["u"]).max() < 1e-5


def test_threads():
    """A bar so long that threads share it; one of them computes the ends."""
    u = np.random.default_rng(9).uniform(-1, 1, 50_001)
    runs = [
        fh.Simulation(line(50_001), wave(), COMPRESSED, {"u": u}, dt=0.1, threads=n) for n in (1, available_threads())
    ]
    for sim in runs:
        sim.step(40)
    np.testing.assert_array_equal(runs[0].fields["u"], runs[1].fields["u"])


def test_a_checkpoint_of_other_sides_is_refused(tmp_path):
    setup = {"lattice": line(40), "model": wave(), "initial": {"u": np.zeros(40)}, "dt": 0.1}
    ours, other = fh.Simulation(**setup, boundary=COMPRESSED), fh.Simulation(**setup, boundary=fh.Fixed())
    for sim, wrong in ((ours, other), (other, ours)):
        sim.save(tmp_path / "c")
        with pytest.raises(fh.InputError, match="another set-up"):
            wrong.load(tmp_path / "c")


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", [1e-6, 1e-9, 1e-12])
def test_bounded_over_a_million_steps(tolerance, monkeypatch):
    """A sum for 8192 steps that is run for a million, by declaring it valid for so many: the bar leaves an offset,
    and noise does not grow.

    As in tests/analysis/exact/test_exponential_sum.py: noise on 51 nodes, which excites waves that hardly move.
    """
    made = exact._compressed
    monkeypatch.setattr(
        exact, "_compressed", lambda a, r, steps, c: dataclasses.replace(made(a, r, 8192, c), steps=steps)
    )
    noise = np.random.default_rng(4).uniform(-1, 1, 51)
    for half, initial, bound in ((10, lambda x: np.exp(-(x**2)), tolerance), (2.5, noise, 1.0)):
        sim = fh.Simulation(
            fh.Lattice(0.1, -half, half),
            fh.Wave(stencil_of(BAR), speed=0.1),
            fh.Exact(tolerance),
            {"u": initial},
            dt=0.005,
        )
        sim.exact_ends.cover(10**6)
        for _ in range(4):
            sim.step(250_000)
            assert np.abs(sim.fields["u"]).max() <= bound


def test_what_serves_an_end_is_said():
    """The modes and the error bound once they are known, and a tolerance that no sum meets."""
    setup = {"lattice": line(40), "model": wave(), "initial": {"u": np.ones(40)}, "dt": 0.1}
    sim = fh.Simulation(**setup, boundary={"x-": COMPRESSED, "x+": CONVOLVED})
    assert "when the run begins" in sim.check().details
    sim.prepare(100.0)
    text = sim.check().details
    assert "modes, error of the force <= " in text and "past convolved, exact to rounding, to step 1024" in text
    strict = fh.Simulation(**setup, boundary=fh.Exact(compress=1e-15))
    strict.prepare(10.0)
    assert any("no sum of exponentials meets the tolerance 1e-15" in note for note in strict.notes)
    strict.step(100)
    sim.step(100)
    assert np.abs(strict.fields["u"] - sim.fields["u"]).max() < 1e-12


def test_sums_are_kept_on_disk(monkeypatch, tmp_path):
    """A second process finds the sum; a damaged file is computed again."""
    monkeypatch.setenv("FARHORIZON_CACHE", str(tmp_path))
    weights, recursion = tuple(BAR.tolist()), Recursion.of(wave().integrator, 0.0123)
    made = exact._compressed(weights, recursion, 1024, 1e-9)
    path = next(tmp_path.glob("exact_*.npz"))
    assert path.stat().st_size < 20_000
    exact._compressed.cache_clear()
    with monkeypatch.context() as patch:
        patch.setattr(exact, "_make_kernel", None)
        found = exact._compressed(weights, recursion, 1024, 1e-9)
    np.testing.assert_array_equal(found.poles, made.poles)
    path.write_bytes(path.read_bytes()[:1000])
    exact._compressed.cache_clear()
    assert exact._compressed(weights, recursion, 1024, 1e-9).modes == made.modes


CASE = """
[lattice]
spacing = 0.25
lower = [-5.0]
upper = [5.0]
[model]
type = "wave"
[model.kernel]
horizon = 0.75
[initial]
u = "exp(-4*x**2)"
[boundary]
"x-" = {{ type = "exact"{} }}
"x+" = {{ type = "free" }}
[run]
until = 4.0
"""


def test_case_files():
    assert Case(CASE.format("")).simulation().sides[0, -1] == COMPRESSED
    assert Case(CASE.format(", compress = 1e-6")).simulation().sides[0, -1] == fh.Exact(1e-6)
    assert Case(CASE.format(", compress = false")).simulation().sides[0, -1] == CONVOLVED
    with pytest.raises(fh.InputError, match="did you mean 'compress'"):
        Case(CASE.format(", compres = 1e-6"))
    with pytest.raises(fh.InputError, match="out of range"):
        Case(CASE.format(", compress = 2.0"))


def test_bad_input():
    pulse = {"u": lambda x: np.exp(-((x - 20) ** 2) / 9)}
    with pytest.raises(fh.InputError, match=r"one dimension.*LatticePML"):
        fh.Simulation(fh.Lattice(0.25, (-3, -3), (3, 3)), fh.Wave(fh.Kernel(0.5)), COMPRESSED)
    for integrator in ("rk4", "rkc", fh.RungeKuttaChebyshev(2)):
        with pytest.raises(fh.InputError, match="one stage only"):
            fh.Simulation(line(40), fh.Diffusion(stencil_of(BAR), integrator=integrator), COMPRESSED)
    with pytest.raises(fh.InputError, match="not zero beyond the absorbing side x-"):
        fh.Simulation(line(40), wave(), COMPRESSED, {"u": lambda x: np.exp(-((x - 2) ** 2) / 9)})
    with pytest.raises(fh.InputError, match="lies outside the near field"):
        fh.Simulation(line(40), wave(), COMPRESSED, pulse, sources=[lambda x, t: np.exp(-((x - 60) ** 2))]).run(1.0)
    with pytest.raises(fh.InputError, match="cannot continue it"):
        fh.Simulation(line(40), wave(), COMPRESSED, pulse, cracks=[39.5])
    with pytest.raises(fh.InputError, match="positive"):
        fh.Simulation(line(40), wave(), COMPRESSED, pulse, coefficient=np.where(np.arange(40) < 5, 0.0, 1.0))
    with pytest.raises(fh.InputError, match="out of range"):
        fh.Exact(0.5)
    sim = fh.Simulation(line(40), wave(), COMPRESSED, pulse)
    with pytest.raises(fh.InputError, match="does not fit into memory"):
        sim.prepare(1e12)


def test_beam_stencil():
    """Weights of both signs (biharmonic), random data."""
    u = np.random.default_rng(8).uniform(-1, 1, 20)
    dt = 0.6 * fh.Simulation(line(20), wave(BEAM), fh.Fixed()).step_limit
    infinite, near = long_chain(BEAM, Recursion.of(wave().integrator, dt), u, 1000)
    for end, bound in ((COMPRESSED, 1e-11), (CONVOLVED, 1e-12)):
        sim = fh.Simulation(line(20), wave(BEAM), end, {"u": u}, dt=dt)
        sim.step(1000)
        expected = infinite.u if infinite.step else infinite.run(1000)
        assert np.abs(sim.fields["u"] - expected[near]).max() <= bound


def drifting(reach, seed=5):
    """Return a stencil with random positive weights that differ ahead and behind."""
    rng = np.random.default_rng(int(os.environ.get("FARHORIZON_SEED", seed)))
    offsets = np.array([k for k in range(-reach, reach + 1) if k])
    return fh.Stencil(offsets[:, None], rng.uniform(0.2, 1.0, 2 * reach) / np.abs(offsets))


@pytest.mark.parametrize("reach", [1, 2, 5])
@pytest.mark.parametrize("made", ["diffusion", "heat", "reaction", "upwind"])
def test_media_that_drift(reach, made):
    """Exact ends against a line so long that nothing arrives at its ends, at the same time step."""
    stencil = drifting(reach)
    if made == "reaction":
        stencil = stencil.with_reaction(0.02)
    if made == "upwind":  # nothing comes back against the drift
        stencil = fh.Stencil(stencil.offsets[:reach], stencil.weights[:reach])
    model = fh.Heat(stencil, density=2.0, specific_heat=0.5, conductivity=0.7) if made == "heat" else None
    setup = {"model": model or fh.Diffusion(stencil, 0.7), "initial": {"u": "exp(-x**2)*(1 + 0.3*sin(3*x))"}}
    near = fh.Simulation(fh.Lattice(0.2, -6, 6), boundary=fh.Exact(), **setup)
    with pytest.raises(fh.InputError, match="flows are not sums over bonds"):
        near.flux()
    wide = fh.Simulation(fh.Lattice(0.2, -100, 100), boundary=fh.Fixed(), dt=near.dt, **setup)
    for until in (1.0, 5.0):
        near.run(until=until)
        wide.run(until=until)
        assert np.abs(near.fields["u"] - wide.fields["u"][470:-470]).max() < 1e-14
    assert near.certificate().verdict == "certified"


def test_media_that_drift_against_the_infinite_lattice():
    """Exact ends against the Fourier transform of the infinite lattice, which `compare` uses."""
    medium = {"model": fh.Diffusion(drifting(3)), "boundary": fh.Exact(), "initial": {"u": "exp(-2*x**2)"}}
    for sources in ((), ["exp(-x**2 - t)"]):  # by Fourier transform, and on a longer line
        found = compare({"lattice": fh.Lattice(0.2, -7, 7), "sources": sources, **medium}, 8.0)
        assert found.curves["exact"]["error_max_over_run"] < 1e-13


def test_media_that_drift_resume(tmp_path):
    """A run goes on from its checkpoint bit by bit."""
    setup = (fh.Lattice(0.2, -6, 6), fh.Diffusion(drifting(3)), fh.Exact(), {"u": "exp(-x**2)"})
    whole, part = fh.Simulation(*setup), fh.Simulation(*setup)
    whole.step(300)
    part.step(100)
    part.save(tmp_path / "part")
    again = fh.Simulation.restore(tmp_path / "part")
    again.step(200)
    assert np.array_equal(again.fields["u"], whole.fields["u"])


@pytest.mark.parametrize(
    ("more", "match"),
    [
        ({"boundary": None}, "LatticePML does not support weights that differ"),
        ({"boundary": fh.Free()}, "limit: Exact, Fixed, Periodic"),
        ({"model": fh.Wave(drifting(1))}, "not available with this integrator.*velocity Verlet"),
        ({"model": fh.Diffusion(drifting(1), integrator="rk4")}, "limit: diffusion and heat by forward Euler"),
        ({"model": fh.Diffusion(fh.Stencil([[1], [-1]], [1.0, -1.0]))}, "grow at every time step"),
        ({"model": fh.Diffusion(drifting(1), diffusivity="1 + 0.1*sin(x)")}, "is uniform"),
        ({"coefficient": np.ones(61)}, "is uniform"),
        ({"cracks": [0.05]}, "no bond is cut"),
    ],
)
def test_what_media_that_drift_do_not_support(more, match):
    """Refused before the run, with what is available."""
    setup = {"model": fh.Diffusion(drifting(1)), "boundary": fh.Exact(), "initial": {"u": "exp(-x**2)"}}
    with pytest.raises(fh.InputError, match=match):
        fh.Simulation(fh.Lattice(0.2, -6, 6), **setup | more)

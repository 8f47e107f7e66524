"""Forces that relax: stability, layers, and what continues a run."""

from dataclasses import replace

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.engine.engine import available_threads
from farhorizon.engine.features.relaxations import relaxation_factors
from farhorizon.engine.state import State
from farhorizon.errors import InputError

LOW = fh.Attenuation(5.0, (0.02, 0.3))
ROCK = fh.Wave(fh.Kernel(1.0), attenuation=LOW)
TWO = replace(LOW, quality=30.0, regions=[fh.LossyRegion(fh.Box((0.0,), (99.0,)), 5.0)])
FLAT = replace(LOW, regions=[fh.LossyRegion(fh.Disc(2.0), 5.0)])
LINE = fh.Lattice(0.5, -10.0, 10.0)
BELL = {"u": "exp(-x**2)"}


def step_matrix(ratio, keep, now, later):
    """Matrix of a step of a mode with ``dt^2 S = ratio``, on the levels of the field and the memory."""
    count = len(keep)
    matrix = np.zeros((2 + count,) * 2)
    matrix[0, :2], matrix[1, 0], matrix[0, 2:] = (2 - ratio * (1 - now.sum()), -1), 1, -1
    matrix[2:, 0], matrix[2:, 2:] = -ratio * later, np.diag(keep)
    return matrix


@pytest.mark.parametrize("quality", [5.0, 50.0])
@pytest.mark.parametrize("shortest", [0.01, 0.3, 3.0])
def test_no_mode_grows_up_to_the_limit_of_the_unrelaxed_medium(quality, shortest):
    """Of all wavelengths, however long the relaxation times are compared with the step."""
    times, shares = fh.Attenuation(quality, (0.01, 1.0)).relaxation
    factors = relaxation_factors(times, shares, times.min() * shortest)
    for ratio in np.append(np.geomspace(1e-6, 4, 200), 4.0):
        assert np.abs(np.linalg.eigvals(step_matrix(ratio, *factors))).max() <= 1 + 1e-12
    keep, now, later = factors
    alternating = 1 - (now - (later - keep * now)).dot(1 / (1 + keep))  # share that is left of an alternating force
    assert 0 < alternating <= 1
    assert np.abs(np.linalg.eigvals(step_matrix(4.01 / alternating, *factors))).max() > 1


def test_noise_dies_out_just_below_the_limit():
    """Between a free and a fixed side."""
    noise = np.random.default_rng(74).standard_normal(41)
    sides = {"x-": fh.Free(), "x+": fh.Fixed()}
    limit = fh.Simulation(LINE, ROCK, sides, {"u": noise}, threads=1).step_limit
    sim = fh.Simulation(LINE, ROCK, sides, {"u": noise}, dt=0.9999 * limit, threads=1)
    assert sim.energies().keys() == {"kinetic"}
    sim.step()
    first = sim.energies()["kinetic"]
    sim.step(1000)
    assert sim.energies()["kinetic"] < 1e-6 * first


def test_energy_never_grows():
    """Of motion, of the relaxed springs and of those that relax: ``c^2 ((1 - sum a) <u, -L u> + sum a <u - u_l, -L (u -
    u_l)>) / 2``, where u_l is the displacement of the dashpot l.
    """
    count, times, shares = 64, *LOW.relaxation
    line = fh.Lattice(0.5, 0.0, 31.5)
    noise = np.random.default_rng(4).standard_normal(count)
    sim = fh.Simulation(line, ROCK, fh.Periodic(), {"u": noise}, threads=1)
    sim = fh.Simulation(line, ROCK, fh.Periodic(), {"u": noise}, dt=sim.step_limit / 8, threads=1)
    squared = sim.stencil.symbol(2 * np.pi * np.arange(33) / count) / 0.25 * LOW.unrelaxed

    def stretched(u):
        return 0.5 * (squared * np.abs(np.fft.rfft(u)) ** 2 * np.where(np.arange(33) % 32, 2, 1)).sum() / count

    keep = np.exp(-sim.dt / times)[:, None]
    mean = -np.expm1(-sim.dt / times)[:, None] * (times / sim.dt)[:, None]
    u, slid, energies = sim.fields["u"].copy(), np.zeros((len(times), count)), []
    for _ in range(2000):
        sim.step()
        now = sim.fields["u"].copy()
        stored = (1 - shares.sum()) * stretched(u) + sum(
            a * stretched(u - s) for a, s in zip(shares, slid, strict=True)
        )
        slid_now = keep * slid + (mean - keep) * u + (1 - mean) * now
        later = (1 - shares.sum()) * stretched(now)
        later += sum(a * stretched(now - s) for a, s in zip(shares, slid_now, strict=True))
        between = (1 - shares.sum()) * stretched(now - u)
        between += sum(a * stretched(now - u - t + s) for a, s, t in zip(shares, slid, slid_now, strict=True))
        # of products of two steps, as the kinetic energy is one of the time between them
        energies.append(((now - u) ** 2).sum() / (2 * sim.dt**2) + (stored + later - between) / 2)
        u, slid = now, slid_now
    growth = np.diff(energies) / energies[:-1]
    assert growth.max() < 1e-12
    assert energies[-1] < 1e-3 * energies[0]


def test_the_certificate_includes_the_memory():
    """Its state has the memory of all nodes, so that its map is that of the run."""
    sim = fh.Simulation(LINE, ROCK, fh.LatticePML(nodes=4), BELL, threads=1)
    state = State(sim.engine)
    mechanisms = len(LOW.relaxation.times)
    assert state.size >= (2 + mechanisms) * state.size_of_field
    rng = np.random.default_rng(3)
    a, b = rng.standard_normal((2, state.size))
    np.testing.assert_allclose(state.after(a + 2 * b, 7), state.after(a, 7) + 2 * state.after(b, 7), atol=1e-11)
    np.testing.assert_allclose(state.after(state.after(a, 3), 4), state.after(a, 7), atol=1e-12)
    assert str(sim.certificate()).startswith("certified")


@pytest.mark.parametrize("target", [1e-3, 1e-5])
@pytest.mark.parametrize("dim", [1, 2])
def test_layers_keep_their_target(dim, target):
    """Against a domain so large that nothing returns."""
    near, far = (fh.Lattice(0.5, [-r] * dim, [r] * dim) for r in (6.0, 28.0))
    bell = {"u": "*".join(f"exp(-{axis}**2)" for axis in "xy"[:dim])}
    sim = fh.Simulation(near, ROCK, fh.LatticePML(target=target, until=35.0), bell, threads=1)
    endless = fh.Simulation(far, ROCK, fh.Fixed(), bell, dt=sim.dt, threads=1)
    inside = (slice(44, 69),) * dim
    for _ in range(int(35 / sim.dt) // 10):
        sim.step(10)
        endless.step(10)
        assert np.abs(sim.fields["u"] - endless.fields["u"][inside]).max() < target


@pytest.mark.skipif(available_threads() < 2, reason="one thread")
def test_two_threads_compute_what_one_does():
    """In a box that is large enough for two, to the last bit."""
    plane, bell = fh.Lattice(1.0, (0.0, 0.0), (220.0, 219.0)), {"u": "exp(-((x-100)**2+(y-90)**2)/20)"}
    model = fh.Wave(fh.Kernel(2.0), attenuation=fh.Attenuation(20.0, (0.01, 0.1)))
    sims = [fh.Simulation(plane, model, fh.Periodic(), bell, threads=threads) for threads in (1, 2)]
    for sim in sims:
        sim.step(20)
    assert sims[1].engine.threads == 2
    np.testing.assert_array_equal(sims[1].fields["u"], sims[0].fields["u"])


@pytest.mark.parametrize(("given", "balance"), [(LOW, True), (TWO, False)], ids=["balance", "regions"])
def test_a_run_resumes_bit_for_bit(tmp_path, given, balance):
    """The memory of the nodes is in the checkpoint, and so are the attenuation and what it has dissipated."""
    model = fh.Wave(fh.Kernel(1.0), attenuation=given)
    sim = fh.Simulation(LINE, model, fh.LatticePML(nodes=4), BELL, threads=1, balance=balance)
    sim.step(30)
    sim.save(tmp_path / "half.npz")
    resumed = fh.Simulation.restore(tmp_path / "half.npz")
    kept = resumed.setup.model.attenuation
    assert (kept.quality, len(kept.regions)) == (given.quality, len(given.regions))
    sim.step(40)
    resumed.step(40)
    np.testing.assert_array_equal(resumed.fields["u"], sim.fields["u"])
    assert resumed.energies() == pytest.approx(sim.energies(), rel=1e-14)


def test_regions_alike_are_no_regions():
    """Runs of nodes, the rest of a row, and what layers complete later, relax alike."""
    fields = []
    for regions in ((), [fh.LossyRegion(fh.Disc(3.1, (0.3, -0.4)), LOW.quality)]):
        model = fh.Wave(fh.Kernel(1.0), attenuation=replace(LOW, regions=regions))
        plane, bell = fh.Lattice(0.5, (-5.0, -6.0), (5.0, 6.0)), {"u": "exp(-x**2 - y**2)"}
        sim = fh.Simulation(plane, model, {"x": fh.LatticePML(nodes=4), "y": fh.Free()}, bell, threads=1)
        sim.step(60)
        fields.append(sim.fields["u"])
    np.testing.assert_array_equal(*fields)


def test_released_nodes_move_by_the_forces_that_are_left():
    """A node that is held where it moves anyway, and then released, does not notice."""
    free = fh.Simulation(LINE, ROCK, fh.Free(), BELL, dt=0.1, threads=1)
    path = [float(free.fields["u"][20])]
    for _ in range(30):
        free.step()
        path.append(float(free.fields["u"][20]))
    curve = fh.Prescribed([0.0], lambda t: np.interp(t, 0.1 * np.arange(31), path), until=2.0)
    held = fh.Simulation(LINE, ROCK, fh.Free(), BELL, dt=0.1, constraints=[curve], threads=1)
    held.step(30)
    assert np.abs(held.fields["u"] - free.fields["u"]).max() < 0.01


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"boundary": fh.Exact()}, "boundary.x-.*attenuation|attenuation.*boundary"),
        ({"dtype": "float32"}, "float64"),
        ({"model": fh.Wave(fh.Kernel(1.0), attenuation=fh.Attenuation(50.0, (0.1, 2.0)))}, "band.*lattice.*<= 0."),
        ({"model": fh.Wave(fh.Kernel(1.0), attenuation=LOW, integrator="modified-equation")}, "modified"),
        ({"model": fh.Wave(fh.Kernel(1.0), attenuation=TWO), "balance": True}, "balance.*one quality"),
        ({"model": fh.Wave(fh.Kernel(1.0), attenuation=FLAT)}, "regions.*dimension"),
    ],
)
def test_what_has_no_attenuation_is_refused(arguments, words):
    given = {"lattice": LINE, "model": ROCK, "boundary": fh.Free(), "initial": BELL} | arguments
    with pytest.raises(InputError, match=words):
        fh.Simulation(**given)


def test_recorders_and_gradients_of_lossless_media_are_refused():
    plane = fh.Lattice(0.5, (-5.0, -5.0), (5.0, 5.0))
    bell = {"u": "exp(-2*(x**2 + y**2))"}
    for recorder in (
        fh.PowerThrough(fh.Box((-2.0, -2.0), (2.0, 2.0)), frequencies=[0.1]),
        fh.FarField(fh.Box((-3.0, -3.0), (3.0, 3.0)), frequencies=[0.1]),
        fh.Receivers([(0.0, 0.0)], record="energy_flux"),
    ):
        with pytest.raises(InputError, match="not available in a medium with attenuation"):
            fh.Simulation(plane, ROCK, fh.LatticePML(nodes=4), bell, observe=[recorder], threads=1)
    with pytest.raises(InputError, match="gradient"):
        setup = fh.Setup(LINE, ROCK, fh.LatticePML(nodes=4), BELL)
        fh.gradient(setup, [fh.LeastSquares(fh.Receivers([(3.0,)]), np.zeros((20, 1)))], "u", until=5.0)
    with pytest.raises(InputError, match="attenuation"):
        fh.Simulation(
            plane,
            fh.Elastic(fh.Kernel(1.0), 1.0, critical_stretch=0.1, attenuation=LOW),
            fh.Free(),
            {"u": ["exp(-x**2)", 0.0]},
        )


def test_a_case_file_gives_the_attenuation():
    text = """
    [lattice]
    spacing = 0.5
    lower = [-10.0]
    upper = [10.0]
    [model]
    type = "wave"
    kernel = { horizon = 1.0 }
    attenuation = { quality = 5.0, band = [0.02, 0.3] }
    [boundary]
    x = { type = "free" }
    [initial]
    u = "exp(-x**2)"
    [run]
    until = 1.0
    """
    assert Case(text).simulation().model.attenuation == LOW

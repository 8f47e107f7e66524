"""Simulation: state, energies, guard, observers and refusals."""

import itertools
import tracemalloc

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.engine.state import as_before
from farhorizon.simulation.sides.layered_sides import memory_needed

LATTICE = fh.Lattice(0.25, (-3, -3), (3, 3))
KERNEL = fh.Kernel(0.75)


def pulse(x, y):
    return np.exp(-4 * (x**2 + y**2))


def simulation(**changes):
    setup = {"lattice": LATTICE, "model": fh.Wave(KERNEL), "initial": {"u": pulse}}
    return fh.Simulation(**{**setup, **changes})


@pytest.mark.parametrize(
    "model", [fh.Wave(KERNEL, damping=0.1), fh.Diffusion(KERNEL), fh.Diffusion(KERNEL, integrator="rk4")]
)
@pytest.mark.parametrize("steps", [7, 10])
def test_resumed_run_is_bitwise_equal(tmp_path, model, steps):
    """Saved and loaded after an odd or even number of steps, layer memory included."""
    source = [fh.Source(pulse, np.cos)]
    whole = simulation(model=model, sources=source)
    whole.step(25)
    first = simulation(model=model, sources=source)
    first.step(steps)
    first.save(tmp_path / "state.ckpt", note=3)
    second = simulation(model=model, sources=source)
    assert second.load(tmp_path / "state.ckpt") == {"note": 3}
    second.step(25 - steps)
    np.testing.assert_array_equal(second.fields["u"], whole.fields["u"])
    assert second.time == whole.time


def test_resumed_bar_is_bitwise_equal(tmp_path):
    """Runs in 1D advance by increments, which are part of the state, too."""

    def make():
        return fh.Simulation(fh.Lattice(0.25, -4, 4), fh.Wave(KERNEL), initial={"u": lambda x: np.exp(-4 * x**2)})

    whole, first, second = make(), make(), make()
    whole.step(40)
    first.step(13)
    first.save(tmp_path / "bar.ckpt")
    second.load(tmp_path / "bar.ckpt")
    second.step(27)
    np.testing.assert_array_equal(second.fields["u"], whole.fields["u"])


RESTORED = [
    {},
    {
        "model": fh.Diffusion(KERNEL, integrator="rk4"),
        "sources": [fh.Source(pulse(*LATTICE.coordinates())), fh.Expression("x*exp(-4*x**2-4*y**2)*t", 2)],
    },
    {
        "lattice": fh.Lattice(0.25, window=fh.Disc(3.0)),
        "cracks": [[(-1.0, 0.1), (1.0, 0.6)]],
        "background": 2.0,
        "initial": {"u": 2.0},
    },
    {
        "lattice": fh.Lattice(0.25, (-3, -3), (3, 3), body=fh.Box((-3, -3), (3, 3)) - fh.Disc(0.8, (1, 1))),
        "boundary": fh.Free(),
    },
    {"lattice": fh.Lattice(0.25, (-3, -3), (3, 3), body=fh.Disc(2.5)), "boundary": fh.Free(), "rim": "fixed"},
    {
        "boundary": {"x": fh.LatticePML(nodes=8), "y-": fh.Sponge(5), "y+": fh.Fixed()},
        "coefficient": 1 + 0.5 * np.sign(LATTICE.coordinates()[1]),
    },
    {"model": fh.Wave(fh.Stencil.finite_element(2)), "boundary": fh.Periodic(), "dtype": "float32"},
]


@pytest.mark.parametrize("changes", RESTORED)
def test_restored_simulation_goes_on_bitwise(tmp_path, changes):
    """A checkpoint alone rebuilds the simulation: lattice, model, sides, cracks, material and sources."""
    sim = simulation(**changes)
    sim.step(9)
    sim.save(tmp_path / "state.ckpt")
    again = fh.Simulation.restore(tmp_path / "state.ckpt")
    assert again.time == sim.time
    sim.step(12)
    again.step(12)
    np.testing.assert_array_equal(again.fields["u"], sim.fields["u"])


def test_restore_asks_for_python_functions(tmp_path):
    source = lambda x, y, t: pulse(x, y) * t  # noqa: E731
    sim = simulation(sources=[source])
    sim.step(5)
    sim.save(tmp_path / "state.ckpt")
    with pytest.raises(fh.InputError, match="Python function"):
        fh.Simulation.restore(tmp_path / "state.ckpt")
    again = fh.Simulation.restore(tmp_path / "state.ckpt", sources=[source])
    np.testing.assert_array_equal(again.fields["u"], sim.fields["u"])


def test_checkpoint_of_another_set_up_is_refused(tmp_path):
    simulation().save(tmp_path / "state.ckpt")
    with pytest.raises(fh.FileFormatError, match="another set-up"):
        simulation(model=fh.Wave(KERNEL, speed=2.0)).load(tmp_path / "state.ckpt")


def test_step_in_parts_equals_one_call():
    one, many = simulation(), simulation()
    one.step(30)
    for count in (1, 2, 3, 24):
        many.step(count)
    np.testing.assert_array_equal(one.fields["u"], many.fields["u"])


@pytest.mark.parametrize("integrator", ["euler", "rk4", fh.RungeKuttaChebyshev(4), fh.RungeKuttaChebyshev(7)])
def test_sources_act_alike_however_steps_are_divided(integrator):
    """Amplitudes of all stages are combined for all steps of a call, and rounded alike for any number of these."""
    model, source = fh.Diffusion(KERNEL, integrator=integrator), fh.Source(pulse, lambda t: np.cos(7 * t) + t)
    one, other = (simulation(model=model, sources=[source]) for _ in range(2))
    one.step(40)
    for steps in (1, 1, 2, 3, 33):
        other.step(steps)
    np.testing.assert_array_equal(one.engine.levels, other.engine.levels)


def test_a_run_that_was_not_finite_goes_on_from_a_checkpoint(tmp_path):
    """Layers of diffusion have no memory: all take the same few numbers for it, which only zeros may have met. So do
    lanes without a line: there are 22 lines here, and 32 lanes.
    """
    lattice, slow = fh.Lattice(0.25, (-1.25, -6.0), (1.25, 6.0)), fh.LatticePML(nodes=5)
    sides = {"x-": slow, "x+": fh.Fixed(), "y": slow}
    start = {"u": "max(0, 1 - x**2 - y**2)**3"}
    sim = simulation(lattice=lattice, model=fh.Diffusion(KERNEL), boundary=sides, initial=start, dtype="float32")
    assert not sim.engine.remember and sim.engine.memory.size
    sim.save(tmp_path / "state.ckpt")
    sim.step(20)
    found = sim.fields["u"]
    sim.load(tmp_path / "state.ckpt")
    sim.engine.core.view(sim.engine.current)[...] = np.nan
    with pytest.raises(fh.UnstableError):
        sim.step(20)
    sim.load(tmp_path / "state.ckpt")
    with as_before(sim.engine):
        sim.engine.core.view(sim.engine.current)[...] = np.nan
        sim.engine.advance(20)
    sim.step(20)
    np.testing.assert_array_equal(sim.fields["u"], found)


@pytest.mark.parametrize("boundary", [fh.Free(), fh.Periodic()])
def test_energy_is_conserved(boundary):
    """The discrete energy of undamped Verlet is constant to rounding in a closed body, with a crack in it."""
    sim = simulation(boundary=boundary, cracks=[[(-1.1, 0.4), (1.3, 0.4)]])
    start = sim.energy()
    sim.step(500)
    assert sim.energy() == pytest.approx(start, rel=1e-12)


def test_viscous_damping_takes_energy_at_its_rate():
    """A uniform velocity in a free body decays like exp(-2 d t), in the scheme by the factor (1 - d dt)/(1 + d dt) a
    step.
    """
    sim = simulation(model=fh.Wave(KERNEL, damping=0.2), boundary=fh.Free(), initial={"v": 1.0})
    sim.step(50)
    share = 0.2 * sim.dt
    expected = ((1 - share) / (1 + share)) ** 50 * (1 + share)  # half a step late
    np.testing.assert_allclose(sim.fields["v"], expected, rtol=1e-10)


def test_total_is_conserved_by_diffusion():
    """There is no flux through free faces, cracks and the rim of a cavity."""
    body = fh.Box((-3, -3), (3, 3)) - fh.Disc(0.8, (1.0, 1.0))
    lattice = fh.Lattice(0.25, (-3, -3), (3, 3), body=body)
    sim = fh.Simulation(lattice, fh.Diffusion(KERNEL), fh.Free(), {"u": pulse}, cracks=[[(-2, -1.1), (1, -1.1)]])
    start = np.nansum(sim.fields["u"])
    sim.step(300)
    assert np.nansum(sim.fields["u"]) == pytest.approx(start, rel=1e-12)
    assert np.isnan(sim.fields["u"][LATTICE.index((1.0, 1.0))])


@pytest.mark.parametrize("dim", [1, 2])
@pytest.mark.parametrize(
    "make", [fh.Wave, fh.Diffusion, lambda k: fh.Diffusion(k, integrator="rk4")], ids=["Verlet", "Euler", "RK4"]
)
def test_a_fixed_rim_is_the_medium_with_zeros_outside(make, dim):
    """Nodes outside the body stay at the background and keep their bonds: against eigenmodes of the operator
    restricted to the nodes of the body.
    """
    n = 17
    body = fh.Box(-1.0, 1.1) if dim == 1 else fh.Disc(1.0, (0.1, 0.0))
    lattice = fh.Lattice(0.25, (-2.0,) * dim, (2.0,) * dim, body=body)
    inside = np.flatnonzero(lattice.mask.ravel())
    model = make(fh.Kernel(0.5))
    stencil = model.stencil(0.25, dim)
    number = np.arange(n**dim).reshape((n,) * dim)
    matrix = np.zeros((n**dim, n**dim))
    for o, w in zip(stencil.offsets, stencil.weights * model.coefficient / 0.25**2, strict=True):
        matrix[number.ravel(), np.roll(number, tuple(-o), tuple(range(dim))).ravel()] += w
        matrix[number.ravel(), number.ravel()] -= w
    rates, modes = np.linalg.eigh(matrix[np.ix_(inside, inside)])
    u = np.zeros(n**dim)
    u[inside] = modes[:, -3]
    sim = fh.Simulation(
        lattice, model, fh.Fixed(1.5), {"u": u.reshape(lattice.shape) + 1.5}, background=1.5, rim="fixed"
    )
    sim.step(20)
    if model.order == 2:
        factor = np.cos(20 * 2 * np.arcsin(sim.dt * np.sqrt(-rates[-3]) / 2))  # Verlet's discrete frequency
    else:
        factor = model.integrator.growth(-rates[-3], sim.dt) ** 20
    np.testing.assert_allclose(sim.fields["u"].ravel()[inside], 1.5 + factor * modes[:, -3], atol=1e-12)
    assert np.isnan(np.delete(sim.fields["u"].ravel(), inside)).all()


@pytest.mark.parametrize("coefficient", [0.5, "0.5 + 0*x"])
def test_a_body_whose_rim_is_held_conducts_there_by_its_own_coefficient(coefficient):
    """Half the coefficient everywhere is half the diffusivity."""
    lattice = fh.Lattice(1.0, (-10.0, -10.0), (10.0, 10.0), body=fh.Disc(8.3))

    def cooled(diffusivity, **options):
        model = fh.Diffusion(fh.Kernel(2.0), diffusivity)
        sim = fh.Simulation(lattice, model, fh.Fixed(), {"u": 1.0}, rim="fixed", dt=0.1, balance=True, **options)
        sim.step(40)
        return sim

    found, wanted = cooled(1.0, coefficient=coefficient), cooled(0.5)
    np.testing.assert_allclose(found.fields["u"], wanted.fields["u"], atol=1e-13)
    assert found.balance()["rim"] == pytest.approx(wanted.balance()["rim"], rel=1e-12)
    assert wanted.balance()["rim"] < -10  # what has left through the rim, of 1 on each of 221 nodes


def test_fixed_sides_reach_the_linear_profile():
    """Steady diffusion between two fixed sides, periodic along them: linear between the first nodes outside."""
    sides = {"x-": fh.Fixed(0.0), "x+": fh.Fixed(1.0), "y": fh.Periodic()}
    sim = fh.Simulation(LATTICE, fh.Diffusion(fh.Stencil.finite_difference(2)), sides)
    sim.run(150.0)
    n = LATTICE.shape[0]
    expected = (np.arange(n) + 1) / (n + 1)
    np.testing.assert_allclose(sim.fields["u"], np.repeat(expected[:, None], n, 1), atol=1e-10)


def test_sponge_absorbs_most_and_never_grows():
    """A thick sponge reflects less than a hundredth of the pulse, and the energy only falls."""
    sponge, exact = simulation(boundary=fh.Sponge(nodes=40)), simulation()
    energies = []
    for t in (2, 6, 10, 20, 40):
        energies.append(sponge.run(t).energy())
        assert np.abs(sponge.fields["u"] - exact.run(t).fields["u"]).max() < 1e-2
    assert all(b <= a for a, b in itertools.pairwise(energies))


def test_window_hides_what_is_outside():
    lattice = fh.Lattice(0.25, window=fh.Disc(3.0))
    u = fh.Simulation(lattice, fh.Wave(KERNEL), initial={"u": pulse}).fields["u"]
    assert np.isnan(u[0, 0]) and np.isfinite(u[lattice.index((0, 0))])


def test_observers_are_called_at_each_interval():
    times = []
    simulation(observe=[lambda sim: times.append(sim.time)], dt=fh.WholeSteps(every=0.5)).run(2.2, every=0.5)
    np.testing.assert_allclose(times[:-1], [0.5, 1.0, 1.5, 2.0], rtol=1e-14)
    assert 2.2 <= times[-1] < 2.2 + 0.19  # the first step at or after the end


def test_an_end_in_the_past_is_refused():
    sim = simulation()
    for ask in (sim.run, sim.check):
        with pytest.raises(fh.InputError, match=r"run\.until: must be finite and not negative; value: -1; limit: >= 0"):
            ask(until=-1)
    with pytest.raises(fh.InputError, match=r"run\.until: must be a number; value: the text 'static'"):
        sim.check(until="static")
    steps = sim.run(until=2.0).step_count
    with pytest.raises(fh.InputError, match=r"run\.until: the run is already past this end; value: 1; limit: >= 2"):
        sim.run(until=1.0)
    with pytest.raises(fh.InputError, match=r"run\.limit: the run is already past this end; value: 1;"):
        sim.run(until="static", limit=1.0)
    assert sim.run(until=2.0).step_count == sim.run(until=sim.time).step_count == steps  # nothing is left to do


def test_guard_names_step_place_and_cause():
    """A value that turns into nan is found within one interval and located."""
    sim = simulation()
    sim.step(10)
    sim.engine.core.view(sim.engine.current)[0, 5, 5] = np.nan
    with pytest.raises(fh.UnstableError, match=r"unstable at step 11, .* near \["):
        sim.step()


def test_backward_waves_grow_and_the_program_says_so():
    """1D, p = 0, no damping: white noise grows in the layer at a rate below (growth of backward waves) x (largest
    sigma); check() warns.
    """
    lattice = fh.Lattice(0.1, -2, 2)
    noise = np.random.default_rng(0).standard_normal(lattice.shape)
    layer = fh.LatticePML(nodes=20, profile={"sigma": np.linspace(1.0, 30.0, 21), "alpha": 0.01})
    sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(0.3, 0)), layer, {"u": noise})
    assert any("backward" in w for w in sim.check().warnings)
    sim.run(3.0, allow_unstable=True)
    one = np.linalg.norm(sim.engine.levels)
    sim.run(11.0, allow_unstable=True)
    rate = np.log(np.linalg.norm(sim.engine.levels) / one) / 8.0
    sigma = max(layer.sigma.max() for layer in sim.engine.layers.values())
    assert 0 < rate < sim.stencil.backward_waves().growth * sigma


@pytest.mark.parametrize("dim, n", [(1, 20_000), (2, 400), (3, 40)])
def test_the_memory_estimate_is_that_of_the_set_up(dim, n):
    """The estimate by which set-ups are refused, against the traced peak; without the tables of a small layout and
    Python's own memory.
    """
    lattice = fh.Lattice(0.25, (0.0,) * dim, ((n - 1) * 0.25,) * dim)
    u = lambda *x: np.exp(-4 * sum((a - n / 8) ** 2 for a in x))  # noqa: E731
    fh.Simulation(lattice, fh.Wave(KERNEL), initial={"u": u}, threads=1).step(1)
    tracemalloc.start()
    sim = fh.Simulation(lattice, fh.Wave(KERNEL), initial={"u": u}, threads=1)
    sim.step(1)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # an estimate: data and sources of many terms need more, none less
    assert 0.5 < memory_needed(sim.setup, sim.stencil, sim.parts.layered) / peak < 2


BAD = [
    ({"dt": 1.0}, "above the stable limit"),
    ({"dt": -1.0}, "positive"),
    ({"dt": float("nan")}, "positive"),
    ({"dtype": "float16"}, "number type"),
    ({"threads": 0}, "threads"),
    ({"background": float("inf")}, "background"),
    ({"initial": {"w": 1.0}}, "unknown initial field"),
    ({"initial": {"u": np.ones((3, 3))}}, "shape"),
    ({"initial": {"u": np.full(LATTICE.shape, np.nan)}}, "finite"),
    ({"initial": {"u": lambda x, y: np.exp(-0.1 * (x**2 + y**2))}}, "not zero beyond"),
    ({"initial": {"u": 2.0}}, "not zero beyond"),
    ({"model": fh.Wave(fh.Kernel(0.1))}, "horizon is smaller"),
    ({"lattice": fh.Lattice(0.25, (0, 0), (1, 5))}, "thinner than the stencil"),
    ({"lattice": fh.Lattice(1e-5, (0, 0), (3, 3)), "model": fh.Wave(fh.Stencil.finite_difference(2))}, "memory"),
    ({"model": fh.Wave(fh.Kernel(100.0))}, "spans too many nodes"),
    (
        {"lattice": fh.Lattice(0.25, (0, 0), (40_000, 40_000)), "model": fh.Wave(KERNEL)},
        "memory; value: about .* GiB for 25600320001 nodes",
    ),
    ({"cracks": [[(-5, 0.1), (5, 1.1)]]}, "across the absorbing side"),
    ({"cracks": [[(-5, 0.1), (-3.1, 0.1)]]}, "across the absorbing side"),
    ({"cracks": [[(-5, 0.1), (5, 1.1)]], "boundary": fh.Periodic()}, "cannot continue it"),
    ({"coefficient": -np.ones(LATTICE.shape)}, "negative"),
    ({"coefficient": 0.0}, r"coefficient: the coefficient is zero everywhere"),
    ({"coefficient": 5e-324}, r"coefficient: is beyond what can be computed with"),
    ({"coefficient": 0.0, "model": fh.Diffusion(KERNEL)}, r"coefficient: the coefficient is zero everywhere"),
    (
        {"model": fh.Wave(fh.Stencil([[1, 0], [-1, 0]], [-1.0, -1.0]))},
        r"model\.operator: no weight of the stencil is positive.*value: weights from -1 to -1; limit: > 0",
    ),
    (
        {"dtype": "float32", "initial": {"u": "1e-60*exp(-9*(x**2 + y**2))"}},
        r"initial\.u: .* single precision: .*vanish; value: 1e-60; limit: 1e-15 to 1e\+15; remedy: other units",
    ),
    ({"dtype": "float32", "initial": {"v": "1e25*exp(-9*(x**2 + y**2))"}}, r"initial\.v: .*overflow; value: 1e\+25"),
    ({"dtype": "float32", "initial": {"u": "1e39*exp(-9*(x**2 + y**2))"}}, r"initial\.u: .*overflow; value: 1e\+39"),
    ({"dtype": np.float16}, "unknown number type; value: float16"),
    ({"rule": "geometric"}, "bond rule"),
    ({"rim": "clamped"}, "unknown surface"),
    ({"rim": "fixed"}, "only a body has a surface"),
    ({"boundary": {"x": fh.LatticePML()}}, "no boundary given"),
    ({"boundary": {"all": fh.LatticePML(), "w": fh.Free()}}, "unknown side"),
    ({"boundary": {"all": fh.LatticePML(), "x-": fh.Periodic()}}, "both sides"),
    ({"boundary": {"x": fh.Fixed(1.0), "y": fh.LatticePML()}}, "background"),
]


@pytest.mark.parametrize("scale", [1e-15, 1e15])
def test_energies_in_single_precision_to_the_ends_of_its_range(scale):
    """Relative to the squared amplitude, the energy is the same up to rounding."""
    energies = [
        simulation(dtype="float32", initial={"u": f"{size}*exp(-9*(x**2 + y**2))"}).run(1.0).energy() / size**2
        for size in (1.0, scale)
    ]
    assert energies[1] == pytest.approx(energies[0], rel=1e-4)


@pytest.mark.parametrize("changes, message", BAD)
def test_bad_input_is_refused_before_any_work(changes, message):
    with pytest.raises(fh.InputError, match=message):
        if "lattice" in changes and "memory" in message:
            fh.Simulation(**changes)
        simulation(**changes)


def test_what_a_notebook_shows():
    sim = fh.Simulation(
        fh.Lattice(1.0, (-9.0, -4.0), (9.0, 4.0)), fh.Wave(fh.Kernel(2.0)), fh.Fixed(), dt=0.25, threads=1
    )
    assert repr(sim.run(until=2.0)) == "<Simulation on 19 x 9 nodes at t = 2, step 8>"


def test_another_model_has_a_step_and_layers_of_its_own():
    """A run remade with other sources keeps its step and layers; one with a faster medium has its own, as if new."""
    lattice, start = fh.Lattice(0.5, (-4.0, -4.0), (4.0, 4.0)), {"u": "exp(-3*(x**2 + y**2))"}
    sides = fh.LatticePML(target=1e-6, until=20.0)
    sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(1.0)), sides, start)
    assert sim.remade(sources=[fh.Source("exp(-x**2 - y**2)", "sin(t)")]).dt == sim.dt
    fast = fh.Wave(fh.Kernel(1.0), speed=4.0)
    made, new = sim.remade(model=fast), fh.Simulation(lattice, fast, sides, start)
    assert made.dt == new.dt < sim.dt
    made.run(20.0, progress=False)
    new.run(20.0, progress=False)
    np.testing.assert_allclose(made.fields["u"], new.fields["u"], rtol=0, atol=1e-14)


@pytest.mark.parametrize("material", ["bond-based", "state-based", "correspondence"])
@pytest.mark.parametrize("across", [fh.Fixed(), {"y-": fh.Free(), "y+": fh.Fixed()}])
def test_energy_of_a_periodic_strip_beside_a_fixed_side(material, across):
    """Nodes beyond the fixed side have states, also where the strip repeats itself."""
    rng = np.random.default_rng(3)
    shape = 14, 13
    start = {name: 0.01 * rng.standard_normal((2, *shape)) for name in ("u", "v")}
    ratio = {} if material == "bond-based" else {"poisson": 0.3}
    model = fh.Elastic(
        fh.Kernel(2.0, 1), young=rng.uniform(1.0, 1.5, shape), material=material, plane="stress", **ratio
    )
    sides = {"x": fh.Periodic(), **(across if isinstance(across, dict) else {"y": across})}
    cracks = [[(3.2, 4.1), (8.3, 7.2)]]
    sim = fh.Simulation(fh.Lattice(1.0, (0, 0), (13, 12)), model, sides, start, cracks=cracks, balance=True)
    sim.step(61)
    found = sim.balance()
    assert abs(found["lost"]) < 1e-12 * found["kinetic"]


@pytest.mark.parametrize("dim", [1, 2])
@pytest.mark.parametrize("side", [fh.Free(), fh.Periodic()])
def test_energy_beside_a_fixed_rim(dim, side):
    """Bonds to the outside of a body, where the field is fixed, count in full, as those to fixed sides do."""
    rng = np.random.default_rng(4)
    shape = (19,) * dim
    hole = np.ones(shape, bool)
    hole[(slice(6, 9),) * dim] = False
    hole[0] = False  # also where the lattice repeats itself
    lattice = fh.Lattice(1.0, (0.0,) * dim, (18.0,) * dim, body=hole)
    start = {"u": rng.standard_normal(shape), "v": rng.standard_normal(shape)}
    model = fh.Wave(fh.Kernel(2.0), speed=rng.uniform(1.0, 1.5, shape), density=rng.uniform(1.0, 1.5, shape))
    sim = fh.Simulation(lattice, model, side, start, rim="fixed")
    sim.step(1)
    first = sim.energy()
    sim.step(100)
    assert sim.energy() == pytest.approx(first, rel=1e-12)

"""Media with a reaction, Klein-Gordon waves and diffusion that decays, against exact solutions."""

import os

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.exact.chain import Recursion, half_weights, run_kernel, transform_kernel
from farhorizon.analysis.references.infinite_lattice import InfiniteLattice
from farhorizon.checks.run_cost import extended_run_cost
from farhorizon.medium.integrators import Euler, RungeKutta4, RungeKuttaChebyshev, Verlet
from farhorizon.studies.compare import compare
from helpers import dense_operator

SEED = int(os.environ.get("FARHORIZON_SEED", np.random.default_rng().integers(2**31)))


def massive(operator, speed=1.0, mass=0.5, damping=0.0):
    """Waves of the dispersion ``omega^2 = mass^2 + speed^2 k^2``."""
    model = fh.Wave(operator, speed, damping)
    model.reaction = mass**2
    return model


def decaying(operator, diffusivity=1.0, rate=0.5, integrator="euler"):
    """Diffusion that decays."""
    model = fh.Diffusion(operator, diffusivity, integrator)
    model.reaction = rate
    return model


def bell(width, *centre):
    def at(*x):
        return np.exp(-sum((a - c) ** 2 for a, c in zip(x, centre or (0.0,) * len(x), strict=True)) / width**2)

    return at


def box(half, dim=1, spacing=1.0):
    return fh.Lattice(spacing, (-half * spacing,) * dim, (half * spacing,) * dim)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("dim", [1, 2])
@pytest.mark.parametrize("reach", [1, 2])
def test_dispersion_of_a_plane_wave(dim, reach, dtype):
    """A plane wave in a periodic box follows the dispersion of the lattice, written out bond by bond."""
    speed, mass, spacing, n = 1.3, 0.7, 0.5, 16
    stencil = fh.Stencil.finite_difference(dim) if reach == 1 else fh.Stencil.from_kernel(fh.Kernel(1.0), spacing, dim)
    k = 2 * np.pi * np.array([3, 2][:dim]) / n
    bonds = sum(w * (1 - np.cos(o @ k)) for o, w in zip(stencil.offsets, stencil.weights, strict=True))
    lattice = fh.Lattice(spacing, (0.0,) * dim, ((n - 1) * spacing,) * dim)
    phase = sum(a * x / spacing for a, x in zip(k, lattice.coordinates(), strict=True))
    sim = fh.Simulation(lattice, massive(stencil, speed, mass), fh.Periodic(), {"u": np.cos(phase)}, dtype=dtype)
    sim.step(100)
    squared = mass**2 + (speed / spacing) ** 2 * bonds
    frequency = 2 / sim.dt * np.arcsin(np.sqrt(squared) * sim.dt / 2)  # of the Verlet scheme, exactly
    # rounding of 100 steps
    limit = {"float64": 1e-12, "float32": 1e-5}[dtype]
    assert np.abs(sim.fields["u"] - np.cos(frequency * sim.time) * np.cos(phase)).max() < limit


@pytest.mark.parametrize("integrator", [Euler(), RungeKutta4(), RungeKuttaChebyshev(5)])
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_a_uniform_field_decays(integrator, dtype):
    """The coefficient does not matter, because it applies to the bonds."""
    rate, varied = 0.3, 1 + np.arange(9) / 8
    model = decaying(fh.Kernel(2.0), 0.1, rate, integrator)
    sim = fh.Simulation(
        box(4), model, fh.Periodic(), {"u": 3.0}, background=2.0, coefficient=varied, dt=0.5, dtype=dtype, balance=True
    )
    sim.step(10)
    # the step of each method for u' = -rate u
    z = -0.5 * rate
    by = {"forward Euler": 1 + z, "Runge-Kutta 4": 1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24}
    factor = by.get(integrator.name, float(integrator.growth(np.array(rate), 0.5)))
    assert sim.fields["u"] == pytest.approx(2 + factor**10, abs=1e-13 if dtype == "float64" else 1e-5)
    found = sim.balance()
    assert found["stored"] == pytest.approx(9 * (factor**10 - 1), rel=1e-6)
    if dtype == "float64":
        assert found["reaction"] == pytest.approx(found["stored"], rel=1e-12)
        assert abs(found["residual"]) < 1e-12
    if integrator.name == "Runge-Kutta-Chebyshev":  # of second order
        assert factor == pytest.approx(np.exp(z), abs=abs(z) ** 3)


@pytest.mark.parametrize("integrator", ["euler", "rk4", "rkc"])
def test_balance_with_open_sides_and_a_source(integrator):
    sim = fh.Simulation(
        box(12, 2),
        decaying(fh.Kernel(2.0), 1.0, 0.2, integrator),
        fh.LatticePML(target=1e-4, until=10.0),
        sources=[fh.Source(bell(2.0, 1.0, 0.0), lambda t: np.exp(-t))],
        balance=True,
        dt=0.1,
    )
    taken = 0.0
    for _ in range(50):
        before = sim.fields["u"].sum()
        sim.step(1)
        taken += 0.2 * sim.dt * (before if integrator == "euler" else (before + sim.fields["u"].sum()) / 2)
    found = sim.balance()
    assert abs(found["residual"]) < 1e-12 * found["source[0]"]
    # for the other integrators the trapezoidal rule errs by dt^2 / 12
    assert -found["reaction"] == pytest.approx(taken, rel=1e-11 if integrator == "euler" else 2e-3)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("dim", [1, 2])
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_layers_against_the_infinite_lattice(dim, dtype):
    """The layer is exact for the reaction, which is local: 16 nodes are as good as without it."""
    setup = {"lattice": box(15, dim), "model": massive(fh.Kernel(2.0), 1.0, 0.3), "boundary": fh.LatticePML(nodes=16)}
    found = compare({**setup, "initial": {"u": bell(3.0)}, "dtype": dtype}, 60.0, beside=False)
    assert found.curves["lattice PML"]["error_max_over_run"] < (1e-8 if dtype == "float64" else 1e-4)


def test_a_wave_of_vectors_on_a_foundation():
    model = fh.Elastic(fh.Kernel(2.0, exponent=1), young=1.0, density=1.0)
    model.reaction = 0.2
    pulse = {"u": np.stack([bell(3.0)(*box(12, 2).coordinates()), np.zeros((25, 25))])}
    sim = fh.Simulation(box(12, 2), model, fh.LatticePML(nodes=20), pulse)
    infinite = InfiniteLattice(sim.stencil, model.coefficient, sim.model.integrator, sim.dt, 150, pulse["u"])
    sim.step(150)
    assert np.abs(sim.fields["u"] - infinite.after(150)).max() < 1e-4  # of the layer itself, see docs/limits.md
    assert sim.fields["u"].shape == (2, 25, 25)
    twin = fh.Simulation(box(12, 2), model, fh.Periodic(), {"u": [1.0, 1.0]})
    twin.step(40)
    frequency = 2 / twin.dt * np.arcsin(np.sqrt(0.2) * twin.dt / 2)
    assert twin.fields["u"] == pytest.approx(np.cos(frequency * twin.time), abs=1e-12)


def test_bonds_that_may_break_stand_on_it_too():
    model = fh.Elastic(fh.Kernel(2.0, exponent=1), young=1.0, density=2.0, critical_stretch=0.5)
    model.reaction = 0.2
    pulse = [lambda x, y: 0.05 * bell(2.0)(x, y), 0.0]
    sim = fh.Simulation(box(9, 2), model, fh.Free(), {"u": pulse})
    sim.step(1)
    first = sim.energy()
    sim.step(200)
    assert sim.energy() == pytest.approx(first, rel=1e-12) and sim.energies()["reaction"] > 0


@pytest.mark.parametrize("order", [1, 2])
def test_exact_ends_against_a_longer_bar(order):
    """With a wide stencil, and a coefficient that differs from end to end but does not affect the reaction."""
    kernel, make = fh.Kernel(3.0, exponent=1), massive if order == 2 else decaying
    factor = np.where(np.arange(41) < 20, 0.25, 1.0)
    more = np.pad(factor, 100, mode="edge")
    start = {"u": bell(3.0)}
    sim = fh.Simulation(box(20), make(kernel), fh.Exact(), start, coefficient=factor)
    bar = fh.Simulation(box(120), make(kernel), fh.Fixed(), start, coefficient=more, dt=sim.dt)
    for one in (sim, bar):
        one.step(60 if order == 2 else 100)
    assert np.abs(sim.fields["u"] - bar.fields["u"][100:-100]).max() < 1e-11


def test_both_kernels_of_exact_ends_agree():
    stencil = fh.Stencil.from_kernel(fh.Kernel(2.0), 1.0, 1)
    for scheme, dt in ((Verlet(), 0.5), (Euler(), 0.2)):
        recursion = Recursion.of(scheme, dt, reaction=0.3)
        kernels = [make(half_weights(stencil), recursion, 400) for make in (run_kernel, transform_kernel)]
        assert np.abs(kernels[0] - kernels[1]).max() < 1e-12


@pytest.mark.parametrize("order", [1, 2])
def test_step_limit(order):
    """From the largest eigenvalue of the matrix: below the limit the scheme is bounded, above it it grows."""
    rng = np.random.default_rng(SEED)
    print("seed", SEED)
    stencil = fh.Stencil.from_kernel(fh.Kernel(2.0), 1.0, 2)
    mass = float(rng.uniform(0.1, 3))
    model = massive(stencil, 1.5, mass) if order == 2 else decaying(stencil, 2.25, mass**2)
    sim = fh.Simulation(fh.Lattice(1.0, (0, 0), (7, 7)), model, fh.Periodic())
    highest = 2.25 * (stencil.symbol_maximum) + mass**2
    assert sim.step_limit == pytest.approx(2 / np.sqrt(highest) if order == 2 else 2 / highest, rel=1e-12)
    matrix = dense_operator((8, 8), stencil.offsets, 2.25 * stencil.weights) - mass**2 * np.eye(64)
    largest = np.linalg.eigvalsh(-matrix).max()  # with free ends, a little smaller
    limit = 2 / np.sqrt(largest) if order == 2 else 2 / largest
    assert sim.step_limit <= limit * (1 + 1e-12)
    sizes = []
    for share in (0.999, 1.01):
        dt, u = share * limit, rng.standard_normal(64)
        old = u.copy()
        for _ in range(2000):
            u, old = (2 * u - old + dt**2 * matrix @ u, u) if order == 2 else (u + dt * matrix @ u, u)
        sizes.append(np.abs(u).max())
    assert sizes[0] < 1e3 and sizes[1] > 1e6
    with pytest.raises(fh.InputError, match=r"above the stable limit"):
        fh.Simulation(fh.Lattice(1.0, (0, 0), (7, 7)), model, fh.Periodic(), dt=1.01 * sim.step_limit)


def test_a_step_just_below_the_limit_is_stable():
    noise = np.random.default_rng(0).standard_normal(41)
    model = massive(fh.Kernel(3.0), 2.0, 1.5)
    limit = fh.Simulation(box(20), model, fh.Periodic()).step_limit
    sim = fh.Simulation(box(20), model, fh.Periodic(), {"u": noise}, dt=0.999 * limit)
    sim.step(20000)
    assert np.abs(sim.fields["u"]).max() < 200 * np.abs(noise).max()  # at 0.999 the shortest wave swings 1/sin(..) = 22


def test_static_decay_of_a_line_source():
    """``D L u - k u + s = 0`` for a source of one node: ``u = s exp(-kappa |x|) / sqrt(k^2 + 4 k D)``."""
    rate, diffusivity = 0.05, 1.0
    source = np.zeros(61)
    source[30] = 1.0
    sim = fh.Simulation(
        box(30), decaying(fh.Stencil.finite_difference(1), diffusivity, rate), fh.LatticePML(), sources=[source]
    )
    sim.run(until=600.0)  # exp(-30) of the start remains
    kappa = 2 * np.arcsinh(np.sqrt(rate / diffusivity) / 2)
    exact = np.exp(-kappa * np.abs(np.arange(-30, 31))) / np.sqrt(rate**2 + 4 * rate * diffusivity)
    assert np.abs(sim.fields["u"] - exact).max() < 1e-5 * exact.max()  # the target of layers by default


@pytest.mark.parametrize("varies", ["speed", "density"])
def test_strength_does_not_depend_on_which_medium_fills_more_of_the_lattice(varies):
    """The reaction of a stencil is in units of its bonds, of which there would be two; that of a model is not, but
    it needs one density.
    """
    parts, stencil = np.where(np.arange(17) < 8, 1.0, 2.0), fh.Stencil.finite_difference(1).with_reaction(0.25)
    with pytest.raises(fh.InputError, match=rf"no definite strength.*{'density' if varies == 'density' else 'stiff'}"):
        fh.Simulation(box(8), fh.Wave(stencil, **{varies: parts}), fh.Free(), {"u": 1.0})
    model = fh.Wave(fh.Stencil.finite_difference(1), **{varies: parts})
    model.reaction = 0.25
    if varies == "density":
        with pytest.raises(fh.InputError, match=r"no definite strength.*density"):
            fh.Simulation(box(8), model, fh.Free(), {"u": 1.0})
        return
    sim = fh.Simulation(box(8), model, fh.Free(), {"u": 1.0})
    sim.step(3)
    assert np.ptp(sim.fields["u"]) < 1e-14  # the same at all nodes
    uniform = fh.Wave(stencil, speed=np.full(17, 2.0))
    assert fh.Simulation(box(8), uniform, fh.Free()).engine.reaction == pytest.approx(1.0)


@pytest.mark.parametrize("side", [fh.Fixed(), fh.Free(), fh.Periodic()])
@pytest.mark.parametrize("dim", [1, 2])
def test_energy_of_a_closed_box(side, dim):
    rng = np.random.default_rng(1)
    shape = (17,) * dim
    sim = fh.Simulation(
        box(8, dim), massive(fh.Kernel(2.0)), side, {"u": bell(2.0), "v": rng.standard_normal(shape)},
        coefficient=rng.uniform(0.3, 1.0, shape),
    )  # fmt: skip
    sim.step(1)
    first = sim.energies()
    sim.step(500)
    assert sim.energy() == pytest.approx(sum(first.values()), rel=1e-12)
    assert 0 < sim.energies()["reaction"] != first["reaction"]
    assert sim.certificate().verdict == "certified"


def test_layers_are_certified():
    assert fh.Simulation(box(10), massive(fh.Kernel(2.0)), fh.LatticePML(nodes=8)).certificate().verdict == "certified"
    plane = fh.Simulation(box(5, 2), massive(fh.Stencil.finite_difference(2)), fh.LatticePML(nodes=4))
    assert plane.certificate(60.0).verdict == "certified"


def test_convergence_to_the_continuum():
    """Second-order convergence to the Fourier integral of ``u_tt = u_xx - m^2 u``."""
    mass, time = 1.5, 4.0
    k = np.linspace(-30, 30, 6001)
    errors = []
    for spacing in (0.2, 0.1, 0.05):
        lattice = fh.Lattice(spacing, -9, 9)  # so wide that nothing returns from its ends
        (x,) = lattice.coordinates()
        sim = fh.Simulation(
            lattice, massive(fh.Stencil.finite_difference(1), 1.0, mass), fh.Free(), {"u": bell(0.7)}, dt=0.5 * spacing
        )
        sim.run(until=time)
        start = 0.7 * np.sqrt(np.pi) * np.exp(-((0.7 * k) ** 2) / 4)
        exact = (start * np.cos(np.sqrt(k**2 + mass**2) * time) * np.cos(np.outer(x, k))).sum(1) * 0.01 / (2 * np.pi)
        errors.append(np.abs(sim.fields["u"] - exact).max())
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (np.abs(rates - 2) < 0.15).all(), (errors, rates)


def test_a_coefficient_is_one_of_the_bonds():
    """A medium of a quarter of the squared speed equals one of half the speed and the same mass, also in the layers."""
    start, layer = {"u": bell(3.0)}, fh.LatticePML(target=1e-6, until=60.0)
    slow = fh.Simulation(box(15), massive(fh.Kernel(2.0), 0.5, 0.4), layer, start)
    weak = fh.Simulation(
        box(15), massive(fh.Kernel(2.0), 1.0, 0.4), layer, start, coefficient=np.full(31, 0.25), dt=slow.dt
    )
    assert weak.step_limit == pytest.approx(slow.step_limit, rel=1e-12)
    for one in (slow, weak):
        one.run(until=60.0)
    for side, layer in slow.engine.layers.items():
        assert weak.engine.layers[side].sigma == pytest.approx(layer.sigma, rel=1e-9)
    assert weak.fields["u"] == pytest.approx(slow.fields["u"], abs=1e-12)
    assert weak.remade(lattice=box(9)).stencil == slow.stencil


def test_wide_domains_and_prices():
    """The width of extended sides, and their price, depend on the largest group speed, which a mass lowers."""
    model, start = massive(fh.Kernel(2.0), 1.0, 0.4), {"u": bell(3.0)}
    wide = fh.Simulation(box(15), model, fh.Extended(target=1e-8, until=60.0), start)
    wide.prepare(60.0)
    infinite = InfiniteLattice(wide.stencil, 1.0, model.integrator, wide.dt, 400, wide.start_u)
    steps = int(60 / wide.dt)
    wide.step(steps)
    assert np.abs(wide.fields["u"] - infinite.after(steps)).max() < 1e-8
    sim = fh.Simulation(box(15), model, fh.LatticePML(target=1e-8, until=60.0), start)
    assert extended_run_cost(sim, 60.0, [(0, -1), (0, 1)]).nodes <= 31 + 2 * 60


def driven(rng, dim):
    """A set-up with a random mass, and the length of its run."""
    half, spacing, speed = int(rng.integers(10, 22)), 10 ** rng.uniform(-1, 1), 10 ** rng.uniform(-1, 1)
    unit = speed / spacing
    mass, until = unit * 10 ** rng.uniform(-2, 0.5), rng.uniform(1, 6) * 2 * half / unit
    operator = (fh.Stencil.finite_difference(dim), fh.Kernel(2 * spacing))[rng.integers(2)]
    place = rng.uniform(0, 0.4) * half * spacing
    shape = bell(rng.uniform(2.0, 3.0) * spacing, place, *[0.0] * (dim - 1))
    swing = mass * rng.choice([0.0, 1.0, rng.uniform(0.5, 2.0)])  # at rest, at the cut-off, around it
    start = {"initial": {"u": shape}} if rng.random() < 0.3 else {}
    source = {} if start else {"sources": [fh.Source(shape, lambda t: np.cos(swing * t))]}
    return {"lattice": box(half, dim, spacing), "model": massive(operator, speed, mass), **start, **source}, until


def check_layers(seed, dim, count, first=0):
    """For arbitrarily slow waves the layers keep their targets, and the default one; `count` set-ups of a seed, from
    number `first` on.
    """
    rng = np.random.default_rng(seed)
    print("seed", seed)
    for setup, until in [driven(rng, dim) for _ in range(first + count)][first:]:
        for target in (None, 1e-4):
            layer = fh.LatticePML(target=target, until=until)
            try:
                found = compare({**setup, "boundary": layer}, until, beside=False)
            except fh.InputError as error:
                assert "not zero beyond" in str(error)
                continue
            error = found.curves["lattice PML"]["error_max_over_run"] / found.initial
            assert error < (target or 1e-5), (setup, until)


def test_layers_keep_their_targets():
    check_layers(SEED, 1, 3)


@pytest.mark.parametrize(("seed", "number"), [(2123085838, 0), (777002, 568), (777002, 993), (777002, 1187)])
def test_layers_keep_targets_that_were_missed(seed, number):
    """Targets were missed when layers started before the run, and when they ignored how sources vary in time."""
    check_layers(seed, 1, 1, number)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [777002, 777003])
def test_layers_keep_their_targets_on_a_line(seed):
    check_layers(seed, 1, 900)


@pytest.mark.slow
@pytest.mark.parametrize("dim", [1, 2])
@pytest.mark.parametrize("seed", [11, 12])
def test_layers_keep_their_targets_of_many(dim, seed):
    check_layers(seed, dim, 25 if dim == 1 else 12)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [21, 22])
def test_layers_of_diffusion_that_decays(seed):
    rng = np.random.default_rng(seed)
    for _ in range(20):
        half = int(rng.integers(10, 25))
        rate = 10 ** rng.uniform(-4, 0)
        model = decaying(fh.Stencil.finite_difference(1), 1.0, rate)
        start = {"initial": {"u": bell(2.0)}} if rng.random() < 0.5 else {"sources": [bell(2.0)]}
        until = rng.uniform(0.3, 3) * half**2
        found = compare({"lattice": box(half), "model": model, "boundary": fh.LatticePML(), **start}, until)
        assert max(found.curves["lattice PML"]["error_rel_current"]) < 1e-5, (rate, half, start, until)


def test_what_does_not_know_it_refuses():
    model, lattice = massive(fh.Kernel(2.0)), box(8, 2)
    for boundary in (fh.PlaneWave(), fh.Higdon(angles=(0, 45)), fh.FirstOrder()):
        with pytest.raises(fh.InputError, match=r"does not support media with a reaction.*LatticePML"):
            fh.Simulation(lattice, model, boundary)
    wave = fh.IncidentWave((1.0, 0.0), lambda t: np.exp(-((t - 6) ** 2)), 12.0)
    with pytest.raises(fh.InputError, match=r"without a reaction"):
        fh.Simulation(lattice, model, fh.LatticePML(), sources=[wave])
    stencil = fh.Stencil.finite_difference(2).with_reaction(0.5)
    with pytest.raises(fh.InputError, match=r"metal that dissolves has no reaction"):
        fh.Simulation(lattice, fh.Corrosion(stencil, saturation=0.5), fh.Fixed())
    for bad in (np.nan, "heavy"):
        with pytest.raises(fh.InputError, match=r"reaction"):
            fh.Stencil([[1], [-1]], [1, 1], bad)
        model.reaction = bad
        with pytest.raises(fh.InputError, match=r"model.reaction"):
            fh.Simulation(lattice, model, fh.Fixed())


def test_a_stencil_brings_its_own():
    """In units of its bonds, and in addition to that of the model."""
    stencil = fh.Stencil.finite_difference(1).with_reaction(0.25)
    sim = fh.Simulation(box(8), fh.Wave(stencil, speed=2.0), fh.Periodic(), {"u": 1.0})
    assert sim.engine.reaction == 0.25 * 2.0**2
    both = fh.Simulation(box(8), massive(stencil, 2.0, 1.0), fh.Periodic())
    assert both.engine.reaction == pytest.approx(2.0)
    assert stencil != stencil.with_reaction(0.5) and stencil.along(0) == stencil and "reaction=0.25" in repr(stencil)
    assert float(stencil.symbol(0.0)) == 0.25 and stencil.symbol_maximum == pytest.approx(4.25)


# --- growth ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("integrator", ["euler", "rk4", RungeKuttaChebyshev(5)], ids=str)
def test_a_negative_reaction_is_growth(integrator):
    """White noise in a box, by the modes of its matrix: the long ones grow, the others decay; the balance says from
    what.
    """
    rng, lattice, rate = np.random.default_rng(SEED), fh.Lattice(1.0, (0.0, 0.0), (7.0, 6.0)), 0.7
    print(f"seed {SEED}")
    u = rng.standard_normal(lattice.shape)
    model = decaying(fh.Kernel(2.0), 1.3, -rate, integrator)
    sim = fh.Simulation(lattice, model, fh.Free(), {"u": u}, balance=True)
    stencil = fh.Diffusion(fh.Kernel(2.0)).stencil(1.0, 2)
    rates, modes = np.linalg.eigh(-1.3 * dense_operator(lattice.shape, stencil.offsets, stencil.weights))
    growth = model.integrator.growth(rates - rate, sim.dt)
    assert growth[0] > 1 > growth[-1] and sim.growth == pytest.approx(rate)
    sim.step(60)
    expected = (modes @ (growth**60 * (modes.T @ u.ravel()))).reshape(lattice.shape)
    np.testing.assert_allclose(sim.fields["u"], expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    found = sim.balance()
    assert found["reaction"] == pytest.approx(found["stored"], rel=1e-11)


def test_waves_of_an_imaginary_mass_grow():
    """Those longer than ``2 pi speed / mass``; each by the scheme's own factor, to the finite time step."""
    lattice, mass, n = fh.Lattice(1.0, 0.0, 31.0), 0.4, 32
    model = fh.Wave(fh.Stencil.finite_difference(1).with_reaction(-(mass**2)))
    for waves, grows in ((1, True), (3, False)):
        mode = np.cos(2 * np.pi * waves * np.arange(n) / n)
        sim = fh.Simulation(lattice, model, fh.Periodic(), {"u": mode})
        squared = 4 * np.sin(np.pi * waves / n) ** 2 - mass**2
        sim.step(80)
        expected = np.cosh(80 * 2 * np.arcsinh(sim.dt / 2 * np.sqrt(abs(squared)))) if grows else None
        if grows:
            np.testing.assert_allclose(sim.fields["u"], expected * mode, rtol=0, atol=1e-11 * expected)
        assert (np.abs(sim.fields["u"]).max() > 2) == grows


@pytest.mark.parametrize("order", [1, 2])
def test_growth_of_the_medium_is_no_instability(order):
    """The certificate leaves it out, a note says so, and a run goes on for as long as numbers are finite."""
    stencil = fh.Kernel(2.0)
    model = decaying(stencil, rate=-1.0) if order == 1 else massive(stencil)
    model.reaction = -1.0
    sim = fh.Simulation(box(9, 2), model, {"x": fh.Free(), "y": fh.Fixed()}, {"u": bell(2.0)})
    found = sim.certificate()
    assert (
        found.verdict == "certified" and "apart from the growth of the medium itself, 1 per unit time" in found.reason
    )
    assert any("the medium grows by itself, e-fold in t = 1" in note for note in sim.notes)
    sim.run(until=80.0, progress=False)  # a factor of e^80 in a medium without ends
    assert 1e25 < np.abs(sim.fields["u"]).max() < np.inf
    sim.engine.current[:] *= 1e40
    with pytest.raises(fh.UnstableError):
        sim.run(until=81.0, progress=False)


def test_with_held_nodes_the_modes_without_growth_are_examined():
    model = decaying(fh.Kernel(2.0), rate=-0.5)
    sim = fh.Simulation(box(9, 2), model, fh.Free(), {"u": 0.0}, constraints=[fh.Temperature("x-", 1.0)])
    assert sim.certificate().verdict == "certified"


def test_a_step_just_below_the_limit_of_growth_is_stable():
    """The largest rate is at least the growth, which Euler's method then follows to a factor below 3."""
    model = decaying(fh.Kernel(2.0), rate=-30.0)
    sim = fh.Simulation(box(9, 1), model, fh.Periodic(), {"u": 1.0})
    assert sim.step_limit < 2 / 30.0
    sim.step()
    np.testing.assert_allclose(sim.fields["u"], 1 + 30 * sim.dt, rtol=1e-13)


@pytest.mark.parametrize("side", [fh.LatticePML(nodes=5), fh.Extended(nodes=20), fh.Sponge(), fh.Auto(), fh.Exact()])
def test_no_side_absorbs_in_a_medium_that_grows(side):
    model, dim = decaying(fh.Kernel(2.0), rate=-0.5), 1 if isinstance(side, fh.Exact) else 2
    with pytest.raises(fh.InputError, match=r"grows.*value: reaction -0.5; limit: .*remedy: Fixed, Free or Periodic"):
        fh.Simulation(box(9, dim), model, {"all": fh.Free(), "x-": side} if dim > 1 else side)


def test_check_tells_the_waves_of_a_source_in_a_medium_that_grows():
    """The longest do not oscillate: they have no frequency."""
    model, source = massive(fh.Kernel(2.0)), fh.PointSource((0.0,), time=fh.Ricker(0.1))
    model.reaction = -0.3
    held = fh.Prescribed([(3.0,), (4.0,)], "sin(t)")
    sim = fh.Simulation(box(15), model, fh.Free(), sources=[source], constraints=[held])
    with np.errstate(all="raise"):
        assert "wavelengths" in str(sim.check(until=30.0))


def test_vectors_have_no_growth():
    model = fh.Elastic(fh.Kernel(2.0), 1.0)
    model.reaction = -0.5
    with pytest.raises(fh.InputError, match=r"model.reaction"):
        fh.Simulation(box(9, 2), model, fh.Free())

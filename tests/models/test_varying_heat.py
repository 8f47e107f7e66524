"""Heat and diffusion in media whose constants vary from node to node, against dense matrices and layered slabs."""

import os

import numpy as np
import pytest
from scipy.optimize import brentq

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.simulation.assembly import shared, survey
from farhorizon.simulation.setup.stiffening import largest_rate
from farhorizon.studies.compare import compare
from helpers import RULES, dense_operator, fitted_rate
from threads_as_processes import on_threads

SEED = int(os.environ.get("FARHORIZON_SEED", np.random.default_rng().integers(2**31)))
INTEGRATORS = ["euler", "rk4", fh.RungeKuttaChebyshev(5), fh.RungeKuttaChebyshev(6)]


@pytest.fixture
def rng():
    print(f"seed {SEED}")
    return np.random.default_rng(SEED)


def random_constants(rng, shape):
    """Density, specific heat and conductivity over more than a decade."""
    return np.exp(rng.uniform(-1.5, 1.5, (3, *shape)))


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("integrator", INTEGRATORS, ids=str)
def test_steps_are_those_of_a_dense_matrix(integrator, rule, rng):
    """A block with free sides, one of which loses heat: the growth of each mode of the matrix, for any integrator."""
    lattice = fh.Lattice(0.5, (0.0, 0.0), (3.5, 3.0))
    density, specific, conductivity = random_constants(rng, lattice.shape)
    model = fh.Heat(fh.Kernel(1.0), density, specific, conductivity, integrator)
    u, transfer = rng.standard_normal(lattice.shape), 0.3
    surface = fh.Convection("x+", transfer)
    sim = fh.Simulation(lattice, model, fh.Free(), {"u": u}, rule=rule, constraints=[surface])
    stencil = fh.Heat(fh.Kernel(1.0)).stencil(0.5, 2)
    matrix = dense_operator(lattice.shape, stencil.offsets, stencil.weights / 0.5**2, None, conductivity, rule)
    lost = np.zeros(lattice.shape)
    lost[-1] = transfer / 0.5
    root = np.sqrt(density * specific).ravel()
    rates, modes = np.linalg.eigh((matrix - np.diag(lost.ravel())) / root / root[:, None])
    growth = model.integrator.growth(-rates, sim.dt)
    for _ in range(4):
        u = (modes @ (growth * (modes.T @ (root * u.ravel()))) / root).reshape(lattice.shape)
        sim.step()
        np.testing.assert_allclose(sim.fields["u"], u, rtol=0, atol=1e-12)
    assert sim.rate_limit >= -rates.min() * (1 - 1e-12)


@pytest.mark.parametrize("integrator", INTEGRATORS, ids=str)
@pytest.mark.parametrize("side", [fh.LatticePML(nodes=6), fh.Fixed(), fh.Free(), fh.Sponge(nodes=8)], ids=repr)
def test_balance_to_rounding(side, integrator, rng):
    """Heat from a source, from a fluid and through every other side, in random media."""
    lattice = fh.Lattice(1.0, (0.0, 0.0), (12.0, 9.0))
    constants = random_constants(rng, lattice.shape)
    u = np.zeros(lattice.shape)
    u[5:8, 4:6] = rng.standard_normal((3, 2))
    source = fh.Source("where(abs(x - 6) < 2, 1, 0)*where(abs(y - 5) < 2, 1, 0)", lambda t: np.cos(t))
    sim = fh.Simulation(
        lattice,
        fh.Heat(fh.Kernel(2.0), *constants, integrator),
        {"x-": side, "x+": fh.Free(), "y": fh.Free()},
        {"u": u},
        sources=[source],
        constraints=[fh.Convection("x+", 0.7, 2.0)],
        balance=True,
    )
    sim.step(30)
    found = sim.balance()
    stored = (constants[0] * constants[1] * (sim.fields["u"] - u)).sum()
    size = sum(abs(value) for value in found.values())
    assert found["stored"] == pytest.approx(stored, abs=1e-12 * size)
    assert abs(found["residual"]) < 1e-13 * size


def test_noise_decays_below_the_limit_of_the_step(rng):
    """The limit holds for any constants, and is at most 6.25 times below that of the matrix, as for waves."""
    lattice = fh.Lattice(1.0, (0.0, 0.0), (15.0, 12.0))
    constants, u = random_constants(rng, lattice.shape), rng.standard_normal(lattice.shape)
    model, sides = fh.Heat(fh.Kernel(2.0), *constants), {"x": fh.Free(), "y": fh.Periodic()}
    limit = fh.Simulation(lattice, model, sides, {"u": u}).step_limit
    sim = fh.Simulation(lattice, model, sides, {"u": u}, dt=0.999 * limit)
    weight = constants[0] * constants[1]
    norms = [(weight * u**2).sum()]
    for _ in range(20):
        sim.step(10)
        norms.append((weight * sim.fields["u"] ** 2).sum())
    assert (np.diff(norms) < 0).all()
    largest = largest_rate(sim.parts.grid, sim.team)
    assert (1 - 1e-9) * largest < sim.rate_limit < 6.25 * largest


def test_each_of_two_processes_finds_the_limit_of_the_whole(rng):
    """The heat lost through a side counts at the nodes of least capacity."""
    lattice = fh.Lattice(1.0, (0.0, 0.0), (15.0, 12.0))
    model, surface = fh.Heat(fh.Kernel(2.0), *random_constants(rng, lattice.shape)), fh.Convection("x+", 50.0)
    sim = fh.Simulation(lattice, model, fh.Free(), {"u": 0.0}, constraints=[surface])

    def limit(team):
        share, _ = shared(sim.setup, team, None)
        return survey(share.setup, 1.0, team, share).near.rate_limit

    assert on_threads(2, limit) == pytest.approx([sim.rate_limit] * 2, rel=1e-12)


def slab_modes(a, conductivity, capacity, count):
    """Decay rates of a slab of two layers, 0 to a and a to 1, insulated at both ends, and the modes, as functions."""
    (k1, k2), (c1, c2), b = conductivity, capacity, 1 - a

    def flux(rate):
        one, two = np.sqrt(rate * c1 / k1), np.sqrt(rate * c2 / k2)
        return k1 * one * np.sin(one * a) * np.cos(two * b) + k2 * two * np.sin(two * b) * np.cos(one * a)

    at = np.linspace(1e-3, 200.0, 20_001)
    signs = np.flatnonzero(np.diff(np.sign(flux(at))))[:count]
    rates = [brentq(flux, at[i], at[i + 1], xtol=1e-14, rtol=1e-14) for i in signs]

    def mode(rate):
        one, two = np.sqrt(rate * c1 / k1), np.sqrt(rate * c2 / k2)
        return lambda x: np.where(x < a, np.cos(one * x) * np.cos(two * b), np.cos(two * (1 - x)) * np.cos(one * a))

    return rates, [mode(rate) for rate in rates]


@pytest.mark.parametrize(
    ("conductivity", "density", "specific"),
    [((1.0, 4.0), (1.0, 1.0), (1.0, 1.0)), ((1.0, 0.3), (2.0, 0.5), (1.5, 4.0))],
)
def test_a_slab_of_two_layers_is_that_of_the_series_to_second_order(conductivity, density, specific):
    """Insulated ends are the planes of symmetry of a periodic row; the interface lies between nodes."""
    a, until, errors, counts = 0.375, 0.05, [], (16, 32, 64)
    rates, modes = slab_modes(a, conductivity, np.multiply(density, specific), 3)
    for n in counts:
        h = 1 / n
        lattice = fh.Lattice(h, -1 + h / 2, 1 - h / 2)
        x = np.abs(lattice.axes[0])
        layered = [np.where(x < a, *values) for values in (density, specific, conductivity)]
        model = fh.Heat(fh.Kernel(2 * h), *layered, "rk4")
        start = {"u": sum(mode(x) for mode in modes)}
        sim = fh.Simulation(lattice, model, fh.Periodic(), start)
        sim = fh.Simulation(lattice, model, fh.Periodic(), start, dt=until / np.ceil(until / sim.dt))
        sim.run(until, progress=False)
        exact = sum(mode(x) * np.exp(-rate * until) for rate, mode in zip(rates, modes, strict=True))
        errors.append(np.abs(sim.fields["u"] - exact).max())
    assert errors[-1] < 0.01 * np.abs(exact).max() and fitted_rate(1 / np.array(counts), errors) > 1.8


@pytest.mark.parametrize(
    "model",
    [
        fh.Diffusion(fh.Kernel(1.0), diffusivity="where(y < 0.25, 2, 1)"),
        fh.Heat(fh.Kernel(1.0), "where(y < 0.25, 2, 1)", 1.5, "where(y < 0.25, 1, 3)"),
    ],
    ids=["diffusion", "heat"],
)
def test_interfaces_run_into_the_layers(model):
    lattice = fh.Lattice(0.5, (-8.0, -7.0), (8.0, 7.0))
    setup = fh.Setup(lattice, model, fh.LatticePML(target=1e-4), {"u": "exp(-(x**2+(y-2)**2)/2)"})
    (curve,) = compare(setup, 60.0, [20.0, 40.0, 60.0], beside=False).curves.values()
    assert max(curve["error_rel_current"]) < 1e-4


def test_a_varying_diffusivity_is_a_coefficient():
    lattice = fh.Lattice(1.0, (0.0, 0.0), (12.0, 9.0))
    start, factor = {"u": np.random.default_rng(1).standard_normal(lattice.shape)}, lambda x, y: 1 + 0.05 * x * y
    one = fh.Simulation(lattice, fh.Diffusion(fh.Kernel(2.0), factor), fh.Free(), start, dt=0.01)
    two = fh.Simulation(
        lattice, fh.Diffusion(fh.Kernel(2.0)), fh.Free(), start, coefficient=factor, rule="harmonic", dt=0.01
    )
    for sim in (one, two):
        sim.step(30)
    np.testing.assert_allclose(one.fields["u"], two.fields["u"], rtol=0, atol=1e-13)


def test_constants_that_are_the_same_everywhere_are_numbers():
    lattice = fh.Lattice(1.0, (0.0, 0.0), (9.0, 9.0))
    start = {"u": np.random.default_rng(1).standard_normal(lattice.shape)}
    one, two = (
        fh.Simulation(lattice, fh.Heat(fh.Kernel(2.0), *given), fh.Fixed(), start)
        for given in ((2.0, 3.0, 5.0), (np.full(lattice.shape, 2.0), "3 + 0*x", lambda x, y: 5.0 + 0 * x))
    )
    for sim in (one, two):
        sim.step(20)
    assert np.array_equal(one.fields["u"], two.fields["u"])
    assert np.isnan(two.setup.model.heat_capacity) and one.setup.model.heat_capacity == 6.0


def test_a_checkpoint_continues_it(tmp_path):
    """The levels of a scheme of several stages change places from step to step."""
    lattice = fh.Lattice(0.5, (-6.0, -5.0), (6.0, 5.0))
    model = fh.Heat(fh.Kernel(1.0), "1 + (y < 0)", 1.0, "1 + 2*(x > 0)", fh.RungeKuttaChebyshev(4))
    one, two = (fh.Simulation(lattice, model, fh.LatticePML(nodes=6), {"u": "exp(-3*(x**2 + y**2))"}) for _ in range(2))
    one.step(7)
    one.save(tmp_path / "a.ckpt")
    two.load(tmp_path / "a.ckpt")
    for sim in (one, two):
        sim.step(6)
    assert np.array_equal(one.fields["u"], two.fields["u"])


def test_deformation_heats_a_body_of_varying_capacity():
    """Mechanical energy and that of the temperature are exchanged to rounding, where nothing conducts."""
    lattice = fh.Lattice(1.0, (-6.0, -5.0), (6.0, 5.0))
    solid = fh.Elastic(fh.Kernel(2.0, exponent=1), young=1.0)
    heat = fh.Heat(fh.Kernel(2.0), "1 + (x > 0)", "2 + (y > 0)", 1e-40)
    model = fh.Thermoelastic(solid, heat, expansion=0.01, reference=300.0)
    start = {"u": ["exp(-(x**2 + y**2)/4)", 0.0], "T": "300 + 5*exp(-((x - 1)**2 + y**2)/3)"}
    sim = fh.Simulation(lattice, model, fh.Free(), start)
    sim.step()
    before = sim.energies()
    sim.step(60)
    after = sim.energies()
    total = [sum(found[name] for name in ("kinetic", "strain", "thermal")) for found in (before, after)]
    assert total[1] == pytest.approx(total[0], rel=1e-11)
    assert abs(after["thermal"] - before["thermal"]) > 1e-3 * total[0]


CASE = """
[lattice]
spacing = 0.1
lower = [-1.0, -1.0]
upper = [1.0, 1.0]
[model]
type = "heat"
density = 2.0
specific_heat = "1 + 0.5*x**2"
conductivity = 3.0
kernel = { horizon = 0.2 }
[[material]]
region = { box = { lower = [0.05, -2.0], upper = [2.0, 2.0] } }
density = 4.0
conductivity = "5 + y"
[initial]
u = "exp(-20*(x**2 + y**2))"
[boundary]
all = { type = "free" }
[run]
until = 0.01
"""


def test_materials_of_a_case_file(tmp_path):
    path = tmp_path / "plate.toml"
    path.write_text(CASE)
    one = Case.read(path).simulation()
    x, y = one.lattice.coordinates()
    there = x > 0.05
    two = fh.Simulation(
        one.lattice,
        fh.Heat(fh.Kernel(0.2), np.where(there, 4.0, 2.0), 1 + 0.5 * x**2, np.where(there, 5 + y, 3.0)),
        fh.Free(),
        {"u": np.exp(-20 * (x**2 + y**2))},
        dt=one.dt,
    )
    for sim in (one, two):
        sim.step(10)
    np.testing.assert_allclose(one.fields["u"], two.fields["u"], rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("given", "key", "words"),
    [
        ({"density": "1 - x"}, "model.density", "positive at every node"),
        ({"specific_heat": np.ones(3)}, "model.specific_heat", "shape"),
        ({"conductivity": "1 + z"}, "model.conductivity", "z"),
        ({"conductivity": "1 + t"}, "model.conductivity", "t"),
        ({"density": -1.0}, "model.density", "positive"),
    ],
)
def test_constants_that_cannot_be(given, key, words):
    lattice = fh.Lattice(1.0, (-9.0, -9.0), (9.0, 9.0))
    with pytest.raises(fh.InputError, match=words) as caught:
        fh.Simulation(lattice, fh.Heat(fh.Kernel(2.0), **given))
    assert caught.value.key == key


def test_outlines_that_go_on_with_one_heat_capacity_are_refused():
    lattice = fh.Lattice(1.0, (-9.0, -9.0), (9.0, 9.0))
    with pytest.raises(fh.InputError, match="PlaneWave does not support a density that varies"):
        fh.Simulation(lattice, fh.Heat(fh.Kernel(2.0), density="1 + (x > 0)"), fh.PlaneWave())


@pytest.mark.parametrize("compress", [1e-12, None])
def test_exact_ends_continue_the_heat_capacity_at_each_end(compress):
    """As in a bar so long that nothing returns; the balance counts what leaves."""
    lattice, capacity = fh.Lattice(0.25, -5.0, 5.0), "where(x < -1.5, 3, where(x > 2.2, 0.4, 1))"
    model = fh.Heat(fh.Kernel(0.75), density=capacity, conductivity="where(x < -1.5, 0.5, 1)")
    ends, bar = (
        fh.Simulation(lattice, model, side, {"u": "exp(-2*x**2)"}, balance=True)
        for side in (fh.Exact(compress=compress), fh.Extended(nodes=600))
    )
    for until in (1.0, 5.0):
        ends.run(until)
        bar.run(until)
        assert np.abs(ends.fields["u"] - bar.fields["u"]).max() < 1e-11
    assert abs(ends.balance()["residual"]) < 1e-12

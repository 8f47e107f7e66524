"""Time stepping of fourth order by the modified equation, against exact solutions."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import farhorizon as fh
from farhorizon.analysis.references.infinite_lattice import InfiniteLattice
from farhorizon.medium.integrators import ModifiedEquation, Verlet

FOURTH = "modified-equation"
KERNEL = fh.Kernel(2.0)


def wave(dim, order=4, **options):
    return fh.Wave(fh.Stencil.finite_difference(dim, order), integrator=FOURTH, **options)


def fitted_order(errors):
    """Slope of the error over two halvings."""
    return float(np.log2(np.array(errors[:-1]) / np.array(errors[1:])).mean())


def travelling(nodes, order):
    """Error of a wave that travels around a periodic line, at a time step that is the same part of its limit."""
    spacing = 2 * np.pi / nodes
    lattice = fh.Lattice(spacing, 0.0, 2 * np.pi - spacing)
    initial = {"u": lambda x: np.cos(3 * x), "v": lambda x: 3 * np.sin(3 * x)}
    sim = fh.Simulation(lattice, wave(1, order), fh.Periodic(), initial=initial)
    sim.run(2.0, progress=False)
    return np.abs(sim.fields["u"] - np.cos(3 * (lattice.coordinates()[0] - sim.time))).max()


def standing(nodes, order):
    """Error of a standing wave in a square between fixed edges."""
    spacing = np.pi / nodes
    lattice = fh.Lattice(spacing, (spacing,) * 2, (np.pi - spacing,) * 2)
    initial = {"u": lambda x, y: np.sin(x) * np.sin(2 * y)}
    sim = fh.Simulation(lattice, wave(2, order), fh.Fixed(), initial=initial, threads=1)
    sim.run(2.0, progress=False)
    x, y = lattice.coordinates()
    return np.abs(sim.fields["u"] - np.sin(x) * np.sin(2 * y) * np.cos(np.sqrt(5) * sim.time)).max()


def driven(nodes, order):
    """Error of a mode that a source drives from rest: ``q'' + 9 q = cos(2 t + 1)``, which does not begin at rest."""
    spacing = 2 * np.pi / nodes
    lattice = fh.Lattice(spacing, 0.0, 2 * np.pi - spacing)
    sources = [fh.Source(lambda x: np.cos(3 * x), time=lambda t: np.cos(2 * t + 1))]
    sim = fh.Simulation(lattice, wave(1, order), fh.Periodic(), sources=sources)
    sim.run(2.0, progress=False)
    t = sim.time
    own = np.cos(1) * np.cos(3 * t) - 2 / 3 * np.sin(1) * np.sin(3 * t)
    exact = (np.cos(2 * t + 1) - own) / 5 * np.cos(3 * lattice.coordinates()[0])
    return np.abs(sim.fields["u"] - exact).max()


@pytest.mark.parametrize(
    ("error", "order"), [(travelling, 4), (travelling, 6), (travelling, 8), (driven, 4), (driven, 8)]
)
def test_the_order_is_four(error, order):
    """With differences of order 4 or more the order of the run is that of the time step."""
    assert fitted_order([error(n, order) for n in (96, 192, 384)]) == pytest.approx(4, abs=0.2)


def test_the_order_is_four_in_a_box():
    """Between fixed edges the odd images of a sine are the sine itself only within one reach of order 2: the time step
    alone is of order 4 there.
    """
    errors = [standing(n, 2) for n in (16, 32)]
    assert fitted_order(errors) == pytest.approx(2, abs=0.2)


CASES = {
    "fixed": (fh.Wave(KERNEL, integrator=FOURTH), fh.Fixed(), {}),
    "free": (fh.Wave(KERNEL, integrator=FOURTH), fh.Free(), {}),
    "fixed and free": (fh.Wave(KERNEL, integrator=FOURTH), {"x": fh.Fixed(), "y": fh.Free()}, {}),
    "crack": (fh.Wave(KERNEL, integrator=FOURTH), fh.Free(), {"cracks": [fh.Crack([(-2.2, 0.4), (1.3, 0.4)])]}),
    "density": (fh.Wave(KERNEL, speed="1 + 0.3*sin(x)", density="2 + cos(y)", integrator=FOURTH), fh.Free(), {}),
    "reaction": (fh.Wave(fh.Stencil.finite_difference(2).with_reaction(0.5), integrator=FOURTH), fh.Fixed(), {}),
    "bonds": (fh.Elastic(KERNEL, 1.0, integrator=FOURTH), fh.Free(), {}),
    "states": (fh.Elastic(KERNEL, 1.0, poisson=0.3, material="state-based", integrator=FOURTH), fh.Free(), {}),
    "states between fixed sides": (
        fh.Elastic(KERNEL, 1.0, poisson=0.3, material="state-based", integrator=FOURTH),
        {"x": fh.Fixed(), "y": fh.Free()},
        {},
    ),
    "correspondence": (
        fh.Elastic(KERNEL, "1 + 0.2*cos(y)", poisson=0.3, material="correspondence", integrator=FOURTH),
        {"x": fh.Periodic(), "y": fh.Free()},
        {},
    ),
}


def bump(x, y):
    return np.exp(-((x - 1) ** 2 + y**2) / 4)


def course(t):
    return np.cos(1.3 * t + 0.4)


def of_the_nodes(sim, force, until):
    """Field at the end of a run, from the differential equations of the nodes by a method of order 8."""
    indices, held = sim.parts.grid.indices, sim.parts.held
    force = sim.parts.near.model.source_factor * force.ravel()

    def rates(t, state):
        u, v = state.reshape(2, -1)
        level = sim.engine.levels[0].copy()  # its halo and what is held beyond
        level[indices] = u
        found = sim.engine.apply(level)
        found[indices] += force * course(t)
        found *= sim.engine.mobility
        found[held] = 0
        return np.concatenate([v, found[indices]])

    start = np.concatenate([sim.start_u.ravel(), sim.start_v.ravel()])
    return solve_ivp(rates, (0.0, until), start, "DOP853", rtol=1e-11, atol=1e-13).y[: force.size, -1]


@pytest.mark.parametrize("name", CASES)
def test_the_order_in_the_step_on_one_lattice(name):
    """The differential equations of the nodes, with the run's own operator, are solved to 1e-11 by another method;
    sources, initial values and velocities are anything.
    """
    model, boundary, options = CASES[name]
    lattice, until = fh.Lattice(1.0, (-5.0, -4.0), (5.0, 4.0)), 4.0
    vector = isinstance(model, fh.Elastic)
    values = bump(*lattice.coordinates())
    initial = {"u": values, "v": 0.4 * values}
    force = np.stack([values, np.full(lattice.shape, 0.3)]) if vector else values
    if vector:
        initial = {name: np.stack([field, -0.5 * field]) for name, field in initial.items()}
    source = fh.Source([bump, 0.3] if vector else bump, time=course)
    errors, exact = [], None
    for steps in (32, 64, 128):
        sim = fh.Simulation(
            lattice, model, boundary, initial=initial, sources=[source], dt=until / steps, threads=1, **options
        )
        exact = of_the_nodes(sim, force, until) if exact is None else exact
        sim.run(until, progress=False)
        errors.append(np.abs(sim.fields["u"].ravel() - exact).max())
    assert fitted_order(errors) == pytest.approx(4, abs=0.2)


@pytest.mark.parametrize(
    ("dim", "half", "nodes", "steps", "error"), [(1, 30, 20, 150, 1e-9), (2, 20, 20, 80, 1e-13), (3, 14, 8, 20, 1e-8)]
)
@pytest.mark.parametrize("order", [2, 4])
def test_layers_continue_the_infinite_lattice(dim, half, nodes, steps, error, order):
    """The layers act in both stages, each with its memory: what is left is the reflection at their outer ends."""
    lattice = fh.Lattice(1.0, (-half,) * dim, (half,) * dim)

    def bump(*x):
        return np.exp(-sum((c - 0.3) ** 2 for c in x) / 6)

    initial = {"u": bump, "v": lambda *x: 0.3 * x[0] * bump(*x)}
    sim = fh.Simulation(lattice, wave(dim, order), fh.LatticePML(nodes=nodes), initial=initial, threads=1)
    exact = InfiniteLattice(sim.stencil, 1.0, sim.model.integrator, sim.dt, steps, sim.start_u, sim.start_v)
    for _ in range(4):
        sim.step(steps // 4)
        assert np.abs(sim.fields["u"] - exact.after(sim.step_count)).max() < error


@pytest.mark.parametrize("material", ["bond-based", "state-based"])
def test_layers_of_solids(material):
    """Their filter of short waves acts on the increments of whole steps; 20 nodes leave 1e-7."""
    model = fh.Elastic(KERNEL, 1.0, poisson=0.25, material=material, integrator=FOURTH)
    lattice, steps = fh.Lattice(1.0, (-20, -20), (20, 20)), 60
    initial = {"u": [lambda x, y: np.exp(-(x**2 + y**2) / 6), 0.0]}
    sim = fh.Simulation(lattice, model, fh.LatticePML(nodes=20), initial=initial, threads=1)
    exact = InfiniteLattice(sim.stencil, model.coefficient, model.integrator, sim.dt, steps, sim.start_u)
    sim.step(steps)
    assert np.abs(sim.fields["u"] - exact.after(steps)).max() < 1e-6
    assert sim.check(50.0, budget=30.0).certificate.verdict == "certified"


def test_sources_in_layers_are_those_of_a_larger_domain():
    sources = [fh.PointSource((0.3, -0.2), time=fh.Ricker(0.1))]
    fields = []
    for half, sides in ((15, fh.LatticePML(nodes=16)), (45, fh.Fixed())):
        sim = fh.Simulation(
            fh.Lattice(1.0, (-half,) * 2, (half,) * 2), wave(2), sides, sources=sources, dt=0.6, threads=1
        )
        sim.run(50.0, progress=False)
        fields.append(sim.fields["u"])
    small, large = fields[0], fields[1][30:-30, 30:-30]
    assert np.abs(small - large).max() < 1e-6 * np.abs(large).max()


def test_extended_sides():
    lattice = fh.Lattice(1.0, (-12, -12), (12, 12))
    initial = {"u": lambda x, y: np.exp(-(x**2 + y**2) / 4)}
    sim = fh.Simulation(lattice, wave(2), fh.Extended(until=30.0), initial=initial, threads=1)
    sim.run(30.0, progress=False)
    exact = InfiniteLattice(sim.stencil, 1.0, sim.model.integrator, sim.dt, sim.step_count, sim.start_u)
    assert np.abs(sim.fields["u"] - exact.after(sim.step_count)).max() < 1e-5


def test_layers_are_chosen_by_trial_runs():
    lattice = fh.Lattice(1.0, (-12, -12), (12, 12))
    initial = {"u": lambda x, y: np.exp(-(x**2 + y**2) / 4)}
    sim = fh.Simulation(lattice, wave(2), fh.LatticePML(target=1e-6, until=40.0), initial=initial, threads=1)
    sim.run(40.0, progress=False)
    exact = InfiniteLattice(sim.stencil, 1.0, sim.model.integrator, sim.dt, sim.step_count, sim.start_u)
    assert np.abs(sim.fields["u"] - exact.after(sim.step_count)).max() < 1e-6


@pytest.mark.parametrize("part", [0.5, 0.999])
def test_the_energy_of_the_scheme_is_conserved(part):
    """``|u(n) - u(n-1)|^2 - u(n) . Z u(n-1)`` with ``Z = z + z^2/12`` and ``z = dt^2 L`` is an invariant; over 1e5
    steps it drifts by the sum of rounding errors only, up to just below the limit, which is sqrt(3) times that of
    Verlet.
    """
    lattice = fh.Lattice(1.0, 0.0, 23.0)
    model = fh.Wave(fh.Stencil.finite_difference(1), integrator=FOURTH)
    rng = np.random.default_rng(5)
    initial = {name: rng.standard_normal(24) for name in "uv"}
    limits = [fh.Simulation(lattice, one, fh.Fixed()).step_limit for one in (fh.Wave(model.operator), model)]
    assert limits[1] == pytest.approx(np.sqrt(3) * limits[0], rel=1e-12)
    sim = fh.Simulation(lattice, model, fh.Fixed(), initial=initial, dt=part * limits[1])
    z = sim.dt**2 * (np.eye(24, k=1) + np.eye(24, k=-1) - 2 * np.eye(24))

    def energy():
        u, v = sim.fields["u"], sim.fields["v"]
        return sim.dt**2 * v @ v - u @ (z + z @ z / 12) @ (u - sim.dt * v)

    first, found = energy(), []
    for _ in range(10):
        sim.step(10_000)
        found.append(energy())
    # 1e5 roundings of 1e-16, many times as large where waves of amplitude 1 have little energy
    assert np.abs(np.array(found) / first - 1).max() < 1e-9


def test_it_grows_beyond_the_limit():
    symbol = np.array([12.0])
    limit = ModifiedEquation.step_limit(12.0)
    inside, beyond = (ModifiedEquation.modes(symbol, dt, 0.0) for dt in (0.999 * limit, 1.001 * limit))
    assert abs(inside.after(1000, np.ones(1), np.zeros(1))[0]) <= 1 + 1e-9
    assert abs(beyond.after(1000, np.ones(1), np.zeros(1))[0]) > 1e6
    assert limit == pytest.approx(np.sqrt(3) * Verlet.step_limit(12.0))


@pytest.mark.parametrize("boundary", [fh.LatticePML(nodes=8), {"x": fh.Free(), "y": fh.LatticePML(nodes=8)}])
def test_a_run_that_continues_is_the_same(tmp_path, boundary):
    """A checkpoint holds the memory of the layers in both stages; the level between the stages is scratch."""
    source = fh.PointSource((0.0, 0.0), time=fh.Ricker(0.1))
    lattice = fh.Lattice(1.0, (-10, -10), (10, 10))
    model = fh.Wave(KERNEL, density="1 + 0.1*cos(y)*0", integrator=FOURTH)
    sims = [fh.Simulation(lattice, model, boundary, sources=[source], threads=1) for _ in range(2)]
    sims[0].step(37)
    sims[1].step(20)
    sims[1].save(tmp_path / "half.h5")
    again = fh.Simulation.restore(tmp_path / "half.h5")
    again.step(17)
    np.testing.assert_array_equal(again.fields["u"], sims[0].fields["u"])
    np.testing.assert_array_equal(again.fields["v"], sims[0].fields["v"])


def test_threads_and_single_precision():
    lattice = fh.Lattice(1.0, (-110, -110), (110, 110))
    initial = {"u": lambda x, y: np.exp(-(x**2 + y**2) / 9)}
    fields = []
    for threads, dtype in ((1, "float64"), (2, "float64"), (1, "float32")):
        try:
            sim = fh.Simulation(lattice, wave(2), fh.LatticePML(nodes=8), initial=initial, threads=threads, dtype=dtype)
        except fh.InputError:  # one core
            continue
        sim.step(30)
        fields.append(sim.fields["u"])
    for other in fields[1:]:
        assert np.abs(other - fields[0]).max() < (1e-12 if other.dtype == np.float64 else 1e-5)


def test_a_case_file(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text(
        """
lattice = { spacing = 0.25, lower = [-4.0, -4.0], upper = [4.0, 4.0] }
model = { type = "wave", stencil = "finite-difference", order = 4, integrator = "modified-equation" }
initial = { u = "exp(-2*(x**2 + y**2))" }
boundary = { all = { type = "lattice-pml", nodes = 8 } }
run = { until = 2.0 }
"""
    )
    sim = fh.read_case(path).simulation()
    assert sim.model.integrator == ModifiedEquation()
    sim.run(2.0, progress=False)
    assert np.abs(sim.fields["u"]).max() < 1
    path.write_text(path.read_text().replace("modified-equation", "rk4"))
    with pytest.raises(fh.InputError, match=r"model\.integrator.*verlet, modified-equation"):
        fh.read_case(path).simulation()


INNER = fh.Box((-5, -5), (5, 5))
REFUSED = {
    "breaking": ({"model": fh.Elastic(KERNEL, 1.0, critical_stretch=0.1, integrator=FOURTH)}, "model"),
    "nonlinear": ({"model": fh.Elastic(KERNEL, 1.0, nonlinear=True, integrator=FOURTH)}, "model"),
    "contact": ({"model": fh.Elastic(KERNEL, 1.0, contact=True, integrator=FOURTH)}, "model"),
    "exact ends": ({"lattice": fh.Lattice(1.0, -9, 9), "boundary": fh.Exact()}, "boundary.x-"),
    "sponge": ({"boundary": fh.Sponge(nodes=8)}, "boundary.x-"),
    "outline": ({"boundary": fh.PlaneWave()}, "boundary.x-"),
    "prescribed": ({"constraints": [fh.Prescribed(fh.Box((-1, -1), (1, 1)), value=0.0)]}, "constraint"),
    "balance": ({"balance": True}, "balance"),
    "of the field": ({"sources": [fh.OfField("-u**3")]}, "model.integrator"),
    "incident": ({"sources": [fh.IncidentWave((1.0, 0.0), fh.Ricker(0.1), 30.0, within=INNER)]}, ""),
    "long step in layers": ({"boundary": fh.LatticePML(nodes=8), "dt": 0.9}, "run.dt"),
    "step above the limit": ({"boundary": fh.Fixed(), "dt": 1.3}, "run.dt"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name):
    changes, key = REFUSED[name]
    options = {"lattice": fh.Lattice(1.0, (-9, -9), (9, 9)), "model": None, "boundary": fh.Free(), **changes}
    lattice, boundary = options.pop("lattice"), options.pop("boundary")
    model = options.pop("model") or wave(lattice.dim, 2)
    with pytest.raises(fh.InputError) as refused:
        fh.Simulation(lattice, model, boundary, **options)
    assert key in str(refused.value)


def test_damping_is_refused():
    for make in (lambda: wave(1, damping=0.1), lambda: fh.Elastic(KERNEL, 1.0, damping=0.1, integrator=FOURTH)):
        with pytest.raises(fh.InputError, match="modified equation"):
            make()
    with pytest.raises(fh.InputError, match="verlet, modified-equation"):
        fh.Wave(KERNEL, integrator="leapfrog")

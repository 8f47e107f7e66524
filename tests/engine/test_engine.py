"""The compiled engine against plain numpy: the operator, bond coefficients, free sides, the time loop, and conserved
quantities.
"""

import gc
import weakref

import numpy as np
import pytest

from farhorizon import (
    Diffusion,
    Fixed,
    Free,
    InputError,
    LatticePML,
    Periodic,
    Simulation,
    Source,
    Sponge,
    Stencil,
    Wave,
)
from farhorizon.engine.features.ends import ends_table
from farhorizon.medium.integrators import Euler, RungeKutta4, Verlet
from helpers import (
    RULES,
    TOLERANCE,
    check_apply,
    dense_operator,
    engine_apply,
    kernel_stencil,
    lattice_of,
    periodic_engine,
    roll_apply,
)

EULER = Euler.stages(0.1)
RANDOM = np.random.default_rng(7)
EPS = np.finfo(float).eps


def symmetric(dim, table):
    """A stencil from half of its offsets."""
    offsets = np.array(list(table))
    return Stencil(np.concatenate([offsets, -offsets]).reshape(-1, dim), np.tile(list(table.values()), 2))


# Weights differ from axis to axis, and so does the reach.
ANISOTROPIC = {
    2: symmetric(2, {(1, 0): 1.0, (2, 0): 0.3, (3, 0): -0.05, (0, 1): 0.2, (1, 1): 0.11, (1, -1): 0.11}),
    3: symmetric(
        3, {(1, 0, 0): 1.0, (0, 1, 0): 0.2, (0, 0, 1): 0.5, (0, 0, 2): 0.07, (2, 1, 0): 0.03, (2, -1, 0): 0.03}
    ),
}
# Weights at (1, 1) and (1, -1) differ: no mirror symmetry along any axis.
SKEWED = {
    2: symmetric(2, {(1, 0): 1.0, (0, 1): 0.6, (1, 1): 0.4, (1, -1): -0.1, (2, 1): 0.05}),
    3: symmetric(3, {(1, 0, 0): 1.0, (0, 1, 0): 0.6, (0, 0, 1): 0.8, (1, 1, 0): 0.3, (0, 1, -1): 0.2, (1, 2, 1): 0.05}),
}
STENCILS = {
    **{f"1D m{m}": (kernel_stencil(1, m, 0), (23,)) for m in (1, 2, 3, 4)},
    **{f"2D m{m}": (kernel_stencil(2, m, 1), (13, 19)) for m in (1, 2, 3, 4)},
    **{f"3D m{m}": (kernel_stencil(3, m, 2), (7, 9, 11)) for m in (1, 2, 3)},
    "3D m4": (kernel_stencil(3, 4, 2), (9, 9, 10)),  # too many neighbours for straight-line code
    "FE 1D": (Stencil.finite_element(1), (9,)),
    "FE 2D": (Stencil.finite_element(2), (9, 17)),
    "FE 3D": (Stencil.finite_element(3), (5, 6, 9)),
    "anisotropic 2D": (ANISOTROPIC[2], (11, 14)),
    "anisotropic 3D": (ANISOTROPIC[3], (7, 6, 13)),
    "skewed 2D": (SKEWED[2], (11, 14)),
    "skewed 3D": (SKEWED[3], (7, 6, 13)),
    "big 2D": (kernel_stencil(2, 8, 1), (19, 29)),
}
SOME = {name: STENCILS[name] for name in ("1D m2", "2D m3", "3D m1", "skewed 2D")}


@pytest.mark.parametrize(("stencil", "shape"), STENCILS.values(), ids=STENCILS)
def test_operator(stencil, shape):
    """The operator is the sum of weights times differences over the family, in 1D, 2D and 3D, for every kind of
    stencil.
    """
    check_apply(shape, stencil)


@pytest.mark.parametrize(("stencil", "shape"), SOME.values(), ids=SOME)
def test_operator_in_single_precision(stencil, shape):
    """The same to the precision of float32."""
    check_apply(shape, stencil, real="float32")


@pytest.mark.parametrize("name", ["1D m2", "2D m3", "skewed 2D"])
@pytest.mark.parametrize(
    "stages",
    [RungeKutta4.stages(0.1), Verlet.stages(0.1, 0.2), Verlet.stages(0.1, 0.2, True)],
    ids=["RK4", "Verlet", "increments"],
)
def test_operator_does_not_depend_on_the_integrator(name, stages):
    """Increments have a sweep of their own, the others share one; the operator is the same."""
    stencil, shape = STENCILS[name]
    check_apply(shape, stencil, stages)


@pytest.mark.parametrize("length", range(5, 21))
@pytest.mark.parametrize("rows", [(), (5,), (6,), (7,), (8,)], ids=str)
def test_row_lengths(length, rows):
    """Row lengths that are not multiples of a vector."""
    check_apply((*rows, length), kernel_stencil(1 + len(rows), 2))


@pytest.mark.parametrize("length", [5, 15, 16, 17, 31, 33])
def test_row_lengths_in_single_precision(length):
    """16 numbers fill a vector of float32."""
    check_apply((7, length), kernel_stencil(2, 2), real="float32")


@pytest.mark.parametrize("real", TOLERANCE)
@pytest.mark.parametrize("length", [512, 513, 1285, 1300])
def test_rows_longer_than_a_tile(length, real):
    """For a reach of 3 tiles hold 512 numbers of float64 or 1024 of float32: seams, remainders, and rows that end with
    a tile.
    """
    check_apply((9, length), kernel_stencil(2, 3), real=real)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("real", "reach"), [("float64", 8), ("float64", 9), ("float32", 9), ("float32", 16), ("float32", 17)]
)
def test_reach_of_a_vector_and_beyond(real, reach):
    """A sum is shifted along a row by one vector at most; wider stencils read each neighbour separately."""
    check_apply((2 * reach + 1, 2 * reach + 20), kernel_stencil(2, reach), real=real)


@pytest.mark.parametrize("rows", [63, 64, 65, 130])
def test_more_rows_than_a_part(rows):
    """Rows are swept in parts of up to 64."""
    check_apply((rows, 12), kernel_stencil(2, 2))


@pytest.mark.parametrize("shape", [(5, 5, 5), (5, 6, 7), (6, 5, 9), (8, 7, 16)], ids=str)
def test_row_counts_in_3d(shape):
    """Odd and even row counts along both slow axes."""
    check_apply(shape, kernel_stencil(3, 1))


def test_small_lattices_run_on_one_thread():
    """A second thread costs more than it saves."""
    assert periodic_engine((30, 30), kernel_stencil(2, 2), EULER, 0.1, threads=2).threads == 1


# Coefficients on bonds


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize(("stencil", "shape"), SOME.values(), ids=SOME)
def test_bond_coefficients(stencil, shape, rule):
    """The smaller, arithmetic or harmonic mean of the values at a bond's ends, including voids."""
    coefficient = np.random.default_rng(5).uniform(0.1, 3, shape)
    coefficient[..., 2:4] = 0
    check_apply(shape, stencil, coefficient=coefficient, rule=rule)


def test_bond_coefficients_in_single_precision():
    """In float32, on more nodes than one chunk of a row."""
    coefficient = np.random.default_rng(5).uniform(0.1, 3, (41, 405))
    check_apply((41, 405), kernel_stencil(2, 1), real="float32", coefficient=coefficient, rule="harmonic")


@pytest.mark.parametrize("rule", RULES)
def test_a_uniform_coefficient_is_a_factor(rule):
    """Every rule preserves a constant."""
    stencil, shape = kernel_stencil(2, 2), (9, 12)
    u = RANDOM.normal(size=shape)
    plain, scaled = (periodic_engine(shape, stencil, EULER, 0.1, c, rule=rule) for c in (None, np.full(shape, 2.5)))
    np.testing.assert_allclose(engine_apply(scaled, u), 2.5 * engine_apply(plain, u), rtol=0, atol=1e-13)


# Free sides, against a matrix of the bonds that exist

SHAPES = {1: (17,), 2: (11, 13), 3: (6, 5, 8)}


def free_simulation(dim, model=Diffusion, reach=2, boundary=None, stencil=None, **options):
    """A simulation from white noise with free sides and spacing 0.5, and its initial values."""
    lattice = lattice_of(SHAPES[dim], 0.5)
    stencil = stencil or kernel_stencil(dim, reach, 1)
    u = np.random.default_rng(11).uniform(-1, 1, lattice.shape)
    return Simulation(lattice, model(stencil), boundary or Free(), {"u": u}, **options), u


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("reach", [1, 2])
def test_free_sides_have_no_bonds(dim, reach):
    """The operator is the matrix from which bonds that leave the body are absent."""
    sim, u = free_simulation(dim, reach=reach)
    matrix = dense_operator(u.shape, sim.stencil.offsets, sim.stencil.weights / 0.25)
    np.testing.assert_allclose(engine_apply(sim.engine, u).ravel(), matrix @ u.ravel(), rtol=0, atol=1e-12)


def test_free_sides_of_a_skewed_stencil():
    """No mirror symmetry is assumed at a free side."""
    sim, u = free_simulation(2, stencil=SKEWED[2])
    matrix = dense_operator(u.shape, SKEWED[2].offsets, SKEWED[2].weights / 0.25)
    np.testing.assert_allclose(engine_apply(sim.engine, u).ravel(), matrix @ u.ravel(), rtol=0, atol=1e-12)


@pytest.mark.parametrize("rule", RULES)
def test_free_sides_of_a_composite(rule):
    """Absent bonds are subtracted with their coefficient."""
    coefficient = np.random.default_rng(5).uniform(0.1, 3, SHAPES[2])
    sim, u = free_simulation(2, coefficient=coefficient, rule=rule)
    matrix = dense_operator(
        u.shape, sim.stencil.offsets, sim.stencil.weights / 0.25, coefficient=coefficient, rule=rule
    )
    np.testing.assert_allclose(engine_apply(sim.engine, u).ravel(), matrix @ u.ravel(), rtol=0, atol=1e-12)


@pytest.mark.parametrize("free", [0, 1])
def test_free_and_periodic_sides(free):
    """A strip: bonds are absent along one axis and wrap along the other."""
    sim, u = free_simulation(2, boundary={"xy"[free]: Free(), "xy"[1 - free]: Periodic()})
    m = sim.stencil.reach[0]
    # Free along `free` equals the periodic operator on a lattice with a gap, whose void removes the bonds.
    pads = [(m, m) if a == free else (0, 0) for a in range(2)]
    wide, there = np.pad(u, pads), np.pad(np.ones(u.shape), pads)
    expected = roll_apply(wide, sim.stencil.offsets, sim.stencil.weights / 0.25, there, "both")
    inner = tuple(slice(m, -m) if a == free else slice(None) for a in range(2))
    np.testing.assert_allclose(engine_apply(sim.engine, u), expected[inner], rtol=0, atol=1e-12)


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_fixed_sides_see_the_value(dim):
    """Every node beyond a Fixed side has the given value, corners included."""
    sim, u = free_simulation(dim, boundary=Fixed(1.5))
    m = sim.stencil.reach[0]
    wide = np.pad(u, m, constant_values=1.5)
    expected = roll_apply(wide, sim.stencil.offsets, sim.stencil.weights / 0.25)[(slice(m, -m),) * dim]
    got = sim.engine.core.view(sim.engine.apply(sim.engine.current)).reshape(u.shape)
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-12)


# The time loop


def loop(model, matrix, u, v, dt, steps, force):
    """Euler, classical Runge-Kutta or damped Verlet by matrix products; `force(t)` is an array."""
    slope = lambda t, u: matrix @ u + force(t)  # noqa: E731
    if isinstance(model, Wave):
        share = model.damping * dt
        old = u - dt * (1 + share) * v + dt**2 / 2 * slope(0, u)
    for n in range(steps):
        t = n * dt
        if isinstance(model, Wave):
            u, old = (2 * u - (1 - share) * old + dt**2 * slope(t, u)) / (1 + share), u
        elif model.integrator.order == 1:
            u = u + dt * slope(t, u)
        else:
            k1 = slope(t, u)
            k2 = slope(t + dt / 2, u + dt / 2 * k1)
            k3 = slope(t + dt / 2, u + dt / 2 * k2)
            u = u + dt / 6 * (k1 + 2 * k2 + 2 * k3 + slope(t + dt, u + dt * k3))
    return u


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("heterogeneous", [False, True])
@pytest.mark.parametrize(
    "make",
    [
        lambda s: Diffusion(s, 1.3),
        lambda s: Diffusion(s, 1.3, "rk4"),
        lambda s: Wave(s, 1.1),
        lambda s: Wave(s, 1.1, damping=0.4),
    ],
    ids=["Euler", "RK4", "Verlet", "damped Verlet"],
)
def test_time_loop(dim, make, heterogeneous):
    """Many steps of the compiled loop, with a source and a coefficient that varies, equal the textbook loop."""
    random = np.random.default_rng(13)
    shape = SHAPES[dim]
    model = make(kernel_stencil(dim, 2, 1))
    u, v, s = random.uniform(-1, 1, (3, *shape))
    coefficient = random.uniform(0.2, 1.5, shape) if heterogeneous else None
    initial = {"u": u, "v": v} if isinstance(model, Wave) else {"u": u}
    force = lambda t: np.cos(4 * t)  # noqa: E731
    sim = Simulation(
        lattice_of(shape, 0.5),
        model,
        Free(),
        initial,
        sources=[Source(s, force)],
        coefficient=coefficient,
        rule="harmonic",
    )
    sim.step(11)
    sim.step(14)
    matrix = dense_operator(
        shape, sim.stencil.offsets, sim.stencil.weights * model.coefficient / 0.25, None, coefficient, "harmonic"
    )
    expected = loop(model, matrix, u.ravel(), v.ravel(), sim.dt, 25, lambda t: s.ravel() * force(t))
    np.testing.assert_allclose(sim.fields["u"].ravel(), expected, rtol=0, atol=1e-13 * max(1, np.abs(expected).max()))


BANDS = np.broadcast_to(np.where(np.arange(201) < 90, 1.0, 0.3), (213, 201)).copy()
BANDS[:, :20] = BANDS[:, -20:] = 1.0
THREADED = {
    "layers, crack, source": (
        (213, 201),
        Wave(kernel_stencil(2, 3, 1), damping=0.1),
        LatticePML(nodes=7),
        {
            "cracks": [[(60.5, 80.5), (70.5, 120.5)]],
            "sources": [Source(lambda x, y, t: np.exp(-((x - 90) ** 2 + (y - 99) ** 2)) * np.sin(t))],
        },
    ),
    "coefficient, crack": (
        (213, 201),
        Wave(kernel_stencil(2, 2, 1)),
        LatticePML(nodes=5),
        {"cracks": [[(60.5, 80.5), (70.5, 120.5)]], "coefficient": BANDS},
    ),
    "rows cut among threads": ((151, 301), Wave(kernel_stencil(2, 3, 2)), LatticePML(nodes=6), {}),
    "skewed": ((213, 201), Wave(SKEWED[2]), LatticePML(nodes=5), {}),
    "periodic and layers": ((213, 201), Wave(kernel_stencil(2, 2, 1)), {"x": LatticePML(nodes=6), "y": Periodic()}, {}),
    "sponge, free": ((213, 201), Wave(kernel_stencil(2, 2, 1)), {"x": Sponge(nodes=20), "y": Free()}, {}),
    "diffusion, RK4": ((40, 35, 33), Diffusion(kernel_stencil(3, 1), integrator="rk4"), LatticePML(nodes=4), {}),
}


@pytest.mark.parametrize("threads", [2, 5])
@pytest.mark.parametrize(("shape", "model", "boundary", "rest"), THREADED.values(), ids=THREADED)
def test_threads_share_every_part_of_a_step(shape, model, boundary, rest, threads, monkeypatch):
    """With as many threads as cores or more the result, boundary memory included, is bitwise that of the serial run,
    because the order of summation does not change.
    """
    monkeypatch.setattr("farhorizon.simulation.setup.setup.available_threads", lambda: threads)
    lattice = lattice_of(shape)
    u = np.pad(np.random.default_rng(17).normal(size=[n - 16 for n in shape]), 8)
    runs = [Simulation(lattice, model, boundary, {"u": u}, threads=n, **rest) for n in (1, threads)]
    for sim in runs:
        sim.step(11)
        sim.step(2)
    assert [sim.engine.threads for sim in runs] == [1, threads]
    np.testing.assert_array_equal(*[sim.engine.levels for sim in runs])
    np.testing.assert_array_equal(*[sim.engine.memory for sim in runs])


def test_single_precision_run_follows_double():
    """100 steps of float32 stay within rounding times the number of steps."""
    u = np.random.default_rng(19).uniform(-1, 1, SHAPES[2])
    runs = [
        Simulation(lattice_of(SHAPES[2]), Wave(kernel_stencil(2, 2, 2)), Free(), {"u": u}, dtype=t)
        for t in ("float64", "float32")
    ]
    for sim in runs:
        sim.step(100)
    assert runs[1].engine.current.dtype == np.float32
    # 100 steps with a relative rounding of 6e-8 each, amplified at most linearly (bounded oscillators)
    np.testing.assert_allclose(*[sim.fields["u"] for sim in runs], rtol=0, atol=100 * 100 * 6e-8)


# Conserved quantities


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("integrator", ["euler", "rk4"])
def test_free_diffusion_conserves_the_sum(dim, integrator):
    """No flux leaves an insulated body."""
    sim, u = free_simulation(dim, lambda s: Diffusion(s, 1.0, integrator))
    sim.step(300)
    assert sim.fields["u"].sum() == pytest.approx(u.sum(), abs=1e-13 * u.size)
    assert np.ptp(sim.fields["u"]) < 0.9 * np.ptp(u)


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("heterogeneous", [False, True])
@pytest.mark.parametrize("boundary", [Free(), Periodic()])
def test_undamped_verlet_conserves_energy(dim, heterogeneous, boundary):
    """The discrete energy of a closed body is constant over 2000 steps to rounding, from the start."""
    coefficient = np.random.default_rng(5).uniform(0.2, 1.5, SHAPES[dim]) if heterogeneous else None
    sim, _ = free_simulation(dim, Wave, coefficient=coefficient, rule="arithmetic", boundary=boundary)
    energies = [sim.energy()]
    for steps in (1, 999, 1000):
        sim.step(steps)
        energies.append(sim.energy())
    assert energies[0] > 0
    np.testing.assert_allclose(energies, energies[0], rtol=1e-12)


def test_damping_takes_energy_away():
    """The energy falls; a uniform velocity decays by (1 - d dt)/(1 + d dt) per step (exact for symbol 0)."""
    sim, _ = free_simulation(2, lambda s: Wave(s, damping=0.3))
    energies = []
    for _ in range(20):
        energies.append(sim.energy())
        sim.step(5)
    assert (np.diff(energies) < 0).all()
    drift = Simulation(
        lattice_of((9, 9)),
        Wave(kernel_stencil(2, 2), damping=0.3),
        Free(),
        {"u": np.zeros((9, 9)), "v": np.ones((9, 9))},
    )
    share = 0.3 * drift.dt
    drift.step(10)
    steps = (1 - share) * ((1 - share) / (1 + share)) ** np.arange(10)  # the first step: u(1) - u(0) = dt (1 - d dt) v
    np.testing.assert_allclose(drift.fields["u"], drift.dt * steps.sum(), rtol=1e-12)


@pytest.mark.parametrize("boundary", [Free(), Periodic()])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_a_uniform_field_stays(dim, boundary):
    """Differences vanish, also where coefficients vary."""
    coefficient = np.random.default_rng(5).uniform(0.2, 1.5, SHAPES[dim])
    u = np.full(SHAPES[dim], 2.0)
    sim = Simulation(lattice_of(SHAPES[dim]), Wave(kernel_stencil(dim, 2)), boundary, {"u": u}, coefficient=coefficient)
    sim.step(100)
    # two levels: the rounding of each step changes the velocity
    np.testing.assert_allclose(sim.fields["u"], 2.0, rtol=100**2 * EPS)


def test_a_near_field_thinner_than_the_stencil_is_refused():
    """Fewer than 2 m + 1 nodes along an axis between sides that are neither free nor fixed."""
    with pytest.raises(InputError, match=r"thinner than the stencil.*>= 7"):
        Simulation(lattice_of((6, 20)), Wave(kernel_stencil(2, 3)), LatticePML(nodes=4))


def test_an_engine_goes_as_soon_as_nobody_holds_it():
    """Levels may take gigabytes, so they must not wait for the collection of reference cycles. The first run lets the
    compiler create its own cycles beforehand.
    """

    def stepped():
        sim = Simulation(lattice_of((20, 20)), Wave(kernel_stencil(2, 2)), LatticePML(nodes=4))
        sim.step(3)
        return sim

    stepped()
    gc.disable()
    try:
        sim = stepped()
        engine = weakref.ref(sim.engine)
        del sim
        assert engine() is None
    finally:
        gc.enable()


@pytest.mark.parametrize("table", ["history", "source_times", "held_values", "dependent_times"])
def test_tables_without_room_are_refused_before_the_loop(table):
    """The compiled loop checks no bounds: a table that is too short for the steps and stages raises an IndexError, and
    nothing runs.
    """
    stages = RungeKutta4.stages(0.1)
    engine = periodic_engine((12,), kernel_stencil(1, 2), stages, 0.1)
    steps, stage_count = 300, len(stages.numbers)
    times, held, tied = np.zeros((steps, stage_count, 1)), np.zeros((steps, 1)), np.zeros((steps, stage_count, 0))
    if table == "history":
        engine.replace(ends=ends_table(np.array([[0, 1]]), 1.0))  # counts stages, but there is room for steps only
    elif table == "source_times":
        times = times[:, :1]
    elif table == "held_values":
        engine.hold(np.array([3]))
        held = held[:-1]
    else:
        tied = tied[:-1]
    before = engine.levels.copy()
    with pytest.raises(IndexError, match=table):
        engine.advance(steps, np.array([2]), np.zeros((1, 1)), times, held, np.zeros((0, 0)), tied)
    assert np.array_equal(engine.levels, before) and engine.steps_done == 0

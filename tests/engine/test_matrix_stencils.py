"""Fields of several components: the compiled sweeps of matrix stencils against plain numpy, halos, absent bonds, and
threads.
"""

import itertools

import numpy as np
import pytest

from farhorizon import Elastic, Fixed, Free, Kernel, LatticePML, Periodic, Simulation, Sponge, Stencil, Wave
from farhorizon.engine.engine import Layer
from farhorizon.engine.state import State
from farhorizon.medium.integrators import RungeKutta4, Verlet
from helpers import check_apply, kernel_stencil, lattice_of, periodic_engine

TAPS = np.array([6.0, -4.0, 1.0]) / 16  # (1 - cos k)^2 / 4, a filter that passes short waves


def elastic(dim, reach, material="bond-based", **options):
    """Stencil of a material on a unit lattice."""
    poisson = None if material == "bond-based" else 0.3
    kernel = None if material == "finite-element" else Kernel(float(reach), exponent=1, **options)
    return Elastic(kernel, 1.0, poisson, material=material).stencil(1.0, dim)


def random_stencil(dim, seed=4):
    """A stencil with no symmetry except the one that every stencil has."""
    rng = np.random.default_rng(seed)
    half = [o for o in itertools.product((-1, 0, 1), repeat=dim) if o > (0,) * dim]
    weights = rng.uniform(-0.2, 1, (len(half), dim, dim))
    return Stencil(np.concatenate([half, -np.array(half)]), np.concatenate([weights, np.swapaxes(weights, 1, 2)]))


def stretched(stencil):
    """The same stencil with other weights along each axis: mirror symmetry remains, exchange of axes does not."""
    factors = 1.0 + 0.2 * np.abs(stencil.offsets) @ np.arange(1, stencil.dim + 1)
    return Stencil(stencil.offsets, stencil.weights * factors[:, None, None])


def alike(dim, reach):
    """The same scalar stencil for each component."""
    scalar = kernel_stencil(dim, reach)
    return Stencil(scalar.offsets, scalar.weights[:, None, None] * np.eye(dim))


def apart(dim, reach):
    """A different scalar stencil for each component."""
    scalar = kernel_stencil(dim, reach)
    return Stencil(scalar.offsets, scalar.weights[:, None, None] * np.diag([1.0, 0.5, 0.7][:dim]))


STENCILS = {
    **{f"2D m{m}": (elastic(2, m), (17, 21)) for m in (1, 2, 3)},
    "2D m6": (elastic(2, 6), (15, 33)),
    "2D state-based": (elastic(2, 2, "state-based"), (11, 19)),
    "2D correspondence": (elastic(2, 3, "correspondence"), (15, 22)),
    "2D elements": (elastic(2, 1, "finite-element"), (9, 12)),
    "2D stretched": (stretched(elastic(2, 2)), (9, 18)),
    "2D without symmetry": (random_stencil(2), (9, 18)),
    "2D alike": (alike(2, 2), (9, 18)),
    "3D alike": (alike(3, 2), (7, 8, 19)),
    "3D m1": (elastic(3, 1), (7, 8, 19)),
    "3D m2 linear": (elastic(3, 2, influence="linear"), (7, 8, 19)),
    "3D without symmetry": (random_stencil(3), (5, 6, 9)),
    # with more lines than are read together
    "2D m8": (elastic(2, 8), (19, 37)),
    "2D m8 apart": (apart(2, 8), (19, 37)),
    "3D m2": (elastic(3, 2), (7, 8, 19)),
    "3D m3": (elastic(3, 3), (8, 9, 27)),
    "3D m3 apart": (apart(3, 3), (8, 9, 27)),
    "3D state-based": (elastic(3, 2, "state-based"), (9, 10, 21)),
}
SOME = {
    name: STENCILS[name]
    for name in ("2D m3", "2D without symmetry", "2D alike", "2D m8", "3D m1", "3D alike", "3D m2", "3D m3 apart")
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("stencil", "shape"), STENCILS.values(), ids=STENCILS)
def test_operator(stencil, shape):
    """The operator is the sum of matrices times differences, for stencils with all symmetries, mirrors only, or
    none.
    """
    check_apply(shape, stencil)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("stencil", "shape"), SOME.values(), ids=SOME)
def test_operator_in_single_precision(stencil, shape):
    """The same to the precision of float32."""
    check_apply(shape, stencil, real="float32")


@pytest.mark.parametrize("rule", ["both", "arithmetic", "harmonic"])
@pytest.mark.parametrize(("stencil", "shape"), SOME.values(), ids=SOME)
def test_factors_on_bonds(stencil, shape, rule):
    """A coefficient on the nodes multiplies all entries of a bond's matrix."""
    coefficient = np.random.default_rng(5).uniform(0, 2, shape)
    check_apply(shape, stencil, coefficient=coefficient, rule=rule)


def test_mirrored_stencils_are_compiled_and_others_are_not():
    """Compiled rows serve stencils with mirror symmetry along all axes."""
    assert check_apply((9, 18), STENCILS["2D m2"][0]).tables.sweep.function
    assert not check_apply((9, 18), STENCILS["2D without symmetry"][0]).tables.sweep.function


@pytest.mark.parametrize(("name", "blocks"), [("2D m2", 1), ("2D alike", 2), ("3D alike", 3)])
def test_equal_scalars_are_swept_one_by_one(name, blocks):
    stencil, shape = STENCILS[name]
    sweep = check_apply(shape, stencil).tables.sweep
    assert sweep.function
    assert sweep.blocks == blocks


@pytest.mark.parametrize("stages", [Verlet().stages(0.1), RungeKutta4().stages(0.1)])
def test_equal_scalars_step_as_fields_of_their_own(stages):
    """This holds in a medium that varies, too."""
    stencil, shape = STENCILS["2D alike"]
    u = np.random.default_rng(3).standard_normal((2, *shape))
    scalar = Stencil(stencil.offsets, stencil.weights[:, 0, 0])
    layered = np.ones(shape)
    layered[:, 7:] = 2.0
    for medium in (None, layered):
        found = []
        for one, start in ((stencil, u), (scalar, u[0]), (scalar, u[1])):
            engine = periodic_engine(shape, one, stages, 0.1, medium, threads=1)
            for level in engine.levels:
                engine.core.view(level)[...] = start.reshape(engine.core.view(level).shape)
            for _ in range(5):
                engine.advance(1)
            found.append(engine.core.view(engine.current).reshape(-1, *shape))
        np.testing.assert_allclose(found[0], np.concatenate(found[1:]), rtol=0, atol=1e-13)


@pytest.mark.parametrize("dim", [2, 3])
def test_layers_are_swept_alike_with_and_without_compiled_rows(dim, monkeypatch):
    """On faces, edges and corners the general sweep agrees with the compiled rows up to the order of summation."""
    stencil, lattice = elastic(dim, 2), lattice_of((9, 8, 7)[:dim])
    initial = {"u": np.random.default_rng(2).standard_normal((dim, *lattice.shape))}

    def run():
        sim = Simulation(lattice, Elastic(stencil, 1.0), LatticePML(nodes=4), initial, threads=1)
        sim.step(12)
        return sim

    fast = run()
    assert fast.engine.tables.sweep.function
    monkeypatch.setattr("farhorizon.engine.codegen.choose.UNROLLED_LIMIT", 0)
    slow = run()
    assert not slow.engine.tables.sweep.function
    for name in ("levels", "memory"):
        np.testing.assert_allclose(getattr(fast.engine, name), getattr(slow.engine, name), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("shape", "solid"),
    [
        ((15, 40), Elastic(Kernel(2.0), 1.0)),
        ((10, 11, 14), Elastic(Kernel(2.0), 1.0, 0.3, material="correspondence", stabilisation=0.3)),
    ],
    ids=["bonds", "blocks"],
)
def test_two_threads_compute_what_one_does(shape, solid, monkeypatch):
    """Results agree bitwise, layers, periodic copies and damped nodes included."""
    monkeypatch.setattr("farhorizon.engine.engine._PARALLEL_NUMBERS", 0)
    lattice = lattice_of(shape)
    runs = []
    for threads in (1, 2):
        monkeypatch.setattr("farhorizon.simulation.setup.setup.available_threads", lambda n=threads: n)
        sim = Simulation(
            lattice,
            solid,
            {"x-": LatticePML(nodes=4), "x+": Sponge(3)} | dict.fromkeys("yz"[: len(shape) - 1], Periodic()),
            {"u": np.random.default_rng(2).standard_normal((len(shape), *lattice.shape))},
            threads=threads,
        )
        sim.step(9)
        runs.append(sim)
    np.testing.assert_array_equal(*[sim.engine.levels for sim in runs])
    np.testing.assert_array_equal(*[sim.engine.memory for sim in runs])


def by_hand(nodes):
    """A layer that does not depend on the stencil."""
    return LatticePML(nodes=nodes, profile={"sigma": np.linspace(0.1, 2.0, nodes + 1), "alpha": 0.01})


BOUNDARIES = {
    "filtered layers": LatticePML(
        nodes=6, profile=Layer(np.ones(7), np.linspace(0, 1, 7), np.full(7, 0.01), np.linspace(0, 0.5, 6), TAPS)
    ),
    "mixed": {"x-": Sponge(5), "x+": Free(), "y-": by_hand(4), "y+": Fixed()},
    "periodic": {"x": by_hand(5), "y": Periodic()},
}


@pytest.mark.parametrize("boundary", BOUNDARIES.values(), ids=BOUNDARIES)
def test_components_that_do_not_couple_are_scalar_waves(boundary):
    """With multiples of the unit matrix each component is a scalar run, including layers and their filters, sponges,
    sides, and a coefficient.
    """
    lattice, scalar = lattice_of((15, 13)), kernel_stencil(2, 2)
    coefficient = (
        np.where(np.arange(13) < 6, 1.0, 0.5) * np.ones((15, 1))
        if isinstance(boundary, dict) and "x" in boundary
        else None
    )
    u = np.random.default_rng(2).standard_normal((2, *lattice.shape))
    vector = Elastic(Stencil(scalar.offsets, scalar.weights[:, None, None] * np.eye(2)), shear=1 / 3, poisson=0.25)
    assert vector.coefficient == pytest.approx(1.0)
    options = {"coefficient": coefficient, "threads": 1, "dt": 0.3}
    both = Simulation(lattice, vector, boundary, {"u": u}, **options)
    alone = [Simulation(lattice, Wave(scalar), boundary, {"u": part}, **options) for part in u]
    for sim in (both, *alone):
        sim.step(60)
    np.testing.assert_allclose(both.fields["u"], [sim.fields["u"] for sim in alone], rtol=0, atol=1e-12)
    assert both.energy() == pytest.approx(sum(sim.energy() for sim in alone), rel=1e-10)


def test_absent_bonds():
    """In a free body with a crack the operator is the sum over the remaining bonds."""
    shape = (9, 11)
    lattice, stencil = lattice_of(shape), elastic(2, 2)
    u = np.random.default_rng(6).standard_normal((2, *shape))
    sim = Simulation(lattice, Elastic(stencil, 1.0), Free(), {"u": u}, cracks=[[(3.5, 2.2), (3.5, 7.8)]], threads=1)
    expected = np.zeros_like(u)
    for i in itertools.product(*map(range, shape)):
        for o, w in zip(stencil.offsets, stencil.weights, strict=True):
            j = tuple(np.array(i) + o)
            inside = all(0 <= a < n for a, n in zip(j, shape, strict=True))
            if inside and (i[0] < 3.5) != (j[0] < 3.5):
                meets = i[1] + (3.5 - i[0]) / (j[0] - i[0]) * (j[1] - i[1])
                inside = not 2.2 <= meets <= 7.8
            if inside:
                expected[(slice(None), *i)] += w @ (u[(slice(None), *j)] - u[(slice(None), *i)])
    expected *= sim.model.coefficient
    level = sim.engine.apply(sim.engine.current)
    np.testing.assert_allclose(sim.engine.core.view(level)[:, 0], expected, rtol=0, atol=1e-13)


SETUPS = {
    "corners": (lattice_of((7, 8)), LatticePML(nodes=3)),
    "free and periodic": (lattice_of((7, 6)), {"x-": LatticePML(nodes=3), "x+": Free(), "y": Periodic()}),
    "space": (lattice_of((5, 5, 6)), {"x": LatticePML(nodes=2), "y": Fixed(), "z": LatticePML(nodes=2)}),
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name == "space" else name for name in SETUPS]
)
def test_a_state_has_all_that_a_run_needs(name):
    """A run that is set to an earlier state continues bitwise as before, and every entry of the state matters."""
    lattice, boundary = SETUPS[name]
    u = np.random.default_rng(5).standard_normal((lattice.dim, *lattice.shape))
    sim = Simulation(lattice, Elastic(Kernel(2.0), 1.0), boundary, {"u": u}, threads=1)
    sim.step(3)
    state = State(sim.engine)
    before = state.read()
    sim.step(5)
    after = sim.fields["u"]
    sim.engine.tables.layers.slots[:] = 0  # scratch
    np.testing.assert_array_equal(state.read(), state.after(before, 5))
    np.testing.assert_array_equal(sim.fields["u"], after)
    assert np.abs(state.after(np.eye(state.size)[-1])).max() > 0


def test_threads_serve_where_the_memory_of_layers_is_large():
    """A small box in space has more work in its layers than a large square; the state is bitwise that of one thread."""
    wave = Wave(Kernel(2.0))
    square = Simulation(lattice_of((61, 61)), wave, LatticePML(nodes=8), threads=2)
    assert square.engine.threads == 1
    start = np.random.default_rng(0).standard_normal((9, 9, 9))
    one, two = (Simulation(lattice_of((9, 9, 9)), wave, LatticePML(nodes=10), {"u": start}, threads=n) for n in (1, 2))
    assert (one.engine.threads, two.engine.threads) == (1, 2)
    for sim in (one, two):
        sim.step(20)
    np.testing.assert_array_equal(one.engine.levels, two.engine.levels)
    np.testing.assert_array_equal(one.engine.memory, two.engine.memory)

"""Integrators: their closed forms against explicit recursions, and their order in time against exact solutions."""

import numpy as np
import pytest

from farhorizon import Diffusion, InputError, Periodic, Simulation, Source, Wave
from farhorizon.medium.integrators import RK4_REAL_LIMIT, Euler, RungeKutta4, RungeKuttaChebyshev, Verlet, stage_effects
from helpers import fitted_rate, kernel_stencil, lattice_of


def verlet_recursion(symbol, dt, steps, u, v, damping):
    """Velocity Verlet for u'' + 2 d u' + symbol u = 0 in position and velocity, with the damping averaged over the
    step, in long double.

    A half kick with the force at the old position, a drift, a half kick with the new one; the damping acts on the mean
    of the velocities half a step before and after, which is Hermann et al. (2023), eq 42.
    """
    symbol, dt, u, v, damping = (np.longdouble(x) for x in (symbol, dt, u, v, damping))
    half = v + dt / 2 * (-symbol * u - 2 * damping * v)  # velocity at t = dt/2 from a first half step
    u = u + dt * half
    for _ in range(steps - 1):
        half = ((1 - damping * dt) * half - dt * symbol * u) / (1 + damping * dt)
        u = u + dt * half
    return float(u)


OSCILLATORS = {
    "undamped": (1.0, 0.1, 0.0),
    "close to the step limit": (3.99, 1.0, 0.0),
    "weakly damped": (1.0, 0.1, 0.05),
    "overdamped": (1.0, 0.1, 3.0),
    "slow": (1e-8, 0.1, 0.0),
    "slow and damped": (1e-8, 0.1, 0.0125),
    "free flight (double root)": (0.0, 0.1, 0.0),
    "free and damped": (0.0, 0.1, 0.3),
    # the roots of (1 + s) l^2 - (2 - x) l + (1 - s) meet where (2 - x)^2 = 4 (1 - s^2); s = 0.6 gives x = 0.4
    "critically damped (double root)": (0.4, 1.0, 0.6),
    "nearly critically damped": (0.4 * (1 + 1e-9), 1.0, 0.6),
}


@pytest.mark.parametrize(("symbol", "dt", "damping"), OSCILLATORS.values(), ids=OSCILLATORS)
@pytest.mark.parametrize("steps", [1, 2, 7, 1000])
@pytest.mark.parametrize(("u", "v"), [(1.0, 0.0), (0.0, 1.0), (0.7, -1.3)])
def test_propagate_against_the_recursion(symbol, dt, damping, steps, u, v):
    """The closed form for any number of steps equals the recursion; the size of the state bounds the rounding."""
    got = Verlet.propagate(np.array([symbol]), dt, steps, np.array([u]), np.array([v]), damping)
    size = abs(u) + abs(v) * dt * steps
    # Near a double root the two powers cancel by the distance of the roots: 2e-5 for a relative detuning of 1e-9.
    tolerance = 1e-8 if symbol == OSCILLATORS["nearly critically damped"][0] else 1e-12
    assert complex(got[0]).imag == pytest.approx(0, abs=tolerance * size)
    assert complex(got[0]).real == pytest.approx(
        verlet_recursion(symbol, dt, steps, u, v, damping), abs=tolerance * size
    )


def test_propagate_nothing():
    """No step, no change."""
    symbol, u = np.array([0.0, 1.0, 3.0]), np.array([1.0, 2.0, -1.0])
    np.testing.assert_allclose(Verlet.propagate(symbol, 0.1, 0, u, np.ones(3)), u, atol=1e-14)


def test_growth_of_euler_and_runge_kutta():
    """The factors of one step are the Taylor polynomials of exp(-dt symbol) of first and fourth degree."""
    symbol, dt = np.linspace(0, 20, 41), 0.1
    z = -symbol * dt
    np.testing.assert_allclose(Euler.growth(symbol, dt), 1 + z, rtol=1e-14)
    np.testing.assert_allclose(
        RungeKutta4.growth(symbol, dt), 1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24, rtol=1e-13, atol=1e-15
    )


@pytest.mark.parametrize("integrator", [Euler, RungeKutta4])
def test_step_limit_of_first_order_equations(integrator):
    """At the limit the fastest mode keeps its size, just below it decays, just above it grows; slower modes decay."""
    largest = 7.3
    limit = integrator.step_limit(largest)
    assert abs(integrator.growth(largest, limit)) == pytest.approx(1, abs=1e-13)
    assert abs(integrator.growth(largest, 0.999 * limit)) < 1 < abs(integrator.growth(largest, 1.001 * limit))
    assert (np.abs(integrator.growth(np.linspace(0.01, 0.99, 50) * largest, limit)) < 1).all()


def test_runge_kutta_limit_is_the_root_of_its_polynomial():
    """1 - x + x^2/2 - x^3/6 + x^4/24 = 1 has one positive root."""
    roots = np.roots([1 / 24, -1 / 6, 1 / 2, -1])
    assert roots[np.abs(roots.imag) < 1e-9].real == pytest.approx([RK4_REAL_LIMIT], rel=1e-12)


@pytest.mark.parametrize("stages", [2, 3, 10, 57])
def test_chebyshev_polynomial(stages):
    """It agrees with exp(z) to second order, stays below 1 on the whole stable interval, and exceeds 1 beyond."""
    integrator = RungeKuttaChebyshev(stages)
    z = np.array([1e-3, 2e-3])
    errors = np.abs(integrator.growth(z, 1.0) - np.exp(-z))
    assert np.log2(errors[1] / errors[0]) == pytest.approx(3, abs=0.1)
    limit = integrator.step_limit(1.0)
    assert (np.abs(integrator.growth(np.linspace(0.01, 1, 2001), limit)) <= 1).all()
    if stages % 2 == 0:  # an odd polynomial decreases beyond, and is small for a while
        assert abs(integrator.growth(1.0, 1.02 * limit)) > 1
    # Verwer's bound 2/3 (s^2 - 1) (1 - 2/15 eps) with eps = 2/13 (Sommeijer et al. 1998, section 2.1) is of leading
    # order in eps
    assert limit == pytest.approx(2 / 3 * (stages**2 - 1) * (1 - 4 / 195), rel=0.02)


@pytest.mark.parametrize(
    "integrator", [Euler(), RungeKutta4(), RungeKuttaChebyshev(2), RungeKuttaChebyshev(9)], ids=repr
)
def test_stage_effects_add_up_to_the_step(integrator):
    """A constant flow into every stage adds dt times itself; sources have the scales of the operator."""
    stages = integrator.stages(0.3)
    scales = np.array([n[2] for n in stages.numbers])
    assert stage_effects(stages) @ scales == pytest.approx(0.3, rel=1e-12)


@pytest.mark.parametrize("integrator", [Euler(), RungeKutta4(), RungeKuttaChebyshev(7)], ids=repr)
def test_samples_of_prescribed_nodes(integrator):
    """After the last stage a prescribed node has its value at the end of the step; the weights of each stage add up to
    1.
    """
    times, weights = integrator.prescribed_samples(0.2)
    assert weights[-1] @ np.array(times) == pytest.approx(0.2, rel=1e-14)
    assert weights.shape == (len(integrator.stages(0.2).numbers), len(times))
    assert weights.sum(1) == pytest.approx(1.0, rel=1e-14)


def test_bad_stages():
    with pytest.raises(InputError, match="2 to 1000"):
        RungeKuttaChebyshev(1)
    with pytest.raises(InputError, match="unknown integrator"):
        Diffusion(kernel_stencil(1, 2), 1.0, "leapfrog")


def test_step_limit_of_verlet():
    """Just below the limit 2/omega a wave stays bounded, just above it grows exponentially."""
    limit = Verlet.step_limit(9.0)
    assert limit == pytest.approx(2 / 3, rel=1e-15)
    sizes = [
        np.abs(Verlet.propagate(np.array([9.0]), f * limit, 2000, np.ones(1), np.zeros(1))[0]) for f in (0.999, 1.001)
    ]
    assert sizes[0] < 30 and sizes[1] > 1e6


# Order in time, on a periodic lattice with an eigenmode of the operator

NODES, SPACING, COEFFICIENT, FREQUENCY = 24, 0.5, 1.7, 3.0
WAVE_NUMBERS = {1: (3,), 2: (2, 1)}


def eigenmode(dim):
    """Stencil, lattice, sine mode and its rate, the symbol of the stencil: the mode is exact on the lattice."""
    stencil = kernel_stencil(dim, 2, 2)
    lattice = lattice_of((NODES,) * dim, SPACING)
    angles = [2 * np.pi * n / NODES for n in WAVE_NUMBERS[dim]]
    phase = sum(a * x / SPACING for a, x in zip(angles, lattice.coordinates(), strict=True))
    return stencil, lattice, np.sin(phase + 0.3), float(stencil.symbol(*angles)) * COEFFICIENT / SPACING**2


def final_error(dim, make_model, steps, until, exact, sources=(), start=1.0):
    """Largest error of the mode after `steps` steps."""
    stencil, lattice, mode, _ = eigenmode(dim)
    sim = Simulation(
        lattice,
        make_model(stencil),
        Periodic(),
        {"u": start * mode},
        sources=[s(mode) for s in sources],
        dt=until / steps,
    )
    sim.step(steps)
    assert sim.time == pytest.approx(until)
    return float(np.abs(sim.fields["u"] - exact(until) * mode).max())


def decay(rate, start=1.0, forced=False):
    """Exact solution of u' = -rate u + sin(FREQUENCY t)."""
    w = FREQUENCY if forced else 0.0
    size = 1.0 if forced else 0.0

    def response(t):
        return (rate * np.sin(w * t) - w * np.cos(w * t) + w * np.exp(-rate * t)) / (rate**2 + w**2)

    return lambda t: start * np.exp(-rate * t) + size * response(t)


def oscillation(rate, start=1.0, forced=False):
    """Exact solution of u'' = -rate u + sin(FREQUENCY t), at rest at t = 0."""
    own, w = np.sqrt(rate), FREQUENCY
    size = 1.0 if forced else 0.0
    return lambda t: start * np.cos(own * t) + size * (np.sin(w * t) - w / own * np.sin(own * t)) / (own**2 - w**2)


SOURCES = {
    "no source": (),
    "separable source": (lambda mode: Source(mode, np.vectorize(lambda t: np.sin(FREQUENCY * t))),),
    "general source": (lambda mode: Source(lambda *args: mode * np.sin(FREQUENCY * args[-1])),),
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("sources", SOURCES.values(), ids=SOURCES)
@pytest.mark.parametrize("dim", [1, 2])
@pytest.mark.parametrize(
    ("make_model", "solution", "order", "counts"),
    [
        (lambda s: Diffusion(s, COEFFICIENT), decay, 1, (64, 128, 256, 512)),
        (lambda s: Wave(s, np.sqrt(COEFFICIENT)), oscillation, 2, (32, 64, 128, 256)),
        (lambda s: Diffusion(s, COEFFICIENT, "rk4"), decay, 4, (32, 48, 64, 96)),
        (lambda s: Diffusion(s, COEFFICIENT, RungeKuttaChebyshev(5)), decay, 2, (64, 128, 256, 512)),
        (lambda s: Diffusion(s, COEFFICIENT, RungeKuttaChebyshev(12)), decay, 2, (16, 32, 64, 128)),
    ],
    ids=["Euler", "Verlet", "RK4", "RKC 5", "RKC 12"],
)
def test_order_in_time(make_model, solution, order, counts, dim, sources):
    """Euler 1, velocity Verlet 2, Runge-Kutta 4, Runge-Kutta-Chebyshev 2, also with a time-dependent source; space is
    exact in an eigenmode.
    """
    _, _, _, rate = eigenmode(dim)
    until = 0.6
    exact = solution(rate, forced=bool(sources))
    errors = [final_error(dim, make_model, n, until, exact, sources) for n in counts]
    assert fitted_rate(until / np.array(counts), errors) == pytest.approx(order, abs=0.12)


@pytest.mark.parametrize(
    ("name", "integrator"),
    [
        ("euler", Euler),
        ("rk4", RungeKutta4),
        ("rkc", RungeKuttaChebyshev()),
        *((RungeKuttaChebyshev(s),) * 2 for s in (2, 3, 51)),
    ],
)
def test_a_run_multiplies_an_eigenmode_by_the_growth_factor(name, integrator):
    """The compiled stages are the method whose growth factor the analysis uses."""
    stencil, lattice, mode, rate = eigenmode(2)
    dt = 0.4 * integrator.step_limit(rate)
    dt = min(dt, 0.5 * integrator.step_limit(stencil.symbol_maximum * COEFFICIENT / SPACING**2))
    sim = Simulation(lattice, Diffusion(stencil, COEFFICIENT, name), Periodic(), {"u": mode}, dt=dt)
    sim.step(10)
    np.testing.assert_allclose(sim.fields["u"], integrator.growth(rate, dt) ** 10 * mode, atol=1e-14)


@pytest.mark.parametrize("damping", [0.0, 0.4])
@pytest.mark.parametrize("dim", [1, 2])
def test_a_run_of_verlet_is_propagate(dim, damping):
    """Initial displacement and velocity, with and without damping, in increments (1D) and two levels (2D)."""
    stencil, lattice, mode, rate = eigenmode(dim)
    sim = Simulation(
        lattice, Wave(stencil, np.sqrt(COEFFICIENT), damping), Periodic(), {"u": 0.7 * mode, "v": -1.3 * mode}
    )
    sim.step(50)
    factor = Verlet.propagate(np.array([rate]), sim.dt, 50, np.array([0.7]), np.array([-1.3]), damping)[0].real
    np.testing.assert_allclose(sim.fields["u"], factor * mode, atol=1e-13)


@pytest.mark.parametrize("damping", [0.0, 0.4])
@pytest.mark.parametrize("dim", [1, 2])
def test_velocity_shown_is_that_of_half_a_step_ago(dim, damping):
    """v = (u(n) - u(n-1)) / dt at every step, and at time zero v - dt/2 (acceleration of the undamped part), with v
    raised by the damping share.
    """
    stencil, lattice, mode, rate = eigenmode(dim)
    sim = Simulation(
        lattice, Wave(stencil, np.sqrt(COEFFICIENT), damping), Periodic(), {"u": 0.7 * mode, "v": -1.3 * mode}
    )
    start = -1.3 * (1 + damping * sim.dt) + sim.dt / 2 * rate * 0.7
    np.testing.assert_allclose(sim.fields["v"], start * mode, atol=1e-12)
    before = 0.7 * mode
    for _ in range(3):
        sim.step()
        now = sim.fields
        np.testing.assert_allclose(now["v"], (now["u"] - before) / sim.dt, atol=1e-12)
        before = now["u"]


def test_runge_kutta_with_sources_is_the_classical_method():
    """The nested stages and their source weights give k1 .. k4 of the textbook, to rounding."""
    stencil, lattice, mode, rate = eigenmode(1)
    force = lambda t: np.exp(0.3 * t) * np.cos(5 * t)  # noqa: E731
    sim = Simulation(
        lattice, Diffusion(stencil, COEFFICIENT, "rk4"), Periodic(), {"u": mode}, sources=[Source(mode, force)]
    )
    sim.step(20)
    u, t, dt = 1.0, 0.0, sim.dt
    slope = lambda t, u: -rate * u + force(t)  # noqa: E731
    for _ in range(20):
        k1 = slope(t, u)
        k2 = slope(t + dt / 2, u + dt / 2 * k1)
        k3 = slope(t + dt / 2, u + dt / 2 * k2)
        k4 = slope(t + dt, u + dt * k3)
        u, t = u + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4), t + dt
    np.testing.assert_allclose(sim.fields["u"], u * mode, atol=1e-14)

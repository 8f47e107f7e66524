"""The fully discrete boundary against chains from which nothing returns, with the same time step."""

import numpy as np
import pytest

from chains import BAR, BEAM, gaussian_weights, long_chain, recursion_at
from farhorizon import InputError
from farhorizon.analysis.exact.chain import Recursion, force_form, ghost_kernel, largest_angle
from farhorizon.analysis.exact.exponential_sum import compress
from farhorizon.medium.integrators import Euler, Verlet
from farhorizon.papers.bar import Bar, bonds_of
from farhorizon.papers.ji2021 import BarExample

# Examples of Ji et al. (2021): bar, interfaces, seismic source.
EXAMPLES = {"bar": BarExample(), "interface": BarExample(soft=0.1), "seismic": BarExample(seismic=True)}


def kernel_of(weights, recursion, steps):
    return force_form(ghost_kernel(weights, recursion, steps), weights)


@pytest.mark.parametrize("name", EXAMPLES)
@pytest.mark.parametrize(
    ("last", "dt", "bound"),
    # required: 1e-13 at t = 40, 1e-12 at t = 400
    [(40.0, 0.005, 1e-13), (400.0, 0.02, 1e-12)],
)
def test_published_examples(name, last, dt, bound):
    """Error of the boundary at two times, the second being the last."""
    example, times = EXAMPLES[name], (0.3 * last, last)
    kernel = kernel_of(BAR, Recursion.of(Verlet(), dt), round(last / dt) + 1)
    truncated, infinite = (example.run(dt, times, k)[0] for k in (kernel, None))
    assert np.abs(truncated - infinite).max() <= bound


RANDOM = [
    ("wave", 0.2, 1500),
    ("wave", 0.95, 1500),
    ("damped", 0.2, 1500),
    ("diffusion", 0.45, 3000),
    ("diffusion", 0.95, 3000),
]


@pytest.mark.sampled(3)
@pytest.mark.parametrize("reach", [1, 2, 7, 25])
@pytest.mark.parametrize(("kind", "share", "steps"), RANDOM)
def test_random_data_on_the_whole_near_field(reach, kind, share, steps):
    """Data include the drivers, and random velocities; 1e-12 is required."""
    weights, rng = gaussian_weights(reach), np.random.default_rng(reach)
    recursion = recursion_at(weights, kind, share)
    u = rng.uniform(-1, 1, 101)
    increment = None if kind == "diffusion" else 0.1 * rng.uniform(-1, 1, 101)
    kernel = kernel_of(weights, recursion, steps)
    infinite, near = long_chain(weights, recursion, u, steps, increment)
    truncated = Bar(weights, recursion, u, increment, ends=(kernel, kernel))
    for _ in range(3):
        assert np.abs(truncated.run(steps // 3) - infinite.run(steps // 3)[near]).max() <= 1e-12


@pytest.mark.parametrize("block", [None, 1, 48])
def test_ways_to_convolve(block):
    """A direct sum and blocks of any size agree to rounding."""
    recursion = recursion_at(BAR, "wave", 0.4)
    kernel = kernel_of(BAR, recursion, 200)
    u = np.random.default_rng(6).uniform(-1, 1, 30)
    one, other = (Bar(BAR, recursion, u, ends=(kernel, kernel), block=b).run(200) for b in (64, block))
    assert np.abs(one - other).max() < 1e-13


def test_pieces_of_a_run_are_the_run():
    """A run may stop anywhere within a block."""
    recursion = recursion_at(BAR, "damped", 0.4)
    kernel = kernel_of(BAR, recursion, 300)
    u = np.random.default_rng(7).uniform(-1, 1, 30)
    whole, parts = (Bar(BAR, recursion, u, ends=(kernel, kernel)) for _ in range(2))
    whole.run(300)
    for count in (1, 62, 3, 100, 134):
        parts.run(count)
    np.testing.assert_array_equal(whole.u, parts.u)


@pytest.mark.parametrize("kind", ["wave", "diffusion"])
def test_exact_on_one_end_only(kind):
    """The opposite end is free; the exact one is a convolution, or a sum of exponentials."""
    recursion = recursion_at(BAR, kind, 0.4)
    kernel = kernel_of(BAR, recursion, 800)
    found = compress(kernel, 1e-11, largest_angle(BAR, recursion))
    u = np.exp(-((np.arange(50) - 20.0) ** 2) / 9)
    infinite, near = long_chain(BAR, recursion, u, 800, right=False)
    expected = infinite.run(800)[near]
    assert np.abs(Bar(BAR, recursion, u, ends=(kernel, None)).run(800) - expected).max() < 1e-12
    assert np.abs(Bar(BAR, recursion, u, ends=(found, None)).run(800) - expected).max() < 1e-10


def test_beam():
    """The stencil is biharmonic, and the data are random."""
    recursion = recursion_at(BEAM, "wave", 0.6)
    u = np.random.default_rng(8).uniform(-1, 1, 20)
    kernel = kernel_of(BEAM, recursion, 1000)
    infinite, near = long_chain(BEAM, recursion, u, 1000)
    assert np.abs(Bar(BEAM, recursion, u, ends=(kernel, kernel)).run(1000) - infinite.run(1000)[near]).max() < 1e-12


def test_weight_of_the_first_sample_matters():
    """With weight 1 instead of 1/2 data on the drivers cause an error of the order of dt; with the right weight,
    none.
    """
    recursion = recursion_at(BAR, "wave", 0.4)
    kernel, u = kernel_of(BAR, recursion, 200), np.ones(20)
    infinite, near = long_chain(BAR, recursion, u, 200)
    expected = infinite.run(200)[near]
    assert np.abs(Bar(BAR, recursion, u, ends=(kernel, kernel)).run(200) - expected).max() < 1e-13
    assert np.abs(Bar(BAR, recursion, u, ends=(kernel, kernel), first=1.0).run(200) - expected).max() > 1e-3


def test_damping_beyond_one_a_step():
    """For d dt = 1.5 a step reverses the increment (keep < 0)."""
    recursion = Recursion.of(Verlet(), 0.1, 15.0)
    assert recursion.keep < 0
    u = np.random.default_rng(11).uniform(-1, 1, 20)
    kernel = kernel_of(BAR, recursion, 400)
    infinite, near = long_chain(BAR, recursion, u, 400)
    assert np.abs(Bar(BAR, recursion, u, ends=(kernel, kernel)).run(400) - infinite.run(400)[near]).max() <= 1e-12


def test_first_step_is_the_integrator():
    """``u + (1 - d dt) dt v + dt^2/2 A u`` (Verlet), ``u + dt A u`` (Euler)."""
    rng = np.random.default_rng(9)
    u, v, dt, d = rng.standard_normal(12), rng.standard_normal(12), 0.05, 0.7
    operator = np.zeros((12, 12))
    bonds = bonds_of(BAR, 12)
    for k in range(1, 8):
        operator += np.diag(bonds[k - 1, : 12 - k], k) + np.diag(bonds[k - 1, : 12 - k], -k)
    operator -= np.diag(operator.sum(1))
    verlet = Bar(BAR, Recursion.of(Verlet(), dt, d), u, dt * v).run(1)
    np.testing.assert_allclose(verlet, u + (1 - d * dt) * dt * v + dt**2 / 2 * operator @ u, atol=1e-13)
    np.testing.assert_allclose(Bar(BAR, Recursion.of(Euler(), 0.01), u).run(1), u + 0.01 * operator @ u, atol=1e-13)


def test_rounding_does_not_drift():
    """In increments a bar at rest at 1 remains there exactly."""
    recursion = recursion_at(BAR, "wave", 0.3)
    np.testing.assert_array_equal(Bar(BAR, recursion, np.ones(40)).run(5000), np.ones(40))


def test_bad_input():
    recursion = recursion_at(BAR, "wave", 0.3)
    with pytest.raises(InputError, match="shorter than its stencil"):
        Bar(BAR, recursion, np.ones(6))
    kernel = kernel_of(BAR, recursion, 100)
    with pytest.raises(InputError, match="outlives"):
        Bar(BAR, recursion, np.ones(20), ends=(kernel, kernel)).run(101)

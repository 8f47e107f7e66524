"""Compression of the force kernel: number of modes, accuracy, and stability for unlimited times."""

import numpy as np
import pytest

from chains import BAR, BEAM, gaussian_weights, recursion_at
from farhorizon import InputError, Stencil
from farhorizon.analysis.exact.chain import Recursion, force_form, ghost_kernel, largest_angle
from farhorizon.analysis.exact.exponential_sum import ExponentialSum, compress, force_error
from farhorizon.analysis.references.infinite_lattice import InfiniteLattice
from farhorizon.medium.integrators import Verlet
from farhorizon.papers.bar import Bar

X = 0.1 * np.arange(-100, 101)


@pytest.fixture(scope="module")
def kernel_to_40():
    return force_form(ghost_kernel(BAR, Recursion.of(Verlet(), 0.005), 8000), BAR)


@pytest.mark.parametrize(("tolerance", "modes"), [(1e-6, 12), (1e-9, 20), (1e-12, 25)])
def test_modes_of_the_bar_to_40(kernel_to_40, tolerance, modes):
    """At 1e-9 the aim is at most 20 modes. The bounds 12 and 25 are the numbers of an independent program, 11 modes
    for 1e-6 and 25 for 3e-14, the first with one in reserve.
    """
    recursion = Recursion.of(Verlet(), 0.005)
    found = compress(kernel_to_40, tolerance, largest_angle(BAR, recursion))
    assert found.modes <= modes
    assert found.error <= tolerance
    assert np.abs(found.poles).max() <= 1
    u = np.exp(-(X**2))
    exact, compressed = (Bar(BAR, recursion, u, ends=(e, e)).run(8000) for e in (kernel_to_40, found))
    assert np.abs(exact - compressed).max() <= tolerance


def test_error_is_the_largest_over_bounded_histories(kernel_to_40):
    """The history whose signs follow those of the error attains it, and random histories do not exceed it."""
    kernel = kernel_to_40[:501]
    found = compress(kernel, 1e-5, 0.04)
    difference = np.concatenate([np.zeros((1, 7, 7)), found.kernel(np.arange(1, 501)) - kernel[1:]])
    size = np.abs(kernel[1:]).sum((0, 2)).max()
    worst = max(float((difference[:, i] * np.sign(difference[:, i])).sum()) for i in range(7))
    assert worst / size == pytest.approx(found.error, rel=1e-9)
    histories = np.random.default_rng(1).uniform(-1, 1, (20, 501, 7))
    assert np.abs(np.einsum("aim,ham->hi", difference, histories)).max() / size <= found.error


def test_update_is_the_convolution(kernel_to_40):
    """`advance` and `force` against the sum over the compressed kernel, with the first sample weighted."""
    found = compress(kernel_to_40[:201], 1e-8, 0.04)
    samples = np.random.default_rng(3).standard_normal((30, 7))
    kernel = np.concatenate([np.zeros((1, 7, 7)), found.kernel(np.arange(1, 40))])
    state = np.zeros(found.modes, complex)
    for n, sample in enumerate(samples):
        weights = np.where(np.arange(n) == 0, 0.5, 1.0)
        expected = sum((w * kernel[n - j] @ samples[j] for j, w in enumerate(weights)), np.zeros(7))
        np.testing.assert_allclose(found.force(state), expected, atol=1e-12)
        state = found.advance(state, sample, 0.5 if n == 0 else 1.0)
    weighted = samples * np.where(np.arange(30) == 0, 0.5, 1.0)[:, None]
    np.testing.assert_allclose(found.replay(weighted), state, atol=1e-12)


@pytest.mark.parametrize("reach", [2, *[pytest.param(reach, marks=pytest.mark.slow) for reach in (7, 25)]])
@pytest.mark.parametrize(("kind", "share"), [("wave", 0.2), ("damped", 0.2), ("diffusion", 0.45)])
def test_default_tolerance_for_all_schemes(reach, kind, share):
    """The default tolerance of 1e-12 is reached for narrow and wide stencils, waves, damped waves and diffusion."""
    weights = gaussian_weights(reach)
    recursion = recursion_at(weights, kind, share)
    found = compress(force_form(ghost_kernel(weights, recursion, 600), weights), band=largest_angle(weights, recursion))
    assert found.error <= 1e-12
    assert np.abs(found.poles).max() <= 1


def test_beam():
    """The biharmonic stencil: bending waves, with one evanescent root of two."""
    recursion = recursion_at(BEAM, "wave", 0.3)
    found = compress(force_form(ghost_kernel(BEAM, recursion, 2000), BEAM), 1e-9, largest_angle(BEAM, recursion))
    assert found.error <= 1e-9


@pytest.mark.parametrize("tolerance", [*(pytest.param(one, marks=pytest.mark.slow) for one in (1e-6, 1e-9)), 1e-12])
def test_bounded_over_a_million_steps(kernel_to_40, tolerance):
    """A sum fitted to 8000 steps is run for 1e6, by declaring it valid for so many.

    The Gaussian leaves an offset no larger than the error of the sum. Noise does not grow, although it excites the
    flat top of the band, whose waves hardly move.
    """
    recursion = Recursion.of(Verlet(), 0.005)
    found = compress(kernel_to_40, tolerance, largest_angle(BAR, recursion))
    for_ever = ExponentialSum(found.poles, found.inputs, found.outputs, 10**6, found.error)
    bar = Bar(BAR, recursion, np.exp(-(X**2)), ends=(for_ever, for_ever))
    sizes = [np.abs(bar.run(250_000)).max() for _ in range(4)]
    assert max(sizes) <= tolerance
    noise = Bar(BAR, recursion, np.random.default_rng(4).uniform(-1, 1, 51), ends=(for_ever, for_ever))
    assert max(np.abs(noise.run(250_000)).max() for _ in range(4)) <= 1


def test_a_run_outlives_its_sum(kernel_to_40):
    """The run is refused beyond the steps of its sum. Exchanged for a longer sum, with the history of the drivers, it
    continues as with the exact kernel.
    """
    recursion = Recursion.of(Verlet(), 0.005)
    short, long = (compress(kernel_to_40[: n + 1], 1e-11, largest_angle(BAR, recursion)) for n in (400, 1200))
    u = np.exp(-(X[70:131] ** 2))
    bar = Bar(BAR, recursion, u, ends=(short, short))
    history = []
    for _ in range(400):
        history.append(bar.u.copy())
        bar.run(1)
    with pytest.raises(InputError, match="outlives"):
        bar.run(1)
    samples = np.array(history)
    samples[0] *= recursion.first
    bar.exchange((long, long), (samples[:, :7], samples[:, :-8:-1]))
    kernel = kernel_to_40[:1201]
    assert np.abs(bar.run(800) - Bar(BAR, recursion, u, ends=(kernel, kernel)).run(1200)).max() < 1e-10


def test_what_cannot_be_had_is_said(kernel_to_40):
    """For a tolerance below rounding the best sum is returned, with its true error."""
    kernel = kernel_to_40[:801]
    found = compress(kernel, 1e-17, 0.04)
    assert 1e-17 < found.error < 1e-11
    assert found.error == pytest.approx(force_error(kernel, found), rel=1e-12)


def test_bad_input(kernel_to_40):
    lopsided = kernel_to_40[:100].copy()
    lopsided[5, 0, 1] += 1
    with pytest.raises(InputError, match="symmetric"):
        compress(lopsided)
    with pytest.raises(InputError, match="positive"):
        compress(kernel_to_40[:100], 0.0)
    with pytest.raises(InputError, match="too few"):
        compress(kernel_to_40[:5])


@pytest.mark.slow
def test_modes_of_the_bar_to_3000():
    """At most 34 modes at 1e-9 with dt = 0.02 (150000 steps), and the bar agrees with the closed form of the infinite
    lattice.
    """
    recursion, steps = Recursion.of(Verlet(), 0.02), 150_000
    kernel = force_form(ghost_kernel(BAR, recursion, steps), BAR)
    found = compress(kernel, 1e-9, largest_angle(BAR, recursion))
    assert found.modes <= 34 and found.error <= 1e-9 and np.abs(found.poles).max() <= 1
    u = np.exp(-(X**2))
    offsets = np.concatenate([np.arange(1, 8), -np.arange(1, 8)])[:, None]
    infinite = InfiniteLattice(Stencil(offsets, np.tile(BAR, 2)), 1.0, Verlet(), 0.02, steps, u)
    bar = Bar(BAR, recursion, u, ends=(found, found))
    for mark in (75_000, steps):
        assert np.abs(bar.run(mark - bar.step) - infinite.after(mark)).max() < 1e-9

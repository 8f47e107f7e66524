"""The damping of short waves that makes layers stable for every kernel: its filter, its strength, its cost in
accuracy, and long runs from noise.
"""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.layers.short_waves import HighPass, high_pass
from farhorizon.analysis.references.infinite_lattice import InfiniteLattice
from farhorizon.checks.certificate import certify
from farhorizon.checks.reduced_setups import Strip
from farhorizon.engine.state import State
from helpers import kernel_stencil

BACKWARD = [(1, 2, 0), (1, 3, 0), (2, 2, 0), (2, 3, 0), (2, 2, 1), (2, 3, 1)]  # dimension, reach, exponent


def test_filter_lets_short_waves_through_and_nothing_else():
    """The response is 0 to the order `rise` for long waves, 1 to the order `fall` for the shortest, and always from 0
    to 1; the taps are its Fourier series.
    """
    found = HighPass(10, 8, 1.0, 1.0)
    angles = np.linspace(0, np.pi, 201)
    passed = found.passed(angles)
    assert (np.diff(passed) >= 0).all() and passed[0] == 0 and passed[-1] == 1
    small = np.array([0.02, 0.04])
    assert np.log2(found.passed(small)[1] / found.passed(small)[0]) == pytest.approx(20, abs=0.01)  # y^10 = (k/2)^20
    taps = found.taps()
    assert len(taps) == 18
    series = taps[0] + 2 * np.cos(np.outer(angles, np.arange(1, 18))) @ taps[1:]
    assert np.abs(series - passed).max() <= 1e-14


@pytest.mark.parametrize("dim, reach, exponent", BACKWARD)
def test_rate_stops_every_backward_wave(dim, reach, exponent):
    """On an independent grid, sum_a f(k_a) nu >= 2 gamma sigma wherever gamma, the larger one of all axes, is
    positive.
    """
    stencil = kernel_stencil(dim, reach, exponent)
    found = high_pass(stencil)
    grid = np.ix_(*[np.linspace(0.003, np.pi - 0.003, 101)] * dim)
    value = stencil.symbol(*grid)
    gamma = np.max([-np.sin(a) * stencil.symbol_gradient(i, *grid) / (2 * value) for i, a in enumerate(grid)], axis=0)
    damped = found.strength * sum(found.passed(a) for a in grid)
    assert gamma.max() > 0 and (damped >= 2 * gamma).all()
    assert found.strength <= 1.25  # at most sigma, and a margin of a quarter


def test_filters_without_a_rise_or_a_fall_are_steps():
    """Their limit is not defined in every version of SciPy."""
    angles = np.array([0.0, 1e-3, 1.0, np.pi])
    np.testing.assert_array_equal(HighPass(0, 18, 1.0, 1.0).passed(angles), [0, 1, 1, 1])
    np.testing.assert_array_equal(HighPass(18, 0, 1.0, 1.0).passed(angles), [0, 0, 0, 1])


def test_stencils_without_backward_waves_are_left_alone():
    assert high_pass(kernel_stencil(2, 3, 2)) is None and high_pass(fh.Stencil.finite_difference(3)) is None
    sim = fh.Simulation(fh.Lattice(1.0, (0.0, 0.0), (8.0, 8.0)), fh.Wave(fh.Kernel(3.0)))
    assert not next(iter(sim.engine.layers.values())).damping.size


def pulse_error(stencil, nodes):
    """Error over four crossings for a Gaussian whose spectrum is 1.5e-5 at 8 nodes a wave or at 60 % of the first
    backward wavenumber.
    """
    dim = stencil.dim
    width = 4.71 / min(np.pi / 4, 0.6 * high_pass(stencil).first)  # exp(-(4.71)^2/2) = 1.5e-5
    half = int(np.ceil(7.5 * width))
    lattice = fh.Lattice(1.0, (-float(half),) * dim, (float(half),) * dim)
    start = np.exp(-sum(x**2 for x in lattice.coordinates()) / (2 * width**2))
    sim = fh.Simulation(lattice, fh.Wave(stencil), fh.LatticePML(nodes=nodes), initial={"u": start}, threads=1)
    last = int(4 * half / sim.dt)
    infinite = InfiniteLattice(stencil, 1.0, sim.model.integrator, sim.dt, last, start)
    errors = []
    for share in (0.25, 0.4, 0.45, 0.5, 0.6, 0.8, 1.0):
        sim.step(int(share * last) - sim.step_count)
        errors.append(np.abs(sim.fields["u"] - infinite.after(sim.step_count)).max())
    return max(errors)


@pytest.mark.parametrize("nodes, limit", [(16, 1e-6), (30, 1e-8)])
@pytest.mark.parametrize("dim, reach, exponent", BACKWARD)
def test_resolved_pulses_hardly_notice(dim, reach, exponent, nodes, limit):
    assert pulse_error(kernel_stencil(dim, reach, exponent), nodes) <= limit


@pytest.mark.parametrize("nodes, limit", [(16, 1e-6), (30, 1e-8)])
def test_resolved_pulses_hardly_notice_on_finite_elements(nodes, limit):
    assert pulse_error(fh.Stencil.finite_element(2), nodes) <= limit


@pytest.mark.parametrize("reach", [3, 5, 8])
def test_waves_that_stand_still_decay(reach):
    """In 1D, exponent 1 with constant influence has no backward waves, but its group velocity touches zero, and layers
    without damping grew by 0.005 to 0.04.
    """
    stencil = kernel_stencil(1, reach, 1)
    angle = np.linspace(0.3, np.pi - 0.3, 4001)
    slope = stencil.symbol_gradient(0, angle)
    assert not stencil.backward_waves() and slope.min() < 1e-4 * slope.max()
    assert angle[np.argmin(slope)] >= high_pass(stencil).first - 0.1
    nodes = max(16, 4 * reach)
    sim = fh.Simulation(
        fh.Lattice(1.0, (0.0,), (2.0 * reach + 4,)), fh.Wave(stencil), fh.LatticePML(nodes=nodes), threads=1
    )
    assert Strip(sim, 0, 2 * reach + 1).growth().stable
    assert reach > 6 or pulse_error(stencil, nodes) <= 1e-6


WIDE = [
    (1, 10, 1, 16),
    (1, 6, 0, None),
    *[
        pytest.param(*case, marks=pytest.mark.slow)
        for case in [
            (1, 9, 1, 36),
            (1, 11, 1, None),
            (1, 12, 1, None),
            (2, 7, 1, None),
            (2, 8, 1, None),
            (2, 9, 1, None),
            (2, 10, 1, None),
        ]
    ],
]


@pytest.mark.parametrize("dim, reach, exponent, nodes", WIDE)
def test_layers_of_wide_kernels_decay(dim, reach, exponent, nodes):
    """The modes between two sides, for which the ramp for reach 6 grew by 3e-4 to 3e-2 c/spacing."""
    model = fh.Wave(kernel_stencil(dim, reach, exponent))
    sim = fh.Simulation(
        fh.Lattice(1.0, (0.0,) * dim, (2.0 * reach + 4,) * dim), model, fh.LatticePML(nodes=nodes), threads=1
    )
    strip = Strip(sim, 0, 2 * reach + 1)
    for along in [(0.005,), (0.3,), (0.6,), (1.8,), (np.pi,)] if dim == 2 else [()]:
        assert strip.growth(*along).stable


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "reach, exponent, influence", [(11, 1, "linear"), (12, 1, "linear"), (12, 2, "constant"), (8, 1, "gaussian")]
)
def test_wide_kernels_without_backward_waves_absorb_and_do_not_grow(reach, exponent, influence):
    """With a longer entrance of half the strength the first three grew by 0.02 to 0.1 c/spacing; it reflected 1e-7 of
    the waves of the last one.
    """
    sim = fh.Simulation(
        fh.Lattice(1.0, (0.0,), (6.0 * reach,)),
        fh.Wave(fh.Kernel(float(reach), exponent, influence)),
        fh.LatticePML(nodes=4 * reach),
        threads=1,
    )
    assert sim.certificate().verdict == "certified"
    assert abs(Strip(sim, 0, 2 * reach + 1).reflection(4.0 * reach, 0.0)) < 1e-9


def test_a_layer_that_would_absorb_next_to_nothing_is_not_made_gentle():
    """For exponent 0 and a reach of 25 no ramp is short enough, and the certificate refuses the usual one."""
    sim = fh.Simulation(
        fh.Lattice(1.0, (0.0,), (60.0,)), fh.Wave(kernel_stencil(1, 25, 0)), fh.LatticePML(nodes=25), threads=1
    )
    assert next(iter(sim.engine.layers.values())).sigma.max() > 1
    assert sim.certificate().verdict == "not certified"


@pytest.mark.parametrize(
    "operator", [fh.Kernel(3.0, 0), fh.Kernel(3.0, 1), fh.Kernel(2.0, 0), fh.Stencil.finite_element(2)], ids=repr
)
def test_certified_with_corners(operator):
    """Cases that grew without the damping: sides at all tangential wavenumbers, and corners from noise."""
    sim = fh.Simulation(fh.Lattice(1.0, (0.0, 0.0), (8.0, 8.0)), fh.Wave(operator), fh.LatticePML(nodes=12))
    found = certify(sim, budget=60.0)
    assert found.verdict == "certified", str(found)


@pytest.mark.parametrize(
    "dim, reach, exponent", [pytest.param(*case, marks=pytest.mark.slow) for case in [*BACKWARD, (3, 2, 2), (3, 3, 2)]]
)
def test_white_noise_of_the_whole_state_decays(dim, reach, exponent):
    """Noise in all nodes and all memory over 1e5 steps in 1D and 2D, 5000 in 3D. It rises at first, because most of
    the random memory is not the past of any field.
    """
    side, steps = 2.0 * reach + 3, 100_000 if dim < 3 else 5000
    model = fh.Wave(kernel_stencil(dim, reach, exponent))
    sim = fh.Simulation(fh.Lattice(1.0, (0.0,) * dim, (side,) * dim), model, fh.LatticePML(nodes=10), threads=1)
    state = State(sim.engine)
    noise = np.random.default_rng(0).standard_normal(state.size)
    sizes = [float(np.linalg.norm(noise))]
    for _ in range(3):
        noise = state.after(noise, steps // 3)
        sizes.append(float(np.linalg.norm(noise)))
    assert sizes[3] < sizes[2] < sizes[1]

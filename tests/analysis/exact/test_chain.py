"""Kernels of the half-infinite chain, computed in two independent ways and compared with closed forms, symmetry and
sum rules.
"""

import numpy as np
import pytest
from scipy import special

from chains import BAR, BEAM, gaussian_weights, recursion_at
from farhorizon import InputError, Kernel, Stencil
from farhorizon.analysis.exact.chain import (
    Recursion,
    driver_matrix,
    force_form,
    fronts,
    ghost_kernel,
    ground,
    half_weights,
    largest_angle,
    run_kernel,
    surface_response,
    symbol,
    transform_kernel,
)
from farhorizon.engine.chain_loops import chain_responses
from farhorizon.medium.integrators import Euler, RungeKutta4, Verlet

KINDS = [("wave", 0.2), ("wave", 0.95), ("wave", 0.02), ("damped", 0.2), ("diffusion", 0.45), ("diffusion", 0.95)]


def test_the_weights_of_the_published_bar():
    """Ji et al. (2021): K = 7 and values of an independent program, to their six digits."""
    kernel = Kernel(horizon=0.75, exponent=0, influence="gaussian", width=0.25, volume="full", calibrate=False)
    stencil = Stencil.from_kernel(kernel, 0.1, 1)
    found = half_weights(stencil, 1 / 0.1**2)
    np.testing.assert_allclose(found / found[0], BAR / BAR[0], rtol=1e-12)
    np.testing.assert_allclose(BAR, [12.3077, 7.61582, 3.42201, 1.11653, 0.264537, 0.0455123, 0.00568586], rtol=5e-6)


def test_recursions_are_the_integrators():
    """The factor of a step solves ``(1 + s) z - 2 + (1 - s)/z = dt^2 sigma`` (Verlet) and ``z = 1 + dt sigma``
    (Euler)."""
    z, dt, d = np.array([1.1 + 0.3j, 0.7 - 0.2j]), 0.1, 0.5
    damped = Recursion.of(Verlet(), dt, d)
    np.testing.assert_allclose(damped.eigenvalue(z), ((1 + d * dt) * z - 2 + (1 - d * dt) / z) / dt**2, rtol=1e-13)
    assert damped.first == pytest.approx((1 + d * dt) / 2, rel=1e-14)
    euler = Recursion.of(Euler(), dt)
    np.testing.assert_allclose(euler.eigenvalue(z), (z - 1) / dt, rtol=1e-13)
    assert euler.first == 1
    for recursion in (damped, euler):
        sigma = recursion.eigenvalue(z[:1])
        assert recursion.growth(sigma)[0] >= abs(z[0]) * (1 - 1e-12)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("reach", [1, 2, 7])
@pytest.mark.parametrize(("kind", "share"), KINDS)
def test_chain_and_transform_agree(reach, kind, share):
    """The two computations have only the weights in common. The tolerance of 1e-13 allows for the amplification of
    rounding on the circle, which is below a factor of 10.
    """
    weights = gaussian_weights(reach)
    recursion = recursion_at(weights, kind, share)
    one, other = run_kernel(weights, recursion, 2000), transform_kernel(weights, recursion, 2000)
    assert np.abs(one - other).max() < 1e-13
    assert not one[0].any() and not other[0].any()


def test_chain_and_transform_agree_for_a_wide_stencil_and_a_beam():
    """A stencil of reach K = 25, and the biharmonic stencil, whose second weight is negative."""
    for weights in (gaussian_weights(25), BEAM):
        recursion = recursion_at(weights, "wave", 0.3)
        assert np.abs(run_kernel(weights, recursion, 400) - transform_kernel(weights, recursion, 400)).max() < 1e-13


def test_transform_of_long_times():
    """The split of the circle into a fine and a coarse part (many small steps) agrees with the chain."""
    recursion = Recursion.of(Verlet(), 0.02)
    assert 4 * largest_angle(BAR, recursion) < np.pi  # the split is on
    chain, transform = run_kernel(BAR, recursion, 5000), transform_kernel(BAR, recursion, 5000)
    assert np.abs(chain - transform).max() < 1e-13


def test_nearest_neighbours_have_a_bessel_kernel():
    """For K = 1 and small steps the ghost kernel is ``2 J_2(2 t)/t`` of the harmonic chain (u'' = u_+ - 2 u + u_-),
    times dt, to order dt^2.
    """
    errors = []
    for dt in (0.02, 0.01):
        kernel = run_kernel(np.ones(1), Recursion.of(Verlet(), dt), round(20 / dt))[:, 0, 0]
        t = dt * np.arange(1, kernel.size)
        errors.append(np.abs(kernel[1:] / dt - 2 * special.jv(2, 2 * t) / t).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.05)


def test_first_samples_are_the_bonds():
    """After one step the values of the ghosts are ``scale D``."""
    recursion = recursion_at(BAR, "damped", 0.3)
    np.testing.assert_allclose(ghost_kernel(BAR, recursion, 10)[1], recursion.scale * driver_matrix(BAR), rtol=1e-14)


@pytest.mark.parametrize(("kind", "share"), KINDS)
def test_force_form_is_symmetric(kind, share):
    """M = D^T F is a surface Green's function between bonds, hence symmetric, to rounding of its largest entry."""
    recursion = recursion_at(BAR, kind, share)
    force = force_form(run_kernel(BAR, recursion, 1500), BAR)
    assert np.abs(force - force.swapaxes(1, 2)).max() < 1e-14 * np.abs(force).max() * BAR.size


def test_a_displaced_half_space_pulls_back_with_nothing():
    """With drivers held at 1 for ever the chain follows, and the forces M 1 - ground vanish. Waves decay slowly, so
    the remainder is compared in two intervals of time.
    """
    recursion = recursion_at(BAR, "wave", 0.3)
    force = force_form(run_kernel(BAR, recursion, 4000), BAR)
    rest = np.abs(np.cumsum(force.sum(2), 0) - ground(BAR)).max(1)
    assert rest[4000] < 1e-2 * ground(BAR).max()  # the remainder oscillates at the band edge and falls like t^-3/2
    assert rest[3000:].max() < rest[300:1000].max() / 5


@pytest.mark.parametrize(("kind", "share"), KINDS)
def test_nothing_travels_beyond_the_front(kind, share):
    """A chain twice as long gives the same kernel up to rounding (loops of other lengths sum in another order)."""
    recursion = recursion_at(BAR, kind, share)
    kernel = run_kernel(BAR, recursion, 300)
    nodes = np.full(301, 2 * int(fronts(BAR, recursion, 300)[-1]))
    longer = chain_responses(np.stack([BAR, BAR]), recursion.keep, recursion.scale, recursion.reaction, nodes)
    assert np.abs(kernel - longer).max() < 1e-15


def test_surface_response_solves_the_semi_infinite_problem():
    """The response is the fixed point of the elimination: a chain that is longer by many blocks has the same response,
    at frequencies near to and far from the band.
    """
    sigma = np.array([-1.0 + 1e-3j, -30 + 0.1j, 5.0, 2 - 3j])
    response = surface_response(BAR, sigma)
    reach, far = BAR.size, 100
    size = reach * far
    full = np.concatenate([BAR[::-1], [-2 * BAR.sum()], BAR])
    matrix = sum(np.diag(np.full(size - abs(k), full[k + reach]), k) for k in range(-reach, reach + 1))
    right = np.zeros((size, reach))
    right[:reach] = driver_matrix(BAR)
    for number in (2, 3):  # at these values a wave decays within the chain
        np.testing.assert_allclose(
            response[number], np.linalg.solve(sigma[number] * np.eye(size) - matrix, right)[:reach], atol=1e-12
        )
    # waves z^j with |z| < 1, counted into the chain: ghosts are z^K times the drivers in the order of their depth
    steps = np.arange(reach)
    for value, ghosts in zip(sigma, response, strict=True):
        roots = np.roots(full - value * (np.arange(full.size) == reach))
        roots = roots[np.abs(roots) < 1]
        assert roots.size == reach
        np.testing.assert_allclose(
            ghosts[:, ::-1] @ roots ** steps[:, None], roots ** (reach + steps[:, None]), rtol=0, atol=1e-12
        )
    assert (np.abs(np.linalg.eigvals(response[:, :, ::-1])) < 1).all()


def test_point_on_the_spectrum_is_refused():
    with pytest.raises(InputError, match="spectrum"):
        surface_response(BAR, np.array([-symbol(BAR, np.array([0.3]))[0]], complex))


def test_bad_input():
    with pytest.raises(InputError, match="one stage"):
        Recursion.of(RungeKutta4(), 0.1)
    with pytest.raises(InputError, match="one dimension"):
        half_weights(Stencil.finite_difference(2))

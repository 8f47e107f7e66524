"""Spectral radii of maps that are known."""

import numpy as np
import pytest
from scipy import linalg

from farhorizon.analysis.stability import (
    TOLERANCE,
    Allowance,
    Growth,
    LinearMap,
    dense_growth,
    fastest,
    krylov_growth,
    noise_growth,
    white_noise,
)


def with_factors(factors, seed=0):
    """A matrix with given eigenvalues, real or in conjugate pairs, and eigenvectors that are not orthogonal."""
    blocks = [
        np.array([[f.real, f.imag], [-f.imag, f.real]]) if np.imag(f) else np.array([[np.real(f)]]) for f in factors
    ]
    matrix = linalg.block_diag(*blocks)
    basis = np.eye(len(matrix)) + 0.3 * np.random.default_rng(seed).standard_normal(matrix.shape) / np.sqrt(len(matrix))
    return basis @ matrix @ np.linalg.inv(basis)


INSIDE = [0.9 * np.exp(1j * a) for a in np.linspace(0.1, 3, 30)]


@pytest.mark.parametrize("rate", [1e-2, 1e-6, 1e-9, -1e-9, -1e-6])
def test_growth_of_known_size(rate):
    """A well-conditioned mode is resolved down to the tolerance; time step 0.1."""
    factor = (1 + 0.1 * rate) * np.exp(0.7j)
    growth = dense_growth(with_factors([factor, *INSIDE]), 0.1)
    assert growth.stable is (rate < 0)
    assert growth.rate == pytest.approx(rate, abs=max(growth.error, 1e-12))
    assert growth.angle == pytest.approx(0.7)
    matrix = with_factors([factor, *INSIDE])
    assert np.abs(matrix @ growth.mode - growth.factor * growth.mode).max() < 1e-12


def test_a_double_factor_one_is_not_decided_by_rounding():
    """Rounding splits a Jordan block at 1 by the root of machine epsilon, which must count neither as growth nor as
    decay.
    """
    matrix = with_factors([0.5, *INSIDE])
    size = len(matrix)
    block = linalg.block_diag([[1.0, 1.0], [0.0, 1.0]], matrix)
    basis = np.eye(size + 2) + 0.3 * np.random.default_rng(1).standard_normal((size + 2, size + 2)) / np.sqrt(size)
    assert dense_growth(basis @ block @ np.linalg.inv(basis), 0.1).stable is None


@pytest.mark.parametrize("rate", [3e-2, 1e-4, -1e-4])
def test_krylov_spaces_of_powers(rate):
    """A mode that grows or decays slowly among many that decay little faster, in a map that can only be applied."""
    angles = np.linspace(0.1, 3, 100)
    slow = [(1 - 1e-3 - 1e-3 * i) * np.exp(1j * a) for i, a in enumerate(angles)]
    matrix = with_factors([(1 + rate) * np.exp(0.7j), *slow])
    advance = lambda x, n: np.linalg.matrix_power(matrix, n) @ x  # noqa: E731
    growth = krylov_growth(LinearMap(advance, len(matrix), 1.0, 50, 1e-4), Allowance(20.0))
    assert growth.stable is (rate < 0)
    assert growth.rate == pytest.approx(rate, abs=growth.error + 0.1 * abs(rate))


def test_without_an_allowance_nothing_is_decided():
    growth = krylov_growth(LinearMap(lambda x, n: x, 10, 1.0, 5, 1.0), Allowance(0.0))
    assert growth.stable is None and growth.error == np.inf


@pytest.mark.parametrize(("budget", "decided"), [(30.0, False), (60.0, True), (300.0, True)])
def test_where_a_long_run_is_not_allowed_krylov_spaces_may_tell(budget, decided):
    """At one second per crossing noise takes 20 seconds, a Krylov space of 16 vectors the same, and the long run 100
    more.
    """
    matrix = with_factors([0.99 * np.exp(0.7j), *INSIDE])
    steps_done = [0]

    def advance(x, steps):
        steps_done[0] += steps
        return np.linalg.matrix_power(matrix, steps) @ x

    allowance = Allowance(budget)
    growth = krylov_growth(LinearMap(advance, len(matrix), 1.0, 20, 1 / 20), allowance)
    assert (growth.stable is True) is decided
    assert steps_done[0] / 20 <= allowance.used * (1 + 1e-9) <= budget * (1 + 1e-9)


def test_what_is_not_allowed_is_not_begun():
    """Regression test: with steps so short that a crossing takes days, `check` never ended."""

    def advance(x, steps):
        raise AssertionError

    update = LinearMap(advance, 10, 1e-12, 10**12, 1e-6)
    assert krylov_growth(update, Allowance(60.0)).stable is None
    assert noise_growth(update, white_noise(10), Allowance(0.0), Allowance(60.0)) == (None, 0.0)


def test_rising_noise_is_growth_only_when_it_is_certain():
    """Noise behind an outline rises as the square of time: a busy machine refused a run that an idle one accepted. What
    grows is found within an allowance; without one nothing is known, not even that it is quiet.
    """

    def accelerated(state, steps):
        u, v, a = state.reshape(3, -1)
        return np.concatenate([u + steps * v + 0.5 * steps * (steps - 1) * a, v + steps * a, a])

    def growing(state, steps):
        return 1.03**steps * state

    def of(advance):
        return LinearMap(advance, 3 * 300, 0.1, 10, 1e-3)

    for allowed in (0.0, 0.1, 1.0):
        none, quiet = noise_growth(of(accelerated), white_noise(900), Allowance(allowed), Allowance(np.inf), 20.0)
        assert none is None and quiet == 0
    found, _ = noise_growth(of(growing), white_noise(900), Allowance(1.0), Allowance(np.inf), 20.0)
    assert found.rate == pytest.approx(np.log(1.03) / 0.1)
    assert noise_growth(of(growing), white_noise(900), Allowance(0.0), Allowance(np.inf), 20.0) == (None, 0.0)


def test_the_fastest_decides():
    """A certain growth before an uncertain one; without, whatever is uncertain; the tolerance is per crossing."""
    grows, unclear, decays = (Growth(*numbers, 1.0, np.zeros(0)) for numbers in ((1e-3, 0.0), (0.0, 1.0), (-1.0, 0.1)))
    assert fastest([decays, unclear, grows]) is grows
    assert fastest([decays, unclear]) is unclear
    assert Growth(TOLERANCE, 0.0, 1.0, np.zeros(0)).stable is True


def test_a_body_without_bonds_drifts():
    """Its free particles have the factor 1 exactly: a pivot of the inverse iteration is 0."""
    particles = np.kron([[2.0, -1.0], [1.0, 0.0]], np.eye(2))
    with np.errstate(all="raise"):
        found = dense_growth(particles, 1.0)
    assert found.factor == pytest.approx(1.0, abs=1e-7) and np.isfinite(found.error)
    np.testing.assert_allclose(particles @ found.mode, found.mode, atol=1e-7)

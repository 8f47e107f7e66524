"""Modes: their directions and factors in time, and the results of fits to them."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis import modes

SPACING, DT, DAMPING = 0.25, 0.05, 0.0125
STENCIL = fh.Stencil.from_kernel(fh.Kernel(3 * SPACING, 2), SPACING, 2)
K = np.array([[0.3, 0.0], [1.0, 0.5], [1.5, -1.0]])


def symbol(k):
    return modes.discrete_symbol(k, SPACING * STENCIL.offsets, STENCIL.weights / SPACING**2)


def test_symbol_is_the_stencils():
    own = STENCIL.symbol(*(SPACING * K.T)) / SPACING**2
    assert np.allclose(symbol(K), own, rtol=1e-13)


def test_symbol_of_modes_that_decay():
    """At k = i kappa, against the stencil applied to the growing exponential itself."""
    a = np.array([0.7, -0.2])
    direct = -(STENCIL.weights @ (np.exp(-SPACING * STENCIL.offsets @ a) - 1)) / SPACING**2
    assert symbol(1j * a[None])[0] == pytest.approx(direct, rel=1e-12)


def test_wave_factor_takes_one_step():
    """Three levels of a plane wave satisfy velocity Verlet; the wave travels along k and decays by the damping."""
    s = symbol(K)
    factor = modes.factors(s, DT, 2, DAMPING)
    step = (1 + DAMPING * DT) * factor - 2 + (1 - DAMPING * DT) / factor
    assert np.allclose(step, -(DT**2) * s, rtol=1e-12)
    assert (factor.imag < 0).all()
    assert np.allclose(np.abs(factor), np.sqrt((1 - DAMPING * DT) / (1 + DAMPING * DT)), rtol=1e-13)


@pytest.mark.parametrize("order, damping", [(1, 0.0), (2, 0.0), (2, 0.3)])
def test_continuous_factors_are_the_limit(order, damping):
    """The difference of the factors falls like dt^2 (Euler) or dt^3 (Verlet), overdamped long waves included."""
    k = np.array([[0.05, 0.0], [1.0, 0.5]]) * (1 if order == 2 else 1j)
    steps = np.array([0.02, 0.01, 0.005])
    gaps = [
        np.abs(modes.factors(symbol(k), dt, order, damping) - modes.factors(symbol(k), dt, order, damping, False)).max()
        for dt in steps
    ]
    assert np.polyfit(np.log(steps), np.log(gaps), 1)[0] == pytest.approx(order + 1, abs=0.1)


def test_ways_out():
    """Unit vectors around the first axis. In space the rings are balanced, whereas the published grid is not and
    repeats a direction.
    """
    for dim in (1, 2, 3):
        ways = modes.outward(dim, np.pi / 4, 9)
        assert np.allclose(np.linalg.norm(ways, axis=1), 1)
        assert np.allclose(ways.mean(0)[1:], 0, atol=1e-15)
        assert (ways[:, 0] >= np.cos(np.pi / 4) - 1e-12).all()
    assert len(modes.outward(3, np.pi / 4, 9)) == 1 + 6 + 12 + 18 + 24
    grid = modes.outward(3, np.pi / 4, 11, balanced=False)
    assert len(np.unique(np.round(grid, 12), axis=0)) == 111  # 605 / 5 less ten repetitions of one direction
    assert np.abs(grid.mean(0)[1:]).max() > 0.01


def test_frame():
    for normal in ([1.0], [0.6, 0.8], [0.36, 0.48, 0.8]):
        axes = modes.frame(np.array(normal))
        assert np.allclose(axes @ axes.T, np.eye(len(normal)))
        assert np.allclose(axes[0], normal)


def test_fit_of_few_modes_is_exact():
    """With more values than modes every mode advances exactly."""
    places = SPACING * np.array([[0, 0], [-1, 0], [-2, 0], [-1, 1], [-1, -1], [-3, 0]])
    factor = modes.factors(symbol(K), DT, 2, DAMPING)
    shape = modes.phases(K, places)
    update = modes.fit(modes.CloudModes(shape, factor, symbol(K)), 2).weights
    assert np.allclose(shape @ update[0] + shape @ update[1] / factor, factor, rtol=1e-11)


@pytest.mark.parametrize("order", [1, 2])
def test_operator_fit_has_a_limit(order):
    """Smaller steps give the same acceleration (rate) at the centre."""
    places = SPACING * np.array([[0, 0], [-1, 0], [-2, 0], [-1, 1], [-1, -1], [-2, 1], [-2, -1]])
    k = K if order == 2 else 0.3j * K
    found = []
    for dt in (1e-4, 1e-5):
        cloud = modes.CloudModes(modes.phases(k, places), modes.factors(symbol(k), dt, order), symbol(k))
        update = modes.fit_operator(cloud, 0, dt, order, SPACING**-2, 1e-5).weights
        values = np.exp(-places.sum(1) / 4)
        now = update[0] @ values + (update[1] @ values if order == 2 else 0)
        found.append((now - values[0]) / dt**order)
    assert found[0] == pytest.approx(found[1], rel=1e-2)


def test_overflow_is_refused():
    with pytest.raises(fh.InputError, match="overflow within a cloud"):
        modes.phases(np.array([[400.0j]]), np.array([[-1.0]]))
    with pytest.raises(fh.InputError, match="overflow within a time step"):
        modes.factors(np.array([-4e4]), 0.01, 1)
    with pytest.raises(fh.InputError, match="too short"):
        modes.factors(np.array([5.0]), 1.0, 2)


# dim, exponent, influence, terms: Hermann et al. (2023) eqs 24, 29; Shojaei et al. (2020) eqs 26, 56, whose modes grow
PUBLISHED = [
    (2, 2, "constant", (-1 / 32, 1 / 1728)),
    (2, 2, "linear", (-3 / 160, 1 / 4032)),
    (2, 1, "constant", (-3 / 80, 1 / 1344)),
    (3, 1, "constant", (-1 / 30, 1 / 1680)),
]


@pytest.mark.parametrize("dim, exponent, influence, terms", PUBLISHED)
def test_published_series(dim, exponent, influence, terms):
    assert fh.Kernel(1.0, exponent, influence).series(dim, 2) == pytest.approx(terms, rel=1e-13)


@pytest.mark.parametrize("influence", ["constant", "linear"])
@pytest.mark.parametrize("dim, exponent", [(d, p) for d in (1, 2, 3) for p in range(4) if d + 2 > p + (d == 1)])
def test_series_is_the_dispersion(dim, exponent, influence):
    """Thirty terms against the closed form, far beyond its long-wave limit."""
    kernel, k = fh.Kernel(0.7, exponent, influence), np.array([[0.5], [2.0], [5.0]])
    series = modes.series_symbol(k, 1.0, 0.7, kernel.series(dim, 30))
    assert np.allclose(series, kernel.dispersion(k[:, 0], dim), rtol=1e-9)

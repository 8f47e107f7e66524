"""Stencils: moments, symbols, largest symbol and backward waves, against textbook formulas, brute force and published
numbers.
"""

import itertools
import os

import numpy as np
import pytest
from scipy.optimize import brentq

from farhorizon import InputError, Kernel, Stencil
from helpers import fitted_rate, kernel_stencil

REACHES = (2, 3, 4, 6)

# 0.5 * sum w x^2 with the constants of the literature (calibrate=False) at horizon = 2, 3, 4, 6 spacings, keyed by
# (dim, exponent), summed by an independent program
RAMP = {
    (1, 0): (1.125, 1.056, 1.031, 1.014),
    (1, 1): (1.0, 1.0, 1.0, 1.0),
    (1, 2): (0.75, 0.833, 0.875, 0.917),
    (2, 0): (1.216, 1.057, 1.033, 1.015),
    (2, 1): (1.097, 1.020, 1.013, 1.006),
    (2, 2): (0.964, 0.969, 0.983, 0.992),
    (3, 0): (1.236, 1.104, 1.048, 1.020),
    (3, 1): (1.129, 1.062, 1.027, 1.011),
    (3, 2): (1.035, 1.024, 1.008, 1.004),
}
# from the same source, "No correction" (printed with two or three digits)
FULL = {(1, 1): (1.5, 1.33, 1.25, 1.17), (2, 1): (1.05, 1.04, 0.96, 0.999)}
EFFECTIVE = [
    (volume, *key, m, value)
    for volume, rows in (("ramp", RAMP), ("full", FULL))
    for key, row in rows.items()
    for m, value in zip(REACHES, row, strict=True)
]


def moment(stencil, *powers):
    """``sum w x^a y^b ...``."""
    return float((stencil.weights * np.prod(stencil.offsets ** np.array(powers), axis=1)).sum())


@pytest.mark.parametrize(("volume", "dim", "exponent", "m", "expected"), EFFECTIVE)
def test_effective_coefficient_of_the_published_constants(volume, dim, exponent, m, expected):
    """Without calibration a lattice diffuses or carries waves at the tabulated fraction of the nominal coefficient."""
    stencil = kernel_stencil(dim, m, exponent, volume=volume, calibrate=False)
    digits = 5e-4 if volume == "ramp" else 5e-3
    assert 0.5 * moment(stencil, 2, *[0] * (dim - 1)) == pytest.approx(expected, abs=digits * 1.001)


@pytest.mark.parametrize(("dim", "m", "neighbours"), [(1, 3, 6), (2, 2, 20), (2, 3, 28 + 8), (3, 2, 80)])
def test_neighbours_of_the_ramp(dim, m, neighbours):
    """Bonds reach horizon + spacing/2; 2D m = 2: 20, 3D m = 2: 80 (plane_wave_abc_diffusion.md, "Beta"); the others
    are counted here.
    """
    grid = np.stack(np.meshgrid(*[np.arange(-m - 1, m + 2)] * dim), -1).reshape(-1, dim)
    r2 = (grid**2).sum(1)
    assert ((r2 > 0) & (r2 < (m + 0.5) ** 2)).sum() == neighbours
    assert len(kernel_stencil(dim, m).weights) == neighbours


@pytest.mark.parametrize(("dim", "m"), [(1, 2), (2, 3), (3, 2)])
def test_full_volume_keeps_whole_cells_within_the_horizon(dim, m):
    """With constant influence and p = 0 the weights are equal on every node of the closed ball."""
    stencil = kernel_stencil(dim, m, 0, volume="full")
    assert ((stencil.offsets**2).sum(1) <= m**2).all()
    assert np.ptp(stencil.weights) < 1e-15
    assert len(stencil.weights) == {1: 4, 2: 28, 3: 32}[dim]  # integer points with 0 < r <= 2, 3, 2


@pytest.mark.parametrize("influence", ["constant", "linear", "gaussian"])
@pytest.mark.parametrize(("dim", "exponent", "reach"), [(1, 0, 3), (1, 2, 2), (2, 1, 3), (2, 3, 2), (3, 2, 2)])
@pytest.mark.parametrize("volume", ["ramp", "full"])
def test_calibrated_stencil_has_the_exact_coefficient(dim, exponent, reach, influence, volume):
    """symbol / k^2 -> 1 along any direction; the deviation at k = 1e-3 is of second order in k."""
    stencil = kernel_stencil(dim, reach, exponent, influence=influence, volume=volume)
    direction = np.array([0.6, 0.64, 0.48])[:dim]
    direction /= np.linalg.norm(direction)
    k = 1e-3
    assert abs(float(stencil.symbol(*(k * direction))) / k**2 - 1) < k**2 * (reach + 1) ** 2
    for axis in range(dim):
        assert 0.5 * (stencil.weights * stencil.offsets[:, axis] ** 2).sum() == pytest.approx(1, rel=1e-13)


@pytest.mark.parametrize(
    ("dim", "exponent", "low", "high"),
    [
        # 1D: the ramp halves the last cell, so the sum is the trapezoidal rule, of second order; p = 2 leaves out the
        # centre, where the integrand is k^2/2, an error of first order (the table above: 1 - 1/(2m)).
        (1, 0, 1.9, 2.1),
        (1, 1, 1.9, 2.1),
        (1, 2, 0.9, 1.1),
        # 2D, 3D: lattice points in a ball with a rim smoothed over one spacing: between 3/2 (the oscillating remainder
        # of the circle problem with one power of smoothing) and 2 (the trapezoidal part, and the missing centre for p
        # = 2).
        (2, 0, 1.3, 2.4),
        (2, 1, 1.3, 2.4),
        (2, 2, 1.3, 2.4),
    ],
)
def test_discrete_symbol_converges_to_the_continuum_one(dim, exponent, low, high):
    """At a fixed horizon and wave vector the symbol converges with the order of the quadrature."""
    kernel = Kernel(1.0, exponent, calibrate=False)
    k = np.array([2.1, 1.2])[:dim]
    exact = float(kernel.dispersion(np.linalg.norm(k), dim))
    reaches = np.unique(np.round(np.geomspace(4, 64 if dim == 1 else 40, 16)).astype(int))
    errors = [
        abs(float(Stencil.from_kernel(kernel, 1 / m, dim).symbol(*(k / m))) * m**2 - exact) / exact for m in reaches
    ]
    assert low < fitted_rate(1 / reaches, errors) < high
    assert errors[-1] < 0.01


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_finite_difference_symbol(dim):
    """The 3-, 5-, 7-point Laplacian: sum of 4 sin^2(k/2), largest at the corner of the Brillouin zone."""
    stencil = Stencil.finite_difference(dim)
    angles = np.random.default_rng(1).uniform(-np.pi, np.pi, (dim, 50))
    np.testing.assert_allclose(stencil.symbol(*angles), (4 * np.sin(angles / 2) ** 2).sum(0), rtol=1e-13)
    assert len(stencil.weights) == 2 * dim
    assert stencil.symbol_maximum == pytest.approx(4 * dim, rel=1e-12)
    assert not stencil.backward_waves()


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_finite_element_symbol(dim):
    """Row-sum lumped multilinear elements: the sum over axes of 2 (1 - cos k_a) times the product over the others of
    (2 + cos k_b) / 3.
    """
    stencil = Stencil.finite_element(dim)
    angles = np.random.default_rng(2).uniform(-np.pi, np.pi, (dim, 50))
    cos = np.cos(angles)
    mass = (2 + cos) / 3
    expected = sum(2 * (1 - cos[a]) * np.prod(np.delete(mass, a, 0), 0) for a in range(dim))
    np.testing.assert_allclose(stencil.symbol(*angles), expected, rtol=1e-12, atol=1e-14)
    # one axis at pi, the others at 0 (or any, where the mass cancels)
    assert stencil.symbol_maximum == pytest.approx(4, rel=1e-9)


def test_finite_element_in_2d_is_nine_points_of_weight_one_third():
    """8 neighbours of weight 1/3 and the centre -8/3; exact second derivatives without a mixed one."""
    stencil = Stencil.finite_element(2)
    np.testing.assert_allclose(stencil.weights, 1 / 3, rtol=1e-14)
    assert len(stencil.weights) == 8 and stencil.reach == (1, 1)
    assert [moment(stencil, *p) for p in ((2, 0), (0, 2), (1, 1), (1, 0))] == pytest.approx([2, 2, 0, 0], abs=1e-14)


@pytest.mark.parametrize(
    "stencil",
    [
        kernel_stencil(1, 3, 0),
        kernel_stencil(1, 7, 2, influence="linear"),
        kernel_stencil(2, 3, 2),
        kernel_stencil(2, 5, 0),
        Stencil.finite_element(2),
        Stencil([[1, 1], [-1, -1], [1, 0], [-1, 0], [1, -1], [-1, 1]], [1, 1, 0.3, 0.3, 0.2, 0.2]),
    ],
    ids=["1D p0 m3", "1D linear m7", "2D p2 m3", "2D p0 m5", "FE", "skewed"],
)
def test_symbol_maximum_against_brute_force(stencil):
    """The largest sample on a fine grid of the whole zone is a lower bound; the largest curvature bounds the rest."""
    n = {1: 20001, 2: 601}[stencil.dim]
    axis = np.linspace(-np.pi, np.pi, n)
    sampled = float(stencil.symbol(*np.ix_(*[axis] * stencil.dim)).max())
    curvature = float((np.abs(stencil.weights) * (stencil.offsets**2).sum(1)).sum())
    beyond = curvature * stencil.dim * (axis[1] - axis[0]) ** 2 / 8
    assert sampled * (1 - 1e-13) <= stencil.symbol_maximum <= sampled + beyond


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_symbol_gradient_against_differences(dim):
    """Central differences with step h agree to order h^2."""
    stencil = kernel_stencil(dim, 2)
    angles = np.random.default_rng(3).uniform(-np.pi, np.pi, (dim, 20))
    for axis in range(dim):
        shift = 1e-5 * np.eye(dim)[axis][:, None]
        difference = (stencil.symbol(*(angles + shift)) - stencil.symbol(*(angles - shift))) / 2e-5
        np.testing.assert_allclose(stencil.symbol_gradient(axis, *angles), difference, atol=1e-8)


# Backward waves


@pytest.mark.parametrize(
    ("stencil", "growth", "first"),
    [
        # largest growth over sigma and smallest backward |k|, to two or three digits, by an independent scan of the
        # symbols
        (kernel_stencil(1, 3, 0), 0.16, 1.47),
        (kernel_stencil(1, 25, 0), 0.49, 0.18),
        (kernel_stencil(2, 3, 1), 0.025, 1.94),
        (Stencil.finite_element(2), 0.101, 2.11),
    ],
    ids=["1D p0 m3", "1D p0 m25", "2D p1 m3", "FE 2D"],
)
def test_published_growth_of_backward_waves(stencil, growth, first):
    """Largest first-order growth per sigma, and where the backward waves begin."""
    waves = stencil.backward_waves()
    assert waves
    assert waves.growth == pytest.approx(growth, abs=0.005 if growth > 0.11 else 6e-4)
    assert waves.first_wavenumber == pytest.approx(first, abs=0.01)


def test_backward_waves_in_1d_begin_where_the_group_velocity_turns():
    """1D p = 0, m = 3: the ramp weights are 1, 1, 1/2, and d(symbol)/dk = 0 has its first root where backward waves
    begin.
    """
    root = brentq(lambda k: np.sin(k) + 2 * np.sin(2 * k) + 1.5 * np.sin(3 * k), 1, 2)
    # the zone is sampled every pi / 4096
    assert kernel_stencil(1, 3, 0).backward_waves().first_wavenumber == pytest.approx(root, abs=2e-3)


@pytest.mark.parametrize("dim", [1, 2])
@pytest.mark.parametrize("m", [1, 2, 3])
def test_no_backward_waves_for_exponent_2_and_short_horizons(dim, m):
    """p = 2 constant, m = 1..3."""
    waves = kernel_stencil(dim, m, 2).backward_waves()
    assert not waves and waves.growth == 0 and waves.fraction == 0 and waves.first_wavenumber == np.inf


@pytest.mark.parametrize(("exponent", "influence"), [(2, "linear"), (3, "constant"), (2, "gaussian")])
def test_no_backward_waves_for_smoother_kernels(exponent, influence):
    """Linear p = 2, p = 3 and gaussian p = 2 in 2D, here m = 3 and 5."""
    for m in (3, 5):
        assert not kernel_stencil(2, m, exponent, influence=influence).backward_waves()


@pytest.mark.parametrize(("m", "percent"), [(4, 2.8), (5, 1.1), (6, 1.9)])
def test_fraction_of_backward_waves_of_the_ramp(m, percent):
    """2D p = 2 constant: the part of the zone that is backward along one axis (an independent scan: 2.8, 1.1, 1.9 %
    for m = 4, 5, 6).

    The published figure counts one axis. `fraction` counts either axis: at least as much, at most twice.
    """
    stencil = kernel_stencil(2, m, 2)
    axis = (np.arange(400) + 0.5) / 400 * np.pi
    kx, ky = np.meshgrid(axis, axis, indexing="ij")
    slope = stencil.symbol(kx + 1e-5, ky) - stencil.symbol(kx - 1e-5, ky)
    single = float((slope < 0).mean())
    assert 100 * single == pytest.approx(percent, abs=0.15)
    assert kx[slope < 0].min() > 2.65  # same source: "k dx > 2.7", printed with two digits
    assert 0.95 * single <= stencil.backward_waves().fraction <= 2.1 * single


# Bad input


def test_horizon_below_the_spacing():
    """No node has a neighbour: refused with a horizon that works."""
    with pytest.raises(InputError, match=r"horizon.*0\.2.*>= 0\.25.*0\.75"):
        Stencil.from_kernel(Kernel(0.2), 0.25, 2)


@pytest.mark.parametrize(
    ("offsets", "weights", "match"),
    [
        ([[1, 0], [-1, 0]], [1.0, 2.0], "equal weights"),
        ([[1, 0]], [1.0], "equal weights"),
        ([[0], [1], [-1]], [1.0, 1.0, 1.0], "distinct and not zero"),
        ([[1], [1], [-1]], [1.0, 1.0, 1.0], "distinct"),
        ([[1], [-1]], [1.0, np.nan], "finite"),
        ([[1], [-1]], [1.0], "one weight an offset"),
        (np.zeros((0, 1)), np.zeros(0), r"stencil\.offsets: a stencil needs neighbours; value: 0 offsets"),
        ([[1, 0, 0, 0], [-1, 0, 0, 0]], [1.0, 1.0], "1 to 3 dimensions"),
    ],
)
def test_bad_tables_are_refused(offsets, weights, match):
    """Asymmetric, repeated, incomplete or non-finite tables."""
    with pytest.raises(InputError, match=match):
        Stencil(offsets, weights)


@pytest.mark.parametrize("reaction", [0.0, 0.3])
def test_drifting_stencils(reaction):
    """Their symbol by its definition, and the rate that limits the step from the spectrum of a ring: one step at it
    lets nothing grow, one that is a little longer does.
    """
    rng = np.random.default_rng(int(os.environ.get("FARHORIZON_SEED", 7)))
    offsets = np.array([-3, -1, 1, 2])
    stencil = Stencil(offsets[:, None], rng.uniform(0.1, 1.0, 4), reaction)
    angle = rng.uniform(0, np.pi, 5)
    expected = (1 - np.exp(1j * np.multiply.outer(angle, stencil.offsets[:, 0]))) @ stencil.weights + reaction
    np.testing.assert_allclose(stencil.symbol(angle), expected, rtol=0, atol=1e-14)
    ring = np.zeros((2000, 2000))  # long enough for a wave within a thousandth of any angle
    nodes = np.arange(2000)
    for k, w in zip(stencil.offsets[:, 0], stencil.weights, strict=True):
        ring[nodes, (nodes + k) % 2000] += w
        ring[nodes, nodes] -= w
    rates = np.fft.fft(ring[0]) - reaction  # eigenvalues of a circulant
    dt = 2 / stencil.symbol_maximum
    assert np.abs(1 + dt * rates).max() <= 1 + 1e-12
    assert np.abs(1 + 1.01 * dt * rates).max() > 1
    assert stencil.drifting and not Stencil.finite_difference(1).drifting


def matrix_stencil():
    """Bonds along the axes and diagonals of the plane, springs of two strengths."""
    offsets = np.array([o for o in itertools.product((-1, 0, 1), repeat=2) if any(o)])
    n = offsets / np.linalg.norm(offsets, axis=1)[:, None]
    strength = np.where(np.abs(offsets).sum(1) == 1, 1.0, 0.5)
    return Stencil(offsets, strength[:, None, None] * n[:, :, None] * n[:, None, :])


def test_matrix_symbol():
    """Hermitian, by the definition; its gradient and the slopes of its eigenvalues by finite differences."""
    stencil = matrix_stencil()
    skewed = stencil.weights + np.where(stencil.offsets[:, :1, None] > 0, 1, -1) * np.array([[0, 0.1], [-0.1, 0]]) * (
        stencil.offsets[:, :1, None] != 0
    )
    for table in (stencil, Stencil(stencil.offsets, skewed)):
        k = np.array([0.7, -1.9])
        expected = sum(w * (1 - np.exp(1j * (o @ k))) for o, w in zip(table.offsets, table.weights, strict=True))
        np.testing.assert_allclose(table.symbol(*k), expected, rtol=0, atol=1e-14)
        np.testing.assert_allclose(expected, expected.conj().T, rtol=0, atol=1e-14)
        step = 1e-6
        for axis in range(2):
            ahead, behind = (k + side * step * np.eye(2)[axis] for side in (1, -1))
            slope = (table.symbol(*ahead) - table.symbol(*behind)) / (2 * step)
            np.testing.assert_allclose(table.symbol_gradient(axis, *k), slope, rtol=0, atol=1e-8)
            slopes = (table.branches(*ahead) - table.branches(*behind)) / (2 * step)
            np.testing.assert_allclose(table.branches_with_gradient(*k)[1][axis], slopes, rtol=0, atol=1e-8)
        assert table.symbol_maximum >= table.branches(*np.meshgrid(*[np.linspace(-np.pi, np.pi, 41)] * 2)).max() - 1e-12


def test_symmetries_of_matrices():
    """Reflections reverse the component along them, and exchanging axes exchanges the components. Springs gain no
    energy; weights with a negative part are not positive.
    """
    stencil = matrix_stencil()
    assert stencil.components == 2 and stencil.positive
    assert stencil.even_along(0) and stencil.even_along(1) and stencil.same_along(0, 1)
    wide = Stencil(stencil.offsets, stencil.weights * (1 + np.abs(stencil.offsets[:, :1, None])))
    assert wide.even_along(0) and not wide.same_along(0, 1)
    assert stencil.along(1) is stencil.along(0) is stencil  # so that layers are made once for both
    np.testing.assert_allclose(wide.along(1).symbol(0.3, 0.8), wide.symbol(0.8, 0.3)[::-1, ::-1], rtol=0, atol=1e-15)
    assert not Stencil(stencil.offsets, stencil.weights - 0.3 * np.eye(2)).positive


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda w: w[:, :1], "one weight an offset"),
        (lambda w: w + np.arange(8)[:, None, None], "equal weights at k and -k"),
        (lambda w: w + np.array([[0, 1], [0, 0]]), "of matrices the transpose"),
        (lambda w: w * np.nan, "finite"),
    ],
)
def test_bad_matrices(change, message):
    stencil = matrix_stencil()
    with pytest.raises(InputError, match=message):
        Stencil(stencil.offsets, change(stencil.weights))


@pytest.mark.parametrize("order", [2, 4, 6, 8])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_the_error_of_central_differences_falls_with_their_order(order, dim):
    """The frequency of waves in a slanted direction against that of the continuum, |k|."""
    direction = np.array([0.8, 0.5, 0.33])[:dim]
    direction /= np.linalg.norm(direction)
    waves = 2 * np.pi / np.array([8.0, 12.0, 16.0])  # per unit spacing; more nodes meet rounding at order 8
    stencil = Stencil.finite_difference(dim, order)
    errors = [1 - float(np.sqrt(stencil.symbol(*(k * direction)))) / k for k in waves]
    assert min(errors) > 0 and abs(fitted_rate(waves, errors) - order) < 0.2
    assert stencil.accuracy == order and stencil.reach == (order // 2,) * dim


@pytest.mark.parametrize("order", [2, 4, 6, 8])
def test_central_differences_are_exact_for_polynomials(order):
    """The conditions that define the weights: the second difference of x^n at 0, up to the order and one more."""
    stencil = Stencil.finite_difference(1, order)
    x = stencil.offsets[:, 0].astype(float)
    for power in range(1, order + 2):
        assert abs(stencil.weights @ x**power - 2 * (power == 2)) < 1e-9
    assert abs(stencil.weights @ x ** (order + 2)) > 0.1


def test_orders_of_central_differences():
    for order in (0, 1, 3, 10, 2.5, "4"):
        with pytest.raises(InputError, match=r"stencil\.order"):
            Stencil.finite_difference(2, order)
    assert Stencil.finite_difference(2) == Stencil.finite_difference(2, 2)
    assert Stencil.finite_element(2).accuracy == 0 and kernel_stencil(2, 2).accuracy == 0
    assert Stencil.finite_difference(2, 6).with_reaction(0.3).accuracy == 6

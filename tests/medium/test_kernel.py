"""Kernels: scaling constants and continuum dispersion, against the published tables and numerical quadrature."""

from fractions import Fraction as F

import numpy as np
import pytest
from scipy import special
from scipy.integrate import quad

from farhorizon import InputError, Kernel

# (dim, influence): per exponent p = 0, 1, 2, 3 the constant c * horizon^(dim + 2 - p) (times pi in 2D and 3D) and the
# coefficients of z^2 and z^4 in S / k^2 = 1 + a z^2 + b z^4, z = k * horizon. c: Shojaei, Hermann, Seleson and Cyron
# (2020), table 1, completed from Hermann et al. (2023) and Shojaei et al. (2020), tables of the constants and of the
# series, with misprints corrected (3D p = 3: not tabulated).
TABLE = {
    (1, "constant"): [(3, F(-1, 20), F(1, 840)), (2, F(-1, 24), F(1, 1080)), (1, F(-1, 36), F(1, 1800))],
    (1, "linear"): [(12, F(-1, 30), F(1, 1680)), (6, F(-1, 40), F(1, 2520)), (2, F(-1, 72), F(1, 5400))],
    (2, "constant"): [
        (8, F(-1, 24), F(1, 1152)),
        (6, F(-3, 80), F(1, 1344)),
        (4, F(-1, 32), F(1, 1728)),
        (2, F(-1, 48), F(1, 2880)),
    ],
    (2, "linear"): [
        (40, F(-5, 168), F(5, 10368)),
        (24, F(-1, 40), F(1, 2688)),
        (12, F(-3, 160), F(1, 4032)),
        (4, F(-1, 96), F(1, 8640)),
    ],
    (3, "constant"): [
        (F(15, 2), F(-1, 28), F(1, 1512)),
        (6, F(-1, 30), F(1, 1680)),
        (F(9, 2), F(-3, 100), F(1, 1960)),
        (3, F(-1, 40), None),
    ],
    (3, "linear"): [
        (45, F(-3, 112), F(1, 2520)),
        (30, F(-1, 42), F(1, 3024)),
        (18, F(-1, 50), F(1, 3920)),
        (9, F(-3, 200), None),
    ],
}
CASES = [(dim, influence, p, *row) for (dim, influence), rows in TABLE.items() for p, row in enumerate(rows)]
KINDS = pytest.mark.parametrize(("dim", "influence", "exponent"), [case[:3] for case in CASES])
MEAN = {1: np.cos, 2: special.j0, 3: lambda z: np.sinc(z / np.pi)}  # of exp(i k.x) over the sphere |x| = z / |k|
SPHERE = {1: 2.0, 2: 2 * np.pi, 3: 4 * np.pi}


def symbol_by_quadrature(kernel, dim, z):
    """``c |S| integral of w(r) r^(dim - 1 - p) (1 - mean)`` with c from the integral of ``w(r) r^(dim + 1 - p)``,
    horizon 1.
    """

    def integral(f):
        return quad(f, 0, 1, epsabs=1e-14, epsrel=1e-13, limit=200)[0]

    def influence(r):
        return {"constant": 1.0, "linear": 1 - r, "gaussian": np.exp(-((r / kernel.gaussian_width) ** 2))}[
            kernel.influence
        ]

    power = dim - 1 - kernel.exponent
    moment = integral(lambda r: influence(r) * r ** (power + 2))
    c = 2 * dim / (SPHERE[dim] * moment)
    # 1 - mean = z^2 r^2 / (2 dim) for small arguments, where the difference cancels
    drop = lambda x: x**2 / (2 * dim) * (1 - x**2 / (4 * dim + 8)) if x < 1e-3 else 1 - MEAN[dim](x)  # noqa: E731
    return c * SPHERE[dim] * integral(lambda r: influence(r) * r**power * drop(z * r))


def test_the_table_holds_all_finite_cases():
    """2 influences x (3 exponents in 1D, 4 in 2D, 4 in 3D)."""
    assert len(CASES) == 22


@pytest.mark.parametrize(("dim", "influence", "exponent", "constant", "a", "b"), CASES)
def test_scaling_constant_of_the_table(dim, influence, exponent, constant, a, b):
    """c is the published constant and scales with the horizon and the coefficient as printed."""
    horizon, coefficient = 0.7, 2.5
    expected = float(constant) * coefficient / horizon ** (dim + 2 - exponent) / (1 if dim == 1 else np.pi)
    kernel = Kernel(horizon, exponent, influence)
    assert kernel.scaling_constant(dim, coefficient) == pytest.approx(expected, rel=1e-13)


@pytest.mark.parametrize(("dim", "influence", "exponent", "constant", "a", "b"), CASES)
def test_long_wave_dispersion_of_the_table(dim, influence, exponent, constant, a, b):
    """S / k^2 = 1 + a z^2 + b z^4 + ... with the published coefficients, from a polynomial through the symbol."""
    z = np.sqrt(np.linspace(0.05, 1.0, 40))
    horizon = 0.7
    ratio = Kernel(horizon, exponent, influence).dispersion(z / horizon, dim) / (z / horizon) ** 2
    fit = np.polynomial.Polynomial.fit(z**2, ratio, 7).convert().coef
    assert fit[0] == pytest.approx(1, abs=1e-11)
    assert fit[1] == pytest.approx(float(a), rel=1e-8)
    if b is not None:
        assert fit[2] == pytest.approx(float(b), rel=1e-5)


@KINDS
@pytest.mark.parametrize("z", [0.3, 1.3, 7.0])
def test_dispersion_against_quadrature(dim, influence, exponent, z):
    """The series (z < 2) and the closed forms (z > 2) equal the integral over the family."""
    kernel = Kernel(0.7, exponent, influence)
    expected = symbol_by_quadrature(kernel, dim, z) / 0.7**2
    assert kernel.dispersion(z / 0.7, dim) == pytest.approx(expected, rel=1e-11)


@pytest.mark.parametrize(("dim", "exponent"), [(1, 0), (1, 2), (2, 0), (2, 2), (2, 3), (3, 1), (3, 3)])
@pytest.mark.parametrize("width", [None, 0.25])
def test_gaussian_dispersion_and_constant_against_quadrature(dim, exponent, width):
    """The Gaussian has no closed form; its symbol and scaling constant are still integrals."""
    kernel = Kernel(1.0, exponent, "gaussian", width)
    for z in (0.3, 1.3, 7.0):
        assert kernel.dispersion(z, dim) == pytest.approx(symbol_by_quadrature(kernel, dim, z), rel=1e-11)


@KINDS
def test_dispersion_is_continuous_where_series_and_closed_form_meet(dim, influence, exponent):
    """There is no jump at z = 2; the change over two ulps is below rounding."""
    kernel = Kernel(1.0, exponent, influence)
    below, above = kernel.dispersion(np.array([np.nextafter(2.0, 0), 2.0]), dim)
    assert below == pytest.approx(above, rel=1e-12)


@pytest.mark.parametrize("influence", ["constant", "linear", "gaussian"])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_long_waves_travel_at_the_given_speed(dim, influence):
    """S / k^2 -> 1: at z = 1e-3 the deviation is below z^2 / 20 (largest table entry); S(0) = 0, S(-k) = S(k)."""
    kernel = Kernel(1.0, 1, influence)
    k = 1e-3
    assert abs(float(kernel.dispersion(k, dim)) / k**2 - 1) < k**2 / 20
    np.testing.assert_array_equal(kernel.dispersion(np.array([0.0]), dim), 0)
    assert kernel.dispersion(-1.7, dim) == kernel.dispersion(1.7, dim)


def test_dispersion_keeps_the_shape_of_its_argument():
    """Numbers give numbers and arrays give arrays, across the switch of formulas."""
    k = np.linspace(0, 9, 12).reshape(3, 4)
    kernel = Kernel(1.0, 2)
    values = kernel.dispersion(k, 2)
    assert values.shape == (3, 4)
    assert kernel.dispersion(k[2, 1], 2).shape == ()
    np.testing.assert_allclose([float(kernel.dispersion(x, 2)) for x in k.ravel()], values.ravel(), rtol=1e-12)


@pytest.mark.parametrize("influence", ["constant", "linear"])
def test_exponent_3_diverges_in_1d(influence):
    """The second moment of r^-3 on a line is the integral of 1/r, so this is refused with the limit."""
    kernel = Kernel(1.0, 3, influence)
    for use in (lambda: kernel.scaling_constant(1), lambda: kernel.dispersion(1.0, 1)):
        with pytest.raises(InputError, match=r"diverges.*<= 2"):
            use()


@pytest.mark.parametrize(
    ("options", "key"),
    [
        ({"horizon": 0.0}, "kernel.horizon"),
        ({"horizon": -1.0}, "kernel.horizon"),
        ({"horizon": np.nan}, "kernel.horizon"),
        ({"exponent": 4}, "kernel.exponent"),
        ({"exponent": 1.5}, "kernel.exponent"),
        ({"influence": "cubic"}, "kernel.influence"),
        ({"volume": "half"}, "kernel.volume"),
        ({"width": 0.2}, "kernel.width"),
        ({"influence": "gaussian", "width": 0.0}, "kernel.width"),
        ({"influence": "gaussian", "width": np.nan}, "kernel.width"),
    ],
)
def test_bad_kernels_are_refused(options, key):
    """The message names the key of the value."""
    with pytest.raises(InputError) as error:
        Kernel(**{"horizon": 1.0, **options})
    assert error.value.key == key

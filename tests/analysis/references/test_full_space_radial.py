"""The cylindrical wave: its equation, initial value and Hankel integral, and a correspondence body."""

import numpy as np
import pytest
from scipy import special

from farhorizon import Correspondence, Fixed, Kernel, Lattice, Simulation
from farhorizon.analysis.references.full_space import gaussian_symbol, nonlocal_radial_wave, radial_wave
from farhorizon.medium.stencil import Stencil

# central differences of order 8
_SECOND = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])
_FIRST = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])


@pytest.mark.parametrize("t", [0.0, 0.3, 1.0, 2.5])
def test_radial_wave_equation(t):
    """u_tt = c^2 (u_rr + u_r / r - u / r^2): the residual falls with order 8 of the differences, down to rounding."""
    speed, r = 1.3, np.linspace(0.5, 3.0, 26)
    residuals = []
    for h in (0.08, 0.04, 0.02):
        near = h * np.arange(-4, 5)
        in_time = sum(w * radial_wave(r, t + d, speed) for w, d in zip(_SECOND, near, strict=True)) / h**2
        in_space = sum(
            (a / h**2 + b / h / r) * radial_wave(r + d, t, speed) for a, b, d in zip(_SECOND, _FIRST, near, strict=True)
        )
        residuals.append(np.abs(in_time - speed**2 * (in_space - radial_wave(r, t, speed) / r**2)).max())
    assert residuals[2] < 1e-8 and np.log2(residuals[0] / residuals[1]) > 7


def test_start():
    """Eq. 3-2; the printed eq. 3-3 gives 0.096, or with sqrt(2) a 0.304, in place of 0.358 at r = a / 2."""
    r = np.linspace(0, 5, 51)
    assert np.abs(radial_wave(r, 0.0, 1.0, 2.0, 0.7) - 2 * (r / 0.7) * (1 + (r / 0.7) ** 2) ** -1.5).max() < 1e-15
    a, alpha, squared = 0.1, 1.25, 1.25
    printed = 0.05 * np.sqrt(squared + alpha * (2 * alpha - squared)) / squared**3
    assert printed / np.sqrt(2 * a) == pytest.approx(0.096, abs=1e-4)
    assert printed / (np.sqrt(2) * a) == pytest.approx(0.3036, abs=1e-4)
    assert radial_wave(0.05, 0.0, 1.0, 1.0, a) == pytest.approx(0.5 / 1.25**1.5, rel=1e-14)


def test_complex_form():
    """b r/a Re ((1 + i c t / a)^2 + r^2/a^2)^(-3/2), behind, at and ahead of the front."""
    r, t = np.meshgrid(np.linspace(0.01, 4, 40), np.linspace(0, 6, 25))
    exact = (r * ((1 + 1j * t) ** 2 + r**2) ** -1.5).real
    assert np.abs(radial_wave(r, t, 1.0) - exact).max() < 1e-14 * np.abs(exact).max()


def test_hankel_integral_of_the_local_medium():
    """With the symbol k the integral equals the closed form."""
    r, t = np.meshgrid([0.0, 0.05, 0.5, 1.5], [0.0, 0.3, 1.0, 3.0])
    found = nonlocal_radial_wave(r, t, 1.1, lambda k: k, 1.0, 0.1)
    assert np.abs(found - radial_wave(r, t, 1.1, 1.0, 0.1)).max() < 1e-12


@pytest.mark.parametrize(
    ("kernel", "symbol"),
    [
        (Kernel(12.0, 0, "gaussian", 2.5, volume="full"), gaussian_symbol(2.5)),
        (Kernel(60.0, 0, volume="full"), lambda k: 8 * special.jv(2, k * 60.0) / (k * 60.0**2)),
    ],
)
def test_symbols(kernel, symbol):
    """Symbols of a fine lattice: Gaussian sums are spectrally accurate, a disc of cells is not."""
    k = np.linspace(0.05, 4, 30) / kernel.horizon
    offsets, weights = Stencil.family(kernel, 1.0, 2)
    factors = weights * offsets[:, 0] / (weights * offsets[:, 0] ** 2).sum()  # factors of the gradient along x
    lattice = factors @ np.sin(np.outer(offsets[:, 0], k))
    tolerance = 1e-6 if kernel.influence == "gaussian" else 0.01
    assert np.abs(lattice - symbol(k)).max() < tolerance * np.abs(symbol(k)).max()


@pytest.mark.slow
def test_a_solid_against_the_nonlocal_solution():
    """A pulse five spacings wide in a body so large that its edge is not felt at the middle; the second-order error of
    the time step is negligible.
    """
    half, width = 60, 5.0

    def component(a):
        return lambda *at: at[a] / width * (1 + (at[0] ** 2 + at[1] ** 2) / width**2) ** -1.5

    lattice = Lattice(1.0, (-half,) * 2, (half,) * 2)
    solid = Correspondence(Kernel(1.1 * np.sqrt(np.log(1e8)), 0, "gaussian", 1.1, volume="full"), 1.0, 0.25)
    sim = Simulation(lattice, solid, Fixed(), {"u": (component(0), component(1))}, dt=0.05).run(20.0)
    found = sim.fields["u"][0, half : half + 20, half]
    exact = nonlocal_radial_wave(np.arange(20.0), sim.time, solid.p_speed, gaussian_symbol(1.1), 1.0, width)
    local = radial_wave(np.arange(20.0), sim.time, solid.p_speed, 1.0, width)
    assert np.abs(found - exact).max() < 0.02 * np.abs(local - exact).max()

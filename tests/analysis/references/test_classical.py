"""Classical heat conduction: each solution satisfies its equation, initial and boundary conditions, and the published
numbers.
"""

import numpy as np
import pytest
from scipy.integrate import simpson

import heat_solutions
from farhorizon import InputError
from farhorizon.analysis.references.classical import End, Slab, line_source

EXAMPLE1 = Slab(10.0, 1.14, [(0, 10, 100.0)])
EXAMPLE2 = Slab(10.0, 1.14, [(0, 5, 60.0)], End(0.0, slope=True), End(100.0))
EXAMPLE3 = Slab(np.pi, 1.14, [], End(20.0), End(3.0, slope=True))
SLABS = [EXAMPLE1, EXAMPLE2, EXAMPLE3, Slab(2.0, 0.7, [(0.5, 1.0, 3.0)], End(-1.0, slope=True), End(2.0, slope=True))]


def test_mid_temperatures():
    """The dashed lines of figure 10, 51.75 and 53.06; the further digits are from an independent evaluation."""
    assert EXAMPLE1.temperature(5.0, 8.0) == pytest.approx(51.74760, abs=5e-6)
    assert EXAMPLE2.temperature(5.0, 8.0) == pytest.approx(53.06259, abs=5e-6)


@pytest.mark.parametrize("slab", SLABS)
def test_heat_equation_and_ends(slab):
    """Central differences of the solution satisfy T_t = a T_xx, and the condition at either end holds."""
    x, t, h = slab.length * np.linspace(0.1, 0.9, 9), 0.3, 1e-3
    rate = (slab.temperature(x, t + 1e-4) - slab.temperature(x, t - 1e-4)) / 2e-4
    bend = (slab.temperature(x + h, t) - 2 * slab.temperature(x, t) + slab.temperature(x - h, t)) / h**2
    assert rate == pytest.approx(slab.diffusivity * bend, abs=1e-3)
    slope = (slab.temperature(x + h, t) - slab.temperature(x - h, t)) / (2 * h)
    assert slab.gradient(x, t) == pytest.approx(slope, abs=1e-3)
    for end, place in ((slab.left, 0.0), (slab.right, slab.length)):
        found = slab.gradient(place, t) if end.slope else slab.temperature(place, t)
        assert found == pytest.approx(end.value, abs=1e-10)


@pytest.mark.parametrize("slab", SLABS)
def test_start(slab):
    """At t = 0 the series is the initial temperature, and shortly after nothing but the neighbourhood of jumps has
    changed.
    """
    x = slab.length * np.array([0.15, 0.35, 0.65, 0.85])
    assert slab.temperature(x, 1e-4 * slab.length**2) == pytest.approx(slab.temperature(x, 0.0), abs=1e-8)


def test_truncation():
    """The truncation error stays below 100 times the requested bound."""
    x = np.linspace(0, 10, 41)
    for error in (1e-3, 1e-6, 1e-9):
        assert np.abs(EXAMPLE1.temperature(x, 0.1, error) - EXAMPLE1.temperature(x, 0.1, 1e-15)).max() < 100 * error


def test_slab_is_the_half_space_at_first():
    x = np.linspace(0, 3, 16)
    assert EXAMPLE1.temperature(x, 0.2) == pytest.approx(heat_solutions.half_space(x, 0.2, 1.14, 0.0, 100.0), abs=1e-9)
    heated = Slab(20.0, 1.14, [], End(-3.0, slope=True), End(0.0))
    assert heated.temperature(x, 0.2) == pytest.approx(heat_solutions.half_space_flux(x, 0.2, 1.14, 2.0, 6.0), abs=1e-9)


def test_convection_lies_between():
    """A large coefficient gives a prescribed surface temperature, a small one a prescribed flux."""
    x = np.linspace(0, 2, 9)
    assert heat_solutions.half_space_convection(x, 0.5, 1.0, 1.0, 1e9) == pytest.approx(
        heat_solutions.half_space(x, 0.5, 1.0, 1.0, 0.0), abs=1e-8
    )
    assert heat_solutions.half_space_convection(x, 0.5, 1.0, 1.0, 1e-6) == pytest.approx(
        heat_solutions.half_space_flux(x, 0.5, 1.0, 1.0, 1e-6), abs=1e-11
    )


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_gaussian_keeps_its_heat(dim):
    """The integral over space does not change."""
    r, dr = np.linspace(0, 40, 40001, retstep=True)
    measure = {1: 2.0, 2: 2 * np.pi * r, 3: 4 * np.pi * r**2}[dim]
    totals = [simpson(heat_solutions.gaussian(r, t, 0.8, 1.3, dim) * measure, dx=dr) for t in (0.0, 5.0)]
    assert totals[1] == pytest.approx(totals[0], rel=1e-8)


def test_line_source():
    """The heat is power times time; a source that is spread out is the integral of Gaussians."""
    r, dr = np.linspace(0, 60, 600001, retstep=True)
    heat = np.trapezoid(line_source(r[1:], 3.0, 0.5, 2.0, 7.0) * 2 * np.pi * r[1:], dx=dr) * 2.0 / 0.5
    assert heat == pytest.approx(21.0, rel=1e-6)
    times, dt = np.linspace(0, 3, 60001, retstep=True)
    at = np.array([0.0, 0.4, 2.0])
    pulses = np.array([[heat_solutions.gaussian(x, t, 0.5, 0.6, 2) for x in at] for t in times[::60]])
    smooth = np.trapezoid(pulses, dx=60 * dt, axis=0) * 7.0 * 0.5 / 2.0 / (np.pi * 0.6**2)
    assert line_source(at, 3.0, 0.5, 2.0, 7.0, 0.6) == pytest.approx(smooth, rel=1e-5)


def test_bad_input():
    with pytest.raises(InputError, match="positive"):
        Slab(1.0, -1.0, [])
    with pytest.raises(InputError, match="must lie in the slab"):
        Slab(1.0, 1.0, [(0.5, 2.0, 1.0)])
    with pytest.raises(InputError, match="not a function"):
        EXAMPLE1.gradient(1.0, 0.0)

"""One-sided flux: exact for linear temperatures at every node of any body; its leading error; and power across
planes, which closes the balance.
"""

import numpy as np
import pytest

from farhorizon import Box, Disc, Free, Heat, InputError, Kernel, Lattice, Simulation, Temperature


def linear(*x):
    """A temperature of constant gradient (2, -3, 5)."""
    return sum((g * c for g, c in zip((2.0, -3.0, 5.0), x, strict=False)), 7.0)


@pytest.mark.parametrize("influence", ["constant", "linear"])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_linear_temperature(dim, influence):
    """At every node, corners included, the flux is minus the conductivity times the gradient."""
    lattice = Lattice(0.5, (0.0,) * dim, (5.0,) * dim)
    sim = Simulation(lattice, Heat(Kernel(1.5, influence=influence), conductivity=4.0), Free(), {"u": linear})
    flux = sim.flux()
    for axis in range(dim):
        np.testing.assert_allclose(flux[axis], -4.0 * (2.0, -3.0, 5.0)[axis], rtol=1e-12)


def test_linear_temperature_in_a_body_with_a_hole_and_a_crack():
    body = Box((0, 0), (10, 10)) - Disc(2.0, (5, 5))
    lattice = Lattice(0.5, (0.0, 0.0), (10.0, 10.0), body=body)
    sim = Simulation(lattice, Heat(Kernel(1.5)), Free(), {"u": linear}, cracks=[[[1.0, 1.3], [4.0, 1.3]]])
    flux = sim.flux()
    np.testing.assert_allclose(flux[0][lattice.mask], -2.0, rtol=1e-11)
    np.testing.assert_allclose(flux[1][lattice.mask], 3.0, rtol=1e-11)
    assert np.isnan(flux[:, ~lattice.mask]).all()


@pytest.mark.parametrize(
    ("influence", "reach", "constant"),
    # half the sum of V k (distance / horizon) over one side, by hand: 5/16 and 17/64 for constant k, 1/4 and 3/16 for
    # the triangle
    [("constant", 2, 0.3125), ("constant", 4, 0.265625), ("linear", 2, 0.25), ("linear", 4, 0.1875)],
)
def test_leading_error(influence, reach, constant):
    """For a parabola the error is ``constant * T'' * horizon``."""
    lattice = Lattice(0.1, 0.0, 4.0)
    sim = Simulation(
        lattice, Heat(Kernel(0.1 * reach, influence=influence, calibrate=False)), Free(), {"u": lambda x: x**2 / 2}
    )
    error = -sim.flux()[0] - lattice.axes[0]
    assert error[5:-10] == pytest.approx(constant * 0.1 * reach, rel=1e-10)


def test_a_crack_across_the_body_lets_nothing_through():
    lattice = Lattice(0.5, (0.0, 0.0), (10.0, 5.0))
    whole = Simulation(lattice, Heat(Kernel(1.5)), Free(), {"u": linear})
    # eleven rows of cells; the outer rows lack bonds
    assert whole.power_across("x", 5.2) == pytest.approx(-2.0 * 5.5, rel=0.1)
    cut = Simulation(lattice, Heat(Kernel(1.5)), Free(), {"u": linear}, cracks=[[[5.2, -1.0], [5.2, 6.0]]])
    assert cut.power_across("x", 5.2) == 0.0
    with pytest.raises(InputError, match="outside the near field"):
        cut.power_across("x", 11.0)
    with pytest.raises(InputError, match="no such axis"):
        cut.power_across("z", 1.0)


def test_power_across_is_what_the_part_beyond_gains():
    """The power is exactly what one step of forward Euler adds beyond the plane."""
    lattice = Lattice(0.5, (0.0, 0.0), (8.0, 5.0))
    start, factor = {"u": lambda x, y: np.sin(x) * np.cos(y)}, 1 + lattice.coordinates()[0]
    sim = Simulation(lattice, Heat(Kernel(1.5), 2.0, 3.0, 4.0), Free(), start, coefficient=factor, rule="harmonic")
    before, power = sim.fields["u"][9:].sum(), sim.power_across("x", 4.1)
    sim.step()
    gain = (sim.fields["u"][9:].sum() - before) * 2.0 * 3.0 * 0.25
    assert gain == pytest.approx(power * sim.dt, rel=1e-11)


def test_steady_power_is_the_flux_of_the_bar():
    """Between two held temperatures the same power crosses every plane."""
    held = [Temperature("x-", 0.0), Temperature("x+", 1.0)]
    sim = Simulation(
        Lattice(0.1, 0.0, 3.0), Heat(Kernel(0.3), integrator="rk4"), Free(), {"u": lambda x: x / 3}, constraints=held
    )
    sim.run(20.0)
    powers = [sim.power_across("x", x) for x in np.arange(0.5, 2.5, 0.2)]
    np.testing.assert_allclose(powers, powers[0], rtol=1e-10)

"""Heat conduction: the conductivity of a grid, the self term, bars between two temperatures, composites, units."""

import numpy as np
import pytest
from scipy.linalg import expm

from farhorizon import (
    Free,
    Heat,
    InputError,
    Insulated,
    Kernel,
    Lattice,
    Periodic,
    RungeKuttaChebyshev,
    Simulation,
    Source,
    Stencil,
    Temperature,
)
from farhorizon.analysis.references.classical import End, Slab
from farhorizon.models.heat import self_weight
from heat_solutions import box
from helpers import dense_operator, fitted_rate


def kernel(reach, influence="constant", **options):
    """The micro-conductivity of the paper on unit spacing."""
    return Kernel(float(reach), influence=influence, **{"calibrate": False, **options})


def conductivity(stencil):
    """Second moment of a stencil, which is the conductivity for long waves."""
    return 0.5 * (stencil.weights * stencil.offsets[:, 0] ** 2).sum()


@pytest.mark.parametrize("reach", [2, 4, 8, 16])
@pytest.mark.parametrize(
    ("influence", "self_term", "expected"),
    [
        # by algebra of the sums of the paper's discretisation: constant k lacks 1/(2m), the triangle 1/m or, as
        # printed, 1/m^2
        ("constant", "centre", lambda m: 1.0),
        ("constant", "neighbour", lambda m: 1.0),
        ("constant", "none", lambda m: 1 - 1 / (2 * m)),
        ("linear", "centre", lambda m: 1.0),
        ("linear", "neighbour", lambda m: 1 - 1 / m**2),
        ("linear", "none", lambda m: 1 - 1 / m),
    ],
)
def test_self_term(reach, influence, self_term, expected):
    """Only the self term with k(0) gives the requested conductivity."""
    model = Heat(kernel(reach, influence), self_term=self_term)
    assert conductivity(model.stencil(1.0, 1)) == pytest.approx(expected(reach), rel=1e-13)


def test_triangle_over_two_nodes_is_the_classical_difference():
    """k vanishes at the edge of the horizon; half of it and the self term add up to 1."""
    stencil = Heat(kernel(2, "linear")).stencil(1.0, 1)
    classical = Stencil.finite_difference(1)
    assert stencil.offsets.tolist() == classical.offsets.tolist()
    assert stencil.weights == pytest.approx(classical.weights, rel=1e-14)


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("exponent", [0, 1, 2, 3])
def test_self_weight_is_the_cell_integral(dim, exponent):
    """Half the constant times the integral of x^2 r^-p over the unit cell, by a fine midpoint rule."""
    if dim == 1 and exponent == 3:
        return
    count = {1: 100_000, 2: 1000, 3: 100}[dim]
    axis = (np.arange(count) + 0.5) / count - 0.5
    grids = np.meshgrid(*[axis] * dim, indexing="ij")
    r = np.sqrt(sum(g**2 for g in grids))
    cell = (grids[0] ** 2 * r ** -float(exponent)).mean()
    k = Kernel(3.0, exponent)
    assert self_weight(k, 1.0, dim) == pytest.approx(0.5 * k.scaling_constant(dim) * cell, rel=1e-3)
    if exponent == 2:
        assert self_weight(k, 1.0, dim) == pytest.approx(0.5 * k.scaling_constant(dim) / dim, rel=1e-13)


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("influence", ["constant", "linear", "gaussian"])
def test_calibrated_conductivity(dim, influence):
    """With a calibrated kernel any self term and any horizon give the conductivity."""
    for self_term in ("centre", "neighbour", "none"):
        stencil = Heat(Kernel(2.7, influence=influence), conductivity=3.0, self_term=self_term).stencil(1.0, dim)
        assert conductivity(stencil) == pytest.approx(1.0, rel=1e-12)


def test_units():
    """In SI units a mode of a copper bar decays with conductivity / (density specific heat), and a source is a power
    per volume.
    """
    density, heat, kappa = 8960.0, 385.0, 401.0  # copper at room temperature (CRC Handbook)
    lattice = Lattice(1e-3, 0.0, 0.039)
    model = Heat(Kernel(3e-3), density, heat, kappa, "rk4")
    phase = 2 * np.pi * np.arange(40) / 40
    rate = float(model.stencil(1e-3, 1).symbol(2 * np.pi / 40)) * kappa / density / heat / 1e-6
    sim = Simulation(lattice, model, Periodic(), {"u": 20 + np.cos(phase)}, sources=[Source(1e6)], dt=5e-4)
    sim.run(0.1)
    exact = 20 + np.cos(phase) * np.exp(-rate * 0.1) + 1e6 * 0.1 / (density * heat)
    assert sim.fields["u"] == pytest.approx(exact, abs=1e-9)


def test_bar_against_the_matrix_exponential():
    """A bar with one node held at either end is a linear system: Runge-Kutta 4, even close to its limit, is within
    1e-9 of it, in degrees.
    """
    nodes, reach, alpha = 67, 2, 1.14
    spacing = 10 / nodes
    model = Heat(Kernel(reach * spacing, calibrate=False), conductivity=alpha, integrator="rk4")
    lattice = Lattice(spacing, spacing / 2, spacing / 2 + (nodes - 1) * spacing)
    stencil = model.stencil(spacing, 1)
    matrix = dense_operator((nodes,), stencil.offsets, stencil.weights) * alpha / spacing**2
    matrix[[0, -1]] = 0
    start = np.full(nodes, 100.0)
    start[[0, -1]] = 0
    held = [Temperature("x-", 0.0, "node"), Temperature("x+", 0.0, "node")]
    sim = Simulation(lattice, model, Free(), {"u": 100.0}, constraints=held)
    limit = 2.785293563405282 / np.abs(np.linalg.eigvals(matrix)).max()
    for share in (0.98, 0.2):
        steps = int(np.ceil(8 / (share * limit)))
        sim = Simulation(lattice, model, Free(), {"u": 100.0}, constraints=held, dt=8 / steps)
        sim.step(steps)
        assert np.abs(sim.fields["u"] - expm(8 * matrix) @ start).max() < 1e-9


@pytest.mark.parametrize("integrator", ["euler", RungeKuttaChebyshev(15)])
def test_order_in_time_with_held_nodes(integrator):
    """Held values that vary in time keep the orders 1 and 2; compared with Runge-Kutta 4 at a small step."""

    def end(method, steps):
        model = Heat(Kernel(3.0), integrator=method)
        wall = Temperature("x-", lambda x, t: np.sin(2 * t), "node")
        sim = Simulation(
            Lattice(1.0, 0.0, 19.0),
            model,
            Free(),
            {"u": lambda x: np.exp(-((x - 10) ** 2) / 4)},
            constraints=[wall],
            dt=2 / steps,
        )
        sim.step(steps)
        return sim.fields["u"]

    exact = end("rk4", 1600)
    counts = np.array([50, 100, 200] if integrator == "euler" else [10, 20, 40])
    errors = [np.abs(end(integrator, n) - exact).max() for n in counts]
    assert fitted_rate(1 / counts, errors) == pytest.approx(1 if integrator == "euler" else 2, abs=0.15)


def test_order_of_runge_kutta_4_with_held_nodes():
    """Order 4 with a held value that varies in time."""

    def end(steps):
        model = Heat(Kernel(3.0), integrator="rk4")
        wall = Temperature("x-", lambda x, t: np.sin(2 * t), "node")
        sim = Simulation(Lattice(1.0, 0.0, 19.0), model, Free(), {"u": 0.0}, constraints=[wall], dt=2 / steps)
        sim.step(steps)
        return sim.fields["u"]

    counts = np.array([8, 16, 32])
    errors = [np.abs(end(n) - end(512)).max() for n in counts]
    assert fitted_rate(1 / counts, errors) == pytest.approx(4, abs=0.3)


def test_composite_reaches_its_steady_state():
    """Two halves of conductivity 1 and 3, with harmonic bonds of nearest neighbours and the interface between cells,
    reach the classical profile exactly.
    """
    nodes = 20
    x = np.arange(nodes) + 0.5
    factor = np.where(x < 10, 1.0, 3.0)
    held = [Temperature("x-", 0.0, "node"), Temperature("x+", 1.0, "node")]
    model = Heat(Stencil.finite_difference(1), integrator="rk4")
    sim = Simulation(
        Lattice(1.0, 0.5, nodes - 0.5), model, Free(), {"u": 0.5}, coefficient=factor, rule="harmonic", constraints=held
    )
    sim.run(1500.0)  # exp(-0.027 * 1500) of the slowest mode of 19 cells is below rounding
    resistance = np.concatenate([[0], np.cumsum((1 / factor[:-1] + 1 / factor[1:]) / 2)])
    assert sim.fields["u"] == pytest.approx(resistance / resistance[-1], abs=1e-10)


@pytest.mark.parametrize("reach", [2, 3])
def test_quenched_bar_converges(reach):
    """With mirror conditions the error against the classical solution is of second order in the spacing."""
    errors, spacings = [], []
    for nodes in (20, 40, 80):
        spacing = 1 / nodes
        model = Heat(Kernel(reach * spacing), integrator="rkc")
        margin = model.stencil(spacing, 1).reach[0]
        lattice = Lattice(spacing, (0.5 - margin) * spacing, 1 + (margin - 0.5) * spacing)
        held = [Temperature("x-", 0.0, "mirror"), Temperature("x+", 0.0, "mirror")]
        sim = Simulation(lattice, model, Free(), {"u": 1.0}, constraints=held, dt=0.05 / 400)
        sim.step(400)
        inside = slice(margin, -margin)
        exact = Slab(1.0, 1.0, [(0, 1, 1.0)]).temperature(lattice.axes[0][inside], 0.05)
        errors.append(np.abs(sim.fields["u"][inside] - exact).max())
        spacings.append(spacing)
    assert fitted_rate(spacings, errors) == pytest.approx(2, abs=0.15)


@pytest.mark.parametrize("dim", [2, 3])
def test_quenched_block_is_the_product_of_slabs(dim):
    """A quarter of a square, or an eighth of a cube, cooled from 1 to 0 on all sides by mirror conditions and
    insulated where it is cut. Second order.
    """
    counts, errors = ([16, 32] if dim == 3 else [16, 32, 64]), []
    slab = Slab(1.0, 1.0, [(0, 1, 1.0)], End(0.0, slope=True), End(0.0))
    for nodes in counts:
        spacing = 1 / nodes
        kernel = Kernel(2 * spacing, influence="linear")
        beyond = Heat(kernel).stencil(spacing, dim).reach[0]
        lattice = Lattice(spacing, ((0.5 - beyond) * spacing,) * dim, (1 + (beyond - 0.5) * spacing,) * dim)
        held = []
        for axis in "xyz"[:dim]:
            held += [Insulated(axis + "-"), Temperature(axis + "+", 0.0, "mirror")]
        rate = Heat(kernel).stencil(spacing, dim).symbol_maximum / spacing**2
        model = Heat(kernel, integrator=RungeKuttaChebyshev.for_step(5e-4, rate))
        sim = Simulation(lattice, model, Free(), {"u": 1.0}, constraints=held, dt=5e-4)
        sim.run(0.1, progress=False)
        inside = (slice(beyond, beyond + nodes),) * dim
        exact = box([slab] * dim, [lattice.axes[0][beyond:-beyond]] * dim, 0.1)
        errors.append(np.abs(sim.fields["u"][inside] - exact).max())
    assert fitted_rate(1 / np.array(counts), errors) == pytest.approx(2, abs=0.15)


def test_bad_input():
    for name in ("density", "specific_heat", "conductivity"):
        with pytest.raises(InputError, match=f"model.{name}: must be finite and positive"):
            Heat(kernel(3), **{name: -1.0})
    with pytest.raises(InputError, match="unknown self term"):
        Heat(kernel(3), self_term="yes")

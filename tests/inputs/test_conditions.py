"""Conditions on nodes: which nodes they set, their order against classical solutions, the heat balance, what is
refused.
"""

import os

import numpy as np
import pytest

from farhorizon import (
    Box,
    Convection,
    Crack,
    Disc,
    Expression,
    Fixed,
    Flux,
    Free,
    Heat,
    InputError,
    Insulated,
    Kernel,
    Lattice,
    LatticePML,
    Periodic,
    RungeKuttaChebyshev,
    Simulation,
    Source,
    Sponge,
    Temperature,
)
from farhorizon.analysis.references.classical import End, Slab
from farhorizon.inputs.conditions import resolve
from heat_solutions import half_space_convection
from helpers import fitted_rate
from threads_as_processes import on_threads

BAR = Lattice(1.0, 0.0, 9.0)
PLATE = Lattice(1.0, (0.0, 0.0), (9.0, 7.0))


def values(constraint, lattice=BAR, reach=3, **options):
    """Return what a condition sets at t = 2, where T = 1 + node number elsewhere; nan where it sets nothing."""
    table = resolve([constraint], lattice, [reach] * lattice.dim, **options)
    u = 1.0 + np.arange(np.prod(lattice.shape))
    out = np.full(u.shape, np.nan)
    for i, node in enumerate(table.nodes):
        part = slice(table.starts[i], table.starts[i + 1])
        out[node] = table.weights[part] @ u[table.references[part]]
        out[node] += sum(time(2.0)[i] if space is None else space[i] * time(2.0) for space, time in table.source_terms)
        u[node] = out[node]
    return out.reshape(lattice.shape)


def test_layers_of_a_bar():
    """A single node, a volume, mirror images, eq. 22; the wall of the mirror kinds lies between nodes 2 and 3."""
    nan = np.nan
    np.testing.assert_equal(values(Temperature("x-", 5.0, "node")), [5.0] + 9 * [nan])
    np.testing.assert_equal(values(Temperature("x+", 5.0, "volume")), 7 * [nan] + 3 * [5.0])
    np.testing.assert_allclose(values(Temperature("x-", 5.0, "mirror"))[:3], 10 - np.array([6.0, 5.0, 4.0]))
    np.testing.assert_allclose(values(Temperature("x+", 5.0, "mirror"))[7:], 10 - np.array([7.0, 6.0, 5.0]))
    np.testing.assert_allclose(values(Flux("x-", 6.0, "layer"), conductivity=2.0)[:3], 4 + 3 * np.array([3, 2, 1]))
    np.testing.assert_allclose(values(Flux("x+", 6.0, "layer"), conductivity=2.0)[7:], 7 + 3 * np.array([1, 2, 3]))
    np.testing.assert_allclose(
        values(Flux("x-", 6.0, "mirror"), conductivity=2.0)[:3], np.array([6, 5, 4]) + 3 * np.array([5, 3, 1])
    )
    np.testing.assert_allclose(values(Insulated("x-"))[:3], [6, 5, 4])


def test_values():
    """Array of the face, array of the lattice, callable, expression and source all give 3 + y at the wall at t = 2."""
    y = np.arange(8.0)
    whole = np.broadcast_to(3 + y, (10, 8))
    for value in (
        3 + y,
        whole,
        lambda x, y, t: 1 + y + t,
        Expression("1 + y + t", 2),
        Source(lambda x, y: 1.5 + y / 2, lambda t: t),
    ):
        np.testing.assert_allclose(values(Temperature("x-", value, "node"), PLATE, 2)[0], 3 + y)
        np.testing.assert_allclose(values(Temperature("x+", value, "volume"), PLATE, 2)[8:], whole[8:])
    at_the_wall = values(Temperature("x-", lambda x, y, t: x, "mirror"), PLATE, 2)
    # 2 value - T(mirror): the wall is at x = 1.5
    np.testing.assert_allclose(at_the_wall[1] + 1 + 8 * 2 + np.arange(8), 2 * 1.5)


def test_conditions_that_stay_as_they_are():
    """A condition with a number or an array is constant; one with a function of time, or of place and time, is not."""
    region = Box(1.0, 2.0)
    for value in (3.0, np.ones(BAR.shape), Source(2.0)):
        assert resolve([Temperature(region, value)], BAR, [3]).constant
    for value in (Source(2.0, time=lambda t: t), lambda x, t: x * t):
        assert not resolve([Temperature(region, value)], BAR, [3]).constant


def test_regions():
    """Conditions in a shape, in a mask, and on a side within a shape."""
    inside = values(Temperature(Disc(2.1, (4, 4)), 7.0), PLATE)
    assert np.isfinite(inside).sum() == 13 and (inside[np.isfinite(inside)] == 7).all()
    mask = np.zeros((10, 8), bool)
    mask[2, 3] = True
    assert np.argwhere(np.isfinite(values(Temperature(mask, lambda x, y, t: x + t), PLATE))).tolist() == [[2, 3]]
    part = values(Temperature("y+", 1.0, "node", within=Box((2, 0), (5, 9))), PLATE)
    assert np.argwhere(np.isfinite(part)).tolist() == [[i, 7] for i in (2, 3, 4, 5)]


def test_a_body_has_its_own_outermost_nodes():
    """On a disc the condition of a side holds the nodes along the rim."""
    lattice = Lattice(1.0, (-6.0, -6.0), (6.0, 6.0), body=Disc(5.2))
    held = np.isfinite(values(Temperature("x-", 1.0, "node"), lattice))
    x = lattice.coordinates()[0]
    outermost = lattice.mask & (x == np.where(lattice.mask, x, np.inf).min(axis=0))
    np.testing.assert_array_equal(held, outermost)


CONTRADICTIONS = {
    "two temperatures": [Temperature("x-", 0.0, "node"), Temperature("y-", 1.0, "node")],
    "temperature and flux": [Temperature("x-", 0.0, "node"), Flux("x-", 1.0, "layer")],
    "mirror and region": [Temperature(Disc(2.0, (0, 0)), 1.0), Temperature("y-", 0.0, "mirror")],
    "region and side": [Temperature(Disc(2.0, (0, 0)), 1.0), Temperature("x-", 0.0, "volume")],
    "temperature and power": [Temperature("x-", 0.0, "volume"), Flux("x-", 1.0)],
    "region and convection": [Temperature(Disc(2.0, (0, 0)), 1.0), Convection("x-", 1.0)],
    "time": [Temperature("x-", lambda x, y, t: t, "node"), Temperature("y-", lambda x, y, t: t, "node")],
}


@pytest.mark.parametrize("constraints", CONTRADICTIONS.values(), ids=CONTRADICTIONS)
def test_contradictions(constraints):
    with pytest.raises(
        InputError,
        match=r"two conditions on one node contradict each other; value: constraint\[0\] and constraint\[1\] near "
        r"\[0.0, 0.0\]",
    ):
        resolve(constraints, PLATE, [2, 2])


def test_corners_of_layers_are_images_of_images():
    """Mirror conditions on two sides: a node in the corner is 2 b - (2 a - T) of the node across it; beside a plain
    layer it has that layer's value.
    """
    table = resolve([Temperature("y-", 5.0, "mirror"), Temperature("x-", 2.0, "mirror")], PLATE, [2, 2])
    u = np.arange(80.0).reshape(10, 8)
    exact = u.copy()
    exact[:2] = 4 - exact[3:1:-1]
    exact[:, :2] = 10 - exact[:, 3:1:-1]
    flat = u.ravel()
    for i, node in enumerate(table.nodes):
        part = slice(table.starts[i], table.starts[i + 1])
        flat[node] = table.weights[part] @ flat[table.references[part]] + sum(
            space[i] for space, _ in table.source_terms
        )
    np.testing.assert_allclose(u, exact)
    assert len(set(table.nodes.tolist())) == len(table.nodes) == 2 * 8 + 2 * 8
    both = resolve([Insulated("y-"), Temperature("x-", 2.0, "volume")], PLATE, [2, 2])
    assert both.owner[np.isin(both.nodes, [0, 1, 8, 9])].tolist() == [1] * 4


def test_what_agrees_is_no_contradiction():
    table = resolve([Temperature("x-", 1.0, "node"), Temperature("y-", 1, "node")], PLATE, [2, 2])
    assert len(table.nodes) == 8 + 9


BAD = {
    "flux on a part one node wide": (
        Flux("x-", 1.0),
        {"lattice": Lattice(1.0, (0.0, 0.0), (9.0, 9.0), body=Box((3, 0), (3.4, 9)))},
        "two nodes wide",
    ),
    "flux layer": (Flux("x-", 1.0, "layer"), {"lattice": Lattice(1.0, 0.0, 3.0)}, "two nodes wide"),
    "thin body": (Temperature("x-", 1.0, "mirror"), {"lattice": Lattice(1.0, 0.0, 4.0)}, "too thin"),
    "no such side": (Temperature("y-", 1.0), {"lattice": BAR}, "no such side"),
    "nan": (Temperature("x-", np.nan), {"lattice": BAR}, "must be finite"),
    "squares that overflow": (Convection("x-", 1.0, ambient=1e300), {"lattice": BAR}, "squares.* overflow"),
    "shape of array": (Temperature("x-", np.ones(3), "node"), {"lattice": PLATE}, "shape of the side"),
    "empty": (Temperature(Disc(0.1, (0.5, 0.5)), 1.0), {"lattice": PLATE}, "no node lies in the shape"),
    "not a constraint": (3.0, {"lattice": BAR}, "not a constraint"),
}


@pytest.mark.parametrize(("constraint", "options", "message"), BAD.values(), ids=BAD)
def test_bad_input(constraint, options, message):
    lattice = options["lattice"]
    with pytest.raises(InputError, match=message):
        resolve([constraint], lattice, [3] * lattice.dim)


def test_bad_conditions():
    for make, message in [
        (lambda: Temperature("left", 0.0), "a side, a shape or a mask"),
        (lambda: Temperature("x-", 0.0, "soft"), "unknown kind"),
        (lambda: Temperature(Disc(1.0), 0.0, "mirror"), "unknown kind|needs a side"),
        (lambda: Insulated(Disc(1.0)), "needs a side"),
        (lambda: Convection("x-", -1.0), "constraint.transfer: must be finite and not negative"),
        (lambda: Convection("x-", 1.0, ambient="warm"), r"constraint\.ambient: unknown name 'warm'"),
        (lambda: Temperature("x-", "warm"), r"constraint\.value: unknown name 'warm'"),
        (lambda: Flux("x-", Source("warm", "t")), r"constraint\.value: unknown name 'warm'"),
    ]:
        with pytest.raises(InputError, match=message):
            make()


def test_conditions_keep_off_absorbing_sides():
    with pytest.raises(InputError, match="within one reach of the absorbing side x-"):
        Simulation(PLATE, Heat(Kernel(2.0)), LatticePML(), constraints=[Temperature("x-", 0.0, "node")])
    Simulation(
        PLATE,
        Heat(Kernel(2.0)),
        {"x-": Free(), "x+": LatticePML(), "y": Periodic()},
        constraints=[Temperature("x-", 0.0, "node")],
    ).step(3)


# Against classical solutions: a bar of length 1, diffusivity 1 (conductivity 2, heat capacity 2), at t = 0.05


def bar_error(nodes, conditions, slab, reach=2, until=0.05, layers=(True, True), exact=None):
    """Return the largest error of a bar, whose conditions hold on nodes beyond those ends that `layers` marks."""
    spacing = 1 / nodes
    kernel = Kernel(reach * spacing)
    beyond = [Heat(kernel).stencil(spacing, 1).reach[0] * layer for layer in layers]
    low = (0.5 - beyond[0]) * spacing
    lattice = Lattice(spacing, low, low + (nodes + sum(beyond) - 1) * spacing)
    inside = slice(beyond[0], beyond[0] + nodes)
    x = lattice.axes[0][inside]
    start = np.zeros(lattice.shape)
    start[inside] = slab.temperature(x, 0.0)
    model = Heat(kernel, density=2.0, conductivity=2.0, integrator=RungeKuttaChebyshev(30))
    sim = Simulation(lattice, model, Free(), {"u": start}, constraints=conditions, dt=until / 200, balance=True)
    sim.step(200)
    wanted = slab.temperature(x, until) if exact is None else exact(x, until)
    return np.abs(sim.fields["u"][inside] - wanted).max(), sim


def smooth(left, right):
    """Return a slab that starts at 0."""
    return Slab(1.0, 1.0, [], left, right)


ORDERS = {
    "mirror": (
        [Temperature("x-", 1.0, "mirror"), Temperature("x+", -2.0, "mirror")],
        smooth(End(1.0), End(-2.0)),
        (True, True),
        2,
    ),
    "mirror and flux": (
        [Temperature("x-", 1.0, "mirror"), Flux("x+", 6.0, "mirror")],
        smooth(End(1.0), End(3.0, slope=True)),
        (True, True),
        2,
    ),
    "volume": (
        [Temperature("x-", 1.0, "volume"), Temperature("x+", 0.0, "volume")],
        smooth(End(1.0), End(0.0)),
        (True, True),
        1,
    ),
    "flux layer": (
        [Flux("x-", 6.0, "layer"), Temperature("x+", 0.0, "mirror")],
        smooth(End(-3.0, slope=True), End(0.0)),
        (True, True),
        1,
    ),
    "flux as a source": (
        [Flux("x-", 6.0), Temperature("x+", 0.0, "mirror")],
        smooth(End(-3.0, slope=True), End(0.0)),
        (False, True),
        1,
    ),
    "insulated": (
        [Insulated("x-"), Temperature("x+", 1.0, "mirror")],
        smooth(End(0.0, slope=True), End(1.0)),
        (True, True),
        2,
    ),
}


@pytest.mark.parametrize(("conditions", "slab", "layers", "order"), ORDERS.values(), ids=ORDERS)
def test_order_in_space(conditions, slab, layers, order):
    """The mirror kinds are of second order in the horizon at a fixed number of nodes in it, the others of first."""
    counts = np.array([20, 40, 80])
    errors = [bar_error(n, conditions, slab, layers=layers)[0] for n in counts]
    assert fitted_rate(1 / counts, errors) > order - 0.2


def test_convection():
    """A bar in a fluid, as long as its other end is not affected, against the half-space (Carslaw and Jaeger, 2.7)."""
    counts = np.array([40, 80, 160])
    errors = []
    for nodes in counts:
        held = [Convection("x-", 4.0, 1.0)]
        exact = lambda x, t: half_space_convection(x, t, 1.0, 2.0, 4.0)  # noqa: E731
        errors.append(
            bar_error(nodes, held, smooth(End(0.0), End(0.0)), until=0.01, layers=(False, False), exact=exact)[0]
        )
    assert fitted_rate(1 / counts, errors) > 0.8
    assert errors[-1] < 0.01


def test_background_changes_nothing():
    """Values are relative to the background only internally."""
    conditions = [Temperature("x-", 4.0, "mirror"), Convection("x+", 3.0, 2.0)]
    found = []
    for background in (0.0, 5.0):
        sim = Simulation(
            Lattice(0.1, 0.0, 3.0), Heat(Kernel(0.3)), Free(), {"u": 5.0}, constraints=conditions, background=background
        )
        sim.step(200)
        found.append(sim.fields["u"])
    np.testing.assert_allclose(found[1], found[0], atol=1e-13)


# Heat balance

BALANCED = {
    "bar": lambda integrator: Simulation(
        Lattice(0.1, 0.0, 4.0),
        Heat(Kernel(0.3), 2.0, 3.0, 4.0, integrator),
        Free(),
        {"u": lambda x: np.sin(x)},
        sources=[Source(2.0, np.cos)],
        constraints=[Temperature("x-", 1.0, "mirror"), Convection("x+", 5.0, lambda x, t: 2 + t)],
        balance=True,
    ),
    "plate with a hole, a crack and a composite": lambda integrator: Simulation(
        Lattice(0.25, (-4.0, -4.0), (4.0, 4.0), body=Box((-4, -4), (4, 4)) - Disc(1.0)),
        Heat(Kernel(0.75), integrator=integrator),
        Free(),
        {"u": lambda x, y: np.exp(-(x**2))},
        coefficient=np.where(np.arange(33)[:, None] > 20, 3.0, 1.0) * np.ones((33, 33)),
        cracks=[[[-3.0, 2.1], [3.0, 2.1]], Crack([[-3.0, -2.1], [3.0, -2.1]], 0.3, opens=0.2)],
        constraints=[
            Temperature("x-", 3.0),
            Flux("x+", lambda x, y, t: np.cos(y)),
            Temperature(Disc(0.4, (2, 2)), 1.0),
        ],
        balance=True,
    ),
    "absorbing and fixed sides": lambda integrator: Simulation(
        Lattice(0.25, (-2.0, -2.0), (2.0, 2.0)),
        Heat(Kernel(0.75), integrator=integrator),
        {"x": LatticePML(), "y-": Fixed(0.0), "y+": Free()},
        {"u": lambda x, y: np.exp(-16 * (x**2 + y**2))},
        balance=True,
    ),
    "a hot disc in an unbounded medium": lambda integrator: Simulation(
        Lattice(0.5, (-8.0, -6.0), (8.0, 6.0)),
        Heat(Kernel(1.5), 2.0, 3.0, 4.0, integrator),
        LatticePML(nodes=8),
        constraints=[Temperature(Disc(2.0), "70 + t")],
        background=20.0,
        balance=True,
    ),
    "block": lambda integrator: Simulation(
        Lattice(1.0, (0.0,) * 3, (8.0,) * 3),
        Heat(Kernel(2.0), integrator=integrator),
        {"all": Free(), "z": Periodic()},
        {"u": lambda x, y, z: np.cos(x + z)},
        constraints=[Temperature("x-", 2.0, "node"), Convection("y+", 1.0, 7.0)],
        balance=True,
    ),
}


@pytest.mark.parametrize("integrator", ["euler", "rk4", RungeKuttaChebyshev(9)], ids=str)
@pytest.mark.parametrize("make", BALANCED.values(), ids=BALANCED)
def test_heat_balance(make, integrator):
    """The stored heat is the heat that came in, to 1e-12 of all that moved; the entries are not all zero."""
    sim = make(integrator)
    sim.step(100)
    found = sim.balance()
    residual = found.pop("residual")
    moved = sum(abs(v) for v in found.values())
    assert moved > 1e-3
    assert abs(residual) < 1e-12 * max(
        moved, float(np.nansum(np.abs(sim.fields["u"]))) * sim.lattice.spacing**sim.lattice.dim
    )


def test_balance_knows_the_power_of_a_flux():
    """A flux as a source brings in exactly its value times area times time."""
    sim = Simulation(
        PLATE, Heat(Kernel(2.0), 2.0, 3.0, 4.0), Free(), constraints=[Flux("x-", 5.0), Flux("y+", -2.0)], balance=True
    )
    sim.step(30)
    found = sim.balance()
    assert found["constraint[0]"] == pytest.approx(5.0 * 8 * sim.time, rel=1e-13)
    assert found["constraint[1]"] == pytest.approx(-2.0 * 10 * sim.time, rel=1e-13)
    with pytest.raises(InputError, match="records no balance"):
        Simulation(PLATE, Heat(Kernel(2.0)), Free()).balance()


def test_restored_run_is_bitwise_the_uninterrupted_one(tmp_path):
    """It has prescribed nodes, a crack that opens before and one that opens after the checkpoint, and a balance."""

    def make():
        held = [Temperature("x-", 3.0, "mirror"), Convection("x+", 2.0, Expression("1 + sin(t)", 2))]
        cracks = [Crack([[2.0, 3.5], [6.0, 3.5]], 0.2, opens=0.5), Crack([[2.0, 5.5], [6.0, 5.5]], opens=1.5)]
        model, start = Heat(Kernel(2.0), integrator="rk4"), {"u": lambda x, y: x * y}
        return Simulation(PLATE, model, Free(), start, constraints=held, cracks=cracks, balance=True, dt=0.05)

    whole, part = make(), make()
    whole.step(40)
    part.step(20)
    part.save(tmp_path / "state.h5")
    again = Simulation.restore(tmp_path / "state.h5")
    again.step(20)
    np.testing.assert_array_equal(again.fields["u"], whole.fields["u"])
    assert again.balance() == whole.balance()


SURFACES = {
    "convection": Convection("y+", 2.0, 5.0),
    "held": Temperature("y+", 5.0),
    "one layer held": Temperature("y+", 5.0, "node"),
}


def ground(half, depth, surface, sides):
    """Return ground warmed below its surface, off the middle, which cools in surroundings of 5 degrees."""
    lattice = Lattice(0.25, (-half, -depth), (half, 0.0))
    start = {"u": lambda x, y: 5 + 10 * np.exp(-8 * ((x - 1.0) ** 2 + (y + 1.0) ** 2))}
    return Simulation(lattice, Heat(Kernel(0.5)), sides, start, background=5.0, constraints=[surface], dt=0.02)


@pytest.mark.parametrize("surface", SURFACES.values(), ids=SURFACES)
def test_surfaces_run_into_the_layers(surface):
    """The reference is ground so wide that nothing returns, up to 1 R^2 / D: the error is below 1e-9 of what is left,
    while a surface that ends with the near field is wrong by a third.
    """
    layers = {"x": LatticePML(nodes=20), "y-": LatticePML(nodes=20), "y+": Free()}
    near, wide = ground(3.0, 3.0, surface, layers), ground(24.0, 24.0, surface, Free())
    ended = ground(3.0, 3.0, surface, {"x": Free(), "y-": LatticePML(nodes=20), "y+": Free()})
    part = (slice(84, 109), slice(84, 97))
    for t in (1.0, 3.0, 9.0):
        for sim in (near, wide, ended):
            sim.run(t, progress=False)
        left = np.abs(wide.fields["u"] - 5).max()
        assert np.abs(near.fields["u"] - wide.fields["u"][part]).max() < 1e-9 * left
    assert np.abs(ended.fields["u"] - wide.fields["u"][part]).max() > 0.3 * left


def test_a_convective_surface_beside_a_sponge_and_through_a_checkpoint(tmp_path):
    """The surface's nodes in the sponge lose heat to both; a restored run is bitwise the uninterrupted one."""
    runs = [ground(3.0, 3.0, SURFACES["convection"], {"x": Sponge(8), "y-": Sponge(8), "y+": Free()}) for _ in range(2)]
    runs[0].run(3.0, progress=False)
    assert 0 < np.abs(runs[0].fields["u"] - 5).max() < 10
    runs[1].step(70)
    runs[1].save(tmp_path / "a.ckpt")
    again = Simulation.restore(tmp_path / "a.ckpt")
    again.run(3.0, progress=False)
    assert np.array_equal(again.fields["u"], runs[0].fields["u"])


@pytest.mark.parametrize(
    "surface, said",
    [
        (Convection("y+", 2.0, 7.0), "must come to rest.*remedy: background"),
        (Temperature("y+", 7.0), "must come to rest"),
        (Temperature("y+", lambda x, y, t: 5 + np.sin(t)), "must come to rest"),
        (Temperature("y+", 5.0, "mirror"), "must come to rest"),
        (
            Convection("y+", 2.0, 5.0, Box((-2.9, -1.0), (9.0, 1.0))),
            "ends or varies within one reach of the absorbing side x-",
        ),
    ],
)
def test_surfaces_that_cannot_go_on_are_refused(surface, said):
    with pytest.raises(InputError, match=said):
        ground(3.0, 3.0, surface, {"x": LatticePML(), "y-": LatticePML(), "y+": Free()})


def test_what_lies_outside_within_is_said_to_be_insulated():
    """A note gives numbers of nodes, except where the rest has its own condition, or where there is no rest."""
    sides = {"x": LatticePML(), "y-": LatticePML(), "y+": Free()}
    middle, rest = Box((-1.1, -9.0), (1.1, 9.0)), Box((-9.0, -9.0), (9.0, 9.0)) - Box((-1.1, -9.0), (1.1, 9.0))
    sim = ground(3.0, 3.0, Convection("y+", 2.0, 20.0, middle), sides)
    assert any("16 of the 25 nodes of side y+ are insulated" in note for note in sim.notes)
    lattice = sim.lattice
    both = [Convection("y+", 2.0, 20.0, middle), Convection("y+", 2.0, 5.0, rest)]
    for constraints in (both, [Convection("y+", 2.0, 5.0)]):
        sim = Simulation(lattice, Heat(Kernel(0.5)), sides, {"u": 5.0}, background=5.0, constraints=constraints)
        assert not any("insulated" in note for note in sim.notes)


def random_condition(rng, shape):
    """Return a random condition on a random side, with or without a random box, or in a disc."""
    within = None if rng.random() < 0.5 else Box(rng.uniform(-2, 8, 2), rng.uniform(9, 40, 2))
    side, kind = str(rng.choice(["x-", "x+", "y-", "y+"])), rng.integers(0, 5)
    value = lambda x, y, t: np.sin(x + 2 * y) + t  # noqa: E731
    if kind == 0:
        return Temperature(side, value, str(rng.choice(["node", "volume", "mirror"])), within)
    if kind == 1:
        return Flux(side, rng.standard_normal(shape), str(rng.choice(["source", "layer", "mirror"])), within)
    if kind == 2:
        return Insulated(side, str(rng.choice(["mirror", "layer"])), within)
    if kind == 3:
        return Convection(side, 2.0, value, within)
    return Temperature(Disc(4.0, tuple(rng.uniform(8, 20, 2))), rng.standard_normal(shape))


def told(table, lattice):
    """Return, by flat number in the whole lattice, what sets each node at t = 1.5 (nodes with weights, and a value),
    what is added to nodes, and what they lose.
    """
    held, whole = {}, np.arange(np.prod(lattice.whole.shape)).reshape(lattice.whole.shape)[lattice.within].ravel()
    added = np.zeros(len(table.nodes))
    for space, time in table.source_terms:
        added = added + (time(1.5) if space is None else space * time(1.5))
    for i, node in enumerate(table.nodes):
        here = slice(table.starts[i], table.starts[i + 1])
        held[whole[node]] = (whole[table.references[here]].tolist(), table.weights[here].tolist(), float(added[i]))
    fed = [time(1.5) if space is None else space * time(1.5) for _, (space, time) in table.sources]
    return held, fed, [leak for _, leak in table.leaks]


SEED = int(os.environ.get("FARHORIZON_SEED", np.random.default_rng().integers(2**31)))


def test_parts_have_the_conditions_of_the_whole():
    """Random conditions on random bodies, divided by random cuts: the parts have the conditions of the whole, or both
    are refused, or a cut passes through a layer.
    """
    print(f"seed {SEED}")
    rng, compared = np.random.default_rng(SEED), 0
    for _ in range(150):
        shape = tuple(rng.integers(16, 34, 2).tolist())
        hole = rng.random(shape) < 0.02
        lattice = Lattice(1.0, (0.0, 0.0), np.array(shape) - 1.0, body=~hole if rng.random() < 0.5 else None)
        given = [random_condition(rng, shape) for _ in range(rng.integers(1, 3))]
        conductivity, cuts = rng.uniform(1, 2, shape), [int(rng.integers(6, n - 6)) for n in shape]
        right = cuts[0], shape[0]
        boxes = [[(0, cuts[0]), (0, shape[1])], [right, (0, cuts[1])], [right, (cuts[1], shape[1])]]

        def of_part(team, lattice=lattice, given=given, boxes=boxes, conductivity=conductivity):
            part = lattice.part(boxes[team.number])
            return told(resolve(given, part, [2, 2], conductivity[part.within], 3.0, team.gather), part)

        try:
            held, fed, lost = told(resolve(given, lattice, [2, 2], conductivity, 3.0), lattice)
        except InputError:
            with pytest.raises(InputError):  # perhaps for another reason
                on_threads(3, of_part)
            continue
        try:
            found = on_threads(3, of_part)
        except InputError as error:
            assert "another process" in str(error), f"seed {SEED}"
            continue
        compared += 1
        assert {key: value for one, _, _ in found for key, value in one.items()} == held, SEED
        for number, ends in enumerate(boxes):
            within = tuple(slice(*end) for end in ends)
            for mine, whole in zip(found[number][1:], (fed, lost), strict=True):
                for one, other in zip(mine, whole, strict=True):
                    np.testing.assert_array_equal(one, other[within], err_msg=f"seed {SEED}")
    assert compared > 40

"""Flux and convection on surfaces of any form, against closed forms of Carslaw and Jaeger (1959)."""

import itertools

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import j0, j1, jn_zeros, y0, y1

import farhorizon as fh
from farhorizon.inputs.conditions import resolve

RADIUS = 1.0


def disc(nodes, sign=1, half=1.4, place=(0.13, -0.21), **condition):
    """A disc, or the ground around a hole of this form, with a radius of some nodes; the centre is none of them."""
    spacing = RADIUS / nodes
    count = round(half / spacing)
    centre = tuple(spacing * np.array(place))
    shape = fh.Disc(RADIUS, centre)
    edge = spacing * count
    body = shape if sign > 0 else fh.Box((-9.0, -9.0), (9.0, 9.0)) - shape
    lattice = fh.Lattice(spacing, (-edge, -edge), (edge, edge), body=body)
    one = (fh.Convection if "transfer" in condition else fh.Flux)(region=shape, **condition)
    heat = fh.Heat(fh.Kernel(2 * spacing), conductivity=1.0)
    sides = fh.Free() if sign > 0 else fh.LatticePML()
    start = {"u": condition.pop("start", 0.0)} if "transfer" not in condition else {"u": 1.0}
    sim = fh.Simulation(lattice, heat, sides, start if sign > 0 else None, constraints=[one])
    x, y = lattice.coordinates()
    return sim, np.hypot(x - centre[0], y - centre[1]), lattice.mask


def heated(r, t):
    """Of a disc into which a unit of heat flows per area and time (section 7.8)."""
    roots = jn_zeros(1, 40)[:, None, None]
    decaying = np.exp(-(roots**2) * t) * j0(roots * r) / (roots**2 * j0(roots))
    return 2 * t + r**2 / 2 - 1 / 4 - 2 * decaying.sum(0)


def cooled(r, t, biot):
    """Of a disc that loses its heat to a fluid (section 7.7)."""
    zeros = np.concatenate([[1e-9], jn_zeros(1, 30)])
    found = np.zeros(r.shape)
    for low, high in itertools.pairwise(zeros):
        root = brentq(lambda a: a * j1(a) - biot * j0(a), low, high)
        found += 2 * biot / (root**2 + biot**2) * np.exp(-(root**2) * t) * j0(root * r) / j0(root)
    return found


def around(r, t):
    """Of the ground around a cylinder from which a unit of heat flows per area and time (section 13.5)."""

    def part(u):
        over = j0(u * r) * y1(u) - y0(u * r) * j1(u)
        return -2 / np.pi * (1 - np.exp(-(u**2) * t)) * over / (u**2 * (j1(u) ** 2 + y1(u) ** 2))

    return quad(part, 0, 1, limit=200)[0] + quad(part, 1, 80, limit=2000)[0]


PLACES = ((0.0, 0.0), (0.13, -0.21), (0.5, 0.5), (0.37, 0.08))


@pytest.mark.parametrize("where", ["heated", "cooled"])
def test_a_disc(where):
    """Of first order: at most 0.45 h / R of the largest change, wherever its centre is; with 8 nodes around a node less
    than 3 %. Most of it is the area of the cells, which is not quite that of the disc.
    """
    t, sizes, errors = 0.3, (8, 16, 32), []
    for nodes in sizes:
        given = {"value": 1.0} if where == "heated" else {"transfer": 2.0, "ambient": 0.0}
        every = []
        for place in PLACES:
            sim, r, there = disc(nodes, place=place, **given)
            sim.run(until=t, progress=False)
            exact = heated(r, sim.time) if where == "heated" else 1 - cooled(r, sim.time, 2.0)
            u = sim.fields["u"] if where == "heated" else 1 - sim.fields["u"]
            every.append(np.abs(u - exact)[there].max() / exact[there].max())
        assert max(every) < 0.45 / nodes
        assert nodes > 8 or every[0] < 0.03
        errors.append(np.sqrt(np.mean(np.square(every))))
    assert np.polyfit(np.log(sizes), np.log(errors), 1)[0] < -0.8


def test_the_ground_around_a_hole():
    """Heat from a hole into an unbounded medium: less than 3 % of the temperature of its surface."""
    sim, r, there = disc(8, sign=-1, half=2.5, value=1.0)
    sim.run(until=1.0, progress=False)
    chosen = np.argwhere(there)[::97]
    exact = np.array([around(r[tuple(at)], sim.time) for at in chosen])
    found = np.array([sim.fields["u"][tuple(at)] for at in chosen])
    assert np.abs(found - exact).max() < 0.03 * around(1.0, sim.time)


@pytest.mark.parametrize("where", ["heated", "cooled"])
def test_faces_midway_between_nodes(where):
    """Of second order: a plate of half-thickness 1, as part of a longer bar."""
    errors, sizes, t = [], (8, 16, 32), 0.2
    n = np.arange(1, 30)[:, None]
    roots = [brentq(lambda a: a * np.sin(a) - 2 * np.cos(a), k * np.pi, (k + 0.5) * np.pi) for k in range(20)]
    roots = np.array(roots)[:, None]
    for nodes in sizes:
        spacing = 1 / nodes
        bar, plate = (
            fh.Lattice(spacing, -1.5 - spacing / 2, 1.5 + spacing / 2, body=fh.Box(-1.0, 1.0)),
            fh.Box(-1.0, 1.0),
        )
        one = fh.Flux(region=plate, value=1.0) if where == "heated" else fh.Convection(region=plate, transfer=2.0)
        heat = fh.Heat(fh.Kernel(3 * spacing), integrator="rk4")
        sim = fh.Simulation(bar, heat, fh.Free(), {"u": float(where == "cooled")}, constraints=[one])
        sim.run(until=t, progress=False)
        x, t0 = bar.axes[0][bar.mask], sim.time
        parts = 2 * (-1.0) ** n / (n * np.pi) ** 2 * np.exp(-((n * np.pi) ** 2) * t0) * np.cos(n * np.pi * x)
        exact = t0 + x**2 / 2 - 1 / 6 - parts.sum(0)
        if where == "cooled":
            size = 2 * np.sin(roots) / (roots + np.sin(roots) * np.cos(roots))
            exact = (size * np.exp(-(roots**2) * t0) * np.cos(roots * x)).sum(0)
        errors.append(np.abs(sim.fields["u"][bar.mask] - exact).max())
    assert np.polyfit(np.log(sizes), np.log(errors), 1)[0] < -1.8, errors


def powers(lattice, region, reach=3.0, **more):
    """Powers of a unit flux per area, node by node, times the volume of a node."""
    stencil = fh.Stencil.from_kernel(fh.Kernel(reach * lattice.spacing), lattice.spacing, lattice.dim)
    table = resolve([fh.Flux(region=region, value=1.0, **more)], lattice, stencil.reach, stencil=stencil)
    ((_, (space, _)),) = table.sources
    return lattice.spacing**lattice.dim * space


ROOM = fh.Box((-30.0, -30.0), (30.0, 30.0))


@pytest.mark.parametrize(
    "region, area, corners",
    [
        (fh.Disc(8.0, (0.2, -0.3)), 16 * np.pi, 0),
        (fh.Box((-6.5, -0.5), (7.5, 0.5)), 30.0, 4),  # a baffle of one row of nodes, which bonds reach across
        (fh.Box((-6.5, -3.5), (7.5, 4.5)), 44.0, 4),
        (fh.Polygon([(-8.0, -6.0), (9.0, -5.0), (1.0, 9.0)]), np.hypot(17, 1) + np.hypot(8, 14) + np.hypot(9, 15), 3),
    ],
    ids=["disc", "baffle", "box", "triangle"],
)
def test_the_power_is_that_of_the_area(region, area, corners):
    """Of a hole and of a body, to a share of the spacing; where a body has corners, fewer bonds lead out."""
    for body in (ROOM - region, region) if area != 30 else (ROOM - region,):
        lattice = fh.Lattice(1.0, (-14.0, -14.0), (14.0, 14.0), body=body)
        assert powers(lattice, region).sum() == pytest.approx(area, rel=0.01, abs=0.55 * corners)


def test_a_part_of_a_surface_and_of_a_lattice():
    """Of a process, the nodes in its box; `within` restricts it further."""
    hole = fh.Disc(5.0, (0.2, -0.3))
    lattice = fh.Lattice(1.0, (-9.0, -9.0), (9.0, 9.0), body=ROOM - hole)
    whole = powers(lattice, hole)
    upper = lattice.part([(0, 19), (9, 19)])
    np.testing.assert_allclose(powers(upper, hole), whole[:, 9:], rtol=1e-12)
    above = powers(lattice, hole, within=fh.Box((-9.0, 0.5), (9.0, 9.0)))
    np.testing.assert_array_equal(above[:, 10:], whole[:, 10:])
    assert not above[:, :10].any()


def test_the_balance_has_it():
    """Heat that flows in and is lost again, to rounding."""
    hole = fh.Disc(5.0, (0.2, -0.3))
    lattice = fh.Lattice(1.0, (-9.0, -9.0), (9.0, 9.0), body=ROOM - hole)
    given = [fh.Flux(region=hole, value="1 + x*t"), fh.Convection(region=hole, transfer=0.3, ambient="cos(t)")]
    sim = fh.Simulation(lattice, fh.Heat(fh.Kernel(3.0)), fh.Free(), constraints=given, balance=True, background=2.0)
    sim.run(until=5.0, progress=False)
    found = sim.balance()
    assert abs(found["residual"]) < 1e-12 * found["constraint[0]"]
    assert found["constraint[0]"] == pytest.approx(10 * np.pi * (sim.time + 0.1 * sim.time**2), rel=0.03)
    assert found["constraint[1]"] < 0


@pytest.mark.parametrize(
    "make, words",
    [
        (lambda: fh.Flux(value=1.0), "either a side or a region"),
        (lambda: fh.Flux("x-", 1.0, region=fh.Disc(1.0)), "either a side or a region"),
        (lambda: fh.Flux("x-"), "value is missing"),
        (lambda: fh.Convection(region=fh.Disc(1.0)), "transfer is missing"),
        (lambda: fh.Flux(region=fh.Disc(1.0), value=1.0, kind="mirror"), "at sides only"),
        (lambda: fh.Flux(region="x-", value=1.0), "a shape"),
        (lambda: powers(fh.Lattice(1.0, (-9.0, -9.0), (9.0, 9.0)), fh.Disc(3.0)), "no surface"),
        (lambda: powers(fh.Lattice(1.0, (-9.0, -9.0), (9.0, 9.0), body=fh.Disc(8.0)), fh.Disc(3.0)), "no surface"),
        (lambda: powers(fh.Lattice(1.0, -9.0, 9.0, body=fh.Box(-8.0, 8.0)), fh.Disc(3.0)), "dimension"),
    ],
)
def test_bad_input(make, words):
    with pytest.raises(fh.InputError, match=words):
        make()


CASE = """
model = { type = "heat", kernel = { horizon = 0.75 } }
boundary = { all = { type = "free" } }
run = { until = 1.0, dt = 0.025 }

[lattice]
spacing = 0.25
lower = [-4.0, -4.0]
upper = [4.0, 4.0]
body = { box = { lower = [-5.0, -5.0], upper = [5.0, 5.0] }, without = [{ disc = { radius = 2.0 } }] }

[[constraint]]
type = "flux"
region = { disc = { radius = 2.0 } }
value = "1 + x"

[[constraint]]
type = "convection"
region = { disc = { radius = 2.0 } }
transfer = 0.5
value = 3.0
within = { box = { lower = [-5.0, 0.0], upper = [5.0, 5.0] } }
"""


def test_a_case_file_and_a_checkpoint(tmp_path):
    """They hold the same conditions as a script."""
    hole, upper = fh.Disc(2.0), fh.Box((-5.0, 0.0), (5.0, 5.0))
    lattice = fh.Lattice(0.25, (-4.0, -4.0), (4.0, 4.0), body=fh.Box((-5.0, -5.0), (5.0, 5.0)) - hole)
    given = [fh.Flux(region=hole, value="1 + x"), fh.Convection(region=hole, transfer=0.5, ambient=3.0, within=upper)]
    sim = fh.Simulation(lattice, fh.Heat(fh.Kernel(0.75)), fh.Free(), constraints=given, dt=0.025)
    (tmp_path / "case.toml").write_text(CASE)
    other = fh.Simulation.of(fh.read_case(tmp_path / "case.toml").setup)
    for one in (sim, other):
        one.step(10)
    sim.save(tmp_path / "state.h5")
    again = fh.Simulation.restore(tmp_path / "state.h5")
    for one in (sim, other, again):
        one.step(10)
        np.testing.assert_array_equal(one.fields["u"], sim.fields["u"])
    assert np.nanmax(sim.fields["u"]) > 0

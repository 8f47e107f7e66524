"""Sources at points, along lines and on patches: strength, position, exact solutions, and what is refused."""

import os

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.references.full_space import FullSpace, scalar_wave_in_the_plane
from farhorizon.case.case import Case
from farhorizon.geometry.interpolation import interpolation_blocks

SEED = int(os.environ.get("FARHORIZON_SEED", np.random.default_rng().integers(2**31)))


@pytest.fixture
def rng():
    print(f"seed {SEED}")
    return np.random.default_rng(SEED)


def square(half, spacing):
    return fh.Lattice(spacing, (-half, -half), (half, half))


def elastic(spacing, **constants):
    return fh.Elastic(fh.Kernel(2 * spacing), **{"young": 2.5, "density": 1.3, **constants})


def rate_of(spacings, errors):
    return np.polyfit(np.log(spacings), np.log(errors), 1)[0]


def courses(setup, points, until):
    """Return the field at points at every step, shape (steps, components, n), and the times."""
    receivers = fh.Receivers(points)
    fh.Simulation.of(setup, observe=[receivers]).run(until, progress=False)
    found = receivers.data["u"]
    return np.moveaxis(found.reshape(*found.shape[:2], -1), 1, 2), receivers.times


# Strength


@pytest.mark.parametrize("interpolation", ["sinc", "linear"])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_strength_does_not_depend_on_the_lattice(dim, interpolation, rng):
    """The sum of the density times the volume of a cell is the force, wherever the point lies."""
    for spacing in (0.25, 1.0):
        lattice = fh.Lattice(spacing, [-9.0 * spacing] * dim, [9.0 * spacing] * dim)
        at = spacing * rng.uniform(-0.9, 0.9, dim)
        (source,) = fh.PointSource(at, 2.5, interpolation=interpolation).placed(lattice, 1, "source")
        assert source.value.sum() * spacing**dim == pytest.approx(2.5, rel=1e-14)
        if dim > 1:
            force = rng.standard_normal(dim)
            (source,) = fh.PointForce(at, force, interpolation=interpolation).placed(lattice, dim, "source")
            total = source.value.reshape(dim, -1).sum(1) * spacing**dim
            np.testing.assert_allclose(total, force, rtol=1e-13)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_moment_tensor_has_no_force_and_its_moment(dim, rng):
    """The total force is exactly zero; the moment of the forces is the tensor, and has no torque since the tensor is
    symmetric, up to the error with which the weights interpolate a linear field.
    """
    spacing = 0.5
    lattice = fh.Lattice(spacing, [-5.0] * dim, [5.0] * dim)
    for _ in range(5):
        moment, at = rng.standard_normal((dim, dim)), spacing * rng.uniform(-0.9, 0.9, dim)
        moment = moment + moment.T
        (source,) = fh.MomentTensor(at, moment).placed(lattice, dim, "source")
        assert np.abs(source.value.reshape(dim, -1).sum(1)).max() < 1e-13 * np.abs(source.value).sum()
        places = np.reshape(lattice.coordinates(), (dim, -1))
        found = source.value.reshape(dim, -1) @ places.T * spacing**dim
        slope = np.zeros(dim)
        for axis in range(dim):
            nodes, weights = interpolation_blocks(lattice, at[None], derivative=axis).entries()
            slope[axis] = (weights * places[axis, nodes]).sum()
        np.testing.assert_allclose(found, moment * slope, rtol=0, atol=1e-12)
        assert np.abs(found - moment).max() < 1e-4 * np.abs(moment).max()


def test_a_double_couple_is_that_of_the_formulas(rng):
    """The formulas are those of Aki and Richards (2002), Box 4.4, with x north, y east and z down."""
    strike, dip, rake = rng.uniform([0, 0, -180], [360, 90, 180])
    f, d, r = np.radians([strike, dip, rake])
    xx = -(np.sin(d) * np.cos(r) * np.sin(2 * f) + np.sin(2 * d) * np.sin(r) * np.sin(f) ** 2)
    xy = np.sin(d) * np.cos(r) * np.cos(2 * f) + np.sin(2 * d) * np.sin(r) * np.sin(2 * f) / 2
    xz = -(np.cos(d) * np.cos(r) * np.cos(f) + np.cos(2 * d) * np.sin(r) * np.sin(f))
    yy = np.sin(d) * np.cos(r) * np.sin(2 * f) - np.sin(2 * d) * np.sin(r) * np.cos(f) ** 2
    yz = -(np.cos(d) * np.cos(r) * np.sin(f) - np.cos(2 * d) * np.sin(r) * np.cos(f))
    zz = np.sin(2 * d) * np.sin(r)
    turn = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])  # east, north, up
    known = 3.0 * turn @ [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]] @ turn.T
    found = fh.MomentTensor((0, 0, 0), 3.0, strike=strike, dip=dip, rake=rake).tensor(3)
    np.testing.assert_allclose(found, known, atol=1e-14)


def test_a_line_and_a_patch_have_their_length_and_area(rng):
    """The total and the first moment of a line source, and the total of a patch, are those of their geometry."""
    lattice = fh.Lattice(0.5, (-9.0, -9.0), (9.0, 9.0))
    corners = rng.uniform(-4, 4, (3, 2))
    (line,) = fh.LineSource(corners, 2.0).placed(lattice, 1, "source")
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    middle = lengths @ (corners[1:] + corners[:-1]) / 2
    assert line.value.sum() * 0.25 == pytest.approx(2 * lengths.sum(), rel=1e-13)
    found = [(line.value * x).sum() * 0.25 for x in lattice.coordinates()]
    np.testing.assert_allclose(found, 2 * middle, atol=1e-4 * lengths.sum())

    space = fh.Lattice(0.5, (-5.0, -5.0, -5.0), (5.0, 5.0, 5.0))
    array = fh.PhasedArray((-0.5, 0, 0), (0.5, 0, 0), 3, (0, 0, 2.0), "1", width=0.25, across=(0, 0.75, 0))
    for source in array.placed(space, 3, "source"):
        np.testing.assert_allclose(source.value.reshape(3, -1).sum(1) * 0.125, [0, 0, 2 * 0.25 * 0.75], atol=1e-14)


# Exact solutions

SPACINGS = (0.25, 1 / 6, 0.125)
PLACES = ((3.0, 0.0), (1.5, 2.5), (-2.5, 2.0))  # beyond the eight nodes over which a source is spread


def test_a_point_source_is_that_of_the_plane():
    """It converges to the exact solution in 2D with order 2; nothing returns from the walls until then."""
    at, until, errors = np.array([0.13, -0.07]), 14.0, []
    signal = fh.Ricker(0.15)
    for spacing in SPACINGS:
        model = fh.Wave(fh.Kernel(2 * spacing))
        sources = [fh.PointSource(at, 3.0, signal)]
        setup = fh.Setup(square(9.0, spacing), model, fh.Fixed(), sources=sources, threads=1)
        found, times = courses(setup, PLACES, until)
        distances = np.linalg.norm(np.array(PLACES) - at, axis=1)
        known = 3 * np.stack([scalar_wave_in_the_plane(r, times, signal) for r in distances], axis=-1)
        errors.append(np.abs(found[:, 0] - known).max() / np.abs(known).max())
    assert rate_of(SPACINGS, errors) > 1.9 and errors[-1] < 0.01, errors


def in_the_plane(rock, at, times, solution):
    """Return the displacement (n, 2) due to a line of sources: the integral of the solution in 3D along it, twice
    that of the half above the plane.
    """
    points, weights = np.polynomial.legendre.leggauss(160)
    far, above = rock.p_speed * times[-1], points > 0
    return sum(
        2 * w * far * solution(rock, np.array([*at, far * z]), times)[:2].T
        for z, w in zip(points[above], weights[above], strict=True)
    )


LOW = fh.Ricker(0.2)
AT = np.array([0.11, 0.06])
IN_THE_PLANE = {
    "force": (
        fh.PointForce(AT, (1.0, -0.5), LOW),
        lambda rock, at, times: rock.of_force(at, times, np.array([1.0, -0.5, 0.0]), LOW),
    ),
    "explosion": (
        fh.MomentTensor(AT, 1.0, LOW),
        lambda rock, at, times: rock.of_moment(at, times, np.diag([1.0, 1.0, 0.0]), LOW, 1.0),
    ),
}


@pytest.mark.parametrize(("source", "solution"), IN_THE_PLANE.values(), ids=IN_THE_PLANE)
def test_a_force_and_an_explosion_in_the_plane(source, solution):
    """They converge to the exact solutions with order 2; nothing returns from the walls until then."""
    errors, half, until = [], 11.0, 12.0
    for spacing in SPACINGS:
        model = elastic(spacing)
        rock = FullSpace(model.p_speed, model.s_speed, model.density)
        assert rock.p_speed * until < 2 * half - 3.3
        setup = fh.Setup(square(half, spacing), model, fh.Fixed(), sources=[source], threads=1)
        found, times = (rows[::5] for rows in courses(setup, PLACES, until))
        known = np.stack([in_the_plane(rock, place - AT, times, solution) for place in np.array(PLACES)], axis=-1)
        errors.append(np.abs(found - known).max() / np.abs(known).max())
    assert rate_of(SPACINGS, errors) > 1.9 and errors[-1] < 0.02, errors


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["force", "explosion", "double couple"])
def test_in_space(kind):
    """Finite elements, which have no horizon, converge to Aki and Richards (2002), eqs 4.23 and 4.29, with order 2."""
    signal, at, moment = fh.Gaussian(1.4), np.array([0.1, -0.05, 0.07]), np.eye(3)
    if kind == "force":
        source = fh.PointForce(at, (0.3, 1.0, -0.5), signal)
    elif kind == "explosion":
        source = fh.MomentTensor(at, 1.0, signal)
    else:
        source = fh.MomentTensor(at, 1.0, signal, strike=20.0, dip=70.0, rake=30.0)
        moment = source.tensor(3)
    # received beyond the eight nodes over which a source is spread; what returns by then is below 1e-4
    spacings, errors, half, until = (0.24, 0.2, 0.15), [], 6.0, 9.5
    places = np.array([(2.0, 0.0, 0.0), (1.0, 1.0, 1.0), (0.0, -1.0, 2.0)])
    for spacing in spacings:
        model = fh.Elastic(None, young=1.2, poisson=0.3, density=1.0, material="finite-element")
        rock = FullSpace(model.p_speed, model.s_speed, model.density)
        lattice = fh.Lattice(spacing, (-half,) * 3, (half,) * 3)
        found, times = courses(fh.Setup(lattice, model, fh.Fixed(), sources=[source]), places, until)
        if kind == "force":
            known = [rock.of_force(place - at, times, np.array(source.force), signal).T for place in places]
        else:
            known = [rock.of_moment(place - at, times, moment, signal, 1.4).T for place in places]
        known = np.stack(known, axis=-1)
        errors.append(np.abs(found - known).max() / np.abs(known).max())
    assert rate_of(spacings, errors) > 1.9 and errors[-1] < 0.05, errors


# Position


def moved(spacing, interpolation):
    """Return the effect of placing source and receivers between nodes, relative to a lattice shifted by a fraction of
    a spacing, on which all of them are nodes. They are so far apart that their weights share no nodes.
    """
    shift, signal, found = np.array([0.37, 0.21]) * spacing, fh.Ricker(0.12), []
    for by in (0.0, 1.0):
        corner = np.full(2, -15.0) + by * shift
        lattice = fh.Lattice(spacing, corner, corner + 30.0)
        source = fh.PointSource(shift, 1.0, signal, interpolation=interpolation)
        setup = fh.Setup(lattice, fh.Wave(fh.Kernel(2 * spacing)), fh.Fixed(), sources=[source], threads=1)
        places = np.array([(8.5, 0.0), (6.5, 6.0), (-8.5, 2.0)]) + shift
        found.append(courses(setup, places, 20.0)[0])
    return np.abs(found[1] - found[0]).max() / np.abs(found[0]).max()


def test_the_error_of_the_place():
    """Linear interpolation is of second order; the windowed sinc is below 1e-5 at some nodes per wavelength."""
    spacings = (0.5, 0.25, 0.125)
    linear = [moved(spacing, "linear") for spacing in spacings]
    assert rate_of(spacings, linear) > 1.9, linear
    assert moved(0.5, "sinc") < 1e-5 < linear[-1]


@pytest.mark.parametrize("material", ["uniform", "varied"])
def test_reciprocity(material, rng):
    """The record of a receiver at one point for a force at another is the same with both exchanged, at every step,
    also in a medium that varies: the operator is symmetric, and receivers have the weights of sources.
    """
    lattice = square(9.0, 0.5)
    factor = None if material == "uniform" else rng.uniform(0.3, 1.0, lattice.shape)
    a, b = rng.uniform([-4, -4], [-1, 4]), rng.uniform([1, -4], [4, 4])
    found = []
    for here, there, direction, component in ((a, b, 0, 1), (b, a, 1, 0)):
        source = fh.PointForce(here, np.eye(2)[direction], fh.Ricker(0.15))
        receiver = fh.Receivers([there])
        options = {"coefficient": factor, "sources": [source], "observe": [receiver], "threads": 1}
        fh.Simulation(lattice, elastic(0.5), {"all": fh.Fixed(), "y+": fh.Free()}, **options).run(40.0)
        found.append(receiver.data["u"][:, 0, component])
    assert np.abs(found[0]).max() > 1e-3
    assert np.abs(found[0] - found[1]).max() < 1e-12 * np.abs(found[0]).max()


# In a run


def test_work_of_a_point_force():
    """The work is the energy of the medium, as for any source."""
    source = fh.PointForce((0.2, -0.1), (0.3, 1.0), fh.Ricker(0.1))
    sim = fh.Simulation(square(12.0, 1.0), elastic(1.0), fh.Fixed(), sources=[source], balance=True, threads=1)
    sim.run(until=30.0)
    energies = sim.energies()
    assert energies["work"] > 0
    assert energies["kinetic"] + energies["strain"] == pytest.approx(energies["work"], rel=1e-10)


def test_heat_of_a_point_source():
    """The heat content is the power times the time."""
    model = fh.Heat(fh.Kernel(1.0), density=2.0, specific_heat=3.0, conductivity=1.0)
    options = {"sources": [fh.PointSource((0.1, 0.2), 5.0)], "balance": True, "threads": 1}
    sim = fh.Simulation(square(8.0, 0.5), model, fh.Free(), **options).run(7.0)
    assert 2.0 * 3.0 * sim.fields["u"].sum() * 0.25 == pytest.approx(5.0 * sim.time, rel=1e-12)
    assert sim.balance()["source[0]"] == pytest.approx(5.0 * sim.time, rel=1e-12)


def test_the_same_in_every_unit_system():
    """Megametres, nanoseconds and micrograms in place of metres, seconds and kilograms."""
    runs, nodes = [], []
    for length, time, mass in ((1.0, 1.0, 1.0), (1e-6, 1e9, 1e9)):
        modulus = mass / (length * time**2)
        force = modulus * length  # per unit length across the plane
        sources = [
            fh.PointForce((0.23 * length, -0.1 * length), (0.3 * force, force), fh.Ricker(0.1 / time)),
            fh.MomentTensor((length, 0.4 * length), 0.5 * force * length, fh.ToneBurst(0.05 / time, 4)),
            fh.LineSource([(0.0, length), (2 * length, length)], (force / length, 0.0), fh.Step(12.0 * time)),
        ]
        model = fh.Elastic(fh.Kernel(length), young=2.5 * modulus, density=1.3 * mass / length**3)
        sim = fh.Simulation(square(8.0 * length, 0.5 * length), model, fh.Fixed(), sources=sources, threads=1)
        nodes.append(sim.check(budget=0.1).numbers["shortest_wave_nodes"])
        runs.append(sim.run(20.0 * time).fields["u"] / length)
    assert nodes[0] == pytest.approx(nodes[1], rel=1e-10) and nodes[0] > 1
    assert np.abs(runs[0] - runs[1]).max() < 1e-11 * np.abs(runs[0]).max()


def test_checkpoints_have_them(tmp_path):
    sources = [
        fh.PointForce((0.2, -0.1), (0.3, 1.0), fh.Ricker(0.1)),
        fh.MomentTensor((1.2, 0.1), [[1.0, 0.2], [0.2, -1.0]], fh.Step(5.0)),
        fh.LineSource([(0.0, 1.0), (2.0, 2.5)], (1.0, 0.0), "sin(t)"),
        fh.PhasedArray((-3, -2), (3, -2), 4, (0.0, 1.0), fh.ToneBurst(0.1, 2), speed=1.0, angle=20.0),
    ]
    sim = fh.Simulation(square(14.0, 1.0), elastic(1.0), fh.Fixed(), sources=sources, threads=1)
    sim.run(until=8.0)
    sim.save(tmp_path / "half.h5")
    other = fh.Simulation.restore(tmp_path / "half.h5")
    assert repr(other.setup.sources) == repr(sim.setup.sources)
    np.testing.assert_array_equal(other.run(16.0).fields["u"], sim.run(16.0).fields["u"])


CASE = """
lattice = { spacing = 1.0, lower = [-12.0, -12.0], upper = [12.0, 12.0] }
model = { type = "elastic", young = 1.0, kernel = { horizon = 2.0 } }
boundary = { all = { type = "fixed" } }
run = { until = 10.0 }
[[source]]
"""


@pytest.mark.parametrize(
    ("text", "source"),
    [
        (
            'type = "point-force"\nat = [0.2, 0.1]\nforce = [0, 1]\ntime = "sin(t)"',
            fh.PointForce((0.2, 0.1), (0, 1), "sin(t)"),
        ),
        (
            'type = "moment-tensor"\nat = [0, 0]\nmoment = [[1, 0], [0, -1.5]]\ntime = { type = "step", rise = 3 }',
            fh.MomentTensor((0, 0), [[1, 0], [0, -1.5]], fh.Step(3)),
        ),
        ('type = "moment-tensor"\nat = [0, 0]\nmoment = 2', fh.MomentTensor((0, 0), 2.0)),
        ('type = "line-source"\npoints = [[0, 0], [1, 1]]\nstrength = [1, 0]', fh.LineSource([(0, 0), (1, 1)], (1, 0))),
        (
            'type = "phased-array"\nfirst = [-2, 0]\nlast = [2, 0]\nelements = 5\nstrength = [0, 1]\n'
            'time = { type = "ricker", frequency = 0.1 }\nspeed = 1\nfocus = [0, 5]\ninterpolation = "linear"',
            fh.PhasedArray((-2, 0), (2, 0), 5, (0, 1), fh.Ricker(0.1), 1.0, (0, 5), interpolation="linear"),
        ),
    ],
    ids=lambda value: "" if isinstance(value, str) else type(value).__name__,
)
def test_case_files(text, source):
    (found,) = Case(CASE + text).setup.sources
    assert repr(found) == repr(source)


# What is refused

HOLE = fh.Box((-12.0, -12.0), (12.0, 12.0)) - fh.Disc(2.0)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (fh.PointForce((13.0, 0.0), (1, 0)), r"source\.at: the point lies outside the near field; .*remedy: move it"),
        (fh.PointForce((11.3, 0.0), (1, 0)), r"source\.at: .* close to the edge.*limit: 8 nodes.*remedy: .*linear"),
        (fh.MomentTensor((11.0, 0.0), 1.0), r"limit: 8 nodes .*axis of a derivative; .*also on a node"),
        (fh.PointForce((0.0, 0.0, 0.0), (1, 0)), r"source\.at: has another shape"),
        (fh.PointForce((0.0, 0.0), (1, 0, 0)), r"source\.force: .*another field; value: 3 components; limit: 2"),
        (fh.PointSource((0.0, 0.0), 1.0), r"source\.strength: .*another field; value: one number; .*PointForce"),
        (fh.MomentTensor((0.0, 0.0), np.eye(3)), r"source\.moment: .*value: shape \(3, 3\); limit: shape \(2, 2\)"),
        (fh.MomentTensor((0, 0), 1.0, strike=0, dip=0, rake=0), r"source\.moment: .*value: strike, dip and rake"),
        (fh.LineSource([(0.0, 0.0), (20.0, 0.0)], (1, 0)), r"source\.points: the point lies outside the near field"),
        (fh.LineSource([(0.0, 0.0), (1e300, 1e300)], (1, 0)), r"source\.points: reaches beyond .*limit: \[-12, -12\]"),
        (fh.PhasedArray((0, 0), (1e30, 0), 2, (1, 0), 1.0), r"source\.first: reaches beyond the near field"),
    ],
)
def test_what_does_not_fit(source, message):
    with pytest.raises(fh.InputError, match=message):
        fh.Simulation(square(12.0, 1.0), elastic(1.0), fh.Fixed(), sources=[source], threads=1)


@pytest.mark.parametrize("at", [(0.5, 0.5), (2.6, 0.3)])
def test_in_a_hole_or_beside_it(at):
    lattice = fh.Lattice(1.0, (-12.0, -12.0), (12.0, 12.0), body=HOLE)
    with pytest.raises(fh.InputError, match=r"source\.at: the point"):
        fh.Simulation(lattice, elastic(1.0), fh.Fixed(), sources=[fh.PointForce(at, (1, 0))], threads=1)


@pytest.mark.parametrize(
    ("source", "key"),
    [
        (fh.PointForce((0.3, 0.0), (1, 0)), "at"),
        (fh.PointForce((0.3, 0.0), (1, 0), interpolation="linear"), "at"),
        (fh.MomentTensor((0.0, 0.0), 1.0), "at"),
        (fh.LineSource([(-9.0, -3.5), (9.0, -3.5)], (1, 0), interpolation="linear"), "points"),
        (fh.PhasedArray((-3.0, 0.5), (3.0, 0.5), 2, (1, 0), 1.0, interpolation="linear"), "first"),
    ],
)
def test_not_across_a_crack(source, key):
    """A source is not spread over nodes on the other side of a crack, on which it does not act."""
    crack, far = [[(0.4, -9.0), (0.4, 9.0)]], [[(9.4, -9.0), (9.4, 9.0)]]
    given = {"lattice": square(12.0, 0.5), "model": elastic(0.5), "boundary": fh.Fixed(), "sources": [source]}
    with pytest.raises(fh.InputError, match=rf"source\.{key}: a crack lies between .*limit: interpolation = "):
        fh.Simulation(**given, cracks=crack)
    if key == "at":
        fh.Simulation(**given, cracks=far)


def test_beside_a_crack():
    """On a node, or between nodes that all lie on its side, a force acts on this side alone."""
    crack, there = [[(0.6, -13.0), (0.6, 13.0)]], (square(12.0, 0.5).coordinates()[0] > 0.6)
    for at, interpolation in (((0.5, 0.0), "sinc"), ((0.3, 0.2), "linear"), ((-4.2, 0.2), "sinc")):
        source = fh.PointForce(at, (1, 0), interpolation=interpolation)
        sim = fh.Simulation(square(12.0, 0.5), elastic(0.5), fh.Free(), sources=[source], cracks=crack)
        sim.step(20)
        u = np.abs(sim.fields["u"])
        assert u[:, there].max() < 1e-12 * u.max()  # absent bonds are subtracted, to rounding


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: fh.PointForce([[0, 0]], (1, 0)), "one coordinate per axis"),
        (lambda: fh.PointForce((0, 0), [[1, 0]]), "one component per axis"),
        (lambda: fh.PointForce((0, 0), (1, 0), interpolation="cubic"), "unknown interpolation.*sinc, linear"),
        (lambda: fh.PointForce((0, 0), (1, 0), lambda x, y: x), "called with t"),
        (lambda: fh.MomentTensor((0, 0), np.ones(3)), "a number or a tensor"),
        (lambda: fh.MomentTensor((0, 0, 0), 1.0, strike=3), r"strike, dip, rake.*value: strike and a number"),
        (lambda: fh.MomentTensor((0, 0, 0), np.eye(3), strike=3, dip=4, rake=5), "and a tensor"),
        (lambda: fh.LineSource([(0, 0)], 1.0), "two points or more"),
        (lambda: fh.LineSource([(1, 0), (1, 0)], 1.0), "two points or more"),
    ],
)
def test_what_is_no_such_source(make, message):
    with pytest.raises(fh.InputError, match=message):
        make()


def test_a_signal_above_the_lattice():
    """Megahertz in place of hertz."""
    source = fh.PointForce((0.0, 0.0), (1, 0), fh.Ricker(1e6))
    with pytest.raises(fh.InputError, match=r"source\.time: half of the signal's amplitude.*value: from .*limit: 0\."):
        fh.Simulation(square(12.0, 1.0), elastic(1.0), fh.Fixed(), sources=[source], threads=1)

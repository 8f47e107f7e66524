"""Impactors, against exact solutions, conservation laws, Coulomb's law and a plain program."""

import warnings

import numpy as np
import pytest
from scipy.linalg import expm
from tests.interpreter import Interpreter

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.engine.features.sources import work_of_sources
from farhorizon.simulation.processes.subdomain import check_divisible

PLATE = fh.Lattice(0.5, (-6.0, -4.0), (6.0, 0.0))
KERNEL = fh.Kernel(1.5, exponent=1)
SOLID = fh.Elastic(KERNEL, 1.0)
SOLIDS = {
    "bonds": SOLID,
    "bonds that break": fh.Elastic(KERNEL, 1.0, critical_stretch=0.03, nonlinear=True),
    "states": fh.Elastic(fh.Kernel(1.0, 1), 1.0, poisson=0.2, material="state-based"),
    "varying density": fh.Elastic(KERNEL, 1.0, density="2 + tanh(x)"),
}
#: Shapes of every kind above the plate, the lowest point at y = 0.4.
HALF = 0.4 + 2.0
SHAPES = {
    "disc": fh.Disc(2.0, (0.1, HALF)),
    "box": fh.Box((-2.1, 0.4), (1.9, 1.5)),
    "polygon": fh.Polygon([(-2.0, 1.5), (0.1, 0.4), (2.2, 1.4), (0.0, 4.0)]),
    "union": fh.Disc(1.0, (-1.2, 1.4)) | fh.Disc(1.0, (1.2, 1.4)),
    "intersection": fh.Disc(2.0, (0.1, HALF)) & fh.Box((-1.0, 0.0), (3.0, 3.0)),
    "difference": fh.Box((-2.1, 0.4), (1.9, 1.5)) - fh.Disc(0.8, (0.1, 0.4)),
}


def hit(solid=SOLID, shape="disc", observe=(), dt=None, **options):
    """A free plate that an impactor hits from above."""
    given = {"mass": 5.0, "velocity": (0.02, -0.1), "stiffness": 0.6, **options}
    loads = [fh.Impactor(SHAPES[shape], **given)]
    return fh.Simulation(PLATE, solid, fh.Free(), loads=loads, observe=observe, dt=dt, balance=True)


def momentum(sim):
    """Momentum of a plate and of its impactor, half a step ago."""
    density = 1.0 if sim.parts.near.density is None else sim.parts.near.density
    return (sim.parts.near.mass * density * sim.fields["v"]).sum((1, 2)) + 5.0 * sim.parts.impactors.state[0, 1]


@pytest.mark.parametrize("friction", [0.0, 0.4])
@pytest.mark.parametrize("name", SOLIDS)
def test_momentum_is_exchanged_exactly(name, friction):
    sim = hit(SOLIDS[name], friction=friction)
    first = momentum(sim)
    sim.run(until=30.0)
    assert abs(sim.parts.impactors.state[0, 1] - (0.02, -0.1)).max() > 0.05
    assert (sim.energies().get("broken", 0.0) > 0) == ("break" in name)
    np.testing.assert_allclose(momentum(sim), first, rtol=0, atol=1e-10 * abs(first).max())


def test_momentum_is_exchanged_exactly_in_space_while_bonds_break():
    lattice = fh.Lattice(0.5, (-3.0, -3.0, -1.5), (3.0, 3.0, 0.0))
    model = fh.Elastic(fh.Kernel(0.5, 1), 1.0, critical_stretch=0.02)
    ball = fh.Impactor(fh.Ball(1.0, (0.1, 0.0, 1.1)), mass=5.0, velocity=(0.0, 0.02, -0.1), friction=0.3)
    sim = fh.Simulation(lattice, model, fh.Free(), loads=[ball], balance=True)
    sim.run(until=20.0)
    total = (sim.parts.near.mass * sim.fields["v"]).sum((1, 2, 3)) + 5.0 * sim.parts.impactors.state[0, 1]
    assert sim.energies()["broken"] > 0
    np.testing.assert_allclose(total, (0.0, 0.1, -0.5), rtol=0, atol=1e-10)


@pytest.mark.parametrize("shape", SHAPES)
def test_momentum_is_exchanged_by_every_shape(shape):
    motion = fh.Impacts()
    sim = hit(shape=shape, friction=0.2, observe=[motion])
    first = momentum(sim)
    sim.run(until=30.0)
    force = motion.data["force"][:, 0]
    assert force[:, 1].min() < -0.01 and force[:, 1].max() <= 1e-12
    np.testing.assert_allclose(momentum(sim), first, rtol=0, atol=1e-10 * abs(first).max())
    gained = np.diff(motion.data["velocity"][:, 0], axis=0) + sim.dt / 5.0 * (force[1:] + force[:-1]) / 2
    np.testing.assert_allclose(gained, 0, atol=1e-13)  # Newton's law for what is recorded


def energy_errors(dt, until=12.0, **options):
    """Errors of the energy of plate and impactor over that at the start, half a step ago in every step."""
    motion, others = fh.Impacts(), []
    sim = hit(dt=dt, observe=[motion], **options)
    for _ in range(round(until / dt)):
        sim.step(1)
        others.append([sim.parts.impactors.kinetic(), sim.parts.near.mass * work_of_sources(sim.engine)])
    energies = sim.energies()
    assert energies["kinetic"] + energies["strain"] == pytest.approx(energies["work"], rel=1e-10)  # of linear bonds
    sim.step(1)
    stored = motion.data["stored"][:, 0]
    kinetic, work = np.transpose(others)
    return (kinetic + work + (stored[1:] + stored[:-1]) / 2) / kinetic[0] - 1


def test_energy_is_conserved_to_the_square_of_the_step():
    errors = [np.sqrt((energy_errors(dt) ** 2).mean()) for dt in (0.1, 0.0125)]
    assert errors[0] < 5e-4
    assert np.log2(errors[0] / errors[1]) / 3 == pytest.approx(2, abs=0.2)


def test_friction_takes_energy():
    losses = [energy_errors(dt, friction=0.3, velocity=(0.1, -0.1))[-1] for dt in (0.1, 0.05)]
    assert -0.5 < losses[0] < -0.05
    assert losses[1] == pytest.approx(losses[0], rel=0.02)  # a property of the contact, not of the step


def slab_errors(dim, spacing):
    """A slab of mass M per area on a half-space, between them the stiffness k: ``M v' = -p`` and ``p' = k (v - p /
    rho c)``, because the surface of a half-space moves with p / (rho c). Errors of v and p over their largest values.
    """
    depth, last = (30.0 if dim == 2 else 12.0), "xyz"[dim - 1]
    lattice = fh.Lattice(spacing, (0.0,) * (dim - 1) + (-depth,), (4.0 - spacing,) * (dim - 1) + (0.0,))
    sides = dict.fromkeys("xy"[: dim - 1], fh.Periodic()) | {f"{last}-": fh.LatticePML(nodes=12), f"{last}+": fh.Free()}
    slab = fh.Box((-1.0,) * (dim - 1) + (0.0,), (5.0,) * (dim - 1) + (1.0,))
    area, mass_per_area, stiffness, first = 4.0 ** (dim - 1), 6.0, 1.5, 0.01
    velocity = (0.0,) * (dim - 1) + (-first,)
    load = fh.Impactor(slab, mass=mass_per_area * area, velocity=velocity, stiffness=stiffness)
    model, motion = fh.Elastic(fh.Kernel(2 * spacing, exponent=1), 1.0), fh.Impacts()
    sim = fh.Simulation(lattice, model, sides, loads=[load], observe=[motion])
    sim.run(until=12.0)
    law = np.array([[0.0, -1 / mass_per_area], [stiffness, -stiffness / model.p_speed]])  # density 1
    exact = np.array([expm(law * t) @ (first, 0.0) for t in motion.times])
    got = np.stack([-motion.data["velocity"][:, 0, -1], -motion.data["force"][:, 0, -1] / area], axis=1)
    return abs(got - exact).max(0) / abs(exact).max(0)


def test_a_rigid_mass_on_a_half_space_slows_down_as_its_waves_tell():
    coarse, fine = slab_errors(2, 0.5), slab_errors(2, 0.25)
    assert coarse[0] < 0.025
    assert (fine < 0.5 * coarse).all()
    np.testing.assert_allclose(slab_errors(3, 0.5), coarse, rtol=0.1)


def indented(spacing):
    """Force on a ball of radius 40 that is pressed half a unit of length deep into a half-space at rest."""
    lattice = fh.Lattice(spacing, (-10.0, -10.0, -8.0), (10.0, 10.0, 0.0))
    load = fh.Impactor(fh.Ball(40.0, (0.0, 0.0, 40.0)), path=[0.0, 0.0, "-0.5*min(t/60, 1)**2*(3 - 2*min(t/60, 1))"])
    motion, sides = fh.Impacts(), {"all": fh.LatticePML(nodes=12), "z+": fh.Free()}
    model = fh.Elastic(fh.Kernel(spacing, exponent=1), 1.0)
    fh.Simulation(lattice, model, sides, loads=[load], observe=[motion]).run(until=100.0)
    return -motion.data["force"][-1, 0, 2]


# Hertz: 4/3 E / (1 - nu^2) sqrt(R) depth^(3/2), with nu = 1/4
HERTZ = 4 / 3 / (1 - 1 / 16) * 40**0.5 * 0.5**1.5


def test_a_ball_is_pressed_into_an_unbounded_half_space():
    """The radius of contact is 4.5 spacings; the penalty makes the contact softer by a part of a spacing."""
    assert indented(1.0) == pytest.approx(HERTZ, rel=0.07)


@pytest.mark.slow
def test_a_ball_is_pressed_in_with_the_force_of_hertz():
    assert indented(0.5) == pytest.approx(HERTZ, rel=0.025)


def test_coulombs_law():
    """A block pressed onto a damped plate on a rigid foundation, then drawn along it: it sticks, then slides."""
    block = fh.Box((-2.25, 0.0), (2.25, 1.0))
    path = ["where(t < 200, 0, 1e-4*(t - 200))", "-0.01*min(t/100, 1)"]
    motion, rest = fh.Impacts(), fh.Prescribed(fh.Box((-6.0, -4.0), (6.0, -3.0)), [0.0, 0.0])
    load = fh.Impactor(block, path=path, friction=0.3)
    solid = fh.Elastic(KERNEL, 1.0, damping=0.3)
    sim = fh.Simulation(PLATE, solid, fh.Free(), constraints=[rest], loads=[load], observe=[motion])
    sim.run(until=500.0)
    force, t = motion.data["force"][:, 0], motion.times
    ratio = force[:, 0] / -force[:, 1].clip(max=-1e-6)
    assert abs(ratio[(t > 190) & (t < 199)]).max() < 0.01
    np.testing.assert_allclose(ratio[t > 450], 0.3, rtol=1e-3)
    slow = (t > 205) & (t < 212)  # all of it sticks: the block draws the surface along
    assert 0.01 < ratio[slow].mean() < 0.28
    assert ratio.max() < 0.3 * (1 + 1e-9)


def test_what_is_symmetric_stays_so():
    load = fh.Impactor(fh.Disc(2.0, (0.0, 2.2)), mass=5.0, velocity=(0.0, -0.1), friction=0.2)
    model = fh.Elastic(KERNEL, 1.0, critical_stretch=0.05)
    sim = fh.Simulation(PLATE, model, fh.Free(), loads=[load])
    sim.run(until=25.0)
    u = sim.fields["u"]
    np.testing.assert_allclose(u[1], u[1][::-1], rtol=0, atol=1e-12 * abs(u).max())
    np.testing.assert_allclose(u[0], -u[0][::-1], rtol=0, atol=1e-12 * abs(u).max())


@pytest.mark.parametrize("shape", ["disc", "box", "polygon", "difference"])
@pytest.mark.parametrize("name", ["bonds", "varying density"])
def test_an_interpreter_finds_the_same(name, shape):
    told = [fh.Impacts(), fh.Impacts()]
    sims = [hit(SOLIDS[name], shape, [one], friction=0.2) for one in told]
    sims[1].engine.loop = Interpreter(sims[1].engine)
    for sim in sims:
        sim.step(30)
    for key, values in told[0].data.items():
        assert abs(values).max() > 0
        np.testing.assert_allclose(told[1].data[key], values, rtol=0, atol=1e-12 * abs(values).max())
    np.testing.assert_allclose(sims[1].fields["u"], sims[0].fields["u"], rtol=0, atol=1e-13)
    assert sims[0].energies()["work"] == pytest.approx(sims[1].energies()["work"], rel=1e-9)


def test_the_work_is_that_of_held_nodes_too():
    """Where nodes that are pushed are held, the balance stays exact."""
    grip = fh.Prescribed(fh.Box((-0.6, -0.6), (0.6, 0.1)), velocity=[0.01, None])
    load = fh.Impactor(SHAPES["disc"], mass=5.0, velocity=(0.0, -0.1), friction=0.2)
    sim = fh.Simulation(PLATE, SOLID, fh.Free(), loads=[load], constraints=[grip], balance=True)
    sim.run(until=20.0)
    assert abs(sim.balance()["lost"]) < 1e-13 < 1e-4 < sim.energies()["work"]


@pytest.mark.parametrize("name", ["bonds", "bonds that break"])
def test_a_run_resumes_bit_for_bit(name, tmp_path):
    whole, first, second = fh.Impacts(), fh.Impacts(), fh.Impacts()
    uninterrupted = hit(SOLIDS[name], observe=[whole], friction=0.2)
    uninterrupted.step(70)
    sim = hit(SOLIDS[name], observe=[first], friction=0.2)
    sim.step(31)
    sim.save(tmp_path / "state")
    resumed = fh.Simulation.restore(tmp_path / "state", observe=[second])
    resumed.step(39)
    for key, values in whole.data.items():
        np.testing.assert_array_equal(second.data[key], values)
    np.testing.assert_array_equal(resumed.fields["u"], uninterrupted.fields["u"])
    assert resumed.energies() == uninterrupted.energies()
    with pytest.raises(fh.FileFormatError, match="impactors"):
        hit(SOLIDS[name], friction=0.3).load(tmp_path / "state")


def test_a_path_is_followed():
    motion = fh.Impacts()
    loads = [fh.Impactor(SHAPES["disc"], path=[0.0, "-0.1*t"]), fh.Impactor(fh.Disc(1.0, (5.0, 1.0)), path=[0, 0])]
    sim = fh.Simulation(PLATE, SOLID, fh.Free(), loads=loads, observe=[motion])
    sim.run(until=10.0)
    np.testing.assert_allclose(motion.data["displacement"][:, 0, 1], -0.1 * motion.times, atol=1e-14)
    np.testing.assert_allclose(motion.data["velocity"][:, 0, 1], -0.1, rtol=1e-12)
    at = np.stack(PLATE.coordinates()) + sim.fields["u"]
    depth = 2.0 - np.hypot(at[0] - 0.1, at[1] - HALF + 0.1 * sim.time).min()
    assert 0 < depth < 0.1  # of nodes in the disc
    np.testing.assert_allclose(motion.points, [(0.1, HALF), (5.0, 1.0)], rtol=1e-14)


def test_a_cylinder_in_three_dimensions_is_a_disc_in_each_plane():
    """A roller along z on a slab that is periodic along z: the same in all planes."""
    lattice = fh.Lattice(0.5, (-3.0, -2.0, 0.0), (3.0, 0.0, 2.0))
    sides = {"all": fh.Free(), "z": fh.Periodic()}
    load = fh.Impactor(fh.Disc(1.0, (0.1, 1.2)), mass=5.0, velocity=(0.0, -0.1, 0.0), friction=0.1)
    sim = fh.Simulation(lattice, fh.Elastic(fh.Kernel(1.0, 1), 1.0), sides, loads=[load])
    sim.run(until=10.0)
    u = sim.fields["u"]
    assert abs(u[1]).max() > 1e-3
    np.testing.assert_allclose(u, np.broadcast_to(u[..., :1], u.shape), atol=1e-13)


def test_a_ball_in_single_precision():
    lattice = fh.Lattice(0.5, (-3.0, -3.0, -2.0), (3.0, 3.0, 0.0))
    heights = {}
    for real in ("float32", "float64"):
        motion = fh.Impacts()
        load = fh.Impactor(fh.Ball(1.0, (0.1, 0.0, 1.1)), mass=5.0, velocity=(0.0, 0.0, -0.1))
        model = fh.Elastic(fh.Kernel(1.0, 1), 1.0)
        sim = fh.Simulation(lattice, model, fh.Free(), loads=[load], observe=[motion], dtype=real)
        sim.run(until=15.0)
        heights[real] = motion.data["displacement"][:, 0, 2]
    np.testing.assert_allclose(heights["float32"], heights["float64"], atol=1e-4)


def test_the_default_stiffness_is_that_of_a_layer_of_cells():
    """... unless the step demands less, which a note says."""
    sim = hit(dt=0.1, stiffness=None, mass=50.0)
    rate = sim.parts.impactors.grid.engine.tables.impactors.constants[0, 0]
    assert rate == pytest.approx(SOLID.p_modulus / 0.5 / 0.5)  # mass 0.25 of a node, of width 0.5
    assert not any("stiffness is" in note for note in sim.notes)
    assert any("stiffness is" in note for note in hit(stiffness=None).notes)


CASE = """
units = { length = "mm", time = "us", pressure = "GPa" }
lattice = { spacing = 0.5, lower = [-6.0, -4.0], upper = [6.0, 0.0] }
model = { type = "elastic", young = "70 GPa", density = "2700 kg/m^3", kernel = { horizon = 1.0 , exponent = 1} }
boundary = { all = { type = "free" } }
impacts = [{}]
run = { until = 4.0 }
[[load]]
type = "impactor"
shape = { disc = { radius = 2.0, centre = [0.0, 2.1] } }
mass = "0.03 kg/m"
velocity = [0.0, "-50 m/s"]
friction = 0.1
[[load]]
type = "impactor"
shape = { box = { lower = [-6.0, -5.0], upper = [6.0, -4.0] } }
path = [0.0, "0"]
"""


def test_a_case_file(tmp_path):
    (tmp_path / "drop.toml").write_text(CASE)
    sim = Case.read(tmp_path / "drop.toml").simulation()
    [motion] = sim.recorders
    assert motion.recorded.labels == ("impactor 0", "impactor 1")
    assert motion.data["velocity"].shape == (0, 2, 2)
    sim.run(until=1.0)
    np.testing.assert_allclose(motion.data["velocity"][0, 0], (0.0, -0.05))


@pytest.mark.parametrize(
    "options, message",
    [
        ({"path": [0.0, 0.0]}, "either a path or a mass"),
        ({"mass": None}, "either a path or a mass"),
        ({"mass": None, "path": [0.0, 0.0]}, "the path of an impactor determines its velocity"),
        ({"mass": 0.0}, "load.mass"),
        ({"friction": -0.1}, "load.friction"),
        ({"stiffness": 0.0}, "load.stiffness"),
        ({"stiffness": 1e3}, "too stiff for the time step"),
        ({"velocity": (0.0, -9.0)}, "so fast an impactor"),
        ({"velocity": (0.0, 0.0, -0.1)}, "one component per axis"),
        ({"mass": None, "velocity": None, "path": [0.0]}, "one component per axis"),
        ({"mass": None, "velocity": None, "path": ["x", 0.0]}, "load.path"),
        ({"mass": None, "velocity": None, "path": ["1/t", 0.0]}, "load"),
    ],
)
def test_what_is_refused(options, message):
    with pytest.raises(fh.InputError, match=message):
        hit(**options)


@pytest.mark.parametrize(
    "shape, message",
    [
        (fh.Disc(2.0, (0.0, 1.0)), "starts inside the body"),
        (fh.Text("a", 1.0, (0.0, 2.0)), "how deep a point lies"),
        (fh.Ball(1.0, (0.0, 0.0, 2.0)), "differ in dimension"),
    ],
)
def test_shapes_that_are_refused(shape, message):
    load, sides = fh.Impactor(shape, mass=1.0), {"all": fh.LatticePML(nodes=6), "y+": fh.Free()}
    with pytest.raises(fh.InputError, match=message):
        fh.Simulation(PLATE, SOLID, sides, loads=[load])


def test_a_shape_that_reaches_a_side_is_told():
    """An absorbing side, or a periodic one unless the shape covers the period."""
    for side, left, told in (
        (fh.LatticePML(nodes=6), -9.0, True),
        (fh.Periodic(), -9.0, False),
        (fh.Periodic(), 1.0, True),
    ):
        sides = {"all": fh.Free(), "x": side}
        load = fh.Impactor(fh.Box((left, 0.0), (9.0, 1.0)), path=[0.0, "-0.01*t"])
        sim = fh.Simulation(PLATE, fh.Elastic(fh.Kernel(1.0, 1), 1.0), sides, loads=[load])
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            sim.step(5)
        assert [caution.brief for caution in sim.cautions] == ["impactor at a side"] * told
        assert len(caught) == told


def test_media_that_are_refused():
    load = fh.Impactor(SHAPES["disc"], mass=1.0)
    with pytest.raises(fh.InputError, match="load"):
        fh.Simulation(PLATE, fh.Wave(fh.Kernel(1.0)), fh.Free(), loads=[load])
    model = fh.Elastic(KERNEL, 1.0, integrator="modified-equation")
    with pytest.raises(fh.InputError, match="one stage"):
        fh.Simulation(PLATE, model, fh.Fixed(), loads=[load])
    with pytest.raises(fh.InputError, match="no impactor"):
        fh.Simulation(PLATE, SOLID, fh.Free(), observe=[fh.Impacts()])


def test_what_one_process_computes():
    setup = hit().setup
    with pytest.raises(fh.InputError, match=r"impactors.*not computed on several processes yet"):
        check_divisible(setup, ())
    misfit = fh.LeastSquares(fh.Receivers([(0.0, -1.0)]), np.zeros((3, 1, 2)))
    with pytest.raises(fh.InputError, match="contact with an impactor is not linear"):
        fh.gradient(setup, misfit, wrt="density", until=1.0)


def test_impactors_in_layers_that_are_chosen():
    """A layer with a target is chosen by trials with the impactor, and the plate is followed as by a larger one."""
    load = fh.Impactor(fh.Disc(2.0, (0.0, 2.1)), mass=5.0, velocity=(0.0, -0.1))
    lattice = fh.Lattice(0.5, (-6.0, -4.0), (6.0, 0.0))
    motions = [fh.Impacts(), fh.Impacts()]
    sides = {"all": fh.LatticePML(target=1e-3), "y+": fh.Free()}
    model = fh.Elastic(fh.Kernel(1.0, 1), 1.0)
    fh.Simulation(lattice, model, sides, loads=[load], observe=motions[:1]).run(until=20.0)
    larger = fh.Lattice(0.5, (-20.0, -20.0), (20.0, 0.0))
    fh.Simulation(larger, model, fh.Free(), loads=[load], observe=motions[1:]).run(until=20.0)
    ours, exact = (motion.data["displacement"][:, 0, 1] for motion in motions)
    assert motions[0].times[-1] == motions[1].times[-1]
    np.testing.assert_allclose(ours, exact, rtol=0, atol=1e-3 * abs(exact).max())

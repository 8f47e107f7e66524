"""Faces of closed cracks that slide: an inclined crack and an S pulse against exact solutions, energies with friction,
wing cracks, checkpoints, case files, and what is refused.
"""

import math

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.simulation.processes.subdomain import check_divisible
from helpers import lattice_of

SEED = 20261130


# --- statics ---------------------------------------------------------------------------------------------------


def pressed(half, crack, friction, material="bond-based", plane="stress", reach=3.0, steps=4, strain=1e-3):
    """A plate between platens, compressed along y in load steps, and its compressive stress."""
    moduli = (1.0,) if material == "bond-based" else (1.0, 0.2)
    kernel, inner = fh.Kernel(reach, 1), half - reach + 0.5
    model = fh.Elastic(kernel, *moduli, material=material, plane=plane, contact=True, friction=friction)
    platens = [fh.Box((-999.0, inner), (999.0, 999.0)), fh.Box((-999.0, -999.0), (999.0, -inner))]
    rate = strain * half / steps
    held = [fh.Prescribed(box, velocity=[None, way * rate]) for box, way in zip(platens, (-1, 1), strict=True)]
    lattice, reaction = fh.Lattice(1.0, (-half, -half), (half, half)), fh.Reaction(platens[0])
    steps_of_load = fh.LoadSteps(1.0, tolerance=1e-5)
    given = {"constraints": held, "cracks": [crack], "observe": [reaction], "dt": steps_of_load}
    run = fh.Simulation(lattice, model, fh.Free(), **given).run(until=float(steps), progress=False)
    return run, abs(run.recorders[0].data["force"][-1, 0, 1]) / (2 * half + 1)


def jump_in_the_middle(run, along, apart):
    """Jump of the displacement along and across a crack through the origin, extrapolated to its faces."""
    across = np.array([-along[1], along[0]])
    jumps = []
    for distance in (apart, 2 * apart):
        ends = np.stack([distance * across, -distance * across])
        u = np.array([interpolated(run, end) for end in ends])
        jumps.append(u[0] - u[1])
    jump = 2 * jumps[0] - jumps[1]
    return jump @ along, jump @ across


def interpolated(run, at):
    """Displacement at a point, linear between nodes."""
    place = (at - run.lattice.lower) / run.lattice.spacing
    first = np.floor(place).astype(int)
    (a, b), (i, j) = place - first, first
    u = run.fields["u"]
    low, high = (u[:, i + k, j] * (1 - b) + u[:, i + k, j + 1] * b for k in (0, 1))
    return low * (1 - a) + high * a


@pytest.mark.sampled(2)
@pytest.mark.parametrize("friction", [0.0, 0.4, 1.2])
@pytest.mark.parametrize(
    ("material", "plane", "ratio"), [("bond-based", "stress", 1 / 3), ("state-based", "strain", 0.2)]
)
def test_an_inclined_crack_slides_as_in_an_endless_plate(material, plane, ratio, friction):
    """The faces of a closed crack of half length a slip by ``4/E' (tau - mu p) sqrt(a^2 - x^2)``, E' being E in plane
    stress and E / (1 - nu^2) in plane strain (mode II, Tada, Paris and Irwin 2000, 5.1), and not at all at 45 degrees
    if mu is above 1, whatever the stress. Faces that stick yield as a layer of half a horizon would, whose shear adds
    ``(1 + nu) horizon tau / E`` to the jump; the plate is five times as wide as the crack.
    """
    a, horizon, angle = 10.0, 3.0, math.radians(45.0)
    along = np.array([math.cos(angle), math.sin(angle)])
    run, stress = pressed(50.0, [(-a * along).tolist(), (a * along).tolist()], friction, material, plane)
    tau, pressure = stress * math.sin(angle) * math.cos(angle), stress * math.cos(angle) ** 2
    stiffer = 1.0 if plane == "stress" else 1 / (1 - ratio**2)
    exact = 4 / stiffer * max(tau - friction * pressure, 0.0) * a
    slip, gap = jump_in_the_middle(run, along, horizon)
    layer = (1 + ratio) * horizon * tau
    print(material, friction, -slip / exact if exact else slip, abs(-slip - exact) / layer, gap / layer)
    assert abs(-slip - exact) < layer
    assert abs(gap) < layer / 2


# --- pulses ----------------------------------------------------------------------------------------------------


@pytest.mark.sampled(4)
@pytest.mark.parametrize("friction", [0.0, 0.05, 0.2, 1.0])
@pytest.mark.parametrize("name", ["bond-based", "state-based"])
def test_a_crack_under_pressure_transmits_a_shear_pulse_up_to_coulombs_limit(name, friction):
    """At normal incidence the faces slip while the stress of the pulse exceeds ``mu p``, which is then what is
    transmitted (Miller 1977, Bulletin of the Seismological Society of America 67, 1597): the pulse is cut off there.
    Faces that stick yield as a layer of half a horizon, so that it may come later by as much.
    """
    moduli, spacing = ((1.0,) if name == "bond-based" else (1.0, 0.3)), 0.25
    model = fh.Elastic(fh.Kernel(2 * spacing, 1), *moduli, material=name, contact=True, friction=friction)
    lattice = fh.Lattice(spacing, (-40.0, -1.0), (40.0, 0.75))
    x, strain = lattice.coordinates()[0], 1e-4
    bell = np.exp(-(((x + 7) / 2) ** 2))
    shear = strain * np.sqrt(np.pi) * (np.vectorize(math.erf)((x + 7) / 2) - 1)
    start = {"u": [-strain * x, shear], "v": [0 * x, -model.s_speed * strain * bell]}
    sides, face = {"x": fh.Free(), "y": fh.Periodic()}, fh.Crack([(0.125, -99.0), (0.125, 99.0)])
    sim = fh.Simulation(lattice, model, sides, start, cracks=[face], dt=0.1 / model.p_speed, balance=True)
    sim.run(14.0 / model.s_speed, progress=False)
    found = -sim.fields["v"][1][x > 2.0] / model.s_speed  # strain of the waves that have passed
    limit = friction * model.p_modulus * strain / (model.shear)
    passed = np.minimum(strain * np.exp(-(((x - 7) / 2) ** 2)), limit)[x > 2.0]
    print(name, friction, np.abs(found - passed).max() / strain)
    steepest = strain * np.sqrt(2 / np.e) / 2  # slope of the bell, of width 2
    assert np.abs(found - passed).max() < spacing * steepest  # half of the horizon
    energies = sim.energies()
    assert (energies.get("friction", 0.0) > 1e-3 * energies["kinetic"]) == (0 < friction < 0.3)
    assert abs(sim.balance()["lost"]) < 1e-4 * energies["kinetic"]


# --- energies --------------------------------------------------------------------------------------------------


def shaken(dt, friction=0.3, name="bond-based", **options):
    """A block with two oblique cracks, one of which opens later, thrown against itself."""
    lattice = lattice_of((40, 37), 0.5)
    moduli = () if name == "bond-based" else (0.3,)
    model = fh.Elastic(fh.Kernel(1.0, 1), 1.0, *moduli, material=name, contact=True, friction=friction)
    v = [lambda x, y: -1e-3 * np.tanh((x - 10) / 3), lambda x, y: -2e-3 * np.tanh((y - 9) / 3) + 1e-3 * np.sin(x / 3)]
    cracks = [fh.Crack([(5.0, 6.1), (14.0, 11.3)]), fh.Crack([(6.0, 13.2), (13.0, 3.3)], opens=6.0)]
    start = {"v": lambda x, y: [part(x, y) for part in v]}
    return fh.Simulation(lattice, model, fh.Free(), start, cracks=cracks, dt=dt, balance=True, **options)


@pytest.mark.parametrize("name", ["bond-based", "state-based"])
def test_friction_dissipates_what_is_lost(name):
    """Nothing else does: kinetic, strain and lost energy sum to a constant, to the square of the time step."""
    losses = []
    for dt in (0.1, 0.05, 0.025):
        sim = shaken(dt, name=name)
        sim.run(12.0, progress=False)
        energies, lost = sim.energies(), sim.balance()["lost"]
        losses.append(abs(lost) / energies["friction"])
        assert energies["friction"] > 0.01 * energies["kinetic"]
        print(name, dt, losses[-1], energies)
    assert losses[-1] < 1e-3 and losses[-1] < losses[0] / 8  # 16 for the square, with faces that open and close


def test_the_momentum_is_conserved():
    """Faces push each other with opposite forces, to the last bit, and slips are alike."""
    sim = shaken(0.05)
    before = sim.fields["v"].sum((1, 2))
    sim.run(12.0, progress=False)
    v = sim.fields["v"]
    assert np.abs(v.sum((1, 2)) - before).max() < 1e-12 * np.abs(v).sum()
    faces, d = sim.engine.tables.faces, 2
    reverse = np.lexsort((faces.nodes, faces.neighbours))
    assert faces.slips.any() and len(faces.slips) == len(faces.nodes)
    np.testing.assert_array_equal(faces.slips[reverse], -faces.slips)
    np.testing.assert_array_equal(faces.rubbed[reverse], faces.rubbed)
    assert faces.normals.shape == (len(faces.nodes), d)


@pytest.mark.parametrize("name", ["bond-based", "state-based", "correspondence"])
def test_noise_stays_small_below_the_step_limit(name):
    """Faces open, close and rub at random."""
    rng = np.random.default_rng(SEED)
    options = {"stabilisation": 0.3} if name == "correspondence" else {}
    moduli = () if name == "bond-based" else (0.3,)
    model = fh.Elastic(fh.Kernel(2.0, 1), 1.0, *moduli, material=name, contact=True, friction=0.5, **options)
    lattice = lattice_of((18, 17), 1.0)
    cracks = [[rng.uniform(1, 16, 2).tolist(), rng.uniform(1, 16, 2).tolist()] for _ in range(4)]
    start = {"u": 1e-3 * rng.standard_normal((2, 18, 17))}
    limit = fh.Simulation(lattice, model, fh.Free(), start, cracks=cracks).step_limit
    sim = fh.Simulation(lattice, model, fh.Free(), start, cracks=cracks, dt=0.97 * limit)
    for _ in range(10):
        sim.step(100)
        assert np.abs(sim.fields["v"]).max() < 1e-2 / sim.dt


# --- wing cracks -----------------------------------------------------------------------------------------------


def wings(angle, friction=0.0, nonlinear=False, until=60.0, **material):
    """A plate of rock, 60 by 100 mm, with an inclined crack of 20 mm between platens; in mm, us and GPa."""
    along = np.array([math.cos(math.radians(angle)), math.sin(math.radians(angle))])
    lattice = fh.Lattice(0.5, (-29.75, -49.75), (29.75, 49.75))
    strength = {"fracture_energy": 2e-5, "damping": 0.02, "density": 2.5, "plane": "stress"} | material
    model = fh.Elastic(fh.Kernel(1.5, 1), 30.0, contact=True, nonlinear=nonlinear, friction=friction, **strength)
    platens = [fh.Box((-99.0, 48.2), (99.0, 99.0)), fh.Box((-99.0, -99.0), (99.0, -48.2))]
    speeds = ["-0.001*min(t/50,1)", "0.001*min(t/50,1)"]
    held = [fh.Prescribed(box, velocity=[None, v]) for box, v in zip(platens, speeds, strict=True)]
    tips = [(-10 * along).tolist(), (10 * along).tolist()]
    sim = fh.Simulation(lattice, model, fh.Free(), constraints=held, cracks=[tips])
    cut = sim.fields["damage"].copy()
    sim.run(until, progress=False)
    return sim, sim.fields["damage"] - cut, 10 * along


ENERGY = {"material": "correspondence", "poisson": 0.25, "stabilisation": 0.4}


@pytest.mark.parametrize(("angle", "material"), [(30.0, {}), pytest.param(45.0, ENERGY, marks=pytest.mark.slow)])
def test_wing_cracks_begin_at_the_tips_at_seventy_degrees(angle, material):
    """The largest tension around the tip of a crack in mode II is at 70.5 degrees to it (Erdogan and Sih 1963); the
    cracks then turn along the compression, at 60 or 45 degrees, so that they begin a little below 70. Bonds that break
    by their own stretch have them begin nearer to the compression, at less than 50 degrees to a crack at 45.
    """
    sim, new, tip = wings(angle, **material)
    x, y = sim.lattice.coordinates()
    for side in (-1, 1):
        dx, dy = side * x - tip[0], side * y - tip[1]
        near = (np.hypot(dx, dy) > 0.75) & (np.hypot(dx, dy) < 2.25) & (new > 0.15)  # half to three halves of a horizon
        begins = math.degrees(math.atan2((dy * new)[near].sum(), (dx * new)[near].sum())) - angle
        print(side, begins, sim.broken_bonds)
        assert 60.0 < begins < 80.0
        far = (np.hypot(dx, dy) > 4.5) & (new > 0.25)  # the wings are three horizons long
        assert far.any()
    distant = (np.abs(x) > 25.0) | (np.abs(y) > 40.0)
    assert not new[distant].any()


def test_wing_cracks_need_faces_that_slide():
    """Those that stick, by more friction than the tangent of the angle or because bonds are not linear, break at the
    same load nothing.
    """
    for options in ({"friction": 1.0}, {"nonlinear": True}):
        assert wings(30.0, **options)[0].broken_bonds == 0


# --- checkpoints, words, what is refused -----------------------------------------------------------------------


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_run_that_is_saved_goes_on_bitwise(tmp_path, friction):
    """Saved while faces rub, and before another crack opens; with more threads, too."""
    whole, saved = shaken(0.1, friction), shaken(0.1, friction)
    saved.run(4.0, progress=False)
    saved.save(tmp_path / "rubs.ckpt")
    again = shaken(0.1, friction, threads=2)
    again.load(tmp_path / "rubs.ckpt")
    for sim in (whole, saved, again):
        sim.run(12.0, progress=False)
        assert sim.fields["u"].tobytes() == whole.fields["u"].tobytes()
        assert sim.energies() == whole.energies() and sim.balance() == whole.balance()
    with pytest.raises(fh.InputError, match="same friction"):
        shaken(0.1, friction + 0.1).load(tmp_path / "rubs.ckpt")


def test_faces_slide_where_they_are_said_to():
    """Of given cracks that are cut altogether; the notes tell of others."""
    lattice, crack = fh.Lattice(0.5, (-4.0, -4.0), (4.0, 4.0)), [(-1.0, -1.1), (1.0, 1.2)]

    def made(cracks, **options):
        return fh.Simulation(lattice, fh.Elastic(fh.Kernel(1.0, 1), 1.0, **options), fh.Free(), cracks=cracks)

    slides = made([crack], contact=True)
    assert len(slides.engine.tables.faces.nodes) == slides.engine.absent.count - made([]).engine.absent.count
    assert "faces of cracks slide with a friction of 0" in dict(slides.check().rows)["bonds"]
    assert not any("stick" in note for note in slides.notes)
    for sim in (made([crack]), made([fh.Crack(crack, 0.5)]), made([crack], nonlinear=True), made([], contact=True)):
        assert not len(sim.engine.tables.faces.nodes)
    assert any(note.startswith("cracks stick where they close") for note in made([crack], nonlinear=True).notes)
    notes = made([crack], contact=True, critical_stretch=0.01).notes
    assert any(note.startswith("faces of new cracks stick") for note in notes)
    assert any("uniaxial compression of 0.03 or more" in note for note in notes)  # Poisson's ratio is 1/3 in the plane


def test_a_case_has_friction():
    """By the same word as in Python."""
    text = """
        lattice = { spacing = 0.5, lower = [-5.0, -5.0], upper = [5.0, 5.0] }
        model = { type = "elastic", contact = true, friction = 0.4, young = 1.0, kernel = { horizon = 1.0 } }
        boundary = { all = { type = "free" } }
        initial = { v = ["0", "where(y > 0.1, -0.01, 0.01)"] }
        crack = [{ points = [[-9.0, 0.1], [9.0, 1.1]] }]
        run = { until = 2.0 }
    """
    sim = Case(text).run()
    sim.run(2.0, progress=False)
    assert sim.engine.tables.faces.constants[0] == 0.4 and sim.energies()["friction"] > 0


def test_what_is_refused():
    """Friction without faces that slide, and what is no coefficient; several processes do not know slips."""
    for options, match in (
        ({"friction": 0.2}, r"model\.friction.*contact=True"),
        ({"friction": 0.2, "contact": False}, r"model\.friction.*contact=True"),
        ({"friction": 0.2, "nonlinear": True}, r"model\.friction.*nonlinear=False"),
        ({"friction": -0.1, "contact": True}, r"model\.friction.*-0\.1"),
        ({"friction": math.nan, "contact": True}, r"model\.friction"),
    ):
        with pytest.raises(fh.InputError, match=match):
            fh.Elastic(fh.Kernel(1.0, 1), 1.0, **options)
    assert fh.Correspondence(fh.Kernel(2.0), 1.0, 0.3, contact=True, friction=0.2).friction == 0.2
    with pytest.raises(fh.InputError, match=r"friction are not computed on several processes.*one process"):
        check_divisible(shaken(0.1).setup, ())
    check_divisible(shaken(0.1, 0.0).setup, ())

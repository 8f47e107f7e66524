"""Reactions, against the work of the constraints, exact stresses, and the balance of forces of bodies at rest."""

import numpy as np
import pytest
from tests.interpreter import Interpreter

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.pictures.histories import history_pictures

PLATE = fh.Lattice(1.0, (-9.0, -9.0), (9.0, 9.0))
KERNEL = fh.Kernel(2.0, 1)
BREAKING = {"critical_stretch": 0.02, "nonlinear": True}
SOLIDS = {
    "bonds": fh.Elastic(KERNEL, 1.0),
    "bonds that break": fh.Elastic(KERNEL, 1.0, **BREAKING),
    "states": fh.Elastic(fh.Kernel(2.0), 1.0, poisson=0.2, material="state-based"),
    "damped": fh.Elastic(KERNEL, 1.0, damping=0.2),
}


def pulled(model, observe, until=None, **options):
    """A plate between a support and a grip that moves along y."""
    rest = fh.Prescribed(fh.Box((-9.0, -9.0), (9.0, -8.0)), [0.0, 0.0])
    grip = fh.Prescribed(fh.Box((-9.0, 8.0), (9.0, 9.0)), velocity=[None, "0.02*t/(1 + t)"], until=until)
    cracks = [[(-12.0, 0.5), (-3.0, 0.5)]]
    constraints = [rest, grip]
    return fh.Simulation(PLATE, model, fh.Free(), constraints=constraints, cracks=cracks, observe=observe, **options)


@pytest.mark.parametrize("name", SOLIDS)
def test_the_force_is_the_derivative_of_the_work(name):
    reaction, work = fh.Reaction(), []
    sim = pulled(SOLIDS[name], [reaction], balance=True)
    for _ in range(240):
        work.append(sim.energies()["work"])
        sim.step(1)
    force, way = reaction.data["force"][:, 1, 1], reaction.data["displacement"][:, 1, 1]
    assert len(force) == 240 and (reaction.data["force"][:, 1, 0] == 0).all()
    gains = force[1:-1] * (way[2:] - way[:-2]) / 2
    np.testing.assert_allclose(np.diff(work)[1:], gains, rtol=0, atol=1e-12 * max(map(abs, work)))
    assert (sim.energies().get("broken", 0.0) > 0) == ("break" in name)


def test_scalar_waves_in_a_varying_medium():
    """A string of two speeds, shaken at both ends; the work as above, of each end by the balance of the energies."""
    first, both = fh.Reaction(fh.Box((-9.5,), (-8.5,)), name="first"), fh.Reaction()
    model, shaken = fh.Wave(fh.Kernel(1.5), "where(x < 0, 2, 1)"), fh.Prescribed([-9.0, 9.0], "sin(t)")
    line = fh.Lattice(1.0, -9, 9)
    sim = fh.Simulation(line, model, fh.Free(), constraints=[shaken], observe=[first, both])
    energies = []
    for _ in range(50):
        energies.append(sim.energy())
        sim.step(1)
    force, way = (both.data[name][:, 0] for name in ("force", "displacement"))
    np.testing.assert_allclose(np.diff(energies)[1:], force[1:-1] * (way[2:] - way[:-2]) / 2, rtol=0, atol=1e-11)
    assert 0 < abs(first.data["force"][1:] - force[1:, None]).max()


@pytest.mark.parametrize("direction", [0, 1])
def test_a_uniform_strain_is_held_by_its_stress(direction):
    """All rows of a strip that is periodic along x are held in a uniform strain: across a plane with all its bonds act
    the stresses of the continuum, which the calibrated bonds have exactly.
    """
    strain, lattice = 1e-3, fh.Lattice(0.5, (0.0, -4.0), (5.5, 4.0))  # 12 columns: a width of 6 with the period
    rows = [
        fh.Prescribed(fh.Box((-1.0, y - 0.1), (9.0, y + 0.1)), [strain * y * (direction == a) for a in range(2)])
        for y in np.arange(-4.0, 4.25, 0.5)
    ]
    upper = fh.Reaction(fh.Box((-1.0, 0.25), (9.0, 9.0)))
    model = fh.Elastic(fh.Kernel(1.5, 1), 1.0)
    sides = {"x": fh.Periodic(), "y": fh.Free()}
    fh.Simulation(lattice, model, sides, constraints=rows, observe=[upper]).step(2)
    (lame, shear), wanted = model.moduli, np.zeros(2)
    wanted[direction] = 6.0 * strain * [shear, lame + 2 * shear][direction]
    free_before, held = upper.data["force"][:, 0]
    np.testing.assert_allclose(held, wanted, rtol=1e-11, atol=1e-14)
    np.testing.assert_allclose(free_before, wanted / 2, rtol=1e-11, atol=1e-14)
    np.testing.assert_allclose(upper.data["displacement"][0, 0, direction], strain * 2.25, rtol=1e-12)


def test_forces_of_a_body_at_rest_are_in_equilibrium():
    body_force, reaction = fh.BodyForce([1e-3, 2e-3]), fh.Reaction()
    feet = [fh.Prescribed(fh.Box((x, -9.0), (x + 8.0, -8.0)), [0.0, 0.0]) for x in (-9.0, 1.0)]
    model = fh.Elastic(KERNEL, 1.0, damping=0.05)
    sim = fh.Simulation(PLATE, model, fh.Free(), constraints=feet, loads=[body_force], observe=[reaction])
    sim.run(until=1500.0, progress=False)
    total = reaction.data["force"][-1].sum(0)
    np.testing.assert_allclose(total, -np.array([1e-3, 2e-3]) * 19**2, rtol=1e-6)  # 361 nodes of volume 1


def test_an_interpreter_finds_the_same_forces():
    told = [fh.Reaction(), fh.Reaction()]
    sims = [pulled(SOLIDS["damped"], [one]) for one in told]
    sims[1].engine.loop = Interpreter(sims[1].engine)
    for sim in sims:
        sim.step(8)
    np.testing.assert_allclose(told[0].data["force"], told[1].data["force"], rtol=0, atol=1e-13)


def test_released_nodes_have_no_force():
    reaction = fh.Reaction()
    sim = pulled(SOLIDS["bonds"], [reaction], until=20.0)
    sim.run(until=30.0, progress=False)
    after = reaction.times > 20.0 - sim.dt
    assert (reaction.data["force"][after, 1] == 0).all() and after.sum() > 5
    assert (reaction.data["force"][~after, 1, 1] != 0).sum() > 20


def test_records_resume_and_may_be_fewer(tmp_path):
    whole, first, second, fewer = fh.Reaction(), fh.Reaction(), fh.Reaction(), fh.Reaction(every=7, name="few")
    pulled(SOLIDS["bonds that break"], [whole, fewer]).step(60)
    sim = pulled(SOLIDS["bonds that break"], [first])
    sim.step(33)
    sim.save(tmp_path / "state")
    sim = pulled(SOLIDS["bonds that break"], [second])
    sim.load(tmp_path / "state")
    sim.step(27)
    for name, values in whole.data.items():
        np.testing.assert_array_equal(second.data[name], values)
        np.testing.assert_array_equal(fewer.data[name], values[::7])
    assert (second.times == whole.times).all()


CASE = """
lattice = { spacing = 0.5, lower = [-4.0, -4.0], upper = [4.0, 4.0] }
model = { type = "elastic", young = 1.0, kernel = { horizon = 1.0, exponent = 1 } }
boundary = { all = { type = "free" } }
constraint = [
  { type = "prescribed", region = { box = { lower = [-4.0, -4.0], upper = [4.0, -3.5] } }, value = [0.0, 0.0] },
  { type = "prescribed", region = { box = { lower = [-4.0, 3.5], upper = [4.0, 4.0] } }, velocity = [false, 1e-3] },
]
reaction = [{ region = { box = { lower = [-4.0, 3.5], upper = [4.0, 4.0] } }, every = 2, name = "grip" }]
run = { until = 4.0 }
"""


def test_case_file_with_table_and_pictures(tmp_path):
    case = Case(CASE)
    sim = case.run()
    [made] = sim.recorders
    assert made.name == "grip" and made.every == 2 and made.region is not None
    sim.run(until=4.0, progress=False)
    sim.write(tmp_path / "case.h5")
    results = fh.open_results(tmp_path / "case.h5")
    grip = results.recorded["grip"]
    grip.to_csv(tmp_path / "grip.csv", ["displacement", "force"])
    written = {path.name for path in history_pictures(results, tmp_path, "png", {})}
    table = np.loadtxt(tmp_path / "grip.csv", delimiter=",", skiprows=3)
    assert table.shape == (len(grip.times), 5)
    np.testing.assert_array_equal(table[:, 4], grip.data["force"][:, 0, 1])
    assert "grip_force_y_displacement_y.png" in written and "grip_force_x_displacement_x.png" not in written


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"constraints": []}, "no node of the run is prescribed"),
        ({"observe": [fh.Reaction(fh.Disc(2.0))]}, "no node in the region is prescribed"),
        ({"observe": [fh.Reaction(fh.Ball(2.0))]}, "shape and lattice differ in dimension"),
        ({"model": fh.Diffusion(KERNEL, 1.0), "boundary": fh.Fixed()}, "diffuses is not held by forces"),
    ],
)
def test_what_has_no_reaction_is_refused(options, words):
    model = options.get("model", SOLIDS["bonds"])
    value = 0.0 if "model" in options else [0.0, 0.0]
    rest = fh.Prescribed(fh.Box((-9.0, -9.0), (9.0, -8.0)), value)
    setup = {"boundary": fh.Free(), "constraints": [rest], "observe": [fh.Reaction()], **options, "model": model}
    with pytest.raises(fh.InputError, match=words):
        fh.Simulation(PLATE, **setup)
    with pytest.raises(fh.InputError, match=r"reaction\.every"):
        fh.Reaction(every=0)


def test_single_precision_is_noted():
    assert any("single precision" in note for note in pulled(SOLIDS["bonds"], [fh.Reaction()], dtype="float32").notes)
    assert not any("reaction" in note for note in pulled(SOLIDS["bonds"], [fh.Reaction()]).notes)

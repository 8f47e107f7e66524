"""Load steps: equilibrium, forces, energy and fracture of solids that are loaded slowly."""

import numpy as np
import pytest

import farhorizon as fh

KERNEL = fh.Kernel(2.0, exponent=1)


def strip(nodes, ends):
    """A region of all nodes whose first coordinate lies in a range."""
    return fh.Box((ends[0] - 0.5, -1.0), (ends[1] + 0.5, nodes))


def plate(model, constraints, shape=(12, 9), dt=None, **options):
    lattice = fh.Lattice(1.0, (0.0, 0.0), (shape[0] - 1.0, shape[1] - 1.0))
    dt = fh.LoadSteps(1.0, tolerance=1e-11) if dt is None else dt
    return fh.Simulation(lattice, model, fh.Free(), constraints=constraints, dt=dt, **options)


def pulled(shape=(12, 9), value=("1e-3*t", "2e-3*t")):
    """One end is at rest, and the other one moves."""
    rest = fh.Prescribed(strip(shape[1], (0, 0)), [0.0, 0.0])
    return [rest, fh.Prescribed(strip(shape[1], (shape[0] - 1, shape[0] - 1)), list(value))]


def directly(sim, u, held, force):
    """Displacements in equilibrium with forces per mass by Gauss elimination, given those of held nodes; the matrix
    consists of the accelerations after unit displacements in a run in time.
    """
    engine, grid = sim.engine, sim.parts.grid
    places, size = grid.indices.ravel(), u.size
    matrix, level = np.zeros((size, size)), np.zeros_like(engine.current)
    for i in range(size):
        level[places[i]] = 1.0
        matrix[:, i] = (engine.apply(level.copy()) * engine.mobility)[places]
        level[places[i]] = 0.0
    free = ~held.ravel()
    solution = u.ravel().copy()
    right = -force.ravel()[free] - matrix[np.ix_(free, ~free)] @ solution[~free]
    solution[free] = np.linalg.solve(matrix[np.ix_(free, free)], right)
    return solution.reshape(u.shape)


MODELS = {
    "bond-based": fh.Elastic(KERNEL, 1.0, density="where(x > 5, 30, 1)", damping=0.7),
    "state-based": fh.Elastic(KERNEL, 1.0, 0.2, material="state-based", plane="strain"),
    "correspondence": fh.Correspondence(KERNEL, 1.0, 0.3, plane="stress"),
}


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_equilibrium_is_that_of_the_direct_solution(model):
    sim = plate(model, pulled()).run(until=2.0)
    u, held = sim.fields["u"], np.zeros((2, 12, 9), bool)
    held[:, [0, -1]] = True
    np.testing.assert_array_equal(u[:, -1], np.outer([2e-3, 4e-3], np.ones(9)))
    exact = directly(plate(model, pulled(), dt=0.1), np.where(held, u, 0.0), held, np.zeros_like(u))
    assert abs(u - exact).max() < 1e-8 * abs(exact).max()


def test_forces_and_energy_under_a_load():
    """The reaction balances the load, whose virtual work is twice the strain energy."""
    reaction = fh.Reaction()
    rest = fh.Prescribed(strip(9, (0, 0)), [0.0, 0.0])
    loads = [fh.BodyForce(["1e-3*exp(-(x - 8)**2)", "2e-3*(x > 10)"], time="t**2")]
    sim = plate(
        MODELS["correspondence"], [rest], loads=loads, observe=[reaction], dt=fh.LoadSteps(0.5, 1e-11), balance=True
    )
    sim.run(until=1.5)
    x, _ = sim.lattice.coordinates()
    force = 1.5**2 * np.stack([1e-3 * np.exp(-((x - 8) ** 2)), 2e-3 * (x > 10)])
    assert reaction.times.tolist() == [0.5, 1.0, 1.5] and sim.time == 1.5
    balanced = np.multiply.outer([1 / 9, 4 / 9, 1], -force.sum((1, 2)))
    np.testing.assert_allclose(reaction.data["force"][:, 0], balanced, rtol=1e-8)
    energies = sim.energies()
    assert abs(2 * energies["strain"] - (force * sim.fields["u"]).sum()) < 1e-8 * energies["strain"]
    assert energies["kinetic"] < 1e-16 * energies["strain"] < energies["work"]


def table(sim, reaction):
    """Force on the moving nodes and their displacement, one row for each load step, from the state at rest on."""
    return (np.append(0.0, reaction.data[name][:, 0, 1]) for name in ("force", "displacement"))


def test_work_of_the_table_is_the_strain_energy():
    reaction = fh.Reaction(strip(9, (11, 11)))
    sim = plate(MODELS["state-based"], pulled(value=("0", "1e-3*t")), observe=[reaction], balance=True).run(until=4.0)
    force, way = table(sim, reaction)
    np.testing.assert_allclose(force, force[1] * np.arange(5), rtol=1e-8, atol=1e-12 * force[1])
    assert abs(np.trapezoid(force, way) / sim.energies()["strain"] - 1) < 1e-8


def notched(length, energy, interval, until):
    """Plate of 24 x 40 nodes with a crack from its edge, between grips that do not turn: the run and its reaction."""
    lattice = fh.Lattice(1.0, (0.5, -19.5), (23.5, 19.5))
    below, above = (fh.Box((0.0, low), (24.0, low + 2.0)) for low in (-20.0, 18.0))
    grips = [fh.Prescribed(below, [None, "-t"]), fh.Prescribed(above, [None, "t"])]
    model = fh.Elastic(fh.Kernel(3.0, 1), 1.0, plane="stress", fracture_energy=energy)
    reaction, cracks = fh.Reaction(above), [[(-4.0, 0.0), (length, 0.0)]]
    dt = fh.LoadSteps(interval, tolerance=1e-8)
    options = {"constraints": grips, "cracks": cracks, "observe": [reaction], "dt": dt, "balance": True}
    return fh.Simulation(lattice, model, fh.Free(), **options).run(until=until), reaction


def test_peak_load_and_energy_of_a_notched_plate():
    """The peak load is that of Griffith's criterion for the change of the compliance with the length of the crack
    (Irwin and Kies 1954). Fields are symmetric, and the work of the table is what bonds and damping have taken.
    """
    compliances = []
    for length in (5.0, 7.0):
        _, reaction = notched(length, 1.0, 1e-3, 1e-3)
        force, way = table(_, reaction)
        compliances.append(2 * way[1] / force[1])
    energy, ligament = 1e-6, 18
    peak = np.sqrt(energy / (0.5 * np.diff(compliances)[0] / 2))
    sim, reaction = notched(6.0, energy, 1e-4, 6e-3)
    force, way = table(sim, reaction)
    assert 0.97 < force.max() / peak < 1.06
    assert force[-1] < 0.05 * force.max()
    u = sim.fields["u"]
    assert abs(u - u[:, :, ::-1] * np.array([1, -1])[:, None, None]).max() < 1e-12 * abs(u).max()
    balance = sim.balance()
    assert abs(balance["broken"] / (energy * ligament) - 1) < 0.08
    taken = balance["broken"] + balance["lost"] + balance["strain"]
    # the plate breaks within a step, whose work the table knows up to half of the fall of the force times the way
    unknown = 0.5 * abs(np.diff(force)).max() * 2e-4
    assert balance["lost"] > 0 and abs(np.trapezoid(force, 2 * way) - taken) < unknown + 0.01 * taken


def arms(length, crack, height=24):
    """Displacement per force of a beam of a height that is held at its far end, cut in the middle up to a crack length:
    of its upper arm, whose end is lifted while that of the lower one is lowered; without a crack, of the whole beam.
    """
    half = height / 2
    lattice = fh.Lattice(1.0, (0.5, 0.5 - half), (length - 0.5, half - 0.5))
    rest = fh.Prescribed(fh.Box((length - 2.0, -half), (length + 1.0, half)), [0.0, 0.0])
    ends = [fh.Box((0.0, low), (1.0, low + half)) for low in (0.0, -half)]
    lifted = [fh.Prescribed(end, [None, value]) for end, value in zip(ends, ("t", "-t" if crack else "t"), strict=True)]
    reaction = fh.Reaction(ends[0] if crack else None)
    cracks = [[(-9.0, 0.0), (crack, 0.0)]] if crack else []
    model = fh.Elastic(KERNEL, 1.0, plane="stress")
    options = {"constraints": [rest, *lifted], "cracks": cracks, "observe": [reaction]}
    fh.Simulation(lattice, model, fh.Free(), dt=fh.LoadSteps(1.0, tolerance=1e-5), **options).run(until=1.0)
    return 1 / reaction.data["force"][-1, 0 if crack else 1 :, 1].sum()


def test_double_cantilever_beam():
    """Stiffness and energy release rate of a double cantilever beam are those of beam theory (arms that turn at the
    tip, as if they were longer by 0.67 of their height), once the arms have the stiffness against bending that a single
    beam of nodes has: it is softer than EI, because its faces lack bonds.
    """
    height, length, crack = 12, 80, 50.0
    inertia = height**3 / 12
    # the difference of two lengths is free of the shear and of what the grips add
    clamped = np.diff([arms(n, 0.0, height) / (n - 2.5) for n in (40, 60)])[0] / np.diff([37.5**2, 57.5**2])[0]
    stiff = 1 / (3 * clamped)
    assert 0.8 < stiff / inertia < 1.0
    compliances = [2 * arms(length, crack + more, 2 * height) for more in (-2.0, 2.0)]
    effective = crack - 0.5 + 0.67 * height
    assert abs(np.mean(compliances) / (2 * effective**3 / (3 * stiff)) - 1) < 0.05
    released = 0.5 * np.diff(compliances)[0] / 4.0
    assert abs(released / (effective**2 / stiff) - 1) < 0.05


def test_steps_continue_from_a_checkpoint(tmp_path):
    def run():
        model = fh.Elastic(KERNEL, 1.0, critical_stretch=7e-4)
        moving = pulled(value=("1e-3*t", "0"))
        moving += [fh.Prescribed([(5.0, 4.0)], [None, "1e-3*t"], until=2.0)]
        cracks = [fh.Crack([(3.5, -2.0), (3.5, 2.0)], opens=3.0)]
        reaction = fh.Reaction()
        dt = fh.LoadSteps(1.0, tolerance=1e-8)
        return plate(model, moving, observe=[reaction], cracks=cracks, dt=dt), reaction

    whole, reaction = run()
    whole.run(until=6.0)
    first, _ = run()
    first.run(until=2.0).save(tmp_path / "a.ckpt")
    second, again = run()
    second.load(tmp_path / "a.ckpt")
    second.run(until=6.0)
    made = fh.Simulation.restore(tmp_path / "a.ckpt", observe=[fh.Reaction()])
    made.run(until=6.0)
    assert whole.broken_bonds > 0 and len(reaction.times) == 6
    for sim, read in ((second, again), (made, made.recorders[0])):
        np.testing.assert_array_equal(sim.fields["u"], whole.fields["u"])
        np.testing.assert_array_equal(read.data["force"], reaction.data["force"])
    force = reaction.data["force"]
    assert force[1, 2, 1] and not force[2:, 2].any()  # released
    assert force[3, 1, 0] / 4 < 0.99 * force[1, 1, 0] / 2  # open


def test_a_velocity_moves_as_far_as_a_value():
    runs = []
    for motion in ({"value": [None, "1e-3*t**2"]}, {"velocity": [None, "2e-3*t"]}):
        rest = fh.Prescribed(strip(9, (0, 0)), [0.0, 0.0])
        runs.append(plate(MODELS["bond-based"], [rest, fh.Prescribed(strip(9, (11, 11)), **motion)]).run(until=2.0))
    first, second = (sim.fields["u"] for sim in runs)
    assert abs(first - second).max() < 1e-9 * abs(first).max()


def test_a_step_without_equilibrium_is_told():
    rest = fh.Prescribed(strip(9, (0, 0)), [0.0, 0.0])
    sim = plate(MODELS["bond-based"], [rest], loads=[fh.BodyForce(["1e-3", "0"])], dt=fh.LoadSteps(1.0, limit=64))
    with pytest.warns(fh.ValidityWarning, match="not in equilibrium: after 64 iterations"):
        sim.run(until=1.0)


def test_a_run_without_loads_stays():
    sim = plate(MODELS["bond-based"], pulled(value=("0", "0"))).run(until=2.0)
    assert sim.time == 2.0 and not sim.fields["u"].any()


REFUSED = {
    "layers": ({"boundary": fh.LatticePML(nodes=6)}, "boundary.x-"),
    "springs": ({"boundary": fh.Impedance(stiffness=1.0)}, "boundary.x-"),
    "laws of time": ({"model": fh.Elastic(KERNEL, 1.0, law=fh.ViscoelasticBond(0.4, 2.0))}, "model.law"),
    "attenuation": (
        {"model": fh.Elastic(KERNEL, 1.0, attenuation=fh.Attenuation(50.0, (0.01, 0.1)))},
        "model.attenuation",
    ),
    "waves": ({"model": fh.Wave(KERNEL)}, "model"),
    "single precision": ({"dtype": "float32"}, "dtype"),
    "velocities": ({"initial": {"v": [1.0, 0.0]}}, "initial.v"),
    "another integrator": ({"model": fh.Elastic(KERNEL, 1.0, integrator="modified-equation")}, "model.integrator"),
    "loads of space and time": ({"loads": [fh.BodyForce(["sin(x*t)", "0"])]}, "load"),
    "heat": ({"loads": [fh.ThermalLoad("x", expansion=1e-3, reference=0.0)]}, "load"),
}


@pytest.mark.parametrize(("changes", "key"), REFUSED.values(), ids=REFUSED)
def test_refused(changes, key):
    given = {"lattice": fh.Lattice(1.0, (0.0, 0.0), (15.0, 15.0)), "model": MODELS["bond-based"], "boundary": fh.Free()}
    with pytest.raises(fh.InputError, match=f"{key}: load steps"):
        fh.Simulation(**{**given, "dt": fh.LoadSteps(1.0), **changes})


def test_load_steps_do_not_end_at_a_static_state():
    with pytest.raises(fh.InputError, match="each load step is static"):
        plate(MODELS["bond-based"], pulled()).run(until="static")


CASE = """
lattice = { spacing = 1.0, lower = [0.0, 0.0], upper = [11.0, 8.0] }
model = { type = "elastic", young = 1.0, kernel = { horizon = 2.0, exponent = 1 } }
boundary = { all = { type = "free" } }
run = { until = 4.0, load_steps = 4 }
output = { every = 2.0 }
[[constraint]]
type = "prescribed"
region = { box = { lower = [-0.5, -1.0], upper = [0.5, 9.0] } }
value = [0.0, 0.0]
[[constraint]]
type = "prescribed"
region = { box = { lower = [10.5, -1.0], upper = [11.5, 9.0] } }
value = ["1e-3*t", "2e-3*t"]
[[reaction]]
"""


def test_load_steps_of_a_case(tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(CASE)
    sim = fh.read_case(path).completed()
    made = plate(fh.Elastic(KERNEL, 1.0), pulled(), dt=fh.LoadSteps(1.0)).run(until=4.0)
    np.testing.assert_array_equal(sim.fields["u"], made.fields["u"])
    assert len(sim.recorders[0].times) == 4


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"run.load_steps": 0}, "run.load_steps: a run has at least one load step"),
        ({"run.dt": 0.1}, "run.dt: load steps divide the time"),
        ({"run.limit": 9.0}, "run.limit: load steps divide the time"),
        ({"run.tolerance": 2.0}, "run.tolerance"),
        ({"output.every": 1.5}, "not a whole number of time steps"),
    ],
)
def test_load_steps_of_a_case_are_checked(tmp_path, changes, message):
    path = tmp_path / "case.toml"
    path.write_text(CASE)
    with pytest.raises(fh.InputError, match=message):
        fh.read_case(path, changes).simulation()

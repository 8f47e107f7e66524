"""Bodies whose surfaces are corrected by the energy of their nodes, against the given moduli and exact symmetries."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.simulation.setup import surface_effect

MATERIALS = {
    "bonds": {},
    "states": {"material": "state-based", "poisson": 0.2},
    "nearly incompressible": {"material": "state-based", "poisson": 0.4},
}


def corrected(*given, **options):
    return fh.Elastic(*given, surface="energy", **options)


@pytest.mark.parametrize("nodes", [3, 4, 5, 8])
@pytest.mark.parametrize("horizon", [2.0, 3.0])
@pytest.mark.parametrize("material", MATERIALS)
def test_strips_are_as_stiff_as_their_material_in_tension(material, horizon, nodes, monkeypatch):
    """Young's modulus of a strip between free surfaces, from forces through its middle; they would be 5 to 24 % too
    soft.
    """
    monkeypatch.setattr(surface_effect, "Elastic", corrected)
    options = MATERIALS[material]
    given = options.get("material", "bond-based"), "strain", options.get("poisson", 0.25), nodes
    found = surface_effect.apparent_modulus.__wrapped__(fh.Kernel(horizon, 1), 1.0, 2, *given)
    assert abs(found - 1) < 0.02


def test_plates_are_as_stiff_as_their_material(monkeypatch):
    monkeypatch.setattr(surface_effect, "Elastic", corrected)
    for nodes in (3, 5):
        found = surface_effect.apparent_modulus.__wrapped__(fh.Kernel(2.0, 1), 1.0, 3, "bond-based", None, 0.25, nodes)
        assert abs(found - 1) < 0.02


def strained(options, nodes, strain, dim=2):
    """Energy per node and shear modulus of a periodic strip, or plate, `nodes` thick, under a uniform strain."""
    shape = (*(9.0,) * (dim - 1), 12.0)
    body = fh.Box([*[-99.0] * (dim - 1), 1.5], [*[99.0] * (dim - 1), nodes + 1.5])
    lattice = fh.Lattice(1.0, [0.0] * dim, shape, body=body)
    model = fh.Elastic(fh.Kernel(2.0, 1), 1.0, surface="energy", **options)
    sim = fh.Simulation(lattice, model, fh.Free(), threads=1)
    engine, indices = sim.parts.grid.engine, sim.parts.grid.indices
    level = np.zeros(engine.levels.shape[1])
    field = np.einsum("ab,b...->a...", strain, np.stack(np.broadcast_arrays(*lattice.coordinates())))
    level[indices] = (field * lattice.existing).reshape(indices.shape)
    forces = engine.apply_core(level)[indices].reshape(dim, *lattice.shape) * lattice.existing
    return forces, field, model


@pytest.mark.parametrize("nodes", [3, 5])
@pytest.mark.parametrize("material", MATERIALS)
def test_the_shear_modulus_is_that_of_the_material(material, nodes):
    """The force through a cross-section under a uniform shear, over the thickness and the strain."""
    forces, _, model = strained(MATERIALS[material], nodes, np.array([[0.0, 0.5], [0.5, 0.0]]))
    through = -forces[1, 5:].sum()  # along y, through the plane between the fifth and the sixth column
    assert through / nodes == pytest.approx(model.shear, rel=1e-3)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("material", MATERIALS)
def test_rigid_motions_are_free(material, dim):
    """Translations and rotations exert no force, on any node; the force and the torque of a strain add up to zero."""
    turn = np.zeros((dim, dim))
    turn[0, -1], turn[-1, 0] = 1.0, -1.0
    forces, _, _ = strained(MATERIALS[material], 4, turn, dim)
    assert np.abs(forces).max() < 1e-11
    stretch = np.random.default_rng(3).standard_normal((dim, dim))
    forces, field, _ = strained(MATERIALS[material], 4, stretch + stretch.T, dim)
    assert np.abs(forces.reshape(dim, -1).sum(1)).max() < 1e-13 * np.abs(forces).sum()  # rounding
    forces, field, _ = strained(MATERIALS[material], 4, np.eye(dim), dim)  # the field is that of the positions
    torque = forces.reshape(dim, -1) @ field.reshape(dim, -1).T
    assert np.abs(torque - torque.T).max() < 1e-10
    assert np.abs(forces).max() > 1e-3


def plate(**options):
    body = fh.Box((-1.0, -1.0), (30.0, 30.0)) - fh.Disc(3.3, (9.0, 6.2))
    lattice = fh.Lattice(1.0, (0.0, 0.0), (20.0, 12.0), body=body)
    model = fh.Elastic(fh.Kernel(3.0, 1), 1.0, surface="energy", **options)
    start = {"v": ["0.01*sin(x + 2*y)", "0.01*cos(3*x*y)"]}
    return fh.Simulation(lattice, model, fh.Free(), start, threads=1)


@pytest.mark.parametrize("options", [{}, MATERIALS["states"]], ids=["bonds", "states"])
def test_bonds_that_may_break_have_the_same_forces(options):
    """They are swept one by one, where others are corrected after the sweep; and energy is conserved."""
    fields = []
    for strength in ({}, {"critical_stretch": 1.0}):
        sim = plate(**options, **strength)
        start = sim.energy()
        sim.step(300)
        assert sim.energy() == pytest.approx(start, rel=1e-12)
        fields.append(sim.fields["u"])
    np.testing.assert_allclose(*fields, rtol=0, atol=1e-10 * np.nanmax(np.abs(fields[0])))


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"contact": True},
        {"nonlinear": True},
        MATERIALS["states"],
        {"softening": "linear", "fracture_energy": 2e-4, "critical_stretch": 0.003},
    ],
)
def test_energies_add_up_as_bonds_break(options):
    """A notched specimen is pulled in two: work is what moves, is stored and has been lost with bonds."""
    body = fh.Box((-99.0, -6.5), (99.0, 6.5)) - fh.Disc(3.2, (0.0, 6.5))
    lattice = fh.Lattice(1.0, (-30.0, -8.0), (30.0, 8.0), body=body)
    model = fh.Elastic(fh.Kernel(2.0, 1), 1.0, surface="energy", **{"critical_stretch": 0.004, **options})
    pull = fh.BodyForce(["where(x > 25, 6e-4, where(x < -25, -6e-4, 0))", 0.0])
    sim = fh.Simulation(lattice, model, fh.Free(), loads=[pull], threads=1, balance=True)
    sim.run(until=120.0, progress=False)
    balance = sim.balance()
    assert np.nanmax(sim.fields["damage"]) > 0.8
    exact = not (options.get("contact") or options.get("nonlinear"))  # whose laws the scheme conserves to second order
    assert abs(balance["lost"]) < (1e-12 if exact else 2e-4) * balance["work"]
    u = sim.fields["u"][0][lattice.existing]
    assert np.abs(u + sim.fields["u"][0][::-1][lattice.existing]).max() < 1e-11


def test_whole_bodies_are_as_without_it():
    """Between sides that continue the medium nothing is stiffened."""
    fields = []
    for surface in (None, "energy"):
        model = fh.Elastic(fh.Kernel(2.0, 1), 1.0, surface=surface)
        lattice = fh.Lattice(1.0, (-9.0, -9.0), (9.0, 9.0))
        sides = {"x": fh.Periodic(), "y": fh.LatticePML(nodes=8)}
        sim = fh.Simulation(lattice, model, sides, {"u": ["exp(-x**2-y**2)", 0.0]}, threads=1, dt=0.4)
        sim.step(50)
        fields.append(sim.fields["u"])
    np.testing.assert_allclose(*fields, rtol=0, atol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, MATERIALS["states"], {"critical_stretch": 9.0}], ids=str)
def test_a_corrected_surface_runs_into_layers(options):
    """Against a box three times as wide; the error relative to the field is at most that of the uncorrected one."""
    errors = {}
    for surface in (None, "energy"):
        found = []
        for half in (15.0, 45.0):
            lattice = fh.Lattice(1.0, (-half, -half), (half, 0.0))
            model = fh.Elastic(fh.Kernel(2.0, 1), 1.0, surface=surface, **options)
            sides = {"all": fh.LatticePML(nodes=20), "y+": fh.Free()}
            start = {"u": [0.0, "exp(-(x**2 + (y + 3)**2)/9)"]}
            sim = fh.Simulation(lattice, model, sides, start, dt=0.35)
            sim.run(80.0, allow_unstable=True, progress=False)
            middle = int(half - 15)
            found.append(sim.fields["u"][:, middle : middle + 31, -16:])
        errors[surface] = np.abs(found[0] - found[1]).max() / np.abs(found[1]).max()
    print(errors)
    assert errors["energy"] < errors[None] < 1e-3


def test_it_is_a_key_of_case_files_and_thin_bodies_have_no_note():
    text = """
    lattice = { spacing = 1.0, lower = [-20.0, -3.0], upper = [20.0, 3.0] }
    model = { type = "elastic", young = 1.0, surface = "energy", kernel = { horizon = 2.0, exponent = 1 } }
    boundary = { all = { type = "free" } }
    run = { until = 1.0 }
    """
    sim = Case(text).simulation()
    assert sim.model.surface == "energy"
    assert not any("apparent over given" in note for note in sim.notes)
    plain = Case(text.replace('surface = "energy", ', "")).simulation()
    assert any("apparent over given" in note and 'surface = "energy"' in note for note in plain.notes)


def test_bad_input():
    kernel, free = fh.Kernel(2.0, 1), {"all": fh.LatticePML(nodes=8), "y+": fh.Free()}
    for options, words in (
        ({"material": "correspondence", "poisson": 0.3}, "not softer"),
        ({"surface": "volume"}, "unknown correction"),
    ):
        with pytest.raises(fh.InputError, match=words):
            fh.Elastic(kernel, 1.0, **{"surface": "energy", **options})
    model = fh.Elastic(kernel, 1.0, surface="energy")
    ground = fh.Lattice(1.0, (-20.0, -20.0), (20.0, 0.0))
    with pytest.raises(fh.InputError, match="thermal strain"):
        model.heated()
    wave = fh.IncidentWave((0.0, 1.0), "exp(-((t - 40)/8)**2)", 80.0)
    with pytest.raises(fh.InputError, match="incident"):
        fh.Simulation(ground, model, free, sources=[wave])
    with pytest.raises(fh.InputError, match=r"crack\.factor"):
        fh.Simulation(ground, model, free, cracks=[fh.Crack([(-3.0, -4.5), (3.0, -4.5)], factor=0.5)])
    with pytest.raises(fh.InputError, match="coefficient"):
        fh.Simulation(ground, model, free, coefficient=np.ones(ground.shape))
    notched = fh.Lattice(
        1.0, (-20.0, -20.0), (20.0, 0.0), body=fh.Box((-99, -99), (99, 99)) - fh.Disc(3.2, (17.0, 0.0))
    )
    with pytest.raises(fh.InputError, match="turns within two reaches of x"):
        fh.Simulation(notched, model, free)

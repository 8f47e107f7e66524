"""Tractions and body forces on `Elastic` media: plane waves, momentum, reciprocity, energies, cases, bad input."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.studies.compare import compare
from helpers import fitted_rate

LAWS = {"linear": {}, "breaking": {"critical_stretch": 0.1}, "nonlinear": {"nonlinear": True}}
HALF_SPACE = {"x-": fh.Free(), "x+": fh.LatticePML(nodes=8), "y": fh.Periodic()}


def blow(t):
    """Return a smooth pulse of length 4."""
    return np.where((t > 0) & (t < 4), np.sin(np.pi * t / 4) ** 4, 0.0)


def material(spacing, **options):
    return fh.Elastic(fh.Kernel(2 * spacing, 1), 1.0, density=2.0, **options)


@pytest.mark.parametrize("direction", [0, 1], ids=["P", "S"])
def test_a_pulse_on_a_face_is_a_plane_wave(direction):
    """Traction sigma = rho c v on the face of a half-space, to first order in the spacing: the face lies between the
    last nodes and one spacing beyond.
    """
    spacings, errors = np.array([0.1, 0.05, 0.025, 0.0125]), []
    for dx in spacings:
        lattice, model = fh.Lattice(dx, (0.0, 0.0), (6.0, 5 * dx)), material(dx)
        push = fh.Traction("x-", np.eye(2)[direction], time=blow)
        sim = fh.Simulation(lattice, model, HALF_SPACE, loads=[push])
        sim.step(sim.prepare(5.0))  # its stability, which takes longer, is examined elsewhere
        speed = (model.p_speed, model.s_speed)[direction]
        exact = blow(sim.time - sim.dt / 2 - lattice.axes[0] / speed) / (model.density * speed)
        errors.append(np.abs(sim.fields["v"][direction] - exact[:, None]).max())
    assert fitted_rate(spacings, errors) > 0.95
    assert errors[-1] < 0.05 / (model.density * speed)


@pytest.mark.parametrize("options", LAWS.values(), ids=LAWS)
@pytest.mark.parametrize("dim", [2, 3])
def test_momentum_is_force_times_time(dim, options):
    """Momentum is area times traction times time, to rounding, before anything reaches the layers; in 3D the area is
    that of 3 x 3 nodes; velocities are half a step late.
    """
    dx, value = 0.5, np.array([0.02, -0.03, 0.01])[:dim]
    lattice = fh.Lattice(dx, (-6.0,) * dim, (6.0,) * (dim - 1) + (0.0,))
    top = "xyz"[dim - 1]
    sim = fh.Simulation(
        lattice,
        material(dx, **options),
        {"all": fh.LatticePML(nodes=6), f"{top}+": fh.Free()},
        loads=[fh.Traction(f"{top}+", value, between=[(-0.5, 0.5)] * (dim - 1))],
    )
    sim.step(5)
    momentum = 2.0 * dx**dim * sim.fields["v"].sum(tuple(range(1, dim + 1)))
    np.testing.assert_allclose(momentum, value * (3 * dx) ** (dim - 1) * (sim.time - sim.dt / 2), rtol=1e-13)


def test_reciprocity():
    """Betti and Rayleigh: the vertical displacement at one place due to a horizontal push at another equals the
    horizontal displacement there due to a vertical push at the first.
    """
    lattice = fh.Lattice(0.5, (-8.0, -8.0), (8.0, 0.0))
    places, found = [[(-5.0, -4.0)], [(2.0, 2.0)]], []
    for here, there, value, component in ((0, 1, (1.0, 0.0), 1), (1, 0, (0.0, 1.5), 0)):
        load = fh.Traction("y+", value, between=places[here], time=blow)
        sim = fh.Simulation(lattice, material(0.5), {"x": fh.Fixed(), "y-": fh.Fixed(), "y+": fh.Free()}, loads=[load])
        inside = (lattice.axes[0] >= places[there][0][0]) & (lattice.axes[0] <= places[there][0][1])
        sim.run(30.0, progress=False)
        found.append(sim.fields["u"][component, inside, -1].sum() / max(value))
    assert found[0] == pytest.approx(found[1], rel=1e-10) and abs(found[0]) > 0.1


@pytest.mark.parametrize("options", LAWS.values(), ids=LAWS)
def test_energies_count_the_work(options):
    """Nothing is lost in a closed box; nonlinear bonds have the error of the time step."""
    lattice = fh.Lattice(0.5, (-5.0, -5.0), (5.0, 5.0))
    loads = [
        fh.Traction("y+", (0.0, 0.05), between=[(-2.0, 2.0)], time=blow),
        fh.BodyForce([lambda x, y: 0.01 * x, 0.0], blow),
    ]
    sim = fh.Simulation(
        lattice, material(0.5, **options), {"all": fh.Free(), "x-": fh.Fixed()}, loads=loads, balance=True
    )
    sim.run(20.0, progress=False)
    found = sim.balance()
    assert found["work"] > 0 and abs(found["lost"]) < (1e-3 if "nonlinear" in options else 1e-12) * found["work"]


def test_a_restored_run_goes_on_bit_by_bit(tmp_path):
    """This includes the work done so far; a steady traction need not be given again."""
    setup = {
        "lattice": fh.Lattice(0.5, (-6.0, -6.0), (6.0, 0.0)),
        "model": material(0.5),
        "balance": True,
        "boundary": {"all": fh.LatticePML(nodes=6), "y+": fh.Free()},
        "loads": [fh.Traction("y+", [0.3, -1.0], [[-1.0, 1.0]])],
    }
    whole, first = fh.Simulation(**setup), fh.Simulation(**setup)
    whole.step(50)
    first.step(30)
    first.save(tmp_path / "state")
    second = fh.Simulation.restore(tmp_path / "state")
    second.step(20)
    np.testing.assert_array_equal(second.fields["u"], whole.fields["u"])
    assert second.balance() == whole.balance()


def test_a_blow_on_a_half_space_feels_no_box():
    """The reference is a half-space from whose ends nothing returns; the load stays in its place."""
    setup = {
        "lattice": fh.Lattice(0.5, (-6.0, -6.0), (6.0, 0.0)),
        "model": material(0.5, plane="strain"),
        "boundary": {"all": fh.LatticePML(nodes=24), "y+": fh.Free()},
        "loads": [
            fh.Traction("y+", (0.0, -1.0), [(-1.0, 1.0)], blow),
            fh.BodyForce([lambda x, y: np.exp(-4 * (x**2 + (y + 3) ** 2)), 0.0], blow),
        ],
    }
    (curve,) = compare(setup, 20.0, times=[10.0, 20.0], beside=False).curves.values()
    assert max(curve["error_rel_initial"]) < 1e-4  # the part of surface waves that the layer reflects


def test_a_case_and_its_simulation_agree():
    case = Case("""
[lattice]
spacing = 0.5
lower = [-5.0, -5.0]
upper = [5.0, 0.0]
[model]
type = "elastic"
young = 2.0
kernel = { horizon = 1.0, exponent = 1 }
[boundary]
all = { type = "lattice-pml", nodes = 8 }
"y+" = { type = "free" }
[[load]]
type = "traction"
side = "y+"
value = [0.1, -1.0]
between = [[-1.0, 1.0]]
time = "sin(t)"
[[load]]
type = "body-force"
value = ["exp(-4*(x**2+(y+2)**2))", 0.0]
[run]
until = 5.0
[output]
balance = true
""")
    sim = case.simulation().run(5.0, progress=False)
    loads = [
        fh.Traction("y+", (0.1, -1.0), [(-1.0, 1.0)], np.sin),
        fh.BodyForce([lambda x, y: np.exp(-4 * (x**2 + (y + 2) ** 2)), 0.0]),
    ]
    same = fh.Simulation(
        fh.Lattice(0.5, (-5, -5), (5, 0)),
        fh.Elastic(fh.Kernel(1.0, 1), 2.0),
        {"all": fh.LatticePML(nodes=8), "y+": fh.Free()},
        loads=loads,
        balance=True,
        dt=sim.dt,
    )
    same.run(5.0, progress=False)
    np.testing.assert_allclose(sim.fields["u"], same.fields["u"], rtol=0, atol=1e-14)
    assert sim.balance() == pytest.approx(same.balance())


def test_a_load_on_the_whole_side_is_said_to_end_at_the_layers():
    lattice = fh.Lattice(0.5, (-5.0, -5.0), (5.0, 0.0))
    sim = fh.Simulation(
        lattice, material(0.5), {"all": fh.LatticePML(), "y+": fh.Free()}, loads=[fh.Traction("y+", (0.0, 1.0))]
    )
    assert "taken to be zero beyond" in sim.notes[0]


@pytest.mark.parametrize(
    ("load", "changes", "message"),
    [
        (fh.Traction("x+", (1.0, 0.0)), {}, "acts on a free side.*LatticePML"),
        (fh.Traction("z+", (1.0, 0.0)), {}, "unknown side"),
        (fh.Traction("y+", (1.0,)), {}, "one component per axis"),
        (fh.Traction("y+", (1.0, 0.0), [(2.0, 7.0)]), {}, r"load\[0\].between \(x\): .*reaches beyond the near field"),
        (fh.Traction("y+", (1.0, 0.0), [(2.1, 2.2)]), {}, "meets no node"),
        (fh.Traction("y+", (1.0, 0.0), [(0.0, 1.0), (0.0, 1.0)]), {}, "two ends along each other axis"),
        (fh.BodyForce([1.0]), {}, "needs one entry per component"),
        (fh.BodyForce([1.0, 0.0]), {}, "not zero beyond the absorbing side"),
        (fh.Traction("y+", (1.0, 0.0)), {"model": fh.Wave(fh.Kernel(1.0, 1))}, "loads act on an elastic medium"),
        (
            fh.Traction("y+", (1.0, 0.0), [(-1.0, 1.0)]),
            {"model": material(0.5, critical_stretch=1e-3)},
            "far below the first strain of the load",
        ),
    ],
)
def test_bad_loads(load, changes, message):
    setup = {
        "lattice": fh.Lattice(0.5, (-5.0, -5.0), (5.0, 0.0)),
        "model": material(0.5),
        "boundary": {"all": fh.LatticePML(), "y+": fh.Free()},
    }
    with pytest.raises(fh.InputError, match=message):
        fh.Simulation(**{**setup, **changes}, loads=[load])


def test_ends_in_the_wrong_order_are_told():
    with pytest.raises(fh.InputError, match=r"load\.between: the ends are in the wrong order; .*remedy: \(-2, 2\)"):
        fh.Traction("y+", (0.0, -1.0), between=[(2, -2)])

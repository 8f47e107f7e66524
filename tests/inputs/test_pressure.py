"""Pressure in cracks and holes: resultants, superposition with a far stress, Lame's hole, cases, bad input."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.inputs.cracks import as_crack
from farhorizon.inputs.pressure import pressing_force
from helpers import fitted_rate

SPACING = 0.5
MATERIALS = {
    "bond-based": {},
    "uncalibrated": {"kernel": fh.Kernel(1.2, 0, calibrate=False)},
    "state-based": {"material": "state-based", "poisson": 0.4},
    "correspondence": {"material": "correspondence", "poisson": 0.1, "stabilisation": 0.6},
}
SHEARED = {2: [[0.3, -0.5], [-0.5, 1.1]], 3: [[0.3, -0.5, 0.2], [-0.5, 1.1, 0.4], [0.2, 0.4, -0.7]]}


def material(**options):
    return fh.Elastic(**{"kernel": fh.Kernel(2 * SPACING, 1), "young": 1.0, **options})


def force_of(load, lattice, model, cracks=(), rim="free", periodic=()):
    cracks = [as_crack(crack, lattice.dim) for crack in cracks]
    repeats = {axis: axis in periodic for axis in range(lattice.dim)}
    return pressing_force(load, lattice, model, cracks, rim, repeats)


# --- resultants ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("options", MATERIALS.values(), ids=MATERIALS)
@pytest.mark.parametrize("dim", [2, 3])
def test_a_flat_face_bears_pressure_times_area(dim, options):
    """The crack's tips are placed so that each bond vector crosses as often as the crack's length implies; the tensor
    has shear. Under a pressure without shear the forces between pairs are central and have no moment.
    """
    lattice = fh.Lattice(SPACING, (-4.0,) * dim, (4.0,) * dim)
    low = 0.37 * SPACING
    if dim == 2:
        crack, size = fh.Polyline([(low - 2, 0.2), (low + 1.5, 0.2)]), 3.5
    else:
        corner, far = (low - 2, low - 1.5, 0.2), (3.0, 2.5)
        crack, size = fh.Rectangle(corner, (far[0], 0, 0), (0, far[1], 0)), far[0] * far[1]
    above = lattice.coordinates()[-1] > 0.2
    volume = SPACING**dim
    for value in (0.7, SHEARED[dim]):
        load = fh.Pressure(crack, value)
        force = volume * force_of(load, lattice, material(**options), [crack])
        np.testing.assert_allclose(force.sum(tuple(range(1, dim + 1))), 0, atol=1e-13)
        np.testing.assert_allclose(force[:, above].sum(1), load.tensor(dim)[:, -1] * size, rtol=0, atol=1e-12)
    force = volume * force_of(fh.Pressure(crack, 1.0), lattice, material(**options), [crack])
    x = np.stack(lattice.coordinates())
    moment = x.reshape(dim, -1) @ force.reshape(dim, -1).T
    np.testing.assert_allclose(moment, moment.T, atol=1e-12)


@pytest.mark.parametrize("options", MATERIALS.values(), ids=MATERIALS)
def test_a_rim_is_pressed_from_within(options):
    """The total force is zero, no other rim is loaded, and all forces point outwards."""
    body = fh.Box((-99, -99), (99, 99)) - fh.Disc(2.1) - fh.Disc(0.6, (3.4, 3.5))
    lattice = fh.Lattice(SPACING, (-5.25, -5.25), (5.25, 5.25), body=body)
    force = SPACING**2 * force_of(fh.Pressure(fh.Disc(2.1), 0.3), lattice, material(**options))
    x, y = lattice.coordinates()
    np.testing.assert_allclose(force.sum((1, 2)), 0, atol=1e-13)
    assert not force[:, ~lattice.mask].any() and not force[:, np.hypot(x, y) > 2.1 + 1.2].any()
    pressed = force.any(0)
    assert pressed.sum() > 40 and ((force * [x, y]).sum(0)[pressed] > 0).all()


def test_a_hole_across_a_periodic_side():
    """The forces are those of the same hole elsewhere."""
    lattices = [
        fh.Lattice(SPACING, (-4.0, -4.0), (4.0, 3.5), body=fh.Box((-99, -99), (99, 99)) - hole)
        for hole in (fh.Disc(1.2), fh.Disc(1.2, (0, -4.0)) | fh.Disc(1.2, (0, 4.0)))
    ]
    middle, edge = (
        force_of(fh.Pressure(hole, 1.0), lattice, material(), periodic=(1,))
        for lattice, hole in zip(
            lattices, (fh.Disc(1.2), fh.Disc(1.2, (0, -4.0)) | fh.Disc(1.2, (0, 4.0))), strict=True
        )
    )
    np.testing.assert_allclose(np.roll(middle, 8, axis=2), edge, atol=1e-14)


# --- exact solutions -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", ["crack", "disc", "hole"])
def test_faces_under_stress_are_the_stress_and_pressed_faces(case):
    """Step by step, a body that is stretched and held at its edge moves as an unstretched one whose faces are loaded
    by that stress, up to the uniform stretch.
    """
    dim = 3 if case == "disc" else 2
    body = fh.Box((-9,) * 2, (9,) * 2) - fh.Disc(0.9) if case == "hole" else None
    lattice = fh.Lattice(SPACING, (-3.0,) * dim, (3.0,) * dim, body=body)
    model, stress = material(), np.array(SHEARED[dim])
    lame, shear = model.lame, model.shear
    strain = (stress - lame / (dim * lame + 2 * shear) * np.trace(stress) * np.eye(dim)) / (2 * shear)
    cracks = {
        "crack": [fh.Polyline([(-1.1, -0.4), (1.2, 0.7)])],
        "disc": [fh.DiscCut((0.1, 0.1, 0.1), (0.2, 0.3, 1.0), 1.2)],
        "hole": [],
    }[case]
    x = np.stack(lattice.coordinates())
    stretched = np.einsum("ab,b...->a...", strain, x) * (True if body is None else lattice.mask)
    edge = fh.Prescribed((np.abs(x) > 1.8).any(0), velocity=[0.0] * dim)
    setup = {"lattice": lattice, "model": model, "boundary": fh.Fixed(), "constraints": [edge], "cracks": cracks}
    far = fh.Simulation(initial={"u": list(stretched)}, **setup)
    pressed = fh.Simulation(loads=[fh.Pressure(cracks[0] if cracks else fh.Disc(0.9), stress)], **setup)
    for sim in (far, pressed):
        sim.step(30)
    assert np.nanmax(np.abs(pressed.fields["u"])) > 0.3
    np.testing.assert_allclose(far.fields["u"] - stretched, pressed.fields["u"], rtol=0, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bond-based", "state-based", "correspondence"])
def test_a_pressed_hole_widens_as_lame_has_it(name):
    """``u = p a^2 / (2 mu r)`` in the plane, to first order in the spacing because the rim is a staircase."""
    spacings, errors = np.array([0.25, 0.125, 0.0625]), []
    for dx in spacings:
        half = 3 + 0.5 * dx
        body = fh.Box((-99, -99), (99, 99)) - fh.Disc(1.0)
        lattice = fh.Lattice(dx, (-half, -half), (half, half), body=body)
        model = material(**MATERIALS[name] | {"kernel": fh.Kernel(2 * dx, 1)})
        load = fh.Pressure(fh.Disc(1.0), 1.0, fh.Step(2.0))
        sim = fh.Simulation(lattice, model, fh.LatticePML(nodes=12), loads=[load])
        sim.run("static", tolerance=1e-3, limit=200.0, progress=False)
        x = np.stack(lattice.coordinates())
        r = np.hypot(*x)
        outwards = (sim.fields["u"] * x).sum(0) / r
        away = (r > 1.5) & (r < 2.5)
        errors.append(np.abs(outwards * 2 * model.shear * r - 1)[away].max())
    assert errors[-1] < 0.05 and fitted_rate(spacings, errors) > 0.8


# --- cases and bad input ---------------------------------------------------------------------------------------

CASE = """
[lattice]
spacing = 0.5
lower = [-5.0, -5.0]
upper = [5.0, 5.0]
[lattice.body]
box = { lower = [-6.0, -6.0], upper = [6.0, 6.0] }
without = [{ disc = { radius = 0.8, centre = [2.5, 2.5] } }]
[model]
type = "elastic"
young = 1.0
[model.kernel]
horizon = 1.0
exponent = 1
[[crack]]
points = [[-3.0, 0.25], [1.0, 0.25]]
[[load]]
type = "pressure"
points = [[-3.0, 0.25], [1.0, 0.25]]
value = [[1.0, 0.2], [0.2, 2.0]]
time = "min(t, 1)"
[[load]]
type = "pressure"
region = { disc = { radius = 0.8, centre = [2.5, 2.5] } }
value = 0.3
[boundary]
all = { type = "lattice-pml", nodes = 6 }
[run]
until = 2.0
"""


def test_a_case_is_the_same():
    case = Case(CASE)
    sim = fh.Simulation.of(case.setup)
    hole = fh.Disc(0.8, (2.5, 2.5))
    crack = [(-3.0, 0.25), (1.0, 0.25)]
    lattice = fh.Lattice(0.5, (-5.0, -5.0), (5.0, 5.0), body=fh.Box((-6, -6), (6, 6)) - hole)
    loads = [fh.Pressure(crack, [[1.0, 0.2], [0.2, 2.0]], "min(t, 1)"), fh.Pressure(hole, 0.3)]
    other = fh.Simulation(lattice, material(), fh.LatticePML(nodes=6), cracks=[crack], loads=loads, dt=sim.dt)
    for one in (sim, other):
        one.step(5)
    np.testing.assert_array_equal(sim.fields["u"], other.fields["u"])
    assert sim.fields["u"].any()


LATTICE = fh.Lattice(0.5, (-5.0, -5.0), (5.0, 5.0))
CRACK = [(-2.0, 0.25), (2.0, 0.25)]
ELEMENTS = fh.Elastic(young=1.0, poisson=0.2, material="finite-element")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ((CRACK, np.nan), "load.value: must be finite"),
        ((CRACK, [1.0, 2.0]), r"a number or a symmetric matrix; value: shape \(2,\)"),
        ((CRACK, [[1.0, 2.0], [0.0, 1.0]]), "the tensor of a pressure is symmetric"),
        ((CRACK, 1.0, "x"), "load.time"),
        (("here", 1.0), "load.on"),
    ],
)
def test_impossible_pressures(given, message):
    with pytest.raises(fh.InputError, match=message):
        fh.Pressure(*given)


@pytest.mark.parametrize(
    ("load", "options", "message"),
    [
        (fh.Pressure([(-2.0, 0.25), (2.5, 0.25)], 1.0), {}, r"load\[0\].on: .*faces of a crack; .*the same in cracks"),
        (fh.Pressure(CRACK, 1.0), {"cracks": [fh.Crack(CRACK, factor=0.5)]}, "faces of a crack"),
        (fh.Pressure(CRACK, np.eye(3)), {}, r"load\[0\].value: .*a row for each axis; value: 3; limit: 2"),
        (fh.Pressure([(7.0, 0.0), (8.0, 0.0)], 1.0), {}, "meets no face"),
        (fh.Pressure(fh.Disc(1.0), 1.0), {}, "free rim of a hole; value: 13 nodes in it"),
        (fh.Pressure(fh.Ball(1.0), 1.0), {}, "differ in dimension"),
        (fh.Pressure(CRACK, 1.0), {"model": fh.Wave(fh.Kernel(1.0))}, "loads act on an elastic medium"),
        (fh.Pressure(CRACK, 1.0), {"model": ELEMENTS, "cracks": []}, "faces of a medium of bonds"),
    ],
)
def test_pressures_on_what_is_no_face(load, options, message):
    setup = {"lattice": LATTICE, "model": material(), "boundary": fh.LatticePML(nodes=6), "cracks": [CRACK]}
    with pytest.raises(fh.InputError, match=message):
        fh.Simulation(**setup | options, loads=[load])

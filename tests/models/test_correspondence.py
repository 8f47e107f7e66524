"""Correspondence solids with drag, damage and several materials, against a program with one matrix entry per bond,
classical interfaces, and energy balances. Forces at free surfaces, holes and cracks are in `test_force_states`.
"""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.case.case import Case
from helpers import fitted_rate
from solids import KERNELS, MATERIAL, Dense, box, lame_constants, noise, solid


def graded(*at):
    """Young's modulus, Poisson's ratio and density that vary everywhere, by tens of per cent."""
    wave = sum((a + 1) * x for a, x in enumerate(at))
    return 1 + 0.5 * np.sin(wave), 0.2 + 0.15 * np.cos(wave), 1.3 + 0.4 * np.sin(0.7 * wave)


def constants(shape):
    return dict(zip(("young", "poisson", "density"), graded(*box(*shape).coordinates()), strict=True))


def run_of(shape, name, sides, initial=None, loads=(), cracks=(), dt=0.1, **options):
    """A run; the remaining options are those of the solid."""
    return fh.Simulation(
        box(*shape), solid(name, **options), sides, initial, loads=loads, cracks=cracks, dt=dt, threads=1, balance=True
    )


def elastic(name, **options):
    """A solid with one of the kernels, whose bonds break by energy."""
    return fh.Elastic(**{"kernel": KERNELS[name], **MATERIAL, "material": "correspondence", **options})


def crossing(points):
    """A function that tells which bonds cross a straight crack along an axis."""
    first, last = np.array(points)
    axis = int(first[1] == last[1])

    def absent(a, b):
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.nan_to_num((first[axis] - a[..., axis]) / (b[..., axis] - a[..., axis]), posinf=0, neginf=0)
        at = (a + share[..., None] * (b - a))[..., 1 - axis]
        across = (a[..., axis] - first[axis]) * (b[..., axis] - first[axis]) < 0
        return across & (at >= first[1 - axis]) & (at <= last[1 - axis])

    return absent


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("shape", "name", "side"),
    [
        ((10, 9), "gaussian", fh.Free()),
        ((9, 10), "ramp", fh.Free()),
        ((9, 10), "gaussian", fh.Fixed()),
        ((10, 9), "constant", fh.Fixed()),
        pytest.param((9, 9, 9), "constant", fh.Free(), marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("varies", [False, True])
@pytest.mark.parametrize("stabilisation", [0.0, 0.4])
def test_steps_match_dense_matrices(shape, name, side, varies, stabilisation):
    """A load, drag, and, in free solids without stabilisation, bonds that break: the displacements after 40 steps
    agree, and the same bonds break.
    """
    u, v = noise(shape, 0.01), noise(shape, 0.05, 2)
    breaks = not side.bonded and not stabilisation
    dense = Dense(
        shape,
        KERNELS[name],
        4 if side.bonded else 0,
        stabilisation=stabilisation,
        drag=0.5,
        material=graded if varies else None,
        critical=0.12 if breaks else 1e9,
    )
    dense.start(u, v)
    sim = run_of(
        shape,
        name,
        side,
        {"u": u, "v": v},
        loads=[fh.BodyForce([0.02, *[0.0] * (len(shape) - 1)])],
        drag=0.5,
        stabilisation=stabilisation,
        critical_stretch=0.12 if breaks else None,
        **(constants(shape) if varies else {}),
    )
    dense.step(40, load=0.02)
    sim.step(40)
    assert (sim.broken_bonds > 0) == breaks
    np.testing.assert_allclose(sim.fields["u"], dense.field(dense.u), rtol=0, atol=1e-12)
    np.testing.assert_allclose(sim.fields["v"], dense.field(dense.v), rtol=0, atol=1e-11)


def test_drag_across_periodic_sides():
    """The choice of the first node does not matter, from the first step on."""
    shape, shift = (12, 11), (4, 5)
    data = {"u": noise(shape, 0.01), "v": noise(shape, 0.05, 2)}
    fields = []
    for by in ((0, 0), shift):
        turned = {name: np.roll(values, by, (1, 2)) for name, values in data.items()}
        sim = run_of(shape, "ramp", fh.Periodic(), turned, drag=0.5, stabilisation=0.4)
        sim.step(5)
        fields.append(np.roll(sim.fields["u"], np.negative(by), (1, 2)))
    np.testing.assert_allclose(*fields, rtol=0, atol=1e-15)


#: Solids with damage: how they are made, from what their shape tensors follow, and by what criterion bonds break.
DAMAGED = {
    "recomputed": (solid, {"drag": 0.5}, {}),
    "published": (solid, {"drag": 0.5, "shape_tensor": "published"}, {"unweakened": True}),
    "kept": (solid, {"drag": 0.5, "shape_tensor": "kept"}, {"kept": True}),
    "by energy": (elastic, {"stabilisation": 0.4}, {"by_energy": True}),
}
CRITICAL = {"by energy": 0.05}  # of the longest bonds; otherwise 0.12


@pytest.mark.sampled(4)
@pytest.mark.parametrize("law", DAMAGED)
@pytest.mark.parametrize("varies", [False, True])
@pytest.mark.parametrize(
    ("name", "points"), [("gaussian", [(4.5, -1.0), (4.5, 5.0)]), ("constant", [(2.0, 3.6), (7.0, 3.6)])]
)
def test_damage_matches_dense_matrices(name, points, law, varies):
    """A crack, bonds that break, drag or stabilisation, and a load combined: the same bonds break at the same steps."""
    shape, (made, options, of_dense) = (10, 9), DAMAGED[law]
    u, v = noise(shape, 0.01), noise(shape, 0.08, 2)
    beside = {key: options[key] for key in ("drag", "stabilisation") if key in options} | of_dense
    critical = CRITICAL.get(law, 0.12)
    if varies:
        beside, options = beside | {"material": graded}, options | constants(shape)
    dense = Dense(shape, KERNELS[name], absent=crossing(points), critical=critical, **beside)
    dense.start(u, v)
    sim = fh.Simulation(
        box(*shape),
        made(name, critical_stretch=critical, **options),
        fh.Free(),
        {"u": u, "v": v},
        loads=[fh.BodyForce([0.02, 0.0])],
        cracks=[points],
        dt=0.1,
        threads=1,
    )
    cut = int((dense.w > 0).sum())
    dense.step(60, load=0.02)
    sim.step(60)
    lost = cut - int((dense.w > 0).sum())
    assert lost > 10 and sim.broken_bonds == lost // 2
    np.testing.assert_allclose(sim.fields["u"], dense.field(dense.u), rtol=0, atol=1e-12)
    expected = 1 - (dense.w > 0).sum(1) / (dense.uncut > 0).sum(1)
    np.testing.assert_allclose(sim.fields["damage"], dense.field(expected[:, None])[0], rtol=0, atol=1e-14)


def test_threads_agree():
    """Two threads agree bitwise with one."""
    fields = []
    for threads in (1, 2):
        sim = fh.Simulation(
            box(180, 130),
            solid("gaussian", drag=0.1, critical_stretch=0.08),
            {"all": fh.NonlocalPML(8), "y+": fh.Free()},
            {"u": noise((180, 130), 0.01), "v": noise((180, 130), 0.1, 2)},
            threads=threads,
        )
        sim.step(8)
        fields.append([*sim.fields.values(), sim.engine.memory])
    assert sim.broken_bonds > 0 and sim.engine.threads == 2
    assert all((a == b).all() for a, b in zip(*fields, strict=True))


@pytest.mark.parametrize(
    "options",
    [
        {"drag": 0.2},
        {"critical_stretch": 0.06},
        {"critical_stretch": 0.06, "shape_tensor": "published"},
        {"critical_stretch": 0.06, "shape_tensor": "kept"},
        {"stabilisation": 0.5, "drag": 0.2, "critical_stretch": 0.06},
    ],
)
@pytest.mark.parametrize("varies", [False, True])
def test_energies_add_up(options, varies):
    """Kinetic and strain energy change by the work less the energy spent by breaking and drag, to rounding."""
    sim = run_of(
        (20, 24),
        "gaussian",
        {"all": fh.Free(), "x-": fh.Fixed()},
        {"u": noise((20, 24), 0.006), "v": noise((20, 24), 0.06, 2)},
        [fh.BodyForce([0.01, 0.0], lambda t: np.sin(t)), fh.Traction("y+", (0.0, -0.02), [(3.0, 15.0)])],
        [[(9.5, 12.0), (9.5, 30.0)]],
        0.2,
        **(constants((20, 24)) if varies else {}),
        **options,
    )
    start = sim.energy()
    assert sim.balance()["lost"] == sim.energies()["work"] == 0
    sim.step(150)
    found = sim.balance()
    assert abs(found["lost"]) < 1e-12 * (start + abs(found["work"])) and found["work"] != 0
    assert (sim.broken_bonds > 0) == ("critical_stretch" in options)
    assert (found.get("drag", 0.0) > 0) == ("drag" in options)


def test_uniform_motion_feels_no_drag():
    """Drag pulls towards the mean of the neighbours, so it does not affect rigid motion."""
    sim = run_of((12, 12), "gaussian", fh.Free(), {"v": (1.0, 0.5)}, drag=1.0)
    sim.step(40)
    np.testing.assert_allclose(sim.fields["v"], np.broadcast_to([[[1.0]], [[0.5]]], (2, 12, 12)), rtol=0, atol=1e-12)


def test_no_bond_breaks_near_the_layers():
    """Nothing breaks within one reach of the layers, even beyond the critical stretch; elsewhere bonds do break."""
    sim = run_of(
        (30, 30), "gaussian", fh.NonlocalPML(8), loads=[fh.BodyForce(noise((30, 30), 0.05))], critical_stretch=0.03
    )
    sim.step(60)
    damage, rim = sim.fields["damage"], np.ones((30, 30), bool)
    rim[2:-2, 2:-2] = False
    assert damage[rim].max() == 0 and damage.max() > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("varies", [False, True])
@pytest.mark.parametrize(("side", "drag"), [(fh.Free(), 0.0), (fh.Fixed(), 0.0), (fh.Free(), 1.0)])
def test_step_limit(side, drag, varies):
    """White noise stays bounded at 0.97 of the limit, with free faces and a crack, and a step of 1.01 times the limit
    is refused.
    """
    settings = {"drag": drag, **(constants((20, 18)) if varies else {})}
    start, cracks = {"u": noise((20, 18), 0.01)}, [] if side.bonded else [[(9.5, -1.0), (9.5, 9.0)]]
    limit = run_of((20, 18), "gaussian", side, start, cracks=cracks, dt=None, **settings).step_limit
    sim = run_of((20, 18), "gaussian", side, start, cracks=cracks, dt=0.97 * limit, **settings)
    sim.step(3000)
    assert np.abs(sim.fields["u"]).max() < 1
    with pytest.raises(fh.InputError, match="above the stable limit"):
        run_of((20, 18), "gaussian", side, start, cracks=cracks, dt=1.01 * limit, **settings)


def test_isolated_nodes_are_said():
    """A crack around a node is allowed; the node keeps its velocity."""
    square = [(4.4, 4.4), (5.6, 4.4), (5.6, 5.6), (4.4, 5.6), (4.4, 4.4)]
    sim = run_of((11, 11), "gaussian", fh.Free(), {"v": (0.3, 0.0)}, cracks=[square], drag=0.5, critical_stretch=0.5)
    assert any("1 nodes without any bond" in note for note in sim.notes)
    sim.step(20)
    assert sim.fields["v"][0, 5, 5] == pytest.approx(0.3, abs=1e-14) and sim.fields["damage"][5, 5] == 1


@pytest.mark.parametrize("shape", [(20, 13), pytest.param((14, 9, 9), marks=pytest.mark.slow)])
def test_layers_stretched_along_themselves_are_at_rest(shape):
    """A patch test: with Poisson's ratio 0 a uniform strain along strata of any stiffness is in equilibrium, also at
    free faces along them.
    """
    lattice = box(*shape)
    along, across = lattice.coordinates()[0], lattice.coordinates()[1]
    young = 1 + 3 * np.random.default_rng(1).random(shape[1])[across.astype(int)]
    stretched = [0.01 * along, *[0.0 * along] * (len(shape) - 1)]
    sim = run_of(shape, "ramp", fh.Free(), {"u": np.stack(stretched)}, young=young, poisson=0.0, density=young**2)
    sim.step()
    v = sim.fields["v"]
    assert np.abs(v[:, 4:-4]).max() < 1e-14 and np.abs(v).max() > 1e-4  # two reaches of 2 nodes from the ends


#: Young's modulus, Poisson's ratio and density on either side of x = 0.
PAIR = {"young": (1.0, 3.0), "poisson": (0.2, 0.3), "density": (1.0, 2.0)}


@pytest.mark.slow
@pytest.mark.parametrize("component", [0, 1], ids=["P", "S"])
def test_an_interface_reflects_and_transmits_by_impedance(component):
    """The part of wavenumber 2 of a normally incident pulse obeys R = (Z1 - Z2)/(Z1 + Z2) and T = 2 Z1/(Z1 + Z2), with
    Z = density times speed, to second order. The interface lies midway between nodes, and by the end nothing has
    reached the middle from the lateral faces.
    """
    moduli = [lame_constants(PAIR["young"][i], PAIR["poisson"][i]) for i in (0, 1)]
    moduli = [lame + 2 * shear if component == 0 else shear for lame, shear in moduli]
    speed, impedance = (
        np.array([np.sqrt(m * rho**sign) for m, rho in zip(moduli, PAIR["density"], strict=True)]) for sign in (-1, 1)
    )
    exact = np.abs([impedance[0] - impedance[1], 2 * impedance[0]]) / impedance.sum()

    def pulse(x):
        return np.exp(-(((x + 2.5) / 0.6) ** 2))

    def part(values, x, k):
        return abs((values * np.exp(-1j * k * x)).sum())

    spacings, errors = [0.2, 0.1, 0.05], []
    half = 6.0 if component == 0 else 9.0
    for dx in spacings:
        lattice = fh.Lattice(dx, (-7 + dx / 2, -half), (7 - dx / 2, half))
        u, v = [0.0, 0.0], [0.0, 0.0]
        u[component], v[component] = lambda x, y: pulse(x), lambda x, y: speed[0] * 2 * (x + 2.5) / 0.36 * pulse(x)
        model = fh.Correspondence(
            fh.Kernel(2 * dx, 1),
            stabilisation=0.5,
            **{name: lambda x, y, pair=pair: np.where(x < 0, *pair) for name, pair in PAIR.items()},
        )
        sim = fh.Simulation(lattice, model, fh.Free(), {"u": u, "v": v}).run(4.5 / speed[0], progress=False)
        x, middle = lattice.axes[0], sim.fields["u"][component][:, lattice.shape[1] // 2]
        left, k = x < 0, 2.0
        back, on = (
            part(middle[left], x[left], k),
            part(middle[~left], x[~left], k * speed[0] / speed[1]) * speed[0] / speed[1],
        )
        errors.append(np.abs(np.array([back, on]) / part(pulse(x), x, k) - exact).max())
    assert fitted_rate(spacings, errors) > 1.8 and errors[-1] < 5e-3


def test_layers_along_the_way_go_on_into_the_absorbing_layer():
    """A stiff stratum between soft ones meets the side at right angles; the reflection is less than the 1e-3 for which
    the layer is designed.
    """

    def young(x, y):
        return np.where(np.abs(y) < 5, 3.0, 1.0)

    start = {"u": [lambda x, y: np.exp(-(x**2 + y**2) / 20), lambda x, y: 0 * x]}
    sides = {"x": fh.NonlocalPML(20, reflection=1e-3), "y": fh.Fixed()}
    near, far = (
        fh.Simulation(fh.Lattice(1.0, (-half, -40), (half, 40)), solid("gaussian", young=young), b, start, dt=0.25)
        for half, b in ((15, sides), (70, fh.Fixed()))
    )
    for sim in (near, far):
        sim.step(220)
    assert np.abs(near.fields["u"] - far.fields["u"][:, 55:-55]).max() < 1e-3


def test_cavity():
    """Nodes in a hole neither move nor count, also beside layers."""
    lattice = fh.Lattice(1.0, (0, 0), (24, 24), body=fh.Box((-1, -1), (25, 25)) - fh.Disc(4.0, (12, 12)))
    start = noise((25, 25), 0.01)
    sim = fh.Simulation(lattice, solid("gaussian"), fh.NonlocalPML(6), {"u": start})
    sim.step(30)
    u = sim.fields["u"]
    assert np.isnan(u[:, ~lattice.mask]).all() and 0 < np.abs(u[:, lattice.mask]).max() < np.abs(start).max()
    assert np.isfinite(list(sim.energies().values())).all()


def breaking(strength=1.0, **options):
    """A half-space that is pressed at its face until bonds break."""
    lattice = fh.Lattice(1.0, (-12, -16), (12, 0))
    push = fh.Traction("y+", (0.0, -0.01), between=[(-5, 5)], time=lambda t: strength * min(t / 10, 1.0))
    sides = {"all": fh.NonlocalPML(8, cross=0.1), "y+": fh.Free()}
    model = solid("gaussian", critical_stretch=3e-3, drag=0.9)
    return fh.Simulation(lattice, model, sides, loads=[push], balance=True, **options), push


def test_a_saved_run_goes_on_bitwise(tmp_path):
    """Displacements, broken bonds, energies and the memory of the layers equal those of an uninterrupted run, whether
    the checkpoint is loaded into a new simulation or restored from the file alone.
    """
    (sim, push), (again, _) = breaking(), breaking()
    sim.step(70)
    sim.save(tmp_path / "a.ckpt", outputs=3)
    sim.step(40)
    assert sim.broken_bonds > 0
    assert again.load(tmp_path / "a.ckpt") == {"outputs": 3}
    for other in (again, fh.Simulation.restore(tmp_path / "a.ckpt", loads=[push])):
        other.step(40)
        for name, field in sim.fields.items():
            np.testing.assert_array_equal(other.fields[name], field)
        assert other.energies() == sim.energies() and other.broken_bonds == sim.broken_bonds
        np.testing.assert_array_equal(other.engine.memory, sim.engine.memory)


def test_loads_must_be_finite():
    with pytest.raises(fh.InputError, match="must be finite"):
        breaking(strength=np.nan)[0].step(1)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"poisson": 0.5}, "Poisson's ratio"),
        ({"plane": "bending"}, "unknown plane state"),
        ({"young": 0.0}, "model.young"),
        ({"density": -1.0}, "density"),
        ({"critical_stretch": 0.0}, "critical_stretch"),
        ({"shape_tensor": "frozen"}, "recomputed, published, kept"),
        ({"drag": -1.0}, "drag"),
        ({"stabilisation": 2.0}, "stabilisation"),
        ({"kernel": fh.Stencil.finite_difference(2)}, "made of its kernel"),
    ],
)
def test_bad_constants(change, words):
    with pytest.raises(fh.InputError, match=words):
        fh.Correspondence(**{"kernel": fh.Kernel(2.0), "young": 1.0, "poisson": 0.25, **change})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"dt": 5.0}, "the time step is above the stable limit"),
        ({"drag": 10.0, "dt": 0.3}, "above the stable limit.*limit: 0.09"),
        ({"sides": {"all": fh.NonlocalPML(6), "x-": fh.LatticePML(nodes=6)}}, "cannot be combined"),
        ({"stabilisation": 0.1, "sides": fh.NonlocalPML(6)}, "no such side.*without stabilisation"),
        (
            {"sides": {"all": fh.NonlocalPML(6), "y+": fh.Free()}, "cracks": [[(12.0, 3.0), (40.0, 20.0)]]},
            "missing bonds in a layer",
        ),
        (
            {"sides": fh.NonlocalPML(6), "young": np.arange(1.0, 257.0).reshape(16, 16)},
            "^model.young: varies along x within one reach of x-, whose layer.*value: .1, 17, 33, 49, 65. from",
        ),
    ],
)
def test_bad_input(change, words):
    with pytest.raises(fh.InputError, match=words):
        run_of((16, 16), "gaussian", **{"sides": {"all": fh.Fixed(), "y+": fh.Free()}, **change})


CASE = """
[lattice]
spacing = 1.0
lower = [-12.0, -12.0]
upper = [12.0, 12.0]
[model]
type = "correspondence"
young = "1 + 0.5*(y > 0)"
poisson = 0.2
drag = 0.1
kernel = { horizon = 2.7, exponent = 0, influence = "gaussian", width = 0.9, volume = "full" }
[[material]]
region = { disc = { radius = 4.0 } }
young = "3 + 0.1*x"
density = 2.0
[initial]
u = ["exp(-(x**2+y**2)/8)", 0.0]
[boundary]
x = { type = "nonlocal-pml", nodes = 6 }
y = { type = "fixed" }
[run]
until = 10.0
"""


def test_a_case_with_regions():
    sim = Case(CASE).run()
    sim.step(40)
    lattice = fh.Lattice(1.0, (-12, -12), (12, 12))
    x, y = lattice.coordinates()
    disc = fh.Disc(4.0).contains(np.stack([x, y], -1))
    same = fh.Simulation(
        lattice,
        solid(
            "gaussian",
            young=np.where(disc, 3 + 0.1 * x, 1 + 0.5 * (y > 0)),
            poisson=0.2,
            density=np.where(disc, 2.0, 1.0),
            drag=0.1,
        ),
        {"x": fh.NonlocalPML(6), "y": fh.Fixed()},
        {"u": [fh.Expression("exp(-(x**2+y**2)/8)", 2), 0.0]},
        dt=sim.dt,
    )
    same.step(40)
    np.testing.assert_allclose(sim.fields["u"], same.fields["u"], rtol=0, atol=1e-14)

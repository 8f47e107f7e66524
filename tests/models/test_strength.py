"""Bonds whose strength varies from node to node: which of them break, the energy spent, and what is refused."""

import warnings

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.medium.fracture import fracture_energy
from solids import Dense, noise

SPACING = 0.5


def material(**options):
    return fh.Elastic(fh.Kernel(2 * SPACING, 1), **{"young": 1.0, **options})


def bonds_of(lattice, sim):
    """Numbers of the two ends of each bond, and its vector, where the last axis is periodic."""
    index = np.indices(lattice.shape).reshape(lattice.dim, -1).T
    found = []
    for offset in sim.stencil.offsets:
        other = index + offset
        other[:, -1] %= lattice.shape[-1]
        found += [(i, j, offset) for i, j in enumerate(other) if 0 <= j[0] < lattice.shape[0]]
    i, j, xi = (np.array([one[k] for one in found]) for k in range(3))
    return i, np.ravel_multi_index(tuple(j.T), lattice.shape), SPACING * xi


# --- which bonds break -----------------------------------------------------------------------------------------


def test_a_bar_in_tension_breaks_at_its_weakest_bonds():
    """At a constant rate of strain all bonds of one direction have the same stretch. The first to break are those with
    the least strength over their share of the strain, known before the run.
    """
    rate = 1e-3
    lattice = fh.Lattice(SPACING, (-20.0, -2.0), (20.0, 2.0))
    strength = fh.Weibull(scale=0.01, modulus=6, cell=SPACING, seed=4)
    stronger_ends = lambda x, y: strength(x, y) + (np.abs(x) > 12)  # noqa: E731 (which slow down)
    sides = {"x": fh.Free(), "y": fh.Periodic()}
    start = {"v": lambda x, y: [rate * x, 0 * y]}
    sim = fh.Simulation(lattice, material(critical_stretch=stronger_ends), sides, start, dt=0.02)
    i, j, xi = bonds_of(lattice, sim)
    at_nodes = stronger_ends(*lattice.coordinates()).ravel()
    along = xi[:, 0] ** 2 / (xi**2).sum(1)
    strains = np.minimum(at_nodes[i], at_nodes[j]) / np.maximum(along, 1e-9)
    weakest = strains < strains.min() * (1 + 1e-12)
    assert weakest.sum() == 8 and np.sort(strains)[8] > 1.01 * strains.min()  # those along the bar of one node
    sim.step(int(np.floor(strains.min() / rate / sim.dt)))
    assert sim.broken_bonds == 0
    sim.step(2)
    assert sim.broken_bonds == 4
    assert set(np.flatnonzero(sim.fields["damage"].ravel())) == {*i[weakest], *j[weakest]}


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"nonlinear": True},
        {"material": "state-based", "poisson": 0.3},
        {"material": "correspondence", "poisson": 0.3},
    ],
    ids=["linear", "nonlinear", "state-based", "correspondence"],
)
def test_the_crack_runs_in_the_weaker_half(options):
    """A crack in the middle is pulled open evenly; beyond its right tip bonds bear four times the stretch."""
    lattice = fh.Lattice(SPACING, (-8.0, -8.0), (8.0, 8.0))
    model = material(critical_stretch="where(x > 0, 0.04, 0.01)", **options)
    start = {"v": [0.0, "0.004*y"]}
    sim = fh.Simulation(lattice, model, fh.Free(), start, cracks=[[(-3.0, 0.25), (3.0, 0.25)]])
    cut = sim.fields["damage"]
    x = lattice.coordinates()[0]
    while sim.broken_bonds < 60:
        sim.step(2)
        assert sim.time < 30
    more = sim.fields["damage"] - cut
    assert more[x < -3].sum() > 4 and not more[x > 0.5].any()


def test_stresses_of_many_strengths_break_as_in_a_dense_program():
    shape = (11, 10)
    strength = np.random.default_rng(3).uniform(0.06, 0.2, shape)
    kernel = fh.Kernel(2.7, 0, "gaussian", 0.9, volume="full")
    pairs = np.minimum.outer(strength.ravel(), strength.ravel())
    dense = Dense(shape, kernel, critical=pairs, stabilisation=0.4)
    model = fh.Correspondence(kernel, 1.0, 0.25, critical_stretch=strength, stabilisation=0.4)
    lattice = fh.Lattice(1.0, (0.0, 0.0), tuple(n - 1.0 for n in shape))
    v = noise(shape, 0.15)
    sim = fh.Simulation(lattice, model, fh.Free(), {"v": v}, dt=dense.dt)
    dense.start(0 * v, v)
    dense.step(25)
    sim.step(25)
    np.testing.assert_allclose(sim.fields["u"], dense.field(dense.u), rtol=0, atol=1e-11)
    assert sim.broken_bonds == ((dense.uncut > 0) & (dense.w == 0)).sum() // 2 > 10


# --- what it takes ---------------------------------------------------------------------------------------------


def test_energies_of_many_strengths_add_up():
    lattice = fh.Lattice(SPACING, (-8.0, -8.0), (8.0, 8.0))
    x = np.stack(lattice.coordinates())
    blast = fh.Source(0.15 * x * np.exp(-(x**2).sum(0)), lambda t: np.exp(-((t - 4) ** 2)))
    model = material(critical_stretch=fh.Weibull(0.02, 4, 1.0))
    sim = fh.Simulation(lattice, model, fh.Free(), sources=[blast], balance=True).run(16.0)
    found = sim.balance()
    assert abs(found["lost"]) < 1e-6 * found["work"]
    assert sim.broken_bonds > 50 and found["broken"] > 0.05 * found["work"]


@pytest.mark.parametrize("dim", [2, 3])
def test_a_fracture_energy_is_spent_whatever_the_stiffness(dim):
    """The energy of each node is that of its own bonds: Young's modulus, a coefficient and the energy itself vary."""
    lattice = fh.Lattice(SPACING, (-3.0,) * dim, (3.0,) * dim)
    x = lattice.coordinates()[0]
    young, energy = np.where(x > 0, 5.0, 1.0), np.where(x > 1, 3e-4, 1e-4)
    stretches = {}
    for name, given in {
        "all": {"model": material(young=young, fracture_energy=energy)},
        "coefficient": {"model": material(fracture_energy=1e-4), "coefficient": young},
        "one": {"model": material(fracture_energy=1e-4)},
    }.items():
        stretches[name] = fh.Simulation(lattice, boundary=fh.Free(), **given).parts.breaking.critical_stretches
    one = material()
    stencil = one.stencil(SPACING, dim)
    stiffness = one.bond_stiffness(stencil, SPACING)
    for at in ((0,) * dim, (8,) * dim, (12,) * dim):
        spent = fracture_energy(SPACING * stencil.offsets, young[at] * stiffness, stretches["all"][at])
        assert spent == pytest.approx(energy[at], rel=1e-12)
    np.testing.assert_allclose(stretches["coefficient"], stretches["one"] / np.sqrt(young), rtol=1e-12)


def test_strengths_that_are_the_same_everywhere_are_a_number():
    start = {"v": 0.03 * noise((17, 17), 1.0)}
    lattice = fh.Lattice(SPACING, (-4.0, -4.0), (4.0, 4.0))
    sims = [
        fh.Simulation(lattice, material(critical_stretch=s), fh.Free(), start).run(8.0)
        for s in (0.03, "0.03 + 0*x", np.full((17, 17), 0.03))
    ]
    assert sims[0].broken_bonds > 20
    for sim in sims[1:]:
        np.testing.assert_array_equal(sim.fields["u"], sims[0].fields["u"])
        assert sim.engine.tables.bonds.strength.size == 1


def test_threads_checkpoints_and_the_order_of_nodes_change_nothing(tmp_path):
    """Strengths depend on the place: a lattice that is shifted by whole nodes has the same ones at the same places."""
    model = material(critical_stretch=fh.Weibull(0.02, 5, SPACING))
    start = {"v": ["0.05*sin(3*x)*cos(2*y)", "0.05*cos(5*x*y)"]}
    lattice = fh.Lattice(SPACING, (-26.0, -25.0), (26.0, 25.0))
    one, two, resumed = (fh.Simulation(lattice, model, fh.Free(), start, threads=n) for n in (1, 2, 1))
    one.step(6)
    one.save(tmp_path / "a.ckpt")
    resumed.load(tmp_path / "a.ckpt")
    restored = fh.Simulation.restore(tmp_path / "a.ckpt")
    for sim, steps in ((one, 6), (two, 12), (resumed, 6), (restored, 6)):
        sim.step(steps)
        np.testing.assert_array_equal(sim.fields["u"], one.fields["u"])
        assert sim.broken_bonds == one.broken_bonds > 50
    part = fh.Lattice(SPACING, (-3.0, -1.5), (3.0, 5.0))
    at = tuple(slice(round((a - b) / SPACING), None) for a, b in zip(part.lower, lattice.lower, strict=True))
    whole = fh.Weibull(0.02, 5, SPACING)(*lattice.coordinates())[at]
    ours = fh.Weibull(0.02, 5, SPACING)(*part.coordinates())
    np.testing.assert_array_equal(whole[: ours.shape[0], : ours.shape[1]], ours)
    other = fh.Simulation(lattice, material(critical_stretch=0.02), fh.Free(), start, dt=one.dt)
    with pytest.raises(fh.FarhorizonError, match=r"strength|bonds"):
        other.load(tmp_path / "a.ckpt")


# --- bonds that cannot break -----------------------------------------------------------------------------------


def test_the_rim_warns_of_the_strengths_there():
    """Bonds within one reach of a side that is not free cannot break. A warning says so where they would break, and
    none appears where they are strong enough, however weak the others are.
    """
    lattice = fh.Lattice(SPACING, (-4.0, -2.0), (4.0, 2.0))
    for rim, inside, warned in ((0.5, 0.005, False), (0.005, 0.5, True)):
        model = material(critical_stretch=f"where(abs(x) > 1.9, {rim}, {inside})")
        sides = {"x": fh.LatticePML(nodes=4), "y": fh.Periodic()}
        sim = fh.Simulation(lattice, model, sides, {"v": ["0.1*exp(-4*x**2)", 0.0]})
        with warnings.catch_warnings(record=True) as seen:
            warnings.simplefilter("always")
            sim.run(6.0)
        assert bool(sim.cautions) == any("where they cannot break" in str(one.message) for one in seen) == warned


# --- cases and bad input ---------------------------------------------------------------------------------------

CASE = """
[lattice]
spacing = 0.5
lower = [-4.0, -4.0]
upper = [4.0, 4.0]
[model]
type = "elastic"
young = 1.0
critical_stretch = { type = "weibull", scale = 0.05, modulus = 6, cell = 0.5 }
kernel = { horizon = 1.0, exponent = 1 }
[[material]]
region = { box = { lower = [-4.0, -1.0], upper = [4.0, 0.0] } }
critical_stretch = "0.01 + 0.001*x"
[boundary]
all = { type = "free" }
[run]
until = 1.0
"""


def test_case_of_regions_with_strengths():
    sim = Case(CASE).simulation()
    x, y = sim.lattice.coordinates()
    strength = fh.Weibull(0.05, 6, 0.5)(x, y)
    wanted = np.where((y >= -1) & (y <= 0), 0.01 + 0.001 * x, strength)
    np.testing.assert_allclose(sim.parts.breaking.critical_stretches, wanted, rtol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("lower = [-4.0, -1.0], upper = [4.0, 0.0]", "lower = [5.0, 5.0], upper = [6.0, 6.0]", "has no node"),
        ('"0.01 + 0.001*x"', '"0.01*x"', r"material\[0\].critical_stretch: the critical_stretch must be positive"),
        ('"0.01 + 0.001*x"', '"0.01 + t"', "depend on t"),
        ('critical_stretch = "0.01 + 0.001*x"', "fracture_energy = 1e-4", "constants that the model has, too"),
        ("scale = 0.05", "scale = 0.0", r"model.critical_stretch.scale: must be finite and positive"),
        ("cell = 0.5", "cells = 0.5", "did you mean 'cell'"),
        ("modulus = 6", "modulus = -6", "modulus"),
    ],
)
def test_bad_cases_of_strengths(old, new, message):
    assert old in CASE
    with pytest.raises(fh.InputError, match=message):
        Case(CASE.replace(old, new)).simulation()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"critical_stretch": "x"}, "positive at every node"),
        ({"critical_stretch": np.full(3, 0.1)}, "shape"),
        ({"critical_stretch": "0.1 + t"}, "t"),
        ({"fracture_energy": "z"}, "z"),
        ({"critical_stretch": "0.1 + x**2", "fracture_energy": 0.1}, "two names of one thing"),
        ({"fracture_energy": 1.0, "softening": "linear", "material": "state-based", "poisson": 0.3}, "no softening"),
        ({"critical_stretch": 0.0}, "positive"),
        ({"critical_stretch": fh.Weibull(0.1, 2, 1.0)(np.zeros(2))}, "shape"),
    ],
)
def test_strengths_that_cannot_be(given, words):
    lattice = fh.Lattice(1.0, (-9.0, -9.0), (9.0, 9.0))
    with pytest.raises(fh.InputError, match=words):
        fh.Simulation(lattice, fh.Elastic(**{"kernel": fh.Kernel(2.0, 1), "young": 1.0, **given}))


def test_a_start_beyond_the_strength_of_a_seam_is_refused():
    """The same start is allowed where the strong bonds bear it."""
    lattice = fh.Lattice(SPACING, (-4.0, -4.0), (4.0, 4.0))
    start = {"u": ["0.02*x*exp(-x**2)", 0.0]}
    fh.Simulation(lattice, material(critical_stretch="where(abs(x) > 3, 0.01, 0.03)"), fh.Free(), start)
    with pytest.raises(fh.InputError, match="beyond the critical stretch"):
        fh.Simulation(lattice, material(critical_stretch="where(abs(x) > 3, 0.03, 0.01)"), fh.Free(), start)


def test_a_strength_that_varies_up_to_where_the_domain_is_extended_is_told():
    """This matters where bonds break beyond the side, because there the strength continues with its value at the
    edge.
    """
    model = fh.Elastic(fh.Kernel(2.0, 1), 1.0, critical_stretch="1e-3*(1 + 0.03*x)")
    lattice = fh.Lattice(1.0, (-8.0, -8.0), (8.0, 8.0))

    def notes(side):
        return fh.Simulation(lattice, model, {"x": side, "y": fh.Free()}).notes

    assert any("the critical stretch changes by" in note for note in notes(fh.Extended(nodes=8)))
    assert not any("the critical stretch changes by" in note for note in notes(fh.LatticePML(nodes=4)))

"""Bonds that soften before they break: cycles of single bonds, the energy of a crack, energies, threads and
checkpoints, cases, bad input.

The comparison with plain numpy, bond by bond, is in `tests/engine/test_bonds.py`.
"""

import numpy as np
import pytest
from scipy.optimize import brentq

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.engine.codegen.bond_sweeps import SOFTENINGS
from farhorizon.medium.fracture import fracture_energy
from helpers import fitted_rate

ONSET = 0.01
SIDES_ALONG_X = {"x": fh.Free(), "y": fh.Periodic(), "z": fh.Periodic()}


def held(spacing, reach, dim, stretch=ONSET):
    """Energy per area of the bonds across a plane at a stretch, if they were linear."""
    brittle = fh.Elastic(fh.Kernel(reach * spacing, 1), 1.0)
    stencil = brittle.stencil(spacing, dim)
    return fracture_energy(spacing * stencil.offsets, brittle.bond_stiffness(stencil, spacing), stretch)


def material(softening="linear", energy=None, spacing=0.5, reach=2, dim=2, **options):
    """By default the fracture energy is twice that of the bonds when they begin to soften."""
    energy = 2 * held(spacing, reach, dim) if energy is None else energy
    given = {"critical_stretch": ONSET, "fracture_energy": energy, "softening": softening} | options
    return fh.Elastic(fh.Kernel(reach * spacing, 1), 1.0, **given)


def sides(dim):
    return {axis: side for axis, side in SIDES_ALONG_X.items() if axis in "xyz"[:dim]}


# --- single bonds ----------------------------------------------------------------------------------------------


class Bond:
    """A bond of given length along an axis, on the curve of its law and on the way back to the origin."""

    def __init__(self, softening, onset, final, contact=False):
        self.softening, self.onset, self.final, self.contact = softening, onset, final, contact
        self.top = self.spent = 0.0

    def secant(self, stretch):
        """Secant of the curve, relative to that of an intact bond."""
        if stretch <= self.onset:
            return 1.0
        if self.softening == "linear":
            return max(self.onset * (self.final - stretch) / (self.final - self.onset), 0.0) / stretch
        return self.onset * np.exp(-2 * (stretch - self.onset) / (self.final - self.onset)) / stretch

    def pull(self, stretch, before):
        """Force over stiffness; adds up the loss between the stretch one step ago and now."""
        loss = self.secant(self.top) - self.secant(max(self.top, stretch))
        self.spent += loss * stretch * before / 2
        self.top = max(self.top, stretch)
        return stretch if self.contact and stretch < 0 else self.secant(self.top) * stretch


@pytest.mark.parametrize("contact", [False, True], ids=["apart", "contact"])
@pytest.mark.parametrize("softening", SOFTENINGS)
def test_bonds_that_are_loaded_unloaded_and_loaded_again(softening, contact):
    """Beside nodes at rest, a row is pulled and pushed by a growing load: each of its nodes has one straight bond and
    two oblique ones, each computed by itself. Displacement and loss agree step by step. In compression a bond is as
    soft as in tension, or has its full stiffness with contact.
    """
    spacing, count = 0.5, 8
    model = material(softening, reach=1.5, energy=4 * held(spacing, 1.5, 2), contact=contact)
    lattice = fh.Lattice(spacing, (-spacing, 0.0), (spacing, spacing * (count - 1)))
    moves = 1.0 * (lattice.coordinates()[0] > 0.1)
    load = lambda t: 2e-4 * t * np.sin(0.5 * t)  # noqa: E731
    at_rest = fh.Prescribed(moves == 0, [0.0, 0.0])
    row = fh.Source(np.stack([moves, 0 * moves]), load)
    sim = fh.Simulation(lattice, model, sides(2), sources=[row], constraints=[at_rest], balance=True)
    ahead = sim.stencil.offsets[:, 0] == 1
    xi, c = spacing * sim.stencil.offsets[ahead], model.bond_stiffness(sim.stencil, spacing)[ahead]
    lengths = np.linalg.norm(xi, axis=1)
    shares = xi[:, 0] / lengths**2  # stretch of a bond over the displacement
    bonds = [Bond(softening, ONSET, 4 * ONSET, contact) for _ in xi]
    assert len(bonds) == 3
    u = old = 0.0
    course, tops = [], []
    while u < 8 * ONSET * spacing and sim.step_count < 2000:
        pulls = np.array([bond.pull(u * share, old * share) for bond, share in zip(bonds, shares, strict=True)])
        old, u = u, 2 * u - old + sim.dt**2 * (load(sim.time) - (c * pulls * xi[:, 0]).sum())
        sim.step()
        np.testing.assert_allclose(sim.fields["u"][0], u * moves, rtol=0, atol=1e-12 * spacing * ONSET)
        spent = sum(k * length**2 * bond.spent for k, length, bond in zip(c, lengths, bonds, strict=True))
        assert sim.energies()["broken"] == pytest.approx(count * spacing**2 * spent, rel=1e-9)
        course.append(u)
        tops.append(bonds[0].top)
    grows = np.diff(tops) > 0
    assert (np.diff(grows.astype(int)) == 1).sum() >= 3  # it softens in several swings
    assert min(course) < -0.5 * ONSET * spacing and sim.step_count < 2000


# --- what a crack takes ----------------------------------------------------------------------------------------


def opened(softening, spacing, reach, dim, energy, steps=400, nonlinear=False):
    """Two halves of a bar are moved apart evenly, until the most oblique of the bonds across x = 0 has reached the end
    of the linear law, or three times as far for the exponential one. Returns the energy that is lost per area, and the
    same from the bonds across that plane, one by one.
    """
    model = material(softening, energy, spacing, reach, dim, nonlinear=nonlinear)
    half, period = (reach + 0.5) * spacing, 2 * reach * spacing
    lattice = fh.Lattice(spacing, (-half, *[0.0] * (dim - 1)), (half, *[period] * (dim - 1)))
    xi = spacing * model.stencil(spacing, dim).offsets
    c, length = model.bond_stiffness(model.stencil(spacing, dim), spacing), np.linalg.norm(xi, axis=1)
    across = xi[:, 0] > 1e-9
    final = ONSET * energy / held(spacing, reach, dim)
    gap = 1.05 * final * (length[across] ** 2 / xi[across, 0]).max() * (1 if softening == "linear" else 3)
    until = steps * 0.9 * fh.Simulation(lattice, model, sides(dim)).dt
    right = lattice.coordinates()[0] > 0
    halves = [fh.Prescribed(~right, [0.0] * dim), fh.Prescribed(right, velocity=[gap / until, *[0.0] * (dim - 1)])]
    start = {"v": np.stack([gap / until * right, *[0.0 * right] * (dim - 1)])}
    sim = fh.Simulation(lattice, model, sides(dim), start, constraints=halves).run(until, progress=False)
    area = np.prod([spacing * n for n in lattice.shape[1:]])
    taken = 0.5 * ONSET * final * (c * xi[:, 0] * length**2)[across].sum()
    if softening == "linear":
        assert sim.broken_bonds == round((xi[across, 0] / spacing).sum()) * np.prod(lattice.shape[1:])
    return sim.energies()["broken"] / area, taken


BARS = [(2, 2, False), (2, 4, False), (2, 3, True), (3, 2, False)]


@pytest.mark.parametrize("softening", SOFTENINGS)
@pytest.mark.parametrize(("dim", "reach", "nonlinear"), BARS)
def test_a_plane_takes_what_its_bonds_do(dim, reach, nonlinear, softening):
    """Each bond is loaded steadily: the error is of second order in the stretch per step, and for the linear law
    arises at its ends only. The exponential law leaves a force of exp(-7) at most.
    """
    lost, taken = opened(softening, 0.5, reach, dim, 4 * held(0.5, reach, dim), nonlinear=nonlinear)
    assert lost == pytest.approx(taken, rel=2e-3)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("dim", [2, 3])
def test_the_fracture_energy_is_the_same_on_every_lattice(dim):
    """The fracture energy is that of the material, up to the difference between a plane along an axis and the mean
    over all planes: 6 % in space at a reach of two nodes, half of that in the plane, and less on finer lattices. The
    horizon does not matter.
    """
    energy = 8 * held(0.5, 2, dim)
    reaches, errors = np.array([2, 3, 4]), []
    for reach in reaches:
        lost, taken = opened("linear", 1.0 / reach, reach, dim, energy)
        assert lost == pytest.approx(taken, rel=1e-3)
        errors.append(abs(lost / energy - 1))
    half = opened("linear", 0.25, 2, dim, energy)[0]  # horizon and spacing
    assert half / energy - 1 == pytest.approx(-errors[0], rel=1e-2)
    assert errors[0] < (0.03 if dim == 2 else 0.065) and errors[-1] < 0.02
    assert fitted_rate(1 / reaches, errors) > 1.4


#: Largest stress of a bar of bonds over E s0, given in docs/explanation/fracture.md, by final over critical stretch.
STRENGTHS = {"linear": {2: 1.14, 5: 1.32, 10: 1.45}, "exponential": {2: 1.10, 5: 1.24, 10: 1.36}}


@pytest.mark.parametrize("softening", SOFTENINGS)
def test_oblique_bonds_bear_more_than_the_critical_stretch_tells(softening):
    """For all bonds of a lattice of reach 6 in space, strained uniformly along x, and along y and z so that there is
    no stress there.
    """
    stencil = (model := fh.Elastic(fh.Kernel(6.0, 1), 1.0)).stencil(1.0, 3)
    xi = stencil.offsets.astype(float)
    tensors = np.einsum("k,ka,kb->kab", model.bond_stiffness(stencil, 1.0) / (2 * (xi**2).sum(1)), xi, xi)
    along, across = xi[:, 0] ** 2 / (xi**2).sum(1), (xi[:, 1] ** 2 + xi[:, 2] ** 2) / (xi**2).sum(1)
    lengths = (xi**2).sum(1)

    def stresses(strain, contraction, bond):
        s = strain * along - contraction * across
        pulls = lengths * s * [bond.secant(one) for one in s]
        return (tensors[:, 0, 0] * pulls).sum(), (tensors[:, 1, 1] * pulls).sum()

    assert stresses(1e-3, 0.25e-3, Bond(softening, 1.0, 2.0)) == pytest.approx((1e-3, 0), rel=2e-3, abs=2e-6)
    for ratio, told in STRENGTHS[softening].items():
        bond, found = Bond(softening, 1.0, ratio), []
        for strain in np.linspace(1.0, 3.2, 45):
            free = brentq(lambda c, strain=strain, bond=bond: stresses(strain, c, bond)[1], -strain, strain)
            found.append(stresses(strain, free, bond)[0])
        assert max(found) == pytest.approx(told, rel=0.01)
        assert 0 < np.argmax(found) < len(found) - 1


@pytest.mark.slow
@pytest.mark.parametrize("softening", SOFTENINGS)
def test_a_straight_crack_spends_its_fracture_energy(softening):
    """Like a crack of brittle bonds (`test_breaking`), in a notched strip that is pulled at its edges: it runs at 0.4
    of the S wave speed and spends 3 % more than the fracture energy, on bonds beside its plane.
    """
    half, edge, energy = 20.0, 7.75, held(0.5, 2, 2)
    lattice = fh.Lattice(0.5, (-half, -edge), (half, edge))
    y = lattice.coordinates()[1]
    pull = np.stack([0 * y, np.sign(y) * (np.abs(y) > edge - 0.05)]) * 0.0024
    model = material(softening, energy, critical_stretch=ONSET / np.sqrt(2.5))
    source, notch = fh.Source(pull, lambda t: min(t / 40, 1.0)), [[-half - 1, 0], [-half / 2, 0]]
    sim = fh.Simulation(lattice, model, fh.Free(), sources=[source], cracks=[notch])
    rows = []
    for t in np.arange(40.0, 90.0):
        sim.run(t, progress=False)
        damage = sim.fields["damage"][:, lattice.shape[1] // 2]
        rows.append((lattice.axes[0][damage > 0.3].max(), sim.energies()["broken"]))
    tip, spent = np.array(rows).T
    running = (tip > -8) & (tip < 0)
    assert running.sum() > 10
    assert np.polyfit(tip[running], spent[running], 1)[0] == pytest.approx(energy, rel=0.06)


# --- energies, threads, checkpoints ----------------------------------------------------------------------------


def blast(lattice, strength=0.15, **options):
    """A closed box with an explosion in the middle."""
    x = np.stack(lattice.coordinates())
    source = fh.Source(strength * x * np.exp(-(x**2).sum(0)), lambda t: np.exp(-((t - 6) ** 2)))
    return {"sources": [source], "balance": True} | options


@pytest.mark.parametrize(("softening", "nonlinear"), [("linear", False), ("exponential", False), ("linear", True)])
@pytest.mark.parametrize("dim", [2, 3])
def test_energies_add_up(dim, softening, nonlinear):
    """With the linear elongation energies add up to rounding, whatever is loaded and unloaded; the load is 1e-16 at
    the start. Fracture energy and critical stretch vary, and a crack opens during the run.
    """
    half = 8.0 if dim == 2 else 4.0
    lattice = fh.Lattice(0.5, (-half,) * dim, (half,) * dim)
    crack = fh.Polyline([[-4, 0.3], [4, 0.3]]) if dim == 2 else fh.Rectangle([-2, -2, 0.3], [4, 0, 0], [0, 4, 0])
    energy = 2 * held(0.5, 2, dim, 0.02)
    given = {"critical_stretch": "0.015 + 0.005*cos(x)", "fracture_energy": f"{energy}*(1.2 + 0.1*sin(x))"}
    model = material(softening, nonlinear=nonlinear, dim=dim, **{"energy": energy} | given)
    sim = fh.Simulation(lattice, model, fh.Free(), cracks=[fh.Crack(crack, opens=9.0)], **blast(lattice, 0.3))
    for t in (6.0, 12.0, 18.0):
        sim.run(t, progress=False)
        found = sim.balance()
        assert abs(found["lost"]) < (0.01 if nonlinear else 1e-12) * found["work"]
    damage = sim.fields["damage"]
    assert ((damage > 0.05) & (damage < 0.95)).sum() > 50 and damage.max() <= 1
    assert found["broken"] > 0.05 * found["work"]


@pytest.mark.parametrize("softening", SOFTENINGS)
def test_threads_and_checkpoints_change_nothing(softening, tmp_path):
    """Two threads need 40 000 nodes; a crack opens between the checkpoint and the end."""
    lattice = fh.Lattice(0.5, (-52.0, -50.0), (52.0, 50.0))
    start = {"v": ["0.05*sin(3*x)*cos(2*y)", "0.05*cos(5*x*y)"]}
    model = material(softening, contact=True)
    cracks = [fh.Crack([(-9.0, 0.3), (9.0, 0.3)], opens=0.9)]
    one, two, resumed = (
        fh.Simulation(lattice, model, fh.Free(), start, cracks=cracks, balance=True, dt=0.1, threads=n)
        for n in (1, 2, 1)
    )
    one.step(6)
    one.save(tmp_path / "a.ckpt")
    resumed.load(tmp_path / "a.ckpt")
    restored = fh.Simulation.restore(tmp_path / "a.ckpt")
    for sim, steps in ((one, 9), (two, 15), (resumed, 9), (restored, 9)):
        sim.step(steps)
        for name in ("u", "damage"):
            np.testing.assert_array_equal(sim.fields[name], one.fields[name])
        assert sim.energies() == one.energies() and sim.balance() == one.balance()
    assert ((one.fields["damage"] > 0) & (one.fields["damage"] < 1)).sum() > 1000
    tougher = material(softening, 1.5 * model.fracture_energy, contact=True)
    other = fh.Simulation(lattice, tougher, fh.Free(), start, cracks=cracks, balance=True, dt=0.1)
    with pytest.raises(fh.FarhorizonError, match="softening"):
        other.load(tmp_path / "a.ckpt")


def test_a_crack_that_opens_elsewhere_leaves_what_has_softened():
    """The tiles in which bonds have softened remain known. A distant crack cuts none of their bonds, so nothing
    changes until its waves arrive.
    """
    lattice = fh.Lattice(0.5, (-20.0, -4.0), (20.0, 4.0))
    start = {"v": [0.0, "0.03*sin(2*y)*exp(-(x + 15)**2)"]}
    far = [fh.Crack([(15.0, -1.0), (15.0, 1.2)], opens=6.0)]
    runs = [fh.Simulation(lattice, material(), fh.Free(), start, cracks=cracks).run(9.0) for cracks in ([], far)]
    near = lattice.coordinates()[0] < -8
    one, two = (sim.fields["damage"][near] for sim in runs)
    assert (one > 0).sum() > 20 and runs[1].fields["damage"][~near].max() > 0.1
    np.testing.assert_array_equal(one, two)


@pytest.mark.slow  # like all tests of single precision
@pytest.mark.parametrize("softening", SOFTENINGS)
def test_single_precision(softening):
    """The fields agree to the precision of float32; softening multiplies errors, so far only a little here."""
    lattice = fh.Lattice(0.5, (-8.0, -8.0), (8.0, 8.0))
    runs = [
        fh.Simulation(lattice, material(softening), fh.Free(), dtype=real, **blast(lattice)).run(8.0)
        for real in ("float64", "float32")
    ]
    one, two = (sim.fields for sim in runs)
    assert one["damage"].max() > 0.1
    for name in ("u", "damage"):
        np.testing.assert_allclose(two[name], one[name], rtol=0, atol=1e-4 * np.abs(one[name]).max())


# --- cases and bad input ---------------------------------------------------------------------------------------

CASE = """
[lattice]
spacing = 0.5
lower = [-4.0, -4.0]
upper = [4.0, 4.0]
[model]
type = "elastic"
young = 1.0
critical_stretch = 0.01
fracture_energy = 1e-3
softening = "exponential"
kernel = { horizon = 1.0, exponent = 1 }
[[material]]
region = { box = { lower = [-4.0, -1.0], upper = [4.0, 0.0] } }
critical_stretch = 0.008
fracture_energy = "8e-4 + 1e-5*x"
[boundary]
all = { type = "free" }
[run]
until = 1.0
"""


def test_case_of_regions_that_soften():
    sim = Case(CASE).simulation()
    x, y = sim.lattice.coordinates()
    seam = (y >= -1) & (y <= 0)
    onset, energy = np.where(seam, 0.008, 0.01), np.where(seam, 8e-4 + 1e-5 * x, 1e-3)
    breaking = sim.parts.breaking
    np.testing.assert_allclose(breaking.critical_stretches, onset, rtol=1e-12)
    np.testing.assert_allclose(breaking.final_stretches, energy / onset / held(0.5, 2, 2, 1.0), rtol=1e-12)
    assert "soften exponentially from a stretch of 0.008 to 0.01" in " ".join(str(sim.check().details).split())


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"exponential"', '"bilinear"', "softening"),
        (
            "= 1e-3\n",
            "= 1e-5\n",
            r"model\.fracture_energy: bonds store more .* a horizon of about 0\.\d+ times this one",
        ),
        ('"8e-4 + 1e-5*x"', '"2e-4*x"', "must be positive at every node"),
        ("= 0.01\n", "= -0.01\n", r"model\.critical_stretch: the critical_stretch must be positive"),
        (
            "young = 1.0",
            'young = 1.0\npoisson = 0.3\nmaterial = "state-based"',
            "bonds of this material have no softening",
        ),
    ],
)
def test_bad_cases_that_soften(old, new, words):
    assert CASE.count(old) == 1
    with pytest.raises(fh.InputError, match=words):
        Case(CASE.replace(old, new)).simulation()


@pytest.mark.parametrize("given", [{"critical_stretch": 0.1}, {"fracture_energy": 1.0}, {}])
def test_what_softens_has_a_critical_stretch_and_a_fracture_energy(given):
    with pytest.raises(fh.InputError, match=r"model\.softening: bonds that soften have a critical stretch"):
        fh.Elastic(fh.Kernel(1.0, 1), 1.0, softening="linear", **given)


def test_the_horizon_that_the_remedy_names_does():
    """The longer the bonds, the more energy they store."""
    lattice = fh.Lattice(0.25, (-4.0, -4.0), (4.0, 4.0))
    energy = held(0.25, 8, 2)

    def make(reach):
        return fh.Simulation(lattice, material(energy=0.5 * energy, spacing=0.25, reach=reach), fh.Free())

    with pytest.raises(fh.InputError, match=r"a horizon of about 0\.5 times this one, or .* at most 0\.707 times"):
        make(8)
    assert make(3.9).broken_bonds == 0

"""Sweeps of bonds that have a law of their own and break, against plain numpy, bond by bond."""

import numpy as np
import pytest

from farhorizon import Elastic, Fixed, Free, Kernel, LatticePML, Periodic, Simulation, Source
from farhorizon.engine.codegen.bond_sweeps import SOFTENINGS
from farhorizon.medium.fracture import fracture_energy
from helpers import RULES, lattice_of

LAWS = {"linear": False, "nonlinear": True}


class PairByPair:
    """The same medium with one entry per ordered pair of nodes, with free ends or with nodes at rest beyond fixed
    ones.

    Bonds of nodes within one reach of a fixed side are linear and do not break. For bonds that soften, the largest
    stretch so far lies on the curve of the law, and they unload from there to the origin.
    """

    def __init__(self, sim, held=False, coefficient=None, rule="both", strength=None, final=None, energy=None):
        model, lattice = sim.model, sim.lattice
        reach = sim.stencil.reach[0] if held else 0
        shape = np.array(lattice.shape) + 2 * reach
        index = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), -1).reshape(-1, lattice.dim)
        inner = ((index >= reach) & (index < shape - reach)).all(1)
        free = ((index >= 2 * reach) & (index < shape - 2 * reach)).all(1)
        around = max(sim.stencil.reach)
        number = np.pad(np.arange(len(index)).reshape(shape), around, constant_values=-1)
        neighbours = np.stack([number[tuple((index + around + o).T)] for o in sim.stencil.offsets], -1)
        self.i, bond = np.nonzero(neighbours >= 0)
        self.j = neighbours[self.i, bond]
        self.c = model.bond_stiffness(sim.stencil, lattice.spacing)[bond] / model.density
        if coefficient is not None:
            factor = np.pad(coefficient, reach, mode="edge").ravel()
            factor = RULES[rule](factor[self.i], factor[self.j])
            self.c *= factor
        self.xi = lattice.spacing * (index[self.j] - index[self.i]).astype(float)
        self.length = np.linalg.norm(self.xi, axis=1)
        self.law, self.inner = free[self.i] & free[self.j], inner
        self.alive = np.ones(len(self.i), bool)
        self.nonlinear, self.contact, self.limit, self.dt = (
            model.nonlinear,
            model.contact,
            model.critical_stretch_on(lattice.spacing, lattice.dim),
            sim.dt,
        )
        if strength is not None:
            stretch = np.pad(strength, reach, mode="edge").ravel()
            self.limit = np.minimum(stretch[self.i], stretch[self.j])
        if energy is not None:
            energy = np.pad(energy, reach, mode="edge").ravel()
            self.limit = np.sqrt(np.minimum(energy[self.i], energy[self.j]) / (held_at(1.0, lattice.dim) * factor))
        self.softening, self.largest = model.softening, np.zeros(len(self.i))
        if self.softening:
            final = np.pad(np.broadcast_to(final, lattice.shape), reach, mode="edge").ravel()
            self.final = np.minimum(final[self.i], final[self.j])
        self.shape, self.dim = lattice.shape, lattice.dim
        u, v = (self._spread(x) for x in (sim.start_u, sim.start_v))
        self.old, self.u = u - self.dt * v + self.dt**2 / 2 * self.acceleration(u), u

    def _spread(self, values):
        out = np.zeros((len(self.inner), self.dim))
        out[self.inner] = np.reshape(values, (self.dim, -1)).T
        return out

    def acceleration(self, u):
        eta = u[self.j] - u[self.i]
        n = self.xi / self.length[:, None]
        stretch, direction = (n * eta).sum(1), n
        if self.nonlinear:
            y = self.xi + eta
            size = np.linalg.norm(y, axis=1)
            stretch = np.where(self.law, size - self.length, stretch)
            direction = np.where(self.law[:, None], y / size[:, None], n)
        left = np.where(self.law & self.contact & (stretch < 0), 1.0, self.left(stretch / self.length))
        out = np.zeros_like(u)
        np.add.at(out, self.i, (left * self.c * stretch)[:, None] * direction)
        return out * self.inner[:, None]

    def left(self, stretch):
        """What is left of the stiffness of bonds once they have had these stretches."""
        if not self.softening:
            self.alive &= ~(self.law & (stretch > self.limit))
            return self.alive
        self.largest = np.maximum(self.largest, self.law * stretch)
        return self.secant(self.largest)

    def secant(self, stretch):
        """Force over stretch on the curve of the law, relative to that of an intact bond."""
        onset, width = self.limit, self.final - self.limit
        if self.softening == "linear":
            force = onset * np.clip((self.final - stretch) / width, 0, None)
            self.alive = stretch < self.final
        else:
            force = onset * np.exp(-(stretch - onset) / (width / 2))
        return np.where(stretch > onset, force / np.maximum(stretch, onset), 1.0)

    def step(self):
        self.old, self.u = self.u, 2 * self.u - self.old + self.dt**2 * self.acceleration(self.u)

    @property
    def field(self):
        return self.u[self.inner].T.reshape(self.dim, *self.shape)

    @property
    def bonds_left(self):
        left = self.secant(self.largest) if self.softening else self.alive
        return np.bincount(self.i, left, len(self.inner))[self.inner].reshape(self.shape)


def shaken(shape, nonlinear, sides=None, reach=2, speed=0.03, strength=0.04, contact=False, law=None, **options):
    """A box whose nodes start with random velocities, so that bonds break here and there."""
    dim = len(shape)
    v = speed * np.random.default_rng(5).standard_normal((dim, *shape))
    given = {"nonlinear": nonlinear, "critical_stretch": strength, "contact": contact}
    model = Elastic(Kernel(0.5 * reach, 1), 1.0, **given, **(law or {}))
    return Simulation(lattice_of(shape, 0.5), model, sides or Free(), {"v": v}, **options)


def assert_both_break_alike(sim, plain):
    """After 40 steps the displacements agree to rounding, and the same bonds are broken. The remaining shares of bonds
    that soften follow from strains, whose rounding is amplified by the slope of the law.
    """
    for _ in range(40):
        plain.step()
    sim.step(40)
    np.testing.assert_allclose(sim.fields["u"], plain.field, rtol=0, atol=1e-12 * np.abs(plain.field).max())
    rounding = 1e-11 if plain.softening else 0
    np.testing.assert_allclose(sim.parts.breaking.left(), plain.bonds_left, rtol=0, atol=rounding)
    assert sim.broken_bonds == (~plain.alive).sum() // 2
    assert (sim.broken_bonds > 20) == (plain.softening != "exponential")  # these never break


@pytest.mark.parametrize("nonlinear", LAWS.values(), ids=LAWS)
@pytest.mark.parametrize("held", [False, True], ids=["free", "fixed"])
@pytest.mark.parametrize("shape", [(13, 19), (9, 7, 8)], ids=["2D", "3D"])
def test_bonds_break_as_one_by_one(shape, held, nonlinear):
    """Rows and planes that are not multiples of a tile."""
    sim = shaken(shape, nonlinear, Fixed() if held else None, reach=1 if held and len(shape) == 3 else 2)
    plain = PairByPair(sim, held)
    assert_both_break_alike(sim, plain)


@pytest.mark.parametrize("nonlinear", LAWS.values(), ids=LAWS)
@pytest.mark.parametrize(("held", "rule"), [(False, "both"), (True, "arithmetic"), (False, "harmonic")])
@pytest.mark.parametrize("shape", [(13, 19), (9, 7, 8)], ids=["2D", "3D"])
def test_bonds_of_coefficients_that_vary(shape, held, rule, nonlinear):
    """With a factor of each bond from those of its ends, some of them zero."""
    coefficient = np.maximum(np.random.default_rng(8).random(shape) * 1.3 - 0.1, 0)
    reach = 1 if held and len(shape) == 3 else 2
    sim = shaken(shape, nonlinear, Fixed() if held else None, reach, coefficient=coefficient, rule=rule)
    plain = PairByPair(sim, held, coefficient, rule)
    assert_both_break_alike(sim, plain)


@pytest.mark.parametrize(("shape", "held", "nonlinear"), [((13, 19), False, False), ((9, 7, 8), True, True)])
def test_bonds_of_strengths_that_vary(shape, held, nonlinear):
    """With a strength for each node, of which the weaker one of a bond counts."""
    strength = np.random.default_rng(9).uniform(0.02, 0.08, shape)
    reach = 1 if held and len(shape) == 3 else 2
    sim = shaken(shape, nonlinear, Fixed() if held else None, reach, strength=strength)
    plain = PairByPair(sim, held, strength=strength)
    assert_both_break_alike(sim, plain)
    assert sim.broken_bonds != shaken(shape, nonlinear, Fixed() if held else None, reach).run(sim.time).broken_bonds


@pytest.mark.parametrize("rule", ["both", "arithmetic", "harmonic"])
@pytest.mark.parametrize(("shape", "held", "nonlinear"), [((13, 19), False, False), ((9, 7, 8), True, True)])
def test_bonds_of_fracture_energies_and_stiffnesses_that_vary(shape, held, nonlinear, rule):
    """A bond takes the energy of its weaker end, whatever its stiffness."""
    rng, dim = np.random.default_rng(9), len(shape)
    energy, coefficient = held_at(0.03, dim) * rng.uniform(1, 4, shape), rng.uniform(0.3, 3.0, shape)
    options = {"coefficient": coefficient, "rule": rule, "law": {"fracture_energy": energy}, "strength": None}
    sim = shaken(shape, nonlinear, Fixed() if held else None, **options)
    assert_both_break_alike(sim, PairByPair(sim, held, coefficient, rule, energy=energy))


@pytest.mark.parametrize(("shape", "held", "nonlinear"), [((13, 19), True, False), ((9, 7, 8), False, True)])
def test_broken_bonds_that_carry_compression(shape, held, nonlinear):
    """With and without contact; with the linear law it has to be requested."""
    runs = []
    for contact in (True, False):
        sim = shaken(shape, nonlinear, Fixed() if held else None, contact=contact)
        plain = PairByPair(sim, held)
        assert_both_break_alike(sim, plain)
        runs.append(sim.fields["u"])
    assert np.abs(runs[0] - runs[1]).max() > 1e-6


def held_at(stretch, dim, spacing=0.5, reach=2):
    """Energy per area of the bonds across a plane at a given stretch. A bond that softens linearly up to a multiple of
    this stretch takes that multiple of the energy.
    """
    model = Elastic(Kernel(spacing * reach, 1), 1.0)
    stencil = model.stencil(spacing, dim)
    return fracture_energy(spacing * stencil.offsets, model.bond_stiffness(stencil, spacing), stretch)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("contact", [False, True], ids=["apart", "contact"])
@pytest.mark.parametrize("nonlinear", LAWS.values(), ids=LAWS)
@pytest.mark.parametrize("softening", SOFTENINGS)
@pytest.mark.parametrize(("shape", "held"), [((13, 19), True), ((9, 7, 8), False)], ids=["2D", "3D"])
def test_bonds_soften_as_one_by_one(shape, held, softening, nonlinear, contact):
    """Bonds are loaded, unloaded and loaded again by the waves in the box."""
    law = {"softening": softening, "fracture_energy": 2.5 * held_at(0.03, len(shape))}
    sim = shaken(shape, nonlinear, Fixed() if held else None, speed=0.06, strength=0.03, contact=contact, law=law)
    plain = PairByPair(sim, held, final=2.5 * 0.03)
    assert_both_break_alike(sim, plain)
    left = plain.secant(plain.largest)
    assert ((left > 0.02) & (left < 0.98)).sum() > 200


@pytest.mark.parametrize(("shape", "nonlinear", "rule"), [((13, 19), True, "harmonic"), ((9, 7, 8), False, "both")])
def test_bonds_that_soften_where_all_varies(shape, nonlinear, rule):
    """Stiffness, critical stretch and fracture energy vary from node to node. The smaller limits of a bond count, each
    of which may be that of the other end.
    """
    random = np.random.default_rng(9)
    onset, more, coefficient = (random.uniform(*ends, shape) for ends in ((0.02, 0.05), (1.2, 4.0), (0.5, 1.0)))
    law = {"softening": "linear", "fracture_energy": held_at(1.0, len(shape)) * coefficient * more * onset**2}
    options = {"coefficient": coefficient, "rule": rule}
    sim = shaken(shape, nonlinear, speed=0.08, strength=onset, law=law, **options)
    assert_both_break_alike(sim, PairByPair(sim, strength=onset, final=more * onset, **options))


@pytest.mark.parametrize("softening", SOFTENINGS)
def test_bonds_that_end_where_they_begin_to_soften_break_at_once(softening):
    """In the brittle limit the same bonds break, and the fields agree to rounding."""
    energy = held_at(0.03, 2) * (1 + 1e-12)
    runs = [
        shaken((23, 31), True, strength=0.03, law=law)
        for law in ({}, {"softening": softening, "fracture_energy": energy})
    ]
    for sim in runs:
        sim.step(40)
    first, second = runs
    assert first.broken_bonds == second.broken_bonds > 20
    np.testing.assert_allclose(first.fields["u"], second.fields["u"], rtol=0, atol=1e-13)
    np.testing.assert_array_equal(first.fields["damage"], second.fields["damage"])
    assert first.energies() == pytest.approx(second.energies(), rel=1e-10)


@pytest.mark.parametrize("nonlinear", LAWS.values(), ids=LAWS)
def test_periodic_box_is_the_same_wherever_it_is_cut(nonlinear):
    """Bonds across periodic sides follow the law and break: a shifted start gives the shifted result, bitwise."""
    v = 0.03 * np.random.default_rng(2).standard_normal((2, 20, 24))
    model = Elastic(Kernel(1.0, 1), 1.0, nonlinear=nonlinear, critical_stretch=0.04)
    results = []
    for shift in ((0, 0), (7, 5)):
        sim = Simulation(lattice_of((20, 24), 0.5), model, Periodic(), {"v": np.roll(v, shift, (1, 2))})
        sim.step(40)
        results.append([np.roll(sim.fields[name], (-shift[0], -shift[1]), (-2, -1)) for name in ("u", "damage")])
        assert sim.broken_bonds > 20
    for first, second in zip(*results, strict=True):
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("shape", [(210, 200), (36, 34, 35)], ids=["2D", "3D"])
def test_threads_agree_to_the_last_bit(shape):
    """Fields, damage and energies; the lattices are large enough for two threads (40 000 nodes)."""
    single, pair = (shaken(shape, True, LatticePML(nodes=4), threads=n) for n in (1, 2))
    for sim in (single, pair):
        sim.step(12)
    assert single.broken_bonds > 1000
    for name in ("u", "damage"):
        np.testing.assert_array_equal(single.fields[name], pair.fields[name])
    assert single.energies() == pair.energies()


def test_threads_agree_on_the_work_of_sources():
    """No thread overwrites a level whose work another thread is still adding up."""
    shape, works = (210, 200), []
    field = np.random.default_rng(4).standard_normal((2, *shape))
    for threads in (1, 2):
        model = Elastic(Kernel(1.0, 1), 1.0)
        sources = [Source(field, "sin(3*t)")]
        sim = Simulation(lattice_of(shape, 0.5), model, Free(), sources=sources, balance=True, threads=threads)
        sim.step(60)
        works.append(sim.engine.tables.work)
    np.testing.assert_array_equal(*works)


@pytest.mark.slow  # single precision, for which few runs share the kernels: these compile for long
@pytest.mark.parametrize("nonlinear", LAWS.values(), ids=LAWS)
def test_single_precision(nonlinear):
    """A run without breaking agrees to the precision of float32."""
    runs = [shaken((17, 21), nonlinear, speed=0.003, dtype=real) for real in ("float64", "float32")]
    for sim in runs:
        sim.step(30)
    u, v = (sim.fields["u"] for sim in runs)
    np.testing.assert_allclose(v, u, rtol=0, atol=1e-4 * np.abs(u).max())
    assert runs[0].broken_bonds == runs[1].broken_bonds == 0


def test_a_plain_tile_and_one_looked_at_bond_by_bond_give_the_same():
    """Plain tiles only save time: marking all tiles as damaged changes nothing but rounding."""
    plain, marked = (shaken((30, 41), True, speed=0.01) for _ in range(2))
    marked.engine.tables.bonds.kinds[...] = 1
    for sim in (plain, marked):
        sim.step(40)
    np.testing.assert_allclose(plain.fields["u"], marked.fields["u"], rtol=0, atol=1e-13)
    assert (plain.engine.tables.bonds.kinds == 0).any()


def test_masks_cost_a_word_of_bits_for_64_bonds():
    """With 122 neighbours the masks take two words per node, compared with three components of each of three levels;
    kinds of tiles and records of energy take a few per cent of that.
    """
    model = Elastic(Kernel(3.0, 1, volume="full"), 1.0, nonlinear=True, critical_stretch=0.1)
    sim = Simulation(lattice_of((20, 20, 20)), model, Free())
    state, level = sim.engine.bonds.state, sim.engine.levels[0].nbytes
    assert len(sim.stencil.weights) == 122
    assert state["bonds"].nbytes < 2 / 3 * level
    assert sum(array.nbytes for array in state.values()) < 0.75 * level


@pytest.mark.parametrize("shape", [(60, 150), (26, 57, 40)], ids=["2D", "3D"])
def test_calm_pieces_are_swept_by_the_stencil(shape):
    """Where the slopes bound every stretch below the critical one, the linear law uses the plain stencil. With a bound
    of zero only rounding changes, and the same bonds break.
    """
    x = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"))
    bump = np.exp(-sum((c - n / 3) ** 2 for c, n in zip(x, shape, strict=True)) / 20)
    model = Elastic(Kernel(1.0, 1), 1.0, critical_stretch=0.05)
    runs = [
        Simulation(lattice_of(shape, 0.5), model, Free(), {"v": np.stack([0.4 * bump] * len(shape))}, threads=1)
        for _ in range(2)
    ]
    runs[1].engine.tables.bonds.limit[1] = 0
    for sim in runs:
        sim.step(25)
    first, second = (sim.fields for sim in runs)
    np.testing.assert_allclose(first["u"], second["u"], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(first["damage"], second["damage"])
    assert 0 < runs[0].broken_bonds
    assert (first["u"] != second["u"]).any()  # the two paths are not the same

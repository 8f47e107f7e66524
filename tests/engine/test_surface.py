"""Bonds that end where there is no node: free sides and holes against sums over bonds, invariants, layers, threads."""

import time

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.engine.absent import AbsentBonds
from farhorizon.engine.engine import available_threads
from farhorizon.engine.state import State
from helpers import RULES, dense_operator, engine_apply, kernel_stencil, lattice_of

SHAPES = {1: (19,), 2: (13, 15), 3: (8, 7, 9)}
HOLES = {
    1: fh.Box((-9.0,), (20.0,)) - fh.Box((8.6,), (12.2,)),
    2: fh.Box((-9.0, -9.0), (30.0, 30.0)) - fh.Disc(2.6, (6.2, 7.1)),
    3: fh.Box((-9.0,) * 3, (30.0,) * 3) - fh.Ball(1.8, (3.6, 3.2, 4.3)),
}


def padded(sides, value, u, there, factor, reach):
    """Field, existence and coefficient, padded with what lies beyond the sides."""
    for axis, side in enumerate(sides):
        m = [(0, 0)] * u.ndim
        m[u.ndim - len(sides) + axis] = (reach[axis],) * 2
        own = m[u.ndim - len(sides) :]
        u = (
            np.pad(u, m, mode="wrap")
            if side == "periodic"
            else np.pad(u, m, constant_values=value if side == "fixed" else 0.0)
        )
        there = (
            np.pad(there, own, constant_values=False)
            if side == "free"
            else np.pad(there, own, mode="wrap" if side == "periodic" else "edge")
        )
        factor = np.pad(factor, own, mode="wrap" if side == "periodic" else "edge")
    return u, there, factor


def bond_by_bond(u, stencil, sides, value, there, factor, rule):
    """The operator as a sum over the bonds between existing nodes."""
    wide, exists, material = padded(sides, value, u, there, factor, stencil.reach)
    total, shape = np.zeros(u.shape), there.shape
    for offset, weight in zip(stencil.offsets, stencil.weights, strict=True):
        at = tuple(slice(m + o, m + o + n) for m, o, n in zip(stencil.reach, offset, shape, strict=True))
        difference = RULES[rule](factor, material[at]) * (there & exists[at]) * (wide[(..., *at)] - u)
        total += weight * difference if np.ndim(weight) == 0 else np.tensordot(weight, difference, 1)
    return total


@pytest.mark.parametrize("seed", range(16))
def test_the_operator_is_the_sum_over_the_bonds_that_are_there(seed):
    """Random sides, holes, coefficients and fields, including a fixed value beside free sides and holes."""
    random = np.random.default_rng(seed)
    dim = seed % 3 + 1
    sides = random.choice(["free", "free", "fixed", "periodic"], dim)
    lattice = lattice_of(SHAPES[dim])
    vector = dim == 2 and random.random() < 0.5
    hole = random.random() < 0.6 and "periodic" not in sides
    if hole:
        lattice = fh.Lattice(1.0, lattice.lower, lattice.upper, body=HOLES[dim])
    there = np.ones(lattice.shape, bool) if lattice.mask is None else lattice.mask
    rule = random.choice(list(RULES)) if random.random() < 0.5 else None
    factor = np.ones(lattice.shape) if rule is None else random.uniform(0.2, 3.0, lattice.shape)
    value = 0.0 if vector else 0.7
    model = fh.Elastic(fh.Kernel(2.0), 1.0) if vector else fh.Wave(kernel_stencil(dim, 2))
    u = there * random.standard_normal((2, *lattice.shape) if vector else lattice.shape)
    boundary = {
        "xyz"[a]: {"free": fh.Free(), "fixed": fh.Fixed(value), "periodic": fh.Periodic()}[s]
        for a, s in enumerate(sides)
    }
    sim = fh.Simulation(
        lattice, model, boundary, {"u": u}, coefficient=None if rule is None else factor, rule=rule or "both"
    )
    expected = (
        bond_by_bond(u, sim.stencil, sides, value, there, np.where(there, factor, 0.0), rule or "both")
        * sim.model.coefficient
    )
    got = sim.engine.core.view(sim.engine.apply(sim.engine.current)).reshape(u.shape)
    scale = np.abs(sim.engine.weights).sum() * factor.max()
    np.testing.assert_allclose(np.where(there, got, 0.0), expected, rtol=0, atol=1e-13 * scale)


def listed(set_cuts):
    """`AbsentBonds.set` with every bond to a place without a node in the list of cuts."""

    def with_list(self, nodes, neighbours, weights, exists=None):
        set_cuts(self, nodes, neighbours, weights, exists)
        if exists is None:
            return
        outside, kept = self.outside, exists[nodes] & exists[neighbours]
        found = [(nodes[kept], neighbours[kept], weights[kept])]
        engine = self.engine
        flat = engine.layout.box.node_indices()
        for offset, weight in zip(engine.offsets, engine.weights, strict=True):
            other = flat + int(offset @ np.array(engine.layout.box.stride))
            bare = exists[flat] != exists[other]
            found.append((flat[bare], other[bare], np.repeat(np.asarray(weight)[None], int(bare.sum()), axis=0)))
        set_cuts(self, *(np.concatenate([f[i] for f in found]) for i in range(3)))
        self.outside = outside

    return with_list


PLATE = fh.Lattice(1.0, (0.0, 0.0), (14.0, 12.0), body=HOLES[2])
NOTCHED = fh.Lattice(1.0, (0.0, 0.0), (14.0, 12.0), body=fh.Box((-9.0, -9.0), (30.0, 6.5)) - fh.Disc(2.4, (6.2, 2.1)))
CRACK = {"cracks": [[(-9.0, 4.4), (4.4, 4.4)]]}
HALF_OPEN = {"x": fh.LatticePML(nodes=4), "y-": fh.LatticePML(nodes=3), "y+": fh.Free()}
FACES = {"x": fh.Free(), "y": fh.LatticePML(nodes=3), "z": fh.Free()}
LAYERS = {"x": fh.LatticePML(nodes=4), "y": fh.Free()}
SETUPS = {
    "hole": (PLATE, fh.Wave(fh.Kernel(2.0)), fh.Free(), {}),
    "hole, elastic": (PLATE, fh.Elastic(fh.Kernel(2.0), 1.0), fh.Free(), {"cracks": [[(1.4, 2.2), (1.4, 9.8)]]}),
    "faces into layers": (lattice_of((15, 13)), fh.Wave(fh.Kernel(2.0)), LAYERS, CRACK),
    "faces into layers, elastic": (lattice_of((15, 13)), fh.Elastic(fh.Kernel(2.0), 1.0), LAYERS, CRACK),
    "body into layers": (NOTCHED, fh.Elastic(fh.Kernel(2.0), 1.0), HALF_OPEN, {}),
    "layers on one axis of three": (lattice_of((7, 6, 7)), fh.Wave(fh.Kernel(2.0)), FACES, {}),
    "coefficients": (
        lattice_of((15, 13)),
        fh.Wave(fh.Kernel(2.0)),
        LAYERS,
        {"coefficient": np.linspace(0.5, 2.0, 13) * np.ones((15, 1)), "rule": "harmonic"},
    ),
    "sponge": (NOTCHED, fh.Wave(fh.Kernel(2.0)), {"x": fh.Sponge(4), "y": fh.Free()}, {}),
    "runge-kutta": (PLATE, fh.Diffusion(fh.Kernel(2.0), integrator="rk4"), {"x": fh.Periodic(), "y": fh.Free()}, {}),
    "chebyshev": (PLATE, fh.Diffusion(fh.Kernel(2.0), integrator="rkc"), fh.Free(), {}),
    "single precision": (PLATE, fh.Wave(fh.Kernel(2.0)), LAYERS, {"dtype": "float32"}),
}


@pytest.mark.parametrize("name", SETUPS)
def test_a_run_is_that_of_a_list_of_bonds(name, monkeypatch):
    """One number per node restores the same as a list of its absent bonds; two threads agree bitwise with one."""
    monkeypatch.setattr("farhorizon.engine.engine._PARALLEL_NUMBERS", 0)
    monkeypatch.setattr("farhorizon.simulation.setup.setup.available_threads", lambda: 2)
    lattice, model, boundary, rest = SETUPS[name]
    shape = (lattice.dim, *lattice.shape) if isinstance(model, fh.Elastic) else lattice.shape
    start = {"u": np.random.default_rng(4).standard_normal(shape)}
    one, two = (fh.Simulation(lattice, model, boundary, start, threads=n, **rest) for n in (1, 2))
    monkeypatch.setattr(AbsentBonds, "set", listed(AbsentBonds.set))
    bonds = [fh.Simulation(lattice, model, boundary, start, threads=n, **rest) for n in (1, 2)]
    assert not bonds[0].engine.tables.surface.stretches.size and one.engine.tables.surface.stretches.size
    assert bonds[0].engine.absent.count == one.engine.absent.count
    for sim in (one, two, *bonds):
        sim.step(30)
    scale = np.abs(one.fields["u"][np.isfinite(one.fields["u"])]).max()
    tolerance = 2e-4 if rest.get("dtype") else 1e-12
    np.testing.assert_allclose(one.fields["u"], bonds[0].fields["u"], rtol=0, atol=tolerance * scale)
    np.testing.assert_array_equal(one.engine.levels, two.engine.levels)
    np.testing.assert_array_equal(bonds[0].engine.levels, bonds[1].engine.levels)
    nodes = one.engine.layout.box.node_indices()
    for level in one.engine.levels:
        assert not level.reshape(one.engine.components, -1)[:, nodes[~one.engine.absent.exists[nodes]]].any()


def test_a_free_body_with_a_hole_keeps_energy_and_momenta():
    """Energy, linear and angular momentum are conserved, and rigid motions, rotations to first order, cause no
    strain.
    """
    sim = fh.Simulation(
        PLATE,
        fh.Elastic(fh.Kernel(2.0), 1.0),
        fh.Free(),
        {"u": np.random.default_rng(1).standard_normal((2, *PLATE.shape))},
    )
    x, y = PLATE.coordinates()
    for motion in ((1 + 0 * x, 0 * x), (0 * x, 1 + 0 * x), (-y, x)):
        force = engine_apply(sim.engine, np.where(PLATE.mask, motion, 0.0))
        assert np.abs(force[:, PLATE.mask]).max() <= 1e-13 * np.abs(sim.engine.weights).sum() * np.abs(motion).max()
    kept = []
    for _ in range(2):
        sim.step(400)
        vx, vy = (np.where(PLATE.mask, v, 0.0) for v in sim.fields["v"])
        kept.append([sim.energy(), vx.sum(), vy.sum(), (x * vy - y * vx).sum()])
    scale = [kept[0][0], *[np.abs(vx).sum()] * 2, (np.abs(x * vy) + np.abs(y * vx)).sum()]
    for value, before, size in zip(*reversed(kept), scale, strict=True):
        assert value == pytest.approx(before, rel=0, abs=1e-12 * size)


def test_heat_of_a_body_beside_a_warm_side():
    """The warm side heats only the body, not what lies outside it; the balance closes with the heat of the body."""
    lattice = fh.Lattice(1.0, (0.0, 0.0), (14.0, 12.0), body=fh.Disc(7.2, (7.0, 6.0)))
    sides = {"x-": fh.Fixed(1.0), "x+": fh.Free(), "y": fh.Free()}
    sim = fh.Simulation(lattice, fh.Diffusion(kernel_stencil(2, 2)), sides, balance=True, sources=[fh.Source(0.01)])
    sim.step(300)
    found = sim.balance()
    assert found["stored"] == pytest.approx(sim.fields["u"][lattice.mask].sum(), rel=1e-12) and found["x-"] > 1
    assert abs(found["residual"]) < 1e-12 * found["stored"]


def test_a_state_has_the_nodes_that_exist():
    """Any state advances as the body alone does: two steps of the engine equal those of the matrix of its bonds."""
    sim = fh.Simulation(PLATE, fh.Wave(kernel_stencil(2, 2)), fh.Free(), threads=1)
    state = State(sim.engine)
    assert state.size == 2 * PLATE.nodes
    there = PLATE.mask
    matrix = dense_operator(
        there.shape, sim.stencil.offsets, sim.stencil.weights, lambda i, j: there[tuple(i.T)] & there[tuple(j.T)]
    )
    inner = matrix[np.ix_(there.ravel(), there.ravel())]
    u, old = np.random.default_rng(2).standard_normal((2, PLATE.nodes))
    got = state.after(np.concatenate([u, old]), 2)
    for _ in range(2):
        u, old = 2 * u - old + sim.dt**2 * (inner @ u), u
    np.testing.assert_allclose(got, np.concatenate([u, old]), rtol=0, atol=1e-12)


def test_faces_of_a_box_hold_little():
    """Identical rows share their weights, so that a node near a face takes a dozen bytes rather than one entry per
    bond.
    """
    lattice = lattice_of((40, 40, 40))
    free, fixed = (fh.Simulation(lattice, fh.Wave(kernel_stencil(3, 2)), side) for side in (fh.Free(), fh.Fixed()))
    near = 40**3 - 36**3
    assert free.engine.absent.count > 10 * near
    assert (free.engine.nbytes - fixed.engine.nbytes) / near < 12


@pytest.mark.slow
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize(
    "make", [lambda: fh.Wave(fh.Kernel(3.0)), lambda: fh.Elastic(fh.Kernel(2.0), 1.0)], ids=["scalar", "elastic"]
)
def test_free_faces_cost_little(make, threads):
    """With six free faces a step of a box of 80^3 nodes takes less than 1.3 times as long as with fixed ones."""
    lanes = min(threads, available_threads())
    sims = [fh.Simulation(lattice_of((80,) * 3), make(), side, threads=lanes) for side in (fh.Free(), fh.Fixed())]
    ratios = []
    for _ in range(12):
        seconds = []
        for sim in sims:
            begin = time.process_time()  # processor time, whatever else the machine does
            sim.step(8)
            seconds.append(time.process_time() - begin)
        ratios.append(seconds[0] / seconds[1])
    assert np.median(ratios[1:]) < 1.3

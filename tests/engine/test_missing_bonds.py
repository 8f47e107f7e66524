"""Bonds that end where there is no node: free sides and holes against sums over bonds, invariants, layers, threads; the
law of nodes that lack bonds, row by row, against their matrices node by node.
"""

import os
import time

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.engine.codegen.build import load_rows
from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.codegen.matrices import call_map
from farhorizon.engine.engine import available_threads
from farhorizon.engine.missing_bonds import AbsentBonds, law_rows
from farhorizon.engine.point_law import ALIKE, EACH
from farhorizon.engine.state import State
from helpers import RULES, dense_operator, engine_apply, kernel_stencil, lattice_of

SEED = int(os.environ.get("FARHORIZON_SEED", np.random.SeedSequence().entropy % 2**32))
SHAPES = {1: (19,), 2: (13, 15), 3: (8, 7, 9)}
HOLES = {
    1: fh.Box((-9.0,), (20.0,)) - fh.Box((8.6,), (12.2,)),
    2: fh.Box((-9.0, -9.0), (30.0, 30.0)) - fh.Disc(2.6, (6.2, 7.1)),
    3: fh.Box((-9.0,) * 3, (30.0,) * 3) - fh.Ball(1.8, (3.6, 3.2, 4.3)),
}


def padded(sides, value, u, exists, factor, reach):
    """Field, existence and coefficient, padded with what lies beyond the sides."""
    for axis, side in enumerate(sides):
        m = [(0, 0)] * u.ndim
        m[u.ndim - len(sides) + axis] = (reach[axis],) * 2
        margins = m[u.ndim - len(sides) :]
        u = (
            np.pad(u, m, mode="wrap")
            if side == "periodic"
            else np.pad(u, m, constant_values=value if side == "fixed" else 0.0)
        )
        exists = (
            np.pad(exists, margins, constant_values=False)
            if side == "free"
            else np.pad(exists, margins, mode="wrap" if side == "periodic" else "edge")
        )
        factor = np.pad(factor, margins, mode="wrap" if side == "periodic" else "edge")
    return u, exists, factor


def bond_by_bond(u, stencil, sides, value, inside, factor, rule):
    """The operator as a sum over the bonds between existing nodes."""
    wide, exists, material = padded(sides, value, u, inside, factor, stencil.reach)
    total, shape = np.zeros(u.shape), inside.shape
    for offset, weight in zip(stencil.offsets, stencil.weights, strict=True):
        at = tuple(slice(m + o, m + o + n) for m, o, n in zip(stencil.reach, offset, shape, strict=True))
        difference = RULES[rule](factor, material[at]) * (inside & exists[at]) * (wide[(..., *at)] - u)
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
    inside = np.ones(lattice.shape, bool) if lattice.mask is None else lattice.mask
    rule = random.choice(list(RULES)) if random.random() < 0.5 else None
    factor = np.ones(lattice.shape) if rule is None else random.uniform(0.2, 3.0, lattice.shape)
    value = 0.0 if vector else 0.7
    model = fh.Elastic(fh.Kernel(2.0), 1.0) if vector else fh.Wave(kernel_stencil(dim, 2))
    u = inside * random.standard_normal((2, *lattice.shape) if vector else lattice.shape)
    boundary = {
        "xyz"[a]: {"free": fh.Free(), "fixed": fh.Fixed(value), "periodic": fh.Periodic()}[s]
        for a, s in enumerate(sides)
    }
    sim = fh.Simulation(
        lattice, model, boundary, {"u": u}, coefficient=None if rule is None else factor, rule=rule or "both"
    )
    expected = (
        bond_by_bond(u, sim.stencil, sides, value, inside, np.where(inside, factor, 0.0), rule or "both")
        * sim.model.coefficient
    )
    got = sim.engine.core.view(sim.engine.apply(sim.engine.current)).reshape(u.shape)
    scale = np.abs(sim.engine.weights).sum() * factor.max()
    np.testing.assert_allclose(np.where(inside, got, 0.0), expected, rtol=0, atol=1e-13 * scale)


def listed(set_cuts):
    """`AbsentBonds.set` with every bond to a place without a node in the list of cuts."""

    def with_list(self, nodes, neighbours, weights, exists=None):
        set_cuts(self, nodes, neighbours, weights, exists)
        if exists is None:
            return
        outside, kept = self.outside, exists[nodes] & exists[neighbours]
        cuts = [(nodes[kept], neighbours[kept], weights[kept])]
        engine = self.engine
        flat = engine.layout.box.node_indices()
        for offset, weight in zip(engine.offsets, engine.weights, strict=True):
            neighbour = flat + int(offset @ np.array(engine.layout.box.stride))
            bare = exists[flat] != exists[neighbour]
            cuts.append((flat[bare], neighbour[bare], np.repeat(np.asarray(weight)[None], int(bare.sum()), axis=0)))
        set_cuts(self, *(np.concatenate([f[i] for f in cuts]) for i in range(3)))
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
    single, double = (fh.Simulation(lattice, model, boundary, start, threads=n, **rest) for n in (1, 2))
    monkeypatch.setattr(AbsentBonds, "set", listed(AbsentBonds.set))
    bonds = [fh.Simulation(lattice, model, boundary, start, threads=n, **rest) for n in (1, 2)]
    assert not bonds[0].engine.tables.surface.segments.size and single.engine.tables.surface.segments.size
    assert bonds[0].engine.absent.count == single.engine.absent.count
    for sim in (single, double, *bonds):
        sim.step(30)
    scale = np.abs(single.fields["u"][np.isfinite(single.fields["u"])]).max()
    tolerance = 2e-4 if rest.get("dtype") else 1e-12
    np.testing.assert_allclose(single.fields["u"], bonds[0].fields["u"], rtol=0, atol=tolerance * scale)
    np.testing.assert_array_equal(single.engine.levels, double.engine.levels)
    np.testing.assert_array_equal(bonds[0].engine.levels, bonds[1].engine.levels)
    nodes = single.engine.layout.box.node_indices()
    for level in single.engine.levels:
        assert not level.reshape(single.engine.components, -1)[:, nodes[~single.engine.absent.exists[nodes]]].any()


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
    balance = sim.balance()
    assert balance["stored"] == pytest.approx(sim.fields["u"][lattice.mask].sum(), rel=1e-12) and balance["x-"] > 1
    assert abs(balance["residual"]) < 1e-12 * balance["stored"]


def test_a_state_has_the_nodes_that_exist():
    """Any state advances as the body alone does: two steps of the engine equal those of the matrix of its bonds."""
    sim = fh.Simulation(PLATE, fh.Wave(kernel_stencil(2, 2)), fh.Free(), threads=1)
    state = State(sim.engine)
    assert state.size == 2 * PLATE.nodes
    inside = PLATE.mask
    matrix = dense_operator(
        inside.shape, sim.stencil.offsets, sim.stencil.weights, lambda i, j: inside[tuple(i.T)] & inside[tuple(j.T)]
    )
    inner = matrix[np.ix_(inside.ravel(), inside.ravel())]
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


@njit()
def product(function, src, read, out, written, matrix, step, nodes, factor):
    """The map, called as compiled code does."""
    call_map(function, src, read, out, written, matrix, step, nodes, factor)


@pytest.mark.parametrize("real", ["float64", "float32"])
@pytest.mark.parametrize("added", [False, True])
@pytest.mark.parametrize("each", [False, True])
@pytest.mark.parametrize("shape", [(1, 1), (3, 1), (2, 3), (9, 3)])
def test_numbers_of_nodes_times_matrices(shape, each, added, real):
    """Any number of nodes, whether a multiple of the vector length or not; nothing else is written."""
    rng = np.random.default_rng(SEED)
    print(f"seed {SEED}")
    rows, columns = shape
    entries = [np.flatnonzero(rng.random(columns) < 0.7) for _ in range(rows)]
    entries = tuple(tuple(e.tolist()) if len(e) else (0,) for e in entries)
    mask = np.array([[c in e for c in range(columns)] for e in entries])
    (function,) = load_rows("map_rows", entries=entries, columns=columns, each=each, added=added, real=real)
    apart = 40
    for nodes in (1, 3, 8, 19):
        values = rng.normal(size=(columns, apart)).astype(real)
        before = rng.normal(size=(rows, apart)).astype(real)
        matrix = np.zeros(rows * columns * (nodes if each else 1) + 16, real)
        entries_of = (mask[..., None] * rng.normal(size=(rows, columns, nodes if each else 1))).astype(real)
        matrix[: entries_of.size] = entries_of.ravel()
        after, size = before.copy(), before.itemsize
        step = (nodes if each else 1) * size
        given = values.ctypes.data, apart * size, after.ctypes.data, apart * size, matrix.ctypes.data, step, nodes, 0.3
        product(function, *given)
        expected = before.copy()
        sums = np.einsum("rcn,cn->rn", np.broadcast_to(entries_of, (rows, columns, nodes)), values[:, :nodes])
        expected[:, :nodes] = before[:, :nodes] + 0.3 * sums if added else sums
        np.testing.assert_allclose(after, expected, atol=1e-13 if real == "float64" else 1e-5)


@pytest.mark.parametrize("shape", [(23,), (9, 21), (5, 4, 19)])
def test_rows_hold_the_matrix_of_each_node(shape):
    """Nodes occur alone, beside others, and in runs that share their matrix; identical rows share theirs."""
    rng = np.random.default_rng(SEED)
    print(f"seed {SEED}")
    box = fh.Simulation(lattice_of(shape), fh.Wave(fh.Kernel(2.0)), fh.Periodic()).engine.layout.box
    places = box.node_indices()
    numbers = rng.integers(-2, 3, shape[-1])[None, None] * np.ones(places.shape, int)
    numbers[..., 2:12] = np.where(rng.random((*places.shape[:2], 1)) < 0.5, 1, numbers[..., 2:12])
    odd = numbers >= 0
    matrices = rng.normal(size=(3, 4, 4))
    rows = law_rows(box, places[odd], numbers[odd], matrices)
    got = np.full((*places.shape, 16), np.nan)
    for row, (first, end) in enumerate(rows.ranges):
        for place, stop, function, weight, step, number in rows.segments[first:end]:
            for i in range(stop - place):
                start = weight + i * (function == EACH)
                at = row // places.shape[1], row % places.shape[1], place + i
                assert np.isnan(got[at]).all()
                got[at] = rows.weights[start : start + 16 * step : step]
                assert rows.kinds[number + i] == numbers[at]
                assert function in (ALIKE, EACH)
    np.testing.assert_array_equal(np.isnan(got[..., 0]), ~odd)
    np.testing.assert_array_equal(got[odd].reshape(-1, 4, 4), matrices[numbers[odd]])

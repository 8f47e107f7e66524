"""The compiled layers, nested along two axes, against all continued fields written out, with one memory for each
offset of the stencil.
"""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.engine.engine import Engine, Layer
from farhorizon.medium.integrators import Verlet

SEED = 20261122


class WrittenOut:
    """Stretched shifts on the whole box, axis by axis: ``u(p + 1) + r (u(p) - v(p + 1)) - N``, from the far end of the
    shift backwards, with zero beyond it.
    """

    def __init__(self, shape, layers, dt):
        self.memory, self.edges = {}, []
        for axis, n in enumerate(shape):
            r, e, f = np.zeros((3, n + 1))  # edge i lies between nodes i - 1 and i
            for side in (-1, 1):
                if (axis, side) in layers:
                    for row, values in zip((r, e, f), layers[axis, side].recursion(dt), strict=True):
                        row[slice(None, len(values)) if side < 0 else slice(-len(values), None)] = values[::side]
            self.edges.append((r, e, f))

    def shift(self, u, axis, sign, key):
        """Shift by one node along an axis; advances the memory of this application."""
        r, e, f = (t if sign > 0 else t[::-1] for t in self.edges[axis])
        u = np.moveaxis(u, axis, 0)[::sign]
        past = self.memory.setdefault(key, np.zeros((len(u) + 1, *u.shape[1:])))
        v, ahead, beyond = np.zeros_like(u), np.zeros_like(u[0]), np.zeros_like(u[0])
        for p in range(len(u) - 1, -1, -1):
            d = u[p] - ahead
            v[p] = beyond + r[p + 1] * d - past[p]
            past[p] = e[p + 1] * past[p] + f[p + 1] * d
            ahead, beyond = v[p], u[p]
        return np.moveaxis(v[::sign], 0, axis)

    def apply(self, u, offsets, weights):
        """The operator on a field of several components."""
        known = {(0, 0, 0): u}

        def continued(offset):
            if offset not in known:
                axis = max(a for a in range(3) if offset[a])
                sign = int(np.sign(offset[axis]))
                before = tuple(o - sign * (a == axis) for a, o in enumerate(offset))
                parts = enumerate(continued(before))
                known[offset] = np.stack([self.shift(part, axis, sign, (offset, c)) for c, part in parts])
            return known[offset]

        return sum(np.tensordot(w, continued(tuple(o)) - u, 1) for o, w in zip(offsets.tolist(), weights, strict=True))


def random_stencil(random, dim, components, mirrored):
    """Random offsets along three axes, with reach 1 to 3 along each of `dim` axes, and matrices.

    The stencil is even, and if `mirrored` even along each axis.
    """
    reach = [0] * (3 - dim) + random.integers(1, 4, dim).tolist()
    grid = np.array(list(np.ndindex(*[2 * m + 1 for m in reach]))) - reach
    grid = grid[grid.any(1)]
    table = random.uniform(0, 1, (*[m + 1 for m in reach], components, components)) if mirrored else None
    values = {}
    for o in map(tuple, grid.tolist()):
        opposite = tuple(-i for i in o)
        if mirrored == "as a medium":  # the coupling of two components changes its sign with each of their coordinates
            sign = np.sign(o[3 - components :])
            values[o] = table[tuple(map(abs, o))] * np.where(np.eye(components), 1, np.outer(sign, sign))
            continue
        values[o] = (
            table[tuple(map(abs, o))]
            if mirrored
            else values.get(opposite, random.uniform(0, 1, (components, components)))
        )
    weights = np.array([values[tuple(o)] for o in grid.tolist()])
    return grid, (weights + weights.swapaxes(1, 2)) / 2


@pytest.mark.sampled(5)
@pytest.mark.parametrize(
    ("dim", "components", "mirrored"),
    [
        (dim, components, mirrored)
        for dim, components in ((1, 1), (2, 1), (2, 2), (3, 1), (3, 3))
        for mirrored in (True, False)
    ]
    + [(2, 2, "as a medium"), (3, 3, "as a medium")],
)
@pytest.mark.parametrize(("kept", "error"), [("float64", 1e-12), ("int32", 1e-5)])
def test_every_layer_is_that_of_continued_fields(dim, components, mirrored, kept, error):
    """Faces, edges and corners, with sides of different thickness or without a layer and with general stretches.
    Memory of half the length is right to its last digit.
    """
    random = np.random.default_rng([SEED, dim, components, bool(mirrored)])
    print("seed", SEED)
    offsets, weights = random_stencil(random, dim, components, mirrored)
    reach = np.abs(offsets).max(0)
    # data vanish on the last reach + 1 nodes
    core = tuple(int(2 * m + 3 + random.integers(3)) if m else 1 for m in reach)
    layers = {}
    for axis in range(3 - dim, 3):
        for side in (-1, 1):
            columns = int(random.integers(1, 6))
            stretch = random.uniform([[1.0], [0.0], [0.0]], [[3.0], [2.0], [0.5]], (3, columns + 1))
            layers[axis, side] = Layer(*stretch, short=kept == "int32")
    if dim > 1:
        del layers[3 - dim, 1]
    dt = 0.5 / np.sqrt(np.abs(weights).sum())
    engine = Engine(
        core,
        offsets,
        weights if components > 1 else weights[:, 0, 0],
        Verlet.stages(dt, 0.0, dim == 1),
        dt,
        layers=layers,
    )
    assert engine.memory.dtype == kept
    box = engine.layout.box
    start = np.zeros((components, *box.nodes))
    middle = tuple(low + n // 2 for low, n in zip(engine.layout.low, core, strict=True))
    start[(slice(None), *middle)] = random.standard_normal(components)
    engine.layout.box.view(engine.levels[0])[...] = start if components > 1 else start[0]
    if dim > 1:
        engine.layout.box.view(engine.levels[1])[...] = start if components > 1 else start[0]
    reference = WrittenOut(box.nodes, layers, dt)
    old, new = start, start
    steps = 25
    for _ in range(steps):
        old, new = new, 2 * new - old + dt**2 * reference.apply(new, offsets, weights)
    engine.advance(steps)
    found = box.view(engine.current).reshape(new.shape)
    assert np.abs(found - new).max() < error * np.abs(new).max()
    assert np.abs(new).max() > 1e-3


@pytest.mark.parametrize(("real", "error"), [("float64", 1e-12), ("float32", 1e-5)])
@pytest.mark.parametrize(("components", "mirrored"), [(1, True), (2, "as a medium")])
def test_layers_along_the_last_axis_are_those_along_another_one(components, mirrored, real, error):
    """Long planes whose lines are processed in several pieces: noise in either order of the axes and components."""
    random = np.random.default_rng([SEED, 300, components])
    print("seed", SEED)
    offsets, weights = random_stencil(random, 2, components, mirrored)
    dt = 0.5 / np.sqrt(np.abs(weights).sum())
    stretch = random.uniform([[1.0], [0.0], [0.0]], [[3.0], [2.0], [0.5]], (3, 5))
    near = np.zeros((components, 300, 12))
    near[:, :, 4:-4] = random.standard_normal((components, 300, 4))
    found = []
    for turned in (False, True):
        values = near[::-1].swapaxes(1, 2) if turned else near
        layers = {(1 if turned else 2, side): Layer(*stretch) for side in (-1, 1)}
        given = (offsets[:, [0, 2, 1]], weights[:, ::-1, ::-1]) if turned else (offsets, weights)
        given = given if components > 1 else (given[0], given[1][:, 0, 0])
        shape, stages = (1, *values.shape[1:]), Verlet.stages(dt, 0.0, False)
        engine = Engine(shape, *given, stages, dt, layers=layers, real=real)
        for level in engine.levels:
            engine.core.view(level)[...] = values.reshape(engine.core.view(level).shape)
        engine.advance(40)
        last = engine.core.view(engine.current).reshape(values.shape)
        found.append(last[::-1].swapaxes(1, 2) if turned else last)
    np.testing.assert_allclose(found[0], found[1], rtol=0, atol=error * np.abs(found[0]).max())
    assert np.abs(found[0][:, :, [0, -1]]).max() > 1e-3


@pytest.mark.parametrize("periodic", [False, True])
def test_threads_wait_for_the_lines_that_drag_continues(periodic, monkeypatch):
    """No sweep lies between the continued lines of the increments and the sums that read them, as it does for forces:
    threads must wait for each other there, or drag takes what is left of the step before.
    """
    monkeypatch.setattr("farhorizon.engine.engine._PARALLEL_NUMBERS", 0)
    monkeypatch.setattr("farhorizon.simulation.setup.setup.available_threads", lambda: 3)
    sides = {"x": fh.Periodic() if periodic else fh.LatticePML(nodes=4), "y": fh.LatticePML(nodes=6)}
    model = fh.Correspondence(fh.Kernel(2.0), 1.0, 0.3, drag=0.4, stabilisation=0.3)
    lattice = fh.Lattice(1.0, (-20.0, -20.0), (20.0, 20.0))
    pulse = "1e-3*exp(-(x**2 + y**2)/20)"
    runs = [fh.Simulation(lattice, model, sides, {"u": [pulse, pulse]}, threads=n) for n in (1, 3)]
    assert runs[1].engine.threads == 3
    for sim in runs:
        sim.step(60)
    assert all(sim.engine.tables.neighbours.layers.slots.any() for sim in runs)
    np.testing.assert_array_equal(*[sim.engine.levels for sim in runs])

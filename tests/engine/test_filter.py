"""The compiled damping of short waves against dense matrices."""

import numpy as np
import pytest
from scipy import special

import farhorizon as fh
from farhorizon.analysis.layers.short_waves import HighPass
from farhorizon.checks.reduced_setups import Strip
from farhorizon.engine.engine import Layer
from farhorizon.engine.features.filter import line_damping
from farhorizon.engine.state import State

FILTER = HighPass(5, 3, 1.0, 1.0)
TAPS = FILTER.taps()  # longer than some near fields are wide
RATE = np.array([0.1, 0.4, 0.9, 1.5])


def layer(damping=RATE, whole=False, every=1):
    return fh.LatticePML(nodes=4, profile=Layer(np.ones(5), np.zeros(5), np.zeros(5), damping, TAPS, whole, every))


def simulation(boundary, shape, dtype="float64", threads=1, **more):
    lattice = fh.Lattice(1.0, (0.0,) * len(shape), [n - 1.0 for n in shape])
    return fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), boundary, dtype=dtype, threads=threads, **more)


def natural(engine):
    """Coordinates and indices of all nodes of a level, and the distance of each from the core along each axis, 0
    inside.
    """
    box, low = engine.layout.box, engine.layout.low
    place = np.stack(
        [i - n for i, n in zip(np.indices(box.nodes), low, strict=True)] + [box.node_indices()], -1
    ).reshape(-1, 4)
    far = np.maximum(np.maximum(-place[:, :3], place[:, :3] + 1 - np.array(engine.core.nodes)), 0)
    return place, far


def filter_matrix(nodes, shape, periodic=False, walls=None, cuts=()):
    """Sum over the axes of the filter along each, as a matrix between all nodes of a box with layers.

    Between walls it is the same function of the second difference, whose row at a free end lacks a neighbour and at a
    fixed end has one at rest. Cuts of lines along the second axis, after given nodes, are free ends on both sides.
    """
    dim, taps = len(shape), np.append(TAPS, np.zeros(100))
    filtered = np.zeros((len(nodes), len(nodes)))
    for axis in range(3 - dim, 3):
        line = np.delete(nodes, axis, 1) @ (1000, 1)  # the number of the line
        gap = np.subtract.outer(nodes[:, axis], nodes[:, axis])
        if walls and axis == 4 - dim:
            second = 2 * np.eye(shape[1]) - np.eye(shape[1], k=1) - np.eye(shape[1], k=-1)
            second[[0, -1], [0, -1]] -= [wall is fh.Free for wall in walls]
            for i in cuts:
                second[i : i + 2, i : i + 2] -= [[1, -1], [-1, 1]]
            values, modes = np.linalg.eigh(second / 4)
            across = modes * special.betainc(FILTER.rise, FILTER.fall, np.clip(values, 0, 1)) @ modes.T
            filtered += np.where(line[:, None] == line, across[nodes[:, axis][:, None], nodes[:, axis]], 0.0)
            continue
        images = shape[1] * np.arange(-5, 6) if periodic and axis == 4 - dim else (0,)  # all images within reach
        weight = sum(taps[np.minimum(np.abs(gap + turn), 99)] for turn in images)
        filtered += np.where(line[:, None] == line, weight, 0.0)
    return filtered


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("whole", "every"), [(False, 1), (True, 1), (False, 2)])
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize(
    ("shape", "across"),
    [
        ((9,), None),
        ((7, 8), None),
        ((7, 8), "periodic"),
        ((7, 8), (fh.Free, fh.Fixed)),
        ((7, 5), (fh.Free, fh.Free)),
        ((7, 5), (fh.Fixed, fh.Free)),
        ((6, 5, 7), None),
        ((6, 5, 7), "periodic"),
        ((6, 5, 7), (fh.Fixed, fh.Fixed)),
    ],
)
def test_filter_is_the_matrix_it_is_said_to_be(shape, across, threads, whole, every):
    """A step with damping equals one without, minus D F D times the increments (or times both levels), where F has the
    taps along each axis. Where only some steps are damped, each makes up for those before.
    """
    periodic, walls = across == "periodic", across if isinstance(across, tuple) else None
    dim = len(shape)
    sides = {axis: layer(whole=whole, every=every) for axis in "xyz"[:dim]}
    plain = {axis: layer(np.zeros(0)) for axis in "xyz"[:dim]}
    if periodic:
        sides["y"] = plain["y"] = fh.Periodic()
    for key, wall in zip(("y-", "y+"), walls or (), strict=False):
        for given in (sides, plain):
            given.pop("y", None)
            given[key] = wall()
    sim, bare = simulation(sides, shape, threads=threads), simulation(plain, shape)
    state, bare_state = State(sim.engine), State(bare.engine)
    start = np.random.default_rng(0).standard_normal(state.size)
    state.after(start, every)
    table, depth = natural(bare.engine)
    at = table[:, 3]
    bare_state.write(start)
    bare.engine.advance(every - 1)
    old = bare.engine.current[at].copy()
    bare.engine.advance(1)
    undamped = bare.engine.current[at]
    rates = np.append(0.0, RATE)[depth].sum(1)
    strength = np.sqrt(-np.expm1(-dim * rates * every * sim.dt) / dim)
    filtered = filter_matrix(table[:, :3], shape, periodic, walls)
    expected = undamped - strength * (filtered @ (strength * (undamped if whole else undamped - old)))
    assert np.abs(sim.engine.current[at] - expected).max() <= 1e-13 * np.abs(expected).max()
    if whole:  # the level before is filtered, too; in 1D it is stored as an increment
        before = sim.engine.current[at] - sim.engine.levels[2][at] if dim == 1 else sim.engine.older[at]
        assert np.abs(before - (old - strength * (filtered @ (strength * old)))).max() <= 1e-13 * np.abs(old).max()
    if dim < 3:
        taken = np.linalg.eigvalsh(strength[:, None] * filtered * strength)
        assert taken.max() <= 1 + 1e-12  # never reverses an increment
        assert taken.min() >= -1e-12  # never adds energy


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize(
    ("shape", "walls", "cuts"),
    [
        ((7, 8), (fh.Free, fh.Free), (3,)),
        ((7, 8), (fh.Free, fh.Free), (0, 5)),  # a line of one node, and images of images
        ((7, 8), (fh.Fixed, fh.Free), (0, 4)),  # with images beyond a fixed side
        ((7, 5), (fh.Fixed, fh.Fixed), (1,)),
        ((7, 30), (fh.Fixed, fh.Free), (14, 15)),
        ((6, 5, 7), (fh.Free, fh.Free), (2,)),
    ],
)
def test_lines_of_the_filter_end_at_cracks(shape, walls, cuts, threads, whole):
    """Cracks along the normal of two layers run into these and act as free ends."""
    dim, long = len(shape), 30.0
    sides = {axis: layer(whole=whole) for axis in "xyz"[:dim] if axis != "y"}
    plain = {axis: layer(np.zeros(0)) for axis in sides}
    for given in (sides, plain):
        given |= {key: wall() for key, wall in zip(("y-", "y+"), walls, strict=True)}

    cracks = [
        [(-long, i + 0.5), (long, i + 0.5)]
        if dim == 2
        else fh.Rectangle((-long, i + 0.5, -long), (2 * long + 9, 0.0, 0.0), (0.0, 0.0, 2 * long + 9))
        for i in cuts
    ]
    sim, bare = simulation(sides, shape, threads=threads, cracks=cracks), simulation(plain, shape, cracks=cracks)
    state, bare_state = State(sim.engine), State(bare.engine)
    start = np.random.default_rng(0).standard_normal(state.size)
    table, depth = natural(bare.engine)
    at = table[:, 3]
    bare_state.write(start)
    old = bare.engine.current[at].copy()
    bare.engine.advance(1)
    undamped = bare.engine.current[at]
    state.after(start, 1)
    strength = np.sqrt(-np.expm1(-dim * np.append(0.0, RATE)[depth].sum(1) * sim.dt) / dim)
    filtered = filter_matrix(table[:, :3], shape, False, walls, cuts)
    expected = undamped - strength * (filtered @ (strength * (undamped if whole else undamped - old)))
    assert np.abs(sim.engine.current[at] - expected).max() <= 1e-13 * np.abs(expected).max()


def test_single_precision():
    single, double = (simulation(layer(), (9, 8), dtype) for dtype in ("float32", "float64"))
    for sim in (single, double):
        sim.engine.core.view(sim.engine.current)[0, 4, 4] = 1.0
        sim.engine.advance(30)
    a, b = (s.engine.core.view(s.engine.current) for s in (single, double))
    assert np.abs(a - b).max() <= 1e-5 * np.abs(b).max() + 1e-6  # 30 steps of 6e-8


def test_line_damping_is_the_strip_of_it():
    """For a wave along the side the filter along it is a number."""
    damping = line_damping(RATE, TAPS, 0.3, np.array([np.pi]))
    strength = np.sqrt(-np.expm1(-2 * RATE * 0.3) / 2)
    lone = line_damping(RATE, TAPS, 0.6, np.zeros(0))  # the same strengths, except for the factor 1/2 of two axes
    assert np.abs(damping - (lone / 2 + np.diag(strength**2 * FILTER.passed(np.pi)))).max() <= 1e-15


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("components", [1, 2])
def test_strips_know_the_filter(components, whole):
    """A Bloch wave on long periodic rows, whose filter reaches farther than the rows of a strip, advances by the
    matrix of the strip.
    """
    rows, model = 40, fh.Wave(fh.Kernel(2.0)) if components == 1 else fh.Elastic(fh.Kernel(2.0, 1), young=1.0)
    sides = fh.LatticePML(
        nodes=4, profile=Layer(np.ones(5), np.linspace(0.1, 2, 5), np.full(5, 0.01), RATE, TAPS, whole)
    )
    lattice = fh.Lattice(1.0, (0.0, 0.0), (7.0, rows - 1.0))
    sim = fh.Simulation(lattice, model, {"x": sides, "y": fh.Periodic()}, threads=1)
    strip, state = Strip(sim, 0, 8), State(sim.engine)
    place = state.rows().place
    number = 2 * np.pi * 11 / rows
    random = np.random.default_rng(0)
    start = random.standard_normal(len(place)) + 1j * random.standard_normal(len(place))
    phase = np.exp(1j * number * np.arange(rows))
    before = np.zeros(state.size, complex)
    before[place] = start[:, None] * phase
    after = state.after(before, 3)[place]
    expected = np.linalg.matrix_power(strip.matrix(number), 3) @ start
    assert np.abs(after - expected[:, None] * phase).max() <= 1e-13 * np.abs(expected).max()


@pytest.mark.parametrize("blocked", [False, True])
@pytest.mark.parametrize("threads", [2, 3, 7])
def test_threads_filter_what_one_does(threads, blocked, monkeypatch):
    """Results agree bitwise, also where the filter reaches beyond the part of a thread. Long filters work in blocks of
    lines, here of one line, as in large boxes.
    """
    monkeypatch.setattr("farhorizon.engine.features.filter._CACHED", 0)
    monkeypatch.setattr("farhorizon.engine.engine._PARALLEL_NUMBERS", 0)
    monkeypatch.setattr("farhorizon.simulation.setup.setup.available_threads", lambda: threads)
    lattice = fh.Lattice(1.0, (0.0,) * 3, (8.0,) * 3)
    model = fh.Elastic(fh.Kernel(2.0, 1), young=1.0) if blocked else fh.Wave(fh.Kernel(3.0))
    shape = (3, *lattice.shape) if blocked else lattice.shape
    initial = {"u": np.random.default_rng(1).standard_normal(shape)}
    runs = [fh.Simulation(lattice, model, fh.LatticePML(nodes=4), initial, threads=n) for n in (1, threads)]
    filtered = runs[1].engine.tables.filter
    assert runs[1].engine.threads == threads and filtered.runs.size and filtered.blocked == blocked
    for sim in runs:
        sim.step(9)
    np.testing.assert_array_equal(*[sim.engine.levels for sim in runs])

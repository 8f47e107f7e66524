"""Layers for diffusion: what they reflect of the data, and how many nodes they need."""

import os

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.layers.diffusing import Diffusing, Planes, Wall, diffusive, thinnest_for_diffusion
from farhorizon.analysis.references.infinite import InfiniteLattice

SEED = int(os.environ.get("FARHORIZON_SEED", np.random.default_rng().integers(2**31)))


@pytest.mark.parametrize(("ratio", "known"), [(1, (4, 6, 9, 11)), (100, (8, 12, 18, 21)), (1e4, (14, 19, 27, 31))])
def test_nodes_for_diffusion_are_those_of_an_independent_program(ratio, known):
    """Nodes for 1e-3, 1e-5, 1e-7 and 1e-8 at D T / distance^2, found by an independent program from the exact error of
    a point source.
    """
    for wanted, nodes in zip((1e-3, 1e-5, 1e-7, 1e-8), known, strict=True):
        spreads = 400.0 * np.geomspace(0.03, ratio, 200)
        worst = [
            Diffusing(Planes.at(20.0), spreads).returned(diffusive(n, 1.0, ratio * 400.0, 20.0), 1.0).max()
            for n in (nodes - 2, nodes)
        ]
        assert worst[1] < 1.5 * wanted < 1.5 * worst[0]
        assert thinnest_for_diffusion(1.0, ratio * 400.0, [Planes.at(20.0)], wanted).predicted < wanted


@pytest.mark.parametrize("reach", [1, 3])
def test_what_diffusion_sends_back_on_a_line(reach):
    """The prediction for a point source against a bar with one absorbing end, far from the other one."""
    model, distance = fh.Diffusion(fh.Kernel(float(reach), 1), 1.0), 15
    u = np.zeros(161)
    u[160 - distance] = 1.0
    layer = diffusive(8, 1.0, 10.0 * distance**2, distance)
    boundary = {"x-": fh.Fixed(0.0), "x+": fh.LatticePML(nodes=8, profile={"kappa": layer.kappa})}
    sim = fh.Simulation(fh.Lattice(1.0, (0.0,), (160.0,)), model, boundary, {"u": u}, threads=1)
    infinite = InfiniteLattice(sim.stencil, 1.0, model.integrator, sim.dt, int(400 / sim.dt), u)
    ratios = []
    for time in (40.0, 100.0, 200.0, 400.0):  # what the other end reflects is smaller by exp(-145^2/1600) = 2e-6
        sim.step(int(time / sim.dt) - sim.step_count)
        exact = infinite.after(sim.step_count)
        predicted = Diffusing(Planes.at(distance), np.array([sim.time])).returned(layer, 1.0)[0]
        ratios.append(abs(sim.fields["u"][-1] - exact[-1]) / exact.max() / predicted)
    # the prediction is that of the continuum, and the first waves are steep
    np.testing.assert_allclose(ratios, 1, atol=0.25)
    assert abs(ratios[-1] - 1) < 0.05


@pytest.mark.parametrize("wall", [fh.Fixed(0.0), fh.Free()], ids=["held", "insulated"])
def test_what_diffusion_sends_back_beside_a_wall(wall):
    """The prediction for a point source near a wall against a bar so long that its end does not matter. Beside a wall
    that holds its nodes at zero both the field and its echo decay as those of a dipole, the longer one in the layer.
    """
    model, nodes, place, end = fh.Diffusion(fh.Kernel(2.0, 1), 1.0), 30, 8, 6000.0
    bars = []
    for length, far in ((nodes, fh.LatticePML(nodes=4, profile={"kappa": diffusive(4, 1.0, end, 21.0).kappa})),
                        (900, fh.Fixed(0.0))):  # fmt: skip
        u = np.zeros(length)
        u[place] = 1.0
        lattice = fh.Lattice(1.0, (0.0,), (length - 1.0,))
        bars.append(fh.Simulation(lattice, model, {"x-": wall, "x+": far}, {"u": u}, threads=1))
    [layer], found = bars[0].engine.layers.values(), []
    [source], beside = Planes.of(bars[0].fields["u"], 1.0), Wall(wall.image, float(nodes))
    assert source.distances == nodes - 1 - place
    for time in np.geomspace(200.0, end, 8):
        for bar in bars:
            bar.step(int(time / bar.dt) - bar.step_count)
        exact, now = bars[1].fields["u"][:nodes], np.array([bars[0].time])
        predicted = [Diffusing(source, now, one).returned(layer, 1.0)[0] for one in (beside, None)]
        found.append([abs(bars[0].fields["u"][-1] - exact[-1]) / exact.max(), *predicted])
    came, expected, alone = np.transpose(found)
    print(np.transpose(found))
    # the prediction is that of the continuum, and passes through zero at some times
    assert np.abs(came - expected).max() < 0.25 * expected.max()
    assert np.abs(came - alone).max() > 0.25 * expected.max()


@pytest.mark.parametrize("image", [-1, 1])
def test_a_wall_far_away_changes_nothing(image):
    """A source beside the layer of a long bar, from the first time on, when it is narrower than a node."""
    layer, spreads = diffusive(6, 1.0, 400.0, 2.0), np.geomspace(0.03, 400.0, 40)
    source, far = Planes.at(2.0), Wall(image, 2002.3)
    np.testing.assert_allclose(Diffusing(source, spreads, far).largest, 1.0, rtol=1e-12)
    with_wall, without = (Diffusing(source, spreads, wall).returned(layer, 1.0) for wall in (far, None))
    np.testing.assert_allclose(with_wall, without, rtol=1e-9)
    alone, beside = (thinnest_for_diffusion(1.0, 400.0, [source], 1e-5, wall) for wall in (None, far))
    assert alone.layer.columns == beside.layer.columns


def test_diffusion_keeps_its_target_beside_a_wall():
    """Random bars, held at one end and absorbing at the other, keep their target at all times."""
    print(f"seed {SEED}")
    rng = np.random.default_rng(SEED)
    for _ in range(4):
        nodes, width, target = int(rng.integers(25, 50)), rng.uniform(2.0, 3.0), 10.0 ** -rng.integers(3, 6)
        model, until = (
            fh.Diffusion(fh.Kernel(float(rng.integers(1, 4)), 1), 1.0),
            rng.uniform(10.0, 60.0) * nodes**2 / 4,
        )
        place = rng.uniform(3 * width, nodes / 2)
        layer, runs = fh.LatticePML(target=target, until=until), []
        for length, far in ((nodes, layer), (nodes + int(6 * np.sqrt(2 * until)), fh.Fixed(0.0))):
            lattice = fh.Lattice(1.0, (0.0,), (length - 1.0,))
            sides = {"x-": fh.Fixed(0.0), "x+": far}
            data = {"u": np.exp(-(((np.arange(length) - place) / width) ** 2))}
            runs.append(fh.Simulation(lattice, model, sides, data, threads=1))
        for time in np.geomspace(until / 300, until, 12):
            for run in runs:
                run.step(int(time / run.dt) - run.step_count)
            exact = runs[1].fields["u"][:nodes]
            assert np.abs(runs[0].fields["u"] - exact).max() < target * exact.max()


@pytest.mark.parametrize("sign", [1, -1], ids=["one sign", "both signs"])
def test_what_diffusion_sends_back_of_data_that_are_spread_out(sign):
    """The prediction against a bar with one absorbing end. Data of both signs decay as a dipole; concentrated at their
    nearest node, they were predicted so badly that up to six targets came back.
    """
    model, end = fh.Diffusion(fh.Kernel(2.0, 1), 1.0), 3000.0
    x = np.arange(401.0)
    u = np.exp(-(((x - 350) / 4) ** 2)) + sign * np.exp(-(((x - 360) / 4) ** 2))
    [planes] = Planes.of(u, 1.0)
    layer = diffusive(6, 1.0, end, planes.nearest)
    boundary = {"x-": fh.Fixed(0.0), "x+": fh.LatticePML(nodes=6, profile={"kappa": layer.kappa})}
    sim = fh.Simulation(fh.Lattice(1.0, (0.0,), (400.0,)), model, boundary, {"u": u}, threads=1)
    infinite = InfiniteLattice(sim.stencil, 1.0, model.integrator, sim.dt, int(end / sim.dt), u)
    found = []
    for time in np.geomspace(100.0, end, 12):
        sim.step(int(time / sim.dt) - sim.step_count)
        exact = infinite.after(sim.step_count)
        came = abs(sim.fields["u"][-1] - exact[-1]) / np.abs(exact).max()
        found.append((came, Diffusing(planes, np.array([sim.time])).returned(layer, 1.0)[0]))
    came, predicted = np.transpose(found)
    print(np.transpose(found))
    assert np.abs(came - predicted).max() < 0.08 * predicted.max()


@pytest.mark.parametrize("wall", [None, fh.Fixed(0.0), fh.Free()], ids=["open", "held", "insulated"])
def test_what_diffusion_sends_back_of_a_source_that_goes_on(wall):
    """The prediction against a bar with one absorbing end, relative to the largest value at the same time, the one at
    the source.
    """
    model, end, nodes, place = fh.Diffusion(fh.Kernel(1.0), 1.0), 2000.0, 30 if wall else 401, -16
    u = np.zeros(nodes)
    u[place] = 1.0
    [planes] = [Planes.nearest_of(u, 1.0, lasting=2)]
    assert planes.distances == 15
    layer = diffusive(4, 1.0, end, planes.nearest)
    sides = {"x-": wall or fh.Fixed(0.0), "x+": fh.LatticePML(nodes=4, profile={"kappa": layer.kappa})}
    lattice, far = fh.Lattice(1.0, (0.0,), (nodes - 1.0,)), fh.Lattice(1.0, (0.0,), (nodes + 499.0,))
    longer = np.concatenate([u, np.zeros(500)])
    bars = [
        fh.Simulation(grid, model, ends, {"u": 0.0}, sources=[fh.Source(data)], threads=1)
        for grid, ends, data in ((lattice, sides, u), (far, sides | {"x+": fh.Fixed(0.0)}, longer))
    ]
    found = []
    for time in np.geomspace(100.0, end, 9):
        for bar in bars:
            bar.step(int(time / bar.dt) - bar.step_count)
        exact = bars[1].fields["u"][:nodes]
        beside = Wall(wall.image, float(nodes)) if wall else None
        predicted = Diffusing(planes, np.array([bars[0].time]), beside).returned(layer, 1.0)[0]
        found.append((abs(bars[0].fields["u"][-1] - exact[-1]) / exact.max(), predicted))
    came, predicted = np.transpose(found)
    print(np.transpose(found))
    assert np.abs(came - predicted).max() < 0.1 * predicted.max()


def test_what_diffusion_sends_back_of_what_holds_its_value():
    """The prediction against a bar with a node held at 1."""
    model, end, nodes = fh.Diffusion(fh.Kernel(1.0), 1.0), 1000.0, 401
    lattice, layer = fh.Lattice(1.0, (0.0,), (nodes - 1.0,)), diffusive(4, 1.0, end, 15.0)
    held, start = [fh.Temperature(fh.Box(384.5, 385.5), 1.0)], np.zeros(nodes)
    runs = []
    for far in (fh.LatticePML(nodes=4, profile={"kappa": layer.kappa}), fh.Extended(until=end, target=1e-12)):
        runs.append(
            fh.Simulation(lattice, model, {"x-": fh.Fixed(0.0), "x+": far}, {"u": start}, constraints=held, threads=1)
        )
    found = []
    for time in np.geomspace(60.0, end, 9):
        for run in runs:
            run.step(int(time / run.dt) - run.step_count)
        came = abs(runs[0].fields["u"][-1] - runs[1].fields["u"][-1])
        found.append((came, Diffusing(Planes.at(15.0, lasting=1), np.array([runs[0].time])).returned(layer, 1.0)[0]))
    came, predicted = np.transpose(found)
    print(np.transpose(found))
    assert np.abs(came - predicted).max() < 0.1 * predicted.max()


def test_planes_of_a_product_are_those_along_the_normal():
    """The planes depend neither on the profile across the normal nor on its sign."""
    random = np.random.default_rng(3)
    along, across = random.standard_normal(30), 1 + random.random((5, 7))
    sums, largest = Planes.of(np.multiply.outer(along, across), 0.5)
    np.testing.assert_allclose(sums.shares, largest.shares, rtol=1e-12)
    np.testing.assert_allclose(sums.shares, along / np.abs(along).sum(), rtol=1e-12)
    np.testing.assert_allclose(sums.distances, 0.5 * np.arange(30)[::-1], rtol=1e-12, atol=1e-12)
    # with both signs along the side the sums vanish
    [alone] = Planes.of(np.multiply.outer(along, [1.0, -1.0]), 0.5)
    np.testing.assert_allclose(np.abs(alone.shares), np.abs(sums.shares), rtol=1e-12)


def test_many_planes_of_data_are_put_together():
    """For a long bar, 128 groups of planes give the same reflection as all planes."""
    x = np.arange(1024.0)
    u = np.exp(-(((x - 700) / 60) ** 2))
    [few] = Planes.of(u, 1.0)
    every = Planes(1023 - x, u / u.sum(), few.nearest, few.farthest)
    layer, spreads = diffusive(5, 1.0, 1e6, few.nearest), np.geomspace(few.nearest**2 / 10, 1e6, 20)
    assert len(few.shares) == 128
    came = [Diffusing(planes, spreads).returned(layer, 1.0) for planes in (few, every)]
    np.testing.assert_allclose(came[0], came[1], rtol=0.02, atol=1e-3 * came[1].max())


def test_nothing_is_in_no_plane():
    assert not list(Planes.of(np.zeros((9, 4)), 1.0))


def test_scales_do_not_change_a_layer_for_diffusion():
    np.testing.assert_allclose(
        diffusive(9, 1.0, 400.0, 12.0).kappa, diffusive(9, 1e-6, 400e-12, 12e-6).kappa, rtol=1e-13
    )


def random_data(random: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """A disc, two bells or a bell of both signs, at a random place."""
    half = (np.array(shape) - 1) / 2
    grid, width = np.ix_(*(np.arange(n) - h for n, h in zip(shape, half, strict=True))), random.uniform(1.5, 3.0)
    places = random.uniform(-1, 1, (2, len(shape))) * np.maximum(half - 1.2 * width - 1, 0)
    away = [sum((x - a) ** 2 for x, a in zip(grid, place, strict=True)) for place in places]
    bells = [np.exp(-one / width**2) for one in away]
    return [1.0 * (away[0] < width**2), bells[0] + 0.3 * bells[1], bells[0] * (grid[0] - places[0][0])][
        random.integers(3)
    ]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("number", range(6))
def test_random_data_keep_their_target_in_diffusion(number):
    random = np.random.default_rng([SEED, number])
    dim, reach, target = int(random.integers(1, 4)), float(random.integers(1, 4)), 10.0 ** -random.integers(3, 7)
    shape = tuple(random.integers(*[(20, 60), (20, 40), (13, 19)][dim - 1], size=dim))
    until = random.choice([1.0, 8.0] if dim < 3 else [0.5, 2.0]) * (min(shape) / 2) ** 2
    u, lattice = random_data(random, shape), fh.Lattice(1.0, (0.0,) * dim, tuple(n - 1.0 for n in shape))
    model = fh.Diffusion(fh.Kernel(reach, int(random.integers(0, 3))), 1.0)
    sim = fh.Simulation(lattice, model, fh.LatticePML(target=target, until=until), {"u": u}, threads=1)
    print(f"seed {SEED}, number {number}: {shape}, reach {reach:g}, until {until:g}, target {target:g}")
    infinite = InfiniteLattice(sim.stencil, 1.0, model.integrator, sim.dt, int(until / sim.dt), u)
    for step in np.unique(np.geomspace(1, int(until / sim.dt), 20).astype(int)):
        sim.step(int(step) - sim.step_count)
        exact = infinite.after(sim.step_count)
        assert np.abs(sim.fields["u"] - exact).max() < target * np.abs(exact).max()

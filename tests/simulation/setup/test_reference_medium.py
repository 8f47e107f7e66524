"""The uniform medium to which one that varies is compared, found by processes that each see a part of it."""

import os
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.geometry import lattice as lattices
from farhorizon.geometry.decomposition import decompose
from farhorizon.simulation.setup import reference_medium as module
from farhorizon.simulation.setup.reference_medium import _widened, node_factor, reference_and_variation, varied
from threads_as_processes import on_threads

SEED = int(os.environ.get("FARHORIZON_SEED", np.random.default_rng().integers(2**31)))
KERNEL = fh.Kernel(2.0)


def random_setup(rng):
    """Values that are few, so that many nodes are alike, or all different; with or without a body."""
    shape = tuple(rng.integers(12, 30, 2).tolist())
    few = rng.choice([0.5, 1.0, 1.0, 1.0, 2.0], (2, *shape))
    speed, density = few if rng.random() < 0.5 else rng.uniform(0.5, 2.0, (2, *shape))
    body = rng.random(shape) < 0.7 if rng.random() < 0.5 else None
    lattice = fh.Lattice(1.0, (0.0, 0.0), np.array(shape) - 1.0, body=body)
    return fh.Setup(lattice, fh.Wave(KERNEL, speed, density=density), fh.Free())


@pytest.mark.parametrize("count", [2, 3, 4])
def test_the_medium_beside_which_one_varies_is_that_of_the_sorted_nodes(count):
    """The reference is the medium of the middle node, sorted by speed and then by number, on any number of
    processes.
    """
    print(f"seed {SEED}")
    rng = np.random.default_rng([SEED, count])
    for _ in range(6):
        setup = random_setup(rng)
        lattice, speed, density = setup.lattice, setup.model.speed, setup.model.density
        if lattice.mask is not None:
            speed, density = (
                np.where(lattice.mask, v, np.sort(v[lattice.mask])[lattice.mask.sum() // 2]) for v in (speed, density)
            )
        middle = sorted(range(speed.size), key=lambda n: (speed.flat[n], n))[speed.size // 2]
        uniform, variation = varied(setup)
        assert (uniform.model.speed, uniform.model.density) == (speed.flat[middle], density.flat[middle]), SEED
        np.testing.assert_allclose(variation.squared_speed, (speed / speed.flat[middle]) ** 2, rtol=1e-14)
        for reference_medium, _ in on_threads(count, lambda group, setup=setup: reference_and_variation(setup, group)):
            assert (reference_medium.model.speed, reference_medium.model.density) == (
                uniform.model.speed,
                uniform.model.density,
            ), SEED


def test_a_density_that_turns_out_to_be_uniform_does_not_vary():
    """A density that varies on one process varies on all; one that varies on none is uniform on all."""
    lattice = fh.Lattice(1.0, (0.0, 0.0), (29.0, 14.0))
    for density, even in (("1 + 0*x", ("density",)), ("where(x > 25, 2, 1)", ())):
        setup = fh.Setup(lattice, fh.Wave(KERNEL, "1 + x", density=density), fh.Free())
        for reference_medium, variation in on_threads(
            2, lambda group, setup=setup: reference_and_variation(setup, group)
        ):
            assert reference_medium.even == even
            assert (variation.density is None) == bool(even)


def test_beyond_a_held_rim_a_part_has_the_factor_of_the_nearest_node_of_the_whole():
    """Also where that node belongs to another part."""
    print(f"seed {SEED}")
    rng = np.random.default_rng(SEED)
    for _ in range(20):
        shape = tuple(rng.integers(20, 40, 2).tolist())
        centre = rng.uniform(0.4, 0.6, 2) * shape
        lattice = fh.Lattice(1.0, (0.0, 0.0), np.array(shape) - 1.0, body=fh.Disc(0.35 * min(shape), tuple(centre)))
        factor = rng.uniform(0.5, 2.0, shape)
        setup = fh.Setup(lattice, fh.Wave(KERNEL), fh.Free(), coefficient=factor, rim="fixed")
        factors, cut = node_factor(setup), int(rng.integers(5, shape[0] - 5))
        reached = np.zeros(shape, bool)  # by bonds of the body's nodes
        for offset in fh.Stencil.from_kernel(KERNEL, 1.0, 2).offsets:
            rows, columns = np.nonzero(lattice.mask)
            rows, columns = rows + offset[0], columns + offset[1]
            inside = (rows >= 0) & (rows < shape[0]) & (columns >= 0) & (columns < shape[1])
            reached[rows[inside], columns[inside]] = True
        for ends in ((0, cut), (cut, shape[0])):
            part = lattice.part([ends, (0, shape[1])])
            of_part = node_factor(replace(setup, lattice=part))
            inside = reached[part.within]
            np.testing.assert_array_equal(of_part[inside], factors[part.within][inside], err_msg=f"seed {SEED}")


@pytest.mark.parametrize("periodic", [(), (0,), (0, 1)])
@pytest.mark.parametrize("count", [1, 2, 4])
def test_boxes_are_widened_by_the_values_of_their_neighbours(count, periodic):
    """Beyond the lattice by those at its edges, or by those on the other side."""
    values, reach = np.random.default_rng(count).standard_normal((13, 17)), (2, 3)
    widened = values
    for axis, m in enumerate(reach):
        widths = [(m * (a == axis),) * 2 for a in range(2)]
        widened = np.pad(widened, widths, mode="wrap" if axis in periodic else "edge")
    boxes = decompose(values.shape, count, reach, {}, frozenset(periodic))

    def of_box(group):
        box = tuple(slice(*ends) for ends in boxes.ranges(group.number))
        return _widened(values[box], boxes, reach, group)

    for number, of_process in enumerate(on_threads(count, of_box)):
        box = tuple(slice(a, b + 2 * m) for (a, b), m in zip(boxes.ranges(number), reach, strict=True))
        np.testing.assert_array_equal(of_process, widened[box])


VARYING = {"young": "where(x > 0, 1, 2)", "poisson": "0.2 + 0*x", "density": "1 + 0*x", "critical_stretch": "1 + 0*x"}


@pytest.mark.parametrize(
    "model", [fh.Elastic(fh.Kernel(2.0), young="where(x > 0, 1, 2)"), fh.Correspondence(fh.Kernel(2.0), **VARYING)]
)
def test_the_memory_for_constants_is_checked_before_they_are_evaluated(model, monkeypatch):
    setup = fh.Simulation(fh.Lattice(1.0, (-200, -200), (200, 200)), model, boundary=fh.Fixed()).setup
    tracemalloc.start()
    reference_and_variation(setup, module.ALONE)
    needed = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    need = []
    monkeypatch.setattr(module, "check_fits", lambda *given: need.append(given[0]))
    reference_and_variation(setup, module.ALONE)
    assert 0.5 * need[0] <= needed <= need[0]
    monkeypatch.undo()
    monkeypatch.setattr("farhorizon.machine.available_memory", lambda: needed // 3)
    monkeypatch.setattr("farhorizon.machine._FEW", 0)
    with pytest.raises(fh.InputError, match="constants at 160801 nodes do not fit into memory"):
        reference_and_variation(setup, module.ALONE)


def test_a_body_without_a_node_is_refused_on_all_processes(monkeypatch):
    """Large bodies are not examined earlier, when the lattice is made."""
    monkeypatch.setattr(lattices, "_AT_ONCE", 0)
    lattice = fh.Lattice(1.0, (0.0, 0.0), (29.0, 14.0), body=fh.Disc(0.2, (3.5, 3.5)))
    setup = fh.Setup(lattice, fh.Wave(KERNEL, "1 + x"), fh.Free())
    with pytest.raises(fh.InputError, match="no node lies in the window or body"):
        on_threads(2, lambda group: reference_and_variation(setup, group))


def test_a_stiff_inclusion_leaves_the_medium_of_waves_that_come_from_outside():
    """The reference is the medium of most nodes, in which boxes of incident waves have to lie, not the stiffest one."""
    lattice = fh.Lattice(1.0, (-20.0, -20.0), (20.0, 20.0))
    inclusion = {name: lambda x, y: np.where(x**2 + y**2 < 36, 2.0, 1.0) for name in ("speed", "density")}
    wave = fh.IncidentWave((1.0, 0.0), "sin(pi*t/20)**4", 20.0, within=fh.Box((-15, -15), (15, 15)))
    sim = fh.Simulation(lattice, fh.Wave(KERNEL, **inclusion), fh.LatticePML(nodes=6), sources=[wave])
    assert (sim.model.speed, sim.model.density) == (1.0, 1.0)

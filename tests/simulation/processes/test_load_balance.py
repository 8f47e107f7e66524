"""Work of nodes, by which a lattice is divided: against the bonds that the engine counts, and box by box."""

import os
from dataclasses import replace

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.geometry.decomposition import Decomposition
from farhorizon.simulation.processes.halo_volume import cost_of_boxes, rows_on_processes
from farhorizon.simulation.processes.load_balance import cost_along, cost_per_node, costs_of
from farhorizon.simulation.processes.subdomain import boxes_of, cost_beyond

KERNEL = fh.Kernel(2.0)
LAYERED = "where(y < 30.5, 1.0, 2.0)"
SOLID = fh.Elastic(KERNEL, 1.0, critical_stretch=0.01)


def plane(model, shape=(61, 54), body=None, **more):
    lattice = fh.Lattice(1.0, (0.0, 0.0), [n - 1.0 for n in shape], body=body)
    sides = fh.LatticePML(nodes=6) if body is None else fh.Free()
    return fh.Simulation.of(fh.Setup(lattice, model, sides, **more))


def band(low, high, ends=(5.5, 30.5)):
    """Cracks one above the other."""
    return [[(ends[0], y), (ends[1], y)] for y in np.arange(low + 0.5, high, 3.0)]


def busiest(run, boxes):
    """Return the work of the busiest box relative to the mean."""
    beyond = cost_beyond(run.parts.layered, run.stencil, run.lattice)
    work = cost_of_boxes(boxes, cost_per_node(run.setup, run.model, run.lattice), beyond)
    return work.max() / work.mean()


def equal(run, topology):
    """Boxes of equal numbers of nodes, including layers, whatever the work of each node."""
    beyond = cost_beyond(run.parts.layered, run.stencil, run.lattice)
    cuts = []
    for axis, (n, count) in enumerate(zip(run.lattice.shape, topology, strict=True)):
        low, high = beyond[axis, -1], beyond[axis, 1]
        ends = [round(i * (low + n + high) / count - low) for i in range(count + 1)]
        cuts.append((0, *ends[1:-1], n))
    return Decomposition(tuple(cuts), frozenset())


@pytest.mark.parametrize(
    "given",
    [
        {"cracks": [[(10.3, 8.2), (31.7, 33.4)], [(40.5, 3.0), (40.5, 20.0)]]},
        {"body": fh.Box((-1.0, -1.0), (70.0, 70.0)) - fh.Disc(9.0, (21.0, 33.0))},
    ],
)
def test_nodes_that_lack_bonds_are_those_of_the_engine(given):
    """All of those at a crack; at a rim at least these, because it is examined box by box."""
    run = plane(SOLID, **given)
    costs, work = costs_of(run.setup, run.model), cost_per_node(run.setup, run.model, run.lattice)
    lacks = np.nan_to_num(run.fields["damage"]) > 0
    lacks |= np.nan_to_num(run.parts.breaking.families, nan=99) < run.parts.breaking.families.max()
    inner = (slice(3, -3),) * 2  # bonds across free sides are not counted
    more = work[inner] > costs.node
    assert (
        lacks[inner].sum() > 100
        and (more | ~lacks[inner] | (~run.lattice.mask[inner] if given.get("body") else False)).all()
    )
    if "cracks" in given:
        np.testing.assert_array_equal(more, lacks[inner])


@pytest.mark.parametrize("model", [fh.Wave(fh.Kernel(3.0), LAYERED), fh.Elastic(fh.Kernel(3.0), LAYERED)])
def test_nodes_whose_bonds_see_several_media_have_more_work(model):
    """Those within one reach of an interface, here across the rows, but not those beside a hole."""
    body = fh.Box((-1.0, -1.0), (70.0, 70.0)) - fh.Disc(6.0, (12.0, 32.0))
    lattice = fh.Lattice(1.0, (0.0, 0.0), (60.0, 60.0), body=body)
    run = fh.Simulation(lattice, model, fh.Free())
    values = np.where(lattice.coordinates()[1] < 30.5, 1.0, 2.0)
    high, low = (
        np.lib.stride_tricks.sliding_window_view(np.pad(np.where(lattice.mask, values, none), 3, "edge"), (7, 7))
        for none in (0.0, 9.0)
    )
    several = (low.min((2, 3)) < high.max((2, 3))) & lattice.mask
    costs = costs_of(run.setup, run.model)
    beside = cost_per_node(run.setup, run.model, lattice) - cost_per_node(
        replace(run.setup, model=run.model), run.model, lattice
    )
    np.testing.assert_array_equal(beside > 0, several)
    np.testing.assert_array_equal(beside[22:][several[22:]], sum(costs.uneven))  # behind the hole rows see one medium
    assert 4 * 61 < several.sum() < 6 * 61


def test_parts_have_the_work_of_the_whole():
    """Also where bonds reach into the next part, in the plane, and for metal in space."""
    metal = fh.Specimen(fh.Ball(5.0, (9.0, 8.0, 7.0)))
    solid = fh.Setup(
        fh.Lattice(1.0, (0, 0, 0), (19, 17, 18)), fh.Corrosion(fh.Kernel(2.0), saturation=0.5), specimens=[metal]
    )
    for setup in (plane(SOLID, cracks=band(3.0, 20.0)).setup, solid):
        work = cost_per_node(setup, setup.model, setup.lattice)
        assert len(np.unique(work)) > 1
        for cut in (4, 9, 13):
            ends = [[(0, cut), (cut, work.shape[0])], *([(0, n)] for n in work.shape[1:])]
            rows = [
                cost_per_node(setup, setup.model, setup.lattice.part([x, *(e[0] for e in ends[1:])])) for x in ends[0]
            ]
            np.testing.assert_array_equal(np.concatenate(rows), work)


SEED = int(os.environ.get("FARHORIZON_SEED", np.random.default_rng().integers(2**31)))


@pytest.mark.parametrize("case", range(8))
def test_uneven_boxes_are_more_even_in_work(case):
    """Off-centre bands of cracks, holes and metal at random places, with bonds that break and with stencils alone."""
    print(f"seed {SEED}")
    rng = np.random.default_rng([SEED, case])
    at, count = rng.integers(0, 9), int(rng.integers(2, 4))
    kind = ("cracks", "hole", "metal", "breaking")[case % 4]
    shape = tuple(rng.integers(90, 130, 2).tolist())
    if kind == "hole":
        body = fh.Box((-1.0, -1.0), (199.0, 199.0))
        for k in range(6):
            body -= fh.Disc(3.0, (at + 8.0 * (k % 2), 8.0 + 9.0 * (k // 2)))
        run = plane(SOLID, shape, body)
    elif kind == "metal":
        metal = [fh.Specimen(fh.Box((10.0, y + 0.5), (shape[0] - 10.0, y + 3.5))) for y in range(at + 4, at + 24, 7)]
        run = plane(fh.Corrosion(KERNEL, saturation=0.5), shape, specimens=metal)
    else:
        run = plane(SOLID if kind == "breaking" else fh.Wave(KERNEL), shape, cracks=band(at + 6, at + 20))
    for topology in ([1, count], [2, 2]):
        boxes = boxes_of(run.setup, run.model, run.parts.layered, int(np.prod(topology)), topology)
        words = f"seed {SEED}, {kind}, {topology}: {boxes.cuts}"
        before, now = busiest(run, equal(run, topology)), busiest(run, boxes)
        assert boxes.cuts != equal(run, topology).cuts and now < before, words
        if topology[0] == 1:  # cut along one axis, only the work of a row remains
            along = cost_along(run.setup, run.model, cost_beyond(run.parts.layered, run.stencil, run.lattice))[1]
            assert now - 1 <= along.max() * count / along.sum() + 0.01, words


def test_uniform_media_are_cut_as_ever():
    run = plane(fh.Wave(KERNEL))
    for topology in ([1, 3], [2, 2], [4, 1]):
        boxes = boxes_of(run.setup, run.model, run.parts.layered, int(np.prod(topology)), topology)
        assert boxes.cuts == equal(run, topology).cuts


def test_check_tells_the_busiest_box():
    rows = dict(rows_on_processes(plane(SOLID, cracks=band(3.0, 20.0)), [1, 3]))
    assert "the busiest has 1" in rows["3 processes"] and "of the mean work" in rows["2 processes"]

"""Media that vary: where they are uniform within the reach of bonds, the sweep with weights of their own agrees with
the sum bond by bond.
"""

import os

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.engine.layout import with_defaults
from farhorizon.engine.media import media_of
from farhorizon.engine.tables import Media
from farhorizon.medium.integrators import Euler, RungeKutta4, Verlet
from helpers import check_apply, kernel_stencil, periodic_engine

SEED = int(os.environ.get("FARHORIZON_SEED", 20261125))


def blocks(random, shape):
    """Strata, boxes of other media, and some nodes with values of their own."""
    axis = int(random.integers(len(shape)))
    edges = random.integers(0, shape[axis], 2)
    coefficients = np.ones(shape)
    coefficients[(slice(None),) * axis + (slice(*sorted(edges)),)] = 2.5
    for _ in range(3):
        first = [int(random.integers(n)) for n in shape]
        coefficients[tuple(slice(a, a + int(random.integers(2, 9))) for a in first)] = random.choice([0.4, 1.0, 3.0])
    alone = tuple(random.integers(n, size=2) for n in shape)
    coefficients[alone] = random.uniform(0.5, 2, 2)
    return coefficients


@pytest.mark.parametrize("rule", ["both", "arithmetic", "harmonic"])
@pytest.mark.parametrize(("shape", "reach"), [((60,), 3), ((33, 41), 2), ((15, 17, 23), 2)])
@pytest.mark.parametrize("real", ["float64", "float32"])
def test_the_operator_is_the_sum_over_bonds(shape, reach, rule, real):
    random = np.random.default_rng([SEED, len(shape)])
    print("seed", SEED)
    engine = check_apply(
        shape, kernel_stencil(len(shape), reach), real=real, coefficient=blocks(random, shape), rule=rule
    )
    media = engine.tables.media.pieces[:, 4]
    assert media.max() >= 1
    assert media.min() == -1


@pytest.mark.parametrize("shape", [(40, 33), (9, 14, 21)])
def test_each_node_is_summed_once(shape):
    """A node is swept with the weights of its medium where all nodes within reach are of the same one, otherwise bond
    by bond.
    """
    random = np.random.default_rng([SEED, 5])
    print("seed", SEED)
    reach, values = 2, blocks(random, shape)
    engine = periodic_engine(shape, kernel_stencil(len(shape), reach), Euler.stages(0.1), 0.1, values)
    media, sweep, lead = engine.tables.media, engine.tables.sweep, 3 - len(shape)
    grown = np.pad(values, reach, mode="wrap").reshape([n + 2 * reach * (n > 1) for n in (1,) * lead + shape])
    box = engine.layout.box
    mixed = media.mixed[box.node_indices()] == 1
    uniform, summed = np.zeros((2, *mixed.shape), int)
    for part in range(len(media.ranges) - 1):
        i0 = part % sweep.block[1]
        for first, end, start, stop, medium in media.pieces[media.ranges[part] : media.ranges[part + 1]]:
            assert part // sweep.block[1] * sweep.depth <= first < end <= box.nodes[1]
            assert 0 <= start < stop <= box.nodes[2]
            (summed if medium < 0 else uniform)[i0, first:end, start:stop] += 1
    widths = [2 * reach + 1 if n > 1 else 1 for n in mixed.shape]
    around = np.lib.stride_tricks.sliding_window_view(grown, widths)
    assert np.array_equal(mixed, np.ptp(around.reshape(*mixed.shape, -1), axis=-1) > 0)
    assert np.array_equal(uniform == 1, ~mixed)
    assert uniform.max() == 1
    assert (summed[mixed] == 1).all()
    assert summed.max() == 1


@pytest.mark.parametrize(
    ("model", "dim"),
    [
        (lambda v: fh.Wave(fh.Kernel(2.0), v), 1),
        (lambda v: fh.Wave(fh.Kernel(3.0), v, density=v), 2),
        (lambda v: fh.Wave(fh.Kernel(2.0), v), 3),
        (lambda v: fh.Elastic(fh.Kernel(2.0, 1), v), 2),
        (lambda v: fh.Elastic(fh.Kernel(2.0, 1), v, poisson=0.3, material="state-based"), 2),
        (lambda v: fh.Diffusion(fh.Kernel(2.0), integrator="rk4"), 2),
    ],
)
@pytest.mark.parametrize("boundary", [fh.Fixed(), fh.LatticePML(nodes=4)])
def test_runs_are_those_of_bonds_one_by_one(model, dim, boundary):
    """Strata that run into layers, with a free side, a crack and several stages."""
    shape = {1: (61,), 2: (31, 37), 3: (13, 17, 19)}[dim]
    axis, middle = "xyz"[dim - 1], shape[-1] // 2
    medium = f"where({axis} > {middle + 2}, 2.0, 1.0)"
    made = model(medium)
    lattice = fh.Lattice(1.0, (0.0,) * dim, [n - 1.0 for n in shape])
    pulse = "exp(-(" + "+".join(f"({a} - {n // 2})**2" for a, n in zip("xyz", shape, strict=False)) + ")/3)"
    across = {"x": boundary, f"{axis}-": fh.Free()} if dim == 2 and made.order == 2 else {}
    sides = dict.fromkeys("xyz"[:dim], boundary)
    if across:
        sides = {"x": boundary, "y-": fh.Free(), "y+": boundary}
    varied = {"coefficient": medium} if made.order == 1 else {}
    given = [pulse] * dim if isinstance(made, fh.Elastic) else pulse
    cracks = [[(12.3, 14.2), (17.1, 20.4)]] if dim == 2 else []
    runs = []
    for alone in (False, True):
        sim = fh.Simulation(lattice, made, sides, {"u": given}, cracks=cracks, threads=1, **varied)
        assert sim.engine.tables.media.function != 0
        if alone:
            sim.engine.replace(media=with_defaults(Media, sim.engine.dtype))
        sim.step(30)
        runs.append(sim.fields["u"])
    assert np.abs(runs[0] - runs[1]).max() <= 1e-12 * np.abs(runs[1]).max()
    assert np.abs(runs[1]).max() > 1e-3


def test_a_graded_medium_has_none():
    values = np.random.default_rng(2).uniform(1, 2, (20, 21))
    engine = periodic_engine((20, 21), kernel_stencil(2, 2), Verlet.stages(0.1, 0.0, False), 0.1, values)
    assert engine.tables.media.function == 0
    assert media_of(engine).pieces.size == 0


def test_pieces_follow_the_parts_of_the_box():
    """This covers rows that are swept in different numbers at a time."""
    values = np.where(np.arange(40)[:, None] > 17, 2.0, np.ones((40, 21)))
    engine = periodic_engine((40, 21), kernel_stencil(2, 2), RungeKutta4.stages(0.1), 0.1, values)
    engine.sweep_in_pieces(7)
    sweep, media = engine.tables.sweep, engine.tables.media
    assert len(media.ranges) - 1 == sweep.block[1] * -(-sweep.block[2] // sweep.depth)
    assert (np.diff(media.ranges) > 0).all()

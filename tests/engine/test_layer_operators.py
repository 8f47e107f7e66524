"""Thermal strain in the layers of a solid: the forces that it causes and the traces of stresses, by the compiled loop
and by the definitions.
"""

import os

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.engine.features.thermal_strain import give_thermal_strain_beyond
from interpreter import Interpreter

SEED = int(os.environ.get("FARHORIZON_SEED", np.random.SeedSequence().entropy % 2**32))
LAYER, SPACE = fh.LatticePML(nodes=4), fh.Kernel(1.5, exponent=1)


def solid(shape, sides, kernel=SPACE, young=1.0, real="float64", of=None, **more):
    """A solid whose temperature continues through its layers."""
    lattice = fh.Lattice(1.0, (0.0,) * len(shape), [n - 1.0 for n in shape])
    heat = fh.Heat(fh.Kernel(1.5), specific_heat=0.5, conductivity=0.1)
    model = fh.Thermoelastic(fh.Elastic(kernel, young, **(of or {})), heat, 0.02, 300.0)
    sim = fh.Simulation(lattice, model, sides, dtype=real, **more)
    assert sim.parts.thermoelastic
    return sim


PLANE = fh.Kernel(2.0, exponent=1)
STATES = {"material": "state-based", "poisson": 0.3}
STRESSES = {"material": "correspondence", "poisson": 0.1, "stabilisation": 0.5}
CASES = {
    "corners": lambda: solid((9, 10), LAYER, PLANE),
    "one layer and free faces": lambda: solid(
        (9, 12), {"x-": fh.Free(), "x+": LAYER, "y-": fh.Free(), "y+": LAYER}, PLANE
    ),
    "crack across, strata": lambda: solid(
        (12, 13),
        {"x": LAYER, "y": fh.Periodic()},
        PLANE,
        "1 + 0.5*(y > 4)",
        cracks=[fh.Crack([(5.2, 7.5), (30.0, 7.5)])],
    ),
    "crack along the last axis": lambda: solid(
        (12, 13), {"x": fh.Free(), "y": LAYER}, PLANE, cracks=[fh.Crack([(5.5, 5.2), (5.5, 30.0)])]
    ),
    "states, corners": lambda: solid((9, 10), LAYER, PLANE, of=STATES),
    "stresses and springs, free faces": lambda: solid(
        (9, 12), {"x-": fh.Free(), "x+": LAYER, "y-": fh.Free(), "y+": LAYER}, PLANE, of=STRESSES
    ),
    "stresses and springs, crack across": lambda: solid(
        (12, 13), {"x": LAYER, "y": fh.Periodic()}, PLANE, of=STRESSES, cracks=[fh.Crack([(5.2, 7.5), (30.0, 7.5)])]
    ),
    "in space": lambda: solid((6, 7, 8), {"x": LAYER, "y": fh.Free(), "z": LAYER}),
    "in space, corners": lambda: solid((6, 6, 7), LAYER, real="float32"),
}


@pytest.mark.sampled(4)
@pytest.mark.parametrize("make", CASES.values(), ids=CASES)
def test_both_compute_the_same(make):
    """From random displacements and strains on all nodes, fields agree to rounding step after step."""
    print("seed", SEED)
    random, found = np.random.default_rng(SEED), []
    sims = make(), make()
    sims[1].engine.loop = Interpreter(sims[1].engine)
    box = sims[0].engine.layout.box.node_indices().ravel()
    box = box[sims[0].engine.absent.exists[box]]
    start = random.standard_normal((2, len(sims[0].engine.all_components(box))))
    strains = random.standard_normal((4, len(box)))
    for sim in sims:
        engine, rows = sim.engine, []
        engine.levels[:2, engine.all_components(box)] = start
        for strain in strains:
            give_thermal_strain_beyond(engine, box, strain)
            if engine.passes is None:  # the program of definitions makes states where it needs forces of them
                rows.append(engine.bonds.traces(engine.current)[box])
            engine.advance(1)
            rows.append(engine.current[engine.all_components(box)])
        found.append(rows)
    digits = 1e-12 if sims[0].engine.dtype == np.float64 else 1e-4
    for one, two in zip(*found, strict=True):
        np.testing.assert_allclose(one, two, rtol=0, atol=digits * np.abs(one).max())


@pytest.mark.parametrize("make", CASES.values(), ids=CASES)
def test_traces_are_the_adjoint_of_pushes(make):
    """The forces of a strain on a displacement are adjoint to the traces of the displacement, for nodes beyond the
    reach of layers, where shifts are plain.
    """
    print("seed", SEED)
    random, sim = np.random.default_rng(SEED + 1), make()
    engine = sim.engine
    box = engine.layout.box.node_indices().ravel()
    box = box[engine.absent.exists[box]]
    u, strain = np.zeros_like(engine.current), random.standard_normal(len(box)).astype(engine.dtype)
    inner = engine.core.node_indices()[tuple(slice(3, -3) if n > 7 else slice(None) for n in engine.core.nodes)].ravel()
    places = engine.all_components(inner[engine.absent.exists[inner]])
    u[places] = random.standard_normal(len(places))
    traces = engine.bonds.traces(u.copy(), apart=True)[box]
    give_thermal_strain_beyond(engine, box, 0 * strain)
    cold = engine.apply(u.copy())
    give_thermal_strain_beyond(engine, box, strain)
    pushes = engine.apply(u.copy()) - cold
    digits = 1e-11 if engine.dtype == np.float64 else 1e-4
    assert abs((traces * strain).sum() - (u * pushes).sum()) < digits * np.abs(traces * strain).sum()

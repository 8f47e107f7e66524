"""Bodies thinner than the stencil between free or fixed sides, against the same ones in wider lattices."""

import numpy as np
import pytest

import farhorizon as fh

KERNEL = fh.Kernel(2.0, 1)
STATES = {"material": "state-based", "poisson": 0.2}
MODELS = {
    "wave": fh.Wave(KERNEL),
    "bonds": fh.Elastic(KERNEL, 1.0),
    "bonds that break": fh.Elastic(KERNEL, 1.0, critical_stretch=0.02),
    "states": fh.Elastic(KERNEL, 1.0, **STATES),
    "states that break": fh.Elastic(KERNEL, 1.0, critical_stretch=0.02, **STATES),
    "gradients": fh.Elastic(KERNEL, 1.0, 0.3, material="correspondence", stabilisation=0.4),
    "corrected": fh.Elastic(KERNEL, 1.0, surface="energy", critical_stretch=0.02),
}
PADDING = 14  # nodes beyond each face: twice the reach of the widest stencil and more


def strip(model, nodes, sides, body):
    """A strip of some nodes along y, by itself or as the body of a lattice that is wider."""
    more = PADDING if body else 0
    shape = fh.Box((-99.0, -0.5), (99.0, nodes - 0.5)) if body else None
    lattice = fh.Lattice(1.0, (-20.0, -float(more)), (20.0, nodes - 1.0 + more), body=shape)
    pull, bump = ["0.002*x*(1 + 0.1*y)", "1e-3*y"], "exp(-x**2/8)*(1 + y)"
    if not isinstance(sides, fh.Free):  # what layers absorb begins inside
        pull = [bump, bump]
    start = {"v": pull if isinstance(model, fh.Elastic) else bump}
    sim = fh.Simulation(lattice, model, {"x": sides, "y": fh.Free()}, start, threads=1, dt=0.35)
    sim.run(until=100.0, allow_unstable=True, progress=False)
    return sim, sim.fields["u"][..., more : more + nodes]


@pytest.mark.parametrize("nodes", [1, 2, 4])
@pytest.mark.parametrize("name", MODELS)
def test_a_thin_lattice_is_the_thin_body_of_a_wide_one(name, nodes):
    sim, found = strip(MODELS[name], nodes, fh.Free(), False)
    other, expected = strip(MODELS[name], nodes, fh.Free(), True)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * np.abs(expected).max())
    if "break" in name:
        assert sim.broken_bonds == other.broken_bonds > 20
    assert sim.lattice.shape[1] == nodes < sim.stencil.reach[1] * 2 + 1


@pytest.mark.parametrize("name", ["bonds", "states"])
def test_thin_bodies_run_into_layers(name):
    _, found = strip(MODELS[name], 2, fh.LatticePML(nodes=12), False)
    _, expected = strip(MODELS[name], 2, fh.LatticePML(nodes=12), True)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["wave", "bonds", "states", "gradients"])
def test_thin_bodies_may_be_fixed(name):
    """Against a lattice whose nodes beyond a side are held at zero."""
    model, vector = MODELS[name], name != "wave"
    zero = [0.0, 0.0] if vector else 0.0
    for nodes in (1, 3):
        held = [fh.Prescribed(fh.Box((-99.0, -99.0), (99.0, -0.5)), zero)]
        held += [fh.Prescribed(fh.Box((-99.0, nodes - 0.5), (99.0, 99.0)), zero)]
        fields = []
        for more, sides, constraints in ((0, fh.Fixed(), []), (PADDING, fh.Free(), held)):
            lattice = fh.Lattice(1.0, (0.0, -float(more)), (19.0, nodes - 1.0 + more))
            bump = f"exp(-(x - 9)**2/8)*where((y > -0.5)*(y < {nodes - 0.5}), 1, 0)"
            start, around = {"u": [bump, bump] if vector else bump}, {"x": fh.Periodic(), "y": sides}
            sim = fh.Simulation(lattice, model, around, start, constraints=constraints, threads=1, dt=0.3)
            sim.run(until=30.0, progress=False)
            fields.append(sim.fields["u"][..., more : more + nodes])
        np.testing.assert_allclose(*fields, rtol=0, atol=1e-11 * np.abs(fields[1]).max())


def test_other_sides_need_a_wider_near_field():
    with pytest.raises(fh.InputError, match="thinner than the stencil"):
        fh.Simulation(fh.Lattice(1.0, (-9.0, 0.0), (9.0, 2.0)), MODELS["bonds"], {"all": fh.LatticePML(nodes=8)})

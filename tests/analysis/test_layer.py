"""What a layer sends back by its own equations, against the engine's complete map."""

import pytest

import farhorizon as fh
from farhorizon.analysis.layer import LayerSide
from farhorizon.strip import Strip, pinned

SCALAR = [(1, fh.Kernel(3.0, 0)), (2, fh.Kernel(3.0, 1)), (2, fh.Stencil.finite_element(2)), (3, fh.Kernel(2.0))]
VECTORS = [
    (2, fh.Elastic(fh.Kernel(3.0, 1), young=1.0)),
    (2, fh.Elastic(fh.Kernel(2.0, 1), young=1.0, poisson=0.3, material="state-based")),
    (2, fh.Elastic(young=1.0, poisson=0.3, material="finite-element")),
    (3, fh.Elastic(fh.Kernel(1.0, 1), young=1.0)),
]


@pytest.mark.parametrize("dim, model", [(dim, fh.Wave(operator, damping=0.01)) for dim, operator in SCALAR] + VECTORS)
def test_the_layers_equations_are_what_the_engine_steps(dim, model):
    """Every type of wave into every type, damped short waves included."""
    reach = max(model.stencil(1.0, dim).reach)
    lattice = fh.Lattice(1.0, (0.0,) * dim, (2.0 * reach + 2,) * dim)
    sim = fh.Simulation(lattice, model, boundary=fh.LatticePML(nodes=9))
    layer = sim.engine.layers[3 - dim, 1]
    assert layer.damping.max() > 0
    strip = Strip(sim, 0, 2 * reach + 2, (fh.Fixed(), pinned(sim)[0, 1]))
    side = LayerSide(strip.medium, layer)
    for wavelength, angle in ((9.0, 0.0), (14.0, 35.0), (40.0, 75.0)):
        if dim == 1 and angle:
            continue
        for incoming in side.types:
            given, azimuth = (wavelength, angle), 30.0 if dim == 3 else 0.0
            expected = strip.reflections(*given, azimuth, incoming=incoming)
            found = side.reflections(*given, azimuth, incoming=incoming)
            assert found.keys() == expected.keys()
            assert all(abs(found[k] - expected[k]) <= 1e-6 * abs(expected[k]) + 1e-12 for k in expected), (incoming, found, expected)

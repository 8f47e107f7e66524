"""The compiled loop calls each operation by its address; an operation is compiled when a run first needs it."""

import copy

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.engine import loop, passes
from helpers import lattice_of

WAVE = fh.Wave(fh.Kernel(2.0))
#: Two components that are not coupled.
ALIKE = fh.Elastic(fh.Stencil([(1, 0), (-1, 0), (0, 1), (0, -1)], np.tile(np.eye(2), (4, 1, 1))), 1.0)
LAYERS = {"continue_band", "add_mirrored_bands", "stretch_faces", "stretch_face"}
#: What these runs compile besides the sweep of a box.
RUNS = {
    "wave": ((12, 12), WAVE, fh.Fixed(), {"stencil_part"}),
    "layers": ((12, 12), WAVE, fh.LatticePML(nodes=4), {"stencil_part", *LAYERS}),
    "space": ((12, 12, 12), WAVE, fh.LatticePML(nodes=4), {"stencil_part", *LAYERS, "stretch_edge", "filter_layers"}),
    "alike": ((12, 12), ALIKE, fh.Fixed(), {"stencil_part"}),
    "sponge": ((12, 12), WAVE, fh.Sponge(3), {"stencil_part", "damp_old", "damp_new"}),
    "metal": ((12, 12), fh.Corrosion(fh.Kernel(2.0), saturation=0.5), fh.Fixed(), {"phases_part", "dissolve_nodes"}),
}


def test_every_operation_has_a_function():
    """Operations on layers may have several functions."""
    operations = {value for name, value in vars(passes).items() if name.isupper() and isinstance(value, str)}
    assert {*passes.OPERATIONS, passes.LINES, passes.STRETCH} == operations


@pytest.mark.parametrize(("shape", "model", "side", "found"), RUNS.values(), ids=RUNS)
def test_a_run_compiles_what_it_has(shape, model, side, found, monkeypatch):
    monkeypatch.setattr(loop, "_FUNCTIONS", {})
    fh.Simulation(lattice_of(shape), model, side).step(2)
    assert {function.__name__ for function, _ in loop._FUNCTIONS} - {"general_rows"} == {"sweep_box", *found}


def test_types_are_those_of_the_precision(monkeypatch):
    """The types do not depend on the run, so that what is compiled once serves all others."""
    monkeypatch.setattr(loop, "_FUNCTIONS", {})
    for shape in ((12,), (12, 12), (12, 12, 12)):
        fh.Simulation(lattice_of(shape), WAVE, fh.LatticePML(nodes=4), initial={"u": 0.0}).step(2)
    solid = fh.Elastic(fh.Kernel(2.0), 1.0, 0.3, material="state-based")
    fh.Simulation(lattice_of((12, 12)), solid, fh.LatticePML(nodes=4)).step(2)
    names = [function.__name__ for function, _ in loop._FUNCTIONS]
    assert sorted(names) == sorted(set(names))


def test_a_copy_has_calls_of_its_own():
    """The calls contain addresses of arrays; a copy with the same calls would write into the original."""
    sim = fh.Simulation(lattice_of((20, 20)), WAVE, fh.LatticePML(nodes=4), {"u": "exp(-((x-10)**2 + (y-10)**2)/8)"})
    sim.step(5)
    other = copy.deepcopy(sim)
    kept = sim.fields["u"].copy()
    other.step(7)
    np.testing.assert_array_equal(sim.fields["u"], kept)
    sim.step(7)
    np.testing.assert_array_equal(sim.fields["u"], other.fields["u"])

"""What is said of a run as it begins."""

import numpy as np
import pytest

import farhorizon as fh
from helpers import lattice_of

LOOSE = {"free": fh.Free(), "periodic": {"x": fh.Periodic(), "y": fh.Free()}}
HELD = {"fixed": fh.Fixed(), "layers": {"x": fh.LatticePML(nodes=4), "y": fh.Free()}}


def with_sides(sides, dtype, **initial):
    return fh.Simulation(lattice_of((17, 17)), fh.Wave(fh.Kernel(2.0)), sides, initial, dtype=dtype)


@pytest.mark.parametrize("sides", LOOSE.values(), ids=LOOSE)
def test_a_body_that_nothing_holds_is_no_case_for_single_precision(sides):
    """Which goes on as it was in double precision."""
    assert any("single precision" in note for note in with_sides(sides, "float32", v=1e-3).notes)
    exact = with_sides(sides, "float64", v=1e-3)
    assert not exact.notes
    exact.step(2000)
    np.testing.assert_allclose(exact.fields["v"], 1e-3, rtol=1e-6)


@pytest.mark.parametrize("sides", HELD.values(), ids=HELD)
def test_one_that_something_holds_is(sides):
    sim = with_sides(sides, "float32", u="exp(-((x - 8)**2 + (y - 8)**2)/4)")
    assert not any("single precision" in note for note in sim.notes)

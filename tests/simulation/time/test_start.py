"""Notes on a run as it begins, and initial data up to its sides."""

import os

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.references.infinite_lattice import InfiniteLattice
from helpers import lattice_of

SEED = int(os.environ.get("FARHORIZON_SEED", np.random.SeedSequence().entropy % 2**32))
LOOSE = {"free": fh.Free(), "periodic": {"x": fh.Periodic(), "y": fh.Free()}}
HELD = {"fixed": fh.Fixed(), "layers": {"x": fh.LatticePML(nodes=4), "y": fh.Free()}}
WAVES = fh.Wave(fh.Kernel(2.0))
SOLIDS = {"bond-based": {}, "state-based": {"poisson": 0.3}, "correspondence": {"poisson": 0.3, "stabilisation": 0.5}}


def with_sides(sides, dtype, model=WAVES, shape=(17, 17), constraints=(), **initial):
    return fh.Simulation(lattice_of(shape), model, sides, initial, constraints=constraints, dtype=dtype, threads=1)


@pytest.mark.parametrize("sides", LOOSE.values(), ids=LOOSE)
def test_a_body_that_nothing_holds_is_no_case_for_single_precision(sides):
    """A note says so; in double precision the velocity stays as it was."""
    assert any("single precision" in note for note in with_sides(sides, "float32", v=1e-3).notes)
    exact = with_sides(sides, "float64", v=1e-3)
    assert not exact.notes
    exact.step(2000)
    np.testing.assert_allclose(exact.fields["v"], 1e-3, rtol=1e-6)


@pytest.mark.parametrize("sides", HELD.values(), ids=HELD)
def test_one_that_something_holds_is(sides):
    sim = with_sides(sides, "float32", u="exp(-((x - 8)**2 + (y - 8)**2)/4)")
    assert not any("single precision" in note for note in sim.notes)


def test_a_body_is_held_by_some_of_its_nodes():
    held = [fh.Prescribed([(0.0, 0.0)], 0.0)]
    assert not any("single precision" in note for note in with_sides(fh.Free(), "float32", constraints=held).notes)


@pytest.mark.parametrize("damping", [0.0, 0.3])
@pytest.mark.parametrize("field", ["u", "v"])
def test_data_may_reach_up_to_the_sides(field, damping):
    """A near field that is displaced or struck as a whole, up to its last nodes and corners, against the infinite
    lattice.
    """
    model, values = fh.Wave(fh.Kernel(2.0), damping=damping), np.ones((13, 13))
    sim = with_sides(fh.LatticePML(nodes=20), "float64", model, (13, 13), **{field: values})
    rest = np.zeros_like(values)
    data = (values, rest) if field == "u" else (rest, values)
    infinite = InfiniteLattice(sim.stencil, 1.0, model.integrator, sim.dt, 90, *data, damping=damping)
    for steps in (1, 2, 10, 30, 90):
        sim.step(steps - sim.step_count)
        assert np.abs(sim.fields["u"] - infinite.after(steps)).max() < 1e-9


def test_data_at_the_sides_go_on_after_a_restart(tmp_path):
    """Saved after one step, when the layers have just begun."""
    sides, data = fh.LatticePML(nodes=8), {"u": np.ones((13, 13))}
    whole, first = (with_sides(sides, "float64", WAVES, (13, 13), **data) for _ in range(2))
    first.step(1)
    first.save(tmp_path / "one.h5")
    again = with_sides(sides, "float64", WAVES, (13, 13), **data)
    again.load(tmp_path / "one.h5")
    for sim in (whole, again):
        sim.step(40 - sim.step_count)
    np.testing.assert_array_equal(again.fields["u"], whole.fields["u"])


@pytest.mark.slow
def test_rounding_pushes_a_body_as_the_note_says():
    """Random bodies: like weak springs, whose work on a motion grows with the square of the number of steps."""
    rng = np.random.default_rng(SEED)
    print(f"seed {SEED}")
    for _ in range(6):
        dim = int(rng.integers(2, 4))
        shape = tuple(rng.integers(10, 25 if dim == 2 else 14, dim).tolist())
        material = rng.choice([None, *SOLIDS])
        solid = None if material is None else fh.Elastic(fh.Kernel(2.0, 1), 1.0, material=material, **SOLIDS[material])
        speed, sides = 10 ** rng.uniform(-4, 0), rng.choice([fh.Free(), fh.Periodic()])
        v = speed if solid is None else [speed] * dim
        sim, off = with_sides(sides, "float32", solid or WAVES, shape, v=v), []
        for steps in (2000, 8000):
            sim.step(steps - sim.step_count)
            off.append(abs(float(np.array(sim.fields["v"], float).mean()) / speed - 1))
        assert 3e-4 < off[0] < 0.3 and 6 < off[1] / off[0] < 40, (shape, material, sides, off)


@pytest.mark.parametrize("boundary", [fh.LatticePML(nodes=4), fh.Extended(1e-3, until=5.0)], ids=["layer", "extended"])
def test_components_may_be_given_in_different_ways(boundary):
    """An array beside a number, an expression or a function gives the same run as one array of all values."""
    lattice = lattice_of((13, 13))
    bell = "exp(-((x - 6)**2 + (y - 6)**2)/3)"
    values = np.exp(-sum((x - 6) ** 2 for x in lattice.coordinates()) / 3)
    solid, nothing = fh.Elastic(fh.Kernel(2.0), 1.0), np.zeros((13, 13))
    for given, whole in (
        ([values, 0.0], [values, nothing]),
        ((values, bell), [values, values]),
        ([lambda x, y: 0 * x, values], [nothing, values]),
        ([values, 2 * values], [values, 2 * values]),
    ):
        for name in ("u", "v"):
            runs = [fh.Simulation(lattice, solid, boundary, {name: one}, threads=1) for one in (given, np.array(whole))]
            for run in runs:
                run.run(until=2.0)
            np.testing.assert_allclose(runs[0].fields["u"], runs[1].fields["u"], rtol=0, atol=1e-14)


def test_each_component_is_looked_at_beyond_the_sides():
    lattice, solid = lattice_of((13, 13)), fh.Elastic(fh.Kernel(2.0), 1.0)
    values = np.exp(-sum((x - 6) ** 2 for x in lattice.coordinates()) / 3)
    with pytest.raises(fh.InputError, match="beyond the absorbing"):
        fh.Simulation(lattice, solid, fh.LatticePML(nodes=4), {"u": [values, "exp(-x**2)"]})
    ends = np.ones((13, 13))
    sim = fh.Simulation(lattice, solid, fh.LatticePML(nodes=4), {"u": ["exp(-((x - 6)**2 + (y - 6)**2)/3)", ends]})
    assert any("at an absorbing edge" in note for note in sim.notes)

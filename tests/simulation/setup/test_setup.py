"""A set-up is one value: kept as it is given, changed by `replace`, run by `Simulation.of`."""

import copy
import pickle
from dataclasses import FrozenInstanceError, fields, replace
from inspect import signature

import numpy as np
import pytest

import farhorizon as fh

LINE = fh.Lattice(1.0, -20, 20)
WAVE = fh.Wave(fh.Kernel(2.0))
GIVEN = {
    "lattice": LINE,
    "model": WAVE,
    "boundary": {"x-": fh.LatticePML(target=1e-4), "x+": fh.Free()},
    "initial": {"u": "exp(-x**2/8)"},
    "sources": ["exp(-x**2/8)*sin(t)"],
    "cracks": [12.5],
    "coefficient": 1 + (LINE.axes[0] > 5),
}


def test_it_has_the_arguments_of_a_simulation_in_their_order():
    around = {"observe", "communicator", "topology", "engine"}  # who looks at a run, and who computes it
    given = [name for name in signature(fh.Simulation).parameters if name not in around]
    assert [field.name for field in fields(fh.Setup)] == given


def test_a_set_up_runs_as_its_arguments_do():
    one, other = fh.Simulation(**GIVEN), fh.Simulation.of(fh.Setup(**GIVEN))
    for sim in (one, other):
        sim.run(20.0, progress=False)
    np.testing.assert_array_equal(one.fields["u"], other.fields["u"])
    assert one.notes == other.notes


def test_what_is_given_is_kept_and_what_was_chosen_is_beside_it():
    setup = fh.Setup(**GIVEN)
    sim = fh.Simulation.of(setup)
    assert sim.setup is setup and setup.dt is None and setup.sides[0, -1] == GIVEN["boundary"]["x-"]
    assert sim.thickness  # the layers are chosen now
    assert sim.settled.dt == sim.dt and sim.settled.sides[0, -1].nodes == sim.engine.layers[2, -1].columns
    again = fh.Simulation.of(sim.settled)  # all has been chosen: nothing is chosen again
    assert again.settled.sides[0, -1].nodes == sim.settled.sides[0, -1].nodes and not again.thickness
    np.testing.assert_array_equal(again.engine.memory.shape, sim.engine.memory.shape)


def test_it_is_frozen_and_replaced():
    setup = fh.Setup(**GIVEN)
    with pytest.raises(FrozenInstanceError):
        setup.background = 1.0
    changed = replace(setup, background=0.5)
    assert (setup.background, changed.background) == (0.0, 0.5)
    assert [crack.cut.x for crack in changed.cracks] == [12.5]
    assert changed.initial["u"] is setup.initial["u"]  # objects of the right kind are kept


def test_a_run_that_chooses_between_sides_keeps_what_was_given():
    sim = fh.Simulation(LINE, WAVE, fh.Auto(target=1e-3), {"u": "exp(-x**2/8)"})
    sim.prepare(50.0)
    assert set(sim.setup.sides.values()) == {fh.Auto(target=1e-3)}
    assert not any(isinstance(side, fh.Auto) for side in sim.settled.sides.values())


def test_what_cannot_be_pickled_is_told_and_copied():
    setup = fh.Setup(**{**GIVEN, "sources": [lambda x, t: 0 * x]})
    with pytest.raises(
        fh.InputError,
        match=r"sources: what is made in place, .*cannot be pickled; value: .*lambda.*remedy: an expression as a text",
    ):
        pickle.dumps(setup)
    assert copy.copy(setup).sources == setup.sources
    again = copy.deepcopy(setup)
    assert again.sources == setup.sources and again.initial["u"] is not setup.initial["u"]
    plain = fh.Setup(**GIVEN)
    assert pickle.loads(pickle.dumps(plain)).initial["u"].text == plain.initial["u"].text


@pytest.mark.parametrize("given", [np.float32, np.dtype("float32"), "float32"])
def test_types_of_numbers_are_those_of_numpy_too(given):
    assert fh.Setup(**GIVEN, dtype=given).dtype == "float32"


@pytest.mark.parametrize("load", [fh.Traction("y+", (0.0, 1.0)), fh.BodyForce([0.0, 1.0])])
def test_loads_are_told_from_sources(load):
    name = type(load).__name__
    with pytest.raises(fh.InputError, match=rf"source: a load is not a source.*remedy: loads=\[{name}\(\.\.\.\)\]"):
        fh.Setup(**{**GIVEN, "sources": [load]})
    with pytest.raises(fh.InputError, match=r"load\[0\]: must be a BodyForce.*remedy: sources=\[\.\.\.\]"):
        fh.Setup(**{**GIVEN, "loads": [fh.Source("exp(-x**2)")]})


def test_changes_of_what_there_is_not_are_told_the_nearest():
    with pytest.raises(fh.InputError, match=r"boundry: a set-up has no such argument.*did you mean 'boundary'"):
        fh.Simulation(**GIVEN).remade(boundry=fh.Fixed())


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"lattice": 1.0}, "lattice"),
        ({"model": "wave"}, "model"),
        ({"initial": {"u": "y"}}, "initial.u"),
        ({"sources": ["z*t"]}, "source"),
        ({"dtype": "int8"}, "dtype"),
        ({"rule": "mean"}, "rule"),
        ({"rim": "fixed"}, "rim"),
        ({"loads": [1.0]}, "load[0]"),
        ({"balance": "yes"}, "balance"),
        ({"boundary": {"x-": fh.Free()}}, "boundary"),
    ],
)
def test_other_kinds_are_refused_at_once(changes, key):
    with pytest.raises(fh.InputError) as refused:
        fh.Setup(**{**GIVEN, **changes})
    assert refused.value.key == key


@pytest.mark.parametrize("threads", [0, -3, 100_000])
def test_so_many_threads_are_none(threads):
    """One message serves for fewer than one and for more than there are."""
    with pytest.raises(fh.InputError, match=r"threads: not a number of threads that there are; .*limit: 1 to"):
        fh.Simulation(fh.Lattice(1.0, -4, 4), fh.Wave(fh.Kernel(1.0)), threads=threads)

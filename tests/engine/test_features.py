"""A feature of a step is one file: this one adds a stop for the field, which enters nothing else but the list."""

from typing import NamedTuple

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.engine import loop
from farhorizon.engine.feature import CHANGE, Feature, Step
from farhorizon.engine.feature_list import FEATURES, steps
from farhorizon.engine.features.held import HELD
from farhorizon.engine.layout import doubles, reals
from farhorizon.engine.passes import reads
from farhorizon.engine.state import as_before, digest, sums_of, take_sums
from farhorizon.engine.threads import barrier, chunk_of
from helpers import lattice_of
from interpreter import Interpreter


class Stops(NamedTuple):
    """The largest size of the values, and by how much values have exceeded it, by row."""

    most: np.ndarray = reals(0)
    excess: np.ndarray = doubles(0)


@reads("stops")
def stop(thread, stage, sums, tables, inputs, step, number):
    """Bring values that are too large back to the largest."""
    block, stops, out = sums.sweep.block, tables.stops, stage.out
    chunk = chunk_of(thread, block[1] * block[2])
    for row in range(chunk[0], chunk[1]):
        place = block[0] + row // block[2] * block[4] + row % block[2] * block[5]
        for node in range(place, place + block[3]):
            value = min(max(out[node], -stops.most[0]), stops.most[0])
            stops.excess[row] += abs(out[node] - value)
            out[node] = value
    barrier(thread)


STOPS = Feature(
    "stops",
    [Step(CHANGE, stop, lambda tables, *_: tables.stops.most.size)],
    table=Stops,
    map=lambda stops: (stops.most,),
    sums=lambda stops: {"excess": stops.excess[None]},
)


def set_stops(engine, most):
    rows = int(np.prod(engine.layout.box.nodes[:2]))
    engine.replace(stops=Stops(np.array([most], engine.dtype), np.zeros(rows)))


class Stopping(Interpreter):
    """The same in numpy."""

    def stop(self) -> None:
        stops, out = self.tables.stops, self.stage.out
        value = np.clip(out[self.nodes], -stops.most, stops.most)
        stops.excess[0] += np.abs(out[self.nodes] - value).sum()
        out[self.nodes] = value


@pytest.fixture
def listed():
    """The stop is in the list, before nodes are held."""
    FEATURES.insert(FEATURES.index(HELD), STOPS)
    yield
    FEATURES.remove(STOPS)


def wave(most=None, engine=None):
    initial = {"u": "2*exp(-((x-9)**2 + (y-8)**2)/4)"}
    sim = fh.Simulation(lattice_of((19, 18)), fh.Wave(fh.Kernel(2.0)), fh.Free(), initial, engine=engine)
    if most is not None:
        set_stops(sim.engine, most)
    return sim


def test_a_feature_is_one_file(listed):
    compiled, plain, free = wave(0.5), wave(0.5, Stopping), wave()
    for sim in (compiled, plain, free):
        sim.step(20)
    assert np.abs(compiled.fields["u"]).max() <= 0.5 < np.abs(free.fields["u"]).max()
    np.testing.assert_allclose(compiled.fields["u"], plain.fields["u"], rtol=0, atol=1e-13)
    assert sums_of(compiled.engine) == pytest.approx(sums_of(plain.engine), rel=1e-12)
    assert sums_of(compiled.engine)["excess/0"] > 1 and not sums_of(free.engine)


def test_its_state_is_that_of_the_engine(listed):
    sim, other = wave(0.5), wave(0.4)
    assert digest(sim.engine) != digest(other.engine)
    before = sums_of(sim.engine)
    with as_before(sim.engine):
        sim.engine.advance(5)
        assert sums_of(sim.engine) != before
    assert sums_of(sim.engine) == before
    take_sums(sim.engine, {"excess/0": 3.0})
    assert sums_of(sim.engine) == {"excess/0": 3.0}


def test_thermal_strains_are_restored():
    """They advance in each step, also in those that only measure how long a step takes."""
    load = fh.ThermalLoad("sin(x)*(1 + t)", expansion="1e-3", reference=0.0)
    sim = fh.Simulation(lattice_of((19, 18)), fh.Elastic(fh.Kernel(2.0), 1.0), fh.Free(), loads=[load])
    sim.step(2)
    before = sim.engine.get("heat.thermal_strain").copy()
    with as_before(sim.engine):
        sim.engine.advance(5)
        assert np.abs(sim.engine.get("heat.thermal_strain") - before).max() > 1e-4
    np.testing.assert_array_equal(sim.engine.get("heat.thermal_strain"), before)


def test_nothing_else_is_compiled_anew(listed):
    wave().step(2)
    before = set(loop._FUNCTIONS)
    wave(0.5).step(2)
    assert {function for function, _ in set(loop._FUNCTIONS) - before} <= {stop}


def test_names_differ():
    """Operations and tables are found by their names."""
    for names in ([step.name for step in steps()], [feature.name for feature in FEATURES]):
        assert len(names) == len(set(names))

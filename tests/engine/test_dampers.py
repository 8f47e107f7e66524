"""Dampers, masses attached to the nodes of layers, against their equations at one frequency."""

from dataclasses import replace

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.layers.reflection import LayerSide
from farhorizon.checks.reduced_setups import Strip
from farhorizon.engine.engine import Layer
from farhorizon.engine.features.dampers import response, springs_of, strengths_of
from farhorizon.engine.state import State
from interpreter import Interpreter

NODES = 4
DEPTH = (np.arange(NODES + 1) + 0.5) / (NODES + 1)
TUNED = Layer(
    1 + 0.5 * DEPTH, 2.0 * DEPTH, 0.01 + 0.3 * DEPTH**4, np.array([0.05, 0.2, 0.3, 0.7]), tuned=np.array([1.6, 0.5])
)
STILL = Layer(np.ones(NODES + 1), 0 * DEPTH, 0 * DEPTH, TUNED.damping, tuned=TUNED.tuned)  # dampers alone
OTHER = Layer(np.ones(NODES + 1), DEPTH, 0.01 * DEPTH, np.array([0.1, 0.1, 0.3, 0.2]), tuned=np.array([1.3, 0.9]))
BONDS = fh.Elastic(fh.Kernel(2.0, 1), young=1.0)
MEDIA = {
    "line": (fh.Wave(fh.Kernel(3.0, 0)), 1),
    "plane": (fh.Wave(fh.Kernel(2.0), damping=0.1), 2),
    "bonds": (BONDS, 2),
    "states": (fh.Elastic(fh.Kernel(2.0, 1), young=1.0, poisson=0.3, material="state-based"), 2),
    "correspondence": (
        fh.Elastic(fh.Kernel(2.0, 1), young=1.0, poisson=0.3, material="correspondence", stabilisation=0.4),
        2,
    ),
    "space": (BONDS, 3),
    "scalar in space": (fh.Wave(fh.Kernel(2.0)), 3),
}


def side(layer=TUNED):
    return fh.LatticePML(nodes=NODES, profile=layer)


def simulation(name, boundary=None, nodes=11, **more):
    model, dim = MEDIA[name]
    lattice = fh.Lattice(1.0, (0.0,) * dim, (nodes - 1.0,) * dim)
    if "u" not in more:
        square = sum((x - (nodes - 1) / 2 + 0.4) ** 2 for x in lattice.coordinates())
        pulse = np.exp(-square / 3) * (square < 4.0)  # the layers begin at rest
        more["u"] = pulse if isinstance(model, fh.Wave) else np.stack([pulse, -pulse, 2 * pulse][:dim])
    u = more.pop("u")
    return fh.Simulation(lattice, model, boundary or side(), {"u": u}, **({"threads": 1} | more))


@pytest.mark.parametrize("name", MEDIA)
def test_a_layer_sends_back_what_its_equations_say(name):
    """The step of the compiled loop against the force through the factor ``1 + strength g``."""
    strip = Strip(simulation(name), 0, 11)
    asked = {1: (0.0, 0.0), 2: (35.0, 0.0), 3: (35.0, 20.0)}[MEDIA[name][1]]
    for incoming in strip.types:
        of_strip = strip.reflections(7.0, *asked, incoming)
        of_equations = LayerSide(strip.medium, TUNED).reflections(7.0, *asked, incoming)
        assert max(map(abs, of_equations.values())) > 1e-5
        assert all(abs(of_strip[outgoing] - of_equations[outgoing]) < 1e-12 for outgoing in of_equations)


@pytest.mark.parametrize("dt", [0.05, 0.6, 1.2])
def test_dampers_take_energy_at_every_frequency(dt):
    """Slow waves are hardly affected, to second order in their frequency."""
    keep, pull = springs_of(np.array([1.4, 0.4]), dt)
    turn = np.linspace(1e-3, np.pi - 1e-3, 2001)
    taken = response(np.exp(1j * turn), keep, pull)
    assert (taken.imag > 0).all()
    slow = np.array([0.04, 0.02])
    sizes = np.abs(response(np.exp(1j * slow * dt), keep, pull))
    assert np.log2(sizes[0] / sizes[1]) == pytest.approx(2.0, abs=0.02)


@pytest.mark.parametrize("dt", [0.05, 0.6, 1.2])
def test_waves_of_the_springs_decay_at_the_rate_that_is_asked_for(dt):
    """Waves decay at half the rate, as with damping of the velocity: the roots of the scheme of one node, from their
    polynomial.
    """
    frequency, rate = 1.4, 1e-3
    keep, pull = springs_of(np.array([frequency, 0.4]), dt)
    strength = float(strengths_of(np.array([rate]), keep, pull, dt)[0])
    move, spring = np.array([1.0, -1.0]), np.array([1.0, -(1 + keep - pull), keep])
    square = (frequency * dt) ** 2
    scheme = np.polyadd(
        np.polymul(np.polymul(move, move), spring),
        square * np.append(np.polyadd(spring, strength * np.polymul(move, move)), 0.0),
    )
    roots = np.roots(scheme)
    loudest = roots[np.argmax(np.abs(roots))]
    assert -np.log(abs(loudest)) / dt == pytest.approx(rate / 2, rel=0.05)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", MEDIA)
def test_the_interpreter_computes_the_same(name):
    sides = {"x": side(), "y-": side(OTHER), "y+": fh.Free()} if MEDIA[name][1] == 2 else side()
    compiled, plain = (simulation(name, sides, nodes=15 if MEDIA[name][1] == 3 else 25) for _ in range(2))
    plain.engine.loop = Interpreter(plain.engine)
    for sim in (compiled, plain):
        sim.step(25)
    field = compiled.fields["u"]
    assert np.abs(compiled.engine.tables.dampers.states).max() > 1e-4
    np.testing.assert_allclose(plain.fields["u"], field, rtol=0, atol=1e-12 * np.abs(field).max())


@pytest.mark.parametrize("name", ["bonds", "space", "scalar in space"])
def test_more_threads_change_nothing(name):
    single, double = (simulation(name, nodes=161 if name == "bonds" else 27, threads=threads) for threads in (1, 2))
    for sim in (single, double):
        sim.step(40)
    assert double.engine.threads == 2
    np.testing.assert_array_equal(single.fields["u"], double.fields["u"])


@pytest.mark.sampled(3)
@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("short", [False, True])
def test_a_checkpoint_has_them(tmp_path, dtype, short):
    """This includes layers whose memory has six digits."""
    layer = fh.LatticePML(nodes=NODES, profile=Layer(**{**vars(TUNED), "short": short}))
    ahead, later = (simulation("space", layer, dtype=dtype) for _ in range(2))
    ahead.step(20)
    ahead.save(tmp_path / "state")
    later.load(tmp_path / "state")
    for sim in (ahead, later):
        sim.step(15)
    assert np.abs(ahead.engine.tables.dampers.states).max() > 1e-4
    np.testing.assert_array_equal(later.fields["u"], ahead.fields["u"])


@pytest.mark.parametrize("name", ["space", "scalar in space"])
@pytest.mark.parametrize(("layer", "most"), [(STILL, 1e-7), (TUNED, 1e-6)])
def test_halves_of_states_miss_a_part_of_what_dampers_take(name, layer, most):
    """The error without stretch, and beside layers whose memory has six digits, too; it is relative to the
    amplitude.
    """
    short, fields = side(replace(layer, short=True)), []
    start = simulation(name, short).fields["u"].copy()
    for boundary, factor in ((side(layer), 1.0), (short, 1.0), (short, 2.0**-200), (short, 2.0**200)):
        sim = simulation(name, boundary, u=factor * start)
        sim.step(60)
        fields.append(sim.fields["u"] / factor)
    assert sim.engine.tables.dampers.states.dtype == "int32"
    missed = np.abs(fields[1] - fields[0]).max() / np.abs(start).max()
    print(missed)
    assert 0 < missed < most
    for scaled in fields[2:]:
        np.testing.assert_array_equal(scaled, fields[1])


def test_each_node_of_the_layers_has_one_place():
    """This includes nodes where layers meet."""
    sim = simulation("space")
    layout = sim.engine.layout
    assert sim.engine.dampers.size == np.prod(layout.box.nodes) - np.prod(layout.core) + 1


def test_single_precision():
    double, single = (simulation("bonds", dtype=dtype) for dtype in ("float64", "float32"))
    for sim in (double, single):
        sim.step(60)
    difference = np.abs(double.fields["u"] - single.fields["u"]).max()
    assert 0 < difference < 1e-5


@pytest.mark.parametrize("name", ["line", "bonds", "space"])
def test_they_belong_to_the_state(name):
    """A state that is written and advanced continues like the run it was read from."""
    sim, second = simulation(name), simulation(name)
    sim.step(12)
    after = State(second.engine).after(State(sim.engine).read(), 9)
    sim.step(9)
    np.testing.assert_array_equal(after, State(sim.engine).read())


def test_plain_layers_have_none():
    plain = simulation("bonds", fh.LatticePML(nodes=6))
    assert not plain.engine.tables.dampers.runs.size and not plain.engine.dampers.size

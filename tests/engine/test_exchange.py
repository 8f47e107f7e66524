"""Messages between processes, where a process is its own neighbour: what periodic sides are."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.engine.exchange import Link, Messages
from farhorizon.engine.interpreter import Interpreter
from farhorizon.engine.settings import connect

ITSELF = Link((0, 0, 0, 0), 0, 0, False, 0)


def periodic(dim=2, **more):
    """Waves that cross a periodic side and run along layers."""
    shape = (17, 19, 21)[:dim]
    sides = {"x": fh.Periodic(), "y": fh.LatticePML(nodes=4), "z": fh.LatticePML(nodes=4)}
    u = np.zeros(shape)
    u[:3, 8:11] = np.random.default_rng(5).standard_normal(u[:3, 8:11].shape)
    lattice = fh.Lattice(1.0, [0.0] * dim, [n - 1.0 for n in shape])
    there = {axis: side for axis, side in sides.items() if axis in "xyz"[:dim]}
    return fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), there, {"u": u}, threads=1, **more)


def connected(sim):
    """The same with messages to itself in place of copies."""
    neighbours = {(axis, side): 0 for axis in sim.engine.layout.periodic for side in (-1, 1)}
    connect(sim.engine, ITSELF, neighbours)
    return sim


@pytest.mark.parametrize("more", [{}, {"dtype": "float32"}], ids=str)
def test_messages_to_itself_are_periodic_sides(more):
    """Bit by bit, energies too."""
    plain, other = periodic(**more), connected(periodic(**more))
    for sim in (plain, other):
        sim.step(60)
    np.testing.assert_array_equal(other.fields["u"], plain.fields["u"])
    assert other.energy() == plain.energy() and np.abs(plain.fields["u"]).max() > 1e-3


@pytest.mark.parametrize("model", [{}, {"integrator": fh.RungeKuttaChebyshev(3)}], ids=str)
def test_metal_dissolves_beyond_a_side_as_before_it(model):
    """Metal across a periodic side: the halo becomes liquid by the values that are sent, as periodic sides copy it."""

    def corrosion():
        lattice = fh.Lattice(1.0, (0.0, 0.0), (16.0, 40.0))
        disc = fh.Specimen(fh.Disc(5.0, (0.0, 17.0)) | fh.Disc(5.0, (17.0, 17.0)))
        sides = {"x": fh.Periodic(), "y": fh.LatticePML(nodes=4)}
        corrodes = fh.Corrosion(fh.Kernel(2.0), saturation=0.8, **model)
        return fh.Simulation(lattice, corrodes, sides, specimens=[disc], threads=1)

    plain, other = corrosion(), connected(corrosion())
    other.parts.phases.start()
    assert len(other.engine.tables.phases.halo) > 10
    for sim in (plain, other):
        sim.step(150)
        assert (sim.engine.tables.material.coefficient[sim.engine.tables.phases.halo[:, 0]] > 0).all()
    for name, values in plain.fields.items():
        np.testing.assert_array_equal(other.fields[name], values)
    assert np.nanmax(plain.fields["dissolved"]) > 0 and plain.fields["solid"].sum() < 40


@pytest.mark.slow
def test_in_space_and_with_states():
    """The slots of layers and the states of two passes are exchanged, too."""
    plain, other = periodic(3), connected(periodic(3))
    model = fh.Elastic(fh.Kernel(2.0), young=1.0, poisson=0.3, material="state-based")
    lattice = fh.Lattice(1.0, (0, 0, 0), (9, 10, 11))
    start = {"u": ["exp(-x)", 0.0, "exp(-y)"]}
    pair = [fh.Simulation(lattice, model, fh.Periodic(), start, threads=1) for _ in range(2)]
    for one, two in ((plain, other), (pair[0], connected(pair[1]))):
        one.step(40)
        two.step(40)
        np.testing.assert_array_equal(two.fields["u"], one.fields["u"])


def test_the_interpreter_does_the_same():
    plain, other = connected(periodic()), connected(periodic())
    Interpreter(other.engine)
    for sim in (plain, other):
        sim.step(12)
    np.testing.assert_allclose(other.fields["u"], plain.fields["u"], rtol=0, atol=1e-12)


def test_whom_messages_go_to():
    """What would fill my halo if I were periodic fills that of my neighbour on the other side."""
    layout = periodic().engine.layout
    across = {(1, side): layout.across(1, side) for side in (-1, 1)}
    messages = Messages.between(Link((0, 0, 0, 0), 0, 0, False, 5), {(1, -1): 4, (1, 1): -1}, across)
    (down, to_nobody) = messages.rows
    assert down[:2] == (-1, 4) and to_nobody[:2] == (4, -1)
    box = layout.box
    assert set(box.coordinates(to_nobody[2])[:, 1]) == {0, 1}  # my first nodes, of a reach of two
    assert set(box.coordinates(down[3])[:, 1]) == {-2, -1}  # my halo before them
    assert messages.volume == len(to_nobody[2]) == 2 * box.nodes[2]

"""Prescribed values: held, released, in one and more dimensions."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.case.case import Case

KERNEL = fh.Kernel(0.75)
LINE = fh.Lattice(0.25, -4, 4)
PLANE = fh.Lattice(0.25, (-3, -3), (3, 3))


@pytest.mark.parametrize("lattice", [LINE, PLANE])
@pytest.mark.parametrize("model", [fh.Wave(KERNEL, damping=0.1), fh.Diffusion(KERNEL)])
@pytest.mark.parametrize("boundary", [fh.LatticePML(), fh.Fixed()])
def test_held_nodes_follow(lattice, model, boundary):
    """At every step, the first included, and their neighbours feel it."""
    dim = lattice.dim
    held = fh.Prescribed([(0.5,) * dim, (-1.0,) * dim], lambda t: 1 + np.sin(t))
    sim = fh.Simulation(lattice, model, boundary, constraints=[held])
    nodes = [lattice.index((0.5,) * dim), lattice.index((-1.0,) * dim)]
    for _ in range(7):
        for node in nodes:
            assert sim.fields["u"][node] == 1 + np.sin(sim.time)
        sim.step(1)
    assert (np.abs(sim.fields["u"]) > 1e-3).sum() > 2
    sim.step(300)
    assert sim.fields["u"][nodes[0]] == 1 + np.sin(sim.time)


def test_all_but_one_node_held():
    """The free one is an oscillator in a given field: ``u_tt = -w u + f``, by the scheme's own recursion."""
    free = LINE.index((0.0,))
    mask = np.ones(LINE.shape, bool)
    mask[free] = False
    sim = fh.Simulation(
        LINE,
        fh.Wave(KERNEL),
        fh.Fixed(),
        {"u": lambda x: 1.0 * (np.abs(x) < 0.1)},
        constraints=[fh.Prescribed(mask, 0.0)],
    )
    rate = sim.stencil.weights.sum() / LINE.spacing**2
    angle = 2 * np.arcsin(sim.dt * np.sqrt(rate) / 2)
    sim.step(1000)
    assert sim.fields["u"][free] == pytest.approx(np.cos(1000 * angle), abs=1e-11)


@pytest.mark.parametrize("lattice", [LINE, PLANE])
@pytest.mark.parametrize("rate", [None, np.cos(2.0), fh.Expression("cos(t)", 0)])
def test_the_first_step_after_the_release(lattice, rate):
    """``u + (1 - d dt) dt v + dt^2/2 A u``: the start of velocity Verlet, the rate from the value's derivative unless
    given.
    """
    dim, damping = lattice.dim, 0.2
    at = lattice.index((0.0,) * dim)
    held = fh.Prescribed([(0.0,) * dim], np.sin, 2.0, rate)
    sim = fh.Simulation(lattice, fh.Wave(KERNEL, damping=damping), fh.LatticePML(), constraints=[held], dt=0.1)
    sim.step(20)
    u = sim.fields["u"]
    pull = 0.0
    for offset, weight in zip(sim.stencil.offsets, sim.stencil.weights, strict=True):
        pull += weight / lattice.spacing**2 * (u[tuple(np.array(at) + offset)] - u[at])
    sim.step(1)
    expected = u[at] + (1 - damping * 0.1) * 0.1 * np.cos(2.0) + 0.1**2 / 2 * pull
    assert sim.fields["u"][at] == pytest.approx(expected, abs=1e-10)


def test_release_does_not_disturb_a_solution():
    """A node that is made to do what it would do anyway, and released with the scheme's own velocity: a free run to
    rounding.
    """
    setup = {
        "lattice": fh.Lattice(0.25, -8, 8),
        "model": fh.Wave(KERNEL),
        "boundary": fh.Exact(),
        "initial": {"u": lambda x: np.exp(-4 * x**2)},
    }
    free = fh.Simulation(**setup, dt=0.02)
    values = [1.0]
    for _ in range(100):
        free.step(1)
        values.append(free.fields["u"][32])
    held = fh.Prescribed([0.0], lambda t: values[round(t / 0.02)], 1.0, (values[51] - values[49]) / 0.04)
    sim = fh.Simulation(**setup, dt=0.02, constraints=[held])
    sim.run(2.0)
    assert np.abs(sim.fields["u"] - free.fields["u"]).max() < 1e-12


@pytest.mark.parametrize("saved", [10, 20, 30])
def test_restored_runs_are_bitwise_the_same(saved, tmp_path):
    """Before, at and after the release; two constraints, one for ever."""
    held = [fh.Prescribed([0.0], fh.Expression("sin(t)", 1), 2.0), fh.Prescribed(fh.Box((2.9,), (3.1,)), 0.25)]
    whole = fh.Simulation(LINE, fh.Wave(KERNEL), fh.Exact(), constraints=held, dt=0.1)
    whole.step(saved)
    whole.save(tmp_path / "c")
    parts = fh.Simulation.restore(tmp_path / "c")
    for sim in (whole, parts):
        sim.step(60)
    np.testing.assert_array_equal(whole.fields["u"], parts.fields["u"])
    assert parts.fields["u"][LINE.index((3.0,))] == 0.25


def test_steps_in_pieces_are_the_run():
    """The release falls inside one call of `step`, or between two."""
    setup = {
        "lattice": LINE,
        "model": fh.Wave(KERNEL),
        "boundary": fh.LatticePML(),
        "constraints": [fh.Prescribed([0.0], np.sin, 2.0)],
        "dt": 0.1,
    }
    one, other = fh.Simulation(**setup), fh.Simulation(**setup)
    one.step(50)
    for count in (7, 13, 30):
        other.step(count)
    np.testing.assert_array_equal(one.fields["u"], other.fields["u"])


CASE = """
[lattice]
spacing = 0.25
lower = [-4.0]
upper = [4.0]
[model]
type = "wave"
[model.kernel]
horizon = 0.75
[boundary]
all = {{ type = "exact" }}
[[constraint]]
type = "prescribed"
{}
[run]
until = 4.0
dt = 0.1
"""


def test_case_files():
    sim = Case(CASE.format('points = [[0.0]]\nvalue = "sin(t)"\nuntil = 2.0')).simulation()
    other = fh.Simulation(LINE, fh.Wave(KERNEL), fh.Exact(), constraints=[fh.Prescribed([0.0], np.sin, 2.0)], dt=0.1)
    for each in (sim, other):
        each.run(4.0)
    np.testing.assert_allclose(sim.fields["u"], other.fields["u"], atol=1e-12)
    with pytest.raises(fh.InputError, match="points or region"):
        Case(CASE.format("value = 1.0"))
    with pytest.raises(fh.InputError, match="did you mean 'value'"):
        Case(CASE.format("points = [[0.0]]\nvalues = 1.0"))
    with pytest.raises(fh.InputError, match="function of t only"):
        Case(CASE.format('points = [[0.0]]\nvalue = "x"'))


def test_bad_input():
    def simulation(*held, model=None):
        return fh.Simulation(LINE, model or fh.Wave(KERNEL), fh.LatticePML(), constraints=held, dt=0.01)

    with pytest.raises(fh.InputError, match="outside the near field"):
        simulation(fh.Prescribed([7.0], 1.0))
    with pytest.raises(fh.InputError, match="the same node"):
        simulation(fh.Prescribed([1.0], 1.0), fh.Prescribed([1.01], 2.0))
    with pytest.raises(fh.InputError, match="holds no node"):
        simulation(fh.Prescribed(fh.Box((0.05,), (0.1,)), 1.0))
    with pytest.raises(fh.InputError, match="lattice's shape"):
        simulation(fh.Prescribed(np.ones(3, bool), 1.0))
    with pytest.raises(fh.InputError, match="one stage"):
        simulation(fh.Prescribed([1.0], 1.0), model=fh.Diffusion(KERNEL, integrator="rk4"))
    with pytest.raises(fh.InputError, match="not a constraint"):
        simulation(1.0)
    with pytest.raises(fh.InputError, match="not negative"):
        fh.Prescribed([0.0], 1.0, until=-1.0)
    with pytest.raises(fh.InputError, match="not finite"):
        simulation(fh.Prescribed([0.0], lambda t: 1.0 if t < 0.05 else np.nan)).step(20)

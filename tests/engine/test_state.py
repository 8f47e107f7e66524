"""The state vector is complete, and a step of it is a step of the run."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.checks.reduced_setups import Strip
from farhorizon.engine.state import State


def kernel(reach=3, exponent=2):
    return fh.Kernel(float(reach), exponent)


def box(*nodes):
    return fh.Lattice(1.0, (0.0,) * len(nodes), [n - 1.0 for n in nodes])


def noise(lattice, model):
    vector = (lattice.dim,) * isinstance(model, fh.Correspondence)
    return np.random.default_rng(5).standard_normal(vector + lattice.shape)


SETUPS = {
    "increments": {"lattice": box(12), "model": fh.Wave(kernel()), "boundary": fh.LatticePML(nodes=5)},
    "corners, crack, other reach": {
        "lattice": box(9, 8),
        "model": fh.Wave(kernel(2), damping=0.1),
        "boundary": fh.LatticePML(nodes=4),
        "cracks": [[(2.5, 2.5), (5.5, 2.5)]],
    },
    "free, fixed and sponge": {
        "lattice": box(7, 8),
        "model": fh.Wave(kernel()),
        "boundary": {"x-": fh.LatticePML(nodes=5), "x+": fh.Sponge(4), "y-": fh.Free(), "y+": fh.Fixed()},
    },
    "stretched without memory": {
        "lattice": box(8, 7),
        "model": fh.Diffusion(kernel(), integrator="rk4"),
        "boundary": fh.LatticePML(nodes=4),
    },
    "memory with a stretch at rest": {
        "lattice": box(10),
        "model": fh.Wave(kernel()),
        "boundary": fh.LatticePML(nodes=3, profile={"kappa": [1.0, 2.0, 3.0, 4.0], "sigma": [0.0, 0.1, 0.0, 0.4]}),
    },
    "space": {
        "lattice": box(5, 6, 5),
        "model": fh.Wave(kernel(2)),
        "boundary": {"x": fh.LatticePML(nodes=3), "y": fh.Periodic(), "z": fh.LatticePML(nodes=2)},
    },
    "layers and fixed sides": {
        "lattice": box(9, 8),
        "model": fh.Wave(kernel(2)),
        "boundary": {"x-": fh.LatticePML(nodes=3), "x+": fh.Fixed(), "y-": fh.LatticePML(nodes=4), "y+": fh.Fixed()},
    },
    "fixed between two pairs of layers": {
        "lattice": box(5, 5, 6),
        "model": fh.Wave(kernel(2)),
        "boundary": {"x": fh.LatticePML(nodes=2), "y": fh.Fixed(), "z": fh.LatticePML(nodes=2)},
    },
    "drag between periodic sides": {
        "lattice": box(9, 8),
        "model": fh.Correspondence(kernel(2, 1), 1.0, 0.3, stabilisation=0.5, drag=0.5),
        "boundary": {"x": fh.LatticePML(nodes=3), "y": fh.Periodic()},
    },
    "exact ends": {"lattice": box(20), "model": fh.Wave(kernel()), "boundary": fh.Exact()},
    "mirrored temperatures": {
        "lattice": box(20),
        "model": fh.Heat(kernel(), integrator=fh.RungeKuttaChebyshev(5)),
        "boundary": fh.Free(),
        "constraints": [fh.Temperature("x-", 0.0, "mirror"), fh.Insulated("x+")],
    },
}


@pytest.mark.parametrize("name", SETUPS)
def test_a_state_has_all_that_a_run_needs(name):
    """The state determines everything that follows: a run that is set to an earlier state continues bitwise as
    before.
    """
    setup = SETUPS[name]
    sim = fh.Simulation(**setup, initial={"u": noise(setup["lattice"], setup["model"])}, threads=1)
    sim.prepare(50 * sim.dt)
    state = State(sim.engine)
    sim.step(3 * state.every)
    before = state.read()
    sim.step(5)
    u, after = sim.fields["u"], state.read()
    sim.engine.tables.layers.slots[:] = 0  # scratch
    assert np.array_equal(state.after(before, 5), after)
    assert np.array_equal(sim.fields["u"], u, equal_nan=True)  # images beyond a wall are shown as nan


@pytest.mark.parametrize("name", SETUPS)
def test_a_step_is_linear(name):
    setup = SETUPS[name]
    sim = fh.Simulation(**setup, threads=1)
    sim.prepare(50 * sim.dt)
    state = State(sim.engine)
    a, b = np.random.default_rng(3).standard_normal((2, state.size))
    assert np.abs(state.after(2 * a - 3 * b, 2) - 2 * state.after(a, 2) + 3 * state.after(b, 2)).max() < 1e-12
    assert np.abs(state.after(a + 1j * b) - state.after(a) - 1j * state.after(b)).max() < 1e-12


@pytest.mark.parametrize("dim, axis", [(2, 0), (2, 1), (3, 0), (3, 2)])
def test_chain_of_a_tangential_wavenumber(dim, axis):
    """A Bloch wave along the sides, here one that fits into the periodic rows, advances by the matrix of its
    wavenumber.
    """
    model = fh.Wave(kernel(2), damping=0.05)
    undamped = fh.LatticePML(nodes=4, profile={"sigma": [0.2, 0.5, 1.0, 2.0, 3.0], "alpha": 0.01})
    sim = fh.Simulation(box(*(9, 8, 10)[:dim]), model, boundary=undamped)
    strip = Strip(sim, axis, 6)
    wave = [2 * np.pi * n / 5 for n in (2, 1)][: dim - 1]  # number of rows: twice the reach plus one
    random = np.random.default_rng(2)
    start = random.standard_normal(strip.size) + 1j * random.standard_normal(strip.size)
    rows = np.indices((5,) * (dim - 1)).reshape(dim - 1, -1)
    phase = np.exp(1j * np.tensordot(wave, rows, 1))
    whole = np.zeros(strip.state.size, complex)
    whole[strip.place] = start[:, None] * phase
    found = strip.state.after(whole, 3)[strip.place]
    expected = np.linalg.matrix_power(strip.matrix(*wave), 3) @ start
    assert np.abs(found - expected[:, None] * phase).max() < 1e-12 * np.abs(expected).max()

"""The semi-discrete Euler-Bernoulli beam against exact solutions."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.studies.compare import compare
from helpers import fitted_rate


def standing_wave(nodes, waves=2, stiffness=0.7, share=0.6):
    """A periodic beam of length 1 deflected as a cosine; returns the simulation and the wavenumber."""
    dx = 1 / nodes
    lattice = fh.Lattice(dx, 0, 1 - dx)
    k = 2 * np.pi * waves
    sim = fh.Simulation(
        lattice,
        fh.Beam(stiffness),
        fh.Periodic(),
        {"u": lambda x: np.cos(k * x)},
        dt=share * dx**2 / (2 * np.sqrt(stiffness)),
    )
    return sim, k


def test_step_limit():
    """The largest eigenvalue of the fourth difference is 16 / spacing^4."""
    sim, _ = standing_wave(20)
    assert sim.step_limit == pytest.approx(0.05**2 / (2 * np.sqrt(0.7)), rel=1e-12)
    with pytest.raises(fh.InputError, match="stable limit"):
        fh.Simulation(sim.lattice, sim.model, fh.Periodic(), dt=1.01 * sim.step_limit)
    tight, _ = standing_wave(20, waves=10, share=0.999)
    tight.step(2000)
    assert np.abs(tight.fields["u"]).max() <= 1 + 1e-6


def test_standing_wave_of_the_scheme():
    """``sin^2(a/2) = dt^2 omega^2 / 4`` for the phase a of a step, with ``omega^2 = stiffness (2 sin(k
    dx/2)/dx)^4``.
    """
    sim, k = standing_wave(40)
    omega = np.sqrt(0.7) * (2 * np.sin(k / 80) * 40) ** 2
    angle = 2 * np.arcsin(sim.dt * omega / 2)
    x = sim.lattice.axes[0]
    for _ in range(3):
        sim.step(500)
        assert np.abs(sim.fields["u"] - np.cos(sim.step_count * angle) * np.cos(k * x)).max() < 1e-11


def test_converges_to_the_continuum():
    """cos(sqrt(stiffness) k^2 t) cos(k x), with second order in the spacing."""
    sizes, errors = [], []
    for nodes in (24, 48, 96):
        sim, k = standing_wave(nodes, waves=1)
        sim.run(0.05)
        exact = np.cos(np.sqrt(0.7) * k**2 * sim.time) * np.cos(k * sim.lattice.axes[0])
        sizes.append(1 / nodes)
        errors.append(np.abs(sim.fields["u"] - exact).max())
    assert fitted_rate(sizes, errors) > 1.9


@pytest.mark.sampled(2)
@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_infinite_beam(damping):
    """Exact ends against the infinite lattice by FFT.

    With a compressed kernel an error of 1e-12 of the force translates and rotates the beam as a whole, hence the bound
    a hundred times as large.
    """
    setup = {
        "lattice": fh.Lattice(0.25, -5, 5),
        "model": fh.Beam(1.5, damping),
        "initial": {"u": lambda x: np.exp(-4 * x**2)},
    }
    for end, bound in ((fh.Exact(), 1e-10), (fh.Exact(None), 1e-12)):
        curves = compare({**setup, "boundary": end}, 30.0).curves
        assert curves["exact"]["error_max_over_run"] < bound
    assert curves["fixed edge"]["error_max_over_run"] > 1e-2
    assert "free edge" not in curves


def test_energy_is_conserved():
    sim = fh.Simulation(fh.Lattice(0.25, -5, 5), fh.Beam(), fh.Periodic(), {"u": lambda x: np.exp(-4 * x**2)})
    before = sim.energy()
    sim.step(3000)
    assert sim.energy() == pytest.approx(before, rel=1e-11)


def test_case_file():
    text = (
        '[lattice]\nspacing = 0.25\nlower = [-5]\nupper = [5]\n[model]\ntype = "beam"\nstiffness = '
        '2.0\n[initial]\nu = "exp(-4*x**2)"\n'
    )
    sim = Case(text + '[boundary]\nall = { type = "exact" }\n[run]\nuntil = 1.0\n').simulation()
    assert sim.model.stiffness == 2.0
    sim.run(1.0)
    other = fh.Simulation(sim.lattice, fh.Beam(2.0), fh.Exact(), {"u": lambda x: np.exp(-4 * x**2)}, dt=sim.dt)
    other.run(1.0)
    np.testing.assert_allclose(sim.fields["u"], other.fields["u"], atol=1e-12)


def test_bad_input(tmp_path):
    lattice = fh.Lattice(0.25, -5, 5)
    for side in (fh.LatticePML(), fh.Free(), fh.Sponge()):
        with pytest.raises(fh.InputError, match="Beam has no such side"):
            fh.Simulation(lattice, fh.Beam(), side)
    with pytest.raises(fh.InputError, match="cut or weakened"):
        fh.Simulation(lattice, fh.Beam(), fh.Exact(), cracks=[0.1])
    with pytest.raises(fh.InputError, match="cut or weakened"):
        fh.Simulation(lattice, fh.Beam(), fh.Exact(), coefficient=np.ones(41))
    with pytest.raises(fh.InputError, match="one dimension"):
        fh.Simulation(fh.Lattice(0.25, (-2, -2), (2, 2)), fh.Beam(), fh.Fixed())
    sim = fh.Simulation(lattice, fh.Beam(2.0, 0.1), fh.Exact(), {"u": lambda x: np.exp(-4 * x**2)})
    sim.step(10)
    sim.save(tmp_path / "c")
    again = fh.Simulation.restore(tmp_path / "c")
    assert again.model.stiffness == 2.0 and again.model.damping == 0.1

"""The first steps in front of a layer for diffusion, against runs with that layer."""

import os

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.layers.first_steps import FirstSteps, waves_of
from farhorizon.analysis.references.infinite import InfiniteLattice

SEED = int(os.environ.get("FARHORIZON_SEED", np.random.default_rng().integers(2**31)))


@pytest.mark.parametrize("case", range(6))
@pytest.mark.parametrize("dim", [1, 2])
def test_the_first_steps_are_those_of_a_run(dim, case):
    """A layer at one side of a near field that continues beyond the other side, and periodic sides across."""
    print(f"seed {SEED}")
    random = np.random.default_rng([SEED, dim, case])
    reach = float(random.integers(2, 6))
    model = fh.Diffusion(fh.Kernel(reach, int(random.integers(0, 3)), str(random.choice(["constant", "linear"]))), 1.3)
    shape = [int(random.integers(22, 40)), int(random.integers(11, 19))][:dim]
    lattice = fh.Lattice(1.0, (0.0,) * dim, [n - 1.0 for n in shape])
    centre = [shape[0] / 2 + 3, *random.uniform(0, shape[-1], dim - 1)]
    u = np.exp(-sum((x - a) ** 2 for x, a in zip(lattice.coordinates(), centre, strict=True)) / 1.5**2)
    nodes, steps = int(random.integers(2, 12)), 40
    dt = random.uniform(0.4, 0.98) * fh.Simulation(lattice, model, fh.Fixed()).step_limit
    sides = {"x+": fh.LatticePML(nodes=nodes, until=steps * dt), "x-": fh.Extended(until=steps * dt, target=1e-12)}
    sim = fh.Simulation(lattice, model, sides | ({"y": fh.Periodic()} if dim > 1 else {}), {"u": u}, dt=dt, threads=1)
    (layer,) = sim.engine.layers.values()
    margin = sim.parts.grid.margins[0, 1]
    along = FirstSteps(sim.stencil, 1.3 * dt, u.reshape(len(u), -1), True, steps, 1e-12, margin)
    copies = 2 * (int(8 * np.sqrt(2 * 1.3 * dt * steps)) // shape[-1] + 1) + 1 if dim > 1 else 1
    infinite = InfiniteLattice(sim.stencil, 1.3, model.integrator, dt, steps, np.tile(u, [1, copies][:dim]))
    worst, middle = 0.0, slice(copies // 2 * shape[-1], (copies // 2 + 1) * shape[-1])
    for step in range(1, steps + 1):
        sim.step(1)
        exact = infinite.after(step)
        exact = exact[:, middle] if dim > 1 else exact
        worst = max(worst, float(np.abs(sim.fields["u"] - exact).max() / np.abs(exact).max()))
    assert along.returned(layer) == pytest.approx(worst, rel=1e-2, abs=1e-11)


@pytest.mark.parametrize("reach", [1.0, 3.0])
def test_the_first_steps_of_a_source_are_those_of_a_run(reach):
    """A source at one node that acts from the first step on, relative to the largest value after each step."""
    model, steps, nodes, layers = fh.Diffusion(fh.Kernel(reach), 1.0), 60, 30, 4
    lattice, u = fh.Lattice(1.0, 0.0, nodes - 1.0), np.zeros(nodes)
    u[22] = 1.0
    dt, runs = 0.9 * fh.Simulation(lattice, model, fh.Fixed()).step_limit, []
    for far in (fh.LatticePML(nodes=layers, until=steps * dt), fh.Extended(until=steps * dt, target=1e-12)):
        sides = {"x-": fh.Extended(until=steps * dt, target=1e-12), "x+": far}
        runs.append(fh.Simulation(lattice, model, sides, sources=[fh.Source(u)], dt=dt, threads=1))
    (layer,), margin = runs[0].engine.layers.values(), runs[0].parts.grid.margins[0, 1]
    along = FirstSteps(runs[0].stencil, dt, dt * u[:, None], False, steps, 1e-12, margin, lasting=True)
    worst = 0.0
    for _ in range(steps):
        for run in runs:
            run.step()
        off, exact = runs[0].fields["u"] - runs[1].fields["u"], runs[1].fields["u"]
        worst = max(worst, float(np.abs(off).max() / np.abs(exact).max()))
    print(worst, along.returned(layer))
    assert along.returned(layer) == pytest.approx(worst, rel=0.02)


def test_waves_that_stand_for_a_line_are_all_of_it_where_they_are_in_phase():
    """For a bell or a single node the shares of the waves add up to the largest value; a wide bell consists of the
    longest waves.
    """
    for line, sure in ((np.exp(-((np.arange(40.0) - 20) ** 2)), 1.0), (np.eye(30)[7], 1.0)):
        angles, shares = np.transpose(waves_of(line))
        assert shares.sum() == pytest.approx(sure, rel=0.02)
        assert (np.diff(angles) > 0).all() and 0 <= angles[0] and angles[-1] <= np.pi
    angles, shares = np.transpose(waves_of(np.exp(-((np.linspace(-4, 4, 400)) ** 2))))
    assert shares[0] > 0.9 * shares.sum() and angles[0] < 0.05


def test_in_space_the_first_steps_are_those_of_a_product():
    """A box of data in front of a single side: the prediction is no less than what returns, and not much more."""
    shape, place = (18, 17, 17), (11, 8, 8)
    lattice = fh.Lattice(1.0, (0.0,) * 3, [n - 1.0 for n in shape])
    u = np.zeros(shape)
    u[tuple(slice(a - 1, a + 2) for a in place)] = 1.0
    model, steps = fh.Diffusion(fh.Kernel(2.0, 1), 1.0), 40
    dt = 0.95 * fh.Simulation(lattice, model, fh.Fixed()).step_limit
    far = fh.Extended(until=steps * dt, target=1e-9)
    sides = {"x+": fh.LatticePML(nodes=7, until=steps * dt), "x-": far, "y": far, "z": far}
    sim = fh.Simulation(lattice, model, sides, {"u": u}, dt=dt, threads=1)
    (layer,) = sim.engine.layers.values()
    beyond = waves_of(u[place[0], place[1]])
    first = FirstSteps(sim.stencil, dt, u[:, :, place[2]], False, steps, 1e-9, sim.parts.grid.margins[0, 1], beyond)
    infinite, worst = InfiniteLattice(sim.stencil, 1.0, model.integrator, dt, steps, u), 0.0
    for step in range(1, steps + 1):
        sim.step()
        exact = infinite.after(step)
        worst = max(worst, float(np.abs(sim.fields["u"] - exact).max() / np.abs(exact).max()))
    print(worst, first.returned(layer))
    assert 0.9 * worst < first.returned(layer) < 2 * worst

"""How far data spread, against the infinite lattice and against runs."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.extent import Datum, Waves, extent, largest
from farhorizon.analysis.references.infinite_lattice import InfiniteLattice
from farhorizon.medium.integrators import Euler, Verlet


def medium(stencil, integrator, dt, steps, damping=0.0):
    return Waves(stencil, 1.0, integrator, dt, damping, steps)


def stencil(dim, reach=2, exponent=2):
    return fh.Stencil.from_kernel(fh.Kernel(float(reach), exponent), 1.0, dim)


@pytest.mark.parametrize("reach", [1, 3])
@pytest.mark.parametrize("integrator, dt, steps", [(Verlet(), 0.4, 200), (Euler(), 0.1, 2000)])
def test_a_mirror_image_on_a_line(integrator, dt, steps, reach):
    """The predicted return is the value of the infinite lattice at the place of the mirror image, to the node."""
    line = stencil(1, reach)
    start = np.exp(-((np.arange(60) - 30.0) ** 2) / 9)
    found = extent(medium(line, integrator, dt, steps), [Datum(start, "u")], [1.0], 0, 1e-4)
    wide = np.zeros(1200)
    wide[600:660] = start
    states = [
        InfiniteLattice(line, 1.0, integrator, dt, steps, wide).after(n)
        for n in np.ceil(np.arange(1, 17) * steps / 16).astype(int)
    ]
    scale = [1.0 if integrator.order == 2 else state[600:660].max() for state in states]
    returned = max(
        np.abs(state[660 + 2 * found.nodes :]).max() / size for state, size in zip(states, scale, strict=True)
    )
    assert found.predicted == pytest.approx(returned, rel=1e-6, abs=1e-12) and found.predicted < 1e-4
    fewer = max(np.abs(state[658 + 2 * found.nodes :]).max() / size for state, size in zip(states, scale, strict=True))
    assert fewer > 0.3e-4  # 0.3 of the target is aimed at


def test_the_extent_knows_no_units_and_no_amplitude():
    start = np.exp(-((np.arange(30) - 15.0) ** 2) / 9)
    one = extent(Waves(stencil(1), 1.0, Verlet(), 0.4, 0.01, 100), [Datum(start, "u")], [1.0], 0, 1e-5)
    other = extent(Waves(stencil(1), 1e12, Verlet(), 0.4e-6, 1e4, 100), [Datum(1e30 * start, "u")], [1e30], 0, 1e-5)
    assert one.nodes == other.nodes and one.predicted == pytest.approx(other.predicted, rel=1e-6)


@pytest.mark.parametrize("wall", [1, -1])
def test_a_wall_opposite_sends_its_image_after_the_data(wall):
    """The image of a wall far behind the data changes nothing. That of a wall right behind them arrives with them and
    changes at most one node, but what returns is, as predicted, that of the data and their image in the infinite
    lattice.
    """
    steps, line = 400, stencil(1)  # waves travel twice the length of the near field

    def found(place, mirror):
        start = np.exp(-((np.arange(80) - place) ** 2) / 9)
        return start, extent(medium(line, Verlet(), 0.4, steps), [Datum(start, "u")], [1.0], mirror, 1e-5)

    assert found(60.0, wall)[1].nodes == found(60.0, 0)[1].nodes
    start, beside = found(2.0, wall)
    alone = found(2.0, 0)[1]
    assert abs(beside.nodes - alone.nodes) <= 1
    wide = np.zeros(2400)
    wide[1200:1280], wide[1120:1200] = start, wall * start[::-1]
    lattice = InfiniteLattice(line, 1.0, Verlet(), 0.4, steps, wide)
    moments = np.ceil(np.arange(1, 17) * steps / 16).astype(int)
    returned = max(np.abs(lattice.after(n)[1280 + 2 * beside.nodes :]).max() for n in moments)
    assert beside.predicted == pytest.approx(returned, rel=1e-6)
    assert abs(beside.predicted / alone.predicted - 1) > 1e-3  # the image is felt, well above the tolerance


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("kind", ["v", "source"])
def test_the_largest_value_is_estimated_from_below(dim, kind):
    """For velocities and for sources that come and go the estimate lies between a tenth and 1.2 times the largest
    value of a run. A steady source keeps growing.
    """
    lattice = fh.Lattice(1.0, (-12.0,) * dim, (12.0,) * dim)
    values = np.exp(-sum(x**2 for x in lattice.coordinates()) / 6)
    values[values < 1e-12] = 0
    model, period = fh.Wave(fh.Kernel(2.0)), 6.0
    sources = (
        [fh.Source(values, lambda t: np.sin(np.pi * t / period) ** 2 * (t < 2 * period))] if kind == "source" else []
    )
    sim = fh.Simulation(lattice, model, fh.LatticePML(nodes=8), {} if sources else {"v": values}, sources=sources)
    steps = int(16 / sim.dt)
    times = np.array([sources[0].time(n * sim.dt) for n in range(steps)]) if sources else np.zeros(0)
    estimate = largest(medium(sim.stencil, Verlet(), sim.dt, steps), Datum(values, kind, times))
    most = 0.0
    for _ in range(steps):
        sim.step()
        most = max(most, np.abs(sim.fields["u"]).max())
    assert 0.1 * most < estimate < 1.2 * most

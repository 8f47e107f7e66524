"""The waves that data send to a side, against the infinite lattice and runs in long domains."""

import warnings

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from test_returned import SEED, UNTIL, medium, pulse

import farhorizon as fh
from farhorizon.analysis.layers.arrivals import arrivals, round_a_point
from farhorizon.analysis.layers.chain_modes import vectors_arrived
from farhorizon.analysis.layers.layer import LatticeMedium
from farhorizon.analysis.layers.side_data import Datum, hold_backward_waves
from farhorizon.analysis.references.infinite import InfiniteLattice


@pytest.mark.parametrize("damping", [0.0, 0.02])
@pytest.mark.parametrize(
    ("shape", "centre"), [((41,), (17.0,)), ((31, 33), (12.0, 20.0)), ((13, 15, 15), (5.0, 7.0, 7.0))]
)
def test_waves_arrive_as_on_the_infinite_lattice(shape, centre, damping):
    dim = len(shape)
    model = fh.Wave(fh.Kernel(2.0), 1.0, damping=damping)
    front, u = medium(model, dim), pulse(shape, centre, 3.0 if dim < 3 else 2.2)
    until = UNTIL if dim < 3 else 12.0
    steps = int(until / front.dt)
    lengths = [n + int(until) for n in shape[1:]]
    arrived = arrivals(front, steps, [Datum(u, "u")], lengths, [range(n) for n in shape[1:]], 1e-5, 1.0)
    infinite = InfiniteLattice(front.stencil, 1.0, model.integrator, front.dt, steps, u, damping=damping)
    largest = max(np.abs(infinite.after(step)[-1]).max() for step in range(steps))
    assert arrived.largest == pytest.approx(largest, rel=0.03)  # the times examined are not the steps of the run


@pytest.mark.parametrize("smooth", [6.0, 12.0])
def test_long_waves_arrive_as_those_of_smoothed_data(smooth):
    """The waves match those on the infinite lattice from data smoothed along the side, with the last row smoothed in
    time.
    """
    random = np.random.default_rng(SEED)
    shape, model = (31, 27), fh.Wave(fh.Kernel(2.0))
    front, u = medium(model, 2), pulse(shape, random.uniform(10, 17, 2))
    steps, margin = int(UNTIL / front.dt), 60
    given = [Datum(u, "u")], [shape[1] + 2 * int(UNTIL)], [range(shape[1])]
    arrived = arrivals(front, steps, *given, 1e-5, 1.0, smooth=smooth)
    rows = gaussian_filter1d(np.pad(u, ((0, 0), (margin, margin))), smooth, axis=1, mode="constant", truncate=6)
    infinite = InfiniteLattice(front.stencil, 1.0, model.integrator, front.dt, 2 * steps, rows)
    last = np.array([infinite.after(step)[-1, margin:-margin] for step in range(2 * steps)])
    last = gaussian_filter1d(last, smooth / front.dt, axis=0, mode="constant", truncate=6)[:steps]
    assert arrived.largest == pytest.approx(np.abs(last).max(), rel=0.03)
    assert len(arrived.amplitude) < 0.3 * len(arrivals(front, steps, *given, 1e-5, 1.0).amplitude)


@pytest.mark.parametrize("case", range(6))
def test_all_modes_arrive_as_on_the_infinite_lattice(case):
    """Short pulses beside a side, whose backward waves and evanescent modes arrive too; the slowest mode alone misses
    up to a third of the field.
    """
    random = np.random.default_rng([SEED, 2, case])
    dim = 1 + case % 2
    model = fh.Wave(fh.Kernel(float(random.integers(3, 7)), int(random.integers(0, 2)), "constant"))
    front, shape = medium(model, dim), (25, 19)[:dim]
    u = pulse(shape, [random.uniform(14, 20), 9.0][:dim], random.uniform(0.8, 1.2))
    steps, lengths = int(2 * UNTIL / front.dt), [n + int(4 * UNTIL) for n in shape[1:]]
    given = [Datum(u, "u")], lengths, [range(n) for n in shape[1:]], 1e-4, 1.0
    assert hold_backward_waves(front, given[0], 1e-4)
    arrived = arrivals(front, steps, *given, every=True)
    infinite = InfiniteLattice(front.stencil, 1.0, model.integrator, front.dt, steps, u)
    last = np.array([infinite.after(step)[-1] for step in range(steps)])
    assert arrived.largest == pytest.approx(np.abs(last).max(), rel=0.05)


@pytest.mark.parametrize("case", range(5))
def test_all_modes_of_vectors_arrive_as_on_the_infinite_lattice(case):
    """P and S waves of both components, backward waves included, for bonds with and without a ramp of the volume,
    state-based solids and finite elements.
    """
    random = np.random.default_rng([SEED, 9, case])
    kernel = fh.Kernel(
        float(random.integers(2, 5)), int(random.integers(0, 2)), "constant", volume=["ramp", "full"][case % 2]
    )
    model = [
        fh.Elastic(kernel, young=1.0),
        fh.Elastic(kernel, young=1.0),
        fh.Elastic(None, young=1.0, poisson=0.3, material="finite-element"),
        fh.Elastic(kernel, young=1.0, poisson=random.uniform(0.1, 0.4), material="state-based"),
        fh.Elastic(kernel, young=1.0),
    ][case]
    front, shape = medium(model, 2), (25, 19)
    width = random.uniform(0.8, 1.2)
    u = np.stack([a * pulse(shape, [random.uniform(14, 20), random.uniform(7, 11)], width) for a in (1.0, -0.6)])
    steps, lengths = int(UNTIL / front.dt), [shape[1] + int(2 * UNTIL)]
    data = [Datum(part, "u", component=place) for place, part in enumerate(u)]
    assert hold_backward_waves(front, data, 1e-4)
    arrived = arrivals(front, steps, data, lengths, [range(shape[1])], 1e-4, 1.0, every=True)
    infinite = InfiniteLattice(front.stencil, 1.0, model.integrator, front.dt, steps, u)
    once = np.where(np.isin(arrived.factor.imag.round(12), 0.0), 0.5, 1.0)  # the ends of the integral count half
    waves = arrived.amplitude * arrived.shapes * once / steps
    along = np.exp(1j * np.outer(arrived.along[0], np.arange(shape[1])))
    for step in [*random.integers(1, steps, 8), steps - 1]:
        exact = infinite.after(int(step))[:, -1]
        arrives = -(waves * arrived.factor**step @ along).real  # opposite in sign; only sizes matter
        assert np.abs(arrives - exact).max() < 1e-4 * np.abs(u).max()


def test_modes_that_die_out_at_once_do_not_overflow():
    """Regression test: at some wavenumbers a factor of 3e-4 per node, to the twelfth power, was rounded to a slope of
    zero.
    """
    solid = fh.Elastic(fh.Kernel(6.0, 0, volume="full"), young=1.0, poisson=0.344197534, material="state-based")
    front = medium(solid, 2)
    along, rows = np.linspace(0.5, 0.75, 2001)[None], np.ones((5, 2001))
    z = np.array([1.0103 + 0.0198j, 1.0099 + 0.033j, 0.9412 + 0.3675j, 0.9363 + 0.3798j, 0.9152 + 0.4282j])
    with warnings.catch_warnings(action="error"):
        found = vectors_arrived(front, z, along, [(0, rows, np.ones(5)), (1, rows, np.ones(5))])
    assert all(np.isfinite(one).all() for one in found)
    assert found[1].any()


@pytest.mark.sampled(3)
@pytest.mark.parametrize("case", range(3))
def test_round_waves_are_what_a_point_of_a_side_sees_in_space(case):
    """Two pulses of different size, so that no point of symmetry exists; against the infinite lattice."""
    random = np.random.default_rng([SEED, 4, case])
    shape = (15, 17, 19)
    kernel = [fh.Kernel(1.0), fh.Kernel(2.0), fh.Kernel(2.0, 3, "linear")][case]
    model = fh.Wave(kernel)
    front = medium(model, 3)
    u = pulse(shape, (6.0, 7.0, 8.0), 2.0) - 0.7 * pulse(shape, (8.0, 9.0, 12.0), 2.2)
    until = 24.0
    steps = int(until / front.dt)
    infinite = InfiniteLattice(front.stencil, 1.0, model.integrator, front.dt, steps, u)
    history = np.array([infinite.after(step)[-1] for step in range(steps)])
    for place in (8, 9), (0, 18), tuple(random.integers(0, (17, 19))):
        along, rows = round_a_point(u, place, until)
        arrived = arrivals(front, steps, [Datum(rows, "u")], [], [], 1e-5, 1.0, radial=along)
        assert arrived.largest == pytest.approx(np.abs(history[:, place[0], place[1]]).max(), rel=0.06)


@pytest.mark.parametrize("kind", ["u", "v"])
def test_what_comes_out_of_a_slower_medium(kind):
    """Two thirds of the displacement of a long wave pass an interface, midway between two nodes, to a medium of the
    same density and twice the speed. The prediction assumes a factor of two, the most that any density lets through.
    """
    model = fh.Wave(fh.Kernel(1.0), "where(x < 20.5, 1, 2)")
    fast = medium(fh.Wave(fh.Kernel(1.0), 2.0), 1, share=0.4)
    front = LatticeMedium(fast.stencil, 4.0, 1.0, fast.recursion, fast.dt)
    values, steps = pulse((41,), (6.0,), 4.0), int(UNTIL / front.dt)
    far = fh.Lattice(1.0, (-150.0,), (300.0,))
    sim = fh.Simulation(
        far, model, fh.Fixed(), {kind: np.concatenate([np.zeros(150), values, np.zeros(260)])}, dt=front.dt, threads=1
    )
    largest = 0.0
    for _ in range(steps - 1):
        sim.step()
        largest = max(largest, abs(sim.fields["u"][190]))
    found = arrivals(front, steps, [Datum(values, kind, behind=(20, 0.25))], [], [], 1e-5)
    assert found.largest / largest == pytest.approx(2 / (2 / 3), rel=0.03)


def test_velocities_and_sources_arrive_as_in_a_long_domain():
    model = fh.Wave(fh.Kernel(2.0), 1.0)
    front = medium(model, 1)
    values, steps = pulse((41,), (17.0,)), int(UNTIL / front.dt)
    drive = np.sin(0.4 * front.dt * np.arange(steps)) ** 2
    far = fh.Lattice(1.0, (-150.0,), (190.0,))
    for datum, given in (
        (Datum(values, "v"), {"initial": {"v": np.pad(values, 150)}}),
        (Datum(values, "source", drive), {"sources": [fh.Source(np.pad(values, 150), lambda t: np.sin(0.4 * t) ** 2)]}),
    ):
        sim = fh.Simulation(far, model, fh.Fixed(), dt=front.dt, threads=1, **given)
        largest = 0.0
        for _ in range(steps - 1):
            sim.step()
            largest = max(largest, abs(sim.fields["u"][190]))
        assert arrivals(front, steps, [datum], [], [], 1e-5).largest == pytest.approx(largest, rel=0.03)

"""What a side's layer sends back, predicted: against the infinite lattice, the exact reflection and runs."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

import farhorizon as fh
from farhorizon.analysis.exact.chain import Recursion
from farhorizon.analysis.layers import returned as returned_waves
from farhorizon.analysis.layers.layer import LatticeMedium, layer_amplitudes
from farhorizon.analysis.layers.returned import (
    Datum,
    Sample,
    arrivals,
    frequency_of_slow_waves,
    hold_backward_waves,
    reflected,
    round_a_point,
)
from farhorizon.analysis.layers.short_waves import high_pass, short_share
from farhorizon.analysis.references.infinite import InfiniteLattice
from farhorizon.engine.engine import Layer

SEED = 20261125
UNTIL = 60.0
print(f"long waves: seed {SEED}")


def medium(model, dim, share=0.5):
    stencil = model.stencil(1.0, dim)
    dt = share * 2 / np.sqrt(stencil.symbol_maximum)
    return LatticeMedium(stencil, 1.0, 1.0, Recursion.of(model.integrator, dt, model.damping), dt)


def pulse(shape, centre, width=3.0):
    grid = np.ix_(*[np.arange(n) for n in shape])
    return np.exp(-sum((x - a) ** 2 for x, a in zip(grid, centre, strict=True)) / width**2)


def rising(nodes, strength=4.0):
    depth = (np.arange(nodes + 1) + 0.5) / (nodes + 1)
    return Layer(np.ones(nodes + 1), strength * depth, 0.001 + 0.3 * depth**4)


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
    assert arrived.largest == pytest.approx(largest, rel=0.03)  # the moments that are looked at are not the run's


@pytest.mark.parametrize("smooth", [6.0, 12.0])
def test_long_waves_arrive_as_those_of_smoothed_data(smooth):
    """The same as on the infinite lattice, where data are smoothed along the side and the last row in time."""
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


@pytest.mark.parametrize("case", range(4))
def test_waves_that_hardly_move_stand_for_themselves(case, monkeypatch):
    """Of wide kernels of exponent 0 some waves hardly move and come back as they come. As long as faster ones of nearly
    their frequency stood for them, 0.02 to 0.4 of what comes back was predicted.
    """
    random = np.random.default_rng([SEED, case])
    front = medium(fh.Wave(fh.Kernel(float(random.integers(4, 7)), 0, "linear")), 1)
    u = np.exp(-(((np.arange(61) - random.uniform(25, 35)) / random.uniform(4.0, 5.0)) ** 2))
    layer = fh.LatticePML(nodes=44).make_layer(2, front.stencil, 1.0, 1.0, 0.0)
    monkeypatch.setattr(returned_waves, "_EACH", 0)  # as where they are too many to follow each by itself

    def returned():
        return arrivals(front, int(1500 / front.dt), [Datum(u, "u")], [], [], 1e-6, 1.0).returned(layer)

    of_sample = returned()
    monkeypatch.setattr(returned_waves, "_CELLS", (1000.0,) * 3)  # each wave by itself
    assert 0.6 < of_sample / returned() < 1.5


@pytest.mark.parametrize("case", range(6))
def test_all_modes_arrive_as_on_the_infinite_lattice(case):
    """Short pulses beside a side: waves that run backward arrive, too, and what dies out on the way; the slowest mode
    alone misses up to a third of it.
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
    """P and S waves of both components together, those that run backward among them, in bonds that have no stiffness
    across at their full length, and in elements.
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
    once = np.where(np.isin(arrived.factor.imag.round(12), 0.0), 0.5, 1.0)  # of the Laplace integral its ends
    waves = arrived.amplitude * arrived.shapes * once / steps
    along = np.exp(1j * np.outer(arrived.along[0], np.arange(shape[1])))
    for step in [*random.integers(1, steps, 8), steps - 1]:
        exact = infinite.after(int(step))[:, -1]
        arrives = -(waves * arrived.factor**step @ along).real  # sizes are what counts: signs are the other ones
        assert np.abs(arrives - exact).max() < 1e-4 * np.abs(u).max()


@pytest.mark.parametrize("case", range(6))
def test_backward_waves_of_sources_are_as_large_as_oscillators_swing(case):
    """Waves of a source go on swinging once it is steady: beside one that is switched on at once by as much less as
    oscillators of their frequencies do.
    """
    random = np.random.default_rng([SEED, 4, case])
    model = fh.Wave(fh.Kernel(float(random.integers(3, 7)), int(random.integers(0, 2)), "constant"))
    front, dim = medium(model, 1 + case % 2, random.choice([0.3, 0.5, 0.8])), 1 + case % 2
    first, shape = 0.8 * high_pass(front.stencil).first, (25, 19)[:dim]  # where waves begin that turn round
    u = pulse(shape, [12.0, 9.0][:dim], random.uniform(0.8, 1.2))
    course = np.minimum(np.arange(1500) * front.dt / random.uniform(0.5, 60.0), 1.0)
    k = np.linspace(first, np.pi, 9)
    squared = front.rate * front.stencil.symbol(k, *[np.zeros_like(k)] * (dim - 1)) * front.dt**2

    def swing(forces):
        old = new = np.zeros_like(squared)
        seen = []
        for force in forces:
            old, new = new, 2 * new - old - squared * (new - force)
            seen.append(new)
        last = np.array(seen[-700:])
        return last.max(0) - last.min(0)

    less = float((swing(course) / swing(np.ones_like(course))).max())
    limit = short_share(u, first) * less / 0.3
    given = [Datum(u, "source", course)]
    assert hold_backward_waves(front, given, 0.8 * limit) and not hold_backward_waves(front, given, 1.25 * limit)


@pytest.mark.parametrize("case", range(8))
def test_waves_that_run_backward_come_back_as_predicted(case):
    """Random lines whose data hold such waves: from as much as predicted to twice as much, where the echoes of both
    ends meet. As long as a sample stood for all waves, down to a hundredth was predicted.
    """
    random = np.random.default_rng([SEED, 3, case])
    model = fh.Wave(fh.Kernel(float(random.integers(3, 7)), int(random.integers(0, 2)), "constant"))
    width = random.uniform(1.8, 3.2)
    half = float(np.ceil(3.9 * width + 8))
    lattice = fh.Lattice(1.0, (-half,), (half,))
    u = np.exp(-((lattice.coordinates()[0] - random.uniform(-1, 1)) ** 2) / width**2)
    front, until = medium(model, 1, random.choice([0.3, 0.5, 0.8])), float(random.uniform(3, 10) * 2 * half)
    steps, layer = int(until / front.dt), fh.LatticePML(nodes=int(random.choice([8, 12, 16])))
    made = layer.make_layer(2, front.stencil, 1.0, 1.0, 0.0)
    predicted = max(
        arrivals(front, steps, [Datum(u, "u").turned(0, side)], [], [], 1e-6, 1.0, every=True).returned(made)
        for side in (-1, 1)
    )
    sim = fh.Simulation(lattice, model, layer, {"u": u}, dt=front.dt, threads=1)
    infinite, error = InfiniteLattice(front.stencil, 1.0, model.integrator, front.dt, steps, u), 0.0
    for step in range(1, steps + 1):
        sim.step()
        error = max(error, float(np.abs(sim.fields["u"] - infinite.after(step)).max()))
    assert predicted > 1e-6  # of which nothing is left out
    assert 0.5 < error / predicted < 2.5


@pytest.mark.parametrize("case", range(3))
def test_round_waves_are_what_a_point_of_a_side_sees_in_space(case):
    """Two pulses of different size, which no single point has around it; against the infinite lattice."""
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
    """Through an interface midway between two nodes 2/3 of a long wave's displacement passes where the speed is doubled
    at the same density; twice as much is what any density lets through at most, and is counted on.
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


@pytest.mark.parametrize("angle", [0.0, 40.0, 75.0])
def test_reflection_is_the_exact_one_of_a_single_mode(angle):
    front = medium(fh.Wave(fh.Stencil.finite_difference(2), 1.0), 2)
    wave, layer = front.plane_wave(9.0, angle), rising(6)
    found = reflected(np.array([wave.modes.incoming]), np.array([wave.s]), layer)
    # with one node of reach a wave returns as one mode, through the last edge once: the exact reflection has it twice
    # less the end
    assert abs(found[0]) == pytest.approx(np.abs(layer_amplitudes(wave, layer)[wave.modes.travels]).max(), rel=1e-9)


def test_modes_of_one_frequency_and_wavenumber_are_found_once(monkeypatch):
    """Both waves of a solid that come are picked from the same modes, and judged together as each by itself."""
    front = medium(fh.Elastic(fh.Kernel(2.0), 1.0, 0.3, material="state-based"), 2)
    calls, every = [], LatticeMedium.waves
    swings, along = front.plane_wave(30.0, 10.0, number=1), np.array([2 * np.pi / 30 * np.sin(np.radians(10.0))])
    near = [np.exp(1j * number) for number in (0.08, 0.2)]
    shapes = np.array([[1.0, 0.0], [0.0, 1.0]])
    alone = [front.wave(along, swings.factor, *one) for one in zip(near, shapes, strict=True)]
    monkeypatch.setattr(LatticeMedium, "waves", lambda *given: calls.append(given) or every(*given))
    sample, layer = returned_waves.Sample(front), rising(6)
    waves = [sample.wave(root, swings.factor, along, shape) for root, shape in zip(near, shapes, strict=True)]
    assert len(calls) == 1 and waves[0].modes.incoming != waves[1].modes.incoming
    for wave, one in zip(waves, alone, strict=True):
        assert wave.modes.incoming == one.modes.incoming and np.array_equal(wave.modes.vector, one.modes.vector)
    together = returned_waves._judged(waves, layer)
    assert together == pytest.approx(np.hstack([returned_waves._judged([wave], layer) for wave in waves]), rel=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_prediction_is_the_error_of_a_run(seed):
    """Random pulses, kernels, steps and lengths: the largest error of a run over the prediction is a small factor."""
    random = np.random.default_rng(seed)
    exponent, influence, reach = [(2, "constant", 1), (2, "constant", 3), (1, "linear", 2), (2, "gaussian", 4)][
        seed % 4
    ]
    model = fh.Wave(fh.Kernel(float(reach), exponent, influence), 1.0)
    shape = (31, int(random.choice([31, 61])))
    centre = np.array([random.uniform(14, 16), random.uniform(15, shape[1] - 16)])
    u, front = pulse(shape, centre, random.uniform(2.0, 2.8)), medium(model, 2, random.choice([0.3, 0.8]))
    until = float(random.uniform(60, 150))
    steps, layer = int(until / front.dt), rising(int(random.integers(3, 7)))
    predicted = 0.0
    for axis in range(2):
        for side in (-1, 1):
            facing = LatticeMedium(front.stencil.along(axis), 1.0, 1.0, front.recursion, front.dt)
            nodes = shape[1 - axis]
            arrived = arrivals(
                facing, steps, [Datum(u, "u").turned(axis, side)], [nodes + int(until)], [range(nodes)], 1e-6, 1.0
            )
            predicted = max(predicted, arrived.returned(layer))
    boundary = fh.LatticePML(nodes=layer.columns, profile=layer)
    sim = fh.Simulation(
        fh.Lattice(1.0, (0.0, 0.0), np.array(shape) - 1.0), model, boundary, {"u": u}, dt=front.dt, threads=1
    )
    infinite = InfiniteLattice(front.stencil, 1.0, model.integrator, front.dt, steps, u)
    error = 0.0
    for step in np.linspace(1, steps, 60).astype(int):
        sim.step(int(step) - sim.step_count)
        error = max(error, float(np.abs(sim.fields["u"] - infinite.after(int(step))).max()))
    assert 0.25 < error / predicted < 3


def test_backward_waves_do_not_grow_in_what_is_predicted():
    """Forces on two rows that run towards the side hold them, as those on the faces of a crack do; the closed form lets
    them grow by a hundred and more, the layer damps them.
    """
    model = fh.Elastic(fh.Kernel(2.0, exponent=1), young=1.0)
    front = medium(model, 2)
    rows = np.zeros((60, 40))
    rows[10:50, 19:21] = 1.0, -1.0
    datum = Datum(rows, "u", component=1)
    arrived = arrivals(front, int(800.0 / front.dt), [datum], [120], [range(40)], 1e-3, 1.0, Sample(front, 1))
    layer = fh.LatticePML(nodes=24).make_layer(2, front.stencil, front.coefficient, 1.0, 0.0)
    assert np.abs(reflected(arrived.root, arrived.frequency, layer)).max() > 100
    assert arrived.returned(layer) <= arrived.largest  # no more comes back than came


@pytest.mark.parametrize(("reach", "width"), [(6, 5.0), (5, 4.0), (3, 2.5)])
def test_what_dies_out_beside_a_layer_counts(reach, width):
    """Thin layers turn waves of a wide stencil into what stays beside them; targets hold there, too."""
    lattice = fh.Lattice(1.0, (-36.0,), (36.0,))
    model, u = fh.Wave(fh.Kernel(float(reach), 2)), np.exp(-(np.arange(-36.0, 37.0) ** 2) / width**2)
    limit = fh.Simulation(lattice, model, fh.Fixed()).step_limit
    layer = fh.LatticePML(target=1e-6, until=190.0)
    sim = fh.Simulation(lattice, model, layer, {"u": u}, dt=0.8 * limit, threads=1)
    steps, error = int(190 / sim.dt), 0.0
    infinite = InfiniteLattice(sim.stencil, 1.0, model.integrator, sim.dt, steps, u)
    for step in np.unique(np.linspace(1, steps, 60).astype(int)):
        sim.step(int(step) - sim.step_count)
        error = max(error, float(np.abs(sim.fields["u"] - infinite.after(int(step))).max()))
    assert error <= 1e-6


def test_frequencies_from_which_on_waves_are_slow():
    """By the slope of the dispersion relation of the steps, on a finer sample of wavenumbers."""
    one, k = medium(fh.Wave(fh.Kernel(3.0, 1, "constant")), 2, 0.9), np.linspace(0, np.pi, 1201)
    turn = one.dt * np.sqrt(np.maximum(one.stencil.symbol(*np.ix_(k, k)), 0.0)) / 2
    omega = 2 / one.dt * np.arcsin(turn)
    speed = np.hypot(*np.gradient(omega, k, k))
    for most in (0.5, 0.2, 0.1):
        found = frequency_of_slow_waves(one, most)
        assert 0 < found < omega.max()
        assert speed[omega > found].max() < 1.05 * most
        assert speed[omega > 0.99 * found].max() > 0.95 * most
    assert frequency_of_slow_waves(one, 1.5) == 0

"""Errors of layers that choose their thickness are below the target, for set-ups on which nothing was tuned."""

import os
import warnings
from dataclasses import replace

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.references.infinite import InfiniteLattice
from farhorizon.studies.compare import compare

SEED = 20261122
KERNELS = [(2, "constant", 1), (2, "constant", 3), (1, "linear", 4), (2, "gaussian", 3), (2, "linear", 5)]


def pulse(lattice, centre, width):
    return np.exp(-sum((x - a) ** 2 for x, a in zip(lattice.coordinates(), centre, strict=True)) / width**2)


def wave_setup(random, dim):
    """A pulse anywhere in a near field of up to 3 : 1 that contains it, and a run of 2 to 12 crossings."""
    exponent, influence, reach = KERNELS[random.integers(len(KERNELS) if dim < 3 else 2)]
    shape = random.choice([25, 33, 41], dim) if dim < 3 else np.full(3, 17)
    if dim == 2:
        shape = np.array([25, 25 * random.choice([1, 2, 3])])
    width = random.uniform(1.9, 2.3) if dim < 3 else 1.6
    room = np.maximum((shape - 1) / 2 - 3.8 * width - reach, 0)
    lattice = fh.Lattice(1.0, -(shape - 1) / 2, (shape - 1) / 2)
    model = fh.Wave(fh.Kernel(float(reach), exponent, influence), 1.0, damping=float(random.choice([0.0, 0.02])))
    until = float(random.uniform(2, 12 if dim < 3 else 2.5) * max(shape))
    return lattice, model, pulse(lattice, random.uniform(-1, 1, dim) * room, width), until


def with_layers(setup, target, until, most=None, **periodic):
    """Return the run with layers for a target, and the target. If it is refused, the least possible one, which the
    message names, replaces it. It must be above the target and below `most`: unless given, 1e-3, the largest target
    that is asked for here, or for targets above 1e-4 ten times the target.
    """

    def run(target):
        layer = fh.LatticePML(target=target, until=until)
        return fh.Simulation(**setup, boundary={"all": layer, **periodic} if periodic else layer)

    try:
        return run(target), target
    except fh.InputError as refused:
        assert "no layer meets the target" in str(refused)
        least = 1.01 * float(str(refused.limit).removeprefix(">= "))
        print(f"target {target:.3g}, refused: {least:.3g}")
        assert target < least < (most or max(1e-3, 10 * target))
        return run(least), least


def worst_error(sim, u, until, times=40):
    infinite = InfiniteLattice(
        sim.stencil,
        sim.model.coefficient,
        sim.model.integrator,
        sim.dt,
        int(until / sim.dt),
        u,
        damping=sim.model.damping,
    )
    worst = 0.0
    for step in np.linspace(1, int(until / sim.dt), times).astype(int):
        sim.step(int(step) - sim.step_count)
        exact = infinite.after(int(step))
        scale = np.abs(u).max() if sim.model.order == 2 else np.abs(exact).max()
        worst = max(worst, float(np.abs(sim.fields["u"] - exact).max() / scale))
    return worst


@pytest.mark.parametrize("case", [*range(5), *(pytest.param(n, marks=pytest.mark.slow) for n in range(5, 60))])
def test_random_waves_keep_their_target(case):
    random = np.random.default_rng([SEED, case])
    lattice, model, u, until = wave_setup(random, 1 + case % 3 if case < 12 else int(random.integers(1, 4)))
    target = 10.0 ** -random.integers(3, 7)
    sim = fh.Simulation(lattice, model, fh.LatticePML(target=target, until=until), {"u": u}, threads=1)
    assert worst_error(sim, u, until, 40 if lattice.dim < 3 else 12) <= target
    assert max(one.layer.columns for one in sim.thickness.values()) <= 12 if lattice.dim > 1 else True


def elastic_setup(random):
    """A P or S pulse, or one of both, in a near field of up to 2 : 1; four kinds of material, 2 to 6 crossings."""
    kernel = fh.Kernel(*[(1.0, 1), (2.0, 1), (2.0, 2), (3.0, 1, "linear"), (3.0, 1, "gaussian")][random.integers(5)])
    model = [
        fh.Elastic(kernel, young=1.0),
        fh.Elastic(kernel, young=1.0, poisson=0.3, material="state-based"),
        fh.Elastic(None, young=1.0, poisson=0.3, material="finite-element"),
        fh.Elastic(fh.Kernel(2.0, 2), young=1.0, poisson=0.3, material="correspondence", stabilisation=0.5),
    ][random.integers(4)]
    width = random.uniform(2.6, 3.4)
    short = int(np.ceil(2 * (3.9 * width + max(model.stencil(1.0, 2).reach)))) + 1
    half = (np.array([short, short * random.choice([1, 1, 2])]) - 1) / 2
    lattice = fh.Lattice(1.0, -half, half)
    centre = random.uniform(-1, 1, 2) * (half - half.min())
    x, y = (at - a for at, a in zip(lattice.coordinates(), centre, strict=True))
    g = np.exp(-(x**2 + y**2) / width**2)
    u = np.stack([(x * g, y * g), (-y * g, x * g), (g, 0.5 * g)][random.integers(3)])
    return lattice, model, u, float(random.uniform(2, 6)) * 2 * half.max() / model.p_speed


@pytest.mark.parametrize("case", [*range(2), *(pytest.param(n, marks=pytest.mark.slow) for n in range(2, 24))])
def test_random_elastic_pulses_keep_their_target(case):
    random = np.random.default_rng([SEED, 2, case])
    lattice, model, u, until = elastic_setup(random)
    target, share = 10.0 ** -random.integers(3, 7), random.choice([0.5, 0.8, 0.95])
    dt = share * fh.Simulation(lattice, model, fh.Fixed(), threads=1).step_limit
    setup = {"lattice": lattice, "model": model, "initial": {"u": u}, "dt": dt, "threads": 1}
    sim, target = with_layers(setup, target, until, 1e-3)
    assert set(sim.thickness) == {"x-", "x+", "y-", "y+"}
    assert worst_error(sim, u, until, 24) <= target


@pytest.mark.slow
@pytest.mark.parametrize("case", range(16))
def test_random_dragged_pulses_keep_their_target(case):
    """Drag moves velocities towards the mean of their neighbours, also in the layers and across a side. Solids of
    several kernels, displaced or struck, against a domain from which nothing returns.
    """
    seed = int(os.environ.get("FARHORIZON_SEED", np.random.default_rng().integers(2**31)))
    random = np.random.default_rng([seed, case])
    print(f"seed {seed}, set-up {case}")
    shape, until, target = random.integers(21, 33, 2), 50.0, 10.0 ** -random.uniform(3, 6)
    kernel = fh.Kernel(float(random.choice([1.5, 2.0, 2.6, 3.0])), int(random.integers(3)))
    poisson, stabilisation, drag = random.uniform(0.05, 0.4), random.uniform(0.3, 1), 10 ** random.uniform(-2.5, 0)
    bell = pulse(fh.Lattice(1.0, (0.0, 0.0), shape - 1.0), (shape - 1) / 2, random.uniform(2.0, 2.8))
    model = fh.Correspondence(kernel, 1.0, poisson, stabilisation=stabilisation, drag=drag)
    kind = str(random.choice(["u", "v"]))
    assert dragged_error(model, {kind: np.stack([bell, random.uniform(-1, 1) * bell])}, target, until) <= target


def dragged_error(model, initial, target, until):
    """Return the error of layers for a target relative to the largest value, against a domain larger on each side by
    three quarters of the way of long waves, since short ones run ahead of them until drag stops them.
    """
    ((kind, values),) = initial.items()
    shape, room = np.array(values.shape[1:]), int(0.75 * until * model.p_speed) + 8
    sim = fh.Simulation(
        fh.Lattice(1.0, (0.0, 0.0), shape - 1.0), model, fh.LatticePML(target=target, until=until), initial, threads=1
    )
    wide = fh.Lattice(1.0, (-room, -room), shape - 1.0 + room)
    around = np.pad(values, [(0, 0), (room, room), (room, room)])
    large = fh.Simulation(wide, model, fh.Fixed(), {kind: around}, dt=sim.dt, threads=1)
    worst, largest = 0.0, np.abs(values).max() if kind == "u" else 0.0
    while sim.time < until - 4 * sim.dt:
        for one in (sim, large):
            one.step(4)
        inside = large.fields["u"][:, room:-room, room:-room]
        worst, largest = max(worst, np.abs(sim.fields["u"] - inside).max()), max(largest, np.abs(inside).max())
    return worst / largest


@pytest.mark.parametrize("drag", [0.02, 0.5])
def test_layers_drag_as_the_medium_does(drag):
    """When the drag read the values in the layer as they are, 3 and 45 times the target came back."""
    model = fh.Correspondence(fh.Kernel(2.0, 1), 1.0, 0.3, stabilisation=0.5, drag=drag)
    bell = pulse(fh.Lattice(1.0, (-12.0, -12.0), (12.0, 12.0)), (0.0, 0.0), np.sqrt(8.0))
    assert dragged_error(model, {"u": np.stack([bell, 0 * bell])}, 1e-5, 50.0) <= 1e-5


def test_no_images_are_heard_in_long_runs():
    """Where the medium continues along the sides, a run ten times as long needs only a few nodes more; once, waves of
    images travelled along them, and 59 nodes were chosen instead of 12.
    """
    lattice = fh.Lattice(1.0, (-25.0, -25.0), (25.0, 25.0))
    model, u = fh.Elastic(fh.Kernel(2.0, 1, "gaussian"), young=1.0), pulse(lattice, (4.0, -3.0), 5.0)

    def nodes(until):
        boundary = fh.LatticePML(target=1e-3, until=until)
        sim = fh.Simulation(lattice, model, boundary, {"u": np.stack([u, 0.5 * u])}, threads=1)
        return sim.thickness["x-"].layer.columns

    assert nodes(1300.0) <= nodes(130.0) + 4 <= 20


@pytest.mark.slow
@pytest.mark.parametrize("model", [fh.Elastic(fh.Kernel(2.0, 1), young=1.0), fh.Wave(fh.Stencil.finite_element(2))])
def test_sources_that_go_on_ask_for_no_more_in_long_runs(model):
    """20 crossings, of waves in a solid and of finite elements under a force that stays; once, images of the source
    were heard, and 45 to 60 nodes were chosen instead of 13 to 16.
    """
    random, speed = np.random.default_rng([SEED, 6, model.order]), np.sqrt(model.coefficient)
    lattice, stays = fh.Lattice(1.0, (-20.0, -20.0), (20.0, 20.0)), isinstance(model, fh.Wave)
    shape, period = pulse(lattice, random.uniform(-4, 4, 2), 3.0), random.uniform(15.0, 40.0) / speed
    source = fh.Source(
        shape if stays else np.stack([shape, 0 * shape]),
        lambda t: min(t * speed / 40, 1.0) * (1.0 if stays else np.sin(2 * np.pi * t / period)),
    )
    boundary, until = fh.LatticePML(target=1e-4, until=820.0 / speed), 820.0 / speed
    setup = {"lattice": lattice, "model": model, "boundary": boundary, "sources": [source], "threads": 1}
    assert max(one.layer.columns for one in fh.Simulation(**setup).thickness.values()) <= 20
    found = compare(setup, until, beside=False)
    assert max(found.curves["lattice PML"]["error_rel_initial"]) <= 1e-4


def pulse_in_elements(width, target, until=494.0):
    lattice = fh.Lattice(1.0, (-18.5, -18.5), (18.5, 18.5))
    model, sides = fh.Wave(fh.Stencil.finite_element(2)), fh.LatticePML(target=target, until=until)
    initial = {"u": pulse(lattice, (0.5, 0.5), width)}
    return {"lattice": lattice, "model": model, "boundary": sides, "initial": initial, "threads": 1}


@pytest.mark.slow
def test_backward_waves_take_no_more_nodes_than_they_need():
    """When some waves were not followed individually they rang in the prediction, and what comes after the end of the
    run folded back into it: 19 nodes were chosen.
    """
    assert max(one.nodes for one in fh.Simulation(**pulse_in_elements(2.5, 1e-4)).thickness.values()) <= 8


@pytest.mark.slow
@pytest.mark.parametrize(("width", "target", "most"), [(2.5, 1e-4, 8), (4.0, 1e-5, 16), (3.0, 1e-6, 24)])
def test_backward_waves_keep_their_target_with_no_more(width, target, most):
    """Once, 19, 28 and 35 nodes were chosen."""
    setup = pulse_in_elements(width, target)
    assert max(one.nodes for one in fh.Simulation(**setup).thickness.values()) <= most
    assert max(compare(setup, 494.0, beside=False).curves["lattice PML"]["error_rel_initial"]) <= target


@pytest.mark.slow
@pytest.mark.parametrize("case", range(8))
def test_sources_of_any_pace_keep_their_target_where_waves_run_backward(case):
    """Random forces that rise slowly or at once, and then stay or oscillate. If a target is refused, the least one that
    is named instead is kept.
    """
    seed = int(os.environ.get("FARHORIZON_SEED", np.random.default_rng().integers(2**31)))
    print(f"seed {seed}, set-up {case}")
    setup, target, until = forced_setup(np.random.default_rng([seed, case]), 1 + case % 2)
    _, target = with_layers(setup, target, until)
    found = compare({**setup, "boundary": fh.LatticePML(target=target, until=until)}, until, beside=False)
    assert max(found.curves["lattice PML"]["error_rel_initial"]) <= target


def forced_setup(random, dim):
    """A force in a medium in which some waves run backward, and 3 to 12 crossings."""
    half = 18.0
    kernel = fh.Kernel(float(random.integers(2, 5)), int(random.integers(0, 2)), "constant")
    model = fh.Wave(fh.Stencil.finite_element(dim) if random.random() < 0.5 else kernel)
    lattice = fh.Lattice(1.0, (-half,) * dim, (half,) * dim)
    rise, period, stays = np.exp(random.uniform(0, 4)), random.uniform(12.0, 40.0), random.random() < 0.5
    shape = pulse(lattice, random.uniform(-4, 4, dim), random.uniform(2.0, 3.0))
    source = fh.Source(shape, lambda t: min(t / rise, 1.0) * (1.0 if stays else np.sin(2 * np.pi * t / period)))
    target, until = float(random.choice([1e-3, 1e-4])), float(random.uniform(3, 12) * 2 * half)
    return {"lattice": lattice, "model": model, "sources": [source], "threads": 1}, target, until


@pytest.mark.parametrize("kind", ["bar", "line", pytest.param("plane", marks=pytest.mark.slow)])
def test_few_targets_for_sources_are_refused(kind):
    """Of random set-ups like those of the test above and the one below, which keep their target or the least that is
    named instead, at least three in four keep the one that is asked for.
    """
    kept, count = 0, {"bar": 24, "line": 16, "plane": 8}[kind]
    for case in range(count):
        random = np.random.default_rng([SEED, 11, case])
        setup, target, until = bar_setup(random) if kind == "bar" else forced_setup(random, 1 + (kind == "plane"))
        kept += with_layers(setup, target, until)[1] == target
    assert kept >= 0.75 * count


@pytest.mark.parametrize("case", [*range(4), *(pytest.param(n, marks=pytest.mark.slow) for n in range(4, 24))])
def test_sources_at_the_end_of_a_bar_keep_their_target(case):
    """Waves that decay within a node or two without travelling reach the layer from one of its last nodes: smooth
    forces that leave the bar displaced, against a bar that continues. A target is kept, or the least one that is named
    when it is refused, up to a reach of 4; wider stencils may leave four times the target (docs/limits.md).
    """
    seed = int(os.environ.get("FARHORIZON_SEED", np.random.default_rng().integers(2**31)))
    print(f"seed {seed}, set-up {case}")
    setup, target, until = bar_setup(np.random.default_rng([seed, case]))
    exact = fh.Simulation(**setup, boundary=fh.Extended(target=1e-3 * target, until=until))
    run, target = with_layers(setup, target, until)
    worst = largest = 0.0
    while run.time < until:
        run.step(3)
        exact.step(3)
        here = exact.fields["u"]
        largest = max(largest, np.abs(here).max())
        worst = max(worst, np.abs(run.fields["u"] - here).max())
    assert worst <= target * largest


def bar_setup(random):
    """A bar, with a force on one of its first three nodes."""
    volume, influence = random.choice(["ramp", "full"]), random.choice(["constant", "gaussian"])
    kernel = fh.Kernel(float(random.integers(2, 5)), int(random.integers(1, 3)), str(influence), volume=str(volume))
    force, target, until = np.zeros(60), 10.0 ** -random.integers(3, 7), random.uniform(150.0, 600.0)
    force[random.integers(0, 3)] = 1.0
    setup = {
        "lattice": fh.Lattice(1.0, (0.0,), (59.0,)),
        "model": fh.Wave(kernel, damping=float(random.choice([0.0, 0.02]))),
        "sources": [fh.Source(force, fh.Gaussian(random.uniform(4.0, 20.0)))],
        "threads": 1,
    }
    return setup, target, until


@pytest.mark.parametrize("place", [0, 1, 2])
@pytest.mark.parametrize(("reach", "influence", "target"), [(3.0, "constant", 1e-4), (6.0, "linear", 1e-3)])
def test_what_comes_back_of_a_source_at_the_end_of_a_bar_is_known(reach, influence, target, place):
    """The prediction for the layer next to it is the error of the run, to the digits that are reported."""
    force, until = np.zeros(60), 300.0
    force[place] = 1.0
    setup = {
        "lattice": fh.Lattice(1.0, (0.0,), (59.0,)),
        "model": fh.Wave(fh.Kernel(reach, 2, influence)),
        "sources": [fh.Source(force, fh.Gaussian(9.0))],
        "threads": 1,
    }
    sides = fh.LatticePML(target=target, until=until), fh.Extended(target=1e-4 * target, until=until)
    run, exact = (fh.Simulation(boundary={"x-": side, "x+": fh.LatticePML(nodes=40)}, **setup) for side in sides)
    worst = largest = 0.0
    while run.time < until - 2 * run.dt:
        run.step(2)
        exact.step(2)
        here = exact.fields["u"]
        largest = max(largest, np.abs(here).max())
        worst = max(worst, np.abs(run.fields["u"] - here).max())
    assert worst / largest == pytest.approx(run.thickness["x-"].predicted, rel=0.03)


@pytest.mark.parametrize("case", [6, 7, *(pytest.param(n, marks=pytest.mark.slow) for n in range(6))])
def test_echoes_of_all_sides_meet_in_the_middle(case):
    """Each is predicted to make at most 0.2 of the target there; when each side was considered alone, they made 1.04
    of it together (case 6).
    """
    random = np.random.default_rng([SEED, 5, case])
    half = random.integers(20, 37) + np.zeros(2)
    lattice, model = fh.Lattice(1.0, -half, half), fh.Wave(fh.Stencil.finite_element(2))
    u = pulse(lattice, random.uniform(-4, 4, 2), random.uniform(3.0, 4.5))
    target, until = 10.0 ** -random.integers(3, 5), random.uniform(2, 4) * 2 * half[0]
    sim = fh.Simulation(lattice, model, fh.LatticePML(target=target, until=until), {"u": u}, threads=1)
    assert worst_error(sim, u, until) <= 0.8 * target


@pytest.mark.slow
@pytest.mark.parametrize("case", range(3))
def test_slow_echoes_of_all_sides_count_in_long_runs(case):
    """Long waves return from all sides at once, and are predicted to make at most 0.8 of the target together."""
    random = np.random.default_rng([SEED, 4, case])
    lattice, model = fh.Lattice(1.0, (-31.0, -62.0), (31.0, 62.0)), fh.Wave(fh.Kernel(1.0))
    u = pulse(lattice, random.uniform(-1, 1, 2) * (8.0, 35.0), random.uniform(4.0, 7.0))
    sim = fh.Simulation(lattice, model, fh.LatticePML(target=1e-5, until=2100.0), {"u": u}, threads=1)
    assert worst_error(sim, u, 2100.0, 60) <= 0.8e-5
    assert max(one.layer.columns for one in sim.thickness.values()) <= 10


@pytest.mark.slow
@pytest.mark.parametrize("case", range(8))
def test_random_elastic_pulses_keep_their_target_in_long_runs(case):
    """10 to 30 crossings, with few nodes more than in short runs."""
    random = np.random.default_rng([SEED, 3, case])
    lattice, model, u, until = elastic_setup(random)
    target, until = 10.0 ** -random.integers(3, 6), until * 5
    sim = fh.Simulation(lattice, model, fh.LatticePML(target=target, until=until), {"u": u}, threads=1)
    assert worst_error(sim, u, until, 40) <= target
    assert max(one.layer.columns for one in sim.thickness.values()) <= 24


@pytest.mark.slow
def test_stabilised_correspondence_takes_as_few_nodes_as_scalars_and_bonds_more():
    """Without backward waves nothing is damped, so that vectors reflect little more than scalars; bonds need 4 or 5
    nodes for 1e-3.
    """
    lattice = fh.Lattice(1.0, (-16.0, -16.0), (16.0, 16.0))
    x, y = lattice.coordinates()
    g = np.exp(-(x**2 + y**2) / 2.55**2)

    def nodes(model, u, target):
        until = 110.0 / np.sqrt(model.coefficient)
        return (
            fh.Simulation(lattice, model, fh.LatticePML(target=target, until=until), {"u": u}, threads=1)
            .thickness["x-"]
            .layer.columns
        )

    soft = fh.Elastic(fh.Kernel(2.0, 2), young=1.0, poisson=0.3, material="correspondence", stabilisation=0.5)
    bonds = fh.Elastic(fh.Kernel(2.0, 1), young=1.0)
    assert [
        nodes(soft, np.stack([x * g, y * g]), target) <= most for target, most in ((1e-3, 4), (1e-4, 5), (1e-5, 7))
    ] == [True] * 3
    assert nodes(soft, np.stack([x * g, y * g]), 1e-5) <= nodes(fh.Wave(fh.Kernel(2.0)), x * g, 1e-5) + 1
    assert nodes(bonds, np.stack([x * g, y * g]), 1e-3) <= 5 < nodes(bonds, np.stack([x * g, y * g]), 1e-4) <= 12


@pytest.mark.parametrize("case", [*range(4), *(pytest.param(n, marks=pytest.mark.slow) for n in range(4, 30))])
def test_random_diffusion_keeps_its_target_at_all_times(case):
    random = np.random.default_rng([SEED, 1, case])
    dim = 1 + case % 2
    shape = np.array([25, 25 * random.choice([1, 3])])[:dim]
    lattice = fh.Lattice(1.0, -(shape - 1) / 2, (shape - 1) / 2)
    model = fh.Diffusion(fh.Kernel(float(random.integers(1, 4)), int(random.integers(0, 3))), 1.0)
    u = pulse(lattice, random.uniform(-1, 1, dim) * np.maximum((shape - 1) / 2 - 12, 0), 2.0)
    target, until = (
        10.0 ** -random.integers(3, 8),
        float(random.choice([1, 10, 50] if dim == 2 else [10, 50, 300]) * 12**2),
    )
    sim = fh.Simulation(lattice, model, fh.LatticePML(target=target, until=until), {"u": u}, threads=1)
    assert worst_error(sim, u, until) <= target


@pytest.mark.sampled(2)
@pytest.mark.parametrize("wall", [fh.Free(), fh.Fixed()], ids=["free", "held"])
@pytest.mark.parametrize(
    "model",
    [fh.Elastic(fh.Kernel(2.0, 1, "linear"), young=1.0), fh.Wave(fh.Kernel(3.0, 1, "constant"))],
    ids=["elastic", "scalar"],
)
def test_waves_along_a_wall_keep_the_target(model, wall):
    """Where layers damp short waves, those that travel along a free or fixed side leave like all others: P, S and
    surface waves, against a domain from which nothing returns.
    """
    lattice, until, target = fh.Lattice(1.0, (-15.0, -20.0), (15.0, 0.0)), 120.0, 1e-5
    bell = pulse(lattice, np.array([1.0, -10.0]), 3.0)
    initial = {"u": bell if isinstance(model, fh.Wave) else np.stack([0.3 * bell, bell])}

    def run(far, dt=None):
        return fh.Simulation(lattice, model, {"x": far, "y-": far, "y+": wall}, initial, dt=dt, threads=1)

    enlarged = run(fh.Extended(target=1e-9, until=until))
    layers = run(fh.LatticePML(target=target, until=until), enlarged.dt)
    assert all(layer.damping.any() for layer in layers.engine.layers.values())
    worst = 0.0
    for _ in range(40):
        for sim in (layers, enlarged):
            sim.step(int(until / sim.dt / 40))
        worst = max(worst, float(np.abs(layers.fields["u"] - enlarged.fields["u"]).max()))
    assert worst <= target * np.abs(initial["u"]).max()


@pytest.mark.parametrize("case", [*range(2), *(pytest.param(n, marks=pytest.mark.slow) for n in range(2, 20))])
def test_waves_that_alternate_are_kept_back_or_refused(case):
    """Near the limit of Euler's step, the shortest waves of diffusion change sign in every step and hardly decay:
    layers become thicker, or the target is refused, and the least possible one is named.
    """
    random = np.random.default_rng([SEED, 4, case])
    dim = 1 + case % 2
    reach = float(random.integers(2, 6))
    model = fh.Diffusion(fh.Kernel(reach, int(random.integers(0, 2)), "constant", volume="ramp"), 1.0)
    half = np.full(dim, 10 + reach) + random.integers(0, 6)
    lattice = fh.Lattice(1.0, -half, half)
    u, until = pulse(lattice, random.uniform(-1, 1, dim), 2.0), float(half[0] ** 2)
    dt = random.choice([0.6, 0.8, 0.95]) * fh.Simulation(lattice, model, fh.Fixed()).step_limit
    sim, target = with_layers(
        {"lattice": lattice, "model": model, "initial": {"u": u}, "dt": dt, "threads": 1}, 1e-6, until
    )
    assert worst_error(sim, u, until) <= target


@pytest.mark.slow
def test_waves_that_outlive_those_steps_are_refused():
    """At 0.99 of the limit they keep 0.98 of their size in each step, and outlast the steps that are followed."""
    model, lattice = fh.Diffusion(fh.Kernel(2.0, 0, "constant"), 1.0), fh.Lattice(1.0, (-13.0,), (13.0,))
    limit = fh.Simulation(lattice, model, fh.Fixed()).step_limit
    setup = {"lattice": lattice, "model": model, "initial": {"u": pulse(lattice, np.zeros(1), 2.0)}, "dt": 0.99 * limit}
    with pytest.raises(fh.InputError, match="hardly damps") as refused:
        fh.Simulation(**setup, boundary=fh.LatticePML(target=1e-6, until=400.0))
    assert refused.value.key == "boundary.target"


def test_what_layers_given_by_hand_send_back_of_alternating_waves_is_told():
    model, lattice = fh.Diffusion(fh.Kernel(4.0, 0, "constant"), 1.0), fh.Lattice(1.0, (-15.0,), (15.0,))
    u, limit = pulse(lattice, np.zeros(1), 2.0), fh.Simulation(lattice, model, fh.Fixed()).step_limit

    def notes(nodes, share):
        layer = fh.LatticePML(nodes=nodes, target=1e-6, until=400.0)
        return fh.Simulation(lattice, model, layer, {"u": u}, dt=share * limit, threads=1).notes

    assert any("alternate from step to step" in note and "1e-06" in note for note in notes(4, 0.8))
    assert not any("alternate" in note for note in notes(4, 0.4))
    assert not notes(40, 0.8)


def told_and_missed(lattice, model, layer, u):
    """Return the reflection that a set-up reports for layers given by hand, of which a check warns, and the largest
    error of the run, for diffusion relative to the largest value at the same time.
    """
    until = layer.until
    near = fh.Simulation(lattice, model, layer, {"u": u}, threads=1)
    said = [note for note in near.notes if "predicted to reflect" in note]
    assert set(said) <= set(near.check(until).warnings)
    told = max(float(note.split("reflect ")[1].split()[0]) for note in said)
    whole = InfiniteLattice(near.stencil, 1.0, model.integrator, near.dt, int(until / near.dt), u)
    missed = 0.0
    for step in np.geomspace(10, until / near.dt, 40).astype(int):
        near.step(int(step) - near.step_count)
        exact = whole.after(int(step))
        size = np.abs(exact).max() if isinstance(model, fh.Diffusion) else np.abs(u).max()
        missed = max(missed, float(np.abs(near.fields["u"] - exact).max() / size))
    print(told, missed)
    return told, missed


@pytest.mark.sampled(2)
@pytest.mark.parametrize("number", range(6))
def test_what_layers_given_by_hand_send_back_of_diffusion_is_told(number):
    """Within a factor of five of what is measured, at the worst time."""
    random = np.random.default_rng([SEED, number])
    print("seed", SEED)
    dim, half, nodes = 1 + number % 2, float(random.integers(12, 20)), int(random.integers(3, 10))
    lattice, model = fh.Lattice(1.0, (-half,) * dim, (half,) * dim), fh.Diffusion(fh.Kernel(2.0), 1.0)
    u, until = pulse(lattice, random.uniform(-3, 3, dim), 3.0), float(random.uniform(2, 8) * half**2)
    told, missed = told_and_missed(lattice, model, fh.LatticePML(nodes=nodes, target=1e-9, until=until), u)
    assert told / 5 < missed < 5 * told


@pytest.mark.sampled(4)
@pytest.mark.parametrize("number", range(12))
def test_what_profiles_by_hand_send_back_is_told(number):
    """For waves and diffusion alike, whatever the stretch; a whole `Layer` is not assessed."""
    random = np.random.default_rng([SEED, number])
    print("seed", SEED)
    dim, half, nodes = 1 + number % 2, float(random.integers(12, 20)), int(random.integers(3, 10))
    lattice, kernel = fh.Lattice(1.0, (-half,) * dim, (half,) * dim), fh.Kernel(float(random.integers(1, 4)), 2)
    depth = (np.arange(nodes + 1) + 0.5) / (nodes + 1)
    if number % 4 < 2:
        model, until = fh.Wave(kernel, 1.0), float(random.uniform(4, 12) * half)
        sigma, alpha = random.uniform(0.5, 3) * depth ** random.uniform(0.5, 2), random.uniform(0, 0.1) * depth**4
        profile = {"sigma": sigma, "alpha": alpha}
    else:
        model, until = fh.Diffusion(kernel, 1.0), float(random.uniform(2, 8) * half**2)
        profile = {"kappa": 1 + random.uniform(1, 8) * depth ** random.uniform(1, 2)}
    u, by_hand = pulse(lattice, random.uniform(-3, 3, dim), 3.0), fh.LatticePML(1e-13, nodes, profile, until)
    told, missed = told_and_missed(lattice, model, by_hand, u)
    rounded = 10 ** np.floor(np.log10(told)) / 2  # what is told has one digit
    assert (told - rounded) / 5 < missed < 5 * (told + rounded)
    layer = next(iter(fh.Simulation(lattice, model, by_hand).engine.layers.values()))
    whole = fh.Simulation(lattice, model, fh.LatticePML(1e-13, nodes, layer, until), {"u": u}, threads=1)
    assert not any("more than the target" in note for note in whole.notes)


def test_short_waves_that_stages_hardly_damp_are_refused():
    """The stages of Runge-Kutta-Chebyshev leave nine tenths of short waves in each step, which layers reflect."""
    lattice = fh.Lattice(1.0, (-13.0,), (13.0,))
    model = fh.Diffusion(fh.Kernel(2.0, 0, "constant"), 1.0, integrator=fh.RungeKuttaChebyshev(8))
    limit = fh.Simulation(lattice, model, fh.Fixed()).step_limit
    setup = {"lattice": lattice, "model": model, "initial": {"u": pulse(lattice, np.zeros(1), 2.0)}, "dt": 0.6 * limit}
    with pytest.raises(fh.InputError, match="hardly damps") as refused:
        fh.Simulation(**setup, boundary=fh.LatticePML(target=1e-6, until=400.0))
    assert refused.value.key == "boundary.target"
    sim = fh.Simulation(**setup, boundary=fh.LatticePML(until=400.0))
    assert any("hardly damps" in note for note in sim.notes)


def backward_setup(random, where):
    """A narrow pulse in a medium in which many waves run backward; 2 to 10 crossings, in 3D 2 to 3."""
    dim = {"line": 1, "guide": 2, "plane": 2, "space": 3}[where]
    reach, exponent = int(random.integers(1, 5 if dim < 3 else 4)), int(random.integers(0, 2))
    model = fh.Wave(fh.Kernel(float(reach), exponent, "constant") if reach > 1 else fh.Stencil.finite_element(dim))
    width = random.uniform(1.8, 2.6) if dim < 3 else 1.8
    half = np.full(dim, np.ceil(3.9 * width + reach)) + (0 if dim == 3 else int(random.integers(0, 6)))
    if where == "guide":
        half[0] = 7
    lattice = fh.Lattice(1.0, -half, half)
    u = np.exp(-sum(x**2 for x in lattice.coordinates()) / width**2)
    return lattice, model, u, float(random.uniform(2, 10 if dim < 3 else 3) * 2 * half.max())


class InfiniteGuide:
    """Infinite lattice of a guide that is periodic across, made of copies side by side."""

    def __init__(self, sim, u, steps):
        self.period, copies = u.shape[0], 2 * int(np.ceil(1.2 * steps * sim.dt / u.shape[0])) + 3
        self.middle = copies // 2
        self.infinite = InfiniteLattice(
            sim.stencil, 1.0, sim.model.integrator, sim.dt, steps, np.tile(u, (copies, 1)), damping=0.0
        )

    def after(self, step):
        return self.infinite.after(step)[self.middle * self.period : (self.middle + 1) * self.period]


@pytest.mark.parametrize(
    ("where", "case"),
    [
        *(("line", n) for n in range(4)),
        *(("guide", n) for n in range(2)),
        ("space", 0),
        *(pytest.param("line", n, marks=pytest.mark.slow) for n in range(4, 16)),
        *(pytest.param("guide", n, marks=pytest.mark.slow) for n in range(2, 6)),
        *(pytest.param("plane", n, marks=pytest.mark.slow) for n in range(6)),
        *(pytest.param("space", n, marks=pytest.mark.slow) for n in range(1, 4)),
    ],
)
def test_data_of_waves_that_run_backward_keep_their_target(where, case):
    """All but one, which is refused for what the layers are predicted to reflect, and keeps the least target that is
    named instead; before a prediction followed such waves, all of these were refused.
    """
    random = np.random.default_rng([SEED, 6, len(where), case])
    lattice, model, u, until = backward_setup(random, where)
    wanted = 10.0 ** -random.integers(3, 6)
    setup = {"lattice": lattice, "model": model, "initial": {"u": u}, "threads": 1}
    sim, target = with_layers(setup, wanted, until, 10 * wanted, **({"x": fh.Periodic()} if where == "guide" else {}))
    assert target == wanted or (where, case) == ("line", 6)
    sim.examine(until)
    steps, worst = int(until / sim.dt), 0.0
    infinite = (
        InfiniteGuide(sim, u, steps)
        if where == "guide"
        else InfiniteLattice(sim.stencil, 1.0, model.integrator, sim.dt, steps, u)
    )
    for step in np.linspace(1, steps, 40 if lattice.dim < 3 else 16).astype(int):
        sim.step(int(step) - sim.step_count)
        worst = max(worst, float(np.abs(sim.fields["u"] - infinite.after(int(step))).max()))
    assert worst <= target
    assert not sim.notes


@pytest.mark.slow
@pytest.mark.parametrize("case", range(3))
def test_forward_waves_that_leave_as_backward_ones_keep_their_target(case):
    """A pulse with next to no backward waves, but with waves of nearly their frequency, which leave a layer as
    backward ones. When these were not followed, they left 6 times the target. If it is refused, as in cases 1 and 2,
    the least target that is named instead is kept.
    """
    random = np.random.default_rng([SEED, 10, case])
    lattice, model = fh.Lattice(1.0, (-22.0, -22.0), (22.0, 22.0)), fh.Wave(fh.Kernel(3.0, 0, "constant"))
    u = pulse(lattice, random.uniform(-4, 4, 2), random.uniform(4.7, 5.2))
    dt, until = 0.95 * fh.Simulation(lattice, model, fh.Fixed()).step_limit, 400.0
    setup = {"lattice": lattice, "model": model, "initial": {"u": u}, "dt": dt, "threads": 1}
    sim, target = with_layers(setup, 1e-6, until, 1e-5)
    assert case > 0 or target == 1e-6
    assert worst_error(sim, u, until) <= target


@pytest.mark.parametrize("elastic", [False, True])
def test_data_in_space_that_are_odd_about_their_middle_keep_their_target(elastic):
    """Averaged around the point of a side that faces them they vanish, but elsewhere they do not."""
    lattice = fh.Lattice(1.0, (-9.0,) * 3, (9.0,) * 3)
    bell = np.exp(-sum(x**2 for x in lattice.coordinates()) / 5.0)
    odd = np.stack([x * bell for x in lattice.coordinates()])
    model = fh.Elastic(fh.Kernel(2.0, 1), young=1.0) if elastic else fh.Wave(fh.Kernel(2.0))
    start, until, target = {"u": odd if elastic else odd[0]}, 15.0, 1e-3
    with warnings.catch_warnings(action="error"):
        sim = fh.Simulation(lattice, model, fh.LatticePML(target=target, until=until), start, threads=1)
    exact = fh.Simulation(lattice, model, fh.Extended(target=1e-6, until=until), start, threads=1)
    worst = 0.0
    while sim.time < until:
        sim.step(3)
        exact.step(3)
        worst = max(worst, float(np.abs(sim.fields["u"] - exact.fields["u"]).max()))
    assert worst <= target * np.abs(start["u"]).max()


@pytest.mark.slow
@pytest.mark.parametrize("case", range(4))
def test_waves_that_run_backward_in_space_are_followed_each(case):
    """By all modes of the chain in front of a side, as in 2D. When one mode stood for all, 13 nodes made 6 times the
    target instead of 0.3 (case 0 is of that kind).
    """
    random = np.random.default_rng([SEED, 9, case])
    model, width = fh.Wave(fh.Kernel(3.0 if case == 0 else float(random.integers(2, 4)), 0)), random.uniform(1.9, 2.4)
    half = np.full(3, np.ceil(3.9 * width + 3))
    lattice, target, until = fh.Lattice(1.0, -half, half), 1e-4, float(random.uniform(2.5, 3.5) * 2 * half[0])
    u = pulse(lattice, random.uniform(-1, 1, 3), width)
    dt = (0.95 if case == 0 else random.uniform(0.3, 0.95)) * fh.Simulation(lattice, model, fh.Fixed()).step_limit
    setup = {"lattice": lattice, "model": model, "initial": {"u": u}, "dt": dt, "threads": 1}
    sim = fh.Simulation(**setup, boundary=fh.LatticePML(target=target, until=until))
    print([one.layer.columns for one in sim.thickness.values()])
    assert worst_error(sim, u, until, 16) <= target


@pytest.mark.parametrize("case", [*range(3), *(pytest.param(n, marks=pytest.mark.slow) for n in range(3, 12))])
def test_waves_that_hardly_move_keep_their_target_in_long_runs(case):
    """With wide kernels of exponent 0, short waves return late. When a sample stood for all of them, they made 1.35
    times the target.
    """
    random = np.random.default_rng([SEED, 7, case])
    model = fh.Wave(fh.Kernel(float(random.integers(3, 7)), 0, "linear"))
    width = random.uniform(4.0, 5.5)
    half = float(np.ceil(3.9 * width + 8 + random.integers(0, 8)))
    lattice = fh.Lattice(1.0, (-half,), (half,))
    u, until = pulse(lattice, random.uniform(-3, 3, 1), width), float(random.uniform(15, 35) * 2 * half)
    target = 10.0 ** -random.integers(4, 7)
    dt = random.choice([0.5, 0.95]) * fh.Simulation(lattice, model, fh.Fixed(), threads=1).step_limit
    setup = {"lattice": lattice, "model": model, "initial": {"u": u}, "dt": dt, "threads": 1}
    sim, target = with_layers(setup, target, until, 1e-3)
    assert worst_error(sim, u, until, 80) <= target


@pytest.mark.slow
@pytest.mark.parametrize("case", range(8))
def test_waves_that_turn_round_come_together_again_within_the_target(case):
    """In 2D, waves of nearly the largest frequency hardly move: they arrive as forward waves and leave as backward
    ones, back to where they began, long after others have left. When they were followed for 512 nodes only, as far as
    the side and as waves of many phases, they made 10 times the target.
    """
    random = np.random.default_rng([SEED, 8, case])
    kernel = [fh.Kernel(3.0, 1, "constant"), fh.Kernel(float(random.integers(4, 7)), 0, "linear")][case % 2]
    width = random.uniform(2.0, 3.0) if case % 2 == 0 else random.uniform(3.5, 5.0)
    half = np.ceil(3.9 * width + 6) + np.array([0, random.integers(0, 12)])
    lattice, model = fh.Lattice(1.0, -half, half), fh.Wave(kernel)
    u, until = pulse(lattice, random.uniform(-2, 2, 2), width), float(random.uniform(300, 1000))
    target = 10.0 ** -random.integers(3, 5)
    dt = random.choice([0.3, 0.5, 0.9]) * fh.Simulation(lattice, model, fh.Fixed(), threads=1).step_limit
    setup = {"lattice": lattice, "model": model, "initial": {"u": u}, "dt": dt, "threads": 1}
    sim, target = with_layers(setup, target, until)
    print("target", target, "nodes", [one.layer.columns for one in sim.thickness.values()])
    assert worst_error(sim, u, until, 80) <= target


@pytest.mark.slow
@pytest.mark.parametrize("case", range(6))
def test_elastic_waves_that_run_backward_keep_their_target(case):
    """P and S waves of short pulses in 2D, with all modes of both followed together. When one long wave stood for
    each, those that turn round made 5 times the target with bonds.
    """
    random = np.random.default_rng([SEED, 9, case])
    model = [
        fh.Elastic(fh.Kernel(3.0, 1, "constant", volume="full"), young=1.0),
        fh.Elastic(None, young=1.0, poisson=0.3, material="finite-element"),
        fh.Elastic(fh.Kernel(2.0, 1, "constant"), young=1.0, poisson=0.2, material="state-based"),
    ][case % 3]
    width = random.uniform(2.3, 3.2)
    half = np.ceil(3.9 * width + 3) + np.array([0, random.integers(0, 8)])
    lattice = fh.Lattice(1.0, -half, half)
    one = pulse(lattice, random.uniform(-2, 2, 2), width)
    u, until, target = np.stack([one, 0.5 * one]), float(random.uniform(60, 300)), 10.0 ** -random.integers(3, 5)
    dt = random.choice([0.5, 0.9]) * fh.Simulation(lattice, model, fh.Fixed(), threads=1).step_limit
    setup = {"lattice": lattice, "model": model, "initial": {"u": u}, "dt": dt, "threads": 1}
    sim, target = with_layers(setup, target, until)
    print("target", target, {side: (one.layer.columns, one.predicted) for side, one in sim.thickness.items()})
    assert not sim.notes
    error = worst_error(sim, u, until, 80)
    print("error", error)
    assert error <= target


def test_what_no_prediction_follows_of_waves_that_run_backward():
    """In a medium that varies, a target is refused; layers without a target give a note in every medium."""
    lattice = fh.Lattice(1.0, (-18.0, -18.0), (18.0, 18.0))
    u, model = pulse(lattice, (0.0, 0.0), 2.0), fh.Wave(fh.Kernel(3.0, 0, "constant"), 1.0)
    setup = {"lattice": lattice, "model": model, "initial": {"u": u}, "threads": 1}
    with pytest.raises(fh.InputError, match="run backward") as caught:
        fh.Simulation(**setup, boundary=fh.LatticePML(target=1e-4, until=60.0), coefficient="where(y < 0, 1, 2)")
    assert caught.value.key == "boundary.target" and float(caught.value.limit.removeprefix(">= ")) > 1e-4
    assert "nodes instead of the target" in caught.value.remedy
    sim = fh.Simulation(**setup, boundary=fh.LatticePML(until=60.0))
    assert any("run backward" in note for note in sim.notes)


@pytest.mark.parametrize("walls", ["periodic", "fixed", "free"])
def test_waveguides_keep_their_target(walls):
    """A guide 21 nodes wide for 20 of its lengths, where modes near cut-off return late; against a guide more than
    twenty times as long.
    """
    boundary = {"periodic": fh.Periodic(), "fixed": fh.Fixed(), "free": fh.Free()}[walls]
    model, until, more = fh.Wave(fh.Kernel(2.0), 1.0), 800.0, 430
    lattice = fh.Lattice(1.0, (-20.0, -10.0), (20.0, 10.0))
    u = pulse(lattice, (1.0, -1.0), 2.2)
    long = fh.Lattice(1.0, (-20.0 - more, -10.0), (20.0 + more, 10.0))
    far = fh.Simulation(
        long, model, {"x": fh.Fixed(), "y": boundary}, {"u": np.pad(u, ((more, more), (0, 0)))}, threads=1
    )
    for target in (1e-3, 1e-5):
        near = fh.Simulation(
            lattice, model, {"x": fh.LatticePML(target=target, until=until), "y": boundary}, {"u": u}, threads=1
        )
        far = far.remade(initial={"u": np.pad(u, ((more, more), (0, 0)))}) if far.step_count else far
        worst = 0.0
        for _ in range(40):
            near.run(near.time + until / 40)
            far.run(far.time + until / 40)
            assert near.step_count == far.step_count
            worst = max(worst, float(np.abs(near.fields["u"] - far.fields["u"][more:-more]).max()))
        assert worst <= target * u.max()


def test_layers_follow_the_target_and_the_length_of_the_run():
    lattice = fh.Lattice(0.5, (-8.0, -8.0), (8.0, 8.0))
    u = pulse(lattice, (0.0, 0.0), 1.2)

    def nodes(model=None, **options):
        sim = fh.Simulation(lattice, model or fh.Wave(fh.Kernel(1.0)), fh.LatticePML(**options), {"u": u}, threads=1)
        assert set(sim.thickness) == {"x-", "x+", "y-", "y+"}
        return sim.thickness["x-"].layer.columns

    assert nodes(target=1e-3, until=80.0) < nodes(target=1e-5, until=80.0) < nodes(target=1e-7, until=80.0)
    slow = fh.Diffusion(fh.Kernel(1.0))
    assert nodes(slow, target=1e-5, until=80.0) < nodes(slow, target=1e-5, until=8000.0)


@pytest.mark.parametrize("scale", [1e-9, 1e-6, 1e6])
def test_units_change_no_layer(scale):
    def layers(length, time):
        lattice = fh.Lattice(0.5 * length, (-8.0 * length, -8.0 * length), (8.0 * length, 8.0 * length))
        u = pulse(lattice, (2.0 * length, 0.0), 1.2 * length)
        boundary = fh.LatticePML(target=1e-5, until=60.0 * time)
        sim = fh.Simulation(
            lattice, fh.Wave(fh.Kernel(1.0 * length), speed=length / time), boundary, {"u": u}, threads=1
        )
        return {
            name: (found.name, found.layer.columns, found.layer.sigma * time) for name, found in sim.thickness.items()
        }

    known = layers(1.0, 1.0)
    for found in (layers(scale, 1.0), layers(1.0, scale)):
        for name, (profile, nodes, sigma) in known.items():
            assert found[name][:2] == (profile, nodes)
            np.testing.assert_allclose(found[name][2], sigma, rtol=1e-6)


def test_sources_and_data_that_are_not_known():
    """A source that splits into space and time is predicted; pulses stand for one that does not, conservatively."""
    lattice, model = fh.Lattice(1.0, (-20.0, -20.0), (20.0, 20.0)), fh.Wave(fh.Kernel(2.0))
    shape = pulse(lattice, (0.0, 0.0), 3.0)

    def columns(source):
        sim = fh.Simulation(lattice, model, fh.LatticePML(target=1e-5, until=100.0), sources=[source], threads=1)
        return sim.thickness["x+"].layer.columns

    known = columns(fh.Source(shape, lambda t: np.exp(-((t - 10) ** 2) / 9)))
    unknown = columns(lambda x, y, t: np.exp(-(x**2 + y**2) / 9) * np.exp(-((t - 10) ** 2) / 9))
    assert 3 <= known <= unknown <= 16


def test_checkpoints_and_remade_runs_keep_the_layers(tmp_path):
    lattice = fh.Lattice(1.0, (-16.0, -16.0), (16.0, 16.0))
    sim = fh.Simulation(
        lattice, fh.Wave(fh.Kernel(2.0)), fh.LatticePML(target=1e-4), {"u": pulse(lattice, (0, 0), 2.5)}, threads=1
    )
    sim.step(30)
    sim.save(tmp_path / "kept.ckpt")
    again = fh.Simulation.restore(tmp_path / "kept.ckpt")
    assert {k: v.columns for k, v in again.engine.layers.items()} == {
        k: v.columns for k, v in sim.engine.layers.items()
    }
    sim.step(30)
    again.step(30)
    np.testing.assert_array_equal(sim.fields["u"], again.fields["u"])
    empty = sim.remade(initial={})
    assert {k: v.columns for k, v in empty.engine.layers.items()} == {
        k: v.columns for k, v in sim.engine.layers.items()
    }


@pytest.mark.parametrize("model", [fh.Wave(fh.Kernel(2.0)), fh.Diffusion(fh.Kernel(2.0))], ids=["wave", "diffusion"])
def test_a_run_that_outlasts_its_layers_says_what_comes_back(model):
    """No warning while they are predicted to keep their target; then one with the reflection, as the run shows it.
    The prediction looks ahead and is repeated only if it changes; the error is measured at three times.
    """
    lattice, end, wanted = fh.Lattice(1.0, (-16.0,), (16.0,)), 30.0, 1e-4
    initial, late = {"u": pulse(lattice, (0,), 2.5)}, 10 * end if model.order == 2 else 40 * end
    far = fh.Extended(1e-10, until=late) if model.order == 2 else fh.LatticePML(1e-9, until=late)
    exact = fh.Simulation(lattice, model, far, initial, threads=1)
    sim = fh.Simulation(lattice, model, fh.LatticePML(target=wanted, until=end), initial, dt=exact.dt, threads=1)
    sim.run(until=end)
    assert not sim.notes
    worst, said = 0.0, []
    for until in (1.4 * end, late, late):
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            sim.run(until=until)
        said.append([str(one.message) for one in told])
        exact.step(sim.step_count - exact.step_count)
        largest = np.abs(exact.fields["u"]).max() if model.order == 1 else 1.0
        worst = max(worst, float(np.abs(sim.fields["u"] - exact.fields["u"]).max() / largest))
        assert sim.notes or worst <= wanted
    assert [len(texts) for texts in said] == [0, 1, 0]
    assert sim.notes == said[1]
    assert "up to t = 30;" in sim.notes[0]
    predicted = sum(one.error for one in sim.parts.around.foretold.values())
    assert f"to reflect {predicted:.1g} of the largest value" in sim.notes[0]
    assert wanted < worst <= 1.05 * predicted <= 5 * worst


def test_what_is_predicted_of_a_run_that_goes_on_asks_nothing_of_its_signals():
    """Signals need not be defined beyond the end of the run."""

    def signal(t):
        if t > 42.0:
            raise ValueError("nothing is known so late")
        return np.exp(-((t - 8) ** 2) / 4)

    lattice = fh.Lattice(1.0, (-16.0,), (16.0,))
    source = fh.Source(pulse(lattice, (0,), 2.0), time=signal)
    sim = fh.Simulation(
        lattice, fh.Wave(fh.Kernel(2.0)), fh.LatticePML(target=1e-4, until=30.0), sources=[source], threads=1
    )
    sim.run(until=30.0)
    sim.run(until=39.0)
    assert {one.until for one in sim.parts.around.foretold.values()} == {39.0}
    with warnings.catch_warnings(action="error"):
        sim.run(until=41.0)  # no warning


def test_a_run_in_many_pieces_is_warned_of_a_few_times():
    """A warning is repeated once the run is half as long again as at the last one."""
    lattice = fh.Lattice(1.0, (-16.0,), (16.0,))
    layer = fh.LatticePML(target=1e-4, until=30.0)
    sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), layer, {"u": pulse(lattice, (0,), 2.5)}, threads=1)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        for until in np.linspace(30.0, 300.0, 90):
            sim.run(until=float(until))
    assert 1 <= len(told) <= np.log(10.0) / np.log(1.5) + 1


def test_what_comes_back_counts_by_the_larger_target_of_an_axis():
    """A side with a small target is not blamed for what the other one, with a larger target, reflects."""
    lattice = fh.Lattice(1.0, (-16.0,), (16.0,))
    sides = {"x-": fh.LatticePML(target=1e-2, until=200.0), "x+": fh.LatticePML(target=1e-7, until=200.0)}
    sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), sides, {"u": pulse(lattice, (0,), 2.5)}, threads=1)
    sim.run(until=200.0)
    with warnings.catch_warnings(action="error"):
        sim.run(until=205.0)
    foretold = sim.parts.around.foretold
    assert 1e-7 < foretold["x-"].error < 1e-2
    assert foretold["x+"].error < 1e-7


def test_a_run_beside_a_wall_goes_on():
    """The wall has no target."""
    lattice = fh.Lattice(1.0, (-16.0,), (16.0,))
    sides = {"x-": fh.Free(), "x+": fh.LatticePML(target=1e-4, until=30.0)}
    sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), sides, {"u": pulse(lattice, (0,), 2.5)}, threads=1)
    sim.run(until=30.0)
    sim.run(until=31.0)
    assert list(sim.parts.around.foretold) == ["x+"]


@pytest.mark.slow
def test_solids_are_predicted_as_far_as_they_can_be():
    lattice = fh.Lattice(1.0, (-6.0, -6.0), (6.0, 6.0))
    bell = pulse(lattice, (0, 0), 1.5)
    model = fh.Elastic(fh.Kernel(2.0), 1.0)
    crossing = fh.Simulation(lattice, model, fh.LatticePML(nodes=4)).crossing
    layer = fh.LatticePML(target=1e-3, until=45 * crossing)
    sim = fh.Simulation(lattice, model, layer, {"u": [bell, 0.0]}, threads=1)
    sim.run(until=45 * crossing)
    with warnings.catch_warnings(action="error"):
        sim.run(until=50 * crossing)
    assert all(50 * crossing <= one.until <= 60 * crossing for one in sim.parts.around.foretold.values())


def test_a_refusal_is_of_what_was_asked():
    """A side without a target was not asked for any: what it could keep of the default is not stated. Sides that see
    weaker waves keep what the others keep.
    """
    lattice = fh.Lattice(1.0, (-15.0,), (15.0,))
    medium, u = fh.Wave(fh.Kernel(3.0, 0)).stencil(1.0, 1).with_reaction(0.01), {"u": pulse(lattice, (5,), 1.5)}
    sides = {"x-": fh.LatticePML(target=1e-9, until=400.0), "x+": fh.LatticePML(until=400.0)}
    with pytest.raises(fh.InputError, match="no layer meets the target") as refused:
        fh.Simulation(lattice, fh.Wave(medium), sides, u)
    assert "1e-09" in str(refused.value)
    least = float(str(refused.value.limit).removeprefix(">= "))
    both = dict.fromkeys(sides, fh.LatticePML(target=1e-9, until=400.0))
    with pytest.raises(fh.InputError, match="no layer meets the target") as of_both:
        fh.Simulation(lattice, fh.Wave(medium), both, u)
    most = float(str(of_both.value.limit).removeprefix(">= "))
    assert most >= least
    fh.Simulation(lattice, fh.Wave(medium), dict.fromkeys(sides, fh.LatticePML(target=1.01 * most, until=400.0)), u)


def test_a_run_longer_than_can_be_foreseen_says_so():
    lattice = fh.Lattice(1.0, (-6.0, -6.0), (6.0, 6.0))
    sim = fh.Simulation(
        lattice,
        fh.Elastic(fh.Kernel(2.0), 1.0),
        fh.LatticePML(target=1e-3, until=30.0),
        {"u": [pulse(lattice, (0, 0), 1.5), 0.0]},
        threads=1,
    )
    sim.run(until=30.0)
    with pytest.warns(fh.ValidityWarning, match="up to t = 30, but perhaps not later: LatticePML"):
        sim.run(until=61 * sim.crossing)
    with warnings.catch_warnings(action="error"):
        sim.run(until=62 * sim.crossing)


def test_a_target_that_no_layer_keeps_is_refused():
    lattice = fh.Lattice(1.0, (-20.0,), (20.0,))
    noise = np.zeros(41)
    noise[20] = 1.0  # all waves that the lattice carries, including those that hardly move
    with pytest.raises(fh.InputError, match=r"no layer meets the target.*Extended") as refused:
        fh.Simulation(lattice, fh.Wave(fh.Kernel(3.0)), fh.LatticePML(target=1e-9, until=20000.0), {"u": noise})
    most = float(str(refused.value.limit).removeprefix(">= "))  # the least possible target
    assert 1e-9 < most < 0.1
    fh.Simulation(lattice, fh.Wave(fh.Kernel(3.0)), fh.LatticePML(target=2 * most, until=20000.0), {"u": noise})
    with pytest.raises(fh.InputError, match=r"until"):
        fh.LatticePML(until=-1.0)


@pytest.mark.parametrize("sides", [fh.LatticePML(target=1e-4), fh.LatticePML(), fh.LatticePML(nodes=8), fh.Sponge(12)])
@pytest.mark.parametrize("factor", [4.0, 0.01])
def test_a_coefficient_everywhere_is_another_speed(sides, factor):
    """Layers, predictions, certificates and fields are those of the medium that the coefficient makes; once, its
    layers were made for the speed of the model, and missed their targets a thousandfold.
    """
    lattice, speed = fh.Lattice(1.0, (-12.0, -12.0), (12.0, 12.0)), float(np.sqrt(factor))
    pulse = {"u": "exp(-(x**2 + y**2)/6)"}
    asked = {} if isinstance(sides, fh.Sponge) or sides.nodes else {"until": 60.0 / speed}
    made = [
        fh.Simulation(lattice, model, replace(sides, **asked), pulse, threads=1, **options)
        for model, options in (
            (fh.Wave(fh.Kernel(2.0), speed=speed), {}),
            (fh.Wave(fh.Kernel(2.0)), {"coefficient": factor}),
        )
    ]
    plain, given = made
    assert given.dt == pytest.approx(plain.dt) and given.thickness.keys() == plain.thickness.keys()
    for key, layer in plain.engine.layers.items():
        for name in ("kappa", "sigma", "alpha", "damping"):
            assert getattr(given.engine.layers[key], name) == pytest.approx(getattr(layer, name), rel=1e-9), (key, name)
    assert given.certificate(5.0).verdict == plain.certificate(5.0).verdict == "certified"
    for sim in made:
        sim.step(100)
    assert np.abs(given.fields["u"] - plain.fields["u"]).max() < 1e-12


def test_layers_go_by_the_fastest_waves_at_their_side():
    """Ground of two strata: the lower side has the stiff one, the upper side the soft one, the others both."""
    lattice = fh.Lattice(1.0, (-20.0, -20.0), (20.0, 20.0))
    ground = {"coefficient": "where(y < 0, 9, 1)", "initial": {"u": "exp(-(x**2 + (y - 2)**2)/6)"}}
    sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), fh.LatticePML(nodes=8), threads=1, **ground)
    assert sim.coefficients == {(0, -1): 9.0, (0, 1): 9.0, (1, -1): 9.0, (1, 1): 1.0}
    sigma = {key: layer.sigma for key, layer in sim.engine.layers.items()}
    assert sigma[2, -1] == pytest.approx(3 * sigma[2, 1]) and sigma[1, 1] == pytest.approx(3 * sigma[2, 1])
    for until in (None, 40.0):  # slow waves beside them count, too: for the short run two nodes once left 1.6e-3
        setup = {"lattice": lattice, "model": sim.model, "boundary": fh.LatticePML(target=1e-3, until=until), **ground}
        kept = compare(setup, 40.0, beside=False)
        assert max(kept.curves["lattice PML"]["error_rel_initial"]) < 1e-3


@pytest.mark.slow
def test_solids_keep_their_target_in_runs_that_go_beyond_the_room():
    """Short pulses in 2D, whose waves are followed for 512 nodes, slow ones longer; what comes later is estimated
    from the second half of that time. Once a note warned of them instead, and up to 12 times the target came back.
    """
    seed = int(os.environ.get("FARHORIZON_SEED", np.random.SeedSequence().entropy % 2**32))
    print(f"seed {seed}")
    random = np.random.default_rng([seed, 8])
    for _ in range(3):
        kernel = fh.Kernel(float(random.integers(2, 4)), 1, str(random.choice(["constant", "linear"])))
        model, shape, width = fh.Elastic(kernel, 1.0), random.integers(26, 36, 2), random.uniform(2.2, 3.2)
        lattice, target = fh.Lattice(1.0, (0.0, 0.0), shape - 1.0), float(random.choice([1e-4, 1e-5]))
        bell = pulse(lattice, shape / 2, width)
        u, until = np.stack([random.uniform(-1, 1) * bell, bell]), float(random.uniform(560, 900) / model.p_speed)
        setup = {"lattice": lattice, "model": model, "threads": 1, "initial": {"u": u}}
        near, target = with_layers(setup, target, until, 0.01)
        assert worst_error(near, u, until) < target, (kernel, shape, width, until)


@pytest.mark.parametrize("vectors", [False, True])
def test_the_same_is_told_beside_walls_of_any_axis_and_end(vectors):
    kernel = fh.Kernel(3.0, 1)
    model, layer = fh.Elastic(kernel, 1.0) if vectors else fh.Wave(kernel), fh.LatticePML(nodes=20, target=1e-12)
    bell = pulse(fh.Lattice(1.0, (0.0, 0.0), (39.0, 29.0)), (17.0, 9.0), 2.5)
    below = np.stack([bell, 0.5 * bell]) if vectors else bell
    across = np.swapaxes(below, -1, -2)[::-1] if vectors else bell.T
    turned = across[..., ::-1, :] * (np.array([-1, 1])[:, None, None] if vectors else 1)
    told = []
    for u, axis, end in ((below, "y", "-"), (across, "x", "-"), (turned, "x", "+")):
        sides = {"x": layer, "y": layer}
        sides |= {side: sides[axis] for side in (axis + "-", axis + "+")} | {axis + end: fh.Free()}
        del sides[axis]
        lattice = fh.Lattice(1.0, (0.0, 0.0), np.array(u.shape[-2:]) - 1.0)
        sim = fh.Simulation(lattice, model, sides, {"u": u}, threads=1)
        told.append(sorted(note.split("reflect ")[1] for note in sim.notes if "predicted to reflect" in note))
    assert told[0] == told[1] == told[2] and len(told[0]) == 2


@pytest.mark.slow
@pytest.mark.parametrize(("vectors", "short"), [(False, False), (True, False), (False, True), (True, True)])
def test_what_comes_back_beside_walls_is_no_more_than_is_told(vectors, short):
    """Random bonds whose short waves run backward, nodes, walls and sources, against a domain from which nothing
    returns. What a wall outside turns into such waves is damped, and the prediction includes an estimate of it. For
    short initial pulses, in one of seventy trials the reflection was larger than reported, 1.2 times.
    """
    seed = int(os.environ.get("FARHORIZON_SEED", np.random.SeedSequence().entropy % 2**32))
    print(f"seed {seed}")
    random = np.random.default_rng([seed, 2 * short + vectors])
    most = 1.4 if short else 1.1  # told by one digit
    for _ in range(6):
        kernel = fh.Kernel(
            float(random.integers(2, 6)), int(random.integers(2)), volume=str(random.choice(["ramp", "full"]))
        )
        model = fh.Elastic(kernel, 1.0) if vectors else fh.Wave(kernel)
        shape = random.integers(30, 60, 2)
        lattice = fh.Lattice(1.0, (0.0, 0.0), shape - 1.0)
        bell = pulse(lattice, random.uniform(0.2, 0.7, 2) * shape, random.uniform(*(1.5, 4.0) if short else (3.0, 6.0)))
        sent = fh.Source(np.stack([bell, 0.5 * bell]) if vectors else bell, time=fh.Ricker(0.04))
        start = np.stack([bell, 0.5 * bell]) if vectors else bell
        given = {"initial": {"u": start}} if short else {"sources": [sent]}
        speed = model.p_speed if vectors else model.speed
        crossings = random.uniform(*(3, 14) if short else (2, 4))
        nodes, until = int(random.integers(14, 45)), float(crossings * shape.max() / speed)
        wall = random.choice([fh.Free(), fh.Fixed()])
        wide, layer = fh.Extended(target=1e-10, until=until), fh.LatticePML(nodes=nodes, target=1e-12, until=until)
        far, near = (
            fh.Simulation(lattice, model, {"x": side, "y-": wall, "y+": side}, threads=1, **given)
            for side in (wide, layer)
        )
        assert near.dt == far.dt
        told = max(float(note.split("reflect ")[1].split()[0]) for note in near.notes if "predicted to reflect" in note)
        worst, largest = 0.0, float(bell.max()) if short else 0.0
        while far.time < until:
            far.step(2)
            near.step(2)
            exact = np.array(far.fields["u"])
            worst, largest = max(worst, np.abs(near.fields["u"] - exact).max()), max(largest, np.abs(exact).max())
        print(f"{kernel}, {nodes} nodes: {worst / largest:.3g}, told {told:g}")
        assert worst < most * told * largest, (kernel, nodes, wall, worst / largest, told)

"""Power through surfaces: equal to the loss of energy inside, to rounding, and to what a plane wave carries."""

from contextlib import nullcontext

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.inputs.cracks import as_cut, cut_bonds


def pulse(*at):
    return np.exp(-sum(x**2 for x in at) / 4)


def scalar(dim, observe, **more):
    n = (14.0, 11.0, 9.0)[:dim]
    lattice = fh.Lattice(1.0, [-x for x in n], n)
    return fh.Simulation(
        lattice, fh.Wave(fh.Kernel(2.0)), fh.LatticePML(nodes=5), {"u": pulse}, observe=observe, **more
    )


def elastic(observe, material="bond-based", **more):
    lattice = fh.Lattice(1.0, [-14.0, -12.0], [14.0, 12.0])
    model = fh.Elastic(
        fh.Kernel(2.0, exponent=1), 2.0, None if material == "bond-based" else 0.3, material=material, density=0.7
    )
    start = {"u": [lambda x, y: 0.1 * pulse(x, y), 0.0], "v": [0.0, lambda x, y: 0.02 * x * pulse(x, y)]}
    return fh.Simulation(lattice, model, fh.LatticePML(nodes=5), start, observe=observe, **more)


def energy_inside(run, inside):
    """Kinetic and strain energy of nodes half a step ago, by definition; bonds across the edge count half."""
    stencil, near, engine = run.stencil, run.parts.near, run.engine
    components, dim = stencil.components, run.lattice.dim
    u = run.fields["u"].reshape(components, *run.lattice.shape)
    old = u - run.dt * run.fields["v"].reshape(u.shape)
    mass = run.lattice.spacing**dim / near.model.source_factor
    total = 0.5 * ((u - old) ** 2 / run.dt**2)[:, inside].sum()
    index = np.argwhere(inside)
    weights = engine.weights.reshape(len(engine.weights), components, components)
    factor = np.ones(run.lattice.shape) if near.factor is None else near.factor
    for offset, weight in zip(stencil.offsets, weights, strict=True):
        here, there = tuple(index.T), tuple(((index + offset) % run.lattice.shape).T)
        change, before = (
            u[(slice(None), *there)] - u[(slice(None), *here)],
            old[(slice(None), *there)] - old[(slice(None), *here)],
        )
        shared = np.minimum(factor[here], factor[there])
        total += 0.25 * np.einsum("an,ab,bn,n->", change, weight, before, shared)
    return mass * total


def strip(observe):
    """A strip that is periodic along y, with a pulse off its middle."""
    sides = {"x": fh.LatticePML(nodes=5), "y": fh.Periodic()}
    start = {"u": lambda x, y: pulse(x, y - 1)}
    lattice = fh.Lattice(1.0, (-9.0, -5.0), (9.0, 5.0))
    return fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), sides, start, observe=observe)


CASES = {
    "periodic": strip,
    "1D": lambda observe: scalar(1, observe),
    "2D": lambda observe: scalar(2, observe),
    "3D": lambda observe: scalar(3, observe),
    "2D, coefficient": lambda observe: scalar(
        2, observe, coefficient=lambda x, y: np.where(abs(x) + abs(y) < 5, 0.4, 1.0)
    ),
    "elastic": elastic,
    "state-based": lambda observe: elastic(observe, "state-based"),
    "correspondence": lambda observe: elastic(observe, "correspondence"),
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("make", CASES.values(), ids=CASES)
def test_what_leaves_is_lost_inside(make):
    """In each of 40 steps, through the edge of a box and through that of a part of it that is not a box. To rounding,
    since the power is summed in another order.
    """
    dim = make(()).lattice.dim
    box = fh.Box([-5.2, -5.0 if make is strip else -4.0, -3.0][:dim], [4.1, 3.0, 3.5][:dim])
    regions = [box] if dim == 1 else [box, box - (fh.Disc if dim == 2 else fh.Ball)(2.3, [3.0, 2.0, 3.0][:dim])]
    power = fh.PowerThrough(regions)
    run = make([power])
    inside = [one.contains(np.stack(run.lattice.coordinates(), -1)) for one in regions]
    energies = [[energy_inside(run, one) for one in inside]]
    for _ in range(40):
        run.step()
        energies.append([energy_inside(run, one) for one in inside])
    lost = -np.diff(energies, axis=0)
    assert lost.sum(0).max() > 0.05 * energies[0][0]  # something has left
    # rounding of some hundred terms
    np.testing.assert_allclose(run.dt * power.data["power"], lost, rtol=0, atol=1e-13 * energies[0][0])
    np.testing.assert_allclose(power.times, run.dt * np.arange(40))


BURST = {"wave": fh.Wave(fh.Kernel(2.0)), "elastic": fh.Elastic(fh.Kernel(2.0, exponent=1), 2.0, density=0.7)}


@pytest.mark.parametrize(
    ("kind", "dim", "until"),
    [
        ("wave", 2, 300.0),
        ("elastic", 2, 400.0),
        pytest.param("wave", 3, 220.0, marks=pytest.mark.slow),
        pytest.param("elastic", 3, 220.0, marks=pytest.mark.slow),
    ],
)
def test_what_leaves_at_a_frequency_is_what_the_source_does(kind, dim, until):
    """The work of a burst without slow parts, from its samples and the field where it acts, is the energy through two
    surfaces around it, when all has left to 1e-10; the region between them, without a source, emits none.
    """
    lattice = fh.Lattice(1.0, [-9.0, -8.0, -7.0][:dim], [9.0, 8.0, 7.0][:dim])
    at = lattice.coordinates()
    space = np.exp(-sum(x**2 for x in at) / 6) * (sum(x**2 for x in at) < 3.3**2)
    direction = np.array([0.8, -0.6, 0.5])[:dim]
    force = space if kind == "wave" else direction.reshape(-1, *[1] * dim) * space
    frequencies = np.array([0.1, 0.12, 0.13])

    def burst(t):
        return np.exp(-(((t - 72) / 12) ** 2)) * np.sin(0.24 * np.pi * t)

    box, ball = fh.Box([-5.2] * dim, [5.1] * dim), (fh.Disc if dim == 2 else fh.Ball)(4.3)
    power = fh.PowerThrough([box, ball, box - ball], frequencies)
    inside = fh.Spectra(fh.Box([-3.2] * dim, [3.2] * dim), frequencies)
    run = fh.Simulation(
        lattice, BURST[kind], fh.LatticePML(nodes=12), sources=[fh.Source(force, burst)], observe=[power, inside]
    )
    run.step(round(until / run.dt))
    times = run.dt * np.arange(run.step_count + 1)
    signal = run.dt * np.exp(-2j * np.pi * np.outer(frequencies, times)) @ burst(times)
    moved = inside.data["u"].reshape(3, -1, 1 if kind == "wave" else dim)
    nodes = tuple(np.round(inside.points - lattice.lower).astype(int).T)
    pushed = np.einsum("fnc,cn->f", moved, force.reshape(-1, *lattice.shape)[(slice(None), *nodes)])
    work = -2 * np.sin(2 * np.pi * frequencies * run.dt) / run.dt * (signal.conj() * pushed).imag
    through = power.energy()
    assert work.min() > 0
    np.testing.assert_allclose(through[:, :2], np.stack([work, work], -1), rtol=0, atol=1e-10 * work.max())
    np.testing.assert_allclose(through[:, 2], 0, atol=1e-10 * work.max())


def test_all_frequencies_carry_what_goes_through_in_time():
    """Parseval's theorem, over the frequencies of a discrete transform of a run that ends when all has left."""
    steps, every = 900, []
    for frequencies in ((), every):
        power = fh.PowerThrough([("x", 5.5), fh.Disc(6.2)], frequencies)
        start = {"v": lambda x, y: x * np.exp(-(x**2 + y**2) / 6)}
        run = scalar(2, [power]).remade(initial=start)
        highest = run.parts.near.highest_frequency
        every += [k / (steps * run.dt) for k in range(1, steps // 2) if k / (steps * run.dt) < highest]
    run.step(steps - 1)
    found, wanted = power.energy().sum(0) / (steps * run.dt), run.dt * power.data["power"].sum(0)
    np.testing.assert_allclose(found, wanted, rtol=1e-6)


def test_a_free_body_and_a_crack():
    """Absent bonds carry nothing: in a body with free faces, half of which lies behind a crack that ends in it."""
    body = fh.Box((-9.0, -8.0), (9.0, 8.0)) - fh.Disc(2.2, (4.0, -3.0))
    lattice = fh.Lattice(1.0, (-9.0, -8.0), (9.0, 8.0), body=body)
    half = fh.Box((-9.0, -8.0), (0.2, 8.0))
    power = fh.PowerThrough([half, ("x", 0.5)])
    cracks = [[(0.5, -9.0), (0.5, 1.0)]]
    start = {"u": lambda x, y: pulse(x + 3, y)}
    run = fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), fh.Free(), start, cracks=cracks, observe=[power])
    whole = run.energy()
    run.step(80)
    gone = run.dt * power.data["power"].sum(0)
    assert gone[0] == pytest.approx(gone[1], rel=1e-12) and abs(gone[0]) > 0.02 * whole
    # the body as a whole loses nothing, so that one half gains what the other one loses
    other = fh.PowerThrough(fh.Box((0.8, -8.0), (9.0, 8.0)))
    again = fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), fh.Free(), start, cracks=cracks, observe=[other])
    again.step(80)
    assert again.dt * other.data["power"].sum() == pytest.approx(-gone[0], rel=1e-10)
    assert run.energy() == pytest.approx(whole, rel=1e-12)


MATERIALS = {
    "state-based": {"poisson": 0.35, "material": "state-based"},
    "correspondence": {"poisson": 0.25, "material": "correspondence"},
    "stabilised": {"poisson": 0.1, "material": "correspondence", "stabilisation": 0.4},
}


def energy_of_states(run, crack, inside):
    """Energy of nodes half a step ago, by definition: that of each state; springs across the edge count half."""
    lattice, model, dim = run.lattice, run.model, run.lattice.dim
    states, h = model.force_states(lattice.spacing, dim), lattice.spacing
    nodes, bonds = cut_bonds(as_cut(crack, dim), lattice.lower, h, lattice.shape, states.offsets)
    gone = {(*n, b) for n, b in zip(nodes.tolist(), bonds.tolist(), strict=True)}
    mask = np.ones(lattice.shape, bool) if lattice.mask is None else lattice.mask
    u = np.nan_to_num(run.fields["u"])
    old = u - run.dt * np.nan_to_num(run.fields["v"])
    lame, shear = run.parts.near.lame / model.p_modulus
    density = 1.0 if run.parts.near.density is None else run.parts.near.density
    total = 0.5 * model.density * (density * ((u - old) ** 2).sum(0) / run.dt**2)[inside & mask].sum()
    unit, stabilisation = model.p_modulus / h**2, states.moduli[2] * (lame + 2 * shear)
    moduli = np.stack([lame - shear, 0 * shear, 0 * shear] if len(states.signs) == 1 else [lame, shear, stabilisation])
    stiff = shear * model.p_modulus / model.shear if len(states.signs) == 1 else lame + 2 * shear
    for i in np.argwhere(inside & mask):
        q, before, shape = 0.0, 0.0, np.zeros((dim, dim))
        for k, offset in enumerate(states.offsets):
            j = i + offset
            if (j < 0).any() or (j >= lattice.shape).any() or not mask[tuple(j)] or (*i, k) in gone:
                continue
            here, there = (slice(None), *i), (slice(None), *j)
            one, two = u[there] - u[here], old[there] - old[here]
            q, before, shape = q + states.gradient[k] @ one, before + states.gradient[k] @ two, shape + states.shapes[k]
            spring = (stiff[tuple(i)] + stiff[tuple(j)]) / 2 * states.bonds[k]
            total += 0.25 * unit * one @ spring @ two
        (law,) = states.law(shape[None], moduli[(slice(None), *i)][None])
        total += 0.5 * unit * q @ law @ before
    return h**dim * total


@pytest.mark.sampled(4)
@pytest.mark.parametrize("varied", [False, True], ids=["even", "varied"])
@pytest.mark.parametrize(("name", "dim"), [*((one, 2) for one in MATERIALS), pytest.param("stabilised", 3)])
def test_what_leaves_is_lost_inside_by_states_that_lack_bonds(name, dim, varied):
    """In a body with free faces and a hole, cut by a crack that the surface crosses; with uniform or varying moduli
    and density.
    """
    half = 7.0 if dim == 2 else 4.0
    hole = fh.Disc(1.6, (3.0, -3.0)) if dim == 2 else fh.Ball(1.1, (2.0, -2.0, 0.0))
    lattice = fh.Lattice(1.0, (-half,) * dim, (half,) * dim, body=fh.Box((-half,) * dim, (half,) * dim) - hole)
    crack = fh.Crack([(-0.4, -9.0), (0.6, 1.0)] if dim == 2 else fh.DiscCut((0.5, -3.0, 0.0), (1.0, 0.1, 0.0), 2.5))
    more = {"young": "1.5 + 0.5*sin(x + y)", "density": "1 + 0.3*cos(y)"} if varied else {"young": 1.5}
    model = fh.Elastic(fh.Kernel(2.0 if dim == 2 else 1.4), **more, **MATERIALS[name])
    start = {"u": [lambda *at: 0.1 * pulse(at[0] + 2, *at[1:]), *[0.0] * (dim - 1)]}
    regions = [fh.Box((-half - 1,) * dim, (0.2, *[half + 1] * (dim - 1))), (fh.Disc if dim == 2 else fh.Ball)(3.2)]
    power = fh.PowerThrough([*regions, ("x", 0.5)])
    run = fh.Simulation(lattice, model, fh.Free(), start, cracks=[crack], observe=[power])
    inside = [one.contains(np.stack(lattice.coordinates(), -1)) for one in regions]
    energies = [[energy_of_states(run, crack.cut, one) for one in inside]]
    for _ in range(12 if dim == 2 else 3):
        run.step()
        energies.append([energy_of_states(run, crack.cut, one) for one in inside])
    lost, found = -np.diff(energies, axis=0), run.dt * power.data["power"]
    size = max(abs(e) for e in energies[0])
    assert np.abs(lost).max() > 1e-3 * size
    np.testing.assert_allclose(found[:, :2], lost, rtol=0, atol=1e-13 * size)
    np.testing.assert_allclose(found[:, 2], found[:, 0], rtol=0, atol=1e-13 * size)  # the plane is the first one's face


def test_a_half_space_of_states_loses_what_goes_down():
    """Through the edge of a box at the free side, until all has left; the other sides are layers."""
    sides = {"all": fh.LatticePML(nodes=8), "y+": fh.Free()}
    lattice = fh.Lattice(1.0, (-16.0, -18.0), (16.0, 0.0))
    power = fh.PowerThrough([fh.Box((-10.0, -10.0), (10.0, 1.0)), ("y", -12.5)])
    model = fh.Elastic(fh.Kernel(2.0), 1.5, **MATERIALS["state-based"])
    start = {"v": [0.0, lambda x, y: pulse(x, y + 2)]}
    run = fh.Simulation(lattice, model, sides, start, observe=[power])
    whole = run.energy()
    run.run(until=150.0)
    gone = run.dt * power.data["power"].sum(0)
    assert gone[0] == pytest.approx(whole, rel=2e-4)  # slow waves of the lattice are still there
    assert -0.9 * whole < gone[1] < -0.1 * whole  # the rest travels along the surface and sideways


def test_regions_of_states_keep_off_the_layers():
    """By the reach of a node's bonds and of the bonds at their other ends."""
    for lower, refused in ((-11.0, True), (-10.0, False)):
        power = fh.PowerThrough(fh.Box((lower, -4.0), (4.0, 4.0)))
        with pytest.raises(fh.InputError, match="beyond the near field") if refused else nullcontext():
            elastic([power], "state-based", cracks=[[(0.5, -1.0), (0.5, 1.0)]])


GUIDED = {
    "scalar": (fh.Wave(fh.Kernel(3.0)), 3),
    "bond-based": (fh.Elastic(fh.Kernel(2.0, exponent=1), 1.0), 2),
    "state-based": (fh.Elastic(fh.Kernel(2.0, exponent=1), 1.0, **MATERIALS["state-based"]), 4),
    "correspondence": (fh.Elastic(fh.Kernel(2.0, exponent=1), 1.0, **MATERIALS["stabilised"]), 4),
}


def guide(model, length, planes, side):
    """Return the energy that has gone through planes across a strip with free faces."""
    start = {"v": pulse if isinstance(model, fh.Wave) else [pulse, 0.0]}
    power = fh.PowerThrough([("x", x) for x in planes])
    lattice, sides = fh.Lattice(1.0, (-length, -5.0), (length, 5.0)), {"x": side, "y": fh.Free()}
    run = fh.Simulation(lattice, model, sides, start, observe=[power])
    run.run(until=20.0)
    np.testing.assert_array_equal(power.points, [[x, 0.0] for x in planes])
    return run.dt * power.data["power"].sum(0)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("model", "nodes"), GUIDED.values(), ids=GUIDED)
def test_planes_keep_off_sides_that_go_on(model, nodes):
    """By the bonds through them, and those of the states at the ends of these; the nearest planes that are accepted
    carry what they carry where the side is far away.
    """
    near = 10.5 - nodes
    for side in (fh.LatticePML(nodes=30), fh.Sponge(20), fh.Extended(until=20.0), fh.Fixed()):
        for plane in (near + 1, -near - 1):
            with pytest.raises(fh.InputError, match=rf"lead beyond the near field.*limit: {nodes} nodes"):
                guide(model, 10.0, [plane], side)
    far = guide(model, 14.0, [-near, near], fh.Extended(until=20.0))
    assert far[1] > 0.1
    # extended sides send back less than their target of 1e-3
    np.testing.assert_allclose(guide(model, 10.0, [-near, near], fh.Extended(until=20.0)), far, rtol=1e-3)


@pytest.mark.parametrize(("model", "nodes"), GUIDED.values(), ids=GUIDED)
def test_planes_at_free_and_periodic_sides(model, nodes):
    """Beside a free side, the power through a plane is that out of the region before it; beside a periodic one, it is
    that through the same plane of a lattice that begins elsewhere.
    """
    start = {"v": pulse if isinstance(model, fh.Wave) else [pulse, 0.0]}
    lattice = fh.Lattice(1.0, (-10.0, -5.0), (10.0, 5.0))
    power = fh.PowerThrough([("x", 9.5), fh.Box((-11.0, -6.0), (9.5, 6.0)), ("x", -9.5)])
    fh.Simulation(lattice, model, fh.Free(), start, observe=[power]).step(60)
    size = np.abs(power.data["power"]).max()
    np.testing.assert_allclose(*power.data["power"].T[:2], rtol=0, atol=1e-12 * size)
    np.testing.assert_allclose(*power.data["power"].T[[0, 2]] * [[1.0], [-1.0]], rtol=0, atol=1e-12 * size)
    found = []
    for shift in (0.0, 7.0):
        lattice = fh.Lattice(1.0, (-10.0 + shift, -5.0), (10.0 + shift, 5.0))
        start = {"v": round_pulse if isinstance(model, fh.Wave) else [round_pulse, 0.0]}
        planes = [(-9.5, 8.5, 9.5), (11.5, 8.5, 9.5)][bool(shift)]
        power = fh.PowerThrough([("x", x) for x in planes])
        fh.Simulation(lattice, model, fh.Periodic(), start, observe=[power]).step(60)
        found.append(power.data["power"])
    np.testing.assert_allclose(*found, rtol=0, atol=1e-12 * np.abs(found[0]).max())


def round_pulse(x, y):
    """The pulse on a ring of 21 nodes, wherever the ring is cut open."""
    return pulse((x - 4.0 + 10.0) % 21.0 - 10.0, y)


def test_a_plane_wave_carries_its_energy():
    """Through planes across it, the mean power of a period per area is ``rho c omega^2 / 2`` in the limit of long
    waves; the error is of second order in the spacing.
    """
    errors, spacings, k, c = [], (1.0, 0.5, 0.25), 2 * np.pi / 16, 1.5
    start = {"u": lambda x, y: np.sin(k * x) + 0 * y, "v": lambda x, y: -k * c * np.cos(k * x) + 0 * y}
    for spacing in spacings:
        lattice = fh.Lattice(spacing, (0.0, 0.0), (16.0 - spacing, 6.0 - spacing))
        power, steps = fh.PowerThrough([("x", 5.6), ("x", 8.1)]), round(64 / spacing)  # per period
        model = fh.Wave(fh.Kernel(2 * spacing), speed=c)
        run = fh.Simulation(lattice, model, fh.Periodic(), start, dt=16 / c / steps, observe=[power])
        run.step(steps + 1)
        errors.append(abs(power.data["power"][1:].mean() / (6.0 * c * (c * k) ** 2 / 2) - 1))
    assert np.polyfit(np.log(spacings), np.log(errors), 1)[0] == pytest.approx(2, abs=0.3), errors


def test_saved_taken_up_and_forgotten(tmp_path):
    def made():
        return fh.PowerThrough([fh.Box((-4.0, -4.0), (4.0, 4.0)), ("y", 1.5)], [0.05, 0.1])

    whole, first, second = made(), made(), made()
    scalar(2, [whole]).step(30)
    run = scalar(2, [first])
    run.step(11)
    kept = first.recorded
    first.forget()
    run.save(tmp_path / "state")
    fh.Simulation.restore(tmp_path / "state", observe=[second]).step(19)
    np.testing.assert_allclose(
        np.concatenate([kept.data["power"], second.data["power"]]), whole.data["power"], rtol=1e-12, atol=1e-16
    )
    np.testing.assert_allclose(np.concatenate([kept.times, second.times]), whole.times)
    np.testing.assert_array_equal(second.energy(), whole.energy())
    np.testing.assert_array_equal(second.recorded.spectra["energy"], whole.energy())


def test_rows_of_a_resumed_run_are_the_same_bit_for_bit(tmp_path):
    """Also where a single step is left, which is summed on its own: power through a box, and intensities of a crack."""
    lattice, crack = fh.Lattice(1.0, (-14.0, -14.0), (14.0, 14.0)), [[(-4.0, 0.5), (4.0, 0.5)]]
    model, blow = fh.Elastic(fh.Kernel(2.0, 1), young=1.0), fh.PointForce((0.0, -9.0), (0.3, 1.0), fh.Ricker(0.1))

    def made():
        recorders = [fh.PowerThrough(fh.Box((-6.5, -6.5), (6.5, 6.5))), fh.StressIntensity()]
        return fh.Simulation(
            lattice, model, fh.LatticePML(nodes=6), sources=[blow], cracks=crack, observe=recorders
        ), recorders  # fmt: skip

    whole, wanted = made()
    whole.step(30)
    for steps in (11, 29):
        first, _ = made()
        first.step(steps)
        first.save(tmp_path / "state")
        second, found = made()
        second.load(tmp_path / "state")
        second.step(30 - steps)
        for one, other in zip(found, wanted, strict=True):
            for name, rows in other.data.items():
                np.testing.assert_array_equal(one.data[name], rows)


@pytest.mark.parametrize(
    ("make", "surfaces", "message"),
    [
        (CASES["2D"], fh.Box((-13.0, -4.0), (4.0, 4.0)), "beyond the near field"),
        (CASES["2D"], fh.Disc(0.2, (0.5, 0.5)), "no node"),
        (CASES["2D"], ("x", 99.0), "outside the near field"),
        (CASES["2D"], ("z", 0.0), "no such axis"),
        (CASES["2D"], [3.0], "edge of a region"),
        (CASES["2D"], [], "no surface"),
        (
            lambda observe: scalar(2, observe, cracks=[fh.Crack([(0.0, 0.0), (2.0, 0.0)], opens=1.0)]),
            ("x", 0.5),
            "open later",
        ),
        (
            lambda observe: fh.Simulation(fh.Lattice(1.0, -9, 9), fh.Diffusion(fh.Kernel(2.0)), observe=observe),
            ("x", 0.5),
            "diffuses",
        ),
    ],
)
def test_refused_surfaces(make, surfaces, message):
    with pytest.raises(fh.InputError, match=message):
        make([fh.PowerThrough(surfaces)])


@pytest.mark.parametrize(("given", "message"), [([-0.1], "from 0 on"), ([9.0], "Nyquist"), ([0.6], "lattice")])
def test_refused_frequencies(given, message):
    with pytest.raises(fh.InputError, match=message):
        scalar(2, [fh.PowerThrough(("x", 0.5), given)])


@pytest.mark.parametrize(
    "given", ['{ axis = "x" }', "{ name = 'a' }", '{ axis = "x", position = 99.0 }', '{ axis = "q", position = 0.0 }']
)
def test_cases_without_a_surface(given):
    """A plane needs an axis and a position, within the near field."""
    text = f"""
lattice = {{ spacing = 1.0, lower = [-9.0, -9.0], upper = [9.0, 9.0] }}
model = {{ type = "wave", kernel = {{ horizon = 2.0 }} }}
run = {{ until = 12.0 }}
power = [{given}]
"""
    with pytest.raises(fh.InputError):
        Case(text).run()


def test_no_run_has_no_power():
    power = fh.PowerThrough(fh.Disc(2.0), [0.1])
    assert power.data["power"].shape == (0, 1)
    with pytest.raises(fh.InputError, match=r"power: the energy of no run; .*observe=\[power\]"):
        _ = power.recorded

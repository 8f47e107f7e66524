"""Heat beside bonds of its solid that have broken: against whole pieces, a plain program, and two lumps in contact."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.simulation.heat.broken_bonds import chains

MATERIALS = {
    "bond-based": {},
    "state-based": {"material": "state-based", "poisson": 0.3},
    "correspondence": {"material": "correspondence", "poisson": 0.1, "stabilisation": 0.5},
    "bonds that soften": {"softening": "linear", "fracture_energy": 0.004},
}
ZERO, HOT = 300.0, 10.0
FAINT = 1e-12  # an expansion whose heat of deformation is below rounding


def torn(of_heat=2.0, coupled=False, side=None, expansion=FAINT, plate=None, **more):
    """A plate whose upper half flies off, heated above the plane of the cut, before heat arrives there."""
    plate = fh.Lattice(1.0, (-12.0, -12.0), (12.0, 12.0)) if plate is None else plate
    more.setdefault("critical_stretch", 0.05)
    solid = fh.Elastic(fh.Kernel(2.0, exponent=1), young=1.0, plane="stress", **more)
    heat = fh.Heat(fh.Kernel(of_heat), specific_heat=2.0, conductivity=0.3)
    model = fh.Thermoelastic(solid, heat, expansion, ZERO, coupled)
    y = plate.coordinates()[1]
    start = {"v": [0 * y, np.where(y > 0.5, 0.2, -0.2)], "T": ZERO + HOT * (y > 4)}
    return fh.Simulation(plate, model, fh.Free() if side is None else side, start)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("coupled", [False, True])
@pytest.mark.parametrize("of_heat", [1.0, 2.0, 3.5], ids=["shorter", "same", "longer"])
@pytest.mark.parametrize("material", MATERIALS)
def test_no_heat_crosses_a_gap(material, of_heat, coupled):
    sim = torn(of_heat, coupled, **MATERIALS[material])
    sim.run(until=20.0, progress=False)
    gap = sim.fields["u"][1][:, 13].min() - sim.fields["u"][1][:, 12].max()
    assert gap > 6 and sim.broken_bonds > 100
    heated = sim.fields["T"] - ZERO
    assert np.abs(heated[:, :13]).max() < 1e-10 and heated[:, 13].min() > 0.1  # but it has reached the other side
    assert heated.sum() == pytest.approx(HOT * 25 * 8, rel=1e-13)


def test_no_heat_crosses_a_seam():
    """A plate that periodic sides close to a ring tears where it is closed."""
    plate = fh.Lattice(1.0, (-12.0, -12.0), (12.0, 12.0))
    y = plate.coordinates()[1]
    solid = fh.Elastic(fh.Kernel(2.0, exponent=1), young=1.0, plane="stress", critical_stretch=0.05)
    largest = []
    for speed in (0.2, 0.0):
        model = fh.Thermoelastic(solid, fh.Heat(fh.Kernel(3.5), 1.0, 2.0, 0.3), FAINT, ZERO, coupled=False)
        start = {"v": [0 * y, -speed * np.sign(y)], "T": ZERO + HOT * (abs(y - 6) < 2)}
        sim = fh.Simulation(plate, model, fh.Periodic(), start)
        sim.run(until=8.0, progress=False)
        assert (sim.fields["T"] - ZERO).sum() == pytest.approx(HOT * 25 * 3, rel=1e-13)
        largest.append(np.abs(sim.fields["T"][:, 0] - ZERO).max())
    assert largest[0] < 1e-12 and largest[1] > 1e-3  # all around, heat has not yet come so far


@pytest.mark.parametrize("coupled", [False, True])
@pytest.mark.parametrize("material", ["bond-based", "state-based"])
def test_steps_are_those_of_a_plain_program(material, coupled):
    """Bonds that break here and there, in a plate thrown apart at random; which ones is read from the run."""
    random = np.random.default_rng(3)
    lattice = fh.Lattice(1.0, (0.0, 0.0), (10.0, 8.0))
    solid = fh.Elastic(
        fh.Kernel(2.0, exponent=1), young=1.0, critical_stretch=0.05, plane="stress", **MATERIALS[material]
    )
    heat = fh.Heat(fh.Kernel(2.0), specific_heat=2.0, conductivity=0.3)
    start = {"v": 0.05 * random.standard_normal((2, *lattice.shape)), "T": ZERO + random.standard_normal(lattice.shape)}
    sides, model = {"x": fh.Periodic(), "y": fh.Free()}, fh.Thermoelastic(solid, heat, FAINT, ZERO, coupled)
    beside = 0.5 * fh.Simulation(lattice, heat, sides).step_limit  # of heat that has steps of its own
    steps = 1 if coupled else 5
    sim = fh.Simulation(lattice, model, sides, start, dt=beside / 10 if coupled else beside / steps)
    weights, offsets = 0.3 / 2.0 * heat.stencil(1.0, 2).weights, heat.stencil(1.0, 2).offsets
    numbers = {tuple(offset): k for k, offset in enumerate(sim.engine.offsets[:, 1:].tolist())}
    theta, places = start["T"] - ZERO, sim.parts.grid.nodes.reshape(lattice.shape)
    for _ in range(25 if coupled else 15):
        bits = sim.engine.bonds.table.alive[:, places].copy()
        sim.step(steps)
        bits = sim.engine.bonds.table.alive[:, places].copy() if coupled else bits
        change = np.zeros_like(theta)
        for (i, j), weight in zip(offsets.tolist(), weights, strict=True):
            k = numbers[i, j]
            intact = bits[k >> 6] >> np.uint64(k & 63) & np.uint64(1) == 1
            for x, y in np.argwhere(intact):
                change[x, y] += weight * (theta[(x + i) % 11, y + j] - theta[x, y])
        theta = theta + steps * sim.dt * change
        np.testing.assert_allclose(sim.fields["T"] - ZERO, theta, atol=1e-11)
    assert sim.broken_bonds > 50 and sim.fields["damage"].min() < 0.2


def test_a_crack_that_opens_later_keeps_its_factor_next_to_broken_bonds():
    """An open crack of factor 0.5 conducts, while the bonds that break beside it do not."""
    plate = fh.Lattice(1.0, (-12.0, -12.0), (12.0, 12.0))
    y = plate.coordinates()[1]
    solid = fh.Elastic(fh.Kernel(2.0, exponent=1), young=1.0, plane="stress", critical_stretch=0.05)
    model = fh.Thermoelastic(solid, fh.Heat(fh.Kernel(2.0), 1.0, 2.0, 0.3), FAINT, ZERO, coupled=False)
    crack = fh.Crack([(-3.0, 0.5), (3.0, 0.5)], factor=0.5)
    start = {"v": [0 * y, np.where(y > 0.5, 0.2, -0.2)], "T": ZERO + HOT * (y > 4)}
    largest = []
    for factor in (0.5, 0.0):
        cracks = [fh.Crack(crack.cut, factor)]
        sim = fh.Simulation(plate, model, fh.Free(), start, cracks=cracks)
        sim.run(until=20.0, progress=False)
        largest.append(np.abs(sim.fields["T"] - ZERO)[:, :13].max())
    assert largest[0] > 1e-3 and largest[1] < 1e-10


def closed(conductance, back=-1e-3, height=6):
    """A strip torn in two halves, which are then pushed together: 10 degrees between them."""
    strip = fh.Lattice(1.0, (-4.0, 1.0 - height), (4.0, float(height)))
    solid = fh.Elastic(fh.Kernel(2.0, exponent=1), young=1.0, plane="stress", critical_stretch=0.05)
    heat = fh.Heat(fh.Kernel(2.0), 1.0, 0.5, 0.25)
    model = fh.Thermoelastic(solid, heat, FAINT, ZERO, False, conductance)
    y = strip.coordinates()[1]
    moved = f"where(t < 2, 0.3*t*(2 - t), {back})"
    held = [fh.Prescribed(y > 0.5, [0.0, moved]), fh.Prescribed(y < 0.5, [0.0, 0.0])]
    sides = {"x": fh.Periodic(), "y": fh.Free()}
    sim = fh.Simulation(strip, model, sides, {"T": ZERO + HOT * (y > 0.5)}, constraints=held)
    sim.run(until=60.0, progress=False)  # until the profiles are steady
    halves = [(sim.fields["T"][:, half] - ZERO).mean() for half in (slice(None, height), slice(height, None))]
    before, t = halves[1] - halves[0], sim.time
    sim.run(until=t + 60.0, progress=False)
    after = [(sim.fields["T"][:, half] - ZERO).mean() for half in (slice(None, height), slice(height, None))]
    return np.log(before / (after[1] - after[0])) / (sim.time - t)


def test_closed_faces_conduct_as_much_as_is_given():
    """Two lumps of heat capacity ``C`` per area, between which h passes: their difference decays at the rate 2 h / C,
    or hardly more slowly because they also conduct within themselves.
    """
    conductance, capacity, height = 2e-3, 0.5, 6
    resistance = 1 / conductance + 2 * height / 3 / 0.25  # of the faces, and of each half with a steady flow
    fast, slow = 2 * conductance / (capacity * height), 2 / resistance / (capacity * height)
    assert slow < closed(conductance) < fast
    assert abs(closed(conductance, back=1e-3)) < 1e-12  # faces that do not touch
    assert abs(closed(0.0)) < 1e-12


@pytest.mark.parametrize("coupled", [False, True])
def test_a_run_goes_on_bit_for_bit(tmp_path, coupled):
    """Also back from a later state, in which more bonds have broken."""
    sim = torn(coupled=coupled, expansion=1e-4, **MATERIALS["bonds that soften"] | {"fracture_energy": 0.01})
    sim.step(2)
    sim.save(tmp_path / "state.h5")
    before = sim.broken_bonds
    again = fh.Simulation.restore(tmp_path / "state.h5")
    for run in (sim, again):
        run.step(20)
    assert 0 < before < sim.broken_bonds
    fields = sim.fields
    sim.load(tmp_path / "state.h5")
    sim.step(20)
    for name, values in fields.items():
        np.testing.assert_array_equal(again.fields[name], values)
        np.testing.assert_array_equal(sim.fields[name], values)


def refused(**more):
    lattice = fh.Lattice(1.0, (-6.0, -6.0), (6.0, 6.0))
    given = {"horizon": 2.0, "of_heat": 2.0, "critical_stretch": 0.05, "contact": 0.0} | more
    kernel = fh.Kernel(given["horizon"], exponent=1)
    solid = fh.Elastic(kernel, young=1.0, critical_stretch=given["critical_stretch"])
    heat = fh.Heat(fh.Kernel(given["of_heat"]), conductivity=2.0)
    model = fh.Thermoelastic(solid, heat, FAINT, ZERO, False, given["contact"])
    return fh.Simulation(lattice, model, fh.Free())


@pytest.mark.parametrize(
    "more, words",
    [
        ({"contact": 2.1}, "<= "),
        ({"contact": -1.0}, ">= 0"),
        ({"contact": 0.1, "critical_stretch": None}, "no bond breaks"),
    ],
)
def test_bad_input(more, words):
    refused()
    with pytest.raises(fh.InputError, match=words):
        refused(**more)


def test_longer_bonds_are_chains():
    """In both directions the same one, with ends that meet; a diagonal is no chain of steps along the axes."""
    cube = np.stack(np.meshgrid(*[range(-2, 3)] * 3, indexing="ij"), -1).reshape(-1, 3)
    short, long = (cube[(np.abs(cube).sum(1) > 0) & ((cube**2).sum(1) < end)] for end in (4, 13))
    numbers, starts = chains(long, short)
    links = [[] for _ in long]
    for link, row, at in zip(short, numbers, starts, strict=True):
        for k, start in zip(row[row >= 0], at[row >= 0], strict=True):
            links[k].append((tuple(-start), tuple(link - start)))  # its ends, relative to the node of the long one
    for offset, chain in zip(long, links, strict=True):
        start, end = sorted([(0, 0, 0), tuple(offset)])
        nodes, here, met = dict(chain), start, 0
        while here != end:
            here, met = nodes[here], met + 1
        assert met == len(chain) <= np.abs(offset).max()
        (opposite,) = (k for k, row in enumerate(long) if (row == -offset).all())
        turned = {(tuple(np.add(b, -offset)), tuple(np.add(a, -offset))) for a, b in chain}
        assert {tuple(sorted(link)) for link in turned} == {tuple(sorted(link)) for link in links[opposite]}
    with pytest.raises(fh.InputError, match="no chain"):
        chains(long, short[np.abs(short).sum(1) == 1])

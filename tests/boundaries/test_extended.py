"""The extended domain against the infinite lattice: the same scheme and step, without any end."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.boundaries import Extended
from farhorizon.case.case import Case
from farhorizon.studies.compare import compare

SIDES = ("x-", "x+", "y-", "y+", "z-", "z+")


def pulse(lattice, centre, width):
    """A pulse, cut off where it is negligible."""
    values = np.exp(-sum((x - c) ** 2 for x, c in zip(lattice.coordinates(), centre, strict=True)) / width**2)
    return np.where(values > 1e-14, values, 0.0)


def random_setup(rng, physics, dim):
    """Return a pulse, a velocity or a source, off the centre of a box; with its target and the end of the run."""
    # bonds of nearest neighbours alone are no elastic medium
    reach = int(rng.integers(1 if physics != "elastic" else 2, 5 if dim < 3 else 3))
    spacing = float(rng.choice([0.1, 0.25, 1.0]))
    lattice = fh.Lattice(
        spacing, (0.0,) * dim, tuple(spacing * (rng.integers(2 * reach + 8, {1: 80, 2: 32, 3: 16}[dim], dim) - 1))
    )
    influence = "constant" if reach == 1 else str(rng.choice(["constant", "linear", "gaussian"]))
    exponent = int(rng.integers(0, 2 if physics != "wave" else 3 if dim == 1 else 4))
    kernel = fh.Kernel(reach * spacing, exponent, influence, volume=str(rng.choice(["ramp", "full"])))
    speed, longest = float(rng.choice([0.7, 1.0, 1.6])), {1: 10, 2: 4, 3: 2}[dim]
    if physics == "wave":
        model = fh.Wave(
            kernel, speed=speed, damping=speed / (spacing * max(lattice.shape)) * float(rng.choice([0.0, 0.0, 1.0]))
        )
    else:
        model = (
            fh.Diffusion(kernel, speed)
            if physics == "diffusion"
            else fh.Elastic(kernel, speed, plane="strain" if dim == 2 else None)
        )
    width = spacing * rng.uniform(1.5, 4.0)
    shape = pulse(lattice, lattice.lower + rng.uniform(0.35, 0.65, dim) * (lattice.upper - lattice.lower), width)
    shape = shape if physics != "elastic" else np.stack([a * shape for a in rng.uniform(-1, 1, dim)])
    until = fh.Simulation(lattice, model, fh.Fixed()).crossing * rng.uniform(1, longest)
    what = str(rng.choice(["u", "source"] if physics == "diffusion" else ["u", "v", "source"]))
    period = until / rng.uniform(5, 20)
    data = (
        {"sources": [fh.Source(shape, lambda t: np.sin(t / period) ** 2 * (t < 3 * period))]}
        if what == "source"
        else {"initial": {what: shape}}
    )
    return {"lattice": lattice, "model": model, **data}, float(10.0 ** -rng.integers(3, 8)), until


def measured(setup, boundary, until):
    """Return the largest error over the run, sampled from a tenth of it on; for diffusion relative to the maximum at
    the same time.
    """
    curve = next(
        iter(
            compare(
                {**setup, "boundary": boundary}, until, np.linspace(0.1, 1, 10) * until, beside=False
            ).curves.values()
        )
    )
    return max(curve["error_rel_current" if setup["model"].order == 1 else "error_rel_initial"])


def check_random(seed, physics, dim, count):
    for number in range(count):
        setup, target, until = random_setup(np.random.default_rng([seed, number]), physics, dim)
        error = measured(setup, fh.Extended(target, until=until), until)
        assert error <= target, (
            f"seed {seed}, number {number}: {error / target:.3g} targets of {target:g} at {until:.6g}"
        )


@pytest.mark.parametrize("physics, dim", [("wave", 1), ("wave", 2), ("diffusion", 1), ("diffusion", 2), ("elastic", 2)])
def test_random_runs_keep_their_target(physics, dim):
    check_random(1, physics, dim, 2)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [11, 12])
@pytest.mark.parametrize(
    "physics, dim", [(p, d) for p in ("wave", "diffusion", "elastic") for d in (1, 2, 3) if p != "elastic" or d > 1]
)
def test_more_random_runs_keep_their_target(physics, dim, seed):
    check_random(seed, physics, dim, 8 if dim < 3 else 3)


@pytest.mark.parametrize("physics, dim", [("wave", 1), ("wave", 2), ("diffusion", 1), ("elastic", 2)])
def test_the_domain_is_no_larger_than_it_must_be(physics, dim):
    """With a quarter less of it the target is missed."""
    for seed in (2, 3):
        setup, _, until = random_setup(np.random.default_rng([seed, dim]), physics, dim)
        target = 1e-4
        extents = fh.Simulation(**setup, boundary=fh.Extended(target, until=until)).extents
        less = {
            SIDES[2 * axis + (side > 0)]: fh.Extended(nodes=3 * found.nodes // 4)
            for (axis, side), found in extents.items()
        }
        assert measured(setup, less, until) > target, seed


LATTICE = fh.Lattice(0.25, (-4.0, -2.5), (4.0, 2.5))
WAVE = fh.Wave(fh.Kernel(0.5))
BLOB = pulse(LATTICE, (1.0, -0.5), 0.6)


def far_domain(setup, sides, more):
    """Return the same set-up on a larger lattice, independent of `Extended`, and where the near field lies in it."""
    lattice = setup["lattice"]
    pads = [[more * (s + e in sides or s in sides) for e in "-+"] for s in "xyz"[: lattice.dim]]
    wide = fh.Lattice(
        lattice.spacing,
        [a - lattice.spacing * p[0] for a, p in zip(lattice.lower, pads, strict=True)],
        [b + lattice.spacing * p[1] for b, p in zip(lattice.upper, pads, strict=True)],
    )
    grown = {**setup, "lattice": wide, "initial": {"u": np.pad(setup["initial"]["u"], pads)}}
    if "coefficient" in setup:
        grown["coefficient"] = np.pad(setup["coefficient"], pads, mode="edge")
    return grown, tuple(slice(p[0], p[0] + n) for p, n in zip(pads, lattice.shape, strict=True))


@pytest.mark.parametrize(
    "others",
    [
        {"y": fh.Free()},
        {"y": fh.Fixed()},
        {"y": fh.Periodic()},
        {"y-": fh.Free(), "y+": fh.Extended()},
        {"x-": fh.Fixed(0.5), "y": fh.Periodic()},
        {"coefficient": np.broadcast_to(np.where(np.arange(LATTICE.shape[1]) < 8, 0.4, 1.0), LATTICE.shape)},
        {"coefficient": np.broadcast_to(np.where(np.arange(LATTICE.shape[0]) < 8, 2.0, 1.0)[:, None], LATTICE.shape)},
        {"cracks": [[(3.0, -1.0), (6.0, 2.0)]]},
        {"cracks": [[(2.0, 0.3), (900.0, 0.3)]]},
    ],
    ids=["free", "fixed", "periodic", "corner", "driven", "layered", "interface", "oblique crack", "endless crack"],
)
def test_sides_materials_and_cracks(others):
    """Beside other sides, with interfaces along and across the side, and with cracks that cross it; against a domain
    whose ends are twice as far away.
    """
    boundary = {"all": fh.Extended(1e-6)} | {k: b for k, b in others.items() if k[0] in "xy"}
    setup = {
        "lattice": LATTICE,
        "model": WAVE,
        "initial": {"u": BLOB},
        **{k: v for k, v in others.items() if k[0] not in "xy"},
    }
    sim = fh.Simulation(**setup, boundary=boundary).run(until=16.0)
    open_sides = {SIDES[2 * a + (s > 0)] for (a, s), b in sim.sides.items() if isinstance(b, Extended)}
    more = 2 * max(found.nodes for found in sim.extents.values())
    grown, near = far_domain(setup, open_sides, more)
    named = {"xy"[a] + "-+"[s > 0]: b for (a, s), b in sim.sides.items()}
    ends = {name: fh.Fixed() if name in open_sides else b for name, b in named.items()}
    far = fh.Simulation(**grown, boundary=ends, dt=sim.dt).run(until=16.0)
    assert np.abs(sim.fields["u"] - far.fields["u"][near]).max() <= 1e-6
    assert np.abs(sim.fields["u"]).max() > 1e-3 and sim.fields["u"].shape == LATTICE.shape


def test_the_length_of_the_run_is_that_of_the_first_run():
    sim = fh.Simulation(LATTICE, WAVE, fh.Extended(1e-4), {"u": BLOB})
    places, seen = sim.record([(0.0, 0.0)]), []
    sim.observers.append(lambda run: seen.append(run.time))
    small = sim.extents[0, 1].nodes
    sim.run(until=20.0)
    assert sim.extents[0, 1].nodes > small + 20 and sim.extents[0, 1].until == 20.0
    assert sim.probes is places and len(places.times) == sim.step_count + 1 and seen and not sim.notes
    sim.run(until=24.0)  # the domain is fixed by now
    assert any("comes back from the end of the extended domain up to t = 20" in note for note in sim.notes)
    stepped = fh.Simulation(LATTICE, WAVE, fh.Extended(1e-4, until=2.0), {"u": BLOB})
    stepped.step(int(2.5 / stepped.dt))
    assert any("up to t = 2, but later" in note for note in stepped.notes)


def nodes(sim):
    """Return the number of nodes beyond each side that extends the domain."""
    return {key: found.nodes for key, found in sim.extents.items()}


def test_checkpoints_are_bitwise(tmp_path):
    """A run continues from its checkpoint to the last bit, by `restore` and by `load` into a set-up that was prepared
    for another length.
    """

    def make():
        return fh.Simulation(LATTICE, WAVE, {"x": fh.Extended(1e-5), "y": fh.LatticePML(nodes=6)}, {"u": BLOB})

    whole = make().run(until=6.0)
    half = make()
    half.prepare(6.0)
    half.step(10)
    half.save(tmp_path / "a.ckpt")
    restored = fh.Simulation.restore(tmp_path / "a.ckpt")
    loaded = make()
    loaded.prepare(9.0)
    loaded.load(tmp_path / "a.ckpt")
    for sim in (restored, loaded):
        assert sim.step_count == 10 and nodes(sim) == nodes(half)
        assert np.array_equal(sim.run(until=6.0).fields["u"], whole.fields["u"])


CASE = """
[lattice]
spacing = 0.25
lower = [-3.0, -2.0]
upper = [3.0, 2.0]
[model]
type = "wave"
[model.kernel]
horizon = 0.5
[initial]
u = "exp(-4*(x**2+y**2))"
[boundary]
all = { type = "extended", target = 1e-4 }
[run]
until = 8.0
"""


def test_a_case_is_the_run_of_python():
    case = Case(CASE)
    sim = case.simulation().run(until=8.0)
    same = fh.Simulation(
        case.lattice, fh.Wave(fh.Kernel(0.5)), fh.Extended(1e-4), {"u": "exp(-4*(x**2+y**2))"}, dt=sim.dt
    ).run(until=8.0)
    assert np.array_equal(sim.fields["u"], same.fields["u"]) and sim.extents == same.extents
    assert sim.energy() == same.energy() < 0.05 * fh.Simulation.of(case.setup).energy()  # of the near field


def test_check_compares_it_with_layers():
    """`check` of either one prices the other, in time and memory; the extended domain is certified, like all nodes of
    the medium.
    """
    ours = fh.Simulation.of(Case(CASE).setup).check(8.0)
    page = ours.details
    assert ours.certificate.verdict == "certified" and "layers instead" in page and "extended x-" in page
    assert ours.numbers["layer_nodes"] >= 2 and ours.numbers["layer_cost"] > 0 and ours.numbers["layer_memory"] > 0
    layers = Case(CASE).simulation(boundary=fh.LatticePML(target=1e-4, until=8.0)).check(8.0)
    assert layers.numbers["extended_nodes"] == pytest.approx(ours_nodes(ours)) and layers.numbers["extended_memory"] > 1


def ours_nodes(report):
    """Return the number of nodes that a report says are computed."""
    words = dict(report.rows)["nodes computed"].split()
    return int(words[0])


def test_what_it_cannot_serve_is_refused():
    cube = fh.Lattice(0.1, (-1.0,) * 3, (1.0,) * 3)
    with pytest.raises(fh.InputError, match="does not fit into memory") as refused:
        fh.Simulation(cube, fh.Wave(fh.Kernel(0.2)), fh.Extended(until=1e4), {"u": "exp(-30*(x**2+y**2+z**2))"})
    assert refused.value.key == "boundary" and "LatticePML" in refused.value.remedy
    with pytest.raises(fh.InputError, match="cannot be combined"):
        fh.Simulation(LATTICE, WAVE, {"x": fh.Extended(), "y": fh.Higdon()})
    with pytest.raises(fh.InputError, match="no such side"):
        fh.Simulation(fh.Lattice(0.25, -4, 4), fh.Beam(1.0), fh.Extended())
    for wrong in ({"target": 0.5}, {"nodes": 0}, {"until": -1.0}):
        with pytest.raises(fh.InputError, match=f"boundary.{next(iter(wrong))}"):
            fh.Extended(**wrong)
    with pytest.raises(fh.InputError, match="zero beyond the absorbing side"):
        fh.Simulation(LATTICE, WAVE, fh.Extended(), {"u": "exp(-x**2/100)"})

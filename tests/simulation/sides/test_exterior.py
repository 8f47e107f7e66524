"""Data beyond the near field: refused above the side's target, noted below it, and ignored where the medium ends."""

import os

import numpy as np
import pytest

import farhorizon as fh

LATTICE = fh.Lattice(0.25, (-3, -3), (3, 3))
KERNEL = fh.Kernel(0.75)
X, Y = LATTICE.coordinates()


def pulse(steepness, x0=0.0, y0=0.0):
    return lambda x, y: np.exp(-steepness * ((x - x0) ** 2 + (y - y0) ** 2))


def simulation(**changes):
    setup = {"lattice": LATTICE, "model": fh.Wave(KERNEL), "boundary": fh.LatticePML(), "initial": {"u": pulse(4)}}
    return fh.Simulation(**{**setup, **changes})


def travelling(x, y, t):
    """Source that leaves the near field at about t = 3."""
    return np.exp(-4 * ((x - t) ** 2 + y**2))


BEYOND = {
    "pulse too wide": {"initial": {"u": pulse(1)}},  # exp(-3.25^2) = 3e-5 just beyond
    "pulse centred beyond": {"initial": {"u": pulse(4, 5.0)}},
    "pulse near a corner": {"initial": {"u": pulse(4, 2.9, 2.9)}},
    "velocity": {"initial": {"v": pulse(1)}},
    "expression": {"initial": {"u": fh.Expression("exp(-x**2)", 2)}},
    "starts within the layer": {"initial": {"u": lambda x, y: pulse(4)(x, y) + (np.abs(x - 5) < 0.3)}},
    "only in the corner of two layers": {"initial": {"u": lambda x, y: pulse(4)(x, y) + (x > 4) * (y > 4)}},
    "far beyond, nothing inside": {"initial": {"u": lambda x, y: 1.0 * (np.abs(x - 8) < 0.3)}},
    "undefined beyond": {"initial": {"u": lambda x, y: pulse(4)(x, y) / (x < 3.1)}},
    "number": {"initial": {"u": 1.0}},
    "sponge": {"initial": {"u": pulse(1)}, "boundary": fh.Sponge()},
    "source too wide": {"sources": [fh.Source(pulse(1), np.sin)]},
    "source beyond": {"sources": [fh.Expression("exp(-4*(x-5)**2-4*y**2)*sin(t)", 2)]},
    "point source far beyond": {"sources": [fh.Expression("(abs(x-8) < 0.1)*(abs(y) < 0.1)*sin(t)", 2)]},
    "uniform source": {"sources": [1.0]},
}


@pytest.mark.parametrize("changes", BEYOND.values(), ids=BEYOND)
def test_beyond_an_absorbing_side_is_refused(changes):
    """The error names the key, the value, the limit and a remedy."""
    with pytest.raises(fh.InputError, match="beyond") as error:
        simulation(**changes)
    assert error.value.key.split(".")[0] in ("initial", "source")
    assert error.value.value is not None and error.value.limit is not None and "near field" in error.value.remedy


def test_the_error_that_it_would_cause_is_named():
    """The largest value just beyond the side is exp(-3.25^2) = 2.6e-5 of the maximum."""
    with pytest.raises(fh.InputError, match=r"error of about 2\.6e-05 of the largest initial value.*limit: 1e-05"):
        simulation(initial={"u": pulse(1)})


@pytest.mark.parametrize("end", [fh.Fixed(), fh.Free(), fh.Periodic()])
def test_where_the_medium_ends_nothing_lies_beyond(end):
    """A pulse cut off by a wall, and a uniform source where no side absorbs."""
    sim = simulation(boundary={"x": fh.LatticePML(), "y": end}, initial={"u": pulse(4, 0.0, 2.9)})
    assert sim.notes == []
    assert (
        simulation(boundary=end, initial={"u": 1.0 if not isinstance(end, fh.Fixed) else 0.0}, sources=[1.0]).notes
        == []
    )


def test_a_body_has_no_data_where_it_has_no_nodes():
    """A half-space y < 0 in a square with absorbing sides: data outside the body do not count."""
    body = fh.Box((-3, -3), (3, 0))
    lattice = fh.Lattice(0.25, (-3, -3), (3, 3), body=body)
    sides = {"all": fh.LatticePML(), "y+": fh.Free()}
    sim = fh.Simulation(lattice, fh.Wave(KERNEL), sides, {"u": lambda x, y: pulse(9, 0, -1)(x, y) + 1.0 * (y > 1)})
    assert sim.notes == []


def test_below_the_target_it_is_noted():
    """exp(-1.5 * 3.25^2) = 1.3e-7 is above 1e-8 and below 1e-6; exp(-4 * 3.25^2) is below rounding."""
    (note,) = simulation(boundary=fh.LatticePML(target=1e-6), initial={"u": pulse(1.5)}).notes
    assert "1.3e-07" in note and "x-, x+, y-, y+" in note
    assert simulation().notes == []


def test_an_array_at_the_edge_is_noted():
    """The values of an array beyond its edge are unknown: there is a note, and no error."""
    assert simulation(initial={"u": np.exp(-4 * (X**2 + Y**2))}).notes == []
    sim = simulation(initial={"u": np.exp(-(X**2)) * np.exp(-4 * Y**2)})  # exp(-9) at x = 3
    assert len(sim.notes) == 1 and "(x-, x+)" in sim.notes[0] and "cannot be checked" in sim.notes[0]
    assert any("cannot be checked" in line for line in str(sim.check()).splitlines())
    assert "x-, x+, y-, y+" in simulation(sources=[np.ones(LATTICE.shape)]).notes[0]
    assert simulation(boundary=fh.Free(), initial={"u": np.ones(LATTICE.shape)}).notes == []


def test_a_source_that_moves_out_is_refused_before_the_run():
    """The end of the run has to be known: at t = 1 the whole source is inside, at t = 3 half of it."""
    sim = simulation(sources=[travelling])
    sim.run(0.5)
    with pytest.raises(fh.InputError, match=r"source.*beyond the absorbing side x\+"):
        sim.run(3.0)
    assert sim.time < 0.8
    simulation(sources=[fh.Source(fh.Expression("exp(-4*x**2-4*y**2+0*t)", 2), np.sin)]).run(1.0)


def test_what_vanishes_everywhere_is_noted():
    assert simulation(initial={"u": lambda x, y: 0 * x}).notes == ["initial.u is zero on every node of the near field"]


def test_the_background_is_not_called_zero():
    """Data equal to the background count as zero; data equal to zero do not."""
    ground = {"model": fh.Heat(KERNEL), "background": 10.0}
    assert (
        "initial.u is 10, the background, on every node of the near field"
        in simulation(**ground, initial={"u": 10.0}).notes
    )
    with pytest.raises(fh.InputError, match=r"not 10, the background, beyond the .*value: 10 off at .*set background"):
        simulation(**ground, initial={"u": 0.0})
    with pytest.raises(fh.InputError, match=r"10, the background, on every node .* not beyond; value: 1 off near"):
        simulation(**ground, initial={"u": lambda x, y: 10.0 + (np.abs(x - 8) < 0.3)})


CRACKS = {
    "wholly beyond": [(5, 0), (6, 1)],
    "wholly beyond, along a side": [(-2, 4.5), (2, 4.5)],
    "far away": [(50, 0), (60, 0)],
    "oblique": [(0, 0.1), (5, 2.6)],
    "turns in the layer": [(0, 0.1), (5, 0.1), (5, 2.1)],
}


@pytest.mark.parametrize("points", CRACKS.values(), ids=CRACKS)
def test_cracks_beyond_are_refused(points):
    with pytest.raises(fh.InputError, match="crack") as error:
        simulation(cracks=[points])
    assert error.value.value is not None and error.value.limit is not None and error.value.remedy


def test_a_crack_straight_into_a_layer_is_continued():
    """A crack along the normal is accepted, with a note that it continues without end; where it ends beyond does not
    matter.
    """
    short, long = simulation(cracks=[[(0, 0.1), (4.5, 0.1)]]), simulation(cracks=[[(0, 0.1), (50.0, 0.1)]])
    assert len(long.notes) == 1 and "without end" in long.notes[0]
    short.step(40)
    long.step(40)
    np.testing.assert_array_equal(short.fields["u"], long.fields["u"])


@pytest.mark.parametrize("dim", [1, 3])
def test_cracks_beyond_in_1d_and_3d(dim):
    crack = 5.0 if dim == 1 else fh.DiscCut((5, 0, 0), (1, 0, 0), 0.5)
    with pytest.raises(fh.InputError, match="beyond the near field"):
        fh.Simulation(fh.Lattice(0.5, (-2,) * dim, (2,) * dim), fh.Wave(fh.Kernel(1.0)), cracks=[crack])


def bar(half, pull):
    """Return a bar whose stiffness grows along it, with the near field |x| < half; beyond, it continues as at the
    edge.
    """
    lattice = fh.Lattice(0.1, [-half], [half])
    stiffness = np.clip(1 + pull * lattice.axes[0], 0.2, None)
    start = {"u": lambda x: np.exp(-8 * x**2)}
    return fh.Simulation(
        lattice,
        fh.Wave(fh.Kernel(0.2)),
        fh.LatticePML(nodes=12),
        start,
        coefficient=stiffness,
        rule="arithmetic",
        dt=0.025,
    )


def test_a_gradient_along_the_normal_is_noted_with_its_size():
    """The note gives the change over the last eight nodes in front of each side. The error against wider runs to t =
    20 is 4e-3 with the gradient and 1e-11 without it.
    """
    near, wide, flat, wide_flat = bar(4.0, 0.08), bar(30.0, 0.08), bar(4.0, 0.0), bar(30.0, 0.0)
    steep = {side: 0.08 * 0.8 / max(1 + 0.08 * 4 * side, 1 + 0.08 * 4 * side - 0.064 * side) for side in (-1, 1)}
    for side, name in ((-1, "x-"), (1, "x+")):
        (note,) = [note for note in near.notes if f"in front of {name}" in note]
        assert f"changes by {100 * steep[side]:.2g} % along the normal over the last 8 nodes" in note
    errors = []
    for _ in range(20):
        for sim in (near, wide, flat, wide_flat):
            sim.step(40)
        errors.append(
            [
                np.abs(one.fields["u"] - other.fields["u"][260:341]).max()
                for one, other in ((near, wide), (flat, wide_flat))
            ]
        )
    assert 2e-3 < np.max(errors, axis=0)[0] and np.max(errors, axis=0)[1] < 1e-9
    assert not any("changes by" in note for note in flat.notes)


def test_interfaces_are_no_gradients_and_gradients_across_the_normal_are_none():
    """Random interfaces parallel to a pair of sides, and a material that varies only along the sides, give no note;
    oblique interfaces, which meet a side, give one that does not call them gradients. A gradient along the normal gives
    one for each side, even with a hole at it.
    """
    seed = int(os.environ.get("FARHORIZON_SEED", 415))
    print(f"seed {seed}")
    rng = np.random.default_rng(seed)
    for number in range(20):
        oblique = number % 2 == 1
        a, b = rng.uniform(0.3, 1, 2) * rng.choice([-1, 1], 2) if oblique else rng.permutation([0.0, 0.5])
        step = np.where(a * X + b * Y > rng.uniform(-1.4, 1.4), *rng.permutation([rng.uniform(0.1, 0.5), 1.0]))
        assert np.ptp(step) > 0
        notes = simulation(coefficient=step).notes
        assert not any("changes by" in note for note in notes)
        assert any(ALONG in note for note in notes) == oblique
    across = simulation(coefficient=1 + 0.1 * X, boundary={"x": fh.Fixed(), "y": fh.LatticePML()})
    assert not any("changes by" in note for note in across.notes)
    along = simulation(
        coefficient=np.where(X**2 + (Y - 3) ** 2 < 1, 0.0, 1 + 0.1 * Y),
        boundary={"x": fh.Fixed(), "y": fh.LatticePML()},
    )
    assert sum("changes by" in note for note in along.notes) == 2


PULSE = {"u": ["1e-3*exp(-(x**2+y**2)/8)", "0"]}  # which reaches the sides, as far as layers are concerned
PUSH = {"loads": [fh.BodyForce(["0", "exp(-x**2-y**2)"], time="exp(-(t-4)**2)")]}
ALONG = "continue straight along the normal"
ROOM = fh.Box((-99.0, -99.0), (99.0, 99.0))


def solid(start, body=None, **constants):
    lattice = fh.Lattice(1.0, (-12.0, -12.0), (12.0, 12.0), body=body)
    medium = fh.Elastic(fh.Kernel(2.0, 1), **{"young": 1.0} | constants)
    return fh.Simulation(lattice, medium, fh.LatticePML(nodes=8), threads=1, **start)


@pytest.mark.parametrize("start", [{}, PUSH, {"initial": PULSE}], ids=["rest", "push", "pulse"])
@pytest.mark.parametrize(
    ("medium", "noted", "what"),
    [
        ({"density": "1+0.05*x"}, {"x-", "x+"}, "the density changes by"),
        ({"density": "2+0.05*x", "material": "state-based", "poisson": 0.3}, {"x-", "x+"}, "the density changes by"),
        ({"poisson": "0.3+0.01*x", "material": "state-based"}, {"x-", "x+"}, "the stiffness changes by"),
        ({"body": ROOM - fh.Disc(4.5, (13.0, 0.0))}, {"x+"}, "the body: an interface"),
    ],
    ids=["bonds", "states", "poisson", "hole"],
)
def test_layers_continue_any_medium_whatever_drives_it(start, medium, noted, what):
    """Where the medium varies at a side, it is continued over one reach of nodes beyond the edge, and there is a
    note; also for a medium at rest.
    """
    sim = solid(start, **medium)
    reach = sim.parts.near.stencil.reach[0]
    assert {name for name in ("x-", "x+", "y-", "y+") if any(what in n and name in n for n in sim.notes)} == noted
    for side in noted:
        assert sim.parts.grid.margins[0, 1 if side == "x+" else -1] == 1 + reach


@pytest.mark.parametrize(
    ("young", "bends"),
    [
        ("where((x-12)**2+y**2<16,3,1)", True),  # a disc that the side cuts
        ("where(x+y>3,3,1)", True),
        ("where(x+0.2*y>12,3,1)", True),
        ("where(x+y>3,3,1+0.01*y)", True),
        ("where((x-7)**2+y**2<16,3,1)", False),  # a disc in front of the side
        ("where((x-7)**2+y**2<16,3,where(y>0,2,1))", False),
        ("where(y>3,3,1)", False),
        ("where(x>10,3,1)", False),
        ("1+0.01*y+where((x-7)**2+y**2<16,1,0)", False),
    ],
)
def test_an_interface_that_meets_a_side_at_an_angle_is_noted(young, bends):
    assert any("x+" in note and ALONG in note for note in solid({}, young=young).notes) == bends


def test_a_gradient_in_a_body_is_noted():
    """A body's material may not vary within one reach of a layer, but may do so farther away."""
    lattice = fh.Lattice(1.0, (-12, -8), (12, 8))
    young = np.clip(1 + 0.05 * lattice.coordinates()[0], 0.6, 1.4)

    def body(young):
        solid = fh.Correspondence(fh.Kernel(2.7, 0, "gaussian", 0.9, volume="full"), young, 0.25)
        return fh.Simulation(lattice, solid, fh.NonlocalPML(8))

    notes = [note for note in body(young).notes if "changes by" in note]
    assert len(notes) == 2 and all(note.startswith("the stiffness") for note in notes)
    assert not body(np.where(lattice.coordinates()[0] > 1, 2.0, 1.0)).notes

"""Conditions along an outline: geometry, memory, sides of different kinds, and what is refused. How well they absorb
is tested in the files of each.
"""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.boundaries.outline import Outline, OutlineNodes, ordered_fronts
from farhorizon.studies.compare import compare

SPACING = 0.25
KERNEL = fh.Kernel(3 * SPACING, 2)
CONDITIONS = [fh.PlaneWave(), fh.Higdon(), fh.Higdon((0.0, 30.0, 60.0))]


def pulse(*x):
    return np.exp(-2 * sum(a**2 for a in x))


def disc(boundary, radius=5.0, **options):
    model = fh.Wave(KERNEL, damping=0.0125)
    return fh.Simulation(fh.Lattice(SPACING, window=fh.Disc(radius)), model, boundary, {"u": pulse}, dt=0.05, **options)


def test_halo_is_what_the_stencil_reads():
    sim = disc(fh.Higdon())
    near, halo = sim.closure.outline.near, sim.closure.halo
    assert not (near & halo).any()
    nodes = np.argwhere(near)
    for offset in sim.stencil.offsets:
        assert (near | halo)[tuple((nodes + offset).T)].all()
    for node in np.argwhere(halo)[::50]:
        assert near[tuple(np.clip(node + sim.stencil.offsets, 0, np.array(near.shape) - 1).T)].any()


@pytest.mark.parametrize("boundary", CONDITIONS)
def test_disc_stays_symmetric(boundary):
    """Mirror images along both axes, and for `PlaneWave` along the diagonal, to rounding."""
    sim = disc(boundary)
    sim.step(300)
    u = np.nan_to_num(sim.fields["u"])
    for image in (u[::-1], u[:, ::-1]):
        assert np.abs(u - image).max() < 1e-11 * np.abs(sim.start_u).max()
    if isinstance(boundary, fh.PlaneWave):  # a Higdon node on the diagonal takes the first axis
        assert np.abs(u - u.T).max() < 1e-11


@pytest.mark.parametrize("boundary", CONDITIONS)
def test_threads_and_steps_do_not_matter(boundary):
    """The compiled loop on one thread at once, and on two step by step: the same to the last bit."""
    runs = [disc(boundary, radius=27.0, threads=threads) for threads in (1, 2)]
    runs[0].step(40)
    for _ in range(40):
        runs[1].step()
    assert np.array_equal(*(sim.fields["u"] for sim in runs), equal_nan=True)


@pytest.mark.parametrize("boundary", CONDITIONS)
def test_resumed_run_is_the_same(boundary, tmp_path):
    """The levels that the condition remembers are in the checkpoint."""
    whole, half = disc(boundary), disc(boundary)
    whole.step(200)
    half.step(120)
    half.save(tmp_path / "half.ckpt")
    resumed = fh.Simulation.restore(tmp_path / "half.ckpt", initial={"u": pulse})
    resumed.step(80)
    assert np.array_equal(whole.fields["u"], resumed.fields["u"], equal_nan=True)


def test_checkpoint_of_another_condition_is_refused(tmp_path):
    disc(fh.Higdon()).save(tmp_path / "a.ckpt")
    with pytest.raises(fh.FileFormatError, match="update"):
        disc(fh.Higdon((0.0, 30.0))).load(tmp_path / "a.ckpt")


@pytest.mark.slow
def test_single_precision():
    """Each step rounds by 2^-24, which changes the velocity: a random walk of 300 steps, summed. The condition itself
    is in double precision.
    """
    one, other = disc(fh.PlaneWave()), disc(fh.PlaneWave(), dtype="float32")
    for sim in (one, other):
        sim.step(300)
    assert np.nanmax(np.abs(one.fields["u"] - other.fields["u"])) < 300**1.5 * 2**-24


def test_ball():
    """In 3D, against the infinite lattice: at least ten times better than a fixed edge."""
    lattice = fh.Lattice(SPACING, window=fh.Ball(2.5))
    setup = {
        "lattice": lattice,
        "model": fh.Wave(fh.Kernel(2 * SPACING, 2, "linear")),
        "boundary": fh.Higdon(),
        "dt": 0.05,
        "initial": {"u": lambda x, y, z: np.exp(-5 * (x**2 + y**2 + z**2))},
    }
    curves = compare(setup, 5.0, times=[2, 3, 4, 5]).curves
    assert 10 * curves["Higdon"]["error_max_over_run"] < curves["fixed edge"]["error_max_over_run"]


@pytest.mark.parametrize("beside", [fh.Periodic(), fh.Free(), fh.Fixed()])
@pytest.mark.parametrize("boundary", [fh.PlaneWave(), fh.Higdon()])
def test_two_sides_of_a_box(boundary, beside):
    """A waveguide closed at both ends, against a long one: much better than fixed ends, whatever the walls are."""
    setup = {
        "lattice": fh.Lattice(SPACING, (-5.0, -2.0), (5.0, 2.0)),
        "model": fh.Wave(KERNEL),
        "boundary": {"x": boundary, "y": beside},
        "dt": 0.05,
        "initial": {"u": lambda x, y: np.exp(-(x**2)) * np.ones_like(y)},
    }
    if isinstance(beside, fh.Fixed):  # a wave that satisfies the fixed walls
        setup["initial"] = {"u": lambda x, y: np.exp(-(x**2)) * np.cos(np.pi * y / 4)}
    curves = compare(setup, 12.0, times=[6, 8, 10, 12]).curves
    ours = next(iter(curves.values()))
    assert 5 * ours["error_max_over_run"] < curves["fixed edge"]["error_max_over_run"]


def test_periodic_halo_wraps():
    """A wave that does not depend on y leaves in the same way, whatever the width of the fringe."""
    fields = []
    for half in (1.0, 2.5):
        lattice = fh.Lattice(SPACING, (-5.0, -half), (5.0, half))
        sim = fh.Simulation(
            lattice,
            fh.Wave(KERNEL),
            {"x": fh.PlaneWave(), "y": fh.Periodic()},
            {"u": lambda x, y: np.exp(-(x**2)) + 0 * y},
            dt=0.05,
        )
        sim.step(200)
        fields.append(sim.fields["u"][:, 3])
        assert np.abs(np.ptp(sim.fields["u"], axis=1)).max() < 1e-12
    assert np.abs(fields[0] - fields[1]).max() < 1e-12


def test_different_conditions_on_the_sides_of_a_box():
    sides = {"x-": fh.Higdon(), "x+": fh.PlaneWave(), "y": fh.Higdon((0.0, 0.0))}
    setup = {
        "lattice": fh.Lattice(SPACING, (-5.0, -5.0), (5.0, 5.0)),
        "model": fh.Wave(KERNEL),
        "boundary": sides,
        "dt": 0.05,
        "initial": {"u": pulse},
    }
    curves = compare(setup, 12.0, times=[6, 8, 10, 12]).curves
    assert 10 * next(iter(curves.values()))["error_max_over_run"] < curves["fixed edge"]["error_max_over_run"]


@pytest.mark.parametrize("boundary", [fh.PlaneWave(), fh.Higdon()])
def test_window_that_is_a_box(boundary):
    """The field is that of the same box given as bounds."""
    fields = []
    for lattice in (
        fh.Lattice(SPACING, (-5.0, -5.0), (5.0, 5.0)),
        fh.Lattice(SPACING, window=fh.Box((-5.0, -5.0), (5.0, 5.0))),
    ):
        sim = fh.Simulation(lattice, fh.Wave(KERNEL), boundary, {"u": pulse}, dt=0.05)
        sim.step(200)
        fields.append(sim.fields["u"])
    assert np.array_equal(*fields)


def test_thin_layer_cuts_bonds():
    """A layer of one node where the stencil reaches three: the bonds beyond it are absent, two of the last near node
    and one of the next.
    """
    lattice = fh.Lattice(SPACING, (-5.0,), (5.0,))
    sim = fh.Simulation(lattice, fh.Diffusion(fh.Kernel(3 * SPACING, 1)), fh.PlaneWave(layer=SPACING))
    assert sim.closure.halo.sum() == 2
    assert sim.engine.absent.count == 2 * (2 + 1)
    whole = fh.Simulation(lattice, fh.Diffusion(fh.Kernel(3 * SPACING, 1)), fh.PlaneWave())
    assert whole.closure.halo.sum() == 6 and whole.engine.absent.count == 0


def test_balance_through_an_outline():
    """What leaves a window through its outline is what the near field loses."""
    lattice = fh.Lattice(SPACING, window=fh.Disc(2.0))
    sim = fh.Simulation(
        lattice,
        fh.Diffusion(fh.Kernel(2 * SPACING, 1)),
        fh.PlaneWave(),
        {"u": lambda x, y: np.exp(-4 * (x**2 + y**2))},
        balance=True,
    )
    sim.run(2.0, progress=False)
    found = sim.balance()
    assert found["outline"] < -0.1 * abs(found["stored"])
    assert abs(found["residual"]) < 1e-12 * abs(found["stored"])


def test_case_file(tmp_path):
    from farhorizon.case.case import Case

    text = """
        [lattice]
        spacing = 0.25
        window = { disc = { radius = 5.0 } }
        [model]
        type = "wave"
        kernel = { horizon = 0.75 }
        [initial]
        u = "exp(-2*(x**2 + y**2))"
        [boundary]
        all = { type = "%s" }
        [run]
        until = 1.0
        dt = 0.05
    """
    for name, boundary in (
        ("plane-wave", fh.PlaneWave()),
        ('higdon", angles = [0.0, 45.0], shift = 0.02, type = "higdon', fh.Higdon(shift=0.02)),
    ):
        line = (
            text % name
            if "shift" not in name
            else text.replace('type = "%s"', 'type = "higdon", angles = [0.0, 45.0], shift = 0.02')
        )
        sim = Case(line).simulation()
        assert set(sim.sides.values()) == {boundary}
    with pytest.raises(fh.InputError, match="did you mean 'wavenumber'"):
        Case(text.replace('type = "%s"', 'type = "plane-wave", wavenumbr = 1.0'))


def test_check_says_what_closes_the_outline():
    """And leaves the run as it is, including the memory of the condition."""
    sim, other = disc(fh.PlaneWave()), disc(fh.PlaneWave())
    text = sim.check(until=10.0).details
    assert "halo nodes from" in text and "PlaneWave()" in text and "stability" in text
    for run in (sim, other):
        run.step(50)
    assert np.array_equal(sim.fields["u"], other.fields["u"], equal_nan=True)


REFUSED = [
    ({"boundary": {"x": fh.Higdon(), "y": fh.LatticePML()}}, "cannot be combined"),
    ({"boundary": {"x": fh.PlaneWave(layer=0.5), "y": fh.Higdon()}}, "need the same layer"),
    ({"cracks": [[(3.0, 0.0), (4.9, 0.0)]]}, "crack cuts bonds of nodes"),
    ({"coefficient": np.where(np.arange(41) > 38, 1.1, 1.0)[:, None] * np.ones(41)}, "material varies"),
    ({"constraints": [fh.Prescribed([(4.75, 0.0)], 1.0)]}, "constraint holds"),
    ({"model": fh.Diffusion(KERNEL)}, "for waves"),
    ({"model": fh.Diffusion(KERNEL, integrator="rk4"), "boundary": fh.PlaneWave()}, "one stage"),
    ({"boundary": fh.FirstOrder()}, "classical equations"),
    ({"initial": {"u": lambda x, y: np.exp(-0.05 * (x**2 + y**2))}}, "not zero beyond"),
]


@pytest.mark.parametrize("changes, message", REFUSED)
def test_refused(changes, message):
    setup = {
        "lattice": fh.Lattice(SPACING, (-5.0, -5.0), (5.0, 5.0)),
        "model": fh.Wave(KERNEL),
        "boundary": fh.Higdon(),
        **changes,
    }
    with pytest.raises(fh.InputError, match=message):
        fh.Simulation(**setup)


WINDOWS = [
    (fh.Disc(5.0), {"boundary": {"x": fh.Higdon(), "y": fh.Fixed()}}, "all around"),
    (
        fh.Disc(5.0),
        {"initial": {"u": lambda x, y: np.exp(-8 * ((x - 3.4) ** 2 + (y - 3.4) ** 2))}},
        "not zero beyond the absorbing outline",
    ),
    (fh.Disc(5.0), {"initial": {"u": np.ones((41, 41))}}, "beyond the outline"),
    (fh.Disc(5.0), {"boundary": fh.FirstOrder(), "model": fh.Wave(fh.Stencil.finite_element(2))}, "flat sides"),
    (fh.Disc(0.7), {"boundary": fh.Higdon((0, 0, 0, 0))}, "straight inwards|depend on each other|thinner"),
]


@pytest.mark.parametrize("window, changes, message", WINDOWS)
def test_refused_windows(window, changes, message):
    setup = {
        "lattice": fh.Lattice(SPACING, window=window),
        "model": fh.Wave(KERNEL),
        "boundary": fh.Higdon(),
        **changes,
    }
    with pytest.raises(fh.InputError, match=message):
        fh.Simulation(**setup)


def test_fronts():
    """Rows 0 and 1 read nothing new, 2 reads what 0 gives, 3 what 2 gives; circular dependence is refused."""
    from scipy import sparse

    def update(entries):
        rows, columns = zip(*entries, strict=True)
        return sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=(4, 12))

    rows = np.array([0, 1, 2, 3])
    order, bounds = ordered_fronts(update([(0, 6), (1, 4), (2, 0), (3, 2)]), rows, 6)
    assert bounds.tolist() == [0, 2, 3, 4] and order.tolist() == [0, 1, 2, 3]
    with pytest.raises(fh.InputError, match="depend on each other"):
        ordered_fronts(update([(0, 1), (1, 0)]), rows, 6)


def test_normals_of_other_shapes():
    """The smoothed outline of a polygon has the normals of its edges, to a few degrees away from its corners."""
    points = [(-4.0, -4.0), (4.0, -4.0), (4.0, 4.0), (-4.0, 4.0)]
    near = np.zeros((41, 41), bool)
    near[4:37, 4:37] = True
    outline = Outline(
        np.full(2, -5.0),
        0.25,
        near,
        fh.Polygon(points),
        {(0, 1): fh.Higdon()},
        frozenset(),
        frozenset(),
        KERNEL_OFFSETS,
    )
    fringe = OutlineNodes(outline, outline.halo(), 0.5)
    right = fringe.filled[(fringe.points[fringe.filled][:, 0] > 4) & (np.abs(fringe.points[fringe.filled][:, 1]) < 2)]
    assert (fringe.normals[right][:, 0] > np.cos(np.radians(5))).all()
    assert (fringe.axes[right] == [1, 0]).all()


KERNEL_OFFSETS = fh.Stencil.from_kernel(KERNEL, SPACING, 2).offsets

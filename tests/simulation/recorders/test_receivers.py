"""Receivers: fields and their gradients between nodes, in every step; saved, pickled and refused."""

import pickle
import warnings

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.cli import main
from farhorizon.geometry.interpolation import interpolation_blocks

POINTS = [(0.13, 0.2), (-1.0, 0.5), (1.7, -0.41)]


def pulse(*at):
    return np.exp(-4 * sum(x**2 for x in at))


def waves(*observe, **more):
    lattice = fh.Lattice(0.25, [-5.0, -4.0], [5.0, 4.0])
    return fh.Simulation(
        lattice, fh.Wave(fh.Kernel(0.5)), fh.LatticePML(nodes=6), {"u": pulse}, observe=observe, **more
    )


def large(*observe):
    """Large enough for two threads."""
    lattice = fh.Lattice(0.1, [-15.0, -10.0], [15.0, 10.0])
    return fh.Simulation(
        lattice, fh.Wave(fh.Kernel(0.2)), fh.LatticePML(nodes=4), {"u": pulse}, threads=2, observe=observe
    )


def bar(*observe):
    return fh.Simulation(
        fh.Lattice(0.25, [-5.0], [5.0]), fh.Wave(fh.Kernel(0.5)), fh.Exact(), {"u": pulse}, observe=observe
    )


def heat(*observe):
    """Four stages, a background, a source."""
    lattice = fh.Lattice(0.25, [-4.0, -4.0], [4.0, 4.0])
    model = fh.Heat(fh.Kernel(0.5), integrator="rk4")
    return fh.Simulation(lattice, model, fh.Free(), {"u": 20.0}, [pulse], background=20.0, observe=observe)


def elastic(*observe, **more):
    lattice = fh.Lattice(0.25, [-4.0, -4.0], [4.0, 4.0])
    material = fh.Elastic(fh.Kernel(0.5, exponent=1), 1.0)
    start = {"u": [lambda x, y: 0.01 * pulse(x, y), 0.0]}
    return fh.Simulation(lattice, material, fh.Sponge(4), start, observe=observe, **more)


def between(run, points, values, **options):
    """Values of a field of a run at points, by a plain sum over the nodes."""
    nodes, weights = interpolation_blocks(run.lattice, points, **options).entries()
    flat = values.reshape(-1, run.lattice.nodes)
    return (flat[:, nodes] * weights).sum(-1).T.squeeze(-1 if len(flat) == 1 else ())


@pytest.mark.parametrize("method", ["sinc", "linear"])
@pytest.mark.parametrize("make", [waves, large, bar, heat, elastic])
def test_what_is_received_is_the_field_between_the_nodes(make, method):
    """After every step, and at the start, as a plain sum over the fields of a run that is stepped one by one; a point
    on a node has the value of that node to the last bit; recording does not change the run.
    """
    dim = 1 if make is bar else 2
    receivers = fh.Receivers(np.array(POINTS)[:, :dim], ["u", "gradient"], interpolation=method)
    run, other, plain = make(receivers), make(), make()
    found, slopes = [], []
    for step in range(20):
        other.step(int(step > 0))
        u = other.fields["u"]
        found.append(between(other, receivers.points, u, method=method))
        slopes.append(
            np.stack([between(other, receivers.points, u, method=method, derivative=a) for a in range(dim)], -1)
        )
    run.step(5)
    run.step(14)
    scale = np.abs(found).max()
    np.testing.assert_allclose(receivers.data["u"], found, rtol=0, atol=1e-13 * scale)
    np.testing.assert_allclose(receivers.data["gradient"], slopes, rtol=0, atol=1e-12 * scale / run.lattice.spacing)
    np.testing.assert_array_equal(receivers.times, run.dt * np.arange(20))
    assert np.ptp(receivers.data["u"]) > 0
    on_node = other.fields["u"][(..., *other.lattice.index(receivers.points[1]))]
    np.testing.assert_array_equal(receivers.data["u"][-1, 1], on_node)
    plain.step(19)
    np.testing.assert_array_equal(run.fields["u"], plain.fields["u"])


@pytest.mark.parametrize("method", ["sinc", "linear"])
@pytest.mark.parametrize(("shape", "threads"), [((61, 33), 1), ((33, 61), 1), ((301, 201), 2)])
def test_all_over_the_near_field_no_point_is_left_out(shape, threads, method):
    """The loop sums a point once it has swept all of its rows, upwards or downwards; also those at the edges."""
    rng = np.random.default_rng(5)
    noise, close = rng.standard_normal(shape), 7 if method == "sinc" else 0
    lattice, low, high = fh.Lattice(1.0, (0, 0), np.array(shape) - 1), close, np.array(shape) - 1.0 - close
    points = rng.uniform(low, high, (300, 2))
    points[:40, 0], points[40:80, 0], points[80:120, 1], points[120:160, 1] = low + 1e-3, high[0] - 1e-3, low, high[1]
    found = []
    for steps in ([7], [1] * 7):  # the last step of a call is summed separately
        receivers = fh.Receivers(points, interpolation=method)
        model = fh.Wave(fh.Kernel(2.0))
        run = fh.Simulation(lattice, model, fh.Fixed(), {"u": noise}, threads=threads, observe=[receivers])
        for count in steps:
            run.step(count)
        found.append(receivers.data["u"])
    np.testing.assert_array_equal(*found)
    assert np.ptp(found[0], axis=0).all()


def test_in_single_precision_receivers_follow_the_fields():
    """As sums over the fields to the rounding of float32; a point on a node has the value of that node."""
    receivers = fh.Receivers([*POINTS, (0.5, 0.25)], interpolation="sinc")
    run = waves(receivers, dtype="float32")
    run.step(7)
    u = run.fields["u"].astype(float)
    assert np.abs(u).max() > 0.1
    np.testing.assert_allclose(receivers.data["u"][-1], between(run, receivers.points, u), rtol=0, atol=1e-6)
    assert receivers.data["u"][-1, -1] == u[run.lattice.index((0.5, 0.25))]


def test_velocity_is_that_of_the_fields():
    """With its lag of half a step, also at the start."""
    receivers = fh.Receivers(POINTS, "v")
    run, other = elastic(receivers), elastic()
    found = [between(other, receivers.points, other.fields["v"])]
    for _ in range(6):
        other.step()
        found.append(between(other, receivers.points, other.fields["v"]))
    run.step(6)
    np.testing.assert_allclose(receivers.data["v"], found, rtol=0, atol=1e-12 * np.abs(found).max())


def test_every_so_many_steps():
    """The rows are those of the steps that are multiples of `every`; the velocity is that of a single step."""
    often, seldom = fh.Receivers(POINTS, ["u", "v"], name="often"), fh.Receivers(POINTS, ["u", "v"], every=3)
    run = waves(often, seldom)
    for count in (1, 1, 5, 4):
        run.step(count)
    for name in ("u", "v"):
        np.testing.assert_array_equal(seldom.data[name], often.data[name][::3])
    np.testing.assert_array_equal(seldom.times, often.times[::3])


@pytest.mark.filterwarnings("ignore::farhorizon.ValidityWarning")
def test_only_the_steps_that_are_wanted_are_looked_at():
    """Rows of other steps are not filled; with velocities or probes, every step is needed."""
    seldom, plain = fh.Receivers(POINTS, every=4), fh.Receivers(POINTS)
    run, other = waves(seldom), waves(plain)
    for one in (run, other):
        for count in (3, 6, 8):
            one.step(count)
    assert run.engine.watch_stride == 4 and other.engine.watch_stride == 1
    np.testing.assert_array_equal(seldom.data["u"], plain.data["u"][::4])
    assert waves(fh.Receivers(POINTS, "v", every=4)).engine.watch_stride == 1
    assert waves(seldom, fh.Receivers(POINTS, every=6, name="more")).engine.watch_stride == 2
    run.record([(0.0, 0.0)])
    assert run.engine.watch_stride == 1


def displacement(x, y, z=0.0):
    return [np.sin(x + 0.3 * y) + 0.2 * z, 0.5 * np.cos(x - 0.7 * y) * np.cos(0.4 * z), 0.1 * x * z + np.sin(0.6 * y)]


def displacement_gradient(x, y, z=0.0):
    """Gradient of `displacement`, component first."""
    one = np.ones_like(x)
    return np.array(
        [
            [np.cos(x + 0.3 * y), 0.3 * np.cos(x + 0.3 * y), 0.2 * one],
            [
                -0.5 * np.sin(x - 0.7 * y) * np.cos(0.4 * z),
                0.35 * np.sin(x - 0.7 * y) * np.cos(0.4 * z),
                -0.2 * np.cos(x - 0.7 * y) * np.sin(0.4 * z),
            ],
            [0.1 * z, 0.6 * np.cos(0.6 * y), 0.1 * x],
        ]
    )


MECHANICAL = ["strain", "stress", "pressure", "divergence", "curl", "rotation"]


def closed(gradient, lame, shear):
    """Return the quantities that follow from a gradient, by their textbook formulas."""
    dim = len(gradient)
    strain = (gradient + gradient.T) / 2
    stress = lame * np.trace(gradient) * np.eye(dim) + 2 * shear * strain
    turn = gradient.T - gradient
    curl = turn[0, 1] if dim == 2 else np.array([turn[1, 2], turn[2, 0], turn[0, 1]])
    found = (strain, stress, -np.trace(stress) / dim, np.trace(gradient), curl, curl / 2)
    return dict(zip(MECHANICAL, found, strict=True))


@pytest.mark.parametrize("dim", [2, 3])
def test_strain_and_stress_of_a_given_displacement(dim):
    """At the start: linear interpolation is of second order; the sinc is accurate on the coarse lattice already."""
    errors, spacings = [], (0.5, 0.25, 0.125) if dim == 2 else (0.5, 0.25)
    points = np.random.default_rng(7).uniform(-0.9, 0.9, (60, dim))
    for spacing in spacings:
        lattice = fh.Lattice(spacing, [-4.5 if dim == 2 else -2.0] * dim, [4.5 if dim == 2 else 2.0] * dim)
        material = fh.Elastic(fh.Kernel(2 * spacing, exponent=1), young=3.0)
        given = {"u": [lambda *at, i=i: displacement(*at)[i] for i in range(dim)]}
        linear = fh.Receivers(points, MECHANICAL, interpolation="linear", name="linear")
        sinc = fh.Receivers(points, MECHANICAL)
        fh.Simulation(lattice, material, fh.Free(), given, observe=[linear, sinc][: 1 + (dim == 2)])
        exact = [closed(displacement_gradient(*p)[:dim, :dim], material.lame, material.shear) for p in points]
        wanted = {name: np.array([one[name] for one in exact]) for name in MECHANICAL}
        errors.append([np.abs(linear.data[name][0] - wanted[name]).mean() for name in MECHANICAL])
        for name in MECHANICAL if dim == 2 else ():
            np.testing.assert_allclose(sinc.data[name][0], wanted[name], rtol=0, atol=2e-4 * np.abs(wanted[name]).max())
    rates = np.polyfit(np.log(spacings), np.log(errors), 1)[0]
    assert np.all(np.abs(rates - 2) < 0.25), rates


def test_energy_flux_of_plane_waves():
    """A long wave along x carries its energy density at its speed, ``rho c omega^2 cos^2``, and none across."""
    length, dx = 16.0, 0.25
    k = 2 * np.pi / length
    lattice = fh.Lattice(dx, (0.0, 0.0), (length - dx, 5.0))
    sides = fh.Periodic()
    for model, parts in (
        (fh.Wave(fh.Kernel(2 * dx), speed=2.0), 1),
        (fh.Elastic(fh.Kernel(2 * dx, exponent=1), young=4.0, density=0.5), 2),
    ):
        speed = 2.0 if parts == 1 else model.p_speed
        mass = 1.0 if parts == 1 else model.density

        def moving(x, y, speed=speed):
            return -k * speed * np.cos(k * x) + 0 * y

        start = {"u": lambda x, y: np.sin(k * x) + 0 * y, "v": moving}
        if parts == 2:
            start = {name: [value, 0.0] for name, value in start.items()}
        receivers = fh.Receivers([(3.13, 2.6), (5.9, 2.6)], "energy_flux")
        run = fh.Simulation(lattice, model, sides, start, observe=[receivers])
        run.step(60)
        t = receivers.times[1:, None] - run.dt / 2
        exact = mass * speed * (speed * k * np.cos(k * (receivers.points[:, 0] - speed * t))) ** 2
        largest = exact.max()
        # the lattice's dispersion over so short a run, (k dx)^2, and the interpolation
        np.testing.assert_allclose(receivers.data["energy_flux"][1:, :, 0], exact, atol=2e-2 * largest)
        np.testing.assert_allclose(receivers.data["energy_flux"][..., 1], 0, atol=1e-4 * largest)


def test_stress_where_the_material_changes():
    """The moduli are those of the nearest node."""
    inside = lambda x, y: np.where(x < 0.4, 1.0, 0.25)  # noqa: E731
    receivers = fh.Receivers([(0.2, 0.1), (0.7, 0.1)], ["strain", "stress"], interpolation="linear")
    run = elastic(receivers, coefficient=inside)
    run.step(3)
    for number, factor in enumerate((1.0, 0.25)):
        e = receivers.data["strain"][:, number]
        wanted = factor * (run.model.lame * np.trace(e, axis1=1, axis2=2)[:, None, None] * np.eye(2))
        np.testing.assert_allclose(receivers.data["stress"][:, number], wanted + 2 * factor * run.model.shear * e)


def everything():
    return fh.Receivers(POINTS, ["u", "v", "stress", "energy_flux"], every=2)


def test_saved_and_taken_up_the_records_are_the_same_bit_by_bit(tmp_path):
    """Saved at an odd step, restored with new receivers; those that the checkpoint does not contain begin there."""
    whole, first, second, later = (everything() for _ in range(4))
    elastic(whole).step(31)
    run = elastic(first)
    run.step(13)
    run.save(tmp_path / "state")
    later.name = "later"
    again = fh.Simulation.restore(tmp_path / "state", observe=[second, later])
    again.step(18)
    for name in whole.record:
        np.testing.assert_array_equal(second.data[name], whole.data[name])
        np.testing.assert_allclose(later.data[name], whole.data[name][7:], rtol=1e-12, atol=1e-14)
    np.testing.assert_array_equal(second.times, whole.times)
    np.testing.assert_array_equal(later.times, whole.times[7:])
    with pytest.raises(fh.FileFormatError, match="recorded something else"):
        fh.Simulation.restore(tmp_path / "state", observe=[fh.Receivers(POINTS, "u")])


def test_pickled_runs_go_on_recording():
    """With what they have recorded so far."""
    receivers = everything()
    run = elastic(receivers)
    run.step(5)
    copy = pickle.loads(pickle.dumps(run))
    for one in (run, copy):
        one.step(8)
    for name in receivers.record:
        np.testing.assert_array_equal(copy.recorders[0].data[name], receivers.data[name])


def test_a_run_that_settles_its_sides_records_from_its_start():
    """The sides are chosen once the length of the run is known."""
    receivers = fh.Receivers(POINTS)
    lattice = fh.Lattice(0.25, [-5.0, -4.0], [5.0, 4.0])
    run = fh.Simulation(lattice, fh.Wave(fh.Kernel(0.5)), fh.Extended(), {"u": pulse}, observe=[receivers])
    run.run(until=3.0)
    plain = waves(other := fh.Receivers(POINTS))
    plain.run(until=3.0)
    assert len(receivers.times) == run.step_count + 1
    np.testing.assert_allclose(receivers.data["u"], other.data["u"], atol=1e-4)


def test_given_to_another_run_receivers_forget():
    receivers = fh.Receivers(POINTS)
    waves(receivers).step(5)
    heat(receivers).step(2)
    assert receivers.data["u"].shape == (3, 3) and receivers.data["u"].min() > 19


def test_what_is_forgotten_is_gone():
    receivers = fh.Receivers(POINTS)
    run = waves(receivers)
    run.step(5)
    kept = receivers.recorded
    receivers.forget()
    assert len(kept.times) == len(kept.data["u"]) == 6 and len(receivers.times) == len(receivers.data["u"]) == 0
    run.step(2)
    assert len(receivers.times) == len(receivers.data["u"]) == 2


def test_lines_and_grids():
    line = fh.Receivers.line((0.0, 1.0), (3.0, -1.0), 4, record="v", every=2)
    np.testing.assert_allclose(line.points, [(0, 1), (1, 1 / 3), (2, -1 / 3), (3, -1)])
    assert line.record == ("v",) and line.every == 2
    grid = fh.Receivers.grid((0.0, 1.0), (1.0, 3.0), (2, 3))
    np.testing.assert_allclose(grid.points, [(0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (1, 3)])
    assert fh.Receivers.line(-1.0, 1.0, 3).points.shape == (3, 1)
    for wrong in (
        lambda: fh.Receivers.line((0.0, 1.0), 3.0, 4),
        lambda: fh.Receivers.grid((0.0, 1.0), (1.0, 3.0), (2,)),
        lambda: fh.Receivers.grid((0.0, 1.0), (1.0, 3.0), (2, 0)),
    ):
        with pytest.raises(fh.InputError):
            wrong()


def test_what_is_sampled_too_seldom_is_told():
    """Half the stable step turns the fastest wave of the lattice by 60 degrees: three steps resolve it, four do not."""
    told = fh.Receivers(POINTS, every=4)
    with pytest.warns(fh.ValidityWarning, match="every = 3 or less") as found:
        run = waves(told, fh.Receivers(POINTS, every=3, name="fine"))
    (warning,) = found
    assert warning.filename == __file__ and told.doubts == [str(warning.message)]
    assert told.doubts[0] in run.check(until=1.0, budget=0.1).warnings
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run.remade(dt=run.dt)  # no second warning
        heat(fh.Receivers(POINTS, every=50))


def test_a_case_that_samples_too_seldom_is_told(tmp_path, capsys):
    """By `check` among its warnings, and when it runs."""
    case = tmp_path / "case.toml"
    text = """[lattice]\nspacing = 1.0\nlower = [-9.0, -9.0]\nupper = [9.0, 9.0]
        [model]\ntype = "wave"\n[model.kernel]\nhorizon = 2.0
        [boundary]\nall = { type = "fixed" }\n[[receivers]]\npoints = [[0.0, 0.0]]\nevery = 4\n[run]\nuntil = 2.0"""
    case.write_text("\n".join(line.strip() for line in text.splitlines()))
    assert main(["check", str(case), "--budget", "0.1"]) == 0
    out, err = capsys.readouterr()
    assert "every = 3 or less" in out and "warning: receivers are recorded every 4 steps" in out
    assert main(["run", str(case), "--no-report", "--out", str(tmp_path)]) == 0
    out, err = capsys.readouterr()
    assert err.count("warning: receivers are recorded every 4 steps") == 1


CRACK = [[(0.4, -9.0), (0.4, 9.0)]]
HOLE = fh.Box((-5.0, -4.0), (5.0, 4.0)) - fh.Disc(0.6)


@pytest.mark.parametrize(
    ("points", "options", "more", "message"),
    [
        ([(5.3, 0.0)], {}, {}, "outside the near field"),
        ([(4.9, 0.0), (0.0, 0.0)], {}, {}, "'linear'"),
        ([(0.3, 0.0)], {}, {"cracks": CRACK}, "crack"),
        ([(0.3, 0.0)], {"interpolation": "linear"}, {"cracks": CRACK}, "crack"),
        ([(0.0, 0.0)], {"record": "stress"}, {}, "Wave has no such quantity"),
        ([(0.0, 0.0, 0.0)], {}, {}, "shape"),
        (np.zeros((0, 2)), {}, {}, "no point"),
    ],
)
def test_refused_by_the_run(points, options, more, message):
    """The error has the key of the receivers."""
    with pytest.raises(fh.InputError, match=message) as error:
        waves(fh.Receivers(points, **options), **more)
    assert error.value.key.startswith("receivers")


def test_beside_a_crack_and_a_hole():
    """Linear interpolation from nodes on one side, and points on nodes, are accepted."""
    near = fh.Receivers([(0.3, 0.1)], interpolation="linear", name="near")
    waves(near, fh.Receivers([(0.5, 0.0), (0.25, 0.25)]), cracks=[[(0.6, -9.0), (0.6, 9.0)]]).step(3)
    assert np.isfinite(near.data["u"]).all()
    lattice = fh.Lattice(0.25, [-5.0, -4.0], [5.0, 4.0], body=HOLE)
    given = lattice, fh.Wave(fh.Kernel(0.5)), fh.Free(), {"u": lambda x, y: pulse(x - 2, y)}
    for points, message in (([(0.1, 0.0)], "outside the near field"), ([(0.7, 0.1)], "'linear'")):
        with pytest.raises(fh.InputError, match=message):
            fh.Simulation(*given, observe=[fh.Receivers(points)])
    on_nodes = fh.Receivers([(0.75, 0.0), (5.0, 4.0)])
    fh.Simulation(*given, observe=[on_nodes]).step(2)
    assert np.isfinite(on_nodes.data["u"]).all()


def test_other_things_that_are_refused():
    with pytest.raises(fh.InputError, match="one name"):
        waves(fh.Receivers(POINTS), fh.Receivers(POINTS))
    with pytest.raises(fh.InputError, match="unknown quantity"):
        fh.Receivers(POINTS, ["u", "w"])
    with pytest.raises(fh.InputError, match="letters"):
        fh.Receivers(POINTS, name="a/b")
    with pytest.raises(fh.InputError, match="nothing"):
        fh.Receivers(POINTS, [])
    with pytest.raises(fh.InputError, match="no such quantity"):
        heat(fh.Receivers(POINTS, "v"))
    beam = fh.Receivers([0.0], "energy_flux")
    with pytest.raises(fh.InputError, match="no such quantity"):
        fh.Simulation(fh.Lattice(0.1, -2, 2), fh.Beam(), fh.Exact(), {"u": "exp(-8*x**2)"}, observe=[beam])


def drawn_points(count, seed):
    print("seed", seed)
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (count, 2))


def test_reciprocity_of_scalar_waves():
    """The response at one point to a source at another, both between nodes, stays the same when they are exchanged,
    including echoes from edges and from a change of the material. (Layers are reciprocal to within what they
    reflect.)
    """
    lattice = fh.Lattice(0.25, [-4.0, -3.5], [4.0, 3.5])
    points, found = drawn_points(2, 20261122), []
    for here, there in (points, points[::-1]):
        source = fh.PointSource(tuple(here), time=fh.Ricker(0.8))
        receivers = fh.Receivers([there])
        sides = {"x": fh.Free(), "y-": fh.Free(), "y+": fh.Fixed()}
        inside = lambda x, y: np.where(x + y < 0.1, 1.0, 0.3)  # noqa: E731
        model = fh.Wave(fh.Kernel(0.5))
        run = fh.Simulation(lattice, model, sides, sources=[source], coefficient=inside, observe=[receivers])
        run.step(120)
        found.append(receivers.data["u"])
    # both sum the same products in another order
    np.testing.assert_allclose(found[0], found[1], rtol=0, atol=1e-12 * np.abs(found[0]).max())
    assert np.abs(found[0]).max() > 1e-3


def test_reciprocity_of_forces_and_displacements():
    """Component i at one point of a force along j at another is component j of a force along i, points exchanged."""
    lattice = fh.Lattice(0.25, [-4.0, -4.0], [4.0, 4.0])
    points, found = drawn_points(2, 20261123), []
    for here, there, force, component in ((*points, (1.0, 0.0), 1), (*points[::-1], (0.0, 1.0), 0)):
        source = fh.PointForce(tuple(here), force, time=fh.Ricker(0.8))
        receivers = fh.Receivers([there])
        material = fh.Elastic(fh.Kernel(0.5, exponent=1), 1.0)
        fh.Simulation(lattice, material, fh.Sponge(4), sources=[source], observe=[receivers]).step(100)
        found.append(receivers.data["u"][..., component])
    np.testing.assert_allclose(found[0], found[1], rtol=0, atol=1e-12 * np.abs(found[0]).max())
    assert np.abs(found[0]).max() > 1e-4


def two_runs(*lines):
    lattice, model = fh.Lattice(0.5, (-4.0, -4.0), (4.0, 4.0)), fh.Wave(fh.Kernel(1.0))
    start = {"u": "exp(-3*(x**2 + y**2))"}
    return [fh.Simulation(lattice, model, fh.LatticePML(nodes=6), start, observe=[line]) for line in lines]


def test_a_recorder_serves_one_run_at_a_time():
    """A run whose recorder was given to another run does not go on; in the new run, the record starts anew."""
    line = fh.Receivers([(1.0, 0.0)])
    first, second = two_runs(line, line)
    second.step(5)
    with pytest.raises(fh.InputError, match=r"observe: another run has this recorder now; value: receivers; .*own"):
        first.step(5)
    assert len(line.times) == 6


@pytest.mark.parametrize(
    ("make", "differs"),
    [
        (lambda point: fh.Receivers([point]), "points"),
        (lambda point: fh.Receivers([(1.0, 0.0)], every=1 + (point[0] < 0)), "every"),
        (lambda point: fh.Spectra([(1.0, 0.0)], [0.1 - 0.01 * point[0]]), "frequencies"),
        (
            lambda point: fh.FarField(fh.Box((-2.0, -2.0), (2.0, 2.0)), frequencies=[0.1 - 0.01 * point[0]]),
            "frequencies",
        ),
    ],
)
def test_a_run_does_not_go_on_with_what_was_recorded_elsewhere(tmp_path, make, differs):
    first, same, other = two_runs(make((1.0, 0.0)), make((1.0, 0.0)), make((-2.0, 0.5)))
    first.step(5)
    first.save(tmp_path / "state")
    same.load(tmp_path / "state")
    with pytest.raises(fh.FileFormatError, match=f"recorded something else under this name; .*limit: same {differs}"):
        other.load(tmp_path / "state")

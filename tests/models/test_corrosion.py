"""Corrosion: phases against plain numpy, the Stefan problem, conserved quantities, the layer beside dissolving metal,
restarts, refusals.
"""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import erfc

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.engine.codegen.stencil_sweeps import TILE, TILE_ROWS
from farhorizon.engine.features.phases import count_solid
from farhorizon.studies.compare import compare
from helpers import kernel_stencil, lattice_of

SATURATION, INTERFACE, METAL = 0.8, 0.1, 2.0
pytestmark = pytest.mark.filterwarnings("ignore::farhorizon.ValidityWarning")  # about liquid above the saturation
SKEWED = fh.Stencil(
    np.array([[1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1], [2, 1], [-2, -1]]),
    np.array([1, 1, 0.6, 0.6, 0.4, 0.4, 0.05, 0.05]),
)
#: Stencil and lattice. The wide stencil has no compiled rows, the skewed one no mirror symmetry, and rows span several
#: tiles.
LATTICES = {
    "1D": (kernel_stencil(1, 2), (90,)),
    "2D": (kernel_stencil(2, 2), (23, 75)),
    "3D": (kernel_stencil(3, 1), (9, 11, 70)),
    "skewed": (SKEWED, (21, 40)),
    "wide": (kernel_stencil(2, 8), (21, 70)),
}
SIDES = {"periodic": fh.Periodic(), "fixed": fh.Fixed(0.0), "free": fh.Free()}


def model(stencil, **options):
    """Corrosion with the constants of the tests."""
    return fh.Corrosion(stencil, **{"saturation": SATURATION, "interface": INTERFACE, **options})


def plain(u, solid, stencil, dt, steps, sides, body=None, limited=False):
    """Forward Euler bond by bond on padded arrays; solid nodes below the saturation become liquid after each step."""
    body = np.ones(u.shape, bool) if body is None else body
    u, solid, reach = u.copy(), solid.copy(), max(stencil.reach)
    dissolved = np.where(solid, np.nan, 0.0)
    for step in range(1, steps + 1):
        wide, hard = (np.pad(a, reach, mode="wrap") if sides == "periodic" else np.pad(a, reach) for a in (u, solid))
        there = np.pad(body, reach) if sides == "free" else np.pad(body, reach, mode="edge")
        change = np.zeros(u.shape)
        for offset, weight in zip(stencil.offsets, stencil.weights, strict=True):
            at = tuple(slice(reach + o, reach + o + n) for o, n in zip(offset, u.shape, strict=True))
            factor = np.where(solid & hard[at], 0.0, np.where(solid ^ hard[at], INTERFACE, 1.0))
            gap = wide[at] - u
            if limited:
                gap = np.where(solid ^ hard[at], np.minimum(wide[at], SATURATION) - np.minimum(u, SATURATION), gap)
            change += weight * factor * (body & there[at]) * gap
        u += dt * change
        new = solid & (u < SATURATION)
        solid &= ~new
        dissolved[new] = step * dt
    return u, solid, dissolved


@pytest.mark.sampled(5)
@pytest.mark.parametrize("limited", [False, True])
@pytest.mark.parametrize("sides", SIDES)
@pytest.mark.parametrize("name", LATTICES)
def test_against_plain_numpy(name, sides, limited):
    """For every kind of tile, row and side the same nodes dissolve at the same steps."""
    stencil, shape = LATTICES[name]
    random = np.random.default_rng(3)
    solid = random.random(shape) < 0.3
    solid[..., 10:50] = True
    solid[..., 20:25] = False
    start = {"u": 0.1 * random.random(shape)}
    start["u"][..., 21:23] = 1.5 * SATURATION  # must not flow back into the metal where dissolution is limited
    sim = fh.Simulation(
        lattice_of(shape), model(stencil, limited=limited), SIDES[sides], start, specimens=[fh.Specimen(solid, METAL)]
    )
    u, left = sim.fields["u"], []
    for steps in (1, 20, 120):
        sim.step(steps - sim.step_count)
        expected, hard, dissolved = plain(u, solid, stencil, sim.dt, steps, sides, limited=limited)
        np.testing.assert_allclose(sim.fields["u"], expected, rtol=0, atol=1e-13)
        np.testing.assert_array_equal(sim.fields["solid"], hard)
        np.testing.assert_allclose(sim.fields["dissolved"], dissolved, rtol=1e-12)
        left.append(hard.sum())
    assert any(0 < n < solid.sum() for n in left)
    check_counts(sim)


@pytest.mark.parametrize("limited", [False, True])
@pytest.mark.parametrize("sides", ["free", "fixed"])
def test_a_body_with_a_hole_against_plain_numpy(sides, limited):
    """Metal and liquid beside a hole have no bonds to missing nodes, before and after they dissolve."""
    stencil, shape = LATTICES["2D"]
    body = fh.Box((-9.0, -9.0), (99.0, 99.0)) - fh.Disc(5.3, (10.2, 41.4))
    lattice = fh.Lattice(1.0, (0.0, 0.0), np.array(shape) - 1.0, body=body)
    random = np.random.default_rng(6)
    solid = (random.random(shape) < 0.3) & lattice.mask
    solid[:, 38:50] |= lattice.mask[:, 38:50]
    start = lattice.mask * 0.1 * random.random(shape)
    metal = [fh.Specimen(solid, METAL)]
    sim = fh.Simulation(
        lattice, model(stencil, limited=limited), SIDES[sides], {"u": start}, specimens=metal, balance=True
    )
    u = np.where(solid, METAL, start)
    for steps in (1, 40, 200):
        sim.step(steps - sim.step_count)
        expected, hard, _ = plain(u, solid, stencil, sim.dt, steps, sides, lattice.mask, limited)
        np.testing.assert_allclose(sim.fields["u"][lattice.mask], expected[lattice.mask], rtol=0, atol=1e-13)
        np.testing.assert_array_equal(sim.fields["solid"][lattice.mask], hard[lattice.mask])
    assert 0 < hard.sum() < solid.sum()
    found = sim.balance()
    assert found["stored"] == pytest.approx((expected - u)[lattice.mask].sum(), abs=1e-10)
    assert abs(found["residual"]) < 1e-10


def check_counts(sim):
    """Counts and runs of the tiles equal those of a new classification."""
    engine = sim.engine
    phases = engine.tables.phases
    solids, volumes, changed, runs = phases.solids, phases.volumes, phases.changed, phases.runs
    solid = engine.layout.box.all(engine.tables.material.coefficient) < 0
    anew = count_solid(solid, engine.layout.reach, (1, TILE_ROWS, TILE))
    np.testing.assert_array_equal(solids, anew[0])
    np.testing.assert_array_equal(volumes, anew[1])
    assert not changed.any()
    for row, kinds in zip(runs, np.sign(solids) + (solids == volumes), strict=True):
        last = list(row[:, 1]).index(len(kinds))
        np.testing.assert_array_equal(np.repeat(row[: last + 1, 0], np.diff(row[: last + 1, 1], prepend=0)), kinds)


OTHER = [
    pytest.param({"threads": 2}, id="two threads"),
    pytest.param({"dtype": "float32"}, id="single", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("options", OTHER)
def test_threads_and_precision(options):
    """Two threads agree bitwise with one; single precision is close."""
    stencil, shape = kernel_stencil(2, 2), (210, 200)  # more nodes than the engine leaves to one thread
    solid = np.random.default_rng(3).random(shape) < 0.4
    solid[60:150, 60:150] = True
    runs = [
        fh.Simulation(
            lattice_of(shape), model(stencil), fh.Periodic(), specimens=[fh.Specimen(solid, METAL)], dt=0.05, **options
        )
        for options in ({"threads": 1}, options)
    ]
    for sim in runs:
        sim.step(60)
    early = runs[0].fields["solid"] != runs[1].fields["solid"]
    if "threads" in options:
        assert np.array_equal(runs[0].fields["u"], runs[1].fields["u"]) and not early.any()
        check_counts(runs[1])
        return
    # 60 steps with a rounding of 6e-8 of 2 each; a node may dissolve a step earlier
    assert early.mean() < 1e-3
    np.testing.assert_allclose(runs[1].fields["u"][~early], runs[0].fields["u"][~early], rtol=0, atol=2e-4)


@pytest.mark.parametrize("integrator", ["euler", "rk4", "rkc"])
@pytest.mark.parametrize("name", LATTICES)
def test_all_liquid_is_diffusion(name, integrator):
    """Results agree bitwise where there are compiled rows, otherwise to rounding."""
    stencil, shape = LATTICES[name]
    start = {"u": np.random.default_rng(1).random(shape)}
    runs = [
        fh.Simulation(lattice_of(shape), m, fh.LatticePML(nodes=8), start)
        for m in (model(stencil, integrator=integrator), fh.Diffusion(stencil, integrator=integrator))
    ]
    for sim in runs:
        sim.step(20)
    np.testing.assert_allclose(
        *[sim.fields["u"] for sim in runs], rtol=0, atol=1e-14 if name in ("skewed", "wide") else 0
    )


@pytest.mark.parametrize("integrator", ["euler", "rk4", "rkc"])
def test_all_solid_stays(integrator):
    """Nothing flows in the solid, not even to rounding."""
    shape = (20, 70)
    sim = fh.Simulation(
        lattice_of(shape),
        model(kernel_stencil(2, 2), integrator=integrator),
        fh.Free(),
        specimens=[fh.Specimen(np.ones(shape, bool), METAL)],
    )
    sim.step(50)
    np.testing.assert_allclose(sim.fields["u"], METAL, rtol=1e-12)  # at free sides the sum of levels in a stage rounds
    assert (sim.fields["u"][8:12, 32:64] == METAL).all()  # out of reach of any liquid there is no rounding either
    assert sim.fields["solid"].all()


# The Stefan problem


def front_error(horizon, metal=1.0, depth=2.56, limited=False):
    """Relative error of the front of a half-infinite bar that dissolves from x = 0 into a half-infinite liquid, mean
    over t = 1/2 to 1.

    In the Stefan problem the front is at -2 p sqrt(t), where (metal - saturation) times its speed equals the flux that
    diffuses away from the saturated liquid. The front of the run is where the remaining metal would end.
    """
    p = brentq(lambda p: np.sqrt(np.pi) * p * np.exp(p**2) * erfc(-p) - SATURATION / (metal - SATURATION), 0.01, 5)
    spacing, errors = horizon / 2, []
    lattice = fh.Lattice(spacing, -depth + spacing / 2, 0.64 - spacing / 2)
    sim = fh.Simulation(
        lattice,
        model(fh.Kernel(horizon), interface=1.0, limited=limited),
        {"x-": fh.Free(), "x+": fh.LatticePML()},
        specimens=[fh.Specimen(fh.Box(-depth, 0.0), metal)],
    )
    for t in np.linspace(0.5, 1.0, 60):
        sim.run(t, progress=False)
        left = sim.fields["u"][sim.fields["solid"] > 0].sum() * spacing / metal
        errors.append((depth - left) / (2 * p * np.sqrt(sim.time)) - 1)
        assert not limited or sim.fields["u"][sim.fields["solid"] == 0].max() <= SATURATION * (1 + 1e-12)
    return np.mean(errors)


def test_the_front_tends_to_that_of_the_stefan_problem():
    """Metal dissolves node by node, in pulses of (metal - saturation) spacing. They raise the concentration at the
    front like the root of the spacing, whereas bonds across it have an effect linear in the spacing. Without both
    terms the front is exact to half a percent.
    """
    horizons = np.array([0.04, 0.02, 0.01])
    errors = np.array([front_error(h) for h in horizons])
    assert (np.diff(errors) < 0).all() and errors[-1] < 0.03
    limit, pulses, _ = np.linalg.solve(np.stack([np.ones(3), np.sqrt(horizons), horizons], axis=1), errors)
    assert abs(limit) < 0.005
    assert pulses > 0


@pytest.mark.parametrize("metal, depth", [(1.0, 2.56), (4.0, 0.64), (12.0, 0.64)])
def test_a_limited_front_is_that_of_diffusion_control(metal, depth):
    """No liquid exceeds the saturation, whatever the metal holds, and the front is that of the Stefan problem. Without
    the limit, metal of 15 times the saturation makes the front a fifth too fast, which a warning says.
    """
    errors = np.array([front_error(h, metal, depth, limited=True) for h in (0.02, 0.01)])
    assert abs(errors[1]) < 0.005 and abs(errors[1]) < 0.6 * abs(errors[0])  # of first order in the horizon
    if metal > 10:
        with pytest.warns(fh.ValidityWarning, match="times the saturation"):
            assert front_error(0.01, metal, depth) > 0.15


def test_a_limit_that_long_stages_overshoot_is_told_with_what_keeps_it():
    """Stages of Runge-Kutta-Chebyshev exceed a step of Euler's, within which the limit holds: steel in a pit."""
    steel = fh.Corrosion(fh.Kernel(4e-6), 8.5e-10, saturation=5.1e3, interface=1.0, limited=True, integrator="rkc")
    setup = {
        "lattice": fh.Lattice(2e-6, -399e-6, 3e-6),
        "model": steel,
        "boundary": {"x-": fh.Free(), "x+": fh.Fixed(0.0)},
        "specimens": [fh.Specimen(fh.Box(-400e-6, 0.0), 143e3)],
    }
    sim = fh.Simulation(**setup, dt=0.5 * fh.Simulation(**setup).step_limit)
    with pytest.warns(fh.ValidityWarning, match="integrator = 'euler' or a smaller step"):
        for t in np.arange(3.75, 40.0, 3.75):
            sim.run(t, progress=False)


# The speed of a front


def test_speeds_of_fronts_under_activation_control():
    """Random constants: fronts recede layer by layer into liquid that is renewed at once; `interface_for` gives the
    requested speed.
    """
    seed = 77
    rng = np.random.default_rng(seed)
    for limited in (False, True):
        for reach in (1, 3):
            diffusivity, spacing, saturation = 10.0 ** rng.uniform([-3, -6, -2], [3, 2, 4])
            metal, speed = saturation / rng.uniform(0.2, 0.7), 1e-4 * diffusivity / spacing
            kernel, options = fh.Kernel(reach * spacing), {"saturation": saturation, "limited": limited}
            interface = fh.Corrosion(kernel, diffusivity, interface=0.3, **options).interface_for(
                speed, spacing, 1, metal
            )
            corroding = fh.Corrosion(kernel, diffusivity, interface=interface, **options)
            assert corroding.speed(spacing, 1, metal) == pytest.approx(speed, rel=1e-12), seed
            lattice = fh.Lattice(spacing, [-24 * spacing], [4 * spacing])
            solid = fh.Specimen(lattice.axes[0] < 0.5 * spacing, metal)
            sim = fh.Simulation(lattice, corroding, {"x-": fh.Free(), "x+": fh.Fixed(0.0)}, specimens=[solid])
            sim.run(12.5 * spacing / speed, progress=False)
            times = np.sort(sim.fields["dissolved"][sim.fields["dissolved"] > 0])
            assert spacing / np.diff(times)[4:].mean() == pytest.approx(speed, rel=0.02), seed


def test_currents():
    """1 A/m^2 of iron (two electrons, 141 000 mol/m^3) removes 1.16 mm a year."""
    assert fh.speed_of_current(1.0, 141_000.0, 2) * 365.25 * 86400 == pytest.approx(1.16e-3, rel=2e-3)
    for bad in ({"metal": 0.5}, {"far": 0.9}):
        with pytest.raises(fh.InputError, match="saturation"):
            model(kernel_stencil(1, 2)).speed(**{"spacing": 1.0, "dim": 1, "metal": METAL, "far": 0.0, **bad})


def test_check_tells_the_speed_of_the_front():
    """The report also has the factor that converts a speed to the interface. Supersaturation causes a caution, limited
    dissolution none.
    """
    sim = Case(CASE).simulation()
    facts = dict(sim.check(budget=1.0).rows)
    speed = sim.model.speed(0.25, 2, 2.0)
    assert f"speed {speed:.4g}" in facts["front"] and f"{0.1 / speed:.4g} v" in facts["front"]
    pitting = CASE.replace("concentration = 2.0", "concentration = 22.4")
    runs = [
        Case(pitting.replace("interface = 0.1", f"interface = 0.1\nlimited = {word}")).simulation()
        for word in ("false", "true")
    ]
    with pytest.warns(fh.ValidityWarning, match="times the saturation"):
        runs[0].run(1.0)
    runs[1].run(1.0)
    assert [c.brief for c in runs[0].cautions] == ["supersaturated"] and not runs[1].cautions


# What is conserved


def specimens(dim):
    """A block with a hole, away from the sides."""
    hole = {1: fh.Box(-0.5, 0.5), 2: fh.Disc(1.5), 3: fh.Ball(1.5)}[dim]
    return [fh.Specimen(fh.Box([-3.0] * dim, [3.0] * dim) - hole, METAL)]


def test_only_differences_from_the_background_matter():
    """With all concentrations raised by the same amount the same metal dissolves at the same steps, and the balance is
    that of the metal itself.
    """
    lattice, runs = fh.Lattice(1.0, (-8.0, -8.0), (8.0, 8.0)), []
    for level in (0.0, 0.25):
        metal = fh.Specimen(specimens(2)[0].where, METAL + level)
        corroding = model(kernel_stencil(2, 2), saturation=SATURATION + level)
        runs.append(
            fh.Simulation(
                lattice,
                corroding,
                fh.LatticePML(nodes=8),
                {"u": level},
                background=level,
                specimens=[metal],
                balance=True,
            )
        )
        runs[-1].step(40)
    low, high = (sim.fields for sim in runs)
    np.testing.assert_allclose(high["u"], low["u"] + 0.25, rtol=1e-13)
    assert np.array_equal(high["dissolved"], low["dissolved"], equal_nan=True)
    gone = (high["dissolved"] > 0).sum()
    assert runs[1].balance()["metal"] == pytest.approx(runs[0].balance()["metal"] - 0.25 * gone, rel=1e-12)


@pytest.mark.parametrize("axis, position", [("x", -2.5), ("y", 0.5)])
@pytest.mark.parametrize("limited", [False, True])
def test_power_across_a_plane(axis, position, limited):
    """The flux through a plane across metal, front and liquid equals what the nodes beyond it gain in the next step."""
    lattice = fh.Lattice(1.0, (-8.0, -8.0), (8.0, 8.0))
    sim = fh.Simulation(
        lattice,
        model(kernel_stencil(2, 2), limited=limited),
        fh.Free(),
        specimens=[fh.Specimen(fh.Disc(3.3, (-1.0, 2.0)), METAL)],
    )
    sim.step(20)
    beyond = lattice.coordinates()["xy".index(axis)] > position
    before, power = sim.fields["u"][beyond].sum(), sim.power_across(axis, position)
    sim.step(1)
    assert sim.fields["u"][beyond].sum() - before == pytest.approx(power * sim.dt, rel=1e-10)


def test_exact_ends():
    """A bar that dissolves between exact ends, against one so long that nothing returns."""
    metal = [fh.Specimen(fh.Box(-6.0, 4.0), METAL)]
    runs = [
        fh.Simulation(fh.Lattice(1.0, -n, n), model(kernel_stencil(1, 2)), side, specimens=metal, dt=0.2)
        for n, side in ((10.0, fh.Exact()), (200.0, fh.Fixed(0.0)))
    ]
    for sim in runs:
        sim.step(500)
    assert 0 < runs[0].fields["solid"].sum() < 11
    assert np.abs(runs[0].fields["u"] - runs[1].fields["u"][190:211]).max() < 1e-10


SOME_SIDES = [fh.LatticePML(nodes=8), fh.Sponge(8), fh.Fixed(0.0), fh.Free(), fh.Periodic()]


@pytest.mark.parametrize("limited", [False, True])
@pytest.mark.parametrize(
    "dim, boundary", [*((d, b) for d in (1, 2, 3) for b in SOME_SIDES), (1, fh.Exact()), (1, fh.Exact(None))]
)
def test_mass_balance(dim, boundary, limited):
    """Metal, dissolved matter and outflow add up to the initial amount, to rounding of what has moved."""
    lattice = fh.Lattice(1.0, [-8.0] * dim, [8.0] * dim)
    corroding = model(kernel_stencil(dim, 2), limited=limited, interface=0.1 + 0.4 * limited)
    sim = fh.Simulation(lattice, corroding, boundary, specimens=specimens(dim), balance=True)
    sim.run(60.0, progress=False)
    found = sim.balance()
    start = METAL * specimens(dim)[0].nodes(lattice).sum()
    assert -start <= found["metal"] < -0.3 * start < 0.01 * start < found["dissolved"]
    left = sum(found[side] for side in found if side[0] in "xyz")
    assert abs(found["metal"] + found["dissolved"] - left) < 1e-12 * start
    assert abs(found["residual"]) < 1e-12 * start
    assert (left == 0) if isinstance(boundary, fh.Free | fh.Periodic) else (left < 0)


def test_mass_balance_along_an_outline():
    """A window closed by plane waves; metal within the reach of their clouds is refused."""
    window = fh.Lattice(1.0, window=fh.Disc(9.0))
    sim = fh.Simulation(window, model(kernel_stencil(2, 2)), fh.PlaneWave(), specimens=specimens(2), balance=True)
    sim.run(60.0, progress=False)
    found = sim.balance()
    assert found["metal"] < -10 and found["outline"] < 0
    assert abs(found["residual"]) < 1e-11
    with pytest.raises(fh.InputError, match="reads metal"):
        fh.Simulation(
            window,
            model(kernel_stencil(2, 2)),
            fh.PlaneWave(),
            specimens=[fh.Specimen(fh.Disc(1.2, (5.5, 5.5)), METAL)],
        )


def test_check_leaves_the_metal_alone():
    """The certificate is that of the liquid; neither it nor timing the steps changes phases or times."""
    lattice = fh.Lattice(1.0, (-8.0, -8.0), (8.0, 8.0))
    runs = [
        fh.Simulation(
            lattice, model(kernel_stencil(2, 2)), fh.LatticePML(nodes=8), specimens=specimens(2), balance=True
        )
        for _ in range(2)
    ]
    for sim in runs:
        sim.step(10)
    report = runs[0].check(100.0, budget=5.0)
    assert f"{int(runs[1].fields['solid'].sum())} solid nodes" in dict(report.rows)["metal"]
    assert report.certificate.verdict != "not certified"
    for sim in runs:
        sim.step(20)
    for name, field in runs[1].fields.items():
        assert np.array_equal(runs[0].fields[name], field, equal_nan=True)
    assert runs[0].balance() == runs[1].balance()
    check_counts(runs[0])


@pytest.mark.parametrize("integrator", ["rk4", "rkc"])
def test_mass_balance_of_other_integrators(integrator):
    lattice = fh.Lattice(1.0, (-8.0, -8.0), (8.0, 8.0))
    sim = fh.Simulation(
        lattice,
        model(kernel_stencil(2, 2), integrator=integrator),
        fh.LatticePML(nodes=8),
        specimens=specimens(2),
        balance=True,
    )
    sim.run(60.0, progress=False)
    assert sim.balance()["metal"] < -10
    assert abs(sim.balance()["residual"]) < 1e-11


@pytest.mark.parametrize("dim", [2, 3])
def test_symmetry(dim):
    """A disc and a ball stay symmetric under all reflections and permutations of the axes."""
    lattice = fh.Lattice(1.0, [-9.0] * dim, [9.0] * dim)
    shape = {2: fh.Disc, 3: fh.Ball}[dim](5.0)
    sim = fh.Simulation(
        lattice, model(kernel_stencil(dim, 2)), fh.LatticePML(nodes=8), specimens=[fh.Specimen(shape, METAL)]
    )
    sim.run(60.0 if dim == 2 else 30.0, progress=False)
    u, solid = sim.fields["u"], sim.fields["solid"]
    assert 0 < solid.sum() < shape.contains(np.stack(lattice.coordinates(), -1)).sum()
    for axis in range(dim):
        assert np.abs(u - np.flip(u, axis)).max() < 1e-12
        assert np.abs(u - np.moveaxis(u, axis, 0)).max() < 1e-12


# The layer, and what runs beside it


def test_layer_beside_dissolving_metal():
    """An off-centre disc near the layer, against a domain from which nothing returns."""
    setup = {
        "lattice": fh.Lattice(1.0, (-10.0, -10.0), (10.0, 10.0)),
        "model": model(kernel_stencil(2, 2)),
        "boundary": fh.LatticePML(target=1e-7),
        "specimens": [fh.Specimen(fh.Disc(4.0, (5.0, 3.0)), METAL), fh.Specimen(fh.Disc(2.0, (-5.0, 3.0)), 1.5)],
    }
    found = compare(setup, 600.0, times=[20.0, 60.0, 200.0, 600.0])
    ours, edge = found.curves["lattice PML"]["error_rel_current"], found.curves["fixed edge"]["error_rel_current"]
    assert max(ours) < 1e-7  # the target
    assert min(edge) > 1e-3
    assert "domain of" in found.reference


def test_specimen_next_to_the_layer():
    """A specimen may extend to the last node but one: the run puts liquid nodes between it and the layer."""
    start = [fh.Specimen(fh.Box((0.0, -3.0), (9.0, 3.0)), METAL)]
    lattices = [fh.Lattice(1.0, (-10.0, -10.0), (10.0, 10.0)), fh.Lattice(1.0, (-10.0, -10.0), (16.0, 10.0))]
    runs = [fh.Simulation(at, model(kernel_stencil(2, 2)), fh.LatticePML(nodes=24), specimens=start) for at in lattices]
    for sim in runs:
        sim.run(100.0, progress=False)
    assert np.abs(runs[0].fields["u"] - runs[1].fields["u"][:21]).max() < 1e-6


@pytest.mark.parametrize("limited", [False, True])
def test_pit_under_a_film(limited):
    """Metal under a film dissolves only through the hole in it, and the pit undercuts the film. Under a film that forms
    later, what has dissolved until then is as without it, and from then on less dissolves; one that would form after
    the end changes nothing.
    """
    lattice = fh.Lattice(1.0, (-15.0, -10.0), (15.0, 10.0))
    plate = fh.Specimen(fh.Box((-15.0, -10.0), (15.0, 0.0)), METAL)
    film = [[(-16.0, 0.5), (-2.5, 0.5)], [(2.5, 0.5), (16.0, 0.5)]]
    sides = {"x": fh.Free(), "y-": fh.Free(), "y+": fh.LatticePML(nodes=12)}

    def run(cracks, until=150.0):
        sim = fh.Simulation(
            lattice, model(kernel_stencil(2, 2), limited=limited), sides, specimens=[plate], cracks=cracks, balance=True
        )
        sim.run(until, progress=False)
        assert abs(sim.balance()["residual"]) < 1e-10
        return sim.fields["solid"]

    def forming(time):
        return [fh.Crack(f, opens=time) for f in film]

    bare, pitted, late = run([]), run(film), run(forming(60.0))
    assert pitted.sum() > bare.sum()
    assert pitted[0, 10] == 1 and pitted[15, 10] == 0 and bare[0, 10] == 0  # nodes at y = 0
    assert (pitted[:13, 9] == 0).any() and (pitted[:13, 10] == 0).any()  # undercut
    assert np.array_equal(pitted, pitted[::-1])
    assert np.array_equal(run(forming(60.0), 60.0), run([], 60.0))
    for under in (slice(0, 10), slice(21, 31)):  # three nodes and more from the hole, whose edges are at x = 2.5
        assert bare[under].sum() < late[under].sum() < pitted[under].sum()
    assert not (bare > late).any()  # nothing dissolves that would not without the film
    assert np.array_equal(late, late[::-1])
    assert np.array_equal(run(forming(151.0)), bare)


def test_resume_is_bitwise(tmp_path):
    """Phases, times of dissolution and the balance continue; the specimens are in the checkpoint."""
    lattice = fh.Lattice(1.0, (-8.0, -8.0), (8.0, 8.0))
    make = lambda: fh.Simulation(  # noqa: E731
        lattice,
        model(kernel_stencil(2, 2)),
        {"x": fh.LatticePML(nodes=8), "y": fh.Periodic()},
        specimens=[*specimens(2)],
        balance=True,
    )
    whole, part = make(), make()
    whole.step(30)
    part.step(16)
    part.save(tmp_path / "c.ckpt")
    again = fh.Simulation.restore(tmp_path / "c.ckpt")
    again.step(14)
    for name, field in whole.fields.items():
        assert np.array_equal(field, again.fields[name], equal_nan=True)
    assert whole.balance() == again.balance()
    assert 0 < whole.fields["solid"].sum() < part.parts.start.solid.sum()
    check_counts(again)


# Case files and refusals

CASE = """
[lattice]
spacing = 0.25
lower = [-3.0, -3.0]
upper = [3.0, 3.0]
[model]
type = "corrosion"
saturation = 0.8
interface = 0.1
[model.kernel]
horizon = 0.5
[[specimen]]
region = { disc = { radius = 1.5 }, without = [{ box = { lower = [-0.2, 0.0], upper = [0.2, 2.0] } }] }
concentration = 2.0
[run]
until = 1.0
[output]
fields = ["u", "solid", "dissolved"]
"""


def test_a_case_is_the_run_of_the_python_interface():
    sim = Case(CASE).simulation().run(1.0)
    shape = fh.Disc(1.5) - fh.Box((-0.2, 0.0), (0.2, 2.0))
    same = fh.Simulation(
        fh.Lattice(0.25, (-3, -3), (3, 3)),
        fh.Corrosion(fh.Kernel(0.5), saturation=0.8, interface=0.1),
        fh.LatticePML(until=1.0),
        specimens=[fh.Specimen(shape, 2.0)],
        dt=sim.dt,
    ).run(1.0)
    for name, field in same.fields.items():
        assert np.array_equal(sim.fields[name], field, equal_nan=True)


@pytest.mark.parametrize(
    "old, new, message",
    [
        ("concentration", "concentraton", "did you mean 'concentration'"),
        ("saturation = 0.8", "saturation = 2.0", "outside the range of the data.*above 0 .*below 2"),
        ("saturation = 0.8", "saturation = 0.0", "outside the range of the data"),
        ("saturation = 0.8", "", "missing key model.saturation"),
        ("interface = 0.1", "interface = 0.0", "model.interface"),
        ("radius = 1.5", "radius = 3.0", "touches the absorbing side"),
        ("radius = 1.5", "radius = 1.5, centre = [9.0, 0.0]", "holds no node"),
        ('"dissolved"]', '"v"]', "no such field.*dissolved"),
        ("disc =", "ball =", "dimension"),
    ],
)
def test_case_refusals(old, new, message):
    with pytest.raises(fh.InputError, match=message):
        Case(CASE.replace(old, new, 1)).simulation()


SQUARE = fh.Lattice(1.0, (-8.0, -8.0), (8.0, 8.0))
PIECE = [fh.Specimen(fh.Disc(3.0), METAL)]
LEFT = [fh.Specimen(fh.Disc(3.0, (-8.0, 0.0)), METAL)]
BEYOND = [fh.Specimen(fh.Box((-8.0, 0.0), (2.0, 4.0)) | fh.Disc(1.0, (12.0, 0.0)), METAL)]


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"model": fh.Diffusion(kernel_stencil(2, 2))}, "only a Corrosion has specimens"),
        ({"model": fh.Wave(kernel_stencil(2, 2))}, "only a Corrosion has specimens"),
        ({"coefficient": np.ones(SQUARE.shape)}, "phases are the coefficient"),
        ({"specimens": [fh.Disc(3.0)]}, "not a specimen"),
        ({"specimens": [*PIECE, fh.Specimen(fh.Disc(3.0, (4.0, 0.0)), 1.5)]}, "share nodes"),
        ({"specimens": [fh.Specimen(np.ones((3, 3), bool))]}, "lattice's shape"),
        ({"specimens": BEYOND, "boundary": {"x-": fh.Free(), "all": fh.LatticePML()}}, "beyond the absorbing side"),
        ({"background": 1.0}, "outside the range of the data"),
        ({"sources": [1.0], "boundary": fh.Free()}, "acts on solid nodes"),
        ({"constraints": [fh.Prescribed([(0.0, 0.0)], 1.0)]}, "acts on solid nodes"),
        ({"constraints": [fh.Insulated("x-")], "boundary": fh.Free(), "specimens": LEFT}, "acts on solid nodes"),
    ],
)
def test_refusals(changes, message):
    setup = {"lattice": SQUARE, "model": model(kernel_stencil(2, 2)), "specimens": PIECE}
    with pytest.raises(fh.InputError, match=message):
        fh.Simulation(**{**setup, **changes})


def test_a_source_that_reaches_the_metal_is_refused_when_it_does():
    """A source that is not a product of functions of space and time is examined step by step."""
    moving = fh.Source(lambda x, y, t: np.where(np.hypot(x - 5 + t, y) < 1, 1.0, 0.0))
    sim = fh.Simulation(SQUARE, model(kernel_stencil(2, 2)), fh.Free(), specimens=PIECE, sources=[moving])
    with pytest.raises(fh.InputError, match="acts on solid nodes"):
        sim.run(4.0)
    assert 1.0 < sim.time <= 1.0 + sim.dt  # the source reaches the rim at t = 1


def test_bad_specimens():
    with pytest.raises(fh.InputError, match="shape or a mask"):
        fh.Specimen(3.0)
    with pytest.raises(fh.InputError, match="concentration: must be finite"):
        fh.Specimen(fh.Disc(1.0), np.nan)
    with pytest.raises(fh.InputError, match="concentration: must be finite and not negative; value: -1"):
        fh.Specimen(fh.Disc(1.0), -1.0)
    with pytest.raises(fh.InputError, match="saturation: must be finite"):
        model(kernel_stencil(2, 2), saturation=np.inf)

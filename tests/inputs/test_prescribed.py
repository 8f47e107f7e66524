"""Prescribed values: held, released, in one and more dimensions."""

import math

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.case.case import Case
from helpers import fitted_rate, roll_apply

KERNEL = fh.Kernel(0.75)
LINE = fh.Lattice(0.25, -4, 4)
PLANE = fh.Lattice(0.25, (-3, -3), (3, 3))


@pytest.mark.parametrize("lattice", [LINE, PLANE])
@pytest.mark.parametrize("model", [fh.Wave(KERNEL, damping=0.1), fh.Diffusion(KERNEL)])
@pytest.mark.parametrize("boundary", [fh.LatticePML(), fh.Fixed()])
def test_held_nodes_follow(lattice, model, boundary):
    """Held nodes have the prescribed value at every step, including the first, and act on their neighbours."""
    dim = lattice.dim
    held = fh.Prescribed([(0.5,) * dim, (-1.0,) * dim], lambda t: 1 + np.sin(t))
    sim = fh.Simulation(lattice, model, boundary, constraints=[held])
    nodes = [lattice.index((0.5,) * dim), lattice.index((-1.0,) * dim)]
    for _ in range(7):
        for node in nodes:
            assert sim.fields["u"][node] == 1 + np.sin(sim.time)
        sim.step(1)
    assert (np.abs(sim.fields["u"]) > 1e-3).sum() > 2
    sim.step(300)
    assert sim.fields["u"][nodes[0]] == 1 + np.sin(sim.time)


def test_all_but_one_node_held():
    """The free node is an oscillator: ``u_tt = -w u``, solved by the scheme's own recursion."""
    free = LINE.index((0.0,))
    mask = np.ones(LINE.shape, bool)
    mask[free] = False
    sim = fh.Simulation(
        LINE,
        fh.Wave(KERNEL),
        fh.Fixed(),
        {"u": lambda x: 1.0 * (np.abs(x) < 0.1)},
        constraints=[fh.Prescribed(mask, 0.0)],
    )
    rate = sim.stencil.weights.sum() / LINE.spacing**2
    angle = 2 * np.arcsin(sim.dt * np.sqrt(rate) / 2)
    sim.step(1000)
    assert sim.fields["u"][free] == pytest.approx(np.cos(1000 * angle), abs=1e-11)


@pytest.mark.parametrize("lattice", [LINE, PLANE])
@pytest.mark.parametrize("rate", [None, np.cos(2.0), fh.Expression("cos(t)", 0)])
def test_the_first_step_after_the_release(lattice, rate):
    """``u + (1 - d dt) dt v + dt^2/2 A u``, the start of velocity Verlet, with the rate from the value's derivative
    unless given.
    """
    dim, damping = lattice.dim, 0.2
    at = lattice.index((0.0,) * dim)
    held = fh.Prescribed([(0.0,) * dim], np.sin, 2.0, rate)
    sim = fh.Simulation(lattice, fh.Wave(KERNEL, damping=damping), fh.LatticePML(), constraints=[held], dt=0.1)
    sim.step(20)
    u = sim.fields["u"]
    pull = 0.0
    for offset, weight in zip(sim.stencil.offsets, sim.stencil.weights, strict=True):
        pull += weight / lattice.spacing**2 * (u[tuple(np.array(at) + offset)] - u[at])
    sim.step(1)
    expected = u[at] + (1 - damping * 0.1) * 0.1 * np.cos(2.0) + 0.1**2 / 2 * pull
    assert sim.fields["u"][at] == pytest.approx(expected, abs=1e-10)


def test_release_does_not_disturb_a_solution():
    """A node that is held at the values of a free run and released with the scheme's own velocity gives that run, to
    rounding.
    """
    setup = {
        "lattice": fh.Lattice(0.25, -8, 8),
        "model": fh.Wave(KERNEL),
        "boundary": fh.Exact(),
        "initial": {"u": lambda x: np.exp(-4 * x**2)},
    }
    free = fh.Simulation(**setup, dt=0.02)
    values = [1.0]
    for _ in range(100):
        free.step(1)
        values.append(free.fields["u"][32])
    held = fh.Prescribed([0.0], lambda t: values[round(t / 0.02)], 1.0, (values[51] - values[49]) / 0.04)
    sim = fh.Simulation(**setup, dt=0.02, constraints=[held])
    sim.run(2.0)
    assert np.abs(sim.fields["u"] - free.fields["u"]).max() < 1e-12


@pytest.mark.parametrize("saved", [10, 20, 30])
def test_restored_runs_are_bitwise_the_same(saved, tmp_path):
    """Checkpoints before, at and after the release of one of two constraints."""
    held = [fh.Prescribed([0.0], fh.Expression("sin(t)", 1), 2.0), fh.Prescribed(fh.Box((2.9,), (3.1,)), 0.25)]
    whole = fh.Simulation(LINE, fh.Wave(KERNEL), fh.Exact(), constraints=held, dt=0.1)
    whole.step(saved)
    whole.save(tmp_path / "c")
    parts = fh.Simulation.restore(tmp_path / "c")
    for sim in (whole, parts):
        sim.step(60)
    np.testing.assert_array_equal(whole.fields["u"], parts.fields["u"])
    assert parts.fields["u"][LINE.index((3.0,))] == 0.25


def test_steps_in_pieces_are_the_run():
    """The release falls within one call of `step`, or between two."""
    setup = {
        "lattice": LINE,
        "model": fh.Wave(KERNEL),
        "boundary": fh.LatticePML(),
        "constraints": [fh.Prescribed([0.0], np.sin, 2.0)],
        "dt": 0.1,
    }
    one, other = fh.Simulation(**setup), fh.Simulation(**setup)
    one.step(50)
    for count in (7, 13, 30):
        other.step(count)
    np.testing.assert_array_equal(one.fields["u"], other.fields["u"])


CASE = """
[lattice]
spacing = 0.25
lower = [-4.0]
upper = [4.0]
[model]
type = "wave"
[model.kernel]
horizon = 0.75
[boundary]
all = {{ type = "exact" }}
[[constraint]]
type = "prescribed"
{}
[run]
until = 4.0
dt = 0.1
"""


def test_case_files():
    sim = Case(CASE.format('points = [[0.0]]\nvalue = "sin(t)"\nuntil = 2.0')).simulation()
    other = fh.Simulation(LINE, fh.Wave(KERNEL), fh.Exact(), constraints=[fh.Prescribed([0.0], np.sin, 2.0)], dt=0.1)
    for each in (sim, other):
        each.run(4.0)
    np.testing.assert_allclose(sim.fields["u"], other.fields["u"], atol=1e-12)
    with pytest.raises(fh.InputError, match="points or region"):
        Case(CASE.format("value = 1.0"))
    with pytest.raises(fh.InputError, match="did you mean 'value'"):
        Case(CASE.format("points = [[0.0]]\nvalues = 1.0"))
    with pytest.raises(fh.InputError, match="there is no x in a function of t alone"):
        Case(CASE.format('points = [[0.0]]\nvalue = "x"'))


def test_bad_input():
    def simulation(*held, model=None):
        return fh.Simulation(LINE, model or fh.Wave(KERNEL), fh.LatticePML(), constraints=held, dt=0.01)

    with pytest.raises(fh.InputError, match="outside the near field"):
        simulation(fh.Prescribed([7.0], 1.0))
    with pytest.raises(fh.InputError, match="the same node"):
        simulation(fh.Prescribed([1.0], 1.0), fh.Prescribed([1.01], 2.0))
    with pytest.raises(fh.InputError, match="holds no node"):
        simulation(fh.Prescribed(fh.Box((0.05,), (0.1,)), 1.0))
    with pytest.raises(fh.InputError, match="lattice's shape"):
        simulation(fh.Prescribed(np.ones(3, bool), 1.0))
    for integrator in ("rk4", "rkc"):
        with pytest.raises(fh.InputError, match="one stage"):
            simulation(fh.Prescribed([1.0], 1.0), model=fh.Diffusion(KERNEL, integrator=integrator))
    with pytest.raises(fh.InputError, match="not a constraint"):
        simulation(1.0)
    with pytest.raises(fh.InputError, match="not negative"):
        fh.Prescribed([0.0], 1.0, until=-1.0)
    with pytest.raises(fh.InputError, match="not finite"):
        simulation(fh.Prescribed([0.0], lambda t: 1.0 if t < 0.05 else np.nan)).step(20)


# --- displacements ---------------------------------------------------------------------------------------------

SOLIDS = {
    "bonds": {},
    "state-based": {"material": "state-based", "poisson": 0.1},
    "correspondence": {"material": "correspondence", "poisson": 0.3, "stabilisation": 0.4},
    "finite elements": {"kernel": None, "material": "finite-element", "poisson": 0.3},
}


def solid(**options):
    return fh.Elastic(**{"kernel": fh.Kernel(2.0), "young": 1.0, **options})


@pytest.mark.parametrize("options", SOLIDS.values(), ids=SOLIDS)
def test_displacements_are_those_of_a_plain_program(options):
    """The lattice is periodic: some nodes follow both components, some a velocity in one component from where they
    started, and some are released.
    """
    lattice = fh.Lattice(1.0, (0.0, 0.0), (12.0, 11.0))
    u, v = 0.01 * np.random.default_rng(3).standard_normal((2, 2, *lattice.shape))
    masks = np.zeros((3, *lattice.shape), bool)
    masks[0, 2:4, 3], masks[1, 6, 5:9], masks[2, 9:11, 9] = True, True, True
    held = [
        fh.Prescribed(masks[0], ["0.1*sin(t)", 0.02]),
        fh.Prescribed(masks[1], velocity=[None, "0.03*t**2"]),  # for which Simpson's rule is exact
        fh.Prescribed(masks[2], [np.cos, None], until=1.0, rate=[0.25, None]),
    ]
    model = solid(**options)
    sim = fh.Simulation(lattice, model, fh.Periodic(), {"u": u, "v": v}, constraints=held, dt=0.05)
    rate = model.coefficient

    def acceleration(u):
        return rate * roll_apply(u, sim.stencil.offsets, sim.stencil.weights)

    u = u.copy()
    u[0, masks[0]], u[1, masks[0]], u[0, masks[2]] = 0.0, 0.02, 1.0
    first = u[1, masks[1]].copy()
    old = u - sim.dt * v + sim.dt**2 / 2 * acceleration(u)
    for n in range(1, 41):
        u, old, t = 2 * u - old + sim.dt**2 * acceleration(u), u, n * sim.dt
        u[0, masks[0]], u[1, masks[0]] = 0.1 * np.sin(t), 0.02
        u[1, masks[1]] = first + 0.01 * t**3
        if n <= 20:
            u[0, masks[2]] = np.cos(t)
        if n == 20:
            old[0, masks[2]] = (u - sim.dt * 0.25 + sim.dt**2 / 2 * acceleration(u))[0, masks[2]]
    sim.step(40)
    np.testing.assert_allclose(sim.fields["u"], u, rtol=0, atol=1e-12)


def test_a_plane_that_is_moved_sends_waves_to_both_sides():
    """``u = U(t - |x|/c)`` of a plane with prescribed velocity in an open medium, to second order in the spacing;
    finite elements couple nodes only to their neighbours, so that no bond crosses the plane.
    """
    errors, spacings = [], (0.5, 0.25)
    for h in spacings:
        lattice = fh.Lattice(h, (-18.0, 0.0), (18.0, 4 * h))
        model = solid(kernel=None, material="finite-element", poisson=0.3)
        plane = fh.Prescribed(fh.Box((-h / 4, -1.0), (h / 4, 9.0)), velocity=["0.01*exp(-((t-9)/2.5)**2)", 0.0])
        sides = {"x": fh.LatticePML(nodes=10), "y": fh.Periodic()}
        sim = fh.Simulation(lattice, model, sides, constraints=[plane]).run(16.0)
        x, late = lattice.coordinates()[0], sim.time - np.abs(lattice.coordinates()[0]) / model.p_speed
        exact = 0.01 * 2.5 * np.sqrt(np.pi) / 2 * (1 + np.vectorize(math.erf)((late - 9) / 2.5))
        errors.append(np.abs(sim.fields["u"][0] - exact).max() / exact.max())
        assert np.abs(sim.fields["u"][1]).max() < 1e-12 and x.size
    assert errors[-1] < 0.02 and fitted_rate(spacings, errors) > 1.7


@pytest.mark.parametrize("saved", [10, 20, 30])
def test_restored_bodies_that_are_pulled_are_bitwise_the_same(saved, tmp_path):
    """Checkpoints before, at and after the release, while bonds break."""
    lattice = fh.Lattice(0.5, (-4.0, -4.0), (4.0, 4.0))
    model = fh.Elastic(fh.Kernel(1.0, 1), 1.0, nonlinear=True, critical_stretch=0.02)
    pull = [
        fh.Prescribed(fh.Box((-4.0, 3.4), (4.0, 4.0)), velocity=[None, fh.Expression("0.3*t", 0)], until=2.0),
        fh.Prescribed(fh.Box((-4.0, -4.0), (4.0, -3.4)), [0.0, 0.0]),
    ]
    whole = fh.Simulation(lattice, model, fh.Free(), constraints=pull, dt=0.1, cracks=[[(-9.0, 0.2), (0.0, 0.2)]])
    whole.step(saved)
    whole.save(tmp_path / "c")
    parts = fh.Simulation.restore(tmp_path / "c")
    for sim in (whole, parts):
        sim.step(40)
    np.testing.assert_array_equal(whole.fields["u"], parts.fields["u"])
    assert whole.broken_bonds == parts.broken_bonds > 10
    assert not whole.fields["u"][:, :, 0].any()


ELASTIC_CASE = """
[units]
length = "mm"
time = "us"
pressure = "GPa"
[lattice]
spacing = 0.5
lower = [-4.0, -4.0]
upper = [4.0, 4.0]
[model]
type = "elastic"
young = 1.0
kernel = { horizon = 1.0 }
[boundary]
all = { type = "free" }
[[constraint]]
type = "prescribed"
region = { box = { lower = [-4.0, 3.5], upper = [4.0, 4.0] } }
velocity = [false, { type = "step", rise = 1.0 }]
[[constraint]]
type = "prescribed"
points = [[0.0, -4.0]]
value = ["1 um", "0.1*t"]
until = 1.0
rate = [0.0, "2 m/s"]
[run]
until = 2.0
dt = 0.1
"""


def test_case_of_displacements():
    sim = Case(ELASTIC_CASE).simulation().run(2.0)
    held = [
        fh.Prescribed(fh.Box((-4.0, 3.5), (4.0, 4.0)), velocity=[None, fh.Step(1.0)]),
        fh.Prescribed([[0.0, -4.0]], [1e-3, "0.1*t"], 1.0, [0.0, 2e-3]),
    ]
    lattice = fh.Lattice(0.5, (-4.0, -4.0), (4.0, 4.0))
    other = fh.Simulation(lattice, fh.Elastic(fh.Kernel(1.0), 1.0), fh.Free(), constraints=held, dt=0.1).run(2.0)
    np.testing.assert_array_equal(sim.fields["u"], other.fields["u"])
    assert np.ptp(sim.fields["u"][1][:, -1]) == 0 < sim.fields["u"][1][0, -1] and np.ptp(sim.fields["u"][0][:, -1]) > 0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('["1 um", "0.1*t"]', '"0.1*t"', "constraint.value.*needs one entry per component"),
        ('["1 um", "0.1*t"]', '[0.0, 0.0, "0.1*t"]', "needs one entry per component"),
        ('["1 um", "0.1*t"]', "[false, false]", "prescribes no component"),
        ('["1 um", "0.1*t"]', '["x", 0.0]', r"value\[0\]: there is no x in a function of t alone"),
        ('["1 um", "0.1*t"]', '["1 s", 0.0]', "measures something else"),
        ("until = 1.0\nrate", "until = 1.0\nvelocity = [0, 0]\nrate", "either a value or a velocity"),
        ('value = ["1 um", "0.1*t"]\n', "", "either a value or a velocity"),
        ("points = [[0.0, -4.0]]", "points = [[0.0, 4.0]]", "the same node"),
        ("points = [[0.0, -4.0]]", "points = [[0.0, -5.0]]", "outside the near field"),
        ('rate = [0.0, "2 m/s"]', "rate = 0.0", "constraint.rate.*needs one entry per component"),
        ('velocity = [false, { type = "step", rise = 1.0 }]', "velocity = [0, 0]\nrate = [0, 0]", "released with it"),
    ],
)
def test_bad_cases_of_displacements(old, new, message):
    assert old in ELASTIC_CASE
    with pytest.raises(fh.InputError, match=message):
        Case(ELASTIC_CASE.replace(old, new)).simulation()


def test_lists_and_conditions_of_heat_are_refused_where_they_do_not_fit():
    with pytest.raises(fh.InputError, match="a scalar field has one value"):
        fh.Simulation(LINE, fh.Wave(KERNEL), constraints=[fh.Prescribed([0.0], [1.0])])
    with pytest.raises(fh.InputError, match="thermal conditions"):
        fh.Simulation(PLANE, solid(), fh.Free(), constraints=[fh.Insulated("x-")])


def beside_a_line(half, side, held, model, until, value):
    """Return the field within 8 nodes of the centre, and the notes, of a near field of given half width: a pulse,
    which is zero farther out, beside held nodes.
    """
    lattice = fh.Lattice(1.0, (-half,) * held.dim, (half,) * held.dim)
    x = np.stack(lattice.coordinates())
    pulse = np.exp(-((x - 1.0) ** 2).sum(0) / 3) * (np.abs(x).max(0) < 8.5)
    components = 1 if isinstance(model, fh.Wave) else held.dim
    start = {"u": pulse if components == 1 else np.stack([pulse] * components)}
    sim = fh.Simulation(lattice, model, side, start, constraints=[fh.Prescribed(held, value)], dt=0.25)
    sim.run(until, progress=False)
    inner = (slice(half - 8, half + 9),) * held.dim
    return sim.fields["u"][(..., *inner)], sim.notes


TO_THE_LEFT = fh.Box((-99.0, -0.1), (0.1, 0.1))
DOWN_AND_UP = fh.Box((-0.1, -99.0), (0.1, 99.0))
RUNNING_ON = {
    "line": (TO_THE_LEFT, fh.Wave(fh.Kernel(3.0)), 0.0, 30.0),
    "line across": (DOWN_AND_UP, fh.Wave(fh.Kernel(3.0)), "0", 30.0),
    "line in a solid": (TO_THE_LEFT, fh.Elastic(fh.Kernel(2.0), 1.0), [0.0, 0.0], 30.0),
    "line to slide along": (TO_THE_LEFT, fh.Elastic(fh.Kernel(2.0), 1.0), [None, 0.0], 30.0),
    "wire in space": (fh.Box((-99.0, -0.1, -0.1), (0.1, 0.1, 0.1)), fh.Wave(fh.Kernel(2.0)), 0.0, 14.0),
    "plate in space": (fh.Box((-99.0, -0.1, -99.0), (0.1, 0.1, 99.0)), fh.Wave(fh.Kernel(2.0)), 0.0, 14.0),
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("held", "model", "value", "until"), RUNNING_ON.values(), ids=RUNNING_ON)
def test_what_is_held_runs_on_into_the_layers(held, model, value, until):
    """The reference is a near field so wide that nothing returns: the error is within twice the target. Held nodes
    that end before the layer are a different problem.
    """
    speed = model.speed if isinstance(model, fh.Wave) else model.p_speed
    layers, wide = fh.LatticePML(target=1e-6, until=until), 8 + int(until * speed) // 2 + 4
    wanted, _ = beside_a_line(wide, fh.Fixed(), held, model, until, value)
    found, notes = beside_a_line(8, layers, held, model, until, value)
    assert np.abs(found - wanted).max() < 2e-6
    assert any("held at the side" in note for note in notes)
    ended = held & fh.Box((-4.0,) * held.dim, (4.0,) * held.dim)
    assert np.abs(beside_a_line(8, layers, ended, model, until, value)[0] - wanted).max() > 1e-3


def test_what_is_held_runs_on_where_the_domain_is_extended():
    held, model, value, until = RUNNING_ON["line"]
    fields = [
        beside_a_line(half, side, held, model, until, value)[0]
        for half, side in ((8, fh.Extended(1e-9)), (40, fh.Fixed()))
    ]
    assert np.abs(fields[0] - fields[1]).max() < 1e-9


@pytest.mark.parametrize(
    ("constraint", "said"),
    [
        (fh.Prescribed(TO_THE_LEFT, 1.0), "within one reach of the absorbing side x-.*must come to rest"),
        (fh.Prescribed(TO_THE_LEFT, "sin(t)"), "must come to rest"),
        (fh.Prescribed(TO_THE_LEFT, lambda t: 0.0), "must come to rest"),
        (fh.Prescribed(TO_THE_LEFT, 0.0, until=5.0), "must come to rest"),
        (fh.Prescribed(TO_THE_LEFT, velocity=0.0), "must come to rest"),
        (fh.Prescribed([(-8.0, 0.0)], 0.0), "ends or varies within one reach of the absorbing side x-"),
        (fh.Prescribed([(-8.0 + n, n) for n in range(8)], 0.0), "ends or varies within one reach"),
    ],
)
def test_what_cannot_run_on_is_refused(constraint, said):
    lattice = fh.Lattice(1.0, (-8.0, -8.0), (8.0, 8.0))
    with pytest.raises(fh.InputError, match=said):
        fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), fh.LatticePML(nodes=12), constraints=[constraint])


def test_what_is_held_at_the_background_runs_on():
    """A line held at 5 in a medium at rest at 5 gives the same as a line held at 0 in a medium at 0."""
    lattice, fields = fh.Lattice(1.0, (-8.0, -8.0), (8.0, 8.0)), []
    for rest in (0.0, 5.0):
        start = {"u": lambda x, y, rest=rest: rest + np.exp(-((x - 1) ** 2) - (y - 1) ** 2)}
        sim = fh.Simulation(
            lattice,
            fh.Wave(fh.Kernel(2.0)),
            fh.LatticePML(nodes=12),
            start,
            background=rest,
            constraints=[fh.Prescribed(TO_THE_LEFT, rest)],
        )
        sim.run(30.0, progress=False)
        fields.append(sim.fields["u"] - rest)
    assert np.abs(fields[1] - fields[0]).max() < 1e-13  # rounding errors of values of 5 over a hundred steps


PULLED = {
    "bonds": {},
    "bonds that break": {"critical_stretch": 1.2e-3},
    "states": {"poisson": 0.3, "material": "state-based", "density": "1 + 0.03*x"},
    "states that break": {"poisson": 0.3, "material": "state-based", "critical_stretch": 1.2e-3},
    "correspondence": {"poisson": 0.3, "material": "correspondence", "stabilisation": 0.3},
}


@pytest.mark.parametrize("until", [None, 14.3], ids=["held", "released"])
@pytest.mark.parametrize("name", PULLED)
def test_what_holds_nodes_does_the_work_that_is_found(name, until):
    """A plate is pulled apart at its ends, one of which may be released, while a traction acts on its side: energies
    add up to rounding.
    """
    constants = PULLED[name]
    model = fh.Elastic(fh.Kernel(2.0, 1), 1.0, **constants)
    ends = [
        fh.Prescribed(fh.Box((7.0, -8.0), (8.0, 8.0)), velocity=["1.5e-3*sin(t/8)**2", None], until=until),
        fh.Prescribed(fh.Box((-8.0, -8.0), (-7.0, 8.0)), [0.0, 0.0]),
    ]
    traction = fh.Traction("y+", (0.0, 1e-4), time="sin(t/4)**2")
    lattice = fh.Lattice(1.0, (-8.0, -8.0), (8.0, 8.0))
    sim = fh.Simulation(lattice, model, fh.Free(), constraints=ends, loads=[traction], balance=True)
    sim.run(until=30.0)
    found = sim.balance()
    assert found["work"] > 1e-5 and abs(found["lost"]) < 1e-12 * found["work"]
    assert sim.fields["damage"].any() if "critical_stretch" in constants else found["strain"] > 1e-5


@pytest.mark.parametrize("until", [None, 3.0])
@pytest.mark.parametrize("model", [fh.Diffusion(fh.Kernel(2.0), 0.8), fh.Heat(fh.Kernel(2.0), 2.0, 3.0, 4.0)])
def test_what_diffusing_nodes_supply_is_in_the_balance(model, until, tmp_path):
    """Prescribed nodes do not count among the free ones; when they are released they do, with what they have then."""
    plane = fh.Lattice(1.0, (-6.0, -6.0), (6.0, 6.0))
    first = fh.Prescribed([(3.0, 1.0), (3.0, 2.0)], value=lambda t: 5.0 + np.sin(t), until=until)
    held = [first, fh.Temperature(fh.Box((-1.5, -6.5), (6.5, -5.5)), 4.0), fh.Prescribed([(-4.0, 2.0)], value=5.7)]

    def make():
        return fh.Simulation(
            plane, model, {"all": fh.Free(), "x-": fh.LatticePML(nodes=6)}, {"u": "5 + exp(-(x**2 + y**2)/4)"},
            sources=["exp(-x**2 - y**2)"], constraints=held, background=5.0, balance=True, dt=0.1,
        )  # fmt: skip

    sim = make()
    free = np.ones(plane.shape, bool)
    for node in ((9, 7), (9, 8)) if until is None else ():
        free[node] = False
    free[2, 8], free[5:, 0] = False, False
    sim.run(5.0)
    found = sim.balance()
    largest = max(abs(value) for value in found.values())
    assert abs(found["residual"]) < 1e-12 * largest
    assert min(abs(found[f"constraint[{i}]"]) for i in range(3)) > 1e-3 * largest
    if until is None:
        stored = (sim.fields["u"] - 5.0)[free].sum() - sim.start_u[free].sum()
        assert found["stored"] == pytest.approx(stored / model.source_factor, rel=1e-12)
    for middle in (2.0, 4.0):
        part, rest = make(), make()
        part.run(middle)
        part.save(tmp_path / "state")
        rest.load(tmp_path / "state")
        rest.run(5.0)
        assert rest.balance() == pytest.approx(found, rel=1e-12, abs=1e-12 * largest)

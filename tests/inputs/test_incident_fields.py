"""Waves given as functions of space and time: those of the lattice leave nothing outside their box; others radiate
their residual.
"""

import numpy as np
import pytest

import farhorizon as fh

_LINEAR = fh.Kernel(horizon=2.5, influence="linear", exponent=1)
_MODELS = {
    "line": (fh.Wave(fh.Kernel(horizon=3.0)), 1),
    "plane": (fh.Wave(fh.Kernel(horizon=3.0), damping=0.01), 2),
    "elastic": (fh.Elastic(_LINEAR, young=2.0, density=0.5, damping=0.02), 2),
    "space": (fh.Elastic(fh.Kernel(horizon=1.5, influence="linear", exponent=1), young=2.0), 3),
}


def _boxed(half, dim, spacing=1.0):
    return fh.Lattice(spacing, (-half,) * dim, (half,) * dim)


def _solution(sim, rng):
    """Return a sum of three waves of the infinite lattice under velocity Verlet, with random wavevectors and
    branches, which have always been present; damped ones decay.
    """
    stencil, dt, damping, waves = sim.stencil, sim.dt, sim.model.damping, []
    for _ in range(3):
        k = rng.uniform(-0.5, 0.5, stencil.dim)
        symbol = np.reshape(stencil.symbol(*k), (stencil.components,) * 2)
        values, vectors = np.linalg.eigh(symbol)
        number = rng.integers(stencil.components)
        rate = values[number] * sim.model.coefficient / sim.lattice.spacing**2
        # (1 + d dt) z^2 - (2 - dt^2 rate) z + 1 - d dt = 0
        root = np.roots([1 + damping * dt, dt**2 * rate - 2, 1 - damping * dt])[0]
        waves.append((k / sim.lattice.spacing, vectors[:, number] * np.exp(1j * rng.uniform(0, 6)), root))

    def field(*at):
        *places, t = at
        found = sum(
            np.multiply.outer(e, np.exp(1j * sum(a * x for a, x in zip(k, places, strict=True))) * z ** (t / dt))
            for k, e, z in waves
        ).real
        return found if stencil.components > 1 else found[0]

    return field


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name == "space" else []) for name in _MODELS]
)
def test_a_wave_of_the_lattice_leaves_nothing(name):
    """The wave is under way at the start."""
    seed = 20261124
    model, dim = _MODELS[name]
    lattice = _boxed(9 if dim == 3 else 16, dim)
    field = _solution(fh.Simulation(lattice, model), np.random.default_rng(seed))
    low = (9 if dim < 3 else 6) * -1.0
    box = fh.Box((low,) * dim, (5.0,) * dim)
    sim = fh.Simulation(lattice, model, fh.LatticePML(nodes=4), sources=[fh.IncidentField(field, box)])
    places = lattice.coordinates()
    inside = np.logical_and.reduce([(x >= low) & (x <= 5) for x in places])
    for until in (0.0, 9.0, 18.0):
        sim.run(until=until)
        expected = field(*places, sim.time)
        error = np.abs(np.where(inside, expected, 0.0) - sim.fields["u"]).max()
        assert error < 1e-10 * np.abs(expected).max(), f"seed {seed}"
    assert not any("equation of the lattice" in note for note in sim.notes)


def test_its_own_forces_send_nothing_far_away():
    """The far field sums all forces on the shell of the box, with the phases of the waves that they radiate."""
    model, lattice = fh.Wave(fh.Kernel(horizon=2.0)), _boxed(14.0, 2)
    field = _solution(fh.Simulation(lattice, model), np.random.default_rng(20261126))
    far = fh.FarField()
    wave = fh.IncidentField(field, fh.Box((-8.0, -8.0), (8.0, 8.0)))
    fh.Simulation(lattice, model, fh.LatticePML(nodes=3), sources=[wave], observe=[far]).run(20.0)
    assert np.abs(far.at([(25.0, 0.0), (-18.0, 20.0)])[1]).max() < 1e-12


def test_on_a_free_side():
    """With bonds to next neighbours only, a free side is a mirror half a spacing above the last row."""
    spacing, model = 0.5, fh.Wave(fh.Stencil.finite_difference(2))
    lattice = fh.Lattice(spacing, (-8.0, -8.0), (8.0, 0.0))
    sides = {"all": fh.LatticePML(nodes=4), "y+": fh.Free()}
    dt = fh.Simulation(lattice, model, sides).dt
    a, b = 0.9, 0.7
    squared = 4 / spacing**2 * (np.sin(a * spacing / 2) ** 2 + np.sin(b * spacing / 2) ** 2)
    frequency = 2 / dt * np.arcsin(dt / 2 * np.sqrt(squared))
    field = f"cos({a!r}*x - {float(frequency)!r}*t)*cos({b!r}*(y - {spacing / 2!r}))"
    for top in (0.0, 3.0):  # the box ends at the side, or continues above it
        wave = fh.IncidentField(field, fh.Box((-5.0, -5.0), (4.0, top)))
        sim = fh.Simulation(lattice, model, sides, sources=[wave])
        assert sim.incident[0].wave.within.upper[1] == 0
        x, y = lattice.coordinates()
        inside = (np.abs(x + 0.5) < 4.6) & (y > -5.1)
        sim.run(until=10.0)
        expected = np.where(inside, fh.Expression(field, 2)(x, y, t=sim.time), 0.0)
        assert np.abs(sim.fields["u"] - expected).max() < 1e-10
    assert not any("only what is scattered" in note or "equation of" in note for note in sim.notes)


def test_on_a_free_side_of_states():
    """A plane wave and its reflection from the surface, given as a function on the nodes."""
    lattice = fh.Lattice(1.0, (-16.0, -16.0), (16.0, 0.0))
    model = fh.Elastic(fh.Kernel(2.0), 2.0, 0.4, density=0.2, material="state-based")
    sides = {"all": fh.LatticePML(nodes=4), "y+": fh.Free()}
    box = fh.Box((-9.0, -9.0), (9.0, 0.0))
    wave = fh.IncidentWave((1.0, 1.5), "sin(2*pi*t/16)*exp(-((t-40)/8)**2)", 80.0, within=box)
    plane = fh.Simulation(lattice, model, sides, sources=[wave])
    passage = plane.incident[0].passage

    def field(x, y, t):
        nodes = np.stack(np.broadcast_arrays(x + 16, y + 16), axis=-1)
        return passage.at(np.round(nodes.reshape(-1, 2)).astype(int))(t).reshape(2, *nodes.shape[:-1])

    given = fh.Simulation(lattice, model, sides, sources=[fh.IncidentField(field, box)])
    for until in (30.0, 45.0):
        wanted = plane.run(until=until).fields["u"]
        np.testing.assert_allclose(given.run(until=until).fields["u"], wanted, rtol=0, atol=1e-10)
        assert np.abs(wanted).max() > 0.1
    assert not any("equation of the lattice" in note for note in given.notes)


def test_what_is_no_wave_of_the_lattice_is_radiated_and_said():
    """A plane wave of the continuum in a box of fixed size: the radiated field and the residual in the note are of
    second order in the spacing.
    """
    leaks, lacks = [], []
    for spacing in (0.5, 0.25):
        lattice = _boxed(8.0, 2, spacing)
        wave = fh.IncidentField("sin(0.6*x + 0.8*y - t)", fh.Box((-4.0, -4.0), (4.0, 4.0)))
        model = fh.Wave(fh.Stencil.finite_difference(2))
        sim = fh.Simulation(lattice, model, fh.LatticePML(nodes=8), sources=[wave])
        (note,) = [note for note in sim.check(until=12.0).notes if "equation of the lattice" in note]
        lacks.append(float(note.split("but for ")[1].split()[0]))
        sim.run(until=12.0)
        outside = np.max([np.abs(x) for x in lattice.coordinates()], axis=0) > 4.01
        leaks.append(np.abs(sim.fields["u"][outside]).max())
    assert 1.8 < np.log2(leaks[0] / leaks[1]) < 2.2
    assert 1.7 < np.log2(lacks[0] / lacks[1]) < 2.3  # two digits are printed


def test_what_is_far_from_a_wave_of_the_lattice_is_a_warning():
    wave = fh.IncidentField("sin(1.2*x - 0.5*t)", fh.Box((-8.0, -8.0), (8.0, 8.0)))
    sim = fh.Simulation(_boxed(12.0, 2), fh.Wave(fh.Kernel(2.0)), fh.LatticePML(nodes=3), sources=[wave])
    with pytest.warns(fh.ValidityWarning, match="equation of the lattice"):
        report = sim.check(until=5.0, budget=0.1)
    assert any("equation of the lattice" in text for text in report.warnings)


def test_restored_and_described(tmp_path):
    model, lattice = fh.Elastic(_LINEAR, young=2.0), _boxed(12.0, 2)
    wave = fh.IncidentField(["cos(0.3*x - 0.4648*t)", 0.0])
    sim = fh.Simulation(lattice, model, fh.LatticePML(nodes=4), sources=[wave])
    sim.run(until=5.0)
    sim.save(tmp_path / "run.ckpt")
    again = fh.Simulation.restore(tmp_path / "run.ckpt")
    for run in (sim, again):
        run.run(until=8.0)
    np.testing.assert_array_equal(again.fields["u"], sim.fields["u"])


def _refused(match, field, model=None, **changes):
    with pytest.raises(fh.InputError, match=match):
        fh.Simulation(
            _boxed(12.0, 2), model or fh.Wave(fh.Kernel(2.5)), sources=[fh.IncidentField(field, **changes)]
        ).step(2)


def test_bad_input():
    _refused("there is no z", "sin(z - t)")
    _refused(r"incident\.field: .*x, y, t", lambda x: x)
    _refused("finite", "1/t")
    _refused("one value a place", lambda x, y, t: np.ones(3))
    _refused("one entry per component", ["x", "y"])
    _refused("one entry per component", "x", model=fh.Elastic(_LINEAR, young=2.0))
    _refused("one reach of the near field", "x", within=fh.Box((-11, -8), (8, 8)))
    _refused("second order", "x", model=fh.Diffusion(fh.Kernel(2.5)))


def test_case_file():
    from farhorizon.case.case import Case

    text = """
    lattice = { spacing = 1.0, lower = [-12.0, -12.0], upper = [12.0, 12.0] }
    model = { type = "elastic", young = 1.0, kernel = { horizon = 2.0, exponent = 1, influence = "linear" } }
    run = { until = 1.0 }
    [[incident]]
    type = "incident-field"
    field = ["cos(0.3*x - t)", 0.0]
    within = { lower = [-6.0, -5.0], upper = [6.0, 5.0] }
    """
    wave = Case(text).simulation().incident[0].wave
    assert wave.within.bounds()[1].tolist() == [6.0, 5.0] and wave.field[0].text == "cos(0.3*x - t)"
    with pytest.raises(fh.InputError, match=r"incident\.field.*there is no z"):
        Case(text.replace("0.3*x", "0.3*z")).simulation()

"""Bonds whose law is a function: single bonds against closed forms, built-in laws, energies, threads, checkpoints, case
files, bad input.
"""

import math
from dataclasses import dataclass

import numba
import numpy as np
import pytest

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.medium.fracture import fracture_energy

ONSET, SPACING = 0.01, 0.5


def held(reach, dim):
    """Energy per area of the bonds across a plane at the onset, if they were linear."""
    brittle = fh.Elastic(fh.Kernel(reach * SPACING, 1), 1.0)
    stencil = brittle.stencil(SPACING, dim)
    return fracture_energy(SPACING * stencil.offsets, brittle.bond_stiffness(stencil, SPACING), ONSET)


def blast(lattice, strength=0.3, **options):
    """A closed box with an explosion in the middle."""
    x = np.stack(lattice.coordinates())
    source = fh.Source(strength * x * np.exp(-(x**2).sum(0)), lambda t: np.exp(-((t - 6) ** 2)))
    return {"sources": [source], "balance": True} | options


def box(dim=2):
    half = 8.0 if dim == 2 else 4.0
    return fh.Lattice(SPACING, (-half,) * dim, (half,) * dim)


@dataclass(frozen=True)
class Yielding(fh.BondLaw, offered=False):
    """Bonds that yield, so that they have a stretch without a force."""

    limit: float
    history = {"slip": 0.0}  # noqa: RUF012

    @staticmethod
    def update(stretch, slip, limit):
        return min(max(slip, stretch - limit), stretch + limit)

    @staticmethod
    def force(stretch, slip):
        return stretch - slip

    @staticmethod
    def energy(stretch, slip):
        return (stretch - slip) ** 2 / 2


@dataclass(frozen=True)
class Linear(fh.BondLaw, offered=False):
    """Springs."""

    @staticmethod
    def force(stretch):
        return stretch


@dataclass(frozen=True)
class Stiffening(fh.BondLaw, offered=False):
    """Springs as soft as half the bond at first, with an energy that is no square."""

    scale: float

    @staticmethod
    def force(stretch, scale):
        return stretch - 0.5 * scale * math.tanh(stretch / scale)

    @staticmethod
    def energy(stretch, scale):
        return 0.5 * stretch**2 - 0.5 * scale**2 * math.log(math.cosh(stretch / scale))


#: Types of laws, and their numbers; `law_of` makes them, because Numba then compiles them.
LAWS = {
    "bilinear": (fh.BilinearSoftening, ONSET, 2 * ONSET),
    "exponential": (fh.ExponentialSoftening, ONSET, 2 * ONSET),
    "viscoelastic": (fh.ViscoelasticBond, 0.4, 2.0),
    "yielding": (Yielding, ONSET),
}
SOFTENINGS = {"bilinear": "linear", "exponential": "exponential"}


def law_of(name):
    kind, *numbers = LAWS[name]
    return kind(*numbers)


# --- single bonds ----------------------------------------------------------------------------------------------


def pulled(law, stretches, nonlinear=False):
    """A node beside two rows at rest is moved along x, so that each of its straight bonds has given stretches in
    successive steps; returns the force in that bond over its stiffness, the energies, and the time step.
    """
    lattice = fh.Lattice(SPACING, (-2 * SPACING, 0.0), (0.0, 5 * SPACING))
    model = fh.Elastic(
        fh.Kernel(1.001 * SPACING, 1, volume="full", calibrate=False), 1.0, law=law, nonlinear=nonlinear, contact=False
    )
    moves = lattice.coordinates()[0] > -0.1 * SPACING
    sides = {"x": fh.Free(), "y": fh.Periodic()}
    dt = 0.05
    course = np.concatenate([[0.0], stretches, stretches[-1:]])
    fields = [
        fh.Prescribed(~moves, [0.0, 0.0]),
        fh.Prescribed(moves, [lambda t: SPACING * np.interp(t / dt, np.arange(len(course)), course), 0.0]),
    ]
    sim = fh.Simulation(lattice, model, sides, constraints=fields, dt=dt, balance=True)
    stencil = sim.stencil
    ahead = int(np.flatnonzero((stencil.offsets == [1, 0]).all(1))[0])
    c, rows = model.bond_stiffness(stencil, SPACING)[ahead], []
    for _ in course[1:]:
        sim.step()
        rows.append(sim.energies())
    scale = lattice.shape[1] * SPACING**2 * c * SPACING**2
    return {name: np.array([row[name] for row in rows]) / scale for name in rows[0]}, dt


@pytest.mark.parametrize("name", SOFTENINGS)
def test_a_bond_takes_the_area_below_its_curve(name):
    """Pulled apart steadily, it loses ``onset * final / 2`` in units of its stiffness; the exponential law leaves
    ``exp(-14)`` of it. The error is of second order in the stretch per step.
    """
    law = LAWS[name][0](ONSET, 4 * ONSET)
    errors = []
    for steps in (400, 800):
        lost = pulled(law, np.linspace(0, 25 * ONSET, steps))[0]["broken"]
        errors.append(lost[-1] / (ONSET * 4 * ONSET / 2) - 1)
    assert abs(errors[1]) < 4e-3
    assert abs(errors[1]) < 0.3 * abs(errors[0]) or abs(errors[1]) < 1e-5


def test_a_bond_relaxes_as_its_closed_form_tells():
    """Held at a stretch s, which rises within the first step, a viscoelastic bond stores ``((1 - m) s^2 + m (s -
    q)^2) / 2`` with the dashpot's stretch ``q = s (1 - (tau/dt) (exp(dt/tau) - 1) exp(-t/tau))``, and loses the rest.
    """
    m, tau, top = 0.4, 1.0, 0.02
    energies, dt = pulled(fh.ViscoelasticBond(m, tau), np.full(100, top))
    t = dt * np.arange(2, len(energies["strain"]))  # of the history, which follows the stretch by a step
    q = top * (1 - tau / dt * np.expm1(dt / tau) * np.exp(-t / tau))
    np.testing.assert_allclose(energies["strain"][2:], ((1 - m) * top**2 + m * (top - q) ** 2) / 2, rtol=2e-4)
    lost = energies["broken"][2:] - energies["broken"][2]
    np.testing.assert_allclose(lost, m * ((top - q[0]) ** 2 - (top - q) ** 2) / 2, rtol=0, atol=4e-4 * m * top**2 / 2)
    assert energies["broken"][-1] == pytest.approx(m * top**2 / 2, rel=0.05)  # less while the stretch rises


def test_a_bond_in_vibration_loses_what_the_loss_modulus_tells():
    """Per cycle of the amplitude s a standard linear solid loses ``pi s^2 m w tau / (1 + w^2 tau^2)``."""
    m, tau, top, period = 0.4, 1.0, 0.02, 200
    steps = np.arange(1, 6 * period + 1)
    energies, dt = pulled(fh.ViscoelasticBond(m, tau), top * np.sin(2 * np.pi * steps / period))
    w = 2 * np.pi / (period * dt)
    lost = energies["broken"][5 * period - 1] - energies["broken"][4 * period - 1]
    assert lost == pytest.approx(np.pi * top**2 * m * w * tau / (1 + (w * tau) ** 2), rel=2e-3)
    assert (np.diff(energies["broken"]) >= 0).all()


def test_a_yielding_bond_loses_four_times_its_limit_over_its_range():
    """Between the stretches -s and s it takes ``4 limit (s - limit)`` per cycle: the area of its parallelogram."""
    top, period = 5 * ONSET, 400
    steps = np.arange(1, 3 * period + 1)
    triangle = top * (np.abs((steps + period / 4) % period / period * 4 - 2) - 1) * -1
    lost = pulled(Yielding(ONSET), triangle)[0]["broken"]
    assert lost[-period // 4] - lost[-period // 4 - period] == pytest.approx(4 * ONSET * (top - ONSET), rel=1e-2)


@pytest.mark.parametrize("name", SOFTENINGS)
def test_the_force_follows_the_curve(name):
    """Loaded, unloaded and loaded again."""
    law = LAWS[name][0](ONSET, 3 * ONSET)
    stretches = np.concatenate([np.linspace(0, 0.02, 50), np.linspace(0.02, -0.01, 50), np.linspace(-0.01, 0.05, 100)])
    top = np.maximum.accumulate(np.maximum(stretches, ONSET))
    curve = ONSET * (3 * ONSET - top) / (2 * ONSET) if name == "bilinear" else ONSET * np.exp(-(top - ONSET) / ONSET)
    curve = np.maximum(curve, 0) / top
    course = law.course(stretches)
    np.testing.assert_allclose(course["force"], curve * stretches, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(course["damage"], 1 - curve, rtol=0, atol=1e-12)


# --- in a medium ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("dim", "nonlinear"), [(2, False), (2, True), (3, False)])
@pytest.mark.parametrize("name", SOFTENINGS)
def test_softening_laws_do_what_the_built_in_ones_do(name, dim, nonlinear):
    """With the same limits, in a box that varies, with a crack and with contact; to rounding."""
    lattice = box(dim)
    crack = fh.Polyline([[-4, 0.3], [4, 0.3]]) if dim == 2 else fh.Rectangle([-2, -2, 0.3], [4, 0, 0], [0, 4, 0])
    laws = [
        {"critical_stretch": ONSET, "fracture_energy": 2 * held(2, dim), "softening": SOFTENINGS[name]},
        {"law": law_of(name)},
    ]
    runs = []
    for law in laws:
        model = fh.Elastic(fh.Kernel(2 * SPACING, 1), 1.0, nonlinear=nonlinear, contact=True, **law)
        cracks = [fh.Crack(crack, opens=9.0)]
        sim = fh.Simulation(lattice, model, fh.Free(), cracks=cracks, **blast(lattice))
        runs.append(sim.run(14.0, progress=False))
    built_in, function = runs
    assert ((function.fields["damage"] > 0.05) & (function.fields["damage"] < 0.95)).sum() > 20
    for field in ("u", "damage"):
        largest = np.abs(built_in.fields[field]).max()
        np.testing.assert_allclose(function.fields[field], built_in.fields[field], rtol=0, atol=1e-11 * largest)
    for energy, value in built_in.balance().items():
        assert function.balance()[energy] == pytest.approx(value, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", LAWS)
def test_energies_add_up(name, dim):
    """To rounding, because the energies are squares of the stretch."""
    lattice = box(dim)
    model = fh.Elastic(fh.Kernel(2 * SPACING, 1), 1.0, law=law_of(name))
    sim = fh.Simulation(lattice, model, fh.Free(), **blast(lattice))
    lost = 0.0
    for t in (6.0, 9.0, 12.0):
        balance = sim.run(t, progress=False).balance()
        assert abs(balance["lost"]) < 1e-12 * balance["work"]
        assert balance["broken"] >= lost
        lost = balance["broken"]
    assert lost > 0.05 * balance["work"]


def test_energies_of_other_curves_add_up_to_third_order():
    lattice = box()
    errors = []
    for dt in (0.2, 0.1):
        model = fh.Elastic(fh.Kernel(2 * SPACING, 1), 1.0, law=Stiffening(0.01))
        sim = fh.Simulation(lattice, model, fh.Free(), dt=dt, **blast(lattice)).run(12.0, progress=False)
        errors.append(abs(sim.balance()["lost"]) / sim.balance()["work"])
        assert sim.balance()["broken"] == 0
    assert errors[1] < 0.35 * errors[0] and errors[1] < 1e-2


def test_a_spring_is_a_linear_solid():
    lattice = box()
    runs = []
    for law in (None, Linear()):
        model = fh.Elastic(fh.Kernel(2 * SPACING, 1), "1 + 0.2*sin(x)", law=law)
        runs.append(fh.Simulation(lattice, model, fh.Fixed(), **blast(lattice)).run(12.0, progress=False))
    largest = np.abs(runs[0].fields["u"]).max()
    np.testing.assert_allclose(runs[1].fields["u"], runs[0].fields["u"], rtol=0, atol=1e-13 * largest)
    for energy, value in runs[0].balance().items():
        assert runs[1].balance()[energy] == pytest.approx(value, rel=1e-10, abs=1e-14)


def test_a_relaxed_strip_is_softer():
    """Held at a strain it relaxes to ``1 - relaxing`` of its strain energy, and has lost the rest."""
    lattice = fh.Lattice(SPACING, (0.0, 0.0), (8.0, 4.0))
    x, y = lattice.coordinates()
    start, everywhere = {"u": [0.001 * x, 0 * y]}, fh.Prescribed(x > -1, velocity=[0.0, 0.0])
    energies = []
    for law in (Linear(), fh.ViscoelasticBond(0.4, 1.0)):
        model = fh.Elastic(fh.Kernel(2 * SPACING, 1), 1.0, law=law)
        sim = fh.Simulation(lattice, model, fh.Free(), start, constraints=[everywhere], balance=True, dt=0.05)
        energies.append(sim.run(25.0, progress=False).energies())
    elastic, relaxed = energies
    assert relaxed["strain"] == pytest.approx(0.6 * elastic["strain"], rel=1e-9)
    assert relaxed["broken"] == pytest.approx(0.4 * elastic["strain"], rel=5e-3)


@pytest.mark.parametrize("name", ["exponential", "viscoelastic"])
def test_threads_and_checkpoints_change_nothing(name, tmp_path):
    """Two threads need 40 000 nodes; a crack opens between the checkpoint and the end."""
    lattice = fh.Lattice(SPACING, (-52.0, -50.0), (52.0, 50.0))
    start = {"v": ["0.05*sin(3*x)*cos(2*y)", "0.05*cos(5*x*y)"]}
    model = fh.Elastic(fh.Kernel(2 * SPACING, 1), 1.0, law=law_of(name))
    cracks = [fh.Crack([(-9.0, 0.3), (9.0, 0.3)], opens=0.9)]
    one, two, resumed = (
        fh.Simulation(lattice, model, fh.Free(), start, cracks=cracks, balance=True, dt=0.1, threads=n)
        for n in (1, 2, 1)
    )
    one.step(6)
    one.save(tmp_path / "a.ckpt")
    resumed.load(tmp_path / "a.ckpt")
    restored = fh.Simulation.restore(tmp_path / "a.ckpt")
    for sim, steps in ((one, 9), (two, 15), (resumed, 9), (restored, 9)):
        sim.step(steps)
        for field in ("u", "damage"):
            np.testing.assert_array_equal(sim.fields[field], one.fields[field])
        assert sim.energies() == one.energies() and sim.balance() == one.balance()
    other = fh.Elastic(fh.Kernel(2 * SPACING, 1), 1.0, law=fh.ViscoelasticBond(0.3, 2.0))
    with pytest.raises(fh.FarhorizonError, match="law"):
        fh.Simulation(lattice, other, fh.Free(), start, cracks=cracks, balance=True, dt=0.1).load(tmp_path / "a.ckpt")


@pytest.mark.slow  # like all tests of single precision
@pytest.mark.parametrize("name", LAWS)
def test_single_precision(name):
    """The fields agree to the precision of float32."""
    runs = []
    for real in ("float64", "float32"):
        model = fh.Elastic(fh.Kernel(2 * SPACING, 1), 1.0, law=law_of(name))
        runs.append(fh.Simulation(box(), model, fh.Free(), dtype=real, **blast(box(), 0.15)).run(8.0, progress=False))
    one, two = (sim.fields["u"] for sim in runs)
    np.testing.assert_allclose(two, one, rtol=0, atol=1e-4 * np.abs(one).max())


def test_functions_know_step_and_length():
    """A bond that remembers how long it has been stretched by more than 1 %, and is softer the longer it is."""
    law = defined(
        lambda stretch, length, age: stretch / (1 + length + age),
        history={"age": 0.0},
        update=lambda stretch, before, age, dt: age + dt * (min(stretch, before) > 0.01),
    )()
    stretches = np.where(np.arange(40) < 10, 0.0, 0.02)
    energies, dt = pulled(law, stretches)
    age = dt * np.maximum(np.arange(40) - 10, 0)
    stored = stretches**2 / (1 + SPACING + age) / 2
    np.testing.assert_allclose(energies["strain"][12:40], stored[11:39], rtol=1e-9)


def test_asking_for_forces_leaves_histories():
    """What is computed from a state between steps must not move it."""
    lattice = box()
    model = fh.Elastic(fh.Kernel(2 * SPACING, 1), 1.0, law=law_of("viscoelastic"))
    sims = [fh.Simulation(lattice, model, fh.Free(), **blast(lattice)) for _ in range(2)]
    for sim in sims:
        sim.run(7.0, progress=False)
    for _ in range(3):
        sims[0].engine.apply(sims[0].engine.current)
        sims[0].energies()
    for sim in sims:
        sim.run(9.0, progress=False)
    np.testing.assert_array_equal(sims[0].fields["u"], sims[1].fields["u"])


# --- cases and bad input ------------------------------------------------------------------------------------------

CASE = """
units = { length = "m", time = "s", mass = "kg" }
[lattice]
spacing = 0.5
lower = [-4.0, -4.0]
upper = [4.0, 4.0]
[model]
type = "elastic"
young = 1.0
kernel = { horizon = 1.0, exponent = 1 }
law = { type = "viscoelastic-bond", relaxing = 0.4, time = "2000 ms" }
[boundary]
all = { type = "free" }
[run]
until = 1.0
"""


def test_case_of_a_law():
    sim = Case(CASE).simulation()
    assert sim.model.law == fh.ViscoelasticBond(0.4, 2.0)
    assert "ViscoelasticBond(relaxing=0.4, time=2.0)" in " ".join(str(sim.check().details).split())


def test_case_of_a_law_of_a_user(monkeypatch):
    monkeypatch.setitem(fh.BondLaw.known, "Yielding", Yielding)  # other tests examine all laws of case files
    old = 'type = "viscoelastic-bond", relaxing = 0.4, time = "2000 ms"'
    assert Case(CASE.replace(old, 'type = "yielding", limit = 0.01')).simulation().model.law == Yielding(0.01)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("= 0.4", "= 1.4", r"model\.law\.relaxing"),
        ('"2000 ms"', "0.0", r"model\.law\.time"),
        ('"viscoelastic-bond"', '"viscous"', r"model\.law"),
        ("young = 1.0", "young = 1.0\ncritical_stretch = 0.1", r"model\.critical_stretch: a law says itself"),
        ("young = 1.0", 'young = 1.0\npoisson = 0.3\nmaterial = "state-based"', r"bonds of this material have no law"),
    ],
)
def test_bad_cases_of_laws(old, new, words):
    assert CASE.count(old) == 1
    with pytest.raises(fh.InputError, match=words):
        Case(CASE.replace(old, new)).simulation()


def test_limits_of_the_laws():
    for law in (fh.BilinearSoftening, fh.ExponentialSoftening):
        with pytest.raises(fh.InputError, match=r"law\.onset"):
            law(0.0, 1.0)
        with pytest.raises(fh.InputError, match=r"law\.final"):
            law(0.1, 0.1)


def defined(force, **functions):
    """A law without a name in files."""
    body = {"force": staticmethod(force)} | {
        name: staticmethod(value) if callable(value) else value for name, value in functions.items()
    }
    law = type("Defined", (fh.BondLaw,), body | {"__module__": __name__}, offered=False)
    return dataclass(frozen=True)(law)


SOFT = 0.5


@numba.njit
def halved(x):
    return 0.5 * x


def test_functions_of_numba_may_be_called():
    assert defined(lambda stretch: halved(stretch))().course([0.01])["force"] == 0.005


@pytest.mark.parametrize(
    ("force", "functions", "words"),
    [
        (lambda stretch: np.array([stretch, 1.0])[0], {}, "Defined.force takes memory"),
        (lambda stretch: sum([stretch for _ in range(3)]), {}, "Defined.force takes memory"),
        (lambda stretch: stretch.real_part, {}, "Numba does not compile Defined.force"),
        (lambda stretch: math.sqrt(0.3 - stretch), {}, r"force is not a number at the stretch 0\.3"),
        (lambda stretch: (stretch, stretch), {}, r"Defined.force does not return 1 number"),
        (lambda stretch: 2 * stretch, {}, r"stiffer than the bond .*slope 2"),
        (lambda stretch: 0.5 * stretch + 0.1, {}, r"a force without a stretch"),
        (lambda stretch: 0.5 * stretch, {"energy": lambda stretch: stretch**2}, r"not the derivative of the energy"),
        (
            lambda stretch, a: stretch * (1 - a),
            {"history": {"a": 0.0}, "update": lambda stretch, a: (a, stretch)},
            r"Defined.update does not return 1 number",
        ),
        (lambda stretch: 0.9 * stretch, {"elastic_limit": 0.1}, r"springs that remember nothing"),
        (lambda stretch, length: math.sqrt(length - 0.3) * stretch / 2, {}, "of length 0.25"),
    ],
)
def test_laws_that_cannot_be_used(force, functions, words):
    with pytest.raises(fh.InputError, match=words):
        law = defined(force, **functions)()
        model = fh.Elastic(fh.Kernel(0.5, 1), 1.0, law=law)
        fh.Simulation(fh.Lattice(0.25, (-2.0, -2.0), (2.0, 2.0)), model, fh.Free())


def test_laws_that_depend_on_what_is_not_given():
    bound = 0.3
    with pytest.raises(TypeError, match=r"asks for strain, which is not given; there are stretch, length"):
        defined(lambda strain: strain)
    with pytest.raises(TypeError, match=r"Defined.force asks for before"):
        defined(lambda stretch, before: stretch - before)
    with pytest.raises(TypeError, match="reads the variable SOFT"):
        defined(lambda stretch: SOFT * stretch)
    with pytest.raises(TypeError, match="reads the variable bound"):
        defined(lambda stretch: bound * stretch)
    with pytest.raises(TypeError, match=r"needs a static method force"):
        type("Defined", (fh.BondLaw,), {"__module__": __name__}, offered=False)
    with pytest.raises(TypeError, match=r"needs a static method update"):
        defined(lambda stretch, a: stretch - a, history={"a": 0.0})


def test_a_law_that_ends_in_a_run_is_named():
    """A force that is not a number only at a history that trials do not reach."""

    def force(stretch, steps):
        return stretch * math.sqrt(1.0 if steps < 1500 else -1.0)

    law = defined(force, history={"steps": 0.0}, update=lambda stretch, steps: steps + 1)()
    lattice = box()
    model = fh.Elastic(fh.Kernel(2 * SPACING, 1), 1.0, law=law)
    sim = fh.Simulation(lattice, model, fh.Free(), {"v": ["1e-3*exp(-x**2-y**2)", 0.0]}, dt=0.1)
    with pytest.raises(fh.UnstableError, match=r"u = nan near \[.*likely cause: .*Defined\(\)"):
        sim.run(200.0, progress=False)


def test_where_laws_are_not_available():
    model = fh.Elastic(fh.Kernel(2.0, 1), 1.0, law=law_of("bilinear"))
    with pytest.raises(fh.InputError, match="thermal strain"):
        model.heated()
    with pytest.raises(fh.InputError, match=r"model\.law"):
        fh.Elastic(fh.Kernel(2.0, 1), 1.0, law="bilinear")
    with pytest.raises(fh.InputError, match="surfaces are corrected only"):
        fh.Elastic(fh.Kernel(2.0, 1), 1.0, law=law_of("bilinear"), surface="energy")

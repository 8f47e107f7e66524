"""Sources and conductivities that depend on the field, against other solvers and in closed form."""

import math
import os
from fractions import Fraction

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.inputs import expressions
from helpers import fitted_rate

SEED = int(os.environ.get("FARHORIZON_SEED", np.random.default_rng().integers(2**31)))
LINE = fh.Lattice(0.5, -8.0, 8.0)
HOT = {"u": "exp(-x**2)"}
LAW = "1 + 2*u + 0.5*u**2"


def named(name, function):
    """Return a function with another name."""
    function.__name__ = name
    return function


def conductivity(u):
    return 1 + 2 * u + 0.5 * u**2


def bell(x):
    return np.exp(-((x / 0.3) ** 2))


def bar(count, until, source=lambda u: 0 * u, law=conductivity):
    """Temperature of an insulated bar from 0 to 1 by finite volumes whose faces have the conductivity of the mean of
    their cells, and an implicit method of variable order.
    """
    h = 1 / count
    x = (np.arange(count) + 0.5) * h

    def rate(t, u):
        flux = law((u[1:] + u[:-1]) / 2) * np.diff(u) / h
        return (np.append(flux, 0) - np.append(0, flux)) / h + source(u)

    return solve_ivp(rate, (0, until), bell(x), method="BDF", rtol=1e-9, atol=1e-11).y[:, -1]


@pytest.fixture(scope="module")
def exact():
    return {"0": bar(1024, 0.05), "u*(3 - 4*u)": bar(1024, 0.05, lambda u: u * (3 - 4 * u))}


@pytest.mark.parametrize("source", ["0", "u*(3 - 4*u)"])
@pytest.mark.parametrize("as_text", [True, False])
def test_a_bar_is_that_of_finite_volumes_to_second_order(source, as_text, exact):
    """Insulated ends are the planes of symmetry of a periodic row; heat is conserved to rounding."""
    errors, counts, law = [], (16, 32, 64), LAW if as_text else fh.OfField(conductivity)
    for n in counts:
        h = 1 / n
        lattice, start = fh.Lattice(h, -1 + h / 2, 1 - h / 2), {"u": bell}
        given = {"sources": [] if source == "0" else [source if as_text else fh.OfField(lambda u, x: u * (3 - 4 * u))]}
        model = fh.Heat(fh.Kernel(2 * h), conductivity=law)
        sim = fh.Simulation(lattice, model, fh.Periodic(), start, **given)
        dt = 0.05 / np.ceil(0.05 / sim.dt)
        sim = fh.Simulation(lattice, model, fh.Periodic(), start, **given, dt=dt, balance=True)
        sim.run(0.05, progress=False)
        errors.append(np.abs(sim.fields["u"][n:] - exact[source].reshape(n, -1).mean(1)).max())
        found = sim.balance()
        assert abs(found["residual"]) < 1e-11 and "conductivity" not in found
        if source == "0":
            assert abs(found["stored"]) < 1e-11
        else:
            assert found["source"] == pytest.approx(found["stored"], abs=1e-11)
    assert errors[-1] < 1e-4 and fitted_rate(1 / np.array(counts), errors) > 1.8


def test_steps_are_those_of_a_plain_program():
    """A plate with a crack, a hole, free and held sides, a fluid, a heat capacity that varies and a conductivity that
    is the product of a law and a coefficient: bond by bond.
    """
    rng = np.random.default_rng(SEED)
    print(f"seed {SEED}")
    lattice = fh.Lattice(1.0, (0.0, 0.0), (9.0, 8.0), body=fh.Box((-1, -1), (10, 9)) - fh.Disc(1.2, (6.0, 5.0)))
    there = lattice.mask
    density, factor, u = *np.exp(rng.uniform(-1, 1, (2, *lattice.shape))), rng.uniform(0, 1, lattice.shape)
    held, crack = 0.7, [(-1.0, 3.5), (4.5, 3.5)]
    sim = fh.Simulation(
        lattice,
        fh.Heat(fh.Kernel(1.0), density=density, conductivity=LAW),
        {"x-": fh.Fixed(held), "x+": fh.Free(), "y": fh.Free()},
        {"u": u},
        cracks=[crack],
        coefficient=factor,
        rule="arithmetic",
        constraints=[fh.Convection("y+", 0.4, 2.0)],
    )
    stencil = fh.Heat(fh.Kernel(1.0)).stencil(1.0, 2)
    whole = lambda v: v + v**2 + v**3 / 6  # noqa: E731 (integral of the conductivity)
    u = np.where(there, u, 0.0)
    for _ in range(5):
        rate = np.zeros(lattice.shape)
        for at in zip(*np.nonzero(there), strict=True):
            for offset, weight in zip(stencil.offsets, stencil.weights, strict=True):
                i, j = np.array(at) + offset
                if {at[1], j} == {3, 4} and min(at[0], i) <= 4:
                    continue
                if i < 0 and 0 <= j <= 8:  # what is held there goes on as the edge
                    rate[at] += weight * (factor[at] + factor[0, j]) / 2 * (whole(held) - whole(u[at]))
                elif 0 <= i <= 9 and 0 <= j <= 8 and there[i, j]:
                    rate[at] += weight * (factor[at] + factor[i, j]) / 2 * (whole(u[i, j]) - whole(u[at]))
        rate[:, -1] += 0.4 * (2.0 - u[:, -1])
        u = u + sim.dt * np.where(there, rate / density, 0.0)
        sim.step()
        np.testing.assert_allclose(sim.fields["u"][there], u[there], rtol=0, atol=1e-12)


def test_the_balance_says_through_which_sides_it_flows():
    """A bar of conductivity k(u) between two temperatures comes to a steady flow, the integral of k over the length; a
    decay acts on the temperature itself.
    """
    lattice = fh.Lattice(0.5, 0.25, 4.75)
    model = fh.Heat(fh.Stencil.finite_difference(1), conductivity=LAW)
    held = [fh.Temperature("x-", 1.0, "node"), fh.Temperature("x+", 0.25, "node")]
    sim = fh.Simulation(lattice, model, fh.Free(), {"u": 0.5}, constraints=held, balance=True)
    sim.run(until=60.0, progress=False)
    one, begun = sim.balance(), sim.time
    sim.step(100)
    two, t = sim.balance(), sim.time - begun
    flow = (1 + 1 + 1 / 6 - (0.25 + 0.25**2 + 0.25**3 / 6)) / 4.5
    assert two["constraint[0]"] - one["constraint[0]"] == pytest.approx(flow * t, rel=1e-8)
    assert two["constraint[0]"] - one["constraint[0]"] == pytest.approx(-two["constraint[1]"] + one["constraint[1]"])
    assert abs(two["residual"]) < 1e-10
    fading = fh.Diffusion(fh.Stencil.finite_difference(1), "1 + u")
    fading.reaction = 0.3
    sim = fh.Simulation(lattice, fading, fh.Free(), {"u": 2.0}, balance=True)
    sim.step(10)
    np.testing.assert_allclose(sim.fields["u"], 2.0 * (1 - 0.3 * sim.dt) ** 10, rtol=1e-12)
    assert abs(sim.balance()["residual"]) < 1e-12


def test_a_crack_that_opens_stops_the_flow():
    lattice = fh.Lattice(1.0, (0.0, 0.0), (9.0, 8.0))
    crack = fh.Crack([(-9.0, 3.5), (19.0, 3.5)], opens=1.0)
    sim = fh.Simulation(
        lattice, fh.Heat(fh.Kernel(2.0), conductivity=LAW), fh.Free(), {"u": "exp(-y)"}, cracks=[crack], dt=0.05
    )
    sim.step(20)
    below = [sim.fields["u"][:, :4].sum()]
    sim.step(20)
    below.append(sim.fields["u"][:, :4].sum())
    sim.step(20)
    below.append(sim.fields["u"][:, :4].sum())
    assert below[0] == pytest.approx(below[1], rel=1e-13) and below[1] == pytest.approx(below[2], rel=1e-13)
    assert 10 * np.exp(-np.arange(4)).sum() > below[0] + 0.1


def test_a_uniform_field_follows_its_differential_equation():
    """Logistic growth by Euler's method, and a pendulum by velocity Verlet, step by step."""
    lattice = fh.Lattice(1.0, -6.0, 6.0)
    spread = fh.Simulation(lattice, fh.Diffusion(fh.Kernel(2.0)), fh.Free(), {"u": 0.01}, sources=["2*u*(1 - u)"])
    u = 0.01
    for _ in range(200):
        spread.step()
        u += spread.dt * 2 * u * (1 - u)
    np.testing.assert_allclose(spread.fields["u"], u, rtol=1e-12)
    assert abs(u - 1) < 1e-6
    swing = fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), fh.Periodic(), {"u": 2.0}, sources=["-3*sin(u)"])
    u, before = 2.0, 2.0 - swing.dt**2 / 2 * 3 * np.sin(2.0)
    for _ in range(100):
        swing.step()
        u, before = 2 * u - before - swing.dt**2 * 3 * np.sin(u), u
    np.testing.assert_allclose(swing.fields["u"], u, rtol=0, atol=1e-11)


def test_fronts_of_fisher_advance_at_their_speed():
    """The least ``growth(k) / k`` of exp(-k x), on the lattice and with Euler's step, less the delay
    ``3 / (2 k) log(t)`` (Bramson 1983).
    """
    lattice = fh.Lattice(0.5, 0.0, 120.0)
    sim = fh.Simulation(
        lattice, fh.Diffusion(fh.Kernel(1.0)), fh.Free(), {"u": "where(x < 3, 1, 0)"}, sources=["u*(1-u)"]
    )
    front = []
    for until in (30.0, 50.0):
        sim.run(until=until, progress=False)
        front.append(np.interp(-0.5, -sim.fields["u"], lattice.axes[0]))
    stencil, k = fh.Diffusion(fh.Kernel(1.0)).stencil(0.5, 1), np.linspace(0.5, 1.5, 10_001)[:, None]
    rates = 1 + (stencil.weights * (np.cosh(0.5 * k * stencil.offsets[:, 0]) - 1)).sum(1) / 0.5**2
    speeds = np.log(1 + sim.dt * rates) / sim.dt / k[:, 0]
    expected = 20.0 * speeds.min() - 1.5 / k[speeds.argmin(), 0] * np.log(50 / 30)
    assert (front[1] - front[0]) == pytest.approx(expected, rel=0.01)


def test_beside_layers_a_law_that_is_constant_there_is_as_in_a_larger_domain():
    """A conductivity that differs only where it is hot, and a source that burns out, in the middle."""
    law = "1 + where(u > 0.2, 5*(u - 0.2)**2, 0)"
    source = "where(x**2 + y**2 < 9, u*(1 - u), 0)"
    start = {"u": "exp(-(x**2 + y**2)/6)"}
    fields = []
    for half in (12.0, 36.0):
        lattice = fh.Lattice(0.5, (-half, -half), (half, half))
        sim = fh.Simulation(
            lattice,
            fh.Heat(fh.Kernel(1.0), conductivity=law),
            fh.LatticePML(nodes=12),
            start,
            sources=[source],
            dt=0.01,
        )
        sim.run(until=3.0, progress=False)
        inside = (np.abs(lattice.axes[0]) <= 12.0).nonzero()[0]
        fields.append(sim.fields["u"][np.ix_(inside, inside)])
    assert np.abs(fields[0] - fields[1]).max() < 1e-5 * fields[1].max()


def test_a_checkpoint_keeps_texts(tmp_path):
    lattice = fh.Lattice(0.25, -4.0, 4.0)
    model = fh.Heat(fh.Kernel(0.5), conductivity=LAW)
    sim = fh.Simulation(lattice, model, fh.Free(), {"u": "exp(-x**2)"}, sources=["u*(1 - u)"])
    sim.step(20)
    sim.save(tmp_path / "a.ckpt")
    again = fh.Simulation.restore(tmp_path / "a.ckpt")
    for one in (sim, again):
        one.step(20)
    assert np.array_equal(sim.fields["u"], again.fields["u"])


CASE = """
lattice = { spacing = 0.25, lower = [-4.0], upper = [4.0] }
model = { type = "heat", kernel = { horizon = 0.5 }, conductivity = "1 + 2*u + 0.5*u**2" }
initial = { u = "exp(-x**2)" }
boundary = { all = { type = "free" } }
source = [{ value = "u*(1 - u)" }]
run = { until = 0.2 }
"""


def test_case_files_have_them_too(tmp_path):
    (tmp_path / "a.toml").write_text(CASE)
    one = Case.read(tmp_path / "a.toml").simulation()
    model = fh.Heat(fh.Kernel(0.5), conductivity=fh.OfField(LAW))
    two = fh.Simulation(
        one.lattice, model, fh.Free(), {"u": "exp(-x**2)"}, sources=[fh.OfField("u*(1 - u)")], dt=one.dt
    )
    for sim in (one, two):
        sim.step(20)
    assert np.array_equal(one.fields["u"], two.fields["u"])
    assert one.certificate().reason.endswith("as at the background, without sources")


# --- functions of users, by name ---------------------------------------------------------------------------------


@fh.function
def ignited(u, x):
    """What is hotter than 0.3 burns, faster on one side: with branches, as numbers have them."""
    return (2 + math.tanh(x)) * (u - 0.3) * (1 - u) if u > 0.3 else 0.0


@fh.function
def tabled(u):
    """As `1 + u/2` by what Numba does not compile."""
    return {"slope": Fraction(1, 2)}["slope"] * u + 1


@pytest.mark.parametrize(
    ("conductivity", "source", "same"),
    [
        ("1 + u/2", "ignited(u, x)", ("1 + u/2", "where(u > 0.3, (2 + tanh(x))*(u - 0.3)*(1 - u), 0)")),
        ("tabled(u)", "0*u", ("1 + u/2", "0*u")),
    ],
)
def test_a_function_by_its_name_is_the_expression_that_it_stands_for(conductivity, source, same, tmp_path):
    """Compiled or not, also in case files and checkpoints, which keep the name."""
    law, line = fh.Kernel(0.5), fh.Lattice(0.25, -4.0, 4.0)
    runs = [
        fh.Simulation(line, fh.Heat(law, conductivity=k), fh.Free(), {"u": "exp(-x**2)"}, sources=[w], dt=0.01)
        for k, w in ((conductivity, source), same)
    ]
    for sim in runs:
        sim.step(40)
    np.testing.assert_allclose(runs[0].fields["u"], runs[1].fields["u"], rtol=1e-12)
    runs[0].save(tmp_path / "a.ckpt")
    again = fh.Simulation.restore(tmp_path / "a.ckpt")
    (tmp_path / "a.toml").write_text(
        CASE.replace('"1 + 2*u + 0.5*u**2"', f'"{conductivity}"').replace("u*(1 - u)", source)
    )
    case = Case.read(tmp_path / "a.toml").simulation()
    other = fh.Simulation(case.lattice, case.model, fh.Free(), {"u": "exp(-x**2)"}, sources=[source], dt=case.dt)
    for sim, count in ((runs[0], 10), (again, 10), (case, 20), (other, 20)):
        sim.step(count)
    assert np.array_equal(again.fields["u"], runs[0].fields["u"])
    assert np.array_equal(case.fields["u"], other.fields["u"])


def test_functions_are_compiled_where_that_is_possible():
    u = np.array([0.2, 0.5, np.nan])
    for given, compiled in ((ignited, True), (tabled, False)):
        arrays = [u, 0 * u][: 2 if given is ignited else 1]
        own = expressions.OWN[given.__name__]
        np.testing.assert_allclose(own(*arrays), [given(*one) for one in zip(*arrays, strict=True)], rtol=1e-14)
        assert own.compiled is compiled


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (lambda u: u, r"function: must be a function with a name"),
        (3.0, r"function: must be a function with a name"),
        (named("exp", lambda u: u), r"expressions have this name already; value: exp"),
        (named("u", lambda u: u), r"expressions have this name already"),
        (named("ignited", lambda u: u), r"expressions have this name already"),
        (named("several", lambda *u: u), r"given by position; value: several\(\*u\)"),
        (named("chosen", lambda u, power=2: u), r"without defaults"),
    ],
)
def test_functions_that_have_no_name_of_their_own(given, words):
    with pytest.raises(fh.InputError, match=words):
        fh.function(given)


def test_functions_that_are_not_there_or_fail(tmp_path, monkeypatch):
    with pytest.raises(fh.InputError, match=r"unknown function 'absent'.*import what gives it to fh.function"):
        fh.Simulation(LINE, fh.Heat(fh.Kernel(1.0)), fh.Free(), HOT, sources=["absent(u)"])
    failing = fh.function(named("failing", lambda u: [][int(u)]))
    assert failing.__name__ in expressions.OWN
    with pytest.raises(fh.InputError, match=r"the function failing has failed; value: IndexError"):
        fh.Simulation(LINE, fh.Heat(fh.Kernel(1.0)), fh.Free(), HOT, sources=["failing(u)"])
    sim = fh.Simulation(LINE, fh.Heat(fh.Kernel(1.0)), fh.Free(), HOT, sources=["ignited(u, x)"])
    sim.save(tmp_path / "a.ckpt")
    for table in (expressions.OWN, expressions.FUNCTIONS):
        del table["failing"]
        monkeypatch.delitem(table, "ignited")
    with pytest.raises(fh.InputError, match=r"unknown function 'ignited'"):
        fh.Simulation.restore(tmp_path / "a.ckpt")


# --- bad input ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "more", "words"),
    [
        ({"conductivity": "1 - 2*u"}, {}, r"model.conductivity.*must be positive.*value: -1 at u = 1; limit: > 0"),
        ({"conductivity": "u"}, {}, r"model.conductivity.*must be positive"),
        ({"conductivity": "1 + u*x"}, {}, r"model.conductivity.*x"),
        ({"conductivity": fh.OfField(lambda u, x: u)}, {}, r"model.conductivity.*called with u"),
        ({}, {"sources": ["u*y"]}, r"source.*y"),
        ({}, {"sources": ["log(u - 2)"]}, r"source.*not finite.*value: nan where u = 0, at .*t = 0"),
        ({}, {"sources": ["1/(u - 0.5)"]}, r"source.*not finite.*value: inf where u = 0.5"),
        ({"integrator": "rk4"}, {"sources": ["u"]}, r"model.integrator.*one stage.*forward Euler"),
        ({"density": "1 + u"}, {}, r"model.density"),
        (
            {"conductivity": "1 + u"},
            {"constraints": [fh.Flux("x-", 1.0, kind="mirror")]},
            r"constraints.*a flux is a source",
        ),
    ],
)
def test_what_cannot_be_is_refused_before_the_run(model, more, words):
    with pytest.raises(fh.InputError, match=words):
        fh.Simulation(LINE, fh.Heat(fh.Kernel(1.0), **model), fh.Free(), HOT, **more)


def test_beside_layers_nothing_depends_on_the_field():
    model, layers = fh.Heat(fh.Kernel(1.0)), fh.LatticePML(nodes=8)
    with pytest.raises(fh.InputError, match=r"source: .*does not vanish beside x-.*value: .*limit: 0 within 2 nodes"):
        fh.Simulation(LINE, model, layers, HOT, sources=["u*(1 - u)"])
    sim = fh.Simulation(LINE, fh.Heat(fh.Kernel(1.0), conductivity="1 + u"), layers, HOT)
    with pytest.raises(
        fh.InputError, match=r"conductivity is not constant beside x.*where u = .*t = .*larger near field"
    ):
        sim.run(until=100.0, progress=False)


@pytest.mark.parametrize(
    ("law", "words"),
    [
        ("1.5 - u", r"the conductivity has become negative; value: -?\d.* where u = 1\.\d+, at .*, t = .*limit: > 0"),
        ("1 + u**4", r"the conductivity has risen so far that the time step is unstable; value: .*shorter dt"),
    ],
)
def test_what_becomes_wrong_in_the_run_is_told_at_the_step(law, words):
    sim = fh.Simulation(LINE, fh.Heat(fh.Kernel(1.0), conductivity=law), fh.Free(), HOT, sources=["1 + 0*x"])
    with pytest.raises(fh.InputError, match=words):
        sim.run(until=10.0, progress=False)


def test_vectors_and_several_processes_have_none():
    plane = fh.Lattice(1.0, (-9.0, -9.0), (9.0, 9.0))
    with pytest.raises(fh.InputError, match=r"available for scalar fields"):
        fh.Simulation(plane, fh.Elastic(fh.Kernel(2.0), 1.0), fh.Free(), sources=[fh.OfField("u")])
    with pytest.raises(fh.InputError, match=r"neither|must be an expression or a function"):
        fh.OfField(3.0)

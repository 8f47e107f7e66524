"""Case files: the same run as the Python interface, and clear refusals."""

import tomllib
import warnings
from pathlib import Path

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.case.case import Case

GOOD = """
[lattice]
spacing = 0.25
lower = [-3.0, -3.0]
upper = [3.0, 3.0]
[model]
type = "wave"
[model.kernel]
horizon = 0.75
[initial]
u = "exp(-4*(x**2+y**2))"
[run]
until = 3.0
"""


def test_a_case_is_the_run_of_the_python_interface():
    sim = Case(GOOD).simulation().run(3.0)
    same = fh.Simulation(
        fh.Lattice(0.25, (-3, -3), (3, 3)),
        fh.Wave(fh.Kernel(0.75)),
        fh.LatticePML(until=3.0),
        {"u": lambda x, y: np.exp(-4 * (x**2 + y**2))},
        dt=sim.dt,
    ).run(3.0)
    np.testing.assert_allclose(sim.fields["u"], same.fields["u"], atol=1e-15)


def test_demo_is_the_published_example():
    """The packaged demo is a copy of the example file."""
    root = Path(__file__).parents[2]
    assert (root / "examples" / "two_notches.toml").read_text() == (
        root / "src" / "farhorizon" / "case" / "demo.toml"
    ).read_text()


@pytest.mark.parametrize(
    "old, new, message",
    [
        ("spacing", "spaccing", "did you mean 'spacing'"),
        ("horizon = 0.75", "horizn = 0.75", "did you mean 'horizon'"),
        ("[run]", "[runn]", "did you mean 'run'"),
        ('type = "wave"', 'type = "wave"\nspeeed = 2.0', "did you mean 'speed'"),
        ('type = "wave"', 'type = "wav"', "model"),
        ("0.75", "0.1", "horizon is smaller"),
        ("until = 3.0", "until = -3.0", "run.until"),
        ("until = 3.0", "until = nan", "run.until"),
        ("until = 3.0", "until = 3.0\ndt = 9.0", "above the stable limit"),
        ("exp(", "ecp(", "exp"),
        ("exp(", "__import__('os').system(", "case.toml"),
        ("x**2", "t**2", "depend on t"),
        ("upper = [3.0, 3.0]", "upper = [3.1, 3.0]", "whole number of spacings"),
        ("upper = [3.0, 3.0]", "", "upper"),
        ("[run]", "[boundary]\nw = { type = 'free' }\n[run]", "unknown side"),
        ("[run]", "[boundary]\nall = { type = 'lattice-pml', node = 3 }\n[run]", "did you mean 'nodes'"),
        ("[run]", "[output]\nprobes = [[9.0, 0.0]]\n[run]", "outside the near field"),
        ("[run]", "[output]\npictures = [-1.0]\n[run]", r"output\.pictures\[0\]: the time of the picture"),
        (
            "[run]",
            "[output]\nfields = []\n[run]",
            r"output\.fields: a results file has one field or more; .*limit: u, v",
        ),
        ("exp(-4*(x**2+y**2))", "1 if x>0 else 0", r"initial\.u: 'if \.\.\. else' is not allowed.*write where\("),
        (
            "exp(-4*(x**2+y**2))",
            "2x",
            r"initial\.u: unknown unit; value: x; .*in expressions products are written with \*",
        ),
        ("exp(-4*(x**2+y**2))", "fast", r"initial\.u: unknown name 'fast'.*known: x, y, pi, e"),
        ("[run]", "[output]\nbalance = 'yes'\n[run]", r"output\.balance: must be true or false; value: the text 'yes'"),
        ("[run]", "[output]\ncompress = 1\n[run]", r"output\.compress: must be true or false; value: 1"),
        ("[run]", "[[crack]]\npoints = [[-9.0, 0.1], [9.0, 3.1]]\n[run]", "across the absorbing side"),
        ("[run]", "[run", "not valid TOML"),
    ],
)
def test_mistakes_are_named(old, new, message):
    with pytest.raises(fh.InputError, match=message) as error:
        Case(GOOD.replace(old, new)).simulation()
    assert "case.toml" in str(error.value)


HEAT = """
[lattice]
spacing = 0.1
lower = [0.0, 0.0]
upper = [2.0, 1.0]
[model]
type = "heat"
conductivity = 2.0
specific_heat = 4.0
integrator = "rkc"
stages = 12
[model.kernel]
horizon = 0.3
influence = "linear"
[boundary]
all = { type = "free" }
[[crack]]
points = [[1.0, 0.3], [1.0, 0.7]]
factor = 0.1
opens = 0.02
[[constraint]]
type = "temperature"
side = "x-"
kind = "mirror"
value = "sin(t)"
[[constraint]]
type = "convection"
side = "x+"
transfer = 3.0
value = 5.0
[[constraint]]
type = "temperature"
region = { disc = { radius = 0.15, centre = [1.5, 0.5] } }
value = 1.0
[run]
until = 0.05
"""


def test_heat_case():
    """Model, conditions and cracks with their options are those of the Python interface."""
    case = Case(HEAT)
    model = case.model
    assert isinstance(model, fh.Heat) and model.coefficient == 0.5 and model.integrator == fh.RungeKuttaChebyshev(12)
    [crack] = case.setup.cracks
    assert (np.array(crack.cut.points).tolist(), crack.factor, crack.opens) == ([[1.0, 0.3], [1.0, 0.7]], 0.1, 0.02)
    left, right, inside = case.setup.constraints
    assert (
        isinstance(left.value, fh.Expression)
        and left.kind == "mirror"
        and right.transfer == 3.0
        and isinstance(inside.where, fh.Disc)
    )
    case.simulation().run(0.05, progress=False)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('side = "x-"', 'side = "left"', r"constraint\[0\].*x-, x\+"),
        ("transfer = 3.0", "", r"constraint\[1\].transfer"),
        ('type = "convection"\nside = "x+"', 'type = "insulated"\nside = "x+"', r"constraint\[1\].value"),
        ("conductivity = 2.0", "conductivity = -2.0", "model.conductivity: must be finite and positive"),
        ("stages = 12", "stages = 1", "limit: 2 to 1000"),
        ("factor = 0.1", "factor = 2.0", "crack.factor"),
        ("transfer = 3.0", "transfr = 3.0", "did you mean 'transfer'"),
    ],
)
def test_bad_heat_case(old, new, message):
    with pytest.raises(fh.InputError, match=message):
        Case(HEAT.replace(old, new)).simulation()


ELASTIC = """
[lattice]
spacing = 0.5
lower = [-5.0, -5.0]
upper = [5.0, 5.0]
[model]
type = "elastic"
material = "state-based"
young = 2.0
poisson = 0.3
density = 1.5
[model.kernel]
horizon = 1.0
exponent = 1
[initial]
u = ["exp(-2*(x**2+y**2))", 0.0]
v = [0, "x*exp(-2*(x**2+y**2))"]
[[source]]
value = [0.0, "exp(-2*(x**2+y**2))*sin(t)"]
[run]
until = 3.0
"""


def test_elastic_case():
    """The entries of a list are the components of a field."""
    sim = Case(ELASTIC).simulation().run(3.0, progress=False)

    def bump(x, y):
        return np.exp(-2 * (x**2 + y**2))

    model = fh.Elastic(fh.Kernel(1.0, 1), 2.0, 0.3, density=1.5, material="state-based")
    same = fh.Simulation(
        fh.Lattice(0.5, (-5, -5), (5, 5)),
        model,
        initial={"u": lambda x, y: [bump(x, y), 0 * x], "v": lambda x, y: [0 * x, x * bump(x, y)]},
        sources=[fh.Source(lambda x, y: [0 * x, bump(x, y)], np.sin)],
        dt=sim.dt,
        boundary=sim.settled.boundary,
    ).run(3.0, progress=False)
    np.testing.assert_allclose(sim.fields["u"], same.fields["u"], rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("poisson = 0.3", "poissn = 0.3", "did you mean 'poisson'"),
        ("poisson = 0.3", "poisson = 0.7", "model.poisson"),
        ('material = "state-based"', "", "bond-based materials have one Poisson's ratio"),
        (", 0.0]\nv", "]\nv", "not as many entries"),
        ('u = ["exp(-2*(x**2+y**2))", 0.0]', 'u = "exp(-2*(x**2+y**2))"', "one entry per component"),
        ('"x*exp(-2*(x**2+y**2))"', '"t*x"', "depend on t"),
        ('value = [0.0, "exp(-2*(x**2+y**2))*sin(t)"]', 'value = "sin(t)"', "one entry per component"),
        ('type = "elastic"', 'type = "wave"', "unknown key"),
    ],
)
def test_bad_elastic_case(old, new, message):
    assert old in ELASTIC
    with pytest.raises(fh.InputError, match=message):
        Case(ELASTIC.replace(old, new)).simulation().run(0.1, progress=False)


BREAKING = """
[lattice]
spacing = 0.5
lower = [-6.0, -6.0]
upper = [6.0, 6.0]
[model]
type = "elastic"
young = 2.0
nonlinear = true
critical_stretch = 0.01
[model.kernel]
horizon = 1.0
exponent = 1
[[crack]]
points = [[-2.0, 0.25], [2.0, 0.25]]
[[source]]
value = [0.0, "0.1*y*exp(-(x**2+y**2))*sin(t)"]
[run]
until = 6.0
[output]
balance = true
"""


@pytest.mark.parametrize(
    ("words", "options"),
    [("", {}), ('coefficient = "where(x > 1, 0.5, 1)"\nrule = "harmonic"\n', {"rule": "harmonic"})],
)
def test_case_of_bonds_that_break(words, options):
    case = Case(words + BREAKING)
    assert case.fields == ("u", "damage")
    sim = case.simulation().run(6.0, progress=False)
    lattice = fh.Lattice(0.5, (-6, -6), (6, 6))
    if words:
        options = {"coefficient": np.where(lattice.coordinates()[0] > 1, 0.5, 1.0), **options}
    same = fh.Simulation(
        lattice,
        fh.Elastic(fh.Kernel(1.0, 1), 2.0, nonlinear=True, critical_stretch=0.01),
        balance=True,
        **options,
        dt=sim.dt,
        cracks=[[[-2.0, 0.25], [2.0, 0.25]]],
        sources=[fh.Source(lambda x, y: [0 * x, 0.1 * y * np.exp(-(x**2 + y**2))], np.sin)],
    ).run(6.0, progress=False)
    assert sim.broken_bonds == same.broken_bonds > 10
    np.testing.assert_array_equal(sim.fields["damage"], same.fields["damage"])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("critical_stretch", "critical_strech", "did you mean 'critical_stretch'"),
        ("critical_stretch = 0.01", "critical_stretch = -0.01", "model.critical_stretch"),
        ("critical_stretch = 0.01", "critical_stretch = 0.01\nfracture_energy = 1.0", "two names of one thing"),
        ("nonlinear = true", 'nonlinear = "perhaps"', "model.nonlinear"),
        ("nonlinear = true", 'nonlinear = true\npoisson = 0.3\nmaterial = "state-based"', "have no nonlinear"),
        ("points = [[-2.0, 0.25], [2.0, 0.25]]", "points = [[-2.0, 0.25], [2.0, 0.25]]\nfactor = 0.5", "whole or cut"),
        ("balance = true", 'fields = ["u", "solid"]', "has no such field"),
    ],
)
def test_bad_case_of_bonds_that_break(old, new, message):
    assert old in BREAKING
    with pytest.raises(fh.InputError, match=message):
        Case(BREAKING.replace(old, new)).simulation()


def test_damage_is_a_field_of_bonds_that_break():
    with pytest.raises(fh.InputError, match="has no such field"):
        Case(
            BREAKING.replace("nonlinear = true\ncritical_stretch = 0.01\n", "").replace(
                "balance = true", 'fields = ["u", "damage"]'
            )
        )


def test_a_run_to_the_static_state_has_a_latest_end():
    text = GOOD.replace("until = 3.0", 'until = "static"\nlimit = 40.0\ntolerance = 0.01')
    case = Case(text)
    assert case.end == 40.0 and case.to_rest == {"tolerance": 0.01, "limit": 40.0}
    assert case.setup.boundary["x-"].until == 40.0
    for old, new, message in (
        ("limit = 40.0\n", "", "a latest end"),
        ('"static"', "3.0", r"run\.tolerance: only a run to the static state"),
        ("= 0.01", "= -0.01", r"run\.tolerance: must be positive"),
    ):
        with pytest.raises(fh.InputError, match=message):
            Case(text.replace(old, new))


def test_sides_without_keys_have_their_defaults_without_a_word():
    """A tuple as a default is a list in a file, which must not cause a warning of Pydantic."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        case = Case(GOOD.replace("[run]", '[boundary]\nall = { type = "higdon" }\n[run]'))
    assert case.setup.boundary["x-"] == fh.Higdon()


def test_a_list_is_for_vectors():
    with pytest.raises(fh.InputError, match="not as many entries"):
        Case(GOOD.replace('u = "exp(-4*(x**2+y**2))"', "u = [1.0, 2.0]"))


BODY = """
[lattice]
spacing = 1.0
lower = [-12.0, -16.0]
upper = [12.0, 0.0]
[model]
type = "correspondence"
young = 1.0
poisson = 0.2
critical_stretch = 0.003
drag = 0.9
[model.kernel]
horizon = 3.717
exponent = 0
influence = "gaussian"
width = 1.0
volume = "full"
[initial]
u = ["1e-4*exp(-(x**2+(y+8)**2)/8)", 0.0]
[boundary]
all = { type = "nonlocal-pml", nodes = 8, cross = 0.1 }
"y+" = { type = "free" }
[[crack]]
points = [[-5.5, 1.0], [-5.5, -1.1]]
[[load]]
type = "traction"
side = "y+"
value = [0.0, -0.01]
between = [[-5.0, 5.0]]
time = "min(t/10, 1)"
[[load]]
type = "body-force"
value = ["1e-5*exp(-x**2-(y+8)**2)", 0.0]
[run]
until = 30.0
[output]
balance = true
probes = [[0.0, -8.0]]
"""


def test_body_case():
    """The keys of `fh.Correspondence` in a file give the same solid."""
    case = Case(BODY)
    assert case.fields == ("u", "damage")
    sim = case.run().run(30.0, progress=False)
    loads = [
        fh.Traction("y+", (0.0, -0.01), [(-5.0, 5.0)], lambda t: min(t / 10, 1)),
        fh.BodyForce((lambda x, y: 1e-5 * np.exp(-(x**2) - (y + 8) ** 2), 0.0)),
    ]
    solid = fh.Correspondence(
        fh.Kernel(3.717, 0, "gaussian", 1.0, volume="full"), 1.0, 0.2, critical_stretch=0.003, drag=0.9
    )
    same = fh.Simulation(
        fh.Lattice(1.0, (-12, -16), (12, 0)),
        solid,
        {"all": fh.NonlocalPML(8, cross=0.1), "y+": fh.Free()},
        {"u": (lambda x, y: 1e-4 * np.exp(-(x**2 + (y + 8) ** 2) / 8), 0.0)},
        loads=loads,
        cracks=[[(-5.5, 1.0), (-5.5, -1.1)]],
        balance=True,
        dt=sim.dt,
    ).run(30.0, progress=False)
    assert same.broken_bonds == sim.broken_bonds > 0
    np.testing.assert_allclose(sim.fields["u"], same.fields["u"], rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("drag = 0.9", "dragg = 0.9", "did you mean 'drag'"),
        ("poisson = 0.2", "poisson = 0.7", "model.poisson"),
        ("critical_stretch = 0.003", "critical_stretch = -1", "model.critical_stretch"),
        ("critical_stretch = 0.003", "critical_stretch = 1e-5", "stretch"),
        ("cross = 0.1", "crosss = 0.1", "did you mean 'cross'"),
        ("cross = 0.1", "cross = 2.0", "boundary.all.cross: is out of range"),
        ('type = "nonlocal-pml", nodes = 8, cross = 0.1', 'type = "higdon"', "no such side"),
        ('side = "y+"', 'side = "x+"', "a traction acts on a free side"),
        ("between = [[-5.0, 5.0]]", "between = [[-5.0, 50.0]]", "beyond the near field"),
        (
            'time = "min(t/10, 1)"',
            'time = "x*t"',
            "load\\[0\\].time: there is no x in a function of t alone; value: x\\*t; remedy: use t",
        ),
        ('time = "min(t/10, 1)"', 'tme = "t"', "did you mean 'time'"),
        ('value = ["1e-5*exp(-x**2-(y+8)**2)", 0.0]', "value = [0.0]", "load\\[1\\].value: not as many entries"),
        (
            'u = ["1e-4*exp(-(x**2+(y+8)**2)/8)", 0.0]',
            'u = "x"',
            "initial.u: a vector field needs one entry per component",
        ),
        ("until = 30.0", "until = 30.0\ndt = 5.0", "run.dt"),
        ("balance = true", 'fields = ["solid"]', "no such field"),
        ("[run]", "[[source]]\nvalue = [0.0]\n[run]", "not as many entries"),
        (
            "points = [[-5.5, 1.0], [-5.5, -1.1]]",
            "points = [[-5.5, 1.0], [-5.5, -1.1]]\nfactor = 0.5",
            "cannot be weakened one by one",
        ),
    ],
)
def test_bad_body_case(old, new, message):
    assert old in BODY
    with pytest.raises(fh.InputError, match=message):
        Case(BODY.replace(old, new)).run()


def test_loads_are_for_elastic_media():
    with pytest.raises(fh.InputError, match="loads act on an elastic medium"):
        Case(GOOD + '[[load]]\ntype = "body-force"\nvalue = [0.0, 0.0]\n')


@pytest.fixture(scope="module")
def validator():
    from jsonschema import Draft202012Validator

    from farhorizon.case.schema import schema

    Draft202012Validator.check_schema(schema())
    return Draft202012Validator(schema())


@pytest.mark.parametrize(
    "path", sorted((Path(__file__).parents[2] / "examples").glob("*.toml")), ids=lambda path: path.stem
)
def test_the_schema_takes_every_example(path, validator):
    assert not list(validator.iter_errors(tomllib.loads(path.read_text())))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("spacing =", "spacings ="),
        ("until = 30.0", 'until = "thirty"'),
        ('"lattice-pml"', '"pml"'),
        ("horizon = 0.75", ""),
    ],
)
def test_the_schema_refuses_what_the_program_refuses(old, new, validator):
    readme = (Path(__file__).parents[2] / "README.md").read_text()
    text = readme.split("```toml\n")[1].split("```")[0]
    assert validator.is_valid(tomllib.loads(text)) and old in text
    spoilt = text.replace(old, new, 1)
    assert not validator.is_valid(tomllib.loads(spoilt))
    with pytest.raises(fh.InputError):
        Case(spoilt)

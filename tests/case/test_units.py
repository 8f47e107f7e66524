"""Numbers with units in case files: the same run as with plain numbers, and refusals of what does not fit."""

import tomllib
from pathlib import Path

import jsonschema
import numpy as np
import pytest

import farhorizon as fh
from farhorizon.arguments import ANY, FIELD, RATE
from farhorizon.case.case import Case
from farhorizon.case.schema import schema
from farhorizon.case.units import Units, unit
from farhorizon.pictures.fields import field_panels
from farhorizon.pictures.panels import Panel
from farhorizon.pictures.style import counted_in, time_text

PLATE = """
[units]
length = "mm"
time = "us"
pressure = "GPa"
[lattice]
spacing = "0.5 mm"
lower = ["-0.5 cm", -3]
upper = [5, "3000 um"]
[model]
type = "elastic"
young = "210 GPa"
poisson = 0.25
density = "7850 kg/m^3"
kernel = { horizon = "1 mm" }
[initial]
u = ["1 um", 0]
v = ["2e-3*exp(-x**2-y**2)", "0 m/s"]
[boundary]
all = { type = "periodic" }
[run]
until = "2 us"
dt = "20 ns"
"""


@pytest.mark.parametrize(
    ("text", "scale"),
    [
        ("mm", 1e-3),
        ("us", 1e-6),
        ("µs", 1e-6),
        ("GPa", 1e9),
        ("kg/m^3", 1.0),
        ("g/cm³", 1e3),
        ("W/(m K)", 1.0),
        ("J/(g·K)", 1e3),
        ("mm^2/s", 1e-6),
        ("1/us", 1e6),
        ("1 / us", 1e6),
        ("us^-1", 1e6),
        ("us**-1", 1e6),
        ("µs⁻¹", 1e6),
        ("K^-1", 1.0),
        ("mm us^-2", 1e9),
        ("mg mm^-3", 1e3),
        ("W m^-1 K^-1", 1.0),
        ("km/h", 1 / 3.6),
        ("bar", 1e5),
        ("t/m**3", 1e3),
    ],
)
def test_units_are_those_of_the_si(text, scale):
    assert unit(text).scale == pytest.approx(scale, rel=1e-14)


@pytest.mark.parametrize(
    "text", ["1/", "K^-", "K^--1", "K^-1^-1", "K⁻", "1/xyz", "1/0", "2/K", "m^-99", "1/(nm^9)^9^9"]
)
def test_what_is_no_unit_is_refused(text):
    with pytest.raises(fh.InputError, match="unknown unit"):
        unit(text)


@pytest.mark.parametrize("text", ["0.1 1/us", "0.1 us^-1", "0.1 us⁻¹", "1e-1 MHz", "+.1  1 / us"])
def test_inverse_units(text):
    case = Case(PLATE, changes={"model.damping": text})
    assert case.parts.model.damping == 0.1
    damping = schema()["$defs"]["ElasticPart"]["properties"]["damping"]
    jsonschema.validate(text, damping)


@pytest.mark.parametrize("text", ["0.1 1/", "0.1 us^-", "0.1 1/xyz"])
def test_inverse_units_that_are_none(text):
    with pytest.raises(fh.InputError, match=r"model\.damping: unknown unit; .*\"1/s\", \"s\^-1\""):
        Case(PLATE, changes={"model.damping": text})


def test_a_number_over_a_unit_says_how_it_is_written():
    with pytest.raises(fh.InputError, match=r'model\.damping: a number over a unit .* remedy: "0\.1 1/us"'):
        Case(PLATE, changes={"model.damping": "0.1/us"})
    for text in ("11/(2+x)", "3/(1+x*x)", "1/max(x, 1)"):  # these remain expressions
        assert Case(PLATE, changes={"model.young": text}).parts.model.young == text


def test_a_case_with_units_is_the_case_in_si():
    """The same plate in plain numbers in metres, seconds and pascals."""
    case = Case(PLATE)
    sim = case.simulation().run(2.0)
    same = fh.Simulation(
        fh.Lattice(5e-4, (-5e-3, -3e-3), (5e-3, 3e-3)),
        fh.Elastic(fh.Kernel(1e-3), young=210e9, poisson=0.25, density=7850.0),
        fh.Periodic(),
        {"u": [1e-6, 0.0], "v": [lambda x, y: 2.0 * np.exp(-1e6 * (x**2 + y**2)), 0.0]},
        dt=2e-8,
    ).run(2e-6)
    np.testing.assert_allclose(sim.fields["u"], 1e3 * same.fields["u"], rtol=0, atol=1e-12)
    assert sim.model.density == 7.85 and np.abs(sim.fields["u"]).max() > 5e-4
    recorded = {"stress": "GPa", "pressure": "GPa", "energy_flux": "GPa mm/us", "speed": "mm/us", "G": "GPa mm"}
    recorded |= {"K_I": "GPa mm^(1/2)", "K_II": "GPa mm^(1/2)"}
    recorded |= {"energy": "GPa mm²", "power": "GPa mm²/us", "force": "GPa mm"}  # per unit thickness
    assert case.unit_names == {"length": "mm", "time": "us", "frequency": "1/us", "u": "mm", "v": "mm/us", **recorded}


def test_temperatures_have_a_zero_of_their_own():
    celsius = Units({"temperature": "degC", "time": "s", "length": "m", "mass": "kg"}, "K")
    assert celsius.number(293.15, "K", FIELD, "u") == 20.0 and celsius.number(20.0, "°C", FIELD, "u") == 20.0
    assert celsius.number(2.0, "W/(m K)", "W/(m*K)", "conductivity") == 2.0
    assert Units({"temperature": "K"}, "K").number(20.0, "degC", FIELD, "u") == 293.15


def test_names_of_derived_units():
    grams = Units({"length": "mm", "time": "us", "mass": "g"}, "m")
    assert grams.number(210.0, "GPa", "Pa", "young") == 0.21  # not 210
    assert grams.name("Pa") == "g/(mm us²)" and grams.name(RATE) == "mm/us" and grams.name("1/s") == "1/us"
    assert grams.name("K") == "" and grams.name(ANY) == ""
    pascals = Units({"length": "mm", "time": "us", "pressure": "GPa"})
    assert pascals.name("Pa") == "GPa" and pascals.name("J/m^2") == "GPa mm" and pascals.name(FIELD) == ""
    assert pascals.number(2.0, "J/m^2", "J/m^2", "fracture_energy") == 2e-6


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"model.density": "5 kg"},
            "model.density: the unit measures something else; value: 5 kg; limit: such as kg/m",
        ),
        ({"lattice.lower": ["2 s", 0]}, r"lattice.lower\[0\]: the unit measures something else"),
        ({"initial.u": ["3 K", 0]}, r"initial.u\[0\]: the unit measures something else"),
        ({"model.young": "3 parsec"}, "model.young: unknown unit; value: parsec"),
        ({"model.kernel.horizon": "3 mm^x"}, "model.kernel.horizon: unknown unit"),
        ({"background": "3 degC"}, "background: the unit measures"),
        ({"source": [{"value": ["3 K", 0]}]}, r"source\[0\].value\[0\]: the case has no unit of temperature"),
        ({"units.length": "kg"}, "units.length: is not a unit of length; value: kg; limit: such as m"),
        ({"units.length": "furlong"}, "units.length: unknown unit"),
        ({"units.mass": "kg"}, "units: the unit of mass follows from one of them; value: pressure, mass"),
        ({"units.colour": "red"}, "unknown key units.colour"),
        ({"units.length": 3}, "units.length: must be a text"),
        ({"units": {}}, "the case has no unit of length"),
    ],
)
def test_units_that_do_not_fit_are_refused(change, message):
    with pytest.raises(fh.InputError, match=message):
        Case(PLATE, changes=change)


def test_a_number_with_a_unit_needs_units():
    with pytest.raises(fh.InputError, match=r"initial.u\[0\]: a number with a unit needs .* remedy: \[units\]"):
        Case(PLATE[PLATE.index("[lattice") :])


def test_texts_stay_texts():
    """Texts for which no number with a unit can stand are left alone."""
    case = Case(PLATE + 'threads = 1\n[lattice.body]\ntext = { text = "5 m", height = "8 mm" }')
    assert case.parts.lattice.body.text.text == "5 m" and case.parts.lattice.body.text.height == 8.0


def test_each_number_has_a_unit_or_none():
    """New numeric keys of the schema need a unit or an entry in this list."""
    none = {
        "coefficient",
        "poisson",
        "critical_stretch",
        "friction",
        "exponent",
        "quality",
        "onset",
        "final",
        "relaxing",
        "modulus",
        "stabilisation",
        "factor",
        "normal",
        "threshold",
        "target",
        "scale",
    }
    none |= {"direction", "polarisation", "strike", "dip", "rake", "cone", "angle", "angles", "cycles", "cross"}
    none |= {"plateau", "reflection", "rcond", "regularization", "tolerance", "compress", "interface", "profile"}
    none |= {"values", "time", "signal", "field"}  # functions of t
    whole = schema()
    numbers = {
        (name, key): found
        for name, table in {"CasePart": whole, **whole["$defs"]}.items()
        for key, found in table.get("properties", {}).items()
        if '"number"' in str(found).replace("'", '"')
    }
    assert {key for (_, key), found in numbers.items() if "unit" not in found} <= none
    for si in {found["unit"] for found in numbers.values() if "unit" in found} - {ANY, FIELD, RATE}:
        assert unit(si).scale == 1.0


def test_the_schema_takes_numbers_with_units():
    data = tomllib.loads(PLATE)
    jsonschema.validate(data, schema())
    data["lattice"]["spacing"] = "wide"
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(data, schema())


def test_finer_cases_keep_their_units():
    case = Case(PLATE).refined(0.25)
    assert case.lattice.spacing == 0.25 and case.parts.model.kernel.horizon == 0.5


def test_pictures_name_the_units():
    axes = [np.arange(4.0), np.arange(3.0)]
    with counted_in({"length": "mm", "time": "us"}):
        figure = field_panels([Panel(time_text(3.0), np.ones((4, 3)))], axes, None)
    panel = figure.axes[0]
    assert (panel.get_xlabel(), panel.get_ylabel(), panel.get_title()) == ("x (mm)", "y (mm)", "3 µs")
    assert time_text(3.0) == "3" and time_text(2e7).endswith("{7}$")


def test_the_tutorial_with_units_is_the_one_without():
    text = (Path(__file__).parents[2] / "docs" / "tutorials" / "pipe.toml").read_text(encoding="utf-8")
    parts = Case(text).parts
    assert (parts.run.until, parts.output.every, parts.background) == (60 * 86400.0, 86400.0, 10.0)
    assert (parts.model.specific_heat, parts.model.conductivity, parts.constraint[0].transfer) == (1000.0, 2.0, 10.0)


COUNTED = """
units = { length = "m", time = "day", mass = "kg" }
lattice = { nodes = [60, 30], box = { lower = [0.0, 0.0], upper = ["100 cm", 0.5] } }
model = { type = "wave", speed = 1.0, kernel = { horizon = 0.05 } }
boundary = { all = { type = "free" } }
run = { until = "48 h" }
"""


def test_nodes_in_the_cells_of_a_box():
    case = Case(COUNTED)
    assert case.lattice.shape == (60, 30) and case.end == 2.0
    np.testing.assert_allclose(case.lattice.lower, 1 / 120)
    finer = case.refined(1 / 120)
    assert finer.lattice.shape == (120, 60) and finer.model.operator.horizon == 0.025


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("60, 30", "60, 31", "lattice.nodes: the counts of nodes do not fit the box"),
        ("nodes = [60, 30], ", "", "give either spacing or nodes and box"),
        ("nodes =", "spacing = 0.1, nodes =", "give either spacing or nodes and box"),
        ("nodes =", "lower = [0.0, 0.0], nodes =", "lattice.lower: nodes in a box determine the bounds"),
    ],
)
def test_other_keys_beside_counts_are_refused(old, new, words):
    with pytest.raises(fh.InputError, match=words):
        Case(COUNTED.replace(old, new))

"""Case files of a thermoelastic solid: the set-ups that they describe, and what is refused."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.case.case import Case

CASE = """
[units]
length = "mm"
time = "us"
mass = "kg"
temperature = "K"

[lattice]
spacing = 0.5
lower = [0.0, -4.0]
upper = [12.0, 4.0]

[model]
type = "thermoelastic"
expansion = "1e-3*(1 + 0.1*x)"
reference = "20 degC"

[model.elastic]
young = "70 GPa"
density = "2700 kg/m^3"
kernel = { horizon = 1.0, exponent = 1 }

[model.heat]
density = "2700 kg/m^3"
specific_heat = "900 J/(kg K)"
conductivity = "2e6 W/(m K)"
integrator = "rkc"
stages = 3
kernel = { horizon = 1.0 }

[initial]
u = ["1e-3*exp(-(x - 6)**2 - y**2)", 0.0]
T = "293.15 + 10*exp(-((x - 6)**2 + y**2)/4)"

[boundary]
all = { type = "free" }

[boundary_T]
y = { type = "periodic" }

[coefficient]
T = "1 + 0.5*(x > 8)"

[[source]]
value = ["1e-9*sin(t)*exp(-(x - 3)**2 - y**2)", 0.0]

[[source]]
field = "T"
value = "1e-9*exp(-(x - 8)**2 - y**2)"

[[constraint]]
type = "temperature"
side = "x-"
value = "293.15 + 5*min(t, 1)"

[run]
until = 1.0

[output]
every = 0.5
"""


def given():
    """Return the same set-up in Python, with numbers in mm, us, kg and K."""
    lattice = fh.Lattice(0.5, (0.0, -4.0), (12.0, 4.0))
    solid = fh.Elastic(fh.Kernel(1.0, exponent=1), young=7e-5, density=2.7e-6)
    heat = fh.Heat(fh.Kernel(1.0), 2.7e-6, 9e-4, 2e-9, fh.RungeKuttaChebyshev(3))
    return fh.Setup(
        lattice,
        fh.Thermoelastic(solid, heat, "1e-3*(1 + 0.1*x)", 293.15),
        {"u": fh.Free(), "T": {"x": fh.Free(), "y": fh.Periodic()}},
        {"u": ["1e-3*exp(-(x - 6)**2 - y**2)", 0.0], "T": "293.15 + 10*exp(-((x - 6)**2 + y**2)/4)"},
        {"u": [["1e-9*sin(t)*exp(-(x - 3)**2 - y**2)", 0.0]], "T": ["1e-9*exp(-(x - 8)**2 - y**2)"]},
        coefficient={"T": "1 + 0.5*(x > 8)"},
        constraints=[fh.Temperature("x-", "293.15 + 5*min(t, 1)")],
    )


def test_a_case_is_its_set_up():
    """The fields are bitwise those of the set-up in Python, with sides, sources and coefficients by field."""
    case = Case(CASE)
    ours, other = case.run(), fh.Simulation.of(given())
    other = fh.Simulation.of(fh.Setup(**{**given().arguments, "dt": ours.dt}))
    for sim in (ours, other):
        sim.step(20)
    for name, values in other.fields.items():
        np.testing.assert_array_equal(ours.fields[name], values)
    assert case.fields == ("u", "T")
    assert case.unit_names["T"] == "K" and case.quantities["u"] == "displacement"
    assert np.ptp(ours.fields["T"]) > 5


def test_a_finer_case_has_as_many_nodes_in_both_horizons():
    finer = Case(CASE).refined(0.25)
    solid, heat = finer.model.elastic, finer.model.heat
    assert (solid.kernel.horizon, heat.operator.horizon, finer.lattice.spacing) == (0.5, 0.5, 0.25)


@pytest.mark.slow
def test_results_have_the_temperature(tmp_path):
    """A run that is interrupted and continued gives the same."""
    case = Case(CASE)
    whole, first = case.run(), case.run()
    whole.run(1.0, 0.5, progress=False, output=tmp_path / "whole.h5")
    first.run(0.5, 0.5, progress=False)
    first.save(tmp_path / "half.ckpt")
    again = case.run()
    again.load(tmp_path / "half.ckpt")
    again.run(1.0, 0.5, progress=False)
    kept = fh.open_results(tmp_path / "whole.h5")
    for name in ("u", "T", "thermal_strain"):
        np.testing.assert_array_equal(kept.field(name, -1), whole.fields[name])
        np.testing.assert_array_equal(again.fields[name], whole.fields[name])


BAD = {
    'temperature = "K"': ('temperature = "degC"', "units.temperature: the heat of deformation depends on the absolute"),
    'reference = "20 degC"': ("", "model.reference: .*the reference is missing"),
    'young = "70 GPa"': ('young = "70 GPa"\ncontact = true', "model.coupled: the heat of deformation"),
    'integrator = "rkc"': ('integrator = "euler"', "model.heat.stages: only Runge-Kutta-Chebyshev has stages"),
    "[boundary_T]\ny =": ("[boundary_T]\nz =", "boundary_T: unknown side; value: z"),
    "conductivity": ("conductance", "unknown key model.heat.conductance; did you mean 'conductivity'"),
    "[coefficient]\nT =": ("[coefficient]\nv =", "coefficient"),
}


@pytest.mark.parametrize("text", BAD)
def test_what_is_wrong_is_named(text):
    wrong, message = BAD[text]
    assert text in CASE
    with pytest.raises(fh.InputError, match=message):
        Case(CASE.replace(text, wrong))


WAVE = """
[lattice]
spacing = 1.0
lower = [-9.0]
upper = [9.0]

[model]
type = "wave"
kernel = { horizon = 2.0 }

[run]
until = 1.0
"""


@pytest.mark.parametrize(
    "more, key",
    [
        ("[initial]\nT = 1.0", "initial.T"),
        ('[boundary_T]\nall = { type = "free" }', "boundary_T"),
        ('[[source]]\nfield = "T"\nvalue = 1.0', "source.field"),
        ("[coefficient]\nT = 1.0", "coefficient"),
    ],
)
def test_others_have_no_temperature_beside(more, key):
    with pytest.raises(fh.InputError, match=f"{key}: only a thermoelastic solid has a second field"):
        Case(f"{WAVE}\n{more}\n")

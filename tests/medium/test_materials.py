"""Named materials: agreement with published wave speeds, their sources, and how models use a name."""

import re
from pathlib import Path

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.medium.materials import Fluid, named

PAGE = (Path(__file__).parents[2] / "docs" / "howto" / "units.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", named())
def test_each_number_has_a_source(name):
    one = named()[name]
    numbers = {key for key, value in vars(one).items() if isinstance(value, float)}
    assert numbers == set(one.sources) and all(re.search(r"\d{4}", source) for source in one.sources.values())


@pytest.mark.parametrize("name", named())
def test_the_page_has_the_numbers(name):
    """Each number is in the row of its material: Young's modulus in GPa, or the speed, Poisson's ratio, and the
    density.
    """
    one = named()[name]
    (row,) = re.findall(rf"^\| `{name}` \|(.*)\|$", PAGE, re.MULTILINE)
    cells = [cell.strip() for cell in row.split("|")]
    fluid = isinstance(one, Fluid)
    first = f"{one.speed:g} m/s" if fluid else f"{one.young / 1e9:g} GPa"
    assert cells[:3] == [first, "" if fluid else f"{one.poisson:g}", f"{one.density:g}"]
    assert all(re.sub(r"[,:].*| \(.*", "", source) in cells[3] for source in one.sources.values())


#: Speeds of long waves, to 5 %: metals from common tables; the S wave of Homalite, 1 200 m/s, and its P wave, 2 498
#: m/s, from Xia, Rosakis and Kanamori (2004), Science 303; PMMA from Xu and Needleman (1994), who give both speeds.
SPEEDS = [
    ("steel", None, 6000, 3200),
    ("aluminium", None, 5910, 3160),
    ("homalite", None, 2498, 1200),
    ("pmma", None, 2090, 1004),
]


@pytest.mark.parametrize(("name", "plane", "fast", "slow"), SPEEDS)
def test_waves_have_the_speeds_that_are_known(name, plane, fast, slow):
    model = fh.Elastic(fh.Kernel(0.01), **named()[name].constants, material="state-based", plane=plane)
    assert model.p_speed == pytest.approx(fast, rel=0.05) and model.s_speed == pytest.approx(slow, rel=0.05)


def test_the_nearest_material_is_told():
    with pytest.raises(AttributeError, match=r"no material 'stel'; did you mean 'steel'.*known: steel, aluminium"):
        fh.materials.stel  # noqa: B018


def test_bonds_refuse_another_ratio_and_say_what_to_do():
    steel = fh.materials.steel
    with pytest.raises(fh.InputError, match=r"0\.25.*leave it out, or give 0\.25, which keeps the modulus"):
        fh.Elastic(fh.Kernel(0.01), **steel.constants)
    model = fh.Elastic(fh.Kernel(0.01), **steel.constants | {"poisson": 0.25})
    assert model.young == steel.young and model.poisson == 0.25


def test_pressures_are_reflected_as_the_impedances_say():
    """From air to water, whose impedance is 3550 times as large, everything is reflected, and the pressure at the wall
    is doubled.
    """
    air, water = fh.materials.air, fh.materials.water
    lattice = fh.Lattice(0.01, -4.0, 1.0)
    x = lattice.coordinates()[0]
    given = {name: np.where(x > 0, water.constants[name], air.constants[name]) for name in air.constants}
    pulse = {"u": "exp(-((x+1.5)/0.2)**2)", "v": f"2*{air.speed}*(x+1.5)/0.04*exp(-((x+1.5)/0.2)**2)"}
    sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(0.02), **given), fh.LatticePML(nodes=12), pulse)
    sim.run(1.6 / air.speed)  # its middle has come 0.1 of air beyond the wall
    assert sim.fields["u"][x > 0.1].max() == pytest.approx(2.0, rel=0.02)


CASE = """
[units]
length = "mm"
time = "us"
pressure = "GPa"
[lattice]
spacing = 1
lower = [-10, -10]
upper = [10, 10]
[model]
type = "elastic"
material = "state-based"
of = "steel"
kernel = { horizon = 2 }
[[material]]
region = { box = { lower = [-10, -10], upper = [10, 0] } }
of = "glass"
young = "60 GPa"
[initial]
u = [0, "1e-3*exp(-x**2-y**2)"]
[boundary]
all = { type = "free" }
[run]
until = 1.0
"""


def test_case_of_named_materials():
    """In millimetres, microseconds and gigapascals; values given beside a name take precedence."""
    case = Case(CASE)
    young, poisson, density = (getattr(case.model, name) for name in ("young", "poisson", "density"))
    below = case.lattice.coordinates()[1] <= 0
    for found, steel, glass in ((young, 210, 60), (poisson, 0.3, 0.2), (density, 7.85, 2.5)):
        np.testing.assert_allclose(found, np.where(below, glass, steel), rtol=1e-14)
    case.simulation().step(3)


def test_case_of_a_fluid():
    text = re.sub(
        r"\[model\].*\[initial\]\nu = .*?\n",
        '[model]\ntype = "wave"\nof = "water"\nkernel = { horizon = 2 }\n',
        CASE,
        flags=re.DOTALL,
    )
    model = Case(text).model
    assert model.speed == pytest.approx(1.4823, rel=1e-14)  # mm/us
    assert model.density == pytest.approx(1 / (998.2 * 1482.3**2) * 1e9, rel=1e-14)  # 1/GPa


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"steel"', '"stele"', "steel"),
        ('[units]\nlength = "mm"\ntime = "us"\npressure = "GPa"\n', "", "states its own units"),
        ('material = "state-based"\n', "", "bond-based materials have one Poisson's ratio"),
        ('"glass"', '"water"', "constants that the model has, too"),
        ('of = "steel"', "young = 1.0\npoisson = 0.3", None),
        ('of = "steel"', "bulk = 1.0\nshear = 1.0", "constants that the model has, too"),
        ('type = "elastic"\nmaterial = "state-based"', 'type = "heat"', "of"),
    ],
)
def test_names_that_do_not_fit(old, new, message):
    assert old in CASE
    text = CASE.replace(old, new)
    if message is None:
        Case(text).simulation()
        return
    with pytest.raises(fh.InputError, match=message):
        Case(text).simulation()

"""Models defined by users: the classes of docs/extending.md, as they are there."""

import json
import re
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import farhorizon as fh
from farhorizon import cli
from farhorizon.case.case import Case
from farhorizon.case.schema import schema
from farhorizon.studies.compare import compare

PAGE = (Path(__file__).parents[2] / "docs" / "extending.md").read_text(encoding="utf-8")
FILE = re.search(r"## A model of your own\n.*?```python\n(.*?)```", PAGE, re.S).group(1)
CASE = """
lattice = { spacing = 0.5, lower = [-9.0, -7.0], upper = [9.0, 7.0] }
model = { type = "klein-gordon", speed = 2.0, mass = 0.8, kernel = { horizon = 1.0 } }
initial = { u = "exp(-(x**2 + y**2)/2)" }
boundary = { all = { type = "lattice-pml", target = 1e-6 } }
run = { until = 12.0 }
output = { every = 6.0 }
"""


@pytest.fixture
def page():
    """The module with the classes, which are registered during a test; `__name__` is set so that annotations can be
    evaluated.
    """
    module = {"__name__": __name__}
    before = dict(fh.LatticeModel.known)
    exec(FILE, module)
    yield module
    fh.LatticeModel.known.clear()
    fh.LatticeModel.known.update(before)


def test_one_short_file():
    """Two models and a run of one in at most 40 lines."""
    assert len(FILE.splitlines()) <= 40


def test_the_case_of_the_page(page):
    text = re.search(r"## A model of your own\n.*?```toml\n(.*?)```", PAGE, re.S).group(1)
    rest = 'lattice = { spacing = 0.5, lower = [-9.0], upper = [9.0] }\ninitial = { u = "exp(-x**2)" }\n'
    rest += "run = { until = 1.0 }\n"
    case = Case(rest + text)
    assert isinstance(case.model, page["KleinGordon"]) and case.model.reaction == case.model.mass**2 > 0
    assert case.fields == ("u",)
    case.simulation().step(3)


def test_dispersion_and_decay(page):
    """Uniform fields oscillate at the frequency of the mass, and decay at the given rate."""
    lattice = fh.Lattice(0.5, -4, 4)
    heavy = fh.Simulation(lattice, page["KleinGordon"](fh.Kernel(1.0), mass=0.8), fh.Periodic(), {"u": 1.0}, dt=0.05)
    heavy.step(100)
    frequency = 2 / 0.05 * np.arcsin(0.8 * 0.05 / 2)
    assert heavy.fields["u"] == pytest.approx(np.cos(frequency * heavy.time), abs=1e-12)
    for integrator in ("euler", "rk4", "rkc"):
        model = page["Decay"](fh.Kernel(1.0), rate=0.3, integrator=integrator)
        sim = fh.Simulation(lattice, model, fh.Periodic(), {"u": 1.0}, dt=0.01)
        sim.step(100)
        # the error of Euler is rate^2 t dt / 2
        assert sim.fields["u"] == pytest.approx(np.exp(-0.3), rel=1e-3 if integrator == "euler" else 1e-6)


def test_compare_check_and_certificate(page):
    model, pulse = page["KleinGordon"](fh.Kernel(2.0), mass=0.5), {"u": lambda x, y: np.exp(-(x**2 + y**2) / 6)}
    setup = fh.Setup(fh.Lattice(1.0, (-12.0, -9.0), (12.0, 9.0)), model, fh.LatticePML(target=1e-6, until=40.0), pulse)
    errors = compare(setup, 40.0, times=[10.0, 20.0, 40.0]).curves
    assert errors["lattice PML"]["error_max_over_run"] < 1e-6
    assert errors["fixed edge"]["error_max_over_run"] > 1e-2
    line = fh.Simulation(fh.Lattice(1.0, -9, 9), model, fh.LatticePML(nodes=6))
    assert line.certificate().verdict == "certified"
    assert "reflection" in fh.Simulation.of(setup).check(until=12.0, budget=5.0).details


@pytest.mark.parametrize("name", ["KleinGordon", "Decay"])
def test_a_checkpoint_holds_it(page, name, tmp_path):
    model = page[name](fh.Kernel(2.0))
    whole, half = (
        fh.Simulation(fh.Lattice(1.0, -15, 15), model, fh.LatticePML(nodes=6), {"u": "exp(-x**2/8)"}) for _ in range(2)
    )
    whole.step(40)
    half.step(20)
    half.save(tmp_path / "state.npz")
    again = fh.Simulation.restore(tmp_path / "state.npz")
    again.step(20)
    assert np.array_equal(again.fields["u"], whole.fields["u"]) and type(again.model) is type(model)
    del fh.LatticeModel.known[name]
    with pytest.raises(fh.InputError, match=rf"{name}.*import the module that defines it first"):
        fh.Simulation.restore(tmp_path / "state.npz")


def test_a_case_file_has_it(page, tmp_path, capsys):
    path = tmp_path / "case.toml"
    path.write_text(CASE, encoding="utf-8")
    model = Case.read(path).model
    assert (type(model), model.speed, model.mass) == (page["KleinGordon"], 2.0, 0.8)
    properties = json.dumps(schema())
    assert "klein-gordon" in properties and '"decay"' in properties
    for command in (
        ["check", str(path), "--budget", "2"],
        ["compare", str(path), "--out", str(tmp_path / "compare")],
        ["run", str(path), "--out", str(tmp_path / "run")],
        ["plot", str(tmp_path / "run" / "case.h5")],
    ):
        assert cli.main(command) == 0, capsys.readouterr()
    for wrong, words in (
        ("mass = 0.8, ma", r"unknown key model.ma; did you mean 'mass'\? known: .*kernel"),
        ('mass = "high", speed', r"model.mass: must be a number"),
        ("mass = -1.0, damping", r"model.mass: must be .*0"),
    ):
        text = CASE.replace("speed = 2.0, mass = 0.8", f"{wrong} = 1.0")
        with pytest.raises(fh.InputError, match=words):
            Case(text)
    decay = CASE.replace(
        '"klein-gordon", speed = 2.0, mass = 0.8', '"decay", rate = 0.2, integrator = "rkc", stages = 7'
    )
    assert Case(decay).model.integrator == fh.RungeKuttaChebyshev(7)
    with pytest.raises(fh.InputError, match=r"unknown type.*klein-gordin.*limit: wave.*klein-gordon"):
        Case(CASE.replace('"klein-gordon"', '"klein-gordin"'))


def test_what_it_must_answer_is_asked_where_it_is_defined():
    before = set(fh.LatticeModel.known)
    with pytest.raises(fh.InputError, match=r"the model Empty has no coefficient and no integrator.*__init__"):
        type("Empty", (fh.LatticeModel,), {})
    with pytest.raises(fh.InputError, match=r"the model Timeless has no integrator"):
        type("Timeless", (fh.LatticeModel,), {"coefficient": 1.0})

    def loose(self, operator, **more): ...

    def clashing(self, operator, stages=3): ...

    for init, word in ((loose, r"\*\*more"), (clashing, "stages=3")):
        with pytest.raises(fh.InputError, match=rf"a parameter that a case file cannot give by its name.*{word}"):
            type("Loose", (fh.Wave,), {"__init__": init})
    for name in ("Wave", "wave", "Correspondence"):
        with pytest.raises(fh.InputError, match=rf"there is a model '{name.lower()}' already"):
            type(name, (fh.Wave,), {})
    assert set(fh.LatticeModel.known) == before and fh.LatticeModel.known["Wave"] is fh.Wave


def test_what_was_left_out_is_named_before_any_work(page):
    class Forgetful(fh.LatticeModel):
        def __init__(self, operator, strength=1.0):
            super().__init__(operator)
            self.coefficient = strength

    with pytest.raises(fh.InputError, match=r"Forgetful has not kept .*integrator, strength.*self.integrator = "):
        fh.Simulation(fh.Lattice(1.0, -9, 9), Forgetful(fh.Kernel(2.0)))
    model = page["KleinGordon"](fh.Kernel(2.0))
    for name, bad in (("coefficient", -1.0), ("integrator", "verlet"), ("reaction", "heavy")):
        broken = page["KleinGordon"](fh.Kernel(2.0))
        setattr(broken, name, bad)
        with pytest.raises(fh.InputError, match=rf"model.{name}"):
            fh.Simulation(fh.Lattice(1.0, -9, 9), broken)
    assert model.reaction == model.mass**2


def test_other_classes(page):
    """A dataclass is accepted, an abstract class is no model of case files, and a model's own stencil has the
    reaction.
    """

    @dataclass
    class Rod(fh.LatticeModel):
        operator: fh.Kernel | fh.Stencil
        stiffness: float = 1.0

        def __post_init__(self) -> None:
            super().__init__(self.operator)
            self.coefficient, self.integrator = self.stiffness, fh.Wave(self.operator).integrator
            self.reaction = 0.5

        def stencil(self, spacing, dim):
            return fh.Stencil.finite_difference(dim)

    class Idea(fh.Wave, ABC):
        @abstractmethod
        def said(self): ...

    sim = Case(CASE.replace('"klein-gordon", speed = 2.0, mass = 0.8', '"rod", stiffness = 2.0')).simulation()
    assert sim.engine.reaction == 0.5 and sim.stencil.reaction == 0.5 * 0.25 / 2.0 and sim.model.stiffness == 2.0
    assert '"idea"' not in json.dumps(schema()) and '"rod"' in json.dumps(schema())

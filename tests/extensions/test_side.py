"""A boundary defined by users: the class of docs/extending.md, as it is there."""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
import pytest

import farhorizon as fh
from farhorizon import cli
from farhorizon.boundaries import Side
from farhorizon.case.case import Case
from farhorizon.case.schema import schema
from farhorizon.studies.compare import compare

PAGE = (Path(__file__).parents[2] / "docs" / "extending.md").read_text(encoding="utf-8")
CASE = """
lattice = { spacing = 1.0, lower = [-12.0, -9.0], upper = [12.0, 9.0] }
model = { type = "wave", kernel = { horizon = 2.0 } }
initial = { u = "exp(-(x**2 + y**2)/4)" }
boundary = { all = { type = "power-sponge", nodes = 20 } }
run = { until = 12.0 }
output = { every = 6.0 }
"""


@pytest.fixture
def sponge():
    """The class, registered during a test; `__name__` is set so that its annotations can be evaluated."""
    module = {"__name__": __name__}
    before = dict(Side.known)
    exec(re.search(r"## A side of your own\n.*?```python\n(.*?)```", PAGE, re.S).group(1), module)
    yield module["PowerSponge"]
    Side.known.clear()
    Side.known.update(before)


PULSE = {"u": lambda x, y: np.exp(-(x**2 + y**2) / 4)}


def simulation(boundary, **options):
    lattice = fh.Lattice(1.0, (-12.0, -9.0), (12.0, 9.0))
    return fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), boundary, PULSE, threads=1, **options)


def test_it_runs_as_ours(sponge):
    """With a power of 2 the boundary is bitwise the built-in sponge; with a power of 3 it absorbs."""
    mine = simulation(sponge(nodes=20, strength=0.3, power=2.0))
    ours = simulation(fh.Sponge(nodes=20, strength=0.3))
    for sim in (mine, ours):
        sim.step(60)
    assert np.array_equal(mine.fields["u"], ours.fields["u"])
    cubic, wall = simulation(sponge(nodes=30)), simulation(fh.Fixed())
    for sim in (cubic, wall):
        sim.run(until=60.0)
    assert np.abs(cubic.fields["u"]).max() < 0.1 * np.abs(wall.fields["u"]).max()


def test_check_certificate_and_compare(sponge):
    sim = simulation(sponge(nodes=20))
    found = sim.certificate()
    assert found.verdict == "certified" and "energy of the scheme cannot grow" in found.reason
    text = sim.check(until=12.0).details
    assert "PowerSponge" in text and "reflection" in text
    setup = {"lattice": sim.lattice, "model": sim.model, "boundary": sponge(nodes=40), "initial": PULSE}
    errors = compare(setup, 40.0, times=[20.0, 40.0]).curves
    assert errors["power sponge"]["error_max_over_run"] < 0.3 * errors["fixed edge"]["error_max_over_run"]


def test_a_checkpoint_holds_it(sponge, tmp_path):
    whole, half = simulation(sponge(nodes=20)), simulation(sponge(nodes=20))
    whole.step(40)
    half.step(20)
    half.save(tmp_path / "state.npz")
    again = fh.Simulation.restore(tmp_path / "state.npz")
    again.step(20)
    assert np.array_equal(again.fields["u"], whole.fields["u"])
    del Side.known["PowerSponge"]
    with pytest.raises(fh.InputError, match=r"PowerSponge.*import the module that defines it first"):
        fh.Simulation.restore(tmp_path / "state.npz")


def test_a_case_file_has_it(sponge, tmp_path, capsys):
    path = tmp_path / "case.toml"
    path.write_text(CASE, encoding="utf-8")
    assert set(Case.read(path).setup.sides.values()) == {sponge(nodes=20)}
    properties = json.dumps(schema())
    assert "power-sponge" in properties
    for command in (
        ["check", str(path)],
        ["compare", str(path), "--out", str(tmp_path / "compare")],
        ["run", str(path), "--out", str(tmp_path / "run")],
        ["plot", str(tmp_path / "run" / "case.h5")],
    ):
        assert cli.main(command) == 0, capsys.readouterr()
    wrong = CASE.replace("nodes = 20", "nods = 20")
    with pytest.raises(fh.InputError, match=r"unknown key boundary.all.nods; did you mean 'nodes'\? known: .*power"):
        Case(wrong)
    with pytest.raises(fh.InputError, match=r"boundary.all.power: must be a number"):
        Case(CASE.replace("nodes = 20", 'power = "high"'))


def test_what_it_must_answer_is_asked_where_it_is_defined():
    with pytest.raises(TypeError, match=r"Open.endless is true, so that the class needs a method 'wanted'"):

        @dataclass(frozen=True)
        class Open(fh.Side):
            endless: ClassVar[bool] = True

    with pytest.raises(TypeError, match=r"Layered.stretched is true, so that the class needs a method 'make_layer'"):

        class Layered(fh.Side):
            stretched: ClassVar[bool] = True

    with pytest.raises(TypeError, match=r"Torn.damped is true, so that the class needs a method 'damping'"):

        class Torn(fh.Side):
            damped: ClassVar[bool] = True

    assert not {"Open", "Layered", "Torn"} & set(Side.known)


def test_something_else_is_refused():
    with pytest.raises(fh.InputError, match=r"not a boundary;.*limit: Auto, Exact, Extended"):
        simulation("sponge")


def test_other_classes_do_not_disturb_case_files(sponge):
    """A side that is no dataclass has no table; fields of all kinds are accepted."""

    class Plain(fh.Side):
        pass

    @dataclass(frozen=True)
    class Mixed(fh.Side):
        kind: Literal["a", "b"] = "a"
        places: list[float] | None = None
        odd: complex = 1j

    found = Case(CASE.replace('"power-sponge", nodes = 20', '"mixed", kind = "b", places = [1.0]')).setup.sides.values()
    assert all(side == Mixed("b", [1.0]) for side in found) and '"plain"' not in json.dumps(schema())
    with pytest.raises(fh.InputError, match=r"unknown type.*plain"):
        Case(CASE.replace('"power-sponge", nodes = 20', '"plain"'))
    with pytest.raises(TypeError, match=r"there is a side 'Sponge' already, in farhorizon.boundaries.sponge"):
        type("Sponge", (fh.Side,), {})
    assert Side.known["Sponge"] is fh.Sponge

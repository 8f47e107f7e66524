"""Shapes, loads and recorders defined by users, in case files: the classes of docs/extending.md, as they are there."""

import re
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Annotated

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.arguments import Unit
from farhorizon.case.case import Case
from farhorizon.case.keys import all_keys, explain_keys
from farhorizon.simulation.recorders.recorder import Recorder

PAGE = (Path(__file__).parents[2] / "docs" / "extending.md").read_text(encoding="utf-8")
SHAPE, RECORDER = (
    PAGE[PAGE.index(heading) : PAGE.index("\n## ", PAGE.index(heading) + 1)]
    for heading in ("## A shape of your own", "## A recorder of your own")
)
CLASSES = "\n".join(re.findall(r"```python\n(.*?)```", SHAPE + RECORDER, re.S))
CASE = re.search(r"## In a case file\n.*?```toml\n(.*?)```", PAGE, re.S).group(1)
FAMILIES = (fh.Shape, fh.Load, fh.Signal, fh.LatticeModel, fh.Side, Recorder)


@pytest.fixture
def page(monkeypatch):
    """The module with the classes, which are registered during a test."""
    before = {family: dict(family.known) for family in FAMILIES}
    made = ModuleType("shapes_of_users")
    monkeypatch.setitem(sys.modules, made.__name__, made)
    exec(CLASSES, made.__dict__)
    yield made
    for family, known in before.items():
        family.known.clear()
        family.known.update(known)


def test_the_case_of_the_page_is_the_run_of_python(page):
    case = Case(CASE)
    assert isinstance(case.lattice.body, page.HollowDisc) and case.lattice.body.outer == 6.0
    ring = case.lattice.mask
    assert ring.sum() == (fh.Lattice(0.5, (-6, -6), (6, 6), body=fh.Disc(6.0) - fh.Disc(1.99)).mask).sum()
    [load] = case.setup.loads
    assert isinstance(load, fh.BodyForce) and load.value == [0.0, -2000.0 * 9.81]
    sim = case.simulation().run(0.1, progress=False)
    [circle] = sim.recorders
    angles = np.pi / 4 * np.arange(8)
    np.testing.assert_allclose(circle.points, 4.0 * np.stack([np.cos(angles), np.sin(angles)], axis=-1), atol=1e-15)
    # every node of a body that nothing holds falls freely
    np.testing.assert_allclose(np.nanmean(sim.fields["u"][1]), -0.5 * 2000 * 9.81 * sim.time**2, rtol=0.05)


def test_a_recorder_of_other_sums(page, tmp_path):
    """The momentum that a force gives to a body, recorded without a break over a checkpoint and by a case file."""

    def run():
        lattice = fh.Lattice(0.5, (-4.0, -4.0), (4.0, 4.0), body=fh.Disc(3.0))
        pull = fh.Source([lambda x, y: np.exp(-(x**2) - y**2), 0.0], lambda t: 1.0)
        [recorder] = recorders = [page.Momentum(fh.Box((-4.0, -4.0), (4.0, 4.0)), every=5)]
        model = fh.Elastic(fh.Kernel(1.0, 1), 1.0)
        return fh.Simulation(lattice, model, fh.Free(), sources=[pull], observe=recorders), recorder

    sim, recorder = run()
    sim.step(60)
    force = sim.lattice.spacing**2 * np.nansum(np.where(sim.lattice.mask, sim.sources[0][0][0], 0.0))
    momentum = recorder.data["momentum"]
    assert momentum.shape == (13, 1, 2)
    np.testing.assert_allclose(momentum[1:, 0, 0], force * (recorder.times[1:] - sim.dt / 2), rtol=1e-10)
    sim, _ = run()
    sim.step(23)
    sim.save(tmp_path / "state.h5")
    sim, again = run()
    sim.load(tmp_path / "state.h5")
    sim.step(37)
    np.testing.assert_array_equal(again.data["momentum"], momentum)
    case = Case(CASE + "momentum = [{ region = { disc = { radius = 7.0 } }, every = 2 }]\n")
    recorders = case.simulation().run(0.1, progress=False).recorders
    [from_case] = [recorder for recorder in recorders if isinstance(recorder, page.Momentum)]
    assert from_case.data["momentum"].shape[1:] == (1, 2)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("inner =", "iner =", r"unknown key lattice\.body\.hollow_disc\.iner; did you mean 'inner'"),
        (', outer = "600 cm"', "", r"missing key lattice\.body\.hollow_disc\.outer: radii of the hole"),
        ('"2 g/cm^3"', '"2 g"', r"load\[0\]\.density: the unit measures something else; .* such as kg/m\^3"),
        ('"weight"', '"wieght"', r"load\[0\]\.type: unknown type; value: wieght; .*remedy: type = \"weight\""),
        ("count = 8", "count = 8.5", r"circle\[0\]\.count: must be a whole number"),
        ("[{ centre", "[{ center", r"unknown key circle\[0\]\.center; did you mean 'centre'"),
    ],
)
def test_their_mistakes_are_named(page, old, new, message):
    assert old in CASE
    with pytest.raises(fh.InputError, match=message):
        Case(CASE.replace(old, new))


def test_their_keys_are_explained(page):
    said = explain_keys("load.weight.gravity")
    assert "number, default 9.81, unit m/s^2" in said and "Acceleration" in said
    assert "required, unit m" in explain_keys("lattice.body.hollow_disc.inner")
    assert "Number of receivers" in explain_keys("circle.count")


def test_a_new_parameter_is_a_key_at_once(page):
    """Of a side, a model, a signal and a load; a unit follows from its annotation, or from the name in its family."""

    @dataclass(frozen=True)
    class Tilted(page.Weight):
        angle: float = 0.0

    @dataclass(frozen=True)
    class Leaky(fh.Sponge):
        leak: Annotated[float, Unit("1/s")] = 0.5

    class Heavy(fh.Wave):
        def __init__(self, operator, speed=1.0, mass=1.0):
            super().__init__(operator, speed)
            self.mass = mass

    found = {(key.path, key.types): key for key in all_keys()}
    assert found["load.angle", ("tilted",)].default == "0.0"
    assert found["boundary.all.leak", ("leaky",)].default == "0.5, unit 1/s"
    assert found["model.speed", ("heavy",)].default == "1.0, unit m/s"
    assert found["model.mass", ("heavy",)].default == "1.0"


def test_names_that_are_taken(page):
    with pytest.raises(
        TypeError, match=r"there is a 'power' already, farhorizon\.simulation\.recorders\.power_through"
    ):
        type("Power", (fh.Receivers,), {"tag": "power"})
    with pytest.raises(TypeError, match="there is a 'receivers' already"):
        type("Receivers", (fh.CrackTips,), {})
    type("Run", (fh.CrackTips,), {})
    with pytest.raises(fh.InputError, match="run: a case file has such a table already"):
        Case(CASE)


def test_all_classes_are_gone_afterwards():
    assert not {"HollowDisc", "Weight", "Circle", "Momentum"} & {name for family in FAMILIES for name in family.known}

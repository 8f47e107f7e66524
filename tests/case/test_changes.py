"""Changes of a case by dotted keys, and the TOML of the changed case."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.case.changes import changed, parsed
from farhorizon.case.toml import document

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("model.speed=2", 2),
        ("model.speed = 2.5", 2.5),
        ("output.balance=true", True),
        ("model.kernel.influence=linear", "linear"),
        ('model.kernel.influence="linear"', "linear"),
        ("initial.u=exp(-x**2)", "exp(-x**2)"),
        ("run.until=1\nrun.dt=2", "1\nrun.dt=2"),  # TOML of two keys, not one value
        ("lattice.lower=[-1, 2.0]", [-1, 2.0]),
        ("boundary.all={ type = 'free' }", {"type": "free"}),
        ("a.b==", "="),
        ("a=" + "[" * 10_000, "[" * 10_000),
    ],
)
def test_values_are_toml_and_what_is_none_is_a_text(text, value):
    key, found = parsed(text)
    assert found == value and type(found) is type(value) and key == text.partition("=")[0].strip()


@pytest.mark.parametrize("text", ["model.speed", "=2", "model.speed=", ""])
def test_half_a_change_is_refused(text):
    with pytest.raises(fh.InputError, match="--set: give a key"):
        parsed(text)


def test_changes_reach_tables_entries_of_lists_and_what_is_not_there():
    data = {"model": {"kernel": {"horizon": 1.0}}, "crack": [{"factor": 0.0}, {}]}
    found = changed(
        data, {"model.kernel.horizon": 2.0, "crack[1].opens": 3.0, "crack.0.factor": 1.0, 'a."x-".b': 4, "c": 5}
    )
    assert found == {
        "model": {"kernel": {"horizon": 2.0}},
        "crack": [{"factor": 1.0}, {"opens": 3.0}],
        "a": {"x-": {"b": 4}},
        "c": 5,
    }
    assert data["model"]["kernel"]["horizon"] == 1.0 and data["crack"][1] == {}
    with pytest.raises(fh.InputError, match=r"model.kernel.horizon.x: .*not a table; value: 1"):
        changed(data, {"model.kernel.horizon.x": 2.0})
    with pytest.raises(fh.InputError, match=r"crack\[2\].factor: .*no such entry; value: 2; limit: 0 to 1"):
        changed(data, {"crack[2].factor": 2.0})
    with pytest.raises(fh.InputError, match=r"load\[0\].value: .*no such entry; value: 0; limit: none: it is empty"):
        changed(data, {"load[0].value": 2.0})


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.toml")), ids=lambda path: path.stem)
def test_what_is_written_reads_as_what_it_was(path):
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    assert tomllib.loads(document(data)) == data


def test_texts_of_all_kinds_are_written():
    rng = np.random.default_rng(7)
    for _ in range(50):
        words = ["".join(map(chr, rng.integers(0, 0x2FF, 12))) for _ in range(3)]
        data = {words[0]: words[1], "t": {words[2]: [words[0], {words[1]: -0.0, "i": float("inf"), "e": {}}], "n": []}}
        assert tomllib.loads(document(data)) == data


def test_a_changed_case_is_that_of_the_changed_text():
    text = (EXAMPLES / "two_notches.toml").read_text(encoding="utf-8")
    case = Case(text, "case.toml", {"model.speed": 2.0, "run.until": 3.0, "crack[0].factor": 0.5})
    assert case.model.speed == 2.0 and case.setup.cracks[0].factor == 0.5
    again = Case(case.text)  # which is stored in a results file
    assert again.parts == case.parts and "speed = 2.0" in case.text
    assert Case(text, "case.toml", {}).text == text
    with pytest.raises(fh.InputError, match=r"case.toml: unknown key model.sped; did you mean 'speed'\?"):
        Case(text, "case.toml", {"model.sped": 2.0})

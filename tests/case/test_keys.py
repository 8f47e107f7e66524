"""Explanations of the keys of a case file on the command line."""

import tomllib
from pathlib import Path

import pytest

import farhorizon as fh
from farhorizon.case.keys import all_keys, explain_keys
from farhorizon.case.schema import explained

EXAMPLES = Path(__file__).parents[2] / "examples"


def paths(data, place=""):
    """Return the dotted keys of a case, without the numbers of entries and the names of sides."""
    if isinstance(data, list):
        return {path for part in data for path in paths(part, place)}
    if not isinstance(data, dict):
        return set()
    found = set()
    for name, value in data.items():
        path = "boundary.all" if place == "boundary" else f"{place}.{name}".lstrip(".")
        found |= {path} | paths(value, path)
    return found - {"boundary.all"}


def test_every_key_is_explained_and_every_key_of_the_examples_is_there():
    keys = all_keys()
    assert [key.path for key in keys if not key.text] == []
    used = set().union(*(paths(tomllib.loads(path.read_text(encoding="utf-8"))) for path in EXAMPLES.glob("*.toml")))
    used = {path.replace(".without.", ".") for path in used}  # a region within a region has the same keys
    used = {path for path in used if not path.startswith(("initial.", "crack.rectangle.", "crack.disc."))}
    assert used <= {key.path for key in keys} and len(used) > 40


def test_a_key_has_kind_default_and_meaning():
    said = explain_keys("model.kernel.influence")
    assert 'text, default "constant"' in said and "Influence function" in said
    assert "number, required" in explain_keys("model.kernel.horizon")
    assert "default 0.0" in explain_keys("background") and "list of numbers" in explain_keys("lattice.lower")
    assert explain_keys("crack[0].factor") == explain_keys("crack.factor")
    assert "whole number, default 40" in explain_keys("boundary.x-.sponge.nodes")
    assert "bulk" in explain_keys("model.elastic") and "diffusivity" not in explain_keys("model.elastic")
    assert explain_keys("lattice.body.without[0].disc.radius") == explain_keys("lattice.body.disc.radius")
    assert "taken out" in explain_keys("lattice.body.without")
    assert "the equation has 2 d u_t" in explain_keys("model.damping")
    assert "energy that a new crack takes" in explain_keys("model.elastic.fracture_energy")


def test_every_key_can_be_asked_for():
    for path in {key.path for key in all_keys()}:
        assert path.rpartition(".")[2] in explain_keys(path)
    said = explain_keys("constraint")  # one table with several types, and one with a single type
    assert all(f"  {name} " in said for name in ("temperature", "flux", "insulated", "convection", "prescribed"))
    assert "transfer" in explain_keys("constraint.convection") and "velocity" in explain_keys("constraint.prescribed")


def test_tables_list_what_is_in_them():
    whole = explain_keys("")
    assert all(f"  {name} " in whole for name in ("lattice", "model", "boundary", "crack", "run", "output"))
    assert all(name in explain_keys("model") for name in ("wave", "heat", "correspondence", "types"))
    assert explain_keys("boundary.x-") == explain_keys("boundary.y").replace("boundary.y.", "boundary.x-.")
    assert max(map(len, explain_keys("boundary.lattice-pml", 70).splitlines())) <= 70


@pytest.mark.parametrize(
    ("key", "near"),
    [
        ("horizn", "model.kernel.horizon"),
        ("model.sped", "model.speed"),
        ("model.kernel.horizon.x", "model.kernel.horizon"),
        ("boundary.lattice-pl", "boundary.lattice-pml"),
        ("modle", "model"),
        ("§", "keys lists the tables"),
    ],
)
def test_an_unknown_key_has_the_nearest_ones(key, near):
    with pytest.raises(fh.InputError, match=f"no such key.*{near}"):
        explain_keys(key)


def test_docstrings_say_what_parameters_are():
    class Thing:
        """A thing.

        More of it.

        Parameters
        ----------
        one, two : float
            Both `of` them.

            Really.
        three : int

        Raises
        ------
        four : str
            Not a parameter.
        """

    assert explained(Thing) == ("A thing.", {"one": "Both of them. Really.", "two": "Both of them. Really."})

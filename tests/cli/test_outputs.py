"""Every command that writes figures has a schema, which its output follows here and in other tests."""

import copy
import json
import sys
from pathlib import Path

import pytest

from farhorizon.cli import main
from farhorizon.cli.common import write_json
from farhorizon.cli.outputs import OUTPUTS, output_schema
from farhorizon.cli.parser import command_parser
from outputs import validator, written

SMALL = """[lattice]\nspacing = 0.5\nlower = [-3.0]\nupper = [3.0]
[model]\ntype = "wave"\nspeed = 1.0\nkernel = { horizon = 1.0 }
[initial]\nu = "exp(-4*x**2)"\n[boundary]\nall = { type = "fixed" }\n[run]\nuntil = 2.0\n"""


@pytest.fixture
def small(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("small.toml").write_text(SMALL)


def test_each_command_that_writes_figures_has_a_schema():
    """Each key in it has a description."""
    (commands,) = (one for one in command_parser()._actions if hasattr(one, "choices") and one.choices)
    writing = {name for name, sub in commands.choices.items() if "--json" in sub._option_string_actions}
    assert writing == set(OUTPUTS)
    for command in OUTPUTS:
        for name, table in output_schema(command)["$defs"].items():
            silent = [key for key, value in table["properties"].items() if "description" not in value]
            assert silent == [], (command, name)


@pytest.mark.parametrize("command", OUTPUTS)
def test_the_command_prints_it(command, capsys):
    assert main(["schema", command]) == 0
    assert json.loads(capsys.readouterr().out) == output_schema(command)


def test_schema_of_a_command_that_writes_none(capsys):
    with pytest.raises(SystemExit) as left:
        main(["schema", "plot"])
    assert left.value.code == 2 and "'plot'" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["run", "check", "compare"])
def test_what_is_written_fits_and_what_is_not_does_not(command, small):
    """Only keys of the schema are written, and all of them are required."""
    assert main([command, "small.toml", "--quiet", "--json", "out.json"]) == 0
    found, holds = written("out.json", command), validator(command).is_valid
    table = found["fixed edge" if "fixed edge" in found else next(iter(found))] if command == "compare" else found
    assert not holds(found | {"stranger": 1})
    for name in list(table):
        kept = copy.deepcopy(table[name])
        table[name] = object()
        assert not holds(found), name
        del table[name]
        assert not holds(found), name
        table[name] = kept
    assert holds(found)


def test_list_of_reproductions(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["reproduce", "--quiet", "--json", "list.json"]) == 0
    assert written("list.json", "reproduce")["ji2021-table1"]["takes"]


def test_what_overflowed_is_null(tmp_path):
    """JSON has neither infinity nor nan."""
    write_json(str(tmp_path / "a.json"), {"a": {"b": [1.0, float("inf")], "c": float("nan"), "d": 3}})
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": {"b": [1.0, None], "c": None, "d": 3}}


def test_several_processes_are_refused(small, monkeypatch, capsys):
    """Each process would compute the whole case and write the same files; `run` would do so without mpi4py."""
    monkeypatch.setenv("PMI_SIZE", "2")
    monkeypatch.setitem(sys.modules, "mpi4py", None)
    for command, word in {
        "run": "mpi4py is missing",
        "check": "this command computes on one process",
        "compare": "this command computes on one process",
        "sweep": "this command computes on one process",
    }.items():
        for number in ("0", "1"):  # only the first process reports it
            monkeypatch.setenv("PMI_RANK", number)
            assert main([command, "small.toml", *["model.speed=1.0,2.0"] * (command == "sweep")]) == 2
            assert (word in capsys.readouterr().err) == (number == "0")
    assert not Path("small.h5").exists()

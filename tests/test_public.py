"""The public names: a single list, loaded lazily, visible to type checkers."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import farhorizon as fh
from farhorizon import public


def test_names_are_those_of_one_list():
    """The public names are `read_case` and those that `public` exports; nothing else of the modules is visible."""
    lines = ast.parse(Path(public.__file__).read_text()).body[1:]
    handed_on = [alias.asname for line in lines for alias in line.names]
    assert sorted([*handed_on, "read_case"]) == fh.__all__ == sorted(set(dir(fh)) - {"__version__"})
    for name in fh.__all__:
        assert getattr(fh, name).__module__.startswith("farhorizon.")


def test_they_are_loaded_when_they_are_wanted():
    code = """
import sys, farhorizon as fh
assert 'numpy' not in sys.modules and 'farhorizon.public' not in sys.modules
assert fh.errors.InputError is fh.InputError
from farhorizon import *
assert Wave is fh.Wave and read_case is fh.read_case
"""
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("name", ["Waves", "_Wave", "numpy"])
def test_others_are_not_there(name):
    with pytest.raises(AttributeError, match=f"no attribute '{name}'"):
        getattr(fh, name)


def test_the_nearest_name_is_told():
    with pytest.raises(AttributeError, match="no attribute 'Latice'; did you mean 'Lattice'"):
        fh.Latice  # noqa: B018


@pytest.mark.slow
def test_type_checkers_see_them(tmp_path):
    code = "import farhorizon as fh\nreveal_type(fh.Wave)\nreveal_type(fh.read_case)\nfh.Waves\n"
    (tmp_path / "code.py").write_text(code)
    command = [sys.executable, "-m", "mypy", "--no-implicit-reexport", "code.py"]
    said = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path).stdout
    assert "farhorizon.models.wave.Wave" in said and "farhorizon.case.case.Case" in said
    assert "Module has no attribute" in said and "Found 1 error" in said

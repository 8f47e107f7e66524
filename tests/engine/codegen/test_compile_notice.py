"""Compilation is announced on stderr, once, and nothing else is."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from farhorizon.engine.codegen import compile_notice

MODULE = """
from numba import cfunc, njit, types

@njit(cache=True)
def inner(x):
    return 2 * x

@njit(cache=True)
def outer(x):
    return inner(x) + 1
"""
WHILE_IMPORTED = MODULE + "\n@cfunc(types.float64(types.float64), cache=True)\ndef found(x):\n    return outer(x)\n"
BLOB = Path(__file__).parents[3] / "examples" / "blob.toml"


def load(path, name, text):
    """A module of compiled functions, loaded as `engine.codegen.build` does."""
    if not path.exists():  # a file written again is a changed one for older versions of Numba
        path.write_text(text)
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    with compile_notice.importing(name):
        spec.loader.exec_module(module)
    return module


@pytest.fixture
def fresh(monkeypatch):
    """The state at the start of a process, with no compilation too short to be announced."""
    monkeypatch.setattr(compile_notice._NOTICE, "_begun", False)
    monkeypatch.setattr(compile_notice, "_SHORT", 0.0)


@pytest.mark.parametrize(
    ("name", "purpose", "text"),
    [
        ("farhorizon.engine.program", "the time loop", MODULE),
        ("stencil_rows_0", "the sweep of a stencil", WHILE_IMPORTED),
    ],
)
def test_what_is_compiled_is_said_once(name, purpose, text, tmp_path, capfd, fresh):
    """One line before and one after the outermost function is compiled; none when it comes from the cache, and none on
    stdout.
    """
    for expected in (2, 0):
        module = load(tmp_path / f"{name}.py", name, text)
        module.outer(1.5)
        said = capfd.readouterr()
        lines = said.err.splitlines()
        assert said.out == "" and len(lines) >= expected and bool(lines) == bool(expected)
        if lines:
            assert "compiling" in lines[0] and "once" in lines[0]
            assert all(re.fullmatch(rf"farhorizon: compiled {purpose} in \d+\.\d s", line) for line in lines[1:])


def test_functions_of_others_are_compiled_in_silence(tmp_path, capfd, fresh):
    """A user's own compiled functions are not announced."""
    load(tmp_path / "mine.py", "mine", MODULE).outer(1.5)
    assert capfd.readouterr().err == ""


@pytest.mark.slow
def test_a_cold_start_says_what_it_does(tmp_path):
    """The first check with empty caches announces on stderr what is compiled. The second announces nothing, and
    neither does so on stdout.
    """
    places = {"FARHORIZON_CACHE": str(tmp_path / "cache"), "NUMBA_CACHE_DIR": str(tmp_path / "numba")}
    command = [sys.executable, "-m", "farhorizon", "check", str(BLOB)]
    first, second = (
        subprocess.run(command, capture_output=True, text=True, env={**os.environ, **places}) for _ in range(2)
    )
    assert "compiling for this machine" in first.stderr and "compiled the time loop in" in first.stderr
    assert "compil" not in second.stderr + first.stdout + second.stdout
    assert list(tmp_path.rglob("*stretch_face*")) and not list(tmp_path.rglob("*phases_part*"))

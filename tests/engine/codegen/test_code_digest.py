"""Compiled code depends on the code that it uses: comments, docstrings and code that it does not use cost nothing."""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

import farhorizon
from farhorizon.engine import layer_program, program
from farhorizon.engine.codegen import code_digest

PACKAGE = Path(farhorizon.__file__).parent
#: Functions whose machine code is kept, by file.
KEPT = {
    "sweep": ("engine/sweep_program.py", "stencil_part"),
    "break": ("engine/program.py", "break_stretched"),
    "strain": ("engine/bonds.py", "largest_strain"),
    "rows": ("engine/codegen/stencil_sweeps.py", "stencil_sweep"),
}
#: Edits of a file, and the functions that depend on them.
EDITS = {
    "comment": ("engine/bonds.py", "    return total / length\n", "    # of one bond\n    return total / length\n", ""),
    "docstring": ("engine/bonds.py", '"""Stretch of a bond, ', '"""Elongation of a bond, ', ""),
    "head": ("engine/codegen/vectors.py", '"""Explicit SIMD', '"""Vectors', ""),
    "field": ("engine/bonds.py", "nonlinear: bool = False\n", "nonlinear: int = False  # or bool\n", ""),
    "annotation": ("engine/codegen/vectors.py", "def splat(self, value: Any) -> Any:", "def splat(self, value):", ""),
    "layout": ("engine/bonds.py", "return e / (1 + np.sqrt(1 + e)) if", "return (e / (1 + np.sqrt(1 + e))) if", ""),
    "host": (
        "engine/bonds.py",
        "numbers = np.flatnonzero(bits.any(0)), ",
        "numbers = np.flatnonzero(bits.sum(0)), ",
        "",
    ),
    "constant": ("engine/codegen/bond_sweeps.py", "LANES = 8\n", "LANES = 16\n", "break"),
    "kernel": ("engine/bonds.py", "results[i] /= length", "results[i] *= 1 / length", "strain"),
    "emitter": (
        "engine/codegen/vectors.py",
        "return functools.reduce(self.builder.fadd, terms)",
        "return sum(terms)",
        "rows",
    ),
    "name": ("engine/bonds.py", "FIRST, END = 0, 3, 6, 9", "FIRST, END = 0, 3, 9, 6", "break strain"),
    "decorator": (
        "engine/codegen/compiled.py",
        '"no_cfunc_wrapper": True',
        '"no_cfunc_wrapper": False',
        "sweep break strain",
    ),
}


@pytest.fixture
def copied(tmp_path, monkeypatch):
    """A copy of the sources, which the digests are those of, and a cache of their own."""
    ignored = shutil.ignore_patterns("__pycache__")
    for room in ("engine", "files"):
        shutil.copytree(PACKAGE / room, tmp_path / "farhorizon" / room, ignore=ignored)
    monkeypatch.setattr(code_digest, "_PACKAGE", tmp_path / "farhorizon")
    monkeypatch.setattr(code_digest, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(code_digest, "_STARTED", float("inf"))
    return tmp_path / "farhorizon"


def digests(package):
    """Digests of the functions in `KEPT`."""
    code_digest._source.cache_clear()
    return {key: code_digest.digest(package / file, name) for key, (file, name) in KEPT.items()}


def edit(path, old, new):
    text = path.read_text()
    assert text.count(old) >= 1
    path.write_text(text.replace(old, new))


def test_what_is_used_decides(copied):
    """Each edit changes the digests of the functions that depend on it and of no others, in one process and another."""
    before = digests(copied)
    assert digests(copied) == before
    for what, (file, old, new, expected) in EDITS.items():
        edit(copied / file, old, new)
        after = digests(copied)
        assert {key for key in KEPT if after[key] != before[key]} == set(expected.split()), what
        before = after
    code_digest._source.cache_clear()


def test_what_changes_during_a_run_is_not_for_others(copied, monkeypatch):
    """A process that has imported the old code must not keep machine code under the name of the new one."""
    started = time.time()
    os.utime(copied / "engine" / "bonds.py", (started + 1.0,) * 2)
    unchanged = digests(copied)
    monkeypatch.setattr(code_digest, "_STARTED", started)
    first, second = digests(copied), digests(copied)
    assert first["rows"] == second["rows"] == unchanged["rows"]
    assert len({unchanged["strain"], first["strain"], second["strain"]}) == 3
    code_digest._source.cache_clear()


def globals_of(function):
    """Functions and numbers of the engine that compiled code refers to by a name, also in functions within it."""
    code, waiting = set(), [function.__code__]
    while waiting:
        part = waiting.pop()
        code |= set(part.co_names)
        waiting += [constant for constant in part.co_consts if hasattr(constant, "co_names")]
    return {name: function.__globals__[name] for name in code if name in function.__globals__}


def test_every_function_that_is_called_is_among_the_definitions():
    """The same by another way: the objects that the functions of the loop refer to."""
    from farhorizon.engine.feature_list import steps

    modules = program, layer_program, *(sys.modules[step.function.__module__] for step in steps())
    names = {module.__name__ for module in modules}
    waiting = [value for module in modules for value in vars(module).values()]
    waiting = [
        function
        for function in waiting
        if getattr(function, "__module__", "") in names and hasattr(getattr(function, "py_func", function), "__code__")
    ]
    seen = {}
    for start in waiting:
        start = getattr(start, "py_func", start)
        file = Path(start.__code__.co_filename)
        found = {(place.stem, name) for place, name in code_digest.definitions(file, start.__name__)}
        inner = [start]
        while inner:
            function = inner.pop()
            for value in globals_of(function).values():
                value = getattr(value, "py_func", getattr(value, "_defn", value))
                if hasattr(value, "__code__") and "farhorizon" in value.__code__.co_filename:
                    place = Path(value.__code__.co_filename).stem, value.__qualname__.partition(".")[0]
                    assert place in found, (start.__name__, place)
                    if (start, value) not in seen:
                        seen[start, value] = True
                        inner.append(value)
    assert len(seen) > 100  # of about forty operations, most of which call several functions


LOAD = """
from farhorizon.engine.codegen.build import load_rows
from farhorizon.engine.codegen.compile_notice import compile_seconds
load_rows("map_rows", entries=((0,),), columns=1, each=False, added=False, real="float64")
print(compile_seconds() > 0)
"""


def test_a_comment_compiles_nothing_and_a_change_does(tmp_path):
    """In processes of their own, with a copy of the package and a cache that is empty at first."""
    shutil.copytree(PACKAGE, tmp_path / "farhorizon", ignore=shutil.ignore_patterns("__pycache__", "papers", "gallery"))
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "FARHORIZON_CACHE": str(tmp_path / "cache")}
    vectors, matrices = (
        tmp_path / "farhorizon" / "engine" / "codegen" / name for name in ("vectors.py", "matrices.py")
    )

    def compiles():
        command = [sys.executable, "-c", LOAD]
        return subprocess.run(command, capture_output=True, text=True, env=environment, check=True).stdout.strip()

    assert [compiles(), compiles()] == ["True", "False"]
    edit(matrices, '"""Make the intrinsic ``map(', '"""Make, as an example, the intrinsic ``map(')
    edit(vectors, "        product = self.builder", "        # the product\n        product = self.builder")
    assert compiles() == "False"
    edit(vectors, "self.builder.fmul(factor, term, flags=CONTRACT)", "self.builder.fmul(term, factor, flags=CONTRACT)")
    assert [compiles(), compiles()] == ["True", "False"]

"""Modules generated from templates: which sources their names depend on."""

import ast
from pathlib import Path

import pytest

import farhorizon.engine
from farhorizon.engine.rows.build import _COMPILED_IN

ENGINE = Path(farhorizon.engine.__file__).parent
TEMPLATES = ["program", "layer_program", *(f"rows/{path.stem}" for path in (ENGINE / "rows").glob("*_rows.py"))]
# imported by modules of the engine for work outside compiled code
NOT_COMPILED = {"rows/build"}


def imported(module):
    """Modules of the engine that a module imports when it is loaded."""
    for statement in ast.parse((ENGINE / f"{module}.py").read_text()).body:
        if isinstance(statement, ast.ImportFrom):
            place = statement.module.removeprefix("farhorizon.engine.").replace(".", "/")
            if (ENGINE / f"{place}.py").is_file():
                yield place


@pytest.mark.parametrize("template", TEMPLATES)
def test_names_of_generated_modules_depend_on_all_that_is_compiled_in(template):
    """Constants of other modules become part of the machine code, and Numba's cache does not notice when they
    change.
    """
    found, waiting = set(), [template]
    while waiting:
        new = set(imported(waiting.pop())) - found - NOT_COMPILED
        found |= new
        waiting += new
    assert found and found <= set(_COMPILED_IN)

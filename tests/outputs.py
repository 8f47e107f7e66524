"""Validation of what commands write with --json."""

import json
from functools import cache
from pathlib import Path

from jsonschema import Draft202012Validator

from farhorizon.cli.outputs import output_schema


@cache
def validator(command):
    """Return the validator of a command's output, after checking the schema itself."""
    Draft202012Validator.check_schema(output_schema(command))
    return Draft202012Validator(output_schema(command))


def _refused(word):
    raise ValueError(f"{word} is no JSON")


def written(path, command):
    """Return the content of a file that a command wrote, checked to be strict JSON and to follow the schema."""
    found = json.loads(Path(path).read_text(), parse_constant=_refused)
    validator(command).validate(found)
    return found

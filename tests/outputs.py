"""What a command wrote with --json, held against its schema."""

import json
from functools import cache
from pathlib import Path

from jsonschema import Draft202012Validator

from farhorizon.cli.outputs import output_schema


@cache
def validator(command):
    """Of what a command writes; the schema itself is one."""
    Draft202012Validator.check_schema(output_schema(command))
    return Draft202012Validator(output_schema(command))


def _refused(word):
    raise ValueError(f"{word} is no JSON")


def written(path, command):
    """The figures in a file that a command wrote: strict JSON, as the schema says."""
    found = json.loads(Path(path).read_text(), parse_constant=_refused)
    validator(command).validate(found)
    return found

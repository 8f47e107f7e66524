"""Output of commands with --json, and its JSON Schema."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from pydantic import ConfigDict, create_model
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from typing_extensions import TypedDict

from farhorizon import __version__
from farhorizon.checks.certificate import CertificateFacts
from farhorizon.checks.report import ReportFacts
from farhorizon.studies.collection import EntryFacts, OutcomeFacts
from farhorizon.studies.compare import Curve


class RunFacts(TypedDict):
    """A run that has reached its end."""

    name: str
    """Name of the case."""
    steps: int
    """Number of steps."""
    time: float
    """Time that was reached."""
    dt: float
    """Time step."""
    energy: float
    """Energy of the near field at the end."""
    results: str
    """Path of the results file."""
    pictures: list[str]
    """Paths of the pictures."""
    certificate: CertificateFacts
    """What was known about stability before the run."""


class SweepFacts(TypedDict):
    """Many cases that differ in some keys."""

    name: str
    """Name of the case."""
    table: str
    """Path of the table."""
    changes: list[dict[str, Any]]
    """For each case, the values of the keys that were changed."""
    figures: list[dict[str, float]]
    """For each case, the resulting quantities by name; empty if it failed."""
    failed: dict[str, str]
    """Numbers of the cases that failed, from 0 on, with the reasons."""


class StepFacts(TypedDict):
    """An accepted step of an inversion."""

    stage: int
    """Number of its highest frequency, from 0 on."""
    iteration: int
    """Number of the iteration, through all stages."""
    misfit: float
    """Sum of the misfits of the shots."""


class InvertFacts(TypedDict):
    """An inversion that has ended."""

    name: str
    """Name of the inversion file."""
    results: str
    """Path of the file of maps and misfits."""
    pictures: list[str]
    """Paths of the pictures."""
    message: str
    """Why it ended."""
    history: list[StepFacts]
    """All steps, the start of each stage included."""
    least: dict[str, float]
    """Least value of each map that was found."""
    largest: dict[str, float]
    """Largest value of each map that was found."""


OUTPUTS: dict[str, Any] = {
    "run": RunFacts,
    "check": ReportFacts,
    "compare": dict[str, Curve],
    "sweep": SweepFacts,
    "invert": InvertFacts,
    "reproduce": OutcomeFacts | dict[str, OutcomeFacts] | dict[str, EntryFacts],
    "validate": OutcomeFacts | dict[str, OutcomeFacts] | dict[str, EntryFacts],
    "demo": dict[str, Curve],
}
"""Output of each command: of `compare` and `demo` by boundary, of several entries of `reproduce` and `validate`, and of
their lists, by name."""


class _WithNull(GenerateJsonSchema):
    """Schemas of what `write_json` makes of numbers: null for those that are not finite."""

    def float_schema(self, schema: Any) -> JsonSchemaValue:
        return {"type": ["number", "null"]}

    def nullable_schema(self, schema: Any) -> JsonSchemaValue:
        inner = self.generate_inner(schema["schema"])
        return inner if inner == self.float_schema(None) else super().nullable_schema(schema)


@lru_cache(maxsize=len(OUTPUTS))
def output_schema(command: str) -> dict[str, Any]:
    """JSON Schema of the output of a command with --json."""
    config = ConfigDict(extra="forbid", use_attribute_docstrings=True)
    output: Any = create_model("Output", __config__=config, figures=(OUTPUTS[command], ...))
    schema = output.model_json_schema(schema_generator=_WithNull)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema["properties"]["figures"],
        "$defs": schema["$defs"],
        "title": f"farhorizon {command} --json",
        "description": f"What farhorizon {__version__} writes with {command} --json; null for what overflowed.",
    }

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
    """A run that came to its end."""

    name: str
    """Name of the case."""
    steps: int
    """Steps that were made."""
    time: float
    """The time that was reached."""
    dt: float
    """The time step."""
    energy: float
    """Energy of the near field at the end."""
    results: str
    """The results file."""
    pictures: list[str]
    """The pictures."""
    certificate: CertificateFacts
    """What was known of the stability before the run."""


class SweepFacts(TypedDict):
    """Many cases that differ in some keys."""

    name: str
    """Name of the case."""
    table: str
    """The file of the table."""
    changes: list[dict[str, Any]]
    """Of each case, the values of the keys that were changed."""
    figures: list[dict[str, float]]
    """Of each case, what came out; nothing of one that failed."""
    failed: dict[str, str]
    """By the numbers of cases that failed, from 0 on, why."""


OUTPUTS: dict[str, Any] = {
    "run": RunFacts,
    "check": ReportFacts,
    "compare": dict[str, Curve],
    "sweep": SweepFacts,
    "reproduce": OutcomeFacts | dict[str, EntryFacts],
    "validate": OutcomeFacts | dict[str, EntryFacts],
    "demo": dict[str, Curve],
}
"""What each command writes, by boundary what compares, by name what `reproduce` and `validate` list."""


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
    whole: Any = create_model("Output", __config__=config, figures=(OUTPUTS[command], ...))
    made = whole.model_json_schema(schema_generator=_WithNull)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **made["properties"]["figures"],
        "$defs": made["$defs"],
        "title": f"farhorizon {command} --json",
        "description": f"What farhorizon {__version__} writes with {command} --json; null for what overflowed.",
    }

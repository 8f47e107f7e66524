"""What is wrong with a case file, in one line: key, value, limit, remedy."""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from typing import Any, get_args

from pydantic import ValidationError

from farhorizon.boundaries.lattice_pml import BY_TARGET
from farhorizon.case.schema import (
    AnyConstraint,
    AnyLoad,
    BodyForcePart,
    BodyPart,
    BoxPart,
    CasePart,
    ConstraintPart,
    CrackPart,
    DiscPart,
    ImagePart,
    IncidentPart,
    KernelPart,
    LatticePart,
    MaterialPart,
    OutputPart,
    Part,
    PolygonPart,
    PrescribedPart,
    RegionPart,
    RunPart,
    SourcePart,
    SpecimenPart,
    TextPart,
    TractionPart,
    model_kinds,
    model_part,
    side_kinds,
    side_part,
)
from farhorizon.errors import InputError


def nearest(word: str, words: Sequence[str]) -> str:
    near = difflib.get_close_matches(word, words, 1, 0.6)
    return (f"did you mean {near[0]!r}? " if near else "") + f"known: {', '.join(words)}"


_PARTS: dict[str, type[Part]] = {
    "lattice": LatticePart,
    "window": RegionPart,
    "body": RegionPart,
    "without": RegionPart,
    "region": RegionPart,
    "within": RegionPart,
    "box": BoxPart,
    "ball": DiscPart,
    "polygon": PolygonPart,
    "text": TextPart,
    "image": ImagePart,
    "correspondence": BodyPart,
    "material": MaterialPart,
    "load": TractionPart,
    "traction": TractionPart,
    "body-force": BodyForcePart,
    "specimen": SpecimenPart,
    "kernel": KernelPart,
    "crack": CrackPart,
    "source": SourcePart,
    "incident": IncidentPart,
    "constraint": ConstraintPart,
    "temperature": ConstraintPart,
    "flux": ConstraintPart,
    "insulated": ConstraintPart,
    "convection": ConstraintPart,
    "prescribed": PrescribedPart,
    "run": RunPart,
    "output": OutputPart,
}


def _known(location: tuple[Any, ...]) -> list[str]:
    """Keys allowed at a place of the schema, following the data's own path."""
    parts: type[Part] = CasePart
    known = _PARTS | {name: side_part(kind) for name, kind in side_kinds().items()}
    known |= {name: model_part(kind) for name, kind in model_kinds().items()}
    for step in location:
        if step == "disc" and parts is RegionPart:
            parts = DiscPart
        elif step in known:
            parts = known[step]
    return list(parts.model_fields)


# What pydantic wants, in words, by the types of its errors.
_WANTED = {
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "a text",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
}


def _types(table: str) -> list[str]:
    """The types that a table of the case may have."""
    if table == "boundary":
        return list(side_kinds())
    if table == "model":
        return [*model_kinds(), "correspondence"]
    union = {"load": AnyLoad, "constraint": AnyConstraint}[table]
    return [name for part in get_args(union) for name in get_args(part.model_fields["type"].annotation)]


def explain(error: ValidationError, data: dict[str, Any]) -> str:
    """The first problems in one line: key, value, what is wrong, the nearest known key."""
    # a misspelt key is why another is missing
    problems = sorted(error.errors(), key=lambda problem: problem["type"] != "extra_forbidden")
    by_key: dict[str, list[Any]] = {}
    for problem in problems:
        by_key.setdefault(_key(data, tuple(problem["loc"]), problem["type"] == "missing"), []).append(problem)
    return " | ".join(_problem(key, same) for key, same in list(by_key.items())[:3])


def _key(data: Any, location: tuple[Any, ...], missing: bool) -> str:
    """The path of a problem as it stands in the case: pydantic's has names of types in between, which are nowhere in
    the data.
    """
    found = ""
    for number, step in enumerate(location):
        if isinstance(data, list) and isinstance(step, int) and step < len(data):
            found, data = f"{found}[{step}]", data[step]
        elif isinstance(data, dict) and (step in data or (missing and number == len(location) - 1)):
            found, data = f"{found}.{step}".lstrip("."), data.get(step)
    return found


def _problem(key: str, same: list[Any]) -> str:
    """What is wrong with one key; of what may be of several types there is a problem each."""
    first = same[0]
    location, context = tuple(first["loc"]), first.get("ctx", {})
    match first["type"]:
        case "extra_forbidden" if "lattice-pml" in location and location[-1] in ("angle", "wavelengths"):
            return str(
                InputError("layers are no longer chosen by angle", key=key, remedy=BY_TARGET.replace("=...", " = ..."))
            )
        case "extra_forbidden":
            return f"unknown key {key}; {nearest(str(location[-1]), _known(location[:-1]))}"
        case "missing":
            return f"missing key {key}"
        case "union_tag_not_found" | "union_tag_invalid":
            types = _types(re.split(r"\W", key)[0])
            message = "unknown type" if "tag" in context else "the type is missing"
            return str(
                InputError(
                    message,
                    value=context.get("tag"),
                    limit=", ".join(types),
                    key=f"{key}.type",
                    remedy=f'type = "{types[0]}"',
                )
            )
    words = [
        _WANTED.get(p["type"], f"one of {p['ctx']['expected']}" if p["type"] == "literal_error" else "") for p in same
    ]
    message = f"must be {' or '.join(dict.fromkeys(words))}" if all(words) else first["msg"]
    value = first["input"]
    return str(InputError(message, value=f"the text {value!r}" if isinstance(value, str) else value, key=key))

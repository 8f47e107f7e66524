"""Errors in a case file, described in one line: key, value, limit, remedy."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, get_args

from pydantic import ValidationError

from farhorizon.boundaries.lattice_pml import BY_TARGET
from farhorizon.case.keys import all_keys
from farhorizon.case.schema import Part, case_part, tables, tag_of
from farhorizon.case.toml import literal
from farhorizon.errors import InputError, nearest, suggestion


def _tables(hint: Any) -> list[type[Part]]:
    """The tables that a type hint admits."""
    if isinstance(hint, type) and issubclass(hint, Part):
        return [hint]
    return [table for inner in get_args(hint) for table in _tables(inner)]


def _tags(table: type[Part]) -> tuple[str, ...]:
    """Values that `type` may have in a table."""
    return get_args(table.model_fields["type"].annotation) if "type" in table.model_fields else ()


def _at(root: type[Part], location: tuple[Any, ...]) -> list[type[Part]]:
    """Tables at a place of the schema of a file; places include the types of tables on the way."""
    tables: list[type[Part]] = [root]
    for step in location:
        having = [table for table in tables if step in table.model_fields]
        if having:
            tables = [inner for table in having for inner in _tables(table.model_fields[step].annotation)]
        else:  # a type selects a table; the number of an entry or the name of a side leaves the tables as they are
            tables = [table for table in tables if step in _tags(table)] or tables
    return tables


def _known(root: type[Part], location: tuple[Any, ...]) -> list[str]:
    """Keys allowed at a place of the schema."""
    return list(dict.fromkeys(name for table in _at(root, location) for name in table.model_fields))


# What pydantic expects, in words, by its type of error.
_EXPECTED = {
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
_EXAMPLES = {
    "a number": "1.5",
    "a finite number": "1.5",
    "a whole number": "3",
    "a text": '"..."',
    "true or false": "true",
    "a list": "[...]",
    "a table": "{ ... }",
}


#: What other programs and books call some types.
_OTHER_NAMES = {
    "plane-wave": "incident-wave",
    "plane": "incident-wave",
    "planar-wave": "incident-wave",
    "surface-wave": "rayleigh-wave",
    "pml": "lattice-pml",
    "absorbing": "lattice-pml",
    "open": "lattice-pml",
    "damping": "sponge",
    "dirichlet": "fixed",
    "rigid": "fixed",
    "neumann": "free",
    "explosion": "moment-tensor",
    "line": "line-source",
    "point": "point-source",
}


def _meant(word: str, types: list[str]) -> list[str]:
    """The type that a word means or resembles, in a list, which is empty if there is none."""
    ours = _other_name(word)
    return [ours] if ours in types else nearest(word, types)


def _other_name(word: str) -> str:
    return _OTHER_NAMES.get(word.lower().replace("_", "-").replace(" ", "-"), "")


def _elsewhere(word: str, known: Iterable[str]) -> str:
    """The types of other tables that a word names, if none of the known words resembles it."""
    if nearest(word, known):
        return ""
    tags = [(tag, key.parent) for key in all_keys() if key.name == "type" for tag in key.types[-1:]]
    places = [(tag, table) for name in (_other_name(word), word) for tag, table in tags if tag == name]
    return f"type = {literal(places[0][0])} in {places[0][1]}" if places else ""


def _types(root: type[Part], location: tuple[Any, ...]) -> list[str]:
    """Types that a table at a place of the schema may have."""
    return [tag for table in _at(root, location) for tag in _tags(table)]


def _instead(location: tuple[Any, ...]) -> str:
    """What a model takes in place of a key of other models, if known."""
    models = [model for model in tables().known.models if tag_of(model) in location[-2:-1]]
    return models[0].others.get(str(location[-1]), "") if models else ""


def _meaning(root: type[Part], location: tuple[Any, ...]) -> str:
    """Description of a key from the schema."""
    fields = [table.model_fields.get(location[-1]) for table in _at(root, location[:-1])]
    texts = [field.description for field in fields if field and field.description]
    return f": {texts[0][0].lower()}{' '.join(texts[0][1:].split()).rstrip('.')}" if texts else ""


def explain(error: ValidationError, data: dict[str, Any], table: type[Part] | None = None) -> str:
    """The first problems in one line: key, value, what is wrong, the most similar known key; `table` is that of the
    file, of a case unless given.
    """
    root = case_part() if table is None else table
    # misspelt keys first, because they are why other keys are missing
    problems = sorted(error.errors(), key=lambda problem: problem["type"] != "extra_forbidden")
    by_key: dict[str, list[Any]] = {}
    for problem in problems:
        by_key.setdefault(_key(data, tuple(problem["loc"]), problem["type"] == "missing"), []).append(problem)
    return " | ".join(_problem(root, key, problems) for key, problems in list(by_key.items())[:3])


def _key(data: Any, location: tuple[Any, ...], missing: bool) -> str:
    """The path of a problem as it is in the case: pydantic's path also contains names of types, which do not occur in
    the data.
    """
    path = ""
    for number, step in enumerate(location):
        if isinstance(data, list) and isinstance(step, int) and step < len(data):
            path, data = f"{path}[{step}]", data[step]
        elif isinstance(data, dict) and (step in data or (missing and number == len(location) - 1)):
            path, data = f"{path}.{step}".lstrip("."), data.get(step)
    return path


def _problem(root: type[Part], key: str, problems: list[Any]) -> str:
    """What is wrong with one key; there is one problem for each type that it may have."""
    first = problems[0]
    location, context = tuple(first["loc"]), first.get("ctx", {})
    match first["type"]:
        case "extra_forbidden" if "lattice-pml" in location and location[-1] in ("angle", "wavelengths"):
            return str(
                InputError("layers are no longer chosen by angle", key=key, remedy=BY_TARGET.replace("=...", " = ..."))
            )
        case "extra_forbidden":
            word, known = str(location[-1]), _known(root, location[:-1])
            remedy = _instead(location) or _elsewhere(word, known)
            return f"unknown key {key}; {suggestion(word, known)}{f'; remedy: {remedy}' if remedy else ''}"
        case "missing":
            return f"missing key {key}{_meaning(root, location)}"
        case "value_error" if isinstance(context["error"], InputError):  # its key is relative to the table
            return str(context["error"].at(f"{key}.{context['error'].key}".lstrip(".")))
        case "union_tag_not_found" | "union_tag_invalid":
            types = _types(root, location)
            message = "unknown type" if "tag" in context else "the type is missing"
            near = _meant(str(context["tag"]), types) if "tag" in context else types[:1]
            return str(
                InputError(
                    message,
                    value=context.get("tag"),
                    limit=", ".join(types),
                    key=f"{key}.type",
                    remedy=f"type = {literal(near[0])}" if near else _elsewhere(str(context.get("tag")), types),
                )
            )
    words = [
        _EXPECTED.get(p["type"], f"one of {p['ctx']['expected']}" if p["type"] == "literal_error" else "")
        for p in problems
    ]
    expected = " or ".join(dict.fromkeys(words)) if all(words) else ""
    value = first["input"]
    return str(
        InputError(
            f"must be {expected}" if expected else first["msg"],
            value=f"the text {value!r}" if isinstance(value, str) else value,
            limit=expected or None,
            key=key,
            remedy=f"such as {', '.join(_EXAMPLES.get(w, w) for w in dict.fromkeys(words))}" if expected else "",
        )
    )

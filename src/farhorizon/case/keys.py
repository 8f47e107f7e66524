"""Explanations of the keys of a case file at the prompt, from the JSON Schema."""

from __future__ import annotations

import difflib
import re
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

from farhorizon.case.changes import steps
from farhorizon.case.inversion_schema import inversion_part
from farhorizon.case.schema import Part, case_part, schema_of
from farhorizon.case.toml import literal
from farhorizon.errors import InputError

_KINDS = {
    "number": "number",
    "integer": "whole number",
    "string": "text",
    "boolean": "true or false",
    "object": "table",
}
_SIDE = "all"  # stands for the name of any side


@dataclass(frozen=True)
class Key:
    """A key of a case file."""

    path: str  # with dots, and ``boundary.all`` for sides; entries of lists have no number
    types: tuple[str, ...]  # of the enclosing tables, where these have one
    kind: str  # of values that it takes
    default: str  # or that it is required or optional; with its unit
    text: str

    @cached_property
    def parent(self) -> str:
        """Path of the table that contains the key."""
        return self.path.rpartition(".")[0]

    @cached_property
    def name(self) -> str:
        """Last part of the path."""
        return self.path.rpartition(".")[2]

    @property
    def brief(self) -> str:
        """First sentence of the text."""
        return re.split(r"(?<!\.)\.(?: (?=[A-Z\"])|$)", self.text)[0]


def all_keys() -> list[Key]:
    """Every key, each table before its contents."""
    return list(_keys_of(case_part()))


@lru_cache(maxsize=4)
def _keys_of(case: type[Part]) -> tuple[Key, ...]:
    """Every key of the table of a case."""
    schema = schema_of(case)
    return tuple(_inside(schema, schema["$defs"], "", (), ()))


def _inside(
    table: dict[str, Any], defs: dict[str, Any], path: str, types: tuple[str, ...], within: tuple[str, ...]
) -> Iterator[Key]:
    """The keys of a table and of the tables in it; `within` names the enclosing kinds of table, which are not entered
    again (regions may contain regions).
    """
    for name, key in table["properties"].items():
        place = f"{path}.{name}".lstrip(".")
        needed, default = name in table.get("required", ()), key.get("default")
        default = "required" if needed else "optional" if default is None or _empty(default) else literal(default)
        default += f", unit {key['unit']}" if "unit" in key else ""
        yield Key(place, types, _kind(key, defs), default, key.get("description", ""))
        for kind, inner in _tables(key, defs):
            if kind not in within:
                below = f"{place}.{_SIDE}" if place == "boundary" else place
                tag = inner["properties"].get("type", {})
                tags = tag.get("enum", [tag["const"]] if "const" in tag else [])
                for inner_types in [(*types, name) for name in tags] or [types]:
                    yield from _inside(inner, defs, below, inner_types, (*within, kind))


def _empty(default: Any) -> bool:
    """Whether a default is a table or an empty list, whose contents have their own defaults."""
    return isinstance(default, dict) or default == []


def _tables(schema: dict[str, Any], defs: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Name and schema of each kind of table that a key, or a list at a key, may contain."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        yield name, defs[name]
    for option in (*schema.get("anyOf", ()), *schema.get("oneOf", ()), *schema.get("allOf", ())):
        yield from _tables(option, defs)
    for inner in (schema.get("items"), schema.get("additionalProperties")):
        if isinstance(inner, dict):
            yield from _tables(inner, defs)


def _kind(schema: dict[str, Any], defs: dict[str, Any]) -> str:
    """Kind of value that a key takes, in words."""
    options = [*schema.get("anyOf", ()), *schema.get("oneOf", ())]
    if options:
        return " or ".join(dict.fromkeys(_kind(option, defs) for option in options if option.get("type") != "null"))
    if "enum" in schema or "const" in schema:
        return " or ".join(literal(value) for value in schema.get("enum", [schema.get("const")]))
    if "$ref" in schema:
        return "table"
    if schema.get("type") == "array":
        of = _kind(schema["items"], defs) if schema.get("items") else ""
        plural = f"{of}s" if of in ("number", "text", "table", "whole number") else f"({of})"
        return f"list of {plural}" if of else "list"
    return "number" if isinstance(schema.get("type"), list) else _KINDS.get(schema.get("type", ""), "as in Python")


def explain_keys(prefix: str, width: int = 100) -> str:
    """Description of a key and of the keys below it, `width` characters wide; without a prefix, of the tables of a
    case. The prefix may have numbers of entries and types ("crack[0]", "model.elastic.young"), and be of an inversion
    file; the InputError for an unknown key names the most similar ones.
    """
    of_inversions = re.match(r"inversion\b|shot\b", prefix)
    keys = list(_keys_of(inversion_part())) if of_inversions else all_keys()
    path, types = _place(prefix, keys)
    of_any_type = [key for key in keys if key.path == path]
    keys = [key for key in keys if types <= set(key.types)]
    lines = []
    for key, tags in _merged([key for key in keys if key.path == path] or of_any_type):
        lines += [f"{key.path}{_of(tags)}: {key.kind}, {_default(key)}", *_wrapped(key.text, "  ", width)]
    if path == "boundary":
        path = f"boundary.{_SIDE}"
    groups: dict[tuple[str, ...], list[Key]] = {}
    for key, tags in _merged([key for key in keys if key.parent == path and key.path]):
        groups.setdefault(tags, []).append(key)
    if len(groups) > 1:
        tables = [(key.types[-1], key.brief) for key in keys if key.parent == path and key.name == "type"]
        return "\n".join([*lines, "", f"types; keys {prefix}.TYPE lists what each has", *_listed(tables, width)])
    for tags, members in groups.items():
        lines += ["", f"{path}{_of(tags)}" if path else "tables and keys of a case file"]
        lines += _listed([(key.name, f"{key.brief} ({key.kind}, {_default(key)})") for key in members], width)
    return "\n".join(lines).strip("\n")


def _place(prefix: str, keys: Sequence[Key]) -> tuple[str, set[str]]:
    """The path that a prefix denotes, and the types of tables that it names."""
    given, path, types = [step for step in steps(prefix) if step and not step.isdecimal()], "", set()
    # regions taken out of a region have the keys of a region
    path_steps = [step for step, below in zip(given, [*given, ""][1:], strict=True) if step != "without" or not below]
    for number, step in enumerate(path_steps):
        below = f"{path}.{step}".lstrip(".")
        if any(key.path == below for key in keys):
            path = below
            continue
        known = {tag for key in keys if f"{key.path}.".startswith(f"{path}.") for tag in key.types}
        if path == "boundary" and (step in known or re.fullmatch(r"all|[xyz][-+]?", step)):
            path = f"boundary.{_SIDE}"
            types |= {step} & known
        elif step in known and path:
            types.add(step)
        else:
            raise _unknown(prefix, ".".join([path, *path_steps[number:]]).lstrip("."), keys)
    return path, types


def _listed(entries: Sequence[tuple[str, str]], width: int) -> list[str]:
    """Names and descriptions in two columns."""
    longest = max(len(name) for name, _ in entries)
    return [line for name, text in entries for line in _wrapped(text, f"  {name:{longest}}  ", width)]


def _default(key: Key) -> str:
    return key.default if key.default.startswith(("required", "optional")) else f"default {key.default}"


def _merged(keys: Sequence[Key]) -> list[tuple[Key, tuple[str, ...]]]:
    """Keys of the same path and description merged into one, with the types of the tables that contain it."""
    merged: dict[Key, list[str]] = {}
    for key in keys:
        merged.setdefault(replace(key, types=()), []).extend(key.types[-1:])
    return [(key, tuple(dict.fromkeys(tags))) for key, tags in merged.items()]


def _of(tags: Sequence[str]) -> str:
    return f" (type {', '.join(tags)})" if tags else ""


def _wrapped(text: str, head: str, width: int) -> list[str]:
    return textwrap.wrap(text, max(width, 40), initial_indent=head, subsequent_indent=" " * len(head))


def _unknown(given: str, place: str, keys: Sequence[Key]) -> InputError:
    """The error for an unknown key, with the most similar ones."""
    typed = (f"{key.parent.removesuffix(f'.{_SIDE}')}.{key.types[-1]}" for key in keys if key.types)
    paths = list(dict.fromkeys([*(key.path for key in keys), *typed]))
    last = place.rpartition(".")[2]
    alike = difflib.get_close_matches(last, {path.rpartition(".")[2] for path in paths}, 2, 0.7)
    near = [path for name in alike for path in paths if path.rpartition(".")[2] == name][:4]
    near = near or difflib.get_close_matches(place, paths, 3, 0.5)
    return InputError(
        "a case file has no such key",
        value=given,
        remedy=f"did you mean {' or '.join(near)}?" if near else "farhorizon keys lists the tables",
        key="keys",
    )

"""Explanations of the keys of a case file at the prompt, from the JSON Schema."""

from __future__ import annotations

import difflib
import re
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

from farhorizon.case.changes import steps
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
    """A key of a case file.

    Attributes
    ----------
    path : str
        Dotted path, with ``boundary.all...`` for sides; entries of lists have no number.
    types : tuple of str
        Types of the enclosing tables, where these have one.
    kind, default, text : str
        What values the key takes; its default (or that it is required or optional) with its unit; and its description.
    """

    path: str
    types: tuple[str, ...]
    kind: str
    default: str
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
    whole = schema_of(case)
    return tuple(_inside(whole, whole["$defs"], "", (), ()))


def _inside(
    table: dict[str, Any], defs: dict[str, Any], path: str, types: tuple[str, ...], within: tuple[str, ...]
) -> Iterator[Key]:
    """The keys of a table and of the tables in it; `within` names the enclosing kinds of table, which are not entered
    again (regions may contain regions).
    """
    for name, found in table["properties"].items():
        place = f"{path}.{name}".lstrip(".")
        needed, default = name in table.get("required", ()), found.get("default")
        said = "required" if needed else "optional" if default is None or _empty(default) else literal(default)
        text = found.get("description", "")
        said += f", unit {found['unit']}" if "unit" in found else ""
        yield Key(place, types, _kind(found, defs), said, text)
        for kind, inner in _tables(found, defs):
            if kind not in within:
                step = f"{place}.{_SIDE}" if place == "boundary" else place
                tag = inner["properties"].get("type", {})
                tags = tag.get("enum", [tag["const"]] if "const" in tag else [])
                for own in [(*types, one) for one in tags] or [types]:
                    yield from _inside(inner, defs, step, own, (*within, kind))


def _empty(default: Any) -> bool:
    """Whether a default is a table or an empty list, whose contents have their own defaults."""
    return isinstance(default, dict) or default == []


def _tables(found: dict[str, Any], defs: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Name and schema of each kind of table that a key, or a list at a key, may contain."""
    if "$ref" in found:
        name = found["$ref"].rpartition("/")[2]
        yield name, defs[name]
    for one in (*found.get("anyOf", ()), *found.get("oneOf", ()), *found.get("allOf", ())):
        yield from _tables(one, defs)
    for inner in (found.get("items"), found.get("additionalProperties")):
        if isinstance(inner, dict):
            yield from _tables(inner, defs)


def _kind(found: dict[str, Any], defs: dict[str, Any]) -> str:
    """Kind of value that a key takes, in words."""
    options = [*found.get("anyOf", ()), *found.get("oneOf", ())]
    if options:
        return " or ".join(dict.fromkeys(_kind(one, defs) for one in options if one.get("type") != "null"))
    if "enum" in found or "const" in found:
        return " or ".join(literal(value) for value in found.get("enum", [found.get("const")]))
    if "$ref" in found:
        return "table"
    if found.get("type") == "array":
        of = _kind(found["items"], defs) if found.get("items") else ""
        return (
            f"list of {of}s"
            if of in ("number", "text", "table", "whole number")
            else f"list of ({of})"
            if of
            else "list"
        )
    return "number" if isinstance(found.get("type"), list) else _KINDS.get(found.get("type", ""), "as in Python")


def explain_keys(prefix: str, width: int = 100) -> str:
    """Description of a key and of the keys below it, as text.

    Parameters
    ----------
    prefix : str
        A dotted key: the first part of its path or all of it, with numbers of list entries and types of tables if
        desired ("crack[0]", "model.elastic.young", "boundary.x-"). If empty, the tables of a case are listed.
    width : int
        Characters per line.

    Raises
    ------
    InputError
        There is no such key; the message names the most similar ones.
    """
    keys = all_keys()
    path, types = _place(prefix, keys)
    own = [key for key in keys if key.path == path]
    keys = [key for key in keys if types <= set(key.types)]
    lines = []
    for key, kinds in _merged([key for key in keys if key.path == path] or own):
        lines += [f"{key.path}{_of(kinds)}: {key.kind}, {_default(key)}", *_wrapped(key.text, "  ", width)]
    if path == "boundary":
        path = f"boundary.{_SIDE}"
    groups: dict[tuple[str, ...], list[Key]] = {}
    for key, kinds in _merged([key for key in keys if key.parent == path and key.path]):
        groups.setdefault(kinds, []).append(key)
    if len(groups) > 1:
        some = [(key.types[-1], key.brief) for key in keys if key.parent == path and key.name == "type"]
        return "\n".join([*lines, "", f"types; keys {prefix}.TYPE lists what each has", *_listed(some, width)])
    for kinds, these in groups.items():
        lines += ["", f"{path}{_of(kinds)}" if path else "tables and keys of a case file"]
        lines += _listed([(key.name, f"{key.brief} ({key.kind}, {_default(key)})") for key in these], width)
    return "\n".join(lines).strip("\n")


def _place(prefix: str, keys: Sequence[Key]) -> tuple[str, set[str]]:
    """The path that a prefix denotes, and the types of tables that it names."""
    given, path, types = [step for step in steps(prefix) if step and not step.isdecimal()], "", set()
    # regions taken out of a region have the keys of a region
    wanted = [step for step, below in zip(given, [*given, ""][1:], strict=True) if step != "without" or not below]
    for number, step in enumerate(wanted):
        below = f"{path}.{step}".lstrip(".")
        if any(key.path == below for key in keys):
            path = below
            continue
        known = {kind for key in keys if f"{key.path}.".startswith(f"{path}.") for kind in key.types}
        if path == "boundary" and (step in known or re.fullmatch(r"all|[xyz][-+]?", step)):
            path = f"boundary.{_SIDE}"
            types |= {step} & known
        elif step in known and path:
            types.add(step)
        else:
            raise _unknown(prefix, ".".join([path, *wanted[number:]]).lstrip("."), keys)
    return path, types


def _listed(entries: Sequence[tuple[str, str]], width: int) -> list[str]:
    """Names and descriptions in two columns."""
    longest = max(len(name) for name, _ in entries)
    return [line for name, text in entries for line in _wrapped(text, f"  {name:{longest}}  ", width)]


def _default(key: Key) -> str:
    return key.default if key.default.startswith(("required", "optional")) else f"default {key.default}"


def _merged(keys: Sequence[Key]) -> list[tuple[Key, tuple[str, ...]]]:
    """Keys of the same path and description merged into one, with the types of the tables that contain it."""
    found: dict[tuple[str, str, str, str], list[str]] = {}
    first: dict[tuple[str, str, str, str], Key] = {}
    for key in keys:
        same = key.path, key.kind, key.default, key.text
        first.setdefault(same, key)
        found.setdefault(same, []).extend(key.types[-1:])
    return [(first[same], tuple(dict.fromkeys(kinds))) for same, kinds in found.items()]


def _of(kinds: Sequence[str]) -> str:
    return f" (type {', '.join(kinds)})" if kinds else ""


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

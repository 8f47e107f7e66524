"""Every key of a case file as Markdown.

What it takes and what it means is in the schema, how it is written in the examples; `reference/keys.toml` has what
these do not say.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import farhorizon as fh
from farhorizon.case.schema import schema

DOCS = Path(__file__).resolve().parents[1]
CASES = [*sorted((DOCS.parent / "examples").glob("*.toml")), *sorted((DOCS / "tutorials").glob("*.toml"))]
CLASSES = {"ImagePart": "ImageMask"}  # others: without "Part"
WORDS = {"number": "a number", "integer": "a whole number", "string": "a text", "boolean": "true or false"}


@lru_cache(maxsize=1)
def tables() -> dict[str, dict[str, Any]]:
    """The schema of each table by its name; the case itself is "CasePart"."""
    whole = schema()
    return {"CasePart": whole, **whole["$defs"]}


def markdown() -> str:
    """All tables, those of the case in their order, then those that others hold."""
    return "\n".join(line for name in _order(tables()) for line in _section(name))


def _order(found: dict[str, dict[str, Any]]) -> list[str]:
    """Names as the case file mentions them, breadth first."""
    names = ["CasePart"]
    for name in names:
        names += [one for one in dict.fromkeys(_references(found[name].get("properties", {}))) if one not in names]
    return names


def _references(content: Any) -> Iterator[str]:
    if isinstance(content, dict):
        if "$ref" in content:
            yield content["$ref"].rpartition("/")[2]
        for key, value in content.items():
            if key != "mapping":
                yield from _references(value)
    elif isinstance(content, list):
        for value in content:
            yield from _references(value)


def _section(name: str) -> Iterator[str]:
    table, said = tables()[name], _said().get(name, {})
    kind = table.get("properties", {}).get("type", {}).get("const")
    title = said.get("title") or (f'A side: `type = "{kind}"`' if kind else None)
    if title is None:
        raise LookupError(f"docs/reference/keys.toml has no title of {name}")
    yield f"\n## {title}\n"
    owner = CLASSES.get(name, name.removesuffix("Part"))
    about = said.get("about", "")
    if owner in fh.__all__:
        about += f" The same as {{py:obj}}`farhorizon.{owner}`."
    yield about.strip() + "\n"
    for key, value in table.get("properties", {}).items():
        yield f"`{key}`"
        takes = _kind(value)
        unit = f" (unit: {value['unit']})" if "unit" in value else ""
        yield f": {takes[0].upper()}{takes[1:]}{unit}; {_default(table, key, value)}."
        yield f"  {meaning(name, key)}"
        yield f"  Example: `{key} = {example(name, key)}`\n"


def meaning(name: str, key: str) -> str:
    """What a key means: a paragraph of Markdown."""
    return re.sub(r"([*_<\[\]$\\])", r"\\\1", tables()[name]["properties"][key]["description"])


def example(name: str, key: str) -> str:
    """A value as it is written in a case file."""
    given = _said().get(name, {}).get("example", {}).get(key)
    if given is not None:
        return given
    properties = tables()[name]["properties"][key]
    if "const" in properties:
        return _toml(properties["const"])
    if (name, key) in (used := _used()):
        return _toml(used[name, key])
    if properties.get("default") not in (None, [], {}):
        return _toml(properties["default"])
    raise LookupError(f"docs/reference/keys.toml has no example of {name}.{key}")


@lru_cache(maxsize=1)
def _said() -> dict[str, Any]:
    return tomllib.loads((DOCS / "reference" / "keys.toml").read_text(encoding="utf-8"))


def _kind(value: dict[str, Any]) -> str:
    options = value.get("anyOf") or value.get("oneOf")
    if options:
        words = dict.fromkeys(_kind(one) for one in options if one.get("type") != "null")
        if set(words) >= {"a text", "a number"}:
            words = dict.fromkeys(["an expression or a number", *(w for w in words if w not in ("a text", "a number"))])
        return " or ".join(words)
    if "const" in value:
        return f"`{_toml(value['const'])}`"
    if "enum" in value:
        return "one of " + ", ".join(f"`{_toml(one)}`" for one in value["enum"])
    if "$ref" in value:
        return "a table"
    if value.get("type") == "array":
        return f"a list, each entry {_kind(value.get('items', {}))}"
    return "a number" if isinstance(value.get("type"), list) else WORDS.get(value.get("type", ""), "a table")


def _default(table: dict[str, Any], key: str, value: dict[str, Any]) -> str:
    if key in table.get("required", ()):
        return "required"
    default = value.get("default")
    return "optional" if default in (None, [], {}) or isinstance(default, dict) else f"`{_toml(default)}` unless given"


def _toml(value: Any) -> str:
    """A value in one line of TOML."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(one)}" for key, one in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value)


@lru_cache(maxsize=1)
def _used() -> dict[tuple[str, str], Any]:
    """The first value of each key in the examples."""
    found: dict[tuple[str, str], Any] = {}
    defined = tables()

    def visit(name: str, table: dict[str, Any]) -> None:
        for key, value in table.items():
            content = defined[name].get("properties", {}).get(key, {})
            found.setdefault((name, key), value)
            for part in value if isinstance(value, list) else [value]:
                if isinstance(part, dict):
                    below(list(_references(content)), part)

    def below(names: list[str], part: dict[str, Any]) -> None:
        fits = [n for n in names if _discriminates(defined[n], part)]
        if fits:
            visit(fits[0], part)
        else:  # a table of tables, as the sides by their names
            for inner in part.values():
                if isinstance(inner, dict):
                    below(names, inner)

    for path in CASES:
        visit("CasePart", tomllib.loads(path.read_text(encoding="utf-8")))
    return found


def _discriminates(table: dict[str, Any], part: dict[str, Any]) -> bool:
    """Whether a part is this table: by its type, or by its keys where it has none."""
    properties = table.get("properties", {})
    kind = properties.get("type", {})
    return part.keys() <= properties.keys() and (
        ("type" not in part and "type" not in properties)
        or part.get("type", kind.get("default")) in ([kind["const"]] if "const" in kind else kind.get("enum", []))
    )

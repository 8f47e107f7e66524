"""Every key of case and inversion files as Markdown, from the schema, the examples and the docstrings."""

from __future__ import annotations

import ast
import doctest
import inspect
import itertools
import json
import re
import tomllib
from collections.abc import Iterator
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import jsonschema

import farhorizon as fh
from farhorizon.case.inversion_schema import inversion_part
from farhorizon.case.schema import schema, schema_of
from farhorizon.case.toml import literal

DOCS = Path(__file__).resolve().parents[1]
CASES = [*sorted((DOCS.parent / "examples").glob("*.toml")), *sorted((DOCS / "tutorials").glob("*.toml"))]
INVERSION = re.search(r"```toml\n(.*?)```", (DOCS / "howto" / "invert.md").read_text(encoding="utf-8"), re.DOTALL)
FILES = {"CasePart": "The case", "InversionFilePart": "The inversion file"}  # headings of whole files by their tables
WORDS = {"number": "a number", "integer": "a whole number", "string": "a text", "boolean": "true or false"}


@lru_cache(maxsize=1)
def tables() -> dict[str, dict[str, Any]]:
    """The schema of each table by its name; whole files are those of `FILES`."""
    case, inversion = schema(), schema_of(inversion_part())
    inversion |= {"title": "farhorizon inversion", "description": "Shots, and what is sought from them."}
    return {"CasePart": case, "InversionFilePart": inversion, **inversion["$defs"], **case["$defs"]}


def markdown() -> str:
    """All tables, those of a file in their order, then those that others hold."""
    return "\n".join(line for name in _order(tables()) for line in _section(name))


def _order(found: dict[str, dict[str, Any]]) -> list[str]:
    """Names as the files mention them, breadth first."""
    names: list[str] = []
    for file in FILES:
        names.append(file)
        for name in itertools.islice(names, names.index(file), None):
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
    table = tables()[name]
    yield f"\n## {titles()[name]}\n"
    about = escaped(table.get("description", ""))
    owner = _owner(name)
    if owner is not None:
        about += f" The same as {{py:obj}}`farhorizon.{owner}`."
    yield about.strip() + "\n"
    for key, value in table.get("properties", {}).items():
        yield f"`{key}`"
        takes = _kind(value)
        unit = f" (unit: {value['unit']})" if "unit" in value else ""
        yield f": {takes[0].upper()}{takes[1:]}{unit}; {_default(table, key, value)}."
        yield f"  {meaning(name, key)}"
        yield f"  Example: `{key} = {example(name, key)}`\n"


def _owner(name: str) -> str | None:
    """The public class whose parameters are the keys of a table."""
    return name.removesuffix("Part") if name.removesuffix("Part") in fh.__all__ else None


@lru_cache(maxsize=1)
def titles() -> dict[str, str]:
    """The heading of each table: the keys at which it is found, and its type."""
    places: dict[str, list[str]] = {}
    for outer, table in tables().items():
        for key, value in table.get("properties", {}).items():
            place = f"[{key}]" if outer in FILES else key
            for name in _references(value):
                listed = outer in FILES and value.get("type") == "array"
                places.setdefault(name, []).append(f"[{place}]" if listed else place)
    found = dict(FILES)
    for name in _order(tables()):
        if name in FILES:
            continue
        words = ", ".join(f"`{place}`" for place in dict.fromkeys(places[name]))
        kind = tables()[name]["properties"].get("type", {})
        words += f" with `type = {literal(kind['const'])}`" if "const" in kind else ""
        found[name] = f"{words} ({name.removesuffix('Part')})" if words in found.values() else words
    return found


def escaped(text: str) -> str:
    """Words as Markdown."""
    return re.sub(r"([*_<\[\]$\\])", r"\\\1", text)


def meaning(name: str, key: str) -> str:
    """What a key means: a paragraph of Markdown."""
    return escaped(" ".join(tables()[name]["properties"][key]["description"].split()))


def example(name: str, key: str) -> str:
    """A value as it is written in a case file: of an example, of the docstring of the class, or of its kind."""
    wanted = {**tables()[name]["properties"][key], "$defs": tables()}
    fits = jsonschema.Draft202012Validator(wanted)
    return next(literal(value) for value in _values(name, key) if value is not None and fits.is_valid(value))


def _values(name: str, key: str) -> Iterator[Any]:
    """Values of a key, the best one first."""
    content = tables()[name]["properties"][key]
    yield from [_used()[name, key]] if (name, key) in _used() else []
    yield from content.get("examples", ())
    yield from (given[key] for given in _calls(_owner(name)) if key in given)
    yield content.get("default") or None
    yield from _made_up(content)


def _made_up(content: dict[str, Any]) -> Iterator[Any]:
    """Values of a kind."""
    options = [*content.get("anyOf", ()), *content.get("oneOf", ())]
    for one in sorted(options, key=lambda one: "number" not in one.get("type", "")):  # rather than an expression
        yield from _made_up(one | {"description": content.get("description", "")})
    yield from [content["const"]] if "const" in content else content.get("enum", ())
    kind = content.get("type", "")
    if "$ref" in content:
        name = content["$ref"].rpartition("/")[2]
        table = tables()[name]
        needed = table.get("required") or list(table["properties"])[:1]
        yield {key: tomllib.loads(f"value = {example(name, key)}")["value"] for key in needed}
    if kind == "array":
        yield from ([one, one] if one == 1.0 else [one] for one in _made_up(content.get("items", {"type": "number"})))
    if kind == "object" and isinstance(content.get("additionalProperties"), dict):
        yield from ({"all": one} for one in _made_up(content["additionalProperties"]))
    if "number" in kind or kind == "integer":
        yield 1.0 if "number" in kind else 2
    if kind == "boolean":
        yield True
    if kind == "string":
        yield next(iter(re.findall('"(.*?)"', content.get("description", ""))), "name")


@cache
def _calls(owner: str | None) -> list[dict[str, Any]]:
    """Arguments with which the examples in the docstring of a public class call it, as far as they are plain data."""
    if owner is None:
        return []
    kind = getattr(fh, owner)
    source = "".join(one.source for one in doctest.DocTestParser().get_examples(inspect.getdoc(kind) or ""))
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and ast.unparse(node.func) == f"fh.{owner}":
            bound = inspect.signature(kind).bind_partial(
                *node.args, **{one.arg: one.value for one in node.keywords if one.arg}
            )
            found.append({name: _plain(value) for name, value in bound.arguments.items()})
    return found


def _plain(value: Any) -> Any:
    """A literal of Python as TOML has it; None for what is none."""
    try:
        return json.loads(json.dumps(ast.literal_eval(value)))
    except (ValueError, TypeError):
        return None


def _kind(value: dict[str, Any]) -> str:
    options = value.get("anyOf") or value.get("oneOf")
    if options:
        words = dict.fromkeys(_kind(one) for one in options if one.get("type") != "null")
        if set(words) >= {"a text", "a number"}:
            words = dict.fromkeys(["an expression or a number", *(w for w in words if w not in ("a text", "a number"))])
        return " or ".join(words)
    if "const" in value:
        return f"`{literal(value['const'])}`"
    if "enum" in value:
        return "one of " + ", ".join(f"`{literal(one)}`" for one in value["enum"])
    if "$ref" in value:
        return "a table"
    if value.get("type") == "array":
        return f"a list, each entry {_kind(value.get('items', {}))}"
    return "a number" if isinstance(value.get("type"), list) else WORDS.get(value.get("type", ""), "a table")


def _default(table: dict[str, Any], key: str, value: dict[str, Any]) -> str:
    if key in table.get("required", ()):
        return "required"
    default = value.get("default")
    return (
        "optional" if default in (None, [], {}) or isinstance(default, dict) else f"`{literal(default)}` unless given"
    )


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
    if INVERSION is not None:
        visit("InversionFilePart", tomllib.loads(INVERSION[1]))
    return found


def _discriminates(table: dict[str, Any], part: dict[str, Any]) -> bool:
    """Whether a part is this table: by its type, or by its keys where it has none."""
    properties = table.get("properties", {})
    kind = properties.get("type", {})
    return part.keys() <= properties.keys() and (
        ("type" not in part and "type" not in properties)
        or part.get("type", kind.get("default")) in ([kind["const"]] if "const" in kind else kind.get("enum", []))
    )

"""Changes of a case by dotted keys, as given on the command line."""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

from farhorizon.errors import InputError


def parsed(text: str) -> tuple[str, Any]:
    """Key and value of ``key=value``: the value is TOML, or a string where it is not valid TOML; InputError without a
    key, an equals sign or a value.
    """
    key, equals, value = (part.strip() for part in text.partition("="))
    if not (key and equals and value):
        raise InputError(
            "give a key of the case and its value", value=text, key="--set", remedy="--set model.speed=2.0"
        )
    try:
        tables = tomllib.loads(f"value = {value}")
    except (ValueError, RecursionError):
        return key, value
    return key, tables["value"] if len(tables) == 1 else value


def steps(key: str) -> list[str]:
    """Names and numbers in a dotted key: ``crack[0].points`` and ``crack.0.points`` are the same."""
    return key.replace('"', "").replace("[", ".").replace("]", "").split(".")


def changed(data: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """A copy of a case's tables with values set at dotted keys; missing tables are created. InputError where a key
    leads through something that is not a table, or to an entry that a list does not have.
    """
    tables: dict[str, Any] = copy.deepcopy(dict(data))
    for key, value in changes.items():
        names = steps(key)
        container: Any = tables
        for step, following in pairwise(names):
            if isinstance(container, list):
                container = container[_entry(container, step, key)]
            else:  # a missing list has no entries
                container = _table(container, key).setdefault(step, [] if following.isdecimal() else {})
        if isinstance(container, list):
            container[_entry(container, names[-1], key)] = value
        else:
            _table(container, key)[names[-1]] = value
    return tables


def _table(value: Any, key: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InputError("the key leads through a value that is not a table", value=value, key=key)
    return value


def _entry(entries: list[Any], step: str, key: str) -> int:
    if not (step.isdecimal() and int(step) < len(entries)):
        limit = f"0 to {len(entries) - 1}" if entries else "none: it is empty"
        raise InputError("the list has no such entry", value=step, limit=limit, key=key)
    return int(step)

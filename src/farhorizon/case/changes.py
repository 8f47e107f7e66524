"""Changes of a case by dotted keys, as given on the command line."""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

from farhorizon.errors import InputError


def parsed(text: str) -> tuple[str, Any]:
    """Key and value of ``key=value``: the value is TOML, or a string where it is not valid TOML.

    Raises
    ------
    InputError
        There is no key, no equals sign or no value.
    """
    key, equals, value = (part.strip() for part in text.partition("="))
    if not (key and equals and value):
        raise InputError(
            "give a key of the case and its value", value=text, key="--set", remedy="--set model.speed=2.0"
        )
    try:
        found = tomllib.loads(f"value = {value}")
    except (ValueError, RecursionError):
        return key, value
    return key, found["value"] if len(found) == 1 else value


def steps(key: str) -> list[str]:
    """Names and numbers in a dotted key: ``crack[0].points`` and ``crack.0.points`` are the same."""
    return key.replace('"', "").replace("[", ".").replace("]", "").split(".")


def changed(data: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """A copy of a case's tables with values set at dotted keys; missing tables are created.

    Raises
    ------
    InputError
        A key leads through something that is not a table, or to an entry that a list does not have.
    """
    whole: dict[str, Any] = copy.deepcopy(dict(data))
    for key, value in changes.items():
        names = steps(key)
        place: Any = whole
        for step, following in pairwise(names):
            if isinstance(place, list):
                place = place[_entry(place, step, key)]
            else:  # a missing list has no entries
                place = _table(place, key).setdefault(step, [] if following.isdecimal() else {})
        if isinstance(place, list):
            place[_entry(place, names[-1], key)] = value
        else:
            _table(place, key)[names[-1]] = value
    return whole


def _table(place: Any, key: str) -> dict[str, Any]:
    if not isinstance(place, dict):
        raise InputError("the key leads through a value that is not a table", value=place, key=key)
    return place


def _entry(place: list[Any], step: str, key: str) -> int:
    if not (step.isdecimal() and int(step) < len(place)):
        entries = f"0 to {len(place) - 1}" if place else "none: it is empty"
        raise InputError("the list has no such entry", value=step, limit=entries, key=key)
    return int(step)

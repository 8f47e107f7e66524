"""`farhorizon sweep`: run a case for many values of some keys."""

from __future__ import annotations

import argparse
import tomllib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from farhorizon.cli.common import FAILED, GOOD, INTERRUPTED, case_of, check_folder, made_folder, write_json

if TYPE_CHECKING:
    from farhorizon.cli.outputs import SweepFacts


def sweep_command(options: argparse.Namespace) -> int:
    """Run all combinations, several at a time, and print the table."""
    from farhorizon.studies.sweep import sweep

    check_folder(options.out)
    case = case_of(options)
    changes = _changes(options.changes)
    path = made_folder(options.out) / f"{case.name}-sweep.csv"
    if options.force:
        path.unlink(missing_ok=True)
    try:
        swept = sweep(case, changes, table=path, jobs=options.jobs, progress=True)
    except KeyboardInterrupt:
        print(f"\ninterrupted; the same command continues {path}", file=options.errors)
        return INTERRUPTED
    print(swept, file=options.output)
    print(f"table: {path}")
    facts: SweepFacts = {
        "name": case.name,
        "table": str(path),
        "changes": swept.changes,
        "figures": swept.figures,
        "failed": {str(number): why for number, why in swept.failed.items()},
    }
    write_json(options.json, facts)
    return FAILED if swept.failed else GOOD


def _changes(texts: Sequence[str]) -> dict[str, list[Any]]:
    """Values by key."""
    from farhorizon.errors import InputError

    changes: dict[str, list[Any]] = {}
    for key, values in map(_values, texts):
        if key in changes:
            remedy = f"all values after one equals sign: {key}=VALUE,VALUE"
            raise InputError("a key is given twice", value=key, key="KEY=VALUES", remedy=remedy)
        changes[key] = values
    return changes


def _values(text: str) -> tuple[str, list[Any]]:
    """Key and values of ``key=value,value``: the values are TOML, or strings if they are not valid TOML."""
    from farhorizon.errors import InputError

    key, _, several = (part.strip() for part in text.partition("="))
    if not (key and several):
        raise InputError("give a key and its values", value=text, key="KEY=VALUES", remedy="model.speed=1.0,2.0")
    try:
        return key, list(tomllib.loads(f"values = [{several}]")["values"])
    except (ValueError, RecursionError):
        return key, [part.strip() for part in several.split(",")]

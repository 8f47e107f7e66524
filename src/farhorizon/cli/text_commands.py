"""Commands that print text: new, keys, schema, info."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from farhorizon.cli.common import GOOD


def new_command(options: argparse.Namespace) -> int:
    from farhorizon.case.templates import KINDS, brief, template
    from farhorizon.errors import InputError, suggestion

    if options.kind is None:
        if options.out is not None:
            raise InputError("a case has a kind", key="--out", remedy=f"farhorizon new {KINDS[0]} -o {options.out}")
        print("\n".join(f"{kind:12}{brief(kind)}" for kind in KINDS))
        return GOOD
    if options.kind not in KINDS:
        raise InputError("no such kind of case", value=options.kind, key="new", remedy=suggestion(options.kind, KINDS))
    if options.out is None:
        print(template(options.kind), end="")
        return GOOD
    path = Path(options.out)
    try:
        with path.open("w" if options.force else "x", encoding="utf-8") as file:
            file.write(template(options.kind))
    except FileExistsError:
        raise InputError(f"{path} exists", key="--out", remedy="--force overwrites it") from None
    print(f"{path}: farhorizon check {path} shows what to expect, farhorizon run {path} computes it")
    return GOOD


def keys_command(options: argparse.Namespace) -> int:
    from shutil import get_terminal_size

    from farhorizon.case.keys import explain_keys

    print(explain_keys(options.prefix, min(get_terminal_size().columns, 120)))
    return GOOD


def schema_command(options: argparse.Namespace) -> int:
    from farhorizon.case.schema import schema
    from farhorizon.cli.outputs import output_schema

    print(json.dumps(output_schema(options.of) if options.of else schema(), indent=1))
    return GOOD


def info_command(options: argparse.Namespace) -> int:
    from farhorizon.engine.engine import available_threads
    from farhorizon.files.cache import cache_folder
    from farhorizon.files.provenance import versions

    for name, value in (*versions(), ("threads", available_threads()), ("compiled programs", cache_folder())):
        print(f"{name:<18}{value}")
    return GOOD

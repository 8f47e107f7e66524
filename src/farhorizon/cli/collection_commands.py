"""`farhorizon reproduce` and `farhorizon validate`."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from farhorizon.cli.common import GOOD, made_folder, write_json

if TYPE_CHECKING:
    from farhorizon.studies.collection import Collection


def reproduce_command(options: argparse.Namespace) -> int:
    from farhorizon.papers.reproductions import REPRODUCTIONS

    return _list_or_compute(REPRODUCTIONS, options)


def validate_command(options: argparse.Namespace) -> int:
    from farhorizon.validation.validations import VALIDATIONS

    return _list_or_compute(VALIDATIONS, options)


def _list_or_compute(collection: Collection, options: argparse.Namespace) -> int:
    from farhorizon.engine.engine import at_most
    from farhorizon.studies.collection import outcome_table

    if options.name is None:
        entries = collection.entries()
        width, longest = max(map(len, entries)), max(len(entry.duration) for entry in entries.values())
        for name, entry in entries.items():
            print(f"{name:{width}}  {entry.duration:{longest}}  {entry.title}", file=options.output)
        write_json(options.json, {name: entry.facts for name, entry in entries.items()})
        return GOOD
    entry = collection.find(options.name)
    print(f"{entry.paper}\n{entry.name}: {entry.title}")
    with at_most(options.threads):
        outcome = entry.run(made_folder(options.out), options.full)
    print(outcome_table(outcome, collection.known), file=options.output)
    if outcome.pictures:
        print(f"pictures: {', '.join(str(p) for p in outcome.pictures)}")
    write_json(options.json, entry.as_json(outcome))
    return GOOD

"""`farhorizon reproduce` and `farhorizon validate`."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from farhorizon.cli.common import FAILED, GOOD, made_folder, write_json

if TYPE_CHECKING:
    from farhorizon.studies.collection import Collection, Entry, Outcome


def reproduce_command(options: argparse.Namespace) -> int:
    from farhorizon.papers.reproductions import REPRODUCTIONS

    return _list_or_compute(REPRODUCTIONS, options)


def validate_command(options: argparse.Namespace) -> int:
    from farhorizon.validation.validations import VALIDATIONS

    return _list_or_compute(VALIDATIONS, options)


def _list_or_compute(collection: Collection, options: argparse.Namespace) -> int:
    if options.name is None:
        _print_list(collection, options)
        return GOOD
    entries = collection.select(options.name)
    facts: dict[str, Any] = {}
    unexplained = []
    for entry in entries:
        outcome = _compute(collection, entry, options)
        unexplained += [f"{entry.name}, {what}" for what in outcome.unexplained(collection.tolerance)]
        facts[entry.name] = entry.as_json(outcome)
        # after each entry, so that a series that is interrupted keeps what it has found
        write_json(options.json, facts[entry.name] if len(entries) == 1 else facts)
    if unexplained:
        limit = f"more than {100 * collection.tolerance:g} % from the {collection.known} number, for no known reason"
        print(f"{limit}: {'; '.join(unexplained)}", file=options.output)
    return FAILED if unexplained else GOOD


def _print_list(collection: Collection, options: argparse.Namespace) -> None:
    entries = collection.entries()
    labels = {name: ", ".join([name, *entry.figures]) for name, entry in entries.items()}
    width, longest = max(map(len, labels.values())), max(len(entry.duration) for entry in entries.values())
    for name, entry in entries.items():
        print(f"{labels[name]:{width}}  {entry.duration:{longest}}  {entry.title}", file=options.output)
    write_json(options.json, {name: entry.facts for name, entry in entries.items()})


def _compute(collection: Collection, entry: Entry, options: argparse.Namespace) -> Outcome:
    """Compute an entry and print it, with its readings of the paper before and its comparisons with it at the end."""
    from farhorizon.engine.engine import at_most
    from farhorizon.studies.collection import outcome_table

    print(f"{entry.paper}\n{entry.name}: {entry.title}")
    for reading in entry.readings:
        print(f"reading of the paper: {reading}")
    with at_most(options.threads):
        outcome = entry.run(made_folder(options.out), options.full)
    if outcome.settings:
        print(f"settings: {'; '.join(map(str, outcome.settings))}")
    table = outcome_table(outcome, collection.known, getattr(options, "details", True), collection.tolerance)
    print(table, file=options.output)
    if outcome.pictures:
        print(f"pictures: {', '.join(str(p) for p in outcome.pictures)}")
    for comparison in outcome.comparisons:
        print(comparison, file=options.output)
    return outcome

"""`farhorizon reproduce`."""

from __future__ import annotations

import argparse

from farhorizon.cli.common import GOOD, made_folder, write_json


def reproduce_command(options: argparse.Namespace) -> int:
    from farhorizon.engine.engine import at_most
    from farhorizon.papers.registry import find, outcome_table, reproductions

    if options.name is None:
        known = reproductions()
        width, longest = max(map(len, known)), max(len(entry.duration) for entry in known.values())
        for name, entry in known.items():
            print(f"{name:{width}}  {entry.duration:{longest}}  {entry.title}", file=options.output)
        write_json(options.json, {name: entry.entry for name, entry in known.items()})
        return GOOD
    entry = find(options.name)
    print(f"{entry.paper}\n{entry.name}: {entry.title}")
    with at_most(options.threads):
        outcome = entry.run(made_folder(options.out), options.full)
    print(outcome_table(outcome), file=options.output)
    if outcome.pictures:
        print(f"pictures: {', '.join(str(p) for p in outcome.pictures)}")
    write_json(options.json, entry.as_json(outcome))
    return GOOD

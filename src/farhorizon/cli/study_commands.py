"""Commands that run a case several times, or run several: sweep, compare, demo, reproduce, validate."""

from __future__ import annotations

import argparse
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from farhorizon.cli.common import (
    FAILED,
    GOOD,
    INTERRUPTED,
    case_of,
    check_folder,
    made_folder,
    thread_change,
    write_json,
)

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


def _compare_case(
    options: argparse.Namespace, case: Any, folder: Path, times: Sequence[float] | None, moment: float | None
) -> None:
    import numpy as np

    from farhorizon.pictures.curves import error_history
    from farhorizon.pictures.fields import field_panels
    from farhorizon.pictures.panels import Look, Panel, magnitude
    from farhorizon.pictures.style import counted_in, time_text, with_unit
    from farhorizon.pictures.words import axis_label
    from farhorizon.studies.compare import compare

    with case.naming():
        result = compare(case.setup, case.end, times, moment)
    print(result.table())
    shown = {
        name: value if value.ndim == case.lattice.dim else magnitude(value)
        for name, value in result.fields.items()
        if name != "free edge"
    }
    folder.mkdir(parents=True, exist_ok=True)
    picture, history = folder / "compare.png", folder / "error.png"
    named = "|u|" if any(value.ndim > case.lattice.dim for value in result.fields.values()) else "u"
    curves = {name: (np.array(c["times"]), np.array(c["error_rel_initial"])) for name, c in result.curves.items()}
    with counted_in(case.unit_names):
        panels = [Panel(f"{name}, t = {time_text(result.shown_time)}", value) for name, value in shown.items()]
        look = Look(axis_label(named, "u", case.quantities), cracks=case.polylines, smooth=True)
        field_panels(panels, case.lattice.axes, picture, look)
        above, below = f"max error / {result.scale}", with_unit("t", "time")
        error_history(curves, history, above, "Error against the infinite medium", xlabel=below)
    print(f"pictures: {picture}, {history}")
    if options.quiet:
        print(f"{case.name}: {result.headline}", file=options.output)
    write_json(options.json, result.as_json())


def compare_command(options: argparse.Namespace) -> int:
    check_folder(options.out)
    case = case_of(options)
    _compare_case(options, case, Path(options.out) / case.name, options.times, None)
    return GOOD


def demo_command(options: argparse.Namespace) -> int:
    check_folder(options.out)
    from importlib.resources import files

    from farhorizon.case.case import Case

    text = files("farhorizon.case").joinpath("demo.toml").read_text(encoding="utf-8")
    case = Case(text, "two_notches.toml", thread_change(options))
    print("An infinite membrane with two notches, seen through a disc of radius 26 (example 3 of Hermann et al. 2023).")
    print(
        "Running it with the lattice PML, with a fixed and a free edge, and on a domain from which nothing returns ..."
    )
    _compare_case(options, case, Path(options.out), None, 30.0)
    return GOOD


if TYPE_CHECKING:
    from farhorizon.studies.collection import Collection, Entry, Outcome


def reproduce_command(options: argparse.Namespace) -> int:
    from farhorizon.papers import REPRODUCTIONS

    return _list_or_compute(REPRODUCTIONS, options)


def validate_command(options: argparse.Namespace) -> int:
    from farhorizon.validation import VALIDATIONS

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

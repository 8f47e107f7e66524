"""Shared by several commands: exit codes, files and folders, the case, one-line warnings."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from farhorizon.cli.processes import refuse_processes

GOOD, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


def write_json(path: str | None, facts: Mapping[str, Any]) -> None:
    """Write the output of a command to the file of --json, if given; `farhorizon.cli.outputs` describes it."""
    if path:
        Path(path).write_text(json.dumps(_finite(facts), indent=1, allow_nan=False) + "\n")


def _finite(facts: Any) -> Any:
    """The same output with null for numbers that overflowed, because JSON has no infinity."""
    if isinstance(facts, Mapping):
        return {name: _finite(value) for name, value in facts.items()}
    if isinstance(facts, list):
        return list(map(_finite, facts))
    return None if isinstance(facts, float) and not math.isfinite(facts) else facts


def check_json(name: str | None) -> None:
    """Refuse a JSON file that cannot be written, before any work."""
    from farhorizon.errors import InputError

    if name and (Path(name).is_dir() or not os.access(Path(name).parent, os.W_OK)):
        raise InputError(
            "cannot write this file",
            value=name,
            key="--json",
            remedy="a file in a folder that exists and may be written",
        )


def check_folder(name: str) -> None:
    """Refuse a folder that cannot be created, without creating it."""
    from farhorizon.errors import InputError

    existing = next(p for p in (Path(name).resolve(), *Path(name).resolve().parents) if p.exists())
    if not (existing.is_dir() and os.access(existing, os.W_OK)):
        what = "not a writable folder: choose another"
        if existing.is_file():
            what = "a file: choose another folder, or another name for the case, such as case.toml"
        raise InputError("cannot make the folder", value=name, key="--out", remedy=f"{existing} is {what}")


def made_folder(name: str) -> Path:
    """A folder, created if it does not exist."""
    from farhorizon.errors import InputError

    folder = Path(name)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the folder {folder}: {error.strerror}", key="--out") from None
    return folder


def case_of(options: argparse.Namespace, parallel: bool = False) -> Any:
    """The case file with the changes of the command line; only on one process, unless several compute it together."""
    from farhorizon.case.case import Case
    from farhorizon.case.changes import parsed

    if not parallel:
        refuse_processes()
    return Case.read(options.case, dict(map(parsed, options.set)) | thread_change(options))


def thread_change(options: argparse.Namespace) -> dict[str, Any]:
    """The change of a case that --threads requests."""
    return {} if options.threads is None else {"run.threads": options.threads}


@contextmanager
def one_line_warnings() -> Iterator[None]:
    """Context in which validity warnings are printed as single lines on stderr."""
    from farhorizon.errors import ValidityWarning

    usual = warnings.showwarning

    def show(message: Any, category: type[Warning], *where: Any, **more: Any) -> None:
        if issubclass(category, ValidityWarning):
            print(f"warning: {message}", file=sys.stderr)
        else:
            usual(message, category, *where, **more)

    with warnings.catch_warnings():
        warnings.simplefilter("always", ValidityWarning)
        warnings.showwarning = show
        yield

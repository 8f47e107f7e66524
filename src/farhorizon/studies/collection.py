"""Collections of computations with known results: published tables and figures, exact solutions.

An entry is a function of a folder (where it may draw pictures) that returns an `Outcome`: computed numbers, each with
the expected one. `Collection.enter` adds it to a collection under a name.
"""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NotRequired

import numpy as np
from typing_extensions import TypedDict

from farhorizon.errors import InputError


@dataclass(frozen=True)
class Row:
    """One number of a table or figure.

    Attributes
    ----------
    what : str
        Description, e.g. ``"t = 5, dt = 0.001"``.
    ours : float
    printed : float, optional
        Value in the paper or of the exact solution; None if there is none.
    corrected : float, optional
        Correct value of a misprint.
    note : str
        Explanation, in one line.
    """

    what: str
    ours: float
    printed: float | None = None
    corrected: float | None = None
    note: str = ""

    @property
    def expected(self) -> float | None:
        """The printed number, or the correct value of a misprint."""
        return self.printed if self.corrected is None else self.corrected

    @property
    def deviation(self) -> float | None:
        """Relative deviation of the computed number from the expected one."""
        return self.ours / self.expected - 1 if self.expected else None


@dataclass(frozen=True)
class Outcome:
    """Result of an entry.

    Attributes
    ----------
    rows : list of Row
    infinite_error : dict of str to float
        For each boundary, the largest difference from the infinite medium at the same time step, relative to the
        initial maximum.
    pictures : list of Path
    remarks : list of str
        What the publication leaves open and what each choice does, one sentence each.
    """

    rows: list[Row]
    infinite_error: dict[str, float] = field(default_factory=dict)
    pictures: list[Path] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)


class RowFacts(TypedDict):
    """One number of a table or figure."""

    what: str
    """Description of the number."""
    ours: float
    """The computed number."""
    printed: float | None
    """Value in the paper or of the exact solution; null if there is none."""
    corrected: float | None
    """Correct value of a misprint; null if there is none."""
    note: str
    """Explanation, in one line."""


class OutcomeFacts(TypedDict):
    """Computed numbers next to the known ones."""

    name: str
    """Name in the list."""
    paper: str
    """Publication."""
    rows: list[RowFacts]
    """Computed numbers, each with the expected one."""
    infinite_error: dict[str, float]
    """For each boundary, the largest difference from the infinite medium at the same time step, relative to the initial
    maximum."""
    pictures: list[str]
    """Names of files in the folder of the pictures."""
    remarks: NotRequired[list[str]]
    """What the publication leaves open, and what each choice does."""


class EntryFacts(TypedDict):
    """An entry of the list."""

    paper: str
    """Publication."""
    title: str
    """What the entry shows."""
    takes: str
    """Approximate run time."""
    full: str
    """Approximate run time in the published size; empty if there is only one size."""


@dataclass(frozen=True)
class Entry:
    """An entry of a collection.

    Attributes
    ----------
    name, paper, title : str
    function : callable
        Takes the folder of the pictures, and `full` if the entry is scaled.
    takes : {"seconds", "a minute"}
        Approximate run time on one core, once everything needed is compiled.
    full : {"", "a minute", "minutes", "an hour"}
        The same in full size, if the default is a smaller version or has larger steps; empty if there is only one size.
    """

    name: str
    paper: str
    title: str
    function: Callable[..., Outcome]
    takes: str = "seconds"
    full: str = ""

    @property
    def scaled(self) -> bool:
        """Whether it is run in a smaller version, or with larger steps, unless the full one is requested."""
        return bool(self.full)

    @property
    def duration(self) -> str:
        """Run time, as stated in the list."""
        return f"{self.takes}; --full: {self.full}" if self.scaled else self.takes

    def run(self, folder: Path, full: bool = False) -> Outcome:
        """Compute the entry; with `full` in the published size, or that which gives the closest agreement."""
        return self.function(folder, full) if self.scaled else self.function(folder)

    @property
    def facts(self) -> EntryFacts:
        """The entry of the list as plain data."""
        return {"paper": self.paper, "title": self.title, "takes": self.takes, "full": self.full}

    def as_json(self, outcome: Outcome) -> OutcomeFacts:
        """Return an outcome as plain data."""
        rows = [_row_facts(row) for row in outcome.rows]
        pictures = [path.name for path in outcome.pictures]
        found: OutcomeFacts = {
            "name": self.name,
            "paper": self.paper,
            "rows": rows,
            "infinite_error": outcome.infinite_error,
            "pictures": pictures,
        }
        return {**found, "remarks": outcome.remarks} if outcome.remarks else found


def _row_facts(row: Row) -> RowFacts:
    return {"what": row.what, "ours": row.ours, "printed": row.printed, "corrected": row.corrected, "note": row.note}


@dataclass(frozen=True)
class Collection:
    """Entries by name.

    Attributes
    ----------
    command : str
        The command that lists and computes them.
    package : str
        Package of the modules that enter them.
    modules : tuple of str
        Names of these modules, in the order of the list.
    known : str
        Heading of the column of known numbers.
    """

    command: str
    package: str
    modules: tuple[str, ...]
    known: str
    _entries: dict[str, Entry] = field(default_factory=dict)

    def enter(
        self, name: str, paper: str, title: str, takes: str = "seconds", full: str = ""
    ) -> Callable[[Callable[..., Outcome]], Callable[..., Outcome]]:
        """Decorator that enters a function of the folder of the pictures; if there is a `full` size, the function takes
        `full` as well. See `Entry`.
        """

        def entered(function: Callable[..., Outcome]) -> Callable[..., Outcome]:
            self._entries[name] = Entry(name, paper, title, function, takes, full)
            return function

        return entered

    def entries(self) -> dict[str, Entry]:
        """Return all entries by name, in the order of the modules."""
        for module in self.modules:
            importlib.import_module(f"{self.package}.{module}")
        return dict(self._entries)

    def find(self, name: str) -> Entry:
        """Return the entry of a name.

        Raises
        ------
        InputError
            The name is unknown; the closest known one is suggested.
        """
        entries = self.entries()
        if name not in entries:
            near = difflib.get_close_matches(name, entries, 1, 0.4)
            raise InputError(
                "there is no entry of this name",
                value=name,
                limit=", ".join(entries),
                key=self.command,
                remedy=f"did you mean {near[0]!r}?" if near else f"farhorizon {self.command} lists them",
            )
        return entries[name]


def _number(value: float) -> str:
    """A counted number with all its digits, in groups of three from five digits on; a measured one to five digits."""
    if not isinstance(value, int | np.integer):
        return f"{value:.5g}"
    return f"{value:,}".replace(",", " ") if abs(value) >= 10_000 else str(value)


def outcome_table(outcome: Outcome, known: str) -> str:
    """Return the rows as text: the computed number, the known one under its heading, deviation, note."""
    width = max(len(row.what) for row in outcome.rows)
    lines = [f"{'':{width}}  {'ours':>10}  {known:>10}  {'deviation':>9}  note"]
    for row in outcome.rows:
        printed = "" if row.printed is None else _number(row.printed)
        deviation = "" if row.deviation is None else f"{100 * row.deviation:+.1f} %"
        note = row.note if row.corrected is None else f"misprint, read {row.corrected:.3g}: {row.note}"
        lines.append(f"{row.what:{width}}  {_number(row.ours):>10}  {printed:>10}  {deviation:>9}  {note}".rstrip())
    for name, value in outcome.infinite_error.items():
        lines.append(f"error against the infinite medium at the same time step, {name}: {value:.1e}")
    return "\n".join([*lines, *outcome.remarks])

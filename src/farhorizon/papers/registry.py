"""Published tables and figures, computed anew: one module a paper, each result beside the printed one.

A reproduction is a function of a folder (where it may draw a picture) that returns an `Outcome`; `reproduction` enters
it under a name.
"""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from typing_extensions import TypedDict

from farhorizon.errors import InputError

_MODULES = ("bobaru2010", "hermann2023", "ji2021", "shojaei2020", "shojaei2020_corrosion", "wildman2012")


@dataclass(frozen=True)
class Row:
    """One number of a table or figure.

    Attributes
    ----------
    what : str
        What it is, e.g. ``"t = 5, dt = 0.001"``.
    ours : float
    printed : float, optional
        As the paper has it; None where it gives no number.
    corrected : float, optional
        What a misprint should read.
    note : str
        Why, in one line.
    """

    what: str
    ours: float
    printed: float | None = None
    corrected: float | None = None
    note: str = ""

    @property
    def expected(self) -> float | None:
        """The printed number, a misprint corrected."""
        return self.printed if self.corrected is None else self.corrected

    @property
    def deviation(self) -> float | None:
        """Relative deviation of ours from what is expected."""
        return self.ours / self.expected - 1 if self.expected else None


@dataclass(frozen=True)
class Outcome:
    """What a reproduction found.

    Attributes
    ----------
    rows : list of Row
    infinite_error : dict of str to float
        For each boundary, the largest difference from the infinite medium at the same time step, relative to the
        initial maximum.
    pictures : list of Path
    """

    rows: list[Row]
    infinite_error: dict[str, float] = field(default_factory=dict)
    pictures: list[Path] = field(default_factory=list)


class RowFacts(TypedDict):
    """One number of a table or figure."""

    what: str
    """What it is."""
    ours: float
    """The number as computed here."""
    printed: float | None
    """As the paper has it; null where it gives no number."""
    corrected: float | None
    """What a misprint should read; null where there is none."""
    note: str
    """Why, in one line."""


class OutcomeFacts(TypedDict):
    """A published table or figure computed anew."""

    name: str
    """Name in the list of reproductions."""
    paper: str
    """Where it was published."""
    rows: list[RowFacts]
    """Its numbers, ours beside the printed ones."""
    infinite_error: dict[str, float]
    """By boundary the largest difference from the infinite medium at the same time step, relative to the initial
    maximum."""
    pictures: list[str]
    """Files in the folder of the pictures."""


class EntryFacts(TypedDict):
    """An entry of the list of reproductions."""

    paper: str
    """Where it was published."""
    title: str
    """What it shows."""
    takes: str
    """About how long it runs."""
    full: str
    """About how long it runs in the published size; empty if there is one size."""


@dataclass(frozen=True)
class Reproduction:
    """An entry of the list of reproductions.

    Attributes
    ----------
    name, paper, title : str
    function : callable
        Takes the folder of the pictures, and `full` if it is scaled.
    takes : {"seconds", "a minute"}
        About how long it runs on one core, once what it needs is compiled.
    full : {"", "a minute", "minutes", "an hour"}
        The same of the published size, where the default is a smaller version or has larger steps; empty if there is
        one size.
    """

    name: str
    paper: str
    title: str
    function: Callable[..., Outcome]
    takes: str = "seconds"
    full: str = ""

    @property
    def scaled(self) -> bool:
        """Whether it runs in a smaller version, or with larger steps, unless the full one is asked for."""
        return bool(self.full)

    @property
    def duration(self) -> str:
        """The words of the list for how long it runs."""
        return f"{self.takes}; --full: {self.full}" if self.scaled else self.takes

    def run(self, folder: Path, full: bool = False) -> Outcome:
        """Compute it; `full` as published, as far as the machine allows within minutes."""
        return self.function(folder, full) if self.scaled else self.function(folder)

    @property
    def entry(self) -> EntryFacts:
        """What the list says, as plain data."""
        return {"paper": self.paper, "title": self.title, "takes": self.takes, "full": self.full}

    def as_json(self, outcome: Outcome) -> OutcomeFacts:
        """The outcome as plain data."""
        rows = [_row_facts(row) for row in outcome.rows]
        pictures = [path.name for path in outcome.pictures]
        return {
            "name": self.name,
            "paper": self.paper,
            "rows": rows,
            "infinite_error": outcome.infinite_error,
            "pictures": pictures,
        }


def _row_facts(row: Row) -> RowFacts:
    return {"what": row.what, "ours": row.ours, "printed": row.printed, "corrected": row.corrected, "note": row.note}


_ENTRIES: dict[str, Reproduction] = {}


def reproduction(
    name: str, paper: str, title: str, takes: str = "seconds", full: str = ""
) -> Callable[[Callable[..., Outcome]], Callable[..., Outcome]]:
    """Decorator that enters a function of the pictures' folder into the list; one with a `full` size takes `full`, too.
    See `Reproduction`.
    """

    def enter(function: Callable[..., Outcome]) -> Callable[..., Outcome]:
        _ENTRIES[name] = Reproduction(name, paper, title, function, takes, full)
        return function

    return enter


def reproductions() -> dict[str, Reproduction]:
    """All entries by name, in the order of the papers and of their tables."""
    for module in _MODULES:
        importlib.import_module(f"farhorizon.papers.{module}")
    return dict(_ENTRIES)


def find(name: str) -> Reproduction:
    """The entry of a name.

    Raises
    ------
    InputError
        An unknown name; the nearest known one is suggested.
    """
    known = reproductions()
    if name not in known:
        near = difflib.get_close_matches(name, known, 1, 0.4)
        raise InputError(
            "unknown reproduction",
            value=name,
            limit=", ".join(known),
            key="reproduce",
            remedy=f"did you mean {near[0]!r}?" if near else "farhorizon reproduce lists them",
        )
    return known[name]


def outcome_table(outcome: Outcome) -> str:
    """The rows as text: ours, printed, deviation, note."""
    width = max(len(row.what) for row in outcome.rows)
    lines = [f"{'':{width}}  {'ours':>10}  {'printed':>10}  {'deviation':>9}  note"]
    for row in outcome.rows:
        printed = "" if row.printed is None else f"{row.printed:.5g}"
        deviation = "" if row.deviation is None else f"{100 * row.deviation:+.1f} %"
        note = row.note if row.corrected is None else f"misprint, read {row.corrected:.3g}: {row.note}"
        lines.append(f"{row.what:{width}}  {row.ours:>10.5g}  {printed:>10}  {deviation:>9}  {note}".rstrip())
    for name, value in outcome.infinite_error.items():
        lines.append(f"error against the infinite medium at the same time step, {name}: {value:.1e}")
    return "\n".join(lines)

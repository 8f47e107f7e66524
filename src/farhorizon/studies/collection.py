"""Collections of computations with known results: published tables and figures, exact solutions.

An entry is a function of a folder (where it may draw pictures) that returns an `Outcome`: computed numbers, each with
the expected one. `Collection.enter` adds it to a collection under a name.
"""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from typing_extensions import TypedDict

from farhorizon.errors import InputError


@dataclass(frozen=True)
class Row:
    """One number of a table or figure."""

    what: str  # such as "t = 5, dt = 0.001"
    ours: float
    printed: float | None = None  # value in the paper or of the exact solution
    corrected: float | None = None  # correct value of a misprint
    note: str = ""  # explanation, in one line
    reason: str = ""  # of a deviation by more than the tolerance of the collection, where it is known
    key: bool = False  # answers a statement of the paper, and is listed without the details though no number is printed

    @property
    def expected(self) -> float | None:
        """The printed number, or the correct value of a misprint."""
        return self.printed if self.corrected is None else self.corrected

    @property
    def deviation(self) -> float | None:
        """Relative deviation of the computed number from the expected one."""
        return self.ours / self.expected - 1 if self.expected else None

    def within(self, tolerance: float) -> bool:
        """Whether the deviation is at most `tolerance`; true without an expected number, false after an overflow."""
        return self.deviation is None or abs(self.deviation) <= tolerance


@dataclass(frozen=True)
class Setting:
    """One parameter of a computation, beside that of the paper."""

    what: str  # such as "time step"
    ours: float
    paper: float | None = None  # None if the paper does not state it
    note: str = ""  # explanation, in one line

    def __str__(self) -> str:
        """The setting in one line, with the ratio where it is not that of the paper."""
        if self.paper is None:
            beside = "not stated in the paper"
        elif abs(self.ours - self.paper) <= _SAME * abs(self.paper):
            beside = "as in the paper"
        else:
            more, less = sorted((abs(self.ours), abs(self.paper)), reverse=True)
            ratio = f", {float(f'{more / less:.3g}'):g} times {'larger' if more == abs(self.ours) else 'smaller'}"
            factor = ratio if less and more / less > _MUCH else ""
            beside = f"paper: {_number(self.paper)}{factor}"
        return f"{self.what} {_number(self.ours)} ({beside}{'; ' * bool(self.note)}{self.note})"


_MUCH = 1.01  # ratio of settings below which a factor says less than the two numbers
_SAME = 1e-9  # relative difference between settings that are the same number up to rounding


@dataclass(frozen=True)
class Comparison:
    """What a figure or table of the paper shows, and what the computation shows."""

    item: str  # such as "figure 5"
    paper: str  # the end of a sentence that begins with "shows", as the next one
    ours: str
    agrees: bool  # determined from the computed numbers
    reason: str = ""  # why they differ, if they do and it is known

    def __str__(self) -> str:
        """The comparison as one sentence."""
        verdict = "agrees" if self.agrees else f"differs because {self.reason}" if self.reason else "differs"
        return f"{self.item}: the paper shows {self.paper}; this run shows {self.ours}: {verdict}."

    @classmethod
    def of_rows(cls, item: str, rows: Sequence[Row], paper: str = "", tolerance: float = 0.05) -> Comparison:
        """Comparison of the printed numbers among some rows; `paper` says what they are, if there are too few words."""
        printed = [row for row in rows if row.deviation is not None]
        off = [row for row in printed if not row.within(tolerance)]
        misprints = sum(row.corrected is not None for row in printed)
        ours = f"{len(printed) - len(off)} of them within {100 * tolerance:g} %"
        if len(off) < len(printed):
            ours += f", the largest deviation of these {max(_percent(row) for row in printed if row not in off):.1f} %"
        if misprints:
            ours += f", {misprints} of them after correcting a misprint"
        reasons = dict.fromkeys(row.reason for row in off)
        reason = "" if "" in reasons else "; ".join(reasons)
        return cls(item, paper or f"{len(printed)} numbers", ours, not off, reason)


def _percent(row: Row) -> float:
    return 100 * abs(row.deviation or 0.0)


@dataclass(frozen=True)
class Outcome:
    """Result of an entry, whose parts `OutcomeFacts` describes."""

    rows: list[Row]
    infinite_error: dict[str, float] = field(default_factory=dict)
    pictures: list[Path] = field(default_factory=list)
    comparisons: list[Comparison] = field(default_factory=list)
    settings: list[Setting] = field(default_factory=list)

    def unexplained(self, tolerance: float) -> list[str]:
        """What deviates from the paper by more than `tolerance`, or contradicts it, without a known reason."""
        rows = [row.what for row in self.rows if not row.within(tolerance) and not row.reason]
        return rows + [shown.item for shown in self.comparisons if not shown.agrees and not shown.reason]


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
    reason: str
    """Why the computed number deviates from the printed one; empty if it does not, or if this is not known."""


class ComparisonFacts(TypedDict):
    """What a figure or table of the paper shows, and what the computation shows."""

    item: str
    """The figure or table."""
    paper: str
    """What the paper shows."""
    ours: str
    """What the computation shows."""
    agrees: bool
    """Whether they agree."""
    reason: str
    """Why they differ; empty if they agree, or if this is not known."""


class SettingFacts(TypedDict):
    """A parameter of the computation."""

    what: str
    """Description of the parameter."""
    ours: float
    """Its value."""
    paper: float | None
    """Its value in the paper; null if the paper does not state it."""
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
    comparisons: list[ComparisonFacts]
    """For each figure or table, what the paper shows and what the computation shows."""
    settings: list[SettingFacts]
    """Grid, steps and what else decides how close the computation is to that of the paper."""
    readings: list[str]
    """How the paper was read where it leaves something open or does not lead to its own numbers."""


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
    figures: list[str]
    """Other names by which it is found: those of the figures that it draws."""


@dataclass(frozen=True)
class Entry:
    """An entry of a collection."""

    name: str
    paper: str
    title: str
    function: Callable[..., Outcome]  # of the folder of the pictures, and of `full` if the entry is scaled
    takes: str = "seconds"  # run time on two cores, once everything needed is compiled, such as "2 min"
    full: str = ""  # the same in full size, if the default is smaller or has larger steps
    figures: tuple[str, ...] = ()  # computed besides that of its name, such as ("fig5",)
    readings: tuple[str, ...] = ()  # of the paper where it leaves something open or contradicts its own numbers

    @property
    def group(self) -> str:
        """First part of the name, which the entries of one paper share."""
        return self.name.partition("-")[0]

    @property
    def other_names(self) -> list[str]:
        """Names of the figures and tables that it computes besides that of its name."""
        return [f"{self.group}-{figure}" for figure in self.figures]

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
        return {
            "paper": self.paper,
            "title": self.title,
            "takes": self.takes,
            "full": self.full,
            "figures": self.other_names,
        }

    def as_json(self, outcome: Outcome) -> OutcomeFacts:
        """An outcome as plain data."""
        rows = [_row_facts(row) for row in outcome.rows]
        pictures = [path.name for path in outcome.pictures]
        comparisons: list[ComparisonFacts] = [
            {"item": c.item, "paper": c.paper, "ours": c.ours, "agrees": bool(c.agrees), "reason": c.reason}
            for c in outcome.comparisons
        ]
        settings: list[SettingFacts] = [
            {"what": s.what, "ours": s.ours, "paper": s.paper, "note": s.note} for s in outcome.settings
        ]
        return {
            "name": self.name,
            "paper": self.paper,
            "rows": rows,
            "infinite_error": outcome.infinite_error,
            "pictures": pictures,
            "comparisons": comparisons,
            "settings": settings,
            "readings": list(self.readings),
        }


def _row_facts(row: Row) -> RowFacts:
    return {
        "what": row.what,
        "ours": row.ours,
        "printed": row.printed,
        "corrected": row.corrected,
        "note": row.note,
        "reason": row.reason,
    }


@dataclass(frozen=True)
class Collection:
    """Entries by name."""

    command: str  # which lists and computes them
    package: str  # of the modules that enter them
    modules: tuple[str, ...]  # in the order of the list
    known: str  # heading of the column of known numbers
    tolerance: float = float("inf")  # deviation beyond which a reason is required; infinite if entries judge themselves
    _entries: dict[str, Entry] = field(default_factory=dict)

    def enter(
        self,
        name: str,
        paper: str,
        title: str,
        takes: str = "seconds",
        full: str = "",
        figures: tuple[str, ...] = (),
        readings: tuple[str, ...] = (),
    ) -> Callable[[Callable[..., Outcome]], Callable[..., Outcome]]:
        """Decorator that enters a function of the folder of the pictures; if there is a `full` size, the function takes
        `full` as well. See `Entry`.
        """

        def entered(function: Callable[..., Outcome]) -> Callable[..., Outcome]:
            self._entries[name] = Entry(name, paper, title, function, takes, full, figures, readings)
            return function

        return entered

    def entries(self) -> dict[str, Entry]:
        """All entries by name, in the order of the modules."""
        for module in self.modules:
            importlib.import_module(f"{self.package}.{module}")
        return dict(self._entries)

    def names(self) -> list[str]:
        """Everything that `select` knows: entries, figures that they draw, groups of entries, and "all"."""
        entries = self.entries().values()
        figures = [name for entry in entries for name in entry.other_names]
        return [*self.entries(), *figures, *dict.fromkeys(entry.group for entry in entries), "all"]

    def select(self, name: str) -> list[Entry]:
        """The entries of a name: one, all of a group such as a paper, or all. InputError for an unknown name, with the
        closest known one.
        """
        entries = self.entries()
        if name in entries:
            return [entries[name]]
        chosen = [e for e in entries.values() if name in ("all", e.group) or name in e.other_names]
        if not chosen:
            near = difflib.get_close_matches(name, self.names(), 1, 0.4)  # names are long and share words
            raise InputError(
                "there is no entry of this name",
                value=name,
                limit=", ".join(entries),
                key=self.command,
                remedy=f"did you mean {near[0]!r}?" if near else f"farhorizon {self.command} lists them",
            )
        return chosen

    def find(self, name: str) -> Entry:
        """The first entry of a name, as `select`."""
        return self.select(name)[0]


def _number(value: float) -> str:
    """A counted number with all its digits, in groups of three from five digits on; a measured one to five digits."""
    if not isinstance(value, int | np.integer):
        return f"{value:.5g}"
    return f"{value:,}".replace(",", " ") if abs(value) >= 10_000 else str(value)


def outcome_table(outcome: Outcome, known: str, details: bool = True, tolerance: float = 0.0) -> str:
    """The rows as text: the computed number, the known one under its heading, deviation, note.

    Rows with a known number come first; without `details` those without one are left out, except for key ones. Reasons
    are those of deviations beyond `tolerance`.
    """
    order = sorted(outcome.rows, key=lambda row: (row.printed is None, not row.key))
    rows = [row for row in order if details or row.key or row.printed is not None]
    lines = []
    if rows:
        width = max(len(row.what) for row in rows)
        lines.append(f"{'':{width}}  {'ours':>10}  {known:>10}  {'deviation':>9}  note")
    for row in rows:
        printed = "" if row.printed is None else _number(row.printed)
        deviation = "" if row.deviation is None else f"{100 * row.deviation:+.1f} %"
        misprint = "" if row.corrected is None else f"misprint, read {row.corrected:.3g}"
        reason = "" if row.within(tolerance) else row.reason
        note = ": ".join(part for part in (misprint, "; ".join(filter(None, (row.note, reason)))) if part)
        lines.append(f"{row.what:{width}}  {_number(row.ours):>10}  {printed:>10}  {deviation:>9}  {note}".rstrip())
    left = len(outcome.rows) - len(rows) + len(outcome.infinite_error)
    if details:
        for name, value in outcome.infinite_error.items():
            lines.append(f"error against the infinite medium at the same time step, {name}: {value:.1e}")
    elif left:
        lines.append(f"{left} more numbers, which the paper does not print: --details")
    return "\n".join(lines)

"""Sweeps: many cases that differ in some keys, run in parallel, and a table of the results."""

from __future__ import annotations

import csv
import hashlib
import itertools
import json
import multiprocessing
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from farhorizon import kinds
from farhorizon.engine.engine import available_threads
from farhorizon.errors import FileFormatError, InputError
from farhorizon.files.datasets import xarray_module
from farhorizon.files.storage import locked, replacing

if TYPE_CHECKING:
    import xarray

_FAILED, _CASE = "failed", "case"  # columns after those of the keys and the quantities
_DOTTED = re.compile(r"[A-Za-z_]\w*(\.\w+|\[\d+\])+")  # a key below a table, which is no quantity

Quantities = Mapping[str, Callable[[Any], float]]
Outcome = tuple[dict[str, float], str]  # quantities, and the reason of a failure


class Sweepable(Protocol):
    """A case file that has been read."""

    @property
    def text(self) -> str:
        """Its contents."""

    def changed(self, changes: Mapping[str, Any]) -> Sweepable:
        """The same case with other values at dotted keys."""

    def completed(self, threads: int | None) -> Any:
        """Return a new run that has reached its end, on at most `threads` threads."""

    def figures(self, run: Any) -> dict[str, float]:
        """The default quantities of a run."""


@dataclass(frozen=True, eq=False)
class SweepTable:
    """Results of many cases.

    Attributes
    ----------
    changes : list of dict
        For each case, the values of the keys that were changed.
    figures : list of dict
        For each case, the quantities by name; empty if it failed.
    failed : dict of int to str
        Numbers of the cases that failed, with the reasons.
    """

    changes: list[dict[str, Any]]
    figures: list[dict[str, float]]
    failed: dict[int, str]

    @property
    def quantities(self) -> list[str]:
        """Names of the quantities."""
        return list(dict.fromkeys(name for figures in self.figures for name in figures))

    def __str__(self) -> str:
        names = [*self.changes[0], *self.quantities]
        rows = [names]
        for change, figures in zip(self.changes, self.figures, strict=True):
            words = {key: _word(value) for key, value in change.items()} | {n: f"{v:.6g}" for n, v in figures.items()}
            rows.append([words.get(name, "") for name in names])
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(f"{word:>{width}}" for word, width in zip(row, widths, strict=True)) for row in rows]
        return "\n".join([*lines, *(f"failed: {_in_words(self.changes[i])}: {why}" for i, why in self.failed.items())])

    def to_xarray(self) -> xarray.Dataset:
        """The table with one axis per key if all combinations of their values were computed, otherwise with a
        single axis for the cases. Failed cases are NaN.

        Returns
        -------
        xarray.Dataset

        Raises
        ------
        InputError
            xarray is not installed.
        """
        keys = list(self.changes[0])
        rows = [tuple(_plain(value) for value in change.values()) for change in self.changes]
        values = [list(dict.fromkeys(column)) for column in zip(*rows, strict=True)]
        complete = list(itertools.product(*values)) == rows
        axes, shape = (keys, [len(several) for several in values]) if complete else ([_CASE], [len(rows)])
        data = {
            name: (axes, np.reshape([figures.get(name, np.nan) for figures in self.figures], shape))
            for name in self.quantities
        }
        columns = zip(*rows, strict=True)
        along = zip(keys, values if complete else [(_CASE, list(column)) for column in columns], strict=True)
        return xarray_module().Dataset(data, coords=dict(along))


def sweep(
    case: Sweepable,
    changes: Mapping[str, Sequence[Any]] | Sequence[Mapping[str, Any]],
    quantities: Quantities | None = None,
    *,
    table: str | Path | None = None,
    jobs: int = 1,
    executor: Executor | None = None,
    progress: bool = False,
) -> SweepTable:
    """Run a case for each combination of values of some keys, several at a time, and tabulate the results.

    Parameters
    ----------
    case : Case
        A case read by `read_case`.
    changes : mapping of str to sequence, or sequence of mappings
        Values of each dotted key, all combinations of which are computed, with the last key varying fastest; or the
        changes of each case, one by one.
    quantities : mapping of str to callable, optional
        Functions that take the run at its end and return a number. For use in other processes they must be functions of
        a module. Unless given, those of `Case.figures`.
    table : str or Path, optional
        A CSV file, to which each case is added when it has ended. Cases that it contains are not computed again, except
        those that failed.
    jobs : int
        Number of processes that compute simultaneously; they share the threads of the machine. With one, the
        computation takes place in this process.
    executor : concurrent.futures.Executor, optional
        Executor used instead of them: `mpi4py.futures.MPIPoolExecutor()`, Dask's, ...
    progress : bool
        Print a line for each case as it ends.

    Returns
    -------
    SweepTable
        Failed cases are listed in it; the other cases continue.

    Raises
    ------
    InputError
        No values, a change that the case file refuses, both jobs and an executor; raised before anything is computed.
    FileFormatError
        The table belongs to another sweep, or another sweep is writing it.

    Examples
    --------
    >>> import farhorizon as fh
    >>> from pathlib import Path
    >>> _ = Path("pulse.toml").write_text('''
    ... lattice = { spacing = 0.25, lower = [-3.0], upper = [3.0] }
    ... model = { type = "wave", kernel = { horizon = 0.75 } }
    ... initial = { u = "exp(-9*x**2)" }
    ... boundary = { all = { type = "fixed" } }
    ... run = { until = 1.0 }
    ... ''')
    >>> found = fh.sweep(fh.read_case("pulse.toml"), {"model.speed": [1.0, 2.0]}, {"end": lambda run: run.time})
    >>> print(found)
    model.speed  end
              1    1
              2    1
    """
    if not hasattr(case, "completed"):
        raise InputError("must be a case file", value=kinds.said(case), key="case", remedy="fh.read_case(path)")
    if executor is not None:
        kinds.instance(executor, "executor", Executor, "an executor of concurrent.futures")
    say: Callable[[str], None] = print if kinds.flag(progress, "progress") else lambda _: None
    combinations = _combinations(changes)
    kinds.integer(jobs, "jobs", least=1)
    if executor is not None and jobs > 1:
        raise InputError("an executor has jobs of its own", value=jobs, key="jobs", remedy="leave jobs out")
    asked = None if quantities is None else _checked(quantities, list(combinations[0]))
    cases = [case.changed(change) for change in combinations]
    names = [_name(changed, asked) for changed in cases]
    figures: list[dict[str, float]] = [{} for _ in combinations]
    failed: dict[int, str] = {}
    with _Table.opened(table, list(combinations[0]), asked or ()) as stored:
        known = [i for i, name in enumerate(names) if name in stored.figures]
        for i in known:
            figures[i] = stored.figures[names[i]]
        if known:
            say(f"{len(known)} of {len(combinations)} cases are in the table")
        todo = {i: cases[i] for i in range(len(combinations)) if i not in known}
        for i, (numbers, why) in _outcomes(todo, asked, jobs, executor):
            figures[i] = numbers
            failed |= {i: why} if why else {}
            stored.add(names[i], combinations[i], numbers, why)
            say(f"failed: {_in_words(combinations[i])}: {why}" if why else _in_words(combinations[i]))
    return SweepTable(combinations, figures, dict(sorted(failed.items())))


def _combinations(changes: Any) -> list[dict[str, Any]]:
    """The changes of each case."""
    if isinstance(changes, Mapping):
        values = [kinds.sequence(several, f"changes[{key!r}]", "values") for key, several in changes.items()]
        combinations = [dict(zip(changes, row, strict=True)) for row in itertools.product(*values)]
    else:
        given = kinds.sequence(changes, "changes", "mappings of dotted keys to values")
        expected = "a mapping of keys to values"
        combinations = [dict(kinds.instance(change, "changes", Mapping, expected)) for change in given]
    if not combinations or not all(combinations):
        raise InputError("there is nothing to change", key="changes", remedy='{"model.speed": [1.0, 2.0]}')
    for change in combinations:
        if list(change) != list(combinations[0]):
            raise InputError(
                "all cases change the same keys", value=list(change), limit=list(combinations[0]), key="changes"
            )
    return combinations


def _checked(quantities: Any, keys: list[str]) -> Quantities:
    given = kinds.instance(quantities, "quantities", Mapping, "a mapping of names to functions of the run")
    for name, quantity in given.items():
        if kinds.text(name, "quantities") in {*keys, _FAILED, _CASE}:
            raise InputError("the table has another column of this name", value=name, key="quantities")
        kinds.function(quantity, f"quantities[{name!r}]", "run")
    return dict(given)


def _name(case: Sweepable, asked: Quantities | None) -> str:
    """Name by which a case with its quantities is identified in a table."""
    words = [case.text, *([] if asked is None else sorted(asked))]
    return hashlib.sha256("\0".join(words).encode()).hexdigest()[:16]


def _outcomes(
    cases: Mapping[int, Sweepable], asked: Quantities | None, jobs: int, executor: Executor | None
) -> Iterator[tuple[int, Outcome]]:
    """Yield the number and the outcome of each case as it ends."""
    jobs = min(jobs, len(cases))
    if executor is None and jobs <= 1:
        yield from ((i, _outcome(case, asked)) for i, case in cases.items())
        return
    threads = None if executor else max(1, available_threads() // jobs)
    # a forked process may hang if its parent has threads
    pool = executor or ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"))
    waiting = {pool.submit(_outcome, case, asked, threads): i for i, case in cases.items()}
    try:
        for future in as_completed(waiting):
            error = future.exception()  # the process was killed, or its arguments cannot be pickled
            yield waiting[future], future.result() if error is None else ({}, _reason(error))
    finally:
        for future in waiting:
            future.cancel()
        if executor is None:
            pool.shutdown()


def _outcome(case: Sweepable, asked: Quantities | None, threads: int | None = None) -> Outcome:
    """The outcome of one case, in any process."""
    try:
        run = case.completed(threads)
        figures = case.figures(run) if asked is None else {name: float(of(run)) for name, of in asked.items()}
    except Exception as error:
        return {}, _reason(error)
    return figures, ""


def _reason(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())


def _plain(value: Any) -> Any:
    """A value as a coordinate: a number or a text."""
    return value if isinstance(value, int | float | str) else json.dumps(value, default=str)


def _word(value: Any) -> str:
    plain = _plain(value)
    return f"{plain:.10g}" if isinstance(plain, float) else str(plain)


def _in_words(change: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} = {_word(value)}" for key, value in change.items())


class _Table:
    """File of a sweep with one row per case; it is complete at all times, even if the process is killed. `figures` are
    the quantities of the cases that did not fail, by the name of the case.
    """

    def __init__(self, path: Path | None, keys: list[str], asked: Collection[str]) -> None:
        self._path, self._keys, self._asked = path, keys, asked
        self._rows: dict[str, dict[str, str]] = {}
        self.figures: dict[str, dict[str, float]] = {}
        if path is not None and path.exists():
            try:
                self._read(path)
            except FileFormatError:
                raise
            except (ValueError, csv.Error) as error:  # not a text file, or no number where one is expected
                raise FileFormatError(
                    f"{path} is damaged, or no table: {error}", remedy="choose another file, or mend it"
                ) from None

    @classmethod
    @contextmanager
    def opened(cls, path: str | Path | None, keys: list[str], asked: Collection[str]) -> Iterator[_Table]:
        """Open the table at a path, locked against other writers; with None it is kept in no file."""
        if path is None:
            yield cls(None, keys, asked)
            return
        place = kinds.path(path, "table")
        if place.is_dir() or not place.parent.is_dir():
            raise InputError("no file can be written there", value=place, key="table", remedy="a file in a folder")
        with locked(place.with_name(f".{place.name}.lock")):
            yield cls(place, keys, asked)

    def _read(self, path: Path) -> None:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            columns = list(reader.fieldnames or ())
            more = columns[len(self._keys) :]
            foreign = [name for name in more if _DOTTED.fullmatch(name) and name not in self._asked]
            if columns[: len(self._keys)] != self._keys or more[-2:] != [_FAILED, _CASE] or foreign:
                raise FileFormatError(
                    f"{path} is not the table of such a sweep",
                    value=columns,
                    limit=[*self._keys, "...", _FAILED, _CASE],
                    remedy="choose another file, on the command line another folder by --out",
                )
            for row in reader:
                self._rows[row[_CASE]] = row
                if not row[_FAILED]:
                    numbers = columns[len(self._keys) : -2]
                    self.figures[row[_CASE]] = {name: float(row[name]) for name in numbers if row[name]}

    def add(self, name: str, change: Mapping[str, Any], figures: Mapping[str, float], why: str) -> None:
        """Add a case that has ended, replacing an earlier one of the same name."""
        if self._path is None:
            return
        texts = {key: _word(value) for key, value in change.items()} | {n: repr(v) for n, v in figures.items()}
        self._rows[name] = {**texts, _FAILED: why, _CASE: name}
        columns = list(dict.fromkeys(column for row in self._rows.values() for column in row))
        columns = [column for column in columns if column not in (_FAILED, _CASE)] + [_FAILED, _CASE]
        with replacing(self._path) as fresh, fresh.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, columns, restval="")
            writer.writeheader()
            writer.writerows(self._rows.values())

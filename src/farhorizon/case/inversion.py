"""Inversion files: TOML with the words of `fh.invert` and the case files of the shots."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from farhorizon import public as fh
from farhorizon.case.build import recorders_of
from farhorizon.case.case import Case
from farhorizon.case.changes import changed
from farhorizon.case.inversion_schema import MISFITS, inversion_part
from farhorizon.case.problems import explain
from farhorizon.case.reading import Reader
from farhorizon.case.schema import unit_of
from farhorizon.case.units import plain
from farhorizon.errors import FileFormatError, InputError, suggestion
from farhorizon.files.results import open_results
from farhorizon.inverse.misfits import RECORDS
from farhorizon.simulation.time.steps import last_step


class InversionFile:
    """A validated inversion file; `changes` and `of_cases` are values at dotted keys that replace those of the file and
    of all cases, and `path`, whose folder other files are relative to, is named in messages. Raises an InputError with
    file, key, value, limit and remedy.
    """

    def __init__(
        self,
        text: str,
        path: str | Path,
        changes: Mapping[str, Any] | None = None,
        of_cases: Mapping[str, Any] | None = None,
    ) -> None:
        self.path, self._of_cases = Path(path), dict(of_cases or {})
        try:
            data = tomllib.loads(text)
        except (ValueError, RecursionError) as error:
            raise InputError(f"{self.path}: not valid TOML: {error}") from None
        with self.naming():
            data = changed(data, changes or {})
            if not data.get("shot"):
                raise InputError("there is no shot", key="shot", remedy="a table [[shot]] for each run with data")
            first = self._first_case(data)
            context = {"folder": self.path.parent} if first is None else self._context(first)
            data = data if first is None else _with_plain_bounds(data, first)
        table = inversion_part()
        try:
            self.parts = table.model_validate(data, context=context)
        except ValidationError as error:
            raise InputError(f"{self.path}: " + explain(error, data, table)) from None
        with self.naming():
            self.cases = [self._case(i, shot) for i, shot in enumerate(self.parts.shot)]
            for i, case in enumerate(self.cases):
                if case.parts.units != self.cases[0].parts.units:
                    raise InputError(
                        "all shots have the units of the first one",
                        value=str(case.path),
                        key=f"shot[{i}].case",
                        remedy="the same [units] in all cases",
                    )
            self.shots = [self._shot(i, shot) for i, shot in enumerate(self.parts.shot)]

    @classmethod
    def read(
        cls, path: str | Path, changes: Mapping[str, Any] | None = None, of_cases: Mapping[str, Any] | None = None
    ) -> InversionFile:
        """Read an inversion file."""
        try:
            text = Path(path).read_text(encoding="utf-8")
        except OSError as error:
            raise InputError(
                f"cannot read the inversion file {path}: {error.strerror}", remedy="check the path"
            ) from None
        except UnicodeDecodeError:
            raise FileFormatError(f"{path} is not a text file", remedy="an inversion file is TOML") from None
        return cls(text, path, changes, of_cases)

    @property
    def name(self) -> str:
        """Name of the results: the stem of the file."""
        return self.path.stem

    @cached_property
    def arguments(self) -> dict[str, Any]:
        """What `fh.invert` takes beside the shots."""
        part = self.parts.inversion
        given = {name: getattr(part, name) for name in part.ARGUMENTS if name in part.model_fields_set}
        if given.get("region") is not None:
            with self.naming():
                given["region"] = Reader(self.cases[0].lattice.dim).region(part.region, "inversion.region")
        if "frequencies" in given:
            given["frequencies"] = [None if limit is False else limit for limit in given["frequencies"]]
        return given

    def run(self, **others: Any) -> fh.Inversion:
        """The inversion; `others` are the arguments of `fh.invert` that a file does not give."""
        try:
            return fh.invert(self.shots, **self.arguments, **others)
        except FileFormatError:  # of the output, which a file does not name
            raise
        except InputError as error:
            with self.naming():
                raise error.at(self._key_of(error.key)) from None

    @contextmanager
    def naming(self) -> Iterator[None]:
        """Context in which an InputError names the inversion file."""
        try:
            yield
        except InputError as error:
            raise type(error)(f"{self.path}: {error}") from None

    def _key_of(self, key: str) -> str:
        """The place in the file of what `fh.invert` names."""
        if key.startswith("shots"):
            return key.replace("shots", "shot", 1)
        return f"inversion.{key}" if key.partition(".")[0] in self.parts.inversion.ARGUMENTS else key

    def _first_case(self, data: Any) -> Case | None:
        """The case of the first shot, whose units are those of the file; None if the file does not name it, which the
        table says.
        """
        shots = data.get("shot")
        first = shots[0] if isinstance(shots, list) and shots else None
        if not isinstance(first, dict) or not isinstance(first.get("case"), str):
            return None
        changes = first.get("set", {})
        return self._read_case(self.path.parent / first["case"], changes if isinstance(changes, dict) else {}, 0)

    def _read_case(self, path: str | Path, changes: Mapping[str, Any], number: int) -> Case:
        if not Path(path).is_file():
            raise InputError(
                "there is no such file", value=str(path), key=f"shot[{number}].case", remedy="the path of a case file"
            )
        return Case.read(path, {**changes, **self._of_cases})

    def _context(self, case: Case) -> dict[str, Any]:
        return {"folder": self.path.parent, "units": case.units}

    def _case(self, number: int, shot: Any) -> Case:
        """The case of a shot, whose run ends with the inversion."""
        return self._read_case(shot.case, {**shot.set, "run.until": self.parts.inversion.until}, number)

    def _shot(self, number: int, shot: Any) -> tuple[fh.Setup, fh.Misfit]:
        """The set-up of a shot and its misfit."""
        case, key = self.cases[number], f"shot[{number}]"
        line = self._receivers(case, shot, key)
        dt = fh.Simulation.of(case.setup).dt
        data = _data(Path(shot.data), line, dt, f"{key}.data")
        listening = fh.Receivers(line.points, list(data), line.every, line.interpolation, line.name)
        misfit = MISFITS[shot.misfit](listening, data)
        try:
            rows = last_step(self.parts.inversion.until, dt) // line.every + 1
            misfit.check(rows, case.lattice.dim if case.model.mechanical else 1)
        except InputError as error:
            raise error.at(f"{key}.data") from None
        return case.setup, misfit

    def _receivers(self, case: Case, shot: Any, key: str) -> fh.Receivers:
        """The receivers of a shot."""
        recorders = recorders_of(case.parts, case.lattice.dim)
        given = {recorder.name: recorder for recorder in recorders if isinstance(recorder, fh.Receivers)}
        names = ", ".join(given)
        if not given:
            raise InputError(
                "the case has no receivers",
                value=shot.case,
                key=f"{key}.case",
                remedy="[[receivers]] with the points at which the data were recorded",
            )
        if shot.receivers is None and len(given) > 1:
            raise InputError(
                "the case has several receivers",
                value=names,
                limit="1",
                key=f"{key}.receivers",
                remedy=f'receivers = "{next(iter(given))}"',
            )
        name = next(iter(given)) if shot.receivers is None else shot.receivers
        if name not in given:
            raise InputError(
                "the case has no receivers of this name",
                value=name,
                limit=names,
                key=f"{key}.receivers",
                remedy=suggestion(name, list(given)),
            )
        return given[name]


def _with_plain_bounds(data: dict[str, Any], case: Case) -> dict[str, Any]:
    """The tables of a file with bounds that are numbers, in the units of the constants of the case's model."""
    table = data.get("inversion")
    bounds = table.get("bounds") if isinstance(table, dict) else None
    if not isinstance(bounds, dict):
        return data
    fields = type(case.parts.model).model_fields
    numbers = {
        name: plain(pair, unit_of(fields[name]) if name in fields else None, case.units, f"inversion.bounds.{name}")
        for name, pair in bounds.items()
    }
    return {**data, "inversion": {**table, "bounds": numbers}}  # type: ignore[dict-item]


def _data(path: Path, line: fh.Receivers, dt: float, key: str) -> dict[str, np.ndarray]:
    """What receivers have recorded, by quantity."""
    if not path.is_file():
        raise InputError(
            "there is no such file", value=str(path), key=key, remedy="a .npy file, or a results file of farhorizon run"
        )
    if path.suffix == ".npy":
        try:
            return {"u": np.load(path, allow_pickle=False)}
        except (ValueError, EOFError, OSError) as error:
            raise FileFormatError(
                f"not an array of NumPy: {error}", value=str(path), key=key, remedy="numpy.save(path, data)"
            ) from None
    recorded = open_results(path).recorded
    if line.name not in recorded:
        raise InputError(
            "the results file has no receivers of this name",
            value=line.name,
            limit=", ".join(recorded) or "none",
            key=key,
            remedy="the results of a case with these receivers",
        )
    records = recorded[line.name]
    data = {name: records.data[name] for name in RECORDS if name in records.data and name in line.record}
    if not data:
        raise InputError(
            "the results file has no records of u or v",
            value=", ".join(records.data),
            limit=", ".join(RECORDS),
            key=key,
            remedy='record = ["u"] in [[receivers]]',
        )
    if records.points.shape != line.points.shape or not np.allclose(records.points, line.points):
        raise InputError(
            "the data were recorded at other points than those of the case's receivers",
            value=f"{len(records.points)} points",
            limit=f"the {len(line.points)} points of {line.name}",
            key=key,
            remedy="the same [[receivers]] in both cases",
        )
    between = float(np.diff(records.times).mean()) if len(records.times) > 1 else dt * line.every
    if abs(between / (dt * line.every) - 1) > 1e-6:  # times in files carry rounding errors
        raise InputError(
            "the data were recorded at other times than those of the run",
            value=f"every {between:.6g}",
            limit=f"every {dt * line.every:.6g}",
            key=key,
            remedy="the same run.dt in both cases, and the same `every` of the receivers",
        )
    return data

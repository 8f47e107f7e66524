"""Writing of results files: created or resumed, and appended to."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon.errors import FileFormatError, InputError
from farhorizon.files.hdf5 import (
    CHUNK_ROWS,
    directory_of,
    grow,
    hdf5_file,
    opened,
    put_fixed,
    put_word,
    put_words,
    read_indices,
)
from farhorizon.files.parts import Box, make_room, parts_of
from farhorizon.files.polylines import Lines, put_lines
from farhorizon.files.records import Recorded
from farhorizon.files.results_layout import (
    FIELD,
    RESERVED,
    Caution,
    Layout,
    Regions,
    checked_group,
    chunk_of,
    counts_of,
    list_outputs,
    stored_boxes,
    table_in,
    table_names,
    vtk_shape,
)
from farhorizon.files.storage import created


def check_replaceable(path: Path) -> None:
    """Refuse a path for new results if anything other than a results file of ours exists there or among its parts, or
    one that may not be written, or if there is no such folder.
    """
    directory_of(path)
    for part in parts_of(path):
        check_replaceable(part)
    if not path.exists():
        return
    if not os.access(path, os.W_OK):
        raise InputError(f"{path}: permission denied", remedy="change the permissions or use another path")
    try:
        with opened(path, "r", "results file") as file:
            checked_group(file, path)
    except FileFormatError as error:
        remedy = "move or delete it, or choose another path"
        raise InputError(
            f"{path} exists, is not a whole results file of ours, and is not overwritten", remedy=remedy
        ) from error


class ResultsWriter:
    """Appends outputs to a results file, by `create` or `resume`. Every call opens the file, appends and closes it; a
    killed process leaves a file with or without what was appended.

    Checkpoints store the numbers of valid `outputs`, `rows` of the history, `records` of the probes, and of `recorded`
    rows by recorder, for `resume`. If `whole`, the fields are in the file itself; `last_step` is that of the last
    output.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        with opened(self.path, "r", "results file") as file:
            self._layout = layout = Layout.of(file, self.path)
            self.outputs, self.rows, self.records = counts_of(file, self.path).values()
            self.last_step = int(file["farhorizon/steps"][self.outputs - 1]) if self.outputs else None
            recorders = [name for name in table_names(file) if "/" in name]
            self.recorded = {name.removeprefix("recorded/"): table_in(file, name).counted for name in recorders}
        self.shape, self.components, self.accounts = layout.shape, layout.components, layout.accounts
        self.fields, self.whole = tuple(layout.components), not len(layout.boxes)

    @classmethod
    def create(
        cls,
        path: str | Path,
        *,
        shape: Sequence[int],
        spacing: float,
        lower: Sequence[float] | np.ndarray,
        fields: tuple[str, ...],
        dtype: Any,
        probes: np.ndarray | None = None,
        accounts: Sequence[str] = (),
        case: str = "",
        program: str = "",
        components: int | Mapping[str, int] = 1,
        units: Mapping[str, str] | None = None,
        provenance: Mapping[str, str] | None = None,
        compress: bool = False,
        outlines: Lines | None = None,
        regions: Regions | None = None,
        boxes: Sequence[Box] = (),
    ) -> ResultsWriter:
        """Create an empty results file with the entries of `Layout`, fields of type `dtype`, texts and names for the
        reader, and for fields in parts the `boxes` of these, for which it creates a folder; an older results file of
        that name is replaced together with its parts, any other file is refused.
        """
        path = Path(path)
        check_replaceable(path)
        _check_fields(fields)
        nodes = tuple(int(n) for n in shape)
        widths = dict.fromkeys(fields, components) if isinstance(components, int) else dict(components)
        if not {widths[name] for name in fields} <= {1, 2, 3}:
            raise InputError("fields in results files have up to three components", value=components, limit="1 to 3")
        layout = Layout(
            nodes,
            tuple(float(v) for v in lower),
            float(spacing),
            {name: widths[name] for name in fields},
            np.zeros((0, len(nodes))) if probes is None else np.asarray(probes, float),
            widths.get("u", widths[fields[0]]),
            tuple(accounts),
            stored_boxes(boxes),
        )
        words = {name: json.dumps(dict(table or {})) for name, table in (("units", units), ("provenance", provenance))}
        with created(path) as draft, hdf5_file(draft, "w") as file:
            group = layout.make(file, np.dtype(dtype), compress)
            for name, word in {"program": program, "cautions": "[]", **words}.items():
                put_word(group.attrs, name, word)
            put_words(group, "case", [case])
            put_lines(group, "outlines", outlines or {})
            if regions is not None:
                _put_regions(file["VTKHDF"], group, regions, nodes)
        make_room(path, len(boxes))
        return cls(path)

    @classmethod
    def resume(
        cls,
        path: str | Path,
        outputs: int,
        rows: int | None = None,
        records: int | None = None,
        recorded: Mapping[str, int] | None = None,
    ) -> ResultsWriter:
        """Resume a results file after its first outputs, and cut off the rest; how many history rows, probe records and
        rows of recorders are kept follows from the last of these outputs unless given. A file that holds fewer is
        refused.
        """
        path = Path(path)
        if min(outputs, rows or 0, records or 0) < 0:
            raise InputError(
                "the numbers of outputs, history rows and records to keep are not negative",
                value=(outputs, rows, records),
                limit=0,
            )
        # HDF5 crashes if an index that it modifies is damaged
        with opened(path, "r", "results file") as file:
            read_indices(checked_group(file, path).parent)
        with opened(path, "r+", "results file") as file:
            layout, tables = Layout.of(file, path), {name: table_in(file, name) for name in table_names(file)}
            held, columns = counts_of(file, path), tables["outputs"].columns
            _check_held(path, "outputs", held["outputs"], outputs)
            kept = {"outputs": outputs}
            for name, given, noted, what in (
                ("history", rows, "history_rows", "history rows"),
                ("records", records, "record_rows", "records"),
            ):
                last = int(columns[noted][outputs - 1]) if outputs else 0
                kept[name] = last if given is None else given
                _check_held(path, what, held[name], kept[name])
            end = float(columns["times"][outputs - 1]) if outputs else -np.inf
            for name in tables.keys() - kept.keys():
                recorder, count = name.removeprefix("recorded/"), tables[name].counted
                last = int(np.searchsorted(tables[name].columns["times"][:count], end, side="right"))
                kept[name] = (recorded or {}).get(recorder, last)
                _check_held(path, f"rows of {recorder}", count, kept[name])
            for name, table in tables.items():
                table.cut(kept[name])
            list_outputs(file, layout, path, outputs)
            file["farhorizon"].attrs["finished"] = False
        return cls(path)

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        """The file, to be changed."""
        with opened(self.path, "r+", "results file") as file:
            yield file

    def append(
        self,
        step: int,
        time: float,
        fields: Mapping[str, np.ndarray],
        energy: float | None = None,
        balance: Mapping[str, float] | None = None,
        cautions: Sequence[Caution] = (),
    ) -> None:
        """Append one output, with every field of the file (components first, nan outside a window), and with an energy
        or a balance a row of the history; entries of the balance that the file lacks are ignored. The cautions are all
        so far.
        """
        self._check(step, fields)
        n, rows = self.outputs, self.rows
        with self._opened() as file:
            if energy is not None or balance is not None:
                entries = [np.nan if balance is None else balance[name] for name in self.accounts]
                energies = [np.nan if energy is None else energy]
                rows = table_in(file, "history").put(rows, {"times": [time], "energy": energies, "balance": [entries]})
            noted = {"times": [time], "steps": [step], "history_rows": [rows], "record_rows": [self.records]}
            offsets = {f"offsets/{name}": [0 if name == FIELD else n] for name in (*self.fields, FIELD)}
            table = table_in(file, "outputs")
            stored = {name: self._stored(name, values, table.columns[name].dtype) for name, values in fields.items()}
            table.put(n, {**noted, **offsets, **stored})
            put_word(file["farhorizon"].attrs, "cautions", json.dumps(list(cautions)))
            list_outputs(file, self._layout, self.path, n + 1)
        self.outputs, self.rows, self.last_step = n + 1, rows, int(step)

    def _check(self, step: int, fields: Mapping[str, np.ndarray]) -> None:
        """Refuse an output that is incomplete, or not later than the last one."""
        expected = self.fields if self.whole else ()
        if set(fields) != set(expected):
            raise InputError(
                f"{self.path}: an output has every field of the file, no other",
                value=sorted(fields),
                limit=sorted(expected),
            )
        for name, values in fields.items():
            shape = self.shape if self.components[name] == 1 else (self.components[name], *self.shape)
            if np.shape(values) != shape:
                raise InputError(
                    f"{self.path}: field {name!r} has not the lattice shape", value=np.shape(values), limit=shape
                )
        if self.last_step is not None and step <= self.last_step:
            raise InputError(
                f"{self.path}: step numbers grow from output to output",
                value=step,
                limit=f"> {self.last_step}",
                remedy="append each step once; ResultsWriter.resume goes back",
            )

    def _stored(self, name: str, values: np.ndarray, dtype: np.dtype) -> np.ndarray:
        """A field as one row in VTK's order, vectors with three components."""
        stored = np.asarray(values).T.astype(dtype, order="C", copy=False)
        if self.components[name] > 1:
            stored = np.pad(stored, [(0, 0)] * len(self.shape) + [(0, 3 - self.components[name])])
        return stored.reshape(1, *self._layout.stored_shape(name))

    def finish(self) -> None:
        """Record that the run has reached its end; `resume` revokes this."""
        with self._opened() as file:
            file["farhorizon"].attrs["finished"] = True

    def hold(self, records: Recorded) -> None:
        """Create empty datasets for the records of a recorder, with the quantities and shapes of `records`."""
        if records.name in self.recorded or records.name in (*RESERVED, *self.fields):
            raise InputError(
                "the results have something else of this name", value=records.name, key="name", remedy="another name"
            )
        with self._opened() as file:
            group = file["farhorizon"].require_group("recorded").create_group(records.name)
            group.attrs["rows"], group.attrs["directions"] = 0, records.directions
            group.attrs["medium"] = records.medium
            put_fixed(group, "points", np.asarray(records.points, float))
            if records.labels:
                put_words(group, "labels", records.labels)
            put_fixed(group, "frequencies", np.asarray(records.frequencies, float))
            grow(group, "times", "f8")
            data, spectra = (group.create_group(name, track_order=True) for name in ("data", "spectra"))
            for name, values in records.data.items():
                width = values.shape[1:]
                # chunks of about 64 x 512 numbers, as those of the probes
                grow(data, name, "f8", width, (max(1, CHUNK_ROWS // max(1, int(np.prod(width)) // 64)), *width))
            for name, values in records.spectra.items():
                real = np.isrealobj(values)
                put_fixed(spectra, name, np.zeros(values.shape if real else (2, *values.shape)))
                spectra[name].attrs["real"] = real
        self.recorded[records.name] = 0

    def conclude(self, records: Recorded) -> None:
        """Store what follows from all records, replacing what followed from an earlier end of the run."""
        if self.recorded.pop(records.name, None) is not None:
            with self._opened() as file:
                del file["farhorizon/recorded"][records.name]
        self.hold(records)
        self.append_recorded(records)

    def append_recorded(self, records: Recorded) -> None:
        """Append the rows of a recorder, and replace its stored spectra."""
        count, place = self.recorded[records.name], f"recorded/{records.name}"
        with self._opened() as file:
            if len(records.times):
                count = table_in(file, place).put(count, {"times": records.times, **records.data})
            for name, values in records.spectra.items():
                stored = file["farhorizon"][place]["spectra"][name]
                stored[...] = values if np.isrealobj(values) else [values.real, values.imag]
        self.recorded[records.name] = count

    def append_probes(self, times: np.ndarray, values: np.ndarray) -> None:
        """Append records of the probes, of shapes (n,) and (n, n probes[, components])."""
        times, values, shape = np.asarray(times, float), np.asarray(values, float), self._layout.probe_shape
        if times.ndim != 1 or values.shape != (times.size, *shape):
            raise InputError(
                f"{self.path}: times and values of the probes do not match",
                value=f"{times.shape}, {values.shape}",
                limit=f"(n,), (n, {str(shape)[1:-1]})",
            )
        if not times.size:
            return
        with self._opened() as file:
            count = table_in(file, "records").put(self.records, {"times": times, "values": values})
        self.records = count


def _check_fields(fields: tuple[str, ...]) -> None:
    for name in fields:
        if not name or name in RESERVED or "/" in name or name.startswith("."):
            remedy = f"use a name without '/', not beginning with '.', and none of {', '.join(sorted(RESERVED))}"
            raise InputError("this name cannot be used for a field in a results file", value=repr(name), remedy=remedy)
    if not fields or len(set(fields)) != len(fields):
        remedy = "name one or more, each once"
        raise InputError("fields are one or more different names", value=fields, key="fields", remedy=remedy)


def _put_regions(vtk: Any, group: Any, regions: Regions, shape: tuple[int, ...]) -> None:
    """Store the regions as point data of every output: as a single row, to which all outputs refer."""
    stored = vtk_shape(shape, 1)
    values = np.asarray(regions.numbers, np.int32).T.reshape(1, *stored)
    options = {"chunks": chunk_of(stored, 4), "fletcher32": True, "compression": "gzip", "shuffle": True}
    vtk["PointData"].create_dataset(FIELD, data=values, **options)
    grow(vtk["Steps/PointDataOffsets"], FIELD, "i8")
    put_words(group, "regions", regions.names)


def _check_held(path: Path, what: str, held: int, expected: int) -> None:
    if expected > held:
        raise FileFormatError(
            f"{path} holds fewer {what} than the checkpoint counts",
            value=held,
            limit=expected,
            remedy="use the results file that belongs to the checkpoint, or start the run anew",
        )

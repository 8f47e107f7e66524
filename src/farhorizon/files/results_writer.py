"""Writing of results files: created or resumed, and appended to."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
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
    put_rows,
    put_word,
    put_words,
    read_indices,
    words_in,
)
from farhorizon.files.new_results import make_columns, make_own, make_vtk, planned, put_outlines, put_regions
from farhorizon.files.parts import Box, parts_of
from farhorizon.files.polylines import Lines
from farhorizon.files.records import Recorded
from farhorizon.files.region_numbers import FIELD, Regions
from farhorizon.files.results_layout import (
    RESERVED,
    Caution,
    Counts,
    check_format,
    components_in,
    counts_of,
    fields_in,
    make_room,
    probe_components_in,
    set_outputs,
)
from farhorizon.files.storage import created


def check_replaceable(path: Path) -> None:
    """Refuse a path for new results if anything other than a results file of ours exists there.

    Raises
    ------
    InputError
        There is another file, or one that may not be written, also among the parts; or there is no such folder.
    """
    directory_of(path)
    for one in parts_of(path):
        check_replaceable(one)
    if not path.exists():
        return
    if not os.access(path, os.W_OK):
        raise InputError(f"{path}: permission denied", remedy="change the permissions or use another path")
    try:
        with opened(path, "r", "results file") as file:
            check_format(file, path)
    except FileFormatError as error:
        remedy = "move or delete it, or choose another path"
        raise InputError(
            f"{path} exists, is not a whole results file of ours, and is not overwritten", remedy=remedy
        ) from error


class ResultsWriter:
    """Appends outputs to a results file; the file is closed between the calls.

    Use `create` or `resume`. Every call opens the file, appends and closes it; a killed process leaves a file with or
    without what was appended.

    Parameters
    ----------
    path : str or Path
        An existing results file.

    Attributes
    ----------
    path : Path
    outputs, rows, records : int
        Numbers of valid outputs, history rows and probe records so far; checkpoints store them for `resume`.
    fields : tuple of str
    shape : tuple of int
        Lattice shape (nx[, ny[, nz]]).
    components : dict of str to int
        Number of components of each field.
    recorded : dict of str to int
        Number of valid rows of each recorder.
    whole : bool
        Whether the fields are in the file itself, not in parts.
    last_step : int or None
        Step number of the last output; None if there is none.

    Raises
    ------
    FileFormatError
        The file is truncated, damaged or not ours.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        with opened(self.path, "r", "results file") as file:
            group = check_format(file, self.path)
            self.shape: tuple[int, ...] = tuple(int(n) for n in group.attrs["shape"])
            self.fields: tuple[str, ...] = words_in(group, "fields")
            self.outputs, self.rows, self.records = counts_of(file, self.path)
            self.components = components_in(group)
            width = probe_components_in(group)
            self._probes = (group["probes"].shape[0], *((width,) if width > 1 else ()))
            self.accounts = words_in(group, "accounts")
            self.last_step = int(group["steps"][self.outputs - 1]) if self.outputs else None
            self.recorded = {name: int(one.attrs["rows"]) for name, one in group.get("recorded", {}).items()}
            self.whole = "parts" not in group

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
        """Create an empty results file; an older results file of that name is replaced together with its parts, any
        other file is refused.

        Parameters
        ----------
        path : str or Path
        shape : sequence of int, length dim
            Nodes along x[, y[, z]]: one, two or three numbers.
        spacing : float
            Distance of neighbouring nodes, the same along every axis.
        lower : sequence of float, length dim
            Coordinates of the first node.
        fields : tuple of str
            Names of the fields; `append` requires all of them.
        dtype : dtype
            Type of the stored fields, float32 or float64.
        probes : ndarray, shape (n, dim), optional
            Positions of the probes.
        accounts : sequence of str
            Names of the entries of a balance, which each balance passed to `append` must have.
        case : str
            Text of the case file.
        program : str
            Name and version of the program.
        components : int or mapping of str to int
            1, or dim for vector fields. VTK's vectors have three components; missing ones are stored as zeros. Probes
            show the field u if it is among the keys, whether written or not, otherwise the first field.
        units : mapping of str to str, optional
            Units of "length", "time" and fields, as far as they are known.
        provenance : mapping of str to str, optional
            What produced the file: command, machine, versions.
        compress : bool
            Compress the fields, without loss.
        outlines : mapping of str to sequence of ndarray, each of shape (n, dim), optional
            Polylines by what they show: "cracks", "near field", "layers".
        regions : Regions, optional
            Materials of the nodes; None if one medium fills the lattice.
        boxes : sequence of Box
            Boxes of the parts, whose files (`farhorizon.files.parts.part_path`) are created and appended to separately;
            a folder for them is created.

        Returns
        -------
        ResultsWriter

        Raises
        ------
        InputError
            An argument is wrong, or `path` is another file or one that may not be written.
        """
        path = Path(path)
        check_replaceable(path)
        plan = planned(shape, lower, spacing, fields, dtype, probes, components, boxes)
        tables = {"units": units, "provenance": provenance}
        with created(path) as draft, hdf5_file(draft, "w") as file:
            make_vtk(file, plan, compress)
            group = make_own(file, plan, case, {"program": program}, tables)
            put_outlines(group, outlines or {})
            if regions is not None:
                put_regions(file["VTKHDF"], group, regions, plan.shape)
            make_columns(group, plan, accounts)
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
        """Resume a results file after its first `outputs` outputs; later outputs, history rows and records are cut off.

        Parameters
        ----------
        path : str or Path
        outputs : int
            Number of outputs to keep, as stored in the checkpoint.
        rows, records : int, optional
            Numbers of history rows and probe records to keep; by default those that existed when the last kept output
            was appended.
        recorded : mapping of str to int, optional
            Number of rows of each recorder to keep; by default those up to the last kept output.

        Returns
        -------
        ResultsWriter

        Raises
        ------
        InputError
            A count is negative.
        FileFormatError
            The file is truncated, damaged, not ours, or has fewer outputs or rows than requested.
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
            read_indices(check_format(file, path).parent)
        with opened(path, "r+", "results file") as file:
            check_format(file, path)
            kept = _kept(file, path, outputs, rows, records)
            _cut_recorded(file, path, outputs, recorded or {})
            set_outputs(file, path, outputs)
            _cut(file, kept)
        return cls(path)

    def append(
        self,
        step: int,
        time: float,
        fields: Mapping[str, np.ndarray],
        energy: float | None = None,
        balance: Mapping[str, float] | None = None,
        cautions: Sequence[Caution] = (),
    ) -> None:
        """Append one output.

        With an energy or a balance, a history row is appended too.

        Parameters
        ----------
        step : int
            Step number, larger than that of the previous output.
        time : float
        fields : mapping of str to ndarray, each of the lattice shape, of vectors with the components first
            Every field that the file was created with, or none if it is in parts; nan (outside a window) stays nan.
        energy : float, optional
        balance : mapping of str to float, optional
            Every entry that the file was created with; others are ignored.
        cautions : sequence of Caution
            All cautions so far.

        Raises
        ------
        InputError
            A field is missing, unknown or of the wrong shape, or the step number is not larger.
        FileFormatError
            The file has been damaged since the last call.
        """
        self._check(step, fields)
        history = None
        if energy is not None or balance is not None:
            entries = [np.nan if balance is None else balance[name] for name in self.accounts]
            history = {"times": [time], "energy": [np.nan if energy is None else energy], "balance": [entries]}
        n, rows = self.outputs, self.rows + (0 if history is None else 1)
        with opened(self.path, "r+", "results file") as file:
            if history is not None:
                for name, dataset in file["farhorizon/history"].items():
                    put_rows(dataset, self.rows, history[name])
                file["farhorizon/history"].attrs.modify("rows", rows)
            vtk, group = file["VTKHDF"], file["farhorizon"]
            self._put_fields(vtk, fields)
            put_rows(vtk["Steps/Values"], n, [time])
            put_rows(group["steps"], n, [step])
            put_rows(group["history_rows"], n, [rows])
            put_rows(group["record_rows"], n, [self.records])
            put_word(group.attrs, "cautions", json.dumps(list(cautions)))
            set_outputs(file, self.path, n + 1)
        self.outputs, self.rows, self.last_step = n + 1, rows, int(step)

    def _check(self, step: int, fields: Mapping[str, np.ndarray]) -> None:
        """Refuse an output that is incomplete, or not later than the last one."""
        held = self.fields if self.whole else ()
        if set(fields) != set(held):
            raise InputError(
                f"{self.path}: an output has every field of the file, no other",
                value=sorted(fields),
                limit=sorted(held),
            )
        for name, values in fields.items():
            wanted = self.shape if self.components[name] == 1 else (self.components[name], *self.shape)
            if np.shape(values) != wanted:
                raise InputError(
                    f"{self.path}: field {name!r} has not the lattice shape", value=np.shape(values), limit=wanted
                )
        if self.last_step is not None and step <= self.last_step:
            remedy = "append each step once; ResultsWriter.resume goes back"
            raise InputError(
                f"{self.path}: step numbers grow from output to output",
                value=step,
                limit=f"> {self.last_step}",
                remedy=remedy,
            )

    def _put_fields(self, vtk: Any, fields: Mapping[str, np.ndarray]) -> None:
        """Write the fields of the next output in VTK's order, and their offsets."""
        for name in self.fields if self.whole else ():
            dataset = vtk["PointData"][name]
            values = np.asarray(fields[name]).T.astype(dataset.dtype, order="C", copy=False)
            if self.components[name] > 1:
                values = np.pad(values, [(0, 0)] * len(self.shape) + [(0, 3 - self.components[name])])
            put_rows(dataset, self.outputs, values.reshape(1, *dataset.shape[1:]))
        for name, offsets in vtk["Steps/PointDataOffsets"].items():
            put_rows(offsets, self.outputs, [0 if name == FIELD else self.outputs])

    def finish(self) -> None:
        """Record that the run has reached its end; `resume` revokes this."""
        with opened(self.path, "r+", "results file") as file:
            file["farhorizon"].attrs["finished"] = True

    def hold(self, records: Recorded) -> None:
        """Create empty datasets for the records of a recorder, with the quantities and shapes of `records`.

        Raises
        ------
        InputError
            The name is in use, or would collide with a name in xarray.
        """
        if records.name in self.recorded or records.name in (*RESERVED, *self.fields):
            raise InputError(
                "the results have something else of this name", value=records.name, key="name", remedy="another name"
            )
        with opened(self.path, "r+", "results file") as file:
            group = file["farhorizon"].require_group("recorded").create_group(records.name)
            group.attrs["rows"], group.attrs["directions"] = 0, records.directions
            group.attrs["medium"] = records.medium
            put_fixed(group, "points", np.asarray(records.points, float))
            if records.labels:
                put_words(group, "labels", records.labels)
            put_fixed(group, "frequencies", np.asarray(records.frequencies, float))
            grow(group, "times", "f8")
            rows, spectra = (group.create_group(one, track_order=True) for one in ("data", "spectra"))
            for name, values in records.data.items():
                width = values.shape[1:]
                chunk = (max(1, CHUNK_ROWS // max(1, int(np.prod(width)) // 64)), *width)
                grow(rows, name, "f8", width, chunk)
            for name, values in records.spectra.items():
                real = np.isrealobj(values)
                put_fixed(spectra, name, np.zeros(values.shape if real else (2, *values.shape)))
                spectra[name].attrs["real"] = real
        self.recorded[records.name] = 0

    def conclude(self, records: Recorded) -> None:
        """Store what follows from all records, replacing what followed from an earlier end of the run.

        Raises
        ------
        InputError
            As for `hold`.
        """
        if self.recorded.pop(records.name, None) is not None:
            with opened(self.path, "r+", "results file") as file:
                del file["farhorizon/recorded"][records.name]
        self.hold(records)
        self.append_recorded(records)

    def append_recorded(self, records: Recorded) -> None:
        """Append the rows of `records`, and replace the stored spectra by those of `records`.

        Raises
        ------
        FileFormatError
            The file has been damaged since the last call.
        """
        with opened(self.path, "r+", "results file") as file:
            group, first = file["farhorizon/recorded"][records.name], self.recorded[records.name]
            if len(records.times):
                put_rows(group["times"], first, records.times)
                for name, values in records.data.items():
                    put_rows(group["data"][name], first, values)
                group.attrs.modify("rows", first + len(records.times))
            for name, values in records.spectra.items():
                group["spectra"][name][...] = values if np.isrealobj(values) else [values.real, values.imag]
        self.recorded[records.name] = first + len(records.times)

    def append_probes(self, times: np.ndarray, values: np.ndarray) -> None:
        """Append records of the probes, which have times of their own.

        Parameters
        ----------
        times : ndarray, shape (n,)
        values : ndarray, shape (n, n probes[, components])

        Raises
        ------
        InputError
            The shapes do not match.
        FileFormatError
            The file has been damaged since the last call.
        """
        times, values = np.asarray(times, dtype=float), np.asarray(values, dtype=float)
        if times.ndim != 1 or values.shape != (times.size, *self._probes):
            raise InputError(
                f"{self.path}: times and values of the probes do not match",
                value=f"{times.shape}, {values.shape}",
                limit=f"(n,), (n, {str(self._probes)[1:-1]})",
            )
        if times.size == 0:
            return
        with opened(self.path, "r+", "results file") as file:
            records = file["farhorizon/records"]
            put_rows(records["times"], self.records, times)
            put_rows(records["values"], self.records, values)
            records.attrs.modify("rows", self.records + times.size)
        self.records += times.size


def _kept(file: Any, path: Path, outputs: int, rows: int | None, records: int | None) -> Counts:
    """What is kept of a file that is resumed: as many rows and records as requested, or as at its last kept output."""
    group, held = file["farhorizon"], counts_of(file, path)
    _check_held(path, "outputs", held.outputs, outputs)
    kept_rows, kept_records = (
        wanted if wanted is not None else int(group[noted][outputs - 1]) if outputs else 0
        for wanted, noted in ((rows, "history_rows"), (records, "record_rows"))
    )
    _check_held(path, "history rows", held.rows, kept_rows)
    _check_held(path, "records", held.records, kept_records)
    return Counts(outputs, kept_rows, kept_records)


def _check_held(path: Path, what: str, held: int, wanted: int) -> None:
    if wanted > held:
        raise FileFormatError(
            f"{path} holds fewer {what} than the checkpoint counts",
            value=held,
            limit=wanted,
            remedy="use the results file that belongs to the checkpoint, or start the run anew",
        )


def _cut(file: Any, kept: Counts) -> None:
    """Cut off the rows beyond those that are kept; the run is no longer marked as finished."""
    group = file["farhorizon"]
    group["history"].attrs.modify("rows", kept.rows)
    group["records"].attrs.modify("rows", kept.records)
    group.attrs["finished"] = False
    fields = () if "parts" in group else fields_in(file)
    for dataset in (group["steps"], group["history_rows"], group["record_rows"], *fields):
        dataset.resize(kept.outputs, axis=0)
    for dataset in group["history"].values():
        dataset.resize(kept.rows, axis=0)
    for dataset in group["records"].values():
        dataset.resize(kept.records, axis=0)


def _cut_recorded(file: Any, path: Path, outputs: int, wanted: Mapping[str, int]) -> None:
    """Cut off what recorders recorded after the last kept output, or beyond the requested rows."""
    end = float(file["VTKHDF/Steps/Values"][outputs - 1]) if outputs else -np.inf
    for name, group in file["farhorizon"].get("recorded", {}).items():
        held = int(group.attrs["rows"])
        rows = wanted.get(name, int(np.searchsorted(group["times"][:held], end, side="right")))
        _check_held(path, f"rows of {name}", held, rows)
        group.attrs.modify("rows", rows)
        for dataset in (group["times"], *group["data"].values()):
            dataset.resize(rows, axis=0)

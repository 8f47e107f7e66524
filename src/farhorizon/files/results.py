"""Reading of results files: field by field, assembled from their parts, as a Dataset of xarray.

Their layout is described in `farhorizon.files.results_layout`.
"""

from __future__ import annotations

import json
import shutil
import warnings
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from farhorizon import kinds
from farhorizon.errors import FileFormatError, InputError, ValidityWarning
from farhorizon.files.datasets import put_units, xarray_module
from farhorizon.files.hdf5 import copy_all_but, directory_of, failing, hdf5_file, opened, read_rows, word_in, words_in
from farhorizon.files.parts import Box, folder_of, part_path
from farhorizon.files.polylines import gathered, write_vtp
from farhorizon.files.records import Recorded, dataset_parts, measured_in, spectra_of
from farhorizon.files.region_numbers import FIELD, OUTSIDE
from farhorizon.files.results_layout import (
    Caution,
    boxes_in,
    check_format,
    components_in,
    copied_data,
    counts_of,
    make_field,
    make_room,
    put_boxes,
    vtk_shape,
)
from farhorizon.files.results_writer import ResultsWriter, check_replaceable
from farhorizon.files.storage import created

if TYPE_CHECKING:
    import xarray

_AXES = ("x", "y", "z")
_LISTED = 6  # damaged places in a warning


class Results:
    """A results file, which is opened only at each access, so that it may still grow.

    Parameters
    ----------
    path : str or Path

    Attributes
    ----------
    path : Path
    dim : int
    shape : tuple of int
        Number of nodes along x[, y[, z]].
    spacing : float
    lower : tuple of float
        Coordinates of the first node.
    field_names : tuple of str
    components : dict of str to int
        Number of components of each field: 1, or dim for vectors.
    probes : ndarray, shape (n, dim)
        Positions of the probes.
    case, program : str
        Text of the case file; name and version of the program that wrote the file.
    units : dict of str to str
        Units of "length", "time", "u" and "v", as far as the case specifies them.
    provenance : dict of str to str
        Command, machine and versions that produced the file, for runs from the command line; the error of the layers
        that trial runs showed.
    finished : bool
        Whether the run had ended when the file was opened.
    outlines : dict of str to list of ndarray, each of shape (n, dim)
        Lines to be shown: "cracks" as they were given, in 3D their rims; the edges of the "near field" and, if anything
        is computed beyond it, of the "layers".
    region_names : tuple of str
        Materials of the `regions`, by number; empty if one medium fills the lattice.

    Raises
    ------
    InputError
        The file does not exist.
    FileFormatError
        The file is truncated, damaged or not a farhorizon results file. Any access may raise this error, which names
        the dataset whose checksum is wrong.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        with opened(self.path, "r", "results file") as file:
            group = check_format(file, self.path)
            counts_of(file, self.path)
            self.dim = int(group.attrs["dim"])
            self.shape: tuple[int, ...] = tuple(int(n) for n in group.attrs["shape"])
            self.spacing = float(group.attrs["spacing"])
            self.lower: tuple[float, ...] = tuple(float(v) for v in group.attrs["lower"])
            self.field_names: tuple[str, ...] = words_in(group, "fields")
            self.probes: np.ndarray = read_rows(group, self.path, "probes")
            self.case: str = words_in(group, "case")[0]
            self.program = word_in(group.attrs, "program")
            self.units, self.provenance = (
                dict[str, str](json.loads(word_in(group.attrs, name) or "{}")) for name in ("units", "provenance")
            )
            self.finished = bool(group.attrs.get("finished", False))
            self.outlines: dict[str, list[np.ndarray]] = {}
            if "outlines" in group:
                shown = group["outlines"]
                points, counts = (read_rows(shown, self.path, name) for name in ("points", "counts"))
                self.outlines = gathered(points, counts, words_in(shown, "names"))
            self.region_names = words_in(group, "regions")
            self._accounts = words_in(group, "accounts")
            self._boxes, self._parts = boxes_in(group, self.path), dict[int, Results]()
            self.components = components_in(group)
            for name in self.field_names:
                stored = file["VTKHDF/PointData"][name].shape[1:]
                if stored != vtk_shape(self.shape, self.components[name]):
                    raise FileFormatError(
                        f"{self.path} is damaged: field {name!r} has not the lattice shape",
                        value=stored,
                        limit=self.shape,
                    )

    def __repr__(self) -> str:
        return (
            f"Results({str(self.path)!r}: {len(self.times)} outputs of {', '.join(self.field_names)} on {self.shape})"
        )

    @property
    def boxes(self) -> list[list[tuple[int, int]]]:
        """The boxes of the parts: first node and last node + 1 along each axis; empty if the file has no parts."""
        return [[(int(first), int(last)) for first, last in box] for box in self._boxes]

    def _output_rows(self, name: str) -> np.ndarray:
        with opened(self.path, "r", "results file") as file:
            return read_rows(file, self.path, name, slice(counts_of(file, self.path).outputs))

    def _history_rows(self, name: str) -> np.ndarray:
        with opened(self.path, "r", "results file") as file:
            return read_rows(file, self.path, f"farhorizon/history/{name}", slice(counts_of(file, self.path).rows))

    def _records(self, name: str) -> np.ndarray:
        with opened(self.path, "r", "results file") as file:
            return read_rows(file, self.path, f"farhorizon/records/{name}", slice(counts_of(file, self.path).records))

    @property
    def times(self) -> np.ndarray:
        """Times of the outputs, shape (outputs,)."""
        return self._output_rows("VTKHDF/Steps/Values")

    @property
    def cautions(self) -> list[Caution]:
        """Times from which the result is doubtful, and why; empty if there are no doubts."""
        with opened(self.path, "r", "results file") as file:
            return [Caution(*entry) for entry in json.loads(word_in(file["farhorizon"].attrs, "cautions"))]

    @property
    def steps(self) -> np.ndarray:
        """Step numbers of the outputs, shape (outputs,)."""
        return self._output_rows("farhorizon/steps")

    @property
    def axes(self) -> list[np.ndarray]:
        """Coordinates of the nodes along each axis."""
        return [first + self.spacing * np.arange(n) for first, n in zip(self.lower, self.shape, strict=True)]

    @property
    def history_times(self) -> np.ndarray:
        """Times of the history, shape (rows,)."""
        return self._history_rows("times")

    @property
    def probe_times(self) -> np.ndarray:
        """Times at which the probes were recorded, shape (records,): every step unless the case specifies otherwise."""
        return self._records("times")

    @property
    def probe_values(self) -> np.ndarray:
        """Values at the probes at `probe_times`, shape (records, n probes[, components])."""
        return self._records("values") if len(self.probes) else np.empty((0, 0))

    @property
    def recorded(self) -> dict[str, Recorded]:
        """The data of receivers and spectra, by their names."""
        found = {}
        with opened(self.path, "r", "results file") as file:
            for name, group in file["farhorizon"].get("recorded", {}).items():
                place, rows = f"farhorizon/recorded/{name}", slice(int(group.attrs["rows"]))
                spectra = {n: _read_spectrum(file, self.path, f"{place}/spectra/{n}") for n in group["spectra"]}
                found[name] = Recorded(
                    name,
                    read_rows(file, self.path, f"{place}/points"),
                    read_rows(file, self.path, f"{place}/times", rows),
                    {n: read_rows(file, self.path, f"{place}/data/{n}", rows) for n in group["data"]},
                    read_rows(file, self.path, f"{place}/frequencies"),
                    spectra,
                    bool(group.attrs.get("directions", False)),
                    float(group.attrs.get("medium", 0.0)),
                    words_in(group, "labels"),
                )
        return found

    @property
    def regions(self) -> np.ndarray:
        """The number of the region of each node, of the lattice's shape, with names in `region_names`: 0 has the most
        nodes, and -1 is where there is no node.
        """
        if not self.region_names:
            return np.zeros(self.shape, np.int32)
        with opened(self.path, "r", "results file") as file:
            stored = read_rows(file, self.path, f"VTKHDF/PointData/{FIELD}", 0)
        return np.ascontiguousarray(stored.reshape(self.shape[::-1]).T)

    @property
    def energy(self) -> np.ndarray:
        """Energy, shape (rows,); nan where none was recorded."""
        return self._history_rows("energy")

    @property
    def balance(self) -> dict[str, np.ndarray]:
        """Entries of the balance (`Simulation.balance`), each of shape (rows,); empty if none was recorded."""
        rows = self._history_rows("balance") if self._accounts else np.empty((0, 0))
        return {name: rows[:, i] for i, name in enumerate(self._accounts)}

    def field(self, name: str, index: int = -1) -> np.ndarray:
        """Read one field at one output.

        Parameters
        ----------
        name : str
        index : int
            Number of the output; negative numbers count from the end.

        Returns
        -------
        ndarray, shape (nx[, ny[, nz]]), or (components, nx, ...) for vectors

        Raises
        ------
        InputError
            There is no such field or output.
        FileFormatError
            The file is damaged.
        """
        if name not in self.field_names:
            raise InputError(f"{self.path} has no field {name!r}", remedy=f"one of {', '.join(self.field_names)}")
        index = kinds.integer(index, "index", least=-kinds.MOST_WHOLE)
        with opened(self.path, "r", "results file") as file:
            outputs = counts_of(file, self.path).outputs
            if not -outputs <= index < outputs:
                raise InputError(f"{self.path} has no output {index}", value=index, limit=f"{outputs} outputs")
        return self._values(name, slice(index % outputs, index % outputs + 1))[0]

    def _values(self, name: str, rows: slice, within: Box | None = None) -> np.ndarray:
        """Outputs of a field, in a box if one is given, shape (outputs[, components], nx[, ny[, nz]]), assembled from
        the parts if there are any.
        """
        asked = np.array([(0, n) for n in self.shape] if within is None else within)
        if not len(self._boxes):
            with opened(self.path, "r", "results file") as file:
                values = self._lattice_first(name, read_rows(file, self.path, f"VTKHDF/PointData/{name}", rows))
            inside: tuple[Any, ...] = (..., *(slice(first, last) for first, last in asked))
            return values[inside]
        whole, size = np.zeros(0), asked[:, 1] - asked[:, 0]
        for number, box in enumerate(self._boxes):
            first, last = np.maximum(box[:, 0], asked[:, 0]), np.minimum(box[:, 1], asked[:, 1])
            if (first >= last).any():
                continue
            values = self._part(number, box)._values(name, rows)
            if not whole.size:
                whole = np.zeros((*values.shape[: -self.dim], *size), values.dtype)
            self._check_rows(number, len(values), len(whole))
            to: tuple[Any, ...] = (..., *map(slice, first - asked[:, 0], last - asked[:, 0]))
            of: tuple[Any, ...] = (..., *map(slice, first - box[:, 0], last - box[:, 0]))
            whole[to] = values[of]
        return whole

    def _part(self, number: int, box: np.ndarray) -> Results:
        """The results of a part.

        Raises
        ------
        FileFormatError
            The part is missing or belongs to another run.
        """
        if number in self._parts:
            return self._parts[number]
        path = part_path(self.path, number)
        if not path.is_file():
            raise FileFormatError(
                f"{self.path} lacks its part {path}",
                remedy=f"keep the folder {folder_of(self.path).name} beside the file",
            )
        found = Results(path)
        alike = found.shape == tuple(box[:, 1] - box[:, 0]) and found.field_names == self.field_names
        if not (alike and found.components == self.components and found.spacing == self.spacing):
            raise FileFormatError(
                f"{path} is no part of {self.path}", remedy="use the folder that the run has written beside the file"
            )
        self._parts[number] = found
        return found

    def _check_rows(self, number: int, held: int, wanted: int) -> None:
        if held != wanted:
            raise FileFormatError(
                f"{part_path(self.path, number)} has other outputs than the other parts",
                value=held,
                limit=wanted,
                remedy="compute it again, or resume the run from a checkpoint before it",
            )

    def _lattice_first(self, name: str, stored: np.ndarray) -> np.ndarray:
        """Outputs in our order of axes, without VTK's padding of vectors: (outputs[, components], nx[, ny[, nz]])."""
        components = self.components[name]
        width = () if components == 1 else (3,)
        values = stored.reshape(len(stored), *self.shape[::-1], *width)
        found = values.transpose(0, *range(values.ndim - 1, 0, -1))
        return np.ascontiguousarray(found if components == 1 else found[:, :components])

    def damaged(self) -> list[str]:
        """Verify all check sums, which reads the whole file, chunk by chunk, and its parts.

        Returns
        -------
        list of str
            Datasets with the rows that fail; for fields these are the outputs ("VTKHDF/PointData/u[3]"). Reading them
            raises FileFormatError; everything else can be read. Empty if nothing is damaged.

        Raises
        ------
        FileFormatError
            What says where the data are is damaged, or a part is missing.
        """
        parts = [self._part(number, box).path for number, box in enumerate(self._boxes)]
        return _failing(self.path) + [f"{path.name}: {name}" for path in parts for name in _failing(path)]

    def merge(self, path: str | Path) -> Path:
        """Write the results of several processes as one file, as one process would have written it; a copy if the
        results are already one file.

        The file is written piece by piece: no field is held in memory as a whole.

        Parameters
        ----------
        path : str or Path
            Older results of that name are replaced.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        InputError
            The path is that of this file or of another program's file, or there is no such directory.
        FileFormatError
            A part is missing or damaged.
        """
        path = kinds.path(path, "path")
        check_replaceable(path)
        if path.exists() and path.samefile(self.path):
            raise InputError("the file cannot take its own place", value=path, key="path", remedy="another name")
        with opened(self.path, "r", "results file") as file, created(path) as draft, hdf5_file(draft, "w") as made:
            counts = counts_of(file, self.path)
            copy_all_but(file, made, {"/VTKHDF/PointData", "/farhorizon/parts"})
            source, data = file["VTKHDF/PointData"], copied_data(file["VTKHDF/PointData"], made)
            for name in self.field_names:
                self._copy_field(source[name], data, counts.outputs)
        make_room(path, 0)
        return path

    def cut(self, path: Path, box: Box, outputs: int) -> None:
        """Write the fields in a box, at the first outputs, to a results file that contains nothing else.

        Raises
        ------
        FileFormatError
            A part is missing or damaged.
        """
        one = self._part(0, self._boxes[0]).path if len(self._boxes) else self.path
        with opened(one, "r", "results file") as file:
            data = file["VTKHDF/PointData"][self.field_names[0]]
            dtype, compress = data.dtype, data.compression is not None
        writer = ResultsWriter.create(
            path,
            shape=[last - first for first, last in box],
            spacing=self.spacing,
            lower=[low + self.spacing * first for low, (first, _) in zip(self.lower, box, strict=True)],
            fields=self.field_names,
            dtype=dtype,
            components=self.components,
            program=self.program,
            compress=compress,
        )
        for index, (step, time) in enumerate(zip(self.steps[:outputs], self.times[:outputs], strict=True)):
            rows = slice(index, index + 1)
            writer.append(int(step), float(time), {n: self._values(n, rows, box)[0] for n in self.field_names})

    def take_parts(self, boxes: Sequence[Box], folder: Path) -> None:
        """Replace the parts, or the fields in this file, by parts of other boxes, which `cut` has written to a folder.

        If this is interrupted, either set of parts is still in a folder of its own.
        """
        with opened(self.path, "r", "results file") as file, created(self.path) as draft, hdf5_file(draft, "w") as made:
            copy_all_but(file, made, {"/VTKHDF/PointData", "/farhorizon/parts"})
            source, data = file["VTKHDF/PointData"], copied_data(file["VTKHDF/PointData"], made)
            for name in self.field_names:
                data.create_dataset(name, (0, *source[name].shape[1:]), source[name].dtype)
            put_boxes(made["farhorizon"], boxes)
        old, own = folder.with_name(f"{folder.name}.old"), folder_of(self.path)
        if own.is_dir():
            own.rename(old)
        folder.rename(own)
        if old.is_dir():
            shutil.rmtree(old)

    def _copy_field(self, source: Any, data: Any, outputs: int) -> None:
        """Copy the outputs of a field to a group, chunk by chunk."""
        name = source.name.rpartition("/")[2]
        dim = source.ndim - 1 - (self.components[name] > 1)  # number of stored axes
        with ExitStack() as stack:
            parts = [
                (box[:dim][::-1], stack.enter_context(opened(self._part(i, box).path, "r", "results file")))
                for i, box in enumerate(self._boxes)
            ]
            own = source if not parts else parts[0][1][source.name]
            made = make_field(data, name, source.shape[1:], source.dtype, own.compression is not None)
            made.resize(outputs, axis=0)
            for chunk in made.iter_chunks() if outputs else ():
                values = np.zeros([one.stop - one.start for one in chunk], source.dtype)
                if not parts:
                    values[...] = source[chunk]
                for box, file in parts:
                    common = [
                        (max(one.start, int(first)), min(one.stop, int(last)), one.start, int(first))
                        for one, (first, last) in zip(chunk[1 : dim + 1], box, strict=True)
                    ]
                    if all(first < last for first, last, _, _ in common):
                        here = tuple(slice(first - begin, last - begin) for first, last, begin, _ in common)
                        there = tuple(slice(first - begin, last - begin) for first, last, _, begin in common)
                        values[(slice(None), *here)] = read_rows(
                            file, Path(file.filename), source.name, (chunk[0], *there)
                        )
                made[chunk] = values

    def write_outlines(self, path: str | Path) -> Path:
        """Write the `outlines` for ParaView, which shows them beside the fields.

        Parameters
        ----------
        path : str or Path
            A name that ends in .vtp; the cell data ``kind`` number the entries of `outlines`, in their order.

        Raises
        ------
        InputError
            There is no such directory.
        """
        path = kinds.path(path, "path")
        directory_of(path)
        return write_vtp(path, self.outlines)

    def to_xarray(self) -> xarray.Dataset:
        """Read everything into an xarray Dataset (in memory).

        Returns
        -------
        xarray.Dataset
            Fields with the dimensions time, [component, ]x[, y[, z]]; ``energy`` (history_time), ``probe_values``
            (probe_time, probe), ``balance`` (history_time, account) if one was recorded; case, program and lattice as
            attributes; for each recorder NAME the variables ``NAME_QUANTITY`` (NAME_time, NAME_point, ...), its spectra
            ``NAME_QUANTITY_spectrum`` (NAME_frequency, NAME_point, ...), and the coordinates NAME_x, ....

        Raises
        ------
        InputError
            xarray is not installed.
        FileFormatError
            The file is damaged.
        """
        xarray = xarray_module()
        # The counts are read once, because a running simulation may append between two accesses.
        times, history_times, probe_times = self.times, self.history_times, self.probe_times
        data = self._variables(times.size, history_times.size, probe_times.size)
        coords = self._coordinates(times, history_times, probe_times)
        if any("component" in dims for dims, *_ in data.values()):
            coords["component"] = list(_AXES[: self.dim])
        recorded = self.recorded
        more = dataset_parts(recorded)
        whole = xarray.Dataset(data | more[0], coords | more[1], self._attributes())
        put_units(whole, self.units, self._measured() | measured_in(recorded), spectra_of(recorded))
        return whole

    def _variables(self, outputs: int, rows: int, records: int) -> dict[str, Any]:
        """Variables of a Dataset that every results file has, up to the given counts."""
        names, probed = _AXES[: self.dim], self.probe_values[:records]
        data: dict[str, Any] = {}
        for name, count in self.components.items():
            dims = ("time", *names) if count == 1 else ("time", "component", *names)
            data[name] = (dims, self._values(name, slice(outputs)))
        data["energy"] = ("history_time", self.energy[:rows])
        data["probe_values"] = (("probe_time", "probe", "component")[: probed.ndim], probed)
        if self.region_names:
            data[FIELD] = (names, self.regions, {"names": list(self.region_names), "outside": OUTSIDE})
        if self._accounts:
            balance = np.stack([values[:rows] for values in self.balance.values()], axis=1)
            data["balance"] = (("history_time", "account"), balance)
        return data

    def _coordinates(self, times: np.ndarray, history_times: np.ndarray, probe_times: np.ndarray) -> dict[str, Any]:
        coords: dict[str, Any] = {
            "time": times,
            "step": ("time", self.steps[: times.size]),
            "history_time": history_times,
            "probe_time": probe_times,
        }
        for axis, name in enumerate(_AXES[: self.dim]):
            coords[name] = self.axes[axis]
            coords[f"probe_{name}"] = ("probe", self.probes[:, axis])
        if self._accounts:
            coords["account"] = list(self._accounts)
        return coords

    def _attributes(self) -> dict[str, Any]:
        return {
            **self.provenance,
            "program": self.program,
            "case": self.case,
            "dim": self.dim,
            "spacing": self.spacing,
            "lower": list(self.lower),
            "cautions": [caution.text for caution in self.cautions],
        }

    def _measured(self) -> dict[str, str]:
        """What variables and coordinates of a Dataset measure, where it is not their own name."""
        lengths = [f"{before}{name}" for before in ("", "probe_") for name in _AXES[: self.dim]]
        measured = {**dict.fromkeys(lengths, "length"), "probe_values": "u"}
        measured |= dict.fromkeys(("time", "probe_time", "history_time"), "time")
        return measured | {name: "stress" for name in self.field_names if name.startswith("stress_")}


def open_results(path: str | Path, verify: bool = True) -> Results:
    """Open a results file.

    Parameters
    ----------
    path : str or Path
    verify : bool
        Verify all check sums at once, which reads the whole file, and warn about what is damaged (`Results.damaged`).
        Whatever is read later is verified in any case, so that large files may be opened without.

    Returns
    -------
    Results

    Raises
    ------
    InputError
        The file does not exist.
    FileFormatError
        The file is truncated, damaged or not a farhorizon results file.

    Warns
    -----
    ValidityWarning
        Some of the data are damaged; the others can be read.

    Examples
    --------
    >>> import farhorizon as fh
    >>> results = fh.open_results("results/case.h5")  # doctest: +SKIP
    >>> results.times, results.field("u", -1)  # doctest: +SKIP
    """
    found = Results(kinds.path(path, "path"))
    if kinds.flag(verify, "verify") and (failed := found.damaged()):
        shown = ", ".join(failed[:_LISTED]) + (f" and {len(failed) - _LISTED} more" if len(failed) > _LISTED else "")
        text = f"{path} is damaged, and what fails its check sum cannot be read: {shown}; remedy: compute it again"
        warnings.warn(text, ValidityWarning, stacklevel=2)
    return found


def _read_spectrum(file: Any, path: Path, name: str) -> np.ndarray:
    """A spectrum, real if the file says so, otherwise complex."""
    values = read_rows(file, path, name)
    return values if file[name].attrs.get("real", False) else np.asarray(values[0] + 1j * values[1])


def _failing(path: Path) -> list[str]:
    """What fails its check sum twice: what a running simulation was just writing is whole the next time."""
    with opened(path, "r", "results file") as file:
        found = list(failing(file))
    if not found:
        return found
    with opened(path, "r", "results file") as file:
        again = set(failing(file))
    return [name for name in found if name in again]

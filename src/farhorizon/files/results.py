"""Reading of results files: field by field, assembled from their parts, as a Dataset of xarray.

Their layout is described in `farhorizon.files.results_layout`.
"""

from __future__ import annotations

import json
import shutil
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from farhorizon import kinds
from farhorizon.errors import FileFormatError, InputError, ValidityWarning
from farhorizon.files.datasets import put_units, xarray_module
from farhorizon.files.hdf5 import (
    copy_all_but,
    copy_attributes,
    directory_of,
    failing,
    hdf5_file,
    opened,
    put_fixed,
    read_rows,
    word_in,
    words_in,
)
from farhorizon.files.parts import Box, folder_of, make_room, part_path, stored_slices
from farhorizon.files.polylines import lines_in, write_vtp
from farhorizon.files.records import Recorded, variables_of
from farhorizon.files.results_layout import (
    FIELD,
    OUTSIDE,
    Caution,
    Layout,
    counts_of,
    make_field,
    stored_boxes,
    table_in,
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
            self._layout = layout = Layout.of(file, self.path)
            group = file["farhorizon"]
            counts_of(file, self.path)
            self.shape, self.lower, self.spacing, *_ = layout
            self.dim = len(self.shape)
            self.components, self.field_names = layout.components, tuple(layout.components)
            self.probes = layout.probes
            self.case: str = words_in(group, "case")[0]
            self.program = word_in(group.attrs, "program")
            self.units, self.provenance = (
                dict[str, str](json.loads(word_in(group.attrs, name) or "{}")) for name in ("units", "provenance")
            )
            self.finished = bool(group.attrs.get("finished", False))
            self.outlines = lines_in(group, self.path, "outlines")
            self.region_names = words_in(group, "regions")
            self._parts = dict[int, Results]()
            for name in self.field_names:
                stored = file["VTKHDF/PointData"][name].shape[1:]
                if stored != layout.stored_shape(name):
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
        return [[(int(first), int(last)) for first, last in box] for box in self._layout.boxes]

    def _column(self, table: str, column: str) -> np.ndarray:
        """Valid rows of a column of a table that every file has."""
        with opened(self.path, "r", "results file") as file:
            rows = slice(counts_of(file, self.path)[table])
            return read_rows(file, self.path, table_in(file, table).columns[column].name.lstrip("/"), rows)

    @property
    def times(self) -> np.ndarray:
        """Times of the outputs, shape (outputs,)."""
        return self._column("outputs", "times")

    @property
    def cautions(self) -> list[Caution]:
        """Times from which the result is doubtful, and why; empty if there are no doubts."""
        with opened(self.path, "r", "results file") as file:
            return [Caution(*entry) for entry in json.loads(word_in(file["farhorizon"].attrs, "cautions"))]

    @property
    def steps(self) -> np.ndarray:
        """Step numbers of the outputs, shape (outputs,)."""
        return self._column("outputs", "steps")

    @property
    def axes(self) -> list[np.ndarray]:
        """Coordinates of the nodes along each axis."""
        return [first + self.spacing * np.arange(n) for first, n in zip(self.lower, self.shape, strict=True)]

    @property
    def history_times(self) -> np.ndarray:
        """Times of the history, shape (rows,)."""
        return self._column("history", "times")

    @property
    def probe_times(self) -> np.ndarray:
        """Times at which the probes were recorded, shape (records,): every step unless the case specifies otherwise."""
        return self._column("records", "times")

    @property
    def probe_values(self) -> np.ndarray:
        """Values at the probes at `probe_times`, shape (records, n probes[, components])."""
        return self._column("records", "values") if len(self.probes) else np.empty((0, 0))

    @property
    def recorded(self) -> dict[str, Recorded]:
        """The data of receivers and spectra, by their names."""
        recorded = {}
        with opened(self.path, "r", "results file") as file:
            for name, group in file["farhorizon"].get("recorded", {}).items():
                place, rows = f"farhorizon/recorded/{name}", slice(int(group.attrs["rows"]))
                recorded[name] = Recorded(
                    name,
                    read_rows(file, self.path, f"{place}/points"),
                    read_rows(file, self.path, f"{place}/times", rows),
                    {n: read_rows(file, self.path, f"{place}/data/{n}", rows) for n in group["data"]},
                    read_rows(file, self.path, f"{place}/frequencies"),
                    {n: _read_spectrum(file, self.path, f"{place}/spectra/{n}") for n in group["spectra"]},
                    bool(group.attrs.get("directions", False)),
                    float(group.attrs.get("medium", 0.0)),
                    words_in(group, "labels"),
                )
        return recorded

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
        return self._column("history", "energy")

    @property
    def balance(self) -> dict[str, np.ndarray]:
        """Entries of the balance (`Simulation.balance`), each of shape (rows,); empty if none was recorded."""
        accounts = self._layout.accounts
        rows = self._column("history", "balance") if accounts else np.empty((0, 0))
        return {name: rows[:, i] for i, name in enumerate(accounts)}

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
            outputs = counts_of(file, self.path)["outputs"]
            if not -outputs <= index < outputs:
                raise InputError(f"{self.path} has no output {index}", value=index, limit=f"{outputs} outputs")
        return self._values(name, slice(index % outputs, index % outputs + 1))[0]

    def _values(self, name: str, rows: slice, box: Box | None = None) -> np.ndarray:
        """Outputs of a field, in a box if one is given, shape (outputs[, components], nx[, ny[, nz]])."""
        box = [(0, n) for n in self.shape] if box is None else box
        stored, components = self._stored(name, rows, box), self.components[name]
        sizes = [last - first for first, last in box]
        values = stored.reshape(len(stored), *sizes[::-1], *(() if components == 1 else (3,)))
        ours = values.transpose(0, *range(values.ndim - 1, 0, -1))
        return np.ascontiguousarray(ours if components == 1 else ours[:, :components])

    def _stored(self, name: str, rows: slice, box: Box) -> np.ndarray:
        """Outputs of a field in a box, in VTK's order of axes and with its padding of vectors, assembled from the parts
        if there are any.
        """
        axes = vtk_shape(self.shape, 1)
        if not len(self._layout.boxes):
            with opened(self.path, "r", "results file") as file:
                return read_rows(file, self.path, f"VTKHDF/PointData/{name}", (rows, *stored_slices(axes, box)))
        asked, values = np.array(box), np.zeros(0)
        for number, held in enumerate(self._layout.boxes):
            common = np.stack([np.maximum(held[:, 0], asked[:, 0]), np.minimum(held[:, 1], asked[:, 1])], axis=1)
            if (common[:, 0] >= common[:, 1]).any():
                continue
            piece = self._part(number)._stored(name, rows, common - held[:, :1])
            if not values.size:
                sizes = [part.stop for part in stored_slices(axes, asked - asked[:, :1])]
                values = np.zeros((len(piece), *sizes, *self._layout.stored_shape(name)[len(axes) :]), piece.dtype)
            if len(piece) != len(values):
                raise FileFormatError(
                    f"{part_path(self.path, number)} has other outputs than the other parts",
                    value=len(piece),
                    limit=len(values),
                    remedy="compute it again, or resume the run from a checkpoint before it",
                )
            place = values[(slice(None), *stored_slices(axes, common - asked[:, :1]))]
            place[...] = piece.reshape(place.shape)  # a part of one node along a slow axis lacks that axis
        return values

    def _part(self, number: int) -> Results:
        """The results of a part; FileFormatError if it is missing or belongs to another run."""
        if number in self._parts:
            return self._parts[number]
        path, box = part_path(self.path, number), self._layout.boxes[number]
        if not path.is_file():
            raise FileFormatError(
                f"{self.path} lacks its part {path}",
                remedy=f"keep the folder {folder_of(self.path).name} beside the file",
            )
        part = Results(path)
        alike = part.shape == tuple(box[:, 1] - box[:, 0]) and part.field_names == self.field_names
        if not (alike and part.components == self.components and part.spacing == self.spacing):
            raise FileFormatError(
                f"{path} is no part of {self.path}", remedy="use the folder that the run has written beside the file"
            )
        self._parts[number] = part
        return part

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
        parts = [self._part(number).path for number in range(len(self._layout.boxes))]
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
        outputs = len(self.times)
        with self._copied(path) as (_, data):
            for name in self.field_names:
                axes = len(vtk_shape(self.shape, 1))
                field = make_field(data, name, self._layout.stored_shape(name), *self._stored_as(name))
                field.resize(outputs, axis=0)
                for chunk in field.iter_chunks() if outputs else ():
                    box = [(part.start, part.stop) for part in chunk[axes:0:-1]]
                    field[chunk] = self._stored(name, chunk[0], [*box, *[(0, 1)] * (self.dim - axes)])
        make_room(path, 0)
        return path

    @contextmanager
    def _copied(self, path: Path) -> Iterator[tuple[Any, Any]]:
        """A copy of the file without its fields and boxes, and its group for the fields; it replaces what is at a path
        at the end.
        """
        with opened(self.path, "r", "results file") as file, created(path) as draft, hdf5_file(draft, "w") as made:
            copy_all_but(file, made, {"/VTKHDF/PointData", "/farhorizon/parts"})
            source, data = file["VTKHDF/PointData"], made.create_group("VTKHDF/PointData")
            copy_attributes(source, data)
            if FIELD in source:
                source.copy(FIELD, data)
            yield made, data

    def _stored_as(self, name: str) -> tuple[np.dtype, bool]:
        """Type of a field in the file or in its parts, and whether it is compressed."""
        with opened(self._part(0).path if len(self._layout.boxes) else self.path, "r", "results file") as file:
            data = file["VTKHDF/PointData"][name]
            return data.dtype, data.compression is not None

    def cut(self, path: Path, box: Box, outputs: int) -> None:
        """Write the fields in a box, at the first outputs, to a results file that contains nothing else."""
        dtype, compress = self._stored_as(self.field_names[0])
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
        with self._copied(self.path) as (made, data):
            for name in self.field_names:
                data.create_dataset(name, (0, *self._layout.stored_shape(name)), self._stored_as(name)[0])
            put_fixed(made["farhorizon"], "parts", stored_boxes(boxes))
        old, place = folder.with_name(f"{folder.name}.old"), folder_of(self.path)
        if place.is_dir():
            place.rename(old)
        folder.rename(place)
        if old.is_dir():
            shutil.rmtree(old)

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
        names, probed = _AXES[: self.dim], self.probe_values[: probe_times.size]
        data, coords, quantities = variables_of(self.recorded)
        for name, count in self.components.items():
            dims = ("time", *names) if count == 1 else ("time", "component", *names)
            data[name] = (dims, self._values(name, slice(times.size)))
        data["energy"] = ("history_time", self.energy[: history_times.size])
        data["probe_values"] = (("probe_time", "probe", "component")[: probed.ndim], probed)
        if self.region_names:
            data[FIELD] = (names, self.regions, {"names": list(self.region_names), "outside": OUTSIDE})
        if balance := self.balance:
            rows = np.stack([values[: history_times.size] for values in balance.values()], axis=1)
            data["balance"], coords["account"] = (("history_time", "account"), rows), list(balance)
        coords |= {"time": times, "step": ("time", self.steps[: times.size])}
        coords |= {"history_time": history_times, "probe_time": probe_times}
        for axis, name in enumerate(names):
            coords |= {name: self.axes[axis], f"probe_{name}": ("probe", self.probes[:, axis])}
        if any("component" in dims for dims, *_ in data.values()):
            coords["component"] = list(names)
        attributes = {
            **self.provenance,
            "program": self.program,
            "case": self.case,
            "dim": self.dim,
            "spacing": self.spacing,
            "lower": list(self.lower),
            "cautions": [caution.text for caution in self.cautions],
        }
        variables = xarray.Dataset(data, coords, attributes)
        for quantity, of_it in (
            ("length", [f"{before}{name}" for before in ("", "probe_") for name in names]),
            ("time", ["time", "probe_time", "history_time"]),
            ("u", ["probe_values"]),
            ("stress", [name for name in self.field_names if name.startswith("stress_")]),
        ):
            quantities |= dict.fromkeys(of_it, (quantity,))
        put_units(variables, self.units, quantities)
        return variables


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
    results = Results(kinds.path(path, "path"))
    if kinds.flag(verify, "verify") and (failed := results.damaged()):
        shown = ", ".join(failed[:_LISTED]) + (f" and {len(failed) - _LISTED} more" if len(failed) > _LISTED else "")
        text = f"{path} is damaged, and what fails its check sum cannot be read: {shown}; remedy: compute it again"
        warnings.warn(text, ValidityWarning, stacklevel=2)
    return results


def _read_spectrum(file: Any, path: Path, name: str) -> np.ndarray:
    """A spectrum, real if the file says so, otherwise complex."""
    values = read_rows(file, path, name)
    return values if file[name].attrs.get("real", False) else np.asarray(values[0] + 1j * values[1])


def _failing(path: Path) -> list[str]:
    """What fails its check sum twice: what a running simulation was just writing is whole the next time."""
    with opened(path, "r", "results file") as file:
        damaged = list(failing(file))
    if not damaged:
        return damaged
    with opened(path, "r", "results file") as file:
        again = set(failing(file))
    return [name for name in damaged if name in again]

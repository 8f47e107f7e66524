"""Layout of a results file, for the code that writes it and the code that reads it.

A results file is a VTKHDF ``ImageData`` file [1]_ with a temporal ``Steps`` group, so that ParaView opens it directly:
``/VTKHDF`` contains the fields as point data, one chunked record per output, in VTK's order (x fastest), on a lattice
padded to three dimensions. ``/farhorizon`` contains what VTK does not know: case text, program, lattice, and the tables
of `table_in`, each with the number of its valid rows; ``finished`` says whether the run reached its end. Every dataset
has a checksum (Fletcher 32) per chunk, and so has all metadata in HDF5's format 1.10.

It is written through `farhorizon.files.storage`: if a process is killed, or a disk is full, the file stays as it was
before. Several processes write a file in parts, see `farhorizon.files.parts`.

References
----------
.. [1] VTKHDF file format, https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/vtkhdf_specifications.html
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np

from farhorizon.errors import FileFormatError
from farhorizon.files.hdf5 import (
    CHUNK_ROWS,
    Table,
    check_version,
    grow,
    put_fixed,
    put_word,
    put_words,
    read_rows,
    refuse_other_files,
    word_in,
    words_in,
)
from farhorizon.files.parts import Box, lay_out

FORMAT = "farhorizon results"
RESULTS_VERSION = 2
FIELD = "region"
"""Name of the regions among the point data, under which ParaView lists them."""
OUTSIDE = -1
"""Region number of nodes that do not exist, outside a body or a window."""
_NAMED = 6  # most regions named in a row of a report
# Names that the Dataset of `Results.to_xarray` and the pictures of `farhorizon.pictures` use for other things.
RESERVED = frozenset(
    f"time step {FIELD} x y z energy history_time probe probe_time probe_x probe_y probe_z probe_values probes balance "
    "account component".split()
)
_CHUNK_BYTES = 2**26  # large enough that a chunk costs little beside its data, small enough to be held several times


class Caution(NamedTuple):
    """The result of a run is doubtful from a time on; `brief` gives the reason in two or three words, `text` in a
    sentence.
    """

    time: float
    brief: str
    text: str


class Layout(NamedTuple):
    """Lattice and fields of a results file: components by field, positions (n, dim) and components of the probes,
    entries of the balance, and boxes (parts, dim, 2) of the parts that store the fields, if the file itself does not.
    """

    shape: tuple[int, ...]
    lower: tuple[float, ...]
    spacing: float
    components: dict[str, int]
    probes: np.ndarray
    probe_components: int
    accounts: tuple[str, ...]
    boxes: np.ndarray

    @classmethod
    def of(cls, file: Any, path: Path) -> Layout:
        """Layout of an open file of ours; fields have one component if it does not say, and probes those of the first
        field.
        """
        group = checked_group(file, path)
        names = words_in(group, "fields")
        widths = np.broadcast_to(group.attrs.get("components", 1), len(names))
        components = dict(zip(names, map(int, widths), strict=True))
        return cls(
            tuple(int(n) for n in group.attrs["shape"]),
            tuple(float(v) for v in group.attrs["lower"]),
            float(group.attrs["spacing"]),
            components,
            read_rows(group, path, "probes"),
            int(group.attrs.get("probe_components", components[names[0]])),
            words_in(group, "accounts"),
            read_rows(group, path, "parts") if "parts" in group else np.zeros((0, 0, 2), np.int64),
        )

    @property
    def probe_shape(self) -> tuple[int, ...]:
        """Shape of the values at the probes at one time."""
        return (len(self.probes), *((self.probe_components,) if self.probe_components > 1 else ()))

    def stored_shape(self, field: str) -> tuple[int, ...]:
        """Shape of one stored output of a field."""
        return vtk_shape(self.shape, self.components[field])

    def make(self, file: Any, dtype: np.dtype, compress: bool) -> Any:
        """Create what VTK reads and all tables, without rows; returns the group of what VTK does not know."""
        vtk, group = file.create_group("VTKHDF"), file.create_group("farhorizon")
        padded, origin = (*self.shape, 1, 1)[:3], (*self.lower, 0.0, 0.0)[:3]
        vtk.attrs["Version"] = np.array([2, 0])
        vtk.attrs.create("Type", b"ImageData", dtype=h5py.string_dtype("ascii", len("ImageData")))
        vtk.attrs["WholeExtent"] = np.array([end for n in padded for end in (0, n - 1)])
        vtk.attrs["Origin"] = np.array(origin)
        vtk.attrs["Spacing"] = np.full(3, self.spacing)
        vtk.attrs["Direction"] = np.eye(3).ravel()
        steps, data = vtk.create_group("Steps"), vtk.create_group("PointData")
        steps.attrs["NSteps"] = 0
        grow(steps, "Values", "f8")
        offsets = steps.create_group("PointDataOffsets")
        for name, components in self.components.items():
            if len(self.boxes):
                data.create_dataset(name, (0, *self.stored_shape(name)), dtype)
            else:
                make_field(data, name, self.stored_shape(name), dtype, compress)
            grow(offsets, name, "i8")
            attribute = "Scalars" if components == 1 else "Vectors"
            if attribute not in data.attrs:
                put_word(data.attrs, attribute, name)
        put_word(group.attrs, "format", FORMAT)
        attributes = {
            "version": RESULTS_VERSION,
            "finished": False,
            "dim": len(self.shape),
            "shape": self.shape,
            "spacing": self.spacing,
            "lower": self.lower,
            "components": list(self.components.values()),
            "probe_components": self.probe_components,
            "outputs": 0,
        }
        for name, value in attributes.items():
            group.attrs[name] = value
        if len(self.boxes):
            put_fixed(group, "parts", self.boxes)
        put_words(group, "fields", tuple(self.components))
        put_fixed(group, "probes", self.probes)
        for name in ("steps", "history_rows", "record_rows"):
            grow(group, name, "i8")
        history, records = group.create_group("history"), group.create_group("records")
        history.attrs["rows"] = records.attrs["rows"] = 0
        for table, name in ((history, "times"), (history, "energy"), (records, "times")):
            grow(table, name, "f8")
        if count := len(self.probes):
            chunk = (CHUNK_ROWS, min(count, 64), *self.probe_shape[1:])
            grow(records, "values", "f8", self.probe_shape, chunk)
        if self.accounts:
            put_words(group, "accounts", self.accounts)
            grow(history, "balance", "f8", (len(self.accounts),))
        return group


def checked_group(file: Any, path: Path) -> Any:
    """The group ``/farhorizon``; FileFormatError if the file is another program's or of another version."""
    refuse_other_files(file, path)
    if "farhorizon" not in file or word_in(file["farhorizon"].attrs, "format") != FORMAT or "VTKHDF" not in file:
        raise FileFormatError(
            f"{path} is an HDF5 file, but not a farhorizon results file", remedy="give a file written by farhorizon run"
        )
    group = file["farhorizon"]
    check_version(path, int(group.attrs["version"]), RESULTS_VERSION, "run the case again")
    return group


def table_names(file: Any) -> list[str]:
    """Names of the tables of a file."""
    return ["outputs", "history", "records", *(f"recorded/{name}" for name in file["farhorizon"].get("recorded", {}))]


def table_in(file: Any, name: str) -> Table:
    """A table of a file: its "outputs" with their fields (which in a file in parts each part has), the "history" of
    energy and balance, the "records" of the probes, those of a recorder under "recorded/NAME".

    The outputs have the numbers of rows of history and records that existed when they were appended.
    """
    vtk, group = file["VTKHDF"], file["farhorizon"]
    if name != "outputs":
        records = group[name]
        return Table({"times": records["times"], **records.get("data", records)}, records.attrs)
    fields = {} if "parts" in group else {name: data for name, data in vtk["PointData"].items() if name != FIELD}
    offsets = {f"offsets/{name}": data for name, data in vtk["Steps/PointDataOffsets"].items()}
    columns = {name: group[name] for name in ("steps", "history_rows", "record_rows")}
    return Table({"times": vtk["Steps/Values"], **columns, **offsets, **fields}, group.attrs, "outputs")


def counts_of(file: Any, path: Path) -> dict[str, int]:
    """Numbers of valid "outputs", rows of the "history" and "records" of the probes: the counted ones as far as the
    tables hold them; the last output, and what belongs to it, may be missing.
    """
    table = table_in(file, "outputs")
    counts = {"outputs": (outputs := table.held(path, max(table.counted - 1, 0)))}
    for name, noted in (("history", "history_rows"), ("records", "record_rows")):
        counts[name] = table_in(file, name).held(path, int(table.columns[noted][outputs - 1]) if outputs else 0)
    return counts


def list_outputs(file: Any, layout: Layout, path: Path, outputs: int) -> None:
    """Make VTK show the first outputs; in a file in parts, those of its parts.

    A single output is listed twice among VTK's steps, because vtkHDFReader takes a file with one step for a file
    without time, and fails.
    """
    steps, listed = file["VTKHDF/Steps"], 2 if outputs == 1 else outputs
    for dataset in (steps["Values"], *steps["PointDataOffsets"].values()):
        dataset.resize(listed, axis=0)
        if outputs == 1:
            dataset[1] = dataset[0]
    steps.attrs.modify("NSteps", listed)
    if len(layout.boxes):
        for name, components in layout.components.items():
            lay_out(file["VTKHDF/PointData"], name, path, layout.boxes, outputs, components > 1)


def vtk_shape(shape: tuple[int, ...], components: int) -> tuple[int, ...]:
    """Shape of one stored output: z, y, x, without slow axes that have a single node, which vtkHDFReader expects to be
    omitted; vectors have their components last.
    """
    while len(shape) > 1 and shape[-1] == 1:
        shape = shape[:-1]
    return shape[::-1] + ((3,) if components > 1 else ())


def make_field(data: Any, name: str, stored: tuple[int, ...], dtype: np.dtype, compress: bool) -> Any:
    """Create an empty dataset for a field whose outputs have the shape `stored`."""
    packed = {"compression": "gzip", "shuffle": True} if compress else {}
    return grow(data, name, dtype, stored, chunk_of(stored, dtype.itemsize), packed)


def chunk_of(shape: tuple[int, ...], itemsize: int) -> tuple[int, ...]:
    """Chunk for one output, halved along its slowest axes until it has at most 64 MiB."""
    chunk = [1, *shape]
    while int(np.prod(chunk)) * itemsize > _CHUNK_BYTES:
        axis = next(a for a in range(1, len(chunk)) if chunk[a] > 1)
        chunk[axis] = (chunk[axis] + 1) // 2
    return tuple(chunk)


def stored_boxes(boxes: Sequence[Box]) -> np.ndarray:
    """Boxes of parts as a layout has them."""
    return np.array(boxes, np.int64) if len(boxes) else np.zeros((0, 0, 2), np.int64)


class Regions(NamedTuple):
    """Regions of nodes of the same material."""

    numbers: np.ndarray  # of the lattice's shape, int32: each node's region, from 0 on; -1 where there is no node
    names: tuple[str, ...]  # of the materials, by number

    def __str__(self) -> str:
        """The largest regions with their numbers of nodes, and how many more there are."""
        counts = np.bincount(self.numbers[self.numbers >= 0], minlength=len(self.names))
        named = [f"{name} ({count} nodes)" for name, count in zip(self.names[:_NAMED], counts.tolist(), strict=False)]
        more = len(self.names) - _NAMED
        return "; ".join(named + [f"{more} more"] * (more > 0))

"""Layout of a results file, for the code that writes it and the code that reads it.

A results file is a VTKHDF ``ImageData`` file [1]_ with a temporal ``Steps`` group, so that ParaView opens it directly:
``/VTKHDF`` contains the fields as point data, one chunked record per output, in VTK's order (x fastest), on a lattice
padded to three dimensions. ``/farhorizon`` contains what VTK does not know: case text, program, lattice, step numbers,
the history of energy and balance, and, with times of their own, the records of the probes. Its attribute ``outputs``,
and the attributes ``rows`` of the history and of the records, say how many are valid; ``finished`` says whether the run
reached its end. Every dataset has a checksum (Fletcher 32) per chunk, and so has all metadata in HDF5's format 1.10.

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

import numpy as np

from farhorizon.errors import FileFormatError
from farhorizon.files.hdf5 import (
    check_version,
    copy_attributes,
    grow,
    put_fixed,
    read_rows,
    refuse_other_files,
    word_in,
    words_in,
)
from farhorizon.files.parts import Box, folder_of, lay_out, parts_of
from farhorizon.files.region_numbers import FIELD

FORMAT = "farhorizon results"
RESULTS_VERSION = 2
# Names that the Dataset of `Results.to_xarray` and the pictures of `farhorizon.pictures` use for other things.
RESERVED = frozenset(
    {
        "time",
        "step",
        FIELD,
        "x",
        "y",
        "z",
        "energy",
        "history_time",
        "probe",
        "probe_time",
        "probe_x",
        "probe_y",
        "probe_z",
        "probe_values",
        "probes",
    }
    | {"balance", "account", "component"}
)
_CHUNK_BYTES = 2**26


def check_format(file: Any, path: Path) -> Any:
    """Return the group ``/farhorizon`` of a results file; FileFormatError if the file is another program's or of
    another version.
    """
    refuse_other_files(file, path)
    if "farhorizon" not in file or word_in(file["farhorizon"].attrs, "format") != FORMAT or "VTKHDF" not in file:
        raise FileFormatError(
            f"{path} is an HDF5 file, but not a farhorizon results file", remedy="give a file written by farhorizon run"
        )
    group = file["farhorizon"]
    check_version(path, int(group.attrs["version"]), RESULTS_VERSION, "run the case again")
    return group


class Caution(NamedTuple):
    """The result of a run is doubtful from a time on; `brief` gives the reason in two or three words, `text` in a
    sentence.
    """

    time: float
    brief: str
    text: str


class Counts(NamedTuple):
    """Numbers of valid outputs, history rows and probe records."""

    outputs: int
    rows: int
    records: int


def counts_of(file: Any, path: Path) -> Counts:
    """Return the numbers of valid outputs, history rows and records: the counted ones, as far as all datasets hold
    them.

    Some datasets may lack the last output, or its history rows and records, because other programs that write such
    files are killed, too.
    """
    group, vtk = file["farhorizon"], file["VTKHDF"]

    def held(counted: int, least: int, datasets: Sequence[Any]) -> int:
        shortest = min(datasets, key=len)
        if not least <= min(counted, len(shortest)):
            raise FileFormatError(
                f"{path} is damaged: {shortest.name} is too short",
                value=len(shortest),
                limit=least,
                remedy="compute it again",
            )
        return min(counted, len(shortest))

    outputs = int(group.attrs["outputs"])
    fields = () if "parts" in group else fields_in(file)  # each part has its own
    per_output = vtk["Steps/Values"], group["steps"], group["history_rows"], group["record_rows"], *fields
    outputs = held(outputs, max(outputs - 1, 0), per_output)
    rows, records = (
        held(
            int(group[name].attrs["rows"]), int(group[noted][outputs - 1]) if outputs else 0, list(group[name].values())
        )
        for name, noted in (("history", "history_rows"), ("records", "record_rows"))
    )
    return Counts(outputs, rows, records)


def set_outputs(file: Any, path: Path, outputs: int) -> None:
    """Make the first `outputs` outputs the valid ones; in a file in parts, also those that are shown.

    A single output is listed twice among VTK's steps, because vtkHDFReader takes a file with one step for a file
    without time, and fails.
    """
    steps, listed = file["VTKHDF/Steps"], 2 if outputs == 1 else outputs
    for dataset in (steps["Values"], *steps["PointDataOffsets"].values()):
        dataset.resize(listed, axis=0)
        if outputs == 1:
            dataset[1] = dataset[0]
    steps.attrs.modify("NSteps", listed)
    file["farhorizon"].attrs.modify("outputs", outputs)
    if (boxes := boxes_in(file["farhorizon"], path)).size:
        for name, components in components_in(file["farhorizon"]).items():
            lay_out(file["VTKHDF/PointData"], name, path, boxes, outputs, components > 1)


def fields_in(file: Any) -> list[Any]:
    """The datasets of the fields, which grow by a row per output; that of the regions does not."""
    return [dataset for name, dataset in file["VTKHDF/PointData"].items() if name != FIELD]


def boxes_in(group: Any, path: Path) -> np.ndarray:
    """Boxes of the parts of a results file, shape (parts, dim, 2); empty if it has no parts."""
    return read_rows(group, path, "parts") if "parts" in group else np.zeros((0, 0, 2), np.int64)


def put_boxes(group: Any, boxes: Sequence[Box]) -> None:
    """Store the boxes of the parts."""
    put_fixed(group, "parts", np.array(boxes, np.int64))


def vtk_shape(shape: tuple[int, ...], components: int) -> tuple[int, ...]:
    """Shape of one stored output: z, y, x, without slow axes that have a single node, which vtkHDFReader expects to be
    omitted; vectors have their components last.
    """
    while len(shape) > 1 and shape[-1] == 1:
        shape = shape[:-1]
    return shape[::-1] + ((3,) if components > 1 else ())


def chunk_of(shape: tuple[int, ...], itemsize: int) -> tuple[int, ...]:
    """Chunk for one output, halved along its slowest axes until it has at most 64 MiB."""
    chunk = [1, *shape]
    while int(np.prod(chunk)) * itemsize > _CHUNK_BYTES:
        axis = next(a for a in range(1, len(chunk)) if chunk[a] > 1)
        chunk[axis] = (chunk[axis] + 1) // 2
    return tuple(chunk)


def components_in(group: Any) -> dict[str, int]:
    """Number of components of each field of a results file; 1 if the file does not say."""
    names = words_in(group, "fields")
    return dict(
        zip(names, (int(n) for n in np.broadcast_to(group.attrs.get("components", 1), len(names))), strict=True)
    )


def probe_components_in(group: Any) -> int:
    """Number of components of the values at the probes; that of the first field if the file does not say."""
    return int(group.attrs.get("probe_components", next(iter(components_in(group).values()))))


def make_field(data: Any, name: str, stored: tuple[int, ...], dtype: np.dtype, compress: bool) -> Any:
    """Create an empty dataset for a field whose outputs have the shape `stored`."""
    packed = {"compression": "gzip", "compression_opts": 4, "shuffle": True} if compress else {}
    return grow(data, name, dtype, stored, chunk_of(stored, dtype.itemsize), packed)


def make_room(path: Path, parts: int) -> None:
    """Create the folder for the parts of a new results file, and remove surplus parts of the one that it replaces;
    without parts, the folder is removed if it is empty.
    """
    if parts:
        folder_of(path).mkdir(exist_ok=True)
    for one in parts_of(path):
        if int(one.stem) >= parts:
            one.unlink()
    if not parts and folder_of(path).is_dir() and not any(folder_of(path).iterdir()):
        folder_of(path).rmdir()


def copied_data(source: Any, file: Any) -> Any:
    """Copy the group of point data of another file without its fields."""
    made = file.create_group(source.name)
    copy_attributes(source, made)
    if FIELD in source:
        source.copy(FIELD, made)
    return made

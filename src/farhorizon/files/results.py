"""The results file and the checkpoint.

A results file is a VTKHDF ``ImageData`` file [1]_ with a temporal ``Steps`` group, so that ParaView opens it as it is:
``/VTKHDF`` holds the fields as point data, one chunked record an output, in VTK's order (x fastest), on a lattice
padded to three dimensions. ``/farhorizon`` holds what VTK does not know: case text, program, lattice, step numbers, the
history of energy and balance, and, with times of their own, the records of the probes. Its attribute ``outputs``, and
``rows`` of the history and of the records, say how many are valid, ``finished`` whether the run came to its end.  Every
dataset has a check sum a chunk (Fletcher 32), and so has, in HDF5's format 1.10, all that HDF5 notes about it.

A checkpoint is its own HDF5 file: an index (JSON, with the SHA-256 of every array), the arrays, and a flag that is
written last.

Both are written by `farhorizon.files.storage`: a process that is killed, or a disk that is full, leaves the file as it
was before. Several processes write a file in parts, see `farhorizon.files.parts`.

References
----------
.. [1] VTKHDF file format, https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/vtkhdf_specifications.html
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import h5py
import numpy as np

from farhorizon import kinds
from farhorizon.errors import FarhorizonError, FileFormatError, InputError
from farhorizon.files.parts import Box, folder_of, is_own, lay_out, part_path, parts_of
from farhorizon.files.polylines import Lines, flattened, gathered, write_vtp
from farhorizon.files.records import Recorded, dataset_parts, measured_in, spectra_of
from farhorizon.files.region_numbers import FIELD, OUTSIDE, Regions
from farhorizon.files.storage import Draft, changing, created, read

if TYPE_CHECKING:
    import xarray

FORMAT = "farhorizon results"
CHECKPOINT_FORMAT = "farhorizon checkpoint"
VERSION = 2  # of a checkpoint
RESULTS_VERSION = 2
# Names that the Dataset of `Results.to_xarray` and the pictures of `farhorizon.pictures` use for something else.
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
_CHUNK_ROWS = 512
_DEPTH = 5  # of groups in each other, in any file of ours


def _hdf5(path: Path | Draft, mode: str) -> Any:
    """Open an HDF5 file; what is written into it has the format of HDF5 1.10, which has check sums.

    File locks are off, so that someone who looks at a file with another program cannot stop the run that writes it.
    """
    return h5py.File(path, mode, locking=False, libver=("v110", "v110"))


@contextmanager
def _opened(path: Path, mode: str, what: str) -> Iterator[Any]:
    """Open an HDF5 file, "r" or "r+"; whatever HDF5 cannot read becomes a FileFormatError."""
    if not path.is_file():
        raise InputError(f"{path}: no such file", remedy=f"give the path of a {what}")
    try:
        if not h5py.is_hdf5(path):
            raise FileFormatError(
                f"{path} is not an HDF5 file, or its beginning is damaged", remedy=f"give the path of a {what}"
            )
        with (read if mode == "r" else changing)(path) as draft, _hdf5(path if draft is None else draft, mode) as file:
            yield file
    except FarhorizonError:
        raise
    except PermissionError as error:
        raise InputError(f"{path}: permission denied", remedy="change the permissions or use another path") from error
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError, MemoryError) as error:
        # Python's own system errors (disk full, ...) carry an errno and say nothing about the file's format.
        if isinstance(error, OSError) and error.errno is not None and mode != "r":
            raise
        raise FileFormatError(
            f"{path} is truncated or damaged ({error})", remedy=f"use another {what}, or compute it again"
        ) from error


def _refuse_other_files(group: Any, path: Path, depth: int = 0) -> None:
    """FileFormatError if something that a file seems to hold stands elsewhere: ours have no links, and another file's
    content may be secret.
    """
    for name in group:
        item = group[name] if isinstance(group.get(name, getlink=True), h5py.HardLink) and depth < _DEPTH else None
        if item is None or (isinstance(item, h5py.Dataset) and _lies_elsewhere(item, path)):
            raise FileFormatError(
                f"{path}: {group.name.rstrip('/')}/{name} refers to another place or file, as nothing that we write "
                "does",
                remedy="use a file of a known origin; one in parts keeps its name, that of its folder",
            )
        if isinstance(item, h5py.Group):
            _refuse_other_files(item, path, depth + 1)


def _lies_elsewhere(item: Any, path: Path) -> bool:
    return bool(item.external) or (item.is_virtual and not is_own(item, path))


def _read_indices(group: Any) -> None:
    """Read where the chunks of all datasets lie; OSError if the check sum of an index fails."""
    for item in group.values():
        if isinstance(item, h5py.Group):
            _read_indices(item)
        elif item.chunks is not None:
            item.id.get_num_chunks()


def _read(file: Any, path: Path, name: str, rows: Any = ()) -> np.ndarray:
    """Rows of a dataset; FileFormatError names the one that fails its check sum."""
    try:
        return np.asarray(file[name][rows])
    except OSError as error:
        remedy = "compute it again, or resume the run from a checkpoint before it"
        raise FileFormatError(f"{path} is damaged: {name} fails its check sum", remedy=remedy) from error


def _read_spectrum(file: Any, path: Path, name: str) -> np.ndarray:
    """A spectrum: complex, and so are all those of files that do not say, or real."""
    values = _read(file, path, name)
    return values if file[name].attrs.get("real", False) else np.asarray(values[0] + 1j * values[1])


def _directory_of(path: Path) -> Path:
    """Directory that a new file shall stand in; InputError if there is none."""
    if path.is_dir():
        raise InputError(f"{path} is a directory", remedy="give the path of a file")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no directory {path.parent}", remedy="create it first")
    return path.parent


def _check_format(file: Any, path: Path) -> Any:
    """Return the group ``/farhorizon`` of a results file; FileFormatError if the file is another program's or a later
    version's.
    """
    _refuse_other_files(file, path)
    if "farhorizon" not in file or _word(file["farhorizon"].attrs, "format") != FORMAT or "VTKHDF" not in file:
        raise FileFormatError(
            f"{path} is an HDF5 file, but not a farhorizon results file", remedy="give a file written by farhorizon run"
        )
    group = file["farhorizon"]
    _check_version(path, int(group.attrs["version"]), RESULTS_VERSION, "run the case again")
    return group


def _check_version(path: str | Path, version: int, known: int, older: str) -> None:
    """FileFormatError of a version other than the known one, with what to do about an older one."""
    if version != known:
        raise FileFormatError(
            f"{path} has {'an older' if version < known else 'a newer'} format",
            value=version,
            limit=known,
            remedy=older if version < known else "update farhorizon",
        )


class Caution(NamedTuple):
    """From a time on the result of a run is doubtful: in two or three words, and in a sentence."""

    time: float
    brief: str
    text: str


class Counts(NamedTuple):
    """Valid outputs, history rows and records of the probes."""

    outputs: int
    rows: int
    records: int


def _counts(file: Any, path: Path) -> Counts:
    """Return the numbers of valid outputs, history rows and records: of what is counted as much as all datasets hold.

    The last output, and its history rows and records, may be missing from some of them, for other programs that write
    such files are killed too.
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
    fields = () if "parts" in group else _changing(file)  # of parts each knows its own
    per_output = vtk["Steps/Values"], group["steps"], group["history_rows"], group["record_rows"], *fields
    outputs = held(outputs, max(outputs - 1, 0), per_output)
    rows, records = (
        held(
            int(group[name].attrs["rows"]), int(group[noted][outputs - 1]) if outputs else 0, list(group[name].values())
        )
        for name, noted in (("history", "history_rows"), ("records", "record_rows"))
    )
    return Counts(outputs, rows, records)


def _set_outputs(file: Any, path: Path, outputs: int) -> None:
    """Make the first `outputs` outputs the valid ones, in a file in parts those that are shown.

    A single output is listed twice among VTK's steps: vtkHDFReader takes a file of one step for a file without time,
    and fails.
    """
    steps, listed = file["VTKHDF/Steps"], 2 if outputs == 1 else outputs
    for dataset in (steps["Values"], *steps["PointDataOffsets"].values()):
        dataset.resize(listed, axis=0)
        if outputs == 1:
            dataset[1] = dataset[0]
    steps.attrs.modify("NSteps", listed)
    file["farhorizon"].attrs.modify("outputs", outputs)
    if (boxes := _boxes(file["farhorizon"], path)).size:
        for name, components in _components(file["farhorizon"]).items():
            lay_out(file["VTKHDF/PointData"], name, path, boxes, outputs, components > 1)


def _changing(file: Any) -> list[Any]:
    """The datasets of the fields, which grow by a row an output; those of regions do not."""
    return [dataset for name, dataset in file["VTKHDF/PointData"].items() if name != FIELD]


def _put_regions(vtk: Any, group: Any, regions: Regions, shape: tuple[int, ...]) -> None:
    """Keep the regions as the point data of every output: a single row, at which all outputs point."""
    stored = _vtk_shape(shape, 1)
    values = np.asarray(regions.numbers, np.int32).T.reshape(1, *stored)
    options = {"chunks": _chunk(stored, 4), "fletcher32": True, "compression": "gzip", "shuffle": True}
    vtk["PointData"].create_dataset(FIELD, data=values, **options)
    _growing(vtk["Steps/PointDataOffsets"], FIELD, "i8")
    _put_words(group, "regions", regions.names)


def _boxes(group: Any, path: Path) -> np.ndarray:
    """The boxes of the parts of a results file, shape (parts, dim, 2); of none where it has no parts."""
    return _read(group, path, "parts") if "parts" in group else np.zeros((0, 0, 2), np.int64)


def _cut_recorded(file: Any, path: Path, outputs: int, wanted: Mapping[str, int]) -> None:
    """Cut off what recorders have recorded after an output, or beyond the rows that are wanted."""
    end = float(file["VTKHDF/Steps/Values"][outputs - 1]) if outputs else -np.inf
    for name, group in file["farhorizon"].get("recorded", {}).items():
        held = int(group.attrs["rows"])
        rows = wanted.get(name, int(np.searchsorted(group["times"][:held], end, side="right")))
        if rows > held:
            raise FileFormatError(
                f"{path} holds fewer rows of {name} than the checkpoint counts",
                value=held,
                limit=rows,
                remedy="use the results file that belongs to the checkpoint, or start the run anew",
            )
        group.attrs.modify("rows", rows)
        for dataset in (group["times"], *group["data"].values()):
            dataset.resize(rows, axis=0)


def _vtk_shape(shape: tuple[int, ...], components: int) -> tuple[int, ...]:
    """Shape of one stored output: z, y, x, without the slow axes that have a single node, for vtkHDFReader expects them
    left out; vectors last.
    """
    while len(shape) > 1 and shape[-1] == 1:
        shape = shape[:-1]
    return shape[::-1] + ((3,) if components > 1 else ())


def _chunk(shape: tuple[int, ...], itemsize: int) -> tuple[int, ...]:
    """Chunk of one output, halved along its slowest axes until it holds no more than 64 MiB."""
    chunk = [1, *shape]
    while int(np.prod(chunk)) * itemsize > _CHUNK_BYTES:
        axis = next(a for a in range(1, len(chunk)) if chunk[a] > 1)
        chunk[axis] = (chunk[axis] + 1) // 2
    return tuple(chunk)


def _words(group: Any, name: str) -> tuple[str, ...]:
    """Texts in a dataset; none if it is not there."""
    return tuple(text.decode() for text in np.ravel(group[name][()])) if name in group else ()


def _put_words(group: Any, name: str, words: Sequence[str]) -> None:
    """Keep texts; they have a fixed length, since those of variable length have no check sum."""
    encoded = [word.encode() for word in words]
    dtype = h5py.string_dtype("utf-8", max(1, *map(len, encoded)))
    _put_fixed(group, name, np.array(encoded, dtype))


def _word(attributes: Any, name: str) -> str:
    """A text among attributes; empty if it is not there."""
    text = attributes.get(name, b"")
    return text.decode(errors="replace") if isinstance(text, bytes) else str(text)


def _put_word(attributes: Any, name: str, word: str) -> None:
    """Keep a text of fixed length among attributes: damage where HDF5 keeps those of variable length makes it hang or
    crash.
    """
    encoded = word.encode()
    attributes.create(name, encoded, dtype=h5py.string_dtype("utf-8", max(1, len(encoded))))


def _put_fixed(group: Any, name: str, values: np.ndarray) -> None:
    """Keep an array that does not grow."""
    checked = {"chunks": values.shape, "fletcher32": True} if values.size else {}
    group.create_dataset(name, data=values, dtype=values.dtype, **checked)


def _components(group: Any) -> dict[str, int]:
    """Components of each field of a results file; 1 in files that do not say."""
    names = _words(group, "fields")
    return dict(
        zip(names, (int(n) for n in np.broadcast_to(group.attrs.get("components", 1), len(names))), strict=True)
    )


def _probe_components(group: Any) -> int:
    """Components of the values at the probes; those of the first field in files that do not say."""
    return int(group.attrs.get("probe_components", next(iter(_components(group).values()))))


def _growing(group: Any, name: str, dtype: str) -> None:
    """Make an empty column that grows by rows."""
    group.create_dataset(name, (0,), dtype, maxshape=(None,), chunks=(_CHUNK_ROWS,), fletcher32=True)


def _put(dataset: Any, start: int, values: Any) -> None:
    """Write `values` from row `start` on; rows that stood there or beyond are replaced."""
    stop = start + len(values)
    dataset.resize(stop, axis=0)
    dataset[start:stop] = values


def _grow_fields(data: Any, name: str, stored: tuple[int, ...], dtype: np.dtype, compress: bool) -> Any:
    """Make an empty dataset of a field whose outputs have this shape."""
    packed = {"compression": "gzip", "compression_opts": 4, "shuffle": True} if compress else {}
    chunk = _chunk(stored, dtype.itemsize)
    return data.create_dataset(
        name, (0, *stored), dtype, maxshape=(None, *stored), chunks=chunk, fletcher32=True, **packed
    )


def _make_room(path: Path, parts: int) -> None:
    """Make the folder for so many parts of a new results file, and remove parts of the one whose place it takes; none
    is left without any.
    """
    if parts:
        folder_of(path).mkdir(exist_ok=True)
    for one in parts_of(path):
        if int(one.stem) >= parts:
            one.unlink()
    if not parts and folder_of(path).is_dir() and not any(folder_of(path).iterdir()):
        folder_of(path).rmdir()


def _copy_attributes(source: Any, target: Any) -> None:
    for name, value in source.attrs.items():
        target.attrs.create(name, value, dtype=source.attrs.get_id(name).dtype)


def _copied_data(source: Any, file: Any) -> Any:
    """The point data of another file without its fields."""
    made = file.create_group(source.name)
    _copy_attributes(source, made)
    if FIELD in source:
        source.copy(FIELD, made)
    return made


def _copy_all_but(source: Any, target: Any, left_out: set[str]) -> None:
    """Copy what is in a group, with all that HDF5 notes of it, but for some places."""
    _copy_attributes(source, target)
    for name, item in source.items():
        if item.name in left_out:
            continue
        if any(place.startswith(f"{item.name}/") for place in left_out):
            _copy_all_but(item, target.create_group(name), left_out)
        else:
            source.copy(item, target, name)


def check_replaceable(path: Path) -> None:
    """Refuse to put new results where something else is than results of ours, or nothing.

    Raises
    ------
    InputError
        Another file, or one that may not be written, also among its parts; no such folder.
    """
    _directory_of(path)
    for one in parts_of(path):
        check_replaceable(one)
    if not path.exists():
        return
    if not os.access(path, os.W_OK):
        raise InputError(f"{path}: permission denied", remedy="change the permissions or use another path")
    try:
        with _opened(path, "r", "results file") as file:
            _check_format(file, path)
    except FileFormatError as error:
        remedy = "move or delete it, or choose another path"
        raise InputError(
            f"{path} exists, is not a whole results file of ours, and is not overwritten", remedy=remedy
        ) from error


class ResultsWriter:
    """Appends outputs to a results file; the file is closed between the calls.

    Use `create` or `resume`.  Every call opens the file, appends and closes it; a killed process leaves a file with or
    without what was appended.

    Parameters
    ----------
    path : str or Path
        An existing results file.

    Attributes
    ----------
    path : Path
    outputs, rows, records : int
        Valid outputs, history rows and records of the probes so far; a checkpoint has them, and `resume` takes them.
    fields : tuple of str
    shape : tuple of int
        Lattice shape (nx[, ny[, nz]]).
    components : dict of str to int
        Of each field.
    recorded : dict of str to int
        Valid rows of each recorder.
    whole : bool
        Whether the fields stand in the file itself, and not in parts.
    last_step : int or None
        Step number of the last output; None without any.

    Raises
    ------
    FileFormatError
        The file is truncated, damaged or not ours.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        with _opened(self.path, "r", "results file") as file:
            group = _check_format(file, self.path)
            self.shape: tuple[int, ...] = tuple(int(n) for n in group.attrs["shape"])
            self.fields: tuple[str, ...] = _words(group, "fields")
            self.outputs, self.rows, self.records = _counts(file, self.path)
            self.components = _components(group)
            width = _probe_components(group)
            self._probes = (group["probes"].shape[0], *((width,) if width > 1 else ()))
            self.accounts = _words(group, "accounts")
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
        """Create an empty results file; an older results file of that name is replaced, with its parts, any other file
        is refused.

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
            Names of the fields; `append` wants them all.
        dtype : dtype
            float32 or float64, of the stored fields.
        probes : ndarray, shape (n, dim), optional
            Positions of the probes.
        accounts : sequence of str
            Names of the entries of a balance, which each `append` is to give.
        case : str
            Text of the case file.
        program : str
            Name and version of the program.
        components : int or mapping of str to int
            1, or dim for vector fields. VTK's vectors have three, the missing ones are stored as zeros. Probes show
            the field u if it is named, written or not, else the first one.
        units : mapping of str to str, optional
            Units of "length", "time" and fields, as far as they are known.
        provenance : mapping of str to str, optional
            What the file comes from: command, machine, versions.
        compress : bool
            Pack the fields, without loss.
        outlines : mapping of str to sequence of ndarray, each of shape (n, dim), optional
            Polylines by what they show: "cracks", "near field", "layers".
        regions : Regions, optional
            Of what the nodes are made; nothing where one medium fills the lattice.
        boxes : sequence of Box
            Of a file in parts, whose files (`farhorizon.files.parts.part_path`) others create and append to; a folder
            for them is made.

        Returns
        -------
        ResultsWriter

        Raises
        ------
        InputError
            An argument is wrong, `path` holds another file, or one that may not be written.
        """
        path = Path(path)
        check_replaceable(path)
        dtype = np.dtype(dtype)
        if dtype not in (np.dtype("float32"), np.dtype("float64")):
            raise InputError(
                "results are stored in single or double precision", value=dtype, remedy="use float32 or float64"
            )
        shape, origin = tuple(int(n) for n in shape), tuple(float(v) for v in lower)
        dim = len(shape)
        if dim not in (1, 2, 3) or len(origin) != dim or min(shape) < 1:
            raise InputError(
                "shape has one to three entries, all positive, and lower as many",
                value=f"shape {shape}, lower {origin}",
            )
        if not np.isfinite(spacing) or spacing <= 0:
            raise InputError("the spacing is a positive number", value=spacing)
        for name in fields:
            if not name or name in RESERVED or "/" in name or name.startswith("."):
                remedy = f"use a name without '/', not beginning with '.', and none of {', '.join(sorted(RESERVED))}"
                raise InputError(
                    "this name cannot be used for a field in a results file", value=repr(name), remedy=remedy
                )
        if not fields or len(set(fields)) != len(fields):
            remedy = "name one or more, each once"
            raise InputError("fields are one or more different names", value=fields, key="fields", remedy=remedy)
        places = np.zeros((0, dim)) if probes is None else np.asarray(probes, dtype=float)
        if places.ndim != 2 or places.shape[1] != dim:
            raise InputError("probes have the shape (n, dim)", value=places.shape, limit=f"(n, {dim})")
        width = dict.fromkeys(fields, components) if isinstance(components, int) else dict(components)
        probed_width = width.get("u", width[fields[0]])
        if not {width[name] for name in fields} <= {1, 2, 3}:
            raise InputError("fields in results files have up to three components", value=components, limit="1 to 3")
        padded = (*shape, 1, 1)[:3]
        with created(path) as draft, _hdf5(draft, "w") as file:
            vtk = file.create_group("VTKHDF")
            vtk.attrs["Version"] = np.array([2, 0])
            vtk.attrs.create("Type", b"ImageData", dtype=h5py.string_dtype("ascii", len("ImageData")))
            vtk.attrs["WholeExtent"] = np.array([0, padded[0] - 1, 0, padded[1] - 1, 0, padded[2] - 1])
            vtk.attrs["Origin"] = np.array((*origin, 0.0, 0.0)[:3])
            vtk.attrs["Spacing"] = np.full(3, float(spacing))
            vtk.attrs["Direction"] = np.eye(3).ravel()
            steps, data = vtk.create_group("Steps"), vtk.create_group("PointData")
            steps.attrs["NSteps"] = 0
            _growing(steps, "Values", "f8")
            offsets = steps.create_group("PointDataOffsets")
            for name in fields:
                stored = _vtk_shape(shape, width[name])
                if len(boxes):
                    data.create_dataset(name, (0, *stored), dtype)
                else:
                    _grow_fields(data, name, stored, dtype, compress)
                _growing(offsets, name, "i8")
                kind = "Scalars" if width[name] == 1 else "Vectors"
                if kind not in data.attrs:
                    _put_word(data.attrs, kind, name)
            group = file.create_group("farhorizon")
            told = {name: json.dumps(dict(one or {})) for name, one in (("units", units), ("provenance", provenance))}
            for name, word in {"format": FORMAT, "program": program, "cautions": "[]", **told}.items():
                _put_word(group.attrs, name, word)
            group.attrs["version"], group.attrs["finished"] = RESULTS_VERSION, False
            group.attrs["dim"], group.attrs["shape"], group.attrs["spacing"], group.attrs["lower"] = (
                dim,
                shape,
                float(spacing),
                origin,
            )
            group.attrs["components"], group.attrs["probe_components"] = [width[name] for name in fields], probed_width
            group.attrs["outputs"] = 0
            if len(boxes):
                _put_fixed(group, "parts", np.array(boxes, np.int64))
            _put_words(group, "case", [case])
            _put_words(group, "fields", fields)
            _put_fixed(group, "probes", places)
            points, counts, names = flattened(outlines or {})
            shown = group.create_group("outlines")
            _put_fixed(shown, "points", points)
            _put_fixed(shown, "counts", counts)
            if names:
                _put_words(shown, "names", names)
            if regions is not None:
                _put_regions(vtk, group, regions, shape)
            _growing(group, "steps", "i8")
            _growing(group, "history_rows", "i8")
            _growing(group, "record_rows", "i8")
            history = group.create_group("history")
            history.attrs["rows"] = 0
            _growing(history, "times", "f8")
            _growing(history, "energy", "f8")
            records = group.create_group("records")
            records.attrs["rows"] = 0
            _growing(records, "times", "f8")
            if len(places):
                probed = () if probed_width == 1 else (probed_width,)
                records.create_dataset(
                    "values",
                    (0, len(places), *probed),
                    "f8",
                    maxshape=(None, len(places), *probed),
                    chunks=(_CHUNK_ROWS, min(len(places), 64), *probed),
                    fletcher32=True,
                )
            if accounts:
                _put_words(group, "accounts", accounts)
                history.create_dataset(
                    "balance",
                    (0, len(accounts)),
                    "f8",
                    maxshape=(None, len(accounts)),
                    chunks=(_CHUNK_ROWS, len(accounts)),
                    fletcher32=True,
                )
        _make_room(path, len(boxes))
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
        """Take up a results file after its first `outputs` outputs; later ones, their history and their records, are
        cut off.

        Parameters
        ----------
        path : str or Path
        outputs : int
            Outputs to keep, as the checkpoint recorded them.
        rows, records : int, optional
            History rows and records of the probes to keep; as many as there were when the last kept output was
            appended, unless given.
        recorded : mapping of str to int, optional
            Rows of each recorder to keep; those up to the last kept output unless given.

        Returns
        -------
        ResultsWriter

        Raises
        ------
        InputError
            A count is negative.
        FileFormatError
            The file is truncated, damaged, not ours, or holds fewer outputs or rows than asked for.
        """
        path = Path(path)
        if min(outputs, rows or 0, records or 0) < 0:
            raise InputError(
                "the numbers of outputs, history rows and records to keep are not negative",
                value=(outputs, rows, records),
                limit=0,
            )
        # HDF5 crashes where it meets damage of an index that it changes
        with _opened(path, "r", "results file") as file:
            _read_indices(_check_format(file, path).parent)
        with _opened(path, "r+", "results file") as file:
            group = _check_format(file, path)
            held = _counts(file, path)
            if outputs <= held.outputs:
                rows = (int(group["history_rows"][outputs - 1]) if outputs else 0) if rows is None else rows
                records = (int(group["record_rows"][outputs - 1]) if outputs else 0) if records is None else records
            for what, there, wanted in zip(
                ("outputs", "history rows", "records"), held, (outputs, rows, records), strict=True
            ):
                if wanted is not None and wanted > there:
                    raise FileFormatError(
                        f"{path} holds fewer {what} than the checkpoint counts",
                        value=there,
                        limit=wanted,
                        remedy="use the results file that belongs to the checkpoint, or start the run anew",
                    )
            _cut_recorded(file, path, outputs, recorded or {})
            _set_outputs(file, path, outputs)
            group["history"].attrs.modify("rows", rows)
            group["records"].attrs.modify("rows", records)
            group.attrs["finished"] = False
            fields = () if "parts" in group else _changing(file)
            for dataset in (group["steps"], group["history_rows"], group["record_rows"], *fields):
                dataset.resize(outputs, axis=0)
            for dataset in group["history"].values():
                dataset.resize(rows, axis=0)
            for dataset in group["records"].values():
                dataset.resize(records, axis=0)
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
            Step number, larger than that of the output before.
        time : float
        fields : mapping of str to ndarray, each of the lattice shape, of vectors with the components first
            Every field that the file was created with, none of a file in parts; nan (outside a window) stays nan.
        energy : float, optional
        balance : mapping of str to float, optional
            Every entry that the file was created with; others are left out.
        cautions : sequence of Caution
            All so far.

        Raises
        ------
        InputError
            A field is missing, unknown or of the wrong shape, or the step number does not grow.
        FileFormatError
            The file has been damaged since the last call.
        """
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
        history = None
        if energy is not None or balance is not None:
            entries = [np.nan if balance is None else balance[name] for name in self.accounts]
            history = {"times": [time], "energy": [np.nan if energy is None else energy], "balance": [entries]}
        n = self.outputs
        rows = self.rows + (0 if history is None else 1)
        with _opened(self.path, "r+", "results file") as file:
            if history is not None:
                for name, dataset in file["farhorizon/history"].items():
                    _put(dataset, self.rows, history[name])
                file["farhorizon/history"].attrs.modify("rows", rows)
            vtk, group = file["VTKHDF"], file["farhorizon"]
            for name in held:
                dataset = vtk["PointData"][name]
                values = np.asarray(fields[name]).T.astype(dataset.dtype, order="C", copy=False)
                if self.components[name] > 1:
                    values = np.pad(values, [(0, 0)] * len(self.shape) + [(0, 3 - self.components[name])])
                _put(dataset, n, values.reshape(1, *dataset.shape[1:]))
            for name, offsets in vtk["Steps/PointDataOffsets"].items():
                _put(offsets, n, [0 if name == FIELD else n])
            _put(vtk["Steps/Values"], n, [time])
            _put(group["steps"], n, [step])
            _put(group["history_rows"], n, [rows])
            _put(group["record_rows"], n, [self.records])
            _put_word(group.attrs, "cautions", json.dumps(list(cautions)))
            _set_outputs(file, self.path, n + 1)
        self.outputs, self.rows, self.last_step = n + 1, rows, int(step)

    def finish(self) -> None:
        """Note that the run came to its end; `resume` takes that back."""
        with _opened(self.path, "r+", "results file") as file:
            file["farhorizon"].attrs["finished"] = True

    def hold(self, records: Recorded) -> None:
        """Make room for the records of a recorder, of which this has the first ones or none.

        Raises
        ------
        InputError
            There is one of this name, or the names of xarray would collide.
        """
        if records.name in self.recorded or records.name in (*RESERVED, *self.fields):
            raise InputError(
                "the results have something else of this name", value=records.name, key="name", remedy="another name"
            )
        with _opened(self.path, "r+", "results file") as file:
            group = file["farhorizon"].require_group("recorded").create_group(records.name)
            group.attrs["rows"], group.attrs["directions"] = 0, records.directions
            group.attrs["medium"] = records.medium
            _put_fixed(group, "points", np.asarray(records.points, float))
            _put_fixed(group, "frequencies", np.asarray(records.frequencies, float))
            _growing(group, "times", "f8")
            rows, spectra = (group.create_group(one, track_order=True) for one in ("data", "spectra"))
            for name, values in records.data.items():
                width = values.shape[1:]
                chunk = (max(1, _CHUNK_ROWS // max(1, int(np.prod(width)) // 64)), *width)
                rows.create_dataset(name, (0, *width), "f8", maxshape=(None, *width), chunks=chunk, fletcher32=True)
            for name, values in records.spectra.items():
                real = np.isrealobj(values)
                _put_fixed(spectra, name, np.zeros(values.shape if real else (2, *values.shape)))
                spectra[name].attrs["real"] = real
        self.recorded[records.name] = 0

    def conclude(self, records: Recorded) -> None:
        """Keep what follows from all that was recorded, in place of what followed from an earlier end of the run.

        Raises
        ------
        InputError
            As `hold`.
        """
        if self.recorded.pop(records.name, None) is not None:
            with _opened(self.path, "r+", "results file") as file:
                del file["farhorizon/recorded"][records.name]
        self.hold(records)
        self.append_recorded(records)

    def append_recorded(self, records: Recorded) -> None:
        """Append the rows that this has, and put its spectra in place of those before.

        Raises
        ------
        FileFormatError
            The file has been damaged since the last call.
        """
        with _opened(self.path, "r+", "results file") as file:
            group, first = file["farhorizon/recorded"][records.name], self.recorded[records.name]
            if len(records.times):
                _put(group["times"], first, records.times)
                for name, values in records.data.items():
                    _put(group["data"][name], first, values)
                group.attrs.modify("rows", first + len(records.times))
            for name, values in records.spectra.items():
                group["spectra"][name][...] = values if np.isrealobj(values) else [values.real, values.imag]
        self.recorded[records.name] = first + len(records.times)

    def append_probes(self, times: np.ndarray, values: np.ndarray) -> None:
        """Append records of the probes, whose times are their own.

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
        with _opened(self.path, "r+", "results file") as file:
            records = file["farhorizon/records"]
            _put(records["times"], self.records, times)
            _put(records["values"], self.records, values)
            records.attrs.modify("rows", self.records + times.size)
        self.records += times.size


class Results:
    """A results file; the file is opened at each access only, so it may still grow.

    Parameters
    ----------
    path : str or Path

    Attributes
    ----------
    path : Path
    dim : int
    shape : tuple of int
        Nodes along x[, y[, z]].
    spacing : float
    lower : tuple of float
        Coordinates of the first node.
    field_names : tuple of str
    components : dict of str to int
        Of each field: 1, or dim of vectors.
    probes : ndarray, shape (n, dim)
        Positions of the probes.
    case, program : str
        Text of the case file; name and version of the program that wrote the file.
    units : dict of str to str
        Units of "length", "time", "u" and "v", as far as the case says them.
    provenance : dict of str to str
        Command, machine and versions that it comes from, of runs of the command line.
    finished : bool
        Whether the run had come to its end when the file was opened.
    outlines : dict of str to list of ndarray, each of shape (n, dim)
        Lines to be shown: "cracks" as they were given, in space their rims; the edges of the "near field" and, where
        something is computed beyond it, of the "layers".
    region_names : tuple of str
        Of what the nodes of each of the `regions` are made; empty where one medium fills the lattice.

    Raises
    ------
    InputError
        There is no such file.
    FileFormatError
        The file is truncated, damaged or not a farhorizon results file.  Any access may raise this, and names the
        dataset that fails its check sum.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        with _opened(self.path, "r", "results file") as file:
            group = _check_format(file, self.path)
            _counts(file, self.path)
            self.dim = int(group.attrs["dim"])
            self.shape: tuple[int, ...] = tuple(int(n) for n in group.attrs["shape"])
            self.spacing = float(group.attrs["spacing"])
            self.lower: tuple[float, ...] = tuple(float(v) for v in group.attrs["lower"])
            self.field_names: tuple[str, ...] = _words(group, "fields")
            self.probes: np.ndarray = _read(group, self.path, "probes")
            self.case: str = _words(group, "case")[0]
            self.program = _word(group.attrs, "program")
            self.units, self.provenance = (
                dict[str, str](json.loads(_word(group.attrs, name) or "{}")) for name in ("units", "provenance")
            )
            self.finished = bool(group.attrs.get("finished", False))
            self.outlines: dict[str, list[np.ndarray]] = {}
            if "outlines" in group:
                shown = group["outlines"]
                points, counts = (_read(shown, self.path, name) for name in ("points", "counts"))
                self.outlines = gathered(points, counts, _words(shown, "names"))
            self.region_names = _words(group, "regions")
            self._accounts = _words(group, "accounts")
            self._boxes, self._parts = _boxes(group, self.path), dict[int, Results]()
            self.components = _components(group)
            for name in self.field_names:
                stored = file["VTKHDF/PointData"][name].shape[1:]
                if stored != _vtk_shape(self.shape, self.components[name]):
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
        """The boxes of the parts: along each axis the first node and the last + 1; empty where the file has none."""
        return [[(int(first), int(last)) for first, last in box] for box in self._boxes]

    def _output_rows(self, name: str) -> np.ndarray:
        with _opened(self.path, "r", "results file") as file:
            return _read(file, self.path, name, slice(_counts(file, self.path).outputs))

    def _history_rows(self, name: str) -> np.ndarray:
        with _opened(self.path, "r", "results file") as file:
            return _read(file, self.path, f"farhorizon/history/{name}", slice(_counts(file, self.path).rows))

    def _records(self, name: str) -> np.ndarray:
        with _opened(self.path, "r", "results file") as file:
            return _read(file, self.path, f"farhorizon/records/{name}", slice(_counts(file, self.path).records))

    @property
    def times(self) -> np.ndarray:
        """Times of the outputs, shape (outputs,)."""
        return self._output_rows("VTKHDF/Steps/Values")

    @property
    def cautions(self) -> list[Caution]:
        """From when on the result is doubtful, and why; empty where nothing is known against it."""
        with _opened(self.path, "r", "results file") as file:
            return [Caution(*entry) for entry in json.loads(_word(file["farhorizon"].attrs, "cautions"))]

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
        """Times at which the probes were recorded, shape (records,): those of every step unless the case says
        otherwise.
        """
        return self._records("times")

    @property
    def probe_values(self) -> np.ndarray:
        """Values at the probes at `probe_times`, shape (records, n probes[, components])."""
        return self._records("values") if len(self.probes) else np.empty((0, 0))

    @property
    def recorded(self) -> dict[str, Recorded]:
        """What receivers and spectra have recorded, by their names."""
        found = {}
        with _opened(self.path, "r", "results file") as file:
            for name, group in file["farhorizon"].get("recorded", {}).items():
                place, rows = f"farhorizon/recorded/{name}", slice(int(group.attrs["rows"]))
                spectra = {n: _read_spectrum(file, self.path, f"{place}/spectra/{n}") for n in group["spectra"]}
                found[name] = Recorded(
                    name,
                    _read(file, self.path, f"{place}/points"),
                    _read(file, self.path, f"{place}/times", rows),
                    {n: _read(file, self.path, f"{place}/data/{n}", rows) for n in group["data"]},
                    _read(file, self.path, f"{place}/frequencies"),
                    spectra,
                    bool(group.attrs.get("directions", False)),
                    float(group.attrs.get("medium", 0.0)),
                )
        return found

    @property
    def regions(self) -> np.ndarray:
        """The number of each node's region, of the lattice's shape, which `region_names` explains: 0 has most nodes; -1
        where there is no node.
        """
        if not self.region_names:
            return np.zeros(self.shape, np.int32)
        with _opened(self.path, "r", "results file") as file:
            stored = _read(file, self.path, f"VTKHDF/PointData/{FIELD}", 0)
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
        ndarray, shape (nx[, ny[, nz]]), of vectors (components, nx, ...)

        Raises
        ------
        InputError
            There is no such field or output.
        FileFormatError
            The file is damaged.
        """
        if name not in self.field_names:
            raise InputError(f"{self.path} has no field {name!r}", remedy=f"one of {', '.join(self.field_names)}")
        with _opened(self.path, "r", "results file") as file:
            outputs = _counts(file, self.path).outputs
            if not -outputs <= index < outputs:
                raise InputError(f"{self.path} has no output {index}", value=index, limit=f"{outputs} outputs")
        return self._values(name, slice(index % outputs, index % outputs + 1))[0]

    def _values(self, name: str, rows: slice, within: Box | None = None) -> np.ndarray:
        """Outputs of a field, in a box if one is given, (outputs[, components], nx[, ny[, nz]]), from the parts where
        there are any.
        """
        asked = np.array([(0, n) for n in self.shape] if within is None else within)
        if not len(self._boxes):
            with _opened(self.path, "r", "results file") as file:
                values = self._lattice_first(name, _read(file, self.path, f"VTKHDF/PointData/{name}", rows))
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
            It is missing, or that of another run.
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
        """Outputs in our order of axes, of vectors without what only VTK has: (outputs[, components], nx[, ny[,
        nz]])."""
        components = self.components[name]
        width = () if components == 1 else (3,)
        values = stored.reshape(len(stored), *self.shape[::-1], *width)
        found = values.transpose(0, *range(values.ndim - 1, 0, -1))
        return np.ascontiguousarray(found if components == 1 else found[:, :components])

    def merge(self, path: str | Path) -> Path:
        """Write the results of several processes as one file, as one process would have written it; a copy of what is
        one file.

        It is made piece by piece: no field is held whole.

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
            It is this file, another program's, or there is no such directory.
        FileFormatError
            A part is missing or damaged.
        """
        path = kinds.path(path, "path")
        check_replaceable(path)
        if path.exists() and path.samefile(self.path):
            raise InputError("the file cannot take its own place", value=path, key="path", remedy="another name")
        with _opened(self.path, "r", "results file") as file, created(path) as draft, _hdf5(draft, "w") as made:
            counts = _counts(file, self.path)
            _copy_all_but(file, made, {"/VTKHDF/PointData", "/farhorizon/parts"})
            source, data = file["VTKHDF/PointData"], _copied_data(file["VTKHDF/PointData"], made)
            for name in self.field_names:
                self._copy_field(source[name], data, counts.outputs)
        _make_room(path, 0)
        return path

    def cut(self, path: Path, box: Box, outputs: int) -> None:
        """Write a part of the first outputs: a results file of a box, of their fields alone.

        Raises
        ------
        FileFormatError
            A part is missing or damaged.
        """
        one = self._part(0, self._boxes[0]).path if len(self._boxes) else self.path
        with _opened(one, "r", "results file") as file:
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
        """Put parts of other boxes, which `cut` has written into a folder, in the place of those that there are, or of
        the fields in this file.

        What is stopped in the middle of it leaves either parts in their folders.
        """
        with _opened(self.path, "r", "results file") as file, created(self.path) as draft, _hdf5(draft, "w") as made:
            _copy_all_but(file, made, {"/VTKHDF/PointData", "/farhorizon/parts"})
            source, data = file["VTKHDF/PointData"], _copied_data(file["VTKHDF/PointData"], made)
            for name in self.field_names:
                data.create_dataset(name, (0, *source[name].shape[1:]), source[name].dtype)
            _put_fixed(made["farhorizon"], "parts", np.array(boxes, np.int64))
        old, own = folder.with_name(f"{folder.name}.old"), folder_of(self.path)
        if own.is_dir():
            own.rename(old)
        folder.rename(own)
        if old.is_dir():
            shutil.rmtree(old)

    def _copy_field(self, source: Any, data: Any, outputs: int) -> None:
        """Copy the outputs of a field into a group, chunk by chunk."""
        name = source.name.rpartition("/")[2]
        dim = source.ndim - 1 - (self.components[name] > 1)  # those that are stored
        with ExitStack() as stack:
            parts = [
                (box[:dim][::-1], stack.enter_context(_opened(self._part(i, box).path, "r", "results file")))
                for i, box in enumerate(self._boxes)
            ]
            own = source if not parts else parts[0][1][source.name]
            made = _grow_fields(data, name, source.shape[1:], source.dtype, own.compression is not None)
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
                        values[(slice(None), *here)] = _read(file, Path(file.filename), source.name, (chunk[0], *there))
                made[chunk] = values

    def write_outlines(self, path: str | Path) -> Path:
        """Write the `outlines` for ParaView, which shows them beside the fields.

        Parameters
        ----------
        path : str or Path
            A name that ends in .vtp; ``kind`` numbers what lines show, in the order of `outlines`.

        Raises
        ------
        InputError
            There is no such directory.
        """
        path = kinds.path(path, "path")
        _directory_of(path)
        return write_vtp(path, self.outlines)

    def to_xarray(self) -> xarray.Dataset:
        """Read everything into an xarray Dataset (in memory).

        Returns
        -------
        xarray.Dataset
            Fields with the dimensions time, [component, ]x[, y[, z]]; ``energy`` (history_time), ``probe_values``
            (probe_time, probe), ``balance`` (history_time, account) if one was recorded; case, program and lattice as
            attributes; of each recorder NAME ``NAME_QUANTITY`` (NAME_time, NAME_point, ...), its spectra
            ``NAME_QUANTITY_spectrum`` (NAME_frequency, NAME_point, ...), and the coordinates NAME_x, ....

        Raises
        ------
        InputError
            xarray is not installed.
        FileFormatError
            The file is damaged.
        """
        xarray = xarray_module()
        names = ("x", "y", "z")[: self.dim]
        component = {name: () if count == 1 else ("component",) for name, count in self.components.items()}
        probed = ("component",) if self.probe_values.ndim > 2 else ()
        # One look at the counts: a running simulation may append between two accesses.
        times, rows, probe_times = self.times, self.history_times.size, self.probe_times
        data: dict[str, Any] = {}
        for name in self.field_names:
            data[name] = (("time", *component[name], *names), self._values(name, slice(times.size)))
        data["energy"] = ("history_time", self.energy[:rows])
        data["probe_values"] = (("probe_time", "probe", *probed), self.probe_values[: probe_times.size])
        balance = self.balance
        if self.region_names:
            meanings = {"names": list(self.region_names), "outside": OUTSIDE}
            data[FIELD] = (names, self.regions, meanings)
        if balance:
            data["balance"] = (
                ("history_time", "account"),
                np.stack([values[:rows] for values in balance.values()], axis=1),
            )
        coords: dict[str, Any] = {
            "time": times,
            "step": ("time", self.steps[: times.size]),
            "history_time": self.history_times[:rows],
            "probe_time": probe_times,
        }
        for axis, name in enumerate(names):
            coords[name] = self.axes[axis]
            coords[f"probe_{name}"] = ("probe", self.probes[:, axis])
        if balance:
            coords["account"] = list(balance)
        if probed or any(component.values()):
            coords["component"] = list(names)
        more = dataset_parts(self.recorded)
        data, coords = data | more[0], coords | more[1]
        attributes = {
            **self.provenance,
            "program": self.program,
            "case": self.case,
            "dim": self.dim,
            "spacing": self.spacing,
            "lower": list(self.lower),
            "cautions": [caution.text for caution in self.cautions],
        }
        whole = xarray.Dataset(data, coords, attributes)
        lengths = [*names, *(f"probe_{name}" for name in names)]
        measured = {**dict.fromkeys(lengths, "length"), "probe_values": "u", **measured_in(self.recorded)}
        measured |= dict.fromkeys(("time", "probe_time", "history_time"), "time")
        measured |= {name: "stress" for name in self.field_names if name.startswith("stress_")}
        for name in whole.variables.keys() & (measured.keys() | self.units.keys()):
            if unit := self.units.get(measured.get(str(name), str(name))):
                whole[name].attrs["units"] = unit
        for name, quantity in spectra_of(self.recorded).items():  # integrals over time
            if (unit := self.units.get(quantity)) and "time" in self.units:
                whole[name].attrs["units"] = f"{unit} {self.units['time']}"
        return whole


def xarray_module() -> Any:
    """xarray; InputError where it is not installed."""
    try:
        import xarray
    except ImportError as error:
        raise InputError("xarray is not installed", remedy="pip install 'farhorizon[xarray]'") from error
    return xarray


def dataset(
    fields: Mapping[str, np.ndarray], axes: Sequence[np.ndarray], moment: Mapping[str, float]
) -> xarray.Dataset:
    """Fields at one moment, of vectors the components first, as an xarray Dataset.

    Raises
    ------
    InputError
        xarray is not installed.
    """
    names = ("x", "y", "z")[: len(axes)]
    data = {name: (("component", *names)[-values.ndim :], values) for name, values in fields.items()}
    coords: dict[str, Any] = {**dict(zip(names, axes, strict=True)), **moment}
    if any(values.ndim > len(axes) for values in fields.values()):
        coords["component"] = list(names)
    return xarray_module().Dataset(data, coords)


def open_results(path: str | Path) -> Results:
    """Open a results file.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    Results

    Raises
    ------
    InputError
        There is no such file.
    FileFormatError
        The file is truncated, damaged or not a farhorizon results file.

    Examples
    --------
    >>> import farhorizon as fh
    >>> results = fh.open_results("results/case.h5")  # doctest: +SKIP
    >>> results.times, results.field("u", -1)  # doctest: +SKIP
    """
    return Results(kinds.path(path, "path"))


def _digest(data: bytes | np.ndarray) -> str:
    return hashlib.sha256(data if isinstance(data, bytes) else data.reshape(-1).view(np.uint8).data).hexdigest()


def write_checkpoint(path: str | Path, arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any]) -> None:
    """Write a checkpoint: under a temporary name in the same directory, forced to disk, then renamed.

    Until the new checkpoint is whole, an older one at `path` stays as it is.

    Parameters
    ----------
    path : str or Path
    arrays : mapping of str to ndarray
        Arrays of numbers, of any shape; they come back bit by bit.
    meta : mapping
        What JSON can hold.

    Raises
    ------
    InputError
        There is no such directory, an array does not hold numbers, or `meta` is not JSON.
    """
    path = kinds.path(path, "path")
    _directory_of(path)
    stored = {name: np.asarray(array, order="C") for name, array in arrays.items()}
    for name, array in stored.items():
        if array.dtype.kind not in "biufc":
            raise InputError(
                f"{path}: array {name!r} does not hold numbers", value=array.dtype, remedy="put it into meta"
            )
    entries = [
        {"name": name, "dtype": array.dtype.str, "shape": array.shape, "sha256": _digest(array)}
        for name, array in stored.items()
    ]
    try:
        index = json.dumps({"meta": dict(meta), "arrays": entries}).encode()
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{path}: meta is not JSON ({error})", remedy="use numbers, strings, lists, dicts, bool and None"
        ) from error
    with created(path) as draft, _hdf5(draft, "w") as file:
        file.attrs["version"], file.attrs["complete"] = VERSION, False
        for name, word in (("format", CHECKPOINT_FORMAT), ("sha256", _digest(index))):
            _put_word(file.attrs, name, word)
        file.create_dataset("index", data=np.frombuffer(index, dtype=np.uint8))
        for number, array in enumerate(stored.values()):
            file.create_dataset(f"arrays/{number}", data=array)
        file.attrs.modify("complete", True)


def read_checkpoint(path: str | Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read a checkpoint and check every byte of what it holds.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    arrays : dict of str to ndarray
    meta : dict

    Raises
    ------
    InputError
        There is no such file.
    FileFormatError
        The file is truncated, damaged, incomplete, of a newer version or not a farhorizon checkpoint.
    """
    path = kinds.path(path, "path")
    remedy = "use an earlier checkpoint, or start the run anew"
    with _opened(path, "r", "checkpoint") as file:
        _refuse_other_files(file, path)
        if _word(file.attrs, "format") != CHECKPOINT_FORMAT:
            raise FileFormatError(
                f"{path} is an HDF5 file, but not a farhorizon checkpoint",
                remedy="give a file written by Simulation.save",
            )
        remedy_of_older = "go on with the version of farhorizon that wrote it"
        _check_version(path, int(file.attrs["version"]), VERSION, remedy_of_older)
        if not file.attrs["complete"]:
            raise FileFormatError(f"{path} is incomplete: its writing was interrupted", remedy=remedy)
        text = file["index"][:].tobytes()
        if _digest(text) != _word(file.attrs, "sha256"):
            raise FileFormatError(f"{path} is damaged: its index fails its check sum", remedy=remedy)
        index = json.loads(text)
        arrays = {}
        for number, entry in enumerate(index["arrays"]):
            dataset, name = file[f"arrays/{number}"], entry["name"]
            whole = dataset.dtype.str == entry["dtype"] and dataset.shape == tuple(entry["shape"])
            array = np.asarray(dataset[()]) if whole else np.empty(0)
            if not whole or _digest(array) != entry["sha256"]:
                raise FileFormatError(f"{path} is damaged: array {name!r} fails its check sum", remedy=remedy)
            arrays[name] = array
    return arrays, index["meta"]

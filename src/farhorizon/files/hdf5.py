"""HDF5 files of ours: a change is whole or not there, and all that is read has a check sum and stands in the file.

They are opened by way of `farhorizon.files.storage`. Texts have a fixed length, and arrays that grow do so by rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from farhorizon.errors import FarhorizonError, FileFormatError, InputError
from farhorizon.files.parts import is_own
from farhorizon.files.storage import Draft, changing, read

CHUNK_ROWS = 512  # of a dataset that grows by short rows
_DEPTH = 5  # of groups in each other, in any file of ours


def hdf5_file(path: Path | Draft, mode: str) -> Any:
    """Open an HDF5 file; what is written into it has the format of HDF5 1.10, which has check sums.

    File locks are off, so that someone who looks at a file with another program cannot stop the run that writes it.
    """
    return h5py.File(path, mode, locking=False, libver=("v110", "v110"))


@contextmanager
def opened(path: Path, mode: str, what: str) -> Iterator[Any]:
    """Open an HDF5 file, "r" or "r+"; whatever HDF5 cannot read becomes a FileFormatError."""
    if not path.is_file():
        raise InputError(f"{path}: no such file", remedy=f"give the path of a {what}")
    try:
        if not h5py.is_hdf5(path):
            raise FileFormatError(
                f"{path} is not an HDF5 file, or its beginning is damaged", remedy=f"give the path of a {what}"
            )
        with (
            (read if mode == "r" else changing)(path) as draft,
            hdf5_file(path if draft is None else draft, mode) as file,
        ):
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


def refuse_other_files(group: Any, path: Path, depth: int = 0) -> None:
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
            refuse_other_files(item, path, depth + 1)


def _lies_elsewhere(item: Any, path: Path) -> bool:
    return bool(item.external) or (item.is_virtual and not is_own(item, path))


def read_indices(group: Any) -> None:
    """Read where the chunks of all datasets lie; OSError if the check sum of an index fails."""
    for item in group.values():
        if isinstance(item, h5py.Group):
            read_indices(item)
        elif item.chunks is not None:
            item.id.get_num_chunks()


def read_rows(file: Any, path: Path, name: str, rows: Any = ()) -> np.ndarray:
    """Rows of a dataset; FileFormatError names the one that fails its check sum."""
    try:
        return np.asarray(file[name][rows])
    except OSError as error:
        remedy = "compute it again, or resume the run from a checkpoint before it"
        raise FileFormatError(f"{path} is damaged: {name} fails its check sum", remedy=remedy) from error


def directory_of(path: Path) -> Path:
    """Directory that a new file shall stand in; InputError if there is none."""
    if path.is_dir():
        raise InputError(f"{path} is a directory", remedy="give the path of a file")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no directory {path.parent}", remedy="create it first")
    return path.parent


def check_version(path: str | Path, version: int, known: int, older: str) -> None:
    """FileFormatError of a version other than the known one, with what to do about an older one."""
    if version != known:
        raise FileFormatError(
            f"{path} has {'an older' if version < known else 'a newer'} format",
            value=version,
            limit=known,
            remedy=older if version < known else "update farhorizon",
        )


def words_in(group: Any, name: str) -> tuple[str, ...]:
    """Texts in a dataset; none if it is not there."""
    return tuple(text.decode() for text in np.ravel(group[name][()])) if name in group else ()


def put_words(group: Any, name: str, words: Sequence[str]) -> None:
    """Keep texts; they have a fixed length, since those of variable length have no check sum."""
    encoded = [word.encode() for word in words]
    dtype = h5py.string_dtype("utf-8", max(1, *map(len, encoded)))
    put_fixed(group, name, np.array(encoded, dtype))


def word_in(attributes: Any, name: str) -> str:
    """A text among attributes; empty if it is not there."""
    text = attributes.get(name, b"")
    return text.decode(errors="replace") if isinstance(text, bytes) else str(text)


def put_word(attributes: Any, name: str, word: str) -> None:
    """Keep a text of fixed length among attributes: damage where HDF5 keeps those of variable length makes it hang or
    crash.
    """
    encoded = word.encode()
    attributes.create(name, encoded, dtype=h5py.string_dtype("utf-8", max(1, len(encoded))))


def put_fixed(group: Any, name: str, values: np.ndarray) -> None:
    """Keep an array that does not grow."""
    checked = {"chunks": values.shape, "fletcher32": True} if values.size else {}
    group.create_dataset(name, data=values, dtype=values.dtype, **checked)


def grow(
    group: Any,
    name: str,
    dtype: Any,
    row: tuple[int, ...] = (),
    chunk: tuple[int, ...] | None = None,
    packed: Mapping[str, Any] | None = None,
) -> Any:
    """Make an empty dataset that grows by rows of a shape, without one by numbers.

    Parameters
    ----------
    group : h5py.Group
    name : str
    dtype : dtype
    row : tuple of int
    chunk : tuple of int, optional
        Rows, and parts of a row, that have a check sum together; 512 whole rows unless given.
    packed : mapping, optional
        How HDF5 packs them.
    """
    chunks = (CHUNK_ROWS, *row) if chunk is None else chunk
    return group.create_dataset(
        name, (0, *row), dtype, maxshape=(None, *row), chunks=chunks, fletcher32=True, **(packed or {})
    )


def put_rows(dataset: Any, start: int, values: Any) -> None:
    """Write `values` from row `start` on; rows that stood there or beyond are replaced."""
    stop = start + len(values)
    dataset.resize(stop, axis=0)
    dataset[start:stop] = values


def copy_attributes(source: Any, target: Any) -> None:
    """Copy all that is said of something, in the types that it has there."""
    for name, value in source.attrs.items():
        target.attrs.create(name, value, dtype=source.attrs.get_id(name).dtype)


def copy_all_but(source: Any, target: Any, left_out: set[str]) -> None:
    """Copy what is in a group, with all that HDF5 notes of it, but for some places."""
    copy_attributes(source, target)
    for name, item in source.items():
        if item.name in left_out:
            continue
        if any(place.startswith(f"{item.name}/") for place in left_out):
            copy_all_but(item, target.create_group(name), left_out)
        else:
            source.copy(item, target, name)

"""Our HDF5 files: changes are atomic, and everything that is read has a checksum and is stored in the file itself.

They are opened by way of `farhorizon.files.storage`. Strings have a fixed length, and growing arrays grow by rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np

from farhorizon.errors import FarhorizonError, FileFormatError, InputError
from farhorizon.files.parts import is_own
from farhorizon.files.storage import Draft, changing, read

CHUNK_ROWS = 512  # rows per chunk of a dataset that grows by short rows
_DEPTH = 5  # largest depth of nested groups in our files


def hdf5_file(path: Path | Draft, mode: str) -> Any:
    """Open an HDF5 file; it is written in the format of HDF5 1.10, which has checksums.

    File locks are off, so that viewing the file in another program cannot stop the run that writes it.
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
        # Errors of the operating system (disk full, ...) have an errno and say nothing about the format of the file.
        if isinstance(error, OSError) and error.errno is not None and mode != "r":
            raise
        raise FileFormatError(
            f"{path} is truncated or damaged ({error})", remedy=f"use another {what}, or compute it again"
        ) from error


def refuse_other_files(group: Any, path: Path, depth: int = 0) -> None:
    """Refuse content that is stored elsewhere: our files have no links, and another file's content may be secret."""
    for name in group:
        item = group[name] if isinstance(group.get(name, getlink=True), h5py.HardLink) and depth < _DEPTH else None
        elsewhere = isinstance(item, h5py.Dataset) and (item.external or (item.is_virtual and not is_own(item, path)))
        if item is None or elsewhere:
            raise FileFormatError(
                f"{path}: {group.name.rstrip('/')}/{name} refers to another place or file, as nothing that we write "
                "does",
                remedy="use a file of a known origin; one in parts keeps its name, that of its folder",
            )
        if isinstance(item, h5py.Group):
            refuse_other_files(item, path, depth + 1)


def read_indices(group: Any) -> None:
    """Read the chunk locations of all datasets; OSError if the checksum of an index is wrong."""
    for item in group.values():
        if isinstance(item, h5py.Group):
            read_indices(item)
        elif item.chunks is not None:
            item.id.get_num_chunks()


def failing(group: Any) -> Iterator[str]:
    """Yield datasets with the rows that fail their check sum; OSError if an index or an attribute fails its own."""
    for item in group.values():
        list(item.attrs.values())
        if isinstance(item, h5py.Group):
            yield from failing(item)
            continue
        for place in item.iter_chunks() if item.chunks is not None and item.size else ():
            try:
                item[place]
            except OSError:
                first, last = place[0].start, place[0].stop
                yield f"{item.name.lstrip('/')}[{first if last - first == 1 else f'{first}:{last}'}]"


def read_rows(file: Any, path: Path, name: str, rows: Any = ()) -> np.ndarray:
    """Rows of a dataset; FileFormatError names the one whose checksum is wrong."""
    try:
        return np.asarray(file[name][rows])
    except OSError as error:
        remedy = "compute it again, or resume the run from a checkpoint before it"
        raise FileFormatError(f"{path} is damaged: {name} fails its check sum", remedy=remedy) from error


def directory_of(path: Path) -> Path:
    """The directory of a new file; InputError if it does not exist, or if the path is itself a directory."""
    if path.is_dir():
        raise InputError(f"{path} is a directory", remedy="give the path of a file")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no directory {path.parent}", remedy="create it first")
    return path.parent


def check_version(path: str | Path, version: int, known: int, older: str) -> None:
    """Raise FileFormatError for a version other than the known one, with `older` as the remedy for an older one."""
    if version != known:
        raise FileFormatError(
            f"{path} has {'an older' if version < known else 'a newer'} format",
            value=version,
            limit=known,
            remedy=older if version < known else "update farhorizon",
        )


def words_in(group: Any, name: str) -> tuple[str, ...]:
    """Strings in a dataset; empty if it does not exist."""
    return tuple(text.decode() for text in np.ravel(group[name][()])) if name in group else ()


def put_words(group: Any, name: str, words: Sequence[str]) -> None:
    """Store strings; they have a fixed length, because strings of variable length have no checksum."""
    encoded = [word.encode() for word in words]
    dtype = h5py.string_dtype("utf-8", max(1, *map(len, encoded)))
    put_fixed(group, name, np.array(encoded, dtype))


def word_in(attributes: Any, name: str) -> str:
    """A string attribute; empty if it does not exist."""
    text = attributes.get(name, b"")
    return text.decode(errors="replace") if isinstance(text, bytes) else str(text)


def put_word(attributes: Any, name: str, word: str) -> None:
    """Store a string attribute of fixed length: damage where HDF5 stores strings of variable length makes it hang or
    crash.
    """
    encoded = word.encode()
    attributes.create(name, encoded, dtype=h5py.string_dtype("utf-8", max(1, len(encoded))))


def put_fixed(group: Any, name: str, values: np.ndarray) -> None:
    """Store an array that does not grow."""
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
    """Create an empty dataset that grows by rows of a shape; each chunk (512 rows unless given) has a checksum."""
    chunks = (CHUNK_ROWS, *row) if chunk is None else chunk
    return group.create_dataset(
        name, (0, *row), dtype, maxshape=(None, *row), chunks=chunks, fletcher32=True, **(packed or {})
    )


class Table(NamedTuple):
    """Datasets that grow together by rows; an attribute counts the valid ones, and what lies beyond does not count."""

    columns: dict[str, Any]
    attributes: Any
    counter: str = "rows"

    @property
    def counted(self) -> int:
        """Number of valid rows according to the attribute."""
        return int(self.attributes[self.counter])

    def held(self, path: Path, least: int) -> int:
        """The counted rows, as far as all columns hold them: a program of others may have been killed between two of
        them. FileFormatError if these are less than `least`.
        """
        shortest = min(self.columns.values(), key=len)
        rows = min(self.counted, len(shortest))
        if rows < least:
            raise FileFormatError(
                f"{path} is damaged: {shortest.name} is too short",
                value=len(shortest),
                limit=least,
                remedy="compute it again",
            )
        return rows

    def put(self, start: int, values: Mapping[str, Any]) -> int:
        """Write rows of all columns from row `start` on, which become the last valid ones; returns their number."""
        for name, column in self.columns.items():
            column.resize(start + len(values[name]), axis=0)
            column[start:] = values[name]
        self.attributes.modify(self.counter, end := len(next(iter(self.columns.values()))))
        return end

    def cut(self, rows: int) -> None:
        """Cut off all rows beyond a number."""
        self.attributes.modify(self.counter, rows)
        for column in self.columns.values():
            column.resize(rows, axis=0)


def copy_attributes(source: Any, target: Any) -> None:
    """Copy all attributes with their types."""
    for name, value in source.attrs.items():
        target.attrs.create(name, value, dtype=source.attrs.get_id(name).dtype)


def copy_all_but(source: Any, target: Any, left_out: set[str]) -> None:
    """Copy the content of a group with all attributes, except what is at some paths."""
    copy_attributes(source, target)
    for name, item in source.items():
        if item.name in left_out:
            continue
        if any(place.startswith(f"{item.name}/") for place in left_out):
            copy_all_but(item, target.create_group(name), left_out)
        else:
            source.copy(item, target, name)

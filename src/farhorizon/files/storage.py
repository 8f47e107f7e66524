"""Atomic changes of files, which stay intact wherever a writing process is stopped, and locks on names.

HDF5 writes the pieces of one change (data, sizes, indices) one after the other and in an order of its own, so that a
process that dies between two of them, or a disk that is full, leaves a file that nothing can read. It also cannot close
a file that it failed to write, and crashes in the end. Therefore HDF5 does not write our files itself: it is given an
object that looks like a file (`Draft`).

- A new file grows under a temporary name beside its own and is renamed when it is complete.
- In a change to an existing file, data beyond the old end are written at once, because nothing refers to them yet. Data
  that replace old content are kept in memory, written to a journal beside the file when they are complete, and from
  there into the file; then the journal is removed. A journal that is found belongs to an interrupted change: the next
  change completes it first, and readers see the file as if it were complete.
- The first error of the operating system, or an interrupt, is kept; everything after it is discarded without informing
  HDF5, and then the error is raised.
"""

from __future__ import annotations

import errno
import hashlib
import io
import os
import re
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from farhorizon.errors import InputError

_MARK = b"farhorizon journal 1\n"
_PIECE = struct.Struct("<QQ")  # sizes of the file before and after the change; offset and length of each piece

_PAUSE = 0.2  # seconds between two attempts to acquire a lock

Change = tuple[int, bytes]  # offset, and what is written there


class Draft(io.RawIOBase):
    """A file with pending changes, as a file object to which HDF5 writes, see `h5py.File`.

    Attributes
    ----------
    changes : list of (offset, bytes)
        Pieces that replace content of the file, in the order in which they were written, or those of an interrupted
        change, which a reader is to see.
    old_size, size : int
        Sizes of the file and of the draft.
    error : BaseException or None
        The first error in a read or write; nothing has been written since.
    """

    def __init__(
        self, path: Path, writable: bool, changes: list[Change] | None = None, size: int | None = None
    ) -> None:
        self.path = path
        self._file = open(path, "r+b" if writable else "rb", buffering=0)
        self.old_size = os.fstat(self._file.fileno()).st_size
        self.size = self.old_size if size is None else size
        self.changes: list[Change] = [] if changes is None else changes
        self.error: BaseException | None = None
        self._place = 0

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()

    def readable(self) -> bool:
        """Always true."""
        return True

    def seekable(self) -> bool:
        """Always true."""
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Set the position of the next read or write."""
        self._place = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._place, os.SEEK_END: self.size}[whence]
        return self._place

    def tell(self) -> int:
        """Position of the next read or write."""
        return self._place

    def readinto(self, buffer: Any) -> int:
        """Read as if the changes were in the file; zeros beyond its end."""
        target = memoryview(buffer).cast("B")
        with self._keeping_errors():
            self._read(target)
        self._place += len(target)
        return len(target)

    def _read(self, target: memoryview) -> None:
        start, end, done = self._place, self._place + len(target), 0
        self._file.seek(start)
        while done < len(target):
            count = self._file.readinto(target[done:])
            if not count:
                target[done:] = bytes(len(target) - done)
                break
            done += count
        for offset, data in self.changes:
            first, last = max(start, offset), min(end, offset + len(data))
            if first < last:
                target[first - start : last - start] = data[first - offset : last - offset]

    def write(self, data: Any) -> int:
        """Write what lies beyond the old end of the file at once; keep the rest as changes."""
        source = memoryview(data).cast("B")
        if self.error is None:
            with self._keeping_errors():
                self._write(source)
        self._place += len(source)
        self.size = max(self.size, self._place)
        return len(source)

    def _write(self, source: memoryview) -> None:
        start = self._place
        inside = max(0, min(len(source), self.old_size - start))
        if inside:
            self.changes = [c for c in self.changes if not (start <= c[0] and c[0] + len(c[1]) <= start + inside)]
            self.changes.append((start, bytes(source[:inside])))
        if inside < len(source):
            _write_all(self._file.fileno(), source[inside:], start + inside)

    @contextmanager
    def _keeping_errors(self) -> Iterator[None]:
        """Keep the first error, also an interrupt, because HDF5 must not see it."""
        try:
            yield
        except BaseException as error:
            if isinstance(error, OSError) and error.filename is None:
                error.filename = str(self.path)
            self.error = self.error or error

    def truncate(self, size: int | None = None) -> int:
        """Set the size of the file, by default to the present position."""
        self.size = self._place if size is None else size
        return self.size

    def flush(self) -> None:
        """Do nothing, because no data are buffered here."""


def _write_all(descriptor: int, data: memoryview, offset: int) -> None:
    """Write all data; the operating system may accept only a part at a time."""
    os.lseek(descriptor, offset, os.SEEK_SET)
    while len(data):
        data = data[os.write(descriptor, data) :]


def _journal_of(path: Path) -> Path:
    return path.with_name(f".{path.name}.journal")


def _temporary_of(path: Path) -> Path:
    return path.with_name(f".{path.name}.{os.getpid()}-{threading.get_ident()}.tmp")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary name beside `path`; at the end, the file of that name is forced to disk and replaces `path`.
    After an error `path` is unchanged.
    """
    temporary = _temporary_of(path)
    try:
        yield temporary
        force_to_disk(temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    if os.name == "posix":
        force_to_disk(path.parent)


@contextmanager
def created(path: Path) -> Iterator[Draft]:
    """Yield a draft of a new file, which replaces `path` at the end; after an error `path` is unchanged."""
    if _journal_of(path).exists():
        with changing(path):  # a journal must not outlive the file that it belongs to
            pass
    with replacing(path) as temporary:
        temporary.touch()
        with _held(Draft(temporary, True)) as draft:
            yield draft
        os.truncate(temporary, draft.size)


@contextmanager
def changing(path: Path) -> Iterator[Draft]:
    """Yield a draft of changes to an existing file; at the end all of them are in the file, or after an error none."""
    interrupted = _read_journal(path)
    if interrupted is not None:
        _apply(path, *interrupted)
    with suppress(FileNotFoundError):
        _journal_of(path).unlink()
    draft = Draft(path, True)
    try:
        with _held(draft):
            yield draft
        if draft.changes or draft.size != draft.old_size:
            _commit(path, draft)
    except BaseException:
        if not _journal_of(path).exists() and os.path.getsize(path) > draft.old_size:
            os.truncate(path, draft.old_size)
        raise


@contextmanager
def read(path: Path) -> Iterator[Draft | None]:
    """Yield a file as completed by its journal; None if there is no journal and the file can be read as it is."""
    interrupted = _read_journal(path)
    if interrupted is None:
        yield None
        return
    with _held(Draft(path, False, *interrupted)) as draft:
        yield draft


@contextmanager
def _held(draft: Draft) -> Iterator[Draft]:
    """Close the draft at the end; its own error takes precedence, because it explains any other."""
    try:
        yield draft
    except Exception:
        if draft.error is not None:
            raise draft.error from None
        raise
    finally:
        draft.close()
    if draft.error is not None:
        raise draft.error


def _commit(path: Path, draft: Draft) -> None:
    body = _PIECE.pack(draft.old_size, draft.size) + b"".join(
        _PIECE.pack(o, len(data)) + data for o, data in draft.changes
    )
    temporary = _temporary_of(path)
    try:
        with open(temporary, "wb", buffering=0) as file:
            _write_all(file.fileno(), memoryview(_MARK + hashlib.sha256(body).digest() + body), 0)
        os.replace(temporary, _journal_of(path))
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    _apply(path, draft.changes, draft.size)
    _journal_of(path).unlink()


def _apply(path: Path, changes: list[Change], size: int) -> None:
    with open(path, "r+b", buffering=0) as file:
        for offset, data in changes:
            _write_all(file.fileno(), memoryview(data), offset)
        file.truncate(size)


def _read_journal(path: Path) -> tuple[list[Change], int] | None:
    """Changes and final size of the file; None without a journal, or if it is damaged or of another file."""
    try:
        raw = _journal_of(path).read_bytes()
        size = os.path.getsize(path)
    except FileNotFoundError:
        return None
    start = len(_MARK) + hashlib.sha256().digest_size
    body = memoryview(raw)[start:]
    if raw[: len(_MARK)] != _MARK or hashlib.sha256(body).digest() != raw[len(_MARK) : start]:
        return None
    before, after = _PIECE.unpack_from(body)
    if size < min(before, after):
        return None
    changes, place = [], _PIECE.size
    while place < len(body):
        offset, length = _PIECE.unpack_from(body, place)
        place += _PIECE.size
        changes.append((offset, bytes(body[place : place + length])))
        place += length
    return changes, after


def force_to_disk(path: Path) -> None:
    """Force a file, or the entries of a directory, to disk."""
    descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def remove_leftovers(path: Path) -> None:
    """Remove temporary files that stopped processes left beside a file, whose lock must be held: none is in use."""
    temporary = re.compile(re.escape(f".{path.name}.") + r"[\d-]+\.tmp")
    for file in path.parent.iterdir():
        if temporary.fullmatch(file.name):
            file.unlink(missing_ok=True)


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold a lock on a name while the block runs, by a file that is created, locked and removed; it is released when
    the process ends, in whatever way. InputError if another process holds it.
    """
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            _lock(descriptor, path)
            if path.exists() and os.path.samestat(os.fstat(descriptor), os.stat(path)):
                break
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)  # its holder removed the name after we had opened it, so it no longer locks anything
    try:
        yield
    finally:
        with suppress(OSError):
            path.unlink()
        os.close(descriptor)


@contextmanager
def awaited(path: Path) -> Iterator[None]:
    """Hold a lock on a name, as `locked`, waiting until nobody else holds it."""
    with ExitStack() as lock:
        while True:
            with suppress(InputError):
                lock.enter_context(locked(path))
                break
            time.sleep(_PAUSE)
        yield


def _lock(descriptor: int, path: Path) -> None:
    """Lock a file, where the operating system and the file system support it."""
    try:
        if os.name == "nt":
            import msvcrt

            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except ImportError:
        return
    except OSError as error:
        if error.errno in (errno.EWOULDBLOCK, errno.EACCES, errno.EDEADLK):
            raise InputError(
                "another run writes these results",
                value=str(path),
                remedy="wait until it has ended, or --out another folder",
            ) from None

"""The cache folder for things computed once and reused: compiled programs, kernels, certificates. A damaged file in it
counts as missing.
"""

from __future__ import annotations

import hashlib
import io
import os
import stat
import tempfile
import time
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from platformdirs import user_cache_path

from farhorizon.files.storage import replacing

_STALE = 86400.0  # seconds after which a temporary file is taken to be left by a stopped process


def cache_folder() -> Path:
    """The cache folder: ``FARHORIZON_CACHE`` or one in the user's cache folder; if it cannot be used, a private
    temporary one.
    """
    given = os.environ.get("FARHORIZON_CACHE")
    with suppress(OSError):
        folder = Path(given) if given else user_cache_path("farhorizon", appauthor=False)
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return folder
    if not given and hasattr(os, "getuid"):
        shared = Path(tempfile.gettempdir()) / f"farhorizon-{os.getuid()}"
        with suppress(OSError):
            shared.mkdir(mode=0o700, exist_ok=True)
            if _private(shared):
                return shared
    return _temporary_folder()


@cache
def _temporary_folder() -> Path:
    """A folder of this process."""
    return Path(tempfile.mkdtemp(prefix="farhorizon-"))


def _private(folder: Path) -> bool:
    """Whether a folder belongs to the user and nobody else can use it, because code in it will be executed."""
    status = folder.lstat()
    return stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and stat.S_IMODE(status.st_mode) == 0o700


def sealed(data: bytes) -> bytes:
    """Data followed by their checksum."""
    return data + hashlib.sha256(data).digest()


def unsealed(data: bytes) -> bytes | None:
    """Data without the checksum at their end; None if it does not match."""
    size = len(data) - hashlib.sha256().digest_size
    return data[:size] if size >= 0 and hashlib.sha256(data[:size]).digest() == data[size:] else None


def keep(path: Path, **arrays: Any) -> None:
    """Save arrays to a file of the cache; if they cannot be written they will be computed again next time."""
    file = io.BytesIO()
    np.savez(file, **arrays)
    with suppress(OSError):
        write(path, sealed(file.getvalue()))


def kept(path: Path) -> dict[str, np.ndarray] | None:
    """Arrays in a file of the cache; None if it is missing or damaged."""
    try:
        data = unsealed(path.read_bytes())
    except OSError:
        return None
    if data is None:
        return None
    with np.load(io.BytesIO(data)) as arrays:
        return dict(arrays)


def write(path: Path, data: bytes) -> None:
    """Replace a file of the cache, and remove temporary files left there by stopped processes."""
    with replacing(path) as temporary:
        temporary.write_bytes(data)
    for left in (*path.parent.glob("*.tmp"), *path.parent.glob("__pycache__/*.tmp.*")):
        with suppress(OSError):
            if time.time() - left.stat().st_mtime > _STALE:
                left.unlink()

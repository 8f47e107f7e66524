"""The folder of what is made once and found again: compiled programs, kernels, certificates. A damaged file in it
counts as none.
"""

from __future__ import annotations

import hashlib
import io
import os
import stat
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon.files.storage import replacing

_STALE = 86400.0  # seconds after which a temporary file belongs to a process that was stopped


def cache_folder() -> Path:
    """Folder of generated programs: ``FARHORIZON_CACHE`` or the user's cache folder, else a temporary one of the user's
    own.
    """
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    given = os.environ.get("FARHORIZON_CACHE")
    with suppress(OSError):
        folder = Path(given) if given else home / "farhorizon"
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return folder
    if not given and hasattr(os, "getuid"):
        shared = Path(tempfile.gettempdir()) / f"farhorizon-{os.getuid()}"
        with suppress(OSError):
            shared.mkdir(mode=0o700, exist_ok=True)
            if _private(shared):
                return shared
    return Path(tempfile.mkdtemp(prefix="farhorizon-"))


def _private(folder: Path) -> bool:
    """Whether a folder is the user's, and nobody else's: what lies in it will be run."""
    found = folder.lstat()
    return stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and stat.S_IMODE(found.st_mode) == 0o700


def sealed(data: bytes) -> bytes:
    """Data with their check sum behind them."""
    return data + hashlib.sha256(data).digest()


def unsealed(data: bytes) -> bytes | None:
    """Data without their check sum; None if it is not theirs."""
    size = len(data) - hashlib.sha256().digest_size
    return data[:size] if size >= 0 and hashlib.sha256(data[:size]).digest() == data[size:] else None


def keep(path: Path, **arrays: Any) -> None:
    """Keep arrays in a file of the cache; where they cannot be written they are made again another time."""
    file = io.BytesIO()
    np.savez(file, **arrays)
    with suppress(OSError):
        write(path, sealed(file.getvalue()))


def kept(path: Path) -> dict[str, np.ndarray] | None:
    """Arrays of a file of the cache; None if it is not there or damaged."""
    try:
        data = unsealed(path.read_bytes())
    except OSError:
        return None
    if data is None:
        return None
    with np.load(io.BytesIO(data)) as found:
        return dict(found)


def write(path: Path, data: bytes) -> None:
    """Write a file of the cache under a temporary name and rename it; temporary files that stopped processes left there
    go.
    """
    with replacing(path) as temporary:
        temporary.write_bytes(data)
    for old in (*path.parent.glob("*.tmp"), *path.parent.glob("__pycache__/*.tmp.*")):
        with suppress(OSError):
            if time.time() - old.stat().st_mtime > _STALE:
                old.unlink()

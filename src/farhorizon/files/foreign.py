"""Files of other programs: whatever their readers raise becomes one InputError that names the file."""

from __future__ import annotations

import io
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon.errors import FileFormatError, InputError


@contextmanager
def reading(path: Path, what: str, key: str, remedy: str) -> Iterator[None]:
    """Guard the reading of a file, and nothing else: readers meet damaged data with errors of every kind, or exit, and
    print and warn in several lines. InputError if it may not be read, FileFormatError for all else; `what` is in it, as
    "the samples".
    """
    cannot = f"cannot read {what} {path}"
    readable = {"limit": "a file that can be read", "key": key, "remedy": "check the path"}
    if not os.path.isfile(path):  # `Path.is_file` raises for names that are too long
        raise InputError(f"{cannot}: no such file", value=path.name, **readable)
    silent = io.StringIO()
    try:
        with warnings.catch_warnings(), redirect_stdout(silent), redirect_stderr(silent):
            warnings.simplefilter("ignore")
            yield
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        if isinstance(error, OSError) and error.strerror:
            raise InputError(f"{cannot}: {error.strerror}", value=path.name, **readable) from None
        text = str(error) if not isinstance(error, SystemExit) else silent.getvalue() or "it gave up"
        reason = " ".join(text.split())
        if not isinstance(error, ValueError | OSError | SyntaxError | SystemExit):  # whose texts are sentences
            reason = f"{type(error).__name__} {reason}".strip()
        raise FileFormatError(
            f"{cannot}: it is damaged, or of a kind that is not understood",
            value=reason,
            limit="a whole file of its kind",
            key=key,
            remedy=remedy,
        ) from None


@contextmanager
def naming(given: Any) -> Iterator[None]:
    """Name the file in every InputError about what is in it; nothing is changed where no file is given."""
    try:
        yield
    except InputError as error:
        if not isinstance(given, str | Path) or Path(given).name in str(error):
            raise
        message = f"{error.message} (in the file {given})"
        raise type(error)(message, value=error.value, limit=error.limit, remedy=error.remedy, key=error.key) from None


def npy(path: Path) -> np.ndarray:
    """Array of an NPY file; ValueError if it holds Python objects, or less data than its header says.

    It is mapped before it is copied: a mapping is compared with the size of the file before memory is asked for.
    """
    return np.array(np.load(path, mmap_mode="r", allow_pickle=False))

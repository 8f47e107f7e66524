"""The checkpoint file: arrays and JSON that are read back bit by bit, or not at all.

It is an HDF5 file with an index (JSON, with the SHA-256 of every array), the arrays, and a flag that is written last.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon import kinds
from farhorizon.errors import FileFormatError, InputError
from farhorizon.files.hdf5 import check_version, directory_of, hdf5_file, opened, put_word, refuse_other_files, word_in
from farhorizon.files.storage import created

CHECKPOINT_FORMAT = "farhorizon checkpoint"
VERSION = 2


def _digest(data: bytes | np.ndarray) -> str:
    return hashlib.sha256(data if isinstance(data, bytes) else data.reshape(-1).view(np.uint8).data).hexdigest()


def write_checkpoint(path: str | Path, arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any]) -> None:
    """Write arrays of numbers, and values that JSON can represent; until the new file is complete and on disk, an older
    one stays as it is.
    """
    path = kinds.path(path, "path")
    directory_of(path)
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
    with created(path) as draft, hdf5_file(draft, "w") as file:
        file.attrs["version"], file.attrs["complete"] = VERSION, False
        for name, word in (("format", CHECKPOINT_FORMAT), ("sha256", _digest(index))):
            put_word(file.attrs, name, word)
        file.create_dataset("index", data=np.frombuffer(index, dtype=np.uint8))
        for number, array in enumerate(stored.values()):
            file.create_dataset(f"arrays/{number}", data=array)
        file.attrs.modify("complete", True)


def read_checkpoint(path: str | Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read arrays and values, and verify every byte; FileFormatError if the file is truncated, damaged, incomplete, of
    another version or foreign.
    """
    path = kinds.path(path, "path")
    remedy = "use an earlier checkpoint, or start the run anew"
    with opened(path, "r", "checkpoint") as file:
        refuse_other_files(file, path)
        if word_in(file.attrs, "format") != CHECKPOINT_FORMAT:
            raise FileFormatError(
                f"{path} is an HDF5 file, but not a farhorizon checkpoint",
                remedy="give a file written by Simulation.save",
            )
        check_version(path, int(file.attrs["version"]), VERSION, "go on with the version of farhorizon that wrote it")
        if not file.attrs["complete"]:
            raise FileFormatError(f"{path} is incomplete: its writing was interrupted", remedy=remedy)
        text = file["index"][:].tobytes()
        if _digest(text) != word_in(file.attrs, "sha256"):
            raise FileFormatError(f"{path} is damaged: its index fails its check sum", remedy=remedy)
        index, arrays = json.loads(text), {}
        for number, entry in enumerate(index["arrays"]):
            dataset, name = file[f"arrays/{number}"], entry["name"]
            alike = dataset.dtype.str == entry["dtype"] and dataset.shape == tuple(entry["shape"])
            arrays[name] = np.asarray(dataset[()]) if alike else np.empty(0)
            if not alike or _digest(arrays[name]) != entry["sha256"]:
                raise FileFormatError(f"{path} is damaged: array {name!r} fails its check sum", remedy=remedy)
    return arrays, index["meta"]

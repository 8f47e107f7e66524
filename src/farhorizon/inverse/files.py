"""The file of an inversion: an HDF5 file that is replaced as a whole after each step."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from farhorizon.errors import FileFormatError
from farhorizon.files.hdf5 import hdf5_file, opened
from farhorizon.files.storage import replacing

Arrays = dict[str, np.ndarray]
_KIND = "farhorizon inversion"


class Stored(NamedTuple):
    """What the file of an inversion holds: the digest of the problem, stage, iteration and misfit of each step, the
    maps after each step, and the unknowns after the last one.
    """

    digest: str
    history: list[tuple[Any, ...]]
    models: list[Arrays]
    change: np.ndarray


def digest_of(
    start: Arrays,
    bounds: Mapping[str, tuple[float, float]],
    region: np.ndarray,
    until: float,
    settings: Any,
    data: Iterable[np.ndarray],
) -> str:
    """Return a text that is the same for the same problem only: the same medium, data and settings."""
    digest = hashlib.sha256(repr((sorted(bounds.items()), until, settings)).encode())
    for name in sorted(start):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(start[name]).tobytes())
    for values in (region, *data):
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


def write_inversion(path: Path, stored: Stored) -> None:
    """Write the file, in place of one of that name."""
    with replacing(path) as draft, hdf5_file(draft, "w") as file:
        file.attrs["kind"], file.attrs["digest"] = _KIND, stored.digest
        file["history"] = np.array(stored.history, float).reshape(-1, 3)
        file["change"] = stored.change
        for name in stored.models[0]:
            file[f"models/{name}"] = np.stack([model[name] for model in stored.models])


def read_inversion(path: Path, digest: str) -> Stored | None:
    """Return what a file holds, None if there is none; a FileFormatError for a damaged file, or one of another program
    or problem.
    """
    if not path.exists():
        return None
    with opened(path, "r", "file of an inversion") as file:
        if file.attrs.get("kind") != _KIND or file.attrs.get("digest") != digest:
            raise FileFormatError(
                f"{path} is not the file of this inversion",
                value=str(file.attrs.get("kind", "an unknown file")),
                limit="the same start, data, bounds, region, frequencies and penalties",
                key="output",
                remedy="another name, or delete the file",
            )
        history = [(int(a), int(b), float(c)) for a, b, c in file["history"][()]]
        maps = {name: values[()] for name, values in file["models"].items()}
        models = [{name: values[i] for name, values in maps.items()} for i in range(len(history))]
        return Stored(digest, history, models, file["change"][()])

"""Results files in parts: one file for the whole, which shows the fields in others, each for a box of the lattice.

``NAME.h5`` contains everything but the fields. These are stored in ``NAME.h5.parts/0000.h5`` and so on, which are
results files of the boxes; in ``NAME.h5`` they are virtual datasets, which other programs read as a single one. We read
the parts themselves, so that their checksums are verified and their journals are taken into account.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

Box = Sequence[tuple[int, int]]  # first node and last node + 1 along each axis


def folder_of(path: Path) -> Path:
    """Folder of the parts of a results file."""
    return path.with_name(f"{path.name}.parts")


def part_path(path: Path, number: int) -> Path:
    """File of a part."""
    return folder_of(path) / f"{number:04d}.h5"


def parts_of(path: Path) -> list[Path]:
    """Parts in the folder of a results file, whichever run wrote them."""
    return sorted(part for part in folder_of(path).glob("*.h5") if re.fullmatch(r"\d{4,}", part.stem))


def make_room(path: Path, parts: int) -> None:
    """Create the folder for the parts of a new results file, and remove surplus parts of the one that it replaces;
    without parts, the folder is removed if it is empty.
    """
    folder = folder_of(path)
    if parts:
        folder.mkdir(exist_ok=True)
    for part in parts_of(path):
        if int(part.stem) >= parts:
            part.unlink()
    if not parts and folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def is_own(item: Any, path: Path) -> bool:
    """Whether everything that a virtual dataset shows is in our parts, under its own name."""
    ours = re.compile(re.escape(folder_of(path).name) + r"/\d{4,}\.h5")
    return all(ours.fullmatch(source.file_name) and source.dset_name == item.name for source in item.virtual_sources())


def stored_slices(shape: Sequence[int], box: Box) -> tuple[slice, ...]:
    """A box of nodes in a stored output of a scalar, whose axes are in VTK's order without slow ones of one node."""
    return tuple(slice(int(first), int(last)) for first, last in box[: len(shape)][::-1])


def lay_out(data: Any, name: str, path: Path, boxes: np.ndarray, outputs: int, vector: bool) -> None:
    """Make a dataset, which has the shape of the whole lattice's outputs, show those of its parts; nan where one is
    missing. The last axis of a vector is that of its components.
    """
    shape, dtype, place = data[name].shape[1:], data[name].dtype, data[name].name
    del data[name]
    if not outputs:
        data.create_dataset(name, (0, *shape), dtype)
        return
    layout, width = h5py.VirtualLayout((outputs, *shape), dtype), shape[len(shape) - vector :]
    for number, box in enumerate(boxes):
        along = stored_slices(shape[: len(shape) - vector], box)
        sizes = [part.stop - part.start for part in along]
        # one more row than is shown, so that a selection is taken, however many rows the part will have
        source = h5py.VirtualSource(
            part_path(path, number).relative_to(path.parent).as_posix(), place, (outputs + 1, *sizes, *width), dtype
        )
        layout[(slice(None), *along, *[slice(None)] * len(width))] = source[:outputs]
    data.create_virtual_dataset(name, layout, fillvalue=np.nan)

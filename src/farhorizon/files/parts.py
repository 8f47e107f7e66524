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
    return sorted(one for one in folder_of(path).glob("*.h5") if re.fullmatch(r"\d{4,}", one.stem))


def is_own(item: Any, path: Path) -> bool:
    """Whether everything that a virtual dataset shows is in our parts, under its own name."""
    own = re.compile(re.escape(folder_of(path).name) + r"/\d{4,}\.h5")
    return all(own.fullmatch(one.file_name) and one.dset_name == item.name for one in item.virtual_sources())


def lay_out(data: Any, name: str, path: Path, boxes: np.ndarray, outputs: int, vector: bool) -> None:
    """Make a field show the given number of outputs of its parts, nan where one is missing.

    Parameters
    ----------
    data : h5py.Group
    name : str
        A dataset in it, whose shape is that of the outputs of the complete lattice, with axes in VTK's order.
    path : Path
    boxes : ndarray of int, shape (parts, dim, 2)
    outputs : int
    vector : bool
        Whether the last axis is that of components.
    """
    shape, dtype, place = data[name].shape[1:], data[name].dtype, data[name].name
    del data[name]
    if not outputs:
        data.create_dataset(name, (0, *shape), dtype)
        return
    layout = h5py.VirtualLayout((outputs, *shape), dtype)
    width = shape[-1:] if vector else ()
    stored = len(shape) - len(width)  # number of axes: those with a single node may be omitted
    for number, box in enumerate(boxes):
        along = [slice(int(first), int(last)) for first, last in box[:stored][::-1]]
        sizes = [one.stop - one.start for one in along]
        # one more row than is shown, so that a selection is taken, however many rows the part will have
        source = h5py.VirtualSource(
            part_path(path, number).relative_to(path.parent).as_posix(), place, (outputs + 1, *sizes, *width), dtype
        )
        layout[(slice(None), *along, *[slice(None)] * len(width))] = source[:outputs]
    data.create_virtual_dataset(name, layout, fillvalue=np.nan)

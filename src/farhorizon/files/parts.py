"""A results file in parts: one file for the whole, which shows the fields of others, each of a box of the lattice.

``NAME.h5`` has all but the fields. These stand in ``NAME.h5.parts/0000.h5`` and so on, results files of the boxes; in
``NAME.h5`` they are virtual datasets, by which other programs read them as one. We read the parts themselves, so that
their check sums and journals count.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

Box = Sequence[tuple[int, int]]  # along each axis the first node and the last + 1


def folder_of(path: Path) -> Path:
    """The folder of the parts of a results file."""
    return path.with_name(f"{path.name}.parts")


def part_path(path: Path, number: int) -> Path:
    """The file of a part."""
    return folder_of(path) / f"{number:04d}.h5"


def parts_of(path: Path) -> list[Path]:
    """The parts that lie beside a results file, whatever run wrote them."""
    return sorted(one for one in folder_of(path).glob("*.h5") if re.fullmatch(r"\d{4,}", one.stem))


def is_own(item: Any, path: Path) -> bool:
    """Whether all that a virtual dataset shows lies in our parts, under its own name."""
    own = re.compile(re.escape(folder_of(path).name) + r"/\d{4,}\.h5")
    return all(own.fullmatch(one.file_name) and one.dset_name == item.name for one in item.virtual_sources())


def lay_out(data: Any, name: str, path: Path, boxes: np.ndarray, outputs: int, vector: bool) -> None:
    """Let a field of a group of fields show so many outputs of its parts, nan where one is missing.

    Parameters
    ----------
    data : h5py.Group
    name : str
        A dataset in it, whose shape is that of outputs of the whole, the axes in VTK's order.
    path : Path
    boxes : ndarray of int, shape (parts, dim, 2)
    outputs : int
    vector : bool
        Whether components are the last axis.
    """
    shape, dtype, place = data[name].shape[1:], data[name].dtype, data[name].name
    del data[name]
    if not outputs:
        data.create_dataset(name, (0, *shape), dtype)
        return
    layout = h5py.VirtualLayout((outputs, *shape), dtype)
    width = shape[-1:] if vector else ()
    stored = len(shape) - len(width)  # axes: those of a single node may be left out
    for number, box in enumerate(boxes):
        along = [slice(int(first), int(last)) for first, last in box[:stored][::-1]]
        sizes = [one.stop - one.start for one in along]
        # one more row than is shown: what is taken of a part is a selection, however many rows it comes to have
        source = h5py.VirtualSource(
            part_path(path, number).relative_to(path.parent).as_posix(), place, (outputs + 1, *sizes, *width), dtype
        )
        layout[(slice(None), *along, *[slice(None)] * len(width))] = source[:outputs]
    data.create_virtual_dataset(name, layout, fillvalue=np.nan)

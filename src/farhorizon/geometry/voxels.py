"""Regions made of cells: masks, label images, stacks of images."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import Length, OneOf, Point, Toml
from farhorizon.errors import InputError
from farhorizon.files.foreign import naming, npy, reading
from farhorizon.geometry.shapes import TOLERANCE, Array, Mask, Shape, constant

_File = Annotated[
    Path, 'Path of an array such as "grains.npy", or of a TIFF image or stack of images, relative to the case file.'
]
_LISTED = 12  # labels in a message


class Voxels(Shape):
    """Cells of a regular grid, such as a mask, a label image or a tomogram; its size is the longest edge of the grid.

    Parameters
    ----------
    voxels : str, Path or ndarray of bool or integers, shape (nx[, ny[, nz]])
        The axes are those of space, in this order, as in a field of a run; or an NPY file of such an array; or a TIFF
        file, whose columns run along x, rows down y, and pages, if there are several, along z.
    size : float
        Edge length of a cell.
    lower : array_like, shape (dim,), optional
        Lower corner of the grid; unless given, the grid is centred at the origin.
    labels : int or sequence of int, optional
        Values of the cells that belong to the shape; all except 0 unless given.

    Attributes
    ----------
    voxels : ndarray of bool
        The cells that belong to the shape.

    Raises
    ------
    InputError
        A file that cannot be read, an array of other numbers, a label that no cell has, no selected cell.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> grains = np.array([[1, 1], [2, 0]])  # x = -0.5 first
    >>> fh.Voxels(grains, size=1.0, labels=1).contains([(-0.5, 0.5), (0.5, -0.5)])
    array([ True, False])
    """

    _shown = ("size", "lower")

    def __init__(
        self,
        voxels: Annotated[str | Path | np.ndarray, OneOf(file=_File)],
        size: Length,
        lower: Point | None = None,
        labels: Annotated[int | Sequence[int] | None, Toml(list[int])] = None,
    ) -> None:
        with naming(voxels):
            given = _read(Path(voxels)) if isinstance(voxels, str | Path) else voxels
            if not isinstance(given, np.ndarray) or given.dtype.kind not in "biu" or given.ndim not in (1, 2, 3):
                raise InputError(
                    "voxels are a file, or an array of bool or whole numbers",
                    value=kinds.said(given),
                    limit="one to three axes",
                    key="voxels",
                )
            self.voxels, self.labels = _taken(given, labels), None
            if not self.voxels.any():
                raise InputError("no voxel is taken", value="all are 0", key="voxels", remedy="other labels")
        self.size = kinds.number(size, "size", above=0)
        self.dim = given.ndim
        extent = self.size * np.array(given.shape)
        self.lower = constant(
            "lower", -extent / 2 if lower is None else np.atleast_1d(kinds.array(lower, "lower")), (self.dim,)
        )

    def bounds(self) -> tuple[Array, Array]:
        along = [np.flatnonzero(self.voxels.any(tuple(set(range(self.dim)) - {axis}))) for axis in range(self.dim)]
        low, high = np.array([planes[0] for planes in along]), np.array([planes[-1] + 1 for planes in along])
        return self.lower + self.size * low, self.lower + self.size * high

    def _contains(self, points: Array) -> Mask:
        place, shape = (points - self.lower) / self.size, np.array(self.voxels.shape)
        slack = TOLERANCE * shape.max()
        contained = np.zeros(points.shape[:-1], bool)
        for aside in itertools.product((-slack, slack), repeat=self.dim):  # a face belongs to the cells on both sides
            cell = np.floor(place + np.array(aside)).astype(np.int64)
            in_array = ((cell >= 0) & (cell < shape)).all(-1)
            contained[in_array] |= self.voxels[tuple(cell[in_array].T)]
        return contained


def _taken(cells: np.ndarray, labels: Any) -> Mask:
    """Mask of the cells with the given labels, or of all that are not zero."""
    if labels is None:
        return cells != 0
    chosen = kinds.array([labels] if isinstance(labels, int | np.integer) else labels, "labels", shape=(None,))
    present = np.unique(cells)
    missing = sorted(set(chosen.tolist()) - set(present.tolist()))
    if missing or not chosen.size:
        listed = ", ".join(map(str, present[:_LISTED].tolist())) + ", ..." * (len(present) > _LISTED)
        raise InputError("no voxel has this label", value=missing, limit=listed, key="labels")
    return np.isin(cells, chosen)


def _read(path: Path) -> np.ndarray:
    """The array in a file, with its axes in the order of space."""
    remedy = "an NPY file of bool or whole numbers, or a TIFF file of grey values or labels"
    readers = {".npy": npy, ".tif": _pages, ".tiff": _pages}
    if path.suffix.lower() not in readers:
        raise InputError("unknown kind of voxel file", value=path.name, limit=".npy, .tif", key="voxels", remedy=remedy)
    with reading(path, "the voxels", "voxels", remedy):
        return readers[path.suffix.lower()](path)


def _pages(path: Path) -> np.ndarray:
    from PIL import Image, ImageSequence

    with Image.open(path) as image:
        pages = np.stack([np.asarray(page) for page in ImageSequence.Iterator(image)])
    if pages.ndim != 3:
        raise ValueError("its pages have colours")
    voxels = pages.transpose(2, 1, 0)[:, ::-1]  # columns, rows from below, pages
    return voxels[..., 0] if len(pages) == 1 else voxels

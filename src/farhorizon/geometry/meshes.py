"""Bodies in space bounded by a surface of triangles."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import OneOf, Point
from farhorizon.errors import InputError
from farhorizon.files.foreign import naming
from farhorizon.files.triangles import read_triangles
from farhorizon.geometry.shapes import TOLERANCE, Array, Mask, Shape, constant

_File = Annotated[Path, 'Path of a closed surface (STL, OBJ, PLY), relative to the case file, such as "part.stl".']
_SAME = 1e-6  # of the size: corners closer than this are the same, since STL does not number them


class Mesh(Shape):
    """The region enclosed by a closed surface of triangles; its size is the longest edge of its bounding box.

    A point is inside if a ray from it crosses an odd number of triangles, so that cavities are described by inner
    surfaces.

    Parameters
    ----------
    triangles : str, Path, (vertices, faces), or array_like of shape (n, 3, 3)
        An STL, OBJ or PLY file; or points of shape (m, 3) and the three point indices of each triangle, as in meshio,
        trimesh and Gmsh; or the corners themselves.
    scale : float
        Factor on the coordinates: 1e-3 converts a drawing in millimetres to metres.
    centre : array_like, shape (3,), optional
        Point to which the centre of the bounding box is moved; it is not moved unless this is given.

    Attributes
    ----------
    triangles : ndarray, shape (n, 3, 3)
        Corners, scaled and moved.

    Raises
    ------
    InputError
        A file that cannot be read, a surface that is not closed, values that are not positive or not finite.

    Examples
    --------
    >>> import farhorizon as fh
    >>> corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    >>> tetrahedron = fh.Mesh((corners, [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)]))
    >>> tetrahedron.contains([(0.2, 0.2, 0.2), (0.5, 0.5, 0.5)])
    array([ True, False])
    """

    dim = 3
    _shown = ("scale", "centre")

    def __init__(
        self, triangles: Annotated[Any, OneOf(file=_File)], scale: float = 1.0, centre: Point | None = None
    ) -> None:
        factor = kinds.number(scale, "scale", above=0)
        with naming(triangles):
            corners = factor * _corners(triangles)
            constant("triangles", corners)
            lower, upper = corners.min((0, 1)), corners.max((0, 1))
            if not (upper > lower).all():
                raise InputError("the surface is flat", value=(upper - lower).tolist(), key="mesh")
            _check_closed(corners, float((upper - lower).max()))
        if centre is not None:
            corners = corners + (constant("centre", centre, (3,)) - (lower + upper) / 2)
        # scaled and moved already, so that the same arguments give the same shape again
        self.triangles, self.scale, self.centre = corners, 1.0, None

    def __repr__(self) -> str:
        lower, upper = self.bounds()
        return f"Mesh({len(self.triangles)} triangles from {lower.tolist()} to {upper.tolist()})"

    def bounds(self) -> tuple[Array, Array]:
        return self.triangles.min((0, 1)), self.triangles.max((0, 1))

    def _contains(self, points: Array) -> Mask:
        lower, upper = self.bounds()
        slack = TOLERANCE * float((upper - lower).max())
        flat = points.reshape(-1, 3)
        near = ((flat >= lower - slack) & (flat <= upper + slack)).all(1)
        inside = np.zeros(len(flat), bool)
        columns, of = np.unique(flat[near, :2], axis=0, return_inverse=True)
        height = flat[near, 2]
        odd = np.zeros(len(height), bool)
        # A ray through an edge or a corner may meet two triangles or none. So each ray is displaced to all sides, and a
        # point on the surface is inside for one of them.
        for aside in ((1, 0.618), (-1, 0.618), (0.618, -1), (-0.618, -1)):
            met = self._met(columns + slack * np.array(aside))
            for z in (height - slack, height + slack):
                odd |= _odd_above(met, of.reshape(-1), z)
        inside[near] = odd
        return inside.reshape(points.shape[:-1])

    def _met(self, columns: Array) -> np.ndarray:
        """Sorted points where vertical lines meet the surface: numbers of the lines + 1j * heights."""
        met = [np.zeros(0, complex)]
        low, high = self.triangles[..., :2].min(1), self.triangles[..., :2].max(1)
        first = np.searchsorted(columns[:, 0], low[:, 0], "left")
        last = np.searchsorted(columns[:, 0], high[:, 0], "right")
        for number in np.flatnonzero(last > first):
            a, b, c = self.triangles[number]
            near = np.arange(first[number], last[number])
            x, y = columns[near].T
            edges = [
                (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]) for p, q in ((b, c), (c, a), (a, b))
            ]  # twice the areas opposite to a, b and c
            positive = [edge > 0 for edge in edges]
            through = (positive[0] == positive[1]) & (positive[1] == positive[2])
            area = sum(edges)[through]
            heights = sum(edge[through] * corner[2] for edge, corner in zip(edges, (a, b, c), strict=True)) / area
            met.append(near[through] + 1j * heights)
        return np.sort(np.concatenate(met))


def _corners(given: Any) -> Array:
    """Corners of the triangles given in any of the accepted forms, shape (n, 3, 3)."""
    if isinstance(given, str | Path):
        return read_triangles(Path(given))
    if isinstance(given, tuple) and len(given) == 2:
        points = kinds.array(given[0], "mesh", shape=(None, 3))
        faces = kinds.array(given[1], "mesh", shape=(None, 3))
        if not ((faces >= 0) & (faces < len(points)) & (faces == np.floor(faces))).all():
            raise InputError(
                "faces have the numbers of points",
                limit=f"0 to {len(points) - 1}, whole",
                key="mesh",
                remedy="count from 0",
            )
        return points[faces.astype(int)]
    return kinds.array(given, "mesh", shape=(None, 3, 3))


def _check_closed(corners: Array, size: float) -> None:
    """Refuse a surface in which an edge belongs to an odd number of triangles."""
    _, points = np.unique(np.round(corners.reshape(-1, 3) / (_SAME * size)), axis=0, return_inverse=True)
    faces = points.reshape(-1, 3)
    faces = faces[(faces != np.roll(faces, 1, 1)).all(1)]  # without degenerate faces
    edges = np.sort(np.stack([faces, np.roll(faces, -1, 1)], -1).reshape(-1, 2), 1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    open_edges = int((counts % 2).sum())
    if open_edges:
        raise InputError(
            "the surface is not closed (watertight)",
            value=f"{open_edges} edges with an odd number of triangles",
            limit="two triangles at each edge",
            key="mesh",
            remedy="close its holes in the program that made it, or by trimesh.repair.fill_holes or MeshLab",
        )


def _odd_above(met: np.ndarray, column: np.ndarray, height: Array) -> Mask:
    """Whether the surface is met an odd number of times above points in the given columns."""
    last = np.searchsorted(met, column + complex(0, np.inf), "right")
    return (last - np.searchsorted(met, column + 1j * height, "right")) % 2 == 1

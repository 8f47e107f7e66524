"""Regions covered by volume meshes, such as those of Gmsh: triangles in the plane, tetrahedra in space."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from scipy.spatial import cKDTree

from farhorizon import kinds
from farhorizon.arguments import OneOf
from farhorizon.errors import InputError
from farhorizon.files.foreign import naming, reading
from farhorizon.geometry.shapes import TOLERANCE, Array, Mask, Shape, constant
from farhorizon.rounding import TINY

_File = Annotated[Path, 'Path of a Gmsh mesh (MSH 4.1), relative to the case file, such as "part.msh".']
_CORNERS = {"triangle": 3, "triangle6": 3, "tetra": 4, "tetra10": 4}  # the nodes in the middle of edges follow them
_DIMENSION = {"triangle": 2, "triangle6": 2, "tetra": 3, "tetra10": 3}
_CHUNK = 4096  # elements that are processed together
_FLAT = 1e-9  # of the extent: largest range of heights of a mesh in the plane


class Elements(Shape):
    """The region covered by the triangles of a 2D mesh or the tetrahedra of a 3D mesh; its size is the longest edge of
    its bounding box.

    Parameters
    ----------
    elements : str, Path, (points, elements), or array_like of shape (n, dim + 1, dim)
        A Gmsh file (MSH 4.1, or another format of meshio), which requires ``pip install 'farhorizon[gmsh]'``; or points
        and the point indices of each element's corners; or the corners themselves. For second-order elements only the
        corners are used.
    group : str, optional
        Name of the physical group of a file to be used; all elements of the highest dimension unless given.
    scale : float
        Factor on the coordinates: 1e-3 converts a drawing in millimetres to metres.

    Attributes
    ----------
    elements : ndarray, shape (n, dim + 1, dim)
        Corners, scaled.

    Raises
    ------
    InputError
        A file that cannot be read, a group that it does not have, no triangles or tetrahedra, meshio not installed.

    Examples
    --------
    >>> import farhorizon as fh
    >>> square = fh.Elements(([(0, 0), (1, 0), (1, 1), (0, 1)], [(0, 1, 2), (0, 2, 3)]))
    >>> square.contains([(0.5, 0.25), (1.5, 0.5)])
    array([ True, False])
    """

    _shown = ("scale",)

    def __init__(
        self, elements: Annotated[Any, OneOf(file=_File)], group: str | None = None, scale: float = 1.0
    ) -> None:
        factor = kinds.number(scale, "scale", above=0)
        name = None if group is None else kinds.text(group, "group")
        if name is not None and not isinstance(elements, str | Path):
            raise InputError("only files have groups", value=name, key="group", remedy="the elements of the group")
        given = _read(Path(elements), name) if isinstance(elements, str | Path) else elements
        with naming(elements):
            corners = _corners(given)
            # scaled already, so that the same arguments give the same shape again
            self.elements, self.group, self.scale = constant("elements", factor * corners), None, 1.0
        self.dim = corners.shape[-1]

    def __repr__(self) -> str:
        lower, upper = self.bounds()
        return f"Elements({len(self.elements)} elements from {lower.tolist()} to {upper.tolist()})"

    def bounds(self) -> tuple[Array, Array]:
        return self.elements.min((0, 1)), self.elements.max((0, 1))

    def _contains(self, points: Array) -> Mask:
        flat, contained = points.reshape(-1, self.dim), np.zeros(points[..., 0].size, bool)
        lower, upper = self.bounds()
        slack = TOLERANCE * float((upper - lower).max())
        tree = cKDTree(flat)
        for first in range(0, len(self.elements), _CHUNK):
            chunk = self.elements[first : first + _CHUNK]
            middle = chunk.mean(1)
            radius = np.linalg.norm(chunk - middle[:, None], axis=-1).max(1) + slack
            near = tree.query_ball_point(middle, radius)
            counts = np.array([len(indices) for indices in near])
            which = np.repeat(np.arange(len(chunk)), counts)
            numbers = np.array([k for indices in near for k in indices], dtype=np.int64)
            inside = _within(chunk, which, flat[numbers], slack)
            contained[numbers[inside]] = True
        return contained.reshape(points.shape[:-1])


def _within(elements: Array, which: np.ndarray, points: Array, slack: float) -> Mask:
    """Whether points lie in given elements, one for each point, or within `slack` of their faces."""
    edges = elements[:, 1:] - elements[:, :1]
    volume = np.linalg.det(edges)
    solid = np.abs(volume) > 0
    inverse = np.linalg.inv(np.where(solid[:, None, None], edges, np.eye(edges.shape[-1])))
    coordinates = np.einsum(
        "ni,nij->nj", points - elements[which, 0], inverse[which]
    )  # barycentric, of all corners but the first
    slopes = np.concatenate([inverse, -inverse.sum(2, keepdims=True)], axis=2)
    reach = slack * np.linalg.norm(slopes, axis=1)[which]  # change of the coordinates over a distance of slack
    coordinates = np.concatenate([coordinates, 1 - coordinates.sum(1, keepdims=True)], axis=1)
    return np.asarray((coordinates >= -reach).all(1) & solid[which])


def _corners(given: Any) -> Array:
    """Corners of the elements given in any of the accepted forms, shape (n, dim + 1, dim)."""
    if isinstance(given, tuple) and len(given) == 2:
        points = kinds.array(given[0], "elements", shape=(None, None))
        numbers = kinds.array(given[1], "elements", shape=(None, points.shape[1] + 1))
        if not ((numbers >= 0) & (numbers < len(points)) & (numbers == np.floor(numbers))).all():
            raise InputError(
                "elements have the numbers of points",
                limit=f"0 to {len(points) - 1}, whole",
                key="elements",
                remedy="count from 0",
            )
        corners = points[numbers.astype(int)]
    else:
        corners = kinds.array(given, "elements", shape=(None, None, None))
    count, width, dim = corners.shape
    if not count or dim not in (2, 3) or width != dim + 1:
        raise InputError(
            "elements are triangles in 2D or tetrahedra in 3D",
            value=f"shape {corners.shape}",
            limit="(n, 3, 2) or (n, 4, 3)",
            key="elements",
        )
    return corners


def _read(path: Path, group: str | None) -> tuple[Array, Array]:
    """Points of a file, and the corners of its elements, or of those of one of its physical groups if it is named."""
    try:
        import meshio
    except ImportError as error:
        raise InputError(
            "meshio is not installed", value=path.name, key="elements", remedy="pip install 'farhorizon[gmsh]'"
        ) from error
    with reading(path, "the mesh", "elements", "a mesh that Gmsh has saved in its format MSH 4.1"):
        mesh = meshio.read(path)
    groups = {name: int(entry[0]) for name, entry in mesh.field_data.items()}
    spans = {name: int(entry[1]) for name, entry in mesh.field_data.items()}
    volumes = [name for name in groups if spans[name] > 1]
    if group is not None and group not in groups:
        raise InputError(
            "the mesh has no physical group of this name",
            value=group,
            limit=", ".join(volumes) or "none has a name",
            key="group",
        )
    tags = mesh.cell_data.get("gmsh:physical", [None] * len(mesh.cells))
    by_dim: dict[int, list[np.ndarray]] = {}
    for block, tag in zip(mesh.cells, tags, strict=True):
        dim = _DIMENSION.get(block.type)
        chosen = slice(None) if group is None or tag is None else np.asarray(tag) == groups[group]
        if dim is not None and (group is None or (dim == spans[group] and tag is not None)):
            by_dim.setdefault(dim, []).append(np.asarray(block.data)[chosen][:, : _CORNERS[block.type]])
    dim = max((axes for axes, blocks in by_dim.items() if sum(map(len, blocks))), default=0)
    if not dim:
        types = ", ".join(sorted({block.type for block in mesh.cells})) or "nothing"
        what = "the mesh" if group is None else f"the group {group!r}"
        raise InputError(
            f"{what} has no triangles and no tetrahedra",
            value=f"{path.name}: {types}",
            key="elements" if group is None else "group",
            remedy="mesh the surface or the volume, and save all elements",
        )
    points, numbers = np.asarray(mesh.points, float), np.concatenate(by_dim[dim])
    if dim == 3 or points.shape[1] == 2:
        return points, numbers
    with naming(path):
        corners = _corners((points[:, :2], numbers))
        heights = kinds.array(points[numbers, 2], "elements")
    if np.ptp(heights) > _FLAT * max(float(np.ptp(corners)), float(np.ptp(heights)), TINY):
        raise InputError(
            "triangles in 3D are a surface, and cover no volume",
            value=path.name,
            key="elements",
            remedy="mesh = {...} takes a closed surface; tetrahedra cover a volume",
        )
    return points[:, :2], numbers

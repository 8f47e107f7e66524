"""Regions of space that select nodes, and flat cuts that sever bonds.

**Regions.** A node within 1e-9 of a shape's size of its surface counts as inside, so that a disc through lattice nodes
holds them all whatever the rounding.

**Cuts.** Every cut is flat (a point on a line, a segment in the plane, a rectangle or a disc in space) and its plane
has a side that its normal points to. A bond is cut if its ends lie on different sides and it meets the closed flat
region, to 1e-9 of the bond's length: a bond that grazes a tip or an edge is cut. A node on the plane, to the same
tolerance, lies on the normal's side, as if the cut were shifted by an infinitesimal amount against its normal: a crack
through nodes cuts their bonds to one side only, and bonds in the plane of the crack stay whole.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from farhorizon import kinds
from farhorizon.arguments import Length, Point, Points, Registered, Toml
from farhorizon.errors import InputError
from farhorizon.files.storable import Storable

__all__ = [
    "Ball",
    "Box",
    "Cut",
    "Difference",
    "Disc",
    "DiscCut",
    "Intersection",
    "PointCut",
    "Polygon",
    "Polyline",
    "Rectangle",
    "Shape",
    "Union",
    "segments_cross",
]

_CORNERS = 49  # of a circle in pictures and files
TOLERANCE = 1e-9
"""Tolerance relative to the size of a shape, or to the length of a bond."""

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def constant(name: str, value: ArrayLike, shape: tuple[int | None, ...] | None = None) -> Array:
    """Return finite coordinates as a read-only array."""
    array = np.array(kinds.array(value, name, shape=shape))
    if (np.abs(array) > kinds.LARGEST).any():
        raise InputError(
            "is beyond what can be computed with",
            value=value,
            limit=f"{kinds.LARGEST:g} in magnitude",
            key=name,
            remedy="other units",
        )
    array.setflags(write=False)
    return array


def _points(name: str, value: ArrayLike, least: int, dim: int = 2) -> Array:
    array = constant(name, value)
    if array.ndim != 2 or array.shape[1] != dim or len(array) < least:
        raise InputError(
            f"needs at least {least} points of {dim} coordinates", value=value, limit=f"shape (n, {dim})", key=name
        )
    return array


def _trailing(name: str, value: ArrayLike, dim: int) -> Array:
    array = kinds.array(value, name, finite=False)
    if array.ndim == 0 or array.shape[-1] != dim:
        raise InputError(f"the last axis must have length {dim}", value=f"shape {array.shape}", key=name)
    return array


def _dot(a: Array, b: Array) -> Array:
    # Term by term: a matrix product may round the same row differently from place to place, and a bond must not depend
    # on its place.
    return np.asarray(sum(a[..., i] * b[..., i] for i in range(a.shape[-1])))


def _norm(a: Array) -> Array:
    return np.sqrt(_dot(a, a))


class _Described(Storable):
    _shown: tuple[str, ...] = ()

    def __repr__(self) -> str:
        values = (getattr(self, name) for name in self._shown)
        shown = (v.tolist() if isinstance(v, np.ndarray) else v for v in values)
        return f"{type(self).__name__}({', '.join(f'{n}={v!r}' for n, v in zip(self._shown, shown, strict=True))})"


class Shape(Registered, _Described):
    """A region of space. Shapes can be combined by ``|`` (union), ``&`` (intersection) and ``-`` (difference).

    Attributes
    ----------
    dim : int
        Number of coordinates.
    tag : str
        Its key in the table of a region in a case file, with underscores: ``HollowDisc`` is "hollow-disc", its key
        ``hollow_disc``.
    known : dict of str to type
        All shapes that a case file can name, including user-defined ones.

    Examples
    --------
    >>> import farhorizon as fh
    >>> ring = fh.Disc(2.0) - fh.Disc(1.0)
    >>> isinstance(ring, fh.Shape), ring.contains([(1.5, 0.0), (0.5, 0.0)])
    (True, array([ True, False]))
    """

    known: ClassVar[dict[str, type[Shape]]] = {}
    dim: int

    def contains(self, points: ArrayLike) -> Mask:
        """Determine which points lie inside.

        Parameters
        ----------
        points : array_like, shape (..., dim)
            Coordinates.

        Returns
        -------
        ndarray of bool, shape (...)
            True inside and, to within 1e-9 of the shape's size, on the surface.

        Raises
        ------
        InputError
            If the last axis of `points` is not `dim` long.
        """
        return self._contains(_trailing("points", points, self.dim))

    def bounds(self) -> tuple[Array, Array]:
        """Return the smallest and the largest coordinates.

        Returns
        -------
        lower, upper : ndarray, shape (dim,)
            Corners of a box that contains the shape.
        """
        raise NotImplementedError

    def _contains(self, points: Array) -> Mask:
        raise NotImplementedError

    def __or__(self, other: Shape) -> Union:
        return Union(self, other) if isinstance(other, Shape) else NotImplemented

    def __and__(self, other: Shape) -> Intersection:
        return Intersection(self, other) if isinstance(other, Shape) else NotImplemented

    def __sub__(self, other: Shape) -> Difference:
        return Difference(self, other) if isinstance(other, Shape) else NotImplemented


class _Round(Shape, offered=False):
    _shown = ("radius", "centre")

    def __init__(self, radius: Length, centre: Point | None = None) -> None:
        self.radius = kinds.number(radius, "radius", above=0)
        self.centre = constant("centre", np.zeros(self.dim) if centre is None else centre, (self.dim,))

    def bounds(self) -> tuple[Array, Array]:
        return self.centre - self.radius, self.centre + self.radius

    def _contains(self, points: Array) -> Mask:
        return _norm(points - self.centre) <= self.radius * (1 + TOLERANCE)


class Disc(_Round):
    """A closed disc in 2D; its size is the radius.

    Parameters
    ----------
    radius : float
        Radius of the disc, greater than zero.
    centre : array_like, shape (2,), optional
        Centre of the disc; the origin unless given.

    Raises
    ------
    InputError
        For a radius that is not positive, or values that are not finite or of the wrong length.

    Examples
    --------
    >>> import farhorizon as fh
    >>> fh.Disc(2.0, (1.0, 0.0)).contains([(2.9, 0.0), (-1.1, 0.0)])
    array([ True, False])
    """

    dim = 2


class Ball(_Round):
    """A closed ball in 3D; its size is the radius.

    Parameters
    ----------
    radius : float
        Radius of the ball, greater than zero.
    centre : array_like, shape (3,), optional
        Centre of the ball; the origin unless given.

    Raises
    ------
    InputError
        For a radius that is not positive, or values that are not finite or of the wrong length.

    Examples
    --------
    >>> import farhorizon as fh
    >>> fh.Ball(2.0).contains([(1.0, 1.0, 1.0), (2.0, 1.0, 0.0)])
    array([ True, False])
    """

    dim = 3


class Box(Shape):
    """A closed interval, rectangle or cuboid along the axes; its size is its longest edge.

    Parameters
    ----------
    lower, upper : array_like, shape (dim,)
        Smallest and largest coordinate along each of one to three axes (plain numbers in 1D); `upper` is the greater.

    Raises
    ------
    InputError
        For corners that are not finite, of different or wrong length, or in the wrong order.

    Examples
    --------
    >>> import farhorizon as fh
    >>> hole = fh.Box((0.0, 0.0), (2.0, 1.0)) - fh.Disc(0.5, (1.0, 0.5))
    >>> hole.contains([(0.25, 0.5), (1.0, 0.5)])
    array([ True, False])
    """

    _shown = ("lower", "upper")

    def __init__(self, lower: Point, upper: Point) -> None:
        first = np.atleast_1d(constant("lower", lower))
        if first.ndim != 1 or len(first) not in (1, 2, 3):
            raise InputError("lower needs 1 to 3 coordinates", value=lower)
        self.dim = len(first)
        self.lower = first
        self.upper = constant("upper", np.atleast_1d(constant("upper", upper)), (self.dim,))
        if not (self.upper > self.lower).all():
            shown = f"lower {self.lower.tolist()}, upper {self.upper.tolist()}"
            raise InputError(
                "every coordinate of upper must be greater than that of lower",
                value=shown,
                limit="upper > lower",
                key="upper",
                remedy="exchange them",
            )

    def bounds(self) -> tuple[Array, Array]:
        return self.lower.copy(), self.upper.copy()

    def _contains(self, points: Array) -> Mask:
        slack = TOLERANCE * (self.upper - self.lower).max()
        inside: Mask = ((points >= self.lower - slack) & (points <= self.upper + slack)).all(axis=-1)
        return inside


class Polygon(Shape):
    """A closed polygon in 2D; its size is the longer edge of its bounding box.

    A point is inside if a ray from it crosses an odd number of edges (where the polygon crosses itself, doubly enclosed
    parts are outside). A point within 1e-9 of the size from an edge or corner counts as inside, whichever edge it is.

    Parameters
    ----------
    points : array_like, shape (n, 2)
        The corners in order, n >= 3, clockwise or anticlockwise; the last may repeat the first.

    Raises
    ------
    InputError
        For fewer than 3 different corners, corners on one line, equal neighbours, or coordinates that are not finite.

    Examples
    --------
    >>> import farhorizon as fh
    >>> fh.Polygon([(0.0, 0.0), (2.0, 0.0), (0.0, 2.0)]).contains([(0.5, 0.5), (1.5, 1.5)])
    array([ True, False])
    """

    dim = 2
    _shown = ("points",)

    def __init__(self, points: Points) -> None:
        corners = _points("points", points, 3)
        if (corners[0] == corners[-1]).all():
            corners = _points("points", corners[:-1], 3)
        if (_norm(np.roll(corners, -1, axis=0) - corners) == 0).any():
            raise InputError("two neighbouring corners of the polygon are equal", value=points)
        self.points = corners
        spread = np.linalg.svd(corners - corners.mean(axis=0), compute_uv=False)
        if spread[1] <= TOLERANCE * spread[0]:
            raise InputError("the corners of the polygon lie on one line", value=points)

    def bounds(self) -> tuple[Array, Array]:
        return self.points.min(axis=0), self.points.max(axis=0)

    def _contains(self, points: Array) -> Mask:
        lower, upper = self.bounds()
        odd, on_edge = polygon_side(points, self.points, TOLERANCE * (upper - lower).max())
        return odd | on_edge


def polygon_side(points: Array, corners: Array, slack: float) -> tuple[Mask, Mask]:
    """The points (..., 2) from which a ray crosses an odd number of the edges of a polygon with corners (n, 2), and
    those within `slack` of an edge.
    """
    odd = np.zeros(points.shape[:-1], dtype=bool)
    on_edge = np.zeros_like(odd)
    x, y = points[..., 0], points[..., 1]
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        edge = b - a
        if not edge.any():
            continue
        nearest = np.clip(_dot(points - a, edge) / _dot(edge, edge), 0.0, 1.0)
        on_edge |= _norm(points - a - nearest[..., None] * edge) <= slack
        # Half-open in y, so that a ray through a corner meets one of its two edges, or both or none where it only
        # touches.
        spans = (a[1] > y) != (b[1] > y)
        if edge[1]:
            odd ^= spans & (x < a[0] + (y - a[1]) * (edge[0] / edge[1]))
    return odd, on_edge


class _Pair(Shape, offered=False):
    _shown = ("first", "second")

    def __init__(self, first: Shape, second: Shape) -> None:
        for name, shape in (("first", first), ("second", second)):
            kinds.instance(shape, name, Shape, "a shape")
        if first.dim != second.dim:
            raise InputError(
                "shapes of different dimensions cannot be combined", value=f"{first.dim}D and {second.dim}D"
            )
        self.first, self.second, self.dim = first, second, first.dim


class Union(_Pair, offered=False):
    """The region that lies in either of two shapes: ``first | second``.

    Parameters
    ----------
    first, second : Shape
        Of the same dimension, else InputError.
    """

    def bounds(self) -> tuple[Array, Array]:
        (a, b), (c, d) = self.first.bounds(), self.second.bounds()
        return np.minimum(a, c), np.maximum(b, d)

    def _contains(self, points: Array) -> Mask:
        return self.first._contains(points) | self.second._contains(points)


class Intersection(_Pair, offered=False):
    """The region that lies in both of two shapes: ``first & second``.

    Parameters
    ----------
    first, second : Shape
        Of the same dimension, with bounds that meet, else InputError.
    """

    def __init__(self, first: Shape, second: Shape) -> None:
        super().__init__(first, second)
        lower, upper = self.bounds()
        if (upper < lower).any():
            raise InputError("the shapes do not meet, their intersection is empty", value=f"{first!r}, {second!r}")

    def bounds(self) -> tuple[Array, Array]:
        (a, b), (c, d) = self.first.bounds(), self.second.bounds()
        return np.maximum(a, c), np.minimum(b, d)

    def _contains(self, points: Array) -> Mask:
        return self.first._contains(points) & self.second._contains(points)


class Difference(_Pair, offered=False):
    """The region that lies in the first shape and not in the second: ``first - second``.

    The surface of the second shape belongs to the second: a node on the edge of a hole is removed.

    Parameters
    ----------
    first, second : Shape
        Of the same dimension, else InputError.
    """

    def bounds(self) -> tuple[Array, Array]:
        return self.first.bounds()

    def _contains(self, points: Array) -> Mask:
        return self.first._contains(points) & ~self.second._contains(points)


# Determines which of the points where bonds cross the plane of a cut lie in its flat region. Arguments: the points
# relative to the origin of the cut, how far each would move if the plane were shifted by one unit against its normal,
# and the tolerance of each bond.
_Region = Callable[[Array, Array, Array], Mask]


def _planar_cut(start: Array, end: Array, origin: Array, normal: Array, region: _Region) -> Mask:
    """Determine which bonds a flat cut severs, in any dimension, by the rule at the head of this module.

    Every formula is symmetric in start and end to the last bit, so a bond and its reverse always agree.
    """
    slack = TOLERANCE * _norm(end - start)

    def height(nodes: Array) -> Array:
        distance = _dot(nodes - origin, normal)
        return np.where(np.abs(distance) <= slack, 0.0, distance)

    above, below = height(start), height(end)
    cut: Mask = (above >= 0) != (below >= 0)
    # Few bonds of a lattice cross the plane: the region is examined for these alone.
    p, q, hp, hq = start[cut], end[cut], above[cut, None], below[cut, None]
    crossing = ((q - origin) * hp - (p - origin) * hq) / (hp - hq)
    shift = (q - p) / (hp - hq)
    cut[cut] = region(crossing, shift, slack[cut])
    return cut


class Cut(_Described):
    """A surface without thickness that severs the bonds across it.

    Attributes
    ----------
    dim : int
        Number of coordinates.
    """

    dim: int

    def cuts(self, start: ArrayLike, end: ArrayLike) -> Mask:
        """Determine which bonds are cut.

        Parameters
        ----------
        start, end : array_like, shape (..., dim)
            The ends of the bonds; the shapes broadcast. Swapping the ends changes nothing.

        Returns
        -------
        ndarray of bool, shape (...)
            True where the bond is cut.

        Raises
        ------
        InputError
            If the last axes are not `dim` long.
        """
        a, b = np.broadcast_arrays(_trailing("start", start, self.dim), _trailing("end", end, self.dim))
        return self._cuts(a.reshape(-1, self.dim), b.reshape(-1, self.dim)).reshape(a.shape[:-1])

    def normals(self, start: ArrayLike, end: ArrayLike) -> Array:
        """Unit normals of the surface where bonds cross it.

        Parameters
        ----------
        start, end : array_like, shape (n, dim)
            The ends of bonds that are cut.

        Returns
        -------
        ndarray, shape (n, dim)
            Of any sign; along the bonds unless a class defines them, so that faces that touch do not slide.

        Raises
        ------
        InputError
            If the last axes are not `dim` long.
        """
        return self._normals_of(_trailing("start", start, self.dim), _trailing("end", end, self.dim))

    def bounds(self) -> tuple[Array, Array]:
        """Return the smallest and the largest coordinates.

        Returns
        -------
        lower, upper : ndarray, shape (dim,)
            Corners of the smallest box that contains the cut.
        """
        raise NotImplementedError

    def outline(self) -> Array:
        """Points of the line that pictures and files show, shape (n, dim): in 3D the rim of the surface; empty unless a
        class defines them.
        """
        return np.zeros((0, self.dim))

    def _cuts(self, start: Array, end: Array) -> Mask:
        raise NotImplementedError

    def _normals_of(self, start: Array, end: Array) -> Array:
        return (end - start) / _norm(end - start)[:, None]


class PointCut(Cut):
    """A cut at a point in 1D: severs the bonds that span it.

    A node at the point counts as lying to the left of it.

    Parameters
    ----------
    x : float
        Coordinate of the cut.

    Raises
    ------
    InputError
        If x is not a finite number.

    Examples
    --------
    >>> import farhorizon as fh
    >>> bar = fh.Lattice(1.0, -9, 9)
    >>> sim = fh.Simulation(bar, fh.Wave(fh.Kernel(2.0)), cracks=[fh.PointCut(0.5)])
    >>> sim.engine.absent.count  # three bonds, of both ends
    6
    """

    dim = 1
    _shown = ("x",)

    def __init__(self, x: float) -> None:
        self.x = float(constant("x", np.atleast_1d(constant("x", x)), (1,))[0])

    def bounds(self) -> tuple[Array, Array]:
        return np.array([self.x]), np.array([self.x])

    def outline(self) -> Array:
        return np.array([[self.x]])

    def _cuts(self, start: Array, end: Array) -> Mask:
        return _planar_cut(
            start,
            end,
            np.array([self.x]),
            np.array([-1.0]),
            lambda crossing, shift, slack: np.ones(len(slack), dtype=bool),
        )


class Polyline(Cut):
    """A crack in 2D made of successive straight segments.

    A node on the crack counts as lying to its left, as seen along the points: as if the whole curve, joints included,
    were shifted by an infinitesimal amount to its right. A bond that touches a joint is therefore cut if it crosses the
    shifted curve; one that touches a free tip is always cut, unless it runs along the segment or comes from the left
    and ends at the tip.

    Parameters
    ----------
    points : array_like, shape (n, 2)
        The corners in order, n >= 2. If the last repeats the first, the curve is closed and has no tips.

    Raises
    ------
    InputError
        For fewer than 2 points, equal successive points, or coordinates that are not finite.

    Examples
    --------
    >>> import farhorizon as fh
    >>> kinked = fh.Polyline([(-3.0, 0.5), (0.0, 0.5), (3.0, 2.5)])
    >>> lattice = fh.Lattice(1.0, (-9.0, -9.0), (9.0, 9.0))
    >>> fh.Simulation(lattice, fh.Wave(fh.Kernel(1.0)), cracks=[kinked]).engine.absent.count > 0
    True
    """

    dim = 2
    _shown = ("points",)

    def __init__(self, points: ArrayLike) -> None:
        self.points = _points("points", points, 2)
        steps = np.diff(self.points, axis=0)
        self._lengths = _norm(steps)
        if not (self._lengths > 0).all():
            raise InputError(
                "two successive points of the crack are equal",
                value=points,
                limit="points apart",
                key="points",
                remedy="leave one of them out",
            )
        self._tangents = steps / self._lengths[:, None]
        self._normals = np.stack([-self._tangents[:, 1], self._tangents[:, 0]], axis=1)
        # How far the first and last point of each segment move along it per unit of shift to the right, to where the
        # shifted segments meet. A free tip cuts every bond that touches it.
        before, after = np.roll(self._normals, 1, axis=0), np.roll(self._normals, -1, axis=0)
        self._first_moves = _mitre(self._normals, self._tangents, before, -np.inf)
        self._last_moves = _mitre(self._normals, self._tangents, after, np.inf)
        if not (self.points[0] == self.points[-1]).all():
            self._first_moves[0], self._last_moves[-1] = -np.inf, np.inf

    def bounds(self) -> tuple[Array, Array]:
        return self.points.min(axis=0), self.points.max(axis=0)

    def outline(self) -> Array:
        return self.points

    def _cuts(self, start: Array, end: Array) -> Mask:
        cut = np.zeros(len(start), dtype=bool)
        for i in range(len(self._lengths)):
            cut |= _planar_cut(start, end, self.points[i], self._normals[i], self._region(i))
        return cut

    def _normals_of(self, start: Array, end: Array) -> Array:
        normals = super()._normals_of(start, end)
        for i, normal in enumerate(self._normals):
            normals[_planar_cut(start, end, self.points[i], normal, self._region(i))] = normal
        return normals

    def _region(self, i: int) -> _Region:
        tangent, length = self._tangents[i], self._lengths[i]
        first, last = self._first_moves[i], self._last_moves[i]

        def region(crossing: Array, shift: Array, slack: Array) -> Mask:
            along, move = _dot(crossing, tangent), _dot(shift, tangent)
            blur = TOLERANCE * (1 + np.abs(move))
            after_first = (along > slack) | ((along >= -slack) & (move >= first - blur))
            before_last = (along < length - slack) | ((along <= length + slack) & (move <= last + blur))
            return after_first & before_last

        return region


def _mitre(normals: Array, tangents: Array, neighbours: Array, tip: float) -> Array:
    opening = 1 + _dot(normals, neighbours)
    # A segment that folds back on its neighbour has no mitre: both ends are tips.
    folded = opening <= TOLERANCE
    return np.where(folded, tip, -_dot(neighbours, tangents) / np.where(folded, 1.0, opening))


def segments_cross(a0: ArrayLike, a1: ArrayLike, b0: ArrayLike, b1: ArrayLike) -> Mask:
    """Determine which bonds, with ends a0 and a1 (..., 2), a straight crack from b0 to b1 (2,) cuts, (...).

    A bond is cut if it meets the closed segment, to 1e-9 of the bond's length, with nodes on the crack's line counted
    as lying on its left; see the head of this module. Bonds along the crack are not cut, bonds that graze a tip are.
    """
    return Polyline([constant("b0", b0, (2,)), constant("b1", b1, (2,))]).cuts(a0, a1)


class Rectangle(Cut):
    """A rectangular crack in 3D.

    A node in its plane counts as lying on the side of edge2 x edge1. With edge2 along z this is the left of edge1, as
    for a crack in the x-y plane.

    Parameters
    ----------
    corner : array_like, shape (3,)
        One corner.
    edge1, edge2 : array_like, shape (3,)
        The two edges from that corner, perpendicular to within 1e-9.

    Raises
    ------
    InputError
        For edges of zero length or not at right angles, or values that are not finite or of the wrong length.

    Examples
    --------
    >>> import farhorizon as fh
    >>> cut = fh.Rectangle(corner=(-2.0, -2.0, 0.5), edge1=(4.0, 0.0, 0.0), edge2=(0.0, 4.0, 0.0))
    >>> lattice = fh.Lattice(1.0, (-4.0,) * 3, (4.0,) * 3)
    >>> fh.Simulation(lattice, fh.Wave(fh.Kernel(1.0)), fh.Fixed(), cracks=[cut]).engine.absent.count
    210
    """

    dim = 3
    _shown = ("corner", "edge1", "edge2")

    def __init__(self, corner: Point, edge1: Point, edge2: Point) -> None:
        self.corner, self.edge1, self.edge2 = (
            constant("corner", corner, (3,)),
            constant("edge1", edge1, (3,)),
            constant("edge2", edge2, (3,)),
        )
        self._lengths = (float(_norm(self.edge1)), float(_norm(self.edge2)))
        if not min(self._lengths) > 0:
            raise InputError(
                "an edge of the rectangle has no length",
                value=f"edge1 {self.edge1.tolist()}, edge2 {self.edge2.tolist()}",
            )
        self._tangents = (self.edge1 / self._lengths[0], self.edge2 / self._lengths[1])
        cosine = float(_dot(*self._tangents))
        if abs(cosine) > TOLERANCE:
            raise InputError(
                "the edges of the rectangle are not at right angles",
                value=f"cosine {cosine:.3g}",
                limit=TOLERANCE,
                remedy=f"e.g. edge2 = {(self.edge2 - cosine * self._lengths[1] * self._tangents[0]).tolist()}",
            )
        self._normal = np.cross(self._tangents[1], self._tangents[0])

    def bounds(self) -> tuple[Array, Array]:
        corners = self.outline()
        return corners.min(axis=0), corners.max(axis=0)

    def outline(self) -> Array:
        nothing = 0 * self.edge1
        return self.corner + np.array([nothing, self.edge1, self.edge1 + self.edge2, self.edge2, nothing])

    def _cuts(self, start: Array, end: Array) -> Mask:
        return _planar_cut(start, end, self.corner, self._normal, self._region)

    def _normals_of(self, start: Array, end: Array) -> Array:
        return np.tile(self._normal, (len(start), 1))

    def _region(self, crossing: Array, shift: Array, slack: Array) -> Mask:
        inside = np.ones(len(slack), dtype=bool)
        for tangent, length in zip(self._tangents, self._lengths, strict=True):
            along = _dot(crossing, tangent)
            inside &= (along >= -slack) & (along <= length + slack)
        return inside


class DiscCut(Cut):
    """A penny-shaped crack in 3D.

    A node in its plane counts as lying on the side to which the normal points.

    Parameters
    ----------
    centre : array_like, shape (3,)
        Centre of the crack.
    normal : array_like, shape (3,)
        Normal of its plane, of any nonzero length.
    radius : float
        Radius of the crack, greater than zero.

    Raises
    ------
    InputError
        For a radius or a normal of zero length, or values that are not finite or of the wrong length.

    Examples
    --------
    >>> import farhorizon as fh
    >>> penny = fh.DiscCut(centre=(0.0, 0.0, 0.5), normal=(0.0, 0.0, 1.0), radius=2.0)
    >>> lattice = fh.Lattice(1.0, (-4.0,) * 3, (4.0,) * 3)
    >>> fh.Simulation(lattice, fh.Wave(fh.Kernel(1.0)), fh.Fixed(), cracks=[penny]).engine.absent.count
    122
    """

    dim = 3
    _shown = ("centre", "normal", "radius")

    def __init__(self, centre: Point, normal: Annotated[ArrayLike, Toml(list[float])], radius: Length) -> None:
        self.centre, self.normal = constant("centre", centre, (3,)), constant("normal", normal, (3,))
        self.radius = kinds.number(radius, "radius", above=0)
        length = float(_norm(self.normal))
        if not length > 0:
            raise InputError("the normal of the disc has no length", value=normal)
        self._unit = self.normal / length

    def bounds(self) -> tuple[Array, Array]:
        half = self.radius * np.sqrt(np.maximum(0.0, 1 - self._unit**2))
        return self.centre - half, self.centre + half

    def outline(self) -> Array:
        first = np.cross(self._unit, np.eye(3)[np.argmin(np.abs(self._unit))])
        first /= _norm(first)
        angles = np.linspace(0, 2 * np.pi, _CORNERS)[:, None]
        circle = np.cos(angles) * first + np.sin(angles) * np.cross(self._unit, first)
        return self.centre + self.radius * circle

    def _cuts(self, start: Array, end: Array) -> Mask:
        return _planar_cut(start, end, self.centre, self._unit, self._region)

    def _normals_of(self, start: Array, end: Array) -> Array:
        return np.tile(self._unit, (len(start), 1))

    def _region(self, crossing: Array, shift: Array, slack: Array) -> Mask:
        return _norm(crossing) <= self.radius + slack


class PolygonCut(Cut):
    """A crack in 3D whose outline is a plane polygon.

    A node in its plane counts as lying on the side from which the corners run anticlockwise; for a polygon that crosses
    itself, this side is not specified.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        The corners in order, n >= 3, in one plane to within 1e-9 of the size; the last may repeat the first. The inside
        is defined as in `Polygon`.

    Raises
    ------
    InputError
        For fewer than 3 corners, corners on one line or not in one plane, or values that are not finite or of the wrong
        length.

    Examples
    --------
    >>> import farhorizon as fh
    >>> fault = fh.PolygonCut([(-2.0, -2.0, 0.5), (2.0, -2.0, 0.5), (2.0, 2.0, 0.5), (-2.0, 2.0, 0.5)])
    >>> lattice = fh.Lattice(1.0, (-4.0,) * 3, (4.0,) * 3)
    >>> fh.Simulation(lattice, fh.Wave(fh.Kernel(1.0)), fh.Fixed(), cracks=[fault]).engine.absent.count
    210
    """

    dim = 3
    _shown = ("points",)

    def __init__(self, points: ArrayLike) -> None:
        corners = _points("points", points, 3, dim=3)
        self.points = corners[:-1] if (corners[0] == corners[-1]).all() else corners
        self._origin = self.points.mean(axis=0)
        arms = self.points - self._origin
        _, sizes, axes = np.linalg.svd(arms, full_matrices=False)
        if len(sizes) == 3 and sizes[2] > TOLERANCE * sizes[0]:
            raise InputError(
                "the corners of the polygon do not lie in one plane",
                value=f"{sizes[2]:.3g} off",
                limit=f"{TOLERANCE * sizes[0]:.3g}",
            )
        turn = np.cross(arms, np.roll(arms, -1, axis=0)).sum(axis=0)  # twice the area, along the normal
        normal = np.cross(axes[0], axes[1])
        self._normal = -normal if _dot(turn, normal) < 0 else normal
        self._tangents = axes[0], np.cross(self._normal, axes[0])
        self._outline = Polygon(self._flat(arms))

    def _flat(self, arms: Array) -> Array:
        return np.stack([_dot(arms, tangent) for tangent in self._tangents], axis=-1)

    def bounds(self) -> tuple[Array, Array]:
        return self.points.min(axis=0), self.points.max(axis=0)

    def outline(self) -> Array:
        return np.concatenate([self.points, self.points[:1]])

    def _cuts(self, start: Array, end: Array) -> Mask:
        return _planar_cut(start, end, self._origin, self._normal, self._region)

    def _normals_of(self, start: Array, end: Array) -> Array:
        return np.tile(self._normal, (len(start), 1))

    def _region(self, crossing: Array, shift: Array, slack: Array) -> Mask:
        return self._outline.contains(self._flat(crossing))

"""The uniform lattice: spacing, bounds and nodes, with a window on the medium or a body of finite extent."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Annotated, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from farhorizon import kinds
from farhorizon.arguments import Length, OneOf, Point, Toml
from farhorizon.errors import InputError, shown
from farhorizon.files.storable import Storable
from farhorizon.geometry.shapes import Box, Shape
from farhorizon.geometry.voxels import Voxels
from farhorizon.machine import check_fits
from farhorizon.rounding import MARGIN

AXES = ("x", "y", "z")
_AT_ONCE = 2**22  # nodes up to which the mask is computed at once; beyond, each process computes its own part
_COUNTED = 2.0**53  # nodes beyond which their numbers are not exact in double precision
_SHAPES = (
    "Disc, Ball, Box, Polygon, Mesh, Voxels, of a body an array of bool of the lattice's shape, "
    "or a subclass of farhorizon.geometry.shapes.Shape with dim, bounds() and contains(points)"
)


class Cells(NamedTuple):
    """Cells of a box, each of which has a node in its middle.

    Parameters
    ----------
    nodes : sequence of int
        Number of nodes along each axis, with `box` instead of spacing, lower and upper.
    box : Box
        Box that equal cells fill; each has a node in its middle.
    """

    nodes: Annotated[Sequence[int] | np.ndarray | int, Toml(list[int])]
    box: Box


class Lattice(Storable):
    """Nodes ``lower, lower + spacing, ..., upper`` (both included) along each of one to three axes.

    Parameters
    ----------
    spacing : float
        Distance between neighbouring nodes, the same along every axis.
    lower, upper : sequence of float or float, optional
        Bounds of the near field. ``upper - lower`` must be a whole number of spacings, to within 1e-9.
    window : Shape, optional
        A window on the medium instead of bounds: the lattice (through the origin) covers the bounding box, the medium
        continues beyond the edge of the window, and only nodes inside are shown.
    body : Shape or ndarray of bool, optional
        A body of finite extent: nodes outside it do not exist. An array, of the lattice's shape, marks the nodes that
        exist, and requires bounds; a shape may be seen through a window, as a hole in a medium that does not end.

    Attributes
    ----------
    shape, first : tuple of int
        Number of nodes along the axes; for a part of a lattice, the index of its first node in the `whole`.

    Raises
    ------
    InputError
        A spacing that is not positive, bounds that are not a whole number of spacings apart, an empty window or body.

    Notes
    -----
    `of_counts` makes a lattice from the numbers of nodes in a box; in case files, these are `nodes` and `box`.

    Examples
    --------
    >>> import farhorizon as fh
    >>> lattice = fh.Lattice(0.5, lower=(-2.0, -1.0), upper=(2.0, 1.0))
    >>> lattice.shape
    (9, 5)
    >>> lattice.index((0.2, 0.1))  # the nearest node
    (4, 2)
    """

    def __init__(
        self,
        spacing: Annotated[float | Cells, OneOf(spacing=Length, cells=Cells)],
        lower: Point | None = None,
        upper: Point | None = None,
        *,
        window: Shape | None = None,
        body: Annotated[Shape | np.ndarray | None, Toml(Shape)] = None,
    ) -> None:
        if isinstance(spacing, Cells):
            for name, bound in (("lower", lower), ("upper", upper), ("window", window)):
                if bound is not None:
                    raise InputError(
                        "nodes in a box determine the bounds",
                        value=shown(bound),
                        key=f"lattice.{name}",
                        remedy=f"leave {name} out, or give a spacing instead of nodes and box",
                    )
            spacing, lower, upper = _middles(*spacing)
        self.spacing = spacing = kinds.number(spacing, "lattice.spacing", above=0)
        mask = body if isinstance(body, np.ndarray) else None
        region = _cells(body, spacing, lower) if isinstance(body, np.ndarray) else body
        for key, shape in (("lattice.window", window), ("lattice.body", region)):
            if shape is not None:
                kinds.instance(shape, key, Shape, "a shape", remedy=_SHAPES)
        self.window, self.body = window, region
        if window is not None:
            if lower is not None or upper is not None or mask is not None:
                raise InputError(
                    "a window replaces lower and upper",
                    key="lattice.window",
                    remedy="a window, and a shape as its body",
                )
            low, high = window.bounds()
            first = np.ceil(np.asarray(low) / spacing - MARGIN)
            last = np.floor(np.asarray(high) / spacing + MARGIN)
        elif lower is None or upper is None:
            raise InputError(
                "a lattice needs lower and upper, or a window", key="lattice", remedy="give lower=(...), upper=(...)"
            )
        else:
            lower, upper = (
                np.atleast_1d(kinds.array(bound, f"lattice.{name}"))
                for name, bound in (("lower", lower), ("upper", upper))
            )
            first, last = self._whole_spacings(lower, upper)
        self._masks: dict[str, np.ndarray] = {}
        count = np.prod(last - first + 1)
        if self._regions or count > _COUNTED:
            _check_size(last - first + 1, 1 / 8)
        self._whole: Lattice | None = None
        self.shape: tuple[int, ...] = tuple(int(n) for n in last - first + 1)
        self.first = (0,) * len(self.shape)
        self.dim = len(self.shape)
        if min(self.shape) < 1:
            raise InputError(
                "the lattice holds no node",
                value=self.shape,
                key="lattice",
                remedy="a smaller spacing or a larger window",
            )
        self.lower = np.asarray(first * self.spacing if lower is None else lower)
        self.upper = self.lower + (np.array(self.shape) - 1) * self.spacing
        if mask is not None and mask.shape != self.shape:
            raise InputError("has another shape", value=mask.shape, limit=self.shape, key="lattice.body")
        for region in self._regions.values():
            if region.dim != self.dim:
                raise InputError(
                    "shape and lattice differ in dimension", value=region.dim, limit=self.dim, key="lattice"
                )
        if count <= _AT_ONCE:
            self._check_shown(self.mask)

    @classmethod
    def of_counts(
        cls,
        nodes: Sequence[int] | np.ndarray | int,
        lower: ArrayLike,
        upper: ArrayLike,
        *,
        body: Shape | np.ndarray | None = None,
    ) -> Self:
        """Create the lattice of a box of equal cells, each with a node in its middle, as input files of other
        peridynamic programs describe it: the outermost nodes lie half a spacing inside the box.

        Parameters
        ----------
        nodes : array_like of int, shape (dim,), or int in 1D
            Number of nodes along each axis.
        lower, upper : array_like, shape (dim,)
            Corners of the box.
        body : Shape or ndarray of bool, optional
            As for the constructor.

        Raises
        ------
        InputError
            As many counts as the box has axes are not given, or they make cells that are not cubes; the message has
            the nearest counts that do, and the nearest box.

        Examples
        --------
        >>> import farhorizon as fh
        >>> lattice = fh.Lattice.of_counts([60, 30], (0.0, 0.0), (1.0, 0.5))
        >>> lattice.shape, round(lattice.spacing * 60, 12), round(lattice.lower[0] * 120, 12)
        ((60, 30), 1.0, 1.0)
        """
        return cls(Cells(nodes, Box(np.atleast_1d(lower), np.atleast_1d(upper))), body=body)

    @property
    def _regions(self) -> dict[str, Shape]:
        """The window and the body, as far as they are given."""
        return {name: shape for name in ("window", "body") if (shape := getattr(self, name)) is not None}

    @property
    def mask(self) -> np.ndarray | None:
        """Mask of the nodes inside the window and the body, of the lattice's shape; None where there is neither.

        Raises
        ------
        InputError
            There are no such nodes, unless this is a part of a lattice; for large lattices this is not checked earlier.
        """
        masks = [mask for mask in (self.framed, self.existing) if mask is not None]
        return np.logical_and.reduce(masks) if len(masks) > 1 else next(iter(masks), None)

    @property
    def framed(self) -> np.ndarray | None:
        """Mask of the nodes inside the window; None where there is none. The medium does not end at its edge."""
        return self._inside("window")

    @property
    def existing(self) -> np.ndarray | None:
        """Mask of the nodes of the body, outside of which there is nothing; None where there is none."""
        return self._inside("body")

    def _check_shown(self, mask: np.ndarray | None) -> None:
        if mask is not None and self._whole is None:
            check_any(bool(mask.any()))

    def _inside(self, name: str) -> np.ndarray | None:
        """Mask of the nodes inside the window or the body; None if it is not given."""
        region = self._regions.get(name)
        if region is None or name in self._masks:
            return self._masks.get(name)
        _check_size(np.array(self.shape), 3 * self.dim + 2)
        inside = kinds.function(region.contains, "lattice", "points")(np.stack(self.coordinates(), axis=-1))
        if not isinstance(inside, np.ndarray) or inside.dtype != bool or inside.shape != self.shape:
            raise InputError(
                "contains(points) of a shape tells true or false for each point",
                value=kinds.said(inside),
                key="lattice",
                limit=f"an array of bool of shape {self.shape} for points of shape {(*self.shape, self.dim)}",
            )
        self._check_shown(inside)
        self._masks[name] = inside
        return inside

    def _whole_spacings(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if lower.shape != upper.shape or lower.ndim != 1 or not 1 <= len(lower) <= 3:
            raise InputError(
                "lower and upper need a number for each axis, one to three",
                value=f"lower = {lower.tolist()}, upper = {upper.tolist()}",
                key="lattice",
                remedy="as many numbers in one as in the other",
            )
        if not (upper >= lower).all():
            axis = int(np.argmin(upper - lower))
            raise InputError(
                f"upper lies below lower along {'xyz'[axis]}",
                value=upper[axis],
                limit=f">= {lower[axis]:g} (lattice.lower)",
                key="lattice.upper",
                remedy="the corner with the larger coordinates comes second",
            )
        steps = (upper - lower) / self.spacing
        counts = np.round(steps)
        if np.any(np.abs(steps - counts) > MARGIN * np.maximum(1.0, counts)):
            nearest = shown(lower + counts * self.spacing)
            raise InputError(
                "upper - lower is not a whole number of spacings",
                value=(upper - lower).tolist(),
                limit=f"multiples of {shown(self.spacing)}",
                key="lattice.upper",
                remedy=f"nearest upper = {nearest}",
            )
        return np.zeros(len(lower)), counts

    @property
    def axes(self) -> list[np.ndarray]:
        """Coordinates of the nodes along each axis, one array (n,) per axis."""
        begin = self.whole.lower
        return [
            begin[a] + self.spacing * np.arange(first, first + n)
            for a, (first, n) in enumerate(zip(self.first, self.shape, strict=True))
        ]

    @property
    def whole(self) -> Lattice:
        """The lattice of which this is a part; the lattice itself unless `part` created it."""
        return self if self._whole is None else self._whole

    def part(self, ranges: Sequence[tuple[int, int]]) -> Lattice:
        """A box of the lattice, with the same coordinates to the last bit.

        Parameters
        ----------
        ranges : sequence of (int, int)
            First node and last node + 1 along each axis.
        """
        box = copy.copy(self)
        box._whole, box.first = self, tuple(first for first, _ in ranges)
        box.shape = tuple(last - first for first, last in ranges)
        box.lower = np.array([along[first] for along, (first, _) in zip(self.axes, ranges, strict=True)])
        box.upper = np.array([along[last - 1] for along, (_, last) in zip(self.axes, ranges, strict=True)])
        box._masks = {name: mask[box.within] for name, mask in self._masks.items()}
        return box

    def around(self, more: Sequence[int]) -> tuple[Lattice, tuple[slice, ...]]:
        """This part of the whole lattice, extended by a number of nodes on both sides of each axis as far as they
        exist, and the location of the nodes of this lattice in it.
        """
        spans = zip(self.first, self.shape, more, self.whole.shape, strict=True)
        ends = [(max(first - m, 0), min(first + n + m, size)) for first, n, m, size in spans]
        location = [slice(f - low, f - low + n) for f, (low, _), n in zip(self.first, ends, self.shape, strict=True)]
        return self.whole.part(ends), tuple(location)

    @property
    def within(self) -> tuple[slice, ...]:
        """Location of the nodes among those of the `whole`."""
        return tuple(slice(first, first + n) for first, n in zip(self.first, self.shape, strict=True))

    def inside(self, shape: Shape) -> np.ndarray:
        """Flat indices of the nodes in a shape, for a body only those that exist; only the box around the shape is
        searched.
        """
        low, high = (np.asarray(bound, float) for bound in shape.bounds())
        first = np.clip(np.floor((low - self.lower) / self.spacing) - 1, 0, self.shape).astype(int)
        last = np.clip(np.ceil((high - self.lower) / self.spacing) + 2, first, self.shape).astype(int)
        if (first == last).any():
            return np.zeros(0, np.int64)
        box = self.part(list(zip(first.tolist(), last.tolist(), strict=True)))
        contained = shape.contains(np.stack(box.coordinates(), axis=-1))
        contained = contained if box.mask is None else contained & box.mask
        return np.ravel_multi_index(tuple((np.argwhere(contained) + first).T), self.shape)

    def own(self, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which nodes of the `whole` (flat indices) belong to this part, and their flat indices here."""
        if self._whole is None:
            return np.ones(nodes.shape, bool), nodes.ravel()
        at = np.stack(np.unravel_index(nodes, self.whole.shape), axis=-1) - np.array(self.first)
        inside = ((at >= 0) & (at < self.shape)).all(-1)
        return inside, np.ravel_multi_index(tuple(at[inside].T), self.shape)

    def coordinates(self) -> list[np.ndarray]:
        """Coordinates of all nodes, one array of the lattice's shape per axis; raises InputError if they do not fit
        into memory.
        """
        _check_size(np.array(self.shape), self.dim)
        return list(np.meshgrid(*self.axes, indexing="ij"))

    def index(self, point: ArrayLike, key: str = "point") -> tuple[int, ...]:
        """Index of the node nearest to a point (in one dimension, to a number); raises an InputError for the given key
        if the point lies outside the near field or the window.
        """
        given = kinds.array(point, key)
        at = np.atleast_1d(given)
        if at.shape != (self.dim,):
            count = "one coordinate" if self.dim == 1 else f"{self.dim} coordinates"
            raise InputError("a point needs one coordinate per axis", value=given, limit=count, key=key)
        with np.errstate(over="ignore"):  # points so far away are outside, too
            place = np.round((at - self.lower) / self.spacing)
        inside = bool(((place >= 0) & (place < self.shape)).all())
        node = tuple(int(i) for i in place) if inside else ()
        if not inside or (self.mask is not None and not self.mask[node]):
            raise InputError(
                "the point lies outside the near field",
                value=at.tolist(),
                limit=f"{shown(self.lower)} to {shown(self.upper)}",
                key=key,
                remedy="move it inside or enlarge the lattice",
            )
        return node

    def extended(self, nodes: dict[tuple[int, int], int]) -> Lattice:
        """The lattice with additional nodes beyond its sides (axis, side); a body continues along the normal, a window
        is dropped.
        """
        pads = [(nodes.get((a, -1), 0), nodes.get((a, 1), 0)) for a in range(self.dim)]
        low, high = (np.array([p[i] for p in pads]) * self.spacing for i in range(2))
        grown = Lattice(self.spacing, self.lower - low, self.upper + high)
        if self.existing is not None:
            grown.body, grown._masks = self.body, {"body": np.pad(self.existing, pads, mode="edge")}
        return grown

    @property
    def nodes(self) -> int:
        """Number of nodes shown."""
        return int(np.prod(self.shape)) if self.mask is None else int(self.mask.sum())

    def __repr__(self) -> str:
        return (
            f"Lattice(spacing={self.spacing}, lower={self.lower.tolist()}, upper={self.upper.tolist()}, "
            f"nodes={self.nodes})"
        )


def nodes_in(shape: Shape, lattice: Lattice, key: str) -> np.ndarray:
    """Mask of the nodes in a shape, of the lattice's shape; raises an InputError for a shape of another dimension."""
    if shape.dim != lattice.dim:
        raise InputError("shape and lattice differ in dimension", value=shape.dim, limit=lattice.dim, key=key)
    return shape.contains(np.stack(lattice.coordinates(), axis=-1))


def check_any(inside: bool) -> None:
    """Raise an InputError if no node lies in the window or body."""
    if not inside:
        raise InputError(
            "no node lies in the window or body", key="lattice", remedy="a smaller spacing or a larger shape"
        )


def _cells(mask: np.ndarray, spacing: float, lower: ArrayLike | None) -> Voxels:
    """The nodes of a mask as a shape: one cell around each."""
    first = np.zeros(mask.ndim) if lower is None else np.atleast_1d(kinds.array(lower, "lattice.lower"))
    return Voxels(kinds.mask(mask, "lattice.body"), spacing, first - spacing / 2)


def _check_size(count: np.ndarray, fields: float) -> None:
    """Raise an InputError unless `fields` arrays with `count` nodes along each axis fit into memory."""
    need = 8.0 * fields * float(np.prod(np.maximum(count, 1.0)))
    size = f"{' x '.join(shown(n) for n in count)} nodes"
    check_fits(need, "the lattice does", "lattice.spacing", "a larger spacing or a smaller extent", size)


def _middles(nodes: Sequence[int] | np.ndarray | int, box: Box) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the spacing and the first and last node, shape (dim,), of cells that fill a box."""
    kinds.instance(box, "lattice.box", Box, "a box", remedy="box = { lower = [...], upper = [...] }")
    given = [nodes] if isinstance(nodes, int) else nodes.tolist() if isinstance(nodes, np.ndarray) else nodes
    entries = kinds.sequence(given, "lattice.nodes", "counts")
    counts = np.array([kinds.integer(n, "lattice.nodes", least=1) for n in entries])
    lower, upper = (np.asarray(bound, float) for bound in box.bounds())
    if len(counts) != len(lower):
        raise InputError(
            "as many counts of nodes as the box has axes",
            value=counts.tolist(),
            limit=f"{len(lower)} counts",
            key="lattice.nodes",
            remedy="one for each number of box.lower",
        )
    widths = upper - lower
    spacings = widths / counts
    longest = int(np.argmax(counts))
    spacing = float(spacings[longest])
    if not np.isfinite(spacings).all() or np.abs(widths - counts * spacing).max() > MARGIN * widths[longest]:
        fitting = np.maximum(1, np.round(widths / spacing))
        raise InputError(
            "the counts of nodes do not fit the box: its cells would not have equal sides",
            value=f"sides {shown(spacings)} for nodes = {counts.tolist()}",
            limit="one spacing along all axes, to 1e-9",
            key="lattice.nodes",
            remedy=f"nodes = {fitting.astype(int).tolist()} with box.upper = {shown(lower + fitting * spacing)}, "
            f"or box.upper = {shown(lower + counts * spacing)}",
        )
    first = lower + spacing / 2
    return spacing, first, first + (counts - 1) * spacing

"""Interpolation of values and derivatives between the nodes of a lattice, as sums over blocks of nodes.

Along each axis the weights are those of a kernel of the distance, divided by their sum, so that constants are
reproduced exactly:

- "sinc": ``sin(pi d) / (pi d)`` under a Kaiser window of eight nodes to either side (Hicks 2002, Geophysics 67(1), eqs
  11 to 13). Its shape parameter ``8 pi / 2`` is that for waves of four nodes and more: values are accurate to about
  ``exp(-8 pi / 2)`` = 3.5e-6 per axis, derivatives to ten times as much;
- "linear": ``1 - |d|`` on the two nodes next to the point, with an error of second order in the spacing.

At a point on a node, that node has the weight 1 and all others 0. The same weights distribute a source that acts at a
point over nodes, so that the transmission between two points is the same in both directions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
from scipy.special import i0, i1, iv, spherical_jn

from farhorizon import kinds
from farhorizon.arguments import Point, Toml
from farhorizon.errors import InputError, shown
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Cut
from farhorizon.machine import check_fits

HALF_WIDTH = 8  # nodes to either side of a point that the windowed sinc reads
_SHAPE = HALF_WIDTH * np.pi / 2  # of the Kaiser window: half width times the distance from the band limit pi/2 to pi
_ON_NODE = 1e-9  # spacings within which a point counts as on a node: the tolerance of bounds

Kernel = Callable[[np.ndarray], np.ndarray]


class Blocks(NamedTuple):
    """A block of nodes for each point, with weights that are products of those along the axes."""

    first: np.ndarray  # index of the first node of each block, (n, dim)
    weights: tuple[np.ndarray, ...]  # along each axis, (n, width); the width is the same for all points
    shape: tuple[int, ...]  # nodes of the lattice along each axis

    def entries(self) -> tuple[np.ndarray, np.ndarray]:
        """Flat indices in the lattice of all nodes of each block, and their weights, both of shape (n, nodes)."""
        count = len(self.first)
        nodes, weights = np.zeros((count, 1), np.int64), np.ones((count, 1))
        for axis, along in enumerate(self.weights):
            place = self.first[:, axis, None] + np.arange(along.shape[1])
            size = nodes.shape[1] * along.shape[1]
            nodes = (nodes[:, :, None] * self.shape[axis] + place[:, None]).reshape(count, size)
            weights = (weights[:, :, None] * along[:, None]).reshape(count, size)
        return nodes, weights

    def within(self, begin: Sequence[int], shape: Sequence[int]) -> tuple[Blocks, np.ndarray]:
        """Parts of the blocks that lie in a box of the lattice, given by its first node and its number of nodes along
        each axis, and the numbers of the blocks that have such a part.
        """
        firsts, tables, in_box = [], [], np.ones(len(self.first), bool)
        for axis, (start, count) in enumerate(zip(begin, shape, strict=True)):
            along, offset = self.weights[axis], self.first[:, axis] - start
            width = min(along.shape[1], count)
            first = np.clip(offset, 0, count - width)
            place = (first - offset)[:, None] + np.arange(width)  # in the block
            inside = (place >= 0) & (place < along.shape[1])
            shifted = np.take_along_axis(along, np.where(inside, place, 0), 1)
            firsts.append(first)
            tables.append(np.where(inside, shifted, 0.0))
            in_box &= tables[-1].any(axis=1)
        blocks = Blocks(np.stack(firsts, axis=1)[in_box], tuple(table[in_box] for table in tables), tuple(shape))
        return blocks, np.flatnonzero(in_box)


def interpolation_blocks(
    lattice: Lattice,
    points: np.ndarray,
    method: str = "sinc",
    derivative: int | None = None,
    key: str = "points",
    moving: int | None = None,
    cuts: Iterable[Cut] = (),
) -> Blocks:
    """Blocks whose sums are the values of a field at points, as from `as_points`, or its first derivatives there along
    an axis: the windowed sinc itself is differentiated, "linear" interpolates central differences.

    With an axis `moving`, the weights are the changes of these per length by which the points move along it.

    An InputError, which names the points `key`, for an unknown method, a point outside the near field or in a hole, one
    so close to an edge or a hole that some of the nodes in its sum do not exist, one with `cuts` between it and some of
    them, across which a field jumps, or one that moves off a node where the weights have a kink.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> lattice = fh.Lattice(0.5, -10.0, 10.0)
    >>> nodes, weights = interpolation_blocks(lattice, np.array([[0.2]])).entries()
    >>> value = (weights * np.cos(lattice.axes[0][nodes])).sum()
    >>> bool(abs(value - np.cos(0.2)) < 1e-6)
    True
    """
    kernels = _KERNELS[kinds.one_of(method, "interpolation", _KERNELS, "unknown interpolation")]
    place = (points - lattice.lower) / lattice.spacing
    near = np.round(place)
    place = np.where(np.abs(place - near) <= _ON_NODE * np.maximum(1.0, np.abs(near)), near, place)
    _check_inside(lattice, points, place, key)
    if moving is not None:
        _check_smooth(points, place[:, moving], method, key)
    orders = [(derivative == a, moving == a) for a in range(lattice.dim)]
    along_axes = [_along(place[:, a], n, kernels, *orders[a]) for a, n in enumerate(lattice.shape)]
    weights = tuple(along / lattice.spacing ** sum(orders[a]) for a, (_, along) in enumerate(along_axes))
    blocks = Blocks(np.stack([first for first, _ in along_axes], axis=1), weights, lattice.shape)
    _check_whole(lattice, points, blocks, method, derivative is not None, key)
    _check_uncut(lattice, points, blocks, cuts, method, derivative is not None, key)
    return blocks


def as_points(points: Any, dim: int, key: str = "points") -> np.ndarray:
    """Points as an array of shape (n, dim), at least one; in one dimension, numbers along the line are
    accepted, too.
    """
    given = kinds.array(points, key)
    if given.ndim < 2 and dim == 1:
        given = given.reshape(-1, 1)
    array = kinds.array(np.atleast_2d(given), key, shape=(None, dim))
    if not len(array):
        raise InputError(
            "there is no point", value=kinds.said(given), limit="at least 1", key=key, remedy="give at least one"
        )
    return array


def points_on_line(start: Point, end: Point, count: int) -> np.ndarray:
    """Evenly spaced points from one end to the other, both included, shape (count, dim).

    Parameters
    ----------
    start, end : array_like, shape (dim,)
        First and last point.
    count : int
        Number of points, both ends included.

    Raises
    ------
    InputError
        Ends of different dimensions, no point.
    """
    count = kinds.integer(count, "line.count", least=1)
    ends = [np.atleast_1d(kinds.array(point, "line")) for point in (start, end)]
    if ends[0].ndim != 1 or ends[0].shape != ends[1].shape:
        raise InputError(
            "both ends of a line need one coordinate per axis",
            value=[point.shape for point in ends],
            limit="two equal shapes (dim,)",
            key="line",
            remedy="(x, y) for both in two dimensions",
        )
    return np.linspace(ends[0], ends[1], count)


def points_on_grid(lower: Point, upper: Point, counts: Annotated[Any, Toml(list[int])]) -> np.ndarray:
    """Points on a grid, both corners included, with the last axis varying fastest, shape (n, dim).

    Parameters
    ----------
    lower, upper : array_like, shape (dim,)
        Smallest and largest coordinates.
    counts : sequence of int
        Number of points along each axis, both ends included.

    Raises
    ------
    InputError
        Corners and counts of different dimensions, no point along an axis.
    """
    corners = [np.atleast_1d(kinds.array(corner, "grid")) for corner in (lower, upper)]
    numbers = [kinds.integer(n, "grid.counts", least=1) for n in np.atleast_1d(np.asarray(counts, object))]
    if any(corner.shape != (len(numbers),) for corner in corners):
        raise InputError(
            "corners and counts of a grid have one entry an axis",
            value=[*(corner.shape for corner in corners), len(numbers)],
            limit="three equal lengths",
            key="grid",
            remedy="(x, y), (x, y) and (n, m) in two dimensions",
        )
    count = math.prod(numbers)
    # coordinates, twice while they are made; and along each axis the nodes and weights by which a field is interpolated
    need = 8 * count * len(numbers) * (3 + 2 * HALF_WIDTH)
    check_fits(need, f"{count:.6g} points do", "grid.counts", "fewer points")
    axes = [np.linspace(a, b, n) for a, b, n in zip(*corners, numbers, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(axes))


def _check_inside(lattice: Lattice, points: np.ndarray, place: np.ndarray, key: str) -> None:
    """Raise an InputError for a point outside the near field, or one whose nearest node does not exist."""
    outside = ((place < 0) | (place > np.array(lattice.shape) - 1)).any(axis=1)
    if lattice.mask is not None:
        nearest = np.clip(np.round(place), 0, np.array(lattice.shape) - 1).astype(int)
        outside |= ~lattice.mask[tuple(nearest.T)]
    if outside.any():
        hole = "" if lattice.mask is None else ", or where the body or window has no node"
        raise InputError(
            f"the point lies outside the near field{hole}",
            value=points[outside][0],
            limit=f"{shown(lattice.lower)} to {shown(lattice.upper)}",
            key=key,
            remedy="move it inside or enlarge the lattice",
        )


def _check_smooth(points: np.ndarray, along: np.ndarray, method: str, key: str) -> None:
    """Raise an InputError for a point on a node, where weights that are linear between the nodes have a kink."""
    on_node = along == np.floor(along)
    if method == "linear" and on_node.any():
        raise InputError(
            "on a node the weights of interpolation = 'linear' have no derivative by the place",
            value=points[on_node][0],
            limit="between nodes",
            key=key,
            remedy="interpolation = 'sinc', or a place between nodes",
        )


def _check_whole(lattice: Lattice, points: np.ndarray, blocks: Blocks, method: str, derived: bool, key: str) -> None:
    """Raise an InputError for a point whose sum includes nodes that do not exist."""
    incomplete = np.zeros(len(points), bool)
    for along in blocks.weights:
        incomplete |= np.isnan(along).any(axis=1)
    if lattice.mask is not None:
        nodes, weights = blocks.entries()
        incomplete |= ((weights != 0) & ~lattice.mask.ravel()[nodes]).any(axis=1)
    if incomplete.any():
        kernels, where = _KERNELS[method], "along each axis along which it is between nodes"
        half, more = (kernels.slope_half, ", and along the axis of a derivative") if derived else (kernels.half, "")
        raise InputError(
            f"the point is so close to the edge of the near field, or of a body or window, that some of the nodes "
            f"that interpolation = {method!r} needs are not there",
            value=points[incomplete][0],
            limit=f"{half} nodes to either side {where}{more}",
            key=key,
            remedy=another_point(method, derived),
        )


def _check_uncut(
    lattice: Lattice, points: np.ndarray, blocks: Blocks, cuts: Iterable[Cut], method: str, derived: bool, key: str
) -> None:
    """Raise an InputError for a point with a cut between it and nodes in its sum."""
    width = [along.shape[1] - 1 for along in blocks.weights]
    first, last = (lattice.lower + lattice.spacing * nodes for nodes in (blocks.first, blocks.first + width))
    for cut in cuts:
        low, high = cut.bounds()
        for number in np.flatnonzero(((first <= high) & (last >= low)).all(1)):
            one = Blocks(blocks.first[[number]], tuple(along[[number]] for along in blocks.weights), blocks.shape)
            nodes, weights = one.entries()
            used = np.stack(np.unravel_index(nodes[weights != 0], lattice.shape), -1)
            if len(used) > 1 and cut.cuts(points[number], lattice.lower + lattice.spacing * used).any():
                raise InputError(
                    "a crack lies between the point and nodes that its interpolation takes",
                    value=points[number],
                    limit=f"interpolation = {method!r}",
                    key=key,
                    remedy=another_point(method, derived),
                )


def another_point(method: str, derived: bool) -> str:
    """What to do about a point whose sum is not possible: on a node, only derivatives use other nodes."""
    place = (
        "a point farther away, because derivatives use neighbours also on a node" if derived else "a point on a node"
    )
    return f"interpolation = 'linear', or {place}" if method == "sinc" else place


def _inside(distance: np.ndarray) -> np.ndarray:
    """``sqrt(1 - (d/8)^2)``, 0 outside the window."""
    return np.sqrt(np.maximum(1 - (distance / HALF_WIDTH) ** 2, 0.0))


def _sinc(distance: np.ndarray) -> np.ndarray:
    inside = _inside(distance)
    window = np.where(inside > 0, i0(_SHAPE * inside) / i0(_SHAPE), 0.0)
    on_node = distance == np.round(distance)  # where rounding errors of the sine would remain
    return np.where(on_node, distance == 0, np.sinc(distance) * window)


def _sinc_slope(distance: np.ndarray) -> np.ndarray:
    inside = _inside(distance)
    argument = _SHAPE * np.maximum(inside, 1e-8)  # the quotient below is 1/2 there
    window, bend = i0(argument), -(_SHAPE**2) / HALF_WIDTH**2 * distance * i1(argument) / argument
    slope = -np.pi * np.sign(distance) * spherical_jn(1, np.pi * np.abs(distance))
    return np.where(inside > 0, (slope * window + np.sinc(distance) * bend) / i0(_SHAPE), 0.0)


def _sinc_bend(distance: np.ndarray) -> np.ndarray:
    """Second derivative of the windowed sinc."""
    inside = _inside(distance)
    argument = _SHAPE * np.maximum(inside, 1e-8)  # the quotients below are 1/2 and 1/8 there
    x = np.pi * np.maximum(np.abs(distance), 1e-8)  # the quotient below is 1/3 at zero
    slope = -np.pi * np.sign(distance) * spherical_jn(1, x)
    bend = np.pi**2 * (2 * spherical_jn(1, x) / x - np.sinc(distance))
    rate, steep = (_SHAPE / HALF_WIDTH) ** 2, i1(argument) / argument
    window_slope = -rate * distance * steep
    window_bend = -rate * (steep - rate * distance**2 * iv(2, argument) / argument**2)
    whole = bend * i0(argument) + 2 * slope * window_slope + np.sinc(distance) * window_bend
    return np.where(inside > 0, whole / i0(_SHAPE), 0.0)


def _hat(distance: np.ndarray) -> np.ndarray:
    return np.maximum(1 - np.abs(distance), 0.0)


def _hat_slope(distance: np.ndarray) -> np.ndarray:
    return np.where(np.abs(distance) < 1, -np.sign(distance), 0.0)


def _hat_of_differences(distance: np.ndarray) -> np.ndarray:
    return (_hat(distance + 1) - _hat(distance - 1)) / 2


def _hat_of_differences_slope(distance: np.ndarray) -> np.ndarray:
    return (_hat_slope(distance + 1) - _hat_slope(distance - 1)) / 2


class _Kernels(NamedTuple):
    """Kernel of the weights along an axis and its half width, the same for derivatives of the field, and the
    derivatives of both kernels by the distance.
    """

    value: Kernel
    half: int
    slope: Kernel
    slope_half: int
    value_by_place: Kernel
    slope_by_place: Kernel


_KERNELS = {
    "sinc": _Kernels(_sinc, HALF_WIDTH, _sinc_slope, HALF_WIDTH, _sinc_slope, _sinc_bend),
    "linear": _Kernels(_hat, 1, _hat_of_differences, 2, _hat_slope, _hat_of_differences_slope),
}
INTERPOLATIONS = tuple(_KERNELS)


def _along(
    place: np.ndarray, count: int, kernels: _Kernels, derived: bool, moving: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """First nodes and weights of blocks along an axis with `count` nodes; weights are nan where a node is missing."""
    half = kernels.slope_half if derived else kernels.half
    below = np.floor(place).astype(np.int64)
    between = (place != below) | derived | moving
    lowest, highest = below - half + 1, below + half - (place == below)
    missing = ((lowest < 0) | (highest >= count)) & between
    width = min(count, 2 * half) if between.any() else 1
    first = np.clip(lowest if width > 1 else below, 0, count - width)
    distance = place[:, None] - (first[:, None] + np.arange(width))
    values = kernels.value(distance)
    values[missing] = np.nan
    total = values.sum(1, keepdims=True)
    if not (derived or moving):
        return first, values / total

    def change(kernel: Kernel, *more: np.ndarray) -> np.ndarray:
        """Derivative of values / total, whose numerator has the derivative that the kernel says; `more` is subtracted
        from it.
        """
        slopes = kernel(distance)
        return np.asarray((slopes - sum(more) - values * slopes.sum(1, keepdims=True) / total) / total)

    if not (derived and moving):
        return first, change(kernels.slope if derived else kernels.value_by_place)
    once, by_place = change(kernels.slope), change(kernels.value_by_place)
    sums = [one(distance).sum(1, keepdims=True) for one in (kernels.slope, kernels.value_by_place)]
    return first, change(kernels.slope_by_place, by_place * sums[0], once * sums[1])

"""Conditions that close a near field along its outline: the fringe of nodes that they read and set, and their sparse
update in the engine.

The near field is a window on the medium, or a box. Its halo, the nodes beyond the outline that the operator reads, is
set after each step from nodes of the fringe at this step and at earlier ones. Copies of these values are the memory of
the conditions.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import permutations, product
from typing import ClassVar

import numpy as np
from scipy import ndimage, sparse

from farhorizon import kinds
from farhorizon.analysis import modes
from farhorizon.boundaries.side import Side
from farhorizon.engine.engine import Engine
from farhorizon.engine.features.outline_stencil import FringeSums, outline_table
from farhorizon.errors import InputError
from farhorizon.geometry.shapes import Ball, Box, Disc, Shape

SERIES = 40  # terms of the series of the continuum: it converges everywhere, and does not cancel for decaying modes
_SMOOTHING = 3.0  # nodes over which the outline of a general shape is smoothed before its normals are computed


@dataclass(frozen=True)
class Medium:
    """Homogeneous medium beyond the nodes, and its time integration.

    Parameters
    ----------
    order : {1, 2}
        Diffusion by forward Euler, or waves by velocity Verlet.
    coefficient : float
        Diffusivity or squared speed of long waves.
    dt : float
    damping : float
        d in ``2 d u_t``.
    offsets, weights : ndarray, shapes (J, dim) and (J,), or (J, d, d) for a field of d components
        Bonds as vectors and their weights in units of the operator, if the dispersion relation is that of a stencil.
    horizon : float
    series : tuple of float
        Coefficients of the kernel's dispersion relation in powers of (k horizon)^2, see `Kernel.series`.

    Raises
    ------
    InputError
        Numbers out of range, offsets and weights that do not match.

    Examples
    --------
    >>> import farhorizon as fh
    >>> fh.Medium(order=1, coefficient=2.0, dt=0.001).components  # diffusion on a mesh
    1
    """

    order: int
    coefficient: float
    dt: float
    damping: float = 0.0
    offsets: np.ndarray = field(default_factory=lambda: np.zeros((0, 1)))
    weights: np.ndarray = field(default_factory=lambda: np.zeros(0))
    horizon: float = 0.0
    series: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        offsets, weights = kinds.array(self.offsets, "medium.offsets"), kinds.array(self.weights, "medium.weights")
        if offsets.ndim != 2 or weights.shape[:1] != offsets.shape[:1] or weights.ndim not in (1, 3):
            raise InputError(
                "bonds have offsets, and one weight each, or one square matrix",
                value=(offsets.shape, weights.shape),
                limit="(J, dim) and (J,) or (J, d, d)",
                key="medium.weights",
            )
        kinds.set_fields(
            self,
            order=kinds.integer(self.order, "medium.order", least=1, most=2),
            coefficient=kinds.number(self.coefficient, "medium.coefficient", above=0),
            dt=kinds.number(self.dt, "medium.dt", above=0),
            damping=kinds.number(self.damping, "medium.damping", least=0),
            offsets=offsets,
            weights=weights,
            horizon=kinds.number(self.horizon, "medium.horizon", least=0),
            series=tuple(kinds.array(self.series, "medium.series", shape=(None,)).tolist()),
        )

    @property
    def components(self) -> int:
        """Number of components of the field."""
        return 1 if self.weights.ndim == 1 else self.weights.shape[1]

    @cached_property
    def _long(self) -> float:
        """Coefficient of long waves on the lattice, if there is one: for a kernel that is not calibrated it differs
        from that of the model.
        """
        return float(self.weights @ self.offsets[:, 0] ** 2) / 2 if len(self.weights) else self.coefficient

    @cached_property
    def square(self) -> bool:
        """Whether mirror images along the axes, and an exchange of axes, leave the bonds as they are; not for a field
        of several components, which they exchange.
        """
        if self.components > 1:
            return False
        by_offset = {
            tuple(o): w for o, w in zip(np.round(self.offsets, 9).tolist(), self.weights.tolist(), strict=True)
        }
        return all(
            abs(by_offset.get(tuple(float(s * o[a]) for s, a in zip(signs, axes, strict=True)), np.inf) - w)
            <= 1e-9 * abs(w)
            for o, w in by_offset.items()
            for axes in permutations(range(len(o)))
            for signs in product((1, -1), repeat=len(o))
        )

    def symbol(self, k: np.ndarray, dispersion: str) -> np.ndarray:
        """Return the symbol S at wavevectors (M, dim) by one of the dispersion relations of `PlaneWave`.

        Raises
        ------
        InputError
            If the medium does not have this dispersion relation.
        """
        if dispersion == "discrete":
            if not len(self.weights):
                raise InputError(
                    "the medium has no stencil",
                    value=dispersion,
                    limit="local",
                    key="boundary.dispersion",
                    remedy="Medium(offsets=...)",
                )
            return modes.discrete_symbol(k, self.offsets, self.weights)
        terms = {"local": 0, "taylor": 1, "continuum": SERIES}[dispersion]
        if terms and not self.series:
            raise InputError(
                "only a kernel with constant or linear influence has a series",
                value=dispersion,
                limit="discrete, local",
                key="boundary.dispersion",
            )
        return modes.series_symbol(k, self._long, self.horizon, np.array(self.series[:terms]))

    def waves(self, k: np.ndarray, dispersion: str) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Return the waves of wavevectors (M, dim): the wavevector and the symbol of each, and for a field of d
        components the polarisation, shape (M d, d).

        Raises
        ------
        InputError
            As in `symbol`; for several components, any dispersion relation but that of the lattice.
        """
        if self.components == 1:
            return k, self.symbol(k, dispersion), None
        if dispersion != "discrete":
            raise InputError(
                "a field of several components has the dispersion relation of its lattice only",
                value=dispersion,
                limit="discrete",
                key="boundary.dispersion",
            )
        return np.repeat(k, self.components, axis=0), *modes.polarised(k, self.offsets, self.weights)


class Closing(Side, ABC):
    """Condition that closes an outline: it determines the values of the halo from nodes of the near field."""

    closing: ClassVar[bool] = True
    # waves of the bonds alone
    assumes = frozenset({"one component", "one density", "no reaction", "no drift", "no losses", "one stage"})
    alone = "they follow from nodes along the outline, which several processes have"
    #: Thickness of the halo that it sets; the reach of the stencil unless given.
    layer: float | None = None

    @abstractmethod
    def wanted(self, default: float) -> float:
        """Return the fraction of the largest value that may be neglected beyond the outline."""

    def width(self, reach: int, spacing: float) -> int:
        """Return the thickness of the halo in nodes."""
        return reach if self.layer is None else int(self.layer / spacing + 1e-9)

    @abstractmethod
    def depth(self, medium: Medium, spacing: float, extent: float) -> float:
        """Return the distance to which nodes are read inwards, for a near field with half the extent `extent`."""

    @abstractmethod
    def update(self, fringe: OutlineNodes, halo: np.ndarray, medium: Medium) -> sparse.csr_array:
        """Return the rows for the halo nodes (positions in the fringe) over the new level and earlier ones, shape (H, L
        S); for a field of d components those of the first component come first, in rows and in each level, shape (d H,
        L d S).
        """


@dataclass
class Outline:
    """Near field among the nodes of a grid, and its surroundings."""

    origin: np.ndarray  # coordinates of the grid's first node, (dim,)
    spacing: float
    near: np.ndarray  # nodes of the grid that belong to the near field, of bool
    window: Shape | None  # shape of the near field; None for a box
    sides: Mapping[tuple[int, int], Closing]  # sides of the box that conditions close; all sides for a window
    periodic: frozenset[int]  # axes
    free: frozenset[tuple[int, int]]  # sides of the grid across which there are no bonds
    offsets: np.ndarray  # of the stencil, in nodes, (J, dim)

    def halo(self) -> np.ndarray:
        """Nodes of the grid beyond the outline whose values the conditions set: those that the stencil reads, or a
        layer of given thickness.
        """
        layer = next((b.layer for b in self.sides.values() if b.layer is not None), None)
        if layer is None:
            read = np.zeros_like(self.near)
            for offset in self.offsets:
                read |= self._shifted(self.near, offset)
            return read & ~self.near
        reach = int(layer / self.spacing + 1e-9)
        pads = [(reach if a in self.periodic else 0,) * 2 for a in range(self.near.ndim)]
        distance = ndimage.distance_transform_edt(~np.pad(self.near, pads, mode="wrap"))
        inner = tuple(slice(p, p + n) for (p, _), n in zip(pads, self.near.shape, strict=True))
        return np.asarray(~self.near & (distance[inner] <= layer / self.spacing * (1 + 1e-9)))

    def _shifted(self, mask: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """Return the mask shifted by an offset; periodic axes wrap."""
        shifted = mask
        for axis, step in enumerate(offset.tolist()):
            shifted = np.roll(shifted, step, axis)
            if step and axis not in self.periodic:
                edge = slice(0, step) if step > 0 else slice(step, None)
                shifted[tuple(edge if a == axis else slice(None) for a in range(mask.ndim))] = False
        return shifted

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the first and the last node of the near field along each axis."""
        nodes = np.argwhere(self.near)
        return nodes.min(0), nodes.max(0)

    def normals(self, index: np.ndarray) -> np.ndarray:
        """Return outward unit normals at nodes (N, dim) beyond the outline: radial for a disc or ball, for a box away
        from its nearest point.
        """
        if isinstance(self.window, Disc | Ball):
            away = self.origin + self.spacing * index - self.window.centre
        elif self.flat:
            away = self.faces(index).astype(float)
        else:
            smooth = ndimage.gaussian_filter(self.near.astype(float), _SMOOTHING, mode="constant")
            away = -np.stack([g[tuple(index.T)] for g in np.atleast_2d(np.gradient(smooth))], axis=-1).reshape(
                index.shape
            )
        length = np.linalg.norm(away, axis=1, keepdims=True)
        return np.asarray(away / np.where(length > 0, length, 1.0))

    @property
    def flat(self) -> bool:
        """Whether the outline is that of a box."""
        return self.window is None or isinstance(self.window, Box)

    def faces(self, index: np.ndarray) -> np.ndarray:
        """Return the number of nodes by which nodes (N, dim) lie beyond the box along each axis."""
        low, high = self.bounds()
        return index - np.clip(index, low, high)


class OutlineNodes:
    """Nodes that conditions along an outline read, to a depth in the near field, or set: those of the halo, a mask of
    the grid.

    Attributes
    ----------
    index : (S, dim), nodes of the grid
    points : (S, dim), their coordinates
    filled : positions of the halo nodes in the fringe
    normals : (S, dim), outward unit normals at the halo nodes; zero at others
    axes : (S, dim), signed unit vector along the grid axis nearest to the normal
    faces : (S, dim), outward directions of the sides of the box beyond which a halo node lies; None for other outlines
    extent : half the extent of the near field
    remarks : what conditions say about their rows, for the report
    """

    def __init__(self, outline: Outline, halo: np.ndarray, depth: float) -> None:
        self.outline, self.spacing, self.depth = outline, outline.spacing, depth
        self.remarks: list[str] = []
        reach = int(np.ceil(depth / outline.spacing))
        pads = [(reach if a in outline.periodic else 0,) * 2 for a in range(halo.ndim)]
        away = ndimage.distance_transform_edt(~np.pad(halo, pads, mode="wrap"))
        inner = tuple(slice(p, p + n) for (p, _), n in zip(pads, halo.shape, strict=True))
        member = halo | (outline.near & (away[inner] * outline.spacing <= depth * (1 + 1e-9)))
        self.index = np.argwhere(member)
        self.points = outline.origin + outline.spacing * self.index
        self._places = np.full(member.shape, -1)
        self._places[member] = np.arange(len(self.index))
        self.filled = self._places[halo]
        self.normals = np.zeros(self.points.shape)
        self.normals[self.filled] = outline.normals(self.index[self.filled])
        nearest = np.argmax(np.round(np.abs(self.normals), 9), axis=1)
        self.axes = np.zeros(self.index.shape, int)
        self.axes[np.arange(len(nearest)), nearest] = np.sign(self.normals[np.arange(len(nearest)), nearest])
        self.faces = None
        if outline.flat:
            self.faces = np.zeros(self.index.shape, int)
            self.faces[self.filled] = np.sign(outline.faces(self.index[self.filled]))
        low, high = outline.bounds()
        self.extent = max(float((high - low).max()) / 2, 1.0) * outline.spacing

    def at(self, index: np.ndarray) -> np.ndarray:
        """Return the positions in the fringe of nodes (N, dim) of the grid, -1 for others; periodic axes wrap."""
        shape = np.array(self._places.shape)
        wrapped = np.where([a in self.outline.periodic for a in range(len(shape))], index % shape, index)
        inside = ((wrapped >= 0) & (wrapped < shape)).all(1)
        return np.where(inside, self._places[tuple(np.clip(wrapped, 0, shape - 1).T)], -1)

    def bonded(self, index: np.ndarray) -> np.ndarray:
        """Whether bonds lead to nodes (N, dim): true except beyond free sides."""
        shape = self._places.shape
        absent = [(index[:, a] < 0) if side < 0 else (index[:, a] >= shape[a]) for a, side in self.outline.free]
        return ~np.any(absent, axis=0) if absent else np.ones(len(index), bool)

    def with_images(self, distance: float) -> tuple[np.ndarray, np.ndarray]:
        """Return all points, followed by their images within a distance beyond periodic sides, and the position in the
        fringe of each.
        """
        points, places = self.points, np.arange(len(self.points))
        for axis in sorted(self.outline.periodic):
            n = self._places.shape[axis]
            first = self.outline.origin[axis]
            period, last = n * self.spacing, first + (n - 1) * self.spacing
            high, low = points[:, axis] - first < distance, last - points[:, axis] < distance
            shift = period * np.eye(points.shape[1])[axis]
            points, places = (
                np.concatenate([points, points[high] + shift, points[low] - shift]),
                np.concatenate([places, places[high], places[low]]),
            )
        return points, places

    def owners(self) -> dict[tuple[int, int], np.ndarray]:
        """Return the halo nodes that each side sets, as positions in the fringe: a node belongs to the side beyond
        which it lies furthest.
        """
        sides = list(self.outline.sides)
        if self.outline.window is not None or len({repr(b) for b in self.outline.sides.values()}) == 1:
            return {sides[0]: self.filled}
        steps = self.outline.faces(self.index[self.filled])
        beyond = np.stack([side * steps[:, axis] for axis, side in sides], axis=1)
        owner = np.argmax(beyond, axis=1)
        return {key: self.filled[owner == number] for number, key in enumerate(sides) if (owner == number).any()}


class OutlineCondition:
    """Conditions along one outline, in an engine; an InputError if one cannot be used with the medium or the outline.

    Attributes
    ----------
    halo, outside : nodes of the grid that are set, and those beyond, which do not exist, of bool
    update : (H, L S), or (d H, L d S), matrix that yields the new values of the halo from the fringe at the new step
        and at L - 1 earlier ones
    """

    def __init__(self, outline: Outline, medium: Medium) -> None:
        self.outline, self.medium = outline, medium
        self.halo = outline.halo()
        self.outside = ~outline.near & ~self.halo
        low, high = outline.bounds()
        extent = max(float((high - low).max()) / 2, 1.0) * outline.spacing
        self.fringe = OutlineNodes(
            outline, self.halo, max(b.depth(medium, outline.spacing, extent) for b in outline.sides.values())
        )
        parts = {
            key: outline.sides[key].update(self.fringe, places, medium) for key, places in self.fringe.owners().items()
        }
        size = medium.components * len(self.fringe.points)
        self.levels = max(part.shape[1] for part in parts.values()) // size
        first = len(self.fringe.points) * np.arange(medium.components)[:, None]
        rows = np.concatenate([(self.fringe.owners()[key] + first).ravel() for key in parts])
        stacked = sparse.vstack([_widened(part, self.levels * size) for part in parts.values()]).tocsr()
        self._order, self._fronts = ordered_fronts(stacked, rows, size)
        self.rows, self.update = rows[self._order], stacked[self._order]

    def attach(self, engine: Engine, indices: np.ndarray) -> None:
        """Pass the sparse update to the engine; `indices` are the places of the grid's nodes in a level."""
        self.engine, self.nodes = engine, engine.all_components(indices[tuple(self.fringe.index.T)])
        outside = engine.all_components(indices[self.outside])
        self.unmoved = np.concatenate([engine.all_components(indices[self.halo]), outside])
        sums = FringeSums(self._fronts, self.rows, self.update.indptr, self.update.indices, self.update.data)
        engine.replace(outline_stencil=outline_table(self.nodes, self.levels, sums, outside))

    def start(self) -> None:
        """Initialise the memory with the state one step ago, before which all was at rest."""
        self.engine.put("outline_stencil.history.T", 0)
        if self.levels > 2:
            self.engine.put("outline_stencil.history.T", self.engine.get("u_old", self.nodes), 0)

    def mark(self) -> float:
        """Return a number that differs between conditions."""
        return float(np.abs(self.update.data).sum())

    def describe(self) -> str:
        """Describe what closes the outline, for the report."""
        entries = np.diff(self.update.indptr)
        return "; ".join(
            [
                f"{len(self.rows)} halo nodes from {entries.min()} to {entries.max()} values each, {self.levels} "
                f"levels of {len(self.fringe.points)} nodes kept",
                *dict.fromkeys(self.fringe.remarks),
            ]
        )


def _widened(part: sparse.csr_array, columns: int) -> sparse.csr_array:
    return sparse.csr_array((part.data, part.indices, part.indptr), shape=(part.shape[0], columns))


def ordered_fronts(update: sparse.csr_array, rows: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """An order in which rows can be computed, and the bounds of the fronts in it: a front reads new values of earlier
    fronts only; an InputError if rows depend on each other.

    The first `size` columns of the update, (R, L * size), are new values; `rows` (R,) are the columns that they
    compute.
    """
    number = np.full(size, -1)
    number[rows] = np.arange(len(rows))
    reads = update.tocoo()
    new = reads.col < size
    row, read = reads.row[new], number[reads.col[new]]
    row, read = row[read >= 0], read[read >= 0]
    front = np.zeros(len(rows), int)
    for _ in range(len(rows) + 1):
        later = front.copy()
        np.maximum.at(later, row, front[read] + 1)
        if (later == front).all():
            break
        front = later
    else:
        raise InputError(
            "halo nodes depend on each other: the outline is too narrow for this condition",
            key="boundary",
            remedy="a larger or smoother window, or LatticePML",
        )
    order = np.argsort(front, kind="stable")
    return order, np.searchsorted(front[order], np.arange(front.max(initial=-1) + 2))

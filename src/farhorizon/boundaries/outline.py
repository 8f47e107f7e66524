"""Conditions that close a near field along its outline: the fringe of nodes that they read and fill, and their sparse
update on the engine.

The near field is a window on the medium, or a box. Its halo, the nodes beyond the outline that the operator reads, gets
its values after each step from nodes of the fringe at this step and before. Copies of those are the conditions' memory.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy import ndimage, sparse

from farhorizon.analysis import modes
from farhorizon.boundaries.side import Side
from farhorizon.engine.engine import Engine
from farhorizon.engine.fringe import fringe_table
from farhorizon.errors import InputError
from farhorizon.geometry.shapes import Ball, Box, Disc, Shape

SERIES = 40  # terms of the continuum's series: it converges everywhere, and does not cancel for modes that decay
_SMOOTHING = 3.0  # nodes over which the outline of a general shape is smoothed before its normals are taken


@dataclass(frozen=True)
class Medium:
    """What lies beyond the nodes: a homogeneous medium and the steps that it takes.

    Attributes
    ----------
    order : {1, 2}
        Diffusion by forward Euler, or waves by velocity Verlet.
    coefficient : float
        Diffusivity or squared speed of long waves.
    dt : float
    damping : float
        d in ``2 d u_t``.
    offsets, weights : ndarray, shapes (J, dim) and (J,)
        Bonds as vectors and their weights in units of the operator, where the dispersion is that of a stencil.
    horizon : float
    series : tuple of float
        Terms of the kernel's dispersion in (k horizon)^2, see `Kernel.series`.
    """

    order: int
    coefficient: float
    dt: float
    damping: float = 0.0
    offsets: np.ndarray = field(default_factory=lambda: np.zeros((0, 1)))
    weights: np.ndarray = field(default_factory=lambda: np.zeros(0))
    horizon: float = 0.0
    series: tuple[float, ...] = ()

    @cached_property
    def _long(self) -> float:
        """Coefficient of long waves on the lattice, if there is one: that of a kernel that is not calibrated differs
        from the model's.
        """
        return float(self.weights @ self.offsets[:, 0] ** 2) / 2 if len(self.weights) else self.coefficient

    def symbol(self, k: np.ndarray, dispersion: str) -> np.ndarray:
        """S at wavevectors (M, dim) by one of the dispersion relations of `PlaneWave`.

        Raises
        ------
        InputError
            A dispersion relation that the medium does not have.
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


class Closing(Side, ABC):
    """A condition that closes an outline: it determines the values of the halo from nodes of the near field."""

    endless: ClassVar[bool] = True
    closing: ClassVar[bool] = True
    vectors: ClassVar[bool] = False
    reactive: ClassVar[bool] = False  # its waves are those of the bonds alone
    #: Thickness of the halo that it fills; as far as the stencil reads unless given.
    layer: float | None = None

    @abstractmethod
    def wanted(self, default: float) -> float:
        """Fraction of the largest value that may be neglected beyond the outline."""

    def width(self, reach: int, spacing: float) -> int:
        """Thickness of the halo in nodes."""
        return reach if self.layer is None else int(self.layer / spacing + 1e-9)

    @abstractmethod
    def depth(self, medium: Medium, spacing: float, extent: float) -> float:
        """Distance to which nodes are read inwards, for a near field of half the extent `extent`."""

    @abstractmethod
    def update(self, fringe: OutlineNodes, halo: np.ndarray, medium: Medium) -> sparse.csr_array:
        """Rows for the halo nodes (locations in the fringe) over the new level and those before, shape (H, L S)."""


@dataclass
class Outline:
    """A near field among the nodes of a grid, and what lies around it.

    Attributes
    ----------
    origin : ndarray, shape (dim,)
        Coordinates of the grid's first node.
    spacing : float
    near : ndarray of bool
        The near field, over the grid.
    window : Shape or None
        What it was cut out with; None: a box.
    sides : dict of (axis, side) to Closing
        Sides of the box that conditions close; all for a window.
    periodic : set of int
        Axes that close on themselves.
    free : set of (axis, side)
        Sides of the grid across which there are no bonds.
    offsets : ndarray, shape (J, dim)
        Of the stencil, in nodes.
    """

    origin: np.ndarray
    spacing: float
    near: np.ndarray
    window: Shape | None
    sides: Mapping[tuple[int, int], Closing]
    periodic: frozenset[int]
    free: frozenset[tuple[int, int]]
    offsets: np.ndarray

    def halo(self) -> np.ndarray:
        """Nodes beyond the outline whose values conditions give, over the grid: those that the stencil reads, or a
        layer of given thickness.
        """
        layer = next((b.layer for b in self.sides.values() if b.layer is not None), None)
        if layer is None:
            found = np.zeros_like(self.near)
            for offset in self.offsets:
                found |= self._shifted(self.near, offset)
            return found & ~self.near
        reach = int(layer / self.spacing + 1e-9)
        pads = [(reach if a in self.periodic else 0,) * 2 for a in range(self.near.ndim)]
        distance = ndimage.distance_transform_edt(~np.pad(self.near, pads, mode="wrap"))
        inner = tuple(slice(p, p + n) for (p, _), n in zip(pads, self.near.shape, strict=True))
        return np.asarray(~self.near & (distance[inner] <= layer / self.spacing * (1 + 1e-9)))

    def _shifted(self, mask: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """The mask moved by an offset; periodic axes wrap."""
        out = mask
        for axis, step in enumerate(offset.tolist()):
            out = np.roll(out, step, axis)
            if step and axis not in self.periodic:
                edge = slice(0, step) if step > 0 else slice(step, None)
                out[tuple(edge if a == axis else slice(None) for a in range(mask.ndim))] = False
        return out

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """First and last node of the near field along each axis."""
        found = np.argwhere(self.near)
        return found.min(0), found.max(0)

    def normals(self, index: np.ndarray) -> np.ndarray:
        """Outward unit normals at nodes (N, dim) beyond the outline: of a disc or ball radial, of a box away from its
        nearest point.
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
        """Steps of nodes (N, dim) beyond the box along each axis."""
        low, high = self.bounds()
        return index - np.clip(index, low, high)


class OutlineNodes:
    """Nodes that conditions read or fill.

    Parameters
    ----------
    outline : Outline
    halo : ndarray of bool
        Over the grid.
    depth : float
        How far into the near field the conditions read.

    Attributes
    ----------
    index : ndarray of int, shape (S, dim)
        Nodes of the grid.
    points : ndarray, shape (S, dim)
        Their coordinates.
    filled : ndarray of int
        Places of the halo nodes in the fringe.
    normals : ndarray, shape (S, dim)
        Outward, at the halo nodes; others zero.
    axes : ndarray of int, shape (S, dim)
        The grid axis nearest to the normal.
    faces : ndarray of int, shape (S, dim), or None
        Outward directions of the box's sides on or beyond which halo nodes lie; None for other outlines.
    extent : float
        Half the extent of the near field.
    spacing, depth : float
    """

    def __init__(self, outline: Outline, halo: np.ndarray, depth: float) -> None:
        self.outline, self.spacing, self.depth = outline, outline.spacing, depth
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
        """Places of nodes (N, dim) of the grid in the fringe, -1 for others; periodic axes wrap."""
        shape = np.array(self._places.shape)
        wrapped = np.where([a in self.outline.periodic for a in range(len(shape))], index % shape, index)
        inside = ((wrapped >= 0) & (wrapped < shape)).all(1)
        return np.where(inside, self._places[tuple(np.clip(wrapped, 0, shape - 1).T)], -1)

    def bonded(self, index: np.ndarray) -> np.ndarray:
        """True for nodes (N, dim) to which bonds exist: all but those beyond free sides."""
        shape = self._places.shape
        absent = [(index[:, a] < 0) if side < 0 else (index[:, a] >= shape[a]) for a, side in self.outline.free]
        return ~np.any(absent, axis=0) if absent else np.ones(len(index), bool)

    def with_images(self, distance: float) -> tuple[np.ndarray, np.ndarray]:
        """All points, then their images within a distance beyond periodic sides, and the place in the fringe of
        each."""
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
        """Halo nodes that each side fills, as places: the side beyond which they lie furthest."""
        sides = list(self.outline.sides)
        if self.outline.window is not None or len({repr(b) for b in self.outline.sides.values()}) == 1:
            return {sides[0]: self.filled}
        steps = self.outline.faces(self.index[self.filled])
        beyond = np.stack([side * steps[:, axis] for axis, side in sides], axis=1)
        owner = np.argmax(beyond, axis=1)
        return {key: self.filled[owner == number] for number, key in enumerate(sides) if (owner == number).any()}


class Closure:
    """The conditions along one outline, on an engine.

    Parameters
    ----------
    outline : Outline
    medium : Medium

    Attributes
    ----------
    halo, outside : ndarray of bool
        Over the grid: filled nodes, and those beyond, which do not exist.
    fringe : OutlineNodes
    update : csr_array, shape (H, L S)
        New values of the halo from the fringe at the new step and at L - 1 before.

    Raises
    ------
    InputError
        A condition that does not serve the medium or the outline.
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
        self.levels = max(part.shape[1] for part in parts.values()) // len(self.fringe.points)
        rows = np.concatenate([self.fringe.owners()[key] for key in parts])
        found = sparse.vstack(
            [_widened(part, self.levels * len(self.fringe.points)) for part in parts.values()]
        ).tocsr()
        self._order, self._fronts = ordered_fronts(found, rows, len(self.fringe.points))
        self.rows, self.update = rows[self._order], found[self._order]

    def attach(self, engine: Engine, indices: np.ndarray) -> None:
        """Give the engine the sparse update; `indices` are the places of the grid's nodes in a level."""
        self.engine, self.nodes = engine, indices[tuple(self.fringe.index.T)]
        self.unmoved = np.concatenate([indices[self.halo], indices[self.outside]])
        found = self.update.indptr, self.update.indices, self.update.data
        sums = fringe_table(self.nodes, self.levels, self._fronts, self.rows, *found, indices[self.outside])
        engine.replace(fringe=sums)

    def start(self) -> None:
        """The memory holds the state one step ago; before that all was at rest."""
        history = self.engine.fringe_history
        history[...] = 0
        if self.levels > 2:
            history[0] = self.engine.older[self.nodes]

    def mark(self) -> float:
        """A number that differs for other conditions."""
        return float(np.abs(self.update.data).sum())

    def describe(self) -> str:
        """What closes the outline, for the report."""
        entries = np.diff(self.update.indptr)
        return (
            f"{len(self.rows)} halo nodes from {entries.min()} to {entries.max()} values each, {self.levels} levels of "
            f"{len(self.fringe.points)} nodes kept"
        )


def _widened(part: sparse.csr_array, columns: int) -> sparse.csr_array:
    return sparse.csr_array((part.data, part.indices, part.indptr), shape=(part.shape[0], columns))


def ordered_fronts(update: sparse.csr_array, rows: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Order in which rows can be computed, and the bounds of the fronts in it: a front reads new values of earlier ones
    only.

    Parameters
    ----------
    update : csr_array, shape (R, L * size)
        Its first `size` columns are new values.
    rows : ndarray of int, shape (R,)
        The column that each row computes.
    size : int

    Raises
    ------
    InputError
        Rows that wait for each other.
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

"""The uniform lattice: spacing, bounds, nodes; a window on the medium, or a body that ends."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from farhorizon.errors import InputError
from farhorizon.machine import available_memory
from farhorizon.shapes import Shape

AXES = ("x", "y", "z")


class Lattice:
    """Nodes ``lower, lower + spacing, ..., upper`` (both included) along each of one to three axes.

    Parameters
    ----------
    spacing : float
        Distance of neighbouring nodes, the same along every axis.
    lower, upper : sequence of float or float, optional
        Bounds of the near field. ``upper - lower`` is a whole number of spacings to 1e-9.
    window : Shape, optional
        A window on the medium instead of bounds: the lattice (through the origin) covers the bounding box,
        nothing ends at the window's edge, and only nodes inside are shown.
    body : Shape, optional
        A body that ends: nodes outside do not exist. Needs bounds.

    Raises
    ------
    InputError
        Spacing not positive, bounds that are no whole number of spacings apart, an empty window or body.
    """

    def __init__(
        self,
        spacing: float,
        lower: ArrayLike | None = None,
        upper: ArrayLike | None = None,
        *,
        window: Shape | None = None,
        body: Shape | None = None,
    ) -> None:
        if not (np.isfinite(spacing) and spacing > 0):
            raise InputError("the spacing must be positive and finite", value=spacing, limit="> 0", key="lattice.spacing")
        self.spacing = float(spacing)
        self.window, self.body = window, body
        if window is not None:
            if lower is not None or upper is not None or body is not None:
                raise InputError("a window replaces lower, upper and body", key="lattice.window", remedy="give the window alone")
            low, high = window.bounds()
            first = np.ceil(np.asarray(low) / spacing - 1e-9).astype(int)
            last = np.floor(np.asarray(high) / spacing + 1e-9).astype(int)
        elif lower is None or upper is None:
            raise InputError("a lattice needs lower and upper, or a window", key="lattice", remedy="give lower=(...), upper=(...)")
        else:
            first, last = self._whole_spacings(np.atleast_1d(np.asarray(lower, float)), np.atleast_1d(np.asarray(upper, float)))
        self.shape: tuple[int, ...] = tuple(int(n) for n in last - first + 1)
        self.dim = len(self.shape)
        if min(self.shape) < 1:
            raise InputError("the lattice holds no node", value=self.shape, key="lattice", remedy="a smaller spacing or a larger window")
        self.lower = np.asarray(first * self.spacing if window is not None else np.atleast_1d(np.asarray(lower, float)))
        self.upper = self.lower + (np.array(self.shape) - 1) * self.spacing
        region = window if window is not None else body
        self.mask: np.ndarray | None = None
        if region is not None:
            if region.dim != self.dim:
                raise InputError("shape and lattice differ in dimension", value=region.dim, limit=self.dim, key="lattice")
            need = 8 * (3 * self.dim + 2) * float(np.prod(np.array(self.shape, float)))
            if need > available_memory():
                size = f"about {need / 2**30:.3g} GiB for {' x '.join(map(str, self.shape))} nodes"
                raise InputError("the lattice does not fit into memory", value=size,
                                 limit=f"{available_memory() / 2**30:.3g} GiB available", key="lattice.spacing",
                                 remedy="a larger spacing or a smaller window")  # fmt: skip
            self.mask = region.contains(np.stack(self.coordinates(), axis=-1))
            if not self.mask.any():
                raise InputError("no node lies in the window or body", key="lattice", remedy="a smaller spacing or a larger shape")

    def _whole_spacings(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if lower.shape != upper.shape or lower.ndim != 1 or not 1 <= len(lower) <= 3:
            raise InputError("lower and upper need the same length, 1 to 3", value=(lower.tolist(), upper.tolist()), key="lattice")
        if not (np.isfinite(lower).all() and np.isfinite(upper).all() and (upper >= lower).all()):
            raise InputError("bounds must be finite with upper >= lower", value=(lower.tolist(), upper.tolist()), key="lattice")
        steps = (upper - lower) / self.spacing
        whole = np.round(steps)
        if np.any(np.abs(steps - whole) > 1e-9 * np.maximum(1.0, whole)):
            nearest = (lower + whole * self.spacing).tolist()
            raise InputError(
                "upper - lower is not a whole number of spacings",
                value=(upper - lower).tolist(),
                limit=f"multiples of {self.spacing}",
                key="lattice.upper",
                remedy=f"nearest upper = {nearest}",
            )
        return np.zeros(len(lower), int), whole.astype(int)

    @property
    def axes(self) -> list[np.ndarray]:
        """Coordinates of the nodes along each axis, one array (n,) an axis."""
        return [self.lower[a] + self.spacing * np.arange(n) for a, n in enumerate(self.shape)]

    def coordinates(self) -> list[np.ndarray]:
        """Coordinates of all nodes, one array of the lattice's shape an axis."""
        return list(np.meshgrid(*self.axes, indexing="ij"))

    def index(self, point: ArrayLike) -> tuple[int, ...]:
        """Index of the node nearest to a point; InputError beyond the near field or outside the window."""
        at = np.asarray(point, float)
        if at.shape != (self.dim,) or not np.isfinite(at).all():
            raise InputError("a point needs one finite coordinate an axis", value=np.atleast_1d(at).tolist(), limit=f"{self.dim} coordinates")
        node = tuple(int(i) for i in np.round((at - self.lower) / self.spacing))
        inside = all(0 <= i < n for i, n in zip(node, self.shape, strict=True))
        if not inside or (self.mask is not None and not self.mask[node]):
            raise InputError(
                "the point lies outside the near field",
                value=at.tolist(),
                limit=f"{self.lower.tolist()} to {self.upper.tolist()}",
                remedy="move it inside or enlarge the lattice",
            )
        return node

    def extended(self, nodes: dict[tuple[int, int], int]) -> Lattice:
        """The lattice with more nodes beyond its sides (axis, side); a body continues along the normal, a window is dropped."""
        pads = [(nodes.get((a, -1), 0), nodes.get((a, 1), 0)) for a in range(self.dim)]
        low, high = (np.array([p[i] for p in pads]) * self.spacing for i in range(2))
        grown = Lattice(self.spacing, self.lower - low, self.upper + high)
        if self.body is not None and self.mask is not None:
            grown.body, grown.mask = self.body, np.pad(self.mask, pads, mode="edge")
        return grown

    @property
    def nodes(self) -> int:
        """Number of nodes that are shown."""
        return int(np.prod(self.shape)) if self.mask is None else int(self.mask.sum())

    def __repr__(self) -> str:
        return f"Lattice(spacing={self.spacing}, lower={self.lower.tolist()}, upper={self.upper.tolist()}, nodes={self.nodes})"

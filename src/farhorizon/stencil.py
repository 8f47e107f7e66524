"""Stencils: offsets and weights of a linear lattice operator, and what their symbol tells."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from farhorizon.errors import InputError
from farhorizon.kernel import Kernel

_MOST_NEIGHBOURS = 100_000  # of a kernel's stencil: far beyond use, and soon built


@dataclass(frozen=True)
class BackwardWaves:
    """Waves whose group and phase velocity have opposite signs along an axis.

    Attributes
    ----------
    growth : float
        Largest first-order growth rate per unit of layer strength sigma, 0 without backward waves.
    fraction : float
        Part of the Brillouin zone where waves are backward along any axis.
    first_wavenumber : float
        Smallest |k| times spacing among them (inf without).
    """

    growth: float
    fraction: float
    first_wavenumber: float

    def __bool__(self) -> bool:
        return self.growth > 0


class Stencil:
    """A translation-invariant operator ``(L u)_i = sum_k w_k (u_(i+k) - u_i)`` for unit spacing and coefficient.

    Parameters
    ----------
    offsets : array_like of int, shape (K, dim)
        Neighbours, without the centre.
    weights : array_like, shape (K,)
        A model scales them by ``coefficient / spacing^2``.

    Raises
    ------
    InputError
        Repeated or zero offsets, weights that are not finite, a stencil that is not symmetric under k -> -k.
    """

    def __init__(self, offsets: np.ndarray, weights: np.ndarray) -> None:
        offsets = np.atleast_2d(np.asarray(offsets, int))
        weights = np.asarray(weights, float)
        if offsets.shape[0] != weights.size or not 1 <= offsets.shape[1] <= 3:
            raise InputError("a stencil needs one weight an offset, in 1 to 3 dimensions", value=(offsets.shape, weights.shape))
        if not np.isfinite(weights).all():
            raise InputError("stencil weights must be finite", value=weights)
        table = {tuple(o): w for o, w in zip(offsets.tolist(), weights, strict=True)}
        if len(table) != len(weights) or (0,) * offsets.shape[1] in table:
            raise InputError("stencil offsets must be distinct and not zero", value=offsets.tolist())
        for o, w in table.items():
            if abs(table.get(tuple(-i for i in o), np.inf) - w) > 1e-12 * np.abs(weights).max():
                raise InputError("a stencil must have equal weights at k and -k", value=o, remedy="symmetrise the table")
        order = np.lexsort(offsets.T[::-1])
        self.offsets, self.weights = offsets[order], weights[order]
        self.dim = offsets.shape[1]

    @classmethod
    def from_kernel(cls, kernel: Kernel, spacing: float, dim: int) -> Stencil:
        """Stencil of a kernel by one-point quadrature with the kernel's volume rule.

        Raises
        ------
        InputError
            A horizon below the spacing (no neighbours), or so many spacings wide that the stencil has above 100 000 neighbours.
        """
        if kernel.horizon < spacing * (1 - 1e-9):
            raise InputError(
                "the horizon is smaller than the spacing, no node has neighbours",
                value=kernel.horizon,
                limit=f">= {spacing}",
                key="kernel.horizon",
                remedy=f"horizon = {3 * spacing:g} (three spacings) or a finer lattice",
            )
        delta = kernel.horizon / spacing
        reach = int(np.floor(delta + (0.5 if kernel.volume == "ramp" else 0.0) + 1e-9))
        if (2 * reach + 1) ** dim > _MOST_NEIGHBOURS:
            most = int((_MOST_NEIGHBOURS ** (1 / dim) - 1) / 2)
            raise InputError("the horizon spans too many nodes", value=f"{reach} nodes", limit=f"{most} nodes in {dim}D", key="kernel.horizon",
                             remedy=f"horizon = {3 * spacing:g} (three spacings) or a coarser lattice")  # fmt: skip
        grid = np.array([o for o in itertools.product(range(-reach, reach + 1), repeat=dim) if any(o)])
        r = np.sqrt((grid**2).sum(1))
        share = np.clip(delta + 0.5 - r, 0.0, 1.0) if kernel.volume == "ramp" else (r <= delta + 1e-9).astype(float)
        c = kernel.scaling_constant(dim) * spacing ** (dim + 2 - kernel.exponent)
        weights = c * kernel.influence_at(r * spacing) * share * r ** -float(kernel.exponent)
        used = weights > 1e-14 * weights.max()
        grid, weights = grid[used], weights[used]
        if kernel.calibrate:
            weights = weights / (0.5 * (weights * grid[:, 0] ** 2).sum())
        return cls(grid, weights)

    @classmethod
    def finite_difference(cls, dim: int) -> Stencil:
        """The classical 3-, 5- or 7-point Laplacian."""
        eye = np.eye(dim, dtype=int)
        return cls(np.concatenate([eye, -eye]), np.ones(2 * dim))

    @classmethod
    def finite_element(cls, dim: int) -> Stencil:
        """Lumped linear, bilinear or trilinear finite elements on a uniform mesh: 3, 9 or 27 points."""
        stiffness, mass = np.array([1.0, -2.0, 1.0]), np.array([1.0, 4.0, 1.0]) / 6
        table = np.zeros((3,) * dim)
        for axis in range(dim):
            factors = [stiffness if a == axis else mass for a in range(dim)]
            table += np.einsum(",".join("ijk"[:dim]) + "->" + "ijk"[:dim], *factors)
        grid = np.array([o for o in itertools.product((-1, 0, 1), repeat=dim) if any(o)])
        weights = np.array([table[tuple(o + 1)] for o in grid])
        used = np.abs(weights) > 1e-14
        return cls(grid[used], weights[used])

    def along(self, axis: int) -> Stencil:
        """The same stencil with another axis first, the rest in their order."""
        order = [axis, *(a for a in range(self.dim) if a != axis)]
        return Stencil(self.offsets[:, order], self.weights)

    @cached_property
    def reach(self) -> tuple[int, ...]:
        """Largest offset along each axis."""
        return tuple(int(n) for n in np.abs(self.offsets).max(0))

    def symbol(self, *angles: np.ndarray | float) -> np.ndarray:
        """``sum_k w_k (1 - cos(k . angle))`` at wavenumbers times spacing, one array an axis (broadcast)."""
        total: np.ndarray = np.zeros(np.broadcast_shapes(*(np.shape(a) for a in angles)))
        for o, w in zip(self.offsets, self.weights, strict=True):
            phase = sum(int(i) * np.asarray(a, float) for i, a in zip(o, angles, strict=True))
            total = total + 2 * w * np.sin(phase / 2) ** 2
        return total

    def symbol_gradient(self, axis: int, *angles: np.ndarray | float) -> np.ndarray:
        """Derivative of the symbol along one axis."""
        total: np.ndarray = np.zeros(np.broadcast_shapes(*(np.shape(a) for a in angles)))
        for o, w in zip(self.offsets, self.weights, strict=True):
            phase = sum(int(i) * np.asarray(a, float) for i, a in zip(o, angles, strict=True))
            total = total + w * o[axis] * np.sin(phase)
        return total

    def _zone(self) -> list[np.ndarray]:
        """A sample of the Brillouin zone as open grids; the symbol is even, so half of the first axis is enough."""
        count = {1: 4097, 2: 129, 3: 33}[self.dim]
        half, full = np.linspace(0, np.pi, count), np.linspace(-np.pi, np.pi, 2 * count - 1)
        return list(np.ix_(half, *[full] * (self.dim - 1)))

    @cached_property
    def symbol_maximum(self) -> float:
        """Largest value of the symbol over the Brillouin zone."""
        from scipy.optimize import minimize

        zone = self._zone()
        values = self.symbol(*zone)
        best = float(values.max())
        for flat in np.argsort(values, axis=None)[-3:]:
            index = np.unravel_index(flat, values.shape)
            start = [float(axis.ravel()[i]) for axis, i in zip(zone, index, strict=True)]
            found = minimize(lambda a: -float(self.symbol(*a)), start, method="BFGS", options={"gtol": 1e-12})
            best = max(best, -float(found.fun))
        return best

    def backward_waves(self) -> BackwardWaves:
        """Backward waves along any axis, from the sign of group against phase velocity on the Brillouin zone."""
        zone = self._zone()
        value = self.symbol(*zone)
        growth = np.zeros_like(value)
        inner = value > 1e-9 * value.max()
        for axis in range(self.dim):
            slope = np.sin(zone[axis]) * self.symbol_gradient(axis, *zone)
            growth = np.maximum(growth, np.where(inner, -slope / np.where(inner, 2 * value, 1.0), 0.0))
        growth[growth < 1e-9] = 0.0
        radius = np.sqrt(sum(a**2 for a in zone))
        found = growth > 0
        return BackwardWaves(float(growth.max()), float(found.mean()), float(radius[found].min()) if found.any() else np.inf)

    def __repr__(self) -> str:
        return f"Stencil(dim={self.dim}, neighbours={len(self.weights)}, reach={self.reach})"

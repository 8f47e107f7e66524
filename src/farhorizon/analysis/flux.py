"""Flux of a nonlocal conductor: one-sided at nodes, and across planes. Plain arrays in, plain arrays out.

The flux at a node is the sum over the bonds to one side of ``k (T' - T) / distance`` (Bobaru and Duangpanya 2010, eqs 19 and 20, whose
signs differ: here it is positive along an axis when heat flows that way). It is exact for a linear temperature if all those bonds exist;
where they do not, the other side's bonds serve, and where neither side is whole all that exist, normalised by their own second moments.
"""

from __future__ import annotations

import numpy as np

_SINGULAR = 1e-8  # second moments of the bonds left, relative to those of all


def shifted(values: np.ndarray, offset: np.ndarray) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Slices of the nodes that have a neighbour at an offset, and of those neighbours."""
    near = tuple(slice(max(0, -o), n - max(0, o)) for o, n in zip(offset.tolist(), values.shape, strict=True))
    far = tuple(slice(max(0, o), n - max(0, -o)) for o, n in zip(offset.tolist(), values.shape, strict=True))
    return near, far


def nodal_flux(u: np.ndarray, offsets: np.ndarray, weights: np.ndarray, bonds: np.ndarray, spacing: float) -> np.ndarray:
    """Flux at every node, along each axis.

    Parameters
    ----------
    u : ndarray, shape (n..)
        Temperature; bonds to nodes that do not exist have factor 0.
    offsets : ndarray of int, shape (K, dim)
    weights : ndarray, shape (K,)
        Conductivity times the dimensionless weights: half their second moment along an axis is the conductivity.
    bonds : ndarray, shape (K, n..)
        Factor of each node's bond along each offset: 0 where it is absent, the ratio of the conductivities in composites.
    spacing : float

    Returns
    -------
    ndarray, shape (dim, n..)
        nan where the bonds left do not determine the gradient.
    """
    dim = u.ndim
    whole = 0.5 * (weights[:, None] * offsets**2).sum(0)
    flux = np.full((dim, *u.shape), np.nan)
    steps = np.zeros((len(weights), *u.shape))
    for number, offset in enumerate(offsets):
        near, far = shifted(u, offset)
        steps[number][near] = u[far] - u[near]
    steps = np.where(bonds > 0, steps, 0.0)
    for axis in range(dim):
        for side in (1, -1):  # bonds ahead where they are whole, else those behind
            half = offsets[:, axis] * side > 0
            ready = (bonds[half] > 0).all(axis=0) & np.isnan(flux[axis])
            along = (weights[half] * offsets[half, axis]).reshape(-1, *[1] * dim)
            flux[axis][ready] = -((along * bonds[half] * steps[half]).sum(0) / spacing)[ready]
    left = np.argwhere(np.isnan(flux).any(axis=0))
    for node in map(tuple, left):
        here = (slice(None), *node)
        there = bonds[here] > 0
        arms = offsets[there].astype(float)
        moment = (weights[there][:, None, None] * arms[:, :, None] * arms[:, None, :]).sum(0)
        if there.any() and np.linalg.svd(moment, compute_uv=False)[-1] > _SINGULAR * whole.max():
            slope = np.linalg.solve(moment, (weights[there] * bonds[here][there] * steps[here][there]) @ arms) / spacing
            values = -whole * slope
            flux[here] = np.where(np.isnan(flux[here]), values, flux[here])
    return flux


def power_across(u: np.ndarray, offsets: np.ndarray, weights: np.ndarray, bonds: np.ndarray, spacing: float, axis: int, row: int) -> float:
    """Power that crosses, towards larger coordinates, the plane half-way between the nodes `row` and `row + 1` along an axis.

    The sum over all bonds that cross it: what leaves one part of the body and enters the other, exactly.

    Parameters
    ----------
    u, offsets, weights, bonds, spacing
        As for `nodal_flux`.
    axis, row : int

    Returns
    -------
    float
        Power; per area in 1D, per thickness in 2D.
    """
    total = 0.0
    for number, offset in enumerate(offsets):
        if offset[axis] <= 0:
            continue
        near, far = shifted(u, offset)
        start = max(0, row - int(offset[axis]) + 1)
        crossing = tuple(slice(start, row + 1) if a == axis else s for a, s in enumerate(near))
        beyond = tuple(slice(start + int(offset[axis]), row + 1 + int(offset[axis])) if a == axis else s for a, s in enumerate(far))
        factor = bonds[number][crossing]
        ends = u[beyond]
        count = min(factor.shape[axis], ends.shape[axis])
        cut = tuple(slice(0, count) if a == axis else slice(None) for a in range(u.ndim))
        exists = factor[cut] > 0
        total += weights[number] * float(np.where(exists, factor[cut] * (u[crossing][cut] - ends[cut]), 0.0).sum())
    return total * spacing ** (u.ndim - 2)

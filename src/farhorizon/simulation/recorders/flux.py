"""Flux of a nonlocal conductor at nodes, from one-sided sums, and across planes.

The flux at a node is the sum over the bonds to one side of ``k (T' - T) / distance`` (Bobaru and Duangpanya 2010, eqs
19 and 20, with opposite sign: here it is positive if heat flows in the direction of the axis). It is exact for a linear
temperature if all those bonds exist; if some do not, the bonds to the other side are used, and if neither side is
complete all existing bonds, normalised by their own second moments.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from farhorizon import kinds
from farhorizon.engine.missing_bonds import FAINT
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import AXES, Lattice
from farhorizon.simulation.heat.solid_and_liquid import SolidAndLiquid
from farhorizon.simulation.setup.compatibility import check_lossless
from farhorizon.simulation.setup.grid import Grid
from farhorizon.simulation.setup.near_field import NearField

#: Takes the number of an offset and returns the factor of each node's bond along it, shape (n..): 0 where the bond is
#: absent, the ratio of the conductivities in composites.
Bonds = Callable[[int], np.ndarray]
_SINGULAR = 1e-8  # second moments of the remaining bonds, relative to those of all


def shifted(values: np.ndarray, offset: np.ndarray) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Return the slices of the nodes that have a neighbour at an offset, and of those neighbours."""
    near = tuple(slice(max(0, -o), n - max(0, o)) for o, n in zip(offset.tolist(), values.shape, strict=True))
    far = tuple(slice(max(0, o), n - max(0, -o)) for o, n in zip(offset.tolist(), values.shape, strict=True))
    return near, far


def nodal_flux(u: np.ndarray, offsets: np.ndarray, weights: np.ndarray, bonds: Bonds, spacing: float) -> np.ndarray:
    """Return the flux at every node along each axis, shape (dim, n..); nan where the bonds do not determine the
    gradient.

    The weights are the conductivity times dimensionless ones: half their second moment along an axis is the
    conductivity.
    """
    dim = u.ndim
    sums, complete = np.zeros((2, dim, *u.shape)), np.ones((2, dim, *u.shape), bool)  # over the bonds ahead and behind
    for number, offset in enumerate(offsets):
        factor = bonds(number)
        gain = weights[number] * _gains(u, offset, factor) / spacing
        for axis in np.flatnonzero(offset):
            side = 0 if offset[axis] > 0 else 1
            sums[side, axis] -= offset[axis] * gain
            complete[side, axis] &= factor > 0
    flux = np.where(complete[0], sums[0], np.where(complete[1], sums[1], np.nan))
    undetermined = np.asarray(np.isnan(flux).any(axis=0))
    if undetermined.any():
        flux[:, undetermined] = np.where(
            np.isnan(flux[:, undetermined]),
            _fitted(u, offsets, weights, bonds, spacing, undetermined),
            flux[:, undetermined],
        )
    return flux


def _gains(u: np.ndarray, offset: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """``factor (T' - T)`` along an offset, 0 where there is no bond."""
    near, far = shifted(u, offset)
    gain = np.zeros(u.shape)
    gain[near] = u[far] - u[near]
    return np.where(factor > 0, factor * gain, 0.0)


def _fitted(
    u: np.ndarray, offsets: np.ndarray, weights: np.ndarray, bonds: Bonds, spacing: float, where: np.ndarray
) -> np.ndarray:
    """Flux at the nodes of a mask from all existing bonds, normalised by their second moments; shape (dim, nodes)."""
    dim, count = u.ndim, int(where.sum())
    moment, source_term = np.zeros((count, dim, dim)), np.zeros((count, dim))
    for number, offset in enumerate(offsets):
        factor = bonds(number)
        moment += (weights[number] * (factor[where] > 0))[:, None, None] * np.outer(offset, offset)
        source_term += (weights[number] * _gains(u, offset, factor)[where])[:, None] * offset
    conductivity = 0.5 * (weights[:, None] * offsets**2).sum(0)
    sound = np.linalg.svd(moment, compute_uv=False)[:, -1] > _SINGULAR * conductivity.max()
    slope = np.full((count, dim), np.nan)
    slope[sound] = np.linalg.solve(moment[sound], source_term[sound][..., None])[..., 0] / spacing
    return -(conductivity * slope).T


def power_across(
    u: np.ndarray, offsets: np.ndarray, weights: np.ndarray, bonds: Bonds, spacing: float, axis: int, row: int
) -> float:
    """Return the power that crosses, towards larger coordinates, the plane half-way between the nodes `row` and `row +
    1` along an axis, with the tables of `nodal_flux`; per area in 1D, per thickness in 2D.

    It is the sum over all bonds that cross the plane, and so exactly what leaves one part of the body and enters the
    other.
    """
    total = 0.0
    for number, offset in enumerate(offsets):
        if offset[axis] <= 0:
            continue
        near, far = shifted(u, offset)
        start = max(0, row - int(offset[axis]) + 1)
        crossing = tuple(slice(start, row + 1) if a == axis else s for a, s in enumerate(near))
        beyond = tuple(
            slice(start + int(offset[axis]), row + 1 + int(offset[axis])) if a == axis else s for a, s in enumerate(far)
        )
        factor = bonds(number)[crossing]
        ends = u[beyond]
        count = min(factor.shape[axis], ends.shape[axis])
        cut = tuple(slice(0, count) if a == axis else slice(None) for a in range(u.ndim))
        exists = factor[cut] > 0
        total += weights[number] * float(np.where(exists, factor[cut] * (u[crossing][cut] - ends[cut]), 0.0).sum())
    return total * spacing ** (u.ndim - 2)


def check_drift(near: NearField, key: str) -> None:
    """Refuse to sum flows over bonds where the medium drifts: what one node loses by a bond the other does not gain."""
    if near.stencil.drifting:
        raise InputError(
            "flows are not sums over bonds in a medium that drifts",
            value=type(near.model).__name__,
            limit="weights that are equal at k and -k",
            key=key,
            remedy="the change of what is stored: energies()",
        )


def flux_tables(
    near: NearField, grid: Grid, phases: SolidAndLiquid | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, Bonds]:
    """Return what `nodal_flux` and `power_across` need of a run: the field, offsets and weights of the bonds, and their
    factors, 0 where no bond exists within the near field.
    """
    check_drift(near, "flux")
    check_lossless(near.model, "flux", "Receivers of the field")
    engine, stencil = grid.engine, near.stencil
    u = grid.get("u").astype(float)
    if phases is not None and phases.dissolution.limited:  # the value of the metal in bonds between the phases
        u = np.where(phases.solid, phases.dissolution.saturation - near.background, u)
    nodes = grid.nodes.ravel()
    inside = np.zeros(grid.layout.size, bool)
    inside[nodes] = True

    def factor(number: int) -> np.ndarray:
        neighbours = nodes + grid.layout.distances[number]
        weight = engine.weights[number]
        missing = engine.absent.lost(nodes, neighbours, weight) / weight
        factor_left = engine.factors(nodes, neighbours) * (1 - missing)
        return np.where(inside[neighbours] & (factor_left > FAINT), factor_left, 0.0).reshape(near.lattice.shape)

    return u, stencil.offsets, stencil.weights * near.model.coefficient / near.model.source_factor, factor


def plane(lattice: Lattice, axis: str, position: float) -> tuple[int, int]:
    """Return the number of the axis that a plane is normal to, and the last row of nodes before the plane; raises
    InputError if the lattice does not have the axis, or the plane lies outside it.
    """
    number = AXES.index(kinds.one_of(axis, "axis", AXES[: lattice.dim], "the lattice has no such axis"))
    position = kinds.number(position, "position")
    row = int(np.floor((position - lattice.lower[number]) / lattice.spacing + 1e-9))
    if not 0 <= row < lattice.shape[number] - 1:
        raise InputError(
            "the plane lies outside the near field",
            value=position,
            key="position",
            limit=f"{lattice.lower[number]:.10g} to {lattice.upper[number]:.10g}",
            remedy="move it inside or enlarge the lattice",
        )
    return number, row

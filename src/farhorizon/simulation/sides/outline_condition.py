"""Sides that close the near field from the values of its own nodes: conditions along its outline, and exact ends."""

from __future__ import annotations

import numpy as np

from farhorizon.analysis.exact.chain import Recursion, half_weights
from farhorizon.boundaries import Exact, ExactEnds, Outline, OutlineCondition
from farhorizon.boundaries.outline import SERIES, Medium
from farhorizon.errors import InputError
from farhorizon.medium.kernel import Kernel
from farhorizon.simulation.setup.grid import Grid
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Sides, side_name


def outline_condition(near: NearField, sides: Sides, grid: Grid, solid: np.ndarray) -> OutlineCondition | None:
    """Return the conditions along the outline, None if there are none; raises InputError if the nodes that they read
    are not those of the homogeneous medium, or are metal.
    """
    closing = {key: side for key, side in sides.items() if side.closing}
    if not closing:
        return None
    lattice, model, stencil, factor = near.lattice, near.model, near.stencil, near.factor
    if stencil.components > 1:
        _check_solid(near)
    dx = lattice.spacing
    shape = grid.core.nodes[grid.lead :]
    inside = np.zeros(shape, bool)
    inside[grid.near[-lattice.dim :]] = True if near.closed is None else near.closed
    outline = Outline(
        grid.origin,
        dx,
        inside,
        lattice.window,
        closing,
        frozenset(axis for (axis, _), side in sides.items() if side.periodic),
        frozenset(key for key, side in sides.items() if not side.bonded),
        stencil.offsets,
    )
    first = 0 if near.closed is None else tuple(np.argwhere(near.closed)[0])
    scale = 1.0 if factor is None else float(factor[first].flat[0])
    kernel = given if isinstance(given := getattr(model, "operator", None), Kernel) else None
    medium = Medium(
        model.order,
        model.coefficient * scale,
        near.dt,
        model.damping,
        dx * stencil.offsets,
        stencil.weights * model.coefficient * scale / dx**2,
        0.0 if kernel is None else kernel.horizon,
        () if kernel is None else tuple(kernel.series(lattice.dim, SERIES)),
    )
    condition = OutlineCondition(outline, medium)
    condition.attach(grid.engine, grid.core.node_indices().reshape(shape))
    _check_outline(condition, near, grid, solid)
    return condition


def _check_solid(near: NearField) -> None:
    """Refuse fields of several components whose waves a condition along the outline does not know."""
    model, dim = near.model, near.lattice.dim
    law = model.bond_law is not None
    if dim != 2 or near.stencil.components != dim or law:
        raise InputError(
            "a condition along the outline serves linear elastic media in the plane",
            value=f"{model.title} in {dim} dimensions" + " with bonds that are nonlinear, break or are heated" * law,
            limit="two dimensions, two components, linear bonds",
            key="boundary",
            remedy="LatticePML",
        )


def _check_outline(condition: OutlineCondition, near: NearField, grid: Grid, solid: np.ndarray) -> None:
    """Raise InputError unless a condition along the outline reads the homogeneous medium only: no other material, no
    end of a body, no metal and no constraint.
    """
    material = near.material
    for nodes in (*near.prescribed.nodes, near.conditions.nodes, np.flatnonzero(near.leak), np.flatnonzero(solid)):
        material.flat[nodes] = np.nan
    grown = grid.grown(material).reshape(condition.halo.shape)
    if not np.ptp(grown[tuple(condition.fringe.index.T)]) == 0:
        raise InputError(
            "a condition along the outline reads metal, or nodes where the material varies, the body ends or a "
            "constraint holds",
            key="boundary",
            limit=f"uniform within {condition.fringe.depth:g} of the outline",
            remedy="enlarge the near field, or use a LatticePML",
        )


def exact_ends_of(near: NearField, sides: Sides, grid: Grid) -> ExactEnds | None:
    """Return the exact ends, whose chains have the bonds of the last nodes, None if there are none; raises InputError
    if there are no bonds at an end.
    """
    factor, density = near.factor, near.density
    ends = {side: boundary for (_, side), boundary in sides.items() if isinstance(boundary, Exact)}
    if not ends:
        return None
    last = {side: 0 if side < 0 else -1 for side in ends}  # the last node before each
    if factor is not None and any(factor[node] == 0 for node in last.values()):
        raise InputError(
            "the medium beyond an exact end needs bonds",
            value=0.0,
            limit="positive at the end",
            key="coefficient",
            remedy="Free",
        )
    recursion = Recursion.of(near.model.integrator, near.dt, near.model.damping, float(grid.engine.reaction))
    unit = near.model.coefficient / near.lattice.spacing**2
    bonds = [half_weights(near.stencil, unit, side) for side in ends]
    count = near.stencil.reach[0]
    line = grid.core.node_indices().ravel()
    stiff, heavy = (
        [1.0 if values is None else float(values[node]) for node in last.values()] for values in (factor, density)
    )
    return ExactEnds(
        grid.engine,
        [side_name(0, side) for side in ends],
        list(ends.values()),
        [weights * (factor / mass) for weights, factor, mass in zip(bonds, stiff, heavy, strict=True)],
        heavy,
        recursion,
        np.array([line[0] + np.arange(count) if side < 0 else line[-1] - np.arange(count) for side in ends]),
    )

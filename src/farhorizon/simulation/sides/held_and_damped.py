"""Nodes that are held at the background, lose heat, are damped or never move, and their continuation beyond the near
field.
"""

from __future__ import annotations

import numpy as np

from farhorizon.engine.features.damping import set_damping
from farhorizon.errors import InputError
from farhorizon.simulation.setup.cuts import CutBonds
from farhorizon.simulation.setup.grid import Grid
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Key, Sides, side_name
from farhorizon.simulation.setup.supports import Supports
from farhorizon.simulation.sides.layered_sides import LayeredSides


def _held(near: NearField) -> tuple[np.ndarray, np.ndarray]:
    """Return which values conditions or constraints hold, and which of these are held at the background for ever;
    components first, then the shape of the lattice.
    """
    held, steady = np.zeros((2, near.stencil.components, *near.lattice.shape), bool)
    held.ravel()[np.concatenate([near.conditions.nodes, near.prescribed.held(0)])] = True
    steady.ravel()[np.concatenate([near.conditions.nodes[near.conditions.resting], near.prescribed.at_rest])] = True
    return held, steady


def _leak(near: NearField) -> np.ndarray:
    """Rates at which nodes lose heat, of the shape of the lattice."""
    return near.leak if near.leak.size else np.zeros(near.lattice.shape)


def check_conditions(near: NearField, sides: Sides, margins: dict[Key, int], notes: list[str]) -> None:
    """Check conditions next to absorbing sides. Beyond such a side the medium continues as at the edge and comes to
    rest, including surfaces that lose heat and nodes that are held at the background. `margins` are the nodes of the
    core beyond the near field; `notes` receives notes for the user. Raises InputError if a condition within reach of
    such a side ends, varies or does not let the medium come to rest.
    """
    (held, steady), leak = _held(near), _leak(near)
    if not held.any() and not leak.any():
        return
    busy = (held & ~steady).any(0) | (leak > 0) & near.conditions.heated(leak.shape)
    for (axis, side), boundary in sides.items():
        if not boundary.endless or boundary.exact or boundary.closing:
            continue
        reach, name = near.stencil.reach[axis], side_name(axis, side)
        near_layer = max(reach - margins[axis, side] + 1, int(boundary.stretched))
        if count := np.count_nonzero(np.take(busy, _last(leak.shape[axis], side, near_layer), axis)):
            limit, remedy = (
                f"nodes held at the background, {near.background:g}, for ever",
                "keep what moves away from it",
            )
            if near.model.order == 1:
                limit = f"convection to the background, or {limit}"
                remedy = "background = the value far away, restrict the condition by `within`"
            raise InputError(
                f"a condition holds on nodes within one reach of the absorbing side {name}, where the medium "
                "must come to rest",
                value=f"{count} nodes",
                key="constraints",
                limit=f"{limit}, on the last {reach + 1} nodes",
                remedy=f"{remedy}, or a Free side there",
            )
        last = _last(leak.shape[axis], side, reach + 1)
        surfaces = [np.take(steady, last, 1 + axis).swapaxes(0, 1 + axis), np.take(leak, last, axis).swapaxes(0, axis)]
        if any((surface != surface[:1]).any() for surface in surfaces):
            raise InputError(
                f"a condition ends or varies within one reach of the absorbing side {name}, where it would continue",
                key="constraints",
                limit=f"the same on the last {reach + 1} nodes",
                remedy="a larger near field, or restrict the condition by `within`",
            )
        if np.take(steady, last, 1 + axis).any():
            notes.append(f"what is held at the side {name} is assumed to continue straight beyond it without end")


def _last(count: int, side: int, width: int) -> np.ndarray:
    """Indices of the last `width` nodes along an axis of `count` nodes, from a side inwards; none if that is not
    positive.
    """
    inwards = np.arange(min(width, count))
    return inwards if side < 0 else count - 1 - inwards


def hold_and_damp(near: NearField, layered: LayeredSides, cuts: CutBonds, fixed_rim: bool) -> np.ndarray:
    """Give the engine the nodes that never move, and the damping of sponges and of surfaces that lose heat, in the core
    and in the layers next to it; nodes outside a body are held, too, if `fixed_rim`. Return the places in a level
    that never move, of all components.
    """
    grid, engine = cuts.grid, cuts.grid.engine
    held = engine.absent.outside
    if fixed_rim:
        exists = cuts.existing(True)
        nodes = grid.layout.box.node_indices()
        held = nodes[~exists[nodes]]
    steady, leaking, leak = _continued(near, grid)
    held = np.concatenate([held, grid.walls])
    places: np.ndarray = np.union1d(engine.all_components(held), steady)
    tables = [(places, *np.zeros((3, len(places))))]
    if near.supports is not None or any(side.damped for side in layered.sides.values()):
        tables.append(_damped(near, layered, grid, held))
    tables.append((leaking, *np.ones((2, leaking.size)), leak))
    nodes, before, after, losses = (np.concatenate(columns) for columns in zip(*tables, strict=True))
    # a node of a sponge may also lose heat at a surface, but the engine takes each node only once
    distinct, at = np.unique(nodes, return_inverse=True)
    rows = [np.ones(distinct.size), np.ones(distinct.size), np.zeros(distinct.size)]
    for row, combine, values in zip(rows, (np.multiply, np.multiply, np.add), (before, after, losses), strict=True):
        combine.at(row, at, values)
    set_damping(engine, distinct, *rows)
    return places


def _continued(near: NearField, grid: Grid) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the places beyond the near field where values remain held at the background, for all components, and the
    nodes that lose heat, with their rates, including those beyond it.
    """
    engine = grid.engine
    beyond = np.ones(grid.layout.size, bool)
    beyond[grid.nodes] = False
    places = grid.layout.box.node_indices()
    outside = places[beyond[places]]
    steady = [
        outside[engine.spread(grid.grown(held.astype(float)))[outside] > 0] + number * grid.layout.size
        for number, held in enumerate(_held(near)[1])
    ]
    leak = engine.spread(grid.grown(_leak(near)))
    leaking = places[leak[places] > 0]
    return np.concatenate(steady), leaking, leak[leaking]


def _damped(
    near: NearField, layered: LayeredSides, grid: Grid, held: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the nodes of the sponges that are not held, their factors on the old and the new increment, and their loss
    rates.
    """
    layout, lead, model = grid.layout, grid.lead, near.model
    rate = np.zeros(layout.box.nodes)
    for (axis, side), boundary in layered.sides.items():
        if boundary.damped:
            values = boundary.damping(model.order, layered.coefficients[axis, side], near.lattice.spacing)
            line = np.zeros(layout.box.nodes[lead + axis])
            line[: len(values)] = values[::-1]
            rate = rate + line[::-side].reshape([-1 if a == lead + axis else 1 for a in range(3)])
    if near.supports is not None:
        return _supported(near, near.supports, grid, rate, held)
    rate[np.isin(layout.box.node_indices(), held)] = 0
    where = np.nonzero(rate)
    index = grid.engine.all_components(layout.box.node_indices()[where])
    rate = np.tile(rate[where], grid.engine.components)
    if model.order == 1:
        return index, np.ones_like(rate), np.ones_like(rate), rate
    drag, total = model.damping * near.dt, (model.damping + rate) * near.dt  # the model's damping, and all of it
    return index, (1 - total) / (1 - drag), (1 + drag) / (1 + total), np.zeros_like(rate)


def _supported(
    near: NearField, supports: Supports, grid: Grid, sponges: np.ndarray, held: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the same with the nodes at springs and dashpots, which continue beside absorbing sides; `sponges` is the
    damping of the box.
    """
    engine, dt, damping = grid.engine, near.dt, near.model.damping
    nodes = grid.layout.box.node_indices()
    free = nodes[~np.isin(nodes, held)]
    in_sponges = np.zeros(grid.layout.size)
    in_sponges[nodes] = sponges
    columns = []
    for number, (stiffness, rate) in enumerate(zip(*supports, strict=True)):
        springs, dashpots = (engine.spread(grid.grown(values))[free] for values in (stiffness, rate))
        dashpots = dashpots + in_sponges[free]
        at = (springs > 0) | (dashpots > 0)
        drag, total = damping * dt, (damping + dashpots[at]) * dt
        after = (1 + drag) / (1 + total)
        # the spring is part of what the damping acts on, which the leak is not
        columns.append((free[at] + number * grid.layout.size, (1 - total) / (1 - drag), after, after * springs[at]))
    places, before, after, leak = (np.concatenate(parts) for parts in zip(*columns, strict=True))
    return places, before, after, leak

"""Surfaces and nodes apart: held at the background, losing heat, damped or resting, and going on beyond the near
field.
"""

from __future__ import annotations

import numpy as np

from farhorizon.engine.settings import set_damping
from farhorizon.errors import InputError
from farhorizon.simulation.cuts import CutBonds
from farhorizon.simulation.grid import Grid
from farhorizon.simulation.near_field import NearField
from farhorizon.simulation.setup import Key, Sides, side_name
from farhorizon.simulation.surroundings import Surroundings


def _surfaces(near: NearField) -> tuple[np.ndarray, np.ndarray]:
    """Nodes that conditions hold at the background, and the rates at which nodes lose heat; of the lattice's shape."""
    held, leak = np.zeros(near.lattice.shape, bool), near.leak
    held.ravel()[near.conditions.nodes[near.conditions.resting]] = True
    return held, leak if leak.size else np.zeros(near.lattice.shape)


def check_conditions(near: NearField, sides: Sides, margins: dict[Key, int]) -> None:
    """What lies beyond an absorbing side goes on as at the edge and comes to rest: surfaces that lose heat, or are held
    at the background.

    Raises
    ------
    InputError
    """
    held, leak = _surfaces(near)
    if not near.conditions.nodes.size and not leak.any():
        return
    shape = near.lattice.shape
    busy = (leak > 0) & near.conditions.fed(shape)
    busy.ravel()[near.conditions.nodes] = True
    busy &= ~held
    for (axis, side), boundary in sides.items():
        m = near.stencil.reach[axis] - margins[axis, side] + 1
        if boundary.endless and not (boundary.exact or boundary.closing) and m > 0:
            last = np.arange(m) if side < 0 else shape[axis] - 1 - np.arange(m)
            name = side_name(axis, side)
            if np.take(busy, last, axis).any():
                raise InputError(
                    f"a condition holds on nodes within one reach of the absorbing side {name}, where the medium "
                    "must come to rest",
                    key="constraints",
                    limit=f"convection to the background, or nodes held at it, on the last {m} nodes",
                    remedy="background = the temperature of the surroundings, a Free side there, or restrict the "
                    "condition by `within`",
                )
            if any(np.ptp(np.take(surface, last, axis), axis=axis).any() for surface in (held.astype(float), leak)):
                raise InputError(
                    f"a condition ends or varies within one reach of the absorbing side {name}, into which it "
                    "would go on",
                    key="constraints",
                    limit=f"the same on the last {m} nodes",
                    remedy="a larger near field, or restrict the condition by `within`",
                )


def rest_and_damp(near: NearField, around: Surroundings, cuts: CutBonds, fixed_rim: bool) -> np.ndarray:
    """Give the engine the nodes that never move, and the damping of sponges and of surfaces that lose heat, in the core
    and in layers along it.

    Parameters
    ----------
    near : NearField
    around : Surroundings
    cuts : CutBonds
    fixed_rim : bool
        Whether nodes outside a body are held.

    Returns
    -------
    ndarray of int
        Places in a level that never move, of all components.
    """
    grid, engine = cuts.grid, cuts.grid.engine
    held = engine.absent.outside
    if fixed_rim:
        exists = cuts.existing(True)
        nodes = engine.layout.box.node_indices()
        held = nodes[~exists[nodes]]
    resting, leaking, leak = _continued(near, grid)
    held = np.concatenate([held, resting, grid.walls])
    places: np.ndarray = engine.all_components(held)
    tables = [(places, *np.zeros((3, len(places))))]
    if any(b.damped for b in around.sides.values()):
        tables.append(_damped(near, around, grid, held))
    tables.append((leaking, *np.ones((2, leaking.size)), leak))
    nodes, before, after, losses = (np.concatenate(columns) for columns in zip(*tables, strict=True))
    # a node belongs to one thread: a sponge's may lose heat at a surface, too
    once, at = np.unique(nodes, return_inverse=True)
    rows = [np.ones(once.size), np.ones(once.size), np.zeros(once.size)]
    for row, put, values in zip(rows, (np.multiply, np.multiply, np.add), (before, after, losses), strict=True):
        put.at(row, at, values)
    set_damping(engine, once, *rows)
    return places


def _continued(near: NearField, grid: Grid) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes beyond the near field that go on being held at the background, and nodes that lose heat, with their rates,
    beyond it too.
    """
    engine = grid.engine
    beyond = np.ones(engine.layout.size, bool)
    beyond[grid.nodes] = False
    held, leak = (engine.spread(grid.grown(f.astype(float))) for f in _surfaces(near))
    places = engine.layout.box.node_indices()
    resting, leaking = places[(held[places] > 0) & beyond[places]], places[leak[places] > 0]
    return resting, leaking, leak[leaking]


def _damped(
    near: NearField, around: Surroundings, grid: Grid, held: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Nodes of the sponges but those held, their factors on the old and the new increment, their loss rate."""
    layout, lead, model = grid.engine.layout, grid.lead, near.model
    rate = np.zeros(layout.box.nodes)
    for (axis, side), boundary in around.sides.items():
        if boundary.damped:
            values = boundary.damping(model.order, around.coefficients[axis, side], near.lattice.spacing)
            line = np.zeros(layout.box.nodes[lead + axis])
            line[: len(values)] = values[::-1]
            rate = rate + line[::-side].reshape([-1 if a == lead + axis else 1 for a in range(3)])
    rate[np.isin(layout.box.node_indices(), held)] = 0
    where = np.nonzero(rate)
    index = grid.engine.all_components(layout.box.node_indices()[where])
    rate = np.tile(rate[where], grid.engine.components)
    if model.order == 1:
        return index, np.ones_like(rate), np.ones_like(rate), rate
    share, total = model.damping * near.dt, (model.damping + rate) * near.dt
    return index, (1 - total) / (1 - share), (1 + share) / (1 + total), np.zeros_like(rate)

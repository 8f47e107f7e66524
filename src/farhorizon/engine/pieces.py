"""State of an engine by the nodes of its box: values of levels, and the memory of the layers beside each line.

It does not depend on the layout in memory, so that the state of one box can be assembled from those of others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from farhorizon.engine.engine import Engine

Box = Sequence[tuple[int, int]]  # first node and last + 1 along the three axes


class Piece(NamedTuple):
    """Some values of a state.

    Attributes
    ----------
    held : ndarray
        Level or memory that contains them.
    places : ndarray of int
        Index of each value in it; the last axes are some of those of the box.
    axes : tuple of int
        Axes of the box that these are.
    """

    held: np.ndarray
    places: np.ndarray
    axes: tuple[int, ...]


def pieces_of(engine: Engine, more: Mapping[str, np.ndarray] | None = None) -> dict[str, Piece]:
    """Return all pieces of a state by name: of each level, of further ones that have their form, and of each pass and
    layer.
    """
    every = np.stack([engine.layout.box.node_indices() + c * engine.layout.size for c in range(engine.components)])
    levels = {f"level/{k}": level for k, level in enumerate(engine.levels)} | dict(more or {})
    found = {name: Piece(level, every, (0, 1, 2)) for name, level in levels.items()}
    for name, places, axes in engine.remembered():
        found[name] = Piece(engine.memory, places, axes)
    for word, bits in enumerate(engine.bonds.table.alive):
        found[f"bonds/{word}"] = Piece(bits, every[0], (0, 1, 2))
    for bond, residual_stiffness in enumerate(engine.bonds.table.residual_stiffness):
        found[f"shares/{bond}"] = Piece(residual_stiffness, every[0], (0, 1, 2))
    if engine.tables.phases.dissolved.size:
        found["dissolved"] = Piece(engine.tables.phases.dissolved, every[0], (0, 1, 2))
    return found


def values_of(engine: Engine, more: Mapping[str, np.ndarray] | None = None) -> dict[str, np.ndarray]:
    """Return copies of the values of all pieces by name; `more` as in `pieces_of`."""
    return {name: piece.held[piece.places] for name, piece in pieces_of(engine, more).items()}


def sums_of(engine: Engine) -> dict[str, float]:
    """Return accumulated quantities by name: energy and number of broken bonds, work of the sources, losses by drag,
    and the flow into each account; in units of the update.
    """
    return {
        f"{name}/{i}": float(one.sum()) for name, sums in parts_of_sums(engine).items() for i, one in enumerate(sums)
    }


def take_sums(engine: Engine, given: Mapping[str, float]) -> None:
    """Continue to accumulate from the result of `sums_of`."""
    for name, sums in parts_of_sums(engine).items():
        for i, one in enumerate(sums):
            one[...] = 0
            one.flat[0] = given[f"{name}/{i}"]


def parts_of_sums(engine: Engine) -> dict[str, np.ndarray]:
    """Return the arrays, by places or threads, whose sums `sums_of` returns, by name; the first axis is that of the
    sums. They share memory.
    """
    tables = engine.tables
    every = {
        "broken": np.moveaxis(tables.bonds.broken, -1, 0),
        "work": tables.work[None],
        "drag": tables.drag.lost[None],
        "flows": tables.flows.totals.T,
    }
    return {name: sums for name, sums in every.items() if sums.size}


def common(one: Box, other: Box, axes: Sequence[int]) -> tuple[tuple[slice, ...], tuple[slice, ...]] | None:
    """Return the intersection of two boxes along some axes, counted in each of them; None if it is empty."""
    pairs = [(max(one[a][0], other[a][0]), min(one[a][1], other[a][1]), a) for a in axes]
    if any(first >= last for first, last, _ in pairs):
        return None
    here, there = (tuple(slice(f - box[a][0], e - box[a][0]) for f, e, a in pairs) for box in (one, other))
    return here, there


class Assembly:
    """Assembles the state of an engine from those of boxes that cover its own.

    Parameters
    ----------
    engine : Engine
    box : Box
        Position of its own box.
    more : mapping of str to ndarray, optional
        As in `pieces_of`.
    """

    def __init__(self, engine: Engine, box: Box, more: Mapping[str, np.ndarray] | None = None) -> None:
        self._engine, self._pieces, self._box = engine, pieces_of(engine, more), box
        self._values = {name: piece.held[piece.places] for name, piece in self._pieces.items()}
        self._lacks = {
            name: np.ones(piece.places.shape[-len(piece.axes) :], bool) for name, piece in self._pieces.items()
        }

    def add(self, box: Box, arrays: Mapping[str, np.ndarray]) -> bool:
        """Take over what a box has in common with this one; return whether its layers have the same form."""
        for name, piece in self._pieces.items():
            shared = common(self._box, box, piece.axes)
            if name not in arrays or shared is None:
                continue
            (here, there), values = shared, arrays[name]
            front = values.ndim - len(piece.axes)
            if values.shape[:front] != piece.places.shape[: -len(piece.axes)]:
                return False
            to: tuple[Any, ...] = (..., *here)
            of: tuple[Any, ...] = (..., *there)
            self._values[name][to] = values[of]
            self._lacks[name][here] = False
        return True

    def put(self) -> bool:
        """Write the state to the engine if it is complete; return whether it is."""
        if any(one.any() for one in self._lacks.values()):
            return False
        bonds = self._engine.bonds
        alive = bonds.table.alive.copy()
        # what belongs to no node may be left from a field that was not finite; it is multiplied by zero at most
        self._engine.memory[...] = self._engine.tables.work_space[...] = 0
        for name, piece in self._pieces.items():
            piece.held[piece.places] = self._values[name]
        if bonds:
            bonds.break_since(alive)
        return True

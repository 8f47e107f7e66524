"""The state of an engine by the nodes of its box: values of levels, and what layers remember beside each line.

Nothing of it depends on how memory is laid out, so that the state of a box is put together from those of other boxes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from farhorizon.engine.engine import Engine

Box = Sequence[tuple[int, int]]  # along the three axes the first node and the last + 1


class Piece(NamedTuple):
    """Some values of a state.

    Attributes
    ----------
    held : ndarray
        The level or the memory that they stand in.
    places : ndarray of int
        Of each in it; the last axes are some of the box's.
    axes : tuple of int
        Which.
    """

    held: np.ndarray
    places: np.ndarray
    axes: tuple[int, ...]


def pieces_of(engine: Engine) -> dict[str, Piece]:
    """All of a state by name: that of a level, or of a pass and a layer."""
    every = np.stack([engine.layout.box.node_indices() + c * engine.layout.size for c in range(engine.components)])
    found = {f"level/{k}": Piece(level, every, (0, 1, 2)) for k, level in enumerate(engine.levels)}
    for name, places, axes in engine.remembered():
        found[name] = Piece(engine.memory, places, axes)
    for word, bits in enumerate(engine.bonds.table.alive):
        found[f"bonds/{word}"] = Piece(bits, every[0], (0, 1, 2))
    for bond, shares in enumerate(engine.bonds.table.shares):
        found[f"shares/{bond}"] = Piece(shares, every[0], (0, 1, 2))
    if engine.tables.phases.dissolved.size:
        found["dissolved"] = Piece(engine.tables.phases.dissolved, every[0], (0, 1, 2))
    return found


def values_of(engine: Engine) -> dict[str, np.ndarray]:
    """Copies of the values of all pieces by name."""
    return {name: piece.held[piece.places] for name, piece in pieces_of(engine).items()}


def sums_of(engine: Engine) -> dict[str, float]:
    """What has been added up on the way by name: energy and number of the bonds that broke, the work of sources, what
    drag has taken, what has flowed into each account; in units of the update.
    """
    return {
        f"{name}/{i}": float(one.sum()) for name, sums in parts_of_sums(engine).items() for i, one in enumerate(sums)
    }


def take_sums(engine: Engine, given: Mapping[str, float]) -> None:
    """Go on adding up from what `sums_of` has told."""
    for name, sums in parts_of_sums(engine).items():
        for i, one in enumerate(sums):
            one[...] = 0
            one.flat[0] = given[f"{name}/{i}"]


def parts_of_sums(engine: Engine) -> dict[str, np.ndarray]:
    """What is added up to `sums_of`, by places or threads, by name: the first axis is that of the sums; they share
    memory.
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
    """What two boxes have in common along some axes, counted in each of them; None for nothing."""
    pairs = [(max(one[a][0], other[a][0]), min(one[a][1], other[a][1]), a) for a in axes]
    if any(first >= last for first, last, _ in pairs):
        return None
    here, there = (tuple(slice(f - box[a][0], e - box[a][0]) for f, e, a in pairs) for box in (one, other))
    return here, there


class Assembly:
    """Puts the state of an engine together from those of boxes that cover its own.

    Parameters
    ----------
    engine : Engine
    box : Box
        Where its own lies.
    """

    def __init__(self, engine: Engine, box: Box) -> None:
        self._engine, self._pieces, self._box = engine, pieces_of(engine), box
        self._values = {name: piece.held[piece.places] for name, piece in self._pieces.items()}
        self._lacks = {
            name: np.ones(piece.places.shape[-len(piece.axes) :], bool) for name, piece in self._pieces.items()
        }

    def add(self, box: Box, arrays: Mapping[str, np.ndarray]) -> bool:
        """Take what a box has of it; returns whether its layers are like these."""
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
        """Give it to the engine, if nothing lacks; returns whether."""
        if any(one.any() for one in self._lacks.values()):
            return False
        bonds = self._engine.bonds
        alive = bonds.table.alive.copy()
        for name, piece in self._pieces.items():
            piece.held[piece.places] = self._values[name]
        if bonds:
            bonds.break_since(alive)
        return True

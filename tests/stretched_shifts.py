"""Stretched shifts of a field in the layers by their definition: one after the other, each with a memory of its own."""

from __future__ import annotations

import numpy as np

from farhorizon.engine.engine import Engine


class StretchedShifts:
    """Shifts of levels over the box of an engine.

    Parameters
    ----------
    engine : Engine
    memory : dict
        What each shift remembers from step to step, by name.
    """

    def __init__(self, engine: Engine, memory: dict[object, np.ndarray]) -> None:
        self.engine, self.memory, self.box = engine, memory, engine.layout.box
        self.stage = 0  # each stage of a step has a memory of its own
        self.edges = [self._edges(axis) for axis in range(3)]
        self.begin(0, np.zeros((0, engine.layout.size)))  # a step begins with a level

    def begin(self, number: int, level: np.ndarray) -> None:
        """Set the level to shift from now on, by component; the number distinguishes the memories of the levels of a
        step.
        """
        self.number = number
        self.fields: dict[tuple[int, ...], np.ndarray] = {}
        if len(level):
            self.fields[0, 0, 0] = np.stack([self.box.all(u).astype(float) for u in level])

    def _edges(self, axis: int) -> tuple[np.ndarray, ...]:
        """Return the recursion on the edges of an axis with its halo; edge i lies between the nodes i - 1 and i."""
        engine, m = self.engine, self.box.reach[axis]
        tables = np.zeros((3, self.box.nodes[axis] + 2 * m + 1))
        for (a, side), layer in engine.layers.items():
            if a == axis:
                inner = tables[:, m : tables.shape[1] - m]
                at = slice(None, layer.columns + 1) if side < 0 else slice(-layer.columns - 1, None)
                inner[:, at] = np.array(layer.recursion(engine.dt))[:, ::side]
        if not engine.remember:
            tables[1:] = 0
        return tables[0], tables[1], tables[2]

    def _shift(self, u: np.ndarray, axis: int, sign: int, key: object) -> np.ndarray:
        """Return a field on the box and its halo, one node further along an axis: ``v(p) = u(p + 1) + r (u(p) - v(p +
        1)) - N``.
        """
        r, e, f = (t if sign > 0 else t[::-1] for t in self.edges[axis])
        u = np.moveaxis(u, axis, 0)[::sign]
        past = self.memory.setdefault((self.stage, key), np.zeros((len(u) + 1, *u.shape[1:])))
        v, ahead, beyond = np.zeros_like(u), np.zeros_like(u[0]), np.zeros_like(u[0])
        for p in range(len(u) - 1, -1, -1):
            d = u[p] - ahead
            v[p] = beyond + r[p + 1] * d - past[p]
            past[p] = e[p + 1] * past[p] + f[p + 1] * d
            ahead, beyond = v[p], u[p]
        return np.moveaxis(v[::sign], 0, axis)

    def along(self, offset: tuple[int, ...], axis: int) -> np.ndarray:
        """Return the field shifted along this axis and later ones by stretched shifts, shape (components, *box and
        halo).
        """
        stretched = tuple(o if a >= axis else 0 for a, o in enumerate(offset))
        if self.fields.get(stretched) is None:
            first = next(a for a in range(3) if stretched[a])
            sign = int(np.sign(stretched[first]))
            nearer = tuple(o - sign * (a == first) for a, o in enumerate(stretched))
            before = self.along(nearer, axis)
            made = [self._shift(u, first, sign, (self.number, stretched, c)) for c, u in enumerate(before)]
            self.fields[stretched] = np.stack(made)
        return self.fields[stretched]

    def serve(self, axis: int) -> bool:
        """Return whether there are layers along an axis."""
        return any(a == axis for a, _ in self.engine.layers)

    def at_nodes(self, field: np.ndarray, offset: list[int], axis: int) -> np.ndarray:
        """Return the nodes' values of a field, with plain shifts along the axes before this one."""
        parts = [
            slice(m + (o if a < axis else 0), m + (o if a < axis else 0) + n)
            for a, (o, m, n) in enumerate(zip(offset, self.box.reach, self.box.nodes, strict=True))
        ]
        return field[(slice(None), *parts)]

"""Broken bonds of a solid, along which its heat does not flow: Bobaru and Duangpanya (2010), eqs 13 to 15.

A bond of the heat conducts as long as the same bond of the solid has not broken. Bonds of the heat that the solid does
not have, because its horizon is smaller, are the chains of its bonds that follow them most closely, and conduct as long
as all links do: no heat flows between pieces that no bond of the solid connects.
"""

from __future__ import annotations

import numpy as np

from farhorizon.engine.bonds import set_bits
from farhorizon.errors import InputError
from farhorizon.simulation.assembly import RunParts
from farhorizon.simulation.processes.process_group import ALONE, ProcessGroup
from farhorizon.simulation.setup.cuts import Bonds
from farhorizon.simulation.setup.setup import Sides
from farhorizon.simulation.time.breaking import BreakableBonds

GAPING, TOUCHING, INTACT = range(3)  # states of a bond


class BrokenBonds:
    """Broken bonds of a solid on the nodes of this process, as tables with one row per bond and direction: a key, and
    whether its ends are apart or touch.

    Its cracks that are open at the start have been cut. Unless `touching`, which processes find out together, all ends
    are taken as apart.
    """

    def __init__(self, breaking: BreakableBonds, touching: bool, group: ProcessGroup = ALONE) -> None:
        self.breaking, self.grid, self._touching = breaking, breaking.grid, touching
        engine, grid = self.grid.engine, self.grid
        engine.bonds.expect_cuts()
        shape = (1,) * grid.lead + grid.lattice.whole.shape
        self._pad = int(group.largest(max(grid.margins.values())))  # nodes beyond the near field may be counted, too
        self._sizes = *(n + 2 * self._pad for n in shape), len(engine.offsets)
        self.forget()

    @property
    def offsets(self) -> np.ndarray:
        """Offsets of the bonds of the solid, shape (K, 3)."""
        return self.grid.engine.offsets

    def forget(self) -> None:
        """Look again at the next call of `table`, whatever has changed."""
        self._seen: tuple[float, int] | None = None
        self._table = np.zeros((0, 2), np.int64)

    def table(self) -> np.ndarray:
        """Return the present table, sorted; the same array as long as nothing has changed."""
        engine, core = self.grid.engine, self.grid.core
        if self._touching:
            engine.complete("u")
        seen = engine.bonds.broken[1], engine.absent.count
        if seen != self._seen or self._touching:
            nodes, bonds = set_bits(engine.bonds.broken_bits.reshape(-1, core.node_indices().size))
            at = np.stack(np.unravel_index(nodes, core.nodes), axis=-1)
            states = self._apart(core.node_indices().ravel()[nodes], bonds)
            rows = np.column_stack([self.keys(at + self.grid.first, bonds), states])
            rows = rows[np.argsort(rows[:, 0])]
            if not np.array_equal(rows, self._table):
                self._table = rows
            self._seen = seen
        return self._table

    def _apart(self, places: np.ndarray, bonds: np.ndarray) -> np.ndarray:
        """Return `TOUCHING` for bonds that are not longer than free of stress, which close if the solid has contact,
        and `GAPING` for others.
        """
        if not self._touching:
            return np.full(len(bonds), GAPING)
        engine, count = self.grid.engine, self.grid.engine.components
        thermal_strain, level = engine.get("bonds.thermal_strain"), engine.get("u").reshape(count, -1)
        xi = engine.get("bonds.table", (bonds, slice(count))).astype(float)
        neighbours = places + engine.get("bonds.places", (bonds, 0))
        eta = (level[:, neighbours] - level[:, places]).T.astype(float)
        thermal_strain = (thermal_strain[places] + thermal_strain[neighbours]) / 2
        return np.where((xi * eta).sum(1) / (xi**2).sum(1) <= thermal_strain, TOUCHING, GAPING)

    def keys(self, at: np.ndarray, bonds: np.ndarray) -> np.ndarray:
        """Return the keys of bonds from nodes, shape (n, 3), whose numbers begin at the first node of the lattice."""
        return np.ravel_multi_index((*(at + self._pad).T, bonds), self._sizes).astype(np.int64)

    def bonds_of(self, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the nodes and bonds of which `keys` returned the keys."""
        *at, bonds = np.unravel_index(keys, self._sizes)
        return np.stack(at, axis=-1) - self._pad, np.asarray(bonds)

    def own(self, table: np.ndarray) -> np.ndarray:
        """Return the rows of the nodes of this process."""
        at = self.bonds_of(table[:, 0])[0] - self.grid.first
        return table[((at >= 0) & (at < self.grid.core.nodes)).all(1)]


def table_changes(before: np.ndarray, now: np.ndarray) -> np.ndarray:
    """Return the rows in which a table differs from an earlier one, and a row with `INTACT` for each that is gone."""
    gone = np.setdiff1d(before[:, 0], now[:, 0])
    old = np.full(len(now), INTACT)
    _, rows, rows_before = np.intersect1d(now[:, 0], before[:, 0], return_indices=True)
    old[rows] = before[rows_before, 1]
    return np.concatenate([now[now[:, 1] != old], np.column_stack([gone, np.full(len(gone), INTACT)])])


def after_changes(table: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return a table after changes."""
    changed = np.concatenate([rows, table])  # of two rows with the same key the first one counts
    changed = changed[np.unique(changed[:, 0], return_index=True)[1]]
    return changed[changed[:, 1] != INTACT]


class InsulatedBonds:
    """Bonds of a heat conduction that broken bonds of its solid interrupt.

    The heat has bonds with these offsets, shape (K, 3), sides and `shape` nodes along the axes, the first of which has
    the number `first` in the lattice of the solid. Bonds whose ends touch keep the fraction `remaining`. Raises
    InputError if a bond of the heat is no chain of bonds of the solid.
    """

    def __init__(
        self,
        solid: BrokenBonds,
        offsets: np.ndarray,
        sides: Sides,
        shape: tuple[int, ...],
        first: np.ndarray,
        remaining: float = 0.0,
    ) -> None:
        lead = 3 - len(shape)
        self.solid, self._offsets = solid, offsets
        self._bonds, self._from = chains(offsets, solid.offsets)
        self._lost = np.array([1.0, 1.0 - remaining])
        self._first = np.array([0] * lead + [int(n) for n in first])
        self._period = np.array([0] * lead + [n if sides[a, -1].periodic else 0 for a, n in enumerate(shape)])

    def of(self, table: np.ndarray, heat: RunParts) -> Bonds:
        """Return the interrupted bonds on the nodes of a heat conduction: nodes, neighbours, and lost weights."""
        at, broken = self.solid.bonds_of(table[:, 0])
        row, link = np.nonzero(self._bonds[broken] >= 0)
        bonds, nodes = self._bonds[broken[row], link], at[row] + self._from[broken[row], link] - self._first
        nodes = np.where(self._period > 0, nodes % np.maximum(self._period, 1), nodes)
        engine, grid = heat.grid.engine, heat.grid
        nodes = nodes - grid.first
        neighbours, last = nodes + self._offsets[bonds], np.array(grid.core.nodes)
        kept = ((nodes >= 0) & (nodes < last)).all(1)
        for (axis, side), boundary in heat.layered.sides.items():
            if not (boundary.periodic or boundary.shared):  # the medium beyond continues as it is
                along = neighbours[:, grid.lead + axis]
                kept &= along >= 0 if side < 0 else along < last[grid.lead + axis]
        places = grid.core.origin + nodes[kept] @ np.array(grid.core.stride)
        weights = engine.weights[bonds[kept]] * self._lost[table[row[kept], 1]]
        return places, places + grid.layout.distances[bonds[kept]], weights


def chains(offsets: np.ndarray, links: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return, for each link, the numbers of the offsets whose chains contain it, shape (L, n), -1 for none, and where
    these begin relative to the node where the link begins, shape (L, n, 3).

    Offsets, shape (K, 3), and links, shape (L, 3), both have the opposite of each row. The chain of an offset has as
    few links as possible, between the nodes nearest to the points that divide it evenly. Raises InputError if there is
    none.
    """
    number = {tuple(link): k for k, link in enumerate(links.tolist())}
    of_links: list[list[tuple[int, np.ndarray]]] = [[] for _ in links]
    for k, offset in enumerate(offsets):
        ahead = offset * (1 if tuple(offset) > (0, 0, 0) else -1)  # opposite bonds have the same chain
        for count in range(1, int(np.abs(offset).max()) + 1):
            points = np.floor(np.arange(count + 1)[:, None] * ahead / count + 0.5).astype(int)
            steps = [number.get(tuple(step)) for step in np.diff(points, axis=0).tolist()]
            if None not in steps:
                break
        else:
            raise InputError(
                "the heat has bonds that are no chain of bonds of the solid: which of them conduct when bonds break is "
                "not known",
                value=f"a bond to the node {offset[np.flatnonzero(np.abs(links).max(0))].tolist()}",
                limit=f"{len(links)} bonds of the solid",
                key="load.temperature",
                remedy="a horizon of the heat that is not larger than that of the solid",
            )
        start = points[:-1] if (ahead == offset).all() else points[:-1] - ahead
        for step, node in zip(steps, start, strict=True):
            assert step is not None
            of_links[step].append((k, -node))
    numbers = np.full((len(links), max(map(len, of_links))), -1)
    starts = np.zeros((*numbers.shape, 3), int)
    for k, of_link in enumerate(of_links):
        for i, (bond, start) in enumerate(of_link):
            numbers[k, i], starts[k, i] = bond, start
    return numbers, starts

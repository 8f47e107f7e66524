"""Absent bonds and places without a node: their tables, and the corrections that they require.

See `farhorizon.engine.surface` for nodes at the surface of a body.
"""

from __future__ import annotations

import weakref

import numpy as np

from farhorizon.engine.bond_zone import BondZone
from farhorizon.engine.bonds import PHASES, factors_of
from farhorizon.engine.exchange import FILTER
from farhorizon.engine.field import Field
from farhorizon.engine.filter import cut_filter, cut_links, without
from farhorizon.engine.layer_passes import cut_layers
from farhorizon.engine.surface import bare_bonds, surface_of
from farhorizon.engine.tables import Cuts, Material


class AbsentBonds:
    """Bonds and nodes that the medium of an engine lacks."""

    count: int  #: Number of absent bonds, counted from each end that is a node.
    exists: np.ndarray  #: Where nodes exist, bool, shape (places,).
    #: Places in a level, of the first component, where no node exists but from which bonds lead to existing nodes: they
    #: must be held at zero.
    outside: np.ndarray

    def __init__(self, engine: Field, bonds: BondZone) -> None:
        self.engine: Field = weakref.proxy(engine)  # the engine refers to this: a cycle would keep its levels alive
        self.bonds = bonds
        self._opened: tuple[np.ndarray, Material, np.ndarray, np.ndarray] | None = None
        none = np.zeros(0, np.int64)
        self.set(none, none, np.zeros((0, *engine.weights.shape[1:])))

    def set(
        self, nodes: np.ndarray, neighbours: np.ndarray, weights: np.ndarray, exists: np.ndarray | None = None
    ) -> None:
        """Set the bonds that are absent, by the places of their ends (of the first component), one entry per direction,
        and their `weights` without coefficients, shape (bonds,) or (bonds, d, d), which are subtracted; and the places
        where nodes exist, shape (places,), by default all.

        No bond leads from or to a place without a node, where all levels must hold zero: beyond the core and the layers
        they do, and the nodes `outside` must be kept at zero.
        """
        engine = self.engine
        self.exists = np.ones(engine.layout.size, bool) if exists is None else exists
        kept = self.exists[nodes] & self.exists[neighbours]
        nodes, neighbours, weights = nodes[kept], neighbours[kept], weights[kept]
        self.count = len(nodes)
        bare = self._open_surface()
        self._cut_filter(nodes, neighbours, weights)
        self._clear_drag(nodes, neighbours, *bare)
        swept = self.bonds.clear(nodes, neighbours) if self.bonds else np.zeros(len(nodes), bool)
        swept &= self.bonds.forces
        order = np.flatnonzero(~swept)
        order = order[np.lexsort((neighbours[order], nodes[order]))]
        nodes, neighbours, weights = nodes[order].astype(np.int64), neighbours[order].astype(np.int64), weights[order]
        if engine.drag_pass is not None:
            layers = engine.drag_pass.without(nodes, neighbours)
            engine.replace(neighbours=engine.tables.neighbours._replace(layers=layers))
        if engine.passes is not None:
            engine.passes.leave_out(nodes, neighbours, *bare, self.exists)
            if not engine.weights.any():
                nodes, neighbours, weights = nodes[:0], neighbours[:0], weights[:0]
        if engine.heat_passes:
            pushes, traces = (heat_pass.without(nodes, neighbours) for heat_pass in engine.heat_passes)
            tables = engine.tables
            engine.replace(pushes=tables.pushes._replace(layers=pushes), traces=tables.traces._replace(layers=traces))
        engine.replace(
            cuts=Cuts(nodes, neighbours, weights.astype(engine.dtype).ravel()),
            layers=cut_layers(engine.layer_tables, nodes, neighbours, weights),
        )

    def _clear_drag(self, nodes: np.ndarray, neighbours: np.ndarray, bare_nodes: np.ndarray, bare: np.ndarray) -> None:
        """Keep drag from acting along absent bonds; if bonds may break, drag uses their bits."""
        drag = self.engine.tables.drag
        if not drag.rate.size or self.bonds:
            return
        order = np.argsort(drag.distances)
        bonds = order[np.searchsorted(drag.distances[order], neighbours - nodes)]
        bare_ends = ((bare_nodes[row], np.full(row.sum(), k)) for k, row in enumerate(bare))
        for ends, numbers in [(nodes, bonds), *bare_ends]:
            gone = ~(np.uint64(1) << (numbers & 63).astype(np.uint64))
            np.bitwise_and.at(drag.alive, (numbers >> 6, ends), gone)

    def _cut_filter(self, nodes: np.ndarray, neighbours: np.ndarray, weights: np.ndarray) -> None:
        """Keep the filter of short waves from reaching across absent bonds, and bonds that have lost at least half
        their weight.
        """
        engine = self.engine
        filtered = engine.tables.filter
        if not filtered.runs.size:
            return
        distances = engine.offsets @ np.array(engine.layout.box.stride)
        order = np.argsort(distances)
        bonds = order[np.searchsorted(distances[order], neighbours - nodes)]
        taken, full = (np.abs(w).max(axis=tuple(range(1, w.ndim)), initial=0) for w in (weights, engine.weights))
        most = taken >= full[bonds] / 2
        to, source, _ = filtered.copies[:, filtered.copies[2] > 0]
        ends = []
        for link in cut_links(filtered, engine.layout, np.array([nodes[most], neighbours[most]]), self.exists):
            link[to] = np.maximum(link[to], link[source])
            if engine.exchange is not None:
                engine.exchange.fill(link, 1, kind=FILTER)
            ends.append(link.astype(np.int8))
        engine.replace(filter=cut_filter(filtered, ends))

    def _open_surface(self) -> tuple[np.ndarray, np.ndarray]:
        """Set the tables of the nodes with bonds to places without a node (see `engine.surface`), and `outside`; return
        the nodes with bonds of which only one end exists, and which bonds these are.
        """
        engine, exists, box, material = self.engine, self.exists, self.engine.layout.box, self.engine.tables.material
        opened = self._opened  # the last time
        if opened is not None and opened[1] is material and np.array_equal(opened[0], exists) and not self.bonds:
            self.count += int(opened[3].sum())
            return opened[2:]
        at: tuple[np.ndarray, ...] = (np.zeros(0, np.int64),) * 3
        bare = np.zeros((len(engine.offsets), 0), bool)
        if not exists.all():
            engine.levels.reshape(len(engine.levels), engine.components, -1)[..., ~exists] = 0
            # the filter of the layers must not act from or to there
            engine.replace(filter=without(engine.tables.filter, lambda damped: ~exists[damped]))
            at, bare = bare_bonds(box, engine.offsets, exists)
        flat = np.asarray(box.origin + sum(i * s for i, s in zip(at, box.stride, strict=True)))
        self.count += int(bare.sum())
        self.outside = flat[~exists[flat]]
        kept = exists[flat]
        if self.bonds:
            self.bonds.clear_bits(flat, bare)
            kept &= ~(self.bonds.forces & self.bonds.contains(np.stack(at, axis=1)))
        if not engine.weights.any():
            kept[:] = False
        weights = self._weights_of(flat[kept], bare[:, kept]).astype(engine.dtype)
        engine.replace(surface=surface_of(box, flat[kept], weights))
        self._opened = exists, material, flat, bare
        return flat, bare

    def _weights_of(self, nodes: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Sum of the weights of the `chosen` bonds, shape (K, S), of nodes; shape (S,) or (S, d, d).

        Coefficients are included, except for those of phases, which change.
        """
        engine = self.engine
        material = engine.tables.material
        total = np.zeros((len(nodes), *engine.weights.shape[1:]))
        for offset, weight, has_bond in zip(engine.offsets, engine.weights, chosen, strict=True):
            ends = nodes[has_bond]
            neighbours = ends + int(offset @ np.array(engine.layout.box.stride))
            factors = np.ones(len(ends)) if material.rule == PHASES else factors_of(material, ends, neighbours)
            total[has_bond] += np.multiply.outer(factors, weight)
        return total

    def lost(self, nodes: np.ndarray, neighbours: np.ndarray, weights: np.ndarray | float) -> np.ndarray:
        """Absent part of the `weights` of bonds of the core (given by places), without coefficients."""
        cut_nodes, cut_neighbours, cut_weights = self.engine.tables.cuts
        size = self.engine.layout.size
        keys = cut_nodes * size + cut_neighbours
        cut = np.zeros(len(nodes))
        if keys.size:
            order = np.argsort(keys)
            asked = nodes * size + neighbours
            at = np.minimum(np.searchsorted(keys[order], asked), keys.size - 1)
            cut = np.where(keys[order][at] == asked, cut_weights[order][at].astype(float), 0.0)
        return np.where(self.exists[nodes] == self.exists[neighbours], cut, weights)

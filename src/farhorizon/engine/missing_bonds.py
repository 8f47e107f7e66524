"""Missing bonds and places without a node: which bonds of nodes at the surface of a body lead to such places, the
tables of what the nodes lack, row by row, and the corrections that they require.

A place without a node holds zero. The contribution of such a bond to a sweep is its weight times the node's own value
(subtracted), so that one number per node (for vectors one matrix), the sum of those weights, corrects all of them.
"""

from __future__ import annotations

import itertools
import weakref
from collections.abc import Iterator

import numpy as np

from farhorizon.engine.bond_zone import BondZone
from farhorizon.engine.bonds import PHASES, factors_of
from farhorizon.engine.codegen.build import load_rows
from farhorizon.engine.exchange import FILTER
from farhorizon.engine.features.filter import cut_filter, cut_links, without
from farhorizon.engine.field import Field
from farhorizon.engine.layer_operators import cut_layers
from farhorizon.engine.layout import SLACK, Block, with_defaults
from farhorizon.engine.point_law import ALIKE, EACH, LawRows
from farhorizon.engine.tables import Cuts, Material, Surface

#: Remaining fractions of a bond below this are rounding error.
FAINT = 1e-12


class AbsentBonds:
    """Bonds and nodes that the medium of an engine lacks."""

    count: int  #: Number of absent bonds, counted from each end that is a node.
    exists: np.ndarray  #: Where nodes exist, bool, shape (places,).
    #: Places in a level, of the first component, where no node exists but from which bonds lead to existing nodes: they
    #: must be held at zero.
    outside: np.ndarray
    #: Numbers of nodes from which the factors of springs near surfaces follow, shape (M, places), and the weights of
    #: each end of a bond in them, (K, M), see `stiffen`; M = 0 without any.
    excess: np.ndarray
    cosines: np.ndarray
    #: Bonds that have such a factor: places of their nodes and neighbours, and the weights, without coefficients, that
    #: they lose by it, which are negative where they are stiffer.
    stiffened: tuple[np.ndarray, np.ndarray, np.ndarray]

    def __init__(self, engine: Field, bonds: BondZone) -> None:
        self.engine: Field = weakref.proxy(engine)  # the engine refers to this: a cycle would keep its levels alive
        self.bonds = bonds
        self._opened: tuple[np.ndarray, Material, np.ndarray, np.ndarray] | None = None
        none, no_weights = np.zeros(0, np.int64), np.zeros((0, *engine.weights.shape[1:]))
        self.excess, self.cosines = np.zeros((0, 0)), np.zeros((len(engine.offsets), 0))
        self.stiffened = none, none, no_weights
        self.set(none, none, no_weights)

    def stiffen(self, excess: np.ndarray, cosines: np.ndarray) -> None:
        """Multiply springs by the mean of ``1 + cosines @ excess`` of their ends from the next `set` on, by which the
        zone of a law must be set, too; shapes (M, places) and (K, M), without numbers where no nodes are.
        """
        engine = self.engine
        self.excess, self.cosines = excess, cosines
        near = engine.layout.box.node_indices().ravel()
        ends, weights = [], []
        for distance, cosine, weight in zip(engine.layout.distances, cosines, engine.weights, strict=True):
            softer = -cosine @ (excess[:, near] + excess[:, near + distance]) / 2
            unlike = np.flatnonzero(softer)
            ends.append(near[unlike] + np.array([[0], [distance]]))
            weights.append(np.multiply.outer(softer[unlike], weight))
        nodes, neighbours = np.concatenate(ends, axis=1)
        self.stiffened = nodes, neighbours, np.concatenate(weights)

    def factors_at_surfaces(self, nodes: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
        """Factors of the springs between some places by `stiffen`."""
        if not len(self.excess):
            return np.ones(len(nodes))
        bonds = self.engine.layout.bonds_between(nodes, neighbours)
        both = self.excess[:, nodes] + self.excess[:, neighbours]
        return np.asarray(1 + np.einsum("km,mk->k", self.cosines[bonds], both) / 2)

    def _with_stiffened(self, cut: tuple[np.ndarray, np.ndarray, np.ndarray]) -> tuple[np.ndarray, ...]:
        """Add to the bonds that are absent those with a factor, unless they are absent, too, or swept bit by bit."""
        nodes, neighbours, _ = self.stiffened
        if not nodes.size:
            return cut
        size = self.engine.layout.size
        kept = self.exists[nodes] & self.exists[neighbours]
        kept &= ~np.isin(nodes * size + neighbours, cut[0] * size + cut[1])
        if self.bonds.forces:
            kept &= ~self.bonds.contains(self.engine.layout.box.coordinates(nodes))
        nodes, neighbours, weights = (
            np.concatenate([of_cut, of_stiff[kept]]) for of_cut, of_stiff in zip(cut, self.stiffened, strict=True)
        )
        order = np.lexsort((neighbours, nodes))
        return nodes[order], neighbours[order], weights[order]

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
        nodes, neighbours, weights = self._with_stiffened((nodes, neighbours, weights))
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
        cuts, absent = self.engine.tables.cuts, np.zeros(len(nodes))
        cut, at = _found(cuts, self.engine.layout.size, nodes, neighbours)
        absent[cut] = cuts.weights[at[cut]]
        return np.where(self.exists[nodes] == self.exists[neighbours], absent, weights)

    def is_cut(self, nodes: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
        """Return whether the bond from each of some places to another is cut."""
        return _found(self._cuts, self.engine.layout.size, nodes, neighbours)[0]

    @property
    def _cuts(self) -> Cuts:
        """The bonds that are cut; where forces follow from states, a bond and its spring are both present or absent."""
        tables = self.engine.tables
        return tables.cuts if self.engine.passes is None else tables.gradient_pass.cuts

    def left(self, nodes: np.ndarray, neighbours: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Return the remaining factor of a bond of the given weight from each of some places to another; 0 where it is
        absent.
        """
        of_states, cuts = self.engine.passes is not None, self._cuts
        cut, at = _found(cuts, self.engine.layout.size, nodes, neighbours)
        lost = cut.astype(float)
        if cut.any() and not of_states:
            largest = np.unravel_index(np.abs(weight).argmax(), weight.shape)
            taken = cuts.weights.reshape(-1, *weight.shape)[(slice(None), *largest)] / weight[largest]
            lost[cut] = taken[at[cut]]
        factors = factors_of(self.engine.tables.material, nodes, neighbours)
        at_surfaces = self.factors_at_surfaces(nodes, neighbours)
        factors = factors * np.where(cut & (not of_states), 1.0, at_surfaces)  # those of springs are among what is cut
        factor_left = factors * (1 - lost) * (self.exists[nodes] & self.exists[neighbours])
        return np.where(factor_left > FAINT, factor_left, 0.0)


def _found(cuts: Cuts, size: int, nodes: np.ndarray, neighbours: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether the bond from each place to another is cut, and if so its number among those cut; `size` of a level."""
    keys, asked = cuts.nodes * size + cuts.neighbours, nodes * size + neighbours
    if not keys.size:
        return np.zeros(len(nodes), bool), np.zeros(len(nodes), np.int64)
    order = np.argsort(keys)
    at = order[np.minimum(np.searchsorted(keys[order], asked), keys.size - 1)]
    return keys[at] == asked, at


_LONG = 8  # number of neighbours with one matrix; fewer take one vector, in which each may have its own


def bare_bonds(block: Block, offsets: np.ndarray, exists: np.ndarray) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """Find the bonds of a block's nodes of which only one end exists, for offsets (K, 3) and `exists` by place.

    Return the S nodes with such bonds, three indices by axis, and which bonds these are, shape (K, S).
    """
    at = np.nonzero(_reached(block, exists) & _reached(block, ~exists))
    places = block.origin + sum(i * s for i, s in zip(at, block.stride, strict=True))
    bare = np.stack([exists[places] != exists[places + int(offset @ np.array(block.stride))] for offset in offsets])
    lacking = bare.any(0)
    return tuple(i[lacking] for i in at), bare[:, lacking]


def surface_of(block: Block, nodes: np.ndarray, weights: np.ndarray) -> Surface:
    """Return the tables of weights on the nodes' own values, for places of the block and weights of shape (S,), or (S,
    rows, columns).
    """
    if not len(nodes):
        return with_defaults(Surface, weights.dtype)
    rows, columns = weights.shape[1:] or (1, 1)
    entries, real = (tuple(range(columns)),) * rows, weights.dtype.name
    functions = load_rows("map_rows", entries=entries, columns=columns, each=True, added=True, real=real)
    return Surface(*in_rows(block, nodes, weights), *functions)


def in_rows(block: Block, nodes: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return `shared_rows` for some numbers of each of these places."""
    first, second, third = block.coordinates(nodes).T
    order = np.lexsort((third, second, first))
    counts = np.bincount(first * block.nodes[1] + second, minlength=block.nodes[0] * block.nodes[1])
    numbers = weights[order].reshape(len(nodes), int(np.prod(weights.shape[1:])))
    return shared_rows(np.cumsum(np.append(0, counts)), third[order], numbers)


def _reached(block: Block, marked: np.ndarray) -> np.ndarray:
    """Which nodes of a block have a marked place of the box within reach of them."""
    near = block.all(marked)
    for axis, m in enumerate(block.reach):
        near = np.asarray(np.lib.stride_tricks.sliding_window_view(near, 2 * m + 1, axis).any(-1))
    return near


def shared_rows(
    starts: np.ndarray, places: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Arrange weights, shape (N, n), on nodes of rows in segments of neighbours; equal rows share theirs, so that
    these stay in the cache. `starts` are the first entries of the R rows and the end, `places` positions along them.

    Return for each row its first segment and last + 1; for each segment its first node, last + 1, and the index of its
    first entry of the weights; and these: for each segment the first number of all its nodes, then the second, and so
    on, padded by as many entries as a vector may read beyond the last.
    """
    known: dict[bytes, int] = {}
    kept: list[np.ndarray] = []
    rows = np.zeros(len(starts) - 1, np.int64)
    for row, (first, last) in enumerate(itertools.pairwise(starts.tolist())):
        key = places[first:last].tobytes() + weights[first:last].tobytes()
        rows[row] = known.setdefault(key, len(known))
        if rows[row] == len(kept):
            kept.append(np.arange(first, last))
    entries = np.concatenate([np.zeros(0, np.int64), *kept])
    owner = np.repeat(np.arange(len(kept)), [len(k) for k in kept])
    places, end = places[entries], len(entries)
    begins = np.flatnonzero((np.diff(places, prepend=-1) != 1) | (np.diff(owner, prepend=-1) != 0))
    lengths, numbers = np.diff(begins, append=end), weights.shape[1]
    segments = np.stack([places[begins], places[begins] + lengths, numbers * begins], axis=1)
    ranges = np.searchsorted(owner[begins], np.stack([rows, rows + 1], axis=1))
    # positions of the numbers of each entry: after those of earlier segments, one number of a segment after another
    segment_of = np.repeat(np.arange(len(begins)), lengths)
    at = (numbers - 1) * begins[segment_of] + np.arange(end)
    arranged = np.zeros(numbers * end + SLACK, weights.dtype)
    for number in range(numbers):
        arranged[at + number * lengths[segment_of]] = weights[entries, number]
    return ranges, segments, arranged


def law_rows(block: Block, nodes: np.ndarray, numbers: np.ndarray, matrices: np.ndarray) -> LawRows:
    """Return the law's tables for places of a block that lack bonds, given the indices of their matrices."""
    ranges, segments, kinds = in_rows(block, nodes, numbers)
    used, weights = matrices.size, [matrices.ravel()]
    parts, firsts = [], [0]
    for place, stop, start in segments.tolist():
        for first, end in _runs(kinds[start : start + stop - place]):
            entry, count = start + first, end - first
            of_part = kinds[entry : entry + count]
            if count >= _LONG and (of_part == of_part[0]).all():
                place_of = (ALIKE, of_part[0] * matrices[0].size, 1)
            else:
                place_of = (EACH, used, count)
                weights.append(matrices[of_part].reshape(count, -1).T.ravel())
                used += weights[-1].size
            parts.append((place + first, place + end, *place_of, entry))
        firsts.append(len(parts))
    table = np.array(parts, np.int64).reshape(-1, 6)
    return LawRows(np.array(firsts)[ranges], table, kinds, np.pad(np.concatenate(weights), (0, SLACK)))


def _runs(kinds: np.ndarray) -> Iterator[tuple[int, int]]:
    """Yield first and last + 1 of long runs of equal numbers, and of what lies between them."""
    begun = first = 0
    for end in np.append(np.flatnonzero(np.diff(kinds)) + 1, len(kinds)).tolist():
        if end - first >= _LONG:
            if begun < first:
                yield begun, first
            yield first, end
            begun = end
        first = end
    if begun < first:
        yield begun, first

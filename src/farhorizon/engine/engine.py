"""The compiled loops, and the one place that knows Numba: plain arrays in, plain arrays out."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import numpy as np

from farhorizon.engine import bonds as bond_laws
from farhorizon.engine.bonds import END, FIRST, ODD, PHASES, PLAIN, Bonds, Zone, all_bits, no_bonds
from farhorizon.engine.filter import damped_nodes, filter_tables
from farhorizon.engine.fringe import split_sums
from farhorizon.engine.layout import ALIGN, Layout
from farhorizon.engine.nested import LayerTables
from farhorizon.engine.phases import NEVER, count_solid, find_runs
from farhorizon.engine.rows.bond_sweeps import LANES, ROWS
from farhorizon.engine.rows.build import load_bonds, load_driver
from farhorizon.engine.rows.choose import compiled_rows
from farhorizon.engine.rows.vectors import TILE, TILE_ROWS, WINDOW
from farhorizon.engine.surface import bare_bonds, shared_rows

__all__ = ["NEVER", "Engine", "Layer", "Layout", "Zone", "available_threads"]

_NO_ENDS = np.zeros((0, 0), np.int64)
_MODES = 8  # modes of an exact end are filled up to whole vectors
_ALONE = np.zeros(1, np.int64)  # what threads share when there is one
RULES = ("both", "arithmetic", "harmonic", "phases")
_SECOND_CACHE = 600_000  # bytes of the second cache that a part of the box may take
_SET_BITS = np.array([number.bit_count() for number in range(256)], np.uint8)
# of the field, and a quarter of the layers' memory: fewer are through before a second thread is there
_PARALLEL_NUMBERS = 40_000


Poles = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Layer:
    """What a layer is made of, from the near field outwards.

    Attributes
    ----------
    kappa, sigma, alpha : ndarray, shape (columns + 1,)
        Stretch ``kappa + sigma / (s + alpha)`` on the edges p = 0..columns between its columns.
    damping : ndarray, shape (columns,), or empty
        Rate at which its nodes lose the short waves that pass `taps`.
    taps : ndarray
        High-pass filter along one axis, see `engine.filter`.
    whole : bool
        Whether short waves are damped themselves, not their velocity alone.
    """

    kappa: np.ndarray
    sigma: np.ndarray
    alpha: np.ndarray
    damping: np.ndarray = field(default_factory=lambda: np.zeros(0))
    taps: np.ndarray = field(default_factory=lambda: np.zeros(1))
    whole: bool = False

    def __post_init__(self) -> None:
        for name in ("kappa", "sigma", "alpha", "damping", "taps"):  # a checkpoint has short arrays as lists
            object.__setattr__(self, name, np.asarray(getattr(self, name), float))

    @property
    def columns(self) -> int:
        """Nodes of the layer along its normal."""
        return len(self.kappa) - 1

    def recursion(self, dt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Coefficients r, e, f of the trapezoidal rule: ``far = near + r d - N``, ``N <- e N + f d``."""
        a, b = self.sigma * dt / 2, self.alpha * dt / 2
        new, old = (1 + b) * (1 + self.kappa) + a, (1 - b) * (1 + self.kappa) - a
        r = ((1 + b) * (self.kappa - 1) + a) / new
        return r, old / new, ((1 - b) * (self.kappa - 1) - a - old * r) / new


def available_threads() -> int:
    """Threads that the machine and Numba (NUMBA_NUM_THREADS) offer to this process."""
    import numba

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(cores, int(getattr(numba.config, "NUMBA_NUM_THREADS", cores)))


def _zeros(count: int, dtype: np.dtype, rows: int = 0) -> np.ndarray:
    """Zeros that begin on a cache line, shape (rows, count) or (count,)."""
    total = max(rows, 1) * count
    raw = np.zeros(total + ALIGN, dtype)
    first = -raw.ctypes.data // dtype.itemsize % ALIGN
    values = raw[first : first + total]
    return values.reshape(rows, count) if rows else values


class Engine:
    """Time levels of one field, a scalar or a vector, and the compiled loop that advances them.

    Parameters
    ----------
    core : tuple of int
        Nodes of the core, three axes (leading axes have one node in 1D and 2D).
    offsets, weights : ndarray, shapes (K, 3) and (K,), or (K, d, d)
        Stencil in units of the operator (1/time or 1/time^2). Matrices act on fields of d components (2 or 3), those
        along the last d axes.
    stages : Stages
        Integrator (see `farhorizon.medium.integrators`).
    dt : float
    layers : mapping of (axis, side) to Layer
    periodic : set of int
    real : {"float64", "float32"}
    threads : int
    coefficient : ndarray, shape `core`, optional
        Factor on bonds, combined by `rule`.

    Attributes
    ----------
    absent_bonds : int
        Bonds that are absent, counted from each end that is a node of a level.
    exists : ndarray of bool, shape (places,)
        Where nodes are.
    outside : ndarray of int
        Places in a level, of the first component, of nodes that do not exist but have bonds to some that do: they
        must be held at zero.
    watched : ndarray of int, shape (n,)
        Places in a level whose values after each step of an `advance` are in `seen`, shape (steps, n).
    """

    def __init__(  # type: ignore[no-untyped-def]
        self,
        core,
        offsets,
        weights,
        stages,
        dt,
        *,
        layers: Mapping[tuple[int, int], Layer],
        periodic=frozenset(),
        real="float64",
        threads=1,
        coefficient=None,
        rule="both",
    ) -> None:
        self.dtype = np.dtype(real)
        self.stages, self.dt = stages, dt
        self.offsets, self.weights = np.asarray(offsets, np.int64), np.asarray(weights, float)
        self.components = 1 if self.weights.ndim == 1 else self.weights.shape[1]
        self.layers = dict(layers)
        columns = {name: layer.columns for name, layer in self.layers.items()}
        self.layout = Layout(tuple(core), self.offsets, columns, frozenset(periodic), self.components)
        self.core = self.layout.near
        self.remember = any(np.any(layer.sigma) for layer in self.layers.values())
        recursion = {name: layer.recursion(dt) for name, layer in self.layers.items()}
        matrices = self.weights.reshape(len(self.weights), self.components, self.components)
        self._tables = LayerTables(
            self.layout, self.offsets, matrices, recursion, self.dtype, self.remember, coefficient is None
        )
        self._layers = self._tables.layers
        self.levels = _zeros(self.components * self.layout.size, self.dtype, stages.levels)
        self.slots = _zeros(self._tables.slots, self.dtype)
        self.memory = _zeros(self._tables.memory if self.remember else ALIGN * 4, self.dtype)
        numbers = self.components * int(np.prod(core)) + (self.memory.size // 4 if self.remember else 0)
        self.threads = threads if numbers >= _PARALLEL_NUMBERS else 1
        self.phase, self.steps_done = 0, 0
        self._work = _zeros(self._tables.scratch, self.dtype, self.threads)
        self._coefficient = np.ones(1, self.dtype)
        self._rule = RULES.index(rule)
        self._collect_sweep(coefficient is not None)
        self._copies = self.layout.copies()
        if coefficient is not None:
            self._coefficient = self.spread(coefficient)
        self._bonds, self._work_done = no_bonds(self.dtype), np.zeros(0)
        self.set_cuts(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, *self.weights.shape[1:])))
        self.set_damping(np.zeros(0, np.int64), np.zeros(0), np.zeros(0), np.zeros(0))
        self._set_tiles(
            np.zeros((0, 0), np.int64), np.zeros((0, 0), np.int64), np.zeros(0, np.int64), (1.0, np.inf), 0.0
        )
        self.set_ends(np.zeros((0, 0), np.int64), 1.0)
        self.hold(np.zeros(0, np.int64))
        self.set_tied(np.zeros(0, np.int64), np.zeros(1, np.int64), np.zeros(0, np.int64), np.zeros(0))
        none = np.zeros(0, np.int64)
        self.set_fringe(none, 1, np.zeros(1, np.int64), none, np.zeros(1, np.int64), none, np.zeros(0), none)
        self.set_books(none, none, none, np.zeros(0), np.zeros(len(stages.numbers)), 0)
        self.watched, self.seen = none, np.zeros((0, 0))
        self._collect_filter()

    # --- tables of the compiled loop ---------------------------------------------------------------------------

    def _collect_sweep(self, heterogeneous: bool) -> None:
        """What the sweep of the box takes: its row, compiled rows or 0, how many at a time, their weights, offsets,
        weights of the general sweep.
        """
        function, row = (
            (0, np.zeros(1))
            if heterogeneous
            else compiled_rows(self.offsets, self.weights, self.dtype.name, self.stages.increments)
        )
        scale = np.array([n[2] for n in self.stages.numbers])
        self._box = [
            self.layout.table(),
            function,
            self._depth(),
            (scale[:, None] * row).astype(self.dtype),
            self.offsets @ np.array(self.layout.box.stride),
            (scale[:, None] * self.weights.ravel()).astype(self.dtype),
        ]
        self._numbers = np.array([(a + s * self._centre, a, b, s, g) for a, b, s, g in self.stages.numbers]).astype(
            self.dtype
        )
        self._rotation = np.array(self.stages.rotation, np.int64)

    @property
    def _centre(self) -> float:
        """The operator's weight of a node itself, where the rows do not have it among their weights."""
        return -float(self.weights.sum()) if self.components == 1 else 0.0

    def _depth(self) -> int:
        """Rows to sweep at a time: few enough that each thread gets some and that, in 3D, the planes they read stay in
        the second cache.
        """
        box, reach = self.layout.box, self.layout.reach
        rows, planes = box.nodes[1], 2 * reach[0] + 1
        most = min(64, -(-box.nodes[0] * rows // (8 * self.threads)))
        if planes > 1:
            most = min(
                most, _SECOND_CACHE // (self.components * box.stride[1] * self.dtype.itemsize * planes) - 2 * reach[0]
            )
        return -(-rows // -(-rows // max(most, 8)))

    def _collect_filter(self) -> None:
        """Tables of the filter that damps short waves in the layers; all layers share the longest one, and what it is
        applied to.
        """
        layers = self.layers.values()
        taps = max((layer.taps for layer in layers), key=len, default=np.zeros(1))
        rates = {
            name: layer.damping if layer.damping.size else np.zeros(layer.columns)
            for name, layer in self.layers.items()
        }
        tables = filter_tables(self.layout, rates, taps, self.dt)
        self._filter = tuple(a.astype(self.dtype) if a.dtype == np.float64 else a for a in tables)
        self._whole = any(layer.whole for layer in layers)

    def spread(self, core: np.ndarray, beyond: Mapping[tuple[int, int], float] | None = None) -> np.ndarray:
        """Nodal values of the core on every place of a level: constant along each normal from the core's edge on.

        `beyond` gives the value beyond a side (axis, side) where it is not that of the edge.
        """
        layout, padded = self.layout, np.asarray(core, float)
        for axis, m in enumerate(layout.reach):
            mode = "wrap" if axis in layout.periodic else "edge"
            widths = layout.low[axis] + m, layout.high[axis] + m
            margins = [widths if a == axis else (0, 0) for a in range(3)]
            padded = np.pad(padded, margins, mode=mode)  # type: ignore[call-overload]
            for side, width in zip((-1, 1), widths, strict=True):
                if beyond is not None and (axis, side) in beyond:
                    strip = slice(0, width) if side < 0 else slice(padded.shape[axis] - width, None)
                    padded[tuple(strip if a == axis else slice(None) for a in range(3))] = beyond[axis, side]
        values = np.zeros(layout.size, self.dtype)
        layout.box.all(values)[...] = padded
        return values

    # --- parts that may be set after construction --------------------------------------------------------------

    def set_cuts(
        self, nodes: np.ndarray, neighbours: np.ndarray, weights: np.ndarray, exists: np.ndarray | None = None
    ) -> None:
        """Bonds that are absent.

        Parameters
        ----------
        nodes, neighbours : ndarray of int, shape (bonds,)
            Node in a level and its neighbour's place (of the first component); one row a direction.
        weights : ndarray, shape (bonds,) or (bonds, d, d)
            What is taken away, without coefficients.
        exists : ndarray of bool, shape (places,), optional
            Where nodes are, everywhere unless given. No bond leads from or to a place without a node, where all levels
            must hold zero: they do beyond the core and the layers, and the nodes `outside` must be kept so.
        """
        self.exists = np.ones(self.layout.size, bool) if exists is None else exists
        kept = self.exists[nodes] & self.exists[neighbours]
        nodes, neighbours, weights = nodes[kept], neighbours[kept], weights[kept]
        self.absent_bonds = len(nodes)
        self._open_rim()
        swept = self._clear(nodes, neighbours) if self.has_bonds else np.zeros(len(nodes), bool)
        nodes, neighbours, weights = (
            nodes[~swept].astype(np.int64),
            neighbours[~swept].astype(np.int64),
            weights[~swept],
        )
        order = np.lexsort((neighbours, nodes))
        self._cuts = nodes[order], neighbours[order], weights[order].astype(self.dtype).ravel()
        self._layers = self._tables.cut(*self._cuts[:2], weights[order])

    def _open_rim(self) -> None:
        """Tables of the nodes with bonds to places without a node (see `engine.surface`), and the nodes `outside`."""
        exists, box = self.exists, self.layout.box
        at: tuple[np.ndarray, ...] = (np.zeros(0, np.int64),) * 3
        bare = np.zeros((len(self.offsets), 0), bool)
        if not exists.all():
            self.levels.reshape(len(self.levels), self.components, -1)[..., ~exists] = 0
            # nothing passes the layers' filter from or to there
            self._filter[3][np.flatnonzero(~exists[damped_nodes(self._filter[4])])] = 0
            at, bare = bare_bonds(box, self.offsets, exists)
        flat = np.asarray(box.origin + sum(i * s for i, s in zip(at, box.stride, strict=True)))
        self.absent_bonds += int(bare.sum())
        self.outside = flat[~exists[flat]]
        kept = exists[flat]
        if self.has_bonds:
            self._clear_bits(flat, bare)
            kept &= ~self._in_zone(np.stack(at, axis=1))
        first, second, third = (i[kept] for i in at)
        order = np.lexsort((third, second, first))
        counts = np.bincount(first * box.nodes[1] + second, minlength=box.nodes[0] * box.nodes[1])
        weights = self._weights_of(flat[kept], bare[:, kept])[order].astype(self.dtype).reshape(-1, self.components**2)
        self._rim = shared_rows(np.cumsum(np.append(0, counts)), third[order], weights)

    def _weights_of(self, nodes: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Sum of the weights of the `chosen` bonds, shape (K, S), of nodes; shape (S,) or (S, d, d).

        With coefficients, but for those of phases, which change.
        """
        total = np.zeros((len(nodes), *self.weights.shape[1:]))
        for offset, weight, which in zip(self.offsets, self.weights, chosen, strict=True):
            mine = nodes[which]
            other = mine + int(offset @ np.array(self.layout.box.stride))
            factors = np.ones(len(mine)) if self._rule == PHASES else self.bond_factors(mine, other)
            total[which] += np.multiply.outer(factors, weight)
        return total

    def set_bonds(self, stiffness: np.ndarray, spacing: float, zone: Zone, nonlinear: bool, limit: float) -> None:
        """Bonds that follow a law of their own stretch and may break, where both ends lie in a zone of the core; see
        `engine.bonds`.

        Parameters
        ----------
        stiffness : ndarray, shape (K,)
            Force on a unit of mass over elongation, of each offset, without coefficients.
        spacing : float
            Of the nodes, in the unit of the field.
        zone : Zone
            Of the core.
        nonlinear : bool
        limit : float
            Largest ``|xi + eta|^2 / |xi|^2 - 1`` of a bond (linearised: ``2 xi . eta / |xi|^2``) that does not break;
            may be infinite.
        """
        block, components, high = self.layout.box, self.components, ROWS[self.components]
        xi = spacing * self.offsets[:, 3 - components :].astype(float)
        table = np.column_stack([xi, 1 / (xi**2).sum(1), self.stages.numbers[0][2] * np.asarray(stiffness)]).astype(
            self.dtype
        )
        places = np.column_stack([self.offsets @ np.array(block.stride), self.offsets]).astype(np.int64)
        alive = np.zeros(
            (len(all_bits(len(places))), block.origin + block.nodes[0] * block.stride[0] + LANES), np.uint64
        )
        alive[:, block.node_indices()] = all_bits(len(places))[:, None, None, None]
        zone = zone.moved(self.layout.low)
        rows = block.nodes[0], -(-block.nodes[1] // high)
        kinds = np.zeros((*rows, -(-(zone.end[2] - zone.first[2]) // LANES)), np.uint8)
        rule = RULES[self._rule] if self._coefficient.size > 1 else None
        functions = np.array(load_bonds(components, nonlinear, self.dtype.name, rule), np.int64)
        limits = np.array([limit, (limit / 2 * spacing) ** 2], self.dtype)
        self._bonds = Bonds(
            functions,
            table,
            places,
            alive,
            kinds,
            zone.table(self.layout.reach),
            limits,
            nonlinear,
            np.zeros((*rows, 2)),
        )
        self._sweep_in_pieces(bond_laws.CALM_ROWS)
        self._find_kinds()

    def record_work(self) -> None:
        """From now on add up the work of the sources; the older level must outlive a step."""
        self._work_done = np.zeros(-(-self.components * int(np.prod(self.core.nodes)) // bond_laws.CHUNK))

    @property
    def nonlinear(self) -> bool:
        """Whether the law of the bonds is."""
        return self._bonds.nonlinear

    @property
    def has_bonds(self) -> bool:
        """Whether there are bonds that follow a law of their own."""
        return len(self._bonds.places) > 0

    def _clear(self, nodes: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
        """Clear the bits of bonds of the core; says which of them have their node in the zone, where bits alone
        count."""
        block, places = self.layout.box, self._bonds.places
        number = np.full(self._bonds.alive.shape[1], -1)
        number[block.node_indices().ravel()] = np.arange(int(np.prod(block.nodes)))
        mine = np.flatnonzero((nodes < len(number)) & (neighbours < self.layout.size))
        mine = mine[number[nodes[mine]] >= 0]
        order = np.argsort(places[:, 0])
        bond = order[np.searchsorted(places[order, 0], neighbours[mine] - nodes[mine])]
        np.bitwise_and.at(self._bonds.alive, (bond >> 6, nodes[mine]), ~(np.uint64(1) << (bond & 63).astype(np.uint64)))
        self._find_kinds()
        swept = np.zeros(len(nodes), bool)
        swept[mine] = self._in_zone(np.stack(np.unravel_index(number[nodes[mine]], block.nodes), axis=1))
        return swept

    def _clear_bits(self, nodes: np.ndarray, gone: np.ndarray) -> None:
        """Clear the bits of the bonds of nodes of the core that are `gone`, shape (K, nodes)."""
        for bond, which in enumerate(gone):
            self._bonds.alive[bond >> 6, nodes[which]] &= ~(np.uint64(1) << np.uint64(bond & 63))

    def _in_zone(self, at: np.ndarray) -> np.ndarray:
        """Which nodes of the core, shape (N, 3), are in the zone of bonds with their own law: bits alone count
        there."""
        zone = self._bonds.zone
        return np.asarray(((at >= zone[FIRST:END]) & (at < zone[END:])).all(1))

    def _find_kinds(self) -> None:
        """Which tiles of the zone are plain: all bonds there, and none leaves the box where bonds follow the law."""
        block, high, kinds, zone = self.layout.box, ROWS[self.components], self._bonds.kinds, self._bonds.zone
        full = all_bits(len(self._bonds.places))[:, None, None, None]
        odd = (self._bonds.alive[:, block.node_indices()] != full).any(0)
        for axis, m in enumerate(self.layout.reach):
            i = np.arange(block.nodes[axis])
            odd |= ((i - m < zone[axis]) | (i + m >= zone[axis] + zone[3 + axis])).reshape(
                [-1 if a == axis else 1 for a in range(3)]
            )
        first, end = zone[FIRST:END], zone[END:]
        odd[:, : first[1]] = odd[:, end[1] :] = False  # rows of tiles that are not in the zone
        odd = odd[:, :, first[2] : end[2]]
        missing = [
            (0, count * size - n) for n, count, size in zip(odd.shape, kinds.shape, (1, high, LANES), strict=True)
        ]
        tiles = np.pad(odd, missing).reshape(kinds.shape[0], kinds.shape[1], high, kinds.shape[2], LANES)
        kinds[...] = np.where(tiles.any((2, 4)), ODD, PLAIN)

    @property
    def alive(self) -> np.ndarray:
        """Bonds that are left of each node of the core."""
        bits = np.ascontiguousarray(self._bonds.alive[:, self.core.node_indices()])
        return _SET_BITS[bits[..., None].view(np.uint8)].sum((0, -1), dtype=np.int64)

    @property
    def bond_state(self) -> dict[str, np.ndarray]:
        """What a checkpoint holds of the bonds: bits, kinds of tiles, and what has been added up of broken bonds and of
        work; they share memory.
        """
        bonds = (
            {"bonds": self._bonds.alive, "kinds": self._bonds.kinds, "broken": self._bonds.book}
            if self.has_bonds
            else {}
        )
        return bonds | ({"work": self._work_done} if self._work_done.size else {})

    @property
    def broken(self) -> tuple[float, int]:
        """Energy of the bonds when they broke, for a unit of mass a node, and their number."""
        energy, count = self._bonds.book.sum((0, 1))
        return float(energy) / self.stages.numbers[0][2], round(float(count))

    def book_cut(self, energy: float) -> None:
        """Add the energy, for a unit of mass a node, of bonds that were cut."""
        self._bonds.book[0, 0, 0] += energy * self.stages.numbers[0][2]

    @property
    def work(self) -> float:
        """Work of the sources, for a unit of mass a node."""
        return float(self._work_done.sum())

    def bond_energy(self, first: tuple[int, ...], end: tuple[int, ...], nodes: np.ndarray, whole: np.ndarray) -> float:
        """Energy of the bonds of some nodes from the elongations now and a step ago, for a unit of mass a node.

        `nodes`, of the box from `first` to `end` of the core, says which; bonds to nodes beyond the box count half,
        across sides that are `whole`, shape (3, 2), fully.
        """
        self.complete(self.current)
        low = np.array(self.layout.low)
        bounds = np.array(first, np.int64) + low, np.array(end, np.int64) + low
        total = bond_laws.strain_energy(
            self.current,
            self.older,
            self._box[0],
            *bounds,
            nodes,
            whole,
            self.components,
            self._coefficient,
            self._rule,
            self._bonds,
        )
        return float(total) / self.stages.numbers[0][2]

    def largest_strain(self) -> float:
        """Largest ``|xi + eta|^2 / |xi|^2 - 1`` (linearised: ``2 xi . eta / |xi|^2``) of the bonds that may break."""
        self.complete(self.current)
        return float(bond_laws.largest_strain(self.current, self._box[0], self.components, self._bonds))

    def present_bonds(self, nodes: tuple[slice, ...]) -> np.ndarray:
        """Bits of the bonds that are there and carry something, of the nodes in a part of the core; shape (words,
        *part).
        """
        places = self.core.node_indices()[nodes]
        bits = self._bonds.alive[:, places]
        for k, distance in enumerate(self._bonds.places[:, 0] if self._coefficient.size > 1 else ()):
            idle = (self.bond_factors(places.ravel(), places.ravel() + distance) == 0).reshape(places.shape)
            bits[k >> 6, idle] &= ~(np.uint64(1) << np.uint64(k & 63))
        return bits

    @property
    def bond_limit(self) -> float:
        """Largest e of a bond that does not break, see `set_bonds`."""
        return float(self._bonds.limit[0])

    def set_damping(self, nodes: np.ndarray, before: np.ndarray, after: np.ndarray, leak: np.ndarray) -> None:
        """Nodal factors of an absorbing zone: on the old increment, on the new increment, and a loss rate.

        Nodes whose new increment is taken whole stay where they are.
        """
        if nodes.size:
            self._filter[3][np.flatnonzero(np.isin(damped_nodes(self._filter[4]), nodes[after == 0]))] = 0
        self._damping = (
            nodes.astype(np.int64),
            before.astype(self.dtype),
            after.astype(self.dtype),
            leak.astype(self.dtype),
        )

    def set_phases(self, dissolved: np.ndarray, interface: float, saturation: float, limited: bool = False) -> None:
        """Two phases: bonds between solid nodes carry nothing, those between phases `interface` times their weight, and
        a solid node becomes liquid once its value is below `saturation`. All beyond the core is liquid, beyond a
        periodic side what it repeats.

        Parameters
        ----------
        dissolved : ndarray of int, shape of the core
            Steps (of `steps_done`) at which the nodes became liquid, `NEVER` for the solid ones.
        limited : bool
            Whether between the phases no value counts for more than the saturation.
        """
        solid = dissolved == NEVER
        beyond = {(axis, side): 1.0 for axis in range(3) for side in (-1, 1) if axis not in self.layout.periodic}
        self._rule = RULES.index("phases")
        self._coefficient = self.spread(np.where(solid, -interface, 1.0), beyond)
        steps = np.zeros(self.layout.size, np.int64)
        self.core.view(steps)[...] = dissolved
        self._sweep_in_pieces(TILE_ROWS)
        self._set_tiles(*self._count_solid(), steps, (interface, saturation if limited else np.inf), saturation)

    def _count_solid(self) -> tuple[np.ndarray, np.ndarray]:
        """Solid nodes, and all nodes, of each tile and within one reach of it."""
        return count_solid(self.layout.box.all(self._coefficient) < 0, self.layout.reach, (1, TILE_ROWS, TILE))

    def _set_tiles(
        self,
        solids: np.ndarray,
        volumes: np.ndarray,
        dissolved: np.ndarray,
        interface: tuple[float, float],
        saturation: float,
    ) -> None:
        period = np.array([n if a in self.layout.periodic else 0 for a, n in enumerate(self.layout.box.nodes)])
        changed, runs = np.ones(len(solids), bool), np.zeros((*solids.shape, 2), np.int32)
        if len(solids):
            find_runs(0, 1, solids, volumes, changed, runs)
        self._runs = runs, (self.dtype.type(interface[0]), self.dtype.type(interface[1]))
        self._tiles = solids, volumes, changed
        self._dissolution = dissolved, np.zeros(1, np.int64), float(saturation), period

    @property
    def dissolved(self) -> np.ndarray:
        """Step at which each node of the core became liquid, `NEVER` for solid ones, where there are phases; shares
        memory.
        """
        return self.core.view(self._dissolution[0])

    def hold(self, nodes: np.ndarray) -> None:
        """Nodes with prescribed values: those of the columns of `held_values` in `advance`."""
        self.held = nodes.astype(np.int64)

    def set_ends(self, nodes: np.ndarray, first: float, sums: Sequence[Poles | None] = (), block: int = 0) -> None:
        """Exact ends of a bar, their states zero: `states`, `forces`, `heads`, `past` and `history` are theirs to read
        and to fill.

        Parameters
        ----------
        nodes : ndarray of int, shape (ends, K)
            Drivers in a level, from each end inwards.
        first : float
            Weight of the sample at step 0.
        sums : sequence of (poles, inputs, outputs), or None
            Complex arrays of shapes (P,), (P, K), (P, K) for each end that is a sum of exponentials.
        block : int
            Steps in a block of convolutions, 0 without.
        """
        ends, reach = nodes.shape
        rows = -(-reach // 4) * 4
        most = max((len(s[0]) for s in sums if s is not None), default=0)
        count = -(-most // _MODES) * _MODES
        poles, inputs, outputs = (
            np.zeros((ends, 2, count)),
            np.zeros((ends, rows, 2 * count)),
            np.zeros((ends, rows, 2 * count)),
        )
        for end, found in enumerate(sums):
            if found is not None:
                z, c, b = found
                used, imaginary = slice(len(z)), slice(count, count + len(z))
                poles[end, 0, used], poles[end, 1, used] = z.real, z.imag
                inputs[end, :reach, used], inputs[end, :reach, imaginary] = c.real.T, c.imag.T
                outputs[end, :reach, used], outputs[end, :reach, imaginary] = b.real.T, -b.imag.T
        self.clock, self.poles = np.zeros(1, np.int64), poles
        self.states, self.forces = np.zeros((ends, 2 * count)), np.zeros((ends, rows))
        self.heads, self.past, self.history = (
            np.zeros((ends, block, reach, reach)),
            np.zeros((ends, block, reach)),
            np.zeros((ends, 0, reach)),
        )
        self._ends = (
            self.clock,
            float(first),
            nodes.astype(np.int64),
            poles,
            inputs,
            outputs,
            self.states,
            np.zeros(rows),
            self.forces,
        )

    def _lengthen_history(self, steps: int) -> None:
        """Room for the drivers' values of some steps more."""
        ends, length, reach = self.history.shape
        if ends and length < self.clock[0] + steps:
            more = max(int(self.clock[0]) + steps - length, min(length, 1 << 20), 256)
            self.history = np.concatenate([self.history, np.zeros((ends, more, reach))], axis=1)

    def set_tied(self, nodes: np.ndarray, starts: np.ndarray, sources: np.ndarray, weights: np.ndarray) -> None:
        """Nodes with prescribed values: node i is the sum of weights[k] times node sources[k], k from starts[i] to
        starts[i + 1], plus what `advance` is told. They are set in this order after each stage."""
        self._tied = (
            nodes.astype(np.int64),
            starts.astype(np.int64),
            sources.astype(np.int64),
            weights.astype(self.dtype),
        )

    def set_fringe(
        self,
        nodes: np.ndarray,
        levels: int,
        fronts: np.ndarray,
        rows: np.ndarray,
        starts: np.ndarray,
        columns: np.ndarray,
        weights: np.ndarray,
        outside: np.ndarray,
    ) -> None:
        """Halo nodes along an outline that are sums over a fringe of `nodes`, as `fringe.split_sums` has it; `rows`:
        places of the halo nodes there.

        The rows of `fringe_history`, shape (levels - 1, S), are the fringe's values one step ago, two and so on; a step
        forgets the last.
        """
        count = nodes.size * (levels - 1)
        # the last windows reach beyond it
        history = _zeros(count + WINDOW, np.dtype(float))[:count].reshape(nodes.size, levels - 1)
        self.fringe_history = history.T
        edges = np.flatnonzero(np.diff(np.sort(outside), prepend=-2, append=-2) != 1)
        runs = (
            np.stack([np.sort(outside)[edges[:-1]], np.sort(outside)[edges[1:] - 1] + 1], axis=1)
            if outside.size
            else np.zeros((0, 2))
        )
        self._fringe = (
            nodes.astype(np.uint32),
            history,
            *split_sums(fronts, rows, starts, columns, np.asarray(weights, float), nodes, levels),
            runs.astype(np.int64),
        )

    def set_books(
        self,
        books: np.ndarray,
        nodes: np.ndarray,
        neighbours: np.ndarray,
        weights: np.ndarray,
        effects: np.ndarray,
        count: int,
        ends: np.ndarray = _NO_ENDS,
        sides: Mapping[tuple[int, int], tuple[int, np.ndarray]] | None = None,
    ) -> None:
        """Bonds whose flow into their node is summed over time, in `count` books, and what each stage's flow adds to a
        step's.

        Places in a level, weights without coefficients; a neighbour below 0 is at zero. `ends`, shape (ends, K): the
        books of the drivers of exact ends, -1 for none. `sides`: the book of a layer (axis, side), and the nodes next
        to it into which what it adds to these flows is counted. First-order equations only.
        """
        self.flows = np.zeros((2, count))
        near, rows = [np.zeros(0, np.int64)], []
        for (axis, _), (number, at) in (sides or {}).items():
            first = sum(map(len, near))
            rows.append((axis, number, first, first + len(at)))
            near.append(at)
        self._books = (
            books.astype(np.int64),
            nodes.astype(np.int64),
            neighbours.astype(np.int64),
            weights.astype(float),
            effects.astype(float),
            ends,
            np.array(rows, np.int64).reshape(-1, 4),
            np.concatenate(near),
            np.zeros(self.layout.size if rows else 0, self.dtype),
        )

    def tie(self, values: np.ndarray) -> None:
        """Set the prescribed nodes of the current level; `values` has what is added to the combinations, one a
        prescribed node.
        """
        level = self.current
        self._driver.tie(
            level, level, level, False, *self._tied, np.asarray(values, self.dtype)[None], np.ones(1, self.dtype)
        )

    def bond_factors(self, nodes: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
        """Factor of each bond from the coefficients of its ends (flat indices)."""
        if self._coefficient.size == 1:
            return np.ones(len(nodes))
        mine, other = self._coefficient[nodes].astype(float), self._coefficient[neighbours].astype(float)
        if self._rule == PHASES:
            return np.maximum(np.maximum(mine, other), 0) * np.abs(np.minimum(mine, other))
        if self._rule == 0:
            return np.minimum(mine, other)
        total = mine + other
        return 0.5 * total if self._rule == 1 else 2 * mine * other / np.where(total > 0, total, 1.0)

    def lost(self, nodes: np.ndarray, neighbours: np.ndarray, weights: np.ndarray | float) -> np.ndarray:
        """What is absent of the `weights` of bonds of the core (places), whatever the coefficients."""
        cut_nodes, cut_neighbours, cut_weights = self._cuts
        keys = cut_nodes * self.layout.size + cut_neighbours
        cut = np.zeros(len(nodes))
        if keys.size:
            order = np.argsort(keys)
            wanted = nodes * self.layout.size + neighbours
            at = np.minimum(np.searchsorted(keys[order], wanted), keys.size - 1)
            cut = np.where(keys[order][at] == wanted, cut_weights[order][at].astype(float), 0.0)
        return np.where(self.exists[nodes] == self.exists[neighbours], cut, weights)

    # --- the work ----------------------------------------------------------------------------------------------

    @property
    def _driver(self) -> ModuleType:
        """The compiled loop that has what this run needs."""
        fringe, work = self._fringe[0], self._work_done
        return load_driver(
            bool(self._runs[0].size or self.has_bonds or work.size or self.history.shape[0] or fringe.size)
        )

    @property
    def current(self) -> np.ndarray:
        """The flat level that holds the state."""
        return self.levels[self._rotation[self.phase, 0, 0]]

    @property
    def older(self) -> np.ndarray:
        """The level with the state one step ago, halos included (second-order integrators)."""
        rotation = self._rotation[self.phase, 0]
        return self.levels[rotation[2 if self.stages.increments else 1]]

    def all_components(self, nodes: np.ndarray) -> np.ndarray:
        """Indices in a level of all components of nodes that are given by those of the first, component by
        component."""
        return (nodes.ravel() + self.layout.size * np.arange(self.components)[:, None]).ravel()

    def complete(self, level: np.ndarray) -> None:
        """Fill the halo of a level across periodic axes."""
        self._driver.copy(level, self._copies, self.components)

    def remind(self, level: np.ndarray) -> None:
        """The layers' memory goes through one step in which the field is `level`."""
        self._stage(level, self.memory)

    def apply(self, level: np.ndarray) -> np.ndarray:
        """The operator L on a level, as a level (its nodes only are meaningful); fills the halo of `level`."""
        return self._stage(level, self.memory.copy())

    def _stage(self, level: np.ndarray, memory: np.ndarray) -> np.ndarray:
        out, base, numbers = self._plain(level)
        self._driver.stage(
            0,
            1,
            _ALONE,
            level,
            base,
            out,
            numbers,
            self.stages.increments,
            False,
            self.slots,
            memory,
            self._work,
            self.components,
            self._first_box,
            self._layers,
            self._copies,
            self._coefficient,
            self._rule,
            self._cuts,
            self._rim,
            *self._runs,
            self._lasting_bonds,
            self._reach,
        )
        return (base if self.stages.increments else out) / numbers[3]

    def apply_core(self, level: np.ndarray) -> np.ndarray:
        """The operator L on a level with whatever its halo holds, with plain shifts everywhere."""
        out, base, numbers = self._plain(level)
        self._driver.sweep_box(
            0,
            1,
            _ALONE,
            level,
            base,
            out,
            numbers,
            self.stages.increments,
            False,
            self.components,
            self._first_box,
            self._coefficient,
            self._rule,
            self._cuts,
            self._rim,
            *self._runs,
            self._lasting_bonds,
            self._reach,
        )
        return (base if self.stages.increments else out) / numbers[3]

    def _plain(self, level: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Empty output and base, and the numbers of a stage that writes ``scale * L``."""
        scale = self.stages.numbers[0][2]  # the last stage may be without operator
        return np.zeros_like(level), np.zeros_like(level), np.array([scale * self._centre, 0, 0, scale, 0], self.dtype)

    @property
    def _lasting_bonds(self) -> Bonds:
        """The bonds as they are, of which none breaks."""
        return self._bonds._replace(limit=np.array([np.inf, np.inf], self.dtype))

    @property
    def _first_box(self) -> tuple[Any, ...]:
        block, function, depth, weights, offsets, general = self._box
        return block, function, depth, weights[0], offsets, general[0]

    @property
    def _reach(self) -> np.ndarray:
        return np.array(self.layout.reach)

    def _sweep_in_pieces(self, rows: int) -> None:
        """From now on sweep whole multiples of some rows at a time."""
        self._box[2] = -(-self._box[2] // rows) * rows

    def advance(
        self,
        steps: int,
        source_nodes: np.ndarray,
        source_fields: np.ndarray,
        source_times: np.ndarray,
        held_values: np.ndarray | None = None,
        tied_fields: np.ndarray | None = None,
        tied_times: np.ndarray | None = None,
    ) -> None:
        """Run steps without returning to Python; sources, held and tied values as in `program.run`.

        Raises
        ------
        IndexError
            A table does not match the steps: the compiled loop, which looks at no bounds, is not entered.
        """
        self._lengthen_history(steps)
        self.seen = np.zeros((steps, self.watched.size))
        if tied_fields is None or tied_times is None:
            tied_fields, tied_times = (
                np.zeros((0, len(self._tied[0])), self.dtype),
                np.zeros((steps, len(self.stages.numbers), 0), self.dtype),
            )
        held_values = np.zeros((0, 0)) if held_values is None else held_values
        self._check_room(steps, source_nodes, source_fields, source_times, held_values, tied_fields, tied_times)
        state = (
            self.phase,
            self.levels,
            self._rotation,
            self._numbers,
            self.stages.increments,
            self.slots,
            self.memory,
            self._work,
            self.components,
            *self._box,
            self._layers,
            self._copies,
            self._coefficient,
            self._rule,
            self._cuts,
            self._rim,
            *self._runs,
            self._bonds,
            self._reach,
            self._work_done,
            *self._tiles,
            *self._dissolution,
            self.steps_done,
            *self._damping,
            (*self._ends, self.heads, self.past, self.history),
            *self._tied,
            *self._books,
            self.flows,
            self._fringe,
            (*self._filter, self._whole),
            source_nodes,
            source_fields,
            source_times,
            self.held,
            held_values,
            tied_fields,
            tied_times,
            self.watched,
            self.seen,
        )
        from farhorizon.engine.threads import side_by_side

        side_by_side(lambda lane, lanes, sync: self._driver.run(lane, lanes, sync, steps, *state), self.threads)
        self.phase = (self.phase + steps) % len(self._rotation)
        self.steps_done += steps

    def _check_room(
        self,
        steps: int,
        source_nodes: np.ndarray,
        source_fields: np.ndarray,
        source_times: np.ndarray,
        held_values: np.ndarray,
        tied_fields: np.ndarray,
        tied_times: np.ndarray,
    ) -> None:
        """Every table that the compiled loop indexes by step and stage is large enough; exact ends count their clock
        once a stage.
        """
        stages, ends = len(self.stages.numbers), len(self.history)
        for name, shape, least in (
            ("history", self.history.shape[1:2], (int(self.clock[0]) + steps * stages if ends else 0,)),
            ("source_times", source_times.shape, (steps, stages, len(source_fields))),
            ("source_fields", source_fields.shape[1:], (len(source_nodes) if len(source_fields) else 0,)),
            ("held_values", held_values.shape, (steps if len(self.held) else 0, len(self.held))),
            ("tied_times", tied_times.shape, (steps, stages, len(tied_fields))),
            ("tied_fields", tied_fields.shape[1:], (len(self._tied[0]),)),
        ):
            if len(shape) != len(least) or any(have < want for have, want in zip(shape, least, strict=True)):
                raise IndexError(
                    f"the table {name} of the compiled loop has the shape {shape}, less than {least} for {steps} steps"
                )

    def digest(self) -> str:
        """Hash of all that decides the map of a step: engines of one digest have one map."""
        mark = hashlib.sha256(
            repr(
                (self.dt, self.stages, self.core.nodes, sorted(self.layout.periodic), self._rule, self.dtype.name)
            ).encode()
        )
        layers = [
            a
            for _, layer in sorted(self.layers.items())
            for a in (layer.kappa, layer.sigma, layer.alpha, layer.damping, layer.taps)
        ]
        mark.update(repr([(name, layer.columns, layer.whole) for name, layer in sorted(self.layers.items())]).encode())
        ends = [np.asarray(a) for a in self._ends[2:6]]
        fringe = [a for a in self._fringe if a is not self._fringe[1]]
        for array in (
            self.offsets,
            self.weights,
            *layers,
            self._coefficient,
            *self._cuts,
            *self._rim,
            *self._damping,
            *self._tied,
            self.held,
            *ends,
            *fringe,
        ):
            mark.update(np.ascontiguousarray(array).tobytes())
        return mark.hexdigest()

    @contextmanager
    def as_before(self) -> Iterator[None]:
        """Whatever runs inside leaves no trace."""
        arrays = [
            self.levels,
            self.memory,
            self.states,
            self.forces,
            self.clock,
            self.flows,
            self.fringe_history,
            self._coefficient,
            self._runs[0],
            *self._tiles,
            *self._dissolution[:2],
            *self.bond_state.values(),
        ]
        kept, phase, steps = [a.copy() for a in arrays], self.phase, self.steps_done
        try:
            yield
        finally:
            for array, values in zip(arrays, kept, strict=True):
                array[...] = values
            self.phase, self.steps_done = phase, steps

    def advance_alone(self, steps: int) -> None:
        """Run steps with nothing from outside: no sources, and prescribed values that are zero."""
        held = np.zeros((steps, len(self.held)), self.dtype) if len(self.held) else None
        self.advance(
            steps,
            np.zeros(0, np.int64),
            np.zeros((0, 0), self.dtype),
            np.zeros((steps, len(self.stages.numbers), 0), self.dtype),
            held,
        )

    @property
    def layer_memory(self) -> list[tuple[tuple[int, int], np.ndarray]]:
        """Places of the memory that is ever used: (axis, side) of a layer, and an array by component, number, and line;
        see `LayerTables.cells`.
        """
        return self._tables.cells(self._layers.f != 0) if self.remember else []

    @property
    def nbytes(self) -> int:
        """Bytes of all time levels, slots, layer memory, phases, exact ends, fringes, the filter and absent bonds."""
        ends = (
            self.heads.nbytes + self.past.nbytes + self.history.nbytes + sum(np.asarray(a).nbytes for a in self._ends)
        )
        phases = sum(np.asarray(a).nbytes for a in (*self._runs, *self._tiles, *self._dissolution))
        phases += sum(np.asarray(a).nbytes for a in self._bonds)
        sparse = sum(np.asarray(a).nbytes for a in (*self._fringe, *self._filter, *self._cuts, *self._rim))
        return (
            self.levels.nbytes
            + self.slots.nbytes
            + self.memory.nbytes
            + self._coefficient.nbytes
            + ends
            + phases
            + sparse
        )

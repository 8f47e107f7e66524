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
from farhorizon.engine.bonds import DAMAGED, END, FIRST, PHASES, PLAIN, Bonds, Zone, all_bits, no_bonds
from farhorizon.engine.ends import Ends, Poles, ends_table
from farhorizon.engine.filter import Filter, damped_nodes, filter_tables
from farhorizon.engine.fringe import fringe_table, no_fringe
from farhorizon.engine.layout import Layout, aligned_zeros
from farhorizon.engine.nested import LayerTables
from farhorizon.engine.operations import Tables, operations_of, operator_operations, sweep_operations
from farhorizon.engine.phases import NEVER, count_solid, one_phase, phases_table
from farhorizon.engine.rows.bond_sweeps import LANES, ROWS
from farhorizon.engine.rows.build import load_bonds, load_driver
from farhorizon.engine.rows.choose import compiled_rows
from farhorizon.engine.rows.vectors import TILE, TILE_ROWS
from farhorizon.engine.surface import bare_bonds, shared_rows
from farhorizon.engine.tables import Cuts, Damping, Dependents, Flows, Inputs, Material, Stage, Surface, Sweep, no_flows
from farhorizon.engine.threads import side_by_side

__all__ = ["NEVER", "Engine", "Layer", "Layout", "Zone", "available_threads"]

_NO_ENDS = np.zeros((0, 0), np.int64)
RULES = ("both", "arithmetic", "harmonic", "phases")
_SECOND_CACHE = 600_000  # bytes of the second cache that a part of the box may take
_SET_BITS = np.array([number.bit_count() for number in range(256)], np.uint8)
# of the field, and a quarter of the layers' memory: fewer are through before a second thread is there
_PARALLEL_NUMBERS = 40_000


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
    reaction : float
        In units of the operator: what it takes of each node's own value, whatever the coefficient.

    Attributes
    ----------
    absent_bonds : int
        Bonds that are absent, counted from each end that is a node of a level.
    exists : ndarray of bool, shape (places,)
        Where nodes are.
    outside : ndarray of int
        Places in a level, of the first component, of nodes that do not exist but have bonds to some that do: they
        must be held at zero.
    loop : callable
        What works off the table of operations: the compiled loop, or a `farhorizon.engine.interpreter.Interpreter`.
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
        reaction=0.0,
    ) -> None:
        self.dtype = np.dtype(real)
        self.stages, self.dt, self.reaction = stages, dt, float(reaction)
        self.offsets, self.weights = np.asarray(offsets, np.int64), np.asarray(weights, float)
        self.components = 1 if self.weights.ndim == 1 else self.weights.shape[1]
        self.layers = dict(layers)
        columns = {name: layer.columns for name, layer in self.layers.items()}
        self.layout = Layout(tuple(core), self.offsets, columns, frozenset(periodic), self.components)
        self.core = self.layout.near
        self.remember = any(np.any(layer.sigma) for layer in self.layers.values())
        recursion = {name: layer.recursion(dt) for name, layer in self.layers.items()}
        matrices = self.weights.reshape(len(self.weights), self.components, self.components)
        self._layer_tables = LayerTables(
            self.layout, self.offsets, matrices, recursion, self.dtype, self.remember, coefficient is None
        )
        self.levels = aligned_zeros(self.components * self.layout.size, self.dtype, stages.levels)
        memory = self._layer_tables.layers.memory.size // 4 if self.remember else 0
        numbers = self.components * int(np.prod(core)) + memory
        self.threads = threads if numbers >= _PARALLEL_NUMBERS else 1
        self.phase, self.steps_done = 0, 0
        self.tables = self._first_tables(coefficient is not None, RULES.index(rule))
        if coefficient is not None:
            self._replace(material=self.tables.material._replace(coefficient=self.spread(coefficient)))
        none = np.zeros(0, np.int64)
        self.set_cuts(none, none, np.zeros((0, *self.weights.shape[1:])))
        self.hold(none)
        self.watched, self.seen = none, np.zeros((0, 0))
        self.loop = self._compiled

    # --- tables of the compiled loop ---------------------------------------------------------------------------

    def _first_tables(self, heterogeneous: bool, rule: int) -> Tables:
        """Those of a medium without anything that may be set later."""
        none, nothing, one = np.zeros(0, np.int64), np.zeros(0, self.dtype), self.dtype.type(1)
        numbers = [self._numbers_of(*one) for one in self.stages.numbers]
        return Tables(
            operations=np.zeros((0, 2), np.int64),
            starts=np.zeros(len(numbers) + 1, np.int64),
            rotation=np.array(self.stages.rotation, np.int64),
            numbers=np.array(numbers).astype(self.dtype),
            increments=self.stages.increments,
            components=self.components,
            sweep=self._sweep(heterogeneous),
            layers=self._layer_tables.layers,
            work_space=aligned_zeros(self._layer_tables.scratch, self.dtype, self.threads),
            copies=self.layout.copies(),
            material=Material(np.ones(1, self.dtype), rule, one, self.dtype.type(np.inf)),
            cuts=Cuts(none, none, nothing),
            surface=Surface(np.zeros((0, 2), np.int64), np.zeros((0, 3), np.int64), np.zeros((1, 0), self.dtype)),
            phases=one_phase(),
            bonds=no_bonds(self.dtype),
            work=np.zeros(0),
            damping=Damping(none, nothing, nothing, nothing),
            ends=ends_table(np.zeros((0, 0), np.int64), 1.0),
            dependents=Dependents(none, np.zeros(1, np.int64), none, nothing),
            flows=no_flows(len(numbers), self.dtype),
            fringe=no_fringe(),
            filter=self._filter(),
        )

    def _replace(self, **tables: Any) -> None:
        """Put others in the place of some tables."""
        self.tables = self.tables._replace(**tables)

    def _sweep(self, heterogeneous: bool) -> Sweep:
        function, row = (
            (0, np.zeros(1))
            if heterogeneous
            else compiled_rows(self.offsets, self.weights, self.dtype.name, self.stages.increments)
        )
        scale = np.array([n[2] for n in self.stages.numbers])
        return Sweep(
            self.layout.table(),
            function,
            self._depth(),
            (scale[:, None] * row).astype(self.dtype),
            self.offsets @ np.array(self.layout.box.stride),
            (scale[:, None] * self.weights.ravel()).astype(self.dtype),
            np.array(self.layout.reach),
        )

    def _numbers_of(self, a: float, b: float, scale: float, source_scale: float) -> tuple[float, ...]:
        """The numbers of a stage as the sweeps take them: how much of a node's own value beside the rows' weights and
        beside differences, and the rest. Rows of increments are differences, and leave out the value that stays.
        """
        own = a - float(self.stages.increments) - scale * self.reaction
        rows = -float(self.weights.sum()) if self.components == 1 and not self.stages.increments else 0.0
        return own + scale * rows, own, b, scale, source_scale

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

    def _filter(self) -> Filter:
        """What damps short waves in the layers; all layers share the longest filter, and what it is applied to."""
        layers = self.layers.values()
        taps = max((layer.taps for layer in layers), key=len, default=np.zeros(1))
        rates = {
            name: layer.damping if layer.damping.size else np.zeros(layer.columns)
            for name, layer in self.layers.items()
        }
        return filter_tables(self.layout, rates, taps, self.dt, self.dtype, any(layer.whole for layer in layers))

    @property
    def memory(self) -> np.ndarray:
        """What the layers remember."""
        return self.tables.layers.memory

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
        self._open_surface()
        swept = self._clear(nodes, neighbours) if self.has_bonds else np.zeros(len(nodes), bool)
        nodes, neighbours, weights = (
            nodes[~swept].astype(np.int64),
            neighbours[~swept].astype(np.int64),
            weights[~swept],
        )
        order = np.lexsort((neighbours, nodes))
        nodes, neighbours, weights = nodes[order], neighbours[order], weights[order]
        self._replace(
            cuts=Cuts(nodes, neighbours, weights.astype(self.dtype).ravel()),
            layers=self._layer_tables.cut(nodes, neighbours, weights),
        )

    def _open_surface(self) -> None:
        """Tables of the nodes with bonds to places without a node (see `engine.surface`), and the nodes `outside`."""
        exists, box = self.exists, self.layout.box
        at: tuple[np.ndarray, ...] = (np.zeros(0, np.int64),) * 3
        bare = np.zeros((len(self.offsets), 0), bool)
        if not exists.all():
            self.levels.reshape(len(self.levels), self.components, -1)[..., ~exists] = 0
            # nothing passes the layers' filter from or to there
            found = self.tables.filter
            found.strengths[np.flatnonzero(~exists[damped_nodes(found.runs)])] = 0
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
        self._replace(surface=Surface(*shared_rows(np.cumsum(np.append(0, counts)), third[order], weights)))

    def _weights_of(self, nodes: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Sum of the weights of the `chosen` bonds, shape (K, S), of nodes; shape (S,) or (S, d, d).

        With coefficients, but for those of phases, which change.
        """
        total = np.zeros((len(nodes), *self.weights.shape[1:]))
        for offset, weight, which in zip(self.offsets, self.weights, chosen, strict=True):
            mine = nodes[which]
            other = mine + int(offset @ np.array(self.layout.box.stride))
            factors = np.ones(len(mine)) if self.tables.material.rule == PHASES else self.bond_factors(mine, other)
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
        rule = RULES[self.tables.material.rule] if self.tables.material.coefficient.size > 1 else None
        functions = np.array(load_bonds(components, nonlinear, self.dtype.name, rule), np.int64)
        limits = np.array([limit, (limit / 2 * spacing) ** 2], self.dtype)
        at = zone.table(self.layout.reach)
        broken = np.zeros((*rows, 2))
        self._replace(bonds=Bonds(functions, table, places, alive, kinds, at, limits, nonlinear, broken))
        self._sweep_in_pieces(bond_laws.PIECE_ROWS)
        self._find_kinds()

    def record_work(self) -> None:
        """From now on add up the work of the sources; the older level must outlive a step."""
        self._replace(work=np.zeros(-(-self.components * int(np.prod(self.core.nodes)) // bond_laws.CHUNK)))

    @property
    def nonlinear(self) -> bool:
        """Whether the law of the bonds is."""
        return self.tables.bonds.nonlinear

    @property
    def has_bonds(self) -> bool:
        """Whether there are bonds that follow a law of their own."""
        return len(self.tables.bonds.places) > 0

    def _clear(self, nodes: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
        """Clear the bits of bonds of the core; says which of them have their node in the zone, where bits alone
        count."""
        block, places = self.layout.box, self.tables.bonds.places
        number = np.full(self.tables.bonds.alive.shape[1], -1)
        number[block.node_indices().ravel()] = np.arange(int(np.prod(block.nodes)))
        mine = np.flatnonzero((nodes < len(number)) & (neighbours < self.layout.size))
        mine = mine[number[nodes[mine]] >= 0]
        order = np.argsort(places[:, 0])
        bond = order[np.searchsorted(places[order, 0], neighbours[mine] - nodes[mine])]
        np.bitwise_and.at(
            self.tables.bonds.alive, (bond >> 6, nodes[mine]), ~(np.uint64(1) << (bond & 63).astype(np.uint64))
        )
        self._find_kinds()
        swept = np.zeros(len(nodes), bool)
        swept[mine] = self._in_zone(np.stack(np.unravel_index(number[nodes[mine]], block.nodes), axis=1))
        return swept

    def _clear_bits(self, nodes: np.ndarray, gone: np.ndarray) -> None:
        """Clear the bits of the bonds of nodes of the core that are `gone`, shape (K, nodes)."""
        for bond, which in enumerate(gone):
            self.tables.bonds.alive[bond >> 6, nodes[which]] &= ~(np.uint64(1) << np.uint64(bond & 63))

    def _in_zone(self, at: np.ndarray) -> np.ndarray:
        """Which nodes of the core, shape (N, 3), are in the zone of bonds with their own law: bits alone count
        there."""
        zone = self.tables.bonds.zone
        return np.asarray(((at >= zone[FIRST:END]) & (at < zone[END:])).all(1))

    def _find_kinds(self) -> None:
        """Which tiles of the zone are plain: all bonds there, and none leaves the box where bonds follow the law."""
        block, high, kinds, zone = (
            self.layout.box,
            ROWS[self.components],
            self.tables.bonds.kinds,
            self.tables.bonds.zone,
        )
        full = all_bits(len(self.tables.bonds.places))[:, None, None, None]
        damaged = (self.tables.bonds.alive[:, block.node_indices()] != full).any(0)
        for axis, m in enumerate(self.layout.reach):
            i = np.arange(block.nodes[axis])
            damaged |= ((i - m < zone[axis]) | (i + m >= zone[axis] + zone[3 + axis])).reshape(
                [-1 if a == axis else 1 for a in range(3)]
            )
        first, end = zone[FIRST:END], zone[END:]
        damaged[:, : first[1]] = damaged[:, end[1] :] = False  # rows of tiles that are not in the zone
        damaged = damaged[:, :, first[2] : end[2]]
        missing = [
            (0, count * size - n) for n, count, size in zip(damaged.shape, kinds.shape, (1, high, LANES), strict=True)
        ]
        tiles = np.pad(damaged, missing).reshape(kinds.shape[0], kinds.shape[1], high, kinds.shape[2], LANES)
        kinds[...] = np.where(tiles.any((2, 4)), DAMAGED, PLAIN)

    @property
    def alive(self) -> np.ndarray:
        """Bonds that are left of each node of the core."""
        bits = np.ascontiguousarray(self.tables.bonds.alive[:, self.core.node_indices()])
        return _SET_BITS[bits[..., None].view(np.uint8)].sum((0, -1), dtype=np.int64)

    @property
    def bond_state(self) -> dict[str, np.ndarray]:
        """What a checkpoint holds of the bonds: bits, kinds of tiles, and what has been added up of broken bonds and of
        work; they share memory.
        """
        bonds = (
            {"bonds": self.tables.bonds.alive, "kinds": self.tables.bonds.kinds, "broken": self.tables.bonds.broken}
            if self.has_bonds
            else {}
        )
        return bonds | ({"work": self.tables.work} if self.tables.work.size else {})

    @property
    def broken(self) -> tuple[float, int]:
        """Energy of the bonds when they broke, for a unit of mass a node, and their number."""
        energy, count = self.tables.bonds.broken.sum((0, 1))
        return float(energy) / self.stages.numbers[0][2], round(float(count))

    def book_cut(self, energy: float) -> None:
        """Add the energy, for a unit of mass a node, of bonds that were cut."""
        self.tables.bonds.broken[0, 0, 0] += energy * self.stages.numbers[0][2]

    @property
    def work(self) -> float:
        """Work of the sources, for a unit of mass a node."""
        return float(self.tables.work.sum())

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
            self.tables.sweep.block,
            *bounds,
            nodes,
            whole,
            self.components,
            self.tables.material,
            self.tables.bonds,
        )
        return float(total) / self.stages.numbers[0][2]

    def largest_strain(self) -> float:
        """Largest ``|xi + eta|^2 / |xi|^2 - 1`` (linearised: ``2 xi . eta / |xi|^2``) of the bonds that may break."""
        self.complete(self.current)
        return float(
            bond_laws.largest_strain(self.current, self.tables.sweep.block, self.components, self.tables.bonds)
        )

    def present_bonds(self, nodes: tuple[slice, ...]) -> np.ndarray:
        """Bits of the bonds that are there and carry something, of the nodes in a part of the core; shape (words,
        *part).
        """
        places = self.core.node_indices()[nodes]
        bits = self.tables.bonds.alive[:, places]
        for k, distance in enumerate(self.tables.bonds.places[:, 0] if self.varied else ()):
            idle = (self.bond_factors(places.ravel(), places.ravel() + distance) == 0).reshape(places.shape)
            bits[k >> 6, idle] &= ~(np.uint64(1) << np.uint64(k & 63))
        return bits

    @property
    def bond_limit(self) -> float:
        """Largest e of a bond that does not break, see `set_bonds`."""
        return float(self.tables.bonds.limit[0])

    def set_damping(self, nodes: np.ndarray, before: np.ndarray, after: np.ndarray, leak: np.ndarray) -> None:
        """Nodal factors of an absorbing zone: on the old increment, on the new increment, and a loss rate.

        Nodes whose new increment is taken whole stay where they are.
        """
        if nodes.size:
            found = self.tables.filter
            found.strengths[np.flatnonzero(np.isin(damped_nodes(found.runs), nodes[after == 0]))] = 0
        factors = (factor.astype(self.dtype) for factor in (before, after, leak))
        self._replace(damping=Damping(nodes.astype(np.int64), *factors))

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
        steps = np.zeros(self.layout.size, np.int64)
        self.core.view(steps)[...] = dissolved
        factors = (self.dtype.type(v) for v in (interface, saturation if limited else np.inf))
        coefficient = self.spread(np.where(solid, -interface, 1.0), beyond)
        self._replace(material=Material(coefficient, RULES.index("phases"), *factors))
        self._sweep_in_pieces(TILE_ROWS)
        solids, volumes = self.count_solid()
        period = np.array([n if a in self.layout.periodic else 0 for a, n in enumerate(self.layout.box.nodes)])
        self._replace(phases=phases_table(solids, volumes, steps, saturation, period))

    def count_solid(self) -> tuple[np.ndarray, np.ndarray]:
        """Solid nodes, and all nodes, of each tile and within one reach of it."""
        solid = self.layout.box.all(self.tables.material.coefficient) < 0
        return count_solid(solid, self.layout.reach, (1, TILE_ROWS, TILE))

    @property
    def dissolved(self) -> np.ndarray:
        """Step at which each node of the core became liquid, `NEVER` for solid ones, where there are phases; shares
        memory.
        """
        return self.core.view(self.tables.phases.dissolved)

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
        self._replace(ends=ends_table(nodes, first, sums, block))

    @property
    def ends(self) -> Ends:
        """The exact ends."""
        return self.tables.ends

    def set_history(self, history: np.ndarray) -> None:
        """Values of the exact ends' drivers so far, shape (ends, steps, K)."""
        self._replace(ends=self.tables.ends._replace(history=history))

    def _lengthen_history(self, steps: int) -> None:
        """Room for the values of the exact ends' drivers in some steps more."""
        ends = self.tables.ends
        count, length, reach = ends.history.shape
        if count and length < ends.clock[0] + steps:
            more = max(int(ends.clock[0]) + steps - length, min(length, 1 << 20), 256)
            history = np.concatenate([ends.history, np.zeros((count, more, reach))], axis=1)
            self._replace(ends=ends._replace(history=history))

    def set_tied(self, nodes: np.ndarray, starts: np.ndarray, sources: np.ndarray, weights: np.ndarray) -> None:
        """Nodes with prescribed values: node i is the sum of weights[k] times node sources[k], k from starts[i] to
        starts[i + 1], plus what `advance` is told. They are set in this order after each stage."""
        nodes, starts, sources = (a.astype(np.int64) for a in (nodes, starts, sources))
        self._replace(dependents=Dependents(nodes, starts, sources, weights.astype(self.dtype)))

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

        A step forgets the last row of `fringe_history`.
        """
        self._replace(fringe=fringe_table(nodes, levels, fronts, rows, starts, columns, weights, outside))

    @property
    def fringe_history(self) -> np.ndarray:
        """Values of the fringe's nodes one step ago, two and so on, shape (levels - 1, S); shares memory."""
        return self.tables.fringe.history.T

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
        near, rows = [np.zeros(0, np.int64)], []
        for (axis, _), (number, at) in (sides or {}).items():
            first = sum(map(len, near))
            rows.append((axis, number, first, first + len(at)))
            near.append(at)
        self._replace(
            flows=Flows(
                books.astype(np.int64),
                nodes.astype(np.int64),
                neighbours.astype(np.int64),
                weights.astype(float),
                effects.astype(float),
                ends,
                np.array(rows, np.int64).reshape(-1, 4),
                np.concatenate(near),
                np.zeros(self.layout.size if rows else 0, self.dtype),
                np.zeros((2, count)),
            )
        )

    @property
    def flows(self) -> np.ndarray:
        """Sums of what has flowed, and the rounding of them, shape (2, count)."""
        return self.tables.flows.totals

    def tie(self, values: np.ndarray) -> None:
        """Set the prescribed nodes of the current level; `values` has what is added to the combinations, one a
        prescribed node.
        """
        level, one = self.current, self.dtype.type(1)
        stage = Stage(level, level, level, 0, one, one, one, one, False, self.components)
        fields = np.asarray(values, self.dtype)[None]
        self._driver.depend(stage, self.tables.dependents, fields, np.ones(1, self.dtype))

    @property
    def varied(self) -> bool:
        """Whether bonds have factors of their own."""
        return self.tables.material.coefficient.size > 1

    def bond_factors(self, nodes: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
        """Factor of each bond from the coefficients of its ends (flat indices)."""
        if not self.varied:
            return np.ones(len(nodes))
        coefficient, rule = self.tables.material.coefficient, self.tables.material.rule
        mine, other = coefficient[nodes].astype(float), coefficient[neighbours].astype(float)
        if rule == PHASES:
            return np.maximum(np.maximum(mine, other), 0) * np.abs(np.minimum(mine, other))
        if rule == 0:
            return np.minimum(mine, other)
        total = mine + other
        return 0.5 * total if rule == 1 else 2 * mine * other / np.where(total > 0, total, 1.0)

    def lost(self, nodes: np.ndarray, neighbours: np.ndarray, weights: np.ndarray | float) -> np.ndarray:
        """What is absent of the `weights` of bonds of the core (places), whatever the coefficients."""
        cut_nodes, cut_neighbours, cut_weights = self.tables.cuts
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
        tables = self.tables
        rare = (tables.phases.runs, tables.bonds.places, tables.work, tables.ends.nodes, tables.fringe.nodes)
        return load_driver(any(table.size for table in rare))

    def _compiled(self, steps: int, phase: int, levels: np.ndarray, tables: Tables, inputs: Inputs) -> None:
        """Work off the table of operations, on all threads for those of the engine's own levels."""
        run = self._driver.run
        threads = self.threads if levels is self.levels else 1
        side_by_side(lambda thread: run(thread, steps, phase, levels, tables, inputs), threads)

    @property
    def current(self) -> np.ndarray:
        """The flat level that holds the state."""
        return self.levels[self.tables.rotation[self.phase, 0, 0]]

    @property
    def older(self) -> np.ndarray:
        """The level with the state one step ago, halos included (second-order integrators)."""
        rotation = self.tables.rotation[self.phase, 0]
        return self.levels[rotation[2 if self.stages.increments else 1]]

    def all_components(self, nodes: np.ndarray) -> np.ndarray:
        """Indices in a level of all components of nodes that are given by those of the first, component by
        component."""
        return (nodes.ravel() + self.layout.size * np.arange(self.components)[:, None]).ravel()

    def complete(self, level: np.ndarray) -> None:
        """Fill the halo of a level across periodic axes."""
        self._driver.copy(level, self.tables.copies, self.components)

    def remind(self, level: np.ndarray) -> None:
        """The layers' memory goes through one step in which the field is `level`."""
        self._operate(level, operator_operations(self.tables), self.memory)

    def apply(self, level: np.ndarray) -> np.ndarray:
        """The operator L on a level, as a level (its nodes only are meaningful); fills the halo of `level`."""
        return self._operate(level, operator_operations(self.tables), self.memory.copy())

    def apply_core(self, level: np.ndarray) -> np.ndarray:
        """The operator L on a level with whatever its halo holds, with plain shifts everywhere."""
        return self._operate(level, sweep_operations(self.tables), self.memory)

    def _operate(self, level: np.ndarray, operations: list[tuple[int, int]], memory: np.ndarray) -> np.ndarray:
        """What some operations make of a level, without the rest of a stage, as a level: of bonds none breaks."""
        scale = self.stages.numbers[0][2]  # the last stage may be without operator
        levels = np.stack([level, np.zeros_like(level), np.zeros_like(level)])
        tables = self.tables._replace(
            operations=np.array(operations, np.int64).reshape(-1, 2),
            starts=np.array([0, len(operations)]),
            rotation=np.arange(3).reshape(1, 1, 3),
            numbers=np.array([self._numbers_of(float(self.stages.increments), 0.0, scale, 0.0)], self.dtype),
            layers=self.tables.layers._replace(memory=memory),
            bonds=self.tables.bonds._replace(limit=np.array([np.inf, np.inf], self.dtype)),
        )
        self.loop(1, 0, levels, tables, self._no_inputs(1))
        level[:] = levels[0]
        return levels[1 if self.stages.increments else 2] / tables.numbers[0, 3]

    def _no_inputs(self, steps: int) -> Inputs:
        """Nothing from outside for some steps; prescribed values are zero."""
        none, times = np.zeros(0, np.int64), np.zeros((steps, len(self.stages.numbers), 0), self.dtype)
        return Inputs(
            self.steps_done,
            none,
            np.zeros((0, 0), self.dtype),
            times,
            self.held,
            np.zeros((steps, len(self.held))),
            np.zeros((0, len(self.tables.dependents.nodes)), self.dtype),
            times,
            self.watched,
            np.zeros((steps, self.watched.size)),
        )

    def _sweep_in_pieces(self, rows: int) -> None:
        """From now on sweep whole multiples of some rows at a time."""
        sweep = self.tables.sweep
        self._replace(sweep=sweep._replace(depth=-(-sweep.depth // rows) * rows))

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
        nothing = self._no_inputs(steps)
        self.seen = nothing.seen
        inputs = nothing._replace(source_nodes=source_nodes, source_fields=source_fields, source_times=source_times)
        if held_values is not None:
            inputs = inputs._replace(held_values=np.asarray(held_values, float))
        if tied_fields is not None and tied_times is not None:
            times = np.ascontiguousarray(tied_times)
            inputs = inputs._replace(dependent_fields=tied_fields, dependent_times=times)
        self._check_room(steps, inputs)
        tables = self.tables
        operations, starts = operations_of(tables, inputs)
        tables = tables._replace(operations=operations, starts=starts)
        self.loop(steps, self.phase, self.levels, tables, inputs)
        self.phase = (self.phase + steps) % len(tables.rotation)
        self.steps_done += steps

    def _check_room(self, steps: int, inputs: Inputs) -> None:
        """Every table that the compiled loop indexes by step and stage is large enough; exact ends count their clock
        once a stage.
        """
        stages, ends, dependents = len(self.stages.numbers), self.tables.ends, len(self.tables.dependents.nodes)
        clock = int(ends.clock[0]) + steps * stages if len(ends.history) else 0
        fields, sums = inputs.source_fields, inputs.dependent_fields
        for name, shape, least in (
            ("history", ends.history.shape[1:2], (clock,)),
            ("source_times", inputs.source_times.shape, (steps, stages, len(fields))),
            ("source_fields", fields.shape[1:], (len(inputs.source_nodes) if len(fields) else 0,)),
            ("held_values", inputs.held_values.shape, (steps if len(self.held) else 0, len(self.held))),
            ("dependent_times", inputs.dependent_times.shape, (steps, stages, len(sums))),
            ("dependent_fields", sums.shape[1:], (dependents,)),
        ):
            if len(shape) != len(least) or any(have < want for have, want in zip(shape, least, strict=True)):
                raise IndexError(
                    f"the table {name} of the compiled loop has the shape {shape}, less than {least} for {steps} steps"
                )

    def digest(self) -> str:
        """Hash of all that decides the map of a step: engines of one digest have one map."""
        rule = self.tables.material.rule
        mark = hashlib.sha256(
            repr(
                (
                    self.dt,
                    self.stages,
                    self.reaction,
                    self.core.nodes,
                    sorted(self.layout.periodic),
                    rule,
                    self.dtype.name,
                )
            ).encode()
        )
        layers = [
            a
            for _, layer in sorted(self.layers.items())
            for a in (layer.kappa, layer.sigma, layer.alpha, layer.damping, layer.taps)
        ]
        mark.update(repr([(name, layer.columns, layer.whole) for name, layer in sorted(self.layers.items())]).encode())
        tables = self.tables
        ends, fringe = tables.ends, tables.fringe._replace(history=np.zeros(0))
        for array in (
            self.offsets,
            self.weights,
            *layers,
            tables.material.coefficient,
            *tables.cuts,
            *tables.surface,
            *tables.damping,
            *tables.dependents,
            self.held,
            *(ends.nodes, ends.poles, ends.inputs, ends.outputs),
            *fringe,
        ):
            mark.update(np.ascontiguousarray(array).tobytes())
        return mark.hexdigest()

    @contextmanager
    def as_before(self) -> Iterator[None]:
        """Whatever runs inside leaves no trace."""
        tables = self.tables
        ends, phases = tables.ends, tables.phases
        arrays = [
            self.levels,
            self.memory,
            *(ends.states, ends.forces, ends.clock),
            tables.flows.totals,
            tables.fringe.history,
            tables.material.coefficient,
            *(phases.runs, phases.solids, phases.volumes, phases.changed, phases.dissolved, phases.total),
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
        inputs = self._no_inputs(steps)
        self.advance(steps, inputs.source_nodes, inputs.source_fields, inputs.source_times)

    @property
    def layer_memory(self) -> list[tuple[tuple[int, int], np.ndarray]]:
        """Places of the memory that is ever used: (axis, side) of a layer, and an array by component, number, and line;
        see `LayerTables.cells`.
        """
        return self._layer_tables.cells(self.tables.layers.f != 0) if self.remember else []

    @property
    def nbytes(self) -> int:
        """Bytes of all time levels, slots, layer memory, phases, exact ends, fringes, the filter and absent bonds."""
        tables = self.tables
        parts = (tables.ends, tables.phases, tables.bonds, tables.fringe, tables.filter, tables.cuts, tables.surface)
        held = (self.levels, tables.layers.slots, self.memory, tables.material.coefficient)
        return sum(np.asarray(a).nbytes for part in (held, *parts) for a in part)

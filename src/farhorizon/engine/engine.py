"""The engine: the compiled time loop behind an interface of plain arrays."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator, Mapping, Set
from contextlib import contextmanager
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any, Literal, TypeVar

import numpy as np

from farhorizon import kinds
from farhorizon.engine import program
from farhorizon.engine.bond_zone import BondZone
from farhorizon.engine.bonds import RULES, Zone, factors_of
from farhorizon.engine.codegen.matrices import Signs, signs_of
from farhorizon.engine.derivative_pml import DerivativePML
from farhorizon.engine.exchange import LEVEL, Exchange
from farhorizon.engine.features.dampers import DamperTables
from farhorizon.engine.features.ends import lengthen_history
from farhorizon.engine.features.phases import NEVER
from farhorizon.engine.field import numbers_of
from farhorizon.engine.first_tables import first_tables
from farhorizon.engine.layer_operators import LayerOperator, drag_pass, heat_passes
from farhorizon.engine.layer_tables import LayerSetup, LayerTables
from farhorizon.engine.layers import Layers
from farhorizon.engine.layout import SLACK, Layout, aligned, aligned_zeros
from farhorizon.engine.loop import CompiledLoop
from farhorizon.engine.media import media_of
from farhorizon.engine.missing_bonds import AbsentBonds
from farhorizon.engine.operations import (
    asked_by,
    beginning_operations,
    check_room,
    once,
    operations_of,
    operator_operations,
    sweep_operations,
    with_histories_at_rest,
    without_contact,
    without_heat,
)
from farhorizon.engine.passes import FURTHER_PASSES, SEND, Operation
from farhorizon.engine.tables import Asked, Inputs, Tables
from farhorizon.engine.two_pass import StateSums, TwoPassOperator
from farhorizon.files.storable import Storable

__all__ = ["NEVER", "Engine", "Layer", "Layout", "Zone", "available_threads"]

Kept = TypeVar("Kept", Layers, DerivativePML)
# Values of the field plus a quarter of the layers' memory; with fewer, one thread is done before a second has started.
_PARALLEL_NUMBERS = 40_000
# Where an engine has the arrays that `Engine.get` names otherwise than its tables do.
_PATHS = {
    "u": "current",  # the field now, one step ago, and two steps ago (of schemes that keep that)
    "u_old": "older",
    "u_older": "oldest",
    "exists": "absent.exists",  # whether there is a node at a place
    **{name: name for name in ("increment", "levels", "memory", "node_values", "block_values")},
    **{name: name for name in ("held_forces", "impactor_values")},
}
_ARRAYS = {name: attrgetter(path) for name, path in _PATHS.items()}


#: Does a number of steps, from a phase of the rotation of the levels on, by the tables of operations.
Loop = Callable[[int, int, np.ndarray, Tables, Inputs], None]
#: Returns such a loop for an engine that is set up, and whose layers remember nothing.
BackEnd = Callable[["Engine"], Loop]


@dataclass(frozen=True)
class Layer(Storable):
    """Coefficients of an absorbing layer, from the near field outwards."""

    kappa: np.ndarray  # stretch ``kappa + sigma / (s + alpha)`` on the edges between columns, shape (columns + 1,)
    sigma: np.ndarray
    alpha: np.ndarray
    # Rate at which each column loses the short waves that pass `taps`, a high-pass filter along one axis (see
    # `engine.features.filter`); shape (columns,), or empty.
    damping: np.ndarray = field(default_factory=lambda: np.zeros(0))
    taps: np.ndarray = field(default_factory=lambda: np.zeros(1))
    whole: bool = False  # whether short waves themselves are damped, and not only their increments
    # Steps between applications of the filter, each of which damps by as much as is due for all of them; 0 leaves the
    # choice to the run.
    every: int = 0
    short: bool = False  # whether six digits are enough for this layer's memory; used only if enough for all layers
    # Angular frequency of tuned dampers and the width of their band, or empty. If given, `damping` is the rate of these
    # dampers instead of that of the filter, see `engine.features.dampers`.
    tuned: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        for name in ("kappa", "sigma", "alpha", "damping", "taps", "tuned"):  # short arrays are lists in a checkpoint
            object.__setattr__(self, name, np.asarray(getattr(self, name), float))

    @property
    def filtered(self) -> bool:
        """Whether the layer damps short waves by a filter."""
        return bool(self.damping.size and not self.tuned.size)

    @property
    def columns(self) -> int:
        """Number of nodes of the layer along its normal."""
        return len(self.kappa) - 1

    def recursion(self, dt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Coefficients r, e and f of the trapezoidal rule: ``far = near + r d - N``, ``N <- e N + f d``."""
        a, b = self.sigma * dt / 2, self.alpha * dt / 2
        new, old = (1 + b) * (1 + self.kappa) + a, (1 - b) * (1 + self.kappa) - a
        r = ((1 + b) * (self.kappa - 1) + a) / new
        return r, old / new, ((1 - b) * (self.kappa - 1) - a - old * r) / new


def available_threads() -> int:
    """Number of threads that the machine, Numba (NUMBA_NUM_THREADS) and `at_most` allow this process."""
    import numba

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(cores, int(getattr(numba.config, "NUMBA_NUM_THREADS", cores)), *_allowed)


_allowed: list[int] = []


@contextmanager
def at_most(threads: int | None) -> Iterator[None]:
    """Limit the number of threads of the whole process while the context is active; None sets no limit.

    Raises
    ------
    InputError
        If `threads` is less than one, or exceeds the number available.
    """
    allowed = [] if threads is None else [kinds.integer(threads, "threads", least=1, most=available_threads())]
    _allowed.extend(allowed)
    try:
        yield
    finally:
        for _ in allowed:
            _allowed.pop()


class Engine:
    """Time levels of a scalar or vector field, and the compiled loop that advances them.

    Parameters
    ----------
    core : tuple of int
        Nodes of the core along three axes (leading axes have one node in 1D and 2D).
    offsets, weights : ndarray, shapes (K, 3) and (K,), or (K, d, d)
        Stencil in units of the operator (1/time or 1/time^2). Matrices act on fields of d components (2 or 3), which
        belong to the last d axes.
    stages : Stages
        Integrator (see `farhorizon.medium.integrators`).
    dt : float
    layers : mapping of (axis, side) to Layer
    periodic : set of int
    real : {"float64", "float32"}
    threads : int
    coefficient : ndarray, shape `core`, optional
        Factors of the bonds, combined from both ends by `rule`.
    reaction : float or ndarray, shape (d, d)
        Coefficient of each node's own value, which the operator subtracts whatever the coefficient, in its units.
    signs : Signs, optional
        Whether each component changes its sign under mirroring of each of the three axes; by default those of a vector.
    sums : StateSums, optional
        Two passes in addition to the stencil, on its offsets; coefficients are those of the stencil's own bonds.
    heat : ndarray, shape (K, d), optional
        Forces of the stencil's own bonds per unit of thermal strain, in units of the operator; given if heat passes
        through the layers.
    dragged : bool
        Whether drag towards the mean velocity of the neighbours is going to be set (`settings.set_drag`).
    mechanisms : int
        Number of those that are going to be set by `settings.set_relaxations`; their memory are further levels.
    dashpots : bool
        Whether the dashpots of these mechanisms are going to be followed (`settings.set_dissipation`), on as many more.
    """

    tables: Tables  # of the compiled loop; functions of `engine.settings` and of features replace them
    heat_passes: tuple[LayerOperator, ...]  # thermal forces and traces, if heat passes through the layers
    layers_of_passes: list[LayerTables | None]  # by the number of the pass; None for passes that do not exist
    all_layers: list[LayerTables]  # of the passes that exist
    memory: np.ndarray  # of the layers, of the type `kept`: that of the field, or the first halves of its values
    bonds: BondZone  # bonds that have a law of their own
    loop: Loop | None  # executes the operations in place of the compiled loop; keeps the layers' memory to itself
    # Values at the places of `record_nodes` and sums of `settings.record_blocks`, shapes (steps, n) and (steps, R),
    # after each step of an `advance`, valid until the next one; only rows whose step is a multiple of `watch_stride`.
    node_values: np.ndarray
    block_values: np.ndarray
    watch_stride: int
    held_forces: np.ndarray  # forces that held the prescribed nodes in each step, as in `Inputs`, if `forces_wanted`
    impactor_values: np.ndarray  # what rigid shapes did in each step, likewise, if `impactors_recorded`

    def __init__(
        self,
        core: tuple[int, int, int],
        offsets: np.ndarray,
        weights: np.ndarray,
        stages: Any,
        dt: float,
        *,
        layers: Mapping[tuple[int, int], Layer],
        periodic: Set[int] = frozenset(),
        real: str = "float64",
        threads: int = 1,
        coefficient: np.ndarray | None = None,
        rule: str = "both",
        reaction: float | np.ndarray = 0.0,
        signs: Signs | None = None,
        sums: StateSums | None = None,
        heat: np.ndarray | None = None,
        dragged: bool = False,
        mechanisms: int = 0,
        dashpots: bool = False,
    ) -> None:
        self.dtype = np.dtype(real)
        self.stages, self.dt, self.reaction = stages, dt, reaction
        self.offsets, self.weights = np.asarray(offsets, np.int64), np.asarray(weights, float)
        self.components = 1 if self.weights.ndim == 1 else self.weights.shape[1]
        self.layers = dict(layers)
        plain = sums is None or sums.phi is None  # memory of stretched derivatives is separate, unrounded
        halves = self.dtype.itemsize == 8 and plain and layers and all(layer.short for layer in layers.values())
        self.kept = np.dtype("int32") if halves else self.dtype
        columns = {name: layer.columns for name, layer in self.layers.items()}
        axes = frozenset(periodic)
        self.layout = Layout(core, self.offsets, columns, axes, self.components, self.dtype.itemsize)
        self.core = self.layout.near
        self.remember = any(np.any(layer.sigma) for layer in self.layers.values())
        recursion = {name: layer.recursion(dt) for name, layer in self.layers.items()}
        self.signs = signs = signs_of(self.components) if signs is None else signs
        alike = coefficient is None
        of_values = self.dtype, self.kept, self.remember
        self.layer_setup = LayerSetup(self.layout, self.offsets, recursion, *of_values, len(stages.numbers))
        matrices = self.weights.reshape(len(self.weights), self.components, self.components)
        springs = self.layer_setup if self.weights.any() else self.layer_setup._replace(recursion={})  # of two passes
        self.layer_tables = LayerTables(springs, matrices, signs, signs, alike)
        self.passes = None if sums is None else TwoPassOperator(self, sums)
        self.heat_vectors = np.zeros((0, 0)) if heat is None else heat
        self.heat_passes = () if heat is None else heat_passes(self.layer_setup, heat, alike)
        self.drag_pass = drag_pass(self.layer_setup, signs) if dragged else None
        self.layers_of_passes = [
            self.layer_tables,
            *((None, None) if self.passes is None else self.passes.layer_tables),
            *([heat_pass.layer_tables for heat_pass in self.heat_passes] or (None, None)),
            None if self.drag_pass is None else self.drag_pass.layer_tables,
        ]
        self.all_layers = [tables for tables in self.layers_of_passes if tables is not None]
        self.dampers = DamperTables(self.layout, self.layers, dt)
        self.memory = self._allocate_memory()
        self.levels = aligned_zeros(
            self.components * self.layout.size, self.dtype, stages.levels + mechanisms * (1 + dashpots)
        )
        memory = self.memory.size // 4 if self.remember else 0
        numbers = self.components * int(np.prod(core)) + memory
        self.threads = threads if numbers >= _PARALLEL_NUMBERS else 1
        self.phase, self.steps_done = 0, 0
        self.tables = first_tables(self, coefficient is not None, RULES.index(rule))
        if coefficient is not None:
            self.replace(material=self.tables.material._replace(coefficient=self.spread(coefficient)))
            self.replace(media=media_of(self))
        self.bonds = BondZone(self)
        self.exchange: Exchange | None = None
        self.absent = AbsentBonds(self, self.bonds)
        self.hold(np.zeros(0, np.int64))
        self.node_values, self.block_values = np.zeros((0, 0)), np.zeros((0, 0))
        self.held_forces, self.impactor_values = np.zeros((0, 0)), np.zeros((0, 0, 0))
        self.record_nodes(np.zeros(0, np.int64))
        self._call_cache = CallCache()
        self._compiled_loop = CompiledLoop()
        self._prepared: dict[tuple[Any, ...], _Prepared] = {}
        self.loop = None

    def in_a_line(self, side: int) -> int:
        """Number of values that the layers at one side of the last axis have beside each of its lines, for exchange."""
        return sum(tables.in_a_line(side) for tables in self.all_layers)

    def _allocate_memory(self) -> np.ndarray:
        """Allocate the memory of the layers of all passes as one array, and return it."""
        starts = np.cumsum([0, *(aligned(tables.layers.memory.size) for tables in self.all_layers)])
        stretched = 0 if self.passes is None else self.passes.stretches.memory.size
        hanging = 3 * self.components * self.dampers.size
        end = int(starts[-1]) if stretched or hanging else int(starts[-2]) + self.all_layers[-1].layers.memory.size
        self.dampers.start = aligned(end + stretched) if hanging else 0
        memory = aligned_zeros(self.dampers.start + hanging + SLACK if hanging else end + stretched, self.kept)
        for start, tables in zip(starts[:-1], self.all_layers, strict=True):
            tables.start = int(start)
            tables.layers = _remembering(tables.layers, memory, tables.start)
        if self.passes is not None and stretched:
            self.passes.start = end
            self.passes.stretches = _remembering(self.passes.stretches, memory, end)
        return memory

    def spread(
        self, core: np.ndarray, beyond: Mapping[tuple[int, int], float] | None = None, jointly: bool = False
    ) -> np.ndarray:
        """Extend nodal values of the core to all places of a level, constant along each normal beyond the core's edge,
        except where `beyond` gives the value beyond a side (axis, side). If `jointly`, all processes that exchange
        halos call this together, and each gives the others the values beyond their sides.
        """
        layout, padded = self.layout, np.asarray(core, float)
        for axis, m in enumerate(layout.reach):
            mode: Literal["wrap", "edge"] = "wrap" if axis in layout.periodic else "edge"
            widths = layout.low[axis] + m, layout.high[axis] + m
            margins = [widths if a == axis else (0, 0) for a in range(3)]
            padded = np.pad(padded, margins, mode=mode)
            for side, width in zip((-1, 1), widths, strict=True):
                if beyond is not None and (axis, side) in beyond:
                    strip = slice(0, width) if side < 0 else slice(padded.shape[axis] - width, None)
                    padded[tuple(strip if a == axis else slice(None) for a in range(3))] = beyond[axis, side]
        values = np.zeros(layout.size, self.dtype)
        layout.box.all(values)[...] = padded
        if jointly:
            self.join(values, beyond or {})
        return values

    def join(self, values: np.ndarray, beyond: Mapping[tuple[int, int], float]) -> None:
        """Fill the halo of nodal values from other processes, all of which must call this. Beyond sides that no process
        fills the values continue as in `spread`, also in the halos of the other processes.
        """
        if self.exchange is None:
            return
        self.exchange.fill(values, 1)
        reach, mask = self.layout.reach, np.zeros(self.layout.size, bool)
        mask[self.exchange.filled] = True
        padded, filled = self.layout.box.all(values), self.layout.box.all(mask)
        inside = tuple(slice(m, n - m) for m, n in zip(reach, padded.shape, strict=True))
        for axis, side in itertools.product(range(3), (-1, 1)):
            m, n = reach[axis], padded.shape[axis] - 2 * reach[axis]
            halo, edge = (slice(0, m), m) if side < 0 else (slice(m + n, None), m + n - 1)
            along = np.moveaxis(padded, axis, 0)
            if filled[tuple(halo if a == axis else part for a, part in enumerate(inside))].any():
                continue
            if axis in self.layout.periodic:
                along[halo] = along[n : n + m] if side < 0 else along[m : 2 * m]
            else:
                along[halo] = beyond.get((axis, side), along[edge])

    def replace(self, **tables: Any) -> None:
        """Replace some of the tables."""
        self.tables = self.tables.replaced(**tables)

    # --- values by name: all that code outside this package reads and writes of levels and tables -------------------

    def get(self, name: str, at: Any = ...) -> np.ndarray:
        """Return values, or those at an index: of a level ("u", "u_old"; see `_PATHS`) or of a field of the tables
        ("heat.thermal_strain"). They may not be changed, and are valid until the next step.
        """
        values: np.ndarray = self.array(name)[at]
        values.flags.writeable = False
        return values

    def put(self, name: str, values: Any, at: Any = ...) -> None:
        """Set values by name, as `get` returns them."""
        self.array(name)[at] = values

    def add(self, name: str, values: Any, at: Any = ...) -> None:
        """Add to values by name, as `get` returns them."""
        self.array(name)[at] += values

    def array(self, name: str) -> np.ndarray:
        """The array that `get` names."""
        return _ARRAYS[name](self) if name in _ARRAYS else attrgetter(name)(self.tables)

    def level(self) -> np.ndarray:
        """Return a level of zeros."""
        return np.zeros_like(self.levels[0])

    @property
    def clock(self) -> tuple[int, int]:
        """Steps done, and the phase of the rotation of the levels."""
        return self.steps_done, self.phase

    @clock.setter
    def clock(self, steps_and_phase: tuple[int, int]) -> None:
        self.steps_done, self.phase = steps_and_phase

    @property
    def every(self) -> int:
        """Steps between filters of short waves in the layers: only the map of that many steps is always the same."""
        return int(self.tables.filter.every)

    @property
    def size(self) -> int:
        """Number of nodes of the core and the layers."""
        return int(np.prod(self.layout.box.nodes))

    # --- parts that may be set after construction --------------------------------------------------------------

    @property
    def mobility(self) -> np.ndarray:
        """Acceleration by a given force relative to a node of the medium, by place; one value without densities."""
        mobility = self.tables.mobility
        return np.tile(mobility, self.components) if mobility.size else np.ones(1, self.dtype)

    def hold(self, nodes: np.ndarray) -> None:
        """Set the nodes with prescribed values, which are those of the columns of `held_values` in `advance`."""
        self.held = nodes.astype(np.int64)

    def record_nodes(self, places: np.ndarray, stride: int = 1, forces: bool = False, impactors: bool = False) -> None:
        """Record the values at places of a level, shape (n,), in `node_values` after every step from now on, or where
        nobody needs others, steps whose number is a multiple of `stride`; also, if wanted, the forces that hold
        prescribed nodes, and what impactors do.
        """
        self.watch_stride, self.forces_wanted, self.impactors_recorded = stride, forces, impactors
        first = np.flatnonzero(np.diff(places, prepend=-2) != 1)  # places that do not directly follow the one before
        runs = places[first] % self.layout.size, places[first], first, np.diff(first, append=len(places))
        self._watched = np.stack(runs, axis=-1)[np.argsort(runs[0], kind="stable")]

    def factors(self, nodes: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
        """Return the factors of the bonds between places."""
        return factors_of(self.tables.material, nodes, neighbours)

    @property
    def varied(self) -> bool:
        """Whether bonds have individual factors."""
        return self.tables.material.coefficient.size > 1

    # --- the work ----------------------------------------------------------------------------------------------

    @property
    def current(self) -> np.ndarray:
        """Flat level that holds the present state."""
        return self.levels[self.tables.rotation[self.phase, 0, 0]]

    @property
    def older(self) -> np.ndarray:
        """Level with the state one step ago, halos included (second-order integrators)."""
        rotation = self.tables.rotation[self.phase, 0]
        return self.levels[rotation[2 if self.stages.increments else 1]]

    @property
    def oldest(self) -> np.ndarray:
        """Level with the state two steps ago, of velocity Verlet whose older level outlives a step."""
        return self.levels[self.tables.rotation[self.phase, 0, 2]]

    @property
    def increment(self) -> np.ndarray:
        """Level with the increment of the last step, of integrators that advance it."""
        return self.levels[2]

    def all_components(self, nodes: np.ndarray) -> np.ndarray:
        """Indices in a level of all components of nodes, component by component, from those of the first component."""
        return (nodes.ravel() + self.layout.size * np.arange(self.components)[:, None]).ravel()

    def complete(self, level: np.ndarray | str) -> None:
        """Fill the halo of a level, or of levels given by name, across periodic axes and from other processes."""
        levels = self.array(level) if isinstance(level, str) else level
        for each in levels.reshape(-1, self.levels.shape[1]):
            if self.exchange is not None:
                self.exchange.fill(each, self.components)
            else:
                program.copy(each, self.tables.copies, self.components)

    def begin(self, level: np.ndarray | str) -> None:
        """Initialise the memory of stretched derivatives so that it is zero in the state `level`."""
        if self.tables.stretches.runs.size:
            self.operate(level, beginning_operations(self.tables))

    def apply(self, level: np.ndarray | str) -> np.ndarray:
        """Apply the operator L to a level, and return a level (valid at its nodes only); fills the halo of `level`."""
        return self.operate(level, operator_operations(self.tables), keep_memory=True)

    def apply_core(self, level: np.ndarray, again: bool = False) -> np.ndarray:
        """Apply the operator L to a level with plain shifts everywhere, using its halo as it is, without thermal
        strains and, in state-based media, without contact of absent bonds; `again` as in `operate`.
        """
        return self.operate(level, sweep_operations(self.tables), thermal=False, contact=False, again=again)

    def forces_of_heat(self) -> tuple[np.ndarray, np.ndarray]:
        """Thermal forces on undisplaced nodes in a state-based medium, as a level, and four times the energy of each
        place, per unit mass of a node.
        """
        assert self.passes is not None
        forces = self.operate(np.zeros_like(self.current), sweep_operations(self.tables), contact=False)
        return forces, 4 * self.passes.energy_of_heat()

    def operate(
        self,
        level: np.ndarray | str,
        operations: list[Operation],
        keep_memory: bool = False,
        thermal: bool = True,
        contact: bool = True,
        again: bool = False,
    ) -> np.ndarray:
        """Apply some operations to a level outside the time loop, and return the result as a level; no bond breaks.

        The memory of the layers may be left unchanged, thermal strains left out, and so may the compression that absent
        bonds of a state-based medium carry. The prepared tables are kept if the same operations are going to be applied
        `again`.
        """
        level = self.array(level) if isinstance(level, str) else level
        key = (keep_memory, thermal, contact, *operations)
        prepared = self._prepared.get(key) if again else None
        if prepared is None or prepared.of is not self.tables:
            prepared = _Prepared(self, operations, keep_memory, thermal, contact)
            if again:
                self._prepared[key] = prepared
        return prepared(level)

    def _no_inputs(self, steps: int) -> Inputs:
        """Return inputs without sources for a number of steps; prescribed values are zero."""
        inputs = self._call_cache.zero_inputs(steps, self.tables, self.held, self._watched, self.watch_stride)
        inputs.before[0] = self.steps_done
        return inputs

    def sweep_in_pieces(self, rows: int) -> None:
        """Sweep whole multiples of a number of rows at a time from now on."""
        sweep = self.tables.sweep
        self.replace(sweep=sweep._replace(depth=-(-sweep.depth // rows) * rows))
        self.replace(media=media_of(self))

    def advance(
        self,
        steps: int,
        source_nodes: np.ndarray | None = None,
        source_fields: np.ndarray | None = None,
        source_times: np.ndarray | None = None,
        held_values: np.ndarray | None = None,
        dependent_fields: np.ndarray | None = None,
        dependent_times: np.ndarray | None = None,
        impactor_paths: np.ndarray | None = None,
    ) -> None:
        """Run steps without returning to Python; sources, held and dependent values are those of `Inputs`, or else none
        and zero. If the shape of one does not match the steps, this raises an IndexError in place of running the loop,
        which checks no bounds.
        """
        lengthen_history(self, steps)
        inputs, given = self._no_inputs(steps), dict[str, Any]()
        self.node_values, self.block_values = inputs.node_values, inputs.block_values
        if source_nodes is not None:
            given |= {"source_nodes": source_nodes, "source_fields": source_fields, "source_times": source_times}
        if held_values is not None:
            given["held_values"] = np.asarray(held_values, float)
        if self.forces_wanted:
            given["held_forces"] = self.held_forces = np.zeros((steps, len(self.held)))
        if dependent_fields is not None and dependent_times is not None:
            given |= {"dependent_fields": dependent_fields, "dependent_times": np.ascontiguousarray(dependent_times)}
        if impactor_paths is not None:
            given["impactor_paths"] = np.asarray(impactor_paths, float)
            if self.impactors_recorded:
                shapes, components = impactor_paths.shape[1:]
                given["impactor_values"] = self.impactor_values = np.zeros((steps, shapes, 3 * components + 1))
        if given or len(self.tables.ends.history):
            inputs = inputs._replace(**given)
            check_room(self.tables, inputs, steps)
        if self.exchange is not None:
            self.exchange.agree((steps,))
        tables = self._call_cache.planned(self.tables, inputs)
        if self.loop is None:
            self._compiled_loop(steps, self.phase, self.levels, tables, inputs, self.threads)
        else:
            self.loop(steps, self.phase, self.levels, tables, inputs)
        self.phase = (self.phase + steps) % len(tables.rotation)
        self.steps_done += steps

    def remembered(self) -> Iterator[tuple[str, np.ndarray, tuple[int, ...]]]:
        """Yield the parts of the memory: name, places, and the axes of the box that the last axes of the places belong
        to; see `LayerTables.lines`.
        """
        for number, tables in enumerate(self.all_layers if self.remember else ()):
            for name, places, axes in tables.lines():
                yield f"memory/{number}/{name}", tables.start + places, axes
        for name, places, axes in self.dampers.lines():
            yield f"memory/dampers/{name}", places, axes

    @property
    def layer_memory(self) -> list[tuple[int, tuple[int, int], np.ndarray, Signs]]:
        """Places of the memory that the forces of the displacements use: for each pass and layer its number, (axis,
        side), an array by component, number, and line, and the signs of the components; see `LayerTables.cells`.
        """
        of_heat = [heat_pass.layer_tables for heat_pass in self.heat_passes]
        of_the_solid = [tables for tables in self.all_layers if tables not in of_heat]
        of_layers = [
            (number + stage * (len(self.all_layers) + 1), key, tables.start + start + cells, signs)
            for number, tables in enumerate(of_the_solid if self.remember else ())
            for stage, start in enumerate(tables.starts)
            for key, cells, signs in tables.cells(tables.layers.f != 0)
        ]
        return of_layers + [(len(self.all_layers), key, cells, self.signs) for key, cells in self.dampers.cells()]

    @property
    def nbytes(self) -> int:
        """Bytes of all time levels, slots, layer memory, phases, exact ends, fringes, the filter and absent bonds."""
        tables = self.tables
        parts = (tables.ends, tables.phases, tables.bonds, tables.outline_stencil, tables.filter)
        absent = (tables.cuts, tables.surface)
        states = tables.gradient_pass.sweep.law.values
        stretched = tables.stretches.keep, tables.stretches.gain, tables.stretches.own
        drag = tables.drag.moved, tables.drag.beyond
        arrays = (self.levels, tables.layers.slots, self.memory, tables.material.coefficient, states, *stretched, *drag)
        return sum(np.asarray(a).nbytes for part in (arrays, *parts, *absent) for a in part)


class _Prepared:
    """Prepared operations of `Engine.operate`, applicable to any level as long as the engine's tables stay the same."""

    def __init__(
        self,
        engine: Engine,
        operations: list[Operation],
        keep_memory: bool = False,
        thermal: bool = True,
        contact: bool = True,
    ) -> None:
        self.engine, self.of, self.keep_memory = engine, engine.tables, keep_memory
        scale = engine.stages.numbers[0][2]  # the last stage may not apply the operator
        numbers = np.array([numbers_of(engine, float(engine.stages.increments), 0.0, scale, 0.0)], engine.dtype)
        tables = once(with_histories_at_rest(engine.tables), operations, numbers)
        if not thermal:
            tables = without_heat(tables)
        if not contact:
            tables = without_contact(tables)
        self.memory = engine.memory.copy() if keep_memory else engine.memory
        self.tables = self._with_own_memory(tables) if keep_memory else tables
        self.levels = np.zeros((3, engine.levels.shape[1]), engine.dtype)
        self.loop = CompiledLoop(engine._compiled_loop)
        # all processes have messages of levels; those of layers only where there are some
        self.together = any(operation == SEND and number // 3 == LEVEL for operation, number, _ in operations)

    def __call__(self, level: np.ndarray) -> np.ndarray:
        """Apply the operations to a level, whose halo is filled, and return the result as a level."""
        engine, levels = self.engine, self.levels
        if self.together and engine.exchange is not None:
            engine.exchange.agree((1,))
        if self.keep_memory:
            self.memory[:] = engine.memory
        levels[0], levels[1:] = level, 0
        if engine.loop is None:
            self.loop(1, 0, levels, self.tables, engine._no_inputs(1), 1)
        else:
            engine.loop(1, 0, levels, self.tables, engine._no_inputs(1))
        level[:] = levels[0]
        return np.asarray(levels[1 if engine.stages.increments else 2] / self.tables.numbers[0, 3])

    def _with_own_memory(self, tables: Tables) -> Tables:
        """Return tables whose layers use a memory separate from the engine's."""
        engine, memory = self.engine, self.memory
        _, *further = engine.layers_of_passes
        changed: dict[str, Any] = {"layers": _remembering(tables.layers, memory, engine.layer_tables.start)}
        for name, layers in zip(FURTHER_PASSES, further, strict=True):
            if layers is not None:
                sums = getattr(tables, name)
                changed[name] = sums._replace(layers=_remembering(sums.layers, memory, layers.start))
        if engine.passes is not None:
            changed["stretches"] = _remembering(tables.stretches, memory, engine.passes.start)
        return tables.replaced(**changed)


def _remembering(layers: Kept, memory: np.ndarray, start: int) -> Kept:
    """Return the same layers with the part of another memory that begins at `start`."""
    return layers._replace(memory=memory[start : start + layers.memory.size])


class CallCache:
    """Keeps inputs and tables for the next call, which usually needs the same ones: certificates call the loop tens of
    thousands of times, for one step without any inputs each.
    """

    def __init__(self) -> None:
        self._room: dict[str, np.ndarray] = {}
        self._zero_inputs: tuple[tuple[Any, ...], Inputs] | None = None
        self._planned: tuple[Tables, Asked, Tables] | None = None

    def zero_inputs(
        self, steps: int, tables: Tables, held: np.ndarray, recorded_nodes: np.ndarray, stride: int
    ) -> Inputs:
        """Return inputs without sources for a number of steps; prescribed values are zero."""
        given = steps, stride, held, recorded_nodes, tables.dependents, tables.block_sums
        if self._zero_inputs is None or not _unchanged(self._zero_inputs[0], given):
            none, times = np.zeros(0, np.int64), np.zeros((steps, len(tables.numbers), 0), tables.numbers.dtype)
            self._zero_inputs = (
                given,
                Inputs(
                    before=np.zeros(1, np.int64),
                    source_nodes=none,
                    source_fields=np.zeros((0, 0), times.dtype),
                    source_times=times,
                    held=held,
                    held_values=np.zeros((steps, len(held))),
                    held_forces=np.zeros((0, 0)),
                    impactor_paths=np.zeros((0, 0, 0)),
                    impactor_values=np.zeros((0, 0, 0)),
                    dependent_fields=np.zeros((0, len(tables.dependents.nodes)), times.dtype),
                    dependent_times=times,
                    recorded_nodes=recorded_nodes,
                    node_values=self._rows("node values", steps, int(recorded_nodes[:, 3].sum())),
                    block_values=self._rows("block values", steps, len(tables.block_sums.rows)),
                    stride=stride,
                ),
            )
        return self._zero_inputs[1]

    def _rows(self, name: str, steps: int, width: int) -> np.ndarray:
        """Return an array of rows, reusing the same memory: allocating it takes longer than filling it."""
        kept = self._room.get(name)
        if kept is None or kept.size < steps * width:
            kept = self._room[name] = np.zeros(steps * width)
        return kept[: steps * width].reshape(steps, width)

    def planned(self, tables: Tables, inputs: Inputs) -> Tables:
        """Return the tables with their operations, the identical object as long as these stay the same."""
        asked = asked_by(inputs)
        if self._planned is None or self._planned[0] is not tables or self._planned[1] != asked:
            self._planned = tables, asked, tables.replaced(operations=operations_of(tables, asked))
        return self._planned[2]


def _unchanged(given: tuple[Any, ...], before: tuple[Any, ...]) -> bool:
    """Whether two tuples contain the identical arrays and equal numbers."""
    return all(a is b or (isinstance(a, int) and a == b) for a, b in zip(given, before, strict=True))

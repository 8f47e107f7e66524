"""The field of an engine: its interface to its parts, and its tables before any of the settings that may follow."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from farhorizon.engine.codegen.choose import compiled_rows, equal_blocks
from farhorizon.engine.codegen.matrices import Signs
from farhorizon.engine.dampers import DamperTables
from farhorizon.engine.exchange import Exchange
from farhorizon.engine.filter import Filter, filter_tables
from farhorizon.engine.layer_operators import LayerOperator
from farhorizon.engine.layer_tables import LayerSetup, LayerTables
from farhorizon.engine.layout import Block, Layout, aligned_zeros, with_defaults
from farhorizon.engine.operations import FURTHER_PASSES, Operation, Tables
from farhorizon.engine.tables import BlockSums, Flows, Material, Pass, Sweep

_SECOND_CACHE = 600_000  # bytes of the second-level cache that a part of the box may occupy


class Field(Protocol):
    """Levels, tables and geometry; see `engine.Engine`."""

    layout: Layout
    core: Block
    stages: Any
    dt: float
    reaction: float | np.ndarray
    signs: Signs
    dtype: np.dtype
    kept: np.dtype
    components: int
    threads: int
    offsets: np.ndarray
    weights: np.ndarray
    layers: dict[tuple[int, int], Any]
    layer_setup: LayerSetup
    layer_tables: LayerTables
    dampers: DamperTables
    memory: np.ndarray
    remember: bool
    levels: np.ndarray
    tables: Tables
    passes: Any
    heat_vectors: np.ndarray
    heat_passes: tuple[LayerOperator, ...]
    drag_pass: LayerOperator | None
    absent: Any
    all_layers: list[LayerTables]
    exchange: Exchange | None

    def array(self, name: str) -> np.ndarray: ...
    @property
    def current(self) -> np.ndarray: ...
    @property
    def older(self) -> np.ndarray: ...
    @property
    def varied(self) -> bool: ...
    def spread(
        self, core: np.ndarray, beyond: Mapping[tuple[int, int], float] | None = None, jointly: bool = False
    ) -> np.ndarray: ...
    def join(self, values: np.ndarray, beyond: Mapping[tuple[int, int], float]) -> None: ...
    def complete(self, level: np.ndarray) -> None: ...
    def operate(
        self,
        level: np.ndarray,
        operations: list[Operation],
        keep_memory: bool = False,
        thermal: bool = True,
        contact: bool = True,
        again: bool = False,
    ) -> np.ndarray: ...
    def replace(self, **tables: Any) -> None: ...
    def sweep_in_pieces(self, rows: int) -> None: ...


def first_tables(engine: Field, heterogeneous: bool, rule: int) -> Tables:
    """Return the tables for a medium without any of the settings that may follow."""
    dtype, n = engine.dtype, engine.components
    numbers = [numbers_of(engine, *stage) for stage in engine.stages.numbers]
    sweep, layers = _sweep(engine, heterogeneous), engine.layer_tables.layers
    bond_stencil = with_defaults(Pass, dtype, sweep=sweep, layers=layers, columns=n, rows=n)
    passes = dict.fromkeys(FURTHER_PASSES, bond_stencil)  # it stands for those that do not exist
    if engine.passes is not None:
        passes["gradient_pass"], passes["divergence_pass"] = engine.passes.tables(sweep)
    if engine.heat_passes:
        passes["pushes"], passes["traces"] = (layer_pass.table(sweep) for layer_pass in engine.heat_passes)
    if engine.drag_pass is not None:
        passes["neighbours"] = engine.drag_pass.table(sweep)
    stretches = {} if engine.passes is None else {"stretches": engine.passes.stretch_tables()}
    return with_defaults(
        Tables,
        dtype,
        rotation=np.array(engine.stages.rotation, np.int64),
        numbers=np.array(numbers).astype(dtype),
        increments=engine.stages.increments,
        components=n,
        sweep=sweep,
        layers=layers,
        work_space=aligned_zeros(max(tables.scratch for tables in engine.all_layers), dtype, engine.threads),
        copies=engine.layout.copies(),
        material=Material(np.ones(1, dtype), rule, dtype.type(1), dtype.type(np.inf)),
        starts=np.zeros(len(numbers) + 1, np.int64),
        flows=with_defaults(Flows, dtype, effects=np.zeros(len(numbers))),
        filter=_filter(engine),
        dampers=engine.dampers.tables(engine.memory, dtype),
        block_sums=with_defaults(BlockSums, dtype, stride=np.array(engine.layout.box.stride, np.int64)),
        **passes,
        **stretches,
    )


def _sweep(engine: Field, heterogeneous: bool) -> Sweep:
    """Sweep of the stencil; rows of a heterogeneous medium are not compiled for its weights."""
    reaction = np.asarray(engine.reaction) if np.ndim(engine.reaction) else np.zeros((0, 0))  # scalars: `numbers_of`
    blocks, block = block_of(engine)
    of_rows = engine.dtype.name, engine.stages.increments, engine.signs, reaction
    function, row = (0, np.zeros(1)) if heterogeneous else compiled_rows(engine.offsets, block, *of_rows)
    scale = np.array([n[2] for n in engine.stages.numbers])
    used = engine.weights.any(axis=tuple(range(1, engine.weights.ndim)))  # two passes may have no springs
    offsets, weights = engine.offsets[used], engine.weights[used]
    return with_defaults(
        Sweep,
        engine.dtype,
        block=engine.layout.table(engine.components // blocks, engine.components // blocks),
        function=function,
        blocks=blocks,
        depth=_depth(engine),
        weights=(scale[:, None] * row).astype(engine.dtype),
        offsets=offsets @ np.array(engine.layout.box.stride),
        general=(scale[:, None] * np.concatenate([weights.ravel(), -reaction.ravel()])).astype(engine.dtype),
        reach=np.array(engine.layout.reach),
    )


def block_of(engine: Field) -> tuple[int, np.ndarray]:
    """Number of equal stencils in the weights, one per component of the field, and one of these; otherwise 1 and all
    weights.
    """
    count = engine.components
    if count > 1 and not np.ndim(engine.reaction) and equal_blocks(engine.weights, count):
        return count, engine.weights[:, 0, 0]
    return 1, engine.weights


def numbers_of(engine: Field, a: float, b: float, scale: float, source_scale: float) -> tuple[float, ...]:
    """Numbers of a stage for the sweeps: factor of a node's own value for the rows' weights, the same for sums over
    differences, and the others. Rows of increments are differences, and leave out the value itself, which stays.
    """
    increments = engine.stages.increments
    difference = a - float(increments) - (0.0 if np.ndim(engine.reaction) else scale * float(engine.reaction))
    block = block_of(engine)[1]
    rows = -float(block.sum()) if block.ndim == 1 and not increments else 0.0
    return difference + scale * rows, difference, b, scale, source_scale


def _depth(engine: Field) -> int:
    """Number of rows to sweep at a time: few enough that each thread gets some and that, in 3D, the planes that they
    read stay in the second-level cache.
    """
    box, reach = engine.layout.box, engine.layout.reach
    rows, planes = box.nodes[1], 2 * reach[0] + 1
    most = min(64, -(-box.nodes[0] * rows // (8 * engine.threads)))
    if planes > 1:
        most = min(
            most, _SECOND_CACHE // (engine.components * box.stride[1] * engine.dtype.itemsize * planes) - 2 * reach[0]
        )
    return -(-rows // -(-rows // max(most, 8)))


def _filter(engine: Field) -> Filter:
    """Return the filter of short waves; all layers share the longest one, and what it is applied to."""
    rates, taps = damping_of(engine)
    whole = any(layer.whole for layer in engine.layers.values())
    every = max((layer.every for layer in engine.layers.values() if layer.filtered), default=0) or 1
    return filter_tables(engine.layout, rates, taps, engine.dt, engine.dtype, whole, every)


def damping_of(engine: Field) -> tuple[dict[tuple[int, int], np.ndarray], np.ndarray]:
    """Rates at which layers damp short waves, from the near field outwards, and the filter."""
    rates = {
        name: layer.damping if layer.filtered else np.zeros(layer.columns) for name, layer in engine.layers.items()
    }
    return rates, max((layer.taps for layer in engine.layers.values()), key=len, default=np.zeros(1))

"""The interface of an engine to its parts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from farhorizon.engine.codegen.choose import equal_blocks
from farhorizon.engine.codegen.matrices import Signs
from farhorizon.engine.exchange import Exchange
from farhorizon.engine.layer_operators import LayerOperator
from farhorizon.engine.layer_tables import LayerSetup, LayerTables
from farhorizon.engine.layout import Block, Layout
from farhorizon.engine.passes import Operation
from farhorizon.engine.tables import Tables


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
    layers_of_passes: list[LayerTables | None]
    layer_setup: LayerSetup
    layer_tables: LayerTables
    dampers: Any
    bonds: Any
    held: np.ndarray
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
    def apply(self, level: np.ndarray) -> np.ndarray: ...
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

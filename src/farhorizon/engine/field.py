"""Interface of an engine to its parts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from farhorizon.engine.dampers import DamperTables
from farhorizon.engine.exchange import Exchange
from farhorizon.engine.layer_tables import LayerTables
from farhorizon.engine.layout import Block, Layout
from farhorizon.engine.operations import Operation, Tables
from farhorizon.engine.rows.matrices import Signs


class Field(Protocol):
    """Levels, tables and geometry; see `farhorizon.engine.engine.Engine`, whose constructor documents the
    parameters.
    """

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
    layer_tables: LayerTables
    dampers: DamperTables
    memory: np.ndarray
    remember: bool
    levels: np.ndarray
    tables: Tables
    passes: Any
    thermoelastic_layers: Any
    dragged_layers: Any
    all_layers: list[LayerTables]
    exchange: Exchange | None

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
        apart: bool = False,
        cold: bool = False,
        again: bool = False,
        gaping: bool = False,
    ) -> np.ndarray: ...
    def replace(self, **tables: Any) -> None: ...
    def sweep_in_pieces(self, rows: int) -> None: ...

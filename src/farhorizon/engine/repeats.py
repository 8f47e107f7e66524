"""Reuse of inputs and tables between calls of the loop: certificates call it tens of thousands of times, for one step
without any inputs each.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from farhorizon.engine.operations import Asked, Tables, asked_by, operations_of
from farhorizon.engine.tables import Inputs


class Repeats:
    """Keeps inputs and tables for the next call, which usually needs the same ones."""

    def __init__(self) -> None:
        self._room: dict[str, np.ndarray] = {}
        self._nothing: tuple[tuple[Any, ...], Inputs] | None = None
        self._planned: tuple[Tables, Asked, Tables] | None = None

    def nothing(self, steps: int, tables: Tables, held: np.ndarray, recorded_nodes: np.ndarray, stride: int) -> Inputs:
        """Return inputs without sources for a number of steps; prescribed values are zero."""
        given = steps, stride, held, recorded_nodes, tables.dependents, tables.block_sums
        if self._nothing is None or not _unchanged(self._nothing[0], given):
            none, times = np.zeros(0, np.int64), np.zeros((steps, len(tables.numbers), 0), tables.numbers.dtype)
            self._nothing = (
                given,
                Inputs(
                    before=0,
                    source_nodes=none,
                    source_fields=np.zeros((0, 0), times.dtype),
                    source_times=times,
                    held=held,
                    held_values=np.zeros((steps, len(held))),
                    held_forces=np.zeros((0, 0)),
                    dependent_fields=np.zeros((0, len(tables.dependents.nodes)), times.dtype),
                    dependent_times=times,
                    recorded_nodes=recorded_nodes,
                    node_values=self._rows("node values", steps, int(recorded_nodes[:, 3].sum())),
                    block_values=self._rows("block values", steps, len(tables.block_sums.rows)),
                    stride=stride,
                ),
            )
        return self._nothing[1]

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
            operations, starts = operations_of(tables, asked)
            self._planned = tables, asked, tables._replace(operations=operations, starts=starts)
        return self._planned[2]


def _unchanged(given: tuple[Any, ...], before: tuple[Any, ...]) -> bool:
    """Whether two tuples contain the identical arrays and equal numbers."""
    return all(a is b or (isinstance(a, int) and a == b) for a, b in zip(given, before, strict=True))

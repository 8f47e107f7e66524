"""Drag in the layers of a solid: as for the forces, the neighbours there are those of the medium that a layer
continues; otherwise waves would meet a different medium.

This is one further pass, from the increments of a step to their sums over neighbours. `engine.drag` computes the sums
with plain shifts, and this module provides what the layers add.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from farhorizon.engine.field import Field
from farhorizon.engine.layer_cuts import cut_layers
from farhorizon.engine.layer_tables import LayerTables
from farhorizon.engine.layout import aligned_zeros
from farhorizon.engine.nested import Layers
from farhorizon.engine.operations import Pass
from farhorizon.engine.surface import no_surface
from farhorizon.engine.tables import Cuts, Sweep


class DraggedLayers:
    """Makes the tables of the pass.

    Parameters
    ----------
    engine : Field
    recursion : mapping of (axis, side) to (r, e, f)
        Recursion coefficients of each layer.

    Attributes
    ----------
    layer_tables : LayerTables
    weights : ndarray, shape (K, d, d)
        Equal weights of all neighbours.
    moved, beyond : ndarray, shape (d * places,)
        Increments of a step, and what the layers add to their sums.
    """

    def __init__(self, engine: Field, recursion: Mapping[tuple[int, int], tuple[np.ndarray, ...]]) -> None:
        self.weights = np.broadcast_to(np.eye(engine.components), (len(engine.offsets), *[engine.components] * 2))
        signs, of_values = engine.signs, (engine.dtype, engine.kept, engine.remember)
        self.layer_tables = LayerTables(
            engine.layout, engine.offsets, self.weights, signs, signs, recursion, *of_values
        )
        self.moved, self.beyond = aligned_zeros(engine.components * engine.layout.size, engine.dtype, 2)

    def table(self, bond_stencil: Sweep) -> Pass:
        """Return the pass, on the box over which the springs are swept."""
        none, dtype, tables = np.zeros(0, np.int64), bond_stencil.general.dtype, self.layer_tables
        cuts, surface = Cuts(none, none, np.zeros(0, dtype)), no_surface(dtype)
        return Pass(bond_stencil, tables.layers, cuts, surface, tables.columns, tables.rows)

    def without(self, nodes: np.ndarray, neighbours: np.ndarray) -> Layers:
        """Return the layers without some bonds, given by the places of their ends in a level."""
        return cut_layers(self.layer_tables, nodes, neighbours, self.weights[np.zeros(len(nodes), np.int64)])

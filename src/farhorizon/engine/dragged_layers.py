"""Drag in the layers of a solid: what neighbours do is that of the medium which a layer continues, as in the forces,
else waves would meet another medium there.

One further pass, from the increments of a step to their sums over neighbours, of which the plain ones are made by
`engine.drag`; here is what the layers add.
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
        Of each layer.

    Attributes
    ----------
    layer_tables : LayerTables
    weights : ndarray, shape (K, d, d)
        All neighbours count alike.
    moved, beyond : ndarray, shape (d * places,)
        The increments of a step, and what the layers add to their sums.
    """

    def __init__(self, engine: Field, recursion: Mapping[tuple[int, int], tuple[np.ndarray, ...]]) -> None:
        self.weights = np.broadcast_to(np.eye(engine.components), (len(engine.offsets), *[engine.components] * 2))
        signs, of_values = engine.signs, (engine.dtype, engine.kept, engine.remember)
        self.layer_tables = LayerTables(
            engine.layout, engine.offsets, self.weights, signs, signs, recursion, *of_values
        )
        self.moved, self.beyond = aligned_zeros(engine.components * engine.layout.size, engine.dtype, 2)

    def table(self, springs: Sweep) -> Pass:
        """That of the pass, on the box that the springs are swept over."""
        none, dtype, tables = np.zeros(0, np.int64), springs.general.dtype, self.layer_tables
        cuts, surface = Cuts(none, none, np.zeros(0, dtype)), no_surface(dtype)
        return Pass(springs, tables.layers, cuts, surface, tables.columns, tables.rows)

    def without(self, nodes: np.ndarray, neighbours: np.ndarray) -> Layers:
        """The layers without some bonds, given by the places of their ends in a level."""
        return cut_layers(self.layer_tables, nodes, neighbours, self.weights[np.zeros(len(nodes), np.int64)])

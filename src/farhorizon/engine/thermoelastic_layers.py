"""Heat that passes through the layers of a solid: the temperature exerts forces, and deformation feeds it, through the
same stretched shifts as those of the displacements.

There are two further passes with one number per node: from thermal strains to forces, and from displacements to the
traces of the stresses. For bonds with a law of their own their plain sums are computed in the zone (`engine.bonds`);
those of all others are computed by `engine.thermal_strain`, and this module provides what the layers add. Where nodes
have states, thermal strains act node by node and pass through the layers with the results of the law; the two passes
are then those of the springs.
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
from farhorizon.engine.rows.matrices import signs_of
from farhorizon.engine.surface import no_surface
from farhorizon.engine.tables import Cuts, Sweep


class ThermoelasticLayers:
    """Makes the tables of both passes.

    Parameters
    ----------
    engine : Field
    vectors : ndarray, shape (K, d)
        Forces of the bonds, or of the springs of state-based media, per unit strain, in units of the operator.
    recursion : mapping of (axis, side) to (r, e, f)
        Recursion coefficients of each layer.
    alike : bool
        Whether bonds have no coefficients.

    Attributes
    ----------
    layer_tables : tuple of LayerTables
    weights : tuple of ndarray, shapes (K, d, 1) and (K, 1, d)
        Weights of both passes: a bond has the mean thermal strain of its ends, and a node half the trace of each of its
        bonds.
    vectors : ndarray, shape (K, d)
    traces : ndarray, shape (places,)
        Output of the second pass.
    """

    def __init__(
        self,
        engine: Field,
        vectors: np.ndarray,
        recursion: Mapping[tuple[int, int], tuple[np.ndarray, ...]],
        alike: bool,
    ) -> None:
        self.vectors, self._distances = vectors, engine.offsets @ np.array(engine.layout.box.stride)
        self.weights = -vectors[:, :, None] / 2, vectors[:, None, :] / 2
        scalar, vector = signs_of(1), signs_of(engine.components)
        recursion = recursion if vectors.any() else {}  # state-based media may have no springs
        self.layer_tables = tuple(
            LayerTables(
                engine.layout,
                engine.offsets,
                weights,
                *signs,
                recursion,
                engine.dtype,
                engine.kept,
                engine.remember,
                alike,
            )
            for weights, signs in zip(self.weights, ((scalar, vector), (vector, scalar)), strict=True)
        )
        self.traces = aligned_zeros(engine.layout.size, engine.dtype)

    def tables(self, bond_stencil: Sweep) -> tuple[Pass, Pass]:
        """Return both passes, on the box over which the springs are swept."""
        none, dtype = np.zeros(0, np.int64), bond_stencil.general.dtype
        cuts, surface = Cuts(none, none, np.zeros(0, dtype)), no_surface(dtype)
        pushes, traces = (
            Pass(bond_stencil, tables.layers, cuts, surface, tables.columns, tables.rows)
            for tables in self.layer_tables
        )
        return pushes, traces

    def without(self, nodes: np.ndarray, neighbours: np.ndarray) -> tuple[Layers, Layers]:
        """Return the layers of both passes without some bonds, given by the places of their ends in a level."""
        order = np.argsort(self._distances)
        bonds = order[np.searchsorted(self._distances[order], neighbours - nodes)]
        pushes, traces = (
            cut_layers(tables, nodes, neighbours, weights[bonds])
            for tables, weights in zip(self.layer_tables, self.weights, strict=True)
        )
        return pushes, traces

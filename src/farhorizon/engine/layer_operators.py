"""Operators to which only layers add, and layers without some bonds (`cut_layers`).

Drag (`features.drag`) and heat that passes through the layers of a solid (`features.thermal_strain`) sum over bonds of
their own: increments over neighbours; thermal strains to forces; displacements to the traces of the stresses. These
modules compute the plain sums. In the layers the neighbours are those of the medium that a layer continues, through the
same stretched shifts as those of the displacements; otherwise waves would meet a different medium there.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from farhorizon.engine.codegen.matrices import Signs, signs_of
from farhorizon.engine.layer_tables import LayerSetup, LayerTables
from farhorizon.engine.layers import (
    AXIS,
    BASE,
    COLUMNS,
    CUTS,
    EDGE_FACE,
    EDGE_OTHER,
    NO_SLOT,
    ORIGIN,
    REACH,
    ROW_STEP,
    ROWS,
    SETS,
    STEP,
    TILE_BAND,
    TILE_FIRST,
    WIDTH,
    Layers,
)
from farhorizon.engine.layout import with_defaults
from farhorizon.engine.tables import Pass, Sweep


class LayerOperator:
    """Tables of a further pass with these weights, shape (K, rows, columns), see `LayerTables`."""

    def __init__(
        self, setup: LayerSetup, weights: np.ndarray, inside: Signs, outside: Signs, alike: bool = True
    ) -> None:
        self.weights = weights
        self.layer_tables = LayerTables(setup, weights, inside, outside, alike)

    def table(self, bond_stencil: Sweep) -> Pass:
        """Return the pass, on the box over which the springs are swept."""
        tables = self.layer_tables
        return with_defaults(
            Pass, tables.dtype, sweep=bond_stencil, layers=tables.layers, columns=tables.columns, rows=tables.rows
        )

    def without(self, nodes: np.ndarray, neighbours: np.ndarray) -> Layers:
        """Return the layers without some bonds, given by the places of their ends in a level."""
        bonds = self.layer_tables.layout.bonds_between(nodes, neighbours)
        return cut_layers(self.layer_tables, nodes, neighbours, self.weights[bonds])


def drag_pass(setup: LayerSetup, signs: Signs) -> LayerOperator:
    """Return the pass from the increments of a step, with these signs, to their sums over neighbours."""
    components = len(signs)
    weights = np.broadcast_to(np.eye(components), (len(setup.offsets), components, components))
    return LayerOperator(setup, weights, signs, signs)


def heat_passes(setup: LayerSetup, vectors: np.ndarray, alike: bool) -> tuple[LayerOperator, LayerOperator]:
    """Return the passes from thermal strains to forces and from displacements to the traces of the stresses.

    `vectors`, shape (K, d), are the forces of the bonds, or of the springs of state-based media, per unit strain, in
    units of the operator. A bond has the mean thermal strain of its ends, and a node half the trace of each of its
    bonds. Where nodes have states, thermal strains act node by node and pass through the layers with the results of the
    law; the two passes are then those of the springs.
    """
    scalar, vector = signs_of(1), signs_of(vectors.shape[1])
    if not vectors.any():  # state-based media may have no springs
        setup = setup._replace(recursion={})
    return (
        LayerOperator(setup, -vectors[:, :, None] / 2, scalar, vector, alike),
        LayerOperator(setup, vectors[:, None, :] / 2, vector, scalar, alike),
    )


def cut_layers(tables: LayerTables, nodes: np.ndarray, neighbours: np.ndarray, weights: np.ndarray) -> Layers:
    """Layers without some bonds, given by places in a level and weights (n,) or (n, rows, columns): all columns of a
    layer, and those of the core next to it, lack the bonds of its first column.
    """
    box = tables.layout.box
    here = box.coordinates(nodes)
    offset = box.coordinates(neighbours) - here
    matrices = weights.reshape(len(nodes), tables.rows, tables.columns) / tables.unit
    faces, face_rows, band_rows, start = tables.faces.copy(), [], [], 0
    for face in faces:
        axis = int(face[AXIS])
        column = (int(face[ORIGIN]) - box.origin + int(face[STEP])) // box.stride[axis]
        face[CUTS] = start
        for i in np.flatnonzero((here[:, axis] == column) & (offset[:, axis] != 0)):
            face_rows += _face_cuts(tables, face, here[i], offset[i], matrices[i])
        start += tables.rows * int(face[ROWS]) * len(tables.tiles)
    edge_rows = []
    for number, edge in enumerate(tables.edges):
        both = [tables.faces[edge[which]] for which in (EDGE_FACE, EDGE_OTHER)]
        columns = [(int(f[ORIGIN]) - box.origin + int(f[STEP])) // box.stride[f[AXIS]] for f in both]
        for i in np.flatnonzero((here[:, :2] == columns).all(1) & (offset[:, :2] != 0).all(1)):
            edge_rows += _edge_cuts(tables, number, both, here[i], offset[i], matrices[i])
    for number, band in enumerate(tables.bands):
        column = int(band[ORIGIN]) - box.origin + int(band[STEP])
        for i in np.flatnonzero((here[:, 2] == column) & (offset[:, 2] != 0)) if band[COLUMNS] else ():
            band_rows += _band_cuts(tables, number, int(nodes[i]), here[i], offset[i], matrices[i])
    if not face_rows and not band_rows:
        return tables.layers
    face_rows.sort(key=lambda row: row[0])
    edge_rows.sort(key=lambda row: row[0])
    last = len(tables.edges) * tables.rows * len(tables.tiles)
    return tables.layers._replace(
        faces=faces,
        cuts=np.array([row[1:7] for row in face_rows], np.int64).reshape(-1, 6),
        cut_weights=np.array([row[7] for row in face_rows], tables.dtype),
        cut_ranges=np.searchsorted([row[0] for row in face_rows], np.arange(start + 1)),
        edge_cuts=np.array([row[1:9] for row in edge_rows], np.int64).reshape(-1, 8),
        edge_cut_weights=np.array([row[9] for row in edge_rows], tables.dtype),
        edge_cut_ranges=np.searchsorted([row[0] for row in edge_rows], np.arange(last + 1)),
        band_cuts=np.array([row[:5] for row in band_rows], np.int64).reshape(-1, 5),
        band_cut_weights=np.array([row[5] for row in band_rows], tables.dtype),
    )


def _face_cuts(
    tables: LayerTables, face: np.ndarray, here: np.ndarray, offset: np.ndarray, matrix: np.ndarray
) -> list[tuple[Any, ...]]:
    """For one bond, the key and the entries of `Layers.cuts` and `cut_weights`."""
    axis, tiles = int(face[AXIS]), tables.tiles
    inward = int(offset[axis] * face[STEP] < 0)
    if inward >= face[SETS]:
        return []  # its mirror image serves
    other, k = 1 - axis, int(abs(offset[axis]))
    t = int(np.searchsorted(tiles[:, TILE_FIRST], here[2], side="right")) - 1
    lane, band = int(here[2] - tiles[t, TILE_FIRST]), int(tiles[t, TILE_BAND])
    across, line = int(offset[other] * face[ROW_STEP] + offset[2]), np.where(np.arange(3) == axis, 0, offset).tolist()
    rows = []
    for row, column in np.argwhere(matrix != 0):
        far = tables.slots.place(band, column, line) if band >= 0 else None
        key = int(face[CUTS] + (row * face[ROWS] + here[other]) * len(tiles) + t)
        near = across + column * tables.layout.size
        rows.append((key, lane, inward, k - 1, near, NO_SLOT if far is None else far, across, matrix[row, column]))
    return rows


def _edge_cuts(
    tables: LayerTables, number: int, faces: list[np.ndarray], here: np.ndarray, offset: np.ndarray, matrix: np.ndarray
) -> list[tuple[Any, ...]]:
    """For one bond, the key and the entries of `Layers.edge_cuts` and `edge_cut_weights`."""
    inwards = [int(o * face[STEP] < 0) for o, face in zip(offset, faces, strict=False)]
    if any(inward >= face[SETS] for inward, face in zip(inwards, faces, strict=True)):
        return []  # its mirror image serves
    tiles = tables.tiles
    t = int(np.searchsorted(tiles[:, TILE_FIRST], here[2], side="right")) - 1
    lane, band, across = int(here[2] - tiles[t, TILE_FIRST]), int(tiles[t, TILE_BAND]), int(offset[2])
    rows = []
    for row, column in np.argwhere(matrix != 0):
        far = tables.slots.place(band, column, [0, 0, across]) if band >= 0 else None
        place = across + column * tables.layout.size, NO_SLOT if far is None else far, across
        which = inwards[0], int(abs(offset[0])) - 1, inwards[1], int(abs(offset[1])) - 1
        key = (number * tables.rows + int(row)) * len(tiles) + t
        rows.append((key, lane, *which, *place, matrix[row, column]))
    return rows


def _band_cuts(
    tables: LayerTables, number: int, node: int, here: np.ndarray, offset: np.ndarray, matrix: np.ndarray
) -> list[tuple[Any, ...]]:
    """For one bond, the entries of `Layers.band_cuts` and `band_cut_weights`."""
    band, box, slots = tables.bands[number], tables.layout.box, tables.slots
    first = node - here[2] + (0 if band[STEP] < 0 else box.nodes[2] - band[COLUMNS] - band[REACH])
    neighbour = node + offset[0] * box.stride[0] + offset[1] * box.stride[1]
    line = [here[0] + offset[0], here[1] + offset[1], offset[2]]
    rows: list[tuple[Any, ...]] = []
    for row, column in np.argwhere(matrix != 0):
        place = slots.place(number, column, line)
        if place is not None:
            slot = band[BASE] + slots.first * band[WIDTH] + place
            rows.append((number, first + row * tables.layout.size, slot, node, neighbour, matrix[row, column]))
    return rows

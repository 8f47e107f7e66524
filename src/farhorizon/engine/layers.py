"""The tables of layers, and how they work: stretched shifts add to the sums that a sweep has made with plain shifts.

A stencil is a sum of products of shifts. Along an axis with layers the shift by one node outwards is ``v = V q``,

    v(p) = q(p+1) + c(p),   c(p) = r (q(p) - v(p+1)) - N(p),   N <- e N + f (q(p) - v(p+1)),

on the edge between the columns p and p+1 of a layer, where column 0 is the last one of the core; likewise inwards. On
all other edges c is zero. So the stencil is swept over all nodes, those of the layers included, with plain shifts, and
the layers add sums over c, as follows.

- Along the first two axes in nested (Horner) form: ``sum_k V^k B_k = V (B_1 + V (B_2 + ...))`` takes one c, with one N,
  for each k, direction and edge, whatever the B_k are. These are the parts of the stencil that reach k columns outwards
  or inwards, and they are needed on the columns of the layer and on the last reach + 1 of the core. Where faces of both
  axes meet, in an edge, the B_k of the first axis contain what the layers along the second add to them.
- Along the last axis, whose nodes are neighbours in memory, the fields ``V^k u`` are continued instead, line by line:
  ``slots`` hold how they differ from plain shifts on a *band*: the columns of the layer and as many of the core as the
  stencil reaches. All sums across that axis read them as further lines.

Lines along the last axis are cut into *tiles* of up to `LINES` nodes, whose values are processed side by side. Bands
are tiles of their own.

This module holds the tables, which `engine.layer_tables` builds; `engine.layer_program` has the functions that work on
them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from farhorizon.engine.layout import ints, reals

#: Values that are processed side by side.
LINES = 32
#: Axes along which the sums run, in the order of `Layers.spans`: for faces of the first axis and of the second, for
#: edges and for bands.
ACROSS = (1, 2), (0, 2), (2,), (0, 1)
OF_EDGES, OF_BANDS = 2, 3

#: Distance to the slot of a neighbour that has none; distances to slots may be negative.
NO_SLOT = -(2**62)

# Columns of tables.
AXIS, PROFILE, COLUMNS, REACH, SETS, ORIGIN, STEP, OUTWARDS, INWARDS, PARTS = range(10)  # of a face and of a band
ROWS, ROW_STEP, SLOT, SLOT_STEP, SLOT_ROW, SUMS, MEMORY, CUTS = range(10, 18)  # of a face
WIDTH, BASE, BAND_MEMORY, PLANE, ROW, LINE = range(10, 16)  # of a band
TILE_FIRST, TILE_COUNT, TILE_VECTORS, TILE_BAND, TILE_COLUMN, TILE_PLACE = range(6)
EDGE_FACE, EDGE_OTHER, EDGE_SUMS, EDGE_MEMORY, EDGE_CELLS, EDGE_FIRST, EDGE_ROWS, EDGE_KINDS = range(8)
KIND_REACH, KIND_FIRST, KIND_CELLS, KIND_OUTWARDS, KIND_INWARDS, KIND_PARTS = range(6)  # of the parts of an edge


class Layers(NamedTuple):
    """What the compiled loop knows of the layers; for the columns of tables see above and `engine.layer_tables`."""

    faces: np.ndarray  # layers along the first two axes, shape (F, 18)
    bands: np.ndarray  # layers along the last axis, the low and the high one; no columns where there is none, (2, 16)
    edges: np.ndarray  # where two faces meet, shape (E, 8)
    # For each set and k of an edge's first face: how far those parts reach along the second axis, the first column
    # where they are needed, the cells of memory before theirs, and the functions that process them; shape (n, 6).
    kinds: np.ndarray
    tiles: np.ndarray  # shape (T, 6)
    items: np.ndarray  # pieces of work: face, first row, last row + 1, tile, edge or -1; shape (n, 5)
    item_ranges: np.ndarray  # items of the second axis, then of the first; shape (3,)
    # Three rows for each sum, for terms in the level, in the low and in the high band: the ends of their groups of
    # terms, see `vectors.weighted_parts`; shape (3 S, reach + 1).
    ends: np.ndarray
    # For each term, the distance in bytes from a node to what it is taken of; and, where coefficients vary, that from
    # the first factors of bonds to its own, for which a thread's work space has a row for each of `neighbours`.
    places: np.ndarray
    factors: np.ndarray
    # Distances to coefficients: for sums across the second axis and the last, the first and the last, the last alone,
    # the first two; and the first of each of these.
    neighbours: np.ndarray
    spans: np.ndarray
    weights: np.ndarray  # shape (terms, reach)
    r: np.ndarray  # shape (layers, columns + 1), as are e and f
    e: np.ndarray
    f: np.ndarray
    # For mirror-symmetric stencils, for each axis, then for each distance along the first one where faces meet, and for
    # terms in the level and in the bands: the function that sums all parts at once, or 0, and the first of its weights;
    # shape (3 + reach, 2, 2).
    mirrored: np.ndarray
    mirrored_weights: np.ndarray
    # Lines along the first two axes, those of a band with their halo, and those before its first node; the first sum of
    # the bands; rows of work space for the parts of a face; lanes of all tiles and of a group of lines; the place of
    # the first node; rows of work space for an edge; the rows at which factors of bonds and the parts of an edge begin.
    sizes: np.ndarray
    cell: int  # bytes of each number that layers remember; 0 where they have no memory
    unit: Any  # sum of the magnitudes of the weights, by which all weights here are divided
    slots: np.ndarray  # values of the bands
    memory: np.ndarray
    # Places of the slots that repeat others, and those others, where an axis is periodic; shape (2, n).
    copies: np.ndarray = ints(2, 0)
    # Absent bonds: node of the tile, set, k - 1, distances to the neighbour, to its place in the band, to its
    # coefficient; their weights; and those of each component, row and tile of a face, from its `CUTS` on.
    cuts: np.ndarray = ints(0, 6)
    cut_weights: np.ndarray = reals(0)
    cut_ranges: np.ndarray = ints(0)
    # Absent bonds where faces meet: node of the tile, set and k - 1 of the first face, whether inwards and k - 1 of the
    # second, then as before; those of each edge, component and tile.
    edge_cuts: np.ndarray = ints(0, 8)
    edge_cut_weights: np.ndarray = reals(0)
    edge_cut_ranges: np.ndarray = ints(0)
    # Absent bonds of bands: band, first node, its place in the slots, and the two coefficients.
    band_cuts: np.ndarray = ints(0, 5)
    band_cut_weights: np.ndarray = reals(0)


def has_layers(layers: Layers, axis: int) -> bool:
    """Whether there are any layers along an axis."""
    return bool(layers.bands[:, COLUMNS].any() if axis == 2 else np.diff(layers.item_ranges)[1 - axis])

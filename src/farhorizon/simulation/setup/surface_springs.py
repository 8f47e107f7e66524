"""Stiffer bonds near surfaces, `model.surface`: from which bonds the nodes of a near field have."""

from __future__ import annotations

import numpy as np

from farhorizon.medium.surface import excess, products
from farhorizon.simulation.setup.cuts import CutBonds


def stiffen_surfaces(cuts: CutBonds) -> None:
    """Have the engine stiffen the bonds of nodes that lack some, beyond free sides or outside a body."""
    engine, block, lead = cuts.grid.engine, cuts.grid.engine.core, cuts.grid.lead
    exists = cuts.existing(cuts.free_rim)
    nodes = block.node_indices()
    present = np.zeros((-(-len(engine.offsets) // 8), *nodes.shape), np.uint8)  # a bit for each bond
    for bond, distance in enumerate(engine.layout.distances):
        present[bond // 8] |= (exists[nodes + distance] & exists[nodes]).astype(np.uint8) << np.uint8(7 - bond % 8)
    families, kinds = np.unique(present.reshape(len(present), -1), axis=1, return_inverse=True)
    offsets = engine.offsets[:, lead:]
    cosines = products(offsets)
    energies = np.trace(engine.weights, axis1=1, axis2=2) * (offsets**2).sum(1)
    has_bond = np.unpackbits(families, axis=0, count=len(offsets)).T.astype(bool)
    numbers = excess(has_bond, energies, cosines)
    numbers[has_bond.all(1)] = 0.0
    of_nodes = numbers[kinds.ravel()].T.reshape(-1, *nodes.shape)
    engine.absent.stiffen(np.stack([engine.spread(values, jointly=True) for values in of_nodes]) * exists, cosines)

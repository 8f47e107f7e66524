"""Stiffer bonds near surfaces, `model.surface`: from which bonds the nodes of a near field have."""

from __future__ import annotations

import numpy as np

from farhorizon.errors import InputError
from farhorizon.geometry.lattice import AXES
from farhorizon.medium.surface import excess, products
from farhorizon.simulation.setup.cuts import CutBonds
from farhorizon.simulation.setup.setup import side_name


def stiffen_surfaces(cuts: CutBonds) -> None:
    """Have the engine stiffen the bonds of nodes that lack some, beyond free sides or outside a body."""
    engine, block, lead = cuts.grid.engine, cuts.grid.core, cuts.grid.lead
    exists = cuts.existing(cuts.free_rim)
    nodes = block.node_indices()
    present = np.zeros((-(-len(engine.offsets) // 8), *nodes.shape), np.uint8)  # a bit for each bond
    for bond, distance in enumerate(cuts.grid.layout.distances):
        present[bond // 8] |= (exists[nodes + distance] & exists[nodes]).astype(np.uint8) << np.uint8(7 - bond % 8)
    families, kinds = np.unique(present.reshape(len(present), -1), axis=1, return_inverse=True)
    offsets = engine.offsets[:, lead:]
    cosines = products(offsets)
    energies = np.trace(engine.weights, axis1=1, axis2=2) * (offsets**2).sum(1)
    has_bond = np.unpackbits(families, axis=0, count=len(offsets)).T.astype(bool)
    numbers = excess(has_bond, energies, cosines)
    numbers[has_bond.all(1)] = 0.0
    of_nodes = numbers[kinds.ravel()].T.reshape(-1, *nodes.shape)
    _check_entrances(cuts, of_nodes)
    engine.absent.stiffen(np.stack([engine.spread(values, jointly=True) for values in of_nodes]) * exists, cosines)


def _check_entrances(cuts: CutBonds, of_nodes: np.ndarray) -> None:
    """Refuse numbers that change along the normal within one reach of a layer, which continues the last of them."""
    lead, reach = cuts.grid.lead, cuts.grid.layout.reach
    for axis, side in cuts.layered.layers:
        last = np.moveaxis(of_nodes, 1 + lead + axis, 1)[:, ::-side][:, : reach[lead + axis] + 1]
        if (last != last[:, :1]).any():
            raise InputError(
                f"the surface of the body turns within two reaches of {side_name(axis, side)}, whose layer continues "
                f"it straight along {AXES[axis]}",
                value='surface = "energy"',
                limit=f"{2 * reach[lead + axis] + 1} nodes away",
                key="model.surface",
                remedy="enlarge the near field",
            )

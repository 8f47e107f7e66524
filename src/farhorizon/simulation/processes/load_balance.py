"""Computational work of nodes, by which a lattice is divided into boxes for several processes.

The unit is the work of a node with all its bonds that a stencil sweeps. The costs were measured on one thread
(`python benchmarks/work.py`, 2D and 3D, nodes with 28 bonds in the plane and 32 in space): the constants here lie
between the results, which depend on the stencil and the machine. Nodes outside a body are swept like all others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from farhorizon.geometry.decomposition import Key, decompose
from farhorizon.geometry.lattice import Lattice
from farhorizon.inputs.cracks import cut_bonds
from farhorizon.medium.variation import Variation
from farhorizon.models import LatticeModel
from farhorizon.simulation.processes.process_group import ALONE, ProcessGroup
from farhorizon.simulation.setup.reference_medium import constants_of, node_factor
from farhorizon.simulation.setup.setup import Setup, within_part

#: A node whose bonds are swept one by one, and one in a row of a linear material with breakable, intact bonds.
_ONE_BY_ONE, _WATCHED = 10.0, 3.0
#: Added for a node next to a crack or a rim that a stencil sweeps, and next to a crack for the two passes of states.
_CUT, _RIM, _STATES = 50.0, 2.0, 35.0
#: Added for a node of a linear material whose bonds end in several media, and if those along its row do.
_UNEVEN, _UNEVEN_ROW = 20.0, 45.0
#: Added for a node with bonds between metal and liquid, swept one by one; bonds within metal are not swept.
_FRONT = 20.0


class Costs(NamedTuple):
    """Work per node for a set-up."""

    node: float  # for a node with all its bonds
    cut: float  # added next to a crack
    rim: float  # added next to nodes outside the body
    uneven: tuple[float, float] = (0.0, 0.0)  # added where bonds end in several media, and where those along the row do


def varies(setup: Setup) -> bool:
    """Whether the medium of a set-up varies."""
    return bool(setup.model.varying) or setup.coefficient is not None


def costs_of(setup: Setup, model: LatticeModel) -> Costs:
    """Return the work per node of the operator of a set-up, whose reference medium is `model`."""
    law, lattice = model.bond_law, setup.lattice
    if model.force_states(lattice.spacing, lattice.dim) is not None:
        return Costs(1.0, _STATES, _RIM)
    if law is not None and (
        varies(setup) or law.nonlinear or law.softening is not None or law.law is not None or law.warm
    ):
        return Costs(_ONE_BY_ONE, 0.0, 0.0)
    if law is not None:
        return Costs(_WATCHED, _ONE_BY_ONE, _ONE_BY_ONE)
    return Costs(1.0, _CUT, _RIM, (_UNEVEN, _UNEVEN_ROW) if varies(setup) else (0.0, 0.0))


def cost_per_node(setup: Setup, model: LatticeModel, subdomain: Lattice) -> np.ndarray:
    """Return the work of each node in a part of the lattice of a set-up, whose reference medium is `model`."""
    costs, lattice = costs_of(setup, model), subdomain.whole
    states = model.force_states(lattice.spacing, lattice.dim)
    offsets = (model.medium(lattice.spacing, lattice.dim) if states is None else states).offsets
    reach = np.abs(offsets).max(0).tolist()
    around, inside = subdomain.around(reach)  # with all nodes within reach of its own
    box = [2 * m + 1 for m in reach]
    work = np.full(around.shape, costs.node)
    if around.existing is not None and setup.rim == "free" and costs.rim:
        work += costs.rim * (around.existing & ~minimum_filter(around.existing, box, mode="nearest"))
    if any(costs.uneven):
        several, in_row = _uneven(setup, model, around, reach)
        work += costs.uneven[0] * several + costs.uneven[1] * in_row
    if costs.cut:
        severed = np.zeros(around.shape, bool)
        for crack in setup.cracks:
            severed[tuple(cut_bonds(crack.cut, around.lower, lattice.spacing, around.shape, offsets)[0].T)] = True
        work += costs.cut * severed
    if setup.specimens:
        solid = np.zeros(around.shape, bool)
        for number, specimen in enumerate(setup.specimens):
            metal = replace(specimen, where=within_part(specimen.where, lattice, around.within))
            solid |= metal.nodes(around, f"specimen[{number}]")
        interior = minimum_filter(solid, box, mode="nearest")
        front = maximum_filter(solid, box, mode="nearest") & ~interior
        work = np.where(interior, 0.0, work + _FRONT * front)
    return np.asarray(work[inside])


def _uneven(
    setup: Setup, model: LatticeModel, subdomain: Lattice, reach: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Mark the nodes in a part of the lattice whose bonds end in more than one medium, and those for which bonds along
    the last axis do.
    """
    of_part = replace(setup, lattice=subdomain)
    variation = model.beside(constants_of(of_part)) if setup.model.varying else Variation()
    factor = variation.times(node_factor(replace(of_part, model=model))).of_bonds
    if factor is None:
        return np.zeros(subdomain.shape, bool), np.zeros(subdomain.shape, bool)
    nodes = np.ones(subdomain.shape, bool) if subdomain.mask is None else subdomain.mask
    high, low = np.where(nodes, factor, -np.inf), np.where(nodes, factor, np.inf)
    box, row = ([2 * m + 1 if a >= first else 1 for a, m in enumerate(reach)] for first in (0, subdomain.dim - 1))
    several, in_row = (
        nodes & (maximum_filter(high, size, mode="nearest") > minimum_filter(low, size, mode="nearest"))
        for size in (box, row)
    )
    return several, in_row


def cost_along(
    setup: Setup, model: LatticeModel, beyond: Mapping[Key, float], group: ProcessGroup = ALONE
) -> list[np.ndarray]:
    """Return, for each axis, the work of the nodes at each place along it relative to that of as many plain nodes, with
    those `beyond` the sides of the other axes; each process examines a box.
    """
    lattice, shape = setup.lattice, setup.lattice.shape
    boxes = decompose(shape, group.size, model.medium(lattice.spacing, lattice.dim).reach, {}, frozenset())
    subdomain = lattice.part(boxes.ranges(group.number))
    work, sums = cost_per_node(setup, model, subdomain), [np.zeros(n) for n in shape]
    for axis, (along, place) in enumerate(zip(sums, subdomain.within, strict=True)):
        along[place] = work.sum(tuple(b for b in range(lattice.dim) if b != axis))
    grown = np.array([n + beyond.get((a, -1), 0.0) + beyond.get((a, 1), 0.0) for a, n in enumerate(shape)])
    relative = []
    for axis, along in enumerate(sums):
        across = float(np.prod(np.delete(grown, axis)))
        plain = across - float(np.prod(np.delete(shape, axis)))  # nodes beyond the sides, of work 1
        relative.append((group.summed(along) + plain) / across)
    return relative

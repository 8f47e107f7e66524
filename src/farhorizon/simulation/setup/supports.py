"""Springs and dashpots at the last nodes of a near field, for sides that have a rule for them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from farhorizon.boundaries import Side
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import Lattice
from farhorizon.models import LatticeModel
from farhorizon.simulation.setup.setup import Key, side_name


class Supports(NamedTuple):
    """What springs and dashpots do to the nodes of a lattice; each of shape (components, *lattice.shape)."""

    stiffness: np.ndarray  # force per displacement on a unit of mass of the medium (1/time^2)
    damping: np.ndarray  # d in 2 d u_t

    @property
    def rate(self) -> float:
        """Largest addition to the squared frequency of a node."""
        return float(self.stiffness.max(initial=0))


def supports_of(
    sides: Mapping[Key, Side], lattice: Lattice, model: LatticeModel, components: int, density: np.ndarray | None
) -> Supports | None:
    """Return the springs and dashpots at the sides of a lattice, which may be a part, for densities of its nodes over
    that of the model; None if there are none. InputError for a model that has no velocity.
    """
    total = np.zeros((2, components, *lattice.shape))
    for (axis, side), boundary in sorted(sides.items()):
        name = f"boundary.{side_name(axis, side)}"
        try:
            rule = boundary.node_rule(axis, components)
        except InputError as error:
            raise error.at(f"{name}.{error.key.rpartition('.')[2]}") from None
        if rule is None:
            continue
        if model.order != 2:
            raise InputError(
                f"{boundary.label} is a side of waves and solids",
                value=type(model).__name__,
                limit="models of second order in time",
                key=name,
                remedy="a condition such as Convection on a Free side",
            )
        states = model.force_states(lattice.spacing, lattice.dim)
        if states is not None and not states.bonds.any():
            # measured: a tenth of a pulse is reflected by matched dashpots, at any practical spacing
            raise InputError(
                f"{boundary.label} acts on the last nodes, which such a solid hardly feels",
                value="no stabilisation",
                limit="a stabilisation, or bonds",
                key=name,
                remedy='stabilisation=0.1, or material="state-based"',
            )
        last = [slice(None)] * lattice.dim
        last[axis] = slice(1) if side < 0 else slice(-1, None)
        total[(slice(None), slice(None), *last)] += rule.reshape(2, components, *[1] * lattice.dim)
    if not total.any():
        return None
    # a force per area acts on a layer of nodes, one spacing thick
    total *= model.source_factor / lattice.spacing
    if lattice.existing is not None:
        total *= lattice.existing
    if density is not None:
        total /= density
    return Supports(total[0], total[1] / 2)

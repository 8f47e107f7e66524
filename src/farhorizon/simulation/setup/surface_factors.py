"""Surface correction: by what factor bonds near a free surface must be stiffer to make up for the absent ones."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from farhorizon import kinds
from farhorizon.boundaries import Side
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import Lattice
from farhorizon.medium.kernel import Kernel
from farhorizon.medium.stencil import Stencil
from farhorizon.models import Elastic
from farhorizon.simulation.setup.setup import Setup

_SERVED = ("bond-based", "state-based")


def surface_factor(lattice: Lattice, model: Elastic, boundary: Side | Mapping[str, Side] | None = None) -> np.ndarray:
    """Factor on Young's modulus near free surfaces that makes a surface no softer than the solid: the sum over all
    bonds of a node, weighted as in the material, divided by that over the existing ones.

    This is the volume method: since the moduli of a bond's ends are combined by their harmonic mean, a bond becomes
    stiffer by ``2 V0 / (V + V')``. Along a flat face the factor does not change, so that the face may run into layers.

    Parameters
    ----------
    lattice : Lattice
        The lattice; outside its body, if it has one, there are no bonds.
    model : Elastic
        Bond-based or state-based, with a kernel.
    boundary : Side or mapping, optional
        As in `Simulation`: beyond `Free` sides there are no bonds.

    Returns
    -------
    ndarray
        Of the lattice's shape, at least 1; 1 where all bonds exist, outside a body, and where no bond exists.

    Raises
    ------
    InputError
        Another material: the gradients of a correspondence material are exact at surfaces.

    Notes
    -----
    Le and Bobaru (2018), Surface corrections for peridynamic models in elasticity and fracture, Computational
    Mechanics 61, 499-518.

    Examples
    --------
    >>> import farhorizon as fh
    >>> ground = fh.Lattice(1.0, (-9.0, -9.0), (9.0, 0.0))
    >>> sides = {"all": fh.LatticePML(), "y+": fh.Free()}
    >>> soil = fh.Elastic(fh.Kernel(2.0, 1), young=3.0)
    >>> factor = fh.surface_factor(ground, soil, sides)
    >>> factor[0, [-1, -2, -3]].round(2).tolist()
    [1.56, 1.06, 1.0]
    >>> sim = fh.Simulation(ground, fh.Elastic(fh.Kernel(2.0, 1), young=3.0 * factor), sides)
    """
    kinds.instance(model, "model", Elastic, "an Elastic model")
    if model.material not in _SERVED or not isinstance(model.kernel, Kernel):
        raise InputError(
            "surfaces of this material are not softer by bonds that are absent",
            value=model.title,
            limit=f"{' or '.join(_SERVED)} with a kernel",
            key="model.material",
            remedy="leave the factor out",
        )
    sides = Setup(lattice, model, boundary).sides
    offsets, weights = Stencil.family(model.kernel, lattice.spacing, lattice.dim)
    exists = np.ones(lattice.shape) if lattice.existing is None else lattice.existing.astype(float)
    padded, reach = exists, np.abs(offsets).max(0)
    for axis, m in enumerate(reach):
        if sides[axis, -1].periodic:
            padded = np.pad(padded, [(m, m) if a == axis else (0, 0) for a in range(lattice.dim)], mode="wrap")
            continue
        for side, width in ((-1, (m, 0)), (1, (0, m))):
            widths = [width if a == axis else (0, 0) for a in range(lattice.dim)]
            padded = np.pad(padded, widths, mode="edge") if sides[axis, side].bonded else np.pad(padded, widths)
    left = np.zeros(lattice.shape)
    for offset, weight in zip(offsets, weights, strict=True):
        left += (
            weight * padded[tuple(slice(m + o, m + o + n) for m, o, n in zip(reach, offset, exists.shape, strict=True))]
        )
    has_bonds = (exists > 0) & (left > 0)
    return np.divide(weights.sum(), left, out=np.ones(lattice.shape), where=has_bonds)

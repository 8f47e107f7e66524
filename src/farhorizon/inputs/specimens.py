"""Pieces of metal that corrode: the solid nodes and their concentration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import ANY, OneOf, Unit
from farhorizon.errors import InputError
from farhorizon.files.storable import Storable
from farhorizon.geometry.lattice import Lattice, nodes_in
from farhorizon.geometry.shapes import Shape


@dataclass(frozen=True, eq=False)
class Specimen(Storable):
    """A piece of metal.

    Parameters
    ----------
    where : Shape or ndarray of bool
        A shape (including `Text` and `ImageMask`), or a mask of the lattice's shape. To model an initial defect,
        subtract a shape from it; to model a film that protects part of its surface, use a crack along that part.
    concentration : float
        Concentration of the intact metal.

    Raises
    ------
    InputError
        An object that is neither a shape nor a mask, a concentration that is negative or not finite.

    Examples
    --------
    >>> import farhorizon as fh
    >>> model = fh.Corrosion(fh.Kernel(2.0), saturation=0.5)
    >>> metal = fh.Specimen(fh.Disc(4.0), concentration=1.0)
    >>> lattice = fh.Lattice(1.0, (-12.0, -12.0), (12.0, 12.0))
    >>> sim = fh.Simulation(lattice, model, specimens=[metal])
    >>> int(sim.fields["solid"].sum())
    49
    """

    where: Annotated[Shape | np.ndarray, OneOf(region=Annotated[Shape, "Region of the metal."])]
    concentration: Annotated[float, Unit(ANY)] = 1.0

    def __post_init__(self) -> None:
        if not isinstance(self.where, Shape):
            kinds.mask(self.where, "specimen.where", "a specimen is a shape or a mask")
        kinds.set_fields(self, concentration=kinds.number(self.concentration, "specimen.concentration", least=0))

    def nodes(self, lattice: Lattice, key: str = "specimen") -> np.ndarray:
        """Nodes of a lattice that belong to it, a mask of the lattice's shape; raises InputError if there are none,
        unless the lattice is a part of another one, or if shape and lattice are incompatible.
        """
        if isinstance(self.where, Shape):
            nodes = nodes_in(self.where, lattice, f"{key}.where")
        else:
            nodes = np.asarray(self.where)
            if nodes.shape != lattice.shape:
                raise InputError(
                    "a mask must have the lattice's shape", value=nodes.shape, limit=lattice.shape, key=f"{key}.where"
                )
        if lattice.existing is not None:
            nodes = nodes & lattice.existing
        if lattice.whole is lattice:
            check_held(bool(nodes.any()), key)
        return nodes


def check_held(any_node: bool, key: str) -> None:
    """Raise an InputError for a specimen that contains no node."""
    if not any_node:
        raise InputError(
            "a specimen holds no node",
            key=f"{key}.where",
            remedy="move it into the near field, enlarge it or refine the lattice",
        )


def place(
    specimens: Sequence[Specimen], lattice: Lattice, saturation: float, background: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the solid nodes and the concentration on them, zero in the liquid. Raises InputError for what is no
    specimen or has no nodes, two different ones on a node, and a saturation not between that of the liquid far away,
    `background`, and of each specimen.
    """
    solid, concentration = np.zeros(lattice.shape, bool), np.zeros(lattice.shape)
    for number, specimen in enumerate(specimens):
        key = f"specimen[{number}]"
        if not isinstance(specimen, Specimen):
            raise InputError(
                "not a specimen",
                value=kinds.said(specimen),
                limit="Specimen",
                key=key,
                remedy="Specimen(shape, concentration)",
            )
        if not background < saturation < specimen.concentration:
            raise InputError(
                "the saturation lies outside the range of the data: the metal would dissolve at once, or never",
                value=saturation,
                limit=f"above {background:g} (background), below {specimen.concentration:g} ({key}.concentration)",
                key="model.saturation",
            )
        nodes = specimen.nodes(lattice, key)
        if (concentration[nodes & solid] != specimen.concentration).any():
            raise InputError(
                "two specimens of different concentration share nodes",
                value=int((nodes & solid).sum()),
                key=f"{key}.where",
                remedy="take one out of the other: first - second",
            )
        solid |= nodes
        concentration[nodes] = specimen.concentration
    return solid, concentration

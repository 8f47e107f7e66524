"""Sides without a layer: a fixed value, absent bonds, periodic continuation, or the nodes of another process."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from farhorizon import kinds
from farhorizon.arguments import FIELD, Unit
from farhorizon.boundaries.side import Side


@dataclass(frozen=True)
class Fixed(Side):
    """The field has a given value on every node beyond the side.

    Parameters
    ----------
    value : float
        Value of the field on every node beyond the side.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> bar = fh.Lattice(1.0, 0, 9)
    >>> hot = {"x-": fh.Fixed(1.0), "x+": fh.Fixed(0.0)}
    >>> sim = fh.Simulation(bar, fh.Diffusion(fh.Kernel(1.0)), hot, {"u": 0.0})
    >>> _ = sim.run(until=400.0)
    >>> bool(abs(sim.fields["u"] - (10 - np.arange(10)) / 11).max() < 1e-3)  # a straight line between the ends
    True
    """

    value: Annotated[float, Unit(FIELD)] = 0.0
    passive: ClassVar[bool] = True
    image: ClassVar[int] = -1
    assumes = frozenset()
    cracks: ClassVar[Literal["end"]] = "end"

    def __post_init__(self) -> None:
        kinds.set_fields(self, value=kinds.number(self.value, "boundary.value"))

    @property
    def held(self) -> float:
        """The value."""
        return self.value


@dataclass(frozen=True)
class Free(Side):
    """The body ends here: bonds across the side do not exist.

    A body between opposite free or fixed sides may be as thin as one node.

    Examples
    --------
    >>> import farhorizon as fh
    >>> plate = fh.Lattice(1.0, (-9.0, -9.0), (9.0, 0.0))
    >>> half_space = {"all": fh.LatticePML(), "y+": fh.Free()}
    >>> sim = fh.Simulation(plate, fh.Elastic(fh.Kernel(2.0), young=1.0), half_space)
    >>> sim.engine.absent.count > 0
    True
    """

    bonded: ClassVar[bool] = False
    passive: ClassVar[bool] = True
    image: ClassVar[int] = 1
    cracks: ClassVar[Literal["end"]] = "end"


@dataclass(frozen=True)
class Periodic(Side):
    """The field continues periodically beyond the opposite side.

    A crack that crosses this side re-enters at the opposite side: it must extend beyond both, as does a crack along the
    axis.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> ring = fh.Lattice(1.0, 0, 9)
    >>> sim = fh.Simulation(ring, fh.Diffusion(fh.Kernel(1.0)), fh.Periodic(), {"u": np.eye(10)[3]})
    >>> _ = sim.run(until=100.0)
    >>> round(float(sim.fields["u"].sum()), 12)  # nothing is lost
    1.0
    """

    periodic: ClassVar[bool] = True
    assumes = frozenset()
    passive: ClassVar[bool] = True
    cracks: ClassVar[Literal["repeat"]] = "repeat"


class Neighbour(Side, offered=False):
    """Side beyond which the nodes belong to another process, which fills the halo there (`farhorizon.engine.exchange`).

    Users do not choose it: it is placed where a run is divided into parts.
    """

    passive = shared = True
    cracks = "end"

    def __repr__(self) -> str:
        return "Neighbour()"

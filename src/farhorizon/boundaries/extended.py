"""Extended domain: more of the same medium, with a fixed end so far away that nothing returns before the end of the
run.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

from farhorizon import kinds
from farhorizon.arguments import Duration
from farhorizon.boundaries.side import Side, checked_target


@dataclass(frozen=True)
class Extended(Side):
    """Side beyond which as much of the medium as the run needs is computed, but not shown.

    This is what a user would do without absorbing layers, except that the distance is chosen automatically from the
    largest wave speed on the lattice, the location of the data and the length of the run. It supports everything that a
    lattice of nodes supports, including cracks that cross the side as they are given, and is exact to within the
    target. Its cost grows with the length of the run, to the power of the dimension.

    Parameters
    ----------
    target : float, optional
        Desired error, for waves relative to the largest value, for diffusion relative to the largest value at the same
        time; unless given, that of the model: 1e-5, for elasticity 1e-4.
    nodes : int, optional
        Fixes the number of nodes beyond the side. Together with a target and the length of the run it is assessed: a
        note tells how much may return if that is more than the target.
    until : float, optional
        Length of the run: in a case file its end, otherwise that of the first `run`.

    Raises
    ------
    InputError
        A target outside 1e-12..0.1, fewer than one node, an end that is not positive.

    Examples
    --------
    >>> import farhorizon as fh
    >>> lattice = fh.Lattice(1.0, (-9.0, -9.0), (9.0, 9.0))
    >>> far = fh.Extended(target=1e-6, until=10.0)
    >>> sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), far, {"u": "exp(-x**2 - y**2)"})
    >>> sim.fields["u"].shape  # what is computed beyond is not shown
    (19, 19)
    """

    label: ClassVar[str] = "extended domain"
    extended: ClassVar[bool] = True
    alone = "the domain grows by what all data need until the end of the run"
    cracks: ClassVar[Literal["end"]] = "end"
    target: float | None = None
    nodes: int | None = None
    until: Duration | None = None

    def __post_init__(self) -> None:
        kinds.set_fields(
            self,
            target=checked_target(self.target, 1e-12),
            nodes=None if self.nodes is None else kinds.integer(self.nodes, "boundary.nodes", least=1),
            until=None if self.until is None else kinds.number(self.until, "boundary.until", above=0),
        )

    @property
    def open_ended(self) -> bool:
        """Whether the number of nodes is chosen from the length of the run."""
        return self.nodes is None

    def width(self, reach: int, spacing: float) -> int:
        """Return the number of nodes, if it is given."""
        return self.nodes or 0

    def wanted(self, default: float) -> float:
        """Return the target if one is given, otherwise that of the model."""
        return default if self.target is None else self.target

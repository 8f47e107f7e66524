"""Layer or extended domain, whichever takes less time."""

from __future__ import annotations

from dataclasses import dataclass

from farhorizon import kinds
from farhorizon.arguments import Duration
from farhorizon.boundaries.extended import Extended
from farhorizon.boundaries.lattice_pml import LatticePML
from farhorizon.boundaries.side import Side


@dataclass(frozen=True)
class Auto(Side):
    """Side beyond which the medium continues, as a `LatticePML` or as an `Extended` domain with the same target,
    whichever is faster.

    Both are timed on this machine when the run is prepared, so that no run takes longer than one on a domain from whose
    end nothing returns. All `Auto` sides of a set-up become the same type; a note says which, and why.

    Parameters
    ----------
    target : float, optional
        Desired error, as for `LatticePML` and `Extended`.
    until : float, optional
        Length of the run, as for `LatticePML` and `Extended`.

    Raises
    ------
    InputError
        A target outside 1e-12..0.1, an end that is not positive.

    Examples
    --------
    >>> import farhorizon as fh
    >>> side = fh.Auto(target=1e-4)
    >>> side.as_layer(until=30.0, default=1e-5)
    LatticePML(target=0.0001, nodes=None, profile=None, until=30.0)
    """

    alone = Extended.alone
    target: float | None = None
    until: Duration | None = None

    def __post_init__(self) -> None:
        kinds.set_fields(self, target=self.as_domain(None).target, until=self.as_domain(None).until)

    def wanted(self, default: float) -> float:
        """Return the target if one is given, otherwise that of the model."""
        return default if self.target is None else self.target

    def as_layer(self, until: float | None, default: float) -> LatticePML:
        """Return a layer for a run of the given length or that specified for the side, whichever is longer, that meets
        the target or that of the model.
        """
        return LatticePML(target=self.wanted(default), until=self._longer(until))

    def as_domain(self, until: float | None) -> Extended:
        """Return an extended domain for a run of the given length or that specified for the side, whichever is
        longer.
        """
        return Extended(self.target, until=self._longer(until))

    def _longer(self, until: float | None) -> float | None:
        return self.until if until is None else until if self.until is None else max(until, self.until)

"""The side behind which another process computes on."""

from __future__ import annotations

from farhorizon.boundaries.side import Side


class Neighbour(Side, offered=False):
    """Another process has what lies beyond the side: it fills the halo there (`farhorizon.engine.exchange`).

    Nobody chooses it: it stands where a run is cut into parts.
    """

    passive = shared = True
    cracks = "end"

    def __repr__(self) -> str:
        return "Neighbour()"

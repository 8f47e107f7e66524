"""Side beyond which another process computes."""

from __future__ import annotations

from farhorizon.boundaries.side import Side


class Neighbour(Side, offered=False):
    """Side beyond which the nodes belong to another process, which fills the halo there (`farhorizon.engine.exchange`).

    Users do not choose it: it is placed where a run is divided into parts.
    """

    passive = shared = True
    cracks = "end"

    def __repr__(self) -> str:
        return "Neighbour()"

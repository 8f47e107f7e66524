"""What lies beyond each side of the near field, one file each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from farhorizon.boundaries.exact import Exact, ExactEnds
from farhorizon.boundaries.lattice_pml import LatticePML
from farhorizon.boundaries.plain import Fixed, Free, Periodic
from farhorizon.boundaries.sponge import Sponge
from farhorizon.errors import InputError
from farhorizon.lattice import AXES

__all__ = ["Absorbing", "Boundary", "Exact", "ExactEnds", "Fixed", "Free", "LatticePML", "Periodic", "Sponge", "sides"]

#: Sides beyond which the medium goes on.
Absorbing = LatticePML | Exact | Sponge
Boundary = Absorbing | Fixed | Free | Periodic


def sides(boundary: Boundary | Mapping[str, Boundary], dim: int) -> dict[tuple[int, int], Boundary]:
    """One boundary for each (axis, side), side = -1 or +1.

    Parameters
    ----------
    boundary : Boundary or mapping
        One for all sides, or a mapping with keys "all", "x", "x-", "x+", "y", ...; the more specific key wins.
    dim : int

    Raises
    ------
    InputError
        An unknown or superfluous key, a side without a boundary, Periodic on one side of an axis only, Exact in more than one dimension.
    """
    given: Mapping[str, Any] = boundary if isinstance(boundary, Mapping) else {"all": boundary}
    names = ["all"] + [AXES[a] + s for a in range(dim) for s in ("", "-", "+")]
    for key, value in given.items():
        if key not in names:
            raise InputError("unknown side", value=key, limit=", ".join(names), key="boundary")
        if not isinstance(value, Boundary):
            raise InputError("not a boundary", value=repr(value), limit="LatticePML, Exact, Fixed, Free, Periodic, Sponge", key=f"boundary.{key}")
    found: dict[tuple[int, int], Boundary] = {}
    for axis in range(dim):
        for side, sign in ((-1, "-"), (1, "+")):
            keys = [k for k in (AXES[axis] + sign, AXES[axis], "all") if k in given]
            if not keys:
                raise InputError("no boundary given for a side", value=AXES[axis] + sign, key="boundary", remedy='add it, or "all"')
            found[axis, side] = given[keys[0]]
            if isinstance(found[axis, side], Exact) and dim > 1:
                raise InputError("the exact boundary is for one dimension", value=f"{dim} dimensions", key=f"boundary.{keys[0]}", remedy="LatticePML")
        if isinstance(found[axis, -1], Periodic) != isinstance(found[axis, 1], Periodic):
            raise InputError("Periodic needs both sides of an axis", value=AXES[axis], key="boundary", remedy=f'"{AXES[axis]}" = Periodic')
    return found

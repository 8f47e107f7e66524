"""What lies beyond each side of the near field, one file each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, get_args

from farhorizon.boundaries.auto import Auto
from farhorizon.boundaries.exact import Exact, ExactEnds
from farhorizon.boundaries.extended import Extended
from farhorizon.boundaries.first_order import FirstOrder
from farhorizon.boundaries.higdon import Higdon
from farhorizon.boundaries.lattice_pml import LatticePML
from farhorizon.boundaries.nonlocal_pml import NonlocalPML
from farhorizon.boundaries.outline import Closing, Closure, Outline
from farhorizon.boundaries.plain import Fixed, Free, Periodic
from farhorizon.boundaries.plane_wave import PlaneWave
from farhorizon.boundaries.sponge import Sponge
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import AXES
from farhorizon.kinds import said

__all__ = [
    "Absorbing",
    "Auto",
    "Boundary",
    "Closing",
    "Closure",
    "Exact",
    "ExactEnds",
    "Extended",
    "FirstOrder",
    "Fixed",
    "Free",
    "Higdon",
    "LatticePML",
    "Margin",
    "NonlocalPML",
    "Outline",
    "Periodic",
    "PlaneWave",
    "Sponge",
    "sides",
]

#: Sides beyond which nodes of the medium itself are computed.
Margin = Sponge | Extended | PlaneWave | Higdon | FirstOrder
#: Sides beyond which the medium goes on.
Absorbing = LatticePML | Exact | Margin
Boundary = Absorbing | Fixed | Free | Periodic | Auto


def sides(
    boundary: Any | Mapping[str, Any], dim: int, kinds: Any = Boundary, remedy: str = ""
) -> dict[tuple[int, int], Any]:
    """One boundary for each (axis, side), side = -1 or +1.

    Parameters
    ----------
    boundary : Boundary or mapping
        One for all sides, or a mapping with keys "all", "x", "x-", "x+", "y", ...; the more specific key wins.
    dim : int
    kinds : type or union
        What may stand on a side.
    remedy : str
        For what may not.

    Raises
    ------
    InputError
        An unknown or superfluous key, a side without a boundary, Periodic on one side of an axis only, Exact in more
        than one dimension, conditions along an outline beside layers.
    """
    given: Mapping[str, Any] = boundary if isinstance(boundary, Mapping) else {"all": boundary}
    names = ["all"] + [AXES[a] + s for a in range(dim) for s in ("", "-", "+")]
    for key, value in given.items():
        if key not in names:
            raise InputError("unknown side", value=said(key), limit=", ".join(names), key="boundary")
        if not isinstance(value, kinds):
            known = ", ".join(sorted(kind.__name__ for kind in get_args(kinds) or (kinds,)))
            raise InputError(
                "not a boundary that serves here", value=said(value), key=f"boundary.{key}", limit=known, remedy=remedy
            )
    found: dict[tuple[int, int], Any] = {}
    for axis in range(dim):
        for side, sign in ((-1, "-"), (1, "+")):
            keys = [k for k in (AXES[axis] + sign, AXES[axis], "all") if k in given]
            if not keys:
                raise InputError(
                    "no boundary given for a side", value=AXES[axis] + sign, key="boundary", remedy='add it, or "all"'
                )
            found[axis, side] = given[keys[0]]
            if isinstance(found[axis, side], Exact) and dim > 1:
                raise InputError(
                    "the exact boundary is for one dimension",
                    value=f"{dim} dimensions",
                    key=f"boundary.{keys[0]}",
                    remedy="LatticePML",
                )
        if isinstance(found[axis, -1], Periodic) != isinstance(found[axis, 1], Periodic):
            raise InputError(
                "Periodic needs both sides of an axis",
                value=AXES[axis],
                key="boundary",
                remedy=f'"{AXES[axis]}" = Periodic',
            )
    _check_closing(found)
    return found


def _check_closing(found: Mapping[tuple[int, int], Boundary]) -> None:
    """Conditions along an outline stand beside fixed, free and periodic sides, which the halo can go by."""
    closing = [b for b in found.values() if isinstance(b, Closing)]
    others = {type(b).__name__ for b in found.values() if isinstance(b, LatticePML | Exact | Sponge | Extended)}
    if closing and others:
        raise InputError(
            f"{type(closing[0]).__name__} and {', '.join(sorted(others))} do not stand beside each other",
            key="boundary",
            limit="Fixed, Free, Periodic",
            remedy="the same absorber on all open sides",
        )
    layers = {b.layer for b in closing}
    if len(layers) > 1:
        raise InputError("sides of one box need one layer", value=sorted(map(str, layers)), key="boundary.layer")

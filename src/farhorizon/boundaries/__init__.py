"""Conditions on the sides of the near field, one file each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from farhorizon.boundaries.auto import Auto
from farhorizon.boundaries.exact import Exact, ExactEnds
from farhorizon.boundaries.extended import Extended
from farhorizon.boundaries.first_order import FirstOrder
from farhorizon.boundaries.higdon import Higdon
from farhorizon.boundaries.lattice_pml import LatticePML
from farhorizon.boundaries.nonlocal_pml import NonlocalPML
from farhorizon.boundaries.outline import Closing, Outline, OutlineCondition
from farhorizon.boundaries.plain import Fixed, Free, Periodic
from farhorizon.boundaries.plane_wave import PlaneWave
from farhorizon.boundaries.side import Side, names
from farhorizon.boundaries.sponge import Sponge
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import AXES
from farhorizon.kinds import said

__all__ = [
    "Auto",
    "Closing",
    "Exact",
    "ExactEnds",
    "Extended",
    "FirstOrder",
    "Fixed",
    "Free",
    "Higdon",
    "LatticePML",
    "NonlocalPML",
    "Outline",
    "OutlineCondition",
    "Periodic",
    "PlaneWave",
    "Side",
    "Sponge",
    "names",
    "sides",
]


def sides(boundary: Any | Mapping[str, Any], dim: int) -> dict[tuple[int, int], Any]:
    """Return one boundary for each (axis, side), side = -1 or +1.

    Parameters
    ----------
    boundary : Side or mapping
        One for all sides, or a mapping with keys "all", "x", "x-", "x+", "y", ...; the more specific key wins.
    dim : int

    Raises
    ------
    InputError
        An unknown or superfluous key, a side without a boundary, Periodic on one side of an axis only, Exact in more
        than one dimension, conditions along an outline beside layers.
    """
    given: Mapping[str, Any] = boundary if isinstance(boundary, Mapping) else {"all": boundary}
    known = ["all"] + [AXES[a] + s for a in range(dim) for s in ("", "-", "+")]
    for key, value in given.items():
        if key not in known:
            raise InputError("unknown side", value=said(key), limit=", ".join(known), key="boundary")
        if not isinstance(value, Side):
            raise InputError("not a boundary", value=said(value), key=f"boundary.{key}", limit=names(lambda kind: True))
    found: dict[tuple[int, int], Any] = {}
    for axis in range(dim):
        for side, sign in ((-1, "-"), (1, "+")):
            keys = [k for k in (AXES[axis] + sign, AXES[axis], "all") if k in given]
            if not keys:
                raise InputError(
                    "no boundary given for a side", value=AXES[axis] + sign, key="boundary", remedy='add it, or "all"'
                )
            found[axis, side] = given[keys[0]]
            one = found[axis, side]
            if dim not in one.dims:
                served = " or ".join(("one", "two", "three")[count - 1] for count in one.dims)
                raise InputError(
                    f"{type(one).__name__} is for {served} dimension{'s' * (one.dims != (1,))}",
                    value=f"{dim} dimensions",
                    key=f"boundary.{keys[0]}",
                    remedy="LatticePML",
                )
        if found[axis, -1].periodic != found[axis, 1].periodic:
            raise InputError(
                "Periodic needs both sides of an axis",
                value=AXES[axis],
                key="boundary",
                remedy=f'"{AXES[axis]}" = Periodic',
            )
    _check_closing(found)
    _check_derivatives(found)
    return found


def _check_derivatives(found: Mapping[tuple[int, int], Any]) -> None:
    """Refuse layers that stretch shifts and layers that stretch derivatives in the same set-up: they cannot share a
    corner.
    """
    for one in found.values():
        others = [b for b in found.values() if b.stretched]
        if one.derivatives and others:
            raise InputError(
                f"{type(one).__name__} and {type(others[0]).__name__} cannot be combined",
                key="boundary",
                limit="Fixed, Free, Sponge",
                remedy="the same layer on all open sides",
            )


def _check_closing(found: Mapping[tuple[int, int], Any]) -> None:
    """Refuse conditions along an outline beside layers: the halo can adapt only to fixed, free and periodic sides."""
    closing = [b for b in found.values() if b.closing]
    others = {type(b).__name__ for b in found.values() if b.endless and not b.closing}
    if closing and others:
        raise InputError(
            f"{type(closing[0]).__name__} and {', '.join(sorted(others))} cannot be combined",
            key="boundary",
            limit="Fixed, Free, Periodic",
            remedy="the same absorber on all open sides",
        )
    layers = {b.layer for b in closing}
    if len(layers) > 1:
        raise InputError("sides of one box need the same layer", value=sorted(map(str, layers)), key="boundary.layer")

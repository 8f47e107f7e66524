"""Conditions on the sides of the near field, one file each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from farhorizon.boundaries.auto import Auto
from farhorizon.boundaries.exact import Exact, ExactEnds
from farhorizon.boundaries.extended import Extended
from farhorizon.boundaries.first_order import FirstOrder
from farhorizon.boundaries.higdon import Higdon
from farhorizon.boundaries.impedance import Impedance
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
    "Impedance",
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
    """One boundary for each (axis, side), side = -1 or +1, from one for all sides or a mapping with keys "all", "x",
    "x-", "x+", "y", ...; the more specific key wins.

    An InputError for an unknown or superfluous key, a side without a boundary, Periodic on one side of an axis only,
    Exact in more than one dimension, or conditions along an outline beside layers.
    """
    given: Mapping[str, Any] = boundary if isinstance(boundary, Mapping) else {"all": boundary}
    known = ["all"] + [AXES[a] + s for a in range(dim) for s in ("", "-", "+")]
    for key, value in given.items():
        if key not in known:
            raise InputError("unknown side", value=said(key), limit=", ".join(known), key="boundary")
        if not isinstance(value, Side):
            raise InputError("not a boundary", value=said(value), key=f"boundary.{key}", limit=names(lambda kind: True))
    by_side: dict[tuple[int, int], Any] = {}
    for axis in range(dim):
        for side, sign in ((-1, "-"), (1, "+")):
            keys = [k for k in (AXES[axis] + sign, AXES[axis], "all") if k in given]
            if not keys:
                raise InputError(
                    "no boundary given for a side", value=AXES[axis] + sign, key="boundary", remedy='add it, or "all"'
                )
            by_side[axis, side] = given[keys[0]]
            chosen = by_side[axis, side]
            if dim not in chosen.dims:
                served = " or ".join(("one", "two", "three")[count - 1] for count in chosen.dims)
                raise InputError(
                    f"{type(chosen).__name__} is for {served} dimension{'s' * (chosen.dims != (1,))}",
                    value=f"{dim} dimensions",
                    key=f"boundary.{keys[0]}",
                    remedy="LatticePML",
                )
        if by_side[axis, -1].periodic != by_side[axis, 1].periodic:
            raise InputError(
                "Periodic needs both sides of an axis",
                value=AXES[axis],
                key="boundary",
                remedy=f'"{AXES[axis]}" = Periodic',
            )
    _check_closing(by_side)
    _check_derivatives(by_side)
    return by_side


def _check_derivatives(by_side: Mapping[tuple[int, int], Any]) -> None:
    """Refuse layers that stretch shifts and layers that stretch derivatives in the same set-up: they cannot share a
    corner.
    """
    for side in by_side.values():
        stretched = [b for b in by_side.values() if b.stretched]
        if side.derivatives and stretched:
            raise InputError(
                f"{type(side).__name__} and {type(stretched[0]).__name__} cannot be combined",
                key="boundary",
                limit="Fixed, Free, Sponge",
                remedy="the same layer on all open sides",
            )


def _check_closing(by_side: Mapping[tuple[int, int], Any]) -> None:
    """Refuse conditions along an outline beside layers: the halo can adapt only to fixed, free and periodic sides."""
    closing = [b for b in by_side.values() if b.closing]
    other_types = {type(b).__name__ for b in by_side.values() if b.endless and not b.closing}
    if closing and other_types:
        raise InputError(
            f"{type(closing[0]).__name__} and {', '.join(sorted(other_types))} cannot be combined",
            key="boundary",
            limit="Fixed, Free, Periodic",
            remedy="the same absorber on all open sides",
        )
    layers = {b.layer for b in closing}
    if len(layers) > 1:
        raise InputError("sides of one box need the same layer", value=sorted(map(str, layers)), key="boundary.layer")

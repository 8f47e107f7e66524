"""The set-up of displacements and a temperature, reduced to that of the displacements with a thermal load."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from farhorizon import kinds
from farhorizon.boundaries import Side, sides
from farhorizon.errors import InputError
from farhorizon.inputs.cracks import Crack
from farhorizon.inputs.prescribed import Prescribed
from farhorizon.inputs.thermal_loads import ThermalLoad, of_the_heat

U, T = "u", "T"  # names of the fields


def of_one_field(given: Mapping[str, Any], make: Callable[..., Any]) -> dict[str, Any]:
    """Turn the arguments for a `Setup`, by name, of a `Thermoelastic` into those of its solid with a thermal load;
    `make` makes a `Setup`.

    Raises InputError if a value is given for an unknown field, a coefficient is not given by field, or the set-up of
    the heat is refused, with a key that begins with "heat.".
    """
    model = given["model"]
    boundary = _by_field(given["boundary"], "boundary", both=True)
    sources = _by_field(given["sources"], "sources")
    coefficient = _by_field(given["coefficient"], "coefficient", none=given["coefficient"] is not None)
    initial = {} if given["initial"] is None else given["initial"]
    kinds.instance(initial, "initial", Mapping, "a mapping of fields to their values", remedy='{"T": ...}')
    constraints = kinds.sequence(given["constraints"], "constraints")
    cracks = kinds.sequence(given["cracks"], "cracks")
    with of_the_heat():
        heat = make(
            given["lattice"],
            model.heat,
            boundary[T],
            {U: initial[T]} if T in initial else None,
            () if sources[T] is None else sources[T],
            cracks,
            coefficient[T],
            model.reference,
            rule=given["rule"],
            dtype=given["dtype"],
            threads=given["threads"],
            rim=given["rim"],
            constraints=[condition for condition in constraints if not isinstance(condition, Prescribed)],
        )
    load = ThermalLoad(
        heat,
        model.expansion,
        model.reference,
        coupled=model.coupled,
        joint=_joint(boundary, heat),
        contact_conductance=model.contact_conductance,
    )
    return {
        "model": model.elastic,
        "boundary": boundary[U],
        "initial": {name: value for name, value in initial.items() if name != T},
        "sources": () if sources[U] is None else sources[U],
        "cracks": [replace(crack, factor=0.0) if isinstance(crack, Crack) else crack for crack in cracks],
        "coefficient": coefficient[U],
        "constraints": [condition for condition in constraints if isinstance(condition, Prescribed)],
        "loads": [*kinds.sequence(given["loads"], "loads"), load],
    }


def _joint(boundary: Mapping[str, Any], heat: Any) -> list[str]:
    """Return the names of the sides that are the same for both fields."""
    if boundary[U] is boundary[T]:
        return list(heat.boundary)
    if None in boundary.values():
        return []
    dim = heat.lattice.dim
    of_solid, of_heat = (sides(boundary[field], dim) for field in (U, T))
    return [
        name
        for name, key in zip(heat.boundary, of_heat, strict=True)
        if key in of_solid and _equal(of_solid[key], of_heat[key])
    ]


def _equal(side: Side, other: Side) -> bool:
    """Whether two sides are equal; sides with a profile of their own must be the same object."""
    return side is other or (side.profile is None and other.profile is None and side == other)


def _by_field(value: Any, key: str, both: bool = False, none: bool = False) -> dict[str, Any]:
    """Return a value for each field: those given by field, or one value for both fields if `both`, otherwise for the
    displacements alone. If `none`, the value must be given by field.
    """
    if isinstance(value, Mapping) and (value.keys() & {U, T} or none):
        for name in value:
            kinds.one_of(name, key, (U, T), "no such field")
        return {U: value.get(U), T: value.get(T)}
    if none:
        raise InputError(
            "of two fields each has its own",
            value=kinds.said(value),
            key=key,
            limit='{"u": ..., "T": ...}',
            remedy='{"T": ...} of the conductivity, {"u": ...} of the stiffness',
        )
    return {U: value, T: value if both else None}

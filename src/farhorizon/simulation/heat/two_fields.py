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
    """Turn the arguments for a set-up of a `Thermoelastic` into those for a set-up of its solid with a thermal load.

    Parameters
    ----------
    given : mapping
        Arguments of `Setup` by name.
    make : callable
        Makes a `Setup`.

    Raises
    ------
    InputError
        A value is given for an unknown field, or a coefficient is not given by field; the set-up of the heat is
        refused, with a key that begins with "heat.".
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
            constraints=[one for one in constraints if not isinstance(one, Prescribed)],
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
        "cracks": [replace(one, factor=0.0) if isinstance(one, Crack) else one for one in cracks],
        "coefficient": coefficient[U],
        "constraints": [one for one in constraints if isinstance(one, Prescribed)],
        "loads": [*kinds.sequence(given["loads"], "loads"), load],
    }


def _joint(boundary: Mapping[str, Any], heat: Any) -> list[str]:
    """Return the names of the sides that are the same for both fields."""
    if boundary[U] is boundary[T]:
        return list(heat.boundary)
    if None in boundary.values():
        return []
    dim = heat.lattice.dim
    mine, theirs = (sides(boundary[field], dim) for field in (U, T))
    return [
        name for name, key in zip(heat.boundary, theirs, strict=True) if key in mine and _same(mine[key], theirs[key])
    ]


def _same(mine: Side, theirs: Side) -> bool:
    """Whether two sides are equal; sides with a profile of their own must be the same object."""
    return mine is theirs or (mine.profile is None and theirs.profile is None and mine == theirs)


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

"""The set-up that the tables of a case file describe."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np

from farhorizon import public as fh
from farhorizon.case.case_values import Values, a_box, built, made, of_time
from farhorizon.case.schema import (
    CONDITIONS,
    BodyForcePart,
    ConstraintPart,
    CrackPart,
    CutPart,
    LatticePart,
    Part,
    PrescribedPart,
    PressurePart,
    SourcePart,
    ThermalPart,
    TractionPart,
    incident_kinds,
    side_kinds,
    source_kinds,
)
from farhorizon.errors import InputError, suggestion
from farhorizon.geometry.lattice import AXES
from farhorizon.medium.of_field import names_field
from farhorizon.simulation.setup import keys


def lattice_of(part: LatticePart) -> fh.Lattice:
    """The lattice of a case."""
    window = part.window.build("lattice.window") if part.window else None
    body = part.body.build("lattice.body") if part.body else None
    return fh.Lattice(part.spacing, part.lower, part.upper, window=window, body=body)


def setup_of(
    parts: Any, lattice: fh.Lattice, model: fh.LatticeModel, end: float, dt: float | Callable[[float], float]
) -> fh.Setup:
    """The set-up of a case.

    Parameters
    ----------
    parts : Part
        A validated case.
    lattice : Lattice
    model : LatticeModel
    end : float
        Length of the run for which layers without one of their own are designed.
    dt : float or callable
        The time step, or a function that computes it from the default one.

    Raises
    ------
    InputError
        What the object of a table itself refuses, with the key of the table.
    """
    read = Values(lattice.dim, model.mechanical)
    two = model.of_temperature is not None
    _check_fields(parts, two)
    if parts.load and not model.mechanical:
        raise InputError(
            "loads act on an elastic medium",
            value=parts.model.type,
            key="load",
            limit="elastic, correspondence",
            remedy="[[source]]",
        )
    return fh.Setup(
        lattice=lattice,
        model=model,
        initial=_initial(parts.initial, read),
        boundary=_boundaries(parts, lattice.dim, end, two),
        sources=_sources(parts, read, two),
        specimens=[
            fh.Specimen(s.region.build(f"specimen[{i}].region"), s.concentration) for i, s in enumerate(parts.specimen)
        ],
        cracks=[_crack(part, key) for part, key in _numbered("crack", parts.crack)],
        constraints=[_constraint(part, f"constraint[{i}]", read) for i, part in enumerate(parts.constraint)],
        coefficient=_coefficient(parts.coefficient, lattice, read),
        rule=parts.rule,
        rim=parts.rim,
        background=parts.background,
        loads=[_load(part, f"load[{i}]", read) for i, part in enumerate(parts.load)],
        balance=parts.output.balance,
        dt=dt,
        dtype=parts.run.dtype,
        threads=parts.run.threads,
    )


def _check_fields(parts: Any, two: bool) -> None:
    """Refuse keys for the temperature if the model has none."""
    given = {
        "initial.T": "T" in parts.initial,
        "boundary_T": bool(parts.boundary_T),
        "coefficient": isinstance(parts.coefficient, dict),
    }
    given |= {f"{key}.field": getattr(one, "field", "u") == "T" for one, key in _numbered("source", parts.source)}
    for key, there in given.items():
        if there and not two:
            raise InputError(
                "only a thermoelastic solid has a second field, the temperature T",
                value=parts.model.type,
                key=key,
                remedy='[model] type = "thermoelastic"',
            )


def _boundaries(parts: Any, dim: int, end: float, two: bool) -> Any:
    """Boundaries by side; for two fields, by field."""
    plain: Any = fh.LatticePML(until=end)
    found = _boundary(parts.boundary, "boundary", dim, end)
    if not two:
        return found or plain
    other = found | _boundary(parts.boundary_T, "boundary_T", dim, end)
    return {"u": found or plain, "T": other or plain}


def _sources(parts: Any, read: Values, two: bool) -> Any:
    """Sources and incident waves; for two fields, by field."""
    given = [
        (part, _source(part, key, Values(read.dim) if _heats(part) else read))
        for part, key in _numbered("source", parts.source)
    ]
    waves = [_incident(part, key) for part, key in _numbered("incident", parts.incident)]
    found = {heats: [one for part, one in given if _heats(part) == heats] for heats in (False, True)}
    return {"u": found[False] + waves, "T": found[True]} if two else found[False] + waves


def _heats(part: Part) -> bool:
    """Whether a source drives the temperature."""
    return getattr(part, "field", "u") == "T"


def _numbered(table: str, parts: list[Any]) -> list[tuple[Any, str]]:
    return list(zip(parts, keys(table, parts), strict=True))


def _initial(given: dict[str, Any], read: Values) -> dict[str, Any]:
    """Initial values, which must not depend on time."""
    return {name: read.expression(value, f"initial.{name}", time=False) for name, value in given.items()}


def _boundary(given: dict[str, Any], key: str, dim: int, end: float) -> dict[str, Any]:
    """Boundaries of the sides that are named."""
    boundary: dict[str, Any] = {}
    kinds = side_kinds()
    for side, part in given.items():
        values = part.model_dump(exclude={"type"}, exclude_none=True)
        if "until" in type(part).model_fields:
            values.setdefault("until", end)
        boundary[side] = made(kinds[part.type], f"{key}.{side}", **values)
    allowed = ["all"] + [AXES[a] + s for a in range(dim) for s in ("", "-", "+")]
    for side in boundary:
        if side not in allowed:
            raise InputError(
                "unknown side", value=side, limit=", ".join(allowed), key=key, remedy=suggestion(side, allowed)
            )
    return boundary


def _coefficient(given: Any, lattice: fh.Lattice, read: Values) -> Any:
    if given is None:
        return None
    if isinstance(given, dict):
        return {name: _coefficient(one, lattice, read) for name, one in given.items()}
    found = read.expression(given, "coefficient", time=False)
    return np.broadcast_to(found(*lattice.coordinates()) if callable(found) else found, lattice.shape)


def _source(part: Part, key: str, read: Values) -> Any:
    given = {"time": of_time(dict(part)["time"], f"{key}.time")} if "time" in part.model_fields_set else {}
    if not isinstance(part, SourcePart):
        return built(part, source_kinds(), key, **given)
    if names_field(part.value) and not given:
        return part.value
    value = read.expression(part.value, f"{key}.value")
    return fh.Source(value, **given) if given else value


def _incident(part: Part, key: str) -> Any:
    given = dict(part)
    changes = {"within": a_box(given["within"])}
    if "signal" in given:
        changes["signal"] = of_time(given["signal"], f"{key}.signal")
    return built(part, incident_kinds(), key, **changes)


def _load(
    part: TractionPart | PressurePart | BodyForcePart | ThermalPart, key: str, read: Values
) -> fh.Traction | fh.Pressure | fh.BodyForce | fh.ThermalLoad:
    if isinstance(part, ThermalPart):
        temperature = read.entry(part.temperature, f"{key}.temperature")
        expansion = read.steady(part.expansion, f"{key}.expansion")
        return made(fh.ThermalLoad, key, temperature, expansion, part.reference, part.every)
    factor = of_time(part.time, f"{key}.time")
    if isinstance(part, TractionPart):
        return made(fh.Traction, key, part.side, part.value, part.between, factor)
    if isinstance(part, PressurePart):
        on = _cut(part, key) if part.region is None else part.region.build(f"{key}.region")
        return made(fh.Pressure, key, on, part.value, factor)
    return made(fh.BodyForce, key, read.expression(part.value, f"{key}.value"), factor)


def _crack(part: CrackPart, key: str) -> Any:
    cut = _cut(part, key)
    return made(fh.Crack, key, cut, part.factor, part.opens) if part.factor or part.opens else cut


def _cut(part: CutPart, key: str) -> Any:
    given = [p for p in (part.points, part.rectangle, part.disc) if p is not None]
    if len(given) != 1:
        raise InputError("give exactly one of points, rectangle, disc", key=key)
    if part.points is not None:
        return part.points
    given_as: Any = given[0]
    cls: Any = fh.DiscCut if part.rectangle is None else fh.Rectangle
    try:
        return cls(**given_as)
    except TypeError:
        raise InputError(
            "a rectangle needs corner, edge1 and edge2; a disc needs centre, normal and radius", key=key
        ) from None


def _constraint(part: ConstraintPart | PrescribedPart, key: str, read: Values) -> Any:
    return _prescribed(part, key, read) if isinstance(part, PrescribedPart) else _condition(part, key, read)


def _prescribed(part: PrescribedPart, key: str, read: Values) -> fh.Prescribed:
    if (part.points is None) == (part.region is None):
        raise InputError("give either points or region", key=key)
    where = part.points if part.region is None else part.region.build(f"{key}.region")
    given = {name: read.of_times(getattr(part, name), f"{key}.{name}") for name in ("value", "velocity", "rate")}
    return made(fh.Prescribed, key, where, until=part.until, **given)


def _condition(part: ConstraintPart, key: str, read: Values) -> Any:
    if (part.side is None) == (part.region is None):
        raise InputError("give either a side or a region", key=key)
    make = CONDITIONS[part.type]
    # in case files the value is always called "value", whatever the class calls it
    names = {"value" if one.name == "ambient" else one.name: one.name for one in fields(make)}
    options: dict[str, Any] = {}
    for name in ("value", "kind", "transfer"):
        value = getattr(part, name)
        if value is not None and name not in names:
            raise InputError(
                f"a condition of type {part.type} has no such key",
                value=value,
                limit=", ".join(sorted(names.keys() - {"where", "within", "region"})),
                key=f"{key}.{name}",
            )
        if value is None and name in names and name != "kind":
            raise InputError(f"a condition of type {part.type} needs it", key=f"{key}.{name}")
        if value is not None:
            options[names[name]] = read.expression(value, f"{key}.{name}") if name == "value" else value
    if part.within is not None:
        options["within"] = part.within.build(f"{key}.within")
    where: Any = part.side if part.region is None else part.region.build(f"{key}.region")
    return made(make, key, where, **options)

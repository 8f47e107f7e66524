"""The recorders of a case file."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from farhorizon import public as fh
from farhorizon.case.case_values import a_box
from farhorizon.case.schema import FarFieldPart, PowerPart, ReceiversPart, SpectraPart, under
from farhorizon.errors import InputError
from farhorizon.geometry.interpolation import points_on_grid, points_on_line
from farhorizon.simulation.recorder import Observer

_BY_NAME = {"record", "every", "interpolation", "frequencies", "radii", "most"}  # keys passed to recorders by name


def recorders_of(parts: Any) -> list[Observer]:
    """New recorders, each for a single run.

    Parameters
    ----------
    parts : Part
        A validated case.

    Raises
    ------
    InputError
        What a recorder itself refuses, with the key of its table.
    """
    makers: dict[str, tuple[Callable[..., Observer], Callable[[Any, str], list[Any]]]] = {
        "receivers": (fh.Receivers, lambda part, key: [_where(part, key)]),
        "spectra": (fh.Spectra, lambda part, key: [_where(part, key)]),
        "power": (fh.PowerThrough, lambda part, key: [_surface(part, key)]),
        "stress_intensity": (fh.StressIntensity, lambda part, _: [part.tips]),
        "crack_tips": (fh.CrackTips, lambda *_: []),
        "shell": (fh.ShellRecorder, lambda part, _: [a_box(part.box)]),
    }
    found: list[Observer] = []
    for table, (make, places) in makers.items():
        given = getattr(parts, table)
        for i, part in enumerate(given):
            key = f"{table}[{i}]"
            name = part.name or (f"{table}_{i}" if len(given) > 1 else table)
            try:
                found.append(make(*places(part, key), **part.model_dump(include=_BY_NAME), name=name))
            except InputError as error:
                raise error.at(under(key, error.key)) from None
    if parts.far_field is not None:
        found.append(_far_field(parts.far_field))
    return found


def _far_field(part: FarFieldPart) -> fh.FarField:
    """The far field; its history is kept only if there are receivers or no frequencies."""
    options = part.model_dump(include={"frequencies", "points", "directions"})
    return fh.FarField(a_box(part.box), **options, history=part.points is not None or not part.frequencies)


def _surface(part: PowerPart, key: str) -> Any:
    """The region or the plane through which power is recorded."""
    if part.region is not None and part.axis is None and part.position is None:
        return part.region.build(f"{key}.region")
    if part.region is not None or part.axis is None or part.position is None:
        given = [name for name in ("region", "axis", "position") if getattr(part, name) is not None]
        raise InputError(
            "give either a region, or axis and position",
            value=", ".join(given) or "none",
            limit="one surface",
            key=key,
            remedy='axis = "x" and position = 2.0, or region = { ... }',
        )
    return part.axis, part.position


def _where(part: ReceiversPart | SpectraPart, key: str) -> Any:
    """The points, the region or the plane of a recorder."""
    region, plane = (part.region, (part.axis, part.position)) if isinstance(part, SpectraPart) else (None, (None, None))
    given = {"points": part.points, "line": part.line, "grid": part.grid, "region": region, "axis": plane[0]}
    if sum(place is not None for place in given.values()) != 1 or (plane[0] is None) != (plane[1] is None):
        known = [name if name != "axis" else "axis and position" for name in given if name in type(part).model_fields]
        several = ", ".join(name for name, place in given.items() if place is not None)
        raise InputError(
            f"give exactly one of {', '.join(known)}",
            value=several or "none",
            limit="1",
            key=key,
            remedy="leave the others out" if several else f"{known[0]} = ...",
        )
    if plane[0] is not None:
        return plane
    if part.line is not None:
        return points_on_line(**part.line.model_dump())
    if part.grid is not None:
        return points_on_grid(**part.grid.model_dump())
    return part.points if region is None else region.build(f"{key}.region")

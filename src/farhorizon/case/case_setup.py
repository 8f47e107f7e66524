"""The set-up and the recorders that the tables of a case file describe."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from farhorizon import public as fh
from farhorizon.case.reading import Reader
from farhorizon.case.schema import Part, key_of
from farhorizon.errors import InputError, suggestion
from farhorizon.geometry.lattice import AXES
from farhorizon.simulation.recorders.recorder import Observer, Recorder
from farhorizon.simulation.setup.setup import keys


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
    read = Reader(lattice.dim, model.mechanical)
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
        initial={
            name: read.expression(getattr(parts.initial, name), f"initial.{name}", time=False)
            for name in type(parts.initial).model_fields
            if name in parts.initial.model_fields_set
        },
        boundary=_boundaries(parts, read, end, two),
        sources=_sources(parts, read, two),
        specimens=[read.made(part, f"specimen[{i}]") for i, part in enumerate(parts.specimen)],
        cracks=[read.made(part, key) for part, key in _numbered("crack", parts.crack)],
        constraints=[read.made(part, f"constraint[{i}]") for i, part in enumerate(parts.constraint)],
        coefficient=_coefficient(parts.coefficient, lattice, read),
        rule=parts.rule,
        rim=parts.rim,
        background=parts.background,
        loads=[read.made(part, f"load[{i}]") for i, part in enumerate(parts.load)],
        balance=parts.output.balance,
        dt=dt,
        dtype=parts.run.dtype,
        threads=parts.run.threads,
    )


def recorders_of(parts: Any, dim: int) -> list[Observer]:
    """New recorders, each for a single run.

    Parameters
    ----------
    parts : Part
        A validated case.
    dim : int
        Number of axes of its lattice.

    Raises
    ------
    InputError
        What a recorder itself refuses, with the key of its table.
    """
    read, found = Reader(dim), []
    for kind in Recorder.known.values():
        table = key_of(kind)
        given = getattr(parts, table, None) or []
        several = given if isinstance(given, list) else [given]
        for i, part in enumerate(several):
            name = f"{table}_{i}" if len(several) > 1 else table
            named = {} if {"name"} & part.model_fields_set or "name" not in part.ARGUMENTS else {"name": name}
            found.append(read.made(part, f"{table}[{i}]" if several is given else table, **named))
    return found


def _check_fields(parts: Any, two: bool) -> None:
    """Refuse keys for the temperature if the model has none."""
    given = {
        "initial.T": "T" in parts.initial.model_fields_set,
        "boundary_T": bool(parts.boundary_T),
        "coefficient": isinstance(parts.coefficient, dict),
    }
    given |= {f"{key}.field": _heats(one) for one, key in _numbered("source", parts.source)}
    for key, there in given.items():
        if there and not two:
            raise InputError(
                "only a thermoelastic solid has a second field, the temperature T",
                value=parts.model.type,
                key=key,
                remedy='[model] type = "thermoelastic"',
            )


def _boundaries(parts: Any, read: Reader, end: float, two: bool) -> Any:
    """Boundaries by side; for two fields, by field."""
    usual: Any = fh.LatticePML(until=end)
    found = _boundary(parts.boundary, "boundary", read, end)
    if not two:
        return found or usual
    other = found | _boundary(parts.boundary_T, "boundary_T", read, end)
    return {"u": found or usual, "T": other or usual}


def _boundary(given: dict[str, Any], key: str, read: Reader, end: float) -> dict[str, Any]:
    """Boundaries of the sides that are named; those that need the length of the run have it."""
    allowed = ["all"] + [AXES[a] + s for a in range(read.dim) for s in ("", "-", "+")]
    for side in given:
        if side not in allowed:
            raise InputError(
                "unknown side", value=side, limit=", ".join(allowed), key=key, remedy=suggestion(side, allowed)
            )
    return {side: read.made(part, f"{key}.{side}", **_until(part, end)) for side, part in given.items()}


def _until(part: Any, end: float) -> dict[str, float]:
    """The length of the run for a side that has the key and is not given one."""
    return {"until": end} if "until" in part.ARGUMENTS and "until" not in part.model_fields_set else {}


def _sources(parts: Any, read: Reader, two: bool) -> Any:
    """Sources and incident waves; for two fields, by field."""
    found: dict[str, list[Any]] = {"u": [], "T": []}
    for part, key in _numbered("source", parts.source):
        heats = _heats(part)
        source = (Reader(read.dim) if heats else read).made(part, key)
        plain = isinstance(source, fh.Source) and source.time is None
        found["T" if heats else "u"].append(source.value if plain else source)
    found["u"] += [read.made(part, key) for part, key in _numbered("incident", parts.incident)]
    return found if two else found["u"]


def _heats(part: Part) -> bool:
    """Whether a source drives the temperature."""
    return getattr(part, "field", "u") == "T"


def _numbered(table: str, parts: list[Any]) -> list[tuple[Any, str]]:
    return list(zip(parts, keys(table, parts), strict=True))


def _coefficient(given: Any, lattice: fh.Lattice, read: Reader) -> Any:
    if given is None:
        return None
    if isinstance(given, dict):
        return {name: _coefficient(one, lattice, read) for name, one in given.items()}
    found = read.expression(given, "coefficient", time=False)
    return np.broadcast_to(found(*lattice.coordinates()) if callable(found) else found, lattice.shape)

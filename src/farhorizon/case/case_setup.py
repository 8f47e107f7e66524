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
    """The set-up of a validated case whose run, for which layers are designed, has the length `end`; `dt` is the time
    step, or a function of the default one. What the object of a table refuses is an InputError with its key.
    """
    read = Reader(lattice.dim, model.mechanical)
    heated = model.of_temperature is not None  # there are two fields
    _check_fields(parts, heated)
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
        boundary=_boundaries(parts, read, end, heated),
        sources=_sources(parts, read, heated),
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
    """New recorders of a validated case, each for a single run; what one refuses is an InputError with its key."""
    read, recorders = Reader(dim), []
    for recorder_class in Recorder.known.values():
        table = key_of(recorder_class)
        given = getattr(parts, table, None) or []
        entries = given if isinstance(given, list) else [given]
        for i, part in enumerate(entries):
            key = f"{table}[{i}]" if entries is given else table
            nameless = "name" in part.ARGUMENTS and "name" not in part.model_fields_set
            name = {"name": f"{table}_{i}" if len(entries) > 1 else table} if nameless else {}
            recorders.append(read.made(part, key, **name))
    return recorders


def _check_fields(parts: Any, heated: bool) -> None:
    """Refuse keys for the temperature if the model has none."""
    given = {
        "initial.T": "T" in parts.initial.model_fields_set,
        "boundary_T": bool(parts.boundary_T),
        "coefficient": isinstance(parts.coefficient, dict),
    }
    given |= {f"{key}.field": _heats(part) for part, key in _numbered("source", parts.source)}
    for key, is_given in given.items():
        if is_given and not heated:
            raise InputError(
                "only a thermoelastic solid has a second field, the temperature T",
                value=parts.model.type,
                key=key,
                remedy='[model] type = "thermoelastic"',
            )


def _boundaries(parts: Any, read: Reader, end: float, heated: bool) -> Any:
    """Boundaries by side; for two fields, by field."""
    usual: Any = fh.LatticePML(until=end)
    sides = _boundary(parts.boundary, "boundary", read, end)
    if not heated:
        return sides or usual
    of_temperature = sides | _boundary(parts.boundary_T, "boundary_T", read, end)
    return {"u": sides or usual, "T": of_temperature or usual}


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


def _sources(parts: Any, read: Reader, heated: bool) -> Any:
    """Sources and incident waves; for two fields, by field."""
    sources: dict[str, list[Any]] = {"u": [], "T": []}
    for part, key in _numbered("source", parts.source):
        heats = _heats(part)
        source = (Reader(read.dim) if heats else read).made(part, key)
        plain = isinstance(source, fh.Source) and source.time is None
        sources["T" if heats else "u"].append(source.value if plain else source)
    sources["u"] += [read.made(part, key) for part, key in _numbered("incident", parts.incident)]
    return sources if heated else sources["u"]


def _heats(part: Part) -> bool:
    """Whether a source drives the temperature."""
    return getattr(part, "field", "u") == "T"


def _numbered(table: str, parts: list[Any]) -> list[tuple[Any, str]]:
    return list(zip(parts, keys(table, parts), strict=True))


def _coefficient(given: Any, lattice: fh.Lattice, read: Reader) -> Any:
    if given is None:
        return None
    if isinstance(given, dict):
        return {name: _coefficient(value, lattice, read) for name, value in given.items()}
    factor = read.expression(given, "coefficient", time=False)
    return np.broadcast_to(factor(*lattice.coordinates()) if callable(factor) else factor, lattice.shape)

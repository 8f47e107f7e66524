"""The set-up, its model with its materials, and the recorders that the tables of a case file describe."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from farhorizon import public as fh
from farhorizon.case.reading import Reader
from farhorizon.case.schema import Part, is_model, key_of
from farhorizon.errors import InputError, shown, suggestion
from farhorizon.files.results_layout import Regions
from farhorizon.geometry.lattice import AXES
from farhorizon.simulation.recorders.recorder import Observer, Recorder
from farhorizon.simulation.setup.setup import keys

_NO_CONSTANTS = {"region", "of", "name"}  # keys of a material that are not constants


def model_of(table: Any, materials: Sequence[Any], lattice: fh.Lattice) -> fh.LatticeModel:
    """The model of the table [model] on a lattice, with the constants of the tables [[material]] in their regions,
    later ones over earlier ones; InputError for a constant or option that the model does not have, a region without a
    material or nodes.
    """
    read = Reader(lattice.dim)
    if models := models_in(table):
        inner = {name: _inner(name, nested, materials, lattice) for name, nested in models.items()}
        return read.made(table, "model", **inner)
    arguments = _in_regions(table, type(table).MAKER, materials, lattice)
    if (name := getattr(table, "stencil", None)) is not None and table.kernel is None:
        arguments["operator"] = _stencil(name, getattr(table, "order", None), lattice.dim)
    elif getattr(table, "order", None) is not None:
        raise _without_differences(table.order)
    if getattr(table, "stages", None) is not None:
        arguments["integrator"] = _integrator(table)
    return read.made(table, "model", **arguments)


def _stencil(name: str, order: int | None, dim: int) -> fh.Stencil:
    """The stencil of the classical operator by its name in a case file."""
    if name == "finite-difference":
        try:
            return fh.Stencil.finite_difference(dim, 2 if order is None else order)
        except InputError as error:
            raise error.at("model.order") from None
    if order is not None:
        raise _without_differences(order)
    return fh.Stencil.finite_element(dim)


def _without_differences(order: int) -> InputError:
    return InputError(
        "the order is that of finite differences",
        value=order,
        limit='stencil = "finite-difference"',
        key="model.order",
        remedy="this stencil, or leave the order out",
    )


def _inner(name: str, table: Any, materials: Sequence[Any], lattice: fh.Lattice) -> fh.LatticeModel:
    """A model that is part of another one; only that of the displacements has materials."""
    try:
        return model_of(table, materials if type(table).MAKER.mechanical else (), lattice)
    except InputError as error:
        raise error.at(error.key.replace("model", f"model.{name}", 1)) from None


def _in_regions(table: Any, model: Any, materials: Sequence[Any], lattice: fh.Lattice) -> dict[str, Any]:
    """The constants of a class of models to which materials give other values in their regions."""
    _check(materials)
    last = {name: i for i, material in enumerate(materials) for name in material.model_fields_set - _NO_CONSTANTS}
    for name in sorted(last):
        if getattr(table, name, None) is None:
            constants = {key for key, value in table if value is not None} - _NO_CONSTANTS
            raise InputError(
                "a region has constants that the model has, too",
                value=name,
                limit=", ".join(sorted(constants & type(materials[0]).model_fields.keys())) or "none",
                key=f"material[{last[name]}].{name}",
                remedy=f"give [model] its {name}, of what is elsewhere" if name in table.ARGUMENTS else "leave it out",
            )
    return {name: _constant(model, name, getattr(table, name), materials, lattice) for name in sorted(last)}


def named_materials(table: Any, materials: Sequence[Any], lattice: fh.Lattice) -> Regions | None:
    """Nodes by material name, "" where a material has none; None if no material has a name."""
    names = [_material_name(table)]
    numbers = np.zeros(lattice.shape, np.int32)
    for i, material in enumerate(materials):
        if name := _material_name(material):
            names += [] if name in names else [name]
            numbers[_inside(material, i, lattice)] = names.index(name)
    return Regions(numbers, tuple(names)) if any(names) else None


def models_in(part: Any) -> dict[str, Any]:
    """The tables of the models that a model is composed of, by key."""
    return {name: table for name, table in part if isinstance(table, Part) and is_model(type(table).MAKER)}


def _material_name(table: Any) -> str:
    """Name that a table gives its material; "" if none."""
    for nested in models_in(table).values():
        return _material_name(nested)
    return getattr(table, "name", None) or getattr(table, "of", None) or ""


def _integrator(table: Any) -> fh.RungeKuttaChebyshev:
    if table.integrator != "rkc":
        raise InputError(
            "only Runge-Kutta-Chebyshev has stages to choose", value=table.integrator, limit="rkc", key="model.stages"
        )
    return fh.RungeKuttaChebyshev(table.stages)


def _check(materials: Sequence[Any]) -> None:
    for i, table in enumerate(materials):
        if not table.model_fields_set - {"region", "name"}:
            raise InputError(
                "a region without a material",
                key=f"material[{i}]",
                limit=", ".join(sorted(set(type(table).model_fields) - {"region", "name"})),
                remedy="give it constants, or leave it out",
            )


def _constant(
    model: type[fh.LatticeModel], name: str, value: Any, materials: Sequence[Any], lattice: fh.Lattice
) -> np.ndarray:
    """Values of a constant at the nodes, with those given in regions."""
    read = Reader(lattice.dim)
    elsewhere = read.constant(value, f"model.{name}")
    at = lattice.coordinates()
    values = np.array(np.broadcast_to(elsewhere(*at) if callable(elsewhere) else elsewhere, lattice.shape), float)
    for i, table in enumerate(materials):
        if getattr(table, name) is None:
            continue
        nodes = _inside(table, i, lattice)
        if not nodes.any():
            raise InputError(
                "the region has no node of the near field",
                value=read.region(table.region, f"material[{i}].region"),
                limit=f"{shown(lattice.lower)} to {shown(lattice.upper)}",
                key=f"material[{i}].region",
                remedy="move it inside, enlarge it, or refine the lattice",
            )
        key = f"material[{i}].{name}"
        inside = read.constant(getattr(table, name), key)
        values[nodes] = inside(*(x[nodes] for x in at)) if callable(inside) else inside
        model.check_constant(name, values[nodes], key)
    return values


def _inside(material: Any, number: int, lattice: fh.Lattice) -> np.ndarray:
    """Mask of the nodes in the region of a material."""
    region = Reader(lattice.dim).region(material.region, f"material[{number}].region")
    return region.contains(np.stack(lattice.coordinates(), -1))


def setup_of(
    parts: Any,
    lattice: fh.Lattice,
    model: fh.LatticeModel,
    end: float,
    dt: float | Callable[[float], float] | fh.LoadSteps,
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
        specimens=[read.made(table, f"specimen[{i}]") for i, table in enumerate(parts.specimen)],
        cracks=[read.made(table, key) for table, key in _numbered("crack", parts.crack)],
        constraints=[read.made(table, f"constraint[{i}]") for i, table in enumerate(parts.constraint)],
        coefficient=_coefficient(parts.coefficient, lattice, read),
        rule=parts.rule,
        rim=parts.rim,
        background=parts.background,
        loads=[read.made(table, f"load[{i}]") for i, table in enumerate(parts.load)],
        balance=parts.output.balance,
        dt=dt,
        dtype=parts.run.dtype,
        threads=parts.run.threads,
    )


def recorders_of(parts: Any, dim: int) -> list[Observer]:
    """New recorders of a validated case, each for a single run; what one refuses is an InputError with its key."""
    read, recorders = Reader(dim), []
    for recorder_class in Recorder.known.values():
        tables = key_of(recorder_class)
        given = getattr(parts, tables, None) or []
        entries = given if isinstance(given, list) else [given]
        for i, table in enumerate(entries):
            key = f"{tables}[{i}]" if entries is given else tables
            nameless = "name" in table.ARGUMENTS and "name" not in table.model_fields_set
            name = {"name": f"{tables}_{i}" if len(entries) > 1 else tables} if nameless else {}
            recorders.append(read.made(table, key, **name))
    return recorders


def _check_fields(parts: Any, heated: bool) -> None:
    """Refuse keys for the temperature if the model has none."""
    given = {
        "initial.T": "T" in parts.initial.model_fields_set,
        "boundary_T": bool(parts.boundary_T),
        "coefficient": isinstance(parts.coefficient, dict),
    }
    given |= {f"{key}.field": _heats(table) for table, key in _numbered("source", parts.source)}
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
    return {side: read.made(table, f"{key}.{side}", **_until(table, end)) for side, table in given.items()}


def _until(table: Any, end: float) -> dict[str, float]:
    """The length of the run for a side that has the key and is not given one."""
    return {"until": end} if "until" in table.ARGUMENTS and "until" not in table.model_fields_set else {}


def _sources(parts: Any, read: Reader, heated: bool) -> Any:
    """Sources and incident waves; for two fields, by field."""
    sources: dict[str, list[Any]] = {"u": [], "T": []}
    for table, key in _numbered("source", parts.source):
        heats = _heats(table)
        source = (Reader(read.dim) if heats else read).made(table, key)
        plain = isinstance(source, fh.Source) and source.time is None
        sources["T" if heats else "u"].append(source.value if plain else source)
    sources["u"] += [read.made(table, key) for table, key in _numbered("incident", parts.incident)]
    return sources if heated else sources["u"]


def _heats(table: Part) -> bool:
    """Whether a source drives the temperature."""
    return getattr(table, "field", "u") == "T"


def _numbered(table: str, parts: list[Any]) -> list[tuple[Any, str]]:
    return list(zip(parts, keys(table, parts), strict=True))


def _coefficient(given: Any, lattice: fh.Lattice, read: Reader) -> Any:
    if given is None:
        return None
    if isinstance(given, dict):
        return {name: _coefficient(value, lattice, read) for name, value in given.items()}
    factor = read.expression(given, "coefficient", time=False)
    return np.broadcast_to(factor(*lattice.coordinates()) if callable(factor) else factor, lattice.shape)

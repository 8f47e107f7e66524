"""The model of a case file, with its materials."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from farhorizon import public as fh
from farhorizon.case.reading import Reader
from farhorizon.case.schema import Part, is_model
from farhorizon.errors import InputError, shown
from farhorizon.files.region_numbers import Regions

_NO_CONSTANTS = {"region", "of", "name"}  # keys of a material that are not constants


def model_of(part: Any, materials: Sequence[Any], lattice: fh.Lattice) -> fh.LatticeModel:
    """The model of the table [model] on a lattice, with the constants of the tables [[material]] in their regions,
    where later ones override earlier ones; InputError for a constant or an option that the model does not have, and a
    region without a material or without nodes.
    """
    read = Reader(lattice.dim)
    if models := models_in(part):
        inner = {name: _inner(name, table, materials, lattice) for name, table in models.items()}
        return read.made(part, "model", **inner)
    arguments = _in_regions(part, type(part).MAKER, materials, lattice)
    if (name := getattr(part, "stencil", None)) is not None and part.kernel is None:
        arguments["operator"] = _stencil(name, getattr(part, "order", None), lattice.dim)
    elif getattr(part, "order", None) is not None:
        raise _without_differences(part.order)
    if getattr(part, "stages", None) is not None:
        arguments["integrator"] = _integrator(part)
    return read.made(part, "model", **arguments)


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


def _inner(name: str, part: Any, materials: Sequence[Any], lattice: fh.Lattice) -> fh.LatticeModel:
    """A model that is part of another one; only that of the displacements has materials."""
    try:
        return model_of(part, materials if type(part).MAKER.mechanical else (), lattice)
    except InputError as error:
        raise error.at(error.key.replace("model", f"model.{name}", 1)) from None


def _in_regions(part: Any, model: Any, materials: Sequence[Any], lattice: fh.Lattice) -> dict[str, Any]:
    """The constants of a class of models to which materials give other values in their regions."""
    _check(materials)
    last = {name: i for i, material in enumerate(materials) for name in material.model_fields_set - _NO_CONSTANTS}
    for name in sorted(last):
        if getattr(part, name, None) is None:
            constants = {key for key, value in part if value is not None} - _NO_CONSTANTS
            raise InputError(
                "a region has constants that the model has, too",
                value=name,
                limit=", ".join(sorted(constants & type(materials[0]).model_fields.keys())) or "none",
                key=f"material[{last[name]}].{name}",
                remedy=f"give [model] its {name}, of what is elsewhere" if name in part.ARGUMENTS else "leave it out",
            )
    return {name: _constant(model, name, getattr(part, name), materials, lattice) for name in sorted(last)}


def named_materials(part: Any, materials: Sequence[Any], lattice: fh.Lattice) -> Regions | None:
    """Nodes by material name, "" where a material has none; None if no material has a name."""
    names = [_material_name(part)]
    numbers = np.zeros(lattice.shape, np.int32)
    for i, material in enumerate(materials):
        if name := _material_name(material):
            names += [] if name in names else [name]
            numbers[_inside(material, i, lattice)] = names.index(name)
    return Regions(numbers, tuple(names)) if any(names) else None


def models_in(part: Any) -> dict[str, Any]:
    """The tables of the models that a model is composed of, by key."""
    return {name: table for name, table in part if isinstance(table, Part) and is_model(type(table).MAKER)}


def _material_name(part: Any) -> str:
    """Name that a table gives its material; "" if none."""
    for table in models_in(part).values():
        return _material_name(table)
    return getattr(part, "name", None) or getattr(part, "of", None) or ""


def _integrator(part: Any) -> fh.RungeKuttaChebyshev:
    if part.integrator != "rkc":
        raise InputError(
            "only Runge-Kutta-Chebyshev has stages to choose", value=part.integrator, limit="rkc", key="model.stages"
        )
    return fh.RungeKuttaChebyshev(part.stages)


def _check(materials: Sequence[Any]) -> None:
    for i, part in enumerate(materials):
        if not part.model_fields_set - {"region", "name"}:
            raise InputError(
                "a region without a material",
                key=f"material[{i}]",
                limit=", ".join(sorted(set(type(part).model_fields) - {"region", "name"})),
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
    for i, part in enumerate(materials):
        if getattr(part, name) is None:
            continue
        nodes = _inside(part, i, lattice)
        if not nodes.any():
            raise InputError(
                "the region has no node of the near field",
                value=read.region(part.region, f"material[{i}].region"),
                limit=f"{shown(lattice.lower)} to {shown(lattice.upper)}",
                key=f"material[{i}].region",
                remedy="move it inside, enlarge it, or refine the lattice",
            )
        key = f"material[{i}].{name}"
        inside = read.constant(getattr(part, name), key)
        values[nodes] = inside(*(x[nodes] for x in at)) if callable(inside) else inside
        model.check_constant(name, values[nodes], key)
    return values


def _inside(material: Any, number: int, lattice: fh.Lattice) -> np.ndarray:
    """Mask of the nodes in the region of a material."""
    region = Reader(lattice.dim).region(material.region, f"material[{number}].region")
    return region.contains(np.stack(lattice.coordinates(), -1))

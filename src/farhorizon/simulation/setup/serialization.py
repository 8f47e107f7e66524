"""Set-ups as plain data, from which a checkpoint can rebuild the simulation: JSON and arrays, no pickle."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np

from farhorizon.boundaries import Side
from farhorizon.errors import InputError
from farhorizon.files.storable import Storable
from farhorizon.geometry.lattice import Lattice
from farhorizon.models import LatticeModel
from farhorizon.models.model import INTEGRATORS, WAVE_INTEGRATORS
from farhorizon.simulation.setup.setup import Setup


def _types() -> dict[str, type]:
    """Classes whose objects can be described, by name."""
    return LatticeModel.known | Side.known | Storable.stored_as | {"Setup": Setup}


def arguments_of(value: Any) -> dict[str, Any] | None:
    """Arguments from which an object can be made again; None for one of a class that is not known."""
    if _types().get(type(value).__name__) is not type(value):
        return None
    names = list(inspect.signature(type(value)).parameters)
    if isinstance(value, Lattice) and value.window is not None:
        names = ["spacing", "window", "body"]
    return {name: getattr(value, name) for name in names}


def describe(value: Any, arrays: dict[str, np.ndarray]) -> Any:
    """A value as JSON; arrays are added to `arrays` under new names.

    Every described class keeps its constructor's arguments as attributes of the same name. A callable has no
    description and becomes a marker that `rebuild` refuses.
    """
    if isinstance(value, np.ndarray) and value.size > 8:
        name = f"setup{len(arrays)}"
        arrays[name] = value
        return {"array": name}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    for name, integrator in (INTEGRATORS | WAVE_INTEGRATORS).items():
        if value is integrator:
            return name
    if (given := arguments_of(value)) is not None:
        return {"type": type(value).__name__, "arguments": {n: describe(part, arrays) for n, part in given.items()}}
    if isinstance(value, dict):
        return {"dict": {k: describe(v, arrays) for k, v in value.items()}}
    if isinstance(value, list | tuple):
        return [describe(v, arrays) for v in value]
    if value is None or isinstance(value, str | bool | int | float):
        return value
    return {"callable": getattr(value, "__qualname__", type(value).__name__)}


def rebuild(value: Any, arrays: dict[str, np.ndarray], key: str = "") -> Any:
    """Rebuild a value from its description by `describe`; InputError for an object of an unknown class, or a callable,
    which only the program that made it can provide again.
    """
    if isinstance(value, list):
        return [rebuild(v, arrays, key) for v in value]
    if not isinstance(value, dict):
        return value
    if "array" in value:
        return arrays[value["array"]]
    if "dict" in value:
        return {k: rebuild(v, arrays, f"{key}.{k}") for k, v in value["dict"].items()}
    if "callable" in value:
        raise InputError(
            "a checkpoint cannot hold a Python function",
            value=value["callable"],
            key=key,
            remedy=f"Simulation.restore(path, {key.split('.')[0]}=...)",
        )
    if value["type"] not in _types():
        raise InputError(
            "a set-up holds an object of a class that is not known here",
            value=value["type"],
            key=key,
            remedy="import the module that defines it first",
        )
    return _types()[value["type"]](**{k: rebuild(v, arrays, key) for k, v in value["arguments"].items()})

"""Scalars that are drawn from fields: components and lengths of vectors, and quantities derived from them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from operator import itemgetter
from typing import TYPE_CHECKING, Literal

import numpy as np

from farhorizon.errors import InputError
from farhorizon.pictures.panels import magnitude

if TYPE_CHECKING:
    from farhorizon.files.results import Results


@dataclass(frozen=True)
class Scalar:
    """A scalar that is drawn: a field, the length or a component of a vector field, or a quantity derived from it."""

    name: str  # in file names, and in requests
    label: str
    field: str
    of: Callable[[np.ndarray], np.ndarray]  # its values from those of the field
    pure: bool = False  # whether it is a number without a unit

    @property
    def quantity(self) -> str:
        """Quantity whose unit it has; empty without a unit."""
        if self.field.startswith("stress_"):
            return "stress"
        return "" if self.pure else "time" if self.field == "dissolved" else self.field


def parts_of(components: Mapping[str, int]) -> Iterator[Scalar]:
    """The fields with one of so many components; of vectors, their length and components."""
    for name, count in components.items():
        if count == 1:
            yield Scalar(name, name, name, lambda values: values)
            continue
        yield Scalar(name, f"|{name}|", name, magnitude)
        for i, axis in enumerate("xyz"[:count]):
            yield Scalar(f"{name}_{axis}", f"{name}_{axis}", name, itemgetter(i))


def _derived(results: Results) -> Iterator[Scalar]:
    """Scalars of vector fields in 2D and 3D that are drawn on request: divergence and curl, which show P and S
    waves."""
    for name in results.field_names:
        if results.components[name] == results.dim > 1:
            yield Scalar(f"{name}_divergence", f"div {name}", name, partial(_divergence, results.spacing), True)
            yield Scalar(f"{name}_curl", f"curl {name}", name, partial(_curl, results.spacing), True)


def _slopes(spacing: float, values: np.ndarray) -> np.ndarray:
    """Derivatives of a vector field along the axes by second-order differences, shape (dim, dim, ...)."""
    axes = tuple(range(len(values)))
    order: Literal[1, 2] = 2 if min(values.shape[1:]) > 2 else 1
    return np.stack([np.stack(np.gradient(component, spacing, axis=axes, edge_order=order)) for component in values])


def _divergence(spacing: float, values: np.ndarray) -> np.ndarray:
    return np.asarray(np.trace(_slopes(spacing, values)))


def _curl(spacing: float, values: np.ndarray) -> np.ndarray:
    """Curl: in 2D its component normal to the plane, in 3D its length."""
    slopes = _slopes(spacing, values)
    parts = [slopes[i, j] - slopes[j, i] for i, j in ((1, 0), (2, 1), (0, 2))[: 1 if len(values) == 2 else 3]]
    return parts[0] if len(parts) == 1 else magnitude(np.stack(parts))


def wanted_scalars(results: Results, names: Sequence[str] | None) -> list[Scalar]:
    """Scalars with the given names, or those of all fields if `names` is None; InputError for an unknown name."""
    plain = {
        scalar.name: scalar for scalar in parts_of({name: results.components[name] for name in results.field_names})
    }
    known = plain | {scalar.name: scalar for scalar in _derived(results)}
    stresses = [name for name in plain if name.startswith("stress_")]
    if names is not None and stresses:
        names = [part for name in names for part in (stresses if name == "stress" else [name])]
    for name in names or ():
        if name not in known:
            raise InputError("the file has no such field", value=name, limit=", ".join(known), key="--field")
    return [known[name] for name in (plain if names is None else dict.fromkeys(names))]

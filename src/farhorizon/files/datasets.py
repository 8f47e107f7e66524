"""Fields and records as xarray Datasets, if xarray is installed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from farhorizon.errors import InputError

if TYPE_CHECKING:
    import xarray


def xarray_module() -> Any:
    """The module xarray; InputError if it is not installed."""
    try:
        import xarray
    except ImportError as error:
        raise InputError("xarray is not installed", remedy="pip install 'farhorizon[xarray]'") from error
    return xarray


def dataset(
    fields: Mapping[str, np.ndarray], axes: Sequence[np.ndarray], moment: Mapping[str, float]
) -> xarray.Dataset:
    """Fields at one time as an xarray Dataset; vectors have their components first."""
    names = ("x", "y", "z")[: len(axes)]
    data = {name: (("component", *names)[-values.ndim :], values) for name, values in fields.items()}
    coords: dict[str, Any] = {**dict(zip(names, axes, strict=True)), **moment}
    if any(values.ndim > len(axes) for values in fields.values()):
        coords["component"] = list(names)
    return xarray_module().Dataset(data, coords)


def put_units(variables: xarray.Dataset, units: Mapping[str, str], quantities: Mapping[str, tuple[str, ...]]) -> None:
    """Set the units of the variables of a Dataset, as far as those of the quantities that multiply to them are known; a
    variable without an entry measures the quantity of its own name.
    """
    for name in variables.variables:
        factors = [units.get(quantity) for quantity in quantities.get(str(name), (str(name),))]
        if all(factors):
            variables[name].attrs["units"] = " ".join(map(str, factors))

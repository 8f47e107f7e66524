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
    """Fields at one time as an xarray Dataset; vectors have their components first.

    Raises
    ------
    InputError
        xarray is not installed.
    """
    names = ("x", "y", "z")[: len(axes)]
    data = {name: (("component", *names)[-values.ndim :], values) for name, values in fields.items()}
    coords: dict[str, Any] = {**dict(zip(names, axes, strict=True)), **moment}
    if any(values.ndim > len(axes) for values in fields.values()):
        coords["component"] = list(names)
    return xarray_module().Dataset(data, coords)


def put_units(
    whole: xarray.Dataset, units: Mapping[str, str], measured: Mapping[str, str], spectra: Mapping[str, str]
) -> None:
    """Set the units of the variables of a Dataset, as far as they are known.

    Parameters
    ----------
    whole : xarray.Dataset
    units : mapping of str to str
        Units by the quantity that they measure.
    measured : mapping of str to str
        What variables measure, where it is not their own name.
    spectra : mapping of str to str
        Variables that are integrals over time, and the quantities that they integrate.
    """
    for name in whole.variables.keys() & (measured.keys() | units.keys()):
        if unit := units.get(measured.get(str(name), str(name))):
            whole[name].attrs["units"] = unit
    for name, quantity in spectra.items():
        if (unit := units.get(quantity)) and "time" in units:
            whole[name].attrs["units"] = f"{unit} {units['time']}"

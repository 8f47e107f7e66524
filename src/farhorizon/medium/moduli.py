"""Constants of isotropic elasticity, computed from any two of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from farhorizon.errors import InputError

_PAIRS = "two of young, poisson, bulk, shear"
_MODULI = "one of young, bulk, shear"
_CLOSE = 1e-6  # tolerance for Poisson's ratio, and for moduli relative to their value


class Moduli(NamedTuple):
    """Constants of an isotropic solid, numbers or arrays.

    In plane stress `lame` is the constant of the plane; the others are always those of space.
    """

    young: Any
    poisson: Any
    bulk: Any
    shear: Any
    lame: Any


def moduli_of(
    given: Mapping[str, Any], fixed: float | None, plane: str | None, material: str, combinations: str
) -> Moduli:
    """All constants from two of young, poisson, bulk and shear, or one modulus where Poisson's ratio is fixed; an
    InputError for too few constants, constants that do not agree, or a Poisson's ratio that the material cannot have.

    `material` and `combinations` are used in messages: the name of the material, and the combinations that allow other
    Poisson's ratios.
    """
    nu = given.get("poisson", _poisson(given, fixed))
    if nu is None or not set(given) - {"poisson"}:
        is_fixed = fixed is not None
        raise InputError(
            f"a {material} material needs {'one modulus' if is_fixed else 'two elastic constants'}",
            value=f"only {', '.join(sorted(given))}" if given else "none",
            limit=_MODULI if is_fixed else _PAIRS,
            key="model",
            remedy="give young" if is_fixed else "give young and poisson",
        )
    check_ratio(nu, "model.poisson")
    if fixed is not None:
        for ratio in {float(np.min(nu)), float(np.max(nu))}:
            _check_fixed(ratio, fixed, plane, combinations)
    if "shear" in given:
        shear = given["shear"]
    elif "young" in given:
        shear = given["young"] / (2 * (1 + nu))
    else:
        shear = 3 * given["bulk"] * (1 - 2 * nu) / (2 * (1 + nu))
    space = 2 * shear * nu / (1 - 2 * nu)
    lame = 2 * space * shear / (space + 2 * shear) if plane == "stress" else space
    moduli = Moduli(2 * shear * (1 + nu), nu, space + 2 * shear / 3, shear, lame)
    for name, value in given.items():
        apart = np.abs(getattr(moduli, name) - value)
        if np.any(apart > _CLOSE * np.maximum(np.abs(value), 1.0 if name == "poisson" else 0.0)):
            worst = int(np.argmax(apart))
            pair = (value, getattr(moduli, name))
            wrong, right = (np.broadcast_to(constant, np.shape(apart)).flat[worst] for constant in pair)
            raise InputError(
                "elastic constants do not agree",
                value=float(wrong),
                limit=f"{right:.6g}",
                key=f"model.{name}",
                remedy="give two of them",
            )
    return moduli


def check_ratio(values: np.ndarray | float, key: str) -> None:
    """Refuse a Poisson's ratio that no solid has with an InputError for the given key."""
    for nu in (float(np.max(values)), float(np.min(values))) if np.size(values) else ():
        if not -1 < nu < 0.5:
            raise InputError(
                "Poisson's ratio is out of range",
                value=nu,
                limit="above -1, below 0.5",
                key=key,
                remedy="0.49 for a nearly incompressible material" if nu >= 0.5 else "most solids have 0 to 0.49",
            )


def _check_fixed(nu: float, fixed: float, plane: str | None, combinations: str) -> None:
    if abs(nu - fixed) > _CLOSE:
        state = "plane stress" if plane == "stress" else "three dimensions and plane strain"
        raise InputError(
            f"bond-based materials have one Poisson's ratio, in {state}",
            value=nu,
            limit=fixed,
            key="model.poisson",
            remedy=f"leave it out, or give {fixed:.6g}, which keeps the modulus that is given. {combinations}",
        )


def _poisson(given: Mapping[str, Any], fixed: float | None) -> Any:
    """Poisson's ratio from two moduli; from one, the fixed ratio of the material, or None if it has none."""
    if {"young", "shear"} <= set(given):
        return given["young"] / (2 * given["shear"]) - 1
    if {"bulk", "shear"} <= set(given):
        return (3 * given["bulk"] - 2 * given["shear"]) / (6 * given["bulk"] + 2 * given["shear"])
    if {"young", "bulk"} <= set(given):
        return (3 * given["bulk"] - given["young"]) / (6 * given["bulk"])
    return fixed

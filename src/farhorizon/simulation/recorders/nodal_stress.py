"""Stress at the nodes of a run, defined as receivers define it at points: central differences of u, the moduli of each
node, and the formula of `farhorizon.simulation.recorders.quantities`.

Differences are one-sided at edges and holes, and next to open cracks; nodes with broken bonds are left out.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations_with_replacement
from typing import Any

import numpy as np

from farhorizon.errors import InputError
from farhorizon.simulation.recorders.quantities import QUANTITIES, LocalModuli, Reading

NAME = "stress"
"""Name under which all components of the stress are requested."""
_MISES = "stress_von_mises"
_BESIDE = 2  # nodes to either side that a difference uses


def stress_names(dim: int) -> list[str]:
    """Return the names of the components in a number of dimensions, from two on with the von Mises stress."""
    parts = [f"{NAME}_{a}{b}" for a, b in combinations_with_replacement("xyz"[:dim], 2)]
    return parts if dim == 1 else [*parts, _MISES]


def fields_of(run: Any, names: Iterable[str]) -> dict[str, np.ndarray]:
    """Return fields of a run by name, as they are now; the stress is computed if requested.

    Raises
    ------
    InputError
        There is no field of this name.
    """
    wanted = list(names)
    held = shown_fields(run, next((name for name in wanted if name.startswith(NAME)), ""))
    if NAME in wanted and QUANTITIES[NAME].has(run.model):
        wanted = [part for name in wanted for part in (stress_names(run.lattice.dim) if name == NAME else [name])]
    for name in wanted:
        if name not in held:
            more = [NAME] * (NAME not in held and QUANTITIES[NAME].has(run.model))
            raise InputError("the run has no such field", value=name, key="fields", limit=", ".join([*held, *more]))
    return {name: held[name] for name in wanted}


def shown_fields(run: Any, name: str) -> dict[str, np.ndarray]:
    """Return the fields of a run, and its stress if `name` requests it."""
    asked = isinstance(name, str) and name.startswith(NAME) and QUANTITIES[NAME].has(run.model)
    return run.fields | (nodal_stress(run) if asked else {})


def nodal_stress(run: Any) -> dict[str, np.ndarray]:
    """Return the components of the stress at the nodes, and the von Mises stress, by name; nan where undefined, as at
    broken bonds and across a body one node thick.

    In two dimensions the components are those in the plane; the von Mises stress includes the normal stress across it.
    All processes must call it.
    """
    near, lattice = run.parts.near, run.lattice
    dim = lattice.dim
    u = run.fields["u"].reshape(dim, *lattice.shape)
    if "damage" in run.fields:
        u = np.where(run.fields["damage"] > 0, np.nan, u)
    cuts = [crack.cut for crack in run.setup.cracks if crack.opens <= run.time]
    around, wide = (lattice, u) if run.subdomain is None else run.subdomain.wider(u, _BESIDE, run.team)
    own: tuple[Any, ...] = (
        ...,
        *(slice(f - low, f - low + n) for f, low, n in zip(lattice.first, around.first, lattice.shape, strict=True)),
    )
    slopes = [_slope(wide, axis, around, cuts)[own] for axis in range(dim)]
    alone = np.isnan(slopes).all((0, 1)) & np.isfinite(u).all(0)
    for slope in slopes:
        slope[:, alone] = 0.0  # a node without neighbours has no bonds, and so no stress
    thermal_strain = run.fields.get("thermal_strain", np.zeros(lattice.shape))
    for axis, slope in enumerate(slopes):
        slope[axis] -= thermal_strain  # thermal strains cause no stress
    now = np.stack([u, *slopes], axis=-1).reshape(dim, -1, 1 + dim).swapaxes(0, 1)[None]
    lame, shear = near.lame.reshape(2, -1)
    (tensor,) = Reading(now, now, run.dt, 0.0, LocalModuli(lame, shear)).of([NAME])[NAME]
    found = {f"{NAME}_{'xyz'[a]}{'xyz'[b]}": tensor[:, a, b] for a, b in combinations_with_replacement(range(dim), 2)}
    if dim > 1:
        held = dim == 2 and getattr(run.model, "plane", None) != "stress"
        across = lame / (2 * (lame + shear)) if held else 0.0
        found[_MISES] = von_mises(tensor, across, -2 * shear * thermal_strain.ravel() if held else 0.0)
    return {name: values.reshape(lattice.shape) for name, values in found.items()}


def von_mises(tensor: np.ndarray, across: Any = 0.0, beside: Any = 0.0) -> np.ndarray:
    """Return ``sqrt(3/2 s : s)`` for the deviators s of stresses.

    Parameters
    ----------
    tensor : ndarray, shape (n, dim, dim)
    across : float or ndarray, shape (n,)
        In two dimensions, the ratio of the normal stress across the plane to the sum of those in it: Poisson's ratio in
        plane strain, 0 in plane stress.
    beside : float or ndarray, shape (n,)
        Contribution to the normal stress across the plane that is added: that of heat in plane strain.
    """
    dim = tensor.shape[-1]
    whole = np.zeros((len(tensor), 3, 3))
    whole[:, :dim, :dim] = tensor
    if dim == 2:
        whole[:, 2, 2] = across * np.trace(tensor, axis1=1, axis2=2) + beside
    mean = np.trace(whole, axis1=1, axis2=2) / 3
    deviator = whole - mean[:, None, None] * np.eye(3)
    return np.asarray(np.sqrt(1.5 * (deviator**2).sum((1, 2))))


def _slope(u: np.ndarray, axis: int, lattice: Any, cuts: Any) -> np.ndarray:
    """Derivative along an axis: the mean of the differences to both sides, or a one-sided difference."""
    first = np.moveaxis(np.diff(u, axis=axis + 1) / lattice.spacing, axis + 1, -1)
    if cuts:
        at = np.moveaxis(np.stack(np.meshgrid(*lattice.axes, indexing="ij"), -1), axis, -2)
        cut = np.any([one.cuts(at[..., :-1, :], at[..., 1:, :]) for one in cuts], axis=0)
        first = np.where(cut, np.nan, first)
    none = np.full((*first.shape[:-1], 2), np.nan)
    padded = np.concatenate([none, first, none], axis=-1)
    n = first.shape[-1] + 1
    before2, before, after, after2 = (padded[..., k : k + n] for k in range(4))
    found = (before + after) / 2
    for one, two in ((after, after2), (before, before2)):
        aside = np.where(np.isnan(two), one, one + (one - two) / 2)
        found = np.where(np.isnan(found), aside, found)
    return np.moveaxis(found, -1, axis + 1)

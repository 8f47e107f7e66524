"""Quantities that follow from the field and its gradient: at points, as receivers record them, and at nodes.

Stress and energy flux are those of classical elasticity and of the classical wave equation, which hold for long waves:
the strain is that of the interpolated field, the moduli are those of the model. For the energy that crosses a surface
on the lattice itself, bond by bond, see `farhorizon.simulation.recorders.power_through`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Any, NamedTuple

import numpy as np

from farhorizon.errors import InputError
from farhorizon.models import LatticeModel
from farhorizon.simulation.setup.compatibility import check_lossless


class LocalModuli(NamedTuple):
    """Lame's constants at n points, each of shape (n,); for media that are not elastic `shear` is the factor of the
    gradient in the energy flux.
    """

    lame: np.ndarray
    shear: np.ndarray


class Reading(NamedTuple):
    """Field at n points after each of some steps."""

    # the field, its derivatives along the axes and, if `warm`, the thermal strain at the point; now and one step
    # before, shape (steps, n, components, 1 or 1 + dim or 2 + dim)
    now: np.ndarray
    before: np.ndarray
    dt: float
    background: float
    medium: LocalModuli
    warm: bool = False

    @property
    def u(self) -> np.ndarray:
        """The field, shape (steps, n, components)."""
        return np.asarray(self.now[..., 0] + self.background)

    @property
    def v(self) -> np.ndarray:
        """Velocity half a step before, shape (steps, n, components)."""
        return np.asarray((self.now[..., 0] - self.before[..., 0]) / self.dt)

    @property
    def gradient(self) -> np.ndarray:
        """Derivatives along the axes, shape (steps, n, components, dim)."""
        return self.now[..., 1:-1] if self.warm else self.now[..., 1:]

    @property
    def elastic(self) -> np.ndarray:
        """The gradient minus the thermal strain: the part that causes stress."""
        return self._elastic(self.now)

    @property
    def middle(self) -> np.ndarray:
        """The same half a step before."""
        return (self._elastic(self.now) + self._elastic(self.before)) / 2

    def _elastic(self, rows: np.ndarray) -> np.ndarray:
        if not self.warm:
            return rows[..., 1:]
        gradient = rows[..., 1:-1]
        return np.asarray(gradient - rows[..., :1, -1:] * np.eye(gradient.shape[-1]))

    def of(self, names: Iterable[str]) -> dict[str, np.ndarray]:
        """Return quantities by name, each of shape (steps, n, ...)."""
        quantities = {name: QUANTITIES[name].of(self) for name in names}
        if self.now.shape[2] == 1:  # a scalar field has no axis of components
            for name in {"u", "v", "gradient"} & quantities.keys():
                quantities[name] = quantities[name][:, :, 0]
        return quantities


@dataclass(frozen=True)
class Quantity:
    """A quantity that can be recorded."""

    # returns an array of shape (steps, n, ...); u, v and gradient of scalar fields have an axis of one component
    of: Callable[[Reading], np.ndarray]
    derived: bool = False  # needs the gradient
    moving: bool = False  # needs the velocity, which only waves have; it then refers to half a step before
    mechanical: bool = False  # exists for displacements only
    stressed: bool = False  # derived from stresses, and so needs the thermal strain

    def has(self, model: LatticeModel) -> bool:
        """Whether it exists for a model."""
        has_energy_flux = not (self.derived and self.moving) or model.moduli is not None
        return has_energy_flux and (model.order == 2 or not self.moving) and (model.mechanical or not self.mechanical)


def strain(gradient: np.ndarray) -> np.ndarray:
    """Symmetric part of the displacement gradient, shape (..., dim, dim)."""
    return (gradient + gradient.swapaxes(-1, -2)) / 2


def _divergence(gradient: np.ndarray) -> np.ndarray:
    """Trace of the gradient."""
    return np.asarray(np.trace(gradient, axis1=-2, axis2=-1))


def stress(gradient: np.ndarray, medium: LocalModuli) -> np.ndarray:
    """``lame div u 1 + 2 shear strain`` from the displacement gradient at n points, thermal strain subtracted; shape
    (steps, n, dim, dim), in two dimensions the components in the plane.
    """
    lame, shear = medium.lame[:, None, None], medium.shear[:, None, None]
    unit = np.eye(gradient.shape[-1])
    return np.asarray(lame * _divergence(gradient)[..., None, None] * unit + 2 * shear * strain(gradient))


def curl(gradient: np.ndarray) -> np.ndarray:
    """``du_y/dx - du_x/dy`` in two dimensions, shape (...); the vector in three, shape (..., 3)."""
    if gradient.shape[-1] == 2:
        return np.asarray(gradient[..., 1, 0] - gradient[..., 0, 1])
    pairs = ((2, 1), (0, 2), (1, 0))
    return np.stack([gradient[..., i, j] - gradient[..., j, i] for i, j in pairs], axis=-1)


def _energy_flux(reading: Reading) -> np.ndarray:
    """Poynting vector: ``- stress . v``, for scalar waves ``- c^2 v grad u``."""
    if reading.now.shape[2] == 1:
        return np.asarray(-reading.medium.shear[:, None] * reading.v * reading.middle[..., 0, :])
    return -np.einsum("...ij,...i->...j", stress(reading.middle, reading.medium), reading.v)


QUANTITIES: dict[str, Quantity] = {
    "u": Quantity(lambda s: s.u),
    "v": Quantity(lambda s: s.v, moving=True),
    "gradient": Quantity(lambda s: s.gradient, derived=True),
    "strain": Quantity(lambda s: strain(s.gradient), derived=True, mechanical=True),
    "stress": Quantity(lambda s: stress(s.elastic, s.medium), derived=True, mechanical=True, stressed=True),
    "pressure": Quantity(
        lambda s: -_divergence(stress(s.elastic, s.medium)) / s.gradient.shape[-1],
        derived=True,
        mechanical=True,
        stressed=True,
    ),
    "divergence": Quantity(lambda s: _divergence(s.gradient), derived=True, mechanical=True),
    "curl": Quantity(lambda s: curl(s.gradient), derived=True, mechanical=True),
    "rotation": Quantity(lambda s: curl(s.gradient) / 2, derived=True, mechanical=True),
    "energy_flux": Quantity(_energy_flux, derived=True, moving=True, stressed=True),
}


# --- the stress at nodes -------------------------------------------------------------------------------------------

STRESS = "stress"
"""Name under which all components of the stress are requested."""
_MISES = "stress_von_mises"
_BESIDE = 2  # nodes to either side that a difference uses


def _stress_names(dim: int) -> list[str]:
    """Return the names of the components in a number of dimensions, from two on with the von Mises stress."""
    parts = [f"{STRESS}_{a}{b}" for a, b in combinations_with_replacement("xyz"[:dim], 2)]
    return parts if dim == 1 else [*parts, _MISES]


def fields_of(run: Any, names: Iterable[str]) -> dict[str, np.ndarray]:
    """Return fields of a run by name, as they are now; the stress is computed if requested. Raises InputError if there
    is no field of this name.
    """
    asked = list(names)
    fields = shown_fields(run, next((name for name in asked if name.startswith(STRESS)), ""))
    if STRESS in asked and QUANTITIES[STRESS].has(run.model):
        asked = [part for name in asked for part in (_stress_names(run.lattice.dim) if name == STRESS else [name])]
    for name in asked:
        if name not in fields:
            more = [STRESS] * (STRESS not in fields and QUANTITIES[STRESS].has(run.model))
            raise InputError("the run has no such field", value=name, key="fields", limit=", ".join([*fields, *more]))
    return {name: fields[name] for name in asked}


def shown_fields(run: Any, name: str) -> dict[str, np.ndarray]:
    """Return the fields of a run, and its stress if `name` requests it."""
    asked = isinstance(name, str) and name.startswith(STRESS) and QUANTITIES[STRESS].has(run.model)
    return run.fields | (nodal_stress(run) if asked else {})


def nodal_stress(run: Any) -> dict[str, np.ndarray]:
    """Return the components of the stress at the nodes, in 2D those in the plane, and the von Mises stress, by name;
    nan at broken bonds and across a body one node thick. As at points: central differences of u, one-sided at edges,
    holes and open cracks, and the moduli of each node. All processes must call it.
    """
    near, lattice = run.parts.near, run.lattice
    check_lossless(near.model, STRESS, "the displacements")
    dim = lattice.dim
    u = run.fields["u"].reshape(dim, *lattice.shape)
    if "damage" in run.fields:
        u = np.where(run.fields["damage"] > 0, np.nan, u)
    cuts = [crack.cut for crack in run.setup.cracks if crack.opens <= run.time]
    lattice_around, u_around = (lattice, u) if run.subdomain is None else run.subdomain.wider(u, _BESIDE, run.team)
    own_part: tuple[Any, ...] = (
        ...,
        *(
            slice(f - low, f - low + n)
            for f, low, n in zip(lattice.first, lattice_around.first, lattice.shape, strict=True)
        ),
    )
    slopes = [_slope(u_around, axis, lattice_around, cuts)[own_part] for axis in range(dim)]
    alone = np.isnan(slopes).all((0, 1)) & np.isfinite(u).all(0)
    for slope in slopes:
        slope[:, alone] = 0.0  # a node without neighbours has no bonds, and so no stress
    thermal_strain = run.fields.get("thermal_strain", np.zeros(lattice.shape))
    for axis, slope in enumerate(slopes):
        slope[axis] -= thermal_strain  # thermal strains cause no stress
    field_and_slopes = np.stack([u, *slopes], axis=-1).reshape(dim, -1, 1 + dim).swapaxes(0, 1)[None]
    lame, shear = near.lame.reshape(2, -1)
    (tensor,) = Reading(field_and_slopes, field_and_slopes, run.dt, 0.0, LocalModuli(lame, shear)).of([STRESS])[STRESS]
    components = {
        f"{STRESS}_{'xyz'[a]}{'xyz'[b]}": tensor[:, a, b] for a, b in combinations_with_replacement(range(dim), 2)
    }
    if dim > 1:
        plane_strain = dim == 2 and getattr(run.model, "plane", None) != "stress"
        ratio = lame / (2 * (lame + shear)) if plane_strain else 0.0
        components[_MISES] = von_mises(tensor, ratio, -2 * shear * thermal_strain.ravel() if plane_strain else 0.0)
    return {name: values.reshape(lattice.shape) for name, values in components.items()}


def von_mises(tensor: np.ndarray, ratio: Any = 0.0, thermal: Any = 0.0) -> np.ndarray:
    """Return ``sqrt(3/2 s : s)`` for the deviators s of stresses of shape (n, dim, dim).

    In two dimensions the normal stress across the plane is `ratio` times the sum of those in it (Poisson's ratio in
    plane strain, 0 in plane stress), plus `thermal` (that of heat in plane strain).
    """
    dim = tensor.shape[-1]
    in_space = np.zeros((len(tensor), 3, 3))
    in_space[:, :dim, :dim] = tensor
    if dim == 2:
        in_space[:, 2, 2] = ratio * np.trace(tensor, axis1=1, axis2=2) + thermal
    mean = np.trace(in_space, axis1=1, axis2=2) / 3
    deviator = in_space - mean[:, None, None] * np.eye(3)
    return np.asarray(np.sqrt(1.5 * (deviator**2).sum((1, 2))))


def _slope(u: np.ndarray, axis: int, lattice: Any, cuts: Any) -> np.ndarray:
    """Derivative along an axis: the mean of the differences to both sides, or a one-sided difference."""
    differences = np.moveaxis(np.diff(u, axis=axis + 1) / lattice.spacing, axis + 1, -1)
    if cuts:
        places = np.moveaxis(np.stack(np.meshgrid(*lattice.axes, indexing="ij"), -1), axis, -2)
        is_cut = np.any([cut.cuts(places[..., :-1, :], places[..., 1:, :]) for cut in cuts], axis=0)
        differences = np.where(is_cut, np.nan, differences)
    unknown = np.full((*differences.shape[:-1], 2), np.nan)
    padded = np.concatenate([unknown, differences, unknown], axis=-1)
    n = differences.shape[-1] + 1
    before2, before, after, after2 = (padded[..., k : k + n] for k in range(4))
    slopes = (before + after) / 2
    for nearest, next_nearest in ((after, after2), (before, before2)):
        one_sided = np.where(np.isnan(next_nearest), nearest, nearest + (nearest - next_nearest) / 2)
        slopes = np.where(np.isnan(slopes), one_sided, slopes)
    return np.moveaxis(slopes, -1, axis + 1)

"""What receivers record at a point: u, and quantities that follow from it and its gradient. The functions take and
return plain arrays.

Stress and energy flux are those of classical elasticity and of the classical wave equation, which hold for long waves:
the strain is that of the interpolated field, the moduli are those of the model. For the energy that crosses a surface
on the lattice itself, bond by bond, see `farhorizon.simulation.recorders.power_through`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from farhorizon.models import LatticeModel


class LocalModuli(NamedTuple):
    """Constants of the medium at n points.

    Attributes
    ----------
    lame, shear : ndarray, shape (n,)
        Lame's constants of an elastic medium; for other media `shear` is the factor of the gradient in the energy flux.
    """

    lame: np.ndarray
    shear: np.ndarray


class Reading(NamedTuple):
    """Field at n points after each of some steps.

    Attributes
    ----------
    now, before : ndarray, shape (steps, n, components, 1 or 1 + dim or 2 + dim)
        The field, its derivatives along the axes and, if `warm`, the thermal strain at the point; now and one step
        before.
    dt, background : float
    medium : LocalModuli
    warm : bool
        Whether the thermal strain is included.
    """

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
    def answered(self) -> np.ndarray:
        """The gradient minus the thermal strain: the part that causes stress."""
        return self._answered(self.now)

    @property
    def middle(self) -> np.ndarray:
        """The same half a step before."""
        return (self._answered(self.now) + self._answered(self.before)) / 2

    def _answered(self, rows: np.ndarray) -> np.ndarray:
        if not self.warm:
            return rows[..., 1:]
        gradient = rows[..., 1:-1]
        return np.asarray(gradient - rows[..., :1, -1:] * np.eye(gradient.shape[-1]))

    def of(self, names: Iterable[str]) -> dict[str, np.ndarray]:
        """Return quantities by name, each of shape (steps, n, ...)."""
        found = {name: QUANTITIES[name].of(self) for name in names}
        if self.now.shape[2] > 1:
            return found
        # a scalar field has no axis of components
        return {n: values[:, :, 0] if n in ("u", "v", "gradient") else values for n, values in found.items()}


@dataclass(frozen=True)
class Quantity:
    """A quantity that can be recorded.

    Attributes
    ----------
    of : callable
        Takes a `Reading`, and returns an array of shape (steps, n, ...); u, v and gradient of scalar fields have an
        axis of one component.
    derived : bool
        Whether it needs the gradient.
    moving : bool
        Whether it needs the velocity, which only waves have; it then refers to half a step before.
    mechanical : bool
        Whether it exists for displacements only.
    stressed : bool
        Whether it is derived from stresses, and so needs the thermal strain.
    """

    of: Callable[[Reading], np.ndarray]
    derived: bool = False
    moving: bool = False
    mechanical: bool = False
    stressed: bool = False

    def has(self, model: LatticeModel) -> bool:
        """Whether it exists for a model."""
        flows = not (self.derived and self.moving) or model.moduli is not None
        return flows and (model.order == 2 or not self.moving) and (model.mechanical or not self.mechanical)


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
    "stress": Quantity(lambda s: stress(s.answered, s.medium), derived=True, mechanical=True, stressed=True),
    "pressure": Quantity(
        lambda s: -_divergence(stress(s.answered, s.medium)) / s.gradient.shape[-1],
        derived=True,
        mechanical=True,
        stressed=True,
    ),
    "divergence": Quantity(lambda s: _divergence(s.gradient), derived=True, mechanical=True),
    "curl": Quantity(lambda s: curl(s.gradient), derived=True, mechanical=True),
    "rotation": Quantity(lambda s: curl(s.gradient) / 2, derived=True, mechanical=True),
    "energy_flux": Quantity(_energy_flux, derived=True, moving=True, stressed=True),
}

"""Scalar waves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

from farhorizon import kinds
from farhorizon.arguments import Frequency, Unit
from farhorizon.medium.attenuation import Attenuation
from farhorizon.medium.integrators import Integrator
from farhorizon.medium.kernel import Kernel
from farhorizon.medium.stencil import Stencil
from farhorizon.models.model import Constant, Density, LatticeModel, attenuation_of, material_constant, second_order


class Wave(LatticeModel):
    r"""Peridynamic or classical scalar waves, :math:`\rho\,(u_{tt} + 2 d\,u_t) = \rho c^2 L u + s`, by velocity Verlet
    unless another integrator is given.

    Where the medium varies, the stiffness :math:`\rho c^2` of a bond follows from those of its two ends (`Simulation`,
    `rule`), and each node has its own density: the operator is that of :math:`\nabla\cdot(\rho c^2\,\nabla u)`.

    Parameters
    ----------
    operator : Kernel or Stencil
    speed : float, str, ndarray or callable
        Wave speed c (length / time) of long waves; for a varying medium, an expression or a function of the
        coordinates, or the values at the nodes.
    damping : float
        Viscous damping d (1 / time): the equation has 2 d u_t, so that waves decay as exp(-d t).
    density : float, str, ndarray or callable
        Mass per volume; given like `speed`.
    integrator : {"verlet", "modified-equation"}
        Velocity Verlet, of second order in the time step, or the modified equation of fourth order, which takes two
        sweeps a step, whose limit is sqrt(3) times as long, and which serves linear waves without damping. The stencil
        should be as accurate: `Stencil.finite_difference` of order 4 or more.
    attenuation : Attenuation, optional
        The quality factor of the medium, the same everywhere; `speed` is then that at its reference frequency.

    Notes
    -----
    Hermann, Shojaei, Seleson, Cyron and Silling (2023), eqs 1, 6 and 42. For pressure waves in a fluid, with
    :math:`\nabla\cdot(\rho_f^{-1}\,\nabla p)` on the right-hand side, the density is :math:`1/(\rho_f c^2)` here.

    Examples
    --------
    >>> import farhorizon as fh
    >>> model = fh.Wave(fh.Kernel(2.0), speed=3.0)
    >>> model.crossing(length=12.0)
    4.0
    >>> layered = fh.Wave(fh.Kernel(2.0), speed="where(y < 0, 2, 1)", density="where(y < 0, 1.5, 1)")
    """

    speed: Any
    density: Any
    constants = ("speed", "density")
    others: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("young", "poisson", "bulk", "shear"), "a solid is an Elastic; a Wave has one speed"
    )

    def __init__(
        self,
        operator: Kernel | Stencil,
        speed: Annotated[Constant, Unit("m/s")] = 1.0,
        damping: Frequency = 0.0,
        *,
        density: Density = 1.0,
        integrator: str | Integrator = "verlet",
        attenuation: Attenuation | None = None,
    ) -> None:
        super().__init__(operator)
        self.damping = kinds.number(damping, "model.damping", least=0)
        self.integrator = second_order(integrator, self.damping)
        self.attenuation = attenuation_of(attenuation)
        self._set(speed=material_constant(speed, "model.speed"), density=material_constant(density, "model.density"))

    def medium_of(self, constants: Mapping[str, Any]) -> tuple[Any, Any]:
        stiffer = 1.0 if self.attenuation is None else self.attenuation.strongest.unrelaxed
        return stiffer * constants["speed"] ** 2, constants["density"]

    @property
    def speeds(self) -> dict[str, float]:
        """The speed of long waves."""
        return {"long waves": self.speed}

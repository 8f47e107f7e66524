"""Diffusion of a scalar."""

from __future__ import annotations

from farhorizon.errors import InputError
from farhorizon.kernel import Kernel
from farhorizon.models.scalar import INTEGRATORS, ScalarModel, positive
from farhorizon.stencil import Stencil


class Diffusion(ScalarModel):
    r"""Peridynamic or classical diffusion, :math:`u_t = \chi^2 L u + s`.

    Parameters
    ----------
    operator : Kernel or Stencil
    diffusivity : float
        :math:`\chi^2` (length^2 / time) of long waves.
    integrator : {"euler", "rk4"}
        Forward Euler or the classical Runge-Kutta method of fourth order.

    Notes
    -----
    Shojaei, Hermann, Seleson and Cyron (2020), eqs 1 to 5.
    """

    def __init__(self, operator: Kernel | Stencil, diffusivity: float = 1.0, integrator: str = "euler") -> None:
        super().__init__(operator)
        self.coefficient = self.diffusivity = positive(diffusivity, "model.diffusivity")
        if integrator not in INTEGRATORS:
            raise InputError("unknown integrator", value=integrator, limit=", ".join(INTEGRATORS), key="model.integrator")
        self.integrator = INTEGRATORS[integrator]

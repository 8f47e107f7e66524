"""Diffusion of a scalar."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from farhorizon.arguments import Unit
from farhorizon.medium.integrators import Integrator
from farhorizon.medium.kernel import Kernel
from farhorizon.medium.stencil import Stencil
from farhorizon.models.model import Constant, LatticeModel, first_order, material_constant


class Diffusion(LatticeModel):
    r"""Peridynamic or classical diffusion, :math:`u_t = \chi^2 L u + s`.

    Where the diffusivity varies, that of a bond follows from those of its two ends (`Simulation`, `rule`): the operator
    is that of :math:`\nabla\cdot(\chi^2\,\nabla u)`.

    Parameters
    ----------
    operator : Kernel or Stencil
    diffusivity : float, str, ndarray, callable or OfField
        Diffusivity :math:`\chi^2` of long waves (length^2 / time); for a varying medium, an expression or a function of
        the coordinates, or the values at the nodes; or an expression of u (`OfField`).
    integrator : {"euler", "rk4", "rkc"} or RungeKuttaChebyshev
        Forward Euler, the classical Runge-Kutta method of fourth order, or the stabilised Runge-Kutta-Chebyshev method
        of second order, for long runs.

    Notes
    -----
    Shojaei, Hermann, Seleson and Cyron (2020), eqs 1 and 6 to 9.

    Examples
    --------
    >>> import farhorizon as fh
    >>> model = fh.Diffusion(fh.Kernel(0.3), diffusivity=2.0)
    >>> sim = fh.Simulation(fh.Lattice(0.1, -3, 3), model, initial={"u": "exp(-4*x**2)"})
    >>> _ = sim.run(until=0.05)
    >>> bool(sim.fields["u"].max() < 1)
    True
    """

    diffusivity: Any
    quantity = "concentration"
    constants = ("diffusivity",)

    def __init__(
        self,
        operator: Kernel | Stencil,
        diffusivity: Annotated[Constant, Unit("m^2/s")] = 1.0,
        integrator: str | Integrator = "euler",
    ) -> None:
        super().__init__(operator)
        self._set(diffusivity=material_constant(diffusivity, "model.diffusivity", follows=True))
        self.integrator = first_order(integrator)

    def medium_of(self, constants: Mapping[str, Any]) -> tuple[Any, Any]:
        return constants["diffusivity"], 1.0

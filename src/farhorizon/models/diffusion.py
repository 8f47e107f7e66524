"""Diffusion of a scalar."""

from __future__ import annotations

from farhorizon import kinds
from farhorizon.medium.integrators import Integrator
from farhorizon.medium.kernel import Kernel
from farhorizon.medium.stencil import Stencil
from farhorizon.models.model import LatticeModel, first_order


class Diffusion(LatticeModel):
    r"""Peridynamic or classical diffusion, :math:`u_t = \chi^2 L u + s`.

    Parameters
    ----------
    operator : Kernel or Stencil
    diffusivity : float
        Diffusivity :math:`\chi^2` of long waves (length^2 / time).
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

    def __init__(
        self, operator: Kernel | Stencil, diffusivity: float = 1.0, integrator: str | Integrator = "euler"
    ) -> None:
        super().__init__(operator)
        varies = "the largest; coefficient=diffusivity/largest of Simulation varies it"
        self.coefficient = self.diffusivity = kinds.number(diffusivity, "model.diffusivity", above=0, remedy=varies)
        self.integrator = first_order(integrator)

"""Corrosion of metal in an electrolyte."""

from __future__ import annotations

from farhorizon import kinds
from farhorizon.integrators import Integrator
from farhorizon.kernel import Kernel
from farhorizon.models.model import LatticeModel, first_order
from farhorizon.stencil import Stencil


class Corrosion(LatticeModel):
    r"""Peridynamic corrosion: metal that dissolves into a liquid in which it diffuses, :math:`u_t = \int c\,(u' - u)\,dV'`.

    The field u is the concentration of the metal. Bonds between liquid nodes have the micro-diffusivity :math:`c` of the operator and the
    diffusivity, bonds between a solid and a liquid node `interface` times as much (the micro-dissolvability), bonds between solid nodes none.
    A solid node whose concentration has fallen below `saturation` after a step is liquid from then on and keeps its concentration. `Simulation`
    takes the solid as `specimens`.

    Parameters
    ----------
    operator : Kernel or Stencil
    diffusivity : float
        Of the metal in the liquid (length^2 / time), of long waves.
    saturation : float
        Concentration below which a solid node dissolves: above that of the liquid far away, below that of the metal.
    interface : float
        Micro-diffusivity of bonds between the phases over that of the liquid; positive.
    integrator : {"euler", "rk4", "rkc"} or RungeKuttaChebyshev
        The phases change at the end of a step only, so that the fronts are of first order in time whatever the integrator.

    Raises
    ------
    InputError
        A constant that is not finite or not positive, an unknown integrator.

    Notes
    -----
    Shojaei, Hermann, Seleson and Cyron (2020), section 5.2, after Chen and Bobaru (2015, J. Mech. Phys. Solids 78) and Jafarzadeh, Chen, Zhao
    and Bobaru (2019, Corros. Sci. 150). As the horizon shrinks the concentration at the front tends to the saturation, and the front to that of
    the Stefan problem.
    """

    def __init__(
        self, operator: Kernel | Stencil, diffusivity: float = 1.0, *, saturation: float, interface: float = 0.1,
        integrator: str | Integrator = "euler",
    ) -> None:  # fmt: skip
        super().__init__(operator)
        self.coefficient = self.diffusivity = kinds.number(diffusivity, "model.diffusivity", above=0)
        self.interface = kinds.number(interface, "model.interface", above=0)
        self.strongest = max(1.0, self.interface)
        self.saturation = kinds.number(saturation, "model.saturation")
        self.integrator = first_order(integrator)

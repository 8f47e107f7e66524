"""Scalar waves."""

from __future__ import annotations

from farhorizon import kinds
from farhorizon.medium.integrators import Verlet
from farhorizon.medium.kernel import Kernel
from farhorizon.medium.stencil import Stencil
from farhorizon.models.model import LatticeModel


class Wave(LatticeModel):
    r"""Peridynamic or classical scalar waves, :math:`u_{tt} + 2 d\,u_t = c^2 L u + s`, by velocity Verlet.

    Parameters
    ----------
    operator : Kernel or Stencil
    speed : float
        Wave speed c (length / time) of long waves.
    damping : float
        Viscous damping d (1 / time).

    Notes
    -----
    Hermann, Shojaei, Seleson and Cyron (2023), eqs 1 and 42.

    Examples
    --------
    >>> import farhorizon as fh
    >>> model = fh.Wave(fh.Kernel(2.0), speed=3.0)
    >>> model.crossing(length=12.0)
    4.0
    """

    def __init__(self, operator: Kernel | Stencil, speed: float = 1.0, damping: float = 0.0) -> None:
        super().__init__(operator)
        varies = "the largest speed; coefficient=(speed/largest)**2 of Simulation varies it"
        self.speed = kinds.number(speed, "model.speed", above=0, remedy=varies)
        self.damping = kinds.number(damping, "model.damping", least=0)
        self.coefficient = self.speed**2
        self.integrator = Verlet()

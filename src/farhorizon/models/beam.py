"""Bending of a beam."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import Frequency, Unit
from farhorizon.errors import InputError
from farhorizon.medium.integrators import Verlet
from farhorizon.medium.stencil import Stencil
from farhorizon.models.model import LatticeModel


class Beam(LatticeModel):
    r"""Semi-discrete Euler-Bernoulli beam, :math:`u_{tt} + 2 d\,u_t = -\beta\,u_{xxxx} + s`, by velocity Verlet; one
    dimension.

    The fourth difference is the stencil of reach 2 with the weights 4 and -1 divided by spacing^4. Its bonds cannot be
    cut or weakened individually, and removing them does not produce a mechanically free end, so that the sides must be
    `Exact`, `Fixed` (clamped) or `Periodic`.

    Parameters
    ----------
    stiffness : float
        Bending stiffness divided by mass per length, :math:`\beta = EI/(\rho A)` (length^4 / time^2).
    damping : float
        Viscous damping d (1 / time): the equation has 2 d u_t, so that waves decay as exp(-d t).

    Notes
    -----
    Ji, Pang, Zhang, Yang and Perdikaris (2021), eq 29. The stable step is ``spacing^2 / (2 sqrt(stiffness))``.

    Examples
    --------
    >>> import farhorizon as fh
    >>> beam = fh.Beam(stiffness=2.0)
    >>> sim = fh.Simulation(fh.Lattice(0.1, -2, 2), beam, fh.Exact(), {"u": "exp(-8*x**2)"})
    >>> round(float(sim.step_limit / (0.1**2 / (2 * 2.0**0.5))), 6)
    1.0
    """

    quantity, field_unit = "deflection", "m"
    combinations = "Exact"
    bonds = False

    def __init__(self, stiffness: Annotated[float, Unit("m^4/s^2")] = 1.0, damping: Frequency = 0.0) -> None:
        self.stiffness = kinds.number(stiffness, "model.stiffness", above=0)
        self.damping = kinds.number(damping, "model.damping", least=0)
        self.coefficient = self.stiffness
        self.integrator = Verlet()

    @property
    def moduli(self) -> None:
        """None: in a beam the bending moment transports energy."""
        return None

    def serves(self, side: Any) -> bool:
        """Whether a side can be used with the beam, that is, ends it or continues it exactly."""
        return super().serves(side) and (side.exact or not side.endless)

    def crossing(self, length: float, factor: float = 1.0) -> float:
        """Bending waves have no largest speed: up to a factor, the period of waves as long as a given length,
        ``length^2/sqrt(stiffness)``.
        """
        return length**2 / float(np.sqrt(factor * self.stiffness))

    def stencil(self, spacing: float, dim: int) -> Stencil:
        """Return the fourth difference divided by spacing^2; the other two powers are applied as in all models."""
        if dim != 1:
            raise InputError(
                "a beam has one dimension", value=f"{dim} dimensions", key="lattice", remedy="a lattice with one axis"
            )
        return Stencil(np.array([[1], [-1], [2], [-2]]), np.array([4.0, 4.0, -1.0, -1.0]) / spacing**2)

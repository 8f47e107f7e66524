"""Corrosion of metal in an electrolyte."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import ANY, Unit
from farhorizon.errors import InputError
from farhorizon.medium.integrators import Integrator
from farhorizon.medium.kernel import Kernel
from farhorizon.medium.stencil import Stencil
from farhorizon.models.model import LatticeModel, first_order

FARADAY = 96485.33212  # C/mol


class Corrosion(LatticeModel):
    r"""Peridynamic corrosion: metal that dissolves into a liquid in which it diffuses, :math:`u_t = \int c\,(u' -
    u)\,dV'`.

    The field u is the concentration of the metal. Bonds between liquid nodes have the micro-diffusivity :math:`c` given
    by the operator and the diffusivity, bonds between a solid and a liquid node `interface` times as much (the
    micro-dissolvability), and bonds between solid nodes none. A solid node whose concentration has fallen below
    `saturation` after a step is liquid from then on and keeps its concentration. The solid is passed to `Simulation` as
    `specimens`.

    The rate at which the metal dissolves into a liquid that carries it away immediately (activation control) is set by
    `interface`: see `speed`, `interface_for` and `speed_of_current`. Where the liquid does not carry the metal away,
    the concentration may rise far above the saturation, of which `Simulation` warns, unless the dissolution is
    `limited`.

    Parameters
    ----------
    operator : Kernel or Stencil
    diffusivity : float
        Diffusivity of the metal in the liquid (length^2 / time), for long waves.
    saturation : float
        Concentration below which a solid node dissolves; it must lie above that of the liquid far away and below that
        of the metal.
    interface : float
        Micro-diffusivity of bonds between the phases relative to that of the liquid; positive.
    limited : bool
        The flux in bonds between the phases is driven by ``saturation - u`` instead of ``metal - u``, where u is the
        concentration of the liquid, and vanishes where the liquid is saturated: no node of the liquid rises above the
        saturation, and diffusion controls the front unless `interface` is small. The front is then slower under
        activation control, too (`speed`): determine `interface` by `interface_for`.
    integrator : {"euler", "rk4", "rkc"} or RungeKuttaChebyshev
        Phases change only at the end of a step, so that the fronts are of first order in time whatever the integrator.

    Raises
    ------
    InputError
        A constant that is not finite or not positive, an unknown integrator.

    Notes
    -----
    Shojaei, Hermann, Seleson and Cyron (2020), section 5.2, after Chen and Bobaru (2015, J. Mech. Phys. Solids 78) and
    Jafarzadeh, Chen, Zhao and Bobaru (2019, Corros. Sci. 150). As the horizon shrinks, the concentration at the front
    tends to the saturation, and the front to the solution of the Stefan problem.

    Examples
    --------
    >>> import farhorizon as fh
    >>> model = fh.Corrosion(fh.Kernel(3.0), diffusivity=1.0, saturation=0.5, interface=0.02)
    >>> speed = model.speed(spacing=1.0, dim=2, metal=1.0)
    >>> round(model.interface_for(2 * speed, spacing=1.0, dim=2, metal=1.0), 6)  # twice the speed, twice the interface
    0.04
    """

    quantity = "concentration"

    def __init__(
        self,
        operator: Kernel | Stencil,
        diffusivity: Annotated[float, Unit("m^2/s")] = 1.0,
        *,
        saturation: Annotated[float, Unit(ANY)],
        interface: float = 0.1,
        integrator: str | Integrator = "euler",
        limited: bool = False,
    ) -> None:
        super().__init__(operator)
        self.coefficient = self.diffusivity = kinds.number(diffusivity, "model.diffusivity", above=0)
        self.interface = kinds.number(interface, "model.interface", above=0)
        self.strongest = max(1.0, self.interface)
        self.saturation, self.limited = (
            kinds.number(saturation, "model.saturation"),
            kinds.flag(limited, "model.limited"),
        )
        self.integrator = first_order(integrator)

    @property
    def dissolution(self) -> Corrosion:
        """The model itself."""
        return self

    def speed(self, spacing: float, dim: int, metal: float, far: float = 0.0) -> float:
        """Speed of a plane front along an axis under activation control, where the liquid next to the front has the
        concentration that it has far away.

        A node of the metal loses its surplus from the time at which the front is within its reach until its
        concentration falls below the saturation. In a steady front the time between two layers of nodes therefore
        follows from all bonds ahead of a node, ``S = sum_(x > 0) w x`` (x in spacings): the speed is
        ``interface diffusivity S / spacing / ln((metal - far) / (saturation - far))``, or if `limited`
        ``interface diffusivity S / spacing * (saturation - far) / (metal - saturation)``. It is proportional to
        `interface`, and valid as long as it is far below diffusivity / spacing.

        Parameters
        ----------
        spacing : float
        dim : {1, 2, 3}
        metal : float
            Concentration of the intact metal.
        far : float
            Concentration of the liquid far away.

        Returns
        -------
        float
            Length / time.

        Raises
        ------
        InputError
            The saturation does not lie between the concentrations of the liquid and the metal.
        """
        metal, far = kinds.number(metal, "metal"), kinds.number(far, "far")
        if not far < self.saturation < metal:
            raise InputError(
                "the saturation lies outside the range of the data",
                value=self.saturation,
                limit=f"above {far:g}, below {metal:g}",
                key="model.saturation",
            )
        stencil = self.stencil(spacing, dim)
        ahead = float((stencil.weights * np.maximum(stencil.offsets[:, 0], 0)).sum())
        flow = self.interface * self.diffusivity * ahead / spacing
        if self.limited:
            return flow * (self.saturation - far) / (metal - self.saturation)
        return flow / float(np.log((metal - far) / (self.saturation - far)))

    def interface_for(self, speed: float, spacing: float, dim: int, metal: float, far: float = 0.0) -> float:
        """The `interface` for which a plane front has a given speed (length / time) under activation control; for the
        other parameters see `speed`.
        """
        return self.interface * kinds.number(speed, "speed", above=0) / self.speed(spacing, dim, metal, far)


def speed_of_current(density: float, metal: float, electrons: float) -> float:
    """Speed of a corrosion front (m/s) from the current density, by Faraday's law.

    Parameters
    ----------
    density : float
        Current density, A/m^2.
    metal : float
        Concentration of the intact metal, mol/m^3.
    electrons : float
        Number of electrons that each atom loses.

    Examples
    --------
    >>> import farhorizon as fh
    >>> round(fh.speed_of_current(1.0, metal=141_000.0, electrons=2.0) * 1e3 * 365.25 * 24 * 3600, 2)  # iron, mm a year
    1.16
    """
    given = (
        kinds.number(value, name, above=0)
        for name, value in (("density", density), ("metal", metal), ("electrons", electrons))
    )
    current, concentration, number = given
    return current / (number * FARADAY * concentration)

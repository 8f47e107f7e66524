"""Heat conduction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import Unit
from farhorizon.medium.integrators import Integrator
from farhorizon.medium.kernel import Kernel
from farhorizon.medium.stencil import Stencil
from farhorizon.models.model import Constant, Density, LatticeModel, first_order, material_constant

SELF_TERMS = ("centre", "neighbour", "none")


class Heat(LatticeModel):
    r"""Peridynamic or classical heat conduction, :math:`\rho c\,T_t = \int k(r)\,\frac{T' - T}{r^2}\,dV' + w`.

    The field u is the temperature; sources are powers per volume w(x, t). Any consistent units may be used. Where the
    medium varies, the conductivity of a bond follows from those of its two ends (`Simulation`, `rule`), and each node
    has its own heat capacity: the operator is that of :math:`\nabla\cdot(\kappa\,\nabla T)`.

    Parameters
    ----------
    operator : Kernel or Stencil
        The micro-conductivity k: influence "constant" or "linear" (triangular) with exponent 2 corresponds to the
        paper.
    density : float, str, ndarray or callable
        Mass per volume :math:`\rho`; positive. For a varying medium, an expression or a function of the coordinates, or
        the values at the nodes.
    specific_heat : float, str, ndarray or callable
        Energy per mass and temperature, c; given like `density`.
    conductivity : float, str, ndarray, callable or OfField
        Power per length and temperature, :math:`\kappa`; given like `density`, or as an expression of the temperature
        u, such as "50 - 0.02*u" (`OfField`).
    integrator : {"euler", "rk4", "rkc"} or RungeKuttaChebyshev
    self_term : {"centre", "neighbour", "none"}
        Contribution of the cell of a node itself to the integral over its family: the micro-conductivity at its
        "centre", k(0); that at the nearest "neighbour", as printed in the paper; or "none". See `self_weight`.

    Raises
    ------
    InputError
        A constant that is not positive, an unknown integrator or self term.

    Notes
    -----
    Bobaru and Duangpanya (2010), eqs 9, 16, 17 and 18. Only the self term with k(0) gives the specified conductivity
    without calibration, whatever the number of nodes in the horizon; the paper prints that of the nearest neighbour
    (they are the same for a constant k). A kernel with ``calibrate=True`` is rescaled after the self term is added; use
    ``calibrate=False`` to see the effect of the other variants.

    Examples
    --------
    >>> import farhorizon as fh
    >>> steel = fh.Heat(fh.Kernel(3e-3), density=7850.0, specific_heat=490.0, conductivity=43.0)
    >>> round(steel.coefficient * 1e6, 3)  # diffusivity in mm^2/s
    11.179
    >>> coated = fh.Heat(fh.Kernel(3e-3), "where(x < 0.01, 7850, 2500)", 490.0, "where(x < 0.01, 43, 1.4)")
    """

    density: Any
    specific_heat: Any
    conductivity: Any
    quantity, field_unit = "temperature", "K"
    constants = ("density", "specific_heat", "conductivity")

    def __init__(
        self,
        operator: Kernel | Stencil,
        density: Density = 1.0,
        specific_heat: Annotated[Constant, Unit("J/(kg*K)")] = 1.0,
        conductivity: Annotated[Constant, Unit("W/(m*K)")] = 1.0,
        integrator: str | Integrator = "euler",
        self_term: str = "centre",
    ) -> None:
        super().__init__(operator)
        given = {"density": density, "specific_heat": specific_heat, "conductivity": conductivity}
        self._set(
            **{
                name: material_constant(value, f"model.{name}", follows=name == "conductivity")
                for name, value in given.items()
            }
        )
        self.self_term = kinds.one_of(self_term, "model.self_term", SELF_TERMS, "unknown self term")
        self.integrator = first_order(integrator)

    def medium_of(self, constants: Mapping[str, Any]) -> tuple[Any, Any]:
        capacity = constants["density"] * constants["specific_heat"]
        return constants["conductivity"] / capacity, capacity

    def _set(self, **constants: Any) -> None:
        super()._set(**constants)
        self.heat_capacity = float("nan") if self.varying else float(self.density * self.specific_heat)

    def stencil(self, spacing: float, dim: int) -> Stencil:
        """Return the dimensionless stencil on a lattice, with the self term included in the weights of the nearest
        neighbours.
        """
        if not isinstance(self.operator, Kernel) or self.self_term == "none":
            return super().stencil(spacing, dim)
        kernel = self.operator
        plain = Stencil.from_kernel(replace(kernel, calibrate=False), spacing, dim)
        nearest = np.abs(plain.offsets).sum(1) == 1
        weights = plain.weights + nearest * self_weight(kernel, spacing, dim, self.self_term)
        if kernel.calibrate:
            weights = weights / (0.5 * (weights * plain.offsets[:, 0] ** 2).sum())
        return Stencil(plain.offsets, weights)


def self_weight(kernel: Kernel, spacing: float, dim: int, self_term: str = "centre") -> float:
    """What the integral over a node's own cell adds to the weight of each nearest neighbour, dimensionless, for unit
    conductivity; the influence function is evaluated at the "centre" or a "neighbour".

    In the cell ``T' - T`` is the second derivative times half the squared distance, so that the cell adds ``c w(0) / 2
    integral of x^2 r^-p`` to the second moment along each axis; a weight on the nearest neighbours adds itself. In 1D
    with exponent 2, it is ``k(0) dx / (2 dx^2)`` times dx^2 (Bobaru and Duangpanya 2010, eq 18).
    """
    influence = float(kernel.influence_at(np.array(0.0 if self_term == "centre" else spacing)))
    # Integral of r^(2 - p) over the unit cube, divided into pyramids from the centre to its faces; each axis has a
    # share of 1 / dim.
    points, gauss = np.polynomial.legendre.leggauss(24)
    grids = np.meshgrid(*[points] * (dim - 1), indexing="ij")
    product = np.ones(())
    for _ in range(dim - 1):
        product = np.multiply.outer(product, gauss)
    power = 2 - kernel.exponent
    face = float((product * (1 + sum((g**2 for g in grids), np.zeros(()))) ** (power / 2)).sum())
    moment = 2 * dim * 0.5 ** (dim + power) / (dim + power) * face / dim
    return 0.5 * kernel.scaling_constant(dim) * spacing ** (dim + power) * influence * moment

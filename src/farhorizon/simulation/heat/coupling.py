"""How much the heating by deformation stiffens a solid, and which time step is then stable."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from farhorizon.geometry.lattice import Lattice
from farhorizon.inputs.expressions import as_given
from farhorizon.inputs.sources import field
from farhorizon.inputs.thermal_loads import ThermalLoad
from farhorizon.medium.integrators import Integrator, RungeKuttaChebyshev
from farhorizon.models import LatticeModel

#: Rates at which the growth of the heat's modes is sampled: this many, or 40 for each lobe of a Chebyshev polynomial.
_SAMPLES, _PER_STAGE = 400, 40
_HALVINGS = 60  # of a bracket of the step limit: more than a double has bits


@dataclass(frozen=True)
class Coupling:
    """Constants of a temperature that is computed together with the displacements."""

    # largest T0 alpha^2 s / rho c, s the sum of the normal stresses for unit strain in all directions: upper bound of
    # the relative difference between the adiabatic and the isothermal stiffness
    stiffening: float
    stiffness: float  # the s above
    rate: float  # largest rate of the heat conduction (1/time)
    dt: float  # time step of the heat conduction on its own
    integrator: Integrator  # of the heat conduction

    def softest(self, dt: float) -> float:
        """Return the largest ``1/M``, see `farhorizon.simulation.heat.coupled_temperature`; 1 for slow conduction."""
        stages = self.integrator.chebyshev if isinstance(self.integrator, RungeKuttaChebyshev) else 1
        rates = self.rate * np.linspace(0, 1, 1 + max(_SAMPLES, _PER_STAGE * stages))[1:]
        growth = self.integrator.growth(rates, dt)  # type: ignore[union-attr]
        with np.errstate(divide="ignore"):
            inverse = np.where(growth > -1, 2 * (1 - growth) / (dt * rates * (1 + growth)), np.inf)
        return float(max(1.0, inverse.max()))

    def step_limit(self, model: LatticeModel, rate: float) -> float:
        """Return the largest stable time step of both fields; `rate` is the largest rate of the operator of the
        displacements (1/time^2).
        """
        low, high = 0.0, min(self.integrator.step_limit(self.rate), model.step_limit(rate * (1 + self.stiffening)))
        if self._stable(high, model, rate):
            return high
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if self._stable(middle, model, rate) else (low, middle)
        return low

    def _stable(self, dt: float, model: LatticeModel, rate: float) -> bool:
        softest = self.softest(dt)
        return bool(np.isfinite(softest) and dt <= model.step_limit(rate * (1 + self.stiffening * softest)))


def expansion_of(load: ThermalLoad, lattice: Lattice, model: LatticeModel, lame: np.ndarray) -> np.ndarray:
    """Return the thermal strain per unit of temperature at each node; in plane strain larger by the suppressed
    expansion across the plane. `lame`, shape (2, ...), are Lame's constants at the nodes.
    """
    key = "load.expansion"
    return field(as_given(load.expansion, lattice.dim, key, time=False), lattice, 1, key) * _plane_factor(
        lattice, model, lame
    )


def _plane_factor(lattice: Lattice, model: LatticeModel, lame: np.ndarray) -> Any:
    """Return the ratio of the thermal strains in the plane to unconstrained ones: larger than 1 in plane strain."""
    if lattice.dim != 2 or getattr(model, "plane", None) == "stress":
        return 1.0
    first, shear = lame
    total = first + shear
    return 1 + np.divide(first, 2 * total, out=np.zeros_like(total), where=total > 0)

r"""A temperature that is computed step by step with the displacements, and that the deformation changes.

Of the free energy per volume :math:`\frac12 \varepsilon : C : \varepsilon - \alpha \Theta\, \mathrm{tr}\, \sigma(u) -
\rho c\,\Theta^2 / 2 T_0`, with :math:`\Theta = T - T_0` and the stress :math:`\sigma = C : \varepsilon` at the
reference temperature, follow the forces and, from the entropy,

.. math:: \rho c\,\Theta_t = \kappa \Delta \Theta - T_0\,\alpha\,\mathrm{tr}\,\sigma(u_t) + w

(Biot 1956, Journal of Applied Physics 27, 240; c at constant strain). On the lattice the sum over bonds that stands for
the trace is the adjoint of that by which heat pushes the nodes, so that what the one field loses the other one gains. A
step of the displacements takes the temperature at its start; one of the temperature the trace at its end less that at
its start, and each is of second order if the integrator of the heat is. Then, with the operator A of the heat (its
integrator multiplies the modes by R, and M = dt A (1 + R) / 2 (1 - R), which is 1 for long waves), the form

.. math:: \frac12 v \cdot \Big(1 - \frac{dt^2}{4} (K + B M^{-1} B^T)\Big) v + \frac12 \bar u \cdot K \bar u +
          \frac12 \bar\Theta \cdot \Big(M + \frac{dt^2}{4} A M^{-1} A\Big) \bar\Theta

of the velocities half a step ago and of the means over that step never grows (units of mass, and of rho c / T0): a step
is stable where it is positive. By Cauchy's and Schwarz's inequality :math:`|B^T u|^2 \le \epsilon\, u \cdot K u` with
the :math:`\epsilon` of `farhorizon.simulation.coupling`, bond by bond and state by state, whatever bonds are absent or
vary. (In state-based materials of a Poisson's ratio below 1/4 the dilatation softens, and its energy alone is negative;
there the bound is that without it, and has been seen to hold in noise.)
"""

from __future__ import annotations

from typing import Any

import numpy as np

from farhorizon.simulation.heat_in_steps import HeatInSteps
from farhorizon.simulation.heating import cold_strips
from farhorizon.simulation.near_field import NearField
from farhorizon.simulation.setup import Sides

_RISE = 12  # nodes over which the expansion rises from nothing beside a side that continues the medium without heat


class HeatOfDeformation(HeatInSteps):
    """A temperature that the deformation changes.

    Parameters
    ----------
    *given
        As of `HeatInSteps`, with a load that is coupled.
    """

    kept = (*HeatInSteps.kept, "traces", "traces_beyond")

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        assert self.near.coupling is not None
        self._coupling = self.near.coupling
        self._traces: np.ndarray | None = None
        self._traces_beyond = np.zeros(0)

    def _seen(self) -> np.ndarray:
        return rising(self.near, self.sides)

    def _traces_of(self, level: np.ndarray, apart: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Sum of the normal stresses of each node, as they are without heat, and of those beyond the near field that
        know of heat; if `apart` the layers remember nothing of the level.
        """
        found = self.grid.engine.bonds.traces(level, apart) / self.near.model.source_factor
        own = found[self.grid.nodes].reshape(self.near.lattice.shape)
        return own, np.zeros(0) if self._beyond is None else self._beyond.of(found)

    def _released(self, traces: np.ndarray, before: np.ndarray) -> np.ndarray:
        """Power per volume that the deformation sets free in a step."""
        return -self._zero * self._expansion * (traces - before) / self.near.dt

    def begin(self) -> None:
        """The displacements are those of the start, and of one step before it."""
        engine = self.grid.engine
        older, _ = self._traces_of(engine.older, apart=True)
        self._traces, self._traces_beyond = self._traces_of(engine.current)
        power = self._released(self._traces, older)
        self._before = self._now - self.near.dt / self._capacity * power

    def follow(self, step: int) -> None:
        assert self._traces is not None
        traces, beyond = self._traces_of(self.grid.engine.current)
        self._power = self._released(traces, self._traces)
        super().follow(step)
        if self._beyond is not None:
            self._beyond.heat_up(-self._zero / self._capacity * (beyond - self._traces_beyond))
        self._traces, self._traces_beyond = traces, beyond

    @property
    def _capacity(self) -> float:
        return float(1 / self.load.temperature.model.source_factor)

    @property
    def coupled(self) -> bool:
        return True

    def energies(self) -> dict[str, float]:
        """That of the temperature, half a step ago: ``rho c theta theta^- / 2 T0``."""
        product = self.near.inside((self._now - self._zero) * (self._before - self._zero))
        volume = self.near.lattice.spacing**self.near.lattice.dim
        return {"thermal": float(volume * self._capacity / (2 * self._zero) * product.sum())}

    def _check_heat(self, changed: np.ndarray, step: int) -> None:
        """No heat flows to where the solid knows of none, or not of all, so that strains would be missed. What waves do
        to the temperature there, and leave behind as it was, is not counted.
        """
        flowed, strains = changed, self._whole * changed
        if self._traces is not None:
            flowed = changed + self._zero / self._capacity * self._expansion * self._traces
            strains = np.maximum(np.abs(strains), np.abs(self._traces) / self._coupling.stiffness)
        self._largest = max(self._largest, float(np.abs(strains).max(initial=0)))
        most = self._coupling.stiffening if step else 0.0  # by more waves are changed there
        self._check_sides(self.near.inside(self._whole * flowed), step, _RISE, most)


def rising(near: NearField, sides: Sides) -> np.ndarray:
    """Factor of the expansion at each node: none beside sides where the solid knows of no heat; beside those where the
    medium goes on it rises smoothly, so that waves hardly notice. Shape of the lattice.
    """
    found = np.ones(near.lattice.shape)
    for (axis, side), boundary, cold in cold_strips(near, sides):
        far = np.arange(near.lattice.shape[axis])[::-side]
        part = np.clip((far - cold + 1) / (1 + _RISE * boundary.endless), 0, 1)
        shape = [-1 if a == axis else 1 for a in range(near.lattice.dim)]
        found *= (np.sin(np.pi / 2 * part) ** 2).reshape(shape)
    return found

r"""A temperature that is advanced step by step together with the displacements, and that the deformation changes.

The free energy per volume
:math:`\frac12 \varepsilon : C : \varepsilon - \alpha \Theta\, \mathrm{tr}\, \sigma(u) - \rho c\,\Theta^2 / 2 T_0`, with
:math:`\Theta = T - T_0` and the stress :math:`\sigma = C : \varepsilon` at the reference temperature, yields the forces
and, through the entropy,

.. math:: \rho c\,\Theta_t = \kappa \Delta \Theta - T_0\,\alpha\,\mathrm{tr}\,\sigma(u_t) + w

(Biot 1956, Journal of Applied Physics 27, 240; c at constant strain). On the lattice, the sum over bonds that replaces
the trace is the adjoint of the one that yields the thermal forces on the nodes, so that each field gains what the other
loses. A step of the displacements uses the temperature at its start, a step of the temperature the change of the trace
over the step; both are of second order if the integrator of the heat is. Let A be the operator of the heat, whose
integrator multiplies the modes by R, and M = dt A (1 + R) / 2 (1 - R), which is 1 for long waves. Then the form

.. math:: \frac12 v \cdot \Big(1 - \frac{dt^2}{4} (K + B M^{-1} B^T)\Big) v + \frac12 \bar u \cdot K \bar u +
          \frac12 \bar\Theta \cdot \Big(M + \frac{dt^2}{4} A M^{-1} A\Big) \bar\Theta

of the velocities half a step ago and of the means over that step never grows (in units of mass, and of rho c / T0): a
time step is stable if the form is positive. The Cauchy-Schwarz inequality, applied bond by bond and state by state,
gives :math:`|B^T u|^2 \le \epsilon\, u \cdot K u` with the :math:`\epsilon` of `farhorizon.simulation.heat.coupling`,
whichever bonds are absent and however the constants vary. (In state-based materials with a Poisson's ratio below 1/4
the dilatation softens the solid and its energy on its own is negative; there the bound is the one without dilatation,
which has been observed to hold for random fields.)
"""

from __future__ import annotations

from typing import Any

import numpy as np

from farhorizon.simulation.heat.heat_in_steps import HeatInSteps
from farhorizon.simulation.heat.heating import cold_strips
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Sides

_RISE = 12  # nodes over which the expansion rises from zero next to a side that continues the medium without heat


class HeatOfDeformation(HeatInSteps):
    """A temperature that the deformation changes.

    Parameters
    ----------
    *given
        As for `HeatInSteps`, with a coupled load.
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
        """Return the isothermal sums of the normal stresses at the nodes of the near field, and at those beyond it that
        have a temperature; if `apart`, the memory of the layers is left unchanged.
        """
        found = self.grid.engine.bonds.traces(level, apart) / self.near.model.source_factor
        own = found[self.grid.nodes].reshape(self.near.lattice.shape)
        return own, np.zeros(0) if self._beyond is None else self._beyond.of(found)

    def _released(self, traces: np.ndarray, before: np.ndarray) -> np.ndarray:
        """Power per volume that the deformation releases in a step."""
        return -self._zero * self._expansion * (traces - before) / self.near.dt

    def begin(self) -> None:
        """Compute the traces and the previous temperature, once the engine has the displacements at the start and one
        step before.
        """
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
            per_heat = self._heat.parts.near.model.source_factor
            self._beyond.heat_up(-self._zero * per_heat * (beyond - self._traces_beyond))
        self._traces, self._traces_beyond = traces, beyond

    @property
    def _capacity(self) -> np.ndarray:
        """Heat capacity per volume at each node of the near field."""
        near = self._heat.parts.near
        return np.asarray((1.0 if near.density is None else near.density) / near.model.source_factor)

    @property
    def coupled(self) -> bool:
        return True

    def energies(self) -> dict[str, float]:
        """Energy of the temperature, half a step ago: ``rho c theta theta^- / 2 T0``."""
        product = self.near.inside((self._now - self._zero) * (self._before - self._zero))
        volume = self.near.lattice.spacing**self.near.lattice.dim
        return {"thermal": float(volume / (2 * self._zero) * (self._capacity * product).sum())}

    def _check_heat(self, changed: np.ndarray, step: int) -> None:
        """Check that no heat flows to where bonds ignore it in whole or in part, so that thermal strains would be
        missed. Reversible changes of the temperature by waves do not count.
        """
        flowed, strains = changed, self._whole * changed
        if self._traces is not None:
            flowed = changed + self._zero / self._capacity * self._expansion * self._traces
            strains = np.maximum(np.abs(strains), np.abs(self._traces) / self._coupling.stiffness)
        self._largest = max(self._largest, float(np.abs(strains).max(initial=0)))
        most = self._coupling.stiffening if step else 0.0  # waves miss the stiffening there
        self._check_sides(self.near.inside(self._whole * flowed), step, _RISE, most)


def rising(near: NearField, sides: Sides) -> np.ndarray:
    """Return the factor on the expansion at each node, of the shape of the lattice: zero next to sides where bonds
    ignore heat; where the medium continues it rises smoothly to 1, so that waves hardly notice.
    """
    found = np.ones(near.lattice.shape)
    for (axis, side), boundary, cold in cold_strips(near, sides):
        far = np.arange(near.lattice.shape[axis])[::-side]
        part = np.clip((far - cold + 1) / (1 + _RISE * boundary.endless), 0, 1)
        shape = [-1 if a == axis else 1 for a in range(near.lattice.dim)]
        found *= (np.sin(np.pi / 2 * part) ** 2).reshape(shape)
    return found

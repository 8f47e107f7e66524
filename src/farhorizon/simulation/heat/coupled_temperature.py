r"""A temperature that makes the same steps as the displacements, and one that the deformation changes as well.

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

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np

from farhorizon.boundaries import Side
from farhorizon.engine.features.thermal_strain import give_thermal_strain
from farhorizon.inputs.thermal_loads import ThermalLoad
from farhorizon.simulation.heat.broken_bonds import BrokenBonds
from farhorizon.simulation.heat.coupling import expansion_of
from farhorizon.simulation.heat.thermal_strains import ThermalStrains, check_known, insulated, unheated_strips
from farhorizon.simulation.heat.thermoelastic_sides import ThermoelasticNodes, setup_of_heat
from farhorizon.simulation.processes.process_group import ALONE
from farhorizon.simulation.setup.grid import Grid
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Key, Setup, Sides

_RISE = 12  # nodes over which the expansion rises from zero next to a side that continues the medium without heat


class StaggeredTemperature(ThermalStrains):
    """A temperature that makes the same steps as the displacements, each after theirs.

    The temperature of the load is the set-up of the heat conduction; through the `shared` sides, given as used for the
    temperature, it continues together with the displacements. `time_loop_of` makes a `TimeLoop` of a set-up, given what
    drives it in addition to its sources. Broken bonds do not conduct from the step in which they break.
    """

    kept: ClassVar[tuple[str, ...]] = ("now", "before")  # arrays to save besides the state of the heat conduction

    def __init__(
        self,
        load: ThermalLoad,
        near: NearField,
        grid: Grid,
        sides: Sides,
        shared: Mapping[Key, Side],
        time_loop_of: Callable[[Setup, Callable[[float], np.ndarray]], Any],
        broken: BrokenBonds | None = None,
    ) -> None:
        unshared = {key: side for key, side in sides.items() if key not in shared}
        self.load, self.near, self.grid, self.sides, self._group = load, near, grid, unshared, ALONE
        assert load.reference is not None
        self._reference = load.reference
        self._full_expansion = expansion_of(load, near.lattice, near.model, near.lame)
        self._expansion = self._full_expansion * self._expansion_factor()
        self._largest, self._warned = 0.0, False
        self.every = 1
        self._power = np.zeros(near.lattice.shape)
        self._heat = time_loop_of(setup_of_heat(load, near.dt, shared), lambda _: self._power)
        check_known(len(self._heat.parts.near.conditions.images))
        self._broken = broken
        if broken is not None:
            self._insulated = insulated(load, broken, self._heat.parts, np.zeros(near.lattice.dim, int))
            self._table: np.ndarray | None = broken.table()
        self._beyond = ThermoelasticNodes(grid, self._heat.parts.grid, self._expansion) if shared else None
        self._now = self._before = self._temperature_now()

    def _expansion_factor(self) -> Any:
        """Factor on the expansion at each node."""
        return 1.0

    def _temperature_now(self) -> np.ndarray:
        parts = self._heat.parts
        field = parts.grid.get("u").astype(float)
        return np.asarray(field + parts.near.background)

    def lay(self, step: int) -> float:
        """Give the engine the present thermal strains; return `explained`."""
        changed = self._now - self._reference
        strains = self.near.inside(self._expansion * changed)
        self._check_heat(changed, step)
        give_thermal_strain(self.grid.engine, self.grid.grown(strains), self.grid.grown(np.zeros_like(strains)))
        if self._beyond is not None:
            self._beyond.lay()
        return self.explained

    def follow(self, step: int) -> None:
        """Advance the temperature by a step from number `step`, which the displacements have already made."""
        if self._broken is not None and (table := self._broken.table()) is not self._table:
            self._table = table
            self._heat.sever(self._insulated.of(table, self._heat.parts), step)
        for _ in self._heat.advance(step, 1):
            pass
        self._before, self._now = self._now, self._temperature_now()

    def at_points(self, nodes: np.ndarray, weights: np.ndarray, steps: int) -> np.ndarray:
        """As in `ThermalStrains`, for the temperature after the last step and, of two steps, before it."""
        changed = np.stack([self._before, self._now])[-steps:] - self._reference
        strains = (self._expansion * changed).reshape(steps, -1)
        return np.asarray((strains[:, nodes] * weights).sum(-1))

    @property
    def fields(self) -> dict[str, np.ndarray]:
        return {"T": self._now.copy(), "thermal_strain": self._expansion * (self._now - self._reference)}

    def state(self, step: int) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        arrays, meta = self._heat.state(step)
        kept = {name: getattr(self, f"_{name}") for name in self.kept}
        return {f"heat/{name}": values for name, values in {**arrays, **kept}.items()}, {"heat": meta}

    def take(self, arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any]) -> None:
        of_heat = {name.removeprefix("heat/"): a for name, a in arrays.items() if name.startswith("heat/")}
        facts = meta["heat"]
        self._heat.take([(facts["boxes"][0], of_heat)], facts)
        self._heat.complete()
        if self._broken is not None:
            self._broken.forget()
            self._table = None
        for name in self.kept:
            setattr(self, f"_{name}", of_heat[name])

    def _check_heat(self, changed: np.ndarray, step: int) -> None:
        """Check that no heat flows to where bonds ignore it, so that thermal strains would be missed."""
        self._check_sides(self.near.inside(self._full_expansion * changed), step)


class CoupledTemperature(StaggeredTemperature):
    """A temperature that the deformation changes, too."""

    kept = (*StaggeredTemperature.kept, "traces", "traces_beyond")

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        assert self.near.coupling is not None
        self._coupling = self.near.coupling
        self._traces: np.ndarray | None = None
        self._traces_beyond = np.zeros(0)

    def _expansion_factor(self) -> np.ndarray:
        """Factor on the expansion at each node, of the shape of the lattice: zero next to sides where bonds ignore
        heat; where the medium continues it rises smoothly to 1, so that waves hardly notice.
        """
        lattice = self.near.lattice
        factor = np.ones(lattice.shape)
        for (axis, side), boundary, unheated in unheated_strips(self.near, self.sides):
            far = np.arange(lattice.shape[axis])[::-side]
            ramp = np.clip((far - unheated + 1) / (1 + _RISE * boundary.endless), 0, 1)
            shape = [-1 if a == axis else 1 for a in range(lattice.dim)]
            factor *= (np.sin(np.pi / 2 * ramp) ** 2).reshape(shape)
        return factor

    def _traces_of(self, level: str, apart: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Return the isothermal sums of the normal stresses at the nodes of the near field, and at those beyond it that
        have a temperature; if `apart`, the memory of the layers is left unchanged.
        """
        traces = self.grid.engine.bonds.traces(level, apart) / self.near.model.source_factor
        of_near = traces[self.grid.nodes].reshape(self.near.lattice.shape)
        return of_near, np.zeros(0) if self._beyond is None else self._beyond.of(traces)

    def _released(self, traces: np.ndarray, before: np.ndarray) -> np.ndarray:
        """Power per volume that the deformation releases in a step."""
        return -self._reference * self._expansion * (traces - before) / self.near.dt

    def begin(self) -> None:
        """Compute the traces and the previous temperature, once the engine has the displacements at the start and one
        step before.
        """
        older, _ = self._traces_of("u_old", apart=True)
        self._traces, self._traces_beyond = self._traces_of("u")
        power = self._released(self._traces, older)
        self._before = self._now - self.near.dt / self._capacity * power

    def follow(self, step: int) -> None:
        assert self._traces is not None
        traces, beyond = self._traces_of("u")
        self._power = self._released(traces, self._traces)
        super().follow(step)
        if self._beyond is not None:
            per_heat = self._heat.parts.near.model.source_factor
            self._beyond.heat_up(-self._reference * per_heat * (beyond - self._traces_beyond))
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
        product = self.near.inside((self._now - self._reference) * (self._before - self._reference))
        volume = self.near.lattice.spacing**self.near.lattice.dim
        return {"thermal": float(volume / (2 * self._reference) * (self._capacity * product).sum())}

    def _check_heat(self, changed: np.ndarray, step: int) -> None:
        """Check that no heat flows to where bonds ignore it in whole or in part, so that thermal strains would be
        missed. Reversible changes of the temperature by waves do not count.
        """
        flowed, strains = changed, self._full_expansion * changed
        if self._traces is not None:
            flowed = changed + self._reference / self._capacity * self._expansion * self._traces
            strains = np.maximum(np.abs(strains), np.abs(self._traces) / self._coupling.stiffness)
        self._largest = max(self._largest, float(np.abs(strains).max(initial=0)))
        most = self._coupling.stiffening if step else 0.0  # waves miss the stiffening there
        self._check_sides(self.near.inside(self._full_expansion * flowed), step, _RISE, most)

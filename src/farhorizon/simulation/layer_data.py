"""The data, sources and conditions of a set-up, in the form from which reflection by its layers is predicted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from farhorizon.analysis.layers.diffusing import Cause, goes_on
from farhorizon.analysis.layers.side_data import Datum
from farhorizon.inputs.incidence import Incident
from farhorizon.inputs.sources import by_component, field, split
from farhorizon.inputs.thermal_loads import ThermalLoad
from farhorizon.simulation.coupling import expansion_of
from farhorizon.simulation.near_field import NearField
from farhorizon.simulation.setup import Setup, Sides
from farhorizon.simulation.solid_and_liquid import placed
from farhorizon.simulation.wave_data import stand_ins

_MOMENTS = 33  # times at which sources of diffusion are sampled, to see whether they are constant
_FAST = 0.5  # fraction of the largest frequency above which waves may run backward or hardly move


@dataclass(frozen=True)
class Driven:
    """All that drives a near field.

    Attributes
    ----------
    setup : Setup
    near : NearField
    sources : sequence
        Sources, incident waves and loads.
    """

    setup: Setup
    near: NearField
    sources: Sequence[Any]

    def data(self, times: np.ndarray) -> list[Datum]:
        """Return all that sends waves: initial data, and sources with their values at some times; empty if any source
        is an incident wave or does not split into space and time.
        """
        near, lattice = self.near, self.near.lattice
        components = near.stencil.components
        found = self.initial()
        for source in self.sources:
            if isinstance(source, Incident):
                return []
            for part, unit in by_component(source, lattice, components):
                space, time = split(part, lattice, components if np.ndim(unit) == 0 else 1)
                if space is None:
                    return []
                course = np.array([float(time(t)) for t in times])
                found += self._by_component(unit * space * near.model.source_factor, "source", course)
        heat = self.setup.heat
        if heat is not None and heat.joint:
            if heat.temperature.sources or heat.temperature.constraints:
                return []
            found += self._by_component(self._push_of_heat(heat), "source", np.ones(times.size))
        return found

    def times(self, until: float) -> np.ndarray:
        return np.arange(int(np.ceil(until / self.near.dt)) + 1) * self.near.dt

    @property
    def like_near_field(self) -> tuple[tuple[int, ...], int, int]:
        """Shape of the near field, largest reach and number of components."""
        stencil = self.near.stencil
        return self.near.lattice.shape, max(stencil.reach), stencil.components

    def courses(self, until: float, least: float) -> list[np.ndarray]:
        """Return the time dependence of scattered waves, if incident waves with known signals are all that drives the
        run: scattering preserves frequencies. The courses are those of the velocities.

        Empty if bonds break, which emits waves of any frequency, and if more than `least` of a signal lies at
        frequencies of waves that run backward or hardly move: what leaks of these from the box of an incident wave
        stays near the sides for a long time.
        """
        near, times = self.near, self.times(until)
        found = [source.velocities(times) if isinstance(source, Incident) else None for source in self.sources]
        courses = [course for course in found if course is not None]
        alone = len(courses) == len(found) > 0 and not self.initial() and self.setup.heat is None
        if not alone or self.setup.model.bond_law is not None:
            return []
        spectra = np.abs(np.fft.rfft(courses, 2 * len(times)))
        fast = 2 * np.pi * np.fft.rfftfreq(2 * len(times), near.dt) > _FAST * np.sqrt(near.rate_limit)
        share = float((spectra[:, fast].sum(1) / np.maximum(spectra.sum(1), 1e-300)).max())
        return courses if share < least else []

    def _push_of_heat(self, load: ThermalLoad) -> np.ndarray:
        """Return the force of the initial temperature on the solid, as if it were constant: minus the gradient of the
        thermal pressure, in the units of a source.
        """
        near, lattice = self.near, self.near.lattice
        warm = (load.temperature.initial or {}).get("u", load.reference)
        strain = expansion_of(load, lattice, near.model, near.lame)
        strain = strain * (field(warm, lattice, 1, "initial.T") - load.reference)
        pressure = near.inside((lattice.dim * near.lame[0] + 2 * near.lame[1]) * strain)
        slopes = [np.gradient(pressure, lattice.spacing, axis=axis) for axis in range(lattice.dim)]
        return -near.model.source_factor * np.stack(slopes)

    def initial(self) -> list[Datum]:
        """Return the initial data."""
        near, initial, found = self.near, self.setup.initial or {}, []
        for name in ("u", "v"):
            if name in initial:
                values = field(initial[name], near.lattice, near.stencil.components, f"initial.{name}")
                found += self._by_component(near.inside(values - (near.background if name == "u" else 0.0)), name)
        return found

    def _by_component(self, values: np.ndarray, kind: str, time: np.ndarray | None = None) -> list[Datum]:
        """Return a datum for each component that is not zero everywhere."""
        time = np.zeros(0) if time is None else time
        parts = values.reshape(-1, *self.near.lattice.shape)
        return [Datum(part, kind, time, i) for i, part in enumerate(parts) if part.any()]

    def scatterers(self) -> np.ndarray:
        """Return the nodes that scatter waves: around cracks, outside a body, where the medium changes, and those that
        are held.
        """
        lattice = self.near.lattice
        found = np.zeros(lattice.shape, bool)
        for crack in self.setup.cracks:
            low, high = (np.asarray(bound, float) for bound in crack.cut.bounds())
            first, last = (np.round((bound - lattice.lower) / lattice.spacing).astype(int) for bound in (low, high))
            found[tuple(slice(max(a, 0), max(b, 0) + 1) for a, b in zip(first, last, strict=True))] = True
        if lattice.existing is not None:
            found |= ~lattice.existing
        for values in (self.near.factor, self.near.density):
            if values is not None:
                for axis in range(lattice.dim):
                    found |= np.abs(np.gradient(values, axis=axis)) > 0
        for nodes in self.near.prescribed.nodes:
            found.ravel()[nodes] = True
        return found

    def causes(self, until: float, sides: Sides) -> Iterator[Cause]:
        """Yield all from which diffusion starts: initial data, sources, nodes with constant values, and scatterers."""
        near = self.near
        busy, held, conditions = self.scatterers(), np.zeros(near.lattice.shape, bool), near.conditions
        if self.setup.specimens:
            held |= placed(self.setup, sides)[0]
        lasting = ~conditions.resting & conditions.constant
        held.ravel()[conditions.nodes[lasting]] = True
        busy.ravel()[conditions.nodes[~lasting]] = True
        data = self.data(np.linspace(0, until, _MOMENTS))
        for datum in data:
            start = datum.kind == "u"
            yield Cause(datum, 2 * (not start and goes_on(datum.time)), start)
        for datum in [] if data else stand_ins(*self.like_near_field):
            yield Cause(datum)
        yield Cause(Datum(held.astype(float), "u"), lasting=1)
        yield Cause(Datum(busy.astype(float), "u"))

"""Absorbing sides beyond which a temperature continues together with the displacements: in the layers of the solid, or
as far as the domain is extended.

In a layer the shifts along its normal are stretched. The coupling of the two fields is exact there, too, if both are
continued with the same stretch: the heat then has the layers of the solid, edge by edge, and its time step.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from farhorizon.boundaries import Side
from farhorizon.engine.engine import Layer
from farhorizon.engine.features.thermal_strain import give_thermal_strain_beyond
from farhorizon.inputs.thermal_loads import ThermalLoad
from farhorizon.simulation.setup.grid import Grid
from farhorizon.simulation.setup.near_field import heat_alone
from farhorizon.simulation.setup.setup import Key, Setup, Sides, side_name
from farhorizon.simulation.sides.layered_sides import LayeredSides


def thermoelastic_sides(setup: Setup, sides: Sides, dt: float) -> frozenset[Key]:
    """Return the sides beyond which the temperature continues with the displacements. There are none if some other side
    absorbs, if the integrator of the heat has several stages, if the heat's background is not the reference
    temperature, or if uncoupled heat is unstable with the time step of the solid. `sides` and `dt` are those of the
    displacements, as chosen.
    """
    load = setup.heat
    if load is None or not load.joint:
        return frozenset()
    heat = load.temperature
    joint = {key for key, side in sides.items() if (side.stretched or side.extended) and side_name(*key) in load.joint}
    others = [side for key in sides.keys() - joint for side in (sides[key], heat.sides[key])]
    once = len(heat.model.integrator.stages(dt).numbers) == 1  # each stage would need a memory of its own
    if not once or heat.background != load.reference or any(side.endless for side in others):
        return frozenset()
    return frozenset(joint) if load.coupled or dt <= heat_alone(heat).step_limit else frozenset()


def thermoelastic_margins(setup: Setup, thermoelastic: Collection[Key], layered: LayeredSides) -> dict[Key, int]:
    """Return the numbers of nodes of the core in front of layers of both fields, which keep data and sources out of
    them.
    """
    return {key: 1 + max(_reaches(setup, key[0])) for key in thermoelastic if key in layered.layers}


def _reaches(setup: Setup, axis: int) -> list[int]:
    """Return the reach of the bonds of each field along an axis."""
    assert setup.heat is not None
    lattice, models = setup.lattice, (setup.model, setup.heat.temperature.model)
    return [model.medium(lattice.spacing, lattice.dim).reach[axis] for model in models]


def heat_front(setup: Setup, thermoelastic: Collection[Key], until: float, error: float) -> int:
    """Return the number of nodes beyond a side for which the heat that returns from the end of an extended domain is at
    most an error.
    """
    if not thermoelastic or setup.heat is None:
        return 0
    heat = heat_alone(setup.heat.temperature)
    diffusivity = heat.model.coefficient * heat.strongest
    return int(np.ceil(np.sqrt(diffusivity * until * np.log(1 / error)) / heat.lattice.spacing))


def sides_of_heat(layered: LayeredSides, margins: Mapping[Key, int], thermoelastic: Collection[Key]) -> dict[Key, Side]:
    """Return the sides that the heat shares with the solid, whose layered sides and nodes beyond the near field are
    given, in the form for the heat. The damping of layers is left out: the temperature does not need it.
    """
    sides: dict[Key, Any] = {}
    for key in thermoelastic:
        layer, side = layered.layers.get(key), layered.sides[key]
        if layer is None:
            sides[key] = replace(side, nodes=max(1, margins[key]))
        else:
            profile = Layer(layer.kappa, layer.sigma, layer.alpha)
            sides[key] = replace(side, nodes=layer.columns, profile=profile)
    return sides


def setup_of_heat(load: ThermalLoad, dt: float, shared: Mapping[Key, Side]) -> Setup:
    """Return the set-up of the heat with the time step of the solid and the sides that they share."""
    heat = load.temperature
    named = {side_name(*key): side for key, side in shared.items()}
    return replace(heat, dt=dt, balance=False, boundary={**heat.boundary, **named})


class ThermoelasticNodes:
    """Nodes beyond the near field that both fields have on grids with the same nodes: those of the layers and in front
    of them.

    The expansion, strain per unit of temperature at each node of the near field, is continued along the normals.
    """

    def __init__(self, solid: Grid, heat: Grid, expansion: np.ndarray) -> None:
        self.solid, self.heat = solid.engine, heat.engine
        self._places, self._of_heat = (_beyond(grid) for grid in (solid, heat))
        self._expansion = self.solid.spread(solid.grown(expansion))[self._places].astype(float)
        self._expansion *= self.heat.absent.exists[self._of_heat]

    @property
    def changed(self) -> np.ndarray:
        """Temperature minus that far away."""
        return self.heat.current[self._of_heat].astype(float)

    def lay(self) -> None:
        """Give the thermal strains of these nodes to the engine of the solid."""
        give_thermal_strain_beyond(self.solid, self._places, self._expansion * self.changed)

    def of(self, values: np.ndarray) -> np.ndarray:
        """Return the values of these nodes, from an array over a level of the solid."""
        return values[self._places]

    def heat_up(self, released: np.ndarray) -> None:
        """Warm these nodes by the heat that deformation releases in a step, per unit of expansion and over the model's
        heat capacity.
        """
        mobility = self.heat.tables.mobility
        lighter = mobility[self._of_heat] if mobility.size else 1.0
        self.heat.current[self._of_heat] += self._expansion * released * lighter


def _beyond(grid: Grid) -> np.ndarray:
    """Return the places of the nodes beyond the near field, in the order of the box."""
    places, inside = grid.layout.box.node_indices(), np.zeros(grid.layout.size, bool)
    inside[grid.nodes] = True
    return np.asarray(places[~inside[places]])

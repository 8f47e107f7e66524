"""Absorbing sides through which a temperature goes on with the displacements: in the layers of the solid, or as far as
the domain is extended.

In a layer the shifts along its normal are stretched. What couples both fields is exact there, too, if both are
continued by the same stretch: then the heat has the layers of the solid, edge by edge, and its steps.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from farhorizon.boundaries import Side
from farhorizon.engine.engine import Layer
from farhorizon.engine.settings import give_heat_beyond
from farhorizon.inputs.thermal_loads import ThermalLoad
from farhorizon.simulation.grid import Grid
from farhorizon.simulation.near_field import heat_alone
from farhorizon.simulation.setup import Key, Setup, Sides, side_name
from farhorizon.simulation.surroundings import Surroundings


def warm_sides(setup: Setup, sides: Sides, dt: float) -> frozenset[Key]:
    """The sides through which the temperature goes on with the displacements; none beside absorbing ones of other
    kinds, where each field has its own, or where the heat does not bear the steps of the solid.

    Parameters
    ----------
    setup : Setup
    sides : dict of (axis, side) to Side
        Of the displacements, as they are chosen.
    dt : float
        Their step.
    """
    load = setup.heat
    if load is None or not load.joint:
        return frozenset()
    heat = load.temperature
    found = {key for key, side in sides.items() if (side.stretched or side.extended) and side_name(*key) in load.joint}
    others = [side for key in sides.keys() - found for side in (sides[key], heat.sides[key])]
    once = len(heat.model.integrator.stages(dt).numbers) == 1  # each stage would have a memory of its own
    if not once or heat.background != load.reference or any(side.endless for side in others):
        return frozenset()
    return frozenset(found) if load.coupled or dt <= heat_alone(heat).step_limit else frozenset()


def warm_margins(setup: Setup, warm: Collection[Key], around: Surroundings) -> dict[Key, int]:
    """Nodes of the core in front of the layers of both fields, which keep data and sources out of them."""
    return {key: 1 + max(_reaches(setup, key[0])) for key in warm if key in around.layers}


def _reaches(setup: Setup, axis: int) -> list[int]:
    """How far the bonds of both fields reach along an axis."""
    assert setup.heat is not None
    lattice, models = setup.lattice, (setup.model, setup.heat.temperature.model)
    return [model.medium(lattice.spacing, lattice.dim).reach[axis] for model in models]


def heat_front(setup: Setup, warm: Collection[Key], until: float, error: float) -> int:
    """Nodes of an extended domain from whose end no more of the heat comes back than an error."""
    if not warm or setup.heat is None:
        return 0
    heat = heat_alone(setup.heat.temperature)
    diffusivity = heat.model.coefficient * heat.strongest
    return int(np.ceil(np.sqrt(diffusivity * until * np.log(1 / error)) / heat.lattice.spacing))


def sides_of_heat(around: Surroundings, margins: Mapping[Key, int], warm: Collection[Key]) -> dict[Key, Side]:
    """The sides that the heat shares with the solid, as it has them.

    Parameters
    ----------
    around : Surroundings
        Of the solid. Short waves of the temperature need no damping.
    margins : mapping of (axis, side) to int
        Nodes of the core beyond the near field.
    warm : collection of (axis, side)
    """
    found: dict[Key, Any] = {}
    for key in warm:
        layer, side = around.layers.get(key), around.sides[key]
        if layer is None:
            found[key] = replace(side, nodes=max(1, margins[key]))
        else:
            profile = Layer(layer.kappa, layer.sigma, layer.alpha)
            found[key] = replace(side, nodes=layer.columns, profile=profile)
    return found


def heat_beside(load: ThermalLoad, dt: float, shared: Mapping[Key, Side]) -> Setup:
    """The set-up of the heat, with steps of the solid and the sides that it shares with it."""
    heat = load.temperature
    named = {side_name(*key): side for key, side in shared.items()}
    return replace(heat, dt=dt, balance=False, boundary={**heat.boundary, **named})


class WarmNodes:
    """Nodes beyond the near field that both fields have: those of the layers and in front of them.

    Parameters
    ----------
    solid, heat : Grid
        With the same nodes.
    expansion : ndarray
        What a unit of the temperature strains each node of the near field; goes on along the normals.
    """

    def __init__(self, solid: Grid, heat: Grid, expansion: np.ndarray) -> None:
        self.solid, self.heat = solid.engine, heat.engine
        self._places, self._of_heat = (_beyond(grid) for grid in (solid, heat))
        self._expansion = self.solid.spread(solid.grown(expansion))[self._places].astype(float)
        self._expansion *= self.heat.absent.exists[self._of_heat]

    @property
    def changed(self) -> np.ndarray:
        """Temperature over that far away."""
        return self.heat.current[self._of_heat].astype(float)

    def lay(self) -> None:
        """Tell the engine of the solid what heat strains these nodes."""
        give_heat_beyond(self.solid, self._places, self._expansion * self.changed)

    def of(self, values: np.ndarray) -> np.ndarray:
        """Values at the places of a level of the solid, at these nodes."""
        return values[self._places]

    def heat_up(self, released: np.ndarray) -> None:
        """Warm these nodes by what deformation sets free in a step, for a unit of the expansion."""
        self.heat.current[self._of_heat] += self._expansion * released


def _beyond(grid: Grid) -> np.ndarray:
    """Places of the nodes beyond the near field, in the order of the box."""
    places, inside = grid.engine.layout.box.node_indices(), np.zeros(grid.engine.layout.size, bool)
    inside[grid.nodes] = True
    return np.asarray(places[~inside[places]])

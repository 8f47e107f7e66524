"""The exterior of a near field: layers and other nodes beyond its sides, and the memory that a run needs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from farhorizon.analysis.extent import Extent
from farhorizon.analysis.layers.profiles import weak
from farhorizon.analysis.layers.short_waves import high_pass
from farhorizon.engine.engine import Layer
from farhorizon.machine import check_fits
from farhorizon.medium.stencil import Stencil
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Key, Setup, Sides, side_name

_LITTLE = 0.3  # largest damping in two steps for which the filter is applied only in every second step
_TURN = 0.2  # and largest fraction of a period by which the fastest wave may advance in a step


@dataclass(frozen=True, eq=False)
class LayeredSides:
    """The sides of a near field and what has been chosen for them."""

    sides: Sides
    coefficients: dict[Key, float]  # squared speed or diffusivity of the medium at each side
    layers: dict[Key, Layer]
    extents: dict[Key, Extent] = field(default_factory=dict)  # of sides that extend the domain
    doubts: list[str] = field(default_factory=list)  # warnings of extended domains predicted to miss their targets
    undesigned: str = ""  # why layers without a target may reflect more than the model's default target, if so

    def as_given(self) -> dict[str, Any]:
        """Return the sides by name, with their layers as given, so that a run with them chooses nothing."""
        return {
            side_name(*key): replace(side, nodes=self.layers[key].columns, profile=self.layers[key])
            if key in self.layers
            else side
            for key, side in self.sides.items()
        }

    def width(self, key: Key, stencil: Stencil, spacing: float) -> int:
        """Return the number of nodes of the core that a sponge, an extended side or a condition along the outline needs
        beyond the near field.
        """
        if key in self.extents:
            return self.extents[key].nodes
        return self.sides[key].width(stencil.reach[key[0]], spacing)

    def beyond(self, stencil: Stencil, spacing: float) -> dict[Key, int]:
        """Return the number of nodes that are computed beyond each side: those of its layer, or `width`."""
        layers = {key: layer.columns for key, layer in self.layers.items()}
        return {key: layers.get(key, self.width(key, stencil, spacing)) for key in self.sides}

    def depth(self, stencil: Stencil, spacing: float, shape: tuple[int, ...]) -> dict[Key, int]:
        """Return the number of nodes beyond each absorbing side at which data and sources are checked: those of its
        layer or sponge, or one reach if that is more; beyond an exact end or an extended side, as many as the near
        field has.
        """
        nodes = {key: layer.columns for key, layer in self.layers.items()}
        for key, side in self.sides.items():
            if side.endless and not side.stretched:
                nodes[key] = shape[key[0]] if side.exact or side.extended else self.width(key, stencil, spacing)
        return {key: max(n, stencil.reach[key[0]]) for key, n in nodes.items()}


def by_target(setup: Setup, sides: Sides, stencil: Stencil, faster: Mapping[Key, float] | None = None) -> LayeredSides:
    """Return the sides with layers that are given or follow from their targets alone; `faster` is the squared speed of
    the medium at each side over that of the model.
    """
    lattice, model = setup.lattice, setup.model
    coefficients = {key: model.coefficient * (1.0 if faster is None else faster[key]) for key in sides}
    half_width = max(float((lattice.upper - lattice.lower).max()) / 2, lattice.spacing)
    made, layers = {}, {}  # sides that are alike have the same layer
    for key, side in sides.items():
        if side.stretched:
            first, coefficient = stencil.along(key[0]), coefficients[key]
            alike = id(side), id(first), coefficient
            if alike not in made:
                first = first.beside(coefficient / model.coefficient)
                made[alike] = side.make_layer(model.order, first, coefficient, lattice.spacing, half_width)
            layers[key] = made[alike]
    return LayeredSides(sides, coefficients, layers)


def undesigned(near: NearField, sides: Sides) -> str:
    """Return why layers for scalar waves without a target may reflect more than the model's default target; empty if
    they are made for it.

    The default layers are made for kernels that are symmetric about their axes and whose waves run forward. Backward
    waves are damped, so that nothing grows, but what is damped is also reflected.
    """
    given = {key: side for key, side in sides.items() if side.stretched and side.nodes is not None}
    untargeted = [side_name(*key) for key, side in given.items() if side.target is None and not side.whole]
    if not untargeted or near.model.order == 1 or near.stencil.components > 1:
        return ""
    if not all(near.stencil.even_along(axis) for axis in range(near.lattice.dim)):
        why = "the kernel is not symmetric about its axes"
    elif not weak(high_pass(near.continued)):
        why = "short waves of this kernel run backward, and the layers damp them"
    else:
        return ""
    return (
        f"the layers ({', '.join(untargeted)}) have no target, and are not made for {near.model.target:g} of the "
        f"largest value: {why}; give a target, or measure with 'farhorizon compare'"
    )


def with_one_filter(layers: Mapping[Key, Layer], rate: float, dt: float, dim: int) -> dict[Key, Layer]:
    """Return the layers of a run with the longest of their filters in common, and with how often it is applied.

    If the damping of short waves is weak, the filter is applied in every second step only, provided that no wave
    advances by a quarter of a period in a step: at a quarter, a standing wave might have no velocity whenever the
    filter is applied, and beyond it the filter would alias waves of different frequencies. In 1D it is applied in every
    step, as the analysis of a line assumes. `rate` is the largest squared frequency. If layers already state how often,
    as on a process that received them, that is kept.
    """
    damped = [layer for layer in layers.values() if layer.filtered]
    if not damped:
        return dict(layers)
    of_field, taps = any(layer.whole for layer in damped), max((layer.taps for layer in damped), key=len)
    most = 2 * dim * dt * max(float(layer.damping.max()) for layer in damped)
    turn = float(np.arcsin(min(1.0, dt * np.sqrt(rate) / 2)) / np.pi)
    seldom = dim > 1 and not of_field and most <= _LITTLE and turn <= _TURN
    every = max(layer.every for layer in damped) or 1 + seldom
    return {
        key: replace(layer, taps=taps, whole=of_field, every=every) if layer.filtered else layer
        for key, layer in layers.items()
    }


def spreads(sides: Sides, axis: int) -> bool:
    """Whether the medium continues beyond at least one side along every axis other than this one.

    Between two walls, and along a periodic axis, waves near their cut-off hardly move towards a side and return again
    and again, and some waves of plates run backward even at low frequencies: in thin layers they grow by 0.01
    c/spacing.
    """
    across = {a for a, _ in sides} - {axis}
    open_ended = {a for (a, _), side in sides.items() if not side.periodic and not side.image}
    return bool(across) and across <= open_ended


def memory_needed(setup: Setup, stencil: Stencil, layered: LayeredSides) -> float:
    """Return the peak memory in bytes, which is needed during set-up: three levels and the layers' memory once more,
    and about seven fields besides coordinates, all of doubles.
    """
    lattice, reach, itemsize = setup.lattice, stencil.reach, np.dtype(setup.dtype).itemsize
    widths = {key: layered.width(key, stencil, lattice.spacing) for key in layered.sides}
    shape = [n + sum(width for (a, _), width in widths.items() if a == axis) for axis, n in enumerate(lattice.shape)]
    columns = [
        sum(layer.columns for (a, _), layer in layered.layers.items() if a == axis) for axis in range(lattice.dim)
    ]
    nodes = [float(n + 2 * m + c) for n, m, c in zip(shape, reach, columns, strict=True)]
    sides = [2 * m * c * np.prod(nodes) / n for c, m, n in zip(columns, reach, nodes, strict=True)]
    # the edges between sides of the first two axes
    memory = sum(sides) + (sides[0] * sides[1] / np.prod(nodes) / 2 if lattice.dim == 3 else 0.0)
    tuned = {key: layer.columns for key, layer in layered.layers.items() if layer.tuned.size}
    memory += 3 * sum(columns * np.prod(nodes) / nodes[axis] for (axis, _), columns in tuned.items())
    levels = setup.model.integrator.stages(1.0, 0.0, lattice.dim == 1).levels + setup.lasting
    if (attenuation := setup.model.attenuation) is not None:
        levels += 1 + attenuation.memories * (1 + setup.balance)
    bits = 8 * -(-len(stencil.weights) // 64) * (setup.model.bond_law is not None)
    fields = itemsize * ((levels + 3) * np.prod(nodes) + 2 * memory + sides[-1]) + 8 * 7 * np.prod(lattice.shape)
    return float(stencil.components * fields + (8 * lattice.dim + bits) * np.prod(lattice.shape))


def check_memory(setup: Setup, stencil: Stencil, layered: LayeredSides) -> None:
    """Raise InputError if the run does not fit into memory."""
    remedy = "a coarser or smaller lattice, thinner layers, or float32"
    nodes = f"{int(np.prod(setup.lattice.shape))} nodes"
    check_fits(memory_needed(setup, stencil, layered), "the run does", "lattice", remedy, nodes)


def enlarged(shape: tuple[int, ...], more: Mapping[Key, int]) -> float:
    """Return the number of nodes of a near field together with given numbers of nodes beyond its sides."""
    return float(np.prod([float(n + more.get((a, -1), 0) + more.get((a, 1), 0)) for a, n in enumerate(shape)]))


def check_extended(need: float, shape: tuple[int, ...], more: Mapping[Key, int]) -> None:
    """Refuse an extended domain that needs too many bytes."""
    remedy = "LatticePML, a shorter run, a larger target or float32"
    check_fits(need, "the extended domain does", "boundary", remedy, f"{enlarged(shape, more):.3g} nodes")

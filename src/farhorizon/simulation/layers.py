"""Layers whose number of nodes is given: what they damp short waves with, and what is not known of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from farhorizon.analysis.exact.chain import Recursion
from farhorizon.analysis.layers.choice import weak
from farhorizon.analysis.layers.layer import LatticeMedium
from farhorizon.analysis.layers.short_waves import high_pass
from farhorizon.analysis.layers.tuned_layers import as_quiet, lightly_tuned
from farhorizon.boundaries import Side
from farhorizon.engine.engine import Layer
from farhorizon.medium.stencil import Stencil
from farhorizon.simulation.near_field import NearField
from farhorizon.simulation.setup import Key, Sides, side_name
from farhorizon.simulation.surroundings import Surroundings

_LITTLE = 0.3  # largest damping in two steps for which the filter is applied only in every second step
_TURN = 0.2  # and largest fraction of a period by which the fastest wave may advance in a step
_LIGHT = 1e-5  # smallest target for light dampers, which reflect at most 2e-6 of a resolved pulse


def undesigned(near: NearField, sides: Sides) -> str:
    """Return why layers for scalar waves without a target may reflect more than the model's default target; empty if
    they are made for it.

    The default layers are made for kernels that are symmetric about their axes and whose waves run forward. Backward
    waves are damped, so that nothing grows, but what is damped is also reflected.
    """
    given = {key: b for key, b in sides.items() if b.stretched and b.nodes is not None}
    asked = [side_name(*key) for key, b in given.items() if b.target is None and not b.whole]
    if not asked or near.model.order == 1 or near.stencil.components > 1:
        return ""
    if not all(near.stencil.even_along(axis) for axis in range(near.lattice.dim)):
        why = "the kernel is not symmetric about its axes"
    elif not weak(high_pass(near.continued)):
        why = "short waves of this kernel run backward, and the layers damp them"
    else:
        return ""
    return (
        f"the layers ({', '.join(asked)}) have no target, and are not made for {near.model.target:g} of the largest "
        f"value: {why}; give a target, or measure with 'farhorizon compare'"
    )


def with_light_dampers(near: NearField, around: Surroundings) -> Surroundings:
    """Return the surroundings with light dampers in place of filters in layers for scalar waves that are given by their
    number of nodes and have a target of `_LIGHT` or more, if they reflect no more then, where the medium is uniform
    and continues beyond at least one side along every other axis. Layers that are chosen may have light dampers anyway.

    Each of several processes comes to the same result on its own.
    """
    if near.model.order == 1 or near.weakest != near.strongest:
        return around
    found = dict(around.layers)
    known: dict[tuple[Side, Stencil, float], Layer] = {}  # equivalent sides have the same layer
    for key, boundary in around.sides.items():
        layer = found.get(key)
        if layer is None or not _may_be_light(boundary, layer) or not spreads(around.sides, key[0]):
            continue
        squared, first = around.coefficients[key], 0 if near.stencil.same_along(0, key[0]) else key[0]
        stencil = near.stencil.along(first).beside(squared / near.model.coefficient)
        alike = boundary, stencil, squared
        if alike not in known:
            known[alike] = _light_if_quiet(layer, stencil, squared, near)
        found[key] = known[alike]
    return replace(around, layers=found)


def _may_be_light(boundary: Side, layer: Layer) -> bool:
    """Whether a layer has a filter, is given by its number of nodes, and has a target of `_LIGHT` or more."""
    by_nodes = boundary.profile is None and not boundary.open_ended
    return layer.filtered and by_nodes and (boundary.target or 0.0) >= _LIGHT


def _light_if_quiet(layer: Layer, stencil: Stencil, squared: float, near: NearField) -> Layer:
    """Return the layer with light dampers, or the layer itself if it cannot have them or would reflect more."""
    light = lightly_tuned(layer, stencil, float(np.sqrt(squared)) / near.lattice.spacing, near.dt)
    if light is None:
        return layer
    # without the damping of the model, which affects both alike
    recursion = Recursion.of(near.model.integrator, near.dt)
    medium = LatticeMedium(stencil, squared, near.lattice.spacing, recursion, near.dt)
    return light if as_quiet(light, layer, medium) else layer


def with_one_filter(layers: Mapping[Key, Layer], rate: float, dt: float, dim: int) -> dict[Key, Layer]:
    """Return the layers of a run with the longest of their filters in common, and with how often it is applied.

    If the damping of short waves is weak, the filter is applied in every second step only, provided that no wave
    advances by a quarter of a period in a step: at a quarter, a standing wave might have no velocity whenever the
    filter is applied, and beyond it the filter would alias waves of different frequencies. In 1D it is applied in every
    step, as the analysis of a line assumes.

    Parameters
    ----------
    layers : mapping of (axis, side) to Layer
        If some already state how often, as on a process that received them, that is kept.
    rate : float
        Largest squared frequency.
    dt : float
    dim : int
    """
    damped = [layer for layer in layers.values() if layer.filtered]
    if not damped:
        return dict(layers)
    whole, taps = any(layer.whole for layer in damped), max((layer.taps for layer in damped), key=len)
    most = 2 * dim * dt * max(float(layer.damping.max()) for layer in damped)
    turn = float(np.arcsin(min(1.0, dt * np.sqrt(rate) / 2)) / np.pi)
    seldom = dim > 1 and not whole and most <= _LITTLE and turn <= _TURN
    every = max(layer.every for layer in damped) or 1 + seldom
    return {
        key: replace(layer, taps=taps, whole=whole, every=every) if layer.filtered else layer
        for key, layer in layers.items()
    }


def spreads(sides: Sides, axis: int) -> bool:
    """Whether the medium continues beyond at least one side along every axis other than this one.

    Between two walls, and along a periodic axis, waves near their cut-off hardly move towards a side and return again
    and again, and some waves of plates run backward even at low frequencies: in thin layers they grow by 0.01
    c/spacing.
    """
    others = {other for other, _ in sides} - {axis}
    open_to = {other for (other, _), b in sides.items() if not b.periodic and not b.image}
    return bool(others) and others <= open_to

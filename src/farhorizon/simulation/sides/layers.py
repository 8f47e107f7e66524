"""Layers whose number of nodes is given: what they damp short waves with, and what is not known of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from farhorizon.analysis.layers.profiles import weak
from farhorizon.analysis.layers.short_waves import high_pass
from farhorizon.engine.engine import Layer
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Key, Sides, side_name

_LITTLE = 0.3  # largest damping in two steps for which the filter is applied only in every second step
_TURN = 0.2  # and largest fraction of a period by which the fastest wave may advance in a step


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

"""Dampers that are tuned to the backward waves of a medium, see `farhorizon.engine.dampers`.

In a layer a wave whose group velocity points against its phase velocity grows at the rate ``sigma gamma``, with gamma
from the symbol (`Stencil.layer_growth`). For positive kernels and for solids all such waves are among the fastest of
their medium: their frequencies are above 0.65 (bilinear elements) to 0.9 of the largest one, ten times that of a wave
of twenty nodes. A filter in space distinguishes them from long waves by their wavelength, and in a thin layer, where
long waves decay within a few nodes, also damps part of these. Dampers distinguish them by their frequency, which a
layer does not change.

Weak backward waves, such as those of scalars in space, lie in a narrow band just below the largest frequency. There,
light dampers of that band have the effect of the short filter (`lightly_tuned`), node by node, without a box of all
nodes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from farhorizon.analysis.layers.profiles import rising_alpha
from farhorizon.engine.dampers import response, springs_of, strengths_of
from farhorizon.engine.engine import Layer
from farhorizon.medium.stencil import Stencil

_APART = 0.5  # part of the largest frequency above which all backward waves have to lie
# place of the springs' frequency between the slowest and the fastest of these, and width over the distance between
# both; the smallest width over the largest frequency, for waves that the layer has changed
_PLACE, _WIDTH, _LEAST_WIDTH = 0.5, 1.2, 0.2
_REAL = 0.3  # real stretch over sigma, which reduces the growth of backward waves and slows the fastest waves
_GRADUAL = 2.5  # nodes after the first for each power of the depth by which the dampers may enter later
# light dampers: the smallest width over the largest frequency, since the effect of a damper on slow waves is
# proportional to its width; the rate over that required by first order in sigma, at the outer end, and the power of its
# ramp; and the largest number of nodes, beyond which filters reflect less
_LIGHT_WIDTH, _LIGHT_RATE, _LIGHT_RAMP, _LIGHT_NODES = 0.1, 5.0, 2, 12
# the slower the fastest waves are, the larger sigma is in relation to their frequency, whereas first order assumes that
# it is small, and the more layers grow: by the least of the medium's largest frequency in speeds / spacing, the damping
# at the outer end over that required by first order, and the power of the depth by which the damping enters later than
# sigma. These did not grow, by the eigenvalues of strips and from noise in boxes of few nodes, at 0.3 to 0.65 of the
# step limit, with `_TESTED` nodes
_MARGINS = ((1.7, 2.4, 1.5), (1.4, 2.4, 1.2), (1.1, 1.8, 0.5))
_TESTED = range(3, 9)


@dataclass(frozen=True)
class BackwardBand:
    """Frequencies of backward waves, in units of speed / spacing.

    Attributes
    ----------
    frequency, width : float
        Of the dampers.
    highest : float
        Largest frequency of the medium.
    rate : float
        Damping rate over sigma that stops all backward waves, at the frequency that the dampers absorb most.
    """

    frequency: float
    width: float
    highest: float
    rate: float


@lru_cache(maxsize=64)
def backward_band(stencil: Stencil, least_width: float = _LEAST_WIDTH) -> BackwardBand | None:
    """The band of a stencil, with dampers of at least a given width over the largest frequency; None if there are no
    backward waves, or if some are as slow as other waves.
    """
    value, growth = stencil.zone_branches[1], stencil.layer_growth[1]
    backward = growth > 1e-6
    if not backward.any() or np.any(stencil.reaction):
        return None
    square, highest = value[backward], float(np.sqrt(value.max()))
    lowest = float(np.sqrt(square.min()))
    if lowest < _APART * highest:
        return None
    frequency = lowest + _PLACE * (highest - lowest)
    width = max(_WIDTH * (highest - lowest), least_width * highest)
    taken = (width * square) ** 2 / (frequency**2 * ((frequency**2 - square) ** 2 + width**2 * square))
    return BackwardBand(frequency, width, highest, float((2 * growth[backward] / taken).max()))


def tuned_layer(nodes: int, stencil: Stencil, pace: float, dt: float) -> Layer | None:
    """The layer of a number of nodes with tuned dampers; None where it would grow.

    Parameters
    ----------
    nodes : int
    stencil : Stencil
    pace : float
        Speed / spacing.
    dt : float
    """
    band = backward_band(stencil)
    known = () if band is None else [entry for entry in _MARGINS if band.highest >= entry[0]]
    if band is None or not known or nodes not in _TESTED:
        return None
    _, margin, later = known[0]
    depth, columns = (np.arange(nodes + 1) + 0.5) / (nodes + 1), np.arange(1, nodes + 1) / (nodes + 1)
    sigma, at_nodes = 2 * depth**0.75, 2 * columns**0.75  # the ramp of thin profiles
    rates = margin * band.rate * at_nodes / (1 + _REAL * at_nodes) * columns ** min(later, (nodes - 1) / _GRADUAL)
    layer = Layer(1 + _REAL * sigma, sigma * pace, rising_alpha(sigma, depth) * pace, rates * pace)
    layer = replace(layer, tuned=np.array([band.frequency, band.width]) * pace)
    return layer if _is_steady(layer, band.highest * pace, stencil.dim, dt) else None


def lightly_tuned(layer: Layer, stencil: Stencil, pace: float, dt: float) -> Layer | None:
    """The layer of a scalar in space, with dampers of weak backward waves in place of its filter.

    None for vectors and in the plane; where there are no such waves; for more than 12 nodes, where filters reflect
    less; and where the step is too long.

    Parameters
    ----------
    layer : Layer
        With the ramps of stencils without backward waves.
    stencil : Stencil
    pace : float
        Speed / spacing.
    dt : float
    """
    if stencil.components > 1 or stencil.dim < 3 or not layer.filtered or layer.columns > _LIGHT_NODES:
        return None
    band = backward_band(stencil, _LIGHT_WIDTH)
    if band is None:
        return None
    ramp = (np.arange(1, layer.columns + 1) / (layer.columns + 1)) ** _LIGHT_RAMP
    rates, tuned = _LIGHT_RATE * band.rate * layer.sigma[-1] * ramp, np.array([band.frequency, band.width]) * pace
    light = replace(layer, damping=rates, taps=np.zeros(1), tuned=tuned)
    return light if _is_steady(light, band.highest * pace, stencil.dim, dt) else None


def _is_steady(layer: Layer, highest: float, axes: int, dt: float) -> bool:
    """Whether the step is stable for the fastest waves where layers meet, since nodes have less mass for these."""
    keep, pull = springs_of(layer.tuned, dt)
    less = axes * strengths_of(layer.damping, keep, pull, dt).max() * response(np.array(-1.0), keep, pull)
    return bool((highest * dt / 2) ** 2 * (1 + less) <= 1)

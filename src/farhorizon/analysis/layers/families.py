"""The families of lattice PMLs from which trial runs choose the layers of a run.

A family is a profile of any number of nodes. All of them for waves are stretches ``1 + sigma/(s + alpha)`` whose sigma
rises outwards, and differ in their effect on waves that hardly move towards the side:

- *thin*: sigma as depth^(3/4), alpha rising as depth^4 to the outer end. The fewest nodes in the plane and in space.
- *late*: made for the length T of a run. On the line Re s = 1/T a travelling, grazing, evanescent or static wave is one
  number C in (0, 1], and an edge with ``sigma = 2c/(h a)``, ``alpha = (1/a^2 - 1)/T`` reflects ``|C - a|/(C + a)``. The
  points a are those of Zolotarev's problem on the interval of the C that reach the side within T: for waveguides, long
  boxes, long runs.
- *tuned*: for stencils with strong backward waves, as thin as the thin ones. Dampers absorb the backward waves by their
  frequency, which requires one medium along the whole side, and a step that leaves them room.
  In a layer a wave whose group velocity points against its phase velocity grows at the rate ``sigma gamma``, with gamma
  from the symbol (`Stencil.layer_growth`). For positive kernels and for solids all such waves are among the fastest of
  their medium: their frequencies are above 0.65 (bilinear elements) to 0.9 of the largest one, ten times that of a wave
  of twenty nodes. A filter in space distinguishes them from long waves by their wavelength, and in a thin layer, where
  long waves decay within a few nodes, also damps part of these. Dampers (`engine.features.dampers`) distinguish them
  by their frequency, which a layer does not change. Weak backward waves, such as those of scalars in space, lie in a
  narrow band just below the largest frequency. There, light dampers of that band have the effect of the short filter
  (`lightly_tuned`), node by node, without a box of all nodes.
- *short*: for the same stencils in space, where they cannot be tuned. sigma and damping rise together, and the filter
  of the damping reads few neighbours.
- *steep*: little alpha. Travelling waves are reflected least: on a line, and where others would grow or reflect
  backward waves.
- *diffusive*: for diffusion, stretches kappa at the points of Zolotarev's problem between the slowest and the steepest
  decay of the run.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy import special

from farhorizon.analysis.layers.profiles import crowded, rising_alpha, smooth_ramp, weak
from farhorizon.analysis.layers.short_waves import HighPass, high_pass
from farhorizon.engine.engine import Layer
from farhorizon.engine.features.dampers import response, springs_of, strengths_of
from farhorizon.medium.stencil import Stencil
from farhorizon.rounding import TINY

# strength of the thin profiles: in boxes and guides of one to three dimensions it needs at most a node more than the
# best of 2, 3, 4 and 5.5
_STRENGTH = 3.0
_RISE = 0.75  # power of a thin sigma's ramp
# for weak backward waves in space, by reach: numbers of nodes up to which ramps of these powers are used. Where three
# layers meet, waves of the largest frequency, which stand still, grow at up to 0.3 speed / spacing if they have room,
# that is, enough nodes whose sigma is of the order of their frequency. Measured: noise in corners to 300 spacings /
# speed, strengths 1.4 to 5.6, at 0.35, 0.5 and 0.9 of the step limit, less a quarter
_RISES = (_RISE, 2.0)
_STEADY_TO = {2: (10, 24), 3: (6, 16), 4: (3, 8), 5: (3, 7)}
# edges for waves along the normal, whose tangent is real: their number per two decades of the target, and their sigma
# in speed / spacing
_EQUAL, _EQUAL_AT = (2, 5), 2.2
_GRAZING = 0.6  # largest of the other points
_SLOWEST = 0.3  # smallest alpha times the length of the run: with less, static fields remain in the layer
_GENTLE = HighPass(3, 1, 1.0, 0.0)  # filter of three neighbours for weak backward waves, beside thin profiles
# its rate over that required by first order in sigma, at the outer end, and the power of its ramp
_GENTLE_RATE, _GENTLE_RAMP = 3.0, 4
# filters of four and of two neighbours for strong backward waves, the largest rates over sigma for which they are used,
# and the power of sigma's ramp; the numbers of nodes, and their largest product with the rate, with which noise did not
# grow in corners at 0.5 and 0.95 of the step limit
_FILTERS = ((HighPass(4, 1, 1.0, 0.0), 0.25, 1.5), (HighPass(2, 1, 1.0, 0.0), 0.35, 2.0))
_SHORT, _MOST_DAMPED = range(3, 13), 2.0
_STEADY = 1.25  # rate of their damping over that required by first order in sigma
# largest reach with which late profiles were stable in white noise; with exponent 1 and constant influence, noise grows
# from 5 on
_WIDEST = 4
# decays of diffusion that matter: the steepest, in nodes of the layer over the distance to the side, which is less the
# longer the run in units of the time to get there; and the slowest, over the length of diffusion
_STEEPEST, _EARLY, _SLOWEST_DECAY = 3.2, 5.2, 2.3


class Family(NamedTuple):
    """Layers of one kind: a name, and the layer of a number of nodes (None where there is none)."""

    name: str
    layer: Callable[[int], Layer | None]

    def thickest(self, nodes: int) -> Layer | None:
        """The layer of the family with the most nodes, up to a number; None if there is none."""
        return next((layer for n in range(nodes, 0, -1) if (layer := self.layer(n)) is not None), None)


def thin(nodes: int, pace: float, rise: float = _RISE, strength: float = _STRENGTH) -> Layer:
    """A thin profile; `pace` is speed / spacing, `rise` the power of its ramp."""
    depth = (np.arange(nodes + 1) + 0.5) / (nodes + 1)
    sigma = 2 * strength * depth**rise
    return Layer(np.ones(nodes + 1), sigma * pace, rising_alpha(sigma, depth) * pace)


def long_run_profile(
    nodes: int, pace: float, until: float, distance: float, target: float, equal: int | None = None
) -> Layer:
    """A profile of at least 6 nodes for a run of length `until`, data `distance` nodes from the side, and a target
    error; the number `equal` of edges of equal sigma depends on the latter unless given.
    """
    length = pace * until
    equal = _equal_edges(target) if equal is None else equal
    least = min(max(distance, 1.0) / (length * np.log(1 / target)), _GRAZING / 2)
    points = np.sort(zolotarev(least / _GRAZING, nodes + 1 - equal) * _GRAZING)[::-1]
    sigma = np.concatenate([np.full(equal, _EQUAL_AT), 2 / points])
    alpha = np.concatenate([np.zeros(equal), (1 / points**2 - 1) / length])
    order = np.argsort(sigma, kind="stable")
    return Layer(np.ones(nodes + 1), sigma[order] * pace, np.maximum(alpha, _SLOWEST / length)[order] * pace)


def _timely(stencil: Stencil) -> bool:
    """Whether the late profile is stable: for scalars of short reach without backward waves."""
    return (
        stencil.components == 1
        and max(stencil.reach) <= _WIDEST
        and not crowded(stencil)
        and not stencil.backward_waves()
    )


def _equal_edges(target: float) -> int:
    """Number of edges of equal sigma, for waves along the normal, that an error requires."""
    return int(np.clip(-np.log10(target) / 2 + 1, *_EQUAL))


def zolotarev(least: float, count: int) -> np.ndarray:
    """Points a in [least, 1], descending, that minimise the largest product of |x - a|/(x + a) over the x in that
    interval.
    """
    parameter = 1 - least**2
    return np.asarray(special.ellipj((np.arange(count) + 0.5) / count * special.ellipk(parameter), parameter)[2])


def gently_damped(layer: Layer, stencil: Stencil) -> Layer:
    """The layer with a short filter for the weak backward waves that some stencils have in space."""
    needed = _needed(stencil, _GENTLE)
    if not needed:
        return layer
    depth = np.arange(1, layer.columns + 1) / (layer.columns + 1)
    rate = _GENTLE_RATE * needed * layer.sigma[-1]
    return replace(layer, damping=rate * smooth_ramp(depth) ** _GENTLE_RAMP, taps=_GENTLE.taps())


def steady_rise(stencil: Stencil, nodes: int) -> float | None:
    """The power of the ramp with which a thin profile of a number of nodes does not grow where layers meet in space;
    None if none is known.
    """
    if stencil.dim < 3 or not stencil.backward_waves():
        return _RISE
    steady = _STEADY_TO.get(max(2, *stencil.reach), _STEADY_TO[max(_STEADY_TO)])
    return next((rise for rise, most in zip(_RISES, steady, strict=True) if nodes <= most), None)


def _needed(stencil: Stencil, filtered: HighPass) -> float:
    """Rate over sigma with which a filter stops all backward waves, to first order in sigma; 0 without such waves."""
    zone, growth = stencil.layer_growth
    worst = growth.max(-1)
    backward = worst > 1e-6
    if not backward.any():
        return 0.0
    passed = sum(np.broadcast_to(filtered.passed(axis), worst.shape)[backward] for axis in zone)
    return float((2 * worst[backward] / np.maximum(passed, TINY)).max())


def short(nodes: int, stencil: Stencil, pace: float) -> Layer | None:
    """A layer that damps strong backward waves with a short filter, or None where it would grow, for the speed /
    spacing of the slowest medium along the side: one for the fastest is too strong for the backward waves of the
    slowest.

    The damping must rise as sigma does, or short waves grow where sigma is ahead of it. A sharper filter damps long
    waves less and requires a higher rate.
    """
    if nodes not in _SHORT:
        return None
    depth, columns = (np.arange(nodes + 1) + 0.5) / (nodes + 1), np.arange(1, nodes + 1) / (nodes + 1)
    for filtered, most, rise in _FILTERS:
        needed = _needed(stencil, filtered)
        if needed <= most and needed * nodes <= _MOST_DAMPED:
            sigma, rate = 2 * depth**rise, 2 * _STEADY * needed * smooth_ramp(columns) ** (2 * rise)
            alpha = rising_alpha(sigma, depth)
            return Layer(np.ones(nodes + 1), sigma * pace, alpha * pace, rate * pace, filtered.taps())
    return None


def families(
    stencil: Stencil,
    pace: float,
    slowest: float,
    late: Callable[[int], Layer] | None,
    dt: float | None,
    steep: Callable[[int], Layer],
) -> list[Family]:
    """The families for waves, those that need the fewest nodes or the least time first, for speed / spacing of the
    fastest and the slowest medium along the side. The `late` profile serves scalars without backward waves that reach
    no more than 4 nodes: others grow in it; dampers need the step `dt`.
    """
    damped, last = high_pass(stencil), Family("steep", steep)
    if crowded(stencil) or (damped is not None and damped.whole) or (stencil.dim == 1 and weak(damped)):
        return [last]
    if not weak(damped):
        tuned = [] if dt is None else [Family("tuned", lambda nodes: tuned_layer(nodes, stencil, pace, dt))]
        filtered = [Family("short", lambda nodes: short(nodes, stencil, slowest))] if stencil.dim > 2 else []
        return [*tuned, *filtered, last]
    first = Family("thin", lambda nodes: _thin(nodes, stencil, pace, dt))
    if late is not None and _timely(stencil):
        return [first, Family("late", lambda nodes: late(nodes) if nodes > max(_EQUAL) else None)]
    return [first, Family("steep", lambda nodes: steep(nodes) if first.layer(nodes) is None else None)]


def _thin(nodes: int, stencil: Stencil, pace: float, dt: float | None) -> Layer | None:
    """A thin profile that damps weak backward waves, with light dampers where these can be used."""
    rise = steady_rise(stencil, nodes)
    if rise is None:
        return None
    layer = gently_damped(thin(nodes, pace, rise), stencil)
    light = lightly_tuned(layer, stencil, pace, dt) if dt is not None and layer.filtered else None
    return layer if light is None else light


def diffusive(nodes: int, spacing: float, spread: float, distance: float) -> Layer:
    """A layer for diffusion; `spread` is the diffusivity times the length of the run, `distance` the shortest one
    between the data and the side.
    """
    later = np.log(max(spread / distance**2, 1.0))
    steepest = min(_STEEPEST * nodes / (distance * (later + _EARLY)), 2 / spacing)
    slowest = min(_SLOWEST_DECAY / np.sqrt(spread), steepest / 2)
    tau = spacing / 2 * steepest * zolotarev(slowest / steepest, nodes + 1)
    return Layer(np.maximum(1 / tau, 1.0), np.zeros(nodes + 1), np.zeros(nodes + 1))


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
    """Frequencies of backward waves, in units of speed / spacing: those of the dampers, their width, the largest of the
    medium, and the damping rate over sigma that stops all of them.
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
    """The layer of a number of nodes with tuned dampers; None where it would grow."""
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
    """A layer, of a scalar in space, with dampers of weak backward waves in place of its filter; None for vectors, in
    the plane, without such waves, where the step is too long, and for more than 12 nodes, where filters reflect less.
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

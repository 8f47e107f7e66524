"""The profiles of lattice PMLs that are tried where the waves of a run determine the thickness.

The thinnest member of five families that meets the target is taken (`farhorizon.analysis.layers.thickness`). All are
stretches ``1 + sigma/(s + alpha)`` whose sigma rises outwards, and differ in their effect on waves that hardly move
towards the side:

- *steep*: little alpha. Travelling waves are reflected least: best below 1e-6 and in short runs.
- *thin*: sigma as depth^(3/4), alpha rising as depth^4 to the outer end. The fewest nodes for 1e-3 to 1e-6.
- *tuned*: for stencils with strong backward waves, as thin as the thin ones. Dampers absorb the backward waves by their
  frequency, which requires one medium along the whole side. For the weak backward waves of scalars in space, the other
  families with light dampers.
- *short*: for the same stencils, whose damping by wavelength determines the reflection. sigma and damping rise
  together, and the filter of the damping reads few neighbours.
- *late*: made for the length T of a run. On the line Re s = 1/T a travelling, grazing, evanescent or static wave is one
  number C in (0, 1], and an edge with ``sigma = 2c/(h a)``, ``alpha = (1/a^2 - 1)/T`` reflects ``|C - a|/(C + a)``. The
  points a are those of Zolotarev's problem on the interval of the C that reach the side within T: for waveguides, long
  boxes, long runs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from farhorizon.analysis.layers.choice import crowded, rising_alpha, smooth_ramp, weak
from farhorizon.analysis.layers.samples import reflected
from farhorizon.analysis.layers.short_waves import HighPass, high_pass
from farhorizon.analysis.layers.thickness import Thickness, distance_to_side
from farhorizon.analysis.layers.tuned_layers import lightly_tuned, tuned_layers
from farhorizon.engine.engine import Layer
from farhorizon.medium.stencil import Stencil

_STRENGTHS = (1.4, 2.0, 4.0, 5.6)  # of thin profiles; stronger ones suit waves that travel along the side
_RISE = 0.75  # power of a thin sigma's ramp
# for weak backward waves in space, by reach: numbers of nodes up to which ramps of these powers are used. Where three
# layers meet, waves of the largest frequency, which stand still, grow at up to 0.3 speed / spacing if they have room,
# that is, enough nodes whose sigma is of the order of their frequency. Measured: noise in corners to 300 spacings /
# speed, strengths 1.4 to 5.6, at 0.35, 0.5 and 0.9 of the step limit, less a quarter
_RISES = (_RISE, 1.5, 2.0, 3.0)
_STEADY_TO = {2: (10, 24, 24, 24), 3: (6, 10, 16, 24), 4: (3, 6, 8, 16), 5: (3, 5, 7, 12)}
# numbers of edges for waves along the normal, whose tangent is real, and their sigma in speed / spacing
_EQUAL, _EQUAL_AT = (2, 3, 4, 5), 2.2
_GRAZING = 0.6  # largest of the other points
_SLOWEST = 0.3  # smallest alpha times the length of the run: with less, static fields remain in the layer
_GENTLE = HighPass(3, 1, 1.0, 0.0)  # filter of three neighbours for weak backward waves, beside thin profiles
# its rate over that required by first order in sigma, at the outer end, and the power of its ramp
_GENTLE_RATE, _GENTLE_RAMP = 3.0, 4
# filters of four and of two neighbours for strong backward waves
_FINE, _COARSE = HighPass(4, 1, 1.0, 0.0), HighPass(2, 1, 1.0, 0.0)
_STEADY = 1.25  # rate of their damping over that required by first order in sigma
# largest rate over sigma of the fine filter in layers of up to a number of nodes: in measurements, noise grew with more
_FINEST = ((0.25, 12), (0.3, 8))
_COARSEST = ((0.35, 12), (1.0, 4))  # and the coarse one
# the fine filter's rate over the coarse one's, above which backward waves are so long that layers of 12 nodes grow
_LONG = 3.0
_LEAST = 3  # smallest number of nodes of such layers that was tested
# largest reach with which late profiles were stable in white noise; with exponent 1 and constant influence, noise grows
# from 5 on
_WIDEST = 4
_MORE_EQUAL = 5  # largest number added for short waves: more hardly help against waves that nearly stand still
_WAVES, _ANGLES = 64, np.deg2rad([0.0, 45.0])  # wavelengths and angles at which the short waves of data are sampled
# ratio of the bound of late profiles to measured errors; C of the shortest waves that it covers, 6 nodes long
_CAREFUL, _STEEPEST_WAVE = 10, 1.3


def thin(nodes: int, strength: float, pace: float, rise: float = _RISE) -> Layer:
    """A thin profile; `pace` is speed / spacing, `rise` the power of its ramp."""
    depth = (np.arange(nodes + 1) + 0.5) / (nodes + 1)
    sigma = 2 * strength * depth**rise
    return Layer(np.ones(nodes + 1), sigma * pace, rising_alpha(sigma, depth) * pace)


def long_run_profile(
    nodes: int, pace: float, until: float, distance: float, wanted: float, equal: int | None = None
) -> Layer:
    """A profile for a run of length `until`.

    Parameters
    ----------
    nodes : int
        At least 6.
    pace : float
        Speed / spacing.
    until : float
    distance : float
        Between the data and the side, in nodes.
    wanted : float
        Target error relative to the data.
    equal : int, optional
        Number of edges of equal sigma, for waves along the normal; by default it depends on the target error.
    """
    length = pace * until
    equal = _equal_edges(wanted) if equal is None else equal
    least = min(max(distance, 1.0) / (length * np.log(1 / wanted)), _GRAZING / 2)
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


def _equal_edges(wanted: float) -> int:
    """Number of edges of equal sigma, for waves along the normal, that an error requires."""
    return _EQUAL[int(np.clip(-np.log10(wanted) / 2 - 1, 0, 3))]


def by_formula(
    stencil: Stencil, pace: float, until: float, data: Sequence[np.ndarray], wanted: float
) -> Thickness | None:
    """The late profile that keeps an error by the bound of Zolotarev's problem, ``4 exp(-pi^2 (n + 1/2)/ln(4
    C_max/C_min))``; None where it grows.

    The bound takes all waves of the line at their largest together; measured errors are 10 to 50 times smaller (2D
    waveguides
    of 5 to 1000 crossings, boxes of 10 to 1, permanent loads). It covers waves of 6 nodes and more: for shorter ones in
    the data there are more edges of equal sigma.

    Parameters
    ----------
    stencil : Stencil
        Its first axis is the normal.
    pace : float
        Speed / spacing.
    until : float
        Length of the run.
    data : sequence of ndarray
        With the normal first, towards the side.
    wanted : float
    """
    if not _timely(stencil):
        return None
    aim, distance = _CAREFUL * wanted, distance_to_side(data)
    least = min(max(distance, 1.0) / (pace * until * np.log(1 / aim)), 1.0)
    nodes = int(np.ceil(np.log(4 / aim) * np.log(4 * _STEEPEST_WAVE / least) / np.pi**2 + 0.5))
    equal, nodes = _equal_edges(wanted), max(nodes, max(_EQUAL) + 1)
    sent = _Sent.of(stencil, pace, data)
    layer = long_run_profile(nodes, pace, until, distance, wanted, equal)
    for _ in range(_MORE_EQUAL):
        if sent.returned(layer) <= wanted:
            break
        equal, nodes = equal + 1, nodes + 1
        layer = long_run_profile(nodes, pace, until, distance, wanted, equal)
    return Thickness("late", layer, max(wanted, sent.returned(layer)), until, designed=True)


def _spectrum(line: np.ndarray) -> np.ndarray:
    """Largest amplitude of a line's waves in each of `_WAVES` equal parts of the wavenumbers from 0 to pi."""
    each = -(-len(line) // (2 * _WAVES))
    return np.asarray(np.abs(np.fft.rfft(line, 2 * _WAVES * each))[1:].reshape(_WAVES, each).max(1))


@dataclass(frozen=True)
class _Sent:
    """Waves of the wavelengths that data contain along the normal, at some angles to it: factor per node, frequency,
    and amplitude.
    """

    root: np.ndarray
    frequency: np.ndarray
    amplitude: np.ndarray

    @classmethod
    def of(cls, stencil: Stencil, pace: float, data: Sequence[np.ndarray]) -> _Sent:
        """The waves of data, for a stencil without backward waves."""
        k = np.pi * (np.arange(_WAVES) + 0.5) / _WAVES
        found = np.max(
            [_spectrum(np.abs(values).reshape(len(values), -1).max(1)) for values in data], axis=0, initial=0.0
        )
        along, across = (np.outer(np.array(part), k) for part in (np.cos(_ANGLES), np.sin(_ANGLES)))
        symbol = stencil.symbol(
            along, *([across] + [np.zeros_like(across)] * (stencil.dim - 2) if stencil.dim > 1 else [])
        )
        return cls(np.exp(-1j * along), 1j * pace * np.sqrt(np.abs(symbol)), found / (found.sum() or 1.0))

    def returned(self, layer: Layer) -> float:
        """Reflected amplitude, at the angle where it is largest. Short waves disperse on their way, so their energies
        add up.
        """
        with np.errstate(all="ignore"):  # extreme spacings and speeds overflow
            back = np.abs(reflected(self.root, self.frequency, layer))
        return float(np.linalg.norm(self.amplitude * back, axis=1).max())


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
    return float((2 * worst[backward] / np.maximum(passed, 1e-300)).max())


def briefly_damped(nodes: int, stencil: Stencil, pace: float) -> dict[str, Layer]:
    """Layers that damp strong backward waves with short filters, by name: those that do not grow.

    The damping must rise as sigma does, or short waves grow where sigma is ahead of it. A sharper filter damps long
    waves less and requires a higher rate; beyond the bounds above, the layer grows from noise at 0.5 or at 0.95 of the
    step limit.

    Parameters
    ----------
    nodes : int
    stencil : Stencil
    pace : float
        Speed / spacing.
    """
    depth, columns = (np.arange(nodes + 1) + 0.5) / (nodes + 1), np.arange(1, nodes + 1) / (nodes + 1)
    fine, coarse = _needed(stencil, _FINE), _needed(stencil, _COARSE)
    strength = 1.4 if nodes < 5 else 1.0
    found = {}

    def add(name: str, filtered: HighPass, needed: float, sigma: np.ndarray, ramp: np.ndarray) -> None:
        alpha = rising_alpha(sigma, depth) * pace
        found[name] = Layer(np.ones(nodes + 1), sigma * pace, alpha, _STEADY * needed * ramp * pace, filtered.taps())

    if _LEAST <= nodes <= max((most for rate, most in _FINEST if fine <= rate), default=0):
        add("short", _FINE, fine, 2 * strength * depth**1.5, 2 * strength * smooth_ramp(columns) ** 3)
    bounds = _COARSEST if fine <= _LONG * coarse else _COARSEST[1:]
    if _LEAST <= nodes <= max((most for rate, most in bounds if coarse <= rate), default=0):
        add("short, coarse", _COARSE, coarse, 2 * depth**2, 2 * columns**2)
    return found


def family(
    stencil: Stencil,
    pace: float,
    slowest: float,
    until: float,
    distance: float,
    wanted: float,
    dt: float | None,
    steep: Callable[[int], Layer],
) -> Callable[[int], Mapping[str, Layer]]:
    """The profiles that are tried for waves, by name, as a function of the number of nodes.

    Paces are speeds / spacing of the fastest and of the slowest medium along the side. A short layer designed for the
    fastest medium is too strong for backward waves of the slowest one, and lets them grow by more than its damping
    removes.

    The late profile is for scalars without backward waves that reach no more than 4 nodes: others grow in it. Tuned
    profiles are included where a time step is given.
    """
    backward, damped = stencil.backward_waves(), high_pass(stencil)
    timely = _timely(stencil)

    def members(nodes: int) -> Mapping[str, Layer]:
        found = {"steep": steep(nodes)}
        if crowded(stencil):
            return found
        if not weak(damped):
            if damped is None or damped.whole:
                return found
            found |= briefly_damped(nodes, stencil, slowest)
            return found if dt is None else found | tuned_layers(nodes, stencil, pace, dt)
        rise = steady_rise(stencil, nodes)
        if rise is not None:
            for strength in _STRENGTHS[: 3 if backward and rise == _RISE else None]:
                found[f"thin ({strength:g})"] = gently_damped(thin(nodes, strength, pace, rise), stencil)
        if nodes > max(_EQUAL) and timely:
            found["late"] = long_run_profile(nodes, pace, until, distance, wanted)
        return found if dt is None or not backward else _with_light(found, stencil, pace, dt)

    return members


def _with_light(members: Mapping[str, Layer], stencil: Stencil, pace: float, dt: float) -> dict[str, Layer]:
    """Layers by name, those with light dampers in place of a filter first, because they cost less."""
    light = {f"tuned, {name}": lightly_tuned(layer, stencil, pace, dt) for name, layer in members.items()}
    return {name: layer for name, layer in light.items() if layer is not None} | dict(members)

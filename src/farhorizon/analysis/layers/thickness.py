"""The thinnest lattice PML that keeps a wanted error, for the waves that a run has.

Waves have the thinnest of five families of profiles, by the error that `farhorizon.analysis.layers.returned` predicts
of each. All are stretches ``1 + sigma/(s + alpha)`` whose sigma rises outwards, and differ in what they do to waves
that hardly move towards the side:

- *steep*: little alpha. The least leak of travelling waves: best below 1e-6 and in short runs.
- *thin*: sigma as depth^(3/4), alpha rising as depth^4 to the outer end. The fewest nodes for 1e-3 to 1e-6.
- *tuned*: for stencils with strong backward waves, as thin as the thin ones. Dampers take the backward waves by their
  frequency; one medium along the whole side. Of weak ones of scalars in space, the others with light dampers.
- *short*: for the same, whose damping by wavelength decides what comes back. sigma and damping rise together, and the
  filter of the damping reads few neighbours.
- *late*: made for the length T of a run. On the line Re s = 1/T a travelling, grazing, evanescent or static wave is one
  number C in (0, 1], and an edge with ``sigma = 2c/(h a)``, ``alpha = (1/a^2 - 1)/T`` reflects ``|C - a|/(C + a)``. The
  points a are those of Zolotarev's problem on the interval of the C that reach the side within T: for waveguides, long
  boxes, long runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from farhorizon.analysis.layers.choice import rising_alpha, smooth_ramp, weak
from farhorizon.analysis.layers.returned import Arrivals
from farhorizon.analysis.layers.samples import reflected
from farhorizon.analysis.layers.short_waves import HighPass, high_pass
from farhorizon.analysis.layers.tuned_layers import lightly_tuned, tuned_layers
from farhorizon.engine.engine import Layer
from farhorizon.errors import InputError
from farhorizon.medium.stencil import Stencil

_STRENGTHS = (1.4, 2.0, 4.0, 5.6)  # of thin profiles: the stronger, the more waves travel along the side
_RISE = 0.75  # power of a thin sigma's ramp
# of weak backward waves in space by reach: the nodes up to which ramps of these powers are taken. Where three layers
# meet waves of the largest frequency, which stand still, grow by up to 0.3 speed / spacing; they need room for it, and
# have the more the longer sigma is of the order of their frequency. Measured: noise in corners to 300 spacings / speed,
# strengths 1.4 to 5.6, at 0.35, 0.5 and 0.9 of the step limit, less a quarter
_RISES = (_RISE, 1.5, 2.0, 3.0)
_STEADY_TO = {2: (10, 24, 24, 24), 3: (6, 10, 16, 24), 4: (3, 6, 8, 16), 5: (3, 5, 7, 12)}
# edges for waves along the normal, whose tangent is real, and their sigma in speed / spacing
_EQUAL, _EQUAL_AT = (2, 3, 4, 5), 2.2
_GRAZING = 0.6  # largest of the other points
_SLOWEST = 0.3  # least alpha times the length of the run: with less, what stands still stays in the layer
_GENTLE = HighPass(3, 1, 1.0, 0.0)  # filter of three neighbours for weak backward waves, beside thin profiles
# its rate over what first order in sigma asks for, at the outer end, and the power of its ramp
_GENTLE_RATE, _GENTLE_RAMP = 3.0, 4
# filters of four and of two neighbours for strong ones
_FINE, _COARSE = HighPass(4, 1, 1.0, 0.0), HighPass(2, 1, 1.0, 0.0)
_STEADY = 1.25  # rate of their damping over what first order asks for
# rate over sigma that the fine filter may take in layers of so many nodes: measured, more grows from noise
_FINEST = ((0.25, 12), (0.3, 8))
_COARSEST = ((0.35, 12), (1.0, 4))  # and the coarse one
# the fine filter's rate over the coarse one's: where it is larger, backward waves are so long that 12 nodes grow
_LONG = 3.0
_LEAST = 3  # nodes of such layers that were looked at
# of the wanted error: at edges what two sides send back adds up, and the prediction knows one reflection
_AIM = 0.4
# over the long waves' speed; share of such waves that crowds; part of the aim then
_HARDLY, _CROWDED, _AIM_CROWDED = 0.1, 0.38, 0.2
MOST = 60  # nodes of a layer
_NOT_WORTH = 16  # part of a layer that is not looked for any more
_SINGLY = 6  # nodes up to which all numbers are tried
# reach with which late profiles were stable in white noise; exponent 1 with constant influence grows from 5 on
_WIDEST = 4
_MORE_EQUAL = 5  # at most, for short waves: more of them hardly help against such that stand nearly still
_WAVES, _ANGLES = 64, np.deg2rad([0.0, 45.0])  # wavelengths and angles at which the short waves of data are looked at
# what the bound of late profiles is above measured errors; C of the shortest waves that it knows, 6 nodes long
_CAREFUL, _STEEPEST_WAVE = 10, 1.3


@dataclass(frozen=True, repr=False)
class Thickness:
    """A layer and the error that it is predicted to make, or designed for.

    Attributes
    ----------
    name : str
        Of its profile.
    layer : Layer
    predicted : float
        Largest error at the side, relative to the largest of the data.
    until : float
        Length of the run that it is predicted for.
    designed : bool
        Whether a formula made the layer for that error, and nothing was predicted of these data.
    set_by : str
        In words, of what most comes back: it sets the thickness. Empty where a formula counts all waves alike.
    """

    name: str
    layer: Layer
    predicted: float
    until: float = np.inf
    designed: bool = False
    set_by: str = ""

    @property
    def nodes(self) -> int:
        """Thickness of the layer in nodes."""
        return self.layer.columns

    def __repr__(self) -> str:
        return f"Thickness({self.nodes} nodes, {self})"

    def __str__(self) -> str:
        known = "designed for an error of" if self.designed else "predicted error"
        most = f", set by {self.set_by}" if self.set_by else ""
        return (
            f"{self.name} profile, {known} {self.predicted:.1g} of the largest value up to t = {self.until:.6g}{most}"
        )


def predicted_error(
    layer: Layer, waves: Sequence[Arrivals], size: float, enough: float = np.inf, closely: bool = False
) -> float:
    """Error that a layer makes of what arrives, relative to the largest of the data: of all types that a wave is turned
    into together. Where it is more than `enough`, something that is, too; by a rough look unless `closely`.
    """
    found = []
    for side in waves:
        found.append(float(side.returned(layer, enough * size, closely) / size))
        if not found[-1] <= enough:
            break
    return float(np.max(found))


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
        Of the data from the side, in nodes.
    wanted : float
        Error relative to the data.
    equal : int, optional
        Edges of one sigma, for waves along the normal; by the wanted error unless given.
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
    """Whether the late profile is stable: for scalars without backward waves that do not reach far."""
    return (
        stencil.components == 1
        and max(stencil.reach) <= _WIDEST
        and not crowded(stencil)
        and not stencil.backward_waves()
    )


def _equal_edges(wanted: float) -> int:
    """Edges of one sigma, for waves along the normal, that an error asks for."""
    return _EQUAL[int(np.clip(-np.log10(wanted) / 2 - 1, 0, 3))]


def by_formula(
    stencil: Stencil, pace: float, until: float, data: Sequence[np.ndarray], wanted: float
) -> Thickness | None:
    """The late profile that keeps an error by the bound of Zolotarev's problem, ``4 exp(-pi^2 (n + 1/2)/ln(4
    C_max/C_min))``; None where it grows.

    The bound counts every wave of the line at its largest, together; what was measured is 10 to 50 times less (2D
    waveguides of 5 to 1000 crossings, boxes of 10 to 1, loads that stay). It knows waves of 6 nodes and more: for
    shorter ones in the data there are more edges of one sigma.

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
    """Largest amplitude of a line's waves in each of so many parts of 0 to pi."""
    each = -(-len(line) // (2 * _WAVES))
    return np.asarray(np.abs(np.fft.rfft(line, 2 * _WAVES * each))[1:].reshape(_WAVES, each).max(1))


@dataclass(frozen=True)
class _Sent:
    """Waves of the wavelengths that data hold along the normal, at some angles to it: factor over a node, frequency,
    and amplitude.
    """

    root: np.ndarray
    frequency: np.ndarray
    amplitude: np.ndarray

    @classmethod
    def of(cls, stencil: Stencil, pace: float, data: Sequence[np.ndarray]) -> _Sent:
        """Of a stencil without backward waves."""
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
        """Amplitude that comes back, at the angle where it is largest; short waves disperse on their way, so their
        energies add up.
        """
        with np.errstate(all="ignore"):  # spacings and speeds at the ends of what numbers hold
            back = np.abs(reflected(self.root, self.frequency, layer))
        return float(np.linalg.norm(self.amplitude * back, axis=1).max())


def zolotarev(least: float, count: int) -> np.ndarray:
    """Points a in [least, 1], descending, for which the product of (x - a)/(x + a) is smallest on that interval."""
    parameter = 1 - least**2
    return np.asarray(special.ellipj((np.arange(count) + 0.5) / count * special.ellipk(parameter), parameter)[2])


def gently_damped(layer: Layer, stencil: Stencil) -> Layer:
    """The layer with a short damping of the weak backward waves that some stencils have in space."""
    needed = _needed(stencil, _GENTLE)
    if not needed:
        return layer
    depth = np.arange(1, layer.columns + 1) / (layer.columns + 1)
    rate = _GENTLE_RATE * needed * layer.sigma[-1]
    return replace(layer, damping=rate * smooth_ramp(depth) ** _GENTLE_RAMP, taps=_GENTLE.taps())


def steady_rise(stencil: Stencil, nodes: int) -> float | None:
    """The power of the ramp with which a thin profile of so many nodes does not grow where layers meet in space; None
    if none is known.
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

    The damping must rise as sigma does, or short waves grow where sigma is ahead of it. A sharper filter harms long
    waves less and asks for more of its rate; beyond the bounds above the layer grows from noise at 0.5 or at 0.95 of
    the step limit.

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
    """The profiles of so many nodes that are tried for waves, by name.

    Paces are speeds / spacing of the fastest and of the slowest medium along the side: to backward waves of the slowest
    a short layer for the fastest is the stronger, and lets them grow by more than its damping takes.

    The late profile is for scalars without backward waves that reach no more than 4 nodes: others grow in it. Tuned
    ones are there where a time step is given.
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
    """Layers by name, those with light dampers in place of a filter first: they cost less."""
    light = {f"tuned, {name}": lightly_tuned(layer, stencil, pace, dt) for name, layer in members.items()}
    return {name: layer for name, layer in light.items() if layer is not None} | dict(members)


def thinnest(
    members: Callable[[int], Mapping[str, Layer]],
    waves: Sequence[Arrivals],
    wanted: float,
    size: float,
    beside: Callable[[Layer], float] = lambda layer: 0.0,
    too_few: int = 0,
    start: int = 0,
) -> Thickness:
    """The fewest nodes with which some member of a family keeps an error at a side; of thick layers a sixteenth more
    may be taken.

    Parameters
    ----------
    members : callable
        Layers of so many nodes, by name.
    waves : sequence of Arrivals
        What arrives there, each by itself.
    wanted : float
        Relative to `size`.
    size : float
        The largest of the data.
    beside : callable, optional
        What a layer sends back besides, at most, which no waves of the medium show.
    too_few : int, optional
        Nodes that are known to be.
    start : int, optional
        Nodes that are tried first where not each node counts, such as those of another side.

    Raises
    ------
    NotKept
        No layer of up to 60 nodes keeps it; the least that it names is a rough one.
    """
    aim = _aim(waves) * wanted
    scalar = waves[0].medium.stencil.components == 1
    low, high, found = too_few, MOST + 1, None
    error = 1.0  # of layers of `low` nodes, roughly
    nodes = start if start >= _SINGLY else max(2, too_few + 1)
    while found is None or (high - low > 1 and high - nodes > high // _NOT_WORTH):
        every = members(nodes)
        # of scalars: dampers take no box of all nodes, so that filters are for what these do not keep
        light = {name: one for name, one in every.items() if one.tuned.size} if scalar else {}
        for some in filter(None, (light, {name: one for name, one in every.items() if name not in light})):
            name, layer = _quietest(some, waves)
            predicted, more = predicted_error(layer, waves, size, aim, closely=nodes == MOST), beside(layer)
            if predicted <= aim and predicted + more <= wanted:
                high, found = nodes, Thickness(name, layer, predicted + more)
                break
        if high > nodes:
            if nodes == MOST:
                raise NotKept.of(wanted, max(predicted / _aim(waves), predicted + more))
            low, error = nodes, predicted
        nodes = _next(low, error, high, found, aim)
    return replace(found, set_by=max(side.strongest(found.layer) for side in waves)[1])


def _next(low: int, error: float, high: int, found: Thickness | None, aim: float) -> int:
    """Nodes to be tried between such as keep an aim, if some were found, and such as make an error above it: where a
    straight line in its logarithm says that they just do.
    """
    if found is None:  # one by one where each node counts, and where fewer may do what some more do not
        return min(MOST, low + (1 if low < _SINGLY else low // 2))
    reached = max(found.predicted, 1e-300)
    too_many = np.log(max(aim / reached, 1.0)) / np.log(max(error / reached, 1.1 * aim / reached))
    return int(np.clip(high - np.floor((high - low) * too_many), low + 1, max(low + 1, high - 1)))


def _quietest(members: Mapping[str, Layer], waves: Sequence[Arrivals]) -> tuple[str, Layer]:
    """The layer, with its name, that returns the least share of the waves."""
    if len(members) == 1:
        return next(iter(members.items()))
    return min(members.items(), key=lambda member: max(side.largest * side.share(member[1]) for side in waves))


def _aim(waves: Sequence[Arrivals]) -> float:
    """What waves may leave of a wanted error."""
    return _AIM * (_AIM_CROWDED if crowded(waves[0].medium.stencil) else 1.0)


def crowded(stencil: Stencil) -> bool:
    """Whether many of a scalar's waves along the normal hardly move and are not damped: thin profiles send back more
    than is predicted, and grow.

    Of exponent 1, linear influence and reach 4 nodes 40 % go more slowly than a tenth of the long waves; thin profiles
    of 10 to 14 nodes made up to 25 times the predicted error.
    """
    if stencil.components > 1 or not weak(high_pass(stencil)):
        return False
    k = np.linspace(1e-3, np.pi, 500)
    frequency = np.sqrt(np.maximum(stencil.symbol(k, *[np.zeros_like(k)] * (stencil.dim - 1)), 0.0))
    return float((np.abs(np.gradient(frequency, k)) < _HARDLY).mean()) > _CROWDED


def least(
    members: Callable[[int], Mapping[str, Layer]],
    waves: Sequence[Arrivals],
    size: float,
    beside: Callable[[Layer], float] = lambda layer: 0.0,
    kept: float = 0.0,
) -> float:
    """The smallest target that a layer of 60 nodes keeps, or one where it keeps that; parameters as of `thinnest`."""
    _, layer = _quietest(members(MOST), waves)
    aim, more = _aim(waves), beside(layer)
    if kept:
        predicted = predicted_error(layer, waves, size, aim * kept, closely=True)
        if predicted <= aim * kept and predicted + more <= kept:
            return kept
    predicted = predicted_error(layer, waves, size)
    return max(predicted / aim, predicted + more)


def _one_digit(value: float) -> float:
    """The value, rounded up to one digit."""
    digit = 10.0 ** np.floor(np.log10(max(value, 1e-300)))
    return float(np.ceil(value / digit - 1e-9) * digit)


class NotKept(InputError):
    """No layer of a side keeps a target.

    Attributes
    ----------
    least : float
        The smallest target that one keeps.
    """

    least = np.inf

    @classmethod
    def of(cls, wanted: float, least: float) -> NotKept:
        """The refusal of a target, which names the smallest one that is kept."""
        least = _one_digit(least)
        refusal = cls(
            "no layer keeps the target for these data",
            value=wanted,
            limit=f">= {least:.1g}",
            key="boundary.target",
            remedy="a larger target, smoother data, data farther from the side, another influence, or Extended, "
            "Exact or a Sponge",
        )
        refusal.least = least
        return refusal


def distance_to_side(values: Iterable[np.ndarray]) -> float:
    """Nodes between the side and all but a thousandth of the data; arrays with the normal first, towards the side."""
    held = [np.cumsum(amount) / amount.sum() for amount in along_normal(values)]
    return float(min((len(share) - 1 - int(np.searchsorted(share, 0.999)) for share in held), default=0))


def along_normal(values: Iterable[np.ndarray]) -> list[np.ndarray]:
    """Size of fields along their first axis; of those that are anything."""
    amounts = [np.abs(field).reshape(len(field), -1).sum(1) for field in values]
    return [amount for amount in amounts if amount.any()]

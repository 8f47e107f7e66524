"""The thinnest lattice PML that keeps a wanted error, for the waves that a run has.

Waves have the thinnest of three families of profiles, by the error that `farhorizon.analysis.returned` predicts of each.
All are stretches ``1 + sigma/(s + alpha)`` whose sigma rises outwards, and differ in what they do to waves that hardly
move towards the side:

- *steep*: little alpha. The least leak of travelling waves: best below 1e-6 and in short runs.
- *thin*: sigma as depth^(3/4), alpha rising as depth^4 to the outer end. The fewest nodes for 1e-3 to 1e-6.
- *late*: made for the length T of a run. On the line Re s = 1/T a travelling, grazing, evanescent or static wave is one
  number C in (0, 1], and an edge with ``sigma = 2c/(h a)``, ``alpha = (1/a^2 - 1)/T`` reflects ``|C - a|/(C + a)``. The
  points a are those of Zolotarev's problem on the interval of the C that reach the side within T: for waveguides, long
  boxes, long runs.

In diffusion everything depends on the decay lambda = sqrt(s/D) alone, an edge ``kappa = 1/tau`` reflects
``(lambda h/2 - tau)/(lambda h/2 + tau)``, and the points tau are Zolotarev's between the slowest decay that the run sees
and the steepest that arrives.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from farhorizon.analysis.returned import Arrivals
from farhorizon.analysis.short_waves import HighPass
from farhorizon.engine import Layer
from farhorizon.stencil import Stencil

_STRENGTHS = (2.0, 4.0, 5.6)  # of thin profiles: the stronger, the more waves travel along the side
_RISE, _END = 0.75, 0.15  # power of a thin sigma's ramp; alpha at the outer end over sigma there
_SHIFT = 1e-3  # least alpha in speed / spacing
_EQUAL, _EQUAL_AT = (2, 3, 4, 5), 2.2  # edges for waves along the normal, whose tangent is real, and their sigma in speed / spacing
_GRAZING = 0.6  # largest of the other points
_SLOWEST = 0.3  # least alpha times the length of the run: with less, what stands still stays in the layer
_GENTLE = HighPass(3, 1, 1.0, 0.0)  # filter of three neighbours for weak backward waves, beside thin profiles
_GENTLE_RATE, _GENTLE_RAMP = 3.0, 4  # its rate over what first order in sigma asks for, at the outer end, and the power of its ramp
_AIM = 0.4  # of the wanted error: the prediction knows one side and one reflection
_AIM_LASTING = 0.25  # in diffusion, where what all sides send back adds up
_MOST = 60  # nodes
_STEEPEST, _EARLY, _GRADUAL = 3.2, 5.2, 2.3  # of diffusion: which decays matter, fitted to the least error over all times of a run
_HIGHEST, _POINTS = 6.0, 241  # of the integral over y: exp(-36) remains
_BEGIN, _TIMES = 0.03, 60  # first time in squared distance over D, before which nothing has come back, and how many are looked at


@dataclass(frozen=True)
class Thickness:
    """A layer and the error that it is predicted to make.

    Attributes
    ----------
    name : str
        Of its profile.
    layer : Layer
    predicted : float
        Largest error at the side, relative to the largest of the data.
    until : float
        Length of the run that it is predicted for.
    """

    name: str
    layer: Layer
    predicted: float
    until: float = np.inf

    def __str__(self) -> str:
        return f"{self.name} profile, predicted error {self.predicted:.1g} of the largest value up to t = {self.until:.6g}"


def thin(nodes: int, strength: float, pace: float) -> Layer:
    """A thin profile; `pace` is speed / spacing."""
    depth = (np.arange(nodes + 1) + 0.5) / (nodes + 1)
    sigma = 2 * strength * depth**_RISE
    return Layer(np.ones(nodes + 1), sigma * pace, (_SHIFT + _END * sigma[-1] * depth**4) * pace)


def late(nodes: int, pace: float, until: float, distance: float, wanted: float) -> Layer:
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
    """
    length = pace * until
    equal = _EQUAL[int(np.clip(-np.log10(wanted) / 2 - 1, 0, 3))]
    least = min(max(distance, 1.0) / (length * np.log(1 / wanted)), _GRAZING / 2)
    points = np.sort(_zolotarev(least / _GRAZING, nodes + 1 - equal) * _GRAZING)[::-1]
    sigma = np.concatenate([np.full(equal, _EQUAL_AT), 2 / points])
    alpha = np.concatenate([np.zeros(equal), (1 / points**2 - 1) / length])
    order = np.argsort(sigma, kind="stable")
    return Layer(np.ones(nodes + 1), sigma[order] * pace, np.maximum(alpha, _SLOWEST / length)[order] * pace)


def _zolotarev(least: float, count: int) -> np.ndarray:
    """Points a in [least, 1], descending, for which the product of (x - a)/(x + a) is smallest on that interval."""
    parameter = 1 - least**2
    return np.asarray(special.ellipj((np.arange(count) + 0.5) / count * special.ellipk(parameter), parameter)[2])


def gently_damped(layer: Layer, stencil: Stencil) -> Layer:
    """The layer with a short damping of the weak backward waves that some stencils have in space."""
    zone, growth = stencil.layer_growth
    worst = growth.max(-1)
    backward = worst > 1e-6
    if not backward.any():
        return layer
    passed = sum(np.broadcast_to(_GENTLE.passed(axis), worst.shape)[backward] for axis in zone)
    depth = np.arange(1, layer.columns + 1) / (layer.columns + 1)
    ramp = np.sin(0.4 * np.pi * depth) / np.sin(0.4 * np.pi)
    rate = _GENTLE_RATE * float((2 * worst[backward] / passed).max()) * layer.sigma[-1]
    return replace(layer, damping=rate * ramp**_GENTLE_RAMP, taps=_GENTLE.taps())


def family(
    stencil: Stencil, pace: float, until: float, distance: float, wanted: float, steep: Callable[[int], Layer]
) -> Callable[[int], Mapping[str, Layer]]:  # fmt: skip
    """The profiles of so many nodes that are tried for waves, by name.

    The late profile is for stencils without backward waves: others grow in it.
    """
    backward = stencil.backward_waves()

    def members(nodes: int) -> Mapping[str, Layer]:
        found = {"steep": steep(nodes)}
        for strength in _STRENGTHS[: 2 if backward else None]:
            found[f"thin ({strength:g})"] = gently_damped(thin(nodes, strength, pace), stencil)
        if nodes > max(_EQUAL) and not backward:
            found["late"] = late(nodes, pace, until, distance, wanted)
        return found

    return members


def thinnest(members: Callable[[int], Mapping[str, Layer]], side: Arrivals, wanted: float, size: float) -> Thickness | None:
    """The fewest nodes with which some member of a family keeps an error at a side.

    Parameters
    ----------
    members : callable
        Layers of so many nodes, by name.
    side : Arrivals
    wanted : float
        Relative to `size`.
    size : float
        The largest of the data.

    Returns
    -------
    Thickness or None
        None if no layer of up to 60 nodes keeps it.
    """
    aim = _AIM * wanted

    def best(nodes: int) -> Thickness | None:
        name, layer = min(members(nodes).items(), key=lambda member: side.share(member[1]))
        predicted = side.returned(layer) / size
        if predicted > aim:
            return None
        predicted *= side.conversion(layer)
        return Thickness(name, layer, predicted) if predicted <= 2 * aim else None

    low, high, found = 0, 2, best(2)
    while found is None:
        if high >= _MOST:
            return None
        low, high = high, min(_MOST, high + max(2, high // 2))
        found = best(high)
    while high - low > 1:
        middle = (low + high) // 2
        tried = best(middle)
        low, high, found = (low, middle, tried) if tried is not None else (middle, high, found)
    return found


def distance_to_side(values: Iterable[np.ndarray]) -> float:
    """Nodes between the side and all but a thousandth of the data; arrays with the normal first, towards the side."""
    amounts: Sequence[np.ndarray] = [np.abs(field).reshape(len(field), -1).sum(1) for field in values]
    held = [np.cumsum(amount) / amount.sum() for amount in amounts if amount.any()]
    return float(min((len(share) - 1 - int(np.searchsorted(share, 0.999)) for share in held), default=0))


def diffusive(nodes: int, spacing: float, spread: float, distance: float) -> Layer:
    """A layer for diffusion.

    Parameters
    ----------
    nodes : int
    spacing : float
    spread : float
        Diffusivity times the length of the run.
    distance : float
        The shortest way from the data to the side.
    """
    later = np.log(max(spread / distance**2, 1.0))
    steepest = min(_STEEPEST * nodes / (distance * (later + _EARLY)), 2 / spacing)
    slowest = min(_GRADUAL / np.sqrt(spread), steepest / 2)
    tau = spacing / 2 * steepest * _zolotarev(slowest / steepest, nodes + 1)
    return Layer(np.maximum(1 / tau, 1.0), np.zeros(nodes + 1), np.zeros(nodes + 1))


def returned_by_diffusion(layer: Layer, spacing: float, spreads: np.ndarray, distance: float) -> np.ndarray:
    """What comes back to the side of a point source on a line, relative to the largest value at the same time.

    The inverse Laplace transform along ``lambda = (1.2 + i y)/sqrt(D t)``; of waves along the side less remains.

    Parameters
    ----------
    layer : Layer
    spacing : float
    spreads : ndarray, shape (n,)
        D t of the times.
    distance : float
        Of the source from the side.

    Returns
    -------
    ndarray, shape (n,)
    """
    y, step = np.linspace(-_HIGHEST, _HIGHEST, _POINTS, retstep=True)
    scaled = 1.2 + 1j * y
    decay = scaled / np.sqrt(spreads)[:, None]
    tangent = np.tanh(spacing * decay / 2)
    back = np.ones_like(decay)
    for edge, kappa in enumerate(layer.kappa):
        passed = (1 - kappa * tangent) / (1 + kappa * tangent)
        back *= passed if edge == layer.columns else passed**2
    return np.asarray(np.abs((np.exp(scaled**2 - decay * distance) * back).sum(1)) * step / np.sqrt(np.pi))


def thinnest_for_diffusion(spacing: float, spread: float, distance: float, wanted: float) -> Thickness | None:
    """The fewest nodes that keep an error relative to the largest value at every time of a run; None if no 60 nodes do."""
    distance = max(distance, spacing)
    spreads = np.geomspace(min(_BEGIN * distance**2, spread), spread, _TIMES)
    for nodes in range(2, _MOST + 1):
        layer = diffusive(nodes, spacing, spread, distance)
        predicted = float(returned_by_diffusion(layer, spacing, spreads, distance).max())
        if predicted <= _AIM_LASTING * wanted:
            return Thickness("diffusive", layer, predicted)
    return None

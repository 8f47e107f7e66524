"""The thinnest layer that keeps a target error in diffusion, relative to the largest value at every time of a run.

Everything depends on the decay ``lambda = sqrt(s/D)`` alone. An edge ``kappa = 1/tau`` reflects ``(lambda h/2 -
tau)/(lambda h/2 + tau)``, and the points tau are Zolotarev's between the slowest decay that matters in the run and the
steepest that arrives.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import gamma

from farhorizon.analysis.layers.families import zolotarev
from farhorizon.analysis.layers.side_data import Datum
from farhorizon.analysis.layers.thickness import MOST, Thickness, distance_to_side
from farhorizon.engine.engine import Layer

_AIM = 0.25  # part of the target error: late in a run the reflections of all sides add up
_AIM_OTHERS = 0.8  # part for waves that alternate from step to step, which are reflected earlier
# range of the decays that matter, fitted to the smallest error over all times of a run
_STEEPEST, _EARLY, _GRADUAL = 3.2, 5.2, 2.3
_ENTRANCE = 3  # nodes there and back: the one in front of each layer, and half a node to where an edge reflects
_HIGHEST, _POINTS = 6.0, 241  # upper limit and points of the integral over y: exp(-36) remains
# first time in squared distance over D, before which there is no reflection, and the number of times examined
_BEGIN, _TIMES = 0.03, 60
_PLANES = 128  # largest number of planes of data
_PLACES = 65  # number of places, in addition to those of the data, at which the largest value is sought
_NOTHING = 1e-12  # negligible part of the largest sum over a plane


class Wall(NamedTuple):
    """A wall opposite to a layer for diffusion.

    Attributes
    ----------
    image : int
        Sign of the image that represents it: -1 if it holds the nodes beyond it, 1 if nothing passes.
    distance : float
        From the side where the layer begins.
    """

    image: int
    distance: float


@dataclass(frozen=True)
class Planes:
    """Data that diffuse towards a side, by planes across its normal.

    Attributes
    ----------
    distances : ndarray, shape (n,)
        From the side.
    shares : ndarray, shape (n,)
        Shares of the data, with their signs; the sum of their absolute values is 1.
    nearest, farthest : float
        Shortest distance of the data to the side, and distance of the other end of the near field.
    lasting : int
        0 for initial data, 1 for nodes that hold their value from then on, 2 for a continuing source.
    """

    distances: np.ndarray
    shares: np.ndarray
    nearest: float
    farthest: float
    lasting: int = 0

    @classmethod
    def at(cls, distance: float, lasting: int = 0) -> Planes:
        """All data in one plane."""
        return cls(np.array([distance]), np.ones(1), distance, distance, lasting)

    @classmethod
    def nearest_of(cls, values: np.ndarray, spacing: float, lasting: int = 0) -> Planes:
        """All data in the plane of the values that are nearest to the side; the normal first, towards the side."""
        return cls.at(spacing * distance_to_side([values]), lasting)

    @classmethod
    def of(cls, values: np.ndarray, spacing: float) -> Iterator[Planes]:
        """Yield the planes of values, with the normal first and towards the side: once with their sums over each plane,
        and once with the largest value of each.

        Data also spread along the side: at late times the sums of the planes count, at early ones their largest values.
        If the data are a product of functions along and across the normal, both are the function along it.
        """
        nearest, planes = cls.nearest_of(values, spacing).nearest, values.reshape(len(values), -1)
        size = np.abs(planes).sum(1).max()
        largest = np.take_along_axis(planes, np.abs(planes).argmax(1)[:, None], 1)[:, 0]
        for amounts in (planes.sum(1), largest)[: planes.shape[1]]:
            sizes = np.abs(amounts)
            held = np.flatnonzero(sizes > _NOTHING * size)
            if not held.size:
                continue
            groups = np.array_split(held, min(_PLANES, len(held)))
            middles = np.array([np.average(group, weights=sizes[group]) for group in groups])
            shares = np.array([amounts[group].sum() for group in groups]) / sizes.sum()
            yield cls(spacing * (len(values) - 1 - middles), shares, nearest, spacing * (len(values) - 1))


class Cause(NamedTuple):
    """Something that diffuses.

    Attributes
    ----------
    datum : Datum
    lasting : int
        As in `Planes`.
    whole : bool
        Whether it is followed plane by plane, instead of as if all of it were at its node nearest to a side.
    """

    datum: Datum
    lasting: int = 0
    whole: bool = False

    def planes(self, axis: int, side: int, spacing: float) -> Iterable[Planes]:
        """Its planes as seen from a side; empty where there is nothing."""
        values = self.datum.turned(axis, side).values
        if not values.any():
            return []
        return Planes.of(values, spacing) if self.whole else [Planes.nearest_of(values, spacing, self.lasting)]


def goes_on(course: np.ndarray) -> bool:
    """Whether a source is present, and constant, at all times examined."""
    return bool(course.any()) and bool(np.ptp(course) == 0)


@dataclass(frozen=True)
class Diffusing:
    """Reflection of data at a side, relative to the largest value at the same time.

    It is the inverse Laplace transform along ``lambda = z/sqrt(D t)``, z = 1.2 + i y; waves that vary along the side
    leave less. Opposite a wall that holds its nodes the data become dipoles, whose longer images in the layer decay no
    faster. For lasting data, each sum over time is a factor 1/z.

    Attributes
    ----------
    planes : Planes
    spreads : ndarray, shape (m,)
        D t at the times examined.
    wall : Wall, optional
        Opposite to the layer.
    """

    planes: Planes
    spreads: np.ndarray
    wall: Wall | None = None

    @cached_property
    def _scaled(self) -> np.ndarray:
        return 1.2 + 1j * np.linspace(-_HIGHEST, _HIGHEST, _POINTS)

    @cached_property
    def _decay(self) -> np.ndarray:
        return np.asarray(self._scaled / np.sqrt(self.spreads)[:, None])

    def _in_time(self, transform: np.ndarray) -> np.ndarray:
        """Absolute value at each time of a transform, relative to a single plane at its own place without a wall."""
        step, lasting = 2 * _HIGHEST / (_POINTS - 1), self.planes.lasting
        unit = gamma((lasting + 1) / 2) * step / np.pi
        return np.asarray(np.abs((np.exp(self._scaled**2) / self._scaled**lasting * transform).sum(1)) * unit)

    def _with_image(self, distance: float) -> np.ndarray:
        """Transform for a plane and its image in the wall, at the place of the plane."""
        if self.wall is None:
            return np.ones_like(self._decay)
        return 1 + self.wall.image * np.exp(-2 * self._decay * (self.wall.distance - distance))

    @cached_property
    def _arriving(self) -> np.ndarray:
        """Transform at the side without a layer, for each decay."""
        planes = zip(self.planes.distances, self.planes.shares, strict=True)
        return np.asarray(
            sum(share * np.exp(-self._decay * distance) * self._with_image(distance) for distance, share in planes)
        )

    @cached_property
    def largest(self) -> np.ndarray:
        """Largest value of the field at each time, over that of data that are all in one plane, without a wall."""
        if self.planes.lasting:
            return self._in_time(self._with_image(float(self.planes.distances.mean())))
        distances, sources = self.planes.distances, [(1, self.planes.distances)]
        if self.wall is not None:
            sources.append((self.wall.image, 2 * self.wall.distance - distances))
        places = np.concatenate([distances, np.linspace(0, self.planes.farthest, _PLACES)])
        field = sum(
            sign * np.exp(-((places[:, None] - source) ** 2) / (4 * self.spreads[:, None, None])) @ self.planes.shares
            for sign, source in sources
        )
        return np.asarray(np.abs(field).max(1))

    def returned(self, layer: Layer, spacing: float) -> np.ndarray:
        """Reflection of a layer at each time."""
        tangent = np.tanh(spacing * self._decay / 2)
        back = np.exp(-_ENTRANCE * spacing * self._decay)
        for edge, kappa in enumerate(layer.kappa):
            passed = (1 - kappa * tangent) / (1 + kappa * tangent)
            back *= passed if edge == layer.columns else passed**2
        if self.wall is not None:
            across = self.wall.image * np.exp(-2 * self._decay * self.wall.distance)
            back *= (1 + across) / (1 - across * back)
        return self._in_time(self._arriving * back) / self.largest


def diffusive(nodes: int, spacing: float, spread: float, distance: float) -> Layer:
    """A layer for diffusion.

    Parameters
    ----------
    nodes : int
    spacing : float
    spread : float
        Diffusivity times the length of the run.
    distance : float
        Shortest distance between the data and the side.
    """
    later = np.log(max(spread / distance**2, 1.0))
    steepest = min(_STEEPEST * nodes / (distance * (later + _EARLY)), 2 / spacing)
    slowest = min(_GRADUAL / np.sqrt(spread), steepest / 2)
    tau = spacing / 2 * steepest * zolotarev(slowest / steepest, nodes + 1)
    return Layer(np.maximum(1 / tau, 1.0), np.zeros(nodes + 1), np.zeros(nodes + 1))


def predicted_for_diffusion(
    layer: Layer, spacing: float, spread: float, data: Sequence[Planes], wall: Wall | None = None
) -> float:
    """Largest reflection of a layer at any time of a run, relative to the field at the same time."""
    return max(float(one.returned(layer, spacing).max()) for one in _arriving(spacing, spread, data, wall))


def _arriving(spacing: float, spread: float, data: Sequence[Planes], wall: Wall | None) -> list[Diffusing]:
    """What arrives at the layer, at the times examined."""
    spreads = np.geomspace(min(_BEGIN * _nearest(spacing, data) ** 2, spread), spread, _TIMES)
    return [Diffusing(planes, spreads, wall) for planes in data]


def _nearest(spacing: float, data: Sequence[Planes]) -> float:
    """Shortest distance between data and the side."""
    return max(spacing, min(planes.nearest for planes in data))


def thinnest_for_diffusion(
    spacing: float,
    spread: float,
    data: Sequence[Planes],
    wanted: float,
    wall: Wall | None = None,
    others: Callable[[Layer], float] = lambda layer: 0.0,
) -> Thickness:
    """The layer with the fewest nodes that keeps an error relative to the largest value at every time of a run, and
    that also returns little enough of the alternating waves, as given by `others`; 60 nodes, with the error predicted
    for them, if no layer does.
    """
    distance, arriving = _nearest(spacing, data), _arriving(spacing, spread, data, wall)

    def predicted(layer: Layer) -> float:
        return max(float(one.returned(layer, spacing).max()) for one in arriving)

    layers, last = [diffusive(nodes, spacing, spread, distance) for nodes in range(2, MOST + 1)], MOST - 2
    found = next((i for i, layer in enumerate(layers) if predicted(layer) <= _AIM * wanted), last)
    if others(layers[found]) > _AIM_OTHERS * wanted:
        found = bisect_left(range(found, last), True, key=lambda i: others(layers[i]) <= _AIM_OTHERS * wanted) + found
    layer = layers[found]
    back = max((one.returned(layer, spacing) for one in arriving), key=np.max)
    time = arriving[0].spreads[back.argmax()] / spread
    return Thickness("diffusive", layer, float(back.max()), set_by=f"what comes back at {time:.0%} of that time")

"""The thinnest layer that keeps a wanted error in diffusion, relative to the largest value at every time of a run.

Everything depends on the decay ``lambda = sqrt(s/D)`` alone, an edge ``kappa = 1/tau`` reflects
``(lambda h/2 - tau)/(lambda h/2 + tau)``, and the points tau are Zolotarev's between the slowest decay that the run
sees and the steepest that arrives.
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

_AIM = 0.25  # of the wanted error: late in a run what all sides send back adds up
_AIM_OTHERS = 0.8  # of waves that alternate from step to step, which come earlier
# which decays matter, fitted to the least error over all times of a run
_STEEPEST, _EARLY, _GRADUAL = 3.2, 5.2, 2.3
_ENTRANCE = 3  # nodes there and back: the one in front of each layer, and edges reflect half a node behind theirs
_HIGHEST, _POINTS = 6.0, 241  # of the integral over y: exp(-36) remains
# first time in squared distance over D, before which nothing has come back, and how many are looked at
_BEGIN, _TIMES = 0.03, 60
_PLANES = 128  # of data, at most
_PLACES = 65  # at which, beside those of data, the largest value is looked for
_NOTHING = 1e-12  # of the largest sum over a plane


class Wall(NamedTuple):
    """A wall opposite to a layer for diffusion.

    Attributes
    ----------
    image : int
        Sign of the image that stands for it: -1 where it holds the nodes beyond, 1 where nothing passes.
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
        Of the data, with their signs; their sizes are 1 in all.
    nearest, farthest : float
        The shortest way to the side, and that from the other end of the near field.
    lasting : int
        0 of what is there once, 1 of what holds its value from then on, 2 of a source that goes on.
    """

    distances: np.ndarray
    shares: np.ndarray
    nearest: float
    farthest: float
    lasting: int = 0

    @classmethod
    def at(cls, distance: float, lasting: int = 0) -> Planes:
        """All in one plane."""
        return cls(np.array([distance]), np.ones(1), distance, distance, lasting)

    @classmethod
    def nearest_of(cls, values: np.ndarray, spacing: float, lasting: int = 0) -> Planes:
        """All where the nearest of some values are, with the normal first and towards the side."""
        return cls.at(spacing * distance_to_side([values]), lasting)

    @classmethod
    def of(cls, values: np.ndarray, spacing: float) -> Iterator[Planes]:
        """Of values with the normal first and towards the side: those of their sums over planes, and of the largest
        value of each.

        Along the side, too, data spread: in time planes count by their sums, early by their largest value. If the data
        are a product of what they are along and across the normal, both are that along it.
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
    """What something diffuses from.

    Attributes
    ----------
    datum : Datum
    lasting : int
        As of `Planes`.
    whole : bool
        Whether it is followed plane by plane, else as if all of it were at the node that is nearest to a side.
    """

    datum: Datum
    lasting: int = 0
    whole: bool = False

    def planes(self, axis: int, side: int, spacing: float) -> Iterable[Planes]:
        """As a side sees it; none where there is nothing."""
        values = self.datum.turned(axis, side).values
        if not values.any():
            return []
        return Planes.of(values, spacing) if self.whole else [Planes.nearest_of(values, spacing, self.lasting)]


def goes_on(course: np.ndarray) -> bool:
    """Whether a source is there at all times that are looked at, and stays as it is."""
    return bool(course.any()) and bool(np.ptp(course) == 0)


@dataclass(frozen=True)
class Diffusing:
    """What comes back of data to a side, relative to the largest value at the same time.

    The inverse Laplace transform along ``lambda = z/sqrt(D t)``, z = 1.2 + i y; of waves along the side less remains. A
    wall that holds its nodes leaves dipoles, whose images in the layer are the longer ones and fall no faster. What
    lasts is a sum over times, a factor 1/z for each of them.

    Attributes
    ----------
    planes : Planes
    spreads : ndarray, shape (m,)
        D t of the times.
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
        """At each time, of a transform over that of a plane at its own place, without a wall."""
        step, lasting = 2 * _HIGHEST / (_POINTS - 1), self.planes.lasting
        unit = gamma((lasting + 1) / 2) * step / np.pi
        return np.asarray(np.abs((np.exp(self._scaled**2) / self._scaled**lasting * transform).sum(1)) * unit)

    def _with_image(self, distance: float) -> np.ndarray:
        """A plane and its image in the wall, at its own place."""
        if self.wall is None:
            return np.ones_like(self._decay)
        return 1 + self.wall.image * np.exp(-2 * self._decay * (self.wall.distance - distance))

    @cached_property
    def _arriving(self) -> np.ndarray:
        """At the side without a layer, of each decay."""
        planes = zip(self.planes.distances, self.planes.shares, strict=True)
        return np.asarray(
            sum(share * np.exp(-self._decay * distance) * self._with_image(distance) for distance, share in planes)
        )

    @cached_property
    def largest(self) -> np.ndarray:
        """Largest value of the field at each time, over that of data which are all in one plane and without a wall."""
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
        """At each time, of a layer."""
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
        The shortest way from the data to the side.
    """
    later = np.log(max(spread / distance**2, 1.0))
    steepest = min(_STEEPEST * nodes / (distance * (later + _EARLY)), 2 / spacing)
    slowest = min(_GRADUAL / np.sqrt(spread), steepest / 2)
    tau = spacing / 2 * steepest * zolotarev(slowest / steepest, nodes + 1)
    return Layer(np.maximum(1 / tau, 1.0), np.zeros(nodes + 1), np.zeros(nodes + 1))


def predicted_for_diffusion(
    layer: Layer, spacing: float, spread: float, data: Sequence[Planes], wall: Wall | None = None
) -> float:
    """Largest part of the field at the same time that a layer sends back, at any time of a run."""
    return max(float(one.returned(layer, spacing).max()) for one in _arriving(spacing, spread, data, wall))


def _arriving(spacing: float, spread: float, data: Sequence[Planes], wall: Wall | None) -> list[Diffusing]:
    """What comes to the layer, at the times that are looked at."""
    spreads = np.geomspace(min(_BEGIN * _nearest(spacing, data) ** 2, spread), spread, _TIMES)
    return [Diffusing(planes, spreads, wall) for planes in data]


def _nearest(spacing: float, data: Sequence[Planes]) -> float:
    """The shortest way from data to the side."""
    return max(spacing, min(planes.nearest for planes in data))


def thinnest_for_diffusion(
    spacing: float,
    spread: float,
    data: Sequence[Planes],
    wanted: float,
    wall: Wall | None = None,
    others: Callable[[Layer], float] = lambda layer: 0.0,
) -> Thickness:
    """The fewest nodes that keep an error relative to the largest value at every time of a run, and most of it in
    others than these waves, by what a layer sends back of them; 60 nodes, and what is predicted of them, if none do.
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

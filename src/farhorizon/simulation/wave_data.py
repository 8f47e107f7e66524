"""Data that send waves to a side, as predictions use them: divided in time, flattened along an axis, or replaced."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from farhorizon.analysis.layers.layer import LatticeMedium
from farhorizon.analysis.layers.side_data import Datum
from farhorizon.medium.stencil import Stencil

# lengths of the run before images of the data arrive, if there is room: later arrivals fold back into the run, much
# weaker
_ROUND = 2
_AHEAD = 1.05  # distance over that of long waves: on a lattice the faint front of a pulse runs ahead of them
_LONG = 8  # for the later part of a run data are smoothed over the room divided by this: only the longest waves remain
# speed of the fastest waves over that of the slowest waves of solids that are reflected noticeably: the reflection of
# short pulses in boxes of 120 and 200 nodes grew until about the time at which these are back from the layer
_SLOW = 10.0
FORESEEN = 60  # least number of crossings for which errors are predicted
# steps times nodes along the longest side for which errors of scalars are predicted in 1D and 2D: the work grows with
# both; in 3D the predicted errors of persistent loads are far too large
_WORK = 4e6
_SILENT = 1e-3  # fraction of the wanted error below which a source is taken to have ended
_STAND_IN = 2.0  # width, in nodes, of the pulses that replace unknown data


def foreseen_time(crossing: float, dt: float, stencil: Stencil, shape: tuple[int, ...]) -> float:
    """Return the time up to which errors are predicted."""
    steps = _WORK / max(shape) if stencil.components == 1 and len(shape) < 3 else 0.0
    return max(FORESEEN * crossing, steps * dt)


def by_time(data: Sequence[Datum], half: int, silent: float) -> Iterator[tuple[int, int, list[Datum]]]:
    """Divide data with lasting sources into overlapping parts in time, so that each moment is complete in one of them
    and no source is switched on or off abruptly.

    Parameters
    ----------
    data : sequence of Datum
    half : int
        Half the number of steps that a part lasts.
    silent : float
        Fraction of a source's largest value below which a part of it is left out.

    Yields
    ------
    tuple of (int, int, list of Datum)
        The step at which a part begins, the number of steps from there to its middle, and its data.
    """
    for middle in range(0, max([1, *(len(datum.time) for datum in data)]), half):
        before, part = min(middle, half), [datum for datum in data if datum.kind != "source" and middle == 0]
        for datum in data:
            course = datum.time[middle - before : middle + half]
            if np.abs(course).max(initial=0.0) > silent * np.abs(datum.time).max(initial=0.0):
                away = np.abs(np.arange(len(course)) - before) / half
                part.append(replace(datum, time=course * np.cos(np.pi * np.maximum(away - 0.5, 0.0)) ** 2))
        if part:
            yield middle - before, before, part


class FollowedPart(NamedTuple):
    """Data of which some waves are followed for a time.

    Attributes
    ----------
    data : sequence of Datum
    time : float
    room : int
        Nodes by which the period along the side exceeds the near field.
    smooth : float
        Width in nodes of the smoothing of the data.
    limit : float
        Speed along the side above which waves are left out.
    later : float
        Length of the run over `time`, if later reflection is extrapolated from that up to then; 1 otherwise.
    """

    data: Sequence[Datum]
    time: float
    room: int
    smooth: float = 0.0
    limit: float = np.inf
    later: float = 1.0


def is_long(medium: LatticeMedium, until: float, most: float) -> bool:
    """Whether images of the data arrive within a run if the period exceeds the near field by `most` nodes."""
    return _AHEAD * medium.speed / medium.spacing * until > most


def followed_parts(
    medium: LatticeMedium, data: Sequence[Datum], until: float, wanted: float, most: float, every: bool, nodes: int
) -> list[FollowedPart]:
    """Return which waves of the data are followed in a run, and for how long.

    Where the medium continues along the side, images that are not there in reality would arrive in a long run, and
    matter for layers that absorb little of what travels along them. So all waves are followed only until the first
    image arrives. Only the longest waves, which are few enough for any period, and those that hardly move are followed
    beyond that.

    Parameters
    ----------
    medium : LatticeMedium
    data : sequence of Datum
        Their first axis is the normal.
    until : float
    wanted : float
        The smallest error that has to be detected.
    most : float
        Nodes by which the period exceeds the near field for waves that start at time zero; inf if the data are
        periodic.
    every : bool
        Whether all modes are followed. Some of them hardly move: those of scalars that travel no farther than `most`
        nodes are followed to the end of the run, those of vectors until they have returned.
    nodes : int
        Thickness of the thickest layer from which they return.

    Returns
    -------
    list of FollowedPart
    """
    pace = medium.speed / medium.spacing
    room = int(np.ceil(_ROUND * pace * until))
    if not is_long(medium, until, most):
        return [FollowedPart(data, until, int(min(room, most)))]
    solid = every and medium.stencil.components > 1
    found = [FollowedPart(data, until, room, smooth=most / _LONG)]
    if every and not solid:
        found.append(FollowedPart(data, until, int(most), limit=most * medium.spacing / until))
    slow = _SLOW * (max(depth_of(data), default=0) + 2 * nodes) if solid else 0.0
    for begin, before, some in by_time(data, max(1, int(most / (2 * pace * medium.dt))), _SILENT * wanted):
        left, middle = until - begin * medium.dt, before * medium.dt
        time, last = min(left, middle + most / pace), min(left, middle + slow / pace)
        later = left / time if solid and last <= time else 1.0
        found.append(FollowedPart(some, time, int(np.ceil(_AHEAD * pace * time)), later=later))
        if last > time:
            found.append(FollowedPart(some, last, int(most), limit=most * medium.spacing / last, later=left / last))
    return found


def stand_ins(
    shape: tuple[int, ...], reach: int, components: int = 1, courses: Sequence[np.ndarray] = ()
) -> list[Datum]:
    """Return data that replace unknown ones: short pulses in the middle and, on each axis, one reach and a few nodes
    from both ends; or, if courses in time are given, sources of one node each at these places.
    """
    places = [np.array(shape) / 2]
    for axis, nodes in enumerate(shape):
        near = min(reach + 4 * _STAND_IN, nodes / 2)
        places += [np.where(np.arange(len(shape)) == axis, end, places[0]) for end in (near, nodes - 1 - near)]
    grid = np.ix_(*[np.arange(n) for n in shape])
    if courses:
        points = np.zeros(shape)
        points[tuple(np.array(places).astype(int).T)] = 1
        return [Datum(points, "source", course, component) for component in range(components) for course in courses]
    pulses = [np.exp(-sum((x - a) ** 2 for x, a in zip(grid, place, strict=True)) / _STAND_IN**2) for place in places]
    return [Datum(np.max(pulses, axis=0), "u", component=component) for component in range(components)]


def depth_of(data: Sequence[Datum]) -> tuple[int, ...]:
    """Return the number of nodes from the side to the centre of the data; empty if all data are zero."""
    size = sum(np.abs(datum.values).sum(tuple(range(1, datum.values.ndim))) for datum in data)
    rows = np.arange(len(data[0].values))[::-1]
    return (round(float(np.average(rows, weights=size))),) if np.any(size) else ()


def key_of(data: Sequence[Datum], together: bool, mirrors: Sequence[int] = ()) -> frozenset[object]:
    """Return a key that is the same for data which send waves of the same size to a side, as data of the opposite sign
    and mirror images along the side do.

    Parameters
    ----------
    data : sequence of Datum
    together : bool
        Whether the components are followed together, in 2D, where 0 is along the normal and 1 along the side; otherwise
        each component is followed separately, with a sign and a mirror image of its own.
    mirrors : sequence of int
        Axes under whose reflection the medium and the sides are unchanged.
    """
    apart = [[one for one in data if one.component == component] for component in {one.component for one in data}]
    groups = [data] if together else apart
    return frozenset(Counter(_key_of_images(group, together, mirrors) for group in groups).items())


def _key_of_images(data: Sequence[Datum], together: bool, mirrors: Sequence[int]) -> tuple[object, ...]:
    """Return the key of data that are followed together: that of the first of their images in order."""
    images = []
    for across in (axes for n in range(len(mirrors) + 1) for axes in combinations(mirrors, n)):
        turned = [np.flip(-one.values if together and one.component in across else one.values, across) for one in data]
        # adding zero removes the sign of -0.0
        images += [tuple((sign * values + 0.0).tobytes() for values in turned) for sign in (-1, 1)]
    rest = ((one.component if together else 0, one.kind, one.time.tobytes(), one.behind) for one in data)
    return data[0].values.shape, min(images), *rest


def largest_along(values: np.ndarray, axes: Sequence[int]) -> np.ndarray:
    """Replace values by the largest in magnitude along some axes: in 3D waves that vary along one tangential axis at a
    time stand for all.

    A cylindrical wave decays more slowly than a spherical one, so this is conservative, and takes far less work.
    """
    for axis in axes:
        values = np.take_along_axis(values, np.abs(values).argmax(axis, keepdims=True), axis)
    return values

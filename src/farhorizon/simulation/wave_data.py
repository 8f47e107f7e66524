"""The data that send waves to a side, as predictions take them: in parts by time, flat along an axis, or stood for."""

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

# lengths of the run before images come round, if there is room: what comes later folds back into it, much fainter
_ROUND = 2
_AHEAD = 1.05  # way over that of long waves in a time: on a lattice the front of a pulse runs ahead of them, faintly
_LONG = 8  # parts of the room, by one of which data are smoothed for what is still to come: the longest waves alone
# pace of the fastest waves over that of the slowest of solids of which something comes back: what came back of short
# pulses in boxes of 120 and 200 nodes grew until about when these are back from the layer
_SLOW = 10.0
FORESEEN = 60  # crossings for which errors are predicted at least
# steps, times nodes along the longest side, for which those of scalars on a line and in the plane are: the work grows
# with both, and in space far more is predicted of loads that stay than comes
_WORK = 4e6
_SILENT = 1e-3  # of the wanted error: sources that are fainter send nothing any more
_STAND_IN = 2.0  # width, in nodes, of the pulses that stand for data which are not known


def foreseen_time(crossing: float, dt: float, stencil: Stencil, shape: tuple[int, ...]) -> float:
    """Time up to which errors are predicted."""
    steps = _WORK / max(shape) if stencil.components == 1 and len(shape) < 3 else 0.0
    return max(FORESEEN * crossing, steps * dt)


def by_time(data: Sequence[Datum], half: int, silent: float) -> Iterator[tuple[int, int, list[Datum]]]:
    """Data of which sources that go on are cut into parts, so that each moment is whole in one of them and none is
    switched on or off at once.

    Parameters
    ----------
    data : sequence of Datum
    half : int
        Of the steps that a part lasts.
    silent : float
        A part of a source with less, over its largest value, sends nothing.

    Yields
    ------
    tuple of (int, int, list of Datum)
        The step at which a part begins, steps from there to its middle, and its data.
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
        Nodes beside the near field.
    smooth : float
        Nodes by which the data are smoothed.
    limit : float
        Speed along the side that the waves do not exceed.
    later : float
        Length of the run over the time, where what comes later is told from what comes before.
    """

    data: Sequence[Datum]
    time: float
    room: int
    smooth: float = 0.0
    limit: float = np.inf
    later: float = 1.0


def is_long(medium: LatticeMedium, until: float, most: float) -> bool:
    """Whether images of the data come round within a run, where so many nodes are beside the near field."""
    return _AHEAD * medium.speed / medium.spacing * until > most


def followed_parts(
    medium: LatticeMedium, data: Sequence[Datum], until: float, wanted: float, most: float, every: bool, nodes: int
) -> list[FollowedPart]:
    """What is followed of data in a run.

    Where the medium goes on along the side, images in place of nothing would come round in a long run, and be heard in
    layers that take little of what travels along them. So there all waves are followed only as long as none comes, and
    longer the longest ones alone, which are few enough for any room, and those that hardly move.

    Parameters
    ----------
    medium : LatticeMedium
    data : sequence of Datum
        The first axis along the normal.
    until : float
    wanted : float
        The error that is to be told from none.
    most : float
        Nodes beside the near field for waves that set out at the start; inf where the data repeat themselves.
    every : bool
        Whether all modes are followed. Among them are some that hardly move: those of scalars that go no farther than
        the room are followed to the end of the run, those of vectors until they have come back.
    nodes : int
        Of the thickest layer that they come back from.

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
    """Data in place of such that are not known: short pulses in the middle and one reach and a few nodes from both ends
    of each axis; if their courses in time are known sources there, of a node each.
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
    """Nodes from the side to the middle of the data; none where there is nothing."""
    size = sum(np.abs(datum.values).sum(tuple(range(1, datum.values.ndim))) for datum in data)
    rows = np.arange(len(data[0].values))[::-1]
    return (round(float(np.average(rows, weights=size))),) if np.any(size) else ()


def key_of(data: Sequence[Datum], together: bool, mirrors: Sequence[int] = ()) -> frozenset[object]:
    """By which data are known that send waves of the same size to a side: those of the other sign, too, and mirror
    images along the side.

    Parameters
    ----------
    data : sequence of Datum
    together : bool
        Whether the components are followed together, in the plane, where 0 is along the normal and 1 along the side;
        otherwise each is followed by itself, with sign and mirror of its own.
    mirrors : sequence of int
        Axes across which medium and sides are mirrored.
    """
    apart = [[one for one in data if one.component == component] for component in {one.component for one in data}]
    groups = [data] if together else apart
    return frozenset(Counter(_key_of_images(group, together, mirrors) for group in groups).items())


def _key_of_images(data: Sequence[Datum], together: bool, mirrors: Sequence[int]) -> tuple[object, ...]:
    """That of the first among the images of data that are followed together."""
    images = []
    for across in (axes for n in range(len(mirrors) + 1) for axes in combinations(mirrors, n)):
        turned = [np.flip(-one.values if together and one.component in across else one.values, across) for one in data]
        # without the sign of a zero
        images += [tuple((sign * values + 0.0).tobytes() for values in turned) for sign in (-1, 1)]
    rest = ((one.component if together else 0, one.kind, one.time.tobytes(), one.behind) for one in data)
    return data[0].values.shape, min(images), *rest


def largest_along(values: np.ndarray, axes: Sequence[int]) -> np.ndarray:
    """Values without their course along some axes, where the largest remains: in space waves along one tangential axis
    at a time stand for all.

    A cylindrical wave falls off more slowly than a spherical one, so this is careful, and far less work.
    """
    for axis in axes:
        values = np.take_along_axis(values, np.abs(values).argmax(axis, keepdims=True), axis)
    return values

"""The data that send waves to a side, as predictions take them: in parts by time, flat along an axis, or stood for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from farhorizon.analysis.layers.side_data import Datum

_STAND_IN = 2.0  # width, in nodes, of the pulses that stand for data which are not known


def by_time(data: Sequence[Datum], half: int, silent: float) -> Iterator[tuple[int, list[Datum]]]:
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
    tuple of (int, list of Datum)
        Steps before the middle of a part, the first of which is the start, and its data.
    """
    for middle in range(0, max([1, *(len(datum.time) for datum in data)]), half):
        before, part = min(middle, half), [datum for datum in data if datum.kind != "source" and middle == 0]
        for datum in data:
            course = datum.time[middle - before : middle + half]
            if np.abs(course).max(initial=0.0) > silent * np.abs(datum.time).max(initial=0.0):
                away = np.abs(np.arange(len(course)) - before) / half
                part.append(replace(datum, time=course * np.cos(np.pi * np.maximum(away - 0.5, 0.0)) ** 2))
        if part:
            yield before, part


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


def largest_along(values: np.ndarray, axes: Sequence[int]) -> np.ndarray:
    """Values without their course along some axes, where the largest remains: in space waves along one tangential axis
    at a time stand for all.

    A cylindrical wave falls off more slowly than a spherical one, so this is careful, and far less work.
    """
    for axis in axes:
        values = np.take_along_axis(values, np.abs(values).argmax(axis, keepdims=True), axis)
    return values

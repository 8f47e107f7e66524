"""Pictures of the records of receivers: wiggles, sections (position against time) and spectra."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon.pictures.style import COLORS, figure_at, number_text, scale_of, with_unit

_MOST_WIGGLES = 41
_LEAST_IN_SECTION = 8
_MOST_CURVES = 7
_AT_REST, _SMOOTH = 0.02, 4  # relative amplitude below which a record ends at rest; padding factor for spectra
_STRAIGHT = 1e-6  # of the length of a line: points further away do not lie on it


def trace_picture(
    points: np.ndarray,
    times: np.ndarray,
    values: np.ndarray,
    path: str | Path | None,
    *,
    label: str,
    measured: str = "",
) -> Any:
    """Draw traces and the amplitudes of their spectra.

    Up to seven traces are drawn as curves over time, more as wiggles at the positions of their receivers, with time
    downwards, and as an image.

    Parameters
    ----------
    points : ndarray, shape (n, dim)
        Positions of the receivers.
    times : ndarray, shape (rows,)
        Evenly spaced times.
    values : ndarray, shape (rows, n)
    path : str or Path, optional
        File name; if not given, nothing is written.
    label : str
        Name of the values, with their unit.
    measured : str
        Quantity whose unit they have; the spectrum has this unit times that of time.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        The directory does not exist.
    """
    name, places = positions(points)
    many = len(points) >= _LEAST_IN_SECTION
    with figure_at(path, (9.6 if many else 6.4, 3.6)) as figure:
        panels = list(figure.subplots(1, 2 + many))
        if many:
            _wiggles(panels[0], places, times, values, name)
            _section(figure, panels[1], places, times, values, name, label)
            panels[0].set_title(label)
        else:
            _curves(panels[0], points, times, values)
            panels[0].set(xlabel=with_unit("t", "time"), ylabel=label)
        _spectra(panels[-1], points, times, values)
        panels[-1].set_ylabel(with_unit("amplitude of the spectrum", measured, "time"))
    return figure


def spectrum_picture(
    points: np.ndarray,
    frequencies: np.ndarray,
    values: np.ndarray,
    path: str | Path | None,
    *,
    label: str,
    measured: str = "",
    labels: Sequence[str] = (),
) -> Any:
    """Draw amplitudes of spectra: up to seven points over frequency, more points over their positions, one curve per
    frequency.

    Parameters
    ----------
    points : ndarray, shape (n, dim)
    frequencies : ndarray, shape (F,)
    values : ndarray, shape (F, n)
        Complex values; real ones, such as flows through surfaces, are drawn with their signs.
    path : str or Path, optional
        File name; if not given, nothing is written.
    label : str
        Name of the values, without a unit.
    measured : str
        Quantity whose unit they have; the spectrum has this unit times that of time.
    labels : sequence of str
        Names of the points if these are not positions.

    Raises
    ------
    InputError
        The directory does not exist.
    """
    name, places = positions(points)
    with figure_at(path, (6.4, 3.6)) as figure:
        axes = figure.add_subplot()
        flows = np.isrealobj(values)
        what = f"{label} per frequency" if flows else f"amplitude of the spectrum of {label}"
        axes.set_ylabel(with_unit(what, measured, "time"))
        values = values if flows else np.abs(values)
        if labels or len(points) < _LEAST_IN_SECTION:
            _curves(axes, points, frequencies, values, labels)
            axes.set_xlabel(_frequency_label())
            return figure
        some = np.unique(np.linspace(0, len(frequencies) - 1, min(len(frequencies), _MOST_CURVES)).round().astype(int))
        for number in some:
            axes.plot(places, values[number], label=f"{frequencies[number]:.4g}")
        axes.set_xlabel(name)
        axes.margins(x=0.01)
        axes.grid(True)
        axes.legend(title=with_unit("frequency", "frequency"), fontsize="x-small")
    return figure


def positions(points: np.ndarray) -> tuple[str, np.ndarray]:
    """Name and values of the positions of points along a line; the numbers of the points if they do not lie on one.

    For a line along an axis the position is the coordinate, otherwise the distance from the first point.
    """
    numbers = np.arange(len(points), dtype=float)
    apart = points - points[0]
    length = float(np.linalg.norm(apart[-1]))
    if len(points) < 2 or not length:
        return "receiver", numbers
    direction = apart[-1] / length
    along = apart @ direction
    aside = np.linalg.norm(apart - np.multiply.outer(along, direction), axis=1).max()
    if aside > _STRAIGHT * length or (np.diff(along) <= 0).any():
        return "receiver", numbers
    axis = int(np.abs(direction).argmax())
    if np.abs(direction[axis]) > 1 - _STRAIGHT:
        return with_unit("xyz"[axis]), points[:, axis]
    return with_unit("distance along the receivers"), along


def _wiggles(axes: Any, places: np.ndarray, times: np.ndarray, values: np.ndarray, name: str) -> None:
    """Draw all or every n-th trace at its receiver on one scale, on which the largest is as wide as two are apart."""
    some = np.arange(0, len(places), -(-len(places) // _MOST_WIGGLES))
    gap = np.abs(np.diff(places[some])).min() if len(some) > 1 else 1.0
    largest = float(np.abs(values[np.isfinite(values)]).max(initial=0.0)) or 1.0
    for number in some:
        drawn = places[number] + gap * values[:, number] / largest
        axes.plot(drawn, times, color=COLORS[0], linestyle="-", linewidth=0.7)
        filled = {
            "where": drawn > places[number],
            "color": COLORS[0],
            "linewidth": 0,
            "alpha": 0.4,
            "interpolate": True,
        }
        axes.fill_betweenx(times, places[number], drawn, **filled)
    axes.set(xlabel=name, ylabel=with_unit("t", "time"))
    axes.margins(x=0.02, y=0)
    axes.invert_yaxis()


def _section(
    figure: Any, axes: Any, places: np.ndarray, times: np.ndarray, values: np.ndarray, name: str, label: str
) -> None:
    """Draw an image of position against time (a B-scan)."""
    edges = [_edges(one) for one in (places, times)]
    image = axes.pcolormesh(*edges, values, rasterized=True, **scale_of([values], None, None))
    axes.set(xlabel=name, ylabel=with_unit("t", "time"))
    axes.invert_yaxis()
    figure.colorbar(image, ax=axes, label=label)


def _edges(middles: np.ndarray) -> np.ndarray:
    """Edges half-way between values, and as far outside the first and the last value as inside."""
    if len(middles) < 2:
        return middles[0] + np.array([-0.5, 0.5])
    halves = (middles[1:] + middles[:-1]) / 2
    return np.concatenate([[2 * middles[0] - halves[0]], halves, [2 * middles[-1] - halves[-1]]])


def _spectra(axes: Any, points: np.ndarray, times: np.ndarray, values: np.ndarray) -> None:
    """Draw amplitudes over frequency, up to the last one that exceeds a hundredth of the largest; records that end at
    rest are padded with zeros, which makes the curves smooth.
    """
    if len(times) < 2:
        axes.set_axis_off()
        return
    dt = float(times[-1] - times[0]) / (len(times) - 1)
    values = np.nan_to_num(values)
    at_rest = np.abs(values[-1]).max() <= _AT_REST * np.abs(values).max()
    count = (_SMOOTH if at_rest else 1) * len(times)
    amplitudes = dt * np.abs(np.fft.rfft(values, count, axis=0))
    frequencies = np.fft.rfftfreq(count, dt)
    strong = np.flatnonzero(amplitudes.max(1) > 1e-2 * amplitudes.max())
    shown = slice(0, min(len(frequencies), int(strong[-1]) + 2) if strong.size else None)
    _curves(axes, points, frequencies[shown], amplitudes[shown])
    axes.set_xlabel(_frequency_label())


def _frequency_label() -> str:
    label = with_unit("frequency", "frequency")
    return f"{label} (cycles per unit of time)" if label == "frequency" else label


def _curves(axes: Any, points: np.ndarray, x: np.ndarray, values: np.ndarray, labels: Sequence[str] = ()) -> None:
    """Draw values at some of the receivers, named in the legend by position or by label."""
    some = np.unique(np.linspace(0, len(points) - 1, min(len(points), _MOST_CURVES)).round().astype(int))
    size = float(np.abs(points).max()) or 1.0
    for number in some:
        place = ", ".join(number_text(float(f"{coordinate:.4g}"), size) for coordinate in points[number])
        name = labels[number] if labels else f"({place})"
        axes.plot(x, values[:, number], label=name, marker="o" if len(x) == 1 else None)
    axes.margins(x=0.01)
    axes.grid(True)
    letters = "" if labels else with_unit(f"({', '.join('xyz'[: points.shape[1]])})")
    axes.legend(title=letters, fontsize="x-small", title_fontsize="x-small")

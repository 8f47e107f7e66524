"""Pictures of records at points: wiggles, sections (position against time), spectra, and patterns over directions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon.pictures.style import COLORS, figure_at, number_text, scale_of, with_unit

_MOST_WIGGLES = 41  # neighbours would overlap
_LEAST_IN_SECTION = 8  # receivers; fewer are drawn as curves
_MOST_CURVES = 7  # as many as there are colours
_AT_REST, _SMOOTH = 0.02, 4  # relative amplitude below which a record ends at rest; padding factor for spectra
_STRAIGHT = 1e-6  # of the length of a line: points further away do not lie on it
_MOST_FREQUENCIES = 4  # panels of a pattern side by side
_FLAT = 1e-9  # component of a unit vector normal to a plane in which it lies
_PLANES = ((0, 1), (1, 2), (2, 0))


def _some(count: int, most: int) -> np.ndarray:
    """Numbers of at most so many of `count` things, evenly spaced from the first to the last."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def trace_picture(
    points: np.ndarray,
    times: np.ndarray,
    values: np.ndarray,
    path: str | Path | None,
    *,
    label: str,
    measured: str = "",
) -> Any:
    """Draw traces at points (n, dim), values (times, n) at evenly spaced times, and the amplitudes of their spectra,
    and return the figure.

    Up to seven traces are drawn as curves over time, more as wiggles at the positions of their receivers, with time
    downwards, and as an image. The label has the unit of the values, which is that of the quantity `measured`; the
    spectrum has this unit times that of time.
    """
    name, places = positions(points)
    many = len(points) >= _LEAST_IN_SECTION
    with figure_at(path, (9.6 if many else 6.4, 3.6)) as figure:
        panels = list(figure.subplots(1, 2 + many))
        if many:
            _draw_wiggles(panels[0], places, times, values)
            panels[0].set(xlabel=name, ylabel=with_unit("t", "time"), title=label)
            image = panels[1].pcolormesh(
                _edges(places), _edges(times), values, rasterized=True, **scale_of([values], None, None)
            )
            panels[1].set(xlabel=name, ylabel=with_unit("t", "time"))
            panels[1].invert_yaxis()
            figure.colorbar(image, ax=panels[1], label=label)
        else:
            _draw_curves(panels[0], points, times, values)
            panels[0].set(xlabel=with_unit("t", "time"), ylabel=label)
        _draw_spectra(panels[-1], points, times, values)
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
    """Draw amplitudes of spectra, values (frequencies, n), and return the figure: up to seven points over frequency,
    more points over their positions, one curve per frequency.

    Real values, such as flows through surfaces, are drawn with their signs. The label is without a unit, which is that
    of the quantity `measured` times that of time. `labels` are names of points that are not positions.
    """
    name, places = positions(points)
    with figure_at(path, (6.4, 3.6)) as figure:
        axes = figure.add_subplot()
        flows = np.isrealobj(values)
        what = f"{label} per frequency" if flows else f"amplitude of the spectrum of {label}"
        axes.set_ylabel(with_unit(what, measured, "time"))
        values = values if flows else np.abs(values)
        if labels or len(points) < _LEAST_IN_SECTION:
            _draw_curves(axes, points, frequencies, values, labels)
            axes.set_xlabel(_frequency_label())
            return figure
        for number in _some(len(frequencies), _MOST_CURVES):
            axes.plot(places, values[number], label=f"{frequencies[number]:.4g}")
        axes.set_xlabel(name)
        axes.margins(x=0.01)
        axes.grid(True)
        axes.legend(title=with_unit("frequency", "frequency"), fontsize="x-small")
    return figure


def polar_picture(
    directions: np.ndarray,
    frequencies: np.ndarray,
    levels: Mapping[str, np.ndarray],
    path: str | Path | None,
    label: str = "",
) -> Any:
    """Draw the levels (frequencies, n) of each wave over directions (n, dim), a line per wave and a panel for each of
    up to four frequencies, in 3D in a row for each coordinate plane that contains directions; return the figure.
    """
    planes = [(plane, within) for plane in _PLANES if (within := _within(directions, plane)).size]
    drawn = _some(len(frequencies), _MOST_FREQUENCIES)
    top = max((float(np.nanmax(values, initial=0)) for values in levels.values()), default=0.0)
    with figure_at(path, (0.6 + 2.7 * len(drawn), 0.5 + 2.7 * len(planes))) as figure:
        panels = figure.subplots(len(planes), len(drawn), squeeze=False, subplot_kw={"projection": "polar"})
        for row, (plane, within) in zip(panels, planes, strict=True):
            angles = np.arctan2(directions[within, plane[1]], directions[within, plane[0]]) % (2 * np.pi)
            _, order = np.unique(angles.round(9), return_index=True)  # an axis lies in two planes
            closed = np.append(order, order[:1])
            plane_name = "" if directions.shape[1] == 2 else f", {'xyz'[plane[0]]}{'xyz'[plane[1]]} plane"
            for panel, number in zip(row, drawn, strict=True):
                for wave, values in levels.items():
                    panel.plot(angles[closed], values[number, within][closed], label=wave)
                panel.set_rlim(0, (1.05 * top) or 1.0)
                panel.tick_params(labelsize="x-small")
                panel.set_rlabel_position(100)
                cycles = number_text(float(frequencies[number]), float(frequencies.max()))
                per = with_unit("", "frequency").strip(" ()").removeprefix("1")
                panel.set_title(f"f = {cycles}{per}{plane_name}")
        if len(levels) > 1:
            figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside right upper")
        figure.supxlabel(label, fontsize="medium")
    return figure


def _within(directions: np.ndarray, plane: tuple[int, int]) -> np.ndarray:
    """Indices of the directions that lie in a plane."""
    if directions.shape[1] == 2:
        return np.arange(len(directions)) if plane == (0, 1) else np.zeros(0, int)
    (normal,) = {0, 1, 2} - set(plane)
    return np.flatnonzero(np.abs(directions[:, normal]) < _FLAT)


def positions(points: np.ndarray) -> tuple[str, np.ndarray]:
    """Name and values of the positions of points along a line, coordinates or distances from the first; the numbers of
    the points if they do not lie on one.
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


def _draw_wiggles(axes: Any, places: np.ndarray, times: np.ndarray, values: np.ndarray) -> None:
    """Draw all or every n-th trace at its receiver on one scale, on which the largest is as wide as two are apart."""
    some = np.arange(0, len(places), -(-len(places) // _MOST_WIGGLES))
    gap = np.abs(np.diff(places[some])).min() if len(some) > 1 else 1.0
    largest = float(np.abs(values[np.isfinite(values)]).max(initial=0.0)) or 1.0
    filled: dict[str, Any] = {"color": COLORS[0], "linewidth": 0, "alpha": 0.4, "interpolate": True}
    for number in some:
        trace = places[number] + gap * values[:, number] / largest
        axes.plot(trace, times, color=COLORS[0], linestyle="-", linewidth=0.7)
        axes.fill_betweenx(times, places[number], trace, where=trace > places[number], **filled)
    axes.margins(x=0.02, y=0)
    axes.invert_yaxis()


def _edges(middles: np.ndarray) -> np.ndarray:
    """Edges half-way between values, and as far outside the first and the last value as inside."""
    if len(middles) < 2:
        return middles[0] + np.array([-0.5, 0.5])
    halves = (middles[1:] + middles[:-1]) / 2
    return np.concatenate([[2 * middles[0] - halves[0]], halves, [2 * middles[-1] - halves[-1]]])


def _draw_spectra(axes: Any, points: np.ndarray, times: np.ndarray, values: np.ndarray) -> None:
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
    _draw_curves(axes, points, frequencies[shown], amplitudes[shown])
    axes.set_xlabel(_frequency_label())


def _frequency_label() -> str:
    label = with_unit("frequency", "frequency")
    return f"{label} (cycles per unit of time)" if label == "frequency" else label


def _draw_curves(axes: Any, points: np.ndarray, x: np.ndarray, values: np.ndarray, labels: Sequence[str] = ()) -> None:
    """Draw values at some of the receivers, named in the legend by position or by label."""
    size = float(np.abs(points).max()) or 1.0
    for number in _some(len(points), _MOST_CURVES):
        place = ", ".join(number_text(float(f"{coordinate:.4g}"), size) for coordinate in points[number])
        name = labels[number] if labels else f"({place})"
        axes.plot(x, values[:, number], label=name, marker="o" if len(x) == 1 else None)
    axes.margins(x=0.01)
    axes.grid(True)
    letters = "" if labels else with_unit(f"({', '.join('xyz'[: points.shape[1]])})")
    axes.legend(title=letters, fontsize="x-small", title_fontsize="x-small")

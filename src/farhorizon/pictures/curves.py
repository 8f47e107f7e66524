"""Pictures of curves: error histories, comparisons with papers, reflection over angles, waterfall plots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from farhorizon.errors import InputError
from farhorizon.pictures.style import COLORS, figure_at, tidy

DECADES = 20  # most of a logarithmic axis below its maximum; double precision resolves 16
_MARKERS = "oxs^v"  # of curves that are drawn as points
_ROUNDING = 1e-13  # relative to the incident wave: smaller reflections are due to rounding
_NAME = 0.075  # inches that a letter of a legend takes
_IN_COLUMN = 16  # curves in a column of a legend
# Styles of the curves of panels: dashes are all different, since the colours cannot be told apart in grey.
_DASHES: tuple[tuple[int, ...], ...] = ((), (3, 3), (8, 2, 1, 2, 1, 2), (6, 2), (6, 2, 1, 2), (1, 3), (1, 1))
_THIN = [COLORS[i] for i in (1, 6, 2, 3, 0, 4, 1)]  # those first that differ most on a pale line

Curve = tuple[str, np.ndarray, np.ndarray]  # name, x, y


class Frame(NamedTuple):
    """Labels and scales of the axes of curves."""

    xlabel: str
    ylabel: str
    title: str = ""
    log: bool = False  # the vertical axis
    places: Sequence[float] = ()  # of thin vertical lines
    limits: tuple[float, float] | None = None  # of the vertical axis
    decades: int = DECADES  # at most, below the largest value on a logarithmic axis


def lines(curves: Sequence[Curve], path: str | Path | None, frame: Frame) -> Any:
    """Draw curves into one axes, with the legend beside it, and return the figure."""
    columns = -(-len(curves) // _IN_COLUMN)
    widest = max((len(name) for name, _, _ in curves), default=0) if len(curves) > 1 else 0
    with figure_at(path, (4.6 + columns * (_NAME * widest + 0.5 * (widest > 0)), 3.1)) as figure:
        axes = figure.add_subplot()
        for name, x, y in curves:
            axes.plot(x, y, label=name, marker="o" if np.isfinite(y).sum() == 1 else None)
        for place in frame.places:
            axes.axvline(place, color="0.2", linewidth=0.8, linestyle="-")
        if frame.log:
            _use_decades(axes, [y for _, _, y in curves], frame.decades)
        axes.set(xlabel=frame.xlabel, ylabel=frame.ylabel, title=frame.title)
        if frame.limits is not None:
            axes.set_ylim(*frame.limits)
        tidy(axes)
        if len(curves) > 1:
            figure.legend(loc="outside right upper", ncols=columns)
    return figure


def _use_decades(axes: Any, values: Sequence[np.ndarray], decades: int) -> None:
    """Make the vertical axis logarithmic, with so many decades at most."""
    axes.set_yscale("log")
    top = max(np.max(y, where=np.isfinite(y), initial=0) for y in values)
    axes.set_ylim(bottom=max(axes.get_ylim()[0], top * 10.0**-decades))


def error_history(
    curves: Mapping[str, tuple[np.ndarray, np.ndarray]], path: str | Path, ylabel: str, title: str, *, xlabel: str = "t"
) -> None:
    """Draw errors over time, by name of the boundary, on a logarithmic axis with gaps at zero; curves that are zero
    everywhere or become infinite are marked in the legend.
    """
    if not curves:
        raise InputError("a picture of errors needs one curve or more")
    drawn = []
    for name, (times, errors) in curves.items():
        x, y = np.asarray(times, dtype=float), np.abs(np.asarray(errors, dtype=float))
        if x.ndim != 1 or x.shape != y.shape:
            raise InputError(f"times and errors of {name!r} do not match", value=y.shape, limit=x.shape)
        mark = " (diverges)" if np.isinf(y).any() else " (zero)" if y.size and (y == 0).all() else ""
        drawn.append((name + mark, x, _positive(y)))
    log = any(np.isfinite(y).any() for _, _, y in drawn)
    lines(drawn, path, Frame(xlabel, ylabel, title, log))


def _positive(values: np.ndarray) -> np.ndarray:
    """Values with gaps where they are not positive and finite, for a logarithmic axis."""
    return np.where((values > 0) & np.isfinite(values), values, np.nan)


def _check_panels(panels: Sequence[tuple[str, Sequence[Curve]]]) -> None:
    if not panels or not all(curves for _, curves in panels):
        raise InputError("a picture of curves needs one panel or more, each with a curve")


def curve_panels(
    panels: Sequence[tuple[str, Sequence[Curve]]],
    path: str | Path,
    *,
    xlabel: str | Sequence[str],
    ylabel: str | Sequence[str],
    reference: str | None = None,
    equal: Sequence[int] = (),
    points: Sequence[str] = (),
) -> None:
    """Draw panels (title, curves) for comparison: the reference (the first curve unless given) as a broad pale line,
    the others as thin lines on top of it.

    A name has the same style in all panels. A single curve is named at its axis, several in a common legend. Labels are
    those of all panels, or one per panel. The axes of panels numbered in `equal`, as those of positions where angles
    should be true, have the same scale. Curves named in `points`, whose few values must not be joined by chords, and
    values of which no two neighbours are finite are drawn as points.
    """
    _check_panels(panels)
    columns = 1 if len(panels) < 4 else 2
    rows = -(-len(panels) // columns)
    styles = _styles(panels, panels[0][1][0][0] if reference is None else reference, points)
    # all axes show the same quantity
    shared = isinstance(ylabel, str) and all(len(curves) > 1 for _, curves in panels)
    with figure_at(path, (6.4, 0.7 + 2.0 * rows)) as figure:
        legend: dict[str, Any] = {}
        for number, (title, curves) in enumerate(panels):
            axes = figure.add_subplot(rows, columns, number + 1)
            for name, x, y in curves:
                style = {"color": COLORS[0], "linewidth": 1.1} if len(curves) == 1 else styles[name]
                known = np.isfinite(y)
                marker = "" if (known[1:] & known[:-1]).any() else "o"
                (line,) = axes.plot(x, y, **{"linestyle": "-", "marker": marker, **style})
                if len(curves) > 1:
                    legend.setdefault(name, line)
            beside = "" if shared else ylabel if isinstance(ylabel, str) else ylabel[number]
            below = (xlabel if number >= len(panels) - columns else "") if isinstance(xlabel, str) else xlabel[number]
            axes.set(title=title, xlabel=below, ylabel=curves[0][0] if len(curves) == 1 else beside)
            if number in equal:
                axes.set_aspect("equal", adjustable="datalim")
            tidy(axes)
        if shared:
            figure.supylabel(ylabel, fontsize=axes.yaxis.label.get_size())
        if legend:
            # number of entries in a row: 100 characters fit, and the sample of a line takes 7
            fit = max(1, 100 // (max(map(len, legend)) + 7))
            figure.legend(legend.values(), legend.keys(), loc="outside upper center", ncols=min(len(legend), fit, 4))


def _styles(
    panels: Sequence[tuple[str, Sequence[Curve]]], reference: str, points: Sequence[str]
) -> dict[str, dict[str, Any]]:
    """Style of each curve of panels with several, by name."""
    names = dict.fromkeys(name for _, curves in panels if len(curves) > 1 for name, _, _ in curves)
    thin = [name for name in names if name != reference]
    styles: dict[str, dict[str, Any]] = {}
    for i, name in enumerate(thin):
        dashes = _DASHES[i % len(_DASHES)]
        styles[name] = {"color": _THIN[i % len(_THIN)], "linewidth": 1.1, **({"dashes": dashes} if dashes else {})}
    for marker, name in zip(_MARKERS, points, strict=False):
        styles[name] |= {"linestyle": "", "marker": marker, "markersize": 5, "markerfacecolor": "none"}
        styles[name].pop("dashes", None)
    return styles | {reference: {"color": COLORS[5], "linewidth": 3.4}}


def log_panels(
    panels: Sequence[tuple[str, Sequence[Curve]]],
    path: str | Path,
    *,
    xlabel: str,
    ylabel: str,
    order: float | None = None,
    printed: Sequence[Sequence[np.ndarray]] = (),
) -> None:
    """Draw panels (title, curves) with a logarithmic y axis, one below the other, each with its legend beside it;
    values that are not positive and finite leave a gap.

    With `order` it is a convergence plot: both axes are logarithmic, the points are marked, and a dashed line shows
    this slope. `printed` has for each panel and each of its curves the values that a paper prints at the same x, drawn
    as circles.
    """
    _check_panels(panels)
    widest = max(len(name) for _, curves in panels for name, _, _ in curves)
    with figure_at(path, (4.6 + _NAME * widest + 0.5, 0.5 + 2.6 * len(panels))) as figure:
        grid = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for number, (axes, (title, curves)) in enumerate(zip(grid, panels, strict=True)):
            axes.set_yscale("log")
            if order is not None:
                axes.set_xscale("log")
            for name, x, y in curves:
                axes.plot(x, _positive(y), label=name, marker=None if order is None else ".")
            for k, line in enumerate(axes.get_lines() if printed else ()):
                circles = {"color": line.get_color(), "markerfacecolor": "none", "markersize": 7}
                axes.plot(curves[k][1], printed[number][k], "o", **circles, label="" if k else "as printed")
            if order is not None:
                _, x, y = max(curves, key=lambda curve: float(np.nanmax(curve[2])))
                slope = 2 * np.nanmax(y) * (x / np.max(x)) ** order  # beside the largest curve
                axes.plot(x, slope, color="0.4", linestyle="--", linewidth=0.9, label=f"order {order:g}")
                axes.set_xticks(x, [f"{value:.3g}" for value in x])
                axes.minorticks_off()
            else:
                _use_decades(axes, [y for _, _, y in curves], DECADES)
            axes.set(title=title, ylabel=ylabel, xlabel=xlabel if number + 1 == len(panels) else "")
            tidy(axes, margin=order is None)
            axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.02), borderaxespad=0)


def reflection_picture(
    angles: np.ndarray, curves: Sequence[tuple[str, np.ndarray]], title: str, path: str | Path
) -> None:
    """Draw predicted reflection, amplitudes by name, in decibels over the angle of incidence in degrees."""
    if not curves:
        raise InputError("a picture of reflection needs one curve or more")
    shown = [(name, np.where(values > _ROUNDING, values, np.nan)) for name, values in curves]  # zeros leave gaps
    levels = [(name, angles, 20 * np.log10(values)) for name, values in shown]
    lines(levels, path, Frame("angle of incidence (degrees)", "reflection (dB)", title))


def waterfall(
    x: np.ndarray,
    times: np.ndarray,
    values: np.ndarray,
    path: str | Path,
    *,
    xlabel: str,
    ylabel: str,
    backdrop: tuple[str, np.ndarray],
) -> None:
    """Draw a field along a line at many times, of shape (times, x), the latest farthest back; behind it the curve
    `backdrop` (name, values), scaled to the field.
    """
    name, behind = backdrop
    gap, lowest = np.ptp(values[0]) / 4, values.min()  # from one line to the next
    style: dict[str, Any] = {"color": COLORS[0], "linestyle": "-", "linewidth": 0.9}
    with figure_at(path, (5.6, 4.2)) as figure:
        axes = figure.add_subplot()
        base = gap * len(times)
        scaled = base + 0.6 * np.ptp(values[0]) * behind / behind.max()
        axes.fill_between(x, base, scaled, color="0.85", linewidth=0, label=name)
        for number, line in enumerate(values):
            base, depth = gap * number, 2.5 - number / len(times)  # 2.5 is in front of ticks, behind texts
            axes.fill_between(x, lowest - gap, base + line, color="white", linewidth=0, zorder=depth)
            axes.plot(x, base + line, **style, zorder=depth)
        shown = range(0, len(times), max(1, len(times) // 5))
        axes.set_yticks([gap * number for number in shown], [f"{times[number]:g}" for number in shown])
        axes.set(xlabel=xlabel, ylabel="t")
        axes.plot([], [], **style, label=ylabel)
        axes.margins(x=0)
        axes.legend(loc="upper center", ncols=2)
        axes.set_ylim(lowest - gap, 1.1 * axes.get_ylim()[1])

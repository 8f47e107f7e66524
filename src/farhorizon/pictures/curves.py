"""Pictures of curves: error histories, comparisons with papers, reflection over angles, waterfall plots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon.errors import InputError
from farhorizon.pictures.style import COLORS, figure_at

# Largest number of decades of a logarithmic axis below its maximum; double precision resolves 16.
DECADES = 20
_MARKERS = "oxs^v"  # of curves that are drawn as points
_ROUNDING = 1e-13  # relative to the incident wave: smaller reflections are due to rounding


def lines(
    curves: Sequence[tuple[str, np.ndarray, np.ndarray]],
    path: str | Path | None,
    *,
    xlabel: str,
    ylabel: str,
    title: str = "",
    log: bool = False,
    places: Sequence[float] = (),
    limits: tuple[float, float] | None = None,
    decades: int = DECADES,
) -> Any:
    """Draw curves (name, x, y) into one axes, with the legend beside it and thin vertical lines at `places`, and return
    the figure.

    With `log`, the axis reaches at most `decades` decades below the largest value.
    """
    columns = -(-len(curves) // 16)
    widest = max((len(name) for name, _, _ in curves), default=0) if len(curves) > 1 else 0
    with figure_at(path, (4.6 + columns * (0.075 * widest + 0.5 * (widest > 0)), 3.1)) as figure:
        axes = figure.add_subplot()
        for name, x, y in curves:
            axes.plot(x, y, label=name, marker="o" if np.isfinite(y).sum() == 1 else None)
        for place in places:
            axes.axvline(place, color="0.2", linewidth=0.8, linestyle="-")
        if log:
            axes.set_yscale("log")
            top = max(np.nanmax(y, initial=0) for _, _, y in curves)
            axes.set_ylim(bottom=max(axes.get_ylim()[0], top * 10.0**-decades))
        axes.set(xlabel=xlabel, ylabel=ylabel, title=title)
        if limits is not None:
            axes.set_ylim(*limits)
        axes.margins(x=0.01)
        axes.grid(True)
        axes.set_axisbelow(True)
        if len(curves) > 1:
            figure.legend(loc="outside right upper", ncols=columns)
    return figure


def error_history(
    curves: Mapping[str, tuple[np.ndarray, np.ndarray]], path: str | Path, ylabel: str, title: str, *, xlabel: str = "t"
) -> None:
    """Draw errors over time on a logarithmic axis, one line per boundary.

    Where an error is zero the line has a gap. Curves that are zero everywhere, and curves that become infinite, are
    marked in the legend.

    Parameters
    ----------
    curves : mapping of str to (times, errors)
    path : str or Path
        The PNG file.
    ylabel, title, xlabel : str

    Raises
    ------
    InputError
        There are no curves, times and errors do not match, or the directory does not exist.
    """
    if not curves:
        raise InputError("a picture of errors needs one curve or more")
    drawn = []
    for name, (times, errors) in curves.items():
        x, y = np.asarray(times, dtype=float), np.abs(np.asarray(errors, dtype=float))
        if x.ndim != 1 or x.shape != y.shape:
            raise InputError(f"times and errors of {name!r} do not match", value=y.shape, limit=x.shape)
        mark = " (diverges)" if np.isinf(y).any() else " (zero)" if y.size and (y == 0).all() else ""
        drawn.append((name + mark, x, np.where((y > 0) & np.isfinite(y), y, np.nan)))
    log = any(np.isfinite(y).any() for _, _, y in drawn)
    lines(drawn, path, xlabel=xlabel, ylabel=ylabel, title=title, log=log)


def curve_panels(
    panels: Sequence[tuple[str, Sequence[tuple[str, np.ndarray, np.ndarray]]]],
    path: str | Path,
    *,
    xlabel: str | Sequence[str],
    ylabel: str | Sequence[str],
    reference: str | None = None,
    equal: Sequence[int] = (),
    points: Sequence[str] = (),
) -> None:
    """Draw panels of curves for comparison: the reference as a broad pale line, the others as thin lines on top of it.

    Parameters
    ----------
    panels : sequence of (title, curves)
        Curves are (name, x, y); a name has the same style in all panels. A single curve is named at its axis, several
        in a common legend. Values of which no two neighbours are finite are drawn as points.
    path : str or Path
        The PNG file.
    xlabel, ylabel : str or sequence of str
        One label for all panels, or one per panel.
    reference : str, optional
        Name of the curve to which the others are compared; the first one if not given.
    equal : sequence of int
        Panels whose two axes have the same scale, such as those of positions, where angles should be true.
    points : sequence of str
        Names of the curves that are drawn as points, because their few values must not be joined by chords.

    Raises
    ------
    InputError
        There are no panels, a panel has no curves, or the directory does not exist.
    """
    if not panels or not all(curves for _, curves in panels):
        raise InputError("a picture of curves needs one panel or more, each with a curve")
    columns = 1 if len(panels) < 4 else 2
    rows = -(-len(panels) // columns)
    broad = panels[0][1][0][0] if reference is None else reference
    names = [
        name
        for name in dict.fromkeys(name for _, curves in panels if len(curves) > 1 for name, _, _ in curves)
        if name != broad
    ]
    # all different, since the colours cannot be told apart in grey
    dashes: list[dict[str, Any]] = [
        {},
        {"dashes": (3, 3)},
        {"dashes": (8, 2, 1, 2, 1, 2)},
        {"dashes": (6, 2)},
        {"dashes": (6, 2, 1, 2)},
        {"dashes": (1, 3)},
        {"dashes": (1, 1)},
    ]
    colors = [COLORS[i] for i in (1, 6, 2, 3, 0, 4, 1)]
    styles = {
        name: {"color": colors[i % len(colors)], "linewidth": 1.1, **dashes[i % len(dashes)]}
        for i, name in enumerate(names)
    }
    for marker, name in zip(_MARKERS, points, strict=False):
        styles[name] |= {"linestyle": "", "marker": marker, "markersize": 5, "markerfacecolor": "none"}
        styles[name].pop("dashes", None)
    styles[broad] = {"color": COLORS[5], "linewidth": 3.4}
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
            own = "" if shared else ylabel if isinstance(ylabel, str) else ylabel[number]
            below = (xlabel if number >= len(panels) - columns else "") if isinstance(xlabel, str) else xlabel[number]
            axes.set(title=title, xlabel=below, ylabel=curves[0][0] if len(curves) == 1 else own)
            axes.margins(x=0.01)
            if number in equal:
                axes.set_aspect("equal", adjustable="datalim")
            axes.grid(True)
            axes.set_axisbelow(True)
        if shared:
            figure.supylabel(ylabel, fontsize=axes.yaxis.label.get_size())
        if legend:
            # number of entries in a row: 100 characters fit, and the sample of a line takes 7
            fit = max(1, 100 // (max(map(len, legend)) + 7))
            figure.legend(legend.values(), legend.keys(), loc="outside upper center", ncols=min(len(legend), fit, 4))


def log_panels(
    panels: Sequence[tuple[str, Sequence[tuple[str, np.ndarray, np.ndarray]]]],
    path: str | Path,
    *,
    xlabel: str,
    ylabel: str,
    order: float | None = None,
    printed: Sequence[Sequence[np.ndarray]] = (),
) -> None:
    """Draw panels of curves with a logarithmic y axis, one below the other, each with its legend beside it.

    Parameters
    ----------
    panels : sequence of (title, curves)
        Curves are (name, x, y); values that are not positive and finite leave a gap.
    path : str or Path
        The PNG file.
    xlabel, ylabel : str
    order : float, optional
        For a convergence plot: both axes are logarithmic, the points are marked, and a dashed line shows this slope.
    printed : sequence of sequences of ndarray
        For each panel and each of its curves, the values that a paper prints at the same x, drawn as circles.

    Raises
    ------
    InputError
        There are no panels, a panel has no curves, or the directory does not exist.
    """
    if not panels or not all(curves for _, curves in panels):
        raise InputError("a picture of curves needs one panel or more, each with a curve")
    widest = max(len(name) for _, curves in panels for name, _, _ in curves)
    with figure_at(path, (4.6 + 0.075 * widest + 0.5, 0.5 + 2.6 * len(panels))) as figure:
        grid = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for number, (axes, (title, curves)) in enumerate(zip(grid, panels, strict=True)):
            axes.set_yscale("log")
            if order is not None:
                axes.set_xscale("log")
            for name, x, y in curves:
                axes.plot(
                    x, np.where((y > 0) & np.isfinite(y), y, np.nan), label=name, marker=None if order is None else "."
                )
            for k, line in enumerate(axes.get_lines() if printed else ()):
                circles = {
                    "color": line.get_color(),
                    "markerfacecolor": "none",
                    "markersize": 7,
                    "label": "" if k else "as printed",
                }
                axes.plot(curves[k][1], printed[number][k], "o", **circles)
            top = max(np.max(y, where=np.isfinite(y), initial=0) for _, _, y in curves)
            if order is not None:
                _, x, y = max(curves, key=lambda curve: float(np.nanmax(curve[2])))
                axes.plot(
                    x,
                    2 * np.nanmax(y) * (x / np.max(x)) ** order,
                    color="0.4",
                    linestyle="--",
                    linewidth=0.9,
                    label=f"order {order:g}",
                )
                axes.set_xticks(x, [f"{value:.3g}" for value in x])
                axes.minorticks_off()
            else:
                axes.set_ylim(bottom=max(axes.get_ylim()[0], top * 10.0**-DECADES))
                axes.margins(x=0.01)
            axes.set(title=title, ylabel=ylabel, xlabel=xlabel if number + 1 == len(panels) else "")
            axes.grid(True)
            axes.set_axisbelow(True)
            axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.02), borderaxespad=0)


def reflection_picture(
    angles: np.ndarray, curves: Sequence[tuple[str, np.ndarray]], title: str, path: str | Path
) -> None:
    """Draw predicted reflection in decibels over the angle of incidence.

    Parameters
    ----------
    angles : ndarray, shape (n,)
        In degrees.
    curves : sequence of (name, amplitudes of shape (n,))
    title : str
    path : str or Path
        The PNG file.

    Raises
    ------
    InputError
        There are no curves, or the directory does not exist.
    """
    if not curves:
        raise InputError("a picture of reflection needs one curve or more")
    shown = [(name, np.where(values > _ROUNDING, values, np.nan)) for name, values in curves]  # zeros leave gaps
    levels = [(name, angles, 20 * np.log10(values)) for name, values in shown]
    lines(levels, path, xlabel="angle of incidence (degrees)", ylabel="reflection (dB)", title=title)


def waterfall(
    x: np.ndarray,
    times: np.ndarray,
    lines: np.ndarray,
    path: str | Path,
    *,
    xlabel: str,
    ylabel: str,
    backdrop: tuple[str, np.ndarray],
) -> None:
    """Draw a field along a line at many times, the latest farthest back.

    Parameters
    ----------
    x : ndarray, shape (n,)
    times : ndarray, shape (m,)
    lines : ndarray, shape (m, n)
    path : str or Path
        The PNG file.
    xlabel, ylabel : str
    backdrop : (str, ndarray of shape (n,))
        Name and values of a curve that is drawn behind the last line, scaled to the field.

    Raises
    ------
    InputError
        The directory does not exist.
    """
    name, values = backdrop
    gap = np.ptp(lines[0]) / 4  # from one line to the next
    with figure_at(path, (5.6, 4.2)) as figure:
        axes = figure.add_subplot()
        base = gap * len(times)
        axes.fill_between(
            x, base, base + 0.6 * np.ptp(lines[0]) * values / values.max(), color="0.85", linewidth=0, label=name
        )
        for number in range(len(times)):
            base = gap * number
            axes.fill_between(
                x, lines.min() - gap, base + lines[number], color="white", linewidth=0, zorder=2.5 - number / len(times)
            )
            axes.plot(
                x, base + lines[number], color=COLORS[0], linestyle="-", linewidth=0.9, zorder=2.5 - number / len(times)
            )
        shown = range(0, len(times), max(1, len(times) // 5))
        axes.set_yticks([gap * number for number in shown], [f"{times[number]:g}" for number in shown])
        axes.set(xlabel=xlabel, ylabel="t")
        axes.plot([], [], color=COLORS[0], linestyle="-", linewidth=0.9, label=ylabel)
        axes.margins(x=0)
        axes.legend(loc="upper center", ncols=2)
        axes.set_ylim(lines.min() - gap, 1.1 * axes.get_ylim()[1])

"""Pictures of an inversion: maps with sources and receivers, the fall of the misfit, records beside data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from farhorizon.pictures.fields import field_panels
from farhorizon.pictures.panels import Look, Panel
from farhorizon.pictures.style import COLORS, DIVERGING, figure_at, with_unit
from farhorizon.pictures.traces import positions

_MOST_CURVES = 4  # receivers whose records are drawn as curves; more are drawn as images
_MOST_DECADES = 3  # by which a difference is drawn larger: a smaller one is none
_MARKERS = {"sources": ("*", COLORS[1], 7.0), "receivers": ("v", COLORS[6], 3.5)}


def map_picture(
    panel: Panel, axes: Sequence[np.ndarray], places: Mapping[str, np.ndarray], path: str | Path, look: Look
) -> None:
    """Draw a map of a medium, in space its middle, or what has changed in it, with the places of "sources" and
    "receivers", each of shape (n, dim).
    """
    figure = field_panels([panel], axes, None, look)
    drawn, dim = figure.axes[0], len(axes)
    within = drawn.get_xlim(), drawn.get_ylim()
    for name, points in places.items():
        shape, color, size = _MARKERS[name]
        style = {"marker": shape, "color": color, "ms": size, "ls": "none", "label": name, "mec": "white", "mew": 0.4}
        if len(points) and dim == 1:
            drawn.plot(points[:, 0], np.full(len(points), within[1][0]), clip_on=False, **style)
        elif len(points):
            drawn.plot(points[:, 0], points[:, 1], clip_on=False, **style)
    drawn.set(xlim=within[0], ylim=within[1])
    if any(len(points) for points in places.values()):
        figure.legend(loc="outside lower center", ncols=2, fontsize="small")
    figure.set_layout_engine("constrained")
    figure.savefig(path)


def misfit_picture(history: Sequence[tuple[int, int, float]], names: Sequence[str], path: str | Path) -> None:
    """Draw misfits, from (stage, iteration, misfit), relative to the first one of each stage, over the number of
    iterations.
    """
    with figure_at(path, (4.6, 3.1)) as figure:
        panel = figure.add_subplot()
        for stage, name in enumerate(names):
            steps = np.array([step[1:] for step in history if step[0] == stage]).reshape(-1, 2)
            if len(steps):
                panel.plot(steps[:, 0], steps[:, 1] / (steps[0, 1] or 1.0), marker="o", ms=3, label=name)
        if any(step[2] > 0 for step in history):
            panel.set_yscale("log")
        panel.set(xlabel="iteration", ylabel="misfit / misfit of the first run")
        panel.grid(True)
        panel.locator_params(axis="x", integer=True)
        if len(names) > 1:
            panel.legend()


def records_picture(
    points: np.ndarray, times: np.ndarray, data: np.ndarray, records: np.ndarray, path: str | Path, label: str
) -> None:
    """Draw data, the records of a run (rows, n) and their difference, which is drawn larger by a power of ten where it
    is small.
    """
    residual = records - data
    ratio = np.abs(data).max(initial=0) / (np.abs(residual).max(initial=0) or 1.0)
    louder = 10 ** int(np.clip(np.floor(np.log10(max(ratio, 1.0))), 0, _MOST_DECADES))
    shown = {"data": data, "records": records, f"{louder} " * (louder > 1) + "(records - data)": louder * residual}
    many = len(points) > _MOST_CURVES
    with figure_at(path, (9.6, 3.6) if many else (6.4, 1.2 + 1.5 * len(points))) as figure:
        if many:
            name, places = positions(points)
            largest = float(np.abs(data).max()) or 1.0
            colours = {"cmap": DIVERGING, "vmin": -largest, "vmax": largest, "shading": "nearest", "rasterized": True}
            panels = figure.subplots(1, 3, sharex=True, sharey=True)
            for panel, (title, values) in zip(panels, shown.items(), strict=True):
                image = panel.pcolormesh(places, times, values, **colours)
                panel.set(title=title, xlabel=name)
            panels[0].set_ylabel(with_unit("t", "time"))
            panels[0].invert_yaxis()
            figure.colorbar(image, ax=list(panels), label=label)
            return
        panels = figure.subplots(len(points), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        for number, panel in enumerate(panels):
            for title, values in shown.items():
                panel.plot(times, values[:, number], label=title)
            place = ", ".join(f"{coordinate:.4g}" for coordinate in points[number])
            panel.set(ylabel=label, title=with_unit(f"at ({place})"))
            panel.margins(x=0.01)
            panel.grid(True)
        panels[-1].set_xlabel(with_unit("t", "time"))
        panels[0].legend(loc="upper right", fontsize="small")

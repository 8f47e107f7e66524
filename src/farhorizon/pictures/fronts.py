"""Pictures of corrosion fronts: the time at which each node dissolved."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from farhorizon.errors import InputError
from farhorizon.pictures.panels import PLAIN, Axes, Grid, Look, Plane, cell_edges
from farhorizon.pictures.style import COLORS, SEQUENTIAL, figure_at, with_unit


def _around(axis: np.ndarray, nodes: np.ndarray) -> tuple[float, float]:
    """Part of an axis that contains some nodes, with a margin on either side of a tenth of their extent, at least two
    cells; all of it if there are none.
    """
    part = axis[nodes] if nodes.any() else axis
    margin = max(0.1 * np.ptp(part), 2 * (axis[1] - axis[0]))
    return float(max(part[0] - margin, axis[0])), float(min(part[-1] + margin, axis[-1]))


def front(
    dissolved: np.ndarray, axes: Axes, path: str | Path, look: Look = PLAIN, outside: np.ndarray | None = None
) -> None:
    """Draw the dissolution of metal in 2D or on a slice in 3D: the time at which each node became liquid (nan in the
    metal, 0 where there was liquid from the start), fronts at evenly spaced times, and the remaining metal; nodes
    `outside` a window are left blank.
    """
    from matplotlib.colors import ListedColormap

    if len(axes) not in (2, 3) or dissolved.shape != tuple(len(axis) for axis in axes):
        raise InputError(
            "a picture of the front needs a field on two or three axes",
            value=dissolved.shape,
            limit=[len(axis) for axis in axes],
        )
    blank = np.zeros(dissolved.shape, bool) if outside is None else outside
    title, names = "", "xy"
    if len(axes) == 3:
        plane = look.plane or Plane.middle(dissolved.shape)
        title, names = plane.place(axes), plane.names
        dissolved, blank = plane.of(dissolved), plane.of(blank)
        axes, look = plane.within(axes), look.cut(plane)
    metal = np.isnan(dissolved) & ~blank
    last = float(np.nanmax(dissolved, initial=0.0)) or 1.0
    once = metal | (dissolved > 0)  # nodes that were metal
    shown = [_around(axis, once.any(1 - number)) for number, axis in enumerate(axes)]
    grid = Grid.of(1, np.ptp(shown[1]) / np.ptp(shown[0]))
    with figure_at(path, (1.4 * grid.width + 1.5, 1.4 * grid.height + 0.8), "compressed") as figure:
        panel = figure.add_subplot()
        style: dict[str, Any] = {"origin": "lower", "extent": cell_edges(axes), "aspect": "equal"}
        panel.imshow(np.where(metal, 1.0, np.nan).T, cmap=ListedColormap(["0.55"]), **style)
        times = panel.imshow(np.where(dissolved > 0, dissolved, np.nan).T, cmap=SEQUENTIAL, vmin=0, vmax=last, **style)
        late = np.where(metal, 1.25 * last, np.where(once, dissolved, np.nan))  # metal is beyond the last front
        panel.contour(*axes, late.T, levels=np.linspace(0.2, 0.8, 4) * last, colors="white", linewidths=0.6)
        panel.contour(*axes, once.T.astype(float), levels=[0.5], colors="0.1", linewidths=0.8)
        line: dict[str, Any] = {"color": COLORS[1], "linewidth": 1.4, "linestyle": "-"}
        for points in look.cracks:
            panel.plot(points[:, 0], points[:, 1], **line, scalex=False, scaley=False)
        panel.set(xlabel=with_unit(names[0]), ylabel=with_unit(names[1]), title=title, xlim=shown[0], ylim=shown[1])
        figure.colorbar(times, ax=panel, label=with_unit("time of dissolution", "time"))

"""Pictures of corrosion fronts: the time at which each node dissolved."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon.errors import InputError
from farhorizon.pictures.fields import panel_grid
from farhorizon.pictures.images import cell_edges
from farhorizon.pictures.style import figure_at, number_text, with_unit


def _around(axis: np.ndarray, wanted: np.ndarray) -> tuple[float, float]:
    """Part of an axis that contains the wanted nodes, with a margin on either side of a tenth of their extent, at least
    two cells; all of it if there are none.
    """
    found = axis[wanted] if wanted.any() else axis
    more = max(0.1 * np.ptp(found), 2 * (axis[1] - axis[0]))
    return float(max(found[0] - more, axis[0])), float(min(found[-1] + more, axis[-1]))


def front(
    dissolved: np.ndarray,
    axes: Sequence[np.ndarray],
    path: str | Path,
    *,
    outside: np.ndarray | None = None,
    cracks: Any = (),
    plane: tuple[int, int] | None = None,
) -> None:
    """Draw the dissolution of metal: the time at which each node became liquid, fronts at evenly spaced times, and the
    remaining metal.

    Parameters
    ----------
    dissolved : ndarray, shape (nx, ny[, nz])
        `Simulation.fields["dissolved"]`: nan in the metal, 0 where there was liquid from the start. In 3D a slice is
        drawn.
    axes : sequence of ndarray
        Coordinates of the nodes along each axis, two or three.
    path : str or Path
        The PNG file.
    outside : ndarray of bool, optional
        Nodes outside a window, left blank.
    cracks : sequence of ndarray, each of shape (n, dim)
        Polylines, drawn as lines.
    plane : (int, int), optional
        In 3D, the axis normal to the slice, and the index of the slice along it; the middle of z if not given.

    Raises
    ------
    InputError
        The number of axes is not two or three or does not match the field, or the directory does not exist.
    """
    from matplotlib.colors import ListedColormap

    if len(axes) not in (2, 3) or dissolved.shape != tuple(len(axis) for axis in axes):
        raise InputError(
            "a picture of the front needs a field on two or three axes",
            value=dissolved.shape,
            limit=[len(axis) for axis in axes],
        )
    blank = np.zeros(dissolved.shape, bool) if outside is None else outside
    title = ""
    names = "xy"
    if len(axes) == 3:
        normal, index = plane or (2, dissolved.shape[2] // 2)
        dissolved, blank = dissolved.take(index, normal), blank.take(index, normal)
        title = f"{'xyz'[normal]} = {number_text(axes[normal][index], np.ptp(axes[normal]))}"
        names = "xyz".replace("xyz"[normal], "")
        axes = [axis for number, axis in enumerate(axes) if number != normal]
        cracks = [np.delete(points, normal, 1) for points in cracks]
    metal = np.isnan(dissolved) & ~blank
    last = float(np.nanmax(dissolved, initial=0.0)) or 1.0
    once = metal | (dissolved > 0)
    shown = [_around(axis, once.any(1 - number)) for number, axis in enumerate(axes[:2])]
    _, _, width, height = panel_grid(1, np.ptp(shown[1]) / np.ptp(shown[0]))
    with figure_at(path, (1.4 * width + 1.5, 1.4 * height + 0.8), "compressed") as figure:
        panel = figure.add_subplot()
        style: dict[str, Any] = {"origin": "lower", "extent": cell_edges(axes[:2]), "aspect": "equal"}
        panel.imshow(np.where(metal, 1.0, np.nan).T, cmap=ListedColormap(["0.55"]), **style)
        times = panel.imshow(np.where(dissolved > 0, dissolved, np.nan).T, cmap="viridis", vmin=0, vmax=last, **style)
        late = np.where(metal, 1.25 * last, np.where(once, dissolved, np.nan))
        panel.contour(*axes[:2], late.T, levels=np.linspace(0.2, 0.8, 4) * last, colors="white", linewidths=0.6)
        panel.contour(*axes[:2], once.T.astype(float), levels=[0.5], colors="0.1", linewidths=0.8)
        for points in cracks:
            panel.plot(
                points[:, 0], points[:, 1], color="#D55E00", linewidth=1.4, linestyle="-", scalex=False, scaley=False
            )
        panel.set(xlabel=with_unit(names[0]), ylabel=with_unit(names[1]), title=title, xlim=shown[0], ylim=shown[1])
        figure.colorbar(times, ax=panel, label=with_unit("time of dissolution", "time"))

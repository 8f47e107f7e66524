"""Deformed lattices: each node where it has moved to, so that cracks open before one's eyes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon.errors import InputError
from farhorizon.pictures.fields import panel_grid
from farhorizon.pictures.images import cell_edges
from farhorizon.pictures.style import SEQUENTIAL, figure_at, with_unit, wrapped

_TORN = 0.5  # of a spacing: neighbours that move apart by more, as drawn, have edges of their own
_PART = 0.05  # of the extent of the near field that the largest displacement takes, unless a factor is given


def chosen_factor(displacements: Sequence[np.ndarray], length: float) -> float:
    """A round factor (1, 2 or 5 times a power of ten) with which the largest displacement is a twentieth of a length,
    or less.
    """
    top = max(float(np.nanmax(np.hypot(*u), initial=0.0)) for u in displacements)
    if top == 0:
        return 1.0
    wanted = _PART * length / top
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(max(digit for digit in (1, 2, 5) if digit * power <= wanted * (1 + 1e-9)) * power)


def deformed_cells(moves: np.ndarray, axes: Sequence[np.ndarray]) -> np.ndarray:
    """Corners of the cells of displaced nodes, shape (nx, ny, 4, 2), counterclockwise.

    A corner moves by the mean of the nodes around it that move along with the cell's own, so that cells stay together
    where the lattice is whole, and come apart where it is torn.

    Parameters
    ----------
    moves : ndarray, shape (2, nx, ny)
        Displacements as they are drawn; nan where there is no node.
    axes : sequence of ndarray
        Coordinates of the nodes along the two axes.
    """
    shape, half = moves.shape[1:], float(axes[0][1] - axes[0][0]) / 2
    wide = np.pad(moves, ((0, 0), (1, 1), (1, 1)), constant_values=np.nan)
    at = np.stack(np.meshgrid(*axes, indexing="ij"))
    corners = []
    for side in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
        total, count = np.zeros(moves.shape), np.zeros(shape)
        for i, j in ((0, 0), (side[0], 0), (0, side[1]), side):
            other = wide[:, 1 + i : 1 + i + shape[0], 1 + j : 1 + j + shape[1]]
            along = np.hypot(*(other - moves)) <= 2 * half * _TORN
            total += np.where(along, other, 0.0)
            count += along
        corners.append(at + half * np.array(side)[:, None, None] + total / np.maximum(count, 1))
    return np.moveaxis(np.array(corners), (0, 1), (2, 3))


def deformed_panels(
    frames: Sequence[tuple[str, np.ndarray, np.ndarray]],
    axes: Sequence[np.ndarray],
    path: str | Path,
    *,
    factor: float = 0.0,
    label: str = "u",
    title: str = "",
    colors: str = SEQUENTIAL,
) -> Any:
    """Draw lattices with their nodes displaced, side by side, as `deformed_cells`.

    Parameters
    ----------
    frames : sequence of (title, displacements of shape (2, nx, ny), values of shape (nx, ny))
        Nan where there is no node; values give the colours.
    axes : sequence of ndarray
        Coordinates of the nodes along the two axes.
    path : str or Path
        The file, of which the ending of the name is the format.
    factor : float
        Of the displacements; chosen unless positive.
    label, title : str
        Of the colours, and of the whole picture, where the factor stands, too.
    colors : str
        Matplotlib's colour map, from zero.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        There are no frames, or no such directory.
    """
    from matplotlib.collections import PolyCollection

    if not frames:
        raise InputError("the file has no output to draw")
    left, right, bottom, top = cell_edges(axes)
    factor = factor or chosen_factor([u for _, u, _ in frames], max(right - left, top - bottom))
    rows, columns, width, height = panel_grid(len(frames), (top - bottom) / (right - left))
    largest = max(float(np.nanmax(values, initial=0.0)) for *_, values in frames) or 1.0
    size = (columns * (width + 0.15) + 1.5, rows * (height + 0.35) + 0.75)
    with figure_at(path, size, "compressed") as figure:
        panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
        for empty in panels[len(frames) :]:
            empty.remove()
        for panel, (name, u, values) in zip(panels, frames, strict=False):
            there = np.isfinite(u).all(0)
            # smoothed edges would leave seams between cells
            nodes = PolyCollection(list(deformed_cells(factor * u, axes)[there]), edgecolors="none", antialiaseds=False)
            nodes.set(array=values[there], cmap=colors, clim=(0.0, largest))
            nodes.set_rasterized(True)
            panel.add_collection(nodes)
            panel.set(title=wrapped(name, width), aspect="equal", xlim=(left, right), ylim=(bottom, top))
            panel.locator_params(nbins=4 if width < 2 else 6)
        margin = factor * max(float(np.nanmax(np.abs(u), initial=0.0)) for _, u, _ in frames)
        panels[0].set(xlim=(left - margin, right + margin), ylim=(bottom - margin, top + margin))
        for number, panel in enumerate(panels[: len(frames)]):
            panel.set(
                xlabel=with_unit("x") if number + columns >= len(frames) else "",
                ylabel=with_unit("y") if number % columns == 0 else "",
            )
        figure.colorbar(nodes, ax=list(panels[: len(frames)]), label=label, pad=0.02)
        whole = "; ".join(filter(None, (f"displacements times {factor:g}", title)))
        figure.suptitle(wrapped(whole, size[0]), fontsize=panels[0].title.get_size())
    return figure

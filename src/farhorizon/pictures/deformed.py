"""Pictures of deformed lattices, with each node at its displaced position, which shows how cracks open."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon.errors import InputError
from farhorizon.pictures.fields import panel_grid
from farhorizon.pictures.images import cell_edges
from farhorizon.pictures.style import SEQUENTIAL, figure_at, with_unit, wrapped

_TORN = 0.5  # of a spacing: neighbours whose drawn displacements differ by more share no corners
_PART = 0.05  # largest drawn displacement over the extent of the near field, unless a factor is given


def chosen_factor(displacements: Sequence[np.ndarray], length: float) -> float:
    """Largest round factor (1, 2 or 5 times a power of ten) for which the largest displacement is at most a twentieth
    of a length.
    """
    top = max(float(np.nanmax(np.hypot(*u), initial=0.0)) for u in displacements)
    if top == 0:
        return 1.0
    wanted = _PART * length / top
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(max(digit for digit in (1, 2, 5) if digit * power <= wanted * (1 + 1e-9)) * power)


def deformed_cells(moves: np.ndarray, axes: Sequence[np.ndarray]) -> np.ndarray:
    """Corners of the cells of displaced nodes, shape (nx, ny, 4, 2), counterclockwise.

    A corner is displaced by the mean over those of its neighbouring nodes that move along with the node of the cell, so
    that cells stay together where the lattice is intact and separate where it is torn.

    Parameters
    ----------
    moves : ndarray, shape (2, nx, ny)
        Displacements as drawn, multiplied by the factor; nan where there is no node.
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
    """Draw lattices with displaced nodes side by side, as the cells of `deformed_cells`.

    Parameters
    ----------
    frames : sequence of (title, displacements of shape (2, nx, ny), values of shape (nx, ny))
        Nan where there is no node; the values determine the colours.
    axes : sequence of ndarray
        Coordinates of the nodes along the two axes.
    path : str or Path
        File name, whose ending determines the format.
    factor : float
        Factor of the displacements; 0 chooses it (`chosen_factor`).
    label, title : str
        Label of the colours, and title of the whole picture, which also states the factor.
    colors : str
        Colour map of Matplotlib, starting at zero.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        There are no frames, or the directory does not exist.
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
            # antialiased edges would leave seams between cells
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

"""Deformed lattices: each node where it has moved to, so that cracks open before one's eyes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from farhorizon.errors import InputError
from farhorizon.pictures.fields import panel_grid
from farhorizon.pictures.images import cell_edges
from farhorizon.pictures.style import DAMAGE, SEQUENTIAL, figure_at, with_unit

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


def deformed_panels(
    frames: Sequence[tuple[str, np.ndarray, str, np.ndarray]],
    axes: Sequence[np.ndarray],
    path: str | Path,
    *,
    factor: float = 0.0,
) -> None:
    """Draw lattices with their nodes displaced, side by side: each node is a square of the size of its cell.

    Parameters
    ----------
    frames : sequence of (title, displacements of shape (2, nx, ny), name of the colours, values of shape (nx, ny))
        Nan where there is no node.
    axes : sequence of ndarray
        Coordinates of the nodes along the two axes.
    path : str or Path
        The file, of which the ending of the name is the format.
    factor : float
        Of the displacements; chosen unless positive.

    Raises
    ------
    InputError
        There are no frames, or no such directory.
    """
    from matplotlib.collections import PolyCollection

    if not frames:
        raise InputError("the file has no output to draw")
    left, right, bottom, top = cell_edges(axes)
    factor = factor or chosen_factor([u for _, u, _, _ in frames], max(right - left, top - bottom))
    rows, columns, width, height = panel_grid(len(frames), (top - bottom) / (right - left))
    label = frames[0][2]
    largest = max(float(np.nanmax(values, initial=0.0)) for *_, values in frames) or 1.0
    half = float(axes[0][1] - axes[0][0]) / 2
    corners = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    at = np.stack(np.meshgrid(*axes, indexing="ij"))
    size = (columns * (width + 0.15) + 1.5, rows * (height + 0.35) + 0.75)
    with figure_at(path, size, "compressed") as figure:
        panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
        for empty in panels[len(frames) :]:
            empty.remove()
        for panel, (title, u, _, values) in zip(panels, frames, strict=False):
            there = np.isfinite(u).all(0)
            centres = (at + factor * u)[:, there].T
            # no seams between cells in vector formats: edges have the colour of the face
            nodes = PolyCollection(list(centres[:, None] + corners), edgecolors="face", linewidths=0.1)
            nodes.set(array=values[there], cmap=DAMAGE if label == "damage" else SEQUENTIAL, clim=(0.0, largest))
            nodes.set_rasterized(True)
            panel.add_collection(nodes)
            panel.set(title=title, aspect="equal", xlim=(left, right), ylim=(bottom, top))
            panel.locator_params(nbins=4 if width < 2 else 6)
        margin = factor * max(float(np.nanmax(np.abs(u), initial=0.0)) for _, u, _, _ in frames)
        panels[0].set(xlim=(left - margin, right + margin), ylim=(bottom - margin, top + margin))
        for number, panel in enumerate(panels[: len(frames)]):
            panel.set(
                xlabel=with_unit("x") if number + columns >= len(frames) else "",
                ylabel=with_unit("y") if number % columns == 0 else "",
            )
        figure.colorbar(nodes, ax=list(panels[: len(frames)]), label=label, pad=0.02)
        figure.suptitle(f"displacements times {factor:g}", fontsize=panels[0].title.get_size())

"""Pictures of deformed lattices, with each node at its displaced position, which shows how cracks open."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from farhorizon.errors import InputError
from farhorizon.pictures.panels import PLAIN, Axes, File, Grid, Look, Panel, add_title, cell_edges, heads_of
from farhorizon.pictures.style import SEQUENTIAL, figure_at
from farhorizon.rounding import MARGIN

_TORN = 0.5  # of a spacing: neighbours whose drawn displacements differ by more share no corners
_PART = 0.05  # largest drawn displacement over the extent of the near field, unless a factor is given


def chosen_factor(displacements: Sequence[np.ndarray], length: float) -> float:
    """Largest round factor (1, 2 or 5 times a power of ten) for which the largest displacement is at most a twentieth
    of a length.
    """
    top = max(float(np.nanmax(np.hypot(*u), initial=0.0)) for u in displacements)
    if top == 0:
        return 1.0
    most = _PART * length / top
    power = 10.0 ** np.floor(np.log10(most))
    return float(max(digit for digit in (1, 2, 5) if digit * power <= most * (1 + MARGIN)) * power)


def deformed_cells(moves: np.ndarray, axes: Axes) -> np.ndarray:
    """Corners of the cells of nodes displaced by `moves` (2, nx, ny), nan where there is no node; shape (nx, ny, 4, 2),
    counterclockwise.

    A corner is displaced by the mean over those of its neighbouring nodes that move along with the node of the cell, so
    that cells stay together where the lattice is intact and separate where it is torn.
    """
    shape, half = moves.shape[1:], float(axes[0][1] - axes[0][0]) / 2
    padded = np.pad(moves, ((0, 0), (1, 1), (1, 1)), constant_values=np.nan)
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"))
    corners = []
    for side in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
        total, count = np.zeros(moves.shape), np.zeros(shape)
        for i, j in ((0, 0), (side[0], 0), (0, side[1]), side):
            neighbour = padded[:, 1 + i : 1 + i + shape[0], 1 + j : 1 + j + shape[1]]
            together = np.hypot(*(neighbour - moves)) <= 2 * half * _TORN
            total += np.where(together, neighbour, 0.0)
            count += together
        corners.append(nodes + half * np.array(side)[:, None, None] + total / np.maximum(count, 1))
    return np.moveaxis(np.array(corners), (0, 1), (2, 3))


def deformed_panels(panels: Sequence[Panel], axes: Axes, path: File, look: Look = PLAIN, factor: float = 0) -> Any:
    """Draw lattices whose nodes have the displacements `moves`, times a factor that the title states, side by side as
    the cells of `deformed_cells`, and return the figure; without a factor a round one is chosen.
    """
    from matplotlib.collections import PolyCollection

    if not panels:
        raise InputError("the file has no output to draw")
    moves = [np.asarray(panel.moves) for panel in panels]
    left, right, bottom, top = cell_edges(axes)
    factor = factor or chosen_factor(moves, max(right - left, top - bottom))
    grid = Grid.of(len(panels), (top - bottom) / (right - left))
    largest = max(float(np.nanmax(panel.values, initial=0.0)) for panel in panels) or 1.0
    heads, above = heads_of([panel.title for panel in panels], grid.width)
    size = (grid.columns * (grid.width + 0.15) + 1.5, grid.rows * (grid.height + 0.35 + above) + 0.75)
    margin = factor * max(float(np.nanmax(np.abs(u), initial=0.0)) for u in moves)
    with figure_at(path, size, "compressed") as figure:
        places = grid.places(figure, len(panels))
        for place, panel, u, head in zip(places, panels, moves, heads, strict=True):
            exists = np.isfinite(u).all(0)
            # antialiased edges would leave seams between cells
            cells = list(deformed_cells(factor * u, axes)[exists])
            drawn = PolyCollection(cells, edgecolors="none", antialiaseds=False)
            drawn.set(array=panel.values[exists], cmap=look.colors or SEQUENTIAL, clim=(0.0, largest))
            drawn.set_rasterized(True)
            place.add_collection(drawn)
            place.set(title=head, aspect="equal")
        places[0].set(xlim=(left - margin, right + margin), ylim=(bottom - margin, top + margin))
        figure.colorbar(drawn, ax=places, label=look.label, pad=0.02)
        title = "; ".join(filter(None, (f"displacements times {factor:g}", look.title)))
        add_title(figure, title, size[0])
    return figure

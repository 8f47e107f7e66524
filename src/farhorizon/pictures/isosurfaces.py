"""Pictures of the surfaces on which a 3D field has given values.

The surfaces are computed by marching cubes [1]_ from scikit-image. Matplotlib draws them, as it does all other
pictures, so that neither a screen nor OpenGL is needed.

References
----------
.. [1] T. Lewiner, H. Lopes, A. W. Vieira, G. Tavares, Efficient implementation of marching cubes' cases with
   topological guarantees, Journal of Graphics Tools 8, 1-15 (2003)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from farhorizon.errors import InputError
from farhorizon.pictures.panels import PLAIN, Axes, File, Look, Panel, comparable
from farhorizon.pictures.style import color_range, figure_at, with_unit, wrapped

LEVELS = (0.2, 0.5)  # default levels over the largest magnitude, on both sides of zero
_FINEST = 80  # cells along an axis; finer fields are thinned
_LIGHT = np.array([0.35, -0.6, 0.72])  # direction of the light: from above, the front and the right
_ALPHA = 0.55  # surfaces behind others remain visible
_WIDTH = 3.6  # inches of a panel
_SLACK = 1e-6  # of a cell: tolerance for single precision


def chosen_levels(fields: Sequence[np.ndarray]) -> list[float]:
    """Default levels for several fields, on both sides of zero if there are negative values, otherwise above it."""
    top = max(float(np.nanmax(np.abs(field), initial=0.0)) for field in fields)
    low = min(float(np.nanmin(field, initial=0.0)) for field in fields)
    above = [level * top for level in LEVELS]
    return ([-level for level in reversed(above)] if low < -LEVELS[0] * top else []) + above


def isosurface(field: np.ndarray, axes: Axes, level: float) -> np.ndarray:
    """Triangles of the surface on which a 3D field (nan outside a window) has the value `level`, shape (n, 3, 3); empty
    if it has it nowhere.
    """
    try:
        from skimage.measure import marching_cubes
    except ImportError:
        remedy = "pip install 'farhorizon[space]'"
        raise InputError("scikit-image is not installed", key="--isosurfaces", remedy=remedy) from None
    exists = np.isfinite(field)
    inside = field[exists]
    if min(field.shape) < 2 or not inside.size or not inside.min() < level < inside.max():
        return np.zeros((0, 3, 3))
    step = max(1, max(field.shape) // _FINEST)
    corners, faces, *_ = marching_cubes(np.where(exists, field, level - 1.0), level, step_size=step)
    last = np.array(field.shape) - 1
    # a corner lies on an edge between two nodes, both of which must exist
    before, behind = np.floor(corners / step + _SLACK), np.ceil(corners / step - _SLACK)
    lower, upper = (exists[tuple(np.clip(step * end, 0, last).astype(int).T)] for end in (before, behind))
    first, spacing = np.array([axis[0] for axis in axes]), np.array([axis[1] - axis[0] for axis in axes])
    return np.asarray(first + spacing * corners)[faces[(lower & upper)[faces].all(1)]]


def isosurface_panels(
    panels: Sequence[Panel], axes: Axes, path: File, look: Look = PLAIN, levels: Sequence[float] | None = None
) -> Any:
    """Draw the isosurfaces of 3D fields side by side, with one colour per value and the rims of cracks as lines, and
    return the figure; InputError where no field has one of the levels.

    Levels are by default a fifth and a half of the largest magnitude, on both sides of zero: of that of all fields or,
    where these are not `comparable`, of that of each field, whose title then states its levels.
    """
    from matplotlib import colormaps
    from matplotlib.patches import Patch

    arrays = [np.asarray(panel.values, float) for panel in panels]
    if len(axes) != 3:
        raise InputError("only a field in 3D has isosurfaces", value=f"{len(axes)}D", limit="3D", key="--isosurfaces")
    relative = levels is None and not comparable(arrays)
    tops = [float(np.nanmax(np.abs(values), initial=0.0)) if relative else 1.0 for values in arrays]
    arrays = [values / (top or 1.0) for values, top in zip(arrays, tops, strict=True)]
    drawn = sorted(chosen_levels(arrays) if levels is None else levels)
    surfaces = [{level: isosurface(values, axes, level) for level in drawn} for values in arrays]
    _check_seen(levels or (), surfaces, arrays)
    scale, largest = color_range(arrays), max(map(abs, drawn)) or 1.0
    low = -largest if scale["vmin"] < 0 else 0.0
    colors = {level: np.array(colormaps[scale["cmap"]]((level - low) / (largest - low))) for level in drawn}
    size = (_WIDTH * len(panels), 4.0 + 0.3 * bool(look.title) + 0.3 * relative)
    with figure_at(path, size) as figure:
        for number, (panel, some, top) in enumerate(zip(panels, surfaces, tops, strict=True)):
            place = figure.add_subplot(1, len(panels), number + 1, projection="3d")
            _draw(place, some, axes, colors, look.cracks)
            seen = ", ".join(f"{level * top:.3g}" for level, triangles in some.items() if relative and len(triangles))
            head = [line for line in (panel.title, seen and f"surfaces at {seen}") if line]
            # the layout ignores what is above a 3D box
            place.set_title("\n".join(wrapped(line, _WIDTH - 0.2) for line in head), y=0.96)
        named = [level for level in drawn if any(len(some[level]) for some in surfaces)] or drawn
        name = "" if relative else f"{look.label} = "
        figure.legend(
            handles=[Patch(color=tuple(colors[level][:3]), label=f"{name}{level:.3g}") for level in named],
            loc="outside lower center",
            ncols=len(named),
            title=f"{look.label} over the largest magnitude of its panel" if relative else None,
        )
        if look.title:
            figure.suptitle(wrapped(look.title, size[0]))
    return figure


def _check_seen(levels: Sequence[float], surfaces: Sequence[Any], arrays: Sequence[np.ndarray]) -> None:
    """Raise InputError for levels that no field has."""
    for level in levels:
        if not any(len(some[level]) for some in surfaces):
            low, high = (float(end([end(a[np.isfinite(a)]) for a in arrays])) for end in (np.min, np.max))
            limit = f"between {low:.4g} and {high:.4g}"
            raise InputError("the field has this value nowhere", value=level, limit=limit, key="--isosurfaces")


def _draw(place: Any, surfaces: Any, axes: Axes, colors: Any, cracks: Sequence[np.ndarray]) -> None:
    """Draw all surfaces as one collection, because Matplotlib sorts triangles by depth only within a collection."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    shown = [(level, triangles) for level, triangles in surfaces.items() if len(triangles)]
    if shown:
        triangles = np.concatenate([some for _, some in shown])
        painted = np.concatenate([np.tile(colors[level], (len(some), 1)) for level, some in shown])
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        lengths = np.linalg.norm(normals, axis=1)
        lit = np.abs(normals @ _LIGHT) / np.where(lengths > 0, lengths, np.inf)  # lit from both sides
        painted[:, :3] *= (0.55 + 0.45 * lit)[:, None]
        painted[:, 3] = _ALPHA
        place.add_collection3d(Poly3DCollection(triangles, facecolors=painted, edgecolors="none"))
    for line in cracks:
        place.plot(*line.T, color="0.1", linewidth=1.0, linestyle="-")
    ends = [(float(axis[0]), float(axis[-1])) for axis in axes]
    place.set(**{f"{name}lim": limits for name, limits in zip("xyz", ends, strict=True)})
    place.set_box_aspect([high - low for low, high in ends], zoom=0.85)  # room for the labels
    place.set(**{f"{name}label": with_unit(name) for name in "xyz"})
    place.locator_params(nbins=4)

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
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon.errors import InputError
from farhorizon.pictures.fields import comparable
from farhorizon.pictures.style import color_range, figure_at, with_unit, wrapped

SHARES = (0.2, 0.5)  # default levels over the largest magnitude, on both sides of zero
_FINEST = 80  # cells along an axis; finer fields are thinned
_LIGHT = np.array([0.35, -0.6, 0.72])
_ALPHA = 0.55
_SLACK = 1e-6  # of a cell: tolerance for single precision


def chosen_levels(fields: Sequence[np.ndarray]) -> list[float]:
    """Default levels for several fields, on both sides of zero if there are negative values, otherwise above it."""
    top = max(float(np.nanmax(np.abs(field), initial=0.0)) for field in fields)
    low = min(float(np.nanmin(field, initial=0.0)) for field in fields)
    above = [share * top for share in SHARES]
    return ([-level for level in reversed(above)] if low < -SHARES[0] * top else []) + above


def isosurface(field: np.ndarray, axes: Sequence[np.ndarray], level: float) -> np.ndarray:
    """Triangles of the surface on which a field has the value `level`, shape (n, 3, 3); empty if it has it nowhere.

    Parameters
    ----------
    field : ndarray, shape (nx, ny, nz)
        Values; nan outside a window.
    axes : sequence of ndarray
        Evenly spaced coordinates of the nodes along each axis.
    level : float

    Raises
    ------
    InputError
        scikit-image is not installed.
    """
    try:
        from skimage.measure import marching_cubes
    except ImportError:
        remedy = "pip install 'farhorizon[space]'"
        raise InputError("scikit-image is not installed", key="--isosurfaces", remedy=remedy) from None
    there = np.isfinite(field)
    inside = field[there]
    if min(field.shape) < 2 or not inside.size or not inside.min() < level < inside.max():
        return np.zeros((0, 3, 3))
    step = max(1, max(field.shape) // _FINEST)
    corners, faces, *_ = marching_cubes(np.where(there, field, level - 1.0), level, step_size=step)
    last = np.array(field.shape) - 1
    # a corner lies on an edge between two nodes, both of which must exist
    before, behind = np.floor(corners / step + _SLACK), np.ceil(corners / step - _SLACK)
    one, other = (there[tuple(np.clip(step * end, 0, last).astype(int).T)] for end in (before, behind))
    first, spacing = np.array([axis[0] for axis in axes]), np.array([axis[1] - axis[0] for axis in axes])
    return np.asarray(first + spacing * corners)[faces[(one & other)[faces].all(1)]]


def isosurface_panels(
    fields: Sequence[tuple[str, np.ndarray]],
    axes: Sequence[np.ndarray],
    path: str | Path | None,
    *,
    levels: Sequence[float] | None = None,
    cracks: Sequence[np.ndarray] = (),
    label: str = "u",
    title: str = "",
) -> Any:
    """Draw the isosurfaces of 3D fields side by side, with one colour per value.

    Parameters
    ----------
    fields : sequence of (title, ndarray)
        Fields of shape (nx, ny, nz).
    axes : sequence of ndarray
        Coordinates of the nodes along each axis.
    path : str or Path, optional
        File name, whose ending determines the format; if not given, nothing is written.
    levels : sequence of float, optional
        If not given, a fifth and a half of the largest magnitude, on both sides of zero: of that of all fields or,
        where these are not `comparable`, of that of each field, whose title then states its levels.
    cracks : sequence of ndarray, each of shape (n, 3)
        Rims of cracks, drawn as lines.
    label, title : str
        Name of the quantity, and title of the whole picture.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        The fields are not 3D, none of them has one of the levels, or scikit-image is not installed.
    """
    from matplotlib import colormaps
    from matplotlib.patches import Patch

    arrays = [np.asarray(values, float) for _, values in fields]
    if len(axes) != 3:
        raise InputError("only a field in 3D has isosurfaces", value=f"{len(axes)}D", limit="3D", key="--isosurfaces")
    own = levels is None and not comparable(arrays)
    tops = [float(np.nanmax(np.abs(values), initial=0.0)) if own else 1.0 for values in arrays]
    arrays = [values / (top or 1.0) for values, top in zip(arrays, tops, strict=True)]
    wanted = sorted(chosen_levels(arrays) if levels is None else levels)
    found = [{level: isosurface(values, axes, level) for level in wanted} for values in arrays]
    _check_seen(levels or (), found, arrays)
    scale, largest = color_range(arrays), max(map(abs, wanted)) or 1.0
    low = -largest if scale["vmin"] < 0 else 0.0
    colors = {level: np.array(colormaps[scale["cmap"]]((level - low) / (largest - low))) for level in wanted}
    with figure_at(path, (3.6 * len(fields), 4.0 + 0.3 * bool(title) + 0.3 * own)) as figure:
        for number, ((name, _), surfaces, top) in enumerate(zip(fields, found, tops, strict=True)):
            panel = figure.add_subplot(1, len(fields), number + 1, projection="3d")
            _draw(panel, surfaces, axes, colors, cracks)
            seen = ", ".join(f"{level * top:.3g}" for level, triangles in surfaces.items() if own and len(triangles))
            head = "\n".join(wrapped(line, 3.4) for line in (name, seen and f"surfaces at {seen}") if line)
            panel.set_title(head, y=0.96)  # the layout ignores what is above a 3D box
        called = "" if own else f"{label} = "
        there = [level for level in wanted if any(len(some[level]) for some in found)] or wanted
        figure.legend(
            handles=[Patch(color=tuple(colors[level][:3]), label=f"{called}{level:.3g}") for level in there],
            loc="outside lower center",
            ncols=len(there),
            title=f"{label} over the largest magnitude of its panel" if own else None,
        )
        if title:
            figure.suptitle(wrapped(title, 3.6 * len(fields)))
    return figure


def _check_seen(levels: Sequence[float], found: Sequence[Any], arrays: Sequence[np.ndarray]) -> None:
    """Raise InputError for levels that no field has."""
    for level in levels:
        if not any(len(some[level]) for some in found):
            low, high = (float(end([end(one[np.isfinite(one)]) for one in arrays])) for end in (np.min, np.max))
            limit = f"between {low:.4g} and {high:.4g}"
            raise InputError("the field has this value nowhere", value=level, limit=limit, key="--isosurfaces")


def _draw(panel: Any, surfaces: Any, axes: Sequence[np.ndarray], colors: Any, cracks: Sequence[np.ndarray]) -> None:
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
        panel.add_collection3d(Poly3DCollection(triangles, facecolors=painted, edgecolors="none"))
    for line in cracks:
        panel.plot(*line.T, color="0.1", linewidth=1.0, linestyle="-")
    ends = [(float(axis[0]), float(axis[-1])) for axis in axes]
    panel.set(**{f"{name}lim": limits for name, limits in zip("xyz", ends, strict=True)})
    panel.set_box_aspect([high - low for low, high in ends], zoom=0.85)
    panel.set(**{f"{name}label": with_unit(name) for name in "xyz"})
    panel.locator_params(nbins=4)

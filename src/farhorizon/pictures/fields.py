"""Pictures of fields as images side by side, with cracks, solids and arrows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon.errors import InputError
from farhorizon.files.region_numbers import Regions
from farhorizon.pictures.curves import lines
from farhorizon.pictures.images import Overlay, cell_edges, image_of, unhidden
from farhorizon.pictures.style import (
    DIVERGING,
    color_range,
    extent_beyond,
    figure_at,
    number_text,
    scale_of,
    with_unit,
    wrapped,
)

_ARROWS = 18  # number of arrows along an axis
_LINE = 0.16  # height in inches of a line of a title
_ROOM = 5.0  # largest value on the colour scale of `field_table` over that of the first column
_SHARED = 0.2  # panels whose largest values differ by more than this factor have colour scales of their own


def panel_grid(number: int, ratio: float, bars: bool = False) -> tuple[int, int, float, float]:
    """Rows, columns, and panel width and height in inches, for `number` panels with height / width = `ratio`.

    With `bars`, each panel has a colour bar.
    """
    four = 2 if ratio < 0.6 or (bars and number == 4) else 4  # with bars a row of four is too long
    most = 1 if ratio < 0.35 else 3 if number in (3, 5, 6, 9) else four  # leaves few places empty
    columns = min(number, most)
    width = min(5.5 / columns + 0.8, 3.4)
    if ratio < 0.35:
        width = 5.5
    height = min(max(width * ratio, 0.55), 4.5)
    return -(-number // columns), columns, max(min(width, height / ratio), 1.3), height


def field_panels(
    fields: Sequence[tuple[str, np.ndarray]],
    axes: Sequence[np.ndarray],
    path: str | Path | None,
    *,
    shared_scale: bool = True,
    cracks: Sequence[np.ndarray] = (),
    label: str = "u",
    solids: Sequence[np.ndarray] = (),
    colors: str | None = None,
    plane: tuple[int, int] | None = None,
    limits: tuple[float, float] | None = None,
    title: str = "",
    smooth: bool = False,
    broken: Sequence[np.ndarray] = (),
    regions: Regions | None = None,
    beyond: str | None = None,
) -> Any:
    """Draw fields side by side: as lines in common axes in 1D, as images in 2D, as slices in 3D.

    Parameters
    ----------
    fields : sequence of (title, ndarray)
        Fields of the lattice shape (nx[, ny[, nz]]); nan (outside a window) stays blank.
    axes : sequence of ndarray
        Coordinates of the nodes along each axis.
    path : str or Path, optional
        File name, whose ending determines the format; if not given, nothing is written.
    shared_scale : bool
        Use one colour scale for all panels, with one colour bar; otherwise each panel has its own. Ignored in 1D.
    cracks : sequence of ndarray, each of shape (n, dim)
        Polylines, drawn as thin dark lines; in 3D their projection onto the slice.
    label : str
        Name of the quantity.
    solids : sequence of ndarray of bool
        Solid nodes of each field; their outline is drawn like cracks. Ignored in 1D.
    colors : str, optional
        Colour map of Matplotlib, starting at zero; if not given, a diverging or sequential one, depending on the
        values. Ignored in 1D.
    plane : (int, int), optional
        In 3D, the axis normal to the slice, and the index of the slice along it; the middle of z if not given.
    limits : (float, float), optional
        Limits of the colour scale, in 1D of the axis of values.
    title : str
        Title of the whole picture.
    smooth : bool
        Interpolate linearly between the nodes of a coarse lattice, with at most 100 nodes along an axis. Ignored in 1D.
    broken : sequence of ndarray
        For each field, the fraction of broken bonds at each node, drawn over it in dark. Ignored in 1D.
    regions : Regions, optional
        Regions of the nodes: their outlines are drawn, with the names of materials in the first panel. Ignored in 1D.
    beyond : {"neither", "min", "max", "both"}, optional
        Ends at which a common colour bar has an arrow; if not given, those beyond which there are values. Ignored in
        1D.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        There are no fields, shapes do not match, or the directory does not exist.
    """
    coordinates = [np.asarray(axis, dtype=float) for axis in axes]
    shape, dim = tuple(axis.size for axis in coordinates), len(coordinates)
    if not fields or dim not in (1, 2, 3):
        raise InputError(
            "a picture needs one field or more on one to three axes", value=f"{len(fields)} fields, {dim} axes"
        )
    arrays = [np.asarray(field, dtype=float) for _, field in fields]
    titles = [title for title, _ in fields]
    for name, array in zip(titles, arrays, strict=True):
        if array.shape != shape:
            raise InputError(f"field {name!r} does not match the axes", value=array.shape, limit=shape)
    polylines = [np.asarray(points, dtype=float) for points in cracks]
    for points in polylines:
        if points.ndim != 2 or points.shape[1] != dim:
            raise InputError("a crack is an array of points", value=points.shape, limit=f"(n, {dim})")
    if dim == 1:
        curves = [(name, coordinates[0], array) for name, array in zip(titles, arrays, strict=True)]
        return lines(
            curves,
            path,
            xlabel=with_unit("x"),
            ylabel=label,
            title=", ".join(filter(None, (title, titles[0] if len(titles) == 1 else ""))),
            places=[x for points in polylines for x in points[:, 0]],
            limits=limits,
        )
    overlays = _overlays(len(fields), polylines, solids, broken, regions, smooth)
    names = "xy"
    if dim == 3:
        normal, index = shown_plane(shape, plane)
        names = "xyz".replace("xyz"[normal], "")
        place = f"{'xyz'[normal]} = {number_text(coordinates[normal][index], np.ptp(coordinates[normal]))}"
        arrays = [array.take(index, normal) for array in arrays]
        overlays = [overlay.cut(normal, index) for overlay in overlays]
        coordinates = [axis for number, axis in enumerate(coordinates) if number != normal]
        title = ", ".join(filter(None, (title, place)))
    return _images(
        arrays,
        titles,
        coordinates,
        path,
        overlays,
        shared_scale=shared_scale,
        label=label,
        colors=colors,
        names=names,
        limits=limits,
        title=title,
        beyond=beyond,
    )


def shown_plane(shape: Sequence[int], plane: tuple[int, int] | None) -> tuple[int, int]:
    """Axis and index of the slice of a 3D lattice that is drawn; the middle of z if not given."""
    return plane or (2, shape[2] // 2)


def _overlays(
    count: int,
    cracks: Sequence[np.ndarray],
    solids: Sequence[np.ndarray],
    broken: Sequence[np.ndarray],
    regions: Regions | None,
    smooth: bool,
) -> list[Overlay]:
    """Overlays of several fields; only the first one has names."""
    return [
        Overlay(cracks, solids[k] if solids else None, broken[k] if broken else None, regions, k == 0, smooth)
        for k in range(count)
    ]


def slice_panels(
    fields: Sequence[tuple[str, np.ndarray]],
    axes: Sequence[np.ndarray],
    path: str | Path | None,
    *,
    shared_scale: bool = True,
    cracks: Sequence[np.ndarray] = (),
    label: str = "u",
    colors: str | None = None,
    limits: tuple[float, float] | None = None,
    title: str = "",
    smooth: bool = False,
    broken: Sequence[np.ndarray] = (),
    regions: Regions | None = None,
) -> Any:
    """Draw fields in 3D on the three planes through the middle, with one row per field.

    Parameters
    ----------
    fields, axes, path, shared_scale, cracks, label, colors, limits, title, smooth, broken, regions
        As in `field_panels`; cracks are projected onto the slices.

    Returns
    -------
    matplotlib.figure.Figure
    """
    planes = [(axis, line.size // 2) for axis, line in enumerate(axes)]
    sides = [[line for number, line in enumerate(axes) if number != normal] for normal, _ in planes]
    sizes = [np.ptp(edges[:2]) / np.ptp(edges[2:]) for edges in map(np.array, map(cell_edges, sides))]
    height = min(2.1, 8.0 / sum(sizes))
    places = [number_text(axes[axis][index], float(np.ptp(axes[axis]))) for axis, index in planes]
    heads = [
        [
            wrapped(", ".join(filter(None, (name, f"{'xyz'[axis]} = {place}"))), height * wide)
            for (axis, _), place, wide in zip(planes, places, sizes, strict=True)
        ]
        for name, _ in fields
    ]
    above = _LINE * max(head.count("\n") for row in heads for head in row)
    size = (height * sum(sizes) + 2.2, len(fields) * (height + 0.3 + above) + 0.5 + 0.3 * bool(title))
    with figure_at(path, size, "compressed") as figure:
        panels = figure.subplots(len(fields), 3, squeeze=False, width_ratios=sizes)
        arrays = [np.asarray(field, float) for _, field in fields]
        overlays = _overlays(len(fields), [np.asarray(points, float) for points in cracks], (), broken, regions, smooth)
        seen = [unhidden(array, overlay.broken) for array, overlay in zip(arrays, overlays, strict=True)]
        signed = any(color_range([array])["cmap"] == DIVERGING for array in seen)
        for row, array in enumerate(arrays):
            alike = seen if shared_scale else [seen[row]]
            scale = scale_of(alike, limits, colors, signed, usual=True)
            for panel, head, (normal, index), lines_along in zip(panels[row], heads[row], planes, sides, strict=True):
                along, up = (name for name in "xyz" if name != "xyz"[normal])
                image = image_of(panel, array.take(index, normal), lines_along, scale, overlays[row].cut(normal, index))
                panel.set_title(head)
                panel.set(xlabel=with_unit(along) if row + 1 == len(fields) else "", ylabel=with_unit(up))
                panel.tick_params(labelbottom=row + 1 == len(fields))
                panel.locator_params(nbins=4)
            if not shared_scale or row + 1 == len(fields):
                beside = panels.ravel() if shared_scale else panels[row]
                beyond = extent_beyond(alike, limits, scale)
                tall = 20 * (len(fields) if shared_scale else 1)
                figure.colorbar(image, ax=list(beside), label=label, pad=0.02, extend=beyond, aspect=tall)
        if title:
            figure.suptitle(wrapped(title, size[0]), fontsize=panels[0, 0].title.get_size())
    return figure


def gradient_panels(
    fields: Sequence[tuple[str, np.ndarray]],
    axes: Sequence[np.ndarray],
    path: str | Path,
    *,
    solids: Sequence[np.ndarray],
    label: str = "|grad u|",
) -> None:
    """Draw gradients by central differences outside solids side by side: magnitudes as colours, downhill directions as
    arrows.

    Parameters
    ----------
    fields : sequence of (title, ndarray)
        Fields of the lattice shape (nx, ny[, nz]), nan outside a window; in 3D the slice in the middle of z is drawn.
    axes : sequence of ndarray
        Evenly spaced coordinates of the nodes along each axis.
    path : str or Path
        The PNG file.
    solids : sequence of ndarray of bool
        Solid nodes of each field; they are left blank, and their outline is drawn.
    label : str
        Name of the magnitude.
    """
    middle: Any = (slice(None), slice(None), *[axis.size // 2 for axis in axes[2:]])
    titles, spacing = [title for title, _ in fields], float(axes[0][1] - axes[0][0])
    slopes = [
        np.array(np.gradient(np.where(solid, np.nan, u)[middle], spacing))
        for (_, u), solid in zip(fields, solids, strict=True)
    ]
    _images(
        [np.hypot(*slope) for slope in slopes],
        titles,
        axes[:2],
        path,
        [Overlay(solid=solid[middle]) for solid in solids],
        shared_scale=False,
        label=label,
        arrows=[-slope for slope in slopes],
    )


def _arrows(panel: Any, vectors: np.ndarray, axes: Sequence[np.ndarray]) -> None:
    """Draw the directions of vectors (2, nx, ny) as arrows of equal length, about `_ARROWS` along an axis."""
    every = max(1, max(vectors.shape[1:]) // _ARROWS)
    thin = (slice(every // 2, None, every),) * 2
    length = np.hypot(*vectors)[thin]
    x, y = (part[thin] / np.where(length > 0, length, np.inf) for part in vectors)
    panel.quiver(
        axes[0][thin[0]],
        axes[1][thin[1]],
        x.T,
        y.T,
        color="white",
        pivot="mid",
        scale=1.3 * x.shape[0],
        width=0.006,
        edgecolor="0.1",
        linewidth=0.3,
    )


def _images(
    arrays: Sequence[np.ndarray],
    titles: Sequence[str],
    axes: Sequence[np.ndarray],
    path: str | Path | None,
    overlays: Sequence[Overlay],
    *,
    shared_scale: bool,
    label: str,
    arrows: Sequence[np.ndarray] = (),
    colors: str | None = None,
    names: str = "xy",
    limits: tuple[float, float] | None = None,
    title: str = "",
    beyond: str | None = None,
) -> Any:
    """Draw 2D fields, already checked, as images and return the figure."""
    left, right, bottom, top = cell_edges(axes)
    rows, columns, width, height = panel_grid(len(arrays), (top - bottom) / (right - left), not shared_scale)
    bar = 0.9 if shared_scale else 0.9 * columns
    heads = [wrapped(name, width) for name in titles]
    above = _LINE * max(head.count("\n") for head in heads)
    size = (columns * (width + 0.15) + 0.6 + bar, rows * (height + 0.35 + above) + 0.45 + 0.3 * bool(title))
    with figure_at(path, size, "compressed") as figure:
        panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
        for empty in panels[len(arrays) :]:
            empty.remove()
        seen = [unhidden(array, overlay.broken) for array, overlay in zip(arrays, overlays, strict=True)]
        scale = scale_of(seen, limits, colors, usual=True)
        # one colour map for all panels, even if their scales differ
        signed = any(color_range([array])["cmap"] == DIVERGING for array in seen)
        for number, (array, head) in enumerate(zip(arrays, heads, strict=True)):
            panel = panels[number]
            if not shared_scale:
                scale = scale_of([seen[number]], limits, colors, signed, usual=True)
            image = image_of(panel, array, axes, scale, overlays[number])
            if arrows:
                _arrows(panel, arrows[number], axes)
            panel.set_title(head)
            lowest = number + columns >= len(arrays)
            panel.tick_params(labelbottom=lowest, labelleft=number % columns == 0)
            first = number % columns == 0
            panel.set(xlabel=with_unit(names[0]) if lowest else "", ylabel=with_unit(names[1]) if first else "")
            panel.locator_params(nbins=4 if width < 2 else 6)
            if not shared_scale:
                # within a row it would be mistaken for the label of the next panel's axis
                said = label if (number + 1) % columns == 0 or number + 1 == len(arrays) else ""
                figure.colorbar(image, ax=panel, label=said, extend=extent_beyond([seen[number]], limits, scale))
        if shared_scale:
            beyond = beyond or extent_beyond(seen, limits, scale)
            figure.colorbar(image, ax=list(panels[: len(arrays)]), label=label, pad=0.02, extend=beyond)
        if title:
            figure.suptitle(wrapped(title, size[0]), fontsize=panels[0].title.get_size())
    return figure


def field_table(
    rows: Sequence[str],
    columns: Sequence[tuple[str, Sequence[np.ndarray]]],
    axes: Sequence[np.ndarray],
    path: str | Path,
    *,
    cracks: Sequence[np.ndarray] = (),
    label: str = "u",
) -> None:
    """Draw 2D fields as a table of images: fields to compare side by side, times one below the other.

    Each row has one colour scale, which reaches at most five times the largest value of the first column; larger values
    have the colour of its end.

    Parameters
    ----------
    rows : sequence of str
        Names of the rows.
    columns : sequence of (title, fields)
        One field of shape (nx, ny) per row; fewer if a run ended early.
    axes : sequence of ndarray
        Coordinates of the nodes along the two axes.
    path : str or Path
        The PNG file.
    cracks : sequence of ndarray, each of shape (n, 2)
    label : str
        Name of the quantity.

    Raises
    ------
    InputError
        There are no rows or columns, the first column is incomplete, or the directory does not exist.
    """
    if not rows or not columns or len(columns[0][1]) < len(rows):
        given = f"{len(rows)} rows, {len(columns)} columns"
        raise InputError("a table of fields needs rows, columns, and a first column that is complete", value=given)
    left, right, bottom, top = cell_edges(axes)
    width = min(2.0, 8.0 / len(columns))
    height = width * (top - bottom) / (right - left)
    heads = [wrapped(title, width) for title, _ in columns]
    above = _LINE * max(head.count("\n") for head in heads)
    size = (len(columns) * (width + 0.1) + 1.6, len(rows) * (height + 0.15) + 0.6 + above)
    with figure_at(path, size, "compressed") as figure:
        panels = figure.subplots(len(rows), len(columns), sharex=True, sharey=True, squeeze=False)
        for i, row in enumerate(rows):
            most = _ROOM * float(np.nanmax(np.abs(columns[0][1][i])))
            scale = color_range([np.clip(fields[i], -most, most) for _, fields in columns if i < len(fields)])
            for j, (_, fields) in enumerate(columns):
                panel = panels[i, j]
                if i < len(fields):
                    image = image_of(panel, fields[i], axes, scale, Overlay(cracks))
                else:
                    panel.text(0.5, 0.5, "overflow", transform=panel.transAxes, ha="center", va="center", color="0.4")
                panel.set(
                    title=heads[j] if i == 0 else "",
                    xlabel="x" if i + 1 == len(rows) else "",
                    ylabel=f"{row}\ny" if j == 0 else "",
                )
                panel.locator_params(nbins=4)
            figure.colorbar(image, ax=list(panels[i]), label=label, pad=0.02, extend="both")


def comparable(fields: Sequence[np.ndarray]) -> bool:
    """Whether a common colour scale shows every field: the largest values of the nonzero fields are similar."""
    peaks = [peak for peak in (float(np.nanmax(np.abs(f), initial=0.0)) for f in fields) if peak > 0]
    return not peaks or min(peaks) >= _SHARED * max(peaks)


def magnitude(field: np.ndarray) -> np.ndarray:
    """Length of the vectors of a field, shape (components, nx, ...)."""
    return np.asarray(np.sqrt((np.asarray(field, float) ** 2).sum(0)))


def mode_picture(mode: np.ndarray, spacing: float, title: str, path: str | Path) -> None:
    """Draw the real and imaginary parts of a growing mode on the nodes of the near field, scaled to 1.

    Parameters
    ----------
    mode : ndarray of complex, shape (n,), (nx, ny) or (nx, ny, nz)
        In one dimension it is a profile along the normal of the sides.
    spacing : float
    title : str
    path : str or Path
        The PNG file.

    Raises
    ------
    InputError
        The directory does not exist.
    """
    values = np.squeeze(mode)
    values = values / values.flat[np.argmax(np.abs(values))]
    axes = [spacing * (np.arange(n) - (n - 1) / 2) for n in values.shape]
    if values.ndim == 1:
        curves = [("real part", axes[0], values.real), ("imaginary part", axes[0], values.imag)]
        lines(curves, path, xlabel=with_unit("distance along the normal"), ylabel="mode", title=title)
    else:
        field_panels(
            [("real part", values.real), ("imaginary part", values.imag)], axes, path, label=f"mode that {title}"
        )

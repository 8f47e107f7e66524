"""Pictures of fields as images side by side, with cracks, solids and arrows, and of corrosion fronts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon.errors import InputError
from farhorizon.pictures.curves import Frame, lines
from farhorizon.pictures.panels import (
    PLAIN,
    Axes,
    File,
    Grid,
    Look,
    Panel,
    Plane,
    add_title,
    cell_edges,
    heads_of,
    image_of,
)
from farhorizon.pictures.style import (
    COLORS,
    DIVERGING,
    SEQUENTIAL,
    color_range,
    extent_beyond,
    figure_at,
    scale_of,
    with_unit,
)

_ROOM = 5.0  # largest value on the colour scale of `field_table` over that of the first column


def field_panels(panels: Sequence[Panel], axes: Axes, path: File, look: Look = PLAIN) -> Any:
    """Draw fields side by side, as lines in common axes in 1D, as images in 2D, as slices in 3D, and return the figure;
    without a path nothing is written.
    """
    axes = [np.asarray(axis, dtype=float) for axis in axes]
    look = look._replace(cracks=[np.asarray(points, dtype=float) for points in look.cracks])
    panels = [panel._replace(values=np.asarray(panel.values, dtype=float)) for panel in panels]
    _check(panels, axes, look)
    if len(axes) == 1:
        curves = [(panel.title, axes[0], panel.values) for panel in panels]
        title = ", ".join(filter(None, (look.title, panels[0].title if len(panels) == 1 else "")))
        places = [x for points in look.cracks for x in points[:, 0]]
        return lines(curves, path, Frame(with_unit("x"), look.label, title, places=places, limits=look.limits))
    if len(axes) == 2:
        return _images(panels, axes, path, look)
    plane = look.plane or Plane.middle([axis.size for axis in axes])
    title = ", ".join(filter(None, (look.title, plane.place(axes))))
    cut = [panel.cut(plane) for panel in panels]
    return _images(cut, plane.within(axes), path, look.cut(plane)._replace(title=title), plane.names)


def _check(panels: Sequence[Panel], axes: Axes, look: Look) -> None:
    """Refuse pictures without fields, and fields and cracks that do not match the axes."""
    shape, dim = tuple(axis.size for axis in axes), len(axes)
    if not panels or dim not in (1, 2, 3):
        raise InputError(
            "a picture needs one field or more on one to three axes", value=f"{len(panels)} fields, {dim} axes"
        )
    for panel in panels:
        if panel.values.shape != shape:
            raise InputError(f"field {panel.title!r} does not match the axes", value=panel.values.shape, limit=shape)
    for points in look.cracks:
        if points.ndim != 2 or points.shape[1] != dim:
            raise InputError("a crack is an array of points", value=points.shape, limit=f"(n, {dim})")


def _scales(panels: Sequence[Panel], look: Look) -> list[tuple[dict[str, Any], str]]:
    """For each panel its colour scale, and the ends of the bar that have arrows; all panels have one colour map."""
    fields = [panel.seen for panel in panels]
    signed = None if look.shared else any(color_range([field])["cmap"] == DIVERGING for field in fields)
    scales: list[tuple[dict[str, Any], str]] = []
    for number, field in enumerate(fields):
        if number and look.shared:
            scales.append(scales[0])
            continue
        group = fields if look.shared else [field]
        scale = scale_of(group, look.limits, look.colors, signed, usual=True)
        scales.append((scale, look.beyond or extent_beyond(group, look.limits, scale)))
    return scales


def _images(panels: Sequence[Panel], axes: Axes, path: File, look: Look, names: str = "xy") -> Any:
    """Draw 2D fields as images in a grid."""
    left, right, bottom, top = cell_edges(axes)
    grid = Grid.of(len(panels), (top - bottom) / (right - left), not look.shared)
    heads, above = heads_of([panel.title for panel in panels], grid.width)
    bars = 0.9 if look.shared else 0.9 * grid.columns
    width, height = grid.columns * (grid.width + 0.15) + 0.6 + bars, grid.rows * (grid.height + 0.35 + above) + 0.45
    with figure_at(path, (width, height + 0.3 * bool(look.title)), "compressed") as figure:
        places = grid.places(figure, len(panels), names)
        for number, (panel, (scale, beyond)) in enumerate(zip(panels, _scales(panels, look), strict=True)):
            image = image_of(places[number], panel, axes, scale, look, number == 0)
            places[number].set_title(heads[number])
            if not look.shared:
                # within a row it would be mistaken for the label of the next panel's axis
                named = (number + 1) % grid.columns == 0 or number + 1 == len(panels)
                figure.colorbar(image, ax=places[number], label=look.label if named else "", extend=beyond)
        if look.shared:
            figure.colorbar(image, ax=places, label=look.label, pad=0.02, extend=beyond)
        add_title(figure, look.title, width)
    return figure


def slice_panels(panels: Sequence[Panel], axes: Axes, path: File, look: Look = PLAIN) -> Any:
    """Draw fields in 3D on the three planes through the middle, with one row per field, and return the figure."""
    planes = [Plane.middle([axis.size for axis in axes], normal) for normal in range(3)]
    sides = [plane.within(axes) for plane in planes]
    widths = [np.ptp(edges[:2]) / np.ptp(edges[2:]) for edges in map(np.array, map(cell_edges, sides))]
    height = min(2.1, 8.0 / sum(widths))  # of a row; three panels beside each other have at most 8 inches
    rows = len(panels)
    heads = []
    for wide, plane in zip(widths, planes, strict=True):
        titles = [", ".join(filter(None, (panel.title, plane.place(axes)))) for panel in panels]
        heads.append(heads_of(titles, height * wide))
    above = max(more for _, more in heads)
    size = (height * sum(widths) + 2.2, rows * (height + 0.3 + above) + 0.5 + 0.3 * bool(look.title))
    panels = [panel._replace(values=np.asarray(panel.values, float)) for panel in panels]
    look = look._replace(cracks=[np.asarray(points, float) for points in look.cracks])
    with figure_at(path, size, "compressed") as figure:
        places = figure.subplots(rows, 3, squeeze=False, width_ratios=widths)
        for row, (panel, (scale, beyond)) in enumerate(zip(panels, _scales(panels, look), strict=True)):
            last = row + 1 == rows
            for place, plane, within, (titles, _) in zip(places[row], planes, sides, heads, strict=True):
                image = image_of(place, panel.cut(plane), within, scale, look.cut(plane), row == 0)
                place.set_title(titles[row])
                place.set(xlabel=with_unit(plane.names[0]) if last else "", ylabel=with_unit(plane.names[1]))
                place.tick_params(labelbottom=last)
                place.locator_params(nbins=4)
            if not look.shared or last:
                beside = list(places.ravel() if look.shared else places[row])
                tall = 20 * (rows if look.shared else 1)  # a bar is as wide beside all rows as beside one
                figure.colorbar(image, ax=beside, label=look.label, pad=0.02, extend=beyond, aspect=tall)
        add_title(figure, look.title, size[0])
    return figure


def gradient_panels(panels: Sequence[Panel], axes: Axes, path: str | Path, label: str = "|grad u|") -> None:
    """Draw gradients by central differences outside solids, which are left blank, side by side: magnitudes as colours,
    downhill directions as arrows; in 3D on the slice in the middle of z.
    """
    if len(axes) == 3:
        plane = Plane.middle([axis.size for axis in axes])
        panels, axes = [panel.cut(plane) for panel in panels], plane.within(axes)
    spacing, slopes = float(axes[0][1] - axes[0][0]), []
    for panel in panels:
        solid = False if panel.solid is None else panel.solid
        slope = np.array(np.gradient(np.where(solid, np.nan, panel.values), spacing))
        slopes.append(Panel(panel.title, np.hypot(*slope), panel.solid, arrows=-slope))
    _images(slopes, axes, path, Look(label, shared=False))


def field_table(
    rows: Sequence[str],
    columns: Sequence[tuple[str, Sequence[np.ndarray]]],
    axes: Axes,
    path: str | Path,
    look: Look = PLAIN,
) -> None:
    """Draw 2D fields as a table of images: fields (fewer times if a run ended early) side by side, times one below the
    other, each row with one colour scale up to at most five times the largest value of the first column.
    """
    if not rows or not columns or len(columns[0][1]) < len(rows):
        given = f"{len(rows)} rows, {len(columns)} columns"
        raise InputError("a table of fields needs rows, columns, and a first column that is complete", value=given)
    left, right, bottom, top = cell_edges(axes)
    width = min(2.0, 8.0 / len(columns))  # the table has at most 8 inches
    height = width * (top - bottom) / (right - left)
    heads, above = heads_of([title for title, _ in columns], width)
    size = (len(columns) * (width + 0.1) + 1.6, len(rows) * (height + 0.15) + 0.6 + above)
    with figure_at(path, size, "compressed") as figure:
        places = figure.subplots(len(rows), len(columns), sharex=True, sharey=True, squeeze=False)
        for i, row in enumerate(rows):
            most = _ROOM * float(np.nanmax(np.abs(columns[0][1][i])))
            scale = color_range([np.clip(fields[i], -most, most) for _, fields in columns if i < len(fields)])
            for j, (_, fields) in enumerate(columns):
                place = places[i, j]
                if i < len(fields):
                    image = image_of(place, Panel("", fields[i]), axes, scale, look)
                else:
                    place.text(0.5, 0.5, "overflow", transform=place.transAxes, ha="center", va="center", color="0.4")
                place.set(
                    title=heads[j] if i == 0 else "",
                    xlabel=with_unit("x") if i + 1 == len(rows) else "",
                    ylabel=f"{row}\n{with_unit('y')}" if j == 0 else "",
                )
                place.locator_params(nbins=4)
            figure.colorbar(image, ax=list(places[i]), label=look.label, pad=0.02, extend="both")


def mode_picture(mode: np.ndarray, spacing: float, title: str, path: str | Path) -> None:
    """Draw the real and imaginary parts of a growing mode on the nodes of the near field, scaled to 1; in 1D it is a
    profile along the normal of the sides.
    """
    values = np.squeeze(mode)
    values = values / values.flat[np.argmax(np.abs(values))]
    axes = [spacing * (np.arange(n) - (n - 1) / 2) for n in values.shape]
    parts = [Panel("real part", values.real), Panel("imaginary part", values.imag)]
    if values.ndim == 1:
        curves = [(part.title, axes[0], part.values) for part in parts]
        lines(curves, path, Frame(with_unit("distance along the normal"), "mode", title))
    else:
        field_panels(parts, axes, path, Look(f"mode that {title}"))


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
    metal), fronts at even times, and the remaining metal; nodes `outside` a window are blank.
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

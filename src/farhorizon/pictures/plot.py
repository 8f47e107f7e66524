"""Pictures for papers: fields, probes, energy and error histories, as PNG files.

matplotlib is imported when a picture is made; pyplot is not used, so that no display is needed and no figure stays
open.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from farhorizon.errors import InputError

if TYPE_CHECKING:
    from farhorizon.files.results import Results

_STYLE = {
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9.5,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "axes.linewidth": 0.7,
    "axes.formatter.limits": (-3, 4),
    "axes.formatter.use_mathtext": True,
    "lines.linewidth": 1.3,
    "lines.markersize": 4.0,
    "grid.linewidth": 0.4,
    "grid.color": "0.88",
    "savefig.dpi": 150,
}
# Okabe and Ito's colours, which the colour-blind can tell apart; their yellow is left out, as it does not show on
# white.
_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_DASHES = ("-", "--", "-.", ":")
# A logarithmic axis shows at most so many decades below its maximum; double precision resolves 16.
_DECADES = 20
_ARROWS = 18  # along an axis
_RIM = (("white", 2.2), ("0.1", 0.9))  # a light rim shows a line on dark colours
_DAMAGE = "magma_r"  # light where nothing is broken
_ROOM = 5.0  # how much larger than in the first column values may be in the others without leaving the colours
_SHARED = 0.2  # panels whose largest values differ by more than this factor have colour scales of their own


@contextmanager
def _figure(path: str | Path, size: tuple[float, float], layout: str = "constrained") -> Iterator[Any]:
    """Yield an empty figure in our style, and save it as `path` at the end."""
    import matplotlib
    from cycler import cycler
    from matplotlib.figure import Figure

    path = Path(path)
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no directory {path.parent}", remedy="create it first")
    # coprime: all combinations
    styles = [(_DASHES[i % len(_DASHES)], _COLORS[i % len(_COLORS)]) for i in range(len(_DASHES) * len(_COLORS))]
    cycle = cycler(linestyle=[dash for dash, _ in styles]) + cycler(color=[color for _, color in styles])
    settings: dict[Any, Any] = {**_STYLE, "axes.prop_cycle": cycle}
    with matplotlib.rc_context(settings):
        figure = Figure(figsize=size, layout=layout)  # type: ignore[arg-type]
        yield figure
        figure.savefig(path)


def _lines(
    curves: Sequence[tuple[str, np.ndarray, np.ndarray]],
    path: str | Path,
    *,
    xlabel: str,
    ylabel: str,
    title: str = "",
    log: bool = False,
    places: Sequence[float] = (),
) -> None:
    """Draw curves (name, x, y) into one axes, the legend beside it, and thin lines across at `places`."""
    columns = -(-len(curves) // 16)
    widest = max((len(name) for name, _, _ in curves), default=0) if len(curves) > 1 else 0
    with _figure(path, (4.6 + columns * (0.075 * widest + 0.5 * (widest > 0)), 3.1)) as figure:
        axes = figure.add_subplot()
        for name, x, y in curves:
            axes.plot(x, y, label=name, marker="o" if np.isfinite(y).sum() == 1 else None)
        for place in places:
            axes.axvline(place, color="0.2", linewidth=0.8, linestyle="-")
        if log:
            axes.set_yscale("log")
            top = max(np.nanmax(y, initial=0) for _, _, y in curves)
            axes.set_ylim(bottom=max(axes.get_ylim()[0], top * 10.0**-_DECADES))
        axes.set(xlabel=xlabel, ylabel=ylabel, title=title)
        axes.margins(x=0.01)
        axes.grid(True)
        axes.set_axisbelow(True)
        if len(curves) > 1:
            figure.legend(loc="outside right upper", ncols=columns)


def _number(value: float, scale: float) -> str:
    """Text of a coordinate, free of round-off and with a true minus sign; `scale` is the size of coordinates that
    matter.
    """
    return f"{value if abs(value) > 1e-9 * scale else 0.0:g}".replace("-", "\N{MINUS SIGN}")


def _color_range(fields: Sequence[np.ndarray], signed: bool | None = None) -> dict[str, Any]:
    """Colour map and limits of some fields: symmetric and diverging if they have both signs, sequential otherwise.

    Negative values below a hundredth of the largest value are taken for undershoot, not for a sign, unless `signed` is
    given.
    """
    values = np.concatenate([field[np.isfinite(field)].ravel() for field in fields])
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)
    largest = max(-low, high)
    if low < -0.01 * largest if signed is None else signed:
        return {"cmap": "RdBu_r", "vmin": -largest or -1.0, "vmax": largest or 1.0}
    if high == low:
        return {"cmap": "viridis", "vmin": min(low, 0.0), "vmax": max(high, 0.0) or 1.0}
    return {"cmap": "viridis", "vmin": low if low > 0.5 * high else 0.0, "vmax": high}


def _panel_grid(number: int, ratio: float) -> tuple[int, int, float, float]:
    """Rows, columns and size in inches of `number` panels of height / width = `ratio`."""
    most = 1 if ratio < 0.35 else 2 if ratio < 0.6 else 3 if number in (3, 5, 6, 9) else 4
    columns = min(number, most)
    width = min(5.5 / columns + 0.8, 3.4)
    if ratio < 0.35:
        width = 5.5
    height = min(max(width * ratio, 0.55), 4.5)
    return -(-number // columns), columns, max(min(width, height / ratio), 1.3), height


def field_panels(
    fields: Sequence[tuple[str, np.ndarray]],
    axes: Sequence[np.ndarray],
    path: str | Path,
    *,
    shared_scale: bool = True,
    cracks: Sequence[np.ndarray] = (),
    label: str = "u",
    solids: Sequence[np.ndarray] = (),
    colors: str | None = None,
) -> None:
    """Draw fields side by side: lines in one axes in 1D, images in 2D, the slice in the middle of z in 3D.

    Parameters
    ----------
    fields : sequence of (title, ndarray)
        Fields of the lattice shape (nx[, ny[, nz]]); nan (outside a window) stays blank.
    axes : sequence of ndarray
        Coordinates of the nodes along each axis.
    path : str or Path
        The PNG file.
    shared_scale : bool
        One colour scale for all panels, with one colour bar; otherwise each has its own.  Without meaning in 1D.
    cracks : sequence of ndarray, each of shape (n, dim)
        Polylines, drawn as thin dark lines; in 3D their projection along z.
    label : str
        Name of what is drawn.
    solids : sequence of ndarray of bool
        For each field the nodes that are solid: their outline is drawn as cracks are. Without meaning in 1D.
    colors : str, optional
        Matplotlib's colour map, from zero; diverging or sequential as the values are, unless given. Without meaning in
        1D.

    Raises
    ------
    InputError
        There are no fields, shapes do not match, or there is no such directory.
    """
    coordinates = [np.asarray(axis, dtype=float) for axis in axes]
    shape, dim = tuple(axis.size for axis in coordinates), len(coordinates)
    if not fields or dim not in (1, 2, 3):
        raise InputError(
            "a picture needs one field or more on one to three axes", value=f"{len(fields)} fields, {dim} axes"
        )
    arrays = [np.asarray(field, dtype=float) for _, field in fields]
    titles = [title for title, _ in fields]
    for title, array in zip(titles, arrays, strict=True):
        if array.shape != shape:
            raise InputError(f"field {title!r} does not match the axes", value=array.shape, limit=shape)
    polylines = [np.asarray(points, dtype=float) for points in cracks]
    for points in polylines:
        if points.ndim != 2 or points.shape[1] != dim:
            raise InputError("a crack is an array of points", value=points.shape, limit=f"(n, {dim})")
    if dim == 1:
        curves = [(title, coordinates[0], array) for title, array in zip(titles, arrays, strict=True)]
        title = titles[0] if len(titles) == 1 else ""
        _lines(
            curves,
            path,
            xlabel="x",
            ylabel=label,
            title=title,
            places=[x for points in polylines for x in points[:, 0]],
        )
        return
    if dim == 3:
        middle = shape[2] // 2
        arrays = [array[:, :, middle] for array in arrays]
        place = f"z = {_number(coordinates[2][middle], np.ptp(coordinates[2]))}"
        titles = [f"{title}, {place}" if title else place for title in titles]
        solids = [solid[:, :, middle] for solid in solids]
    _images(
        arrays,
        titles,
        coordinates[:2],
        path,
        shared_scale=shared_scale,
        cracks=polylines,
        label=label,
        solids=solids,
        colors=colors,
    )


def gradient_panels(
    fields: Sequence[tuple[str, np.ndarray]],
    axes: Sequence[np.ndarray],
    path: str | Path,
    *,
    solids: Sequence[np.ndarray],
    label: str = "|grad u|",
) -> None:
    """Draw gradients outside solids side by side, by central differences: magnitudes as colours, downhill directions as
    arrows.

    Parameters
    ----------
    fields : sequence of (title, ndarray)
        Fields of the lattice shape (nx, ny[, nz]), nan outside a window; of nz slices the one in the middle.
    axes : sequence of ndarray
        Coordinates of the nodes along each axis, equally far apart.
    path : str or Path
        The PNG file.
    solids : sequence of ndarray of bool
        For each field the nodes that are solid: they are left blank, and their outline is drawn.
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
        shared_scale=False,
        cracks=(),
        label=label,
        solids=[solid[middle] for solid in solids],
        arrows=[-slope for slope in slopes],
    )


def _arrows(panel: Any, vectors: np.ndarray, axes: Sequence[np.ndarray]) -> None:
    """Directions of vectors (2, nx, ny) as arrows of one length, some `_ARROWS` along an axis."""
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


def _extent(axes: Sequence[np.ndarray]) -> tuple[float, float, float, float]:
    """Left, right, lower and upper edge of the cells of two axes."""
    spacing = max(float(axis[1] - axis[0]) if axis.size > 1 else 0.0 for axis in axes) or 1.0
    left, right, bottom, top = (float(end) for axis in axes for end in (axis[0] - spacing / 2, axis[-1] + spacing / 2))
    return left, right, bottom, top


def _around(axis: np.ndarray, wanted: np.ndarray) -> tuple[float, float]:
    """Part of an axis with the wanted nodes and a tenth of their extent, at least two cells, on either side; all of it
    without any.
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
) -> None:
    """Draw how metal has dissolved: the time at which each node became liquid, the fronts at even times, and the metal
    that is left.

    Parameters
    ----------
    dissolved : ndarray, shape (nx, ny[, nz])
        `Simulation.fields["dissolved"]`: nan in the metal, 0 where it was liquid from the start. In 3D the slice in the
        middle of z is drawn.
    axes : sequence of ndarray
        Coordinates of the nodes along each axis, two or three.
    path : str or Path
        The PNG file.
    outside : ndarray of bool, optional
        Nodes outside a window, left blank.
    cracks : sequence of ndarray, each of shape (n, dim)
        Drawn as lines.

    Raises
    ------
    InputError
        Another number of axes, or no such directory.
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
    if len(axes) == 3:
        middle = dissolved.shape[2] // 2
        dissolved, blank = dissolved[:, :, middle], blank[:, :, middle]
        title = f"z = {_number(axes[2][middle], np.ptp(axes[2]))}"
    metal = np.isnan(dissolved) & ~blank
    last = float(np.nanmax(dissolved, initial=0.0)) or 1.0
    once = metal | (dissolved > 0)
    shown = [_around(axis, once.any(1 - number)) for number, axis in enumerate(axes[:2])]
    _, _, width, height = _panel_grid(1, np.ptp(shown[1]) / np.ptp(shown[0]))
    with _figure(path, (1.4 * width + 1.5, 1.4 * height + 0.8), "compressed") as figure:
        panel = figure.add_subplot()
        style: dict[str, Any] = {"origin": "lower", "extent": _extent(axes[:2]), "aspect": "equal"}
        panel.imshow(np.where(metal, 1.0, np.nan).T, cmap=ListedColormap(["0.55"]), **style)
        times = panel.imshow(np.where(dissolved > 0, dissolved, np.nan).T, cmap="viridis", vmin=0, vmax=last, **style)
        late = np.where(metal, 1.25 * last, np.where(once, dissolved, np.nan))
        panel.contour(*axes[:2], late.T, levels=np.linspace(0.2, 0.8, 4) * last, colors="white", linewidths=0.6)
        panel.contour(*axes[:2], once.T.astype(float), levels=[0.5], colors="0.1", linewidths=0.8)
        for points in cracks:
            panel.plot(
                points[:, 0], points[:, 1], color="#D55E00", linewidth=1.4, linestyle="-", scalex=False, scaley=False
            )
        panel.set(xlabel="x", ylabel="y", title=title, xlim=shown[0], ylim=shown[1])
        figure.colorbar(times, ax=panel, label="time of dissolution")


def _images(
    arrays: Sequence[np.ndarray],
    titles: Sequence[str],
    axes: Sequence[np.ndarray],
    path: str | Path,
    *,
    shared_scale: bool,
    cracks: Sequence[np.ndarray],
    label: str,
    solids: Sequence[np.ndarray] = (),
    arrows: Sequence[np.ndarray] = (),
    colors: str | None = None,
) -> None:
    """Draw checked 2D fields as images."""
    left, right, bottom, top = _extent(axes)
    rows, columns, width, height = _panel_grid(len(arrays), (top - bottom) / (right - left))
    bar = 0.9 if shared_scale else 0.9 * columns
    with _figure(path, (columns * (width + 0.15) + 0.6 + bar, rows * (height + 0.35) + 0.45), "compressed") as figure:
        panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
        for empty in panels[len(arrays) :]:
            empty.remove()
        scale = _color_range(arrays)
        # one colour map for all panels, whatever the scales
        signed = any(_color_range([array])["cmap"] == "RdBu_r" for array in arrays)
        for number, (array, title) in enumerate(zip(arrays, titles, strict=True)):
            panel = panels[number]
            if not shared_scale:
                scale = _color_range([array], signed)
            if colors is not None:
                scale = {**scale, "cmap": colors, "vmin": 0.0}
            image = _image(panel, array, axes, scale, cracks, solids[number] if solids else None)
            if arrows:
                _arrows(panel, arrows[number], axes)
            panel.set_title(title)
            lowest = number + columns >= len(arrays)
            panel.tick_params(labelbottom=lowest, labelleft=number % columns == 0)
            panel.set(xlabel="x" if lowest else "", ylabel="y" if number % columns == 0 else "")
            panel.locator_params(nbins=4 if width < 2 else 6)
            if not shared_scale:
                figure.colorbar(image, ax=panel, label=label)
        if shared_scale:
            figure.colorbar(image, ax=list(panels[: len(arrays)]), label=label, pad=0.02)


def _image(
    panel: Any,
    array: np.ndarray,
    axes: Sequence[np.ndarray],
    scale: Mapping[str, Any],
    cracks: Any,
    solid: np.ndarray | None = None,
) -> Any:
    """Draw a field into one panel, with the outline of its window, of what is solid, and its cracks; returns the
    image."""
    image = panel.imshow(array.T, origin="lower", extent=_extent(axes), aspect="equal", **scale)
    outside = np.isnan(array)
    if outside.any() and not outside.all() and min(array.shape) > 1:
        panel.contour(*axes, outside.T, levels=[0.5], colors="0.6", linewidths=0.6)
    for color, width in _RIM:
        if solid is not None and min(array.shape) > 1:
            panel.contour(*axes, solid.T.astype(float), levels=[0.5], colors=color, linewidths=width)
    for points in cracks:
        for color, width in _RIM:
            panel.plot(
                points[:, 0], points[:, 1], color=color, linewidth=width, linestyle="-", scalex=False, scaley=False
            )
    return image


def field_table(
    rows: Sequence[str],
    columns: Sequence[tuple[str, Sequence[np.ndarray]]],
    axes: Sequence[np.ndarray],
    path: str | Path,
    *,
    cracks: Sequence[np.ndarray] = (),
    label: str = "u",
) -> None:
    """Draw 2D fields as a table of images: what is compared side by side, times one below the other.

    Each row has one colour scale, which reaches up to five times the largest value of the first column; what is larger
    has the colour of the end.

    Parameters
    ----------
    rows : sequence of str
        Names of the rows.
    columns : sequence of (title, fields)
        One field of shape (nx, ny) a row; fewer where a run has ended.
    axes : sequence of ndarray
        Coordinates of the nodes along the two axes.
    path : str or Path
        The PNG file.
    cracks : sequence of ndarray, each of shape (n, 2)
    label : str
        Name of what is drawn.

    Raises
    ------
    InputError
        No rows or columns, a first column that is not complete, or no such directory.
    """
    if not rows or not columns or len(columns[0][1]) < len(rows):
        given = f"{len(rows)} rows, {len(columns)} columns"
        raise InputError("a table of fields needs rows, columns, and a first column that is complete", value=given)
    left, right, bottom, top = _extent(axes)
    width = min(2.0, 8.0 / len(columns))
    height = width * (top - bottom) / (right - left)
    with _figure(path, (len(columns) * (width + 0.1) + 1.6, len(rows) * (height + 0.15) + 0.6), "compressed") as figure:
        panels = figure.subplots(len(rows), len(columns), sharex=True, sharey=True, squeeze=False)
        for i, row in enumerate(rows):
            most = _ROOM * float(np.nanmax(np.abs(columns[0][1][i])))
            scale = _color_range([np.clip(fields[i], -most, most) for _, fields in columns if i < len(fields)])
            for j, (title, fields) in enumerate(columns):
                panel = panels[i, j]
                if i < len(fields):
                    image = _image(panel, fields[i], axes, scale, cracks)
                else:
                    panel.text(0.5, 0.5, "overflow", transform=panel.transAxes, ha="center", va="center", color="0.4")
                panel.set(
                    title=title if i == 0 else "",
                    xlabel="x" if i + 1 == len(rows) else "",
                    ylabel=f"{row}\ny" if j == 0 else "",
                )
                panel.locator_params(nbins=4)
            figure.colorbar(image, ax=list(panels[i]), label=label, pad=0.02, extend="both")


def _comparable(fields: Sequence[np.ndarray]) -> bool:
    """Whether one colour scale shows something in every panel: the largest values of the fields that are not zero are
    alike.
    """
    peaks = [peak for peak in (float(np.nanmax(np.abs(f), initial=0.0)) for f in fields) if peak > 0]
    return not peaks or min(peaks) >= _SHARED * max(peaks)


def plot_results(
    results: Results, out_dir: str | Path, times: Sequence[float] | None = None, cracks: Sequence[np.ndarray] = ()
) -> list[Path]:
    """Draw a results file: each field at some times, the probes and the energy.

    The pictures of a field share one colour scale unless its largest value changes more than fivefold between them.

    Parameters
    ----------
    results : Results
    out_dir : str or Path
        Directory of the pictures; made if there is none.
    times : sequence of float, optional
        The nearest outputs are drawn; up to four evenly spaced ones unless given.
    cracks : sequence of ndarray, each of shape (n, dim)
        Polylines, drawn over the fields.

    Returns
    -------
    list of Path
        ``FIELD.png`` for every field, of vectors their length beside ``FIELD_x.png`` and so on (``front.png`` for the
        times of dissolution), ``probes.png``, ``energy.png`` and ``balance.png`` where they were recorded.

    Raises
    ------
    InputError
        A time is not finite.
    FileFormatError
        The results file is damaged.
    """
    outputs = results.times
    if times is None:
        chosen = np.unique(np.linspace(0, outputs.size - 1, min(outputs.size, 4)).round().astype(int))
    else:
        wanted = np.asarray(times, dtype=float)
        if not np.isfinite(wanted).all():
            raise InputError("the times of the pictures are finite numbers", value=list(times))
        chosen = (
            np.unique([np.abs(outputs - time).argmin() for time in wanted]) if outputs.size else np.zeros(0, dtype=int)
        )
    directory = Path(out_dir)
    directory.mkdir(parents=True, exist_ok=True)
    written = []
    if chosen.size:
        solids = [_solid(results, int(k)) for k in chosen] if "dissolved" in results.field_names else []
        for name in results.field_names:
            if name == "dissolved" and results.dim > 1:
                written.append(directory / "front.png")
                outside = np.isnan(results.field("u", 0)) if "u" in results.field_names else None
                front(results.field(name, int(chosen[-1])), results.axes, written[-1], outside=outside, cracks=cracks)
                continue
            drawn = chosen if name != "dissolved" else chosen[-1:]  # the last one tells all
            found = [results.field(name, int(k)) for k in drawn]
            for part, label, shown in [(name, name, found)] if results.components[name] == 1 else _parts(name, found):
                written.append(directory / f"{part}.png")
                fields = [(_moment(float(outputs[k]), results), values) for k, values in zip(drawn, shown, strict=True)]
                # damage shows the cracks, those cut in advance among them
                cuts, colors = ((), _DAMAGE) if name == "damage" else (cracks, None)
                field_panels(
                    fields,
                    results.axes,
                    written[-1],
                    shared_scale=_comparable(shown),
                    cracks=cuts,
                    label=label,
                    solids=solids,
                    colors=colors,
                )
    moments, values = results.probe_times, results.probe_values
    if moments.size:
        names = [
            ", ".join(f"{axis} = {_number(x, results.spacing)}" for axis, x in zip("xyz", place, strict=False))
            for place in results.probes
        ]
        if values.ndim > 2:
            names = [f"u_{axis} at {name}" for name in names for axis in "xyz"[: values.shape[2]]]
            values = values.reshape(len(values), -1)
        written.append(directory / "probes.png")
        title = f"probe at {names[0]}" if len(names) == 1 else ""
        curves = [(name, *_recorded(moments, column)) for name, column in zip(names, values.T, strict=True)]
        _lines(curves, written[-1], xlabel="t", ylabel="probe value", title=title)
    history, energy = results.history_times, results.energy
    if np.isfinite(energy).any():
        moments, energies = _recorded(history, energy)
        log = bool((energies > 0).all() and energies.max() > 100 * energies.min())
        written.append(directory / "energy.png")
        _lines([("energy", moments, energies)], written[-1], xlabel="t", ylabel="energy", log=log)
    if results.balance:
        written.append(directory / "balance.png")
        curves = [(name, *_recorded(history, values)) for name, values in results.balance.items()]
        _lines(
            curves,
            written[-1],
            xlabel="t",
            ylabel="energy" if "kinetic" in results.balance else "gain since the start, and inflow",
        )
    return written


def _moment(time: float, results: Results) -> str:
    """The title of a panel: its time, and what makes the field doubtful by then."""
    return ", ".join([f"t = {time:.4g}", *(caution.brief for caution in results.cautions if caution.time <= time)])


def magnitude(field: np.ndarray) -> np.ndarray:
    """Length of the vectors of a field, shape (components, nx, ...)."""
    return np.asarray(np.sqrt((np.asarray(field, float) ** 2).sum(0)))


def _parts(name: str, fields: Sequence[np.ndarray]) -> list[tuple[str, str, list[np.ndarray]]]:
    """What is drawn of vector fields, as (file name, label, values): their length and each component."""
    parts = [(name, f"|{name}|", [magnitude(field) for field in fields])]
    return parts + [
        (f"{name}_{axis}", f"{name}_{axis}", [field[i] for field in fields])
        for i, axis in enumerate("xyz"[: len(fields[0])])
    ]


def _solid(results: Results, index: int) -> np.ndarray:
    """Which nodes of an output are solid: those without a time of dissolution that lie in the window."""
    metal = np.isnan(results.field("dissolved", index))
    return metal & np.isfinite(results.field("u", index)) if "u" in results.field_names else metal


def _recorded(times: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of a history in which a value was recorded."""
    kept = np.isfinite(values)
    return times[kept], values[kept]


def error_history(
    curves: Mapping[str, tuple[np.ndarray, np.ndarray]], path: str | Path, ylabel: str, title: str, *, xlabel: str = "t"
) -> None:
    """Draw errors over time on a logarithmic axis, one line a boundary.

    A logarithmic axis has no zero: where an error is zero the line has a gap, and a curve of zeros only is marked in
    the legend, as is one that becomes infinite.

    Parameters
    ----------
    curves : mapping of str to (times, errors)
    path : str or Path
        The PNG file.
    ylabel, title, xlabel : str

    Raises
    ------
    InputError
        There are no curves, times and errors do not match, or there is no such directory.
    """
    if not curves:
        raise InputError("a picture of errors needs one curve or more")
    drawn = []
    for name, (times, errors) in curves.items():
        x, y = np.asarray(times, dtype=float), np.abs(np.asarray(errors, dtype=float))
        if x.ndim != 1 or x.shape != y.shape:
            raise InputError(f"times and errors of {name!r} do not match", value=y.shape, limit=x.shape)
        mark = " (diverges)" if np.isinf(y).any() else " (zero)" if y.size and (y == 0).all() else ""
        drawn.append((name + mark, x, np.where((y > 0) & np.isfinite(y), y, np.nan)))
    log = any(np.isfinite(y).any() for _, _, y in drawn)
    _lines(drawn, path, xlabel=xlabel, ylabel=ylabel, title=title, log=log)


def curve_panels(
    panels: Sequence[tuple[str, Sequence[tuple[str, np.ndarray, np.ndarray]]]],
    path: str | Path,
    *,
    xlabel: str,
    ylabel: str,
    reference: str | None = None,
) -> None:
    """Draw panels of curves that are to be compared: the reference a broad pale line, the others thin ones on top of
    it.

    Parameters
    ----------
    panels : sequence of (title, curves)
        Curves are (name, x, y); one name has one style in all panels. A single curve is named at its axis, several in
        one legend.
    path : str or Path
        The PNG file.
    xlabel, ylabel : str
    reference : str, optional
        Name of the curve that the others are held against; the first one unless given.

    Raises
    ------
    InputError
        There are no panels, a panel without curves, or no such directory.
    """
    if not panels or not all(curves for _, curves in panels):
        raise InputError("a picture of curves needs one panel or more, each with a curve")
    columns = 1 if len(panels) < 4 else 2
    rows = -(-len(panels) // columns)
    broad = panels[0][1][0][0] if reference is None else reference
    names = [
        name
        for name in dict.fromkeys(name for _, curves in panels if len(curves) > 1 for name, _, _ in curves)
        if name != broad
    ]
    dashes: list[dict[str, Any]] = [
        {},
        {"dashes": (3, 3)},
        {},
        {"dashes": (6, 2)},
        {"dashes": (6, 2, 1, 2)},
        {},
        {"dashes": (1, 1)},
    ]
    colors = [_COLORS[i] for i in (1, 6, 2, 3, 0, 4, 1)]
    styles = {
        name: {"color": colors[i % len(colors)], "linewidth": 1.1, **dashes[i % len(dashes)]}
        for i, name in enumerate(names)
    }
    styles[broad] = {"color": _COLORS[5], "linewidth": 3.4}
    shared = all(len(curves) > 1 for _, curves in panels)  # all axes are of one quantity
    with _figure(path, (6.4, 0.7 + 2.0 * rows)) as figure:
        legend: dict[str, Any] = {}
        for number, (title, curves) in enumerate(panels):
            axes = figure.add_subplot(rows, columns, number + 1)
            for name, x, y in curves:
                style = {"color": _COLORS[0], "linewidth": 1.1} if len(curves) == 1 else styles[name]
                (line,) = axes.plot(x, y, **{"linestyle": "-", **style})
                if len(curves) > 1:
                    legend.setdefault(name, line)
            label = curves[0][0] if len(curves) == 1 else "" if shared else ylabel
            axes.set(title=title, xlabel=xlabel if number >= len(panels) - columns else "", ylabel=label)
            axes.margins(x=0.01)
            axes.grid(True)
            axes.set_axisbelow(True)
        if shared:
            figure.supylabel(ylabel, fontsize=axes.yaxis.label.get_size())
        if legend:
            # characters across the figure, and those that a line's sample takes
            fit = max(1, 100 // (max(map(len, legend)) + 7))
            figure.legend(legend.values(), legend.keys(), loc="outside upper center", ncols=min(len(legend), fit, 4))


def log_panels(
    panels: Sequence[tuple[str, Sequence[tuple[str, np.ndarray, np.ndarray]]]],
    path: str | Path,
    *,
    xlabel: str,
    ylabel: str,
    order: float | None = None,
    printed: Sequence[Sequence[np.ndarray]] = (),
) -> None:
    """Draw panels of curves on a logarithmic axis, one below the other, each with its legend beside it.

    Parameters
    ----------
    panels : sequence of (title, curves)
        Curves are (name, x, y); what is not positive and finite has a gap.
    path : str or Path
        The PNG file.
    xlabel, ylabel : str
    order : float, optional
        Of a convergence plot: both axes are logarithmic, the points are marked, and a dashed line has this slope.
    printed : sequence of sequences of ndarray
        For each curve of each panel the values that a paper prints at the same x, drawn as circles.

    Raises
    ------
    InputError
        There are no panels, a panel without curves, or no such directory.
    """
    if not panels or not all(curves for _, curves in panels):
        raise InputError("a picture of curves needs one panel or more, each with a curve")
    widest = max(len(name) for _, curves in panels for name, _, _ in curves)
    with _figure(path, (4.6 + 0.075 * widest + 0.5, 0.5 + 2.6 * len(panels))) as figure:
        grid = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for number, (axes, (title, curves)) in enumerate(zip(grid, panels, strict=True)):
            axes.set_yscale("log")
            if order is not None:
                axes.set_xscale("log")
            for name, x, y in curves:
                axes.plot(
                    x, np.where((y > 0) & np.isfinite(y), y, np.nan), label=name, marker=None if order is None else "."
                )
            for k, line in enumerate(axes.get_lines() if printed else ()):
                circles = {
                    "color": line.get_color(),
                    "markerfacecolor": "none",
                    "markersize": 7,
                    "label": "" if k else "as printed",
                }
                axes.plot(curves[k][1], printed[number][k], "o", **circles)
            top = max(np.max(y, where=np.isfinite(y), initial=0) for _, _, y in curves)
            if order is not None:
                _, x, y = max(curves, key=lambda curve: float(np.nanmax(curve[2])))
                axes.plot(
                    x,
                    2 * np.nanmax(y) * (x / np.max(x)) ** order,
                    color="0.4",
                    linestyle="--",
                    linewidth=0.9,
                    label=f"order {order:g}",
                )
                axes.set_xticks(x, [f"{value:.3g}" for value in x])
                axes.minorticks_off()
            else:
                axes.set_ylim(bottom=max(axes.get_ylim()[0], top * 10.0**-_DECADES))
                axes.margins(x=0.01)
            axes.set(title=title, ylabel=ylabel, xlabel=xlabel if number + 1 == len(panels) else "")
            axes.grid(True)
            axes.set_axisbelow(True)
            axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.02), borderaxespad=0)


def mode_picture(mode: np.ndarray, spacing: float, title: str, path: str | Path) -> None:
    """Draw a growing mode on the nodes of the near field, scaled to 1: its real and imaginary part.

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
        There is no such directory.
    """
    values = np.squeeze(mode)
    values = values / values.flat[np.argmax(np.abs(values))]
    axes = [spacing * (np.arange(n) - (n - 1) / 2) for n in values.shape]
    if values.ndim == 1:
        curves = [("real part", axes[0], values.real), ("imaginary part", axes[0], values.imag)]
        _lines(curves, path, xlabel="distance along the normal", ylabel="mode", title=title)
    else:
        field_panels(
            [("real part", values.real), ("imaginary part", values.imag)], axes, path, label=f"mode that {title}"
        )


def reflection_picture(
    angles: np.ndarray, curves: Sequence[tuple[str, np.ndarray]], title: str, path: str | Path
) -> None:
    """Draw predicted reflection in decibels over the angle of incidence.

    Parameters
    ----------
    angles : ndarray, shape (n,)
        In degrees.
    curves : sequence of (name, amplitudes of shape (n,))
    title : str
    path : str or Path
        The PNG file.

    Raises
    ------
    InputError
        There are no curves, or no such directory.
    """
    if not curves:
        raise InputError("a picture of reflection needs one curve or more")
    levels = [(name, angles, 20 * np.log10(np.maximum(values, 1e-14))) for name, values in curves]
    _lines(levels, path, xlabel="angle of incidence (degrees)", ylabel="reflection (dB)", title=title)


def waterfall(
    x: np.ndarray,
    times: np.ndarray,
    lines: np.ndarray,
    path: str | Path,
    *,
    xlabel: str,
    ylabel: str,
    backdrop: tuple[str, np.ndarray],
) -> None:
    """Draw a field on a line at many times, the latest farthest back.

    Parameters
    ----------
    x : ndarray, shape (n,)
    times : ndarray, shape (m,)
    lines : ndarray, shape (m, n)
    path : str or Path
        The PNG file.
    xlabel, ylabel : str
    backdrop : (str, ndarray of shape (n,))
        Name and values of what is drawn behind the last line, scaled to the field.

    Raises
    ------
    InputError
        There is no such directory.
    """
    name, values = backdrop
    gap = np.ptp(lines[0]) / 4  # from one line to the next
    with _figure(path, (5.6, 4.2)) as figure:
        axes = figure.add_subplot()
        base = gap * len(times)
        axes.fill_between(
            x, base, base + 0.6 * np.ptp(lines[0]) * values / values.max(), color="0.85", linewidth=0, label=name
        )
        for number in range(len(times)):
            base = gap * number
            axes.fill_between(
                x, lines.min() - gap, base + lines[number], color="white", linewidth=0, zorder=2.5 - number / len(times)
            )
            axes.plot(
                x,
                base + lines[number],
                color=_COLORS[0],
                linestyle="-",
                linewidth=0.9,
                zorder=2.5 - number / len(times),
            )
        shown = range(0, len(times), max(1, len(times) // 5))
        axes.set_yticks([gap * number for number in shown], [f"{times[number]:g}" for number in shown])
        axes.set(xlabel=xlabel, ylabel="t")
        axes.plot([], [], color=_COLORS[0], linestyle="-", linewidth=0.9, label=ylabel)
        axes.margins(x=0)
        axes.legend(loc="upper center", ncols=2)
        axes.set_ylim(lines.min() - gap, 1.1 * axes.get_ylim()[1])

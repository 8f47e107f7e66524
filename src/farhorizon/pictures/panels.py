"""Panels of fields: what each shows, how many fit into a picture, and how one is drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from farhorizon.files.region_numbers import Regions
from farhorizon.pictures.style import RIM, number_text, with_unit, wrapped

_COARSE = 100  # nodes along an axis; with more, single pixels are hardly visible
_HURT, _SEVERED = 0.25, 0.45  # fractions of broken bonds, drawn clear and dark; beside a crack nearly half are broken
_INTERFACE = (("white", 1.4), ("0.25", 0.6))  # outlines of regions, lighter than cracks
_ARROWS = 18  # number of arrows along an axis
_LINE = 0.16  # height in inches of a line of a title
_SIMILAR = 0.2  # panels whose largest values differ by more than this factor have colour scales of their own


Axes = Sequence[np.ndarray]  # coordinates of the nodes along each axis
File = str | Path | None  # of a picture, whose ending determines the format; None writes nothing


class Panel(NamedTuple):
    """A field at the nodes of a lattice, and what is drawn over it."""

    title: str
    values: np.ndarray  # shape of the lattice; nan, as outside a window, stays blank
    solid: np.ndarray | None = None  # solid nodes, whose outline is drawn like cracks
    broken: np.ndarray | None = None  # fraction of broken bonds at each node, drawn in dark
    arrows: np.ndarray | None = None  # vectors whose directions are drawn, shape (2, nx, ny)
    moves: np.ndarray | None = None  # displacements of the nodes of a deformed lattice, shape (2, nx, ny)

    @property
    def seen(self) -> np.ndarray:
        """The field with nan at nodes that are drawn dark because many of their bonds are broken."""
        return self.values if self.broken is None else np.where(np.nan_to_num(self.broken) > _HURT, np.nan, self.values)

    def cut(self, plane: Plane) -> Self:
        """The slice of a panel of a 3D lattice."""
        solid, broken = (None if nodes is None else plane.of(nodes) for nodes in (self.solid, self.broken))
        return self._replace(values=plane.of(self.values), solid=solid, broken=broken)


class Look(NamedTuple):
    """What the panels of a picture have in common."""

    label: str = "u"  # of the colours, in 1D of the axis of values
    title: str = ""  # of the whole picture
    colors: str | None = None  # colour map from zero; by default a diverging or sequential one that fits the values
    limits: tuple[float, float] | None = None  # of the colours, in 1D of the axis of values
    shared: bool = True  # one colour scale for all panels, with one bar; otherwise one for each
    plane: Plane | None = None  # in 3D, the slice that is drawn; the middle of z unless given
    cracks: Sequence[np.ndarray] = ()  # polylines, each of shape (n, dim), projected onto slices
    regions: Regions | None = None  # whose outlines are drawn, with the names of materials in the first panel
    smooth: bool = False  # interpolate linearly between the nodes of a coarse lattice
    beyond: str | None = None  # ends at which a common bar has arrows; by default those beyond which there are values

    def cut(self, plane: Plane) -> Self:
        """The look of a slice."""
        regions = self.regions and self.regions._replace(numbers=plane.of(self.regions.numbers))
        return self._replace(cracks=[np.delete(points, plane.normal, 1) for points in self.cracks], regions=regions)


class Plane(NamedTuple):
    """A plane of nodes of a 3D lattice."""

    normal: int  # axis
    number: int  # of the plane along it

    @classmethod
    def middle(cls, shape: Sequence[int], normal: int = 2) -> Self:
        """The plane in the middle of an axis."""
        return cls(normal, shape[normal] // 2)

    @property
    def names(self) -> str:
        """Names of the axes in the plane."""
        return "xyz".replace("xyz"[self.normal], "")

    def of(self, field: np.ndarray) -> np.ndarray:
        """The values of a field in the plane."""
        return field.take(self.number, self.normal)

    def within(self, axes: Axes) -> list[np.ndarray]:
        """The axes in the plane, of those of the lattice."""
        return [axis for number, axis in enumerate(axes) if number != self.normal]

    def place(self, axes: Axes) -> str:
        """Where the plane is, in words."""
        normal = axes[self.normal]
        return f"{'xyz'[self.normal]} = {number_text(normal[self.number], float(np.ptp(normal)))}"


PLAIN = Look()


class Grid(NamedTuple):
    """Places of panels in rows, and their size in inches."""

    rows: int
    columns: int
    width: float
    height: float

    @classmethod
    def of(cls, number: int, ratio: float, bars: bool = False) -> Self:
        """The grid of `number` panels with height / width = `ratio`; with `bars`, each panel has a colour bar."""
        four = 2 if ratio < 0.6 or (bars and number == 4) else 4  # with bars a row of four is too long
        most = 1 if ratio < 0.35 else 3 if number in (3, 5, 6, 9) else four  # leaves few places empty
        columns = min(number, most)
        # a row of several is 5.5 inches and 0.8 for each wide; below 1.3, and 0.55 high, labels of ticks overlap
        width = 5.5 if ratio < 0.35 else min(5.5 / columns + 0.8, 3.4)
        height = min(max(width * ratio, 0.55), 4.5)
        return cls(-(-number // columns), columns, max(min(width, height / ratio), 1.3), height)

    def places(self, figure: Any, count: int, names: str = "xy") -> list[Any]:
        """The axes of so many panels, of the same scale, with labels on the left and below only."""
        places = figure.subplots(self.rows, self.columns, sharex=True, sharey=True, squeeze=False).ravel()
        for empty in places[count:]:
            empty.remove()
        for number, place in enumerate(places[:count]):
            lowest, first = number + self.columns >= count, number % self.columns == 0
            place.tick_params(labelbottom=lowest, labelleft=first)
            place.set(xlabel=with_unit(names[0]) if lowest else "", ylabel=with_unit(names[1]) if first else "")
            place.locator_params(nbins=4 if self.width < 2 else 6)
        return list(places[:count])


def heads_of(titles: Sequence[str], width: float) -> tuple[list[str], float]:
    """Titles in lines that are no wider than their panels, and the height of their lines beyond the first in inches."""
    heads = [wrapped(title, width) for title in titles]
    return heads, _LINE * max(head.count("\n") for head in heads)


def add_title(figure: Any, title: str, width: float) -> None:
    """Add the title of a whole picture, if there is one."""
    if title:
        figure.suptitle(wrapped(title, width), fontsize=figure.axes[0].title.get_size())


def comparable(fields: Sequence[np.ndarray]) -> bool:
    """Whether a common colour scale shows every field: the largest values of the nonzero fields are similar."""
    peaks = [peak for peak in (float(np.nanmax(np.abs(f), initial=0.0)) for f in fields) if peak > 0]
    return not peaks or min(peaks) >= _SIMILAR * max(peaks)


def magnitude(field: np.ndarray) -> np.ndarray:
    """Length of the vectors of a field, shape (components, nx, ...)."""
    return np.asarray(np.sqrt((np.asarray(field, float) ** 2).sum(0)))


def cell_edges(axes: Axes) -> tuple[float, float, float, float]:
    """Left, right, lower and upper edges of the cells of nodes on two axes."""
    spacing = max(float(axis[1] - axis[0]) if axis.size > 1 else 0.0 for axis in axes) or 1.0
    left, right, bottom, top = (float(end) for axis in axes for end in (axis[0] - spacing / 2, axis[-1] + spacing / 2))
    return left, right, bottom, top


def image_of(place: Any, panel: Panel, axes: Axes, scale: Mapping[str, Any], look: Look, named: bool = False) -> Any:
    """Draw a field on two axes, the outline of its window and all that lies over it, and return the image; with `named`
    the names of materials are written into their regions.
    """
    values, flat = panel.values, min(panel.values.shape) > 1
    left, right, bottom, top = cell_edges(axes)
    shown: dict[str, Any] = {"origin": "lower", "extent": (left, right, bottom, top), "aspect": "equal"}
    if look.smooth and max(values.shape) <= _COARSE and bool(np.isfinite(values).all()):
        shown["interpolation"] = "bilinear"
    image = place.imshow(values.T, **shown, **scale)
    if panel.broken is not None:
        dark = np.zeros((*values.T.shape, 4))
        dark[..., 3] = np.clip((np.nan_to_num(panel.broken.T) - _HURT) / (_SEVERED - _HURT), 0, 1)
        place.imshow(dark, **shown)
    if look.regions is not None and flat:
        _outline_regions(place, look.regions, axes, named)
    outside = np.isnan(values)
    if outside.any() and not outside.all() and flat:
        place.contour(*axes, outside.T, levels=[0.5], colors="0.6", linewidths=0.6)
    for color, width in RIM:
        if panel.solid is not None and flat:
            place.contour(*axes, panel.solid.T.astype(float), levels=[0.5], colors=color, linewidths=width)
    for points in look.cracks:
        for color, width in RIM:
            place.plot(points[:, 0], points[:, 1], color=color, linewidth=width, linestyle="-")
    if panel.arrows is not None:
        _draw_arrows(place, panel.arrows, axes)
    place.set(xlim=(left, right), ylim=(bottom, top))  # a crack may extend further
    return image


def _outline_regions(place: Any, regions: Regions, axes: Axes, named: bool) -> None:
    """Draw the outlines of all regions except the first, and the names of materials where there is most room."""
    from matplotlib import patheffects
    from scipy.ndimage import distance_transform_edt

    written = set()  # names, each in the largest of its regions
    for number, name in enumerate(regions.names):
        nodes = regions.numbers == number
        if not nodes.any():
            continue
        for color, width in _INTERFACE if number else ():
            place.contour(*axes, nodes.T.astype(float), levels=[0.5], colors=color, linewidths=width)
        material = name.split(", ")[0]
        if named and " = " not in material and material not in written:
            written.add(material)
            room = distance_transform_edt(np.pad(nodes, 1))[1:-1, 1:-1]
            aside = np.add.outer(*(np.abs(axis - axis.mean()) for axis in axes)) / np.ptp(axes[0])
            node = np.unravel_index(int((room - aside).argmax()), room.shape)  # nearest to the middle if equal
            x, y = (axis[k] for axis, k in zip(axes, node, strict=True))
            rim = [patheffects.withStroke(linewidth=1.6, foreground="white")]
            place.text(x, y, material, ha="center", va="center", fontsize=7, color="0.1", path_effects=rim)


def _draw_arrows(place: Any, vectors: np.ndarray, axes: Axes) -> None:
    """Draw the directions of vectors as arrows of equal length, about `_ARROWS` along an axis."""
    step = max(1, max(vectors.shape[1:]) // _ARROWS)
    thin = (slice(step // 2, None, step),) * 2
    length = np.hypot(*vectors)[thin]
    x, y = (part[thin] / np.where(length > 0, length, np.inf) for part in vectors)
    arrows = {"color": "white", "pivot": "mid", "width": 0.006, "edgecolor": "0.1", "linewidth": 0.3}
    place.quiver(axes[0][thin[0]], axes[1][thin[1]], x.T, y.T, scale=1.3 * x.shape[0], **arrows)

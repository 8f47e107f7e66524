"""Images of single fields with overlays: cracks, broken bonds, solids and regions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Self

import numpy as np

from farhorizon.files.region_numbers import Regions
from farhorizon.pictures.style import RIM

_COARSE = 100  # nodes along an axis; with more, single pixels are hardly visible
_HURT, _SEVERED = 0.25, 0.45  # fractions of broken bonds, drawn clear and dark; beside a crack nearly half are broken
_INTERFACE = (("white", 1.4), ("0.25", 0.6))  # outlines of regions, lighter than cracks


class Overlay(NamedTuple):
    """Objects drawn over a field.

    Attributes
    ----------
    cracks : sequence of ndarray, shapes (n, dim)
    solid : ndarray of bool, optional
        Solid nodes; their outline is drawn.
    broken : ndarray, optional
        Fraction of broken bonds at each node; drawn dark where it is large.
    regions : Regions, optional
        Regions whose outlines are drawn.
    named : bool
        Whether the names of materials are written into their regions.
    smooth : bool
        Whether values are interpolated linearly between the nodes of a coarse lattice.
    """

    cracks: Sequence[np.ndarray] = ()
    solid: np.ndarray | None = None
    broken: np.ndarray | None = None
    regions: Regions | None = None
    named: bool = False
    smooth: bool = False

    def cut(self, normal: int, index: int) -> Self:
        """Overlay of a slice of a 3D field; cracks are projected onto it."""
        solid, broken = (None if one is None else one.take(index, normal) for one in (self.solid, self.broken))
        regions = self.regions and self.regions._replace(numbers=self.regions.numbers.take(index, normal))
        cracks = [np.delete(points, normal, 1) for points in self.cracks]
        return self._replace(cracks=cracks, solid=solid, broken=broken, regions=regions)


def cell_edges(axes: Sequence[np.ndarray]) -> tuple[float, float, float, float]:
    """Left, right, lower and upper edges of the cells of nodes on two axes."""
    spacing = max(float(axis[1] - axis[0]) if axis.size > 1 else 0.0 for axis in axes) or 1.0
    left, right, bottom, top = (float(end) for axis in axes for end in (axis[0] - spacing / 2, axis[-1] + spacing / 2))
    return left, right, bottom, top


def unhidden(array: np.ndarray, broken: np.ndarray | None) -> np.ndarray:
    """A field with nan at nodes that are drawn dark because many of their bonds are broken."""
    return array if broken is None else np.where(np.nan_to_num(broken) > _HURT, np.nan, array)


def image_of(
    panel: Any, array: np.ndarray, axes: Sequence[np.ndarray], scale: Mapping[str, Any], overlay: Overlay
) -> Any:
    """Draw a field, the outline of its window and its overlay into a panel, and return the image."""
    left, right, bottom, top = cell_edges(axes)
    shown: dict[str, Any] = {"origin": "lower", "extent": (left, right, bottom, top), "aspect": "equal"}
    outside, flat = np.isnan(array), min(array.shape) > 1
    between = overlay.smooth and max(array.shape) <= _COARSE and bool(np.isfinite(array).all())
    image = panel.imshow(array.T, interpolation="bilinear" if between else None, **shown, **scale)
    if overlay.broken is not None:
        dark = np.zeros((*array.T.shape, 4))
        dark[..., 3] = np.clip((np.nan_to_num(overlay.broken.T) - _HURT) / (_SEVERED - _HURT), 0, 1)
        panel.imshow(dark, interpolation="bilinear" if between else None, **shown)
    if overlay.regions is not None and flat:
        _outline_regions(panel, overlay.regions, axes, overlay.named)
    if outside.any() and not outside.all() and flat:
        panel.contour(*axes, outside.T, levels=[0.5], colors="0.6", linewidths=0.6)
    for color, width in RIM:
        if overlay.solid is not None and flat:
            panel.contour(*axes, overlay.solid.T.astype(float), levels=[0.5], colors=color, linewidths=width)
    for points in overlay.cracks:
        for color, width in RIM:
            panel.plot(points[:, 0], points[:, 1], color=color, linewidth=width, linestyle="-")
    panel.set(xlim=(left, right), ylim=(bottom, top))  # a crack may extend further
    return image


def _outline_regions(panel: Any, regions: Regions, axes: Sequence[np.ndarray], named: bool) -> None:
    """Draw the outlines of all regions except the first, and the names of materials where there is most room."""
    from matplotlib import patheffects
    from scipy.ndimage import distance_transform_edt

    known = set()  # names already written, each in the largest of its regions
    for number, name in enumerate(regions.names):
        there = regions.numbers == number
        if not there.any():
            continue
        for color, width in _INTERFACE if number else ():
            panel.contour(*axes, there.T.astype(float), levels=[0.5], colors=color, linewidths=width)
        called = name.split(", ")[0]
        if named and " = " not in called and called not in known:
            known.add(called)
            room = distance_transform_edt(np.pad(there, 1))[1:-1, 1:-1]
            aside = np.add.outer(*(np.abs(axis - axis.mean()) for axis in axes)) / np.ptp(axes[0])
            place = np.unravel_index(int((room - aside).argmax()), room.shape)  # nearest to the middle if equal
            x, y = (axis[k] for axis, k in zip(axes, place, strict=True))
            rim = [patheffects.withStroke(linewidth=1.6, foreground="white")]
            panel.text(x, y, called, ha="center", va="center", fontsize=7, color="0.1", path_effects=rim)

"""What is drawn of a results file, and how: its times, its slices, its scale."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from farhorizon.errors import InputError
from farhorizon.pictures.style import FORMATS

if TYPE_CHECKING:
    from farhorizon.files.results import Results

FLOOR = -60.0  # decibels, unless a range is given


@dataclass(frozen=True)
class View:
    """What is drawn of a results file, and how.

    Parameters
    ----------
    times : sequence of float, optional
        The nearest outputs are drawn; up to four evenly spaced ones unless given.
    fields : sequence of str, optional
        Names of fields, of vectors of components, too ("u_x"), and of displacements their divergence and curl
        ("u_divergence", "u_curl"), and "stress" for all its components that there are; all fields, and the histories,
        unless given.
    planes : sequence of (str, float)
        Of lattices in 3D the axis that a slice is normal to, and where it lies: the nearest plane of nodes. Several
        have pictures of their own; the middle of z unless given.
    limits : (float, float), optional
        Of the colour scale; of decibels where these are drawn.
    decibels : bool
        Draw magnitudes in decibels below the largest of the drawn times.
    deformed : float, optional
        Draw the deformed lattice of an elastic run in 2D in place of the fields, displacements times this factor; 0
        chooses it.
    movie : bool
        All outputs one after the other, in place of panels.
    isosurfaces : sequence of float, optional
        Of fields in space draw the surfaces on which they have these values in place of slices; without any values a
        fifth and a half of the largest magnitude, of each time where these are far apart.
    format : {"png", "pdf", "svg"}
    suffix : str
        What the names of the pictures of fields end in, before that of the format.
    cracks : sequence of ndarray, each of shape (n, dim)
        Polylines, drawn over the fields.
    quantities : mapping of str to str
        What a case calls them ("temperature"), at colour bars and axes.

    Raises
    ------
    InputError
        Times, a slice or a range that are not finite, an empty range, an unknown format; more than one of the deformed
        shape, isosurfaces and a film.
    """

    times: Sequence[float] | None = None
    fields: Sequence[str] | None = None
    planes: Sequence[tuple[str, float]] = ()
    limits: tuple[float, float] | None = None
    decibels: bool = False
    deformed: float | None = None
    movie: bool = False
    isosurfaces: Sequence[float] | None = None
    format: str = "png"
    suffix: str = ""
    cracks: Sequence[np.ndarray] = ()
    quantities: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.times is not None and not np.isfinite(np.asarray(self.times, dtype=float)).all():
            raise InputError("the times of the pictures are finite numbers", value=list(self.times))
        if self.limits is not None and not (np.isfinite(self.limits).all() and self.limits[0] < self.limits[1]):
            raise InputError("a range goes from a number to a larger one", value=self.limits, key="--range")
        if self.deformed is not None and not (np.isfinite(self.deformed) and self.deformed >= 0):
            raise InputError("the factor must be positive", value=self.deformed, key="--deformed")
        asked = {"--deformed": self.deformed, "--isosurfaces": self.isosurfaces, "--movie": self.movie or None}
        if len(kinds := [option for option, one in asked.items() if one is not None]) > 1:
            raise InputError("one of these is drawn at a time", value=" ".join(kinds), remedy="plot once for each")
        if not np.isfinite(self.isosurfaces or ()).all():
            raise InputError("levels are finite numbers", value=self.isosurfaces, key="--isosurfaces")
        if self.format not in FORMATS:
            raise InputError("unknown format", value=self.format, limit=", ".join(FORMATS), key="--format")

    def chosen(self, results: Results, say: Callable[[str], None] = lambda text: None) -> list[int]:
        """The outputs that are drawn; says where they are not at the times asked for."""
        outputs = results.times
        if self.times is None or not outputs.size:
            some = outputs.size if self.movie else min(outputs.size, 4)
            return sorted({round(k) for k in np.linspace(0, outputs.size - 1, some).tolist()})
        found = [int(np.abs(outputs - time).argmin()) for time in self.times]
        for time, k in zip(self.times, found, strict=True):
            if abs(outputs[k] - time) > 1e-9 * max(abs(time), abs(outputs[-1])):
                say(f"t = {time:g} is not stored; t = {outputs[k]:.6g}, the nearest, is drawn")
        return sorted(set(found))

    def slices(self, results: Results) -> list[Slice]:
        """The slices that are drawn.

        Raises
        ------
        InputError
            One lies outside, or the lattice is not three-dimensional.
        """
        if self.planes and results.dim != 3:
            raise InputError("only a 3D lattice can be sliced", value=f"{results.dim}D", limit="3D", key="--slice")
        found = []
        for name, place in self.planes:
            axis = results.axes["xyz".index(name)]
            if not axis[0] - results.spacing / 2 <= place <= axis[-1] + results.spacing / 2:
                raise InputError(
                    "the slice lies outside the near field",
                    value=f"{name} = {place:g}",
                    limit=f"{axis[0]:g} to {axis[-1]:g}",
                    key="--slice",
                )
            plane = "xyz".index(name), int(np.abs(axis - place).argmin())
            found.append(Slice(plane, f"-{name}={place:g}{self.suffix}"))
        return found or [Slice(None, self.suffix)]

    def levels(self, values: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Magnitudes in decibels below the largest of them, which is not zero."""
        top = max(float(np.nanmax(np.abs(one), initial=0.0)) for one in values)
        low = self.limits[0] if self.limits else FLOOR
        with np.errstate(divide="ignore"):
            return [np.maximum(20 * np.log10(np.abs(one) / top), low) for one in values]


class Slice(NamedTuple):
    """A slice of a lattice in space.

    Attributes
    ----------
    plane : (int, int) or None
        Its axis and index; None for all of the lattice.
    suffix : str
        What the names of its pictures end in.
    """

    plane: tuple[int, int] | None
    suffix: str

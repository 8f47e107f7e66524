"""Selection of what is drawn from a results file, and how: times, slices and scales."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from farhorizon.errors import InputError
from farhorizon.pictures.panels import Plane
from farhorizon.pictures.style import FORMATS
from farhorizon.rounding import MARGIN

if TYPE_CHECKING:
    from farhorizon.files.results import Results

FLOOR = -60.0  # lower limit in decibels, unless a range is given


@dataclass(frozen=True)
class View:
    """What to draw from a results file, and how; InputError for values that are not finite, an empty range, an unknown
    format, and what excludes each other.
    """

    # for which the nearest outputs are drawn; up to four evenly spaced outputs unless given
    times: Sequence[float] | None = None
    # fields, components of vectors ("u_x"), divergence and curl of displacements ("u_divergence", "u_curl"), "stress"
    # for all its components in the file; all fields and the histories unless given
    fields: Sequence[str] | None = None
    # in 3D, normal and position of each slice, for which the nearest plane of nodes has pictures of its own; unless
    # given, the three planes through the middle are drawn, and the middle of z in films and of corroding metal
    planes: Sequence[tuple[str, float]] = ()
    limits: tuple[float, float] | None = None  # of the colours, in decibels if these are drawn
    decibels: bool = False  # magnitudes are drawn in decibels below the largest of the drawn times
    # factor of the displacements of a 2D elastic run, whose deformed lattice is drawn instead of fields; 0 chooses it
    deformed: float | None = None
    movie: bool = False  # all outputs are drawn one after the other as a film, instead of panels
    # values of 3D fields on surfaces that are drawn instead of slices; an empty sequence stands for a fifth and a half
    # of the largest magnitude, at each time separately if these magnitudes differ much
    isosurfaces: Sequence[float] | None = None
    format: str = "png"
    suffix: str = ""  # end of the file names of the pictures of fields, before that of the format
    cracks: Sequence[np.ndarray] = ()  # polylines, each of shape (n, dim), drawn over the fields
    quantities: Mapping[str, str] = field(default_factory=dict)  # their names in the case, for colour bars and axes

    def __post_init__(self) -> None:
        if self.times is not None and not np.isfinite(np.asarray(self.times, dtype=float)).all():
            raise InputError("the times of the pictures are finite numbers", value=list(self.times))
        if self.limits is not None and not (np.isfinite(self.limits).all() and self.limits[0] < self.limits[1]):
            raise InputError("a range goes from a number to a larger one", value=self.limits, key="--range")
        if self.deformed is not None and not (np.isfinite(self.deformed) and self.deformed >= 0):
            raise InputError("the factor must be positive", value=self.deformed, key="--deformed")
        kinds = _given({"--deformed": self.deformed, "--isosurfaces": self.isosurfaces, "--movie": self.movie or None})
        if len(kinds) > 1:
            raise InputError("one of these is drawn at a time", value=" ".join(kinds), remedy="plot once for each")
        colors = _given({"--field": self.fields, "--range": self.limits, "--db": self.decibels or None})
        if self.deformed is not None and colors:
            raise InputError(
                "colours of a deformed shape show the damage, or the displacements where there is none",
                value=" ".join(colors),
                key="--deformed",
                remedy="plot fields without it",
            )
        if not np.isfinite(self.isosurfaces or ()).all():
            raise InputError("levels are finite numbers", value=self.isosurfaces, key="--isosurfaces")
        if self.format not in FORMATS:
            raise InputError("unknown format", value=self.format, limit=", ".join(FORMATS), key="--format")

    def chosen(self, results: Results, say: Callable[[str], None] = lambda text: None) -> list[int]:
        """Indices of the outputs that are drawn; `say` is told which requested times are not stored."""
        outputs = results.times
        if self.times is None or not outputs.size:
            count = outputs.size if self.movie else min(outputs.size, 4)
            return sorted({round(k) for k in np.linspace(0, outputs.size - 1, count).tolist()})
        nearest = [int(np.abs(outputs - time).argmin()) for time in self.times]
        for time, k in zip(self.times, nearest, strict=True):
            if abs(outputs[k] - time) > MARGIN * max(abs(time), abs(outputs[-1])):  # less is rounding
                say(f"t = {time:g} is not stored; t = {outputs[k]:.6g}, the nearest, is drawn")
        return sorted(set(nearest))

    def slices(self, results: Results) -> list[Slice]:
        """Slices that are drawn; InputError for one outside the near field, or of a lattice that is not 3D."""
        if self.planes and results.dim != 3:
            raise InputError("only a 3D lattice can be sliced", value=f"{results.dim}D", limit="3D", key="--slice")
        slices = []
        for name, place in self.planes:
            normal = "xyz".index(name)
            axis = results.axes[normal]
            if not axis[0] - results.spacing / 2 <= place <= axis[-1] + results.spacing / 2:
                raise InputError(
                    "the slice lies outside the near field",
                    value=f"{name} = {place:g}",
                    limit=f"{axis[0]:g} to {axis[-1]:g}",
                    key="--slice",
                )
            plane = Plane(normal, int(np.abs(axis - place).argmin()))
            slices.append(Slice(plane, f"-{name}={place:g}{self.suffix}"))
        return slices or [Slice(None, self.suffix)]

    def levels(self, values: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Magnitudes in decibels relative to the largest of them, which must not be zero."""
        top = max(float(np.nanmax(np.abs(field), initial=0.0)) for field in values)
        low = self.limits[0] if self.limits else FLOOR
        with np.errstate(divide="ignore"):
            return [np.maximum(20 * np.log10(np.abs(field) / top), low) for field in values]


def _given(options: Mapping[str, object]) -> list[str]:
    """Options that are not None."""
    return [option for option, value in options.items() if value is not None]


class Slice(NamedTuple):
    """A slice of a 3D lattice."""

    plane: Plane | None  # None for the default planes
    suffix: str  # end of the file names of its pictures

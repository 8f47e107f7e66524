"""Selection of what is drawn from a results file, and how: times, slices and scales."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from farhorizon.errors import InputError
from farhorizon.pictures.style import FORMATS

if TYPE_CHECKING:
    from farhorizon.files.results import Results

FLOOR = -60.0  # lower limit in decibels, unless a range is given


@dataclass(frozen=True)
class View:
    """What to draw from a results file, and how.

    Parameters
    ----------
    times : sequence of float, optional
        Times, for which the nearest outputs are drawn; up to four evenly spaced outputs if not given.
    fields : sequence of str, optional
        Names of fields, of components of vectors ("u_x"), of the divergence and curl of displacements ("u_divergence",
        "u_curl"), or "stress" for all its components in the file; all fields and the histories if not given.
    planes : sequence of (str, float)
        For 3D lattices, the axis normal to each slice and its position, for which the nearest plane of nodes is drawn.
        Each slice has its own pictures. If not given, the three planes through the middle are drawn, and the middle of
        z in films and of corroding metal.
    limits : (float, float), optional
        Limits of the colour scale, in decibels if these are drawn.
    decibels : bool
        Draw magnitudes in decibels below the largest of the drawn times.
    deformed : float, optional
        Draw the deformed lattice of a 2D elastic run instead of the fields, with displacements multiplied by this
        factor; 0 chooses it.
    movie : bool
        Draw all outputs one after the other as a film, instead of panels.
    isosurfaces : sequence of float, optional
        Draw the surfaces on which 3D fields have these values, instead of slices; an empty sequence stands for a fifth
        and a half of the largest magnitude, at each time separately if these magnitudes differ much.
    format : {"png", "pdf", "svg"}
    suffix : str
        End of the file names of the pictures of fields, before that of the format.
    cracks : sequence of ndarray, each of shape (n, dim)
        Polylines, drawn over the fields.
    quantities : mapping of str to str
        Names of quantities in the case ("temperature"), for colour bars and axes.

    Raises
    ------
    InputError
        Times, a factor, levels or a range are not finite; the range is empty; the format is unknown; or more than one
        of deformed shape, isosurfaces and film is requested, or fields, a range or decibels with a deformed shape.
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
        own = {"--field": self.fields, "--range": self.limits, "--db": self.decibels or None}
        if self.deformed is not None and (given := [option for option, one in own.items() if one is not None]):
            raise InputError(
                "colours of a deformed shape show the damage, or the displacements where there is none",
                value=" ".join(given),
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
            some = outputs.size if self.movie else min(outputs.size, 4)
            return sorted({round(k) for k in np.linspace(0, outputs.size - 1, some).tolist()})
        found = [int(np.abs(outputs - time).argmin()) for time in self.times]
        for time, k in zip(self.times, found, strict=True):
            if abs(outputs[k] - time) > 1e-9 * max(abs(time), abs(outputs[-1])):
                say(f"t = {time:g} is not stored; t = {outputs[k]:.6g}, the nearest, is drawn")
        return sorted(set(found))

    def slices(self, results: Results) -> list[Slice]:
        """Slices that are drawn.

        Raises
        ------
        InputError
            A slice lies outside the near field, or the lattice is not three-dimensional.
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
        """Magnitudes in decibels relative to the largest of them, which must not be zero."""
        top = max(float(np.nanmax(np.abs(one), initial=0.0)) for one in values)
        low = self.limits[0] if self.limits else FLOOR
        with np.errstate(divide="ignore"):
            return [np.maximum(20 * np.log10(np.abs(one) / top), low) for one in values]


class Slice(NamedTuple):
    """A slice of a 3D lattice.

    Attributes
    ----------
    plane : (int, int) or None
        Axis and index of the slice; None for the default planes.
    suffix : str
        End of the file names of its pictures.
    """

    plane: tuple[int, int] | None
    suffix: str

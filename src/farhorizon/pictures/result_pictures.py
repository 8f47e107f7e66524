"""Pictures of a results file: its fields at some times, its probes, its energies."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from farhorizon.errors import InputError
from farhorizon.files.region_numbers import Regions
from farhorizon.pictures.curves import lines
from farhorizon.pictures.deformed import deformed_panels
from farhorizon.pictures.fields import comparable, field_panels, magnitude, slice_panels
from farhorizon.pictures.fronts import front
from farhorizon.pictures.isosurfaces import isosurface_panels
from farhorizon.pictures.movie import movie
from farhorizon.pictures.polar import polar_picture
from farhorizon.pictures.style import DAMAGE, FORMATS, counted_in, number_text, time_text, with_unit
from farhorizon.pictures.traces import spectrum_picture, trace_picture

if TYPE_CHECKING:
    from farhorizon.files.records import Recorded
    from farhorizon.files.results import Results

_FAINT = 1e-6  # of the largest value that is shown: a panel of no more shows rounding and tails
_FEW_REGIONS = 8  # whose outlines do not cover the field
_FLOOR = -60.0  # decibels, unless a range is given
_LEVELS = {"intensity": "energy per frequency and angle", "cross_section": "scattering cross section per angle"}


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
        fifth and a half of the largest magnitude.
    format : {"png", "pdf", "svg"}
    cracks : sequence of ndarray, each of shape (n, dim)
        Polylines, drawn over the fields.
    quantities : mapping of str to str
        What fields are in words ("temperature"), for the titles.

    Raises
    ------
    InputError
        Times, a slice or a range that are not finite, an empty range, an unknown format.
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
    cracks: Sequence[np.ndarray] = ()
    quantities: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.times is not None and not np.isfinite(np.asarray(self.times, dtype=float)).all():
            raise InputError("the times of the pictures are finite numbers", value=list(self.times))
        if self.limits is not None and not (np.isfinite(self.limits).all() and self.limits[0] < self.limits[1]):
            raise InputError("a range goes from a number to a larger one", value=self.limits, key="--range")
        if self.deformed is not None and not (np.isfinite(self.deformed) and self.deformed >= 0):
            raise InputError("the factor must be positive", value=self.deformed, key="--deformed")
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
                say(f"t = {time:g} is not stored; drawn is t = {outputs[k]:.6g}, the nearest")
        return sorted(set(found))

    def slices(self, results: Results) -> list[_Slice]:
        """The slices that are drawn.

        Raises
        ------
        InputError
            One lies outside, or the lattice is not three-dimensional.
        """
        if self.planes and results.dim != 3:
            raise InputError("only a lattice in space is sliced", value=f"{results.dim}D", limit="3D", key="--slice")
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
            suffix = f"-{name}={place:g}" if len(self.planes) > 1 else ""
            found.append(_Slice(("xyz".index(name), int(np.abs(axis - place).argmin())), suffix))
        return found or [_Slice(None, "")]

    def levels(self, values: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Magnitudes in decibels below the largest of them, which is not zero."""
        top = max(float(np.nanmax(np.abs(one), initial=0.0)) for one in values)
        low = self.limits[0] if self.limits else _FLOOR
        with np.errstate(divide="ignore"):
            return [np.maximum(20 * np.log10(np.abs(one) / top), low) for one in values]


class _Slice(NamedTuple):
    """Axis and index of a slice, None for all of the lattice, and what the names of its pictures end in."""

    plane: tuple[int, int] | None
    suffix: str


@dataclass(frozen=True)
class _Scalar:
    """A scalar that is drawn: a field, the length of a vector field, a component of it, or what follows from it."""

    name: str
    label: str
    field: str
    of: Callable[[np.ndarray], np.ndarray]
    pure: bool = False  # a number without a unit, and nothing that the case has a word for

    @property
    def quantity(self) -> str:
        """What it is measured as."""
        if self.field.startswith("stress_"):
            return "stress"
        return "" if self.pure else "time" if self.field == "dissolved" else self.field


def _parts(results: Results) -> Iterator[_Scalar]:
    for name in results.field_names:
        count = results.components[name]
        if count == 1:
            yield _Scalar(name, name, name, lambda values: values)
            continue
        yield _Scalar(name, f"|{name}|", name, magnitude)
        for i, axis in enumerate("xyz"[:count]):
            yield _Scalar(f"{name}_{axis}", f"{name}_{axis}", name, itemgetter(i))


def _derived(results: Results) -> Iterator[_Scalar]:
    """What is drawn of displacements in the plane and in space when it is asked for: of waves the P and the S part."""
    for name in results.field_names:
        if results.components[name] == results.dim > 1:
            yield _Scalar(f"{name}_divergence", f"div {name}", name, partial(_divergence, results.spacing), True)
            yield _Scalar(f"{name}_curl", f"curl {name}", name, partial(_curl, results.spacing), True)


def _slopes(spacing: float, values: np.ndarray) -> np.ndarray:
    """Derivatives of a vector field along the axes by differences of second order, shape (dim, dim, ...)."""
    axes = tuple(range(len(values)))
    order: Literal[1, 2] = 2 if min(values.shape[1:]) > 2 else 1
    return np.stack([np.stack(np.gradient(one, spacing, axis=axes, edge_order=order)) for one in values])


def _divergence(spacing: float, values: np.ndarray) -> np.ndarray:
    return np.asarray(np.trace(_slopes(spacing, values)))


def _curl(spacing: float, values: np.ndarray) -> np.ndarray:
    """In the plane the component across it, in space the length."""
    slopes = _slopes(spacing, values)
    parts = [slopes[i, j] - slopes[j, i] for i, j in ((1, 0), (2, 1), (0, 2))[: 1 if len(values) == 2 else 3]]
    return parts[0] if len(parts) == 1 else magnitude(np.stack(parts))


def _wanted(results: Results, names: Sequence[str] | None) -> list[_Scalar]:
    plain = {part.name: part for part in _parts(results)}
    parts = plain | {part.name: part for part in _derived(results)}
    stresses = [name for name in plain if name.startswith("stress_")]
    if names is not None and stresses:
        names = [part for name in names for part in (stresses if name == "stress" else [name])]
    for name in names or ():
        if name not in parts:
            raise InputError("the file has no such field", value=name, limit=", ".join(parts), key="--field")
    return [parts[name] for name in (plain if names is None else dict.fromkeys(names))]


def plot_results(
    results: Results, out_dir: str | Path, view: View | None = None, say: Callable[[str], None] = lambda text: None
) -> list[Path]:
    """Draw a results file: each field at some times, the probes and the energy.

    The pictures of a field share one colour scale unless its largest value changes more than fivefold between them.
    Panels of zeros are left out.

    Parameters
    ----------
    results : Results
    out_dir : str or Path
        Directory of the pictures; made if there is none.
    view : View, optional
        What is drawn, and how.
    say : callable, optional
        Told in words what is drawn otherwise than asked for.

    Returns
    -------
    list of Path
        ``FIELD.png`` for every field, of vectors their length beside ``FIELD_x.png`` and so on (``front.png`` for the
        times of dissolution), ``probes.png``, of receivers ``NAME_QUANTITY.png``, of a far field ``NAME_pattern.png``,
        ``energy.png`` and ``balance.png`` where they were recorded; ``deformed.png``; ``FIELD.gif`` and ``FIELD.mp4``
        of a movie.

    Raises
    ------
    InputError
        A field that the file does not have, a slice outside, a deformed shape of what is no elastic run in 2D, a movie
        of one output.
    FileFormatError
        The results file is damaged.
    """
    with counted_in(results.units):
        return _drawn(results, Path(out_dir), view or View(), say)


def _drawn(results: Results, directory: Path, view: View, say: Callable[[str], None]) -> list[Path]:
    """Draw what a view asks for."""
    chosen, parts, slices = view.chosen(results, say), _wanted(results, view.fields), view.slices(results)
    if view.deformed is not None:
        frames = [(_moment(results, k), *_strained(results, k)) for k in chosen]
        directory.mkdir(parents=True, exist_ok=True)
        path = directory / f"deformed.{view.format}"
        deformed_panels(frames, results.axes, path, factor=view.deformed)
        return [path]
    first = parts if view.fields else parts[:1]  # the others where they are asked for: films take their time
    if view.isosurfaces is not None:
        return [path for part in first for path in _surfaces(results, directory, view, chosen, part)]
    if view.movie:
        return [
            path for part, one in product(first, slices) for path in _movie(results, directory, view, chosen, part, one)
        ]
    directory.mkdir(parents=True, exist_ok=True)
    written, regions = [], _regions(results)
    for part, one in product(parts if chosen else (), slices):
        if part.name == "dissolved" and results.dim > 1:
            written.append(directory / f"front{one.suffix}.{view.format}")
            outside = np.isnan(results.field("u", 0)) if "u" in results.field_names else None
            front(
                results.field(part.name, chosen[-1]),
                results.axes,
                written[-1],
                outside=outside,
                cracks=view.cracks,
                plane=one.plane,
            )
        else:
            told = say if one == slices[0] else lambda text: None
            written += _panels(results, directory, view, chosen, part, one, regions, told)
    return written if view.fields is not None else [*written, *_histories(results, directory, view.format)]


def _panels(
    results: Results,
    directory: Path,
    view: View,
    chosen: Sequence[int],
    part: _Scalar,
    one: _Slice,
    regions: Regions | None,
    say: Callable[[str], None],
) -> list[Path]:
    """Draw one part of a field at the chosen times; nothing if it is zero at all of them."""
    drawn = chosen if part.name != "dissolved" else chosen[-1:]  # the last one tells all
    found = {k: part.of(results.field(part.field, k)) for k in drawn}
    empty = [k for k, values in found.items() if not np.nan_to_num(values).any()]
    if len(empty) == len(found):
        say(f"{part.label} is zero everywhere: no picture")
        return []
    sizes = {k: float(np.abs(np.nan_to_num(values)).max()) for k, values in found.items()}
    scaled = view.decibels or view.limits is not None
    faint = [k for k in drawn if 0 < sizes[k] < _FAINT * max(sizes.values()) and not scaled]
    for left_out, what in ((empty, "zero everywhere"), (faint, f"below {_FAINT:g} of its largest value")):
        if left_out:
            moments = ", ".join(f"{results.times[k]:.4g}" for k in left_out)
            say(f"{part.label} is {what} at t = {moments}: left out")
    kept = [k for k in drawn if k not in empty + faint]
    solids = [_solid(results, k) for k in kept] if "dissolved" in results.field_names else []
    path, shown = directory / f"{part.name}{one.suffix}.{view.format}", [found[k] for k in kept]
    limits = view.limits
    if view.decibels:
        shown, limits = view.levels(shown), limits or (_FLOOR, 0.0)
        label = f"{part.label.strip('|')} (dB below the largest)"
    else:
        label = with_unit(part.label, part.quantity)
    broken = part.name == "damage"  # shows the cracks, those cut in advance among them
    damage = [] if broken or "damage" not in results.field_names else [results.field("damage", k) for k in kept]
    given: dict[str, Any] = {
        "shared_scale": limits is not None or comparable(shown),
        "cracks": () if broken else view.cracks,
        "label": label,
        "colors": DAMAGE if broken and not view.decibels else None,
        "limits": limits,
        "title": view.quantities.get(part.quantity, ""),
        "smooth": not (broken or solids),
        "broken": damage,
        "regions": regions,
    }
    panels = [(_moment(results, k), values) for k, values in zip(kept, shown, strict=True)]
    if results.dim == 3 and one.plane is None and not solids:
        slice_panels(panels, results.axes, path, **given)
    else:
        field_panels(panels, results.axes, path, solids=solids, plane=one.plane, **given)
    return [path]


def _regions(results: Results) -> Regions | None:
    """Of what nodes are made, where a picture can tell it."""
    few = 1 < len(results.region_names) <= _FEW_REGIONS and results.dim > 1 and "dissolved" not in results.field_names
    return Regions(results.regions, results.region_names) if few else None


def _movie(
    results: Results, directory: Path, view: View, chosen: Sequence[int], part: _Scalar, one: _Slice
) -> list[Path]:
    """Draw the chosen outputs one after the other."""
    values = [part.of(results.field(part.field, k)) for k in chosen]
    label, limits = with_unit(part.label, part.quantity), view.limits
    if view.decibels and any(np.nan_to_num(one).any() for one in values):
        values, limits = view.levels(values), limits or (_FLOOR, 0.0)
        label = f"{part.label.strip('|')} (dB below the largest)"
    title = view.quantities.get(part.quantity, "")
    frames = [
        (", ".join(filter(None, (title, _moment(results, k)))), field) for k, field in zip(chosen, values, strict=True)
    ]
    broken = part.name == "damage"
    return movie(
        frames,
        results.axes,
        directory / f"{part.name}{one.suffix}",
        label=label,
        limits=limits,
        cracks=() if broken else view.cracks,
        colors=DAMAGE if broken and not view.decibels else None,
        plane=one.plane,
    )


def _surfaces(results: Results, directory: Path, view: View, chosen: Sequence[int], part: _Scalar) -> list[Path]:
    """Draw surfaces of one part of a field at the chosen times but those at which it is zero."""
    found = {k: part.of(results.field(part.field, k)) for k in chosen}
    fields = [(_moment(results, k), values) for k, values in found.items() if np.nan_to_num(values).any()]
    figure = isosurface_panels(
        fields or [(_moment(results, k), values) for k, values in found.items()],
        results.axes,
        None,
        levels=view.isosurfaces or None,
        cracks=view.cracks,
        label=with_unit(part.label, part.quantity),
        title=view.quantities.get(part.quantity, ""),
    )
    directory.mkdir(parents=True, exist_ok=True)
    path = directory / f"{part.name}-surfaces.{view.format}"
    figure.savefig(path, dpi=150)
    return [path]


def _strained(results: Results, index: int) -> tuple[np.ndarray, str, np.ndarray]:
    """Displacements of an output, and what colours them: name and values."""
    if results.dim != 2 or results.components.get("u") != 2:
        raise InputError(
            "only a run in 2D with displacements has a deformed shape",
            value=f"{results.dim}D, u of {results.components.get('u', 0)} components",
            key="--deformed",
        )
    u = results.field("u", index)
    damaged = "damage" in results.field_names
    return u, *(("damage", results.field("damage", index)) if damaged else ("|u|", magnitude(u)))


def _histories(results: Results, directory: Path, ending: str) -> list[Path]:
    """Draw what was recorded over time: probes, energy, balance."""
    written = []
    moments, values = results.probe_times, results.probe_values
    if moments.size:
        names = [
            ", ".join(f"{axis} = {number_text(x, results.spacing)}" for axis, x in zip("xyz", place, strict=False))
            for place in results.probes
        ]
        if values.ndim > 2:
            names = [f"u_{axis} at {name}" for name in names for axis in "xyz"[: values.shape[2]]]
            values = values.reshape(len(values), -1)
        written.append(directory / f"probes.{ending}")
        title = f"probe at {names[0]}" if len(names) == 1 else ""
        curves = [(name, *_recorded(moments, column)) for name, column in zip(names, values.T, strict=True)]
        ylabel = with_unit("probe value", "u")
        lines(curves, written[-1], xlabel=with_unit("t", "time"), ylabel=ylabel, title=title)
    for name, one in results.recorded.items():
        for quantity in one.data if len(one.times) > 1 and not one.medium else ():
            for column, traces in _distinct(one.columns(quantity)).items():
                written.append(directory / f"{name}_{column}.{ending}")
                trace_picture(one.points, one.times, traces, written[-1], label=with_unit(column, quantity))
        if one.directions:
            written += _pattern(one, directory / f"{name}.{ending}")
            continue
        for quantity in one.spectra:
            for column, sums in _distinct(one.columns(quantity)).items():
                written.append(directory / f"{name}_{column}.{ending}")
                spectrum_picture(one.points, one.frequencies, sums, written[-1], label=column)
    history, energy = results.history_times, results.energy
    if np.isfinite(energy).any():
        moments, energies = _recorded(history, energy)
        log = bool((energies > 0).all() and energies.max() > 100 * energies.min())
        written.append(directory / f"energy.{ending}")
        lines([("energy", moments, energies)], written[-1], xlabel=with_unit("t", "time"), ylabel="energy", log=log)
    if results.balance:
        written.append(directory / f"balance.{ending}")
        curves = [(name, *_recorded(history, values)) for name, values in results.balance.items()]
        ylabel = "energy" if "kinetic" in results.balance else "gain since the start, and inflow"
        lines(curves, written[-1], xlabel=with_unit("t", "time"), ylabel=ylabel)
    return written


def _distinct(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The components of a quantity without those below the diagonal of a tensor that is symmetric: "stress_yx"."""
    found: dict[str, np.ndarray] = {}
    for name, values in columns.items():
        quantity, _, letters = name.rpartition("_")
        above = found.get(f"{quantity}_{letters[::-1]}") if len(letters) == 2 else None
        if above is None or not np.array_equal(above, values):
            found[name] = values
    return found


def _pattern(records: Recorded, path: Path) -> list[Path]:
    """Draw the levels of a pattern over its directions; on a line there are but two."""
    if records.dim == 1:
        return []
    levels = {name: values for name, values in records.spectra.items() if name.startswith(tuple(_LEVELS))}
    what = next(what for what in _LEVELS if next(iter(levels)).startswith(what))
    waves = {name.removeprefix(f"{what}_"): values for name, values in levels.items()}
    polar_picture(records.points, records.frequencies, waves, path, _LEVELS[what])
    return [path]


def _moment(results: Results, index: int) -> str:
    """The title of a panel: its time, and what makes the field doubtful by then."""
    time = float(results.times[index])
    doubts = (caution.brief for caution in results.cautions if caution.time <= time)
    return ", ".join([f"t = {time_text(time)}", *doubts])


def _solid(results: Results, index: int) -> np.ndarray:
    """Which nodes of an output are solid: those without a time of dissolution that lie in the window."""
    metal = np.isnan(results.field("dissolved", index))
    return metal & np.isfinite(results.field("u", index)) if "u" in results.field_names else metal


def _recorded(times: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of a history in which a value was recorded."""
    kept = np.isfinite(values)
    return times[kept], values[kept]

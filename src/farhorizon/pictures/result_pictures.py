"""Pictures of a results file: fields at given times, probes and other histories."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from farhorizon.errors import InputError
from farhorizon.files.region_numbers import Regions
from farhorizon.pictures.deformed import deformed_panels
from farhorizon.pictures.fields import comparable, field_panels, magnitude, slice_panels
from farhorizon.pictures.fronts import front
from farhorizon.pictures.histories import history_pictures
from farhorizon.pictures.images import unhidden
from farhorizon.pictures.isosurfaces import isosurface_panels
from farhorizon.pictures.movie import movie
from farhorizon.pictures.scalars import Scalar, wanted_scalars
from farhorizon.pictures.style import DAMAGE, SEQUENTIAL, counted_in, time_text
from farhorizon.pictures.views import FLOOR, Slice, View
from farhorizon.pictures.words import axis_label, in_words

if TYPE_CHECKING:
    from farhorizon.files.results import Results

_FAINT = 1e-6  # of the largest value that is shown: fainter panels show only rounding and tails
_MARKS = "*\N{DAGGER}\N{DOUBLE DAGGER}\N{SECTION SIGN}"  # marks of the cautions that make a field doubtful
_FEW_REGIONS = 8  # largest number of regions whose outlines do not hide the field


def plot_results(
    results: Results, out_dir: str | Path, view: View | None = None, say: Callable[[str], None] = lambda text: None
) -> list[Path]:
    """Draw a results file: each field at given times, the probes and the energy.

    The panels of a field share one colour scale unless its largest value changes more than fivefold between them.
    Panels in which a field is zero are left out.

    Parameters
    ----------
    results : Results
    out_dir : str or Path
        Directory of the pictures, created if it does not exist.
    view : View, optional
        What to draw, and how.
    say : callable, optional
        Called with a message about each deviation from what was requested.

    Returns
    -------
    list of Path
        ``FIELD.png`` for each field, which for vectors shows their length, next to ``FIELD_x.png`` and so on for the
        components (``front.png`` for the times of dissolution); ``probes.png``, ``NAME_QUANTITY.png`` for receivers,
        ``NAME_pattern.png`` for a far field, ``energy.png`` and ``balance.png`` if they were recorded;
        ``deformed.png``; ``FIELD.gif`` and ``FIELD.mp4`` for a movie.

    Raises
    ------
    InputError
        The file does not contain a field, a slice lies outside, a deformed shape is requested of a run that is not
        elastic and 2D, or a movie of a single output.
    FileFormatError
        The results file is damaged.
    """
    with counted_in(results.units):
        return _drawn(results, Path(out_dir), view or View(), say)


def _drawn(results: Results, directory: Path, view: View, say: Callable[[str], None]) -> list[Path]:
    """Draw what a view requests."""
    chosen, parts, slices = view.chosen(results, say), wanted_scalars(results, view.fields), view.slices(results)
    if view.deformed is not None:
        frames = [(_moment(results, k), *_strained(results, k)) for k in chosen]
        directory.mkdir(parents=True, exist_ok=True)
        path = directory / f"deformed{view.suffix}.{view.format}"
        named = "damage" if "damage" in results.field_names else "|u|"
        label = axis_label(named, named.strip("|"), view.quantities)
        deformed_panels(
            frames,
            results.axes,
            path,
            factor=view.deformed,
            label=label,
            title=_doubts(results, chosen),
            colors=DAMAGE if named == "damage" else SEQUENTIAL,
        )
        return [path]
    first = parts if view.fields else parts[:1]  # the others only on request, since films take time
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
    if view.fields is None:
        written += history_pictures(results, directory, view.format, view.quantities)
    return written


def _panels(
    results: Results,
    directory: Path,
    view: View,
    chosen: Sequence[int],
    part: Scalar,
    one: Slice,
    regions: Regions | None,
    say: Callable[[str], None],
) -> list[Path]:
    """Draw one scalar at the chosen times; nothing if it is zero at all of them."""
    drawn = chosen if part.name != "dissolved" else chosen[-1:]  # the last one contains all times
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
        shown, limits = view.levels(shown), limits or (FLOOR, 0.0)
    label = _label(part, view)
    broken = part.name == "damage"  # damage shows the cracks, including initial ones
    over = _broken(results, kept, view, part)
    seen = [unhidden(values, hidden) for values, hidden in zip(shown, over, strict=True)] if over else shown
    given: dict[str, Any] = {
        "shared_scale": limits is not None or comparable(seen),
        "cracks": () if broken else view.cracks,
        "label": label,
        "colors": DAMAGE if broken and not view.decibels else None,
        "limits": limits,
        "title": _doubts(results, kept),
        "smooth": not (broken or solids),
        "broken": over,
        "regions": regions,
    }
    panels = [(_moment(results, k), values) for k, values in zip(kept, shown, strict=True)]
    if results.dim == 3 and one.plane is None and not solids:
        slice_panels(panels, results.axes, path, **given)
    else:
        field_panels(panels, results.axes, path, solids=solids, plane=one.plane, **given)
    return [path]


def _regions(results: Results) -> Regions | None:
    """Regions of the nodes, if there are few enough to draw, otherwise None."""
    few = 1 < len(results.region_names) <= _FEW_REGIONS and results.dim > 1 and "dissolved" not in results.field_names
    return Regions(results.regions, results.region_names) if few else None


def _movie(
    results: Results, directory: Path, view: View, chosen: Sequence[int], part: Scalar, one: Slice
) -> list[Path]:
    """Draw the chosen outputs one after the other as a film."""
    values = [part.of(results.field(part.field, k)) for k in chosen]
    label, limits = _label(part, view), view.limits
    if view.decibels and any(np.nan_to_num(one).any() for one in values):
        values, limits = view.levels(values), limits or (FLOOR, 0.0)
    frames = [(_moment(results, k), field) for k, field in zip(chosen, values, strict=True)]
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
        title=_doubts(results, chosen),
        broken=_broken(results, chosen, view, part),
    )


def _surfaces(results: Results, directory: Path, view: View, chosen: Sequence[int], part: Scalar) -> list[Path]:
    """Draw isosurfaces of one scalar at the chosen times, except those at which it is zero."""
    found = {k: part.of(results.field(part.field, k)) for k in chosen}
    fields = [(_moment(results, k), values) for k, values in found.items() if np.nan_to_num(values).any()]
    figure = isosurface_panels(
        fields or [(_moment(results, k), values) for k, values in found.items()],
        results.axes,
        None,
        levels=view.isosurfaces or None,
        cracks=view.cracks,
        label=axis_label(part.label, part.quantity, view.quantities),
        title=_doubts(results, chosen),
    )
    directory.mkdir(parents=True, exist_ok=True)
    path = directory / f"{part.name}-surfaces{view.suffix}.{view.format}"
    figure.savefig(path)
    return [path]


def _strained(results: Results, index: int) -> tuple[np.ndarray, np.ndarray]:
    """Displacements of an output, and the values for their colours: damage, or their lengths."""
    if results.dim != 2 or results.components.get("u") != 2:
        raise InputError(
            "only a run in 2D with displacements has a deformed shape",
            value=f"{results.dim}D, "
            + (f"u of {count} components" if (count := results.components.get("u")) else "no u"),
            key="--deformed",
        )
    u = results.field("u", index)
    return u, results.field("damage", index) if "damage" in results.field_names else magnitude(u)


def _label(part: Scalar, view: View) -> str:
    """Label of the colours of a scalar."""
    if view.decibels:
        return f"{in_words(part.label, view.quantities)} (dB below the largest)"
    return axis_label(part.label, part.quantity, view.quantities)


def _moment(results: Results, index: int) -> str:
    """Title of a panel: its time, and the marks of the cautions that apply by then."""
    time = float(results.times[index])
    marks = (mark for mark, caution in zip(_MARKS, results.cautions, strict=False) if caution.time <= time)
    return f"t = {time_text(time)}{''.join(marks)}"


def _doubts(results: Results, chosen: Sequence[int]) -> str:
    """Explanation of the marks at the chosen times."""
    last = float(results.times[list(chosen)].max(initial=-np.inf))
    marked = zip(_MARKS, results.cautions, strict=False)
    return "; ".join(f"{mark} {caution.brief}" for mark, caution in marked if caution.time <= last)


def _broken(results: Results, chosen: Sequence[int], view: View, part: Scalar) -> list[np.ndarray]:
    """Fraction of broken bonds of each node at the chosen times, to be drawn over a scalar that does not show it.

    Bonds of initial cracks that are drawn as lines do not count.
    """
    if part.name == "damage" or "damage" not in results.field_names:
        return []
    lines = len(view.cracks) > 0 and results.times[0] == 0
    cut = results.field("damage", 0) if lines else 0.0
    return [results.field("damage", k) - cut for k in chosen]


def _solid(results: Results, index: int) -> np.ndarray:
    """Solid nodes of an output: nodes in the window without a time of dissolution."""
    metal = np.isnan(results.field("dissolved", index))
    return metal & np.isfinite(results.field("u", index)) if "u" in results.field_names else metal

"""Commands on results files: plot, and merge, which makes one file of those of several processes."""

from __future__ import annotations

import argparse
from contextlib import suppress
from pathlib import Path

from farhorizon.cli.common import GOOD

_NAMED = 6  # most times listed in a file name


def plot_command(options: argparse.Namespace) -> int:
    from farhorizon.case.case import Case
    from farhorizon.errors import InputError
    from farhorizon.files.results import open_results
    from farhorizon.pictures.result_pictures import plot_results
    from farhorizon.pictures.views import View

    path = Path(options.result)
    folder = Path(options.out) if options.out else path.with_suffix("")
    results = open_results(path, verify=False)
    try:
        case: Case | None = Case(results.case, path)
    except InputError:  # written from Python, or by a version with other keys
        case = None
    view = View(
        times=options.times,
        fields=options.field,
        planes=list(map(_plane, options.slice)),
        limits=None if options.range is None else tuple(options.range),
        decibels=options.db,
        deformed=options.deformed,
        movie=options.movie,
        isosurfaces=options.isosurfaces,
        format=options.format,
        suffix=_suffix(options),
        cracks=results.outlines.get("cracks", ()),
        quantities=case.quantities if case else {},
    )
    for picture in plot_results(results, folder, view, print):
        print(picture)
    return GOOD


def _suffix(options: argparse.Namespace) -> str:
    """Suffix that distinguishes the names of these pictures from those of the run, which must not be overwritten."""
    named = [f"{time:g}" for time in options.times or ()]
    times = ",".join(named) if len(named) <= _NAMED else f"{named[0]}..{named[-1]},{len(named)}"
    limits = ",".join(f"{limit:g}" for limit in options.range or ())
    return "".join([f"-t={times}" if times else "", f"-range={limits}" if limits else "", "-dB" if options.db else ""])


def _plane(text: str) -> tuple[str, float]:
    """Axis and position of a slice such as z=0.5."""
    import math

    from farhorizon.errors import InputError

    axis, _, place = text.partition("=")
    with suppress(ValueError):
        if axis.strip() in ("x", "y", "z") and math.isfinite(float(place)):
            return axis.strip(), float(place)
    raise InputError("a slice is an axis and a number", value=text, key="--slice", remedy="--slice z=0.5")


def merge_command(options: argparse.Namespace) -> int:
    from farhorizon.files.results import open_results

    path = Path(options.result)
    results = open_results(path, verify=False)
    made = results.merge(path.with_name(f"{path.stem}-merged{path.suffix}") if options.out is None else options.out)
    print(f"{made}: {len(results.times)} outputs of {', '.join(results.field_names)}")
    return GOOD

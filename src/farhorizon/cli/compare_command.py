"""`farhorizon compare`, and `farhorizon demo`, which compares a case that is shipped with the program."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from farhorizon.cli.common import GOOD, case_of, check_folder, thread_change, write_json


def _compare_case(
    options: argparse.Namespace, case: Any, folder: Path, times: Sequence[float] | None, moment: float | None
) -> None:
    import numpy as np

    from farhorizon.pictures.curves import error_history
    from farhorizon.pictures.fields import field_panels
    from farhorizon.pictures.panels import Look, Panel, magnitude
    from farhorizon.pictures.style import counted_in, time_text, with_unit
    from farhorizon.pictures.words import axis_label
    from farhorizon.studies.compare import compare

    with case.naming():
        result = compare(case.setup, case.end, times, moment)
    print(result.table())
    shown = {
        name: value if value.ndim == case.lattice.dim else magnitude(value)
        for name, value in result.fields.items()
        if name != "free edge"
    }
    folder.mkdir(parents=True, exist_ok=True)
    picture, history = folder / "compare.png", folder / "error.png"
    named = "|u|" if any(value.ndim > case.lattice.dim for value in result.fields.values()) else "u"
    curves = {name: (np.array(c["times"]), np.array(c["error_rel_initial"])) for name, c in result.curves.items()}
    with counted_in(case.unit_names):
        panels = [Panel(f"{name}, t = {time_text(result.shown_time)}", value) for name, value in shown.items()]
        look = Look(axis_label(named, "u", case.quantities), cracks=case.polylines, smooth=True)
        field_panels(panels, case.lattice.axes, picture, look)
        above, below = f"max error / {result.scale}", with_unit("t", "time")
        error_history(curves, history, above, "Error against the infinite medium", xlabel=below)
    print(f"pictures: {picture}, {history}")
    if options.quiet:
        print(f"{case.name}: {result.headline}", file=options.output)
    write_json(options.json, result.as_json())


def compare_command(options: argparse.Namespace) -> int:
    check_folder(options.out)
    case = case_of(options)
    _compare_case(options, case, Path(options.out) / case.name, options.times, None)
    return GOOD


def demo_command(options: argparse.Namespace) -> int:
    check_folder(options.out)
    from importlib.resources import files

    from farhorizon.case.case import Case

    text = files("farhorizon.case").joinpath("demo.toml").read_text(encoding="utf-8")
    case = Case(text, "two_notches.toml", thread_change(options))
    print("An infinite membrane with two notches, seen through a disc of radius 26 (example 3 of Hermann et al. 2023).")
    print(
        "Running it with the lattice PML, with a fixed and a free edge, and on a domain from which nothing returns ..."
    )
    _compare_case(options, case, Path(options.out), None, 30.0)
    return GOOD

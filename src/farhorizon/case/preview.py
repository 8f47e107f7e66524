"""What `farhorizon check` adds to the report of a case: pictures of its nodes and materials, and how long the whole
command takes, of which the steps are often the smallest part.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from farhorizon.case.case import Case
from farhorizon.checks.certificate import UNDECIDED
from farhorizon.checks.report import Report, seconds
from farhorizon.machine import without_collection
from farhorizon.pictures.fields import field_panels
from farhorizon.pictures.panels import Look, Panel, Plane
from farhorizon.pictures.words import axis_label
from farhorizon.rounding import MARGIN
from farhorizon.simulation.recorders.quantities import fields_of
from farhorizon.simulation.run import Run, modes_budget
from farhorizon.simulation.setup.regions import uneven
from farhorizon.simulation.time.output import RunResults


def draw_geometry(case: Case, run: Run, folder: Path) -> list[Path]:
    """Draw whatever varies from node to node in a case and a run of it at its start; call it within `counted_in`.

    The files are ``NAME-nodes.png`` for a body or a window, ``NAME-coefficient.png``, ``NAME-metal.png``, for a body of
    several materials ``NAME-young.png`` and so on; in 3D slices through the middle, ``NAME-nodes-x.png`` and so on.
    There are none for a uniform medium that fills its box.
    """
    paths, lattice = [], case.lattice
    planes = [Plane.middle(lattice.shape, normal) for normal in range(3)] if lattice.dim == 3 else [None]
    for name, values in _uneven(case, run):
        for plane in planes:
            paths.append(folder / f"{case.name}-{name}{'' if plane is None else '-' + 'xyz'[plane.normal]}.png")
            look = Look(axis_label(name, name), plane=plane, cracks=case.polylines)
            field_panels([Panel("", values)], lattice.axes, paths[-1], look)
    return paths


def _uneven(case: Case, run: Run) -> Iterator[tuple[str, np.ndarray]]:
    """Names and values of everything that varies from node to node."""
    mask = case.lattice.mask
    if mask is not None:
        yield "nodes", mask.astype(float)
    for name, values in uneven(run).items():
        yield name, np.where(True if mask is None else mask, values, np.nan)


_PANELS = 4  # panels of a picture


def whole_time(case: Case, run: Run, report: Report, start: float) -> dict[str, float]:
    """Seconds that each part of a run (at its start, with the probes of the case) takes on this machine; a row about
    them is added to its report.

    Files and pictures are timed by a trial: two outputs, a checkpoint and a picture, in a temporary folder. `start` is
    the time from the start of the command to the first step, without compilation.
    """
    outputs = 1 + int(np.ceil(report.numbers["steps"] * run.dt / case.every(run.dt) - MARGIN))
    certificate, steps = report.certificate, report.numbers["seconds"]
    examined = certificate is not None and certificate.verdict != UNDECIDED  # and cached: `run` reads it
    with TemporaryDirectory() as folder:
        files, pictures = _files(case, run, Path(folder), outputs), _pictures(case, run, Path(folder))
    parts = {
        "start": start,
        "examination": 0.0 if examined else modes_budget(run, report.until),
        "steps": steps,
        "files": files,
        "pictures": pictures,
    }
    total = sum(parts.values())
    # parts of less than a hundredth are not worth a word
    shown = ", ".join(f"{name} {seconds(part)}" for name, part in parts.items() if part > 0.01 * total)
    report.numbers["seconds_in_all"] = total
    report.rows.append(("time in all", f"about {seconds(total)}: {shown} ({outputs} outputs)"))
    return parts


def _files(case: Case, run: Run, folder: Path, outputs: int) -> float:
    """Seconds for `outputs` outputs and two checkpoints."""
    out = case.parts.output
    made = RunResults.begin(run, folder / "a.h5", case.fields, dtype=out.dtype, compress=out.compress)
    made.append()
    begin = time.perf_counter()
    values, balance = fields_of(run, made.own.fields), run.balance() if made.own.accounts else None
    made.own.append(run.step_count + 1, run.dt, values, energy=run.energy(), balance=balance)
    an_output = time.perf_counter() - begin
    run.save(folder / "a.ckpt")
    return outputs * an_output + 2 * (time.perf_counter() - begin - an_output)


def _pictures(case: Case, run: Run, folder: Path) -> float:
    """Seconds for all pictures of a run: each takes as long as the trial one, and plotting modules are loaded once."""
    from farhorizon.pictures.snapshot import scalars

    fields = fields_of(run, case.fields)
    drawn = scalars(fields, case.lattice.dim)
    more = 1 + bool(case.parts.output.probes) + case.parts.output.balance + len(run.recorders)
    scalar = next(iter(drawn.values()))
    values = scalar.of(fields[scalar.field])
    begin = time.perf_counter()
    with without_collection():
        from matplotlib.backends import backend_agg  # noqa: F401

        from farhorizon.pictures.fields import field_panels
        from farhorizon.pictures.panels import Panel
    loaded = time.perf_counter() - begin
    field_panels([Panel(f"t = {k}", values) for k in range(_PANELS)], case.lattice.axes, folder / "u.png")
    each = time.perf_counter() - begin - loaded
    return loaded + (len(drawn) + more) * each

"""The HTML page about a run, NAME/report.html: a single file that needs no network and no other files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from farhorizon import __version__
from farhorizon.case.case import Case
from farhorizon.checks.certificate import Certificate
from farhorizon.files.html import listed, page, picture, preformatted, table
from farhorizon.files.provenance import computed_with
from farhorizon.files.region_numbers import Regions
from farhorizon.files.results import Results
from farhorizon.files.storage import replacing
from farhorizon.simulation.run import Run


def write_report(
    path: Path,
    case: Case,
    run: Run,
    certificate: Certificate,
    results: Results,
    pictures: Sequence[Path],
    *,
    threads: int,
    again: str,
    seconds: float,
) -> Path:
    """Write the page about a finished run.

    Parameters
    ----------
    path : Path
        The file; its folder is created.
    case : Case
    run : Run
        The run, at its end.
    certificate : Certificate
        What was known of its stability before it began.
    results : Results
        Its results file.
    pictures : sequence of Path
        PNG files, which are embedded in the page.
    threads : int
        Number of threads that the run was allowed.
    again : str
        The command that continues it; empty if there is no checkpoint.
    seconds : float
        Time that steps and files took.

    Returns
    -------
    Path
        The file.
    """
    machine = [*computed_with(), ("threads", str(threads)), ("steps and files", f"{seconds:.3g} s")]
    cite = (
        f"The farhorizon developers: farhorizon: peridynamics in an unbounded medium, version {__version__}, "
        "BSD-3-Clause; and the papers of the methods that were used, which the docstrings of their classes name."
    )
    kept = [
        ("results", f"{results.path}: {len(results.times)} outputs, opens in ParaView"),
        *([("go on with it", again)] if again else []),
        (
            "check it",
            "farhorizon check reports the step limit, predicted reflection by angle, memory and time of the case",
        ),
    ]
    balance = [(name, f"{values[-1]:.6g}") for name, values in results.balance.items()]
    doubts = [f"not valid from t = {caution.time:.6g} on: {caution.text}" for caution in results.cautions]
    sections = [
        ("Result", listed(doubts, "doubt") + table(_summary(case, run, results))),
        ("Pictures", "".join(picture(one) for one in pictures)),
        ("Probes at the end", table(_probes(results)) if results.probe_times.size else ""),
        ("Balance at the end", table(balance) if balance else ""),
        ("Stability", table([("verdict", certificate.verdict), ("reason", certificate.reason)]) + listed(run.notes)),
        ("Files", table(kept)),
        ("Case", preformatted(case.text)),
        ("Computed with", table(machine)),
        ("To cite", listed([cite])),
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as draft:
        draft.write_text(page(case.name, sections), encoding="utf-8")
    return path


def _summary(case: Case, run: Run, results: Results) -> list[tuple[str, str]]:
    """Rows that summarise what was computed."""
    nodes = " x ".join(map(str, run.lattice.whole.shape))
    shared = f", on {run.team.size} processes" if run.team else ""
    length, time = (f" {results.units[what]}" if what in results.units else "" for what in ("length", "time"))
    rows = [
        ("near field", f"{nodes} nodes, spacing {run.lattice.spacing:g}{length}{shared}"),
        (
            "time",
            f"t = {run.time:g}{time}: {run.step_count} steps of {run.dt:.6g}{time}; outputs {case.schedule(run.dt)}",
        ),
    ]
    rows += [(name, text) for name, text in results.provenance.items() if name == "error of the layers"]
    for name in results.field_names if results.times.size else ():
        values = np.abs(results.field(name, -1))
        if np.isfinite(values).any():
            rows.append((f"largest {name} at the end", f"{np.nanmax(values):.6g}"))
    if results.region_names:
        rows.append(("materials", str(Regions(results.regions, results.region_names))))
    energy = results.energy[np.isfinite(results.energy)]
    if energy.size:
        what = "energy" if case.model.order == 2 else "half the integral of (u - background)^2"
        rows.append((what, f"{energy[0]:.6g} at the start, {energy[-1]:.6g} at the end"))
    return rows


def _probes(results: Results) -> list[tuple[str, str]]:
    """Final values of the probes, by position."""
    last = results.probe_values[-1]
    return [
        (", ".join(f"{value:g}" for value in place), ", ".join(f"{value:.6g}" for value in np.atleast_1d(values)))
        for place, values in zip(results.probes.tolist(), last, strict=True)
    ]

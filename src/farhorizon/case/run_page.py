"""The HTML page about a run, NAME/report.html: a single file that needs no network and no other files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
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


@dataclass(frozen=True)
class RunPage:
    """The page about a finished run."""

    case: Case
    run: Run  # at its end
    certificate: Certificate  # made before it began
    results: Results
    pictures: Sequence[Path]  # PNG files, which are embedded in the page
    threads: int  # that the run was allowed
    again: str  # the command that continues it; empty if there is no checkpoint
    seconds: float  # for steps and files

    def write(self, path: Path) -> Path:
        """Write the page, and return its path; its folder is created."""
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as draft:
            draft.write_text(page(self.case.name, self._sections()), encoding="utf-8")
        return path

    def _sections(self) -> list[tuple[str, str]]:
        """Heads and contents, as HTML."""
        results, certificate = self.results, self.certificate
        machine = [*computed_with(), ("threads", str(self.threads)), ("steps and files", f"{self.seconds:.3g} s")]
        cite = (
            f"The farhorizon developers: farhorizon: peridynamics in an unbounded medium, version {__version__}, "
            "BSD-3-Clause; and the papers of the methods that were used, which the docstrings of their classes name."
        )
        check = "farhorizon check reports the step limit, predicted reflection by angle, memory and time of the case"
        files = [
            ("results", f"{results.path}: {len(results.times)} outputs, opens in ParaView"),
            *([("go on with it", self.again)] if self.again else []),
            ("check it", check),
        ]
        balance = [(name, f"{values[-1]:.6g}") for name, values in results.balance.items()]
        doubts = [f"not valid from t = {caution.time:.6g} on: {caution.text}" for caution in results.cautions]
        stability = table([("verdict", certificate.verdict), ("reason", certificate.reason)])
        return [
            ("Result", listed(doubts, "doubt") + table(self._summary())),
            ("Pictures", "".join(map(picture, self.pictures))),
            ("Probes at the end", table(self._probes()) if results.probe_times.size else ""),
            ("Balance at the end", table(balance) if balance else ""),
            ("Stability", stability + listed(self.run.notes)),
            ("Files", table(files)),
            ("Case", preformatted(self.case.text)),
            ("Computed with", table(machine)),
            ("To cite", listed([cite])),
        ]

    def _summary(self) -> list[tuple[str, str]]:
        """Rows that summarise what was computed."""
        case, run, results = self.case, self.run, self.results
        nodes = " x ".join(map(str, run.lattice.whole.shape))
        processes = f", on {run.team.size} processes" if run.team else ""
        length, time = (f" {results.units[name]}" if name in results.units else "" for name in ("length", "time"))
        steps = f"{run.step_count} steps of {run.dt:.6g}{time}; outputs {case.schedule(run.dt)}"
        rows = [
            ("near field", f"{nodes} nodes, spacing {run.lattice.spacing:g}{length}{processes}"),
            ("time", f"t = {run.time:g}{time}: {steps}"),
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

    def _probes(self) -> list[tuple[str, str]]:
        """Final values of the probes, by position."""
        return [
            (", ".join(f"{x:g}" for x in position), ", ".join(f"{value:.6g}" for value in np.atleast_1d(values)))
            for position, values in zip(self.results.probes.tolist(), self.results.probe_values[-1], strict=True)
        ]

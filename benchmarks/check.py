"""How long does `farhorizon check` take on the examples?

Each example is checked with an empty cache of certificates, but with compiled programs (a first check compiles them).
The set-up, including the choice of layers, takes as long for a run. The time of the check beyond that is compared with
the run: it may take at most as long as the run, or 5 seconds, and never more than 30. The time of the run is the one
that `check` extrapolates from a few steps. "skipped" is the number of parts of the certificate for which there was no
time; "known" is the statement on stability in the first line of the report.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from common import run_parts, verdict

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.checks.certificate import BUDGET
from farhorizon.checks.report import LEAST
from farhorizon.engine.codegen.build import cache_folder

EXAMPLES = Path(__file__).parents[1] / "examples"
NAMES = (
    "blob",
    "blob_classical",
    "two_notches",
    "waveguide",
    "wave_3d",
    "backward_waves",
    "dispersive_pulse",
    "diffusion_3d",
    "exact_bar",
    "elastic_blast",
    "elastic_3d",
    "half_space",
    "branching",
    "valley",
    "surface_notch",
)


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """One row per example."""
    rows = []
    for name in NAMES:
        if not (EXAMPLES / f"{name}.toml").exists():
            continue
        case = Case.read(EXAMPLES / f"{name}.toml")
        until = case.parts.run.until
        str(_prepared(case).check(until))
        for kept in cache_folder().glob("certificate_*"):
            kept.unlink()
        begin = time.perf_counter()
        sim = _prepared(case)
        ready = time.perf_counter()
        report = sim.check(until)
        str(report)
        spent = time.perf_counter() - ready
        run = report.numbers["seconds"]
        certificate = report.certificate
        assert certificate is not None
        most = min(BUDGET, max(LEAST, run))
        rows.append(
            {
                "example": name,
                "until": until,
                "run": run,
                "set-up": ready - begin,
                "check": spent,
                "allowed": most,
                "certificate": certificate.seconds,
                "skipped": len(certificate.skipped),
                "met": verdict(spent, most, False),
                "known": certificate.in_words(until),
            }
        )
    return rows


def _prepared(case: Case) -> fh.Simulation:
    sim = case.simulation()
    sim.prepare(case.parts.run.until)
    return sim


if __name__ == "__main__":
    run_parts(__doc__, {"examples": ("seconds of check and of the run", measure)})

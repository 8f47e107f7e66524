"""How long does `farhorizon check` take on the examples?

Each example is checked with an empty cache of certificates and with compiled programs that are there (a first check
makes them). What it takes is set against the run: at most as long as that, or 2 seconds, and never above 30. The time
of the run is that which `check` extrapolates from a few steps. "certificate" is its verdict, "skipped" how many
parts of it there was no time for.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from common import run_parts, verdict

from farhorizon.case.case import Case
from farhorizon.checks.report import Report
from farhorizon.engine.rows.build import cache_folder

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
FLOOR, CEILING = 2.0, 30.0  # seconds


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """One row an example."""
    rows = []
    for name in NAMES:
        if not (EXAMPLES / f"{name}.toml").exists():
            continue
        case = Case.read(EXAMPLES / f"{name}.toml")
        until = case.parts.run.until
        str(_checked(case))
        for kept in cache_folder().glob("certificate_*"):
            kept.unlink()
        begin = time.perf_counter()
        report = _checked(case)
        str(report)
        spent = time.perf_counter() - begin
        run = report.numbers["seconds"]
        certificate = report.certificate
        assert certificate is not None
        most = min(CEILING, max(FLOOR, run))
        rows.append(
            {
                "example": name,
                "until": until,
                "run": run,
                "check": spent,
                "allowed": most,
                "certificate s": certificate.seconds,
                "certificate": certificate.verdict,
                "skipped": len(certificate.skipped),
                "met": verdict(spent, most, False),
            }
        )
    return rows


def _checked(case: Case) -> Report:
    sim = case.simulation()
    sim.prepare(case.parts.run.until)
    return sim.check(case.parts.run.until)


if __name__ == "__main__":
    run_parts(__doc__, {"examples": ("seconds of check and of the run", measure)})

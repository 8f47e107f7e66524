"""Common parts of the benchmarks: interleaved timing, bare engines, plain text tables and the --json option."""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon import Kernel, Stencil
from farhorizon.engine.engine import Engine
from farhorizon.medium.integrators import Verlet

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # for the triad, the only loop that OpenMP distributes

SLICE = 0.08  # shortest timed call in seconds: much longer than clock and wake-up, much shorter than changes of load


def arguments(doc: str | None, *choices: str) -> argparse.Namespace:
    """Command line of a benchmark: names of parts (all unless given) and --json FILE."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(choices)}; all unless given")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers here, too")
    parser.add_argument("--repeats", type=int, default=9, help="interleaved repeats of each timing (default 9)")
    parser.add_argument("--count", type=int, default=200, help="random set-ups, where there are any (default 200)")
    parser.add_argument("--first", type=int, default=0, help="number of the first of them (default 0)")
    parser.add_argument("--longest", type=float, default=float("inf"), help="seconds of a run that is made, at most")
    parser.add_argument("--seed", type=int, help="of random set-ups; unless given, one of each part")
    given = parser.parse_args()
    if unknown := set(given.parts) - set(choices):
        parser.error(f"unknown part {', '.join(sorted(unknown))}; known: {', '.join(choices)}")
    given.parts = given.parts or list(choices)
    return given


def run_parts(
    doc: str | None, parts: Mapping[str, tuple[str, Callable[[argparse.Namespace], list[dict[str, Any]]]]]
) -> None:
    """Main function of a benchmark: run the parts named on the command line, print a table of each, and write the JSON
    file.

    A part is a title and a function that takes the options of the command line and returns rows.
    """
    given = arguments(doc, *parts)
    results: list[dict[str, Any]] = []
    for name in given.parts:
        title, measure = parts[name]
        rows = measure(given)
        table(title, rows)
        results += [{"part": name, **row} for row in rows]
    save(given.json, results)


def machine() -> dict[str, Any]:
    """Facts about the machine, without which absolute numbers mean little."""
    return {
        "cpus": os.cpu_count(),
        "load": os.getloadavg()[0],
        "python": platform.python_version(),
        "machine": platform.machine(),
    }


def save(path: Path | None, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows as JSON if a file is given."""
    if path is not None:
        path.write_text(json.dumps({"machine": machine(), "rows": list(rows)}, indent=1) + "\n")


def table(title: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Print rows with equal keys as columns of plain text."""
    names = list(rows[0])
    cells = [names] + [[f"{v:.3g}" if isinstance(v, float) else str(v) for v in row.values()] for row in rows]
    widths = [max(len(line[i]) for line in cells) for i in range(len(names))]
    print(f"\n{title}")
    for line in cells:
        padded = [cell.rjust(w) for cell, w in zip(line, widths, strict=True)]
        print("  ".join([line[0].ljust(widths[0]), *padded[1:]]), flush=True)


def verdict(value: float, target: float, larger: bool) -> str:
    """ "yes" or "MISSED"."""
    return "yes" if (value >= target if larger else value <= target) else "MISSED"


def interleaved(
    cases: Mapping[str, Callable[[int], None]], repeats: int, clock: Callable[[], float] = time.perf_counter
) -> dict[str, list[float]]:
    """Seconds per step of each case, one list entry per round; every round runs every case once.

    A case is called with a number of steps. On a busy machine ``clock=time.process_time`` excludes the time of other
    processes, for one thread. The first calls warm up, and set this number such that a call takes `SLICE`.
    """
    counts = {}
    for name, case in cases.items():
        case(2)
        count, spent = 1, 0.0
        while spent < SLICE / 2:
            count *= 2
            start = clock()
            case(count)
            spent = clock() - start
        counts[name] = max(2, int(count * SLICE / spent))
    times: dict[str, list[float]] = {name: [] for name in cases}
    for _ in range(repeats):
        for name, case in cases.items():
            start = clock()
            case(counts[name])
            times[name].append((clock() - start) / counts[name])
    return times


def ratio(times: Mapping[str, list[float]], above: str, below: str) -> float:
    """Median over rounds of the ratio of two cases; load that lasts for a round cancels."""
    return statistics.median(a / b for a, b in zip(times[above], times[below], strict=True))


def median(times: Mapping[str, list[float]], name: str) -> float:
    """Median seconds per step of a case."""
    return statistics.median(times[name])


def kernel_stencil(dim: int, m: int, volume: str = "ramp") -> Stencil:
    """Stencil of the kernel |xi|^-2 with a horizon of m spacings, spacing 1."""
    return Stencil.from_kernel(Kernel(float(m), 2, volume=volume), 1.0, dim)


def bare_engine(
    stencil: Stencil, core: Sequence[int], threads: int, real: str = "float64", lasting: bool = False
) -> Engine:
    """Wave engine without layers, cuts and sources, with half the stable step and noise as data, which prevents
    denormal numbers.
    """
    lead = 3 - stencil.dim
    offsets = np.zeros((len(stencil.weights), 3), int)
    offsets[:, lead:] = stencil.offsets
    dt = 0.5 * Verlet.step_limit(stencil.symbol_maximum)
    engine = Engine(
        (1,) * lead + tuple(core),
        offsets,
        stencil.weights,
        Verlet.stages(dt, 0.0, stencil.dim == 1, lasting),
        dt,
        layers={},
        real=real,
        threads=threads,
    )
    for level in range(1 if engine.stages.increments else 2):
        engine.core.view(engine.levels[level])[...] = np.random.default_rng(1).standard_normal(engine.core.nodes)
    return engine


def steps(engine: Engine) -> Callable[[int], None]:
    """Compiled loop of an engine without sources as a timing case."""
    return engine.advance

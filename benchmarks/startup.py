"""Waiting times of a user: import, first run of a new stencil, and a second process.

Measures in fresh processes, medians of the repeats:

- import: ``import farhorizon`` in a fresh interpreter, and the packages that take most of this time.
- cold: the first `farhorizon check`, `run` and `demo` of a fresh install (empty caches), and the second ones, by the
  wall clock.
- compile: the first simulation and step ever (empty ``FARHORIZON_CACHE``, so that the time loop is also compiled),
  those of a new stencil after another one on as many axes, and the same in a second process that finds everything
  compiled. Target for a new stencil: 5 s.

Wall-clock times depend on the machine; the ratio of the first to the second run is the gain by the cache.

Run: ``python benchmarks/startup.py [import] [cold] [compile] [--json FILE] [--repeats N]``. Takes about four minutes.
"""

from __future__ import annotations

import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from common import run_parts, verdict

EXAMPLES = Path(__file__).parents[1] / "examples"
TARGET = 5.0  # seconds from a new stencil to its first step

_IMPORT = "import time; t = time.perf_counter(); import farhorizon; print(time.perf_counter() - t)"
_RUN = """
import time
start = time.perf_counter()
import farhorizon as fh
loaded = time.perf_counter()
lattice = fh.Lattice(1.0, (0.0,) * {dim}, ({n} - 1.0,) * {dim})
sim = fh.Simulation(lattice, fh.Wave(fh.Kernel({m}.0)), initial={{"v": 0.0}})
sim.step(1)
first = time.perf_counter()
sim.step(1)
print(loaded - start, first - loaded, time.perf_counter() - first)
"""


def python(code: str, cache: str, *options: str) -> subprocess.CompletedProcess[str]:
    """Run code in a fresh interpreter with a given cache folder."""
    return subprocess.run(
        [sys.executable, *options, "-c", code], capture_output=True, text=True, check=True, env=empty_caches(cache)
    )


def empty_caches(folder: str) -> dict[str, str]:
    """Environment with the compiled code of generated programs and of the package's own modules in a folder."""
    return {**os.environ, "FARHORIZON_CACHE": folder, "NUMBA_CACHE_DIR": f"{folder}/numba"}


def import_time(repeats: int) -> list[dict[str, Any]]:
    """Seconds of the import, and of the slowest packages within it (their own modules, from -X importtime)."""
    with tempfile.TemporaryDirectory() as cache:
        python(_IMPORT, cache)  # writes the bytecode
        total = statistics.median(float(python(_IMPORT, cache).stdout) for _ in range(repeats))
        trace = python("import farhorizon", cache, "-X", "importtime").stderr
    own: dict[str, float] = {}
    for microseconds, name in re.findall(r"import time:\s+(\d+) \|\s+\d+ \|\s+(\S+)", trace):
        package = name.split(".")[0]
        own[package] = own.get(package, 0.0) + 1e-6 * int(microseconds)
    heaviest = sorted(own.items(), key=lambda item: -item[1])[:6]
    return [{"import": "farhorizon", "s": total}] + [
        {"import": f"  {name} (traced)", "s": seconds} for name, seconds in heaviest
    ]


def cold_start(repeats: int) -> list[dict[str, Any]]:
    """Seconds of whole commands by the wall clock, with empty caches and again."""
    rows = []
    for name in ("check", "run", "demo"):
        times: list[list[float]] = [[], []]
        for _ in range(repeats):
            with tempfile.TemporaryDirectory() as folder:
                case = Path(folder) / "blob.toml"
                shutil.copy(EXAMPLES / "blob.toml", case)
                case_of = [] if name == "demo" else [str(case)]
                for number, found in enumerate(times):
                    start = time.perf_counter()
                    command = [sys.executable, "-m", "farhorizon", name, *case_of, "--out", f"{folder}/{number}"]
                    subprocess.run(command, capture_output=True, check=True, env=empty_caches(folder))
                    found.append(time.perf_counter() - start)
        first, second = (statistics.median(found) for found in times)
        rows.append({"farhorizon": name, "first ever s": first, "again s": second, "compiled s": first - second})
    return rows


def compile_time(repeats: int) -> list[dict[str, Any]]:
    """Seconds to the first step if nothing, the time loop, or everything is already compiled on disk."""
    rows = []
    for dim, m, n in ((1, 3, 201), (2, 3, 100), (2, 3, 1000), (2, 6, 100), (3, 2, 20), (3, 3, 20)):
        code = _RUN.format(dim=dim, m=m, n=n)
        fresh, firsts, seconds = [], [], []
        for _ in range(repeats):
            with tempfile.TemporaryDirectory() as cache:
                other = _RUN.format(dim=dim, m=4, n=20)  # compiles the operations for these axes
                fresh.append(float(python(other, cache).stdout.split()[1]))
                firsts.append([float(x) for x in python(code, cache).stdout.split()])
                seconds.append([float(x) for x in python(code, cache).stdout.split()])
        first, second = (statistics.median(row[1] for row in runs) for runs in (firsts, seconds))
        rows.append(
            {
                "stencil": f"{dim}D m={m} {n}^{dim}",
                "first ever s": statistics.median(fresh),
                "new stencil s": first,
                "cached s": second,
                "step ms": 1e3 * statistics.median(row[2] for row in seconds),
                "times faster": first / second,
                "target": TARGET,
                "met": verdict(first, TARGET, larger=False),
            }
        )
    return rows


if __name__ == "__main__":
    run_parts(
        __doc__,
        {
            "import": ("Import time in a fresh process", lambda given: import_time(given.repeats)),
            # compilation is slow, and its time varies little: fewer repeats
            "cold": ("Commands of a fresh install", lambda given: cold_start(max(1, given.repeats // 9))),
            "compile": (
                "From a new stencil to its first step, import not counted",
                lambda given: compile_time(max(1, given.repeats // 9)),
            ),
        },
    )

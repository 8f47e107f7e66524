"""Cost of free faces per step in 3D.

A box of 80^3 nodes with six free faces is compared with one with six fixed faces, whose halo of zeros costs nothing: a
scalar stencil of reach 3 and an elastic one of reach 2, on one thread and on two. Target: a step with free faces takes
at most 1.3 times as long as one with fixed faces. `memory` is that of the free faces, in bytes per node within one
reach of them.

Run: ``python benchmarks/faces.py [--json FILE] [--repeats N]``. Takes about two minutes.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from common import interleaved, median, ratio, run_parts, steps, verdict

import farhorizon as fh
from farhorizon.boundaries import Fixed, Free
from farhorizon.engine.engine import available_threads
from farhorizon.models import LatticeModel

NODES, TARGET = 80, 1.3
MODELS = {
    "scalar, reach 3": lambda: fh.Wave(fh.Kernel(3.0)),
    "elastic, reach 2": lambda: fh.Elastic(fh.Kernel(2.0), young=1.0),
}


def box(model: LatticeModel, side: Free | Fixed, threads: int) -> fh.Simulation:
    """A box with white noise, which prevents denormal numbers."""
    lattice = fh.Lattice(1.0, (0.0,) * 3, (NODES - 1.0,) * 3)
    components = 1 if isinstance(model, fh.Wave) else 3
    shape = lattice.shape if components == 1 else (components, *lattice.shape)
    start = np.random.default_rng(1).standard_normal(shape)
    return fh.Simulation(lattice, model, side, {"u": start}, threads=threads)


def faces(given: argparse.Namespace) -> list[dict[str, Any]]:
    """Time of a step with free faces over that with fixed faces."""
    rows = []
    for name, make in MODELS.items():
        for threads in sorted({1, min(2, available_threads())}):
            free, fixed = (box(make(), side, threads) for side in (Free(), Fixed()))
            times = interleaved({"free": steps(free.engine), "fixed": steps(fixed.engine)}, given.repeats)
            found = ratio(times, "free", "fixed")
            near = NODES**3 - (NODES - 2 * free.stencil.reach[0]) ** 3
            rows.append(
                {
                    "80^3": name,
                    "threads": threads,
                    "fixed ms": 1e3 * median(times, "fixed"),
                    "free / fixed": found,
                    "memory": (free.engine.nbytes - fixed.engine.nbytes) / near,
                    "target": TARGET,
                    "met": verdict(found, TARGET, larger=False),
                }
            )
    return rows


if __name__ == "__main__":
    run_parts(__doc__, {"faces": ("Free faces in space", faces)})

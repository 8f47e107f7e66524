"""Cost of a far field per wave step.

Measures, in one process with interleaved repeats, the processor time of `Simulation.step` on 1000^2 nodes, m = 3, one
thread, with a far field relative to without (medians of the ratios of a round): sums at 20 frequencies on the shell of
the widest box (24 000 nodes) and of one of 200^2 nodes, aim: at most 10 % more; and the history on the shell of the
widest box.

Run: ``python benchmarks/far_field.py [shell] [--json FILE] [--repeats N]``. Takes about a minute.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from common import interleaved, median, ratio, run_parts, verdict

import farhorizon as fh

HALF, REACH = 500.0, 3
SEED = 20261123


class Passing(fh.FarField):
    """A far field whose history is dropped, so that a long measurement fits into memory."""

    def add(self, step: int, heard: Any) -> None:
        """Add a step as `FarField` does, and drop the history."""
        super().add(step, heard)
        self._rows = []


def simulation(*observe: Any) -> fh.Simulation:
    """Simulation with noise in the middle, which prevents denormal numbers."""
    noise = np.random.default_rng(SEED).standard_normal((int(2 * HALF) + 1,) * 2)
    lattice = fh.Lattice(1.0, (-HALF, -HALF), (HALF, HALF))
    x, y = lattice.coordinates()
    start = np.where(np.maximum(abs(x), abs(y)) < 90, noise, 0.0)
    boundary, model = fh.LatticePML(nodes=12), fh.Wave(fh.Kernel(float(REACH)))
    return fh.Simulation(lattice, model, boundary, {"u": start}, threads=1, observe=observe)


def shell(repeats: int) -> list[dict[str, Any]]:
    """Time of a step with far fields over that without."""
    frequencies, small = np.linspace(0.005, 0.1, 20), fh.Box((-100.0, -100.0), (100.0, 100.0))
    cases: dict[str, tuple[fh.FarField, float | None]] = {
        "20 frequencies, widest box": (fh.FarField(frequencies=frequencies, history=False), 10.0),
        "20 frequencies, 200^2": (fh.FarField(small, frequencies, history=False), 10.0),
        "history, widest box": (Passing(), None),
    }
    sims = {"none": simulation(), **{name: simulation(far) for name, (far, _) in cases.items()}}
    times = interleaved({name: sim.step for name, sim in sims.items()}, repeats, time.process_time)
    rows = []
    for name, (_, aim) in cases.items():
        added = 100 * (ratio(times, name, "none") - 1)
        met = "-" if aim is None else verdict(added, aim, larger=False)
        rows.append({"far field": name, "step ms": 1e3 * median(times, name), "added %": added, "aim": aim, "met": met})
    return rows


if __name__ == "__main__":
    run_parts(__doc__, {"shell": ("Far fields", lambda given: shell(given.repeats))})

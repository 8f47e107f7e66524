"""What the exact boundary adds to a step of the bar of Ji et al. (2021): 201 nodes, K = 7, exact on both ends.

Measures, in one process with interleaved repeats (medians of the ratios of a round), a step of `farhorizon.analysis.bar.Bar`

- with free ends, the interior alone;
- with both ends compressed to 1e-6, 1e-9, 1e-12 until T = 400, dt = 0.02. Target: at most 1.6 times the interior;
- on the extended domain, as many nodes a side as let nothing return until T = 400 (error 2e-13 at 2050 a side). Target: at least twice the
  time of the compressed ends.

Run: ``python benchmarks/exact.py [step] [--json FILE] [--repeats N]``. Takes a quarter of a minute.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from common import arguments, interleaved, median, ratio, save, table, verdict

from farhorizon.analysis.bar import Bar
from farhorizon.analysis.chain import Recursion, band, force_form, ghost_kernel
from farhorizon.analysis.exponential_sum import compress
from farhorizon.integrators import Verlet
from farhorizon.papers.ji2021 import bar_weights

DT, STEPS, BEYOND = 0.02, 20_000, 2050


def step(repeats: int) -> list[dict[str, Any]]:
    """Rows of the table."""
    weights, recursion = bar_weights(), Recursion.of(Verlet(), DT)
    noise = np.random.default_rng(1).standard_normal(201)
    kernel = force_form(ghost_kernel(weights, recursion, STEPS), weights)
    bars = {"interior": Bar(weights, recursion, noise), "extended domain": Bar(weights, recursion, np.pad(noise, BEYOND, mode="reflect"))}
    modes = {}
    for tolerance in (1e-6, 1e-9, 1e-12):
        found = compress(kernel, tolerance, band(weights, recursion))
        name = f"compressed to {tolerance:g}"
        modes[name] = found.modes
        timed = replace(found, steps=10**12)  # timing goes on for longer than the sum is good for
        bars[name] = Bar(weights, recursion, noise, ends=(timed, timed))
    times = interleaved({name: bar.run for name, bar in bars.items()}, repeats)
    rows = []
    for name in bars:
        cost = ratio(times, name, "interior")
        row = {"case": name, "modes": modes.get(name, ""), "us a step": 1e6 * median(times, name), "times interior": cost}
        gain = ratio(times, "extended domain", name)
        reached = verdict(cost, 1.6, False) + ", " + verdict(gain, 2.0, True) if name in modes else ""
        rows.append({**row, "extended / this": gain, "<= 1.6, >= 2": reached})
    table("bar of 201 nodes, K = 7, T = 400", rows)
    return rows


if __name__ == "__main__":
    given = arguments(__doc__, "step")
    save(given.json, step(given.repeats))

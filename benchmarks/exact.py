"""What the exact boundary adds to a step of the bar of Ji et al. (2021): 201 nodes, K = 7, exact on both ends.

Measures, in one process with interleaved repeats (medians of the ratios of a round), a step of the engine

- with fixed ends, the interior alone;
- with both ends compressed to 1e-6, 1e-9, 1e-12 until T = 400, dt = 0.02. Target: at most 1.6 times the interior;
- on the extended domain, as many nodes a side as let nothing return until T = 400 (error 2e-13 at 2050 a side). Target: at least twice the
  time of the compressed ends.

Run: ``python benchmarks/exact.py [step] [--json FILE] [--repeats N]``. Takes a quarter of a minute.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from common import arguments, interleaved, median, ratio, save, steps, table, verdict

from farhorizon import Exact, Fixed, Lattice, Simulation, Stencil, Wave
from farhorizon.papers.ji2021 import SPACING, bar_weights

DT, STEPS, BEYOND = 0.02, 20_000, 2050


def bar(boundary: Exact | Fixed, beyond: int = 0) -> Simulation:
    """The bar with noise as data."""
    offsets = np.concatenate([np.arange(1, 8), -np.arange(1, 8)])[:, None]
    model = Wave(Stencil(offsets, np.tile(bar_weights(), 2)), speed=SPACING)
    lattice = Lattice(SPACING, -10 - beyond * SPACING, 10 + beyond * SPACING)
    u = np.pad(np.random.default_rng(1).standard_normal(201), beyond, mode="reflect")
    return Simulation(lattice, model, boundary, {"u": u}, dt=DT, threads=1)


def timed(sim: Simulation) -> Callable[[int], None]:
    """The engine's loop as a timing case. The clock is put back: timing goes on for longer than the sums are good for."""
    run = steps(sim.engine)

    def call(count: int) -> None:
        sim.engine.clock[0] = 0
        run(count)

    return call


def step(repeats: int) -> list[dict[str, Any]]:
    """Rows of the table."""
    sims = {"interior": bar(Fixed()), "extended domain": bar(Fixed(), BEYOND)}
    modes = {}
    for tolerance in (1e-6, 1e-9, 1e-12):
        name = f"compressed to {tolerance:g}"
        sims[name] = bar(Exact(tolerance))
        sims[name].prepare(STEPS * DT)
        modes[name] = sims[name].ends["x-"].split()[0]
    times = interleaved({name: timed(sim) for name, sim in sims.items()}, repeats)
    rows = []
    for name in sims:
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

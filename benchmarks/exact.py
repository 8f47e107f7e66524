"""Cost of the exact boundary per step of the bar of Ji et al. (2021): 201 nodes, K = 7, both ends exact.

Measures, in one process with interleaved repeats (medians of the ratios of a round), a step of the engine

- with fixed ends, which is the interior alone;
- with both ends compressed to 1e-6, 1e-9, 1e-12 until T = 400, dt = 0.02. Target: at most 1.6 times the interior;
- on the smallest extended domain (to a dozen nodes) with the same error at T = 400, where the error of the compressed
  ends is measured against a domain from whose ends nothing returns. Target: at least twice the time of the compressed
  ends.

Run: ``python benchmarks/exact.py [step] [--json FILE] [--repeats N]``. Takes a minute.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from common import interleaved, median, ratio, run_parts, steps, verdict

from farhorizon import Exact, Fixed, Lattice, Simulation, Stencil, Wave
from farhorizon.papers.ji2021 import SPACING, bar_weights

DT, STEPS = 0.02, 20_000
FAR = 2200  # nodes per side from which nothing returns: the fastest waves (10 nodes per time unit) turn back at 2000


def bar(boundary: Exact | Fixed, beyond: int = 0) -> Simulation:
    """The bar with noise as data and zeros beyond."""
    offsets = np.concatenate([np.arange(1, 8), -np.arange(1, 8)])[:, None]
    model = Wave(Stencil(offsets, np.tile(bar_weights(), 2)), speed=SPACING)
    lattice = Lattice(SPACING, -10 - beyond * SPACING, 10 + beyond * SPACING)
    u = np.pad(np.random.default_rng(1).standard_normal(201), beyond)
    return Simulation(lattice, model, boundary, {"u": u}, dt=DT, threads=1)


def timed(sim: Simulation) -> Callable[[int], None]:
    """Loop of the engine as a timing case; its clock is reset, since timing takes longer than the sums hold."""
    run = steps(sim.engine)

    def call(count: int) -> None:
        sim.engine.put("ends.clock", 0)
        run(count)

    return call


def end_of_run(boundary: Exact | Fixed, beyond: int = 0) -> np.ndarray:
    """Field of the bar at T = 400."""
    sim = bar(boundary, beyond)
    sim.run(STEPS * DT, progress=False)
    return sim.fields["u"][beyond : beyond + 201]


def smallest(error: float, infinite: np.ndarray) -> int:
    """Nodes per side, to a dozen, of the smallest domain with fixed edges whose error is at most `error`."""
    low, high = 1700, FAR
    while high - low > 12:
        middle = (low + high) // 2
        low, high = (low, middle) if np.abs(end_of_run(Fixed(), middle) - infinite).max() <= error else (middle, high)
    return high


def step(repeats: int) -> list[dict[str, Any]]:
    """Rows of the table."""
    infinite = end_of_run(Fixed(), FAR)
    sims = {"interior": bar(Fixed())}
    found = {}
    for tolerance in (1e-6, 1e-9, 1e-12):
        name = f"compressed to {tolerance:g}"
        sims[name] = bar(Exact(tolerance))
        sims[name].prepare(STEPS * DT)
        error = float(np.abs(end_of_run(Exact(tolerance)) - infinite).max())
        beyond = smallest(error, infinite)
        sims[f"extended {name}"] = bar(Fixed(), beyond)
        found[name] = {"modes": sims[name].ends["x-"].split()[0], "error": error, "extended by": beyond}
    times = interleaved({name: timed(sim) for name, sim in sims.items()}, repeats)
    rows = []
    for name, facts in found.items():
        cost, gain = ratio(times, name, "interior"), ratio(times, f"extended {name}", name)
        rows.append(
            {
                "case": name,
                **facts,
                "interior us": 1e6 * median(times, "interior"),
                "us a step": 1e6 * median(times, name),
                "times interior": cost,
                "<= 1.6": verdict(cost, 1.6, False),
                "extended / this": gain,
                ">= 2": verdict(gain, 2.0, True),
            }
        )
    return rows


if __name__ == "__main__":
    run_parts(__doc__, {"step": ("bar of 201 nodes, K = 7, T = 400", lambda given: step(given.repeats))})

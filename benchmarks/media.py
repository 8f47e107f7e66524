"""Cost of media that vary: a step over that of the uniform medium, on one thread.

Strata (a third of the lattice is another medium), inclusions (balls of a tenth of its width, a seventh of its volume),
and a medium that varies from node to node; for waves, bonds and states, in 2D and 3D, between fixed sides and, as
"layers", with absorbing layers of eight nodes.

Run: ``python benchmarks/media.py [--json FILE] [--repeats N]``. Takes about two minutes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from common import interleaved, ratio, run_parts, steps

import farhorizon as fh

NODES = {2: 300, 3: 60}


def media(dim: int) -> dict[str, np.ndarray]:
    """Young's modulus, or the wave speed, at the nodes for each medium."""
    n, random = NODES[dim], np.random.default_rng(4)
    at = np.indices((n,) * dim)
    balls = np.ones((n,) * dim)
    for centre in np.stack(np.meshgrid(*[np.arange(n / 8, n, n / 4)] * dim), -1).reshape(-1, dim):
        balls[((at - centre.reshape(-1, *[1] * dim)) ** 2).sum(0) < (n / 12) ** 2] = 1.3
    return {
        "strata": np.where(at[-1] < n // 3, 1.3, np.ones((n,) * dim)),
        "inclusions": balls,
        "everywhere": random.uniform(1, 1.3, (n,) * dim),
    }


def models(dim: int, value: Any) -> dict[str, Any]:
    """Models that are measured."""
    wide, solid = fh.Kernel(3.0), fh.Kernel(2.0, exponent=1)
    return {
        "waves": fh.Wave(wide, value),
        "bonds": fh.Elastic(solid, value),
        "states": fh.Elastic(solid, value, poisson=0.3, material="state-based"),
    }


def simulation(dim: int, model: Any, boundary: Any) -> fh.Simulation:
    """Simulation with noise, which prevents denormal numbers."""
    lattice = fh.Lattice(1.0, (0.0,) * dim, (NODES[dim] - 1.0,) * dim)
    sim = fh.Simulation(lattice, model, boundary, threads=1)
    field = sim.engine.core.view(sim.engine.current)
    field[...] = np.random.default_rng(1).standard_normal(field.shape)
    return sim


def measure(repeats: int) -> list[dict[str, Any]]:
    """Ratios of the times of steps."""
    rows = []
    for dim in (2, 3):
        for sides, boundary in (("fixed", fh.Fixed()), ("layers", fh.LatticePML(nodes=8))):
            for name, uniform in models(dim, 1.0).items():
                row: dict[str, Any] = {"dim": dim, "sides": sides, "model": name}
                plain = steps(simulation(dim, uniform, boundary).engine)
                for medium, values in media(dim).items():
                    if sides == "layers" and medium != "strata":
                        continue  # media do not vary along the normal of a layer
                    varied = steps(simulation(dim, models(dim, values)[name], boundary).engine)
                    row[medium] = ratio(interleaved({"varied": varied, "plain": plain}, repeats), "varied", "plain")
                rows.append({**row, **{medium: row.get(medium, "-") for medium in media(dim)}})
    return rows


if __name__ == "__main__":
    run_parts(__doc__, {"media": ("Media that vary", lambda given: measure(given.repeats))})

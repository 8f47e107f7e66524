"""Energy that running cracks spend relative to the specified fracture energy of their material.

Cracks in the infinite plane with random angles to the lattice, and random speeds and strengths of the pair of forces
that they follow (`farhorizon.studies.toughness.running_crack`). Cracks that do not follow their forces are counted, but
their energy is not. The critical stretch is the calibrated one.

- bonds, states, correspondence: three, three and four nodes in the horizon, 0.2 to 0.3 of the Rayleigh wave speed.
  Target: all within 5 %.
- coarse: correspondence with three nodes. fast: with four, at 0.35 to 0.4 of that speed.

Run: ``python benchmarks/toughness.py [PART ...] [--count N] [--seed S] [--json FILE]``. Ten cracks take a minute.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from common import run_parts, verdict

from farhorizon import Elastic, Kernel, calibrated_stretch
from farhorizon.studies.toughness import rayleigh_speed, running_crack

ENERGY, TARGET = 1e-4, 0.05
SLOW, FAST = (0.2, 0.3), (0.35, 0.4)
PUSHES = 1.1, 1.5
MOST_ANGLE = np.pi / 4


def drawn(material: str, random: np.random.Generator) -> dict[str, Any]:
    """Random options of a material."""
    found: dict[str, Any] = {"kernel": Kernel(1.0, int(random.integers(0, 2)))}
    if material == "bond-based":
        return found
    found |= {"material": material, "poisson": random.uniform(0.15, 0.3)}
    if random.random() < 0.3:
        found["plane"] = "stress"
    return found if material == "state-based" else found | {"stabilisation": random.uniform(0.2, 0.35)}


def cracks(
    material: str, nodes: int, speeds: tuple[float, float], given: argparse.Namespace, each: int = 4
) -> list[dict[str, Any]]:
    """One row per random material, with `each` cracks."""
    seed = np.random.SeedSequence().entropy % 2**32 if given.seed is None else given.seed
    print(f"seed {seed}", flush=True)
    random, rows = np.random.default_rng(seed), []
    for _ in range(max(1, given.count // each)):
        model = Elastic(young=1.0, **drawn(material, random))
        model.critical_stretch = calibrated_stretch(model, 1 / nodes, ENERGY)
        fastest, spent, largest = rayleigh_speed(model.lame, model.shear, model.density), [], 0.0
        for _ in range(each):
            found = running_crack(
                model,
                1 / nodes,
                ENERGY,
                random.uniform(*speeds),
                random.uniform(0, MOST_ANGLE),
                random.uniform(*PUSHES),
            )
            largest = max(largest, float(np.nanmax(found.tips.data["speed"])) / fastest)
            if found.follows:
                spent.append(found.spent / ENERGY)
        off = max((abs(one - 1) for one in spent), default=np.inf)
        rows.append(
            {
                "exponent": model.kernel.exponent,
                "plane": model.plane or "strain",
                "Poisson": round(model.poisson, 3),
                "stabilisation": round(model.stabilisation, 3),
                "follow": f"{len(spent)}/{each}",
                "least": min(spent, default=np.nan),
                "most": max(spent, default=np.nan),
                "speed/c_R": largest,
                "5 %": verdict(off, TARGET, larger=False),
            }
        )
        print(rows[-1], flush=True)
    return rows


def part(
    material: str, nodes: int, speeds: tuple[float, float] = SLOW
) -> tuple[str, Callable[[argparse.Namespace], list[dict[str, Any]]]]:
    """Title and function of a part of the benchmark."""
    title = f"{material}, {nodes} nodes in the horizon, {speeds[0]:g} to {speeds[1]:g} c_R"
    return title, partial(cracks, material, nodes, speeds)


if __name__ == "__main__":
    run_parts(
        __doc__,
        {
            "bonds": part("bond-based", 3),
            "states": part("state-based", 3),
            "correspondence": part("correspondence", 4),
            "coarse": part("correspondence", 3),
            "fast": part("correspondence", 4, FAST),
        },
    )

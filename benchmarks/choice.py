"""Does a layer that is chosen by angle meet its target, and how much thicker is it than need be?

Random waves on a line and in the plane: kernels, steps, targets, angles and pulses that are zero to the target where the near field ends. What the
layer sends back is computed for plane waves between those that the choice looked at, and the run's error is measured against the infinite lattice.
The thinnest layer is sought in the same family of profiles, three times as many of them.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from common import run_parts, verdict

import farhorizon as fh
from farhorizon.analysis import choice
from farhorizon.analysis.chain import Recursion
from farhorizon.compare import compare
from farhorizon.report import content

SEED, CASES, BETWEEN = 7, 100, 200
STEEP = 60.0, 80.0  # degrees: a pulse in the plane sends waves to the sides at such angles, which a smaller one would leave out


def random_setup(random: np.random.Generator) -> dict[str, Any]:
    """A pulse somewhere in a near field that holds it."""
    dim = int(random.integers(1, 3))
    reach, target = int(random.integers(1, 6)), 10.0 ** -random.uniform(3, 8)
    influence = str(random.choice(["constant", "linear", "gaussian"])) if reach > 1 else "constant"
    width, places = random.uniform(2.0, 5.0), random.uniform(-8, 8, dim)
    half = np.ceil(np.abs(places).max() + width * np.sqrt(np.log(1e3 / target))) + reach

    def pulse(*x: np.ndarray) -> np.ndarray:
        return np.exp(-sum((a - c) ** 2 for a, c in zip(x, places, strict=True)) / width**2)

    return {
        "lattice": fh.Lattice(1.0, (-half,) * dim, (half,) * dim), "model": fh.Wave(fh.Kernel(float(reach), 2, influence)), "initial": {"u": pulse},
        "boundary": fh.LatticePML(target=target, angle=float(random.uniform(*STEEP))), "dt": float(random.choice([0.3, 0.5, 0.8])),
    }  # fmt: skip


def thinner(sim: fh.Simulation, boundary: fh.LatticePML, waves: list[choice.Wave], nodes: int) -> int:
    """The thinnest layer of a finer family that meets the target."""
    members = choice.family(sim.stencil.reach[0], sim.stencil.dim)
    strengths, shifts = {p.strength for p in members}, {p.shift for p in members}
    finer = [
        choice.Profile(s, k, p, a) for p in sorted({p.power for p in members}) for a in np.linspace(0, max(shifts), 5 if max(shifts) else 1)
        for k in np.geomspace(1, max(p.stretch for p in members), 4) for s in np.geomspace(min(strengths), max(strengths), 15)
    ]  # fmt: skip
    found = nodes
    while found > 1 and any(choice.worst(waves, p, found - 1, 1.0, 1.0, boundary.wanted(2)) <= boundary.wanted(2) for p in finer):
        found -= 1
    return found


def cases(options: argparse.Namespace) -> list[dict[str, Any]]:
    """One row: how many of the random cases meet their target, by plane waves and by runs, and the thickness over the thinnest."""
    random = np.random.default_rng(SEED)
    plane, run, ratios = [], [], []
    for number in range(CASES):
        setup = random_setup(random)
        boundary, dim = setup["boundary"], setup["lattice"].dim
        limit = fh.Simulation(**{**setup, "dt": None, "boundary": fh.LatticePML()}).step_limit
        setup["dt"] *= limit
        sim = fh.Simulation(**setup)
        chosen = sim.choices["x-"]
        recursion = Recursion.of(sim.model.integrator, sim.dt)
        waves = content(sim)
        assert waves is not None
        low, high = max(waves.shortest, 2.0), waves.longest
        looked_at = choice.sample(sim.stencil, 1.0, recursion, sim.dt, (low, high), boundary.angle)
        between = [
            choice.plane_wave(sim.stencil, 1.0, recursion, sim.dt, w, a)
            for w, a in zip(np.exp(random.uniform(np.log(low), np.log(high), BETWEEN)), random.uniform(0, boundary.angle, BETWEEN), strict=True)
        ]
        plane.append(choice.worst(between, chosen.profile, chosen.nodes, 1.0, 1.0) / boundary.target)
        half = sim.lattice.shape[0] / 2
        result = compare(setup, (8 if dim == 1 else 6) * half, np.linspace(0.5, 6, 23) * half, beside=False)
        run.append(max(next(iter(result.curves.values()))["error_rel_initial"]) / boundary.target)
        ratios.append(chosen.nodes / thinner(sim, boundary, looked_at, chosen.nodes))
        if options.repeats == 1 or plane[-1] > 1 or run[-1] > 1:
            text = f"{dim}D {setup['model'].operator} half {half:g} target {boundary.target:.1e} angle {boundary.angle:.0f}"
            text += f": {chosen.nodes} nodes, {chosen}; plane waves {plane[-1]:.2f}, run {run[-1]:.2g} of the target"
            print(f"{number}: {text}, thickness {ratios[-1]:.2f}", flush=True)
    met = float(np.mean(np.array(run) <= 1))
    return [{
        "cases": CASES, "plane waves meet": float(np.mean(np.array(plane) <= 1)), "runs meet": met, "aim": 0.95, "met": verdict(met, 0.95, True),
        "median run / target": float(np.median(run)), "thickness, worst": max(ratios), "aim ": 1.25, "met ": verdict(max(ratios), 1.25, False),
    }]  # fmt: skip


if __name__ == "__main__":
    run_parts(__doc__, {"cases": (f"{CASES} random waves, layers chosen by angle", cases)})

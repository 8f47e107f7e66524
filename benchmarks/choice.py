"""Does a layer that is chosen by angle meet its target, and how much thicker is it than need be?

Random waves on a line and in the plane: kernels of exponent 0 to 2, steps, targets, angles and pulses that are zero to the target where the near
field ends. Where layers must damp strong backward waves, the pulses are those that they promise to absorb: their spectrum has fallen to 1.5e-5 at 8
nodes a wave and at 60 % of the first backward wavenumber. What the layer sends back is computed for plane waves between those that the choice looked
at, and the run's error is measured against the infinite lattice. The thinnest layer is sought in the same family of profiles, three times as many.
"""

from __future__ import annotations

import argparse
import itertools
from functools import partial
from typing import Any

import numpy as np
from common import run_parts, verdict

import farhorizon as fh
from farhorizon.analysis import choice
from farhorizon.analysis.chain import Recursion
from farhorizon.analysis.layer import Medium, Wave
from farhorizon.analysis.short_waves import HighPass, high_pass
from farhorizon.compare import compare
from farhorizon.report import content

SEEDS = {"cases": 7, "others": 8}
CASES, BETWEEN = 100, 200
FALLEN = 6.66  # exp(-(k width/2)^2) has fallen to 1.5e-5 at k = 6.66/width
STEEP = 60.0, 80.0  # degrees: a pulse in the plane sends waves to the sides at such angles, which a smaller one would leave out


def random_setup(random: np.random.Generator) -> dict[str, Any]:
    """A pulse somewhere in a near field that holds it."""
    dim = int(random.integers(1, 3))
    exponent = int(random.choice([0, 1, 2], p=[0.25, 0.35, 0.4]))
    reach = int(random.integers(1, 4 if exponent == 0 else 7))
    influence = str(random.choice(["constant", "linear", "gaussian"])) if reach > 1 else "constant"
    model = fh.Wave(fh.Kernel(float(reach), exponent, influence))
    damped = strong_damping(model.stencil(1.0, dim))
    target = 10.0 ** -random.uniform(3, 7 if damped else 8)
    width, places = random.uniform(2.0, 5.0), random.uniform(-8, 8, dim)
    if damped:
        width = random.uniform(1.0, 1.5) * FALLEN / min(np.pi / 4, 0.6 * damped.first)
    half = np.ceil(np.abs(places).max() + width * np.sqrt(np.log(1e3 / target))) + reach

    def pulse(*x: np.ndarray) -> np.ndarray:
        return np.exp(-sum((a - c) ** 2 for a, c in zip(x, places, strict=True)) / width**2)

    return {
        "lattice": fh.Lattice(1.0, (-half,) * dim, (half,) * dim), "model": model, "initial": {"u": pulse},
        "boundary": fh.LatticePML(target=target, angle=float(random.uniform(*STEEP))), "dt": float(random.choice([0.3, 0.5, 0.8])),
    }  # fmt: skip


def strong_damping(stencil: fh.Stencil) -> HighPass | None:
    """The damping of short waves, where it shares in what a layer sends back."""
    damped = high_pass(stencil)
    return None if choice.weak(damped) else damped


def thinner(medium: Medium, target: float, waves: list[Wave], nodes: int) -> int:
    """The thinnest layer of a finer family that meets the target."""
    damped = high_pass(medium.stencil)
    members = choice.family(medium.stencil, damped)
    strengths, shifts = {p.strength for p in members}, {p.shift for p in members}
    powers, alphas = sorted({p.power for p in members}), np.linspace(0, max(shifts), 5 if max(shifts) else 1)
    stretches = np.geomspace(1, max(p.stretch for p in members), 4 if choice.weak(damped) else 1)
    finer = [
        choice.Profile(s, k, p, a, members[0].smooth)
        for p, a, k, s in itertools.product(powers, alphas, stretches, np.geomspace(min(strengths), max(strengths), 15))
    ]
    found = nodes
    while found > 1 and any(choice.worst(waves, p.layer(found - 1, 1.0, 1.0, damped), target) <= target for p in finer):
        found -= 1
    return found


def cases(options: argparse.Namespace, seed: int) -> list[dict[str, Any]]:
    """How many of the random cases meet their target, by plane waves and by runs, and the thickness over the thinnest; a refusal counts as a miss."""
    random = np.random.default_rng(seed)
    plane, run, ratios, damped = [], [], [], []
    for number in range(CASES):
        setup = random_setup(random)
        boundary, dim = setup["boundary"], setup["lattice"].dim
        damped.append(strong_damping(setup["model"].stencil(1.0, dim)) is not None)
        limit = fh.Simulation(**{**setup, "dt": None, "boundary": fh.LatticePML(target=boundary.target)}).step_limit
        setup["dt"] *= limit
        try:
            sim = fh.Simulation(**setup)
        except fh.InputError as error:
            print(f"{number}: refused, {error}", flush=True)
            for missed, value in ((plane, np.inf), (run, np.inf), (ratios, 1.0)):
                missed.append(value)
            continue
        chosen = sim.choices["x-"]
        medium = Medium(sim.stencil, 1.0, 1.0, Recursion.of(sim.model.integrator, sim.dt), sim.dt)
        waves = content(sim)
        assert waves is not None
        low, high = max(waves.shortest, 2.0), waves.longest
        looked_at = choice.sample(medium, (low, high), boundary.angle)
        between = [
            medium.plane_wave(w, a)
            for w, a in zip(
                np.exp(random.uniform(np.log(low), np.log(high), BETWEEN)),
                random.uniform(0, boundary.angle if dim > 1 else 0.0, BETWEEN),
                strict=True,
            )
        ]
        plane.append(choice.worst(between, next(iter(sim.engine.layers.values()))) / boundary.target)
        half = sim.lattice.shape[0] / 2
        result = compare(setup, (8 if dim == 1 else 6) * half, np.linspace(0.5, 6, 23) * half, beside=False)
        run.append(max(next(iter(result.curves.values()))["error_rel_initial"]) / boundary.target)
        ratios.append(chosen.nodes / thinner(medium, boundary.target, looked_at, chosen.nodes))
        if options.repeats == 1 or plane[-1] > 1 or run[-1] > 1 or ratios[-1] > 1.25:
            text = f"{'damped ' * damped[-1]}{dim}D {setup['model'].operator} half {half:g} target {boundary.target:.1e} angle {boundary.angle:.0f}"
            text += f": {chosen.nodes} nodes, {chosen}; plane waves {plane[-1]:.2f}, run {run[-1]:.2g} of the target"
            print(f"{number}: {text}, thickness {ratios[-1]:.2f}", flush=True)
    kinds = {"all": np.ones(CASES, bool), "strong damping": np.array(damped), "none or weak": ~np.array(damped)}
    return [_summary(name, *(np.array(v)[which] for v in (plane, run, ratios))) for name, which in kinds.items()]


def vectors(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Elastic pulses in the plane: nodes of the layer that is chosen, and the run's error over the target."""
    half, rows = 30.0, []
    models = {
        "bonds, reach 2": fh.Elastic(fh.Kernel(2.0, 1), 1.0), "bonds, reach 3": fh.Elastic(fh.Kernel(3.0, 1), 1.0),
        "bonds, gaussian": fh.Elastic(fh.Kernel(3.0, 2, "gaussian"), 1.0), "elements": fh.Elastic(None, 1.0, 0.3, material="finite-element"),
        "correspondence": fh.Elastic(fh.Kernel(1.5), 1.0, 0.3, material="correspondence", stabilisation=0.5),
    }  # fmt: skip

    def pulse(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.exp(-(x**2 + y**2) / 25)

    for (name, model), (target, angle) in itertools.product(models.items(), ((1e-4, 60.0), (1e-6, 70.0))):
        setup = {"lattice": fh.Lattice(1.0, (-half, -half), (half, half)), "model": model, "boundary": fh.LatticePML(target=target, angle=angle),
                 "initial": {"u": [pulse, lambda x, y: 0.5 * pulse(x, y)]}}  # fmt: skip
        chosen = fh.Simulation(**setup).choices["x-"]
        (curve,) = compare(setup, 5 * half / model.p_speed, beside=False).curves.values()
        rows.append(
            {"model": name, "target": target, "angle": angle, "nodes": chosen.nodes, "run / target": max(curve["error_rel_initial"]) / target}
        )
    return rows


def _summary(name: str, plane: np.ndarray, run: np.ndarray, ratios: np.ndarray) -> dict[str, Any]:
    met, worst = float(np.mean(run <= 1)), float(ratios.max())
    return {
        "kernels": name, "cases": len(run), "plane waves meet": float(np.mean(plane <= 1)), "runs meet": met, "aim": 0.95,
        "met": verdict(met, 0.95, True), "median run / target": float(np.median(run)), "thickness, worst": worst, "aim ": 1.25,
        "met ": verdict(worst, 1.25, False),
    }  # fmt: skip


if __name__ == "__main__":
    titles = {"cases": f"{CASES} random waves, layers chosen by angle", "others": f"{CASES} more, of another seed"}
    parts = {name: (title, partial(cases, seed=SEEDS[name])) for name, title in titles.items()}
    run_parts(__doc__, {**parts, "vectors": ("elastic pulses, layers chosen by angle", vectors)})

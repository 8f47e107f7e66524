"""Does the stability certificate agree with long runs from white noise?

Random set-ups (boundaries, kernels, scalar fields and solids, dimensions, steps) are certified, then run from noise in
the whole state. A certified set-up whose noise grows and a not certified one whose noise decays are mistakes; undecided
ones are a weakness. Noise grows if the norm of the whole state, without rigid motions of unsupported bodies, is larger
at the end than at two thirds of the run. If it grows by less than a factor of two the run continues, since nearly equal
modes may add up before they decay.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
from common import run_parts

import farhorizon as fh
from farhorizon.checks.certificate import Certificate, certify
from farhorizon.checks.reduced_setups import crossing_rounds
from farhorizon.engine.state import State

SEED = 2026
CASES = 72
CROSSINGS = 200  # least number in a run
BUDGET = 60.0  # seconds per certificate; two threads on a shared machine need most of them
LONGEST = 20.0  # seconds by which a run continues if its noise grows slowly


def random_setup(random: np.random.Generator, dim: int) -> dict[str, Any]:
    """A small set-up: waves, diffusion or elasticity with a kernel or a stencil, a boundary for each axis or one for
    the whole outline, and a time step.
    """
    reach = int(random.integers(1, {1: 9, 2: 5, 3: 3}[dim]))
    order = 1 if random.random() < 0.25 else 2
    model: Any
    if dim > 1 and order == 2 and random.random() < 0.35:
        model = random_solid(random, min(reach, 2))
    else:
        influence = str(random.choice(["constant", "linear", "gaussian"])) if reach > 1 else "constant"
        kernel = fh.Kernel(float(reach), int(random.integers(0, 4)), influence)
        operator = (
            kernel
            if random.random() < 0.85
            else random.choice([fh.Stencil.finite_difference, fh.Stencil.finite_element])(dim)
        )
        if order == 2:
            model = fh.Wave(operator, damping=float(random.choice([0.0, 0.0, 0.02])))
        else:
            model = fh.Diffusion(operator, integrator=str(random.choice(["euler", "rk4"])))
    vectors = isinstance(model, fh.Elastic)
    m = max(model.stencil(1.0, dim).reach)
    shape = [int(random.integers(2 * m + 1, {1: 40, 2: 2 * m + 8, 3: 2 * m + 4}[dim])) for _ in range(dim)]
    boundary: Any = {axis: random_side(random, dim, order, m, vectors) for axis in "xyz"[:dim]}
    if not vectors and random.random() < 0.1:  # conditions along an outline enclose it completely
        shape = [n + 8 for n in shape]
        boundary = [fh.PlaneWave(), fh.Higdon(angles=(0, 45)), fh.FirstOrder()][random.integers(3)]
    return {
        "lattice": fh.Lattice(1.0, (0.0,) * dim, [n - 1.0 for n in shape]),
        "model": model,
        "boundary": boundary,
        "dt": float(random.choice([0.1, 0.5, 0.5, 0.9])),
    }


def random_solid(random: np.random.Generator, reach: int) -> fh.Elastic:
    """A bond-based or state-based material, or finite elements."""
    material = str(random.choice(["bond-based", "state-based", "finite-element"]))
    poisson = None if material == "bond-based" else float(random.uniform(0.0, 0.4))
    kernel = (
        None
        if material == "finite-element"
        else fh.Kernel(float(reach if material == "bond-based" else 1), int(random.integers(0, 3)))
    )
    return fh.Elastic(kernel, young=1.0, poisson=poisson, material=material)


def random_side(random: np.random.Generator, dim: int, order: int, m: int, vectors: bool) -> Any:
    """In most cases a layer, with the default profile or, for scalar fields, a random one; otherwise a plain side."""
    kind = random.choice(
        ["layer", "profile", "exact" if dim == 1 and order == 2 else "layer", "plain"], p=[0.45, 0.25, 0.1, 0.2]
    )
    nodes = int(random.integers(6, {1: 25, 2: 13, 3: 7}[dim]))
    if kind == "layer" or (kind == "profile" and vectors):
        return fh.LatticePML(nodes=nodes)
    if kind == "profile":
        depth = (np.arange(nodes + 1) + 0.5) / (nodes + 1)
        if order == 1:
            return fh.LatticePML(nodes=nodes, profile={"kappa": 1 + 20 * random.random() * depth**2})
        stretch = {
            "kappa": 1 + random.choice([0.0, 4.0]) * depth,
            "sigma": 4 * random.random() * depth ** random.integers(0, 4),
        }
        return fh.LatticePML(nodes=nodes, profile={**stretch, "alpha": float(random.choice([0.0, 0.001, 0.05]))})
    if kind == "exact":
        return fh.Exact(compress=1e-9)
    return [fh.Fixed(), fh.Periodic(), fh.Sponge(8), fh.Free()][random.integers(3 if vectors else 4)]


def grows(sim: fh.Simulation) -> tuple[bool, float]:
    """Whether noise grows over the last third of a long run, and its growth rate there.

    A run that grows slowly continues, because it may still turn to decay.
    """
    state = State(sim.engine)
    part = max(1, CROSSINGS * crossing_rounds(sim) // 6)
    x, sizes = np.random.default_rng(1).standard_normal(state.size), [1.0]
    end = time.monotonic() + LONGEST
    while True:
        for _ in range(2):
            x = state.after_rounds(x, part)
            sizes.append(size(sim, state, x))
            if not 1e-100 < sizes[-1] < 1e100:
                return sizes[-1] > 1, np.log(sizes[-1] / sizes[-2]) / (part * state.every * sim.dt)
        third = len(sizes) // 3
        ratio = sizes[-1] / sizes[-1 - third]
        if len(sizes) > 6 and (ratio <= 1 or ratio > 2 or time.monotonic() > end):
            return ratio > 1, np.log(ratio) / (third * part * state.every * sim.dt)


def size(sim: fh.Simulation, state: State, x: np.ndarray) -> float:
    """Norm of a state; an unsupported body drifts, and its mean is subtracted."""
    if not all(isinstance(b, fh.Free | fh.Periodic) for b in sim.sides.values()):
        return float(np.linalg.norm(x))
    field = state.field(x)
    return float(np.linalg.norm(field - field.mean(axis=(-3, -2, -1), keepdims=True)))


def make(setup: dict[str, Any]) -> fh.Simulation:
    """Simulation of a set-up, whose dt is given as a fraction of the step limit."""
    share = setup["dt"]
    limit = fh.Simulation(**{**setup, "dt": None}).step_limit
    sim = fh.Simulation(**{**setup, "dt": share * limit}, threads=1)
    sim.prepare(2000 * sim.dt)
    return sim


def agreement(options: argparse.Namespace) -> list[dict[str, Any]]:
    """One row per verdict: numbers of set-ups whose noise grew and did not, and seconds."""
    random = np.random.default_rng(SEED)
    rows = {
        v: {"verdict": v, "set-ups": 0, "noise grew": 0, "did not": 0, "seconds": 0.0}
        for v in ("certified", "not certified", "undecided")
    }
    done = 0
    while done < CASES:
        try:
            setup = random_setup(random, 1 + done % 3 if done % 6 < 3 else 1 + done % 2)
            sim = make(setup)
        except fh.InputError:  # e.g. a layer that does not fit its neighbour
            continue
        begin = time.monotonic()
        certificate: Certificate = certify(sim, BUDGET)
        spent = time.monotonic() - begin
        grew, rate = grows(sim)
        row = rows[certificate.verdict]
        row["set-ups"] += 1
        row["noise grew"] += grew
        row["did not"] += not grew
        row["seconds"] += spent
        done += 1
        wrong = certificate.verdict == ("certified" if grew else "not certified")
        doubt = "   <-- disagree" if wrong else "   <-- undecided" if certificate.verdict == "undecided" else ""
        if options.repeats == 1 or doubt:
            kind, sides = setup["model"], " ".join(str(setup["boundary"]).split())
            print(
                f"{done}: {sim.lattice.shape} {type(kind).__name__} {getattr(kind, 'operator', 'elements')} {sides} "
                f"share {setup['dt']}: "
                f"noise rate {rate:.2g}; {certificate} [{spent:.1f} s]{doubt}",
                flush=True,
            )
    return list(rows.values())


if __name__ == "__main__":
    run_parts(
        __doc__,
        {
            "agreement": (
                f"{CASES} random set-ups, certificate against {CROSSINGS} crossing times of white noise",
                agreement,
            )
        },
    )

"""Savings by the layer: the truncated run compared with the extended domain at equal error.

Both compute the same near field up to the same end with the same step. The truncated run has the layer that the program
chooses for the goal, ``LatticePML(target=goal, until=...)``. The extended domain has a fixed edge so far out that its
error does not exceed the *measured* error of the truncated run. The smallest number of nodes on every side is found by
bisection below the number that ``Extended`` would use; if that leads to more than three million nodes, a tenth fewer
than ``Extended`` uses are taken, and the column "its error" shows that they are too few. Errors are the largest |u -
u_infinite| over the near field and the output times, for waves relative to the largest initial value, for diffusion to
that at the same time; u_infinite is the exact solution on the infinite lattice, for elasticity the extended domain for
a thousandth of the goal.

- wave1d: 201 nodes, wave2d: 49^2, large2d: 209^2, wave3d: 25^3; kernel |xi|^-2 over 3 (3D: 2) spacings, an off-centre
  pulse of 2.8 spacings; two, five and ten crossings of the near field (large2d two).
- elastic2d, elastic3d: 49^2 and 17^3, bond-based, kernel |xi|^-1 over 2 spacings, an oblique displacement; two and five
  crossings of P waves.
- diffusion2d: 25^2 nodes, kernel |xi|^-1 over 3 spacings, forward Euler, up to R^2/diffusivity and ten times that, with
  R half the width of the near field.

Columns "times ..." are ratios of extended over truncated for computed nodes, bytes of the engine and time per step.
Times are medians of ratios of processor time in interleaved rounds on one thread, with noise as data, which prevents
denormal numbers. "aim": 2 in time (10 for waves in 3D and ten crossings, 1 for diffusion).

Run: ``python benchmarks/extended.py [wave1d] [wave2d] [large2d] [wave3d] [elastic2d] [elastic3d] [diffusion2d] [--json
FILE] [--repeats N]``. Takes ten minutes, of which ten crossings in 3D take five.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from common import interleaved, median, ratio, run_parts, verdict

from farhorizon import Diffusion, Elastic, Extended, Kernel, Lattice, LatticePML, Simulation, Wave
from farhorizon.analysis.references.infinite_lattice import InfiniteLattice

GOALS = (1e-4, 1e-6)
OUTPUTS = {1: 40, 2: 40, 3: 8}
CENTRE = (0.3, -0.2, 0.1)  # centre of the pulse, in half widths of the near field
LARGE = 3_000_000  # nodes of a domain above which it is run only once


@dataclass
class Problem:
    """A pulse in a near field, and the end of the run.

    Attributes
    ----------
    model : Wave, Diffusion or Elastic
    lattice : Lattice
    until : float
    """

    model: Wave | Diffusion | Elastic
    lattice: Lattice
    until: float

    @cached_property
    def u0(self) -> np.ndarray:
        """The pulse; for vectors, a displacement in an oblique direction."""
        half, dx = float(self.lattice.upper[0]), self.lattice.spacing
        places = zip(self.lattice.coordinates(), CENTRE, strict=False)
        pulse = np.exp(-sum(((x - c * half) / (2.8 * dx)) ** 2 for x, c in places))
        pulse[pulse < 1e-12] = 0.0
        return (
            pulse
            if not isinstance(self.model, Elastic)
            else np.stack([pulse, 0.5 * pulse, -0.3 * pulse][: self.lattice.dim])
        )

    def run(self, boundary: LatticePML | Extended, noise: bool = False) -> Simulation:
        """Simulation of the near field with a boundary on all sides."""
        sim = Simulation(self.lattice, self.model, boundary, {"u": self.u0}, threads=1)
        if noise:
            core, rng = sim.engine.core, np.random.default_rng(1)
            for level in sim.engine.levels:  # layers stay at rest: noise in them would act as a permanent load
                values = core.view(level)
                values[...] = rng.standard_normal(values.shape)
        return sim

    def reference(self, goal: float) -> dict[int, np.ndarray]:
        """The infinite medium after the steps of the output times."""
        sim = self.run(
            Extended(1e-3 * goal, until=self.until) if isinstance(self.model, Elastic) else Extended(nodes=1)
        )
        last = int(self.until / sim.dt)
        at = sorted({round(n) for n in np.linspace(0, last, OUTPUTS[self.lattice.dim] + 1)[1:]})
        if not isinstance(self.model, Elastic):
            rate = self.model.coefficient / self.lattice.spacing**2
            exact = InfiniteLattice(sim.stencil, rate, self.model.integrator, sim.dt, last, self.u0)
            return {n: exact.after(n) for n in at}
        found = {}
        for n in at:
            sim.step(n - sim.step_count)
            found[n] = sim.fields["u"]
        return found

    def error(self, sim: Simulation, exact: dict[int, np.ndarray], enough: float = np.inf) -> float:
        """Largest relative error; stops early once it exceeds `enough`."""
        peak, worst = float(np.abs(self.u0).max()), 0.0
        for number, reference in exact.items():
            sim.step(number - sim.step_count)
            scale = peak if self.model.order == 2 else float(np.abs(reference).max())
            worst = max(worst, float(np.abs(sim.fields["u"] - reference).max()) / scale)
            if worst > enough:
                break
        return worst

    def domain_for(self, error: float, exact: dict[int, np.ndarray]) -> tuple[int, float]:
        """Smallest number of additional nodes per side for which a fixed edge has at most this error, and its error."""
        high = max(found.nodes for found in self.run(Extended(max(error, 1e-12), until=self.until)).extents.values())
        if np.prod([n + 1.8 * high for n in self.lattice.shape]) > LARGE:
            fewer = int(0.9 * high)
            return fewer, self.error(self.run(Extended(nodes=fewer)), exact)
        low = high // 2
        # to 2 %: the error does not determine the size more accurately
        while high - low > max(1, high // 50):
            middle = (low + high) // 2
            low, high = (
                (low, middle) if self.error(self.run(Extended(nodes=middle)), exact, error) <= error else (middle, high)
            )
        return high, self.error(self.run(Extended(nodes=high)), exact)


def computed(sim: Simulation) -> int:
    """Number of nodes in the box that a step sweeps: the near field with the layers or the larger domain around it."""
    return int(np.prod(sim.engine.layout.box.nodes))


def rows(name: str, problems: dict[float, Problem], aims: dict[float, float], repeats: int) -> list[dict[str, Any]]:
    """One row per length of the run and goal."""
    found = []
    for length, problem in problems.items():
        for goal in GOALS:
            exact = problem.reference(goal)
            layer = LatticePML(target=goal, until=problem.until)
            error = problem.error(problem.run(layer), exact)
            more, far_error = problem.domain_for(error, exact)
            ours, far = problem.run(layer, noise=True), problem.run(Extended(nodes=more), noise=True)
            times = interleaved({"layer": ours.step, "far": far.step}, repeats, time.process_time)
            saved, aim = ratio(times, "far", "layer"), aims.get(length, 2.0)
            found.append(
                {
                    name: f"{length:g}",
                    "goal": f"{goal:g}",
                    "layer nodes": max(layer.columns for layer in ours.engine.layers.values()),
                    "error": error,
                    "more nodes a side": more,
                    "its error": far_error,
                    "times nodes": computed(far) / computed(ours),
                    "times memory": far.engine.nbytes / ours.engine.nbytes,
                    "times time": saved,
                    "aim": aim,
                    "met": verdict(saved, aim, True),
                    "run s": median(times, "layer") * max(exact),
                }
            )
    return found


def wave(dim: int, nodes: int, reach: int, crossings: float) -> Problem:
    """Pulse in (nodes)^dim, spacing 0.25, speed 1."""
    half = (nodes - 1) / 8
    return Problem(Wave(Kernel(0.25 * reach)), Lattice(0.25, (-half,) * dim, (half,) * dim), crossings * 2 * half)


def elastic(dim: int, nodes: int, crossings: float) -> Problem:
    """Pulse in (nodes)^dim, spacing and speed of P waves 1."""
    half, plane = (nodes - 1) / 2, "strain" if dim == 2 else None
    unit = Elastic(Kernel(2.0, 1), 1.0, plane=plane).p_modulus
    return Problem(
        Elastic(Kernel(2.0, 1), 1.0 / unit, plane=plane),
        Lattice(1.0, (-half,) * dim, (half,) * dim),
        crossings * 2 * half,
    )


def diffusion(nodes: int, times: float) -> Problem:
    """Pulse in nodes^2, spacing 1, diffusivity 1."""
    half = (nodes - 1) / 2
    return Problem(Diffusion(Kernel(3.0, 1)), Lattice(1.0, (-half,) * 2, (half,) * 2), times * half**2)


PARTS: dict[str, tuple[str, Callable[[float], Problem], tuple[float, ...], dict[float, float]]] = {
    "wave1d": ("crossings", lambda n: wave(1, 201, 3, n), (2, 5, 10), {}),
    "wave2d": ("crossings", lambda n: wave(2, 49, 3, n), (2, 5, 10), {}),
    "large2d": ("crossings", lambda n: wave(2, 209, 3, n), (2,), {}),
    "wave3d": ("crossings", lambda n: wave(3, 25, 2, n), (2, 5, 10), {10: 10.0}),
    "elastic2d": ("crossings", lambda n: elastic(2, 49, n), (2, 5), {}),
    "elastic3d": ("crossings", lambda n: elastic(3, 17, n), (2, 5), {}),
    "diffusion2d": ("R^2/D", lambda n: diffusion(25, n), (1, 10), {1: 1.0, 10: 1.0}),
}


def part(name: str) -> tuple[str, Callable[[Any], list[dict[str, Any]]]]:
    """Title and function of a part of the command line."""
    unit, make, lengths, aims = PARTS[name]
    title = f"{name}: extended domain over truncated run at equal error"
    return title, lambda given: rows(unit, {n: make(n) for n in lengths}, aims, given.repeats)


if __name__ == "__main__":
    run_parts(__doc__, {name: part(name) for name in PARTS})

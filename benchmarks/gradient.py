"""Cost of the gradient of a misfit relative to one run, and against Deepwave.

Processor time of whole calls in one process on one thread, set-up included, in turn; the result is the median of the
ratios of neighbouring turns, with quartiles.

- plane: 300^2 nodes, m = 3, 500 steps; space: 64^3 nodes, m = 2, 200 steps. One source, 16 receivers, speed at every
  node, layers of 10 nodes. The history in memory as float64 and as float32, aim 3.5 runs; two maps, aim 4; computed
  again within 20 near fields, aim 5. A near field is what a run allocates for its levels and its layers.
- deepwave: a gradient by Deepwave, where it is installed (``pip install deepwave``): 2D acoustic waves, 300^2 nodes, 20
  nodes of PML, fourth order in space, the same steps, double precision; ours with the same stencil and layers of 10
  nodes. Aim: at most as long.

Run: ``python benchmarks/gradient.py [plane] [space] [deepwave] [--json FILE] [--repeats N]``. Takes some minutes and
1.5 GB.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from common import run_parts, verdict

import farhorizon as fh

SEED = 20261129
#: Near fields beside the history: three runs, and what two of them record before it is used.
BESIDE = 8
FOURTH_ORDER = fh.Stencil(
    [(1, 0), (-1, 0), (0, 1), (0, -1), (2, 0), (-2, 0), (0, 2), (0, -2)], [4 / 3] * 4 + [-1 / 12] * 4
)


def setup(dim: int, nodes: int, operator: fh.Kernel | fh.Stencil, rule: str | None = None) -> fh.Setup:
    """A medium that varies at random by 5 %, with its time step and layers settled."""
    lattice = fh.Lattice(1.0, (-float(nodes // 2),) * dim, (nodes - 1.0 - nodes // 2,) * dim)
    speed = 1 + 0.05 * np.random.default_rng(SEED).uniform(-1, 1, lattice.shape)
    source = fh.PointSource((-8.0, 1.0, 0.0)[:dim], time=fh.Ricker(0.05))
    model = fh.Wave(operator, speed, density=np.ones(lattice.shape))
    made = fh.Setup(lattice, model, fh.LatticePML(nodes=10), sources=[source], threads=1, rule=rule)
    return fh.Simulation.of(made).settled


def receivers(dim: int, nodes: int) -> fh.Receivers:
    """Sixteen receivers along a line."""
    along = np.linspace(-nodes // 3, nodes // 3, 16)
    return fh.Receivers(np.stack([along, np.full(16, nodes // 3), np.zeros(16)], axis=1)[:, :dim])


def turns(cases: dict[str, Callable[[], Any]], repeats: int) -> dict[str, np.ndarray]:
    """Processor time of each case, turn by turn."""
    for case in cases.values():
        case()
    found: dict[str, list[float]] = {name: [] for name in cases}
    for _ in range(repeats):
        for name, case in cases.items():
            begin = time.process_time()
            case()
            found[name].append(time.process_time() - begin)
    return {name: np.array(times) for name, times in found.items()}


def rows_of(times: dict[str, np.ndarray], base: str, aims: dict[str, float]) -> list[dict[str, Any]]:
    """Ratios of all cases to one of them."""
    rows = []
    for name, aim in aims.items():
        low, middle, high = np.quantile(times[name] / times[base], (0.25, 0.5, 0.75))
        rows.append(
            {
                "gradient": name,
                f"{base} s": float(np.median(times[base])),
                "ratio": float(middle),
                "quartiles": f"{low:.2f} .. {high:.2f}",
                "aim": aim,
                "met": verdict(float(middle), aim, larger=False),
            }
        )
    return rows


def costs(dim: int, nodes: int, reach: float, steps: int, repeats: int) -> list[dict[str, Any]]:
    """Gradients relative to a run."""
    made, line = setup(dim, nodes, fh.Kernel(reach)), receivers(dim, nodes)
    misfit = fh.LeastSquares(line, np.zeros((steps + 1, 16)))
    until = steps * float(made.dt)  # type: ignore[arg-type]
    near = fh.Simulation.of(made).engine.nbytes

    def run() -> None:
        fh.Simulation.of(made, observe=[line]).step(steps)

    def gradient(wrt: Any = "speed", **options: Any) -> Callable[[], Any]:
        return lambda: fh.gradient(made, misfit, wrt, until, **options)

    cases = {
        "run": run,
        "in memory": gradient(),
        "in memory, float32": gradient(precision="float32"),
        "two maps": gradient(["speed", "density"]),
        "within 20 near fields": gradient(memory=float((20 - BESIDE) * near)),
    }
    aims = {"in memory": 3.5, "in memory, float32": 3.5, "two maps": 4.0, "within 20 near fields": 5.0}
    return rows_of(turns(cases, repeats), "run", aims)


def against_deepwave(nodes: int, steps: int, repeats: int) -> list[dict[str, Any]]:
    """Our gradient relative to that of Deepwave."""
    try:
        import deepwave
        import torch
    except ImportError:
        return [{"gradient": "Deepwave is not installed"}]
    torch.set_num_threads(1)
    made, line = setup(2, nodes, FOURTH_ORDER, "arithmetic"), receivers(2, nodes)
    until = steps * float(made.dt)  # type: ignore[arg-type]
    misfit = fh.LeastSquares(line, np.zeros((steps + 1, 16)))
    speed = torch.tensor(np.asarray(made.model.speed), dtype=torch.float64, requires_grad=True)
    pulse = torch.tensor([made.sources[0].time(n * made.dt) for n in range(steps)], dtype=torch.float64)
    places = torch.tensor(np.round(line.points + nodes // 2).astype(int))[None]

    def theirs() -> None:
        speed.grad = None
        found = deepwave.scalar(
            speed,
            1.0,
            float(made.dt),
            source_amplitudes=pulse[None, None],
            source_locations=torch.tensor([[[nodes // 2 - 8, nodes // 2 + 1]]]),
            receiver_locations=places,
            accuracy=4,
            pml_width=20,
            pml_freq=0.05,
        )
        (found[-1] ** 2).sum().backward()

    cases = {"theirs": theirs, "ours": lambda: fh.gradient(made, misfit, "speed", until)}
    cases["ours, float32 history"] = lambda: fh.gradient(made, misfit, "speed", until, precision="float32")
    times = turns(cases, repeats)
    return rows_of(times, "theirs", {"ours": 1.0, "ours, float32 history": 1.0})


if __name__ == "__main__":
    run_parts(
        __doc__,
        {
            "plane": ("300^2 nodes, m = 3", lambda given: costs(2, 300, 3.0, 500, given.repeats)),
            "space": ("64^3 nodes, m = 2", lambda given: costs(3, 64, 2.0, 200, given.repeats)),
            "deepwave": ("Against Deepwave, 300^2 nodes", lambda given: against_deepwave(300, 500, given.repeats)),
        },
    )

"""Cost of a corrosion step compared with that of plain diffusion.

Measures, in one process with interleaved repeats (medians of the ratios of a round), one forward Euler step in 2D, m =
2 (20 neighbours, the linear volume correction), on periodic squares:

- share: metal around a disc of liquid that contains 10 %, 30 % or 60 % of the nodes, against the same square without
  metal. Target for 10 %: 0.6.
- fronts: squares with one disc (201^2 nodes) and with many small discs (1000^2 nodes), for the cost of bonds that are
  processed one by one, and a square that is all liquid, for the cost of phases, against `Diffusion`.

- sphere: memory that example 3 of Shojaei et al. (2020), 523 155 nodes in 3D with a layer around them, holds and
  temporarily needs, as counted by tracemalloc, and its asymmetry after 20 steps. Targets: 2 GB, 1e-12.

In the first two, a saturation far below all values keeps metal from dissolving, so that every round does the same work;
the search for metal to dissolve is part of the step.

Run: ``python benchmarks/corrosion.py [share] [fronts] [sphere] [--json FILE] [--repeats N]``. Takes a minute.
"""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
from common import interleaved, median, ratio, run_parts, steps, verdict

from farhorizon import Corrosion, Diffusion, Kernel, Lattice, Periodic, Simulation, Specimen
from farhorizon.engine.engine import available_threads
from farhorizon.papers.shojaei2020_corrosion import SPHERE, asymmetry


def simulation(n: int, solid: np.ndarray | None, threads: int) -> Simulation:
    """Periodic square with noise as values, which prevents denormal numbers, and metal on the solid nodes; plain
    diffusion if there is no mask.
    """
    u = np.random.default_rng(1).uniform(1, 2, (n, n))
    lattice, kernel = Lattice(1.0, (0.0, 0.0), (n - 1.0, n - 1.0)), Kernel(2.0)
    model = Diffusion(kernel) if solid is None else Corrosion(kernel, saturation=1e-3)
    metal = [Specimen(solid, 2.0)] if solid is not None and solid.any() else []
    return Simulation(lattice, model, Periodic(), {"u": u}, threads=threads, specimens=metal)


def radius_mask(n: int, share: float) -> np.ndarray:
    """Nodes outside a disc in the middle that contains a fraction of all nodes."""
    x = np.arange(n) - (n - 1) / 2
    return np.hypot(*np.meshgrid(x, x, indexing="ij")) > n * np.sqrt(share / np.pi)


def share_of_liquid(repeats: int) -> list[dict[str, Any]]:
    """Steps of squares that are partly metal compared with squares of liquid."""
    rows = []
    for n in (400, 1000):
        for threads in sorted({1, available_threads()}):
            masks = {"all liquid": np.zeros((n, n), bool)} | {
                f"{share:.0%}": radius_mask(n, share) for share in (0.1, 0.3, 0.6)
            }
            times = interleaved(
                {name: steps(simulation(n, mask, threads).engine) for name, mask in masks.items()}, repeats
            )
            for name in list(masks)[1:]:
                part = ratio(times, name, "all liquid")
                rows.append(
                    {
                        "2D m=2, liquid": name,
                        "nodes": f"{n}^2",
                        "threads": threads,
                        "step ms": 1e3 * median(times, name),
                        "all liquid ms": 1e3 * median(times, "all liquid"),
                        "ratio": part,
                        "target": 0.6 if name == "10%" else "-",
                        "met": verdict(part, 0.6, larger=False) if name == "10%" else "-",
                    }
                )
    return rows


def fronts(repeats: int) -> list[dict[str, Any]]:
    """Steps with few or many nodes near a front compared with plain diffusion on as many nodes."""
    rows = []
    for n, name in ((201, "one disc"), (1000, "all liquid"), (1000, "400 discs")):
        x = np.arange(n) - (n - 1) / 2
        solid = np.zeros((n, n), bool)
        if name == "one disc":
            solid = np.hypot(*np.meshgrid(x, x, indexing="ij")) < 0.3 * n
        elif name == "400 discs":
            solid = np.hypot(*np.meshgrid(x % 50 - 25, x % 50 - 25, indexing="ij")) < 12
        times = interleaved(
            {"phases": steps(simulation(n, solid, 1).engine), "diffusion": steps(simulation(n, None, 1).engine)},
            repeats,
        )
        engine = simulation(n, solid, 1).engine
        solids, volumes = engine.tables.phases.solids, engine.tables.phases.volumes
        rows.append(
            {
                "one thread": name,
                "nodes": f"{n}^2",
                "solid %": float(100 * solid.mean()),
                "mixed tiles %": float(100 * ((solids > 0) & (solids < volumes)).mean()),
                "step ms": 1e3 * median(times, "phases"),
                "diffusion ms": 1e3 * median(times, "diffusion"),
                "ratio": ratio(times, "phases", "diffusion"),
            }
        )
    return rows


def sphere() -> list[dict[str, Any]]:
    """Memory of the sphere in the paper with its layer."""
    simulation(50, None, 1).step(1)  # loads the compiled program and its tables before counting
    tracemalloc.start()
    (sim,) = SPHERE.closed(1).values()
    held, set_up = tracemalloc.get_traced_memory()
    tracemalloc.reset_peak()
    sim.step(20)
    u = sim.fields["u"]
    running = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    skew = asymmetry(u)
    return [
        {
            "sphere": f"{sim.lattice.nodes} nodes",
            "held GB": held / 1e9,
            "peak set-up GB": set_up / 1e9,
            "peak running GB": running / 1e9,
            "target": 2.0,
            "met": verdict(max(set_up, running) / 1e9, 2.0, larger=False),
            "asymmetry": skew,
            "met ": verdict(skew, 1e-12, larger=False),
        }
    ]


if __name__ == "__main__":
    run_parts(
        __doc__,
        {
            "share": ("A disc of liquid in metal", lambda given: share_of_liquid(given.repeats)),
            "fronts": ("Many fronts, and none", lambda given: fronts(given.repeats)),
            "sphere": ("The sphere of the paper", lambda given: sphere()),
        },
    )

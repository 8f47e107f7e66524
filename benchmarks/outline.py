"""Cost of conditions along an outline per step.

Measures, in one process with interleaved repeats (medians of the ratios of a round): the step of a near field closed by
each condition against the same engine without it, which sweeps the same nodes. One thread, except for the disc.

- disc: examples 2 and 3 of Hermann et al. (2023), radius 26, spacing 0.25, horizon 3 and 6 spacings, one and two
  threads. Target: a `PlaneWave` whose clouds have 10 nodes adds at most one step of the near field. For comparison a
  12-node `LatticePML` around the same window.
- mesh: their example 1, finite elements on 103^2 nodes.
- bar: their appendix B, 2001 nodes, horizon 25 spacings.
- ball: diffusion in a ball of radius 5, spacing 0.1, horizon 2 spacings (example 3 of Shojaei et al. 2020, without the
  metal).

Run: ``python benchmarks/outline.py [disc] [mesh] [bar] [ball] [--json FILE] [--repeats N]``. Takes about a minute.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np
from common import interleaved, median, ratio, run_parts, steps, verdict

import farhorizon as fh
from farhorizon.boundaries import Side
from farhorizon.engine.engine import available_threads
from farhorizon.engine.features.outline_stencil import OutlineStencil
from farhorizon.engine.layout import with_defaults
from farhorizon.models import LatticeModel


def simulation(lattice: fh.Lattice, model: LatticeModel, boundary: Side, threads: int = 1) -> fh.Simulation:
    """Simulation with noise, which prevents denormal numbers, and a tiny time step, which prevents overflow."""
    sim = fh.Simulation(lattice, model, boundary, threads=threads, dt=1e-6)
    for level in range(model.order):
        sim.engine.core.view(sim.engine.levels[level])[...] = np.random.default_rng(1).standard_normal(
            sim.engine.core.nodes
        )
    return sim


def measure(
    what: str,
    lattice: fh.Lattice,
    model: LatticeModel,
    conditions: Mapping[str, Side],
    repeats: int,
    target: str = "",
    threads: int = 1,
) -> list[dict[str, Any]]:
    """One row per condition; `target` names the one that may add at most one step."""
    sims = {name: simulation(lattice, model, boundary, threads) for name, boundary in conditions.items()}
    cases = {name: steps(sim.engine) for name, sim in sims.items()}
    # like all the others it has margins of one reach
    bare = simulation(lattice, model, fh.Higdon() if model.order == 2 else fh.PlaneWave(), threads)
    bare.engine.replace(outline_stencil=with_defaults(OutlineStencil, bare.engine.dtype))
    times = interleaved({"bare": steps(bare.engine), **cases}, repeats)
    rows = []
    for name, sim in sims.items():
        added = ratio(times, name, "bare") - 1
        entries = 0 if sim.closure is None else sim.closure.update.nnz / len(sim.closure.rows)
        rows.append(
            {
                what: name,
                "near field us": 1e6 * median(times, "bare"),
                "with it us": 1e6 * median(times, name),
                "adds, in steps": added,
                "values a node": entries,
                "target": 1.0 if name == target else "-",
                "met": verdict(added, 1.0, larger=False) if name == target else "-",
            }
        )
    return rows


def disc(repeats: int) -> list[dict[str, Any]]:
    """Both horizons, on one thread and on two."""
    rows = []
    for reach, threads in itertools.product((3, 6), sorted({1, available_threads()})):
        conditions: dict[str, Side] = {
            "PlaneWave, 10 nodes": fh.PlaneWave(thin=-(-reach // 3)),
            "PlaneWave, whole cone": fh.PlaneWave(),
            "Higdon (0, 45)": fh.Higdon(),
            "LatticePML, 12 nodes": fh.LatticePML(nodes=12),
        }
        lattice, model = (
            fh.Lattice(0.25, window=fh.Disc(26 - 0.25 * reach)),
            fh.Wave(fh.Kernel(0.25 * reach, 2), damping=0.0125),
        )
        found = measure("disc", lattice, model, conditions, repeats, "PlaneWave, 10 nodes", threads)
        rows += [{"disc": f"{reach} spacings, {row.pop('disc')}", "threads": threads, **row} for row in found]
    return rows


def mesh(repeats: int) -> list[dict[str, Any]]:
    """Finite elements on a square."""
    conditions: dict[str, Side] = {
        "PlaneWave, 2 spacings": fh.PlaneWave(),
        "PlaneWave, 1 spacing": fh.PlaneWave(radius=0.5),
        "Higdon (0, 45)": fh.Higdon(),
        "FirstOrder": fh.FirstOrder(),
        "LatticePML, 12 nodes": fh.LatticePML(nodes=12),
    }
    return measure(
        "mesh",
        fh.Lattice(0.5, (-25.5, -25.5), (25.5, 25.5)),
        fh.Wave(fh.Stencil.finite_element(2)),
        conditions,
        repeats,
    )


def bar(repeats: int) -> list[dict[str, Any]]:
    """A bar with a wide horizon."""
    conditions: dict[str, Side] = {
        "PlaneWave, 26 nodes": fh.PlaneWave(fit="collocation", radius=0.25, wavenumber=1.0),
        "Higdon (0, 0)": fh.Higdon((0, 0)),
    }
    return measure(
        "bar", fh.Lattice(0.01, (-10.0,), (10.0,)), fh.Wave(fh.Kernel(0.25, 0), np.sqrt(10)), conditions, repeats
    )


def ball(repeats: int) -> list[dict[str, Any]]:
    """Diffusion in a ball."""
    conditions: dict[str, Side] = {
        "PlaneWave, 7 nodes": fh.PlaneWave(),
        "LatticePML, 12 nodes": fh.LatticePML(nodes=12),
    }
    return measure("ball", fh.Lattice(0.1, window=fh.Ball(5.0)), fh.Diffusion(fh.Kernel(0.2, 1)), conditions, repeats)


if __name__ == "__main__":
    run_parts(
        __doc__,
        {
            "disc": ("Conditions around a disc", lambda given: disc(given.repeats)),
            "mesh": ("Finite elements", lambda given: mesh(given.repeats)),
            "bar": ("A bar", lambda given: bar(given.repeats)),
            "ball": ("A ball", lambda given: ball(given.repeats)),
        },
    )

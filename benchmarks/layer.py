"""Cost of the absorbing layers per wave step.

Measures, in one process with interleaved repeats (medians of the ratios of a round):

- square: a 12-node LatticePML on all sides of a 1000^2 near field, m = 3, with one and two threads, against an engine
  of the near field alone, with neither layers nor cuts. Target: at most 30 % more time per step.
- bar: the same for a 1D bar of 201 nodes, m = 3, in microseconds per step; and `Simulation.step` in addition to the
  loop of the engine. Target: layers add at most 1.6 microseconds per step.
- cube: 3D 100^3, m = 3, for information; and, if there are two threads, a step on one thread over that on two. Target:
  at least 1.6.
- thin: layers of 4, 8 and 12 nodes around both, for a target of 1e-4 in five crossings, on one thread: the step over
  that of the bare engine, the same for layers with full memory, for a run in single precision (over the same bare step,
  which is in double precision), that of the bare stencil on all nodes (the cost of layers if they were free), and the
  memory of the layers in units of near fields. Aims: 1.08, 1.15 and 1.3 around the
  square, 1.8, 2.6 and 4.5 around the cube; memory there 2, 4 and 10.
- chosen: layers chosen for a target, on one thread: the step over that of the bare engine. Around a cube of 80^3 in a
  run of five crossings for 1e-4, 1e-5 and 1e-6, aims 3, 4 and 8; around an elastic cube of 64^3 with a horizon of two
  nodes for 1e-3 and 1e-4, aims 2.2 and 3.5; around the half-space of the examples for 1e-4, aim 1.8.

Run: ``python benchmarks/layer.py [square] [bar] [cube] [thin] [chosen] [--json FILE] [--repeats N]``. Takes about five
minutes, two and a half of them to assess the layers of `thin` around the square.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from common import bare_engine, interleaved, median, ratio, run_parts, steps, verdict

from farhorizon import Elastic, Free, Kernel, Lattice, LatticePML, Simulation, Wave, read_case
from farhorizon.engine.engine import available_threads

EXAMPLES = Path(__file__).parents[1] / "examples"


def simulation(
    dim: int,
    n: int,
    threads: int,
    nodes: int = 12,
    target: float | None = None,
    until: float | None = None,
    dtype: str = "float64",
) -> Simulation:
    """Near field of n^dim nodes with layers on all sides, set up with data in the middle, which noise then replaces to
    prevent denormal numbers.
    """
    pulse = "*".join(f"exp(-({axis} - {n / 2})**2)" for axis in "xyz"[:dim])
    lattice = Lattice(1.0, (0.0,) * dim, (n - 1.0,) * dim)
    layer = LatticePML(nodes=nodes, target=target, until=until)
    sim = Simulation(lattice, Wave(Kernel(3.0)), layer, {"u": pulse}, threads=threads, dtype=dtype)
    core = sim.engine.core
    core.view(sim.engine.current)[...] = np.random.default_rng(1).standard_normal(core.nodes)
    return sim


def measure(dim: int, n: int, counts: Sequence[int], repeats: int) -> tuple[Simulation, dict[str, list[float]]]:
    """Last simulation, and times of the step with and without layers and of `Simulation.step`, for several numbers of
    threads.
    """
    cases: dict[str, Callable[[int], None]] = {}
    for threads in counts:
        sim, full = simulation(dim, n, threads), simulation(dim, n, threads)
        bare = bare_engine(sim.stencil, sim.lattice.shape, threads)
        cases |= {
            f"layers {threads}": steps(sim.engine),
            f"bare {threads}": steps(bare),
            f"step() {threads}": full.step,
        }
    return sim, interleaved(cases, repeats)


def large(dim: int, n: int, repeats: int, target: float | None, gain: float | None = None) -> list[dict[str, Any]]:
    """Relative cost of the layers, and the gain by a second thread if an aim for it is given."""
    counts = sorted({1, min(2, available_threads())})
    sim, times = measure(dim, n, counts, repeats)
    nodes, rows = np.prod(sim.engine.layout.box.nodes) / np.prod(sim.lattice.shape), []
    for threads in counts:
        layers, bare, step = (f"{name} {threads}" for name in ("layers", "bare", "step()"))
        added = 100 * (ratio(times, layers, bare) - 1)
        row = {
            f"{dim}D m=3, 12 nodes": f"{n}^{dim}",
            "threads": threads,
            "bare ms": 1e3 * median(times, bare),
            "layers ms": 1e3 * median(times, layers),
            "added %": added,
            "more nodes %": float(100 * (nodes - 1)),
            "step() / loop": ratio(times, step, layers),
            "target": "-" if target is None else target,
            "met": "-" if target is None else verdict(added, target, larger=False),
        }
        if gain is not None:
            found = ratio(times, "layers 1", layers) if threads > 1 else None
            row |= {
                "one / two": "-" if found is None else found,
                "gain aimed": gain,
                "gain met": "-" if found is None else verdict(found, gain, larger=True),
            }
        rows.append(row)
    return rows


def thin(repeats: int) -> list[dict[str, Any]]:
    """Time and memory of layers by their thickness."""
    rows = []
    for dim, n, steps_aimed, memory_aimed in (
        (2, 1000, (1.08, 1.15, 1.3), (None,) * 3),
        (3, 100, (1.8, 2.6, 4.5), (2.0, 4.0, 10.0)),
    ):
        for nodes, aim, memory_aim in zip((4, 8, 12), steps_aimed, memory_aimed, strict=True):
            sim = simulation(dim, n, 1, nodes, 1e-4, until=5.0 * n)
            bare, full = bare_engine(sim.stencil, sim.lattice.shape, 1), simulation(dim, n, 1, nodes)
            box = bare_engine(sim.stencil, sim.engine.layout.box.nodes[-dim:], 1)
            single = simulation(dim, n, 1, nodes, 1e-4, until=5.0 * n, dtype="float32")
            engines = {"layers": sim.engine, "full": full.engine, "single": single.engine, "bare": bare, "box": box}
            cases = {name: steps(engine) for name, engine in engines.items()}
            times = interleaved(cases, repeats)
            found = ratio(times, "layers", "bare")
            memory = (sim.engine.nbytes - bare.nbytes) / (8 * n**dim)
            rows.append(
                {
                    "m=3": f"{n}^{dim}",
                    "nodes": nodes,
                    "step / bare": found,
                    "aim": aim,
                    "met": verdict(found, aim, larger=False),
                    "all nodes": ratio(times, "box", "bare"),
                    "in full": ratio(times, "full", "bare"),
                    "in single": ratio(times, "single", "bare"),
                    "near fields": memory,
                    "memory aim": "-" if memory_aim is None else memory_aim,
                    "memory met": "-" if memory_aim is None else verdict(memory, memory_aim, larger=False),
                }
            )
    return rows


def chosen(repeats: int) -> list[dict[str, Any]]:
    """Steps with layers that are chosen for a target."""
    bonds, rows = Elastic(Kernel(2.0, 1), young=1.0), []
    for name, make, aim in (
        ("80^3, 1e-4", lambda: enclosed(80, Wave(Kernel(3.0)), 1e-4), 3.0),
        ("80^3, 1e-5", lambda: enclosed(80, Wave(Kernel(3.0)), 1e-5), 4.0),
        ("80^3, 1e-6", lambda: enclosed(80, Wave(Kernel(3.0)), 1e-6), 8.0),
        ("elastic 64^3, 1e-3", lambda: enclosed(64, bonds, 1e-3), 2.2),
        ("elastic 64^3, 1e-4", lambda: enclosed(64, bonds, 1e-4), 3.5),
        ("half-space, 1e-4", lambda: half_space(1e-4), 1.8),
    ):
        sim = make()
        bare = bare_engine(sim.stencil, sim.lattice.shape, 1)
        times = interleaved({"layers": steps(sim.engine), "bare": steps(bare)}, repeats)
        found = ratio(times, "layers", "bare")
        rows.append(
            {
                "near field": name,
                "nodes": max(layer.columns for layer in sim.engine.layers.values()),
                "bare ms": 1e3 * median(times, "bare"),
                "step / bare": found,
                "aim": aim,
                "met": verdict(found, aim, larger=False),
                "near fields": (sim.engine.nbytes - bare.nbytes) / (8 * sim.fields["u"].size),
            }
        )
    return rows


def enclosed(n: int, model: Any, target: float) -> Simulation:
    """A cube of n^3 nodes with a pulse of eight nodes in the middle and layers for five crossings."""
    half = (n - 1) / 2
    lattice = Lattice(1.0, (-half,) * 3, (half,) * 3)
    pulse = np.exp(-sum(x**2 for x in lattice.coordinates()) / 4.0**2)
    u = pulse if isinstance(model, Wave) else np.stack([pulse, 0 * pulse, 0 * pulse])
    layer = LatticePML(target=target, until=5 * n / float(np.sqrt(model.coefficient)))
    return noisy(Simulation(lattice, model, layer, {"u": u}, threads=1))


def half_space(target: float) -> Simulation:
    """The half-space of the examples, with layers for a target."""
    case = read_case(EXAMPLES / "half_space.toml")
    layer = LatticePML(target=target, until=case.end)
    return noisy(case.simulation(boundary={"x": layer, "y-": layer, "y+": Free()}, threads=1))


def noisy(sim: Simulation) -> Simulation:
    """The simulation with noise in its core, which prevents denormal numbers."""
    core = sim.engine.core.view(sim.engine.current)
    core[...] = np.random.default_rng(1).standard_normal(core.shape)
    return sim


def bar(repeats: int) -> list[dict[str, Any]]:
    """Absolute cost for a short bar."""
    _, times = measure(1, 201, [1], repeats)
    added = [1e6 * (a - b) for a, b in zip(times["layers 1"], times["bare 1"], strict=True)]
    over = sorted(added)[len(added) // 2]
    return [
        {
            "1D m=3, 12 nodes": "201",
            "bare us": 1e6 * median(times, "bare 1"),
            "layers us": 1e6 * median(times, "layers 1"),
            "added us": over,
            "step() us": 1e6 * median(times, "step() 1"),
            "target added": 1.6,
            "met": verdict(over, 1.6, larger=False),
        }
    ]


if __name__ == "__main__":
    run_parts(
        __doc__,
        {
            "square": ("Layers around a square", lambda given: large(2, 1000, given.repeats, 30.0)),
            "bar": ("Layers of a bar", lambda given: bar(given.repeats)),
            "cube": ("Layers around a cube", lambda given: large(3, 100, given.repeats, None, 1.6)),
            "thin": ("Layers by their thickness", lambda given: thin(given.repeats)),
            "chosen": ("Layers that choose themselves", lambda given: chosen(given.repeats)),
        },
    )

"""Speed and memory of the near-field wave step, against what the machine can do and against a sparse matrix.

Measures, in one process with interleaved repeats (medians of the ratios of a round):

- triad: 2D m = 3 on 4000^2 nodes with all threads as a fraction of the bandwidth of the update ``A += s*C``. This
  update moves 24 bytes per node, the least that a step must move (read u, read and write the older level), is compiled
  by Numba with the same threads and threading layer, and runs on arrays of as many nodes. Targets: 68 % for the 36
  neighbours of volume="ramp", 75 % for the 28 of volume="full".
- csr: one thread per node against the product of the same operator as a scipy CSR matrix with a vector (no time
  update): 2D m = 3 on 1000^2 nodes; 3D m = 3, 200^3 nodes against a matrix on 96^3 nodes (200^3 would need 17 GB).
  Target: 15 x.
- float32: speed-up by single precision, 2D m = 3. Target: 1.6 x.
- memory: memory that near fields of 1000^2 and 100^3 nodes, with fixed sides and with layers, hold, and that their
  set-up and run temporarily need, in fields of 8 bytes per node, as counted by tracemalloc. Target with fixed sides:
  the run holds at most 5.

Run: ``python benchmarks/step.py [triad] [csr] [float32] [memory] [--json FILE] [--repeats N]``.
Takes one to two minutes and 3 GB.
"""

from __future__ import annotations

import gc
import tracemalloc
from typing import Any

import numba
import numpy as np
import scipy.sparse as sp
from common import bare_engine, interleaved, kernel_stencil, median, ratio, run_parts, steps, verdict

from farhorizon import Fixed, Kernel, Lattice, LatticePML, Simulation, Stencil, Wave
from farhorizon.engine.engine import available_threads


@numba.njit(parallel=True)
def _triad(a: np.ndarray, c: np.ndarray, s: float, count: int) -> None:
    for _ in range(count):
        for i in numba.prange(a.size):
            a[i] += s * c[i]


def triad_case(nodes: int, threads: int) -> Any:
    """The update A += s*C on `nodes` nodes as a timing case."""
    a, c = np.zeros(nodes), np.random.default_rng(0).standard_normal(nodes)

    def run(count: int) -> None:
        numba.set_num_threads(threads)
        _triad(a, c, 1e-9, count)

    return run


def matrix(stencil: Stencil, n: int) -> sp.csr_matrix:
    """Operator on n^dim nodes with zeros beyond, with int32 indices, built for one offset at a time."""
    shape = (n,) * stencil.dim
    index = np.arange(n**stencil.dim, dtype=np.int32).reshape(shape)
    offsets = np.vstack([stencil.offsets, np.zeros((1, stencil.dim), int)])
    weights = np.append(stencil.weights, -stencil.weights.sum())
    order = np.lexsort(offsets.T[::-1])
    reach = max(stencil.reach)
    padded = np.pad(index, reach, constant_values=-1)
    columns = np.empty((n**stencil.dim, len(weights)), np.int32)
    for number, k in enumerate(order):
        columns[:, number] = padded[tuple(slice(reach + o, reach + o + n) for o in offsets[k])].ravel()
    used = columns >= 0
    starts = np.concatenate([[0], np.cumsum(used.sum(1))]).astype(np.int32)
    data = np.broadcast_to(weights[order], columns.shape)[used]
    return sp.csr_matrix((data, columns[used], starts), shape=(index.size, index.size))


def product_case(operator: sp.csr_matrix) -> Any:
    """The matrix-vector product as a timing case."""
    u = np.random.default_rng(0).standard_normal(operator.shape[0])

    def run(count: int) -> None:
        for _ in range(count):
            operator @ u

    return run


def bandwidth(repeats: int) -> list[dict[str, Any]]:
    """2D 4000^2 with all threads and with one, against the triad on as many nodes."""
    rows = []
    n = 4000
    for threads in sorted({1, available_threads()}, reverse=True):
        engines = {v: bare_engine(kernel_stencil(2, 3, v), (n, n), threads) for v in ("ramp", "full")}
        cases = {"triad": triad_case(n * n, threads)} | {v: steps(e) for v, e in engines.items()}
        times = interleaved(cases, repeats)
        for volume, target in (("ramp", 0.68), ("full", 0.75)):
            share = ratio(times, "triad", volume)
            rows.append(
                {
                    "2D m=3 4000^2": volume,
                    "neighbours": len(engines[volume].weights),
                    "threads": threads,
                    "step ms": 1e3 * median(times, volume),
                    "triad ms": 1e3 * median(times, "triad"),
                    "step GB/s": 24e-9 * n * n / median(times, volume),
                    "triad GB/s": 24e-9 * n * n / median(times, "triad"),
                    "share of triad": share,
                    "target": target if threads > 1 else "-",
                    "met": verdict(share, target, larger=True) if threads > 1 else "-",
                }
            )
        del engines, cases
        gc.collect()
    return rows


def against_matrix(repeats: int) -> list[dict[str, Any]]:
    """One-thread step per node compared with the CSR product per node."""
    rows = []
    for dim, n, n_matrix, volume in (
        (2, 1000, 1000, "ramp"),
        (2, 1000, 1000, "full"),
        (3, 200, 96, "ramp"),
        (3, 200, 96, "full"),
    ):
        stencil = kernel_stencil(dim, 3, volume)
        cases = {"step": steps(bare_engine(stencil, (n,) * dim, 1)), "csr": product_case(matrix(stencil, n_matrix))}
        times = interleaved(cases, repeats)
        factor = ratio(times, "csr", "step") * n**dim / n_matrix**dim
        rows.append(
            {
                "one thread, m=3": f"{dim}D {n}^{dim} {volume}",
                "neighbours": len(stencil.weights),
                "step ns/node": 1e9 * median(times, "step") / n**dim,
                "csr nodes": f"{n_matrix}^{dim}",
                "csr ns/node": 1e9 * median(times, "csr") / n_matrix**dim,
                "times faster": factor,
                "target": 15.0,
                "met": verdict(factor, 15.0, larger=True),
            }
        )
        del cases
        gc.collect()
    return rows


def single_precision(repeats: int) -> list[dict[str, Any]]:
    """Single compared with double precision, 2D m = 3."""
    rows = []
    for n, threads in ((1000, 1), (4000, 1), (1000, available_threads()), (4000, available_threads())):
        stencil = kernel_stencil(2, 3)
        times = interleaved(
            {r: steps(bare_engine(stencil, (n, n), threads, r)) for r in ("float64", "float32")}, repeats
        )
        gain = ratio(times, "float64", "float32")
        rows.append(
            {
                "2D m=3 ramp": f"{n}^2",
                "threads": threads,
                "float64 ms": 1e3 * median(times, "float64"),
                "float32 ms": 1e3 * median(times, "float32"),
                "times faster": gain,
                "target": 1.6,
                "met": verdict(gain, 1.6, larger=True),
            }
        )
        gc.collect()
    return rows


def memory() -> list[dict[str, Any]]:
    """Memory that a simulation holds, and that its set-up and run temporarily need, in fields."""
    rows = []
    for dim, n, layers in ((2, 1000, False), (3, 100, False), (2, 1000, True), (3, 100, True)):
        lattice = Lattice(1.0, (0.0,) * dim, (n - 1.0,) * dim)
        field = 8 * n**dim
        boundary = LatticePML(nodes=12) if layers else Fixed(0.0)
        small = Simulation(Lattice(1.0, (0.0,) * dim, (15.0,) * dim), Wave(Kernel(3.0)), boundary)
        small.step(1)  # loads the compiled program and its tables before counting
        gc.collect()
        tracemalloc.start()
        u = np.zeros(lattice.shape)
        u[(n // 2,) * dim] = 1
        sim = Simulation(lattice, Wave(Kernel(3.0)), boundary, initial={"u": u}, threads=1)
        del u
        gc.collect()
        held, set_up = tracemalloc.get_traced_memory()
        tracemalloc.reset_peak()
        sim.step(2)
        running = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        rows.append(
            {
                "m=3": f"{dim}D {n}^{dim}",
                "sides": "layers, 12 nodes" if layers else "fixed",
                "time levels": sim.engine.levels.nbytes / field,
                "slots": sim.engine.tables.layers.slots.nbytes / field,
                "layer memory": sim.engine.memory.nbytes / field,
                "held": held / field,
                "peak running": running / field,
                "peak set-up": set_up / field,
                "target held": "-" if layers else 5.0,
                "met": "-" if layers else verdict(held / field, 5.0, larger=False),
            }
        )
    return rows


if __name__ == "__main__":
    run_parts(
        __doc__,
        {
            "triad": ("Wave step against the 24 B/node update", lambda given: bandwidth(given.repeats)),
            "csr": ("Wave step against scipy CSR product", lambda given: against_matrix(given.repeats)),
            "float32": ("Single precision", lambda given: single_precision(given.repeats)),
            "memory": ("Memory in near fields of 8 B/node", lambda given: memory()),
        },
    )

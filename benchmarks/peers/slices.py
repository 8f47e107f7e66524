"""The same steps of a peridynamic wave by farhorizon, as scipy's sparse product, and as slices in NumPy and JAX.

1000^2 nodes, a horizon of three spacings with 36 neighbours, fixed sides, velocity Verlet, double precision, one
thread. All four compute the same scheme: their fields agree to rounding after some steps, which is asserted. The steps
are timed in turn, and the table has the medians of the ratios to ours. A program that is not installed is left out.

Run, in an environment with `requirements.txt`: ``python benchmarks/peers/slices.py [--json FILE] [--repeats N]``.
Takes a minute and 2 GB.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from one_thread import interleaved, median, ratio, save, table

import farhorizon as fh

NODES, STEPS = 1000, 20


class Scheme:
    """The set-up, and what the other programs need of it."""

    def __init__(self, nodes: int = NODES) -> None:
        axis = np.arange(nodes) - nodes // 2
        self.start = np.exp(-(axis[:, None] ** 2 + axis[None, :] ** 2) / 50.0)
        lattice = fh.Lattice(1.0, (0.0, 0.0), (nodes - 1.0, nodes - 1.0))
        kernel = fh.Kernel(3.0)
        self.sim = fh.Simulation(lattice, fh.Wave(kernel), fh.Fixed(0.0), {"u": self.start}, threads=1)
        stencil = fh.Stencil.from_kernel(kernel, 1.0, 2)
        scale = self.sim.dt**2
        self.terms = [(tuple(map(int, o)), scale * w) for o, w in zip(stencil.offsets, stencil.weights, strict=True)]
        self.own = scale * float(stencil.weights.sum())
        self.reach = int(np.abs(stencil.offsets).max())

    def sum_of(self, u, padded):  # type: ignore[no-untyped-def]  # arrays of NumPy or JAX
        """dt^2 L u, given u with zeros around it."""
        (n, m), r = u.shape, self.reach
        return sum(w * padded[r + i : r + i + n, r + j : r + j + m] for (i, j), w in self.terms) - self.own * u

    def matrix(self) -> sp.csr_matrix:
        """dt^2 L as a matrix."""
        n, r = len(self.start), self.reach
        numbers = np.pad(np.arange(n * n, dtype=np.int32).reshape(n, n), r, constant_values=-1)
        columns = [numbers[r + i : r + i + n, r + j : r + j + n].ravel() for (i, j), _ in self.terms]
        weights = [w for _, w in self.terms]
        order = np.argsort([i * numbers.shape[1] + j for (i, j), _ in self.terms])
        table_of = np.stack([columns[k] for k in order], axis=1)
        used = table_of >= 0
        data = np.broadcast_to(np.array(weights)[order], table_of.shape)[used]
        starts = np.concatenate([[0], np.cumsum(used.sum(1))]).astype(np.int32)
        off = sp.csr_matrix((data, table_of[used], starts), shape=(n * n, n * n))
        return (off - self.own * sp.identity(n * n, format="csr")).tocsr()


def stepped(change: Callable[[np.ndarray], np.ndarray], start: np.ndarray, count: int) -> np.ndarray:
    """Velocity Verlet from rest, by a function that returns dt^2 L u."""
    old, now = start, start + 0.5 * change(start)
    for _ in range(count - 1):
        old, now = now, 2 * now - old + change(now)
    return now


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers here, too")
    parser.add_argument("--repeats", type=int, default=5, help="interleaved repeats of each timing (default 5)")
    given = parser.parse_args()
    scheme = Scheme()
    matrix, start, reach = scheme.matrix(), scheme.start, scheme.reach
    cases: dict[str, Callable[[int], np.ndarray]] = {
        "scipy CSR": lambda count: stepped(lambda u: matrix @ u, start.ravel(), count).reshape(start.shape),
        "NumPy slices": lambda count: stepped(lambda u: scheme.sum_of(u, np.pad(u, reach)), start, count),
    }
    try:
        import jax
    except ImportError:
        print("JAX is not installed")
    else:
        jax.config.update("jax_enable_x64", True)

        def pair(_: int, state: tuple) -> tuple:
            old, now = state
            return now, 2 * now - old + scheme.sum_of(now, jax.numpy.pad(now, reach))

        @jax.jit
        def run(begin: jax.Array, count: int) -> jax.Array:
            first = begin + 0.5 * scheme.sum_of(begin, jax.numpy.pad(begin, reach))
            return jax.lax.fori_loop(0, count - 1, pair, (begin, first))[1]

        cases["JAX slices"] = lambda count: np.asarray(run(start, count))
    scheme.sim.step(STEPS)
    ours = scheme.sim.fields["u"]
    differences = {name: float(np.abs(case(STEPS) - ours).max()) for name, case in cases.items()}
    assert max(differences.values()) < 1e-12, differences  # of values up to one: rounding
    times = interleaved({"farhorizon": scheme.sim.step, **cases}, given.repeats, time.process_time)
    rows = [
        {
            "2D, 36 neighbours": name,
            "ns a node and step": 1e9 * median(times, name) / start.size,
            "times ours": ratio(times, name, "farhorizon"),
            "largest difference": differences.get(name, 0.0),
        }
        for name in times
    ]
    table("Steps of a peridynamic wave, 1000^2 nodes, one thread", rows)
    save(given.json, rows)


if __name__ == "__main__":
    main()

"""What a step of correspondence elasticity costs.

Measures, in one process with interleaved repeats (medians of the ratios of a round):

- square: 2D 400^2, Gaussian kernel with 44 neighbours, one thread: the intact body, with bonds that may break, with
  drag, with stabilisation, with layers of 20 nodes around it, and in all nodes the bond by bond loop (each node with
  one bond cut); the same operator as two scipy CSR products.
- cube: 3D 48^3, constant kernel with 122 neighbours, the same without the last two.

Rates are node updates per second, of the box with its layers. Target: 5 times as fast as CSR.

Run: ``python benchmarks/correspondence.py [square] [cube] [--json FILE] [--repeats N]``. Takes about a minute.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import numpy as np
from common import interleaved, median, ratio, run_parts, verdict
from scipy import sparse

from farhorizon import Body, Kernel, Lattice, NonlocalPML

SQUARE = Kernel(3.717, 0, "gaussian", 1.0, volume="full")
CUBE = Kernel(3.1, 0, volume="full")
TARGET = 5.0


def body(kernel: Kernel, n: int, dim: int, **options: Any) -> Body:
    """A fixed box of n^dim nodes with noise as data."""
    noise = np.random.default_rng(1).standard_normal((dim, *[n] * dim)) * 1e-3
    return Body(
        Lattice(1.0, (0.0,) * dim, (n - 1.0,) * dim),
        kernel,
        young=1.0,
        poisson=0.25,
        threads=1,
        initial={"u": noise},
        **options,
    )


def products(kernel: Kernel, n: int) -> Callable[[int], None]:
    """Gradient, Hooke's law, divergence and update with sparse matrices, 2D."""
    solid = body(kernel, n, 2)
    distances = solid.stencil.offsets
    number = np.arange(n * n).reshape(n, n)
    weights = solid.stencil.weights / (solid.stencil.weights * distances[:, 0] ** 2).sum()
    slopes = []
    for b in range(2):
        rows, columns, values = [], [], []
        for (i, j), w in zip(distances, weights, strict=True):
            here = number[max(0, -i) : n - max(0, i), max(0, -j) : n - max(0, j)].ravel()
            there = number[max(0, i) : n + min(0, i), max(0, j) : n + min(0, j)].ravel()
            rows.append(here)
            columns.append(there)
            values.append(np.full(here.size, w * (i, j)[b]))
        slopes.append(
            sparse.csr_matrix(
                (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(n * n, n * n)
            )
        )
    gradient = sparse.bmat(
        [[slopes[b] if a == c else None for c in range(2)] for a in range(2) for b in range(2)], format="csr"
    )
    divergence = sparse.csr_matrix(gradient.T)
    u, v = solid.u.ravel(), np.zeros(2 * n * n)

    def run(count: int) -> None:
        for _ in range(count):
            e = (gradient @ u).reshape(4, -1)
            trace = solid.lame * (e[0] + e[3])
            shear = solid.shear * (e[1] + e[2])
            stress = np.concatenate([trace + 2 * solid.shear * e[0], shear, shear, trace + 2 * solid.shear * e[3]])
            v[:] -= solid.dt * (divergence @ stress)
            u[:] += solid.dt * v

    return run


def rates(cases: dict[str, tuple[Callable[[int], None], int]], repeats: int, against: str) -> list[dict[str, Any]]:
    """Rows of node updates per second, and times over that of `against`."""
    times = interleaved({name: run for name, (run, _) in cases.items()}, repeats)
    return [
        {"case": name, "M nodes/s": 1e-6 * nodes / median(times, name), "time / intact": ratio(times, name, against)}
        for name, (_, nodes) in cases.items()
    ]


def cases(kernel: Kernel, n: int, dim: int, layers: int) -> dict[str, tuple[Callable[[int], None], int]]:
    """Bodies by name, each with the nodes of its box."""
    options: dict[str, dict[str, Any]] = {
        "intact": {},
        "may break": {"critical_stretch": 0.2},
        "drag": {"drag": 0.1},
        "stabilised": {"stabilisation": 0.5},
        f"layers of {layers}": {"boundary": NonlocalPML(layers)},
    }
    return {
        name: (body(kernel, n, dim, **o).step, (n + 2 * layers * ("boundary" in o)) ** dim)
        for name, o in options.items()
    }


def square(options: argparse.Namespace) -> list[dict[str, Any]]:
    """2D."""
    found = cases(SQUARE, 400, 2, 20)
    every_row = [[(-1.0, y + 0.5), (400.0, y + 0.5)] for y in range(399)]
    found["bond by bond"] = (body(SQUARE, 400, 2, cracks=every_row[::8]).step, 400**2)
    found["two CSR products"] = (products(SQUARE, 400), 400**2)
    rows = rates(found, options.repeats, "intact")
    for row in rows:
        row["target"] = verdict(row["time / intact"], TARGET, True) if row["case"].startswith("two") else "-"
    return rows


def cube(options: argparse.Namespace) -> list[dict[str, Any]]:
    """3D."""
    return rates(cases(CUBE, 48, 3, 8), options.repeats, "intact")


if __name__ == "__main__":
    run_parts(
        __doc__,
        {
            "square": ("2D 400^2, 44 neighbours, one thread", square),
            "cube": ("3D 48^3, 122 neighbours, one thread", cube),
        },
    )

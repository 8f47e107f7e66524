"""Time of a step compared with another checkout, case by case, in one run.

    python benchmarks/against.py ../other
    python benchmarks/against.py ../other "bar" --threads 2

One process per checkout holds the same set-ups. They advance in turn, by slices of a tenth of a second, and the
smallest time of each counts. A ratio below one means that this checkout is faster.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

SLICE = 0.1  # seconds per turn


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("other", type=Path, nargs="?", help="the other checkout; without it, a worker")
    parser.add_argument("cases", nargs="*", help=f"of {', '.join(CASES)}; all unless given")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=15, help="turns of each (default 15)")
    given = parser.parse_args()
    if given.other is None:
        _work(given.threads)
        return
    workers = [_Worker(folder, given.threads) for folder in (Path(__file__).parents[1], given.other.resolve())]
    print(f"{'case':32s} {'this / other':>12s} {'microseconds':>14s}")
    for name in given.cases or CASES:
        steps = max(1, int(SLICE / workers[0].ask(name, 1)))
        for worker in workers:
            worker.ask(name, steps)
        times = [[worker.ask(name, steps) / steps for worker in workers] for _ in range(given.repeats)]
        ours, theirs = (min(column) for column in zip(*times, strict=True))
        print(f"{name:32s} {ours / theirs:12.3f} {1e6 * ours:14.2f}", flush=True)


class _Worker:
    """Process that advances set-ups with the sources of one checkout."""

    def __init__(self, checkout: Path, threads: int) -> None:
        env = os.environ | {"PYTHONPATH": str(checkout / "src"), "NUMBA_NUM_THREADS": str(threads)}
        self.process = subprocess.Popen(
            [sys.executable, __file__, "--threads", str(threads)],
            env=env,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )

    def ask(self, name: str, steps: int) -> float:
        """Seconds that a number of steps takes."""
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write(f"{name};{steps}\n")
        self.process.stdin.flush()
        return float(self.process.stdout.readline())


def _work(threads: int) -> None:
    held: dict[str, Any] = {}
    for line in sys.stdin:
        name, steps = line.split(";")
        if name not in held:
            held.clear()  # one set-up at a time in memory
            held[name] = CASES[name](threads)
            held[name].step(3)
        start = time.perf_counter()
        held[name].step(int(steps))
        print(time.perf_counter() - start, flush=True)


def _wave(shape: tuple[int, ...], nodes: int) -> Callable[[int], Any]:
    def make(threads: int) -> Any:
        import farhorizon as fh

        lattice = fh.Lattice(1.0, [0.0] * len(shape), [n - 1.0 for n in shape])
        side = fh.LatticePML(nodes=nodes) if nodes else fh.Fixed(0.0)
        middle = "+".join(f"({x}-{n // 2})**2" for x, n in zip("xyz", shape, strict=False))
        return fh.Simulation(lattice, fh.Wave(fh.Kernel(3.0)), side, {"u": f"exp(-({middle})/4)"}, threads=threads)

    return make


def _elastic(breaking: bool) -> Callable[[int], Any]:
    def make(threads: int) -> Any:
        import farhorizon as fh

        lattice = fh.Lattice(1.0, (0.0, 0.0), (399.0, 399.0))
        model = fh.Elastic(fh.Kernel(3.0), 1.0, critical_stretch=0.1 if breaking else None)
        start = {"u": ["exp(-((x-200)**2+(y-200)**2)/30)/100", "0"]}
        return fh.Simulation(lattice, model, fh.LatticePML(nodes=10), start, threads=threads)

    return make


def _corrosion(threads: int) -> Any:
    import numpy as np

    import farhorizon as fh

    solid = np.zeros((400, 400), bool)
    solid[:, 200:] = True
    lattice = fh.Lattice(1.0, (0.0, 0.0), (399.0, 399.0))
    model = fh.Corrosion(fh.Kernel(3.0), saturation=0.5, interface=0.1)
    metal = [fh.Specimen(solid, 2.0)]
    return fh.Simulation(lattice, model, fh.Periodic(), specimens=metal, threads=threads)


def _exact(threads: int) -> Any:
    import farhorizon as fh

    return fh.Simulation(
        fh.Lattice(1.0, 0.0, 200.0), fh.Wave(fh.Kernel(3.0)), fh.Exact(), {"u": "exp(-(x-100)**2/4)"}, threads=threads
    )


CASES: dict[str, Callable[[int], Any]] = {
    "bar of 201, bare": _wave((201,), 0),
    "bar of 201, layers": _wave((201,), 12),
    "bar of 201, exact ends": _exact,
    "square of 1000, bare": _wave((1000, 1000), 0),
    "square of 1000, layers of 12": _wave((1000, 1000), 12),
    "cube of 100, bare": _wave((100, 100, 100), 0),
    "cube of 100, layers of 4": _wave((100, 100, 100), 4),
    "elastic square of 400": _elastic(False),
    "breaking square of 400": _elastic(True),
    "corrosion of 400": _corrosion,
}


if __name__ == "__main__":
    main()

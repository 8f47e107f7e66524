"""Runs on several processes compared with threads of one: weak and strong scaling, and messages.

Each part starts programs one after the other, round by round, and prints medians of the ratios of a round:

- weak: waves of reach 3 with fixed sides and equally many nodes for each thread, 2000^2 and 200^3 (with `--quick` 500^2
  and 60^3): time of a step on one thread over that on two processes of one thread each, and over that on two threads of
  one process. Target: processes reach 95 % of the efficiency of threads, and the exchange takes 5 % of a step.
- strong: waves in 100^3 nodes with layers, one thread over two processes of one thread each. Target: 1.8.
- overlap: time of a step on two processes that sweeps nodes while messages travel, relative to one that waits for them
  first; the fraction of the latter that an exchange takes, and the fraction of the exchange that is hidden. Smallest of
  many times in turns.
- messages: time of one message between two processes, in both directions at once, including packing and unpacking: the
  smallest of many times for messages of 168 bytes and of 24 MB; and the part of it that is not hidden by other work.
  `check --details` predicts efficiencies from these (`farhorizon.simulation.processes.parallel_prediction`).
- curves: weak and strong scaling over the numbers of processes (of one thread each) in `--processes`: a table of the
  efficiencies and of the bytes that a process sends, and with `--plot FILE` a plot. Runs only on request.

The number of bytes that a process sends in each step is printed. All parts require a quiet machine.

Run: ``python benchmarks/scaling.py [weak] [strong] [overlap] [messages] [curves] [--quick] [--rounds N]
[--processes 1 2 4 8] [--plot FILE]``; it needs mpi4py and mpiexec.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import subprocess
import sys
import time
from statistics import median
from typing import Any


def made(kind: str, size: int, dim: int, threads: int, parts: int) -> Any:
    """Simulation of waves on these processes; for weak scaling, it is divided across the first axis."""
    from mpi4py import MPI

    import farhorizon as fh

    world = MPI.COMM_WORLD
    shape = [size * (parts if kind == "weak" else 1)] + [size] * (dim - 1)
    lattice = fh.Lattice(1.0, [0.0] * dim, [n - 1.0 for n in shape])
    sides = fh.Fixed() if kind == "weak" else fh.LatticePML(nodes=10)
    grid = [world.size] + [1] * (dim - 1) if kind == "weak" else None
    given: Any = {"communicator": world, "topology": grid} if world.size > 1 else {}
    start = {"u": "exp(-" + "-".join(f"({axis}-{size // 2})**2" for axis in "xyz"[:dim]) + ")"}
    sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(3.0)), sides, start, threads=threads, **given)
    sim.engine.advance(3)
    return sim


def seconds_of(work: Any, count: int) -> float:
    """Seconds per unit of `count` units of work, on the slowest process."""
    from mpi4py import MPI

    world = MPI.COMM_WORLD
    world.Barrier()
    began = time.perf_counter()
    work(count)
    return float(world.allreduce((time.perf_counter() - began) / count, MPI.MAX))


def measure(kind: str, size: int, dim: int, threads: int, parts: int) -> None:
    """Print the times of a step on these processes and of an exchange, in seconds."""
    from mpi4py import MPI

    engine = made(kind, size, dim, threads, parts).engine
    times, exchanges = [], []
    for _ in range(7):
        times.append(seconds_of(engine.advance, 5))
        if engine.exchange is not None:
            exchanges.append(
                seconds_of(lambda count: engine.exchange.fill(engine.current, engine.components, count), 20)
            )
    volume = 0 if engine.exchange is None else engine.exchange.volume(engine.components)
    if MPI.COMM_WORLD.rank == 0:
        facts = {"step": min(times), "exchange": min(exchanges, default=0.0), "bytes": volume}
        print(json.dumps(facts), flush=True)


def measure_overlap(kind: str, size: int, dim: int) -> None:
    """Print the times of a step that sweeps nodes while messages travel, of one that waits for them first, and of an
    exchange: the smallest of many that are measured in turns, for a few milliseconds each.
    """
    import numpy as np
    from mpi4py import MPI

    engine = made(kind, size, dim, 1, 2).engine
    count = max(1, int(0.005 / seconds_of(engine.advance, 5)))
    least = dict.fromkeys(("ahead", "plain", "exchange"), float("inf"))
    boxes = {"ahead": engine.tables.free, "plain": np.zeros_like(engine.tables.free)}
    for _ in range(200):
        for name, box in boxes.items():
            engine.replace(free=box)
            engine.advance(1)
            least[name] = min(least[name], seconds_of(engine.advance, count))
        seconds = seconds_of(lambda n: engine.exchange.fill(engine.current, engine.components, n), 5 * count)
        least["exchange"] = min(least["exchange"], seconds)
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(least), flush=True)


def overlap(quick: bool, rounds: int) -> None:
    """Compare steps with and without sweeping while messages travel."""
    cases = [("weak", 500, 2), ("weak", 60, 3), ("strong", 60, 3)]
    for kind, size, dim in cases if quick else [*cases, ("weak", 2000, 2), ("weak", 200, 3)]:
        every = [started(2, "overlap", kind, size, dim) for _ in range(rounds)]
        ratio = median(one["ahead"] / one["plain"] for one in every)
        share = median(one["exchange"] / one["plain"] for one in every)
        hidden = median((one["plain"] - one["ahead"]) / one["exchange"] for one in every)
        told = "each" if kind == "weak" else "with layers of 10"
        print(
            f"overlap, {size}^{dim} {told}: a step that sweeps while messages travel takes "
            f"{ratio:.3f} of one that waits for them; an exchange takes {share:.3f} of it, and {hidden:.2f} of that is "
            "hidden",
            flush=True,
        )


def measure_messages(size: int) -> None:
    """Print the bytes of a message along a line of `size` nodes, its smallest time, and the part of it that remains if
    a process computes meanwhile and lets messages progress now and then, in seconds.
    """
    from mpi4py import MPI

    import farhorizon as fh

    world = MPI.COMM_WORLD
    lattice = fh.Lattice(1.0, [0.0, 0.0], [13.0, size - 1.0])
    sides = {"x": fh.Periodic(), "y": fh.Fixed()}
    sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(3.0)), sides, threads=1, communicator=world, topology=[2, 1])
    exchange, level = sim.engine.exchange, sim.engine.current
    assert exchange is not None
    count, least = max(1, 20_000 // size), float("inf")
    for _ in range(40):
        world.Barrier()
        began = time.perf_counter()
        exchange.fill(level, 1, count)
        least = min(least, (time.perf_counter() - began) / count / 2)  # one message to either side
    seconds = world.allreduce(least, MPI.MAX)
    left = min(left_of(exchange, level, 4 * seconds) / 2 for _ in range(max(20, 8 * count)))
    left = world.allreduce(left, MPI.MAX)
    if world.rank == 0:
        print(json.dumps({"bytes": exchange.volume(1) / 2, "seconds": seconds, "left": left}), flush=True)


def left_of(exchange: Any, level: Any, meanwhile: float) -> float:
    """Seconds of an exchange along the first axis, without the `meanwhile` seconds in which the process does other
    work.
    """
    from mpi4py import MPI

    from farhorizon.engine.codegen.exchanges import MOVES, RECEIVES, SENDS, TABLE
    from farhorizon.engine.exchange import LEVEL

    numbers = exchange.numbers[LEVEL, 1].tolist()
    kind = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 4)
    send, move, receive = (kind(numbers[column]) for column in (SENDS, MOVES, RECEIVES))
    given = numbers[TABLE], level.ctypes.data, 1, level.nbytes
    now = time.perf_counter
    MPI.COMM_WORLD.Barrier()
    began = now()
    send(*given)
    spent, until = now() - began, now() + meanwhile
    while now() < until:
        pause = now() + meanwhile / 20
        while now() < pause:
            pass
        began = now()
        move(*given)
        spent += now() - began
    began = now()
    receive(*given)
    return spent + now() - began


def messages(rounds: int) -> None:
    """Measure latency and bandwidth, and what remains of both next to other work."""
    found = [(size, [started(2, "messages", size) for _ in range(rounds)]) for size in (7, 1_000_000)]
    (few, many), words = (every[0]["bytes"] for _, every in found), []
    for name in ("seconds", "left"):
        latency, long = (median(one[name] for one in every) for _, every in found)
        bandwidth = 1e-9 * (many - few) / (long - latency)
        words.append(f"{1e6 * latency:.3g} us and {1e3 * long:.3g} ms, {bandwidth:.3g} GB/s")
    print(
        f"messages between two processes of {few:.0f} bytes and of {many:.0f}: {words[0]}; beside other work there are "
        f"left {words[1]}"
    )


def started(processes: int, *words: object) -> dict[str, float]:
    """Run `measure` on a number of processes and return what it prints."""
    command = ["mpiexec", "-n", str(processes), sys.executable, __file__, "--measure", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def weak(size: int, dim: int, rounds: int) -> None:
    """Measure twice the nodes on two processes, and on two threads."""
    ratios: dict[str, list[float]] = {"processes": [], "threads": [], "exchange": []}
    for _ in range(rounds):
        one, two, both = (
            started(n, "weak", size, dim, threads, parts) for n, threads, parts in ((1, 1, 1), (2, 1, 2), (1, 2, 2))
        )
        ratios["processes"].append(one["step"] / two["step"])
        ratios["threads"].append(one["step"] / both["step"])
        ratios["exchange"].append(two["exchange"] / two["step"])
    found = {name: median(values) for name, values in ratios.items()}
    print(
        f"weak, {size}^{dim} each: {found['processes']:.2f} on two processes, {found['threads']:.2f} on two threads: "
        f"{found['processes'] / found['threads']:.2f} of it; the exchange of {two['bytes']:.0f} bytes takes "
        f"{100 * found['exchange']:.1f} % of a step of {1e3 * two['step']:.3g} ms"
    )


def strong(size: int, rounds: int) -> None:
    """Measure the same nodes on two processes."""
    found = [
        started(1, "strong", size, 3, 1, 1)["step"] / started(2, "strong", size, 3, 1, 1)["step"] for _ in range(rounds)
    ]
    print(f"strong, {size}^3 with layers of 10: {median(found):.2f} on two processes")


def curves(counts: list[int], quick: bool, rounds: int, plot: str | None) -> None:
    """Measure efficiencies over numbers of processes, relative to the first number."""
    sizes = dict.fromkeys(("weak", "strong"), (60, 3) if quick else (200, 3))
    found: dict[str, list[float]] = {kind: [] for kind in sizes}
    print("processes  weak  strong  bytes sent by one (weak, strong)")
    for count in counts:
        sent = []
        for kind, (size, dim) in sizes.items():
            every = [started(count, kind, size, dim, 1, count if kind == "weak" else 1) for _ in range(rounds)]
            step = median(one["step"] for one in every)
            found[kind].append(step if kind == "weak" else step * count)
            sent.append(every[0]["bytes"])
        shares = [values[0] / values[-1] for values in found.values()]
        print(f"{count:9d}  {shares[0]:4.2f}  {shares[1]:6.2f}  {sent[0]:.0f}, {sent[1]:.0f}", flush=True)
    if plot is not None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        figure = Figure(figsize=(5, 3.5), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.add_subplot(xlabel="processes", ylabel="efficiency", xscale="log", ylim=(0, 1.1))
        for kind, values in found.items():
            axes.plot(counts, [values[0] / one for one in values], "o-", label=kind)
        axes.set_xticks(counts, [str(count) for count in counts])
        axes.minorticks_off()
        axes.legend()
        figure.savefig(plot)


def main() -> None:
    """Run the command line."""
    if sys.argv[1:3] == ["--measure", "messages"]:
        measure_messages(int(sys.argv[3]))
        return
    if sys.argv[1:3] == ["--measure", "overlap"]:
        measure_overlap(sys.argv[3], *map(int, sys.argv[4:]))
        return
    if sys.argv[1:2] == ["--measure"]:
        measure(sys.argv[2], *map(int, sys.argv[3:]))
        return
    parser = argparse.ArgumentParser()
    parser.add_argument("parts", nargs="*", default=["weak", "strong", "overlap", "messages"])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--processes", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--plot")
    options = parser.parse_args()
    if "weak" in options.parts:
        for size, dim in ((500, 2), (60, 3)) if options.quick else ((2000, 2), (200, 3)):
            weak(size, dim, options.rounds)
    if "strong" in options.parts:
        strong(60 if options.quick else 100, options.rounds)
    if "overlap" in options.parts:
        overlap(options.quick, options.rounds)
    if "messages" in options.parts:
        messages(options.rounds)
    if "curves" in options.parts:
        curves(options.processes, options.quick, options.rounds, options.plot)


if __name__ == "__main__":
    main()

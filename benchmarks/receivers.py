"""Cost of receivers and spectra per wave step.

Measures the processor time of `Simulation.step` on 1000^2 nodes, m = 3, one thread, for one simulation with and without
its recorder in turn, so that both use the same pages of memory. The result is the median of the ratios of neighbouring
turns, with quartiles. A turn is so long that the work of Python at the end of a call matters as little as in a run.

- points: 1000 receivers at every step, in a line along x, in a line along y and scattered, on nodes and between them
  (windowed sinc, linear). Aim: at most 5 % more.
- shell: sums at 20 frequencies on all nodes within two reaches of the edge of a box of 900^2 nodes, over every step and
  over every third one, which suffices for all waves on the lattice. Aim: at most 10 % more.
- power: through the edge of that box, for information.

Run: ``python benchmarks/receivers.py [points] [shell] [power] [--json FILE] [--repeats N]``. Takes some minutes.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from common import run_parts, verdict

import farhorizon as fh
from farhorizon.simulation.recorders.recording import Recording

NODES, REACH = 1000, 3
STEPS = 20  # steps per turn; a run makes 200 steps of this size before it returns to Python
SEED = 20261123


def simulation(*observe: Any) -> fh.Simulation:
    """Simulation with noise, which prevents denormal numbers, between fixed edges."""
    noise = np.random.default_rng(SEED).standard_normal((NODES, NODES))
    lattice = fh.Lattice(1.0, (0.0, 0.0), (NODES - 1.0, NODES - 1.0))
    return fh.Simulation(
        lattice, fh.Wave(fh.Kernel(float(REACH))), fh.Fixed(), {"u": noise}, threads=1, observe=observe
    )


def turns(sim: fh.Simulation, rounds: int) -> np.ndarray:
    """Processor time of a step without its recorders and with them, turn by turn, shape (rounds, 2)."""
    recordings = Recording(sim.setup, sim.parts), sim._recording
    found = np.zeros((rounds, 2))
    for row in found:
        for i, recording in enumerate(recordings):
            recording._lay()
            sim._recording = recording
            sim.step(1)  # checks new tables once
            begin = time.thread_time()
            sim.step(STEPS)
            row[i] = (time.thread_time() - begin) / STEPS
    return found


def measure(cases: dict[str, Any], aim: float | None, repeats: int) -> list[dict[str, Any]]:
    """Cost of each recorder per step."""
    rows = []
    for name, recorder in cases.items():
        times = turns(simulation(recorder), 20 * repeats)
        low, added, high = 100 * (np.quantile(times[:, 1] / times[:, 0], (0.25, 0.5, 0.75)) - 1)
        met = "-" if aim is None else verdict(added, aim, larger=False)
        rows.append(
            {
                "recorder": name,
                "step ms": 1e3 * float(np.median(times[:, 0])),
                "added %": added,
                "quartiles": f"{low:.1f} .. {high:.1f}",
                "aim": aim,
                "met": met,
            }
        )
    return rows


def points(repeats: int) -> list[dict[str, Any]]:
    """Measure 1000 receivers."""
    along, across = np.linspace(20.0, 979.0, 1000), np.full(1000, 500.3)
    scattered = np.random.default_rng(SEED).uniform(20, 979, (1000, 2))
    places = {
        "along x": np.column_stack([along, across]),
        "along y": np.column_stack([across, along]),
        "scattered": scattered,
    }
    cases = {f"{name}, on nodes": fh.Receivers(np.round(at)) for name, at in places.items()}
    cases |= {f"{name}, linear": fh.Receivers(at, interpolation="linear") for name, at in places.items()}
    cases |= {f"{name}, sinc": fh.Receivers(at) for name, at in places.items()}
    return measure(cases, 5.0, repeats)


def box() -> fh.Box:
    """Box of 900^2 nodes."""
    return fh.Box((50.0, 50.0), (NODES - 51.0, NODES - 51.0))


def shell(repeats: int) -> list[dict[str, Any]]:
    """Measure sums at 20 frequencies on a shell of two reaches."""
    inner = fh.Box((50.0 + 2 * REACH,) * 2, (NODES - 51.0 - 2 * REACH,) * 2)
    frequencies = np.linspace(0.01, 0.2, 20)
    cases = {
        f"20 frequencies, every = {every}": fh.Spectra(box() - inner, frequencies, every=every) for every in (1, 3)
    }
    return measure(cases, 10.0, repeats)


def power(repeats: int) -> list[dict[str, Any]]:
    """Measure the power through the edge of a box."""
    return measure({"power through the box": fh.PowerThrough(box())}, None, repeats)


if __name__ == "__main__":
    run_parts(
        __doc__,
        {
            "points": ("1000 receivers at every step", lambda given: points(given.repeats)),
            "shell": ("Spectra on a shell", lambda given: shell(given.repeats)),
            "power": ("Power through a box", lambda given: power(given.repeats)),
        },
    )

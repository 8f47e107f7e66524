"""Acoustic waves in three layers without edges, by farhorizon, Deepwave, Devito and k-Wave: error against time.

One physical problem: a pulse in a plane whose speed of sound rises from 1 to 2 with depth, in steps with smooth flanks,
recorded by five receivers until it has left. The truth is a pseudospectral solution of fourth order in time, by NumPy,
on a periodic plane so large that nothing returns. The error of a program is the largest difference of its records
from it, relative to their largest value; it holds the errors of space, of time and of the absorbing layers.

Each program computes the problem with several spacings, orders in space, time steps and widths of layers, in double
precision on one thread. For each error that is asked for, the fastest settings that reach it count. These are then
timed in turn, and the table has the medians of the ratios to ours. The times are processor times of whole calls, with
their set-up, after a first one that compiles. A program that is not installed is left out.

- Deepwave has its own layer (C-PML). Devito leaves the layer to the user; this is the damping of its seismic examples.
- k-Wave's compiled program is no part of its package on PyPI. Where it is missing, this is its solver in NumPy.

Run, in an environment with `requirements.txt`: ``python benchmarks/peers/acoustic.py [--json FILE] [--repeats N]``.
Takes half an hour, with ``--quick`` a few minutes, without the finest grids.
"""

from __future__ import annotations

import argparse
import itertools
import json
import statistics
import sys
import time
import urllib.request
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from one_thread import save, table  # before the others are loaded
from scipy.fft import irfft2, rfft2

import farhorizon as fh

HALF, UNTIL, SAMPLE = 6.0, 10.0, 0.25  # half the width of the plane, end of the run, and time between samples
WIDTH, SOURCE = 0.5, (0.0, 3.0)  # of the pulse exp(-(r / WIDTH)^2)
RECEIVERS = np.array([(-3.0, 4.0), (3.0, 0.0), (4.2, -3.0), (0.0, -4.2), (-4.2, 4.2)])
FASTEST = 2.0
TARGETS = (1e-2, 1e-3)


class Settings(NamedTuple):
    """How a program computes the problem."""

    spacing: float
    order: int  # of differences in space
    courant: float  # time step times the largest speed over the spacing, at most
    layer: int  # nodes
    steps: int = 2  # order in time

    @property
    def step(self) -> float:
        """The time step, of which a whole number is the time between samples."""
        return SAMPLE / np.ceil(SAMPLE * FASTEST / (self.courant * self.spacing) - 1e-9)

    @property
    def axis(self) -> np.ndarray:
        """Coordinates of the nodes along each axis."""
        return np.linspace(-HALF, HALF, round(2 * HALF / self.spacing) + 1)

    @property
    def every(self) -> int:
        """Steps between samples."""
        return round(SAMPLE / self.step)

    @property
    def places(self) -> np.ndarray:
        """Indices of the receivers, (5, 2)."""
        return np.round((RECEIVERS + HALF) / self.spacing).astype(int)


def speed(y: np.ndarray) -> np.ndarray:
    """Speed of sound at a height: 1, 1.5 and 2 from above, with flanks of a pulse's width."""
    return 1.5 - 0.25 * np.tanh((y - 1.5) / WIDTH) - 0.25 * np.tanh((y + 2.5) / WIDTH)


def pulse(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Initial values; the field is at rest."""
    return np.exp(-((x - SOURCE[0]) ** 2 + (y - SOURCE[1]) ** 2) / WIDTH**2)


def after(x: np.ndarray, y: np.ndarray, dt: float) -> np.ndarray:
    """Values a step after the start, and before it, by the Taylor series up to the second order."""
    r2 = ((x - SOURCE[0]) ** 2 + (y - SOURCE[1]) ** 2) / WIDTH**2
    return pulse(x, y) * (1 + 0.5 * (dt * speed(y)) ** 2 * (4 * r2 - 4) / WIDTH**2)


@cache
def truth(nodes: int = 256, half: float = 12.8, dt: float = 1 / 64) -> np.ndarray:
    """Records, (samples, receivers), of the pseudospectral solution. What leaves through one edge
    and comes back through the other arrives after the end of the run.
    """
    axis = -half + 2 * half / nodes * np.arange(nodes)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    k = 2 * np.pi * np.fft.fftfreq(nodes, 2 * half / nodes)
    minus_k2 = -(k[:, None] ** 2 + k[None, : nodes // 2 + 1] ** 2)
    c2 = speed(y) ** 2

    def operator(u: np.ndarray) -> np.ndarray:
        return c2 * irfft2(minus_k2 * rfft2(u), s=u.shape)

    def change(u: np.ndarray) -> np.ndarray:
        first = operator(u)
        return dt**2 * (first + dt**2 / 12 * operator(first))

    old = pulse(x, y)
    now = old + 0.5 * change(old)
    places = tuple(np.round((RECEIVERS + half) / (2 * half / nodes)).astype(int).T)
    records, every = [old[places]], round(SAMPLE / dt)
    for step in range(1, round(UNTIL / dt) + 1):
        if step % every == 0:
            records.append(now[places])
        old, now = now, 2 * now - old + change(now)
    return np.array(records)


def by_farhorizon(settings: Settings) -> np.ndarray:
    """Records of our program."""
    lattice = fh.Lattice(settings.spacing, (-HALF, -HALF), (HALF, HALF))
    model = fh.Wave(
        fh.Stencil.finite_difference(2, order=settings.order),
        speed=lambda x, y: speed(y),
        density=lambda x, y: speed(y) ** -2,
        integrator="verlet" if settings.steps == 2 else "modified-equation",
    )
    records = fh.Receivers(RECEIVERS, interpolation="linear")
    sim = fh.Simulation(
        lattice,
        model,
        fh.LatticePML(nodes=settings.layer),
        initial={"u": lambda x, y: pulse(x, y)},
        dt=settings.step,
        observe=[records],
        threads=1,
    )
    sim.step(round(UNTIL / settings.step))
    return records.data["u"][:: settings.every]


def _steepest(order: int) -> float:
    """The largest Courant number that Deepwave takes without dividing the steps that it is given."""
    import deepwave

    return deepwave.discretisation.critical_courant_number(order, propagator=deepwave.scalar)


def by_deepwave(settings: Settings) -> np.ndarray:
    """Records of Deepwave."""
    import deepwave
    import torch

    torch.set_num_threads(1)
    _, y = np.meshgrid(settings.axis, settings.axis, indexing="ij")
    outer = settings.spacing * (np.arange(len(settings.axis) + 2 * settings.layer) - settings.layer) - HALF
    wide = np.meshgrid(outer, outer, indexing="ij")
    steps = round(UNTIL / settings.step)
    found = deepwave.scalar(
        torch.tensor(speed(y)),
        settings.spacing,
        settings.step,
        wavefield_0=torch.tensor(pulse(*wide))[None],
        wavefield_m1=torch.tensor(after(*wide, settings.step))[None],
        receiver_locations=torch.tensor(settings.places)[None],
        accuracy=settings.order,
        pml_width=settings.layer,
        origin=[0, 0],
        pml_freq=0.5 / WIDTH,
        max_vel=FASTEST,
        courant_number=_steepest(settings.order),
        nt=steps + 1,
    )
    return found[-1][0].numpy().T[:: settings.every]


@cache
def _devito_operator(settings: Settings) -> Any:
    import devito

    devito.configuration["log-level"] = "ERROR"
    devito.configuration["language"] = "C"
    n, b = len(settings.axis), settings.layer
    side = 2 * HALF + 2 * b * settings.spacing
    origin = (-HALF - b * settings.spacing,) * 2
    grid = devito.Grid((n + 2 * b,) * 2, (side, side), origin, dtype=np.float64)
    u = devito.TimeFunction(name="u", grid=grid, time_order=2, space_order=settings.order)
    m, damp = (devito.Function(name=name, grid=grid) for name in ("m", "damp"))
    depth = np.zeros(n + 2 * b)
    depth[:b] = (b - np.arange(b)) / b
    depth = np.maximum(depth, depth[::-1])
    profile = 1.5 * np.log(1000.0) / b * (depth - np.sin(2 * np.pi * depth) / (2 * np.pi)) / settings.spacing
    if 2 * b * settings.spacing >= FASTEST * UNTIL:
        profile *= 0  # nothing returns in time, and no damping reflects
    damp.data[:] = profile[:, None] + profile[None, :]
    outer = settings.spacing * (np.arange(n + 2 * b) - b) - HALF
    x, y = np.meshgrid(outer, outer, indexing="ij")
    m.data[:] = speed(y) ** -2
    steps = round(UNTIL / settings.step)
    records = devito.SparseTimeFunction(name="rec", grid=grid, npoint=len(RECEIVERS), nt=steps + 1)
    records.coordinates.data[:] = RECEIVERS
    update = devito.Eq(u.forward, devito.solve(m * u.dt2 - u.laplace + damp * u.dt, u.forward))
    operator = devito.Operator([update, records.interpolate(expr=u)])
    return operator, u, records, (pulse(x, y), after(x, y, settings.step)), steps


def by_devito(settings: Settings) -> np.ndarray:
    """Records of Devito."""
    operator, u, records, (start, second), steps = _devito_operator(settings)
    u.data[0], u.data[1], u.data[2] = start, second, second  # at 0, dt and -dt
    operator.apply(time_m=0, time_M=steps, dt=settings.step)
    return np.array(records.data[:: settings.every])


def by_kwave(settings: Settings) -> np.ndarray:
    """Records of k-Wave's solver in NumPy; its differences have no order."""
    from kwave.kgrid import kWaveGrid
    from kwave.kmedium import kWaveMedium
    from kwave.ksensor import kSensor
    from kwave.ksource import kSource
    from kwave.kspaceFirstOrder import kspaceFirstOrder

    x, y = np.meshgrid(settings.axis, settings.axis, indexing="ij")
    grid = kWaveGrid([len(settings.axis)] * 2, [settings.spacing] * 2)
    steps = round(UNTIL / settings.step)
    grid.setTime(steps + 1, settings.step)
    source, mask = kSource(), np.zeros(x.shape, bool)
    source.p0 = pulse(x, y)
    mask[tuple(settings.places.T)] = True
    found = kspaceFirstOrder(
        grid,
        kWaveMedium(sound_speed=speed(y), density=1.0),
        source,
        kSensor(mask=mask, record=["p"]),
        pml_size=settings.layer,
        smooth_p0=False,
        dtype=np.float64,
        quiet=True,
    )
    order = {tuple(place): row for row, place in enumerate(np.argwhere(mask))}
    return found["p"][[order[tuple(place)] for place in settings.places]].T[:: settings.every]


def _without_downloads() -> None:
    """k-Wave looks for its compiled program on the network when it is imported; without one it has to go on."""

    def refuse(*given: Any) -> None:
        raise TimeoutError

    kept, urllib.request.urlretrieve = urllib.request.urlretrieve, refuse  # type: ignore[assignment]
    try:
        import kwave  # noqa: F401
    finally:
        urllib.request.urlretrieve = kept


def programs() -> dict[str, Callable[[Settings], np.ndarray]]:
    """The programs that are installed."""
    known = {"farhorizon": by_farhorizon, "Deepwave": by_deepwave, "Devito": by_devito, "k-Wave (NumPy)": by_kwave}
    modules = {"Deepwave": "deepwave", "Devito": "devito", "k-Wave (NumPy)": "kwave"}
    found = {}
    for name, program in known.items():
        try:
            if name.startswith("k-Wave"):
                _without_downloads()
            __import__(modules.get(name, "farhorizon"))
        except ImportError:
            print(f"{name} is not installed", file=sys.stderr)
        else:
            found[name] = program
    return found


def error_of(records: np.ndarray) -> float:
    """Largest difference from the truth, relative to its largest value."""
    return float(np.abs(records - truth()).max() / np.abs(truth()[1:]).max())


def choices(name: str, quick: bool) -> list[Settings]:
    """Settings that are tried, coarse ones first."""
    spacings = (0.2, 0.1, 0.2 / 3) if quick else (0.2, 0.1, 0.2 / 3, 0.05)
    if name.startswith("k-Wave"):  # its steps are exact in a uniform medium
        each = itertools.product(spacings, (0,), (0.5, 0.25), (20,), (2,))
    elif name == "Devito":  # forty nodes that damp, as in its examples, or so many that nothing returns
        return [
            Settings(spacing, order, courant, nodes)
            for spacing, order, courant in itertools.product(spacings, (4, 8), (0.5, 0.25, 0.125))
            for nodes in (40, int(np.ceil(FASTEST * UNTIL / 2 / spacing)))
        ]
    else:  # only ours has steps of fourth order as it comes
        each = itertools.product(
            spacings, (4, 8), (0.5, 0.25, 0.125), (10, 20, 40), (2, 4) if name == "farhorizon" else (2,)
        )
    return [Settings(*one) for one in each]


def measured(name: str, program: Callable[[Settings], np.ndarray], quick: bool) -> list[tuple[float, float, Settings]]:
    """Error and time of all settings of a program."""
    found = []
    for settings in choices(name, quick):
        if found and settings.spacing < found[-1][2].spacing and min(found)[0] <= min(TARGETS):
            break  # a finer grid takes longer
        try:
            error = error_of(program(settings))
        except fh.InputError as refused:
            print(f"{name} {tuple(settings)}: {refused}", file=sys.stderr)
            continue
        spent = float("inf")
        if error <= max(TARGETS):
            begin = time.process_time()
            program(settings)
            spent = time.process_time() - begin
        found.append((error, spent, settings))
        print(f"{name:16s} {tuple(settings)!s:40s} {error:.2e} {spent:8.3f} s", file=sys.stderr, flush=True)
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers here, too")
    parser.add_argument("--repeats", type=int, default=5, help="repeats of each timing (default 5)")
    parser.add_argument("--quick", action="store_true", help="leave out the finest grid")
    parser.add_argument(
        "--found", type=Path, metavar="FILE", help="keep what all settings gave, to time the best ones again"
    )
    parser.add_argument("--only", nargs="+", help="programs, by the beginnings of their names")
    given = parser.parse_args()
    known = programs()
    if given.only:
        known = {name: program for name, program in known.items() if name.startswith(tuple(given.only))}
    before = json.loads(given.found.read_text()) if given.found and given.found.exists() else {}
    tried = {}
    for name, program in known.items():
        kept = [(error, spent, Settings(*settings)) for error, spent, settings in before.get(name, [])]
        tried[name] = kept or measured(name, program, given.quick)
    if given.found:
        given.found.write_text(json.dumps(before | tried, indent=1) + "\n")
    rows = []
    for target in TARGETS:
        fastest = {}
        for name, found in tried.items():
            good = [entry for entry in found if entry[0] <= target]
            if good:
                fastest[name] = min(good, key=lambda entry: entry[1])
        times: dict[str, list[float]] = {name: [] for name in fastest}
        for _ in range(given.repeats):
            for name, (_, _, settings) in fastest.items():
                begin = time.process_time()
                known[name](settings)
                times[name].append(time.process_time() - begin)
        for name in tried:
            row: dict[str, Any] = {"error at most": target, "program": name}
            if name in fastest:
                error, _, settings = fastest[name]
                ours = zip(times[name], times["farhorizon"], strict=True) if "farhorizon" in times else ()
                ratios = [theirs / own for theirs, own in ours]
                row |= {
                    "error": error,
                    "nodes": f"{len(settings.axis)}^2",
                    "order": settings.order or "spectral",
                    "in time": settings.steps,
                    "courant": settings.courant,
                    "layer": settings.layer,
                    "seconds": statistics.median(times[name]),
                    "times ours": statistics.median(ratios) if ratios else float("nan"),
                }
            else:
                keys = ("nodes", "order", "in time", "courant", "layer", "seconds", "times ours")
                row |= {"error": min(found[0] for found in tried[name])} | dict.fromkeys(keys, "-")
            rows.append(row)
    table("Acoustic waves in three layers, one thread", rows)
    save(given.json, rows)


if __name__ == "__main__":
    main()

"""Is the error of a run below the target that its layers were asked for, and could they be thinner?

Random set-ups that nobody tuned on, of a printed seed: waves (reach 1 to 6, exponent 0 to 3, all influences and
volumes, finite elements), elastic materials in the plane, diffusion; pulses of 6 to 30 nodes a wave, in the middle and
near sides, near fields up to 4 : 1, waveguides, 2 to 40 crossings (3D: 2 to 5), steps from 0.3 to 0.95 of the limit.
The error is the largest difference from the infinite lattice over near field and run, over the initial maximum, in
diffusion over the largest value at that time. With sources or walls it is that from a domain so large that nothing
returns, over the largest value of the run. Refused is what cannot be set up, and what a run refuses as it begins,
because it grows. Asked: below the target in 95 %, below three targets or refused before the run in all others. Set-ups
whose infinite lattice does not fit into memory are not judged. Of the misses, those that a note told before the run;
alarms are such notes where the target was kept.

Sources: the same with sources in place of data at the start, spread over a bell or at one node, anywhere and beside
sides. Walls: of those in the plane, one side or both across is free or holds the nodes beyond it, with sources in a
quarter of them. Space: of the second, those of waves of a scalar in space.

Thickness: of set-ups that keep their target, and whose layers are chosen and whose runs done within a time (`LONGEST`),
the nodes of all layers over those of the thinnest that keep it, too. Of layers of so many nodes those count that are
chosen when larger targets are asked for.

Run: ``python benchmarks/promise.py [first] [second] [default] [sources] [walls] [space] [thickness] [--json FILE]``:
200 set-ups each; ``--count N`` for fewer, ``--first N`` to begin with a later one, ``--longest S`` to leave out longer
runs, ``--seed N`` for another seed.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from common import run_parts, verdict
from scipy import fft

import farhorizon as fh
from farhorizon.analysis.references.infinite import InfiniteLattice
from farhorizon.simulation.steps import seconds_of

SEEDS = {"first": 41, "second": 42, "default": 43, "sources": 45, "walls": 46, "space": 47, "thickness": 44}
TARGETS = (1e-3, 1e-4, 1e-5, 1e-6)
MOMENTS = 60
LOOKS = 8  # between two of them, at how large the field is
SENT = {"sources": 1.0, "walls": 0.25}  # share of set-ups with sources, by part
LONGEST_REFERENCE = 120.0  # seconds that the domain may take from which nothing returns
LONGEST = 20.0  # seconds that the choice of layers and a run may take where their thickness is looked at
COUNTED = ("cases", "kept", "refused", "above 3", "told", "alarms")


def random_model(random: np.random.Generator, dim: int) -> Any:
    """A wave, elastic or diffusion model on unit spacing."""
    kind = random.choice(["wave", "wave", "wave", "elements", "elastic", "diffusion"])
    if kind == "elements":
        return fh.Wave(fh.Stencil.finite_element(dim))
    reach, influence = (
        float(random.integers(1, 7 if dim < 3 else 4)),
        str(random.choice(["constant", "linear", "gaussian"])),
    )
    influence = influence if reach > 1 else "constant"
    volume = str(random.choice(["ramp", "ramp", "full"]))
    exponent = int(random.integers(0, 4 if dim > 1 else 3))
    if kind == "elastic" and dim == 2:
        kernel = fh.Kernel(min(reach, 3.0), 1, influence if reach > 1 else "constant", volume=volume)
        material = str(random.choice(["bond-based", "state-based", "finite-element"]))
        if material == "finite-element":
            return fh.Elastic(None, young=1.0, poisson=0.3, material=material)
        return fh.Elastic(
            kernel, young=1.0, material=material, **({} if material == "bond-based" else {"poisson": 0.3})
        )
    kernel = fh.Kernel(reach, exponent, influence, volume=volume)
    return (
        fh.Diffusion(kernel) if kind == "diffusion" else fh.Wave(kernel, damping=float(random.choice([0.0, 0.0, 0.02])))
    )


def random_setup(random: np.random.Generator, part: str = "second") -> tuple[dict[str, Any], float, bool]:
    """A set-up, its end, and whether it is a guide that is periodic across."""
    dim = int(random.choice([1, 2, 2, 2, 3]))
    model = random_model(random, dim)
    stencil, reach = model.stencil(1.0, dim), max(model.stencil(1.0, dim).reach)
    guide = dim == 2 and stencil.components == 1 and random.random() < 0.2
    width = random.uniform(2.0, 8.0 if dim < 3 else 2.5) if model.order == 2 else 2.0
    least = int(np.ceil(2 * (3.9 * width + reach))) + 1
    shape = np.full(dim, max(least, 2 * reach + 3)) + (0 if dim == 3 else int(random.integers(0, 20)))
    if dim == 2:
        shape[1] *= random.choice([1, 2, 4])
    if guide:
        shape[0] = max(2 * reach + 1, 15)
    half = (shape - 1) / 2
    room = np.maximum(half - 3.9 * width - reach, 0)
    centre = random.uniform(-1, 1, dim) * room
    lattice = fh.Lattice(1.0, -half, half)
    u = np.exp(-sum((x - a) ** 2 for x, a in zip(lattice.coordinates(), centre, strict=True)) / width**2)
    u = u if stencil.components == 1 else np.stack([u, 0.5 * u])
    speed = float(np.sqrt(model.coefficient))
    crossings = float(np.exp(random.uniform(np.log(2), np.log(40 if dim < 3 else 5))))
    until = (
        crossings * max(shape) / speed if model.order == 2 else random.choice([1.0, 10.0, 50.0]) * (min(shape) / 2) ** 2
    )
    layer = fh.LatticePML(target=float(random.choice(TARGETS)), until=until)
    boundary = {"x": fh.Periodic(), "y": layer} if guide else {"all": layer}
    limit = fh.Simulation(lattice, model, fh.Fixed()).step_limit
    share = float(random.choice([0.3, 0.5, 0.8, 0.95]))
    setup = {"lattice": lattice, "model": model, "boundary": boundary, "dt": share * limit, "threads": 1}
    driven = random.random() < SENT.get(part, 0.0)
    if part == "walls" and dim == 2 and not guide:
        held = random.random() < 0.5 or getattr(model, "material", "") == "finite-element"  # which has no free sides
        wall = fh.Fixed() if held else fh.Free()
        setup["boundary"] = {"x": layer, "y-": wall, "y+": layer if random.random() < 0.7 else wall}
    return (
        setup | ({"sources": [random_source(random, setup, u, until)]} if driven else {"initial": {"u": u}}),
        until,
        guide,
    )


def random_source(random: np.random.Generator, setup: dict[str, Any], bell: np.ndarray, until: float) -> Any:
    """A source over a bell, or at a node, often beside a side; in diffusion it goes on and on."""
    lattice, model = setup["lattice"], setup["model"]
    length = min(random.uniform(6.0, 30.0), until * np.sqrt(model.coefficient) / 6)
    frequency = np.sqrt(model.coefficient) / length
    signal = random.choice(["ricker", "burst", "bell"])
    time_ = {
        "ricker": fh.Ricker(0.5 * frequency),
        "burst": fh.ToneBurst(frequency, int(random.integers(1, 4))),
        "bell": fh.Gaussian(0.5 / frequency),
    }[signal]
    at = [int(random.integers(0, n)) for n in lattice.shape]
    if random.random() < 0.5:
        at[-1] = int(random.integers(0, 4))
    values = bell
    if random.random() < 0.5:
        values = np.zeros_like(bell)
        values[(..., *at)] = 1.0
    return fh.Source(values, time=None if model.order == 1 else time_)


class Guide:
    """The infinite guide that is periodic across: as `InfiniteLattice`."""

    def __init__(self, sim: fh.Simulation, last: int, u: np.ndarray) -> None:
        self.sim, self.shape = sim, u.shape
        self.box = (
            u.shape[0],
            fft.next_fast_len(int(u.shape[1] + 1.4 * last * sim.dt * np.sqrt(sim.model.coefficient)) + 200, real=True),
        )
        self.symbol = sim.stencil.symbol(
            *np.ix_(2 * np.pi * np.fft.fftfreq(self.box[0]), 2 * np.pi * np.fft.rfftfreq(self.box[1]))
        )
        self.start = fft.rfft2(u, self.box)

    def after(self, steps: int) -> np.ndarray:
        scheme, symbol = self.sim.model.integrator, self.symbol * self.sim.model.coefficient
        if self.sim.model.order == 2:
            end = scheme.propagate(symbol, self.sim.dt, steps, self.start, np.zeros(1), self.sim.model.damping)
        else:
            end = scheme.growth(symbol, self.sim.dt) ** steps * self.start
        return fft.irfft2(end, self.box)[:, : self.shape[1]]


class Enlarged:
    """The same set-up in a domain so large that nothing returns: as `InfiniteLattice`.

    Raises
    ------
    InputError
        It takes too much memory or time.
    """

    def __init__(self, setup: dict[str, Any], until: float) -> None:
        far = {key: fh.Extended(target=1e-3 * layer.target, until=until) for key, layer in sides(setup).items()}
        self.sim = fh.Simulation(**with_sides(setup, far))
        spent = seconds_of(self.sim.engine) * until / self.sim.dt
        if spent > LONGEST_REFERENCE:
            raise fh.InputError("the enlarged domain takes too long", value=spent, limit=LONGEST_REFERENCE)

    def after(self, steps: int) -> np.ndarray:
        self.sim.step(steps - self.sim.step_count)
        return np.array(self.sim.fields["u"])


def error(sim: fh.Simulation, reference: Any, largest: float, until: float, enough: float = np.inf) -> float:
    """Largest error over the run, of waves over the largest value of it and of `largest`; ends early above `enough`."""
    last, worst, waves = int(until / sim.dt), 0.0, sim.model.order == 2
    moments = np.linspace(1, last, MOMENTS) if waves else np.geomspace(max(1, last / 3000), last, MOMENTS)
    for step in np.unique(moments.astype(int)):
        for piece in np.linspace(sim.step_count, step, LOOKS + 1)[1:].astype(int):  # short waves pass between moments
            sim.step(int(piece) - sim.step_count)
            largest = max(largest, float(np.abs(sim.fields["u"]).max()))
        exact = reference.after(int(step))
        off, here = float(np.abs(sim.fields["u"] - exact).max()), float(np.abs(exact).max())
        worst = max(worst, off if waves else off / here)
        if worst > enough * (largest if waves else 1.0):
            break
    return worst / largest if waves else worst


def sides(setup: dict[str, Any]) -> dict[str, fh.LatticePML]:
    """The layers of a set-up by their key."""
    return {key: side for key, side in setup["boundary"].items() if isinstance(side, fh.LatticePML)}


def unasked(setup: dict[str, Any]) -> dict[str, Any]:
    """The set-up with layers that are asked for nothing but to last for the run."""
    return with_sides(setup, {key: fh.LatticePML(until=layer.until) for key, layer in sides(setup).items()})


def with_sides(setup: dict[str, Any], others: dict[str, Any]) -> dict[str, Any]:
    """The set-up with some sides in place of its own."""
    return setup | {"boundary": setup["boundary"] | others}


def empty(kind: str) -> dict[str, Any]:
    """The row of a kind of set-ups before the first."""
    return {"set-up": kind, **dict.fromkeys(COUNTED, 0), "worst": 0.0, "nodes": []}


def drawn(seed: int, count: int, first: int, part: str) -> Iterator[tuple[int, dict[str, Any], float, bool]]:
    """Number, set-up, end and whether it is a guide, of so many random set-ups, as far as they belong to a part."""
    belongs = {"walls": walled, "space": in_space}.get(part, lambda setup: True)
    for number in range(first, count):
        try:
            setup, until, guide = random_setup(np.random.default_rng([seed, number]), part)
            if belongs(setup):
                yield number, setup, until, guide
        except fh.InputError as refusal:  # a kernel that makes no solid
            print(f"{number}: not judged, {refusal}", flush=True)


def walled(setup: dict[str, Any]) -> bool:
    """Whether a side is free or holds the nodes beyond it."""
    return any(isinstance(side, fh.Free | fh.Fixed) for side in setup["boundary"].values())


def in_space(setup: dict[str, Any]) -> bool:
    """Whether a scalar has waves in space."""
    model = setup["model"]
    return bool(setup["lattice"].dim == 3 and model.order == 2 and model.stencil(1.0, 3).components == 1)


def kind_of(setup: dict[str, Any], guide: bool) -> str:
    """What rows of a table are of."""
    where = "guide" if guide else "walls" if walled(setup) else f"{setup['lattice'].dim}D"
    return f"{where} {type(setup['model']).__name__.lower()}"


def measured(
    sim: fh.Simulation, setup: dict[str, Any], until: float, guide: bool, target: float, enough: float = np.inf
) -> float:
    """Error of a run in targets; ends early above `enough`.

    Raises
    ------
    InputError
        The infinite lattice does not fit into memory, or a domain from which nothing returns takes too long.
    """
    model, last = setup["model"], int(until / sim.dt)
    try:
        if "sources" in setup:
            return error(sim, Enlarged(setup, until), 0.0, until) / target
        u = setup["initial"]["u"]
        if walled(setup):
            return error(sim, Enlarged(setup, until), float(np.abs(u).max()), until, enough * target) / target
        reference = (
            Guide(sim, last, u)
            if guide
            else InfiniteLattice(
                sim.stencil, model.coefficient, model.integrator, sim.dt, last, u, damping=model.damping
            )
        )
        return error(sim, reference, float(np.abs(u).max()), until, enough * target) / target
    except fh.UnstableError:
        return np.inf


def columns(sim: fh.Simulation) -> list[int]:
    """Nodes of the layers."""
    return [layer.columns for layer in sim.engine.layers.values()]


def promise(options: argparse.Namespace, part: str) -> list[dict[str, Any]]:
    """How many keep their target, by kind of set-up."""
    seed = SEEDS[part] if options.seed is None else options.seed
    print(f"seed {seed}")
    rows: dict[str, dict[str, Any]] = {}
    for number, setup, until, guide in drawn(seed, options.count, options.first, part):
        setup = unasked(setup) if part == "default" else setup
        (target,) = {b.wanted(setup["model"].target) for b in sides(setup).values()}
        model, kind = setup["model"], kind_of(setup, guide)
        row = rows.setdefault(kind, empty(kind))
        row["cases"] += 1
        try:
            sim = fh.Simulation(**setup)
            if (spent := seconds_of(sim.engine) * until / sim.dt) > options.longest:
                row["cases"] -= 1
                print(f"{number}: {kind} {target:g}: left out, takes about {spent:.0f} s", flush=True)
                continue
            sim.examine(until)  # as a run begins
        except fh.InputError as refusal:
            row["refused"] += 1
            print(f"{number}: {kind} {target:g}: refused, {refusal}", flush=True)
            continue
        try:
            found = measured(sim, setup, until, guide, target)
        except fh.InputError as refusal:  # of the reference: nothing can be said
            row["cases"] -= 1
            print(f"{number}: {kind} {target:g}: not judged, {refusal}", flush=True)
            continue
        row["kept"] += found <= 1
        row["above 3"] += found > 3
        told = any("target" in note for note in sim.notes)
        row["told"] += told and found > 1
        row["alarms"] += told and found <= 1
        row["worst"] = max(row["worst"], found)
        row["nodes"].append(max(columns(sim)))
        if found > 1 or options.repeats == 1:
            print(
                f"{number}: {kind} {model.operator if hasattr(model, 'operator') else model} {setup['lattice'].shape} "
                f"{'with a source ' * ('sources' in setup)}until {until:.4g} "
                f"target {target:g}: {row['nodes'][-1]} nodes, error {found:.2g} targets{', told' * told}",
                flush=True,
            )
    total = empty("all")
    for row in rows.values():
        for key in (*COUNTED, "nodes"):
            total[key] = total[key] + row[key]
        total["worst"] = max(total["worst"], row["worst"])
    table = [*rows.values(), total]
    for row in table:
        row["nodes"] = float(np.median(row["nodes"])) if row["nodes"] else float("nan")
        share = (row["kept"] + row["refused"]) / row["cases"] if row["cases"] else None
        met = "-" if share is None else verdict(share, 0.95, True)
        row |= {"share": "-" if share is None else share, "aim": 0.95, "met": met}
    return table


def loosened(setup: dict[str, Any], factor: float) -> dict[str, Any]:
    """The set-up with layers that are asked for an error so many times as large."""
    return with_sides(setup, {key: replace(b, target=factor * b.target) for key, b in sides(setup).items()})


def thinnest(setup: dict[str, Any], until: float, guide: bool, target: float, found: float) -> tuple[list[int], float]:
    """The thinnest layers with which a run still keeps a target, of those that are chosen for larger ones, and what it
    leaves; by halving the logarithm of the factor.
    """
    most = int(np.log2(0.1 / target))  # no target is larger
    low, high, best = 0, most + 1, ([], found)
    known = {}
    while high - low > 1:
        middle = min((low + high) // 2, low + 4)
        sim = fh.Simulation(**loosened(setup, 2.0**middle))
        nodes = columns(sim)
        key = tuple(nodes)
        if key not in known:
            known[key] = measured(sim, setup, until, guide, target, 1.0)
        if known[key] <= 1:
            low, best = middle, (nodes, known[key])
        else:
            high = middle
    return best


def thickness(options: argparse.Namespace) -> list[dict[str, Any]]:
    """How thick the layers that keep their target are over the thinnest ones that do, of set-ups that run no longer
    than a time.
    """
    seed = SEEDS["thickness"] if options.seed is None else options.seed
    print(f"seed {seed}")
    ratios: dict[str, list[float]] = {}
    for number, setup, until, guide in drawn(seed, options.count, options.first, "thickness"):
        (target,) = {layer.target for layer in sides(setup).values()}
        kind, start = kind_of(setup, guide), time.perf_counter()
        try:
            sim = fh.Simulation(**setup)
            sim.examine(until)
            spent = time.perf_counter() - start + seconds_of(sim.engine) * until / sim.dt
            if spent > min(LONGEST, options.longest):
                print(f"{number}: {kind} {target:g}: left out, takes about {spent:.0f} s", flush=True)
                continue
            found = measured(sim, setup, until, guide, target)
        except fh.InputError:  # refused, or nothing can be said
            continue
        if found > 1:
            print(f"{number}: {kind} {target:g}: left out, error {found:.2g} targets", flush=True)
            continue
        chosen = columns(sim)
        least, left = thinnest(setup, until, guide, target, found)
        least = least or chosen
        ratios.setdefault(kind, []).append(sum(chosen) / sum(least))
        print(
            f"{number}: {kind} {setup['model']} {setup['lattice'].shape} until {until:.4g} target {target:g}: "
            f"{chosen} nodes, error {found:.2g} targets; {least} nodes, {left:.2g}",
            flush=True,
        )
    every = ratios | {"all": [ratio for values in ratios.values() for ratio in values]}
    return [
        {
            "set-up": kind,
            "cases": len(values),
            "median": float(np.median(values)),
            "at most 1.3": float(np.mean(np.array(values) <= 1.3)),
            "worst": max(values),
        }
        for kind, values in every.items()
        if values
    ]


if __name__ == "__main__":
    names = {
        "first": "random set-ups",
        "second": "random set-ups of a seed not looked at before",
        "default": "layers of which nothing is asked",
        "sources": "random sources",
        "walls": "random data and sources beside walls",
        "space": "random waves in space",
    }
    parts = {name: (title, partial(promise, part=name)) for name, title in names.items()}
    run_parts(__doc__, parts | {"thickness": ("nodes of layers over those of the thinnest that do", thickness)})

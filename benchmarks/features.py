"""What features add to a step: with each, relative to the same set-up without, in one run on one thread.

- attenuation: a quality factor of 50 over one and over two decades of frequency, scalar waves and solids, periodic
  boxes. Aim: 1.6.
- surface: bodies between free sides with ``surface = "energy"``; time and length of a step.
- impactor: a disc or ball that lies in a free face. What it adds depends on how few nodes it touches.

Run: ``python benchmarks/features.py [attenuation] [surface] [impactor] [--json FILE] [--repeats N]``. Takes two
minutes and 1 GB.
"""

from __future__ import annotations

import argparse
from typing import Any

from common import interleaved, median, ratio, run_parts, verdict

import farhorizon as fh

AIM = 1.6


def box(dim: int, nodes: int, model: fh.LatticeModel, side: fh.Side, **more: Any) -> fh.Simulation:
    """A cube of nodes with a pulse in the middle."""
    pulse = f"exp(-((x - {nodes / 2})**2)/20)"
    u = [pulse, *["0"] * (dim - 1)] if model.mechanical else pulse
    lattice = fh.Lattice(1.0, (0.0,) * dim, (nodes - 1.0,) * dim)
    return fh.Simulation(lattice, model, side, {"u": u}, threads=1, **more)


def compared(name: str, plain: fh.Simulation, other: fh.Simulation, repeats: int) -> dict[str, Any]:
    """A row of a table: times of steps of one simulation and another."""
    times = interleaved({"plain": plain.step, "with": other.step}, repeats)
    nodes = plain.lattice.nodes
    return {"case": name, "plain ns/node": 1e9 * median(times, "plain") / nodes, "ratio": ratio(times, "with", "plain")}


def attenuation(given: argparse.Namespace) -> list[dict[str, Any]]:
    """Steps with memories of relaxed forces."""
    rows = []
    for dim, nodes, reach in ((2, 200, 3.0), (2, 400, 3.0), (3, 40, 2.0)):
        for name, make in (
            ("scalar", lambda k, **more: fh.Wave(k, **more)),
            ("bond-based", lambda k, **more: fh.Elastic(k, 1.0, **more)),
            ("state-based", lambda k, **more: fh.Elastic(k, 1.0, 0.25, material="state-based", **more)),
        ):
            for decades in (1, 2):
                rock = fh.Attenuation(50.0, (0.02 / 10**decades, 0.02))
                kernel = fh.Kernel(reach)
                pair = (box(dim, nodes, make(kernel, **m), fh.Periodic()) for m in ({}, {"attenuation": rock}))
                row = compared(f"{name} {nodes}^{dim}, {decades} decades", *pair, given.repeats)
                rows.append(row | {"aim": AIM, "met": verdict(row["ratio"], AIM, larger=False)})
    return rows


def surface(given: argparse.Namespace) -> list[dict[str, Any]]:
    """Steps of bodies whose surfaces are corrected."""
    rows = []
    for dim, nodes in ((2, 150), (3, 30)):
        for material in ("bond-based", "state-based"):
            models = (
                fh.Elastic(
                    fh.Kernel(2.0, 1), 1.0, 0.25 if material == "state-based" else None, material=material, surface=name
                )
                for name in (None, "energy")
            )
            plain, corrected = (box(dim, nodes, model, fh.Free()) for model in models)
            row = compared(f"{material} {nodes}^{dim}", plain, corrected, given.repeats)
            rows.append(row | {"length of a step": corrected.dt / plain.dt})
    return rows


def impactor(given: argparse.Namespace) -> list[dict[str, Any]]:
    """Steps of a solid with a round shape in its upper face."""
    rows = []
    for dim, nodes in ((2, 200), (3, 40)):
        middle, top = (nodes - 1) / 2, nodes - 1 + 5.0
        shape = fh.Disc(5.0, (middle, top)) if dim == 2 else fh.Ball(5.0, (middle, middle, top))
        model = fh.Elastic(fh.Kernel(3.0 if dim == 2 else 2.0, 1), 1.0)
        push = fh.Impactor(shape, path=["0"] * (dim - 1) + ["-t/1000"])
        pair = (box(dim, nodes, model, fh.Free(), loads=loads) for loads in ([], [push]))
        rows.append(compared(f"bond-based {nodes}^{dim}", *pair, given.repeats))
    return rows


if __name__ == "__main__":
    run_parts(
        __doc__,
        {
            "attenuation": ("Steps with attenuation", attenuation),
            "surface": ("Steps of bodies with corrected surfaces", surface),
            "impactor": ("Steps with an impactor", impactor),
        },
    )

"""Permanent loads: how accurate are static and slow fields with layers?

A load is switched on within 40 h/c (h the spacing, c the largest speed) and stays; the near field is compared with that
of the extended domain, from whose end less than 1e-9 returns. Errors are the largest |u - u_extended| over the near
field, relative to the largest value at the same time.

- wave2d, wave3d, elastic2d, elastic3d: a force, for which u in 2D keeps growing like log t; waves with a kernel of
  reach 2, bond-based elasticity of reach 2; 25^2 and 13^3 nodes, up to t = 600, 80, 400 and 60 h/c.
- crack2d: two opposite forces hold a crack open, without a net force, up to t = 400 h/c. crack3d: the same for a square
  crack, up to t = 60.

- rest: a force on one node of the cubic lattice (finite differences, 9^3 nodes) until ``run("static", tolerance=1e-4)``
  ends, compared with the exact static field ``integral of exp(-6 t) I I I (2 t) dt``, which is 1 / 4 pi r far away: the
  error relative to the largest value, and the number of crossings of the near field.

Columns: "nodes" of the layers; "error", the largest from t = 60 h/c (3D: 30) up to the end T; "drift", the same without
its mean over the near field; "at 4 T" in 3D, where fields come to rest, the difference of the run at four times T from
the extended domain at T: a layer that was chosen for T need not meet its target there.

Run: ``python benchmarks/static.py [wave2d] [wave3d] [elastic2d] [elastic3d] [crack2d] [crack3d] [rest] [--json FILE]``.
Takes six minutes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from common import run_parts
from scipy import integrate, special

import farhorizon as fh

RISE = 40.0  # h/c
TARGETS = (None, 1e-3, 1e-4, 1e-5, 1e-6)


def ramp(t: float) -> float:
    """Load as a function of time."""
    return float(np.sin(np.pi / 2 * min(t / RISE, 1.0)) ** 2)


def force(lattice: fh.Lattice, centre: float, width: float = 3.0) -> np.ndarray:
    """A Gaussian force, off the middle along x."""
    x = lattice.coordinates()
    return np.asarray(np.exp(-((x[0] - centre) ** 2 + sum(y**2 for y in x[1:])) / width**2))


def setup(dim: int, elastic: bool, crack: bool) -> dict[str, Any]:
    """Set-up of a part; spacing and largest speed are 1."""
    half = 12.0 if dim == 2 else 6.0
    lattice = fh.Lattice(1.0, (-half,) * dim, (half,) * dim)
    width = 3.0 if dim == 2 else 1.8
    if not elastic:
        return {
            "lattice": lattice,
            "model": fh.Wave(fh.Kernel(2.0)),
            "sources": [fh.Source(force(lattice, 2.0, width), ramp)],
        }
    model = fh.Elastic(fh.Kernel(2.0, 1), 1.0, plane="strain" if dim == 2 else None)
    model = fh.Elastic(fh.Kernel(2.0, 1), 1.0 / model.p_modulus, plane="strain" if dim == 2 else None)
    vector = np.zeros((dim, *lattice.shape))
    if crack:  # on the plane x = 1/2, pulled apart
        vector[0] = force(lattice, 3.0, 1.5) - force(lattice, -2.0, 1.5)
        plane = (
            [(0.5, -4.3), (0.5, 4.3)] if dim == 2 else fh.Rectangle((0.5, -3.3, -3.3), (0.0, 6.6, 0.0), (0.0, 0.0, 6.6))
        )
        return {"lattice": lattice, "model": model, "sources": [fh.Source(list(vector), ramp)], "cracks": [plane]}
    vector[0] = force(lattice, 2.0, width)
    return {"lattice": lattice, "model": model, "sources": [fh.Source(list(vector), ramp)]}


def rows(dim: int, elastic: bool, crack: bool, until: float) -> list[dict[str, Any]]:
    """One row per target."""
    given = setup(dim, elastic, crack)
    first = 60.0 if dim == 2 else 30.0
    far = fh.Simulation(**given, boundary=fh.Extended(1e-9, until=until))
    steps = sorted({round(t / far.dt) for t in np.linspace(first, until, 10)})
    fields = []
    for step in steps:
        far.step(step - far.step_count)
        fields.append(far.fields["u"])
    found = []
    for target in TARGETS if dim == 2 else TARGETS[1:4:2]:
        ours = fh.Simulation(**given, boundary=fh.LatticePML(target=target, until=until))
        worst = drift = 0.0
        for step, exact in zip(steps, fields, strict=True):
            ours.step(step - ours.step_count)
            error = ours.fields["u"] - exact
            space = tuple(range(error.ndim - dim, error.ndim))
            worst = max(worst, float(np.abs(error).max() / np.abs(exact).max()))
            drift = max(drift, float(np.abs(error - error.mean(space, keepdims=True)).max() / np.abs(exact).max()))
        row = {
            "target": "default" if target is None else f"{target:g}",
            "nodes": max(layer.columns for layer in ours.engine.layers.values()),
            "error": worst,
            "drift": drift,
        }
        if dim == 3:
            ours.step(3 * steps[-1])
            row["at 4 T"] = float(np.abs(ours.fields["u"] - fields[-1]).max() / np.abs(fields[-1]).max())
        found.append(row)
    return found


def lattice_potential(n: tuple[int, int, int]) -> float:
    """Static field of a unit force on the infinite cubic lattice, at the offset n in nodes."""

    def integrand(s: float) -> float:
        t = s / (1 - s)
        return float(np.prod([special.ive(m, 2 * t) for m in n])) / (1 - s) ** 2

    return float(integrate.quad(integrand, 0.0, 1.0, epsabs=1e-12, epsrel=1e-10, limit=400)[0])


def rest_rows(_: Any) -> list[dict[str, Any]]:
    """One row per target."""
    cube = fh.Lattice(1.0, (-4.0,) * 3, (4.0,) * 3)
    load = np.zeros(cube.shape)
    load[4, 4, 4] = 1.0
    exact = {n: lattice_potential(n) for n in ((0, 0, 0), (1, 0, 0), (2, 2, 0), (4, 0, 0), (3, 2, 1), (4, 4, 4))}
    found = []
    for target in (1e-3, 1e-4, 1e-5, 1e-6):
        model = fh.Wave(fh.Stencil.finite_difference(3))
        sim = fh.Simulation(cube, model, fh.LatticePML(target=target), sources=[fh.Source(load, fh.Step(RISE))])
        u = sim.run("static", tolerance=1e-4, progress=False).fields["u"]
        error = max(abs(u[tuple(4 + i for i in n)] - value) for n, value in exact.items())
        found.append(
            {
                "target": f"{target:g}",
                "nodes": max(layer.columns for layer in sim.engine.layers.values()),
                "error": error / exact[0, 0, 0],
                "crossings": sim.time / sim.crossing,
            }
        )
    return found


def part(dim: int, elastic: bool, crack: bool, until: float) -> tuple[str, Callable[[Any], list[dict[str, Any]]]]:
    """Title and function of a part of the command line."""
    what = (
        "a crack held open" if crack else "a force that stays"
    ) + f", {'elasticity' if elastic else 'waves'} in {dim}D, T = {until:g} h/c"
    return what, lambda _: rows(dim, elastic, crack, until)


if __name__ == "__main__":
    run_parts(
        __doc__,
        {
            "wave2d": part(2, False, False, 600.0),
            "wave3d": part(3, False, False, 80.0),
            "elastic2d": part(2, True, False, 400.0),
            "elastic3d": part(3, True, False, 60.0),
            "crack2d": part(2, True, True, 400.0),
            "crack3d": part(3, True, True, 60.0),
            "rest": ("a force until all is at rest, beside the exact static field, waves in 3D", rest_rows),
        },
    )

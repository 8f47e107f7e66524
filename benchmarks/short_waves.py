"""Are layers stable for every kernel, and how does the damping of short waves affect accuracy?

For each stencil with backward waves: the damping that is chosen, the fastest growing mode between two sides over
tangential wavenumbers (all eigenvalues; negative means decay), and the error against the infinite lattice of a Gaussian
pulse whose spectrum has fallen to 1.5e-5 at 8 nodes per wave or at 60 % of the first backward wavenumber, over four
crossings, with all sides and corners, relative to its maximum. Goals: decay, 1e-6 with 16 nodes or 4 horizons, 1e-8
with 30 nodes.
"""

from __future__ import annotations

import argparse
import itertools
from typing import Any

import numpy as np
from common import run_parts

import farhorizon as fh
from farhorizon.analysis.exact.chain import Recursion
from farhorizon.analysis.layers.chain_modes import LatticeMedium
from farhorizon.analysis.layers.families import tuned_layer
from farhorizon.analysis.layers.profiles import largest_gain
from farhorizon.analysis.layers.reflection import layer_amplitudes
from farhorizon.analysis.layers.short_waves import high_pass
from farhorizon.analysis.references.infinite_lattice import InfiniteLattice
from farhorizon.checks.reduced_setups import Strip

ALONG = [0.005, 0.02, 0.1, 0.3, 0.6, 1.0, 1.4, 1.8, 2.0, 2.4, np.pi]  # tangential wavenumbers times spacing
CROSSINGS = 4


def growth(model: Any, dim: int, nodes: int, spatial: int = 4) -> float:
    """Largest growth rate of a mode between two sides, in units of speed / spacing."""
    reach = max(model.stencil(1.0, dim).reach)
    width = float(max(12, 2 * reach))
    strip = Strip(
        fh.Simulation(fh.Lattice(1.0, (0.0,) * dim, (width,) * dim), model, fh.LatticePML(nodes=nodes), threads=1),
        0,
        max(8, 2 * reach + 1),
    )
    line = ALONG if dim == 2 else ALONG[:: len(ALONG) // spatial]
    found = [strip.growth(*angles).rate for angles in itertools.combinations_with_replacement(line, dim - 1)]
    return float(max(found) / np.sqrt(model.coefficient))


def error(model: Any, dim: int, nodes: int) -> float:
    """Largest error of the pulse, relative to its initial maximum."""
    stencil = model.stencil(1.0, dim)
    width = 4.71 / min(np.pi / 4, 0.6 * high_pass(stencil).first)
    half = float(np.ceil(7.5 * width)) if dim < 3 else float(np.ceil(4.5 * width))
    lattice = fh.Lattice(1.0, (-half,) * dim, (half,) * dim)
    pulse = np.exp(-sum(x**2 for x in lattice.coordinates()) / (2 * width**2))
    start = pulse if stencil.components == 1 else np.stack([pulse, *[0.5 * pulse] * (dim - 1)])
    sim = fh.Simulation(
        lattice, model, fh.LatticePML(nodes=nodes, target=0.1 if dim == 3 else None), initial={"u": start}
    )
    last = int(CROSSINGS * half / np.sqrt(model.coefficient) / sim.dt)
    infinite = InfiniteLattice(stencil, model.coefficient, sim.model.integrator, sim.dt, last, start)
    worst = 0.0
    for share in (0.25, 0.33, 0.4, 0.45, 0.5, 0.6, 0.8, 1.0):
        sim.step(int(share * last) - sim.step_count)
        worst = max(worst, float(np.abs(sim.fields["u"] - infinite.after(sim.step_count)).max()))
    return worst


def measure(cases: list[tuple[str, int, Any]]) -> list[dict[str, Any]]:
    """One row per stencil with backward waves; prints the names of those without."""
    rows, without = [], []
    for name, dim, model in cases:
        stencil = model.stencil(1.0, dim)
        damped = high_pass(stencil)
        if damped is None:
            without.append(name)
            continue
        reach = max(stencil.reach)
        thin = max(16, 4 * reach if reach > 3 else 0)
        row: dict[str, Any] = {
            "stencil": f"{dim}D {name}",
            "first stopped": damped.first,
            "filter": f"I({damped.rise},{damped.fall})",
            "rate/sigma": damped.strength,
            "nodes": thin,
        }
        row |= {"growth": growth(model, dim, thin), "error": error(model, dim, thin), "limit": 1e-6}
        if dim < 3:
            row |= {"growth, 30": growth(model, dim, 30), "error, 30": error(model, dim, 30), "limit, 30": 1e-8}
        row["met"] = (
            "yes"
            if row["growth"] <= 0
            and row["error"] <= 1e-6
            and row.get("error, 30", 0) <= 1e-8
            and row.get("growth, 30", 0) <= 0
            else "MISSED"
        )
        rows.append(row)
        print(
            "  ".join(f"{key} {value:.3g}" if isinstance(value, float) else f"{value}" for key, value in row.items()),
            flush=True,
        )
    print("\nno backward waves: " + (", ".join(without) or "none"))
    return rows


def scalar(
    dim: int, reaches: list[int], exponents: tuple[int, ...], influences: tuple[str, ...]
) -> list[tuple[str, int, Any]]:
    """Wave models for a table of kernels."""
    return [
        (f"m={m} p={p} {i}", dim, fh.Wave(fh.Kernel(float(m), p, i)))
        for p in exponents
        for m in reaches
        for i in influences
        if m > 1 or i == "constant"
    ]


def certified(given: argparse.Namespace) -> list[dict[str, Any]]:
    """Wide kernels in 1D with layers of 4 horizons: the certificate, and the reflection of waves of three horizons and
    more.
    """
    rows = []
    for name, _, model in scalar(1, list(range(4, 13)), (0, 1, 2), ALL):
        nodes = 4 * max(model.stencil(1.0, 1).reach)
        sim = fh.Simulation(fh.Lattice(1.0, (0.0,), (1.5 * nodes,)), model, fh.LatticePML(nodes=nodes), threads=1)
        found, strip = sim.certificate(60.0), Strip(sim, 0, nodes // 2 + 1)
        back = max(abs(strip.reflection(share * nodes, 0.0)) for share in (0.75, 1.5, 3.0))
        layer = next(iter(sim.engine.layers.values()))
        gain = largest_gain(sim.stencil, layer.kappa, layer.sigma, layer.alpha)
        rows.append(
            {
                "stencil": f"1D {name}",
                "nodes": nodes,
                "verdict": found.verdict,
                "rate": found.rate,
                "sent back": back,
                "gain": gain,
            }
        )
    return rows


def returned(given: argparse.Namespace) -> list[dict[str, Any]]:
    """Layers of 4 horizons for wide kernels: exact reflection of plane waves along the normal."""
    rows = []
    for dim, exponent, reaches in ((1, 1, range(7, 13)), (2, 1, range(7, 13)), (1, 0, (6, 8, 10, 11))):
        for reach in reaches:
            model, nodes = fh.Wave(fh.Kernel(float(reach), exponent)), 4 * reach
            sim = fh.Simulation(
                fh.Lattice(1.0, (0.0,) * dim, (2.0 * reach,) * dim), model, fh.LatticePML(nodes=nodes), threads=1
            )
            layer, first = next(iter(sim.engine.layers.values())), high_pass(sim.stencil).first
            medium = LatticeMedium(sim.stencil, 1.0, 1.0, Recursion.of(model.integrator, sim.dt, 0.0), sim.dt)
            waves = [medium.plane_wave(2 * np.pi / (share * first), 0.0) for share in (0.06, 0.18, 0.36)]
            amplitudes = [float(np.abs(layer_amplitudes(wave, layer)[wave.modes.travels]).max()) for wave in waves]
            rows.append(
                {"stencil": f"{dim}D m={reach} p={exponent}", "nodes": nodes}
                | dict(zip(("6 %", "18 %", "36 %"), amplitudes, strict=True))
            )
    return rows


ALL = ("constant", "linear", "gaussian")


def line(given: argparse.Namespace) -> list[dict[str, Any]]:
    """Waves in 1D."""
    return measure(scalar(1, [1, 2, 3], (0,), ALL) + scalar(1, [2, 4, 6, 8, 12], (1, 2), ALL))


def plane(given: argparse.Namespace) -> list[dict[str, Any]]:
    """Waves in 2D, reach up to 7."""
    cases = scalar(2, [1, 2, 3], (0,), ALL) + scalar(2, [1, 2, 3, 4, 5, 6, 7], (1, 2), ALL)
    return measure([*cases, ("bilinear elements", 2, fh.Wave(fh.Stencil.finite_element(2)))])


def wide(given: argparse.Namespace) -> list[dict[str, Any]]:
    """Waves in 2D, reach 8 and 12."""
    return measure(scalar(2, [8, 12], (1, 2), ("constant", "linear")))


def space(given: argparse.Namespace) -> list[dict[str, Any]]:
    """Waves in 3D."""
    return measure(
        [
            *scalar(3, [1, 2, 3], (0, 1, 2), ("constant",)),
            ("trilinear elements", 3, fh.Wave(fh.Stencil.finite_element(3))),
        ]
    )


def elastic(given: argparse.Namespace) -> list[dict[str, Any]]:
    """Elastic waves in 2D."""
    kernels = [(m, i) for m in (2, 3) for i in ("constant", "linear")]
    cases: list[tuple[str, int, Any]] = [
        (f"bond-based m={m} {i}", 2, fh.Elastic(fh.Kernel(float(m), 1, i), young=1.0)) for m, i in kernels
    ]
    cases.append(("state-based m=2", 2, fh.Elastic(fh.Kernel(2.0, 1), young=1.0, poisson=0.3, material="state-based")))
    return measure([*cases, ("elements", 2, fh.Elastic(young=1.0, poisson=0.3, material="finite-element"))])


def uniform_growth(stencil: fh.Stencil, sigma: float, axes: int, count: int = 9) -> float:
    """Largest growth rate, in units of speed / spacing, of waves with real wavenumbers in a uniform 3D region that is
    stretched by ``1 + sigma/(i w)`` along some axes: the roots of ``w^2 = symbol`` are followed from sigma = 0.
    """
    line = np.pi * (np.arange(count) + 0.5) / count
    tangents = np.tan(np.stack([one.ravel() for one in np.meshgrid(line, line, line, indexing="ij")]) / 2)
    half = [tuple(o) > (0, 0, 0) for o in stencil.offsets.tolist()]

    def residual(w: np.ndarray, share: float) -> np.ndarray:
        stretch = np.ones((3, 1), complex) + np.zeros_like(w)
        stretch[:axes] += share * sigma / (1j * w)
        angles = 2 * np.arctan(tangents / stretch)
        phases = np.exp(1j * np.array([o @ angles for o in stencil.offsets[half]]))
        return w**2 - stencil.weights[half] @ (2 - phases - 1 / phases)

    w = np.sqrt(-residual(np.full(tangents.shape[1], 1e-9 + 0j), 0.0))
    with np.errstate(all="ignore"):
        for share in np.linspace(0, 1, 7)[1:]:
            for _ in range(6):
                change = 2e-6 * residual(w, share) / (residual(w + 1e-6, share) - residual(w - 1e-6, share))
                w = w - change * np.minimum(1.0, 0.3 / np.abs(change))
        settled = np.abs(residual(w, 1.0)) < 1e-8
    return float(np.max(-w.imag[settled]))


def corners(given: argparse.Namespace) -> list[dict[str, Any]]:
    """Growth where layers meet in 3D."""
    return [
        {"stretched axes": axes, "reach": reach}
        | {
            f"sigma {sigma:g}": uniform_growth(kernel_stencil(reach), sigma, axes)
            for sigma in (0.25, 0.5, 1.0, 2.0, 4.0)
        }
        for reach in (2, 3, 4)
        for axes in (1, 2, 3)
    ]


def kernel_stencil(reach: int) -> fh.Stencil:
    """Stencil in 3D of exponent 2 with constant influence."""
    return fh.Wave(fh.Kernel(float(reach))).stencil(1.0, 3)


def pulse_error(model: Any, layer: Any, wave: int) -> float:
    """Largest error in 2D of a pulse, nearer to two of the sides, whose spectrum has its peak at `wave` nodes per wave,
    over four crossings of P waves, relative to its initial maximum."""
    half, pace = 2.0 * wave, float(np.sqrt(model.coefficient))
    lattice = fh.Lattice(1.0, (-half, -half), (half, half))
    x, y = lattice.coordinates()
    pulse = np.exp(-((x - 0.3 * half) ** 2 + (y + 0.2 * half) ** 2) * (np.pi / wave) ** 2)
    start = {"u": np.stack([pulse, 0.5 * pulse])}
    sim = fh.Simulation(lattice, model, fh.LatticePML(nodes=layer.columns, profile=layer), start, threads=1)
    last = int(CROSSINGS * 2 * half / pace / sim.dt)
    infinite = InfiniteLattice(sim.stencil, model.coefficient, model.integrator, sim.dt, last, start["u"])
    worst = 0.0
    for step in np.linspace(0, last, 13).astype(int)[1:].tolist():
        sim.step(step - sim.step_count)
        worst = max(worst, float(np.abs(sim.fields["u"] - infinite.after(step)).max()))
    return worst


def dampers(given: argparse.Namespace) -> list[dict[str, Any]]:
    """Errors in 2D solids with strong backward waves, damped by dampers or a filter."""
    solids = {
        "elements": fh.Elastic(young=1.0, poisson=0.3, material="finite-element"),
        "linear m=2": fh.Elastic(fh.Kernel(2.0, 1, "linear"), young=1.0),
        "p=1 m=2": fh.Elastic(fh.Kernel(2.0, 1), young=1.0),
        "p=0 m=2": fh.Elastic(fh.Kernel(2.0, 0), young=1.0),
        "states m=2": fh.Elastic(fh.Kernel(2.0, 1), young=1.0, poisson=0.3, material="state-based"),
        "p=1 m=3": fh.Elastic(fh.Kernel(3.0, 1), young=1.0),
    }
    rows = []
    for (name, model), nodes in itertools.product(solids.items(), (3, 4, 6, 8)):
        stencil, pace = model.stencil(1.0, 2), float(np.sqrt(model.coefficient))
        limit = fh.Simulation(fh.Lattice(1.0, (0.0, 0.0), (9.0, 9.0)), model, fh.Fixed()).step_limit
        steep = fh.LatticePML(nodes=nodes).make_layer(2, stencil, model.coefficient, 1.0, 0.0)
        kinds = {"dampers": tuned_layer(nodes, stencil, pace, 0.5 * limit), "filter": steep}
        rows.append(
            {"solid": name, "nodes": nodes}
            | {
                f"{kind}, {wave}": np.nan if layer is None else pulse_error(model, layer, wave)
                for wave in (8, 16)
                for kind, layer in kinds.items()
            }
        )
    return rows


PARTS = {
    "dampers": ("errors of pulses of 8 and 16 nodes a wave beside thin layers of solids in 2D", dampers),
    "line": ("waves in 1D", line),
    "plane": ("waves in 2D", plane),
    "wide": ("waves in 2D, wide kernels", wide),
    "space": ("waves in 3D", space),
    "corners": ("largest rate of growth in a region stretched alike along some axes in 3D", corners),
    "elastic": ("elastic waves in 2D", elastic),
    "certified": ("wide kernels in 1D", certified),
    "returned": ("reflection by layers of wide kernels, by wavenumber over the first backward one", returned),
}

if __name__ == "__main__":
    run_parts(__doc__, PARTS)

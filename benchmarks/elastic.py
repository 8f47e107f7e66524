"""Speed, memory and accuracy of elastic steps: matrix stencils and breaking bonds against the multiply-adds of the
machine, layers against the infinite lattice.

- speed: near fields on one thread in double precision. Useful multiply-adds are those of the plain stencil, one for
  each nonzero entry of the matrix of a bond (the centre and the time update are not counted). The compiled rows need
  fewer, since they combine mirror images first, so that more than 100 % is possible. The peak is measured in the same
  run: independent multiply-adds on whole vectors in registers. Targets: 40 % of the peak; in 3D with m = 3 ten times
  the rates of particle codes, which reach 1e6 nodes/s (linear bond-based) and 0.36e6 nodes/s (ordinary state-based);
  150 bytes per node.
- breaking: the same near fields with nonlinear bonds that may break, compared with a step of the linear stencil in the
  same run: intact; with straight cracks through the body that cut 1 and 5 % of all bonds; and with every tile processed
  bond by bond, as if damage were scattered everywhere. The same with softening bonds, by the built-in law and by a
  function, at most twice as long, also with every elongated bond beyond its limit. The fraction of the peak counts
  the arithmetic instructions of the law, 5 dim + 7 per bond, including a root and a division, each as one multiply-
  add. Target: 5e6 nodes/s in 3D with m = 3, five times the rate of particle codes.
- passes: state-based and correspondence materials as two passes, relative to the single stencil that is their
  convolution, both in periodic boxes on one thread; the rate with bonds that may break, on one thread; and with free
  faces on all sides, and with a hole, relative to the periodic box, on two threads. Targets in 3D with m = 3: 1.5 times
  the rate of the convolution (state-based), twice the rate (stabilised correspondence); 3e6 nodes/s with bonds that may
  break (state-based); free faces and holes add 10 %; 200 bytes per node.
- closing: state-based and correspondence materials with a crack from side to side whose faces may close, relative to
  one without contact, with permanent bonds and with bonds that may break; and the ratio of the step limits without and
  with contact.
- strained: a correspondence body with free faces whose bonds may break by their energy, uniformly stretched to 0.05 and
  0.5 of the critical stretch, relative to one with permanent bonds.
- layers: largest error of the near field against the infinite lattice, relative to the largest initial value, over four
  crossings of the P wave; pulses of all components that reach sides and corners. Targets in 3D: 1e-5 with 10 nodes,
  1e-7 with 20.
- heated: a step of a solid and its temperature with the heat of deformation, relative to one without; and with layers
  that both fields share, relative to separate layers.
- warm: largest error of displacements and temperature against a domain so large that nothing returns from its ends,
  relative to the largest value so far, for heat that reaches the sides and for coupled waves that leave, with shared
  and with separate layers. Target with shared layers: that of the model, 1e-4.

Run: ``python benchmarks/elastic.py [speed] [breaking] [passes] [closing] [strained] [heated] [layers] [warm]
[--json FILE] [--repeats N]``. Takes seven minutes and 2 GB.
"""

from __future__ import annotations

import argparse
import warnings
from typing import Any

import numpy as np
from common import bare_engine, interleaved, median, ratio, run_parts, steps, verdict
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from farhorizon import (
    Ball,
    BilinearSoftening,
    Box,
    Disc,
    Elastic,
    Free,
    Heat,
    Kernel,
    Lattice,
    LatticePML,
    Periodic,
    Polyline,
    Rectangle,
    Simulation,
    Thermoelastic,
    ViscoelasticBond,
)
from farhorizon.analysis.references.infinite_lattice import InfiniteLattice
from farhorizon.engine.bonds import DAMAGED
from farhorizon.engine.codegen.numba_internals import cgutils
from farhorizon.engine.codegen.vectors import I64, Vectors
from farhorizon.engine.engine import Engine, Zone, available_threads

CHAINS = 16  # independent sums: more than the latency of a multiply-add in cycles times those issued per cycle
PEAK_STEP = 100_000  # rounds of all chains per timed step
#: Last node along each axis, number of axes with layers (the others are periodic), and end of the run.
WARM = {
    "along an axis": ((24.0, 4.0), 1, 200.0),
    "in the plane": ((24.0, 24.0), 2, 60.0),
    "in space": ((24.0, 24.0, 3.0), 2, 40.0),
}

SPEED = {
    "2D bond-based": (2, 1000, 3, "full", "bond-based"),
    "2D state-based": (2, 1000, 3, "full", "state-based"),
    "2D correspondence": (2, 1000, 3, "full", "correspondence"),
    "3D bond-based": (3, 100, 3, "full", "bond-based"),
    "3D bond-based, ramp": (3, 100, 3, "ramp", "bond-based"),
    "3D state-based, m = 2": (3, 80, 2, "full", "state-based"),
    "3D state-based": (3, 80, 3, "full", "state-based"),
}
PASSES = {
    "2D state-based": (2, 600, {"material": "state-based"}),
    "2D correspondence": (2, 600, {"material": "correspondence", "stabilisation": 0.5}),
    "3D state-based": (3, 64, {"material": "state-based"}),
    "3D correspondence": (3, 64, {"material": "correspondence", "stabilisation": 0.5}),
}
LAYERS = {
    "2D bond-based, m = 2": (2, Kernel(2.0, 1), {}, (12, 20)),
    "2D bond-based, m = 3": (2, Kernel(3.0, 1), {}, (12, 20)),
    "2D state-based, m = 2": (2, Kernel(2.0, 1), {"poisson": 0.3, "material": "state-based"}, (12, 20)),
    "2D bilinear elements": (2, None, {"poisson": 0.3, "material": "finite-element"}, (12, 20)),
    "2D correspondence, gaussian": (
        2,
        Kernel(3.0, 0, "gaussian", volume="full"),
        {"poisson": 0.3, "material": "correspondence", "stabilisation": 0.5},
        (12, 20),
    ),
    "3D bond-based, m = 2": (3, Kernel(2.0, 1), {}, (10, 20)),
    "3D correspondence, m = 1.5": (
        3,
        Kernel(1.5, 2),
        {"poisson": 0.3, "material": "correspondence", "stabilisation": 0.5},
        (10, 20),
    ),
}


@intrinsic
def _multiply_adds(typingctx, rounds, like):  # type: ignore[no-untyped-def]
    """`rounds` multiply-adds in each of `CHAINS` independent vectors; returns their sum, so that none is optimised
    away."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
        vectors = Vectors.of(builder, "float64")
        factor = vectors.splat(args[1])
        slots = [
            cgutils.alloca_once_value(builder, vectors.splat(builder.fadd(args[1], ir.Constant(ir.DoubleType(), i))))
            for i in range(CHAINS)
        ]
        with cgutils.for_range_slice(builder, I64(0), args[0], I64(1), I64):
            for slot in slots:
                builder.store(vectors.multiply_add(factor, factor, builder.load(slot)), slot)
        total = vectors.sum([builder.load(slot) for slot in slots])
        return builder.extract_element(total, ir.IntType(32)(0))

    return types.float64(types.int64, types.float64), codegen


@njit
def _peak(rounds, like):  # type: ignore[no-untyped-def]
    return _multiply_adds(rounds, like)


def peak_case(count: int) -> None:
    """Independent multiply-adds as a timing case."""
    _peak(PEAK_STEP * count, 0.5)


def speed(given: argparse.Namespace) -> list[dict[str, Any]]:
    """One row per material."""
    rows = []
    for name, (dim, n, m, volume, material) in SPEED.items():
        model = Elastic(
            Kernel(float(m), 1, volume=volume), 1.0, None if material == "bond-based" else 0.3, material=material
        )
        stencil = model.stencil(1.0, dim)
        engine = bare_engine(stencil, (n,) * dim, 1)
        times = interleaved({"step": steps(engine), "peak": peak_case}, given.repeats)
        useful = int(np.count_nonzero(stencil.weights))
        share = ratio(times, "peak", "step") * useful * n**dim / (PEAK_STEP * CHAINS * 8)
        rate = n**dim / median(times, "step")
        wanted = {"3D bond-based": 1e7, "3D state-based": 3.6e6}.get(name, 0.0)
        rows.append(
            {
                "case": f"{name}, {n}^{dim}",
                "neighbours": len(stencil.weights),
                "multiply-adds": useful,
                "Mnodes/s": rate / 1e6,
                "of peak": share,
                "bytes/node": engine.nbytes / n**dim,
                "share met": verdict(share, 0.4, True),
                "rate met": verdict(rate, wanted, True) if wanted else "",
                "memory met": verdict(engine.nbytes / n**dim, 150, False),
            }
        )
    return rows


def cut_planes(engine: Engine, share: float) -> None:
    """Cut at least this fraction of all bonds by evenly spaced planes normal to the second last axis."""
    nodes, offsets = engine.core.node_indices(), engine.offsets
    count = nodes.shape[1]
    planes = np.arange(count) * np.ceil(share * count * len(offsets) / np.abs(offsets[:, 1]).sum()) / count
    # number of the slice between two cracks that contains each node
    here = np.broadcast_to(np.floor(planes)[None, :, None], nodes.shape)
    found = []
    for offset in offsets:
        inside = np.arange(count) + offset[1]
        there = np.floor(planes)[np.clip(inside, 0, count - 1)]
        at = nodes[here != there[None, :, None]]
        found.append((at, at + int(offset @ np.array(engine.core.stride))))
    pairs = [np.concatenate(part) for part in zip(*found, strict=True)]
    engine.absent.set(*pairs, np.zeros((len(pairs[0]), engine.components, engine.components)))


def breaking(given: argparse.Namespace) -> list[dict[str, Any]]:
    """One row per state of the bonds."""
    rows = []
    for dim, n in ((2, 1000), (3, 100)):
        model = Elastic(Kernel(3.0, 1, volume="full"), 1.0, nonlinear=True, critical_stretch=0.1)
        stencil = model.stencil(1.0, dim)
        stiffness = model.bond_stiffness(stencil, 1.0)
        zone = Zone((0,) * 3, (1,) * (3 - dim) + (n,) * dim)
        engines = {"linear stencil": bare_engine(stencil, (n,) * dim, 1)}
        laws = {
            "linear, calm": (False, 0.0),
            "linear, not calm": (False, 0.0),
            "whole": (True, 0.0),
            "1 % cut": (True, 0.01),
            "5 % cut": (True, 0.05),
            "all damaged": (True, 0.0),
            "contact, whole": (True, 0.0),
            "contact, 5 % cut": (True, 0.05),
            "softening, whole": (True, 0.0),
            "softening, all damaged": (True, 0.0),
            "softening, all beyond": (True, 0.0),
            "a function, all damaged": (True, 0.0),
            "a function, all beyond": (True, 0.0),
            "viscoelastic": (True, 0.0),
        }
        for name, (nonlinear, share) in laws.items():
            engines[name] = engine = bare_engine(stencil, (n,) * dim, 1, lasting=True)
            engine.levels *= 1e-4  # of the spacing: far from breaking
            limit, more = 0.2, {}
            if name.startswith("softening"):
                more = {"softening": "linear", "final": np.full(engine.core.nodes, 1.0)}
            if name.startswith("contact"):
                more = {"contact": True}
            if name.endswith("all beyond"):
                limit = 1e-12  # exceeded by nearly every elongated bond
            law: Any = None
            if name.startswith("a function"):  # the same as softening
                law = BilinearSoftening(limit / (1 + np.sqrt(1 + limit)), 1.0)
            if name == "viscoelastic":
                law, limit = ViscoelasticBond(0.4, 50.0), -np.inf
            if law is not None:
                more = {"functions": law.functions, "numbers": law.numbers(engine.dt)}
            engine.bonds.set(stiffness, 1.0, zone, nonlinear, limit, **more)
            if name == "linear, not calm":
                engine.tables.bonds.limit[1] = 0
            if share:
                cut_planes(engine, share)
            if name.endswith("all damaged"):
                engine.bonds.state["kinds"][...] = DAMAGED
        times = interleaved(
            {name: steps(engine) for name, engine in engines.items()} | {"peak": peak_case}, given.repeats
        )
        for name, engine in engines.items():
            own = engine.bonds
            work = np.count_nonzero(stencil.weights)
            if own:
                work = len(stencil.weights) * (5 * dim + 7 if engine.bonds.nonlinear else 3 * dim + 4)
            rate = n**dim / median(times, name)
            wanted = dim == 3 and own
            whole = len(stencil.weights) * n**dim
            rows.append(
                {
                    "case": f"{dim}D {n}^{dim}, {name}",
                    "neighbours": len(stencil.weights),
                    "Mnodes/s": rate / 1e6,
                    "over linear": ratio(times, name, "linear stencil"),
                    "over softening": ratio(times, name, name.replace("a function", "softening"))
                    if name.startswith("a function")
                    else ratio(times, name, "softening, all beyond") * (name == "viscoelastic"),
                    "of peak": ratio(times, "peak", name) * work * n**dim / (PEAK_STEP * CHAINS * 8),
                    "cut": 1 - float(engine.bonds.left.sum()) / whole if own else 0.0,
                    "damaged tiles": float(engine.bonds.state["kinds"].mean()) if own else 0.0,
                    "bytes/node": engine.nbytes / n**dim,
                    "met": verdict(rate, 5e6, True) if wanted else "",
                }
            )
    return rows


def layers(given: argparse.Namespace) -> list[dict[str, Any]]:
    """One row per material and thickness."""
    rows = []
    for name, (dim, kernel, options, thicknesses) in LAYERS.items():
        half, width = (14.0, 3.0) if dim == 2 else (9.0, 1.9)
        model = Elastic(kernel, 1.0, **options)
        lattice = Lattice(1.0, (-half,) * dim, (half,) * dim)
        x = lattice.coordinates()
        bump = np.exp(-sum(c**2 for c in x) / width**2)
        u = np.stack([(1 + 0.3 * i + 0.2 * x[i - 1] / width) * bump for i in range(dim)])
        for nodes in thicknesses:
            sim = Simulation(lattice, model, LatticePML(nodes=nodes), {"u": u})
            moments = [int(np.ceil(half * k / model.p_speed / sim.dt)) for k in (1, 2, 3, 4, 6, 8)]
            exact = InfiniteLattice(sim.stencil, model.coefficient, model.integrator, sim.dt, moments[-1], sim.start_u)
            errors = []
            for step in moments:
                sim.step(step - sim.step_count)
                errors.append(float(np.abs(sim.fields["u"] - exact.after(step)).max() / np.abs(u).max()))
            wanted = {10: 1e-5, 20: 1e-7}[nodes] if dim == 3 else 0.0
            rows.append(
                {
                    "case": name,
                    "nodes": nodes,
                    "error": max(errors),
                    "at the end": errors[-1],
                    "met": verdict(max(errors), wanted, False) if wanted else "",
                }
            )
    return rows


def passes(given: argparse.Namespace) -> list[dict[str, Any]]:
    """One row per material."""
    rows, threads = [], min(2, available_threads())
    for name, (dim, n, options) in PASSES.items():
        model = Elastic(Kernel(3.0, 1, volume="full"), 1.0, 0.3, **options)
        scene = {"initial": {"v": [1.0] * dim}}
        box = Lattice(1.0, (0.0,) * dim, (n - 1.0,) * dim)
        hole = (Ball if dim == 3 else Disc)(n / 7, (n / 3,) * dim)
        pierced = Lattice(1.0, box.lower, box.upper, body=Box(box.lower - 1, box.upper + 1) - hole)
        cracks = [] if dim == 3 else _far_crack(n)
        brittle = Elastic(Kernel(3.0, 1, volume="full"), 1.0, 0.3, critical_stretch=1.0, **options)
        runs = {
            "passes": Simulation(box, model, Periodic(), **scene, cracks=cracks, threads=1),
            "stencil": Simulation(box, model.with_stencil(model.stencil(1.0, dim)), Periodic(), **scene, threads=1),
            "breaking": Simulation(box, brittle, Free(), **scene, threads=1),
            "box": Simulation(box, model, Periodic(), **scene, cracks=cracks, threads=threads),
            "free": Simulation(box, model, Free(), **scene, threads=threads),
            "hole": Simulation(pierced, model, Periodic(), **scene, threads=threads),
        }
        assert runs["passes"].engine.passes is not None and runs["stencil"].engine.passes is None
        times = interleaved({key: steps(run.engine) for key, run in runs.items()}, given.repeats)
        wanted = {"3D state-based": 1.5, "3D correspondence": 2.0}.get(name, 0.0)
        faster, size = ratio(times, "stencil", "passes"), runs["passes"].engine.nbytes / n**dim
        brittle_rate = n**dim / median(times, "breaking")
        free, pierced_box = (ratio(times, key, "box") for key in ("free", "hole"))
        rows.append(
            {
                "case": f"{name}, {n}^{dim}",
                "Mnodes/s": n**dim / median(times, "passes") / 1e6,
                "stencil/passes": faster,
                "breaking Mnodes/s": brittle_rate / 1e6,
                "free/periodic": free,
                "hole/periodic": pierced_box,
                "bytes/node": size,
                "rate met": verdict(faster, wanted, True) if wanted else "",
                "breaking met": verdict(brittle_rate, 3e6, True) if name == "3D state-based" else "",
                "faces met": verdict(max(free, pierced_box), 1.1, False) if dim == 3 else "",
                "memory met": verdict(size, 200, False),
            }
        )
    return rows


def closing(given: argparse.Namespace) -> list[dict[str, Any]]:
    """One row per material."""
    rows = []
    for name, (dim, n, options) in PASSES.items():
        box, middle = Lattice(1.0, (0.0,) * dim, (n - 1.0,) * dim), n / 2 - 0.4
        face = Polyline([(-n, middle), (2 * n, middle)])
        if dim == 3:
            face = Rectangle((-n, middle, -n), (3 * n, 0.0, 0.0), (0.0, 0.0, 3 * n))
        runs = {}
        for law, strength in (("lasting", {}), ("breaking", {"critical_stretch": 1.0})):
            for contact in (True, False):
                model = Elastic(Kernel(3.0, 1, volume="full"), 1.0, 0.3, contact=contact, **options, **strength)
                start = {"v": [1e-3 * np.random.default_rng(1).standard_normal((n,) * dim)] * dim}
                runs[law, contact] = Simulation(box, model, Free(), start, cracks=[face], threads=1)
        times = interleaved({str(key): steps(run.engine) for key, run in runs.items()}, given.repeats)
        last, broken = (ratio(times, str((law, True)), str((law, False))) for law in ("lasting", "breaking"))
        longer = runs["breaking", False].step_limit / runs["breaking", True].step_limit
        sizes = [run.engine.nbytes / n**dim for run in runs.values()]
        rows.append(
            {
                "case": f"{name}, {n}^{dim}",
                "closed/open": last,
                "closed/open, breaking": broken,
                "step open/closed": longer,
                "bytes/node": sizes[2],
                "of an open one": sizes[3],
            }
        )
    return rows


def strained(given: argparse.Namespace) -> list[dict[str, Any]]:
    """One row per lattice; the number of bonds that are checked depends on how close they are to breaking."""
    rows, options, stretch = [], {"material": "correspondence", "stabilisation": 0.3}, 1e-5
    for dim, n in ((2, 300), (3, 48)):
        box = Lattice(1.0, (0.0,) * dim, (n - 1.0,) * dim)
        start = {"u": [stretch * x for x in np.broadcast_arrays(*box.coordinates())]}
        strengths: dict[str, float | None] = {"whole": None, "0.05": stretch / 0.05, "0.5": stretch / 0.5}
        runs = {
            name: Simulation(
                box, Elastic(Kernel(3.0, 1), 1.0, 0.3, critical_stretch=critical, **options), Free(), start, threads=1
            )
            for name, critical in strengths.items()
        }
        times = interleaved({name: lambda count, run=run: run.step(count) for name, run in runs.items()}, given.repeats)
        rows.append(
            {"lattice": f"{n}^{dim}"} | {f"{name} of it": ratio(times, name, "whole") for name in ("0.05", "0.5")}
        )
    return rows


def heated(given: argparse.Namespace) -> list[dict[str, Any]]:
    """One row per lattice: with the heat of deformation relative to without; with shared layers of 12 nodes relative to
    separate ones.
    """
    rows = []
    for n in (61, 201):
        box = Lattice(1.0, (0.0, 0.0), (n - 1.0, n - 1.0))
        solid = Elastic(Kernel(2.0, 1), 70.0, density=2.7)
        heat = Heat(Kernel(2.0), density=2.7, specific_heat=0.9, conductivity=0.5)
        warm = {"T": f"300 + exp(-((x-{n // 2})**2 + (y-{n // 2})**2)/9)"}
        layer, other = LatticePML(nodes=12), LatticePML(nodes=13)
        cases: dict[str, tuple[bool, Any]] = {
            "coupled": (True, Free()),
            "not": (False, Free()),
            "shared": (True, layer),
            "own": (True, {"u": layer, "T": other}),
        }
        runs = {
            name: Simulation(box, Thermoelastic(solid, heat, 2e-5, 300.0, coupled), sides, warm, threads=1)
            for name, (coupled, sides) in cases.items()
        }
        times = interleaved({key: lambda count, run=run: run.step(count) for key, run in runs.items()}, given.repeats)
        ratios = {"coupled/not": ratio(times, "coupled", "not"), "shared/own layers": ratio(times, "shared", "own")}
        rows.append({"lattice": f"{n}^2", **ratios})
    return rows


def warm(given: argparse.Namespace) -> list[dict[str, Any]]:
    """One row per lattice, data and kind of layers."""
    rows = []
    for name, (last, axes, until) in WARM.items():
        dim, kernel = len(last), Kernel(1.5 if len(last) > 2 else 2.0, 1)
        solid = Elastic(kernel, 1.5, density=1.2)
        expansion = float(np.sqrt(0.2 * 2 * solid.p_modulus / 300)) / (3 * solid.bulk)  # a coupling constant of 0.2
        model = Thermoelastic(solid, Heat(kernel, 1.2, 2 / 1.2, 0.6), expansion, 300.0)
        radius = " + ".join(f"{axis}**2" for axis in "xyz"[:axes])
        bump, upper = f"exp(-({radius})/5)", np.array(last)
        far = int(0.6 * until * 1.3 * solid.p_speed)  # 1.3: upper bound of the speed of adiabatic P waves
        open_ended = np.arange(dim) < axes
        for kind, initial in (("heat", {"T": f"300 + {bump}"}), ("wave", {"u": [f"x*{bump}", *["0*x"] * (dim - 1)]})):
            for shared in (True, False):
                near, large = (
                    Simulation(
                        Lattice(1.0, -(upper + wider) * open_ended, upper + wider * open_ended),
                        model,
                        _warm_sides(dim, axes, shared),
                        initial,
                    )
                    for wider in (0, far)
                )
                part = tuple(slice(far, -far) if one else slice(None) for one in open_ended)
                row: dict[str, Any] = {"case": f"{name}, {kind}", "layers": "shared" if shared else "their own"}
                row |= {f"error of {field}": error for field, error in _apart(near, large, part, until).items()}
                error = max(row["error of u"], row["error of T"])
                rows.append(row | {"met": verdict(error, 1e-4, False) if shared else ""})
    return rows


def _apart(near: Simulation, large: Simulation, part: tuple[slice, ...], until: float) -> dict[str, float]:
    """Largest errors of both fields, relative to the largest value of each so far."""
    sizes, found = {"u": 0.0, "T": 0.0}, {"u": 0.0, "T": 0.0}
    for moment in (0.0, 0.01, 0.03, 0.1, 0.3, 0.6, 1.0):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that separate layers miss strains
            for sim in (near, large):
                sim.run(moment * until, progress=False)
        for field, base in (("u", 0.0), ("T", 300.0)):
            wanted = large.fields[field][(..., *part)]
            sizes[field] = max(sizes[field], float(np.abs(wanted - base).max()))
            found[field] = max(found[field], float(np.abs(near.fields[field] - wanted).max()))
    return {field: error / sizes[field] for field, error in found.items()}


def _warm_sides(dim: int, axes: int, shared: bool) -> dict[str, Any]:
    """Layers along the first `axes` axes, periodic sides along the others; if not shared, those of the temperature are
    thicker."""
    both = {
        field: {
            axis: LatticePML(nodes=16 + 4 * (field == "T" and not shared)) if i < axes else Periodic()
            for i, axis in enumerate("xyz"[:dim])
        }
        for field in "uT"
    }
    return both["u"] if shared else both


def _far_crack(n: int) -> list[list[tuple[float, float]]]:
    """A crack that cuts a bond or two, which enforces two passes in 2D as well."""
    return [[(n / 2 + 0.4, n / 2 + 0.6), (n / 2 + 0.6, n / 2 + 0.6)]]


if __name__ == "__main__":
    run_parts(
        __doc__,
        {
            "speed": ("Steps on one thread", speed),
            "breaking": ("Bonds that break, one thread", breaking),
            "passes": ("Two passes, one thread; free faces and holes, two", passes),
            "closing": ("Cracks that close, one thread", closing),
            "strained": ("Bonds that may break by energy, one thread", strained),
            "heated": ("A solid and its temperature, one thread", heated),
            "layers": ("Errors against the infinite lattice", layers),
            "warm": ("Errors of a solid and its temperature against a larger domain", warm),
        },
    )

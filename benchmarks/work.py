"""Cost of nodes that lack bonds, or whose bonds are processed one by one, relative to nodes of a plain stencil.

These are the constants of `farhorizon.simulation.processes.load_balance`, by which a lattice is divided into boxes for
several processes.

    NUMBA_NUM_THREADS=1 python benchmarks/work.py

Prints processor times per step and node, the smallest of several, on one thread, and the additional cost of a node next
to a crack, at a rim, at an interface or between metal and liquid, in units of plain nodes. Takes about five minutes,
mostly for compilation.
"""

import time

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

import farhorizon as fh

WIDE = {2: fh.Kernel(3.0), 3: fh.Kernel(2.0)}
NODES = {2: 240, 3: 44}
STATES = {"poisson": 0.3, "material": "state-based"}


def lattice(dim, body=None):
    return fh.Lattice(1.0, (0.0,) * dim, (NODES[dim] - 1.0,) * dim, body=body)


def seconds(setup):
    """Processor time of a step in seconds."""
    engine, found = fh.Simulation.of(setup).engine, []
    for _ in range(12):
        before = time.process_time()
        engine.advance(8)
        found.append((time.process_time() - before) / 8)
    return min(found)


def cracks(dim):
    if dim == 2:
        return [[(20.0, y + 0.5), (220.0, y + 0.5)] for y in range(20, 120, 20)]
    return [fh.Rectangle((5.0, 5.0, z + 0.5), (30.0, 0, 0), (0, 30.0, 0)) for z in (10, 30)]


def holes(dim):
    far, shape = NODES[dim], {2: fh.Disc, 3: fh.Ball}[dim]
    body = fh.Box((-1.0,) * dim, (float(far),) * dim)
    for place in np.stack(np.meshgrid(*[np.arange(20.0, far - 15, 20)] * dim), -1).reshape(-1, dim):
        body -= shape(5.0, tuple(place.tolist()))
    return body


def main():
    for dim, kernel in WIDE.items():
        reach, every = int(kernel.horizon), float(NODES[dim] ** dim)
        body = holes(dim)
        mask = lattice(dim, body).mask
        rims = int((mask & ~minimum_filter(mask, 2 * reach + 1, mode="nearest")).sum())
        lacking = sum(np.prod([200, 2 * reach] if dim == 2 else [31, 31, 2 * reach]) for _ in cracks(dim))
        breaking = {"critical_stretch": 0.01}
        models = {
            "wave": fh.Wave(kernel),
            "solid": fh.Elastic(kernel, 1.0),
            "bonds that break": fh.Elastic(kernel, 1.0, **breaking),
            "nonlinear bonds": fh.Elastic(kernel, 1.0, nonlinear=True, **breaking),
            "solid that varies": fh.Elastic(kernel, "1 + x/1000"),
            "states": fh.Elastic(kernel, 1.0, **STATES),
            "states that break": fh.Elastic(kernel, 1.0, **STATES, **breaking),
        }
        plain = {}
        for name, model in models.items():
            base = seconds(fh.Setup(lattice(dim), model, fh.Free()))
            plain[name] = base / every
            unit = plain["wave" if name == "wave" else "states" if "states" in name else "solid"]
            cut = (seconds(fh.Setup(lattice(dim), model, fh.Free(), cracks=cracks(dim))) - base) / lacking
            rim = (seconds(fh.Setup(lattice(dim, body), model, fh.Free())) - base) / rims
            print(
                f"{dim}D {name:20s} {1e9 * base / every:8.2f} ns a node, {base / every / unit:5.1f} plain ones; "
                f"beside a crack {cut / unit:+6.1f}, at a rim {rim / unit:+6.1f}",
                flush=True,
            )
        for name, make in {"wave": fh.Wave, "solid": fh.Elastic}.items():
            for axis in "x" + "xyz"[dim - 1]:
                strata = make(kernel, f"where(sin(pi*({axis} + 0.5)/20) > 0, 1.0, 1.3)")
                beside = NODES[dim] ** (dim - 1) * 2 * reach * ((NODES[dim] - 1) // 20)
                added = (seconds(fh.Setup(lattice(dim), strata, fh.Free())) - plain[name] * every) / beside
                print(
                    f"{dim}D {name:20s} beside an interface across {axis} {added / plain[name]:+6.1f} plain nodes each"
                )
        ball = {2: fh.Disc, 3: fh.Ball}[dim](NODES[dim] / 4, (NODES[dim] / 2,) * dim)
        liquid = seconds(fh.Setup(lattice(dim), fh.Diffusion(kernel), fh.Fixed()))
        metal = fh.Setup(lattice(dim), fh.Corrosion(kernel, saturation=0.8), fh.Fixed(), specimens=[fh.Specimen(ball)])
        solid = metal.specimens[0].nodes(metal.lattice)
        alone = minimum_filter(solid, 2 * reach + 1)
        front = maximum_filter(solid, 2 * reach + 1) & ~alone
        unit = liquid / every
        found = (seconds(metal) - (every - alone.sum()) * unit) / front.sum() / unit
        print(
            f"{dim}D between metal and liquid {found:+.1f} plain nodes each, metal alone taken for nothing", flush=True
        )


if __name__ == "__main__":
    main()

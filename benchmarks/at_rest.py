"""How much energy per area a crack at rest bears before it grows, over the fracture energy that was asked for.

A strip with a crack half way through is pulled apart slowly by its clamped edges. Far ahead of the crack it stores
``G`` per area that the crack would open, which is computed in a strip without a crack; when the first bonds break, and
when the crack has advanced by one horizon, that energy is compared with the fracture energy. A tip on a lattice waits
at each row of nodes, so that starting a crack takes more than keeping it running.

Run: ``python benchmarks/at_rest.py [--half H]`` (half the height of the strip in nodes, 20 unless given; a minute).
"""

from __future__ import annotations

import argparse

import numpy as np

import farhorizon as fh
from farhorizon.medium.fracture import fracture_energy

REACH = 3  # nodes in the horizon
STRETCH = 1e-3  # critical stretch; G is proportional to its square
DAMPING = 0.02  # waves of the loading die out within a few hundred steps
SLOW = 8  # times ten crossings of the height, in which the edges move by what fast loading would take
MATERIALS = {
    "bond-based": {"plane": "stress"},
    "state-based": {"poisson": 0.3, "plane": "stress"},
    "correspondence": {"poisson": 0.3, "stabilisation": 0.4, "plane": "stress"},
}


def material(name: str, stretch: float) -> fh.Elastic:
    kernel = fh.Kernel(float(REACH), exponent=1)
    return fh.Elastic(kernel, 1.0, material=name, critical_stretch=stretch, damping=DAMPING, **MATERIALS[name])


def asked(name: str) -> float:
    """The fracture energy that gives `STRETCH`."""
    if name == "bond-based":
        model = fh.Elastic(fh.Kernel(float(REACH), exponent=1), 1.0, plane="stress")
        stencil = model.stencil(1.0, 2)
        return float(fracture_energy(stencil.offsets.astype(float), model.bond_stiffness(stencil, 1.0), STRETCH))
    model = fh.Elastic(fh.Kernel(float(REACH), exponent=1), 1.0, material=name, **MATERIALS[name])
    return 1e-6 * (STRETCH / fh.calibrated_stretch(model, 1.0, fracture_energy=1e-6)) ** 2


def stored(name: str, half: int) -> tuple[float, float]:
    """Energy per area ahead of the crack when the first bond breaks, and when it has advanced by a horizon."""
    far, rate = 1e9, 0.006 * np.sqrt(half / 20) / (SLOW * 10 * half)
    top, low = fh.Box((-far, half - REACH + 0.1), (far, far)), fh.Box((-far, -far), (far, -half + REACH - 0.1))
    pulled = [fh.Prescribed(top, ["0", f"{rate}*t"]), fh.Prescribed(low, ["0", f"-{rate}*t"])]
    lattice = fh.Lattice(1.0, (-2 * half + 0.5, -half + 0.5), (2 * half - 0.5, half - 0.5))
    cracks = [[(-2.0 * half - 5, 0.0), (0.0, 0.0)]]
    sim = fh.Simulation(lattice, material(name, STRETCH), fh.Free(), cracks=cracks, constraints=pulled, threads=1)
    column = fh.Lattice(1.0, (0.0, -half + 0.5), (2 * REACH + 1.0, half - 0.5))
    sides = {"x": fh.Periodic(), "all": fh.Free()}
    intact = fh.Simulation(column, material(name, 1.0), sides, constraints=pulled, threads=1, dt=sim.dt)
    offsets = sim.stencil.offsets if name == "bond-based" else fh.Stencil.family(fh.Kernel(float(REACH), 1), 1.0, 2)[0]
    per_node = int(offsets[offsets[:, 1] > 0][:, 1].sum())  # bonds across the plane of the crack
    times = []
    for broken in (1, REACH * per_node):
        while sim.broken_bonds < broken:
            sim.step(20)
        intact.run(sim.time, progress=False)
        times.append(intact.energies()["strain"] / (2 * REACH + 2))
    return times[0], times[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--half", type=int, default=20)
    half = parser.parse_args().half
    print("energy per area over the fracture energy asked for")
    print(f"{'':16}{'first bond breaks':>20}{'advanced by a horizon':>24}")
    for name in MATERIALS:
        first, later = (energy / asked(name) for energy in stored(name, half))
        print(f"{name:16}{first:20.2f}{later:24.2f}", flush=True)


if __name__ == "__main__":
    main()

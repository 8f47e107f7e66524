"""Waves around two notches in an infinite membrane, by the Python interface.

The same as two_notches.toml (example 3 of Hermann, Shojaei, Seleson, Cyron and Silling, 2023). Runs in a few seconds:
``python examples/two_notches.py``.
"""

import numpy as np

import farhorizon as fh


def main() -> fh.Simulation:
    lattice = fh.Lattice(spacing=0.25, window=fh.Disc(radius=26))
    model = fh.Wave(fh.Kernel(horizon=0.75, exponent=2), speed=1.0, damping=0.0125)
    sim = fh.Simulation(
        lattice,
        model,
        boundary=fh.LatticePML(target=1e-8),
        initial={"u": lambda x, y: np.exp(-np.log(2) / 9 * (x**2 + y**2))},
        cracks=[[(-7, -7), (7, -7)], [(0, 10), (7, 10)]],
    )
    print(sim.check())
    probe = lattice.index((20, 10))
    for time in (10, 20, 30, 40, 50, 60, 70):
        sim.run(until=time)
        print(f"t = {sim.time:6.2f}   u(20, 10) = {sim.fields['u'][probe]:+.6f}   energy = {sim.energy():.6f}")
    return sim


if __name__ == "__main__":
    main()

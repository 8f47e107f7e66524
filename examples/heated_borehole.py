"""A heated borehole in infinite ground: absorbing sides compared with the exact line source.

Physics: ground of 2 W/(m K), 2000 kg/m^3 and 1000 J/(kg K) around a heater of 50 W per metre of depth, whose power is
spread over the borehole as a Gaussian 0.15 m wide. In an infinite plane the temperature never becomes steady: it rises
like log t, and at late times heat has spread many times farther than the square of 1.2 m that is computed.

Grid: spacing 1 cm, horizon 2 cm, triangular micro-conductivity. Heat crosses a horizon in horizon^2 / diffusivity = 400
s and half the width of the square in 3.6e5 s; the long run ends after a hundred times that, more than a year.

Prints the relative error at three probes against ``P/(4 pi k) (E1(r^2/(w^2 + 4 a t)) - E1(r^2/w^2))``: it is below 1e-3
from the first crossing of a horizon on.

Run: ``python examples/heated_borehole.py``; about 20 seconds.
"""

import numpy as np

import farhorizon as fh
from farhorizon.analysis.references.classical import line_source

CONDUCTIVITY, DENSITY, SPECIFIC_HEAT = 2.0, 2000.0, 1000.0
DIFFUSIVITY = CONDUCTIVITY / DENSITY / SPECIFIC_HEAT
POWER, WIDTH = 50.0, 0.15
SPACING, HORIZON, HALF = 0.01, 0.02, 0.6
PROBES = (0.0, 0.1, 0.3)
# time step and times, starting with the crossing of a horizon
EARLY = 200.0, HORIZON**2 / DIFFUSIVITY * np.array([1, 2, 5, 10, 100, 900])
LATE = 2e4, HALF**2 / DIFFUSIVITY * np.array([3, 10, 30, 100])  # up to a hundred diffusion times of the near field


def ground(dt: float) -> fh.Simulation:
    """The near field at rest, with only as many stages as the time step requires."""
    kernel = fh.Kernel(HORIZON, influence="linear")
    rate = fh.Heat(kernel).stencil(SPACING, 2).symbol_maximum * DIFFUSIVITY / SPACING**2
    model = fh.Heat(kernel, DENSITY, SPECIFIC_HEAT, CONDUCTIVITY, fh.RungeKuttaChebyshev.for_step(dt, rate))
    heater = fh.Source(lambda x, y: POWER / (np.pi * WIDTH**2) * np.exp(-(x**2 + y**2) / WIDTH**2), lambda t: 1.0)
    lattice = fh.Lattice(SPACING, (-HALF, -HALF), (HALF, HALF))
    return fh.Simulation(lattice, model, fh.LatticePML(nodes=36), sources=[heater], dt=dt)


def probe(sim: fh.Simulation, times: np.ndarray) -> np.ndarray:
    """Temperatures at the probes, one row per time."""
    nodes = [sim.lattice.index((r, 0.0)) for r in PROBES]
    rows = []
    for t in times:
        sim.run(t, progress=False)
        rows.append([sim.fields["u"][node] for node in nodes])
    return np.array(rows)


def errors(dt: float, times: np.ndarray) -> np.ndarray:
    """Relative error of each probe at each time."""
    exact = np.array(
        [[float(line_source(r, t, DIFFUSIVITY, CONDUCTIVITY, POWER, WIDTH)) for r in PROBES] for t in times]
    )
    return probe(ground(dt), times) / exact - 1


def main() -> None:
    """Compute early times with a small step and late times with a large one."""
    for dt, times in (EARLY, LATE):
        for t, row in zip(times, errors(dt, times), strict=True):
            print(f"t = {t:9.3g} s: " + ", ".join(f"r = {r} m: {e:+.1e}" for r, e in zip(PROBES, row, strict=True)))


if __name__ == "__main__":
    main()

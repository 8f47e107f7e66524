"""Layered ground from shot records: a full-waveform inversion on 300 x 100 nodes (SI units).

Physics: eight air guns under the surface of the sea, whose pressure is zero, and a streamer of hydrophones over the
whole width. Below the water lie layers of sediment with a fold and a lens of slow gas. The inversion starts from a
speed that grows with depth alone; low frequencies first keep waves from being matched with their neighbours.

Prints the error of the speed at the start and at the end.

Run: ``python examples/layered_inversion.py``; some minutes.
"""

import numpy as np

import farhorizon as fh

SPACING, UNTIL, DT, NOISE = 10.0, 1.6, 0.002, 0.02
LATTICE = fh.Lattice(SPACING, (0.0, -1000.0), (2990.0, -SPACING))  # held nodes at the surface lie beyond
X, Y = LATTICE.coordinates()
FLOOR, GUN, WATER = 100.0, fh.Ricker(7.0), 1500.0
STREAMER = fh.Receivers.line((20.0, -20.0), (2960.0, -20.0), 99).points
SIDES = {"all": fh.LatticePML(nodes=16), "y+": fh.Fixed(0.0)}
START = np.where(-Y < FLOOR, WATER, 1600.0 + 1.1 * (-Y - FLOOR))


def truth() -> np.ndarray:
    """Speed of sound in m/s at the nodes."""
    fold = 130.0 * np.exp(-(((X - 1300.0) / 450.0) ** 2))
    depths = [FLOOR, 250.0 + 0.02 * X, 450.0 - 0.6 * fold, 620.0 - fold, 800.0 - fold]
    layers = np.select([-Y < depth for depth in depths], [WATER, 1680.0, 1900.0, 2150.0, 2350.0], 2550.0)
    return np.where(np.hypot((X - 2100.0) / 230.0, (Y + 380.0) / 45.0) < 1, 1650.0, layers)


def sea(speed: np.ndarray, gun: float) -> fh.Setup:
    source = fh.PointSource((gun, -20.0), 1e6, GUN)
    model = fh.Wave(fh.Stencil.finite_difference(2), speed)
    return fh.Setup(LATTICE, model, SIDES, sources=[source], dt=DT)


def shots(count: int = 8) -> list[tuple[fh.Setup, fh.LeastSquares]]:
    rng, found = np.random.default_rng(4), []
    for gun in np.linspace(150.0, 2840.0, count).round(-1):
        line = fh.Receivers(STREAMER)
        data = fh.Simulation.of(sea(truth(), gun), observe=[line]).run(UNTIL, progress=False).recorders[0].data["u"]
        noisy = data + NOISE * np.abs(data[len(data) // 3 :]).max() * rng.standard_normal(data.shape)
        found.append((sea(START, gun), fh.LeastSquares(line, noisy)))
    return found


def inverted(given: list, iterations: int = 12, jobs: int = 2) -> fh.Inversion:
    options = {"region": -Y >= FLOOR, "frequencies": [5.0, 9.0, None], "smooth": 15.0, "variation": 1e-3}
    options["region"] &= (X > 30.0) & (X < 2960.0) & (Y > -970.0)
    return fh.invert(given, "speed", UNTIL, bounds={"speed": (1450, 2900)}, iterations=iterations, jobs=jobs, **options)


if __name__ == "__main__":
    given = shots()
    found = inverted(given).maps["speed"]
    for name, speed in {"start": START, "end": found}.items():
        print(f"error of the speed at the {name}: {np.sqrt(np.mean((speed - truth()) ** 2)):.0f} m/s")

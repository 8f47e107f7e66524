"""A hidden inclusion, found from eight sources and thirty-two receivers around it in an unbounded plate.

Physics: scalar waves of speed 1, in a disc of radius 5 of speed 1.2. Each source sends a pulse with a wavelength of 12,
and all receivers record it. The inversion starts from a uniform medium and changes the speed at every node inside of
the receivers until the runs agree with the records; a penalty on the total variation allows edges, but no texture.

Prints what was found; then the same with a sponge as thick as the layer, whose echoes become parts of the medium.

Run: ``python examples/hidden_inclusion.py``; a few minutes.
"""

import numpy as np

import farhorizon as fh

LATTICE = fh.Lattice(1.0, (-24.0, -24.0), (24.0, 24.0))
AT, CENTRE, RADIUS, CONTRAST = np.stack(LATTICE.coordinates(), -1), np.array([2.3, -1.6]), 5.0, 0.2
TRUTH = 1 + CONTRAST * np.clip(RADIUS + 0.5 - np.linalg.norm(AT - CENTRE, axis=-1), 0, 1)
LAYER, SPONGE, UNBOUNDED, UNTIL = fh.LatticePML(nodes=8), fh.Sponge(nodes=8), fh.LatticePML(nodes=24), 90.0


def ring(count: int, radius: float) -> np.ndarray:
    angles = 2 * np.pi * (np.arange(count) + 0.3) / count
    return radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def plate(speed: np.ndarray, place: np.ndarray, sides: fh.Side) -> fh.Setup:
    pulse = fh.PointSource(place, time=fh.Ricker(1 / 12), interpolation="linear")
    return fh.Setup(LATTICE, fh.Wave(fh.Kernel(2.0), speed), sides, sources=[pulse], dt=0.4)


def inverted(sides: fh.Side, noise: float = 0.0, iterations: int = 40, sources: int = 8) -> np.ndarray:
    """Return the speed that is found, from a uniform plate between such sides."""
    rng, shots = np.random.default_rng(8), []
    for place in ring(sources, 19.0):
        line = fh.Receivers(ring(32, 17.0), interpolation="linear")
        fh.Simulation.of(plate(TRUTH, place, UNBOUNDED), observe=[line]).run(UNTIL, progress=False)
        data = line.data["u"] + noise * np.abs(line.data["u"]).max() * rng.standard_normal(line.data["u"].shape)
        shots.append((plate(np.ones(LATTICE.shape), place, sides), fh.LeastSquares(line, data)))
    options = {"region": fh.Disc(radius=14.0), "variation": 0.01 + noise, "iterations": iterations}
    return fh.invert(shots, "speed", UNTIL, bounds={"speed": (0.8, 1.5)}, **options).maps["speed"]


def measured(speed: np.ndarray) -> tuple[float, np.ndarray, float]:
    """Return the contrast of what was found, its centre, and the relative error of the map."""
    change = np.maximum(speed - 1 - CONTRAST / 4, 0)
    centre = (change[..., None] * AT).sum((0, 1)) / change.sum()
    core = np.linalg.norm(AT - centre, axis=-1) < RADIUS - 1
    return speed[core].mean() - 1, centre, np.linalg.norm(speed - TRUTH) / np.linalg.norm(TRUTH - 1)


if __name__ == "__main__":
    maps = {}
    for name, sides, noise in [("layer", LAYER, 0.0), ("layer, 5 % noise", LAYER, 0.05), ("sponge", SPONGE, 0.0)]:
        maps[name] = inverted(sides, noise)
        contrast, centre, error = measured(maps[name])
        print(f"{name:16} contrast {contrast:.3f} of {CONTRAST} centre {centre.round(2)} error of the map {error:.2f}")

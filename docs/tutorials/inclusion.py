"""From records to an image: a fast inclusion in an unbounded plate, seen by four sources and sixteen receivers."""

import matplotlib.pyplot as plt
import numpy as np

import farhorizon as fh

lattice = fh.Lattice(1.0, (-15.0, -15.0), (15.0, 15.0))
x, y = lattice.coordinates()
truth = 1 + 0.15 * ((x - 2) ** 2 + (y + 1) ** 2 < 4**2)  # the speed, which nobody knows
angles = 2 * np.pi * np.arange(16) / 16
ring = np.stack([11 * np.cos(angles), 11 * np.sin(angles)], axis=1)
until, options = 60.0, {"bounds": {"speed": (0.8, 1.4)}, "region": fh.Disc(radius=9.0), "variation": 0.01}


def plate(speed, place):
    pulse = fh.PointSource(place, time=fh.Ricker(0.1), interpolation="linear")
    return fh.Setup(lattice, fh.Wave(fh.Kernel(2.0), speed), fh.LatticePML(nodes=10), sources=[pulse], dt=0.4)


shots = []
for place in 13 / 11 * ring[::4]:
    line = fh.Receivers(ring, interpolation="linear")
    fh.Simulation.of(plate(truth, place), observe=[line]).run(until, progress=False)  # in place of a measurement
    shots.append((plate(np.ones(lattice.shape), place), fh.LeastSquares(line, line.data["u"])))
found = fh.invert(shots, "speed", until, iterations=20, **options)
start, middle = found.history[0].misfit, found.maps["speed"][17, 14]
print(f"misfit {start:.2g} -> {found.misfit:.1g}; speed in the middle {middle:.2f}, true 1.15")

figure, panels = plt.subplots(1, 3, figsize=(10, 3), layout="constrained")
first = fh.gradient(*shots[0], "speed", until)["speed"]
shown = {"truth": (truth, 0.95, 1.2), "found": (found.maps["speed"], 0.95, 1.2), "first gradient": (first, -0.01, 0.01)}
for panel, (name, (values, low, high)) in zip(panels, shown.items(), strict=True):
    colours = "RdBu_r" if low < 0 else "viridis"
    panel.imshow(values.T, colours, origin="lower", extent=(-15, 15, -15, 15), vmin=low, vmax=high)
    panel.plot(*ring.T, "k.", markersize=3)
    panel.set_title(name)
figure.savefig("inclusion.png", dpi=150)

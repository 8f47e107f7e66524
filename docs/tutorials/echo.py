"""An ultrasonic echo from a crack in aluminium (SI units)."""

import matplotlib.pyplot as plt
import numpy as np

import farhorizon as fh

P_SPEED, DENSITY, FREQUENCY, DEPTH = 6300.0, 2700.0, 1e6, 20.1e-3
YOUNG = DENSITY * P_SPEED**2 / 1.2  # of Poisson's ratio 1/4, which bond-based materials have
lattice = fh.Lattice(spacing=0.25e-3, lower=(-25e-3, -30e-3), upper=(25e-3, 0.0))
model = fh.Elastic(fh.Kernel(0.5e-3, exponent=1, influence="linear"), young=YOUNG, density=DENSITY)


def burst(t):  # three cycles under a Hann window
    inside = (t > 0) & (t < 3 / FREQUENCY)
    return inside * np.sin(2 * np.pi * FREQUENCY * t) * np.sin(np.pi * FREQUENCY * t / 3) ** 2


def a_scan(cracks):  # vertical displacement below the probe, the mean over its face of 10 mm
    push = fh.Traction("y+", (0.0, -1e5), between=[(-5e-3, 5e-3)], time=burst)
    sides = {"all": fh.LatticePML(nodes=20), "y+": fh.Free()}
    sim = fh.Simulation(lattice, model, sides, loads=[push], cracks=cracks, dt=fh.WholeSteps(every=2e-8))
    probes = sim.record([(x, 0.0) for x in np.linspace(-5e-3, 5e-3, 21)])
    sim.run(until=12e-6, progress=False)
    return sim, probes.times, probes.values[:, :, 1].mean(axis=1)


sim, times, cracked = a_scan([[(-4e-3, -DEPTH), (4e-3, -DEPTH)]])
intact = a_scan([])[2]
# both begin where they first reach a fiftieth of their largest value
sent, received = (times[(np.abs(a) > np.abs(a).max() / 50).argmax()] for a in (intact, cracked - intact))
found = 0.5 * (received - sent) * P_SPEED
print(f"echo {(received - sent) * 1e6:.2f} µs after the burst: depth {found * 1e3:.1f} mm; it is {DEPTH * 1e3:.1f} mm")
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
left.plot(times * 1e6, cracked * 1e9)
left.set(xlabel="time in µs", ylabel="displacement in nm", title="A-scan")
right.pcolormesh(*[1e3 * c for c in lattice.coordinates()], np.hypot(*sim.fields["v"]), cmap="viridis")
right.set(aspect="equal", xlabel="x in mm", ylabel="y in mm", title=f"speed of motion at {sim.time * 1e6:.0f} µs")
figure.savefig("echo.png", dpi=150)

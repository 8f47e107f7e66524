"""A shot below the surface of layered ground, recorded along the surface (SI units)."""

import matplotlib.pyplot as plt
import numpy as np

import farhorizon as fh

lattice = fh.Lattice(spacing=10.0, lower=(-900, -800), upper=(900, 0))
x, y = lattice.coordinates()
speed = np.select([y > -305, y > -555], [1500.0, 2000.0], 2600.0)  # m/s, three layers
wavelet = "(1 - 2*(12*pi*(t-0.1))**2) * exp(-(12*pi*(t-0.1))**2)"  # Ricker's, 12 Hz, at 0.1 s

sim = fh.Simulation(
    lattice,
    fh.Wave(fh.Stencil.finite_difference(2), speed=speed),
    boundary={"all": fh.LatticePML(nodes=16), "y+": fh.Fixed(0.0)},  # no pressure at the surface
    sources=[fh.Source("1e6*exp(-(x**2 + (y+40)**2)/15**2)", time=wavelet)],
)
receivers = [(offset, -20.0) for offset in range(-800, 801, 20)]
probes = sim.record(receivers)
sim.run(until=1.2, progress=False)

traces, offsets = probes.values, probes.places[:, 0]
first = [probes.times[np.abs(traces[:, i]).argmax()] for i in (45, 55)]  # the direct wave, at offsets of 100 and 300 m
print(f"direct wave: {(offsets[55] - offsets[45]) / (first[1] - first[0]):.0f} m/s, the first layer has 1500 m/s")

figure, panel = plt.subplots(figsize=(7, 5), layout="constrained")
scale = 0.1 * np.abs(traces).max()
panel.pcolormesh(offsets, probes.times, traces, cmap="gray", vmin=-scale, vmax=scale, shading="nearest")
echo = np.hypot(offsets, 2 * 305.0 - 60.0) / 1500.0 + 0.1  # from the first interface, by geometrical optics
panel.plot(offsets, echo, "C3--", label="reflection from the first interface")
panel.set(xlabel="offset in m", ylabel="time in s", ylim=(1.2, 0), title="record section")
panel.legend(loc="lower center")
figure.savefig("seismogram.png", dpi=150)

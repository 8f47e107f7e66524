"""A crack that is pulled open in a plate without edges: where its tip is, and how fast it runs."""

import matplotlib.pyplot as plt
import numpy as np

import farhorizon as fh

lattice = fh.Lattice(spacing=0.25, lower=(-16, -15.875), upper=(16, 15.875))
model = fh.Elastic(fh.Kernel(horizon=0.75, exponent=1), young=1.0, fracture_energy=3e-5)
pull = "0.004*(exp(-(y-9)**2) - exp(-(y+9)**2)) * exp(-(x/7)**4) * (1 - exp(-t/3))"
sim = fh.Simulation(
    lattice,
    model,
    boundary=fh.LatticePML(nodes=24),
    cracks=[[(-2, 0), (2, 0)]],
    sources=[["0", pull]],
    dt=fh.WholeSteps(every=2.0),
    balance=True,
)
x, y = lattice.coordinates()
times, tips = [], []
for time in range(0, 42, 2):
    sim.run(until=time, progress=False)
    times.append(sim.time)
    tips.append(x[sim.fields["damage"] > 0.3].max())

speeds = np.diff(tips) / np.diff(times)
shear = np.sqrt(0.4)  # of Young's modulus and density 1 and Poisson's ratio 1/4
print(f"tip at the start {tips[0]:.2f}, at the end {tips[-1]:.2f}; {sim.broken_bonds} bonds broke")
print(f"largest speed of the tip {speeds.max():.2f}, of Rayleigh waves {0.919 * shear:.2f}")
print({name: f"{value:.3g}" for name, value in sim.balance().items()})

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
shown = left.pcolormesh(x, y, sim.fields["damage"], cmap="magma_r", vmin=0)
left.set(aspect="equal", title=f"damage at t = {sim.time:.0f}", xlabel="x", ylabel="y")
figure.colorbar(shown, ax=left)
right.plot(times, tips)
right.set(xlabel="t", ylabel="x of the right tip")
figure.savefig("crack.png", dpi=150)

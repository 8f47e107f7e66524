# %% How much of a pulse a slit lets through, for several widths of the slit
import matplotlib.pyplot as plt
import numpy as np

import farhorizon as fh

lattice = fh.Lattice(spacing=0.25, lower=(-8, -8), upper=(8, 8))
sim = fh.Simulation(
    lattice,
    fh.Wave(fh.Kernel(horizon=0.75), speed=1.0),
    boundary=fh.LatticePML(target=1e-6, until=30.0),
    initial={"u": "exp(-2*((x+4)**2 + y**2))"},
)
print(sim)

# %% Before the run: what will come back, how long it takes
report = sim.check(until=30.0)
print(report)

# %% The same run with a wall that has a slit; nothing else changes
widths = [1.0, 2.0, 4.0, 8.0]
through = []
for width in widths:
    wall = [[(0.125, width / 2), (0.125, 20.0)], [(0.125, -20.0), (0.125, -width / 2)]]
    part = sim.remade(cracks=wall)
    probes = part.record([(4.0, 0.0)])
    part.run(until=30.0, progress=False)
    through.append(np.abs(probes.values).max())
    plt.plot(probes.times, probes.values[:, 0], label=f"slit {width:g} wide")
print("largest value behind the wall:", np.round(through, 4))

# %% Traces behind the wall
plt.xlabel("t")
plt.ylabel("u at (4, 0)")
plt.legend()
plt.savefig("notebook.png", dpi=150)

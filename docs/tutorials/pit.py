"""A pit that grows in steel through a hole in its film, in an electrolyte without end (SI units: m, s, mol)."""

import matplotlib.pyplot as plt
import numpy as np

import farhorizon as fh

METAL, SATURATION = 143e3, 5.1e3  # concentrations in mol/m^3
DIFFUSIVITY, IRON = 8.5e-10, 0.05585  # m^2/s, kg/mol
SPACING = 4e-6
kernel = fh.Kernel(horizon=2 * SPACING)
model = fh.Corrosion(kernel, DIFFUSIVITY, saturation=SATURATION, interface=1.0, limited=True)
lattice = fh.Lattice(SPACING, lower=(-100e-6, -80e-6), upper=(100e-6, 80e-6))
steel = fh.Specimen(fh.Box((-80e-6, -60e-6), (80e-6, 0.0)), METAL)
film = [(12, 2), (82, 2), (82, -62), (-82, -62), (-82, 2), (-12, 2)]  # in micrometres; a hole of 24
cut, step = [np.array(film) * 1e-6], fh.WholeSteps(every=2.0)
sim = fh.Simulation(lattice, model, specimens=[steel], cracks=cut, dt=step, balance=True)
start = sim.fields["solid"].sum()
times, depths = [], []
for time in range(2, 152, 2):
    sim.run(until=time, progress=False)
    pit = sim.fields["dissolved"] > 0
    times.append(sim.time)
    depths.append(-lattice.coordinates()[1][pit].min(initial=0.0) * 1e6)
lost = (start - sim.fields["solid"].sum()) * SPACING**2 * METAL * IRON
found = sim.balance()
print(f"activation control alone: {model.speed(SPACING, 2, METAL) * 1e3 * 3.156e7:.0f} mm a year")
print(f"after {sim.time:.0f} s: depth {depths[-1]:.0f} micrometres, {lost * 1e6:.2g} mg of iron lost a metre")
print(f"largest concentration in the liquid {np.max(sim.fields['u'][sim.fields['solid'] == 0]):.0f} mol/m^3")
print(f"balance: residual {abs(found['residual'] / found['metal']):.0e} of what dissolved")
figure, panels = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
shown = panels[0].pcolormesh(*[1e6 * c for c in lattice.coordinates()], sim.fields["dissolved"], cmap="viridis")
panels[0].set(aspect="equal", xlabel="x in µm", ylabel="y in µm", title="time at which it dissolved, in s")
figure.colorbar(shown)
panels[1].plot(times, depths)
panels[1].set(xlabel="time in s", ylabel="depth of the pit in µm")
figure.savefig("pit.png", dpi=150)

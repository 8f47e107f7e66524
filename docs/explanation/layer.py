"""What comes back from a lattice PML, over its thickness."""

import matplotlib.pyplot as plt
import numpy as np

import farhorizon as fh

NODES = [2, 4, 6, 8, 12, 16, 20]
bar = fh.Lattice(spacing=0.1, lower=-3, upper=3)
for reach in (1, 2, 3):
    model = fh.Wave(fh.Kernel(horizon=0.1 * reach, exponent=2))
    start = fh.Setup(bar, model, initial={"u": "exp(-8*x**2)"})
    exact = fh.Simulation.of(start).remade(boundary=fh.Extended(target=1e-12)).run(until=12.0, progress=False)
    errors = []
    for nodes in NODES:
        sim = exact.remade(boundary=fh.LatticePML(nodes=nodes)).run(until=12.0, progress=False)
        errors.append(np.abs(sim.fields["u"] - exact.fields["u"]).max())
    print(
        f"reach {reach}: " + ", ".join(f"{nodes} nodes {error:.0e}" for nodes, error in zip(NODES, errors, strict=True))
    )
    plt.semilogy(NODES, errors, "o-", label=f"reach {reach}")
plt.xlabel("nodes of the layer")
plt.ylabel("largest error at t = 12")
plt.legend()
plt.savefig("layer.png", dpi=150)

"""A hot half-space whose face is quenched: cracks grow from the face, and some outrun the others.

Physics: a solid in plane stress, free of stress while it is hot. From t = 0 on, its face is cooled by one unit over a
short ramp, and the change of the temperature penetrates as ``erfc(depth / (2 sqrt(D t)))``. The cold part would shrink,
but the solid beneath holds it, so that the face is under tension. There the bonds, whose strengths scatter by a few per
cent, break, and cracks grow as deep as the cooling allows. The longer they are, the farther they unload the solid
beside them. Some of them therefore stop while the others continue at increasing distances, as in quenched ceramics.

Scaling: lengths in spacings; Young's modulus and the density are 1, so that waves cross a spacing in about 1. The cold
needs some hundred of these times for ten spacings: it is slow compared with the waves, though far less so than in
ceramics.

Sides: periodic along the face; at the bottom, one layer for the heat and one for the waves. Displacements and
temperature are one model, without the heat of deformation, which would be small.

Prints the depths of the cold and of the cracks, the number of cracks near the face, and the number at half the depth of
the deepest one; draws ``quenched_face.png``.

Run: ``python examples/quenched_face.py``; about 10 seconds.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

import farhorizon as fh

WIDTH, DEPTH = 200, 90
DIFFUSIVITY, RAMP = 0.08, 60.0
SHRINKAGE, STRENGTH = 0.015, 0.0075  # strain of the full change of the temperature; stretch at which bonds break
TIMES = (300.0, 1000.0, 2500.0)


def solid(width: int = WIDTH, depth: int = DEPTH) -> fh.Simulation:
    """The solid with its temperature; each field has its own layer at the bottom."""
    lattice = fh.Lattice(1.0, (0.0, -float(depth)), (width - 1.0, 0.0))
    bonds = fh.Elastic(
        fh.Kernel(3.0, exponent=1),
        young=1.0,
        plane="stress",
        damping=0.02,
        critical_stretch=fh.Weibull(STRENGTH, 15.0, 2.0, seed=3),
    )
    heat = fh.Heat(fh.Kernel(2.0), conductivity=DIFFUSIVITY)
    ends = {"x": fh.Periodic(), "y+": fh.Free()}
    return fh.Simulation(
        lattice,
        fh.Thermoelastic(bonds, heat, expansion=SHRINKAGE, reference=0.0, coupled=False),
        {"u": ends | {"y-": fh.LatticePML(nodes=16)}, "T": ends | {"y-": fh.LatticePML(nodes=24)}},
        constraints=[fh.Temperature("y+", f"-min(t/{RAMP}, 1)")],
    )


def cracked(sim: fh.Simulation) -> np.ndarray:
    """Number of cracks that cross each row of nodes, starting at the face."""
    broken = sim.fields["damage"] > 0.35
    first = broken & ~np.roll(broken, 1, axis=0)
    return first.sum(0)[::-1]


def drawn() -> Figure:
    """Run, print the results and draw the figure."""
    sim = solid()
    figure, panels = plt.subplots(len(TIMES), 1, figsize=(7.0, 7.0), sharex=True, layout="constrained")
    for panel, time in zip(panels, TIMES, strict=True):
        sim.run(time, progress=False)
        count = cracked(sim)
        deepest = int(np.flatnonzero(count)[-1]) if count.any() else 0
        print(
            f"t = {time:g}: cold to {2 * np.sqrt(DIFFUSIVITY * time):.0f}, cracks to {deepest}: "
            f"{count[3]} of them 3 deep, {count[deepest // 2]} half as deep as the deepest"
        )
        strain = sim.fields["thermal_strain"]
        extent = (-0.5, WIDTH - 0.5, -DEPTH - 0.5, 0.5)
        back = panel.imshow(strain.T / SHRINKAGE, origin="lower", extent=extent, cmap="Blues_r", vmin=-1, vmax=0)
        damage = np.ma.masked_less(sim.fields["damage"].T, 0.2)
        panel.imshow(damage, origin="lower", extent=extent, cmap="inferno_r", vmin=0.2, vmax=0.8)
        panel.set(ylabel="y / spacing", ylim=(-70, 0.5), title=f"t = {time:g}")
    panels[-1].set_xlabel("x / spacing")
    figure.colorbar(back, ax=panels, label="change of temperature", shrink=0.5)
    return figure


def main() -> None:
    """Write the figure to a file."""
    drawn().savefig("quenched_face.png", dpi=150)


if __name__ == "__main__":
    main()

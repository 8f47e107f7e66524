"""A picture of what each example script computes: ``python docs/_extensions/scripts.py SCRIPT PICTURE``."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import farhorizon as fh

Names = dict[str, Any]


# Each function is named like the script whose picture it draws.


def plane(sim: fh.Simulation | fh.Body, field: np.ndarray, title: str, colours: str = "viridis") -> Figure:
    """A field of the plane over its coordinates."""
    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    panel = figure.add_subplot()
    x, y = sim.lattice.coordinates()
    drawn = panel.pcolormesh(x, y, field, cmap=colours, shading="nearest")
    panel.set(aspect="equal", xlabel="x", ylabel="y", title=title)
    figure.colorbar(drawn)
    return figure


def two_notches(names: Names) -> Figure:
    sim = names["main"]()
    largest = np.nanmax(np.abs(sim.fields["u"]))
    figure = plane(sim, sim.fields["u"], f"u at t = {sim.time:.0f}", "RdBu_r")
    figure.axes[0].collections[0].set_clim(-largest, largest)
    return figure


def heated_borehole(names: Names) -> Figure:
    dt, times = names["EARLY"]
    sim = names["ground"](dt).run(times[4], progress=False)
    return plane(sim, sim.fields["u"], f"temperature rise in K after {sim.time / 3600:.0f} hours", "inferno")


def insulating_crack(names: Names) -> Figure:
    return plane(sim := names["plate"](0.06), sim.fields["u"], "temperature of the steady state", "inferno")


def penny_crack(names: Names) -> Figure:
    sim = names["block"](0.0).run(2.0, progress=False)
    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    panel = figure.add_subplot()
    x, _, z = sim.lattice.axes
    section = sim.fields["u"][:, sim.lattice.shape[1] // 2]
    drawn = panel.pcolormesh(x, z, section.T, cmap="inferno", shading="nearest")
    panel.set(aspect="equal", xlabel="x", ylabel="z", title="temperature in a plane through the centre of the crack")
    figure.colorbar(drawn)
    return figure


def indentation(names: Names) -> Figure:
    body = names["half_space"](0.006).run(names["UNTIL"])
    return plane(body, body.fields["damage"], f"damage at t = {body.time:.0f}", "magma_r")


def mesh_scatterer(names: Names) -> Figure:
    near = names["mesh"](names["NEAR"])
    figure = Figure(figsize=(7.2, 3.0), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    for panel, edge in zip(panels, ("plane waves, wide clouds", "fixed"), strict=True):
        u = names["run"](near, edge)[-1]
        drawn = panel.tripcolor(*near.p, near.t.T, u, cmap="RdBu_r", vmin=-0.1, vmax=0.1, shading="gouraud")
        panel.set(aspect="equal", xlabel="x", title=f"closed by {edge}" if edge != "fixed" else "fixed edge")
    figure.colorbar(drawn, ax=panels)
    return figure


def main() -> None:
    script, picture = map(Path, sys.argv[1:])
    globals()[script.stem](runpy.run_path(str(script))).savefig(picture, dpi=150)


if __name__ == "__main__":
    main()

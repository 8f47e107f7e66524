"""Film of the README: the membrane of the demo in the infinite medium, with a layer and with a fixed edge.

    python benchmarks/film.py            # writes docs/demo.webp, in two minutes

The infinite medium is a box so large that nothing returns from its edge before the end.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.pictures.fields import field_panels
from farhorizon.pictures.panels import Look, Panel

PLACE = Path(__file__).parents[1] / "docs" / "demo.webp"
EVERY = 0.5  # time between frames
RATE = 12  # frames per second
LARGEST = 0.12  # limit of the colours; the initial maximum is 1, but the spreading wave soon falls below this value
DPI = 100
QUALITY = 55


def runs(case: Case) -> tuple[dict[str, fh.Simulation], tuple[slice, ...]]:
    """Runs in the infinite medium, with the layer and with a fixed edge, and the slices of the window in the first
    one."""
    setup = case.setup
    lattice, mine = setup.lattice, fh.Simulation.of(setup)
    radius = float(lattice.axes[0][-1])
    # waves from the pulse to the edge of the box and back to the window take longer than the film
    more = round((case.end - radius) / 2 / lattice.spacing) + round(0.3 * radius / lattice.spacing)
    edge = radius + more * lattice.spacing
    large = replace(setup, lattice=fh.Lattice(lattice.spacing, (-edge,) * 2, (edge,) * 2), boundary=fh.Fixed())
    far, fixed = (fh.Simulation.of(replace(one, dt=mine.dt)) for one in (large, replace(setup, boundary=fh.Fixed())))
    return {"infinite medium": far, "farhorizon": mine, "fixed edge": fixed}, (slice(more, -more),) * 2


def frames(case: Case) -> Iterator[Image.Image]:
    """Yield the frames one after the other."""
    shown, inside = runs(case)
    lattice = case.setup.lattice
    steps = round(EVERY / shown["farhorizon"].dt)
    for number in range(round(case.end / steps / shown["farhorizon"].dt) + 1):
        if number:
            for sim in shown.values():
                sim.step(steps)
        fields = [(name, sim.fields["u"][inside if name == "infinite medium" else ...]) for name, sim in shown.items()]
        within = [(name, np.where(lattice.mask, u, np.nan).clip(-LARGEST, LARGEST)) for name, u in fields]
        yield drawn(within, case, shown["farhorizon"].time)  # clipped, so that the colour bar has no arrows


def drawn(fields: list[tuple[str, np.ndarray]], case: Case, time: float) -> Image.Image:
    """Draw one frame: the fields side by side on one scale."""
    title = f"waves around two notches, t = {time:.1f}"
    look = Look(title=title, limits=(-LARGEST, LARGEST), cracks=case.polylines)
    figure = field_panels([Panel(*field) for field in fields], case.setup.lattice.axes, None, look)
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=PLACE, help="the film (default: docs/demo.webp)")
    options = parser.parse_args()
    case = Case(files("farhorizon.case").joinpath("demo.toml").read_text(encoding="utf-8"))
    first, *others = frames(case)
    first.save(
        options.out, save_all=True, append_images=others, duration=round(1000 / RATE), loop=0, quality=QUALITY, method=6
    )
    count, size = 1 + len(others), options.out.stat().st_size
    print(f"{options.out}: {count} pictures, {count / RATE:.1f} s, {size} bytes")


if __name__ == "__main__":
    main()

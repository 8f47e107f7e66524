"""Pictures of the geometry of a case: its nodes and their materials."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from farhorizon.case.case import Case
from farhorizon.pictures.fields import field_panels
from farhorizon.pictures.panels import Look, Panel, Plane
from farhorizon.pictures.words import axis_label
from farhorizon.simulation.run import Run
from farhorizon.simulation.setup.regions import uneven


def draw_geometry(case: Case, run: Run, folder: Path) -> list[Path]:
    """Draw whatever varies from node to node in a case and a run of it at its start; call it within `counted_in`.

    The files are ``NAME-nodes.png`` for a body or a window, ``NAME-coefficient.png``, ``NAME-metal.png``, for a body of
    several materials ``NAME-young.png`` and so on; in 3D slices through the middle, ``NAME-nodes-x.png`` and so on.
    There are none for a uniform medium that fills its box.
    """
    paths, lattice = [], case.lattice
    planes = [Plane.middle(lattice.shape, normal) for normal in range(3)] if lattice.dim == 3 else [None]
    for name, values in _uneven(case, run):
        for plane in planes:
            paths.append(folder / f"{case.name}-{name}{'' if plane is None else '-' + 'xyz'[plane.normal]}.png")
            look = Look(axis_label(name, name), plane=plane, cracks=case.polylines)
            field_panels([Panel("", values)], lattice.axes, paths[-1], look)
    return paths


def _uneven(case: Case, run: Run) -> Iterator[tuple[str, np.ndarray]]:
    """Names and values of everything that varies from node to node."""
    mask = case.lattice.mask
    if mask is not None:
        yield "nodes", mask.astype(float)
    for name, values in uneven(run).items():
        yield name, np.where(True if mask is None else mask, values, np.nan)

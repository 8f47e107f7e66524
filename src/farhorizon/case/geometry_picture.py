"""Pictures of the geometry of a case: its nodes and their materials."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from farhorizon.case.case import Case
from farhorizon.pictures.fields import field_panels
from farhorizon.pictures.words import axis_label
from farhorizon.simulation.run import Run
from farhorizon.simulation.setup.regions import uneven


def draw_geometry(case: Case, run: Run, folder: Path) -> list[Path]:
    """Draw whatever varies from node to node in a case; call it within `counted_in` for units.

    Parameters
    ----------
    case : Case
    run : Run
        A run of it, at its start.
    folder : Path
        Folder of the pictures.

    Returns
    -------
    list of Path
        ``NAME-nodes.png`` for a body or a window, ``NAME-coefficient.png``, ``NAME-metal.png``, for a body of several
        materials ``NAME-young.png`` and so on; in 3D slices through the middle, ``NAME-nodes-x.png`` and so on; empty
        for a uniform medium that fills its box.
    """
    made, lattice = [], case.lattice
    planes = [(axis, n // 2) for axis, n in enumerate(lattice.shape)] if lattice.dim == 3 else [None]
    for what, values in _uneven(case, run):
        for plane in planes:
            made.append(folder / f"{case.name}-{what}{'' if plane is None else '-' + 'xyz'[plane[0]]}.png")
            label = axis_label(what, what)
            field_panels([("", values)], lattice.axes, made[-1], cracks=case.polylines, label=label, plane=plane)
    return made


def _uneven(case: Case, run: Run) -> Iterator[tuple[str, np.ndarray]]:
    """Names and values of everything that varies from node to node."""
    mask = case.lattice.mask
    if mask is not None:
        yield "nodes", mask.astype(float)
    for name, values in uneven(run).items():
        there = np.ones(case.lattice.shape, bool) if mask is None else mask
        yield name, np.where(there, values, np.nan)

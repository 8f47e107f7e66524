"""Outlines in a results file, next to the fields: cracks, and the edges of the near field and of its layers."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from farhorizon.inputs.cracks import as_crack


def outlines_of(run: Any) -> dict[str, list[np.ndarray]]:
    """Return the polylines of a run by name, each of shape (n, dim); on several processes, those of the whole lattice.

    Parameters
    ----------
    run : Run

    Returns
    -------
    dict
        "cracks": cracks as given (in space their rims, on a line points); "near field": its edges; "layers": the edges
        of everything that is computed, if that extends beyond the near field.
    """
    lattice = run.lattice.whole
    lower, upper = np.array(lattice.lower), np.array(lattice.upper)
    cuts = [as_crack(crack, lattice.dim).cut for crack in run.given["cracks"]]
    found = {"cracks": [line for cut in cuts if len(line := cut.outline())], "near field": edges(lower, upper)}
    if any(run.beyond.values()):
        ends = (lower.copy(), upper.copy())
        for (axis, side), nodes in run.beyond.items():
            ends[side > 0][axis] += side * nodes * lattice.spacing
        found["layers"] = edges(*ends)
    return {name: lines for name, lines in found.items() if lines}


def edges(lower: np.ndarray, upper: np.ndarray) -> list[np.ndarray]:
    """Return the edges of a box: its two ends on a line, a closed polyline in the plane, twelve edges in space."""
    dim = len(lower)
    if dim == 1:
        return [lower[None], upper[None]]
    if dim == 2:
        (x, y), (right, top) = lower, upper
        return [np.array([(x, y), (right, y), (right, top), (x, top), (x, y)])]
    found = []
    for axis, corner in product(range(dim), product((0, 1), repeat=dim - 1)):
        start = np.where(np.insert(np.array(corner), axis, 0), upper, lower)
        found.append(np.array([start, np.where(np.arange(dim) == axis, upper, start)]))
    return found

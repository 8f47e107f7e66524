"""Regions of a run: nodes that are made of the same, as one number a node."""

from __future__ import annotations

from typing import Any

import numpy as np

from farhorizon.files.region_numbers import OUTSIDE, Regions
from farhorizon.simulation.near_field import constants_of

_MOST = 256  # values of a constant; what has more varies continuously


def uneven(run: Any) -> dict[str, np.ndarray]:
    """What differs from node to node: "metal" (of bool), "coefficient" and constants of the model, by name.

    Parameters
    ----------
    run : Simulation
    """
    near, solid = run.parts.near, run.parts.start.solid
    told = {"metal": solid if solid.any() else None, "coefficient": near.coefficient, **constants_of(run.setup)}
    return {name: values for name, values in told.items() if values is not None}


def regions_of(run: Any, named: Regions | None = None) -> Regions | None:
    """The regions of a run; None where one medium fills its box.

    They are counted by their size: 0 has most nodes. A constant with more than 256 values, as one that scatters or
    grows with depth, tells no regions.

    Parameters
    ----------
    run : Simulation
    named : Regions, optional
        Names of materials, which stand before their constants.
    """
    if run.team:  # no process has all nodes
        return None
    shape, hidden = run.lattice.shape, run.parts.near.hidden
    there = np.ones(shape, bool) if hidden is None else ~hidden
    numbers, names = np.zeros(there.sum(), np.int64), [""]
    if named is not None:
        known, numbers = np.unique(named.numbers[there], return_inverse=True)
        names = [named.names[k] for k in known]
    for what, values in uneven(run).items():
        known, which = np.unique(np.broadcast_to(values, shape)[there], return_inverse=True)
        if len(known) > _MOST:
            continue
        words = [_said(what, value) for value in known]
        pairs, numbers = np.unique(numbers * len(known) + which.ravel(), return_inverse=True)
        names = [", ".join(filter(None, (names[k // len(known)], words[k % len(known)]))) for k in pairs]
    if len(names) == 1 and there.all():
        return None
    order = np.argsort(-np.bincount(numbers), kind="stable")
    whole = np.full(shape, OUTSIDE, np.int32)
    whole[there] = np.argsort(order)[numbers]
    return Regions(whole, tuple(names[k] or "medium" for k in order))


def _said(what: str, value: Any) -> str:
    if what == "metal":
        return "metal" if value else "liquid"
    return f"{what} = {value:.6g}"

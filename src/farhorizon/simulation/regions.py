"""Regions of a run: nodes that are made of the same, as one number a node."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from farhorizon.files.region_numbers import OUTSIDE, Regions
from farhorizon.simulation.host import constants_of
from farhorizon.simulation.team import Team

_MOST = 256  # values of a constant; what has more varies continuously


def uneven(run: Any) -> dict[str, np.ndarray]:
    """What differs from node to node: "metal" (of bool), "coefficient" and constants of the model, by name; of several
    processes on the nodes of this one.

    Parameters
    ----------
    run : Simulation
    """
    near, solid = run.parts.near, run.parts.start.solid
    constants = constants_of(replace(run.setup, lattice=run.lattice))
    told = {"metal": solid if run.team.any(bool(solid.any())) else None, "coefficient": near.coefficient, **constants}
    return {name: values for name, values in told.items() if values is not None}


def regions_of(run: Any, named: Regions | None = None) -> Regions | None:
    """The regions of a run; None where one medium fills its box, and on all processes but the first, which has them.

    They are counted by their size: 0 has most nodes. A constant with more than 256 values, as one that scatters or
    grows with depth, tells no regions.

    Parameters
    ----------
    run : Simulation
    named : Regions, optional
        Names of materials, which stand before their constants.
    """
    shape, hidden, team = run.lattice.shape, run.parts.near.hidden, run.team
    there = np.ones(shape, bool) if hidden is None else ~hidden
    numbers, names = np.zeros(there.sum(), np.int64), [""]
    if named is not None:
        known, numbers = _numbered(named.numbers[run.lattice.within][there], team)
        names = [named.names[k] for k in known]
    for what, values in uneven(run).items():
        known, which = _numbered(np.broadcast_to(values, shape)[there], team, _MOST + 1)
        if len(known) > _MOST:
            continue
        words = [_said(what, value) for value in known]
        pairs, numbers = _numbered(numbers * len(known) + which, team)
        names = [", ".join(filter(None, (names[k // len(known)], words[k % len(known)]))) for k in pairs]
    counts = team.summed(np.bincount(numbers, minlength=len(names)))
    alike = len(names) == 1 and not team.any(not there.all())
    order = np.argsort(-counts, kind="stable")
    own = np.full(shape, OUTSIDE, np.int32)
    own[there] = np.argsort(order)[numbers]
    whole = None if alike else team.joined(run.lattice, own)
    return None if whole is None else Regions(whole, tuple(names[k] or "medium" for k in order))


def _numbered(values: np.ndarray, team: Team, most: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """The different ones of values that all processes have, at most so many of each, and which each here is."""
    known = np.unique(np.concatenate(team.gather(np.unique(values)[:most])))
    return known, np.searchsorted(known, values)


def _said(what: str, value: Any) -> str:
    if what == "metal":
        return "metal" if value else "liquid"
    return f"{what} = {value:.6g}"

"""Regions of a run: nodes of the same material, as one number per node."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from farhorizon.files.results_layout import OUTSIDE, Regions
from farhorizon.simulation.processes.process_group import ProcessGroup
from farhorizon.simulation.setup.reference_medium import constants_of

_MOST = 256  # values of a constant; with more of them it counts as varying continuously


def uneven(run: Any) -> dict[str, np.ndarray]:
    """Return what varies from node to node of this process, by name: "metal" (boolean), "coefficient" and constants of
    the model.
    """
    near, solid = run.parts.near, run.parts.start.solid
    constants = constants_of(replace(run.setup, lattice=run.lattice))
    told = {"metal": solid if run.team.any(bool(solid.any())) else None, "coefficient": near.coefficient, **constants}
    return {name: values for name, values in told.items() if values is not None}


def regions_of(run: Any, named: Regions | None = None) -> Regions | None:
    """Return the regions of a run by size, the largest first, after `named` materials; None where one medium fills the
    box, and on all processes but the first. A constant with more than 256 values defines none.
    """
    shape, hidden, team = run.lattice.shape, run.parts.near.hidden, run.team
    exists = np.ones(shape, bool) if hidden is None else ~hidden
    numbers, names = np.zeros(exists.sum(), np.int64), [""]
    if named is not None:
        known, numbers = _numbered(named.numbers[run.lattice.within][exists], team)
        names = [named.names[k] for k in known]
    for what, values in uneven(run).items():
        known, which = _numbered(np.broadcast_to(values, shape)[exists], team, _MOST + 1)
        if len(known) > _MOST:
            continue
        words = [_said(what, value) for value in known]
        pairs, numbers = _numbered(numbers * len(known) + which, team)
        names = [", ".join(filter(None, (names[k // len(known)], words[k % len(known)]))) for k in pairs]
    counts = team.summed(np.bincount(numbers, minlength=len(names)))
    alike = len(names) == 1 and not team.any(not exists.all())
    order = np.argsort(-counts, kind="stable")
    numbers_here = np.full(shape, OUTSIDE, np.int32)
    numbers_here[exists] = np.argsort(order)[numbers]
    numbers_of_all = None if alike else team.joined(run.lattice, numbers_here)
    return None if numbers_of_all is None else Regions(numbers_of_all, tuple(names[k] or "medium" for k in order))


def _numbered(values: np.ndarray, team: ProcessGroup, most: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the distinct values on all processes together, taking at most `most` of each process, and the index among
    them of each value here.
    """
    known = np.unique(np.concatenate(team.gather(np.unique(values)[:most])))
    return known, np.searchsorted(known, values)


def _said(what: str, value: Any) -> str:
    if what == "metal":
        return "metal" if value else "liquid"
    return f"{what} = {value:.6g}"

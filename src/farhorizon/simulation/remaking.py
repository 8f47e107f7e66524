"""Set-ups that are made anew with some arguments changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from farhorizon.simulation.assembly import Parts
from farhorizon.simulation.setup import Setup, check_names


def remade_setup(setup: Setup, settled: Setup, parts: Parts, changes: Mapping[str, Any]) -> Setup:
    """Return a set-up at its start with some arguments changed. On another lattice there are no data and sources, and
    the medium is uniform, as stiff as its stiffest part. The chosen time step and layers are kept, unless the model
    changes on the same lattice.
    """
    check_names(changes)
    near, start = parts.near, parts.start
    if "lattice" not in changes:
        settled = setup if "model" in changes else settled
        initial = {"u": start.u + float(changes.get("background", near.background))}
        initial |= {"v": start.v} if near.model.order == 2 else {}
        return replace(settled, **{"initial": initial, **changes})
    nothing = dict.fromkeys(("sources", "loads", "cracks", "constraints", "specimens"), ())
    changes = {**nothing, "initial": {}, "coefficient": None, "rim": "free", "balance": False, **changes}
    changes.setdefault("model", near.model)
    if near.squared_speed is not None and near.strongest > 0:
        changes["model"] = changes["model"].scaled(near.strongest)
    return replace(settled, **changes)

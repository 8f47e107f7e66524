"""State of a run as arrays and JSON, and what a checkpoint must have in common with the run that resumes from it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from farhorizon.engine.pieces import parts_of_sums
from farhorizon.simulation.assembly import Parts
from farhorizon.simulation.setup.setup import Setup

Arrays = dict[str, np.ndarray]


#: Entries of the fingerprint that refer to the nodes of one process; not compared when several processes are involved.
OF_A_BOX = "shape", "lower", "held", "cuts", "conditions", "density", "strength", "toughness", "solid"


def fingerprint(setup: Setup, parts: Parts, cuts: int) -> dict[str, Any]:
    """Return what a checkpoint and the run that resumes from it must have in common; `cuts` is the number of absent
    bonds at the start.
    """
    near, engine, model = parts.near, parts.grid.engine, parts.near.model
    lattice, law, dissolution = near.lattice, model.bond_law, model.dissolution
    found = {
        "levels": len(engine.levels),
        "dtype": engine.dtype.name,
        "dt": near.dt,
        "shape": list(lattice.shape),
        "spacing": lattice.spacing,
        "lower": lattice.lower.tolist(),
        "model": type(model).__name__,
        "coefficient": model.coefficient,
        "damping": model.damping,
        "weights": float(near.stencil.weights.sum()),
        "neighbours": len(near.stencil.weights),
        "cuts": cuts,
        "held": len(parts.held),
        "conditions": len(near.conditions.nodes),
        "opens": [c.opens for c in setup.cracks],
    }
    if model.drag:
        found["drag"] = model.drag
    if np.any(engine.reaction):
        found["reaction"] = np.asarray(engine.reaction).tolist()
    if near.density is not None:
        found["density"] = float(near.density.sum())
    if parts.ends is not None:
        found["exact"] = parts.ends.names
    if parts.closure is not None:
        found |= {"fringe": list(engine.outline_history.shape), "update": parts.closure.mark()}
    if law is not None:
        found["bonds"] = [law.nonlinear, law.critical_stretch_on(lattice.spacing, lattice.dim)]
    heat = setup.heat
    if parts.breaking is not None and parts.breaking.may_break and heat is not None and heat.of_run(heat.temperature):
        found["insulated"] = heat.contact_conductance  # broken bonds conducted in earlier versions
    if law is not None and law.contact:
        found["contact"] = True
    if law is not None and law.softening is not None:
        found["softening"] = [law.softening, law.fracture_energy]
    if near.variation.toughness is not None:
        found["toughness"] = float(near.variation.toughness.sum())
    if near.variation.strength is not None:
        found["strength"] = float(near.variation.strength.sum())
    if near.prescribed.constraints:
        found["constraints"] = len(near.prescribed.constraints)
    if dissolution is not None:
        found |= {"solid": int(parts.start.solid.sum()), "saturation": dissolution.saturation}
        found |= {"interface": dissolution.interface} | ({"limited": True} if dissolution.limited else {})
    return found


def whole_of(parts: Parts) -> tuple[Arrays, dict[str, Any]]:
    """Return what the state of a run on one process has in addition to that of its nodes: the initial data, partial
    sums in the order in which they were added, and the memory of sides that exist only on one process; as arrays, and
    as facts for JSON.
    """
    engine, meta = parts.grid.engine, {}
    arrays = {"start_u": parts.start.u, "start_v": parts.start.v}
    arrays |= {f"sums/{name}": sums for name, sums in parts_of_sums(engine).items()}
    if parts.ends is not None:
        more, meta["exact"] = parts.ends.save()
        arrays |= more
    if parts.closure is not None:
        arrays["fringe"] = engine.outline_history
    if engine.tables.stretches.memory.size:
        arrays["stretches"] = engine.tables.stretches.memory
    return arrays, meta


def take_whole(parts: Parts, arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any]) -> None:
    """Restore what `whole_of` returned."""
    engine = parts.grid.engine
    if parts.ends is not None:
        parts.ends.load(arrays, meta["exact"])
    if parts.closure is not None:
        engine.outline_history[...] = arrays["fringe"]
    if engine.tables.stretches.memory.size:
        engine.tables.stretches.memory[...] = arrays["stretches"]
    for name, sums in parts_of_sums(engine).items():
        sums[...] = arrays[f"sums/{name}"]

"""The state of a run as arrays and JSON, and what a checkpoint must have in common with the run that goes on from
it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from farhorizon.simulation.assembly import Parts
from farhorizon.simulation.flow_balance import FlowBalance
from farhorizon.simulation.setup import Setup

Arrays = dict[str, np.ndarray]


def fingerprint(setup: Setup, parts: Parts, cuts: int) -> dict[str, Any]:
    """What a checkpoint and the run that goes on from it have in common; `cuts` is the number of absent bonds at the
    start.
    """
    near, engine, model = parts.near, parts.grid.engine, parts.near.model
    lattice, law, dissolution = near.lattice, model.bond_law, model.dissolution
    found = {
        "levels": list(engine.levels.shape),
        "memory": int(engine.memory.size),
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
        found |= {"fringe": list(engine.fringe_history.shape), "update": parts.closure.mark()}
    if law is not None:
        found["bonds"] = [law.nonlinear, law.critical_stretch_on(lattice.spacing, lattice.dim)]
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


def state_of(parts: Parts, balance: FlowBalance | None) -> tuple[Arrays, dict[str, Any]]:
    """The state of a run that cannot be had from its set-up: arrays, and facts as JSON."""
    engine = parts.grid.engine
    meta: dict[str, Any] = {"phase": int(engine.phase)}
    arrays = {"levels": engine.levels, "memory": engine.memory, "start_u": parts.start.u, "start_v": parts.start.v}
    if parts.ends is not None:
        more, meta["exact"] = parts.ends.save()
        arrays |= more
    arrays |= engine.bonds.state
    if engine.tables.drag.rate.size:
        arrays["drag"] = engine.tables.drag.lost
    if parts.phases is not None:
        arrays["dissolved"] = np.ascontiguousarray(engine.dissolved[parts.grid.near])
    if parts.closure is not None:
        arrays["fringe"] = engine.fringe_history
    if balance is not None:
        arrays |= {"flows": engine.flows, "powers": balance.powers}
        meta["first_amounts"] = balance.first
    return arrays, meta


def take_state(parts: Parts, arrays: Arrays, meta: dict[str, Any], step: int) -> None:
    """Be in a state, of a step, but for what depends on the cracks that are open then: see `take_rest`."""
    engine = parts.grid.engine
    engine.levels[...] = arrays["levels"]
    engine.memory[...] = arrays["memory"]
    if parts.ends is not None:
        parts.ends.load(arrays, meta["exact"])
    if parts.closure is not None:
        engine.fringe_history[...] = arrays["fringe"]
    if engine.tables.drag.rate.size:
        engine.tables.drag.lost[...] = arrays["drag"]
    engine.phase, engine.steps_done = int(meta["phase"]), step
    if parts.phases is not None:
        parts.phases.set(arrays["dissolved"])


def take_rest(parts: Parts, balance: FlowBalance | None, arrays: Arrays, meta: dict[str, Any]) -> None:
    """What `take_state` leaves out, once the cracks are open."""
    engine = parts.grid.engine
    for name, array in engine.bonds.state.items():
        array[...] = arrays[name]
    if balance is not None:
        engine.flows[...], balance.powers[...] = arrays["flows"], arrays["powers"]
        balance.first = meta["first_amounts"]

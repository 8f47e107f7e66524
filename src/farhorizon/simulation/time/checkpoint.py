"""State of a run as arrays and JSON, and what a checkpoint must have in common with the run that resumes from it."""

from __future__ import annotations

import json
from collections.abc import Container, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon.engine.state import of_the_run, parts_of_sums
from farhorizon.errors import FileFormatError
from farhorizon.files.checkpoint_format import read_checkpoint
from farhorizon.simulation.assembly import RunParts
from farhorizon.simulation.setup.serialization import rebuild
from farhorizon.simulation.setup.setup import Setup

Arrays = dict[str, np.ndarray]
#: Entries of the fingerprint that refer to the nodes of one process; not compared when several processes are involved.
OF_A_BOX = "shape", "lower", "held", "cuts", "conditions", "density", "strength", "toughness", "solid"


def fingerprint(setup: Setup, parts: RunParts, cuts: int) -> dict[str, Any]:
    """What a checkpoint and the run that resumes from it must have in common, as JSON; `cuts` is the number of absent
    bonds at the start.
    """
    near, engine, model = parts.near, parts.grid.engine, parts.near.model
    lattice, law, dissolution = near.lattice, model.bond_law, model.dissolution
    facts = {
        "levels": len(engine.get("levels")),
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
        facts["drag"] = model.drag
    if model.attenuation is not None:
        facts["attenuation"] = repr(model.attenuation)
    if np.any(engine.reaction):
        facts["reaction"] = np.asarray(engine.reaction).tolist()
    if near.density is not None:
        facts["density"] = float(near.density.sum())
    if parts.ends is not None:
        facts["exact"] = parts.ends.names
    if parts.closure is not None:
        facts |= {"fringe": list(engine.get("outline_stencil.history.T").shape), "update": parts.closure.mark()}
    if law is not None:
        facts["bonds"] = [law.nonlinear, law.critical_stretch_on(lattice.spacing, lattice.dim)]
    heat = setup.heat
    if parts.breaking is not None and parts.breaking.may_break and heat is not None and heat.of_run(heat.temperature):
        facts["insulated"] = heat.contact_conductance  # broken bonds conducted in earlier versions
    if law is not None and law.contact:
        facts["contact"] = True
        if law.slides and setup.cracks:
            facts["friction"] = law.friction
    if law is not None and law.softening is not None:
        facts["softening"] = [law.softening, law.fracture_energy]
    if law is not None and law.law is not None:
        facts["law"] = [type(law.law).__name__, law.law.arguments]
    if near.variation.toughness is not None:
        facts["toughness"] = float(near.variation.toughness.sum())
    if near.variation.strength is not None:
        facts["strength"] = float(near.variation.strength.sum())
    if near.prescribed.constraints:
        facts["constraints"] = len(near.prescribed.constraints)
    if parts.impactors is not None:
        facts["impactors"] = parts.impactors.mark()
    if dissolution is not None:
        facts |= {"solid": int(parts.start.solid.sum()), "saturation": dissolution.saturation}
        facts |= {"interface": dissolution.interface} | ({"limited": True} if dissolution.limited else {})
    return facts


def check_alike(
    path: Path, meta: Mapping[str, Any], fingerprint: dict[str, Any], left_out: Container[str] = ()
) -> None:
    """Refuse a checkpoint whose fingerprint, in `meta`, differs from that of a set-up in entries not left out."""
    mine, theirs = json.loads(json.dumps(fingerprint)), meta.get("fingerprint", {})
    different = sorted(k for k in {*mine, *theirs} if k not in left_out and mine.get(k) != theirs.get(k))
    if different:
        raise FileFormatError(
            "the checkpoint belongs to another set-up",
            value=str(path),
            limit=f"same {', '.join(different)}",
            remedy="resume with the case that wrote it",
        )


def arguments_in(path: str | Path, run: str, left_out: Container[str]) -> dict[str, Any]:
    """Arguments of the run that wrote a checkpoint, of the class named `run`, without those left out; the initial data
    are arrays of its state. InputError for a Python function, which a file cannot hold.
    """
    arrays, meta = read_checkpoint(path)
    if len(meta.get("boxes", ())) > 1:
        raise FileFormatError(
            "a checkpoint of several processes does not hold what was given for the run",
            value=str(path),
            remedy=f"make the same {run} and load(path)",
        )
    if "setup" not in meta or meta.get("fingerprint", {}).get("run", "Simulation") != run:
        raise FileFormatError(f"the file holds no {run}", value=str(path), remedy=f"a checkpoint written by {run}.save")
    given = meta["setup"]["dict"]
    arguments = {name: rebuild(value, arrays, name) for name, value in given.items() if name not in left_out}
    if "start_u" in arrays:
        arguments["initial"] = {"u": arrays["start_u"] + rebuild(given["background"], arrays)}
        arguments["initial"] |= {"v": arrays["start_v"]} if np.any(arrays["start_v"]) else {}
    return arguments


def whole_of(parts: RunParts) -> tuple[Arrays, dict[str, Any]]:
    """What the state of a run on one process has beside that of its nodes, as arrays and as JSON: the initial data,
    partial sums in the order in which they were added, the memory of sides that exist only on one process.
    """
    engine, meta = parts.grid.engine, {}
    arrays = {"start_u": parts.start.u, "start_v": parts.start.v}
    arrays |= {f"sums/{name}": sums for name, sums in parts_of_sums(engine).items()}
    if parts.ends is not None:
        more, meta["exact"] = parts.ends.save()
        arrays |= more
    return arrays | of_the_run(engine), meta


def take_whole(parts: RunParts, arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any]) -> None:
    """Restore what `whole_of` returned."""
    engine = parts.grid.engine
    if parts.ends is not None:
        parts.ends.load(arrays, meta["exact"])
    for name, values in of_the_run(engine).items():
        if name in arrays:
            values[...] = arrays[name]
    for name, sums in parts_of_sums(engine).items():
        sums[...] = arrays[f"sums/{name}"]

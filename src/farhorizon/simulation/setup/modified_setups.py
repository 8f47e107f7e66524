"""Set-ups that are made anew with some arguments changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from farhorizon.geometry.lattice import Lattice
from farhorizon.inputs.expressions import Expression
from farhorizon.simulation.assembly import RunParts
from farhorizon.simulation.setup.reference_medium import constants_of
from farhorizon.simulation.setup.setup import Setup, check_names

_LEAST = 5  # planes that remain of a stretch of equal ones, or as many as a node interacts with


def evaluated_setup(setup: Setup) -> Setup:
    """Return a set-up with the values, at the nodes, of those constants of its model that are functions of users, so
    that trials and runs that are made anew do not call them again.
    """
    varying = setup.model.varying
    functions = [name for name, value in varying.items() if callable(value) and not isinstance(value, Expression)]
    if not functions:
        return setup
    constants = constants_of(setup)
    return replace(setup, model=setup.model.with_constants({name: constants[name] for name in functions}))


def remade_setup(setup: Setup, resolved: Setup, parts: RunParts, changes: Mapping[str, Any]) -> Setup:
    """Return a set-up at its start with some arguments changed, with the chosen time step and layers unless the model
    changes on the same lattice. On another lattice there are no data and sources, and the medium is uniform, as stiff
    as its stiffest part.
    """
    check_names(changes)
    near, start = parts.near, parts.start
    if "lattice" not in changes:
        resolved = setup if "model" in changes else resolved
        initial = {"u": start.u + float(changes.get("background", near.background))}
        initial |= {"v": start.v} if near.model.order == 2 else {}
        return replace(resolved, **{"initial": initial, **changes})
    nothing = dict.fromkeys(("sources", "loads", "cracks", "constraints", "specimens"), ())
    changes = {**nothing, "initial": {}, "coefficient": None, "rim": "free", "balance": False, **changes}
    changes["model"] = changes.get("model", near.model).with_one_attenuation()
    if near.squared_speed is not None and near.strongest > 0:
        changes["model"] = changes["model"].scaled(near.strongest)
    return replace(resolved, **changes)


def shortened_setup(setup: Setup, resolved: Setup, parts: RunParts) -> Setup | None:
    """Return a set-up at rest in which stretches of equal planes are shortened to what a node interacts with, so that
    all pairs of adjoining media remain; None with bodies, cracks, conditions or regions of another quality, and
    where less than half of the nodes are saved.
    """
    near = parts.near
    special = setup.cracks or setup.constraints or setup.specimens or near.lattice.mask is not None
    special = special or setup.model.by_region
    properties = [*near.variation.of_waves, *(() if near.coefficient is None else [near.coefficient])]
    if special or not properties:
        return None
    stacked = np.stack(properties)
    kept = [
        _shortened(np.moveaxis(stacked, 1 + axis, 0), max(_LEAST, 2 * reach + 1))
        for axis, reach in enumerate(near.stencil.reach)
    ]
    shape = np.array([len(planes) for planes in kept])
    if 2 * np.prod(shape) > near.lattice.nodes:
        return None
    chosen, lattice = np.ix_(*kept), near.lattice
    constants = {name: values[chosen] for name, values in constants_of(setup).items()}
    return replace(
        resolved,
        lattice=Lattice(lattice.spacing, lattice.lower, lattice.lower + lattice.spacing * (shape - 1)),
        model=setup.model.with_constants(constants),
        coefficient=None if near.coefficient is None else near.coefficient[chosen],
        initial={},
        sources=(),
        loads=(),
        balance=False,
    )


def _shortened(planes: np.ndarray, most: int) -> np.ndarray:
    """Return the numbers of the planes (first axis) that remain if at most some of a stretch of equal ones do."""
    changes = 1 + np.flatnonzero((planes[1:] != planes[:-1]).reshape(len(planes) - 1, -1).any(1))
    stretches = np.split(np.arange(len(planes)), changes)
    return np.concatenate([stretch[:most] for stretch in stretches])

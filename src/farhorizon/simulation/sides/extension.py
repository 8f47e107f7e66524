"""Size of the domain beyond sides that extend it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from farhorizon.analysis.extent import Datum, Extent, Waves, extent, largest
from farhorizon.errors import InputError
from farhorizon.inputs.sources import at_times
from farhorizon.rounding import MARGIN
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Key, Setup, Sides, side_name
from farhorizon.simulation.sides.layered_sides import LayeredSides, check_extended, enlarged, memory_needed
from farhorizon.simulation.time.source_terms import SourceTerm
from farhorizon.simulation.time.start import Start


@dataclass(frozen=True, eq=False)
class Emitters:
    """All that sends waves or diffuses, from which the size of an extended domain follows."""

    near: NearField
    sides: Sides
    start: Start
    source_terms: Sequence[SourceTerm]
    everywhere: bool  # whether waves may start anywhere, because some source does not split into space and time
    # number of nodes, for the length of a run and an error, for a temperature that continues with the displacements
    front: Callable[[float, float], int]

    def extents_for(
        self, errors: Mapping[Key, float], until: float, given: Mapping[Key, int] | None = None
    ) -> dict[Key, Extent]:
        """Return how far the medium must be computed beyond some sides so that at most the error of each returns during
        a run; for `given` numbers of nodes it is predicted what returns instead. Raises InputError if the domain does
        not fit into memory.
        """
        near, model, lattice, stencil = self.near, self.near.model, self.near.lattice, self.near.fastest
        steps = max(1, int(np.ceil(until / near.dt - MARGIN)))
        fastest = near.fastest_rate * (1 + (0.0 if near.coupling is None else near.coupling.stiffening))
        medium = Waves(stencil, fastest, model.integrator, near.dt, model.damping, steps)
        fixed = given or {}
        least = {key: max(0, int(medium.front - lattice.shape[key[0]]) // 2) for key in errors if key not in fixed}
        check_extended(16 * stencil.components * enlarged(lattice.shape, least), lattice.shape, least)
        data = self._data(medium)
        sizes = [largest(medium, datum) for datum in data]
        extents: dict[Key, Extent] = {}
        known: dict[Any, Extent] = {}
        for (axis, side), error in errors.items():
            oriented = [datum.oriented(axis, side) for datum in data]
            mirror = self.sides[axis, -side].image
            normal, nodes = stencil.along(axis), fixed.get((axis, side))
            case = error, mirror, normal, nodes, *(datum.values.tobytes() for datum in oriented)
            if case not in known:
                beyond = extent(replace(medium, stencil=normal), oriented, sizes, mirror, error, nodes)
                known[case] = replace(beyond, until=until)
            if nodes is not None:
                extents[axis, side] = known[case]
                continue
            # where absent bonds can close, they do so one reach before a fixed end, and waves are reflected there
            unclosed = stencil.reach[axis] if model.bond_law is not None and model.bond_law.contact else 0
            nodes = max(known[case].nodes + unclosed, self.front(until, error))
            extents[axis, side] = replace(known[case], nodes=nodes)
        return extents

    def _data(self, medium: Waves) -> list[Datum]:
        """Return the emitters component by component. Those of which only the place is known count as initial values of
        size 1.
        """
        near, lattice, waves = self.near, self.near.lattice, self.near.model.order == 2
        busy = near.busy | (self.everywhere or any(space is None for space, _ in self.source_terms))
        for (axis, side), boundary in self.sides.items():
            if boundary.held is not None and boundary.held != near.background:
                np.moveaxis(busy, axis, 0)[0 if side < 0 else -1] = True
        data = [
            ("u", self.start.u, np.zeros(0)),
            ("v", self.start.v, np.zeros(0)),
            ("u", busy.astype(float), np.zeros(0)),
        ]
        times = near.dt * np.arange(medium.steps if waves else 0)
        for space, time in self.source_terms:
            if space is not None:
                history = at_times(time, times)
                data.append(("source" if waves else "u", space * near.model.source_factor, history))
        parts = [
            Datum(part, kind, time) for kind, values, time in data for part in np.reshape(values, (-1, *lattice.shape))
        ]
        parts = [datum for datum in parts if datum.values.any() and (datum.kind != "source" or datum.time.any())]
        return parts or [Datum(np.ones(lattice.shape), "u")]


def extend(setup: Setup, layered: LayeredSides, emitters: Emitters, notes: list[str]) -> LayeredSides:
    """Choose how far the medium is computed beyond the sides that extend it, and assess numbers of nodes that are given
    together with a target: `notes` receives warnings. Raises InputError if the domain does not fit into memory.
    """
    near = emitters.near
    extending = {key: side for key, side in layered.sides.items() if side.extended}
    given = {key: side for key, side in extending.items() if side.nodes is not None}
    extents = {key: Extent(side.nodes, side.until or np.inf) for key, side in given.items()}
    errors = {key: side.wanted(near.model.target) for key, side in extending.items() if key not in given}
    lengths = {extending[key].until or near.crossing for key in errors}
    if lengths:
        extents |= emitters.extents_for(errors, max(lengths))
    doubts = _too_near({key: side for key, side in given.items() if side.target and side.until}, emitters)
    notes += doubts
    extended = replace(layered, extents=extents, doubts=layered.doubts + doubts)
    if extending:
        nodes = {key: reached.nodes for key, reached in extents.items()}
        check_extended(memory_needed(setup, near.stencil, extended), near.lattice.shape, nodes)
    return extended


def _too_near(given: Sides, emitters: Emitters) -> list[str]:
    """Return a warning for each number of nodes from whose end more may return than the target of their sides."""
    missed: dict[tuple[int, float, float], list[Key]] = {}
    predicted: dict[Key, float] = {}
    for until in sorted({side.until for side in given.values()}):
        targets = {key: side.target for key, side in given.items() if side.until == until}
        fixed = {key: given[key].nodes for key in targets}
        for key, reached in emitters.extents_for(targets, until, fixed).items():
            if reached.predicted > targets[key]:
                missed.setdefault((reached.nodes, targets[key], until), []).append(key)
                predicted[key] = reached.predicted
    doubts = []
    for (nodes, target, until), keys in missed.items():
        try:
            enough = emitters.extents_for(dict.fromkeys(keys, target), until)
            remedy = f"{max(reached.nodes for reached in enough.values())} nodes would meet it"
        except InputError:
            remedy = "no domain that fits into memory meets it"
        doubts.append(
            f"extended domain of {nodes} nodes ({', '.join(side_name(*key) for key in keys)}): "
            f"up to {max(predicted[key] for key in keys):.1g} of the largest value may return, more than the target "
            f"{target:g}; {remedy}"
        )
    return doubts

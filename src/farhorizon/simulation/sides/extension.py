"""Size of the domain beyond sides that extend it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from farhorizon.analysis.extent import Datum, Extent, Waves, extent, largest
from farhorizon.errors import InputError
from farhorizon.machine import available_memory
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Key, Setup, Sides, side_name
from farhorizon.simulation.sides.layered_sides import LayeredSides, enlarged, memory_needed, too_large
from farhorizon.simulation.time.source_terms import SourceTerm
from farhorizon.simulation.time.start import Start


@dataclass(frozen=True, eq=False)
class Emitters:
    """All that sends waves or diffuses, from which the size of an extended domain follows.

    Attributes
    ----------
    near : NearField
    sides : dict of (axis, side) to Side
    start : Start
    source_terms : sequence of SourceTerm
    everywhere : bool
        Whether waves may start anywhere, because some source does not split into space and time.
    front : callable
        Returns, for the length of a run and an error, the number of nodes that is needed for a temperature that
        continues beyond the sides with the displacements.
    """

    near: NearField
    sides: Sides
    start: Start
    source_terms: Sequence[SourceTerm]
    everywhere: bool
    front: Callable[[float, float], int]

    def extents_for(
        self, wanted: Mapping[Key, float], until: float, given: Mapping[Key, int] | None = None
    ) -> dict[Key, Extent]:
        """Return how far the medium must be computed beyond some sides so that nothing returns during a run.

        Parameters
        ----------
        wanted : mapping of (axis, side) to float
            Wanted error of each side.
        until : float
            Length of the run.
        given : mapping of (axis, side) to int, optional
            Numbers of nodes for which it is predicted what returns, instead of those that are needed.

        Raises
        ------
        InputError
            The domain does not fit into memory.
        """
        near, model, lattice, stencil = self.near, self.near.model, self.near.lattice, self.near.fastest
        steps = max(1, int(np.ceil(until / near.dt - 1e-9)))
        fastest = near.fastest_rate * (1 + (0.0 if near.coupling is None else near.coupling.stiffening))
        medium = Waves(stencil, fastest, model.integrator, near.dt, model.damping, steps)
        fixed = given or {}
        least = {key: max(0, int(medium.front - lattice.shape[key[0]]) // 2) for key in wanted if key not in fixed}
        if enlarged(lattice.shape, least) * stencil.components * 16 > available_memory():
            raise too_large(lattice.shape, least, stencil.components, 8)
        data = self._data(medium)
        sizes = [largest(medium, datum) for datum in data]
        found: dict[Key, Extent] = {}
        known: dict[Any, Extent] = {}
        for (axis, side), error in wanted.items():
            turned = [datum.oriented(axis, side) for datum in data]
            mirror = self.sides[axis, -side].image
            normal = stencil.along(axis)
            like = error, mirror, normal, fixed.get((axis, side)), *(datum.values.tobytes() for datum in turned)
            if like not in known:
                known[like] = replace(
                    extent(replace(medium, stencil=normal), turned, sizes, mirror, error, fixed.get((axis, side))),
                    until=until,
                )
            one = known[like]
            if (axis, side) in fixed:
                found[axis, side] = one
                continue
            # where absent bonds can close, they do so one reach before a fixed end, and waves are reflected there
            unclosed = stencil.reach[axis] if model.bond_law is not None and model.bond_law.contact else 0
            found[axis, side] = replace(one, nodes=max(one.nodes + unclosed, self.front(until, error)))
        return found

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
                course = np.array([float(time(t)) for t in times])
                data.append(("source" if waves else "u", space * near.model.source_factor, course))
        found = [
            Datum(part, kind, time) for kind, values, time in data for part in np.reshape(values, (-1, *lattice.shape))
        ]
        found = [datum for datum in found if datum.values.any() and (datum.kind != "source" or datum.time.any())]
        return found or [Datum(np.ones(lattice.shape), "u")]


def extend(setup: Setup, layered: LayeredSides, emitters: Emitters, notes: list[str]) -> LayeredSides:
    """Choose how far the medium is computed beyond the sides that extend it, and assess numbers of nodes that are given
    together with a target: `notes` receives warnings.

    Raises
    ------
    InputError
        The domain does not fit into memory.
    """
    near = emitters.near
    extended = {key: b for key, b in layered.sides.items() if b.extended}
    given = {key: b for key, b in extended.items() if b.nodes is not None}
    extents = {key: Extent(b.nodes, b.until or np.inf) for key, b in given.items()}
    wanted = {key: b.wanted(near.model.target) for key, b in extended.items() if key not in given}
    lengths = {extended[key].until or near.crossing for key in wanted}
    if lengths:
        extents |= emitters.extents_for(wanted, max(lengths))
    doubts = _too_near({key: b for key, b in given.items() if b.target and b.until}, emitters)
    notes += doubts
    found = replace(layered, extents=extents, doubts=layered.doubts + doubts)
    if extended and memory_needed(setup, near.stencil, found) > available_memory():
        nodes = {key: one.nodes for key, one in extents.items()}
        raise too_large(near.lattice.shape, nodes, near.stencil.components, np.dtype(setup.dtype).itemsize)
    return found


def _too_near(given: Sides, emitters: Emitters) -> list[str]:
    """Return a warning for each number of nodes from whose end more may return than the target of their sides."""
    missed: dict[tuple[int, float, float], list[Key]] = {}
    predicted: dict[Key, float] = {}
    for until in sorted({b.until for b in given.values()}):
        wanted = {key: b.target for key, b in given.items() if b.until == until}
        fixed = {key: given[key].nodes for key in wanted}
        for key, one in emitters.extents_for(wanted, until, fixed).items():
            if one.predicted > wanted[key]:
                missed.setdefault((one.nodes, wanted[key], until), []).append(key)
                predicted[key] = one.predicted
    doubts = []
    for (nodes, target, until), keys in missed.items():
        try:
            enough = emitters.extents_for(dict.fromkeys(keys, target), until)
            remedy = f"{max(one.nodes for one in enough.values())} nodes would meet it"
        except InputError:
            remedy = "no domain that fits into memory meets it"
        doubts.append(
            f"extended domain of {nodes} nodes ({', '.join(side_name(*key) for key in keys)}): "
            f"up to {max(predicted[key] for key in keys):.1g} of the largest value may return, more than the target "
            f"{target:g}; {remedy}"
        )
    return doubts

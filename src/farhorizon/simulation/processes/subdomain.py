"""Subdomain of one process in a run: its own set-up on a box of the lattice; and which runs can be divided."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from farhorizon import kinds
from farhorizon.boundaries.plain import Neighbour
from farhorizon.boundaries.side import Side
from farhorizon.errors import InputError
from farhorizon.geometry.decomposition import Decomposition, decompose
from farhorizon.geometry.lattice import Lattice, check_any
from farhorizon.inputs.loads import BodyForce, Traction, force_density
from farhorizon.inputs.pressure import Pressure, pressing_force
from farhorizon.inputs.sources import Source
from farhorizon.inputs.specimens import check_held
from farhorizon.inputs.thermal_loads import ThermalLoad
from farhorizon.medium.stencil import Stencil
from farhorizon.models import LatticeModel
from farhorizon.simulation.processes.load_balance import cost_along, varies
from farhorizon.simulation.processes.process_group import ALONE, ProcessGroup
from farhorizon.simulation.recorders.recorder import Observer, Recorder, recorders_given
from farhorizon.simulation.setup.near_field import Extremes, NearField
from farhorizon.simulation.setup.reference_medium import ReferenceMedium
from farhorizon.simulation.setup.setup import Key, Setup, Sides, side_name, within_part, wrapping
from farhorizon.simulation.sides.layered_sides import LayeredSides, with_one_filter

#: Work of a node of a layer relative to one of the near field.
_LAYER = 2.0
#: Largest number of nodes for which layers are chosen for the data, because one process then examines all of them.
_CHOSEN = 4_000_000


@dataclass(frozen=True, eq=False)
class Subdomain:
    """What one process computes."""

    setup: Setup  # on a box of the lattice, with the time step and the layers of the whole run
    decomposition: Decomposition
    neighbours: dict[Key, int]  # rank that fills the halo at each side, -1 for none, along the axes that have any
    reference_medium: ReferenceMedium  # of the whole run
    extremes: Extremes  # of the near field on all processes
    boundary: dict[str, Side]  # sides of the whole run by name, with their layers

    @property
    def sides(self) -> Sides:
        """Sides of the whole run, with their layers."""
        return {key: self.boundary[side_name(*key)] for key in self.setup.sides}

    @property
    def given(self) -> dict[str, Any]:
        """Arguments of the run that a checkpoint of several processes stores: the sides as chosen."""
        return {"boundary": self.boundary}

    @property
    def words(self) -> str:
        """Number of boxes along the axes, in words: "2 x 2"."""
        return " x ".join(map(str, self.decomposition.topology))

    def wider(self, field: np.ndarray, width: int, group: ProcessGroup) -> tuple[Lattice, np.ndarray]:
        """Extend a field, whose last axes are those of the lattice, by `width` nodes where other processes have them,
        except across periodic sides; return the part of the lattice that it then covers, and the field. Boxes must not
        have fewer nodes.
        """
        lattice, boxes = self.setup.lattice, self.decomposition
        ends = boxes.ranges(group.number)
        for axis, (count, place) in enumerate(zip(boxes.topology, boxes.place(group.number), strict=True)):
            along = field.ndim - lattice.dim + axis
            below = -1 if place == 0 else self.neighbours[axis, -1]
            above = -1 if place == count - 1 else self.neighbours[axis, 1]
            low, high = group.halos(field, along, width, below, above)
            field = np.concatenate([part for part in (low, field, high) if part is not None], along)
            ends[axis] = ends[axis][0] - width * (low is not None), ends[axis][1] + width * (high is not None)
        return lattice.whole.part(ends), field

    def check_places(self, group: ProcessGroup) -> None:
        """Refuse bodies, tractions and specimens that have no node on any process."""
        part, sides = self.setup.lattice, self.setup.sides
        check_any(part.mask is None or group.any(bool(part.mask.any())))
        for number, specimen in enumerate(self.setup.specimens):
            key = f"specimen[{number}]"
            check_held(group.any(bool(specimen.nodes(part, key).any())), key)
        for number, load in enumerate(self.setup.loads):
            key = f"load[{number}]"
            if isinstance(load, Traction) and not group.any(bool(force_density(load, part, sides, key).any())):
                raise InputError("the traction meets no node", value=load.between, key=key, remedy="a wider load")


def subdomain_of(
    setup: Setup,
    reference_medium: ReferenceMedium,
    layered: LayeredSides,
    near: NearField,
    group: ProcessGroup,
    topology: Sequence[int] | None,
) -> Subdomain:
    """Return the subdomain of this process, given the set-up of the whole run, its sides with their layers, and its
    near field as far as it is known without examining the nodes; raises InputError as `decompose` does.
    """
    lattice, boxes = setup.lattice, boxes_of(setup, reference_medium.model, layered, group.size, topology, group)
    layered = replace(layered, layers=with_one_filter(layered.layers, near.rate_limit, near.dt, lattice.dim))
    ranges, place = boxes.ranges(group.number), boxes.place(group.number)
    boundary, sides = layered.as_given(), {}
    for (axis, side), given in layered.sides.items():
        name, count = side_name(axis, side), boxes.topology[axis]
        outer = place[axis] == (0 if side < 0 else count - 1)
        sides[name] = boundary[name] if count == 1 or (outer and not given.periodic) else Neighbour()
    part = lattice.part(ranges)

    def within(value: Any) -> Any:
        return within_part(value, lattice, part.within)

    of_part = replace(
        setup,
        lattice=part,
        boundary=sides,
        dt=near.dt,
        threads=group.threads() if setup.threads is None else setup.threads,
        initial={name: within(value) for name, value in (setup.initial or {}).items()},
        sources=tuple(
            replace(source, value=within(source.value)) if isinstance(source, Source) else within(source)
            for source in setup.sources
        ),
        specimens=tuple(replace(specimen, where=within(specimen.where)) for specimen in setup.specimens),
        loads=tuple(
            _load_on(part, load, number, setup, reference_medium.model) for number, load in enumerate(setup.loads)
        ),
    )
    neighbours = boxes.neighbours(group.number)
    subdomain = Subdomain(of_part, boxes, neighbours, reference_medium, near.extremes, boundary)
    subdomain.check_places(group)
    return subdomain


def boxes_of(
    setup: Setup,
    model: LatticeModel,
    layered: LayeredSides,
    processes: int,
    topology: Sequence[int] | None = None,
    group: ProcessGroup = ALONE,
    work: Sequence[np.ndarray] | None = None,
) -> Decomposition:
    """Return the boxes of `processes` processes, given the reference medium; `work` is the work along the axes, if
    already known.
    """
    lattice, stencil = setup.lattice, model.medium(setup.lattice.spacing, setup.lattice.dim)
    filtered = max((len(layer.taps) - 1 for layer in layered.layers.values() if layer.filtered), default=1)
    beyond, wraps = cost_beyond(layered, stencil, lattice), wrapping(layered.sides)
    work = cost_along(setup, model, beyond, group) if work is None else work
    return decompose(lattice.shape, processes, stencil.reach, beyond, wraps, topology, filtered, work)


def cost_beyond(layered: LayeredSides, stencil: Stencil, lattice: Lattice) -> dict[Key, float]:
    """Return the work beyond each side, as an equivalent number of nodes along its axis."""
    return {
        key: layered.width(key, stencil, lattice.spacing)
        + (_LAYER * layered.layers[key].columns if key in layered.layers else 0)
        for key in layered.sides
    }


def _load_on(part: Lattice, load: Any, number: int, setup: Setup, model: LatticeModel) -> Any:
    """Return a load on a part of the lattice; a pressure, which needs both sides of its faces, is converted to its
    forces.
    """
    lattice = setup.lattice
    if isinstance(load, Pressure):
        periodic = {axis: setup.sides[axis, -1].periodic for axis in range(lattice.dim)}
        force = pressing_force(load, part, model, setup.cracks, setup.rim, periodic, f"load[{number}]")
        return BodyForce(list(force), load.time)
    names = ("temperature", "expansion") if isinstance(load, ThermalLoad) else ("value",)
    return replace(load, **{name: within_part(getattr(load, name), lattice, part.within) for name in names})


def check_divisible(setup: Setup, observers: Sequence[Observer]) -> None:
    """Refuse, with InputError and before any work, what cannot run on several processes, recorders included."""
    recorders = [observer for observer in observers if isinstance(observer, Recorder) and not observer.shared]
    damped = any(side.damped for side in setup.sides.values())
    refused = [
        (f"recorders of the kind {type(recorders[0]).__name__}" if recorders else "", "observe", bool(recorders)),
        (
            "solids that heat as they are deformed, whose heat a second run needs at each step,",
            "load",
            setup.heat is not None and setup.heat.coupled,
        ),
        ("impactors, whose forces come from nodes of all processes,", "load", bool(setup.impactors)),
        ("sponges beside media that vary", "boundary", varies(setup) and damped),
        ("slips of faces with friction", "model.friction", bool(getattr(setup.model, "friction", 0) and setup.cracks)),
        ("load steps", "dt", setup.load_steps is not None),
        ("surfaces that are corrected", "model.surface", setup.model.stiffens_surfaces),
    ]
    for what, key, given in refused:
        if given:
            raise InputError(f"{what} are not computed on several processes yet", key=key, remedy="one process")
    for at, side in setup.sides.items():
        if side.alone:
            raise InputError(
                f"sides of the kind {side.label} are not computed on several processes yet: {side.alone}",
                key=f"boundary.{side_name(*at)}",
                limit="LatticePML, Sponge, Fixed, Free, Impedance, Periodic",
                remedy="LatticePML, or one process",
            )


def check_choosable(setup: Setup) -> None:
    """Refuse, with InputError and before any work, layers that would be chosen for more data than the first process can
    hold.
    """
    nodes = int(np.prod(setup.lattice.shape))
    chooses = any(side.stretched and side.profile is None and side.open_ended for side in setup.sides.values())
    if chooses and nodes > _CHOSEN:
        raise InputError(
            "layers choose their thickness by looking at all data, which no process has on so large a lattice",
            value=f"{nodes:.3g} nodes",
            limit=f"{_CHOSEN:.3g}",
            key="boundary",
            remedy="nodes=..., as chosen for a smaller lattice: 'farhorizon check' shows them",
        )


def check_given(setup: Setup, observe: Any, topology: Any, group: ProcessGroup) -> list[int] | None:
    """Return the checked topology of a run, and refuse, with InputError, arguments that differ between processes. Each
    may have the threads of its machine, and observers of its own, except for recorders.
    """
    given = {name: value for name, value in setup.arguments.items() if name != "threads"}
    group.alike({**given, "topology": topology, "observe": recorders_given(observe)})
    return checked_topology(topology)


def checked_topology(topology: Any) -> list[int] | None:
    """Return the number of boxes along each axis; InputError if it is not one."""
    if topology is None:
        return None
    return [kinds.integer(n, "run.topology", least=1) for n in kinds.sequence(topology, "run.topology", "numbers")]

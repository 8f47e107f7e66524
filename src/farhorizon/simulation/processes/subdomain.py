"""Share of one process in a run: its own set-up on a box of the lattice."""

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
from farhorizon.simulation.processes.load_balance import cost_along
from farhorizon.simulation.processes.process_group import ALONE, ProcessGroup
from farhorizon.simulation.recorders.recorder import Observer, Recorder, recorders_given
from farhorizon.simulation.setup.near_field import Extremes, NearField
from farhorizon.simulation.setup.reference_medium import ReferenceMedium
from farhorizon.simulation.setup.setup import Key, Setup, Sides, side_name, within_part, wrapping
from farhorizon.simulation.sides.layered_sides import LayeredSides
from farhorizon.simulation.sides.layers import with_one_filter

#: Work of a node of a layer relative to one of the near field.
_LAYER = 2.0
#: Largest number of nodes for which layers are chosen for the data, because one process then examines all of them.
_CHOSEN = 4_000_000


@dataclass(frozen=True, eq=False)
class Subdomain:
    """What one process computes.

    Attributes
    ----------
    setup : Setup
        Set-up on a box of the lattice, with the time step and the layers of the whole run.
    decomposition : Decomposition
    neighbours : dict of (axis, side) to int
        Process that fills the halo at each side, -1 for none, for the axes along which any does.
    reference_medium : ReferenceMedium
        Uniform medium relative to which that of the whole run varies.
    whole : Extremes
        Extremes of the near field on all processes.
    boundary : dict of str to Side
        Sides of the whole run by name, with their layers.
    """

    setup: Setup
    decomposition: Decomposition
    neighbours: dict[Key, int]
    reference_medium: ReferenceMedium
    whole: Extremes
    boundary: dict[str, Side]

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

    def wider(self, field: np.ndarray, width: int, team: ProcessGroup) -> tuple[Lattice, np.ndarray]:
        """Extend a field by `width` nodes where other processes have them, except across periodic sides; return the
        part of the lattice that it then covers, and the field.

        Parameters
        ----------
        field : ndarray
            Its last axes are those of the lattice.
        width : int
            At most the number of nodes of a box.
        team : ProcessGroup
            All processes, which must call it together.
        """
        lattice, boxes = self.setup.lattice, self.decomposition
        ends = boxes.ranges(team.number)
        for axis, (count, place) in enumerate(zip(boxes.topology, boxes.place(team.number), strict=True)):
            along = field.ndim - lattice.dim + axis
            outer = {-1: place == 0, 1: place == count - 1}
            beside = {side: -1 if outer[side] else self.neighbours[axis, side] for side in (-1, 1)}
            edges = {-1: np.take(field, range(width), along), 1: np.take(field, range(-width, 0), along)}
            low, high = (team.send_receive(edges[-side], beside[-side], beside[side]) for side in (-1, 1))
            field = np.concatenate([one for one in (low, field, high) if one is not None], along)
            ends[axis] = ends[axis][0] - width * (low is not None), ends[axis][1] + width * (high is not None)
        return lattice.whole.part(ends), field

    def check_places(self, team: ProcessGroup) -> None:
        """Refuse bodies, tractions and specimens that have no node on any process."""
        part, sides = self.setup.lattice, self.setup.sides
        check_any(part.mask is None or team.any(bool(part.mask.any())))
        for number, specimen in enumerate(self.setup.specimens):
            key = f"specimen[{number}]"
            check_held(team.any(bool(specimen.nodes(part, key).any())), key)
        for number, load in enumerate(self.setup.loads):
            key = f"load[{number}]"
            if isinstance(load, Traction) and not team.any(bool(force_density(load, part, sides, key).any())):
                raise InputError("the traction meets no node", value=load.between, key=key, remedy="a wider load")


def subdomain_of(
    setup: Setup,
    reference_medium: ReferenceMedium,
    layered: LayeredSides,
    near: NearField,
    team: ProcessGroup,
    topology: Sequence[int] | None,
) -> Subdomain:
    """Return the share of this process.

    Parameters
    ----------
    setup : Setup
        Set-up of the whole run.
    reference_medium : ReferenceMedium
    layered : LayeredSides
        Its sides with their layers.
    near : NearField
        Near field of the whole run, as far as it is known without examining the nodes.
    team : ProcessGroup
    topology : sequence of int, optional
        Number of boxes along each axis.

    Raises
    ------
    InputError
        As for `farhorizon.geometry.decomposition.decompose`.
    """
    lattice, boxes = setup.lattice, boxes_of(setup, reference_medium.model, layered, team.size, topology, team)
    layered = replace(layered, layers=with_one_filter(layered.layers, near.rate_limit, near.dt, lattice.dim))
    ranges, place = boxes.ranges(team.number), boxes.place(team.number)
    whole_sides, sides = _chosen(layered), {}
    for (axis, side), boundary in layered.sides.items():
        outer = place[axis] == (0 if side < 0 else boxes.topology[axis] - 1)
        alone = boxes.topology[axis] == 1
        own_side = alone or (outer and not boundary.periodic)
        sides[side_name(axis, side)] = whole_sides[side_name(axis, side)] if own_side else Neighbour()
    part = lattice.part(ranges)

    def own(value: Any) -> Any:
        return within_part(value, lattice, part.within)

    mine = replace(
        setup,
        lattice=part,
        boundary=sides,
        dt=near.dt,
        threads=team.threads() if setup.threads is None else setup.threads,
        initial={name: own(value) for name, value in (setup.initial or {}).items()},
        sources=tuple(
            replace(one, value=own(one.value)) if isinstance(one, Source) else own(one) for one in setup.sources
        ),
        specimens=tuple(replace(one, where=own(one.where)) for one in setup.specimens),
        loads=tuple(
            _load_on(part, one, number, setup, reference_medium.model) for number, one in enumerate(setup.loads)
        ),
    )
    subdomain = Subdomain(mine, boxes, boxes.neighbours(team.number), reference_medium, near.extremes, whole_sides)
    subdomain.check_places(team)
    return subdomain


def _chosen(layered: LayeredSides) -> dict[str, Side]:
    """Return the sides by name, with the layers as chosen."""
    found = {}
    for key, side in layered.sides.items():
        layer = layered.layers.get(key)
        found[side_name(*key)] = side if layer is None else replace(side, nodes=layer.columns, profile=layer)
    return found


def boxes_of(
    setup: Setup,
    model: LatticeModel,
    layered: LayeredSides,
    processes: int,
    topology: Sequence[int] | None = None,
    team: ProcessGroup = ALONE,
    work: Sequence[np.ndarray] | None = None,
) -> Decomposition:
    """Return the boxes of `processes` processes, see `subdomain_of`; `work` is the work along the axes, if already
    known.
    """
    lattice, stencil = setup.lattice, model.medium(setup.lattice.spacing, setup.lattice.dim)
    filtered = max((len(layer.taps) - 1 for layer in layered.layers.values() if layer.filtered), default=1)
    beyond, wraps = cost_beyond(layered, stencil, lattice), wrapping(layered.sides)
    work = cost_along(setup, model, beyond, team) if work is None else work
    return decompose(lattice.shape, processes, stencil.reach, beyond, wraps, topology, filtered, work)


def cost_beyond(layered: LayeredSides, stencil: Stencil, lattice: Lattice) -> dict[Key, float]:
    """Return the cost of each side, as an equivalent number of nodes along its axis."""
    found = {}
    for key in layered.sides:
        layer = layered.layers.get(key)
        found[key] = layered.width(key, stencil, lattice.spacing) + (0 if layer is None else _LAYER * layer.columns)
    return found


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


def _missing(what: str, key: str) -> InputError:
    return InputError(f"{what} are not computed on several processes yet", key=key, remedy="one process")


def check_divisible(setup: Setup, observers: Sequence[Observer]) -> None:
    """Refuse, before any work, what cannot run on several processes, recorders included.

    Raises
    ------
    InputError
    """
    recorders = [one for one in observers if isinstance(one, Recorder) and not one.shared]
    varies = _varies(setup)
    refused = [
        (f"recorders of the kind {type(recorders[0]).__name__}" if recorders else "", "observe", bool(recorders)),
        (
            "solids that heat as they are deformed, whose heat a second run needs at each step,",
            "load",
            setup.heat is not None and setup.heat.coupled,
        ),
        ("sponges beside media that vary", "boundary", varies and any(b.damped for b in setup.sides.values())),
    ]
    for what, key, given in refused:
        if given:
            raise _missing(what, key)
    for at, side in setup.sides.items():
        if why := _of_one_process(side):
            raise InputError(
                f"sides of the kind {side.label} are not computed on several processes yet: {why}",
                key=f"boundary.{side_name(*at)}",
                limit="LatticePML, Sponge, Fixed, Free, Periodic",
                remedy="LatticePML, or one process",
            )


def _of_one_process(side: Side) -> str:
    """Return why a side works on a single process only, or ""."""
    if side.exact:
        return "they sum over the whole past of the nodes at the end, step by step"
    if side.closing:
        return "they follow from nodes along the outline, which several processes have"
    if side.derivatives:
        return "stretched derivatives are remembered on all nodes beyond them, cut across, too"
    if side.extended or side.undecided:
        return "the domain grows by what all data need until the end of the run"
    return ""


def check_choosable(setup: Setup) -> None:
    """Refuse, before any work, layers that would be chosen for more data than the first process can hold.

    Raises
    ------
    InputError
    """
    nodes = int(np.prod(setup.lattice.shape))
    if chooses(setup.sides) and nodes > _CHOSEN:
        raise InputError(
            "layers choose their thickness by looking at all data, which no process has on so large a lattice",
            value=f"{nodes:.3g} nodes",
            limit=f"{_CHOSEN:.3g}",
            key="boundary",
            remedy="nodes=..., as chosen for a smaller lattice: 'farhorizon check' shows them",
        )


def _varies(setup: Setup) -> bool:
    return bool(setup.model.varying) or setup.coefficient is not None


def chooses(sides: Sides) -> list[Key]:
    """Return the sides whose layers are chosen for the data and the length of the run."""
    return [key for key, side in sides.items() if side.stretched and side.profile is None and side.open_ended]


def check_given(setup: Setup, observe: Any, topology: Any, team: ProcessGroup) -> list[int] | None:
    """Return the checked topology of a run, and refuse arguments that differ between processes. Each may have the
    threads of its machine, and observers of its own, except for recorders.

    Raises
    ------
    InputError
    """
    given = {name: value for name, value in setup.arguments.items() if name != "threads"}
    team.alike({**given, "topology": topology, "observe": recorders_given(observe)})
    return checked_topology(topology)


def checked_topology(topology: Any) -> list[int] | None:
    """Return the number of boxes along each axis; InputError if it is not one."""
    if topology is None:
        return None
    return [kinds.integer(n, "run.topology", least=1) for n in kinds.sequence(topology, "run.topology", "numbers")]

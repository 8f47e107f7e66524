"""The share of one process in a run: a set-up of its own on a box of the lattice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from farhorizon import kinds
from farhorizon.boundaries.auto import Auto
from farhorizon.boundaries.neighbour import Neighbour
from farhorizon.boundaries.side import Side
from farhorizon.errors import InputError
from farhorizon.geometry.decomposition import Decomposition, decompose
from farhorizon.geometry.lattice import Lattice
from farhorizon.inputs.incidence import Incident
from farhorizon.inputs.loads import Traction
from farhorizon.inputs.sources import Source
from farhorizon.inputs.thermal_loads import ThermalLoad
from farhorizon.medium.stencil import Stencil
from farhorizon.simulation.recorder import Observer, Recorder
from farhorizon.simulation.setup import Key, Setup, Sides, side_name
from farhorizon.simulation.surroundings import Surroundings
from farhorizon.simulation.team import Team

#: Work of a node of a layer over that of one of the near field.
_LAYER = 2.0
#: Nodes of a lattice whose layers are chosen for its data: one process looks at the whole.
_CHOSEN = 4_000_000


@dataclass(frozen=True, eq=False)
class Share:
    """What one process computes.

    Attributes
    ----------
    setup : Setup
        On a box of the lattice, with the time step and the layers of the whole.
    decomposition : Decomposition
    neighbours : dict of (axis, side) to int
        Processes that fill the halo, -1 for none; of the axes along which any does.
    good_for : float
        Length of the run that the layers were chosen for.
    """

    setup: Setup
    decomposition: Decomposition
    neighbours: dict[Key, int]
    good_for: float

    @property
    def words(self) -> str:
        """Numbers of boxes along the axes, as they are written: "2 x 2"."""
        return " x ".join(map(str, self.decomposition.topology))

    def check_length(self, until: float) -> None:
        """Refuse a run that is longer than its layers were chosen for."""
        if until > self.good_for * (1 + 1e-9):
            raise InputError(
                "the layers were chosen for a shorter run, and several processes cannot choose anew",
                value=until,
                limit=f"{self.good_for:.6g}",
                key="boundary",
                remedy="LatticePML(until=...)",
            )


def share_of(setup: Setup, around: Surroundings, dt: float, team: Team, topology: Sequence[int] | None) -> Share:
    """The share of this process.

    Parameters
    ----------
    setup : Setup
        Of the whole run.
    around : Surroundings
        Its sides with their layers.
    dt : float
    team : Team
    topology : sequence of int, optional
        Boxes along each axis.

    Raises
    ------
    InputError
        As `farhorizon.geometry.decomposition.decompose`.
    """
    lattice, boxes = setup.lattice, boxes_of(setup, around, team.size, topology)
    ranges, place = boxes.ranges(team.number), boxes.place(team.number)
    sides: dict[str, Side] = {}
    for (axis, side), boundary in around.sides.items():
        outer = place[axis] == (0 if side < 0 else boxes.topology[axis] - 1)
        alone = boxes.topology[axis] == 1
        chosen = around.layers.get((axis, side))
        kept = boundary if chosen is None else replace(boundary, nodes=chosen.columns, profile=chosen)
        sides[side_name(axis, side)] = kept if alone or (outer and not boundary.periodic) else Neighbour()
    part = lattice.part(ranges)
    within = tuple(slice(first, last) for first, last in ranges)

    def own(value: Any) -> Any:
        return _part(value, lattice, within)

    mine = replace(
        setup,
        lattice=part,
        boundary=sides,
        dt=dt,
        threads=team.threads() if setup.threads is None else setup.threads,
        initial={name: own(value) for name, value in (setup.initial or {}).items()},
        sources=tuple(
            replace(one, value=own(one.value)) if isinstance(one, Source) else own(one) for one in setup.sources
        ),
        loads=tuple(replace(one, value=own(one.value)) for one in setup.loads if not isinstance(one, ThermalLoad)),
    )
    good_for = min((found.until for found in around.thickness.values()), default=np.inf)
    return Share(mine, boxes, boxes.neighbours(team.number), good_for)


def boxes_of(
    setup: Setup, around: Surroundings, processes: int, topology: Sequence[int] | None = None
) -> Decomposition:
    """The boxes of so many processes; see `share_of`."""
    lattice, stencil = setup.lattice, setup.model.medium(setup.lattice.spacing, setup.lattice.dim)
    filtered = max((len(layer.taps) - 1 for layer in around.layers.values() if layer.damping.any()), default=1)
    beyond, wraps = work_beyond(around, stencil, lattice), wrapping(around.sides)
    return decompose(lattice.shape, processes, stencil.reach, beyond, wraps, topology, filtered)


def wrapping(sides: Sides) -> frozenset[int]:
    """Axes that close on themselves."""
    return frozenset(axis for (axis, _), side in sides.items() if side.periodic)


def work_beyond(around: Surroundings, stencil: Stencil, lattice: Lattice) -> dict[Key, float]:
    """What sides cost, in nodes of the lattice along their axes."""
    found = {}
    for key in around.sides:
        layer = around.layers.get(key)
        found[key] = around.width(key, stencil, lattice.spacing) + (0 if layer is None else _LAYER * layer.columns)
    return found


def _part(value: Any, lattice: Lattice, within: tuple[slice, ...]) -> Any:
    """Of an array over the lattice, of one or more components, what lies in a box; all else as it is."""
    if isinstance(value, np.ndarray) and value.shape[-lattice.dim :] == lattice.shape:
        place: tuple[Any, ...] = (..., *within)
        return value[place]
    if isinstance(value, list | tuple):
        return type(value)(_part(one, lattice, within) for one in value)
    return value


def _missing(what: str, key: str) -> InputError:
    return InputError(f"{what} are not computed on several processes yet", key=key, remedy="one process")


def check_shareable(setup: Setup, observers: Sequence[Observer]) -> None:
    """Refuse what does not run on several processes, before any work, recorders among it.

    Raises
    ------
    InputError
    """
    model, lattice = setup.model, setup.lattice
    recorders = [one for one in observers if isinstance(one, Recorder) and not one.shared]
    refused = [
        (f"recorders of the kind {type(recorders[0]).__name__}" if recorders else "", "observe", bool(recorders)),
        ("thermal loads", "load", setup.heat is not None),
        ("bonds that are nonlinear or break", "model", model.bond_law is not None),
        ("corrosion and its specimens", "model", model.dissolution is not None),
        ("drag", "model.drag", bool(model.drag)),
        ("constants that vary from node to node", "model", bool(model.varying)),
        ("cracks", "crack", len(setup.cracks) > 0),
        ("coefficients of bonds", "coefficient", setup.coefficient is not None),
        ("conditions on nodes", "constraint", len(setup.constraints) > 0),
        ("bodies and windows", "lattice", lattice.mask is not None),
        ("balances", "output.balance", setup.balance),
        ("incident waves", "incident", any(isinstance(one, Incident) for one in setup.sources)),
        ("forces on sides", "load", any(isinstance(one, Traction) for one in setup.loads)),
    ]
    for what, key, given in refused:
        if given:
            raise _missing(what, key)
    for at, side in setup.sides.items():
        if side.exact or side.closing or side.extended or side.derivatives or isinstance(side, Auto):
            raise InputError(
                f"sides of the kind {side.label} are not computed on several processes yet",
                key=f"boundary.{side_name(*at)}",
                limit="LatticePML, Sponge, Fixed, Free, Periodic",
                remedy="LatticePML, or one process",
            )
        if not side.bonded and not model.bonds and model.mechanical:
            raise _missing("free sides of state-based and correspondence materials", f"boundary.{side_name(*at)}")


def check_choosable(setup: Setup, around: Surroundings) -> None:
    """Refuse layers that choose themselves for data that no process can hold.

    Raises
    ------
    InputError
    """
    choosing = chooses(around)
    if choosing and int(np.prod(setup.lattice.shape)) > _CHOSEN:
        raise InputError(
            "layers choose their thickness by looking at all data, which no process has on so large a lattice",
            value=f"{int(np.prod(setup.lattice.shape)):.3g} nodes",
            limit=f"{_CHOSEN:.3g}",
            key=f"boundary.{side_name(*choosing[0])}",
            remedy="nodes=..., as a smaller lattice chooses them: 'farhorizon check' tells",
        )


def chooses(around: Surroundings) -> list[Key]:
    """Sides whose layers choose themselves for the data and the length of the run."""
    return [key for key, side in around.sides.items() if side.stretched and side.profile is None and side.open_ended]


def checked_topology(topology: Any) -> list[int] | None:
    """Boxes along each axis; InputError for what is none."""
    if topology is None:
        return None
    return [kinds.integer(n, "run.topology", least=1) for n in kinds.sequence(topology, "run.topology", "numbers")]

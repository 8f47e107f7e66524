"""The parts of a run, put together from its set-up."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from farhorizon.boundaries import Closure, ExactEnds, Side
from farhorizon.engine.settings import set_drag
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Cut
from farhorizon.inputs.incidence import Incidence
from farhorizon.inputs.outside import Beyond, changes
from farhorizon.inputs.prescribed import Prescribed
from farhorizon.medium.force_states import ForceStates
from farhorizon.medium.variation import Variation
from farhorizon.simulation.breaking import Breaking
from farhorizon.simulation.closing import close, exact_ends_of
from farhorizon.simulation.cuts import CutBonds
from farhorizon.simulation.drives import (
    Arriving,
    Drive,
    Drives,
    check_signals,
    given,
    incidence,
    incident_waves,
    jumps,
    signals,
    split_drives,
)
from farhorizon.simulation.extension import Emitters, extend
from farhorizon.simulation.grid import Grid, choose_margins, make_grid, states_of
from farhorizon.simulation.host import looked_at, node_factor, varied
from farhorizon.simulation.laws import of_field
from farhorizon.simulation.layers import undesigned, with_one_filter
from farhorizon.simulation.near_field import NearField, extremes_of, near_field
from farhorizon.simulation.of_field import field_drives
from farhorizon.simulation.setup import Key, Setup, Sides, side_name
from farhorizon.simulation.share import Share, check_choosable, check_shareable, share_of
from farhorizon.simulation.solid_and_liquid import SolidAndLiquid
from farhorizon.simulation.start import Start, check_range, drifting, own_step, start_of
from farhorizon.simulation.stiffening import least_stiffening, stiffening
from farhorizon.simulation.surfaces import check_conditions, rest_and_damp
from farhorizon.simulation.surroundings import Surroundings, by_target, check_memory
from farhorizon.simulation.team import ALONE, Team
from farhorizon.simulation.validation import check_entrances, check_model, check_repeats, check_stencil, check_variation
from farhorizon.simulation.warm_sides import heat_front, warm_margins, warm_sides

T = TypeVar("T")

#: Note on cracks whose faces can meet and that run into sides beyond which they cannot.
_STICKS = (
    "closed cracks stick: contact acts along the bonds, without a law of friction, so that a crack under pressure does "
    "not slide (it transmits all of an S pulse; one without pressure 0.65 to 0.85 of its amplitude) and wing cracks do "
    "not form; with contact = false faces slide, but pass through each other"
)
_STAYS_OPEN = (
    "the faces of a crack do not meet within one reach of {} and beyond: compression is reflected there; "
    "Extended continues cracks whose faces meet, contact = false disables contact"
)


@dataclass(frozen=True, eq=False)
class Whole:
    """The whole near field and its sides, which recorders use on each of several processes that have parts of a run.

    Attributes
    ----------
    near : NearField
    sides : dict of (axis, side) to Side
    team : Team
        The processes, which call methods jointly.
    """

    near: NearField
    sides: Sides
    team: Team = ALONE

    def numbers(self, inside: np.ndarray, part: Lattice) -> np.ndarray:
        """Return the flat indices in the whole lattice, in order, of the nodes of a mask of which each process has its
        part.
        """
        own = np.argwhere(inside) + np.array(part.first)
        flat = np.ravel_multi_index(tuple(own.T), self.near.lattice.shape)
        return np.sort(np.concatenate(self.team.gather(flat)))


@dataclass(frozen=True, eq=False)
class Parts:
    """The parts of a run.

    Attributes
    ----------
    near : NearField
    around : Surroundings
    autos : dict of (axis, side) to Side
        The sides that leave the choice between a layer, which they are until the length of the run is known, and an
        extended domain.
    beyond : Beyond
        Checks of data and sources beyond absorbing sides; its `notes` are those of the set-up.
    start : Start
    drives : Drives
    emitters : Emitters
    grid : Grid
    phases : SolidAndLiquid or None
        The phases of a corrosion.
    closure : Closure or None
        The conditions along the outline of the near field.
    cuts : CutBonds
    breaking : Breaking or None
        Bonds that are nonlinear or break.
    held : ndarray of int
        Places in a level whose values never change.
    ends : ExactEnds or None
    incident : list of Incidence
    driving : list of Drive
        All that drives the near field: sources and loads, conditions, incident waves, what depends on the field.
    of_field : list of (str, Drive)
        The latter, with their names.
    whole : Whole
        The near field with its sides; on several processes, the parts given to recorders have that of all processes.
    warm : frozenset of (axis, side)
        The sides beyond which a temperature continues with the displacements.
    """

    near: NearField
    around: Surroundings
    autos: dict[Key, Side]
    beyond: Beyond
    start: Start
    drives: Drives
    emitters: Emitters
    grid: Grid
    phases: SolidAndLiquid | None
    closure: Closure | None
    cuts: CutBonds
    breaking: Breaking | None
    held: np.ndarray
    ends: ExactEnds | None
    incident: list[Incidence]
    driving: list[Drive]
    of_field: list[tuple[str, Drive]]
    whole: Whole
    warm: frozenset[Key]

    def at(self, values: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """Return values at some nodes, on all processes, each of which has the values of its part.

        Parameters
        ----------
        values : ndarray
            Its last axes are those of the part of the lattice.
        nodes : ndarray of int
            Flat indices of nodes in the whole lattice.
        """
        part = self.near.lattice
        inside, own = part.own(nodes.ravel())
        mine = values.reshape(*values.shape[: values.ndim - part.dim], -1)[..., own]
        found = self.whole.team.completed(mine, np.flatnonzero(inside), nodes.size, mine.ndim - 1)
        return found.reshape(*found.shape[:-1], *nodes.shape)

    def hides(self, nodes: np.ndarray) -> np.ndarray:
        """Return which nodes of the whole lattice (flat indices) have no values of the body or window."""
        hidden = self.near.hidden
        return self.at(np.zeros(self.near.lattice.shape) if hidden is None else hidden.astype(float), nodes) > 0


@dataclass(frozen=True, eq=False)
class Survey:
    """The medium, sides and sources of a run, before a grid is made.

    Attributes
    ----------
    setup : Setup
        Set-up with a uniform model.
    autos : dict of (axis, side) to Side
        As in `Parts`.
    near : NearField
    around : Surroundings
    waves : list of Arriving
    sources : list of (str, source)
        Sources, each with its name in messages.
    """

    setup: Setup
    autos: dict[Key, Side]
    near: NearField
    around: Surroundings
    waves: list[Arriving]
    sources: list[tuple[str, Any]]


def survey(whole: Setup, stiffer: float = 1.0, team: Team = ALONE, share: Share | None = None) -> Survey:
    """Determine the medium, the sides and the sources of a set-up; see `assemble`."""
    setup, variation = varied(whole) if share is None else (share.host.uniform(whole), share.host.beside(whole))
    of_whole = None if share is None else share.whole
    lattice, model = setup.lattice, setup.model
    autos = {key: b for key, b in setup.sides.items() if b.undecided}
    sides = setup.sides | {key: b.as_layer(None, model.target) for key, b in autos.items()}
    check_model(setup, sides)
    stencil = model.medium(lattice.spacing, lattice.dim)
    check_stencil(setup, sides, stencil)
    check_repeats(setup, sides, stencil)
    check_memory(setup, stencil, by_target(setup, sides, stencil))
    coefficient = node_factor(setup)
    variation = variation.times(coefficient)
    check_variation(sides, variation, stencil)
    check_entrances(whole, sides, stencil)
    near = near_field(setup, sides, stencil, variation, coefficient, stiffer, team, of_whole)
    check_signals(setup, near)
    waves = incident_waves(setup, near, sides if share is None else share.sides, _cuts(setup), team)
    sources = given(setup, near, sides)
    return Survey(setup, autos, near, _with_layers(setup, near, sides), waves, sources)


def assemble(setup: Setup, margins_given: Mapping[Key, int] | None = None) -> Parts:
    """Return the parts of a run on one process; see `assembled`."""
    return _stiffened(
        setup, ALONE, lambda stiffer: assembled(setup, stiffer, margins_given=margins_given), lambda parts: parts
    )


def assemble_shared(
    setup: Setup, team: Team, topology: Sequence[int] | None, observers: Sequence[Any]
) -> tuple[Share, Whole, Parts]:
    """Return the share of this process in a run, the whole for recorders, and the parts; see `assemble`, `shared`."""
    check_shareable(setup, observers)
    check_choosable(setup)

    def built(stiffer: float) -> tuple[Share, Whole, Parts]:
        share, whole = shared(setup, team, topology, stiffer)
        return share, whole, assembled(share.setup, stiffer, team, share)

    return _stiffened(setup, team, built, lambda found: found[2])


def _stiffened(setup: Setup, team: Team, built: Callable[[float], T], parts_of: Callable[[T], Parts]) -> T:
    """Build a run, and build it again if it turns out to be stiffer than the medium.

    Parameters
    ----------
    setup : Setup
    team : Team
    built : callable
        Builds it for a stiffening; of several processes all fail if one does.
    parts_of : callable
        Returns the parts among its results.
    """
    least = least_stiffening(setup)
    found = built(least)
    parts = parts_of(found)
    stiffer = stiffening(parts.near, parts.grid, team, least)
    if stiffer == least:
        return found
    del found, parts  # so that only one is in memory
    return built(stiffer)


def assembled(
    whole: Setup,
    stiffer: float = 1.0,
    team: Team = ALONE,
    share: Share | None = None,
    margins_given: Mapping[Key, int] | None = None,
) -> Parts:
    """Return the parts of a run; cheap checks of the set-up come before expensive ones.

    Parameters
    ----------
    whole : Setup
    stiffer : float
        Largest squared frequency over that of the medium with all its bonds: the `stiffening` of a trial.
    team : Team
        The processes that compute the run.
    share : Share, optional
        The share of this process; its set-up is `whole`.
    margins_given : mapping of (axis, side) to int, optional
        Nodes of the core beyond some sides of the near field, in place of those that are chosen.

    Raises
    ------
    InputError
        Anything that cannot be computed.
    """
    found = survey(whole, stiffer, team, share)
    setup, near, sides = found.setup, found.near, found.around.sides
    beyond = _look_beyond(found, team)
    start = start_of(setup, near, sides, beyond)
    check_range(start, setup.dtype, team)
    beyond.notes.extend(drifting(near, sides, setup.dtype))
    beyond.check_cracks(_cuts(setup), near.stencil.reach)
    drives = split_drives(found.sources, near, beyond)
    driving = drives.sources + [drive for _, drive in near.conditions.sources]
    warm = frozenset() if share is not None else warm_sides(setup, sides, near.dt)
    everywhere = bool(found.waves or drives.unsplit or warm or of_field(setup))  # a hot spot may be anywhere
    emitters = Emitters(near, sides, start, tuple(driving), everywhere, partial(heat_front, setup, warm))
    around = extend(setup, found.around, emitters, beyond.notes)

    states = states_of(setup, sides, near.variation.moduli is not None)
    margins = _margins(found, around, start, states, warm, team) | dict(margins_given or {})
    check_conditions(near, sides, margins, beyond.notes)
    link, neighbours = (None, None) if share is None else (team.link, share.neighbours)
    grid = make_grid(setup, near, around, margins, states, link, neighbours, bool(warm))
    phases = _phases(setup, near, start, grid, driving)
    closure = close(near, sides, grid, start.solid)
    free_rim = setup.lattice.body is not None and setup.rim == "free"
    cuts = CutBonds(near, around, grid, closure, free_rim, beyond.notes)
    law = setup.model.bond_law
    incident = [incidence(one, near, sides, beyond.notes) for one in found.waves]
    beyond.notes.extend(own_step(setup, near, bool(incident or (near.varies and signals(setup)))))
    regions = [one.region for one in incident]
    breaking = None if law is None else Breaking(law, near, sides, grid, cuts, regions, team)
    if law is not None and law.nonlinear and incident:
        beyond.notes.append(
            "an incident wave is one of linear bonds: with nonlinear ones a fraction of it about as large as its "
            "strain leaks from its box"
        )
    if breaking is not None and incident and not team.largest(float(np.prod(breaking.extent))):
        beyond.notes.append("the boxes of the incident waves have no node in common, so no bond will break")
    _set_engine(setup, grid, margins)
    _cut(setup, cuts, breaking, beyond.notes)
    held = rest_and_damp(near, around, cuts, setup.rim == "fixed")
    ends = exact_ends_of(near, sides, grid)
    driving += [(None, lambda t, one=one: one.source(t) / setup.model.source_factor) for one in incident]
    of_the_field = field_drives(setup, near, sides, grid, team)
    driving += [drive for _, drive in of_the_field]
    return Parts(
        near,
        around,
        found.autos,
        beyond,
        start,
        drives,
        emitters,
        grid,
        phases,
        closure,
        cuts,
        breaking,
        held,
        ends,
        incident,
        driving,
        of_the_field,
        Whole(near, around.sides),
        warm,
    )


def _look_beyond(found: Survey, team: Team) -> Beyond:
    """Prepare the checks beyond absorbing sides, with all notes so far and those on a medium that varies there."""
    setup, near, around = found.setup, found.near, found.around
    lattice, stencil = setup.lattice, near.stencil
    depth = around.depth(stencil, lattice.spacing, lattice.shape)
    beyond = Beyond(lattice, around.sides, setup.model.target, depth, near.closed, team.largest)
    beyond.notes += near.conditions.notes + around.doubts + jumps(setup, near)
    if near.growth:
        beyond.notes.append(f"the medium grows by itself, e-fold in t = {1 / near.growth:.3g}, and so do all errors")
    name = "the coefficient" if near.factor is near.coefficient else "the stiffness"
    for values, called in ((near.factor, name), (near.density, "the density"), (lattice.existing, "the body")):
        if values is not None:
            beyond.notes += changes(values.astype(float), called, beyond.targets, stencil.reach)
    extended = [key for key in beyond.targets if around.sides[key].extended]  # bonds also break beyond these sides
    if near.variation.strength is not None and extended:
        strength = np.broadcast_to(near.variation.strength, lattice.shape).astype(float)
        beyond.notes += changes(strength, "the critical stretch", extended, stencil.reach)
    return beyond


def _margins(
    found: Survey, around: Surroundings, start: Start, states: ForceStates | None, warm: frozenset[Key], team: Team
) -> dict[Key, int]:
    """Return the number of nodes of the core beyond each side of the near field."""
    setup, near = found.setup, found.near
    medium = [start.solid, *near.variation.of_waves]
    if setup.lattice.existing is not None:
        medium.append(setup.lattice.existing)
    margins = choose_margins(near, around, (start.u, start.v), medium, _cuts(setup), states, team)
    return margins | warm_margins(setup, warm, around)


def _phases(setup: Setup, near: NearField, start: Start, grid: Grid, driving: Sequence[Drive]) -> SolidAndLiquid | None:
    """Return the phases of a corrosion, placed on the grid; None for other models."""
    if setup.model.dissolution is None:
        return None
    phases = SolidAndLiquid(grid, setup.model.dissolution, setup.background, start.solid)
    phases.start()
    if start.solid.any():
        phases.refuse_wet(_acted_on(near, driving))
    return phases


def _set_engine(setup: Setup, grid: Grid, margins: Mapping[Key, int]) -> None:
    """Have the engine record work if it is needed, and compute the drag of the model."""
    if setup.lasting:
        grid.engine.record_work()
    if setup.model.drag:
        lattice = setup.lattice
        corner = np.array([0] * grid.lead + [margins[a, -1] for a in range(lattice.dim)])
        set_drag(grid.engine, setup.model.drag, corner, corner + np.array((1,) * grid.lead + lattice.shape))


def _cut(setup: Setup, cuts: CutBonds, breaking: Breaking | None, notes: list[str]) -> None:
    """Cut the bonds across cracks that are open from the start."""
    cuts.cut(setup.cracks)
    alone = breaking.loose() if breaking is not None and setup.cracks else 0
    if alone:
        notes.append(f"cracks leave {alone} nodes without any bond: they move freely")
    if breaking is not None and breaking.law.contact and (setup.cracks or np.isfinite(breaking.critical_stretch)):
        notes.append(_STICKS)
    if breaking is not None and (ends := breaking.open_ends(_cuts(setup))):
        notes.append(_STAYS_OPEN.format(", ".join(side_name(*key) for key in ends)))


def _cuts(setup: Setup) -> list[Cut]:
    """Return the cuts of all cracks, whether or not they are open."""
    return [crack.cut for crack in setup.cracks]


def _with_layers(setup: Setup, near: NearField, sides: Sides) -> Surroundings:
    """Return the surroundings with layers; those that are to be chosen have a default number of nodes."""
    around = by_target(setup, sides, near.continued, near.pace.sides)
    layers = with_one_filter(around.layers, near.rate_limit, near.dt, near.lattice.dim)
    return replace(around, layers=layers, undesigned=undesigned(near, sides))


def _acted_on(near: NearField, driving: Sequence[Drive]) -> np.ndarray:
    """Return the nodes on which a condition or a source acts, as a mask."""
    busy = near.conditioned
    for space, _ in driving:
        busy |= False if space is None else space != 0
    return busy


def shared(setup: Setup, team: Team, topology: Sequence[int] | None, stiffer: float = 1.0) -> tuple[Share, Whole]:
    """Return the share of this process in a run, and the whole for recorders; `stiffer` as in `assembled`.

    No process evaluates the whole set-up.

    Raises
    ------
    InputError
        The run is not possible on several processes.
    """
    host, _ = looked_at(setup, team)
    uniform = host.uniform(setup)
    stencil = uniform.model.medium(setup.lattice.spacing, setup.lattice.dim)
    check_repeats(setup, setup.sides, stencil)
    held = tuple(one for one in setup.constraints if isinstance(one, Prescribed))
    bare = replace(uniform, initial={}, loads=(), coefficient=None, constraints=held)
    extremes = extremes_of(setup, host, stencil, team, stiffer)
    around = by_target(uniform, setup.sides, stencil, extremes.pace.sides)
    near = near_field(bare, setup.sides, stencil, Variation(), whole=extremes)
    return share_of(setup, host, around, near, team, topology), Whole(near, setup.sides, team)

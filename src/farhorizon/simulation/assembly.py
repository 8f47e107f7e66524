"""The parts of a run, put together from its set-up."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from farhorizon.boundaries import ExactEnds, OutlineCondition, Side
from farhorizon.engine.settings import set_drag
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Cut
from farhorizon.inputs.exterior import Exterior, changes
from farhorizon.inputs.incidence import Incidence
from farhorizon.inputs.prescribed import Prescribed
from farhorizon.medium.force_states import ForceStates
from farhorizon.medium.variation import Variation
from farhorizon.simulation.heat.solid_and_liquid import SolidAndLiquid
from farhorizon.simulation.heat.thermoelastic_sides import heat_front, thermoelastic_margins, thermoelastic_sides
from farhorizon.simulation.processes.process_group import ALONE, ProcessGroup
from farhorizon.simulation.processes.subdomain import Subdomain, check_choosable, check_divisible, subdomain_of
from farhorizon.simulation.setup.cuts import CutBonds
from farhorizon.simulation.setup.grid import Grid, choose_margins, make_grid, states_of
from farhorizon.simulation.setup.laws import of_field
from farhorizon.simulation.setup.near_field import NearField, extremes_of, near_field
from farhorizon.simulation.setup.reference_medium import node_factor, reference_and_variation, varied
from farhorizon.simulation.setup.setup import Key, Setup, Sides, side_name
from farhorizon.simulation.setup.stiffening import least_stiffening, stiffening
from farhorizon.simulation.setup.validation import (
    check_entrances,
    check_model,
    check_repeats,
    check_stencil,
    check_variation,
)
from farhorizon.simulation.sides.extension import Emitters, extend
from farhorizon.simulation.sides.layered_sides import LayeredSides, by_target, check_memory
from farhorizon.simulation.sides.layers import undesigned, with_one_filter
from farhorizon.simulation.sides.outline_condition import exact_ends_of, outline_condition
from farhorizon.simulation.sides.surfaces import check_conditions, hold_and_damp
from farhorizon.simulation.time.breaking import Breaking
from farhorizon.simulation.time.of_field import field_source_terms
from farhorizon.simulation.time.source_terms import (
    Arriving,
    SourceTerm,
    SourceTerms,
    check_signals,
    given,
    incidence,
    incident_waves,
    jumps,
    signals,
    split_source_terms,
)
from farhorizon.simulation.time.start import Start, check_range, drifting, own_step, start_of

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
    team : ProcessGroup
        The processes, which call methods jointly.
    """

    near: NearField
    sides: Sides
    team: ProcessGroup = ALONE

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
    layered : LayeredSides
    autos : dict of (axis, side) to Side
        The sides that leave the choice between a layer, which they are until the length of the run is known, and an
        extended domain.
    exterior : Exterior
        Checks of data and sources beyond absorbing sides; its `notes` are those of the set-up.
    start : Start
    source_terms : SourceTerms
    emitters : Emitters
    grid : Grid
    phases : SolidAndLiquid or None
        The phases of a corrosion.
    closure : OutlineCondition or None
        The conditions along the outline of the near field.
    cuts : CutBonds
    breaking : Breaking or None
        Bonds that are nonlinear or break.
    held : ndarray of int
        Places in a level whose values never change.
    ends : ExactEnds or None
    incident : list of Incidence
    active_terms : list of SourceTerm
        All that drives the near field: sources and loads, conditions, incident waves, what depends on the field.
    of_field : list of (str, SourceTerm)
        The latter, with their names.
    whole : Whole
        The near field with its sides; on several processes, the parts given to recorders have that of all processes.
    thermoelastic : frozenset of (axis, side)
        The sides beyond which a temperature continues with the displacements.
    """

    near: NearField
    layered: LayeredSides
    autos: dict[Key, Side]
    exterior: Exterior
    start: Start
    source_terms: SourceTerms
    emitters: Emitters
    grid: Grid
    phases: SolidAndLiquid | None
    closure: OutlineCondition | None
    cuts: CutBonds
    breaking: Breaking | None
    held: np.ndarray
    ends: ExactEnds | None
    incident: list[Incidence]
    active_terms: list[SourceTerm]
    of_field: list[tuple[str, SourceTerm]]
    whole: Whole
    thermoelastic: frozenset[Key]

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
    layered : LayeredSides
    waves : list of Arriving
    sources : list of (str, source)
        Sources, each with its name in messages.
    """

    setup: Setup
    autos: dict[Key, Side]
    near: NearField
    layered: LayeredSides
    waves: list[Arriving]
    sources: list[tuple[str, Any]]


def survey(
    whole: Setup, stiffer: float = 1.0, team: ProcessGroup = ALONE, subdomain: Subdomain | None = None
) -> Survey:
    """Determine the medium, the sides and the sources of a set-up; see `assemble`."""
    setup, variation = (
        varied(whole)
        if subdomain is None
        else (subdomain.reference_medium.uniform(whole), subdomain.reference_medium.variation_of(whole))
    )
    of_whole = None if subdomain is None else subdomain.whole
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
    waves = incident_waves(setup, near, sides if subdomain is None else subdomain.sides, _cuts(setup), team)
    sources = given(setup, near, sides)
    return Survey(setup, autos, near, _with_layers(setup, near, sides), waves, sources)


def assemble(setup: Setup, margins_given: Mapping[Key, int] | None = None) -> Parts:
    """Return the parts of a run on one process; see `assembled`."""
    return _stiffened(
        setup, ALONE, lambda stiffer: assembled(setup, stiffer, margins_given=margins_given), lambda parts: parts
    )


def assemble_subdomain(
    setup: Setup, team: ProcessGroup, topology: Sequence[int] | None, observers: Sequence[Any]
) -> tuple[Subdomain, Whole, Parts]:
    """Return the share of this process in a run, the whole for recorders, and the parts; see `assemble`, `shared`."""
    check_divisible(setup, observers)
    check_choosable(setup)

    def built(stiffer: float) -> tuple[Subdomain, Whole, Parts]:
        subdomain, whole = shared(setup, team, topology, stiffer)
        return subdomain, whole, assembled(subdomain.setup, stiffer, team, subdomain)

    return _stiffened(setup, team, built, lambda found: found[2])


def _stiffened(setup: Setup, team: ProcessGroup, built: Callable[[float], T], parts_of: Callable[[T], Parts]) -> T:
    """Build a run, and build it again if it turns out to be stiffer than the medium.

    Parameters
    ----------
    setup : Setup
    team : ProcessGroup
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
    team: ProcessGroup = ALONE,
    subdomain: Subdomain | None = None,
    margins_given: Mapping[Key, int] | None = None,
) -> Parts:
    """Return the parts of a run; cheap checks of the set-up come before expensive ones.

    Parameters
    ----------
    whole : Setup
    stiffer : float
        Largest squared frequency over that of the medium with all its bonds: the `stiffening` of a trial.
    team : ProcessGroup
        The processes that compute the run.
    subdomain : Subdomain, optional
        The share of this process; its set-up is `whole`.
    margins_given : mapping of (axis, side) to int, optional
        Nodes of the core beyond some sides of the near field, in place of those that are chosen.

    Raises
    ------
    InputError
        Anything that cannot be computed.
    """
    found = survey(whole, stiffer, team, subdomain)
    setup, near, sides = found.setup, found.near, found.layered.sides
    exterior = _look_beyond(found, team)
    start = start_of(setup, near, sides, exterior)
    check_range(start, setup.dtype, team)
    exterior.notes.extend(drifting(near, sides, setup.dtype))
    exterior.check_cracks(_cuts(setup), near.stencil.reach)
    source_terms = split_source_terms(found.sources, near, exterior)
    active_terms = source_terms.sources + [source_term for _, source_term in near.conditions.sources]
    thermoelastic = frozenset() if subdomain is not None else thermoelastic_sides(setup, sides, near.dt)
    everywhere = bool(
        found.waves or source_terms.unsplit or thermoelastic or of_field(setup)
    )  # a hot spot may be anywhere
    emitters = Emitters(near, sides, start, tuple(active_terms), everywhere, partial(heat_front, setup, thermoelastic))
    layered = extend(setup, found.layered, emitters, exterior.notes)

    states = states_of(setup, sides, near.variation.moduli is not None)
    margins = _margins(found, layered, start, states, thermoelastic, team) | dict(margins_given or {})
    check_conditions(near, sides, margins, exterior.notes)
    link, neighbours = (None, None) if subdomain is None else (team.link, subdomain.neighbours)
    grid = make_grid(setup, near, layered, margins, states, link, neighbours, bool(thermoelastic))
    phases = _phases(setup, near, start, grid, active_terms)
    closure = outline_condition(near, sides, grid, start.solid)
    free_rim = setup.lattice.body is not None and setup.rim == "free"
    cuts = CutBonds(near, layered, grid, closure, free_rim, exterior.notes)
    law = setup.model.bond_law
    incident = [incidence(one, near, sides, exterior.notes) for one in found.waves]
    exterior.notes.extend(own_step(setup, near, bool(incident or (near.varies and signals(setup)))))
    regions = [one.region for one in incident]
    breaking = None if law is None else Breaking(law, near, sides, grid, cuts, regions, team)
    if law is not None and law.nonlinear and incident:
        exterior.notes.append(
            "an incident wave is one of linear bonds: with nonlinear ones a fraction of it about as large as its "
            "strain leaks from its box"
        )
    if breaking is not None and incident and not team.largest(float(np.prod(breaking.extent))):
        exterior.notes.append("the boxes of the incident waves have no node in common, so no bond will break")
    _set_engine(setup, grid, margins)
    _cut(setup, cuts, breaking, exterior.notes)
    held = hold_and_damp(near, layered, cuts, setup.rim == "fixed")
    ends = exact_ends_of(near, sides, grid)
    active_terms += [(None, lambda t, one=one: one.source(t) / setup.model.source_factor) for one in incident]
    of_the_field = field_source_terms(setup, near, sides, grid, team)
    active_terms += [source_term for _, source_term in of_the_field]
    return Parts(
        near,
        layered,
        found.autos,
        exterior,
        start,
        source_terms,
        emitters,
        grid,
        phases,
        closure,
        cuts,
        breaking,
        held,
        ends,
        incident,
        active_terms,
        of_the_field,
        Whole(near, layered.sides),
        thermoelastic,
    )


def _look_beyond(found: Survey, team: ProcessGroup) -> Exterior:
    """Prepare the checks beyond absorbing sides, with all notes so far and those on a medium that varies there."""
    setup, near, layered = found.setup, found.near, found.layered
    lattice, stencil = setup.lattice, near.stencil
    depth = layered.depth(stencil, lattice.spacing, lattice.shape)
    exterior = Exterior(lattice, layered.sides, setup.model.target, depth, near.closed, team.largest)
    exterior.notes += near.conditions.notes + layered.doubts + jumps(setup, near)
    if near.growth:
        exterior.notes.append(f"the medium grows by itself, e-fold in t = {1 / near.growth:.3g}, and so do all errors")
    name = "the coefficient" if near.factor is near.coefficient else "the stiffness"
    for values, called in ((near.factor, name), (near.density, "the density"), (lattice.existing, "the body")):
        if values is not None:
            exterior.notes += changes(values.astype(float), called, exterior.targets, stencil.reach)
    extended = [key for key in exterior.targets if layered.sides[key].extended]  # bonds also break beyond these sides
    if near.variation.strength is not None and extended:
        strength = np.broadcast_to(near.variation.strength, lattice.shape).astype(float)
        exterior.notes += changes(strength, "the critical stretch", extended, stencil.reach)
    return exterior


def _margins(
    found: Survey,
    layered: LayeredSides,
    start: Start,
    states: ForceStates | None,
    thermoelastic: frozenset[Key],
    team: ProcessGroup,
) -> dict[Key, int]:
    """Return the number of nodes of the core beyond each side of the near field."""
    setup, near = found.setup, found.near
    medium = [start.solid, *near.variation.of_waves]
    if setup.lattice.existing is not None:
        medium.append(setup.lattice.existing)
    margins = choose_margins(near, layered, (start.u, start.v), medium, _cuts(setup), states, team)
    return margins | thermoelastic_margins(setup, thermoelastic, layered)


def _phases(
    setup: Setup, near: NearField, start: Start, grid: Grid, active_terms: Sequence[SourceTerm]
) -> SolidAndLiquid | None:
    """Return the phases of a corrosion, placed on the grid; None for other models."""
    if setup.model.dissolution is None:
        return None
    phases = SolidAndLiquid(grid, setup.model.dissolution, setup.background, start.solid)
    phases.start()
    if start.solid.any():
        phases.refuse_wet(_acted_on(near, active_terms))
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


def _with_layers(setup: Setup, near: NearField, sides: Sides) -> LayeredSides:
    """Return the surroundings with layers; those that are to be chosen have a default number of nodes."""
    layered = by_target(setup, sides, near.continued, near.contrast.sides)
    layers = with_one_filter(layered.layers, near.rate_limit, near.dt, near.lattice.dim)
    return replace(layered, layers=layers, undesigned=undesigned(near, sides))


def _acted_on(near: NearField, active_terms: Sequence[SourceTerm]) -> np.ndarray:
    """Return the nodes on which a condition or a source acts, as a mask."""
    busy = near.conditioned
    for space, _ in active_terms:
        busy |= False if space is None else space != 0
    return busy


def shared(
    setup: Setup, team: ProcessGroup, topology: Sequence[int] | None, stiffer: float = 1.0
) -> tuple[Subdomain, Whole]:
    """Return the share of this process in a run, and the whole for recorders; `stiffer` as in `assembled`.

    No process evaluates the whole set-up.

    Raises
    ------
    InputError
        The run is not possible on several processes.
    """
    reference_medium, _ = reference_and_variation(setup, team)
    uniform = reference_medium.uniform(setup)
    stencil = uniform.model.medium(setup.lattice.spacing, setup.lattice.dim)
    check_repeats(setup, setup.sides, stencil)
    held = tuple(one for one in setup.constraints if isinstance(one, Prescribed))
    bare = replace(uniform, initial={}, loads=(), coefficient=None, constraints=held)
    extremes = extremes_of(setup, reference_medium, stencil, team, stiffer)
    layered = by_target(uniform, setup.sides, stencil, extremes.contrast.sides)
    near = near_field(bare, setup.sides, stencil, Variation(), whole=extremes)
    return subdomain_of(setup, reference_medium, layered, near, team, topology), Whole(near, setup.sides, team)

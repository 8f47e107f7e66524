"""The parts of a run, put together from its set-up."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from farhorizon.boundaries import ExactEnds, OutlineCondition, Side
from farhorizon.engine.features.dissipation import set_dissipation
from farhorizon.engine.features.drag import set_drag
from farhorizon.engine.features.sources import record_work
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Cut
from farhorizon.inputs.incidence import Incidence
from farhorizon.inputs.prescribed import Prescribed
from farhorizon.medium.force_states import ForceStates
from farhorizon.medium.variation import Variation
from farhorizon.simulation.heat.solid_and_liquid import SolidAndLiquid
from farhorizon.simulation.heat.thermoelastic_sides import heat_front, thermoelastic_margins, thermoelastic_sides
from farhorizon.simulation.processes.process_group import ALONE, ProcessGroup
from farhorizon.simulation.processes.subdomain import Subdomain, check_choosable, check_divisible, subdomain_of
from farhorizon.simulation.setup.compatibility import (
    check_entrances,
    check_model,
    check_repeats,
    check_stencil,
    check_variation,
)
from farhorizon.simulation.setup.cuts import CutBonds
from farhorizon.simulation.setup.grid import Grid, choose_margins, make_grid, states_of
from farhorizon.simulation.setup.near_field import NearField, extremes_of, near_field
from farhorizon.simulation.setup.quasi_static import ITERATED, check_load_steps, check_loads, with_fictitious_masses
from farhorizon.simulation.setup.reference_medium import node_factor, reference_and_variation, varied
from farhorizon.simulation.setup.setup import Key, Setup, Sides, side_name
from farhorizon.simulation.setup.stiffening import least_stiffening, stiffening
from farhorizon.simulation.setup.surface_springs import stiffen_surfaces
from farhorizon.simulation.sides.extension import Emitters, extend
from farhorizon.simulation.sides.exterior import Exterior, changes
from farhorizon.simulation.sides.held_and_damped import check_conditions, hold_and_damp
from farhorizon.simulation.sides.layered_sides import LayeredSides, by_target, check_memory, undesigned, with_one_filter
from farhorizon.simulation.sides.outline_condition import exact_ends_of, outline_condition
from farhorizon.simulation.time.breaking import BreakableBonds
from farhorizon.simulation.time.impacts import RigidShapes
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

#: Notes on cracks whose faces can meet: where they do not slide, and on what else compression does to bonds.
_STICKS = (
    "{} stick where they close: contact acts along the bonds, without a law of friction (under pressure all of an S "
    "pulse is transmitted, without it 0.65 to 0.85 of its amplitude); the faces of given cracks slide if bonds are "
    "linear"
)
_EXPANDS = (
    "bonds break by their stretch alone: a bond-based body under uniaxial compression of {:.3g} or more breaks by "
    "Poisson's expansion, without any crack, and first at free edges, where bonds are softer"
)
#: Note on such cracks that run into sides beyond which their faces cannot meet.
_STAYS_OPEN = (
    "the faces of a crack do not meet within one reach of {} and beyond: compression is reflected there; "
    "Extended continues cracks whose faces meet, contact = false disables contact"
)


@dataclass(frozen=True, eq=False)
class GlobalDomain:
    """The whole near field and its sides, which recorders use on each of several processes that have parts of a run."""

    near: NearField
    sides: Sides
    team: ProcessGroup = ALONE  # which calls methods jointly

    def numbers(self, inside: np.ndarray, part: Lattice) -> np.ndarray:
        """Return the flat indices in the whole lattice, in order, of the nodes of a mask of which each process has its
        part.
        """
        indices = np.argwhere(inside) + np.array(part.first)
        flat = np.ravel_multi_index(tuple(indices.T), self.near.lattice.shape)
        return np.sort(np.concatenate(self.team.gather(flat)))


@dataclass(frozen=True, eq=False)
class RunParts:
    """The parts of a run."""

    near: NearField
    layered: LayeredSides
    autos: dict[Key, Side]  # sides that become layers or extended domains once the length of the run is known
    exterior: Exterior  # its `notes` are those of the set-up
    start: Start
    source_terms: SourceTerms
    emitters: Emitters
    grid: Grid
    phases: SolidAndLiquid | None  # of a corrosion
    closure: OutlineCondition | None  # conditions along the outline of the near field
    cuts: CutBonds
    breaking: BreakableBonds | None  # bonds that are nonlinear or break
    held: np.ndarray  # places in a level whose values never change
    ends: ExactEnds | None
    incident: list[Incidence]
    active_terms: list[SourceTerm]  # sources, loads, conditions, incident waves, and what depends on the field
    of_field: list[tuple[str, SourceTerm]]  # the latter, with their names
    whole: GlobalDomain  # on several processes, the parts given to recorders have that of all processes
    thermoelastic: frozenset[Key]  # sides beyond which a temperature continues with the displacements
    impactors: RigidShapes | None  # rigid shapes that push nodes

    def at(self, values: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """Return values at nodes of the whole lattice (flat indices), on all processes, each of which has the values of
        its part, whose axes come last.
        """
        part = self.near.lattice
        inside, own_nodes = part.own(nodes.ravel())
        values_here = values.reshape(*values.shape[: values.ndim - part.dim], -1)[..., own_nodes]
        completed = self.whole.team.completed(values_here, np.flatnonzero(inside), nodes.size, values_here.ndim - 1)
        return completed.reshape(*completed.shape[:-1], *nodes.shape)

    def hides(self, nodes: np.ndarray) -> np.ndarray:
        """Return which nodes of the whole lattice (flat indices) have no values of the body or window."""
        hidden = self.near.hidden
        return self.at(np.zeros(self.near.lattice.shape) if hidden is None else hidden.astype(float), nodes) > 0


@dataclass(frozen=True, eq=False)
class Prepared:
    """The medium, sides and sources of a run, before a grid is made."""

    setup: Setup  # with a uniform model
    autos: dict[Key, Side]  # as in `RunParts`
    near: NearField
    layered: LayeredSides
    waves: list[Arriving]
    sources: list[tuple[str, Any]]  # each with its name in messages


def survey(
    given_setup: Setup, stiffer: float = 1.0, team: ProcessGroup = ALONE, subdomain: Subdomain | None = None
) -> Prepared:
    """Determine the medium, the sides and the sources of a set-up; see `assembled`."""
    setup, variation, of_whole = given_setup, Variation(), None
    if subdomain is not None:
        setup, of_whole = subdomain.reference_medium.uniform(given_setup), subdomain.extremes
        variation = subdomain.reference_medium.variation_of(given_setup)
    elif given_setup.model.varying or given_setup.lattice.existing is not None:
        setup, variation = varied(given_setup)
    lattice, model = setup.lattice, setup.model
    sides = {key: side.as_layer(None, model.target) for key, side in setup.sides.items()}
    autos = {key: side for key, side in setup.sides.items() if side is not sides[key]}
    check_model(setup, sides)
    stencil = model.medium(lattice.spacing, lattice.dim)
    check_stencil(setup, sides, stencil)
    if setup.cracks:
        check_repeats(setup, sides, stencil)
    check_memory(setup, stencil, by_target(setup, sides, stencil))
    coefficient = None
    if setup.coefficient is not None:
        coefficient = node_factor(setup)
        variation = variation.times(coefficient)
    if variation.stiffness is not None or variation.density is not None:
        check_variation(model, sides, variation, stencil)
    if any(side.derivatives for side in sides.values()):
        check_entrances(given_setup, sides, stencil)
    if setup.load_steps is not None:
        check_load_steps(setup, sides)
        in_time = near_field(replace(setup, dt=None), sides, stencil, variation, coefficient, stiffer)
        setup = replace(setup, model=with_fictitious_masses(setup.model, in_time.step_limit, setup.load_steps))
    near = near_field(setup, sides, stencil, variation, coefficient, stiffer, team, of_whole)
    waves, sources = [], []
    if setup.sources or setup.loads or setup.constraints:
        check_signals(setup, near)
        waves = incident_waves(setup, near, sides if subdomain is None else subdomain.sides, _cuts(setup), team)
        sources = given(setup, near, sides)
    return Prepared(setup, autos, near, _with_layers(setup, near, sides), waves, sources)


def assemble(setup: Setup, margins_given: Mapping[Key, int] | None = None) -> RunParts:
    """Return the parts of a run on one process; see `assembled`."""
    if setup.model.bonds and setup.model.stiffens_surfaces:  # how fast linear bonds oscillate limits the step
        linear = assembled(replace(setup, model=setup.model.linearised, dt=None), margins_given=margins_given)
        return assembled(setup, stiffening(linear.near, linear.grid, ALONE), margins_given=margins_given)
    return _stiffened(
        setup, ALONE, lambda stiffer: assembled(setup, stiffer, margins_given=margins_given), lambda parts: parts
    )


def assemble_subdomain(
    setup: Setup, team: ProcessGroup, topology: Sequence[int] | None, observers: Sequence[Any]
) -> tuple[Subdomain, GlobalDomain, RunParts]:
    """Return the subdomain of this process, the whole for recorders, and the parts; see `assembled`, `shared`."""
    check_divisible(setup, observers)
    check_choosable(setup)

    def built(stiffer: float) -> tuple[Subdomain, GlobalDomain, RunParts]:
        subdomain, whole = shared(setup, team, topology, stiffer)
        return subdomain, whole, assembled(subdomain.setup, stiffer, team, subdomain)

    return _stiffened(setup, team, built, lambda results: results[2])


def _stiffened(setup: Setup, team: ProcessGroup, built: Callable[[float], T], parts_of: Callable[[T], RunParts]) -> T:
    """Build a run, for a stiffening, and build it again if it turns out to be stiffer than the medium; `parts_of`
    returns the parts among what `built` does, which fails on all processes if it does on one.
    """
    least = 1.0 if setup.model.bonds else least_stiffening(setup)
    results = built(least)
    parts = parts_of(results)
    if least == 1 and not team and not parts.grid.engine.passes:
        return results  # forces are those of bonds alone
    stiffer = stiffening(parts.near, parts.grid, team, least)
    if stiffer == least:
        return results
    del results, parts  # so that only one is in memory
    return built(stiffer)


def assembled(
    given_setup: Setup,
    stiffer: float = 1.0,
    team: ProcessGroup = ALONE,
    subdomain: Subdomain | None = None,
    margins_given: Mapping[Key, int] | None = None,
) -> RunParts:
    """Return the parts of a run; cheap checks of the set-up come before expensive ones, and what the run does not use
    is not entered.

    `stiffer` is the `stiffening` of a trial. On several processes the given set-up is that of the subdomain. Margins
    that are given, in nodes of the core beyond some sides of the near field, replace those that are chosen.
    """
    surveyed = survey(given_setup, stiffer, team, subdomain)
    setup, near, sides = surveyed.setup, surveyed.near, surveyed.layered.sides
    exterior = _look_beyond(surveyed, team)
    start = start_of(setup, near, sides, exterior)
    check_range(start, setup.dtype, team)
    if setup.dtype == "float32":
        exterior.notes.extend(drifting(near, sides))
    if setup.cracks:
        exterior.check_cracks(_cuts(setup), near.stencil.reach)
    source_terms = split_source_terms(surveyed.sources, near, exterior) if surveyed.sources else SourceTerms([], [])
    if setup.load_steps is not None:
        check_loads(setup, source_terms.unsplit)
        exterior.notes.append(ITERATED)
    active_terms = source_terms.sources + [source_term for _, source_term in near.conditions.sources]
    thermoelastic = frozenset[Key]()
    if setup.heat is not None and subdomain is None:
        thermoelastic = thermoelastic_sides(setup, sides, near.dt)
    everywhere = bool(
        surveyed.waves or source_terms.unsplit or thermoelastic or setup.depends_on_field or setup.impactors
    )  # a hot spot may be anywhere, and a contact
    emitters = Emitters(near, sides, start, tuple(active_terms), everywhere, partial(heat_front, setup, thermoelastic))
    layered = surveyed.layered
    if any(side.extended for side in sides.values()):
        layered = extend(setup, layered, emitters, exterior.notes)

    states = states_of(setup, sides, near.variation.moduli is not None, team)
    margins = _margins(surveyed, layered, start, states, team)
    if thermoelastic:
        margins |= thermoelastic_margins(setup, thermoelastic, layered)
    margins |= margins_given or {}
    conditioned = bool(near.conditions.nodes.size or near.prescribed.constraints or near.leak.size)
    if conditioned:
        check_conditions(near, sides, margins, exterior.notes)
    exchange = None if subdomain is None else (team.link, subdomain.neighbours)
    grid = make_grid(setup, near, layered, margins, states, exchange, bool(thermoelastic))
    phases = None if setup.model.dissolution is None else _phases(setup, near, start, grid, active_terms)
    closing = any(side.closing for side in sides.values())
    closure = outline_condition(near, sides, grid, start.solid) if closing else None
    free_rim = setup.lattice.body is not None and setup.rim == "free"
    cuts = CutBonds(near, layered, grid, closure, free_rim, exterior.notes)
    if setup.model.stiffens_surfaces:
        stiffen_surfaces(cuts)
    law = setup.model.bond_law
    incident = [incidence(wave, near, sides, exterior.notes) for wave in surveyed.waves]
    if incident or (near.varies and signals(setup)):
        exterior.notes.extend(own_step(setup, near))
    regions = [wave.region for wave in incident]
    breaking = None if law is None else BreakableBonds(law, near, sides, grid, cuts, regions, team)
    if law is not None and law.nonlinear and incident:
        exterior.notes.append(
            "an incident wave is one of linear bonds: with nonlinear ones a fraction of it about as large as its "
            "strain leaks from its box"
        )
    if breaking is not None and incident and not team.largest(float(np.prod(breaking.extent))):
        exterior.notes.append("the boxes of the incident waves have no node in common, so no bond will break")
    _set_engine(setup, grid, margins)
    ends_somewhere = free_rim or not all(side.bonded for side in sides.values())
    if team or setup.cracks or layered.layers or closing or ends_somewhere or law is not None:
        _cut(setup, cuts, breaking, exterior.notes)
    held, fixed_rim = np.zeros(0, np.int64), setup.rim == "fixed"
    damped = conditioned or near.supports is not None or any(side.damped for side in sides.values())
    if damped or fixed_rim or grid.walled or grid.engine.absent.outside.size:
        held = hold_and_damp(near, layered, cuts, fixed_rim)
    ends = exact_ends_of(near, sides, grid) if any(side.exact for side in sides.values()) else None
    active_terms += [(None, lambda t, wave=wave: wave.source(t) / setup.model.source_factor) for wave in incident]
    terms_of_field = field_source_terms(setup, near, sides, grid, team) if setup.depends_on_field else []
    active_terms += [source_term for _, source_term in terms_of_field]
    impactors = RigidShapes(setup.impactors, near, sides, grid, start.u) if setup.impactors else None
    if impactors is not None:
        exterior.notes.extend(impactors.notes)
    return RunParts(
        near,
        layered,
        surveyed.autos,
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
        terms_of_field,
        GlobalDomain(near, layered.sides),
        thermoelastic,
        impactors,
    )


def _look_beyond(surveyed: Prepared, team: ProcessGroup) -> Exterior:
    """Prepare the checks beyond absorbing sides, with all notes so far and those on a medium that varies there."""
    setup, near, layered = surveyed.setup, surveyed.near, surveyed.layered
    lattice, stencil = setup.lattice, near.stencil
    depth: dict[Key, int] = {}
    if any(side.endless for side in layered.sides.values()):
        depth = layered.depth(stencil, lattice.spacing, lattice.shape)
    largest = team.largest if team else float
    exterior = Exterior(lattice, layered.sides, setup.model.target, depth, near.closed, largest)
    exterior.notes += near.conditions.notes + layered.doubts
    if surveyed.sources:
        exterior.notes += jumps(setup, near)
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
    surveyed: Prepared, layered: LayeredSides, start: Start, states: ForceStates | None, team: ProcessGroup
) -> dict[Key, int]:
    """Return the number of nodes of the core beyond each side of the near field."""
    setup, near = surveyed.setup, surveyed.near
    medium = [start.solid, *near.variation.of_waves]
    if setup.lattice.existing is not None:
        medium.append(setup.lattice.existing)
    if setup.model.attenuation is not None:
        medium.append(setup.model.attenuation.numbers(setup.lattice))
    return choose_margins(near, layered, (start.u, start.v), medium, _cuts(setup), states, team)


def _phases(
    setup: Setup, near: NearField, start: Start, grid: Grid, active_terms: Sequence[SourceTerm]
) -> SolidAndLiquid:
    """Return the phases of a corrosion, placed on the grid."""
    assert setup.model.dissolution is not None
    phases = SolidAndLiquid(grid, setup.model.dissolution, setup.background, start.solid)
    phases.start()
    if start.solid.any():
        phases.refuse_wet(_acted_on(near, active_terms))
    return phases


def _set_engine(setup: Setup, grid: Grid, margins: Mapping[Key, int]) -> None:
    """Have the engine record work and what relaxation dissipates if they are needed, and compute the drag of the
    model.
    """
    lattice, model = setup.lattice, setup.model
    corner = np.array([0] * grid.lead + [margins[a, -1] for a in range(lattice.dim)])
    end = corner + np.array((1,) * grid.lead + lattice.shape)
    if setup.lasting:
        record_work(grid.engine)
    if model.drag:
        set_drag(grid.engine, model.drag, corner, end)
    if model.attenuation is not None and setup.balance:
        set_dissipation(grid.engine, *model.attenuation.relaxation, corner, end)


def _cut(setup: Setup, cuts: CutBonds, breaking: BreakableBonds | None, notes: list[str]) -> None:
    """Cut the bonds across cracks that are open from the start."""
    cuts.cut(setup.cracks)
    alone = breaking.loose() if breaking is not None and setup.cracks else 0
    if alone:
        notes.append(f"cracks leave {alone} nodes without any bond: they move freely")
    if breaking is not None and breaking.law.contact:
        breaks = bool(np.isfinite(breaking.critical_stretch))
        if breaks or (setup.cracks and not breaking.law.slides):
            notes.append(_STICKS.format("faces of new cracks" if breaking.law.slides else "cracks"))
        if breaks and setup.model.bonds:
            notes.append(_EXPANDS.format(breaking.critical_stretch / breaking.law.expansion(setup.lattice.dim)))
    if breaking is not None and (ends := breaking.open_ends(_cuts(setup))):
        notes.append(_STAYS_OPEN.format(", ".join(side_name(*key) for key in ends)))


def _cuts(setup: Setup) -> list[Cut]:
    """Return the cuts of all cracks, whether or not they are open."""
    return [crack.cut for crack in setup.cracks]


def _with_layers(setup: Setup, near: NearField, sides: Sides) -> LayeredSides:
    """Return the surroundings with layers; those that are to be chosen have a default number of nodes."""
    layered = by_target(setup, sides, near.continued, near.contrast.sides)
    if not layered.layers:
        return layered
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
) -> tuple[Subdomain, GlobalDomain]:
    """Return the subdomain of this process, and the whole for recorders, without evaluating the whole set-up on any
    process; raises InputError if the run is not possible on several processes.
    """
    reference_medium, _ = reference_and_variation(setup, team)
    uniform = reference_medium.uniform(setup)
    stencil = uniform.model.medium(setup.lattice.spacing, setup.lattice.dim)
    check_repeats(setup, setup.sides, stencil)
    prescribed = tuple(condition for condition in setup.constraints if isinstance(condition, Prescribed))
    bare = replace(uniform, initial={}, loads=(), coefficient=None, constraints=prescribed)
    extremes = extremes_of(setup, reference_medium, stencil, team, stiffer)
    layered = by_target(uniform, setup.sides, stencil, extremes.contrast.sides)
    near = near_field(bare, setup.sides, stencil, Variation(), extremes=extremes)
    return subdomain_of(setup, reference_medium, layered, near, team, topology), GlobalDomain(near, setup.sides, team)

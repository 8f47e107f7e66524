"""Simulation: a run of a set-up, with its fields, energies, checks and saved states."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Self

import numpy as np

from farhorizon import kinds
from farhorizon.analysis.extent import Extent
from farhorizon.analysis.layers.thickness import Thickness
from farhorizon.boundaries import ExactEnds, Side
from farhorizon.checks.certificate import BUDGET, CERTIFIED, Certificate, certify
from farhorizon.checks.report import Report
from farhorizon.engine.engine import BackEnd
from farhorizon.errors import InputError
from farhorizon.files.results_layout import Caution
from farhorizon.geometry.lattice import Lattice
from farhorizon.inputs.conditions import Constraint
from farhorizon.inputs.load_steps import LoadSteps
from farhorizon.inputs.loads import Load
from farhorizon.inputs.prescribed import Prescribed
from farhorizon.inputs.specimens import Specimen
from farhorizon.machine import uninterrupted
from farhorizon.models import LatticeModel
from farhorizon.simulation.assembly import assemble, assemble_subdomain
from farhorizon.simulation.processes.parallel_prediction import rows_on_processes
from farhorizon.simulation.processes.process_group import ProcessGroup
from farhorizon.simulation.processes.subdomain import Subdomain, check_given
from farhorizon.simulation.recorders.flux import flux_tables, nodal_flux, plane, power_across
from farhorizon.simulation.recorders.recorder import Observer
from farhorizon.simulation.recorders.recording import Recording
from farhorizon.simulation.run import Run
from farhorizon.simulation.setup.crack_calibration import with_energy_factor
from farhorizon.simulation.setup.modified_setups import evaluated_setup, remade_setup, shortened_setup
from farhorizon.simulation.setup.setup import Key, Setup, side_name
from farhorizon.simulation.setup.surface_effect import thin_note
from farhorizon.simulation.sides.layer_choice import default_length
from farhorizon.simulation.sides.side_selection import SideSelection, extension_warnings, many_steps, resolved_sides
from farhorizon.simulation.time.breaking import check_margin
from farhorizon.simulation.time.checkpoint_files import read_state, write_state
from farhorizon.simulation.time.energies import present
from farhorizon.simulation.time.outer_loop import (
    MOST_STEPS,
    advance_clock,
    checked_end,
    likely_cause,
    refuse_explosion,
    warn,
    warn_once,
)
from farhorizon.simulation.time.source_terms import incident_wave_notes, signals
from farhorizon.simulation.time.steady_state import progress_of, take_progress
from farhorizon.simulation.time.steps import last_step, seconds_of
from farhorizon.simulation.time.time_loop import TimeLoop


class Simulation(Run):
    """One run of a model on a lattice.

    Parameters
    ----------
    lattice : Lattice
        The near field.
    model : Wave, Diffusion, Heat, Corrosion, Beam, Elastic or Thermoelastic
    boundary : Side or mapping
        One boundary for all sides, or a mapping by side: ``{"x-": ..., "x+": ..., "y": ..., "all": ...}``.
    initial : mapping
        "u" and, for waves, "v" (velocity): arrays of the lattice's shape, callables of the coordinates, expressions or
        numbers. For vector fields: arrays of shape (dim, n..), callables that return the components, or a sequence with
        one value per component.
    sources : sequence
        `Source`, array, callable of the coordinates and t, or expression; `PointSource`, `PointForce`, `MomentTensor`,
        `LineSource` and `PhasedArray`, which may lie anywhere between the nodes; incident waves: `IncidentWave`,
        `RayleighWave`, `IncidentField` and `IncidentRecord`.
    communicator : mpi4py.MPI.Intracomm, optional
        Processes that share the computation, each of which computes one box of the lattice: `lattice` and `fields` are
        then those of the box, and ``team.joined(lattice, fields["u"])`` is the whole field, on the first process.
    topology : sequence of int, optional
        Number of boxes along each axis; by default the division that requires the least communication.
    engine : type, optional
        Computes the steps in place of compiled code, on one process: a class that is made for the run's engine, whose
        operations are tables, and whose objects are called with ``(steps, phase, levels, tables, inputs)``.
        Certificates and reports remain those of compiled code. Such a run cannot be saved.
    loads : sequence of BodyForce, Traction, Pressure, Impactor and ThermalLoad
        Forces per volume in an `Elastic` medium, or per area on its free sides, cracks and holes; rigid shapes that
        push its nodes; heat that strains it.
    cracks : sequence
        Cuts, the points of polylines (2D) or polygons (3D), or positions (1D); use `Crack` for a cut that weakens bonds
        without severing them, or that opens later.
    constraints : sequence
        `Temperature`, `Flux`, `Insulated`, `Convection`: conditions on nodes of the body; `Prescribed`: nodes that
        follow a prescribed value, permanently or for a limited time.
    specimens : sequence of Specimen
        The metal of a `Corrosion` model; everything else is liquid.
    balance : bool
        Record the flow into the near field, for `balance`; for an `Elastic` medium, or one with attenuation, record the
        energies and the work of sources and loads.
    coefficient : array_like, optional
        Factor on the bonds, given at the nodes.
    rule : {"both", "arithmetic", "harmonic"}, optional
        How coefficients or stiffnesses of the two ends of a bond are combined: "both" (the smaller one), the default of
        a uniform model, or one of two means; "harmonic" is the default for a model whose constants vary.
    rim : {"free", "fixed"}
        Condition on the outline of a body: bonds across it are absent, or the field outside is fixed at the background.
    background : float
        Uniform state of the infinite medium.
    observe : sequence of callable and Receivers
        Functions that `run` calls with the run at regular intervals, and recorders, which record every step.
    dt : float, callable or LoadSteps, optional
        Time step; by default half the stability limit. A function of this default, such as `WholeSteps`, returns it.
        Runs whose fields are to be subtracted need the same one, the smaller of theirs: ``dt=other.dt``, in a case file
        ``dt`` with this number.
        `LoadSteps` replaces time steps by states of equilibrium.
    dtype : {"float64", "float32"}
    threads : int, optional
        Number of threads; all that the machine offers unless given. Small lattices use one.

    Attributes
    ----------
    time : float
    step_count : int
    dt : float
    setup : Setup
        The arguments as they were given.
    settled : Setup
        The same with the time step, the sides and the factors on bonds that were chosen: a run of it makes none of
        these choices again.
    stop_requested : bool
        Set this to True (in a signal handler or an observer) to end `run` with a KeyboardInterrupt between two steps.
    closure : OutlineCondition or None
        The conditions along the outline of the near field.
    start_u, start_v : ndarray
        Initial values minus the background, and initial velocities.
    fields : dict of str to ndarray
        The near field: "u" (vectors as (dim, n..)) and, for waves, "v" (lagging by half a step, (u(n) - u(n-1))/dt);
        nan outside a window or body, and on nodes beyond a wall that conditions use as images of those inside. For
        bonds that are nonlinear or break, also "damage", the fraction of a node's bonds that are cut or broken. For a
        solid with thermal strains, "T" and "thermal_strain". For corrosion, "solid", 1 in the metal and 0 in the
        liquid, and "dissolved", the time at which a node became liquid: 0 where it was liquid from the start, nan in
        the metal.

    Raises
    ------
    InputError
        Anything that cannot be computed; raised before any work is done.

    Examples
    --------
    >>> import farhorizon as fh
    >>> lattice = fh.Lattice(spacing=1.0, lower=(-15.0, -15.0), upper=(15.0, 15.0))
    >>> sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), initial={"u": "exp(-(x**2 + y**2)/6)"})
    >>> _ = sim.run(until=80.0)
    >>> bool(abs(sim.fields["u"]).max() < 0.02)  # the wave is gone, and does not come back
    True
    """

    def __init__(
        self,
        lattice: Lattice,
        model: LatticeModel,
        boundary: Side | Mapping[str, Side] | None = None,
        initial: Mapping[str, Any] | None = None,
        sources: Sequence[Any] = (),
        cracks: Sequence[Any] = (),
        coefficient: Any = None,
        background: float = 0.0,
        observe: Sequence[Observer] = (),
        dt: float | Callable[[float], float] | LoadSteps | None = None,
        dtype: str = "float64",
        threads: int | None = None,
        rule: str | None = None,
        rim: str = "free",
        constraints: Sequence[Constraint | Prescribed] = (),
        balance: bool = False,
        specimens: Sequence[Specimen] = (),
        loads: Sequence[Load] = (),
        communicator: Any = None,
        topology: Sequence[int] | None = None,
        engine: BackEnd | None = None,
    ) -> None:
        what = (lattice, model, boundary, initial, sources, cracks, coefficient, background, dt, dtype, threads)
        team = ProcessGroup.of(communicator)
        with team.agreed():
            setup = Setup(*what, rule, rim, constraints, balance, specimens, loads)
            self._begin(setup, observe, team, topology, engine)

    @classmethod
    def of(
        cls,
        setup: Setup,
        observe: Sequence[Observer] = (),
        communicator: Any = None,
        topology: Any = None,
        engine: BackEnd | None = None,
    ) -> Self:
        """Create a simulation from a set-up.

        Parameters
        ----------
        setup : Setup
        observe, communicator, topology, engine
            As in the constructor.
        """
        run = cls.__new__(cls)
        run._begin(setup, observe, ProcessGroup.of(communicator), topology, engine)
        return run

    def _begin(
        self,
        setup: Setup,
        observe: Sequence[Observer],
        team: ProcessGroup,
        topology: Sequence[int] | None,
        engine: BackEnd | None,
    ) -> None:
        """Assemble a set-up, go to its start, and set the attributes that other modules read."""
        self.setup, self.team, self.topology, self._back_end = setup, team, None, engine
        if engine is not None:
            team.alone("engines in place of the compiled one", "engine")
            given: Any = engine
            if not isinstance(given, type) or "__call__" not in dir(given):
                raise InputError(
                    "must be a class whose objects are called to make steps",
                    value=type(engine).__name__,
                    key="engine",
                    remedy="leave it out",
                )
        if team or topology is not None:
            self.topology = check_given(setup, observe, topology, team)
        self.subdomain: Subdomain | None = None
        with team.agreed():
            if setup.model.varying and not team:
                setup = evaluated_setup(setup)
            if setup.model.bond_law is not None:
                setup = with_energy_factor(setup, self.of, team)
            if team:
                self.subdomain, whole, parts = assemble_subdomain(setup, team, self.topology, observe)
            else:
                parts = assemble(setup)
        setup, self.parts = setup if self.subdomain is None else self.subdomain.setup, parts
        near, layered = parts.near, parts.layered
        self.lattice, self.model, self.background, self.dt = near.lattice, near.model, near.background, near.dt
        self.stencil, self.engine = near.stencil, parts.grid.engine
        self.sides, self.closure, self.prescribed = layered.sides, parts.closure, near.prescribed
        self.step_limit, self.rate_limit, self.field_shape = near.step_limit, near.rate_limit, near.field_shape
        self.strongest, self.conditions, self.leak = near.strongest, near.conditions, near.leak
        self.fastest_rate, self.weakest, self.of_field = near.fastest_rate, near.weakest, setup.depends_on_field
        self.signals = signals(setup) if setup.sources or setup.loads or setup.constraints else []
        self.growth, self.varied = near.growth, bool(parts.start.solid.any()) or near.varies
        self.start_u, self.start_v, self.sources = parts.start.u, parts.start.v, parts.source_terms.sources
        self.coefficients, self.incident, self.extents = layered.coefficients, parts.incident, layered.extents
        # 0 beyond sides shared with a neighbour
        beyond_of_all = team.gather(layered.beyond(near.stencil, near.lattice.spacing))
        self.beyond = {key: max(beyond[key] for beyond in beyond_of_all) for key in layered.sides}
        sides = {side_name(*key): side for key, side in layered.sides.items()}
        if layered.extents:
            sides = resolved_sides(layered)
        self.settled = replace(setup, boundary=sides, coefficient=near.coefficient, dt=near.dt)
        if setup.load_steps is not None:
            self.settled = replace(self.settled, dt=setup.dt)
        self.given = {name: value for name, value in self.settled.arguments.items() if name != "initial"}
        self._at_start(observe, int(team.largest(float(np.prod(parts.grid.core.nodes)))))
        self._end = 0.0  # end of the run, as far as it is known
        self._incident_notes: list[str] = []
        sides_of_all = self.setup.sides if team else self.sides
        self._chooses = any(b.stretched or b.extended for b in sides_of_all.values())
        self._side_selection = SideSelection(parts.autos, [key for key, b in sides_of_all.items() if b.open_ended])
        with team.agreed():
            self.resting = self.time_loop = TimeLoop(setup, parts, partial(self.of, engine=engine), team, engine)
        seen = replace(parts, whole=whole) if team else parts  # only recorders need the whole
        self._recording: Recording | None = None
        if self.recorders:
            self._recording = Recording(setup, seen, self.recorders, team, self.time_loop.heating)
        if self._chooses and any(b.until for b in self._given_layers):
            self._select_sides_alone()

    # --- time stepping -----------------------------------------------------------------------------------------

    def check_sources(self, until: float) -> None:
        """Evaluate sources that do not split into space and time beyond the absorbing sides, at up to 64 equidistant
        times until the end of the run, and check incident waves; `run` calls this method.

        Raises
        ------
        InputError
            The part of a source beyond the near field exceeds the side's target; an incident wave that is not known for
            the whole run.
        """
        if self.time_loop.source_checks is not None:
            with self.team.agreed():
                self.time_loop.source_checks.check(until)
        self._incident_notes = incident_wave_notes(self.incident, until) if self.incident else []

    def prepare(self, until: float) -> int:
        """Prepare the sides, sources and exact ends of a run, as `run` does first; returns the number of the last step.

        Raises
        ------
        InputError
            As in `check_sources`; a kernel or a domain that does not fit into memory.
        """
        self.team.alike({"run.until": until})
        if self._chooses:
            if not self.step_count:  # before layers are chosen for sources that the run cannot have
                self.check_sources(until)
            self._side_selection.select(self, until)
        self.check_sources(until)
        if self.model.order == 1:
            self._incident_notes += many_steps(self, until)
        layered = self.parts.layered
        if layered.undesigned and not self._end:
            warn(layered.undesigned)
        if layered.extents:
            known = extension_warnings(layered, self._end, self.dt)
            for text in extension_warnings(layered, until, self.dt):
                if text not in known:
                    warn(text)
        self._end = max(self._end, until)
        last = super().prepare(until)
        if self._recording is not None:
            self._recording.foresee(until, last)
        if self.parts.ends is not None:
            self.parts.ends.cover(last)
        return last

    def take(self, sides: Mapping[Key, Side]) -> None:
        """Replace some sides and return to the start of the run; raises InputError if the new sides cannot be used, and
        then leaves the run unchanged.
        """
        settled = self.setup if self.team else self.settled  # on several processes `settled` is that of one part
        named = {side_name(*key): boundary for key, boundary in {**settled.sides, **sides}.items()}
        seen: list[Observer] = [*self.observers, *self.recorders]
        changed = replace(settled, boundary=named, dt=self.dt)  # the step for which layers are chosen
        retaken = self.of(changed, seen, self.team, self.topology, self._back_end)
        alike = np.array_equal(retaken.start_u, self.start_u) and np.array_equal(retaken.start_v, self.start_v)
        if not (alike or self.team):
            # a function that is random, for example: its first values count
            first = {"u": self.start_u + self.background, "v": self.start_v}
            known = {name: value for name, value in first.items() if name in (settled.initial or {})}
            retaken = self.of(replace(changed, initial=known), seen, self.team, self.topology, self._back_end)
        kept = ("setup", "stop_requested", "probes", "_side_selection")
        self.__dict__ = retaken.__dict__ | {name: getattr(self, name) for name in kept}
        if self.probes is not None:
            self._set_probes(self.probes.nodes)

    @property
    def _given_layers(self) -> list[Any]:
        """The sides of the whole near field with layers that can be chosen or assessed."""
        given = self.setup.sides if self.team else self.sides
        return [b for b in given.values() if b.stretched and not b.whole]

    def _select_sides_alone(self) -> None:
        """Choose the sides that state a length of the run or a target, for that length or a usual one, if that has not
        been done for a run.
        """
        side_selection = self._side_selection
        if self.step_count or side_selection.good_for or side_selection.autos:
            return
        given = [b for b in self._given_layers if b.until or b.target is not None]
        if given:
            self._side_selection.select(self, max(b.until or 0.0 for b in given) or default_length(self.parts.near))

    def step(self, count: int = 1) -> None:
        """Advance by `count` steps, which the compiled loop computes without returning to Python.

        Raises
        ------
        UnstableError
            The field became non-finite or grew beyond all bounds.
        """
        last = self.step_count + kinds.integer(count, "count", least=0, most=MOST_STEPS)
        if self._chooses:
            self._select_sides_alone()
        time_loop, recording = self.time_loop, self._recording
        while self.step_count < last:
            with self.team.agreed():
                with uninterrupted():  # engine, records and clock change together
                    if self.setup.cracks:
                        time_loop.open_cracks(self.step_count)
                    steps = min(last - self.step_count, self.guard_steps)
                    if recording is not None:
                        steps = recording.allow(self.step_count, steps)
                    steps = time_loop.allow(self.step_count, steps)
                    for made in time_loop.advance(self.step_count, steps):
                        if recording is not None:
                            recording.add(self.step_count + 1)
                            if self.probes is not None:
                                self.probes.add(self.step_count + 1, self.dt, recording.probed())
                        advance_clock(self, made)
                values = self.parts.grid.core.view(self.engine.get("u"))
                scale = self.team.largest(time_loop.source_table.scale)
                place = self.parts.grid.origin, self.lattice.spacing, scale, self.step_count, self.time
                refuse_explosion(values, *place, lambda: likely_cause(self))
            if self.parts.phases is not None and self.setup.specimens and not self.cautions:
                if (warning := self.parts.phases.warning(self.team.largest(self.parts.phases.most))) is not None:
                    warn_once(self, "supersaturated", warning)
            if self.parts.impactors is not None and (warning := self.parts.impactors.warning()) is not None:
                warn_once(self, "impactor at a side", warning)
            if time_loop.relaxation is not None and (warning := time_loop.relaxation.warning()) is not None:
                warn_once(self, "not in equilibrium", warning)
            if time_loop.every:
                check_margin(self, time_loop.margin, time_loop.every)

    def _set_probes(self, nodes: np.ndarray) -> None:
        if self._recording is None:
            self._recording = Recording(self.setup, self.parts, team=self.team)
        self._recording.set_probes(nodes)

    # --- results -----------------------------------------------------------------------------------------------

    @property
    def fields(self) -> dict[str, np.ndarray]:
        """Copies of the fields in the near field."""
        return self.time_loop.fields()

    def energy(self) -> float:
        """Energy of the near field: kinetic plus strain energy, or stored energy, from `energies`."""
        return present(self.energies())

    def energies(self) -> dict[str, float]:
        """Energies of the near field; bonds across its edge count half, those to fixed sides and rims in full.

        Waves: "kinetic" and "strain", half a step ago, ``1/2 v . v`` and ``1/4 sum_k (u_k - u) . w_k (u_k^- - u^-)``
        times the density of an elastic medium, and, with a reaction r, "reaction", ``1/2 r u . u^-``; the undamped
        scheme conserves their sum exactly. With attenuation there is "kinetic" alone, or with ``balance=True`` also
        "strain", that of all springs, and "dissipated", what their dashpots have taken; the sum less the work is
        conserved to the square of the step. For an elastic or lossy medium with ``balance=True`` also "work", done
        since the start by sources, loads and prescribed nodes, and for a solid that is heated by its deformation
        "thermal", the energy of its temperature half a step ago, ``rho c theta . theta^- / 2 T0``; the strain energy is
        then that of the actual strains, and without conduction the sum of all three is conserved exactly. Diffusion:
        "stored", ``1/2 integral (u - background)^2``.

        Bonds that are nonlinear or break: the strain energy is ``c d d^- / 2`` of the elongations d and d^- now and a
        step ago. There are also "work", as above, and "broken", the energy that bonds held when they broke, also beyond
        sides that extend the domain. Where no energy leaves through the sides and nothing is damped, kinetic + strain +
        broken - work is conserved: exactly for linear bonds, otherwise to within the error of the time step. The work
        of "friction" between faces of cracks, if they have any, belongs to that sum.
        """
        return self.time_loop.energies()

    @property
    def broken_bonds(self) -> int:
        """Number of broken bonds, counted as in "broken" of `energies`; on several processes all must call it."""
        return round(self.team.total({"broken": self.engine.bonds.broken[1]})["broken"])

    def balance(self) -> dict[str, float]:
        """Gains of the near field since the start, by origin, for simulations with ``balance=True``.

        For an elastic medium: the `energies`, and "lost", the initial energy plus the work minus the present energy: it
        left through the sides or was damped, or is the time-stepping error of nonlinear bonds.

        Only free nodes count, that is, nodes that no condition prescribes. Every entry is a heat (for diffusion the
        integral of the field): heat capacity times cell volume times temperature.

        Returns
        -------
        dict
            "stored", the gain, for corrosion the sum of the gains of "metal" (what it has lost, negative) and
            "dissolved" (of the liquid); "source[i]", "constraint[i]", "x-", .. and "rim" or "outline": what came in
            from there; "reaction": minus what the reaction has consumed; "residual": "stored" minus all inflow, which
            is rounding error.

        Raises
        ------
        InputError
            The simulation does not record a balance.
        """
        if not self.setup.balance:
            raise InputError(
                "this simulation records no balance", key="balance", remedy="Simulation(..., balance=True)"
            )
        return self.time_loop.balance()

    def flux(self) -> np.ndarray:
        """Heat flux (or flux of a diffusing field) at the nodes along each axis, positive towards larger coordinates.

        One-sided sums over the bonds ahead of a node, or over those behind it where some ahead are missing, exact for a
        linear field; nan where the remaining bonds do not determine the flux. See
        `farhorizon.simulation.recorders.flux`.

        Returns
        -------
        ndarray, shape (dim, n..)
        """
        self.team.alone("fluxes at nodes")
        tables = flux_tables(self.parts.near, self.parts.grid, self.parts.phases)
        flux = nodal_flux(*tables, self.lattice.spacing)
        return flux if self.lattice.mask is None else np.where(self.lattice.mask, flux, np.nan)

    def power_across(self, axis: str, position: float) -> float:
        """Power across a plane, towards larger coordinates: the sum over the bonds of the near field that cross it.

        Parameters
        ----------
        axis : {"x", "y", "z"}
            Normal of the plane.
        position : float
            Coordinate of the plane, moved to the nearest midpoint between two nodes.

        Raises
        ------
        InputError
            An axis that the lattice does not have, a plane outside the lattice.
        """
        self.team.alone("powers across a plane (PowerThrough records them)")
        place = plane(self.lattice, axis, position)
        tables = flux_tables(self.parts.near, self.parts.grid, self.parts.phases)
        return power_across(*tables, self.lattice.spacing, *place)

    @property
    def notes(self) -> list[str]:
        """What is neglected beyond the near field, within the targets of the sides, or cannot be determined."""
        ends = [] if self.exact_ends is None else self.exact_ends.notes()
        overdue = extension_warnings(self.parts.layered, max(self._end, self.time), self.dt)
        chosen = self._side_selection.doubts + self._side_selection.why
        notes = self.parts.exterior.notes + ends + self._remarks + chosen + overdue + self._incident_notes
        return notes + self._soft + ([] if self._recording is None else self._recording.notes)

    @cached_property
    def _soft(self) -> list[str]:
        """Notes on bodies that are soft because they are thin, which are found when they are asked for."""
        return thin_note(self.setup, self.setup.sides)

    @property
    def thickness(self) -> dict[str, Thickness]:
        """The layers that were chosen for the data and the length of the run, with the errors that trial runs showed,
        by name of the side. They are chosen by `run` and `check`, which know the length; those of sides that state a
        length or a target also by `step` and on reading this attribute.
        """
        self._select_sides_alone()
        return self._side_selection.thickness

    @property
    def doubts(self) -> list[str]:
        """Warnings about layers and extended domains that miss their targets, or may miss them; `notes` has the first
        ones, too.
        """
        layered = self.parts.layered
        return layered.doubts + self._side_selection.doubts + [layered.undesigned] * bool(layered.undesigned)

    @property
    def ends(self) -> dict[str, str]:
        """Representation of each exact end: modes and error bound of its sum, and the number of steps it covers."""
        ends = self.exact_ends
        return {} if ends is None else {name: ends.describe(i, self.dt) for i, name in enumerate(ends.names)}

    # --- checks before a run -----------------------------------------------------------------------------------

    @property
    def exact_ends(self) -> ExactEnds | None:
        """The exact ends; None if there are none."""
        return self.parts.ends

    @property
    def crossing(self) -> float:
        """The set-up's own unit of time: the time in which the fastest wave crosses the near field, or ``R^2/D``, in
        which diffusion empties it.
        """
        return self.parts.near.crossing

    @property
    def targets(self) -> dict[Key, float]:
        """Fraction of the largest value that may be neglected beyond each absorbing side."""
        return self.parts.exterior.targets

    def extents_for(self, wanted: Mapping[Key, float], until: float) -> dict[Key, Extent]:
        """How far the medium must be computed beyond some sides; see `farhorizon.simulation.sides.extension`."""
        return self.parts.emitters.extents_for(wanted, until)

    def remade(self, **changes: Any) -> Simulation:
        """The same set-up at its start with some arguments changed, with the same time step and layers unless the model
        changes; on another lattice there are no data, and the medium is uniform, as stiff as its stiffest part.
        """
        return Simulation.of(remade_setup(self.setup, self.settled, self.parts, changes))

    def shortened(self) -> Simulation | None:
        """The same set-up at rest, with shorter stretches of equal planes of a medium that varies; None where this is
        not much smaller.
        """
        setup = shortened_setup(self.setup, self.settled, self.parts)
        return None if setup is None else Simulation.of(setup)

    def certificate(self, budget: float = BUDGET, until: float = np.inf) -> Certificate:
        """Determine whether the complete update, that is, the near field with all memory of the boundaries, is stable;
        see `farhorizon.checks.certificate`.

        Parameters
        ----------
        budget : float
            Seconds that this may take on a typical core. Operations are counted, so that the verdict depends on neither
            the machine nor its load; whatever is not examined is named.
        until : float
            Length of the run: white noise is followed for as long as this, up to ten crossing times.
        """
        self.team.alone("certificates")
        if self.setup.load_steps is not None:
            return Certificate(CERTIFIED, "load steps are damped", rate=0.0)
        if self._chooses:
            self._select_sides_alone()
        return certify(self if self._back_end is None else self.remade(), budget, until)

    def seconds_per_step(self) -> float:
        """Time per step on this machine at present, measured for a tenth of a second without sources; the state is not
        changed.
        """
        self.team.alone("measured times")
        self._compiled("measured times")
        return seconds_of(self.engine)

    def check(self, until: float | None = None, budget: float | None = None) -> Report:
        """Report before running: step limit, stability certificate, predicted reflection, layers, memory, time,
        warnings and notes, and the communication between several processes.

        Parameters
        ----------
        until : float, optional
            End of the run, for the estimate of its time.
        budget : float, optional
            Seconds for the certificate. By default it takes about as long as the run to `until`, but from 5 to 30; 30
            without `until`.
        """
        self.team.alone("reports")
        if self._back_end is not None:
            return self.remade().check(until, budget)
        if until is None:
            self._select_sides_alone()
        else:
            self._side_selection.select(self, checked_end(until, self.dt))
            self._side_selection.assess_given(self, until)
            self.check_sources(until)
            if self._recording is not None:
                self._recording.foresee(until, last_step(until, self.dt))
        return Report.of(self, until, budget, rows_on_processes(self, self.topology))

    def _compiled(self, what: str) -> None:
        """Refuse what reads the memory of the layers, which another engine keeps to itself."""
        if self._back_end is not None:
            raise InputError(f"{what} are those of compiled code", key="engine", remedy="leave it out")

    # --- state -------------------------------------------------------------------------------------------------

    def save(self, path: str | Path, **extra: Any) -> None:
        """Write the complete state, with the memory of the boundaries, to a temporary file, which is then renamed."""
        self._compiled("saved states")
        kept = {"cautions": self.cautions, "extra": extra, **progress_of(self)}
        path, given = kinds.path(path, "path"), self.given if self.subdomain is None else self.subdomain.given
        recorded = {} if self._recording is None else self._recording.state()
        write_state(path, self.time_loop, self.step_count, recorded, kept, given)

    def load(self, path: str | Path) -> dict[str, Any]:
        self._compiled("saved states")
        with self.team.agreed():
            self._side_selection.adopt(self, path)
        step, arrays, meta = read_state(kinds.path(path, "path"), self.time_loop)
        self.step_count, self.time = step, step * self.dt
        if self._recording is not None:
            self._recording.take(arrays, self.step_count)
        self.cautions = [Caution(*entry) for entry in meta["cautions"]]
        take_progress(self, meta)
        return dict(meta["extra"])

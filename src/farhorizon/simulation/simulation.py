"""Simulation: a set-up that runs, and what comes out of it."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from farhorizon import kinds
from farhorizon.analysis.extent import Extent
from farhorizon.boundaries import ExactEnds, Side
from farhorizon.checks.certificate import BUDGET, Certificate, certify
from farhorizon.checks.report import Report
from farhorizon.errors import InputError
from farhorizon.files.results import Caution, read_checkpoint, write_checkpoint
from farhorizon.geometry.lattice import Lattice
from farhorizon.inputs.conditions import Constraint
from farhorizon.inputs.loads import BodyForce, Traction
from farhorizon.inputs.prescribed import Prescribed
from farhorizon.inputs.specimens import Specimen
from farhorizon.models import LatticeModel
from farhorizon.simulation.assembly import Parts, assemble
from farhorizon.simulation.books import Books
from farhorizon.simulation.checkpoint import fingerprint, state_of, take_rest, take_state
from farhorizon.simulation.described import describe, rebuild
from farhorizon.simulation.drives import Moving
from farhorizon.simulation.energies import energies
from farhorizon.simulation.feed import Feed
from farhorizon.simulation.flux import flux_tables, nodal_flux, plane, power_across
from farhorizon.simulation.guard import likely_cause
from farhorizon.simulation.run import MOST_STEPS, Run
from farhorizon.simulation.settling import Settling, late, settled_sides
from farhorizon.simulation.setup import Key, Setup, side_name
from farhorizon.simulation.start import Motion
from farhorizon.simulation.steps import seconds_of


class Simulation(Run):
    """One run of a model on a lattice.

    Parameters
    ----------
    lattice : Lattice
        The near field.
    model : Wave, Diffusion, Heat, Corrosion, Beam or Elastic
    boundary : Side or mapping
        One for all sides, or ``{"x-": ..., "x+": ..., "y": ..., "all": ...}``.
    initial : mapping
        "u" and, for waves, "v" (velocity): arrays of the lattice's shape, callables of the coordinates, expressions or
        numbers. Of vectors arrays (dim, n..), callables that return the components, or a sequence of one value a
        component.
    sources : sequence
        `Source`, array, callable of the coordinates and t, expression, or `IncidentWave`.
    loads : sequence of BodyForce and Traction
        Forces on an `Elastic` medium per volume, and per area on its free sides (bond-based materials).
    cracks : sequence
        Cuts, points of polylines (2D), of polygons (3D) or positions (1D); `Crack` for one that conducts a little or
        opens later.
    constraints : sequence
        `Temperature`, `Flux`, `Insulated`, `Convection`: conditions on nodes of the body; `Prescribed`: nodes that
        follow a value for a while.
    specimens : sequence of Specimen
        The metal of a `Corrosion`; all else is liquid.
    balance : bool
        Record what flows into the near field, for `balance`; of an `Elastic` medium the energies and the work of
        sources and loads.
    coefficient : array_like, optional
        Factor on bonds, given on the nodes.
    rule : {"both", "arithmetic", "harmonic"}
        How the coefficients of a bond's ends combine; "both" is the smaller one.
    rim : {"free", "fixed"}
        What the outline of a body is: bonds across it are absent, or the field is held at the background outside.
    background : float
        Uniform state of the infinite medium.
    dt : float or callable, optional
        Time step; half the stable limit unless given. A function of that default gives another one: `WholeSteps`.
    dtype : {"float64", "float32"}
    threads : int, optional
        All that the machine offers unless given; small lattices use one.

    Attributes
    ----------
    time : float
    step_count : int
    dt : float
    setup : Setup
        What was given.
    settled : Setup
        The same with the time step, the sides and the factors on bonds as they were chosen: run again it does not
        choose anew.
    stop_requested : bool
        Set it (from a signal handler, an observer) to end `run` with KeyboardInterrupt between two steps.
    closure : Closure or None
        The conditions along the outline of the near field.
    start_u, start_v : ndarray
        Initial values less the background, and initial velocities.
    fields : dict of str to ndarray
        The near field, "u", vectors as (dim, n..), and for waves "v" (half a step late, (u(n) - u(n-1))/dt); nan
        outside a window or body, and on the nodes beyond a wall that conditions set as images of those inside. Of bonds
        that are nonlinear or break "damage", the part of a node's bonds that are cut or broken. Of a corrosion "solid",
        1 in the metal and 0 in the liquid, and "dissolved", the time at which a node became liquid: 0 where it was from
        the start, nan in the metal.

    Raises
    ------
    InputError
        Anything that cannot be computed, before any work.

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
        observe: Sequence[Callable[[Simulation], None]] = (),
        dt: float | Callable[[float], float] | None = None,
        dtype: str = "float64",
        threads: int | None = None,
        rule: str = "both",
        rim: str = "free",
        constraints: Sequence[Constraint | Prescribed] = (),
        balance: bool = False,
        specimens: Sequence[Specimen] = (),
        loads: Sequence[BodyForce | Traction] = (),
    ) -> None:
        self._begin(
            Setup(
                lattice,
                model,
                boundary,
                initial,
                sources,
                cracks,
                coefficient,
                background,
                dt,
                dtype,
                threads,
                rule,
                rim,
                constraints,
                balance,
                specimens,
                loads,
            ),
            observe,
        )

    @classmethod
    def of(cls, setup: Setup, observe: Sequence[Callable[[Simulation], None]] = ()) -> Self:
        """A run of a set-up.

        Parameters
        ----------
        setup : Setup
        observe : sequence of callable
            As of the constructor.
        """
        run = cls.__new__(cls)
        run._begin(setup, observe)
        return run

    def _begin(self, setup: Setup, observe: Sequence[Callable[[Simulation], None]]) -> None:
        """Be at the start of a set-up."""
        self.setup = setup
        parts = self._put_together(setup)
        self._at_start(observe, int(np.prod(parts.grid.engine.core.nodes)))
        open_ended = [key for key, b in self.sides.items() if b.open_ended]
        self._settling = Settling(parts.autos, open_ended)
        self._lay_start()

    def _put_together(self, setup: Setup) -> Parts:
        """Make the parts, and show what others read of them."""
        self.parts = parts = assemble(setup)
        near, around = parts.near, parts.around
        self.lattice, self.model, self.background, self.dt = near.lattice, near.model, near.background, near.dt
        self.stencil, self.engine, self.sides, self.closure = (
            near.stencil,
            parts.grid.engine,
            around.sides,
            parts.closure,
        )
        self.step_limit, self.rate_limit, self.field_shape = near.step_limit, near.rate_limit, near.field_shape
        self.strongest, self.conditions = near.strongest, near.conditions
        self.varied = bool(parts.start.solid.any() or (near.factor is not None and np.ptp(near.factor) > 0))
        self.start_u, self.start_v = parts.start.u, parts.start.v
        self.sources, self.incident = parts.drives.sources, parts.incident
        self.coefficients, self.thickness, self.extents = around.coefficients, around.thickness, around.extents
        sides = settled_sides(around, near.model)
        self.settled = replace(setup, boundary=sides, coefficient=near.factor, dt=near.dt)
        return parts

    def _lay_start(self) -> None:
        """Give the engine the start, and what goes on from it."""
        parts, near, engine = self.parts, self.parts.near, self.engine
        self._end = 0.0  # of the run, as far as it is known
        self._moving = Moving(parts.drives.unsplit, parts.beyond, near.dt)
        self._books: Books | None = None
        self._opened = len(self.setup.cracks)
        self._open_cracks()
        self._first_cuts = engine.absent_bonds
        held = [abs(b.held - near.background) for b in self.sides.values() if b.held is not None]
        largest = float(np.abs(self.start_u).max()), float(np.abs(self.start_v).max()) * near.dt
        self._feed = Feed(near, parts.grid, parts.driving, parts.phases, max([*largest, 1e-300, *held]))
        self._motion = Motion(near, parts.grid, parts.ends, self._feed.force)
        # all, for the sweep leaves out metal that nothing reaches
        for level in engine.levels[: 1 if self.model.order == 2 else None]:
            parts.grid.view(level)[...] = self.start_u.reshape(parts.grid.view(level).shape)
        self._feed.tie()
        self._feed.hold(0)
        if self.model.order == 2:
            # the medium beyond an outline is at rest
            outside = np.zeros(0, np.int64) if self.closure is None else self.closure.unmoved
            self._motion.step_back(self.start_v, np.concatenate([parts.held, outside]))
        if self.closure is not None:
            self.closure.start()
        if parts.breaking is not None:
            parts.breaking.check_start(self._feed.force(0.0))
        self._first_energy = self.energy() if self.setup.balance and self.setup.lasting else 0.0
        if self.setup.balance and not self.setup.lasting:
            self._books = Books(
                self.setup, near, self.sides, parts.grid, parts.phases, parts.ends, self._feed, len(self.sources)
            )
        self._set_rim()

    # --- running -----------------------------------------------------------------------------------------------

    def _open_cracks(self) -> None:
        """Cut what has opened by now."""
        due = [crack for crack in self.setup.cracks if crack.opens <= self.time + 1e-9 * self.dt]
        if len(due) == self._opened:
            return
        breaking, begun = self.parts.breaking, bool(self.step_count)
        stored = breaking.strain_energy() if breaking is not None and begun else 0.0
        if breaking is not None and not begun:
            breaking.begin()
        self.parts.cuts.cut(due)
        if breaking is not None and stored:
            self.engine.book_cut((stored - breaking.strain_energy()) / breaking.mass)
        self._opened = len(due)
        if self._books is not None and begun:
            self._books.reopen()
        if begun:
            self._set_rim()

    def _set_rim(self) -> None:
        """Where bonds would break, but cannot."""
        self._rim = None if self.parts.breaking is None else self.parts.breaking.rim()
        if self._rim is not None:
            self._guard_steps = min(self._guard_steps, self._rim.every)

    def check_sources(self, until: float) -> None:
        """Look beyond the absorbing sides at sources that do not split into space and time, at up to 64 even times up
        to the end of the run; `run` calls it.

        Raises
        ------
        InputError
            The near field would miss more of a source than the side's target.
        """
        self._moving.check(until)

    def prepare(self, until: float) -> int:
        """What `run` does first: sides that depend on the length of the run, `check_sources`, and kernels of exact ends
        that last to the end of the run; returns the number of the last step.

        Raises
        ------
        InputError
            As `check_sources`; a kernel or a domain that does not fit into memory.
        """
        self._settle(until)
        self.check_sources(until)
        self._end = max(self._end, until)
        last = super().prepare(until)
        if self.exact_ends is not None:
            self.exact_ends.cover(last)
        return last

    def _settle(self, until: float) -> None:
        if not self.step_count:
            self._settling.settle(self, until)

    def take(self, sides: Mapping[Key, Side]) -> None:
        """Be at the start of the same run with some other sides.

        Raises
        ------
        InputError
            Sides that do not serve; the run is as it was.
        """
        named = {side_name(*key): boundary for key, boundary in {**self.settled.sides, **sides}.items()}
        other = self.of(replace(self.settled, boundary=named))
        kept = ("setup", "observers", "stop_requested", "probes", "_settling")
        self.__dict__ = other.__dict__ | {name: getattr(self, name) for name in kept}
        if self.probes is not None:
            self._watch(self.probes.nodes)

    def step(self, count: int = 1) -> None:
        """Advance by `count` steps; the compiled loop runs them without returning to Python.

        Raises
        ------
        UnstableError
            The field became non-finite or exploded.
        """
        count, done = kinds.integer(count, "count", least=0, most=MOST_STEPS), 0
        holds, ends = self.parts.near.holds, self.exact_ends
        while done < count:
            self._open_cracks()
            opening = [int(np.ceil(c.opens / self.dt - 1e-9)) - self.step_count for c in self.setup.cracks]
            steps = min(
                count - done, self._guard_steps, min((wait for wait in opening if wait > 0), default=sys.maxsize)
            )
            if holds.constraints:
                steps = holds.allow(self.step_count, steps)
            if ends is not None:
                steps = ends.allow(steps)
            self._advance(steps)
            if holds.constraints:
                if self.model.order == 2:
                    self._motion.release(self.step_count)
                self._feed.hold(self.step_count)
            done += steps
            self._look()

    def _advance(self, steps: int) -> None:
        for batch in self._feed.advance(self.step_count, steps):
            if self.probes is not None:  # the engine has seen the steps that come after the present one
                seen = self.engine.seen.reshape(len(self.engine.seen), self.engine.components, -1) + self.background
                hidden = self.parts.near.hidden
                if hidden is not None:
                    seen[..., hidden.ravel()[self.probes.nodes]] = np.nan
                rows = seen[:, 0] if self.engine.components == 1 else seen.swapaxes(1, 2)
                self.probes.add(self.step_count + 1, self.dt, rows)
            if self._books is not None:
                self._books.add(batch)
            self._tick(batch.steps)

    def _look(self) -> None:
        """See whether the state is sound."""
        level, phases = self.engine.current, self.parts.phases
        self._refuse_explosion(
            self.engine.core.view(level), self.parts.grid.origin, self._feed.scale, lambda: likely_cause(self)
        )
        most = None if phases is None or self.cautions else phases.supersaturated()
        if most is not None:
            self._caution(
                "supersaturated",
                f"the liquid holds up to {most:.3g} times the saturation: metal dissolves faster than it diffuses "
                "away; take limited = true, or an interface for the speed of the front (Corrosion.interface_for)",
            )
        self._look_at(self._rim, level)

    def _watch(self, nodes: np.ndarray) -> None:
        self.engine.watched = self.parts.grid.indices.reshape(self.engine.components, -1)[:, nodes].ravel()

    # --- what comes out ----------------------------------------------------------------------------------------

    def _visible(self, values: np.ndarray) -> np.ndarray:
        """The values, nan on nodes that are not shown."""
        hidden = self.parts.near.hidden
        return values if hidden is None else np.where(hidden, np.nan, values)

    @property
    def fields(self) -> dict[str, np.ndarray]:
        """Copies of the near field."""
        parts, shape = self.parts, self.field_shape
        out = {"u": self._visible(parts.grid.view(self.engine.current).reshape(shape) + self.background)}
        if self.model.order == 2:
            before = self._visible(parts.grid.view(self.engine.older).reshape(shape) + self.background)
            out["v"] = (out["u"] - before) / self.dt
        if parts.breaking is not None:
            out["damage"] = self._visible(parts.breaking.damage)
        if parts.phases is not None:
            solid = parts.phases.solid
            out["solid"] = self._visible(solid.astype(float))
            out["dissolved"] = self._visible(np.where(solid, np.nan, self.dt * parts.phases.steps))
        return out

    def energy(self) -> float:
        """Energy of the near field, kinetic and strain or stored, of `energies`."""
        return sum(value for name, value in self.energies().items() if name in ("kinetic", "strain", "stored"))

    def energies(self) -> dict[str, float]:
        """Energies of the near field; bonds across its edge count half, to a side fixed at the background whole.

        Waves: "kinetic" and "strain", half a step ago, ``1/2 v . v`` and ``1/4 sum_k (u_k - u) . w_k (u_k^- - u^-)``
        times the density of an elastic medium; the undamped scheme conserves their sum exactly. Of an elastic medium
        with ``balance=True`` "work", done by sources and loads since the start. Diffusion: "stored", ``1/2 integral (u
        - background)^2``.

        Bonds that are nonlinear or break: the strain energy is ``c d d^- / 2`` of the elongations d and d^- now and a
        step ago, and there are "work", done by the sources since the start, and "broken", what bonds held when they
        broke. Where no energy leaves through the sides and nothing is damped, kinetic + strain + broken - work stays as
        it was: exactly for linear bonds, else up to the error of the time step.
        """
        parts = self.parts
        return energies(parts.near, self.sides, parts.grid, parts.ends, parts.breaking, self.setup.lasting)

    @property
    def broken_bonds(self) -> int:
        """Bonds that have broken since the start."""
        return self.engine.broken[1]

    def balance(self) -> dict[str, float]:
        """What the near field has gained since the start, and from where, for simulations with ``balance=True``.

        Of an elastic medium: the `energies`, and "lost", what is missing to the energy at the start and the work: it
        left through the sides or was damped, or is the error of the time step of nonlinear bonds.

        Free nodes count: those that no condition prescribes. Every entry is heat (the field's integral for a
        diffusion): heat capacity times cell volume times temperature.

        Returns
        -------
        dict
            "stored", the gain, of a corrosion the sum of the gains of "metal" (what it has lost, negative) and
            "dissolved" (of the liquid); "source[i]", "constraint[i]", "x-", .. and "rim" or "outline": what came in
            from there; "residual": "stored" less all that came in, which is rounding.

        Raises
        ------
        InputError
            The simulation does not record it.
        """
        if not self.setup.balance:
            raise InputError(
                "this simulation records no balance", key="balance", remedy="Simulation(..., balance=True)"
            )
        if self._books is not None:
            return self._books.balance()
        found = self.energies()
        return {**found, "lost": self._first_energy + 2 * found["work"] - sum(found.values())}

    def flux(self) -> np.ndarray:
        """Heat flux (or that of a diffusing field) at the nodes along each axis, positive towards larger coordinates.

        One-sided sums over the bonds ahead of a node, over those behind it where bonds ahead are missing, exact for a
        linear field at every node; nan where the bonds left do not determine it. See `farhorizon.simulation.flux`.

        Returns
        -------
        ndarray, shape (dim, n..)
        """
        tables = flux_tables(self.parts.near, self.parts.grid, self.parts.phases)
        found = nodal_flux(*tables, self.lattice.spacing)
        return found if self.lattice.mask is None else np.where(self.lattice.mask, found, np.nan)

    def power_across(self, axis: str, position: float) -> float:
        """Power that crosses a plane, towards larger coordinates: the sum over the bonds of the near field that cross
        it.

        Parameters
        ----------
        axis : {"x", "y", "z"}
            Normal of the plane.
        position : float
            Coordinate of the plane, taken to the nearest middle between two nodes.

        Raises
        ------
        InputError
            An axis that the lattice has not, a plane outside it.
        """
        place = plane(self.lattice, axis, position)
        tables = flux_tables(self.parts.near, self.parts.grid, self.parts.phases)
        return power_across(*tables, self.lattice.spacing, *place)

    @property
    def notes(self) -> list[str]:
        """What lies beyond the near field and is missed, but within the sides' targets, or cannot be known."""
        ends = [] if self.exact_ends is None else self.exact_ends.notes()
        overdue = late(self.parts.around, max(self._end, self.time), self.dt)
        return self.parts.beyond.notes + ends + self._remarks + self._settling.why + overdue

    @property
    def ends(self) -> dict[str, str]:
        """What serves each exact end: modes and error bound of its sum, and for how many steps."""
        ends = self.exact_ends
        return {} if ends is None else {name: ends.describe(i, self.dt) for i, name in enumerate(ends.names)}

    # --- what the checks ask -----------------------------------------------------------------------------------

    @property
    def exact_ends(self) -> ExactEnds | None:
        """The exact ends; None without."""
        return self.parts.ends

    @property
    def crossing(self) -> float:
        """The set-up's own unit of time: in it the fastest wave crosses the near field, or what diffuses empties it,
        ``R^2/D``.
        """
        return self.parts.near.crossing

    @property
    def targets(self) -> dict[Key, float]:
        """What may be missed beyond each side that absorbs, as a part of the largest value."""
        return self.parts.beyond.targets

    def leak(self) -> np.ndarray:
        """Rate at which each node loses its value to what surrounds the body; of the lattice's shape, empty without."""
        return self.parts.near.leak

    def extents_for(self, wanted: Mapping[Key, float], until: float) -> dict[Key, Extent]:
        """How far the medium must be computed beyond some sides; see `farhorizon.simulation.extension`."""
        return self.parts.emitters.extents_for(wanted, until)

    def remade(self, **changes: Any) -> Simulation:
        """The same set-up at its start with some arguments changed; on another lattice nothing is there, and the medium
        is uniform, as stiff as it is anywhere.
        """
        start: dict[str, Any] = {}
        if "lattice" in changes:
            nothing = dict.fromkeys(("sources", "loads", "cracks", "constraints", "specimens"), ())
            changes = {**nothing, "coefficient": None, "rim": "free", "balance": False, **changes}
            if self.parts.near.factor is not None and self.strongest > 0:
                changes["model"] = changes.get("model", self.model).scaled(self.strongest)
        else:
            start["u"] = self.start_u + float(changes.get("background", self.background))
            start |= {"v": self.start_v} if self.model.order == 2 else {}
        return Simulation.of(replace(self.settled, **{"initial": start, **changes}))

    def certificate(self, budget: float = BUDGET, until: float = np.inf) -> Certificate:
        """Whether the complete update, near field and all memory of the boundaries, is stable; see
        `farhorizon.checks.certificate`.

        Parameters
        ----------
        budget : float
            Seconds that it may take; what is not examined in that time is named.
        until : float
            Length of the run: noise for as long is enough, up to ten crossing times.
        """
        return certify(self, budget, until)

    def seconds_per_step(self) -> float:
        """Time of a step on this machine now, measured for a tenth of a second without sources; the state stays as it
        is.
        """
        return seconds_of(self.engine)

    def check(self, until: float | None = None, budget: float | None = None) -> Report:
        """Step limit, stability certificate, predicted reflection, layer, memory, time, warnings and notes, before
        running.

        Parameters
        ----------
        until : float, optional
            End of the run, for its estimated time.
        budget : float, optional
            Seconds for the certificate. Unless given all of it takes about as long as the run to `until`, from 2 to 30;
            30 without `until`.
        """
        if until is not None:
            self._settle(until)
        return Report.of(self, until, budget)

    # --- state -------------------------------------------------------------------------------------------------

    def _fingerprint(self) -> dict[str, Any]:
        return fingerprint(self.setup, self.parts, self._first_cuts)

    def save(self, path: str | Path, **extra: Any) -> None:
        """Write the complete state, boundary memory included, under a temporary name and rename it."""
        self._open_cracks()  # as the next step begins: `load` opens what is due at that time
        arrays, meta = state_of(self.parts, self._books)
        meta |= {
            "fingerprint": self._fingerprint(),
            "step": self.step_count,
            "scale": self._feed.scale,
            "cautions": self.cautions,
            "extra": extra,
        }
        given = {name: value for name, value in self.settled.arguments.items() if name != "initial"}
        meta["setup"] = describe(given, arrays)
        write_checkpoint(path, arrays, meta)

    @classmethod
    def _start_of(cls, arrays: dict[str, np.ndarray], meta: dict[str, Any]) -> dict[str, Any]:
        initial = {"u": arrays["start_u"] + rebuild(meta["setup"]["dict"]["background"], arrays)}
        return {"initial": initial | ({"v": arrays["start_v"]} if np.any(arrays["start_v"]) else {})}

    def _adopt(self, path: str | Path) -> None:
        """Take the sides of the run that wrote a checkpoint, as far as its length or its price chose them."""
        arrays, meta = read_checkpoint(path)
        if self.step_count or "setup" not in meta:
            return
        theirs = rebuild(meta["setup"]["dict"]["boundary"], arrays)
        names = {key: side_name(*key) for key in {*self._settling.open_ended, *self._settling.autos}}
        if all(theirs[name].stretched or theirs[name].extended for name in names.values() if name in theirs):
            self.take({key: theirs[name] for key, name in names.items()})

    def load(self, path: str | Path) -> dict[str, Any]:
        if self._settling.open_ended or self._settling.autos:
            self._adopt(path)
        arrays, meta = self._read(path)
        self.step_count, self._feed.scale = 0, float(meta["scale"])
        self._tick(int(meta["step"]))
        self.cautions = [Caution(*entry) for entry in meta["cautions"]]
        take_state(self.parts, arrays, meta, self.step_count)
        self._feed.hold(self.step_count)
        self._open_cracks()
        take_rest(self.parts, self._books, arrays, meta)
        return dict(meta["extra"])

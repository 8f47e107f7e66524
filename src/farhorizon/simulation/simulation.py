"""Simulation: runs what `farhorizon.simulation.assembly` has put together, and says what comes out."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any, Self

import numpy as np

from farhorizon import kinds
from farhorizon.boundaries import ExactEnds, Side
from farhorizon.checks.certificate import BUDGET, Certificate, certify
from farhorizon.checks.price import extended_price, price
from farhorizon.checks.report import Report
from farhorizon.errors import InputError
from farhorizon.files.results import Caution, read_checkpoint, write_checkpoint
from farhorizon.geometry.lattice import AXES, Lattice
from farhorizon.inputs.conditions import Constraint
from farhorizon.inputs.loads import BodyForce, Traction
from farhorizon.inputs.prescribed import Prescribed
from farhorizon.inputs.sources import steady
from farhorizon.inputs.specimens import Specimen
from farhorizon.machine import available_memory
from farhorizon.medium.integrators import stage_effects
from farhorizon.models import LatticeModel
from farhorizon.simulation.assembly import Assembly
from farhorizon.simulation.described import describe, rebuild
from farhorizon.simulation.flux import nodal_flux, power_across
from farhorizon.simulation.overstretch import Rim, rim_of
from farhorizon.simulation.run import MOST_STEPS, Run
from farhorizon.simulation.setup import Setup, side_name

_SHATTERS = 10.0  # a load whose first strain is so many times the critical stretch breaks whatever it meets
_SUPERSATURATED = 0.05  # part of the saturation by which liquid may exceed it without a word
_TABLE = 1 << 20  # numbers in one table of source amplitudes


class Simulation(Assembly, Run):
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
        super().__init__(setup)
        self._at_start(observe, int(np.prod(self.engine.core.nodes)))
        self._source_peaks: dict[int, float] = {}
        self._end = 0.0  # of the run, as far as it is known
        self._good_for = 0.0  # length of the run that the sides are good for, as far as they are chosen for one
        self._why: list[str] = []  # how sides that leave the choice were chosen
        self._open_ended = [key for key, b in self.sides.items() if b.open_ended]
        self._looked = 0.0  # up to this time
        self._books = setup.balance and not self.lasting
        self._opened = len(self._cracks)
        self._open_cracks()
        self._first_cuts = self.engine.absent_bonds
        held = [abs(b.held - self.background) for b in self.sides.values() if b.held is not None]
        self.setup = setup
        self.settled = replace(setup, boundary=self._settled_sides(), coefficient=self._factor, dt=self.dt)
        self._scale = max(
            [float(np.abs(self.start_u).max()), float(np.abs(self.start_v).max()) * self.dt, 1e-300, *held]
        )
        self._start(self.start_u, self.start_v)
        if self.bondwise:
            self._check_stretch()
        self._first_energy = self.energy() if setup.balance and self.lasting else 0.0
        if self._books:
            self._open_books()
        self._set_rim()

    # --- start -------------------------------------------------------------------------------------------------

    def _start(self, u: np.ndarray, v: np.ndarray) -> None:
        engine = self.engine
        # all, for the sweep leaves out metal that nothing reaches
        for level in engine.levels[: 1 if self.model.order == 2 else None]:
            engine.core.view(level)[self._near] = u.reshape(engine.core.view(level)[self._near].shape)
        near = self._near_indices()
        self._source_nodes = near if self._drives else np.zeros(0, np.int64)
        table = self.conditions
        engine.set_tied(near[table.nodes], table.starts, near[table.references], table.weights)
        if table.nodes.size:
            fields, amplitudes = self._tables(table.drives, table.nodes.shape, (0.0,), np.ones((1, 1)), 1)
            self._scale = max(self._scale, float(np.abs(fields).max(initial=0) * np.abs(amplitudes).max(initial=0)))
            engine.tie(amplitudes[0, 0] @ fields)
        self._hold()
        self._step_back(v)
        if self.closure is not None:
            self.closure.start()

    def _step_back(self, v: np.ndarray) -> None:
        """The level one step before the start, for equations of second order."""
        engine = self.engine
        if self.model.order == 1:
            return
        acceleration = self._acceleration()
        change = -(self.dt**2) / 2 * acceleration
        rate = engine.core.view(change)[self._near]
        rate += (self.dt * (1 + self.model.damping * self.dt) * v).reshape(rate.shape)
        change[self._held] = 0
        if self.closure is not None:
            change[self.closure.unmoved] = 0  # the medium beyond the outline is at rest
        if engine.stages.increments:
            engine.levels[2][:] = change
        box = engine.layout.box
        box.view(engine.levels[1])[...] = box.view(engine.levels[0]) - box.view(change)
        engine.memory[:] = 0  # the layers are at rest one step before the start
        engine.remind(engine.levels[1])

    def _acceleration(self) -> np.ndarray:
        """What the medium, what lies beyond exact ends and the sources do to the present state, as a level."""
        acceleration = self.engine.apply(self.engine.current)
        if self._ends is not None:
            acceleration[self._ends.nodes] += self._ends.forces()
        near = self.engine.core.view(acceleration)[self._near]
        near += self._source_now(self.time).reshape(near.shape)
        return acceleration

    def _hold(self) -> None:
        """Tell the engine which nodes are held from now on."""
        self.engine.hold(self._near_indices()[self._holds.held(self.step_count)])

    def _check_stretch(self) -> None:
        """Bonds that the start, or the first strain of a load, would break at once."""
        law = self.model.bond_law
        limit = np.inf if law is None else law.critical_stretch_on(self.lattice.spacing, self.lattice.dim)
        if law is None or not np.isfinite(limit):
            return
        factor = np.broadcast_to(1.0 if self._factor is None else self._factor, self.field_shape)
        strain = self.engine.largest_strain()
        stretch = float(np.sqrt(1 + strain) - 1 if law.nonlinear else strain / 2)
        if stretch > limit:
            raise InputError(
                "the initial displacements stretch bonds beyond the critical stretch",
                value=f"{limit:.6g}",
                limit=f"> {stretch:.4g}",
                key="model.critical_stretch",
                remedy="a smaller start, or cracks",
            )
        force = np.abs(self._source_now(0.0)) / self.model.source_factor
        strain = (
            float(np.divide(force, factor, out=np.zeros_like(force), where=factor > 0).max(initial=0))
            * self.lattice.spacing
        )
        strain /= law.p_modulus
        if strain > _SHATTERS * limit:
            raise InputError(
                "the critical stretch is far below the first strain of the load, which would shatter what it meets",
                value=f"{limit:.6g}",
                limit=f">= {strain / _SHATTERS:.3g}",
                key="model.critical_stretch",
                remedy="a smaller load, or one that rises in time",
            )
        if strain > limit:
            self._beyond.notes.append(
                f"the load's first strain, about {strain:.3g}, is above the critical stretch {limit:.3g}: bonds break "
                "at once"
            )

    # --- running -----------------------------------------------------------------------------------------------

    def _release(self) -> None:
        """Let nodes go whose constraint ends now: the next step is their first, as the start is of all."""
        engine = self.engine
        for nodes, rate in self._holds.released(self.step_count) if self.model.order == 2 else ():
            at = self._near_indices()[nodes]
            change = self.dt * (1 + self.model.damping * self.dt) * rate - self.dt**2 / 2 * self._acceleration()[at]
            engine.older[at] = engine.current[at] - change
            if engine.stages.increments:
                engine.levels[2][at] = change
        self._hold()

    def _open_cracks(self) -> None:
        """Cut what has opened by now."""
        due = [crack for crack in self._cracks if crack.opens <= self.time + 1e-9 * self.dt]
        if len(due) != self._opened:
            stored = self._strain_energy() if self.bondwise and self.step_count else 0.0
            if self.bondwise and not self.step_count:
                self._set_bonds()
            self._cut(due)
            if stored:
                self.engine.book_cut((stored - self._strain_energy()) / self._mass)
            self._opened = len(due)
            if self._books and self.step_count:
                self._open_books()
            if self.step_count:
                self._set_rim()

    def _set_rim(self) -> None:
        """Where bonds would break, but cannot; looked at each time that a longitudinal wave has crossed one reach."""
        self._rim: Rim | None = None
        law = self.model.bond_law
        if law is None:
            return
        engine, lattice, lead = self.engine, self.lattice, 3 - self.lattice.dim
        low, high = (
            np.array(edge[lead:]) - [self._margins[a, -1] for a in range(lattice.dim)]
            for edge in (self._zone.first, self._zone.end)
        )
        crossing = min(self.stencil.reach) * lattice.spacing / np.sqrt(law.p_modulus / law.density * self.strongest)
        part = self._near[-3:]
        self._rim = rim_of(
            lattice.shape,
            tuple(slice(a, b) for a, b in zip(low, high, strict=True)),
            engine.core.node_indices()[part].reshape(lattice.shape),
            self.stencil.offsets,
            engine.present_bonds(part).reshape(-1, *lattice.shape),
            engine.offsets @ np.array(engine.core.stride),
            lattice.spacing * self.stencil.offsets,
            engine.bond_limit,
            law.nonlinear,
            max(1, int(crossing / self.dt)),
        )
        if self._rim is not None:
            self._guard_steps = min(self._guard_steps, self._rim.every)

    def _look_at_saturation(self) -> None:
        """Say it if the liquid holds more than can be dissolved in it."""
        dissolution = self.model.dissolution
        if dissolution is not None and not self.cautions and self._first_solid:
            liquid = np.where(
                self._solid, -np.inf, self.engine.core.view(self.engine.current)[self._near].reshape(self.lattice.shape)
            )
            most = float(liquid.max()) / (dissolution.saturation - self.background)
            if most > 1 + _SUPERSATURATED:
                self._caution(
                    "supersaturated",
                    f"the liquid holds up to {most:.3g} times the saturation: metal dissolves faster than it diffuses "
                    "away; take limited = true, or an interface for the speed of the front (Corrosion.interface_for)",
                )

    def _until_opening(self) -> int:
        """Steps until the next crack opens; very many without."""
        waits = [int(np.ceil(c.opens / self.dt - 1e-9)) - self.step_count for c in self._cracks]
        return min((w for w in waits if w > 0), default=sys.maxsize)

    def check_sources(self, until: float) -> None:
        """Look beyond the absorbing sides at sources that do not split into space and time, at up to 64 even times;
        `run` calls it.

        Parameters
        ----------
        until : float
            End of the run. What was looked at before is not looked at again.

        Raises
        ------
        InputError
            The near field would miss more of a source than the side's target.
        """
        if self._unsplit and until > self._looked:
            times = np.linspace(self._looked, until, min(64, int(np.ceil((until - self._looked) / self.dt))) + 1)
            for number, source in enumerate(self._unsplit):
                self._source_peaks[number] = self._beyond.check_moving(
                    source, times, self._source_peaks.get(number, 0.0)
                )
            self._looked = until

    def prepare(self, until: float) -> int:
        """What `run` does first: `check_sources`, and kernels of exact ends that last to the end of the run; returns
        the number of the last step.

        Raises
        ------
        InputError
            As `check_sources`; a kernel that does not fit into memory.
        """
        self._settle(until)
        self.check_sources(until)
        self._end = max(self._end, until)
        last = super().prepare(until)
        if self._ends is not None:
            self._ends.cover(last)
        return last

    def _settle(self, until: float) -> None:
        """Sides that depend on the length of the run, if it is longer than they are good for and nothing has run
        yet."""
        if self.step_count or not until > self._good_for * (1 + 1e-9):
            return
        if self.autos:
            self._decide(until)
        elif any(until > end * (1 + 1e-9) for end in self._lasts()):
            try:
                self._become({key: replace(self.sides[key], nodes=None, until=until) for key in self._open_ended})
            except InputError:  # what layers keep then is noted
                if any(self.sides[key].extended for key in self._open_ended):
                    raise
        self._good_for = until

    def _lasts(self) -> list[float]:
        """Lengths of runs that the sides which follow from them were chosen for."""
        return [found.until for found in self.thickness.values()] + [found.until for found in self.extents.values()]

    def _decide(self, until: float) -> None:
        """Take layers or the extended domain on the sides that leave the choice, whichever takes less time."""
        far_sides: dict[tuple[int, int], Side] = {key: b.domain(until) for key, b in self.autos.items()}
        near_sides: dict[tuple[int, int], Side] = {
            key: b.layer(until, self.model.target) for key, b in self.autos.items()
        }
        try:
            if any(self.sides[key] != layer for key, layer in near_sides.items()):
                self._become(near_sides)
        except InputError as error:
            self._become(far_sides)
            self._why = [f"the domain is extended, for layers do not serve: {error.message}"]
            return
        layers, far = price(self), extended_price(self, until, list(self.autos))
        if far.seconds >= layers.seconds or far.memory > available_memory():
            self._why = [f"layers: the extended domain would take {far.over(layers)}"]
            return
        self._become(far_sides)
        self._why = [f"the domain is extended: layers would take {layers.over(far)}"]

    def _become(self, sides: Mapping[tuple[int, int], Side]) -> None:
        """Be at the start of the same run with some other sides."""
        named = {side_name(*key): boundary for key, boundary in {**self.settled.sides, **sides}.items()}
        other = self.of(replace(self.settled, boundary=named))
        kept = ("setup", "observers", "stop_requested", "probes", "autos", "_open_ended", "_why")
        self.__dict__ = other.__dict__ | {name: getattr(self, name) for name in kept}
        if self.probes is not None:
            self._watch(self.probes.nodes)

    def _late(self, until: float) -> list[str]:
        """What is to be said of a run that outlasts what its sides were chosen for, by more than its last step."""
        chosen = {
            "the layers keep their target up to t = {:.6g}, later perhaps not: LatticePML(target=..., until=...) "
            "chooses them for a longer run": [found.until for found in self.thickness.values()],
            "nothing comes back from the end of the extended domain up to t = {:.6g}, later something does: "
            "Extended(until=...)": [found.until for found in self.extents.values()],
        }
        return [said.format(min(ends)) for said, ends in chosen.items() if ends and until > min(ends) + self.dt]

    def _source_now(self, t: float) -> np.ndarray:
        total = np.zeros(self.field_shape)
        for space, time in self._drives:
            total += time(t) if space is None else space * time(t)
        return total * self.model.source_factor

    def step(self, count: int = 1) -> None:
        """Advance by `count` steps; the compiled loop runs them without returning to Python.

        Raises
        ------
        UnstableError
            The field became non-finite or exploded.
        """
        count, done = kinds.integer(count, "count", least=0, most=MOST_STEPS), 0
        while done < count:
            self._open_cracks()
            steps = min(count - done, self._guard_steps, self._until_opening())
            if self._holds.constraints:
                steps = self._holds.allow(self.step_count, steps)
            if self._ends is not None:
                steps = self._ends.allow(steps)
            self._advance(steps)
            if self._holds.constraints:
                self._release()
            done += steps
            self._guard()
            self._look_at_saturation()
            self._look_at(self._rim, self.engine.current)

    def _advance(self, steps: int) -> None:
        engine = self.engine
        dtype, stages, held = engine.dtype, len(engine.stages.numbers), self.conditions
        if not self._drives and not held.nodes.size:
            engine.advance(
                steps,
                np.zeros(0, np.int64),
                np.zeros((0, 0), dtype),
                np.zeros((steps, stages, 0), dtype),
                self._prescribed(steps),
            )
            self._note_probes()
            self._tick(steps)
            return
        samples, weights = self.model.integrator.source_samples(self.dt)
        tied_samples, held_weights = self.model.integrator.tied_samples(self.dt)
        weights = weights * self.model.source_factor
        drives = self._drives + held.drives
        general = any(space is None for space, _ in drives)
        batch = 1 if general else max(1, min(steps, _TABLE // max(stages * len(drives), 1)))
        done = 0
        while done < steps:
            n = min(batch, steps - done)
            strength, amplitudes = self._tables(self._drives, self.field_shape, samples, weights, n)
            if general and self.model.dissolution is not None:
                self._refuse_wet(np.any(strength != 0, axis=0).reshape(self.lattice.shape))
            values, times = self._tables(held.drives, held.nodes.shape, tied_samples, held_weights, n)
            used = np.any(strength, axis=0)
            engine.advance(
                n,
                self._source_nodes[used] if self._drives else self._source_nodes,
                np.ascontiguousarray(strength[:, used], dtype),
                amplitudes.astype(dtype),
                self._prescribed(n),
                values.astype(dtype),
                times.astype(dtype),
            )
            self._note_probes()
            if self._books:
                self._book_sources(strength, amplitudes)
            explained = float(np.abs(strength).max(initial=0) * np.abs(amplitudes).max(initial=0)) * n * self.dt
            self._scale += explained * (max(1.0, self.time) if self.model.order == 2 else 1.0)
            self._scale = max(self._scale, float(np.abs(values).max(initial=0) * np.abs(times).max(initial=0)))
            self._tick(n)
            done += n

    def _watch(self, nodes: np.ndarray) -> None:
        self.engine.watched = self._near_indices().reshape(self.engine.components, -1)[:, nodes].ravel()

    def _note_probes(self) -> None:
        """Give the probes what the engine has seen in the steps that come after the present one."""
        if self.probes is not None:
            seen = self.engine.seen.reshape(len(self.engine.seen), self.engine.components, -1) + self.background
            if self._hidden is not None:
                seen[..., self._hidden.ravel()[self.probes.nodes]] = np.nan
            self.probes.add(
                self.step_count + 1, self.dt, seen[:, 0] if self.engine.components == 1 else seen.swapaxes(1, 2)
            )

    def _prescribed(self, steps: int) -> np.ndarray | None:
        """Values of the held nodes after each of the next steps."""
        if not self._holds.constraints:
            return None
        values = self._holds.table(self.step_count, steps)
        self._scale = max(self._scale, float(np.abs(values).max(initial=0)))
        return values

    def _tables(
        self,
        drives: Sequence[tuple[np.ndarray | None, Callable[..., Any]]],
        shape: tuple[int, ...],
        samples: Sequence[float],
        weights: np.ndarray,
        count: int,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Fields over nodes, shape (j, nodes), and their amplitudes in each stage of the next `count` steps, shape
        (count, stages, j).

        What does not split into space and time takes one field for each sample time of the next step.
        """
        times = self.dt * (self.step_count + np.arange(count))
        fields, table = [], []
        for space, time in drives:
            if space is None:
                fields += [np.broadcast_to(np.asarray(time(times[0] + s), float), shape).ravel() for s in samples]
                table += [np.broadcast_to(weights[:, i], (1, len(weights))) for i in range(len(samples))]
            else:
                fields.append(np.asarray(space, float).ravel())
                if time is steady:
                    table.append(np.broadcast_to(weights.sum(1), (count, len(weights))))
                else:
                    table.append(np.array([[time(t + s) for s in samples] for t in times], float) @ weights.T)
        if not fields:
            return np.zeros((0, int(np.prod(shape)))), np.zeros((count, len(weights), 0))
        amplitudes = np.stack(table, axis=-1)
        if not np.isfinite(amplitudes).all():
            raise InputError("a source or condition is not finite", value=f"t = {times[0]:g}", key="source")
        return np.stack(fields), amplitudes

    def _guard(self) -> None:
        def cause() -> str:
            if self.closure is not None:
                names = ", ".join(sorted({type(b).__name__ for b in self.sides.values() if b.closing}))
                return (
                    f"{names} grows on this outline, which `check` tells before the run: try `farhorizon check "
                    "--tune`, or LatticePML"
                )
            backward = self.stencil.backward_waves()
            if backward and self._layers:
                return (
                    "the stencil has backward waves, which grow in layers that do not damp them (up to "
                    f"{backward.growth:.2g} sigma)"
                )
            return "check dt, sources and coefficient"

        self._refuse_explosion(self.engine.core.view(self.engine.current), self._origin, self._scale, cause)

    # --- what comes out ----------------------------------------------------------------------------------------

    def _shown(self, level: np.ndarray, offset: float) -> np.ndarray:
        values = self.engine.core.view(level)[self._near].reshape(self.field_shape) + offset
        return self._visible(values)

    def _visible(self, values: np.ndarray) -> np.ndarray:
        """The values, nan on nodes that are not shown."""
        return values if self._hidden is None else np.where(self._hidden, np.nan, values)

    @property
    def fields(self) -> dict[str, np.ndarray]:
        """Copies of the near field."""
        out = {"u": self._shown(self.engine.current, self.background)}
        if self.model.order == 2:
            out["v"] = (out["u"] - self._shown(self.engine.older, self.background)) / self.dt
        if self.bondwise:
            out["damage"] = self._visible(1 - self._bonds_left() / np.maximum(self._families, 1))
        if self.model.dissolution is not None:
            steps = self.engine.dissolved[self._near].reshape(self.lattice.shape)
            out["solid"] = self._visible(self._solid.astype(float))
            out["dissolved"] = self._visible(np.where(self._solid, np.nan, self.dt * steps))
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
        engine, cell = self.engine, self.lattice.spacing**self.lattice.dim / self.model.source_factor

        def near(level: np.ndarray) -> np.ndarray:
            part = engine.core.view(np.ascontiguousarray(level))[self._near].reshape(self.field_shape)
            return part if self.lattice.mask is None else part[..., self.lattice.mask]

        if self.model.order == 1:
            return {
                "stored": float(
                    0.5 * self.lattice.spacing**self.lattice.dim * (near(engine.current).astype(float) ** 2).sum()
                )
            }
        if self.bondwise:
            kinetic = (near(engine.current).astype(float) - near(engine.older)) / self.dt
            return {
                "kinetic": float(cell * 0.5 * (kinetic**2).sum()),
                "strain": self._strain_energy(),
                "work": self._mass * engine.work,
                "broken": self._mass * engine.broken[0],
            }
        engine.complete(engine.current)
        u, old = engine.current.astype(float), engine.older.astype(float)
        if self._ends is not None:
            self._ends.fill(u, old)

        def apply(level: np.ndarray) -> np.ndarray:
            return engine.apply_core(level.astype(engine.dtype)).astype(float)

        strain = -u * apply(old) - old * apply(u)
        each, ago = u.reshape(engine.components, -1), old.reshape(engine.components, -1)
        for number, total in enumerate(strain.reshape(each.shape)):  # component by component: sum_b L_ab (u_a old_b)
            total += apply((each[number] * ago).ravel()).reshape(each.shape)[number]
        at_rest = {(3 - self.lattice.dim + a, s): 0.0 for (a, s), b in self.sides.items() if b.held == self.background}
        if at_rest:  # the other half of the bonds to sides where u is zero
            there = engine.spread(np.ones(engine.core.nodes), at_rest) * engine.exists
            for unit, before in zip(np.eye(engine.components), ago, strict=True):
                strain -= (each * before * apply(np.multiply.outer(unit, there).ravel()).reshape(each.shape)).ravel()
        kinetic = ((near(u) - near(old)) / self.dt) ** 2
        found = {"kinetic": float(cell * 0.5 * kinetic.sum()), "strain": float(cell * 0.25 * near(strain).sum())}
        return found | ({"work": self._mass * engine.work} if self.lasting else {})

    @property
    def _mass(self) -> float:
        """Mass of a node."""
        return self.lattice.spacing**self.lattice.dim / self.model.source_factor

    def _strain_energy(self) -> float:
        """Strain energy of bonds that are nonlinear or break."""
        lattice, lead = self.lattice, 3 - self.lattice.dim
        first = [0] * lead + [self._margins[a, -1] for a in range(lattice.dim)]
        box = (1,) * lead + lattice.shape
        nodes = np.ones(box, bool) if lattice.mask is None else lattice.mask.reshape(box)
        whole = np.zeros((3, 2), bool)
        for (axis, side), boundary in self.sides.items():
            whole[lead + axis, int(side > 0)] = boundary.held is not None
        return self._mass * self.engine.bond_energy(
            tuple(first), tuple(f + n for f, n in zip(first, box, strict=True)), nodes, whole
        )

    @property
    def broken_bonds(self) -> int:
        """Bonds that have broken since the start."""
        return self.engine.broken[1]

    # --- heat balance ------------------------------------------------------------------------------------------

    def _open_books(self) -> None:
        """One book for each condition, each side that the field flows through, and the fixed rim: bonds from there into
        free nodes.
        """
        if self.model.order != 1:
            raise InputError(
                "a balance is recorded for equations of first order in time, and for elasticity",
                value=type(self.model).__name__,
                key="balance",
            )
        engine, lead = self.engine, 3 - self.lattice.dim
        self._book_names = [f"constraint[{i}]" for i in range(len(self.setup.constraints))]
        core = np.zeros(engine.core.nodes)
        beyond = {}
        for (axis, side), boundary in self.sides.items():
            if boundary.periodic:
                continue
            self._book_names.append(AXES[axis] + "-+"[side > 0])
            beyond[lead + axis, side] = float(len(self._book_names))
            width = self._margins[axis, side]
            strip = slice(0, width) if side < 0 else slice(core.shape[lead + axis] - width, None)
            core[tuple(strip if a == lead + axis else slice(None) for a in range(3))] = len(self._book_names)
        near = core[self._near].reshape(self.lattice.shape)
        near.flat[self.conditions.nodes] = self.conditions.owner + 1  # also where `near` is no whole array
        if self.lattice.mask is not None and (self.lattice.body is not None or self._near_field is not None):
            number = -1  # bonds to a free rim are absent: no book
            if self.rim == "fixed" or self._near_field is not None:
                self._book_names.append("rim" if self.rim == "fixed" else "outline")
                number = len(self._book_names)
            near[~self.lattice.mask] = number
        core[self._near] = near.reshape(core[self._near].shape)
        self._free = near == 0
        where = np.round(engine.spread(core, beyond)).astype(int)
        block = engine.core
        flat = block.node_indices()
        found = []
        for offset, weight in zip(engine.offsets, engine.weights, strict=True):
            other = flat + int(offset @ np.array(block.stride))
            flows = (where[flat] == 0) & (where[other] != 0)
            found.append((where[other[flows]] - 1, flat[flows], other[flows], np.full(int(flows.sum()), weight)))
        books, nodes, neighbours, weights = (np.concatenate([f[i] for f in found]) for i in range(4))
        weights = weights - engine.lost(nodes, neighbours, weights)
        for number, leak in self.conditions.leaks:
            lossy = np.flatnonzero((leak > 0) & self._free)
            books = np.append(books, np.full(lossy.size, number))
            nodes, neighbours = (
                np.append(nodes, self._near_indices()[lossy]),
                np.append(neighbours, np.full(lossy.size, -1)),
            )
            weights = np.append(weights, self.model.source_factor * leak.ravel()[lossy])
        layers = {}
        for axis, side in engine.layers:
            reach = engine.layout.reach[axis]
            beside = np.take(flat, np.arange(reach) - (reach if side > 0 else 0), axis).ravel()
            layers[axis, side] = self._book_names.index(AXES[axis - lead] + "-+"[side > 0]), beside[where[beside] == 0]
        kept = weights != 0
        if self._ends is None:
            ends = np.zeros((0, 0), np.int64)
        else:
            numbers = np.array([[self._book_names.index(name)] for name in self._ends.names])
            ends = np.where(where[self._ends.nodes] == 0, numbers, -1)
        flows_so_far = engine.flows
        effects = stage_effects(engine.stages) * np.array([n[2] for n in engine.stages.numbers])
        engine.set_books(
            books[kept], nodes[kept], neighbours[kept], weights[kept], effects, len(self._book_names), ends, layers
        )
        if self.step_count:  # opened anew, as a crack has
            engine.flows[...] = flows_so_far
        else:
            self._powers = np.zeros(len(self._drives))
            self._first_amounts = self._amounts()

    def _amounts(self) -> dict[str, float]:
        """Sums of the field over the free nodes of the near field: "stored", and "metal" and "dissolved" of a
        corrosion.
        """
        near = self.engine.core.view(self.engine.current)[self._near].reshape(self.lattice.shape)

        def total(where: np.ndarray, level: float = 0.0) -> float:
            return math.fsum(near[self._free & where].astype(float) + level)

        phases = {"metal": self._solid, "dissolved": ~self._solid} if self.model.dissolution is not None else {}
        return {"stored": total(self._free)} | {name: total(where, self.background) for name, where in phases.items()}

    def _book_sources(self, fields: np.ndarray, amplitudes: np.ndarray) -> None:
        effects = stage_effects(self.engine.stages) * np.array([n[3] for n in self.engine.stages.numbers])
        totals = np.einsum("p,npj->j", effects, amplitudes) * fields[:, self._free.ravel()].sum(1)
        row, samples = 0, len(self.model.integrator.source_samples(self.dt)[0])
        for number, (space, _) in enumerate(self._drives):
            count = samples if space is None else 1
            self._powers[number] += totals[row : row + count].sum()
            row += count

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
        if self.lasting:
            found = self.energies()
            return {**found, "lost": self._first_energy + 2 * found["work"] - sum(found.values())}
        unit = self.lattice.spacing**self.lattice.dim / self.model.source_factor
        inflow = {
            name: unit * float(value) for name, value in zip(self._book_names, self.engine.flows.sum(0), strict=True)
        }
        owners = [f"source[{i}]" for i in range(len(self.sources))] + [
            f"constraint[{i}]" for i, _ in self.conditions.sources
        ]
        for name, power in zip(owners, self._powers, strict=True):
            inflow[name] = inflow.get(name, 0.0) + unit * float(power)
        gains = {name: unit * (amount - self._first_amounts[name]) for name, amount in self._amounts().items()}
        return {**gains, **inflow, "residual": gains["stored"] - math.fsum(inflow.values())}

    # --- flux --------------------------------------------------------------------------------------------------

    def _bonds(self) -> Callable[[int], np.ndarray]:
        """Factor of the bond from each node of the near field along an offset, given by its number; 0 where there is
        none within it.
        """
        engine = self.engine
        block = engine.core
        nodes = block.node_indices()[self._near].ravel()
        inside = np.zeros(engine.layout.size, bool)
        inside[nodes] = True

        def factor(number: int) -> np.ndarray:
            other = nodes + int(engine.offsets[number] @ np.array(block.stride))
            weight = engine.weights[number]
            left = engine.bond_factors(nodes, other) * (1 - engine.lost(nodes, other, weight) / weight)
            return np.where(inside[other] & (left > 1e-12), left, 0.0).reshape(self.lattice.shape)

        return factor

    def _flux_tables(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, Callable[[int], np.ndarray]]:
        u = self.engine.core.view(self.engine.current)[self._near].reshape(self.lattice.shape).astype(float)
        dissolution = self.model.dissolution
        if dissolution is not None and dissolution.limited:  # what bonds between the phases carry
            u = np.where(self._solid, dissolution.saturation - self.background, u)
        return (
            u,
            self.stencil.offsets,
            self.stencil.weights * self.model.coefficient / self.model.source_factor,
            self._bonds(),
        )

    def flux(self) -> np.ndarray:
        """Heat flux (or that of a diffusing field) at the nodes along each axis, positive towards larger coordinates.

        One-sided sums over the bonds ahead of a node, over those behind it where bonds ahead are missing, exact for a
        linear field at every node; nan where the bonds left do not determine it. See `farhorizon.simulation.flux`.

        Returns
        -------
        ndarray, shape (dim, n..)
        """
        found = nodal_flux(*self._flux_tables(), self.lattice.spacing)
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
        number = AXES.index(kinds.one_of(axis, "axis", AXES[: self.lattice.dim], "the lattice has no such axis"))
        position = kinds.number(position, "position")
        row = int(np.floor((position - self.lattice.lower[number]) / self.lattice.spacing + 1e-9))
        if not 0 <= row < self.lattice.shape[number] - 1:
            raise InputError(
                "the plane lies outside the near field",
                value=position,
                key="position",
                limit=f"{self.lattice.lower[number]} to {self.lattice.upper[number]}",
            )
        return power_across(*self._flux_tables(), self.lattice.spacing, number, row)

    @property
    def notes(self) -> list[str]:
        """What lies beyond the near field and is missed, but within the sides' targets, or cannot be known."""
        ends = [] if self._ends is None else self._ends.notes()
        return self._beyond.notes + ends + self._remarks + self._why + self._late(max(self._end, self.time))

    @property
    def ends(self) -> dict[str, str]:
        """What serves each exact end: modes and error bound of its sum, and for how many steps."""
        return (
            {}
            if self._ends is None
            else {name: self._ends.describe(i, self.dt) for i, name in enumerate(self._ends.names)}
        )

    def _settled_sides(self) -> dict[str, Side]:
        """The sides by name, with the layers that were chosen for the data: on another lattice, or without data, they
        stay what they are.
        """
        named = {
            AXES[axis] + "-+"[side > 0]: (boundary, self._layers.get((axis, side)))
            for (axis, side), boundary in self.sides.items()
        }
        chosen = {
            AXES[axis] + "-+"[side > 0]: found
            for (axis, side), found in self.extents.items()
            if np.isfinite(found.until)
        }
        wanted = self.model.target
        return {
            name: replace(boundary, target=boundary.wanted(wanted), nodes=layer.columns, profile=layer)
            if layer is not None and name in self.thickness
            else boundary
            for name, (boundary, layer) in named.items()
        } | {name: replace(named[name][0], nodes=found.nodes, until=found.until) for name, found in chosen.items()}

    def remade(self, **changes: Any) -> Simulation:
        """The same set-up at its start with some arguments changed; on another lattice nothing is there, and the medium
        is uniform, as stiff as it is anywhere.
        """
        start: dict[str, Any] = {}
        if "lattice" in changes:
            nothing = dict.fromkeys(("sources", "loads", "cracks", "constraints", "specimens"), ())
            changes = {**nothing, "coefficient": None, "rim": "free", "balance": False, **changes}
            if self._factor is not None and self.strongest > 0:
                changes["model"] = changes.get("model", self.model).scaled(self.strongest)
        else:
            start["u"] = self.start_u + float(changes.get("background", self.background))
            start |= {"v": self.start_v} if self.model.order == 2 else {}
        return Simulation.of(replace(self.settled, **{"initial": start, **changes}))

    @property
    def exact_ends(self) -> ExactEnds | None:
        """The exact ends; None without."""
        return self._ends

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
        engine = self.engine
        with engine.as_before():
            engine.advance_alone(1)  # the first one loads compiled programs
            count, spent = 1, 0.0
            while spent < 0.05 and count < 10_000:
                count = count if spent == 0 else int(count * np.clip(0.1 / spent, 2, 50))
                begin = perf_counter()
                engine.advance_alone(count)
                spent = perf_counter() - begin
        return spent / count

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
        """What a checkpoint and the run that goes on from it have in common."""
        engine, law, dissolution = self.engine, self.model.bond_law, self.model.dissolution
        found = {
            "levels": list(engine.levels.shape),
            "memory": int(engine.memory.size),
            "dtype": engine.dtype.name,
            "dt": self.dt,
            "shape": list(self.lattice.shape),
            "spacing": self.lattice.spacing,
            "lower": self.lattice.lower.tolist(),
            "model": type(self.model).__name__,
            "coefficient": self.model.coefficient,
            "damping": self.model.damping,
            "weights": float(self.stencil.weights.sum()),
            "neighbours": len(self.stencil.weights),
            "cuts": self._first_cuts,
            "held": len(self._held),
            "conditions": len(self.conditions.nodes),
            "opens": [c.opens for c in self._cracks],
        }
        if self._ends is not None:
            found["exact"] = self._ends.names
        if self.closure is not None:
            found |= {"fringe": list(engine.fringe_history.shape), "update": self.closure.mark()}
        if law is not None:
            found["bonds"] = [law.nonlinear, law.critical_stretch_on(self.lattice.spacing, self.lattice.dim)]
        if self._holds.constraints:
            found["constraints"] = len(self._holds.constraints)
        if dissolution is not None:
            found |= {"solid": self._first_solid, "saturation": dissolution.saturation}
            found |= {"interface": dissolution.interface} | ({"limited": True} if dissolution.limited else {})
        return found

    def save(self, path: str | Path, **extra: Any) -> None:
        """Write the complete state, boundary memory included, under a temporary name and rename it."""
        self._open_cracks()  # as the next step begins: `load` opens what is due at that time
        meta = {
            "fingerprint": self._fingerprint(),
            "step": self.step_count,
            "phase": int(self.engine.phase),
            "scale": self._scale,
            "cautions": self.cautions,
            "extra": extra,
        }
        arrays = {
            "levels": self.engine.levels,
            "memory": self.engine.memory,
            "start_u": self.start_u,
            "start_v": self.start_v,
        }
        if self._ends is not None:
            more, meta["exact"] = self._ends.save()
            arrays |= more
        arrays |= self.engine.bond_state
        if self.model.dissolution is not None:
            arrays["dissolved"] = np.ascontiguousarray(self.engine.dissolved[self._near])
        if self.closure is not None:
            arrays["fringe"] = self.engine.fringe_history
        if self._books:
            arrays |= {"flows": self.engine.flows, "powers": self._powers}
            meta["first_amounts"] = self._first_amounts
        meta["setup"] = describe({k: v for k, v in self.settled.arguments.items() if k != "initial"}, arrays)
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
        names = {key: AXES[key[0]] + "-+"[key[1] > 0] for key in {*self._open_ended, *self.autos}}
        if all(theirs[name].stretched or theirs[name].extended for name in names.values() if name in theirs):
            self._become({key: theirs[name] for key, name in names.items()})

    def load(self, path: str | Path) -> dict[str, Any]:
        if self._open_ended or self.autos:
            self._adopt(path)
        arrays, meta = self._read(path)
        self.engine.levels[...] = arrays["levels"]
        self.engine.memory[...] = arrays["memory"]
        if self._ends is not None:
            self._ends.load(arrays, meta["exact"])
        if self.closure is not None:
            self.engine.fringe_history[...] = arrays["fringe"]
        self.engine.phase, self._scale = int(meta["phase"]), float(meta["scale"])
        self.step_count = 0
        self._tick(int(meta["step"]))
        self.cautions = [Caution(*entry) for entry in meta["cautions"]]
        self.engine.steps_done = self.step_count
        if self.model.dissolution is not None:
            self._set_phases(arrays["dissolved"])
        self._hold()
        self._open_cracks()
        for name, array in self.engine.bond_state.items():
            array[...] = arrays[name]
        if self._books:
            self.engine.flows[...], self._powers[...] = arrays["flows"], arrays["powers"]
            self._first_amounts = meta["first_amounts"]
        return dict(meta["extra"])

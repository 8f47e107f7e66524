"""A run in progress: what drives it, its balance, its energies, and the opening of its cracks."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from farhorizon.engine.engine import BackEnd
from farhorizon.engine.state import Assembly, Box, common, sums_of, take_sums, values_of
from farhorizon.errors import InputError
from farhorizon.inputs.cracks import Crack
from farhorizon.inputs.thermal_loads import ThermalLoad, of_the_heat
from farhorizon.simulation.assembly import RunParts, assemble
from farhorizon.simulation.heat.broken_bonds import BrokenBonds
from farhorizon.simulation.heat.coupled_temperature import CoupledTemperature, StaggeredTemperature
from farhorizon.simulation.heat.thermal_strains import ThermalStrains
from farhorizon.simulation.heat.thermoelastic_sides import sides_of_heat
from farhorizon.simulation.processes.process_group import ALONE, ProcessGroup
from farhorizon.simulation.setup.cuts import Bonds
from farhorizon.simulation.setup.setup import Setup
from farhorizon.simulation.time.breaking import BreakableBonds, IntactMargin
from farhorizon.simulation.time.checkpoint import Arrays, take_whole, whole_of
from farhorizon.simulation.time.energies import energies, kinetic_energy, present
from farhorizon.simulation.time.flow_balance import FlowBalance
from farhorizon.simulation.time.relaxation import Relaxation
from farhorizon.simulation.time.source_table import SourceTable
from farhorizon.simulation.time.source_terms import SourceChecks, time_histories
from farhorizon.simulation.time.start import Motion, continued, with_incident_waves

_ROUNDING = 1e-9  # of a step, for the times of cracks
_TINY = 1e-300  # a scale above zero, so that values may be compared with it


class TimeLoop:
    """Time stepping of the parts of a run; the constructor brings the engine to the start. `run_of` makes a run of a
    set-up, given its observers and a team, for a temperature that is computed alongside. Raises InputError for initial
    data that would break bonds at once, and a balance where there is none. The steps, the first included, are computed
    by what `back_end` returns for the engine, in place of its compiled loop.
    """

    def __init__(
        self,
        setup: Setup,
        parts: RunParts,
        run_of: Callable[..., Any],
        team: ProcessGroup = ALONE,
        back_end: BackEnd | None = None,
    ) -> None:
        self.setup, self.parts, self.team = setup, parts, team
        near, grid, sides, start = parts.near, parts.grid, parts.layered.sides, parts.start
        self.source_checks: SourceChecks | None = None
        if setup.sources or setup.loads:
            self.source_checks = SourceChecks(
                parts.source_terms.unsplit, parts.exterior, near.dt, time_histories(setup, near)
            )
        self.flow_balance: FlowBalance | None = None  # of diffusion, if it is recorded
        self._severed: Bonds | None = None
        self._opened = len(setup.cracks)
        if setup.cracks:
            self.open_cracks(0)
        self.first_cuts = int(grid.engine.absent.count)  # bonds that are absent at the start
        held = [abs(b.held - near.background) for b in sides.values() if b.held is not None]
        self._begun = with_incident_waves(start, parts.incident) if parts.incident else start
        largest = float(np.abs(self._begun.u).max()), float(np.abs(self._begun.v).max()) * near.dt
        self.source_table = SourceTable(
            near, grid, parts.active_terms, parts.phases, max([*largest, _TINY, *held]), parts.impactors
        )
        self.relaxation: Relaxation | None = None
        if setup.load_steps is not None:
            self.relaxation = Relaxation(setup.load_steps, near, grid, self.source_table)
        self.motion = Motion(near, grid, parts.ends, self.source_table.force)
        self._seen: dict[str, np.ndarray] = {}  # the field of diffusion when `change` was called last
        self._seen_at = 0
        self.heating = None if setup.heat is None else self._heating(setup.heat, run_of, back_end)
        if back_end is not None:
            grid.engine.loop = back_end(grid.engine)
        self._lay_start()
        if parts.breaking is not None:
            with team.agreed():
                parts.breaking.check_start(self.source_table.force(0.0))
        self.first_energy = 0.0  # of an elastic medium whose balance is recorded
        if setup.balance and setup.lasting:
            stored = self.energies()
            self.first_energy = sum(stored.get(name, 0.0) for name in ("kinetic", "strain", "thermal"))
        elif setup.balance:
            self.flow_balance = FlowBalance(setup, parts, self.source_table, team)
        self.margin: IntactMargin | None = None  # nodes whose bonds would break, but cannot
        self.every = 0  # steps between two checks of these on all processes; 0 for none
        if parts.breaking is not None:
            self._find_margin(parts.breaking)

    def _heating(self, load: ThermalLoad, run_of: Callable[..., Any], back_end: BackEnd | None) -> ThermalStrains:
        """Return the temperature that strains the medium."""
        near, grid, sides = self.parts.near, self.parts.grid, self.parts.layered.sides
        broken = self._broken(load)
        if not (load.coupled or self.parts.thermoelastic):
            return ThermalStrains(load, near, grid, sides, run_of, self.team, broken)

        margins = {key: grid.margins[key] for key in self.parts.thermoelastic}

        def driven(setup: Setup, source: Callable[[float], np.ndarray]) -> TimeLoop:
            with of_the_heat():
                parts = assemble(setup, margins)
                parts = replace(parts, active_terms=[*parts.active_terms, (None, source)])
                return TimeLoop(setup, parts, run_of, back_end=back_end)

        shared = sides_of_heat(self.parts.layered, grid.margins, self.parts.thermoelastic)
        stepped_heat = CoupledTemperature if load.coupled else StaggeredTemperature
        return stepped_heat(load, near, grid, sides, shared, driven, broken)

    def _broken(self, load: ThermalLoad) -> BrokenBonds | None:
        """Return the broken bonds of the solid; None if they cannot break, or if the temperature is given."""
        if self.parts.breaking is not None and self.parts.breaking.may_break and load.of_run(load.temperature):
            return BrokenBonds(self.parts.breaking, load.contact_conductance > 0, self.team)
        if load.contact_conductance:
            raise InputError(
                "no bond breaks that could conduct heat: the solid does not break, or its temperature is given",
                value=load.contact_conductance,
                key="load.contact_conductance",
                remedy="leave it out, or critical_stretch or fracture_energy",
            )
        return None

    def _lay_start(self) -> None:
        """Give the engine the initial level, and that one step before it."""
        near, grid, closure, start = self.parts.near, self.parts.grid, self.parts.closure, self._begun
        if self.heating is not None:
            self._warm(self.heating, 0)
        beyond: dict[str, np.ndarray | None] = {"u": None, "v": None}
        if any(side.derivatives for side in self.parts.layered.sides.values()):
            beyond = {name: continued(name, self.setup, near, self.parts.layered.sides, grid) for name in beyond}
        # in diffusion all levels, because the sweep skips metal that nothing reaches
        name = "u" if near.model.order == 2 else "levels"
        if beyond["u"] is not None:
            grid.engine.put(name, beyond["u"].ravel(), (..., grid.engine.all_components(grid.core.node_indices())))
        grid.put(name, start.u)
        if near.conditions.nodes.size:
            self.source_table.prescribe()
        if near.prescribed.constraints:
            self.source_table.hold(0)
        if near.model.order == 2:
            # the medium beyond an outline is at rest
            outside = np.zeros(0, np.int64) if closure is None else closure.unmoved
            self.motion.step_back(start.v, np.concatenate([self.parts.held, outside]), beyond["v"])
        if closure is not None:
            closure.start()
        if self.heating is not None:
            self.heating.begin()

    def _warm(self, heating: ThermalStrains, step: int) -> None:
        """Update the thermal strains, and the displacements that they explain."""
        self.source_table.scale = max(self.source_table.scale, heating.lay(step))

    def energies(self) -> dict[str, float]:
        """Return the energies of the near field by name, see `farhorizon.Simulation.energies`."""
        cold = self.heating is not None and self.heating.coupled
        by_name = energies(self.parts, self.setup.lasting, cold, self.setup.rim == "fixed")
        return self.team.total(by_name if self.heating is None else by_name | self.heating.energies())

    @property
    def slow_crossing(self) -> float:
        """Time that the slowest wave takes to cross the near field."""
        return self.parts.near.slow_crossing

    def kinetic(self) -> float | None:
        """Return the kinetic energy of the near field and of its impactors; None for diffusion."""
        if self.parts.near.model.order == 1:
            return None
        kinetic = self.team.total({"kinetic": kinetic_energy(self.parts.near, self.parts.grid)})["kinetic"]
        return kinetic + (0.0 if self.parts.impactors is None else self.parts.impactors.kinetic())

    def change(self, step: int) -> float | None:
        """Return the largest change of the near field per step since this was called before; None the first time."""
        grid, before, since = self.parts.grid, self._seen.get("seen"), step - self._seen_at
        self._seen, self._seen_at = {"seen": grid.engine.get("u").copy()}, step
        if before is None or not since:
            return None
        now, then = (grid.view(level).reshape(self.parts.near.field_shape) for level in (self._seen["seen"], before))
        moved = np.abs(self.parts.near.visible(np.subtract(now, then, dtype=float)))
        return self.team.largest(float(moved.max(initial=0, where=~np.isnan(moved)))) / since

    def loading_at(self, t: float) -> list[np.ndarray]:
        """Return all that drives the run at a time: amplitudes of sources and conditions that split into space and
        time, values of others, values of prescribed nodes, paths of impactors, and which cracks are open.
        """
        near = self.parts.near
        source_terms = [*self.source_table.source_terms, *near.conditions.source_terms]
        opened = np.array([crack.opens <= t for crack in self.setup.cracks], float)
        paths = [] if self.parts.impactors is None else self.parts.impactors.loading_at(t)
        return [*(np.asarray(time(t), float) for _, time in source_terms), *near.prescribed.now(t), *paths, opened]

    def fields(self) -> dict[str, np.ndarray]:
        """Return copies of the fields in the near field by name, see `farhorizon.Simulation`."""
        parts, near, grid = self.parts, self.parts.near, self.parts.grid

        out = {"u": near.visible(grid.get("u") + near.background)}
        if near.model.order == 2:
            out["v"] = (out["u"] - near.visible(grid.get("u_old") + near.background)) / np.float64(near.dt)
        if parts.breaking is not None:
            out["damage"] = near.visible(parts.breaking.damage)
        if self.heating is not None:
            out |= {name: near.visible(values) for name, values in self.heating.fields.items()}
        if parts.phases is not None:
            solid = parts.phases.solid
            out["solid"] = near.visible(solid.astype(float))
            out["dissolved"] = near.visible(np.where(solid, np.nan, near.dt * parts.phases.steps))
        return out

    def _find_margin(self, breaking: BreakableBonds) -> None:
        self.margin = breaking.margin()
        intervals = self.team.gather(None if self.margin is None else self.margin.every)
        self.every = min((interval for interval in intervals if interval is not None), default=0)

    def _due(self, step: int) -> list[Crack]:
        """Return the cracks that are open at a step."""
        dt = self.parts.near.dt
        return [crack for crack in self.setup.cracks if crack.opens <= step * dt + _ROUNDING * dt]

    def sever(self, bonds: Bonds, step: int) -> None:
        """Cut these bonds from a step on, in addition to those across cracks and in place of those of the last call."""
        self._severed = bonds
        self.parts.cuts.cut(self._due(step), bonds)
        if self.flow_balance is not None:
            self.flow_balance.reopen()

    def open_cracks(self, step: int) -> None:
        """Cut the bonds of cracks that are open at a step and were not before."""
        breaking, engine, due = self.parts.breaking, self.parts.grid.engine, self._due(step)
        if len(due) == self._opened:
            return
        stored = self._held_by_bonds() if breaking is not None and step else 0.0
        if breaking is not None and not step:
            breaking.begin()
        self.parts.cuts.cut(due, self._severed)
        if breaking is not None and len(due) < len(self.setup.cracks):
            engine.bonds.expect_cuts()
        if breaking is not None and stored:
            lost = stored - self._held_by_bonds()  # total of all processes, counted by the first one
            engine.bonds.count_cut(lost / self.parts.near.mass * (self.team.number == 0))
        self._opened = len(due)
        if self.flow_balance is not None and step:
            self.flow_balance.reopen()
        if step and breaking is not None:
            self._find_margin(breaking)

    def _held_by_bonds(self) -> float:
        """Return the strain energy and what friction has dissipated: faces may slip as soon as a crack is cut."""
        energies = self.energies()
        return energies["strain"] + energies.get("friction", 0.0)

    def allow(self, step: int, most: int) -> int:
        """Return how many of the wanted steps from number `step` on may be made before something has to be handled."""
        opening = [int(np.ceil(c.opens / self.parts.near.dt - _ROUNDING)) - step for c in self.setup.cracks]
        steps = min(most, min((wait for wait in opening if wait > 0), default=sys.maxsize))
        if self.relaxation is not None:
            steps = 1
        if self.every:
            steps = min(steps, self.every - step % self.every)
        if self.heating is not None:
            steps = self.heating.allow(step, steps)
        if self.parts.near.prescribed.constraints:
            steps = self.parts.near.prescribed.allow(step, steps)
        return steps if self.parts.ends is None else self.parts.ends.allow(steps)

    def advance(self, step: int, steps: int) -> Iterator[int]:
        """Make `steps` steps from number `step` on; yields the number of steps of each batch after it."""
        if self.heating is not None and self.heating.due(step):
            self._warm(self.heating, step)
        if self.relaxation is not None:
            self.relaxation.settle(step)
            self._hold(step + steps)
            yield steps
            return
        for batch in self.source_table.advance(step, steps):
            if self.heating is not None:
                self.heating.follow(step)
            if self.flow_balance is not None:
                self.flow_balance.add(batch)
            yield batch.steps
        if self.parts.near.prescribed.constraints:
            if self.parts.near.model.order == 2:
                self._release(step + steps)
            self._hold(step + steps)

    def _hold(self, step: int) -> None:
        """Tell the engine and the balance which nodes follow a prescribed value from a step on."""
        self.source_table.hold(step)
        if self.flow_balance is not None:
            self.flow_balance.hold(step)

    def _release(self, step: int) -> None:
        """Release nodes whose constraint ends at a step; the change of energy when they become free counts as work."""
        if not self.team.largest(float(len(self.parts.near.prescribed.released(step)))):
            return
        before = present(self.energies()) if self.setup.lasting else 0.0
        self.motion.release(step)
        if self.setup.lasting:
            gained = present(self.energies()) - before  # total of all processes, counted by the first one
            self.parts.grid.engine.add("work", gained / self.parts.near.mass * (self.team.number == 0), 0)

    def balance(self) -> dict[str, float]:
        """Return the gains since the start by origin, see `farhorizon.Simulation.balance`."""
        if self.flow_balance is not None:
            return self.flow_balance.balance()
        stored = self.energies()
        return {**stored, "lost": self.first_energy + 2 * stored["work"] - sum(stored.values())}

    @property
    def box(self) -> Box:
        """Range of the box of this process in that of the whole, including layers, along each axis of the engine; all
        processes must request theirs jointly.
        """
        grid, lattice = self.parts.grid, self.parts.near.lattice
        low = [grid.layout.low[a] + (grid.margins[a - grid.lead, -1] if a >= grid.lead else 0) for a in range(3)]
        lows = self.team.gather(low)
        first = (0,) * grid.lead + lattice.first
        starts = [f + max(low_there[a] for low_there in lows) - low[a] for a, f in enumerate(first)]
        return [(int(start), int(start) + n) for start, n in zip(starts, grid.layout.box.nodes, strict=True)]

    def state(self, step: int) -> tuple[Arrays, dict[str, Any]]:
        """Return the state before a step, apart from the set-up: arrays over the nodes of this process, and values of
        all processes as JSON; on a single process also what belongs to the whole.
        """
        self.open_cracks(step)  # as at the beginning of the next step: `take` opens cracks that are due then
        engine, balance = self.parts.grid.engine, self.flow_balance
        arrays: Arrays = values_of(engine, self._seen)
        meta: dict[str, Any] = {"step": step, "phase": int(engine.clock[1])}
        meta |= {"seen_at": self._seen_at} if self._seen else {}
        meta |= {"relaxation": self.relaxation.state()} if self.relaxation is not None else {}
        meta |= {
            "boxes": self.team.gather(self.box),
            "scale": self.team.largest(self.source_table.scale),
            "sums": self.sums(),
        }
        meta["first_amounts"] = {} if balance is None else balance.first
        if not self.team:
            more, facts = whole_of(self.parts)
            arrays, meta = arrays | more, meta | facts
        if self.heating is not None:
            more, facts = self.heating.state(step)
            arrays, meta = arrays | more, meta | facts
        return arrays, meta

    def sums(self) -> dict[str, float]:
        """Return the sums accumulated during the run, over all processes."""
        balance = self.flow_balance
        sums = sums_of(self.parts.grid.engine) | ({} if balance is None else balance.sums())
        return self.team.total(sums)

    def take(self, states: Iterable[tuple[Box, Mapping[str, np.ndarray]]], meta: Mapping[str, Any]) -> bool:
        """Restore a state returned by `state`, possibly on other processes: `states` yields the boxes of those and
        their arrays, one after the other. Returns whether they cover the box of this process and match it.
        """
        engine, step, own_box = self.parts.grid.engine, int(meta["step"]), self.box
        self._seen_at = int(meta.get("seen_at", 0))
        self._seen = {"seen": engine.level()} if "seen_at" in meta else {}
        made = Assembly(engine, own_box, self._seen)
        arrays: Mapping[str, np.ndarray] = {}
        for box, arrays in states:
            if common(own_box, box, (0, 1, 2)) is not None and not made.add(box, arrays):
                return False
        self.team.gather(None)  # raises if another process lacks a part and makes no further calls
        engine.clock, self.source_table.scale = (step, int(meta["phase"])), float(meta["scale"])
        if self.relaxation is not None:
            self.relaxation.take(meta["relaxation"])
        alone = not self.team and len(meta["boxes"]) == 1
        if self.heating is not None:
            self.heating.take(arrays, meta)
        self._hold(step)
        self.open_cracks(step)
        if not made.put():
            return False
        if self.heating is not None:
            self._warm(self.heating, step)
        first = self.team.number == 0
        self._take_sums(meta["sums"] if first else dict.fromkeys(meta["sums"], 0.0), meta["first_amounts"])
        if alone:
            take_whole(self.parts, arrays, meta)
        return True

    def _take_sums(self, given: Mapping[str, float], first: Mapping[str, float]) -> None:
        """Continue from sums that `sums` returned, and from the amounts at the start."""
        take_sums(self.parts.grid.engine, given)
        if self.flow_balance is not None:
            self.flow_balance.take_sums(given, first)

    def complete(self) -> None:
        """Complete what a saved state leaves out, once all processes have theirs: halos and what follows from them."""
        self.parts.grid.engine.complete("levels")
        if self.parts.phases is not None:
            self.parts.phases.set(self.parts.phases.steps)

"""Thermal strains of a near field, for a temperature that is prescribed or that another run computes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from farhorizon.engine.features.thermal_strain import give_thermal_strain
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import Lattice
from farhorizon.inputs.sources import split
from farhorizon.inputs.thermal_loads import ThermalLoad, of_the_heat
from farhorizon.simulation.heat.broken_bonds import BrokenBonds, InsulatedBonds, after_changes, table_changes
from farhorizon.simulation.heat.coupling import expansion_of
from farhorizon.simulation.processes.process_group import ALONE, ProcessGroup
from farhorizon.simulation.setup.grid import Grid
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Key, Sides, side_name
from farhorizon.simulation.time.outer_loop import warn

_STRIP = 2  # reaches next to a side within which bonds ignore heat at one or both ends


class ThermalStrains:
    """Thermal strains of a near field over time, which it gives to the engine.

    They are linear in time over `every` steps, from one sample of the temperature to the next, and constant if that is
    0. On several processes all sample the temperature at the same steps. Raises InputError if the temperature is given
    at other nodes, the expansion is not finite, or there is heat next to sides that are not free.
    """

    def __init__(
        self,
        load: ThermalLoad,
        near: NearField,
        grid: Grid,
        sides: Sides,
        run_of: Callable[..., Any],
        group: ProcessGroup = ALONE,
        broken: BrokenBonds | None = None,
    ) -> None:
        self.load, self.near, self.grid, self.sides, self._group = load, near, grid, sides, group
        self._expansion = expansion_of(load, near.lattice, near.model, near.lame)
        self._largest, self._warned = 0.0, False
        run = CompanionRun(load, near.lattice, run_of, group, broken) if load.of_run(load.temperature) else None
        self._run = run
        self._temperature = _given(load, near.lattice) if run is None else run.at
        between = load.every or (0.0 if run is None else run.dt)
        self.every = 0 if load.steady else max(1, int(between / near.dt * (1 + 1e-9)))  # a whole number up to rounding
        self._known: dict[int, np.ndarray] = {}

    def lay(self, step: int) -> float:
        """Give the engine the thermal strains at a step and their rate until the next sample; return `explained`."""
        start = step - step % self.every if self.every else 0
        strains = self._strains_at(start)
        rate = (self._strains_at(start + self.every) - strains) / self.every if self.every else np.zeros_like(strains)
        give_thermal_strain(self.grid.engine, self.grid.grown(strains), self.grid.grown(rate), step - start)
        return self.explained

    @property
    def explained(self) -> float:
        """Size of displacements that all strains so far can explain."""
        return self._largest * self.near.lattice.spacing * max(self.near.lattice.whole.shape)

    def due(self, step: int) -> bool:
        """Whether the temperature is sampled before a step."""
        return bool(self.every) and step % self.every == 0

    def allow(self, step: int, steps: int) -> int:
        """Return how many of some steps can be made from `step` on until the next sample."""
        return min(steps, self.every - step % self.every) if self.every else steps

    @property
    def strains(self) -> np.ndarray:
        """Thermal strains of the nodes now, of the shape of the lattice."""
        thermal_strain = self.grid.engine.get("heat.thermal_strain", self.grid.nodes)
        return thermal_strain.astype(float).reshape(self.near.lattice.shape)

    def at_points(self, nodes: np.ndarray, weights: np.ndarray, steps: int) -> np.ndarray:
        """Return sums of the thermal strains over nodes (flat numbers in the near field) with weights, both of shape
        (n, m), after each of the last steps, within which there was no sample; shape (steps, n).
        """
        engine, places = self.grid.engine, self.grid.nodes.ravel()[nodes]
        now, rate = ((engine.get(f"heat.{name}", places) * weights).sum(1) for name in ("thermal_strain", "rate"))
        return np.asarray(now - np.arange(steps)[::-1, None] * rate)

    def begin(self) -> None:
        """Prepare for the first step, once the engine has the displacements at the start and one step before; nothing
        to do here.
        """

    def follow(self, step: int) -> None:
        """React to a step from number `step`, which the displacements have already made; nothing to do here."""

    @property
    def fields(self) -> dict[str, np.ndarray]:
        """Copies of the temperature and of the thermal strain, by name."""
        return {"T": self.temperature, "thermal_strain": self.strains}

    def energies(self) -> dict[str, float]:
        """Energies of the heat by name; none are known of a given temperature."""
        return {}

    @property
    def coupled(self) -> bool:
        """Whether deformation heats the solid."""
        return False

    def state(self, step: int) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return everything that does not follow from the set-up, before a step: arrays, and facts for JSON."""
        return ({}, {}) if self._run is None else self._run.state()

    def take(self, arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any]) -> None:
        """Restore a state that `state` returned."""
        if self._run is not None:
            self._known = {}
            self._run.take(arrays, meta)

    def _strains_at(self, step: int) -> np.ndarray:
        """Thermal strains at a step; the temperature of the previous sample is kept."""
        known = step in self._known
        if not known:
            temperature = np.broadcast_to(self._temperature(step * self.near.dt), self.near.lattice.shape)
            self._known = {k: v for k, v in self._known.items() if k == step - self.every} | {step: temperature}
        strains = self.near.inside(self._expansion * (self._known[step] - self.load.reference))
        if not known:
            self._check_sides(strains, step)
        return strains

    @property
    def temperature(self) -> np.ndarray:
        """Temperature at the nodes now, linear in time between samples."""
        step, _ = self.grid.engine.clock
        part = step % self.every / self.every if self.every else 0.0
        start = step - step % self.every if self.every else 0
        return (1 - part) * self._known[start] + (part * self._known[start + self.every] if part else 0.0)

    def _check_sides(self, strains: np.ndarray, step: int, rise: int = 0, most: float = 0.0) -> None:
        """Refuse, or after the start warn of, heat next to sides that are neither free nor periodic, where bonds ignore
        it, in whole or, over `rise` further nodes where the medium continues, in part. The fraction of the largest
        strain missed there may be the target of the side, or `most` if that is larger.
        """
        largest = {None: float(np.abs(strains).max(initial=0))} | self._at_sides(strains, rise, most)
        of_processes = self._group.gather(largest)
        self._largest = max(self._largest, *(part[None] for part in of_processes))
        for key in dict.fromkeys(key for part in of_processes for key in part if key is not None):
            wide, strain, target = max(part[key] for part in of_processes if key in part)
            fraction = strain / max(self._largest, 1e-300)  # no division by zero
            if fraction <= target:
                continue
            words = f"the temperature near the side {side_name(*key)} is not the stress-free temperature of the solid"
            if step == 0:
                raise InputError(
                    words,
                    value=f"{fraction:.2g} of the largest change within {wide} nodes of it",
                    limit=f"{target:g}",
                    key="load.temperature",
                    remedy="LatticePML for both fields of a Thermoelastic, whose heat has integrator='euler', a larger "
                    "near field, Periodic or Free"
                    if self.sides[key].endless
                    else "Prescribed nodes beside a Free side, which may have any temperature",
                )
            if not self._warned:
                self._warned = True
                start = f"from t = {step * self.near.dt:.3g} on"
                warn(f"{words}: {start} {fraction:.2g} of the largest change is missed there")

    def _at_sides(self, strains: np.ndarray, rise: int, most: float) -> dict[Any, Any]:
        """For each side next to which bonds ignore heat, return how many nodes are examined, the largest strain at
        them, and its admissible ratio to the largest strain of all.
        """
        largest = {}
        for (axis, side), boundary, unheated in unheated_strips(self.near, self.sides):
            wide = min(unheated + rise * boundary.endless, strains.shape[axis])
            strip = np.take(strains, range(wide) if side < 0 else range(-wide, 0), axis)
            target = boundary.wanted(self.near.model.target) if boundary.endless else self.near.model.target
            largest[axis, side] = wide, float(np.abs(strip).max(initial=0)), max(target, most)
        return largest


class CompanionRun:
    """The temperature of a run that is computed alongside another one, on a part of its lattice.

    On several processes the run has its own decomposition into boxes; each process receives the values at the nodes of
    its box of the other run (`lattice`), from whichever process computes them. Bonds of the solid that have broken
    before a step of this run do not conduct in it. Raises InputError if its nodes are not nodes of the lattice, or have
    no temperature.
    """

    def __init__(
        self,
        load: ThermalLoad,
        lattice: Lattice,
        run_of: Callable[..., Any],
        group: ProcessGroup = ALONE,
        broken: BrokenBonds | None = None,
    ) -> None:
        assert load.reference is not None
        self._setup, self._run_of, self._group, self._reference = load.temperature, run_of, group, load.reference
        heated, part, lattice = self._setup.lattice, lattice, lattice.whole
        first = (heated.lower - lattice.lower) / lattice.spacing if heated.dim == lattice.dim else np.full(1, np.nan)
        place = np.round(np.nan_to_num(first, nan=-1)).astype(int)
        last = place + np.array(heated.shape) if heated.dim == lattice.dim else place
        # to rounding
        fits = abs(heated.spacing / lattice.spacing - 1) < 1e-9 and np.abs(first - place).max() < 1e-6
        if not fits or place.min() < 0 or (last > lattice.shape).any():
            raise InputError(
                "the temperature is computed on nodes that are not those of the solid",
                value=f"spacing {heated.spacing:g} from {heated.lower.tolist()}",
                limit=f"spacing {lattice.spacing:g} from {lattice.lower.tolist()} to {lattice.upper.tolist()}",
                key="load.temperature",
                remedy="the same lattice, or a part of it",
            )
        self._shape, self._place = part.shape, place
        self._boxes = group.gather((part.first, part.shape))
        # changes of the table of broken bonds by step, and the number of steps that have looked for some
        self._broken, self._changes, self._looks = broken, dict[int, np.ndarray](), 0
        self._begin()
        if broken is not None:
            self._insulated = insulated(load, broken, self._run.parts, place)
        unknown = ~np.isfinite(self._on_box())
        unknown &= True if part.mask is None else part.mask
        check_known(sum(group.gather(int(unknown.sum()))))

    def _begin(self) -> None:
        with of_the_heat():
            self._run = self._run_of(self._setup, (), self._group)
        self.dt = float(self._run.dt)
        self._before = self._after = self._field()
        self._table = np.zeros((0, 2), np.int64)

    def _field(self) -> np.ndarray:
        temperature = self._on_box()
        return np.where(np.isfinite(temperature), temperature, self._reference)

    def _on_box(self) -> np.ndarray:
        """Return the field at the nodes of this process, the reference temperature at nodes that the run does not
        have.
        """
        values, low = self._run.fields["u"], self._place + self._run.lattice.first
        pieces = []
        for first, shape in self._boxes:
            ends = np.maximum(low, first), np.minimum(low + values.shape, np.add(first, shape))
            here, there = (tuple(map(slice, *(np.maximum(end - start, 0) for end in ends))) for start in (low, first))
            pieces.append((there, values[here]))
        field = np.full(self._shape, self._reference)
        for place, piece in self._group.all_to_all(pieces):
            field[place] = piece
        return field

    def at(self, t: float) -> np.ndarray:
        """Return the field at a time, linear between steps; for a time before the last step the run is repeated from
        its start.
        """
        if t < (self._run.step_count - 1) * self.dt:
            self._begin()
        while self._run.step_count * self.dt < t:
            self._sever(self._run.step_count)
            self._run.step()
            self._before, self._after = self._after, self._field()
        part = max(self._run.step_count - t / self.dt, 0.0)
        return self._after + min(part, 1.0) * (self._before - self._after)

    def _sever(self, step: int) -> None:
        """Cut the bonds that have broken before a step of this run; in a repetition, those of the first time."""
        if self._broken is None:
            return
        if step == self._looks:
            rows = table_changes(self._broken.own(self._table), self._broken.table())
            rows = np.concatenate(self._group.gather(rows))
            self._looks += 1
            if len(rows):
                self._changes[step] = rows
        if step in self._changes:
            self._table = after_changes(self._table, self._changes[step])
            self._run.resting.sever(self._insulated.of(self._table, self._run.parts), step)

    def state(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return when bonds of the solid have broken, in steps of this run, which repeats them."""
        if self._broken is None:
            return {}, {}
        rows = [
            np.column_stack([np.full(len(changes), step), *self._broken.bonds_of(changes[:, 0]), changes[:, 1]])
            for step, changes in self._changes.items()
        ]
        return {"heat/changes": np.concatenate([np.zeros((0, 6), np.int64), *rows])}, {"heat": {"looks": self._looks}}

    def take(self, arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any]) -> None:
        """Restore what `state` returned, and begin again."""
        if self._broken is None:
            return
        rows = arrays["heat/changes"]
        table = np.column_stack([self._broken.keys(rows[:, 1:4], rows[:, 4]), rows[:, 5]])
        self._changes = {int(step): table[rows[:, 0] == step] for step in np.unique(rows[:, 0])}
        self._looks = int(meta["heat"]["looks"])
        self._broken.forget()
        self._begin()


def insulated(load: ThermalLoad, broken: BrokenBonds, heat: Any, place: np.ndarray) -> InsulatedBonds:
    """Return the bonds of a heat conduction that broken bonds of the solid interrupt; `place` is the number of its
    first node in the lattice of the solid. Raises InputError if the contact conductance is above that of the bonds
    across a plane.
    """
    setup, engine = load.temperature, heat.grid.engine
    # nodes of an area 1 have bonds across a plane x times their number of steps across it
    across = np.abs(engine.weights @ np.abs(engine.offsets[:, -setup.lattice.dim :])).mean() / 2
    most = float(across * setup.lattice.spacing / setup.model.source_factor)
    if load.contact_conductance > most * (1 + 1e-12):  # to rounding
        raise InputError(
            "cracks would conduct more than the bonds that have broken",
            value=load.contact_conductance,
            limit=f"<= {most:.6g}",
            key="load.contact_conductance",
            remedy="a smaller spacing or horizon of the heat",
        )
    remaining = min(load.contact_conductance / most, 1.0)
    return InsulatedBonds(broken, engine.offsets, setup.sides, setup.lattice.shape, place, remaining)


def unheated_strips(near: NearField, sides: Sides) -> list[tuple[Key, Any, int]]:
    """Return the sides that are neither free, periodic nor shared with other processes, each with the number of nodes
    next to it whose bonds ignore heat.
    """
    return [
        (key, boundary, _STRIP * near.stencil.reach[key[0]])
        for key, boundary in sides.items()
        if boundary.bonded and not boundary.periodic and not boundary.shared
    ]


def check_known(unknown: int) -> None:
    """Raise InputError if the temperature is unknown on some nodes of the solid."""
    if unknown:
        raise InputError(
            "the temperature is not known on nodes of the solid",
            value=f"{unknown} nodes",
            key="load.temperature",
            remedy='conditions of another kind than "mirror", whose images lie there, and the body of the solid',
        )


def _given(load: ThermalLoad, lattice: Lattice) -> Callable[[float], Any]:
    """Return a given temperature as a function of time."""
    space, time = split(load.temperature, lattice)
    return time if space is None else lambda t: space * time(t)

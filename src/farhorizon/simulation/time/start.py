"""The start of a run: initial values, and the level one step before them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from farhorizon.boundaries import ExactEnds
from farhorizon.engine.features.dissipation import begin_dissipation
from farhorizon.engine.features.relaxations import begin_relaxations, relaxed
from farhorizon.errors import InputError
from farhorizon.geometry.shapes import Shape
from farhorizon.inputs.incidence import Incidence
from farhorizon.inputs.sources import check_size, field, widened
from farhorizon.medium.integrators import ModifiedEquation
from farhorizon.simulation.heat.solid_and_liquid import placed
from farhorizon.simulation.processes.process_group import ProcessGroup
from farhorizon.simulation.setup.grid import Grid
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Setup, Sides
from farhorizon.simulation.sides.exterior import Exterior


@dataclass(frozen=True, eq=False)
class Start:
    """Initial data of a run."""

    u: np.ndarray  # values less the background, of the field's shape
    v: np.ndarray  # velocities
    solid: np.ndarray  # of bool; the metal of a corrosion, of the lattice's shape


def start_of(setup: Setup, near: NearField, sides: Sides, exterior: Exterior) -> Start:
    """Return the initial data of a set-up; raises InputError for values that extend beyond the near field into the
    surrounding medium, and an unknown field.
    """
    model, initial = near.model, setup.initial or {}
    if continuing := [key for key, side in sides.items() if side.derivatives]:
        exterior = exterior.but_for(continuing)
    u = _initial("u", setup, near, exterior)
    known = ("u", "v") if model.order == 2 else ("u",)
    moving = "v" in initial and model.order == 2
    v = _initial("v", setup, near, exterior) if moving else np.broadcast_to(0.0, near.field_shape)
    for name in set(map(str, initial)) - set(known):
        raise InputError("unknown initial field", value=name, limit=", ".join(known), key="initial")
    if near.prescribed.constraints:
        u = near.prescribed.start(u)
    if model.dissolution is None:
        return Start(u, v, np.zeros(near.lattice.shape, bool))
    solid, metal = placed(setup, sides)
    for number, specimen in enumerate(setup.specimens):
        if isinstance(specimen.where, Shape):
            shape = specimen.where
            exterior.check_function(
                lambda *at, shape=shape: shape.contains(np.stack(at, -1)), 1.0, f"specimen[{number}]"
            )
    return Start(np.where(solid, metal - setup.background, u) if solid.any() else u, v, solid)


def check_range(start: Start, dtype: str, team: ProcessGroup) -> None:
    """Raise InputError for initial data whose squares overflow or underflow in the number type of the run."""
    for name, values in (("u", start.u), ("v", start.v)):
        check_size(values, f"initial.{name}", dtype, team.largest)


def drifting(near: NearField, sides: Sides) -> list[str]:
    """Return a note on a body in single precision that nothing fixes: a step sums values, so rounding is proportional
    to values rather than differences. It acts like weak springs to zero, of either sign, whose effect grows with the
    square of the number of steps.
    """
    loose = all(side.periodic or side.image > 0 for side in sides.values())
    held = near.busy.any() or np.any(near.stencil.reaction) or not loose
    if near.model.order == 1 or held:
        return []
    return [
        "in single precision rounding pushes a body that nothing fixes: in trials its motion as a whole was off by 0.1 "
        "to 14 percent after 2000 steps, which grows with the square of their number; use dtype float64"
    ]


def own_step(setup: Setup, near: NearField) -> list[str]:
    """Return a note on the automatic step of a run of waves in which something scatters, and from which that without it
    may be subtracted.
    """
    if near.model.order == 1 or not (setup.dt is None or callable(setup.dt)):
        return []
    return [
        f"dt = {float(near.dt)!r} was chosen for this medium: where the field of another run, such as that without the "
        "scatterer, is to be subtracted, give both the smaller of their steps, because with steps of their own their "
        "waves disperse differently, and the difference is wrong by per cents of the field before anything is hit"
    ]


def with_incident_waves(start: Start, incident: Sequence[Incidence]) -> Start:
    """Return the initial data, including those of incident waves that are already in their boxes."""
    parts = [wave.initial() for wave in incident if not wave.passage.rests]
    return (
        replace(start, u=start.u + sum(u for u, _ in parts), v=start.v + sum(v for _, v in parts)) if parts else start
    )


def _initial(name: str, setup: Setup, near: NearField, exterior: Exterior) -> np.ndarray:
    """Return initial values minus the background; refuses data that extend beyond the near field."""
    initial = setup.initial or {}
    level = near.background if name == "u" else 0.0
    value, key = initial.get(name, level), f"initial.{name}"
    complete = value if name in initial else np.full(near.field_shape, level)
    given = field(complete, near.lattice, near.stencil.components, key) - level
    values = near.inside(given)
    entries = value if isinstance(value, list | tuple) else [value]
    known = [isinstance(entry, np.ndarray) for entry in entries]  # arrays are known on the lattice alone
    if any(known):
        seen = given if near.closed is not None else values
        exterior.check_values(near.size(seen if all(known) else seen[known]), key)
    if name in initial and not all(known) and exterior.examines:
        if any(known):
            value = [level if is_known else entry for entry, is_known in zip(entries, known, strict=True)]
        peak = float(np.abs(values).max(initial=0))
        exterior.check_function(near.function(value), peak, key, level, "initial value")
    return values


def continued(name: str, setup: Setup, near: NearField, sides: Sides, grid: Grid) -> np.ndarray | None:
    """Return the initial data on the core beyond sides whose nodes stretch derivatives, zero in the near field; None if
    there are no such data or sides.
    """
    value = (setup.initial or {}).get(name)
    beyond = {key: grid.margins[key] for key, side in sides.items() if side.derivatives}
    if value is None or not beyond:
        return None
    lattice, core = near.lattice, grid.core
    wide = field(widened(value, lattice, beyond), lattice.extended(beyond), near.stencil.components, f"initial.{name}")
    around = [tuple(grid.margins[a, side] - beyond.get((a, side), 0) for side in (-1, 1)) for a in range(lattice.dim)]
    values = np.pad(wide, [(0, 0), *around]).reshape(-1, *core.nodes)
    values *= grid.engine.get("exists", core.node_indices())
    values[(slice(None), *grid.near)] = 0
    return np.asarray(values)


@dataclass(frozen=True, eq=False)
class Motion:
    """Time levels of an equation of second order at the start of a run and at the release of nodes."""

    near: NearField
    grid: Grid
    ends: ExactEnds | None
    force: Callable[[float], np.ndarray]  # returns the action of the sources at a time, in the shape of the field

    def acceleration(self, time: float) -> np.ndarray:
        """Return the acceleration of the present state by the medium, exact ends and sources, as a level."""
        engine = self.grid.engine
        acceleration = relaxed(engine, engine.apply("u"))
        if self.ends is not None:
            acceleration[self.ends.nodes] += self.ends.forces()
        part = self.grid.view(acceleration)
        part += self.force(time).reshape(part.shape)
        return acceleration * engine.mobility

    def step_back(self, v: np.ndarray, resting: np.ndarray, beyond: np.ndarray | None = None) -> None:
        """Set the level one step before the start, from initial velocities `v` of the near field and, if given,
        `beyond` of the core beyond it; the places `resting` of a level do not move.
        """
        engine, dt, model = self.grid.engine, self.near.dt, self.near.model
        engine.begin("u")
        begin_relaxations(engine)
        begin_dissipation(engine)
        accelerations = self.acceleration(0.0).astype(float)
        change = -(dt**2) / 2 * accelerations
        if isinstance(model.integrator, ModifiedEquation):
            change += self._higher_terms(accelerations, v, resting)
        rate = self.grid.view(change)
        rate += (dt * (1 + model.damping * dt) * v).reshape(rate.shape)
        if beyond is not None:
            self.grid.core.view(change)[...] += dt * (1 + model.damping * dt) * beyond
        change[resting] = 0
        if engine.stages.increments:
            engine.put("increment", change)
        nodes = engine.all_components(self.grid.layout.box.node_indices())
        engine.put("u_old", engine.get("u", nodes) - change[nodes], nodes)
        engine.complete("u_old")  # drag reads the velocities of neighbours
        engine.put("memory", 0)
        if engine.passes is not None:
            engine.apply("u_old")  # states of nodes are those of the previous step, as after any step
        engine.begin("u")

    def _higher_terms(self, acceleration: np.ndarray, v: np.ndarray, resting: np.ndarray) -> np.ndarray:
        """The terms of third and fourth order in the step by which the field changes before the start, as a level:
        ``dt^3/6 (L v + s_t) - dt^4/24 (L u_tt + s_tt)``; the derivatives of the sources are those of the parabola
        through the first three steps, since a source need not have values before the start.
        """
        engine, dt = self.grid.engine, self.near.dt
        velocity, acceleration = engine.level(), acceleration.astype(engine.dtype)
        part = self.grid.view(velocity)
        part[...] = v.reshape(part.shape)
        terms = []
        for level in (velocity, acceleration):
            level[resting] = 0
            terms.append(engine.apply(level).astype(float))
        first, second, third = (self.force(n * dt) for n in range(3))
        for term, source in zip(
            terms, ((-1.5 * first + 2 * second - 0.5 * third) / dt, (first - 2 * second + third) / dt**2), strict=True
        ):
            part = self.grid.view(term)
            part += source.reshape(part.shape)
        return (dt**3 / 6 * terms[0] - dt**4 / 24 * terms[1]) * engine.mobility

    def release(self, step: int) -> None:
        """Release nodes whose constraint ends at a step: their older level is set as at the start of a run."""
        engine, dt, model = self.grid.engine, self.near.dt, self.near.model
        for nodes, rate in self.near.prescribed.released(step):
            at = self.grid.indices[nodes]
            change = dt * (1 + model.damping * dt) * rate - dt**2 / 2 * self.acceleration(step * dt)[at].astype(float)
            engine.put("u_old", engine.get("u", at) - change, at)
            engine.complete("u_old")
            if engine.stages.increments:
                engine.put("increment", change, at)

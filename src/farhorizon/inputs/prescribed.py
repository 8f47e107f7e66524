"""Constraints: prescribed values and velocities of nodes inside the body."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import FIELD, RATE, Duration, Function, OneOf, Points, Unit
from farhorizon.errors import InputError, shown
from farhorizon.files.storable import Storable
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Shape
from farhorizon.inputs.expressions import Expression, as_signal
from farhorizon.medium.integrators import Integrator, RungeKutta4, RungeKuttaChebyshev

_ROUNDING = 1e-9  # of a step, for the time of a release
_OF_TIMES = Function(place=False, components=True)
_VALUE = "Value as a function of t; for displacements a list with one entry per axis, false for a free component."


@dataclass(frozen=True)
class Prescribed(Storable):
    """A prescribed value of the field at some nodes, or its rate of change, from the start of the run.

    Parameters
    ----------
    where : array_like or Shape
        Points, each of which is replaced by the nearest node (shape (n, dim), or (n,) in 1D), a shape, or a mask of the
        lattice's shape.
    value : float, callable, str or Expression, or a list of one per component, optional
        Value as a function of t. For displacements, a list with one entry per axis, with None for a free component.
    until : float, optional
        Time after which the nodes are released; never unless given.
    rate : float, callable, str or Expression, or a list of one per component, optional
        Velocity with which they are released (waves); unless given, the derivative of `value` at that time.
    velocity : float, callable, str or Expression, or a list of one per component, optional
        Instead of `value`: the nodes move from their initial values with this velocity, a function of t.

    Raises
    ------
    InputError
        A value that is not a function of t, an end before the start, both a value and a velocity or neither, no
        component at all.

    Notes
    -----
    Displacements prescribed by a velocity are its integrals over the steps by Simpson's rule. The forces that constrain
    the nodes do work, which the energy balance includes under "work".

    Nodes that are permanently fixed at the background value (0 unless given) and reach an absorbing side continue
    beyond it along its normal indefinitely, as cracks do: like a wire or a rigid line that does not end. There, the
    constraint must not change within one reach of the bonds and one more node; nodes with another value, or that are
    released, must keep away from such sides.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> shaken = fh.Prescribed([0.0], "sin(t)")
    >>> sim = fh.Simulation(fh.Lattice(1.0, -9, 9), fh.Wave(fh.Kernel(1.0)), constraints=[shaken])
    >>> _ = sim.run(until=2.0)
    >>> bool(abs(sim.fields["u"][9] - np.sin(sim.time)) < 1e-12)
    True
    >>> plate = fh.Lattice(1.0, (-9.0, -9.0), (9.0, 9.0))
    >>> grip = fh.Prescribed(fh.Box((-9.0, 8.0), (9.0, 9.0)), velocity=[None, 1e-3])  # free to slide along x
    >>> rest = fh.Prescribed(fh.Box((-9.0, -9.0), (9.0, -8.0)), [0.0, 0.0])
    >>> sim = fh.Simulation(plate, fh.Elastic(fh.Kernel(2.0), 1.0), fh.Free(), constraints=[grip, rest])
    >>> _ = sim.run(until=5.0)
    >>> bool(abs(sim.fields["u"][1][4, 18] - 1e-3 * sim.time) < 1e-15)
    True
    """

    where: Annotated[
        Any,
        OneOf(
            points=Annotated[Points, "Points, each replaced by the nearest node."],
            region=Annotated[Shape, "Region that contains the nodes."],
        ),
    ]
    value: Annotated[Any, _OF_TIMES, Unit(FIELD), _VALUE] = None
    until: Duration | None = None
    rate: Annotated[Any, _OF_TIMES, Unit(RATE)] = None
    velocity: Annotated[Any, _OF_TIMES, Unit(RATE)] = None

    def __post_init__(self) -> None:
        if (self.value is None) == (self.velocity is None):
            raise InputError("give either a value or a velocity", key="constraint.value")
        if self.velocity is not None and self.rate is not None:
            raise InputError(
                "nodes with a velocity are released with it",
                value=shown(self.rate),
                key="constraint.rate",
                remedy="leave it out",
            )
        kinds.set_fields(
            self,
            **{
                name: _by_component(getattr(self, name), f"constraint.{name}") for name in ("value", "rate", "velocity")
            },
            until=None if self.until is None else kinds.number(self.until, "constraint.until", least=0),
        )

    @property
    def time_history(self) -> list[Any]:
        """Value, or velocity, of each component as a function of t; None for a free component."""
        given = self.velocity if self.value is None else self.value
        return given if isinstance(given, list) else [given]

    def at(self, t: float) -> Any:
        """The value, or the velocity, at a time; for a list, each entry. Raises InputError if one is not finite."""
        values = [None if time_history is None else _at(time_history, t) for time_history in self.time_history]
        return values if isinstance(self.velocity if self.value is None else self.value, list) else values[0]

    def nodes(self, lattice: Lattice) -> np.ndarray:
        """Flat indices of the nodes in the lattice, or in a part of one; raises InputError if there is none in the
        whole lattice, or if a point lies outside.
        """
        nodes = lattice.inside(self.where) if isinstance(self.where, Shape) else self._listed(lattice)
        if lattice.whole is lattice and not nodes.size:
            raise InputError("a constraint holds no node", key="constraint.where", remedy="move it into the near field")
        return nodes

    def _listed(self, lattice: Lattice) -> np.ndarray:
        """Flat indices of the nodes given by a mask or by points."""
        given = (
            np.asarray(self.where)
            if isinstance(self.where, np.ndarray)
            else kinds.array(self.where, "constraint.where")
        )
        if given.dtype != bool:
            points = kinds.array(given, "constraint.where")
            points = points.reshape(-1, 1) if lattice.dim == 1 else np.atleast_2d(points)
            nodes = np.array([lattice.whole.index(point, "constraint.where") for point in points], int).reshape(
                -1, lattice.dim
            )
            own_nodes = np.unique(lattice.own(np.ravel_multi_index(tuple(nodes.T), lattice.whole.shape))[1])
            return own_nodes if lattice.mask is None else own_nodes[lattice.mask.flat[own_nodes]]
        if given.shape != lattice.whole.shape:
            raise InputError(
                "a mask must have the lattice's shape",
                value=given.shape,
                limit=lattice.whole.shape,
                key="constraint.where",
            )
        mask = given[lattice.within]
        return np.flatnonzero(mask if lattice.mask is None else mask & lattice.mask)

    def keeps(self, component: int, background: float) -> bool:
        """Whether a component is permanently fixed at the background; for a Python function this is not known."""
        time_history = self.time_history[component]
        if (
            self.value is None
            or self.until is not None
            or not isinstance(time_history, Expression)
            or time_history.uses_time
        ):
            return False
        return _at(time_history, 0.0) == background

    def last_step(self, dt: float) -> float:
        """Number of the last step in which the value is prescribed."""
        return np.inf if self.until is None else np.floor(self.until / dt + _ROUNDING)

    def release_rate(self, component: int, t: float, dt: float) -> float:
        """Velocity of a component when it is released at time t."""
        rate = self.velocity if self.value is None else self.rate
        if isinstance(rate, list):
            rate = rate[component]
        if rate is not None:
            return _at(rate, t)
        # Backward difference of fourth order: the value need not be defined at later times.
        h, value = min(dt, t / 4 if t > 0 else dt) / 16, self.time_history[component]
        return float(np.dot([25 / 12, -4, 3, -4 / 3, 1 / 4], [_at(value, t - k * h) for k in range(5)]) / h)


def _by_component(given: Any, key: str) -> Any:
    """Return a function of t, or a list of such functions and of None."""
    if not isinstance(given, list | tuple):
        return _of_time(given, key)
    time_histories = [_of_time(component, f"{key}[{i}]") for i, component in enumerate(given)]
    if all(component is None for component in time_histories):
        raise InputError("a constraint prescribes no component", value=list(given), key=key, remedy="leave it out")
    return time_histories


def _of_time(given: Any, key: str) -> Any:
    """Return a function of t; None is returned as it is."""
    if given is None:
        return None
    if isinstance(given, Expression) and given.uses_space:
        raise InputError("a prescribed value is a function of t only", value=given.text, key=key)
    return as_signal(given, key)


def _at(time_history: Callable[[float], Any], t: float) -> float:
    """Value of a function of t at a time; raises InputError if it is not finite."""
    value = float(kinds.array(time_history(t), "constraint.value", shape=(), finite=False))
    if not np.isfinite(value):
        raise InputError("a prescribed value is not finite", value=f"{value} at t = {t:g}", key="constraint.value")
    return value


@dataclass
class _Course:
    """One component of the nodes of a constraint."""

    constraint: Prescribed
    component: int
    places: np.ndarray  # of int; flat indices in the field, components first
    last: float  # number of the last step in which it is prescribed
    first: np.ndarray  # shape (places,); values at the start
    way: list[float]  # for a velocity, the displacement since the start after each step, as far as it has been computed

    def value_over(self, background: float) -> Callable[[float], float]:
        """The prescribed value less the background as a function of t, zero after the release."""
        time_history, end = self.constraint.time_history[self.component], self.constraint.until
        return lambda t: _at(time_history, t) - background if end is None or t <= end else 0.0

    def values(self, step: int, count: int, dt: float) -> np.ndarray:
        """Values after each of the `count` steps that follow `step`, shape (count, places) or (count, 1)."""
        time_history, steps = self.constraint.time_history[self.component], range(step + 1, step + count + 1)
        if self.constraint.value is not None:
            return np.array([_at(time_history, dt * n) for n in steps], float)[:, None]
        while len(self.way) <= step + count:  # summed in the order of the steps, wherever a run begins
            t = dt * (len(self.way) - 1)
            mean = (_at(time_history, t) + 4 * _at(time_history, t + dt / 2) + _at(time_history, t + dt)) / 6
            self.way.append(self.way[-1] + dt * mean)
        return np.array([self.way[n] for n in steps])[:, None] + self.first


class PrescribedNodes:
    """The constraints of one run, and which of them still hold. Raises InputError for an integrator of several stages,
    two constraints on one node, a number of entries other than that of the field's components, and what
    `Prescribed.nodes` refuses.
    """

    def __init__(
        self,
        constraints: tuple[Prescribed, ...],
        lattice: Lattice,
        components: int,
        integrator: Integrator,
        dt: float,
        background: float,
    ) -> None:
        for constraint in constraints:
            if not isinstance(constraint, Prescribed):
                raise InputError("not a constraint", value=repr(constraint), limit="Prescribed", key="constraint")
            _check_components(constraint, components)
        if constraints and isinstance(integrator, RungeKutta4 | RungeKuttaChebyshev):
            raise InputError(
                "a prescribed value needs a scheme of one stage",
                value=integrator.name,
                key="constraint",
                remedy="integrator = euler, or a Temperature, which holds in all stages",
            )
        self.constraints, self.dt, self.background = constraints, dt, background
        self.nodes = [c.nodes(lattice) for c in constraints]
        size = int(np.prod(lattice.shape))
        self._held = [
            _Course(constraint, number, nodes + number * size, constraint.last_step(dt), np.zeros(len(nodes)), [0.0])
            for constraint, nodes in zip(constraints, self.nodes, strict=True)
            for number, time_history in enumerate(constraint.time_history)
            if time_history is not None
        ]
        everywhere = np.concatenate([np.zeros(0, np.int64), *(held.places for held in self._held)])
        if len(np.unique(everywhere)) < len(everywhere):
            raise InputError("two constraints apply to the same node", key="constraint", remedy="separate them")

    def start(self, u: np.ndarray) -> np.ndarray:
        """Initial values less the background, with those that are prescribed at t = 0."""
        if not self.constraints:
            return u
        started = u.copy()
        for held in self._held:
            if held.constraint.value is not None:
                started.flat[held.places] = _at(held.constraint.time_history[held.component], 0.0) - self.background
            held.first[:] = started.flat[held.places] + self.background
        return started

    def now(self, t: float) -> list[np.ndarray]:
        """Return the state at a time: for each prescribed component its value less the background, or its velocity, and
        1; zeros after its release.
        """
        return [
            np.array([held.value_over(self.background if held.constraint.velocity is None else 0.0)(t), 1.0])
            if t <= (np.inf if held.constraint.until is None else held.constraint.until)
            else np.zeros(2)
            for held in self._held
        ]

    @property
    def driven(self) -> list[tuple[np.ndarray, Callable[[float], float]]]:
        """Places in the field with prescribed values, and these values less the background as functions of t, zero
        after the release.
        """
        return [
            (held.places, held.value_over(self.background)) for held in self._held if held.constraint.velocity is None
        ]

    @property
    def at_rest(self) -> np.ndarray:
        """Places in the field that are permanently held at the background."""
        kept = (held.places for held in self._held if held.constraint.keeps(held.component, self.background))
        return np.concatenate([np.zeros(0, np.int64), *kept])

    def _active(self, step: int) -> list[_Course]:
        """Prescribed components that are still held after the step `step`."""
        return [held for held in self._held if step < held.last]

    def held(self, step: int) -> np.ndarray:
        """Places in the field that are still held after a step."""
        return np.concatenate([np.zeros(0, np.int64), *(held.places for held in self._active(step))])

    def holding(self, step: int) -> list[int]:
        """Numbers of the constraints, among these, that still hold after a step."""
        return [i for i, constraint in enumerate(self.constraints) if step < constraint.last_step(self.dt)]

    def table(self, step: int, count: int) -> np.ndarray:
        """Return the values of the held places after each of `count` steps from `step` on, less the background; shape
        (count, places).
        """
        values = [
            np.broadcast_to(held.values(step, count, self.dt), (count, len(held.places))) for held in self._active(step)
        ]
        return np.concatenate([np.zeros((count, 0)), *values], axis=1) - self.background

    def allow(self, step: int, most: int) -> int:
        """How many of the `wanted` steps may be run before any nodes are released."""
        return int(min([most, *(held.last - step for held in self._active(step))]))

    def released(self, step: int) -> list[tuple[np.ndarray, float]]:
        """Places in the field that are released at a step, and their velocities."""
        return [
            (held.places, held.constraint.release_rate(held.component, step * self.dt, self.dt))
            for held in self._held
            if held.last == step
        ]


def _check_components(constraint: Prescribed, components: int) -> None:
    """Refuse a constraint that does not have one entry for each component of the field."""
    for name in ("value", "velocity", "rate"):
        given = getattr(constraint, name)
        if given is None:
            continue
        entries = len(given) if isinstance(given, list) else None
        if (entries or 1) != components or (entries is None) != (components == 1):
            raise InputError(
                "a constraint of a vector field needs one entry per component"
                if components > 1
                else "a constraint of a scalar field has one value",
                value="one for all" if entries is None else f"{entries} entries",
                limit=f"a list of {components}" if components > 1 else "no list",
                key=f"constraint.{name}",
                remedy="None (in a case false) for a component that is free" if components > 1 else "",
            )

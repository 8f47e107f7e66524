"""Constraints: what nodes inside the body are made to do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from farhorizon import kinds
from farhorizon.errors import InputError
from farhorizon.files.storable import Storable
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Shape
from farhorizon.inputs.expressions import Expression, as_signal
from farhorizon.medium.integrators import Integrator, RungeKutta4


@dataclass(frozen=True)
class Prescribed(Storable):
    """A prescribed value of the field on some nodes, from the start on.

    Parameters
    ----------
    where : array_like or Shape
        Points, each of which stands for the node nearest to it (shape (n, dim), or (n,) in 1D), a shape, or a mask of
        the lattice's shape.
    value : float, callable, str or Expression
        Value as a function of t.
    until : float, optional
        The nodes are released after this time; never unless given.
    rate : float, callable, str or Expression, optional
        Velocity with which they are released (waves); the derivative of `value` there unless given.

    Raises
    ------
    InputError
        What is no function of t, an end before the start.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> shaken = fh.Prescribed([0.0], "sin(t)")
    >>> sim = fh.Simulation(fh.Lattice(1.0, -9, 9), fh.Wave(fh.Kernel(1.0)), constraints=[shaken])
    >>> _ = sim.run(until=2.0)
    >>> bool(abs(sim.fields["u"][9] - np.sin(sim.time)) < 1e-12)
    True
    """

    where: Any
    value: Any
    until: float | None = None
    rate: Any = None

    def __post_init__(self) -> None:
        for name in ("value", "rate"):
            given = getattr(self, name)
            if isinstance(given, Expression) and given.uses_space:
                raise InputError(
                    "a prescribed value is a function of t only", value=given.text, key=f"constraint.{name}"
                )
        kinds.settle(
            self,
            value=as_signal(self.value, "constraint.value"),
            rate=None if self.rate is None else as_signal(self.rate, "constraint.rate"),
            until=None if self.until is None else kinds.number(self.until, "constraint.until", least=0),
        )

    def at(self, t: float) -> float:
        """The value at a time; InputError if it is not finite."""
        found = float(kinds.array(self.value(t), "constraint.value", shape=(), finite=False))
        if not np.isfinite(found):
            raise InputError("a prescribed value is not finite", value=f"{found} at t = {t:g}", key="constraint.value")
        return found

    def nodes(self, lattice: Lattice) -> np.ndarray:
        """Flat indices of the nodes in the lattice; InputError if there are none, or a point lies outside."""
        if isinstance(self.where, Shape):
            mask = self.where.contains(np.stack(lattice.coordinates(), axis=-1))
        else:
            given = (
                np.asarray(self.where)
                if isinstance(self.where, np.ndarray)
                else kinds.array(self.where, "constraint.where")
            )
            if given.dtype == bool:
                if given.shape != lattice.shape:
                    raise InputError(
                        "a mask must have the lattice's shape",
                        value=given.shape,
                        limit=lattice.shape,
                        key="constraint.where",
                    )
                mask = given
            else:
                mask = np.zeros(lattice.shape, bool)
                points = kinds.array(given, "constraint.where")
                for point in points.reshape(-1, 1) if lattice.dim == 1 else np.atleast_2d(points):
                    mask[lattice.index(point)] = True
        if lattice.mask is not None:
            mask = mask & lattice.mask
        if not mask.any():
            raise InputError("a constraint holds no node", key="constraint.where", remedy="move it into the near field")
        return np.flatnonzero(mask)

    def last_step(self, dt: float) -> float:
        """Number of the last step that is prescribed."""
        return np.inf if self.until is None else np.floor(self.until / dt + 1e-9)

    def release_rate(self, t: float, dt: float) -> float:
        """Velocity at the release at time t."""
        if self.rate is not None:
            return float(self.rate(t))
        # Backward difference of fourth order: the value need not be defined later.
        h = min(dt, t / 4 if t > 0 else dt) / 16
        return float(np.dot([25 / 12, -4, 3, -4 / 3, 1 / 4], [self.at(t - k * h) for k in range(5)]) / h)


class PrescribedNodes:
    """The constraints of one run, and which of them still hold.

    Parameters
    ----------
    constraints : sequence of Prescribed
    lattice : Lattice
    integrator : Verlet, Euler or RungeKutta4
    dt : float
    background : float

    Raises
    ------
    InputError
        Runge-Kutta, two constraints on one node, or what `Prescribed.nodes` refuses.
    """

    def __init__(
        self,
        constraints: tuple[Prescribed, ...],
        lattice: Lattice,
        integrator: Integrator,
        dt: float,
        background: float,
    ) -> None:
        for constraint in constraints:
            if not isinstance(constraint, Prescribed):
                raise InputError("not a constraint", value=repr(constraint), limit="Prescribed", key="constraint")
        if constraints and isinstance(integrator, RungeKutta4):
            raise InputError(
                "a prescribed value needs a scheme of one stage",
                value=integrator.name,
                key="constraint",
                remedy="integrator = euler",
            )
        self.constraints, self.dt, self.background = constraints, dt, background
        self.nodes = [c.nodes(lattice) for c in constraints]
        self.last = [c.last_step(dt) for c in constraints]
        everywhere = np.concatenate([np.zeros(0, np.int64), *self.nodes])
        if len(np.unique(everywhere)) < len(everywhere):
            raise InputError("two constraints hold the same node", key="constraint", remedy="separate them")

    def start(self, u: np.ndarray) -> np.ndarray:
        """Initial values with those that are prescribed at t = 0."""
        if not self.constraints:
            return u
        started = u.copy()
        for constraint, nodes in zip(self.constraints, self.nodes, strict=True):
            started.flat[nodes] = constraint.at(0.0) - self.background
        return started

    def active(self, step: int) -> list[int]:
        """Numbers of the constraints that hold after the step `step`, too."""
        return [i for i, last in enumerate(self.last) if step < last]

    def held(self, step: int) -> np.ndarray:
        """Flat indices of the nodes that are held beyond a step."""
        return np.concatenate([np.zeros(0, np.int64), *(self.nodes[i] for i in self.active(step))])

    def table(self, step: int, count: int) -> np.ndarray:
        """Values of the held nodes after each of `count` steps from `step` on, less the background; shape (count,
        nodes).
        """
        active = self.active(step)
        values = [
            [self.constraints[i].at(self.dt * (step + n)) - self.background for i in active]
            for n in range(1, count + 1)
        ]
        return np.repeat(
            np.array(values, float).reshape(count, len(active)), [len(self.nodes[i]) for i in active], axis=1
        )

    def allow(self, step: int, wanted: int) -> int:
        """How many of the `wanted` steps may be run before nodes are released."""
        return int(min([wanted, *(self.last[i] - step for i in self.active(step))]))

    def released(self, step: int) -> list[tuple[np.ndarray, float]]:
        """Nodes that are released at a step, and their velocities."""
        return [
            (nodes, c.release_rate(step * self.dt, self.dt))
            for c, nodes, last in zip(self.constraints, self.nodes, self.last, strict=True)
            if last == step
        ]

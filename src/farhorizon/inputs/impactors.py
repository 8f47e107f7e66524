"""Impactors: rigid shapes that push the nodes of an elastic solid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import ANY, Function, Toml, Unit
from farhorizon.engine.features.impactors import BOX, DIFFERENCE, INTERSECTION, POLYGON, ROUND, UNION
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Ball, Box, Difference, Disc, Intersection, Polygon, Shape, Union
from farhorizon.inputs.expressions import as_signal
from farhorizon.inputs.loads import Load

_PAIRS: dict[type[Shape], int] = {Union: UNION, Intersection: INTERSECTION, Difference: DIFFERENCE}


@dataclass(frozen=True)
class Impactor(Load):
    r"""A rigid shape that pushes the nodes that it meets: a projectile, a drop ball, a roller or an indenter.

    It follows a prescribed path, or has a mass and moves freely. It does not turn. `Impacts` records its motion and its
    force.

    Parameters
    ----------
    shape : Shape
        The shape where it is put: `Disc`, `Ball`, `Box`, `Polygon`, and what ``|``, ``&`` and ``-`` make of them. In
        three dimensions a plane shape is a cylinder without end along z. Nodes may touch its surface at the start, but
        not lie inside.
    mass : float, optional
        Mass of a shape that moves freely, in two dimensions per unit thickness.
    velocity : sequence of float, optional
        Its initial velocity, one component per axis; at rest unless given.
    path : sequence of (callable, str, Expression or float), optional
        Instead of a mass: the displacement of the shape as a function of t, one component per axis.
    friction : float
        Coulomb's coefficient of friction.
    stiffness : float, optional
        Pressure per depth of nodes in the shape. Unless given, the modulus of P waves over the spacing: that of one
        layer of cells, so that the nodes of a surface come as deep into the shape as the pressure compresses the
        material in one spacing, which is as accurate as the lattice. It is less, and said, if the time step demands it.

    Raises
    ------
    InputError
        Both a path and a mass, or neither; a velocity on a path; values that are not finite or out of range. When the
        simulation is created: another shape, nodes inside it, a velocity with which it would pass through nodes, a
        stiffness too large for the time step. In a run: a `ValidityWarning` where it pushes nodes at an absorbing side,
        because it does not push those beyond.

    Notes
    -----
    A node at depth d in the shape, the distance to the nearest point of its surface, is accelerated along the normal
    there by the force ``stiffness * spacing^(dim - 1) * d``. Friction stops its motion along the surface relative to
    the shape within one step, by a force of at most `friction` times this. The opposite forces act on the shape. The
    momentum of solid and shape is conserved to rounding error. The work on the nodes is part of "work" in
    `Simulation.energies`. Without friction, this work, the kinetic energy of the shape and the energy of its contact
    ("stored" in `Impacts`) sum to a constant, to the square of the time step.

    In every step, one component of all nodes of the near field is compared with the bounds of the shapes.

    Examples
    --------
    >>> import farhorizon as fh
    >>> ball = fh.Impactor(fh.Disc(2.0, (0.0, 2.5)), mass=5.0, velocity=(0.0, -0.1))
    >>> motion = fh.Impacts()
    >>> plate = fh.Lattice(0.5, (-6.0, -4.0), (6.0, 0.0))
    >>> sides = {"all": fh.LatticePML(nodes=8), "y+": fh.Free()}
    >>> model = fh.Elastic(fh.Kernel(1.0, exponent=1), young=1.0)
    >>> sim = fh.Simulation(plate, model, sides, loads=[ball], observe=[motion])
    >>> _ = sim.run(until=40.0)
    >>> bool(motion.data["velocity"][-1, 0, 1] > 0)  # it bounces
    True
    """

    shape: Annotated[Shape, "The rigid shape where it starts."]
    mass: Annotated[float | None, Unit(ANY)] = None
    velocity: Annotated[Sequence[float] | None, Unit("m/s")] = None
    path: Annotated[
        Sequence[Any] | None, Toml(list[str | float]), Function(place=False, components=True), Unit("m")
    ] = None
    friction: float = 0.0
    stiffness: Annotated[float | None, Unit("Pa/m")] = None

    def __post_init__(self) -> None:
        kinds.instance(self.shape, "load.shape", Shape, "a shape")
        if (self.path is None) == (self.mass is None):
            raise InputError(
                "an impactor has either a path or a mass",
                value="neither" if self.path is None else "both",
                key="load.path",
                remedy="path=[...] for its displacement, or mass= and velocity= for free motion",
            )
        if self.path is not None and self.velocity is not None:
            raise InputError(
                "the path of an impactor determines its velocity",
                value=list(self.velocity),
                key="load.velocity",
                remedy="leave it out",
            )
        if self.velocity is not None:
            kinds.set_fields(self, velocity=kinds.array(self.velocity, "load.velocity", shape=(None,)).tolist())
        if self.path is not None:
            along = kinds.sequence(self.path, "load.path", "one component an axis")
            kinds.set_fields(self, path=[as_signal(value, f"load.path[{i}]") for i, value in enumerate(along)])
        kinds.set_fields(
            self,
            mass=None if self.mass is None else kinds.number(self.mass, "load.mass", above=0),
            friction=kinds.number(self.friction, "load.friction", least=0),
            stiffness=None if self.stiffness is None else kinds.number(self.stiffness, "load.stiffness", above=0),
        )

    def bounded(self, lattice: Lattice) -> Impactor:
        """The impactor itself: it stays where it is on a larger lattice."""
        return self

    def displacement(self, t: float, key: str = "load") -> np.ndarray:
        """Prescribed displacement at a time, shape (dim,); raises InputError if it is not finite."""
        assert self.path is not None
        values = np.array([float(kinds.array(value(t), f"{key}.path", shape=(), finite=False)) for value in self.path])
        if not np.isfinite(values).all():
            raise InputError("the path is not finite", value=f"{values} at t = {t:g}", key=f"{key}.path")
        return values


class Terms(NamedTuple):
    """A shape as `engine.features.impactors.Impactors` describes it."""

    terms: list[tuple[int, int, int]]
    numbers: list[float]


def terms_of(shape: Shape, key: str) -> Terms:
    """Return a shape in postfix order; raises InputError for one whose depth is not known."""
    made = Terms([], [])
    _append(made, shape, key)
    return made


def _append(made: Terms, shape: Shape, key: str) -> None:
    first = len(made.numbers)
    if type(shape) in _PAIRS:
        for part in (shape.first, shape.second):  # type: ignore[attr-defined]
            _append(made, part, key)
        made.terms.append((_PAIRS[type(shape)], first, 0))
    elif isinstance(shape, Disc | Ball):
        made.numbers.extend([*shape.centre, shape.radius])
        made.terms.append((ROUND, first, shape.dim))
    elif isinstance(shape, Box):
        made.numbers.extend([*shape.lower, *shape.upper])
        made.terms.append((BOX, first, shape.dim))
    elif isinstance(shape, Polygon):
        made.numbers.extend(shape.points.ravel())
        made.terms.append((POLYGON, first, len(shape.points)))
    else:
        raise InputError(
            "how deep a point lies in such a shape is not known",
            value=type(shape).__name__,
            limit="Disc, Ball, Box, Polygon, and what |, & and - make of them",
            key=key,
            remedy="a polygon along its outline",
        )

"""Rigid shapes that push the nodes of a run: what the engine has to know of them, and what must hold before it."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np

from farhorizon.engine.features.impactors import Impactors
from farhorizon.engine.layout import with_defaults
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Shape
from farhorizon.inputs.impactors import Impactor, terms_of
from farhorizon.medium.integrators import Verlet
from farhorizon.simulation.setup.grid import Grid
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Sides

_MOST = 62  # impactors: the loop has a bit of a signed word for each
_INSIDE = 1e-6  # of a spacing: nodes that lie less deep touch the surface, to the rounding of coordinates
# part of the stiffness that the time step leaves at which the default ends, so that contacts are resolved in time
_SHARE = 0.5


class RigidShapes:
    """The impactors of a run, by their keys in messages. Raises InputError for those that it cannot have; `u` is the
    initial displacement.
    """

    def __init__(self, given: Mapping[str, Impactor], near: NearField, sides: Sides, grid: Grid, u: np.ndarray) -> None:
        self.given, self.near, self.sides, self.grid = dict(given), near, sides, grid
        self.notes: list[str] = []
        if not isinstance(near.model.integrator, Verlet) or len(given) > _MOST:
            name = near.model.integrator.name
            raise InputError(
                "impactors need a scheme of one stage, and are no more than bits of a word",
                value=f"{name}, {len(given)}",
                limit=f"verlet, {_MOST}",
                key="load",
                remedy='integrator = "verlet", or unions of shapes',
            )
        for key, impactor in given.items():
            _check(key, impactor, near.lattice)
            self._check_outside(key, impactor, u)
        constants = [self._constants(key, impactor) for key, impactor in given.items()]
        grid.engine.replace(impactors=self._table(np.array(constants)))

    def _table(self, constants: np.ndarray) -> Impactors:
        """Return the shapes as the engine reads them."""
        near, grid, engine, lattice = self.near, self.grid, self.grid.engine, self.near.lattice
        shapes = [terms_of(impactor.shape, f"{key}.shape") for key, impactor in self.given.items()]
        shifts = np.cumsum([0, *(len(shape.numbers) for shape in shapes)]).tolist()
        terms = [
            (what, first + shift, count)
            for shape, shift in zip(shapes, shifts[:-1], strict=True)
            for what, first, count in shape.terms
        ]
        margins = [0] * grid.lead + [grid.margins[a, -1] for a in range(lattice.dim)]
        first = np.array(grid.layout.low) + np.array(margins)
        nodes = np.array((1,) * grid.lead + lattice.shape)
        exists = np.zeros(grid.layout.size, np.int8)
        exists[grid.nodes.ravel()] = 1 if lattice.existing is None else lattice.existing.ravel()
        return with_defaults(
            Impactors,
            engine.dtype,
            terms=np.array(terms, np.int64),
            starts=np.cumsum([0, *(len(shape.terms) for shape in shapes)]).astype(np.int64),
            numbers=np.concatenate([np.array(shape.numbers, float) for shape in shapes]),
            bounds=np.array([_bounds(impactor.shape, lattice) for impactor in self.given.values()]),
            constants=constants,
            state=np.array([_start(impactor, near.dt, lattice.dim) for impactor in self.given.values()]),
            first=first.astype(np.int64),
            end=(first + nodes).astype(np.int64),
            lower=np.array(lattice.lower, float),
            scales=np.array([lattice.spacing, near.dt]),
            exists=exists,
            open_sides=np.array([_open_sides(impactor, lattice, self.sides) for impactor in self.given.values()]),
            beside=np.zeros(len(self.given), np.int64),
            spans=np.zeros((int(nodes[0] * nodes[1]), 2), np.int64),
            forces=np.zeros(engine.level().size),
            room=np.zeros((len(terms), 1 + lattice.dim)),
            vectors=np.zeros((5, lattice.dim)),
        )

    def _check_outside(self, key: str, impactor: Impactor, u: np.ndarray) -> None:
        """Refuse a shape that has nodes inside at the start."""
        lattice = self.near.lattice
        at = np.stack(lattice.coordinates(), axis=-1) + np.moveaxis(u, 0, -1)
        at = at.reshape(-1, lattice.dim) - _start(impactor, self.near.dt, lattice.dim)[0]
        if lattice.existing is not None:
            at = at[lattice.existing.ravel()]
        dim = impactor.shape.dim
        low, high = impactor.shape.bounds()
        at = at[((at[:, :dim] >= low) & (at[:, :dim] <= high)).all(1), :dim]
        for axis, sign in itertools.product(range(dim), (-1, 1)):
            at = at[impactor.shape.contains(at + sign * _INSIDE * lattice.spacing * np.eye(dim)[axis])]
        if len(at):
            raise InputError(
                "the impactor starts inside the body",
                value=f"{len(at)} nodes in it, one at {np.round(at[0], 9).tolist()}",
                limit="none",
                key=f"{key}.shape",
                remedy="move the shape out of the body: it pushes the nodes that it meets later",
            )

    def _constants(self, key: str, impactor: Impactor) -> tuple[float, float, float]:
        """Return a row of `Impactors.constants`; raises InputError for a stiffness too large for the time step, and a
        velocity with which nodes would pass into the shape by a spacing and more.
        """
        near, lattice = self.near, self.near.lattice
        lightness = 0.0 if impactor.mass is None else near.mass / impactor.mass
        # No more nodes can be in contact at once than are as large as the shape: the squared frequency of the contact
        # is no larger than `factor` times the acceleration per depth, and adds to that of the medium.
        densities = np.ones(1) if near.density is None else near.density
        heaviest = float(densities.max()) * lightness * _nodes_as_large(impactor.shape, lattice)
        factor = (1 + heaviest) / float(densities.min())
        room = near.rate_limit * ((near.step_limit / near.dt) ** 2 - 1) / factor
        per_stiffness = lattice.spacing ** (lattice.dim - 1) / near.mass
        material = near.model.coefficient / lattice.spacing**2
        if impactor.stiffness is None:
            rate = min(material, _SHARE * room)
            if rate < material:
                self.notes.append(
                    f"{key}: its stiffness is {rate / per_stiffness:.4g}, {rate / material:.3g} of that of the "
                    "material, which the time step demands, so that nodes come deeper into it; a shorter dt leaves more"
                )
        else:
            rate = impactor.stiffness * per_stiffness
            if rate > room:
                shorter = near.step_limit / np.sqrt(1 + rate * factor / near.rate_limit)
                raise InputError(
                    "the impactor is too stiff for the time step",
                    value=impactor.stiffness,
                    limit=f"{room / per_stiffness:.4g}",
                    key=f"{key}.stiffness",
                    remedy=f"leave it out, or dt below {shorter:.4g}",
                )
        speed, limit = float(np.linalg.norm(impactor.velocity or 0.0)), float(np.sqrt(rate)) * lattice.spacing
        if speed >= limit:
            raise InputError(
                "so fast an impactor would pass through nodes",
                value=speed,
                limit=f"below {limit:.4g}, at which a node comes one spacing deep",
                key=f"{key}.velocity",
                remedy="a lower velocity",
            )
        return rate, impactor.friction, lightness

    # --- in a run ----------------------------------------------------------------------------------------------

    @property
    def state(self) -> np.ndarray:
        """Displacements, and velocities half a step before, shape (n, 2, dim)."""
        return self.grid.engine.get("impactors.state")

    def mark(self) -> list[list[float]]:
        """What a checkpoint and the run that resumes from it must have in common."""
        constants, numbers, bounds = (
            self.grid.engine.get(f"impactors.{name}") for name in ("constants", "numbers", "bounds")
        )
        return [*constants.tolist(), numbers.tolist(), bounds.ravel().tolist()]

    def paths(self, step: int, count: int) -> np.ndarray:
        """Return the prescribed displacements after each of `count` steps from `step` on, shape (count, n, dim); zero
        for shapes that move freely.
        """
        dt, paths = self.near.dt, np.zeros((count, len(self.given), self.near.lattice.dim))
        for number, (key, impactor) in enumerate(self.given.items()):
            if impactor.path is not None:
                paths[:, number] = [impactor.displacement(dt * n, key) for n in range(step + 1, step + count + 1)]
        return paths

    def reaches(self, step: int, paths: np.ndarray) -> float:
        """Return how far shapes may have moved nodes by the end of the steps of `paths`, which follow `step`."""
        free = [np.linalg.norm(impactor.velocity or 0.0) for impactor in self.given.values()]
        return max(float(np.abs(paths).max(initial=0)), float(max(free)) * (step + len(paths)) * self.near.dt)

    def warning(self) -> str | None:
        """Return a warning if a shape has pushed nodes at the edge of the near field, beyond which there are others."""
        beside = self.grid.engine.get("impactors.beside")
        names = [key for key, is_beside in zip(self.given, beside, strict=True) if is_beside]
        if not names:
            return None
        return f"{', '.join(names)} pushes the outermost nodes of the near field, but not those beyond: enlarge it"

    def kinetic(self) -> float:
        """Return the kinetic energy of the shapes that move freely, half a step ago."""
        masses = [impactor.mass or 0.0 for impactor in self.given.values()]
        return float(0.5 * (masses * (self.state[:, 1] ** 2).sum(1)).sum())

    def loading_at(self, t: float) -> list[np.ndarray]:
        """Return the prescribed displacements at a time."""
        return [i.displacement(t, key) for key, i in self.given.items() if i.path is not None]


def _start(impactor: Impactor, dt: float, dim: int) -> np.ndarray:
    """Return the displacement at the start, and the velocity half a step before; shape (2, dim)."""
    if impactor.path is None:
        return np.array([np.zeros(dim), np.zeros(dim) if impactor.velocity is None else impactor.velocity])
    first = impactor.displacement(0.0)
    return np.array([first, (impactor.displacement(dt) - first) / dt])


def _bounds(shape: Shape, lattice: Lattice) -> np.ndarray:
    """Return the corners of a box around a shape, which has no end along the axes that it lacks; shape (2, dim)."""
    bounds = np.array([np.full(lattice.dim, -np.inf), np.full(lattice.dim, np.inf)])
    bounds[:, : shape.dim] = shape.bounds()
    return bounds


def _nodes_as_large(shape: Shape, lattice: Lattice) -> float:
    """Return the number of nodes that are as large as a shape, along axes that it lacks as many as the lattice has."""
    low, high = shape.bounds()
    counts = np.ceil((high - low) / lattice.spacing).astype(int) + 1
    # sampled coarsely where the shape is large: its volume is wanted to a few percent only
    counts = np.minimum(counts, 200 if shape.dim == 2 else 40)
    axes = [np.linspace(a, b, 2 * n + 1)[1::2] for a, b, n in zip(low, high, counts, strict=True)]
    share = float(shape.contains(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)).mean())
    return share * float(np.prod((high - low) / lattice.spacing)) * float(np.prod(lattice.shape[shape.dim :]))


def _check(key: str, impactor: Impactor, lattice: Lattice) -> None:
    """Refuse a shape or components of another dimension."""
    dim = lattice.dim
    if impactor.shape.dim not in (2, dim):
        raise InputError(
            "shape and lattice differ in dimension", value=impactor.shape.dim, limit=dim, key=f"{key}.shape"
        )
    for name in ("velocity", "path"):
        given = getattr(impactor, name)
        if given is not None and len(given) != dim:
            raise InputError(
                "an impactor needs one component per axis",
                value=len(given),
                limit=f"a list of {dim}",
                key=f"{key}.{name}",
            )


def _open_sides(impactor: Impactor, lattice: Lattice, sides: Sides) -> np.ndarray:
    """Return a row of `Impactors.open_sides`: sides with a medium beyond them, and periodic ones unless the shape is
    wider than the period, so that it is one with its images.
    """
    low, high = _bounds(impactor.shape, lattice)
    opened = np.zeros((3, 2), np.int64)
    for (axis, side), boundary in sides.items():
        wide = low[axis] < lattice.lower[axis] and high[axis] > lattice.upper[axis]
        opened[3 - lattice.dim + axis, int(side > 0)] = boundary.endless or (boundary.periodic and not wide)
    return opened

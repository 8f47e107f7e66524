"""Sources and conductivities that depend on the field, which are evaluated between the steps of a run.

The engine conducts as the medium does at the background. What a conductivity k(u) adds follows from the operator
applied to ``integral of (k(u) / k(background) - 1) du`` from the background to each node's value: a sum over the same
bonds, cut ones and free sides included, which acts as a source.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from farhorizon.errors import InputError, shown
from farhorizon.geometry.lattice import AXES, Lattice
from farhorizon.inputs.conditions import Flux
from farhorizon.medium.of_field import OfField
from farhorizon.simulation.processes.process_group import ALONE, ProcessGroup
from farhorizon.simulation.setup.grid import Grid
from farhorizon.simulation.setup.laws import SAMPLES, law_of, range_of
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Setup, Sides, keys, side_name

# points of Gauss's formula for the integral of a conductivity: exact for polynomials of degree 31
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(16)


def field_source_terms(
    setup: Setup, near: NearField, sides: Sides, grid: Grid, team: ProcessGroup = ALONE
) -> list[tuple[str, Any]]:
    """Return what drives a run that depends on its field, by name, to be evaluated at each step; raises InputError for
    a field or an integrator that does not support it, values that are not finite, a conductivity that is not positive,
    and quantities that are not constant beside sides that absorb.
    """
    _check(setup, near)
    source_terms: list[tuple[str, Any]] = []
    values = range_of(setup, team.gather)
    for key, quantity in zip(keys("source", setup.sources), setup.sources, strict=True):
        if isinstance(quantity, OfField):
            source_terms.append((key, _Source(quantity, key, near, sides, grid, values, team)))
    for name, quantity in setup.model.follows.items():
        source_terms.append((name, Conduction(quantity, f"model.{name}", near, sides, grid, team)))
    return [(name, (None, source_term)) for name, source_term in source_terms]


def _check(setup: Setup, near: NearField) -> None:
    """Refuse fields and integrators for which nothing may depend on the field."""
    model, key = setup.model, "source" if not setup.model.follows else f"model.{next(iter(setup.model.follows))}"
    if near.stencil.components > 1 or model.bond_law is not None or model.dissolution is not None:
        raise InputError(
            "quantities that depend on the field are available for scalar fields",
            value=model.title,
            key=key,
            limit="Diffusion, Heat, Wave",
            remedy="a function of space and time",
        )
    if len(model.integrator.stages(near.dt).numbers) > 1:
        raise InputError(
            "what depends on the field needs an integrator of one stage per step",
            value=model.integrator.name,
            key="model.integrator",
            limit="forward Euler, velocity Verlet",
            remedy='integrator="euler"',
        )
    fluxes = [
        condition.kind for condition in setup.constraints if isinstance(condition, Flux) and condition.kind != "source"
    ]
    if model.follows and fluxes:
        raise InputError(
            "beside a conductivity that depends on the field, a flux is a source in the outermost cells",
            value=", ".join(fluxes),
            key="constraints",
            limit='"source"',
            remedy='Flux(..., kind="source")',
        )


class _OfField:
    """A source term that depends on the field."""

    def __init__(self, quantity: OfField, key: str, near: NearField, sides: Sides, grid: Grid) -> None:
        self._key, self._near, self._grid = key, near, grid
        self._strips = {
            side_name(*at): (_strip(near, *at), side.wanted(near.model.target))
            for at, side in sides.items()
            if side.endless
        }
        self._law = law_of(quantity, self._names(near.lattice), key)

    def _names(self, lattice: Lattice) -> tuple[str, ...]:
        """Return the names of the arguments of the law."""
        return "u", *AXES[: lattice.dim]

    @property
    def _field(self) -> np.ndarray:
        """Values at the nodes now."""
        values = self._grid.get("u")
        return np.asarray(values.astype(float) + self._near.background)

    def _at(self, wrong: np.ndarray, values: np.ndarray, u: np.ndarray, t: float) -> str:
        """Say what is wrong at the first such node: its value, the field, the place and the time."""
        first = np.unravel_index(int(np.argmax(wrong)), wrong.shape)
        lattice = self._near.lattice
        place = lattice.lower + lattice.spacing * np.array(first)
        return f"{values[first]:.6g} where u = {u[first]:.6g}, at {shown(place)}, t = {t:.6g}"


def _strip(near: NearField, axis: int, side: int) -> tuple[Any, ...]:
    """Return the nodes within one reach of a side."""
    wide = near.stencil.reach[axis] + 1
    last = slice(0, wide) if side < 0 else slice(-wide, None)
    return tuple(last if a == axis else slice(None) for a in range(near.lattice.dim))


class _Source(_OfField):
    """A source that depends on the field; called with a time, it returns its present values. On several processes each
    has those of its nodes, and all fail if one does. `values` are those that the field has at the start.
    """

    def __init__(
        self,
        quantity: OfField,
        key: str,
        near: NearField,
        sides: Sides,
        grid: Grid,
        values: np.ndarray,
        team: ProcessGroup,
    ) -> None:
        super().__init__(quantity, key, near, sides, grid)
        self._team = team
        with team.agreed():
            some = [np.full(near.lattice.shape, value) for value in values[:: SAMPLES // 8]]
            sizes = np.array([np.abs(self._values(u, 0.0)) for u in some])
        largest = team.largest(float(sizes.max(initial=0)))
        with team.agreed():
            self._check_strips(sizes, largest)

    def _check_strips(self, sizes: np.ndarray, largest: float) -> None:
        """Refuse sources, shape (values of the field, ...), beside sides that absorb, unless they are small there."""
        near, key = self._near, self._key
        for name, (strip, target) in self._strips.items():
            beside = float(sizes[:, *strip].max(initial=0))
            if beside > target * largest:
                raise InputError(
                    f"a source that depends on the field does not vanish beside {name}, which continues without it",
                    value=f"{beside:.3g}",
                    limit=f"0 within {near.stencil.reach[AXES.index(name[0])]} nodes of it",
                    key=key,
                    remedy="where(condition, ..., 0) restricts it to the inside, or Free, Fixed or Periodic sides",
                )

    def _values(self, u: np.ndarray, t: float) -> np.ndarray:
        lattice = self._near.lattice
        values = np.broadcast_to(self._law(u, *lattice.coordinates()), u.shape)
        values = self._near.inside(values)
        wrong = ~np.isfinite(values)
        if wrong.any():
            raise InputError(
                "a source that depends on the field is not finite",
                value=self._at(wrong, values, u, t),
                limit="no nan, no inf",
                key=self._key,
                remedy="where(condition, a, b) restricts it to where it is defined",
            )
        return values

    def __call__(self, t: float) -> np.ndarray:
        with self._team.agreed():
            return self._values(self._field, t)


class Conduction(_OfField):
    """What flows because the conductivity differs from that at the background; called with a time, it returns the
    present power per volume.
    """

    level: np.ndarray  # to which the operator was last applied

    def __init__(
        self, quantity: OfField, key: str, near: NearField, sides: Sides, grid: Grid, team: ProcessGroup
    ) -> None:
        super().__init__(quantity, key, near, sides, grid)
        self._team = team
        self._first = float(self._law(np.array(near.background)))

    def _names(self, lattice: Lattice) -> tuple[str, ...]:
        return ("u",)

    def _excess(self, changed: np.ndarray) -> np.ndarray:
        """Integral of the conductivity over that at the background, less 1, to given changes of the field."""
        total = np.zeros(changed.shape)
        for point, weight in zip((1 + _POINTS) / 2, _WEIGHTS / 2, strict=True):
            total += weight * self._law(self._near.background + point * changed)
        return changed * (total / self._first - 1)

    def __call__(self, t: float) -> np.ndarray:
        near, engine = self._near, self._grid.engine
        u = self._field
        largest = self._team.largest(float(np.abs(u - near.background).max(initial=0)))
        with self._team.agreed():
            self._check(u, t, largest)
        changed = engine.get("u").astype(float)
        changing = changed != 0
        changed[changing] = self._excess(changed[changing])
        self.level = changed.astype(engine.dtype)
        engine.complete(self.level)
        # the reaction acts on the field itself
        flow = engine.apply_core(self.level, again=True) + engine.reaction * self.level
        return self._grid.view(flow).reshape(near.lattice.shape).astype(float) / near.model.source_factor

    def _check(self, u: np.ndarray, t: float, largest: float) -> None:
        """Refuse a conductivity that is not positive, for which the step is too long, or that is not constant beside a
        side that absorbs.
        """
        near, name = self._near, self._key.removeprefix("model.")
        exists = np.ones(u.shape, bool) if near.hidden is None else ~near.hidden
        conductivity = np.broadcast_to(self._law(u), u.shape)
        wrong = exists & ~((conductivity > 0) & np.isfinite(conductivity))
        if wrong.any():
            raise InputError(
                f"the {name} has become negative",
                value=self._at(wrong, conductivity, u, t),
                limit="> 0",
                key=self._key,
                remedy="a law that stays positive, such as max(..., smallest)",
            )
        most = near.model.strongest * self._first * (near.step_limit / near.dt)
        wrong = exists & (conductivity > most)
        if wrong.any():
            raise InputError(
                f"the {name} has risen so far that the time step is unstable",
                value=self._at(wrong, conductivity, u, t),
                limit=f"{most:.6g} for dt = {near.dt:.6g}",
                key=self._key,
                remedy="a shorter dt",
            )
        for side, (strip, target) in self._strips.items():
            missed = np.zeros(u.shape)
            missed[strip] = np.abs(self._excess(u[strip] - near.background))
            wrong = exists & (missed > target * largest)
            if wrong.any():
                raise InputError(
                    f"the {name} is not constant beside {side}, which continues it as at the background",
                    value=self._at(wrong, conductivity, u, t),
                    limit=f"{self._first:.6g}, up to a difference that counts {target:g} of the largest value",
                    key=self._key,
                    remedy="a larger near field, or a law that is constant near the background",
                )

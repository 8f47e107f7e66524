"""Derivatives by the medium: from sums over bonds, and over the inertia of nodes, to the constants of the model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from farhorizon.inverse.correlation import RULES, correlate_bonds, correlate_inertia
from farhorizon.inverse.history import Rows
from farhorizon.inverse.patch import Patch
from farhorizon.medium.variation import Variation
from farhorizon.simulation.assembly import Parts
from farhorizon.simulation.host import constants_of
from farhorizon.simulation.setup import Setup

_STEP = 1e-20  # of the complex-step derivative, relative to a value: no difference is taken, so nothing cancels


class Medium:
    """Sums of a gradient by the medium, as the adjoint run goes on.

    Parameters
    ----------
    setup : Setup
        With all choices made.
    parts : Parts
        Those of the run.
    patch : Patch
    region : ndarray of bool
        Nodes at which the medium is unknown.
    constants : sequence of str
        What the derivatives are taken by.
    """

    def __init__(self, setup: Setup, parts: Parts, patch: Patch, region: np.ndarray, constants: Sequence[str]) -> None:
        near = parts.near
        self.patch, self.region, self.constants, self.near = patch, region, constants, near
        self.values = constants_at_nodes(setup)
        self._slopes = {name: slope_by(near.model, self.values, name) for name in constants}
        stencil, lead = near.stencil, 3 - near.lattice.dim
        ahead = np.array([tuple(offset) > (0,) * near.lattice.dim for offset in stencil.offsets])
        self._offsets = np.zeros((int(ahead.sum()), 3), np.int64)
        self._offsets[:, lead:] = stencil.offsets[ahead]
        scale = near.model.coefficient / near.lattice.spacing**2
        self._arms = arms_of(scale * stencil.weights[ahead])
        self._factor = np.ones(patch.places) if near.factor is None else patch.over(near.factor)
        self._exists = patch.exists(setup, parts.around.sides)
        self._begins = self._exists * ~patch.copies
        self._lost = patch.lost(setup, stencil.offsets[ahead])
        self._rule = RULES[rule_of(setup)]
        self._of_bonds, self._of_inertia = np.zeros(patch.places), np.zeros(patch.places)
        dt, damped = near.dt, near.model.damping * near.dt
        self._inertia = (
            (1 / dt, -1 / dt, 0.0)
            if near.model.order == 1
            else ((1 + damped) / dt**2, -2 / dt**2, (1 - damped) / dt**2)
        )
        self._heavy = any(slope.density is not None and slope.density.any() for slope in self._slopes.values())
        self._stiff = any(slope.stiffness is not None and slope.stiffness.any() for slope in self._slopes.values())

    def correlate(self, rows: Rows, n: int, w: np.ndarray) -> None:
        """Add the part of some steps of the adjoint run.

        Parameters
        ----------
        rows : Rows
            The run.
        n : int
            Its step that belongs to the first row of `w`; the next rows belong to the steps before.
        w : ndarray, shape (steps, components, places)
        """
        row = n - rows.first
        if self._stiff:
            correlate_bonds(
                rows.values,
                row,
                w,
                self.patch.shape3,
                self._offsets,
                self._arms,
                self._rule,
                self._factor,
                self._begins,
                self._exists,
                self._lost,
                self._of_bonds,
            )
        if self._heavy:
            correlate_inertia(rows.values, row, w, *self._inertia, self.patch.own.astype(float), self._of_inertia)

    def derivatives(self) -> dict[str, np.ndarray]:
        """Return the derivatives by the constants, of the lattice's shape, zero outside the region."""
        near = self.near
        of_bonds, of_inertia = (
            self.patch.onto(values) / near.model.source_factor for values in (self._of_bonds, self._of_inertia)
        )
        found = {}
        for name, slope in self._slopes.items():
            total = np.zeros(near.lattice.shape)
            if slope.stiffness is not None:
                total += of_bonds * slope.stiffness * (1.0 if near.coefficient is None else near.coefficient)
            if slope.density is not None:
                total += of_inertia * slope.density
            found[name] = np.where(self.region, total, 0.0)
        return found


def constants_at_nodes(setup: Setup) -> dict[str, np.ndarray]:
    """Return all constants that affect the waves of a model at the nodes of its lattice."""
    model, shape = setup.model, setup.lattice.shape
    found = {name: np.full(shape, value) for name, value in model.wave_constants.items() if isinstance(value, float)}
    return {**found, **constants_of(setup)}


def rule_of(setup: Setup) -> str:
    """Return the rule by which the ends of a bond are combined where the medium varies."""
    return setup.rule or "harmonic"


def slope_by(model: object, values: dict[str, np.ndarray], name: str) -> Variation:
    """Return the derivative of the variation relative to a uniform model by one of the constants at each node.

    It is taken by a complex step: the imaginary part of a rational function at a place a tiny distance off the real
    axis is its derivative, to rounding.
    """
    step = _STEP * np.abs(values[name]).max()
    moved = {**values, name: values[name] + 1j * step}
    found = model.beside(moved)  # type: ignore[attr-defined]

    def slope(given: np.ndarray | None) -> np.ndarray | None:
        return None if given is None else np.imag(given) / step

    return Variation(slope(found.stiffness), slope(found.density), slope(found.moduli), slope(found.springs))


def arms_of(weights: np.ndarray) -> np.ndarray:
    """Return the weights of bonds as sums of a number times an outer square, shape (K, R, 1 + components)."""
    if weights.ndim == 1:
        return np.concatenate([weights[:, None, None], np.ones((len(weights), 1, 1))], axis=2)
    sizes, vectors = np.linalg.eigh(weights)
    rounding = 1e-13 * np.abs(sizes).max()
    ranks = max(1, int((np.abs(sizes) > rounding).sum(1).max()))
    order = np.argsort(-np.abs(sizes), axis=1)[:, :ranks]
    chosen = np.take_along_axis(sizes, order, 1)
    arms = np.take_along_axis(vectors.swapaxes(1, 2), order[:, :, None], 1)
    return np.concatenate([chosen[:, :, None], arms], axis=2)

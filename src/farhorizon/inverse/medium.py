"""Derivatives by the medium: from sums over bonds, and over the inertia of nodes, to the constants of the model."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from farhorizon.inverse.correlation import RULES, correlate_bonds, correlate_inertia, correlate_states
from farhorizon.inverse.history import Rows
from farhorizon.inverse.patch import Patch
from farhorizon.medium.force_states import ForceStates
from farhorizon.medium.variation import Variation
from farhorizon.simulation.assembly import RunParts
from farhorizon.simulation.setup.reference_medium import constants_of
from farhorizon.simulation.setup.setup import Setup

_STEP = 1e-20  # of the complex-step derivative, relative to a value: no difference is taken, so nothing cancels


class Medium:
    """Sums of a gradient by constants of the medium in a region, as the adjoint run goes on."""

    def __init__(
        self, setup: Setup, parts: RunParts, patch: Patch, region: np.ndarray, constants: Sequence[str]
    ) -> None:
        near = parts.near
        self.patch, self.region, self.near = patch, region, near
        values = constants_at_nodes(setup)
        self._slopes = {name: slope_by(near.model, values, name) for name in constants}
        states = near.states
        offsets, weights = (
            (near.stencil.offsets, near.stencil.weights) if states is None else (states.offsets, states.bonds)
        )
        lead = 3 - near.lattice.dim
        ahead = np.array([tuple(offset) > (0,) * near.lattice.dim for offset in offsets])
        self._offsets = np.zeros((int(ahead.sum()), 3), np.int64)
        self._offsets[:, lead:] = offsets[ahead]
        scale = near.model.coefficient / near.lattice.spacing**2
        self._arms = arms_of(scale * weights[ahead])
        of_bonds = near.model.beside(values).times(near.coefficient).of_bonds
        self._factor = np.ones(patch.places) if of_bonds is None else patch.over(of_bonds)
        self._exists = patch.exists(setup, parts.layered.sides)
        self._begins = self._exists * ~patch.copies
        self._lost = patch.lost(setup, offsets[ahead])
        self._rule = RULES[rule_of(setup) if states is None else "arithmetic"]
        self._states = None if states is None else States.on(patch, setup, states, scale, self._exists)
        self._of_bonds, self._of_inertia = np.zeros(patch.places), np.zeros(patch.places)
        dt, damped = near.dt, near.model.damping * near.dt
        self._inertia = (
            (1 / dt, -1 / dt, 0.0)
            if near.model.order == 1
            else ((1 + damped) / dt**2, -2 / dt**2, (1 - damped) / dt**2)
        )
        self._heavy = self._some("density")
        self._stiff = self._some("springs" if states is not None else "stiffness") and bool(self._arms[:, :, 0].any())
        self._strained = self._some("moduli")

    def _some(self, name: str) -> bool:
        slopes = [getattr(slope, name) for slope in self._slopes.values()]
        return any(slope is not None and bool(slope.any()) for slope in slopes)

    def correlate(self, rows: Rows, n: int, w: np.ndarray) -> None:
        """Add the part of some steps w (steps, components, places) of the adjoint run; step n of the run belongs to the
        first of them, earlier ones to the next.
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
        if self._states is not None and self._strained:
            self._states.correlate(rows.values, row, w)
        if self._heavy:
            correlate_inertia(rows.values, row, w, *self._inertia, self.patch.own.astype(float), self._of_inertia)

    def derivatives(self) -> dict[str, np.ndarray]:
        """Return the derivatives by the constants, of the lattice's shape, zero outside the region."""
        near, patch, unit = self.near, self.patch, 1 / self.near.model.source_factor
        of_bonds, of_inertia = (unit * patch.onto(values) for values in (self._of_bonds, self._of_inertia))
        of_bonds *= 1.0 if near.coefficient is None else near.coefficient
        derivatives = {}
        for name, slope in self._slopes.items():
            total = np.zeros(near.lattice.shape)
            if slope.of_bonds is not None:
                total += of_bonds * slope.of_bonds
            if slope.moduli is not None and self._states is not None:
                total += unit * (patch.onto(self._states.total) * slope.moduli).sum(0)
            if slope.density is not None:
                total += of_inertia * slope.density
            derivatives[name] = np.where(self.region, total, 0.0)
        return derivatives


@dataclass(frozen=True, eq=False)
class States:
    """Sums `total` (3, places) of a gradient by the moduli of a material whose forces follow from states of the nodes;
    the other fields as in `correlate_states`.
    """

    shape3: np.ndarray
    offsets: np.ndarray
    gradient: np.ndarray
    present: np.ndarray
    laws: np.ndarray
    law_of: np.ndarray
    total: np.ndarray

    @classmethod
    def on(cls, patch: Patch, setup: Setup, states: ForceStates, scale: float, exists: np.ndarray) -> States:
        """Return the states of the nodes of a patch, for an operator in units of `scale`."""
        dim, ratio = patch.lattice.dim, float(np.vdot(states.divergence, states.gradient.transpose(0, 2, 1)))
        ratio *= scale / float((states.gradient**2).sum())  # D is this multiple of the transposed G
        offsets = np.zeros((len(states.offsets), 3), np.int64)
        offsets[:, 3 - dim :] = states.offsets
        present = _present(patch, setup, states.offsets, exists)
        uncut = _present(patch, replace(setup, cracks=()), states.offsets, exists) if states.kept else present
        shapes = np.tensordot(uncut, states.shapes, ((0,), (0,))).round(14)  # equal but for rounding
        odd = ~present.all(0)
        kinds, numbers = np.unique(shapes[odd].reshape(-1, dim * dim), axis=0, return_inverse=True)
        every = np.concatenate([np.eye(dim)[None], kinds.reshape(-1, dim, dim)])
        laws = np.stack([states.law(every, np.tile(unit, (len(every), 1))) for unit in np.eye(3)], axis=1)
        law_of = np.zeros(patch.places, np.int64)
        law_of[odd] = 1 + numbers.ravel()
        law_of[(exists == 0) | patch.copies] = -1
        nothing = np.zeros((0, 0))
        total = np.zeros((3, patch.places))
        return cls(
            patch.shape3, offsets, states.gradient, present if odd.any() else nothing, ratio * laws, law_of, total
        )

    def correlate(self, u: np.ndarray, row: int, w: np.ndarray) -> None:
        """Add the part of some steps; see `correlate_states`."""
        given = self.shape3, self.offsets, self.gradient, self.present, self.laws, self.law_of
        correlate_states(u, row, w, *given, self.total)


def _present(patch: Patch, setup: Setup, offsets: np.ndarray, exists: np.ndarray) -> np.ndarray:
    """Return 1 for each bond of the places of a patch that is there, 0 for others, shape (K, places)."""
    body = exists.reshape(patch.shape)
    reach = np.abs(offsets).max(0)
    # what lies beyond the patch is read by no node that counts
    wide = np.pad(body, [(m, m) for m in reach], constant_values=1.0)
    present = np.empty((len(offsets), patch.places))
    for row, offset in zip(present, offsets, strict=True):
        other = wide[tuple(slice(m + o, m + o + n) for m, o, n in zip(reach, offset, patch.shape, strict=True))]
        row[:] = (body * other).ravel()
    lost = patch.lost(setup, offsets)
    return present * (lost == 0) if lost.size else present


def constants_at_nodes(setup: Setup) -> dict[str, np.ndarray]:
    """Return all constants that affect the waves of a model at the nodes of its lattice."""
    model, shape = setup.model, setup.lattice.shape
    constants = {
        name: np.full(shape, value) for name, value in model.wave_constants.items() if isinstance(value, float)
    }
    constants |= {name: values for name, values in constants_of(setup).items() if name in model.wave_constants}
    existing = setup.lattice.existing
    if existing is None:
        return constants
    return {name: np.where(existing, values, values[existing].mean()) for name, values in constants.items()}


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
    with warnings.catch_warnings():  # checks of ranges look at the real parts
        warnings.simplefilter("ignore", np.exceptions.ComplexWarning)
        contrast = model.beside(moved)  # type: ignore[attr-defined]

    def slope(given: np.ndarray | None) -> np.ndarray | None:
        return None if given is None else np.imag(given) / step

    return Variation(
        slope(contrast.stiffness), slope(contrast.density), slope(contrast.moduli), slope(contrast.springs)
    )


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

"""The near field of a set-up: its medium, its conditions and its time step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy import fft

from farhorizon import kinds
from farhorizon.errors import InputError
from farhorizon.geometry.decomposition import decompose
from farhorizon.geometry.lattice import Lattice
from farhorizon.inputs.conditions import Conditions, losses, resolve
from farhorizon.inputs.load_steps import LoadSteps
from farhorizon.inputs.prescribed import Prescribed, PrescribedNodes
from farhorizon.inputs.sources import field, largest_component
from farhorizon.medium.attenuation import Attenuation
from farhorizon.medium.force_states import ForceStates
from farhorizon.medium.stencil import Stencil
from farhorizon.medium.variation import Variation
from farhorizon.models import LatticeModel
from farhorizon.simulation.heat.coupling import Coupling, expansion_of
from farhorizon.simulation.processes.process_group import ALONE, ProcessGroup
from farhorizon.simulation.setup.compatibility import closed_window
from farhorizon.simulation.setup.laws import source_slope
from farhorizon.simulation.setup.reference_medium import Contrast, ReferenceMedium, contrast_in, node_factor, varied
from farhorizon.simulation.setup.setup import Setup, Sides, wrapping
from farhorizon.simulation.setup.supports import Supports, supports_of

_ALIKE = 1e-12  # relative difference up to which constants are those of the same medium, and a step that at the limit
_TINY = 1e-300  # in place of zero, where nothing moves
# (rate of the data x step)^2 for an error of a thousandth by a method of second order such as Chebyshev's
_FOLLOWED = 0.02


class Extremes(NamedTuple):
    """Quantities that depend on all nodes of a near field."""

    rate_limit: float
    contrast: Contrast


@dataclass(frozen=True, eq=False)
class NearField:
    """The near field, without what lies beyond its sides; on several processes, the part of one of them."""

    lattice: Lattice
    model: LatticeModel
    background: float
    stencil: Stencil  # that of the medium where its coefficient is that of the model
    closed: np.ndarray | None  # of bool; nodes of a window that a condition along its outline closes
    variation: Variation  # of the medium relative to the model
    coefficient: np.ndarray | None  # given factor on bonds, in addition to the variation of the model's own constants
    conditions: Conditions
    rate_limit: float  # largest rate of the operator (1/time, for waves 1/time^2)
    dt: float
    prescribed: PrescribedNodes  # nodes that follow a prescribed value, permanently or for a limited time
    contrast: Contrast  # that of the whole near field, also on a part of it
    coupling: Coupling | None = None  # with a temperature that the deformation changes
    supports: Supports | None = None  # springs and dashpots at sides

    @cached_property
    def continued(self) -> Stencil:
        """Stencil for which layers are made: that of the medium; where Poisson's ratio varies, that with the largest
        ratio at their sides, whose backward waves are the longest and grow fastest.
        """
        return (
            self.stencil
            if self.contrast.lame is None
            else self.model.of_ratio(self.contrast.lame).medium(self.lattice.spacing, self.lattice.dim)
        )

    @property
    def extremes(self) -> Extremes:
        """Quantities that a part of the near field cannot determine on its own."""
        return Extremes(self.rate_limit, self.contrast)

    @property
    def mass(self) -> float:
        """Mass of a node of the model; where the density varies, without that factor."""
        return float(self.lattice.spacing**self.lattice.dim / self.model.source_factor)

    @property
    def medium_rate(self) -> float:
        """Largest rate of the medium with all its bonds, without reaction, from the symbol of the stencil."""
        return _medium_rate(self.model, self.lattice.spacing, self.stencil, self.contrast)

    @cached_property
    def growth(self) -> float:
        """Rate (1/time) at which the medium itself lets a uniform field grow: that of a negative reaction."""
        drawn = -float(self.stencil.reaction) if self.stencil.components == 1 else 0.0
        rate = max(drawn, 0.0) * self.model.coefficient / self.lattice.spacing**2
        return rate if self.model.order == 1 else float(np.sqrt(rate))

    @property
    def closing_rate(self) -> float:
        """Contribution to the largest rate of absent bonds that can close, in a material with states."""
        return self.model.coefficient / self.lattice.spacing**2 * self.contrast.closing

    @property
    def step_limit(self) -> float:
        """Largest stable time step."""
        if self.coupling is not None:
            return self.coupling.step_limit(self.model, self.rate_limit)
        return self.model.step_limit(self.rate_limit)

    @property
    def highest_frequency(self) -> float:
        """Highest frequency f of lattice waves, in cycles per unit of time: ``sin(pi f dt) = dt sqrt(rate) / 2``."""
        return float(np.arcsin(min(1.0, self.dt * np.sqrt(self.rate_limit) / 2)) / (np.pi * self.dt))

    @property
    def states(self) -> ForceStates | None:
        """The states of nodes from which forces follow; None if forces are those of bonds alone."""
        return self.model.force_states(self.lattice.spacing, self.lattice.dim)

    @property
    def field_shape(self) -> tuple[int, ...]:
        """Shape of the field: that of the lattice, for vectors with the components first."""
        shape, components = self.lattice.shape, self.stencil.components
        return shape if components == 1 else (components, *shape)

    @property
    def factor(self) -> np.ndarray | None:
        """Stiffness at each node over that of the model, which is the factor on bonds; None where it is uniform."""
        return self.variation.stiffness

    @property
    def density(self) -> np.ndarray | None:
        """Mass of each node over that of a node of the model; None where it is uniform."""
        return self.variation.density

    @cached_property
    def squared_speed(self) -> np.ndarray | None:
        """Squared speed of waves, or diffusivity, at each node over that of the model; None where it is uniform."""
        return self.variation.squared_speed

    @property
    def strongest(self) -> float:
        """Largest squared speed over that of the model; if no density varies, the largest factor on bonds."""
        return self.contrast.strongest

    @property
    def weakest(self) -> float:
        """Smallest squared speed over that of the model where there are bonds."""
        return self.contrast.weakest

    @property
    def varies(self) -> bool:
        """Whether the medium varies."""
        if self.density is not None or self.variation.moduli is not None or self.model.by_region:
            return True
        return self.factor is not None and bool(np.ptp(self.factor) > 0)

    @property
    def lame(self) -> np.ndarray:
        """Lame constants at each node; for a scalar field, 0 and the factor of the gradient in the flux."""
        return _lame(self.lattice, self.model, self.variation)

    @property
    def fastest_rate(self) -> float:
        """``coefficient / spacing^2`` where the medium is fastest: the factor of the stencil `fastest`."""
        return self.model.coefficient / self.lattice.spacing**2 * max(self.strongest, _TINY)

    @property
    def fastest(self) -> Stencil:
        """The stencil of the medium where it is fastest."""
        return self.stencil.beside(self.strongest or 1.0)

    @cached_property
    def leak(self) -> np.ndarray:
        """Rate at which each node loses its value to the surroundings of the body, of the lattice's shape; empty if no
        node does.
        """
        return _leak(self.model, self.conditions.leaks, self.density)

    @cached_property
    def hidden(self) -> np.ndarray | None:
        """Nodes of the lattice whose values do not belong to the body or window; None if there are none."""
        hidden = np.zeros(self.lattice.shape, bool) if self.lattice.mask is None else ~self.lattice.mask
        if self.conditions.nodes.size:
            hidden.ravel()[self.conditions.images] = True
        return hidden if hidden.any() else None

    @property
    def crossing(self) -> float:
        """Unit of time of the set-up: that in which the fastest wave crosses the near field, or in which it empties by
        diffusion, ``R^2/D``.
        """
        return self.model.crossing(max(self.lattice.whole.shape) * self.lattice.spacing, max(self.strongest, _TINY))

    @property
    def slow_crossing(self) -> float:
        """As `crossing`, for the slowest wave or the smallest diffusivity."""
        length = max(self.lattice.whole.shape) * self.lattice.spacing
        return self.model.speed_ratio * self.model.crossing(length, max(self.weakest, _TINY))

    @property
    def material(self) -> np.ndarray:
        """Stiffness of each node over that of the model; nan outside a body, and where the density or Poisson's ratio
        differs.
        """
        lattice = self.lattice
        stiffness = np.ones(lattice.shape) if self.factor is None else self.factor.copy()
        if self.density is not None:
            stiffness[self.density != 1] = np.nan
        if self.variation.lame is not None:
            uniform = np.multiply.outer(self.model.moduli or (0.0, 0.0), stiffness)
            alike = np.abs(self.variation.lame - uniform) <= _ALIKE * np.abs(self.variation.lame).max()
            stiffness[~alike.all(0)] = np.nan
        if lattice.existing is not None:
            stiffness[~lattice.existing] = np.nan
        return stiffness

    @property
    def constants(self) -> np.ndarray:
        """Factor on the bonds of each node, its density over that of the model, and, if they vary, the moduli of its
        state, shape (2 or 5, ...); nan outside a body.
        """
        variation, lattice = self.variation, self.lattice
        given = [np.ones(lattice.shape) if c is None else c for c in (variation.of_bonds, variation.density)]
        constants = np.stack(given if variation.moduli is None else [*given, *variation.moduli])
        return constants if lattice.existing is None else np.where(lattice.existing, constants, np.nan)

    @property
    def busy(self) -> np.ndarray:
        """Nodes whose values are prescribed or held by a condition, as a mask of the lattice's shape."""
        busy = np.zeros(self.lattice.shape, bool)
        busy.ravel()[np.concatenate([self.conditions.nodes, *self.prescribed.nodes]).astype(int)] = True
        return busy

    @property
    def conditioned(self) -> np.ndarray:
        """The nodes that are `busy`, and those at which heat is lost, as a mask of the lattice's shape."""
        return self.busy | (self.leak > 0) if self.leak.size else self.busy

    def inside(self, values: np.ndarray) -> np.ndarray:
        """Return the values, zero outside a body, and beyond the outline of a window if a condition closes it."""
        for mask in (self.closed, self.lattice.existing):
            values = values if mask is None else np.where(mask, values, 0.0)
        return values

    def visible(self, values: np.ndarray) -> np.ndarray:
        """Return the values, nan on hidden nodes."""
        return values if self.hidden is None else np.where(self.hidden, np.nan, values)

    def size(self, values: np.ndarray) -> np.ndarray:
        """Return the largest magnitude of any component; a scalar is returned unchanged."""
        return values if self.stencil.components == 1 else np.abs(values).max(0)

    def function(self, value: Any) -> Callable[..., Any]:
        """Return a value as a function of the coordinates; for vectors, its largest component."""
        if self.stencil.components > 1:
            return largest_component(value)
        return value if callable(value) else lambda *_: value


def near_field(
    setup: Setup,
    sides: Sides,
    stencil: Stencil,
    variation: Variation,
    coefficient: np.ndarray | None = None,
    stiffer: float = 1.0,
    team: ProcessGroup = ALONE,
    extremes: Extremes | None = None,
) -> NearField:
    """Return the near field of a set-up. `stiffer` is the largest squared frequency over that of the medium with all
    its bonds; `extremes` is what depends on all parts, if this is one of several. Raises InputError for conditions that
    cannot hold, and a time step above the stable limit.
    """
    lattice, model = setup.lattice, setup.model
    conditions = _resolve(setup, stencil, variation.stiffness, team) if setup.constraints else Conditions()
    supports = supports_of(sides, lattice, model, stencil.components, variation.density)
    if extremes is None:
        contrast = _contrast(setup, sides, stencil, variation)
        leak = supports.rate if supports is not None else 0.0
        if conditions.leaks:
            leak = float(_leak(model, conditions.leaks, variation.density).max(initial=0))
        extremes = Extremes(_rate_limit(setup, stencil, contrast, leak, stiffer), contrast)
    rate = extremes.rate_limit
    if model.attenuation is not None:
        _check_band(model.attenuation, float(np.sqrt(rate)) / (2 * np.pi))
    coupling = None if setup.heat is None else _coupling(setup, stencil, variation)
    if coupling is None:
        chosen = model.integrator.outruns and (setup.dt is None or callable(setup.dt))
        most = _step_that_follows(setup, sides, stencil, rate) if chosen else np.inf
        dt = _choose_step(setup, sides, model.step_limit(rate), most)
    else:
        dt = _choose_step(setup, sides, coupling.step_limit(model, rate), coupling.dt)
    prescribed = tuple(c for c in setup.constraints if isinstance(c, Prescribed))
    return NearField(
        lattice,
        model,
        setup.background,
        stencil,
        None if lattice.window is None else closed_window(setup, sides),
        variation,
        coefficient,
        conditions,
        rate,
        dt,
        PrescribedNodes(prescribed, lattice, stencil.components, model.integrator, dt, setup.background),
        extremes.contrast,
        coupling,
        supports,
    )


def _check_band(attenuation: Attenuation, highest: float) -> None:
    """Refuse a band that extends beyond the highest frequency of the lattice."""
    if attenuation.band[1] > highest:
        raise InputError(
            "the lattice has no waves of such a frequency",
            value=list(attenuation.band),
            limit=f"<= {highest:.4g}",
            key="model.attenuation.band",
            remedy="a smaller spacing, or the band of the waves that there are",
        )


def _contrast(setup: Setup, sides: Sides, stencil: Stencil, variation: Variation) -> Contrast:
    """Return the contrast of a medium on one process."""
    if variation.stiffness is None and variation.density is None and setup.model.bond_law is None:
        strongest = setup.model.strongest
        return Contrast(strongest, 1.0, strongest, dict.fromkeys(sides, 1.0), 0.0)
    boxes = decompose(setup.lattice.shape, 1, stencil.reach, {}, wrapping(sides))
    return contrast_in(setup, boxes, stencil, variation)


def extremes_of(
    setup: Setup, reference_medium: ReferenceMedium, stencil: Stencil, team: ProcessGroup, stiffer: float
) -> Extremes:
    """Return the quantities that depend on all of a near field, of which each process evaluates a box; `stencil` is
    that of the uniform medium, and `stiffer` is as in `near_field`.
    """
    boxes = decompose(setup.lattice.shape, team.size, stencil.reach, {}, wrapping(setup.sides))
    part = reference_medium.uniform(replace(setup, lattice=setup.lattice.part(boxes.ranges(team.number))))
    variation = reference_medium.variation_of(replace(setup, lattice=part.lattice)).times(node_factor(part))
    contrast = contrast_in(part, boxes, stencil, variation, team)
    conductivity = _conductivity(reference_medium.model, variation.stiffness)
    lost = losses(setup.constraints, part.lattice, team.gather, stencil, conductivity)
    leak = _leak(reference_medium.model, lost, variation.density)
    supports = supports_of(part.sides, part.lattice, reference_medium.model, stencil.components, variation.density)
    most = team.largest(float(leak.max(initial=0)) + (0.0 if supports is None else supports.rate))
    return Extremes(_rate_limit(part, stencil, contrast, most, stiffer, team), contrast)


def _medium_rate(model: LatticeModel, spacing: float, stencil: Stencil, contrast: Contrast) -> float:
    unit = model.coefficient / spacing**2
    return stencil.with_reaction(0.0).symbol_maximum * (unit * max(contrast.fastest, _TINY))


def _rate_limit(
    setup: Setup, stencil: Stencil, contrast: Contrast, leak: float, stiffer: float, team: ProcessGroup = ALONE
) -> float:
    """Return the largest rate of an operator, with closing bonds, reaction and leak."""
    unit = setup.model.coefficient / setup.lattice.spacing**2
    rate = _medium_rate(setup.model, setup.lattice.spacing, stencil, contrast) * stiffer
    rate += unit * contrast.closing
    if setup.depends_on_field:
        rate += setup.model.source_factor * source_slope(setup, team.gather)
    return rate + stencil.strongest_reaction * setup.model.coefficient / setup.lattice.spacing**2 + leak


def _leak(model: LatticeModel, losses: Sequence[tuple[int, np.ndarray]], density: np.ndarray | None) -> np.ndarray:
    leaks = [leak for _, leak in losses]
    if not leaks:
        return np.zeros(0)
    return model.source_factor * sum(leaks[1:], leaks[0]) / (1.0 if density is None else density)


def _conductivity(model: LatticeModel, factor: np.ndarray | None) -> np.ndarray | float:
    return model.coefficient / model.source_factor * (1.0 if factor is None else factor)


def _resolve(setup: Setup, stencil: Stencil, factor: np.ndarray | None, team: ProcessGroup) -> Conditions:
    conductivity = _conductivity(setup.model, factor)
    return resolve(
        setup.constraints, setup.lattice, stencil.reach, conductivity, setup.background, team.gather, stencil
    )


def _lame(lattice: Lattice, model: LatticeModel, variation: Variation) -> np.ndarray:
    if variation.lame is not None:
        return variation.lame
    factor = np.ones(lattice.shape) if variation.stiffness is None else variation.stiffness
    return np.multiply.outer(model.moduli or (0.0, 0.0), factor)


def _coupling(setup: Setup, stencil: Stencil, variation: Variation) -> Coupling | None:
    """Return the coupling with a temperature that the deformation changes; None if there is none."""
    load, law, lattice = setup.heat, setup.model.bond_law, setup.lattice
    if load is None or not load.coupled or law is None or load.reference is None:
        return None
    alone = heat_alone(load.temperature)
    lame = _lame(lattice, setup.model, variation)
    expansion = expansion_of(load, lattice, setup.model, lame)
    if setup.model.bonds:
        lengths = (lattice.spacing * stencil.offsets) ** 2 @ np.ones(lattice.dim)
        strained = 0.5 * float(law.bond_stiffness(stencil, lattice.spacing) @ lengths)
        strained *= setup.model.strongest if variation.stiffness is None else float(variation.stiffness.max())
    else:
        strained = lattice.dim * float((lattice.dim * np.maximum(*lame) + 2 * lame[1]).max())
    capacity = (1.0 if alone.density is None else alone.density) / alone.model.source_factor
    stiffening = load.reference * float((expansion**2 / capacity).max()) * strained
    return Coupling(stiffening, strained, alone.rate_limit, alone.dt, alone.model.integrator)


def heat_alone(setup: Setup) -> NearField:
    """Return the near field of a temperature on its own, with its own time step."""
    heat, of_heat = varied(setup)
    medium = heat.model.medium(heat.lattice.spacing, heat.lattice.dim)
    return near_field(replace(heat, dt=None), heat.sides, medium, of_heat.times(node_factor(heat)))


def _step_that_follows(setup: Setup, sides: Sides, stencil: Stencil, rate: float) -> float:
    """Return the step with which a method of second order, which is stable with much longer steps, follows the initial
    data to a thousandth of the largest value; at least that of Euler's method, which is also returned if anything else
    drives the field.
    """
    shortest, initial = 1 / rate, (setup.initial or {}).get("u")
    held = any(b.held is not None and b.held != setup.background for b in sides.values())
    if initial is None or held or setup.sources or setup.constraints or setup.specimens:
        return shortest
    values = fft.fftn(field(initial, setup.lattice.whole, 1, "initial.u") - setup.background)
    angles = np.ix_(*[2 * np.pi * fft.fftfreq(n) for n in values.shape])
    rates = stencil.symbol(*angles) * (rate / stencil.symbol_maximum)
    largest, bent = (float(np.abs(fft.ifftn(rates**power * values)).max()) for power in (0, 2))
    return max(shortest, float(np.sqrt(_FOLLOWED * largest / bent))) if bent > 0 else shortest


def _choose_step(setup: Setup, sides: Sides, limit: float, most: float = np.inf) -> float:
    """Return the given time step, by default half the limit of the scheme and of the sides, and at most `most`."""
    dt, model, lattice = setup.dt, setup.model, setup.lattice
    if isinstance(dt, LoadSteps):
        return dt.interval
    if dt is None or callable(dt):
        borne = [b.step_limit(model.order, model.coefficient, lattice.spacing, lattice.dim) for b in sides.values()]
        default = min(0.5 * min(limit, *borne), most)
        if dt is None:
            return default
        dt = kinds.function(dt, "run.dt", "the default step")(default)
    dt = kinds.number(dt, "run.dt", above=0)
    if dt > limit * (1 + _ALIKE):
        raise InputError(
            "the time step is above the stable limit",
            value=dt,
            limit=f"{limit:.6g}",
            key="run.dt",
            remedy=f"dt <= {0.9 * limit:.4g}, or leave dt out",  # a round number below it
        )
    return dt

"""The near field on the engine: which nodes of the core belong to it, and which are margins around it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from farhorizon.engine.codegen.matrices import Signs
from farhorizon.engine.engine import Engine, Layer
from farhorizon.engine.exchange import Link
from farhorizon.engine.features.density import set_density
from farhorizon.engine.features.filter import set_images
from farhorizon.engine.features.relaxations import set_relaxations
from farhorizon.engine.layout import Block, Layout
from farhorizon.engine.settings import connect
from farhorizon.engine.two_pass import StateSums
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Cut
from farhorizon.medium.force_states import ForceStates
from farhorizon.medium.integrators import ModifiedEquation
from farhorizon.medium.stencil import Stencil
from farhorizon.simulation.processes.process_group import ALONE, ProcessGroup
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Key, Setup, Sides, wanted_threads
from farhorizon.simulation.sides.layered_sides import LayeredSides

_FAINT = 1e-11  # share of the data that may touch a layer without a target, whose error may be as small as rounding


@dataclass(frozen=True, eq=False)
class Grid:
    """An engine and the place of the near field in it."""

    lattice: Lattice
    margins: dict[Key, int]  # number of nodes of the core beyond the near field
    engine: Engine
    walled: frozenset[Key]  # fixed sides beyond which there are such nodes

    @property
    def layout(self) -> Layout:
        """Where the nodes of the core and the layers are in a level."""
        return self.engine.layout

    @property
    def core(self) -> Block:
        """The core in a level."""
        return self.engine.core

    @property
    def walls(self) -> np.ndarray:
        """Places of the core's margins beyond fixed sides, and of layers along them."""
        nodes = self.layout.box.node_indices()
        beyond = np.zeros(nodes.shape, bool)
        for axis, side in self.walled:
            margin = self.margins[axis, side]
            last = slice(None, margin) if side < 0 else slice(-margin, None)
            beyond[tuple(last if a == self.lead + axis else slice(None) for a in range(3))] = True
        return nodes[beyond]

    def clear_walls(self, values: np.ndarray) -> None:
        """Set values at places of a level to zero at the `walls`, and where the halo repeats them."""
        layout = self.layout
        values_with_halo = layout.box.all(values)
        for axis, side in self.walled:
            margin = self.margins[axis, side] + layout.reach[self.lead + axis]
            last = slice(None, margin) if side < 0 else slice(-margin, None)
            values_with_halo[tuple(last if a == self.lead + axis else slice(None) for a in range(3))] = 0

    @property
    def lead(self) -> int:
        """Number of the engine's three axes that precede those of the lattice."""
        return 3 - self.lattice.dim

    @cached_property
    def near(self) -> tuple[slice, ...]:
        """Slices of the near field in the core, along the engine's three axes."""
        slices = [slice(self.margins[a, -1], self.margins[a, -1] + n) for a, n in enumerate(self.lattice.shape)]
        return (*[slice(None)] * self.lead, *slices)

    @property
    def first(self) -> list[int]:
        """Indices of the core's first node along the engine's axes; the first node of the whole lattice has index 0."""
        return [0] * self.lead + [n - self.margins[a, -1] for a, n in enumerate(self.lattice.first)]

    @cached_property
    def origin(self) -> np.ndarray:
        """Coordinates of the core's first node."""
        below = np.array([self.margins[a, -1] for a in range(self.lattice.dim)])
        return self.lattice.lower - self.lattice.spacing * below

    def get(self, name: str) -> np.ndarray:
        """Return values by name (`Engine.get`) at the nodes of the near field, components first; a view, to be read."""
        values = self.view(self.engine.get(name))
        return values.reshape(*values.shape[:-3], *self.lattice.shape)

    def put(self, name: str, values: np.ndarray) -> None:
        """Set values by name at the nodes of the near field."""
        self.engine.put(name, values.ravel(), (..., self.indices))

    def view(self, level: np.ndarray) -> np.ndarray:
        """Return a view of the near field of a level, components first."""
        where: tuple[Any, ...] = (..., *self.near)
        return self.core.view(level)[where]

    @property
    def nodes(self) -> np.ndarray:
        """Places of the near field's nodes in a level of one component."""
        return self.core.node_indices()[self.near]

    @property
    def indices(self) -> np.ndarray:
        """Places of the near field's nodes in a level, for all components."""
        return self.engine.all_components(self.nodes)

    def grown(self, values: np.ndarray, mode: Literal["edge", "constant"] = "edge") -> np.ndarray:
        """Extend values on the near field to the core, by default with those at its edge; of the core's shape."""
        return _over_core(values, self.margins, mode)

    def keyed(self, of_sides: dict[Key, float]) -> dict[Key, float]:
        """Return values by side with the engine's numbering of the axes."""
        return {(self.lead + axis, side): value for (axis, side), value in of_sides.items()}


def _over_core(values: np.ndarray, margins: dict[Key, int], mode: Literal["edge", "constant"] = "edge") -> np.ndarray:
    """Extend values on the near field to the core, with its three axes."""
    grown = np.pad(values, [(margins[a, -1], margins[a, 1]) for a in range(values.ndim)], mode=mode)
    return grown.reshape((1,) * (3 - values.ndim) + grown.shape)


def states_of(setup: Setup, sides: Sides, varies: bool, team: ProcessGroup = ALONE) -> ForceStates | None:
    """Return the states of the nodes if the operator is applied in two passes: where bonds may be absent or moduli
    vary, and in 3D, where the combined stencil takes longer (`benchmarks/elastic.py passes`); otherwise None. All
    processes do it alike, also those whose own sides and constants would not require it.
    """
    lattice = setup.lattice
    cut = varies or bool(len(setup.cracks)) or setup.model.bond_law is not None
    cut |= lattice.body is not None and setup.rim == "free"
    cut |= setup.model.drag > 0 or any(b.derivatives for b in sides.values())
    cut |= not all(b.bonded for b in sides.values())
    if lattice.dim < 3 and not team.any(cut):
        return None
    return setup.model.force_states(lattice.spacing, lattice.dim)


def choose_margins(
    near: NearField,
    layered: LayeredSides,
    data: Sequence[np.ndarray],
    medium: Sequence[np.ndarray],
    cuts: Sequence[Cut],
    states: ForceStates | None,
    team: ProcessGroup = ALONE,
) -> dict[Key, int]:
    """Choose the number of nodes of the core beyond the near field: a sponge, unstretched nodes in front of a layer, or
    nodes of the medium beyond a fixed side that have states.

    The entrance of a layer must be free of sources, data, cracks and changes of the material. One node keeps sources
    out; for initial data and for `medium`, all that must not change along the normal, one reach more is needed. An
    exact end must be free of cracks and changes of the material. Processes at the same side have equally many nodes
    there.
    """
    lattice, margins = near.lattice, {}
    peaks = [team.largest(float(np.abs(f).max())) for f in map(near.size, data)]
    for (axis, side), boundary in layered.sides.items():
        margins[axis, side] = layered.width((axis, side), near.stencil, lattice.spacing)
        if states is not None and boundary.held is not None:
            margins[axis, side] = int(np.abs(states.offsets[:, axis]).max())
        if boundary.stretched or boundary.exact:
            m = near.stencil.reach[axis]
            last = np.arange(m + 1) if side < 0 else lattice.shape[axis] - 1 - np.arange(m + 1)
            least = int(boundary.stretched)
            asked = boundary.open_ended or boundary.target is not None
            # a thousandth of what may be missed, so that it does not count
            faint = 1e-3 * boundary.wanted(near.model.target) if asked else _FAINT
            busy = bool(least) and any(
                np.abs(np.take(f, last, axis)).max() > faint * peak
                for f, peak in zip(map(near.size, data), peaks, strict=True)
            )
            busy |= any(np.diff(np.take(values, last, axis), axis=axis).any() for values in medium)
            edge = (lattice.lower if side < 0 else lattice.upper)[axis]
            close = [side * (edge - cut.bounds()[(side + 1) // 2][axis]) < (m + 1) * lattice.spacing for cut in cuts]
            margins[axis, side] = 1 + m if busy or any(close) else least
    outer = {key: margins[key] for key, side in layered.sides.items() if side.stretched or side.exact}
    margins_of_all = team.gather(outer)
    return margins | {key: max(margins_there.get(key, 0) for margins_there in margins_of_all) for key in outer}


def make_grid(
    setup: Setup,
    near: NearField,
    layered: LayeredSides,
    margins: dict[Key, int],
    states: ForceStates | None,
    exchange: tuple[Link, Mapping[Key, int]] | None = None,
    warm: bool = False,
) -> Grid:
    """Make the engine of a near field and its sides; `exchange` connects it to the processes that fill its
    halo. If `warm`, layers have thermal strains, too. Raises InputError for a fixed side beside a layer.
    """
    lattice, model, stencil, sides = near.lattice, near.model, near.stencil, layered.sides
    lead = 3 - lattice.dim
    x, y, z = (1,) * lead + tuple(n + margins[a, -1] + margins[a, 1] for a, n in enumerate(lattice.shape))
    scale = model.coefficient / lattice.spacing**2
    bonds = (stencil.offsets, stencil.weights) if states is None else (states.offsets, states.bonds)
    offsets = np.zeros((len(bonds[0]), 3), int)
    offsets[:, lead:] = bonds[0]
    layers = {(lead + axis, side): layer for (axis, side), layer in layered.layers.items()}
    periodic = frozenset(lead + a for (a, side), b in sides.items() if side < 0 and b.periodic)
    if isinstance(model.integrator, ModifiedEquation) and layers:
        _check_modified_equation(near, list(layers.values()))
    attenuation = model.attenuation
    # otherwise the base of a stage is read after the forces
    light = near.density is None and not model.drag and attenuation is None
    alone = lattice.dim == 1 and light
    stages = model.integrator.stages(near.dt, model.damping, alone, setup.lasting or not light)
    grown = None
    if near.variation.of_bonds is not None:
        grown = _over_core(near.variation.of_bonds, margins)
    moduli = None
    if near.variation.moduli is not None:
        moduli = np.stack([_over_core(modulus, margins) for modulus in near.variation.moduli])
    engine = Engine(
        (x, y, z),
        offsets,
        bonds[1] * scale,
        stages,
        near.dt,
        layers=layers,
        periodic=periodic,
        real=setup.dtype,
        threads=wanted_threads(setup.threads),
        coefficient=grown,
        rule=setup.bond_rule if near.variation.moduli is None else "arithmetic",  # each end contributes its own forces
        reaction=stencil.reaction * scale,
        signs=None if stencil.components in (1, lattice.dim) else _signs(stencil),
        sums=None if states is None else _sums(states, scale, lead, moduli, _stretch(near, layered, margins)),
        heat=np.einsum("kab,kb->ka", bonds[1] * scale, lattice.spacing * bonds[0]) if warm else None,
        dragged=model.drag > 0,
        mechanisms=0 if attenuation is None else attenuation.memories,
        dashpots=setup.balance,
    )
    if attenuation is not None:
        strongest = attenuation.strongest.unrelaxed
        spectra = [(*one.relaxation, one.unrelaxed / strongest) for one in attenuation.spectra]
        set_relaxations(engine, spectra, _over_core(attenuation.numbers(lattice), margins))
    if exchange is not None:
        link, neighbours = exchange
        connect(engine, link, {(lead + axis, side): number for (axis, side), number in neighbours.items()})
    images = {(lead + axis, side): b.image for (axis, side), b in sides.items() if b.image}
    set_images(engine, images)
    walled = frozenset(key for key, b in sides.items() if b.held is not None and margins[key])
    grid = Grid(lattice, margins, engine, walled)
    if near.density is not None:
        set_density(engine, _over_core(near.density, margins))
    for (axis, side), boundary in sides.items():
        if boundary.held is not None and boundary.held != near.background:
            _hold_beyond(grid, near, layered, (axis, side), boundary.held)
    return grid


def _check_modified_equation(near: NearField, layers: list[Layer]) -> None:
    """Refuse layers with dampers, which are tuned to velocity Verlet, and steps with which some waves run backward, and
    grow in layers: those with ``dt^2 S > 6`` for the eigenvalue S, whose frequency falls as S rises.
    """
    most, scheme = near.step_limit / np.sqrt(2), near.model.integrator.name
    if near.dt > most:
        raise InputError(
            f"with the {scheme} short waves run backward at such a step, and grow in layers",
            value=near.dt,
            limit=f"{most:.6g}, 0.707 of the stable limit",
            key="run.dt",
            remedy="a smaller step, or leave it out",
        )
    if any(layer.tuned.size for layer in layers):
        raise InputError(
            "the dampers of this layer are tuned to velocity Verlet",
            value=scheme,
            key="model.integrator",
            remedy='integrator = "verlet", or another profile',
        )


def _signs(stencil: Stencil) -> Signs:
    """Return whether each component changes sign under reflection across each of the three axes."""
    return tuple((0,) * (3 - stencil.dim) + tuple(int(sign < 0) for sign in row) for row in stencil.signs)


def _sums(
    states: ForceStates, scale: float, lead: int, moduli: np.ndarray | None, stretch: tuple[np.ndarray, ...]
) -> StateSums:
    """Return the passes of the engine for an operator in units of `scale`, with moduli over the core if they vary."""
    moduli = np.array(states.moduli) if moduli is None else moduli
    signs = tuple((sign[0] if lead == 0 else 0, sign[-2], sign[-1]) for sign in states.signs)
    sums = states.gradient, scale * states.divergence, states.shapes, states.law, moduli, signs
    released = None if states.released is None else scale * states.released
    return StateSums(*sums, states.kept, released, states.unweakened, *stretch)


def _stretch(near: NearField, layered: LayeredSides, margins: dict[Key, int]) -> tuple[np.ndarray, ...]:
    """Return the rates at which derivatives along each axis are stretched, over the core, and their shift; empty if no
    side stretches derivatives.
    """
    lattice, lead = near.lattice, 3 - near.lattice.dim
    if not any(b.derivatives for b in layered.sides.values()):
        return ()
    core = (1,) * lead + tuple(n + margins[a, -1] + margins[a, 1] for a, n in enumerate(lattice.shape))
    phi, shift = np.zeros((lattice.dim, *core)), np.zeros(core)
    for (axis, side), boundary in layered.sides.items():
        if boundary.derivatives:
            speed = float(np.sqrt(layered.coefficients[axis, side]))
            normal, across, alpha = boundary.stretches(lattice.spacing, speed)
            last = slice(None, len(normal)) if side < 0 else slice(-len(normal), None)
            part = tuple(last if a == lead + axis else slice(None) for a in range(3))
            for along in range(lattice.dim):
                outwards = normal if along == axis else across
                phi[along][part] += outwards[::side].reshape([-1 if a == lead + axis else 1 for a in range(3)])
            shift[part] = np.maximum(shift[part], alpha)
    return phi, shift


def _hold_beyond(grid: Grid, near: NearField, layered: LayeredSides, key: Key, value: float) -> None:
    """Set the halo beyond a fixed side, in every level, to its value."""
    axis, side = grid.lead + key[0], key[1]
    if any(b.stretched for (a, _), b in layered.sides.items() if a != key[0]):
        raise InputError(
            "a Fixed value beside a LatticePML must equal the background: the layer would have to absorb a state "
            "that never decays",
            value=value,
            limit=near.background,
            key="boundary",
            remedy="set background (of a Thermoelastic its reference), or use Periodic or Free",
        )
    engine, block = grid.engine, grid.core
    m = block.reach[axis]
    strip = tuple((slice(0, m) if side < 0 else slice(-m, None)) if a == axis else slice(None) for a in range(3))
    places = block.all(np.arange(block.origin + grid.layout.size))[strip]
    engine.put("levels", value - near.background, (slice(engine.stages.levels - engine.stages.increments), places))

"""Copies of a set-up on which its stability and reflection are examined: without sources, small, or one pair of sides
by itself.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from farhorizon.analysis.exact.chain import Recursion
from farhorizon.analysis.layers.chain_modes import LatticeMedium, types_of
from farhorizon.analysis.layers.reflection import by_type, reflection
from farhorizon.analysis.stability import Allowance, Growth, dense_growth, eigenvalue_seconds, fastest, step_seconds
from farhorizon.boundaries import Fixed, LatticePML, Periodic, Side
from farhorizon.checks.examined import Examined
from farhorizon.engine.engine import Layer
from farhorizon.engine.features.filter import line_damping
from farhorizon.engine.state import State
from farhorizon.geometry.lattice import AXES, Lattice
from farhorizon.geometry.shapes import Ball, Disc
from farhorizon.machine import one_blas_thread

_SPREADS = 8  # diffusion has spread over much of the box after R^2/D divided by this
NARROW = 8  # nodes of the near field between two layers that are examined, or more where the stencil reaches farther


def pinned(sim: Examined) -> dict[tuple[int, int], Side]:
    """The sides with the layers of this set-up given explicitly and with full-precision memory; fixed sides hold 0."""
    lead = 3 - sim.lattice.dim
    sides = dict(sim.sides)
    for (axis, side), layer in sim.engine.layers.items():
        sides[axis - lead, side] = LatticePML(nodes=layer.columns, profile=replace(layer, short=False))
    return {key: boundary if boundary.held is None else Fixed(0.0) for key, boundary in sides.items()}


def like_sides(sim: Examined, first: tuple[int, int], second: tuple[int, int]) -> bool:
    """Whether two sides, each (axis, side), are alike: layers of the same stretch and damping, or equal conditions."""
    lead = 3 - sim.lattice.dim
    layer, twin = (sim.engine.layers.get((lead + axis, side)) for axis, side in (first, second))
    if layer is None or twin is None:
        return layer is twin and sim.sides[first] == sim.sides[second]
    return all(np.array_equal(getattr(layer, f.name), getattr(twin, f.name)) for f in fields(layer))


def one_corner(sim: Examined) -> dict[tuple[int, int], Side]:
    """The sides; where all of them are layers or periodic, the lower one of two alike layers on an axis is held fixed.

    All corners, edges and faces are then like those that are left. Where there are reflecting faces both layers are
    kept, because a layer and its mirror image can feed the same mode between such faces.
    """
    sides = pinned(sim)
    if all(b.stretched or b.periodic for b in sides.values()):
        for axis in range(sim.lattice.dim):
            layered = sides[axis, -1].stretched and sim.stencil.even_along(axis)
            if layered and like_sides(sim, (axis, -1), (axis, 1)):
                sides[axis, -1] = Fixed(0.0)
    return sides


def plain_twin(
    sim: Examined, lattice: Lattice | None = None, sides: Mapping[tuple[int, int], Side] | None = None
) -> Examined:
    """The same set-up in double precision without sources, loads and specimens, or a smaller copy of it without cracks,
    conditions and changes of the material.
    """
    # conditions that run into layers hold the background value, so the background is kept
    level = Fixed(sim.background)
    named = {AXES[a] + "-+"[s > 0]: level if b.held is not None else b for (a, s), b in (sides or pinned(sim)).items()}
    changes: dict[str, Any] = {
        "boundary": named,
        "sources": (),
        "loads": (),
        "specimens": (),
        "dtype": "float64",
        "balance": False,
    }
    if lattice is not None:
        changes["lattice"] = lattice
    twin = sim.remade(**changes)
    if sim.exact_ends is not None and twin.exact_ends is not None:
        twin.exact_ends.cover(sim.exact_ends.steps)
    return twin


def small_lattice(sim: Examined) -> Lattice:
    """Smallest box that corners and faces need; with a condition along an outline, a box or a round window twice as
    wide as the depth the condition reads.
    """
    lattice, spacing = sim.lattice, sim.lattice.spacing
    depth = 0.0 if sim.closure is None else sim.closure.fringe.depth
    if lattice.window is not None and sim.closure is not None:
        if isinstance(lattice.window, Disc | Ball):
            window = type(lattice.window)(min(lattice.window.radius, 2 * depth + 2 * spacing), lattice.window.centre)
            return Lattice(spacing, window=window)
        return lattice
    count = np.maximum(np.maximum(5, 2 * np.array(sim.stencil.reach) + 1), int(np.ceil(2 * depth / spacing)) + 1)
    return Lattice(spacing, lattice.lower, lattice.lower + spacing * (np.minimum(lattice.shape, count) - 1))


def crossing_rounds(sim: Examined) -> int:
    """Rounds of steps (`State.every`) in which a wave crosses the core and its layers, or diffusion spreads over much
    of them.
    """
    nodes = max(
        n + sum(layer.columns for (a, _), layer in sim.engine.layers.items() if a == axis)
        for axis, n in enumerate(sim.engine.core.nodes)
    )
    factor = max(sim.strongest, 1e-300) / sim.model.strongest  # of a coefficient; bonds between phases are not a medium
    duration = sim.model.crossing(nodes * sim.lattice.spacing, factor)
    period = sim.engine.every * sim.dt
    return max(1, int(np.ceil(duration / (1 if sim.model.order == 2 else _SPREADS) / period)))


class Strip:
    """The sides of one axis and `width` nodes between them, unbounded along the other axes: a matrix for each
    tangential wavenumber.

    Its low and high `sides` are those of `sim` unless given. All matrices are assembled from responses of the engine;
    where these would take more than the allowance, a TimeoutError is raised.
    """

    def __init__(
        self,
        sim: Examined,
        axis: int,
        width: int,
        sides: tuple[Side, Side] | None = None,
        allowance: Allowance | None = None,
    ) -> None:
        dim, spacing = sim.lattice.dim, sim.lattice.spacing
        along = [a for a in range(dim) if a != axis]
        stages = len(sim.engine.stages.numbers)
        shape = [width] + [2 * stages * sim.stencil.reach[a] + 1 for a in along]
        lattice = Lattice(spacing, (0.0,) * dim, spacing * (np.array(shape) - 1))
        ends = sides or (pinned(sim)[axis, -1], pinned(sim)[axis, 1])
        boundary: dict[str, Side] = {"x-": ends[0], "x+": ends[1]} | {AXES[a]: Periodic() for a in range(1, dim)}
        self._filters = {}
        self._every = sim.engine.every
        if dim > 1:  # the layers' filters reach farther than the rows needed for the responses below
            profiles = {side: b.profile for side, b in zip((-1, 1), ends, strict=True)}
            self._filters = {side: layer for side, layer in profiles.items() if isinstance(layer, Layer)}
            ends = ends[0].undamped(), ends[1].undamped()
            boundary |= {"x-": ends[0], "x+": ends[1]}
        self.sim = sim.remade(
            lattice=lattice,
            model=sim.model.with_stencil(sim.stencil.along(axis)),
            boundary=boundary,
            dtype="float64",
            threads=1,
            background=0.0,
        )
        self.width, self.dt = width, sim.dt
        self._crossings_per_step = sim.dt / sim.crossing
        self.state = State(self.sim.engine)
        rows = self.state.rows()
        self.place, self._images, self._signs, self._layers = rows.place, rows.images, rows.signs, rows.layers
        self.near = rows.near  # entries of a row's state in the near field, shape (levels * components, nodes)
        self.size = len(self.place)  # numbers in the state of one row along the normal
        # with the components along the sides a quarter of a period apart, the map of a mirror-symmetric stencil is
        # real, which is a few times as fast
        self._turns = np.where(self._signs > 0, 1j, 1.0) if self.sim.stencil.components > 1 else np.ones(self.size)
        self.coarse = 11 if dim == 2 else 6  # tangential wavenumbers along each axis in `sample`
        endless = all(b.periodic or not b.bonded for (a, _), b in sim.sides.items() if a != axis)
        self.longest = 0.0 if endless else 0.01  # the smallest of these; 0 where waves may be uniform along the sides
        # first index: the entry set to 1, so that each write is contiguous
        products = self.sim.engine.size * sim.stencil.weights.size
        if allowance is not None and not allowance.take(self.size * step_seconds(products)):
            raise TimeoutError
        responses = np.empty((self.size, *self.place.shape))
        for number in range(self.size):
            unit = np.zeros(self.state.size)
            unit[self.place[number, 0]] = 1
            responses[number] = self.state.after(unit)[self.place]
        linked = responses.any(axis=-1)  # a step links few entries
        self._links, self._responses = np.nonzero(linked), responses[linked].reshape(-1, *shape[1:])
        images = self._images
        if images is not None:  # whether the map is symmetric is seen at any wavenumbers, up to rounding
            matrix = self._summed(*np.linspace(0.7, 1.9, dim - 1))
            mirrored = np.outer(self._signs, self._signs) * matrix[np.ix_(images, images)]
            if np.abs(mirrored - matrix).max() > 1e-14 * np.abs(matrix).max():
                self._images = None
        # of the eigenvalues at one tangential wavenumber on a typical core; even and odd modes apart are two matrices
        # of half the size, complex ones take four times as long
        halves = 1 if self._images is None else 4
        self.seconds = (4 if self.sim.stencil.components > 1 else 1) * eigenvalue_seconds(self.size) / halves

    def matrix(self, *angles: float) -> np.ndarray:
        """The map of one step, filters included, for waves of given tangential wavenumbers times spacing."""
        return self._filtered(self._summed(*angles), np.array(angles))

    def _summed(self, *angles: float) -> np.ndarray:
        """The responses of all rows, summed with the phases of a wave along the sides."""
        total: np.ndarray = self._responses
        for angle in angles[::-1]:
            row = np.arange(total.shape[-1])
            phase = angle * np.where(row > len(row) // 2, row - len(row), row)
            total = total @ np.cos(phase) - 1j * (total @ np.sin(phase))
        matrix = np.zeros((self.size, self.size), complex)
        matrix[self._links[::-1]] = total
        return matrix

    def _filtered(self, matrix: np.ndarray, angles: np.ndarray, every: int = 1) -> np.ndarray:
        """The map of `every` steps followed by the filters of the layers, for levels u(n), u(n - 1)."""
        matrix = matrix.copy()
        for side, layer in self._filters.items():
            if layer.filtered:
                damping = line_damping(layer.damping, layer.taps, every * self.dt, angles)
                for new, old in zip(*self._layers[side], strict=True):  # component by component
                    if layer.whole:
                        for level in (new, old):
                            matrix[level] = matrix[level] - damping @ matrix[level]
                    else:
                        matrix[new] -= damping @ (matrix[new] - matrix[old])
        return matrix

    def growth(self, *angles: float) -> Growth:
        """The fastest-growing mode at given tangential wavenumbers; between alike sides, even and odd modes are
        computed separately.
        """
        turns, period = self._turns, self._every * self._crossings_per_step
        matrix = np.linalg.matrix_power(self._summed(*angles) * turns / turns[:, None], self._every)
        matrix = self._filtered(matrix, np.array(angles), self._every)
        if self._images is None:
            growth = dense_growth(matrix, period)
            return replace(growth, mode=turns * growth.mode)
        number, signs = np.arange(self.size), self._signs
        first = np.flatnonzero(number < self._images)
        growths = []
        for sign in (1, -1):
            alone = np.flatnonzero((number == self._images) & (signs == sign))
            halves = np.concatenate([first, alone])
            images = self._images[halves]
            part = matrix[np.ix_(halves, halves)]
            part[:, : len(first)] += sign * signs[first] * matrix[np.ix_(halves, images[: len(first)])]
            growth = dense_growth(part, period)
            mode = np.zeros(self.size, complex)
            mode[images], mode[halves] = sign * signs[halves] * growth.mode, growth.mode
            growths.append(replace(growth, mode=turns * mode))
        return fastest(growths)

    def sample(self) -> Iterator[tuple[float, ...]]:
        """Tangential wavenumbers times spacing: a grid up to pi, and very long waves; only one of those that are mirror
        images of each other.
        """
        line = [self.longest, *np.linspace(0, np.pi, self.coarse + 1)[1:].tolist()]
        if self.sim.lattice.dim < 3:
            yield from ((a,) for a in (*line, 0.005, 0.05)) if self.sim.lattice.dim == 2 else ((),)
            return
        even = self.sim.stencil.even_along(1)
        alike = even and self.sim.stencil.same_along(1, 2)
        for a, b in itertools.product(line, repeat=2):
            if a <= b or not alike:
                yield a, b
            if not even:
                yield a, -b

    @property
    def medium(self) -> LatticeMedium:
        """The medium in front of the sides; requires an integrator with one stage."""
        model = self.sim.model
        recursion = Recursion.of(model.integrator, self.dt, model.damping)
        return LatticeMedium(self.sim.stencil, model.coefficient, self.sim.lattice.spacing, recursion, self.dt)

    @property
    def types(self) -> tuple[str, ...]:
        """Types of waves, as given by `types_of`: a single one without a name for a scalar field; for vectors P and S,
        in 3D P, SV and SH.
        """
        return types_of(self.sim.stencil.components, self.sim.stencil.dim)

    def reflection(self, wavelength: float, angle: float, azimuth: float = 0.0) -> complex:
        """Amplitude of the wave that the high side returns for a plane wave of amplitude 1, for a scalar field; see
        `reflections`.
        """
        return self.reflections(wavelength, angle, azimuth)[""]

    @one_blas_thread()
    def reflections(
        self, wavelength: float, angle: float, azimuth: float = 0.0, incoming: str | None = None
    ) -> dict[str, complex]:
        """Displacement amplitudes, by type, of the waves that the high side returns for a plane wave of amplitude 1 of
        type `incoming` (the first of `types` unless given), without types that do not propagate; for second order in
        time.

        `angle` is that between the wave vector and the normal, `azimuth` in 3D that between its tangential part and the
        first axis along the side, both in degrees. InputError where the lattice does not carry so short a wave, or the
        integrator has several stages.
        """
        sim = self.sim
        wave = self.medium.plane_wave(
            wavelength / sim.lattice.spacing, angle, azimuth, self.types.index(incoming or self.types[0])
        )
        near = self.near.reshape(-1, len(self.types), self.near.shape[-1])
        levels = (1.0, 1 - 1 / wave.factor if sim.engine.stages.increments else 1 / wave.factor)[: len(near)]
        amplitudes = reflection(self.matrix(*wave.along), near, levels, wave.factor, wave.modes, sim.stencil.reach[0])
        return by_type(wave.modes, amplitudes, wave.along, float(np.radians(azimuth)))

    def profile(self, mode: np.ndarray) -> np.ndarray:
        """A mode on the nodes along the normal; for vectors, its largest component."""
        if not mode.size:
            return mode
        state = np.zeros(self.state.size, complex)
        state[self.place[:, 0]] = mode
        lead = 3 - self.sim.lattice.dim
        return np.moveaxis(self.state.portrait(state), lead, 0).reshape(self.sim.engine.core.nodes[lead], -1)[:, 0]

"""Reflection of a lattice PML from its own equations at one frequency and tangential wavenumber, the damping of short
waves included.

Along the normal the layer's columns hold x(1) .. x(L), and U(p, k) is column p continued by k nodes. At a factor z per
step the recursion over the edge p between columns p and p + 1, with the stretch ``g = kappa + sigma/(s + alpha)`` and
``s = 2/dt (z - 1)/(z + 1)``,

    (1 - g) U(p+1,k+1) + (1 + g) U(p+1,k) = (1 + g) U(p,k+1) + (1 - g) U(p,k),

is solved inwards for k >= 0 (with zeros beyond the last column) and outwards for k <= 0 (from the near field's nodes at
the entrance). The operator A of the columns is therefore a matrix. With the part F = D F D of the increments that the
filter of `farhorizon.engine.filter` removes in a step, the scheme ``(z - 1) x = (1 - F)(keep (1 - 1/z) x + scale A x)``
and the modes of the medium in front of the layer form one small linear system.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from farhorizon.analysis.exact.chain import Recursion
from farhorizon.analysis.layers.columns import continuations, take_stencil
from farhorizon.analysis.layers.reflection import (
    Chain,
    Modes,
    by_type,
    chain_weights,
    eigenvalue_of_type,
    factor_of_wave,
    polarisations,
    types_of,
)
from farhorizon.engine.dampers import response, springs_of, strengths_of
from farhorizon.engine.engine import Layer
from farhorizon.engine.filter import line_damping
from farhorizon.engine.parallel import in_parallel
from farhorizon.medium.stencil import Stencil

_IN_CACHE = 1 << 16  # matrix entries of the systems that are solved at once


@dataclass(frozen=True)
class ArrivingWave:
    """A wave that meets a side, with all modes of the medium at its factor per step and its tangential wavenumber.

    Attributes
    ----------
    weights : ndarray of complex, shape (2 K + 1,), of vectors (2 K + 1, d, d)
        The stencil along the normal, as from `chain_weights`, times coefficient / spacing^2.
    along : ndarray, shape (dim - 1,)
        Tangential wavenumbers times spacing.
    modes : Modes
    factor : complex
        Factor per step.
    recursion : Recursion
    dt : float
    """

    weights: np.ndarray
    along: np.ndarray
    modes: Modes
    factor: complex
    recursion: Recursion
    dt: float

    @property
    def s(self) -> complex:
        """Discrete frequency of the trapezoidal rule, ``2/dt (z - 1)/(z + 1)``."""
        return 2 / self.dt * (self.factor - 1) / (self.factor + 1)

    @property
    def eigenvalue(self) -> complex:
        """Eigenvalue of the operator, in 1/time^2 (waves) or 1/time (diffusion)."""
        return complex(self.recursion.eigenvalue(np.array(self.factor)))


@dataclass(frozen=True)
class WavesAtFrequency:
    """All waves of a medium at one factor per step and one tangential wavenumber, from which several may be selected.

    Attributes
    ----------
    chain : Chain
    along, factor, recursion, dt
        As in `ArrivingWave`.
    """

    chain: Chain
    along: np.ndarray
    factor: complex
    recursion: Recursion
    dt: float

    def coming(self, near: complex, polarisation: np.ndarray | None = None) -> ArrivingWave:
        """Return the wave that comes to the side and is nearest to a given one, see `Chain.modes`.

        Raises
        ------
        InputError
            No such wave comes to the side.
        """
        modes = self.chain.modes(near, polarisation)
        return ArrivingWave(self.chain.weights, self.along, modes, self.factor, self.recursion, self.dt)


@dataclass(frozen=True)
class LatticeMedium:
    """An unbounded medium and its time integration.

    Attributes
    ----------
    stencil : Stencil
        Its first axis is the normal of the side at which waves arrive.
    coefficient : float
        Squared speed or diffusivity.
    spacing : float
    recursion : Recursion
    dt : float
    """

    stencil: Stencil
    coefficient: float
    spacing: float
    recursion: Recursion
    dt: float

    @property
    def rate(self) -> float:
        """``coefficient / spacing^2``."""
        return self.coefficient / self.spacing**2

    @property
    def speed(self) -> float:
        """Speed of waves."""
        return float(np.sqrt(self.coefficient))

    def wave(
        self,
        along: Sequence[float] | np.ndarray,
        factor: complex,
        near: complex,
        polarisation: np.ndarray | None = None,
    ) -> ArrivingWave:
        """The wave of a factor per step and tangential wavenumbers times spacing; see `Chain.modes`.

        Raises
        ------
        InputError
            No such wave comes to the side.
        """
        return self.waves(along, factor).coming(near, polarisation)

    def waves(self, along: Sequence[float] | np.ndarray, factor: complex) -> WavesAtFrequency:
        """All waves of a factor per step and tangential wavenumbers times spacing."""
        along = np.asarray(along, float)
        chain = Chain.of(self.rate * chain_weights(self.stencil, along.tolist()), factor, self.recursion)
        return WavesAtFrequency(chain, along, factor, self.recursion, self.dt)

    def plane_wave(self, wavelength: float, angle: float, azimuth: float = 0.0, number: int = 0) -> ArrivingWave:
        """A plane wave, for schemes of second order in time.

        Parameters
        ----------
        wavelength : float
            In spacings.
        angle : float
            Between the wave vector and the normal, in degrees.
        azimuth : float
            In 3D, between its tangential part and the first axis along the side, in degrees.
        number : int
            Number of its type among `types_of`.

        Raises
        ------
        InputError
            No such wave comes to the side, because it is too short for the lattice, or the integrator has several
            stages.
        """
        wavenumber, tilt, turn = 2 * np.pi / wavelength, np.radians(angle), np.radians(azimuth)
        along = wavenumber * np.sin(tilt) * np.array([np.cos(turn), np.sin(turn)])[: self.stencil.dim - 1]
        normal = wavenumber * np.cos(tilt)
        shape = polarisations(self.stencil.components, self.stencil.dim, float(tilt), float(turn))
        factor = factor_of_wave(
            -self.rate * eigenvalue_of_type(self.stencil.symbol(normal, *along), shape, number), self.recursion
        )
        return self.wave(along, factor, np.exp(1j * normal), shape[number])

    def diffusion_wave(self, wavelength: float, angle: float) -> ArrivingWave:
        """The field that diffuses from a source of one frequency, ``exp(i w t - (a + i b) x + i q y)``, whose phase
        travels towards the side while it decays.

        In the continuum ``(a + i b)^2 = q^2 + (r + i w) / D``, with the reaction r; without it ``b = sqrt(w cos(angle)
        / 2 D)``, ``q = b tan(angle)``, and with it the angle stands for the same q. The layer's stretch does not depend
        on the frequency, so time is taken to be continuous.

        Parameters
        ----------
        wavelength : float
            ``2 pi sqrt(2 D / w)`` in spacings, the length of a wave along the normal.
        angle : float
            Between the direction of the phase and the normal, in degrees.

        Raises
        ------
        InputError
            The lattice carries no such wave.
        """
        tilt = np.radians(angle)
        frequency = 2 * self.rate * (2 * np.pi / wavelength) ** 2
        normal = 2 * np.pi / wavelength * np.sqrt(np.cos(tilt))
        along = np.array([normal * np.tan(tilt), 0.0])[: self.stencil.dim - 1]
        decay = np.sqrt((along**2).sum() + self.stencil.reaction + 1j * frequency / self.rate)
        return self.wave(along, 1 + 1j * frequency * self.recursion.scale, np.exp(-decay))


def layer_amplitudes(wave: ArrivingWave, layer: Layer) -> np.ndarray:
    """Amplitudes of all leaving modes for an incoming wave of amplitude 1, both at the last node before the layer.

    Parameters
    ----------
    wave : ArrivingWave
    layer : Layer

    Returns
    -------
    ndarray of complex, shape (leaving modes,)
    """
    return amplitudes_of([wave], layer)[0]


def amplitudes_of(waves: Sequence[ArrivingWave], layer: Layer) -> list[np.ndarray]:
    """`layer_amplitudes` of several waves of one medium, which takes much less time than computing them one by one.

    Parameters
    ----------
    waves : sequence of ArrivingWave
        At least one.
    layer : Layer

    Returns
    -------
    list of ndarray of complex
    """
    size = layer.columns * (waves[0].weights.shape[1] if waves[0].weights.ndim > 1 else 1)
    together = max(1, _IN_CACHE // size**2)
    blocks = [waves[first : first + together] for first in range(0, len(waves), together)]
    return [one for found in in_parallel(partial(_amplitudes, layer=layer), blocks) for one in found]


def _amplitudes(waves: Sequence[ArrivingWave], layer: Layer) -> list[np.ndarray]:
    """`amplitudes_of` for so few waves that their equations fit in the cache."""
    stretch = layer.kappa + layer.sigma / (np.array([wave.s for wave in waves])[:, None] + layer.alpha)
    blocks = np.stack([wave.weights.reshape(len(wave.weights), *wave.weights.shape[1:] or (1, 1)) for wave in waves])
    n, reach, d, count = len(waves), blocks.shape[1] // 2, blocks.shape[2], layer.columns
    inside = np.array([wave.eigenvalue for wave in waves])[:, None, None] * np.eye(d) - blocks[:, reach]
    system = np.ascontiguousarray(inside[:, :, None, :, None] * np.eye(count)[:, None])
    entrance = np.zeros((n, reach, count), complex)  # U(0, k), k = 1 .. K, from the columns
    entrance_near = np.zeros((n, reach), complex)  # and from the last node of the near field
    drive = np.zeros((n, reach + 1, d, count, d), complex)
    for k, (inwards, outwards) in enumerate(continuations(stretch, reach), 1):
        entrance[:, k - 1], entrance_near[:, k - 1] = inwards[:, 0, 1:], inwards[:, 0, 0]
        take_stencil(blocks[:, reach + k], inwards, blocks[:, reach - k], outwards, system, drive)
    system, drive = system.reshape(n, d * count, d * count), drive.reshape(n, reach + 1, d * count, d)
    found: list[np.ndarray] = [np.zeros(0)] * n
    modes = np.array([len(wave.modes.leaving) for wave in waves])
    for number in np.unique(modes):
        some = np.flatnonzero(modes == number).tolist()
        equations = (part[some] for part in (blocks, system, drive, entrance, entrance_near))
        for one, amplitudes in zip(some, _leaving([waves[i] for i in some], layer, *equations), strict=True):
            found[one] = amplitudes
    return found


def _leaving(
    waves: Sequence[ArrivingWave],
    layer: Layer,
    blocks: np.ndarray,
    system: np.ndarray,
    drive: np.ndarray,
    entrance: np.ndarray,
    entrance_near: np.ndarray,
) -> np.ndarray:
    """Amplitudes of the leaving modes for which the equations of the columns and of the medium in front of them hold,
    shape (waves, leaving modes), for waves that all have the same number of these modes.
    """
    n, reach, d, first = len(waves), blocks.shape[1] // 2, blocks.shape[2], waves[0]
    if layer.tuned.size:
        system = system + _hanging(waves, layer)[:, :, None] * np.eye(system.shape[1])
    elif layer.damping.size:
        along = np.array([wave.along for wave in waves])
        damping = line_damping(layer.damping, layer.taps, first.dt, along)  # the same for each component
        factor = np.array([wave.factor for wave in waves])[:, None, None]
        lost = (factor - 1) * damping  # from the increment
        if layer.whole:  # from both time levels
            lost = factor * damping - first.recursion.keep / factor * (damping - damping @ damping)
        system = system - _of_each(damping[:, None], system)
        for own in (slice(i * layer.columns, (i + 1) * layer.columns) for i in range(d)):
            system[:, own, own] += lost / first.recursion.scale
        drive = drive - _of_each(damping[:, None, None], drive)
    roots = np.array([np.append(wave.modes.leaving, wave.modes.incoming) for wave in waves])
    vectors = np.array([np.vstack([wave.modes.vectors, wave.modes.vector]) for wave in waves])
    size = np.maximum(np.abs(roots) ** reach, 1.0)  # modes that decay within a node are scaled by their values ahead
    powers = roots[:, None] ** -np.arange(reach + 1)[:, None] / size[:, None]
    shapes = vectors.swapaxes(1, 2)[:, None]
    columns = np.linalg.solve(system, (drive @ (shapes * powers[:, :, None])).sum(1))
    columns = columns.reshape(n, d, layer.columns, -1)
    continued = (entrance[:, None] @ columns).swapaxes(1, 2)
    continued += entrance_near[:, :, None, None] * (shapes * powers[:, :1, None])
    continued -= shapes * (roots[:, None] ** np.arange(1, reach + 1)[:, None] / size[:, None])[:, :, None]
    missing = np.concatenate(
        [(blocks[:, reach + 1 + i :] @ continued[:, : reach - i]).sum(1) for i in range(reach)], axis=1
    )
    missing = missing / np.linalg.norm(missing[..., :-1], axis=1).max(1)[:, None, None]
    dependent = max(missing.shape[1:]) * np.finfo(float).eps
    found = -(np.linalg.pinv(missing[..., :-1], rcond=dependent) @ missing[..., -1:])[..., 0]
    return np.asarray(found * size[:, -1:] / size[:, :-1])


def _of_each(matrix: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Apply a real matrix, which acts on the columns of a layer, to every component; components come first."""
    count = matrix.shape[-1]
    parts = columns.reshape(*columns.shape[:-2], -1, count, columns.shape[-1]).view(float)  # half the work
    return np.asarray((matrix @ parts).view(complex).reshape(columns.shape))


def _hanging(waves: Sequence[ArrivingWave], layer: Layer) -> np.ndarray:
    """Contribution of the dampers to the eigenvalue at the columns, shape (waves, components * columns)."""
    first, factor = waves[0], np.array([wave.factor for wave in waves])
    keep, pull = springs_of(layer.tuned, first.dt)
    passed = 1 + strengths_of(layer.damping, keep, pull, first.dt) * response(factor, keep, pull)[:, None]
    change = ((factor - 1) * (1 - 1 / factor))[:, None] * (1 / passed - 1) / first.recursion.scale
    return np.tile(change, first.weights.shape[1] if first.weights.ndim > 1 else 1)


@dataclass(frozen=True)
class LayerSide:
    """A flat side with a lattice PML.

    Attributes
    ----------
    medium : LatticeMedium
    layer : Layer
    diffusive : bool
        Whether the medium carries diffusion waves, which come from a source of one frequency and decay on their way.
    """

    medium: LatticeMedium
    layer: Layer
    diffusive: bool = False
    #: Time of one angle on a typical core.
    seconds: ClassVar[float] = 0.005

    @property
    def types(self) -> tuple[str, ...]:
        """Types of waves, see `farhorizon.analysis.layers.reflection.types_of`."""
        return types_of(self.medium.stencil.components, self.medium.stencil.dim)

    def reflections(
        self, wavelength: float, angle: float, azimuth: float = 0.0, incoming: str | None = None
    ) -> dict[str, complex]:
        """Amplitudes, by type, of the waves into which a plane wave of amplitude 1 is reflected; see
        `farhorizon.checks.side_modes.Strip.reflections`.
        """
        length = wavelength / self.medium.spacing
        if self.diffusive:
            wave = self.medium.diffusion_wave(length, angle)
        else:
            wave = self.medium.plane_wave(length, angle, azimuth, self.types.index(incoming or self.types[0]))
        return by_type(wave.modes, layer_amplitudes(wave, self.layer), wave.along, float(np.radians(azimuth)))
